"""Photon map: irradiance from the photons that land near a point, `E(x) = sum_p Phi_p K(|x_p - x|) / M(x)`.

K is a kernel of a radius and M its mass on the faces whose photons are counted (`renderer.kernel_mass`): a constant E
is estimated without bias. Photons of the other side of a surface never count.

Each pass has a map of its own, with the radius of Knaus and Zwicker, "Progressive Photon Mapping: A Probabilistic
Approach", TOG 30(3), 2011: `r²_{i+1} = r²_i (i + 2/3) / (i + 1)`. The mean over passes is biased by O(r²) inside
a surface (`r² ΔE / (4 (p + 2))`: 1/8 for the uniform kernel, 1/12 for Epanechnikov's, 1/16 for Simpson's), by O(r)
along edges and shadow borders, and unbiased as r -> 0; the MSE falls as N^(-2/3) for independent photons. Those of a
map that share a low-discrepancy sequence have less of it, a gain that fades as r shrinks: about N^-0.54 at 40 photons.
"""

import math
from concurrent.futures import Executor
from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike

from termwise.renderer.by_reference import by_reference
from termwise.renderer.jit import device, kernel
from termwise.renderer.kernel_mass import EXPONENTS
from termwise.renderer.memory import aligned
from termwise.renderer.vector import Vec3

_PLACED = 1 << 16  # photons that a thread copies at a time
# Memory for the maps of a replicate that another term may use: 16 passes of the open Cornell box take 75 MB.
KEPT_BYTES = 1 << 28


@by_reference()
class PhotonMap(NamedTuple):
    """Photons sorted by grid cell.

    Attributes
    ----------
    position : (3, P)
    direction : (3, P), unit, back along the photon's path.
    power : (3, P), flux in units of radiance x area.
    face : (P,) int32. Eight entries may be read from any photon on, also from the last one.
    start : (nx ny nz + 1,) int64, first photon of each cell.
    low, cell, nx, ny, nz : corner, edge length and counts of the grid.
    radius, exponent : of the kernel.
    """

    position: np.ndarray
    direction: np.ndarray
    power: np.ndarray
    face: np.ndarray
    start: np.ndarray
    low: Vec3
    cell: float
    nx: int
    ny: int
    nz: int
    radius: float
    exponent: int


def progressive_radius(radius: float, index: int) -> float:
    """Kernel radius of pass `index` (from 0), the first being `radius`."""
    square = radius * radius
    for i in range(1, index + 1):
        square *= (i + 2.0 / 3.0) / (i + 1.0)
    return math.sqrt(square)


def mean_radius(radius: float, passes: int) -> float:
    """Root of the mean r² over the passes: the one radius that has the same bias, as far as it is O(r²)."""
    return math.sqrt(sum(progressive_radius(radius, i) ** 2 for i in range(passes)) / passes)


@kernel
def _bounds(position: np.ndarray, low: np.ndarray, high: np.ndarray) -> None:
    """Widen (3,) `low` and `high` to all positions."""
    for i in range(len(position)):
        for k in range(3):
            low[k] = min(low[k], position[i, k])
            high[k] = max(high[k], position[i, k])


@kernel
def _sort(
    position: np.ndarray, low: Vec3, cell: float, nx: int, ny: int, nz: int, start: np.ndarray, order: np.ndarray
) -> None:
    """Counting sort by cell; photons of one cell keep their order, so the sum over them has one order too."""
    photons = len(position)
    cells = np.empty(photons, np.int64)
    for i in range(photons):
        x = min(nx - 1, max(0, int((position[i, 0] - low.x) / cell)))
        y = min(ny - 1, max(0, int((position[i, 1] - low.y) / cell)))
        z = min(nz - 1, max(0, int((position[i, 2] - low.z) / cell)))
        cells[i] = (np.int64(z) * ny + y) * nx + x
        start[cells[i] + 1] += 1
    for i in range(len(start) - 1):
        start[i + 1] += start[i]
    fill = start[:-1].copy()
    for i in range(photons):
        order[fill[cells[i]]] = i
        fill[cells[i]] += 1


@kernel
def _place(
    order: np.ndarray,
    first: int,
    last: int,
    position: np.ndarray,
    direction: np.ndarray,
    power: np.ndarray,
    face: np.ndarray,
    sorted_position: np.ndarray,
    sorted_direction: np.ndarray,
    sorted_power: np.ndarray,
    sorted_face: np.ndarray,
) -> None:
    """Copy the photons `order[first:last]` to where they belong."""
    for i in range(first, last):
        j = order[i]
        for k in range(3):
            sorted_position[k, i] = position[j, k]
            sorted_direction[k, i] = direction[j, k]
            sorted_power[k, i] = power[j, k]
        sorted_face[i] = face[j]


def _room(*shape: int, dtype: DTypeLike = np.float64) -> np.ndarray:
    """An array behind whose last entry seven more may be read."""
    size = math.prod(shape)
    return aligned(size + 7, dtype)[:size].reshape(shape)


def build(
    position: np.ndarray,
    direction: np.ndarray,
    power: np.ndarray,
    face: np.ndarray,
    radius: float,
    shape: str = "simpson",
    pool: Executor | None = None,
) -> PhotonMap:
    """Sort photons, vectors (P, 3), into a dense grid of cells at least r wide: a query meets at most 27 of them.

    `shape` names the kernel, see EXPONENTS. With `pool` its threads share the copying, most of the work.
    """
    low, extent = np.zeros((2, 3))
    if len(position):  # an empty map compiles nothing
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        _bounds(position, low, high)
        extent = high - low
    # A dense grid needs no hash, so no cell is ever visited twice; at most 8 cells a photon.
    cell = max(radius, float(extent.max()) / 1024.0, 1e-300)
    while True:
        nx, ny, nz = (int(n) + 1 for n in extent / cell)
        if nx * ny * nz <= 8 * len(position) + 64:
            break
        cell *= 1.26  # halves the number of cells
    start = np.zeros(nx * ny * nz + 1, np.int64)
    order = np.empty(len(position), np.int64)
    corner = Vec3(float(low[0]), float(low[1]), float(low[2]))
    photons = position, direction, power, face
    count = len(position)
    placed = _room(3, count), _room(3, count), _room(3, count), _room(count, dtype=np.int32)
    if len(position):
        _sort(position, corner, cell, nx, ny, nz, start, order)
        firsts = range(0, len(order), _PLACED)

        def place(first: int) -> None:
            _place(order, first, min(first + _PLACED, len(order)), *photons, *placed)

        list(pool.map(place, firsts) if pool else map(place, firsts))
    return PhotonMap(
        position=placed[0],
        direction=placed[1],
        power=placed[2],
        face=placed[3],
        start=start,
        low=corner,
        cell=cell,
        nx=nx,
        ny=ny,
        nz=nz,
        radius=radius,
        exponent=EXPONENTS[shape],
    )


def bytes_of(photons: PhotonMap) -> int:
    """Memory of the map's arrays."""
    return sum(array.nbytes for array in photons if isinstance(array, np.ndarray))


def empty(radius: float = 1.0) -> PhotonMap:
    """A map without photons: what a kernel gets where none are needed."""
    return build(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, np.int32), radius)


class Cells(NamedTuple):
    """Cells x0 <= x <= x1, y0 <= y < y1, z0 <= z < z1 of the grid."""

    x0: int
    x1: int
    y0: int
    y1: int
    z0: int
    z1: int


@device
def _cell(position: float, low: float, cell: float, count: int) -> int:
    """Grid index of a coordinate, clamped in floating point: far queries must not overflow an integer."""
    return int(min(max((position - low) / cell, 0.0), count - 1.0))


@device
def cells_within(photons: PhotonMap, x: Vec3, radius: float) -> Cells:
    """The cells that hold all photons within a radius of x."""
    low, cell = photons.low, photons.cell
    return Cells(
        _cell(x.x - radius, low.x, cell, photons.nx),
        _cell(x.x + radius, low.x, cell, photons.nx),
        _cell(x.y - radius, low.y, cell, photons.ny),
        _cell(x.y + radius, low.y, cell, photons.ny) + 1,
        _cell(x.z - radius, low.z, cell, photons.nz),
        _cell(x.z + radius, low.z, cell, photons.nz) + 1,
    )


@device
def range_of(photons: PhotonMap, cells: Cells, y: int, z: int) -> tuple[int, int]:
    """Photons [begin, end) of the cells of a row: these are neighbours in memory."""
    row = (np.int64(z) * photons.ny + y) * photons.nx
    return photons.start[row + cells.x0], photons.start[row + cells.x1 + 1]
