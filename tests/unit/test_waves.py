"""The tree of 8 children, and waves of rays, against the binary tree and against all faces: the same bits on every ray.

Rationale: the fast descent tests boxes in float32 and eight triangles at once; one ray in a million that meets another
face is a fault that no image shows. Rays are aimed where descents fail: at vertices and edges, along axes with zeros
of both signs, inside the planes of boxes, from far away, at meshes of any scale and place. Only faces smaller than the
rounding of their distance from the ray's origin are left out: their test is noise, whatever the tree. The oracle is a
tree of a single leaf, which is a test of all faces by `intersect_triangle`, and the binary tree where faces are many.
"""

import itertools

import numpy as np
import pytest
import trimesh

from termwise.renderer.geometry import bvh, bvh8, simd, traverse
from termwise.renderer.geometry.bvh import STACK_SIZE, Tree
from termwise.renderer.geometry.intersect import NOTHING, FaceRange, make_ray
from termwise.renderer.geometry.polygons import DOUBT, HIT, MISS, MOST, any_hit_among_polygons
from termwise.renderer.geometry.rays import (
    any_hit,
    any_hits,
    any_hits_of_wave,
    closest_hit,
    closest_hits,
    closest_hits_of_wave,
    reference_hits,
)
from termwise.renderer.geometry.wave import SIZE, Wave, new_wave, put_ray
from termwise.renderer.jit import kernel
from termwise.renderer.vector import Vec3, vec3

pytestmark = pytest.mark.skipif(not simd.available(), reason="the processor lacks the vectors, or nothing is compiled")

Hits = tuple[np.ndarray, np.ndarray, np.ndarray]


def fast(corners: np.ndarray, tree: Tree, origins: np.ndarray, directions: np.ndarray, far: float) -> Hits:
    """By streams alone, and with packets before them; both must be equal."""
    found = []
    for coherent in (False, True):
        t, face, hit = (np.empty(len(origins)), np.empty(len(origins), np.int32), np.empty(len(origins), np.bool_))
        closest_hits(corners, tree, origins, directions, far, t, face, new_wave(), coherent)
        any_hits(corners, tree, origins, directions, far, hit, new_wave(), coherent)
        found.append((t, face, hit))
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)
    return found[0]


def reference(corners: np.ndarray, tree: Tree, origins: np.ndarray, directions: np.ndarray, far: float) -> Hits:
    t, face, found = (np.empty(len(origins)), np.empty(len(origins), np.int32), np.empty(len(origins), np.bool_))
    reference_hits(corners, tree, origins, directions, far, t, face, found)
    return t, face, found


def one_leaf(corners: np.ndarray) -> Tree:
    """A tree whose root is a leaf of all faces."""
    bounds = np.stack([corners.min(axis=(0, 1)), corners.max(axis=(0, 1))])[None]
    zero, faces = np.zeros(1, np.int32), np.arange(len(corners), dtype=np.int32)
    return Tree(
        bounds, zero, zero, np.array([len(corners)], np.int32), faces, bvh8.empty(), bvh.build(corners[:0]).polygons
    )


def check(corners: np.ndarray, origins: np.ndarray, directions: np.ndarray, far: float = np.inf) -> Hits:
    """Trace both ways; face, t and any-hit must be equal, to the bit."""
    corners = np.ascontiguousarray(corners, np.float64)
    origins, directions = (np.ascontiguousarray(a, np.float64) for a in (origins, directions))
    tree = bvh.build(corners)
    mine = fast(corners, tree, origins, directions, far)
    # All faces are tested while that is cheap.
    few = len(corners) * len(origins) <= 2e7
    oracle = reference(corners, one_leaf(corners) if few else tree, origins, directions, far)
    for ours, theirs in zip(mine, oracle, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    # The loops trace rays in eights; some of them alone.
    stack = np.empty(STACK_SIZE, np.int32)
    t, face, found = mine
    for i in range(0, len(origins), max(1, len(origins) // 200)):
        ray = make_ray(Vec3(*origins[i].tolist()), Vec3(*directions[i].tolist()))
        hit = closest_hit(corners, tree, ray, far, NOTHING, stack)
        assert (hit.t, hit.face) == (t[i], face[i])
        assert any_hit(corners, tree, ray, far, NOTHING, -1, stack) == found[i]
    return mine


def soup(rng: np.random.Generator, faces: int, size: float) -> np.ndarray:
    return rng.uniform(-1, 1, (faces, 1, 3)) + rng.normal(scale=size, size=(faces, 3, 3))


def grid(n: int) -> np.ndarray:
    """Unit squares at height 0, two triangles each, stacked four times, the lowest twice."""
    i, j = (index.ravel() for index in np.meshgrid(np.arange(n), np.arange(n)))
    corner = np.stack([i, j, 0 * i], axis=1).astype(float)
    low = np.stack([corner, corner + [1, 0, 0], corner + [1, 1, 0]], axis=1)
    high = np.stack([corner, corner + [1, 1, 0], corner + [0, 1, 0]], axis=1)
    layer = np.concatenate([low, high])
    return np.concatenate([layer + [0, 0, 0.25 * k] for k in (0, 1, 2, 3, 0)])


def mesh(name: str) -> np.ndarray:
    for prefix, most in (("a few of ", MOST), ("48 of ", 48)):
        if name.startswith(prefix):
            many = mesh(name.removeprefix(prefix))
            return np.ascontiguousarray(many[:: -(-len(many) // most)])
    rng = np.random.default_rng(2)
    sphere = trimesh.creation.icosphere(subdivisions=2)
    ball = sphere.vertices[sphere.faces]
    box = trimesh.creation.box()
    blocks = [[-1.0, -0.7, -1.5], [0.9, 0.6, -1.5], [0.9, 0.6, -0.5]]  # on the floor, and on another
    flat = soup(rng, 60, 0.5)
    flat[::3, 1] = flat[::3, 0]  # needles
    flat[1::3] = flat[1::3, :1]  # points
    return {
        "one": np.array([[[-1, -1, 0], [1, -1, 0], [0, 1, 0.0]]]),
        "box": box.vertices[box.faces],
        "ball": ball,
        "ball in float32": ball.astype(np.float32).astype(np.float64),
        "soup": soup(rng, 200, 0.2),
        "grid": grid(8),
        "without area": flat,
        "far from the origin": 1e-3 * ball + [1e3, -1e3, 1e3],
        "tiny": 1e-12 * ball + 3e-9,
        "huge": 1e12 * soup(rng, 200, 0.2),
        "geometric": soup(rng, 200, 0.05) * 2.0 ** np.linspace(-15, 15, 200)[:, None, None],
        "many": soup(rng, 20_000, 0.02),
        "room": np.concatenate([4.0 * box.vertices[box.faces], *(box.vertices[box.faces] + x for x in blocks)]),
    }[name]


SPREAD = "soup, without area, far from the origin, tiny, huge, geometric".split(", ")
MESHES = [
    "one",
    "box",
    "ball",
    "ball in float32",
    "grid",
    "many",
    "room",
    *SPREAD,
    *(f"a few of {name}" for name in SPREAD),
]


def points_on(rng: np.random.Generator, corners: np.ndarray, count: int) -> np.ndarray:
    """A quarter each: vertices, middles of edges, points of edges, points inside faces."""
    face, corner = rng.integers(0, len(corners), count), rng.integers(0, 3, count)
    a, b = corners[face, corner], corners[face, (corner + 1) % 3]
    weight = rng.choice([0.0, 0.5, np.nan], count)[:, None]
    weight = np.where(np.isnan(weight), rng.uniform(size=(count, 1)), weight)
    inside = np.einsum("ni,nij->nj", rng.dirichlet((1, 1, 1), count), corners[face])
    return np.where(rng.integers(0, 4, (count, 1)) == 0, inside, (1 - weight) * a + weight * b)


def aimed_rays(kind: str, rng: np.random.Generator, corners: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    centre, extent = 0.5 * low + 0.5 * high, float((high - low).max())
    targets = points_on(rng, corners, count)
    if kind == "of a camera":
        # Neighbours are close, so that they share packets; rows end outside of the mesh.
        side = int(count**0.5)
        x, y = (index.ravel() / side - 0.5 for index in np.meshgrid(np.arange(side), np.arange(side)))
        eye = centre + extent * np.array([0.9, -1.1, 0.7])
        across, up = np.array([1.1, 0.9, 0.0]), np.array([-0.4, 0.5, 1.3])
        return np.tile(eye, (len(x), 1)), centre - eye + extent * (x[:, None] * across + y[:, None] * up)
    if kind == "in beams":
        # 64 at a time, from one point or side by side, at what lies around a face: their packets are not given up.
        middles, origins, directions = corners.mean(axis=1), np.empty((count, 3)), np.ones((count, 3))
        for number in range(count // SIZE):
            middle = middles[rng.integers(len(corners))]
            around = np.argpartition(((middles - middle) ** 2).sum(axis=1), min(12, len(corners) - 1))[:12]
            targets = points_on(rng, corners[around], SIZE)
            way = rng.normal(size=3)
            way *= extent * rng.choice([0.003, 0.1, 1.0, 30.0, 3e3, 1e5]) / np.linalg.norm(way)
            wave = slice(SIZE * number, SIZE * (number + 1))
            origins[wave] = (targets if number % 3 == 0 else middle) + way
            directions[wave] = targets - origins[wave]
        return origins[: count // SIZE * SIZE], directions[: count // SIZE * SIZE]
    if kind == "random":
        return rng.uniform(low - 0.2 * extent, high + 0.2 * extent, (count, 3)), rng.normal(size=(count, 3))
    if kind in ("from a point inside", "from around", "from far"):
        reach = {"from a point inside": 0.05, "from around": 1.5, "from far": 1e3}[kind]
        many = 1 if kind == "from a point inside" else count
        origins = np.broadcast_to(centre + reach * extent * rng.normal(size=(many, 3)), (count, 3))
        return origins, targets - origins
    if kind == "from the surface":
        origins = points_on(rng, corners, count)
        return origins, targets - origins
    zeros = rng.choice([0.0, -0.0], (count, 3))
    rows, axis = np.arange(count), rng.integers(0, 3, count)
    if kind == "in an axis' plane":
        origins = rng.uniform(low - 0.2 * extent, high + 0.2 * extent, (count, 3))
        directions = targets - origins
        directions[rows, axis] = zeros[rows, axis]
        return origins, directions
    sign = rng.choice([-1.0, 1.0], count)
    origins = targets.copy()
    origins[rows, axis] -= sign * extent * rng.choice([0.25, 1.0, 3.3], count)
    zeros[rows, axis] = sign * rng.choice([1.0, 1e-7, extent], count)
    return origins, zeros


KINDS = ["of a camera", "random", "from a point inside", "from around", "from far", "from the surface"]
KINDS += ["in an axis' plane", "along an axis", "in beams"]


@pytest.mark.slow
@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("kind", KINDS)
def test_equal_to_the_last_bit(name, kind):
    """171 meshes and kinds of 25 to 100 thousand rays; t, face and any-hit are those of a test of all faces."""
    corners = mesh(name)
    rng = np.random.default_rng(3)
    origins, directions = aimed_rays(kind, rng, corners, int(np.clip(2e7 / len(corners), 25_000, 100_000)))
    _, face, found = check(corners, origins, directions)
    np.testing.assert_array_equal(found, face >= 0)


@pytest.mark.parametrize("name", ["ball", "soup", "grid", "room", "a few of soup"])
def test_equal_with_a_far_end(name):
    """The far end at, an ulp before and an ulp behind hits: both descents keep the same hits."""
    corners = mesh(name)
    rng = np.random.default_rng(4)
    origins, directions = aimed_rays("from around", rng, corners, 20_000)
    t, _, _ = check(corners, origins, directions)
    for scale in (1 - 2.0**-53, 1.0, 1 + 2.0**-52):
        for far in np.unique(t[np.isfinite(t)])[::500]:
            check(corners, origins[:500], directions[:500], float(far * scale))


@kernel
def leave(
    corners: np.ndarray,
    tree: Tree,
    oracle: Tree,
    origins: np.ndarray,
    directions: np.ndarray,
    ways: np.ndarray,
    far: float,
    wave: Wave,
    hits: np.ndarray,
    expected: np.ndarray,
) -> None:
    """Rays that pass faces `ways` (N, 3): first, end, target. Rows of (N, 5): t, face, b1, b2, whether any is hit."""
    stack = np.empty(STACK_SIZE, np.int32)
    for row in range(0, len(origins), SIZE):
        count = min(SIZE, len(origins) - row)
        for i in range(count):
            put_ray(wave, i, vec3(origins, row + i), vec3(directions, row + i))
            wave.first[i], wave.end[i], wave.target[i] = ways[row + i, 0], ways[row + i, 1], ways[row + i, 2]
        closest_hits_of_wave(corners, tree, wave, count, far, True, stack)
        for i in range(count):
            hits[row + i, 0], hits[row + i, 1] = wave.t[i], wave.face[i]
            hits[row + i, 2], hits[row + i, 3] = wave.b1[i], wave.b2[i]
        any_hits_of_wave(corners, tree, wave, count, far, True, stack)
        for i in range(count):
            hits[row + i, 4] = wave.found[i]
    for i in range(len(origins)):
        ray = make_ray(vec3(origins, i), vec3(directions, i))
        ignore = FaceRange(ways[i, 0], ways[i, 1])
        hit = traverse.closest_hit(corners, oracle, ray, far, ignore, stack)
        expected[i, 0], expected[i, 1], expected[i, 2], expected[i, 3] = hit.t, hit.face, hit.b1, hit.b2
        expected[i, 4] = traverse.any_hit(corners, oracle, ray, far, ignore, ways[i, 2], stack)


@pytest.mark.parametrize("name", ["room", "box", "a few of soup"])
@pytest.mark.parametrize("far", [np.inf, 1.0])
def test_rays_that_leave_faces_and_aim_at_faces(name, far):
    """Faces that a ray leaves, or aims at: of a parallelogram its half alone, of a closed piece a front alone.

    From points of faces, of edges and of vertices, from around, and all from one side at one point; a far end at the
    point that is aimed at.
    """
    corners = np.ascontiguousarray(mesh(name))
    rng = np.random.default_rng(8)
    count = 40_000
    at, to = rng.integers(0, len(corners), (2, count))
    kind = rng.integers(0, 3, (2, count, 1))
    weights = np.where(kind == 0, rng.dirichlet((1, 1, 1), (2, count)), np.array([1.0, 0.0, 0.0]))
    weights = np.where(kind == 1, np.array([0.25, 0.75, 0.0]), weights)
    origins, targets = (np.einsum("ni,nij->nj", w, corners[face]) for w, face in zip(weights, (at, to), strict=True))
    extent = float(np.ptp(corners, axis=(0, 1)).max())
    outside = np.arange(count) % 4096 < 1024
    origins[outside] = corners.mean(axis=(0, 1)) + extent * np.array([1.3, -1.1, 0.9])
    first = np.where(rng.random(count) < 0.8, at, rng.integers(0, len(corners), count))
    ways = np.stack(
        [first, first + rng.choice([0, 1, 1, 1, 3], count), np.where(rng.random(count) < 0.5, to, -1)], axis=1
    )
    hits, expected = np.empty((2, count, 5))
    tree = bvh.build(corners)
    leave(corners, tree, one_leaf(corners), origins, targets - origins, ways, far, new_wave(), hits, expected)
    np.testing.assert_array_equal(hits, expected)
    assert 0.05 < expected[:, 4].mean() < 0.99


@pytest.mark.parametrize(("name", "kind"), [("room", "random"), ("soup", "in beams"), ("ball", "of a camera")])
def test_one_ray_that_float32_cannot_hold_spoils_no_other_of_its_wave(name, kind):
    """Some rays with NaN, infinite, huge and tiny numbers, and from far beyond what float32 holds, the first too."""
    corners = np.ascontiguousarray(mesh(name))
    rng = np.random.default_rng(9)
    origins, directions = (np.array(a) for a in aimed_rays(kind, rng, corners, 640))
    odd = itertools.product((np.nan, np.inf, -np.inf, 1e30, 1e9, 1e-320), range(3), (origins, directions))
    for row, (number, axis, array) in enumerate(odd):
        array[13 * row, axis] = number
    directions[5::64] *= 1e-290
    directions[6::64] *= 1e300
    check(corners, origins, directions)
    check(corners, origins, directions, 0.5)


def test_polygons_are_found_in_any_scene():
    """Pairs of triangles that make parallelograms, and closed convex pieces, turned and mirrored ones too."""
    box = trimesh.creation.box()
    cube = box.vertices[box.faces]
    ball = trimesh.creation.icosahedron()
    turn = trimesh.transformations.random_rotation_matrix(np.array([0.1, 0.4, 0.7]))[:3, :3]
    sheet = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 1, 0], [1, 0, 0], [0, 1, 0.0]]])

    def found(corners: np.ndarray) -> tuple[int, int, int]:
        polygons = bvh.build(np.ascontiguousarray(corners)).polygons
        return polygons.count, polygons.pairs, len(polygons.pieces)

    turned = cube @ turn.T
    assert found(cube) == found(turned) == found(cube[:, ::-1]) == (6, 6, 1)
    assert found(turned.astype(np.float32).astype(float)) == (6, 6, 1)
    assert found(np.concatenate([cube, turned + 3.0, sheet])) == (13, 13, 2)
    assert found(cube[:-1]) == (6, 5, 0)  # open
    assert found(np.concatenate([cube, cube[:1]])) == (8, 5, 0)  # a face twice
    assert found(ball.vertices[ball.faces]) == (20, 0, 1)
    bent = cube * np.where(cube[..., 2:] > 0, [0.3, 1.0, 1.0], 1.0)  # a roof: two trapezia
    assert found(bent) == (8, 4, 1)
    dented = np.where((cube == 0.5).all(axis=2, keepdims=True), 0.1, cube)
    assert found(dented)[2] == 0
    assert found(np.concatenate([cube + 3.0 * i for i in range(11)])) == (0, 0, 0)


@pytest.mark.parametrize("name", ["room", "48 of soup", "48 of huge", "48 of far from the origin"])
def test_few_triangles_leave_few_doubts(name):
    """From points of faces, those left out: what is sure is right, both answers occur, float64 has less than 1 %."""
    corners = np.ascontiguousarray(mesh(name))
    tree = bvh.build(corners)
    rng = np.random.default_rng(5)
    count = 5000
    face = rng.integers(0, len(corners), count)
    origins = np.einsum("ni,nij->nj", rng.dirichlet((1, 1, 1), count), corners[face])
    directions = rng.normal(size=(count, 3))
    extent = float(np.ptp(corners, axis=(0, 1)).max())
    stack = np.empty(STACK_SIZE, np.int32)
    answers = []
    for i in range(count):
        ray = make_ray(Vec3(*origins[i].tolist()), Vec3(*directions[i].tolist()))
        left, target = int(face[i]), int(rng.integers(-1, len(corners)))
        ignore = FaceRange(left - i % 2, left + 1)  # a face, or it and the one before
        far = float(rng.choice([0.2 * extent, np.inf]))
        found = any_hit_among_polygons(tree.polygons, ray, far, ignore, target)
        answers.append(found)
        if found != DOUBT:
            exact = traverse.any_hit(corners, one_leaf(corners), ray, far, ignore, target, stack)
            assert exact == (found == HIT)
    shares = np.bincount(answers, minlength=3) / count
    assert min(shares[HIT], shares[MISS]) > 0.02
    # The blocks of the room stand on each other: there the origin lies on two faces.
    assert shares[DOUBT] < (0.1 if name == "room" else 0.01)


@pytest.mark.parametrize("name", ["room", "a few of soup", "a few of tiny"])
def test_the_far_end_is_sure_or_left_in_doubt(name):
    """A far end at the nearest hit, and up to a tenth of it before or behind: never the wrong answer."""
    corners = np.ascontiguousarray(mesh(name))
    polygons, rng, stack = bvh.build(corners).polygons, np.random.default_rng(6), np.empty(STACK_SIZE, np.int32)
    answers = []
    for origin, direction in zip(*aimed_rays("random", rng, corners, 3000), strict=True):
        ray = make_ray(Vec3(*origin.tolist()), Vec3(*direction.tolist()))
        hit = traverse.closest_hit(corners, one_leaf(corners), ray, np.inf, NOTHING, stack)
        if hit.face >= 0:
            for relative in (0.0, *(sign * 10.0**power for power in range(-16, 0) for sign in (-1.0, 1.0))):
                far = hit.t * (1.0 + relative)
                answers.append(any_hit_among_polygons(polygons, ray, far, NOTHING, -1))
                assert answers[-1] == DOUBT or (answers[-1] == HIT) == (hit.t < far)
    assert min(np.bincount(answers, minlength=3)) > 0.02 * len(answers) > 0


def test_empty_scene_and_rays_without_direction():
    """No triangle, no hit; directions of zeros or NaN hit nothing and end."""
    none = np.zeros((0, 3, 3))
    assert (fast(none, bvh.build(none), np.zeros((4, 3)), np.ones((4, 3)), np.inf)[1] == -1).all()
    directions = np.array([[0.0, -0.0, 0.0], [np.nan, 1.0, 0.0], [np.nan, np.nan, np.nan]])
    rng = np.random.default_rng(11)
    # Nodes with 0 to 6 children unused, at several depths: none of them may lead back.
    for faces in (1, 2, 3, 9, 17, 40, 300, 5000):
        for origin in (np.zeros(3), np.full(3, np.nan), np.full(3, np.inf)):
            _, face, found = check(soup(rng, faces, 0.1), np.tile(origin, (3, 1)), directions)
            assert (face == -1).all()
            assert not found.any()


def test_equal_centroids():
    """100 thousand equal triangles, halved by index: the lowest face is hit, and rays beside them end."""
    corners = np.tile(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float), (100_000, 1, 1))
    tree = bvh.build(corners)
    origins, directions = np.array([[0.2, 0.2, 1.0], [0.9, 0.9, 1.0]]), np.array([[0.0, 0, -1], [0, 0, -1]])
    assert fast(corners, tree, origins, directions, np.inf)[1].tolist() == [0, -1]


@pytest.mark.parametrize("name", MESHES)
def test_tree_holds_every_face_once_inside_its_boxes(name):
    """Leaves partition the faces with an area, exact corners beside them; boxes contain those of their children."""
    corners = mesh(name)
    tree = bvh.build(corners).bvh8
    nodes = tree.nodes.reshape(-1, bvh8.NODE)
    links = nodes.view(np.int32)
    ids = tree.leaves.reshape(-1, bvh8.LEAF).view(np.int32).reshape(len(tree.leaves) // bvh8.LEAF, -1)
    first = bvh8.FACES * tree.leaves.itemsize // 4
    found = []
    waiting = [(0, np.full(3, -2.0), np.full(3, 2.0))]
    while waiting:
        node, low, high = waiting.pop()
        boxes = nodes[node, : bvh8.LINKS].reshape(2, 3, bvh8.WIDTH)
        for lane in range(bvh8.WIDTH):
            link = int(links[node, bvh8.LINKS + lane])
            if boxes[0, 0, lane] > boxes[1, 0, lane]:  # unused: no way back up
                assert link == -1
                continue
            assert (boxes[0, :, lane] >= low).all()
            assert (boxes[1, :, lane] <= high).all()
            if link > 0:
                waiting.append((link, boxes[0, :, lane], boxes[1, :, lane]))
                continue
            leaf = tree.leaves[bvh8.LEAF * (-1 - link) :][: bvh8.FACES].reshape(3, 3, bvh8.WIDTH)
            for i, face in enumerate(ids[-1 - link, first : first + bvh8.WIDTH]):
                if face >= 0:
                    np.testing.assert_array_equal(leaf[:, :, i], corners[face])
                    scaled = (corners[face] - np.array(tree.center)) * tree.scale
                    assert (scaled >= boxes[0, :, lane]).all()
                    assert (scaled <= boxes[1, :, lane]).all()
                    found.append(int(face))
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert sorted(found) == np.flatnonzero(normals.any(axis=1)).tolist()


def test_corners_stay_in_float32_where_that_is_exact():
    """A mesh of float32 numbers takes half of the memory of one that is not."""
    assert bvh.build(mesh("ball in float32")).bvh8.leaves.dtype == np.float32
    assert bvh.build(mesh("ball")).bvh8.leaves.dtype == np.float64
