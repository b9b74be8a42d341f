"""What Mitsuba answers where the references ask it: what a ray meets, and whether a point of a surface sees another.

The rays and segments are those of the integrators (`wavefront`, `rays`), with every answer told, for an audit that
knows better (`reports.study.geometry_audit`). All lengths at the canonical scale.
"""

from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from . import density, rays
from .wavefront import camera_ray, idle, rowwise


class Sights(NamedTuple):
    """What N rays met, and what was seen from there.

    Attributes
    ----------
    position : (N, 3) float64, where a surface was met.
    object, face : (N,) indices of object and face; -1 on a miss.
    hidden : (N,) bool, whether anything lies between the surface and its target.
    origin, direction : (N, 3) float64, of the ray that leaves the surface.
    """

    position: np.ndarray
    object: np.ndarray
    face: np.ndarray
    hidden: np.ndarray
    origin: np.ndarray
    direction: np.ndarray


def camera_rays(loaded: Any, film: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions (N, 3) of the rays through points (N, 2) of the film, as `Camera.rays` has them."""
    camera = loaded.description["camera"]

    def ray(point: Any) -> tuple[Any, Any]:
        made = camera_ray(camera, mi.Float64(point.x), mi.Float64(point.y))
        return made.o, made.d

    origin, direction = rowwise(ray, film)
    return origin, direction


def sights(
    loaded: Any,
    origin: np.ndarray,
    direction: np.ndarray,
    *,
    target: np.ndarray,
    normal: np.ndarray,
    leaving: np.ndarray,
) -> Sights:
    """Trace rays; from what they meet, look at a target, and leave.

    Parameters
    ----------
    origin, direction : (N, 3) of the rays, directions of unit length.
    target, normal : (N, 3) points, and the normals of the faces that they lie on; 0 for a point on none.
    leaving : (N, 3) unit directions; the rays leave the surfaces in these or the opposite ones, to the side from which
        they were met.
    """
    scene = loaded.scenes["direct"]
    shapes = scene.shapes()

    def named(shape: Any) -> Any:
        # Told here and compared outside, so that one compiled kernel serves all scenes.
        return dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape)) if dr.is_jit_v(mi.Float) else shapes.index(shape)

    def see(origin: Any, direction: Any, target: Any, normal: Any, leaving: Any) -> tuple[Any, ...]:
        si = scene.ray_intersect(mi.Ray3f(origin, mi.Vector3f(direction)))
        met = si.is_valid()
        if idle(met):
            return si.p, mi.Int32(-1), mi.Int32(-1), mi.Int32(0), origin, leaving
        # A variant without lanes has its images from Mitsuba's own integrators (see `film`), and so its shadow rays.
        own = rays.segment(si, target, mi.Normal3f(normal)) if dr.is_jit_v(mi.Float) else si.spawn_ray_to(target)
        hidden = rays.blocked(loaded, scene, si, own, met)
        away = mi.Vector3f(leaving) * dr.sign(-dr.dot(si.n, leaving) * dr.dot(si.n, direction))
        ray, _ = rays.leave(loaded, scene, si, rays.spawn(si, away), met)
        face = dr.select(met, mi.Int32(si.prim_index), -1)
        return si.p, named(si.shape), face, dr.select(hidden, mi.Int32(1), 0), ray.o, ray.d

    position, pointer, face, hidden, *left = rowwise(see, origin, direction, target, normal, leaving)
    shape = np.full(len(pointer), -1)
    for number, each in enumerate(shapes):
        if each.is_mesh():  # a sphere is no object of the scene model
            shape[(pointer == np.array(named(each))) & (face >= 0)] = number
    thing, face = original(loaded, shape, face.astype(np.int64))
    return Sights(position, thing, face, hidden.astype(bool), *left)


def original(loaded: Any, shape: np.ndarray, face: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Object and face in it (N,) of a shape's faces (N,), -1 on a miss: a shape may hold several objects."""
    thing, within, first = density.origins(loaded.description["parts"])
    met = shape >= 0
    number = np.where(met, first[shape] + face, 0)
    return np.where(met, thing[number], -1), np.where(met, within[number], -1)
