"""Skips: work that cannot contribute is not done, and the image has the same bytes with it.

Rationale: a skip is proven, not believed. Each row of SKIPS meets a scene where it applies; rendered with the skip and
without it the images are equal to the byte, and the counters say which work was spared. Where a skip rests on geometry
(what a pixel may see, what cannot be hidden) it is tested against the geometry itself, in random scenes.
"""

from typing import Any

import attrs
import numpy as np
import pytest

from termwise.renderer import VARIANTS, Engine, Variant, find
from termwise.renderer.plan import SKIPS, may_see, plan
from termwise.renderer.unoccluded import open_sides
from termwise.scenes.analytic import disc_over_plane, furnace, plate
from termwise.scenes.load import library, load
from termwise.scenes.model import Ambient, Camera, Material, Mesh, Object, PointLight, Scene, Sky, Toggles
from termwise.scenes.terms import TERMS, Term
from tests.scenes import box

RAYS, OCCLUSION, PHOTONS, DENSITIES = "rays", "occlusion rays", "photons", "density estimates"


def drawn(
    scene: Scene, term: str, variant: str | None = None, *, without: tuple[str, ...] = (), samples: int = 4
) -> tuple[np.ndarray, Engine]:
    """The image, and the engine that has counted."""
    with Engine(scene, threads=2, without=without) as engine:
        *_, (_, image, _) = engine.prefixes(find(term, variant), samples=samples, seed=1, replicate=0)
    return image, engine


def of_size(scene: Scene, compiled: bool, size: int = 16) -> Scene:
    side = size if compiled else 4
    photons = attrs.evolve(scene.photons, count=500 if compiled else 30, nearest=5)
    return attrs.evolve(scene, resolution=(side, side), photons=photons)


def of_rule(scene: Scene, pixel: Any) -> Scene:
    return attrs.evolve(scene, camera=attrs.evolve(scene.camera, pixel=pixel))


def with_material(scene: Scene, **changes: Any) -> Scene:
    return attrs.evolve(
        scene, objects=tuple(attrs.evolve(o, material=attrs.evolve(o.material, **changes)) for o in scene.objects)
    )


def apart() -> Scene:
    """A cube over a plate, farther from it than the ambient range."""
    ground = plate("ground", (-3.0, -3.0, 0.0), (6.0, 0.0, 0.0), (0.0, 6.0, 0.0), Material((0.5, 0.5, 0.5)))
    return Scene(
        "apart",
        Camera((0.0, -5.0, 3.0), (0.0, 0.0, 1.0), fov=60.0),
        (ground, box("cube", (-0.5, -0.5, 1.0))),
        ambient=Ambient((1.0, 0.5, 0.25), range=0.75),
    )


def half_black() -> Scene:
    """The same, the plate a mirror in the shadow of the cube."""
    scene = apart()
    plate_, cube = scene.objects
    mirror = attrs.evolve(plate_, material=Material((0.5, 0.5, 0.5), gloss=1.0))
    return attrs.evolve(
        scene, objects=(mirror, cube), lights=(PointLight((0.0, 0.5, 6.0), (9.0, 9.0, 9.0)),), scope="first-hit"
    )


CUBES, BOX, MONKEY = load("two_cubes"), load("cornell_box"), load("monkey")
OFF = Toggles(ambient_occlusion=False)
MIRRORS = with_material(MONKEY, color=(0.0, 0.0, 0.0), gloss=0.9)

# skips, scene, term, variant, what is counted without the skip only, and whether nothing of it is left with the skip.
CASES = [
    ("term", BOX, "background", None, RAYS, True),
    ("term", attrs.evolve(BOX, ambient=Ambient()), "ambient", None, RAYS, True),
    ("term", attrs.evolve(MONKEY, lights=()), "direct", None, RAYS, True),
    ("term photons window", MIRRORS, "direct", None, PHOTONS, True),
    ("term", attrs.evolve(BOX, max_bounces=0), "specular", None, RAYS, True),
    ("term window", attrs.evolve(BOX, toggles=Toggles(reflections=False)), "specular", None, RAYS, True),
    ("photons", MIRRORS, "specular", None, PHOTONS, True),
    ("window", CUBES, "ambient", None, RAYS, False),
    ("window", CUBES, "direct", None, RAYS, False),
    ("window", CUBES, "specular", None, RAYS, False),
    ("window", BOX, "specular", None, RAYS, False),  # only the blocks are glossy
    ("window", half_black(), "ambient", None, RAYS, False),
    ("window", half_black(), "direct", None, RAYS, False),
    ("window", MONKEY, "background", None, RAYS, False),
    ("window", attrs.evolve(MONKEY, objects=()), "background", None, RAYS, True),
    ("pixel", of_rule(CUBES, "corner"), "ambient", None, RAYS, False),
    ("pixel", of_rule(BOX, "centre"), "direct", None, RAYS, False),
    ("occlusion", attrs.evolve(BOX, toggles=OFF), "ambient", None, OCCLUSION, True),
    ("occlusion", attrs.evolve(BOX, toggles=OFF), "ambient", "uniform", OCCLUSION, True),
    ("occlusion", BOX, "ambient", "constant", OCCLUSION, True),
    ("open", apart(), "ambient", None, OCCLUSION, True),
    ("open", furnace(roughness=0.5, mu_o=0.7, gloss=0.0), "ambient", None, OCCLUSION, True),
    ("diffuse", CUBES, "ambient", None, OCCLUSION, False),
    ("diffuse", CUBES, "direct", None, DENSITIES, False),
    ("diffuse", CUBES, "direct", "path", RAYS, False),
    ("diffuse", CUBES, "direct", "photon-map", DENSITIES, False),
    ("diffuse", CUBES, "direct", "nearest", DENSITIES, False),
    ("horizon", CUBES, "direct", None, OCCLUSION, False),
    ("horizon", MONKEY, "direct", None, OCCLUSION, False),
    ("throughput", BOX, "specular", "uniform", RAYS, False),
]


# Kernels of their own.
RARE = [("window", attrs.evolve(half_black(), shadows="paper"), "ambient", None, RAYS, False)]


@pytest.mark.parametrize(
    ("skip", "scene", "term", "variant", "counter", "all_of_it"),
    [*CASES, *(pytest.param(*case, marks=pytest.mark.rare) for case in RARE)],
)
def test_a_skip_spares_work_and_no_byte(skip, scene, term, variant, counter, all_of_it, compiled):
    """The same bytes, and less of the work that the skip is about: none of it where the reason holds everywhere."""
    scene = of_size(scene, compiled)
    # Of 16 samples some share neither a camera ray nor a call of the kernel.
    image, engine = drawn(scene, term, variant, samples=16)
    in_vain, without = drawn(scene, term, variant, without=tuple(skip.split()), samples=16)
    assert image.tobytes() == in_vain.tobytes()
    assert all(count <= without.counts[name] for name, count in engine.counts.items())
    if compiled or all_of_it:  # as plain Python the images are too small to meet what is rare
        assert engine.counts[counter] < without.counts[counter]
    if all_of_it:
        assert engine.counts[counter] == 0
    if "term" in skip:
        assert not engine.kernels
        assert without.kernels
    if skip == "photons":
        assert without.kernels - engine.kernels == {"trace_photons", "sort"}


def test_every_skip_has_a_case():
    """All rows of the table are proven; the texture has a test of its own, for lookups are not counted."""
    assert {name for case in CASES for name in case[0].split()} | {"texture"} == set(SKIPS)


@pytest.mark.parametrize("term", ["specular", "background"])
def test_a_black_texture_is_no_texture(term, compiled):
    """A sky of black texels is dropped before the kernels see it."""
    black = attrs.evolve(CUBES, sky=Sky(texture=np.zeros((4, 8, 3), np.float32)), draw_lights=True)
    black = of_size(black, compiled)
    image, engine = drawn(black, term)
    in_vain, without = drawn(black, term, without=("texture",))
    assert image.tobytes() == in_vain.tobytes()
    assert engine.arrays.sky.texture.size == 0
    assert without.arrays.sky.texture.size == 96


@pytest.mark.slow
def test_skips_change_no_byte_of_the_library(compiled):
    """All skips against none of them, on every scene and term, default variants."""
    for name in library():
        scene = of_size(load(name), compiled, 12)
        for term in TERMS:
            image, _ = drawn(scene, term)
            in_vain, _ = drawn(scene, term, without=tuple(SKIPS))
            assert image.tobytes() == in_vain.tobytes(), (name, term)


@pytest.mark.rare
def test_mirrors_have_ambient_light_in_the_papers_shadow(compiled):
    """There a surface has its whole colour, whatever its gloss: nothing of the term may be skipped."""
    mirrors = attrs.evolve(with_material(BOX, gloss=1.0), shadows="paper")
    mirrors = of_size(mirrors, compiled)
    image, _ = drawn(mirrors, "ambient")
    in_vain, _ = drawn(mirrors, "ambient", without=tuple(SKIPS))
    assert image.tobytes() == in_vain.tobytes()
    assert image.any()
    assert not drawn(attrs.evolve(mirrors, shadows="physical"), "ambient")[0].any()


def test_an_unknown_skip_is_refused():
    with pytest.raises(ValueError, match="without = 'haste': allowed are term, photons"):
        Engine(BOX, without=("haste",))


# What a pixel may see.


def scattered(rng: np.random.Generator, count: int) -> Scene:
    """Triangles and cubes anywhere, some behind the camera or through its plane."""
    objects = []
    for index in range(count):
        if rng.random() < 0.5:
            corners = rng.normal(size=(3, 3)) * rng.choice([0.2, 1.0, 5.0]) + rng.normal(size=3) * 2.0
            mesh = Mesh(corners, np.array([[0, 1, 2]], np.int32))
            objects.append(Object(f"face {index}", mesh, Material((0.5, 0.5, 0.5))))
        else:
            low = rng.normal(size=3) * 3.0
            objects.append(box(f"cube {index}", (low[0], low[1], low[2]), 0.5))
    position, target = rng.normal(size=(2, 3)).tolist()
    camera = Camera(tuple(position), tuple(target), fov=float(rng.uniform(10, 120)), pixel="jitter")
    return Scene("scattered", camera, tuple(objects), resolution=(24, 16))


@pytest.mark.slow
def test_no_ray_outside_the_window_meets_anything(compiled):
    """In random scenes: what the centres of the pixels see lies within, and it is not simply everything."""
    rng = np.random.default_rng(5)
    shares = []
    for _ in range(60 if compiled else 3):
        scene = scattered(rng, int(rng.integers(1, 4)))
        seen = may_see(scene)
        with Engine(scene, threads=1) as engine:
            met = engine.geometry().object >= 0
        assert not (met & ~seen).any()
        shares.append(seen.mean())
    assert not compiled or 0.1 < np.mean(shares) < 0.8


def test_the_window_of_a_plate_is_its_rectangle():
    """A plate parallel to the image, of known size and place: the pixels that it touches, no more."""
    camera = Camera((0.0, -1.0, 0.0), (0.0, 0.0, 0.0), fov=90.0)
    # On the image plane at distance 1 a pixel is 2 / 20 wide; x right, z up.
    thing = plate("plate", (-0.35, 0.0, 0.25), (0.5, 0.0, 0.0), (0.0, 0.0, 0.3), Material((0.5, 0.5, 0.5)))
    seen = may_see(Scene("plate", camera, (thing,), resolution=(20, 20)))
    rows, columns = np.nonzero(seen)
    assert (columns.min(), columns.max(), rows.min(), rows.max()) == (6, 11, 4, 7)
    assert seen.sum() == 6 * 4


def test_all_is_seen_through_the_papers_intersection():
    """It may find what is not there: then no pixel is skipped."""
    assert may_see(attrs.evolve(CUBES, intersection="paper")).all()


# What cannot be hidden.


def test_what_is_open():
    """A plate on both sides, a cube outside; not where another is near, where it is hollow, smooth, or inside out."""
    scene = apart()
    assert open_sides(scene).tolist() == [[True, True], [True, False]]
    wide = attrs.evolve(scene, ambient=Ambient((1.0, 1.0, 1.0), range=1.001))
    assert not open_sides(wide).any()
    alone = attrs.evolve(wide, objects=scene.objects[1:], ambient=Ambient((1.0, 1.0, 1.0)))
    assert open_sides(alone).tolist() == [[True, False]]
    mesh = scene.objects[1].mesh
    inside_out = attrs.evolve(mesh, faces=np.ascontiguousarray(mesh.faces[:, ::-1]))
    turned = attrs.evolve(alone, objects=(attrs.evolve(scene.objects[1], mesh=inside_out),))
    assert open_sides(turned).tolist() == [[False, True]]
    smooth = attrs.evolve(mesh, normals=mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True))
    assert not open_sides(attrs.evolve(alone, objects=(attrs.evolve(scene.objects[1], mesh=smooth),))).any()
    vertices = mesh.vertices.copy()
    vertices[7] = vertices.mean(axis=0)  # dented
    dented = attrs.evolve(alone, objects=(attrs.evolve(scene.objects[1], mesh=attrs.evolve(mesh, vertices=vertices)),))
    assert not open_sides(dented).any()
    assert open_sides(attrs.evolve(dented, ignore="object")).all()
    assert not open_sides(attrs.evolve(alone, intersection="paper")).any()
    assert not open_sides(attrs.evolve(alone, toggles=OFF)).any()


def test_only_the_cosine_is_exact_without_rays():
    """The weights of the other variants differ from 1: they trace their rays over an open surface too."""
    scene = attrs.evolve(apart(), resolution=(4, 4))
    for variant in VARIANTS["ambient"]:
        _, engine = drawn(scene, "ambient", variant)
        assert (engine.counts[OCCLUSION] == 0) == (variant in ("cosine", "constant"))


# The plan says what the engine then does.


@pytest.mark.slow
def test_the_plan_counts_what_is_saved(compiled):
    """Work that the plan says is saved is what the counters show, or a bound of it."""
    variants: dict[Term, Variant] = {term: find(term) for term in TERMS}
    skips = {
        "pixels without such objects": "window",
        "occlusion rays": "occlusion",
        "a pixel's further camera rays": "pixel",
        "photon maps": "photons",
    }
    checked = set()
    for scene in (CUBES, of_rule(MONKEY, "corner"), MIRRORS, attrs.evolve(BOX, toggles=OFF), BOX):
        scene = of_size(scene, compiled)
        for step in plan(scene, variants, samples=16):
            if step.kind != "skip" or not step.saved or "first hits" in step.reason:
                continue
            name = "term" if step.work.startswith("kernel") else skips[step.work]
            omitted = ("term", "window") if name == "term" else (name,)
            _, engine = drawn(scene, step.term, samples=16)
            _, without = drawn(scene, step.term, without=omitted, samples=16)
            for counter, count in step.saved.items():
                spared = without.counts[counter] - engine.counts[counter]
                checked.add(name)
                if step.at_most:
                    assert 0 < spared <= count
                elif name == "window":  # tiles are rectangles around what may be seen
                    assert 0 <= spared <= count
                elif name == "term":  # the camera's rays alone are known beforehand
                    assert spared >= count
                else:
                    assert spared == count
    assert checked == {"term", "window", "pixel", "occlusion", "photons"}


def test_disc_within_reach_is_not_open():
    """The gap decides: at a range of .79 below a disc at .8 nothing is traced, at .81 all is."""
    for reach, traced in ((0.79, False), (0.81, True)):
        scene = attrs.evolve(disc_over_plane(height=0.8, radius=0.6, occlusion_range=reach), resolution=(2, 2))
        _, engine = drawn(scene, "ambient")
        assert (engine.counts[OCCLUSION] > 0) == traced
