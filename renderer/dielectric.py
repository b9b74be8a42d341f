"""A rough surface between two media: what its microfacets do not reflect they refract.

With `eta` the index of refraction beyond the surface over that on the side of w_o, and the microfacets' normals m:

- refraction `w_i = -w_o / eta + (c / eta - c') m`, `c = w_o.m`, `c' = sqrt(c² + eta² - 1) / eta`; none where that is a
  root of a negative number: all is reflected
- Fresnel's `F = (p² + s²) / 2`, `p = (eta c - c') / (eta c + c')`, `s = (c - eta c') / (c + eta c')`, unpolarised
- `f_r = D F G / (4 mu_i mu_o)`, `f_t = (w_o.m) |w_i.m| D (1 - F) G / (mu_o |mu_i| (w_o.m + eta w_i.m)²)`

D and G as in `microfacet`; f_t is 0 where m is seen from behind. It is of radiance, which is squeezed into a denser
medium: `f_t(i, o) / eta_o² = f_t(o, i) / eta_i²`. Flux is not: what photons are multiplied by is that over `spread`,
`eta_o² / eta_i²`. For eta = 1 all of it is exact: F is 0 and w_i is -w_o.

Directions are in the local frame, z the normal on the side of w_o, and leave the surface.
Sources: Walter, Marschner, Li, Torrance, "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007; Veach,
"Robust Monte Carlo Methods for Light Transport Simulation", 1997, section 5.2 (radiance and flux).
"""

import math
from typing import NamedTuple

from termwise.renderer.jit import device
from termwise.renderer.microfacet import eval_dg, half_vector, pdf_lobe, sample_visible_normal, smith_g1
from termwise.renderer.vector import Vec3, add, dot, length, mad, max_component, scale
from termwise.renderer.warp import hemisphere_ring

REFLECTED, REFRACTED, EITHER = range(3)
"""Which lobe a direction is of."""

BLACK = Vec3(0.0, 0.0, 0.0)


class Interface(NamedTuple):
    """Where a direction meets a surface: Beckmann's alpha, eta, and the weights of the two lobes."""

    alpha: float
    eta: float
    reflection: float
    transmission: Vec3


@device
def _root(cos: float, eta: float) -> float:
    """Square of eta c'; in this form it is exact for eta = 1, and keeps its digits near it."""
    return cos * cos + (eta - 1.0) * (eta + 1.0)


@device
def fresnel_dielectric(cos: float, eta: float) -> float:
    """Reflectance of a smooth surface at the cosine `cos` >= 0; 1 beyond the critical angle."""
    root = _root(cos, eta)
    if root <= 0.0:
        return 0.0 if eta == 1.0 else 1.0
    beyond = math.sqrt(root) / eta
    parallel = (eta * cos - beyond) / (eta * cos + beyond)
    across = (cos - eta * beyond) / (cos + eta * beyond)
    return 0.5 * (parallel * parallel + across * across)


@device
def refract(wo: Vec3, m: Vec3, eta: float) -> Vec3:
    """The way beyond a smooth surface of normal m, where F < 1."""
    cos = dot(wo, m)
    beyond = math.sqrt(max(0.0, _root(cos, eta))) / eta
    return mad(m, cos / eta - beyond, scale(wo, -1.0 / eta))


@device
def eval_reflection(wi: Vec3, wo: Vec3, alpha: float, eta: float) -> float:
    """f_r mu_i; 0 below the surface."""
    if wi.z <= 0.0 or wo.z <= 0.0:
        return 0.0
    m = half_vector(wi, wo)
    return 0.25 * fresnel_dielectric(max(0.0, dot(wo, m)), eta) * eval_dg(m, wi, wo, alpha) / wo.z


@device
def refracting_normal(wi: Vec3, wo: Vec3, eta: float) -> Vec3:
    """Unit normal of the microfacets that refract one direction into the other, 0 where none does."""
    sum_ = add(wo, scale(wi, eta))
    norm = length(sum_)
    if norm == 0.0:
        return BLACK
    # It points into the rarer medium as it is.
    return scale(sum_, (-1.0 if sum_.z < 0.0 else 1.0) / norm)


@device
def _squeezed(wi: Vec3, wo: Vec3, eta: float) -> tuple[Vec3, float]:
    """The refracting normal m, and `(w_o.m) |w_i.m| / (w_o.m + eta w_i.m)²`, 0 where m is seen from behind."""
    m = refracting_normal(wi, wo, eta)
    cos_o, cos_i = dot(wo, m), dot(wi, m)
    if wi.z >= 0.0 or wo.z <= 0.0 or cos_o <= 0.0 or cos_i >= 0.0:
        return m, 0.0
    across = cos_o + eta * cos_i
    return m, -cos_o * cos_i / (across * across)


@device
def eval_transmission(wi: Vec3, wo: Vec3, alpha: float, eta: float) -> float:
    """f_t |mu_i|, of radiance; 0 above the surface."""
    m, factor = _squeezed(wi, wo, eta)
    if factor == 0.0:
        return 0.0
    through = 1.0 - fresnel_dielectric(dot(wo, m), eta)
    return factor * through * eval_dg(m, Vec3(wi.x, wi.y, -wi.z), wo, alpha) / wo.z


@device
def pdf_transmission(wi: Vec3, wo: Vec3, alpha: float, eta: float) -> float:
    """Density of refraction by visible normals, per solid angle of wi: G1(wo) D(m) (wo.m) / mu_o dm / dwi."""
    m, factor = _squeezed(wi, wo, eta)
    if factor == 0.0:
        return 0.0
    visible = eval_dg(m, Vec3(0.0, 0.0, 1.0), wo, alpha) / wo.z
    return visible * factor * eta * eta


@device
def _sent(interface: Interface, cos: float) -> tuple[float, float]:
    """Weights of what microfacets reflect and of what they refract."""
    fresnel = fresnel_dielectric(cos, interface.eta)
    return interface.reflection * fresnel, max_component(interface.transmission) * (1.0 - fresnel)


@device
def pdf_interface(way: int, interface: Interface, wi: Vec3, wo: Vec3) -> float:
    """Density of `sample_interface` per solid angle of wi."""
    if wo.z <= 0.0 or wi.z == 0.0:
        return 0.0
    crosses = wi.z < 0.0
    m = refracting_normal(wi, wo, interface.eta) if crosses else half_vector(wi, wo)
    reflected, refracted = _sent(interface, max(0.0, dot(wo, m)))
    sent = refracted if crosses else reflected
    if sent == 0.0 or (way != EITHER and crosses != (way == REFRACTED)):
        return 0.0
    share = sent / (reflected + refracted) if way == EITHER else 1.0
    if crosses:
        return share * pdf_transmission(wi, wo, interface.alpha, interface.eta)
    return share * pdf_lobe(wi, wo, interface.alpha)


@device
def sample_interface(
    way: int, interface: Interface, wo: Vec3, u: float, v: float, choice: float
) -> tuple[Vec3, Vec3, float]:
    """Direction by visible normals, its weight `f |mu_i| / pdf`, and the spread in that, 1 of what is reflected.

    With `way` EITHER one of the lobes is chosen by what it sends on: `choice` below its share means REFRACTED.
    """
    alpha, eta = interface.alpha, interface.eta
    m = sample_visible_normal(wo, alpha, u, v)
    cos = dot(wo, m)
    if wo.z <= 0.0 or cos <= 0.0:
        return wo, BLACK, 1.0
    reflected, refracted = _sent(interface, cos)
    crosses = refracted > 0.0 and (way == REFRACTED or (way == EITHER and choice * (reflected + refracted) < refracted))
    total = reflected + refracted if way == EITHER else refracted if way == REFRACTED else reflected
    if crosses:
        wi = refract(wo, m, eta)
        if wi.z >= 0.0:
            return wi, BLACK, 1.0
        spread = 1.0 / (eta * eta)
        weight = total / max_component(interface.transmission) * smith_g1(-wi.z, alpha) * spread
        return wi, scale(interface.transmission, weight), spread
    wi = Vec3(2.0 * cos * m.x - wo.x, 2.0 * cos * m.y - wo.y, 2.0 * cos * m.z - wo.z)
    weight = total * smith_g1(wi.z, alpha)
    return wi, Vec3(weight, weight, weight), 1.0


@device
def sample_uniformly(way: int, interface: Interface, wo: Vec3, u: float, v: float) -> tuple[Vec3, Vec3, float]:
    """Any direction of the hemisphere of the one lobe, or of the sphere, its weight, and the spread in that."""
    alpha, eta = interface.alpha, interface.eta
    mu = 2.0 * u - 1.0 if way == EITHER else -u if way == REFRACTED else u
    wi = hemisphere_ring(mu, v)
    solid_angle = 4.0 * math.pi if way == EITHER else 2.0 * math.pi
    if mu < 0.0:
        weight = solid_angle * eval_transmission(wi, wo, alpha, eta)
        return wi, scale(interface.transmission, weight), 1.0 / (eta * eta)
    weight = solid_angle * interface.reflection * eval_reflection(wi, wo, alpha, eta)
    return wi, Vec3(weight, weight, weight), 1.0
