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

from reference.geometry import first_hits, geometry
from renderer import Engine
from renderer.arrays import from_scene
from renderer.geometry.bvh import STACK_SIZE
from renderer.geometry.intersect import FaceRange, make_ray
from renderer.geometry.traverse import any_hit, closest_hit
from renderer.vector import Vec3
from scenes.load import library, load
from scenes.model import Camera, Mesh, Object, Scene


def ours(scene: Scene, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance and face of each ray; any_hit must say the same as closest_hit."""
    g = from_scene(scene).geometry
    stack = np.empty(STACK_SIZE, np.int32)
    t, face = np.full(len(origins), np.inf), np.full(len(origins), -1)
    for i, (o, d) in enumerate(zip(origins.tolist(), directions.tolist(), strict=True)):
        ray = make_ray(Vec3(*o), Vec3(*d))
        hit = closest_hit(g.corners, g.tree, ray, np.inf, FaceRange(-1, 0), stack)
        assert any_hit(g.corners, g.tree, ray, np.inf, FaceRange(-1, 0), -1, stack) == (hit.face >= 0)
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


@pytest.mark.parametrize("name", library())
def test_geometry_images(name):
    """Depth, normal, object and face through the pixel centres: equal for all but 0.2 % of pixels, those at edges.

    A pixel may differ only where an eighth of a pixel's step in some direction changes the face on our side.
    """
    scene = attrs.evolve(load(name), resolution=(64, 64))
    theirs = geometry(scene)
    with Engine(scene) as engine:
        mine = engine.geometry()
    offset = np.cumsum([0, *(len(thing.mesh.faces) for thing in scene.objects)])[:-1]
    faces = np.where(theirs.object >= 0, theirs.face + offset[theirs.object], -1)
    differ = (mine.object != theirs.object) | (mine.face != faces)
    assert differ.sum() <= 0.002 * differ.size
    same = ~differ & (mine.object >= 0)
    assert same.sum() > 1000
    np.testing.assert_allclose(mine.depth[same], theirs.depth[same], rtol=1e-5)
    np.testing.assert_allclose(mine.normal[same], theirs.normal[same], atol=1e-5)
    assert (np.isinf(mine.depth) == (mine.object < 0)).all()
    if differ.any():
        y, x = np.nonzero(differ)
        steps = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), axis=-1).reshape(-1, 2) / 8
        film = (np.stack([x, y], axis=-1)[:, None] + 0.5 + steps) / 64
        directions = scene.camera.rays(film, aspect=1.0).reshape(-1, 3)
        _, around = ours(scene, np.broadcast_to(scene.camera.position, directions.shape), directions)
        around = around.reshape(len(x), 9)
        assert (around != around[:, :1]).any(axis=1).all()
