"""Faces in one plane: which are found, against exact rational areas; what is left of them; what is refused."""

import time
from fractions import Fraction
from itertools import combinations, pairwise
from pathlib import Path

import attrs
import numpy as np
import pytest
import trimesh

from termwise.scenes import coincident
from termwise.scenes.load import load
from termwise.scenes.model import Camera, Material, Mesh, Object, Scene
from tests.scenes import box

RED, BLUE = Material((0.8, 0.1, 0.1)), Material((0.1, 0.1, 0.8))
CAMERA = Camera((3.0, -7.0, 5.0), (0.0, 0.0, 0.0))
Point = tuple[Fraction, Fraction]


def overlap(one: np.ndarray, other: np.ndarray) -> Fraction:
    """Twice the common area of two triangles (3, 2) of integers, exact: Sutherland and Hodgman with fractions."""

    def side(p: Point, a: Point, b: Point) -> Fraction:
        return (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])

    def points(triangle: np.ndarray) -> list[Point]:
        a, b, c = ((Fraction(int(x)), Fraction(int(y))) for x, y in triangle)
        return [a, b, c] if side(c, a, b) > 0 else [a, c, b]

    shape, edges = points(one), points(other)
    for a, b in pairwise([*edges, edges[0]]):
        cut = []
        for p, q in pairwise([*shape, *shape[:1]]):
            here, there = side(p, a, b), side(q, a, b)
            if here >= 0:
                cut.append(p)
            if here * there < 0:
                t = here / (here - there)
                cut.append((p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])))
        shape = cut
    return sum((p[0] * q[1] - p[1] * q[0] for p, q in pairwise([*shape, *shape[:1]])), Fraction(0))


def placed(plane: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Points (..., 2) in a plane of any direction."""
    turn = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    return np.concatenate([plane, np.zeros_like(plane[..., :1])], axis=-1) @ turn.T + rng.normal(size=3)


@pytest.mark.parametrize("seed", range(2))
def test_overlaps_are_found_and_touching_faces_are_not(seed: int):
    """Triangles of integer corners in two tilted planes: pairs are those with a common area, and no others."""
    rng = np.random.default_rng(seed)
    flat = rng.integers(0, 9, (2, 18, 3, 2))
    corners = np.concatenate([placed(each.astype(float), rng) for each in flat])
    mesh = Mesh.from_arrays(corners.reshape(-1, 3), np.arange(108).reshape(-1, 3))
    found = set(map(tuple, coincident.pairs_of((mesh,)).tolist()))
    right = {
        (18 * plane + i, 18 * plane + j)
        for plane in range(2)
        for i, j in combinations(range(18), 2)
        if overlap(flat[plane, i], flat[plane, j]) != 0
    }
    assert len(right) > 60
    assert found == right


def test_what_is_left_covers_every_point_once():
    """Random rectangles of one material over each other: each point that some cover is covered by one face."""
    rng = np.random.default_rng(5)
    corner, edge = rng.uniform(0, 3, (8, 2)), rng.uniform(1, 4, (8, 2))
    things = []
    for number in range(8):
        x, y = corner[number]
        u, v = edge[number]
        vertices = [(x, y, 0), (x + u, y, 0), (x + u, y + v, 0), (x, y + v, 0)]
        faces = [[0, 1, 2], [0, 2, 3]] if number % 2 else [[3, 2, 1], [3, 1, 0]]
        things.append(Object(str(number), Mesh.from_arrays(vertices, faces), RED))
    points = rng.uniform(0, 7, (4000, 2))

    def covers(objects: tuple[Object, ...]) -> np.ndarray:
        a, b, c = np.moveaxis(np.concatenate([o.mesh.vertices[o.mesh.faces] for o in objects])[..., :2], 1, 0)

        def side(p: np.ndarray, q: np.ndarray) -> np.ndarray:
            (x, y), (u, v) = (q - p).T, np.moveaxis(points[:, None] - p, -1, 0)
            return x * v - y * u > 0

        signs = side(a, b).astype(int) + side(b, c) + side(c, a)
        return np.isin(signs, (0, 3)).sum(axis=1)

    before = covers(tuple(things))
    assert before.max() > 2
    scene = Scene("tiles", CAMERA, tuple(things))
    np.testing.assert_array_equal(covers(scene.objects), np.minimum(before, 1))
    assert attrs.evolve(scene, resolution=(3, 3)).objects is scene.objects


def quad(name: str, material: Material, low: tuple[float, float], high: tuple[float, float], height=0.0) -> Object:
    (x, y), (u, v) = low, high
    corners = [(x, y, height), (u, y, height), (u, v, height), (x, v, height)]
    return Object(name, Mesh.from_arrays(corners, [[0, 1, 2], [0, 2, 3]]), material)


FLOOR = quad("floor", RED, (-4.0, -4.0), (4.0, 4.0))


@pytest.mark.parametrize("thing", ["decal", "twice", "partly", "from below", "inverted room"])
def test_two_looks_in_one_plane_are_refused_by_their_names(thing: str):
    """A decal, the same face, a part of it, a block on a floor that is seen from below too, a room about the camera."""
    objects = {
        "decal": (FLOOR, quad("other", BLUE, (0.0, 0.0), (1.0, 1.0))),
        "twice": (FLOOR, attrs.evolve(FLOOR, name="other", material=BLUE)),
        "partly": (FLOOR, quad("other", BLUE, (3.0, 3.0), (5.0, 5.0))),
        "from below": (
            FLOOR,
            attrs.evolve(box("other", (0.0, 0.0, 0.0)), material=BLUE),
            quad("low", RED, (0, 0), (1, 1), -1.0),
        ),
        "inverted room": (FLOOR, attrs.evolve(box("other", (-10.0, -10.0, 0.0), 20.0), material=BLUE)),
    }[thing]
    with pytest.raises(ValueError, match="'floor' and 'other' lie in one plane") as error:
        Scene("two", CAMERA, objects)
    assert "\n" not in str(error.value)


def test_a_light_over_a_light_is_refused():
    """Twice the light or once: there is no answer."""
    lamp = attrs.evolve(FLOOR, emission=(1.0, 1.0, 1.0))
    with pytest.raises(ValueError, match="'floor' and 'again' lie in one plane.*give light"):
        Scene("lamps", CAMERA, (lamp, attrs.evolve(lamp, name="again")))


def test_what_only_touches_or_is_never_seen_is_kept():
    """Tiles side by side, a block on a floor, blocks wall to wall, a heap of both: nothing is lost or refused."""
    tiles = tuple(
        quad(f"{x} {y}", (RED, BLUE)[(x + y) % 2], (x, y), (x + 1, y + 1)) for x in range(-3, 3) for y in range(-3, 3)
    )
    blocks = tuple(
        attrs.evolve(box(f"block {number}", low), material=material)
        for number, (low, material) in enumerate(
            [((0.0, 0.0, 0.0), BLUE), ((1.0, 0.3, 0.0), RED), ((0.2, 0.1, 1.0), RED), ((-1.0, 0.0, 0.5), BLUE)]
        )
    )
    for objects in (tiles, (FLOOR, *blocks), tiles + blocks):
        assert Scene("fine", CAMERA, objects).objects == objects


def test_faces_listed_twice_count_once(tmp_path: Path):
    """A quad with both windings and either diagonal, alone and beside its copy: the area is that of the quad."""
    corners = placed(np.array([[-0.8, 0.0], [0.8, 0.0], [0.8, 1.5], [-0.8, 1.5]]), np.random.default_rng(2))
    mesh = Mesh.from_arrays(corners, [[0, 1, 2], [0, 2, 3], [3, 2, 1], [3, 1, 0], [0, 1, 2]])
    scene = Scene("card", CAMERA, (Object("card", mesh, RED), Object("copy", mesh, RED)))
    (card,) = scene.objects
    left = card.mesh.vertices[card.mesh.faces]
    area = np.linalg.norm(np.cross(left[:, 1] - left[:, 0], left[:, 2] - left[:, 0]), axis=1).sum() / 2
    assert area == pytest.approx(2.4, rel=1e-6)


def test_a_smooth_mesh_in_both_windings_is_shaded_as_one():
    """Area-weighted normals of two windings would cancel; what is shaded otherwise is refused."""
    ball = trimesh.creation.icosphere(subdivisions=1)
    plain = Mesh.from_arrays(ball.vertices, ball.faces, smooth=True)
    twice = Mesh.from_arrays(ball.vertices, np.concatenate([ball.faces, ball.faces[:, ::-1]]), smooth=True)
    (left,) = Scene("ball", CAMERA, (Object("ball", twice, RED),)).objects
    np.testing.assert_array_equal(left.mesh.faces, plain.faces)
    np.testing.assert_array_equal(left.mesh.normals, plain.normals)
    flat = Object("flat", Mesh.from_arrays(ball.vertices, ball.faces), RED)
    with pytest.raises(ValueError, match="'flat' and 'smooth' lie in one plane.*differ in their shading normals"):
        Scene("balls", CAMERA, (flat, Object("smooth", plain, RED)))


def test_a_camera_on_a_face_is_refused():
    """In the face it is; beside it, in its plane, and a little off it, it is not."""
    for position, fine in [
        ((1.0, 1.5, 0.0), False),
        ((4.0, 0.0, 0.0), False),
        ((5.0, 0.0, 0.0), True),
        ((1, 1, 1e-3), True),
    ]:
        camera = attrs.evolve(CAMERA, position=position)
        if fine:
            assert Scene("camera", camera, (FLOOR,)).objects
            continue
        with pytest.raises(ValueError, match="lies on a face of 'floor'"):
            Scene("camera", camera, (FLOOR,))


@pytest.mark.parametrize("angle", [0.0, 30.0, 90.0])
def test_a_camera_above_a_wide_floor_is_off_it(angle: float):
    """Coordinates of 1e12 round a height by nothing where none of them is in it, and by 1e5 where they are."""
    corners = np.array([[-6e11, -6e11, 0.0], [6e11, -6e11, 0.0], [6e11, 6e11, 0.0], [-6e11, 6e11, 0.0]])
    turn = trimesh.transformations.rotation_matrix(np.radians(angle), (1.0, 0.0, 0.0))[:3, :3]
    floor = Object("floor", Mesh.from_arrays(corners @ turn.T, [[0, 1, 2], [0, 2, 3]]), RED)
    for height, fine in [(0.0, False), (2.0, angle != 30.0), (1e7, True)]:
        camera = attrs.evolve(CAMERA, position=tuple(turn @ (3.0, -7.0, height)))
        if fine:
            assert Scene("wide", camera, (floor,)).objects
            continue
        with pytest.raises(ValueError, match="lies on a face of 'floor'"):
            Scene("wide", camera, (floor,))


def test_a_file_is_refused_in_one_line(tmp_path: Path):
    """Both kinds, with the name of the file."""
    path = tmp_path / "decal.toml"
    text = "[camera]\nposition = [0, -3, {height}]\ntarget = [0, 0, 1]\n"
    text += '[[objects]]\nshape = "rectangle"\nname = "wall"\norigin = [-4, -4, 0]\nedges = [[8, 0, 0], [0, 8, 0]]\n'
    decal = '[[objects]]\nshape = "rectangle"\nname = "text"\nedges = [[1, 0.2, 0], [0, 1, 0]]\ncolor = [1, 0, 0]\n'
    path.write_text(text.format(height=2) + decal)
    with pytest.raises(ValueError, match=r"decal.toml: objects: 'wall' and 'text' lie in one plane"):
        load(path)
    path.write_text(text.format(height=0))
    with pytest.raises(
        ValueError, match=r"decal.toml: camera: position = \(0.0, -3.0, 0.0\): lies on a face of 'wall'"
    ):
        load(path)


def test_many_triangles_take_little_time():
    """Twenty-five thousand, curved and in one plane; none of them coincide."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    side = 100
    x, y = np.meshgrid(np.arange(side + 1.0), np.arange(side + 1.0), indexing="ij")
    corner = np.arange(side * (side + 1)).reshape(side, side + 1)[:, :-1].ravel()
    faces = np.concatenate([corner[:, None] + [0, side + 1, side + 2], corner[:, None] + [0, side + 2, 1]])
    flat = Mesh.from_arrays(np.column_stack([x.ravel() / side - 9.0, y.ravel() / side, 0.1 * x.ravel()]), faces)
    begin = time.process_time()
    assert len(coincident.pairs_of((Mesh.from_arrays(ball.vertices, ball.faces), flat))) == 0
    assert time.process_time() - begin < 2.0
