"""Paths of any length, lit at every vertex by light sampling and by lobe sampling (power heuristic, Veach 1997).

What Mitsuba's `path` integrator computes, with rays and shadow rays of our own making, see `rays`, and with a roulette
that is sound for every albedo: a path of throughput t lives with probability `q = min(t / FAINT, 1)` and is divided by
it, so that t never grows, and the mean is that of all paths, however long. Mitsuba's own, `q = min(t, 0.95)`, lets
t² / q grow for ever where the albedo is above 0.975 and no light gets out: its variance is infinite there.
"""

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi

from . import rays
from .wavefront import idle, meets_surface, pixel_means

FAINT = 0.1
FIRST_HIT, ENDLESS = 1, 2**32 - 1  # vertices
# Mitsuba's roulette: where its throughput never exceeds 1, and the depth from which it plays.
SOUND, START = 0.95, 8
LONGEST = 2**14  # vertices after which all but the tail of the light has to be gone
TAIL = 5e-4


def sound(loaded: Any, role: str) -> bool:
    """Whether the variance of Mitsuba's `path` is finite in the scene of a role."""
    return loaded.description["reflected"][role] <= SOUND


def built_in(*, first_hit: bool) -> dict[str, Any]:
    """Describe Mitsuba's `path`: camera to surface to light alone, or of any length."""
    return {"type": "path"} | ({"max_depth": 2, "rr_depth": 3} if first_hit else {"max_depth": -1, "rr_depth": START})


def reflected(loaded: Any, role: str, *, most: int = ENDLESS) -> Callable[[Any, Any, Any], Any]:
    """(ray, sampler, active) -> light that is reflected at least once, none emitted along the ray, mi.Color3f.

    `role` : of the scene. `most` : vertices of a path. Surfaces of lights are black and end a path.
    """
    scene = loaded.scenes[role]
    if most == ENDLESS:
        check_end(loaded, role)

    def radiance(ray: Any, sampler: Any, active: Any) -> Any:
        return _followed(scene, most, ray, sampler, active)

    return radiance


def survival(throughput: Any, faint: float) -> Any:
    """Probability that a path goes on."""
    return dr.minimum(dr.max(throughput) / faint, 1.0)


@dr.syntax
def _followed(scene: Any, most: int, ray: Any, sampler: Any, active: Any) -> Any:
    si = scene.ray_intersect(ray, active)
    throughput, color = mi.Color3f(1.0), mi.Color3f(0.0)
    vertices, last = mi.UInt32(0), dr.opaque(mi.UInt32, most)
    active = mi.Bool(active & meets_surface(si) & (vertices < last))
    while active:
        light, weight, _, si, active = vertex(scene, si, sampler, active)
        color += throughput * light
        throughput *= weight
        vertices += 1
        alive = survival(throughput, FAINT)
        active &= (vertices < last) & meets_surface(si) & (sampler.next_1d(active) < alive)
        throughput *= dr.select(active, dr.rcp(alive), 0.0)
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
    lit &= ~rays.meets(scene, rays.segment(si, ds.p, rays.normal_of(ds)), lit)
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
        alone = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
        share = dr.select(alone, 1.0, _power_heuristic(bs.pdf, chance))
        color += dr.select(shining, weight * emitter.eval(met, shining) * share, 0.0)
    return color, weight, ray, met, active


def _power_heuristic(a: Any, b: Any) -> Any:
    ratio = b / dr.maximum(a, 1e-20)
    return dr.select(a > 0.0, dr.rcp(1.0 + ratio * ratio), 0.0)


def check_end(loaded: Any, role: str) -> None:
    """Refuse a scene in which light goes on for ever, or as good as: its paths would not end.

    Raises
    ------
    ValueError : how much of the light is left after how many reflections.
    """
    reflected = loaded.description["reflected"][role]
    if reflected**LONGEST < TAIL or role in loaded.ending:
        return
    scene = loaded.scenes[role]
    side, spp = (8, 2) if dr.is_jit_v(mi.Float) else (4, 1)
    camera = loaded.description["camera"] | {"resolution": [side, side]}
    share = float(pixel_means(lambda s: (_left(scene, s.ray, s.sampler),), camera, spp=spp, seed=0).mean())
    if share > TAIL:
        through = loaded.description["transparent"] and role in ("physical", "physical-sky", "physical-lights")
        fields, sent = ("color, transparency", "reflected or let through") if through else ("color", "reflected")
        raise ValueError(
            f"objects: {fields}: up to {reflected:g} of the light is {sent}, and {100 * share:.3g} % of it is left "
            f"after {LONGEST} surfaces: allowed is less where no light gets out"
        )
    loaded.ending.add(role)


@dr.syntax
def _left(scene: Any, ray: Any, sampler: Any) -> Any:
    """What is left of a path's throughput after `LONGEST` vertices."""
    context = mi.BSDFContext()
    si = scene.ray_intersect(ray)
    active = mi.Bool(meets_surface(si))
    throughput = mi.Color3f(dr.select(active, 1.0, 0.0))
    vertices, last = mi.UInt32(0), dr.opaque(mi.UInt32, LONGEST)
    while active:
        bs, weight = si.bsdf().sample(context, si, sampler.next_1d(active), sampler.next_2d(active), active)
        si = scene.ray_intersect(rays.spawn(si, si.to_world(bs.wo)), active)
        throughput *= dr.select(meets_surface(si), weight, 0.0)
        vertices += 1
        active &= (vertices < last) & dr.any(throughput != 0.0)
    return throughput
