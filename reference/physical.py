"""Full light transport, split by the lobe sampled at the camera vertex and by where the path ends.

- ambient: diffuse lobe first, and the path ends on the sky;
- direct: diffuse lobe first, and it ends on a light;
- specular: specular lobe first;
- transmission: what goes through a transparent surface first.

Light is linear, so "ends on" is a scene with that light alone. At the camera vertex one lobe is lit, as vertices of
`paths` are; what the lobe's direction meets is lit by `paths`. All lights are visible to every lobe, the ambient light
L_a0 does not exist, and the parts add up to Mitsuba's plain `path`; where light scatters at most `depth`
times, to that of `max_depth` = `depth` + 1.
"""

from typing import Any

import drjit as dr
import mitsuba as mi

from . import paths
from .wavefront import Estimator, Samples, idle

# Of each term, the roles of the lobe at the camera vertex and of what lights it.
PARTS = {
    "ambient": ("diffuse", "physical-sky"),
    "direct": ("diffuse", "physical-lights"),
    "specular": ("specular", "physical"),
    "transmission": ("transmission", "physical"),
}


def estimator(loaded: Any, limit: dict[str, Any]) -> Estimator:
    """Samples -> (ambient, direct, specular, transmission); unbiased."""
    further = paths.ENDLESS if limit["depth"] is None else limit["depth"] - 1
    parts = []
    for lobe, light in PARTS.values():
        first, lit = loaded.scenes.get(lobe), loaded.scenes[light]
        shown = first is not None and lit.emitters()
        parts.append((first, lit, paths.reflected(loaded, light, most=further) if shown else None))

    def estimate(samples: Samples) -> tuple[Any, ...]:
        images = []
        for lobe_scene, lit_scene, reflected in parts:
            if reflected is None:
                images.append(mi.Color3f(0.0))
                continue
            color, weight, ray, active = _camera_vertex(lobe_scene, lit_scene, samples)
            dr.eval(color, weight, ray, active)
            images.append(color + weight * reflected(ray, samples.sampler, active))
        return tuple(images)

    return estimate


def _camera_vertex(lobe_scene: Any, lit_scene: Any, samples: Samples) -> tuple[Any, Any, Any, Any]:
    """Light that the lobe reflects directly, and the weight, ray and existence of its continuation."""
    si = lobe_scene.ray_intersect(samples.ray)
    active = si.is_valid()
    if idle(active):
        return mi.Color3f(0.0), mi.Color3f(0.0), samples.ray, active
    color, weight, ray, _, active = paths.vertex(lit_scene, si, samples.sampler, active)
    return color, weight, ray, active
