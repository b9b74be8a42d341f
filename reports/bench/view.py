"""How long a page takes from a change of an input to the picture of it, and whether its memory stays.

What is timed begins where an input's value arrives and ends with the PNG of the sum, without the browser's share. A
change of one input is made as soon as the picture of the last is whole, as a slider does; kernels are compiled before.
"""

import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import attrs

from termwise.reports.bench import common
from termwise.reports.live.live import Frame, Live
from termwise.reports.live.page import png
from termwise.reports.live.state import State, Steps, get, put
from termwise.reports.pages.pictures import display
from termwise.scenes.load import load

SCENES = ("two_cubes", "cornell_box", "cornell_box_unshadowed", "monkey")
SIDE = 32
"""Pixels of a side where memory is measured: what a change might leave behind is hardly less in a small picture."""


def measure(
    *,
    scenes: tuple[str, ...] = (),
    changes: int = 30,
    memory_changes: int = 1000,
    resolution: int = 256,
    threads: int | None = None,
    report: Callable[[str, int, int], None],
) -> dict[str, Any]:
    """Seconds of `changes` changes of each input of each scene; memory over `memory_changes` changes.

    Returns
    -------
    cases: scene, input, median, least and greatest seconds, the median of the processor's seconds of all threads, which
    other work on the machine hardly changes, and how many of the pictures were previews. memory: see `held`. machine:
    `load_end` is the load when all was done.
    """
    common.known("scene", scenes, SCENES)
    common.positive(changes=changes, memory_changes=memory_changes, resolution=resolution)
    chosen = scenes or SCENES
    machine = common.machine(threads or os.cpu_count() or 1)
    # First, while nothing else has been held.
    memory = held(chosen[0], changes=memory_changes, threads=threads, report=report)
    cases: list[dict[str, Any]] = []
    for number, name in enumerate(chosen):
        state = State(attrs.evolve(load(name), resolution=(resolution, resolution)), samples=2**20)
        frames = _Frames()
        live = Live(frames, threads=threads)
        try:
            live.show(state)
            frames.first(1)
            shown = 1
            for what, path, step in _inputs(state):
                report(f"{name}: {what}", number, len(chosen))
                seconds, processor, previews = [], [], 0
                for change in range(changes):
                    begin, spent = time.perf_counter(), time.process_time()
                    moved = put(state, path, get(state, path) + step * (1 + change))
                    live.show(moved)
                    shown += 1
                    frame, at, spent_then = frames.first(shown)
                    seconds.append(at - begin)
                    processor.append(spent_then - spent)
                    previews += any(view.status == "preview" for view in frame.terms.values())
                middle, least, most = common.spread(seconds)
                cases.append(
                    {
                        "scene": name,
                        "input": what,
                        "seconds": middle,
                        "seconds_low": least,
                        "seconds_high": most,
                        "processor": common.spread(processor)[0],
                        "previews": previews,
                        "changes": changes,
                    }
                )
        finally:
            live.close()
            live.join()
    return {
        "cases": cases,
        "memory": memory,
        "settings": {"resolution": resolution, "changes": changes},
        "machine": machine | {"load_end": os.getloadavg()[0]},
    }


def held(name: str, *, changes: int, threads: int | None, report: Callable[[str, int, int], None]) -> dict[str, Any]:
    """Memory that the process holds after a tenth of the changes and after all of them.

    Inputs take turns, each new value one that was never shown, and the picture of each is waited for.

    Returns
    -------
    scene, resolution; changes and megabytes: two of each.
    """
    state = State(attrs.evolve(load(name), resolution=(SIDE, SIDE)), samples=1)
    moved = _inputs(state)
    points = max(1, changes // 10), changes
    found: list[float] = []
    frames = _Frames()
    live = Live(frames, threads=threads)
    try:
        for change in range(1, changes + 1):
            report(f"{name}: memory", change - 1, changes)
            _, path, step = moved[change % len(moved)]
            # Back and forth: no input comes to the end of its range.
            turns = change // len(moved)
            state = put(state, path, get(state, path) + (-0.9 * step if turns % 2 else step))
            live.show(state)
            frames.first(change)
            found += [_resident_mb() for point in points if point == change]
    finally:
        live.close()
        live.join()
    return {"scene": name, "resolution": SIDE, "changes": list(points), "megabytes": found}


def _inputs(state: State) -> list[tuple[str, Steps, float]]:
    """One input that touches all terms, one that touches one, and one that lights touch."""
    glossy = next(i for i, thing in enumerate(state.scene.objects) if thing.material.gloss)
    found: list[tuple[str, Steps, float]] = [
        ("camera", ("scene", "camera", "position", 0), 0.002),
        ("roughness", ("scene", "objects", glossy, "material", "roughness"), 0.001),
        ("gloss", ("scene", "objects", glossy, "material", "gloss"), -0.001),
    ]
    if state.scene.lights:
        found.append(("light", ("scene", "lights", 0, state.scene.lights[0].sends, 0), 0.002))
    lamps = [i for i, thing in enumerate(state.scene.objects) if thing.emits]
    if lamps:
        found.append(("light", ("scene", "objects", lamps[0], "emission", 0), 0.01))
    return found


class _Frames:
    """The first picture of each state, encoded, and when it was."""

    def __init__(self) -> None:
        self._new = threading.Condition()
        self._last: tuple[Frame, float, float] | None = None

    def __call__(self, frame: Frame) -> None:
        if self._last is not None and self._last[0].number == frame.number:
            return
        image = frame.total
        if image is not None:
            png(display(image, exposure=frame.state.scene.exposure))
        elif not frame.error:
            return
        with self._new:
            self._last = frame, time.perf_counter(), time.process_time()
            self._new.notify()

    def first(self, number: int) -> tuple[Frame, float, float]:
        """Wait for state `number`: its picture, when it was, and the processor's seconds until then.

        Raises
        ------
        ValueError : rendering ended with an error.
        """
        with self._new:
            self._new.wait_for(lambda: self._last is not None and self._last[0].number == number)
            assert self._last is not None
            found = self._last
        if found[0].error:
            raise ValueError(f"{found[0].state.scene.name}: {found[0].error}")
        return found


def _resident_mb() -> float:
    """Memory that the process holds now; NaN where the system does not tell."""
    path = Path("/proc/self/statm")
    return int(path.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6 if path.exists() else float("nan")
