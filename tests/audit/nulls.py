"""Nulls: comparisons without any bias, so that each BIASED is a false alarm.

Each comparison is a run of its own, so one in twenty may be one: the level is that of a run. The floors of the rule
make it rarer; Welch's test alone, that nothing differs, must alarm as often as the binomial law says, for a test that
never alarms is blind.
"""

import hashlib
import multiprocessing
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor

import attrs
import numpy as np

from termwise.renderer import Engine, find
from termwise.reports.statistics.accumulation import measure
from termwise.reports.statistics.rule import decide
from termwise.reports.statistics.verdict import LEVEL
from termwise.scenes.load import load
from termwise.scenes.store import ROOT, cache_folder, sources_digest, write_atomically
from tests.verdict.synthetic import picture, replicates

REPLICATES = 16
"""K = R."""
LAWS = (("gamma", 0.3), ("gamma", 2.0), ("lognormal", 1.0))
"""Noise of a pixel, and its relative standard deviation."""
SIDE = 16
_BATCH = 250


@attrs.frozen
class Rendered:
    """A row that is rendered again and again: scene, term, variant and samples a pixel of each replicate."""

    scene: str
    term: str
    variant: str
    samples: int


ROWS = (
    Rendered("two_cubes", "ambient", "cosine", 4),
    Rendered("cornell_box", "ambient", "uniform", 4),
    Rendered("cornell_box", "direct", "next-event", 4),
    Rendered("cornell_box_unshadowed", "direct", "path", 2),
    Rendered("cornell_box_unshadowed", "direct", "photon-map", 1),
    Rendered("two_cubes", "specular", "vndf", 4),
    Rendered("two_cubes", "background", "seen", 4),
)
_PHOTONS = 1000


@attrs.frozen
class Alarms:
    """False alarms of some runs.

    Attributes
    ----------
    runs, alarms : runs of the whole rule, and those that end BIASED.
    welch : runs in which Welch's test on the image's luminance alone has p below the level.
    """

    runs: int
    alarms: int
    welch: int

    def __add__(self, other: "Alarms") -> "Alarms":
        """Those of both."""
        return Alarms(self.runs + other.runs, self.alarms + other.alarms, self.welch + other.welch)


def judged(pairs: Iterable[tuple[np.ndarray, np.ndarray]], *, kernel: bool = False) -> Alarms:
    """Decide each pair of (K, H, W, 3) and (R, H, W, 3) as a run of one row."""
    found = Alarms(0, 0, 0)
    for ours, reference in pairs:
        statistics = measure(ours, reference)
        tests = statistics.mean_tests if kernel else statistics.tests
        alarm = decide(statistics, tests=tests, kernel=kernel).verdict == "BIASED"
        found += Alarms(1, int(alarm), int(statistics.luminance.p_values() < LEVEL))
    return found


def _synthetic(law: str, noise: float, runs: int, seed: tuple[int, ...]) -> Alarms:
    rng, mean = np.random.default_rng(seed), picture(SIDE, SIDE)

    def draw() -> np.ndarray:
        return replicates(rng, mean, REPLICATES, noise, law)

    return judged((draw(), draw()) for _ in range(runs))


def synthetic(runs: int, *, seed: int, jobs: int, report: Callable[[str, int, int], object]) -> Alarms:
    """At least `runs` nulls of synthetic pixels, an equal share of each law, by `jobs` processes."""
    batches = [
        (law, noise, min(_BATCH, runs), (seed, number, part))
        for number, (law, noise) in enumerate(LAWS)
        for part in range(-(-runs // (len(LAWS) * _BATCH)))
    ]
    found = Alarms(0, 0, 0)
    # Not forked: this process may have threads.
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        for done, alarms in enumerate(pool.map(_synthetic, *zip(*batches, strict=True)), 1):
            found += alarms
            report("gamma and lognormal pixels", done, len(batches))
    return found


def rendered(
    each: int, *, seed: int, rows: tuple[Rendered, ...] = ROWS, report: Callable[[str, int, int], object]
) -> dict[Rendered, Alarms]:
    """`each` comparisons of every row with itself: disjoint sets of replicates of the same estimator."""
    found = {}
    for done, row in enumerate(rows):
        report(f"{row.scene}: {row.term} {row.variant}", done, len(rows))
        images = _replicates(row, 2 * REPLICATES * each, seed).reshape(each, 2, REPLICATES, SIDE, SIDE, 3)
        found[row] = judged((ours, reference) for ours, reference in images)
    report("rendered", len(rows), len(rows))
    return found


def _replicates(row: Rendered, count: int, seed: int) -> np.ndarray:
    """(count, SIDE, SIDE, 3) float32, kept in the cache by content."""
    scene = load(row.scene)
    scene = attrs.evolve(scene, resolution=(SIDE, SIDE), photons=attrs.evolve(scene.photons, count=_PHOTONS))
    sources = sources_digest(ROOT / "renderer", ROOT / "scenes")
    name = hashlib.sha256(repr((row, scene.digest(), count, seed, sources)).encode()).hexdigest()
    path = cache_folder() / "audit" / f"{name}.npy"
    if not path.is_file():
        images = np.empty((count, SIDE, SIDE, 3), np.float32)
        with Engine(scene) as engine:
            for k in range(count):
                *_, (_, images[k], _) = engine.prefixes(
                    find(row.term, row.variant), samples=row.samples, seed=seed, replicate=k
                )
        write_atomically(path, lambda temporary: np.save(temporary, images))
    return np.load(path)
