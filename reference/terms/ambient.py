"""Ambient: `color (1 - g) L_a0 (1/π) ∫ hit(w) mu dw`, hit(w) = 1 where nothing lies within the range.

Cosine-distributed rays as long as the range are cast. Range 0, or a limit without occlusion: AO is 1.
With N rings the integral is `(2/N) Σ mu_k hit_k`, mu_k = k / (N + 1), its azimuths uniform. Where the paper's shadow
rule makes a point dark, its albedo is `color`. Where the ambient light is a textured sky, it is looked up along each
ray, in the place of L_a0. Of a translucent surface each ray leaves the side that it is of, with that side's share.
"""

from typing import Any

import drjit as dr
import mitsuba as mi

from .. import rays
from ..wavefront import UNBOUNDED, Estimator, Samples, idle
from . import shadows

RAYS = 4  # occlusion rays per camera ray: they share the primary hit
INTEGRATOR = {"type": "direct", "emitter_samples": 0, "bsdf_samples": RAYS, "hide_emitters": True}


def estimator(loaded: Any, limit: dict[str, Any]) -> Estimator:
    """Samples -> (ambient term,); unbiased."""

    def estimate(samples: Samples) -> tuple[Any]:
        return (radiance(samples.ray, samples.sampler, True),)

    radiance = incoming(loaded, limit)
    return estimate


def incoming(loaded: Any, limit: dict[str, Any], *, occlusion_rays: int = RAYS) -> Any:
    """(ray, sampler, active) -> the term seen along the ray; black where it misses."""
    scene = loaded.scenes["ambient"]
    reach = loaded.description["ambient"]["range"] if limit["occluded"] else 0.0
    dark = shadows.rule(loaded, limit, "ambient")
    light = light_of(loaded)

    def radiance(ray: Any, sampler: Any, active: Any) -> Any:
        si = scene.ray_intersect(ray, active)
        active = si.is_valid() & active
        if idle(active):
            return mi.Color3f(0.0)
        albedo = si.bsdf().eval_diffuse_reflectance(si, active)
        if limit["shadows"] == "paper":
            plain = loaded.scenes["color"].ray_intersect(ray, active)
            color_alone = plain.bsdf().eval_diffuse_reflectance(plain, active)
            albedo = dr.select(dark(si, active), color_alone, albedo)
        constant = loaded.description["ambient"]["color"] is not None
        if reach == 0.0 and constant:
            return dr.select(active, albedo * light(ray, active), 0.0)
        seen = mi.Color3f(0.0)
        share = rays.crossing(loaded, si, active)
        for _ in range(occlusion_rays):
            if limit["rings"] is None or reach == 0.0:
                local, weight = mi.warp.square_to_cosine_hemisphere(sampler.next_2d(active)), 1.0
            else:
                local = ring_direction(sampler.next_2d(active), limit["rings"])
                weight = 2.0 * local.z
            side = rays.sampled_side(loaded, si, share, sampler, active)
            occlusion_ray = rays.spawn(si, si.to_world(local * side))
            sent = weight * light(occlusion_ray, active)
            if reach == 0.0:
                seen += sent
                continue
            if reach < UNBOUNDED:
                occlusion_ray.maxt = dr.opaque(mi.Float, reach)
            seen += rays.arriving(loaded, scene, si, occlusion_ray, sent, active)
        return dr.select(active, albedo * (seen / occlusion_rays), 0.0)

    return radiance


def light_of(loaded: Any) -> Any:
    """(ray, active) -> the ambient light that comes against a ray: L_a0, or the textured sky's."""
    color = loaded.description["ambient"]["color"]
    if color is None:
        return loaded.sky
    opaque = dr.opaque(mi.Color3f, color)
    return lambda ray, active: opaque


def built_in(loaded: Any, limit: dict[str, Any]) -> bool:
    """Whether the limit is that of Mitsuba's own integrator."""
    bounded = loaded.description["ambient"]["range"] < UNBOUNDED
    plain = limit["occluded"] and limit["rings"] is None and limit["shadows"] == "physical"
    constant = loaded.description["ambient"]["color"] is not None
    return plain and constant and not bounded and rays.plain(loaded)


def ring_direction(sample: Any, rings: int) -> Any:
    """Local direction of a random azimuth on one of N rings `mu_k = k / (N + 1)`, all as likely."""
    count = dr.opaque(mi.Float, rings)
    mu = (dr.minimum(dr.floor(sample.x * count), count - 1.0) + 1.0) / (count + 1.0)
    sin_phi, cos_phi = dr.sincos(2.0 * dr.pi * sample.y)
    radius = dr.safe_sqrt(1.0 - mu * mu)
    return mi.Vector3f(radius * cos_phi, radius * sin_phi, mu)
