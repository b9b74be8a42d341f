"""`auto`, the direct term's default: what it takes where, and that it is what it takes."""

import itertools
import json

import attrs
import numpy as np
import pytest

from termwise import renderer
from termwise.renderer import VARIANTS, chosen
from termwise.renderer.arrays import FAINT, MAX_SURVIVAL
from termwise.renderer.auto import choice, paths_over_photons, pilot
from termwise.renderer.plan import plan
from termwise.renderer.terms import AUTO, names, register
from termwise.reports.cli import app
from termwise.reports.jobs import cells
from termwise.scenes.load import load
from termwise.scenes.model import Camera, Material, Mesh, Object, PointLight, Scene, Toggles
from termwise.scenes.terms import TERMS
from tests.scenes import box, small

WHITE = (1.0, 1.0, 1.0)
CAMERA = Camera((0.1, -0.4, 0.2), (0.0, 0.0, 0.0), fov=90.0)


def grey(albedo: float) -> Material:
    return Material((albedo, albedo, albedo))


def room(albedo: float, lamp: tuple[float, float, float] = (0.4, 0.4, 0.4)) -> Scene:
    """A cube around the camera, and a lamp in its corner."""
    cube = attrs.evolve(box("room", (-0.5, -0.5, -0.5)), material=grey(albedo))
    return Scene("room", CAMERA, (cube,), (PointLight(lamp, WHITE),), resolution=(6, 6))


def globe(albedo: float) -> Scene:
    """A sphere around the camera, and a lamp in its middle: the same light everywhere."""
    turn, fall = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 65), np.linspace(0.0, np.pi, 33))
    points = np.stack([np.sin(fall) * np.cos(turn), np.sin(fall) * np.sin(turn), np.cos(fall)], axis=-1)
    corners = [65 * row + column for row, column in itertools.product(range(32), range(64))]
    faces = [face for a in corners for face in ((a, a + 65, a + 1), (a + 1, a + 65, a + 66))]
    thing = Object("globe", Mesh(points.reshape(-1, 3), np.array(faces)), grey(albedo))
    return Scene("globe", CAMERA, (thing,), (PointLight((0.0, 0.0, 0.0), WHITE),), resolution=(6, 6))


def by_roulette(albedo: float) -> tuple[float, float]:
    """Rays a path and its relative variance, where every vertex receives the same: by the roulette alone.

    A path of L vertices gathers t_1 + ... + t_L, each t the one before times albedo / P, P the probability to go on.
    """
    throughput, alive, gathered = 1.0, 1.0, 0.0
    rays = mean = square = 0.0
    while alive > 1e-9:
        gathered += throughput
        rays += alive
        mean += alive * throughput
        survival = min(MAX_SURVIVAL, albedo * throughput / FAINT)
        square += alive * (1.0 - survival) * gathered**2
        alive *= survival
        throughput *= albedo / survival
    assert mean == pytest.approx(1.0 / (1.0 - albedo))
    return rays, square / mean**2 - 1.0


@pytest.mark.parametrize("albedo", [0.3, 0.6, 0.9])
def test_in_a_sphere_it_is_that_of_the_roulette(albedo):
    """2048 paths know a variance to some per cent; the sphere is of facets."""
    rays, variance = by_roulette(albedo)
    found = pilot(globe(albedo))
    assert found.rays == pytest.approx(rays, rel=0.05)
    assert found.variance == pytest.approx(variance, rel=0.2)
    assert found.seen == 1.0


def test_nothing_comes_back_in_the_open():
    """To a plate, nor to the outside of a convex body: paths end at once, and the light of a point has no noise."""
    plate = attrs.evolve(load("two_cubes").objects[0], material=grey(0.9))
    for thing in (plate, box("cube", (-0.5, -0.5, -0.5))):
        camera, lamp = Camera((0.3, -2.0, 8.0), (0.0, 0.0, 0.0)), PointLight((0.0, -3.0, 9.0), WHITE)
        scene = Scene("open", camera, (thing,), (lamp,), resolution=(512, 512))
        found = pilot(scene)
        assert (found.rays, 0.0 < found.seen) == (1.0, True)
        assert found.variance < 1e-20
        assert choice(scene).name == "path"


def test_photons_where_light_is_trapped():
    """In a white furnace with a lamp in its corner; never with first hits, nor without a light."""
    furnace = room(0.95)
    furnace = attrs.evolve(furnace, resolution=(256, 256))
    assert choice(furnace).name == "next-event"
    assert choice(room(0.1)).name == "path"
    assert choice(attrs.evolve(furnace, scope="first-hit")) == ("next-event", "")
    assert choice(attrs.evolve(furnace, toggles=Toggles(lighting=False))) == ("next-event", "")


def test_what_one_of_them_cannot_follow_is_the_others():
    scene = small("two_cubes")
    assert choice(scene).name == "path"
    assert choice(attrs.evolve(scene, photons=attrs.evolve(scene.photons, scattering="full"))).name == "next-event"
    furnace = attrs.evolve(room(0.95), resolution=(256, 256))
    assert choice(furnace).name == "next-event"
    assert choice(attrs.evolve(furnace, normals="face")).name == "path"


@pytest.mark.parametrize("name", ["two_cubes", "monkey", pytest.param("leaf", marks=pytest.mark.rare)])
def test_scenes_of_the_library(name):
    """Light is trapped in a lantern, which paths seldom find; it escapes from cubes, and from a head."""
    assert choice(attrs.evolve(load(name), scope="all")).name == ("next-event" if name == "leaf" else "path")


def test_it_depends_on_the_scene_alone():
    """Its paths are the same ones at any resolution; more pixels, and fewer photons, are in favour of photons."""
    scene = small("cornell_box_unshadowed", 64)
    found = pilot(scene)
    assert pilot(scene) == found
    assert pilot(attrs.evolve(scene, resolution=(7, 40))) == found
    fewer = attrs.evolve(scene, photons=attrs.evolve(scene.photons, count=scene.photons.count // 4))
    assert pilot(fewer) == found
    larger = attrs.evolve(scene, resolution=(128, 128))
    assert paths_over_photons(fewer) == paths_over_photons(larger) > 1.5 * paths_over_photons(scene)
    walls = tuple(thing for thing in scene.objects if "wall" not in thing.name and thing.name != "ceiling")
    open_box = attrs.evolve(scene, objects=walls)
    assert pilot(open_box).rays < 0.5 * found.rays, "light escapes"
    assert paths_over_photons(open_box) < 0.5 * paths_over_photons(scene)


def test_nothing_is_seen():
    """By a camera that looks away: paths cost nothing."""
    scene = small("two_cubes")
    camera = attrs.evolve(scene.camera, target=(0.5, -90.0, 40.0))
    assert pilot(attrs.evolve(scene, camera=camera)) == (0.0, 0.0, 0.0)
    assert choice(attrs.evolve(scene, camera=camera)).name == "path"


@pytest.mark.parametrize(("scene", "taken"), [(small("two_cubes", 6), "path"), (room(0.95), "next-event")])
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("seed", [0, 7])
def test_its_images_are_those_of_what_it_takes(scene, taken, threads, seed):
    scene = attrs.evolve(scene, photons=attrs.evolve(scene.photons, count=30))
    assert chosen(scene, "direct").name == taken
    asked = {"samples": 2, "seed": seed, "threads": threads}
    expected = renderer.render(scene, "direct", variant=taken, **asked).mean
    for variant in (None, AUTO):
        assert renderer.render(scene, "direct", variant=variant, **asked).mean.tobytes() == expected.tobytes()


def test_what_is_taken_is_the_named_one_and_says_why():
    scene = small("two_cubes", 6)
    found = chosen(scene, "direct")
    assert found == VARIANTS["direct"]["path"]
    assert cells.key(scene, found, samples=1, seed=0, chain="path") == cells.key(
        scene, VARIANTS["direct"]["path"], samples=1, seed=0, chain="path"
    )
    assert f"about {paths_over_photons(scene):.2g} times" in found.chosen
    steps = plan(scene, {term: chosen(scene, term) for term in TERMS})
    assert [step.reason for step in steps if step.term == "direct"][0] == f"auto: {found.chosen}"
    assert chosen(scene, "direct", "path").chosen == "", "it was named"
    straight = attrs.evolve(scene, scope="first-hit")
    assert (chosen(straight, "direct").name, chosen(straight, "direct").chosen) == ("next-event", "")


def test_only_direct_has_it():
    assert names("direct") == (AUTO, *VARIANTS["direct"])
    for term in (term for term in TERMS if term != "direct"):
        assert names(term) == tuple(VARIANTS[term])
        assert chosen(small("two_cubes"), term) is VARIANTS[term][names(term)[0]]
    for term, name, allowed in (("direct", "magic", "auto, next-event, path"), ("ambient", AUTO, "cosine")):
        with pytest.raises(ValueError, match=rf"variant = '{name}' of {term}: allowed are {allowed}"):
            chosen(small("two_cubes"), term, name)
    with pytest.raises(ValueError, match="term = 'glow': allowed are ambient"):
        chosen(small("two_cubes"), "glow")
    limit = VARIANTS["direct"]["path"].limit(small("two_cubes"), 1)
    with pytest.raises(ValueError, match="name = 'auto' of direct: exists"):
        register("direct", AUTO, lambda scene, samples, seed: np.zeros(()), limit)


def test_a_rendering_says_what_it_took(tmp_path, capsys):
    words = ["render", "two_cubes", "--term", "direct", "--samples", "1", "--resolution", "6", "6", "--json"]
    said = []
    for more in ([], ["--variant", "auto"], ["--variant", "path"]):
        assert app([*words, "--out", str(tmp_path), *more], exit_on_error=False, result_action="return_value") == 0
        said.append(json.loads(capsys.readouterr().out))
    assert [each["settings"]["variants"] for each in said] == 3 * [{"direct": "path"}]
    why = choice(small("two_cubes", 6)).reason
    assert [each["settings"]["auto"] for each in said] == [{"direct": why}, {"direct": why}, {}]
    assert said[0]["terms"]["direct"]["mean"] == said[2]["terms"]["direct"]["mean"]
