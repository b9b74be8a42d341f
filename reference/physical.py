"""Full light transport, split by the lobe sampled at the camera vertex and by where the path ends.

- ambient: diffuse lobe first, and the path ends on the sky;
- direct: diffuse lobe first, and it ends on a light;
- specular: specular lobe first.

Light is linear, so "ends on" is a scene with that light alone. At the camera vertex one lobe is lit by light sampling
and lobe sampling with the power heuristic (Veach 1997); what the lobe's direction meets is lit by Mitsuba's `path`. All
lights are visible to every lobe, the ambient light L_a0 does not exist, and the parts add up to plain `path`.
"""

from typing import Any

import drjit as dr
import mitsuba as mi

from .terms import direct
from .wavefront import Estimator, Samples, idle

# Of each term, the roles of the lobe at the camera vertex and of what lights it.
PARTS = {
    "ambient": ("diffuse", "physical-sky"),
    "direct": ("diffuse", "physical-lights"),
    "specular": ("specular", "physical"),
}


def estimator(loaded: Any, limit: dict[str, Any]) -> Estimator:
    """Samples -> (ambient, direct, specular); unbiased but for the depth of `path`, see `direct.TAIL`."""
    depth = direct.sufficient_depth(loaded, "physical")
    parts = [
        (loaded.scenes[lobe], loaded.scenes[light], direct.reflected(loaded.scenes[light], depth))
        for lobe, light in PARTS.values()
    ]

    def estimate(samples: Samples) -> tuple[Any, ...]:
        images = []
        for lobe_scene, lit_scene, reflected in parts:
            if not lit_scene.emitters():
                images.append(mi.Color3f(0.0))
                continue
            color, weight, ray, active = _camera_vertex(lobe_scene, lit_scene, samples)
            dr.eval(color, weight, ray, active)
            images.append(color + weight * reflected(ray, samples.sampler, active))
        return tuple(images)

    return estimate


def _camera_vertex(lobe_scene: Any, lit_scene: Any, samples: Samples) -> tuple[Any, Any, Any, Any]:
    """Light that the lobe reflects directly, and the weight, ray and existence of its continuation."""
    sampler, context = samples.sampler, mi.BSDFContext()
    si = lobe_scene.ray_intersect(samples.ray)
    active = si.is_valid()
    if idle(active):
        return mi.Color3f(0.0), mi.Color3f(0.0), samples.ray, active
    bsdf = si.bsdf()

    ds, light = lit_scene.sample_emitter_direction(si, sampler.next_2d(active), True, active)
    lit = active & (ds.pdf > 0.0)
    value, pdf = bsdf.eval_pdf(context, si, si.to_local(ds.d), lit)
    # Lobe sampling cannot meet a point light.
    share = dr.select(ds.delta, 1.0, _power_heuristic(ds.pdf, pdf))
    color = dr.select(lit, value * light * share, 0.0)

    bs, weight = bsdf.sample(context, si, sampler.next_1d(active), sampler.next_2d(active), active)
    active = active & dr.any(weight != 0.0)
    ray = si.spawn_ray(si.to_world(bs.wo))
    met = lit_scene.ray_intersect(ray, active)
    emitter = met.emitter(lit_scene, active)
    shining = active & (emitter != None)  # noqa: E711  a lane-wise comparison of pointers
    if not idle(shining):
        chance = lit_scene.pdf_emitter_direction(si, mi.DirectionSample3f(lit_scene, met, si), shining)
        share = _power_heuristic(bs.pdf, chance)
        color += dr.select(shining, weight * emitter.eval(met, shining) * share, 0.0)
    return color, weight, ray, active


def _power_heuristic(a: Any, b: Any) -> Any:
    ratio = b / dr.maximum(a, 1e-20)
    return dr.select(a > 0.0, dr.rcp(1.0 + ratio * ratio), 0.0)
