"""The mass of a kernel on triangles: symmetry, marginals, quadrature and brute force, for each of the three kernels.

Rationale: the density is divided by it, so an error in it is a bias in every estimate near an edge.
"""

import math

import numpy as np
import pytest
import trimesh
from scipy import integrate

from termwise.renderer.arrays import SceneArrays, from_scene
from termwise.renderer.geometry.bvh import STACK_SIZE
from termwise.renderer.kernel_mass import EXPONENTS, MAX_PLANE_DISTANCE, MIN_NORMAL_COSINE, face_mass, kernel_mass
from termwise.renderer.vector import Vec3
from termwise.scenes.analytic import plate, sphere_inside
from termwise.scenes.model import Camera, Material, Mesh, Object, Scene

STACK = np.empty(STACK_SIZE, np.int32)
SHAPES = ("uniform", "epanechnikov", "simpson")
# K(d) pi r² over u = d² / r², as the literature writes each.
PROFILES = {
    "uniform": lambda u: np.ones_like(u),
    "epanechnikov": lambda u: 2 * (1 - u),
    "simpson": lambda u: 3 * (1 - u) ** 2,
}


def profile(shape: str, square: np.ndarray | float, radius: float) -> np.ndarray:
    """K at squared distances."""
    u = np.asarray(square) / radius**2
    return np.where(u < 1, PROFILES[shape](u), 0.0) / (np.pi * radius**2)


def vec(values) -> Vec3:
    return Vec3(*(float(x) for x in values))


def arrays(*objects: Object) -> SceneArrays:
    return from_scene(Scene("mass", Camera((0.0, -3.0, 1.0), (0.0, 0.0, 0.0)), objects))


def unit_plate(name: str = "plate", z: float = 0.0) -> Object:
    """[0, 1]² facing up; face 0 has x >= y, face 1 x <= y."""
    return plate(name, (0.0, 0.0, z), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))


def mass_of(corners: np.ndarray, x: np.ndarray, radius: float, shape: str) -> float:
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    return face_mass(corners[None], 0, vec(normal / np.linalg.norm(normal)), vec(x), radius, EXPONENTS[shape])


def by_quadrature(corners: np.ndarray, x: np.ndarray, radius: float, shape: str) -> float:
    """∫ K dA in polar coordinates around the foot of x, radially in closed form: SciPy's adaptive rule over the angle.

    The antiderivative over the radius is that of `1 - (1 - d²/r²)^n`, n = 1, 2, 3, beyond the height of x.
    """
    a, b, c = corners
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal)
    height = float((a - x) @ normal)
    s = (b - a) / np.linalg.norm(b - a)
    t = np.cross(normal, s)
    flat = np.array([[(p - x) @ s, (p - x) @ t] for p in corners])
    n = SHAPES.index(shape) + 1

    def cumulative(d: float) -> float:
        """∫ K ρ dρ from 0 to d in the plane, at most up to the disc's rim."""
        top = 1 - height**2 / radius**2
        rest = max(0.0, 1 - (height**2 + d * d) / radius**2)
        return (max(0.0, top) ** n - rest**n) / (2 * np.pi)

    def along(angle: float) -> float:
        direction = np.array([math.cos(angle), math.sin(angle)])
        crossings = []
        for p, q in zip(flat, np.roll(flat, -1, axis=0), strict=True):
            edge = q - p
            down = direction[0] * edge[1] - direction[1] * edge[0]
            if down != 0:
                distance = (p[0] * edge[1] - p[1] * edge[0]) / down
                share = (p[0] * direction[1] - p[1] * direction[0]) / down
                if distance > 0 and 0 <= share < 1:
                    crossings.append(distance)
        crossings.sort()
        if len(crossings) % 2:
            crossings = [0.0, *crossings]
        return sum(cumulative(far) - cumulative(near) for near, far in zip(*[iter(crossings)] * 2, strict=True))

    # The integrand has kinks where a ray passes a corner or where an edge crosses the rim.
    breaks = [math.atan2(y, x) % (2 * np.pi) for x, y in flat]
    disc = radius**2 - height**2
    for p, q in zip(flat, np.roll(flat, -1, axis=0), strict=True):
        edge = q - p
        roots = np.roots([edge @ edge, 2 * p @ edge, p @ p - disc])
        for root in roots[np.isreal(roots)].real:
            if 0 < root < 1:
                y = p + root * edge
                breaks.append(math.atan2(y[1], y[0]) % (2 * np.pi))
    cuts = np.unique([0.0, *breaks, 2 * np.pi])
    pieces = [
        integrate.quad(along, low, high, epsabs=1e-12, limit=200)[0] for low, high in zip(cuts, cuts[1:], strict=False)
    ]
    return float(sum(pieces))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(
    ("x", "y", "mass"),
    [(0.5, 0.4, 1.0), (0.5, 0.0, 0.5), (1.0, 0.5, 0.5), (0.0, 0.0, 0.25), (1.0, 0.0, 0.25), (0.3, 0.3, 1.0)],
)
def test_inside_at_an_edge_and_in_a_corner(x, y, mass, shape):
    """1, 1/2 and 1/4 by symmetry; (0.3, 0.3) lies on the diagonal that two faces share."""
    scene = arrays(unit_plate())
    found = kernel_mass(scene, 0, Vec3(x, y, 0.0), 0.2, EXPONENTS[shape], STACK)
    assert found == pytest.approx(mass, abs=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_near_an_edge_by_the_kernel_s_marginal(shape):
    """At distance a from an edge: 1/2 + ∫_0^a m(t) dt, m(t) = ∫ K(sqrt(t² + s²)) ds by quadrature."""
    scene = arrays(unit_plate())
    r = 0.2

    def marginal(t: float) -> float:
        half = math.sqrt(r * r - t * t)
        return integrate.quad(lambda s: float(profile(shape, t * t + s * s, r)), -half, half, epsrel=1e-11)[0]

    for a in (0.02, 0.1, 0.17):
        expected = 0.5 + integrate.quad(marginal, 0, a, epsrel=1e-11)[0]
        found = kernel_mass(scene, 0, Vec3(0.5, a, 0.0), r, EXPONENTS[shape], STACK)
        assert found == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("shape", SHAPES)
def test_of_a_face_against_quadrature(shape, compiled):
    """Random triangles, x in and off their planes, inside, outside, on an edge and at a corner: to 1e-9."""
    rng = np.random.default_rng(4)
    positive = whole = 0
    for _ in range(40 if compiled else 8):
        corners = rng.normal(size=(3, 3))
        weights = rng.choice(np.array([[1, 1, 1], [1, 0, 0], [0.5, 0.5, 0], [2, 2, -3]]), axis=0) + 0.0
        if weights.all():
            weights += rng.uniform(size=3)
        x = weights / weights.sum() @ corners + rng.choice([0.0, 0.4]) * rng.normal(size=3)
        for r in (0.7, 2.0, 6.0):
            expected = by_quadrature(corners, x, r, shape)
            assert mass_of(corners, x, r, shape) == pytest.approx(expected, abs=1e-9)
            positive += expected > 1e-3
            whole += bool((np.linalg.norm(corners - x, axis=1) < r).all())
    assert positive > whole > 5


@pytest.mark.parametrize("shape", SHAPES)
def test_of_tiny_and_of_huge_faces(shape):
    """A face of size 1e-9 holds area K(d) to 1e-8 relative; one of size 1e9 around x holds 1, and none beside it."""
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    for x in ((0.0, 0.0, 0.0), (0.1, -0.2, 0.0), (0.1, 0.2, 0.3)):
        expected = 0.5e-18 * profile(shape, np.square(x).sum(), 0.5)
        assert mass_of(1e-9 * corners, np.array(x), 0.5, shape) == pytest.approx(expected, rel=1e-8)
    huge = 1e9 * (corners - [0.25, 0.25, 0.0])
    assert mass_of(huge, np.zeros(3), 0.5, shape) == pytest.approx(1.0, abs=1e-12)
    assert mass_of(huge, np.array([-1e9, 0.0, 0.0]), 0.5, shape) == pytest.approx(0.0, abs=1e-12)
    # At height h the plane holds 1 - h² / r² to the power p + 1.
    height = 1 - 0.3**2 / 0.5**2
    assert mass_of(huge, np.array([0.0, 0.0, 0.3]), 0.5, shape) == pytest.approx(
        height ** (SHAPES.index(shape) + 1), abs=1e-12
    )


@pytest.mark.parametrize("shape", SHAPES)
def test_a_face_is_the_sum_of_its_parts(shape):
    """A triangle cut into 64, some of them within the radius and some across the rim: the sum is that of the whole."""
    rng = np.random.default_rng(6)
    for _ in range(5):
        corners = rng.normal(size=(3, 3))
        x = rng.dirichlet((1, 1, 1)) @ corners + 0.1 * rng.normal(size=3)
        vertices, faces = corners, np.array([[0, 1, 2]])
        for _ in range(3):
            vertices, faces = trimesh.remesh.subdivide(vertices, faces)[:2]
        parts = sum(mass_of(vertices[face], x, 0.6, shape) for face in faces)
        assert parts == pytest.approx(mass_of(corners, x, 0.6, shape), abs=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_of_many_faces_by_monte_carlo(shape):
    """A tessellated sphere: the sum over the faces that count at x against uniform points on them, 4.5 sigma.

    Their normals lie within acos(0.1) of that of x and their planes within r / 10 of x.
    """
    scene = arrays(sphere_inside("sphere", subdivisions=2, material=Material()))
    g = scene.geometry
    rng = np.random.default_rng(5)
    area = 0.5 * np.linalg.norm(np.cross(g.corners[:, 1] - g.corners[:, 0], g.corners[:, 2] - g.corners[:, 0]), axis=1)
    face = rng.choice(len(area), 200_000, p=area / area.sum())
    points = np.einsum("pc,pcx->px", rng.dirichlet((1, 1, 1), len(face)), g.corners[face])
    for query in (0, 77, 200):
        x = g.corners[query].mean(axis=0)
        r = 0.9
        counted = g.normals[face] @ g.normals[query] > MIN_NORMAL_COSINE
        near = np.abs(np.einsum("px,px->p", points - x, g.normals[face])) < MAX_PLANE_DISTANCE * r
        assert 0 < (counted & near).sum() < counted.sum()
        counted &= near
        value = area.sum() * np.where(counted, profile(shape, ((points - x) ** 2).sum(axis=1), r), 0.0)
        error = value.std() / np.sqrt(len(value))
        found = kernel_mass(scene, query, vec(x), r, EXPONENTS[shape], STACK)
        assert abs(found - value.mean()) < 4.5 * error
        assert error < 0.02 * found


@pytest.mark.parametrize("shape", SHAPES)
def test_on_a_fold_is_whole(shape):
    """Two half planes of one object that meet at 60 degrees: on the fold each carries a half, and all counts."""
    c, s = 0.5, math.sqrt(0.75)
    vertices = [[-1, 0, 0], [1, 0, 0], [1, -1, 0], [-1, -1, 0], [1, c, s], [-1, c, s]]
    faces = [[0, 2, 1], [0, 3, 2], [0, 1, 4], [0, 4, 5]]
    scene = arrays(Object("fold", Mesh.from_arrays(vertices, faces)))
    found = kernel_mass(scene, 0, Vec3(0.1, 0.0, 0.0), 0.3, EXPONENTS[shape], STACK)
    # The rounding of the mesh to float32 tilts the second plane by 1e-8.
    assert found == pytest.approx(1.0, abs=1e-7)
