"""A pixel replayed is the pixel rendered, bit for bit; what its trace says of a sample makes up that sample."""

import math
from typing import Any

import attrs
import numpy as np
import pytest

from termwise.renderer import VARIANTS, Engine
from termwise.renderer.replay import Replay, replay
from termwise.renderer.terms import Chain, Variant
from termwise.scenes.load import load
from termwise.scenes.model import Scene
from tests.scenes import of_glass

SETTINGS: dict[str, Any] = {"samples": 4, "seed": 5, "replicate": 3}


@pytest.fixture(scope="module")
def scene() -> Scene:
    """All light of a scene with roughness, gloss, an area light and a sky that is drawn, in few pixels."""
    box = load("cornell_box")
    return attrs.evolve(
        box,
        resolution=(12, 10),
        scope="all",
        draw_lights=True,
        sky=attrs.evolve(box.sky, color=(0.2, 0.3, 0.4)),
        photons=attrs.evolve(box.photons, count=800),
    )


def rendered(scene: Scene, variant: Variant, chain: Chain) -> np.ndarray:
    with Engine(scene) as engine:
        *_, (_, image, _) = engine.prefixes(variant, chain=chain, **SETTINGS)
    return image


EVERY = [(variant, "next-event") for table in VARIANTS.values() for variant in table.values()]
EVERY += [(VARIANTS["specular"]["vndf"], chain) for chain in ("path", "paper")]
# One of each way in which kernels add to a pixel.
SOON = VARIANTS["ambient"]["cosine"], VARIANTS["direct"]["next-event"], VARIANTS["background"]["seen"]
CASES = [pytest.param(*case, marks=() if case[0] in SOON else pytest.mark.slow) for case in EVERY]


@pytest.mark.parametrize(
    ("variant", "chain"), CASES, ids=lambda value: getattr(value, "name", value) if value else None
)
def test_replayed_pixel_is_the_rendered_one(variant: Variant, chain: Chain, scene: Scene):
    if variant.term == "transmission":
        scene = of_glass(attrs.evolve(load("two_cubes"), resolution=(12, 10), photons=scene.photons))
    image = rendered(scene, variant, chain)
    random = np.random.default_rng(len(variant.name))
    lit = np.argwhere(image.any(axis=2))
    for y, x in random.permuted(lit, axis=0)[:2] if len(lit) else [(2, 3)]:
        found = replay(scene, variant, x=int(x), y=int(y), chain=chain, **SETTINGS)
        assert found.value.tobytes() == image[y, x].tobytes()
        assert [sample.index for sample in found.samples] == [0, 1, 2, 3]
        assert found.astray == ()
        np.testing.assert_allclose(np.mean([s.radiance for s in found.samples], axis=0), found.value, 1e-14)
        for sample in found.samples:
            added = [event["radiance"] for event in sample.events if event["event"] == "adds"]
            np.testing.assert_allclose(np.sum(added, axis=0) if added else 0.0, sample.radiance, 1e-14)


def test_a_pixel_beside_all_objects_is_the_sky(scene: Scene):
    empty = attrs.evolve(scene, objects=scene.objects[:1], lights=(), resolution=(4, 4))
    away = attrs.evolve(empty, camera=attrs.evolve(scene.camera, target=(0.0, 0.0, 100.0)))
    found = replay(away, VARIANTS["background"]["seen"], x=0, y=0, **SETTINGS)
    assert found.value.tobytes() == rendered(away, VARIANTS["background"]["seen"], "next-event")[0, 0].tobytes()
    assert {event["event"] for event in found.samples[0].events} == {"camera ray", "miss", "adds"}


def events(found: Replay, name: str) -> list[dict[str, Any]]:
    return [event for sample in found.samples for event in sample.events if event["event"] == name]


def lit_pixel(scene: Scene, variant: Variant) -> tuple[int, int]:
    image = rendered(scene, variant, "next-event")
    y, x = np.unravel_index(np.argmax(image[..., 1]), image.shape[:2])
    return int(x), int(y)


def trace(scene: Scene, term: str, name: str) -> Replay:
    variant = VARIANTS[term][name]  # type: ignore[index]
    x, y = lit_pixel(scene, variant)
    return replay(scene, variant, x=x, y=y, **SETTINGS)


def test_vertices_lie_on_the_camera_ray_and_on_their_triangle(scene: Scene):
    found = trace(scene, "ambient", "cosine")
    meshes = {thing.name: thing.mesh for thing in scene.objects}
    for ray, vertex in zip(events(found, "camera ray"), events(found, "vertex"), strict=True):
        way = np.subtract(vertex["position"], ray["position"])
        np.testing.assert_allclose(way / np.linalg.norm(way), ray["direction"], atol=1e-9)
        mesh = meshes[vertex["object"]]
        a, b, c = mesh.vertices[mesh.faces[vertex["triangle"]]].astype(float)
        normal = np.cross(b - a, c - a)
        assert abs(normal @ (vertex["position"] - a)) <= 1e-9 * np.linalg.norm(normal)
        assert abs(normal @ vertex["normal"]) == pytest.approx(np.linalg.norm(normal))


def test_densities_are_those_of_the_estimators(scene: Scene):
    for drawn in events(trace(scene, "ambient", "uniform"), "ambient direction"):
        # The estimate of AO is the cosine over pi, over the density.
        assert drawn["weight"] == pytest.approx(drawn["local"][2] / math.pi / drawn["pdf"])
    for drawn in events(trace(scene, "ambient", "cosine"), "ambient direction"):
        assert drawn["weight"] == pytest.approx(drawn["local"][2] / math.pi / drawn["pdf"])


@pytest.mark.parametrize("lamps", [1, 2])
def test_density_of_light_sampling(lamps: int, scene: Scene):
    """All lights have one radiance L: E / pi is at most L / pi over the density. One lamp: by power, two: by light."""
    (emission,) = {thing.emission for thing in scene.objects if thing.emits}
    lit = [
        attrs.evolve(thing, emission=emission) if lamps == 2 and thing.name == "short block" else thing
        for thing in scene.objects
    ]
    lights = events(trace(attrs.evolve(scene, objects=tuple(lit)), "direct", "path"), "light")
    faces = [light for light in lights if light["pdf"]]
    assert faces
    for light in faces:
        assert light["probability"] < 1.0
        bound = np.array(emission) / math.pi / light["pdf"] * (1 + 1e-9)
        assert (np.array(light["unhidden"]) <= bound).all()


def test_photons_make_up_the_irradiance(scene: Scene):
    """The nearest: their flux over the disc. Simpson's kernel: weighted flux times 3 / (pi r²), over its mass."""
    for photons in events(trace(scene, "direct", "paper"), "photons"):
        assert photons["count"] == scene.photons.nearest == len(photons["gathered"])
        expected = np.array(photons["flux"]) / (math.pi * photons["radius"] ** 2)
        np.testing.assert_allclose(expected, photons["irradiance"], 1e-12)
    within = [each for each in events(trace(scene, "direct", "photon-map"), "photons") if each["count"]]
    assert within
    for photons in within:
        weighted = sum(each["weight"] * np.array(each["flux"]) for each in photons["gathered"])
        assert all(each["distance"] < photons["radius"] for each in photons["gathered"])
        peak = 3.0 / (math.pi * photons["radius"] ** 2)
        np.testing.assert_allclose(peak * weighted / photons["mass"], photons["irradiance"], 1e-12)


def test_roulette_ends_a_path_and_weights_the_survivors(scene: Scene):
    found = trace(scene, "direct", "path")
    decisions = events(found, "roulette")
    assert {decision["survives"] for decision in decisions} == {True, False}
    for sample in found.samples:
        names = [event["event"] for event in sample.events if event["event"] in ("gain", "roulette", "miss")]
        assert names.count("gain") == 1 + sum(
            event["event"] == "roulette" and event["survives"] for event in sample.events
        )


@pytest.mark.parametrize(("x", "y", "named"), [(12, 0, "x = 12"), (0, -1, "y = -1")])
def test_a_pixel_outside_is_refused(x: int, y: int, named: str, scene: Scene):
    with pytest.raises(ValueError, match=rf"{named}: allowed is an integer in \[0, "):
        replay(scene, VARIANTS["ambient"]["cosine"], x=x, y=y, **SETTINGS)
