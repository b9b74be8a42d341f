"""The integral that an estimator converges to, as a value: the only thing both sides say of a variant.

With `A = AO * L_a0`, `E` the irradiance and `S[L] = ∫ f mu_i L dw` (Cook-Torrance, method of the renderer):

- ambient:    `factor * weight * A`
- direct:     `factor * weight * E / pi`, E of the first hit or of all bounces (`scope`)
- specular:   `gloss * lobe * S[L]`, the factor `lobe` acting at every vertex of the chain
- background: the sky on a miss and the emission of a light's own surface

where `weight = color * (1 - gloss)`. A variant of the renderer names its Limit; the reference renders Limits and
knows no variants.
"""

from typing import Literal

import attrs

from scenes.terms import Scope, Term


@attrs.frozen
class Limit:
    """Which integral is meant.

    Attributes
    ----------
    term : Term
        The term.
    scope : "first-hit" | "all" | None
        Which irradiance `direct` means, here or at the vertices of a specular chain. None for the
        terms in which no irradiance occurs.
    factor : float
        Constant factor on the whole image (ambient `paper`: pi).
    lobe : float
        Factor on the specular lobe at every vertex of the chain (specular `paper`: 4/pi).
    transport : "decomposed" | "physical"
        `decomposed`: the paper's operator above. `physical`: full light transport with all lights
        visible to every lobe, split by the lobe sampled at the camera vertex.
    """

    term: Term
    scope: Scope | None = None
    factor: float = 1.0
    lobe: float = 1.0
    transport: Literal["decomposed", "physical"] = "decomposed"


def correct(term: Term, scope: Scope) -> Limit:
    """The term's true integral, against which every variant of it can be measured."""
    return Limit(term, scope=scope if term in ("direct", "specular") else None)


def physical(term: Term) -> Limit:
    """The term's share of full light transport, split at the camera vertex."""
    return Limit(term, transport="physical")
