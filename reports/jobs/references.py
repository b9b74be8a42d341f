"""Replicates of references as jobs: kept by `reference.store`, under its names."""

from pathlib import Path

import attrs

from termwise import reference
from termwise.reference import store
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
