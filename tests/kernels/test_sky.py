"""The paper's sky against its formula restated in NumPy and SciPy's bilinear interpolation."""

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from termwise.renderer.arrays import from_scene
from termwise.renderer.sky import sky_radiance, sky_texture
from termwise.renderer.vector import Vec3
from termwise.scenes.model import Camera, Scene, Sky

CENTER, RADIUS = np.array([1.0, -2.0, 3.0]), 10.0
TEXTURE = np.random.default_rng(1).uniform(0, 2, (5, 8, 3)).astype(np.float32)


def arrays(sky: Sky):
    return from_scene(Scene("sky", Camera((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)), sky=sky)).sky


@pytest.fixture(scope="module")
def textured():
    return arrays(Sky(texture=TEXTURE, center=tuple(CENTER.tolist()), radius=RADIUS))


@pytest.fixture(scope="module")
def interpolator() -> RegularGridInterpolator:
    """SciPy over texel centres, the texture wrapped around in u and its border rows repeated in v."""
    padded = np.pad(
        np.concatenate([TEXTURE[:, -1:], TEXTURE, TEXTURE[:, :1]], axis=1), ((1, 1), (0, 0), (0, 0)), "edge"
    )
    v = (np.arange(-1, 6) + 0.5) / 5
    u = (np.arange(-1, 9) + 0.5) / 8
    return RegularGridInterpolator((v, u), padded.astype(np.float64))


def paper_uv(origin: np.ndarray, direction: np.ndarray) -> tuple[float, float] | None:
    """u, v of the sphere's farther intersection by the quadratic formula, None where there is none ahead."""
    s = origin - CENTER
    a, b, c = direction @ direction, 2 * s @ direction, s @ s - RADIUS**2
    discriminant = b * b - 4 * a * c
    if discriminant < 0:
        return None
    t = (-b + np.sqrt(discriminant)) / (2 * a)
    if t <= 0:
        return None
    n = (origin + t * direction - CENTER) / RADIUS
    return np.arctan2(n[0], n[1]) / (2 * np.pi) + 0.5, 0.5 - n[2] / 2


def test_bilinear_lookup_against_scipy(textured, interpolator):
    """Random u, v, and the borders: u = 0 and u = 1 are one place, v beyond the outer texel centres is constant."""
    uv = np.concatenate([np.random.default_rng(2).uniform(0, 1, (200, 2)), [(0, 0.3), (1, 0.3), (0.5, 0), (0.5, 1)]])
    for u, v in uv.tolist():
        np.testing.assert_allclose(sky_texture(textured, u, v), interpolator((v, u)), rtol=1e-12)
    np.testing.assert_allclose(sky_texture(textured, 0.0, 0.4), sky_texture(textured, 1.0, 0.4), rtol=1e-12)


def test_radiance_against_the_paper_s_formula(textured, interpolator):
    """Rays from inside and outside the sphere: the farther hit's texel, black on a miss. All three cases occur."""
    rng = np.random.default_rng(3)
    seen = {"inside": 0, "outside": 0, "miss": 0}
    for _ in range(300):
        origin = CENTER + rng.normal(size=3) * rng.choice([3.0, 15.0])
        direction = CENTER + 8.0 * rng.normal(size=3) - origin
        direction /= np.linalg.norm(direction)
        expected = paper_uv(origin, direction)
        found = sky_radiance(textured, Vec3(*origin.tolist()), Vec3(*direction.tolist()))
        if expected is None:
            assert found == (0.0, 0.0, 0.0)
            seen["miss"] += 1
        else:
            u, v = expected
            np.testing.assert_allclose(found, interpolator((v, u)), rtol=1e-9)
            seen["inside" if np.linalg.norm(origin - CENTER) < RADIUS else "outside"] += 1
    assert min(seen.values()) > 20, seen


def test_parallax(textured):
    """One direction from two places sees two texels: the sphere is at a finite distance (paper)."""
    up = Vec3(0.0, 0.0, 1.0)
    here, there = Vec3(*CENTER.tolist()), Vec3(*(CENTER + [7.0, 0, 0]).tolist())
    assert sky_radiance(textured, here, up) != sky_radiance(textured, there, up)


def test_axes_of_the_map(textured):
    """From the centre: +y is the middle of the texture (u = .5), +x a quarter further, +z the top row."""
    centre = Vec3(*CENTER.tolist())
    np.testing.assert_allclose(sky_radiance(textured, centre, Vec3(0.0, 1.0, 0.0)), sky_texture(textured, 0.5, 0.5))
    np.testing.assert_allclose(sky_radiance(textured, centre, Vec3(1.0, 0.0, 0.0)), sky_texture(textured, 0.75, 0.5))
    top = sky_radiance(textured, centre, Vec3(0.0, 0.0, 1.0))
    np.testing.assert_allclose(top, sky_texture(textured, np.arctan2(0.0, 0.0) / (2 * np.pi) + 0.5, 0.0))


def test_far_origin_hits_the_same_texel(textured, interpolator):
    """From 1e6 radii away along a ray through the centre: relative position on the sphere is kept to 1e-8."""
    direction = np.array([0.6, 0.0, 0.8])
    origin = CENTER - 1e6 * direction
    found = sky_radiance(textured, Vec3(*origin.tolist()), Vec3(*direction.tolist()))
    u, v = np.arctan2(0.6, 0.0) / (2 * np.pi) + 0.5, 0.5 - 0.4
    np.testing.assert_allclose(found, interpolator((v, u)), rtol=1e-8)


def test_constant_sky():
    """The colour, wherever and whither."""
    sky = arrays(Sky(color=(0.5, 0.25, 2.0), radius=1e-3))
    assert sky_radiance(sky, Vec3(9.0, 9.0, 9.0), Vec3(0.0, 0.0, 1.0)) == (0.5, 0.25, 2.0)
