"""The photon map: grid against KDTree, kernels and the laws of their bias, photon tracing.

Rationale: density estimates are biased by design; what is tested is that the bias is the one that the derivation
predicts and none besides: no disc area at borders, no photons from the other side, none counted twice.
Photons are placed here by hand through `build`, so that the irradiance that they stand for is known.
"""

import math
import os
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import attrs
import numpy as np
import pytest
import trimesh
from scipy import integrate
from scipy.spatial import KDTree

from termwise.renderer import photon_map
from termwise.renderer.arrays import SceneArrays, from_scene
from termwise.renderer.kernel_mass import EXPONENTS, MAX_PLANE_DISTANCE, MIN_NORMAL_COSINE, kernel_mass
from termwise.renderer.photon_density import _weighted_flux, estimate_irradiance
from termwise.renderer.photon_map import build, empty, progressive_radius
from termwise.renderer.photon_search import nearest_irradiance
from termwise.renderer.photon_tracing import Scattering, emit
from termwise.renderer.rng import root
from termwise.renderer.scratch import new_scratch
from termwise.renderer.surface import Surface
from termwise.renderer.vector import Vec3
from termwise.scenes.analytic import closed_box, plate, unit_sphere
from termwise.scenes.model import Camera, Material, Mesh, Object, PointLight, Scene

SCRATCH = new_scratch()
UP = Vec3(0.0, 0.0, 1.0)


def vec(values) -> Vec3:
    return Vec3(*(float(x) for x in values))


def arrays(*objects: Object) -> SceneArrays:
    return from_scene(Scene("photons", Camera((0.0, -3.0, 1.0), (0.0, 0.0, 0.0)), objects))


def unit_plate(name: str = "plate", z: float = 0.0) -> Object:
    """[0, 1]² facing up; face 0 has x >= y, face 1 x <= y."""
    return plate(name, (0.0, 0.0, z), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))


def at(point, normal=UP, face: int = 0, thing: int = 0, side: float = 1.0) -> Surface:
    return Surface(vec(point), vec(normal), vec(normal), face, thing, side, 0.0, 0.0)


SHAPES = ("uniform", "epanechnikov", "simpson")
# K(d) pi r² over u = d² / r², as the literature writes each.
PROFILES = {
    "uniform": lambda u: np.ones_like(u),
    "epanechnikov": lambda u: 2 * (1 - u),
    "simpson": lambda u: 3 * (1 - u) ** 2,
}
# Bias inside a surface over r² ΔE: a quarter of the kernel's mean d² / r².
COEFFICIENTS = {"uniform": 1 / 8, "epanechnikov": 1 / 12, "simpson": 1 / 16}


def profile(shape: str, square: np.ndarray, radius: float) -> np.ndarray:
    """K at squared distances."""
    u = np.asarray(square) / radius**2
    return np.where(u < 1, PROFILES[shape](u), 0.0) / (np.pi * radius**2)


def marginal(shape: str, t: float, radius: float) -> float:
    """Mass of the kernel on the line at distance t from its centre, per length: ∫ K(sqrt(t² + s²)) ds."""
    half = math.sqrt(radius**2 - t**2)
    return integrate.quad(lambda s: float(profile(shape, t * t + s * s, radius)), -half, half)[0]


def one_sided(shape: str, a: float, radius: float) -> float:
    """Mass of the kernel on the half plane whose border is at distance a from its centre, which it holds if a > 0."""
    return 0.5 + integrate.quad(lambda t: marginal(shape, t, radius), 0, a)[0]


def on_plate(
    xy: np.ndarray, power, radius: float, shape: str = "simpson", *, direction=(0.0, 0.0, 1.0)
) -> photon_map.PhotonMap:
    """Photons on `unit_plate` at (P, 2), each with its face."""
    position = np.column_stack([xy, np.zeros(len(xy))])
    face = np.where(xy[:, 0] >= xy[:, 1], 0, 1).astype(np.int32)
    flux = np.broadcast_to(np.reshape(power, (-1, 1)), (len(xy), 3)).astype(float)
    return build(position, np.tile(np.array(direction, float), (len(xy), 1)), flux, face, radius, shape)


# Queries on three objects, one of them smooth, that come within a radius of each other.


@pytest.fixture(scope="module")
def crowd() -> tuple[SceneArrays, np.random.Generator]:
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.5)
    smooth = Object("ball", Mesh.from_arrays(ball.vertices + (0.5, 0.5, 0.6), ball.faces, smooth=True))
    return arrays(unit_plate(), unit_plate("upper", 0.05), smooth), np.random.default_rng(1)


def scattered(scene: SceneArrays, rng: np.random.Generator, count: int):
    """Photons at random places of random faces, from random directions on both sides."""
    face = rng.integers(0, len(scene.geometry.corners), count).astype(np.int32)
    position = np.einsum("pc,pcx->px", rng.dirichlet((1, 1, 1), count), scene.geometry.corners[face])
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return position, direction, rng.uniform(0, 2, (count, 3)), face


def random_query(scene: SceneArrays, rng: np.random.Generator) -> Surface:
    g = scene.geometry
    face = int(rng.integers(0, len(g.corners)))
    b = rng.dirichlet((1, 1, 1))
    side = float(rng.choice([-1.0, 1.0]))
    normal = side * (b @ g.shading[face])
    normal /= np.linalg.norm(normal)
    point = vec(b @ g.corners[face])
    return Surface(point, vec(normal), vec(normal), face, int(g.object[face]), side, float(b[1]), float(b[2]))


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("radius", [0.02, 0.15, 3.0])
def test_gather_against_kdtree(crowd, radius, shape, compiled):
    """The same sum with KDTree's neighbours: same object and side, normals within acos(0.1), x near the face's plane.

    Both divide by `kernel_mass`, which has tests of its own; the sums agree to 1e-12.
    """
    scene, rng = crowd
    g = scene.geometry
    radius = radius if compiled else max(radius, 0.2)  # few photons need a wide kernel
    count = 3000 if compiled else 200
    position, direction, power, face = scattered(scene, rng, count)
    photons = build(position, direction, power, face, radius, shape)
    tree = KDTree(position)
    filled = 0
    for _ in range(60 if compiled else 12):
        query = random_query(scene, rng)
        near = np.array(tree.query_ball_point(query.point, radius), int)
        expected = np.zeros(3)
        for p in near:
            normal = g.normals[face[p]]
            cos = direction[p] @ normal
            same = g.object[face[p]] == query.object and normal @ g.normals[query.face] > MIN_NORMAL_COSINE
            same &= abs((position[p] - query.point) @ normal) < MAX_PLANE_DISTANCE * radius
            if same and cos * query.side > 0:
                weight = profile(shape, np.sum((position[p] - query.point) ** 2), radius)
                if g.smooth[face[p]]:
                    weight *= max(0.0, direction[p] @ query.normal) / abs(cos)
                expected += weight * power[p]
        expected /= kernel_mass(scene, query.face, query.point, radius, EXPONENTS[shape], SCRATCH.stack)
        found = estimate_irradiance(scene, photons, query, SCRATCH)
        np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-12 * expected.max(initial=1))
        filled += expected.any()
    assert filled > 5


_QUERIES = """
import pickle, sys
from termwise.renderer.photon_density import _weighted_flux
geometry, maps, queries, lanes = pickle.load(sys.stdin.buffer)
pickle.dump([[tuple(_weighted_flux(geometry, m, q, lanes)) for q in queries] for m in maps], sys.stdout.buffer)
"""


def test_lanes_sum_photons_as_plain_python_does(crowd):
    """Equal bits: of few and of many photons a cell, of one more than eight and of one less, smooth or not."""
    scene, rng = crowd
    maps = [build(*scattered(scene, rng, count), radius) for count, radius in ((7, 3.0), (9, 3.0), (300, 0.3))]
    queries = [random_query(scene, rng) for _ in range(40)]
    given = pickle.dumps((scene.geometry, maps, queries, SCRATCH.lanes))
    run = subprocess.run(
        [sys.executable, "-c", _QUERIES],
        input=given,
        stdout=-1,
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        check=True,
    )
    found = [[tuple(_weighted_flux(scene.geometry, m, q, SCRATCH.lanes)) for q in queries] for m in maps]
    assert found == pickle.loads(run.stdout)
    assert np.count_nonzero([[flux[0] for flux in each] for each in found]) > 40


@pytest.mark.slow
@pytest.mark.parametrize("k", [1, 7, 50])
def test_nearest_against_kdtree(crowd, k, compiled):
    """The k nearest photons in front of the surface: their flux over pi r_k², by KDTree; all of them if fewer."""
    scene, rng = crowd
    count = 1500 if compiled else 150
    position, direction, power, face = scattered(scene, rng, count)
    for radius in (0.05, 2.0):
        photons = build(position, direction, power, face, radius)
        heap, chosen = np.empty(k), np.empty(k, np.int64)
        for _ in range(25 if compiled else 6):
            query = random_query(scene, rng)
            front = direction @ np.array(query.normal) > 0
            distance, index = map(np.atleast_1d, KDTree(position[front]).query(query.point, k=k))
            expected = power[front][index].sum(axis=0) / (np.pi * distance[-1] ** 2)
            found = nearest_irradiance(photons, query, k, heap, chosen)
            np.testing.assert_allclose(found, expected, rtol=1e-11)


def test_nearest_with_fewer_photons_than_k():
    """Three photons and k = 10: all three over the farthest's disc, and no endless search."""
    photons = on_plate(np.array([[0.5, 0.4], [0.5, 0.45], [0.6, 0.4]]), 1.0, 1e-3)
    found = nearest_irradiance(photons, at((0.5, 0.4, 0.0)), 10, np.empty(10), np.empty(10, np.int64))
    np.testing.assert_allclose(found, 3 / (np.pi * 0.01))


@pytest.mark.parametrize("k", [5, 20])
def test_nearest_is_too_bright_by_k_over_k_minus_one(k, compiled):
    """n uniform photons of irradiance 1: the mean over maps is k / (k - 1), since pi r_k² is Beta(k, n - k + 1)."""
    rng = np.random.default_rng(2)
    count = 400
    scratch = np.empty(k), np.empty(k, np.int64)
    values = [
        nearest_irradiance(on_plate(rng.uniform(size=(count, 2)), 1 / count, 0.1), at((0.5, 0.45, 0)), k, *scratch).x
        for _ in range(3000 if compiled else 300)
    ]
    error = np.std(values, ddof=1) / np.sqrt(len(values))
    assert abs(np.mean(values) - k / (k - 1)) < 4.5 * error
    # What the factor (k - 1) / k mends is seen.
    assert error < (1 / (k - 1) / 4.5 if compiled else 0.2)


# Estimates of a known irradiance.


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES)
def test_constant_irradiance_is_unbiased_up_to_edges_and_corners(shape, compiled):
    """Uniform photons of irradiance 1; mean over maps is 1 inside, near and on edges and corners, within 4.5 sigma."""
    rng = np.random.default_rng(6)
    scene = arrays(unit_plate())
    queries = [(0.5, 0.4), (0.5, 0.0), (0.95, 0.5), (0.0, 0.0), (0.98, 0.03), (0.3, 0.3)]
    maps, count = (1500, 300) if compiled else (150, 100)
    values = []
    for _ in range(maps):
        photons = on_plate(rng.uniform(size=(count, 2)), 1 / count, 0.15, shape)
        values.append([estimate_irradiance(scene, photons, at((*q, 0.0)), SCRATCH).x for q in queries])
    error = np.std(values, axis=0, ddof=1) / np.sqrt(maps)
    assert (np.abs(np.mean(values, axis=0) - 1) < 4.5 * error).all()
    assert error.max() < (0.05 if compiled else 0.3)


@pytest.mark.parametrize("shape", SHAPES)
def test_quadratic_irradiance_is_biased_by_the_law(shape, compiled):
    """E = 1 + 3 x² + 2 y², Laplacian 10: the estimate is E + coefficient r² ΔE, a quarter of the kernel's mean d².

    Photons on a regular grid stand for E without noise: the sum over it is the integral to 1e-5 where the kernel is
    continuous. A disc of R cells holds pi R² points to about 2 R^(2/3) (Gauss's circle problem), for the uniform one.
    """
    n = 400 if compiled else 120
    x = (np.arange(n) + 0.5) / n
    xy = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    power = (1 + 3 * xy[:, 0] ** 2 + 2 * xy[:, 1] ** 2) / n**2
    scene = arrays(unit_plate())
    for r in (0.2, 0.3) if compiled else (0.3,):
        photons = on_plate(xy, power, r, shape)
        for qx, qy in ((0.5, 0.4), (0.4, 0.61)):
            exact = 1 + 3 * qx**2 + 2 * qy**2
            bias = estimate_irradiance(scene, photons, at((qx, qy, 0.0)), SCRATCH).x - exact
            rim = 2 * exact * (n * r) ** (2 / 3) / (np.pi * (n * r) ** 2) if shape == "uniform" else 0.0
            assert bias == pytest.approx(COEFFICIENTS[shape] * r * r * 10, rel=0.01, abs=3e-4 + rim)


@pytest.mark.parametrize("shape", SHAPES)
def test_half_plane_is_blurred_by_the_marginal(shape, compiled):
    """E = 1 for x > 1/2: at distance a from the border the estimate is the kernel's mass on the lit side."""
    n, r = 400 if compiled else 150, 0.2
    x = (np.arange(n) + 0.5) / n
    xy = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    photons = on_plate(xy[xy[:, 0] > 0.5], 1 / n**2, r, shape)
    scene = arrays(unit_plate())
    for a in (-0.15, -0.05, 0.0, 0.1):
        found = estimate_irradiance(scene, photons, at((0.5 + a, 0.5, 0.0)), SCRATCH).x
        assert found == pytest.approx(one_sided(shape, a, r), abs=4e-3 if compiled else 0.02)


@pytest.mark.parametrize("shape", SHAPES)
def test_lit_quadrant_near_a_corner(shape, compiled):
    """E = x y on [0, 1]², at its corner, where E = 0: the kernel's mean of x y over the quarter disc is O(r²).

    ∫∫ x y K over the quarter is (1/2) ∫ K d³ dd and the mass is 1/4, so the corner reads 2 ∫ K d³ dd.
    """
    n, r = 400 if compiled else 150, 0.3
    x = (np.arange(n) + 0.5) / n
    xy = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    photons = on_plate(xy, xy[:, 0] * xy[:, 1] / n**2, r, shape)
    expected = 2 * integrate.quad(lambda d: float(profile(shape, d * d, r)) * d**3, 0, r)[0]
    found = estimate_irradiance(arrays(unit_plate()), photons, at((0.0, 0.0, 0.0)), SCRATCH).x
    assert found == pytest.approx(expected, rel=0.01 if compiled else 0.03)


# Mean distance from the centre over r: ∫ K d dA.
MEAN_DISTANCES = {"uniform": 2 / 3, "epanechnikov": 8 / 15, "simpson": 16 / 35}


@pytest.mark.parametrize("shape", SHAPES)
def test_linear_irradiance_is_biased_along_edges_alone(shape, compiled):
    """E = 1 + 3 x + 2 y: no bias inside, where the kernel is even; O(r) in a strip of width r along an edge.

    At distance a from the edge x = 0 the division by the mass leaves `3 ∫_{-a}^r t m(t) dt / M(a)`, m the kernel's
    marginal: on the edge 3 (2 / pi) ∫ K d dA, in the corner the same with 3 + 2.
    """
    n, radii = (400, (0.3, 0.15)) if compiled else (150, (0.3,))
    x = (np.arange(n) + 0.5) / n
    xy = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    scene = arrays(unit_plate())
    for r in radii:
        photons = on_plate(xy, (1 + 3 * xy[:, 0] + 2 * xy[:, 1]) / n**2, r, shape)
        # As in the test of the quadratic: the sum over a lattice, its rim for the kernel that jumps there.
        rim = 8 * (n * r) ** (2 / 3) / (np.pi * (n * r) ** 2) if shape == "uniform" else 0.0

        def bias(qx: float, qy: float, photons=photons) -> float:
            exact = 1 + 3 * qx + 2 * qy
            return estimate_irradiance(scene, photons, at((qx, qy, 0.0)), SCRATCH).x - exact

        on_edge = 2 / np.pi * MEAN_DISTANCES[shape] * r
        for a in (0.0, 0.2 * r, 0.6 * r):
            moment = integrate.quad(lambda t, r=r: t * marginal(shape, t, r), a, r)[0]  # the rest of it is odd
            law = 3 * moment / one_sided(shape, a, r)
            assert bias(a, 0.5) == pytest.approx(law, rel=0.01, abs=3e-4 + rim)
            if a == 0:
                assert law == pytest.approx(3 * on_edge, rel=1e-6)
        assert bias(0.0, 0.0) == pytest.approx(5 * on_edge, rel=0.01, abs=3e-4 + 2 * rim)
        for inside in ((r, 0.5), (0.5, 0.4)):
            assert bias(*inside) == pytest.approx(0, abs=3e-4 + rim)


def test_photons_of_the_other_side_never_count():
    """Photons that arrive from below are seen from below only, by both estimators."""
    scene = arrays(unit_plate())
    xy = np.random.default_rng(7).uniform(size=(200, 2))
    below = on_plate(xy, 1.0, 0.3, direction=(0.0, 0.6, -0.8))
    scratch = np.empty(5), np.empty(5, np.int64)
    above = at((0.5, 0.4, 0.0))
    assert estimate_irradiance(scene, below, above, SCRATCH) == (0.0, 0.0, 0.0)
    assert nearest_irradiance(below, above, 5, *scratch) == (0.0, 0.0, 0.0)
    under = at((0.5, 0.4, 0.0), Vec3(0.0, 0.0, -1.0), side=-1.0)
    assert estimate_irradiance(scene, below, under, SCRATCH).x > 0
    assert nearest_irradiance(below, under, 5, *scratch).x > 0


def test_photons_do_not_leak_to_another_object():
    """A second plate 0.05 above, photons on it: none count on the first, though they lie within the radius."""
    scene = arrays(unit_plate(), unit_plate("upper", 0.05))
    xy = np.random.default_rng(8).uniform(size=(200, 2))
    position = np.column_stack([xy, np.full(200, 0.05)])
    face = np.full(200, 2, np.int32)
    photons = build(position, np.tile([0.0, 0.0, 1.0], (200, 1)), np.ones((200, 3)), face, 0.3)
    assert estimate_irradiance(scene, photons, at((0.5, 0.4, 0.0)), SCRATCH) == (0.0, 0.0, 0.0)
    assert estimate_irradiance(scene, photons, at((0.5, 0.4, 0.05), face=2, thing=1), SCRATCH).x > 0


def test_thin_walls_do_not_leak():
    """Photons on the upper face of a plate 1e-3 thick, or inside a hollow box with such walls: none on the other side.

    The faces of the other side are turned away, so neither their photons nor their areas count.
    """
    rng = np.random.default_rng(12)
    thin = trimesh.creation.box(extents=(1.0, 1.0, 1e-3))
    inner, outer = trimesh.creation.box(extents=(1.0,) * 3), trimesh.creation.box(extents=(1.002,) * 3)
    hollow = np.concatenate([inner.faces[:, ::-1], outer.faces + len(inner.vertices)])
    for thing, lit, dark in (
        (Mesh.from_arrays(thin.vertices, thin.faces), np.flatnonzero(thin.face_normals[:, 2] > 0.9), range(12)),
        (Mesh.from_arrays(np.concatenate([inner.vertices, outer.vertices]), hollow), np.arange(12), range(12, 24)),
    ):
        scene = arrays(Object("thing", thing))
        g = scene.geometry
        face = rng.choice(lit, 2000).astype(np.int32)
        position = np.einsum("pc,pcx->px", rng.dirichlet((1, 1, 1), len(face)), g.corners[face])
        photons = build(position, g.normals[face], np.ones((len(face), 3)), face, 0.2)
        for other in set(dark) - set(lit):
            query = at(g.corners[other].mean(axis=0), vec(g.normals[other]), face=other)
            assert estimate_irradiance(scene, photons, query, SCRATCH) == (0.0, 0.0, 0.0)
        here = at(g.corners[lit[0]].mean(axis=0), vec(g.normals[lit[0]]), face=int(lit[0]))
        assert estimate_irradiance(scene, photons, here, SCRATCH).x > 0


@pytest.mark.parametrize("height", [0.01, 0.019, 0.021, 0.15])
def test_light_does_not_leak_down_a_step(height, compiled):
    """A dark tread below a lit one of the same object: black where the step is higher than r / 10.

    At the foot of a lower one there is less light than a shadow border on flat ground would let through.
    """
    r, n = 0.2, 300 if compiled else 60
    vertices = [[-1, 0, 0], [0, 0, 0], [0, 1, 0], [-1, 1, 0]]
    vertices += [[0, 0, height], [1, 0, height], [1, 1, height], [0, 1, height]]
    faces = [[0, 1, 2], [0, 2, 3], [1, 4, 7], [1, 7, 2], [4, 5, 6], [4, 6, 7]]
    scene = arrays(Object("step", Mesh.from_arrays(vertices, faces)))
    x = (np.arange(n) + 0.5) / n
    xy = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    position = np.column_stack([xy, np.full(len(xy), height)])
    face = np.where(xy[:, 0] >= xy[:, 1], 4, 5).astype(np.int32)
    photons = build(position, np.tile([0.0, 0.0, 1.0], (len(xy), 1)), np.full((len(xy), 3), 1 / n**2), face, r)
    for a in (0.002, 0.05, 0.1):
        found = estimate_irradiance(scene, photons, at((-a, 0.5, 0.0)), SCRATCH).x
        if height > MAX_PLANE_DISTANCE * r:
            assert found == 0
        else:
            assert 0 < found < one_sided("simpson", -a, r)


def test_no_photons_and_far_queries():
    """An empty map gives black; a query at 1e30, and one at 1e300, neither crash nor find anything."""
    scene = arrays(unit_plate())
    scratch = np.empty(5), np.empty(5, np.int64)
    photons = on_plate(np.random.default_rng(9).uniform(size=(50, 2)), 1.0, 0.1)
    assert estimate_irradiance(scene, empty(), at((0.5, 0.4, 0.0)), SCRATCH) == (0.0, 0.0, 0.0)
    assert nearest_irradiance(empty(), at((0.5, 0.4, 0.0)), 5, *scratch) == (0.0, 0.0, 0.0)
    for far in (1e30, -1e30, 1e300):
        query = at((far, far, far))
        assert estimate_irradiance(scene, photons, query, SCRATCH) == (0.0, 0.0, 0.0)
        assert nearest_irradiance(photons, query, 5, *scratch).x < 1e-50


@pytest.mark.parametrize("radius", [1e-9, 1e-3, 1.0, 1e9])
def test_grid_holds_every_photon_once(radius):
    """Whatever the radius, `start` partitions the photons, and the grid stays as small as promised."""
    rng = np.random.default_rng(10)
    position = rng.normal(size=(300, 3)) * (1.0, 1e3, 1e-3)
    photons = build(position, position, position, np.arange(300, dtype=np.int32), radius)
    assert sorted(photons.face.tolist()) == list(range(300))
    np.testing.assert_array_equal(photons.position.T, position[photons.face])
    assert photons.start[0] == 0
    assert photons.start[-1] == 300
    assert (np.diff(photons.start) >= 0).all()
    assert len(photons.start) == photons.nx * photons.ny * photons.nz + 1 <= 8 * 300 + 65
    assert photons.cell >= radius


def test_order_of_photons_changes_nothing_but_rounding():
    """A permuted map estimates the same to 1e-12: no photon is lost or counted twice."""
    rng = np.random.default_rng(11)
    xy = rng.uniform(size=(500, 2))
    power = rng.uniform(size=500)
    scene = arrays(unit_plate())
    shuffled = rng.permutation(500)
    one, other = on_plate(xy, power, 0.1), on_plate(xy[shuffled], power[shuffled], 0.1)
    for q in rng.uniform(size=(20, 2)):
        a = estimate_irradiance(scene, one, at((*q, 0.0)), SCRATCH)
        np.testing.assert_allclose(estimate_irradiance(scene, other, at((*q, 0.0)), SCRATCH), a, rtol=1e-12)


def test_progressive_radius_is_the_product():
    """r²_i = r²_0 prod_{j=1..i} (j + 2/3) / (j + 1), which falls as i^(-1/3)."""
    radii = np.array([progressive_radius(0.3, i) for i in range(400)])
    factors = [(j + 2 / 3) / (j + 1) for j in range(1, 400)]
    np.testing.assert_allclose(radii**2, 0.09 * np.cumprod([1.0, *factors]), rtol=1e-12)
    assert np.log(radii[399] / radii[199]) * 2 / np.log(2) == pytest.approx(-1 / 3, abs=0.003)


# Emission.


def emitted(
    scene: Scene,
    index: int,
    count: int,
    *,
    first_hits: bool,
    threads: int = 1,
    survival: float = 0.0,
    weighted: bool = True,
    full: bool = False,
) -> photon_map.PhotonMap:
    with ThreadPoolExecutor(threads) as pool:
        return emit(
            from_scene(scene),
            root(1, 0),
            index,
            count=count,
            radius=0.2,
            shape="simpson",
            rule=Scattering(survival, weighted, full, independent=False, aimed=False),
            first_hits=first_hits,
            pool=pool,
            scratch=new_scratch,
        )


@pytest.mark.slow
def test_bytes_of_a_map():
    """Three vectors and a face a photon, and the cells."""
    photons = emitted(closed_box(), 0, 50, first_hits=True)
    assert photon_map.bytes_of(photons) == len(photons.face) * (9 * 8 + 4) + 8 * len(photons.start)


def test_threads_change_no_bit(compiled):
    """The map of 1, 2 and 3 threads, over several chunks: equal bytes."""
    count = 10_000 if compiled else 200
    one, two, three = (emitted(closed_box(), 0, count, first_hits=True, threads=n) for n in (1, 2, 3))
    for field in ("position", "direction", "power", "face", "start"):
        assert getattr(one, field).tobytes() == getattr(two, field).tobytes() == getattr(three, field).tobytes()


def landed_flux(scene: Scene, compiled: bool, **options) -> tuple[float, float]:
    """Mean over passes of the green flux of a map, and its standard error; all photons unless said otherwise."""
    passes, count = (40, 500) if compiled else (20, 10)
    options = {"first_hits": True} | options
    flux = [emitted(scene, i, count, **options).power[1].sum() for i in range(passes)]
    return float(np.mean(flux)), float(np.std(flux, ddof=1) / np.sqrt(passes))


@pytest.mark.slow
@pytest.mark.parametrize("albedo", [0.2, 0.5, 0.9])
def test_flux_in_a_closed_box(albedo, compiled):
    """4 pi I / (1 - rho) lands in all, 4 pi I rho / (1 - rho) without first hits: roulette with 1/p keeps the mean."""
    scene = closed_box(albedo=albedo, intensity=2.0)
    for first_hits, expected in ((True, 8 * np.pi / (1 - albedo)), (False, 8 * np.pi * albedo / (1 - albedo))):
        mean, error = landed_flux(scene, compiled, first_hits=first_hits)
        assert abs(mean - expected) < 4.5 * error
        assert error < (0.05 if compiled else 0.3) * expected


@pytest.mark.slow
@pytest.mark.parametrize("survival", [0.2, 0.5, 0.9, 1.0])
def test_survival_leaves_the_mean_of_weighted_photons(survival, compiled):
    """Albedo .4: 4 pi I / (1 - .4) lands whatever P; 1 is cut to 0.99, so that photons end."""
    mean, error = landed_flux(closed_box(albedo=0.4), compiled, survival=survival)
    expected = 4 * np.pi / 0.6
    assert abs(mean - expected) < 4.5 * error
    assert error < (0.05 if compiled else 0.3) * expected


@pytest.mark.slow
@pytest.mark.parametrize("survival", [0.2, 0.5, 0.9])
def test_unweighted_photons_scatter_with_the_survival_probability(survival, compiled):
    """Colours (.4, .6, .1) of which none matters: each channel lands 4 pi I / (1 - P), its own albedo never."""
    scene = closed_box()
    box = attrs.evolve(scene.objects[0], material=Material((0.4, 0.6, 0.1)))
    scene = attrs.evolve(scene, objects=(box,))
    mean, error = landed_flux(scene, compiled, survival=survival, weighted=False)
    assert abs(mean - 4 * np.pi / (1 - survival)) < 4.5 * error
    assert error < (0.05 if compiled else 0.3) * mean
    power = emitted(scene, 0, 200, first_hits=True, survival=survival, weighted=False).power
    assert np.ptp(power) < 1e-12 * power.max()
    # None given: P is the largest channel, .6.
    mean, error = landed_flux(scene, compiled, weighted=False)
    assert abs(mean - 4 * np.pi / 0.4) < 4.5 * error


@pytest.mark.slow
@pytest.mark.parametrize("survival", [0.0, 0.8, 0.95])
def test_flux_of_fully_scattered_photons(survival, compiled):
    """Walls of diffuse albedo rho (1 - g) and a lobe g F that is a mirror of F = 1: 4 pi I / (1 - rho (1 - g) - g).

    At alpha = 1e-4 and F0 = 1 the lobe loses 1e-4 of the light, which G1 takes. Diffuse photons alone: no g.
    """
    scene = closed_box(albedo=0.5)
    material = Material((0.5, 0.5, 0.5), gloss=0.6, roughness=1e-4, f0=(1.0, 1.0, 1.0))
    scene = attrs.evolve(scene, objects=(attrs.evolve(scene.objects[0], material=material),))
    mean, error = landed_flux(scene, compiled, survival=survival, full=True)
    expected = 4 * np.pi / (1 - 0.5 * 0.4 - 0.6)
    assert abs(mean - expected) < 4.5 * error + 1e-3 * expected
    assert error < (0.1 if compiled else 0.4) * expected
    mean, error = landed_flux(scene, compiled, survival=survival)
    assert abs(mean - 4 * np.pi / 0.8) < 4.5 * error


def test_photons_are_kept_where_they_are_seen():
    """A mirror (gloss 1) has no diffuse weight and keeps none; by full scattering what it throws lands elsewhere."""
    floor = unit_plate()
    mirror = attrs.evolve(
        plate("mirror", (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)),
        material=Material(gloss=1.0, roughness=0.1, f0=(1.0, 1.0, 1.0)),
    )
    scene = Scene(
        "mirror",
        Camera((0.0, -3.0, 1.0), (0.0, 0.0, 0.0)),
        (floor, mirror),
        lights=(PointLight((0.5, 0.5, 0.5), (1.0, 1.0, 1.0)),),
    )
    assert set(emitted(scene, 0, 300, first_hits=True, full=True).face) <= {0, 1}
    assert len(emitted(scene, 0, 300, first_hits=False, full=True).face) > 0
    assert len(emitted(scene, 0, 300, first_hits=False).face) == 0


def test_flux_of_lights_of_unequal_power(compiled):
    """A point light and a lamp: every first hit carries (sum of powers) / count, whichever light it came from.

    Power 4 pi I for the point, pi A L for the lamp, which emits from its front only; the walls are white.
    """
    box = closed_box(albedo=0.8)
    lamp = plate("lamp", (-0.3, -0.2, 0.99), (0.0, 0.4, 0.0), (0.6, 0.0, 0.0))
    scene = Scene(
        "two lights",
        box.camera,
        (*box.objects, Object("lamp", lamp.mesh, emission=(20.0, 20.0, 20.0))),
        lights=(PointLight((0.3, -0.2, 0.4), (1.0, 1.0, 1.0)),),
    )
    count = 2000 if compiled else 100
    photons = emitted(scene, 0, count, first_hits=True)
    area = 0.6 * 0.4
    assert photons.power.max() == pytest.approx((4 * np.pi + np.pi * area * 20) / count, rel=1e-5)
    assert photons.power.min() == pytest.approx(photons.power.max(), rel=1e-12)


def test_photons_lie_on_their_faces_and_point_back():
    """Positions by barycentrics are in the plane of the face to 1e-15; directions are unit and above the surface."""
    scene = unit_sphere()
    photons = emitted(scene, 0, 300, first_hits=True)
    g = from_scene(scene).geometry
    offset = np.einsum("px,px->p", photons.position.T - g.corners[photons.face, 0], g.normals[photons.face])
    assert np.abs(offset).max() < 4e-16
    np.testing.assert_allclose(np.linalg.norm(photons.direction, axis=0), 1, rtol=1e-12)
    assert (np.einsum("xp,px->p", photons.direction, g.normals[photons.face]) > 0).all()
