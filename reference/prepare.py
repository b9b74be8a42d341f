"""From a description (see `translate`) to estimators: the step that a stand-alone export shares."""

import importlib
import json
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from . import bsdf, dielectric, distant, film, kernel_reference, physical, second, share, sky
from .wavefront import Estimator, pixel_means


class Loaded:
    """A description loaded into Mitsuba.

    Attributes
    ----------
    description : as `translate.describe` gives it.
    scenes : the Mitsuba scene of each role.
    compiled : limits whose kernels were compiled.
    ending : roles in whose scenes light was seen to end, see `paths.check_end`.
    sky : (ray, active) -> mi.Color3f, what a ray that misses all geometry sees.
    """

    def __init__(self, description: dict[str, Any], folder: Path) -> None:
        """Load the scenes of all roles, from a description whose files lie in `folder`.

        All at once, because Mitsuba compiles into every kernel all materials that exist: a scene that is
        loaded later would have the kernels of the earlier ones compiled again.
        """
        bsdf.register()
        dielectric.register()
        sky.register()
        share.register()
        distant.register()
        located = _with_paths(description, folder)
        shared: dict[str, Any] = {}
        self.description = description
        self.compiled: set[Any] = set()
        self.ending: set[str] = set()
        self.sky = sky.radiance(located["sky"])
        # optimize=False: Mitsuba would merge meshes of equal materials, and face numbers would be lost.
        self.scenes = {
            role: mi.load_dict(_with_shared(shared, _with_transformations(scene)), parallel=False, optimize=False)
            for role, scene in located["scenes"].items()
        }

    def estimator(self, limit: dict[str, Any]) -> Estimator:
        """Return the estimator of a limit, given as its fields; the constant factor is left out."""
        if limit["transport"] == "physical" and limit["term"] in physical.PARTS:
            return physical.estimator(self, limit)
        return importlib.import_module(f".terms.{limit['term']}", __package__).estimator(self, limit)

    def render(self, limit: dict[str, Any], *, spp: int, seed: int, by_second: bool = False) -> np.ndarray:
        """Mean images of a limit's parts, (P, H, W, 3) float64; see `wavefront.pixel_means`, `kernel_reference`.

        `by_second`: by the second integrator of the limit, see `second`.
        """
        # There is no scene of its role, see `translate.TRANSPARENT`.
        if limit["term"] == "transmission" and not self.description["transparent"]:
            width, height = self.description["camera"]["resolution"]
            return np.zeros((1, height, width, 3))
        if by_second:
            estimate = second.estimator(self, limit)
            return pixel_means(estimate, self.description["camera"], spp=spp, seed=seed)
        if limit["kernel"] is not None:
            return kernel_reference.render(self, limit, spp=spp, seed=seed)
        if film.serves(self, limit):
            return film.render(self, limit, spp=spp, seed=seed)
        return pixel_means(self.estimator(limit), self.description["camera"], spp=spp, seed=seed)


def _with_paths(value: Any, folder: Path) -> Any:
    if isinstance(value, dict):
        return {
            key: str(folder / item) if key in ("filename", "texture") and item else _with_paths(item, folder)
            for key, item in value.items()
        }
    return value


def _with_transformations(scene: dict[str, Any]) -> dict[str, Any]:
    """A scene's dictionary with that of each light that has an axis, for JSON has no such value."""

    def placed(described: Any) -> Any:
        if not (isinstance(described, dict) and "axis" in described):
            return described
        rest = {key: value for key, value in described.items() if key not in ("origin", "axis")}
        origin, axis = np.array(described["origin"]), np.array(described["axis"])
        up = np.eye(3)[np.argmin(np.abs(axis))]
        look_at = mi.ScalarTransform4f().look_at(origin.tolist(), (origin + axis).tolist(), up.tolist())
        return rest | {"to_world": look_at}

    return {key: placed(described) for key, described in scene.items()}


def _with_shared(shared: dict[str, Any], scene: dict[str, Any]) -> dict[str, Any]:
    """A scene's dictionary with materials, images and shapes loaded once for all roles that have the same.

    Every material and every shape that exists is traced into every kernel: tracing takes a third less with a few
    objects, and a quarter to a sixth with hundreds of them.
    """

    def once(described: dict[str, Any]) -> Any:
        name = json.dumps(described)
        if name not in shared:
            parts = {key: loaded(key, item) for key, item in described.items()}
            if described["type"] == "bitmap":
                parts["bitmap"] = mi.Bitmap(np.load(parts.pop("texture")))
            shared[name] = mi.load_dict(parts)
        return shared[name]

    def loaded(key: str, item: Any) -> Any:
        if key == "emitter":  # which each shape has for itself
            return {name: once(part) if _has_image(part) else part for name, part in item.items()}
        return once(item) if key == "bsdf" or _has_image(item) else item

    return {key: once(item) if isinstance(item, dict) and "bsdf" in item else item for key, item in scene.items()}


def _has_image(described: Any) -> bool:
    """Whether a dictionary is one of an image, or holds one."""
    if not isinstance(described, dict):
        return False
    return described.get("type") == "bitmap" or any(map(_has_image, described.values()))
