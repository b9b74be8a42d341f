"""Specular: `L_specular(x) = g (k S + k_d H)[L_ambient + L_direct + L_specular + L_sky]`, M lobes deep.

S is the integral against the Cook-Torrance lobe, of factor k (`lobe`), H against a white Lambertian one, of factor k_d
(`diffuse`). A chain of up to M samples of them is traced. The sky is added where it leaves the scene; the diffuse terms
at the vertices 1..M are estimated at one of them a chain, all as likely, with weight M: the same mean as at every
vertex for a fraction of the work. Lights are never met: their surfaces are black and end the chain.

Where a surface is transparent, S has what it lets through too at every vertex but the camera's, whose lobe says which
term the chain is of, this or `transmission`. Vertices on clear glass have no diffuse terms, and chains have many of
them: there the one is chosen among those that may have any, as all are passed, with their number for its weight.
"""

import functools
import operator
from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi

from .. import rays
from ..wavefront import Estimator, Samples, shape_pointer
from . import ambient, direct, shadows


def estimator(loaded: Any, limit: dict[str, Any], *, occlusion_rays: int = ambient.RAYS) -> Estimator:
    """Samples -> (specular term,); unbiased but for `direct` with a kernel, which `kernel_reference` adds itself."""
    # What the other terms are does not vary with the specular variant.
    plain = limit | {"rings": None}
    terms = [(limit["ambient"], ambient.incoming(loaded, plain, occlusion_rays=occlusion_rays))]
    if limit["kernel"] is None:
        terms.append((1.0, direct.incoming(loaded, plain)))
    return gathered(segments(loaded, limit, lobes(loaded, limit)), terms)


def gathered(chain: Any, terms: Sequence[tuple[float, Any]]) -> Estimator:
    """Samples -> (specular term,): `chain`, of `segments`, lit by the terms with their factors."""

    def estimate(samples: Samples) -> tuple[Any]:
        color, ray, weight, active = chain(samples)
        dr.eval(color, ray, weight, active)  # one kernel for the chain, one for each diffuse term
        for factor, term in terms:
            color += weight * dr.opaque(mi.Float, factor) * term(ray, samples.sampler, active)
        return (color,)

    return estimate


def segments(loaded: Any, limit: dict[str, Any], sample_lobes: Any) -> Any:
    """Samples -> the sky's light along a chain; and ray, weight and existence of the segment to the chosen vertex."""
    bounces = loaded.description["max_bounces"]
    dark = shadows.rule(loaded, limit, "specular")
    first = loaded.scenes[limit["term"]]

    def chain(samples: Samples) -> Any:
        if bounces == 0:
            return mi.Color3f(0.0), samples.ray, mi.Color3f(0.0), mi.Bool(False)
        return _chain(loaded, first, bounces, sample_lobes, dark, samples)

    return chain


@dr.syntax
def _chain(loaded: Any, first: Any, bounces: int, sample_lobes: Any, dark: Any, samples: Samples) -> Any:
    """Follow the lobes, that of the camera's vertex in a scene of its own; the weight is the chosen vertex's."""
    scene, sky_radiance = loaded.scenes.get("chain", loaded.scenes["specular"]), loaded.sky
    transparent, black = loaded.description["transparent"], _black(loaded, scene)
    sampler = samples.sampler
    last = dr.opaque(mi.UInt32, bounces)
    chosen = dr.minimum(mi.UInt32(samples.choice * mi.Float(last)), last - 1)
    ray = mi.Ray3f(samples.ray)
    si = first.ray_intersect(ray)
    active = mi.Bool(si.is_valid())
    active = dr.select(dark(si, active), False, active)
    throughput = mi.Color3f(1.0)
    color = mi.Color3f(0.0)
    depth = mi.UInt32(0)
    kept_ray = mi.Ray3f(samples.ray)
    kept_weight = mi.Color3f(0.0)
    kept = mi.Bool(False)
    lit = mi.UInt32(0)
    while active:
        point = dr.select(depth == 0, samples.lobe, sampler.next_2d(active))
        direction, weight = sample_lobes(si, point, sampler, active)
        throughput *= weight
        active &= dr.any(throughput != 0.0)
        ray, si = rays.leave(loaded, scene, si, rays.spawn(si, si.to_world(direction)), active)
        color += throughput * sky_radiance(ray, active & (si.t == dr.inf))
        active &= si.is_valid()
        if transparent:
            may = active & (black(si) == False)  # noqa: E712  of lanes
            lit += dr.select(may, mi.UInt32(1), 0)
            here = may & (sampler.next_1d(may) * mi.Float(lit) < 1.0)
        else:
            here = active & (depth == chosen)
        kept_ray = dr.select(here, ray, kept_ray)
        kept_weight = dr.select(here, throughput, kept_weight)
        kept |= here
        depth += 1
        active = dr.select(dark(si, active), False, active & (depth < last))
    return color, kept_ray, kept_weight * mi.Float(lit if transparent else bounces), kept


def _black(loaded: Any, scene: Any) -> Any:
    """(si) -> whether what is met is black in all diffuse terms."""
    shapes = [
        shape_pointer(shape)
        for shape, albedo in zip(scene.shapes(), loaded.description["diffuse"], strict=True)
        if not any(albedo)
    ]
    return lambda si: functools.reduce(operator.or_, (si.shape == each for each in shapes), mi.Bool(False))


def lobes(loaded: Any, limit: dict[str, Any]) -> Any:
    """(si, point, sampler, active) -> local direction and weight of one sample of `g (k S + k_d H)`, by the point."""
    lobe, diffuse = limit["lobe"], limit["diffuse"]
    outgoing = limit["cosine"] == "outgoing"
    if outgoing and limit["rings"] is not None:
        raise ValueError("limit: cosine = 'outgoing' with rings: allowed is one of the two")
    if loaded.description["transparent"]:
        for name, plain in (("diffuse", 0.0), ("cosine", "incident"), ("rings", None)):
            if limit[name] != plain:
                raise ValueError(f"limit: {name} = {limit[name]!r}: allowed with a transparent surface is {plain!r}")
    context = mi.BSDFContext()
    factor = dr.opaque(mi.Float, lobe)

    def scaled(si: Any, wo: Any, weight: Any) -> Any:
        """The factor is of what is reflected."""
        if not loaded.description["transparent"]:
            return weight * factor
        return weight * dr.select(si.wi.z * wo.z > 0.0, factor, 1.0)

    def shown(si: Any) -> Any:
        # `twosided` turns the lobe to the viewer; about the normal of a face it is 0 from behind.
        return True if loaded.description["normals"] == "viewer" else si.wi.z > 0.0

    def visible_normals(si: Any, point: Any, sampler: Any, active: Any) -> tuple[Any, Any]:
        bs, weight = si.bsdf().sample(context, si, sampler.next_1d(active), point, active)
        weight = scaled(si, bs.wo, weight)
        if outgoing:
            # The view's cosine in place of the light's; the weight's G1 falls as fast as the latter.
            ratio = mi.Frame3f.cos_theta(si.wi) / mi.Frame3f.cos_theta(bs.wo)
            weight = dr.select(dr.any(weight != 0.0), weight * ratio, 0.0)
        return bs.wo, dr.select(shown(si), weight, 0.0)

    def either(si: Any, point: Any, sampler: Any, active: Any) -> tuple[Any, Any]:
        wo, weight = visible_normals(si, point, sampler, active)
        share = diffuse / (diffuse + lobe)
        gloss = si.bsdf().eval_diffuse_reflectance(si, active)
        cosine = rays.side(loaded, si) * mi.warp.square_to_cosine_hemisphere(point)
        chosen = sampler.next_1d(active) < share
        return dr.select(chosen, cosine, wo), dr.select(chosen, gloss * (diffuse / share), weight / (1.0 - share))

    def on_rings(si: Any, point: Any, sampler: Any, active: Any) -> tuple[Any, Any]:
        local = ambient.ring_direction(point, limit["rings"])
        wo = rays.side(loaded, si) * local
        bsdf = si.bsdf()
        gloss = bsdf.eval_diffuse_reflectance(si, active)
        weight = (2.0 * dr.pi) * factor * dr.select(shown(si), bsdf.eval(context, si, wo, active), 0.0)
        return wo, weight + gloss * (2.0 * diffuse * local.z)

    if limit["rings"] is not None:
        return on_rings
    return either if diffuse > 0.0 else visible_normals
