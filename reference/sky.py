"""The paper's sky: `u = atan2(n.x, n.y) / (2π) + 1/2, v = 1/2 - n.z / 2`.

A ray that misses is intersected with a sphere; n, the unit vector from its centre to the farther hit, looks the
texture up, bilinearly, u repeating and v clamped. Without a texture the sky is one colour. As settings of the scene:
`v = acos(n.z) / π` (lat-long), and an infinite sphere, n being the ray's direction.
"""

# pyright: reportCallIssue=false
# Mitsuba's stubs do not know the types of the variant in use.

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .wavefront import UNBOUNDED


class Lookup:
    """The texture of the sky as a function of the direction n from the sphere's centre."""

    def __init__(self, texels: np.ndarray, projection: str) -> None:
        """Take (H, W, 3) float32 texels and the scene's projection."""
        self._equal_area = projection == "equal-area"
        # Dr.Jit wraps u and v alike: clamping both, with the first and last columns repeated, makes u periodic.
        padded = np.concatenate([texels[:, -1:], texels, texels[:, :1]], axis=1)
        self._width = dr.opaque(mi.Float, texels.shape[1])
        # Without `use_accel=False` a GPU would interpolate with 8-bit weights.
        self._texture = mi.Texture2f(
            mi.TensorXf(padded), use_accel=False, filter_mode=dr.FilterMode.Linear, wrap_mode=dr.WrapMode.Clamp
        )

    def __call__(self, normal: Any, active: Any = True) -> Any:
        """Radiance in the unit direction `normal`, mi.Color3f."""
        u = dr.atan2(normal.x, normal.y) * (0.5 * dr.inv_pi) + 0.5
        if self._equal_area:
            v = 0.5 - 0.5 * normal.z
        else:
            v = dr.atan2(dr.sqrt(dr.square(normal.x) + dr.square(normal.y)), normal.z) * dr.inv_pi
        u = (u * self._width + 1.0) / (self._width + 2.0)
        return mi.Color3f(*self._texture.eval(mi.Point2f(u, v), active))


def radiance(sky: dict[str, Any]) -> Any:
    """(ray, active) -> mi.Color3f: what a ray that misses all geometry sees."""
    if sky["texture"] is None:
        color = dr.opaque(mi.Color3f, sky["color"])
        return lambda ray, active: dr.select(active, color, 0.0)
    lookup = Lookup(np.load(sky["texture"]), sky["projection"])
    if sky["radius"] >= UNBOUNDED:
        return lambda ray, active: dr.select(active, lookup(ray.d, active), 0.0)
    center, radius = dr.opaque(mi.Point3f, sky["center"]), dr.opaque(mi.Float, sky["radius"])

    def textured(ray: Any, active: Any) -> Any:
        # |o + t d - c|² = r², with b = d·(o - c): t = -b ± sqrt(r² - |(o - c) - b d|²), which does not cancel.
        offset = ray.o - center
        b = dr.dot(ray.d, offset)
        discriminant = radius * radius - dr.squared_norm(offset - b * ray.d)
        distance = dr.safe_sqrt(discriminant) - b
        active = active & (discriminant >= 0.0) & (distance > 0.0)
        return dr.select(active, lookup(dr.normalize(offset + distance * ray.d), active), 0.0)

    return textured


class PaperSky(mi.Texture):
    """The sky as the radiance of an `area` emitter on a sphere, looked up by the position on it."""

    def __init__(self, props: Any) -> None:
        """Read `texture`, an NPY file of (H, W, 3) float32, its `projection`, and the sphere's `center`."""
        mi.Texture.__init__(self, props)
        self._lookup = Lookup(np.load(props["texture"]), props["projection"])
        self._center = dr.opaque(mi.Point3f, list(props["center"]))

    def eval(self, si: Any, active: Any = True) -> Any:
        """Radiance that leaves the sphere at `si.p`."""
        return dr.select(active, self._lookup(dr.normalize(si.p - self._center), active), 0.0)

    def is_spatially_varying(self) -> bool:
        """Report False: the emitter then samples the sphere uniformly and calls `eval` for the radiance."""
        return False

    def to_string(self) -> str:
        """Name the plugin."""
        return "PaperSky[]"


def register() -> None:
    """Make `paper_sky` known to Mitsuba."""
    mi.register_texture("paper_sky", PaperSky)
