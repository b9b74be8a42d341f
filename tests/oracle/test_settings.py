"""What the paper's program does beside its formulas, as settings of a scene: by hand, and ours against Mitsuba.

`irradiance`, `ignore`, `normals`, `intersection`, the sky's `projection` and `radius`, and `chain = "paper"`.
"""

import math
from typing import Any, Literal

import attrs
import numpy as np
import pytest

from termwise import reference, renderer
from termwise.renderer.geometry import bvh, paper, traverse
from termwise.renderer.geometry.bvh import STACK_SIZE
from termwise.renderer.geometry.intersect import NOTHING, make_ray
from termwise.renderer.terms import Chain, find
from termwise.renderer.vector import Vec3
from termwise.reports.statistics.rule import judge
from termwise.reports.study.study import Study
from termwise.reports.study.subjects import Subject, changed, own_limit
from termwise.scenes.analytic import plate
from termwise.scenes.limits import Limit
from termwise.scenes.load import load
from termwise.scenes.model import Ambient, Camera, Color, Material, Mesh, Object, PointLight, Scene
from tests.scenes import small


def grey(value: float) -> Color:
    return value, value, value


def small_changed(name: str, **change: Any) -> Scene:
    scene = small(name, 24)
    return changed(attrs.evolve(scene, photons=attrs.evolve(scene.photons, count=5000)), change)


def inside_out(scene: Scene) -> Scene:
    """The scene with the faces of everything but lights turned over."""

    def turned(thing: Object) -> Object:
        mesh = Mesh.from_arrays(thing.mesh.vertices, thing.mesh.faces[:, ::-1])
        return thing if thing.emits else attrs.evolve(thing, mesh=mesh)

    return attrs.evolve(scene, objects=tuple(map(turned, scene.objects)))


def agree(
    scene: Scene, term: str, variant: str | None, limit: Limit, *, chain: Chain = "path", maps: int | None = None
) -> float:
    """Ours against the limit by Mitsuba: no error proven, a bias within 5 standard errors; returns that mean."""
    estimator = find(term, variant)
    ours = []
    with renderer.Engine(scene) as engine:
        for replicate in range(16):
            *_, (_, image, _) = engine.prefixes(estimator, samples=16, seed=1, replicate=replicate, chain=chain)
            ours.append(image)
    theirs = [reference.replicate(scene, limit, spp=maps or 64, seed=1, replicate=k) for k in range(16)]
    outcome = judge(ours, theirs)
    assert outcome.verdict in ("EQUIVALENT", "UNDERPOWERED"), outcome.sentence
    assert abs(outcome.bias) < 5 * outcome.standard_error
    return float(np.mean(theirs))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "change", "term", "variant", "least"),
    [
        ("monkey", {"ignore": "object"}, "ambient", "cosine", 0.01),
        ("monkey", {"ignore": "object"}, "direct", "path", 0.01),
        ("monkey", {"ignore": "object", "shadows": "paper"}, "specular", "vndf", 0.01),
        ("two_cubes", {"irradiance": "E"}, "specular", "vndf", 0.5),
        ("two_cubes", {"sky": {"projection": "lat-long"}}, "background", "seen", 0.01),
        ("two_cubes", {"sky": {"radius": math.inf}}, "background", "seen", 0.1),
        ("two_cubes", {"sky": {"radius": math.inf, "projection": "lat-long"}}, "specular", "vndf", 0.01),
    ],
)
def test_both_sides_agree(name: str, change: dict[str, Any], term: str, variant: str, least: float):
    """And the setting changes the mean by more than a share `least`, so that the agreement says something."""
    scene = small_changed(name, **change)
    limit = find(term, variant).limit(scene, 16)
    with_setting = agree(scene, term, variant, limit)
    before = small_changed(name)
    without = reference.replicate(before, find(term, variant).limit(before, 16), spp=256, seed=1).mean()
    assert abs(with_setting / without - 1) > least


@pytest.mark.slow
@pytest.mark.parametrize(
    ("term", "variant"),
    [("ambient", "cosine"), ("ambient", "paper-loop"), ("direct", "path"), ("specular", "paper-code")],
)
def test_both_sides_agree_on_what_is_seen_from_behind(term: str, variant: str):
    """A glossy room inside out, its normals those of the faces, and no ray meets the object that it leaves."""
    room = small_changed("cornell_box_unshadowed", normals="face", ignore="object")
    agree(inside_out(room), term, variant, find(term, variant).limit(room, 16))


def under_a_light(*, normals: Literal["viewer", "face"], height: float) -> Scene:
    """A plate whose normal points up and a light above, or below it; both seen from above."""
    material = Material(grey(0.5))
    return Scene(
        "behind",
        Camera((0.0, -3.0, 2.0), (0.0, 0.0, 0.0), fov=10.0, pixel="centre"),
        (plate("plate", (-1.0, -1.1, 0.0), (2.0, 0.0, 0.0), (0.0, 2.2, 0.0), material),),
        lights=(PointLight((0.0, 0.0, height), grey(math.pi)),),
        ambient=Ambient(grey(1.0)),
        resolution=(4, 4),
        scope="first-hit",
        normals=normals,
    )


def test_a_face_shows_its_front_from_behind():
    """Turned over, a plate seen from above is dark under the light above and lit by one below."""
    for height, lit in ((1.0, False), (-1.0, True)):
        scene = inside_out(under_a_light(normals="face", height=height))
        direct = renderer.render(scene, "direct", samples=1).mean
        assert (direct > 0).all() == lit
        assert (direct == 0).all() != lit
        # The distance and the cosine below are those above.
        seen = renderer.render(under_a_light(normals="viewer", height=1.0), "direct", samples=1).mean
        if lit:
            np.testing.assert_allclose(direct, seen, rtol=1e-12)


def test_photons_are_refused_where_fronts_show_from_behind():
    scene = small_changed("two_cubes", normals="face")
    with pytest.raises(ValueError, match="normals = 'face': allowed is 'viewer' for direct next-event"):
        renderer.render(scene, "direct", variant="next-event")
    renderer.render(scene, "direct", samples=1)  # by paths
    with pytest.raises(ValueError, match="specular vndf"):
        renderer.render(scene, "specular")
    renderer.render(scene, "specular", chain="path", samples=1)
    flat = scene.objects[0].mesh
    smooth = Object("ball", Mesh.from_arrays(flat.vertices, flat.faces, smooth=True))
    with pytest.raises(ValueError, match="'ball': normals = 'smooth': allowed is 'flat'"):
        attrs.evolve(scene, objects=(smooth,))


@pytest.mark.parametrize("variant", ["next-event", "path", "photon-map", "nearest"])
def test_irradiance_is_pi_times_the_radiance(variant: str):
    scene = small_changed("two_cubes")
    plain, read = (
        renderer.render(each, "direct", variant=variant, samples=2).mean
        for each in (scene, attrs.evolve(scene, irradiance="E"))
    )
    np.testing.assert_allclose(read, math.pi * plain, rtol=1e-12)


def test_a_convex_object_cannot_tell_whether_its_rays_pass_it():
    """The same bits: no ray that leaves a cube outwards meets it again. The monkey's do (above)."""
    scene = small_changed("two_cubes")
    for term in ("ambient", "direct", "specular"):
        plain, passing = (
            renderer.render(each, term, samples=2, chain="path").mean
            for each in (scene, attrs.evolve(scene, ignore="object"))
        )
        np.testing.assert_array_equal(plain, passing)


def both_hits(corners: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> tuple[int, int]:
    """Faces that the watertight and the paper's intersection find."""
    tree = bvh.build(corners)
    ray = make_ray(Vec3(*origin.tolist()), Vec3(*direction.tolist()))
    stack = np.empty(STACK_SIZE, np.int32)
    exact = traverse.closest_hit(corners, tree, ray, math.inf, NOTHING, stack)
    by_angles = paper.closest_hit(corners, ray, math.inf, NOTHING)
    assert paper.any_hit(corners, ray, math.inf, NOTHING, -1) == (by_angles.face >= 0)
    if by_angles.face >= 0 and exact.face == by_angles.face:
        assert by_angles.t == pytest.approx(exact.t, rel=1e-9)
        assert by_angles.b1 == pytest.approx(exact.b1, abs=1e-9)
        assert by_angles.b2 == pytest.approx(exact.b2, abs=1e-9)
    return exact.face, by_angles.face


def test_the_paper_s_intersection():
    """Inside faces it finds what is there; along edges it leaks; what is small it misses, whatever is aimed at."""
    monkey = load("monkey").objects[1].mesh
    corners = np.ascontiguousarray(monkey.vertices[monkey.faces])
    centre, extent = corners.mean(axis=(0, 1)), np.ptp(corners.reshape(-1, 3), axis=0).max()
    rng = np.random.default_rng(6)
    found = []
    for _ in range(400):
        outwards = rng.normal(size=3)
        origin = centre + 2 * extent * outwards / np.linalg.norm(outwards)
        face = corners[rng.integers(len(corners))]
        weights = rng.dirichlet(np.ones(3))
        aim = weights @ face - origin
        found.append((*both_hits(corners, origin, aim / np.linalg.norm(aim)), weights.min()))
    inside = [(exact, by_angles) for exact, by_angles, margin in found if margin > 1e-3]
    assert len(inside) > 300
    assert all(exact >= 0 for exact, _ in inside)
    # Absolute epsilons: grazing hits of the smallest faces get lost, no more than a few.
    assert np.mean([exact == by_angles for exact, by_angles in inside]) > 0.98

    octahedron = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
    signs = [(x, y, z) for x in (0, 1) for y in (2, 3) for z in (4, 5)]
    closed = np.ascontiguousarray(octahedron[np.array(signs)])
    leaks = 0
    for _ in range(300):
        a, b = octahedron[rng.choice([0, 1])], octahedron[rng.choice([2, 3])]
        aim = rng.uniform() * (a - b) + b
        exact, by_angles = both_hits(closed, np.zeros(3), aim / np.linalg.norm(aim))
        assert exact >= 0
        leaks += by_angles < 0
    assert 0.02 < leaks / 300 < 0.9

    tiny = closed * 1e-3  # |(v2 - v1) x (v3 - v1)| is below 1e-5
    diagonal = np.full(3, 3**-0.5)
    exact, by_angles = both_hits(tiny, np.zeros(3), diagonal)
    assert (exact, by_angles) == (both_hits(closed, np.zeros(3), diagonal)[0], -1)


@pytest.mark.slow
@pytest.mark.parametrize("shadows", ["physical", "paper"])
def test_a_chain_of_the_paper_s_terms_against_its_twin(shadows: str):
    """Ambient without 1/π and the k nearest photons at the vertices, by Mitsuba's photons and a k-d tree."""
    scene = small_changed("cornell_box_unshadowed", shadows=shadows)
    subject = Subject(scene, {"specular": (find("specular", "vndf"),)}, "paper")
    study = Study(scenes=("cornell_box_unshadowed",), resolution=(24, 24), kernel_maps=1, nearest_maps=1)
    limit = own_limit(study, subject, find("specular", "vndf"))
    assert limit.kernel is not None
    assert limit.ambient == math.pi
    agree(scene, "specular", "vndf", limit, chain="paper", maps=2)
