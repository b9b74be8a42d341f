"""Spheres that give light, met by rays beside the triangles: `|o + t d - c|² = r²`.

Each is numbered as one face behind those of all triangles, and as one object behind all others; its surface is black. A
place on it is said by the height z of the unit normal n and its turn `atan2(n.y, n.x) / (2 pi)`, where a triangle has
barycentric weights.
"""

import math
from typing import NamedTuple

import numpy as np

from termwise.renderer.by_reference import by_reference
from termwise.renderer.geometry.intersect import FaceRange, Hit
from termwise.renderer.jit import device
from termwise.renderer.vector import Vec3, dot, length, mad, scale, sub, vec3
from termwise.renderer.warp import sin_cos_turn
from termwise.scenes.model import Scene


@by_reference()
class Spheres(NamedTuple):
    """The spheres of a scene: centers (S, 3), radii (S,), and the number that the first has among faces."""

    center: np.ndarray
    radius: np.ndarray
    first: int


def from_scene(scene: Scene, faces: int) -> Spheres | None:
    """Those of a scene of so many triangles; None without."""
    if not scene.spheres:
        return None
    return Spheres(
        np.array([sphere.center for sphere in scene.spheres]),
        np.array([sphere.radius for sphere in scene.spheres]),
        faces,
    )


@device
def distance_to(spheres: Spheres, index: int, origin: Vec3, direction: Vec3) -> float:
    """Where a ray meets a sphere first, in lengths of its direction; infinite where it does not."""
    offset = sub(origin, vec3(spheres.center, index))
    radius = spheres.radius[index]
    square = dot(direction, direction)
    middle = -dot(offset, direction) / square
    # The distance of the line from the center, and both factors of |o - c|² - r²: neither cancels.
    aside = mad(direction, middle, offset)
    discriminant = radius * radius - dot(aside, aside)
    if discriminant < 0.0:
        return math.inf
    away = length(offset)
    product = (away - radius) * (away + radius) / square
    half = math.sqrt(discriminant / square)
    if product > 0.0:
        return product / (middle + half) if middle > 0.0 else math.inf
    # From inside, or from a point of it, the far side.
    return middle + half if middle > 0.0 else product / (middle - half)


@device
def normal_at(height: float, turn: float) -> Vec3:
    """Unit normal of the place that `height` and `turn` say."""
    across = math.sqrt(max(0.0, 1.0 - height * height))
    sin, cos = sin_cos_turn(turn)
    return Vec3(across * cos, across * sin, height)


@device
def point_at(spheres: Spheres, index: int, height: float, turn: float) -> Vec3:
    """The point of that place."""
    return mad(normal_at(height, turn), spheres.radius[index], vec3(spheres.center, index))


@device
def nearer(spheres: Spheres | None, origin: Vec3, direction: Vec3, far: float, ignore: FaceRange, hit: Hit) -> Hit:
    """The nearer of what a ray has met and of all spheres but those it leaves."""
    if spheres is not None:
        for index in range(len(spheres.radius)):
            face = spheres.first + index
            if ignore.first <= face < ignore.end:
                continue
            t = distance_to(spheres, index, origin, direction)
            if t < far and (hit.face < 0 or t < hit.t):
                way = sub(mad(direction, t, origin), vec3(spheres.center, index))
                normal = scale(way, 1.0 / length(way))
                turn = math.atan2(normal.y, normal.x) / (2.0 * math.pi)
                hit = Hit(t, face, normal.z, turn if turn >= 0.0 else turn + 1.0)
    return hit


@device
def between(spheres: Spheres | None, origin: Vec3, direction: Vec3, far: float, ignore: FaceRange, target: int) -> bool:
    """Whether a sphere but `target`, and those that the ray leaves, lies nearer than `far`."""
    if spheres is not None:
        for index in range(len(spheres.radius)):
            face = spheres.first + index
            if (
                face != target
                and not ignore.first <= face < ignore.end
                and distance_to(spheres, index, origin, direction) < far
            ):
                return True
    return False
