"""Replicates of an engine as jobs: images kept in the cache by all that decides them, so that no run is done twice."""

import hashlib
import os
import threading
import zipfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import attrs
import numpy as np

from termwise.reports.engines import running
from termwise.reports.engines.asked import Asked
from termwise.reports.engines.engine import Engine, EngineError
from termwise.scenes.store import ROOT, cache_folder, sources_digest, write_atomically

if TYPE_CHECKING:
    from termwise.reports.jobs.cells import Seat
    from termwise.reports.jobs.executors import Executor
    from termwise.scenes.model import Scene


@attrs.frozen(eq=False)
class EngineReplicate:
    """One image of an engine, as a job. It can be pickled.

    Attributes
    ----------
    spp : samples per pixel.
    seed, number : of the run, and of the replicate: they name the engine's own seed.
    key : sha256 of all that decides the image but the number: command, version and adapter, scene, samples, seed,
        and our sources that write the scene.
    """

    engine: Engine
    asked: Asked
    spp: int
    seed: int
    number: int
    key: str

    @property
    def scene(self) -> "Scene":
        """The scene that it concerns."""
        return self.asked.scene

    @property
    def what(self) -> str:
        """As progress names it."""
        return f"{self.asked.name}: {self.engine.name}"

    @property
    def name(self) -> tuple[object, ...]:
        """Equal for jobs that make the same file."""
        return self.key, self.number

    @property
    def own_seed(self) -> int:
        """What the command is given as `{seed}`."""
        return running.seed_of(self.asked.digest, self.seed, self.number)

    def files(self, cache: Path) -> tuple[Path, ...]:
        """What it makes in a cache."""
        return (cache / "engines" / "images" / self.key[:2] / f"{self.key}-{self.number:04d}.npz",)

    def kept(self, cache: Path) -> bool:
        """Whether a cache has it."""
        return self.read(cache) is not None

    def here(self) -> "EngineReplicate":
        """The job as this process would name it: another key where another version of the engine is here."""
        return replicate(self.engine, self.asked, spp=self.spp, seed=self.seed, number=self.number)

    def take(self, seat: "Seat") -> tuple[bool, float]:
        """Have it rendered, unless the cache has it; whether it was; an engine's start stands in its seconds."""
        if self.kept(seat.cache):
            return False, 0.0
        threads = seat.threads or os.cpu_count() or 1
        kept = seat.cache / "engines" / "failed"
        ran = running.run(self.engine, self.asked, spp=self.spp, seed=self.own_seed, threads=threads, kept=kept)
        arrays = {"image": ran.image, "seconds": np.float64(ran.seconds), "notes": np.array(ran.notes, np.str_)}
        write_atomically(self.files(seat.cache)[0], lambda temporary: np.savez_compressed(temporary, **arrays))
        return True, 0.0

    def read(self, cache: Path) -> running.Ran | None:
        """The image that is kept; None where it is missing or damaged (NPZ has checksums)."""
        try:
            with np.load(self.files(cache)[0]) as arrays:
                image, seconds, notes = arrays["image"], float(arrays["seconds"]), tuple(arrays["notes"].tolist())
        except (OSError, ValueError, KeyError, EOFError, RuntimeError, zipfile.BadZipFile):
            return None
        width, height = self.asked.resolution
        return running.Ran(image, seconds, notes) if image.shape == (height, width, 3) else None


def replicate(engine: Engine, asked: Asked, *, spp: int, seed: int, number: int) -> EngineReplicate:
    """The job of one image.

    Raises
    ------
    EngineError : the engine is not here.
    """
    # What the scene is written by decides too.
    sources = sources_digest(ROOT / "reports" / "engines", ROOT / "scenes" / "exchange")
    key = hashlib.sha256(repr((engine.digest, asked.digest, spp, seed, sources)).encode()).hexdigest()
    return EngineReplicate(engine, asked, spp, seed, number, key)


def replicates(engine: Engine, asked: Asked, *, spp: int, seed: int, count: int) -> list[EngineReplicate]:
    """The jobs of `count` images; of an engine without noise one."""
    return [
        replicate(engine, asked, spp=spp, seed=seed, number=number)
        for number in range(1 if engine.says.noiseless else count)
    ]


@attrs.define
class Here:
    """A seat for engines alone: this process, which renders nothing itself."""

    cache: Path
    threads: int | None = None

    def ready(self, scene: Any) -> Any:
        """No scene of ours is made ready."""
        raise NotImplementedError

    def compiling(self, kernels: tuple[str, ...]) -> Any:
        """No kernels."""
        raise NotImplementedError


def made(
    jobs: Sequence[EngineReplicate], *, threads: int | None = None, together: int = 1
) -> Iterator[EngineReplicate]:
    """Have jobs done in the cache, so many `together`, which share the threads; yields each when it is.

    Raises
    ------
    EngineError : of the first that fails; those that run are waited for.
    """
    seat = Here(cache_folder(), max(1, (threads or os.cpu_count() or 1) // together))
    over = threading.Event()

    def take(job: EngineReplicate) -> EngineReplicate | None:
        if over.is_set():
            return None
        try:
            job.take(seat)
        except BaseException:
            over.set()  # here, for this thread would begin the next one
            raise
        return job

    with ThreadPoolExecutor(together) as pool:
        try:
            for done in as_completed([pool.submit(take, job) for job in jobs]):
                if (job := done.result()) is not None:
                    yield job
        except EngineError:
            raise
        except BaseException:  # Ctrl-C, which reaches this thread alone
            over.set()
            running.end_all()
            raise


@attrs.frozen(eq=False)
class Images:
    """Images of one scene: (K, H, W, 3), seconds (K,), and what was done to read them."""

    stack: np.ndarray
    seconds: np.ndarray
    notes: tuple[str, ...]


def collected(jobs: Sequence[EngineReplicate], cache: Path) -> Images:
    """The images of jobs of one scene, all of which are done.

    Raises
    ------
    EngineError : one is missing or damaged; two seeds have the same image, though the engine is said to have noise.
    """
    found: list[running.Ran] = []
    seen: dict[bytes, int] = {}
    for job in jobs:
        ran = job.read(cache)
        if ran is None:
            raise EngineError(f"{job.what}: {job.files(cache)[0]}: is missing or damaged: run it again")
        found.append(ran)
        digest = hashlib.sha256(ran.image.tobytes()).digest()
        if digest in seen and job.asked.noisy and not job.engine.says.noiseless:
            raise EngineError(
                f"{job.engine.name}: {job.asked.name}: seeds {seen[digest]} and {job.own_seed} give the same image: "
                "allowed are independent ones, or noiseless = true where it has no noise"
            )
        seen[digest] = job.own_seed
    notes = dict.fromkeys(note for ran in found for note in ran.notes)
    return Images(np.stack([ran.image for ran in found]), np.array([ran.seconds for ran in found]), tuple(notes))


def rendered(
    engine: Engine,
    asked: Asked,
    *,
    spp: int,
    seed: int,
    count: int,
    threads: int | None = None,
    together: int = 1,
    executor: "Executor | None" = None,
    progress: Callable[[], object] | None = None,
) -> Images:
    """Images of one scene, from the cache or rendered now; arguments as for `replicates` and `made`.

    `executor` : has them done, by its own threads; None: this process.
    """
    jobs = replicates(engine, asked, spp=spp, seed=seed, count=count)
    for _ in made(jobs, threads=threads, together=together) if executor is None else _by(executor, jobs):
        if progress:
            progress()
    return collected(jobs, cache_folder())


def _by(executor: "Executor", jobs: Sequence[EngineReplicate]) -> Iterator[EngineReplicate]:
    """Have an executor do jobs; yields each when it is done."""
    for outcome in executor.run(jobs, cache_folder(), lambda job: False):
        if outcome.error is not None:
            raise outcome.error
        yield cast(EngineReplicate, outcome.job)
