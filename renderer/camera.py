"""Rays through the near plane: `direction = corner + x across + y down` at film position (x, y), in pixels (paper).

The paper sends the ray through the top-left corner of each pixel; `centre` and `jitter` are the unshifted and the
box-filtered choice.
"""

import numpy as np

from termwise.renderer.arrays import CameraArrays
from termwise.renderer.geometry.intersect import Ray, make_ray
from termwise.renderer.jit import device
from termwise.renderer.sobol import Sampler, draw_2d, sample_2d
from termwise.renderer.vector import Vec3, mad, normalize

CORNER, CENTRE, JITTER = range(3)  # as in arrays.PIXEL_RULES
FILM = 0  # the pair of dimensions that places a sample in its pixel


@device
def _shift(camera: CameraArrays) -> float:
    """Where in their pixels, in x and y, rays go through the film that all go through one point of it."""
    return 0.5 if camera.rule == CENTRE else 0.0


@device
def draw_on_film(
    camera: CameraArrays,
    key: np.ndarray,
    index: np.ndarray,
    count: int,
    u: np.ndarray,
    v: np.ndarray,
    words: np.ndarray,
) -> None:
    """Where in their pixels the first `count` rays go through the film, in [0, 1]²; arguments as `draw_2d` has them."""
    if camera.rule == JITTER:
        draw_2d(key, index, count, FILM, u, v, words)
        return
    for k in range(count):
        u[k] = v[k] = _shift(camera)


@device
def direction_through(camera: CameraArrays, x: float, y: float) -> Vec3:
    """Unit direction through film position (x, y), in pixels."""
    return normalize(mad(camera.down, y, mad(camera.across, x, camera.corner)))


@device
def camera_ray(camera: CameraArrays, x: int, y: int, sampler: Sampler) -> Ray:
    """Ray through pixel (x, y), direction of unit length."""
    u = v = _shift(camera)
    if camera.rule == JITTER:
        u, v = sample_2d(sampler, FILM)
    return make_ray(camera.position, direction_through(camera, x + u, y + v))
