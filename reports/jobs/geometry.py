"""The geometry audit of a scene as a job: what it found is one small file, named by all that decides it."""

import hashlib
import json
from pathlib import Path

import attrs

from termwise.reference import backend
from termwise.reports.jobs.cells import Seat
from termwise.reports.study import geometry_audit
from termwise.reports.study.geometry_audit import Finding
from termwise.scenes import reads
from termwise.scenes.model import Scene, absorb
from termwise.scenes.store import ROOT, sources_digest, versions_of, write_atomically

# Fields of a scene that an audit depends on: what a setting changes beside them needs no audit of its own.
_READ = "camera", "objects.name", "objects.mesh", "objects.emission", "lights", "resolution", "ignore"
_READ += "sky.texture", "sky.center", "sky.radius"  # its sphere decides where camera rays begin


@attrs.frozen(eq=False)
class GeometryAudit:
    """The audit of a scene, see `reports.study.geometry_audit`, as a job. It can be pickled."""

    scene: Scene
    seed: int

    @property
    def what(self) -> str:
        """As progress names it."""
        return f"{self.scene.name}: geometry"

    @property
    def name(self) -> tuple[object, ...]:
        """Equal for jobs that make the same file, as far as that is told cheaply."""
        return id(self.scene), self.seed

    def files(self, cache: Path) -> tuple[Path, ...]:
        """What it makes in a cache."""
        return (self.path(cache / "geometry"),)

    def kept(self, cache: Path) -> bool:
        """Whether a cache has it."""
        return _read(self.path(cache / "geometry")) is not None

    def here(self) -> "GeometryAudit":
        """The job as this process would name it: its file's name says what decides it."""
        return self

    def take(self, seat: Seat) -> tuple[bool, float]:
        """Have it made, unless the cache has it; whether it was; it compiles nothing of ours."""
        if seat.threads is not None:
            backend.limit_threads(seat.threads)
        return take(self, seat.cache / "geometry"), 0.0

    def path(self, folder: Path) -> Path:
        """Its file in the folder of the cache."""
        sources = sources_digest(*(ROOT / name for name in ("reference", "scenes", "reports/study")))
        state = hashlib.sha256()
        for field, kind, value in reads.fields_of(self.scene):
            if field.startswith(_READ):
                absorb(state, (field, kind, value))
        settings = repr(
            (state.hexdigest(), self.seed, backend.choose().variant, versions_of("mitsuba", "drjit", "numpy"), sources)
        )
        name = hashlib.sha256(settings.encode()).hexdigest()
        return folder / name[:2] / f"{name}.json"


def take(job: GeometryAudit, folder: Path) -> bool:
    """Audit a scene and keep what was found in `folder`, unless it is there; whether it was not."""
    path = job.path(folder)
    if _read(path) is not None:
        return False
    text = json.dumps(attrs.asdict(geometry_audit.audit(job.scene, seed=job.seed)))
    write_atomically(path, lambda temporary: temporary.write_text(text, "utf-8"))
    return True


def read(job: GeometryAudit, folder: Path) -> Finding:
    """What an audit found.

    Raises
    ------
    ValueError : its file is missing or damaged.
    """
    path = job.path(folder)
    found = _read(path)
    if found is None:
        raise ValueError(f"{path}: is missing or damaged: allowed is an audit that was kept")
    return attrs.evolve(found, scene=job.scene.name)


def _read(path: Path) -> Finding | None:
    try:
        return Finding(**json.loads(path.read_text("utf-8")))
    except (OSError, ValueError, TypeError):
        return None
