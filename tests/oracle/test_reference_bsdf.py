"""The Cook-Torrance lobe of the references against quadrature, chi² and Mitsuba's own `roughconductor`."""

import importlib
from typing import Any

import numpy as np
import pytest
import scipy.stats
from scipy.integrate import dblquad
from scipy.special import erf

from termwise.reference.backend import active, import_mitsuba

mi = import_mitsuba()
dr = importlib.import_module("drjit")
from termwise.reference import bsdf  # noqa: E402  subclasses Mitsuba's plugins

pytestmark = pytest.mark.skipif(active().variant == "scalar_rgb", reason="needs a vectorised variant")

bsdf.register()
SAMPLES = 2**20


def lobe(alpha: float, f0: float = 1.0, factor: float = 1.0):
    return mi.load_dict({"type": "cook_torrance", "alpha": alpha, "f0": [f0] * 3, "factor": factor})


def direction(mu: float, phi: float = 0.0):
    sine = np.sqrt(1 - mu * mu)
    return mi.Vector3f(float(sine * np.cos(phi)), float(sine * np.sin(phi)), float(mu))


def sampled(plugin, mu: float, seed: int = 3):
    """Weights, sampled directions and densities of 2^20 samples."""
    generator = mi.PCG32(size=SAMPLES, initstate=seed)
    si = dr.zeros(mi.SurfaceInteraction3f, SAMPLES)
    si.wi = direction(mu)
    numbers = mi.Point2f(generator.next_float32(), generator.next_float32())
    sample, weight = plugin.sample(mi.BSDFContext(), si, generator.next_float32(), numbers)
    return np.array(weight[0], float), np.array(sample.wo, float).T, np.array(sample.pdf, float)


def g1(mu):
    a = mu / np.sqrt(1 - mu**2)
    return lambda alpha: 2 / (1 + erf(a / alpha) + alpha * np.exp(-((a / alpha) ** 2)) / (a * np.sqrt(np.pi)))


def albedo(alpha: float, mu: float, f0: float) -> float:
    """A = ∫ f mu_o dw over normals: `∫∫ F G1(wi) G1(wo) (wi·h) / (mu_i cos θ_h) du dφ/2π`, tan² θ_h = -α² ln u."""
    wi = np.array([np.sqrt(1 - mu * mu), 0.0, mu])

    def integrand(phi, u):
        tangent = alpha * np.sqrt(-np.log(u))
        cosine = 1 / np.sqrt(1 + tangent**2)
        h = cosine * np.array([tangent * np.cos(phi), tangent * np.sin(phi), 1.0])
        wi_h = wi @ h
        out = 2 * wi_h * h[2] - mu
        if wi_h <= 0 or out <= 0:
            return 0.0
        fresnel = f0 + (1 - f0) * (1 - wi_h) ** 5
        mask = g1(min(out, 1 - 1e-12))(alpha) * g1(min(mu, 1 - 1e-12))(alpha)
        return fresnel * mask * wi_h / (mu * cosine) / np.pi

    return dblquad(integrand, 1e-14, 1 - 1e-14, 0, np.pi, epsabs=1e-5, epsrel=1e-5)[0]


@pytest.mark.parametrize(
    ("alpha", "mu", "f0", "table"),
    [(0.05, 1.0, 1.0, 1.0), (0.3, 0.7, 1.0, 0.9658), (0.3, 0.1, 1.0, 0.9314), (0.6, 1.0, 1.0, 0.8558),
     (1.0, 1.0, 1.0, 0.4616), (0.05, 1.0, 0.04, 0.04), (0.3, 0.1, 0.04, 0.2241)],
)  # fmt: skip
def test_white_furnace(alpha, mu, f0, table):
    """Mean weight = quadrature of A(mu) = the figure derived on paper (four digits)."""
    weight, _, _ = sampled(lobe(alpha, f0), mu)
    expected = albedo(alpha, mu, f0)
    assert expected == pytest.approx(table, abs=6e-5)
    assert weight.mean() == pytest.approx(expected, abs=4.5 * weight.std() / np.sqrt(SAMPLES) + 1e-5)
    assert weight.max() <= 1.0 + 1e-5


@pytest.mark.parametrize("alpha", [0.1, 0.3, 1.0])
@pytest.mark.parametrize("mu", [0.98, 0.5, 0.087])
def test_sampling_matches_density(alpha, mu):
    """Chi² of samples against `pdf`; the density of a lobe that is 1.3 times as rough is rejected."""
    from mitsuba.chi2 import BSDFAdapter, ChiSquareTest, SphericalDomain

    def test(of, against) -> Any:
        sample, _ = BSDFAdapter("cook_torrance", parameters(of), wi=direction(mu))
        _, pdf = BSDFAdapter("cook_torrance", parameters(against), wi=direction(mu))
        chi2 = ChiSquareTest(
            SphericalDomain(), sample, pdf, sample_dim=3, sample_count=SAMPLES, res=201, ires=16, seed=5
        )
        return chi2, chi2.run(significance_level=0.001, test_count=9, quiet=True)

    def parameters(roughness):
        f0 = '<vector name="f0" value="1,1,1"/>'
        return f'<float name="alpha" value="{roughness}"/>{f0}<float name="factor" value="1"/>'

    right, passed = test(alpha, alpha)
    assert passed, right.messages
    assert np.sum(right.pdf) == pytest.approx(np.sum(right.histogram), rel=2e-3)
    wrong, passed = test(alpha, 1.3 * alpha)
    assert not passed


@pytest.mark.parametrize("alpha", [1e-3, 0.01, 0.05])
def test_narrow_lobes_have_beckmann_slopes(alpha):
    """At normal view the squared slope of h over α² is exponential; chi² on the sphere is blind this small."""
    _, wo, _ = sampled(lobe(alpha), 1.0)
    h = wo[:4096] + [0, 0, 1]
    squared = (h[:, 0] ** 2 + h[:, 1] ** 2) / h[:, 2] ** 2 / alpha**2
    assert scipy.stats.kstest(squared, "expon").pvalue > 1e-4
    assert scipy.stats.kstest(1.3 * squared, "expon").pvalue < 1e-6


@pytest.mark.parametrize(("alpha", "f0"), [(0.2, 0.04), (0.7, 0.9)])
def test_value_density_and_weight_agree(alpha, f0):
    """`eval = weight · pdf` in the sampled direction, f(i, o) = f(o, i), and `factor` multiplies the value."""
    plugin, weaker = lobe(alpha, f0), lobe(alpha, f0, factor=0.25)
    si = dr.zeros(mi.SurfaceInteraction3f, 1)
    context = mi.BSDFContext()
    for mu_i, mu_o, phi in [(0.9, 0.3, 1.0), (0.2, 0.25, 3.0), (0.6, 0.6, 0.0)]:
        si.wi = direction(mu_i)
        forward, pdf = plugin.eval_pdf(context, si, direction(mu_o, phi))
        quarter = weaker.eval(context, si, direction(mu_o, phi))
        si.wi = direction(mu_o, phi)
        backward = plugin.eval(context, si, direction(mu_i))
        assert forward[0][0] / mu_o == pytest.approx(backward[0][0] / mu_i, rel=1e-5)
        assert quarter[0][0] == pytest.approx(forward[0][0] / 4, rel=1e-6)
        assert pdf[0] > 0
    weight, wo, pdf = sampled(plugin, 0.5)
    si = dr.zeros(mi.SurfaceInteraction3f, SAMPLES)
    si.wi = direction(0.5)
    value = np.array(plugin.eval(context, si, mi.Vector3f(*wo.T))[0])
    kept = weight > 0
    np.testing.assert_allclose(value[kept], (weight * pdf)[kept], rtol=2e-2)  # float32 at grazing angles
    np.testing.assert_allclose(value[kept].sum(), (weight * pdf)[kept].sum(), rtol=1e-4)


@pytest.mark.parametrize(("alpha", "mu"), [(0.05, 0.5), (0.3, 0.7), (0.3, 0.1), (0.6, 0.9)])
def test_roughconductor_agrees_for_constant_fresnel(alpha, mu):
    """Mitsuba's own lobe with F = 1 has the same albedo but for its rational G1, which is up to 0.3 % off."""
    own, _, _ = sampled(lobe(alpha), mu)
    built_in, _, _ = sampled(
        mi.load_dict({"type": "roughconductor", "distribution": "beckmann", "alpha": alpha, "material": "none"}), mu
    )
    noise = 4.5 * np.hypot(own.std(), built_in.std()) / np.sqrt(SAMPLES)
    assert own.mean() == pytest.approx(built_in.mean(), abs=0.003 * built_in.mean() + noise)
