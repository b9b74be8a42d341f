"""Translucency: `color (1 - gloss) ((1 - s) L(n) + s L(-n))`, by each estimator of ambient and direct light.

Rationale: a thin sheet has closed forms on both sides, and what is on one side alone tells s from 1 - s. A closed body
that a point light shines in is a series of reflections that keep 1 - s: `E = I / (1 - rho (1 - s))` within, none of it
without, where `rho s E / pi` is seen.
"""

import math
from typing import Any

import attrs
import numpy as np
import pytest

from termwise import renderer
from termwise.renderer import Engine, find
from termwise.renderer.arrays import from_scene
from termwise.renderer.plan import plan
from termwise.renderer.terms import VARIANTS
from termwise.scenes.analytic import disc_over_plane, plate, unit_sphere
from termwise.scenes.load import library, load
from termwise.scenes.model import Ambient, Camera, Material, Object, Photons, PointLight, Scene, Vector
from tests.scenes import box

pytestmark = pytest.mark.plain
COLOR = (0.8, 0.5, 0.2)
WHITE = (1.0, 1.0, 1.0)
SHARES = (0.0, 0.25, 1.0)


def sheet(share: float, color: Vector = COLOR) -> Object:
    """Six wide, in the plane z = 0."""
    return plate("sheet", (-3.0, -3.1, 0.0), (6.0, 0.0, 0.0), (0.0, 6.2, 0.0), Material(color, translucency=share))


def seen(share: float, *others: Object, above: bool = True, **changes: Any) -> Scene:
    """The sheet and other things from above, or from below; a point light below."""
    camera = Camera((0.3, -4.0, 3.0 if above else -3.0), (0.3, 0.2, 0.0), fov=20.0, pixel="centre")
    light = PointLight((0.5, 0.25, -1.5), (3.0, 2.0, 1.0))
    scene = Scene("sheet", camera, (sheet(share), *others), (light,), resolution=(3, 3), photons=Photons(2000, 0.5))
    return attrs.evolve(scene, **changes)


def image(scene: Scene, term: str, variant: str, samples: int = 1, **options: Any) -> np.ndarray:
    with Engine(scene, **options) as engine:
        *_, (_, found, _) = engine.prefixes(find(term, variant), samples=samples, seed=1, replicate=0)
    return found


def irradiance(scene: Scene) -> np.ndarray:
    """E of the scene's light at the points of the sheet that its pixels see, on the side of the light, (H, W, 3)."""
    width, height = scene.resolution
    film = np.stack(np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height), axis=-1)
    ways = scene.camera.rays(film, aspect=scene.aspect)
    points = scene.camera.position - (scene.camera.position[2] / ways[..., 2:]) * ways
    (light,) = scene.lights
    assert isinstance(light, PointLight)
    offset = light.position - points
    cosine_by_square = np.abs(offset[..., 2]) / np.linalg.norm(offset, axis=-1) ** 3
    return cosine_by_square[..., None] * np.array(light.intensity)


@pytest.mark.parametrize("share", SHARES)
@pytest.mark.parametrize("variant", VARIANTS["ambient"])
def test_a_sheet_in_a_furnace(variant: str, share: float):
    """As much light comes from either side: of the share nothing is left, for each rule; a white one is invisible."""
    scene = seen(share, ambient=Ambient(WHITE, 9.0))
    scene = attrs.evolve(scene, objects=(sheet(share, WHITE),))
    opaque = attrs.evolve(scene, objects=(sheet(0.0, WHITE),))
    found = image(scene, "ambient", variant, 16, without=("open",))
    expected = {"paper": math.pi, "paper-loop": 0.5}.get(variant, 1.0)
    exact = variant in ("cosine", "constant")
    np.testing.assert_allclose(found, expected, rtol=1e-12 if exact else 0.1)
    if share == 0.0:
        np.testing.assert_array_equal(found, image(opaque, "ambient", variant, 16, without=("open",)))


@pytest.mark.parametrize("share", SHARES)
@pytest.mark.parametrize("variant", ["next-event", "path"])
def test_a_leaf_between_the_lamp_and_the_eye(variant: str, share: float):
    """`w s E / pi` from above, `w (1 - s) E / pi` from below: each sample is exact."""
    for above, part in ((True, share), (False, 1.0 - share)):
        scene = seen(share, above=above, scope="first-hit" if variant == "next-event" else "all")
        expected = part * np.array(COLOR) * irradiance(scene) / math.pi
        np.testing.assert_allclose(image(scene, "direct", variant, 2), expected, rtol=1e-12)


@pytest.mark.parametrize("variant", ["photon-map", "nearest"])
def test_photons_of_both_sides_are_gathered(variant: str):
    """They land on the side of the light; from both sides the same ones are seen."""
    count = 1000
    scenes = [seen(0.25, above=above, photons=Photons(count, 0.5, nearest=count // 20)) for above in (True, False)]
    above, below = (image(scene, "direct", variant) for scene in scenes)
    e = irradiance(scenes[0])
    np.testing.assert_allclose(above.mean(), (0.25 * np.array(COLOR) * e).mean() / math.pi, rtol=0.1)
    np.testing.assert_allclose(below.mean(), 3.0 * above.mean(), rtol=0.1)


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_all_that_crosses_is_the_opaque_sheet_from_the_other_side(share: float):
    """One point, seen along a mirrored ray: to rounding the same picture of the ambient light, half hidden by a box."""
    black = attrs.evolve(box("black", (-0.4, 0.1, -1.4), 0.9), material=Material((0.0, 0.0, 0.0)))

    def ray(above: bool, share: float) -> Scene:
        scene = seen(share, black, above=above, ambient=Ambient(WHITE))
        return attrs.evolve(scene, camera=attrs.evolve(scene.camera, fov=1e-3))

    from_above, from_below = (
        image(ray(True, share), "ambient", "cosine", 16),
        image(ray(False, 1.0 - share), "ambient", "cosine", 16),
    )
    np.testing.assert_allclose(from_above, from_below, rtol=1e-9)
    hidden = from_above < np.array(COLOR) - 1e-9
    assert hidden.all() == (share == 1.0)


@pytest.mark.parametrize("variant", ["path", "next-event", "photon-map"])
def test_a_lantern(variant: str):
    """Of a closed sphere's light the share 1 - s goes on within, and s is seen from outside; it does not come back."""
    rho, share = 0.8, 0.5
    inside = unit_sphere(albedo=rho, intensity=math.pi)
    material = Material((rho, rho, rho), translucency=share)
    walls = attrs.evolve(inside.objects[0], material=material)
    photons = Photons(count=300, radius=0.6)
    # Convex: what is outside meets nothing.
    inside = attrs.evolve(inside, objects=(walls,), photons=photons, resolution=(2, 2))
    outside = attrs.evolve(inside, camera=Camera((0.0, -4.0, 0.0), (0.0, 0.0, 0.0), fov=8.0))
    e = math.pi / (1.0 - rho * (1.0 - share))
    for scene, part in ((inside, 1.0 - share), (outside, share)):
        found = image(scene, "direct", variant, 8 if variant == "path" else 2).mean()
        assert found == pytest.approx(rho * part * e / math.pi, rel=0.2)


def test_ambient_light_is_hidden_on_one_side():
    """A disc over the plate: `(1 - s) (1 - R² / (h² + R²)) + s`; an open side alone is not taken for both."""
    opaque = attrs.evolve(disc_over_plane(height=1.0, radius=1.0), resolution=(4, 4))
    share = 0.25
    plate_ = attrs.evolve(opaque.objects[0], material=Material(WHITE, translucency=share))
    scene = attrs.evolve(opaque, objects=(plate_, opaque.objects[1]))
    found = image(scene, "ambient", "cosine", 64)
    assert found.mean() == pytest.approx(0.75 * 0.5 + 0.25, rel=0.03)
    np.testing.assert_array_equal(found, image(scene, "ambient", "cosine", 64, without=("open",)))
    # Of a hollow body the outside is open, and no light comes from within.
    hollow = attrs.evolve(box("hollow", (-0.5, -0.5, -0.5)), material=Material(WHITE, translucency=share))
    alone = attrs.evolve(scene, objects=(hollow,), camera=Camera((3.0, -4.0, 2.0), (0.0, 0.0, 0.0), fov=8.0))
    found = image(alone, "ambient", "cosine", 64)
    assert found.mean() == pytest.approx(0.75, rel=0.02)
    np.testing.assert_array_equal(found, image(alone, "ambient", "cosine", 64, without=("open",)))
    # Within a range that ends before the disc both sides are open, and no ray is traced.
    near = attrs.evolve(scene, ambient=Ambient(WHITE, 0.5))
    with Engine(near) as engine:
        *_, (_, found, _) = engine.prefixes(find("ambient"), samples=4, seed=1, replicate=0)
        assert engine.counts["occlusion rays"] == 0
    np.testing.assert_array_equal(found, 1.0)


def test_a_chain_meets_the_far_side():
    """A mirror below the sheet, the light above it: in the mirror stands `w s E / pi` of the sheet."""
    mirror = plate(
        "mirror", (-30.0, -31.0, -2.0), (60.0, 0.0, 0.0), (0.0, 62.0, 0.0), Material(WHITE, 1.0, 1e-4, WHITE)
    )
    camera = Camera((0.3, -6.0, -1.0), (0.3, -3.5, -2.0), fov=0.01, pixel="centre")
    light = PointLight((0.5, 0.25, 1.5), (3.0, 2.0, 1.0))
    scene = seen(0.25, mirror, camera=camera, lights=(light,), scope="first-hit", max_bounces=1)
    # The ray goes on upwards as it came, and meets the sheet where one from the mirrored camera does.
    mirrored = attrs.evolve(scene, camera=Camera((0.3, -6.0, -3.0), (0.3, -3.5, -2.0), fov=0.01, pixel="centre"))
    expected = 0.25 * np.array(COLOR) * irradiance(mirrored) / math.pi
    for chain in ("next-event", "path"):
        found = renderer.render(scene, "specular", samples=4, chain=chain).mean
        np.testing.assert_allclose(found, expected, rtol=5e-3)


def test_opaque_surfaces_beside_a_translucent_one_have_their_bytes():
    """A floor over a leaf that is hidden below it: by kernels that know of both sides."""
    under = plate("leaf", (0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (0.0, 1.1, 0.0), Material(COLOR, translucency=0.5))
    light = PointLight((0.5, 0.25, 1.5), (3.0, 2.0, 1.0))
    plain, beside = (seen(0.0, *others, lights=(light,), ambient=Ambient(WHITE, 1.5)) for others in ((), (under,)))
    for term, variant in (("ambient", "cosine"), ("direct", "path")):
        np.testing.assert_array_equal(image(plain, term, variant, 8), image(beside, term, variant, 8))


def test_other_scenes_are_without():
    """What is None is left out of the kernels of a scene; the plan says where light crosses."""
    for name in library():
        scene = load(name)
        translucency = from_scene(scene).materials.translucency
        assert (translucency is not None) == (name == "leaf")
        chosen = {term: find(term) for term in VARIANTS}
        crossing = {step.term for step in plan(scene, chosen) if step.work == "light of the other side"}
        assert crossing == ({"ambient", "direct", "specular"} if name == "leaf" else set())
    black = seen(0.0)
    black = attrs.evolve(black, objects=(sheet(0.5, (0.0, 0.0, 0.0)),))
    assert from_scene(black).materials.translucency is None
