"""Every sampler against its density, `|∂w/∂u x ∂w/∂v| p(w) = 1`, by central differences.

Rationale: a chi² test averages over cells; this one is local, has no cells to be too wide for a lobe, and holds down
to grazing views of nearly smooth surfaces. Densities are those that the renderer divides by or, where it divides by
none, the ones that its weights stand for. With h = 1e-5 and points at least 0.02 from the borders of the square, where
third derivatives of a quantile are of the order 1 / 0.02², the differences are good to h² / 0.02² = 3e-7; rounding
adds 1e-14 / h = 1e-9 over the width of the narrowest lobe, 1e-3: 1e-6.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest

from termwise.renderer import warp
from termwise.renderer.arrays import from_scene
from termwise.renderer.microfacet import beckmann_d, pdf_lobe, sample_lobe, sample_visible_normal, smith_g1
from termwise.renderer.terms.specular import UNIFORM, sample_variant
from termwise.renderer.triangles import point_on_face
from termwise.renderer.vector import Vec3
from termwise.scenes.analytic import plate
from termwise.scenes.model import Camera, Object, Scene

H = 1e-5
WHITE = Vec3(1.0, 1.0, 1.0)


def jacobian(sample: Callable[[float, float], Vec3], u: float, v: float) -> float:
    """Area of the image of the square at (u, v), per area."""
    along, across = (
        (np.array(sample(u + du, v + dv)) - np.array(sample(u - du, v - dv))) / (2 * H)
        for du, dv in ((H, 0.0), (0.0, H))
    )
    return float(np.linalg.norm(np.cross(along, across)))


def interior(count: int) -> list[list[float]]:
    """Points off the borders and off the diagonals, where maps of the square have creases."""
    points = np.random.default_rng(1).uniform(0.02, 0.98, (count, 2))
    creased = np.minimum(abs(points[:, 0] - points[:, 1]), abs(points.sum(axis=1) - 1)) < 1e-3
    return points[~creased].tolist()


@pytest.mark.parametrize(
    ("sample", "density"),
    [
        (warp.square_to_uniform_sphere, lambda w: 1 / (4 * math.pi)),
        (lambda u, v: warp.square_to_uniform_cone(u, v, 0.9), lambda w: 1 / (0.2 * math.pi)),
        (lambda u, v: warp.square_to_uniform_cone(u, v, -0.5), lambda w: 1 / (3 * math.pi)),
        (warp.hemisphere_ring, lambda w: 1 / (2 * math.pi)),
        (warp.square_to_cosine_hemisphere, lambda w: warp.square_to_cosine_hemisphere_pdf(w.z)),
    ],
    ids=("sphere", "narrow cone", "wide cone", "hemisphere", "cosine"),
)
def test_directions(sample, density, compiled):
    """1 / (4 pi); 1 / (2 pi (1 - c)) in a cone; 1 / (2 pi) for a uniform cosine; cos / pi."""
    for u, v in interior(200 if compiled else 60):
        assert jacobian(sample, u, v) * density(sample(u, v)) == pytest.approx(1, rel=1e-5)


def test_points_of_a_triangle(compiled):
    """1 / area, on a triangle in space: what light sampling divides by."""
    mesh = plate("plate", (0.3, -0.2, 0.5), (1.0, 0.5, 0.25), (-0.25, 1.5, 0.5)).mesh
    corners = mesh.vertices[mesh.faces]
    geometry = from_scene(Scene("plate", Camera((0.0, -3.0, 0.0), (0.0, 0.0, 0.0)), (Object("plate", mesh),))).geometry
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    for face in (0, 1):
        sample = lambda u, v, face=face: point_on_face(geometry, face, *warp.square_to_triangle(u, v))  # noqa: E731
        for u, v in interior(100 if compiled else 30):
            assert jacobian(sample, u, v) / area[face] == pytest.approx(1, rel=1e-5)


VIEWS = [(alpha, mu) for alpha in (1e-3, 0.05, 0.3, 1.0) for mu in (1e-3, 0.1, 0.5, 0.999, 1.0)]


def view(mu: float) -> Vec3:
    sin = math.sqrt(1 - mu * mu)
    return Vec3(sin * math.cos(0.4), sin * math.sin(0.4), mu)


@pytest.mark.parametrize(("alpha", "mu_o"), VIEWS)
def test_visible_normals(alpha, mu_o, compiled):
    """`G1(wo) D(m) max(0, wo.m) / mu_o`."""
    wo = view(mu_o)
    for u, v in interior(100 if compiled else 20):
        m = sample_visible_normal(wo, alpha, u, v)
        density = smith_g1(mu_o, alpha) * beckmann_d(m, alpha) * np.dot(wo, m) / mu_o
        found = jacobian(lambda u, v: sample_visible_normal(wo, alpha, u, v), u, v)
        assert found * density == pytest.approx(1, rel=1e-5)


@pytest.mark.parametrize(("alpha", "mu_o"), VIEWS)
def test_directions_of_the_lobe(alpha, mu_o, compiled):
    """`pdf_lobe`, above the horizon; the density of 1.01 alpha is told apart, but where the two densities cross."""
    wo = view(mu_o)
    above = apart = 0
    for u, v in interior(100 if compiled else 20):
        wi, _ = sample_lobe(wo, alpha, WHITE, u, v)
        if wi.z <= 0:
            continue
        above += 1
        found = jacobian(lambda u, v: sample_lobe(wo, alpha, WHITE, u, v)[0], u, v)
        assert found * pdf_lobe(wi, wo, alpha) == pytest.approx(1, rel=1e-5)
        apart += abs(found * pdf_lobe(wi, wo, 1.01 * alpha) - 1) > 1e-4
    assert above > 5
    assert apart > 0.9 * above


def test_uniform_variants_of_the_lobe(compiled):
    """The weight of `uniform` is `f mu_i / p` with p = 1 / (2 pi): its directions must have that density."""
    wo = view(0.5)
    for u, v in interior(100 if compiled else 20):
        found = jacobian(lambda u, v: sample_variant(UNIFORM, 1, wo, 0.3, WHITE, u, v)[0], u, v)
        assert found / (2 * math.pi) == pytest.approx(1, rel=1e-5)
