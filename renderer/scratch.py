"""What one call of a kernel works in: the stack of the descents, waves of rays, counts of the work it has done.

Counts are summed over the tiles of a run. They prove a skip: what a scene does not need is counted as zero.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike

from termwise.renderer.by_reference import by_reference
from termwise.renderer.geometry.bvh import STACK_SIZE
from termwise.renderer.geometry.wave import SIZE, Wave, new_wave
from termwise.renderer.memory import aligned, on_own_lines

# Rays that ask for the nearest hit, rays that ask for any hit, photons traced, estimates of density by photons.
COUNTERS = ("rays", "occlusion rays", "photons", "density estimates")
RAYS, OCCLUSION_RAYS, PHOTONS, DENSITY_ESTIMATES = range(len(COUNTERS))


@by_reference(point=(SIZE,), normal=(SIZE,), way=(SIZE,), irradiance=(SIZE,))
class LightSamples(NamedTuple):
    """Points that ask for light, and one sample of it for each.

    Attributes
    ----------
    point, normal : (3, 64) float64 each.
    face : (64,) int32, the face that each point is on.
    u, v : (64,) float64 each, the sample.
    way : (3, 64) float64, to the point of the light.
    irradiance : (3, 64) float64, E / pi, black where no light can come from.
    target : (64,) int32, the face of the light, -1 for none.
    weight, b1, b2 : (64,) float64 each, scratch.
    """

    point: np.ndarray
    normal: np.ndarray
    face: np.ndarray
    u: np.ndarray
    v: np.ndarray
    way: np.ndarray
    irradiance: np.ndarray
    target: np.ndarray
    weight: np.ndarray
    b1: np.ndarray
    b2: np.ndarray


def _new_light_samples() -> LightSamples:
    three, one, face = np.zeros((3, SIZE)), np.zeros(SIZE), np.zeros(SIZE, np.int32)
    arrays = three, three, face, one, one, three, three, face, one, one, one
    return LightSamples(*map(on_own_lines, arrays))


@by_reference(radiance=(SIZE,), weight=(SIZE,), front=(SIZE,), words=(SIZE,), lanes=(8,))
class Scratch(NamedTuple):
    """Memory of one thread.

    Attributes
    ----------
    stack : int32, STACK_SIZE.
    counts : int64, one of each of COUNTERS, only ever added to.
    primary : the rays through a pixel and what they meet.
    x, y, pixel, index : (64,) each, int64 but for the uint64 of `pixel`: of each primary hit the pixel's column and
        row, the key of the pixel's randomness, and its number within the pixel.
    column, row : (64,) int64 each, the pixel of each that waits: of a primary hit, or of a light sample.
    radiance, weight : (3, 64) float64, what it receives, and by what that, or a ray's light, is multiplied.
    front : (3, 64) float64, what arrives at the front of a translucent surface.
    side : (64,) float64, the side of its face on which a ray has met each surface whose point is in `samples`.
    number, asks : (64,) int64 and bool, how many samples a primary hit is for, and whether they have rays.
    rays : the occlusion rays; `lane` (64,) int32 is the light sample of each, `share` (64,) float64 the translucency
        where it begins, or the share of the side that a light sample is of.
    key, sample : (64,) uint64 and uint32, the randomness of each occlusion ray.
    u, v : (64,) float64 each, points of the unit square: of the camera rays, then of what leaves their hits.
    words : (4, 64) uint32 scratch of `draw_2d`.
    samples : points that ask for light.
    lanes : (4, 8) float64 scratch of `photon_density`.
    """

    stack: np.ndarray
    counts: np.ndarray
    primary: Wave
    x: np.ndarray
    y: np.ndarray
    pixel: np.ndarray
    index: np.ndarray
    column: np.ndarray
    row: np.ndarray
    radiance: np.ndarray
    weight: np.ndarray
    front: np.ndarray
    side: np.ndarray
    number: np.ndarray
    asks: np.ndarray
    rays: Wave
    lane: np.ndarray
    share: np.ndarray
    key: np.ndarray
    sample: np.ndarray
    u: np.ndarray
    v: np.ndarray
    words: np.ndarray
    samples: LightSamples
    lanes: np.ndarray


def _zeros(shape: int | tuple[int, ...], dtype: DTypeLike = np.float64) -> np.ndarray:
    return on_own_lines(np.zeros(shape, dtype))


def new_scratch() -> Scratch:
    """Make scratch for one thread, with nothing done yet."""
    return Scratch(
        aligned(STACK_SIZE, np.int32),
        _zeros(len(COUNTERS), np.int64),
        new_wave(),
        _zeros(SIZE, np.int64),
        _zeros(SIZE, np.int64),
        _zeros(SIZE, np.uint64),
        _zeros(SIZE, np.int64),
        _zeros(SIZE, np.int64),
        _zeros(SIZE, np.int64),
        _zeros((3, SIZE)),
        _zeros((3, SIZE)),
        _zeros((3, SIZE)),
        _zeros(SIZE),
        _zeros(SIZE, np.int64),
        _zeros(SIZE, np.bool_),
        new_wave(),
        _zeros(SIZE, np.int32),
        _zeros(SIZE),
        _zeros(SIZE, np.uint64),
        _zeros(SIZE, np.uint32),
        _zeros(SIZE),
        _zeros(SIZE),
        _zeros((4, SIZE), np.uint32),
        _new_light_samples(),
        _zeros((4, 8)),
    )
