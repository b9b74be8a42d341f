"""The cone around all geometry, seen from a point light: photons outside it meet nothing.

A photon that is uniform in a cone of half angle a carries `2 pi (1 - cos a) I` in the place of `4 pi I`, over the
probability of the pick. The directions to all vertices of a scene lie in a cone narrower than a half space only if
those to all points of its triangles do: each is a positive combination of the former.
"""

import numpy as np

from termwise.renderer.vector import Vec3

_STEPS = 32
_ROUNDING = 1e-9


def cone(position: np.ndarray, vertices: np.ndarray) -> tuple[Vec3, float]:
    """Axis, and cosine of the half angle, of a narrow cone at `position` (3,) around `vertices` (V, 3).

    The cosine is -1, all directions, where no cone within a half space was found.
    """
    everywhere = Vec3(0.0, 0.0, 1.0), -1.0
    offset = vertices.astype(np.float64) - position
    distance = np.linalg.norm(offset, axis=1)
    if not len(offset) or not distance.min() > 0.0:
        return everywhere
    directions = offset / distance[:, None]
    # The centre of the ball around the directions, which cuts the sphere in the cone: Bădoiu, Clarkson, "Smaller
    # Core-Sets for Balls", SODA 2003.
    centre = directions.mean(axis=0)
    for step in range(1, _STEPS + 1):
        farthest = directions[np.argmin(directions @ centre)]
        centre = centre + (farthest - centre) / (step + 1)
    length = float(np.linalg.norm(centre))
    if length == 0.0:
        return everywhere
    axis = centre / length
    cosine = float((directions @ axis).min()) - _ROUNDING
    return (Vec3(*axis.tolist()), cosine) if cosine > 0.0 else everywhere
