"""The audit's own machinery, on few runs: `make audit` counts the many."""

import json
from collections.abc import Iterator

import attrs
import numpy as np
import pytest
from rich.console import Console

from termwise.scenes.store import ROOT
from tests.audit import __main__ as command
from tests.audit import faults, nulls
from tests.audit.plants import BACKGROUND, PLANTS
from tests.audit.worker import Case
from tests.verdict.synthetic import picture, replicates

TINY = Case("cornell_box", "ambient", "constant", samples=1, side=4)
"""No occlusion ray, little noise, no shader to speak of for Mitsuba."""
GAIN = next(plant for plant in PLANTS if plant.name == "1 % gain")


@pytest.mark.parametrize("plant", PLANTS, ids=lambda plant: plant.name)
def test_every_plant_fits_the_sources(plant):
    """Each text is there exactly once, and the fault changes it."""
    assert plant.changed(ROOT) != (ROOT / plant.path).read_text("utf-8")


def test_plants_are_enough_and_have_names_of_their_own():
    assert len({plant.name for plant in PLANTS}) == len(PLANTS) >= 25
    assert len({(plant.path, plant.before, plant.after) for plant in PLANTS}) == len(PLANTS)


@pytest.mark.parametrize("before", ["no such line", "import "])
def test_a_plant_that_does_not_fit_is_an_error(before):
    """Sources that have moved on must not turn into a fault that is never planted, or planted twice."""
    with pytest.raises(ValueError, match=r"1 % gain.*matches: allowed is exactly one"):
        attrs.evolve(GAIN, before=before).changed(ROOT)


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Iterator[faults.Tree]:
    """One copy of the sources for all tests: its kernels are compiled once."""
    with pytest.MonkeyPatch.context() as patch, faults.Tree(seed=3) as copy:
        patch.setenv("TERMWISE_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield copy


def test_a_copy_is_rendered_with_its_fault_and_without_it_again(tree):
    """The gain is exact, the sources stay as they are, and what follows in the same copy has no fault."""
    source = (ROOT / GAIN.path).read_bytes()
    fault = tree.replicates(TINY, GAIN)
    sound = tree.replicates(TINY)
    assert (tree.root / "termwise" / GAIN.path).read_bytes() == source
    assert fault.shape == (faults.REPLICATES, 4, 4, 3)
    np.testing.assert_allclose(fault, 1.01 * sound, rtol=1e-6)
    assert (ROOT / GAIN.path).read_bytes() == source


def test_a_crash_catches_nothing(tree):
    """A fault that ends the process is no catch of the verdict: it ends the audit, by name."""
    crash = attrs.evolve(GAIN, after='raise ArithmeticError("planted")')
    with pytest.raises(RuntimeError, match="planted"):
        tree.replicates(TINY, crash)


def test_what_catches_a_fault_is_named():
    """A gain by the mean, two halves that cancel by the shape and the place, NaN and equal seeds by a check."""
    rng = np.random.default_rng(5)
    mean = picture(64, 64)

    def draw(mean: np.ndarray) -> np.ndarray:
        return replicates(rng, mean, noise=0.05)

    reference = draw(mean)
    assert faults.judge(draw(mean), reference).by == ()
    assert "mean" in faults.judge(draw(1.05 * mean), reference).by
    halves = np.where(np.arange(64) < 32, 1.05, 1 - 0.05)[:, None]
    halved = faults.judge(draw(mean * halves), reference)
    assert {"shape", "place"} <= set(halved.by)
    broken = draw(mean)
    broken[2, 3, 4, 1] = np.nan
    assert faults.judge(broken, reference).by == ("check",)
    twice = faults.judge(np.repeat(draw(mean)[:8], 2, axis=0), reference)
    assert (twice.verdict, twice.by) == ("REFUSED", ("check",))
    noisy = replicates(rng, mean, noise=8.0)
    assert not faults.judge(noisy, replicates(rng, mean, noise=8.0)).caught


def test_nulls_count_alarms():
    """Equal laws: hardly any alarm; a gain: an alarm in every run."""
    rng = np.random.default_rng(6)
    mean = picture(16, 16)
    runs = [(replicates(rng, mean), replicates(rng, mean)) for _ in range(20)]
    assert nulls.judged(runs).alarms <= 4
    assert nulls.judged((2 * ours, reference) for ours, reference in runs) == nulls.Alarms(20, 20, 20)


def test_results_and_page(tmp_path, monkeypatch):
    """A small audit fills every row, and its page and table name each fault and what it fails by."""
    outcomes = {
        plant.name: faults.Judged("BIASED", ("mean",), "BIASED: by the mean.", 0.1, 0.001) for plant in PLANTS[1:]
    }
    outcomes[PLANTS[0].name] = faults.Judged("UNDERPOWERED", (), "UNDERPOWERED: who knows.", 0.1, 0.1)
    controls = {BACKGROUND: faults.Judged("BIASED", ("mean",), "BIASED: a control.", 0.1, 0.001)}
    monkeypatch.setattr(faults, "run", lambda plants, **_: (controls, outcomes))
    results = command.audit(synthetic=6, rendered_each=1, detections=1, rows=())
    assert results["planted"] == len(PLANTS)
    assert results["caught"] == len(PLANTS) - 1
    assert any("control two_cubes, background seen" in text for text in results["failures"])
    page = command.write(tmp_path, results).read_text("utf-8")
    assert json.loads((tmp_path / "results.json").read_text("utf-8")) == results
    console = Console(width=200, record=True)
    command.show(console, results)
    table = console.export_text()
    for plant in PLANTS:
        assert plant.name in page.replace("&#39;", "'")
        assert plant.name in table
    assert "UNDERPOWERED" in page
