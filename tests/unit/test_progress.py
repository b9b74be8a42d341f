"""Progress: bars on a terminal, a line now and then elsewhere, nothing where it is not wanted."""

import io
import re
import time

from rich.console import Console

from termwise.reports import progress


def shown(monkeypatch, *, terminal, quiet=False):
    """What is written while a stage of 60 steps passes, one second each."""
    now = iter(float(second) for second in range(1000))
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(now))
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=terminal, width=100)
    with progress.stages(console, quiet=quiet) as stage:
        report = stage("Measuring")
        for done in range(1, 61):
            report(f"monkey: cell {done}", done, 60)
    return stream.getvalue()


def test_lines_where_there_is_no_terminal(monkeypatch):
    lines = shown(monkeypatch, terminal=False).splitlines()
    assert lines == [
        f"Measuring: {done} of 60, about {60 - done} s left: monkey: cell {done}" for done in range(10, 60, 10)
    ] + ["Measuring: 60 of 60: monkey: cell 60"]


def test_a_step_that_reports_nothing_is_said_to_live(monkeypatch):
    """A line without being asked for one; the first says where the results go."""
    monkeypatch.setattr(progress, "LINE_EVERY", 0.05)
    stream = io.StringIO()
    with progress.stages(Console(file=stream, width=40), where="out/stress") as stage:
        stage("Stress")("shading: a row of many minutes", 3, 9)
        limit = time.monotonic() + 30.0
        while stream.getvalue().count("\n") < 2 and time.monotonic() < limit:
            time.sleep(0.01)
    first, second, *_ = stream.getvalue().splitlines()
    assert re.fullmatch(r"Stress: 3 of 9, \d s so far: shading: a row of many minutes; results go to out/stress", first)
    assert re.fullmatch(r"Stress: 3 of 9, \d s so far: shading: a row of many minutes", second)
    lines = stream.getvalue().count("\n")
    time.sleep(0.2)
    assert stream.getvalue().count("\n") == lines


def test_a_bar_on_a_terminal(monkeypatch):
    text = shown(monkeypatch, terminal=True)
    assert "Measuring" in text
    assert "━" in text
    assert "60/60" in text


def test_quiet(monkeypatch):
    assert shown(monkeypatch, terminal=True, quiet=True) == ""
    assert shown(monkeypatch, terminal=False, quiet=True) == ""
