"""The lobes of a dielectric: Fresnel, Snell, reciprocity of radiance and flux, energy, sampling weights and densities.

Rationale: a forgotten eta², a swapped eta or a missed total reflection makes pictures that look like glass. What is
expected is restated here in NumPy from other forms of the laws: Fresnel by the angles, the lobe by slopes of
microfacets with Snell's law in the plane.
"""

import math
from typing import Any

import numpy as np
import pytest

from termwise.renderer.dielectric import (
    EITHER,
    REFLECTED,
    REFRACTED,
    Interface,
    eval_reflection,
    eval_transmission,
    fresnel_dielectric,
    pdf_interface,
    pdf_transmission,
    refract,
    refracting_normal,
    sample_interface,
    sample_uniformly,
)
from termwise.renderer.vector import Vec3
from tests.kernels.test_jacobians import interior, jacobian
from tests.kernels.test_microfacet import direction, smith

WHITE = Vec3(1.0, 1.0, 1.0)
UP = Vec3(0.0, 0.0, 1.0)
ETAS = [1.5, 1 / 1.5, 1.1, 0.1, 10.0]


def glass(alpha: float, eta: float) -> Interface:
    return Interface(alpha, eta, 1.0, WHITE)


def fresnel(cos: Any, eta: float) -> Any:
    """By the angles of incidence and refraction: sin² and tan² of their difference over their sum."""
    angle = np.arccos(cos)
    beyond = np.arcsin(np.minimum(np.sin(angle) / eta, 1.0))
    across = np.sin(angle - beyond) / np.sin(angle + beyond)
    along = np.tan(angle - beyond) / np.tan(angle + beyond)
    return np.where(np.sin(angle) < eta, (across**2 + along**2) / 2, 1.0)


@pytest.mark.parametrize("eta", ETAS)
def test_fresnel_by_the_angles(eta):
    for angle in np.linspace(0.01, 1.56, 60).tolist():
        assert fresnel_dielectric(math.cos(angle), eta) == pytest.approx(fresnel(math.cos(angle), eta), rel=1e-9)
    assert fresnel_dielectric(1.0, eta) == pytest.approx(((eta - 1) / (eta + 1)) ** 2, rel=1e-12)
    assert fresnel_dielectric(0.0, eta) == 1.0


@pytest.mark.parametrize("eta", ETAS)
def test_fresnel_is_that_of_the_way_back(eta):
    """F is the same from both sides of a ray's path, and at Brewster's angle only what swings across is reflected."""
    for angle in np.linspace(0.0, 1.5, 30).tolist():
        if math.sin(angle) < eta:
            back = math.cos(math.asin(math.sin(angle) / eta))
            assert fresnel_dielectric(back, 1 / eta) == pytest.approx(
                fresnel_dielectric(math.cos(angle), eta), abs=1e-9
            )
    brewster = math.cos(math.atan(eta))
    across = ((1 - eta**2) / (1 + eta**2)) ** 2
    assert fresnel_dielectric(brewster, eta) == pytest.approx(across / 2, rel=1e-9)


def test_all_is_reflected_beyond_the_critical_angle():
    eta = 1 / 1.5
    critical = math.sqrt(1 - eta**2)
    assert fresnel_dielectric(critical * (1 - 1e-12), eta) == 1.0
    assert fresnel_dielectric(critical * (1 + 1e-12), eta) < 1.0
    wo = direction(0.9 * critical, 0.3)
    wi, weight, _ = sample_interface(REFRACTED, glass(1e-4, eta), wo, 0.4, 0.6, 0.5)
    assert weight == (0.0, 0.0, 0.0)
    wi, weight, spread = sample_interface(EITHER, glass(1e-4, eta), wo, 0.4, 0.6, 1e-9)
    assert wi.z > 0.0
    assert weight.x == pytest.approx(1.0, abs=1e-9)
    assert spread == 1.0


@pytest.mark.parametrize("eta", ETAS)
def test_snell(eta):
    """In the plane of incidence, unit, with sines as eta to one: through the normal, and by the smooth limit."""
    for mu in (1.0, 0.9, 0.4, 0.05):
        if math.sqrt(1 - mu * mu) >= 0.999 * eta:
            continue
        wo = direction(mu, 0.7)
        exact = np.array([-wo.x / eta, -wo.y / eta, -math.sqrt(1 - (1 - mu * mu) / eta**2)])
        np.testing.assert_allclose(refract(wo, UP, eta), exact, atol=1e-14)
        wi, _, _ = sample_interface(REFRACTED, glass(1e-4, eta), wo, 0.3, 0.6, 0.5)
        # A slope of alpha turns the normal by it, and the ray by less than alpha / (eta cos).
        np.testing.assert_allclose(wi, exact, atol=3e-4 * max(1.0, 1 / eta) / -exact[2])
        np.testing.assert_allclose(refracting_normal(Vec3(*exact.tolist()), wo, eta), UP, atol=1e-12)


@pytest.mark.parametrize("mu", [1.0, 0.7, 0.1, 1e-6])
def test_no_interface_is_none(mu):
    """For eta = 1 nothing is reflected, and every direction goes on, exactly, by either lobe."""
    wo = direction(mu, 0.7)
    for way in (REFRACTED, EITHER):
        for u, v in interior(8):
            wi, weight, spread = sample_interface(way, glass(1e-4, 1.0), wo, u, v, 0.999999)
            assert wi == (-wo.x, -wo.y, -wo.z)
            assert (weight.x, spread) == (pytest.approx(float(smith(mu, 1e-4)) if mu < 1.0 else 1.0), 1.0)
    assert sample_interface(REFLECTED, glass(0.3, 1.0), wo, 0.3, 0.6, 0.5)[1] == (0.0, 0.0, 0.0)
    assert fresnel_dielectric(mu, 1.0) == fresnel_dielectric(0.0, 1.0) == 0.0


def test_nearly_no_interface_reflects_nearly_nothing():
    """((eta - 1) / (eta + 1))² keeps its digits where eta - 1 has a few."""
    for step in (1e-7, -1e-7, 1e-12):
        assert fresnel_dielectric(1.0, 1 + step) == pytest.approx(step**2 / 4, rel=1e-3)
        assert fresnel_dielectric(0.6, 1 + step) == pytest.approx(fresnel(0.6, 1 + step), rel=1e-2, abs=1e-24)


@pytest.mark.parametrize("eta", [1.5, 1 / 1.5, 1.1, 10.0])
@pytest.mark.parametrize("alpha", [0.1, 0.4, 1.0])
def test_radiance_is_reciprocal_over_the_square_of_the_index(alpha, eta):
    """`f_t(i, o) / eta_o² = f_t(o, i) / eta_i²`: eta_o is 1 at first, and then eta, seen from below."""
    seen = 0
    critical = math.sqrt(max(0.0, 1 - eta * eta))
    for mu_o, u, v in np.random.default_rng(1).uniform((critical + 1e-3, 0, 0), (1, 1, 1), (100, 3)).tolist():
        wo = direction(mu_o)
        wi, weight, _ = sample_interface(REFRACTED, glass(1.5 * alpha, eta), wo, u, v, 0.5)
        if weight.x == 0.0:
            continue
        there = eval_transmission(wi, wo, alpha, eta) / -wi.z
        below, above = Vec3(wi.x, wi.y, -wi.z), Vec3(wo.x, wo.y, -wo.z)
        back = eval_transmission(above, below, alpha, 1 / eta) / mu_o
        assert there == pytest.approx(back / eta**2, rel=1e-9)
        seen += there > 0
    assert seen > 20
    above = direction(0.5)
    assert eval_transmission(above, above, alpha, eta) == 0.0
    assert eval_reflection(Vec3(above.x, above.y, -above.z), above, alpha, eta) == 0.0


def energy(mu: float, alpha: float, eta: float) -> tuple[float, float]:
    """Flux reflected and transmitted, of 1, by the midpoint rule over slopes of the microfacets.

    Visible normals have the density G1(wo) D (wo.m) / mu; each reflects F, and what is seen beyond is G1(wi) of it.
    """
    n = 200
    t = 6 * alpha * (2 * (np.arange(n) + 0.5) / n - 1)
    x, y = np.meshgrid(t, t, indexing="ij")
    mz = 1 / np.sqrt(1 + x * x + y * y)
    m = np.stack([-x * mz, -y * mz, mz])
    wo = np.array(direction(mu))
    cos = np.einsum("c,cij->ij", wo, m)
    d = np.exp(-(x * x + y * y) / alpha**2) / (np.pi * alpha**2 * mz**4)
    g_o = 1.0 if mu == 1.0 else float(smith(mu, alpha))
    seen = np.where(cos > 0, g_o * d * cos / mu * mz**3, 0.0) * (12 * alpha / n) ** 2
    share = fresnel(np.clip(cos, 1e-9, 1 - 1e-12), eta)
    sines = 1 - np.clip(cos, 0, 1) ** 2
    beyond = np.sqrt(np.maximum(0.0, 1 - sines / eta**2))
    mu_r = (2 * cos * m - wo[:, None, None])[2]
    mu_t = (m * (cos / eta - beyond) - wo[:, None, None] / eta)[2]

    def masked(below: np.ndarray) -> np.ndarray:
        return np.where(below > 0, smith(np.clip(below, 1e-12, 1 - 1e-12), alpha), 0.0)

    return float((seen * share * masked(mu_r)).sum()), float((seen * (1 - share) * masked(-mu_t)).sum())


@pytest.mark.parametrize(
    ("alpha", "mu", "eta"),
    [(0.05, 0.9, 1.5), (0.3, 0.4, 1.5), (0.8, 0.7, 1.5), (0.05, 0.9, 1 / 1.5), (0.3, 0.7, 1 / 1.5)],
)
def test_energy(alpha, mu, eta, compiled):
    """Reflected and transmitted flux together are at most 1, and the sampler's; radiance is eta² times thinner."""
    reflected, transmitted = energy(mu, alpha, eta)
    assert 0.5 < reflected + transmitted <= 1 + 1e-6
    n = 96 if compiled else 24
    at = ((np.arange(n) + 0.5) / n).tolist()
    wo = direction(mu, 0.3)
    drawn = [[sample_interface(way, glass(alpha, eta), wo, u, v, 0.5) for u in at for v in at] for way in (0, 1)]
    means = [np.mean([weight.x / spread for _, weight, spread in each]) for each in drawn]
    np.testing.assert_allclose(means, [reflected, transmitted], rtol=1e-2 if compiled else 4e-2, atol=1e-4)
    assert {spread for _, weight, spread in drawn[1] if weight.x > 0} == {1 / (eta * eta)}
    # Whichever lobe is chosen, the choice makes up for its chance.
    either = [
        sample_interface(EITHER, glass(alpha, eta), wo, u, v, c)
        for (u, v), c in zip(np.random.default_rng(2).random((n * n, 2)).tolist(), at * n, strict=True)
    ]
    crossing = np.mean([weight.x / spread for wi, weight, spread in either if wi.z < 0] + [0.0]) * np.mean(
        [wi.z < 0 for wi, _, _ in either]
    )
    assert crossing == pytest.approx(transmitted, abs=0.02 if compiled else 0.08)


@pytest.mark.parametrize("eta", ETAS)
@pytest.mark.parametrize("alpha", [0.01, 0.3])
def test_weights_are_eval_over_density(alpha, eta):
    interface = Interface(alpha, eta, 0.8, Vec3(0.3, 0.6, 0.1))
    wo = direction(0.6, 0.3)
    for (u, v), choice in zip(interior(60), np.linspace(0.01, 0.99, 60).tolist(), strict=False):
        for way in (REFLECTED, REFRACTED, EITHER):
            wi, weight, _ = sample_interface(way, interface, wo, u, v, choice)
            if weight.y == 0.0:
                continue
            assert np.linalg.norm(wi) == pytest.approx(1.0, abs=1e-12)
            if wi.z < 0:
                found = np.array(interface.transmission) * eval_transmission(wi, wo, alpha, eta)
            else:
                found = np.full(3, interface.reflection * eval_reflection(wi, wo, alpha, eta))
            np.testing.assert_allclose(np.array(weight) * pdf_interface(way, interface, wi, wo), found, rtol=1e-6)


@pytest.mark.parametrize("eta", [1.5, 1 / 1.5, 1.01])
@pytest.mark.parametrize(("alpha", "mu"), [(0.001, 0.9), (0.3, 0.85), (1.0, 0.95)])
def test_refraction_has_its_density(alpha, mu, eta, compiled):
    wo = direction(mu, 0.4)
    checked = 0
    for u, v in interior(60 if compiled else 20):
        wi, weight, _ = sample_interface(REFRACTED, glass(alpha, eta), wo, u, v, 0.5)
        # Near the critical angle the direction has no derivative.
        if (
            weight.x > 0.05 * eta**-2
            and fresnel_dielectric(max(0.0, np.dot(wo, refracting_normal(wi, wo, eta))), eta) < 0.5
        ):
            area = jacobian(lambda a, b: sample_interface(REFRACTED, glass(alpha, eta), wo, a, b, 0.5)[0], u, v)
            assert area * pdf_transmission(wi, wo, alpha, eta) == pytest.approx(1, rel=1e-4)
            checked += 1
    assert checked > 5


def test_uniform_directions_have_the_same_mean(compiled):
    """The hemisphere of one lobe, and the sphere of both, weigh what visible normals do."""
    alpha, mu = 0.6, 0.8
    n = 64 if compiled else 24
    at = ((np.arange(n) + 0.5) / n).tolist()
    for eta in (1.5, 1 / 1.5):
        reflected, transmitted = energy(mu, alpha, eta)
        interface = Interface(alpha, eta, 0.5, Vec3(0.25, 0.5, 1.0))
        expected = {REFLECTED: 0.5 * reflected, REFRACTED: transmitted / eta**2}
        expected[EITHER] = expected[REFLECTED] + expected[REFRACTED]
        for way, mean in expected.items():
            drawn = [sample_uniformly(way, interface, direction(mu, 0.2), u, v)[1].z for u in at for v in at]
            assert np.mean(drawn) == pytest.approx(mean, rel=0.02 if compiled else 0.05)


@pytest.mark.parametrize("mu", [1e-8, 1e-4, 0.5, 1.0])
@pytest.mark.parametrize("eta", [0.1, 1 - 1e-7, 1.0, 1 + 1e-7, 10.0])
@pytest.mark.parametrize("alpha", [1e-4, 1.5])
def test_finite_at_the_ends(alpha, eta, mu):
    wo = direction(mu, 0.3)
    for u in (2.0**-33, 0.5, 1 - 2.0**-33):
        for v in (2.0**-33, 1 - 2.0**-33):
            for way in (REFLECTED, REFRACTED, EITHER):
                wi, weight, spread = sample_interface(way, glass(alpha, eta), wo, u, v, 0.5)
                assert np.linalg.norm(wi) == pytest.approx(1.0, abs=1e-9)
                assert 0.0 <= weight.x <= spread * (1 + 1e-12)
                assert math.isfinite(pdf_interface(way, glass(alpha, eta), wi, wo))
