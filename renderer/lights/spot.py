"""Spot light: intensity I up to the angle b from its axis, `I (c - t) / (c - b)` from b to c, nothing beyond.

`E = I(t) cos(theta) / d²`; the power is `2 pi I (1 - (sin c - sin b) / (c - b))`. Photons are uniform in the cone of c
and carry what is radiated in their direction.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from termwise.renderer.by_reference import by_reference
from termwise.renderer.jit import device
from termwise.renderer.lights.arriving import arriving
from termwise.renderer.vector import Vec3, cross, dot, frame, length, scale, sub, to_world, vec3
from termwise.renderer.warp import INV_PI, square_to_uniform_cone
from termwise.scenes.model import Scene, SpotLight, shines

if TYPE_CHECKING:  # they hold what is defined here
    from termwise.renderer.arrays import SceneArrays
    from termwise.renderer.surface import Surface

SOURCE = SpotLight
DRAWS = False


@by_reference()
class Spots(NamedTuple):
    """The spot lights of a scene.

    Attributes
    ----------
    position, axis : (S, 3) each, the axis a unit vector.
    beam, cutoff : (S,) each, angles from the axis, radians.
    intensity : (S, 3), on the axis.
    strength : (S,), mean channel of the intensity.
    """

    position: np.ndarray
    axis: np.ndarray
    beam: np.ndarray
    cutoff: np.ndarray
    intensity: np.ndarray
    strength: np.ndarray


def from_scene(scene: Scene, lit: bool) -> Spots | None:
    """Those that shine; None without, and where a scene is not lit."""
    lights = [light for light in scene.lights if lit and isinstance(light, SOURCE) and shines(light)]
    if not lights:
        return None
    angles = np.array([light.angles for light in lights])
    intensity = np.array([light.intensity for light in lights])
    return Spots(
        np.array([light.position for light in lights]),
        np.array([light.axis for light in lights]),
        np.ascontiguousarray(angles[:, 0]),
        np.ascontiguousarray(angles[:, 1]),
        intensity,
        intensity.mean(axis=1),
    )


def power(spots: Spots, aimed: bool) -> np.ndarray:
    """Power of each (S,), mean channel; aimed or not: a spot light is aimed by itself."""
    beam, cutoff = spots.beam, spots.cutoff
    # sin c - sin b by the cosine of their middle, which does not cancel where they are close.
    half = (cutoff - beam) / 2.0
    mean = np.cos((cutoff + beam) / 2.0) * np.sinc(half / math.pi)
    return 2.0 * math.pi * (1.0 - mean) * spots.strength


def density(scene: SceneArrays, row: int, surface: Surface, direction: Vec3, face: int) -> float | None:
    """Of a sample, per solid angle: none, for all have one direction."""
    return None


@device
def falloff(scene: SceneArrays, row: int, direction: Vec3) -> float:
    """Share of the intensity that goes along `direction`, of any length."""
    spots = scene.emitters.spots
    axis = vec3(spots.axis, row)
    # By both, for near the axis the cosine alone has lost the angle.
    across = cross(axis, direction)
    angle = math.atan2(length(across), dot(axis, direction))
    beam, cutoff = spots.beam[row], spots.cutoff[row]
    if angle <= beam:
        return 1.0
    if angle >= cutoff:
        return 0.0
    return (cutoff - angle) / (cutoff - beam)


@device
def bound(scene: SceneArrays, row: int, surface: Surface) -> float:
    """What a light sends to a surface were it not hidden; 0 only where it cannot."""
    spots = scene.emitters.spots
    offset = sub(vec3(spots.position, row), surface.point)
    cosine = dot(surface.normal, offset)
    if cosine <= 0.0:
        return 0.0
    square = dot(offset, offset)
    share = falloff(scene, row, scale(offset, -1.0))
    return spots.strength[row] * share * cosine / (square * math.sqrt(square))


@device
def sample(
    scene: SceneArrays, row: int, probability: float, surface: Surface, u: float, v: float
) -> tuple[Vec3, Vec3, int]:
    """E / pi at a surface over the probability of the pick, the way to the light, and its face: none."""
    spots = scene.emitters.spots
    direction = sub(vec3(spots.position, row), surface.point)
    radiant = vec3(spots.intensity, row)
    strength = falloff(scene, row, scale(direction, -1.0)) * INV_PI / probability
    return arriving(surface.normal, direction, radiant, strength), direction, -1


@device
def emit(
    scene: SceneArrays, row: int, probability: float, aimed: bool, place: tuple[float, float], way: tuple[float, float]
) -> tuple[Vec3, Vec3, Vec3, int]:
    """Origin, direction, power over the probability of the pick, and face (none) of a photon."""
    spots = scene.emitters.spots
    cosine = math.cos(spots.cutoff[row])
    direction = to_world(frame(vec3(spots.axis, row)), square_to_uniform_cone(way[0], way[1], cosine))
    solid_angle = 2.0 * math.pi * (1.0 - cosine)
    flux = scale(vec3(spots.intensity, row), falloff(scene, row, direction) * solid_angle / probability)
    return vec3(spots.position, row), direction, flux, -1
