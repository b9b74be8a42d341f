"""Counts: N samples of the mean pixel, and of each as its contrast asks, powers of two times N.

With a variance v of one sample and `sum n` samples to spend, the mean square error `sum v / n` is least for
`n ~ sqrt(v)` (Neyman, 1934). v is read off one image whose rays go through the corners of the pixels, two samples each,
with numbers that are the same for every seed: nothing that a mean is made of decides, so that none is biased, whatever
the contrast misses (Kirk, Arvo, "Unbiased Sampling Techniques for Image Synthesis", SIGGRAPH 1991).
"""

import bisect
import math
from typing import NamedTuple

import numpy as np

from termwise.renderer.arrays import CameraArrays
from termwise.renderer.camera import CORNER
from termwise.renderer.film import ALONE
from termwise.renderer.jit import kernel
from termwise.renderer.vector import Vec3

# Samples at a corner. Their mean tells an edge from what is but noise, which low-discrepancy points soon remove.
AT_CORNERS = 2
# Samples that each pixel gets: up to so many, all get the same.
LEAST = ALONE
# A quarter of N guards what the corners have missed.
_LOWEST, _HIGHEST = -2, 4
# Logarithms of deviations are counted in sixteenths, 2^-16 to 2^16 of their mean.
_STEPS, _MOST = 16, 256
_STEADY = 0.2  # of the mean deviation, added to each: four corners that are alike by chance


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


@kernel
def scatter(corners: np.ndarray, wanted: np.ndarray, variance: np.ndarray, deviation: np.ndarray) -> None:
    """Deviation of the pixels (H, W) by the image at their corners (H + 1, W + 1, 3).

    Its square is the variance among a pixel's four corners, of all channels, and the mean of those in the 5 x 5 pixels
    around, in which lights of some area were sampled 72 times. `variance` (H + 4, W + 4) is scratch, all 0; that of
    pixels that are not wanted stays 0.
    """
    height, width = wanted.shape
    for y in range(height):
        for x in range(width):
            if wanted[y, x]:
                square = 0.0
                for k in range(3):
                    a, b, c, d = corners[y, x, k], corners[y, x + 1, k], corners[y + 1, x, k], corners[y + 1, x + 1, k]
                    mean = 0.25 * ((a + b) + (c + d))  # of four that are equal exactly theirs
                    square += (a - mean) ** 2 + (b - mean) ** 2 + (c - mean) ** 2 + (d - mean) ** 2
                variance[y + 2, x + 2] = square / 3.0
    for y in range(height):
        for x in range(width):
            around = 0.0
            for row in range(5):
                for column in range(5):
                    around += variance[y + row, x + column]
            deviation[y, x] = math.sqrt(variance[y + 2, x + 2] + around / 25.0)


def contrast(corners: np.ndarray, wanted: np.ndarray) -> Contrast | None:
    """Contrast of the wanted pixels (H, W) bool, of the image at all corners (H + 1, W + 1, 3).

    None where there is none, or where it is beyond all numbers.
    """
    height, width = wanted.shape
    deviation = np.empty(wanted.shape)
    scatter(corners, wanted, np.zeros((height + 4, width + 4)), deviation)
    deviation = deviation[wanted]
    if not 0.0 < deviation.sum() < math.inf:
        return None
    deviation[deviation > 0.0] += _STEADY * deviation.mean()
    with np.errstate(divide="ignore"):
        level = np.log2(deviation / deviation.mean())
    return Contrast(wanted, np.rint(_STEPS * np.clip(level, -16.0, 16.0)).astype(np.int64) + _MOST)


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
