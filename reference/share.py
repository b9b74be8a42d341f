"""Images in Mitsuba: the textures `share`, `color (1 - gloss)` of a surface, and `lamp_image`, a lamp's radiance."""

# pyright: reportCallIssue=false
# Mitsuba's stubs do not know the types of the variant in use.

from typing import Any

import drjit as dr
import mitsuba as mi


def number(value: Any) -> Any:
    """(si, active) -> mi.Float, by a property that is a texture or a number."""
    if isinstance(value, mi.Texture):
        return value.eval_1
    # Opaque, so that one compiled kernel serves all materials and scenes.
    constant = dr.opaque(mi.Float, value)
    return lambda si, active: constant


def color(value: Any) -> Any:
    """(si, active) -> mi.Color3f, by a property that is a texture or three numbers."""
    if isinstance(value, mi.Texture):
        return value.eval
    constant = dr.opaque(mi.Color3f, list(value))
    return lambda si, active: constant


class Share(mi.Texture):
    """What one texture says, times one minus what another says."""

    def __init__(self, props: Any) -> None:
        """Read the texture `of`, or three numbers, and `less`, a texture or a number."""
        mi.Texture.__init__(self, props)
        self._of = color(props["of"])
        self._less = number(props["less"])

    def eval(self, si: Any, active: Any = True) -> Any:
        """Colour at a point of a surface."""
        return self._of(si, active) * (1.0 - self._less(si, active))

    def is_spatially_varying(self) -> bool:
        """Report that it depends on uv."""
        return True

    def to_string(self) -> str:
        """Name the plugin."""
        return "Share[]"


class LampImage(mi.Texture):
    """An image as the radiance of an `area` emitter that is sampled as one of one radiance: evenly over its faces.

    For an emitter that knows of an image Mitsuba samples its texels, and takes each for one place of the mesh: where
    uv repeat or overlap light would be lost.
    """

    def __init__(self, props: Any) -> None:
        """Read the texture `of`."""
        mi.Texture.__init__(self, props)
        self._of = props["of"]

    def eval(self, si: Any, active: Any = True) -> Any:
        """Radiance at a point of the lamp."""
        return self._of.eval(si, active)

    def sample_spectrum(self, si: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
        """What a photon carries away from there, with no wavelengths."""
        return mi.Color0f(), self._of.eval(si, active)

    def is_spatially_varying(self) -> bool:
        """Report False, see above."""
        return False

    def to_string(self) -> str:
        """Name the plugin."""
        return "LampImage[]"


def register() -> None:
    """Make both known to Mitsuba."""
    mi.register_texture("share", Share)
    mi.register_texture("lamp_image", LampImage)
