"""Shading: the Cook-Torrance lobe is finite, reciprocal, energy-bounded and rightly sampled at its extremes.

View and light at cosines from 1 to 1e-12, roughness from 1e-4 (all but a mirror) to 1.5, F0 of 0, 0.04 and 1. The
oracles restate the model in NumPy by other formulas: Smith's G1 through the scaled complementary error function,
the directional albedo by quadrature over slopes, the distribution of visible slopes in closed form.

What is to be expected: the paper's estimator draws w_i evenly over the hemisphere and weighs it by 2 D F G / mu_o: its
weights have no bound, its mean is 4/pi of the albedo, and below a roughness of a few hundredths a sample of it finds
no lobe at all. Mitsuba's lobe is computed in float32.
"""

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from scipy import special

from termwise.renderer import render
from termwise.renderer.microfacet import eval_lobe, sample_lobe, sample_visible_normal, smith_g1
from termwise.renderer.terms.specular import PAPER, sample_variant
from termwise.renderer.vector import Vec3, frame
from termwise.reports.stress.row import Row
from termwise.scenes.analytic import glossy_sphere

ALPHAS = (1e-4, 0.01, 0.3, 1.5)
COSINES = tuple(10.0**-power for power in (0, 1, 2, 4, 6, 8, 10, 12))
_WHITE = Vec3(1.0, 1.0, 1.0)
# The ends of what the sampler of 32 bits can give.
_ENDS = (2.0**-33, 2.0**-20, 0.5, 1.0 - 2.0**-20, 1.0 - 2.0**-33)


def _direction(mu: float, phi: float) -> Vec3:
    sin = math.sqrt((1.0 - mu) * (1.0 + mu))
    return Vec3(sin * math.cos(phi), sin * math.sin(phi), mu)


def _g1(mu: np.ndarray, alpha: float) -> np.ndarray:
    """G1 = 1 / (1 + Lambda), Lambda = exp(-a²) (1 / (a sqrt(pi)) - erfcx(a)) / 2 (Walter et al. 2007, eq. 26)."""
    mu = np.asarray(mu, np.float64)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        a = mu / (alpha * np.sqrt((1.0 - mu) * (1.0 + mu)))
        masked = 0.5 * np.exp(-a * a) * (1.0 / (a * math.sqrt(math.pi)) - special.erfcx(a))
    return 1.0 / (1.0 + np.where(np.isfinite(a), masked, 0.0))


def masking(count: int) -> Iterator[Row]:
    """G1 at cosines of 1 to 1e-12: 20 roundings, of which exp(-a²) has the most, a² of them, below 36."""
    mu = np.concatenate([10.0 ** -np.linspace(0, 12, 200), 1.0 - 10.0 ** -np.linspace(1, 15, 60)])
    for alpha in ALPHAS:

        def error(alpha: float = alpha) -> float:
            found = np.array([smith_g1(each, alpha) for each in mu.tolist()])
            return float(np.abs(found / _g1(mu, alpha) - 1.0).max())

        yield Row(f"G1, alpha {alpha:g}", "relative error", 100 * 2.0**-53, error)


def _faulty(wi: np.ndarray, weight: np.ndarray) -> float:
    """Samples without a unit direction or with a weight that is no number in [0, 1]."""
    good = np.isfinite(wi).all(axis=1) & np.isfinite(weight) & (weight >= 0.0) & (weight <= 1.0)
    return float((~(good & (np.abs(np.linalg.norm(wi, axis=1) - 1.0) < 1e-6))).sum())


def _points(count: int) -> np.ndarray:
    """Points of the unit square (N, 2): random ones, and all pairs of its ends."""
    ends = np.array([(u, v) for u in _ENDS for v in _ENDS])
    return np.concatenate([np.random.default_rng(21).random((count, 2)), ends])


def _paper_sample(wo: Vec3, alpha: float, f0: Vec3, u: float, v: float) -> tuple[Vec3, Vec3]:
    return sample_variant(PAPER, 1, wo, alpha, f0, u, v)


def _mitsuba_samples(alpha: float, wo: Vec3, points: np.ndarray, f0: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Directions (N, 3) and weights (N,) of the references' own BSDF."""
    from termwise.reference.backend import import_mitsuba

    mi: Any = import_mitsuba()
    import drjit as dr  # after Mitsuba has chosen its LLVM

    from termwise.reference import bsdf

    bsdf.register()
    lobe = mi.load_dict({"type": "cook_torrance", "alpha": alpha, "f0": mi.ScalarColor3f(f0), "factor": 1.0})
    si = dr.zeros(mi.SurfaceInteraction3f, len(points))
    si.wi = mi.Vector3f(*wo)
    found, weight = lobe.sample(
        mi.BSDFContext(), si, mi.Float(0.5), mi.Point2f(points.astype(np.float32).T.copy()), True
    )
    return np.array(found.wo, np.float64).T, np.array(weight.x, np.float64)


def weights(count: int) -> Iterator[Row]:
    """A sample's weight F G1(w_i) is a number in [0, 1] and its direction a unit vector, at any view."""
    points = _points(max(32, count // 8))
    for alpha in ALPHAS:
        for mu in COSINES:
            wo = _direction(mu, 0.3)

            def faulty(sample: Callable[..., tuple[Vec3, Vec3]], wo: Vec3 = wo, alpha: float = alpha) -> float:
                pairs = [sample(wo, alpha, _WHITE, u, v) for u, v in points.tolist()]
                return _faulty(np.array([wi for wi, _ in pairs]), np.array([weight.x for _, weight in pairs]))

            yield Row(
                f"weights, alpha {alpha:g}, cosine {mu:g}",
                f"samples of {len(points)} without a unit direction or a weight in [0, 1]",
                0.0,
                lambda faulty=faulty: faulty(sample_lobe),
                lambda faulty=faulty: faulty(_paper_sample),
                lambda wo=wo, alpha=alpha: _faulty(*_mitsuba_samples(alpha, wo, points)),
            )


def reciprocity(count: int) -> Iterator[Row]:
    """f(w_i, w_o) = f(w_o, w_i), pairs at cosines of 1 to 1e-12.

    With u = 2^-53: both orders share the bits of the half vector, of D and of each G1; 34 u are the products around
    them (16) and the roundings of F itself (18). Its cosine c = w.h differs. By Cauchy-Schwarz the roundings of h cost
    4 u sqrt(1 - c²), the two products 6 u, and the lengths of w, whose squares err by 11 u each as `_direction` rounds,
    `(|w_i|² - |w_o|²) / |w_i + w_o|`, 11 u / c: in all at most 19 u / c. F = F0 + (1 - F0) x⁵ multiplies that by its
    logarithmic derivative to x = 1 - c.
    """
    rng = np.random.default_rng(22)
    for alpha in (0.05, 0.3, 1.5):
        pairs = [
            (_direction(a, p), _direction(b, q))
            for a, b, p, q in zip(
                10.0 ** rng.uniform(-12, 0, count // 8),
                10.0 ** rng.uniform(-12, 0, count // 8),
                rng.uniform(0, 2 * math.pi, count // 8),
                rng.uniform(0, 2 * math.pi, count // 8),
                strict=True,
            )
        ]
        for f0 in (0.0, 0.04, 1.0):

            def error(pairs: list[tuple[Vec3, Vec3]] = pairs, alpha: float = alpha, f0: float = f0) -> float:
                worst = 0.0
                for wi, wo in pairs:
                    one = eval_lobe(wi, wo, alpha, Vec3(f0, f0, f0)).x / wi.z
                    other = eval_lobe(wo, wi, alpha, Vec3(f0, f0, f0)).x / wo.z
                    if not (math.isfinite(one) and math.isfinite(other)):
                        return math.inf
                    square = 0.25 * sum((a - b) ** 2 for a, b in zip(wi, wo, strict=True))
                    cosine = 0.5 * math.sqrt(sum((a + b) ** 2 for a, b in zip(wi, wo, strict=True)))
                    x = square / (1.0 + cosine)  # 1 - c, without cancellation
                    fresnel = f0 + (1.0 - f0) * x**5
                    slope = 5.0 * (1.0 - f0) * x**4 / fresnel if fresnel > 0.0 else math.inf
                    # Beneath, products before the division by cosines of 1e-12 may be denormal.
                    if max(one, other) > 1e-280:
                        allowed = 2.0**-53 * (34.0 + 19.0 * slope / cosine)
                        worst = max(worst, abs(one - other) / max(one, other) / allowed)
                return worst

            figure = "relative difference over its roundings, 34 + 19 dlog F / dc / c of 2^-53"
            yield Row(f"reciprocity, alpha {alpha:g}, F0 {f0:g}", figure, 1.0, error)


def opposite(count: int) -> Iterator[Row]:
    """w_i = -w_o, at cosines of 1 to 0: below the surface the lobe is 0, in it a number, never NaN."""
    phi = np.linspace(0, 6, max(16, count // 64)).tolist()

    def faulty() -> float:
        bad = 0
        for mu in (*COSINES, 0.0, -0.0):
            for angle in phi:
                wo = _direction(mu, angle)
                wi = Vec3(-wo.x, -wo.y, -wo.z)
                value = eval_lobe(wi, wo, 0.3, _WHITE).x
                # Mirrored in the plane as well: the half vector is the normal or nearly none.
                grazing = eval_lobe(Vec3(-wo.x, -wo.y, wo.z), wo, 0.3, _WHITE).x
                bad += value != 0.0 or not 0.0 <= grazing < math.inf
        return float(bad)

    yield Row("opposite directions", f"of {10 * len(phi)} pairs, those without a right value", 0.0, faulty)


def frames(count: int) -> Iterator[Row]:
    """The frame of a normal is orthonormal to 16 roundings, at ±z and beside it too."""
    rng = np.random.default_rng(23)
    for sign in (1.0, -1.0):
        for distance in (0.0, 1e-16, 1e-12, 1e-8, 1e-4, 1.0):
            step = distance * rng.normal(size=(max(8, count // 64), 2))
            normals = np.c_[step, np.full(len(step), sign)]
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)

            def error(normals: np.ndarray = normals) -> float:
                worst = 0.0
                for normal in normals.tolist():
                    basis = np.array(frame(Vec3(*normal)))
                    worst = max(worst, float(np.abs(basis @ basis.T - np.eye(3)).max()))
                return worst

            yield Row(f"frame at {'+' if sign > 0 else '-'}z, {distance:g} beside", "error of B Bᵀ", 2.0**-49, error)


def _albedo(mu_o: float, alpha: float) -> float:
    """∫ f mu_i dw for F = 1 by the midpoint rule over slopes of the half vector, `dw_i = 4 (wo.m) m_z³ dx dy`.

    Slopes beyond 6.5 alpha weigh exp(-42).
    """
    n = 1000
    t = 6.5 * alpha * (2 * (np.arange(n) + 0.5) / n - 1)
    x, y = np.meshgrid(t, t, indexing="ij", sparse=True)
    mz = 1 / np.sqrt(1 + x * x + y * y)
    cos = (mu_o - x * math.sqrt((1 - mu_o) * (1 + mu_o))) * mz
    mu_i = 2 * cos * mz - mu_o
    seen = (cos > 0) & (mu_i > 0)
    d = np.exp(-(x * x + y * y) / alpha**2) / (np.pi * alpha**2 * mz**4)
    value = d * _g1(np.where(seen, np.minimum(mu_i, 1.0), 0.5), alpha) * float(_g1(np.array(mu_o), alpha))
    return float((13 * alpha / n) ** 2 * np.where(seen, value * cos * mz**3, 0.0).sum() / mu_o)


def furnace(count: int) -> Iterator[Row]:
    """The mean weight is the directional albedo under a white sky, F0 = 1.

    A midpoint rule of n² points errs by the length of the horizon's curve in the square, over 2 n, times the weight
    that ends there, at most 1: 1 / n.
    """
    n = max(12, math.isqrt(count))
    middle = (np.arange(n) + 0.5) / n
    points = np.array([(u, v) for u in middle for v in middle])
    for alpha, mu in ((1e-4, 1.0), (1e-4, 0.1), (0.05, 0.01), (0.3, 1e-3), (0.3, 1.0), (1.5, 1.0), (1.5, 0.05)):
        wo = _direction(mu, 0.0)

        def error(mean: Callable[[], float], mu: float = mu, alpha: float = alpha) -> float:
            return abs(mean() / _albedo(mu, alpha) - 1.0)

        def ours(error: Any = error, wo: Vec3 = wo, alpha: float = alpha) -> float:
            return error(lambda: np.mean([sample_lobe(wo, alpha, _WHITE, u, v)[1].x for u, v in points.tolist()]))

        def paper(error: Any = error, wo: Vec3 = wo, alpha: float = alpha) -> float:
            return error(
                lambda: np.mean([sample_variant(PAPER, 1, wo, alpha, _WHITE, u, v)[1].x for u, v in points.tolist()])
            )

        def mitsuba(error: Any = error, wo: Vec3 = wo, alpha: float = alpha) -> float:
            return error(lambda: _mitsuba_samples(alpha, wo, points)[1].mean())

        figure = "relative error of the albedo"
        yield Row(f"furnace, alpha {alpha:g}, cosine {mu:g}", figure, 1.0 / n, ours, paper, mitsuba)


def quantiles(count: int) -> Iterator[Row]:
    """The slope that u gives has the cumulative distribution u, from normal view to 1e-12 of grazing.

    At alpha = 1, `cdf(x) = [1 + erf(x) + t exp(-x²) / s] / [the same at 1 / t]`, t the tangent of the view's angle
    after stretching, s = sqrt(pi). Sharper than a chi² test: every sample is tested, and without noise. The inversion
    stops at 1e-11 in u; the slope is read off the normal, which is rounded.
    """
    u = np.random.default_rng(24).random(max(32, count // 32))
    for alpha in (1e-4, 0.05, 0.5, 1.5):
        for mu in (0.9, 0.1, 1e-3, 1e-6, 1e-9, 1e-12):
            wo = _direction(mu, 0.0)

            def error(alpha: float = alpha, mu: float = mu, wo: Vec3 = wo) -> float:
                tan = alpha * wo.x / mu
                normals = [sample_visible_normal(wo, alpha, each, 0.5) for each in u.tolist()]
                x = np.array([-m.x / m.z / alpha for m in normals])
                mass = lambda x: 1 + special.erf(x) + tan * np.exp(-x * x) / math.sqrt(math.pi)  # noqa: E731
                return float(np.abs(mass(x) / mass(1.0 / tan) - u).max())

            yield Row(f"visible slopes, alpha {alpha:g}, cosine {mu:g}", "error of the quantile", 1e-9, error)


def bounces(count: int) -> Iterator[Row]:
    """A closed sphere of mirrors loses nothing: chains of up to M vertices give `g (1 - g^M)`, finite at any M.

    alpha = 1e-4 and F0 = 1, so that the albedo is 1: `(1 - g) sum_{j=1..M} g^j`. Roulette below a throughput of 0.1 is
    the noise: less than 0.3 a sample, of 8192 or more 0.4 % of the mean.
    """
    for gloss, most in ((0.5, 64), (0.9, 64), (0.99, 64), (0.9, 8)):

        def error(gloss: float = gloss, most: int = most) -> float:
            scene = glossy_sphere(gloss=gloss, roughness=1e-4, max_bounces=most, subdivisions=2)
            image = render(scene, "specular", samples=8).mean
            return float(abs(image.mean() / (gloss * (1.0 - gloss**most)) - 1.0))

        yield Row(f"closed sphere, gloss {gloss:g}, {most} bounces", "relative error of the mean", 0.02, error)


def rows(count: int) -> Iterator[Row]:
    """All rows of the group, of `count` samples or fewer."""
    for make in (masking, weights, reciprocity, opposite, frames, furnace, quantiles, bounces):
        yield from make(count)
