"""Rays through the near plane: `direction = corner + x across + y down` at film position (x, y) (paper).

The paper sends the ray through the top-left corner of each pixel; `centre` and `jitter` are the unshifted and the
box-filtered choice.
"""

from termwise.renderer.arrays import CameraArrays
from termwise.renderer.geometry.intersect import Ray, make_ray
from termwise.renderer.jit import device
from termwise.renderer.sobol import Sampler, sample_2d
from termwise.renderer.vector import Vec3, mad, normalize

CORNER, CENTRE, JITTER = range(3)  # as in arrays.PIXEL_RULES
FILM = 0  # the pair of dimensions that places a sample in its pixel


@device
def point_in_pixel(camera: CameraArrays, sampler: Sampler) -> tuple[float, float]:
    """Where in its pixel a ray goes through the film, in [0, 1]²."""
    if camera.rule == JITTER:
        return sample_2d(sampler, FILM)
    shift = 0.5 if camera.rule == CENTRE else 0.0
    return shift, shift


@device
def direction_through(camera: CameraArrays, x: float, y: float) -> Vec3:
    """Unit direction through film position (x, y), in pixels."""
    direction = mad(camera.across, x / camera.width, camera.corner)
    return normalize(mad(camera.down, y / camera.height, direction))


@device
def camera_ray(camera: CameraArrays, x: int, y: int, sampler: Sampler) -> Ray:
    """Ray through pixel (x, y), direction of unit length."""
    u, v = point_in_pixel(camera, sampler)
    return make_ray(camera.position, direction_through(camera, x + u, y + v))
