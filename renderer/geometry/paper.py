"""The paper's intersection: the plane by a triple product, the inside by comparing angles; every face is tried.

`t = (d . v1) / (d . w)`, d = (v2 - v1) x (v3 - v1), the corners relative to the ray's origin; a point M of the plane is
inside where at A and at B its angles to both sides do not exceed the triangle's own. |d . w| and t must reach 1e-5: an
absolute length, so small, near and grazing faces are missed; and rounding opens gaps along edges. Kept to show what
that costs: everything else uses `traverse`.
"""

import math

import numpy as np

from termwise.renderer.geometry.intersect import FaceRange, Hit, Ray
from termwise.renderer.jit import device
from termwise.renderer.vector import Vec3, cross, dot, length, scale, sub, vec3

_EPSILON = 1e-5


@device
def _cosine(a: Vec3, b: Vec3) -> float:
    """NaN where a vector is 0: no comparison refuses it then, as in the paper's code."""
    size = length(a) * length(b)
    return dot(a, b) / size if size > 0.0 else math.nan


@device
def intersect_face(ray: Ray, corners: np.ndarray, face: int) -> Hit:
    """Hit of one face; face -1 where there is none."""
    none = Hit(math.inf, -1, 0.0, 0.0)
    a = sub(vec3(corners[face], 0), ray.origin)
    ab = sub(vec3(corners[face], 1), vec3(corners[face], 0))
    ac = sub(vec3(corners[face], 2), vec3(corners[face], 0))
    normal = cross(ab, ac)
    size = length(ray.direction)
    slope = dot(normal, ray.direction)
    # The paper's directions are unit vectors.
    if abs(slope) < _EPSILON * size:
        return none
    t = dot(normal, a) / slope
    if t * size < _EPSILON:
        return none
    am = sub(scale(ray.direction, t), a)
    bm = sub(am, ab)
    bc = sub(ac, ab)
    ba = scale(ab, -1.0)
    angle_a = _cosine(ab, ac)
    angle_b = _cosine(ba, bc)
    if _cosine(ab, am) < angle_a or _cosine(ac, am) < angle_a:
        return none
    if _cosine(ba, bm) < angle_b or _cosine(bc, bm) < angle_b:
        return none
    square = dot(normal, normal)
    return Hit(t, face, dot(cross(am, ac), normal) / square, dot(cross(ab, am), normal) / square)


@device
def closest_hit(corners: np.ndarray, ray: Ray, far: float, ignore: FaceRange) -> Hit:
    """Nearest hit at t <= far on any face but those of `ignore`."""
    best = Hit(far, -1, 0.0, 0.0)
    for face in range(len(corners)):
        if face < ignore.first or face >= ignore.end:
            hit = intersect_face(ray, corners, face)
            if hit.face >= 0 and hit.t <= far and (hit.t < best.t or best.face < 0):
                best = hit
    return best


@device
def any_hit(corners: np.ndarray, ray: Ray, far: float, ignore: FaceRange, target: int) -> bool:
    """Whether a face other than `target` and those of `ignore` is hit at t < far."""
    for face in range(len(corners)):
        if (face < ignore.first or face >= ignore.end) and face != target:
            hit = intersect_face(ray, corners, face)
            if hit.face >= 0 and hit.t < far:
                return True
    return False
