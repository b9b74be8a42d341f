"""Our rays against Mitsuba's (robust flag) and Embree's through embreex, and geometry images of the library.

Rationale: before any radiance is compared, both sides must meet the same faces. The oracles compute in float32, so
rays that pass within a float32 distance of an edge or of a silhouette may differ; those are found by the margin of
the ray in our own float64 soup's brute force, or counted.
"""

import attrs
import numpy as np
import pytest
import trimesh
from trimesh.ray.ray_pyembree import RayMeshIntersector

from termwise.reference.geometry import first_hits, geometry
from termwise.renderer import Engine
from termwise.renderer.arrays import from_scene
from termwise.renderer.geometry.bvh import STACK_SIZE
from termwise.renderer.geometry.intersect import NOTHING, make_ray
from termwise.renderer.geometry.rays import any_hit, closest_hit
from termwise.renderer.vector import Vec3
from termwise.scenes.load import library, load
from termwise.scenes.model import Camera, Mesh, Object, Scene
from tests.scenes import small


def ours(scene: Scene, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance and face of each ray; any_hit must say the same as closest_hit."""
    g = from_scene(scene).geometry
    stack = np.empty(STACK_SIZE, np.int32)
    t, face = np.full(len(origins), np.inf), np.full(len(origins), -1)
    for i, (o, d) in enumerate(zip(origins.tolist(), directions.tolist(), strict=True)):
        ray = make_ray(Vec3(*o), Vec3(*d))
        hit = closest_hit(g.corners, g.tree, ray, np.inf, NOTHING, stack)
        assert any_hit(g.corners, g.tree, ray, np.inf, NOTHING, -1, stack) == (hit.face >= 0)
        t[i], face[i] = hit.t, hit.face
    return t, face


def soup_scene(seed: int, faces: int) -> Scene:
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-1, 1, (faces, 1, 3)) + rng.normal(scale=0.1, size=(faces, 3, 3))
    mesh = Mesh.from_arrays(corners.reshape(-1, 3), np.arange(3 * faces).reshape(-1, 3))
    return Scene(f"soup {seed}", Camera((0.0, -3.0, 0.0), (0.0, 0.0, 0.0)), (Object("soup", mesh),))


@pytest.fixture(scope="module")
def rays() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    origins = rng.uniform(-1.5, 1.5, (20_000, 3)).astype(np.float32).astype(np.float64)
    directions = rng.normal(size=(20_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return origins, directions


@pytest.mark.parametrize("name", ["soup", "monkey"])
def test_closest_hit_against_mitsuba(name, rays):
    """20 000 rays: the same face for all but 1 in 1000 (float32 at edges), the same distance to 1e-4 where it is.

    Where faces differ the two distances must be two faces' of one edge or silhouette: not more than 20 rays may.
    """
    scene = soup_scene(2, 500) if name == "soup" else load("monkey")
    origins, directions = rays
    t, face = ours(scene, origins, directions)
    theirs = first_hits(scene, origins, directions)
    offset = np.cumsum([0, *(len(thing.mesh.faces) for thing in scene.objects)])[:-1]
    expected = np.where(theirs.object >= 0, theirs.face + offset[theirs.object], -1)
    same = face == expected
    assert (~same).sum() <= 20
    hit = same & (face >= 0)
    assert hit.sum() > 2000
    np.testing.assert_allclose(t[hit], theirs.depth[hit], rtol=1e-4, atol=1e-4)


def test_closest_hit_against_embree(rays):
    """embreex, the Embree that trimesh uses: the same face for all but 20 of 20 000 rays."""
    scene = soup_scene(3, 2000)
    mesh = scene.objects[0].mesh
    embree = RayMeshIntersector(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False))
    origins, directions = rays
    expected = embree.intersects_first(origins, directions)
    _, face = ours(scene, origins, directions)
    assert (face >= 0).sum() > 5000
    assert (face != expected).sum() <= 20


def test_edge_and_vertex_aimed_rays_where_mitsuba_needs_its_robust_flag():
    """From inside a closed sphere at its edges and vertices: neither side misses one."""
    sphere = trimesh.creation.icosphere(subdivisions=3)
    scene = Scene(
        "ball",
        Camera((0.0, -3.0, 0.0), (0.0, 0.0, 0.0)),
        (Object("ball", Mesh.from_arrays(sphere.vertices, sphere.faces)),),
    )
    vertices = scene.objects[0].mesh.vertices
    targets = np.concatenate([vertices, vertices[sphere.edges_unique].mean(axis=1)])
    directions = targets / np.linalg.norm(targets, axis=1, keepdims=True)
    origins = np.zeros_like(directions)
    _, face = ours(scene, origins, directions)
    assert (face >= 0).all()
    assert (first_hits(scene, origins, directions).object >= 0).all()


def edge_distance(scene: Scene, film: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Distance of points (N, 2) of the image from the nearest edge of the faces (N,) seen there, both in pixels.

    Edges are projected by the camera's frame, `x / (2 z tan(fov / 2))`; one that passes behind the camera is cut at
    z = 1e-3, far outside of the image. inf for the face -1.
    """
    corners = np.concatenate([thing.mesh.vertices[thing.mesh.faces] for thing in scene.objects])[faces]
    right, up, forward = scene.camera.frame()
    width, height = scene.resolution
    nearest = np.full(len(film), np.inf)
    for i in range(3):
        ends = []
        for each, other in ((i, (i + 1) % 3), ((i + 1) % 3, i)):
            point, back = (corners[:, k] - scene.camera.position for k in (each, other))
            depth, far = point @ forward, back @ forward
            behind = np.maximum(1e-3 - depth, 0) / np.where(far > depth, far - depth, np.inf)
            point = point + np.minimum(behind, 1)[:, None] * (back - point)
            depth = np.maximum(point @ forward, 1e-3)
            slope = 0.5 * width / (depth * np.tan(np.radians(scene.camera.fov) / 2))
            ends.append(np.stack([width / 2 + slope * (point @ right), height / 2 - slope * (point @ up)], -1))
        start, edge = ends[0], ends[1] - ends[0]
        square = np.maximum((edge * edge).sum(-1), 1e-300)
        along = np.clip(((film - start) * edge).sum(-1) / square, 0, 1)
        distance = np.linalg.norm(start + along[:, None] * edge - film, axis=-1)
        nearest = np.minimum(nearest, np.where(faces >= 0, distance, np.inf))
    return nearest


# Coordinates, ray and edge functions in float32 move an edge by some 2^-24 of the scene's extent, seen from a
# distance of about that: a few 1e-5 of a pixel 1/128 wide.
EDGE = 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", library())
def test_geometry_images(name, record_property):
    """Depth, normal, object and face through the centres of 132 x 132 pixels: equal in all that are not on an edge.

    On an edge are those within 1e-3 pixel of an edge of the face that either side sees there: under 1 % of them, or
    the test would excuse much. A camera that looks 1e-2 pixel aside is told apart.
    """
    side = 132  # no whole number of tiles
    scene = small(name, side)
    theirs = geometry(scene)
    offset = np.cumsum([0, *(len(thing.mesh.faces) for thing in scene.objects)])[:-1]
    faces = np.where(theirs.object >= 0, theirs.face + offset[theirs.object], -1)
    film = np.stack(np.meshgrid(np.arange(side) + 0.5, np.arange(side) + 0.5), axis=-1).reshape(-1, 2)

    with Engine(scene) as engine:
        mine = engine.geometry()
    distance = np.minimum(
        edge_distance(scene, film, mine.face.ravel()), edge_distance(scene, film, faces.ravel())
    ).reshape(side, side)
    on_edge = distance < EDGE
    record_property("pixels on an edge", int(on_edge.sum()))
    differ = (mine.object != theirs.object) | (mine.face != faces)
    record_property("pixels that differ", int(differ.sum()))
    assert on_edge.mean() < 0.01
    assert not (differ & ~on_edge).any()

    hit = ~on_edge & (mine.object >= 0)
    assert hit.sum() > 10_000
    np.testing.assert_allclose(mine.depth[hit], theirs.depth[hit], rtol=1e-5)
    # A float32 point is off by some 1e-7 of its coordinates, and turns a normal by that over the radius of a ball.
    close = 5e-6 if name == "glass" else 1e-6
    np.testing.assert_allclose(mine.normal[hit], theirs.normal[hit], atol=close)
    np.testing.assert_array_equal(np.isinf(mine.depth), mine.object < 0)
    np.testing.assert_array_equal(np.isinf(theirs.depth), theirs.object < 0)

    right, _, forward = scene.camera.frame()
    ahead = forward @ np.subtract(scene.camera.target, scene.camera.position)
    step = 1e-2 * 2 * np.tan(np.radians(scene.camera.fov) / 2) / side
    aside = (np.array(scene.camera.target) + ahead * step * right).tolist()
    camera = attrs.evolve(scene.camera, target=tuple(aside))
    with Engine(attrs.evolve(scene, camera=camera)) as engine:
        shifted = engine.geometry()
    assert (np.abs(shifted.depth[hit] / theirs.depth[hit] - 1) > 1e-5).any()
    assert ((shifted.face != faces) & ~on_edge).any()
