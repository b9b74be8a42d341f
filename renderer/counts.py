"""Counts: N samples of the mean pixel, and of each as its contrast asks, powers of two times N.

With a variance v of one sample and `sum n` samples to spend, the mean square error `sum v / n` is least for
`n ~ sqrt(v)` (Neyman, 1934). v is read off one image whose rays go through the corners of the pixels, one sample each,
with numbers that are the same for every seed: nothing that a mean is made of decides, so that none is biased, whatever
the contrast misses (Kirk, Arvo, "Unbiased Sampling Techniques for Image Synthesis", SIGGRAPH 1991).
"""

import math
from typing import NamedTuple

import numpy as np

from termwise.renderer.arrays import CameraArrays, SceneArrays
from termwise.renderer.camera import CORNER
from termwise.renderer.jit import device, kernel
from termwise.renderer.vector import Vec3

# Samples that each pixel gets: up to so many, all get the same. Where few pixels hold the noise, what the corners cost
# is soon won back, elsewhere not by 8 samples. The corners of a coarse image tell which it is.
LEAST_FEW, LEAST_MANY = 2, 8
_COARSE = 64  # the most pixels of its sides
# (sum d)² / (P sum d²) of the deviations d of its P pixels: the part of the noise of even counts that is left at best.
_FEW = 0.5
# A quarter of N guards what the corners have missed.
_LOWEST, _HIGHEST = -2, 4
# Logarithms of deviations are counted in sixteenths, 2^-16 to 2^16 of their mean.
_STEPS, _MOST = 16, 256
UNWANTED = 2 * _MOST + 1
_STEADY = 0.2  # of the mean deviation, added to each: four corners that are alike by chance


class Contrast(NamedTuple):
    """How much pixels vary.

    Attributes
    ----------
    level : (H, W) int64, `log2` of the deviation over the mean one in sixteenths, from 0, that of 2^-16, on; UNWANTED
        of the pixels that it is not about: what those see is known.
    pixels : (UNWANTED + 1,) int64, how many have each level.
    """

    level: np.ndarray
    pixels: np.ndarray


class Corners(NamedTuple):
    """The corners of an image's pixels.

    Attributes
    ----------
    arrays : the scene whose camera sees them, a pixel each.
    wanted : (H, W) bool, the pixels that may see something.
    items : of `film.Work`, the tiles of their corners.
    """

    arrays: SceneArrays
    wanted: np.ndarray
    items: np.ndarray


def corner_camera(camera: CameraArrays, columns: int, rows: int) -> CameraArrays:
    """The camera whose pixels' rays go through the corners of so many pixels of this one's image, one more a side."""
    across = Vec3(*(each * (camera.width / columns) for each in camera.across))
    down = Vec3(*(each * (camera.height / rows) for each in camera.down))
    return CameraArrays(camera.position, camera.corner, across, down, columns + 1, rows + 1, CORNER)


def corners_of(wanted: np.ndarray) -> np.ndarray:
    """Corners (H + 1, W + 1) bool of the wanted pixels (H, W) bool."""
    padded = np.pad(wanted, 1)
    return padded[1:, 1:] | padded[1:, :-1] | padded[:-1, 1:] | padded[:-1, :-1]


def coarse(wanted: np.ndarray) -> np.ndarray:
    """Pixels of a coarse image in which some of the wanted ones (H, W) bool lie."""
    for axis, size in enumerate(wanted.shape):
        few = min(size, _COARSE)
        wanted = np.logical_or.reduceat(wanted, np.arange(few) * size // few, axis=axis)
    return wanted


@kernel
def scatter(
    corners: np.ndarray,
    wanted: np.ndarray,
    square: np.ndarray,
    variance: np.ndarray,
    across: np.ndarray,
    deviation: np.ndarray,
) -> None:
    """Put the deviation of the pixels, by the image at their corners (H + 1, 3 W + 3), into `deviation` (H, W).

    Its square is the variance among a pixel's four corners, of all channels, and the mean of those in the 5 x 5 pixels
    around, in which lights of some area were sampled 36 times. Pixels that are not wanted have none. `square` (3 W,),
    `variance` (H + 4, W + 4), all 0, and `across` (H + 4, W) are scratch.
    """
    height, width = wanted.shape
    for y in range(height):
        for i in range(3 * width):
            a, b, c, d = corners[y, i], corners[y, i + 3], corners[y + 1, i], corners[y + 1, i + 3]
            mean = 0.25 * ((a + b) + (c + d))  # of four that are equal exactly theirs
            square[i] = (a - mean) ** 2 + (b - mean) ** 2 + (c - mean) ** 2 + (d - mean) ** 2
        for x in range(width):
            if wanted[y, x]:
                variance[y + 2, x + 2] = (square[3 * x] + square[3 * x + 1] + square[3 * x + 2]) / 3.0
    for y in range(height + 4):
        row = variance[y]
        for x in range(width):
            across[y, x] = (row[x] + row[x + 1]) + row[x + 2] + (row[x + 3] + row[x + 4])
    for y in range(height):
        for x in range(width):
            around = (across[y, x] + across[y + 1, x]) + across[y + 2, x] + (across[y + 3, x] + across[y + 4, x])
            found = math.sqrt(variance[y + 2, x + 2] + around / 25.0)
            deviation[y, x] = found if wanted[y, x] else 0.0


@kernel
def grade(logarithm: np.ndarray, wanted: np.ndarray, level: np.ndarray, pixels: np.ndarray) -> None:
    """Put the levels of logarithms of deviations (H, W) and how many pixels have each into `Contrast`'s two arrays."""
    height, width = wanted.shape
    for y in range(height):
        for x in range(width):
            found = round(_STEPS * min(max(logarithm[y, x], -_MOST / _STEPS), _MOST / _STEPS)) + _MOST
            level[y, x] = found if wanted[y, x] else UNWANTED
    for y in range(height):
        for x in range(width):
            pixels[level[y, x]] += 1


def prepare(height: int, width: int) -> tuple[np.ndarray, ...]:
    """Arrays that `scatter` takes for an image of this size: at first corners and wanted pixels, none."""
    return (
        np.zeros((height + 1, 3 * width + 3)),
        np.zeros((height, width), np.bool_),
        np.empty(3 * width),
        np.zeros((height + 4, width + 4)),
        np.empty((height + 4, width)),
        np.empty((height, width)),
    )


def _deviation(corners: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    height, width = wanted.shape
    _, _, *scratch, deviation = prepare(height, width)
    scatter(corners.reshape(height + 1, -1), wanted, *scratch, deviation)
    return deviation


def least(corners: np.ndarray, wanted: np.ndarray) -> int:
    """Up to how many samples all pixels get the same, by the image at the corners of a coarse one; see `contrast`."""
    deviation = _deviation(corners, wanted)
    # What is beyond all numbers is in no few pixels.
    with np.errstate(over="ignore", invalid="ignore"):
        few = np.sum(deviation) ** 2 < _FEW * np.count_nonzero(wanted) * np.sum(deviation**2)
    return LEAST_FEW if few else LEAST_MANY


def contrast(corners: np.ndarray, wanted: np.ndarray) -> Contrast | None:
    """Contrast of the wanted pixels (H, W) bool, of the image at all corners (H + 1, W + 1, 3).

    None where there is none, or where it is beyond all numbers.
    """
    deviation = _deviation(corners, wanted)
    total = deviation.sum()
    if not 0.0 < total < math.inf:
        return None
    varies = deviation > 0.0
    count = np.count_nonzero(wanted)
    steady = _STEADY * total / count
    deviation += steady * varies
    deviation *= count / (total + steady * np.count_nonzero(varies))
    with np.errstate(divide="ignore"):
        logarithm = np.log2(deviation, out=deviation)
    found = Contrast(np.empty(wanted.shape, np.int64), np.zeros(UNWANTED + 1, np.int64))
    grade(logarithm, wanted, *found)
    return found


@device
def _taken(level: int, shift: int, samples: int, fewest: int) -> float:
    """Samples of a pixel of a level, before they are rounded down."""
    power = min(max((level - _MOST + shift + _STEPS // 2) // _STEPS, _LOWEST), _HIGHEST)
    return max(float(fewest), samples * 2.0**power)


@kernel
def spend(level: np.ndarray, pixels: np.ndarray, samples: int, fewest: int, each: np.ndarray) -> None:
    """Put into `each` (H, W) int32 what `counts` says."""
    budget = samples * pixels[:UNWANTED].sum()
    # The least leaves what does not vary at the lowest power, and is always affordable.
    affordable, beyond = -2 * _MOST, _MOST + _LOWEST * _STEPS
    while beyond - affordable > 1:
        shift = (affordable + beyond) // 2
        spent = 0.0
        for k in range(UNWANTED):
            spent += pixels[k] * _taken(k, shift, samples, fewest)
        if spent <= budget:
            affordable = shift
        else:
            beyond = shift
    for y in range(each.shape[0]):
        for x in range(each.shape[1]):
            known = level[y, x] == UNWANTED
            each[y, x] = samples if known else int(_taken(level[y, x], affordable, samples, fewest))


def counts(found: Contrast, samples: int, fewest: int) -> np.ndarray:
    """Samples of each pixel, (H, W) int32: `samples` of the mean wanted one or fewer, and of all others.

    Each gets `fewest`, below `samples`, at least.
    Of none they are fewer for more `samples`: a factor that spends no more than n spends no more than any N above it.
    """
    each = np.empty(found.level.shape, np.int32)
    spend(found.level, found.pixels, samples, fewest, each)
    return each
