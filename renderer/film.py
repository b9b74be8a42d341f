"""What all drivers share: the sample's ray into the scene, and the sum of its radiance into the image."""

from typing import NamedTuple

import numpy as np

from renderer.arrays import CameraArrays, SceneArrays
from renderer.camera import CENTRE, JITTER, camera_ray
from renderer.geometry.packets import SIZE
from renderer.jit import device, kernel
from renderer.rng import fold
from renderer.scratch import Scratch
from renderer.sobol import Sampler
from renderer.surface import put_ray, trace, trace_group
from renderer.vector import Vec3, length, put, sub, vec3


class Tile(NamedTuple):
    """Pixels x0 <= x < x1, y0 <= y < y1."""

    x0: int
    y0: int
    x1: int
    y1: int


@device
def sampler_of(scene: SceneArrays, key: np.uint64, x: int, y: int, index: int) -> Sampler:
    """Randomness of sample `index` of a pixel."""
    return Sampler(fold(key, y * scene.camera.width + x), np.uint32(index))


@device
def see(
    scene: SceneArrays, key: np.uint64, x: int, y: int, start: int, count: int, first: int, scratch: Scratch
) -> None:
    """Trace `scratch.sights`: what the samples start ... start + count - 1 of a pixel see, `first` being its first.

    Rays through one point of the pixel are one ray: it is traced for the first sample alone.
    """
    sights = scratch.sights
    if scene.camera.rule == JITTER or not scene.skips.pixel:
        for i in range(count):
            ray = camera_ray(scene.camera, x, y, sampler_of(scene, key, x, y, start + i))
            put_ray(sights, i, ray.origin, ray.direction)
        trace_group(scene, sights, count, scratch)
    elif start == first:
        ray = camera_ray(scene.camera, x, y, sampler_of(scene, key, x, y, start))
        for i in range(SIZE):
            put_ray(sights, i, ray.origin, ray.direction)
        trace_group(scene, sights, 1, scratch)
        for i in range(1, SIZE):
            sights.t[i] = sights.t[0]
            sights.face[i] = sights.face[0]
            sights.b1[i] = sights.b1[0]
            sights.b2[i] = sights.b2[0]


@device
def accumulate(out: np.ndarray, x: int, y: int, radiance: Vec3) -> None:
    """Add to a pixel of (H, W, 3) float64."""
    out[y, x, 0] += radiance.x
    out[y, x, 1] += radiance.y
    out[y, x, 2] += radiance.z


@device
def darken(scratch: Scratch, asking: int) -> None:
    """Make black what the first `asking` of `scratch.rays` found hidden."""
    for k in range(asking):
        if scratch.rays.found[k]:
            put(scratch.radiance, scratch.lane[k], Vec3(0.0, 0.0, 0.0))


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
