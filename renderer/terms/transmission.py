"""Transmission: `L_transmission = t tint T[L]`, `T[L] = ∫ f_t(w_i, w_o) |w_i.n| L(w_i) dw_i` over the far side.

f_t is that of `renderer.dielectric`, and L what the chain of `specular` meets: this term is the chains that go through
the surface that the camera sees. It is of radiance, `(eta_o / eta_i)²` times what it is in the other medium: a pixel
that sees into glass is darker by that factor, and by its inverse brighter one that sees out of it.
"""

from typing import Any

from termwise.renderer.dielectric import REFRACTED
from termwise.renderer.terms.estimator import Compiled
from termwise.renderer.terms.specular import UNIFORM, VNDF, chain, inputs_of, photons_of
from termwise.renderer.terms.variant import Variant
from termwise.scenes.limits import Limit


def _variant(name: str, lobe: int, **fields: Any) -> Variant:
    return Variant(
        name=name,
        term="transmission",
        estimator=Compiled(chain),
        inputs=inputs_of(REFRACTED, lobe),
        photons=photons_of,
        limit=lambda scene, samples: Limit("transmission", scope=scene.scope),
        kind="right",
        converges_to=r"t\, \mathrm{tint}\, T[L]",
        **fields,
    )


VARIANTS = (
    _variant(
        "vndf",
        VNDF,
        equation=r"\frac{t\, \mathrm{tint}}{N} \sum_k (1 - F(\omega_o \cdot m_k))\, "
        r"\frac{\eta_o^2}{\eta_i^2}\, G_1(\omega_k)\, L_k, \quad m_k \sim D_{\omega_o}",
        source="Beckmann visible normals, refracted: Walter et al., EGSR 2007; Heitz, d'Eon, EGSR 2014",
        measured=True,
    ),
    _variant(
        "uniform",
        UNIFORM,
        equation=r"\frac{2 \pi\, t\, \mathrm{tint}}{N} \sum_k f_t\, |\mu_k|\, L_k",
        source="directions uniform over the far side, and over the sphere at the vertices beyond",
        by_direction=True,
    ),
)
