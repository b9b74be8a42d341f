"""What Mitsuba's rays meet: depth, geometric normal, object and face per pixel.

Both sides must agree on these before any radiance is compared.
"""

from typing import NamedTuple

import numpy as np

import reference
from reference.translate import Canonical
from scenes.model import Scene


class Geometry(NamedTuple):
    """First hits of the rays through the pixel centres.

    Attributes
    ----------
    depth : (H, W) float32, distance along the unit ray in scene units; infinite on a miss.
    normal : (H, W, 3) float32, unit geometric normal `(v1 - v0) x (v2 - v0)`, not turned to the viewer; 0 on a miss.
    object : (H, W) int32, index into `scene.objects`; -1 on a miss.
    face : (H, W) int32, index into the object's faces; -1 on a miss.
    """

    depth: np.ndarray
    normal: np.ndarray
    object: np.ndarray
    face: np.ndarray


def geometry(scene: Scene) -> Geometry:
    """First hits of the rays through the pixel centres, by Mitsuba."""
    width, height = scene.resolution
    film = np.stack(np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height), axis=-1)
    directions = scene.camera.rays(film, aspect=scene.aspect)
    hits = first_hits(scene, np.broadcast_to(scene.camera.position, directions.shape).reshape(-1, 3), directions.reshape(-1, 3))
    return Geometry(*(array.reshape(height, width, *array.shape[1:]) for array in hits))


def first_hits(scene: Scene, origins: np.ndarray, directions: np.ndarray) -> Geometry:
    """First hits of any rays, `origins` and unit `directions` (N, 3) in scene units; arrays of length N."""
    loaded = reference.loaded(scene)
    import mitsuba as mi

    mitsuba_scene = loaded.scenes["diffuse"]
    canonical = Canonical.of(scene)
    ray = mi.Ray3f(mi.Point3f(canonical.points(origins).T), mi.Vector3f(np.asarray(directions).T))
    si = mitsuba_scene.ray_intersect(ray)
    hit = np.array(si.is_valid())
    number = np.full(len(hit), -1, np.int32)
    for index, shape in enumerate(mitsuba_scene.shapes()):
        number[np.array(si.shape == mi.ShapePtr(shape)) & hit] = index
    return Geometry(
        depth=np.where(hit, np.array(si.t) / canonical.scale, np.inf).astype(np.float32),
        normal=np.where(hit[:, None], np.array(si.n).T, 0.0).astype(np.float32),
        object=number,
        face=np.where(hit, np.array(si.prim_index).astype(np.int32), -1),
    )
