"""Photons aimed at the scene: the cone holds all of it, and fewer photons land the same flux.

Rationale: an reduction may change noise and time, never a mean. The flux that lands is compared with a closed form, the
image with the image of photons sent everywhere; a search for the k nearest, whose mean depends on how many photons are
emitted, is left alone.
"""

import math
from concurrent.futures import ThreadPoolExecutor

import attrs
import numpy as np
import pytest

from termwise.renderer import Engine, Variant, find
from termwise.renderer.arrays import emitters_of, from_scene
from termwise.renderer.lights.aim import cone
from termwise.renderer.photon_map import PhotonMap
from termwise.renderer.photon_tracing import Scattering, emit
from termwise.renderer.plan import plan
from termwise.renderer.rng import root
from termwise.renderer.scratch import new_scratch
from termwise.scenes.analytic import closed_box, plate
from termwise.scenes.load import load
from termwise.scenes.model import Camera, Material, PointLight, Scene
from termwise.scenes.terms import TERMS, Term
from tests.scenes import small


def emitted(scene: Scene, index: int, count: int, *, aimed: bool, independent: bool = False) -> PhotonMap:
    """All photons of a pass that land."""
    with ThreadPoolExecutor(1) as pool:
        return emit(
            from_scene(scene),
            root(1, 0),
            index,
            count=count,
            radius=0.2,
            shape="simpson",
            rule=Scattering(0.0, weighted=True, full=False, independent=independent, aimed=aimed),
            first_hits=True,
            pool=pool,
            scratch=new_scratch,
        )


def test_the_cone_holds_every_point():
    """Random clouds from outside: all vertices, and all points between them, within the half angle."""
    rng = np.random.default_rng(3)
    narrow = 0
    for _ in range(100):
        vertices = rng.normal(size=(int(rng.integers(3, 40)), 3)) * rng.uniform(0.1, 2.0, 3)
        position = rng.normal(size=3) * 3.0
        axis, cosine = cone(position, vertices)
        weights = rng.dirichlet(np.ones(len(vertices)) * 0.1, size=200)
        points = np.concatenate([vertices, weights @ vertices]) - position
        cosines = points @ np.array(axis) / np.linalg.norm(points, axis=1)
        assert (cosines >= cosine).all()
        assert np.linalg.norm(axis) == pytest.approx(1.0, abs=1e-15)
        narrow += cosine > 0.0
    assert narrow > 50


def test_the_cone_is_narrow():
    """Around a square below its centre the narrowest goes through its corners: cos a = h / sqrt(h² + 2 s²)."""
    square = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    axis, cosine = cone(np.array([0.0, 0.0, 2.0]), square)
    np.testing.assert_allclose(axis, (0.0, 0.0, -1.0), atol=1e-9)
    assert cosine == pytest.approx(2.0 / math.sqrt(6.0), abs=1e-6)
    # Off the centre the one by steps may be wider than the narrowest, by little.
    _, cosine = cone(np.array([1.0, 1.0, 2.0]), square)
    best = math.cos(0.5 * math.acos(2.0 / math.sqrt(12.0)))
    assert best - 0.03 < cosine < best + 1e-9


@pytest.mark.parametrize("position", [(0.0, 0.0, 0.0), (0.5, 0.5, 0.5), (0.49, 0.0, 0.0)])
def test_all_directions_from_within(position):
    """Inside a cube, at one of its corners, close to a face: no cone."""
    corners = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)]) - 0.5
    assert cone(np.array(position), corners)[1] == -1.0


def over_a_plate(height: float = 0.7, intensity: float = 3.0) -> Scene:
    """A point light over a plate of 2 x 1, off its centre; nothing that scatters lands again."""
    floor = plate("floor", (-0.5, -0.25, 0.0), (2.0, 0.0, 0.0), (0.0, 1.0, 0.0), Material((0.5, 0.5, 0.5)))
    light = PointLight((0.0, 0.0, height), (intensity, intensity, intensity))
    return Scene("plate", Camera((0.0, -3.0, 1.0), (0.0, 0.0, 0.0)), (floor,), lights=(light,))


def solid_angle(height: float) -> float:
    """Of the plate, by quadrants: atan(ab / (h sqrt(a² + b² + h²))) each."""
    return sum(
        math.atan(a * b / (height * math.sqrt(a * a + b * b + height * height)))
        for a in (0.5, 1.5)
        for b in (0.25, 0.75)
    )


def test_aimed_photons_land_the_flux_of_the_solid_angle(compiled):
    """I times the solid angle of the plate, aimed or not; aimed, by a share of the photons, more of which land.

    Of independent photons a part p lands, or p / share of those that are aimed: the flux has the relative variance
    `(1 - p) / (n p)`, or `(1 - p / share) / (n p)`.
    """
    scene, count = over_a_plate(), 1000 if compiled else 60
    share = emitters_of(scene).share
    assert 0.1 < share < 0.4
    found = {}
    for aimed in (True, False):
        maps = [emitted(scene, i, count, aimed=aimed, independent=True) for i in range(40)]
        flux = np.array([photons.power[1].sum() for photons in maps])
        expected, error = 3.0 * solid_angle(0.7), flux.std(ddof=1) / math.sqrt(len(flux))
        assert abs(flux.mean() - expected) < 4.5 * error
        assert error < (0.02 if compiled else 0.1) * expected
        found[aimed] = np.mean([len(photons.face) for photons in maps]), flux.std(ddof=1)
    # As many land: what is left out would have missed.
    assert found[True][0] == pytest.approx(found[False][0], rel=0.05 if compiled else 0.15)
    part = solid_angle(0.7) / (4 * math.pi)
    assert math.sqrt((1 - part / share) / (1 - part)) < 0.8
    assert found[True][1] < found[False][1]


def test_lights_within_are_not_aimed(compiled):
    """In a closed box all directions meet a wall: the same bytes."""
    scene = closed_box()
    one, other = (emitted(scene, 0, 100, aimed=aimed) for aimed in (True, False))
    assert emitters_of(scene).share == 1.0
    assert one.power.tobytes() == other.power.tobytes()
    assert one.position.tobytes() == other.position.tobytes()


def test_lights_of_both_kinds_are_picked_by_what_they_send(compiled):
    """A point light with a cone and one without: each photon carries the same power, the sum of both over the count."""
    scene = over_a_plate()
    near = PointLight((0.3, 0.2, 1e-3), (0.5, 0.5, 0.5))
    inside = attrs.evolve(scene, lights=(*scene.lights, near), objects=(*scene.objects, *closed_box().objects))
    found = emitters_of(scene), emitters_of(inside)
    assert found[0].share < 1.0
    assert found[1].share == 1.0
    arrays = from_scene(scene).emitters
    for field in ("cdf", "aimed"):
        np.testing.assert_array_equal(getattr(found[0], field), getattr(arrays, field))
    for field in ("axis", "cosine"):
        np.testing.assert_array_equal(getattr(found[0].points, field), getattr(arrays.points, field))
    two = attrs.evolve(scene, lights=(*scene.lights, PointLight((3.0, 0.0, 4.0), (50.0, 50.0, 50.0))))
    photons = emitted(two, 0, 500, aimed=True)
    emitters = emitters_of(two)
    angles = 2 * math.pi * (1 - emitters.points.cosine)
    sent = max(1, math.ceil(500 * emitters.share))
    np.testing.assert_allclose(photons.power.T, (angles @ (3.0, 50.0)) / sent, rtol=1e-9)


@pytest.mark.parametrize(
    ("term", "variant"), [("direct", "next-event"), ("direct", "photon-map"), ("specular", "vndf")]
)
def test_the_mean_image_is_that_of_all_photons(term, variant, compiled):
    """Replicates aimed and not: the difference of the means within 4.5 standard errors, and fewer photons."""
    scene = attrs.evolve(load("monkey"), resolution=(12, 12) if compiled else (3, 3))
    scene = attrs.evolve(scene, photons=attrs.evolve(scene.photons, count=8000 if compiled else 40, radius=0.3))
    means, photons = [], []
    for without in ((), ("aimed",)):
        with Engine(scene, without=without) as engine:
            images = [
                list(engine.prefixes(find(term, variant), samples=4, seed=1, replicate=r))[-1][1].mean()
                for r in range(24 if compiled else 4)
            ]
            means.append(np.array(images))
            photons.append(engine.counts["photons"])
    error = math.sqrt(sum(values.var(ddof=1) / len(values) for values in means))
    assert abs(means[0].mean() - means[1].mean()) < 4.5 * error
    if compiled:
        assert error < 0.02 * means[1].mean()
    passes = photons[1] // scene.photons.count
    assert photons[0] == passes * math.ceil(scene.photons.count * emitters_of(scene).share)
    variants: dict[Term, Variant] = {each: find(each, variant if each == term else None) for each in TERMS}
    steps = plan(scene, variants, samples=4)
    saved = next(step.saved for step in steps if (step.term, step.kind) == (term, "variance reduction"))
    assert saved == {"photons": (photons[1] - photons[0]) // (24 if compiled else 4)}


@pytest.mark.parametrize("variant", ["nearest", "paper", "paper-unweighted"])
def test_the_k_nearest_are_not_aimed(variant, compiled):
    """Their mean depends on how many photons are emitted: the same bytes, and all photons."""
    scene = small("monkey", 4)
    scene = attrs.evolve(scene, photons=attrs.evolve(scene.photons, count=200 if compiled else 30, nearest=5))
    images = []
    for without in ((), ("aimed",)):
        with Engine(scene, without=without) as engine:
            images.append(list(engine.prefixes(find("direct", variant), samples=2, seed=1, replicate=0))[-1][1])
            assert engine.counts["photons"] == 2 * scene.photons.count
    assert images[0].tobytes() == images[1].tobytes()
