"""Progress of long work on standard error: a bar a stage with the time that is left; lines where is no terminal."""

import contextlib
import time
from collections.abc import Callable, Iterator

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
def stages(console: Console, *, quiet: bool = False) -> Iterator[Stages]:
    """Show the progress of what is done in the context, or nothing at all if `quiet`.

    The bars vanish with the context, so that results stand alone.
    """
    if quiet:
        yield lambda name: silent
    elif not console.is_terminal:
        yield lambda name: _lines(console, name)
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


def _lines(console: Console, name: str) -> Report:
    began = last = time.monotonic()

    def report(what: str, done: int, total: int) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last < LINE_EVERY:
            return
        last = now
        left = f", about {(now - began) / done * (total - done):.0f} s left" if 0 < done < total else ""
        console.print(f"{name}: {done} of {total}{left}: {what}", highlight=False, markup=False)

    return report
