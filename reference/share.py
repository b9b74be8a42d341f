"""`color (1 - gloss)` of a surface whose colour is an image: the texture `share`."""

# pyright: reportCallIssue=false
# Mitsuba's stubs do not know the types of the variant in use.

from typing import Any

import drjit as dr
import mitsuba as mi


class Share(mi.Texture):
    """What another texture says, times one minus a number."""

    def __init__(self, props: Any) -> None:
        """Read the texture `of` and the number `less`."""
        mi.Texture.__init__(self, props)
        self._of = props["of"]
        # Opaque, so that one compiled kernel serves all materials and scenes.
        self._share = dr.opaque(mi.Float, 1.0 - props["less"])

    def eval(self, si: Any, active: Any = True) -> Any:
        """Colour at a point of a surface."""
        return self._of.eval(si, active) * self._share

    def is_spatially_varying(self) -> bool:
        """Report that it depends on uv."""
        return True

    def to_string(self) -> str:
        """Name the plugin."""
        return "Share[]"


def register() -> None:
    """Make `share` known to Mitsuba."""
    mi.register_texture("share", Share)
