"""Seconds to equal error: `t(e)` of a measured curve, log-log between points; speed-up = `t_Mitsuba(e) / t_ours(e)`.

A curve is that of one setting: RMSE, pooled over runs, and seconds for more and more samples.
"""

import math
from collections.abc import Sequence

import numpy as np

# Where the targets lie between the least error (0) and the greatest (1) that both sides reach, as logarithms.
_PLACES = (0.85, 0.5, 0.15)


def seconds_to(target: float, rmse: Sequence[float], seconds: Sequence[float]) -> float:
    """Least time at which a curve has the error `target`, or less at its first point; infinite where it never has.

    Parameters
    ----------
    target : RMSE, in radiance.
    rmse, seconds : (P,) the curve by increasing samples. Between two points log seconds is linear in log RMSE, as it
        is for every power law.
    """
    if rmse[0] <= target:
        return float(seconds[0])
    for place in range(1, len(rmse)):
        before, after = rmse[place - 1], rmse[place]
        if after <= target < before:
            share = math.log(before / target) / math.log(before / after)
            return math.exp((1.0 - share) * math.log(seconds[place - 1]) + share * math.log(seconds[place]))
    return math.inf


def leaders(curves: Sequence[tuple[Sequence[float], Sequence[float]]], reach: float) -> list[int]:
    """Which curves (RMSE, seconds) take at most `reach` times as long as the fastest where they end.

    Beyond its end such a one would go on ahead, and a slower curve, which goes further, would pass for the best.
    """
    found = []
    for place, (rmse, seconds) in enumerate(curves):
        end = min(rmse)
        if seconds_to(end, rmse, seconds) <= reach * min(seconds_to(end, *curve) for curve in curves):
            found.append(place)
    return found


def targets(ours: Sequence[float], theirs: Sequence[Sequence[float]]) -> tuple[float, ...]:
    """Three errors, falling, that our curve and all of theirs reach; none where they do not meet.

    Parameters
    ----------
    ours : (P,) RMSE of our curve.
    theirs : of each setting of Mitsuba's that leads where its curve ends, (P,) RMSE of it.
    """
    high = min(max(ours), max(max(curve) for curve in theirs))
    low = max(min(ours), max(min(curve) for curve in theirs))
    if not 0.0 < low < high:
        return ()
    return tuple(low ** (1.0 - place) * high**place for place in _PLACES)


def pooled(square: np.ndarray, noise: float) -> np.ndarray:
    """RMSE from the mean squares (K, P) of K runs, the reference's own mean square `noise` taken away; (P,)."""
    return np.sqrt(np.maximum(square.mean(axis=0) - noise, 0.0))
