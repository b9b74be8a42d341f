"""What is said: every verdict as one sentence that names its tests, what they found and what is not excluded."""

from collections.abc import Sequence

import numpy as np

from termwise.reports.statistics.accumulation import Statistics
from termwise.reports.statistics.verdict import (
    KERNEL_SHAPE_MARGIN,
    OUTSIDE,
    PLACE_SIDE,
    POWER,
    SHAPE_MARGIN,
    WINDOW_SIDE,
    WORDS,
    Verdict,
)

BLOCKS = {1: "single pixels", 2: "2-px blocks", 8: "8-px tiles"}
"""What the shape is judged over."""
SAID = 3
"""So many reasons, and so many errors that are tolerated."""


def sentence(verdict: Verdict, statistics: Statistics, *, kernel: bool, tolerated: float, needed: float | None) -> str:
    """What was tested, what was found, and what is not excluded.

    Parameters
    ----------
    verdict : all of it but its sentence.
    statistics : of the same row.
    kernel : only its means were judged.
    tolerated : relative bias of a mean that is no error.
    needed : times the samples that make an unbiased row EQUIVALENT; None where no samples will do.
    """
    outside = OUTSIDE / verdict.looks
    bias = f"{percent(verdict.bias)} [{percent(verdict.bias_low)}, {percent(verdict.bias_high)}]"
    if verdict.verdict is None:
        predicted = "" if verdict.predicted_bias is None else f"; predicted {percent(verdict.predicted_bias)}"
        return f"Measured, not judged: luminance differs by {bias} ({confidence(outside)}){predicted}."
    if verdict.verdict == "ABSENT":
        why = f" ({verdict.reasons[0]})" if verdict.reasons else ""
        return f"ABSENT: both sides are exactly 0 everywhere{why}; nothing was tested."
    biased, equivalent = zip(*WORDS.values(), strict=True)
    tested, margin, reasons = _tested(verdict, statistics, kernel, tolerated), _margin(verdict), _first(verdict.reasons)
    parts = [
        f"{verdict.verdict}: relative bias of the mean luminance {bias} ({confidence(outside)}), "
        f"K = {statistics.replicates} replicates against {_reference(statistics)}"
    ]
    if verdict.verdict in biased:
        parts.append(f"an error is proven by {tested}, whatever {margin}: {reasons}")
    elif verdict.verdict in equivalent:
        shape = f"the shape error over 8-px tiles below {KERNEL_SHAPE_MARGIN if kernel else SHAPE_MARGIN:.0%} rms"
        parts.append(f"the intervals of red, green and blue ({confidence(outside)}) lie inside {margin}, and {shape}")
        parts.append(f"no error is proven by {tested}")
    else:
        parts.append(f"equivalence within {margin} is not shown: {reasons}")
        parts.append(_needed(verdict, needed))
        parts.append(f"no error is proven by {tested}")
    parts += [f"proven, but too small to be an error: {_first(verdict.tolerated)}"] if verdict.tolerated else []
    parts.append(
        f"smallest detectable bias of the image's mean {verdict.detectable_bias:.2%} (found in {POWER:.0%} of runs)"
    )
    if not kernel:
        parts[-1] += (
            f", of an outermost row or column {verdict.detectable_border:.2%}, of {WINDOW_SIDE} × {WINDOW_SIDE} px "
            f"{verdict.detectable_window:.2%}, of the shape over 8-px tiles {verdict.detectable_shape:.2%} rms"
        )
    if verdict.verdict in biased:
        parts.append("further errors are not excluded")
    else:
        shape = f"a shape error of up to {verdict.rms_bias_high:.2%} rms over 8-px tiles"
        places = f"one of fewer than {WINDOW_SIDE} × {WINDOW_SIDE} px that adds less to these"
        if kernel:
            places = "one of the shape or of a place, which is printed and not judged"
        parts.append(f"not excluded: a smaller one, {places}, and {shape}")
    return "; ".join(parts) + "."


def _tested(verdict: Verdict, statistics: Statistics, kernel: bool, tolerated: float) -> str:
    objects = len(statistics.region_names) - 1
    regions = "image" + (f" and {objects} object{'s' if objects > 1 else ''}" if objects else "")
    places = f"outermost rows and columns, {PLACE_SIDE}-px tiles, {WINDOW_SIDE}-px windows"
    more = "" if kernel else f", {len(BLOCKS)} of shape ({', '.join(BLOCKS.values())}), 3 of places ({places})"
    looks = "" if verdict.looks == 1 else f"/{verdict.looks} ({verdict.looks} looks)"
    return (
        f"{statistics.mean_tests} Welch tests of means ({regions}; red, green, blue; up to {tolerated:.2%} tolerated)"
        f"{more}, of n = {verdict.tests} in the run, each at {100 * verdict.level:g}%/{verdict.tests}{looks}"
    )


def _margin(verdict: Verdict) -> str:
    margin = f"the margin of ±{verdict.margin + verdict.allowance:.2%}"
    return margin + (f" (an allowance of {verdict.allowance:.2%} in it)" if verdict.allowance else "")


def _reference(statistics: Statistics) -> str:
    if statistics.exact:
        return "one image taken as exact"
    return f"R = {statistics.reference_replicates} of the reference"


def _first(said: Sequence[str]) -> str:
    more = len(said) - SAID
    return "; ".join(said[:SAID]) + (f"; and {more} more" if more > 0 else "")


def _needed(verdict: Verdict, needed: float | None) -> str:
    """What it takes to decide an UNDERPOWERED row."""
    if needed is None:
        return "a bias beyond the margin is likely, which more samples would prove rather than remove"
    if verdict.samples_to_margin is None:
        return f"an unbiased estimator would need {max(1.0, needed):.2g} times the samples on both sides"
    took = "" if verdict.seconds_to_margin is None else f", {verdict.seconds_to_margin:.3g} s"
    return f"an unbiased row would need {verdict.samples_to_margin} samples on both sides{took}"


def tile_words(tile: tuple[int, int, int, int]) -> str:
    """Where a tile of x, y, width and height is."""
    x, y, width, height = tile
    return f"tile x {x}-{x + width - 1}, y {y}-{y + height - 1}"


def confidence(outside: float) -> str:
    """Of the two-sided interval that leaves out `outside` at each end."""
    return f"{100 * (1 - 2 * outside):g} %"


def percent(value: np.ndarray | float) -> str:
    """A signed share, whatever its size."""
    return f"{value:+.2%}" if abs(value) < 10 else f"{100 * value:+.2e}%"
