"""Do two means differ? Welch's t on the replicate means of places, and what rare events may hide.

The relative bias of a place's mean is judged on the means of its replicates,

    δ = (Ī - R̄)/scale,     SE² = (s_I²/K + s_R²/R)/scale² + floor²,     t = δ/SE,

with the degrees of freedom of Welch and Satterthwaite.

Noise is skewed: replicates that lack bright samples are dark and agree with one another, and t trusts them. If the
light of a place came in events of one flux E (δ summed over pixels) and its standard error is that of
`m = (K SE / E)²` of them, a place that lacks D in the mean of K replicates has missed `λ = K D / E` events. By
Poisson's law so few are met with probability `Q(m + 1, m + λ)`, `e^-λ` for m = 0: a mean is proven off only if that,
too, is below the level of its test. E is the largest that either side shows anywhere, relative to the radiance there:
an event that stands out of the replicates of any place (`largest_event`), and the flux that gives the noise of pixels
and tiles the skewness that it has (`event_size`). Of ordinary noise E is about its standard deviation, m is large, and
t asks for more. Shape needs no such rule: where events are met, its jackknife has them.
"""

from collections.abc import Sequence

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
    unseen : float64, size of δ that one event makes if the side that is darker here has missed it; 0 where neither side
        has skewed noise anywhere.
    seen : float64, how many such events the darker side has met here, by its standard error.
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

    def at(self, indices: np.ndarray) -> "Comparison":
        """Of some places, by flat index."""
        names = [field.name for field in attrs.fields(Comparison)]
        return Comparison(*(getattr(self, name).ravel()[indices] for name in names))

    def interval(self, level: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """Two-sided interval of δ that misses the truth in `level` of the runs."""
        half = student.isf(level / 2, self.dof) * self.standard_error
        return self.bias - half, self.bias + half

    def p_values(self) -> np.ndarray:
        """Two-sided p of "no bias at all"; uniform under the null but for noiseless places, which the floor judges.

        NaN where all replicates of both sides are the same number: there is nothing to test.
        """
        p = 2 * student.sf(np.abs(self.bias) / self.standard_error, self.dof)
        return np.where(self.noiseless & (self.bias == 0), np.nan, p)

    def detectable(self, level: np.ndarray | float, limit: float) -> np.ndarray:
        """Smallest bias that this very measurement finds outside ±limit in 80 % of the runs."""
        outside = limit + student.isf(level / 2, self.dof) * self.standard_error
        return np.maximum(outside, self.missing(level)) + student.isf(1 - POWER, self.dof) * self.standard_error

    def missing(self, level: np.ndarray | float) -> np.ndarray:
        """Size of δ up to which events that were not met explain it: the chance of so few is above `level`."""
        return self.unseen * (scipy.special.gammainccinv(self.seen + 1, level) - self.seen)


def welch(
    ours: np.ndarray,
    reference: np.ndarray,
    *,
    least: np.ndarray | float,
    term_mean: float,
    areas: np.ndarray | float,
    brightest: float,
    event: np.ndarray | float = 0.0,
    quantum: float = 0.0,
) -> Comparison:
    """Compare replicate means (K, ...) and (R, ...), relative to the reference or `least` if larger.

    `areas` are the pixels of each place, `brightest` is the largest pixel of any replicate, `event` is the flux E in
    units of a place's scale, `quantum` is the relative rounding of stored values beyond float32's.
    """

    def mean_and_variance(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        shifted = values - values[0]  # equal replicates: exactly 0
        count = len(values)
        variance = np.var(shifted, axis=0, ddof=1) / count if count > 1 else np.zeros(values.shape[1:])
        return values[0] + shifted.mean(axis=0), np.asarray(variance)

    (mean, variance), (other, other_variance) = mean_and_variance(ours), mean_and_variance(reference)
    scale = np.maximum(other, least)
    # As bright as an event here, or as the brightest pixel where that is less.
    sample = np.minimum(brightest, event * scale) / areas
    variance = _borrowed(mean, variance, other, sample / len(ours))
    if len(reference) > 1:
        other_variance = _borrowed(other, other_variance, mean, sample / len(reference))
    both = variance + other_variance
    noiseless = both == 0
    share = np.divide(variance, both, out=np.zeros_like(both), where=~noiseless)
    spread = share**2 / (len(ours) - 1) + (1 - share) ** 2 / max(len(reference) - 1, 1)
    dof = np.where(noiseless, len(ours) + len(reference) - 2, 1 / spread)
    rounding = ULP_FLOOR * np.spacing(other.astype(np.float32)) + quantum * other
    floor = np.hypot(TERM_FLOOR * term_mean, rounding)
    error = np.hypot(np.sqrt(both), floor) / scale
    bias = np.asarray((mean - other) / scale)
    # One exact image has missed nothing.
    unseen = np.where(bias < 0, event / len(ours), event / len(reference) if len(reference) > 1 else 0.0) / areas
    own = np.where(bias < 0, variance, other_variance) / scale**2
    # What is below 1e-15 of the noise is rounding, no event.
    seen = np.divide(own, unseen**2, out=np.zeros_like(own), where=unseen**2 > 1e-30 * own)
    return Comparison(mean, other, bias, error, scale, dof, noiseless, unseen, seen)


def _borrowed(mean: np.ndarray, variance: np.ndarray, other: np.ndarray, event: np.ndarray | float) -> np.ndarray:
    """Variances of the means; a place where one side alone is 0 in all replicates has that of a place like the others.

    A sparse estimator may have no sample there, and its variance of 0 then proves nothing. Such a place has, for the
    mean of the other side, the larger of two: the largest variance relative to the square of the mean found anywhere on
    that side; and that of a Poisson law, mean times `event`, what one event of the flux E, at most of the brightest
    pixel's, adds to the mean of all replicates. A term that is lost there stays proven where the side is otherwise
    sure of itself.
    """
    lost = (mean == 0) & (other > 0)
    if not lost.any():
        return variance
    varying = (mean > 0) & (variance > 0)
    relative = np.max(variance[varying] / mean[varying] ** 2) if varying.any() else 0.0
    return np.where(lost, np.maximum(relative * other**2, event * other), variance)


def stack(comparisons: Sequence[Comparison]) -> Comparison:
    """Several of one shape as one, along a new first axis."""
    names = [field.name for field in attrs.fields(Comparison)]
    return Comparison(*(np.stack([getattr(each, name) for each in comparisons]) for name in names))


def largest_event(sums: np.ndarray) -> np.ndarray:
    """What the largest rare event adds to one of the replicates (n, quantities, places), by quantity; 0 without any."""
    if len(sums) == 1:
        return np.zeros(sums.shape[1])
    usual = np.sort(sums, axis=0)[: len(sums) - max(1, len(sums) // 4)]
    far = _OF_THE_LARGEST * student.isf(RARE_EVENT, len(usual) - 1) * usual.std(axis=0, ddof=1)
    excess = sums.max(axis=0) - usual.mean(axis=0)
    return np.where(excess > far, excess, 0.0).max(axis=1)


def cumulants(values: np.ndarray, axis: int = 0) -> np.ndarray:
    """(2, ...): second and third cumulant of each place over the replicates along an axis, unbiased; 0 of one."""
    count = values.shape[axis]
    if count < 3:
        return np.zeros((2, *np.delete(values.shape, axis)))
    off = np.moveaxis(values - values.mean(axis=axis, keepdims=True), axis, 0)
    second = np.einsum("k...,k...->...", off, off) / (count - 1)
    third = np.einsum("k...,k...->...", off * off, off) * (count / ((count - 1) * (count - 2)))
    return np.array([second, third])


def event_size(of_places: np.ndarray, count: int) -> np.ndarray:
    """(4,): flux of events that have the cumulants (2, 4, places) of `count` replicates by Poisson's law, κ_3/κ_2.

    Less two standard errors that it has in normal noise, so that little of it is made of few numbers; 0 at least.
    """
    second, third = of_places.sum(axis=2)
    places = of_places.shape[2]
    chance = 2 * np.sqrt(6 / (places * count) * second / places)
    return np.maximum(np.divide(third, second, out=np.zeros_like(third), where=second > 0) - chance, 0.0)


def median_skewness(values: np.ndarray) -> float:
    """Of replicate means (n, ...) over the places that vary; 0 where none does, or too few replicates tell."""
    second, third = cumulants(values - values[0])  # equal replicates: exactly 0
    varying = second > 0
    return float(np.median(third[varying] / second[varying] ** 1.5)) if varying.any() else 0.0
