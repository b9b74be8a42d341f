"""A run: measure every cell of a study against its references, decide, and write what the report reads.

scene -> plan -> (renderer | reference) -> measurements -> verdicts -> `results.json`, `results.nc`, `images/*.exr`

The level of every test depends on the number of tests of the whole run, so all rows are measured before any is decided.
Replicates are kept in the cache by content: an interrupted run goes on where it stopped, a run with nothing changed
computes nothing.
"""

import hashlib
import importlib.metadata
import json
import math
import os
import platform
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from reference import backend, store
from renderer.plan import check, plan, skipped
from renderer.terms import VARIANTS, Variant
from renderer.tiles import Engine
from reports import cells, closed_forms, exact, images, metrics, verdict
from reports.cells import Cell
from reports.convergence import PREFIXES_NEEDED, Convergence, fit, mean_square_error
from reports.exact import Case
from reports.study import Study
from reports.verdict import Estimate, Statistics, Verdict
from scenes import limits
from scenes.limits import Limit
from scenes.load import load
from scenes.model import Scene
from scenes.store import PROJECT, cache_folder, sources_digest, write_atomically
from scenes.terms import TERMS, TOTAL, Term, total

SCHEMA = 1
# Direct at the vertices of a specular chain, in all cells: kernel bias must not leak into a specular verdict.
CHAIN = "path"
# SSIM and relative MSE are means over so many replicates: more would cost seconds and change no digit that is shown.
_SHOWN_REPLICATES = 4

Report = Callable[[str, int, int], object]


@attrs.frozen(eq=False)
class _Row:
    """A measured row that waits for its verdict."""

    fields: dict[str, Any]
    statistics: Statistics | None
    decide: dict[str, Any]
    judged: bool


@attrs.frozen(eq=False)
class References:
    """Replicates of a scene's limits, (R, H, W, 3) float32 each, and the seconds that they took."""

    images: dict[Limit, np.ndarray]
    seconds: dict[Limit, float]
    spp: dict[Limit, int]
    shortfall: dict[Limit, str]

    def described(self, *limits: Limit) -> dict[str, Any]:
        """What a row says of the references that it was measured against."""
        fields: dict[str, Any] = {
            "reference_samples": self.spp[limits[0]],
            "reference_seconds": sum(self.seconds[limit] for limit in limits),
        }
        shortfall = [self.shortfall[limit] for limit in limits if limit in self.shortfall]
        return fields | ({"reference_shortfall": "; ".join(shortfall)} if shortfall else {})


def scenes_of(study: Study, names: tuple[str, ...] = ()) -> tuple[Scene, ...]:
    """Scenes of a study, or those named, at the study's resolution."""
    prepared = []
    for name in names or study.scenes:
        scene = attrs.evolve(load(name), resolution=study.resolution)
        if study.photons and study.photons < scene.photons.count:
            scene = attrs.evolve(scene, photons=attrs.evolve(scene.photons, count=study.photons))
        prepared.append(scene)
    twice = [scene.name for scene in prepared]
    for name in twice:
        if twice.count(name) > 1:
            raise ValueError(f"scenes: {name!r} is named twice: allowed are distinct names")
    return tuple(prepared)


def variants_of(study: Study, scene: Scene, term: Term) -> tuple[Variant, ...]:
    """Variants of a term that mean what the scene means: those whose limit has the scene's scope."""
    chosen = [VARIANTS[term][name] for name in study.variants_of(term)]
    return tuple(variant for variant in chosen if variant.limit(scene, 1).scope in (None, scene.scope))


def own_limit(study: Study, scene: Scene, variant: Variant) -> Limit:
    """What a variant is judged against: its twin where it estimates a density and the study renders twins."""
    samples = study.samples_of(variant)
    limit, kernel = variant.limit(scene, samples), variant.kernel(scene, samples)
    if study.twin_maps is None or kernel is None:
        return limit
    # The twin scatters diffusely, knows no shadow rule, and its roulette decides how densely the nearest photons lie.
    photons = scene.photons
    served = photons.scattering == "diffuse" and scene.shadows == "physical"
    served &= photons.survival is None or kernel.shape != "nearest"
    return attrs.evolve(limit, kernel=kernel) if served else limit


def digest(study: Study, scenes: tuple[Scene, ...], variant: str) -> str:
    """sha256 of all that decides a run's results but the speed of the machine."""
    sources = sources_digest(*(PROJECT / name for name in ("renderer", "reference", "scenes", "reports")))
    settings = (
        attrs.asdict(study),
        [(s.name, s.exposure, s.digest()) for s in scenes],
        variant,
        sources,
        versions(),
    )
    return hashlib.sha256(repr(settings).encode()).hexdigest()


def versions() -> dict[str, str]:
    """Versions of everything that makes numbers."""
    packages = ("termwise", "numba", "numpy", "scipy", "scikit-image", "mitsuba", "drjit", "xarray")
    return {"python": platform.python_version()} | {
        name: importlib.metadata.version(name) for name in packages
    }


def finished(folder: Path, fingerprint: str) -> dict[str, Any] | None:
    """The results in `folder` if they are whole and belong to this very run."""
    try:
        results = json.loads((folder / "results.json").read_text("utf-8"))
        whole = (folder / "results.nc").is_file() and (folder / "index.html").is_file()
    except (OSError, ValueError):
        return None
    return results if whole and results.get("settings", {}).get("digest") == fingerprint else None


def measure(
    study: Study, scenes: tuple[Scene, ...], folder: Path, *, name: str, report: Report
) -> dict[str, Any]:
    """Measure and judge a study; write results and images into `folder`.

    Parameters
    ----------
    study, scenes : what to measure.
    folder : made if missing.
    name : the study's name, for the report.
    report : called with (what, done, of all) as replicates come in.

    Returns
    -------
    dict
        What `results.json` holds.
    """
    for scene in scenes:
        for term in TERMS:
            for variant in variants_of(study, scene, term):
                check(scene, variant)
    chosen = backend.choose()
    waiting: list[_Row] = []
    described: dict[str, Any] = {}
    pictures = images.Pictures(folder)
    steps = sum(
        study.replicates * sum(len(variants_of(study, scene, term)) for term in TERMS)
        + study.reference_replicates * len(_limits(study, scene))
        for scene in scenes
    )
    known = list(exact.cases(study))
    steps += study.replicates * len(known)
    done = 0

    def advance(what: str) -> None:
        nonlocal done
        done += 1
        report(what, done, steps)

    for scene in scenes:
        references = _references(study, scene, advance)
        with Engine(scene) as engine:
            objects = engine.geometry().object
            measured = [
                cells.cell(
                    engine,
                    variant,
                    own=own_limit(study, scene, variant),
                    samples=study.samples_of(variant),
                    replicates=study.replicates,
                    seed=study.seed,
                    chain=CHAIN,
                    folder=cache_folder() / "cells",
                    progress=lambda scene=scene, term=term, variant=variant: advance(
                        f"{scene.name}: {term} {variant.name}"
                    ),
                )
                for term in TERMS
                for variant in variants_of(study, scene, term)
            ]
        report(f"{scene.name}: measuring", done, steps)
        waiting += _rows(study, scene, measured, references, objects)
        pictures.write(scene, measured, references.images, versions())
        described[scene.name] = _describe(study, scene)
    for case in known:
        waiting += _exact_rows(study, case, lambda case=case: advance(f"{case.name}: {case.variant.name}"))
    tests = sum(_tests(row) for row in waiting if row.judged)
    rows = [_decided(row, tests) for row in waiting]
    results = {
        "schema": SCHEMA,
        "versions": versions(),
        "settings": {
            "study": name,
            "page": study.folder,
            "digest": digest(study, scenes, chosen.variant),
            "seed": study.seed,
            "backend": chosen.variant,
            "backend_reason": chosen.reason,
            "machine": platform.machine(),
            "system": f"{platform.system()} {platform.release()}",
            "cores": os.cpu_count(),
            "command": " ".join(["termwise", *sys.argv[1:]]),
            "alpha": verdict.LEVEL,
            "tests": tests,
            "options": {
                "replicates": study.replicates,
                "reference replicates": study.reference_replicates,
                "reference samples per pixel": study.reference_spp,
                "samples per pixel of full light transport": study.physical_spp,
                "direct at the vertices of a specular chain": CHAIN,
                "what a ray ignores that leaves a face": "the same face",
                "normals": "turned towards the viewer",
                "irradiance read as": "E / pi",
                "intersection": "watertight, float64",
            },
            "scenes": described,
        },
        "cells": rows,
    }
    pictures.close()
    # A page of an earlier run must not stand beside new results, should this one end here.
    (folder / "index.html").unlink(missing_ok=True)
    text = json.dumps(plain(results), indent=1, allow_nan=False)
    write_atomically(folder / "results.json", lambda path: path.write_text(text, "utf-8"))
    return results


def _limits(study: Study, scene: Scene) -> tuple[Limit, ...]:
    """Every limit that a scene's rows are measured against, each once."""
    wanted: dict[Limit, None] = {}
    for term in TERMS:
        for variant in variants_of(study, scene, term):
            wanted[own_limit(study, scene, variant)] = None
        wanted[limits.correct(term, scene.scope)] = None
        wanted[limits.physical(term)] = None
    return tuple(wanted)


def _reference_samples(study: Study, limit: Limit) -> int:
    """Samples per pixel and replicate; of a twin, photon maps a replicate."""
    if limit.kernel is not None:
        assert study.twin_maps is not None
        return study.twin_maps
    return study.physical_spp if limit.transport == "physical" else study.reference_spp


def _references(study: Study, scene: Scene, advance: Callable[[str], None]) -> References:
    found = References({}, {}, {}, {})
    for limit in _limits(study, scene):
        kept = store.replicates(
            scene,
            limit,
            spp=_reference_samples(study, limit),
            seed=study.seed,
            count=study.reference_replicates,
            folder=cache_folder() / "reference",
            progress=lambda limit=limit: advance(f"{scene.name}: reference {limit.term}"),
        )
        found.images[limit] = kept.images
        found.seconds[limit] = float(np.sum(kept.seconds))
        found.spp[limit] = kept.spp
        if kept.shortfall:
            found.shortfall[limit] = kept.shortfall
    return found


def _rows(
    study: Study, scene: Scene, measured: list[Cell], references: References, objects: np.ndarray
) -> list[_Row]:
    names = [thing.name for thing in scene.objects]
    correct = {term: limits.correct(term, scene.scope) for term in TERMS}
    physical = {term: limits.physical(term) for term in TERMS}

    def luminance(images: np.ndarray) -> float:
        return float(np.dot(np.mean(images, axis=(0, 1, 2), dtype=np.float64), verdict.LUMINANCE))

    fallback = sum(luminance(references.images[limit]) for limit in correct.values()) or 1.0
    rows: list[_Row] = []

    def statistics(ours: np.ndarray, reference: np.ndarray, what: str = TOTAL) -> Statistics:
        try:
            return verdict.measure(ours, reference, objects=objects, object_names=names, scale=fallback)
        except ValueError as error:
            raise ValueError(f"{scene.name}: {what}: {error}") from None

    for cell in measured:
        variant = cell.variant
        term = variant.term
        own = cell.own
        reference = references.images[own]
        what = f"{term} {variant.name}"
        at_own = statistics(cell.images[:, -1], reference, what)
        # Against its twin a kernel estimate is judged like any other.
        kernel = variant.kernel_based(scene) and own.kernel is None
        judged = variant.judged or own.kernel is not None
        errors = [mean_square_error(cell.images[:, p], reference) for p in range(len(cell.samples))]
        curve = None
        if len(cell.samples) >= PREFIXES_NEEDED and not at_own.absent:
            seconds = cell.seconds.mean(axis=0)
            curve = fit(cell.samples, errors, seconds=seconds, bias_squared=at_own.bias_squared)
        base = {
            "scene": scene.name,
            "term": term,
            "variant": variant.name,
            "kind": variant.kind,
            "scope": scene.scope,
        }
        own_mean, correct_mean = luminance(reference), luminance(references.images[correct[term]])
        for p in reversed(range(len(cell.samples))):
            last = p == len(cell.samples) - 1
            rows.append(
                _row(
                    {**base, "against": "own", **_curve(curve if last else None)},
                    cell.images[:, p],
                    reference,
                    scene,
                    statistics=at_own if last else None,
                    samples=cell.samples[p],
                    seconds=float(cell.seconds[:, p].sum()),
                    compile_seconds=cell.compile_seconds if last else None,
                    error=errors[p],
                    source=references.described(own),
                    kind=variant.kind,
                    kernel=kernel,
                    allowance=variant.allowance if kernel else 0.0,
                    margin=verdict.margin_of(variant.kind, own_mean, correct_mean),
                    judged=last and judged,
                    predicted_bias=0.0 if judged else None,
                    reason=skipped(scene, term) or "the camera sees nothing of it",
                )
            )
        ratio = variant.ratio(scene)
        measured_ratio = own_mean / correct_mean if correct_mean > 0 else None
        for against, limit in (("correct", correct[term]), ("physical", physical[term])):
            predicted = ratio if against == "correct" and ratio is not None else None
            if against == "correct" and predicted is None and judged:
                predicted = measured_ratio
            if against == "physical" and variant.name != study.variants_of(term)[0]:
                continue
            rows.append(
                _row(
                    {**base, "against": against},
                    cell.images[:, -1],
                    references.images[limit],
                    scene,
                    statistics=at_own
                    if limit == own
                    else statistics(cell.images[:, -1], references.images[limit], what),
                    samples=cell.samples[-1],
                    seconds=float(cell.seconds[:, -1].sum()),
                    source=references.described(limit),
                    kind=variant.kind,
                    kernel=kernel,
                    judged=False,
                    predicted_bias=None if predicted is None else predicted - 1.0,
                )
            )
    rows += _total_rows(study, scene, measured, references, statistics)
    return rows


def _exact_rows(study: Study, case: Case, progress: Callable[[], object]) -> list[_Row]:
    """Rows of a variant against numbers that are known: its own limit's, and the right one's."""
    with Engine(case.scene) as engine:
        cell = cells.cell(
            engine,
            case.variant,
            own=case.variant.limit(case.scene, case.samples),
            samples=case.samples,
            replicates=study.replicates,
            seed=study.seed,
            chain=CHAIN,
            folder=cache_folder() / "cells",
            progress=progress,
        )
    ours = cell.images[:, -1]
    own, right = (float(np.dot(value, verdict.LUMINANCE)) for value in (case.own, case.correct))
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
                statistics=verdict.measure(ours, reference, exact=True),
                samples=cell.samples[-1],
                seconds=float(cell.seconds[:, -1].sum()),
                source={"reference_samples": None, "reference_seconds": 0.0},
                kind=case.variant.kind,
                kernel=False,
                margin=verdict.margin_of(case.variant.kind, own, right),
                judged=judged,
                predicted_bias=0.0 if judged else own / right - 1.0,
            )
        )
    return rows


def _total_rows(
    study: Study,
    scene: Scene,
    measured: list[Cell],
    references: References,
    statistics: Callable[[np.ndarray, np.ndarray], Statistics],
) -> list[_Row]:
    """Rows of the sum of the default variants; it carries the allowance of a kernel-based term."""
    default = {term: next(c for c in measured if c.variant.term == term) for term in TERMS}
    ours = total(*(default[term].images[:, -1] for term in TERMS))
    by_kernel = [
        c.variant for c in default.values() if c.variant.kernel_based(scene) and c.own.kernel is None
    ]
    kernel = bool(by_kernel)
    allowance = max((variant.allowance for variant in by_kernel), default=0.0)
    rows = []
    for against, limit_of in (
        ("own", lambda term: default[term].own),
        ("physical", limits.physical),
    ):
        chosen = tuple(limit_of(term) for term in TERMS)
        shared = min(len(references.images[limit]) for limit in chosen)
        reference = total(*(references.images[limit][:shared] for limit in chosen))
        rows.append(
            _row(
                {
                    "scene": scene.name,
                    "term": TOTAL,
                    "variant": "default",
                    "kind": "right",
                    "scope": scene.scope,
                    "against": against,
                },
                ours,
                reference,
                scene,
                statistics=statistics(ours, reference),
                samples=max(cell.samples[-1] for cell in default.values()),
                seconds=float(sum(cell.seconds[:, -1].sum() for cell in default.values())),
                source=references.described(*chosen),
                kind="right",
                kernel=kernel,
                allowance=allowance if against == "own" else 0.0,
                judged=against == "own",
                predicted_bias=0.0 if against == "own" else None,
                reason="every term is absent",
            )
        )
    return rows


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
    compile_seconds: float | None = None,
    error: Estimate | None = None,
    **decide: Any,
) -> _Row:
    """A row's metrics: of single replicates, against the mean of the reference; RMSE is freed of the latter's noise."""
    truth = np.asarray(np.mean(reference, axis=0, dtype=np.float64))
    shown = ours[:_SHOWN_REPLICATES]
    black = not truth.any()
    error = error or mean_square_error(ours, reference)
    squares = {"rmse": error.value, "rmse_low": error.low(0.05), "rmse_high": error.high(0.05)}
    fields = {
        **_curve(None),
        **fields,
        "samples": samples,
        "replicates": len(ours),
        "reference_replicates": len(reference),
        **source,
        "seconds": seconds,
        "compile_seconds": compile_seconds,
        **{name: math.sqrt(max(0.0, square)) for name, square in squares.items()},
        "relmse": None if black else float(np.mean([metrics.relative_mse(truth, image) for image in shown])),
        "ssim": _ssim(truth, shown, scene.exposure),
    }
    return _Row(fields, statistics, {**decide, "samples": samples, "seconds": seconds}, judged)


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


def _tests(row: _Row) -> int:
    assert row.statistics is not None
    return row.statistics.mean_tests if row.decide["kernel"] else row.statistics.tests


def _decided(row: _Row, tests: int) -> dict[str, Any]:
    if row.statistics is None:
        return {**row.fields, **_NOT_JUDGED}
    outcome = verdict.decide(row.statistics, tests=max(tests, 1), judged=row.judged, **row.decide).row()
    regions = outcome.pop("regions")
    return {
        **row.fields,
        **outcome,
        "channels": [region for region in regions if region["region"] == verdict.IMAGE],
        "objects": [region for region in regions if region["region"] != verdict.IMAGE],
    }


# A prefix of a run has errors, but neither bias nor verdict of its own.
_NOT_JUDGED: dict[str, Any] = dict.fromkeys(
    field.name for field in attrs.fields(Verdict) if field.name != "regions"
) | {"warnings": [], "reasons": [], "channels": [], "objects": []}


def _describe(study: Study, scene: Scene) -> dict[str, Any]:
    chosen: dict[Term, Variant] = {term: variants_of(study, scene, term)[0] for term in TERMS}
    return {
        "resolution": list(scene.resolution),
        "exposure": scene.exposure,
        "scope": scene.scope,
        "max_bounces": scene.max_bounces,
        "digest": scene.digest(),
        "objects": [thing.name for thing in scene.objects],
        "settings": {
            "triangles": sum(len(thing.mesh.faces) for thing in scene.objects),
            "ambient light": list(scene.ambient.color),
            "ambient occlusion range": scene.ambient.range
            if math.isfinite(scene.ambient.range)
            else "infinite",
            "point lights": len(scene.lights),
            "area lights": sum(thing.emits for thing in scene.objects),
            "sky": "texture" if scene.sky.texture is not None else list(scene.sky.color),
            "pixel rule": scene.camera.pixel,
            "field of view (degrees)": scene.camera.fov,
            "photons per pass": scene.photons.count,
            "radius of the first pass": scene.photons.radius,
            "k of the paper's photon search": scene.photons.nearest,
            "rings of the paper's rule": scene.rings,
            "shadows": scene.shadows,
            "lights drawn": scene.draw_lights,
            **{
                f"toggle {name.replace('_', ' ')}": value
                for name, value in attrs.asdict(scene.toggles).items()
            },
        },
        "gains": _gains(study, scene),
        "skips": [attrs.asdict(step) for step in plan(scene, chosen, chain=CHAIN)],
    }


def _gains(study: Study, scene: Scene) -> dict[str, dict[str, float]]:
    """Q of each specular variant on each glossy object, as if all light met this object (see `closed_forms.gain`)."""
    glossy = [thing for thing in scene.objects if scene.specular_weight(thing.surface) > 0.0]
    return {
        variant.name: {
            thing.name: closed_forms.gain(variant.limit(scene, 1), thing.surface) for thing in glossy
        }
        for variant in variants_of(study, scene, "specular")
    }


def failures(results: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows whose verdict against `own` proves an error."""
    return [row for row in results["cells"] if row["verdict"] in ("BIASED", "NOT AS PREDICTED")]


def plain(value: Any) -> Any:
    """JSON has no NaN, no infinity, no NumPy numbers: the first two become null."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
