"""What one call of a kernel works in: the stack of the descents, and the counts of the work it has done.

Counts are summed over the tiles of a run. They prove a skip: what a scene does not need is counted as zero.
"""

from typing import NamedTuple

import numpy as np

from renderer.geometry.bvh import STACK_SIZE

# Rays that ask for the nearest hit, rays that ask for any hit, photons traced, estimates of density by photons.
COUNTERS = ("rays", "occlusion rays", "photons", "density estimates")
RAYS, OCCLUSION_RAYS, PHOTONS, DENSITY_ESTIMATES = range(len(COUNTERS))


class Scratch(NamedTuple):
    """`stack` is int32 scratch of STACK_SIZE; `counts` int64, one of each of COUNTERS, only ever added to."""

    stack: np.ndarray
    counts: np.ndarray


def new_scratch() -> Scratch:
    """Make scratch for one thread, with nothing done yet."""
    return Scratch(np.empty(STACK_SIZE, np.int32), np.zeros(len(COUNTERS), np.int64))
