"""Background: what a camera ray sees without shading: the sky on a miss, suns before it, and a light's front side."""

from typing import Any

import drjit as dr
import mitsuba as mi

from .. import distant
from ..wavefront import Estimator, Samples, idle, shape_pointer


def estimator(loaded: Any, limit: dict[str, Any]) -> Estimator:
    """Samples -> (background term,); its only variance is that of the positions in the pixel."""
    scene = loaded.scenes["diffuse"]
    lights = [
        (shape_pointer(shape), dr.opaque(mi.Color3f, emission))
        for shape, emission in zip(scene.shapes(), loaded.description["emission"], strict=True)
        if any(emission)
    ]
    images = bool(lights) and any(loaded.description["lamp_means"])
    if images:  # which the emitters know, where they are
        scene, lights = loaded.scenes["direct"], []
    suns = distant.discs(loaded.description["suns"])

    def estimate(samples: Samples) -> tuple[Any]:
        si = scene.ray_intersect(samples.ray)
        missed = si.t == dr.inf
        color = loaded.sky(samples.ray, missed) + suns(samples.ray.d, missed)
        front = si.is_valid() & (dr.dot(si.n, samples.ray.d) < 0.0)
        for shape, emission in lights:
            color += dr.select(front & (si.shape == shape), emission, 0.0)
        if images and not idle(front):
            lamp = si.emitter(scene, front)
            front &= lamp != None  # noqa: E711  a lane-wise comparison of pointers
            if not idle(front):
                color += dr.select(front, lamp.eval(si, front), 0.0)
        return (color,)

    return estimate
