"""Rows of a run: what a variant is measured to be against each of its references, then decided once all are known.

The level of every test depends on the number of tests of the whole run, so a row is a `Measurement` first.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import attrs
import numpy as np

from termwise.reference import store
from termwise.renderer.plan import skipped
from termwise.reports.jobs.cells import Cell
from termwise.reports.statistics import accumulation, jackknife, metrics, replicates, rule, tiles, verdict
from termwise.reports.statistics.accumulation import Statistics
from termwise.reports.statistics.convergence import PREFIXES_NEEDED, Convergence, fit, mean_square_error
from termwise.reports.statistics.headline import headline
from termwise.reports.statistics.jackknife import Estimate
from termwise.reports.statistics.verdict import Verdict
from termwise.reports.study import audits
from termwise.reports.study.exact import Case
from termwise.reports.study.subjects import Subject, exact_part
from termwise.scenes import limits
from termwise.scenes.limits import Limit
from termwise.scenes.model import Scene
from termwise.scenes.terms import TERMS, TOTAL, Term, total

# SSIM and relative MSE are means over so many replicates: more would cost seconds and change no digit that is shown.
_SHOWN_REPLICATES = 4

Compare = Callable[[np.ndarray, np.ndarray, str], Statistics]


@attrs.frozen(eq=False)
class Measurement:
    """A row that is measured and waits for its verdict.

    Attributes
    ----------
    fields : of the row, all but what the verdict says.
    statistics : what the verdict is made of; None for a prefix of a run, which has none of its own.
    decide : further arguments of `rule.decide`.
    judged : whether a verdict is due.
    scene, limits : that it was measured on and against.
    """

    fields: dict[str, Any]
    statistics: Statistics | None
    decide: dict[str, Any]
    judged: bool
    scene: Scene
    limits: tuple[Limit, ...]


@attrs.frozen(eq=False)
class References:
    """Replicates of what a subject is measured against.

    Attributes
    ----------
    rendered : of each limit of its scene.
    correct : of each term, the true integral in the unchanged scene.
    """

    rendered: dict[Limit, store.Replicates]
    correct: dict[Term, store.Replicates]


def _row(
    fields: dict[str, Any],
    ours: np.ndarray,
    reference: np.ndarray,
    scene: Scene,
    *,
    statistics: Statistics | None,
    samples: int,
    seconds: float,
    source: dict[str, Any],
    judged: bool,
    limits: tuple[Limit, ...] = (),
    replicate_seconds: list[float] | None = None,
    compile_seconds: float | None = None,
    error: Estimate | None = None,
    **decide: Any,
) -> Measurement:
    """A row's metrics: of single replicates, against the mean of the reference; RMSE is freed of the latter's noise."""
    truth = np.asarray(np.mean(reference, axis=0, dtype=np.float64))
    shown = ours[:_SHOWN_REPLICATES]
    black = not truth.any()
    error = error or mean_square_error(ours, reference)
    squares = {"rmse": error.value, "rmse_low": error.low(0.05), "rmse_high": error.high(0.05)}
    fields = {
        **_curve(None),
        "split": None,
        **fields,
        "samples": samples,
        "replicates": len(ours),
        "reference_replicates": len(reference),
        **source,
        "seconds": seconds,
        "replicate_seconds": replicate_seconds,
        "compile_seconds": compile_seconds,
        **{name: math.sqrt(max(0.0, square)) for name, square in squares.items()},
        "relmse": None if black else float(np.mean([metrics.relative_mse(truth, image) for image in shown])),
        "ssim": _ssim(truth, shown, scene.exposure),
    }
    decided = {**decide, "samples": samples, "seconds": seconds}
    return Measurement(fields, statistics, decided, judged, scene, limits)


def _ssim(truth: np.ndarray, shown: np.ndarray, exposure: float) -> float | None:
    if min(truth.shape[:2]) < metrics.SSIM_WINDOW:
        return None
    return float(np.mean([metrics.ssim(truth, image, exposure=exposure) for image in shown]))


def _curve(curve: Convergence | None) -> dict[str, Any]:
    if curve is None:
        return dict.fromkeys(("slope", "slope_low", "slope_high", "floor", "cause"))
    slope = curve.slope
    return {
        "slope": None if slope is None else slope.value,
        "slope_low": None if slope is None else slope.low(0.05),
        "slope_high": None if slope is None else slope.high(0.05),
        "floor": curve.floor.value,
        "cause": curve.cause,
    }


def _described(*used: store.Replicates) -> dict[str, Any]:
    """What a row says of the references that it was measured against."""
    fields: dict[str, Any] = {
        "reference_samples": used[0].spp,
        "reference_seconds": float(sum(np.sum(each.seconds) for each in used)),
    }
    shortfall = "; ".join(each.shortfall for each in used if each.shortfall)
    return fields | ({"reference_shortfall": shortfall} if shortfall else {})


def _identity(subject: Subject, term: str, variant: str, kind: str, against: str) -> dict[str, Any]:
    return {
        "scene": subject.scene.name,
        "base": subject.base.name if subject.base else None,
        "setting": subject.setting.name if subject.setting else None,
        "term": term,
        "variant": variant,
        "kind": kind,
        "scope": subject.scene.scope,
        "against": against,
    }


def cell_rows(subject: Subject, measured: list[Cell], rendered: References, compare: Compare) -> list[Measurement]:
    """Rows of variants: each prefix against its own limit, the last against the true integral and light transport."""
    scene = subject.scene
    rows: list[Measurement] = []
    for cell in measured:
        variant = cell.variant
        term = variant.term
        own, correct = rendered.rendered[cell.own], rendered.correct[term]
        what = f"{term} {variant.name}"
        at_own = compare(cell.images[:, -1], own.images, what)
        # Against its kernel reference a kernel estimate is judged like any other.
        kernel = variant.kernel_based(scene) and cell.own.kernel is None
        judged = variant.judged or cell.own.kernel is not None
        allowance = _allowance(scene, [cell], rendered, compare)
        kind = variant.kind if subject.setting is None else "wrong"
        errors = [mean_square_error(cell.images[:, p], own.images) for p in range(len(cell.samples))]
        curve = None
        if len(cell.samples) >= PREFIXES_NEEDED and not at_own.absent:
            seconds = cell.seconds.mean(axis=0)
            curve = fit(cell.samples, errors, seconds=seconds, bias_squared=at_own.bias_squared)
        own_mean, correct_mean = mean_luminance(own.images), mean_luminance(correct.images)
        for p in reversed(range(len(cell.samples))):
            last = p == len(cell.samples) - 1
            rows.append(
                _row(
                    _identity(subject, term, variant.name, kind, "own") | _curve(curve if last else None),
                    cell.images[:, p],
                    own.images,
                    scene,
                    statistics=at_own if last else None,
                    samples=cell.samples[p],
                    seconds=float(cell.seconds[:, p].sum()),
                    replicate_seconds=cell.seconds[:, p].tolist() if last else None,
                    compile_seconds=cell.compile_seconds if last else None,
                    error=errors[p],
                    source=_described(own),
                    limits=(cell.own,),
                    kind=kind,
                    kernel=kernel,
                    allowance=allowance,
                    margin=rule.margin_of(kind, own_mean, correct_mean),
                    judged=last and judged,
                    predicted_bias=0.0 if judged else None,
                    reason=skipped(scene, term) or "the camera sees nothing of it",
                )
            )
        ratio = variant.ratio(scene) if subject.setting is None else None
        if ratio is None and judged and correct_mean > 0:
            ratio = own_mean / correct_mean
        others = [("correct", subject.correct(term), correct, ratio)]
        # The first variant, the product's own: how far the paper's decomposition is from light transport.
        if subject.setting is None and variant is subject.variants[term][0]:
            physical = limits.physical(term)
            others.append(("physical", physical, rendered.rendered[physical], None))
        for against, limit, kept, predicted in others:
            fields = _identity(subject, term, variant.name, kind, against)
            if against == "physical" and not at_own.absent:
                fields["split"] = _split(cell, own.images, kept.images)
            rows.append(
                _row(
                    fields,
                    cell.images[:, -1],
                    kept.images,
                    scene,
                    statistics=at_own if kept is own else compare(cell.images[:, -1], kept.images, what),
                    samples=cell.samples[-1],
                    seconds=float(cell.seconds[:, -1].sum()),
                    source=_described(kept),
                    limits=(limit,),
                    kind=kind,
                    kernel=kernel,
                    judged=False,
                    predicted_bias=None if predicted is None else predicted - 1.0,
                )
            )
    return rows


def _allowance(scene: Scene, taken: list[Cell], rendered: References, compare: Compare) -> float:
    """What a row made of cells is allowed for the light that photons stand for, where that has the largest share.

    In the image and the objects, in each channel: δ's own places and scales.
    """
    kernels = {cell.own: cell.variant for cell in taken if cell.variant.kernel_based(scene) and not cell.own.kernel}
    most = max((variant.allowance for variant in kernels.values()), default=0.0)
    exact = {own: exact_part(scene, variant, own) for own, variant in kernels.items()}
    if most == 0.0 or None in exact.values():
        return most

    def images(chosen: list[Limit]) -> np.ndarray:
        stacks = [rendered.rendered[limit].images for limit in chosen]
        return stacks[0] if len(stacks) == 1 else of_sum(stacks)

    own = [cell.own for cell in taken]
    without = compare(images([exact.get(limit) or limit for limit in own]), images(own), "light without photons")
    return most * min(1.0, max(0.0, -float(without.regions.bias.min())))


def _split(cell: Cell, own: np.ndarray, physical: np.ndarray) -> dict[str, list[float]]:
    """Parts of one replicate's mean square error against full light transport: value and 90 % interval, radiance².

    With what rounding to float32 has of the bias.
    """
    ours = cell.images[:, -1]
    parts = attrs.asdict(jackknife.split_error(ours, own, physical), recurse=False)
    parts["float_error"] = jackknife.float_error(ours, np.stack([cell.rendered(k) for k in range(len(ours))]))
    return {name: [part.value, part.low(0.05), part.high(0.05)] for name, part in parts.items()}


def total_rows(subject: Subject, measured: list[Cell], rendered: References, compare: Compare) -> list[Measurement]:
    """Rows of the sum of the default variants; its allowance is that of a kernel-based term."""
    scene = subject.scene
    default = dict(zip(TERMS, measured, strict=True))
    ours = of_sum([default[term].images[:, -1] for term in TERMS])
    by_kernel = any(c.variant.kernel_based(scene) and c.own.kernel is None for c in default.values())
    judged = all(cell.variant.judged or cell.own.kernel for cell in default.values())
    kind = "right" if subject.setting is None else "wrong"

    def summed(chosen: list[store.Replicates]) -> np.ndarray:
        return of_sum([kept.images for kept in chosen])

    against = {"own": [rendered.rendered[default[term].own] for term in TERMS]}
    if subject.setting is None:
        against["physical"] = [rendered.rendered[limits.physical(term)] for term in TERMS]
    else:
        against["correct"] = [rendered.correct[term] for term in TERMS]
    means = {name: mean_luminance(summed(chosen)) for name, chosen in against.items()}
    right = means.get("correct", means["own"])
    allowance = _allowance(scene, list(default.values()), rendered, compare)
    seconds = np.sum([_grouped(c.seconds[:, -1], len(ours)).sum(axis=1) for c in default.values()], axis=0)
    rows = []
    for name, chosen in against.items():
        reference = summed(chosen)
        predicted = {"own": 0.0, "correct": means["own"] / right - 1.0 if right > 0 else None}.get(name)
        rows.append(
            _row(
                _identity(subject, TOTAL, "default", kind, name),
                ours,
                reference,
                scene,
                statistics=compare(ours, reference, TOTAL),
                samples=max(cell.samples[-1] for cell in default.values()),
                seconds=float(seconds.sum()),
                replicate_seconds=seconds.tolist() if name == "own" else None,
                source=_described(*chosen),
                limits=tuple(default[term].own for term in TERMS) if name == "own" else (),
                kind=kind,
                kernel=by_kernel,
                allowance=allowance if name == "own" else 0.0,
                margin=rule.margin_of(kind, means["own"], right),
                judged=name == "own" and judged,
                predicted_bias=predicted if judged else None,
                reason="every term is absent",
            )
        )
    return rows


def of_sum(stacks: Sequence[np.ndarray]) -> np.ndarray:
    """Replicates of the sum of the terms: as many as the term with the fewest has, others averaged in equal groups.

    `stacks` : (K, H, W, 3) of each term, in the order of `TERMS`; the K may differ.
    """
    shared = min(len(stack) for stack in stacks)
    return total(*(stack if len(stack) == shared else _grouped(stack, shared).mean(axis=1) for stack in stacks))


def _grouped(values: np.ndarray, groups: int) -> np.ndarray:
    """(groups, K // groups, ...) of the first of K values."""
    each = len(values) // groups
    return values[: groups * each].reshape(groups, each, *values.shape[1:])


def exact_rows(case: Case, cell: Cell) -> list[Measurement]:
    """Rows against the variant's own limit and against the right one."""
    ours = cell.images[:, -1]
    own, right = (float(np.dot(value, replicates.LUMINANCE)) for value in (case.own, case.correct))
    rows = []
    for against, value in (("own", case.own), ("correct", case.correct)):
        judged = against == "own"
        reference = np.broadcast_to(value, (1, *ours.shape[1:]))
        rows.append(
            _row(
                {
                    "scene": case.name,
                    "term": case.variant.term,
                    "variant": case.variant.name,
                    "kind": case.variant.kind,
                    "scope": case.scene.scope,
                    "against": against,
                    "group": case.group,
                    "at": case.at,
                    "gain": case.gain,
                    "expected": value.tolist(),
                },
                ours,
                reference,
                case.scene,
                statistics=accumulation.measure(ours, reference, exact=True),
                samples=cell.samples[-1],
                seconds=float(cell.seconds[:, -1].sum()),
                replicate_seconds=cell.seconds[:, -1].tolist() if judged else None,
                source={"reference_samples": None, "reference_seconds": 0.0},
                kind=case.variant.kind,
                kernel=False,
                margin=rule.margin_of(case.variant.kind, own, right),
                judged=judged,
                predicted_bias=0.0 if judged else own / right - 1.0,
            )
        )
    return rows


def mean_luminance(images: np.ndarray) -> float:
    """Of replicates (K, H, W, 3), over all pixels."""
    return float(np.dot(np.mean(images, axis=(0, 1, 2), dtype=np.float64), replicates.LUMINANCE))


def tests_of(row: Measurement) -> int:
    """How many tests a judged row takes of the run's level."""
    assert row.statistics is not None
    return row.statistics.mean_tests if row.decide["kernel"] else row.statistics.tests


def tile_maps(row: Measurement) -> dict[int, tiles.TileMap] | None:
    """Of a row that is judged and has light."""
    if row.statistics is None or not row.judged or row.statistics.absent:
        return None
    return tiles.tile_maps(row.statistics)


def decided(row: Measurement, tests: int, audited: list[dict[str, Any]], looks: int = 1) -> dict[str, Any]:
    """The row as results have it: what was measured, and what the verdict says.

    Parameters
    ----------
    tests, looks : of the run, see `rule.decide`.
    audited : what became of the references of all scenes; one that failed judges nobody.
    """
    word, failed = audits.findings(audited, row.scene, row.limits)
    fields = {**row.fields, "reference_audit": word}
    if row.statistics is None:
        return {**fields, **_NOT_JUDGED}
    judged = row.judged and not failed
    found = rule.decide(row.statistics, tests=max(tests, 1), looks=looks, judged=judged, **row.decide)
    outcome: dict[str, Any] = found.row() | {"headline": headline(found, row.statistics) if judged else None}
    if row.judged and failed:
        why = "its reference failed an audit"
        sentence = f"{verdict.NO_VERDICT}: {why}: {'; '.join(failed)}."
        outcome |= {"verdict": verdict.NO_VERDICT, "reasons": failed, "sentence": sentence, "headline": why}
    regions = outcome.pop("regions")
    return {
        **fields,
        **outcome,
        "channels": [region for region in regions if region["region"] == accumulation.IMAGE],
        "objects": [region for region in regions if region["region"] != accumulation.IMAGE],
        "tiles": [] if (maps := tile_maps(row)) is None else tiles.summary(maps),
    }


# A prefix of a run has errors, but neither bias nor verdict of its own.
_NOT_JUDGED: dict[str, Any] = dict.fromkeys(
    field.name for field in attrs.fields(Verdict) if field.name != "regions"
) | {"headline": None, "warnings": [], "reasons": [], "tolerated": [], "channels": [], "objects": [], "tiles": []}
