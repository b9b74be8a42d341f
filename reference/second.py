"""Second integrators: the same integrals by other sampling, which the references themselves are audited by.

- ambient: directions uniform on the hemisphere, `2 mu hit(w)`, nearest hits in the place of occlusion rays;
- direct: paths that light sampling alone lights, in the place of two strategies, with a roulette that begins elsewhere;
- specular, transmission: directions from an even mixture of cosine and lobe, `f mu / ((p_lobe + mu / pi) / 2)`, in
  the place of the lobe's own weight, and the second integrators above at the vertices. Where a surface is transparent,
  the cosine is that of either side, and has half the density. What single precision gives one direction, which no
  cosine meets, keeps its weight.

Which limits have one says `reference.has_second`; the others are held by closed forms in the tests.
"""

from typing import Any

import drjit as dr
import mitsuba as mi

from . import rays
from .terms import ambient, direct, specular
from .wavefront import Estimator, idle

FAINT = 0.5  # the throughput below which the roulette plays: another than that of the references


def estimator(loaded: Any, limit: dict[str, Any]) -> Estimator:
    """Samples -> (term,); unbiased."""
    if limit["term"] in ("specular", "transmission"):
        parts = [(limit["ambient"], _ambient(loaded, limit)), (1.0, _direct(loaded, limit))]
        return specular.gathered(specular.segments(loaded, limit, _mixture(loaded, limit)), parts)
    radiance = {"ambient": _ambient, "direct": _direct}[limit["term"]](loaded, limit)
    return lambda samples: (radiance(samples.ray, samples.sampler, True),)


def _ambient(loaded: Any, _limit: dict[str, Any]) -> Any:
    """(ray, sampler, active) -> the term seen along the ray; black where it misses."""
    scene = loaded.scenes["ambient"]
    reach = dr.opaque(mi.Float, loaded.description["ambient"]["range"])
    light = ambient.light_of(loaded)

    def radiance(ray: Any, sampler: Any, active: Any) -> Any:
        si = scene.ray_intersect(ray, active)
        active = si.is_valid() & active
        if idle(active):
            return mi.Color3f(0.0)
        albedo = si.bsdf().eval_diffuse_reflectance(si, active)
        seen = mi.Color3f(0.0)
        share = rays.crossing(loaded, si, active)
        for number in range(ambient.RAYS):
            local = mi.warp.square_to_uniform_hemisphere(sampler.next_2d(active))
            weight = 2.0 * local.z
            side = rays.side(loaded, si)
            if share is not None:  # by turns on either side, whatever its share
                side, weight = (-side, 2.0 * share * weight) if number % 2 else (side, 2.0 * (1.0 - share) * weight)
            ray = rays.spawn(si, si.to_world(local * side))
            met = scene.ray_intersect(ray, active)
            seen += dr.select(met.is_valid() & (met.t < reach), 0.0, weight * light(ray, active))
        return dr.select(active, albedo * (seen / ambient.RAYS), 0.0)

    return radiance


def _direct(loaded: Any, limit: dict[str, Any]) -> Any:
    """(ray, sampler, active) -> the term seen along the ray."""
    if not loaded.description["has_lights"]:
        return lambda ray, sampler, active: mi.Color3f(0.0)
    most = direct.longest(loaded, limit)
    factor = dr.opaque(mi.Float, loaded.description["irradiance_factor"])
    return lambda ray, sampler, active: factor * direct.followed(loaded, most, FAINT, ray, sampler, active)


def _mixture(loaded: Any, limit: dict[str, Any]) -> Any:
    """(si, point, sampler, active) -> local direction and weight of one sample of `k g S`."""
    context = mi.BSDFContext()
    factor = dr.opaque(mi.Float, limit["lobe"])
    transparent = loaded.description["transparent"]

    def sample(si: Any, point: Any, sampler: Any, active: Any) -> tuple[Any, Any]:
        bsdf = si.bsdf()
        by_lobe, weight = bsdf.sample(context, si, sampler.next_1d(active), point, active)
        cosine = rays.side(loaded, si) * mi.warp.square_to_cosine_hemisphere(sampler.next_2d(active))
        sides = 1.0
        if transparent:
            cosine.z = dr.select(sampler.next_1d(active) < 0.5, -cosine.z, cosine.z)
            sides = 2.0
        chosen = sampler.next_1d(active) < 0.5
        wo = dr.select(chosen, by_lobe.wo, cosine)
        value, density = bsdf.eval_pdf(context, si, wo, active)
        density = 0.5 * (density + dr.abs(wo.z) * (dr.inv_pi / sides))
        mixed = dr.select(density > 0.0, factor * value / density, 0.0)
        if transparent:
            # A reflected direction below the surface is no sample of what goes through it.
            astray = chosen & dr.all(weight == 0.0)
            alone = chosen & mi.has_flag(by_lobe.sampled_type, mi.BSDFFlags.Delta)
            mixed = dr.select(astray, 0.0, dr.select(alone, 2.0 * weight, mixed))
        return wo, mixed

    return sample
