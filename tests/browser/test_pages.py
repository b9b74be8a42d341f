"""The pages in a real browser, from `file://`, offline: no complaint, every control, values as in the EXR.

The run is of known pixels, written here.
"""

import base64
import io
import json
import math
import re
from importlib import resources
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest
import xarray
from PIL import Image
from playwright.sync_api import BrowserContext, Page
from scipy import stats

from termwise.reports.pages import report as page
from termwise.reports.pages import single
from termwise.reports.results import microscope
from termwise.reports.results.exr import read_exr, write_exr

SIZE = 24
REPLICATES = 16
REFERENCE_REPLICATES = 8
CELLS = [("ambient", "cosine"), ("ambient", "paper"), ("direct", "next-event"), ("total", "default")]
LIMITS = ["ambient", "ambient times 3.14159", "ambient physical", "direct all", "total", "total physical"]
AGAINST = {"own": [0, 1, 3, 4], "correct": [0, 0, 3, 4], "physical": [2, 2, -1, 5]}
SCENES = ["two_cubes", "a room & <more>"]
SCENE = SCENES[0]
SIDES = 8, 16, 32
AXE = resources.files("axe_playwright_python") / "axe.min.js"


@attrs.define
class Opened:
    """A page, and what it complained of."""

    page: Page
    complaints: list[str]


@pytest.fixture
def context(new_context) -> BrowserContext:
    """Offline, 1300 pixels wide."""
    return new_context(offline=True, viewport={"width": 1300, "height": 1000})


def opened(context: BrowserContext, address: str) -> Opened:
    """Open a page of the disk, and wait for its viewer or charts."""
    its = Opened(context.new_page(), [])
    its.page.on("console", lambda m: its.complaints.append(m.text) if m.type in ("error", "warning") else None)
    its.page.on("pageerror", lambda error: its.complaints.append(str(error)))
    its.page.on("requestfailed", lambda request: its.complaints.append(f"failed: {request.url}"))

    def within(request) -> None:
        if not request.url.startswith(("file:", "data:", "blob:")):
            its.complaints.append(f"left the machine: {request.url}")

    its.page.on("request", within)
    its.page.goto(address)
    its.page.wait_for_load_state("load")
    return its


def tile_tests(rng: np.random.Generator) -> dict[str, tuple[tuple[str, ...], np.ndarray]]:
    """Of the first cell only: noise, one tile far too bright, one surely too dark; the smallest tiles merged."""
    found = {}
    for side in SIDES:
        count = math.ceil(SIZE / side)
        shape = len(CELLS), count, count
        p = np.full(shape, np.nan)
        p[0] = rng.uniform(0.3, 1.0, shape[1:]) if side > 8 else np.nan
        bias = np.where(np.isnan(p), np.nan, 0.01)
        if side == 16:
            p[0, 0] = 1e-9, 0.02
            p[0, 1, 1] = np.nan
            bias[0, 0] = 0.25, -0.04
        holm = np.clip(2 * p, None, 1.0)
        holm[0, 0, 1:] = np.maximum(holm[0, 0, 1:], 0.06)
        maps = {"bias": bias, "p": p, "holm": holm, "benjamini_hochberg": np.clip(1.5 * p, None, 1.0)}
        dims = "cell", f"tile_y_{side}", f"tile_x_{side}"
        found |= {f"tile_{name}_{side}": (dims, values) for name, values in maps.items()}
    return found


SAMPLES = [(1, 2, 4, 8, 16)] * 2 + [(1, 2, 4, 0, 0)] + [(0,) * 5]


def sweeps(rng: np.random.Generator) -> dict[str, Any]:
    """Tiles of each cell after its samples; the references' replicates in the same tiles, cut by an object."""
    objects = np.arange(SIZE) // 12 % 2 - np.ones((SIZE, 1), int)
    pieces = microscope.pieces(objects)
    found = len(pieces.pixels)
    names = "cell", "prefix", "tile_y_8", "tile_x_8"
    return {
        "object": (("y", "x"), objects),
        **{f"piece_{name}": ("piece", getattr(pieces, name)) for name in ("object", "x", "y", "pixels")},
        "image_pieces": (("cell", "replicate", "piece"), rng.gamma(9.0, 0.1, (len(CELLS), REPLICATES, found))),
        "reference_pieces": (
            ("limit", "reference_replicate", "piece"),
            rng.gamma(9.0, 0.1, (len(LIMITS), REFERENCE_REPLICATES, found)),
        ),
        "rendered": (("cell", "y", "x", "channel"), np.full((len(CELLS), SIZE, SIZE, 3), np.nan)),
        "rendered_replicate": ("cell", np.full(len(CELLS), -1)),
        "sweep_samples": (names[:2], np.array(SAMPLES)),
        "sweep_luminance": (names, rng.gamma(9.0, 0.1, (len(CELLS), 5, 3, 3))),
        "sweep_variance": (names, rng.gamma(9.0, 1e-4, (len(CELLS), 5, 3, 3))),
    }


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """The folder of a finished run: `results.json`, `results.nc`, `images/*.exr` and its pages."""
    folder = tmp_path_factory.mktemp("compare run")
    rng = np.random.default_rng(11)
    dims = "y", "x", "channel"
    described, rows = {}, []
    for index, scene in enumerate(SCENES):
        reference = rng.gamma(2.0, 0.4, (len(LIMITS), SIZE, SIZE, 3)).astype(np.float32)
        ours = np.stack([reference[limit] for limit in AGAINST["own"]])
        ours = (ours * rng.normal(1.0, 0.1, ours.shape)).astype(np.float32)
        ours[0, 2, 3] = 1234.5  # far brighter than the screen
        ours[1, 4, 5, 1] = np.nan
        xarray.Dataset(
            {
                "image": (("cell", *dims), ours),
                "image_variance": (("cell", *dims), rng.gamma(2.0, 1e-3, ours.shape).astype(np.float32)),
                "reference": (("limit", *dims), reference),
                "reference_variance": (("limit", *dims), rng.gamma(2, 1e-4, reference.shape).astype(np.float32)),
            }
            | tile_tests(rng)
            | sweeps(rng),
            {
                "cell_term": ("cell", [term for term, _ in CELLS]),
                "cell_variant": ("cell", [variant for _, variant in CELLS]),
                "limit_name": ("limit", LIMITS),
                "object_name": ("objects", ["a wall"]),
                **{name: ("cell", limits) for name, limits in AGAINST.items()},
            },
            {"exposure": 0.8},
        ).to_netcdf(folder / "results.nc", group=scene, mode="a" if index else "w", engine="h5netcdf")
        parts = {f"{term}.{variant}": image for (term, variant), image in zip(CELLS, ours, strict=True)}
        parts |= {f"reference.{name}": image for name, image in zip(LIMITS, reference, strict=True)}
        (folder / "images").mkdir(exist_ok=True)
        write_exr(folder / "images" / f"{scene}.exr", parts, {})
        described[scene] = {"resolution": [SIZE, SIZE], "exposure": 0.8, "scope": "all", "digest": "3f" * 32}
        described[scene]["plan"] = [
            {"term": "direct", "work": "photons", "kind": "skip", "reason": "no light", "saved": {}, "at_most": False}
        ]
        for term, variant in CELLS:
            common = {"scene": scene, "term": term, "variant": variant, "kind": "right", "scope": "all"}
            for samples in (1, 2, 4, 8, 16):
                error = 0.3 * samples**-0.5
                measured = {"samples": samples, "seconds": 0.1 * samples, "rmse": error}
                measured |= {"rmse_low": 0.9 * error, "rmse_high": 1.1 * error, "replicates": REPLICATES}
                measured |= dict.fromkeys(("verdict", "bias", "bias_low", "bias_high", "sentence"))
                rows.append(common | measured | {"against": "own"})
            rows[-1] |= {
                "verdict": "EQUIVALENT", "sentence": "EQUIVALENT: so.", "bias": 0.001, "bias_low": -0.001,
                "bias_high": 0.003, "standard_error": 0.001, "detectable_bias": 0.004, "ssim": 0.99,
                "reference_replicates": REFERENCE_REPLICATES, "reference_samples": 32, "tests": 9,
                "margin": 0.01, "allowance": 0.0, "reference_seconds": 2.0,
                "channels": [
                    {"region": "image", "channel": name, "bias": 0.001, "low": -0.001, "high": 0.003}
                    for name in ("red", "green", "blue")
                ],
                "tiles": [
                    {
                        "side": side, "tiles": 9, "tested": 4, "holm": 1, "benjamini_hochberg": 2, "fraction": 0.5,
                        "found": [], "histogram": [0] * 20, "left_out": 1, "uniform_p": None, "skewness": 0.1,
                        "merged_into": 16 if side == 8 else None,
                    }
                    for side in SIDES
                ],
            }  # fmt: skip
    asked = {"study": "standard", "seed": 1, "command": "termwise compare", "options": {}, "tests": 9, "alpha": 0.05}
    results = {"schema": 1, "versions": {"termwise": "0.1.0"}, "settings": asked | {"scenes": described}, "cells": rows}
    (folder / "results.json").write_text(json.dumps(results), "utf-8")
    page.write(folder)
    return folder


@pytest.fixture
def view(context, run):
    """The viewer of a scene, by what follows in its address; it must complain of nothing."""
    found = []

    def view(state="", scene=SCENE):
        its = opened(context, (run / "scenes" / f"{scene}.viewer.html").as_uri() + state)
        found.append(its)
        return ready(its.page)

    yield view
    assert [complaint for its in found for complaint in its.complaints] == []


def ready(page):
    """Once all pixels are there and drawn."""
    page.wait_for_selector("#viewer[data-state=ready]")
    return page


def screen(page, panel):
    """(h, w, 3) uint8 of a panel."""
    text = page.evaluate("(id) => document.getElementById(id).toDataURL('image/png')", panel)
    with Image.open(io.BytesIO(base64.b64decode(text.partition(",")[2]))) as image:
        return np.asarray(image.convert("RGB"))


def middles(page, panel):
    """(SIZE, SIZE, 3) uint8: the colours in the middle of each pixel at zoom 1."""
    shown = screen(page, panel)
    at = ((np.arange(SIZE) + 0.5) * shown.shape[1] / SIZE).astype(int)
    return shown[at][:, at].astype(int)


def numbers(page):
    """The inspector's table: row by name, numbers or the text."""

    def value(text):
        return float(text.replace("−", "-")) if re.fullmatch(r"[−\d.e+]+|NaN", text) else text

    rows = page.locator("#inspector tbody tr").all()
    return {
        row.locator("th").inner_text(): [value(text) for text in row.locator("td").all_inner_texts()] for row in rows
    }


@pytest.mark.slow
def test_every_page_loads_without_complaint_and_without_network(context, run):
    pages = sorted([*run.glob("*.html"), *run.glob("scenes/*.html")])
    assert len(pages) == 2 + 2 * len(SCENES)
    for path in pages:
        its = opened(context, path.as_uri())
        its.page.wait_for_timeout(200)
        assert its.complaints == [], path.name


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize(
    "against", ["own", *(pytest.param(other, marks=pytest.mark.slow) for other in ("correct", "physical"))]
)
@pytest.mark.parametrize("cell", range(len(CELLS)), ids=["-".join(cell) for cell in CELLS])
def test_inspector_shows_the_values_of_the_exr(view, run, scene, cell, against):
    limit = AGAINST[against][cell]
    if limit < 0:
        return  # the viewer then offers no such reference, as tested below
    term, variant = CELLS[cell]
    parts = read_exr(run / "images" / f"{scene}.exr")
    with xarray.open_dataset(run / "results.nc", group=scene, engine="h5netcdf") as data:
        x, y = 7, 19
        ours, right = parts[f"{term}.{variant}"][y, x], parts[f"reference.{LIMITS[limit]}"][y, x]
        its = data["image_variance"].values[cell, y, x].astype(float)
        other = data["reference_variance"].values[limit, y, x].astype(float)
    shown = numbers(view(f"#term={term}&variant={variant}&against={against}&pixel={x},{y}", scene))
    degrees = (its + other) ** 2 / (its**2 / (REPLICATES - 1) + other**2 / (REFERENCE_REPLICATES - 1))
    half = stats.t.ppf(0.95, np.floor(degrees)) * np.sqrt(its + other)
    for channel, name in enumerate(("red", "green", "blue")):
        a, b, difference, interval, deviations = shown[name]
        assert a == pytest.approx(ours[channel], rel=1e-4)
        assert b == pytest.approx(right[channel], rel=1e-4)
        apart = float(ours[channel]) - float(right[channel])
        assert difference == pytest.approx(apart, rel=1e-4)
        low, high = (float(text) for text in str(interval).replace("−", "-").strip("[]").split(", "))
        # Standard errors are kept to 11 bits.
        assert low == pytest.approx(apart - half[channel], abs=1e-3 * half[channel])
        assert high == pytest.approx(apart + half[channel], abs=1e-3 * half[channel])
        assert deviations == pytest.approx(apart / math.sqrt(its[channel] + other[channel]), rel=1e-2)


def test_an_invalid_pixel_is_named_and_magenta(view):
    page = view("#term=ambient&variant=paper&pixel=5,4")
    assert math.isnan(numbers(page)["green"][0])
    for panel in ("left", "right"):
        assert middles(page, panel)[4, 5].tolist() == [255, 0, 255]


def encoded(radiance, stops=0.0, gamma=None):
    """8-bit sRGB (IEC 61966-2-1) or a power, at the scene's exposure."""
    v = np.clip(radiance.astype(float) * 0.8 * 2**stops, 0, 1)
    if gamma:
        return 255 * v ** (1 / gamma)
    return 255 * np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize(("stops", "gamma"), [(0.0, None), (-3.0, None), (1.5, 1.8)])
def test_canvas_shows_the_radiance_at_exposure_and_gamma(view, run, stops, gamma):
    curve = f"&curve=gamma&gamma={gamma}" if gamma else ""
    page = view(f"#term=ambient&ev={stops}{curve}&beside=reference")
    parts = read_exr(run / "images" / f"{SCENE}.exr")
    for panel, part in (("left", "ambient.cosine"), ("right", "reference.ambient")):
        assert np.abs(middles(page, panel) - encoded(parts[part], stops, gamma)).max() <= 0.51


def test_split_shows_ours_and_the_reference(view, run):
    page = view("#term=ambient&split=true&at=0.5")
    parts = read_exr(run / "images" / f"{SCENE}.exr")
    shown = middles(page, "left")
    half = SIZE // 2
    assert np.abs(shown[:, : half - 1] - encoded(parts["ambient.cosine"])[:, : half - 1]).max() <= 0.51
    assert np.abs(shown[:, half + 1 :] - encoded(parts["reference.ambient"])[:, half + 1 :]).max() <= 0.51


@pytest.mark.parametrize(
    ("map_", "channel"),
    [("signed", None), ("relative", None), ("deviations", None), ("signed", "green"), ("deviations", "blue")],
)
def test_maps_are_blue_where_ours_is_darker_and_red_where_brighter(view, run, map_, channel):
    page = view(f"#term=direct&beside={map_}")
    if channel:
        page.locator("#channel").select_option(channel)
        ready(page)
        assert f"channel={channel}" in page.url
        assert channel in page.locator("#right + figcaption").inner_text()
    parts = read_exr(run / "images" / f"{SCENE}.exr")
    apart = parts["direct.next-event"].astype(float) - parts["reference.direct all"]
    if map_ == "deviations":
        with xarray.open_dataset(run / "results.nc", group=SCENE, engine="h5netcdf") as data:
            apart /= np.sqrt(data["image_variance"].values[2] + data["reference_variance"].values[3])
    if channel:
        apart = apart[..., ["red", "green", "blue"].index(channel)]
    elif map_ == "deviations":
        greatest = np.abs(apart).argmax(axis=-1, keepdims=True)
        apart = np.take_along_axis(apart, greatest, axis=-1)[..., 0]
    else:
        apart = apart @ np.array([0.2126, 0.7152, 0.0722])
    shown = middles(page, "right")
    redder = shown[..., 0] - shown[..., 2]
    clear = np.abs(apart) > 0.1 * np.quantile(np.abs(apart), 0.99)
    assert clear.sum() > SIZE
    assert np.array_equal(np.sign(redder[clear]), np.sign(apart[clear]))


def test_p_map_colours_the_tiles_found_and_outlines_the_surest(view):
    page = view("#term=ambient&beside=p&pixel=12,3")
    shown = middles(page, "right")
    bright, dark = shown[3, 12], shown[3, 20]
    assert bright[0] > bright[2] + 60  # red, 16 px wide
    assert dark[2] > dark[0] + 20
    assert np.ptp(bright) > np.ptp(dark)  # the surer, the fuller
    grey, nothing = shown[20, 3], shown[20, 20]
    assert np.ptp(grey) == np.ptp(nothing) == 0
    assert nothing[0] < grey[0]
    rim = np.zeros((SIZE, SIZE), bool)
    rim[[0, 15], :16] = rim[:16, [0, 15]] = True
    assert np.array_equal((shown == 0).all(axis=-1), rim)
    said = page.locator("#tile").inner_text()
    assert said.startswith("Tile x 0–15, y 0–15: bias of luminance +25 %; p 1e−9;")
    assert "Holm 2e−9 (found), by Benjamini-Hochberg 1.5e−9 (found)" in said
    page.locator("#left").focus()
    for _ in range(4):
        page.keyboard.press("ArrowRight")
    ready(page)
    said = page.locator("#tile").inner_text()
    assert said.startswith("Tile x 16–23, y 0–15: bias of luminance −4 %; p 0.02;")
    assert "Holm 0.06 (not found), by Benjamini-Hochberg 0.03 (found)" in said


def test_p_map_has_three_sizes_and_says_where_there_is_none(view):
    page = view("#term=ambient&beside=p&pixel=3,20")
    caption = page.locator("#right + figcaption")
    page.get_by_role("combobox", name="Tiles").select_option("8 px")
    ready(page)
    assert "merged into the tiles of 16 px" in caption.inner_text()
    page.locator("h1").click()
    page.keyboard.press("w")
    page.keyboard.press("w")
    ready(page)
    assert "side=32" in page.url
    assert "Tile x 0–23, y 0–23" in page.locator("#tile").inner_text()
    page.keyboard.press("p")
    ready(page)
    assert "own limit alone" in caption.inner_text()
    assert "this row has no p-map" in view("#term=direct&beside=p").locator("#right + figcaption").inner_text()


@pytest.mark.parametrize("cell", [1, 2])
def test_inspector_shows_the_convergence_of_the_tile(view, run, cell):
    term, variant = CELLS[cell]
    page = view(f"#term={term}&variant={variant}&pixel=10,17")
    with xarray.open_dataset(run / "results.nc", group=SCENE, engine="h5netcdf") as data:
        ours = data["sweep_luminance"].values[cell, :, 2, 1]
        errors = np.sqrt(data["sweep_variance"].values[cell, :, 2, 1])
        within = (data["piece_x"].values == 8) & (data["piece_y"].values == 16)
        stack = data["reference_pieces"].values[AGAINST["own"][cell]][:, within]
        right = np.average(stack, axis=1, weights=data["piece_pixels"].values[within])
    assert within.sum() == 2
    samples = [count for count in SAMPLES[cell] if count]
    svg = page.locator("#convergence svg")
    said = svg.get_attribute("aria-label")
    shown = [(float(value), int(n)) for value, n in re.findall(r"([\d.]+) after (\d+)", said)]
    assert [n for _, n in shown] == samples
    # Kept to 11 bits.
    assert [value for value, _ in shown] == pytest.approx(ours[: len(samples)], rel=1e-3)
    assert float(said.rpartition("reference ")[2]) == pytest.approx(right.mean(), rel=1e-3)

    def of(name, *attributes):
        return np.array([[float(each.get_attribute(a)) for a in attributes] for each in svg.locator(name).all()])

    points, ((middle,),) = of("circle", "cx", "cy"), of("line", "y1")
    assert np.ptp(np.diff(points[:, 0])) < 1e-6  # a logarithmic axis
    # All heights are of one scale: that of the points' values.
    scale, zero = np.polyfit(ours[: len(samples)], points[:, 1], 1)
    assert scale < 0
    assert middle == pytest.approx(scale * right.mean() + zero, abs=1.0)
    ((top, height),) = of("rect", "y", "height")
    half = stats.t.ppf(0.95, len(right) - 1) * stats.sem(right)
    assert (top, height) == pytest.approx((scale * (right.mean() + half) + zero, -2 * scale * half), abs=1.0)
    band = svg.locator("polygon").get_attribute("points")
    edge = np.array([float(pair.split(",")[1]) for pair in band.split(" ")])
    half = stats.t.ppf(0.95, REPLICATES - 1) * errors[: len(samples)]
    assert edge[: len(samples)] == pytest.approx(scale * (ours[: len(samples)] + half) + zero, abs=1.0)
    assert "x 8–15, y 16–23" in page.locator("#convergence figcaption").inner_text()
    assert "the sum is measured" in view("#term=total&pixel=1,1").locator("#convergence").inner_text()


def test_flip_map_is_black_where_nothing_differs_and_bright_where_all_does(view):
    dark = middles(view("#term=direct&beside=flip"), "right").sum(axis=-1)
    other = middles(view("#term=ambient&against=physical&beside=flip"), "right").sum(axis=-1)
    assert dark.mean() < 0.6 * other.mean()


def test_flip_map_is_greyed_where_the_exposure_is_another(view):
    page = view("#term=direct&beside=flip")
    caption, panel = page.locator("#right + figcaption"), page.locator("#right")
    opacity = "(canvas) => Number(getComputedStyle(canvas).opacity)"
    assert "+0.0 EV, sRGB" in caption.inner_text()
    assert panel.evaluate(opacity) == 1
    for change, undo in (("e", "E"), ("g", None)):
        page.locator("h1").click()
        page.keyboard.press(change)
        ready(page)
        assert "not that of the pictures shown" in caption.inner_text()
        assert panel.evaluate(opacity) < 0.5
        if undo:
            page.keyboard.press(undo)
            ready(page)
            assert panel.evaluate(opacity) == 1
    page.get_by_role("group", name="Beside it").get_by_label("signed error").check()
    ready(page)
    assert panel.evaluate(opacity) == 1


def test_keys_and_controls_change_the_view_and_the_address_restores_it(view, context):
    page = view("#term=ambient")
    caption = page.locator("#left + figcaption")

    def shows(text):
        ready(page)
        assert text in caption.inner_text()

    shows("ours, cosine")
    for key, text in (
        ("2", "ours, paper"), ("o", "own limit (ambient times 3.14159)"), ("c", "correct (ambient)"),
        ("p", "physical (ambient physical)"), ("f", "ours, paper"), ("1", "ours, cosine"), ("f", "physical"),
    ):  # fmt: skip
        page.keyboard.press(key)
        shows(text)
    page.get_by_role("button", name="Flip").click()
    shows("ours, cosine")
    page.get_by_role("group", name="Picture").get_by_label("paper").check()
    shows("ours, paper")
    page.get_by_role("group", name="Reference").get_by_label("correct").check()
    page.get_by_role("group", name="Beside it").get_by_label("relative error").check()
    page.get_by_role("slider", name="Exposure").fill("1.5")
    page.get_by_label("Curve").select_option("gamma")
    page.get_by_role("slider", name="Gamma").fill("1.8")
    page.get_by_role("checkbox", name="Split").check()
    page.get_by_role("slider", name="at", exact=True).fill("0.25")
    page.get_by_role("button", name="Zoom in").click()
    page.locator("#left").focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Shift+ArrowDown")
    ready(page)
    seen = page.url.split("#")[1], numbers(page), screen(page, "left"), screen(page, "right")
    again = view(f"#{seen[0]}")
    assert numbers(again) == seen[1]
    for panel, before in (("left", seen[2]), ("right", seen[3])):
        # Focus has changed nothing of what is drawn.
        assert np.array_equal(screen(again, panel), before)
    for key, part in (("e", "ev=2"), ("m", "beside=deviations"), ("s", "at=0.25"), ("t", "term=direct")):
        again.locator("h1").click()
        again.keyboard.press(key)
        ready(again)
        assert part in again.url
    assert "split" not in again.url
    again.get_by_role("button", name="Reset").click()
    ready(again)
    assert again.url.endswith("#")
    again.get_by_text("Keys", exact=True).click()
    again.get_by_label("Single keys act").uncheck()
    again.keyboard.press("e")
    assert again.url.endswith("#")


def test_zoom_and_pan_move_both_panels(view):
    page = view("#term=ambient&beside=reference")
    before = screen(page, "left"), screen(page, "right")
    box = page.locator("#left").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 4, box["y"] + box["height"] / 4)
    page.mouse.wheel(0, -400)
    page.wait_for_function("location.hash.includes('zoom=2')")
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2, steps=4)
    page.mouse.up()
    ready(page)
    # Zoomed by 2 about a quarter, then dragged back by a quarter: what was at 1/8 is at 1/4, now at 1/2, so the
    # corner is in view.
    assert "pixel" not in page.url
    after = screen(page, "left"), screen(page, "right")
    side = before[0].shape[0]
    for old, new in zip(before, after, strict=True):
        assert not np.array_equal(old, new)
        at = ((np.arange(SIZE // 2) + 0.5) * side / SIZE).astype(int)
        assert np.array_equal(old[at][:, at], new[2 * at][:, 2 * at])


def test_a_click_holds_a_pixel(view):
    page = view("#term=ambient")
    box = page.locator("#right").bounding_box()
    place = {"x": box["width"] * 3.5 / SIZE, "y": box["height"] * 2.5 / SIZE}
    page.locator("#right").click(position=place)
    ready(page)
    assert page.url.endswith("pixel=3,2")
    assert numbers(page)["red"][0] == 1234.5
    page.locator("#right").click(position=place)
    ready(page)
    assert "pixel" not in page.url


def test_references_that_a_run_lacks_are_not_offered(view):
    page = view("#term=direct&against=physical")
    assert page.get_by_role("group", name="Reference").get_by_role("radio").count() == 2
    assert (
        "own limit" in page.locator("#inspector caption").inner_text()
        or page.locator("#against input:checked").get_attribute("value") == "own"
    )


@pytest.mark.parametrize(
    "state", ["#term=no&variant=no&beside=no&ev=x&zoom=-4&pixel=99,1", "#pixel=1", "#zoom=1e9&x=1e9", "#=&&"]
)
def test_a_senseless_address_shows_the_start(view, state):
    page = view(state)
    assert numbers(page) == {}
    assert screen(page, "left").any()


def test_missing_pixels_are_named(context, run, tmp_path):
    (tmp_path / "scenes").mkdir()
    copied = tmp_path / "scenes" / f"{SCENE}.viewer.html"
    copied.write_bytes((run / "scenes" / copied.name).read_bytes())
    for name in ("viewer.js", "viewer.css", "style.css"):
        (tmp_path / name).write_bytes((run / name).read_bytes())
    page = opened(context, copied.as_uri()).page
    page.wait_for_selector("#viewer[data-state=failed]")
    assert re.search(r"data/two_cubes/\S+\.js could not be read", page.locator("#status").inner_text())


def test_without_javascript_the_static_pictures_stand(new_context, run):
    page = new_context(java_script_enabled=False, offline=True).new_page()
    page.goto((run / "scenes" / f"{SCENE}.viewer.html").as_uri())
    assert page.locator("#viewer").is_hidden()
    assert page.locator("noscript img").count() == 3 * len(CELLS)


@pytest.mark.slow
def test_a_single_file_holds_every_page(context, run, tmp_path):
    alone = tmp_path / "mailed.html"
    alone.write_bytes(single.write(run).read_bytes())
    (run / "report.html").unlink()
    its = opened(context, alone.as_uri())
    frame = its.page.frame_locator("#page")
    frame.get_by_role("navigation").get_by_role("link", name=SCENES[1]).click()
    frame.locator(".plot .main-svg").first.wait_for()
    assert frame.locator("img").first.evaluate("(image) => image.naturalWidth") == SIZE
    frame.get_by_role("link", name="Look at the pixels").click()
    frame.get_by_role("combobox", name="Term").select_option("ambient")
    frame.locator("#viewer[data-state=ready]").wait_for()
    its.page.keyboard.press("Tab")
    frame.locator("#left").click()
    assert frame.locator("#inspector tbody tr").count() == 4
    frame.get_by_role("slider", name="Exposure").fill("1.5")
    frame.get_by_role("group", name="Picture").get_by_label("paper").check()
    frame.locator("#viewer[data-state=ready]").wait_for()
    link, caption = its.page.url, frame.locator("#left + figcaption").inner_text()
    assert "ours, paper" in caption
    assert its.complaints == []
    again = opened(context, link)
    frame = again.page.frame_locator("#page")
    frame.locator("#viewer[data-state=ready]").wait_for()
    assert frame.locator("#left + figcaption").inner_text() == caption
    assert frame.locator("output[for=ev]").inner_text() == "+1.5 EV"
    assert frame.locator("#inspector tbody tr").count() == 4
    frame.get_by_role("link", name="Verdicts and charts").click()
    frame.locator(".plot .main-svg").first.wait_for()
    again.page.go_back()
    frame.locator("#viewer[data-state=ready]").wait_for()
    assert frame.locator("output[for=ev]").inner_text() == "+1.5 EV"
    assert again.complaints == []


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "width"), [("light", 400), ("dark", 1300)])
@pytest.mark.parametrize("name", ["index.html", "method.html", f"scenes/{SCENE}.html", f"scenes/{SCENE}.viewer.html"])
def test_axe_finds_nothing_serious(new_context, run, name, scheme, width):
    context = new_context(color_scheme=scheme, offline=True, viewport={"width": width, "height": 1000})
    page = opened(context, (run / name).as_uri()).page
    if "viewer" in name:
        ready(page)
    page.add_script_tag(content=AXE.read_text("utf-8"))
    page.evaluate("document.querySelectorAll('details').forEach((each) => { each.open = true; })")
    rules = "{runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa'], rules: {'landmark-unique': {enabled: true}}}"
    found = page.evaluate(f"axe.run(document, {rules})")
    for narrower in (width, 800, 400):
        page.set_viewport_size({"width": narrower, "height": 1000})
        page.wait_for_function("document.documentElement.scrollWidth <= innerWidth")
    assert "landmark-unique" in {each["id"] for each in found["passes"] + found["violations"]}
    serious = [
        each
        for each in found["violations"]
        if each["impact"] in ("serious", "critical") or each["id"] == "landmark-unique"
    ]
    assert [(each["id"], [node["target"] for node in each["nodes"]][:3]) for each in serious] == []


@pytest.mark.slow
def test_panels_of_a_chart_stand_one_above_the_other_where_it_is_narrow(context, run):
    """Side by side their axes' titles ran into each other on a screen of 400 px."""
    page = opened(context, (run / f"scenes/{SCENE}.html").as_uri()).page
    plot = page.locator(".plot:has(.x2title)").first
    for width in (400, 1300, 400):
        page.set_viewport_size({"width": width, "height": 1000})
        page.wait_for_function(
            "([plot, narrow]) => { const at = (name) => plot.querySelector(name).getBoundingClientRect();"
            " const [a, b] = [at('.xtitle'), at('.x2title')];"
            " const [above, beside] = [a.bottom < b.top && a.left < b.right, a.right < b.left && a.bottom > b.top];"
            " return narrow ? above : beside; }",
            arg=[plot.element_handle(), width < 700],
        )
        page.wait_for_function("document.documentElement.scrollWidth <= innerWidth")  # the page's other charts follow
