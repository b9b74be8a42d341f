"""The metrics against closed forms: no number here comes from the code under test.

Rationale: published metrics have forgotten squares and guessed ranges; a metric that gates a render is
itself judged by images whose distance is known by hand.
"""

import numpy as np
import pytest

from termwise.reports.statistics.metrics import encode, relative_mse, rmse, ssim

FLAT = np.full((16, 12, 3), 2.0)


@pytest.fixture
def picture() -> np.ndarray:
    return np.random.default_rng(1).uniform(0.1, 0.9, (24, 32, 3))


def test_rmse_of_an_offset_is_the_offset(picture):
    assert rmse(picture, picture + 0.25) == pytest.approx(0.25, rel=1e-12)
    assert rmse(picture, picture - 0.25) == pytest.approx(0.25, rel=1e-12)
    assert rmse(picture, picture) == 0.0


def test_rmse_is_a_root_of_a_mean_of_squares():
    """One pixel in four off by 4 gives sqrt(16/4) = 2, where a mean of magnitudes would give 1."""
    image = np.zeros((2, 2, 1))
    image[0, 0] = 4.0
    assert rmse(np.zeros((2, 2, 1)), image) == 2.0


def test_rmse_accumulates_in_float64():
    """2^25 errors of 1: a float32 running sum stops at 2^24."""
    ones = np.ones(2**25, dtype=np.float32)
    assert rmse(np.zeros_like(ones), ones) == 1.0


def test_relative_mse_of_a_gain(picture):
    """A gain of 1 + e on a flat image of mean R gives e²R²/(R² + R²/100) = e²/1.01, at any unit of radiance."""
    for unit in (1e-6, 1.0, 1e6):
        assert relative_mse(FLAT * unit, FLAT * unit * 1.1) == pytest.approx(0.01 / 1.01, rel=1e-9)
    assert relative_mse(picture, picture * 1.1, epsilon=0.0) == pytest.approx(0.01, rel=1e-9)


def test_relative_mse_of_black_images():
    black = np.zeros_like(FLAT)
    assert relative_mse(black, black) == 0.0
    with pytest.raises(ValueError, match="reference is black"):
        relative_mse(black, FLAT)


def test_ssim_of_flat_images_is_the_luminance_term():
    """Two flat images have no structure: SSIM = (2ab + C1)/(a² + b² + C1), C1 = 0.01² (Wang et al. 2004)."""
    radiance = 0.5, 0.25
    a, b = (1.055 * value ** (1 / 2.4) - 0.055 for value in radiance)  # IEC 61966-2-1
    expected = (2 * a * b + 1e-4) / (a * a + b * b + 1e-4)
    # Divided by 4: with the exposure of 4, the images shown are the radiances above.
    images = (np.full((16, 16, 3), value / 4) for value in radiance)
    assert ssim(*images, exposure=4.0) == pytest.approx(expected, rel=1e-6)


def test_ssim_bounds(picture):
    assert ssim(picture, picture, exposure=1.0) == pytest.approx(1.0, abs=1e-12)
    assert ssim(picture, 1.0 - picture, exposure=1.0) < 0.0
    assert ssim(picture, picture * 8, exposure=100.0) == pytest.approx(1.0), "both white once shown"


def test_encoding_is_srgb():
    values = np.array([-1.0, 0.0, 0.002, 0.5, 7.0])
    expected = [0.0, 0.0, 12.92 * 0.002, 1.055 * 0.5 ** (1 / 2.4) - 0.055, 1.0]
    np.testing.assert_allclose(encode(values, exposure=1.0), expected, atol=1e-12)


def test_encoding_by_a_power():
    np.testing.assert_allclose(
        encode(np.array([-1.0, 0.0, 0.125, 7.0]), exposure=2.0, gamma=2.0), [0.0, 0.0, 0.5, 1.0], atol=1e-15
    )


@pytest.mark.parametrize("metric", [rmse, relative_mse, lambda a, b: ssim(a, b, exposure=1.0)])
@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.full((16, 12, 3), np.nan), r"image: nan at index \(0, 0, 0\)"),
        (np.full((16, 12, 3), np.inf), "image: inf"),
        (np.ones((12, 16, 3)), "unequal shapes"),
    ],
)
def test_bad_images_are_refused(metric, image, message):
    with pytest.raises(ValueError, match=message):
        metric(FLAT, image)


@pytest.mark.parametrize("exposure", [0.0, -1.0, np.nan, np.inf])
def test_bad_exposure_is_refused(exposure):
    with pytest.raises(ValueError, match="exposure"):
        ssim(FLAT, FLAT, exposure=exposure)


def test_images_too_small_or_empty_are_refused():
    with pytest.raises(ValueError, match="≥ 11"):
        ssim(FLAT[:10], FLAT[:10], exposure=1.0)
    with pytest.raises(ValueError, match="without pixels"):
        rmse(FLAT[:0], FLAT[:0])
