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

import math
from numbers import Real
from typing import Any, Literal

import attrs

from termwise.scenes.arguments import whole
from termwise.scenes.model import Scene, Scope
from termwise.scenes.terms import TABLE, Term

KernelShape = Literal["simpson", "epanechnikov", "uniform", "nearest"]


def _factor(default: float = 1.0) -> Any:
    """A finite number >= 0, kept as a float: equal limits have equal seeds."""

    def validate(_instance: Any, attribute: attrs.Attribute, value: Any) -> None:
        if not (isinstance(value, float) and 0.0 <= value < math.inf):
            raise ValueError(f"{attribute.name} = {value!r}: allowed is a number in [0, inf)")

    def plain(value: Any) -> Any:
        return float(value) if isinstance(value, Real) and not isinstance(value, bool) else value

    return attrs.field(default=default, converter=plain, validator=validate)


def _choice(*allowed: Any, **default: Any) -> Any:
    """One of a few values."""

    def validate(_instance: Any, attribute: attrs.Attribute, value: Any) -> None:
        if not any(type(value) is type(each) and value == each for each in allowed):
            raise ValueError(f"{attribute.name} = {value!r}: allowed are {', '.join(map(repr, allowed))}")

    return attrs.field(validator=validate, **default)


def _count(default: int | None, low: int) -> Any:
    """An integer of at least `low`, or the default."""

    def validate(_instance: Any, attribute: attrs.Attribute, value: Any) -> None:
        if value != default or isinstance(value, bool):
            whole(attribute.name, value, low)

    return attrs.field(default=default, validator=validate)


def _changed(value: Any) -> str:
    """`Limit('direct', scope='all')`: the first field, and those that are not as they are by default."""
    first, *others = attrs.fields(type(value))
    shown = [repr(getattr(value, first.name))]
    shown += [f"{each.name}={item!r}" for each in others if (item := getattr(value, each.name)) != each.default]
    return f"{type(value).__name__}({', '.join(shown)})"


@attrs.frozen(repr=False)
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

    shape: KernelShape = _choice("simpson", "epanechnikov", "uniform", "nearest")
    stored: Literal["scattered", "all"] = _choice("scattered", "all", default="all")
    radius: float = _factor(0.0)
    passes: int = _count(1, 1)
    nearest: int = _count(0, 2)
    photons: int = _count(0, 1)
    scale: float = _factor()
    weighted: bool = _choice(True, False, default=True)

    def __attrs_post_init__(self) -> None:
        """Refuse a kernel without its size."""
        if self.shape != "nearest" and self.radius == 0.0:
            raise ValueError(f"shape = {self.shape!r}, radius = 0.0: allowed is a number in (0, inf)")
        if self.shape == "nearest" and 0 in (self.nearest, self.photons):
            raise ValueError(
                f"shape = 'nearest', nearest = {self.nearest}, photons = {self.photons}: allowed are at least 2 and 1"
            )

    def __repr__(self) -> str:
        """The fields that are not as they are by default."""
        return _changed(self)


@attrs.frozen(repr=False)
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
    depth : how often light scatters at surfaces at most, in full light transport alone: 1 is direct light; None: any
        number.

    Raises
    ------
    ValueError : a term that is none, "total" among them, a value that is not allowed, a field that means nothing to the
        term.
    """

    term: Term
    occluded: bool = _choice(True, False, default=True)
    scope: Scope | None = _choice("first-hit", "all", None, default=None)
    factor: float = _factor()
    lobe: float = _factor()
    diffuse: float = _factor(0.0)
    cosine: Literal["incident", "outgoing"] = _choice("incident", "outgoing", default="incident")
    ambient: float = _factor()
    rings: int | None = _count(None, 1)
    kernel: Kernel | None = None
    shadows: Literal["physical", "paper"] = _choice("physical", "paper", default="physical")
    transport: Literal["decomposed", "physical"] = _choice("decomposed", "physical", default="decomposed")
    depth: int | None = _count(None, 1)

    def __attrs_post_init__(self) -> None:
        """Refuse what no image is the integral of."""
        if not isinstance(self.term, str) or self.term not in TABLE:
            raise ValueError(f"term = {self.term!r}: allowed are {', '.join(TABLE)}")
        if not isinstance(self.kernel, Kernel | None):
            raise ValueError(f"kernel = {self.kernel!r}: allowed is a Kernel or None")
        row = TABLE[self.term]
        for field in attrs.fields(Limit):
            value = getattr(self, field.name)
            if field.name not in ("term", "factor", "transport", *row.limit) and value != field.default:
                allowed = ", ".join(("factor", "transport", *row.limit))
                raise ValueError(f"{field.name} = {value!r}: means nothing to {self.term}: allowed are {allowed}")
        if self.depth is not None and self.transport != "physical":
            raise ValueError(f"depth = {self.depth!r}: allowed with transport = 'physical' alone")

    def __repr__(self) -> str:
        """The fields that are not as they are by default."""
        return _changed(self)


def correct(term: Term, scope: Scope) -> Limit:
    """The term's true integral, against which every variant of it can be measured."""
    return Limit(term, scope=scope if TABLE[term].scoped else None)


def physical(term: Term) -> Limit:
    """The term's share of full light transport, split at the camera vertex."""
    return Limit(term, transport="physical")


def named(term: Term, scene: Scene) -> Limit:
    """What a term's name means in a scene, to which the default variant of its term converges.

    The true integral, but for what the scene chooses: its scope, its shadows, and photons that scatter on the specular
    lobe too, whose direct term is its share of full light transport.

    Raises
    ------
    ValueError : a term that is none.
    """
    plain = correct(Limit(term).term, scene.scope)
    if term == "direct" and scene.scope == "all" and scene.photons.scattering == "full":
        return physical(term)
    return attrs.evolve(plain, shadows=scene.shadows if "shadows" in TABLE[term].limit else "physical")
