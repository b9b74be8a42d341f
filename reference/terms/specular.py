"""Specular: `L_specular(x) = k g S[L_ambient + L_direct + L_specular + L_sky]`, M lobes deep.

A chain of up to M lobe samples is traced. The sky is added where it leaves the scene; the diffuse terms at the vertices
1..M are estimated at one of them a chain, vertex `1 + (number mod M)`, with weight M: the same mean as at every vertex
for a fraction of the work. Lights are never met: their surfaces are black and end the chain.
"""

from typing import Any

import drjit as dr
import mitsuba as mi

from ..wavefront import Estimator, Samples
from . import ambient, direct


def estimator(loaded: Any, limit: dict[str, Any]) -> Estimator:
    """Samples -> (specular term,); unbiased but for the depth of `direct`."""
    bounces = loaded.description["max_bounces"]
    diffuse_terms = [term.incoming(loaded, limit) for term in (ambient, direct)]

    def estimate(samples: Samples) -> tuple[Any]:
        if bounces == 0:
            return (mi.Color3f(0.0),)
        color, ray, weight, active = _chain(
            loaded.scenes["specular"], loaded.sky, bounces, limit["lobe"], samples
        )
        dr.eval(color, ray, weight, active)  # one kernel for the chain, one for each diffuse term
        for term in diffuse_terms:
            color += weight * mi.Float(bounces) * term(ray, samples.sampler, active)
        return (color,)

    return estimate


@dr.syntax
def _chain(scene: Any, sky_radiance: Any, bounces: int, lobe: float, samples: Samples) -> Any:
    """Follow the lobe: the sky's light, and ray, weight and existence of the segment to the chosen vertex."""
    sampler = samples.sampler
    last, factor = dr.opaque(mi.UInt32, bounces), dr.opaque(mi.Float, lobe)
    chosen = samples.number % last
    context = mi.BSDFContext()
    ray = mi.Ray3f(samples.ray)
    si = scene.ray_intersect(ray)
    active = mi.Bool(si.is_valid())
    throughput = mi.Color3f(1.0)
    color = mi.Color3f(0.0)
    depth = mi.UInt32(0)
    kept_ray = mi.Ray3f(samples.ray)
    kept_weight = mi.Color3f(0.0)
    kept = mi.Bool(False)
    while active:
        bs, weight = si.bsdf().sample(context, si, sampler.next_1d(active), sampler.next_2d(active), active)
        throughput *= weight * factor
        active &= dr.any(throughput != 0.0)
        ray = si.spawn_ray(si.to_world(bs.wo))
        si = scene.ray_intersect(ray, active)
        color += throughput * sky_radiance(ray, active & (si.t == dr.inf))
        active &= si.is_valid()
        here = active & (depth == chosen)
        kept_ray = dr.select(here, ray, kept_ray)
        kept_weight = dr.select(here, throughput, kept_weight)
        kept |= here
        depth += 1
        active &= depth < last
    return color, kept_ray, kept_weight, kept
