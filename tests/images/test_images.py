"""The library's scenes, small: every term against Mitsuba. `make test` has one of them, `make exam` the others.

The deciding test is the verdict of each row. RMSE and SSIM of the mean images stand beside it, bounded by what two
seeds of one side differ by (`calibrate.py`): they need no statistics to be read, and cannot tell bias from noise.
"""

import contextlib
import fcntl
import functools
import math
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import attrs
import numpy as np
import pytest
import xarray
from PIL import Image

from termwise.reports import run
from termwise.reports.jobs import cells
from termwise.reports.pages import pictures
from termwise.reports.pages.environment import p_maps
from termwise.reports.results.exr import read_exr, write_exr
from termwise.reports.rows import looks
from termwise.reports.statistics import metrics
from termwise.reports.statistics.replicates import TILE_SIDES
from termwise.reports.study import study, subjects
from termwise.scenes.load import load
from termwise.scenes.model import Scene
from termwise.scenes.store import ROOT, cache_folder
from termwise.scenes.terms import TERMS

HERE = Path(__file__).parent
FAILED = ROOT / "out" / "failed"
THRESHOLDS = tomllib.loads((HERE / "thresholds.toml").read_text("utf-8"))
STUDY = study.load(HERE / "study.toml")

SCENES = subjects.scenes_of(STUDY)
ROWS = [
    (scene.name, term, variant.name)
    for scene in SCENES
    for term in TERMS
    for variant in subjects.variants_of(STUDY, scene, term)
] + [(scene.name, "total", "default") for scene in SCENES]
# The scenes without a term, and why; a box that is closed shows no sky.
ABSENT = {(scene.name, "transmission"): "no surface has transparency > 0" for scene in SCENES if scene.name != "glass"}
ABSENT |= {
    (scene, "background"): "the sky is black and lights are not drawn"
    for scene in ("cornell_box", "cornell_box_unshadowed")
}
# Too noisy for so few samples: the paper's cosine-power sampling of a lobe; reflections that are a hundredth of the
# picture's light and less; paths through leaves.
MAY_BE_UNDERPOWERED = {(scene.name, "specular", "paper") for scene in SCENES} | {
    ("lights", "specular", "vndf"),
    ("leaf", "specular", "vndf"),
    ("leaf", "direct", "path"),
}
QUICK = "two_cubes"
OfScene = Callable[[str], "Measured"]


def cases(of_scenes: Iterable[tuple[str, ...]]) -> list[Any]:
    """Parameters of tests, of which the first is a scene."""
    return [pytest.param(*each, marks=() if each[0] == QUICK else pytest.mark.slow) for each in of_scenes]


class Measured(NamedTuple):
    """What a run wrote: its rows against `own`, those against `correct`, and what `results.nc` has by scene and term.

    `images` are the means of ours and of the reference, `cells` everything of the term's default.
    """

    own: dict[tuple[str, str, str], dict[str, Any]]
    correct: dict[tuple[str, str, str], dict[str, Any]]
    images: dict[tuple[str, str], tuple[np.ndarray, np.ndarray]]
    cells: dict[tuple[str, str], xarray.Dataset]


def _measure(chosen: study.Study, scenes: tuple[Scene, ...], folder: Path) -> Measured:
    """Measure with the replicates of the project's cache; parallel test processes wait for each other's."""
    with (cache_folder() / "images.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        results = run.measure(chosen, scenes, folder, name="images", report=lambda *_: None)
    rows = {}
    for row in results["cells"]:
        rows.setdefault((row["against"], row["scene"], row["term"], row["variant"]), row)  # the first has all samples
    pairs, found = {}, {}
    for scene in scenes:
        with xarray.open_dataset(folder / "results.nc", group=scene.name, engine="h5netcdf") as group:
            for index, term in enumerate(group.cell_term.values.tolist()):
                if (scene.name, term) not in pairs:  # the first of a term's variants is its default
                    pair = group.image[index], group.reference[int(group.own[index])]
                    pairs[scene.name, term] = tuple(np.asarray(each, np.float64) for each in pair)
                    found[scene.name, term] = group.isel(cell=index).load()
    against = {which: {key[1:]: rows[key] for key in rows if key[0] == which} for which in ("own", "correct")}
    return Measured(against["own"], against["correct"], pairs, found)


@pytest.fixture(scope="session")
def measured(tmp_path_factory: pytest.TempPathFactory) -> OfScene:
    """All rows of `study.toml` that a scene has, measured when they are first asked for."""

    @functools.cache
    def of_scene(name: str) -> Measured:
        return _measure(STUDY, subjects.scenes_of(STUDY, (name,)), tmp_path_factory.mktemp(name))

    return of_scene


@contextlib.contextmanager
def evidence(measured: Measured, scene: str, term: str, request: pytest.FixtureRequest) -> Iterator[None]:
    """Where an assertion fails: leave ours, the reference, signed error and p-maps, and say how to run this test again.

    The channels of a p-map are p, and p adjusted by Holm and by Benjamini and Hochberg.
    """
    try:
        yield
    except AssertionError as error:
        ours, reference = measured.images[scene, term]
        folder, exposure = FAILED / f"{scene}-{term}", load(scene).exposure
        for name, image in (("ours", ours), ("reference", reference), ("error", ours - reference)):
            write_exr(folder / f"{name}.exr", {name: image}, {"software": "termwise", "scene": scene})
        pictures.write_png(folder / "ours.png", ours, exposure=exposure)
        pictures.write_png(folder / "reference.png", reference, exposure=exposure)
        cell, (height, width, _) = measured.cells[scene, term], ours.shape

        def leave(name: str, pixels: np.ndarray) -> str:
            Image.fromarray(pixels).save(folder / f"{name}.png")
            return name

        for side in p_maps(cell, (height, width), term, leave):
            each = [cell[f"tile_{name}_{side}"].values for name in ("p", "holm", "benjamini_hochberg")]
            pixels = np.stack(each, axis=-1).repeat(side, axis=0).repeat(side, axis=1)[:height, :width]
            header = {"software": "termwise", "scene": scene}
            write_exr(folder / f"{term} p-map {side}.exr", {"p-map": pixels}, header)
        signed, _ = pictures.relative_error(ours, reference)
        Image.fromarray(pictures.diverge(signed, scale=pictures.error_scale([signed]))).save(folder / "error.png")
        again = f'{sys.executable} -m pytest "{request.node.nodeid}"'
        raise AssertionError(f"{error}\nimages: {folder}\nagain: {again}") from None


@pytest.mark.parametrize(
    ("scene", "term"), cases((s, t) for s in THRESHOLDS for t in THRESHOLDS[s]), ids=lambda value: value
)
def test_mean_images_are_as_near_as_two_seeds(scene: str, term: str, measured: OfScene, request: pytest.FixtureRequest):
    bound, found = THRESHOLDS[scene][term], measured(scene)
    variant = "default" if term == "total" else getattr(STUDY.variants, term)[0]
    if "reference_shortfall" in found.own[scene, term, variant]:
        pytest.skip("the reference has fewer samples than the thresholds were calibrated for")
    ours, reference = found.images[scene, term]
    with evidence(found, scene, term, request):
        assert metrics.rmse(reference, ours) <= bound["rmse"], bound["reason"]
        assert metrics.ssim(reference, ours, exposure=load(scene).exposure) >= bound["ssim"], bound["reason"]


def test_every_term_that_a_scene_has_is_bounded():
    bounded = {(scene, term) for scene in THRESHOLDS for term in THRESHOLDS[scene]}
    assert bounded == {(scene, term) for scene, term, _ in ROWS} - set(ABSENT)


@pytest.mark.parametrize(("scene", "term", "variant"), cases(ROWS), ids=lambda value: value)
def test_verdict(scene: str, term: str, variant: str, measured: OfScene, request: pytest.FixtureRequest):
    row = measured(scene).own[scene, term, variant]
    if (scene, term) in ABSENT:
        allowed = {"ABSENT"}
    else:
        allowed = {"EQUIVALENT" if row["kind"] == "right" else "AS PREDICTED"}
        if (scene, term, variant) in MAY_BE_UNDERPOWERED or "reference_shortfall" in row:
            allowed.add("UNDERPOWERED")
    with evidence(measured(scene), scene, term, request):
        assert row["verdict"] in allowed, row["sentence"]


@pytest.mark.parametrize(("scene", "term"), cases(sorted(ABSENT)))
def test_absent_names_its_reason(scene: str, term: str, measured: OfScene):
    row = measured(scene).own[scene, term, getattr(STUDY.variants, term)[0]]
    assert row["reasons"] == (ABSENT[scene, term],)


@pytest.mark.parametrize("scene", cases((scene.name,) for scene in SCENES))
def test_paper_ambient_is_pi_times_too_bright(scene: str, measured: OfScene):
    """The paper weights cosine-distributed rays with the cosine-free pdf's factor: own limit / correct limit is pi."""
    row = measured(scene).correct[scene, "ambient", "paper"]
    assert row["predicted_bias"] == pytest.approx(math.pi - 1)
    # Five standard errors with 15 degrees of freedom or more: one false alarm in 6000 rows.
    assert abs(row["bias"] - (math.pi - 1)) <= 5 * row["standard_error"]
    assert row["standard_error"] < 0.01 * math.pi


@pytest.mark.slow
def test_paper_specular_of_one_bounce_is_4_over_pi_times_too_bright(tmp_path: Path):
    """Each vertex of a chain has the factor 4/pi; a chain of one vertex gives it to the whole image."""
    chosen = attrs.evolve(STUDY, samples=STUDY.samples | {"specular.paper": 128})
    (scene,) = subjects.scenes_of(chosen, (QUICK,))
    name = QUICK
    found = _measure(chosen, (attrs.evolve(scene, max_bounces=1),), tmp_path)
    row = found.correct[name, "specular", "paper"]
    assert row["predicted_bias"] == pytest.approx(4 / math.pi - 1)
    assert abs(row["bias"] - (4 / math.pi - 1)) <= 5 * row["standard_error"]
    assert row["standard_error"] < 0.01
    assert found.own[name, "specular", "paper"]["verdict"] in ("AS PREDICTED", "UNDERPOWERED")
    assert found.own[name, "specular", "vndf"]["verdict"] == "EQUIVALENT"


# The same gate must fail where something is wrong: each fault is put into the replicates of one cell.


def _blurred(stack: np.ndarray) -> np.ndarray:
    """A box of 2 x 2 px, as a film filter that was applied twice."""
    shifted = np.concatenate([stack[..., 1:, :], stack[..., -1:, :]], axis=-2)
    wide = (stack + shifted) / 2
    return (wide + np.concatenate([wide[..., 1:, :, :], wide[..., -1:, :, :]], axis=-3)) / 2


FAULTS: dict[str, tuple[str, Callable[[np.ndarray], np.ndarray]]] = {
    "2 % gain": ("ambient", lambda stack: 1.02 * stack),
    "swapped channels": ("ambient", lambda stack: stack[..., ::-1]),
    "2 px blur": ("background", _blurred),
    "left and right": ("ambient", lambda stack: stack * np.linspace(0.97, 1.03, stack.shape[-2])[:, None]),
    "a NaN": ("specular", lambda stack: np.append(stack.ravel()[:-1], np.nan).reshape(stack.shape)),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_planted_fault_is_biased(fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    wrong_term, spoil = FAULTS[fault]
    intact = cells.read

    def spoilt(*arguments: Any, **settings: Any) -> cells.Cell:
        cell = intact(*arguments, **settings)
        variant = cell.variant
        default = variant.name == getattr(STUDY.variants, variant.term)[0]
        wrong = default and variant.term == wrong_term
        return attrs.evolve(cell, images=spoil(cell.images).astype(np.float32)) if wrong else cell

    monkeypatch.setattr(cells, "read", spoilt)
    caught = _caught(tmp_path)
    assert (wrong_term, getattr(STUDY.variants, wrong_term)[0]) in caught
    assert {term for term, _ in caught} <= {wrong_term, "total"}


def test_planted_half_pixel_shift_is_biased(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Rays through the pixels' corners instead of all over them: a shift by half a pixel, and no mean of its own."""
    intact = looks.of_variant

    def shifted(*arguments: Any) -> Any:
        asked = intact(*arguments)
        camera = attrs.evolve(asked.scene.camera, pixel="corner")
        return attrs.evolve(asked, scene=attrs.evolve(asked.scene, camera=camera))

    monkeypatch.setattr(looks, "of_variant", shifted)
    caught = _caught(tmp_path)
    assert {("ambient", "cosine"), ("background", "seen")} <= caught


def _caught(folder: Path) -> set[tuple[str, str]]:
    """Term and variant of what a run calls BIASED or NOT AS PREDICTED."""
    scenes = subjects.scenes_of(STUDY, (QUICK,))
    rows = _measure(STUDY, scenes, folder).own.values()
    return {(row["term"], row["variant"]) for row in run.failures({"cells": rows})}


def test_a_failure_leaves_its_images(measured: OfScene, request: pytest.FixtureRequest, monkeypatch, tmp_path: Path):
    monkeypatch.setattr(sys.modules[__name__], "FAILED", tmp_path)
    found = measured(QUICK)
    with pytest.raises(AssertionError, match="again: .*test_images.py"), evidence(found, QUICK, "ambient", request):
        raise AssertionError("a bound is exceeded")
    left = {path.name for path in (tmp_path / f"{QUICK}-ambient").iterdir()}
    names = "ours", "reference", "error", *(f"ambient p-map {side}" for side in TILE_SIDES)
    assert left == {f"{name}.{kind}" for name in names for kind in ("exr", "png")}
    cell = found.cells[QUICK, "ambient"]
    (p,) = read_exr(tmp_path / f"{QUICK}-ambient" / "ambient p-map 16.exr").values()
    np.testing.assert_allclose(p[::16, ::16, 0], cell["tile_p_16"].values, rtol=1e-6)
    (error,) = read_exr(tmp_path / f"{QUICK}-ambient" / "error.exr").values()
    ours, reference = found.images[QUICK, "ambient"]
    np.testing.assert_allclose(error, ours - reference, atol=1e-6)
