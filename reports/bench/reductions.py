"""What each reduction is worth: `(variance · seconds with it) / (variance · seconds without)`; and it shifts no mean.

Both ways render the same replicates in turn, in batches: a batch gives one ratio of variances (between its replicates,
mean over pixels and channels) and one of processor seconds; the product is what equal error costs, below 1 a gain. The
images of all batches go through the rule of the verdicts, one way as ours and the other as the reference.
"""

import os
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import attrs
import numpy as np

from termwise.renderer import Engine, Variant, find
from termwise.renderer.plan import REDUCTIONS, needs_photons, skipped
from termwise.renderer.terms import Chain
from termwise.reports.bench.common import known, machine, positive, spread
from termwise.reports.statistics import accumulation, rule
from termwise.scenes.load import load
from termwise.scenes.model import Scene, Scope

SCENES = ("two_cubes", "cornell_box", "cornell_box_unshadowed", "monkey")
NAMES = tuple(REDUCTIONS)
RESOLUTION = 48
BATCHES = 4
_REPLICATES = 8  # of a batch
# Of each; photon maps are few, for each costs what many samples do.
_SAMPLES, _MAPS = 32, 4
# Term, variant, chain, and a scope that is not the scene's own.
_ESTIMATORS: tuple[tuple[str, str, Chain, Scope | None], ...] = (
    ("ambient", "cosine", "path", None),
    ("direct", "next-event", "next-event", None),
    ("direct", "next-event", "next-event", "first-hit"),
    ("direct", "photon-map", "next-event", None),
    ("direct", "path", "path", None),
    ("specular", "vndf", "path", None),
    ("specular", "vndf", "next-event", None),
    ("specular", "paper", "path", None),
    ("background", "seen", "next-event", None),
)


class Case(NamedTuple):
    """An reduction, and an estimator that it serves."""

    scene: Scene
    reduction: str
    variant: Variant
    chain: Chain

    @property
    def label(self) -> str:
        """The estimator, as a table calls it."""
        by_photons = needs_photons(self.scene, self.variant, self.chain) is not None
        kind = " (photons)" if by_photons and self.variant.term == "specular" else ""
        if self.variant.term == "direct" and self.scene.scope == "first-hit":
            kind = " (first hits)"
        return f"{self.variant.name}{kind}"


def measure(
    *,
    scenes: tuple[str, ...] = (),
    reductions: tuple[str, ...] = (),
    resolution: int = RESOLUTION,
    batches: int = BATCHES,
    threads: int | None = None,
    report: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> dict[str, Any]:
    """Measure all reductions; JSON values.

    Parameters
    ----------
    scenes, reductions : of `SCENES` and `NAMES`; all if none.
    resolution : pixels of a side of the square image.
    batches : of `_REPLICATES` replicates; the median of their ratios counts.
    threads : None: one a core.
    report : called with (what runs, done, total).

    Raises
    ------
    ValueError : a name or a number that is not allowed.
    """
    known("scene", scenes, SCENES)
    known("reduction", reductions, NAMES)
    positive(resolution=resolution, batches=batches, threads=1 if threads is None else threads)
    threads = threads or os.cpu_count() or 1
    chosen = list(cases(scenes or SCENES, reductions or NAMES, resolution))
    result: dict[str, Any] = {"cases": [], "machine": machine(threads)}
    result["settings"] = {"resolution": resolution, "batches": batches, "replicates": batches * _REPLICATES}
    measured = []
    for done, case in enumerate(chosen):
        report(f"{case.scene.name}: {case.reduction}", done, len(chosen))
        measured.append(_measure(case, batches, threads))
    tests = sum(statistics.tests for _, statistics in measured)
    for row, statistics in measured:
        outcome = rule.decide(statistics, tests=max(tests, 1))
        result["cases"].append(
            row
            | {"verdict": outcome.verdict, "bias": outcome.bias}
            | {"bias_low": outcome.bias_low, "bias_high": outcome.bias_high}
        )
    result["machine"]["load_end"] = os.getloadavg()[0]
    return result


def cases(scenes: tuple[str, ...], reductions: tuple[str, ...], resolution: int) -> Iterator[Case]:
    """Reductions with the estimators that they serve in each scene."""
    for name in scenes:
        whole = attrs.evolve(load(name), resolution=(resolution, resolution))
        for reduction in reductions:
            for term, estimator, chain, scope in _ESTIMATORS:
                if scope == whole.scope:
                    continue
                scene = attrs.evolve(whole, scope=scope or whole.scope)
                variant = find(term, estimator)
                by_photons = needs_photons(scene, variant, chain) is not None
                if skipped(scene, variant.term) or variant.limit(scene, 1).scope not in (None, scene.scope):
                    continue
                # A chain without photons is the same by either name.
                if term == "specular" and chain == "next-event" and not by_photons:
                    continue
                if REDUCTIONS[reduction].reason(scene, variant, chain) is not None:
                    yield Case(scene, reduction, variant, chain)


def _measure(case: Case, batches: int, threads: int) -> tuple[dict[str, Any], accumulation.Statistics]:
    """A row but for its verdict, and what decides that."""
    by_photons = needs_photons(case.scene, case.variant, case.chain) is not None
    samples = _MAPS if by_photons else _SAMPLES
    images: tuple[list[np.ndarray], list[np.ndarray]] = [], []
    variance, seconds = np.zeros((2, batches, 2))
    with (
        Engine(case.scene, threads=threads) as economical,
        Engine(case.scene, threads=threads, without=(case.reduction,)) as plain,
    ):
        engines = economical, plain
        for engine in engines:
            _render(engine, case, samples, replicate=0, seed=0)  # compiles
        for batch in range(batches):
            for replicate in range(batch * _REPLICATES, (batch + 1) * _REPLICATES):
                for side, engine in enumerate(engines):
                    begin = time.process_time()
                    # Seeds apart: the verdict compares independent sides.
                    images[side].append(_render(engine, case, samples, replicate, seed=1 + side))
                    seconds[batch, side] += time.process_time() - begin
            for side, found in enumerate(images):
                variance[batch, side] = np.var(found[-_REPLICATES:], axis=0, ddof=1).mean()
    row: dict[str, Any] = {
        "scene": case.scene.name,
        "reduction": case.reduction,
        "term": case.variant.term,
        "variant": case.label,
        "samples": samples,
    }
    with np.errstate(divide="ignore", invalid="ignore"):
        of_variance, of_seconds = variance[:, 0] / variance[:, 1], seconds[:, 0] / seconds[:, 1]
    for name, ratios in (("variance", of_variance), ("seconds", of_seconds), ("cost", of_variance * of_seconds)):
        row[name], row[f"{name}_low"], row[f"{name}_high"] = spread(ratios)
    return row, accumulation.measure(np.array(images[0], np.float32), np.array(images[1], np.float32))


def _render(engine: Engine, case: Case, samples: int, replicate: int, seed: int) -> np.ndarray:
    engine.contrasts.clear()  # each replicate pays for all that it takes
    *_, (_, image, _) = engine.prefixes(case.variant, samples=samples, seed=seed, replicate=replicate, chain=case.chain)
    return image
