"""Direct: `color (1 - g) E / π`, E from the lights alone, over the first hit or over all diffuse bounces.

Paths (see `paths`) in a scene whose surfaces are all diffuse with albedo `color (1 - g)`. Where the scene's rays or
normals are not Mitsuba's, they are lit by light sampling alone.
"""

import functools
from typing import Any

import drjit as dr
import mitsuba as mi

from .. import paths, rays
from ..wavefront import Estimator, Samples, meets_surface, pixel_means
from . import shadows

FIRST_HIT = 2  # segments: camera to surface, surface to light
DEPTHS = (2, 4, 8, 16, 32, 64, 128, 256)
TAIL = 5e-4


def estimator(loaded: Any, limit: dict[str, Any]) -> Estimator:
    """Samples -> (direct term,); unbiased but for the tail beyond the depth, below 0.05 % of the image."""

    def estimate(samples: Samples) -> tuple[Any]:
        return (radiance(samples.ray, samples.sampler, True),)

    radiance = incoming(loaded, limit)
    return estimate


def incoming(loaded: Any, limit: dict[str, Any]) -> Any:
    """(ray, sampler, active) -> the term seen along the ray; black where it misses or meets a light's surface."""
    if not loaded.description["has_lights"]:
        return lambda ray, sampler, active: mi.Color3f(0.0)
    depth = depth_of(loaded, limit)
    by_path = paths.reflected(loaded.scenes["direct"], depth)
    radiance = by_path if rays.plain(loaded) else functools.partial(followed, loaded, depth)
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
def followed(loaded: Any, depth: int, ray: Any, sampler: Any, active: Any) -> Any:
    """As `paths.reflected`, by the scene's own rays and normals, lit by light sampling alone."""
    scene = loaded.scenes["direct"]
    si = scene.ray_intersect(ray, active)
    active = mi.Bool(active & meets_surface(si))
    throughput, color = mi.Color3f(1.0), mi.Color3f(0.0)
    vertices, last = mi.UInt32(1), dr.opaque(mi.UInt32, depth)
    while active:
        throughput *= si.bsdf().eval_diffuse_reflectance(si, active)
        side = rays.side(loaded, si)
        ds, light = scene.sample_emitter_direction(si, sampler.next_2d(active), False, active)
        cosine = dr.maximum(side * dr.dot(si.sh_frame.n, ds.d), 0.0)
        lit = active & (ds.pdf > 0.0) & (cosine > 0.0)
        lit &= ~rays.blocked(loaded, scene, si, rays.segment(si, ds.p, rays.normal_of(ds)), lit)
        color += dr.select(lit, throughput * light * (cosine * dr.inv_pi), 0.0)
        local = mi.warp.square_to_cosine_hemisphere(sampler.next_2d(active))
        _, si = rays.leave(loaded, scene, si, rays.spawn(si, si.to_world(side * local)), active)
        vertices += 1
        active &= (vertices < last) & meets_surface(si)
    return color


def depth_of(loaded: Any, limit: dict[str, Any]) -> int:
    """Path depth that the scope of a limit needs."""
    return FIRST_HIT if limit["scope"] == "first-hit" else sufficient_depth(loaded, "direct")


def integrator(depth: int) -> dict[str, Any]:
    """Describe Mitsuba's `path`, its roulette off."""
    return {"type": "path", "max_depth": depth, "rr_depth": depth + 1}


def sufficient_depth(loaded: Any, role: str) -> int:
    """Smallest power of two whose image differs from that of twice the depth by less than `TAIL` of its mean.

    Equal seeds give paths with equal beginnings, so that the difference is the tail itself, not noise. The
    depth is kept in the description.
    """
    depths = loaded.description.setdefault("depths", {})
    if role in depths:
        return depths[role]
    side, spp = (48, 16) if dr.is_jit_v(mi.Float) else (16, 8)
    camera = loaded.description["camera"] | {"resolution": [side, side]}

    def mean(depth: int) -> float:
        radiance = paths.reflected(loaded.scenes[role], depth)
        image = pixel_means(lambda s: (radiance(s.ray, s.sampler, True),), camera, spp=spp, seed=0)
        return float(image.mean())

    depths[role] = DEPTHS[-1]
    shallow = mean(DEPTHS[0])
    for depth, twice in zip(DEPTHS, DEPTHS[1:], strict=False):
        deep = mean(twice)
        if deep - shallow <= TAIL * deep:
            depths[role] = depth
            break
        shallow = deep
    return depths[role]
