"""The stress lab as a page: `stress.json` -> `index.html` beside it, the figures of ours, the paper and Mitsuba."""

import json
import shlex
import shutil
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from plotly.colors import sequential

from termwise.reports.pages import pictures
from termwise.reports.pages.environment import copy_static, grouped, page_environment, render_page

NAMES = {"ours": "ours", "paper": "the paper’s code", "mitsuba": "Mitsuba"}


def write(folder: Path) -> Path:
    """Write the page of the lab's numbers in a folder; returns the `index.html`.

    Raises
    ------
    ValueError : `stress.json` is not there, is no JSON, or is of another version.
    """
    path, index = folder / "stress.json", folder / "index.html"
    try:
        measured = json.loads(path.read_text("utf-8"))
    except OSError:
        raise ValueError(f"{path}: no such file: allowed is what `termwise stress` writes") from None
    except ValueError as error:
        raise ValueError(f"{path}: {error}: allowed is what `termwise stress` writes") from None
    try:
        render_page(
            page_environment(),
            "stress.html.j2",
            index,
            root="",
            run=measured,
            names=NAMES,
            groups=grouped(measured["cases"], lambda case: case["group"]),
            tallies={side: _tally(measured["cases"], side) for side in NAMES},
            passes=passes,
            drawn=_drawn(measured["cases"], folder / "pictures"),
            repeat=_repeat,
        )
    except (KeyError, jinja2.UndefinedError) as error:
        raise ValueError(
            f"{path}: of another version ({error}): allowed is what this one writes; run it again"
        ) from None
    copy_static(folder)
    return index


def passes(case: dict[str, Any], side: str) -> bool | None:
    """Whether a side keeps the row's limit; None where it is not measured."""
    if case[side] is None:
        return False if side in case["faults"] else None
    return case[side] <= case["limit"]


def _drawn(cases: list[dict[str, Any]], folder: Path) -> dict[str, Any]:
    """Pictures of the rows that have one, by one scale: the row, the file, the least, median and greatest number."""
    shutil.rmtree(folder, ignore_errors=True)
    maps = {case["name"]: np.array(case["picture"], np.float64) for case in cases if "picture" in case}
    if not maps:
        return {}
    low, high = (float(of([of(each) for each in maps.values()])) for of in (np.nanmin, np.nanmax))
    rows = []
    for name, values in maps.items():
        path = folder / f"{name.replace(',', '').replace(' ', '-')}.png"
        pictures.save(path, pictures.rise(values, low=low, high=high))
        three = (float(of(values)) for of in (np.nanmin, np.nanmedian, np.nanmax))
        rows.append((name.removesuffix(", median"), f"pictures/{path.name}", *three))
    return {"rows": rows, "low": low, "high": high, "colours": sequential.Viridis}


def _tally(cases: list[dict[str, Any]], side: str) -> tuple[int, int]:
    """Rows that a side fails, of how many."""
    found = [passes(case, side) for case in cases]
    return found.count(False), len(found) - found.count(None)


def _repeat(case: dict[str, Any]) -> str | None:
    """The command that repeats a row, where a cell of it fails."""
    if all(passes(case, side) is not False for side in NAMES):
        return None
    return f"termwise stress --group {case['group']} --case {shlex.quote(case['name'])}"
