"""What one call of a kernel works in: the stack of the descents, groups of rays, counts of the work it has done.

Counts are summed over the tiles of a run. They prove a skip: what a scene does not need is counted as zero.
"""

from typing import NamedTuple

import numpy as np

from renderer.geometry.bvh import STACK_SIZE
from renderer.geometry.packets import SIZE, Group, new_group

# Rays that ask for the nearest hit, rays that ask for any hit, photons traced, estimates of density by photons.
COUNTERS = ("rays", "occlusion rays", "photons", "density estimates")
RAYS, OCCLUSION_RAYS, PHOTONS, DENSITY_ESTIMATES = range(len(COUNTERS))


class Scratch(NamedTuple):
    """Memory of one thread.

    Attributes
    ----------
    stack : int32, STACK_SIZE.
    counts : int64, one of each of COUNTERS, only ever added to.
    sights : the rays through a pixel and what they see.
    x, index : (8,) int64 each, the pixel's column and the sample's number of each sight.
    rays : the occlusion rays that leave what is seen; `lane` (8,) int64 is the sight of each.
    radiance : (8, 3) float64, of each sight.
    """

    stack: np.ndarray
    counts: np.ndarray
    sights: Group
    x: np.ndarray
    index: np.ndarray
    rays: Group
    lane: np.ndarray
    radiance: np.ndarray


def new_scratch() -> Scratch:
    """Make scratch for one thread, with nothing done yet."""
    return Scratch(
        np.empty(STACK_SIZE, np.int32),
        np.zeros(len(COUNTERS), np.int64),
        new_group(),
        np.zeros(SIZE, np.int64),
        np.zeros(SIZE, np.int64),
        new_group(),
        np.zeros(SIZE, np.int64),
        np.zeros((SIZE, 3)),
    )
