"""The predictions by quadrature against SciPy's adaptive quadrature, brute-force sums and identities."""

import math

import numpy as np
import pytest
from scipy import integrate, special

from termwise.reports.study import closed_forms
from termwise.scenes.limits import Limit
from termwise.scenes.model import Material

WHITE = (1.0, 1.0, 1.0)
CORRECT = Limit("specular")
PAPER = Limit("specular", lobe=4 / math.pi)
LITERAL = Limit("specular", lobe=4 / math.pi, cosine="outgoing")
CODE = Limit("specular", lobe=2 / math.pi, diffuse=0.5)

# alpha, mu_o: A, paper, paper-literal, paper-code, as derived with the method (quadrature and Monte Carlo of 2026).
FURNACE = [
    (0.05, 1.0, 1.0000, 1.2732, 1.2796, 1.1366),
    (0.30, 0.7, 0.9658, 1.2296, 1.6488, 1.1148),
    (0.30, 0.1, 0.9314, 1.1859, 0.3611, 1.0929),
    (0.60, 1.0, 0.8558, 1.0897, 2.3535, 1.0448),
    (1.00, 1.0, 0.4616, 0.5877, 1.5980, 0.7939),
]


def material(alpha: float, f0: float = 1.0, gloss: float = 1.0) -> Material:
    return Material(WHITE, gloss, alpha, (f0, f0, f0))


@pytest.mark.parametrize(("alpha", "mu_o", "a", "paper", "literal", "code"), FURNACE)
def test_furnace_table(alpha, mu_o, a, paper, literal, code):
    """The numbers that the method publishes, to the digits given there."""
    found = [closed_forms.albedo(limit, material(alpha), mu_o)[0] for limit in (CORRECT, PAPER, LITERAL, CODE)]
    np.testing.assert_allclose(found, [a, paper, literal, code], atol=1.1e-4)


@pytest.mark.parametrize(("alpha", "mu_o", "f0"), [(0.3, 0.5, 0.04), (0.6, 0.9, 1.0), (1.0, 0.2, 0.5)])
def test_albedo_by_adaptive_quadrature(alpha, mu_o, f0):
    """∫ f mu_i dw with f written from its definition over vectors, by SciPy."""
    wo = np.array([math.sqrt(1 - mu_o**2), 0.0, mu_o])

    def smith(mu):
        a = mu / (alpha * math.sqrt(1 - mu * mu))
        return 1 / (1 + 0.5 * (special.erf(a) - 1) + math.exp(-a * a) / (2 * a * math.sqrt(math.pi)))

    def value(phi, mu):
        wi = np.array([math.sqrt(1 - mu * mu) * math.cos(phi), math.sqrt(1 - mu * mu) * math.sin(phi), mu])
        h = (wi + wo) / np.linalg.norm(wi + wo)
        d = math.exp((h[2] ** 2 - 1) / (h[2] ** 2 * alpha**2)) / (math.pi * alpha**2 * h[2] ** 4)
        fresnel = f0 + (1 - f0) * (1 - wo @ h) ** 5
        return 2 * d * fresnel * smith(mu) * smith(mu_o) / (4 * mu_o)

    exact = integrate.dblquad(value, 0, 1 - 1e-12, 0, math.pi, epsabs=1e-7)[0]
    assert closed_forms.albedo(CORRECT, material(alpha, f0), mu_o)[0] == pytest.approx(exact, abs=1e-6)


@pytest.mark.parametrize("rings", [1, 16, 1024])
def test_rings_of_the_lambertian_lobe_are_exact(rings):
    """(1/N) sum k / (N + 1) = 1/2 for every N, hence 2 diffuse times that is diffuse."""
    only_diffuse = Limit("specular", lobe=0.0, diffuse=0.5, rings=rings)
    assert closed_forms.albedo(only_diffuse, material(0.3), 0.7)[0] == pytest.approx(0.5, rel=1e-12)


@pytest.mark.parametrize(("rings", "expected"), [(16, 0.062), (64, 0.016), (256, 0.004)])
def test_ring_bias_off_the_normal_is_one_over_n(rings, expected):
    """A narrow lobe off the normal is 0 at both ends: the open rule is (N + 1)/N times the integral."""
    rule = Limit("specular", rings=rings)
    smooth = material(0.15)
    bias = closed_forms.albedo(rule, smooth, 0.5)[0] / closed_forms.albedo(CORRECT, smooth, 0.5)[0] - 1
    assert bias == pytest.approx(expected, abs=1e-3)
    assert bias == pytest.approx(1 / rings, rel=0.06)


@pytest.mark.parametrize(("rings", "expected"), [(64, -0.85), (256, -0.34), (1024, -0.094)])
def test_ring_bias_at_normal_view(rings, expected):
    """A lobe of roughness 0.05 around the normal lies beyond the last ring for small N."""
    bias = closed_forms.albedo(Limit("specular", rings=rings), material(0.05), 1.0)[0] - 1
    assert bias == pytest.approx(expected, abs=5e-3)


@pytest.mark.slow
def test_chain_of_a_narrow_lobe_is_geometric():
    """F0 = 1 and roughness 0.05: A = 1 near the normal, where the chain stays: q + q² + ..., q = gloss lobe."""
    mirror = material(0.05, gloss=0.6)
    for limit in (CORRECT, PAPER):
        q = 0.6 * limit.lobe
        expected = 0.4 * np.cumsum(q ** np.arange(1, 5))
        np.testing.assert_allclose(closed_forms.closed_sphere(limit, mirror, 4)[:, 0], expected, rtol=2e-3)


def test_chain_of_the_lambertian_lobe_is_geometric():
    """diffuse = 1/2 alone: each bounce keeps gloss / 2, whatever the rule."""
    for rings in (None, 16):
        limit = Limit("specular", lobe=0.0, diffuse=0.5, rings=rings)
        found = closed_forms.closed_sphere(limit, material(0.3, gloss=0.8), 3)[:, 0]
        np.testing.assert_allclose(found, 0.2 * np.cumsum(0.4 ** np.arange(1, 4)), rtol=1e-12)


@pytest.mark.slow
def test_gain_of_isotropic_light():
    """q = gloss (diffuse + lobe A): A -> 1 for a mirror of F0 = 1."""
    mirror = material(0.05, gloss=0.8)
    assert closed_forms.gain(CODE, mirror) == pytest.approx(0.8 * (0.5 + 2 / math.pi), rel=0.02)
    assert closed_forms.gain(PAPER, mirror) == pytest.approx(0.8 * 4 / math.pi, rel=0.02)
    assert closed_forms.gain(PAPER, mirror) > 1 > closed_forms.gain(PAPER, material(0.05, gloss=0.7))
