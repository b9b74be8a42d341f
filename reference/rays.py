"""Rays that leave a surface, whether two points see each other, and the side that a surface shows.

Mitsuba's own rays start `(1 + max |p|) * 8.9e-5` above a face, and its shadow rays end 9e-4 of their length before the
light: what covers a lamp more closely than that lets all light through. Here a point on a face is lifted off it by
LIFT, a bound of what float32 rounds a point on a face by, and a segment between two such points is traced in its whole
length: neither face is met again, and whatever else lies between blocks it.

By default a surface is shaded from the viewer's side, as `twosided` does. With `ignore = "object"` a ray flies on
through the faces of the object that it leaves; with `normals = "face"` a surface is shaded about its own normal, from
whichever side it is seen. Some glass casts no shadow: of light that comes straight through each of its faces leaves a
share.
"""

from typing import Any

import drjit as dr
import mitsuba as mi

from . import bsdf
from .wavefront import shape_pointer

OWN_FACES = 64  # of the object that a ray leaves, that it may cross
# At the canonical scale no coordinate of a vertex exceeds 50. A point is the sum of three of them by barycentric
# coordinates: at most 2^-24 * 50 * (3 roundings of sums + 1 of the coordinates) * sqrt(3) = 2.1e-5 off its plane.
LIFT = 2.0**-15
TINY = 1e-20  # keeps a division defined between two points that are one


def plain(loaded: Any) -> bool:
    """Whether rays and normals are those of Mitsuba's own integrators."""
    described = loaded.description
    return described["ignore"] == "face" and described["normals"] == "viewer" and not described["passing"]


def side(loaded: Any, si: Any) -> Any:
    """+1 or -1: the sign of the shading frame's z that is lit."""
    one = mi.Float(1.0)
    return one if loaded.description["normals"] == "face" else dr.mulsign(one, si.wi.z)


def crossing(loaded: Any, si: Any, active: Any) -> Any:
    """The share of the diffuse light that is of the other side; None where no surface of the scene lets any through."""
    return bsdf.crossing_share(si.bsdf(), si, active) if loaded.description["translucent"] else None


def sampled_side(loaded: Any, si: Any, share: Any, sampler: Any, active: Any) -> Any:
    """As `side`, of the other side with the chance `share`."""
    lit = side(loaded, si)
    return lit if share is None else dr.select(sampler.next_1d(active) < share, -lit, lit)


def lifted(point: Any, normal: Any, direction: Any) -> Any:
    """A point of a face with that unit normal, moved off the face to the side that `direction` points to.

    By LIFT where coordinates are those of the canonical scale, in proportion beyond (a sky's sphere).
    """
    farthest = dr.max(dr.abs(point))
    distance = LIFT * dr.maximum(1.0, farthest * 0.02)
    return dr.fma(normal, dr.mulsign(distance, dr.dot(normal, direction)), point)


def spawn(si: Any, direction: Any) -> Any:
    """The ray that leaves a surface in a unit direction, in the place of Mitsuba's `spawn_ray`."""
    return mi.Ray3f(lifted(si.p, si.n, direction), direction)


def segment(si: Any, point: Any, normal: Any) -> Any:
    """The ray from a surface that ends at a point, in the place of Mitsuba's `spawn_ray_to`.

    `normal` : unit, of the face that the point lies on; 0 for a point that lies on none.
    """
    direction = point - si.p
    way = lifted(point, normal, -direction) - lifted(si.p, si.n, direction)
    length = dr.norm(way)
    ray = mi.Ray3f(lifted(si.p, si.n, direction), way / dr.maximum(length, TINY))
    ray.maxt = length
    return ray


def normal_of(ds: Any) -> Any:
    """What `segment` takes of a sample of a light: a point light has no face."""
    return dr.select(ds.delta, mi.Normal3f(0.0), ds.n)


def meets(scene: Any, ray: Any, active: Any) -> Any:
    """Whether anything lies on a ray, in the place of Mitsuba's `ray_test`.

    This errs about spheres: from 22 radii away 24 % of the points of their near side are hidden by themselves, from 34
    59 % (docs/findings.md). What is nearest on a ray is right to LIFT: where there are spheres it is asked for.
    """
    if all(shape.is_mesh() for shape in scene.shapes()):
        return scene.ray_test(ray, active)
    return scene.ray_intersect_preliminary(ray, active=active).is_valid()


def leave(loaded: Any, scene: Any, si: Any, ray: Any, active: Any) -> tuple[Any, Any]:
    """What a ray from `si`, a point of this very scene, meets; and the ray from behind the last face that it passes."""
    met = scene.ray_intersect(ray, active)
    return (ray, met) if loaded.description["ignore"] == "face" else _through(scene, si.shape, ray, met, active)


def blocked(loaded: Any, scene: Any, si: Any, ray: Any, active: Any) -> Any:
    """Whether anything lies on a ray from `si`, a point of this very scene, that ends at `ray.maxt`."""
    if loaded.description["ignore"] == "face":
        return meets(scene, ray, active)
    _, met = _through(scene, si.shape, ray, scene.ray_intersect(ray, active), active)
    return met.is_valid()


def arriving(loaded: Any, scene: Any, si: Any, ray: Any, light: Any, active: Any) -> Any:
    """What arrives at `si`, as in `blocked`, of light that comes against a ray, mi.Color3f."""
    if not loaded.description["passing"]:
        return dr.select(blocked(loaded, scene, si, ray, active), 0.0, light)
    shares = [
        (shape_pointer(shape), dr.opaque(mi.Color3f, share))
        for shape, share in zip(scene.shapes(), loaded.description["passing"], strict=True)
        if any(share)
    ]

    def share_of(met: Any) -> Any:
        found = mi.Color3f(0.0)
        for shape, share in shares:
            found = dr.select(met.shape == shape, share, found)
        return found

    return light * _left_beyond(scene, share_of, ray, active)


@dr.syntax
def _left_beyond(scene: Any, share_of: Any, ray: Any, active: Any) -> Any:
    """The product of the shares of what a ray meets."""
    ray, left = mi.Ray3f(ray), mi.Color3f(1.0)
    ends = ray.maxt < dr.largest(mi.Float)
    end = ray(dr.select(ends, ray.maxt, 0.0))
    met = scene.ray_intersect(ray, active)
    flying = mi.Bool(active & met.is_valid())
    while flying:
        left *= dr.select(flying, share_of(met), 1.0)
        flying &= dr.any(left != 0.0)
        ray = dr.select(ends, segment(met, end, mi.Normal3f(0.0)), spawn(met, ray.d))
        met = scene.ray_intersect(ray, flying)
        flying &= met.is_valid()
    return left


@dr.syntax
def _through(scene: Any, own: Any, ray: Any, met: Any, active: Any) -> tuple[Any, Any]:
    ray, met = mi.Ray3f(ray), mi.SurfaceInteraction3f(met)
    # Behind each face the ray begins anew, lifted off it: where it ends, before a light's face, must not move along.
    ends = ray.maxt < dr.largest(mi.Float)
    end = ray(dr.select(ends, ray.maxt, 0.0))
    inside = active & met.is_valid() & (met.shape == own)
    crossed = mi.UInt32(0)
    while inside:
        ray = dr.select(ends, segment(met, end, mi.Normal3f(0.0)), spawn(met, ray.d))
        met = scene.ray_intersect(ray, inside)
        crossed += 1
        inside &= met.is_valid() & (met.shape == own) & (crossed < OWN_FACES)
    return ray, met
