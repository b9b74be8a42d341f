"""The sky: a constant, or the paper's texture on a sphere.

A ray that misses everything meets the sphere around `center`; with n the unit vector from the centre to that point,
`u = atan2(n.x, n.y) / (2 pi) + 0.5` and `v = 0.5 - n.z / 2` (paper): v is linear in height, rows have equal areas. As
settings: `v = acos(n.z) / pi` (lat-long), and n = the ray's direction (infinite radius).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from termwise.renderer.jit import device
from termwise.renderer.vector import Vec3, add, dot, mad, scale, sub

if TYPE_CHECKING:  # it holds what is defined here
    from termwise.renderer.arrays import SkyArrays


@device
def _texel(sky: SkyArrays, column: int, row: int) -> Vec3:
    height, width = sky.texture.shape[0], sky.texture.shape[1]
    column = column % width
    row = min(max(row, 0), height - 1)
    return Vec3(sky.texture[row, column, 0], sky.texture[row, column, 1], sky.texture[row, column, 2])


@device
def sky_texture(sky: SkyArrays, u: float, v: float) -> Vec3:
    """Bilinear lookup; texel centres at (i + 0.5) / size, u repeats, v is clamped."""
    x = u * sky.texture.shape[1] - 0.5
    y = v * sky.texture.shape[0] - 0.5
    column = math.floor(x)
    row = math.floor(y)
    fx = x - column
    fy = y - row
    c = int(column)
    r = int(row)
    top = mad(_texel(sky, c, r), 1.0 - fx, scale(_texel(sky, c + 1, r), fx))
    bottom = mad(_texel(sky, c, r + 1), 1.0 - fx, scale(_texel(sky, c + 1, r + 1), fx))
    return add(scale(top, 1.0 - fy), scale(bottom, fy))


@device
def sky_radiance(sky: SkyArrays, origin: Vec3, direction: Vec3) -> Vec3:
    """Radiance along a unit direction that nothing blocks; black where the sphere is missed."""
    if sky.texture.shape[0] == 0:
        return sky.color
    n = direction
    if sky.radius < math.inf:
        offset = sub(origin, sky.center)
        b = dot(offset, direction)
        # Distance of the line from the centre first: b² - c cancels for far origins.
        perpendicular = mad(direction, -b, offset)
        discriminant = sky.radius * sky.radius - dot(perpendicular, perpendicular)
        if discriminant < 0.0:
            return Vec3(0.0, 0.0, 0.0)
        t = -b + math.sqrt(discriminant)
        if t <= 0.0:
            return Vec3(0.0, 0.0, 0.0)
        n = scale(mad(direction, t, offset), 1.0 / sky.radius)
    u = math.atan2(n.x, n.y) / (2.0 * math.pi) + 0.5
    if sky.equal_area:
        return sky_texture(sky, u, 0.5 - 0.5 * n.z)
    # atan2 and not acos, which loses half of the digits near the poles.
    return sky_texture(sky, u, math.atan2(math.sqrt(n.x * n.x + n.y * n.y), n.z) / math.pi)
