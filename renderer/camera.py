"""Rays through the near plane: `direction = corner + x across + y down` at film position (x, y) (paper).

The paper sends the ray through the top-left corner of each pixel; `centre` and `jitter` are the unshifted and the
box-filtered choice.
"""

from renderer.arrays import CameraArrays
from renderer.geometry.intersect import Ray, make_ray
from renderer.jit import device
from renderer.sobol import Sampler, sample_2d
from renderer.vector import mad, normalize

CORNER, CENTRE, JITTER = range(3)  # as in arrays.PIXEL_RULES
FILM = 0  # the pair of dimensions that places a sample in its pixel


@device
def camera_ray(camera: CameraArrays, x: int, y: int, sampler: Sampler) -> Ray:
    """Ray through pixel (x, y), direction of unit length."""
    u = 0.0
    v = 0.0
    if camera.rule == CENTRE:
        u = 0.5
        v = 0.5
    elif camera.rule == JITTER:
        u, v = sample_2d(sampler, FILM)
    direction = mad(camera.across, (x + u) / camera.width, camera.corner)
    direction = mad(camera.down, (y + v) / camera.height, direction)
    return make_ray(camera.position, normalize(direction))
