"""Built-in integrators through Mitsuba's own sensor and film, for the variant that has no wavefronts.

`scalar_rgb` evaluates rays given from Python one at a time; `mi.render` is far faster. The paper's camera is
Mitsuba's `perspective` with `fov_axis` x, and with a box filter the film's positions are uniform in the pixel.
"""

# pyright: reportArgumentType=false
# Mitsuba's stubs do not know the types of the variant in use.

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from . import paths, rays
from .terms import ambient

FAR = 1e3  # of the camera, at the canonical scale: from further away Mitsuba's, in single precision, misses the pixel


def serves(loaded: Any, limit: dict[str, Any]) -> bool:
    """Whether the limit is a built-in integrator's, in a scalar variant and with positions that the film can take."""
    description = loaded.description
    if dr.is_jit_v(mi.Float) or limit["transport"] == "physical" or description["camera"]["pixel"] != "jitter":
        return False
    if description["translucent"]:  # a plugin in Python, which would be asked ray by ray
        return False
    if max(map(abs, description["camera"]["origin"])) > FAR:
        return False
    if limit["term"] == "ambient":
        return ambient.built_in(loaded, limit)
    if (
        limit["term"] == "direct"
        and limit["kernel"] is None
        and limit["shadows"] == "physical"
        and description["has_lights"]
    ):
        if not rays.plain(loaded) or not (limit["scope"] == "first-hit" or paths.sound(loaded, "direct")):
            return False
        # The film would show a light's surface, or with hidden emitters what is behind it; ours is black.
        return not any(shape.is_emitter() for shape in loaded.scenes["direct"].shapes())
    return False


def render(loaded: Any, limit: dict[str, Any], *, spp: int, seed: int) -> np.ndarray:
    """Mean image, (1, H, W, 3) float64."""
    camera = sensor(loaded.description["camera"], spp)

    def image(scene: Any, integrator: dict[str, Any]) -> np.ndarray:
        tensor = mi.render(scene, sensor=camera, integrator=mi.load_dict(integrator), spp=spp, seed=seed)
        return np.array(tensor, np.float64)[None, ..., :3]

    if limit["term"] == "ambient":
        return image(loaded.scenes["ambient"], ambient.INTEGRATOR)
    return image(loaded.scenes["direct"], paths.built_in(first_hit=limit["scope"] == "first-hit"))


def sensor(camera: dict[str, Any], spp: int, sampler: str = "independent") -> Any:
    """Mitsuba's `perspective` of the paper's camera, rays uniform in a pixel, with one of Mitsuba's samplers."""
    origin, corner, across, down = (np.array(camera[key]) for key in ("origin", "corner", "across", "down"))
    width, height = camera["resolution"]
    forward = corner + across / 2 + down / 2
    return mi.load_dict(
        {
            "type": "perspective",
            "fov": 2.0 * math.degrees(math.atan(np.linalg.norm(across) / 2.0)),
            "fov_axis": "x",
            "to_world": mi.ScalarTransform4f().look_at(
                origin=origin.tolist(), target=(origin + forward).tolist(), up=(-down).tolist()
            ),
            "film": {
                "type": "hdrfilm",
                "width": width,
                "height": height,
                "rfilter": {"type": "box"},
                "component_format": "float32",
                "pixel_format": "rgb",
            },
            "sampler": {"type": sampler, "sample_count": spp},
        }
    )
