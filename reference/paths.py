"""Paths lit at every vertex by light sampling and by lobe sampling, weighted by the power heuristic (Veach 1997).

What Mitsuba's `path` integrator computes, with rays and shadow rays of our own making, see `rays`. No roulette: the
survival probability of Mitsuba's, capped at 0.95, has infinite variance for albedos above 0.975.
"""

from typing import Any

import drjit as dr
import mitsuba as mi

from . import rays
from .wavefront import idle, meets_surface


def reflected(scene: Any, depth: int) -> Any:
    """(ray, sampler, active) -> light that is reflected at least once, none emitted along the ray, mi.Color3f.

    `depth` : segments of the longest paths, that of the camera and that to the light included. Surfaces of lights are
    black and end a path.
    """

    def radiance(ray: Any, sampler: Any, active: Any) -> Any:
        return _followed(scene, depth, ray, sampler, active)

    return radiance


@dr.syntax
def _followed(scene: Any, depth: int, ray: Any, sampler: Any, active: Any) -> Any:
    si = scene.ray_intersect(ray, active)
    active = mi.Bool(active & meets_surface(si))
    throughput, color = mi.Color3f(1.0), mi.Color3f(0.0)
    vertices, last = mi.UInt32(1), dr.opaque(mi.UInt32, depth)
    while active:
        light, weight, _, si, active = vertex(scene, si, sampler, active)
        color += throughput * light
        throughput *= weight
        vertices += 1
        active &= (vertices < last) & meets_surface(si)
    return color


def vertex(scene: Any, si: Any, sampler: Any, active: Any) -> tuple[Any, Any, Any, Any, Any]:
    """What one vertex reflects directly, and how its path goes on.

    Returns
    -------
    light : mi.Color3f, by light sampling and lobe sampling.
    weight, ray, si, active : of the continuation: `f mu / density`, and what its ray meets in the scene of the lights.
    """
    context, bsdf = mi.BSDFContext(), si.bsdf()
    ds, light = scene.sample_emitter_direction(si, sampler.next_2d(active), False, active)
    lit = active & (ds.pdf > 0.0)
    value, pdf = bsdf.eval_pdf(context, si, si.to_local(ds.d), lit)
    lit &= dr.any(value != 0.0)
    lit &= ~scene.ray_test(rays.segment(si, ds.p, rays.normal_of(ds)), lit)
    # Lobe sampling cannot meet a point light.
    share = dr.select(ds.delta, 1.0, _power_heuristic(ds.pdf, pdf))
    color = dr.select(lit, value * light * share, 0.0)

    bs, weight = bsdf.sample(context, si, sampler.next_1d(active), sampler.next_2d(active), active)
    active = active & dr.any(weight != 0.0)
    ray = rays.spawn(si, si.to_world(bs.wo))
    met = scene.ray_intersect(ray, active)
    emitter = met.emitter(scene, active)
    shining = active & (emitter != None)  # noqa: E711  a lane-wise comparison of pointers
    if not idle(shining):
        chance = scene.pdf_emitter_direction(si, mi.DirectionSample3f(scene, met, si), shining)
        share = _power_heuristic(bs.pdf, chance)
        color += dr.select(shining, weight * emitter.eval(met, shining) * share, 0.0)
    return color, weight, ray, met, active


def _power_heuristic(a: Any, b: Any) -> Any:
    ratio = b / dr.maximum(a, 1e-20)
    return dr.select(a > 0.0, dr.rcp(1.0 + ratio * ratio), 0.0)
