"""Maps of the square: moments in closed form, Jacobians, and stratification.

The chi² tests of the same samplers against their densities are in tests/oracle/test_chi2.py.
"""

import math

import numpy as np
import pytest

from termwise.renderer import warp
from termwise.renderer.vector import Vec3


def midpoints(n: int) -> np.ndarray:
    """Midpoint rule on the square, (n², 2)."""
    x = (np.arange(n) + 0.5) / n
    return np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)


def cone_of_60(u: float, v: float) -> Vec3:
    return warp.square_to_uniform_cone(u, v, 0.5)


@pytest.fixture
def square(compiled) -> np.ndarray:
    return midpoints(200 if compiled else 60)


def test_directions_have_unit_length(square):
    """All of them, at the corners of the square too."""
    corners = np.array([(0, 0), (0, 1), (1, 0), (1, 1), (0.5, 0.5), (0, 0.5), (0.5, 1)], float)
    for u, v in (*corners, *square[::7]):
        for sample in (
            warp.square_to_uniform_sphere,
            warp.hemisphere_ring,
            warp.square_to_cosine_hemisphere,
            cone_of_60,
        ):
            assert np.linalg.norm(sample(u, v)) == pytest.approx(1.0, abs=1e-15)
        assert warp.square_to_cosine_hemisphere(u, v).z >= 0.0


@pytest.mark.parametrize(
    ("warp", "moments"),
    [
        # E[x], E[y], E[z], E[z²], E[x²], E[xy]
        (warp.square_to_uniform_sphere, (0, 0, 0, 1 / 3, 1 / 3, 0)),
        # z uniform in [c, 1]: (1 + c) / 2, (1 + c + c²) / 3, (1 - E[z²]) / 2 with c = 1 / 2
        (cone_of_60, (0, 0, 3 / 4, 7 / 12, 5 / 24, 0)),
        (warp.hemisphere_ring, (0, 0, 1 / 2, 1 / 3, 1 / 3, 0)),
        (warp.square_to_cosine_hemisphere, (0, 0, 2 / 3, 1 / 2, 1 / 4, 0)),
    ],
)
def test_moments(warp, moments, square):
    """First and second moments of the density, closed form, by the midpoint rule."""
    x, y, z = np.array([warp(u, v) for u, v in square.tolist()]).T
    found = [x.mean(), y.mean(), z.mean(), (z * z).mean(), (x * x).mean(), (x * y).mean()]
    np.testing.assert_allclose(found, moments, atol=2e-3)


def test_cosine_density_integrates_to_one():
    """∫ pdf dw = 2 pi ∫_0^1 pdf(mu) dmu = 1, and 0 below the horizon."""
    mu = (np.arange(1000) + 0.5) / 1000
    assert 2 * np.pi * np.mean([warp.square_to_cosine_hemisphere_pdf(m) for m in mu.tolist()]) == pytest.approx(1.0)
    assert warp.square_to_cosine_hemisphere_pdf(-0.3) == 0.0


def test_concentric_map_preserves_area(compiled):
    """The Jacobian of square to disc is pi everywhere: finite differences off the diagonals, where it has a crease."""
    h = 1e-6
    for u, v in np.random.default_rng(1).uniform(0.02, 0.98, (200, 2)).tolist():
        if min(abs(u - v), abs(u + v - 1)) < 1e-3:
            continue
        px, mx = warp.square_to_cosine_hemisphere(u + h, v), warp.square_to_cosine_hemisphere(u - h, v)
        py, my = warp.square_to_cosine_hemisphere(u, v + h), warp.square_to_cosine_hemisphere(u, v - h)
        jacobian = np.array([[px.x - mx.x, py.x - my.x], [px.y - mx.y, py.y - my.y]]) / (2 * h)
        assert abs(np.linalg.det(jacobian)) == pytest.approx(np.pi, rel=1e-6)


def test_triangle_points_are_inside_and_uniform(square):
    """b1, b2 >= 0, b1 + b2 <= 1, mean 1/3 each, and the quarter triangle b1 + b2 < 1/2 gets a quarter."""
    b = np.array([warp.square_to_triangle(u, v) for u, v in square.tolist()])
    assert (b >= 0).all()
    assert (b.sum(axis=1) <= 1).all()
    np.testing.assert_allclose(b.mean(axis=0), 1 / 3, atol=2e-3)
    assert np.mean(b.sum(axis=1) < 0.5) == pytest.approx(0.25, abs=0.02)
    # E[b1²] = 1/6, E[b1 b2] = 1/12.
    assert np.mean(b[:, 0] ** 2) == pytest.approx(1 / 6, abs=2e-3)
    assert np.mean(b[:, 0] * b[:, 1]) == pytest.approx(1 / 12, abs=2e-3)


def test_sine_and_cosine_of_turns():
    for v in np.linspace(0.0, 1.0, 4001).tolist():
        sin, cos = warp.sin_cos_turn(v)
        # 2 pi v in double precision is off by up to 2^-51 itself.
        assert sin == pytest.approx(math.sin(2 * math.pi * v), abs=2.0**-50)
        assert cos == pytest.approx(math.cos(2 * math.pi * v), abs=2.0**-50)
