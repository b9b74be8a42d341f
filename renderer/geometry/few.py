"""Any hit among few triangles, without a tree: 16 at a time in float32, and float64 where that leaves a doubt.

The test is that of `intersect_triangle`. In coordinates in which the scene lies in [-1, 1], R being 1 + the largest
coordinate of the ray's origin and u = 2^-24, its float32 errors are at most (summed up from the roundings):

- 2 u R of a corner relative to the origin, at most R; 7 u R of a sheared one, at most 2 R;
- 68 u R² of an edge function U, V or W, at most 8 R²; 280 u R² of their sum, the determinant;
- 340 u R³ of U z0 + V z1 + W z2, which over the determinant is the hit's depth.

A ray hits for sure where all signs hold beyond these bounds, and misses for sure where one of them is against it; where
neither can be said of a triangle, and no other is hit for sure, there is a doubt. The errors of float64 are far below:
what is sure is what the exact test says. Of shadow rays in the Cornell box 1 in 137 is left in doubt.
"""

import math
from typing import NamedTuple

import numpy as np

from termwise.renderer.geometry.intersect import FaceRange, Ray, component
from termwise.renderer.geometry.simd import (
    bits,
    choose,
    fma,
    fms,
    load,
    magnitude,
    maximum,
    minimum,
    narrow,
    rows,
    splat,
    store,
)
from termwise.renderer.jit import device
from termwise.renderer.memory import on_own_lines
from termwise.renderer.vector import Vec3, entry

LANES = 16
BLOCK = 9 * LANES
# Bits of an integer, less its sign; up to there no tree is faster.
MOST = 63
MISS, HIT, DOUBT = range(3)
_ALL = (1 << LANES) - 1
_UNIT = 2.0**-24
_FAR_AWAY = 2.0**20  # a larger R is left to float64: its cube would overflow


class TriangleList(NamedTuple):
    """Corners (BLOCK B,) float32, `(x - center) scale`, and the number of triangles; nothing where there are many.

    A block has, of each corner and of each of its coordinates, those of 16 triangles.
    """

    corners: np.ndarray
    count: int
    center: Vec3
    scale: float


def few_of(corners: np.ndarray, center: Vec3, scale: float) -> TriangleList:
    """Lay out triangles (F, 3, 3), if they are few."""
    count = len(corners)
    if count > MOST:
        return TriangleList(np.zeros(0, np.float32), count, center, scale)
    blocks = np.zeros((-(-count // LANES), 3, 3, LANES), np.float32)
    for face in range(count):
        blocks[face // LANES, :, :, face % LANES] = (corners[face] - np.array(center)) * scale
    return TriangleList(on_own_lines(blocks.ravel()), count, center, scale)


@device
def _first(count: int) -> int:
    """A set of bits, the first `count`."""
    return (1 << max(count, 0)) - 1


class Query(NamedTuple):
    """A ray for 16 triangles, in the coordinates of `TriangleList` and along its own axes.

    `x, y, z` are the origin, `sx, sy` the shear with its signs turned, `reach` the far end as a depth, `forward` the
    sign of the direction's largest component. `above2, above3` bound the errors of an edge function and of a depth
    times the determinant, `above4` that of its difference from the reach. `kx, ky, kz` are where a block's coordinates
    along the ray's axes begin.
    """

    x: np.float32
    y: np.float32
    z: np.float32
    sx: np.float32
    sy: np.float32
    reach: np.float32
    forward: np.float32
    above2: np.float32
    above3: np.float32
    above4: np.float32
    kx: int
    ky: int
    kz: int


@device
def query(few: TriangleList, ray: Ray, far: float) -> Query:
    """Prepare a ray; float32 cannot hold the bounds of one from far away, which leaves all in doubt."""
    origin = Vec3(
        (ray.origin.x - few.center.x) * few.scale,
        (ray.origin.y - few.center.y) * few.scale,
        (ray.origin.z - few.center.z) * few.scale,
    )
    r = 1.0 + max(abs(origin.x), max(abs(origin.y), abs(origin.z)))
    dz = component(ray.direction, ray.kz)
    # No triangle is deeper than R.
    reach = min(far * abs(dz) * few.scale, 2.0 * r)
    bound2 = 80.0 * _UNIT * r * r if r < _FAR_AWAY else math.inf
    bound3 = 5.0 * bound2 * r
    return Query(
        np.float32(component(origin, ray.kx)),
        np.float32(component(origin, ray.ky)),
        np.float32(component(origin, ray.kz)),
        np.float32(-ray.sx),
        np.float32(-ray.sy),
        np.float32(reach),
        np.float32(math.copysign(1.0, dz)),
        np.float32(bound2),
        np.float32(bound3),
        np.float32(bound3 + 5.0 * bound2 * reach),
        LANES * ray.kx,
        LANES * ray.ky,
        LANES * ray.kz,
    )


@device
def put_queries(
    few: TriangleList, origins: np.ndarray, directions: np.ndarray, far: float, numbers: np.ndarray, axes: np.ndarray
) -> None:
    """Prepare eight rays (3, 8) in as many lanes, as `query` does; `numbers` (10, 8) and `axes` (3, 8) hold them."""
    o, d, scale = rows(origins), rows(directions), splat(few.scale, 8)
    x = (o[0] - splat(few.center.x, 8)) * scale
    y = (o[1] - splat(few.center.y, 8)) * scale
    z = (o[2] - splat(few.center.z, 8)) * scale
    r = splat(1.0, 8) + maximum(magnitude(x), maximum(magnitude(y), magnitude(z)))
    along_y = magnitude(d[1]) > magnitude(d[0])
    main = choose(along_y, d[1], d[0])
    along_z = magnitude(d[2]) > magnitude(main)
    main = choose(along_z, d[2], main)
    size = magnitude(main)
    inverse = splat(-1.0, 8) / main
    reach = minimum(splat(far * few.scale, 8) * size, splat(2.0, 8) * r)
    bound2 = choose(r < splat(_FAR_AWAY, 8), splat(80.0 * _UNIT, 8) * r * r, splat(math.inf, 8))
    bound3 = splat(5.0, 8) * bound2 * r
    # The axes go round, x y z, y z x or z x y, whatever the sign: swapped ones only turn the signs of u, v and w.
    store(numbers, 0, narrow(choose(along_z, x, choose(along_y, z, y))))
    store(numbers, 8, narrow(choose(along_z, y, choose(along_y, x, z))))
    store(numbers, 16, narrow(choose(along_z, z, choose(along_y, y, x))))
    store(numbers, 24, narrow(choose(along_z, d[0], choose(along_y, d[2], d[1])) * inverse))
    store(numbers, 32, narrow(choose(along_z, d[1], choose(along_y, d[0], d[2])) * inverse))
    store(numbers, 40, narrow(reach))
    store(numbers, 48, narrow(main / size))
    store(numbers, 56, narrow(bound2))
    store(numbers, 64, narrow(bound3))
    store(numbers, 72, narrow(bound3 + splat(5.0, 8) * bound2 * reach))
    first, second, third = splat(np.int32(0), 8), splat(np.int32(LANES), 8), splat(np.int32(2 * LANES), 8)
    store(axes, 0, choose(along_z, first, choose(along_y, third, second)))
    store(axes, 8, choose(along_z, second, choose(along_y, first, third)))
    store(axes, 16, choose(along_z, third, choose(along_y, second, first)))


@device
def query_of(numbers: np.ndarray, axes: np.ndarray, i: int) -> Query:
    """Ray i of those that `put_queries` has prepared."""
    return Query(
        numbers[0, i],
        numbers[1, i],
        numbers[2, i],
        numbers[3, i],
        numbers[4, i],
        numbers[5, i],
        numbers[6, i],
        numbers[7, i],
        numbers[8, i],
        numbers[9, i],
        entry(axes[0], i),
        entry(axes[1], i),
        entry(axes[2], i),
    )


@device
def answer(few: TriangleList, q: Query, ignore: FaceRange, target: int) -> int:
    """Whether a face other than `target` and those of `ignore` is hit at 0 < t < far: HIT, MISS or DOUBT."""
    x0, y0, z0 = splat(q.x, 16), splat(q.y, 16), splat(q.z, 16)
    sx, sy = splat(q.sx, 16), splat(q.sy, 16)
    forward, backward = splat(q.forward, 16), splat(-q.forward, 16)
    depth = splat(q.reach, 16)
    zero = splat(np.float32(0.0), 16)
    above2, below2 = splat(q.above2, 16), splat(-q.above2, 16)
    above3, below3 = splat(q.above3, 16), splat(-q.above3, 16)
    above4, below4 = splat(q.above4, 16), splat(-q.above4, 16)
    counts = _first(few.count) & ~(_first(ignore.end) ^ _first(ignore.first))
    if target >= 0:
        counts &= ~(1 << target)
    doubts = 0
    for block in range(len(few.corners) // BLOCK):
        a = block * BLOCK
        b = a + 3 * LANES
        c = b + 3 * LANES
        az = load(few.corners, a + q.kz, 16) - z0
        bz = load(few.corners, b + q.kz, 16) - z0
        cz = load(few.corners, c + q.kz, 16) - z0
        ax = fma(sx, az, load(few.corners, a + q.kx, 16) - x0)
        ay = fma(sy, az, load(few.corners, a + q.ky, 16) - y0)
        bx = fma(sx, bz, load(few.corners, b + q.kx, 16) - x0)
        by = fma(sy, bz, load(few.corners, b + q.ky, 16) - y0)
        cx = fma(sx, cz, load(few.corners, c + q.kx, 16) - x0)
        cy = fma(sy, cz, load(few.corners, c + q.ky, 16) - y0)
        u = fms(cx, by, cy * bx)
        v = fms(ax, cy, ay * cx)
        w = fms(bx, ay, by * ax)
        low = minimum(minimum(u, v), w)
        high = maximum(maximum(u, v), w)
        maybe = (counts >> (LANES * block)) & _ALL & ~bits((low < below2) & (high > above2))
        if maybe == 0:
            continue
        det = u + v + w
        along = fma(u, az, fma(v, bz, w * cz)) * choose(det > zero, forward, backward)
        left = fms(depth, magnitude(det), along)
        inside = (low > above2) | (high < below2)
        if maybe & bits(inside & (along > above3) & (left > above4)) != 0:
            return HIT
        doubts |= maybe & ~bits(inside & ((along < below3) | (left < below4)))
    return MISS if doubts == 0 else DOUBT


@device
def any_hit_of_few(few: TriangleList, ray: Ray, far: float, ignore: FaceRange, target: int) -> int:
    """`answer` to one ray."""
    return answer(few, query(few, ray, far), ignore, target)
