"""The command as its user meets it: bad input is one line on standard error and exit status 2, never a traceback."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import OpenEXR
import pytest

from termwise.reports import cli
from termwise.reports.results.exr import read_exr, write_exr
from termwise.scenes.terms import TERMS

SCENE = """
[camera]
position = [0, -4, 1]
target = [0, 0, 0]

[ambient]
color = [1, 1, 1]

[[objects]]
shape = "box"
name = "box"
size = [1, 1, 1]
"""


class Outcome(NamedTuple):
    """What a command left: its exit status, lines on standard error, and standard output."""

    status: Any
    messages: list[str]
    output: str


Command = Callable[..., Outcome]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Command:
    """A function: the command `termwise ...` in this process and an empty folder."""
    monkeypatch.chdir(tmp_path)
    Path("scene.toml").write_text(SCENE)
    Path("cloud.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
        "end_header\n0 0 0\n"
    )
    Path("no.ply").write_text("this is not a mesh\n")
    Path("file").write_text("not a folder\n")

    def command(*arguments: Any) -> Outcome:
        monkeypatch.setattr("sys.argv", ["termwise", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        captured = capsys.readouterr()
        return Outcome(ended.value.code, captured.err.splitlines(), captured.out)

    return command


def refused(outcome: Outcome, *named: str) -> None:
    """Assert exit status 2, nothing on standard output, and one line that holds the words."""
    assert outcome.status == 2
    assert outcome.output == ""
    assert len(outcome.messages) == 1, outcome.messages
    (message,) = outcome.messages
    assert message.startswith("termwise: ")
    assert "Traceback" not in message
    for words in named:
        assert words in message


SMALL = "--samples", 1, "--resolution", 4, 4


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["glow"], ["glow", "compare", "judge"]),
        (["plan"], ["--scene", "requires an argument"]),
        (["plan", "nosuch"], ["nosuch", "monkey", "two_cubes", ".toml"]),
        (["plan", "missing.toml"], ["missing.toml", "No such file"]),
        (["plan", "file"], ["file", "allowed are"]),
        (["plan", "."], ["allowed are"]),
        (["plan", "scene.toml", "--glow"], ["--glow"]),
        (["render", "nosuch"], ["nosuch", "allowed are"]),
        (["render", "scene.toml", "--samples", 0], ["samples = 0", "at least 1"]),
        (["render", "scene.toml", "--samples", -3], ["samples = -3", "at least 1"]),
        (["render", "scene.toml", "--samples", "many"], ["--samples", "'many'", "an integer"]),
        (["render", "scene.toml", "--samples", 1.5], ["--samples", "'1.5'", "an integer"]),
        (["render", "scene.toml", "--replicates", 0], ["replicates = 0", "at least 1"]),
        (["render", "scene.toml", "--threads", 0], ["threads = 0", "at least 1"]),
        (["render", "scene.toml", "--seed", -1], ["seed = -1", "[0, "]),
        (["render", "scene.toml", "--seed", 2**64], [f"seed = {2**64}", "[0, "]),
        (["render", "scene.toml", "--resolution", 0, 4], ["resolution = (0, 4)", "[1, 65536]"]),
        (["render", "scene.toml", "--resolution", 4], ["--resolution = 4", "allowed are 2 values"]),
        (["render", "scene.toml", "--term", "glow"], ["term = 'glow'", "ambient", "specular"]),
        (["render", "scene.toml", "--variant", "paper"], ["variant = 'paper'", "--term"]),
        (["render", "scene.toml", "--term", "ambient", "--variant", "glow"], ["variant = 'glow'", "cosine", "paper"]),
        (["render", "scene.toml", *SMALL, "--out", "file"], ["file/render", "is a file"]),
        (["render", "scene.toml", *SMALL, "--out", "/dev/full"], ["/dev/full/render", "is a file"]),
        (["reference", "scene.toml", "--spp", 0], ["spp = 0", "at least 1"]),
        (["reference", "scene.toml", "--replicates", 0], ["replicates = 0", "at least 1"]),
        (["reference", "scene.toml", "--seed", -1], ["seed = -1", "[0, "]),
        (["reference", "scene.toml", "--term", "glow"], ["term = 'glow'", "ambient"]),
        (["reference", "scene.toml", "--backend", "glow"], ["'glow'", "llvm_ad_rgb", "scalar_rgb"]),
        (["reference", "scene.toml", "--out", "file"], ["file/reference", "is a file"]),
        (["compare", "nosuch"], ["nosuch", "allowed are"]),
        (["compare", "monkey", "monkey"], ["'monkey'", "twice"]),
        (["compare", "--study", "nosuch"], ["nosuch", "full, quick, standard"]),
        (["compare", "--study", "missing.toml"], ["missing.toml", "No such file"]),
        (["compare", "--study", "scene.toml"], ["scene.toml", "unknown key", "resolution"]),
        (["compare", "--backend", "glow"], ["'glow'", "llvm_ad_rgb"]),
        *(
            (["compare", "monkey", "--budget", budget], ["--budget", f"'{budget}'", "90, 90s, 2m or 1h"])
            for budget in ("soon", "0", "0s", "1d", "nan", "2 m", "m", "1e400", "1h30m", "9" * 400)
        ),
        (["compare", "monkey", "--budget=-5"], ["--budget", "'-5'", "90, 90s, 2m or 1h"]),
        (["compare", "monkey", "--study", "quick", "--out", "file"], ["file/compare", "is a file"]),
        (["compare", "--seed", -1], ["seed = -1", "[0, "]),
        (["compare", "--seed", 1.5], ["--seed", "'1.5'", "an integer"]),
        (["compare", "monkey", "--engine", "ours", "--budget", 9], ["budget: allowed without --engine"]),
        (["compare", "monkey", "--engine", "ours", "--engine", "ours"], ["engine: 'ours'", "twice"]),
        (["compare", "monkey", "--engine", "ours", "--seed", -1], ["seed = -1", "[0, "]),
        (["compare", "monkey", "--engine", "ours", "--row", "glow"], ["row = 'glow'", "total, ambient, direct"]),
        (["furnace"], ["engine: none given", "--engine"]),
        (["furnace", "--engine", "vray"], ["vray: no such engine", "mitsuba", ".toml"]),
        (["furnace", "--engine", "missing.toml"], ["missing.toml", "No such file"]),
        (["furnace", "--engine", "scene.toml"], ["scene.toml", "unknown key", "command"]),
        (["furnace", "--engine", "ours", "--replicates", 3], ["replicates = 3", "at least 4"]),
        (["furnace", "--engine", "ours", "--out", "file"], ["file/furnace", "is a file"]),
        (["judge", "--engine", "ours"], ["engine: allowed is --engine with --scene"]),
        (["judge", "--scene", "monkey"], ["images: none given", "--engine"]),
        (["judge", "file", "--scene", "monkey", "--reference", "file"], ["scene: allowed without --reference"]),
        (["judge", "file", "--scene", "monkey", "--resolution", 4, 4], ["resolution: allowed with --engine alone"]),
        (["render", "scene.toml", "--engine", "ours", "--term", "ambient"], ["engine: allowed without --term"]),
        (["render", "scene.toml", "--engine", "nosuch"], ["nosuch: no such engine"]),
        (["diff", "missing", "missing"], ["missing", "no such file", "termwise compare"]),
        (["diff", "file", "file"], ["file", "cut short or no JSON"]),
        (["diff", "."], ["--run-b"]),
        (["figure", "missing", "--scene", "a", "--term", "direct", "--out", "a.pdf"], ["missing", "no such"]),
        (
            ["figure", ".", "--scene", "a", "--term", "direct", "--kind", "pie", "--out", "a.pdf"],
            ["--kind", "pie", "waterfall"],
        ),
        (["judge"], ["--reference"]),
        (["judge", "--reference", "scene.toml"], ["images: none given", "folders"]),
        (["judge", "missing.exr", "--reference", "missing.exr"], ["missing.exr", "no such file"]),
        (["judge", ".", "--reference", "."], [".", "holds no image", ".exr", "folders"]),
        (["judge", "scene.toml", "--reference", "scene.toml"], ["scene.toml", "no image of a kind", "allowed"]),
    ],
    ids=lambda value: " ".join(map(str, value)) if value and isinstance(value[0], str) else None,
)
def test_bad_arguments(arguments: list[Any], named: list[str], run: Command):
    refused(run(*arguments), *named)


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("[camera]", "[camera", ["is not TOML", "line 2"]),
        (SCENE, "", ["camera: is missing"]),
        ("[ambient]", "[ambience]", ["ambience", "unknown key", "ambient"]),
        ("[ambient]", "[ambient]\nglow = 1", ["ambient.glow = 1", "unknown key", "range"]),
        ("color = [1, 1, 1]", "color = [1, nan, 1]", ["ambient", "color = (1.0, nan, 1.0)", "[0, inf)"]),
        ("color = [1, 1, 1]", "color = [1, inf, 1]", ["ambient", "color = (1.0, inf, 1.0)", "[0, inf)"]),
        ("color = [1, 1, 1]", "color = [1, -1, 1]", ["ambient", "color = (1.0, -1.0, 1.0)", "[0, inf)"]),
        ("color = [1, 1, 1]", "color = [1, 1]", ["ambient.color = [1, 1]", "a list of 3"]),
        ("color = [1, 1, 1]", 'color = "white"', ["ambient.color = 'white'", "a list of 3"]),
        ("color = [1, 1, 1]", "range = 0", ["ambient", "range = 0.0", "(0, inf]"]),
        ("position = [0, -4, 1]", "position = [0, 0, 0]", ["camera", "target = (0.0, 0.0, 0.0)", "position"]),
        ("position = [0, -4, 1]", "position = [0, 0, 1]", ["camera", "up = ", "parallel"]),
        ("position = [0, -4, 1]", "", ["camera.position: is missing"]),
        ("[camera]", "[camera]\nfov = 180", ["camera", "fov = 180.0", "(0, 180)"]),
        ("[camera]", '[camera]\npixel = "middle"', ["camera.pixel = 'middle'", "'corner' or 'centre' or 'jitter'"]),
        ("size = [1, 1, 1]", "size = [1, 0, 1]", ["objects[0]", "size = (1.0, 0.0, 1.0)", "(0, inf)"]),
        ("size = [1, 1, 1]", "", ["objects[0]", "size: is missing"]),
        ('shape = "box"', 'shape = "torus"', ["objects[0]", "'torus'", "rectangle, box, sphere, mesh"]),
        ('name = "box"', 'name = "box"\ngloss = 1.2', ["objects[0]", "gloss = 1.2", "[0, 1]"]),
        ('name = "box"', 'name = "box"\nroughness = -0.1', ["objects[0]", "roughness = -0.1", "[0.0001, 1.5]"]),
        ('name = "box"', "name = 3", ["objects[0].name = 3", "a string"]),
        ("[camera]", "max_bounces = -1\n[camera]", ["max_bounces = -1", "[0, 64]"]),
        ("[camera]", "max_bounces = 1.0\n[camera]", ["max_bounces = 1.0", "an integer"]),
        ("[camera]", "draw_lights = 1\n[camera]", ["draw_lights = 1", "true or false"]),
        ("[camera]", "resolution = [0, 4]\n[camera]", ["resolution = (0, 4)", "[1, 65536]"]),
        ("[camera]", "exposure = 0\n[camera]", ["exposure = 0", "(0, inf)"]),
        ("[camera]", 'scope = "second-hit"\n[camera]', ["scope = 'second-hit'", "'first-hit' or 'all'"]),
        ("[camera]", "[photons]\ncount = 0\n[camera]", ["photons", "count = 0", "[1, "]),
        ("[camera]", '[sky]\ntexture = "no.exr"\n[camera]', ["sky", "'no.exr'", "no such file"]),
        ("[camera]", '[sky]\ntexture = "no.ply"\n[camera]', ["sky", "'no.ply'", "no image of a kind"]),
        *(
            ('shape = "box"\nname = "box"\nsize = [1, 1, 1]', f'shape = "mesh"\nname = "box"\nfile = "{file}"', named)
            for file, named in (
                ("none.ply", ["'box'", "'none.ply'", "no such file"]),
                ("no.ply", ["'box'", "'no.ply'"]),
                ("cloud.ply", ["'box'", "cloud.ply"]),
                ("scene.toml", ["'box'", "'scene.toml'", ".ply, .obj, .stl or .glb"]),
            )
        ),
        (SCENE, SCENE + SCENE[SCENE.index("[[") :], ["objects", "'box'", "twice"]),
    ],
)
def test_bad_scene(old: str, new: str, named: list[str], run: Command):
    assert old in SCENE
    Path("scene.toml").write_text(SCENE.replace(old, new))
    refused(run("plan", "scene.toml"), "scene.toml: ", *named)


def test_scene_that_is_a_folder_or_not_text(run: Command):
    Path("folder.toml").mkdir()
    refused(run("plan", "folder.toml"), "folder.toml", "Is a directory")
    Path("binary.toml").write_bytes(b"\xff\xfe\x00")
    refused(run("plan", "binary.toml"), "binary.toml", "is not TOML")


@pytest.mark.parametrize("command", [["scenes"], ["plan", "scene.toml"]], ids=lambda command: command[0])
def test_json_is_the_one_object_on_standard_output(command: list[str], run: Command):
    outcome = run(*command, "--json")
    assert outcome.status == 0
    assert outcome.messages == []
    assert isinstance(json.loads(outcome.output), dict)
    assert run(*command).status == 0


def test_version_and_help(run: Command):
    import importlib.metadata

    assert run("--version").output.strip() == importlib.metadata.version("termwise")
    shown = run("--help")
    assert shown.status == 0
    for command in ("compare", "diff", "figure", "judge", "render", "reference", "plan", "scenes"):
        assert command in shown.output


def test_render_writes_its_terms_and_their_sum(run: Command):
    outcome = run("render", "scene.toml", "--samples", 2, "--resolution", 5, 4, "--json")
    assert outcome.status == 0
    result = json.loads(outcome.output)
    parts = read_exr(Path("out/render/scene.exr"))
    assert list(parts) == [*TERMS, "total"]
    assert all(image.shape == (4, 5, 3) for image in parts.values())
    assert parts["ambient"].any()
    np.testing.assert_array_equal(parts["total"], parts["ambient"])  # no light, no gloss, no sky
    np.testing.assert_allclose(result["terms"]["ambient"]["mean"], parts["ambient"].mean(axis=(0, 1)), rtol=1e-6)
    assert [Path(name).is_file() for name in result["files"]] == [True, True]


def test_equal_seeds_give_equal_bits_for_any_number_of_threads(run: Command):
    for out, seed, threads in (("a", 3, 1), ("b", 3, 2), ("c", 4, 1)):
        arguments = *SMALL, "--term", "ambient", "--seed", seed, "--threads", threads, "--out", out
        assert run("render", "scene.toml", *arguments).status == 0
    a, b, c = (read_exr(Path(f"{out}/render/scene.exr"))["ambient"] for out in "abc")
    np.testing.assert_array_equal(a, b)
    assert not np.array_equal(a, c)


# judge: replicates of any renderer, from files.


@pytest.fixture
def replicates(run: Command) -> Callable[..., list[str]]:
    """A function: files of replicates of a gradient with gamma noise, ours or the reference's."""

    def write(
        name: str, *, seed: int, count: int = 16, gain: float = 1.0, size: int = 32, noise: float = 0.2
    ) -> list[str]:
        rng, files = np.random.default_rng(seed), []
        truth = gain * np.linspace(0.5, 1.5, size)[:, None] * np.array([1.0, 0.7, 0.4])
        for k in range(count):
            factor = rng.gamma(1 / noise**2, noise**2, (size, size, 1))
            files.append(f"{name}_{k:02d}.exr")
            write_exr(Path(files[-1]), {"image": truth * factor}, {})
        return files

    return write


def test_judge_says_equivalent(run: Command, replicates: Callable[..., list[str]]):
    ours, reference = replicates("ours", seed=1, noise=0.1), replicates("ref", seed=2, noise=0.1)
    outcome = run("judge", *ours, "--reference", *reference, "--json")
    assert outcome.status == 0
    assert outcome.messages == []
    verdict = json.loads(outcome.output)
    assert verdict["verdict"] == "EQUIVALENT"
    assert verdict["bias_low"] <= verdict["bias"] <= verdict["bias_high"]
    shown = run("judge", *ours, "--reference", *reference)
    assert shown.output.startswith("EQUIVALENT: agrees: off by ")
    assert shown.status == 0


def test_judge_takes_folders_and_writes_a_page(run: Command, replicates: Callable[..., list[str]]):
    for folder, seed, gain in (("mine", 1, 1.0), ("ref", 2, 1.0), ("dim", 3, 0.9)):
        Path(folder).mkdir()
        for name in replicates("x", seed=seed, gain=gain):
            Path(name).rename(f"{folder}/{name}")
    shown = run("judge", "mine", "--reference", "ref")
    assert shown.status == 0
    assert "tiles of 8 px: 0 of 16 found by Holm" in shown.output
    assert shown.output.splitlines()[-1] == f"Report: {Path('out/judge/index.html').resolve()}"
    outcome = run("judge", "dim", "--reference", "ref", "--exposure", 2, "--out", "there", "--json")
    assert outcome.status == 1
    verdict = json.loads(outcome.output)
    results = json.loads(Path("there/judge/results.json").read_text())
    assert results["verdict"] | {"page": "there/judge/index.html", "status": 1, "require": "unbiased"} == verdict
    assert results["settings"]["exposure"] == 2
    assert [size["side"] for size in verdict["tiles"]] == [8, 16, 32]
    assert verdict["tiles"][0]["holm"] == 16
    text = Path(verdict["page"]).read_text("utf-8")
    assert "Relative bias of the mean luminance" in text
    assert "p-map" in text
    for name in ("ours", "reference", "error", "tiles-p-map-8", "tiles-p-map-16", "tiles-p-map-32"):
        assert f"pictures/{name}.png" in text
        assert Path(f"there/judge/pictures/{name}.png").is_file()
    images = read_exr(Path("there/judge/images.exr"))
    np.testing.assert_allclose(images["error"], images["ours"] - images["reference"], atol=1e-6)
    mean = np.mean([next(iter(read_exr(path).values())) for path in sorted(Path("dim").iterdir())], axis=0)
    np.testing.assert_allclose(images["ours"], mean, rtol=1e-5)
    refused(run("judge", "mine", "--reference", "ref", "--exposure", 0), "exposure = 0", "(0, inf)")


def test_judge_of_a_renderer_without_noise(run: Command, replicates: Callable[..., list[str]]):
    (image,), reference = replicates("ours", seed=1, count=1, noise=1e-6), replicates("ref", seed=2)
    copies = [image] * 4
    refused(run("judge", *copies, "--reference", *reference), "ours", "same image", "equal seeds", "--noiseless")
    outcome = run("judge", *copies, "--reference", *reference, "--noiseless", "--json")
    assert outcome.status == 0
    assert any("free of noise" in line for line in outcome.messages)


def test_judge_of_nothing_is_absent(run: Command, replicates: Callable[..., list[str]]):
    black = replicates("black", seed=1, count=4, gain=0.0, size=9)
    outcome = run("judge", *black, "--reference", *replicates("none", seed=2, count=4, gain=0.0, size=9), "--json")
    assert (outcome.status, json.loads(outcome.output)["verdict"]) == (0, "ABSENT")
    assert "p-map" not in Path("out/judge/index.html").read_text("utf-8")


def test_judge_says_biased(run: Command, replicates: Callable[..., list[str]]):
    ours, reference = replicates("ours", seed=1, gain=1.03), replicates("ref", seed=2)
    outcome = run("judge", *ours, "--reference", *reference, "--json")
    assert outcome.status == 1
    verdict = json.loads(outcome.output)
    assert verdict["verdict"] == "BIASED"
    assert verdict["family_low"] > 0.001
    assert verdict["family_low"] < 0.03 < verdict["family_high"]


def test_judge_says_underpowered(run: Command, replicates: Callable[..., list[str]]):
    ours = replicates("ours", seed=1, count=4, size=8, noise=1.0)
    reference = replicates("ref", seed=2, count=4, size=8, noise=1.0)
    outcome = run("judge", *ours, "--reference", *reference, "--json")
    assert outcome.status == 0
    assert json.loads(outcome.output)["verdict"] == "UNDERPOWERED"
    (line,) = outcome.messages
    assert "4 of ours and 4 of the reference: fewer than 16" in line


def test_judge_with_an_exact_reference(run: Command, replicates: Callable[..., list[str]]):
    ours, exact = replicates("ours", seed=1), replicates("exact", seed=2, count=1, noise=1e-6)
    outcome = run("judge", *ours, "--reference", *exact, "--reference-exact", "--json")
    verdict = json.loads(outcome.output)
    assert (outcome.status, verdict["verdict"]) == (0, "EQUIVALENT")
    assert "taken as exact" in verdict["sentence"]
    refused(run("judge", *ours, "--reference", *exact), "reference: 1 replicate", "--reference-exact")
    two = replicates("two", seed=3, count=2)
    refused(run("judge", *ours, "--reference", *two, "--reference-exact"), "reference: 2 images", "one image")


def test_judge_refuses(run: Command, replicates: Callable[..., list[str]]):
    ours, reference = (replicates("ours", seed=1, count=4, size=12), replicates("ref", seed=2, count=4, size=12))
    wide = replicates("wide", seed=3, count=4, size=16)
    refused(run("judge", *ours[:3], "--reference", *reference), "ours: 3 replicates", "at least 4")
    refused(run("judge", ours[0], "--reference", *reference), "ours: 1 replicate", "seed of its own")
    refused(run("judge", *ours, "--reference", *reference[:3]), "reference: 3 replicates", "at least 4")
    refused(run("judge", *ours, "--reference", *wide), ours[0], "12 x 12", wide[0], "16 x 16")
    refused(run("judge", *ours[:3], wide[0], "--reference", *reference), wide[0], "16 x 16", ours[0])
    refused(run("judge", *ours, ours[2], "--reference", *reference), ours[2], "same image", "equal seeds")
    refused(run("judge", *ours, "--reference", *ours), ours[0], "same files")


def test_judge_and_invalid_pixels(run: Command, replicates: Callable[..., list[str]]):
    ours, reference = (replicates("ours", seed=1, count=4, size=12), replicates("ref", seed=2, count=4, size=12))
    (image,) = read_exr(Path(ours[1])).values()
    image[5, 7, 2] = np.nan
    write_exr(Path(ours[1]), {"image": image}, {})
    outcome = run("judge", *ours, "--reference", *reference, "--json")
    assert outcome.status == 1
    verdict = json.loads(outcome.output)
    assert verdict["verdict"] == "BIASED"
    assert "blue is nan at x 7, y 5" in verdict["reasons"][0]
    refused(run("judge", *reference, "--reference", *ours), ours[1], "blue is nan at x 7, y 5", "finite")


def test_judge_names_layers_for_each_side(run: Command):
    rng = np.random.default_rng(4)
    sides: dict[str, list[str]] = {"ours": [], "reference": []}
    lines = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    for k in range(8):
        beauty, other = rng.gamma(25, 0.04, (2, 12, 12, 3)).astype(np.float32)
        layers = (
            {"ViewLayer.Combined": beauty, "ViewLayer.Albedo": 3 * other} if k < 4 else {"rgba": beauty, "n": other}
        )
        channels = {
            f"{name}.{letter}": pixels[..., at].copy()
            for name, pixels in layers.items()
            for at, letter in enumerate("RGB" if k < 4 else "rgb")
        }
        OpenEXR.File(dict(lines), channels).write(f"{k}.exr")
        sides["ours" if k < 4 else "reference"].append(f"{k}.exr")
    judge = ["judge", *sides["ours"], "--reference", *sides["reference"]]
    refused(run(*judge), "0.exr", "'ViewLayer.Albedo', 'ViewLayer.Combined'", "--layer")
    refused(run(*judge, "--layer", "Combined"), "4.exr", "'n', 'rgba'", "--reference-layer")
    refused(run(*judge, "--layer", "glow"), "0.exr", "layer = 'glow'", "'ViewLayer.Albedo'")
    assert run(*judge, "--layer", "Combined", "--reference-layer", "rgba").status == 0
    assert run(*judge, "--layer", "Albedo", "--reference-layer", "rgba").status == 1


def test_judge_places_crops_where_they_belong(run: Command):
    """Equal crops of a picture at other places are no equal images, and the note stands with the verdict."""
    rng = np.random.default_rng(4)
    window = {"type": OpenEXR.scanlineimage, "displayWindow": ((0, 0), (31, 31))}
    names: dict[int, list[str]] = {0: [], 10: []}
    for at, files in names.items():
        for k in range(4):
            files.append(f"{at}_{k}.exr")
            placed = {**window, "dataWindow": ((at, at), (at + 15, at + 15))}
            OpenEXR.File(placed, {"RGB": rng.gamma(25, 0.04, (16, 16, 3)).astype(np.float32)}).write(files[-1])
    outcome = run("judge", *names[0], "--reference", *names[10], "--json")
    assert outcome.status == 1
    assert json.loads(outcome.output)["verdict"] == "BIASED"
    assert "0_0.exr and 3 more: 768 pixels outside its data window are black" in outcome.messages[0]
    assert "768 pixels outside its data window" in Path("out/judge/index.html").read_text("utf-8")


def test_half_floats_against_floats_are_no_bias(run: Command):
    """Rounding moves each value of a quiet image the same way in all replicates: Holm found it in places, at 1e-5."""
    rng, y = np.random.default_rng(0), np.linspace(0.0, 1.0, 64)
    truth = np.stack(np.broadcast_arrays(0.5 + y, 0.3 + y[:, None], 0.4 + y * y[:, None]), axis=-1)
    lines = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    for folder, kind, noise in (("half", np.float16, 1e-4), ("float", np.float32, 1e-6)):
        Path(folder).mkdir()
        for k in range(16):
            pixels = (truth * (1 + noise * rng.standard_normal(truth.shape))).astype(kind)
            OpenEXR.File(dict(lines), {"RGB": pixels}).write(f"{folder}/{k}.exr")
    outcome = run("judge", "half", "--reference", "float", "--json")
    verdict = json.loads(outcome.output)
    assert verdict["verdict"] == "EQUIVALENT"
    assert [size["holm"] for size in verdict["tiles"]] == [0, 0, 0]
    assert "half/0.exr and 15 more: half floats: a value is known to 0.05%" in " ".join(outcome.messages)


def test_judge_needs_colour(run: Command):
    pixels = np.zeros((4, 4), np.float32)
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Z": pixels}).write("depth.exr")
    refused(run("judge", "depth.exr", "--reference", "depth.exr"), "depth.exr", "no colour")


@pytest.mark.parametrize(
    ("text", "seconds"), [("90", 90), ("90s", 90), ("2m", 120), ("1h", 3600), ("0.5m", 30), (".5", 0.5)]
)
def test_budgets_are_read_in_seconds_minutes_and_hours(
    text: str, seconds: float, run: Command, monkeypatch: pytest.MonkeyPatch
):
    from termwise.reports import run as runs

    asked = []

    def stop(study: Any, *_: Any, **__: Any) -> dict[str, Any]:
        asked.append(study.budget)
        raise ValueError("stopped")

    monkeypatch.setattr(runs, "finished", lambda *_: None)
    monkeypatch.setattr(runs, "measure", stop)
    refused(run("compare", "monkey", "--study", "quick", "--budget", text), "stopped")
    assert asked == [seconds]
