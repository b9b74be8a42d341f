"""Cook-Torrance with Beckmann D, Schlick F, exact Smith G: normalisation, furnace, reciprocity, sampling weights.

Rationale: eval, sample and pdf must be one lobe, and its directional albedo must be the number that the derivation
gives. The expectations come from SciPy's quadrature of formulas restated here in NumPy, never from the renderer.
"""

import functools
import math
from typing import Any

import numpy as np
import pytest
from scipy import integrate, special

from termwise.renderer.microfacet import (
    _visible_slope,
    beckmann_d,
    eval_dfg,
    eval_lobe,
    fresnel_schlick,
    half_vector,
    pdf_lobe,
    sample_lobe,
    sample_visible_normal,
    smith_g1,
)
from termwise.renderer.terms import specular
from termwise.renderer.terms.specular import sample_variant
from termwise.renderer.vector import Vec3
from termwise.renderer.warp import hemisphere_ring, ring_cosine

ALPHAS = [0.05, 0.1, 0.3, 0.6, 1.0]
COSINES = [1.0, 0.999, 0.7, 0.3, 0.05]
WHITE = Vec3(1.0, 1.0, 1.0)

# alpha, mu_o, directional albedo S[1] for F0 = 1 (published with the method; re-derived below).
FURNACE = [(0.05, 1.0, 1.0000), (0.30, 0.7, 0.9658), (0.30, 0.1, 0.9314), (0.60, 1.0, 0.8558), (1.00, 1.0, 0.4616)]


def direction(mu: float, phi: float = 0.0) -> Vec3:
    sin = math.sqrt(1 - mu * mu)
    return Vec3(sin * math.cos(phi), sin * math.sin(phi), mu)


def smith(mu: Any, alpha: float) -> Any:
    """G1 = 1 / (1 + Lambda), Lambda = (erf(a) - 1) / 2 + exp(-a²) / (2 a sqrt(pi)) (Walter et al. 2007, eq. 26)."""
    a = mu / (alpha * np.sqrt(1 - mu * mu))
    return 1 / (1 + 0.5 * (special.erf(a) - 1) + np.exp(-a * a) / (2 * a * np.sqrt(np.pi)))


def lobe(mu_i, phi, mu_o: float, alpha: float):
    """f mu_i for F = 1, restated over arrays with the exact Smith G and the normalised Beckmann D."""
    sin_i, sin_o = np.sqrt(1 - mu_i**2), np.sqrt(1 - mu_o**2)
    wi = np.stack([sin_i * np.cos(phi), sin_i * np.sin(phi), mu_i])
    m = wi + np.array([sin_o, 0.0, mu_o]).reshape(3, *[1] * np.ndim(mu_i))
    m = m / np.sqrt((m * m).sum(axis=0))
    tan2 = (1 - m[2] ** 2) / m[2] ** 2
    d = np.exp(-tan2 / alpha**2) / (np.pi * alpha**2 * m[2] ** 4)
    g_o = 1.0 if mu_o == 1.0 else smith(np.float64(mu_o), alpha)
    return d * smith(mu_i, alpha) * g_o / (4 * mu_o)


@functools.cache
def albedo(mu_o: float, alpha: float) -> float:
    """∫ f mu_i dw by the midpoint rule over slopes of the half vector.

    Half vectors m = (-x, -y, 1) / sqrt(1 + x² + y²); dw_i = 4 (wo.m) dm and dm = m_z³ dx dy. Slopes beyond 6.5 alpha
    weigh exp(-42); 1000² nodes resolve the cut at the horizon to 1e-5.
    """
    n = 1000
    t = 6.5 * alpha * (2 * (np.arange(n) + 0.5) / n - 1)
    x, y = np.meshgrid(t, t, indexing="ij", sparse=True)
    cell = (13 * alpha / n) ** 2
    mz = 1 / np.sqrt(1 + x * x + y * y)
    sin_o = np.sqrt(1 - mu_o * mu_o)
    cos = (-x * sin_o + mu_o) * mz
    mu_i = 2 * cos * mz - mu_o
    seen = (cos > 0) & (mu_i > 0)
    mu = np.where(seen, mu_i, 0.5)
    d = np.exp(-(x * x + y * y) / alpha**2) / (np.pi * alpha**2 * mz**4)
    g_o = 1.0 if mu_o == 1.0 else smith(np.float64(mu_o), alpha)
    mu = np.minimum(mu, 1 - 1e-15)
    value = d * smith(mu, alpha) * g_o / (4 * mu_o) * 4 * cos * mz**3
    return float(cell * np.where(seen, value, 0.0).sum())


@pytest.mark.parametrize("alpha", ALPHAS)
def test_normal_distribution_is_normalised(alpha):
    """∫ D(m) cos(theta_m) dm = 1, by SciPy over theta; the published definition of D."""

    def integrand(theta):
        return 2 * math.pi * math.sin(theta) * math.cos(theta) * beckmann_d(direction(math.cos(theta)), alpha)

    total, _ = integrate.quad(integrand, 0, math.pi / 2, points=[alpha, 3 * alpha] if alpha < 0.4 else None)
    assert total == pytest.approx(1.0, abs=1e-8)


@pytest.mark.parametrize("alpha", ALPHAS)
def test_smith_is_one_over_one_plus_lambda(alpha):
    """G1 against Lambda's definition, restated; its limits at both ends; never above 1."""
    mu = np.linspace(1e-3, 0.999, 97)
    found = np.array([smith_g1(m, alpha) for m in mu.tolist()])
    np.testing.assert_allclose(found, smith(mu, alpha), rtol=1e-12)
    assert smith_g1(1.0, alpha) == 1.0
    assert smith_g1(0.0, alpha) == smith_g1(-0.5, alpha) == 0.0
    # a -> 0: G1 -> 2 sqrt(pi) a.
    assert smith_g1(1e-9, alpha) == pytest.approx(2 * math.sqrt(math.pi) * 1e-9 / alpha, rel=1e-6)
    assert (found <= 1).all()


def test_smith_shadows_as_much_as_it_must(compiled):
    """Visible projected area is the projected area: ∫ G1 max(0, w.m) D dm = mu (Heitz 2014, eq. 2)."""
    for alpha, mu in ((0.3, 0.2), (0.6, 0.5), (1.0, 0.9)):

        def visible(y, x, mu=mu, alpha=alpha):
            mz = 1 / math.sqrt(1 + x * x + y * y)
            cos = max(0.0, (-x * math.sqrt(1 - mu * mu) + mu) * mz)
            d = math.exp(-(x * x + y * y) / alpha**2) / (math.pi * alpha**2 * mz**4)
            return cos * d * mz**3

        reach = 6 * alpha
        edge = mu / math.sqrt(1 - mu * mu)
        total = integrate.dblquad(visible, -reach, min(reach, edge), -reach, reach, epsabs=1e-7)[0]
        assert smith_g1(mu, alpha) * total == pytest.approx(mu, abs=1e-5)


def test_fresnel_at_its_ends():
    """F0 at normal incidence, 1 at grazing, F0 + (1 - F0) / 32 at cosine 1/2; clamped outside [0, 1]."""
    f0 = Vec3(0.04, 0.5, 1.0)
    np.testing.assert_allclose(fresnel_schlick(f0, 1.0), f0, rtol=1e-15)
    np.testing.assert_allclose(fresnel_schlick(f0, 0.0), (1, 1, 1), rtol=1e-15)
    np.testing.assert_allclose(fresnel_schlick(f0, 0.5), [f + (1 - f) / 32 for f in f0], rtol=1e-15)
    np.testing.assert_allclose(fresnel_schlick(f0, 1.0 + 1e-15), f0, rtol=1e-15)


@pytest.mark.parametrize("alpha", ALPHAS)
def test_reciprocity(alpha):
    """f(wi, wo) = f(wo, wi), where f = eval / mu_i."""
    rng = np.random.default_rng(1)
    f0 = Vec3(0.04, 0.3, 0.9)
    for mu_i, mu_o, phi in zip(*rng.uniform(0.05, 1, (2, 50)), rng.uniform(0, 6, 50), strict=True):
        wi, wo = direction(mu_i, phi), direction(mu_o)
        there = np.array(eval_lobe(wi, wo, alpha, f0)) / mu_i
        back = np.array(eval_lobe(wo, wi, alpha, f0)) / mu_o
        np.testing.assert_allclose(there, back, rtol=1e-9, atol=1e-300)


@pytest.mark.parametrize("alpha", [0.2, 0.5, 1.0])
def test_eval_against_the_formula(alpha):
    """f mu_i against D F G / (4 mu_o) restated in NumPy, and D F G itself."""
    rng = np.random.default_rng(2)
    for mu_i, mu_o, phi in zip(*rng.uniform(0.05, 0.999, (2, 50)), rng.uniform(0, 6, 50), strict=True):
        expected = lobe(np.float64(mu_i), np.float64(phi), mu_o, alpha)
        found = eval_lobe(direction(mu_i, phi), direction(mu_o), alpha, WHITE)
        np.testing.assert_allclose(found, expected, rtol=1e-9)
        dfg = eval_dfg(direction(mu_i, phi), direction(mu_o), alpha, WHITE)
        np.testing.assert_allclose(dfg, 4 * mu_o * expected, rtol=1e-9)


def test_nothing_below_the_surface():
    """Directions below or in the surface give exactly 0, for eval, sample and pdf alike."""
    up, level, down = direction(0.5), Vec3(1.0, 0.0, 0.0), direction(-0.5, 2.0)
    for wi, wo in ((down, up), (up, down), (down, down), (level, up), (up, level)):
        assert eval_lobe(wi, wo, 0.5, WHITE) == (0.0, 0.0, 0.0)
    assert pdf_lobe(up, down, 0.5) == 0.0
    assert half_vector(up, Vec3(-up.x, -up.y, -up.z)) == (0.0, 0.0, 1.0)


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("mu_o", COSINES)
def test_weight_is_eval_over_pdf_and_at_most_one(alpha, mu_o, compiled):
    """pdf x weight = f mu_i, each from its own function; weight <= 1; wi is a unit vector."""
    rng = np.random.default_rng(3)
    wo = direction(mu_o, 0.7)
    f0 = Vec3(0.04, 0.5, 1.0)
    for u, v in rng.uniform(0, 1, (200 if compiled else 40, 2)).tolist():
        wi, weight = sample_lobe(wo, alpha, f0, u, v)
        assert max(weight) <= 1.0
        assert min(weight) >= 0.0
        assert np.linalg.norm(wi) == pytest.approx(1.0, abs=1e-12)
        if wi.z > 1e-6:
            value = np.array(eval_lobe(wi, wo, alpha, f0))
            np.testing.assert_allclose(pdf_lobe(wi, wo, alpha) * np.array(weight), value, rtol=1e-6, atol=1e-300)


@pytest.mark.parametrize(("alpha", "mu_o", "expected"), FURNACE)
def test_furnace_by_sampling(alpha, mu_o, expected, compiled):
    """Directional albedo A = S[1]: the table's digits, our quadrature of the restated formula, the sampler's mean.

    The mean weight over a midpoint grid of the square integrates the sampler's weights; both must be the same A.
    The weight is cut at the horizon, so the rule's error is O(1 / n).
    """
    exact = albedo(mu_o, alpha)
    assert exact == pytest.approx(expected, abs=6e-5)
    n = 200 if compiled else 50
    x = (np.arange(n) + 0.5) / n
    wo = direction(mu_o)
    mean = np.mean([sample_lobe(wo, alpha, WHITE, u, v)[1].x for u in x.tolist() for v in x.tolist()])
    assert mean == pytest.approx(exact, abs=0.3 / n)


@pytest.mark.parametrize(("alpha", "mu_o", "expected"), FURNACE[1:])
def test_furnace_by_quadrature_of_eval(alpha, mu_o, expected, compiled):
    """A by integrating `eval_lobe` over the hemisphere with the midpoint rule in (mu, phi)."""
    n = 160 if compiled else 60
    mu = (np.arange(n) + 0.5) / n
    phi = np.pi * (np.arange(n) + 0.5) / n  # the lobe is symmetric: half of the azimuths
    wo = direction(mu_o)
    values = [eval_lobe(direction(m, p), wo, alpha, WHITE).x for m in mu.tolist() for p in phi.tolist()]
    assert 2 * np.pi * np.mean(values) == pytest.approx(albedo(mu_o, alpha), abs=1e-3 if compiled else 4e-3)


# What each estimator becomes under a white sky: the factor of the lobe, and the cosine that multiplies it.
MEANS = {
    specular.UNIFORM: (1.0, "incident"),
    specular.PAPER: (4 / math.pi, "incident"),
    specular.PAPER_LITERAL: (4 / math.pi, "outgoing"),
}


@pytest.mark.parametrize("estimator", MEANS, ids=("uniform", "paper", "paper-literal"))
@pytest.mark.parametrize(("alpha", "mu_o", "expected"), FURNACE[1:])
def test_jittered_estimators_have_their_mean(estimator, alpha, mu_o, expected):
    """The mean of the weight over the unit square, by the midpoint rule, against SciPy's quadrature of the integral."""
    lobe_factor, cosine = MEANS[estimator]
    n = 160
    x = (np.arange(n) + 0.5) / n
    wo = direction(mu_o)
    mean = np.mean([sample_variant(estimator, 1, wo, alpha, WHITE, u, v)[1].x for u in x.tolist() for v in x.tolist()])
    over = (lambda mu: 1.0) if cosine == "incident" else (lambda mu: mu_o / mu)
    exact = integrate.dblquad(
        lambda phi, mu: 2 * over(mu) * lobe(np.float64(mu), phi, mu_o, alpha), 0, 1 - 1e-12, 0, math.pi, epsabs=1e-5
    )[0]
    assert mean == pytest.approx(lobe_factor * exact, rel=2e-3)


@pytest.mark.parametrize("rings", [1, 5, 16])
@pytest.mark.parametrize(("estimator", "factor"), [(specular.PAPER_CODE, 1.0), (specular.PAPER_CODE_NO_PI, math.pi)])
def test_code_estimators_have_the_mean_of_the_loop(estimator, factor, rings, compiled):
    """The paper's loop over k = 1 .. N, its azimuth averaged: (1/N) sum mu_k + F D G / mu_o, restated in NumPy."""
    alpha, mu_o = 0.4, 0.6
    n = 64
    phi = 2 * np.pi * (np.arange(n) + 0.5) / n
    mu = np.arange(1, rings + 1)[:, None] / (rings + 1)
    expected = np.mean(mu + factor * 4 * lobe(mu + 0 * phi, phi + 0 * mu, mu_o, alpha))
    u = (np.arange(rings) + 0.5) / rings
    v = (np.arange(n) + 0.5) / n
    wo = direction(mu_o)
    mean = np.mean(
        [sample_variant(estimator, rings, wo, alpha, WHITE, a, b)[1].x for a in u.tolist() for b in v.tolist()]
    )
    assert mean == pytest.approx(expected, rel=1e-12)


def test_every_ring_has_the_same_share():
    """Ring k takes u in [(k - 1)/N, k/N): the cosines k / (N + 1), neither 0 nor 1 among them."""
    u = np.linspace(2.0**-33, 1 - 2.0**-33, 4001)
    cosines, counts = np.unique([ring_cosine(x, 5) for x in u.tolist()], return_counts=True)
    np.testing.assert_allclose(cosines, np.arange(1, 6) / 6, rtol=1e-15)
    assert counts.max() - counts.min() <= 1


def test_variants_sample_what_they_say():
    """`vndf` is `sample_lobe`; the others draw the cosine u, or its ring, and the azimuth 2 pi v, none from below."""
    wo = direction(0.4, 1.0)
    assert sample_variant(specular.VNDF, 1, wo, 0.3, WHITE, 0.3, 0.6) == sample_lobe(wo, 0.3, WHITE, 0.3, 0.6)
    for estimator in (specular.UNIFORM, specular.PAPER, specular.PAPER_LITERAL, specular.PAPER_CODE):
        cosine = 0.3 if estimator != specular.PAPER_CODE else 1 / 3
        wi, weight = sample_variant(estimator, 2, wo, 0.3, WHITE, 0.3, 0.6)
        assert wi == hemisphere_ring(cosine, 0.6)
        assert weight.x > 0.0
        # From behind the lobe is 0; what the paper's code adds to it is not.
        rest = cosine if estimator == specular.PAPER_CODE else 0.0
        assert sample_variant(estimator, 2, direction(-0.1), 0.3, WHITE, 0.3, 0.6)[1] == (rest, rest, rest)


@pytest.mark.parametrize("mu_o", [1e-8, 1e-4, 0.1, 1 - 1e-12, 1.0])
@pytest.mark.parametrize("alpha", [1e-4, 0.05, 1.5])
def test_finite_at_the_ends(mu_o, alpha):
    """From grazing to normal view and for u, v near 0 and 1: unit normals towards the view, finite weights."""
    wo = direction(mu_o, 0.3)
    ends = [2.0**-33, 1e-6, 0.5, 1 - 1e-6, 1 - 2.0**-33]
    for u in ends:
        for v in ends:
            m = sample_visible_normal(wo, alpha, u, v)
            assert np.linalg.norm(m) == pytest.approx(1.0, abs=1e-12)
            assert m.z > 0.0
            _, weight = sample_lobe(wo, alpha, WHITE, u, v)
            assert 0.0 <= weight.x <= 1.0


@pytest.mark.parametrize(("alpha", "mu_o"), [(0.02, 0.9), (0.05, 0.1), (0.3, 0.3), (1.0, 0.05), (0.5, 1.0)])
def test_slope_along_the_view_has_the_visible_distribution(alpha, mu_o, compiled):
    """The stretched slope x along the view has the density (cot - x) exp(-x²) on x < cot, up to its norm.

    The u-quantile's slope must have the cumulative distribution u, by SciPy's quadrature; this works at any alpha,
    where histograms of directions have too few cells in the lobe.
    """
    wo = direction(mu_o)
    cot = mu_o / math.sqrt(max(1 - mu_o * mu_o, 1e-30)) / alpha
    top = min(cot, 8.0)
    density = lambda x: (1 - x / cot) * math.exp(-x * x)  # noqa: E731
    norm = integrate.quad(density, -8, top, epsabs=1e-13)[0]
    for u in np.linspace(0.01, 0.99, 25 if compiled else 7).tolist():
        m = sample_visible_normal(wo, alpha, u, 0.5)
        slope = -m.x / m.z / alpha
        assert integrate.quad(density, -8, slope, epsabs=1e-13)[0] / norm == pytest.approx(u, abs=1e-7)


def test_slope_is_inverted_to_rounding_up_to_grazing(compiled):
    """cdf(slope(u)) = u by SciPy's erf, from a view along the normal to 1e-12 from grazing, in both tails of u."""
    rng = np.random.default_rng(3)
    count = 400 if compiled else 30
    grazing = math.pi / 2 - 10 ** rng.uniform(-12, -1, count)
    angles = np.concatenate([rng.uniform(0, math.pi / 2, count), grazing, 10 ** rng.uniform(-9, -1, count)])
    u = np.concatenate([rng.random(8), 10 ** rng.uniform(-9, -2, 4), 1 - 10 ** rng.uniform(-9, -2, 4)])
    for angle in angles.tolist():
        tan = math.tan(angle)
        slope = np.array([_visible_slope(1 / tan, tan, math.tan(angle / 2), v) for v in u.tolist()])
        mass = lambda x, tan=tan: 1 + special.erf(x) + tan * np.exp(-x * x) / math.sqrt(math.pi)  # noqa: E731
        np.testing.assert_allclose(mass(slope) / mass(1 / tan), u, rtol=0, atol=2e-11)
