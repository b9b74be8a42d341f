"""Jobs on a dask.distributed cluster: job -> a worker's cache -> the client's, by the names that both give its files.

A worker looks into its cache, renders what is not there, keeps it, and says who did what in how many seconds; bytes
travel only where this machine does not see the worker's cache, which a probe file tells. Before a job is done the
worker names its files itself: other sources, versions, estimators or another Mitsuba give other names, and the worker
is refused. Scheduling, heartbeats and repetition are those of dask.distributed.
"""

import asyncio
import contextlib
import fcntl
import functools
import hashlib
import importlib.metadata
import logging
import math
import os
import pickle
import platform
import runpy
import threading
import time
import uuid
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, NamedTuple, cast

import attrs
import distributed
from dask import config
from distributed import Client, Future, LocalCluster
from distributed.client import FutureCancelledError
from llvmlite.binding import get_host_cpu_name

from termwise.reference import backend
from termwise.renderer.fingerprint import Unknown
from termwise.reports.jobs.cells import Job
from termwise.reports.jobs.executors import Outcome, Worker
from termwise.reports.machine import versions
from termwise.scenes.model import Scene
from termwise.scenes.store import ROOT, cache_folder, sources_digest, write_atomically

CONNECT_SECONDS = 10
"""Within which a scheduler answers."""
LOSSES = 10
"""Workers that a job may lose before it is given up; a scheduler of one's own has a setting for it."""
_AHEAD = 2
"""Batches that a worker has at once: one that it does, another so that it need not wait for messages."""
_MOMENT, _MOST = 0.2, 64
"""Seconds for which a worker goes on with a batch, and jobs in it: a message costs milliseconds, whatever it brings.
What is not begun by then comes back, so that no job waits for one worker while another has nothing to do.
"""
_NEWS_SECONDS = 0.5
"""For which a list of the workers is good."""
_VERSION = importlib.metadata.version("distributed")
_RETRIES = 2
"""Of a job whose worker cannot write: another may have room."""
_SETTINGS = {
    "distributed.scheduler.allowed-failures": LOSSES,
    "distributed.scheduler.worker-ttl": "60 s",
    # dask's own makes glibc give every image back to the system: a seventh of a worker's time went into fetching pages.
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
    # A profiler that holds frames frees Dr.Jit's arrays in its own thread: that spins while another compiles a kernel.
    "distributed.worker.profile.enabled": False,
}


Names = tuple[str, ...]
"""Of a job's files, from a cache's folder on."""


class ClusterError(ValueError):
    """The cluster cannot do the jobs; the message says why, in one line."""


@attrs.frozen
class Machine:
    """What decides the bits of a replicate beside its job; workers are like the client in all of it.

    Attributes
    ----------
    processor : as LLVM names it, whose instructions compiled code has.
    backend : Mitsuba's variant.
    sources : sha256 of all that renders.
    versions : of everything that makes numbers.
    """

    processor: str
    backend: str
    sources: str
    versions: tuple[tuple[str, str], ...]

    @classmethod
    def here(cls) -> "Machine":
        """That of this process."""
        return cls(
            f"{platform.machine()} {get_host_cpu_name()}",
            backend.choose().variant,
            sources_digest(*(ROOT / name for name in ("renderer", "reference", "scenes"))),
            (*versions().items(), ("distributed", _VERSION)),
        )

    def unlike(self, other: "Machine") -> str:
        """What differs in the other, and what this one has; empty if nothing does."""
        found = [
            f"{name} {theirs}: allowed is {ours}"
            for name, ours, theirs in (
                ("processor", self.processor, other.processor),
                ("Mitsuba variant", self.backend, other.backend),
                *((name, version, dict(other.versions).get(name, "none")) for name, version in self.versions),
            )
            if ours != theirs
        ]
        if self.sources != other.sources:
            found.append("other sources of termwise: allowed are those of the client")
        return ", ".join(found)


@attrs.frozen
class Terms:
    """What a worker has to know for all jobs of a client.

    Attributes
    ----------
    cache, probe : the client's folder, and the name of a file in it.
    machine : what the worker has to be like.
    estimators : name and source of a file that registers some, or None.
    """

    cache: str
    probe: str
    machine: Machine
    estimators: tuple[str, str] | None


@attrs.frozen
class Done:
    """What a worker answers.

    Attributes
    ----------
    host, worker : its name and address.
    made : whether it was rendered.
    compile_seconds : spent on kernels.
    error : why there is nothing, or None.
    unlike : why the worker may not do the job, or "".
    files : content by place in `Job.files`, where the client does not see the cache.
    """

    host: str
    worker: str
    made: bool = False
    compile_seconds: float = 0.0
    error: Exception | None = None
    unlike: str = ""
    files: tuple[bytes, ...] = ()


# A worker.


class _Seat(Worker):
    """The process of a worker: kernels that it has not compiled yet are compiled by one process of a node at a time."""

    def __init__(self, cache: Path, threads: int) -> None:
        super().__init__(cache, threads)
        self._compiled: set[str] = set()

    @contextlib.contextmanager
    def compiling(self, kernels: tuple[str, ...]) -> Iterator[None]:
        """Wait for whoever compiles one of them, who leaves it in Numba's cache."""
        with contextlib.ExitStack() as held:
            for name in sorted(set(kernels) - self._compiled):
                lock = cache_folder() / "numba" / f"{name}.lock"
                lock.parent.mkdir(parents=True, exist_ok=True)
                fcntl.flock(held.enter_context(lock.open("w")), fcntl.LOCK_EX)
            yield
        self._compiled |= set(kernels)


# Numba's kernels and Mitsuba take all threads of a worker: one job at a time.
_turn = threading.Lock()


@functools.cache
def _seat(cache: Path, threads: int) -> _Seat:
    return _Seat(cache, threads)


@functools.cache
def _register(name: str, source: str) -> str:
    """Run a file that registers estimators, once in a process; why that failed."""
    path = cache_folder() / "estimators" / hashlib.sha256(source.encode()).hexdigest()[:16] / name
    write_atomically(path, lambda temporary: temporary.write_text(source, "utf-8"))
    try:
        runpy.run_path(str(path), run_name=path.stem)
    except Exception as error:  # one of an earlier version is there, or whatever the file does
        return f"{name}: {' '.join(str(error).split())}: start the worker anew"
    return ""


@functools.cache
def _unlike(machine: Machine) -> str:
    """What differs here from the client's machine."""
    return machine.unlike(Machine.here())


def _another(job: Job, names: Names, cache: Path) -> str:
    """Whether this process would give the job's files other names than the client does, or does not know it."""
    try:
        here = _names(job.here(), cache)
    except Unknown:  # it has no name of its own: the file that registers it is the same
        return ""
    except ValueError as error:
        return f"{job.what}: {error}"
    return "" if here == names else f"{job.what}: is another estimator there: allowed is the client's"


def _do(makes: Sequence[Callable[..., Job]], scene: Scene, names: Sequence[Names], terms: Terms) -> list[Done]:
    """Do jobs on a worker one after another, those of a moment, and at least one."""
    worker, found = distributed.get_worker(), []
    with _turn:
        until = time.monotonic() + _MOMENT
        for make, each in zip(makes, names, strict=True):
            try:
                found.append(_do_one(make, scene, each, terms, worker))
            except OSError as error:
                raise OSError(f"{worker.address}: {error}") from None
            if found[-1].unlike or time.monotonic() > until:
                break
    return found


def _do_one(make: Callable[..., Job], scene: Scene, names: Names, terms: Terms, worker: distributed.Worker) -> Done:
    done = functools.partial(Done, platform.node(), worker.address)
    if why := _unlike(terms.machine):
        return done(unlike=why)
    if terms.estimators is not None and (why := _register(*terms.estimators)):
        return done(unlike=why)
    shared = (Path(terms.cache) / terms.probe).is_file()
    seat = _seat(Path(terms.cache) if shared else cache_folder(), worker.state.nthreads)
    job = make(scene=scene)
    if why := _another(job, names, seat.cache):
        return done(unlike=why)
    outcome = seat.take(job)
    unseen = () if shared or outcome.error else tuple(path.read_bytes() for path in job.files(seat.cache))
    return done(outcome.made, outcome.compile_seconds, _sendable(outcome.error), files=unseen)


def _sendable(error: Exception | None) -> Exception | None:
    """An error that can be sent."""
    try:
        return pickle.loads(pickle.dumps(error))
    except Exception:  # whatever an object's own methods do
        return RuntimeError(f"{type(error).__name__}: {error}")


def _names(job: Job, cache: Path) -> Names:
    return tuple(path.relative_to(cache).as_posix() for path in job.files(cache))


# The client.


@attrs.frozen
class Cluster:
    """Has jobs done by a cluster.

    Attributes
    ----------
    client : of dask.distributed.
    estimators : a file that registers some, which workers run too.
    say : called with a line where a worker is refused.
    """

    client: Client
    estimators: Path | None = None
    say: Callable[[str], object] = lambda line: None
    elsewhere = False  # workers register estimators by the file, and name them before they do a job

    def run(self, jobs: Sequence[Job], cache: Path, dropped: Callable[[Job], bool]) -> Iterator[Outcome]:
        """Yield outcomes as workers end jobs; a job whose worker is lost is done again by another.

        Raises
        ------
        ClusterError : no worker is like this machine, the scheduler is gone, or a job has cost too many workers.
        OSError : the cache cannot be written.
        """
        with _probe(cache) as probe:
            estimators = None
            if self.estimators is not None:
                estimators = self.estimators.name, self.estimators.read_text("utf-8")
            terms = Terms(str(cache.absolute()), probe, Machine.here(), estimators)
            yield from _Run(self, cache, terms).outcomes(jobs, dropped)

    def executor(self) -> Executor:
        """Workers for functions that are no jobs and keep no files, as an executor of concurrent.futures.

        Raises
        ------
        ClusterError : no worker is like this machine.
        """
        found = cast(Any, self.client.run(_unlike, Machine.here()))
        for worker, why in found.items():
            if why:
                self.say(f"{worker} is refused: {why}")
        if not (alike := [worker for worker, why in found.items() if not why]):
            raise ClusterError(f"{_address(self.client)}: no worker there is like this machine")
        return self.client.get_executor(workers=alike, pure=False, retries=_RETRIES)


@contextlib.contextmanager
def _probe(cache: Path) -> Iterator[str]:
    """A file whose name nobody else has: who finds it sees this cache."""
    path = cache / "probes" / f"client-{uuid.uuid4().hex}"
    write_atomically(path, lambda temporary: temporary.touch())
    try:
        yield path.relative_to(cache).as_posix()
    finally:
        path.unlink(missing_ok=True)


class _Batch(NamedTuple):
    """Jobs of one scene under way, and the worker that shall do them."""

    jobs: list[Job]
    names: list[Names]
    worker: str


class _Run:
    """Jobs under way."""

    def __init__(self, cluster: Cluster, cache: Path, terms: Terms) -> None:
        self.cluster, self.cache, self.terms = cluster, cache, terms
        self.client = cluster.client
        self.scenes: dict[int, tuple[Scene, Future]] = {}
        self.todo: dict[str, deque[Job]] = {}  # by what they are of, which a worker compiles and traces once
        self.has: dict[str, str] = {}  # what a worker had last
        self.sent: dict[Future, _Batch] = {}
        self.most = 1  # jobs in a batch, of what a moment has
        self.refused: set[str] = set()
        self.full: set[str] = set()  # workers that could not write: asked where there is no other
        self.failures: Counter[Names] = Counter()
        self.workers: list[str] = []
        self.asked = -math.inf

    def outcomes(self, jobs: Sequence[Job], dropped: Callable[[Job], bool]) -> Iterator[Outcome]:
        """Keep workers supplied, and forget each job as it ends."""
        ended: Any = distributed.as_completed(loop=self.client.loop)
        for job in jobs:
            self.todo.setdefault(job.what, deque()).append(job)
        try:
            while True:
                while self.todo and (worker := self._free()):
                    if batch := (yield from self._next(worker, dropped)):
                        ended.add(self._send(batch, worker))
                if not self.sent:
                    return
                futures = ended.next_batch()
                whole = [future for future in futures if future.status == "finished"]
                # One message for all of them; what went wrong is raised where it is asked for.
                found = dict(zip(whole, cast(Any, self.client.gather(whole)), strict=True))
                for future in futures:
                    yield from self._told(future, found)
        except (OSError, FutureCancelledError, asyncio.CancelledError) as error:
            if self.client.status == "running" and isinstance(error, OSError):
                raise
            address = _address(self.client)
            raise ClusterError(f"{address}: the scheduler is gone; the same command goes on from the cache") from None
        finally:
            with contextlib.suppress(Exception):  # the scheduler may be gone
                self.client.cancel(list(self.sent), force=True)

    def _free(self) -> str | None:
        """The worker that has least to do, if it can have more."""
        load = Counter(batch.worker for batch in self.sent.values())
        alike = self._alike()
        worker = min([each for each in alike if each not in self.full] or alike, key=load.__getitem__)
        return worker if load[worker] < _AHEAD else None

    def _alike(self) -> list[str]:
        """Workers that are not refused."""
        if time.monotonic() - self.asked > _NEWS_SECONDS:
            # Where all are lost the last list stands: what is sent by it waits at the scheduler for those that come.
            self.workers = sorted(_threads(self.client)) or self.workers
            self.asked = time.monotonic()
        if not (alike := [worker for worker in self.workers if worker not in self.refused]):
            raise ClusterError(f"{_address(self.client)}: no worker there is like this machine")
        return alike

    def _next(self, worker: str, dropped: Callable[[Job], bool]) -> Generator[Outcome, None, list[Job]]:
        """Jobs of one scene and kind for a batch; what is kept costs no message."""
        others = {self.has[each] for each in self.workers if each != worker and each in self.has}
        own = (what for what in (self.has.get(worker), *self.todo) if what in self.todo and what not in others)
        what = next(own, None) or next(iter(self.todo))
        queue, batch = self.todo[what], list[Job]()
        while queue and len(batch) < self.most:
            job = queue.popleft()
            if batch and job.scene is not batch[0].scene:
                queue.appendleft(job)
                break
            if dropped(job):
                continue
            if job.kept(self.cache):
                yield Outcome(job)
            else:
                batch.append(job)
        if batch:
            self.has[worker] = what
        if not queue:
            del self.todo[what]
        return batch

    def _put_back(self, jobs: Sequence[Job]) -> None:
        for job in reversed(jobs):
            self.todo.setdefault(job.what, deque()).appendleft(job)

    def _send(self, jobs: list[Job], worker: str) -> Future:
        scene = jobs[0].scene
        if id(scene) not in self.scenes:
            # A task and not scattered data: where its worker is lost it is made again.
            payload = pickle.dumps(scene)
            future = self.client.submit(pickle.loads, payload, key=f"scene-{uuid.uuid4().hex}", pure=False)
            self.scenes[id(scene)] = scene, future
        names = [_names(job, self.cache) for job in jobs]
        future = self.client.submit(
            _do,
            [_unbound(job) for job in jobs],
            self.scenes[id(scene)][1],
            names,
            self.terms,
            key=f"{names[0][-1]}-{uuid.uuid4().hex[:8]}",
            pure=False,
            workers=[worker],
            allow_other_workers=True,  # where it is lost
        )
        self.sent[future] = _Batch(jobs, names, worker)
        return future

    def _told(self, future: Future, found: dict[Future, list[Done]]) -> Iterator[Outcome]:
        """What came of a batch; the jobs that were not begun, and those of a refused worker, are to be done still."""
        batch = self.sent.pop(future)
        try:
            done = found[future] if future in found else cast(list[Done], future.result())
        except distributed.KilledWorker as error:
            what = dict.fromkeys(job.what for job in (batch.jobs[0], batch.jobs[-1]))
            raise ClusterError(f"{' to '.join(what)}: is given up: {' '.join(str(error).split())}") from None
        except OSError:
            self.failures.update(batch.names)
            if self.client.status != "running" or any(self.failures[each] > _RETRIES for each in batch.names):
                raise
            # Not by dask's `retries`: it would ask the same worker again.
            self.full.add(batch.worker)
            self._put_back(batch.jobs)
            return
        future.release()
        done = [each for each in done if not self._refused(each)]
        self._put_back(batch.jobs[len(done) :])
        self.most = min(2 * len(done), _MOST) if len(done) == len(batch.jobs) else max(1, len(done))
        for job, names, each in zip(batch.jobs, batch.names, done, strict=False):
            for name, content in zip(names, each.files, strict=False):
                path = self.cache / name
                write_atomically(path, lambda temporary, content=content: temporary.write_bytes(content))
            yield Outcome(job, each.made, each.compile_seconds, each.error, each.host)

    def _refused(self, done: Done) -> bool:
        if done.unlike and done.worker not in self.refused:
            self.refused.add(done.worker)
            self.cluster.say(f"{done.worker} is refused: {done.unlike}")
        return bool(done.unlike)


def _unbound(job: Job) -> Callable[..., Job]:
    """A job without its scene, which is sent once for all; one that has it within another value is whole."""
    kind: Any = type(job)
    fields = {field.name: getattr(job, field.name) for field in attrs.fields(kind)}
    if fields.pop("scene", None) is None:
        return functools.partial(_whole, job)
    return functools.partial(kind, **fields)


def _whole(job: Job, scene: Scene) -> Job:
    return job


def _threads(client: Client) -> dict[str, int]:
    """Threads of each worker, by its address."""
    return cast(Any, client.nthreads())  # typed as what an asynchronous client returns


def _address(client: Client) -> str:
    return str(client.scheduler.address if client.scheduler else "the cluster")


@contextlib.contextmanager
def connected(
    say: Callable[[str], object],
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    estimators: Path | None = None,
) -> Iterator[Cluster]:
    """A cluster: `workers` processes of this machine, or whatever a scheduler has.

    Parameters
    ----------
    say : called with lines: where the dashboard is, who is refused.
    workers : at least 1; they share the cores.
    scheduler : its address, as tcp://host:8786.
    estimators : a file that registers some, which workers run too.

    Raises
    ------
    ValueError : neither or both are given, `workers` is below 1.
    ClusterError : nothing answers at the address, it has no workers, or its dask is another.
    """
    if (workers is None) == (scheduler is None):
        raise ValueError("workers, scheduler: allowed is one of them")
    if workers is not None and workers < 1:
        raise ValueError(f"workers = {workers}: allowed is at least 1")
    with contextlib.ExitStack() as stack:
        # A worker that is killed takes no blame to its job; one that is silent so long is lost.
        stack.enter_context(config.set(_SETTINGS))
        if workers is not None:
            share = max(1, (os.cpu_count() or 1) // workers)
            where: Any = stack.enter_context(
                LocalCluster(
                    n_workers=workers,
                    threads_per_worker=share,
                    processes=True,
                    dashboard_address="127.0.0.1:0",
                    silence_logs=logging.CRITICAL,
                )
            )
        else:
            where = scheduler
        try:
            client = stack.enter_context(Client(where, timeout=CONNECT_SECONDS, set_as_default=False))
        except (OSError, ValueError, TypeError) as error:
            reason = " ".join(str(error).split())
            raise ClusterError(
                f"scheduler = {scheduler}: {reason}: allowed is the address of a dask scheduler, as tcp://host:8786"
            ) from None
        _check(client)
        say(f"workers: {len(_threads(client))} at {_address(client)}, dashboard {client.dashboard_link}")
        yield Cluster(client, estimators, say)


def _check(client: Client) -> None:
    """Refuse a cluster without workers, or of another dask, whose messages may mean something else."""
    found = cast(Any, client.get_versions())["scheduler"]["packages"]["distributed"]
    if found != _VERSION:
        raise ClusterError(f"{_address(client)}: distributed {found}: allowed is {_VERSION}, as here")
    if not _threads(client):
        raise ClusterError(
            f"{_address(client)}: has no workers: allowed is at least one (dask worker {_address(client)})"
        )
