"""Sphere of radiance L and radius r: `E = pi L sin² a cos t` where all of it is above the horizon, `sin a = r / d`.

Sampled uniformly in the cone that it fills, seen from outside; its power is `4 pi² r² L`. Inside it is black.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from termwise.renderer.by_reference import by_reference
from termwise.renderer.jit import device
from termwise.renderer.vector import Vec3, dot, entry, frame, mad, scale, sub, to_world, vec3
from termwise.renderer.warp import INV_PI, square_to_cosine_hemisphere, square_to_uniform_cone, square_to_uniform_sphere
from termwise.scenes.model import Scene, SphereLight, shines

if TYPE_CHECKING:  # they hold what is defined here
    from termwise.renderer.arrays import SceneArrays
    from termwise.renderer.surface import Surface

SOURCE = SphereLight
DRAWS = True


@by_reference()
class SphereLights(NamedTuple):
    """The spheres of a scene that shine.

    Attributes
    ----------
    face : (S,) int32, their numbers, see `renderer.spheres`.
    center, radius : (S, 3), (S,).
    radiance : (S, 3).
    strength : (S,), mean channel of the radiance times r².
    """

    face: np.ndarray
    center: np.ndarray
    radius: np.ndarray
    radiance: np.ndarray
    strength: np.ndarray


def from_scene(scene: Scene, lit: bool) -> SphereLights | None:
    """Those that shine; None without, and where a scene is not lit."""
    faces = sum(len(thing.mesh.faces) for thing in scene.objects)
    lights = [(faces + number, light) for number, light in enumerate(scene.spheres) if lit and shines(light)]
    if not lights:
        return None
    radius = np.array([light.radius for _, light in lights])
    radiance = np.array([light.radiance for _, light in lights])
    return SphereLights(
        np.array([face for face, _ in lights], np.int32),
        np.array([light.center for _, light in lights]),
        radius,
        radiance,
        radiance.mean(axis=1) * radius**2,
    )


def power(spheres: SphereLights, aimed: bool) -> np.ndarray:
    """Power of each (S,), mean channel, aimed or not."""
    return 4.0 * math.pi**2 * spheres.strength


@device
def _half_angle(spheres: SphereLights, row: int, way: Vec3) -> tuple[float, float]:
    """Squares of the sine of the half angle under which a sphere is seen, and of the way to its center.

    The former is 1 or more from inside.
    """
    square = dot(way, way)
    return spheres.radius[row] * spheres.radius[row] / square if square > 0.0 else math.inf, square


def density(scene: SceneArrays, row: int, surface: Surface, direction: Vec3, face: int) -> float | None:
    """Of a sample, per solid angle; 0 from inside."""
    spheres = scene.emitters.spheres
    sine, _ = _half_angle(spheres, row, sub(vec3(spheres.center, row), surface.point))
    return (1.0 + math.sqrt(1.0 - sine)) / (2.0 * math.pi * sine) if sine < 1.0 else 0.0


@device
def bound(scene: SceneArrays, row: int, surface: Surface) -> float:
    """About what a sphere sends to a surface were it not hidden; 0 only where none of it can."""
    spheres = scene.emitters.spheres
    way = sub(vec3(spheres.center, row), surface.point)
    sine, square = _half_angle(spheres, row, way)
    height = dot(surface.normal, way)
    if sine >= 1.0 or height <= -spheres.radius[row]:
        return 0.0
    return math.pi * spheres.strength[row] * max(height / math.sqrt(square), 0.1) / square


@device
def sample(
    scene: SceneArrays, row: int, probability: float, surface: Surface, u: float, v: float
) -> tuple[Vec3, Vec3, int]:
    """E / pi at a surface over the probability of the pick, the way to a point of the near side, and its number."""
    spheres = scene.emitters.spheres
    face = entry(spheres.face, row)
    way = sub(vec3(spheres.center, row), surface.point)
    sine, square = _half_angle(spheres, row, way)
    if sine >= 1.0:
        return Vec3(0.0, 0.0, 0.0), way, face
    # 1 - cos a, which keeps its digits for a small sphere.
    below = sine / (1.0 + math.sqrt(1.0 - sine))
    distance = math.sqrt(square)
    local = square_to_uniform_cone(u, v, 1.0 - below)
    direction = to_world(frame(scale(way, 1.0 / distance)), local)
    # The nearer point of the sphere on the line: d cos - sqrt(r² - d² sin²).
    across = square * max(0.0, local.x * local.x + local.y * local.y)
    near = distance * local.z - math.sqrt(max(0.0, spheres.radius[row] * spheres.radius[row] - across))
    cosine = max(0.0, dot(surface.normal, direction))
    strength = 2.0 * math.pi * below * cosine * INV_PI / probability
    return scale(vec3(spheres.radiance, row), strength), scale(direction, near), face


@device
def emit(
    scene: SceneArrays, row: int, probability: float, aimed: bool, place: tuple[float, float], way: tuple[float, float]
) -> tuple[Vec3, Vec3, Vec3, int]:
    """Origin, direction, power over the probability of the pick, and number of a photon's sphere."""
    spheres = scene.emitters.spheres
    radius = spheres.radius[row]
    normal = square_to_uniform_sphere(place[0], place[1])
    origin = mad(normal, radius, vec3(spheres.center, row))
    direction = to_world(frame(normal), square_to_cosine_hemisphere(way[0], way[1]))
    flux = scale(vec3(spheres.radiance, row), 4.0 * math.pi**2 * radius * radius / probability)
    return origin, direction, flux, entry(spheres.face, row)
