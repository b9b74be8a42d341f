"""Transmission: chains that are reflected or go through, radiance in and out of glass, photons, what is refused.

Rationale: smooth glass has closed forms. A slab of it leaves (1 - R) / (1 + R) of what is behind it, in a furnace it is
not seen at all, and who stands in it sees the sky eta² as bright. Flux is not squeezed: of a light in glass all comes
out. Expectations are these forms and quadratures, never the renderer's own.
"""

import math
from typing import Any

import attrs
import numpy as np
import pytest
from trimesh import creation

from termwise.renderer import Engine, find, photon_tracing
from termwise.renderer.plan import check, plan
from termwise.renderer.rng import root
from termwise.renderer.scratch import new_scratch
from termwise.renderer.terms import DEFAULTS, VARIANTS
from termwise.scenes.analytic import plate, sphere_inside
from termwise.scenes.model import Ambient, Camera, Material, Mesh, Object, Photons, PointLight, Scene, Sky
from termwise.scenes.terms import TABLE, TERMS
from tests.kernels.test_dielectric import energy, fresnel

pytestmark = pytest.mark.plain
WHITE = (1.0, 1.0, 1.0)
GLASS = Material(color=WHITE, gloss=1.0, roughness=1e-4, transparency=1.0)


def slab(material: Material = GLASS, *, wide: float = 40.0, deep: float = 0.5) -> Object:
    """A block, its upper face in z = 0."""
    block = creation.box(extents=(wide, wide, deep))
    return Object("slab", Mesh.from_arrays(block.vertices - (0.0, 0.0, deep / 2), block.faces), material)


def pane(material: Material = GLASS) -> Object:
    """One face between two media, glass below z = 0."""
    return plate("pane", (-20.0, -20.0, 0.0), (40.0, 0.0, 0.0), (0.0, 41.0, 0.0), material)


def seen(*objects: Object, mu: float = 0.8, below: bool = False, **changes: Any) -> Scene:
    """The origin from above or from below, at the cosine `mu`, by one ray."""
    sin = math.sqrt(1 - mu * mu)
    eye = (3.0 * sin, 0.0, -3.0 * mu if below else 3.0 * mu)
    camera = Camera(eye, (0.01, 0.02, 0.0), up=(0.0, 1.0, 0.0), fov=1.0, pixel="centre")
    return attrs.evolve(Scene("glass", camera, objects, resolution=(1, 1), max_bounces=64), **changes)


def cosine(scene: Scene) -> float:
    return abs(float(scene.camera.rays(np.array([0.5, 0.5]), aspect=1.0)[2]))


def image(scene: Scene, term: str, variant: str | None = None, samples: int = 1, **options: Any) -> np.ndarray:
    """The colour of the one pixel, (3,)."""
    with Engine(scene, threads=1, **options) as engine:
        *_, (_, found, _) = engine.prefixes(find(term, variant), samples=samples, seed=1, replicate=0)
    return found[0, 0]


@pytest.mark.parametrize("ior", [1.5, 3.0, 0.9])
def test_glass_in_a_furnace_is_not_seen(ior: float):
    """Wherever chains go, they end in the same sky: F of them is specular, the rest transmission."""
    scene = seen(slab(attrs.evolve(GLASS, ior=ior), wide=2.0), sky=Sky(WHITE))
    specular, transmission = (image(scene, term, samples=8, without=("roulette",)) for term in TERMS[2:4])
    np.testing.assert_allclose(specular, fresnel(cosine(scene), ior), rtol=1e-3)
    np.testing.assert_allclose(specular + transmission, 1.0, rtol=1e-3)


def test_glass_in_glass_is_not_seen_either():
    """An inner block of an index over that of the outer one, and a bubble."""
    outer = slab(wide=2.0, deep=2.0)
    inner = creation.box(extents=(0.8, 0.8, 0.8)).vertices - (0.0, 0.0, 0.9)
    for ior in (1.2, 1 / 1.5):
        within = Object("inner", Mesh.from_arrays(inner, outer.mesh.faces), attrs.evolve(GLASS, ior=ior))
        scene = seen(outer, within, sky=Sky(WHITE))
        parts = [image(scene, term, samples=8, without=("roulette",)) for term in TERMS[2:4]]
        np.testing.assert_allclose(sum(parts), 1.0, rtol=1e-3)


@pytest.mark.parametrize("gloss", [0.0, 1.0])
def test_what_is_behind_a_slab(gloss: float):
    """R of a passage is lost; with reflections a part of it comes through later: (1 - R)², or that over 1 - R².

    Each of the two passages takes its tint, reflections take none.
    """
    glass = attrs.evolve(GLASS, gloss=gloss, tint=(0.9, 0.5, 1.0), ior=3.0)
    floor = plate("floor", (-30.0, -30.0, -3.0), (60.0, 0.0, 0.0), (0.0, 60.0, 0.0), Material(WHITE))
    scene = seen(slab(glass), floor, ambient=Ambient(WHITE, 0.1))
    reflectance = fresnel(cosine(scene), 3.0)
    left = (1 - reflectance) ** 2 / (1 - gloss * reflectance**2)
    samples = 2048 if gloss else 1
    found = image(scene, "transmission", samples=samples, without=("roulette",))
    np.testing.assert_allclose(found, left * np.square(glass.tint), rtol=0.02 if gloss else 1e-3)


@pytest.mark.parametrize("ior", [1.0, 1 + 1e-7, 1 - 1e-7])
def test_a_block_of_no_index_is_not_seen(ior: float):
    texture = np.random.default_rng(1).random((4, 8, 3)).astype(np.float32)
    block = slab(attrs.evolve(GLASS, ior=ior), wide=2.0, deep=2.0)
    scene = seen(block, sky=Sky(texture=texture, radius=math.inf))
    found = sum(image(scene, term) for term in ("specular", "transmission", "background"))
    alone = image(attrs.evolve(scene, objects=()), "background")
    assert not image(scene, "background").any()
    np.testing.assert_allclose(found, alone, rtol=1e-12 if ior == 1.0 else 1e-5)


def test_who_stands_in_glass_sees_the_sky_eta_squared_as_bright():
    scene = seen(pane(), mu=0.9, below=True, sky=Sky(WHITE))
    found = image(scene, "transmission")
    np.testing.assert_allclose(found, 1.5**2 * (1 - fresnel(cosine(scene), 1 / 1.5)), rtol=1e-3)
    out = image(attrs.evolve(scene, objects=(pane(attrs.evolve(GLASS, ior=1 / 1.5)),)), "transmission")
    np.testing.assert_allclose(out, (1 - fresnel(cosine(scene), 1.5)) / 1.5**2, rtol=1e-3)


def test_total_reflection_lets_nothing_out():
    scene = seen(pane(), mu=0.7, below=True, sky=Sky(WHITE))
    np.testing.assert_array_equal(image(scene, "transmission"), 0.0)
    np.testing.assert_allclose(image(scene, "specular"), 1.0, rtol=1e-3)


@pytest.mark.parametrize("variant", VARIANTS["transmission"])
@pytest.mark.parametrize("below", [False, True])
def test_a_rough_pane_in_a_furnace(variant: str, below: bool):
    """The transmitted share of flux by quadrature over microfacets, and radiance from the other medium."""
    glass = Material(WHITE, gloss=0.5, roughness=0.5, transparency=0.8, tint=(1.0, 0.5, 0.25))
    scene = seen(pane(glass), mu=0.95, below=below, sky=Sky(WHITE))
    eta = 1 / 1.5 if below else 1.5
    _, transmitted = energy(cosine(scene), 0.5, eta)
    samples, tolerance = (256, 0.01) if variant == "vndf" else (4096, 0.03)
    found = image(scene, "transmission", variant, samples=samples)
    np.testing.assert_allclose(found, 0.8 * np.array(glass.tint) * transmitted / eta**2, rtol=tolerance)


def test_the_parts_of_a_surface():
    """Diffuse `color (1 - g) (1 - t)`; both sides of an opaque dielectric are alike, and its F is of ior alone."""
    half = Material(WHITE, gloss=0.25, transparency=0.5, roughness=1e-4)
    np.testing.assert_allclose(image(seen(pane(half), ambient=Ambient(WHITE)), "ambient"), 0.75 * 0.5)
    opaque = attrs.evolve(GLASS, transparency=0.0, fresnel="dielectric", f0=WHITE, gloss=0.5)
    for below in (False, True):
        scene = seen(pane(opaque), mu=0.5, below=below, sky=Sky(WHITE))
        found = image(scene, "specular", without=("roulette",))
        np.testing.assert_allclose(found, 0.5 * fresnel(cosine(scene), 1.5), rtol=1e-3)
    # Without reflections the surface stays transparent.
    scene = seen(pane(half), sky=Sky(WHITE), ambient=Ambient(WHITE))
    scene = attrs.evolve(scene, toggles=attrs.evolve(scene.toggles, reflections=False))
    expected = 0.5 * (1 - fresnel(cosine(scene), 1.5)) / 1.5**2
    np.testing.assert_allclose(image(scene, "transmission"), expected, rtol=1e-3)
    np.testing.assert_allclose(image(scene, "ambient"), 0.5)


@pytest.mark.parametrize("scattering", ["full", "diffuse"])
def test_all_flux_of_a_light_in_a_ball_comes_out(scattering: str):
    """4 pi I times the tint of one passage lands on the walls around, however often it was reflected before."""
    tint = (1.0, 0.5, 0.25)
    ball = sphere_inside("ball", subdivisions=2, material=attrs.evolve(GLASS, tint=tint))
    ball = attrs.evolve(ball, mesh=Mesh.from_arrays(ball.mesh.vertices, ball.mesh.faces[:, ::-1]))
    walls = sphere_inside("walls", subdivisions=1, radius=3.0, material=Material((1e-3, 1e-3, 1e-3)))
    light = PointLight((0.0, 0.0, 0.0), WHITE)
    scene = seen(ball, walls, lights=(light,), photons=Photons(400, 0.5))
    with Engine(scene, threads=1) as engine:
        rule = photon_tracing.Scattering(0.0, True, scattering == "full", False, False)
        options = {"count": 400, "radius": 0.5, "shape": "simpson", "rule": rule, "first_hits": True}
        photons = photon_tracing.emit(engine.arrays, root(1, 0), 0, pool=engine.pool, scratch=new_scratch, **options)
    expected = 4 * math.pi * np.array(tint) if scattering == "full" else np.zeros(3)
    np.testing.assert_allclose(photons.power.sum(axis=1), expected, rtol=0.03)


def test_an_opaque_scene_has_nothing_of_it():
    """No kernel, no argument that one is compiled for, black pixels; and the plan says why."""
    scene = seen(pane(Material(WHITE, gloss=0.5)), sky=Sky(WHITE))
    assert TABLE["transmission"].absent(scene) == "no surface has transparency > 0"
    with Engine(scene, threads=1) as engine:
        assert engine.arrays.materials.dielectrics is None
        assert engine.kernels_of(find("transmission")) == ()
    steps = plan(scene, {term: find(term, name) for term, name in DEFAULTS.items()})
    assert [step.kind for step in steps if step.term == "transmission"] == ["skip"]
    glass = attrs.evolve(scene, objects=(pane(),))
    steps = plan(glass, {term: find(term, name) for term, name in DEFAULTS.items()})
    both = [step.term for step in steps if step.work == "light of both lobes"]
    assert both == ["specular", "transmission"]
    black = attrs.evolve(GLASS, tint=(0.0, 0.0, 0.0))
    why = TABLE["transmission"].absent(attrs.evolve(scene, objects=(pane(black),)))
    assert why == "every tint of a transparent surface is black"


@pytest.mark.parametrize(
    ("material", "term", "variant", "message"),
    [
        (GLASS, "specular", "paper", "transparency = 1.0: allowed is 0 for specular paper"),
        (GLASS, "specular", "paper-code", "transparency = 1.0: allowed is 0 for specular paper-code"),
        (GLASS, "specular", "uniform", "ior = 1.5 with roughness = 0.0001: allowed is |ior - 1| roughness >= 0.03"),
        (attrs.evolve(GLASS, ior=1.0), "transmission", "uniform", "ior = 1.0 with roughness = 0.0001: allowed is"),
        (attrs.evolve(GLASS, ior=1.01, roughness=0.3), "transmission", "uniform", "ior = 1.01 with roughness = 0.3: "),
        (
            Material(gloss=1.0, fresnel="dielectric"),
            "specular",
            "paper",
            "fresnel = 'dielectric': allowed is 'schlick'",
        ),
    ],
)
def test_variants_without_a_rule_are_refused(material: Material, term: str, variant: str, message: str):
    with pytest.raises(ValueError, match=f"glass: objects: 'pane': {message}"):
        check(seen(pane(material)), find(term, variant))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"normals": "face"}, "normals = 'face', for which no side is the viewer's"),
        ({"ignore": "object"}, "ignore = 'object', whose rays never leave what they have entered"),
        ({"shadows": "paper"}, "shadows = 'paper', by which what is inside of a surface sees no light"),
    ],
)
def test_rules_of_opaque_scenes_are_refused(changes: dict[str, Any], message: str):
    with pytest.raises(ValueError, match=f"objects: 'pane': transparency = 1.0: allowed is 0 where .* has {message}"):
        seen(pane(), **changes)


def test_coincident_glass_is_refused():
    twice = (pane(), attrs.evolve(pane(), name="again"))
    with pytest.raises(
        ValueError, match="'pane' and 'again' lie in one plane.*are transparent.*: allowed are one of the"
    ):
        seen(*twice)
