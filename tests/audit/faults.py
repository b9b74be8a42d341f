"""Planted faults rendered and judged: the tree of sources is copied, one fault at a time is planted in the copy.

A process of its own renders each with the copy's renderer; what it is judged against, Mitsuba renders from the sources
as they are. Each case is rendered without a fault as well: were a control BIASED, faults caught there would say
nothing.
"""

import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from queue import SimpleQueue

import attrs
import numpy as np

from termwise.reference import store
from termwise.renderer import find
from termwise.reports.statistics.accumulation import measure
from termwise.reports.statistics.rule import decide
from termwise.reports.statistics.verdict import WORDS
from termwise.scenes.store import ROOT, cache_folder, sources_digest, write_atomically
from tests.audit import worker
from tests.audit.plants import Plant
from tests.audit.worker import Case
from tests.verdict.synthetic import RUN

REPLICATES = 16
"""K = R."""
_TRUTH_SPP, _TRUTH_MAPS = 512, 4
TESTS = ("mean", "shape", "place", "check")
"""What may catch a fault; `check` is an error that names what is wrong, or a pixel that no radiance can be."""
BIASED = WORDS["right"][0]
_COPIED = "renderer", "scenes"


@attrs.frozen
class Judged:
    """What became of a fault, or of a case without one.

    Attributes
    ----------
    verdict : the row's word, or "REFUSED" where an error stands in its place.
    by : those of TESTS that speak against it.
    text : the sentence, or the error.
    bias, standard_error : of the image's luminance, relative; None where refused.
    """

    verdict: str
    by: tuple[str, ...]
    text: str
    bias: float | None = None
    standard_error: float | None = None

    @property
    def caught(self) -> bool:
        """Proven or refused; UNDERPOWERED is neither."""
        return self.verdict in (BIASED, "REFUSED")


def judge(ours: np.ndarray, truth: np.ndarray) -> Judged:
    """Judge replicates as a row of a run of some 60: (K, H, W, 3) against (R, H, W, 3)."""
    try:
        statistics = measure(ours, truth, noiseless=False)
    except ValueError as error:
        return Judged("REFUSED", ("check",), str(error))
    verdict = decide(statistics, tests=RUN)
    by = {_test(reason) for reason in verdict.reasons} if verdict.verdict == BIASED else set()
    return Judged(
        str(verdict.verdict),
        tuple(test for test in TESTS if test in by),
        verdict.sentence,
        verdict.bias if np.isfinite(verdict.bias) else None,
        verdict.standard_error,
    )


def _test(reason: str) -> str:
    """Which test a reason of the verdict comes from."""
    opening = {"mean of": "mean", "shape over": "shape", "tile": "place"}
    return next((test for words, test in opening.items() if reason.startswith(words)), "check")


class Tree:
    """A copy of the sources in a folder that vanishes with the context; kernels compiled there serve all faults."""

    def __init__(self, *, seed: int) -> None:
        self.seed = seed
        self._folder = tempfile.TemporaryDirectory(prefix="termwise-audit-")
        self.root = Path(self._folder.name) / "tree"

    def __enter__(self) -> "Tree":
        """Copy the sources."""
        for package in _COPIED:
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(ROOT / package, self.root / "termwise" / package, ignore=ignored)
        (self.root / "termwise" / "__init__.py").touch()
        return self

    def __exit__(self, *exception: object) -> None:
        """Remove the copy."""
        self._folder.cleanup()

    def replicates(self, case: Case, plant: Plant | None = None) -> np.ndarray:
        """Replicates (K, H, W, 3) of a case with a fault planted; kept in the cache by the content of both.

        Raises
        ------
        ValueError
            The plant does not fit the sources.
        RuntimeError
            The copy cannot be rendered: the process says why. A crash catches nothing.
        """
        fault = None if plant is None else (plant.path, plant.changed(ROOT))
        sources = [sources_digest(ROOT / package) for package in _COPIED]
        content = case.build().digest(), Path(worker.__file__).read_text("utf-8")
        name = repr((attrs.astuple(case), content, sources, fault, self.seed, REPLICATES))
        path = cache_folder() / "audit" / f"{hashlib.sha256(name.encode()).hexdigest()}.npy"
        if not path.is_file():
            write_atomically(path, lambda temporary: self._render(case, fault, temporary))
        return np.load(path)

    def _render(self, case: Case, fault: tuple[str, str] | None, images: Path) -> None:
        if fault is not None:
            path = self.root / "termwise" / fault[0]
            path.write_text(fault[1], "utf-8")
        environment = os.environ | {
            "PYTHONPATH": str(self.root),
            "PYTHONDONTWRITEBYTECODE": "1",
            "TERMWISE_CACHE": str(self.root / "cache"),
        }
        settings = json.dumps({"case": attrs.asdict(case), "count": REPLICATES, "seed": self.seed})
        try:
            done = subprocess.run(
                [sys.executable, worker.__file__, settings, str(images.resolve())],
                env=environment,
                cwd=self.root,
                capture_output=True,
                text=True,
                check=False,
            )
        finally:
            if fault is not None:
                # With its time of change: by that Numba knows which kernels are still good.
                shutil.copy2(ROOT / fault[0], self.root / "termwise" / fault[0])
        if done.returncode:
            raise RuntimeError(f"{case}: {done.stderr.strip().splitlines()[-1]}")


def truth(case: Case, *, seed: int) -> np.ndarray:
    """Replicates (R, H, W, 3) of the case's own limit by Mitsuba, its kernel reference where it estimates a density."""
    scene, variant = case.build(), find(case.term, case.variant)
    limit, kernel = variant.limit(scene, case.samples), variant.kernel(scene, case.samples)
    if kernel is not None:
        limit = attrs.evolve(limit, kernel=kernel)
    # Of a kernel reference, photon maps: each has many more photons than the scene says.
    spp = _TRUTH_SPP if kernel is None else _TRUTH_MAPS
    folder = cache_folder() / "reference"
    return store.replicates(scene, limit, spp=spp, seed=seed, count=REPLICATES, folder=folder).images


def run(
    plants: tuple[Plant, ...], *, seed: int, jobs: int, report: Callable[[str, int, int], object]
) -> tuple[dict[Case, Judged], dict[str, Judged]]:
    """Judge every case without a fault, then every fault; `jobs` copies of the sources are rendered from at once.

    Returns
    -------
    controls, found
        What became of each case and of each plant, by its name.

    Raises
    ------
    ValueError, RuntimeError
        As `Tree.replicates`; all plants are tried against the sources before anything is rendered.
    """
    for plant in plants:
        plant.changed(ROOT)
    cases = tuple(dict.fromkeys(plant.case for plant in plants))
    work: list[tuple[Plant | None, Case]] = [(None, case) for case in cases]
    work += [(plant, plant.case) for plant in plants]
    controls, found = {}, {}
    trees: SimpleQueue[Tree] = SimpleQueue()
    with ExitStack() as folders, ThreadPoolExecutor(jobs) as pool:
        for _ in range(jobs):
            trees.put(folders.enter_context(Tree(seed=seed)))

        def render(plant: Plant | None, case: Case) -> np.ndarray:
            tree = trees.get()
            try:
                return tree.replicates(case, plant)
            finally:
                trees.put(tree)

        rendered = [pool.submit(render, plant, case) for plant, case in work]
        try:
            truths = {case: truth(case, seed=seed) for case in cases}
            for done, ((plant, case), images) in enumerate(zip(work, rendered, strict=True)):
                report(plant.name if plant else f"control: {case.term} {case.variant}", done, len(work))
                outcome = judge(images.result(), truths[case])
                if plant is None:
                    controls[case] = outcome
                else:
                    found[plant.name] = outcome
        finally:
            pool.shutdown(cancel_futures=True)
    report("faults", len(work), len(work))
    return controls, found
