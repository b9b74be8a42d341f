"""Glass that casts no shadow: shadow and occlusion rays, and photons on their way, lose `transparency tint` a passage.

Rationale: a convex shell around all that is seen is passed once by each ray that leaves it. With the same random
numbers every pixel of ambient and direct light is then the one without the shell, times what the shell leaves.
"""

from typing import Any

import attrs
import numpy as np
import pytest

from termwise.renderer import Engine, find, photon_tracing
from termwise.renderer.arrays import from_scene
from termwise.renderer.plan import plan
from termwise.renderer.replay import replay
from termwise.renderer.rng import root
from termwise.renderer.scratch import new_scratch
from termwise.renderer.sobol import Sampler
from termwise.renderer.surface import Surface, beyond
from termwise.renderer.terms import DEFAULTS
from termwise.renderer.vector import Vec3
from termwise.scenes.analytic import plate
from termwise.scenes.model import Ambient, Camera, Material, Object, Photons, PointLight, Scene, SunLight
from termwise.scenes.terms import Term
from tests.scenes import box

WHITE = (1.0, 1.0, 1.0)
BLACK = (0.0, 0.0, 0.0)
THIN = Material(BLACK, 0.5, 0.1, transparency=0.8, tint=(1.0, 0.5, 0.25), occludes=False)
LEFT = 0.8 * np.array(THIN.tint)
FAINT = Material((1e-6, 1e-6, 1e-6))


pytestmark = pytest.mark.plain


def shell(side: float, material: Material = THIN) -> Object:
    return attrs.evolve(box(f"shell {side:g}", (-side / 2, -side / 2, -side / 2), side), material=material)


def inside(*around: Object, **changes: Any) -> Scene:
    """A cube on a floor, lights of all kinds of targets far outside, and what is around."""
    floor = plate("floor", (-1.0, -1.1, -0.51), (2.0, 0.0, 0.0), (0.0, 2.1, 0.0))
    lamp = attrs.evolve(plate("lamp", (-1.0, -1.0, 9.0), (0.0, 2.0, 0.0), (2.0, 0.0, 0.0)), emission=(90.0,) * 3)
    lights = (PointLight((5.0, -8.0, 6.0), (70.0, 60.0, 50.0)), SunLight((0.2, 0.4, -1.0), WHITE, angle=20.0))
    camera = Camera((0.5, -1.8, 1.2), (0.0, 0.0, -0.1), fov=50.0)
    things = (floor, box("cube", (-0.5, -0.4, -0.5), 0.8), lamp, *around)
    scene = Scene("room", camera, things, lights, ambient=Ambient(WHITE), resolution=(4, 4), photons=Photons(400, 0.5))
    return attrs.evolve(scene, **changes)


def image(scene: Scene, term: Term, variant: str) -> np.ndarray:
    with Engine(scene, threads=1, without=("open",)) as engine:
        *_, (_, found, _) = engine.prefixes(find(term, variant), samples=4, seed=1, replicate=0)
    return found


@pytest.mark.parametrize(
    ("term", "variant", "changes"),
    [
        ("ambient", "cosine", {}),
        ("ambient", "uniform", {"ambient": Ambient(WHITE, range=9.0)}),
        ("direct", "path", {}),
        ("direct", "next-event", {"scope": "first-hit"}),
    ],
)
def test_every_pixel_is_dimmed_by_what_shells_leave(term: Term, variant: str, changes: dict[str, Any]):
    bare, one, two = (inside(*around, **changes) for around in ((), (shell(5.0),), (shell(5.0), shell(6.0))))
    right = image(bare, term, variant)
    assert (right.max(axis=2) > 0.0).mean() > 0.5
    np.testing.assert_allclose(image(one, term, variant), LEFT * right, rtol=1e-9)
    np.testing.assert_allclose(image(two, term, variant), LEFT**2 * right, rtol=1e-9)
    dark = image(inside(shell(5.0, attrs.evolve(THIN, occludes=True)), **changes), term, variant)
    np.testing.assert_array_equal(dark, 0.0 if "ambient" not in changes else dark)


def test_a_shell_beyond_the_range_hides_nothing():
    near = {"ambient": Ambient(WHITE, range=0.6)}
    right = image(inside(**near), "ambient", "cosine")
    np.testing.assert_array_equal(image(inside(shell(5.0), **near), "ambient", "cosine"), right)


def test_vertices_of_chains_have_that_light_too():
    """Of light samples and occlusion rays one by one, as of those in waves."""
    mirror = plate("mirror", (-3.0, 2.0, -3.0), (6.0, 0.0, 0.0), (0.0, 0.0, 6.0), Material(BLACK, 1.0, 1e-4, WHITE))
    camera = Camera((0.3, -2.0, 0.5), (0.0, 2.0, 0.4), fov=8.0, pixel="centre")
    changes = {"camera": camera, "scope": "first-hit", "max_bounces": 1}
    seen = [image(inside(mirror, *around, **changes), "specular", "vndf") for around in ((), (shell(8.0),))]
    assert seen[0].any()
    np.testing.assert_allclose(seen[1], LEFT * seen[0], rtol=1e-9)


PANE = plate("pane", (-50.0, -51.0, 1.0), (100.0, 0.0, 0.0), (0.0, 102.0, 0.0), THIN)


def test_photons_fly_on_through_a_pane():
    """What lands behind it is what would land without it, times what is left."""
    floor = plate("floor", (-40.0, -41.0, 0.0), (80.0, 0.0, 0.0), (0.0, 82.0, 0.0), FAINT)
    camera, light = Camera((0.3, -4.0, 0.5), (0.0, 0.0, 0.2)), PointLight((0.0, 0.0, 2.0), WHITE)

    def landed(*things: Object, first_hits: bool) -> np.ndarray:
        with Engine(Scene("pane", camera, things, (light,)), threads=1) as engine:
            rule = photon_tracing.Scattering(0.0, True, False, False, False)
            options: dict[str, Any] = {"count": 200, "radius": 0.5, "shape": "simpson", "rule": rule}
            photons = photon_tracing.emit(
                engine.arrays, root(1, 0), 0, first_hits=first_hits, pool=engine.pool, scratch=new_scratch, **options
            )
        return photons.power.sum(axis=1)

    right = landed(floor, first_hits=True)
    assert right.min() > 1.0
    np.testing.assert_allclose(landed(floor, PANE, first_hits=True), LEFT * right, rtol=1e-5)
    # They come straight from the light: light sampling counts them, where it stands in the place of first hits.
    assert landed(floor, PANE, first_hits=False).max() < 1e-3 * right.max()


def test_photons_scatter_besides():
    """By chance one of the two, and neither loses flux by it; light that has been scattered does not fly on."""
    milky = attrs.evolve(PANE, material=attrs.evolve(THIN, color=(0.9, 0.5, 0.1), gloss=0.0))
    arrays = from_scene(Scene("pane", Camera((0.3, -4.0, 0.5), (0.0, 0.0, 0.2)), (milky,)))
    surface = Surface(Vec3(0.0, 0.0, 1.0), Vec3(0.0, 0.0, 1.0), Vec3(0.0, 0.0, 1.0), 0, 0, 1.0, 0.3, 0.3)
    passing, key = arrays.materials.passing, root(1, 0)
    flux = np.zeros((2, 3))
    for index in range(512):
        flies, factor = photon_tracing._pass(arrays, passing, True, surface, Sampler(key, np.uint32(index)))
        flux[int(flies)] += np.array(factor) / 512
    np.testing.assert_allclose(flux, np.array([WHITE, LEFT]), rtol=0.01)
    assert photon_tracing._pass(arrays, passing, False, surface, Sampler(key, np.uint32(0))) == (False, Vec3(*WHITE))


def test_through_an_edge_is_one_passage():
    """Lines from outside through vertices, edges and diagonals of a box leave it again once."""
    scene = inside(shell(2.0), attrs.evolve(shell(3.0), material=THIN))
    scene = attrs.evolve(scene, objects=scene.objects[3:], lights=())
    arrays, scratch = from_scene(scene), new_scratch()
    passing, light = arrays.materials.passing, Vec3(*WHITE)
    random = np.random.default_rng(1)
    corners = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)]) * 2.0 - 1.0
    for a, b in random.integers(8, size=(200, 2)):
        on_edge = corners[a] + (corners[b] - corners[a]) * random.choice([0.0, 0.25, 0.5, random.random()])
        within = random.uniform(-0.9, 0.9, 3)
        way = within - on_edge
        start = on_edge - 3.0 * way / np.abs(way).max()
        found = beyond(arrays, passing, light, Vec3(*start), -1, Vec3(*(way / 3.0)), np.inf, -1, scratch)
        np.testing.assert_allclose(found, LEFT**4, rtol=1e-12)
        middle = beyond(arrays, passing, light, Vec3(*within), -1, Vec3(*-way), np.inf, -1, scratch)
        np.testing.assert_allclose(middle, LEFT**2, rtol=1e-12)


def test_scenes_without_it_have_nothing_of_it():
    """No argument that a kernel is compiled for, and no step; with it the plan names what is gone through."""
    assert from_scene(inside(shell(5.0, attrs.evolve(THIN, occludes=True)))).materials.passing is None
    for around, terms in (((), []), ((shell(5.0),), ["ambient", "direct", "specular", "transmission"])):
        scene = attrs.evolve(inside(*around))
        steps = plan(scene, {term: find(term, name) for term, name in DEFAULTS.items()})
        assert [step.term for step in steps if step.work == "light through glass"] == terms
    assert {step.reason for step in steps if step.work == "light through glass"} == {
        "shadow and occlusion rays go through shell 5"
    }


def test_a_replayed_pixel_tells_what_is_left():
    scene = inside(shell(5.0), lights=())
    x, y = 2, 2
    right = image(scene, "ambient", "cosine")[y, x]
    found = replay(scene, find("ambient"), x=x, y=y, samples=4, seed=1, replicate=0)
    assert found.astray == ()
    np.testing.assert_allclose(found.value, right, rtol=1e-12)
    events = [event for sample in found.samples for event in sample.events if event["event"] == "goes through"]
    assert events
    for event in events:
        assert not np.any(event["left"]) or np.allclose(event["left"], LEFT)
