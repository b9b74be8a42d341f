"""Errors of numbers made of all replicates: an unbiased mean square by way of a Gram matrix, and its jackknife.

The mean square of a difference over pixels, or over blocks of them, freed of both sides' noise,

    θ = mean((Ī - R̄)²) - mean(s_I²/K) - mean(s_R²/R)
      = ⟨I_k, I_l⟩_{k≠l} - 2 ⟨I_k, R_r⟩ + ⟨R_r, R_s⟩_{r≠s},

is a function of the Gram matrix of all replicate images alone. Its error is a delete-one jackknife over the replicates
of both sides with `t_{min(K, R)-1}`: a bootstrap centres on the un-debiased value and covered the truth in 0 of 240
trials.
"""

from collections.abc import Sequence
from functools import cached_property

import attrs
import numpy as np

from termwise.reports.statistics import student
from termwise.reports.statistics.replicates import bands, check, stacked
from termwise.reports.statistics.verdict import POWER


@attrs.frozen(eq=False)
class Estimate:
    """A number with its delete-one jackknife.

    Attributes
    ----------
    value : float
    leave_one_out : tuple of (n_g,) float64, the number without one replicate, for each group that has more than one.
    floor : added to the standard error in quadrature.
    noise : of a mean square, the part that noise has in it and that was taken off.
    """

    value: float
    leave_one_out: tuple[np.ndarray, ...]
    floor: float = 0.0
    noise: float = 0.0

    @cached_property
    def standard_error(self) -> float:
        """`sqrt(Σ_g (n_g - 1)/n_g Σ_i (θ_(i) - mean θ_(·))² + floor²)` (Efron 1982, for several samples)."""
        variance = sum((len(each) - 1) * np.var(each) for each in self.leave_one_out)
        return float(np.sqrt(variance + self.floor**2))

    @property
    def dof(self) -> int:
        """Of the smallest group."""
        return min(len(each) for each in self.leave_one_out) - 1

    def low(self, level: float) -> float:
        """One-sided lower bound, above the truth in `level` of the runs."""
        return self.value - float(student.isf(level, self.dof)) * self.standard_error

    def high(self, level: float) -> float:
        """One-sided upper bound, below the truth in `level` of the runs."""
        return self.value + float(student.isf(level, self.dof)) * self.standard_error

    def detectable(self, level: float, least: float) -> float:
        """Smallest mean square whose lower bound is above `least` in 80 % of the runs.

        Of B blocks with noise V each, the jackknife has `s² = 4 V²/B` where there is no error, twice the variance that
        θ then has, and `s² (1 + θ/V)` where its mean square is θ.
        """
        quantile = float(student.isf(level, self.dof) + student.isf(1 - POWER, self.dof))
        if self.noise == 0:
            return least + quantile * self.standard_error
        variance = self.standard_error**2 / (1 + max(self.value, 0.0) / self.noise)
        # (θ - least)² = quantile² s² (1 + θ/V), solved for θ.
        half = least + quantile**2 * variance / (2 * self.noise)
        return half + float(np.sqrt(half**2 - least**2 + quantile**2 * variance))


@attrs.frozen(eq=False)
class Gram:
    """Inner products of the replicate images of several groups.

    Attributes
    ----------
    matrix : (N, N) float64, mean over pixels of the products, N the sum of `sizes`. Subtract a common image from all
        replicates first: the differences estimated here do not change, their rounding error does.
    sizes : replicates per group, in the order of the matrix. A group of one is exact, without noise.
    """

    matrix: np.ndarray
    sizes: tuple[int, ...]

    def estimate(self, products: np.ndarray, variances: np.ndarray | Sequence[float] | None = None) -> Estimate:
        """`Σ products[g, h] ⟨E_g, E_h⟩ + Σ variances[g] V_g`, unbiased, with its jackknife.

        `E_g` is the limit of group g, `V_g` the variance of one of its replicates, both averaged over pixels.
        """
        member = np.repeat(np.eye(len(self.sizes)), self.sizes, axis=0)
        diagonal, rows = np.diag(self.matrix), self.matrix @ member
        total, trace, counts = member.T @ rows, member.T @ diagonal, np.array(self.sizes, dtype=float)
        weights = np.zeros(len(self.sizes)) if variances is None else np.asarray(variances, dtype=float)

        def value(total: np.ndarray, trace: np.ndarray, counts: np.ndarray) -> np.ndarray:
            # (..., G, G), (..., G), (..., G). Products of different replicates have no noise in the mean.
            limits = total / (counts[..., :, None] * counts[..., None, :])
            single, own = np.array(self.sizes) == 1, np.diagonal(total, axis1=-2, axis2=-1)
            pairs = np.where(single, 1.0, counts * (counts - 1))
            square = np.where(single, own, own - trace) / pairs
            limits[..., np.arange(len(single)), np.arange(len(single))] = square
            variance = np.where(single, 0.0, trace / counts - square)
            return np.sum(products * limits, axis=(-2, -1)) + np.sum(weights * variance, axis=-1)

        # Without replicate i, of which `one` marks the group: no image is read again.
        deletable = np.array([size > 1 for size in self.sizes for _ in range(size)])
        one, row, square = member[deletable], rows[deletable], diagonal[deletable]
        outer = one[:, :, None] * row[:, None, :]
        both = square[:, None, None] * one[:, :, None] * one[:, None, :]
        deleted = value(total - outer - outer.swapaxes(1, 2) + both, trace - square[:, None] * one, counts - one)
        ends = np.cumsum([size for size in self.sizes if size > 1])
        return Estimate(float(value(total, trace, counts)), tuple(np.split(deleted, ends[:-1])))

    def squared_distance(self) -> Estimate:
        """θ of two groups: `mean((E_0 - E_1)²)`; may come out negative."""
        found = self.estimate(np.array([[1.0, -1.0], [-1.0, 1.0]]))
        ends = np.cumsum((0, *self.sizes))
        groups = [self.matrix[a:b, a:b] for a, b in zip(ends, ends[1:], strict=False) if b - a > 1]
        noise = sum((len(each) * np.trace(each) - each.sum()) / (len(each) ** 2 * (len(each) - 1)) for each in groups)
        return attrs.evolve(found, noise=float(noise))

    def variance(self, group: int) -> Estimate:
        """Variance of one replicate of the group, mean over pixels."""
        return self.estimate(np.zeros((len(self.sizes),) * 2), np.eye(len(self.sizes))[group])


def gram(*groups: np.ndarray) -> Gram:
    """Gram matrix over pixels and channels of groups (n, H, W, 3) of equal image shape, read by bands."""
    sizes = tuple(len(group) for group in groups)
    matrix = np.zeros((sum(sizes), sum(sizes)))
    for _, band in bands(*groups):
        images = np.concatenate(band, dtype=np.float64)
        matrix += inner_products(images - images.mean(axis=0))
    return Gram(matrix / np.prod(groups[0].shape[1:]), sizes)


def inner_products(images: np.ndarray) -> np.ndarray:
    """Inner products (n, n) of images (n, ...)."""
    flat = images.reshape(len(images), -1)
    return flat @ flat.T


@attrs.frozen(eq=False)
class ErrorSplit:
    """`MSE against physical = mean(G²) + 2 mean(G·B) + mean(B²) + mean(V)`, each part unbiased.

    In radiance², over pixels and channels. The parts add up to `total`; `cross` is the signed middle term.
    """

    model_gap: Estimate
    cross: Estimate
    bias: Estimate
    variance: Estimate
    total: Estimate


def split_error(ours: np.ndarray, own: np.ndarray, physical: np.ndarray) -> ErrorSplit:
    """Split the error of one replicate of ours against full light transport into its four causes.

    `G = own - physical` is the model gap, `B = E[ours] - own` the estimator's bias, `V` the variance of one
    replicate. Products are taken over different replicates only, so that no part holds noise in its mean.

    Parameters
    ----------
    ours, own, physical : (n, H, W, 3) floating
        Replicates, in one unit of radiance; a group of one is taken as exact, but ours needs more.

    Raises
    ------
    ValueError : for groups that do not fit or fewer than 4 replicates of ours.
    """
    groups = tuple(stacked(*each) for each in (("ours", ours), ("own", own), ("physical", physical)))
    for group in groups[1:]:
        check(groups[0], group, None, None, len(group) == 1)
    pairs = gram(*groups)
    b, g = np.array([1.0, -1.0, 0.0]), np.array([0.0, 1.0, -1.0])
    return ErrorSplit(
        model_gap=pairs.estimate(np.outer(g, g)),
        cross=pairs.estimate(2 * np.outer(g, b)),
        bias=pairs.estimate(np.outer(b, b)),
        variance=pairs.estimate(np.zeros((3, 3)), (1.0, 0.0, 0.0)),
        total=pairs.estimate(np.outer(g + b, g + b), (1.0, 0.0, 0.0)),
    )


def float_error(kept: np.ndarray, rendered: np.ndarray) -> Estimate:
    """The share of `mean(B²)` that rounding alone makes: `mean(E[kept - rendered]²)`, unbiased.

    Parameters
    ----------
    kept, rendered : (K, H, W, 3) float32 and float64
        The same replicates, of the same random numbers, as they are judged and as they were added up.
    """
    difference = np.subtract(kept, rendered, dtype=np.float64)
    matrix = inner_products(difference) / np.prod(difference.shape[1:])
    return Gram(matrix, (len(kept),)).estimate(np.ones((1, 1)))
