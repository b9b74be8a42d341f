"""What one more of each costs: seconds a ray against triangles, a sample against pixels, samples and threads, a photon.

Every load is a process of its own (`worker`), so that its peak memory is its own. The processes of an axis are started
first and then run in turn, round after round, because other work on the machine then slows all alike.

Threads: `rate(n threads) / Σ rate(n processes)`, the processes at the same time and one thread each: all that the
machine gives n independent workers is what n threads are measured against, not n times one thread alone.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

import attrs

from termwise.renderer.plan import camera_rays
from termwise.renderer.terms.ambient import SPLIT
from termwise.reports.bench.common import known, machine, positive, spread
from termwise.reports.bench.worker import Load
from termwise.scenes.store import ROOT

RUNS = 5
_AMBIENT = Load("cornell_box", "ambient")


@attrs.frozen
class Axis:
    """Loads that differ in one number.

    Attributes
    ----------
    loads : by the value on the axis.
    unit : of what the seconds are divided by, and how many of it a load has.
    """

    loads: dict[int, Load]
    unit: str
    count: Callable[[Load], int]


def _samples(load: Load) -> int:
    return load.resolution**2 * load.samples


def _rays(load: Load) -> int:
    """Occlusion rays, one a sample, and the camera's."""
    return _samples(load) + load.resolution**2 * camera_rays(load.samples, SPLIT)


AXES = {
    # 1280 to 1.3 million triangles.
    "triangles": Axis(
        {20 * 4**n: Load("ball", "ambient", subdivisions=n, samples=8) for n in (3, 4, 5, 6, 7, 8)}, "ray", _rays
    ),
    "pixels": Axis(
        {n**2: attrs.evolve(_AMBIENT, resolution=n, samples=4) for n in (32, 64, 128, 256, 512)}, "sample", _samples
    ),
    "samples": Axis({64: attrs.evolve(_AMBIENT, samples=64, sweep=True)}, "sample", _samples),
    # A picture so small that tracing, storing and sorting photons is nearly all.
    "photons": Axis(
        {
            n: Load("cornell_box_unshadowed", "direct", resolution=8, samples=1, photons=n)
            for n in (10_000, 100_000, 1_000_000)
        },
        "photon",
        lambda load: load.photons or 0,
    ),
    # Of a second: until a scheduler moves one of two new threads away from the other, 30 ms may pass (measured).
    "threads": Axis({1: attrs.evolve(_AMBIENT, samples=1024)}, "sample", _samples),
}


class Worker:
    """A process that runs a load when told to."""

    def __init__(self, load: Load) -> None:
        """Start it and wait until it has compiled and run once."""
        self.load = load
        command = [sys.executable, "-m", "termwise.reports.bench.worker", json.dumps(attrs.asdict(load))]
        self._process = subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.facts: dict[str, Any] = self._answer()

    def start(self) -> None:
        """Begin one run."""
        assert self._process.stdin
        self._process.stdin.write("\n")
        self._process.stdin.flush()

    def seconds(self) -> list[tuple[int, float]]:
        """Seconds of the run begun last, by samples."""
        return [(count, spent) for count, spent in self._answer()]

    def run(self) -> list[tuple[int, float]]:
        """Begin one run and wait for it."""
        self.start()
        return self.seconds()

    def end(self) -> None:
        """Let the process end and take its peak memory."""
        assert self._process.stdin
        self._process.stdin.close()
        self.facts |= self._answer()
        self._process.wait()

    def kill(self) -> None:
        """End the process, if it has not."""
        self._process.kill()
        self._process.wait()

    def _answer(self) -> Any:
        assert self._process.stdout
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"a process of the benchmark ended early: {self.load}")
        return json.loads(line)


def measure(
    *,
    axes: tuple[str, ...] = (),
    runs: int = RUNS,
    threads: int | None = None,
    report: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> dict[str, Any]:
    """Measure all axes; JSON values.

    Parameters
    ----------
    axes : of `AXES`; all if none.
    runs : rounds; their median counts.
    threads : the most threads, and processes; None: one a core.
    report : called with (what runs, done, total).

    Raises
    ------
    ValueError : a name or a number that is not allowed.
    """
    known("axis", axes, AXES)
    positive(runs=runs, threads=1 if threads is None else threads)
    threads = threads or os.cpu_count() or 1
    names = axes or tuple(AXES)
    result: dict[str, Any] = {"cases": [], "machine": machine(threads), "settings": {"runs": runs}}
    for place, name in enumerate(names):
        report(name, place, len(names))
        measured = _threads if name == "threads" else _along
        result["cases"] += measured(name, AXES[name], runs, threads)
    result["machine"]["load_end"] = os.getloadavg()[0]
    return result


def _along(name: str, axis: Axis, runs: int, threads: int) -> list[dict[str, Any]]:
    """Rows of an axis, each load a process with all threads."""
    with _Workers() as workers:
        for load in axis.loads.values():
            workers.add(attrs.evolve(load, threads=threads))
        rounds = [[worker.run() for worker in workers] for _ in range(runs)]
    rows = []
    for place, (value, worker) in enumerate(zip(axis.loads, workers, strict=True)):
        found = [each[place] for each in rounds]
        for step in range(len(found[0])):
            count = found[0][step][0]
            load = attrs.evolve(worker.load, samples=count)
            seconds = [each[step][1] for each in found]
            rows.append(_row(name, count if load.sweep else value, axis, load, seconds, worker))
    return rows


def _threads(name: str, axis: Axis, runs: int, threads: int) -> list[dict[str, Any]]:
    """One thread, several threads, and as many processes of one thread at once."""
    (load,) = axis.loads.values()
    with _Workers() as workers:
        one = workers.add(load)
        several = workers.add(attrs.evolve(load, threads=threads))
        apart = [workers.add(load) for _ in range(threads)]
        alone, together, each = [], [], []
        for _ in range(runs):
            alone.append(one.run()[-1][1])
            together.append(several.run()[-1][1])
            for worker in apart:
                worker.start()
            each.append([worker.seconds()[-1][1] for worker in apart])
    # Seconds in which the processes do together what one of them does alone in the others' company.
    side_by_side = [1.0 / sum(1.0 / spent for spent in found) for found in each]
    share = spread(rate / spent for rate, spent in zip(side_by_side, together, strict=True))
    rows = [
        _row(name, 1, axis, load, alone, one) | {"processes": 1},
        _row(name, threads, axis, load, together, several) | {"processes": 1},
        _row(name, threads, axis, load, side_by_side, apart[0]) | {"processes": threads},
    ]
    rows[1] |= {"of_processes": share[0], "of_processes_low": share[1], "of_processes_high": share[2]}
    return rows


def _row(name: str, value: int, axis: Axis, load: Load, seconds: list[float], worker: Worker) -> dict[str, Any]:
    middle, low, high = spread(seconds)
    row = {"axis": name, "value": value, "seconds": middle, "seconds_low": low, "seconds_high": high}
    row |= {"unit": axis.unit, "per_unit_ns": 1e9 * middle / axis.count(load)}
    return row | worker.facts | {"load": attrs.asdict(load)}


class _Workers:
    """Processes that end with the block, and are ended where it fails."""

    def __init__(self) -> None:
        self._all: list[Worker] = []

    def add(self, load: Load) -> Worker:
        self._all.append(Worker(load))
        return self._all[-1]

    def __iter__(self) -> Iterator[Worker]:
        return iter(self._all)

    def __enter__(self) -> "_Workers":
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        for worker in self._all:
            if kind is None:
                worker.end()
            else:
                worker.kill()
