"""Rays and triangles in rational arithmetic: what intersection is, without a rounding.

With P the plane of a triangle (a, b, c) and all numbers as the fractions that floats are, a ray `o + t d` meets it at
`t = n.(a - o) / (n.d)`, `n = (b - a) x (c - a)`, and inside where the three volumes `d.((p - o) x (q - o))` of its
edges (p, q) have one sign. Float64 numbers are fractions, so the answer is exact, edges and ties included.
"""

from fractions import Fraction
from typing import NamedTuple

import numpy as np

_Vector = tuple[Fraction, Fraction, Fraction]
# A float64 edge function of sheared coordinates has two products of differences: 3 roundings in each coordinate
# (difference, shear, sum), doubled by the product, and 2 after it, and half of it again in its sum with the others.
ROUNDINGS = 16.0 * 2.0**-53


class Meeting(NamedTuple):
    """Exact distance (None: none) and faces at that distance; `sure`: float64 can tell which faces are met.

    `condition` is what a relative error of coordinates is multiplied by in the distance: the greatest distance of a
    corner from the origin, over that of the hit and the cosine of incidence.
    """

    t: Fraction | None
    faces: tuple[int, ...]
    sure: bool
    condition: float


def _fractions(v: np.ndarray) -> _Vector:
    x, y, z = (Fraction(float(value)) for value in v)
    return x, y, z


def _minus(a: _Vector, b: _Vector) -> _Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _cross(a: _Vector, b: _Vector) -> _Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _dot(a: _Vector, b: _Vector) -> Fraction:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _size(a: _Vector) -> Fraction:
    return max(abs(a[0]), abs(a[1]), abs(a[2]))


def closest(corners: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> Meeting:
    """Nearest hit at t > 0 of one ray (3,), (3,) on triangles (F, 3, 3) by testing all of them.

    `sure` is False where an edge function of a triangle that the ray's line meets or nearly meets is smaller than its
    rounding error in float64, `ROUNDINGS` of the largest products in it: such a ray may rightly be found on either
    side of that edge.
    """
    o, d = _fractions(origin), _fractions(direction)
    best: Fraction | None = None
    faces: list[int] = []
    sure = True
    condition = 1.0
    for face, triangle in enumerate(corners):
        a, b, c = (_minus(_fractions(corner), o) for corner in triangle)
        normal = _cross(_minus(b, a), _minus(c, a))
        slope = _dot(normal, d)
        if slope == 0:
            continue
        pairs = ((b, c), (c, a), (a, b))
        volumes = [_dot(d, _cross(p, q)) for p, q in pairs]
        # The edge function is the volume over the main component of d; the shear may double a coordinate.
        unit = 4.0 * ROUNDINGS * float(_size(d))
        signs = []
        for volume, (p, q) in zip(volumes, pairs, strict=True):
            certain = abs(float(volume)) > unit * float(_size(p) * _size(q))
            signs.append((1 if volume > 0 else -1) if certain else 0)
        if not (1 in signs and -1 in signs):
            sure &= 0 not in signs
        if min(volumes) < 0 < max(volumes):
            continue
        t = _dot(normal, a) / slope
        if t <= 0:
            continue
        if best is None or t < best:
            best, faces = t, [face]
            # |n| within a factor 2, without a root.
            condition = float(max(map(_size, (a, b, c))) * _size(normal) * 2 / abs(slope * t))
        elif t == best:
            faces.append(face)
    return Meeting(best, tuple(faces), sure, condition)
