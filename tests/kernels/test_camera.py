"""The kernel's camera against the model's, which is the paper's formula and what the reference uses."""

import attrs
import numpy as np
import pytest

from termwise.renderer.arrays import PIXEL_RULES, from_scene
from termwise.renderer.camera import CENTRE, CORNER, FILM, JITTER, camera_ray
from termwise.renderer.rng import root
from termwise.renderer.sobol import Sampler, sample_2d
from termwise.scenes.model import Camera, Scene

CAMERA = Camera((0.3, -2.0, 1.5), (0.1, 0.7, 0.2), up=(0.2, 0.1, 1.0), fov=71.0, near=0.37)


@pytest.mark.parametrize("rule", ["corner", "centre", "jitter"])
def test_rays_are_those_of_the_model(rule):
    """Pixel (x, y) at film position ((x + u) / W, (y + v) / H): u, v = 0, 1/2 or the sampler's pair."""
    scene = Scene("camera", attrs.evolve(CAMERA, pixel=rule), resolution=(7, 4))
    camera = from_scene(scene).camera
    key = root(1, 0)
    for y in range(4):
        for x in range(7):
            sampler = Sampler(key, np.uint32(3 * y + x))
            shift = {"corner": (0, 0), "centre": (0.5, 0.5), "jitter": sample_2d(sampler, FILM)}[rule]
            film = np.array([(x + shift[0]) / 7, (y + shift[1]) / 4])
            ray = camera_ray(camera, x, y, sampler)
            np.testing.assert_allclose(ray.direction, scene.camera.rays(film, aspect=7 / 4), atol=2e-15)
            assert ray.origin == CAMERA.position


def test_near_plane_of_the_paper():
    """The film's corners are `near` ahead and `width = 2 near tan(fov / 2)`, `width / aspect` apart: restated."""
    directions = CAMERA.rays(np.array([[0, 0], [1, 0], [0, 1], [1, 1], [0.5, 0.5]]), aspect=1.6)
    forward = np.subtract(CAMERA.target, CAMERA.position) / np.linalg.norm(np.subtract(CAMERA.target, CAMERA.position))
    np.testing.assert_allclose(directions[4], forward, atol=1e-15)
    on_plane = directions * (CAMERA.near / (directions @ forward))[:, None]
    width = 2 * CAMERA.near * np.tan(np.radians(71.0) / 2)
    assert np.linalg.norm(on_plane[1] - on_plane[0]) == pytest.approx(width)
    assert np.linalg.norm(on_plane[2] - on_plane[0]) == pytest.approx(width / 1.6)
    # (0, 0) is top left: above the middle, and to the left of someone who looks along `forward` with `up` up.
    assert on_plane[0] @ np.array(CAMERA.up) > on_plane[2] @ np.array(CAMERA.up)
    assert np.cross(forward, CAMERA.up) @ (on_plane[1] - on_plane[0]) > 0


def test_near_distance_changes_no_direction():
    """The near plane and its distance scale together."""
    film = np.random.default_rng(1).uniform(size=(20, 2))
    far = attrs.evolve(CAMERA, near=9.0)
    np.testing.assert_allclose(CAMERA.rays(film, aspect=1.3), far.rays(film, aspect=1.3), atol=1e-15)


def test_rule_names_are_the_kernel_s_numbers():
    """The order of the names in arrays is that of the constants in the kernel."""
    assert [PIXEL_RULES[number] for number in (CORNER, CENTRE, JITTER)] == ["corner", "centre", "jitter"]
