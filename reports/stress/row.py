"""A row of the lab: one property as a number that must not exceed a limit, `figure <= limit`, on each side.

A figure counts violations or measures an error; it is computed in the run, from an oracle that shares no code with
what is judged. Ours alone decides whether a row passes: the columns of the paper and of Mitsuba show what the same
property is with them.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

Figure = Callable[[], float]
SIDES = ("ours", "paper", "mitsuba")


class Row(NamedTuple):
    """A property before it is measured.

    Attributes
    ----------
    name : unique within its group.
    figure : what the number is, with its unit.
    limit : the greatest figure that passes.
    ours : measures it on our default code.
    paper, mitsuba : the same on the paper's own code and on Mitsuba; None where it has nothing of the kind.
    timed : whether the figure is a ratio of times, which other work on the machine can spoil.
    picture : a map (H, W) of ours for the page, of numbers above 0, NaN where there is none; None: no picture.
    """

    name: str
    figure: str
    limit: float
    ours: Figure
    paper: Figure | None = None
    mitsuba: Figure | None = None
    timed: bool = False
    picture: Callable[[], np.ndarray] | None = None


def measure(group: str, row: Row, sides: tuple[str, ...] = SIDES) -> dict[str, Any]:
    """Measure a row: a case of `termwise stress --json`.

    A side that raises has no figure, and its fault stands under `faults`; such a fault of ours fails the row, as does a
    figure that is no number. Infinite figures are None too: JSON has none. Of a picture the case has the lines.
    """
    case: dict[str, Any] = {"name": row.name, "group": group, "figure": row.figure, "limit": row.limit}
    faults: dict[str, str] = {}
    for side in SIDES:
        measured = getattr(row, side)
        case[side] = None
        if measured is None or side not in sides:
            continue
        try:
            value = float(measured())
        except Exception as error:  # a crash is a finding, and the other rows are still to be measured
            faults[side] = " ".join(f"{type(error).__name__}: {error}".split())[:300]
            continue
        if math.isfinite(value):
            case[side] = value
        else:
            faults[side] = f"the figure is {value}"
    case["passed"] = case["ours"] is not None and case["ours"] <= row.limit
    if row.picture is not None and case["ours"] is not None:
        drawn = np.asarray(row.picture(), np.float64)
        # Three digits are more than a colour shows.
        case["picture"] = [[float(f"{x:.3g}") if math.isfinite(x) else None for x in line] for line in drawn]
    case["faults"] = faults
    return case
