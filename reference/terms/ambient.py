"""Ambient: `color (1 - g) L_a0 (1/π) ∫ hit(w) mu dw`, hit(w) = 1 where nothing lies within the range.

Infinite range: Mitsuba's `direct` integrator under a `constant` emitter of radiance L_a0. Finite range: no built-in
has one, so cosine-distributed rays of limited length are cast here. Range 0: ambient occlusion is off.
"""

from typing import Any

import drjit as dr
import mitsuba as mi

from ..wavefront import Estimator, Samples, idle

RAYS = 4  # occlusion rays per camera ray: they share the primary hit
UNBOUNDED = 1e30
INTEGRATOR = {"type": "direct", "emitter_samples": 0, "bsdf_samples": RAYS, "hide_emitters": True}


def estimator(loaded: Any, limit: dict[str, Any]) -> Estimator:
    """Samples -> (ambient term,); unbiased."""

    def estimate(samples: Samples) -> tuple[Any]:
        return (radiance(samples.ray, samples.sampler, True),)

    radiance = incoming(loaded, limit)
    return estimate


def incoming(loaded: Any, limit: dict[str, Any]) -> Any:
    """(ray, sampler, active) -> the term seen along the ray; black where it misses."""
    scene = loaded.scenes["ambient"]
    reach = loaded.description["ambient"]["range"]
    if reach >= UNBOUNDED:
        direct = mi.load_dict(INTEGRATOR)

        def unbounded(ray: Any, sampler: Any, active: Any) -> Any:
            color, valid, _ = direct.sample(scene, sampler, mi.RayDifferential3f(ray), None, active)
            return dr.select(valid & active, color, 0.0)

        return unbounded

    color = dr.opaque(mi.Color3f, loaded.description["ambient"]["color"])

    def bounded(ray: Any, sampler: Any, active: Any) -> Any:
        si = scene.ray_intersect(ray, active)
        active = si.is_valid() & active
        if idle(active):
            return mi.Color3f(0.0)
        albedo = si.bsdf().eval_diffuse_reflectance(si, active)
        if reach == 0.0:
            return dr.select(active, albedo * color, 0.0)
        side = dr.mulsign(
            mi.Float(1.0), si.wi.z
        )  # the shading normal turned to the viewer, as `twosided` does
        seen = mi.Float(0.0)
        for _ in range(RAYS):
            local = mi.warp.square_to_cosine_hemisphere(sampler.next_2d(active))
            occlusion_ray = si.spawn_ray(si.to_world(local * side))
            occlusion_ray.maxt = dr.opaque(mi.Float, reach)
            seen += dr.select(scene.ray_test(occlusion_ray, active), 0.0, 1.0)
        return dr.select(active, albedo * color * (seen / RAYS), 0.0)

    return bounded
