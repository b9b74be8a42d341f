"""From a run to a pixel: a planted bias is opened where it was planted, and the pixel stored is the one replayed."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray

from termwise.renderer import Engine
from termwise.reports import cli, run
from termwise.reports.cli import places
from termwise.reports.results import microscope

SCENE = """
max_bounces = 1
[camera]
position = [0, -1, 4]
target = [0, 0, 0]
[ambient]
color = [0.5, 0.4, 0.3]
range = 1.0
[photons]
count = 300
[[objects]]
shape = "rectangle"
name = "floor"
origin = [-3, -3, 0]
edges = [[6, 0, 0], [0, 6, 0]]
gloss = 0.3
[[objects]]
shape = "box"
name = "box"
size = [1.5, 1.5, 0.6]
[[lights]]
position = [0, 0, 2]
intensity = [3, 3, 3]
"""
STUDY = """
scenes = ["SCENE"]
resolution = [32, 24]
replicates = 4
reference_replicates = 4
reference_spp = 4
physical_spp = 2
audit = false
[samples]
ambient = 2
direct = 2
specular = 2
background = 2
"""
Command = Callable[..., Any]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run whose ambient light is 30 % too bright on the box, in one tile."""
    files = tmp_path_factory.mktemp("microscope")
    (files / "scene.toml").write_text(SCENE)
    (files / "study.toml").write_text(STUDY.replace("SCENE", str(files / "scene.toml")))
    prefixes = Engine.prefixes

    def brighter(self: Any, variant: Any, **settings: Any) -> Iterator[Any]:
        objects = self.geometry().object
        for count, image, seconds in prefixes(self, variant, **settings):
            if (variant.term, variant.name) == ("ambient", "cosine"):
                image[8:16, 16:24][objects[8:16, 16:24] == 1] *= 1.3
            yield count, image, seconds

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "cache_folder", lambda: files / "cache")
        patch.setattr(Engine, "prefixes", brighter)
        patch.setattr("sys.argv", ["termwise", "compare", "--study", str(files / "study.toml"), "--out", str(files)])
        with pytest.raises(SystemExit):
            cli.main()
    return files


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """A function: `termwise ...` in this process -> exit status, standard output, standard error."""

    def call(*arguments: Any) -> tuple[Any, str, str]:
        monkeypatch.setattr("sys.argv", ["termwise", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        captured = capsys.readouterr()
        return ended.value.code, captured.out, captured.err

    return call


@pytest.mark.slow
def test_a_planted_bias_is_opened_where_it_is(folder: Path, command: Command):
    status, output, _ = command("inspect", folder / "compare", "--term", "ambient", "--variant", "cosine", "--json")
    found = json.loads(output)
    assert status == 0
    assert (found["object"]["name"], found["tile"]["name"]) == ("box", "tile x 16-23, y 8-15")
    x, y = found["pixel"]
    assert x in range(16, 24)
    assert y in range(8, 16)
    # Twice the 90 % interval: some four standard errors.
    assert abs(found["tile"]["bias"] - 0.3) < found["tile"]["high"] - found["tile"]["low"]
    assert found["tile"]["z"] > 5


def test_the_tree_ends_with_the_line_that_replays_it(folder: Path, command: Command):
    status, output, _ = command("inspect", folder / "compare")
    assert status == 0
    assert "ambient cosine: " in output
    assert "object box" in output
    # Nothing hides the sky from the pixel: its mean, 1.3 × 0.8 × (0.5, 0.4, 0.3), has no noise.
    (shown,) = (line for line in output.splitlines() if "mean of ours" in line)
    assert shown.split("mean of ours")[1].split() == ["0.52", "0.416", "0.312"]
    line = output.splitlines()[-1]
    assert line.startswith(f"termwise replay --scene {folder / 'scene.toml'} --term ambient --variant cosine --x ")
    page = (folder / "compare" / "scenes" / "scene.html").read_text()
    assert f"<code>{line.partition(' --results ')[0]}</code>" in page


def test_a_mean_has_the_digits_that_its_standard_error_leaves():
    assert places._known((0.51234, 12.3456, 1234.5, 0.25), (0.0123, 0.25, 31.0, 0.0)) == (
        "0.512 ± 0.012  12.35 ± 0.25  1234 ± 31  0.25"
    )


def replayed(folder: Path, command: Command, term: str, variant: str) -> tuple[Any, dict[str, Any]]:
    line = json.loads(command("inspect", folder / "compare", "--term", term, "--variant", variant, "--json")[1])[
        "replay"
    ]
    status, output, _ = command(*line.split()[1:], "--json")
    return status, json.loads(output)


@pytest.mark.parametrize(
    ("term", "variant"),
    [
        ("direct", "next-event"),
        ("specular", "vndf"),
        *(pytest.param(*pair, marks=pytest.mark.slow) for pair in (("ambient", "paper"), ("direct", "path"))),
    ],
)
def test_a_replay_is_what_the_run_stored(term: str, variant: str, folder: Path, command: Command):
    status, found = replayed(folder, command, term, variant)
    assert status == 0
    assert found["equals_stored"] is True
    assert found["value"] == found["stored"]
    with xarray.open_dataset(folder / "compare" / "results.nc", group="scene", engine="h5netcdf") as dataset:
        replicate, image = microscope.rendered(dataset.load(), term, variant)
    assert replicate == found["replicate"]
    assert image.dtype == np.float64
    assert image[found["y"], found["x"]].tolist() == found["value"]


def test_a_replay_shows_that_the_stored_value_was_tampered_with(folder: Path, command: Command):
    """The planted bias is in the run alone."""
    status, found = replayed(folder, command, "ambient", "cosine")
    assert status == 1
    np.testing.assert_allclose(found["stored"], 1.3 * np.array(found["value"]), 1e-14)


def test_objects_are_the_weighted_means_of_their_images(folder: Path):
    """Against the means in `results.nc`, pixel by pixel."""
    with xarray.open_dataset(folder / "compare" / "results.nc", group="scene", engine="h5netcdf") as dataset:
        dataset = dataset.load()
    found = microscope.branch(dataset, "direct", "path")
    cell = list(zip(dataset.cell_term.values, dataset.cell_variant.values, strict=True)).index(("direct", "path"))
    weights = np.array([0.2126, 0.7152, 0.0722])
    ours = dataset.image.values[cell] @ weights
    reference = dataset.reference.values[int(dataset.own.values[cell])] @ weights
    for place in found.objects:
        mask = dataset.object.values == ["floor", "box"].index(place.name)
        assert place.pixels == mask.sum()
        scale = max(reference[mask].mean(), 0.1 * reference.mean())
        assert place.bias == pytest.approx((ours[mask].mean() - reference[mask].mean()) / scale, abs=1e-6)
    assert abs(found.objects[0].z) == max(abs(place.z) for place in found.objects)
    assert found.image.pixels == 24 * 32


def test_pieces_cover_the_image_once():
    objects = np.random.default_rng(1).integers(-1, 3, (13, 21))
    found = microscope.pieces(objects)
    assert found.pixels.sum() == objects.size
    image = np.random.default_rng(2).random((2, 13, 21, 3))
    luminance = found.luminance(image)
    for index in range(len(found.pixels)):
        y, x = np.nonzero(found.index == index)
        assert set(objects[y, x]) == {found.object[index]}
        assert (x // 8 * 8 == found.x[index]).all()
        assert (y // 8 * 8 == found.y[index]).all()
        expected = image[:, y, x].mean(axis=1) @ [0.2126, 0.7152, 0.0722]
        np.testing.assert_allclose(luminance[:, index], expected)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--x", 32, "--y", 0], ["x = 32", "[0, 31]"]),
        (["--x", 3], ["y: is missing"]),
        (["--tile", 0, 24], ["tile y = 24", "[0, 23]"]),
        (["--scene", "glow"], ["scene = 'glow'", "allowed are scene"]),
        (["--term", "specular", "--variant", "cosine"], ["variant = 'cosine'", "vndf"]),
        (["--object", "glow"], ["object = 'glow'", "'box'", "'floor'"]),
    ],
)
def test_bad_places(arguments: list[Any], named: list[str], folder: Path, command: Command):
    status, output, message = command("inspect", folder / "compare", *arguments)
    assert (status, output, message.count("\n")) == (2, "", 1)
    assert [words for words in named if words not in message] == []


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"--x": -1}, ["x = -1", "[0, 31]"]),
        ({"--replicate": 32}, ["replicate = 32", "[0, 31]"]),
        ({"--term": "glow"}, ["term = 'glow'", "ambient"]),
        ({"--variant": "glow"}, ["variant = 'glow' of ambient", "cosine"]),
        ({"--samples": 0}, ["samples = 0", "at least 1"]),
        ({"--scene": "glow"}, ["glow", "allowed are"]),
        ({"--results": "nowhere"}, ["nowhere", "results.json"]),
    ],
)
def test_bad_replays(changes: dict[str, Any], named: list[str], folder: Path, command: Command):
    arguments = {"--scene": folder / "scene.toml", "--term": "ambient", "--x": 1, "--y": 1, "--replicate": 0}
    arguments |= {"--study": folder / "study.toml"} | changes
    status, output, message = command("replay", *(word for pair in arguments.items() for word in pair))
    assert (status, output, message.count("\n")) == (2, "", 1)
    assert [words for words in named if words not in message] == []


def test_damaged_results(folder: Path, command: Command, tmp_path: Path):
    whole = (folder / "compare" / "results.json").read_text()
    (tmp_path / "results.json").write_text(whole[:1000])
    assert "is damaged" in command("inspect", tmp_path)[2]
    (tmp_path / "results.json").write_text("{}")
    assert command("inspect", tmp_path)[0] == 2
    (tmp_path / "results.json").write_text(whole)
    content = (folder / "compare" / "results.nc").read_bytes()
    for kept in (None, content[: len(content) // 2]):
        if kept is not None:
            (tmp_path / "results.nc").write_bytes(kept)
        status, output, message = command("inspect", tmp_path)
        assert (status, output, message.count("\n")) == (2, "", 1)
        assert "results.nc" in message
