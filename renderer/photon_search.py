"""The k nearest photons: `E(x) = scale sum_{p <= k} Phi_p / (pi r_k²)`, r_k the distance of the k-th.

For n photons that land independently and uniformly `1 / (pi r_k²)` has the mean n / (k - 1) per unit of area, exactly,
while the disc lies within the surface: with scale 1 (paper) the estimate is too bright by k / (k - 1), with
`scale = (k - 1) / k` it is unbiased. Where E varies, both are blurred over r_k, which depends on the photons.
Jensen, "Global Illumination using Photon Maps", 1996; Garcia, Ureña, Sbert, "Unreported Intrinsic Bias of the k-th
Nearest Neighbour Density Estimator", CGF 31(1), 2012.
"""

import math

import numpy as np

from termwise.renderer.jit import device
from termwise.renderer.photon_map import PhotonMap, cells_within, range_of
from termwise.renderer.surface import Surface
from termwise.renderer.vector import Vec3, column, dot, sub


@device
def nearest_irradiance(
    photons: PhotonMap, surface: Surface, nearest: int, heap: np.ndarray, chosen: np.ndarray
) -> Vec3:
    """E of scale 1 by the k nearest photons in front of the surface, on whatever object they lie (paper).

    Where fewer than k lie in front: all of them over the disc of the farthest, which says nothing of E there; black
    where there is none. `heap` (float64) and `chosen` (int64) are scratch of at least k entries.
    """
    total = len(photons.face)
    if total == 0:
        return Vec3(0.0, 0.0, 0.0)
    x = surface.point
    widest = photons.cell * (photons.nx + photons.ny + photons.nz)
    reach_x = abs(x.x - photons.low.x)
    reach_y = abs(x.y - photons.low.y)
    reach_z = abs(x.z - photons.low.z)
    widest += reach_x + reach_y + reach_z
    radius = photons.radius
    count = 0
    while True:
        count = 0
        cells = cells_within(photons, x, radius)
        for z in range(cells.z0, cells.z1):
            for y in range(cells.y0, cells.y1):
                begin, end = range_of(photons, cells, y, z)
                for p in range(begin, end):
                    offset = sub(column(photons.position, p), x)
                    square = dot(offset, offset)
                    if square > radius * radius or dot(column(photons.direction, p), surface.normal) <= 0.0:
                        continue
                    if count < nearest:
                        _sift_up(heap, chosen, count, square, p)
                        count += 1
                    elif square < heap[0]:
                        _sift_down(heap, chosen, nearest, square, p)
        if count == nearest or radius > widest:
            break
        radius *= 2.0
    if count == 0:
        return Vec3(0.0, 0.0, 0.0)
    red = 0.0
    green = 0.0
    blue = 0.0
    for i in range(count):
        red += photons.power[0, chosen[i]]
        green += photons.power[1, chosen[i]]
        blue += photons.power[2, chosen[i]]
    norm = 1.0 / (math.pi * heap[0])
    return Vec3(red * norm, green * norm, blue * norm)


@device
def _sift_up(heap: np.ndarray, chosen: np.ndarray, i: int, square: float, photon: int) -> None:
    """Add an entry to a heap whose root is the farthest photon."""
    while i > 0:
        parent = (i - 1) // 2
        if heap[parent] >= square:
            break
        heap[i] = heap[parent]
        chosen[i] = chosen[parent]
        i = parent
    heap[i] = square
    chosen[i] = photon


@device
def _sift_down(heap: np.ndarray, chosen: np.ndarray, size: int, square: float, photon: int) -> None:
    """Replace the farthest photon."""
    i = 0
    while True:
        child = 2 * i + 1
        if child >= size:
            break
        if child + 1 < size and heap[child + 1] > heap[child]:
            child += 1
        if heap[child] <= square:
            break
        heap[i] = heap[child]
        chosen[i] = chosen[child]
        i = child
    heap[i] = square
    chosen[i] = photon
