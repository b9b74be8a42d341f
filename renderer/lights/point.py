"""Point light of intensity I, the same in all directions: `E = I cos(theta) / d²`, power `4 pi I`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from termwise.renderer.by_reference import by_reference
from termwise.renderer.jit import device
from termwise.renderer.lights.aim import cone
from termwise.renderer.lights.arriving import arriving
from termwise.renderer.vector import Vec3, dot, frame, scale, sub, to_world, vec3
from termwise.renderer.warp import INV_PI, square_to_uniform_cone, square_to_uniform_sphere
from termwise.scenes.model import PointLight, Scene, shines

if TYPE_CHECKING:  # they hold what is defined here
    from termwise.renderer.arrays import SceneArrays
    from termwise.renderer.surface import Surface

SOURCE = PointLight
DRAWS = False


@by_reference()
class Points(NamedTuple):
    """The point lights of a scene.

    Attributes
    ----------
    position : (P, 3).
    intensity : (P, 3).
    axis, cosine : (P, 3), (P,), the cone around the scene, see `renderer.lights.aim`.
    strength : (P,), mean channel of the intensity.
    """

    position: np.ndarray
    intensity: np.ndarray
    axis: np.ndarray
    cosine: np.ndarray
    strength: np.ndarray


def from_scene(scene: Scene, lit: bool) -> Points:
    """Those that shine; none where a scene is not lit."""
    lights = [light for light in scene.lights if lit and isinstance(light, SOURCE) and shines(light)]
    position = np.array([light.position for light in lights]).reshape(-1, 3)
    intensity = np.array([light.intensity for light in lights]).reshape(-1, 3)
    vertices = np.concatenate([np.zeros((0, 3)), *(thing.mesh.vertices for thing in scene.objects)])
    cones = [cone(point, vertices) for point in position]
    axis = np.array([axis for axis, _ in cones]).reshape(-1, 3)
    cosine = np.array([cosine for _, cosine in cones])
    return Points(position, intensity, axis, cosine, intensity.mean(axis=1))


def power(points: Points, aimed: bool) -> np.ndarray:
    """Power of each (P,), mean channel; `aimed`: what goes into the cones."""
    solid_angle = 2.0 * math.pi * (1.0 - points.cosine) if aimed else 4.0 * math.pi
    return solid_angle * points.strength


def density(scene: SceneArrays, row: int, surface: Surface, direction: Vec3, face: int) -> float | None:
    """Of a sample, per solid angle: none, for all have one direction."""
    return None


@device
def bound(scene: SceneArrays, row: int, surface: Surface) -> float:
    """What a light sends to a surface were it not hidden; 0 only where it cannot."""
    points = scene.emitters.points
    offset = sub(vec3(points.position, row), surface.point)
    cosine = dot(surface.normal, offset)
    if cosine <= 0.0:
        return 0.0
    square = dot(offset, offset)
    return points.strength[row] * cosine / (square * math.sqrt(square))


@device
def sample(
    scene: SceneArrays, row: int, probability: float, surface: Surface, u: float, v: float
) -> tuple[Vec3, Vec3, int]:
    """E / pi at a surface over the probability of the pick, the way to the light, and its face: none."""
    points = scene.emitters.points
    direction = sub(vec3(points.position, row), surface.point)
    radiant = vec3(points.intensity, row)
    return arriving(surface.normal, direction, radiant, INV_PI / probability), direction, -1


@device
def emit(
    scene: SceneArrays, row: int, probability: float, aimed: bool, place: tuple[float, float], way: tuple[float, float]
) -> tuple[Vec3, Vec3, Vec3, int]:
    """Origin, direction, power over the probability of the pick, and face (none) of a photon."""
    points = scene.emitters.points
    origin, intensity = vec3(points.position, row), vec3(points.intensity, row)
    u, v = way
    cosine = points.cosine[row]
    if aimed and cosine > 0.0:
        local = square_to_uniform_cone(u, v, cosine)
        flux = scale(intensity, 2.0 * math.pi * (1.0 - cosine) / probability)
        return origin, to_world(frame(vec3(points.axis, row)), local), flux, -1
    return origin, square_to_uniform_sphere(u, v), scale(intensity, 4.0 * math.pi / probability), -1
