"""The numerical stress lab: exact and analytic properties under hostile input, ours beside the paper's and Mitsuba's.

Each module is a group; its `rows(count)` gives `Row`s, whose figures are measured when they are asked for.
`reports.pages.stress` makes a page of what `measure` returns.
"""

import time
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any

from termwise.reference import backend
from termwise.reports.bench.common import known, machine, positive
from termwise.reports.stress import (
    garbage,
    images,
    intersection,
    lights,
    photons,
    radiance,
    rounding,
    shading,
    translucency,
    transmission,
)
from termwise.reports.stress.row import SIDES, Row
from termwise.reports.stress.row import measure as measure_row

GROUPS: dict[str, ModuleType] = {
    "intersection": intersection,
    "shading": shading,
    "radiance": radiance,
    "photons": photons,
    "lights": lights,
    "images": images,
    "translucency": translucency,
    "transmission": transmission,
    "rounding": rounding,
    "garbage": garbage,
}
COUNT = 4096


def rows(groups: tuple[str, ...] = (), count: int = COUNT) -> Iterator[tuple[str, Row]]:
    """Rows of some groups, of all if none is named, each with its group."""
    known("group", groups, GROUPS)
    for name in groups or GROUPS:
        for row in GROUPS[name].rows(count):
            yield name, row


def measure(
    *,
    groups: tuple[str, ...] = (),
    case: str = "",
    count: int = COUNT,
    sides: tuple[str, ...] = SIDES,
    report: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> dict[str, Any]:
    """Measure all rows; JSON values.

    Parameters
    ----------
    groups : names of groups; all if none.
    case : only the row of this name, or those whose names have it in them.
    count : rays or samples of a row, about.
    sides : which columns are measured.
    report : called with (what runs, done, total).

    Raises
    ------
    ValueError : an unknown group, no row of that name, a count below 1.
    """
    positive(count=count)
    chosen = [(group, row) for group, row in rows(groups, count) if case in row.name]
    chosen = [(group, row) for group, row in chosen if case == row.name] or chosen
    if not chosen:
        raise ValueError(f"case = {case!r}: allowed is a part of a row's name")
    about = machine(1)
    begin = time.perf_counter()
    cases = []
    for place, (group, row) in enumerate(chosen):
        report(f"{group}: {row.name}", place, len(chosen))
        start = time.perf_counter()
        cases.append(measure_row(group, row, sides))
        cases[-1]["seconds"] = time.perf_counter() - start
    return {
        "cases": cases,
        "failed": sum(not each["passed"] for each in cases),
        "properties": {name: _property(GROUPS[name]) for name in groups or GROUPS},
        "seconds": time.perf_counter() - begin,
        "settings": {
            "count": count,
            "groups": list(groups or GROUPS),
            "sides": list(sides),
            "backend": backend.choose().variant,
        },
        "machine": about,
    }


def _property(group: ModuleType) -> list[str]:
    """Paragraphs of the module's opening: the property that its rows assert, and what is to be expected."""
    return [" ".join(paragraph.split()) for paragraph in (group.__doc__ or "").strip().split("\n\n")]
