"""What is said of a row, and by which numbers: the levels, limits and words of the rule, and the verdict itself."""

from typing import Any, Literal

import attrs

Kind = Literal["right", "wrong"]

LEVEL = 0.05
"""Chance of any false alarm in a run, shared equally by its tests, and by its looks where it takes several."""
OUTSIDE = 0.05
"""Chance that a bias of exactly the margin is called EQUIVALENT, shared by the looks: at one look, a 90 % interval."""
TOLERATED_BIAS = 0.001
"""f: a mean bias below this is never called a bias."""
MARGIN = 0.01
"""m: a mean bias inside this margin is equivalent to none."""
SHARES = (1 / 2, 1 / 6, 1 / 6, 1 / 6)
"""Of luminance, red, green and blue in the level of a test of the shape or of places."""
SHAPE_LIMITS = {1: 0.01, 2: 0.005, 8: 0.003}
"""Root mean square of the error over blocks of so many pixels' side, relative to the mean of the image."""
PLACE_LIMIT = 0.005
"""Of a tile, a window, an outermost row or column, relative to its own mean or the typical one."""
PLACE_SIDE = 16
WINDOW_SIDE = 8
"""The smallest places that are judged without being named: windows, one every half of this."""
SHAPE_MARGIN, KERNEL_SHAPE_MARGIN = 0.01, 0.03
"""Largest root mean square over 8-px tiles that EQUIVALENT may leave open; of a kernel, which blurs by design."""
DOMINATED = 0.1
"""Share of the image's mean below which half of the lit tiles lie where a few bright pixels are most of that mean."""
POWER = 0.8
"""A bias counts as detectable when it is found in this share of runs."""
WORDS = {"right": ("BIASED", "EQUIVALENT"), "wrong": ("NOT AS PREDICTED", "AS PREDICTED")}
NO_VERDICT = "NO VERDICT"
"""In the place of a verdict where the reference failed its own audit."""


@attrs.frozen
class RegionBias:
    """Relative bias of one channel over one region, 90 % interval and the one at the family's level."""

    region: str
    channel: str
    bias: float
    low: float
    high: float
    family_low: float | None
    family_high: float | None
    standard_error: float
    detectable_bias: float | None


@attrs.frozen
class Verdict:
    """What a run says about a row; biases are relative and signed, `None` where none is due.

    Attributes
    ----------
    verdict : ABSENT, BIASED, EQUIVALENT, UNDERPOWERED, NOT AS PREDICTED, AS PREDICTED; None if not judged. A run says
        NO VERDICT where the reference failed its audit, see `reports.study.audits`.
    sentence : what was tested, what was found and what is not excluded.
    reasons : why it is BIASED, the gravest first, or why not EQUIVALENT.
    bias, bias_low, bias_high, standard_error : float
        Of the image's luminance, 90 % interval; with several looks one that holds at 90 % over all of them.
    family_low, family_high : the same interval at 5 % over `tests` and `looks`.
    regions : each channel of the image and of each object: what the mean tests judge.
    rms_bias, rms_bias_high : `sign(θ) sqrt(|θ|)` of luminance over 8-px tiles; the largest U of luminance, red, green
        and blue, its upper bound at 95 %, over all looks.
    place : where the error is proven, else where it is the most likely.
    tile : x, y, width, height of the 16-px tile that is off most, by what noise leaves of it.
    detectable_bias : smallest bias of the image's noisiest channel found in 80 % of runs.
    detectable_shape, detectable_border, detectable_window : the same for a root mean square over 8-px tiles, in the
        noisiest of luminance, red, green and blue; for the luminance of the noisiest of the outermost rows and columns;
        for that of half of the windows of 8 px.
    tolerated : what is proven at the family's level, and too small to be an error.
    samples_ratio : float or None
        Times the samples of both sides that an unbiased row needs to be found EQUIVALENT in 80 % of runs; None where a
        bias beyond the margin is likely so that no samples will do.
    samples_to_margin, seconds_to_margin : float or None
        What both sides need, at these K and R, to be found EQUIVALENT in 80 % of runs if unbiased; None
        where not asked for, or where a bias beyond the margin is likely so that no samples will do.
    margin, allowance, level, tests, looks, predicted_bias
        As decided with.
    warnings : tuple of str
    """

    verdict: str | None
    sentence: str
    reasons: tuple[str, ...]
    bias: float
    bias_low: float
    bias_high: float
    standard_error: float
    family_low: float | None
    family_high: float | None
    regions: tuple[RegionBias, ...]
    rms_bias: float
    rms_bias_high: float
    place: str
    tile: tuple[int, int, int, int]
    detectable_bias: float | None
    detectable_shape: float | None
    detectable_border: float | None
    detectable_window: float | None
    tolerated: tuple[str, ...]
    samples_ratio: float | None
    samples_to_margin: int | None
    seconds_to_margin: float | None
    margin: float
    allowance: float
    level: float
    tests: int | None
    looks: int
    predicted_bias: float | None
    warnings: tuple[str, ...]

    def row(self) -> dict[str, Any]:
        """Plain values, ready for JSON."""
        return attrs.asdict(self)
