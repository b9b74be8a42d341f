"""A run: measure every cell of a study against its references, decide, and write what the report reads.

scene -> plan -> (renderer | reference) -> measurements -> verdicts -> `results.json`, `results.nc`, `images/*.exr`

The level of every test depends on the number of tests of the whole run, so all rows are measured before any is decided;
with a budget, undecided ones are then measured again with more replicates (see `reports.statistics.sequential`).
Replicates are kept in the cache by content: an interrupted run goes on where it stopped, a run with nothing changed
computes nothing.
"""

import hashlib
import json
import math
import os
import platform
import shlex
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from termwise.reference import backend, shared, store
from termwise.renderer import photon_map
from termwise.renderer.plan import plan, skipped
from termwise.renderer.terms import Chain, Variant, registered
from termwise.renderer.tiles import Engine
from termwise.reports.jobs import cells
from termwise.reports.jobs.cells import Cell
from termwise.reports.machine import processor, versions
from termwise.reports.results import netcdf
from termwise.reports.results import schema as stored
from termwise.reports.statistics import (
    accumulation,
    jackknife,
    metrics,
    replicates,
    rule,
    sequential,
    tiles,
    verdict,
)
from termwise.reports.statistics.accumulation import Statistics
from termwise.reports.statistics.convergence import (
    PREFIXES_NEEDED,
    Convergence,
    extrapolate,
    fit,
    mean_square_error,
    relative_error,
)
from termwise.reports.statistics.jackknife import Estimate
from termwise.reports.statistics.sequential import Item, Ledger
from termwise.reports.statistics.verdict import Verdict
from termwise.reports.study import audits as references
from termwise.reports.study import closed_forms, exact, kernel_bias
from termwise.reports.study.exact import Case
from termwise.reports.study.study import Study
from termwise.reports.study.subjects import CHAIN, Subject, own_limit, subjects
from termwise.scenes import limits
from termwise.scenes.limits import Limit
from termwise.scenes.model import Scene
from termwise.scenes.store import ROOT, cache_folder, sources_digest, write_atomically
from termwise.scenes.terms import TERMS, TOTAL, Term, total

# SSIM and relative MSE are means over so many replicates: more would cost seconds and change no digit that is shown.
_SHOWN_REPLICATES = 4
_RINGS = 8  # times the samples a pixel of other references
# Of the replicates of a reference at the first look, where Mitsuba has no fast backend.
_SCALAR_SECONDS = 60.0

Report = Callable[[str, int, int], object]
Compare = Callable[[np.ndarray, np.ndarray, str], Statistics]


@attrs.frozen(eq=False)
class _Row:
    """A measured row that waits for its verdict."""

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


def _described(*used: store.Replicates) -> dict[str, Any]:
    """What a row says of the references that it was measured against."""
    fields: dict[str, Any] = {
        "reference_samples": used[0].spp,
        "reference_seconds": float(sum(np.sum(each.seconds) for each in used)),
    }
    shortfall = "; ".join(each.shortfall for each in used if each.shortfall)
    return fields | ({"reference_shortfall": shortfall} if shortfall else {})


def digest(study: Study, scenes: tuple[Scene, ...], variant: str) -> str:
    """sha256 of all that decides a run's results but the speed of the machine; new each time with registered ones."""
    sources = sources_digest(*(ROOT / name for name in ("renderer", "reference", "scenes", "reports")))
    settings = (
        attrs.asdict(study),
        [(s.name, s.exposure, s.digest()) for s in scenes],
        variant,
        sources,
        versions(),
        [time.time_ns() for term in TERMS if set(registered(term)) & set(study.variants_of(term))],
    )
    return hashlib.sha256(repr(settings).encode()).hexdigest()


def finished(folder: Path, fingerprint: str) -> dict[str, Any] | None:
    """The results in `folder` if they are this very run's and no scene failed; a ValueError says what is damaged."""
    if not (folder / "index.html").is_file() or not (folder / stored.NAME).is_file():
        return None
    found = stored.read(folder)
    stored.check_images(folder)
    ended = found["settings"].get("digest") == fingerprint and not found.get("failed")
    return found if ended else None


def measure(
    study: Study,
    scenes: tuple[Scene, ...],
    folder: Path,
    *,
    name: str,
    report: Report,
    arguments: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Measure and judge a study; write results and images into `folder`.

    Parameters
    ----------
    study, scenes : what to measure.
    folder : made if missing.
    name : the study's name, for the report.
    report : called with (what, done, of all) as replicates come in.
    arguments : what a command names them by: {"study": its name or file, "scenes": {name: name or file}}.

    Returns
    -------
    dict
        What `results.json` holds.
    """
    measured_subjects = list(subjects(study, scenes))
    chosen = backend.choose()
    extrapolations: list[dict[str, Any]] = []
    pictures = netcdf.Pictures(folder)
    known = list(exact.cases(study))
    takes = _Takes(study, report)
    takes.expect(
        study.replicates * len(known)
        + sum(
            study.replicates * len(_estimates(study, subject))
            + study.reference_replicates * len(_limits(study, subject))
            for subject in measured_subjects
        )
    )
    sources: dict[str, _Source] = {}
    described: dict[str, Any] = {}
    groups: list[_Group] = []
    audits: list[references.Audit] = []

    def measure_subject(subject: Subject) -> None:
        scene_name = subject.scene.name
        source = sources[scene_name] = _Source(takes, subject, sources.get(subject.unchanged.name))
        measured = source.measure()
        made, checked = source.groups(measured), source.audits()
        sweeps = [netcdf.sweep(cell) for cell in measured]
        pictures.write(subject, measured, sweeps, *source.images(), source.objects, versions())
        described[scene_name] = _describe(study, subject, measured)
        extrapolations.extend(_extrapolations(takes, subject, source.rendered))
        groups.extend(made)
        audits.extend(checked)

    failed = _each(measured_subjects, measure_subject)
    described = {scene: about for scene, about in described.items() if scene not in failed}
    groups += [_exact_group(takes, case) for case in known]
    tests = sum(_tests(row) for group in groups for row in group.rows if row.judged)
    audited = references.decide(audits)
    looks = 1
    if study.budget is not None:
        looks = len(sequential.LOOKS)
        for group in groups:
            group.tests, group.audited = tests, audited
        undecided = [group for group in groups if group.judged and not group.decided]
        sequential.go_on(undecided, takes.ledger, study.budget)
        for scene_name, source in sources.items():
            if source.extended:
                measured, sweeps = source.extend()
                pictures.write(source.subject, measured, sweeps, *source.images(), source.objects, versions())
                described[scene_name]["work"] = _work(measured)
    decided = [[_decided(row, tests, audited, looks) for row in group.rows] for group in groups]
    rows = [row for found in decided for row in found]
    certified = [
        group.wanted(group.factor)
        for group, found in zip(groups, decided, strict=True)
        if any(row["verdict"] in _CERTIFIED for row in found)
    ]
    results = {
        "schema": stored.SCHEMA,
        "versions": versions(),
        "settings": {
            "study": name,
            "page": study.folder,
            "digest": digest(study, scenes, chosen.variant),
            "seed": study.seed,
            "backend": chosen.variant,
            "backend_reason": chosen.reason,
            "processor": processor(),
            "machine": platform.machine(),
            "system": f"{platform.system()} {platform.release()}",
            "cores": os.cpu_count(),
            "command": shlex.join(["termwise", *sys.argv[1:]]),
            "arguments": arguments or {"study": name, "scenes": {}},
            "alpha": verdict.LEVEL,
            "tests": tests,
            "certified": {
                "margin": verdict.MARGIN,
                "rows": len(certified),
                "of": sum(row["verdict"] not in (None, "ABSENT") for row in rows),
                "seconds": takes.ledger.took("ours", certified),
                "reference_seconds": takes.ledger.took("reference", certified),
                "compile_seconds": sum(row["compile_seconds"] or 0.0 for row in rows),
                "budget": study.budget,
                "spent": takes.ledger.spent,
                "looks": [factor * study.replicates for factor in sequential.LOOKS[:looks]],
            },
            "options": {
                "replicates": study.replicates,
                "reference replicates": study.reference_replicates,
                "reference samples per pixel": study.reference_spp,
                "samples per pixel of full light transport": study.physical_spp,
                "direct at the vertices of a specular chain": CHAIN,
            },
            "scenes": described,
        },
        "failed": [{"scene": scene, "error": error} for scene, error in failed.items()],
        "cells": rows,
        "extrapolations": extrapolations,
        "audits": audited,
    }
    for scene_name in described:
        found_maps = {
            (row.fields["term"], row.fields["variant"]): maps
            for row in (row for group in groups for row in group.rows)
            if row.fields["scene"] == scene_name and (maps := _tile_maps(row)) is not None
        }
        pictures.locate(scene_name, found_maps)
    pictures.close()
    # A page of an earlier run must not stand beside new results, should this one end here.
    (folder / "index.html").unlink(missing_ok=True)
    text = json.dumps(plain(results), indent=1, allow_nan=False)
    write_atomically(folder / "results.json", lambda path: path.write_text(text, "utf-8"))
    return results


def _each(every: list[Subject], measure_subject: Callable[[Subject], None]) -> dict[str, str]:
    """Measure each subject; returns those that failed, by scene, with the reason: the others' results stand.

    What concerns the whole run is raised: a disk without room, the failure of all.
    """
    failed: dict[str, str] = {}
    first: Exception | None = None
    for subject in every:
        name, unchanged = subject.scene.name, subject.unchanged.name
        if unchanged in failed:
            failed[name] = f"{unchanged}, which it changes, failed"
            continue
        try:
            measure_subject(subject)
        except OSError:
            raise
        except Exception as error:
            first = first or error
            reason = " ".join(str(error).split()).removeprefix(f"{name}: ")
            failed[name] = reason if isinstance(error, ValueError) else f"{type(error).__name__}: {reason}"
    if first is not None and len(failed) == len(every):
        raise ValueError(": ".join(next(iter(failed.items())))) from first
    return failed


def _limits(study: Study, subject: Subject) -> tuple[Limit, ...]:
    """Every limit of its scene that a subject's rows are measured against, each once."""
    wanted: dict[Limit, None] = {}
    for term in TERMS:
        for variant in subject.variants[term]:
            wanted[own_limit(study, subject, variant)] = None
        if subject.base is None:
            wanted[subject.correct(term)] = None
            wanted[limits.physical(term)] = None
    return tuple(wanted)


def _estimates(study: Study, subject: Subject) -> list[Variant]:
    """The variants of a subject, and those of them that are measured again at each of the study's radii."""
    every = [variant for term in TERMS for variant in subject.variants[term]]
    return every + [variant for variant in _of_radius(subject) for _ in study.radii]


def _reference_samples(study: Study, limit: Limit) -> int:
    """Samples per pixel and replicate; of a twin, photon maps a replicate."""
    if limit.kernel is not None:
        assert study.twin_maps is not None
        # The paper's own estimate is to be told from one that is right, 1 to 2 % away.
        paper = limit.kernel.shape == "nearest" and limit.kernel.scale == 1.0
        return study.twin_maps * (2 if paper else 1)
    if limit.transport == "physical":
        return study.physical_spp
    # Rings cannot be drawn where the lobe is: their reference is as noisy as the estimator.
    return study.reference_spp * (_RINGS if limit.term == "specular" and limit.rings else 1)


class _Takes:
    """Takes replicates for a run: the cache gives them or keeps them, the ledger knows their seconds."""

    def __init__(self, study: Study, report: Report) -> None:
        self.study = study
        self.ledger = Ledger()
        self._report, self._done, self._steps = report, 0, 0
        # By scene and key: no disk keeps what estimators in Python compute.
        self._python: dict[tuple[str, str], Cell] = {}
        self._compile_seconds: dict[tuple[str, str], float] = {}

    def expect(self, replicates: int) -> None:
        """Announce replicates that will be taken."""
        self._steps += replicates

    def say(self, what: str) -> None:
        """Report what is going on."""
        self._report(what, self._done, self._steps)

    def _advance(self, what: str) -> None:
        self._done += 1
        self.say(what)

    def cell(
        self,
        engine: Engine,
        variant: Variant,
        *,
        own: Limit,
        samples: int,
        chain: Chain,
        what: str,
        factor: int = 1,
        swept: bool = True,
    ) -> Cell:
        """`factor` times the replicates of the study; their compilation is that of all looks."""
        settings: dict[str, Any] = {"samples": samples, "seed": self.study.seed, "chain": chain}
        name = engine.scene.name, cells.key(engine.scene, variant, **settings)
        cell = cells.cell(
            engine,
            variant,
            own=own,
            replicates=factor * self.study.replicates,
            folder=cache_folder() / "cells",
            progress=lambda: self._advance(f"{engine.scene.name}: {what}"),
            before=self._python.get(name),
            swept=swept,
            **settings,
        )
        if variant.function is not None:
            self._python[name] = cell
        self._compile_seconds[name] = self._compile_seconds.get(name, 0.0) + cell.compile_seconds
        return attrs.evolve(cell, compile_seconds=self._compile_seconds[name])

    def reference(self, scene: Scene, limit: Limit, factor: int = 1) -> store.Replicates:
        """`factor` times the reference replicates of the study, at the samples of the first look."""
        return store.replicates(
            scene,
            limit,
            spp=_reference_samples(self.study, limit),
            seed=self.study.seed,
            count=factor * self.study.reference_replicates,
            folder=cache_folder() / "reference",
            progress=lambda: self._advance(f"{scene.name}: reference {limit.term}"),
            budget_s=factor * _SCALAR_SECONDS,
        )

    def book(
        self, scene: Scene, taken: Sequence[Cell], kept: dict[Limit, store.Replicates]
    ) -> dict[Item, int]:
        """Put down the seconds of what a judged row is made of; returns its replicates."""
        seed = self.study.seed
        seconds = {Item("ours", cell.key): cell.seconds[:, -1] for cell in taken}
        for limit, each in kept.items():
            key = store.key(scene, shared(scene, limit), spp=each.spp, seed=seed)
            seconds[Item("reference", key)] = each.seconds
        for item, each in seconds.items():
            self.ledger.book(item, each)
        return {item: len(each) for item, each in seconds.items()}


@attrs.define(eq=False)
class _Group:
    """The rows of one estimate, and how they are measured again with more replicates: a `sequential.Row`.

    Attributes
    ----------
    rows : as of the last look.
    replicates : of what the judged one of them is made of, at the first look.
    again : factor on the replicates -> the rows.
    factor : of the last look.
    tests, audited : of the run.
    """

    rows: list[_Row]
    replicates: dict[Item, int]
    again: Callable[[int], list[_Row]]
    factor: int = 1
    tests: int = 0
    audited: list[dict[str, Any]] = attrs.field(factory=list)

    @property
    def judged(self) -> bool:
        """Whether a verdict is due."""
        return any(row.judged for row in self.rows)

    @property
    def decided(self) -> bool:
        """Whether the last look decided it."""
        (row,) = (row for row in self.rows if row.judged)
        return _decided(row, self.tests, self.audited, len(sequential.LOOKS))["verdict"] != "UNDERPOWERED"

    def wanted(self, factor: int) -> dict[Item, int]:
        """Replicates that a look takes."""
        return {item: factor * count for item, count in self.replicates.items()}

    def look(self, factor: int) -> bool:
        """Measure with so many times the replicates of the first look."""
        self.rows, self.factor = self.again(factor), factor
        return self.decided


class _Source:
    """A subject and its references: makes its rows, at the first look and at later ones."""

    def __init__(self, takes: _Takes, subject: Subject, unchanged: "_Source | None") -> None:
        self.takes, self.subject = takes, subject
        rendered = {limit: takes.reference(subject.scene, limit) for limit in _limits(takes.study, subject)}
        self.rendered = (
            References(rendered, {term: rendered[subject.correct(term)] for term in TERMS})
            if unchanged is None
            else References(rendered, unchanged.rendered.correct)
        )
        # Of the first look, as whatever a row does not share with its own verdict: how far others got decides nothing.
        self._scale = sum(_luminance(kept.images) for kept in self.rendered.correct.values()) or 1.0
        self.objects = np.empty(0, np.int64)
        self._factors: dict[Variant | Limit, int] = {}

    def measure(self) -> list[Cell]:
        """The cells of all variants at the first look."""
        with Engine(self.subject.scene) as engine:
            self.objects = engine.geometry().object
            return [
                self._cell(engine, variant, 1) for term in TERMS for variant in self.subject.variants[term]
            ]

    def _cell(self, engine: Engine, variant: Variant, factor: int) -> Cell:
        return self.takes.cell(
            engine,
            variant,
            own=own_limit(self.takes.study, self.subject, variant),
            samples=self.takes.study.samples_of(variant),
            chain=self.subject.chain,
            what=f"{variant.term} {variant.name}",
            factor=factor,
        )

    def groups(self, measured: list[Cell]) -> list[_Group]:
        """The rows of each variant, and of the sum of the default ones."""
        self.takes.say(f"{self.subject.scene.name}: measuring")
        default = [next(c for c in measured if c.variant.term == term) for term in TERMS]
        return [*(self._group([cell], _cell_rows) for cell in measured), self._group(default, _total_rows)]

    def audits(self) -> list[references.Audit]:
        """The references of the first look against themselves."""
        study = self.takes.study
        return references.audits(
            self.subject.scene,
            self.rendered.rendered,
            # A setting is audited with the scene that it changes.
            by_second=study.audit and self.subject.setting is None,
            seed=study.seed,
            folder=cache_folder() / "reference",
            compare=self._compare,
            progress=self.takes.say,
        )

    def _group(self, taken: list[Cell], rows_of: "_RowsOf") -> _Group:
        subject, own = self.subject, [cell.own for cell in taken]
        variants = [cell.variant for cell in taken]
        found = rows_of(subject, taken, self.rendered, self._compare)
        replicates: dict[Item, int] = {}
        if any(row.judged for row in found):
            kept = {limit: self.rendered.rendered[limit] for limit in own}
            replicates = self.takes.book(subject.scene, taken, kept)

        def again(factor: int) -> list[_Row]:
            study = self.takes.study
            self.takes.expect(
                factor * (len(variants) * study.replicates + len(own) * study.reference_replicates)
            )
            self._factors |= dict.fromkeys((*variants, *own), factor)
            with Engine(subject.scene) as engine:
                taken = [self._cell(engine, variant, factor) for variant in variants]
            kept = {limit: self.takes.reference(subject.scene, limit, factor) for limit in own}
            self.takes.book(subject.scene, taken, kept)
            return rows_of(subject, taken, self._with(kept), self._compare)

        return _Group(found, replicates, again)

    def _with(self, kept: dict[Limit, store.Replicates]) -> References:
        """The references of the first look, some of them with more replicates."""
        correct = self.rendered.correct
        if self.subject.base is None:
            correct = {term: kept.get(self.subject.correct(term), each) for term, each in correct.items()}
        return References(self.rendered.rendered | kept, correct)

    def _compare(self, ours: np.ndarray, reference: np.ndarray, what: str) -> Statistics:
        scene = self.subject.scene
        names = [thing.name for thing in scene.objects]
        try:
            return accumulation.measure(
                ours, reference, objects=self.objects, object_names=names, scale=self._scale
            )
        except ValueError as error:
            raise ValueError(f"{scene.name}: {what}: {error}") from None

    @property
    def extended(self) -> bool:
        """Whether a later look took more replicates."""
        return bool(self._factors)

    def extend(self) -> tuple[list[Cell], list[netcdf.Sweep]]:
        """All replicates that the looks took: the references, and the cells at their last prefix, with their sweeps."""
        scene, factors = self.subject.scene, self._factors
        limits_of = [limit for limit in self.rendered.rendered if limit in factors]
        self.rendered = self._with(
            {limit: self.takes.reference(scene, limit, factors[limit]) for limit in limits_of}
        )
        measured, sweeps = [], []
        with Engine(scene) as engine:
            for variant in (variant for term in TERMS for variant in self.subject.variants[term]):
                cell = self._cell(engine, variant, factors.get(variant, 1))
                last = cell.images[:, -1:].copy()
                measured.append(attrs.evolve(cell, images=last, samples=cell.samples[-1:]))
                sweeps.append(netcdf.sweep(cell))
        return measured, sweeps

    def images(self) -> tuple[dict[Limit, np.ndarray], dict[Term, np.ndarray]]:
        """Replicates of the references: of each limit, and the right ones of each term."""
        return (
            {limit: kept.images for limit, kept in self.rendered.rendered.items()},
            {term: kept.images for term, kept in self.rendered.correct.items()},
        )


_RowsOf = Callable[[Subject, list[Cell], References, Compare], list[_Row]]


def _luminance(images: np.ndarray) -> float:
    return float(np.dot(np.mean(images, axis=(0, 1, 2), dtype=np.float64), replicates.LUMINANCE))


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


def _cell_rows(subject: Subject, measured: list[Cell], rendered: References, compare: Compare) -> list[_Row]:
    scene = subject.scene
    rows: list[_Row] = []
    for cell in measured:
        variant = cell.variant
        term = variant.term
        own, correct = rendered.rendered[cell.own], rendered.correct[term]
        what = f"{term} {variant.name}"
        at_own = compare(cell.images[:, -1], own.images, what)
        # Against its twin a kernel estimate is judged like any other.
        kernel = variant.kernel_based(scene) and cell.own.kernel is None
        judged = variant.judged or cell.own.kernel is not None
        kind = variant.kind if subject.setting is None else "wrong"
        errors = [mean_square_error(cell.images[:, p], own.images) for p in range(len(cell.samples))]
        curve = None
        if len(cell.samples) >= PREFIXES_NEEDED and not at_own.absent:
            seconds = cell.seconds.mean(axis=0)
            curve = fit(cell.samples, errors, seconds=seconds, bias_squared=at_own.bias_squared)
        own_mean, correct_mean = _luminance(own.images), _luminance(correct.images)
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
                    allowance=variant.allowance if kernel else 0.0,
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


def _of_radius(subject: Subject) -> list[Variant]:
    """The right direct estimators of a scene whose photon kernel has a radius."""
    if subject.setting is not None or skipped(subject.scene, "direct"):
        return []
    kernels = {variant: variant.kernel(subject.scene, 1) for variant in subject.variants["direct"]}
    return [variant for variant, kernel in kernels.items() if kernel and kernel.shape != "nearest"]


def _extrapolations(takes: _Takes, subject: Subject, rendered: References) -> list[dict[str, Any]]:
    """Relative error of the mean against the true integral, whole and in parts, at the study's radii and at 0."""
    study, scene = takes.study, subject.scene
    correct = rendered.correct["direct"].images
    found = []
    for variant in _of_radius(subject) if study.radii else []:
        samples = study.samples_of(variant)
        radii, errors, by_class, pixels = [], [], [], []
        for factor in study.radii:
            photons = attrs.evolve(scene.photons, radius=factor * scene.photons.radius)
            radius = photon_map.mean_radius(photons.radius, samples)
            with Engine(attrs.evolve(scene, photons=photons)) as engine:
                cell = takes.cell(
                    engine,
                    variant,
                    own=variant.limit(scene, samples),
                    samples=samples,
                    chain=subject.chain,
                    what=f"radii of {variant.name}",
                )
                seen = engine.geometry()
                points = kernel_bias.points(scene, seen)
                classes = kernel_bias.classify(engine.arrays.geometry, seen.face, points, radius)
            radii.append(radius)
            errors.append(relative_error(cell.images[:, -1], correct))
            by_class.append(kernel_bias.shares(cell.images[:, -1], correct, classes))
            pixels.append(kernel_bias.pixels(classes))
        label = kernel_bias.label(by_class[int(np.argmax(radii))])
        at_zero = {
            name: extrapolate(radii, [each[name] for each in by_class]) for name in kernel_bias.CLASSES
        }
        points = zip(
            (*radii, 0.0),
            (*errors, extrapolate(radii, errors)),
            (*by_class, at_zero),
            (*pixels, dict.fromkeys(kernel_bias.CLASSES)),
            strict=True,
        )
        found.append(
            {
                "scene": scene.name,
                "variant": variant.name,
                "label": label,
                "points": [
                    {
                        "radius": radius,
                        **_interval(error),
                        "classes": {
                            name: {"pixels": shown[name], **_interval(part)} for name, part in parts.items()
                        },
                    }
                    for radius, error, parts, shown in points
                ],
            }
        )
    return found


def _interval(error: Estimate) -> dict[str, float]:
    """A number with its 90 % interval."""
    return {
        "error": error.value,
        "low": error.low(0.05),
        "high": error.high(0.05),
        "standard_error": error.standard_error,
    }


def _exact_group(takes: _Takes, case: Case) -> _Group:
    """Rows of a variant against numbers that are known."""

    def take(factor: int) -> Cell:
        with Engine(case.scene) as engine:
            return takes.cell(
                engine,
                case.variant,
                own=case.variant.limit(case.scene, case.samples),
                samples=case.samples,
                chain=CHAIN,
                what=f"{case.name}: {case.variant.name}",
                factor=factor,
                swept=False,
            )

    def again(factor: int) -> list[_Row]:
        takes.expect(factor * takes.study.replicates)
        cell = take(factor)
        takes.book(case.scene, [cell], {})
        return _exact_rows(case, cell)

    cell = take(1)
    return _Group(_exact_rows(case, cell), takes.book(case.scene, [cell], {}), again)


def _exact_rows(case: Case, cell: Cell) -> list[_Row]:
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


def _total_rows(subject: Subject, measured: list[Cell], rendered: References, compare: Compare) -> list[_Row]:
    """Rows of the sum of the default variants; it carries the allowance of a kernel-based term."""
    scene = subject.scene
    default = dict(zip(TERMS, measured, strict=True))
    ours = total(*(default[term].images[:, -1] for term in TERMS))
    by_kernel = [
        c.variant for c in default.values() if c.variant.kernel_based(scene) and c.own.kernel is None
    ]
    allowance = max((variant.allowance for variant in by_kernel), default=0.0)
    judged = all(cell.variant.judged or cell.own.kernel for cell in default.values())
    kind = "right" if subject.setting is None else "wrong"

    def summed(chosen: list[store.Replicates]) -> np.ndarray:
        shared = min(len(kept.images) for kept in chosen)
        return total(*(kept.images[:shared] for kept in chosen))

    against = {"own": [rendered.rendered[default[term].own] for term in TERMS]}
    if subject.setting is None:
        against["physical"] = [rendered.rendered[limits.physical(term)] for term in TERMS]
    else:
        against["correct"] = [rendered.correct[term] for term in TERMS]
    means = {name: _luminance(summed(chosen)) for name, chosen in against.items()}
    right = means.get("correct", means["own"])
    seconds = np.sum([cell.seconds[:, -1] for cell in default.values()], axis=0)
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
                kernel=bool(by_kernel),
                allowance=allowance if name == "own" else 0.0,
                margin=rule.margin_of(kind, means["own"], right),
                judged=name == "own" and judged,
                predicted_bias=predicted if judged else None,
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
    limits: tuple[Limit, ...] = (),
    replicate_seconds: list[float] | None = None,
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
    return _Row(fields, statistics, decided, judged, scene, limits)


def _ssim(truth: np.ndarray, shown: np.ndarray, exposure: float) -> float | None:
    if min(truth.shape[:2]) < metrics.SSIM_WINDOW:
        return None
    return float(np.mean([metrics.ssim(truth, image, exposure=exposure) for image in shown]))


def _split(cell: Cell, own: np.ndarray, physical: np.ndarray) -> dict[str, list[float]]:
    """Parts of one replicate's mean square error against full light transport: value and 90 % interval, radiance².

    With what rounding to float32 has of the bias, where replicates were rendered by kernels.
    """
    ours = cell.images[:, -1]
    parts = attrs.asdict(jackknife.split_error(ours, own, physical), recurse=False)
    rendered = [image for k in range(len(ours)) if (image := cell.rendered(k)) is not None]
    if rendered:
        parts["float_error"] = jackknife.float_error(ours, np.stack(rendered))
    return {name: [part.value, part.low(0.05), part.high(0.05)] for name, part in parts.items()}


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


def _tile_maps(row: _Row) -> dict[int, tiles.TileMap] | None:
    """Of a row that is judged and has light."""
    if row.statistics is None or not row.judged or row.statistics.absent:
        return None
    return tiles.tile_maps(row.statistics)


def _decided(row: _Row, tests: int, audited: list[dict[str, Any]], looks: int = 1) -> dict[str, Any]:
    word, failed = references.findings(audited, row.scene, row.limits)
    fields = {**row.fields, "reference_audit": word}
    if row.statistics is None:
        return {**fields, **_NOT_JUDGED}
    judged = row.judged and not failed
    outcome = rule.decide(row.statistics, tests=max(tests, 1), looks=looks, judged=judged, **row.decide).row()
    if row.judged and failed:
        sentence = f"{verdict.NO_VERDICT}: its reference failed an audit: {'; '.join(failed)}."
        outcome |= {"verdict": verdict.NO_VERDICT, "reasons": failed, "sentence": sentence}
    regions = outcome.pop("regions")
    return {
        **fields,
        **outcome,
        "channels": [region for region in regions if region["region"] == accumulation.IMAGE],
        "objects": [region for region in regions if region["region"] != accumulation.IMAGE],
        "tiles": [] if (maps := _tile_maps(row)) is None else tiles.summary(maps),
    }


# A prefix of a run has errors, but neither bias nor verdict of its own.
_NOT_JUDGED: dict[str, Any] = dict.fromkeys(
    field.name for field in attrs.fields(Verdict) if field.name != "regions"
) | {"warnings": [], "reasons": [], "channels": [], "objects": [], "tiles": []}


def _describe(study: Study, subject: Subject, measured: list[Cell]) -> dict[str, Any]:
    scene = subject.scene
    samples: dict[Term, int] = {term: study.samples_of(subject.variants[term][0]) for term in TERMS}
    chosen: dict[Term, Variant] = {term: subject.variants[term][0] for term in TERMS}
    return {
        "base": subject.base.name if subject.base else None,
        "setting": attrs.asdict(subject.setting) if subject.setting else None,
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
            "sky": f"texture, {scene.sky.projection}"
            if scene.sky.texture is not None
            else list(scene.sky.color),
            "pixel rule": scene.camera.pixel,
            "field of view (degrees)": scene.camera.fov,
            "photons per pass": scene.photons.count,
            "radius of the first pass": scene.photons.radius,
            "k of the paper's photon search": scene.photons.nearest,
            "rings of the paper's rule": scene.rings,
            "shadows": scene.shadows,
            "direct light read as": scene.irradiance,
            "what a ray ignores that leaves a face": f"the same {scene.ignore}",
            "normals": f"of the {scene.normals}",
            "intersection": scene.intersection,
            "lights drawn": scene.draw_lights,
            **{
                f"toggle {name.replace('_', ' ')}": value
                for name, value in attrs.asdict(scene.toggles).items()
            },
        },
        "gains": _gains(subject),
        "plan": [
            attrs.asdict(step) | {"samples": samples[step.term]}
            for step in plan(scene, chosen, chain=subject.chain, samples=samples)
        ],
        "work": _work(measured),
    }


def _work(measured: list[Cell]) -> list[dict[str, Any]]:
    return [
        {"term": cell.variant.term, "variant": cell.variant.name, "samples": cell.samples[-1]}
        | {"replicates": len(cell.images), "kernels": list(cell.kernels), "counts": cell.counts}
        for cell in measured
    ]


def _gains(subject: Subject) -> dict[str, dict[str, float]]:
    """Q of each specular variant on each glossy object, as if all light met this object (see `closed_forms.gain`)."""
    scene = subject.scene
    glossy = [thing for thing in scene.objects if scene.specular_weight(thing.surface) > 0.0]
    return {
        variant.name: {
            thing.name: closed_forms.gain(variant.limit(scene, 1), thing.surface) for thing in glossy
        }
        for variant in subject.variants["specular"]
    }


_CERTIFIED = "EQUIVALENT", "AS PREDICTED"


def failures(results: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows that prove an error: of ours, or of the reference."""
    proven = ("BIASED", "NOT AS PREDICTED", verdict.NO_VERDICT)
    return [row for row in results["cells"] if row["verdict"] in proven]


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
