"""Replicates of references as jobs: kept by `reference.store`, under its names."""

from pathlib import Path

import attrs

from termwise import reference
from termwise.reference import backend, store
from termwise.reports.jobs.cells import Seat
from termwise.scenes.limits import Limit
from termwise.scenes.model import Scene


@attrs.frozen(eq=False)
class ReferenceReplicate:
    """One replicate of a reference, as a job. It can be pickled.

    Attributes
    ----------
    limit : as it is rendered, see `reference.shared`: one replicate serves all limits that share it.
    spp : samples per pixel; of a kernel reference, photon maps.
    number : of the replicate.
    by_second : by the limit's second integrator.
    """

    scene: Scene
    limit: Limit
    spp: int
    seed: int
    number: int
    by_second: bool = False

    @property
    def what(self) -> str:
        """As progress names it."""
        integrator = "second integrator of" if self.by_second else "reference"
        return f"{self.scene.name}: {integrator} {self.limit.term}"

    @property
    def name(self) -> tuple[object, ...]:
        """Equal for jobs that make the same file.

        Of one scene by its object: its content decides the file's name, which costs more to tell.
        """
        return id(self.scene), self.limit, self.spp, self.number, self.by_second

    def files(self, cache: Path) -> tuple[Path, ...]:
        """What it makes in a cache, the last of them last."""
        folder = cache / "reference"
        return store.files(
            self.scene,
            self.limit,
            spp=self.spp,
            seed=self.seed,
            number=self.number,
            folder=folder,
            by_second=self.by_second,
        )

    def kept(self, cache: Path) -> bool:
        """Whether a cache has it."""
        return store.whole(self.files(cache)[-1], self.scene.resolution)

    def here(self) -> "ReferenceReplicate":
        """The job as this process would name it: its files' names say what decides its bits."""
        return self

    def take(self, seat: Seat) -> tuple[bool, float]:
        """Have it rendered, unless the cache has it; whether it was; compilation stands in no row."""
        if seat.threads is not None:
            backend.limit_threads(seat.threads)
        return take(self, seat.cache / "reference"), 0.0


def reference_jobs(
    scene: Scene, limit: Limit, paced: store.Pace, *, seed: int, by_second: bool = False
) -> list[ReferenceReplicate]:
    """The jobs of a limit's replicates."""
    served = reference.shared(scene, limit)
    return [ReferenceReplicate(scene, served, paced.spp, seed, number, by_second) for number in range(paced.count)]


def take(job: ReferenceReplicate, folder: Path) -> bool:
    """Render a replicate and keep it in `folder`, unless it is there; whether it was not."""
    return store.render_missing(
        job.scene, job.limit, spp=job.spp, seed=job.seed, number=job.number, folder=folder, by_second=job.by_second
    )
