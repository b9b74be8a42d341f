"""Looks at a study: the jobs that its subjects need, and the rows that these make, at first and with more replicates.

Nothing is rendered here: `jobs` lists, the desk has them done, and rows are read from the cache.
"""

from collections.abc import Callable
from typing import Any

import attrs
import numpy as np

from termwise.reference import backend, store
from termwise.renderer.engine import Engine
from termwise.renderer.terms import Variant
from termwise.reports.jobs.cells import Cell, Job
from termwise.reports.jobs.desk import Desk, Measured
from termwise.reports.rows import images, radii
from termwise.reports.rows.measurement import (
    Compare,
    Measurement,
    References,
    cell_rows,
    decided,
    exact_rows,
    mean_luminance,
    total_rows,
)
from termwise.reports.statistics import accumulation, sequential
from termwise.reports.statistics.accumulation import Statistics
from termwise.reports.statistics.sequential import Item
from termwise.reports.study import audits
from termwise.reports.study.allotment import Allotment
from termwise.reports.study.exact import Case
from termwise.reports.study.geometry_audit import Finding
from termwise.reports.study.study import Study
from termwise.reports.study.subjects import CHAIN, Subject, exact_part, own_limit
from termwise.scenes import limits
from termwise.scenes.limits import Limit
from termwise.scenes.terms import TABLE, TERMS, Term

# Times the samples a pixel of other references, in rows that no pilot allots by (`pilot`).
_RINGS = 32  # with 8 most of these rows of `standard` were UNDERPOWERED
_LOBE = 4  # with 1 their shape was known to 0.8 to 1.4 % rms, 1 % being asked

RowsOf = Callable[[Subject, list[Cell], References, Compare], list[Measurement]]


def jobs(study: Study, subject: Subject, desk: Desk, allotment: Allotment) -> list[Job]:
    """The jobs of a subject at the first look: its references, its variants, what audits the references, and radii.

    Nothing is done, but for the pilots by which `scalar_rgb` tells how many samples it affords (`Desk.pace`).
    """
    listed: list[Job] = []
    asked = limits_of(study, subject)
    for limit in asked:
        times = allotment.of_reference(subject.scene, limit)
        listed += desk.reference_jobs(subject.scene, limit, factor=times, spp=reference_samples(study, limit))
    listed.append(desk.geometry_job(subject.scene))
    for variant in _variants(subject):
        times = allotment.of(subject.scene, variant)
        listed += desk.jobs(of_variant(study, subject, variant), factor=times)
    for limit in _seconds(study, subject, asked):
        spp = audits.second_samples(desk.pace(subject.scene, limit, spp=reference_samples(study, limit)).spp)
        listed += desk.reference_jobs(subject.scene, limit, spp=spp, by_second=True)
    for variant in radii.of_radius(subject):
        for each in radii.asked(study, subject, variant):
            listed += desk.jobs(each)
    return listed


def of_variant(study: Study, subject: Subject, variant: Variant) -> Measured:
    """A variant on its subject, as the study measures it."""
    own, samples = own_limit(study, subject, variant), study.samples_of(variant)
    return Measured(subject.scene, variant, own, samples, subject.chain)


def of_case(case: Case) -> Measured:
    """A variant on a scene with a known answer."""
    own = case.variant.limit(case.scene, case.samples)
    return Measured(case.scene, case.variant, own, case.samples, CHAIN, swept=False)


def limits_of(study: Study, subject: Subject) -> tuple[Limit, ...]:
    """Every limit of its scene that a subject's rows are measured against or allowed by, each once."""
    wanted: dict[Limit, None] = {}
    for term in TERMS:
        for variant in subject.variants[term]:
            own = own_limit(study, subject, variant)
            wanted[own] = None
            if exact := exact_part(subject.scene, variant, own):
                wanted[exact] = None
        if subject.base is None:
            wanted[subject.correct(term)] = None
            wanted[limits.physical(term)] = None
    return tuple(wanted)


def reference_samples(study: Study, limit: Limit) -> int:
    """Samples per pixel and replicate; of a kernel reference, photon maps a replicate."""
    if limit.kernel is not None:
        maps = study.maps_of(limit.kernel)
        assert maps is not None
        return maps
    if limit.transport == "physical":
        return study.physical_spp
    if TABLE[limit.term].meets and limit.rings:
        # Rings cannot be drawn where the lobe is: their reference is as noisy as the estimator.
        return study.reference_spp * _RINGS
    return study.reference_spp * (_LOBE if limit.lobe != 1 else 1)


def _variants(subject: Subject) -> list[Variant]:
    return [variant for term in TERMS for variant in subject.variants[term]]


def _seconds(study: Study, subject: Subject, asked: tuple[Limit, ...]) -> list[Limit]:
    """Limits with a second integrator that audits them; a setting is audited with the scene that it changes."""
    vectorised = backend.choose().variant != "scalar_rgb"
    audited = study.audit and subject.setting is None and vectorised
    return audits.second_limits(subject.scene, asked) if audited else []


@attrs.define(eq=False)
class Group:
    """The rows of one estimate, and how they are measured again with more replicates: a `sequential.Row`.

    Attributes
    ----------
    rows : as of the last look.
    replicates : of what the judged one of them is made of, at the first look.
    again : factor on the replicates -> the rows.
    factor : of the last look.
    tests, audited : of the run.
    """

    rows: list[Measurement]
    replicates: dict[Item, int]
    again: Callable[[int], list[Measurement]]
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
        return decided(row, self.tests, self.audited, len(sequential.LOOKS))["verdict"] != "UNDERPOWERED"

    def wanted(self, factor: int) -> dict[Item, int]:
        """Replicates that a look takes."""
        return {item: factor * count for item, count in self.replicates.items()}

    def look(self, factor: int) -> bool:
        """Measure with so many times the replicates of the first look."""
        self.rows, self.factor = self.again(factor), factor
        return self.decided


class Source:
    """A subject and its references, read from the cache: makes its rows, at the first look and at later ones.

    Parameters
    ----------
    study, subject, desk : the subject's jobs of the first look are done.
    allotment : factors on the replicates of the study, at every look.
    unchanged : of the scene without the change, where the subject is a changed one.
    """

    def __init__(
        self, study: Study, subject: Subject, desk: Desk, allotment: Allotment, unchanged: "Source | None"
    ) -> None:
        self.study, self.subject, self.desk, self.allotment = study, subject, desk, allotment
        rendered = {limit: self._reference(limit) for limit in limits_of(study, subject)}
        self.rendered = (
            References(rendered, {term: rendered[subject.correct(term)] for term in TERMS})
            if unchanged is None
            else References(rendered, unchanged.rendered.correct)
        )
        # Of the first look, as whatever a row does not share with its own verdict: how far others got decides nothing.
        self._scale = sum(mean_luminance(kept.images) for kept in self.rendered.correct.values()) or 1.0
        with Engine(subject.scene) as engine:
            self.objects = engine.geometry().object
        self._factors: dict[Variant | Limit, int] = {}

    def _reference(self, limit: Limit, factor: int = 1) -> store.Replicates:
        scene, spp = self.subject.scene, reference_samples(self.study, limit)
        return self.desk.reference(scene, limit, factor=factor * self.allotment.of_reference(scene, limit), spp=spp)

    def _cell(self, variant: Variant, factor: int = 1) -> Cell:
        times = factor * self.allotment.of(self.subject.scene, variant)
        return self.desk.cell(of_variant(self.study, self.subject, variant), factor=times)

    def measure(self) -> list[Cell]:
        """The cells of all variants at the first look."""
        return [self._cell(variant) for variant in _variants(self.subject)]

    def groups(self, measured: list[Cell]) -> list[Group]:
        """The rows of each variant, and of the sum of the default ones."""
        self.desk.say(f"{self.subject.scene.name}: measuring")
        default = [next(c for c in measured if c.variant.term == term) for term in TERMS]
        return [*(self._group([cell], cell_rows) for cell in measured), self._group(default, total_rows)]

    def audits(self) -> list[audits.Audit]:
        """The references of the first look against themselves."""
        scene, rendered = self.subject.scene, self.rendered.rendered
        seconds = {
            limit: self.desk.reference(scene, limit, spp=audits.second_samples(rendered[limit].spp), by_second=True)
            for limit in _seconds(self.study, self.subject, tuple(rendered))
        }
        return audits.audits(scene, rendered, seconds, compare=self._compare)

    def geometry(self) -> Finding:
        """What Mitsuba met and saw in the scene, against float64."""
        return self.desk.geometry(self.subject.scene)

    def extrapolations(self) -> list[dict[str, Any]]:
        """What photon kernels tend to as their radius shrinks."""
        correct = self.rendered.correct["direct"].images
        return radii.extrapolations(self.study, self.subject, correct, self.desk.cell)

    def _group(self, taken: list[Cell], rows_of: RowsOf) -> Group:
        own, variants = [cell.own for cell in taken], [cell.variant for cell in taken]
        found = rows_of(self.subject, taken, self.rendered, self._compare)
        replicates: dict[Item, int] = {}
        if any(row.judged for row in found):
            kept = {limit: self.rendered.rendered[limit] for limit in own}
            replicates = self.desk.book(self.subject.scene, taken, kept)

        def again(factor: int) -> list[Measurement]:
            taken, kept = self._more(variants, own, factor)
            return rows_of(self.subject, taken, self._with(kept), self._compare)

        return Group(found, replicates, again)

    def _more(
        self, variants: list[Variant], own: list[Limit], factor: int
    ) -> tuple[list[Cell], dict[Limit, store.Replicates]]:
        """Have `factor` times the replicates made of what a row consists of, and put down their seconds."""
        scene = self.subject.scene
        listed: list[Job] = []
        for variant in variants:
            times = factor * self.allotment.of(scene, variant)
            listed += self.desk.jobs(of_variant(self.study, self.subject, variant), factor=times)
        for limit in own:
            times, spp = factor * self.allotment.of_reference(scene, limit), reference_samples(self.study, limit)
            listed += self.desk.reference_jobs(scene, limit, factor=times, spp=spp)
        self.desk.run(listed)
        self._factors |= dict.fromkeys((*variants, *own), factor)
        taken = [self._cell(variant, factor) for variant in variants]
        kept = {limit: self._reference(limit, factor) for limit in own}
        self.desk.book(scene, taken, kept)
        return taken, kept

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
            return accumulation.measure(ours, reference, objects=self.objects, object_names=names, scale=self._scale)
        except ValueError as error:
            raise ValueError(f"{scene.name}: {what}: {error}") from None

    @property
    def extended(self) -> bool:
        """Whether a later look took more replicates."""
        return bool(self._factors)

    def extend(self) -> tuple[list[Cell], list[images.Sweep]]:
        """All replicates that the looks took: the references, and the cells at their last prefix, with their sweeps."""
        factors = self._factors
        self.rendered = self._with(
            {limit: self._reference(limit, factors[limit]) for limit in self.rendered.rendered if limit in factors}
        )
        measured, sweeps = [], []
        for variant in _variants(self.subject):
            cell = self._cell(variant, factors.get(variant, 1))
            last = cell.images[:, -1:].copy()
            measured.append(attrs.evolve(cell, images=last, samples=cell.samples[-1:]))
            sweeps.append(images.sweep(cell))
        return measured, sweeps

    def images(self) -> tuple[dict[Limit, np.ndarray], dict[Term, np.ndarray]]:
        """Replicates of the references: of each limit, and the right ones of each term."""
        return (
            {limit: kept.images for limit, kept in self.rendered.rendered.items()},
            {term: kept.images for term, kept in self.rendered.correct.items()},
        )


def exact_group(case: Case, desk: Desk) -> Group:
    """Rows of a variant against numbers that are known; its jobs of the first look are done."""
    asked = of_case(case)

    def again(factor: int) -> list[Measurement]:
        desk.run(desk.jobs(asked, factor=factor))
        cell = desk.cell(asked, factor=factor)
        desk.book(case.scene, [cell], {})
        return exact_rows(case, cell)

    cell = desk.cell(asked)
    return Group(exact_rows(case, cell), desk.book(case.scene, [cell], {}), again)
