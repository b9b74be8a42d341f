"""Counts: N samples of the mean pixel, and of each as its contrast asks, powers of two times N.

With a variance v of one sample and `sum n` samples to spend, the mean square error `sum v / n` is least for
`n ~ sqrt(v)` (Neyman, 1934). v is read off one image whose rays go through the corners of the pixels, one sample each,
with numbers that are the same for every seed: nothing that a mean is made of decides, so that none is biased, whatever
the contrast misses (Kirk, Arvo, "Unbiased Sampling Techniques for Image Synthesis", SIGGRAPH 1991).
"""

import bisect
from typing import NamedTuple

import numpy as np

from termwise.renderer.arrays import CameraArrays
from termwise.renderer.camera import CORNER
from termwise.renderer.film import ALONE
from termwise.renderer.vector import Vec3

# Samples that each pixel gets: up to so many, all get the same.
LEAST = ALONE
# A quarter of N guards what the corners have missed.
_LOWEST, _HIGHEST = -2, 4
# Logarithms of deviations are counted in sixteenths, 2^-16 to 2^16 of their mean.
_STEPS, _MOST = 16, 256
_AROUND = 5  # pixels of a side, whose mean contrast steadies that of four corners


class Contrast(NamedTuple):
    """How much pixels vary.

    Attributes
    ----------
    wanted : (H, W) bool, the P pixels it is about: what the others see is known.
    level : (P,) int64, `log2` of the deviation over the mean one in sixteenths, from 0, that of 2^-16, on.
    """

    wanted: np.ndarray
    level: np.ndarray


def corner_camera(camera: CameraArrays) -> CameraArrays:
    """The camera whose pixels' rays go through the corners of this one's, one more a side."""
    width, height = camera.width + 1, camera.height + 1
    across = Vec3(*(each * (width / camera.width) for each in camera.across))
    down = Vec3(*(each * (height / camera.height) for each in camera.down))
    return CameraArrays(camera.position, camera.corner, across, down, width, height, CORNER)


def corners_of(wanted: np.ndarray) -> np.ndarray:
    """Corners (H + 1, W + 1) bool of the wanted pixels (H, W) bool."""
    padded = np.pad(wanted, 1)
    return padded[1:, 1:] | padded[1:, :-1] | padded[:-1, 1:] | padded[:-1, :-1]


def contrast(corners: np.ndarray, wanted: np.ndarray) -> Contrast | None:
    """Contrast of the wanted pixels (H, W) bool, of the image at all corners (H + 1, W + 1, 3); None: there is none.

    The variance among a pixel's four corners, and the mean of those in the 5 x 5 pixels around, in which lights of some
    area were sampled 36 times.
    """
    peak = np.abs(corners).max()
    if not 0.0 < peak < np.inf:
        return None
    variance = np.where(wanted, _variance(corners / peak), 0.0)
    height, width = wanted.shape
    padded = np.pad(variance, _AROUND // 2)
    rows = sum(padded[k : k + height] for k in range(_AROUND))
    around = sum(rows[:, k : k + width] for k in range(_AROUND)) / _AROUND**2
    deviation = np.sqrt(variance + around)[wanted]
    if not deviation.any():
        return None
    with np.errstate(divide="ignore"):
        level = np.log2(deviation / deviation.mean())
    return Contrast(wanted, np.rint(_STEPS * np.clip(level, -16.0, 16.0)).astype(np.int64) + _MOST)


def _variance(corners: np.ndarray) -> np.ndarray:
    """Variance among the four corners of each pixel, summed over channels: by the six differences."""
    # Channel by channel: sums over an axis of three take ten times as long.
    return sum(_variance_of(np.ascontiguousarray(corners[:, :, k])) for k in range(3))


def _variance_of(corners: np.ndarray) -> np.ndarray:
    across, down = (corners[:, 1:] - corners[:, :-1]) ** 2, (corners[1:] - corners[:-1]) ** 2
    diagonals = (corners[1:, 1:] - corners[:-1, :-1]) ** 2 + (corners[1:, :-1] - corners[:-1, 1:]) ** 2
    return (across[1:] + across[:-1] + down[:, 1:] + down[:, :-1] + diagonals) / 12.0


def counts(found: Contrast, samples: int) -> np.ndarray:
    """Samples of each wanted pixel, (P,) int32: `samples`, above LEAST, of the mean pixel, or fewer.

    Of none they are fewer for more `samples`: a factor that spends no more than n spends no more than any N above it.
    """
    pixels = np.bincount(found.level, minlength=2 * _MOST + 1)
    levels = np.arange(-_MOST, _MOST + 1)

    def taken(shift: int) -> np.ndarray:
        power = np.clip((levels + shift + _STEPS // 2) // _STEPS, _LOWEST, _HIGHEST)
        return np.maximum(LEAST, samples * 2.0**power)

    # The greatest leaves what does not vary at the lowest power.
    shifts = range(-2 * _MOST, _MOST + _LOWEST * _STEPS)
    affordable = bisect.bisect_right(shifts, samples * len(found.level), key=lambda shift: pixels @ taken(shift))
    return taken(shifts[affordable - 1]).astype(np.int32)[found.level]
