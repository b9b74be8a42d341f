"""Predictions by quadrature: what a Limit of the specular term is where the light that arrives is known.

Under a white sky `L_specular = gloss A(mu_o)`, the azimuth integrated:

    T(mu_i, mu_o) = lobe ∫ D F G / (4 mu_o) dphi + 2 diffuse mu_i,      A(mu_o) = sum over nodes of w_i T(mu_i, mu_o).

The nodes mu_i are Gauss and Legendre's, or the paper's rings, each of weight 1 / N. In a closed sphere every chord
meets the surface at equal angles, so a chain of bounces is a power of T. NumPy alone; neither side's code is used.
Sources: as in `renderer.microfacet`; restated here, because a prediction may not share the code that it judges.
"""

import functools

import numpy as np
from scipy import special

from termwise.scenes.limits import Limit
from termwise.scenes.model import Material


def resolution(roughness: float) -> int:
    """Number of cosines, 5/3 of that of azimuths over half a turn: twice as many change no albedo by 1e-6."""
    return int(np.clip(60.0 / roughness, 300, 3000))


@functools.cache
def legendre(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss and Legendre's nodes and weights in (-1, 1), kept: thousands of them take seconds to find."""
    return special.roots_legendre(count)


def cosine_nodes(limit: Limit, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Cosines mu_i in (0, 1) and their weights: the paper's rings, or `count` of a rule for the integral."""
    if limit.rings is not None:
        return np.arange(1, limit.rings + 1) / (limit.rings + 1), np.full(limit.rings, 1 / limit.rings)
    x, w = legendre(count)
    # Quadratic at the upper end, where a narrow lobe at normal view stands.
    t = (x + 1) / 2
    return 1 - (1 - t) ** 2, w * (1 - t)


def transport(limit: Limit, material: Material, mu_i: np.ndarray, mu_o: float) -> np.ndarray:
    """T(mu_i, mu_o): light reflected at cosine mu_o per unit of mu_i and of radiance, (N, 3); gloss left out."""
    alpha, f0 = material.roughness, np.array(material.f0)
    # The midpoint rule, which converges exponentially for a periodic integrand.
    azimuths = int(0.6 * resolution(alpha))
    phi = (np.arange(azimuths) + 0.5) * np.pi / azimuths
    sin_i, sin_o = np.sqrt(1 - mu_i**2), np.sqrt(max(0.0, 1 - mu_o**2))
    # wi.wo fixes the half vector: |wi + wo|² = 2 + 2 wi.wo, wo.wh = |wi + wo| / 2.
    cosine = mu_i[:, None] * mu_o + sin_i[:, None] * sin_o * np.cos(phi)
    length = np.sqrt(np.maximum(2 + 2 * cosine, 1e-300))
    mu_h = np.minimum(1.0, (mu_i[:, None] + mu_o) / length)
    tan2 = (1 - mu_h**2) / mu_h**2
    density = np.exp(-tan2 / alpha**2) / (np.pi * alpha**2 * mu_h**4)
    rise = (1 - np.minimum(1.0, length / 2)) ** 5
    fresnel = np.stack([np.mean(density * (f + (1 - f) * rise), axis=1) for f in f0], axis=-1)
    shadowing = smith_g1(mu_i, alpha) * smith_g1(np.array([mu_o]), alpha)
    denominator = 4 * (mu_o if limit.cosine == "incident" else mu_i)
    lobe = 2 * np.pi * fresnel * (shadowing / denominator)[:, None]
    return limit.lobe * lobe + (2 * limit.diffuse * mu_i)[:, None]


def smith_g1(mu: np.ndarray, alpha: float) -> np.ndarray:
    """Masking of the Beckmann distribution with the exact error function."""
    tan = np.sqrt(np.maximum(1 - mu**2, 1e-300)) / mu
    a = 1 / (alpha * tan)
    return 2 / (1 + special.erf(a) + np.exp(-a * a) / (a * np.sqrt(np.pi)))


def albedo(limit: Limit, material: Material, mu_o: float) -> np.ndarray:
    """Reflected share of a white sky at cosine `mu_o`, (3,); gloss left out. `A` for the correct limit."""
    mu_i, weights = cosine_nodes(limit, resolution(material.roughness))
    return weights @ transport(limit, material, mu_i, mu_o)


def closed_sphere(limit: Limit, material: Material, bounces: int) -> np.ndarray:
    """`L_specular` of `scenes.analytic.glossy_sphere` after 1 .. `bounces` vertices, (bounces, 3).

    `(1 - gloss) sum_{j=1..M} (gloss T)^j 1` at mu_o = 1, by the nodes themselves as the grid of the function (Nystrom).
    """
    mu, weights = cosine_nodes(limit, resolution(material.roughness) // 3)  # each node costs a column
    matrix = np.array([transport(limit, material, mu, each) * weights[:, None] for each in mu])
    seen = transport(limit, material, mu, 1.0) * weights[:, None]
    value, total, images = np.ones((len(mu), 3)), np.zeros(3), []
    for bounce in range(bounces):
        total = total + material.gloss ** (bounce + 1) * np.einsum("ic,ic->c", seen, value)
        value = np.einsum("oic,ic->oc", matrix, value)
        images.append((1 - material.gloss) * total)
    return np.array(images)


def gain(limit: Limit, material: Material) -> float:
    """q: the share of light that a closed room of this material keeps a bounce; its series diverges where q > 1.

    `gloss (diffuse + lobe A)`, A averaged over the hemisphere with the cosine: the gain of isotropic light.
    """
    x, w = legendre(12)
    mu = (x + 1) / 2
    means = np.array([albedo(limit, material, float(each)).max() for each in mu])
    return float(material.gloss * np.sum(w / 2 * 2 * mu * means))
