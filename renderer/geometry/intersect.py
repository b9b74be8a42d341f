"""Watertight ray/triangle intersection in float64.

Woop, Benthin, Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013: shear the triangle so that the ray is the
z axis; the hit is inside where the three scaled edge functions U, V, W have one sign, and `t = (U z0 + V z1 + W z2) /
(U + V + W)`. Edges that two triangles share get the same edge function, so no ray slips between them. Where a corner
lies on a longer edge (a T-junction), the functions differ by their roundings: a sign counts only beyond 2^-48 |U + V +
W|, in the manner of Embree's robust test. Both sides of a triangle are hit. A triangle without area is never hit.
"""

import math
from typing import NamedTuple

import numpy as np

from termwise.renderer.jit import device
from termwise.renderer.vector import Vec3


class Ray(NamedTuple):
    """A ray, with the reciprocals for boxes and the shear for triangles.

    `kx, ky, kz` are the axes after permutation (kz: where |direction| is largest), `sx, sy, sz` the shear.
    """

    origin: Vec3
    direction: Vec3
    inverse: Vec3
    kx: int
    ky: int
    kz: int
    sx: float
    sy: float
    sz: float


class Hit(NamedTuple):
    """Distance in units of |direction|, face (-1: none) and barycentric weights of its corners 1 and 2."""

    t: float
    face: int
    b1: float
    b2: float


class FaceRange(NamedTuple):
    """Faces first <= face < end: those that a ray passes because it leaves them."""

    first: int
    end: int


NOTHING = FaceRange(-1, 0)
EDGE_SLACK = 2.0**-48
"""32 roundings of a coordinate as large as the triangle."""


@device
def component(v: Vec3, axis: int) -> float:
    """Component 0, 1 or 2."""
    if axis == 0:
        return v.x
    if axis == 1:
        return v.y
    return v.z


@device
def reciprocal(x: float) -> float:
    """1 / x with 1 / ±0 = ±inf, compiled or not."""
    if x == 0.0:
        return math.copysign(math.inf, x)
    return 1.0 / x


@device
def make_ray(origin: Vec3, direction: Vec3) -> Ray:
    """Prepare a ray; the direction need not be normalised."""
    kz = 0
    if abs(direction.y) > abs(component(direction, kz)):
        kz = 1
    if abs(direction.z) > abs(component(direction, kz)):
        kz = 2
    kx = (kz + 1) % 3
    ky = (kx + 1) % 3
    if component(direction, kz) < 0.0:
        kx, ky = ky, kx
    dz = component(direction, kz)
    inverse = Vec3(reciprocal(direction.x), reciprocal(direction.y), reciprocal(direction.z))
    return Ray(
        origin, direction, inverse, kx, ky, kz, component(direction, kx) / dz, component(direction, ky) / dz, 1.0 / dz
    )


@device
def intersect_triangle(ray: Ray, corners: np.ndarray, face: int, far: float) -> Hit:
    """Hit of triangle `face` of corners (F, 3, 3) at 0 < t <= far; face -1 where there is none."""
    kx = ray.kx
    ky = ray.ky
    kz = ray.kz
    ox = component(ray.origin, kx)
    oy = component(ray.origin, ky)
    oz = component(ray.origin, kz)
    az = corners[face, 0, kz] - oz
    bz = corners[face, 1, kz] - oz
    cz = corners[face, 2, kz] - oz
    ax = corners[face, 0, kx] - ox - ray.sx * az
    ay = corners[face, 0, ky] - oy - ray.sy * az
    bx = corners[face, 1, kx] - ox - ray.sx * bz
    by = corners[face, 1, ky] - oy - ray.sy * bz
    cx = corners[face, 2, kx] - ox - ray.sx * cz
    cy = corners[face, 2, ky] - oy - ray.sy * cz
    u = cx * by - cy * bx
    v = ax * cy - ay * cx
    w = bx * ay - by * ax
    det = u + v + w
    slack = EDGE_SLACK * abs(det)
    if min(u, v, w) < -slack and max(u, v, w) > slack:
        return Hit(far, -1, 0.0, 0.0)
    if det == 0.0:
        return Hit(far, -1, 0.0, 0.0)
    scale = 1.0 / det
    t = (u * az + v * bz + w * cz) * ray.sz * scale
    if not (t > 0.0 and t <= far):
        return Hit(far, -1, 0.0, 0.0)
    return Hit(t, face, v * scale, w * scale)
