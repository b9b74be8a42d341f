"""The paper's shadow rule: by hand on a plate under a screen, and ours against Mitsuba on the paper's scenes."""

import attrs
import numpy as np
import pytest

from termwise import reference, renderer
from termwise.renderer.terms import find
from termwise.reports.statistics.rule import judge
from termwise.scenes.analytic import plate
from termwise.scenes.limits import Limit
from termwise.scenes.model import Ambient, Camera, Color, Material, Object, PointLight, Scene, Toggles
from tests.scenes import small

COLOR, GLOSS, AMBIENT = 0.6, 0.25, 0.5


def grey(value: float) -> Color:
    return value, value, value


def under_a_screen(*, lamp: bool) -> Scene:
    """A glossy plate; a screen at height 1 over x > 0; the light at height 2: a point, or a lamp around it.

    The light's centre (0, 0, 2) is hidden from x > 0, and nothing else is.
    """
    material = Material(grey(COLOR), gloss=GLOSS, roughness=0.5, f0=grey(1.0))
    floor = plate("floor", (-3.0, -3.0, 0.0), (6.0, 0.0, 0.0), (0.0, 6.1, 0.0), material)
    screen = plate("screen", (0.0, -9.0, 1.0), (9.0, 0.0, 0.0), (0.0, 18.2, 0.0))
    light = plate("lamp", (-0.5, -0.5, 2.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    return Scene(
        "screen",
        # From below the screen's height, so that it hides nothing of the floor.
        Camera((0.0, -2.9, 0.8), (0.0, 1.0, 0.0), fov=60.0, pixel="centre"),
        (floor, screen, *((Object("lamp", light.mesh, emission=grey(9.0)),) if lamp else ())),
        lights=() if lamp else (PointLight((0.0, 0.0, 2.0), grey(5.0)),),
        ambient=Ambient(grey(AMBIENT)),
        toggles=Toggles(ambient_occlusion=False),
        resolution=(16, 12),
        scope="first-hit",
        shadows="paper",
    )


@pytest.mark.rare
@pytest.mark.parametrize("lamp", [False, True])
def test_dark_points_have_the_whole_color_and_nothing_else(lamp: bool):
    scene = under_a_screen(lamp=lamp)
    axes = [(np.arange(n) + 0.5) / n for n in scene.resolution]
    directions = scene.camera.rays(np.stack(np.meshgrid(*axes), axis=-1), aspect=scene.aspect)
    on_floor = directions[..., 2] < 0
    x = directions[..., 0] * (-scene.camera.position[2] / np.where(on_floor, directions[..., 2], -1.0))
    y = scene.camera.position[1] + directions[..., 1] * (-0.8 / np.where(on_floor, directions[..., 2], -1.0))
    # The edge of the lamp's own shadow is at x = 0; the floor ends at 3.
    seen = on_floor & (np.abs(x) < 3) & (np.abs(y) < 3) & (np.abs(x) > 0.02)
    dark = seen & (x > 0)
    lit = seen & (x < 0)
    assert dark.sum() > 20
    assert lit.sum() > 20
    images = {term: renderer.render(scene, term, samples=4).mean[..., 0] for term in ("ambient", "direct", "specular")}
    np.testing.assert_allclose(images["ambient"][dark], COLOR * AMBIENT, rtol=1e-12)
    np.testing.assert_allclose(images["ambient"][lit], COLOR * (1 - GLOSS) * AMBIENT, rtol=1e-12)
    assert (images["direct"][dark] == 0).all()
    assert (images["direct"][lit] > 0).all()
    assert (images["specular"][dark] == 0).all()
    # The same by Mitsuba, from its own rays.
    for term in ("ambient", "direct"):
        by_mitsuba = reference.replicate(scene, find(term).limit(scene, 1), spp=4, seed=3)[..., 0]
        assert ((by_mitsuba[seen] == 0) == (images[term][seen] == 0)).all()
        if term == "ambient":
            np.testing.assert_allclose(by_mitsuba[seen], images[term][seen], rtol=1e-6)


@pytest.mark.rare
def test_without_lights_nothing_is_dark():
    scene = attrs.evolve(under_a_screen(lamp=False), lights=())
    paper = renderer.render(scene, "ambient", samples=1)
    plain = renderer.render(attrs.evolve(scene, shadows="physical"), "ambient", samples=1)
    np.testing.assert_array_equal(paper.mean, plain.mean)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "term"), [("monkey", "ambient"), ("cornell_box", "direct"), ("cornell_box", "specular")]
)
def test_both_sides_agree(name: str, term: str):
    """Ours against Mitsuba's, EQUIVALENT; and the rule changes the mean by more than the margin."""
    scene = small(name, 32, shadows="paper")
    variant = find(term)
    limit = variant.limit(scene, 32)
    ours = []
    with renderer.Engine(scene) as engine:
        for replicate in range(16):
            *_, (_, image, _) = engine.prefixes(variant, samples=32, seed=1, replicate=replicate)
            ours.append(image)
    theirs = [reference.replicate(scene, limit, spp=64, seed=1, replicate=k) for k in range(16)]
    outcome = judge(ours, theirs)
    assert outcome.verdict in ("EQUIVALENT", "UNDERPOWERED"), outcome.sentence
    assert abs(outcome.bias) < 5 * outcome.standard_error
    plain: Limit = attrs.evolve(limit, shadows="physical")
    without = reference.replicate(scene, plain, spp=64, seed=1)
    assert abs(without.mean() / np.mean(theirs) - 1) > 0.01
