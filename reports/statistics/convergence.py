"""How the error falls with samples: `MSE(N) = b² + c·N^-a`, and what its shape says about the estimator.

An unbiased mean of N independent samples has a = 1 and b = 0. Prefixes of one run share samples, so the
errors of a least-squares fit mean nothing: the whole fit is repeated without each replicate (delete-one
jackknife over the replicates of both sides).

Kernel estimates are biased at any N; `E(r) = E(0) + c r²` inside a surface, and means over an image have the same law
in the strips along edges and shadow borders, r wide and O(r) wrong. `extrapolate` takes r to 0.
"""

from collections.abc import Callable, Sequence

import attrs
import numpy as np
from scipy.optimize import fminbound

from termwise.reports.statistics.jackknife import Estimate, gram
from termwise.reports.statistics.replicates import LUMINANCE

SLOPES = 0.1, 3.0
"""Range of a that is searched: a slower fall looks like none, a faster one like a floor."""
STILL_FALLING = 0.8
"""A last prefix with less of the error before it is on no plateau; independent samples have 0.5."""
PREFIXES_NEEDED = 4
"""One more than the parameters."""
RADII_NEEDED = 3
"""One more than the parameters of `E(0) + c r²`."""


@attrs.frozen(eq=False)
class Convergence:
    """A fitted curve of errors.

    Attributes
    ----------
    samples : (P,) float64
    seconds : (P,) float64 or None, time that each prefix takes.
    rmse, rmse_low, rmse_high : (P,) float64, of one replicate against the reference's limit, in radiance; 90 % band.
    slope : Estimate or None, a; None where the error is not proven to fall.
    floor : b² in radiance²; may be negative.
    scale : c in radiance², the error above the floor at the first prefix: `MSE = b² + c (N/N_1)^-a`.
    cause : what the shape of the curve says.
    """

    samples: np.ndarray
    seconds: np.ndarray | None
    rmse: np.ndarray
    rmse_low: np.ndarray
    rmse_high: np.ndarray
    slope: Estimate | None
    floor: Estimate
    scale: Estimate
    cause: str

    def fitted_rmse(self, samples: np.ndarray) -> np.ndarray:
        """The fitted curve at any samples, in radiance; 0 where the fitted square is negative."""
        fall = 1.0 if self.slope is None else (np.asarray(samples) / self.samples[0]) ** -self.slope.value
        return np.sqrt(np.maximum(0.0, self.floor.value + self.scale.value * fall))


def mean_square_error(ours: np.ndarray, reference: np.ndarray) -> Estimate:
    """Mean square error of one replicate against the reference's limit, freed of the reference's noise.

    `mean((I_k - R̄)²) - mean(s_R²/R)` over pixels, channels and replicates: unbiased for `b² + V`, in
    radiance², with a delete-one jackknife over both sides.

    Parameters
    ----------
    ours : (K, H, W, 3) floating, replicates at one prefix, read by bands.
    reference : (R, H, W, 3) floating, R = 1 is taken as exact.
    """
    return gram(ours, reference).estimate(np.array([[1.0, -1.0], [-1.0, 1.0]]), (1.0, 0.0))


def relative_error(ours: np.ndarray, reference: np.ndarray, *, where: np.ndarray | None = None) -> Estimate:
    """Error of the mean luminance, as a share of the reference's: `mean I_k / mean R - 1`.

    Parameters
    ----------
    ours, reference : (K, H, W, 3) and (R, H, W, 3) floating, replicates; the mean of the reference is not 0.
    where : (H, W) bool, optional
        The error of these pixels alone, as a share of the same mean: those of the parts of an image add up to its own.
    """
    inside = np.ones(ours.shape[1:3], bool) if where is None else where
    a, b, whole = (
        np.dot(each[:, chosen].sum(axis=1, dtype=np.float64), LUMINANCE)
        for each, chosen in ((ours, inside), (reference, inside), (reference, np.ones_like(inside)))
    )

    def without_one(values: np.ndarray) -> np.ndarray:
        return (values.sum() - values) / (len(values) - 1)

    a_mean, b_mean, mean = a.mean(), b.mean(), whole.mean()
    leave_one_out = (without_one(a) - b_mean) / mean, (a_mean - without_one(b)) / without_one(whole)
    return Estimate(float((a_mean - b_mean) / mean), leave_one_out)


def fit(
    samples: Sequence[float] | np.ndarray,
    errors: Sequence[Estimate],
    *,
    seconds: Sequence[float] | np.ndarray | None = None,
    bias_squared: Estimate | None = None,
) -> Convergence:
    """Fit `MSE(N) = b² + c·N^-a` by least squares on relative residuals, and name the cause of its shape.

    Parameters
    ----------
    samples : (P,), increasing, samples of each prefix, powers of two; P ≥ 4.
    errors : P estimates
        `mean_square_error` of each prefix, of the same replicates in the same order.
    seconds : (P,), optional, time that each prefix takes.
    bias_squared : debiased bias² at the largest prefix (`Statistics.bias_squared`). It tells a floor made by bias from
        one made by noise that no longer falls.

    Raises
    ------
    ValueError : for fewer than 4 prefixes, samples that do not increase, or estimates of different replicates.
    """
    samples = np.asarray(samples, dtype=np.float64)
    if len(samples) < PREFIXES_NEEDED or len(samples) != len(errors):
        raise ValueError(f"{len(samples)} prefixes and {len(errors)} errors; as many and ≥ {PREFIXES_NEEDED} needed")
    if samples[0] <= 0 or np.any(np.diff(samples) <= 0):
        raise ValueError(f"samples are {samples.tolist()}; they must be positive and increase")
    if seconds is not None and len(seconds) != len(samples):
        raise ValueError(f"{len(samples)} prefixes, but seconds of {len(seconds)}")
    _same_replicates(errors, "prefixes")

    values = np.array([error.value for error in errors])
    weights = 1 / np.maximum(np.abs(values), 1e-12 * (np.abs(values).max() or 1.0))

    def estimates(of: Callable[[np.ndarray], Sequence[float]]) -> list[Estimate]:
        """Numbers made of the prefixes' errors, with the jackknife carried through."""
        without = [
            np.array([of(left) for left in np.stack(group, axis=1)])
            for group in zip(*(error.leave_one_out for error in errors), strict=True)
        ]
        return [Estimate(float(value), tuple(group[:, i] for group in without)) for i, value in enumerate(of(values))]

    (fall,) = estimates(lambda y: (y[0] - y[-1],))
    if fall.low(0.05) > 0:
        floor, scale, slope = estimates(lambda y: _least_squares(samples / samples[0], y, weights))
    else:
        (floor,) = estimates(lambda y: (np.average(y, weights=weights),))
        scale, slope = Estimate(0.0, tuple(np.zeros_like(each) for each in floor.leave_one_out)), None

    def root(squares: Sequence[float] | np.ndarray) -> np.ndarray:
        return np.sqrt(np.maximum(0.0, np.asarray(squares)))

    return Convergence(
        samples=samples,
        seconds=None if seconds is None else np.asarray(seconds, dtype=np.float64),
        rmse=root(values),
        rmse_low=root([error.low(0.05) for error in errors]),
        rmse_high=root([error.high(0.05) for error in errors]),
        slope=slope,
        floor=floor,
        scale=scale,
        cause=_cause(slope, floor, bias_squared, float(values[-1] / values[-2]) if values[-2] > 0 else 1.0),
    )


def _least_squares(n: np.ndarray, values: np.ndarray, weights: np.ndarray) -> tuple[float, float, float]:
    """b², c, a: for each a the other two are linear, so that a alone is searched."""

    def linear(a: float) -> tuple[np.ndarray, float]:
        design = np.stack([np.ones_like(n), n**-a], axis=1) * weights[:, None]
        solution = np.linalg.lstsq(design, values * weights, rcond=None)[0]
        return solution, float(np.sum((design @ solution - values * weights) ** 2))

    # The residual may have two valleys in a (a floor, or a slow fall): start the search from a grid.
    grid = np.geomspace(*SLOPES, 25)
    best = int(np.argmin([linear(a)[1] for a in grid]))
    ends = grid[max(0, best - 1)], grid[min(len(grid) - 1, best + 1)]
    slope = np.asarray(fminbound(lambda a: linear(a)[1], *ends)).item()
    (floor, scale), _ = linear(slope)
    return float(floor), float(scale), slope


def _cause(slope: Estimate | None, floor: Estimate, bias_squared: Estimate | None, last_step: float) -> str:
    biased = bias_squared is not None and bias_squared.low(0.05) > 0
    if floor.low(0.05) > 0 and not biased and last_step < STILL_FALLING:
        # Low-discrepancy points fall faster at few samples than at many: a bend, which the law takes for a floor.
        return f"falls, but not as one power of N: the last prefix has {last_step:.2f} of the MSE before it"
    if floor.low(0.05) > 0:
        if bias_squared is None:
            origin = "bias, a clamp, or repeated seeds"
        else:
            origin = "bias or a clamp" if biased else "noise that no longer falls, as of repeated seeds"
        plateau = f"plateau b = {np.sqrt(floor.value):.3g}: {origin}"
        return f"{plateau}; above it {_interval(slope)}" if slope else f"{plateau}; the error does not fall"
    if slope is None:
        return "the error is not proven to fall with the samples: too noisy to tell, or none"
    low, high, interval = slope.low(0.05), slope.high(0.05), _interval(slope)
    if high < 1:
        return f"{interval}: slower than independent samples, a heavy tail or a shrinking kernel"
    if low > 1:
        return f"{interval}: faster than independent samples, stratified or low-discrepancy"
    return f"{interval}: as independent samples without bias"


def _interval(slope: Estimate) -> str:
    return f"a = {slope.value:.2f} [{slope.low(0.05):.2f}, {slope.high(0.05):.2f}]"


def extrapolate(radii: Sequence[float] | np.ndarray, estimates: Sequence[Estimate]) -> Estimate:
    """E(0) of `E(r) = E(0) + c r²` by least squares on r²: the kernel's bias of O(r²) cancels, O(r⁴) is left.

    A fixed linear combination of the estimates, so its mean and its jackknife are those of the combined replicates,
    whether the estimates share photons or not.

    Parameters
    ----------
    radii : (P,), distinct
        Kernel radii; P ≥ 3. A progressive estimate stands at the root of its mean r_i² (the bias is linear in r²).
    estimates : P estimates
        Of one quantity at each radius, over the same replicates in the same order.

    Raises
    ------
    ValueError : for fewer than 3 radii, radii that are not positive and distinct, or estimates of different replicates.
    """
    radii = np.asarray(radii, dtype=np.float64)
    if len(radii) < RADII_NEEDED or len(radii) != len(estimates):
        raise ValueError(f"{len(radii)} radii and {len(estimates)} estimates; as many and ≥ {RADII_NEEDED} needed")
    if np.any(radii <= 0) or len(np.unique(radii)) < len(radii):
        raise ValueError(f"radii are {radii.tolist()}; they must be positive and distinct")
    _same_replicates(estimates, "radii")
    square = (radii / radii.max()) ** 2
    weights = np.linalg.pinv(np.stack([np.ones_like(square), square], axis=1))[0]
    groups = zip(*(estimate.leave_one_out for estimate in estimates), strict=True)
    return Estimate(
        float(weights @ [estimate.value for estimate in estimates]),
        tuple(weights @ np.stack(group) for group in groups),
        # Float error is no noise: that of the radii may add up.
        float(np.abs(weights) @ [estimate.floor for estimate in estimates]),
    )


def _same_replicates(estimates: Sequence[Estimate], what: str) -> None:
    groups = {tuple(len(each) for each in estimate.leave_one_out) for estimate in estimates}
    if len(groups) > 1:
        raise ValueError(f"{what} of different replicates: {sorted(groups)}")
