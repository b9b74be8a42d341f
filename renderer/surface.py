"""Where a ray meets a surface: `x = (1 - b1 - b2) v0 + b1 v1 + b2 v2`, and the normal that faces the ray.

The point comes from barycentrics, not from o + t d, so it lies on the face to the last bits whatever the distance
travelled; rays that leave it skip this face (or its object, see `Scene.ignore`) by index, never by an epsilon.
"""

import math
from typing import NamedTuple

import numpy as np

from termwise.renderer import spheres
from termwise.renderer.arrays import SceneArrays, ShadowRule
from termwise.renderer.geometry import paper, rays, simd
from termwise.renderer.geometry.intersect import FaceRange, Hit, Ray, make_ray
from termwise.renderer.geometry.simd import (
    bits,
    choose,
    in_lanes,
    load,
    lowest_bit,
    negative,
    put_rows,
    rows,
    splat,
    store,
)
from termwise.renderer.geometry.wave import Wave, hit_of, put_hit
from termwise.renderer.jit import device, subroutine
from termwise.renderer.scratch import OCCLUSION_RAYS, RAYS, Scratch
from termwise.renderer.spheres import Spheres
from termwise.renderer.triangles import Geometry, point_on_face, shading_normal
from termwise.renderer.vector import Vec3, column, dot, entry, is_black, length, mad, mul, negate, put_column, sub, vec3

_VECTORS = simd.available()
_EIGHT = 2**8 - 1
SAME = 2.0**-32  # of how far off and how long a way is: two points that are no further apart are one, rounded


class Surface(NamedTuple):
    """A point on a face, or on a sphere (see `renderer.spheres`), or none (face -1: the ray missed everything).

    `normal` is the shading normal, turned towards the ray's origin; `side` is +1 where that origin is on the
    side that the face's own normal points to, else -1. With `Scene.normals` of the "face" the surface is taken as seen
    from its front: `normal` is not turned, and `side` tells as before where the origin is. `b1`, `b2` are the weights
    of the face's corners 1 and 2.
    """

    point: Vec3
    normal: Vec3
    wo: Vec3
    face: int
    object: int
    side: float
    b1: float
    b2: float


@device
def turned(surface: Surface) -> Surface:
    """The same point seen from the other side, but for the way to who sees it."""
    s = surface
    return Surface(s.point, negate(s.normal), s.wo, s.face, s.object, -s.side, s.b1, s.b2)


@device
def _leaving(scene: SceneArrays, face: int) -> FaceRange:
    """What a ray passes that leaves a face (-1: none)."""
    if scene.ignore_object and face >= 0:
        thing = scene.geometry.object[face]
        return FaceRange(entry(scene.geometry.first, thing), entry(scene.geometry.first, thing + 1))
    return FaceRange(face, face + 1)


@device
def closest(scene: SceneArrays, ray: Ray, far: float, face: int, scratch: Scratch) -> Hit:
    """Nearest hit of a ray that leaves a face (-1: none)."""
    scratch.counts[RAYS] += 1
    return _nearest(scene.geometry, scene.watertight, ray, far, _leaving(scene, face), scratch.stack)


@device
def _nearest(geometry: Geometry, watertight: bool, ray: Ray, far: float, ignore: FaceRange, stack: np.ndarray) -> Hit:
    if watertight:
        hit = rays.closest_hit(geometry.corners, geometry.tree, ray, far, ignore, stack)
    else:
        hit = paper.closest_hit(geometry.corners, ray, far, ignore)
    return spheres.nearer(geometry.spheres, ray.origin, ray.direction, far, ignore, hit)


@device
def trace(scene: SceneArrays, ray: Ray, leaving: int, scratch: Scratch) -> Surface:
    """Nearest surface along a ray of unit direction, `leaving` being the face that it leaves (-1: none)."""
    return _surface(scene, closest(scene, ray, math.inf, leaving, scratch), ray.origin, ray.direction)


@device
def _surface(scene: SceneArrays, hit: Hit, origin: Vec3, direction: Vec3) -> Surface:
    wo = negate(direction)
    if hit.face < 0:
        return Surface(origin, wo, wo, -1, -1, 1.0, 0.0, 0.0)
    return _met(scene, scene.geometry.spheres, hit, wo)


@device
def _met(scene: SceneArrays, balls: Spheres | None, hit: Hit, wo: Vec3) -> Surface:
    geometry = scene.geometry
    thing = entry(geometry.object, hit.face)
    if balls is not None and hit.face >= balls.first:
        normal = spheres.normal_at(hit.b1, hit.b2)
        point = spheres.point_at(balls, hit.face - balls.first, hit.b1, hit.b2)
        outside = dot(normal, wo) >= 0.0
        if scene.face_forward and not outside:
            normal = negate(normal)
        return Surface(point, normal, wo, hit.face, thing, 1.0 if outside else -1.0, hit.b1, hit.b2)
    normal = shading_normal(geometry, hit.face, hit.b1, hit.b2)
    if scene.face_forward and dot(normal, wo) < 0.0:
        normal = negate(normal)
    side = 1.0 if dot(vec3(geometry.normals, hit.face), wo) >= 0.0 else -1.0
    point = point_on_face(geometry, hit.face, hit.b1, hit.b2)
    return Surface(point, normal, wo, hit.face, thing, side, hit.b1, hit.b2)


@device
def _place(geometry: Geometry, balls: Spheres | None, hit: Hit) -> Vec3:
    """The point that was met."""
    if balls is not None and hit.face >= balls.first:
        return spheres.point_at(balls, hit.face - balls.first, hit.b1, hit.b2)
    return point_on_face(geometry, hit.face, hit.b1, hit.b2)


@device
def shadowed(scene: SceneArrays, surface: Surface, scratch: Scratch) -> bool:
    """The paper's rule: the scene has lights, and the centre of none is visible; a light's own faces do not count."""
    return _sees_no_centre(scene, scene.shadow_rule, surface, scratch)


@device
def _sees_no_centre(scene: SceneArrays, rule: ShadowRule | None, surface: Surface, scratch: Scratch) -> bool:
    if rule is not None:
        geometry = scene.geometry
        for light in range(len(rule.object)):
            origin = surface.point
            leaving = surface.face
            while True:
                ray = make_ray(origin, sub(vec3(rule.centre, light), origin))
                hit = closest(scene, ray, 1.0, leaving, scratch)
                if hit.face < 0 or hit.t >= 1.0:
                    return False
                if geometry.object[hit.face] != rule.object[light]:
                    break
                # Through a face of the light itself.
                origin = _place(geometry, geometry.spheres, hit)
                leaving = hit.face
        return len(rule.object) > 0
    return False


@device
def occluded(scene: SceneArrays, surface: Surface, direction: Vec3, far: float, target: int, scratch: Scratch) -> bool:
    """Whether anything but face `target` lies nearer than `far` (in lengths of `direction`)."""
    geometry = scene.geometry
    ray = make_ray(surface.point, direction)
    scratch.counts[OCCLUSION_RAYS] += 1
    ignore = _leaving(scene, surface.face)
    if scene.watertight:
        found = rays.any_hit(geometry.corners, geometry.tree, ray, far, ignore, target, scratch.stack)
    else:
        found = paper.any_hit(geometry.corners, ray, far, ignore, target)
    return found or spheres.between(geometry.spheres, ray.origin, ray.direction, far, ignore, target)


@subroutine
def left_beyond(
    geometry: Geometry,
    passing: np.ndarray,
    watertight: bool,
    point: Vec3,
    face: int,
    direction: Vec3,
    far: float,
    target: int,
    stack: np.ndarray,
    counts: np.ndarray,
) -> Vec3:
    """What is left of light on a way on which something lies, from a point of a face: the product of `passing`.

    Surface by surface, for few rays meet more than the two of a pane. Through an edge a ray meets two faces in one
    place: from the same side that is one passage, and it goes on behind, or it would meet them in turn for ever.
    """
    left = Vec3(1.0, 1.0, 1.0)
    last, outwards, travelled = -1, False, 0.0
    for _ in range(2 * len(geometry.object)):
        counts[RAYS] += 1
        hit = _nearest(geometry, watertight, make_ray(point, direction), far, FaceRange(face, face + 1), stack)
        if hit.face < 0 or hit.face == target or hit.t >= far:
            break
        thing = entry(geometry.object, hit.face)
        share = vec3(passing, thing)
        if is_black(share):
            return share
        leaves = dot(vec3(geometry.normals, hit.face), direction) > 0.0
        step, place = hit.t, SAME * (travelled + length(point) / length(direction))
        again = thing == last and step <= place
        if not (again and leaves == outwards):
            left = mul(left, share)
        point = _place(geometry, geometry.spheres, hit)
        if again:
            point = mad(direction, place, point)
            step += place
        last, outwards = thing, leaves
        travelled += step
        far -= step
        face = hit.face
    return left


@device
def beyond(
    scene: SceneArrays,
    passing: np.ndarray | None,
    radiance: Vec3,
    point: Vec3,
    face: int,
    direction: Vec3,
    far: float,
    target: int,
    scratch: Scratch,
) -> Vec3:
    """What is left of a radiance behind what lies on its way to a point of a face."""
    if passing is not None:
        stack, counts = scratch.stack, scratch.counts
        left = left_beyond(
            scene.geometry, passing, scene.watertight, point, face, direction, far, target, stack, counts
        )
        return mul(radiance, left)
    return Vec3(0.0, 0.0, 0.0)


@device
def arriving(
    scene: SceneArrays, radiance: Vec3, surface: Surface, direction: Vec3, far: float, target: int, scratch: Scratch
) -> Vec3:
    """What arrives at a surface of the light that comes from a direction; `far`, `target` as in `occluded`."""
    if occluded(scene, surface, direction, far, target, scratch):
        passing = scene.materials.passing
        return beyond(scene, passing, radiance, surface.point, surface.face, direction, far, target, scratch)
    return radiance


@device
def arriving_hidden(scene: SceneArrays, radiance: Vec3, wave: Wave, i: int, far: float, scratch: Scratch) -> Vec3:
    """What arrives of the light of ray i of a wave, on which something lies: see `occlude_wave`."""
    point, direction = column(wave.origins, i), column(wave.directions, i)
    face, target = entry(wave.first, i), entry(wave.target, i)
    return beyond(scene, scene.materials.passing, radiance, point, face, direction, far, target, scratch)


@device
def put_leaving_ray(scene: SceneArrays, wave: Wave, i: int, point: Vec3, face: int) -> None:
    """Make ray i of a wave one that leaves a point of a face, its direction still to be put."""
    put_column(wave.origins, i, point)
    put_leaving(scene, wave, i, face)
    wave.target[i] = -1


@device
def put_leaving(scene: SceneArrays, wave: Wave, i: int, face: int) -> None:
    """Let ray i of a wave pass what a ray passes that leaves a face."""
    ignore = _leaving(scene, face)
    wave.first[i] = ignore.first
    wave.end[i] = ignore.end


@device
def put_all_leaving(scene: SceneArrays, wave: Wave, face: np.ndarray, count: int) -> None:
    """Let each of the first `count` rays of a wave pass what one passes that leaves its face."""
    if _VECTORS and not scene.ignore_object:
        for k in range(0, count, 8):
            its = load(face, k, 8)
            store(wave.first, k, its)
            store(wave.end, k, its + splat(np.int32(1), 8))
        return
    for i in range(count):
        put_leaving(scene, wave, i, entry(face, i))


@device
def put_occlusion_ray(scene: SceneArrays, wave: Wave, i: int, surface: Surface, direction: Vec3, target: int) -> None:
    """Make ray i of a wave one that leaves a surface; face `target` does not hide."""
    put_leaving_ray(scene, wave, i, surface.point, surface.face)
    put_column(wave.directions, i, direction)
    wave.target[i] = target


@device
def trace_wave(scene: SceneArrays, wave: Wave, count: int, coherent: bool, scratch: Scratch) -> None:
    """Nearest hits of the first `count` rays of a wave, `coherent`: they begin near each other and go the same way."""
    scratch.counts[RAYS] += count
    geometry = scene.geometry
    if scene.watertight:
        rays.closest_hits_of_wave(geometry.corners, geometry.tree, wave, count, math.inf, coherent, scratch.stack)
    else:
        for i in range(count):
            ray = make_ray(column(wave.origins, i), column(wave.directions, i))
            ignore = FaceRange(wave.first[i], wave.end[i])
            put_hit(wave, i, paper.closest_hit(geometry.corners, ray, math.inf, ignore))
    _trace_spheres(geometry.spheres, wave, count)


@device
def _trace_spheres(balls: Spheres | None, wave: Wave, count: int) -> None:
    """Put the spheres that are nearer than the faces which a wave has met in their place."""
    if balls is not None:
        for i in range(count):
            origin, direction = column(wave.origins, i), column(wave.directions, i)
            ignore = FaceRange(wave.first[i], wave.end[i])
            put_hit(wave, i, spheres.nearer(balls, origin, direction, math.inf, ignore, hit_of(wave, i)))


@device
def surface_of(scene: SceneArrays, wave: Wave, i: int) -> Surface:
    """What ray i of a wave has met."""
    return _surface(scene, hit_of(wave, i), column(wave.origins, i), column(wave.directions, i))


@device
def put_surfaces(scene: SceneArrays, wave: Wave, count: int, scratch: Scratch) -> None:
    """Find where the first `count` rays of a wave have met something: `surface_at` has it of each.

    Points and normals are those of `scratch.samples`.
    """
    _put_surfaces(scene, scene.geometry.spheres, wave, count, scratch)


@device
def _put_surfaces(scene: SceneArrays, balls: Spheres | None, wave: Wave, count: int, scratch: Scratch) -> None:
    if balls is None and _VECTORS:
        for k in range(0, count, 8):
            _put_eight(scene, wave, k, scratch)
    else:
        for i in range(count):
            _put_one(scene, wave, i, scratch)


@device
def _put_one(scene: SceneArrays, wave: Wave, i: int, scratch: Scratch) -> None:
    surface = surface_of(scene, wave, i)
    put_column(scratch.samples.point, i, surface.point)
    put_column(scratch.samples.normal, i, surface.normal)
    scratch.side[i] = surface.side


@device
def _put_eight(scene: SceneArrays, wave: Wave, k: int, scratch: Scratch) -> None:
    """Surfaces k ... k + 7, by the expressions of `_met`; those of smooth faces one by one."""
    geometry, samples = scene.geometry, scratch.samples
    face, zero = load(wave.face, k, 8), splat(0.0, 8)
    a = b = c = normal = zero, zero, zero
    smooth = 0
    left = _EIGHT & ~bits(face < splat(np.int32(0), 8))
    while left != 0:
        # Neighbours have mostly met one face.
        one = entry(wave.face, k + lowest_bit(left))
        mine = face == splat(np.int32(one), 8)
        left &= ~bits(mine)
        a = in_lanes(mine, vec3(geometry.corners[one], 0), a)
        b = in_lanes(mine, vec3(geometry.corners[one], 1), b)
        c = in_lanes(mine, vec3(geometry.corners[one], 2), c)
        normal = in_lanes(mine, vec3(geometry.normals, one), normal)
        if geometry.smooth[one]:
            smooth |= bits(mine)
    b1, b2 = load(wave.b1, k, 8), load(wave.b2, k, 8)
    b0 = splat(1.0, 8) - b1 - b2
    wo = rows(wave.directions, k)
    wo = negative(wo[0]), negative(wo[1]), negative(wo[2])
    behind = normal[0] * wo[0] + normal[1] * wo[1] + normal[2] * wo[2] < zero
    store(scratch.side, k, choose(behind, splat(-1.0, 8), splat(1.0, 8)))
    if scene.face_forward:
        normal = (
            choose(behind, negative(normal[0]), normal[0]),
            choose(behind, negative(normal[1]), normal[1]),
            choose(behind, negative(normal[2]), normal[2]),
        )
    put_rows(
        samples.point,
        k,
        (b0 * a[0] + b1 * b[0] + b2 * c[0], b0 * a[1] + b1 * b[1] + b2 * c[1], b0 * a[2] + b1 * b[2] + b2 * c[2]),
    )
    put_rows(samples.normal, k, normal)
    while smooth != 0:
        _put_one(scene, wave, k + lowest_bit(smooth), scratch)
        smooth &= smooth - 1


@device
def surface_at(scene: SceneArrays, wave: Wave, i: int, scratch: Scratch) -> Surface:
    """What ray i of a wave has met, once `put_surfaces` has found it."""
    face, wo = entry(wave.face, i), negate(column(wave.directions, i))
    if face < 0:
        return Surface(column(wave.origins, i), wo, wo, -1, -1, 1.0, 0.0, 0.0)
    point, normal = column(scratch.samples.point, i), column(scratch.samples.normal, i)
    thing = entry(scene.geometry.object, face)
    return Surface(point, normal, wo, face, thing, scratch.side[i], wave.b1[i], wave.b2[i])


@device
def occlude_wave(scene: SceneArrays, wave: Wave, count: int, far: float, coherent: bool, scratch: Scratch) -> None:
    """Which of the first `count` rays of a wave are hidden: `wave.found`, as `occluded` gives it."""
    scratch.counts[OCCLUSION_RAYS] += count
    geometry = scene.geometry
    if scene.watertight:
        rays.any_hits_of_wave(geometry.corners, geometry.tree, wave, count, far, coherent, scratch.stack)
    else:
        for i in range(count):
            ray = make_ray(column(wave.origins, i), column(wave.directions, i))
            ignore = FaceRange(wave.first[i], wave.end[i])
            wave.found[i] = paper.any_hit(geometry.corners, ray, far, ignore, wave.target[i])
    _occlude_by_spheres(geometry.spheres, wave, count, far)


@device
def _occlude_by_spheres(balls: Spheres | None, wave: Wave, count: int, far: float) -> None:
    """Find the rays of a wave hidden that a sphere hides."""
    if balls is not None:
        for i in range(count):
            if not wave.found[i]:
                origin, direction = column(wave.origins, i), column(wave.directions, i)
                ignore = FaceRange(wave.first[i], wave.end[i])
                wave.found[i] = spheres.between(balls, origin, direction, far, ignore, wave.target[i])
