"""The dielectric lobes of the references against quadrature, chi², Snell's law and Mitsuba's own `roughdielectric`."""

import importlib
import math
from typing import Any

import numpy as np
import pytest
from scipy.special import erf

from termwise.reference.backend import active, import_mitsuba

mi: Any = import_mitsuba()
dr: Any = importlib.import_module("drjit")
from termwise.reference import dielectric  # noqa: E402  subclasses Mitsuba's plugins

pytestmark = pytest.mark.skipif(active().variant == "scalar_rgb", reason="needs a vectorised variant")

dielectric.register()
SAMPLES = 2**17
FLUX = mi.BSDFContext(mi.TransportMode.Importance)
RADIANCE = mi.BSDFContext(mi.TransportMode.Radiance)
TINT = (0.9, 0.6, 0.3)


def glass(alpha: float, eta: float, g: float = 1.0, t: float = 1.0, tint: Any = (1.0, 1.0, 1.0)) -> Any:
    told = {"alpha": alpha, "eta": eta, "factor": g, "transparency": t, "tint": list(tint)}
    return mi.load_dict({"type": "microfacet_dielectric"} | told)


def direction(mu: float, phi: float = 0.0) -> np.ndarray:
    sine = math.sqrt(1.0 - mu * mu)
    return np.array([sine * math.cos(phi), sine * math.sin(phi), mu])


def seen_along(views: np.ndarray) -> Any:
    si = dr.zeros(mi.SurfaceInteraction3f, len(views))
    si.wi = mi.Vector3f(views.T)
    return si


def drawn(plugin: Any, mu: float, context: Any = RADIANCE, count: int = SAMPLES, seed: int = 3) -> tuple[Any, ...]:
    """Weights (N, 3), directions (N, 3) and densities (N,) of samples."""
    points = mi.PCG32(size=count, initstate=seed)
    si = seen_along(np.tile(direction(mu), (count, 1)))
    numbers = mi.Point2f(points.next_float32(), points.next_float32())
    sample, weight = plugin.sample(context, si, points.next_float32(), numbers)
    return np.array(weight, float).T, np.array(sample.wo, float).T, np.array(sample.pdf, float)


# What a surface ought to do, from the formulas, in double precision.


def fresnel(cosine: np.ndarray, eta: float) -> np.ndarray:
    """Reflectance of unpolarized light that comes from the side of index 1 to that of eta."""
    beyond = np.sqrt(np.maximum(1.0 - (1.0 - cosine**2) / eta**2, 0.0))
    s = (cosine - eta * beyond) / (cosine + eta * beyond)
    p = (eta * cosine - beyond) / (eta * cosine + beyond)
    return 0.5 * (s * s + p * p)


def masked(mu: np.ndarray, alpha: float) -> np.ndarray:
    """G1 at positive cosines; 0 elsewhere."""
    up = np.clip(mu, 1e-9, 1.0 - 1e-12)
    a = up / (alpha * np.sqrt(1.0 - up * up))
    return np.where(mu > 0.0, 2.0 / (1.0 + erf(a) + np.exp(-a * a) / (a * math.sqrt(math.pi))), 0.0)


def albedos(alpha: float, mu: float, eta: float) -> tuple[float, float]:
    """Flux that is reflected and let through of g = t = 1: `∫ f |i·n| dw` over facets, by Gauss-Legendre and rings.

    `tan² theta_h = -alpha² ln u`, so that u and the azimuth are uniform: `A = ∫∫ F G (o·h) / (mu cos theta_h) du dphi`.
    """
    nodes, weights = np.polynomial.legendre.leggauss(400)
    u, share = 0.5 * (nodes + 1.0), 0.5 * weights
    phi = (np.arange(256) + 0.5) * (math.pi / 256)
    tangent = alpha * np.sqrt(-np.log(u))[:, None]
    cosine = 1.0 / np.sqrt(1.0 + tangent**2)
    o = direction(mu)
    seen = cosine * (tangent * np.cos(phi) * o[0] + o[2])
    front = seen > 0.0
    seen = np.where(front, seen, 1.0)
    reflected = fresnel(seen, eta)
    beyond = np.sqrt(np.maximum(1.0 - (1.0 - seen**2) / eta**2, 0.0))
    up = 2.0 * seen * cosine - mu
    down = -(cosine * (seen / eta - beyond) - mu / eta)
    visible = np.where(front, seen / (mu * cosine), 0.0) * masked(np.array(mu), alpha)
    parts = reflected * masked(up, alpha), (1.0 - reflected) * masked(down, alpha)
    return tuple(float(share @ (visible * part).mean(axis=1)) for part in parts)  # type: ignore[return-value]


CASES = [
    (1e-4, 0.7, 1.5),
    (0.1, 1.0, 1.5),
    (0.3, 0.5, 1.5),
    (0.3, 0.5, 1.0 / 1.5),
    (0.6, 0.15, 1.33),
    (0.6, 0.9, 0.5),
    (1.0, 0.8, 2.4),
]


@pytest.mark.parametrize(("alpha", "mu", "eta"), CASES)
@pytest.mark.parametrize("inside", [False, True])
def test_energy(alpha: float, mu: float, eta: float, inside: bool):
    """Flux by samples is the quadrature's, from either side; no more than all; radiance has eta² less behind it."""
    weight, wo, _ = drawn(glass(alpha, eta, tint=TINT), -mu if inside else mu, FLUX)
    beyond = 1.0 / eta if inside else eta
    right = albedos(alpha, mu, beyond)
    through = wo[:, 2] * (-1.0 if inside else 1.0) < 0.0
    for side, part, tint in ((~through, right[0], np.ones(3)), (through, right[1], np.array(TINT))):
        found = np.where(side[:, None], weight, 0.0)
        error = found.std(axis=0) / math.sqrt(SAMPLES)
        assert (np.abs(found.mean(axis=0) - part * tint) < 4.5 * error + 2e-5).all()
    assert sum(right) <= 1.0 + 1e-9
    assert weight.max() <= 1.0 + 1e-5
    radiance, _, _ = drawn(glass(alpha, eta, tint=TINT), -mu if inside else mu)
    np.testing.assert_allclose(radiance[through], weight[through] / beyond**2, rtol=1e-5)
    np.testing.assert_array_equal(radiance[~through], weight[~through])


@pytest.mark.parametrize(("g", "t"), [(0.3, 0.8), (0.0, 1.0), (1.0, 0.0)])
def test_factors_are_of_their_lobes(g: float, t: float):
    """g is on what is reflected and t on what goes through, in samples and in values."""
    alpha, mu, eta = 0.3, 0.6, 1.5
    weight, wo, _ = drawn(glass(alpha, eta, g, t), mu, FLUX)
    through = wo[:, 2] < 0.0
    for side, part in zip((~through, through), np.multiply((g, t), albedos(alpha, mu, eta)), strict=True):
        found = np.where(side, weight[:, 0], 0.0)
        assert found.mean() == pytest.approx(part, abs=4.5 * found.std() / math.sqrt(SAMPLES) + 1e-6)
    si, ways = seen_along(np.tile(direction(mu), (2, 1))), mi.Vector3f(np.array([[0, 0, 1.0], [0, 0, -1.0]]).T)
    value, whole = (np.array(each.eval(FLUX, si, ways))[0] for each in (glass(alpha, eta, g, t), glass(alpha, eta)))
    np.testing.assert_allclose(value, whole * (g, t), rtol=1e-5)


@pytest.mark.parametrize(("alpha", "eta"), [(0.2, 1.5), (0.6, 0.7)])
@pytest.mark.parametrize("mu", [0.9, -0.4])
def test_samples_follow_the_density(alpha: float, eta: float, mu: float):
    """Chi² over the whole sphere; with the index of the other side it is rejected."""
    from mitsuba.chi2 import BSDFAdapter, ChiSquareTest, SphericalDomain

    def test(of: float, against: float) -> bool:
        told = f'<float name="alpha" value="{alpha}"/><float name="eta" value="{{}}"/><float name="factor" value="1"/>'
        told += '<float name="transparency" value="1"/><vector name="tint" value="1,1,1"/>'
        view = mi.Vector3f(*direction(mu).tolist())
        sample, _ = BSDFAdapter("microfacet_dielectric", told.format(of), wi=view)
        _, density = BSDFAdapter("microfacet_dielectric", told.format(against), wi=view)
        chi2 = ChiSquareTest(SphericalDomain(), sample, density, sample_dim=3, sample_count=2**18, res=101, ires=16)
        return chi2.run(significance_level=0.001, test_count=4, quiet=True)

    assert test(eta, eta)
    assert not test(eta, 1.0 / eta)


def pairs(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Views and ways on all sides."""
    found = np.random.default_rng(seed).normal(size=(2, count, 3))
    found /= np.linalg.norm(found, axis=2, keepdims=True)
    return found[0], found[1]


@pytest.mark.parametrize("eta", [1.5, 0.7])
def test_reciprocity(eta: float):
    """`f(i, o) / eta_o² = f(o, i) / eta_i²` of radiance, o the view; of flux the two change places."""
    plugin = glass(0.4, eta)
    o, i = pairs(2000, 1)
    forward = np.array(plugin.eval(RADIANCE, seen_along(o), mi.Vector3f(i.T)))[0] / np.abs(i[:, 2])
    backward = np.array(plugin.eval(RADIANCE, seen_along(i), mi.Vector3f(o.T)))[0] / np.abs(o[:, 2])
    adjoint = np.array(plugin.eval(FLUX, seen_along(i), mi.Vector3f(o.T)))[0] / np.abs(o[:, 2])
    square = np.where(o[:, 2] > 0.0, 1.0, eta**2), np.where(i[:, 2] > 0.0, 1.0, eta**2)
    lit = forward > 1e-3  # beneath, facets next to total reflection, of few digits
    assert (lit & (o[:, 2] * i[:, 2] < 0.0)).sum() > 50
    np.testing.assert_allclose((forward / square[0])[lit], (backward / square[1])[lit], rtol=2e-3)
    np.testing.assert_allclose(forward[lit], adjoint[lit], rtol=2e-3)
    np.testing.assert_array_equal(forward > 0.0, backward > 0.0)


@pytest.mark.parametrize("eta", [1.5, 1.0 / 1.5])
def test_it_is_mitsubas_own_but_for_g1(eta: float):
    """`roughdielectric` at pairs of directions on all sides: its rational G1 is 0.4 % off at most, of either way."""
    theirs = mi.load_dict(
        {"type": "roughdielectric", "distribution": "beckmann", "alpha": 0.3, "int_ior": eta, "ext_ior": 1.0}
    )
    o, i = pairs(4000, 2)
    for context in (RADIANCE, FLUX):
        (value, density), (right, right_density) = (
            each.eval_pdf(context, seen_along(o), mi.Vector3f(i.T)) for each in (glass(0.3, eta), theirs)
        )
        found, wanted = (np.array(each)[0] for each in (value, right))
        np.testing.assert_allclose(found, wanted, rtol=0.008, atol=1e-5)
        np.testing.assert_allclose(np.array(density), np.array(right_density), rtol=0.004, atol=1e-5)
        for side in (o[:, 2] * i[:, 2] > 0.0, o[:, 2] * i[:, 2] < 0.0):
            assert found[side].sum() == pytest.approx(wanted[side].sum(), rel=0.004)


@pytest.mark.parametrize("g", [0.0, 1.0])
@pytest.mark.parametrize("mu", [0.95, 0.3, -0.95, -0.8])
def test_value_density_and_weight_agree(mu: float, g: float):
    """`eval = weight pdf` in the drawn direction."""
    plugin = glass(0.3, 1.5, g, tint=TINT)
    weight, wo, pdf = drawn(plugin, mu, count=4096)
    value, density = plugin.eval_pdf(RADIANCE, seen_along(np.tile(direction(mu), (4096, 1))), mi.Vector3f(wo.T))
    kept = (weight > 0.0).all(axis=1)
    assert kept.sum() > 1000
    np.testing.assert_array_equal(np.array(density), pdf)
    np.testing.assert_allclose(np.array(value).T[kept], (weight * pdf[:, None])[kept], rtol=2e-2)
    np.testing.assert_allclose(np.array(value).T[kept].sum(), (weight * pdf[:, None])[kept].sum(), rtol=1e-4)


@pytest.mark.parametrize(("mu", "eta"), [(0.5, 1.5), (0.9, 0.7), (-0.9, 1.5), (-0.5, 0.8)])
def test_a_smooth_surface_obeys_snell(mu: float, eta: float):
    """Directions and shares of both lobes at alpha = 1e-4, from either side."""
    beyond = eta if mu > 0.0 else 1.0 / eta
    weight, wo, _ = drawn(glass(1e-4, eta), mu, FLUX)
    through = wo[:, 2] * mu < 0.0
    sine = -direction(mu)[0] / beyond
    np.testing.assert_allclose(wo[through, 0], sine, atol=2e-3)
    np.testing.assert_allclose(wo[through, 0].mean(), sine, atol=1e-5)
    np.testing.assert_allclose(wo[~through].mean(axis=0), direction(mu) * (-1, -1, 1), atol=1e-5)
    np.testing.assert_allclose(weight, 1.0, rtol=1e-5)
    right = float(fresnel(np.array(abs(mu)), beyond))
    assert 1.0 - through.mean() == pytest.approx(right, abs=4.5 * math.sqrt(right / SAMPLES) + 1e-5)


def test_total_reflection():
    """From within beyond the critical angle all of it comes back; just before it, some goes through."""
    critical = math.sqrt(1.0 - 1.0 / 1.5**2)
    weight, wo, _ = drawn(glass(1e-4, 1.5), -(critical - 1e-3))
    assert (wo[:, 2] < 0.0).all()
    np.testing.assert_allclose(weight, 1.0, rtol=1e-5)
    alone, _, _ = drawn(glass(1e-4, 1.5, g=0.0), -(critical - 1e-3))
    assert not alone.any()
    _, wo, _ = drawn(glass(1e-4, 1.5), -(critical + 1e-3))
    assert (wo[:, 2] > 0.0).any()


@pytest.mark.parametrize("eta", [1.0, 1.0 + 1e-7, 1.0 - 1e-7])
@pytest.mark.parametrize("alpha", [1e-4, 0.5])
def test_without_an_interface_light_goes_straight_on(alpha: float, eta: float):
    """The facets hide as much of it as they hide of the way behind them, and nothing is reflected."""
    for mu in (0.8, -0.3):
        weight, wo, _ = drawn(glass(alpha, eta, tint=TINT), mu, count=4096)
        # A facet that is met at the tangent T turns it by |eta - 1| T.
        np.testing.assert_allclose(wo, np.tile(-direction(mu), (4096, 1)), atol=5e-5)
        right = np.array(TINT) * masked(np.array(abs(mu)), alpha)
        np.testing.assert_allclose(weight, np.tile(right, (4096, 1)), rtol=5e-5)
        value, density = glass(alpha, eta).eval_pdf(
            RADIANCE, seen_along(pairs(500, 3)[0]), mi.Vector3f(pairs(500, 3)[1].T)
        )
        assert np.array(value).max() < 1e-9
        assert np.isfinite(np.array(density)).all()


def test_grazing_views_are_finite():
    """Down to a cosine of 1e-6, from either side."""
    for alpha in (1e-4, 0.3, 1.5):
        for mu in (1e-6, -1e-6, 1.0, -1.0):
            for each in drawn(glass(alpha, 1.5), mu, count=4096):
                assert np.isfinite(each).all()
            weight, _, _ = drawn(glass(alpha, 1.5), mu, FLUX, count=4096)
            assert ((weight >= 0.0) & (weight <= 1.0 + 1e-5)).all()
