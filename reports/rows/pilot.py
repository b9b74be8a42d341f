"""The pilot of a study: a few replicates of each side of every row, by which those of its verdicts are allotted.

Its random numbers are those of a seed that no study can have, and nothing else reads it. It is kept in the cache like
all replicates, and its seconds are booked with those of the rows.
"""

from collections.abc import Mapping, Sequence

import attrs

from termwise.reference import backend, store
from termwise.renderer.terms import Variant
from termwise.renderer.terms.estimator import Compiled
from termwise.reports.jobs.cells import Job
from termwise.reports.jobs.desk import Desk, Measured
from termwise.reports.rows.looks import reference_samples
from termwise.reports.study.allotment import PRICE, Allotment, Noise, allot, key, reference_key, scale, variance
from termwise.reports.study.study import Study
from termwise.reports.study.subjects import Subject, own_limit
from termwise.scenes.limits import Limit

_REPLICATES = 2  # where pixels are independent
_CORRELATED = 4  # times as many where they are not


@attrs.frozen
class _Repetition:
    """Of the pilot of a study."""

    seed: int
    replicates: int = _REPLICATES
    reference_replicates: int = _REPLICATES


def allotted(
    study: Study, subjects: Sequence[Subject], desk: Desk, *, forgiven: Mapping[str, str] | None = None
) -> Allotment:
    """Have the pilot done, and allot; what the study says alone where it sets no half width.

    `forgiven` : as in `Desk.run`; a scene that fails here has nothing allotted, and fails again where it is told.
    """
    # Without a fast backend the reference gets what its seconds afford (`Desk.pace`).
    if study.half_width is None or backend.choose().variant == "scalar_rgb":
        return Allotment()
    beside = desk.beside(_Repetition(study.seed + 2**31))
    pilots = [_Pilot(study, subject, variant, beside) for subject in subjects for variant in _judged(study, subject)]
    try:
        listed: list[Job] = [job for each in pilots for job in each.jobs()]
        beside.run(listed, forgiven=forgiven)
        failed = beside.failed
        there = [p for p in pilots if not {p.subject.scene.name, p.subject.unchanged.name} & set(failed)]
        rows = [row for each in there if (row := each.noise()) is not None]
    finally:
        beside.close()
    factors, half_width = allot(rows, study.half_width)
    return Allotment(
        {key(p.subject.scene, p.variant): factors.get(key(p.subject.scene, p.variant), 1) for p in there},
        {name: factors.get(name, 1) for name in (reference_key(p.subject.scene, p.limit) for p in there)},
        half_width,
    )


def _judged(study: Study, subject: Subject) -> list[Variant]:
    """Of the right ones: the paper's are decided by less, and cost as much as all others together."""
    every = [variant for of_term in subject.variants.values() for variant in of_term if variant.kind == "right"]
    return [each for each in every if each.judged or own_limit(study, subject, each).kernel is not None]


class _Pilot:
    """Of one row: ours as the study has it, of a kernel reference a quarter of a replicate's maps, which add up."""

    def __init__(self, study: Study, subject: Subject, variant: Variant, desk: Desk) -> None:
        self.study, self.subject, self.variant, self._desk = study, subject, variant, desk
        self.limit: Limit = own_limit(study, subject, variant)
        self._asked = Measured(
            subject.scene, variant, self.limit, study.samples_of(variant), subject.chain, swept=False
        )
        # Of a function nothing is known.
        by_maps = variant.photons(subject.scene, subject.chain) is not None
        self._correlated = by_maps or not isinstance(variant.estimator, Compiled)
        self._factor = _CORRELATED if self._correlated else 1
        by_kernel = self.limit.kernel is not None
        self._reference_factor = _CORRELATED if by_kernel else 1
        spp = reference_samples(study, self.limit)
        self._spp = max(1, spp // _CORRELATED) if by_kernel else spp

    def jobs(self) -> list[Job]:
        """The replicates of both sides."""
        scene = self.subject.scene
        theirs = self._desk.reference_jobs(scene, self.limit, factor=self._reference_factor, spp=self._spp)
        return [*theirs, *self._desk.jobs(self._asked, factor=self._factor)]

    def noise(self) -> Noise | None:
        """What the row's sides vary by with the replicates of the study; None where either is black."""
        scene, limit, study = self.subject.scene, self.limit, self.study
        cell = self._desk.cell(self._asked, factor=self._factor)
        kept: store.Replicates = self._desk.reference(scene, limit, factor=self._reference_factor, spp=self._spp)
        self._desk.book(scene, [cell], {limit: kept})
        if not cell.images.any() or not kept.images.any():
            return None
        relative = 1.0 / scale(kept.images) ** 2
        ours = variance(cell.images[:, -1], correlated=self._correlated) / study.replicates
        theirs = variance(kept.images, correlated=limit.kernel is not None) / study.reference_replicates
        theirs *= self._spp / reference_samples(study, limit)
        return Noise(
            key(scene, self.variant),
            reference_key(scene, limit),
            ours * relative,
            theirs * relative,
            float(study.replicates * study.samples_of(self.variant)),
            PRICE * study.reference_replicates * reference_samples(study, limit),
        )
