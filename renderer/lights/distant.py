"""Light that arrives from beyond the scene: where a shadow ray ends, and where a photon begins.

All surfaces lie in a ball of radius R. A shadow ray that is 4 R long ends beyond all of them. Photons that fly along w
begin on a disc of radius R across w, before the ball: through it goes all light along w that could meet the scene.
"""

from typing import NamedTuple

import numpy as np

from termwise.renderer.jit import device
from termwise.renderer.vector import Vec3, add, frame, mad, scale, to_world
from termwise.renderer.warp import square_to_cosine_hemisphere
from termwise.scenes.model import Scene

_ROUNDING = 1e-9


class Ball(NamedTuple):
    """Centre and radius of a ball that holds all surfaces: that of the box around them."""

    center: Vec3
    radius: float


def ball_of(scene: Scene) -> Ball:
    """The ball of a scene; of radius 1 where all is in one point."""
    low, high = scene.bounds()
    radius = 0.5 * float(np.linalg.norm(high - low)) * (1.0 + _ROUNDING)
    return Ball(Vec3(*((low + high) / 2.0).tolist()), radius or 1.0)


@device
def out_of(ball: Ball, direction: Vec3) -> Vec3:
    """The way from any surface to beyond all others, along a unit direction."""
    return scale(direction, 4.0 * ball.radius)


@device
def before(ball: Ball, way: Vec3, u: float, v: float) -> Vec3:
    """Where a photon begins that flies along a unit direction: a uniform point of the disc."""
    # Malley's direction has the uniform point of the unit disc as its first two coordinates.
    point = square_to_cosine_hemisphere(u, v)
    across = to_world(frame(way), Vec3(ball.radius * point.x, ball.radius * point.y, 0.0))
    return mad(way, -2.0 * ball.radius, add(ball.center, across))
