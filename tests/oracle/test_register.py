"""Estimators of one's own: registered, measured like any other, and caught where they are wrong.

Rationale: the example of the README is run as a user would run it. Averaging after gamma encoding is too dark wherever
samples differ: with an open share A of the hemisphere a sample is 1 or 0, and the mean of n of them to the power 2.2
tends to `A^2.2 < A`. The cosine estimator that it is built on must stay EQUIVALENT in the same run.
"""

import attrs
import numpy as np
import pytest

import termwise
from termwise.renderer.terms import VARIANTS, find, registered
from termwise.reports import cli, run
from termwise.reports.jobs.executors import InThisProcess
from termwise.reports.study import study, subjects
from termwise.scenes.limits import Limit
from termwise.scenes.load import load
from termwise.scenes.store import ROOT
from termwise.scenes.terms import TERMS
from tests.scenes import small

EXAMPLE = ROOT / "examples" / "gamma_space.py"

pytestmark = pytest.mark.usefixtures("_tables")


def black(scene, samples, seed):
    return np.zeros((*scene.resolution[::-1], 3))


@pytest.mark.slow
def test_a_wrong_estimator_is_caught(tmp_path):
    cli.runs.run_file(EXAMPLE)
    assert registered("ambient") == ("gamma-space",)
    small = attrs.evolve(
        study.with_registered(study.load("quick")),
        resolution=(24, 24),
        replicates=8,
        reference_replicates=8,
        samples={"ambient": 4},
        variants=study.Variants(ambient=("cosine", "gamma-space"), direct=("path",), specular=("vndf",)),
    )
    scenes = subjects.scenes_of(small, ("cornell_box",))
    scenes = tuple(attrs.evolve(scene, scope="all") for scene in scenes)
    results = run.measure(small, scenes, tmp_path, name="quick", report=lambda what, done, total: None)
    verdicts = {row["variant"]: row for row in results["cells"] if row["term"] == "ambient" and row["verdict"]}
    assert verdicts["gamma-space"]["verdict"] == "BIASED"
    assert verdicts["gamma-space"]["bias"] < -0.05
    assert verdicts["cosine"]["verdict"] != "BIASED"
    prefixes = [
        row["samples"] for row in results["cells"] if row["variant"] == "gamma-space" and row["against"] == "own"
    ]
    assert sorted(prefixes) == [1, 2, 4]


@pytest.mark.slow
def test_later_looks_call_an_estimator_for_new_replicates_alone(tmp_path, monkeypatch):
    """A noisy one, undecided at 4 replicates: with a budget each (seed, count) is asked for once."""
    monkeypatch.setattr(run, "cache_folder", lambda: tmp_path / "cache")
    asked = []

    def noisy(scene, samples, seed):
        asked.append((samples, seed))
        from termwise.renderer import render

        right = render(scene, "ambient", samples=4, seed=seed % 2**31).mean
        return right * np.random.default_rng((seed, samples)).gamma(1.0, 1.0, right.shape)

    termwise.register("ambient", "noisy", noisy, Limit("ambient"))
    small = attrs.evolve(_small("noisy"), budget=3600.0)
    scenes = subjects.scenes_of(small, ("two_cubes",))
    results = run.measure(small, scenes, tmp_path, name="quick", report=lambda what, done, total: None)
    (row,) = (row for row in results["cells"] if row["variant"] == "noisy" and row["verdict"])
    assert row["replicates"] > 4
    assert len(set(asked)) == len(asked)
    (work,) = (each for each in results["settings"]["scenes"]["two_cubes"]["work"] if each["variant"] == "noisy")
    assert len(asked) == 2 * work["replicates"]


def test_a_finished_run_is_told_by_what_its_estimators_compute():
    """The same code is the same run; other code of the same name, or what has no fingerprint, is another one."""
    kept = study.load("quick")
    scenes = subjects.scenes_of(kept, ("cornell_box",))
    digests = [run.digest(kept, scenes, "x")]
    for function in (black, lambda scene, samples, seed: black(scene, samples, seed) + 1.0):
        termwise.register("ambient", "mine", function, Limit("ambient"))
        new = study.with_registered(kept)
        digests.append(run.digest(new, scenes, "x"))
        assert run.digest(new, scenes, "x") == digests[-1]
        del VARIANTS["ambient"]["mine"]
    generator = np.random.default_rng(0)
    termwise.register("ambient", "mine", lambda scene, samples, seed: generator.random(3), Limit("ambient"))
    new = study.with_registered(kept)
    digests += [run.digest(new, scenes, "x") for _ in range(2)]
    assert len(set(digests)) == len(digests)
    ((term, name, why),) = study.unkept()
    assert (term, name) == ("ambient", "mine")
    assert "generator is a Generator" in why


def _small(name: str) -> study.Study:
    return attrs.evolve(
        study.load("quick"),
        resolution=(8, 8),
        replicates=4,
        reference_replicates=4,
        reference_spp=4,
        physical_spp=1,
        samples={"ambient": 2, "direct": 1, "specular": 1, "background": 1},
        variants=study.Variants(ambient=(name,), direct=("path",), specular=("vndf",)),
    )


@pytest.mark.slow
def test_what_it_made_is_kept_like_a_kernels(tmp_path, monkeypatch):
    """A second run calls nothing; another function of the same name is called anew."""
    monkeypatch.setattr(run, "cache_folder", lambda: tmp_path / "cache")
    asked = tmp_path / "asked"

    def counted(scene, samples, seed):
        with asked.open("a") as file:
            file.write("x")
        return np.random.default_rng((seed, samples)).gamma(4.0, 1.0, (*scene.resolution[::-1], 3))

    def means(identity: str) -> float:
        termwise.register("ambient", "counted", counted, Limit("ambient"), identity=identity)
        small = _small("counted")
        scenes = subjects.scenes_of(small, ("two_cubes",))
        results = run.measure(small, scenes, tmp_path / "out", name="quick", report=lambda *_: None)
        del VARIANTS["ambient"]["counted"]
        return next(row["bias"] for row in results["cells"] if row["variant"] == "counted" and row["verdict"])

    first = means("first")
    assert len(asked.read_text()) == 4 * 2
    assert means("first") == first
    assert len(asked.read_text()) == 4 * 2
    means("second")
    assert len(asked.read_text()) == 2 * 4 * 2


@pytest.mark.slow
def test_what_has_no_fingerprint_leaves_nothing_behind(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "cache_folder", lambda: tmp_path / "cache")
    generator = np.random.default_rng(0)

    def stateful(scene, samples, seed):
        return generator.gamma(4.0, 1.0, (*scene.resolution[::-1], 3))

    termwise.register("ambient", "stateful", stateful, Limit("ambient"))
    small = _small("stateful")
    scenes = subjects.scenes_of(small, ("two_cubes",))
    for _ in range(2):
        run.measure(small, scenes, tmp_path / "out", name="quick", report=lambda *_: None)
        assert len(list((tmp_path / "cache" / "cells").rglob("*.npz"))) == (len(TERMS) - 1) * 4  # of the others


def test_what_cannot_be_sent_to_another_process_is_named(tmp_path):
    class Elsewhere(InThisProcess):
        elsewhere = True

    termwise.register("ambient", "mine", lambda scene, samples, seed: black(scene, 1, 1), Limit("ambient"))
    small = _small("mine")
    scenes = subjects.scenes_of(small, ("two_cubes",))
    with pytest.raises(ValueError, match="ambient mine: cannot be sent to another process"):
        run.measure(small, scenes, tmp_path, name="quick", report=lambda *_: None, executor=Elsewhere())


def test_replicates_have_seeds_of_their_own_and_prefixes_share_them():
    from termwise.renderer import Engine

    asked = []

    def noted(scene, samples, seed):
        asked.append((samples, seed))
        return black(scene, samples, seed)

    variant = termwise.register("ambient", "noted", noted, lambda scene: Limit("ambient"))
    with Engine(small("cornell_box", 4, 3)) as engine:
        for replicate in range(2):
            assert [n for n, _, _ in engine.prefixes(variant, samples=4, seed=1, replicate=replicate)] == [1, 2, 4]
    assert [samples for samples, _ in asked] == [1, 2, 4, 1, 2, 4]
    assert len({seed for _, seed in asked[:3]}) == len({seed for _, seed in asked[3:]}) == 1
    assert asked[0][1] != asked[3][1]
    assert all(0 <= seed < 2**63 for _, seed in asked)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("ambience", "mine", black, Limit("ambient")), ["'ambience'", "allowed are", "ambient"]),
        (("ambient", "cosine", black, Limit("ambient")), ["'cosine'", "exists"]),
        (("ambient", "My Own", black, Limit("ambient")), ["'My Own'", "allowed are", "hyphens"]),
        (("ambient", "mine", black, Limit("direct")), ["'direct'", "allowed is 'ambient'"]),
    ],
)
def test_what_cannot_be_registered(arguments, words):
    with pytest.raises(ValueError, match="allowed|exists") as error:
        termwise.register(*arguments)
    assert all(word in str(error.value) for word in words)
    assert "mine" not in VARIANTS["ambient"]


def test_an_image_of_another_size_is_refused():
    termwise.register("ambient", "small", lambda scene, samples, seed: np.zeros((2, 2, 3)), Limit("ambient"))
    with pytest.raises(ValueError, match=r"ambient small: shape = \(2, 2, 3\): allowed is"):
        termwise.render(load("cornell_box"), "ambient", variant="small", samples=1)
    assert find("ambient", "small").kernel_based(load("cornell_box")) is False


def test_a_missing_file_is_one_line(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["termwise", "compare", "cornell_box", "--estimators", "nowhere.py"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    assert "nowhere.py: no such file" in capsys.readouterr().err
