"""Do two means differ? Welch's t on the replicate means of places, and what rare events may hide.

The relative bias of a place's mean is judged on the means of its replicates,

    δ = (Ī - R̄)/scale,     SE² = (s_I²/K + s_R²/R)/scale² + floor²,     t = δ/SE,

with the degrees of freedom of Welch and Satterthwaite.

A sparse estimator may miss its brightest samples in all replicates, agree with itself, and lack their light. If a
place lacks D (radiance summed over its pixels, mean of K replicates), one replicate elsewhere holds an event of E, and
the place's own standard error is that of `m = (K SE / E)²` of them, then `λ = K D / E` are missing. By Poisson's law so
few are met with probability `Q(m + 1, m + λ)`, `e^-λ` for m = 0: a mean is proven off only if that, too, is below the
level of its test. Shape needs no such rule: where events are met, its jackknife has them.
"""

import attrs
import numpy as np
import scipy

from termwise.reports.statistics import student
from termwise.reports.statistics.verdict import POWER

TERM_FLOOR, ULP_FLOOR = 1e-6, 4.0
"""Floors of every standard error: a share of the term's mean, and float32 ulp of the reference value."""
RARE_EVENT = 1e-7
"""A replicate that stands above the lower three quarters of its place as far as normal noise would with this chance
holds a rare event."""
_OF_THE_LARGEST = 2.2
"""Of n normal numbers, the largest one's distance from the mean of the lower three quarters, in their standard
deviation, is about so many times Student's t of one degree of freedom fewer than these are: 2.05 to 2.21 times at
chances of 10^-3 and 10^-4, n = 8 to 32, simulated."""


@attrs.frozen(eq=False)
class Comparison:
    """Welch's comparison of the replicate means of some places; all arrays have one shape.

    Attributes
    ----------
    ours, reference : float64, means over the place, in radiance.
    bias, standard_error : float64, δ and its floored error, relative to `scale`.
    scale : float64, in radiance.
    dof : float64, Welch-Satterthwaite; K + R - 2 where both variances are 0.
    noiseless : both variances are 0: left out of p-histograms.
    unseen : float64, size of δ that one rare event makes if the side that is darker here has missed it, the event being
        as large as the largest that this side shows anywhere; 0 where it shows none.
    seen : float64, how many such events this side has met here, by its standard error.
    """

    ours: np.ndarray
    reference: np.ndarray
    bias: np.ndarray
    standard_error: np.ndarray
    scale: np.ndarray
    dof: np.ndarray
    noiseless: np.ndarray
    unseen: np.ndarray
    seen: np.ndarray

    def interval(self, level: float) -> tuple[np.ndarray, np.ndarray]:
        """Two-sided interval of δ that misses the truth in `level` of the runs."""
        half = student.isf(level / 2, self.dof) * self.standard_error
        return self.bias - half, self.bias + half

    def p_values(self) -> np.ndarray:
        """Two-sided p of "no bias at all"; uniform under the null but for noiseless places, which the floor judges.

        NaN where all replicates of both sides are the same number: there is nothing to test.
        """
        p = 2 * student.sf(np.abs(self.bias) / self.standard_error, self.dof)
        return np.where(self.noiseless & (self.bias == 0), np.nan, p)

    def detectable(self, level: float, limit: float) -> np.ndarray:
        """Smallest bias that this very measurement finds outside ±limit in 80 % of the runs."""
        outside = limit + student.isf(level / 2, self.dof) * self.standard_error
        return np.maximum(outside, self.missing(level)) + student.isf(1 - POWER, self.dof) * self.standard_error

    def missing(self, level: float) -> np.ndarray:
        """Size of δ up to which rare events that were not met explain it: the chance of so few is above `level`."""
        return self.unseen * (scipy.special.gammainccinv(self.seen + 1, level) - self.seen)


def welch(
    ours: np.ndarray,
    reference: np.ndarray,
    *,
    least: float,
    term_mean: float,
    areas: np.ndarray | float,
    brightest: float,
    events: np.ndarray | tuple[float, float] = (0.0, 0.0),
) -> Comparison:
    """Compare replicate means (K, ...) and (R, ...), relative to the reference or `least` if larger.

    `areas` are the pixels of each place, `brightest` is the largest pixel of any replicate, `events` are the sums over
    pixels of the largest rare event of each side (see `largest_event`).
    """

    def mean_and_variance(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        shifted = values - values[0]  # equal replicates: exactly 0
        count = len(values)
        variance = np.var(shifted, axis=0, ddof=1) / count if count > 1 else np.zeros(values.shape[1:])
        return values[0] + shifted.mean(axis=0), np.asarray(variance)

    (mean, variance), (other, other_variance) = mean_and_variance(ours), mean_and_variance(reference)
    event = brightest / areas
    variance = _borrowed(mean, variance, other, event / len(ours))
    if len(reference) > 1:
        other_variance = _borrowed(other, other_variance, mean, event / len(reference))
    both = variance + other_variance
    noiseless = both == 0
    share = np.divide(variance, both, out=np.zeros_like(both), where=~noiseless)
    spread = share**2 / (len(ours) - 1) + (1 - share) ** 2 / max(len(reference) - 1, 1)
    dof = np.where(noiseless, len(ours) + len(reference) - 2, 1 / spread)
    floor = np.hypot(TERM_FLOOR * term_mean, ULP_FLOOR * np.spacing(other.astype(np.float32)))
    scale = np.maximum(other, least)
    error = np.hypot(np.sqrt(both), floor) / scale
    bias = np.asarray((mean - other) / scale)
    event = np.where(bias < 0, events[0] / len(ours), events[1] / len(reference)) / areas
    own = np.where(bias < 0, variance, other_variance)
    # What is below 1e-15 of the noise is rounding, no event.
    seen = np.divide(own, event**2, out=np.zeros_like(own), where=event**2 > 1e-30 * own)
    return Comparison(mean, other, bias, error, scale, dof, noiseless, event / scale, seen)


def _borrowed(mean: np.ndarray, variance: np.ndarray, other: np.ndarray, event: np.ndarray | float) -> np.ndarray:
    """Variances of the means; a place where one side alone is 0 in all replicates has that of a place like the others.

    A sparse estimator may have no sample there, and its variance of 0 then proves nothing. Such a place has, for the
    mean of the other side, the larger of two: the largest variance relative to the square of the mean found anywhere on
    that side; and that of a Poisson law, mean times `event`, what one sample as bright as the brightest pixel adds to
    the mean of all replicates. A term that is lost there stays proven where the side is otherwise sure of itself.
    """
    lost = (mean == 0) & (other > 0)
    if not lost.any():
        return variance
    varying = (mean > 0) & (variance > 0)
    relative = np.max(variance[varying] / mean[varying] ** 2) if varying.any() else 0.0
    return np.where(lost, np.maximum(relative * other**2, event * other), variance)


def largest_event(sums: np.ndarray) -> np.ndarray:
    """What the largest rare event adds to one of the replicates (n, places, channels), by channel; 0 without any."""
    if len(sums) == 1:
        return np.zeros(sums.shape[2])
    usual = np.sort(sums, axis=0)[: len(sums) - max(1, len(sums) // 4)]
    far = _OF_THE_LARGEST * student.isf(RARE_EVENT, len(usual) - 1) * usual.std(axis=0, ddof=1)
    excess = sums.max(axis=0) - usual.mean(axis=0)
    return np.where(excess > far, excess, 0.0).max(axis=0)


def median_skewness(values: np.ndarray) -> float:
    """Of replicate means (n, ...) over the places that vary; 0 where none does, or too few replicates tell."""
    shifted = (values - values[0]).reshape(len(values), -1)
    varying = shifted[:, shifted.any(axis=0)]
    if len(values) < 3 or not varying.size:
        return 0.0
    return float(np.median(scipy.stats.skew(varying, axis=0, bias=False)))
