"""The textured sky as ambient light: `w / pi ∫ hit L_sky cos`, half of the directions drawn where the sky is bright.

A direction of the other half has the cosine's density. Both halves weigh by the density of the mixture (the balance
heuristic, Veach 1997): `L cos / pi / ((cos / pi + p) / 2)`. p is that of the map: a texel by its mean channel and area,
those around it counted too, because the lookup blends them, and a uniform point (u, v) in it. Its density per solid
angle is that of (u, v) over 4 pi, where rows have equal areas, or over `2 pi² sin theta` (lat-long); and a sphere at a
finite distance d, of radius R, is seen from x at the cosine `n.w`: times `d² / (R² n.w)`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from termwise.renderer.by_reference import by_reference
from termwise.renderer.jit import device
from termwise.renderer.lights import running_sum
from termwise.renderer.sky import sky_radiance
from termwise.renderer.vector import Vec3, dot, frame, length, mad, scale, sub, to_world
from termwise.renderer.warp import INV_PI, sin_cos_turn, square_to_cosine_hemisphere
from termwise.scenes.model import Scene

if TYPE_CHECKING:  # it holds what is defined here
    from termwise.renderer.arrays import SceneArrays

_BELOW_ONE = 1.0 - 2.0**-53
_FLOOR = 1e-3  # of the mean: the least that a texel weighs, so that none is out of reach


@by_reference()
class SkyMap(NamedTuple):
    """Where the sky is bright.

    Attributes
    ----------
    rows : (H + 1,), running sum of the probabilities of the rows, from 0 to 1.
    columns : (H, W + 1), the same of the texels within each row.
    """

    rows: np.ndarray
    columns: np.ndarray


def from_scene(scene: Scene) -> SkyMap | None:
    """The map of a scene whose ambient light is a textured sky; None of any other."""
    texture = scene.sky.texture
    if scene.ambient_light is not None or texture is None:
        return None
    brightness = texture.astype(np.float64).mean(axis=2)
    padded = np.pad(np.pad(brightness, ((0, 0), (1, 1)), mode="wrap"), ((1, 1), (0, 0)), mode="edge")
    height, width = brightness.shape
    around = sum(padded[i : i + height, j : j + width] for i in range(3) for j in range(3)) / 9.0
    around = around + _FLOOR * brightness.mean()
    if scene.sky.projection == "lat-long":
        edges = np.cos(np.arange(height + 1) / height * math.pi)
        around = around * (edges[:-1] - edges[1:])[:, None]
    return SkyMap(running_sum(around.sum(axis=1)), np.array([running_sum(row) for row in around]))


@device
def _interval(cdf: np.ndarray, u: float) -> tuple[int, float]:
    """Number of the interval of a running sum that u is in, and its place there, below 1."""
    low, high = 0, len(cdf) - 2
    while low < high:
        middle = (low + high) // 2
        if u >= cdf[middle + 1]:
            low = middle + 1
        else:
            high = middle
    return low, min((u - cdf[low]) / (cdf[low + 1] - cdf[low]), _BELOW_ONE)


@device
def direction_to_sky(scene: SceneArrays, sky_map: SkyMap, origin: Vec3, u: float, v: float) -> Vec3:
    """Unit direction to a point of the sky, drawn by the map."""
    sky = scene.sky
    height, width = len(sky_map.rows) - 1, sky_map.columns.shape[1] - 1
    row, down = _interval(sky_map.rows, v)
    column, across = _interval(sky_map.columns[row], u)
    # u = atan2(n.x, n.y) / (2 pi) + 0.5
    sin, cos = sin_cos_turn(min((column + across) / width, _BELOW_ONE))
    place = (row + down) / height
    if sky.equal_area:
        z = 1.0 - 2.0 * place
        radius = 2.0 * math.sqrt(max(0.0, place * (1.0 - place)))
    else:
        z = math.cos(place * math.pi)
        radius = math.sin(place * math.pi)
    n = Vec3(-radius * sin, -radius * cos, z)
    if sky.radius == math.inf:
        return n
    way = sub(mad(n, sky.radius, sky.center), origin)
    return scale(way, 1.0 / length(way))


@device
def _density_at(scene: SceneArrays, sky_map: SkyMap, n: Vec3) -> float:
    """Density of the map at the unit vector n, per solid angle about the sky's center."""
    height, width = len(sky_map.rows) - 1, sky_map.columns.shape[1] - 1
    u = math.atan2(n.x, n.y) / (2.0 * math.pi) + 0.5
    sine = math.sqrt(n.x * n.x + n.y * n.y)
    v = 0.5 - 0.5 * n.z if scene.sky.equal_area else math.atan2(sine, n.z) / math.pi
    row = min(max(int(v * height), 0), height - 1)
    column = min(max(int(u * width), 0), width - 1)
    of_row = sky_map.rows[row + 1] - sky_map.rows[row]
    of_texel = sky_map.columns[row, column + 1] - sky_map.columns[row, column]
    density = of_row * of_texel * height * width
    if scene.sky.equal_area:
        return density / (4.0 * math.pi)
    return density / (2.0 * math.pi * math.pi * sine) if sine > 0.0 else math.inf


@device
def density_of_sky(scene: SceneArrays, sky_map: SkyMap, origin: Vec3, direction: Vec3) -> float:
    """Density of the above per solid angle; 0 where the ray misses the sky's sphere."""
    sky = scene.sky
    if sky.radius == math.inf:
        return _density_at(scene, sky_map, direction)
    offset = sub(origin, sky.center)
    middle = -dot(offset, direction)
    aside = mad(direction, middle, offset)
    discriminant = sky.radius * sky.radius - dot(aside, aside)
    if discriminant <= 0.0:
        return 0.0
    half = math.sqrt(discriminant)
    density = 0.0
    # From outside of the sphere a ray meets it twice, and either point may have been drawn.
    for distance in (middle + half, middle - half):
        if distance > 0.0:
            n = scale(mad(direction, distance, offset), 1.0 / sky.radius)
            # The cosine n.w is half / R.
            density += _density_at(scene, sky_map, n) * distance * distance / (sky.radius * half)
    return density


@device
def sky_light(scene: SceneArrays, sky_map: SkyMap, origin: Vec3, normal: Vec3, u: float, v: float) -> tuple[Vec3, Vec3]:
    """Unit direction of a sample, and what it contributes to `(1 / pi) ∫ L_sky cos` where nothing hides it."""
    if u < 0.5:
        direction = direction_to_sky(scene, sky_map, origin, 2.0 * u, v)
    else:
        direction = to_world(frame(normal), square_to_cosine_hemisphere(2.0 * u - 1.0, v))
    cosine = dot(normal, direction) * INV_PI
    if cosine <= 0.0:
        return direction, Vec3(0.0, 0.0, 0.0)
    density = 0.5 * (cosine + density_of_sky(scene, sky_map, origin, direction))
    return direction, scale(sky_radiance(scene.sky, origin, direction), cosine / density)
