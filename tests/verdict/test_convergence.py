"""The fit of `MSE(N) = b² + c·N^-a` on estimators whose curve is known.

Rationale: the named cause sends a reader to look for a bias, a repeated seed or a kernel; a confusion matrix
shows that it sends to the right one. Set-up: K = 16 runs of 256 samples of 64 pixels, prefixes in powers of two.
"""

import numpy as np
import pytest

from termwise.reports.statistics.convergence import extrapolate, fit, mean_square_error
from termwise.reports.statistics.jackknife import Estimate, gram

SAMPLES = 2 ** np.arange(9)
RUNS = 20


def prefixes(rng: np.random.Generator, estimator: str) -> list[np.ndarray]:
    """Prefix means (16, 8, 8, 3) of one run per replicate around a limit of 1."""
    noise = rng.normal(size=(16, SAMPLES[-1], 64))
    if estimator == "repeated seeds":
        noise = np.tile(noise[:, :16], (1, SAMPLES[-1] // 16, 1))
    images = []
    for n in SAMPLES:
        image = noise[:, :n].mean(axis=1)
        if estimator == "bias":
            image = image + 0.1
        elif estimator == "kernel":
            image = 0.1 * image + 0.5 * n ** (-1 / 3)
        elif estimator == "stratified":
            image = image / np.sqrt(n)
        images.append(1 + np.repeat(image.reshape(16, 8, 8, 1), 3, axis=3))
    return images


def study(rng: np.random.Generator, estimator: str, reference: np.ndarray):
    images = prefixes(rng, estimator)
    errors = [mean_square_error(each, reference) for each in images]
    return fit(SAMPLES, errors, bias_squared=gram(images[-1], reference).squared_distance())


@pytest.mark.parametrize(
    ("estimator", "cause"),
    [
        ("independent", "as independent samples without bias"),
        ("bias", "bias or a clamp"),
        ("repeated seeds", "noise that no longer falls, as of repeated seeds"),
        ("kernel", "a heavy tail or a shrinking kernel"),
        ("stratified", "stratified or low-discrepancy"),
    ],
)
def test_confusion_matrix(estimator, cause):
    """20 runs each. Expected: the right cause in at least 15 (a 90 % interval of a and a 95 % bound of b²)."""
    rng = np.random.default_rng(21)
    reference = np.ones((1, 8, 8, 3))
    causes = [study(rng, estimator, reference).cause for _ in range(RUNS)]
    assert sum(cause in each for each in causes) >= 15, causes


@pytest.mark.slow
def test_intervals_cover_the_truth():
    """Bias 0.1, a = 1, against a noisy reference: 90 % intervals cover both in at least 80 % of 40 runs."""
    rng = np.random.default_rng(22)
    covered = np.zeros(2)
    for _ in range(40):
        reference = 1 + np.repeat(rng.normal(0, 0.03, (16, 8, 8, 1)), 3, axis=3)
        result = study(rng, "bias", reference)
        assert result.slope is not None
        for i, (estimate, truth) in enumerate(((result.slope, 1.0), (result.floor, 0.01))):
            covered[i] += estimate.low(0.05) <= truth <= estimate.high(0.05)
    assert np.all(covered >= 0.8 * 40)


def exact(values: np.ndarray) -> list[Estimate]:
    return [Estimate(float(value), (np.full(8, value),)) for value in values]


@pytest.mark.parametrize("truth", [(0.0, 1.0, 1.0), (0.02, 3.0, 0.667), (1e-4, 0.5, 1.8), (-1e-3, 1.0, 1.0)])
def test_a_curve_without_noise_is_recovered(truth):
    b2, c, a = truth
    result = fit(SAMPLES, exact(b2 + c * SAMPLES**-a))
    assert result.slope is not None
    np.testing.assert_allclose([result.slope.value, result.scale.value], [a, c], rtol=1e-3)
    assert result.floor.value == pytest.approx(b2, abs=1e-4)
    np.testing.assert_allclose(result.fitted_rmse(SAMPLES), result.rmse, rtol=1e-3)


def test_errors_that_do_not_fall_have_no_slope():
    constant = fit(SAMPLES, exact(np.full(9, 0.04)), seconds=SAMPLES / 10)
    assert constant.slope is None
    assert "does not fall" in constant.cause
    np.testing.assert_allclose(constant.fitted_rmse(SAMPLES), 0.2)
    none = fit(SAMPLES, exact(np.zeros(9)))
    assert none.cause.endswith("or none")
    assert np.all(np.isfinite(none.rmse_high))


def test_mean_square_error_is_freed_of_the_reference_noise():
    """Limit off by 0.2, variance 0.25 of a replicate: 0.29 on average, whatever the reference's noise."""
    rng = np.random.default_rng(23)
    found = [
        mean_square_error(1.2 + rng.normal(0, 0.5, (6, 6, 6, 3)), 1 + rng.normal(0, 1.0, (6, 6, 6, 3))).value
        for _ in range(300)
    ]
    assert abs(np.mean(found) - 0.29) < 4 * np.std(found) / np.sqrt(300)


@pytest.mark.parametrize(
    ("samples", "errors", "message"),
    [
        ([1, 2, 4], exact(np.ones(3)), "≥ 4"),
        ([1, 2, 4, 8], exact(np.ones(5)), "4 prefixes and 5 errors"),
        ([1, 4, 2, 8], exact(np.ones(4)), "must be positive and increase"),
        ([1, 2, 4, 8], [*exact(np.ones(3)), Estimate(1.0, (np.ones(9),))], "different replicates"),
    ],
)
def test_bad_prefixes_are_refused(samples, errors, message):
    with pytest.raises(ValueError, match=message):
        fit(samples, errors)


def jackknifed(values: np.ndarray) -> Estimate:
    """The mean of replicates (K,) and the means without each."""
    return Estimate(float(values.mean()), ((values.sum() - values) / (len(values) - 1),))


def test_extrapolation_is_the_line_s_intercept():
    """Values on `3 + 2 r²`: exactly 3; off the line: NumPy's polyfit, and its jackknife that of each replicate."""
    radii = np.array([0.1, 0.2, 0.25, 0.4])
    assert extrapolate(radii, exact(3 + 2 * radii**2)).value == pytest.approx(3, rel=1e-12)
    rng = np.random.default_rng(24)
    values = rng.normal(size=(4, 9))
    found = extrapolate(radii, [jackknifed(each) for each in values])
    single = np.polynomial.polynomial.polyfit(radii**2, values, 1)[0]
    assert found.value == pytest.approx(single.mean(), rel=1e-10)
    # A linear combination of means: the jackknife is the standard error of the mean.
    assert found.standard_error == pytest.approx(single.std(ddof=1) / 3, rel=1e-10)


def test_extrapolation_covers_the_truth():
    """E = 1 + r², noise growing as 1/r and shared by the radii: the 90 % interval covers 1 as often."""
    rng = np.random.default_rng(25)
    radii = np.array([0.1, 0.15, 0.2, 0.3])
    covered = 0
    for _ in range(200):
        noise = (rng.normal(size=(4, 16)) + rng.normal(size=16)) * 0.02 / radii[:, None]
        found = extrapolate(radii, [jackknifed(1 + r * r + each) for r, each in zip(radii, noise, strict=True)])
        covered += found.low(0.05) <= 1 <= found.high(0.05)
    # Three standard deviations of the binomial around 180.
    assert abs(covered - 180) <= 3 * np.sqrt(200 * 0.9 * 0.1)


@pytest.mark.parametrize(
    ("radii", "estimates", "message"),
    [
        ([0.1, 0.2], exact(np.ones(2)), "≥ 3"),
        ([0.1, 0.2, 0.3], exact(np.ones(4)), "3 radii and 4 estimates"),
        ([0.1, 0.2, 0.2], exact(np.ones(3)), "positive and distinct"),
        ([0.0, 0.1, 0.2], exact(np.ones(3)), "positive and distinct"),
        ([0.1, 0.2, 0.3], [*exact(np.ones(2)), Estimate(1.0, (np.ones(9),))], "different replicates"),
    ],
)
def test_bad_radii_are_refused(radii, estimates, message):
    with pytest.raises(ValueError, match=message):
        extrapolate(radii, estimates)
