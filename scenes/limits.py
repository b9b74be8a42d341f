"""The integral that an estimator converges to, as a value: the only thing both sides say of a variant.

With `A = AO * L_a0`, `E` the irradiance, `S[L] = ∫ f mu_i L dw` (Cook-Torrance, method of the renderer) and
`H[L] = (1/pi) ∫ mu_i L dw`:

- ambient:    `factor * weight * A`
- direct:     `factor * weight * E / pi`, E of the first hit or of all bounces (`scope`); pi times it where the scene
              takes E for radiance
- specular:   `gloss * (lobe * S[L] + diffuse * H[L])`, the bracket acting at every vertex of the chain
- background: the sky on a miss and the emission of a light's own surface

where `weight = color * (1 - gloss)`. With `rings` N the integral over the hemisphere is the paper's rule instead,
`(2 pi / N) sum_k mean over azimuth, mu_k = k / (N + 1)`; with a `kernel` E is the mean of a photon density estimate of
finite resolution. A variant of the renderer names its Limit; the reference renders Limits and knows no variants.
"""

from typing import Literal

import attrs

from termwise.scenes.model import Scope
from termwise.scenes.terms import TABLE, Term

KernelShape = Literal["simpson", "epanechnikov", "uniform", "nearest"]


@attrs.frozen
class Kernel:
    """A photon density estimate: its expectation over independent maps is what is meant, its own bias included.

    `E(x) = sum_p Phi_p K(|x_p - x|) / M(x)` for a kernel of a radius, averaged over the `passes` radii of Knaus and
    Zwicker (2011), `r²_{i+1} = r²_i (i + 2/3) / (i + 1)`. The sum is over photons, and the kernel's mass `M` over
    areas, of the surface of x: the faces of x's object whose normals have a cosine > 0.1 with that of x's face and
    whose planes pass within 0.1 r_i of x, seen from the side of x. For "nearest"
    `E(x) = scale * sum of the k nearest / (pi r_k²)`, without M, over all photons in front of x.

    Attributes
    ----------
    shape : "simpson", "epanechnikov", "uniform": `3 (1 - d²/r²)² / (pi r²)`, `2 (1 - d²/r²) / (pi r²)`, `1 / (pi r²)`;
        or "nearest".
    stored : "all": every photon that lands. "scattered": all but first hits, E of which is added exactly.
    radius, passes : radius of the first pass, and how many passes are averaged; of no meaning to "nearest".
    nearest, photons : k, and photons emitted a map, both of meaning to "nearest" alone: elsewhere the mean does not
        depend on the count.
    scale : factor on the sum over the k nearest.
    weighted : whether a photon that survives the roulette is multiplied by `albedo / P`, P the probability. Without,
        light is scattered with the grey albedo P.
    """

    shape: KernelShape
    stored: Literal["scattered", "all"] = "all"
    radius: float = 0.0
    passes: int = 1
    nearest: int = 0
    photons: int = 0
    scale: float = 1.0
    weighted: bool = True


@attrs.frozen
class Limit:
    """Which integral is meant.

    Attributes
    ----------
    term : the term.
    occluded : whether geometry hides the ambient light; without, AO is 1.
    scope : "first-hit" | "all" | None
        Which irradiance `direct` means, here or at the vertices of a specular chain. None for the
        terms in which no irradiance occurs.
    factor : constant factor on the whole image (ambient `paper`: pi).
    lobe : factor on the specular lobe at every vertex of the chain (specular `paper`: 4/pi).
    diffuse : albedo of a white Lambertian lobe beside it (specular `paper-code`: 1/2).
    cosine : "incident" | "outgoing"
        Which cosine the specular lobe is multiplied by: mu_i, or mu_o in its place (specular `paper-literal`).
    ambient : factor on the ambient light that a specular chain meets.
    rings : N of the paper's rule over the hemisphere, at every vertex; None: the integral.
    kernel : Kernel or None
        The photon density estimate that E is, in `direct` or at the vertices of a specular chain; None: E itself.
    shadows : "physical" | "paper"
        The paper's shadow rule (see `scenes.model.Scene`), or none.
    transport : "decomposed" | "physical"
        `decomposed`: the paper's operator above. `physical`: full light transport with all lights
        visible to every lobe, split by the lobe sampled at the camera vertex.
    """

    term: Term
    occluded: bool = True
    scope: Scope | None = None
    factor: float = 1.0
    lobe: float = 1.0
    diffuse: float = 0.0
    cosine: Literal["incident", "outgoing"] = "incident"
    ambient: float = 1.0
    rings: int | None = None
    kernel: Kernel | None = None
    shadows: Literal["physical", "paper"] = "physical"
    transport: Literal["decomposed", "physical"] = "decomposed"


def correct(term: Term, scope: Scope) -> Limit:
    """The term's true integral, against which every variant of it can be measured."""
    return Limit(term, scope=scope if TABLE[term].scoped else None)


def physical(term: Term) -> Limit:
    """The term's share of full light transport, split at the camera vertex."""
    return Limit(term, transport="physical")
