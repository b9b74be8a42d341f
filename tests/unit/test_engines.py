"""Renderers as commands: what their files may say, what becomes of runs that fail, what is kept, what a probe sees.

The faults are planted into an engine of a few lines, which writes noise without looking at the scene; what is rendered
rightly is rendered by the path tracer of the manual.
"""

import json
import os
import pickle
import signal
import threading
import time
from pathlib import Path
from typing import get_args

import attrs
import numpy as np
import pytest
import trimesh

import termwise
from termwise.reports import cli
from termwise.reports.engines import engine as engines
from termwise.reports.engines import furnaces, probe
from termwise.reports.engines.asked import FEATURES, Asked, lacking, rows
from termwise.reports.engines.engine import EngineError
from termwise.reports.engines.replicates import collected, made, rendered, replicates
from termwise.reports.engines.running import seed_of
from termwise.reports.jobs.executors import InThisProcess
from termwise.reports.judging import engines as judging
from termwise.scenes import analytic, load
from termwise.scenes.exchange import neutral
from termwise.scenes.model import Ambient, Sky
from termwise.scenes.store import ROOT, cache_folder
from termwise.scenes.strict import FileError

FAKE = """
import json, os, random, struct, subprocess, sys, time
scene, output, seed, mode, done = sys.argv[1:]
open(done, "a").write(seed + "\\n")
width, height = json.load(open(scene))["film"]["resolution"]
print("loading", mode)
if mode == "dies":
    sys.exit("no licence is left")
if mode == "meets":
    while len(open(done).read().split()) < 2:  # until another run has begun
        time.sleep(0.01)
if mode == "hangs":
    open(done + ".child", "w").write(str(subprocess.Popen(["sleep", "60"]).pid))
    time.sleep(60)
if mode == "size":
    width += 1
values = [random.Random(0 if mode == "same" else seed).random() for _ in range(3 * width * height)]
if mode == "nan":
    values[3 * (width + 2)] = float("nan")
if mode == "other":
    output += ".pfm"
if mode != "nothing":
    with open(output, "wb") as file:
        file.write(b"PF\\n%d %d\\n-1.0\\n" % (width, height) + struct.pack("<%df" % len(values), *values))
if mode in ("text", "empty"):
    open(output, "w").write("hello" if mode == "text" else "")
if mode == "old":
    os.utime(output, (1e9, 1e9))
if mode == "aborts":
    os.abort()
"""
TOML = """
name = "fake"
command = ["{{python}}", "{{here}}/fake.py", "{{scene}}", "{{output}}", "{{seed}}", "{mode}", "{{here}}/done"]
version = ["{{python}}", "--version"]
output = "{{folder}}/image.pfm"
supports = ["diffuse", "point", "area", "constant-sky", "reflecting-lamp"]
"""
SCENE = Asked.of("box", attrs.evolve(analytic.closed_box(), resolution=(6, 4)), 1)


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of its own for each test."""
    monkeypatch.setenv("TERMWISE_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def fake(folder: Path, mode: str = "fine", more: str = "") -> engines.Engine:
    (folder / "fake.py").write_text(FAKE)
    (folder / "fake.toml").write_text(TOML.format(mode=mode) + more)
    return engines.load(folder / "fake.toml")


def tiny() -> engines.Engine:
    return engines.load(ROOT / "examples" / "tiny_renderer.toml")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('command = "render {scene} {seed}"', "command = 'render {scene} {seed}': allowed is a list"),
        ("command = []", "command"),
        ('command = ["render", "{seed}"]', "lacks {scene}"),
        ('command = ["render", "{scene}"]', "lacks {seed}"),
        ('command = ["render", "{scene}", "{seed}", "{sed}"]', "{sed}: allowed are {python}"),
        ('version = ["render", "{scene}"]', "{scene}: allowed are {python}, {bin}, {here}"),
        ('output = "/etc/passwd"', "output = '/etc/passwd': allowed is a name in {folder}"),
        ('output = "{folder}/../x.exr"', "allowed is a name in {folder}"),
        ('supports = ["difuse"]', "supports[0] = 'difuse': allowed is 'diffuse'"),
        ('scene = "blend"', "scene = 'blend': allowed is 'neutral'"),
        ("timeout_s = 0.0", "timeout_s = 0.0"),
        ("spp = 0", "spp = 0"),
        ("shell = true", "shell = True: unknown key"),
        ('name = "My Engine"', "name"),
    ],
)
def test_a_file_that_is_wrong_is_refused_in_a_line(tmp_path: Path, line: str, words: str):
    path = tmp_path / "mine.toml"
    kept = [each for each in TOML.format(mode="fine").splitlines() if each.split(" =")[0] != line.split(" =")[0]]
    path.write_text("\n".join([*kept, line]))
    with pytest.raises(FileError) as refused:
        engines.load(path)
    assert str(refused.value).startswith(f"{path}: ")
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_an_engine_that_is_nowhere():
    with pytest.raises(FileError, match=r"vray: no such engine: allowed are .*or a path that ends in \.toml"):
        engines.load("vray")


@pytest.mark.parametrize(
    ("mode", "words"),
    [
        ("dies", "exit status 1: allowed is 0; it printed: loading dies | no licence is left"),
        ("nothing", "wrote no image.pfm; it printed: loading nothing"),
        ("other", "wrote no image.pfm, but image.pfm.pfm: name it as `output`"),
        ("size", "image.pfm is 7 x 4 pixels: allowed is 6 x 4, as the scene says"),
        ("nan", "holds 1 values NaN or infinite, the first at pixel (2, 2)"),
        ("old", "image.pfm is older than the run: it is of another one"),
        ("text", "image.pfm: is no image of a kind that can be read"),
        ("empty", "image.pfm: is empty, no image"),
        ("aborts", "was ended by SIGABRT (exit status -6)"),
    ],
)
def test_a_run_that_fails_names_engine_scene_and_seed(tmp_path: Path, mode: str, words: str):
    with pytest.raises(EngineError) as failed:
        rendered(fake(tmp_path, mode), SCENE, spp=1, seed=1, count=4)
    message = str(failed.value)
    assert message.startswith(f"fake: box: seed {seed_of(SCENE.digest, 1, 0)}: ")
    assert words in message
    assert "\n" not in message
    folder = cache_folder() / "engines" / "failed" / "fake"
    assert str(folder) in message
    assert (folder / "scene" / "scene.json").is_file()
    assert "fake.py" in (folder / "command.txt").read_text()


def test_a_run_that_hangs_is_ended_with_what_it_started(tmp_path: Path):
    with pytest.raises(EngineError, match=r"took longer than timeout_s = 2 and was ended; it printed"):
        rendered(fake(tmp_path, "hangs", "timeout_s = 2.0"), SCENE, spp=1, seed=1, count=1)
    child = Path("/proc") / (tmp_path / "done.child").read_text()
    deadline = time.monotonic() + 2.0
    while child.exists() and "Z" not in (child / "stat").read_text().split()[2]:
        assert time.monotonic() < deadline, "what it started is still there"
        time.sleep(0.01)


def test_a_whole_image_counts_where_the_engine_may_die(tmp_path: Path):
    found = rendered(fake(tmp_path, "aborts", "accept_exit = [0, -6]"), SCENE, spp=1, seed=1, count=2)
    assert found.stack.shape == (2, 4, 6, 3)


def test_a_program_that_is_not_here(tmp_path: Path):
    path = tmp_path / "mine.toml"
    path.write_text(TOML.format(mode="fine").replace('command = ["{python}"', 'command = ["no-such-renderer"'))
    with pytest.raises(EngineError, match="fake: command: 'no-such-renderer': no such program is here"):
        rendered(engines.load(path), SCENE, spp=1, seed=1, count=1)


def test_an_environment_that_is_not_installed(tmp_path: Path):
    with pytest.raises(EngineError, match="fake: is not installed: `make engines` puts it into"):
        _ = fake(tmp_path, more='packages = ["no-such-package"]').version


def test_arguments_are_no_shell(tmp_path: Path):
    engine = fake(tmp_path, f"$(touch {tmp_path}/here); `touch {tmp_path}/here` | touch {tmp_path}/here")
    rendered(engine, SCENE, spp=1, seed=1, count=1)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cache", "done", "fake.py", "fake.toml"]


def test_equal_images_of_all_seeds_are_refused(tmp_path: Path):
    first, second = (seed_of(SCENE.digest, 1, number) for number in (0, 1))
    with pytest.raises(EngineError, match=f"fake: box: seeds {first} and {second} give the same image"):
        rendered(fake(tmp_path, "same"), SCENE, spp=1, seed=1, count=3)
    found = rendered(fake(tmp_path, "same", "noiseless = true"), SCENE, spp=1, seed=1, count=3)
    assert len(found.stack) == 1


def test_images_are_kept_by_all_that_decides_them(tmp_path: Path):
    engine = fake(tmp_path)

    def runs(engine: engines.Engine, asked: Asked = SCENE, count: int = 2, spp: int = 1, seed: int = 1) -> int:
        before = len((tmp_path / "done").read_text().split()) if (tmp_path / "done").exists() else 0
        rendered(engine, asked, spp=spp, seed=seed, count=count)
        return len((tmp_path / "done").read_text().split()) - before

    assert runs(engine) == 2
    assert runs(engine) == 0
    assert runs(engine, count=5) == 3  # goes on where it stopped
    assert runs(engine, spp=2) == 2
    assert runs(engine, seed=2) == 2
    assert runs(engine, attrs.evolve(SCENE, depth=2)) == 2
    renamed = attrs.evolve(SCENE, name="other", described=SCENE.described | {"name": "other"})
    assert runs(engine, renamed) == 0
    brighter = SCENE.described | {"lights": [SCENE.described["lights"][0] | {"intensity": [2.0, 1.0, 1.0]}]}
    assert runs(engine, attrs.evolve(SCENE, described=brighter)) == 2
    damaged = next(cache_folder().rglob("*-0000.npz"))
    damaged.write_bytes(damaged.read_bytes()[:-30])
    engines._digest.cache_clear()  # as in another process
    (tmp_path / "fake.py").write_text(FAKE + "\n# changed\n")
    assert runs(engine) == 2


def test_runs_stand_beside_each_other_where_they_may(tmp_path: Path):
    """Each of two waits until the other has begun; one after another they would wait for ever."""
    engine = fake(tmp_path, "meets", "timeout_s = 5.0")
    assert len(rendered(engine, SCENE, spp=1, seed=1, count=2, together=2).stack) == 2


def test_a_run_that_fails_ends_the_others_to_come(tmp_path: Path):
    with pytest.raises(EngineError, match="no licence is left"):
        rendered(fake(tmp_path, "dies"), SCENE, spp=1, seed=1, count=9, together=2)
    assert len((tmp_path / "done").read_text().split()) <= 2


def test_ctrl_c_ends_what_runs(tmp_path: Path):
    """It reaches the main thread, which waits for those that wait for the engine."""
    jobs = replicates(fake(tmp_path, "hangs"), SCENE, spp=1, seed=1, count=2)
    child = tmp_path / "done.child"

    def interrupt() -> None:
        while not (child.exists() and child.read_text()):
            time.sleep(0.01)
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background ignores it
    threading.Thread(target=interrupt, daemon=True).start()
    begin = time.monotonic()
    try:
        with pytest.raises(KeyboardInterrupt):
            list(made(jobs, together=2))
    finally:
        signal.signal(signal.SIGINT, before)
    assert time.monotonic() - begin < 30.0  # it would hang for 60 s


def test_a_damaged_image_is_rendered_again(tmp_path: Path):
    jobs = replicates(fake(tmp_path), SCENE, spp=1, seed=1, count=1)
    rendered(fake(tmp_path), SCENE, spp=1, seed=1, count=1)
    (path,) = jobs[0].files(cache_folder())
    before = collected(jobs, cache_folder()).stack
    path.write_bytes(path.read_bytes()[:-30])
    assert not jobs[0].kept(cache_folder())
    with pytest.raises(EngineError, match="is missing or damaged"):
        collected(jobs, cache_folder())
    assert np.array_equal(rendered(fake(tmp_path), SCENE, spp=1, seed=1, count=1).stack, before)


def test_replicates_are_jobs_of_any_executor(tmp_path: Path):
    jobs = replicates(fake(tmp_path), SCENE, spp=1, seed=1, count=2)
    jobs += replicates(fake(tmp_path, "dies"), SCENE, spp=1, seed=1, count=1)
    outcomes = list(InThisProcess().run(jobs, tmp_path / "there", lambda job: False))
    assert [each.made for each in outcomes] == [True, True, False]
    assert "no licence is left" in str(outcomes[2].error)
    assert [each.kept(tmp_path / "there") for each in jobs] == [True, True, False]
    again = pickle.loads(pickle.dumps(jobs[0])).here()
    assert again.files(tmp_path) == jobs[0].files(tmp_path)


def test_the_probe_of_a_right_renderer_and_of_one_that_paints_noise(tmp_path: Path):
    assert probe.probe(tiny(), threads=1) == ()
    assert len(list(cache_folder().rglob("probes/*.json"))) == 1
    with pytest.raises(EngineError, match="fake: probe: the square of radiance 0.25, 0.5, 1.0 has"):
        probe.probe(fake(tmp_path), threads=1)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda image: image, None),
        (lambda image: image[::-1], "upside down"),
        (lambda image: image[:, ::-1], "flipped left to right"),
        (lambda image: image[::-1, ::-1], "turned by 180°"),
        (lambda image: image[..., ::-1], "the order BGR"),
        (lambda image: np.roll(image, 1, axis=0), "shifted by 1 px down"),
        (lambda image: np.roll(image, (-1, 1), axis=(0, 1)), "shifted by 1 px to the right and 1 px up"),
        (lambda image: np.pi * image, "3.142 = π times as bright"),
        (lambda image: 0.7 * image, "0.7 times as bright"),
        (lambda image: image ** (1 / 2.2), "radiance to the power 0.455"),
        (lambda image: (image + np.roll(image, 1, axis=1) + np.roll(image, -1, axis=1)) / 3, "the mean over its own"),
        (lambda image: np.clip(image, 0.0, 0.6), "has (0.25, 0.5, 0.6)"),
    ],
)
def test_how_an_image_of_the_probe_is_misread(change, words: str | None):
    image, _ = probe.expected()
    fault = probe.misread(change(image))
    assert fault is None if words is None else words in (fault or "")


def test_a_lamp_seen_from_a_corner_of_its_plane_has_howells_form_factor():
    """Howell, "A Catalog of Radiation Heat Transfer Configuration Factors", B-4: from below a corner of a rectangle."""
    x, y = 3.0, 2.0
    corners = np.array([(0.0, 0.0, 1.0), (0.0, y, 1.0), (x, y, 1.0), (x, 0.0, 1.0)])
    p, q = np.hypot(1.0, x), np.hypot(1.0, y)
    expected = (x / p * np.arctan(y / p) + y / q * np.arctan(x / q)) / (2.0 * np.pi)
    assert np.isclose(furnaces.form(np.zeros((1, 3)), corners)[0] / np.pi, expected, rtol=1e-12)


def test_furnaces_are_rendered_rightly_and_a_wrong_albedo_is_found(tmp_path: Path):
    wrong = (ROOT / "examples" / "tiny_renderer.py").read_text().replace("* color[face[on]]", "* 0.8 * color[face[on]]")
    (tmp_path / "tiny_renderer.py").write_text(wrong)
    (tmp_path / "wrong.toml").write_bytes((ROOT / "examples" / "tiny_renderer.toml").read_bytes())
    (once,) = [each for each in furnaces.furnaces() if each.asked.depth == 1]
    for engine, verdict in ((tiny(), "EQUIVALENT"), (engines.load(tmp_path / "wrong.toml"), "BIASED")):
        images = rendered(engine, once.asked, spp=16, seed=1, count=4, threads=1)
        judged = termwise.judge(images.stack, once.exact[None], exact=True, noiseless=True, hint=False)
        assert judged.verdict == verdict


def test_a_furnace_says_how_often_light_may_scatter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Of an engine that ends it, and of none whose surfaces are too dark."""
    (box,) = [each for each in furnaces.furnaces() if each.at_depth and "0.2/0.5/0.8" in each.name]
    monkeypatch.setattr(judging, "furnaces", lambda: [box])
    example = ROOT / "examples" / "tiny_renderer.toml"
    program = example.with_suffix(".py").read_text()
    for name, words, dark in (("ends", ("{depth}", "3"), ""), ("dark", ("", ""), "0.8 * ")):
        (tmp_path / f"{name}.py").write_text(program.replace("* color[face[on]]", f"* {dark}color[face[on]]"))
        told = example.read_text().replace('"tiny"', f'"{name}"').replace("tiny_renderer.py", f"{name}.py")
        (tmp_path / f"{name}.toml").write_text(told.replace(*words))
    subjects = [engines.load(tmp_path / f"{name}.toml") for name in ("ends", "dark")]
    how = judging.Asking(replicates=4, spp=16, threads=1, probed=False)
    ends, dark = (each.judgement for each in judging.furnace(subjects, tmp_path / "out", how).outcomes)
    assert (ends.verdict, dark.verdict) == ("BIASED", "BIASED")
    assert "light scatters 3 times at most" in ends.hints[0].text
    assert not any("scatters" in hint.text for hint in dark.hints)


def test_an_engine_that_fails_leaves_the_other_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    two = [each for each in furnaces.furnaces() if "point" in each.name or each.asked.depth == 1]
    monkeypatch.setattr(judging, "furnaces", lambda: two)
    how = judging.Asking(replicates=4, spp=4, threads=1, probed=False)
    steps: list[tuple[int, int]] = []
    judged = judging.furnace(
        [fake(tmp_path, "dies"), tiny()], tmp_path / "out", how, report=lambda _, done, of: steps.append((done, of))
    )
    assert steps[-1] == (4, 8)  # of a row that failed and one that was rendered; ABSENT ones are no work
    assert [each.word for each in judged.unjudged] == ["ABSENT", "FAILED", "ABSENT"]  # scattering once asks for {depth}
    assert "needs point" in judged.unjudged[2].reason
    assert [each.name for each in judged.outcomes] == [f"tiny: {each.name}" for each in two if each.asked.depth == 1]
    assert judged.failed
    page = (tmp_path / "out" / "index.html").read_text()
    assert "no licence is left" in page
    assert json.loads((tmp_path / "out" / "results.json").read_text())["unjudged"][1]["word"] == "FAILED"


def test_a_furnace_by_command_says_what_failed_in_a_line_and_writes_its_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    path = fake(tmp_path, "dies").path
    monkeypatch.setattr("sys.argv", ["termwise", "furnace", "--engine", str(path), "--out", str(tmp_path / "out")])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    said = capsys.readouterr()
    assert ended.value.code == 2
    (line,) = said.err.splitlines()
    assert line.startswith("termwise: fake: probe: seed 1: exit status 1")
    assert str(tmp_path / "out" / "furnace" / "index.html") in said.out
    assert "no licence is left" in (tmp_path / "out" / "furnace" / "index.html").read_text()


def test_an_engine_in_python(tmp_path: Path):
    found = termwise.engine(fake(tmp_path).path)
    assert repr(found) == f"<engine fake: {tmp_path / 'fake.toml'}>"
    scene = SCENE.scene
    image = found.render(scene, samples=3, replicates=2, seed=4, probe=False)
    assert image.images is not None
    assert (image.samples, image.replicates, image.images.shape) == (3, 2, (2, 4, 6, 3))
    assert np.array_equal(image.mean, image.images.mean(axis=0, dtype=np.float64))
    with pytest.raises(EngineError, match="fake: probe: the square"):
        found.render(scene)


def test_render_by_command_takes_a_scene_without_gloss_and_the_samples_of_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    for name in ("tiny_renderer.py", "tiny_renderer.toml"):
        (tmp_path / name).write_text((ROOT / "examples" / name).read_text().replace("spp = 16", "spp = 3"))
    words = ["render", "cornell_box", "--engine", str(tmp_path / "tiny_renderer.toml"), "--resolution", "6", "4"]
    words += ["--out", str(tmp_path / "out"), "--json"]
    with pytest.raises(EngineError, match="the scene needs glossy"):
        cli.app(words, exit_on_error=False, result_action="return_value")
    capsys.readouterr()
    assert cli.app([*words, "--diffuse"], exit_on_error=False, result_action="return_value") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["settings"]["samples"] == 3
    assert min(found["terms"]["total"]["mean"]) > 0.0


def test_samples_have_the_name_that_they_have_beside_engines():
    for name in ("--samples", "--spp"):
        _, bound, _ = cli.app.parse_args(["render", "monkey", name, "3"], exit_on_error=False)
        assert bound.arguments["samples"] == 3


def test_a_term_is_a_scene_less_what_shines_in_it():
    monkey = load.load("monkey")
    total, ambient, first, every = rows(monkey)
    assert [len(row.parts) for row in (total, ambient, first, every)] == [1, 2, 1, 1]  # a point light is not seen
    (_, lit), (sign, shines) = ambient.parts
    assert (lit.depth, sign) == (1, -1)
    assert lit.described["sky"] == {"type": "constant", "radiance": list(monkey.ambient.color)}
    assert lit.described["lights"] == []
    weights = [list(monkey.diffuse_weight(each.material)) for each in monkey.objects]
    assert np.allclose([each["material"]["color"] for each in lit.described["objects"]], weights, rtol=1e-12)
    assert not any(any(each["material"]["color"]) for each in shines.described["objects"])
    assert (first.parts[0][1].depth, every.parts[0][1].depth) == (1, None)
    assert every.parts[0][1].described["sky"] is None
    box = load.load("cornell_box")
    assert "range, 2" in (rows(box)[1].absent or "")
    assert rows(attrs.evolve(box, ambient=Ambient()))[1].absent == "the ambient light is black"
    assert [len(row.parts) for row in rows(box)[2:]] == [2, 2]  # its lamp is
    assert "ignore = 'object'" in (rows(attrs.evolve(box, ignore="object"))[0].absent or "")


def test_what_a_scene_needs_and_an_engine_has_not(tmp_path: Path):
    engine = fake(tmp_path)
    monkey = load.load("monkey")
    assert lacking(engine, SCENE) == "its command has no {depth}"
    assert lacking(engine, attrs.evolve(SCENE, depth=None)) is None
    assert "needs glossy," in (lacking(engine, Asked.of("monkey", monkey)) or "")
    textured = attrs.evolve(monkey, sky=Sky(texture=np.ones((2, 4, 3), np.float32)))
    assert "glossy, image-sky," in (lacking(engine, Asked.of("monkey", textured)) or "")


def test_a_renderer_of_direct_light_is_judged_where_light_scatters_once(tmp_path: Path):
    """And says what it is asked beyond: it needs no {depth}, and without it a depth is refused by name."""
    direct = fake(tmp_path, more="max_depth = 1")
    free = attrs.evolve(SCENE, depth=None)
    assert lacking(direct, SCENE) is None
    assert lacking(direct, free) == "its light scatters any number of times, and its file says max_depth = 1"
    assert (
        lacking(direct, attrs.evolve(SCENE, depth=2)) == "its light scatters 2 times, and its file says max_depth = 1"
    )
    assert lacking(direct, attrs.evolve(free, enough=1)) is None
    monkey = neutral.diffuse(load.load("monkey"))
    said = {row.name: {lacking(direct, part) for _, part in row.parts} for row in rows(monkey)}
    assert said["direct"] == said["ambient"] == {None}
    assert all("max_depth = 1" in (each or "") for name in ("total", "direct all") for each in said[name])
    judged = {each.name: lacking(direct, each.asked) for each in furnaces.furnaces()}
    assert {name for name, lacks in judged.items() if lacks is None} == {
        each.name for each in furnaces.furnaces() if each.asked.enough == 1 or each.asked.depth == 1
    }
    with pytest.raises(FileError, match=r"depth = 1: is unused, for command lacks \{depth\}: allowed is max_depth"):
        fake(tmp_path, more="depth = 1")


def test_a_renderer_without_shadow_rays_is_found(tmp_path: Path):
    """The exact image of the shadow against itself, and against the lit plate that such a renderer sees."""
    shaded, lit = (
        next(each for each in furnaces.furnaces() if each.name.startswith(name)) for name in ("plate", "point")
    )
    traced = np.zeros_like(shaded.exact)
    light = np.array(shaded.asked.scene.lights[0].position)  # type: ignore[union-attr]
    width, height = shaded.asked.resolution
    y, x = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    ways = shaded.asked.scene.camera.rays(np.stack([x, y], axis=-1).reshape(-1, 2), aspect=width / height)
    origin = np.array(shaded.asked.scene.camera.position)
    points = origin - (origin[2] / ways[:, 2])[:, None] * ways
    plate, blocker = (trimesh.Trimesh(each.mesh.vertices, each.mesh.faces) for each in shaded.asked.scene.objects)
    assert plate.ray.intersects_any(np.tile(origin, (len(ways), 1)), ways).all()
    assert not blocker.ray.intersects_any(np.tile(origin, (len(ways), 1)), ways).any()
    free = ~blocker.ray.intersects_any(points, light - points).reshape(height, width)
    traced[free] = lit.exact[free]
    np.testing.assert_allclose(traced, shaded.exact, rtol=1e-12)
    assert free.any()
    assert not free.all()
    stack = np.repeat(lit.exact[None], 4, axis=0)
    assert termwise.judge(stack, shaded.exact[None], exact=True, noiseless=True, hint=False).verdict == "BIASED"


def test_environment_of_an_adapter_has_no_path_of_ours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("PYTHONPATH", "/somewhere")
    assert fake(tmp_path).variables()["PYTHONPATH"] == "/somewhere"
    assert "PYTHONPATH" not in fake(tmp_path, more='packages = ["x"]').variables()
    assert os.environ["PYTHONPATH"] == "/somewhere"


def test_the_manual_says_every_field_place_and_feature_and_prints_the_example():
    manual = (ROOT / "docs" / "engines.md").read_text("utf-8")
    for field in attrs.fields(engines.EngineFile):
        assert f"`{field.name}`" in manual, field.name
    for name in (*(f"{{{place}}}" for place in engines.PLACES), *FEATURES, *engines.shipped()):
        assert f"`{name}`" in manual, name
    assert set(get_args(engines.Feature)) == set(FEATURES)
    for file in ("tiny_renderer.py", "tiny_renderer.toml"):
        assert f"{{literalinclude}} ../examples/{file}" in manual
        assert (ROOT / "examples" / file).is_file()
