"""Light sampling that chooses among many emitters by what they may send to the point.

Rationale: any choice is unbiased whose probability is above 0 wherever light comes from: tested emitter by emitter.
The mean is held against the sum of the inverse squares, and the variance against the choice by power.
"""

import math

import attrs
import numpy as np
import pytest
import trimesh

from termwise.renderer import Engine, find
from termwise.renderer.arrays import MANY_EMITTERS, from_scene
from termwise.renderer.lights import bound, pick, pick_by_light
from termwise.renderer.plan import REDUCTIONS
from termwise.renderer.surface import Surface
from termwise.renderer.vector import Vec3
from termwise.scenes.load import load
from termwise.scenes.model import Camera, Material, Mesh, Object, PointLight, Scene

FLOOR = Mesh.from_arrays([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], [[0, 1, 2], [0, 2, 3]])
# A pinhole that sees the origin alone.
SPOT = Camera(position=(0.5, 0.0, 0.5), target=(0.0, 0.0, 0.0), fov=0.01)


def scene_of(lights: tuple[PointLight, ...], *others: Object) -> Scene:
    floor = Object("floor", FLOOR, Material(color=(0.5, 0.5, 0.5), gloss=0.0))
    return Scene("many", SPOT, (floor, *others), lights=lights, scope="first-hit", resolution=(2, 2))


def points(count: int) -> tuple[PointLight, ...]:
    """Near and far ones, a few below the floor."""
    rng = np.random.default_rng(3)
    place = rng.uniform((-6, -6, -1), (6, 6, 4), (count, 3))
    return tuple(PointLight(tuple(p), tuple(rng.uniform(0.5, 2.0, 3))) for p in place.tolist())


def lamp(shift: tuple[float, float, float]) -> Object:
    """A glowing cube: half of its faces look away."""
    cube = trimesh.creation.box((0.5, 0.5, 0.5))
    cube.apply_translation(shift)
    return Object("lamp", Mesh.from_arrays(cube.vertices, cube.faces), Material(), emission=(3.0, 2.0, 1.0))


def replicates(scene: Scene, without: tuple[str, ...], count: int, samples: int) -> np.ndarray:
    """Means of the picture, (count, 3)."""
    with Engine(scene, without=without) as engine:
        images = [
            list(engine.prefixes(find("direct"), samples=samples, seed=5, replicate=r))[-1][1] for r in range(count)
        ]
    return np.array(images).mean(axis=(1, 2))


@pytest.mark.slow
def test_point_lights_add_up(compiled):
    """E / pi = sum I cos / (pi d²) of those above the floor; the choice by power has many times the variance."""
    scene = scene_of(points(12))
    expected = sum(
        np.array(light.intensity) * light.position[2] / np.linalg.norm(light.position) ** 3
        for light in points(12)
        if light.position[2] > 0
    )
    samples, count = (256, 24) if compiled else (8, 6)
    chosen, by_power = (replicates(scene, without, count, samples) for without in ((), ("lights",)))
    for found in (chosen, by_power):
        error = found.std(axis=0, ddof=1) / math.sqrt(count)
        assert np.all(np.abs(found.mean(axis=0) - 0.5 / math.pi * expected) < 5 * error)
    assert chosen.var(axis=0, ddof=1).sum() < 0.2 * by_power.var(axis=0, ddof=1).sum()


def test_lamps_keep_their_mean(compiled):
    """Two glowing cubes, one of them half below the floor: both choices agree, and the one by light is the quieter."""
    scene = scene_of((), lamp((0.8, 0.3, 0.9)), attrs.evolve(lamp((-2.0, 1.0, 0.0)), name="other"))
    samples, count = (256, 24) if compiled else (8, 6)
    chosen, by_power = (replicates(scene, without, count, samples) for without in ((), ("lights",)))
    error = np.sqrt(chosen.var(axis=0, ddof=1) / count + by_power.var(axis=0, ddof=1) / count)
    assert np.all(np.abs(chosen.mean(axis=0) - by_power.mean(axis=0)) < 5 * error)
    assert chosen.var(axis=0, ddof=1).sum() < 0.7 * by_power.var(axis=0, ddof=1).sum()


def surface_at(x: float, y: float) -> Surface:
    """A point of the floor, seen from above."""
    up = Vec3(0.0, 0.0, 1.0)
    return Surface(Vec3(x, y, 0.0), up, up, 0, 0, 1.0, 0.0, 0.0)


def test_no_emitter_that_lights_a_point_is_left_out(compiled):
    """Random small lamps: a bound above 0 wherever a point of the face is above the floor and shows its front."""
    rng = np.random.default_rng(1)
    lamps = [
        Object(
            f"lamp {i}",
            Mesh.from_arrays(rng.normal((0, 0, 0.2), 0.7, (3, 3)), [[0, 1, 2]]),
            Material(),
            emission=(1.0, 1.0, 1.0),
        )
        for i in range(60 if compiled else 12)
    ]
    scene = scene_of((), *lamps)
    arrays = from_scene(scene)
    assert arrays.pick_by_light
    weights = rng.dirichlet((1, 1, 1), 200)
    useful = 0
    for x, y in rng.uniform(5, 8, (20 if compiled else 4, 2)):
        surface = surface_at(x, y)
        for index, face in enumerate(arrays.emitters.faces.face):
            corners = arrays.geometry.corners[face]
            way = weights @ corners - np.array(surface.point)
            lit = (way @ np.array(surface.normal) > 1e-9) & (way @ arrays.geometry.normals[face] < -1e-9)
            if lit.any():
                useful += 1
                assert bound(arrays, surface, index) > 0.0
    assert useful > 100 if compiled else useful > 5


def test_probabilities_are_those_of_the_choice(compiled):
    """Numbers u spread evenly pick each emitter as often as its probability says; those that light nothing never."""
    scene = scene_of(points(9))
    arrays = from_scene(scene)
    surface = surface_at(0.3, -0.2)
    count = 20_000 if compiled else 500
    picks = [pick_by_light(arrays, surface, (i + 0.5) / count) for i in range(count)]
    found = np.bincount([index for index, _, _ in picks], minlength=9) / count
    bounds = np.array([bound(arrays, surface, index) for index in range(9)])
    np.testing.assert_allclose(found, bounds / bounds.sum(), atol=2 / count)
    for index, probability, _ in picks[:: count // 50]:
        assert probability == pytest.approx(bounds[index] / bounds.sum(), rel=1e-12)
    assert (bounds == 0.0).any()


@pytest.mark.parametrize("by_light", [True, False])
def test_what_the_pick_leaves_is_spread_evenly(by_light, compiled):
    """Of each emitter's share of [0, 1), in order, it is [0, 1) again."""
    arrays = from_scene(scene_of(points(9)))
    count = 20_000 if compiled else 2000
    us = [(i + 0.5) / count for i in range(count)]
    picks = [pick_by_light(arrays, surface_at(0.3, -0.2), u) if by_light else pick(arrays.emitters.cdf, u) for u in us]
    for index in {index for index, _, _ in picks}:
        rest = np.array([left for chosen, _, left in picks if chosen == index])
        np.testing.assert_allclose(rest, (np.arange(len(rest)) + 0.5) / len(rest), atol=1.5 / len(rest))
        assert rest.max() < 1.0
    assert pick(arrays.emitters.cdf, math.nextafter(1.0, 0.0))[2] < 1.0


def test_a_lamp_of_two_triangles_is_one_rectangle(compiled):
    """Samples on it converge as a smooth integrand's, far faster than 1/N, which a pick apart would leave them."""
    if not compiled:
        pytest.skip("thousands of samples take minutes as plain Python")
    corners = [[-0.5, -0.5, 1.0], [-0.5, 0.5, 1.0], [0.5, 0.5, 1.0], [0.5, -0.5, 1.0]]
    square = Object("lamp", Mesh.from_arrays(corners, [[0, 1, 2], [0, 2, 3]]), Material(), emission=(1.0, 1.0, 1.0))
    few, many = (replicates(scene_of((), square), (), 200, samples) for samples in (1, 64))
    assert few.mean() > 0.0
    assert many.var(axis=0, ddof=1).sum() < 0.1 * few.var(axis=0, ddof=1).sum() / 64


def test_a_point_that_nothing_lights(compiled):
    scene = scene_of(tuple(PointLight((0.0, 0.0, -1.0 - i), (1.0, 1.0, 1.0)) for i in range(4)))
    arrays = from_scene(scene)
    assert pick_by_light(arrays, surface_at(0.0, 0.0), 0.5)[1] == 0.0
    assert not replicates(scene, (), 1, 2).any()


@pytest.mark.parametrize(("count", "serves"), [(1, False), (2, False), (3, True), (MANY_EMITTERS + 1, False)])
def test_few_and_very_many_are_chosen_by_power(count, serves, compiled):
    """Where there is nothing to choose, or too much to look at: the same bytes with the reduction and without."""
    scene = scene_of(points(count))
    assert from_scene(scene).pick_by_light == serves
    reason = REDUCTIONS["lights"].reason(scene, find("direct"), "next-event")
    assert (reason is not None) == serves
    if not serves:
        assert replicates(scene, (), 1, 4).tobytes() == replicates(scene, ("lights",), 1, 4).tobytes()


def test_the_paper_scenes_have_one_light():
    """A rectangle or a point: the reduction has nothing to do there."""
    for name in ("two_cubes", "cornell_box", "cornell_box_unshadowed", "monkey"):
        assert not from_scene(load(name)).pick_by_light
