"""What all drivers share: the sample's ray into the scene, and the sum of its radiance into the image."""

from typing import NamedTuple

import numpy as np

from renderer.arrays import CameraArrays, SceneArrays
from renderer.camera import CENTRE, camera_ray
from renderer.jit import device, kernel
from renderer.rng import fold
from renderer.scratch import Scratch
from renderer.sobol import Sampler
from renderer.surface import Surface, trace
from renderer.vector import Vec3, length, sub, vec3


class Tile(NamedTuple):
    """Pixels x0 <= x < x1, y0 <= y < y1."""

    x0: int
    y0: int
    x1: int
    y1: int


@device
def first_surface(
    scene: SceneArrays, key: np.uint64, x: int, y: int, index: int, scratch: Scratch
) -> tuple[Surface, Sampler]:
    """What sample `index` of a pixel sees first, and the sampler of all that follows."""
    sampler = Sampler(fold(key, y * scene.camera.width + x), np.uint32(index))
    return trace(scene, camera_ray(scene.camera, x, y, sampler), -1, scratch), sampler


@device
def accumulate(out: np.ndarray, x: int, y: int, radiance: Vec3) -> None:
    """Add to a pixel of (H, W, 3) float64."""
    out[y, x, 0] += radiance.x
    out[y, x, 1] += radiance.y
    out[y, x, 2] += radiance.z


class GeometryImages(NamedTuple):
    """What the ray through each pixel's centre meets; (H, W) each, `normal` (H, W, 3).

    `depth` is the distance along the unit ray, inf where nothing is met; `normal` the face's own unit normal; `object`
    and `face` are indices, -1 where nothing is met.
    """

    depth: np.ndarray
    normal: np.ndarray
    object: np.ndarray
    face: np.ndarray


@kernel
def trace_centres(scene: SceneArrays, tile: Tile, images: GeometryImages, scratch: Scratch) -> None:
    """Fill a tile of the geometry images."""
    c = scene.camera
    centre = CameraArrays(c.position, c.corner, c.across, c.down, c.width, c.height, CENTRE)
    for y in range(tile.y0, tile.y1):
        for x in range(tile.x0, tile.x1):
            ray = camera_ray(centre, x, y, Sampler(np.uint64(0), np.uint32(0)))
            surface = trace(scene, ray, -1, scratch)
            images.object[y, x] = surface.object
            images.face[y, x] = surface.face
            if surface.face >= 0:
                images.depth[y, x] = length(sub(surface.point, ray.origin))
                normal = vec3(scene.geometry.normals, surface.face)
                images.normal[y, x, 0] = normal.x
                images.normal[y, x, 1] = normal.y
                images.normal[y, x, 2] = normal.z
