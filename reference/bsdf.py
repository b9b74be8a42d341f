"""The lobes of the references: Cook-Torrance, and Lambert's of both sides.

Cook-Torrance: `f = k F(wi·wh) D(wh) G1(wi) G1(wo) / (4 mu_i mu_o)`.

D is the normalised Beckmann distribution, `F = F0 + (1 - F0)(1 - wi·wh)^5` Schlick's, and G1 the exact Smith term
`2 / (1 + erf(a) + exp(-a²) / (a √π))`, `a = 1 / (α tan θ)` (Walter et al., EGSR 2007). Mitsuba's `roughconductor`
has neither Schlick's F nor the exact G1: its rational approximation is up to 0.3 % off.

Translucent: `f = w (1 - s) / pi` on the side that light comes from, `w s / pi` on the other.
"""

# pyright: reportCallIssue=false, reportArgumentType=false, reportOperatorIssue=false, reportAttributeAccessIssue=false
# Mitsuba's stubs do not know the types of the variant in use.

from typing import Any

import drjit as dr
import mitsuba as mi

from .share import number

TINY = 1e-20  # keeps divisions defined in lanes that are masked out afterwards


def smith_g1(v: Any, alpha: Any) -> Any:
    """Masking of the Beckmann distribution in the local direction `v`, on either side of the surface."""
    a = dr.maximum(dr.rcp(dr.maximum(alpha * dr.abs(mi.Frame3f.tan_theta(v)), TINY)), TINY)
    masked = 2.0 / (1.0 + dr.erf(a) + dr.exp(-a * a) / (a * dr.sqrt(dr.pi)))
    return dr.select(a < 10.0, masked, 1.0)  # exp and 1/a leave float32 there, where 1 - G1 < 1e-44


def beckmann(alpha: Any) -> Any:
    """The distribution of facets, drawn by those that are seen."""
    return mi.MicrofacetDistribution(mi.MicrofacetType.Beckmann, alpha, True)


class Paired(mi.BSDF):
    """A BSDF whose value and density are found together, by `eval_pdf`."""

    def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        """`f |wo.n|`, mi.Color3f."""
        return self.eval_pdf(ctx, si, wo, active)[0]

    def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        """Density of `sample`, per solid angle."""
        return self.eval_pdf(ctx, si, wo, active)[1]


class CookTorrance(Paired):
    """One lobe; sampled by visible normals (Heitz and d'Eon, EGSR 2014), which leaves the weight `k F G1(wo)`."""

    def __init__(self, props: Any) -> None:
        """Read `alpha` and the factor k (`factor`), which may exceed 1, a texture or a number; `f0`, three numbers."""
        mi.BSDF.__init__(self, props)
        self._alpha = number(props["alpha"])
        # Opaque, so that one compiled kernel serves all materials and scenes.
        self._f0 = dr.opaque(mi.Color3f, list(props["f0"]))
        self._factor = number(props["factor"])
        self.m_components = [mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide]
        self.m_flags = self.m_components[0]

    def _fresnel(self, cosine: Any) -> Any:
        return self._f0 + (1.0 - self._f0) * dr.power(dr.maximum(1.0 - cosine, 0.0), 5)

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
        """Reflect about a visible normal; the weight is `f mu_o / pdf`."""
        alpha = self._alpha(si, active)
        wh, _ = beckmann(alpha).sample(si.wi, sample2)
        bs = mi.BSDFSample3f()
        bs.wo = mi.reflect(si.wi, wh)
        bs.eta = 1.0
        bs.sampled_type = mi.UInt32(+self.m_components[0])
        bs.sampled_component = 0
        bs.pdf = self.pdf(ctx, si, bs.wo, active)
        active = active & (mi.Frame3f.cos_theta(si.wi) > 0.0) & (mi.Frame3f.cos_theta(bs.wo) > 0.0) & (bs.pdf > 0.0)
        weight = self._factor(si, active) * self._fresnel(dr.dot(si.wi, wh)) * smith_g1(bs.wo, alpha)
        return bs, dr.select(active, weight, 0.0)

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        """Value and density together: they differ by the weight of `sample`."""
        mu_i, mu_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
        active = active & (mu_i > 0.0) & (mu_o > 0.0)
        wh = dr.normalize(si.wi + wo)
        alpha = self._alpha(si, active)
        pdf = beckmann(alpha).eval(wh) * smith_g1(si.wi, alpha) / (4.0 * dr.maximum(mu_i, TINY))
        value = self._factor(si, active) * self._fresnel(dr.dot(si.wi, wh)) * smith_g1(wo, alpha) * pdf
        return dr.select(active, value, 0.0), dr.select(active, pdf, 0.0)

    def eval_diffuse_reflectance(self, si: Any, active: Any = True) -> Any:
        """The factor k: albedo of the Lambertian lobe that a limit may put beside this one, in units of its own."""
        return mi.Color3f(self._factor(si, active))

    def to_string(self) -> str:
        """Name the plugin."""
        return f"CookTorrance[f0={self._f0}]"


class Translucent(Paired):
    """Diffuse light of which a share crosses the surface; the same from both sides."""

    def __init__(self, props: Any) -> None:
        """Read the weight w (`reflectance`, a texture) and the share s (`share`)."""
        mi.BSDF.__init__(self, props)
        self._reflectance = props.get_texture("reflectance")
        self.share = float(props["share"])
        self._share = dr.opaque(mi.Float, self.share)
        sides = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        self.m_components = [mi.BSDFFlags.DiffuseReflection | sides, mi.BSDFFlags.DiffuseTransmission | sides]
        self.m_flags = self.m_components[0] | self.m_components[1]

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
        """Choose the side by its share, and there by the cosine; the weight is w."""
        crosses = sample1 < self._share
        local = mi.warp.square_to_cosine_hemisphere(sample2)
        bs = mi.BSDFSample3f()
        bs.wo = mi.Vector3f(local.x, local.y, dr.mulsign(local.z, si.wi.z) * dr.select(crosses, -1.0, 1.0))
        bs.eta = 1.0
        bs.sampled_type = dr.select(crosses, mi.UInt32(+self.m_components[1]), mi.UInt32(+self.m_components[0]))
        bs.sampled_component = dr.select(crosses, mi.UInt32(1), mi.UInt32(0))
        bs.pdf = self.pdf(ctx, si, bs.wo, active)
        return bs, dr.select(active & (bs.pdf > 0.0), self._reflectance.eval(si, active), 0.0)

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        """Value and density together: they differ by the weight of `sample`."""
        mu_i, mu_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
        share = dr.select(mu_i * mu_o < 0.0, self._share, 1.0 - self._share)
        pdf = dr.select(active & (mu_i != 0.0) & (mu_o != 0.0), share * dr.abs(mu_o) * dr.inv_pi, 0.0)
        return self._reflectance.eval(si, active) * pdf, pdf

    def eval_diffuse_reflectance(self, si: Any, active: Any = True) -> Any:
        """The weight w, of both sides together."""
        return self._reflectance.eval(si, active)

    def to_string(self) -> str:
        """Name the plugin with its parameters."""
        return f"Translucent[reflectance={self._reflectance}, share={self._share}]"


def share_of(lobe: Any) -> float:
    """The share s of a shape's BSDF, whatever its weight: an image may be black in a place."""
    return lobe.share if isinstance(lobe, Translucent) else 0.0


def crossing_share(lobe: Any, si: Any, active: Any) -> Any:
    """The share s of the light that crosses a surface whose BSDF is diffuse, on one side or both; 0 of a black one."""
    context, up = mi.BSDFContext(), mi.Vector3f(0.0, 0.0, dr.mulsign(mi.Float(1.0), si.wi.z))
    crossing = dr.max(lobe.eval(context, si, -up, active))
    whole = crossing + dr.max(lobe.eval(context, si, up, active))
    return dr.select(whole > 0.0, crossing / dr.maximum(whole, TINY), 0.0)


def register() -> None:
    """Make `cook_torrance` and `translucent` known to Mitsuba."""
    mi.register_bsdf("cook_torrance", CookTorrance)
    mi.register_bsdf("translucent", Translucent)
