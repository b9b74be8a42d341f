"""The interface of a dielectric, Walter, Marschner, Li and Torrance's (EGSR 2007): what it reflects and lets through.

With o the view, i the light, eta_o and eta_i the indices on their sides, and h the normal of the facet between them,

    f_r = g F D G / (4 |o·n| |i·n|),
    f_t = t tint (1 - F) D G |o·h| |i·h| eta_o² / (|o·n| |i·n| (eta_o (o·h) + eta_i (i·h))²).

D is Beckmann's, `G = G1(o) G1(i)` the exact Smith term (see `bsdf`), 0 where a facet is seen from behind, and F
Fresnel's reflectance of unpolarized light. The normal points to the side that eta, inside over outside, calls outside.
Radiance grows with eta² across the interface, the flux of photons does not: `mi.TransportMode.Importance` leaves
`(eta_o / eta_i)²` out. Mitsuba's `roughdielectric` is the same but for its G1, a rational approximation, and for g, t.
"""

# pyright: reportCallIssue=false, reportArgumentType=false, reportOperatorIssue=false, reportAttributeAccessIssue=false
# Mitsuba's stubs do not know the types of the variant in use.

from typing import Any

import drjit as dr
import mitsuba as mi

from .bsdf import TINY, Paired, beckmann, smith_g1
from .share import number

# What is let through is spread over an angle of about |eta - 1| alpha. Single precision has no density of what is
# narrower: it is said to have one direction, which light sampling cannot meet.
NARROW = 2.0**-20


class Dielectric(Paired):
    """Both lobes, or one where a factor is 0; a facet is drawn by visible normals, and a lobe by its share of both."""

    def __init__(self, props: Any) -> None:
        """Read `alpha` and the factor g (`factor`), textures or numbers; `eta`, t (`transparency`), `tint`."""
        mi.BSDF.__init__(self, props)
        self._alpha, self._factor = number(props["alpha"]), number(props["factor"])
        # Opaque, so that one compiled kernel serves all materials and scenes.
        self._eta = dr.opaque(mi.Float, props["eta"])
        self._transparency = dr.opaque(mi.Float, props["transparency"])
        self._tint = dr.opaque(mi.Color3f, list(props["tint"]))
        sides = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        reflected = mi.BSDFFlags.GlossyReflection | sides
        passing = mi.BSDFFlags.GlossyTransmission | mi.BSDFFlags.NonSymmetric | sides
        # `twosided` takes nothing that lets light through.
        through = props["transparency"] > 0.0
        self.m_components = [reflected, passing] if through else [reflected]
        self.m_flags = reflected | passing if through else reflected

    def _spread(self, alpha: Any) -> Any:
        """Whether what is let through has more than one direction."""
        return dr.abs(self._eta - 1.0) * alpha >= NARROW

    def _shares(self, si: Any, fresnel: Any, active: Any) -> tuple[Any, Any]:
        """Chance of the reflected lobe, and what both weigh together."""
        reflected = self._factor(si, active) * fresnel
        whole = reflected + self._transparency * (1.0 - fresnel)
        return dr.select(whole > 0.0, reflected / dr.maximum(whole, TINY), 1.0), whole

    def _passing(self, ctx: Any, eta_ti: Any) -> Any:
        """Factor on what is let through, but for the share of the lobe."""
        return self._tint * (dr.square(eta_ti) if ctx.mode == mi.TransportMode.Radiance else 1.0)

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
        """Reflect or refract at a visible facet; the weight is `f |i·n| / pdf`."""
        alpha = self._alpha(si, active)
        wh, _ = beckmann(alpha).sample(dr.mulsign(si.wi, si.wi.z), sample2)
        fresnel, cosine, eta_it, eta_ti = mi.fresnel(dr.dot(si.wi, wh), self._eta)
        chance, whole = self._shares(si, fresnel, active)
        reflects = sample1 < chance
        bs = mi.BSDFSample3f()
        bs.wo = dr.select(reflects, mi.reflect(si.wi, wh), mi.refract(si.wi, wh, cosine, eta_ti))
        bs.eta = dr.select(reflects, 1.0, eta_it)
        through = dr.select(
            self._spread(alpha), mi.UInt32(+mi.BSDFFlags.GlossyTransmission), mi.UInt32(+mi.BSDFFlags.DeltaTransmission)
        )
        bs.sampled_type = dr.select(reflects, mi.UInt32(+mi.BSDFFlags.GlossyReflection), through)
        bs.sampled_component = dr.select(reflects, mi.UInt32(0), mi.UInt32(1))
        bs.pdf = self.pdf(ctx, si, bs.wo, active)
        # Reflected below the surface, or refracted above it.
        sides = si.wi.z * bs.wo.z
        active = active & dr.select(reflects, sides > 0.0, sides < 0.0)
        weight = dr.select(reflects, 1.0, self._passing(ctx, eta_ti)) * (whole * smith_g1(bs.wo, alpha))
        return bs, dr.select(active, weight, 0.0)

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        """Value and density together: they differ by the weight of `sample`."""
        mu_i, mu_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
        reflects = mu_i * mu_o > 0.0
        beyond = dr.select(mu_i > 0.0, self._eta, dr.rcp(self._eta))  # the index over that of the viewer's side
        alpha = self._alpha(si, active)
        wh = dr.normalize(si.wi + wo * dr.select(reflects, 1.0, beyond))
        wh = dr.mulsign(wh, wh.z)
        seen, lit = dr.dot(si.wi, wh), dr.dot(wo, wh)
        active = active & (seen * mu_i > 0.0) & (lit * mu_o > 0.0) & (reflects | self._spread(alpha))
        fresnel, _, _, eta_ti = mi.fresnel(seen, self._eta)
        chance, whole = self._shares(si, fresnel, active)
        # Density of the facets times the solid angle of facets to that of directions.
        jacobian = dr.square(beyond) * dr.abs(lit) / dr.maximum(dr.square(seen + beyond * lit), TINY)
        jacobian = dr.select(reflects, dr.rcp(4.0 * dr.maximum(dr.abs(lit), TINY)), jacobian)
        facets = beckmann(alpha).eval(wh) * smith_g1(si.wi, alpha)
        facets *= dr.abs(seen) / dr.maximum(dr.abs(mu_i), TINY)
        pdf = facets * jacobian * dr.select(reflects, chance, 1.0 - chance)
        value = dr.select(reflects, 1.0, self._passing(ctx, eta_ti)) * (whole * smith_g1(wo, alpha) * pdf)
        return dr.select(active, value, 0.0), dr.select(active, pdf, 0.0)

    def eval_diffuse_reflectance(self, si: Any, active: Any = True) -> Any:
        """The factor g of what is reflected."""
        return mi.Color3f(self._factor(si, active))

    def to_string(self) -> str:
        """Name the plugin."""
        return f"Dielectric[eta={self._eta}]"


class Blend(Paired):
    """What Mitsuba's `blendbsdf` is, which weighs a sample by values and densities, and has none of one direction."""

    def __init__(self, props: Any) -> None:
        """Read the share of the second (`weight`, a number), and both (`first`, `second`)."""
        mi.BSDF.__init__(self, props)
        self._first, self._second = props["first"], props["second"]
        self._share = dr.opaque(mi.Float, props["weight"])
        parts = self._first, self._second
        self.m_components = [part.flags(number) for part in parts for number in range(part.component_count())]
        self.m_flags = self._first.flags() | self._second.flags()

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
        """One of both by its share, as it samples itself; the density is that of both."""
        share, later = self._share, sample1 < self._share
        one = self._first.sample(ctx, si, (sample1 - share) / (1.0 - share), sample2, active & (later == False))  # noqa: E712
        other = self._second.sample(ctx, si, sample1 / share, sample2, active & later)
        bs, weight = (dr.select(later, b, a) for a, b in zip(one, other, strict=True))
        bs.pdf = self.pdf(ctx, si, bs.wo, active)
        return bs, weight

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        """Value and density together."""
        parts = (part.eval_pdf(ctx, si, wo, active) for part in (self._first, self._second))
        return tuple((1.0 - self._share) * a + self._share * b for a, b in zip(*parts, strict=True))

    def to_string(self) -> str:
        """Name the plugin with its parts."""
        return f"Blend[{self._first}, {self._second}]"


def register() -> None:
    """Make `microfacet_dielectric` and `blend` known to Mitsuba."""
    mi.register_bsdf("microfacet_dielectric", Dielectric)
    mi.register_bsdf("blend", Blend)
