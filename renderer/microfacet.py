"""Cook-Torrance `f = D F G / (4 mu_i mu_o)`: Beckmann D, Schlick F, separable Smith G with the exact error function.

- `D(m) = exp(-tan²(theta_m) / alpha²) / (pi alpha² cos⁴(theta_m))`
- `F = F0 + (1 - F0)(1 - wo.m)⁵`
- `G1(w) = 2 / (1 + erf(a) + exp(-a²) / (a sqrt(pi)))`, `a = 1 / (alpha tan(theta))`; `G = G1(wi) G1(wo)`

Directions are in the local frame, z the normal, and leave the surface. The lobe is zero below the surface. The angles
enter as cosines; each function is finite down to mu = 1e-12.
Sources: Beckmann, Spizzichino 1963; Cook, Torrance, TOG 1(1), 1982; Walter et al., EGSR 2007 (normalisation);
Schlick, CGF 13(3), 1994.
"""

import math

from termwise.renderer.jit import device
from termwise.renderer.vector import Vec3, add, dot, length, scale
from termwise.renderer.warp import INV_PI

_SQRT_PI = math.sqrt(math.pi)
_LOWEST = -1.0 + 2.0**-53  # the least value of erf that has a finite inverse


@device
def beckmann_d(m: Vec3, alpha: float) -> float:
    """Density of microfacet normals over projected area: ∫ D(m) cos(theta_m) dm = 1."""
    if m.z <= 0.0:
        return 0.0
    cos2 = m.z * m.z
    slope2 = (m.x * m.x + m.y * m.y) / (cos2 * alpha * alpha)
    return math.exp(-slope2) * INV_PI / (alpha * alpha * cos2 * cos2)


@device
def smith_g1(mu: float, alpha: float) -> float:
    """Share of microfacets visible at cosine `mu`; in [0, 1]."""
    if mu <= 0.0:
        return 0.0
    sin2 = max(0.0, 1.0 - mu * mu)
    if sin2 == 0.0:
        return 1.0
    a = mu / (alpha * math.sqrt(sin2))
    # At most 1 in exact arithmetic; rounding may add an ulp.
    return min(1.0, 2.0 / (1.0 + math.erf(a) + math.exp(-a * a) / (a * _SQRT_PI)))


@device
def fresnel_schlick(f0: Vec3, cos_theta: float) -> Vec3:
    """Reflectance of a microfacet at cosine wo.m."""
    x = min(1.0, max(0.0, 1.0 - cos_theta))
    x2 = x * x
    rise = x2 * x2 * x
    return Vec3(f0.x + (1.0 - f0.x) * rise, f0.y + (1.0 - f0.y) * rise, f0.z + (1.0 - f0.z) * rise)


@device
def half_vector(wi: Vec3, wo: Vec3) -> Vec3:
    """Unit half-way vector; the normal where wi = -wo leaves it undefined."""
    sum_ = add(wi, wo)
    norm = length(sum_)
    if norm == 0.0:
        return Vec3(0.0, 0.0, 1.0)
    return scale(sum_, 1.0 / norm)


@device
def eval_dg(m: Vec3, wi: Vec3, wo: Vec3, alpha: float) -> float:
    """D G, of microfacets that both directions see from their front."""
    return beckmann_d(m, alpha) * smith_g1(wi.z, alpha) * smith_g1(wo.z, alpha)


@device
def eval_dfg(wi: Vec3, wo: Vec3, alpha: float, f0: Vec3) -> Vec3:
    """D F G, the numerator of every form of the model in the paper; 0 below the surface."""
    if wi.z <= 0.0 or wo.z <= 0.0:
        return Vec3(0.0, 0.0, 0.0)
    m = half_vector(wi, wo)
    return scale(fresnel_schlick(f0, dot(wo, m)), eval_dg(m, wi, wo, alpha))


@device
def eval_lobe(wi: Vec3, wo: Vec3, alpha: float, f0: Vec3) -> Vec3:
    """BRDF times cosine, `f mu_i = D F G / (4 mu_o)`."""
    if wo.z <= 0.0:
        return Vec3(0.0, 0.0, 0.0)
    return scale(eval_dfg(wi, wo, alpha, f0), 0.25 / wo.z)


@device
def _erf_inverse(x: float) -> float:
    """Starting value, within 1e-7 of it: Giles' single-precision polynomial (GPU Computing Gems, 2011)."""
    w = -math.log((1.0 - x) * (1.0 + x))
    if w < 5.0:
        w -= 2.5
        p = 2.81022636e-08
        p = 3.43273939e-07 + p * w
        p = -3.5233877e-06 + p * w
        p = -4.39150654e-06 + p * w
        p = 0.00021858087 + p * w
        p = -0.00125372503 + p * w
        p = -0.00417768164 + p * w
        p = 0.246640727 + p * w
        return (1.50140941 + p * w) * x
    w = math.sqrt(w) - 3.0
    p = -0.000200214257
    p = 0.000100950558 + p * w
    p = 0.00134934322 + p * w
    p = -0.00367342844 + p * w
    p = 0.00573950773 + p * w
    p = -0.0076224613 + p * w
    p = 0.00943887047 + p * w
    p = 1.00167406 + p * w
    return (2.83297682 + p * w) * x


@device
def _visible_slope(cot: float, tan: float, half: float, u: float) -> float:
    """Slope along the view of a visible facet at alpha = 1; `half` is the tangent of half of the view's angle.

    The visible slopes x < cot have the distribution `(cot - x) exp(-x²)` up to a factor, and with s = sqrt(pi)
    `cdf(x) = [cot (1 + erf(x)) + exp(-x²) / s] / [cot (1 + erf(cot)) + exp(-cot²) / s]`. It is inverted by Halley's
    steps, two of them as a rule, to 1e-11 in u. The start is exact at normal view, where `1 + erf(x)` is uniform, and
    near it elsewhere (the manner of Jakob, "An Improved Visible Normal Sampling Routine for the Beckmann Distribution",
    2014; the power is fitted to his).
    """
    top = math.erf(cot)
    # Multiplied through by tan, so that neither grazing nor normal view overflows.
    norm = 1.0 / (1.0 + top + tan * math.exp(-cot * cot) / _SQRT_PI)
    power = 1.0 + half * (-1.757 + half * (1.871 - 0.668 * half))
    x = min(cot, _erf_inverse(max(_LOWEST, top - (1.0 + top) * (1.0 - u) ** power)))
    for _ in range(6):
        density = math.exp(-x * x)
        value = norm * (1.0 + math.erf(x) + tan * density / _SQRT_PI) - u
        rest = 1.0 - x * tan
        if rest <= 0.0 or density == 0.0:
            break
        step = value * _SQRT_PI / (2.0 * norm * density * rest)
        # The curvature over the slope is -2 x - tan / rest.
        x = min(cot, x - step / (1.0 + 0.5 * step * (2.0 * x + tan / rest)))
        if abs(step) * tan < 3e-4 * min(rest, tan):
            break
    return x


@device
def _refined_erf_inverse(x: float) -> float:
    x = min(-_LOWEST, max(_LOWEST, x))
    y = _erf_inverse(x)
    # One of Halley's steps makes the polynomial's 1e-7 exact to double precision.
    step = (math.erf(y) - x) * 0.5 * _SQRT_PI * math.exp(y * y)
    return y - step / (1.0 + y * step)


@device
def sample_visible_normal(wo: Vec3, alpha: float, u: float, v: float) -> Vec3:
    """Microfacet normal of density `G1(wo) D(m) max(0, wo.m) / mu_o`.

    Heitz, d'Eon, "Importance Sampling Microfacet-Based BSDFs using the Distribution of Visible Normals", EGSR 2014:
    stretch the view to alpha = 1, sample the two slopes (the one across the view is Gaussian), rotate, unstretch.
    """
    x = alpha * wo.x
    y = alpha * wo.y
    z = wo.z
    sin = math.sqrt(x * x + y * y)
    cos_phi = 1.0
    sin_phi = 0.0
    if sin > 0.0:
        cos_phi = x / sin
        sin_phi = y / sin
    if sin <= 1e-9 * z:
        # Normal view: both slopes are Gaussian.
        along = _refined_erf_inverse(2.0 * u - 1.0)
    else:
        along = _visible_slope(z / sin, sin / z, sin / (z + math.sqrt(z * z + sin * sin)), u)
    across = _refined_erf_inverse(2.0 * v - 1.0)
    slope_x = alpha * (cos_phi * along - sin_phi * across)
    slope_y = alpha * (sin_phi * along + cos_phi * across)
    norm = 1.0 / math.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    return Vec3(-slope_x * norm, -slope_y * norm, norm)


@device
def sample_lobe(wo: Vec3, alpha: float, f0: Vec3, u: float, v: float) -> tuple[Vec3, Vec3]:
    """Direction by visible normals, and its weight `f mu_i / pdf = F G1(wi) <= 1`."""
    m = sample_visible_normal(wo, alpha, u, v)
    cos = dot(wo, m)
    wi = Vec3(2.0 * cos * m.x - wo.x, 2.0 * cos * m.y - wo.y, 2.0 * cos * m.z - wo.z)
    if wi.z <= 0.0 or cos <= 0.0 or wo.z <= 0.0:
        return wi, Vec3(0.0, 0.0, 0.0)
    return wi, scale(fresnel_schlick(f0, cos), smith_g1(wi.z, alpha))


@device
def pdf_lobe(wi: Vec3, wo: Vec3, alpha: float) -> float:
    """Density of `sample_lobe` per solid angle of wi: G1(wo) D(m) / (4 mu_o)."""
    if wo.z <= 0.0:
        return 0.0
    m = half_vector(wi, wo)
    if m.z <= 0.0 or dot(wo, m) <= 0.0:
        return 0.0
    return smith_g1(wo.z, alpha) * beckmann_d(m, alpha) * 0.25 / wo.z
