"""What the Method page asks for: the equations of variants are the ones in `renderer.terms`."""

from termwise.renderer.terms import VARIANTS
from termwise.renderer.terms.variant import Variant


def find(term: str, name: str) -> Variant | None:
    """The variant of a row, None for `total` and for what the renderer no longer knows."""
    return VARIANTS.get(term, {}).get(name)  # type: ignore[call-overload]
