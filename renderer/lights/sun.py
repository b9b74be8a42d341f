"""Disc in the sky, of half angle a and one radiance `L = H / (pi sin² a)`: `E = H cos(theta)` where all of it is seen.

Sampled uniformly in its solid angle, `2 pi (1 - cos a)`. With H its irradiance on a surface that faces the middle the
radiance of the disc times that solid angle is `2 H / (1 + cos a)`, and `pi R²` times it the power through the scene.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from termwise.renderer.by_reference import by_reference
from termwise.renderer.jit import device
from termwise.renderer.lights.distant import Ball, ball_of, before, out_of
from termwise.renderer.vector import Vec3, add, dot, frame, negate, scale, to_world, vec3
from termwise.renderer.warp import INV_PI, square_to_uniform_cone
from termwise.scenes.model import Scene, SunLight, shines

if TYPE_CHECKING:  # they hold what is defined here
    from termwise.renderer.arrays import SceneArrays
    from termwise.renderer.surface import Surface

SOURCE = SunLight
DRAWS = True


@by_reference()
class Suns(NamedTuple):
    """The suns of a scene.

    Attributes
    ----------
    way : (D, 3), unit vectors along which the light of the middle flies.
    cosine, sine : (D,) each, of the half angle.
    radiance : (D, 3), of the disc.
    flux : (D, 3), radiance times solid angle.
    strength : (D,), mean channel of the flux.
    ball : around the scene.
    """

    way: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray
    radiance: np.ndarray
    flux: np.ndarray
    strength: np.ndarray
    ball: Ball


def from_scene(scene: Scene, lit: bool) -> Suns | None:
    """Those that shine; None without, and where a scene is not lit."""
    lights = [light for light in scene.lights if lit and isinstance(light, SOURCE) and shines(light)]
    if not lights:
        return None
    angle = np.array([light.half_angle for light in lights])
    flux = np.array([light.irradiance for light in lights]) * (2.0 / (1.0 + np.cos(angle)))[:, None]
    return Suns(
        np.array([light.way for light in lights]),
        np.cos(angle),
        np.sin(angle),
        np.array([light.radiance for light in lights]),
        flux,
        flux.mean(axis=1),
        ball_of(scene),
    )


def power(suns: Suns, aimed: bool) -> np.ndarray:
    """Power of each (D,) through the scene's ball, mean channel, aimed or not."""
    return math.pi * suns.ball.radius**2 * suns.strength


def density(scene: SceneArrays, row: int, surface: Surface, direction: Vec3, face: int) -> float | None:
    """Of a sample, per solid angle."""
    return 1.0 / (2.0 * math.pi * (1.0 - scene.emitters.suns.cosine[row]))


@device
def bound(scene: SceneArrays, row: int, surface: Surface) -> float:
    """About what a sun sends to a surface were it not hidden; 0 only where all of it is below the horizon."""
    suns = scene.emitters.suns
    cosine = -dot(surface.normal, vec3(suns.way, row))
    if cosine <= -suns.sine[row]:
        return 0.0
    return suns.strength[row] * max(cosine, 0.1)


@device
def _in_cone(suns: Suns, row: int, u: float, v: float) -> Vec3:
    """A uniform direction towards the disc."""
    middle = frame(negate(vec3(suns.way, row)))
    return to_world(middle, square_to_uniform_cone(u, v, suns.cosine[row]))


@device
def sample(
    scene: SceneArrays, row: int, probability: float, surface: Surface, u: float, v: float
) -> tuple[Vec3, Vec3, int]:
    """E / pi at a surface over the probability of the pick, the way out of the scene, and the light's face: none."""
    suns = scene.emitters.suns
    direction = _in_cone(suns, row, u, v)
    cosine = max(0.0, dot(surface.normal, direction))
    irradiance = scale(vec3(suns.flux, row), cosine * INV_PI / probability)
    return irradiance, out_of(suns.ball, direction), -1


@device
def emit(
    scene: SceneArrays, row: int, probability: float, aimed: bool, place: tuple[float, float], way: tuple[float, float]
) -> tuple[Vec3, Vec3, Vec3, int]:
    """Origin, direction, power over the probability of the pick, and face (none) of a photon."""
    suns = scene.emitters.suns
    ball, heading = suns.ball, negate(_in_cone(suns, row, place[0], place[1]))
    flux = scale(vec3(suns.flux, row), math.pi * ball.radius * ball.radius / probability)
    return before(ball, heading, way[0], way[1]), heading, flux, -1


@device
def radiance_of_suns(suns: Suns, direction: Vec3) -> Vec3:
    """Radiance of all discs that a unit direction points into."""
    seen = Vec3(0.0, 0.0, 0.0)
    for row in range(len(suns.cosine)):
        if -dot(direction, vec3(suns.way, row)) >= suns.cosine[row]:
            seen = add(seen, vec3(suns.radiance, row))
    return seen
