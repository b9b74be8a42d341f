"""Jobs on a cluster: the same bits whoever does them, nothing lost or done twice in a row, and faults are one line.

Workers are processes of this machine. A folder that they do not share is one whose probe file they do not find.
"""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import attrs
import distributed
import numpy as np
import pytest

from termwise.renderer.terms import find, register
from termwise.reports.engines import engine
from termwise.reports.engines.asked import Asked
from termwise.reports.engines.replicates import rendered
from termwise.reports.jobs import cells, cluster
from termwise.reports.jobs.cluster import Cluster, ClusterError, Machine, connected
from termwise.reports.jobs.executors import InThisProcess, Worker
from termwise.scenes.exchange import neutral
from termwise.scenes.limits import Limit
from termwise.scenes.model import Scene
from termwise.scenes.store import ROOT, cache_folder, write_atomically
from tests.scenes import small

pytestmark = [
    pytest.mark.usefixtures("_tables"),
    pytest.mark.slow,
    pytest.mark.skipif(
        os.environ.get("NUMBA_DISABLE_JIT", "0") != "0", reason="workers render, which as plain Python takes minutes"
    ),
]


@attrs.frozen(eq=False)
class Note:
    """A job that writes the number of the process that did it."""

    scene: Scene
    number: int
    seconds: float = 0.0
    fault: str = ""

    @property
    def what(self) -> str:
        return f"note {self.number}"

    @property
    def name(self) -> tuple[object, ...]:
        return (self.number,)

    def files(self, cache: Path) -> tuple[Path, ...]:
        return (cache / "notes" / f"{self.number}.txt",)

    def kept(self, cache: Path) -> bool:
        return self.files(cache)[0].is_file()

    def here(self) -> "Note":
        return attrs.evolve(self, number=-1) if self.fault == "another" else self

    def take(self, seat) -> tuple[bool, float]:
        time.sleep(self.seconds)
        if self.fault == "error":
            raise RuntimeError("no kernel\nfor this")
        if self.fault == "disk" or (self.fault == "a disk" and distributed.get_worker().name == 0):
            raise OSError("no space left")
        write_atomically(self.files(seat.cache)[0], lambda path: path.write_text(str(os.getpid()), "utf-8"))
        return True, 0.0


@pytest.fixture(scope="module")
def lines() -> list[str]:
    return []


@pytest.fixture(scope="module")
def two(lines: list[str], tmp_path_factory) -> Iterator[Cluster]:
    """Two workers, whose own cache lies apart but for compiled kernels."""
    folder = tmp_path_factory.mktemp("workers")
    (folder / "numba").symlink_to(cache_folder() / "numba")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TERMWISE_CACHE", str(folder))
        with connected(lines.append, workers=2) as found:
            yield found


def never(job) -> bool:
    return False


def done(executor: Cluster, jobs: list, cache: Path) -> list[Any]:
    return list(executor.run(jobs, cache, never))


@pytest.fixture
def _apart(monkeypatch):
    """Workers do not find the probe file of this machine's cache."""
    monkeypatch.setattr(cluster, "_probe", lambda cache: contextlib.nullcontext("probes/of nobody"))


def replicates(scene: Scene) -> list[cells.Replicate]:
    cosine = find("ambient", "cosine")
    key = cells.key(scene, cosine, samples=2, seed=1, chain="next-event")
    return [cells.Replicate(scene, "ambient", "cosine", (2,), 1, "next-event", key, number) for number in range(3)]


def image(jobs: list[cells.Replicate], cache: Path) -> np.ndarray:
    own = find("ambient", "cosine").limit(jobs[0].scene, 2)
    return cells.read(jobs, own, cache / "cells").images


def test_the_same_bits_as_in_one_process(two: Cluster, tmp_path: Path):
    jobs = replicates(small("two_cubes", 8))
    here = list(InThisProcess().run(jobs, tmp_path / "here", never))
    there = done(two, jobs, tmp_path / "there")
    assert {outcome.job.number for outcome in there} == {0, 1, 2}
    assert all(outcome.made and outcome.host for outcome in there)
    assert not any(outcome.host for outcome in here)
    np.testing.assert_array_equal(image(jobs, tmp_path / "here"), image(jobs, tmp_path / "there"))
    again = done(two, jobs, tmp_path / "there")
    assert not any(outcome.made for outcome in again)


@pytest.mark.usefixtures("_apart")
def test_without_a_shared_folder_bytes_are_sent(two: Cluster, tmp_path: Path):
    jobs = replicates(small("two_cubes", 8))
    assert all(outcome.made for outcome in done(two, jobs, tmp_path / "client"))
    assert len(list((tmp_path / "client" / "cells").rglob("*.npz"))) == len(jobs)
    list(InThisProcess().run(jobs, tmp_path / "here", never))
    np.testing.assert_array_equal(image(jobs, tmp_path / "here"), image(jobs, tmp_path / "client"))
    # The workers have them: a client without them gets them unrendered.
    assert not any(outcome.made for outcome in done(two, jobs, tmp_path / "another"))
    np.testing.assert_array_equal(image(jobs, tmp_path / "client"), image(jobs, tmp_path / "another"))


def test_killed_workers_lose_no_job_and_none_is_told_twice(two: Cluster, tmp_path: Path):
    """A worker is killed after every tenth of 40 jobs."""
    told, killed = [], 0
    outcome: Any
    for outcome in two.run([Note(small("two_cubes", 4), number, 0.02) for number in range(40)], tmp_path, never):
        told.append(outcome.job.number)
        if len(told) % 10 == 0 and len(told) < 40:
            pids = list(cast(Any, two.client.run(os.getpid, on_error="ignore")).values())
            os.kill(pids[0], signal.SIGKILL)
            killed += 1
    assert killed == 3
    assert sorted(told) == list(range(40))
    assert len(list((tmp_path / "notes").glob("[0-9]*.txt"))) == 40  # who was killed leaves hidden halves
    again = done(two, [Note(small("two_cubes", 4), number) for number in range(50)], tmp_path)
    assert sorted(outcome.job.number for outcome in again if outcome.made) == list(range(40, 50))
    assert len(again) == 50


def test_what_a_worker_has_not_begun_is_done_by_whoever_is_free(two: Cluster, tmp_path: Path):
    """Quick jobs come in large batches; of slow ones that follow in such a batch no worker keeps more than a share."""
    scene = small("two_cubes", 4)
    jobs = [Note(scene, number) for number in range(100)] + [Note(scene, 100 + number, 0.3) for number in range(12)]
    assert sorted(outcome.job.number for outcome in done(two, jobs, tmp_path)) == list(range(112))
    slow = [(tmp_path / "notes" / f"{100 + number}.txt").read_text("utf-8") for number in range(12)]
    assert min(slow.count(worker) for worker in set(slow)) >= 4
    assert len(set(slow)) == 2


def test_an_error_is_the_job_s_own(two: Cluster, tmp_path: Path):
    scene = small("two_cubes", 4)
    found = done(two, [Note(scene, 0, fault="error"), Note(scene, 1)], tmp_path)
    errors = {outcome.job.number: outcome.error for outcome in found}
    assert "no kernel" in str(errors[0])
    assert errors[1] is None


def test_a_full_disk_ends_the_run(two: Cluster, tmp_path: Path):
    with pytest.raises(OSError, match="no space left"):
        done(two, [Note(small("two_cubes", 4), 0, fault="disk")], tmp_path)


def test_what_a_worker_cannot_write_another_does(two: Cluster, tmp_path: Path):
    scene = small("two_cubes", 4)
    jobs = [Note(scene, number, fault="a disk") for number in range(20)]
    assert sorted(outcome.job.number for outcome in done(two, jobs, tmp_path)) == list(range(20))


def test_what_is_dropped_is_not_sent(two: Cluster, tmp_path: Path):
    jobs = [Note(small("two_cubes", 4), number) for number in range(4)]
    outcomes: Any = two.run(jobs, tmp_path, lambda job: job.name != (2,))
    assert [outcome.job.number for outcome in outcomes] == [2]


def test_workers_that_are_not_like_this_machine_are_refused(
    two: Cluster, lines: list[str], tmp_path: Path, monkeypatch
):
    """By what decides bits, each named, and by another estimator of the same name."""
    here = Machine.here()
    other = attrs.evolve(here, sources="another", processor="a processor", versions=(("numba", "0.1"),))
    monkeypatch.setattr(Machine, "here", classmethod(lambda cls: other))
    with pytest.raises(ClusterError, match="no worker there is like this machine"):
        done(two, [Note(small("two_cubes", 4), 0)], tmp_path)
    refused = [line for line in lines if "is refused" in line]
    assert refused
    assert all(word in refused[0] for word in ("a processor", "numba", "0.1", "sources"))
    monkeypatch.setattr(Machine, "here", classmethod(lambda cls: here))
    with pytest.raises(ClusterError, match="no worker"):
        done(two, [Note(small("two_cubes", 4), 0, fault="another")], tmp_path)
    assert "another estimator" in lines[-1]


def test_functions_are_done_by_workers_that_are_like_this_machine(two: Cluster, lines: list[str], monkeypatch):
    executor = two.executor()
    assert list(executor.map(divmod, (7, 8), (4, 4))) == [(1, 3), (2, 0)]
    assert executor.submit(os.getpid).result() != os.getpid()
    here = attrs.evolve(Machine.here(), processor="another")
    monkeypatch.setattr(Machine, "here", lambda: here)
    with pytest.raises(ClusterError, match="no worker there is like this machine"):
        two.executor()
    assert "is refused: processor" in lines[-1]


def test_estimators_of_a_file_are_registered_on_workers(two: Cluster, tmp_path: Path):
    file = tmp_path / "mine.py"
    file.write_text(
        "import numpy as np\nimport termwise\n"
        "def grey(scene, samples, seed):\n    return np.full((*scene.resolution[::-1], 3), 0.5)\n"
        'termwise.register("ambient", "grey", grey, termwise.Limit("ambient"))\n'
    )
    from termwise.reports.cli.runs import run_file

    run_file(file)
    scene = small("two_cubes", 4)
    key = cells.key(scene, find("ambient", "grey"), samples=1, seed=1, chain="path")
    job = cells.Replicate(scene, "ambient", "grey", (1,), 1, "path", key, 0)
    (outcome,) = done(attrs.evolve(two, estimators=file), [job], tmp_path)
    assert outcome.error is None
    assert outcome.made
    np.testing.assert_array_equal(cells.read([job], Limit("ambient"), tmp_path / "cells").images, 0.5)
    # A run has its jobs done in several calls.
    again = attrs.evolve(job, number=1)
    (outcome,) = done(attrs.evolve(two, estimators=file), [again], tmp_path)
    assert outcome.made


def test_workers_without_an_estimator_are_refused(two: Cluster, lines: list[str], tmp_path: Path):
    def local(scene, samples, seed):
        return np.zeros((*scene.resolution[::-1], 3))

    scene = small("two_cubes", 4)
    variant = register("ambient", "local", local, Limit("ambient"))
    key = cells.key(scene, variant, samples=1, seed=1, chain="path")
    with pytest.raises(ClusterError, match="no worker there"):
        done(two, [cells.Replicate(scene, "ambient", "local", (1,), 1, "path", key, 0)], tmp_path)
    assert "two_cubes: ambient local: " in lines[-1]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"workers": 0}, "workers = 0: allowed is at least 1"),
        ({"workers": 1, "scheduler": "tcp://a:1"}, "allowed is one of them"),
        ({"scheduler": "tcp://127.0.0.1:1"}, "scheduler = tcp://127.0.0.1:1: .*allowed is the address"),
        ({"scheduler": "nonsense"}, "scheduler = nonsense: .*allowed is the address"),
    ],
)
def test_what_cannot_be_connected(given: dict, words: str, monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT_SECONDS", 0.5)
    with pytest.raises(ValueError, match=words), connected(print, **given):
        pass


def test_engines_run_on_workers(two: Cluster, tmp_path: Path, monkeypatch):
    """The same images as by this process, and an engine's own words where it fails there."""
    told = (ROOT / "examples" / "tiny_renderer.toml").read_text("utf-8")
    (tmp_path / "fails.toml").write_text(told, "utf-8")
    (tmp_path / "tiny_renderer.py").write_text("raise SystemExit('no licence is left')", "utf-8")
    box = Asked.of("box", neutral.diffuse(small("cornell_box_unshadowed", 6, 4)), 2)
    stacks = []
    for name, executor in (("here", None), ("there", two)):
        monkeypatch.setenv("TERMWISE_CACHE", str(tmp_path / name))
        tiny = engine.load(ROOT / "examples" / "tiny_renderer.toml")
        stacks.append(rendered(tiny, box, spp=4, seed=1, count=3, executor=executor).stack)
    np.testing.assert_array_equal(*stacks)
    with pytest.raises(ValueError, match="no licence is left"):
        rendered(engine.load(tmp_path / "fails.toml"), box, spp=1, seed=1, count=1, executor=two)


def test_the_scheduler_s_end_is_one_line(tmp_path: Path):
    with connected(print, workers=1) as found:
        local: Any = found.client.cluster
        jobs = [Note(small("two_cubes", 4), number, 0.05) for number in range(200)]
        outcomes = found.run(jobs, tmp_path, never)
        next(outcomes)
        local.sync(local.scheduler.close)
        with pytest.raises(ClusterError, match="the scheduler is gone; the same command goes on"):
            list(outcomes)


def test_without_workers_dask_is_not_loaded():
    code = "import sys, termwise.reports.run, termwise.reports.cli.runs; print('distributed' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_ctrl_c_within_a_loop_that_is_traced_is_no_fault_of_the_job(tmp_path: Path):
    """Dr.Jit makes an error of its own of whatever is raised there."""

    class Traced:
        def take(self, seat: Any) -> Any:
            try:
                raise KeyboardInterrupt
            except KeyboardInterrupt as error:
                raise RuntimeError("while_loop(): encountered an exception") from error

    class Broken:
        def take(self, seat: Any) -> Any:
            raise RuntimeError("a scene's own")

    with Worker(tmp_path) as worker:
        with pytest.raises(KeyboardInterrupt):
            worker.take(cast(Any, Traced()))
        assert str(worker.take(cast(Any, Broken())).error) == "a scene's own"
