"""Directional light of irradiance H on a surface that faces it: `E = H cos(theta)`, power `pi R² H` through the scene.

R is the radius of the ball around the scene, see `renderer.lights.distant`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from termwise.renderer.by_reference import by_reference
from termwise.renderer.jit import device
from termwise.renderer.lights.distant import Ball, ball_of, before, out_of
from termwise.renderer.vector import Vec3, dot, negate, scale, vec3
from termwise.renderer.warp import INV_PI
from termwise.scenes.model import DirectionalLight, Scene, shines

if TYPE_CHECKING:  # they hold what is defined here
    from termwise.renderer.arrays import SceneArrays
    from termwise.renderer.surface import Surface

SOURCE = DirectionalLight
DRAWS = False


@by_reference()
class Directionals(NamedTuple):
    """The directional lights of a scene.

    Attributes
    ----------
    way : (D, 3), unit vectors along which the light flies.
    irradiance : (D, 3), of a surface that faces it.
    strength : (D,), mean channel of the irradiance.
    ball : around the scene.
    """

    way: np.ndarray
    irradiance: np.ndarray
    strength: np.ndarray
    ball: Ball


def from_scene(scene: Scene, lit: bool) -> Directionals | None:
    """Those that shine; None without, and where a scene is not lit."""
    lights = [light for light in scene.lights if lit and isinstance(light, SOURCE) and shines(light)]
    if not lights:
        return None
    irradiance = np.array([light.irradiance for light in lights])
    return Directionals(np.array([light.way for light in lights]), irradiance, irradiance.mean(axis=1), ball_of(scene))


def power(directionals: Directionals, aimed: bool) -> np.ndarray:
    """Power of each (D,) through the scene's ball, mean channel, aimed or not."""
    return math.pi * directionals.ball.radius**2 * directionals.strength


def density(scene: SceneArrays, row: int, surface: Surface, direction: Vec3, face: int) -> float | None:
    """Of a sample, per solid angle: none, for all have one direction."""
    return None


@device
def bound(scene: SceneArrays, row: int, surface: Surface) -> float:
    """What a light sends to a surface were it not hidden; 0 only where it cannot."""
    directionals = scene.emitters.directionals
    return directionals.strength[row] * max(0.0, -dot(surface.normal, vec3(directionals.way, row)))


@device
def sample(
    scene: SceneArrays, row: int, probability: float, surface: Surface, u: float, v: float
) -> tuple[Vec3, Vec3, int]:
    """E / pi at a surface over the probability of the pick, the way out of the scene, and the light's face: none."""
    directionals = scene.emitters.directionals
    direction = negate(vec3(directionals.way, row))
    cosine = max(0.0, dot(surface.normal, direction))
    irradiance = scale(vec3(directionals.irradiance, row), cosine * INV_PI / probability)
    return irradiance, out_of(directionals.ball, direction), -1


@device
def emit(
    scene: SceneArrays, row: int, probability: float, aimed: bool, place: tuple[float, float], way: tuple[float, float]
) -> tuple[Vec3, Vec3, Vec3, int]:
    """Origin, direction, power over the probability of the pick, and face (none) of a photon."""
    directionals = scene.emitters.directionals
    ball, heading = directionals.ball, vec3(directionals.way, row)
    flux = scale(vec3(directionals.irradiance, row), math.pi * ball.radius * ball.radius / probability)
    return before(ball, heading, way[0], way[1]), heading, flux, -1
