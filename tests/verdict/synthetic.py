"""Synthetic replicates whose limit is known, and a rule's power counted on them."""

import numpy as np

from termwise.reports.statistics.accumulation import measure
from termwise.reports.statistics.rule import decide
from termwise.reports.statistics.verdict import TOLERATED_BIAS

RUN = 600
"""Tests of a run of some 60 rows."""


def replicates(
    rng: np.random.Generator, mean: np.ndarray, count: int = 16, noise: float = 0.3, law: str = "gamma"
) -> np.ndarray:
    """Replicates (count, H, W, 3) float32 of a known mean image (H, W, 3) with unbiased noise.

    `noise` is the relative standard deviation of a pixel, `law` "gamma" or "lognormal".
    """
    # One factor per pixel, shared by the channels as the noise of a light path is.
    shape = (count, *mean.shape[:2], 1)
    if law == "gamma":
        factor = rng.gamma(1 / noise**2, noise**2, shape)
    else:
        sigma = np.sqrt(np.log1p(noise**2))
        factor = rng.lognormal(-(sigma**2) / 2, sigma, shape)
    return (mean * factor).astype(np.float32)


def picture(height: int, width: int, shift: float = 0.0) -> np.ndarray:
    """A smooth positive colour image (H, W, 3), optionally seen `shift` pixels further right.

    Waves of 40 and 90 px: a shift by half a pixel moves a pixel by 1.5 % rms of the mean, and no mean.
    """
    y, x = np.mgrid[:height, :width]
    grey = 1 + 0.4 * np.sin(2 * np.pi * (x + shift) / 40) * np.cos(2 * np.pi * y / 90)
    return grey[..., None] * np.array([1.0, 0.7, 0.4])


def share_found(rng: np.random.Generator, runs: int) -> float:
    """Share of runs of one row that find, in its noisiest channel, exactly the bias that the same run prints."""
    mean = picture(16, 16)
    found = 0
    for _ in range(runs):
        ours, reference = (replicates(rng, mean) for _ in range(2))
        before = decide(measure(ours, reference), tests=RUN).row()
        channel = int(np.argmax([region["detectable_bias"] for region in before["regions"]]))
        scale = reference[..., channel].mean(dtype=np.float64)
        ours = ours.astype(np.float64)
        ours[..., channel] += before["detectable_bias"] * scale
        after = decide(measure(ours, reference.astype(np.float64)), tests=RUN).row()["regions"][channel]
        found += after["family_low"] > TOLERATED_BIAS or after["family_high"] < -TOLERATED_BIAS
    return found / runs
