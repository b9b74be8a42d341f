"""Rays and triangles: brute force, watertightness, ties, degenerate input, scales.

Rationale: a ray that slips between two triangles, or hits the face that it leaves, is a bias of a few pixels that no
mean shows. The expectation is a float64 test of all pairs in NumPy by another algorithm (Moeller and Trumbore), or
the fact that a closed mesh has no hole.
"""

import math

import numpy as np
import pytest
import trimesh

from termwise.renderer.geometry import bvh, traverse
from termwise.renderer.geometry.bvh import STACK_SIZE
from termwise.renderer.geometry.intersect import FaceRange, Hit, intersect_triangle, make_ray
from termwise.renderer.geometry.rays import any_hit, closest_hit
from termwise.renderer.vector import Vec3


class Soup:
    """Triangles with their tree: `closest` and `any` for arrays of numbers; both descents must agree to the bit."""

    def __init__(self, corners: np.ndarray) -> None:
        self.corners = np.ascontiguousarray(corners, np.float64).reshape(-1, 3, 3)
        self.tree = bvh.build(self.corners)
        self.stack = np.empty(STACK_SIZE, np.int32)

    def closest(self, origin, direction, far: float = math.inf, ignore: int = -1) -> Hit:
        ray = make_ray(Vec3(*map(float, origin)), Vec3(*map(float, direction)))
        passed = FaceRange(ignore, ignore + 1)
        hit = closest_hit(self.corners, self.tree, ray, far, passed, self.stack)
        assert hit == traverse.closest_hit(self.corners, self.tree, ray, far, passed, self.stack)
        return hit

    def any(self, origin, direction, far: float = math.inf, ignore: int = -1, target: int = -1) -> bool:
        ray = make_ray(Vec3(*map(float, origin)), Vec3(*map(float, direction)))
        passed = FaceRange(ignore, ignore + 1)
        found = any_hit(self.corners, self.tree, ray, far, passed, target, self.stack)
        assert found == traverse.any_hit(self.corners, self.tree, ray, far, passed, target, self.stack)
        return found


def brute_force(corners: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> tuple[float, int, float]:
    """Distance and index of the nearest triangle by Moeller-Trumbore over all, and how near a ray came to an edge.

    The margin is the smallest barycentric coordinate (in magnitude) of any triangle whose plane is hit.
    """
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(direction, e2)
    det = (e1 * p).sum(axis=1)
    with np.errstate(all="ignore"):
        s = origin - corners[:, 0]
        u = (s * p).sum(axis=1) / det
        q = np.cross(s, e1)
        v = (q @ direction) / det
        t = (e2 * q).sum(axis=1) / det
    inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    margin = np.nanmin(np.abs(np.stack([u, v, 1 - u - v])), initial=np.inf)
    t = np.where(inside, t, np.inf)
    best = int(np.argmin(t)) if len(t) else -1
    return (float(t[best]), best, margin) if best >= 0 and np.isfinite(t[best]) else (np.inf, -1, margin)


def random_soup(rng: np.random.Generator, faces: int, size: float = 0.4) -> np.ndarray:
    return rng.uniform(-1, 1, (faces, 1, 3)) + rng.normal(scale=size, size=(faces, 3, 3))


@pytest.mark.slow
@pytest.mark.parametrize("faces", [1, 3, 5, 60, 800])
def test_closest_hit_against_brute_force(faces, compiled):
    """Random triangles and rays: same face, t to 1e-9 relative, for all rays not within 1e-9 of an edge."""
    rng = np.random.default_rng(faces)
    soup = Soup(random_soup(rng, faces, 0.4 if faces < 100 else 0.1))
    compared = 0
    for origin, direction in rng.normal(size=(400 if compiled else 40, 2, 3)):
        t, face, margin = brute_force(soup.corners, origin, direction)
        if margin < 1e-9:
            continue
        hit = soup.closest(origin, direction)
        assert hit.face == face
        assert soup.any(origin, direction) == (face >= 0)
        if face >= 0:
            assert hit.t == pytest.approx(t, rel=1e-9)
            point = np.array([1 - hit.b1 - hit.b2, hit.b1, hit.b2]) @ soup.corners[face]
            np.testing.assert_allclose(point, origin + t * direction, rtol=1e-8, atol=1e-8)
            assert soup.any(origin, direction, far=1.001 * t)
            assert not soup.any(origin, direction, far=0.999 * t)
            assert soup.closest(origin, direction, far=0.999 * t).face == -1
        compared += 1
    assert compared > 0.9 * (400 if compiled else 40)


def test_ignored_and_target_faces_are_passed(compiled):
    """Hits on a ray in order, by ignoring the face found: the second of brute force; `target` likewise for any hit."""
    rng = np.random.default_rng(1)
    corners = random_soup(rng, 60, 1.0)
    soup = Soup(corners)
    seen = 0
    for origin, direction in rng.normal(size=(100 if compiled else 25, 2, 3)):
        _, face, _ = brute_force(corners, origin, direction)
        if face < 0:
            continue
        without = corners.copy()
        without[face] += 1e6
        t, second, _ = brute_force(without, origin, direction)
        assert soup.closest(origin, direction, ignore=face).face == second
        assert soup.any(origin, direction, far=1.0001 * t if second >= 0 else np.inf, target=face) == (second >= 0)
        assert soup.any(origin, direction, ignore=face, target=max(second, 0), far=t) is False
        seen += second >= 0
    assert seen > 5


def closed_meshes(compiled: bool) -> list[trimesh.Trimesh]:
    knot = trimesh.creation.torus(1.0, 0.4, major_sections=24, minor_sections=12)
    return [trimesh.creation.icosphere(subdivisions=3 if compiled else 1), trimesh.creation.box(), knot]


@pytest.mark.slow
@pytest.mark.parametrize("offset", [0.0, 10.0, 1e4])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_closed_meshes_have_no_hole(scale, offset, compiled):
    """Rays from inside a closed mesh through points on its edges and through its vertices: not one escapes.

    The set-up rounds the scaled and moved vertices to float64, so that edges are those of the stored mesh.
    """
    rng = np.random.default_rng(5)
    for mesh in closed_meshes(compiled):
        vertices = scale * (mesh.vertices + offset)
        soup = Soup(vertices[mesh.faces])
        # Inside the tube of the torus, inside the others.
        inside = np.array([1.0, 0.0, 0.0]) if len(mesh.faces) == 576 else np.array([0.05, -0.03, 0.02])
        origin = scale * (inside + offset)
        edges = vertices[mesh.edges_unique]
        weight = rng.uniform(size=(len(edges), 1))
        on_edge = weight * edges[:, 0] + (1 - weight) * edges[:, 1]
        for target in np.concatenate([on_edge, edges.mean(axis=1), vertices]):
            direction = target - origin
            assert soup.closest(origin, direction).face >= 0
            assert soup.any(origin, direction)


def test_no_self_hit_from_any_face(compiled):
    """From points on a convex mesh, outwards, with the own face ignored: nothing is hit, whatever the scale.

    Points lie on faces by barycentrics and leave along directions at most 89.9 degrees from the normal.
    """
    rng = np.random.default_rng(6)
    mesh = trimesh.creation.icosphere(subdivisions=2)
    for scale in (1e-6, 1.0, 1e6):
        corners = scale * mesh.vertices[mesh.faces]
        soup = Soup(corners)
        for face in rng.integers(0, len(corners), 300 if compiled else 40):
            b = rng.dirichlet((1, 1, 1))
            normal = mesh.face_normals[face]
            tangent = np.cross(normal, rng.normal(size=3))
            direction = tangent / np.linalg.norm(tangent) + 2e-3 * normal
            assert soup.closest(b @ corners[face], direction, ignore=int(face)).face == -1


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("zero", [0.0, -0.0])
def test_axis_aligned_rays_in_slab_planes(axis, sign, zero, compiled):
    """Origins in the planes of boxes of the tree, directions along an axis with +0 and -0 elsewhere: all hit.

    A grid of unit squares at height 0; every ray starts over a grid line or a grid point, where boxes end.
    """
    n = 8 if compiled else 5
    u, v = (axis + 1) % 3, (axis + 2) % 3
    corners = []
    for i in range(n):
        for j in range(n):
            square = np.zeros((4, 3))
            square[:, u] = [i, i + 1, i + 1, i]
            square[:, v] = [j, j, j + 1, j + 1]
            corners += [square[[0, 1, 2]], square[[0, 2, 3]]]
    soup = Soup(np.array(corners))
    direction = np.full(3, zero)
    direction[axis] = -sign
    for i in np.arange(0, n + 0.1, 0.5):
        for j in np.arange(0, n + 0.1, 0.5):
            origin = np.zeros(3)
            origin[[u, v]] = i, j
            origin[axis] = sign * 2.5
            hit = soup.closest(origin, direction)
            assert hit.face >= 0, (i, j)
            assert hit.t == 2.5
            assert soup.any(origin, direction)


def test_ties_go_to_the_lower_face(compiled):
    """Every triangle is present three times, in random order: of equal distances the lowest index is hit."""
    rng = np.random.default_rng(7)
    single = random_soup(rng, 40, 0.8)
    which = rng.permutation(np.repeat(np.arange(40), 3))
    soup = Soup(single[which])
    for origin, direction in rng.normal(size=(300 if compiled else 40, 2, 3)):
        hit = soup.closest(origin, direction)
        if hit.face >= 0:
            assert hit.face == np.flatnonzero(which == which[hit.face]).min()


def test_ties_of_stacked_squares():
    """Axis-aligned duplicates, whose boxes are flat: the lower index wins for rays from any side."""
    rng = np.random.default_rng(8)
    square = np.array([[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]], float)
    soup = Soup(np.concatenate([square] * 40))
    for _ in range(200):
        target = np.array([*rng.uniform(0.01, 0.99, 2), 0.0])
        origin = rng.normal(size=3)
        hit = soup.closest(origin, target - origin)
        assert hit.face == (0 if target[0] > target[1] else 1)


def test_identical_triangles():
    """Ten thousand equal centroids: the tree is built, stays shallow enough for the stack, and face 0 is hit."""
    count = 10_000
    soup = Soup(np.tile(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float), (count, 1, 1)))
    assert soup.closest((0.2, 0.2, 1), (0, 0, -1)).face == 0
    assert soup.any((0.2, 0.2, 1), (0, 0, -1))
    assert soup.closest((0.9, 0.9, 1), (0, 0, -1)).face == -1


def depth(tree: bvh.Tree) -> int:
    """Levels of a tree, by walking it."""
    deepest, waiting = 0, [(0, 1)]
    while waiting:
        node, level = waiting.pop()
        deepest = max(deepest, level)
        if tree.count[node] == 0:
            waiting += [(node + 1, level + 1), (int(tree.right[node]), level + 1)]
    return deepest


@pytest.mark.parametrize("kind", ["random", "geometric", "identical"])
def test_tree_holds_every_face_once_inside_its_boxes(kind, compiled):
    """Leaves partition the faces, children lie inside parents, and no path is deeper than the stack.

    Sizes that grow geometrically make the surface area heuristic split one face off at a time.
    """
    rng = np.random.default_rng(9)
    count = 500 if compiled else 80
    soup = random_soup(rng, count, 0.05)
    if kind == "geometric":
        soup = soup * 2.0 ** np.linspace(-200, 200, count)[:, None, None]
    elif kind == "identical":
        soup = np.repeat(soup[:1], count, axis=0)
    tree = bvh.build(soup)
    leaves = [(int(tree.first[n]), int(tree.count[n])) for n in range(len(tree.count)) if tree.count[n] > 0]
    covered = np.concatenate([tree.order[first : first + size] for first, size in leaves])
    assert sorted(covered.tolist()) == list(range(count))
    assert max(size for _, size in leaves) <= bvh.LEAF_SIZE
    assert depth(tree) <= bvh.MAX_DEPTH
    for node in range(len(tree.count)):
        low, high = tree.bounds[node]
        if tree.count[node] == 0:
            for child in (node + 1, int(tree.right[node])):
                assert (tree.bounds[child, 0] >= low).all()
                assert (tree.bounds[child, 1] <= high).all()
        else:
            inside = soup[tree.order[tree.first[node] : tree.first[node] + tree.count[node]]]
            assert (inside >= low).all()
            assert (inside <= high).all()


def test_empty_scene():
    """No triangle, no node, no hit."""
    soup = Soup(np.zeros((0, 3, 3)))
    assert len(soup.tree.count) == 0
    assert soup.closest((0, 0, 0), (0, 0, 1)) == (math.inf, -1, 0.0, 0.0)
    assert not soup.any((0, 0, 0), (0, 0, 1))


def test_faces_without_area_are_never_hit():
    """Points and needles among real triangles: the real one behind is hit, and alone they are not."""
    point = np.zeros((3, 3))
    needle = np.array([[-1, 0, 0.5], [1, 0, 0.5], [0, 0, 0.5]], float)
    real = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], float)
    soup = Soup(np.array([point, needle, real, needle]))
    assert soup.closest((0, 0, 1), (0, 0, -1)).face == 2
    assert soup.closest((0, 0, 1), (0, 0, -1)).t == 1.0
    assert Soup(np.array([point, needle])).closest((0, 0, 1), (0, 0, -1)).face == -1


def test_both_sides_are_hit_and_nothing_behind():
    """From the front and from the back at t = 1; a triangle behind the origin, or in its plane, is not hit."""
    soup = Soup(np.array([[[-1, -1, 0], [1, -1, 0], [0, 1, 0]]], float))
    assert soup.closest((0, 0, 1), (0, 0, -1)).t == 1.0
    assert soup.closest((0, 0, -1), (0, 0, 1)).t == 1.0
    assert soup.closest((0, 0, 1), (0, 0, 1)).face == -1
    assert soup.closest((0, 0, 0), (0, 0, 1)).face == -1
    assert soup.closest((-5, 0, 0), (1, 0, 0)).face == -1
    assert soup.closest((0, 0, 1), (0, 0, -4)).t == 0.25


@pytest.mark.parametrize("gap", [1e-3, 1e-9, 1e-15])
def test_no_epsilon_hides_what_is_near(gap):
    """A triangle at any distance in front of the origin is hit: rays skip faces by index, not by distance."""
    soup = Soup(np.array([[[-1, -1, 0], [1, -1, 0], [0, 1, 0]]], float))
    assert soup.closest((0, 0, gap), (0, 0, -1)).t == pytest.approx(gap, rel=1e-12)
    assert soup.any((0, 0, gap), (0, 0, -1))


def test_far_end_counts_for_the_closest_but_not_for_any():
    """closest: 0 < t <= far; any: 0 < t < far, so that the light itself at far = 1 casts no shadow."""
    soup = Soup(np.array([[[-1, -1, 0], [1, -1, 0], [0, 1, 0]]], float))
    assert soup.closest((0, 0, 1), (0, 0, -1), far=1.0).face == 0
    assert not soup.any((0, 0, 1), (0, 0, -1), far=1.0)


def test_shared_edge_belongs_to_at_least_one_side(compiled):
    """Rays exactly through the shared edge of two random triangles hit one of them, for 64 orders of corners."""
    rng = np.random.default_rng(10)
    for _ in range(300 if compiled else 60):
        a, b, c, d, origin = rng.normal(size=(5, 3))
        # c and d on opposite sides of the edge ab as seen from the origin.
        normal = np.cross(a - origin, b - origin)
        c = c if normal @ (c - origin) > 0 else 2 * origin - c
        d = d if normal @ (d - origin) < 0 else 2 * origin - d
        w = rng.uniform(0.05, 0.95)
        direction = w * a + (1 - w) * b - origin
        ray = make_ray(Vec3(*origin.tolist()), Vec3(*direction.tolist()))
        corners = np.array([rng.permutation([a, b, c]), rng.permutation([a, b, d])])
        hits = [intersect_triangle(ray, corners, face, math.inf).face for face in (0, 1)]
        assert max(hits) >= 0


def test_needles_that_rays_are_aimed_at_are_never_hit():
    """Three points of a line, exact ones: rounding in the shear gave some of these rays a hit there."""
    rng = np.random.default_rng(10)
    needles = rng.integers(-8, 8, (50, 1, 3)) / 8 + np.arange(3)[:, None] * rng.integers(1, 8, (50, 1, 3)) / 8
    soup = Soup(needles)
    for face in range(50):
        origin = rng.normal(size=3)
        direction = rng.dirichlet((1, 1, 1)) @ needles[face] - origin
        assert soup.closest(origin, direction).face == -1
        assert not soup.any(origin, direction)
