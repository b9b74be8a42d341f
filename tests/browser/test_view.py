"""`termwise view` in a real browser: what a control changes is what `termwise render` of that state shows, bit for bit.

Rationale: the core is tested without a browser; here a user's hands are: typed values, keys, tabs, a closed tab.
"""

import base64
import contextlib
import io
import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import attrs
import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import expect

from termwise.renderer import render_terms
from termwise.reports.pages.pictures import display
from termwise.reports.results.exr import read_exr
from termwise.scenes.load import load
from termwise.scenes.model import Scene
from termwise.scenes.terms import TERMS, total
from tests import scenes
from tests.browser.conftest import WAIT_S

COMMAND = [sys.executable, "-c", "from termwise.reports.cli import main; main()"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("view")


@pytest.fixture(scope="module")
def small(folder) -> Path:
    """A scene that renders in no time."""
    from termwise.scenes.save import save

    save(scenes.small("cornell_box", 40, 24), folder / "small.toml")
    return folder / "small.toml"


@pytest.fixture(scope="module")
def server(folder, small) -> Iterator[tuple[str, subprocess.Popen]]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [*COMMAND, "view", str(small), "--port", str(port), "--no-browser", "--out", str(folder)]
    # pytest's variables make NiceGUI take the server for one of its own tests.
    environment = {name: value for name, value in os.environ.items() if "PYTEST" not in name}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    assert process.stdout is not None
    assert f"http://127.0.0.1:{port}/" in process.stdout.readline()
    while True:
        try:
            socket.create_connection(("127.0.0.1", port), 1.0).close()
            break
        except OSError:
            assert process.poll() is None
            time.sleep(0.1)
    yield f"http://127.0.0.1:{port}/", process
    process.terminate()
    process.wait(30)


@pytest.fixture
def tab(new_context) -> Iterator[Callable]:
    """Opens empty tabs, each of another user."""
    faults: list[str] = []

    def opened():
        page = new_context(permissions=["clipboard-read", "clipboard-write"]).new_page()
        page.on("pageerror", lambda error: faults.append(str(error)))
        return page

    yield opened
    assert not faults


@pytest.fixture
def page(tab, server):
    page = tab()
    page.goto(server[0])
    settled(page)
    return page


def settled(page, samples: int = 256) -> None:
    """Wait until all terms have as many samples."""
    page.wait_for_function(
        f"document.querySelector('img.picture')?.dataset.samples == '{samples}' && "
        "document.body.innerText.includes('· done')"
    )


def source(page, name: str = "total") -> str:
    """Address of a picture, which is all of it."""
    return page.locator(f"img.picture[alt*='{name}:']").get_attribute("src")


def pixels(page, name: str = "total") -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(source(page, name).partition(",")[2]))))


def shown(scene: Scene, samples: int = 256, **variants: str) -> dict[str, np.ndarray]:
    """What `termwise render` would write as PNG."""
    wanted: dict[str, str | None] = {term: variants.get(term) for term in TERMS}
    images = {term: each.mean for term, each in render_terms(scene, wanted, samples=samples).items()}
    images["total"] = total(*(images[term] for term in TERMS))
    return {name: display(image, exposure=scene.exposure) for name, image in images.items()}


def enter(page, heading: str, label: str, value: str):
    """Type a value into the input of that label, opening its group first."""
    field = page.get_by_label(f"{heading}: {label}", exact=True)
    if not field.is_visible():
        page.get_by_text(heading, exact=True).click()
    field.fill(value)
    field.press("Tab")
    return field


def changed(page, heading: str, label: str, value: str) -> None:
    before = source(page)
    enter(page, heading, label, value)
    page.wait_for_function("s => document.querySelector('img.picture').src != s", arg=before)
    settled(page)


def painted(scene: Scene, name: str, **changes) -> Scene:
    things = [
        attrs.evolve(thing, material=attrs.evolve(thing.material, **changes)) if thing.name == name else thing
        for thing in scene.objects
    ]
    return attrs.evolve(scene, objects=tuple(things))


@pytest.mark.slow
def test_the_picture_is_that_of_render(page, small):
    expected = shown(load(small))
    np.testing.assert_array_equal(pixels(page), expected["total"])
    page.get_by_text("terms side by side").click()
    page.wait_for_selector("img.picture[alt*='specular:']")
    for term in ("ambient", "direct", "specular"):
        np.testing.assert_array_equal(pixels(page, term), expected[term])


def test_an_input_renders_what_it_touches(page, small):
    changed(page, "tall block", "roughness (Beckmann α)", "0.6")
    np.testing.assert_array_equal(pixels(page), shown(painted(load(small), "tall block", roughness=0.6))["total"])
    assert "kept: ambient, direct" in page.locator("[role=status]").first.inner_text()


@pytest.mark.slow
def test_the_curve_is_that_of_the_reports_viewer(page, small):
    """Gamma in place of sRGB's curve, to the bit; a wrong one is refused, and the picture stays."""
    image = render_terms(load(small), dict.fromkeys(TERMS), samples=256)
    radiance = total(*(image[term].mean for term in TERMS))
    before = source(page)
    page.get_by_label("Picture: curve", exact=True).click()
    page.get_by_role("option", name="gamma", exact=True).click()
    page.wait_for_function("s => document.querySelector('img.picture').src != s", arg=before)
    before = source(page)
    enter(page, "Picture", "gamma", "1.5")
    expected = np.round(255 * np.clip(radiance * load(small).exposure, 0, 1) ** (1 / 1.5)).astype(np.uint8)
    page.wait_for_function("s => document.querySelector('img.picture').src != s", arg=before)
    np.testing.assert_array_equal(pixels(page), expected)
    enter(page, "Picture", "gamma", "7.5")
    page.get_by_text("gamma = 7.5: allowed is a number in [1, 3]").wait_for()
    np.testing.assert_array_equal(pixels(page), expected)


@pytest.mark.slow
def test_a_variant_and_the_camera_too(page, small):
    page.get_by_label("Estimators: ambient", exact=True).click()
    page.get_by_role("option", name="paper", exact=True).click()
    page.wait_for_function("document.querySelector('table[aria-label=Terms]').innerText.includes('paper')")
    settled(page)
    np.testing.assert_array_equal(pixels(page), shown(load(small), ambient="paper")["total"])
    changed(page, "Camera", "field of view (paper: FOV, degrees)", "40")
    scene = load(small)
    scene = attrs.evolve(scene, camera=attrs.evolve(scene.camera, fov=40.0))
    np.testing.assert_array_equal(pixels(page), shown(scene, ambient="paper")["total"])


def test_a_switch_changes_the_plan(page):
    page.get_by_text("Switches", exact=True).click()
    page.get_by_text("lighting", exact=True).click()
    page.wait_for_function("document.querySelector('table[aria-label=Plan]').innerText.includes('lighting is off')")


@pytest.mark.slow
def test_a_wrong_value_is_refused_in_its_place(page):
    before = pixels(page)
    enter(page, "tall block", "gloss (paper: g)", "1.5")
    page.get_by_text("tall block: gloss = 1.5: allowed is a number in [0, 1]").wait_for()
    np.testing.assert_array_equal(pixels(page), before)
    enter(page, "tall block", "gloss (paper: g)", "")
    page.get_by_text("gloss = None: allowed is a number").wait_for()
    changed(page, "tall block", "gloss (paper: g)", "0.4")
    expect(page.get_by_text("allowed is a number")).to_have_count(0)


@pytest.mark.slow
def test_undo_redo_by_keyboard(page):
    field = page.get_by_label("Camera: field of view (paper: FOV, degrees)", exact=True)
    before = source(page), field.input_value()
    changed(page, "Camera", "field of view (paper: FOV, degrees)", "40")
    after = source(page), "40"
    for name, expected in (("undo", before), ("redo", after)):
        page.get_by_role("button", name=name).focus()
        page.keyboard.press("Enter")
        page.wait_for_function("s => document.querySelector('img.picture').src == s", arg=expected[0])
        settled(page)
        expect(field).to_have_value(expected[1])


@pytest.mark.slow
def test_the_camera_turns_by_arrow_keys_and_mouse(page):
    field = page.get_by_label("Camera: position x (scene units)")
    page.get_by_text("Camera", exact=True).click()
    values = [field.input_value()]
    page.locator(".picture-frame").focus()
    page.keyboard.press("ArrowRight")
    expect(field).not_to_have_value(values[0])
    values.append(field.input_value())
    box = page.locator(".picture-frame").bounding_box()
    page.mouse.move(box["x"] + 100, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 160, box["y"] + 110, steps=4)
    page.mouse.up()
    expect(field).not_to_have_value(values[1])


@pytest.mark.slow
def test_saved_scene_and_copied_command_give_the_picture(page, folder, tmp_path):
    changed(page, "tall block", "gloss (paper: g)", "0.4")
    page.get_by_label("name", exact=True).fill("glossy")
    page.get_by_role("button", name="export PNG and EXR").click()
    page.get_by_text(re.compile(r"wrote .*glossy\.exr")).wait_for()
    page.get_by_role("button", name="copy command").click()
    page.get_by_text(re.compile("copied: termwise render")).wait_for()
    words = page.evaluate("navigator.clipboard.readText()").split()
    assert words[:2] == ["termwise", "render"]
    subprocess.run([*COMMAND, *words[1:], "--out", str(tmp_path)], check=True, capture_output=True)
    again = np.asarray(Image.open(tmp_path / "render" / "glossy.total.png"))
    np.testing.assert_array_equal(pixels(page), again)
    np.testing.assert_array_equal(np.asarray(Image.open(folder / "view" / "glossy.png")), again)
    ours, theirs = (read_exr(path) for path in (folder / "view" / "glossy.exr", tmp_path / "render" / "glossy.exr"))
    for name, image in ours.items():
        assert image.tobytes() == theirs[name].tobytes()


@pytest.mark.slow
def test_names_outside_the_folder_are_refused(page, folder):
    page.get_by_label("name", exact=True).fill("../escaped")
    page.get_by_role("button", name="save scene").click()
    page.get_by_text(re.compile(r"name = '\.\./escaped': allowed are")).wait_for()
    assert not (folder / "escaped.toml").exists()


def test_a_scene_that_does_not_load_keeps_the_last(page):
    before = pixels(page)
    page.get_by_label("or a scene file").fill("nowhere.toml")
    page.get_by_label("or a scene file").press("Enter")
    page.get_by_text("nowhere.toml: cannot be read").wait_for()
    np.testing.assert_array_equal(pixels(page), before)


@pytest.mark.slow
def test_two_tabs_do_not_disturb_each_other(page, tab, server):
    other = tab()
    other.goto(server[0])
    settled(other)
    before = pixels(page)
    changed(other, "Camera", "field of view (paper: FOV, degrees)", "40")
    np.testing.assert_array_equal(pixels(page), before)
    assert (pixels(other) != before).any()


def busy(process: subprocess.Popen) -> bool:
    """Whether threads of the server run, or want to: other work on the machine makes them wait, not rest."""
    found = 0
    for _ in range(50):
        states = []
        for path in Path(f"/proc/{process.pid}/task").glob("*/stat"):
            with contextlib.suppress(OSError):  # the thread has ended
                states.append(path.read_text().rpartition(")")[2].split()[0])
        found += "R" in states
        time.sleep(0.02)
    return found > 25


def wait_until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < end


def refine_for_ever(page) -> None:
    enter(page, "Estimators", "samples (paper: max_samples, per pixel, where refinement ends)", "1000000")
    page.wait_for_function("document.body.innerText.includes('· refining')")


@pytest.mark.slow
def test_a_closed_tab_stops_its_work(page, server):
    refine_for_ever(page)
    wait_until(lambda: busy(server[1]))
    page.close()
    wait_until(lambda: not busy(server[1]))


@pytest.mark.slow
def test_a_tab_that_was_away_finds_its_state(page, server):
    """The work rests meanwhile; the state, what can be undone and the samples are still there."""
    before = source(page)
    changed(page, "Camera", "field of view (paper: FOV, degrees)", "40")
    refine_for_ever(page)
    page.evaluate(
        """() => {
            window.sameDocument = true;
            const manager = window.socket.io;
            manager.reconnectionDelay(6000);
            manager.reconnectionDelayMax(6000);
            manager.randomizationFactor(0);
            manager.engine.close();
        }"""
    )
    wait_until(lambda: not busy(server[1]))
    page.wait_for_function("window.socket.connected")
    wait_until(lambda: busy(server[1]))
    enter(page, "Estimators", "samples (paper: max_samples, per pixel, where refinement ends)", "256")
    for _ in range(3):
        page.get_by_role("button", name="undo").click()
    page.wait_for_function("s => document.querySelector('img.picture').src == s", arg=before)
    assert page.evaluate("window.sameDocument")


def test_nothing_is_asked_of_the_network(tab, server):
    page = tab()
    addresses: list[str] = []
    page.on("request", lambda request: addresses.append(request.url))
    page.goto(server[0])
    settled(page)
    assert addresses
    assert all(address.startswith((server[0], "data:", "ws:" + server[0][5:])) for address in addresses)


@pytest.mark.slow
def test_the_truth_arrives_and_is_cancelled(page):
    page.get_by_role("button", name="render the reference").click()
    page.get_by_text(re.compile(r"[1-9]\d* of 16 replicates")).wait_for()
    assert page.locator("img[alt^='signed error']").count() == 3
    page.get_by_role("button", name="cancel").click()
    page.get_by_text("cancelled").wait_for()
    page.get_by_role("button", name="render the reference").click()
    page.get_by_text("16 of 16 replicates").wait_for()
    table = page.locator("table[aria-label=Verdicts]").inner_text()
    assert "BIASED" not in table
    assert "EQUIVALENT" in table or "UNDERPOWERED" in table
    page.set_viewport_size({"width": 400, "height": 800})  # with all its tables, no wider than a narrow screen
    page.wait_for_function("document.documentElement.scrollWidth <= innerWidth")


@pytest.mark.slow
def test_every_scene_of_the_library_has_a_page(page):
    """Infinite distances included: what the browser's number fields do not know."""
    for name in ("monkey", "two_cubes"):
        page.get_by_label("scene", exact=True).first.click()
        page.get_by_role("option", name=name, exact=True).click()
        page.wait_for_selector(f"img.picture[alt^='{name}, total:']")
    page.get_by_text("Light", exact=True).click()
    reach = page.get_by_label("Light: ambient range (paper: AO distance, scene units or inf)")
    expect(reach).to_have_value("inf")
    reach.fill("far")
    page.get_by_text("range = 'far': allowed is a number").wait_for()
    reach.fill("0.5")
    page.wait_for_function("document.body.innerText.includes('kept: direct, background')")
