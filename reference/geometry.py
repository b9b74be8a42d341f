"""What Mitsuba's rays meet: depth, geometric normal, object and face per pixel.

Both sides must agree on these before any radiance is compared.
"""

from typing import Any, NamedTuple

import numpy as np

from termwise import reference
from termwise.reference.translate import Canonical
from termwise.scenes.model import Scene


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
    hits = first_hits(
        scene, np.broadcast_to(scene.camera.position, directions.shape).reshape(-1, 3), directions.reshape(-1, 3)
    )
    return Geometry(*(array.reshape(height, width, *array.shape[1:]) for array in hits))


def first_hits(scene: Scene, origins: np.ndarray, directions: np.ndarray) -> Geometry:
    """First hits of any rays, `origins` and unit `directions` (N, 3) in scene units; arrays of length N."""
    loaded = reference.loaded(scene)
    import mitsuba as mi

    from termwise.reference.sights import original

    canonical = Canonical.of(scene)
    points, vectors = canonical.points(origins), np.asarray(directions, np.float64)
    # In double precision up to the ball that holds the scene, from where Mitsuba goes on in single.
    middle, ball = -np.einsum("nx,nx->n", points, vectors), loaded.description["camera"]["ball"]
    half_squared = ball**2 - np.sum((points + middle[:, None] * vectors) ** 2, axis=1)
    ahead = np.where(half_squared > 0.0, np.maximum(middle - np.sqrt(np.maximum(half_squared, 0.0)), 0.0), 0.0)
    points = points + ahead[:, None] * vectors
    intersect = _all_at_once if mi.variant() != "scalar_rgb" else _one_by_one
    depth, normal, shape, number = intersect(loaded.scenes["diffuse"], points, vectors)
    thing, face = original(loaded, shape, number)
    hit = thing >= 0
    return Geometry(
        depth=np.where(hit, (ahead + depth) / canonical.scale, np.inf).astype(np.float32),
        normal=np.where(hit[:, None], normal, 0.0).astype(np.float32),
        object=thing.astype(np.int32),
        face=face.astype(np.int32),
    )


_Hits = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def _meshes(scene: Any) -> list[Any]:
    """Its shapes but for spheres, which are no objects of the scene model: what meets one meets nothing here."""
    return [shape for shape in scene.shapes() if shape.is_mesh()]


def _all_at_once(scene: Any, points: np.ndarray, vectors: np.ndarray) -> _Hits:
    import mitsuba as mi

    si = scene.ray_intersect(mi.Ray3f(mi.Point3f(points.T), mi.Vector3f(vectors.T)))
    hit = np.array(si.is_valid())
    thing = np.full(len(hit), -1)
    for index, shape in enumerate(_meshes(scene)):
        thing[np.array(si.shape == mi.ShapePtr(shape)) & hit] = index
    return np.array(si.t), np.array(si.n).T, thing, np.array(si.prim_index).astype(np.int64)


def _one_by_one(scene: Any, points: np.ndarray, vectors: np.ndarray) -> _Hits:
    import mitsuba as mi

    shapes = _meshes(scene)
    hits = [
        scene.ray_intersect(mi.Ray3f(mi.Point3f(point), mi.Vector3f(vector)))
        for point, vector in zip(points.tolist(), vectors.tolist(), strict=True)
    ]
    return (
        np.array([si.t for si in hits]),
        np.array([list(si.n) for si in hits]),
        np.array([shapes.index(si.shape) if si.is_valid() and si.shape in shapes else -1 for si in hits]),
        np.array([si.prim_index for si in hits], np.int64),
    )
