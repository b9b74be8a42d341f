"""Synthetic replicates whose limit is known."""

from collections.abc import Callable

import numpy as np
import pytest

Replicates = Callable[..., np.ndarray]


@pytest.fixture
def replicates() -> Replicates:
    """A function: replicates (count, H, W, 3) of a known mean image with unbiased noise."""

    def make(
        rng: np.random.Generator, mean: np.ndarray, count: int = 16, noise: float = 0.3, law: str = "gamma"
    ) -> np.ndarray:
        # One factor per pixel, shared by the channels as the noise of a light path is.
        shape = (count, *mean.shape[:2], 1)
        if law == "gamma":
            factor = rng.gamma(1 / noise**2, noise**2, shape)
        else:
            sigma = np.sqrt(np.log1p(noise**2))
            factor = rng.lognormal(-(sigma**2) / 2, sigma, shape)
        return (mean * factor).astype(np.float32)

    return make


@pytest.fixture
def picture() -> Callable[..., np.ndarray]:
    """A function: a smooth positive colour image (H, W, 3), optionally seen `shift` pixels further right.

    Waves of 40 and 90 px: a shift by half a pixel moves a pixel by 1.5 % rms of the mean, and no mean.
    """

    def make(height: int, width: int, shift: float = 0.0) -> np.ndarray:
        y, x = np.mgrid[:height, :width]
        grey = 1 + 0.4 * np.sin(2 * np.pi * (x + shift) / 40) * np.cos(2 * np.pi * y / 90)
        return grey[..., None] * np.array([1.0, 0.7, 0.4])

    return make
