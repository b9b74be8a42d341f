"""Seconds to equal error of one term: `speed-up(e) = t_Mitsuba(e) / t_ours(e)`, e = RMSE over pixels and channels.

Both sides render the same integral with the same camera on the same number of threads, each number of samples in a
render of its own, in alternating runs: our estimators of the integral, then each setting of Mitsuba's that pilot runs
found within reach of its best. RMSE is pooled over the runs; a speed-up is the median over runs of the ratio of
interpolated seconds. At each target Mitsuba has the setting that is its fastest there.

The truth is the mean of both sides' own renders with other seeds, ours much finer, weighted by inverse variance;
its remaining mean square error is taken away from every mean square, and stands in the result beside how far the two
sides differ beyond their noise: a target far above both says nothing of either. Seconds are those of rendering alone:
compilation, loading and the tracing of Mitsuba's programs stand apart.
"""

import itertools
import os
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import attrs
import numpy as np

from termwise import reference
from termwise.reference.backend import import_mitsuba
from termwise.renderer import Engine, Variant, chosen, find
from termwise.renderer.plan import powers_of_two
from termwise.renderer.terms import Chain
from termwise.reports.bench.common import BACKEND, known, machine, positive, settle, spread
from termwise.reports.bench.curves import leaders, pooled, seconds_to, targets
from termwise.scenes import limits
from termwise.scenes.limits import Limit
from termwise.scenes.load import load
from termwise.scenes.model import Scene, Scope
from termwise.scenes.terms import TABLE

SCENES = ("two_cubes", "cornell_box", "cornell_box_unshadowed", "monkey", "glass")
TERMS = ("ambient", "direct", "specular", "transmission")
RUNS = 5
RESOLUTION = 128
# Seconds that the longest run of a setting may take, about.
SECONDS = 0.25
_SEED, _TRUTH_SEED = 1, 2
# Of the truth: runs of each side, how much finer than our finest they are, and Mitsuba's samples a pixel.
_TRUTH_RUNS, _FINER, _TRUTH_SPP = 4, 2, 64
# A setting that takes so many times the best at every target is not measured again: in one run, then in two.
_REACH = 1.6, 1.2
_ENDLESS = 2**20


class Case(NamedTuple):
    """One estimator of ours on one scene; `label` is what a table calls it, and `right` the truth's own estimator."""

    scene: Scene
    scope: Scope | None
    variant: Variant
    chain: Chain
    label: str
    right: tuple[Variant, Chain]

    @property
    def limit(self) -> Limit:
        """The integral that both sides render."""
        return limits.correct(self.variant.term, self.scene.scope)

    @property
    def kernel_based(self) -> bool:
        """Whether photon kernels of a finite radius bias it."""
        return self.variant.photons(self.scene, self.chain) is not None


class Curve(NamedTuple):
    """Points of one side and setting: samples (P,), mean squares of the error (K, P), seconds (K, P)."""

    samples: tuple[int, ...]
    square: np.ndarray
    seconds: np.ndarray


class Truth(NamedTuple):
    """The image (H, W, 3) that errors are measured against.

    Attributes
    ----------
    noise : its own mean square error, by the variance between its runs.
    differ : RMS of ours minus Mitsuba's beyond their noise; 0 where noise explains all.
    """

    image: np.ndarray
    noise: float
    differ: float


def measure(
    *,
    scenes: tuple[str, ...] = (),
    terms: tuple[str, ...] = (),
    resolution: int = RESOLUTION,
    runs: int = RUNS,
    seconds: float = SECONDS,
    threads: int | None = None,
    report: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> dict[str, Any]:
    """Measure all cases; JSON values.

    Parameters
    ----------
    scenes, terms : of `SCENES` and `TERMS`; all if none.
    resolution : pixels of a side of the square image.
    runs : alternating runs of each side.
    seconds : what the longest run of a setting may take, about.
    threads : threads of each side; None: one a core.
    report : called with (what runs, done, total).

    Raises
    ------
    ValueError : a name or a number that is not allowed.
    reference.backend.BackendError : Mitsuba's `llvm_ad_rgb` cannot run here.
    """
    known("scene", scenes, SCENES)
    known("term", terms, TERMS)
    positive(resolution=resolution, runs=runs, seconds=seconds, threads=1 if threads is None else threads)
    threads = threads or os.cpu_count() or 1
    import_mitsuba(BACKEND)
    import drjit as dr  # reads which LLVM to use when it is first imported, so after the backend has chosen

    dr.set_thread_count(threads)
    chosen = list(cases(scenes or SCENES, terms or TERMS, resolution))
    result: dict[str, Any] = {"cases": [], "apart": [], "curves": [], "machine": machine(threads)}
    result["settings"] = {"resolution": resolution, "runs": runs, "seconds": seconds}
    done = 0
    # Variants of one integral share its truth and Mitsuba's pilot.
    for (name, limit), group in itertools.groupby(chosen, key=lambda case: (case.scene.name, case.limit)):
        mine = list(group)
        report(f"{name} {limit.term}", done, len(chosen))
        _compare(mine, threads=threads, runs=runs, seconds=seconds, result=result)
        done += len(mine)
    result["machine"]["load_end"] = os.getloadavg()[0]
    return result


def cases(scenes: tuple[str, ...], terms: tuple[str, ...], resolution: int) -> Iterator[Case]:
    """Our estimators that converge to the right integral, the product's defaults and unbiased ones.

    Of direct with all bounces the one that `auto` takes is labelled so.
    """
    for name in scenes:
        scene = attrs.evolve(load(name), resolution=(resolution, resolution))
        for term in terms:
            if TABLE[term].absent(scene):
                continue
            if term == "ambient":
                variant = find("ambient")
                yield Case(scene, None, variant, "path", variant.name, (variant, "path"))
            elif term == "direct":
                straight = attrs.evolve(scene, scope="first-hit")
                variant = find("direct", "next-event")
                yield Case(straight, "first-hit", variant, "path", variant.name, (variant, "path"))
                scattered, path = attrs.evolve(scene, scope="all"), find("direct", "path")
                taken = chosen(scattered, "direct").name
                for each in (variant, path):
                    label = f"{each.name} (auto)" if each.name == taken else each.name
                    yield Case(scattered, "all", each, "path", label, (path, "path"))
            else:
                variant = find(term)
                for chain in ("next-event", "path") if scene.scope == "all" else ("path",):
                    label = f"{variant.name}+{chain}" if scene.scope == "all" else variant.name
                    yield Case(scene, scene.scope, variant, chain, label, (variant, "path"))


def _compare(cases: list[Case], *, threads: int, runs: int, seconds: float, result: dict[str, Any]) -> None:
    """Append the cases and curves of estimators of one integral."""
    from termwise.reports.bench import yardstick

    scene, limit = cases[0].scene, cases[0].limit
    start = time.perf_counter()
    loaded = reference.loaded(scene)
    loading = time.perf_counter() - start
    settings = list(yardstick.settings(loaded, limit))
    with Engine(scene, threads=threads) as engine:
        counts = [_affordable(engine, case, seconds) for case in cases]
        truth = _truth(engine, cases[0], limit, finest=max(counts))
        pilots = [_ours(engine, case, count, truth, run=runs) for case, count in zip(cases, counts, strict=True)]
        first = {setting: _theirs(setting, truth, seconds, seed=_SEED + runs) for setting in settings}
        near = {setting for pilot in pilots for setting in _within_reach(pilot, first, truth, _REACH[0])}
        # Twice, for other work on the machine must not put a setting out of reach.
        for setting in settings:
            if setting in near:
                again = _theirs(setting, truth, seconds, seed=_SEED + runs + 1)
                first[setting] = _joined([first[setting], again])
        tried = {setting: curve for setting, curve in first.items() if setting in near}
        within = {setting for pilot in pilots for setting in _within_reach(pilot, tried, truth, _REACH[1])}
        kept = [setting for setting in settings if setting in within]
        counts = [
            count if case.kernel_based else _far_enough(pilot, tried, truth)
            for case, count, pilot in zip(cases, counts, pilots, strict=True)
        ]
        images: list[list[np.ndarray]] = [[] for _ in cases]
        mine: list[list[Curve]] = [[] for _ in cases]
        points: dict[Any, list[Curve]] = {setting: [] for setting in kept}
        for run in range(runs):
            for case, count, seen, curves in zip(cases, counts, images, mine, strict=True):
                curves.append(_ours(engine, case, count, truth, run=run, images=seen))
            for setting in kept:
                points[setting].append(_theirs(setting, truth, seconds, seed=_SEED + run))
        measured = {setting: _joined(each) for setting, each in points.items()}
        for case, seen, curves in zip(cases, images, mine, strict=True):
            common = {
                "scene": scene.name, "term": limit.term, "scope": case.scope, "variant": case.label,
            }  # fmt: skip
            ours = _joined(curves)
            floor = _floor(seen, truth) if case.kernel_based else None
            facts = {"compile_seconds": engine.compile_seconds, "floor": floor}
            result["curves"].append(common | {"side": "ours", "setting": case.label} | facts | _points(ours, truth))
            for setting in settings:
                curve = measured.get(setting, first[setting])
                facts = {"compile_seconds": setting.compile_seconds, "trace_seconds": setting.overhead}
                facts |= {"load_seconds": loading, "kept": setting in measured}
                result["curves"].append(
                    common | {"side": "mitsuba", "setting": setting.name} | facts | _points(curve, truth)
                )
            known_facts = {"floor": floor, "truth_rmse": truth.noise**0.5, "truth_differs": truth.differ}
            rows = list(_rows(ours, {setting.name: curve for setting, curve in measured.items()}, truth, runs))
            result["cases"] += [common | row | known_facts for row in rows]
            if not rows:
                result["apart"].append(common)


def _affordable(engine: Engine, case: Case, seconds: float) -> int:
    """Samples, a power of two, that one run can afford; compiles."""
    for count, _, spent in engine.prefixes(case.variant, samples=_ENDLESS, seed=0, replicate=0, chain=case.chain):
        # Four points at least, so that there is a curve.
        if count >= 8 and spent > seconds / 2:
            return count
    return _ENDLESS


def _truth(engine: Engine, case: Case, limit: Limit, *, finest: int) -> Truth:
    variant, chain = case.right
    samples = _FINER * finest
    ours = []
    for run in range(_TRUTH_RUNS):
        *_, (_, image, _) = engine.prefixes(variant, samples=samples, seed=_TRUTH_SEED, replicate=run, chain=chain)
        ours.append(image)
    theirs = [
        reference.replicate(case.scene, limit, spp=_TRUTH_SPP, seed=_TRUTH_SEED, replicate=run)
        for run in range(_TRUTH_RUNS)
    ]
    means, noises = zip(*(_mean_and_noise(np.array(runs, np.float64)) for runs in (ours, theirs)), strict=True)
    total = sum(noises)
    if total == 0.0:
        return Truth(means[0], 0.0, float(np.sqrt(np.mean((means[0] - means[1]) ** 2))))
    image = (noises[1] * means[0] + noises[0] * means[1]) / total
    differ = float(np.mean((means[0] - means[1]) ** 2)) - total
    return Truth(image, noises[0] * noises[1] / total, max(0.0, differ) ** 0.5)


def _mean_and_noise(runs: np.ndarray) -> tuple[np.ndarray, float]:
    """Mean of runs (K, H, W, 3), and its mean square error by the variance between them."""
    return runs.mean(axis=0), float(runs.var(axis=0, ddof=1).mean()) / len(runs)


def _ours(
    engine: Engine, case: Case, count: int, truth: Truth, *, run: int, images: list[np.ndarray] | None = None
) -> Curve:
    """One run of ours, from its finest point down; the image of that goes to `images`.

    Threads that have slept, or work for less than a millisecond at a time, may share a core: behind the pause, 1 to 32
    samples took 1.6 to 1.9 times as long in this order as behind 30 ms of work (`two_cubes`, first hits).
    """
    square, seconds = [], []
    settle()
    numbers = tuple(powers_of_two(count))
    for number in reversed(numbers):
        engine.contrasts.clear()  # what an earlier run has found is paid for again
        ((_, image, spent),) = engine.prefixes(
            case.variant, samples=number, seed=_SEED, replicate=run, chain=case.chain, counts=(number,)
        )
        square.append(_mean_square(image, truth))
        seconds.append(spent)
        if images is not None and number == count:
            images.append(image)
    return Curve(numbers, np.array([square[::-1]]), np.array([seconds[::-1]]))


def _theirs(setting: Any, truth: Truth, seconds: float, *, seed: int) -> Curve:
    """One run of a setting of Mitsuba's: a pilot climbs, to two points at least, and later runs go down from its end.

    Our threads sleep already.
    """
    from termwise.reports.bench import yardstick

    points: dict[int, tuple[float, float]] = {}

    def measure(count: int) -> float:
        image, took = setting.render(count, seed)
        points[count] = _mean_square(image, truth), took
        return took

    if setting.ladder is None:
        spent, last = 0.0, 1
        for count in map(setting.samples, yardstick.LADDER):
            if count in points:
                continue
            if len(points) > 1 and spent * count / last > seconds:
                break
            spent, last = measure(count), count
        setting.ladder = tuple(points)
    else:
        for count in reversed(setting.ladder):
            measure(count)
    square, took = zip(*(points[count] for count in setting.ladder), strict=True)
    return Curve(setting.ladder, np.array([square]), np.array([took]))


def _mean_square(image: np.ndarray, truth: Truth) -> float:
    return float(np.mean((image - truth.image) ** 2))


def _joined(curves: list[Curve]) -> Curve:
    return Curve(
        curves[0].samples,
        np.concatenate([curve.square for curve in curves]),
        np.concatenate([curve.seconds for curve in curves]),
    )


def _known(curves: dict[Any, Curve], truth: Truth) -> dict[Any, tuple[list[float], list[float]]]:
    """What pilots say of settings: (RMSE, the least seconds) of each number of samples."""
    return {
        setting: (list(pooled(curve.square, truth.noise)), list(curve.seconds.min(axis=0)))
        for setting, curve in curves.items()
    }


def _far_enough(ours: Curve, theirs: dict[Any, Curve], truth: Truth) -> int:
    """Samples with which ours has the least error of what may be Mitsuba's best, where it gets so far."""
    known = list(_known(theirs, truth).values())
    if not known:  # no error that both sides reach
        return ours.samples[-1]
    least = max(min(known[place][0]) for place in leaders(known, _REACH[1]))
    errors = zip(ours.samples, pooled(ours.square, truth.noise), strict=True)
    return next((samples for samples, error in errors if error <= least), ours.samples[-1])


def _within_reach(ours: Curve, theirs: dict[Any, Curve], truth: Truth, reach: float) -> list[Any]:
    """Settings that were found to take at most `reach` times as long as Mitsuba's best at one target at least."""
    known = _known(theirs, truth)
    kept = []
    for target in _targets(list(pooled(ours.square, truth.noise)), list(known.values())):
        times = {setting: seconds_to(target, *curve) for setting, curve in known.items()}
        best = min(times.values())
        kept += [setting for setting, spent in times.items() if spent <= reach * best]
    return [setting for setting in theirs if setting in kept]


def _targets(ours: list[float], theirs: list[tuple[list[float], list[float]]]) -> tuple[float, ...]:
    """Errors within reach of ours and of what may be Mitsuba's best, by curves (RMSE, seconds) of its settings."""
    return targets(ours, [theirs[place][0] for place in leaders(theirs, _REACH[1])]) if theirs else ()


def _rows(ours: Curve, theirs: dict[str, Curve], truth: Truth, runs: int) -> Iterator[dict[str, Any]]:
    """Seconds of both sides at the targets."""
    mine = list(pooled(ours.square, truth.noise))
    errors = {name: list(pooled(curve.square, truth.noise)) for name, curve in theirs.items()}
    middle = {name: list(np.median(curve.seconds, axis=0)) for name, curve in theirs.items()}
    for target in _targets(mine, [(errors[name], middle[name]) for name in theirs]):
        their_times = {
            name: [seconds_to(target, errors[name], list(curve.seconds[run])) for run in range(runs)]
            for name, curve in theirs.items()
        }
        name = min(their_times, key=lambda name: float(np.median(their_times[name])))
        my_times = [seconds_to(target, mine, list(ours.seconds[run])) for run in range(runs)]
        ratios = spread(their / my for their, my in zip(their_times[name], my_times, strict=True))
        yield {
            "target_rmse": target,
            "ours_s": spread(my_times)[0],
            "mitsuba_s": spread(their_times[name])[0],
            "mitsuba_setting": name,
            "speedup": ratios[0],
            "speedup_low": ratios[1],
            "speedup_high": ratios[2],
        }


def _points(curve: Curve, truth: Truth) -> dict[str, Any]:
    middle, low, high = zip(*(spread(column) for column in curve.seconds.T), strict=True)
    return {
        "samples": list(curve.samples),
        "rmse": pooled(curve.square, truth.noise).tolist(),
        "seconds": list(middle),
        "seconds_low": list(low),
        "seconds_high": list(high),
    }


def _floor(images: list[np.ndarray], truth: Truth) -> float | None:
    """RMS bias of the finest images, freed of their noise and the truth's: what more samples mend slowly, if at all."""
    if len(images) < 2:
        return None
    mean, noise = _mean_and_noise(np.array(images))
    return max(0.0, _mean_square(mean, truth) - noise - truth.noise) ** 0.5
