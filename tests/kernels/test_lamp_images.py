"""Lamps under images: what they send, their photons and their pictures, against quadrature and lamps of one radiance.

Rationale: an image of 2 x 2 texels is bilinear between their centres, so a lamp that lies there has a radiance in
closed form, whose irradiance is a quadrature by SciPy. Light samples and photons are held against it by points of a
lattice, whose sum converges. Functions of kernels are called as plain Python.
"""

import itertools
import math
from collections.abc import Callable
from typing import Any

import attrs
import numpy as np
import pytest
from scipy import integrate, ndimage, stats

from termwise.renderer import render
from termwise.renderer.arrays import from_scene
from termwise.renderer.lights import emit_photon, sample_light
from termwise.renderer.surface import Surface
from termwise.renderer.vector import Vec3
from termwise.scenes.analytic import plate
from termwise.scenes.model import Camera, Material, Mesh, Object, Photons, Scene, Toggles
from termwise.scenes.textures import Texture

pytestmark = pytest.mark.plain
CORNER, ACROSS, UP = np.array([-0.4, -0.5, 1.2]), np.array([0.0, 1.1, 0.0]), np.array([0.9, 0.0, 0.0])
AREA = 0.99
FLOOR = plate("floor", (-3.0, -3.0, 0.0), (6.0, 0.0, 0.0), (0.0, 6.0, 0.0), Material((0.5, 0.5, 0.5)))
FOUR = np.array([[[4.0, 1.0, 0.0], [0.5, 2.0, 8.0]], [[0.0, 3.0, 1.0], [6.0, 0.0, 0.0]]])
"""Texels that differ along both axes; the top row first."""


def lamp(texels: object, *, side: int = 1, low: float = 0.25, high: float = 0.75, wrap: str = "clamp") -> Object:
    """A rectangle that shines downwards, cut into 2 side² triangles; its image is seen from `low` to `high`."""
    places = np.stack(np.meshgrid(*2 * [np.linspace(0.0, 1.0, side + 1)], indexing="ij"), axis=-1).reshape(-1, 2)
    vertices = CORNER + places @ np.array([ACROSS, UP])
    first = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    a, b, c, d = first, first + side + 1, first + side + 2, first + 1
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    mesh = Mesh.from_arrays(vertices, faces, uv=low + (high - low) * places)
    return Object("lamp", mesh, emission=Texture(texels, wrap))  # type: ignore[arg-type]


def lit(thing: Object, **changes: object) -> Scene:
    camera = Camera((0.0, -4.0, 1.0), (0.0, 0.0, 0.6), fov=50.0, pixel="centre")
    scene = Scene("lit", camera, (FLOOR, thing), resolution=(4, 4), photons=Photons(count=300, radius=0.6))
    return attrs.evolve(scene, **changes)


def radiance(s: float, t: float) -> np.ndarray:
    """Of the lamp under FOUR: its texels' centres lie in the corners."""
    (top_left, top_right), (bottom_left, bottom_right) = FOUR
    return (1 - t) * ((1 - s) * bottom_left + s * bottom_right) + t * ((1 - s) * top_left + s * top_right)


WHOLE = (((0.0, 1.0), (0.0, 1.0)),)
Sent = Callable[[float, float], np.ndarray]


def irradiance(at: tuple[float, float], sent: Sent = radiance, pieces: Any = WHOLE) -> np.ndarray:
    """Of the floor, by quadrature over the pieces of the lamp in which it is smooth, (3,)."""

    def integrand(t: float, s: float, channel: int) -> float:
        way = CORNER + s * ACROSS + t * UP - (*at, 0.0)
        return sent(s, t)[channel] * way[2] ** 2 / (way @ way) ** 2 * AREA

    found = [[integrate.dblquad(integrand, *s, *t, args=(c,), epsrel=1e-6)[0] for c in range(3)] for s, t in pieces]
    return np.sum(found, axis=0)


def sampled(scene: Scene, at: tuple[float, float], count: int) -> np.ndarray:
    """E at a point of the floor by light samples on a lattice, (3,)."""
    arrays, up = from_scene(scene), Vec3(0.0, 0.0, 1.0)
    surface = Surface(Vec3(*at, 0.0), up, up, 0, 0, 1.0, 0.0, 0.0)
    points = stats.qmc.Halton(2, rng=1).random(count)
    return math.pi * np.mean(np.array([sample_light(arrays, surface, u, v)[0] for u, v in points]), axis=0)


@pytest.mark.parametrize("side", [1, 2])
def test_irradiance_is_that_of_quadrature(side: int):
    """Of two faces, and of many, which are chosen by what each may send."""
    scene = lit(lamp(FOUR, side=side))
    assert from_scene(scene).pick_by_light == (side > 1)
    for at in ((0.0, 0.0), (1.5, -0.7)):
        np.testing.assert_allclose(sampled(scene, at, 1024), irradiance(at), rtol=1e-2)


def test_a_step_is_the_half_of_a_lamp():
    """Half of 128 columns black: the ramp between them is narrow, and as long on either side of the middle."""
    step = np.zeros((1, 128, 3))
    step[:, 64:] = 4.0, 2.0, 1.0
    scene = lit(lamp(step, low=0.0, high=1.0))
    for at in ((0.0, 0.0), (0.3, 0.9)):
        expected = irradiance(at, lambda s, t: step[0, -1], [((0.5, 1.0), (0.0, 1.0))])
        np.testing.assert_allclose(sampled(scene, at, 4096), expected, rtol=1e-2)


@pytest.mark.parametrize("side", [1, 2])
def test_one_bright_texel_is_found(side: int):
    """Its light is a tent two texels wide, beside which the lamp is dark, and some of its faces all over."""
    texels = np.zeros((5, 5, 3))
    texels[3, 1] = 64.0, 32.0, 16.0
    scene = lit(lamp(texels, side=side, low=0.0, high=1.0))

    def tent(s: float, t: float) -> np.ndarray:
        across, down = max(0.0, 1.0 - abs(5.0 * s - 1.5)), max(0.0, 1.0 - abs(5.0 * (1.0 - t) - 3.5))
        return texels[3, 1] * across * down

    halves = (0.1, 0.3), (0.3, 0.5)
    expected = irradiance((0.2, 0.1), tent, itertools.product(halves, halves))
    np.testing.assert_allclose(sampled(scene, (0.2, 0.1), 768), expected, rtol=3e-2)


@pytest.mark.parametrize("side", [1, 2])
def test_photons_carry_what_leaves_where_they_start(side: int):
    """Their power is `pi ∫ L dA`, and so are its first moments over the lamp: `∫ s L`, `∫ t L`."""
    arrays = from_scene(lit(lamp(FOUR, side=side)))
    points = stats.qmc.Halton(4, rng=2).random(3000)
    rows = [emit_photon(arrays, False, (u, v), (a, b)) for u, v, a, b in points]
    flux, origin = np.array([row[2] for row in rows]), np.array([row[0] for row in rows])
    s, t = (origin - CORNER) @ ACROSS / (ACROSS @ ACROSS), (origin - CORNER) @ UP / (UP @ UP)
    for found, weight in ((1.0, lambda s, t: 1.0), (s, lambda s, t: s), (t, lambda s, t: t)):
        expected = [
            integrate.dblquad(lambda t, s, c=c, w=weight: w(s, t) * radiance(s, t)[c], 0.0, 1.0, 0.0, 1.0)[0]
            for c in range(3)
        ]
        mean = (flux * np.reshape(found, (-1, 1))).mean(axis=0)
        np.testing.assert_allclose(mean, math.pi * AREA * np.array(expected), rtol=1e-2)


def test_an_image_of_one_value_is_that_value():
    """In all terms, photons too: faces are chosen with the same chances, to the bit."""
    value = 4.0, 2.0, 1.0
    image = lamp(np.tile(value, (3, 5, 1)), low=-1.0, high=2.0, wrap="repeat")
    steel = attrs.evolve(FLOOR, material=Material((0.5, 0.5, 0.5), 0.5, 0.4))
    wall = plate("wall", (-3.0, 2.0, 0.1), (6.0, 0.0, 0.0), (0.0, 0.0, 3.0))
    below = Camera((0.0, -1.6, 0.4), (0.0, 0.0, 0.7), fov=70.0)
    scenes = [
        lit(thing, objects=(steel, wall, thing), camera=below, draw_lights=True, max_bounces=1)
        for thing in (image, attrs.evolve(image, emission=value))
    ]
    cases = ("direct", "path"), ("direct", "photon-map"), ("direct", "next-event"), ("specular", "vndf")
    for term, variant in (*cases, ("background", "seen")):
        images = [render(scene, term, variant=variant, samples=2, seed=3, chain="path").mean for scene in scenes]
        assert images[0].any()
        np.testing.assert_allclose(images[0], images[1], rtol=1e-6, atol=1e-9, err_msg=f"{term} {variant}")


def test_a_lamp_that_is_drawn_shows_its_image():
    """From below its front, where each pixel's middle meets it; its back, and a lamp that is off, are black."""
    rng = np.random.default_rng(4)
    thing = lamp(rng.uniform(0.0, 9.0, (3, 5, 3)), low=-0.3, high=1.6, wrap="repeat")
    camera = Camera((0.1, 0.2, 0.2), (0.05, 0.05, 1.2), up=(0.0, 1.0, 0.0), fov=60.0, pixel="centre")
    scene = lit(thing, camera=camera, objects=(thing,), draw_lights=True, resolution=(6, 6))
    found = render(scene, "background", samples=1).mean.reshape(-1, 3)
    film = np.stack(np.meshgrid(*2 * [(np.arange(6) + 0.5) / 6]), axis=-1).reshape(-1, 2)
    ways = camera.rays(film, aspect=1.0)
    met = np.array(camera.position) + ways / ways[:, 2:]  # the lamp's plane is 1 above
    s, t = (met - CORNER) @ ACROSS / (ACROSS @ ACROSS), (met - CORNER) @ UP / (UP @ UP)
    u, v = -0.3 + 1.9 * s, -0.3 + 1.9 * t
    assert isinstance(thing.emission, Texture)
    at = (1.0 - v) * 3 - 0.5, u * 5 - 0.5
    planes = np.moveaxis(thing.emission.texels.astype(np.float64), 2, 0)
    expected = np.stack([ndimage.map_coordinates(each, at, order=1, mode="grid-wrap") for each in planes], axis=1)
    inside = (s > 0) & (s < 1) & (t > 0) & (t < 1)
    assert 0.3 < inside.mean() < 1.0
    np.testing.assert_allclose(found, np.where(inside[:, None], expected, 0.0), rtol=1e-5, atol=1e-5)
    above = attrs.evolve(camera, position=(0.1, 0.2, 2.2))
    for dark in (attrs.evolve(scene, camera=above), attrs.evolve(scene, toggles=Toggles(lighting=False))):
        assert not render(dark, "background", samples=1).mean.any()
