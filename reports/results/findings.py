"""What a reader looks for first in the rows of a run: what was certified, and how far wrong formulas are from right."""

from typing import Any

CERTIFIED = "EQUIVALENT", "AS PREDICTED"
"""Verdicts that show a bias to lie within a row's margin and allowance."""

Rows = list[dict[str, Any]]


def certified(rows: Rows) -> dict[float, int]:
    """Of how many rows the bias is shown to lie within ±m, by m, the smallest first; m to a hundredth of a percent."""
    within = [round(row["margin"] + row["allowance"], 4) for row in rows if row["verdict"] in CERTIFIED]
    return {margin: within.count(margin) for margin in sorted(set(within))}


def from_right(rows: Rows) -> dict[tuple[str, str, str], dict[str, Any]]:
    """The row against the right integral of each wrong variant that is judged, by scene, term and variant.

    Its bias is what the formula is off by, its own limit having been met or not. Of rows of one variant that with the
    most samples counts; cases whose answer is known stand apart.
    """
    wrong = {key(row) for row in rows if row["kind"] == "wrong" and row["verdict"] and row["against"] == "own"}
    found: dict[tuple[str, str, str], dict[str, Any]] = {}
    for row in rows:
        which = key(row)
        if row["against"] != "correct" or which not in wrong or row.get("group") or row["bias"] is None:
            continue
        if which not in found or (row["samples"] or 0) > (found[which]["samples"] or 0):
            found[which] = row
    return found


def key(row: dict[str, Any]) -> tuple[str, str, str]:
    """Scene, term and variant."""
    return row["scene"], row["term"], row["variant"]
