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

from renderer.geometry.intersect import FaceRange, Ray, component
from renderer.geometry.simd import bits, choose, fma, fms, load, magnitude, maximum, minimum, splat
from renderer.jit import device
from renderer.vector import Vec3

LANES = 16
BLOCK = 9 * LANES
# Triangles up to which this is faster than the tree, or as fast: 43 ns a ray in place of 49 in packets (shadows in the
# Cornell box, 38 triangles), 60 in place of 100 in bundles (its ambient occlusion), 59 in place of 64 (48 triangles of
# boxes, strewn), 65 in place of 64 (60).
MOST = 48
MISS, HIT, DOUBT = range(3)
_ALL = (1 << LANES) - 1
_UNIT = 2.0**-24
_FAR_AWAY = 2.0**20  # a larger R is left to float64: its cube would overflow


class Few(NamedTuple):
    """Corners (BLOCK B,) float32, `(x - center) scale`, and the number of triangles; nothing where there are many.

    A block has, of each corner and of each of its coordinates, those of 16 triangles.
    """

    corners: np.ndarray
    count: int
    center: Vec3
    scale: float


def few_of(corners: np.ndarray, center: Vec3, scale: float) -> Few:
    """Lay out triangles (F, 3, 3), if they are few."""
    count = len(corners)
    if count > MOST:
        return Few(np.zeros(0, np.float32), count, center, scale)
    blocks = np.zeros((-(-count // LANES), 3, 3, LANES), np.float32)
    for face in range(count):
        blocks[face // LANES, :, :, face % LANES] = (corners[face] - np.array(center)) * scale
    return Few(blocks.ravel(), count, center, scale)


@device
def _first(count: int) -> int:
    """A set of bits, the first `count`."""
    return (1 << max(count, 0)) - 1


@device
def any_hit_of_few(few: Few, ray: Ray, far: float, ignore: FaceRange, target: int) -> int:
    """Whether a face other than `target` and those of `ignore` is hit at 0 < t < far: HIT, MISS or DOUBT."""
    origin = Vec3(
        (ray.origin.x - few.center.x) * few.scale,
        (ray.origin.y - few.center.y) * few.scale,
        (ray.origin.z - few.center.z) * few.scale,
    )
    r = 1.0 + max(abs(origin.x), max(abs(origin.y), abs(origin.z)))
    if not r < _FAR_AWAY:
        return DOUBT
    dz = component(ray.direction, ray.kz)
    x0 = splat(np.float32(component(origin, ray.kx)), 16)
    y0 = splat(np.float32(component(origin, ray.ky)), 16)
    z0 = splat(np.float32(component(origin, ray.kz)), 16)
    sx = splat(np.float32(-ray.sx), 16)
    sy = splat(np.float32(-ray.sy), 16)
    # No triangle is deeper than R.
    reach = min(far * abs(dz) * few.scale, 2.0 * r)
    bound2 = 80.0 * _UNIT * r * r
    bound3 = 400.0 * _UNIT * r * r * r
    forward = splat(np.float32(math.copysign(1.0, dz)), 16)
    backward = splat(np.float32(-math.copysign(1.0, dz)), 16)
    depth = splat(np.float32(reach), 16)
    zero = splat(np.float32(0.0), 16)
    above2 = splat(np.float32(bound2), 16)
    below2 = splat(np.float32(-bound2), 16)
    above3 = splat(np.float32(bound3), 16)
    below3 = splat(np.float32(-bound3), 16)
    above4 = splat(np.float32(bound3 + 5.0 * bound2 * reach), 16)
    below4 = splat(np.float32(-(bound3 + 5.0 * bound2 * reach)), 16)
    kx = LANES * ray.kx
    ky = LANES * ray.ky
    kz = LANES * ray.kz
    counts = _first(few.count) & ~(_first(ignore.end) ^ _first(ignore.first))
    if target >= 0:
        counts &= ~(1 << target)
    doubts = 0
    for block in range(len(few.corners) // BLOCK):
        a = block * BLOCK
        b = a + 3 * LANES
        c = b + 3 * LANES
        az = load(few.corners, a + kz, 16) - z0
        bz = load(few.corners, b + kz, 16) - z0
        cz = load(few.corners, c + kz, 16) - z0
        ax = fma(sx, az, load(few.corners, a + kx, 16) - x0)
        ay = fma(sy, az, load(few.corners, a + ky, 16) - y0)
        bx = fma(sx, bz, load(few.corners, b + kx, 16) - x0)
        by = fma(sy, bz, load(few.corners, b + ky, 16) - y0)
        cx = fma(sx, cz, load(few.corners, c + kx, 16) - x0)
        cy = fma(sy, cz, load(few.corners, c + ky, 16) - y0)
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
