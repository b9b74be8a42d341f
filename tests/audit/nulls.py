"""Nulls: comparisons without any bias, so that each BIASED is a false alarm.

Each comparison is a run of its own, so one in twenty may be one: the level is that of a run. Noise is of all kinds that
renderers make, also of those that a test of means likes least: a heavy tail, rare bright events, few independent
pixels; on both sides or on one of them, with few replicates or many.

The floors of the rule make alarms rarer than the level; Welch's test alone, that nothing differs, must alarm as often
as the binomial law says where noise is ordinary, for a test that never alarms is blind.
"""

import hashlib
import itertools
from collections import defaultdict
from collections.abc import Callable, Iterable
from concurrent.futures import Executor
from typing import Literal

import attrs
import numpy as np
from scipy import ndimage

from termwise.renderer import Engine, find
from termwise.reports.statistics.accumulation import measure
from termwise.reports.statistics.rule import decide
from termwise.reports.statistics.verdict import LEVEL
from termwise.scenes.load import load
from termwise.scenes.store import ROOT, cache_folder, sources_digest, write_atomically
from tests.verdict.synthetic import picture

REPLICATES = 16
"""K = R of rendered and of ordinary nulls."""
SIZES = (4, 8, 16, 32)
"""K and R of awkward ones, each with each."""
SIDE = 16
_BATCH = 250
_FIREFLY = 100.0
"""Flux of a firefly in pixels of mean brightness."""

Noise = Callable[[np.random.Generator, tuple[int, ...]], np.ndarray]
"""Generator and shape (n, H, W, 1) -> factors on the limit, of that shape and with the mean 1."""
Noisy = Literal["both sides", "ours", "the reference"]
NOISY: tuple[Noisy, ...] = ("both sides", "ours", "the reference")


def _gamma(noise: float | np.ndarray) -> Noise:
    """`noise` is the relative standard deviation of a pixel."""
    return lambda rng, shape: rng.gamma(1 / np.square(noise), np.square(noise), shape)


def _lognormal(sigma: float) -> Noise:
    return lambda rng, shape: rng.lognormal(-(sigma**2) / 2, sigma, shape)


def _fireflies(rate: float) -> Noise:
    """`rate` events a replicate, somewhere, above ordinary noise."""

    def draw(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        each = rate / (shape[1] * shape[2])
        return (_gamma(0.3)(rng, shape) + _FIREFLY * rng.poisson(each, shape)) / (1 + _FIREFLY * each)

    return draw


def _correlated(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Spots of some 5 px, and a factor that all pixels share, as photon maps have them."""
    width, strength = 2.0, 0.5
    spots = ndimage.gaussian_filter(rng.normal(size=shape), (0, width, width, 0), mode="wrap")
    spots *= 2 * width * np.sqrt(np.pi)  # to a standard deviation of 1
    return np.exp(strength * spots - strength**2 / 2) * _gamma(0.05)(rng, (shape[0], 1, 1, 1))


def _skewed(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Exponential, and one number for 8 x 8 px: the mean of an image is that of four."""
    few = rng.exponential(size=(shape[0], shape[1] // 8, shape[2] // 8, 1))
    return few.repeat(8, axis=1).repeat(8, axis=2)


LAWS: dict[str, Noise] = {
    "gamma, 0.3": _gamma(0.3),
    "gamma, 2": _gamma(2.0),
    "lognormal, 0.83": _lognormal(float(np.sqrt(np.log1p(1.0)))),
    "lognormal, 2": _lognormal(2.0),
    "fireflies, 0.1": _fireflies(0.1),
    "fireflies, 0.3": _fireflies(0.3),
    "fireflies, 1": _fireflies(1.0),
    "correlated": _correlated,
    "skewed": _skewed,
    "heteroscedastic": _gamma(np.geomspace(0.05, 2.0, SIDE)[:, None]),
    "half black": _gamma(0.3),
}
"""Noise by name: of gamma its relative standard deviation, of lognormal sigma, of fireflies how many a replicate."""
ORDINARY = tuple(LAWS)[:3]
UNMET = ("fireflies, 0.1", "fireflies, 0.3")
"""Those whose events all replicates of a side may miss. What none of them met no test can know of, so that alarms under
these laws count in the whole, and are held to the history. With 0.1 fireflies a replicate, 4 % of the light, 16
replicates lack them all in a fifth of the runs.
"""
_QUIET = _gamma(0.05)


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
class Null:
    """Synthetic comparisons: the law of the noise, who has it (the other side is quiet), K and R."""

    law: str
    noisy: Noisy
    replicates: int
    reference_replicates: int

    def draw(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Ours and reference, (n, SIDE, SIDE, 3) float32 each, of one limit."""
        limit = picture(SIDE, SIDE)
        if self.law == "half black":
            limit[:, : SIDE // 2] = 0.0

        def side(count: int, noisy: bool) -> np.ndarray:
            noise = LAWS[self.law] if noisy else _QUIET
            return (limit * noise(rng, (count, SIDE, SIDE, 1))).astype(np.float32)

        return (
            side(self.replicates, self.noisy != "the reference"),
            side(self.reference_replicates, self.noisy != "ours"),
        )


@attrs.frozen
class Alarms:
    """False alarms of some runs.

    Attributes
    ----------
    runs, alarms : runs of the whole rule, and those that end BIASED.
    welch : runs in which Welch's test on the image's luminance alone has p below the level.
    """

    runs: int = 0
    alarms: int = 0
    welch: int = 0

    def __add__(self, other: "Alarms") -> "Alarms":
        """Those of both."""
        return Alarms(self.runs + other.runs, self.alarms + other.alarms, self.welch + other.welch)


def judged(pairs: Iterable[tuple[np.ndarray, np.ndarray]], *, kernel: bool = False) -> Alarms:
    """Decide each pair of (K, H, W, 3) and (R, H, W, 3) as a run of one row."""
    found = Alarms()
    for ours, reference in pairs:
        statistics = measure(ours, reference)
        tests = statistics.mean_tests if kernel else statistics.tests
        alarm = decide(statistics, tests=tests, kernel=kernel).verdict == "BIASED"
        found += Alarms(1, int(alarm), int(statistics.luminance.p_values() < LEVEL))
    return found


def ordinary(runs: int) -> list[tuple[Null, int]]:
    """Nulls in whose noise Welch's test must alarm as often as its level says, each with its share of at least `runs`.

    They are many and few: each is a batch of its own.
    """
    each = -(-runs // len(ORDINARY))
    return [
        (Null(law, "both sides", REPLICATES, REPLICATES), min(_BATCH, each - done))
        for law in ORDINARY
        for done in range(0, each, _BATCH)
    ]


def awkward(runs: int) -> list[tuple[Null, int]]:
    """All laws on all sides with all numbers of replicates, an equal share of at least `runs` each."""
    nulls = [Null(*each) for each in itertools.product(LAWS, NOISY, SIZES, SIZES)]
    return [(null, -(-runs // len(nulls))) for null in nulls]


def _batch(null: Null, runs: int, seed: tuple[int, ...]) -> Alarms:
    rng = np.random.default_rng(seed)
    return judged(null.draw(rng) for _ in range(runs))


def synthetic(
    nulls: list[tuple[Null, int]], *, seed: int, executor: Executor, report: Callable[[str, int, int], object]
) -> dict[Null, Alarms]:
    """So many runs of each null, in an executor's processes."""
    found: dict[Null, Alarms] = defaultdict(Alarms)
    seeds = ((seed, number) for number in range(len(nulls)))
    outcomes = executor.map(_batch, *zip(*nulls, strict=True), seeds)
    for done, ((null, _), alarms) in enumerate(zip(nulls, outcomes, strict=True), 1):
        found[null] += alarms
        report(null.law, done, len(nulls))
    return dict(found)


def grouped(found: dict[Null, Alarms], by: Callable[[Null], str]) -> dict[str, Alarms]:
    """Alarms of nulls that have something in common."""
    groups: dict[str, Alarms] = defaultdict(Alarms)
    for null, alarms in found.items():
        groups[by(null)] += alarms
    return dict(groups)


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
