"""What does jobs: it takes them in any order, puts what they make into the cache, and says of each how it ended."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

import attrs

from termwise.renderer.engine import Engine
from termwise.reports.jobs.cells import Job
from termwise.scenes.model import Scene


@attrs.frozen(eq=False)
class Outcome:
    """How a job ended.

    Attributes
    ----------
    made : whether it was computed; else the cache had it.
    compile_seconds : spent compiling or loading kernels for it.
    error : why there is no replicate, or None.
    host : who did it; "" is this process.
    """

    job: Job
    made: bool = False
    compile_seconds: float = 0.0
    error: Exception | None = None
    host: str = ""


class Executor(Protocol):
    """Does jobs.

    Attributes
    ----------
    elsewhere : whether in other processes, to which estimators have to be sent.
    """

    elsewhere: bool

    def run(self, jobs: Sequence[Job], cache: Path, dropped: Callable[[Job], bool]) -> Iterator[Outcome]:
        """Yield the outcome of each job as it ends; those that are `dropped` when their turn comes have none."""
        ...


@attrs.frozen
class InThisProcess:
    """One job after another; the kernels of each take all threads."""

    elsewhere = False

    def run(self, jobs: Sequence[Job], cache: Path, dropped: Callable[[Job], bool]) -> Iterator[Outcome]:
        """Yield outcomes in the order of the jobs: those of one scene share its tree while they follow each other."""
        with Worker(cache) as worker:
            for job in jobs:
                if not dropped(job):
                    yield worker.take(job)


class Worker:
    """A process that does jobs, and what it keeps between them: the last scene made ready."""

    def __init__(self, cache: Path, threads: int | None = None) -> None:
        self.cache, self.threads = cache, threads
        self._engine: Engine | None = None
        self._digest = ""

    def __enter__(self) -> Self:
        """Return the worker; what it keeps goes with the block."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Let running tiles finish and drop the rest."""
        self._close()

    def _close(self) -> None:
        if self._engine is not None:
            self._engine.__exit__()
        self._engine = None

    def ready(self, scene: Scene) -> Engine:
        """The engine of a scene, that of the job before if it had the same."""
        if self._engine is None or (scene is not self._engine.scene and scene.digest(without=()) != self._digest):
            self._close()
            self._engine, self._digest = Engine(scene, threads=self.threads), scene.digest(without=())
        return self._engine

    def compiling(self, kernels: tuple[str, ...]) -> AbstractContextManager[object]:
        """Around work that may compile kernels: nobody else here does."""
        return nullcontext()

    def take(self, job: Job) -> Outcome:
        """Do a job.

        Raises
        ------
        OSError : the cache cannot be written: no other job could do better.
        """
        try:
            return Outcome(job, *job.take(self))
        except OSError:
            raise
        except Exception as error:  # a scene's own fault, told with its name
            if _interrupted(error):
                raise KeyboardInterrupt from error
            return Outcome(job, error=error)


def _interrupted(error: BaseException | None) -> bool:
    """Whether Ctrl-C is behind it: what is raised while Dr.Jit traces a loop it makes an error of its own."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None
