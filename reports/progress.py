"""Progress of long work on standard error: a bar a stage with the time that is left; lines where is no terminal."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

Report = Callable[[str, int, int], None]
"""(what, done, of all), called as work goes on."""
Stages = Callable[[str], Report]
"""Begins a stage of that name."""

LINE_EVERY = 10.0
"""Seconds between plain lines: a log shows that the work lives, and what is over sooner says nothing."""


def silent(what: str, done: int, total: int) -> None:
    """Report nothing."""


@contextlib.contextmanager
def stages(console: Console, *, quiet: bool = False, where: Path | str = "") -> Iterator[Stages]:
    """Show the progress of what is done in the context, or nothing at all if `quiet`.

    The bars vanish with the context, so that results stand alone. Where is no terminal, the first line says `where`
    the results go: a log is read before they are there.
    """
    if quiet:
        yield lambda name: silent
    elif not console.is_terminal:
        lines = _Lines(console, str(where))
        beat = threading.Thread(target=lines.beat, name="termwise progress", daemon=True)
        beat.start()
        try:
            yield lines.stage
        finally:
            lines.end()
            beat.join()  # no line comes after the results
    else:
        columns = (
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TimeRemainingColumn(elapsed_when_finished=True),
            TextColumn("{task.fields[what]}"),
        )
        with Progress(*columns, console=console, transient=True) as bars:
            yield lambda name: _bar(bars, name)


def _bar(bars: Progress, name: str) -> Report:
    task = bars.add_task(name, total=None, what="")

    def report(what: str, done: int, total: int) -> None:
        bars.update(task, what="" if done == total else what, completed=done, total=total)

    return report


class _Lines:
    """Plain lines of the stage that runs: one every LINE_EVERY seconds, however seldom it reports."""

    def __init__(self, console: Console, where: str) -> None:
        self._console, self._where = console, where
        self._lock, self._over = threading.Lock(), threading.Event()
        self._name, self._state = "", ("", 0, 0)
        self._began = self._last = self._reported = time.monotonic()

    def stage(self, name: str) -> Report:
        with self._lock:
            self._name, self._state = name, ("", 0, 0)
            self._began = self._last = self._reported = time.monotonic()
        return self._report

    def beat(self) -> None:
        while not self._over.wait(LINE_EVERY):
            with self._lock:
                self._tell(time.monotonic())

    def end(self) -> None:
        self._over.set()

    def _report(self, what: str, done: int, total: int) -> None:
        with self._lock:
            self._state, self._reported = (what, done, total), time.monotonic()
            self._tell(self._reported)

    def _tell(self, now: float) -> None:
        if now - self._last < LINE_EVERY or not self._name:
            return
        self._last = now
        what, done, total = self._state
        so_far = now - self._began
        # What is under way has taken its share of the time that its kind took so far.
        left = (self._reported - self._began) / done * (total - done) - (now - self._reported) if done else 0.0
        time_said = (
            f", about {left:.0f} s left" if left > 0 else "" if done == total > 0 else f", {so_far:.0f} s so far"
        )
        where, self._where = f"; results go to {self._where}" if self._where else "", ""
        counted = f": {done} of {total}" if total else ""
        text = f"{self._name}{counted}{time_said}{': ' if what else ''}{what}{where}"
        self._console.print(text, highlight=False, markup=False, soft_wrap=True)
