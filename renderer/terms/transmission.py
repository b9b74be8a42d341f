"""Transmission: `L_transmission = t tint T[L]`, `T[L] = ∫ f_t(w_i, w_o) |w_i.n| L(w_i) dw_i` over the other side.

L as in the chain of `specular`, which this is: at the camera's vertex it goes through the surface, at all others it is
reflected or goes through.
"""

from collections.abc import Callable
from typing import Any

from termwise.renderer.terms import specular
from termwise.renderer.terms.estimator import Compiled
from termwise.renderer.terms.variant import Variant
from termwise.scenes.limits import Limit


def _variant(name: str, lobe: int, **fields: Any) -> Variant:
    return Variant(
        name=name,
        term="transmission",
        estimator=Compiled(specular._chain),
        inputs=specular._inputs(lobe),
        photons=specular._photons,
        limit=lambda scene, samples: Limit("transmission", scope=scene.scope),
        kind="right",
        converges_to=r"t\, \mathrm{tint}\, T[L]",
        **fields,
    )


VARIANTS = (
    _variant(
        "vndf",
        specular.VNDF,
        equation=r"\frac{1}{N} \sum_k t\, \mathrm{tint}\, (1 - F)\, \frac{\eta_o^2}{\eta_i^2}\, G_1(\omega_k)\, L_k",
        source="Beckmann visible normals, refracted: Walter et al., EGSR 2007; Heitz, d'Eon, EGSR 2014",
        measured=True,
    ),
    _variant(
        "uniform",
        specular.UNIFORM,
        equation=r"\frac{1}{N} \sum_k \frac{f_t\, |\mu_k|}{p_k}\, L_k",
        source="uniform directions",
    ),
)
