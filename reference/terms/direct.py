"""Direct: `color (1 - g) E / π`, E from the lights alone, over the first hit or over all diffuse bounces.

Mitsuba's `path` integrator in a scene whose surfaces are all diffuse with albedo `color (1 - g)`. Its roulette is
off: the survival probability capped at 0.95 has infinite variance for albedos above 0.975.
"""

from typing import Any

import drjit as dr
import mitsuba as mi

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
    radiance = reflected(loaded.scenes["direct"], depth_of(loaded, limit))
    if limit["shadows"] == "physical":
        return radiance
    dark = shadows.rule(loaded, limit)

    def masked(ray: Any, sampler: Any, active: Any) -> Any:
        si = loaded.scenes["diffuse"].ray_intersect(ray, active)
        return dr.select(dark(si, si.is_valid()), 0.0, radiance(ray, sampler, active))

    return masked


def depth_of(loaded: Any, limit: dict[str, Any]) -> int:
    """Path depth that the scope of a limit needs."""
    return FIRST_HIT if limit["scope"] == "first-hit" else sufficient_depth(loaded, "direct")


def reflected(scene: Any, depth: int) -> Any:
    """(ray, sampler, active) -> light that `path` finds reflected at least once, none emitted along the ray."""
    path = mi.load_dict(integrator(depth) | {"hide_emitters": True})

    def radiance(ray: Any, sampler: Any, active: Any) -> Any:
        # With `hide_emitters` Mitsuba lets camera rays pass through a light's surface; ours is black and opaque.
        si = scene.ray_intersect(ray, active)
        active = active & meets_surface(si)
        color, _, _ = path.sample(scene, sampler, mi.RayDifferential3f(ray), None, active)
        return dr.select(active, color, 0.0)

    return radiance


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
        radiance = reflected(loaded.scenes[role], depth)
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
