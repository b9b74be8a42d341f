"""Direct: `color (1 - g) E / π`, E from the lights alone, over the first hit or over all diffuse bounces.

Paths (see `paths`) in a scene whose surfaces are all diffuse with albedo `color (1 - g)`. Where the scene's rays or
normals are not Mitsuba's, they are lit by light sampling alone.
"""

import functools
from typing import Any

import drjit as dr
import mitsuba as mi

from .. import paths, rays
from ..wavefront import Estimator, Samples, meets_surface
from . import shadows


def estimator(loaded: Any, limit: dict[str, Any]) -> Estimator:
    """Samples -> (direct term,); unbiased."""

    def estimate(samples: Samples) -> tuple[Any]:
        return (radiance(samples.ray, samples.sampler, True),)

    radiance = incoming(loaded, limit)
    return estimate


def incoming(loaded: Any, limit: dict[str, Any]) -> Any:
    """(ray, sampler, active) -> the term seen along the ray; black where it misses or meets a light's surface."""
    if not loaded.description["has_lights"]:
        return lambda ray, sampler, active: mi.Color3f(0.0)
    most = longest(loaded, limit)
    if rays.plain(loaded):
        radiance = paths.reflected(loaded, "direct", most=most)
    else:
        radiance = functools.partial(followed, loaded, most, paths.FAINT)
    factor = dr.opaque(mi.Float, loaded.description["irradiance_factor"])
    dark = shadows.rule(loaded, limit, "diffuse")

    def read(ray: Any, sampler: Any, active: Any) -> Any:
        color = factor * radiance(ray, sampler, active)
        if limit["shadows"] == "physical":
            return color
        si = loaded.scenes["diffuse"].ray_intersect(ray, active)
        return dr.select(dark(si, si.is_valid()), 0.0, color)

    return read


@dr.syntax
def followed(loaded: Any, most: int, faint: float, ray: Any, sampler: Any, active: Any) -> Any:
    """As `paths.reflected`, by the scene's own rays and normals, lit by light sampling alone.

    A path has at most so many vertices, and below the throughput `faint` the roulette plays for it.
    """
    scene = loaded.scenes["direct"]
    si = scene.ray_intersect(ray, active)
    active = mi.Bool(active & meets_surface(si))
    throughput, color = mi.Color3f(1.0), mi.Color3f(0.0)
    vertices, last = mi.UInt32(0), dr.opaque(mi.UInt32, most)
    while active:
        throughput *= si.bsdf().eval_diffuse_reflectance(si, active)
        ds, light = scene.sample_emitter_direction(si, sampler.next_2d(active), False, active)
        cosine = _received(loaded, si, dr.dot(si.sh_frame.n, ds.d), active)
        lit = active & (ds.pdf > 0.0) & (cosine > 0.0)
        sent = throughput * light * (cosine * dr.inv_pi)
        shadow = rays.segment(si, ds.p, rays.normal_of(ds))
        color += dr.select(lit, rays.arriving(loaded, scene, si, shadow, sent, lit), 0.0)
        local = mi.warp.square_to_cosine_hemisphere(sampler.next_2d(active))
        side = _left(loaded, si, sampler, active)
        _, si = rays.leave(loaded, scene, si, rays.spawn(si, si.to_world(side * local)), active)
        vertices += 1
        alive = paths.survival(throughput, faint)
        active &= (vertices < last) & meets_surface(si) & (sampler.next_1d(active) < alive)
        throughput *= dr.select(active, dr.rcp(alive), 0.0)
    return color


def _received(loaded: Any, si: Any, cosine: Any, active: Any) -> Any:
    """|cosine| to the shading normal, times the share of light from there that is scattered towards the viewer."""
    cosine = rays.side(loaded, si) * cosine
    share = rays.crossing(loaded, si, active)
    if share is None:
        return dr.maximum(cosine, 0.0)
    return dr.select(cosine > 0.0, (1.0 - share) * cosine, -share * cosine)


def _left(loaded: Any, si: Any, sampler: Any, active: Any) -> Any:
    """Sign of the shading frame's z on the side that a path leaves to."""
    return rays.sampled_side(loaded, si, rays.crossing(loaded, si, active), sampler, active)


def longest(loaded: Any, limit: dict[str, Any]) -> int:
    """The most vertices of a path that the scope of a limit has."""
    if limit["scope"] == "first-hit":
        return paths.FIRST_HIT
    paths.check_end(loaded, "direct")
    return paths.ENDLESS
