"""Planted faults shown: the tree of sources is copied, and a fault is planted in the copy, or switched on in it.

A process of its own renders an image with the copy's renderer; what it is judged against, Mitsuba renders from the
sources as they are. A fault that is in no image is shown by a test, which runs in the copy as plain Python. Each case
is judged and each test run without a fault as well: were a control BIASED, faults caught there would say nothing.
"""

import functools
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor, wait
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Self

import attrs
import numpy as np

from termwise.reference import store
from termwise.renderer import find
from termwise.reports.statistics.accumulation import BORDERS, measure
from termwise.reports.statistics.rule import decide
from termwise.reports.statistics.verdict import WORDS
from termwise.scenes.store import ROOT, cache_folder, sources_digest, write_atomically
from tests.audit import switches, worker
from tests.audit.plants import Plant, Test
from tests.audit.worker import Case
from tests.verdict.synthetic import RUN

REPLICATES = 16
"""K = R."""
_TRUTH_SAMPLES, _FEWEST, _TRUTH_MAPS = 512 * 32**2, 64, 4
TESTS = ("mean", "shape", "place", "border", "said", "check", "test")
"""What may catch a fault; `said` is an error that the sentence calls proven and too small, `check` an error that names
what is wrong, or a pixel that no radiance can be.
"""
BIASED = WORDS["right"][0]
REFUSED, SAID, FAILED, PASSED, CRASHED = "REFUSED", "SAID", "FAILED", "PASSED", "CRASHED"
_RENDERED = "renderer", "scenes"
_COPIED = *_RENDERED, "reference", "reports", "termwise", "tests"
_FAILURE = 1  # exit status of pytest where tests fail, and nothing else is wrong


@attrs.frozen
class Judged:
    """What became of a fault, or of a case without one.

    Attributes
    ----------
    verdict : the row's word; REFUSED where an error stands in its place; SAID where the fault is too small for the
        verdict, and its sentence says so; of a test FAILED or PASSED; CRASHED where nothing could be shown.
    by : those of TESTS that speak against it.
    text : the sentence, or the error.
    bias, standard_error : of the image's luminance, relative; None where there is none.
    """

    verdict: str
    by: tuple[str, ...]
    text: str
    bias: float | None = None
    standard_error: float | None = None

    @property
    def caught(self) -> bool:
        """Proven or refused; UNDERPOWERED is neither."""
        return self.verdict in (BIASED, REFUSED, SAID, FAILED)


def judge(ours: np.ndarray, truth: np.ndarray) -> Judged:
    """Judge replicates as a row of a run of some 60: (K, H, W, 3) against (R, H, W, 3)."""
    try:
        statistics = measure(ours, truth, noiseless=False)
    except ValueError as error:
        return Judged(REFUSED, ("check",), str(error))
    verdict = decide(statistics, tests=RUN)
    by = {_test(reason) for reason in verdict.reasons} if verdict.verdict == BIASED else set()
    by |= {"said"} if verdict.tolerated else set()
    return Judged(
        str(verdict.verdict),
        tuple(test for test in TESTS if test in by),
        verdict.sentence,
        verdict.bias if np.isfinite(verdict.bias) else None,
        verdict.standard_error,
    )


def _test(reason: str) -> str:
    """Which test a reason of the verdict comes from."""
    opening = {"mean of": "mean", "shape over": "shape", "tile": "place", **dict.fromkeys(BORDERS, "border")}
    return next((test for words, test in opening.items() if reason.startswith(words)), "check")


@attrs.frozen
class Tree:
    """A copy of the sources; kernels compiled there serve all that is rendered in it.

    Attributes
    ----------
    root : its folder.
    switches : numbers of the faults, by name, that stand in it already and are switched on.
    """

    root: Path
    switches: Mapping[str, int] = attrs.field(factory=dict)

    @classmethod
    def copied(cls, folder: Path, plants: Sequence[Plant] = ()) -> Self:
        """Copy the sources into `folder`, with those of the faults that can be switched.

        Raises
        ------
        ValueError
            A plant does not fit the sources.
        """
        root = folder / "tree"
        for package in _COPIED:
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(ROOT / package, root / package, symlinks=True, ignore=ignored)
        shutil.copy2(ROOT / "pyproject.toml", root)
        texts, numbers = switches.switched(plants, ROOT)
        for path, text in {**texts, f"{switches.MODULE}.py": switches.SOURCE}.items():
            (root / path).write_text(text, "utf-8")
        return cls(root, {plants[number].name: number for number in numbers})

    def replicates(
        self, case: Case, plant: Plant | None = None, *, seed: int, ahead: tuple[int, ...] = ()
    ) -> np.ndarray:
        """Replicates (K, H, W, 3) of a case with a fault; kept in the cache by the content of both.

        Those of seeds `ahead` are rendered and kept as well.

        Raises
        ------
        ValueError
            The plant does not fit the sources.
        RuntimeError
            The copy cannot be rendered: the process says why. A crash catches nothing.
        """
        content = attrs.astuple(case), case.build().digest(), Path(worker.__file__).read_text("utf-8")
        paths = {
            each: self._kept(_RENDERED, plant, (content, each, REPLICATES)).with_suffix(".npy")
            for each in (seed, *ahead)
        }
        if missing := [each for each, path in paths.items() if not path.is_file()]:
            settings = json.dumps({"case": attrs.asdict(case), "count": REPLICATES, "seeds": missing})
            with tempfile.TemporaryDirectory() as folder:
                images = Path(folder) / "images.npy"
                done = self._run([worker.__file__, settings, str(images)], plant)
                if done.returncode:
                    raise RuntimeError(f"{case}: {done.stderr.strip().splitlines()[-1]}")
                for each, rendered in zip(missing, np.load(images), strict=True):
                    write_atomically(paths[each], functools.partial(np.save, arr=rendered))
        return np.load(paths[seed])

    def test(self, tests: tuple[Test, ...], plant: Plant | None = None) -> Judged:
        """Run tests with a fault planted, all of them compiled or none; the outcome is kept as replicates are.

        Raises
        ------
        ValueError
            The plant does not fit the sources.
        RuntimeError
            The tests cannot be run, or are skipped: pytest says why. Only a test that fails catches a fault.
        """
        path = self._kept(_COPIED, plant, [attrs.astuple(test) for test in tests]).with_suffix(".json")
        if not path.is_file():
            words = ["-m", "pytest", "-q", "-x", "--no-header", "-p", "no:cacheprovider"]
            done = self._run(
                [*words, *(test.name for test in tests)],
                plant,
                NUMBA_DISABLE_JIT="0" if tests[0].compiled else "1",
                PYTEST_DISABLE_PLUGIN_AUTOLOAD="1",
            )
            lines = [line for line in done.stdout.splitlines() if line.strip()] or [done.stderr.strip()]
            failed = done.returncode == _FAILURE
            if not failed and (done.returncode or "skipped" in lines[-1]):
                raise RuntimeError(f"{', '.join(map(str, tests))}: {' '.join(lines[-2:])}")
            said = next((line for line in lines if line.startswith("FAILED")), lines[-1])
            text = json.dumps({"failed": failed, "text": said})
            write_atomically(path, lambda temporary: temporary.write_text(text, "utf-8"))
        found = json.loads(path.read_text("utf-8"))
        return Judged(FAILED if found["failed"] else PASSED, ("test",) if found["failed"] else (), found["text"])

    @staticmethod
    def _kept(packages: Iterable[str], plant: Plant | None, what: Any) -> Path:
        """Where the outcome is kept of what is done with the sources of some packages and a fault in them."""
        fault = None if plant is None else (plant.path, plant.changed(ROOT))
        sources = [sources_digest(ROOT / package) for package in packages]
        return cache_folder() / "audit" / hashlib.sha256(repr((what, sources, fault)).encode()).hexdigest()

    def _run(self, words: list[str], plant: Plant | None, **environment: str) -> subprocess.CompletedProcess[str]:
        """Python in the copy, with the fault on or in it meanwhile."""
        switch = switches.NONE if plant is None else self.switches.get(plant.name, switches.NONE)
        planted = plant if switch == switches.NONE else None
        if planted is not None:
            path = self.root / planted.path
            sound = path.rename(path.with_name(f"{path.name}.sound"))
            path.write_text(planted.changed(ROOT), "utf-8")
        try:
            return subprocess.run(
                [sys.executable, *words],
                env=os.environ
                | {
                    "PYTHONPATH": str(self.root),
                    "PYTHONDONTWRITEBYTECODE": "1",
                    "TERMWISE_CACHE": str(self.root / "cache"),
                    switches.VARIABLE: str(switch),
                }
                | environment,
                cwd=self.root,
                capture_output=True,
                text=True,
                check=False,
            )
        finally:
            if planted is not None:
                # With its time of change: by that Numba knows which kernels are still good.
                sound.replace(path)


def truth(case: Case, *, seed: int) -> np.ndarray:
    """Replicates (R, H, W, 3) of the case's own limit by Mitsuba, its kernel reference where it estimates a density."""
    scene, variant = case.build(), find(case.term, case.variant)
    limit, kernel = variant.limit(scene, case.samples), variant.kernel(scene, case.samples)
    if kernel is not None:
        limit = attrs.evolve(limit, kernel=kernel)
    # Of a kernel reference, photon maps: each has many more photons than the scene says.
    width, height = scene.resolution
    spp = max(_FEWEST, _TRUTH_SAMPLES // (width * height)) if kernel is None else _TRUTH_MAPS
    folder = cache_folder() / "reference"
    return store.replicates(scene, limit, spp=spp, seed=seed, count=REPLICATES, folder=folder).images


# Copies of this process alone that nobody uses; it has as many as it was ever asked for at once. They vanish with it.
_trees: SimpleQueue[Tree] = SimpleQueue()
_folders: list[tempfile.TemporaryDirectory[str]] = []


def _show(
    plant: Plant | None, by: Case | tuple[Test, ...], seed: int, ahead: tuple[int, ...], common: Tree
) -> np.ndarray | Judged:
    """Replicates of a case, or what became of tests, with a fault.

    It is switched on in the copy that all processes of a machine have in common, or planted in one of their own.
    """
    if isinstance(by, Case) and (plant is None or plant.name in common.switches) and common.root.is_dir():
        return common.replicates(by, plant, seed=seed, ahead=ahead)
    try:
        tree = _trees.get_nowait()
    except Empty:
        _folders.append(tempfile.TemporaryDirectory(prefix="termwise-audit-"))
        tree = Tree.copied(Path(_folders[-1].name))
    try:
        return tree.replicates(by, plant, seed=seed, ahead=ahead) if isinstance(by, Case) else tree.test(by, plant)
    finally:
        _trees.put(tree)


def run(
    plants: tuple[Plant, ...],
    *,
    seed: int,
    ahead: tuple[int, ...] = (),
    executor: Executor,
    report: Callable[[str, int, int], object],
) -> tuple[dict[Case | Test, Judged], dict[str, Judged]]:
    """Judge every case and run every test without a fault, then every fault, in an executor's processes.

    Images of seeds `ahead` are kept for later runs.

    Returns
    -------
    controls, found
        What became of each case and test, and of each plant, by its name.

    Raises
    ------
    ValueError, RuntimeError
        As `Tree.replicates` and `Tree.test` without a fault; all plants are tried against the sources before anything
        else.
    """
    for plant in plants:
        plant.changed(ROOT)
    shown = tuple(dict.fromkeys(plant.shown for plant in plants))
    cases = [each for each in shown if isinstance(each, Case)]
    tests = [[each for each in shown if isinstance(each, Test) and each.compiled == how] for how in (False, True)]
    # Without a fault all tests of a kind run at once.
    work: list[tuple[Plant | None, Case | tuple[Test, ...]]] = [(None, case) for case in cases]
    work += [(None, tuple(each)) for each in tests if each]
    work += [(plant, plant.shown if isinstance(plant.shown, Case) else (plant.shown,)) for plant in plants]
    controls: dict[Case | Test, Judged] = {}
    found: dict[str, Judged] = {}
    folder = tempfile.TemporaryDirectory(prefix="termwise-audit-")
    common = Tree.copied(Path(folder.name), [plant for plant in plants if isinstance(plant.shown, Case)])
    shows = [executor.submit(_show, plant, by, seed, ahead, common) for plant, by in work]
    try:
        truths = {case: truth(case, seed=seed) for case in cases}
        for done, ((plant, by), each) in enumerate(zip(work, shows, strict=True)):
            report(plant.name if plant else "without a fault", done, len(work))
            try:
                result = each.result()
            except RuntimeError as error:
                if plant is None:
                    raise
                result = Judged(CRASHED, (), str(error))  # no catch, but the others are worth an hour
            if not isinstance(result, Judged):
                assert isinstance(by, Case)
                result = judge(result, truths[by])
            if plant is not None:
                # Not where the same is said without the fault.
                said = plant.tolerated and "said" in result.by and "said" not in controls[plant.shown].by
                found[plant.name] = attrs.evolve(result, verdict=SAID) if said else result
            else:
                controls |= dict.fromkeys((by,) if isinstance(by, Case) else by, result)
    finally:
        for each in shows:
            each.cancel()
        wait(shows)
        folder.cleanup()
    report("faults", len(work), len(work))
    return controls, found
