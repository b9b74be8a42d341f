"""The desk of a run: it lists jobs, has them done, and reads what they made; what they took is in its ledger."""

import math
import uuid
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Protocol

import attrs

from termwise import reference
from termwise.reference import store
from termwise.renderer.fingerprint import Unknown
from termwise.renderer.plan import powers_of_two
from termwise.renderer.terms import Chain, Variant, find
from termwise.renderer.terms.estimator import sent
from termwise.reports.jobs import cells, geometry
from termwise.reports.jobs.cells import Cell, Job, Replicate
from termwise.reports.jobs.executors import Executor, InThisProcess
from termwise.reports.jobs.geometry import GeometryAudit
from termwise.reports.jobs.references import ReferenceReplicate, reference_jobs
from termwise.reports.progress import Report, silent
from termwise.reports.statistics.sequential import Item, Ledger
from termwise.reports.study.geometry_audit import Finding
from termwise.scenes.limits import Limit
from termwise.scenes.model import Scene

# Of the replicates of a reference at the first look, where Mitsuba has no fast backend.
_SCALAR_SECONDS = 60.0


@attrs.frozen(eq=False)
class Measured:
    """A variant on a scene, as a cell is asked for: `samples` a replicate, all prefixes or (not `swept`) the last."""

    scene: Scene
    variant: Variant
    own: Limit
    samples: int
    chain: Chain
    swept: bool = True


class Repeated(Protocol):
    """What a study says of repetition: its seed, and the replicates of the first look on each side."""

    @property
    def seed(self) -> int: ...  # noqa: D102
    @property
    def replicates(self) -> int: ...  # noqa: D102
    @property
    def reference_replicates(self) -> int: ...  # noqa: D102


class Desk:
    """Has jobs done by an executor.

    Parameters
    ----------
    study : its seed and its replicates, of which looks take multiples.
    cache : the folder of what is kept.
    executor : does them; by default this process.
    report : called as jobs end.

    Attributes
    ----------
    ledger : the seconds of what judged rows are made of.
    failed : of each scene that is forgiven, why a job of it failed.
    hosts : where jobs are done elsewhere, how many each host has made.
    """

    def __init__(
        self, study: Repeated, cache: Path, *, executor: Executor | None = None, report: Report = silent
    ) -> None:
        self.ledger = Ledger()
        self.failed: dict[str, Exception] = {}
        self.hosts: Counter[str] = Counter()
        self._study, self._cache = study, cache
        self._executor = executor or InThisProcess()
        self._report, self._done, self._steps = report, 0, 0
        self._compile_seconds: dict[tuple[str, str, str], float] = {}
        self._fingerprints: dict[Variant, str] = {}
        # In the place of a fingerprint that cannot be told: no other run may take such images for its own.
        self._token = uuid.uuid4().hex
        self._unknown: set[str] = set()

    def close(self) -> None:
        """Remove what was kept for this run alone."""
        for name in self._unknown:
            for path in (self._cache / "cells" / name[:2]).glob(f"{name}-*.npz"):
                path.unlink(missing_ok=True)

    def beside(self, study: Repeated) -> "Desk":
        """A desk of other repetitions, in the same cache and by the same executor, that books into the same ledger."""
        other = Desk(study, self._cache, executor=self._executor, report=self._report)
        other.ledger, other.hosts, other._compile_seconds = self.ledger, self.hosts, self._compile_seconds
        return other

    def say(self, what: str) -> None:
        """Report what is going on."""
        self._report(what, self._done, self._steps)

    # Listing.

    def jobs(self, asked: Measured, *, factor: float = 1) -> list[Replicate]:
        """`factor` times the replicates of the study."""
        name = self._key(asked)
        variant = asked.variant
        counts = powers_of_two(asked.samples) if asked.swept else (asked.samples,)
        return [
            Replicate(asked.scene, variant.term, variant.name, counts, self._study.seed, asked.chain, name, number)
            for number in range(math.ceil(factor * self._study.replicates))
        ]

    def reference_jobs(
        self, scene: Scene, limit: Limit, *, factor: float = 1, spp: int, by_second: bool = False
    ) -> list[ReferenceReplicate]:
        """`factor` times the reference replicates of the study, as far as Mitsuba's backend affords them."""
        paced = self.pace(scene, limit, factor=factor, spp=spp, by_second=by_second)
        return reference_jobs(scene, limit, paced, seed=self._study.seed, by_second=by_second)

    def geometry_job(self, scene: Scene) -> GeometryAudit:
        """The geometry audit of a scene."""
        return GeometryAudit(scene, self._study.seed)

    def pace(self, scene: Scene, limit: Limit, *, factor: float = 1, spp: int, by_second: bool = False) -> store.Pace:
        """Samples and replicates of a reference: all that are asked for, but on `scalar_rgb`, where a pilot decides."""
        return store.pace(
            scene,
            limit,
            spp=spp,
            seed=self._study.seed,
            count=math.ceil(factor * self._study.reference_replicates),
            folder=self._cache / "reference",
            budget_s=factor * _SCALAR_SECONDS,
            by_second=by_second,
        )

    def _key(self, asked: Measured) -> str:
        variant = asked.variant
        # Asked once a run: what a function's names stand for may change between runs, and does as it is called.
        if variant not in self._fingerprints:
            try:
                self._fingerprints[variant] = variant.estimator.fingerprint()
            except Unknown:
                self._fingerprints[variant] = self._token
        found = self._fingerprints[variant]
        name = cells.key(
            asked.scene, variant, samples=asked.samples, seed=self._study.seed, chain=asked.chain, fingerprint=found
        )
        if found == self._token:
            self._unknown.add(name)
        return name

    # Doing.

    def run(self, jobs: Iterable[Job], *, forgiven: Mapping[str, str] | None = None) -> None:
        """Have jobs done.

        Parameters
        ----------
        jobs : in an order that is good for one process; equal ones are done once.
        forgiven : scenes whose failure loses no others' results, each with the scene that it needs: `failed` then says
            why, and their other jobs are dropped.

        Raises
        ------
        Exception : That of a job of any other scene.
        ValueError : an estimator that has to be sent to another process and cannot; the message names it.
        """
        unlike = {job.name: job for job in jobs}
        if self._executor.elsewhere:
            self._send(unlike.values())
        needs = forgiven or {}
        self._steps += len(unlike)

        def dropped(job: Job) -> bool:
            name = job.scene.name
            return name in self.failed or needs.get(name) in self.failed

        for outcome in self._executor.run(list(unlike.values()), self._cache, dropped):
            job = outcome.job
            self._done += 1
            if outcome.host:
                self.hosts[outcome.host] += outcome.made
            if outcome.error is not None:
                if job.scene.name not in needs:
                    raise outcome.error
                self.failed.setdefault(job.scene.name, outcome.error)
            elif isinstance(job, Replicate):
                estimate = job.scene.name, job.term, job.variant
                spent = self._compile_seconds.get(estimate, 0.0)
                self._compile_seconds[estimate] = spent + outcome.compile_seconds
            self.say(job.what)
        self._done = self._steps  # those that were dropped will not come

    @staticmethod
    def _send(jobs: Iterable[Job]) -> None:
        """Refuse estimators that another process cannot get."""
        for term, name in {(job.term, job.variant) for job in jobs if isinstance(job, Replicate)}:
            sent(term, name, find(term, name).estimator)

    # Reading.

    def cell(self, asked: Measured, *, factor: float = 1) -> Cell:
        """What the `jobs` of a cell have made; its compilation is that of all looks, and of a pilot."""
        jobs = self.jobs(asked, factor=factor)
        compiled = self._compile_seconds.get((asked.scene.name, asked.variant.term, asked.variant.name), 0.0)
        return cells.read(jobs, asked.own, self._cache / "cells", compile_seconds=compiled)

    def reference(
        self, scene: Scene, limit: Limit, *, factor: float = 1, spp: int, by_second: bool = False
    ) -> store.Replicates:
        """What the `reference_jobs` of a limit have made."""
        paced = self.pace(scene, limit, factor=factor, spp=spp, by_second=by_second)
        kept = store.kept(
            scene,
            limit,
            spp=paced.spp,
            seed=self._study.seed,
            count=paced.count,
            folder=self._cache / "reference",
            by_second=by_second,
        )
        return kept._replace(shortfall=paced.shortfall)

    def geometry(self, scene: Scene) -> Finding:
        """What the `geometry_job` of a scene has found."""
        return geometry.read(self.geometry_job(scene), self._cache / "geometry")

    def book(self, scene: Scene, taken: Sequence[Cell], kept: Mapping[Limit, store.Replicates]) -> dict[Item, int]:
        """Put down the seconds of what a judged row is made of; returns its replicates."""
        seconds = {Item("ours", cell.key): cell.seconds[:, -1] for cell in taken}
        for limit, each in kept.items():
            name = store.key(scene, reference.shared(scene, limit), spp=each.spp, seed=self._study.seed)
            seconds[Item("reference", name)] = each.seconds
        for item, each in seconds.items():
            self.ledger.book(item, each)
        return {item: len(each) for item, each in seconds.items()}
