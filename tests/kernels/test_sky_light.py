"""The sky as ambient light: `w / pi ∫ hit L_sky cos`, against quadrature over directions.

Rationale: the quadrature looks the texture up by numpy and knows nothing of how directions are drawn. The density of
the map must be 1 in all, wherever the point is, or the mixture weighs wrong; a lamp-like spot in the sky shows both.
"""

import itertools
import math
from collections.abc import Callable

import attrs
import numpy as np
import pytest

from termwise import renderer
from termwise.renderer import VARIANTS, Engine, find
from termwise.renderer.arrays import from_scene
from termwise.renderer.plan import plan
from termwise.renderer.sky_light import density_of_sky, direction_to_sky, sky_light
from termwise.renderer.vector import Vec3
from termwise.scenes.analytic import plate
from termwise.scenes.model import Ambient, Camera, Material, Scene, Sky, Toggles, Vector
from termwise.scenes.terms import TERMS

FLOOR = plate("floor", (-3.0, -3.0, 0.0), (6.0, 0.0, 0.0), (0.0, 6.0, 0.0), Material((0.5, 0.5, 0.5)))


def texture() -> np.ndarray:
    """Dim, with a bright spot high in the sky."""
    texels = np.random.default_rng(1).uniform(0.1, 0.3, (8, 16, 3))
    texels[1, 5] += 20.0
    return texels.astype(np.float32)


SKIES = {
    "paper": Sky(texture=texture(), center=(0.5, -1.0, -2.0), radius=6.0),
    "equal areas": Sky(texture=texture(), radius=math.inf),
    "panorama": Sky(texture=texture(), radius=math.inf, projection="lat-long"),
    "near panorama": Sky(texture=texture(), center=(1.0, 0.0, 0.0), radius=5.0, projection="lat-long"),
}


def under(sky: Sky, **changes: object) -> Scene:
    camera = Camera((0.0, -3.0, 1.0), (0.3, 0.2, 0.0), fov=0.01)
    scene = Scene("under", camera, (FLOOR,), ambient=Ambient(source="sky"), sky=sky, resolution=(2, 2))
    return attrs.evolve(scene, **changes)


def sphere_of_directions(steps: int) -> tuple[np.ndarray, float]:
    """Midpoints of equal areas of the sphere, (N, 3), and the solid angle of each."""
    z = 1.0 - 2.0 * (np.arange(steps) + 0.5) / steps
    azimuth = 2.0 * math.pi * (np.arange(2 * steps) + 0.5) / (2 * steps)
    height, turn = (each.ravel() for each in np.meshgrid(z, azimuth, indexing="ij"))
    across = np.sqrt(1.0 - height**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), height], axis=1), 4.0 * math.pi / len(height)


def looked_up(sky: Sky, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """The paper's lookup, in numpy: (N, 3)."""
    assert sky.texture is not None
    n, seen = direction, np.ones(len(direction), bool)
    if sky.radius < math.inf:
        offset = origin - np.array(sky.center)
        b = direction @ offset
        square = b * b - offset @ offset + sky.radius**2
        seen = square >= 0.0
        t = -b + np.sqrt(np.maximum(square, 0.0))
        seen &= t > 0.0
        n = (offset + t[:, None] * direction) / sky.radius
    height, width, _ = sky.texture.shape
    u = np.arctan2(n[:, 0], n[:, 1]) / (2 * math.pi) + 0.5
    v = 0.5 - n[:, 2] / 2 if sky.projection == "equal-area" else np.arccos(np.clip(n[:, 2], -1, 1)) / math.pi
    x, y = u * width - 0.5, v * height - 0.5
    found = np.zeros((len(n), 3))
    for i, j in itertools.product((0, 1), repeat=2):
        column, row = np.floor(x).astype(int) + i, np.floor(y).astype(int) + j
        share = np.abs(1 - i - (x - np.floor(x))) * np.abs(1 - j - (y - np.floor(y)))
        found += share[:, None] * sky.texture[np.clip(row, 0, height - 1), column % width]
    return np.where(seen[:, None], found, 0.0)


def by_quadrature(sky: Sky, origin: Vector, hit: Callable[[np.ndarray], np.ndarray] | None = None) -> np.ndarray:
    """`(1 / pi) ∫ hit L_sky cos` over a floor."""
    directions, share = sphere_of_directions(500)
    directions = directions[directions[:, 2] > 0.0]
    light = looked_up(sky, np.array(origin), directions) * directions[:, 2:] / math.pi
    if hit is not None:
        light *= hit(directions)[:, None]
    return light.sum(axis=0) * share


@pytest.mark.plain
@pytest.mark.parametrize("name", SKIES)
def test_density_is_one_in_all(name: str):
    """From inside of the sky's sphere and, where it has one, from outside; and samples are as dense as it says."""
    sky = SKIES[name]
    places: list[Vector] = [(0.3, 0.2, 0.0)]
    if sky.radius < math.inf:
        places.append((9.0, 1.0, 0.0))
    arrays = from_scene(under(sky))
    assert arrays.sky_map is not None
    # No direction of this lattice is near the pole of a panorama, where the density has no bound.
    directions, share = sphere_of_directions(90)
    for place in places:
        origin = Vec3(*place)
        density = [density_of_sky(arrays, arrays.sky_map, origin, Vec3(*each)) for each in directions.tolist()]
        # From outside it grows without bound where a ray just touches the sphere.
        assert sum(density) * share == pytest.approx(1.0, rel=0.03 if place == places[0] else 0.06)
        numbers = np.random.default_rng(2).random((4000, 2)).tolist()
        drawn = np.array([direction_to_sky(arrays, arrays.sky_map, origin, u, v) for u, v in numbers])
        for axis in range(3):
            expected = np.array(density) @ directions[:, axis] * share
            assert drawn[:, axis].mean() == pytest.approx(expected, abs=0.04)


@pytest.mark.plain
@pytest.mark.parametrize("name", SKIES)
def test_what_the_sky_sends_to_an_open_floor(name: str):
    """Each sample of the mixture, evenly spread; the mean is the quadrature's."""
    sky = SKIES[name]
    arrays = from_scene(under(sky))
    assert arrays.sky_map is not None
    origin, up = Vec3(0.3, 0.2, 0.0), Vec3(0.0, 0.0, 1.0)
    side = 64
    numbers = (np.stack(np.meshgrid(*2 * [np.arange(side)]), axis=-1).reshape(-1, 2) + 0.5) / side
    found = np.mean(
        np.array([sky_light(arrays, arrays.sky_map, origin, up, u, v)[1] for u, v in numbers.tolist()]), axis=0
    )
    np.testing.assert_allclose(found, by_quadrature(sky, (0.3, 0.2, 0.0)), rtol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("variant", [name for name in VARIANTS["ambient"] if name != "paper-loop"])
def test_every_variant_looks_the_sky_up(variant: str, compiled):
    """Beside a wall to the east of the point, which hides half of the sky; without occlusion all of it is seen."""
    wall = plate("wall", (0.35, -500.0, -1.0), (0.0, 1000.0, 0.0), (0.0, 0.0, 1000.0))
    scene = under(SKIES["equal areas"], objects=(FLOOR, wall))
    right = by_quadrature(scene.sky, (0.3, 0.2, 0.0), None if variant == "constant" else lambda w: w[:, 0] < 0.0)
    factor = math.pi if variant == "paper" else 1.0
    samples, rtol = (2**16, 0.02) if compiled else (2**10, 0.25)
    found = renderer.render(scene, "ambient", variant=variant, samples=samples // 4, seed=1).mean.mean(axis=(0, 1))
    np.testing.assert_allclose(found, 0.5 * factor * right, rtol=rtol)
    if variant == "cosine":
        off = attrs.evolve(scene, toggles=Toggles(ambient_occlusion=False))
        found = renderer.render(off, "ambient", samples=samples // 4, seed=1).mean.mean(axis=(0, 1))
        np.testing.assert_allclose(found, 0.5 * by_quadrature(scene.sky, (0.3, 0.2, 0.0)), rtol=rtol)


def test_a_sky_of_one_colour_is_the_constant():
    """To the byte, and without a map; a black one is no ambient light."""
    scene = under(Sky((0.5, 0.25, 0.75)))
    plain = attrs.evolve(scene, ambient=Ambient((0.5, 0.25, 0.75)))
    images = [renderer.render(each, "ambient", samples=4, seed=1).mean for each in (scene, plain)]
    assert images[0].tobytes() == images[1].tobytes()
    assert from_scene(scene).sky_map is None
    assert from_scene(plain).sky_map is None
    variants = {term: find(term) for term in TERMS}
    black = [step for step in plan(under(Sky()), variants) if step.term == "ambient"]
    assert [step.reason for step in black if step.work.startswith("kernel")] == ["the ambient light is black"]


@pytest.mark.rare
def test_drawing_by_the_sky_pays(compiled):
    """A bright spot: the default has less than half of the variance of directions that know nothing of it."""
    scene = under(SKIES["panorama"], camera=Camera((0.0, -3.0, 1.0), (0.3, 0.2, 0.0), fov=0.01))
    deviation = {}
    for variant in ("cosine", "uniform"):
        with Engine(scene) as engine:
            images = [
                list(engine.prefixes(find("ambient", variant), samples=16, seed=1, replicate=k))[-1][1].mean()
                for k in range(40 if compiled else 12)
            ]
        deviation[variant] = np.std(images, ddof=1)
    assert deviation["cosine"] < 0.7 * deviation["uniform"]
