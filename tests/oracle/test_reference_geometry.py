"""First hits of Mitsuba's rays against brute force over all triangles in float64 (Möller and Trumbore 1997)."""

import attrs
import numpy as np
import pytest
import trimesh

from termwise import reference
from termwise.reference.geometry import geometry
from termwise.scenes.limits import Limit
from termwise.scenes.model import Ambient, Camera, Mesh, Object, PointLight, Scene, Sky, SunLight
from tests.scenes import small


def brute_force(scene: Scene, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nearest distance, object and face per direction (N, 3)."""
    nearest = np.full(len(directions), np.inf)
    thing, face = np.full((2, len(directions)), -1)
    for number, item in enumerate(scene.objects):
        for index, corners in enumerate(item.mesh.vertices[item.mesh.faces]):
            first, second = corners[1] - corners[0], corners[2] - corners[0]
            p = np.cross(directions, second)
            with np.errstate(divide="ignore", invalid="ignore"):
                inverse = 1 / (p @ first)
                offset = np.array(scene.camera.position) - corners[0]
                q = np.cross(offset, first)
                u, v, t = p @ offset * inverse, directions @ q * inverse, second @ q * inverse
                hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < nearest)
            nearest[hit], thing[hit], face[hit] = t[hit], number, index
    return nearest, thing, face


def test_first_hits():
    """Depth, normal, object and face agree except where a ray grazes an edge (under 1 % of the pixels)."""
    ball, box = trimesh.creation.icosphere(subdivisions=2), trimesh.creation.box()
    objects = (
        Object("ball", Mesh.from_arrays(ball.vertices * 0.3, ball.faces, smooth=True)),
        Object("box", Mesh.from_arrays(box.vertices + [0.2, 1.0, -0.3], box.faces)),
    )
    camera = Camera(position=(2.0, -1.0, 1.0), target=(0.0, 0.3, 0.0), fov=50.0)
    scene = Scene("two", camera, objects, resolution=(48, 32))
    hits = geometry(scene)
    film = np.stack(np.meshgrid((np.arange(48) + 0.5) / 48, (np.arange(32) + 0.5) / 32), axis=-1)
    depth, thing, face = brute_force(scene, camera.rays(film, aspect=1.5).reshape(-1, 3))
    same = (hits.object.ravel() == thing) & (hits.face.ravel() == face)
    assert same.mean() > 0.99
    assert {-1, 0, 1} == set(thing[same])
    np.testing.assert_allclose(hits.depth.ravel()[same], depth[same], rtol=1e-5)
    for number, item in enumerate(objects):
        here = same & (thing == number)
        corners = item.mesh.vertices[item.mesh.faces[face[here]]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        np.testing.assert_allclose(hits.normal.reshape(-1, 3)[here], normal, atol=2e-5)
    assert np.isinf(hits.depth[hits.object == -1]).all()


def test_an_object_too_small_for_single_precision_is_refused():
    """A speck 1e-4 of the scene's extent: the ray offset would be as long as a tenth of it."""
    speck = Object("speck", Mesh.from_arrays(0.01 * np.eye(3), [[0, 1, 2]]))
    ground = Object("ground", Mesh.from_arrays(100.0 * np.eye(3), [[0, 1, 2]]))
    scene = Scene("far", Camera((1.0, 0.0, 0.0), (0.0, 0.0, 0.0)), (speck, ground))
    with pytest.raises(
        ValueError, match=r"far: object 'speck' is 0.01 long in a scene of 100: allowed is at least 0.001"
    ):
        reference.loaded(scene)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"ambient": Ambient((1e30, 0.0, 0.0))}, r"ambient.color = \(1e\+30, 0.0, 0.0\)"),
        ({"sky": Sky((0.0, 1e16, 0.0))}, r"sky.color = \(0.0, 1e\+16, 0.0\)"),
        ({"sky": Sky(texture=np.full((2, 4, 3), 1e30, np.float32))}, "sky.texture = 1.*e\\+30"),
        ({"lights": (PointLight((0.0, 0.0, 5.0), (0.0, 0.0, 1e30)),)}, r"lights\[0\].intensity"),
        (
            {"draw_lights": True, "lights": (SunLight((0.0, 0.0, -1.0), (0.0, 1e8, 0.0), angle=1e-3),)},
            r"lights\[0\]: radiance of the drawn disc = \(0.0, 4.*e\+17, 0.0\)",
        ),
    ],
)
def test_light_whose_square_single_precision_cannot_hold_is_refused(change, named):
    """Ours renders it: rows of the stress tests hold it to exact powers of two."""
    scene = attrs.evolve(small("two_cubes", 4), **change)
    with pytest.raises(ValueError, match=f"two_cubes: {named}.*: allowed is at most 1e\\+15"):
        reference.render(scene, Limit("ambient"), spp=1)
