"""Relations between renders of related scenes, `L(T scene) = L(scene)`, and `total = ((A + D) + S) + B`.

| relation | holds |
|---|---|
| lights, sky and ambient light times 2^k | to the bit, times 2^k |
| all lengths times 2^k, point intensities times 4^k | to the bit |
| moved by a vector that all coordinates take up exactly | to the rounding of hit points |
| turned by 90 degrees, or axes permuted | to rounding where no direction is drawn, else in the mean |
| a light split in two | to the bit, or in the mean where the split moves the samples |
| the roulette of photons with another probability | in the mean |
| two materials blended | the image is the mean of the two images |
| the terms | add up to the bit |

Rationale: none needs a reference, so none can share its error; each holds for every variant, the wrong ones too.
Scenes are the library's with all coordinates put on a lattice of 2^-10, so that a mesh in float32 and the sums of its
coordinates with the vectors used here are exact: what differs is the renderer's arithmetic alone.
"""

import functools
from collections.abc import Callable
from typing import Any

import attrs
import numpy as np
import pytest
from scipy import stats

from termwise import renderer
from termwise.renderer import VARIANTS
from termwise.renderer.plan import skipped
from termwise.reports import cli
from termwise.reports.results.exr import read_exr
from termwise.scenes.analytic import closed_box
from termwise.scenes.load import library, load
from termwise.scenes.model import Color, Light, Mesh, Object, PointLight, Scene, SphereLight, SunLight, Vector, largest
from termwise.scenes.terms import TERMS, Term, total
from tests.scenes import of_every_kind, of_glass, small

LATTICE = 2.0**-10
SAMPLES = 4
EVERY = [(term, name) for term in TERMS for name in VARIANTS[term]]
# The library's scenes by what their kernels are compiled for: of glass for transmission alone, which no other has.
KINDS = {term: ("glass",) if term == "transmission" else ("plain", "lights") for term in TERMS}


def of_kind(kind: str, *values: str) -> Any:
    """A case of a test, a rare one where no other scene has its kernels."""
    return pytest.param(*values, marks=() if kind == "plain" else pytest.mark.rare)


SHADOW_RULE = "shadow rule"  # the paper's
ALL = [
    of_kind(kind, term, name, kind)
    for term, name in EVERY
    for kind in (*KINDS[term], *((SHADOW_RULE,) if term != "transmission" else ()))
]
CHANCE = [
    of_kind(KINDS[term][0], term, name)
    for term, name in EVERY
    if (term, name) not in (("ambient", "constant"), ("transmission", "uniform"))
]

CYCLE = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
TURNS = {"axes permuted": CYCLE, "90 degrees about z": QUARTER}


def on_lattice(values: np.ndarray | Vector) -> np.ndarray:
    return np.round(np.asarray(values) / LATTICE) * LATTICE


def vector(values: np.ndarray) -> Vector:
    x, y, z = values.tolist()
    return x, y, z


PLACES = "position", "target", "center"


def changed(light: Light, change: Callable[[Vector], Vector], *fields: str) -> Light:
    """A light with those of the fields changed that it has."""
    return attrs.evolve(light, **{name: change(getattr(light, name)) for name in fields if hasattr(light, name)})


@functools.cache
def scenes(side: int = 16) -> dict[str, Scene]:
    """The library, small and on the lattice; the paper's choices and full scattering besides."""
    found = {}
    for name in library():
        scene = load(name)
        found[name] = attrs.evolve(
            scene,
            camera=attrs.evolve(
                scene.camera,
                position=vector(on_lattice(scene.camera.position)),
                target=vector(on_lattice(scene.camera.target)),
            ),
            objects=tuple(
                attrs.evolve(thing, mesh=attrs.evolve(thing.mesh, vertices=on_lattice(thing.mesh.vertices)))
                for thing in scene.objects
            ),
            lights=tuple(changed(light, lambda point: vector(on_lattice(point)), *PLACES) for light in scene.lights),
            photons=attrs.evolve(scene.photons, count=2000),
            resolution=(side, side),
        )
    found["paper's choices"] = attrs.evolve(found["two_cubes"], shadows="paper", ignore="object", irradiance="E")
    box = found["cornell_box_unshadowed"]
    found |= {f"{name} of glass": of_glass(found[name]) for name in ("monkey", "two_cubes")}
    found["full scattering"] = attrs.evolve(box, photons=attrs.evolve(box.photons, scattering="full"))
    return found


def rendered(scene: Scene, term: str, variant: str, *, samples: int = SAMPLES, seed: int = 1) -> np.ndarray:
    return renderer.render(scene, term, variant=variant, samples=samples, seed=seed).mean


def kind_of(scene: Scene) -> str:
    """What its kernels are compiled for, apart from leaves and images."""
    if scene.transparent:
        return "glass"
    return SHADOW_RULE if scene.shadows == "paper" else "lights" if scene.name == "lights" else "plain"


def suitable(term: Term, variant: str, kind: str) -> list[Scene]:
    """Scenes of a kind that have the term, of those that the variant takes."""
    found = renderer.find(term, variant)
    return [
        scene
        for scene in scenes().values()
        if skipped(scene, term) is None
        and scene.photons.scattering in found.scatterings
        and scene.name not in ("leaf", "wild", "glass")
        and kind == kind_of(scene)
    ]


def brighter(scene: Scene, factor: float) -> Scene:
    """The scene with all that shines times `factor`."""

    def times(color: Color) -> Color:
        red, green, blue = color
        return factor * red, factor * green, factor * blue

    texture = scene.sky.texture
    return attrs.evolve(
        scene,
        objects=tuple(attrs.evolve(thing, emission=times(largest(thing.emission))) for thing in scene.objects),
        lights=tuple(changed(light, times, light.sends) for light in scene.lights),
        ambient=attrs.evolve(scene.ambient, color=times(scene.ambient.color)),
        sky=attrs.evolve(
            scene.sky, color=times(scene.sky.color), texture=None if texture is None else texture * np.float32(factor)
        ),
    )


def transformed(
    scene: Scene, *, turn: np.ndarray | None = None, scale: float = 1.0, shift: Vector = (0.0, 0.0, 0.0)
) -> Scene:
    """The scene under `x -> scale turn x + shift`; a point light's intensity is radiance times area."""
    turned = np.eye(3) if turn is None else turn

    def moved(points: np.ndarray | Vector) -> np.ndarray:
        return scale * (np.asarray(points) @ turned.T) + np.array(shift)

    def mesh(before: Mesh) -> Mesh:
        normals = None if before.normals is None else before.normals @ turned.T
        after = attrs.evolve(before, vertices=moved(before.vertices), normals=normals)
        assert (after.vertices == after.vertices.astype(np.float32)).all(), "the transform is not exact"
        return after

    def light(before: Light) -> Light:
        after = changed(before, lambda point: vector(moved(point)), *PLACES)
        after = changed(after, lambda way: vector(turned @ np.array(way)), "direction")
        after = changed(after, lambda sent: vector(scale**2 * np.array(sent)), "intensity")
        return attrs.evolve(after, radius=scale * after.radius) if isinstance(after, SphereLight) else after

    camera, sky = scene.camera, scene.sky
    position, target = (vector(moved(point)) for point in (camera.position, camera.target))
    texture = sky.texture
    if turn is QUARTER and texture is not None:  # u = atan2(n.x, n.y) / (2 pi) + 0.5 falls by a quarter
        texture = np.roll(texture, -texture.shape[1] // 4, axis=1)
    return attrs.evolve(
        scene,
        camera=attrs.evolve(camera, position=position, target=target, up=vector(turned @ np.array(camera.up))),
        objects=tuple(attrs.evolve(thing, mesh=mesh(thing.mesh)) for thing in scene.objects),
        lights=tuple(map(light, scene.lights)),
        ambient=attrs.evolve(scene.ambient, range=scene.ambient.range * scale),
        sky=attrs.evolve(sky, texture=texture, center=vector(moved(sky.center)), radius=sky.radius * scale),
        photons=attrs.evolve(scene.photons, radius=scene.photons.radius * scale),
    )


def p_value(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Welch's t between replicates (K, H, W, 3) and (R, H, W, 3): quarters of the image and channels, Bonferroni."""

    def quarters(images: np.ndarray) -> np.ndarray:
        count, height, width, _ = images.shape
        return images.reshape(count, 2, height // 2, 2, width // 2, 3).mean(axis=(2, 4)).reshape(count, -1)

    a, b = quarters(ours), quarters(theirs)
    seen = np.ptp(np.concatenate([a, b]), axis=0) > 0
    assert seen.any()
    _, p = np.array(stats.ttest_ind(a[:, seen], b[:, seen], equal_var=False))
    return float(np.min(p)) * int(seen.sum())


def replicates(scene: Scene, term: str, variant: str, *, seed: int) -> np.ndarray:
    """Sixteen of them, (16, H, W, 3)."""
    return np.array([rendered(scene, term, variant, samples=16, seed=seed + k) for k in range(16)])


# Chance of a false alarm of one p-value; the seeds are fixed.
LEVEL = 1e-3
# What a broken relation must reach.
PROVEN = 1e-6


@pytest.mark.slow
@pytest.mark.parametrize(("term", "variant", "kind"), ALL)
def test_radiance_times_a_power_of_two(term: Term, variant: str, kind: str):
    """Every product and sum scales exactly, and no decision may depend on how bright the light is."""
    for scene in suitable(term, variant, kind):
        image = rendered(scene, term, variant)
        assert image.any()
        for exponent in (-30, 7):
            factor = 2.0**exponent
            np.testing.assert_array_equal(rendered(brighter(scene, factor), term, variant), factor * image)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("term", "variant"), [("ambient", "cosine"), ("direct", "next-event"), ("direct", "path"), ("direct", "photon-map")]
)
def test_light_that_crosses_scales_exactly(term: Term, variant: str):
    """And all that is translucent is opaque, another picture, where its share is 0."""
    scene = scenes()["leaf"]
    image = rendered(scene, term, variant)
    np.testing.assert_array_equal(rendered(brighter(scene, 2.0**7), term, variant), 2.0**7 * image)
    np.testing.assert_array_equal(rendered(transformed(scene, scale=2.0**13), term, variant), image)
    opaque = tuple(attrs.evolve(each, material=attrs.evolve(each.material, translucency=0.0)) for each in scene.objects)
    assert (rendered(attrs.evolve(scene, objects=opaque), term, variant) != image).any()


@pytest.mark.parametrize(("term", "variant", "kind"), ALL)
def test_lengths_times_a_power_of_two(term: Term, variant: str, kind: str):
    """Lengths, areas and their reciprocals scale exactly, and no decision may compare a length with a constant."""
    for scene in suitable(term, variant, kind):
        image = rendered(scene, term, variant)
        assert image.any()
        for exponent in (-20, 13):
            np.testing.assert_array_equal(rendered(transformed(scene, scale=2.0**exponent), term, variant), image)


def test_intensity_is_radiance_times_area():
    """The control: a point light that keeps its intensity while lengths are halved is 4 times too bright."""
    scene = attrs.evolve(scenes()["monkey"], scope="first-hit")
    half = transformed(scene, scale=0.5)
    (light,) = half.lights
    (before,) = scene.lights
    assert isinstance(before, PointLight)
    kept = attrs.evolve(half, lights=(attrs.evolve(light, intensity=before.intensity),))
    image = rendered(scene, "direct", "next-event")
    np.testing.assert_array_equal(rendered(kept, "direct", "next-event"), 4 * image)


def test_absolute_epsilons_are_seen():
    """The control: the paper's intersection, whose 1e-5 is a length, keeps nothing of a scene 2^-20 as large."""
    scene = attrs.evolve(scenes()["two_cubes"], intersection="paper")
    assert rendered(scene, "ambient", "constant").any()
    assert not rendered(transformed(scene, scale=2.0**-20), "ambient", "constant").any()


@pytest.mark.parametrize(("term", "variant", "kind"), ALL)
def test_moved(term: Term, variant: str, kind: str, record_property):
    """Moved by (16, -32, 8): differences of coordinates are the same bits, hit points are rounded anew.

    No coordinate exceeds 64, so a hit moves by less than e = 4 * 64 * 2^-53 = 3e-14. Radiance depends on it over the
    smallest length there is, a photon kernel of r = 0.1, as 4 e / r = 1e-12 of the kernel's peak (a photon at the rim
    has a small weight with that absolute error); a vertex of a chain or path magnifies e by its distance over cosine,
    1e3 at the most in these images. A pixel that differs by more than 1e-9 has therefore seen another face: an edge
    within 1e-12 of one of its 1e2 rays, a chance of 1e-7 for all pixels here. None may.
    """
    flips = pixels = 0
    # Few of the directions of a sphere are those of a lobe, twice in a row.
    samples = 256 if (term, variant) == ("transmission", "uniform") else SAMPLES
    for scene in suitable(term, variant, kind):
        image = rendered(scene, term, variant, samples=samples)
        moved = rendered(transformed(scene, shift=(16.0, -32.0, 8.0)), term, variant, samples=samples)
        if scene.sky.texture is None:
            assert ((moved == 0) == (image == 0)).all()
        differs = np.abs(moved - image) > 1e-9 * image + 1e-12 * image.max()
        flips += int(differs.any(axis=-1).sum())
        pixels += image.any(axis=-1).sum()
    record_property("pixels whose visibility flips", f"{flips} of {pixels}")
    assert pixels > (100 if kind in ("plain", "glass") else 10)
    assert flips == 0


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize(
    ("term", "kind"),
    [
        *(of_kind(kind, term, kind) for term in ("ambient", "direct", "background") for kind in KINDS[term]),
        *(of_kind(SHADOW_RULE, term, SHADOW_RULE) for term in ("ambient", "direct")),
    ],
)
def test_turned_to_rounding(term: Term, kind: str, turn: str):
    """Nothing here is drawn in a local frame: the same points on the same lights, sums of three in another order.

    A few ulp of 2^-53 each; 1e-12 leaves a factor of 1e3 for grazing angles. The texture of a sky turns about z only.
    """
    variant = {"ambient": "constant", "direct": "next-event", "background": "seen"}[term]
    compared = 0
    for scene in suitable(term, variant, kind):
        scene = attrs.evolve(scene, scope="first-hit", photons=attrs.evolve(scene.photons, scattering="diffuse"))
        still = [each for each in scene.lights if not isinstance(each, SunLight | SphereLight)]
        if len(still) < len(scene.lights):  # which are drawn in a frame: others, below the ground, in their place
            scene = attrs.evolve(scene, lights=of_every_kind(*still))
        if term == "background" and turn == "axes permuted" and scene.sky.texture is not None:
            continue
        image = rendered(scene, term, variant)
        turned = rendered(transformed(scene, turn=TURNS[turn]), term, variant)
        np.testing.assert_allclose(turned, image, rtol=1e-12, atol=1e-12 * image.max())
        compared += image.any(axis=-1).sum()
    assert compared > (20 if kind == SHADOW_RULE else 50)


@pytest.mark.parametrize("turn", ["axes permuted", pytest.param("90 degrees about z", marks=pytest.mark.slow)])
@pytest.mark.parametrize(("term", "variant"), CHANCE)
def test_turned_in_the_mean(term: Term, variant: str, turn: str):
    """Local frames turn against the surface, so directions differ: Welch's t over 16 replicates of each side.

    The control is the turned scene seen from a camera that looks 20 degrees aside: proven different wherever the noise
    of the image's mean is below 5 %, which holds but for directions drawn uniformly about narrow lobes.
    """
    name = "monkey" if turn == "axes permuted" else "two_cubes"  # whose sky turns about z only
    scene = scenes()[f"{name} of glass" if term == "transmission" else name]
    ours = replicates(scene, term, variant, seed=1000)
    turned = transformed(scene, turn=TURNS[turn])
    theirs = replicates(turned, term, variant, seed=2000)
    assert p_value(ours, theirs) > LEVEL
    noise = ours.mean(axis=(1, 2, 3)).std(ddof=1) / ours.mean() / 4
    if term in ("specular", "transmission") and variant != "vndf":
        assert noise < 0.15
        return
    assert noise < 0.05
    camera = turned.camera
    ahead = np.array(camera.target) - np.array(camera.position)
    aside = np.tan(np.radians(20.0)) * np.cross(ahead, camera.up)
    turned = attrs.evolve(turned, camera=attrs.evolve(camera, target=vector(camera.target + aside)))
    assert p_value(ours, replicates(turned, term, variant, seed=3000)) < PROVEN


# A light split in two.


@pytest.mark.parametrize(("term", "variant"), [pair for pair in EVERY if pair[0] in ("direct", "specular")])
def test_a_point_light_split_in_two(term: Term, variant: str):
    """Two lights of half the intensity at one point: each is picked with probability 1/2, which is exact.

    So is every sample, whichever is picked: to the bit, photons as well, but where two lights get four samples beside
    an estimate by photons and one light gets one, whose sum rounds otherwise.
    """
    scene = scenes()["monkey"]
    halves = tuple(
        attrs.evolve(light, intensity=vector(0.5 * np.array(light.intensity)))
        for light in scene.lights
        if isinstance(light, PointLight)
        for _ in range(2)
    )
    image = rendered(scene, term, variant)
    assert image.any()
    found = rendered(attrs.evolve(scene, lights=halves), term, variant)
    if (term, variant) == ("direct", "next-event"):
        np.testing.assert_allclose(found, image, rtol=1e-14)
    else:
        np.testing.assert_array_equal(found, image)


def split_lamp(scene: Scene, *, across: bool) -> Scene:
    """The lamp, the last object, as two: its triangles, or, `across`, its halves, each of the same radiance."""
    lamp = scene.objects[-1]
    assert lamp.emits
    first, second, third, fourth = lamp.mesh.vertices[[0, 1, 2, 3]]
    assert lamp.mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    if across:
        low, high = (first + second) / 2, (fourth + third) / 2
        quads = [[0, 1, 2], [0, 2, 3]]
        meshes = [
            Mesh.from_arrays([first, low, high, fourth], quads),
            Mesh.from_arrays([low, second, third, high], quads),
        ]
    else:
        meshes = [Mesh.from_arrays(lamp.mesh.vertices[list(face)], [[0, 1, 2]]) for face in lamp.mesh.faces]
    halves = (Object(f"lamp {i}", mesh, emission=lamp.emission) for i, mesh in enumerate(meshes))
    return attrs.evolve(scene, objects=(*scene.objects[:-1], *halves))


@pytest.mark.parametrize(("term", "variant"), [pair for pair in EVERY if pair[0] in ("direct", "specular")])
def test_a_lamp_split_into_its_triangles(term: Term, variant: str):
    """Its two faces become two objects: the same faces with the same powers, to the bit."""
    for name in ("two_cubes", "cornell_box_unshadowed"):
        scene = scenes()[name]
        image = rendered(scene, term, variant)
        assert image.any()
        np.testing.assert_array_equal(rendered(split_lamp(scene, across=False), term, variant), image)


@pytest.mark.slow
@pytest.mark.parametrize("variant", VARIANTS["direct"])
def test_a_lamp_split_across_in_the_mean(variant: str):
    """Its halves as two lamps: Welch's t over 16 replicates. Half of it left out is proven."""
    scene = scenes()["two_cubes"]
    ours = replicates(scene, "direct", variant, seed=1000)
    halves = split_lamp(scene, across=True)
    assert p_value(ours, replicates(halves, "direct", variant, seed=2000)) > LEVEL
    half = attrs.evolve(halves, objects=halves.objects[:-1])
    assert p_value(ours, replicates(half, "direct", variant, seed=3000)) < PROVEN


# The roulette's probability.


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["photon-map", "next-event"])
def test_survival_changes_no_mean(variant: str):
    """P = .2, .5, .9 and 1 in a closed box of albedo .4: by Welch's t the images agree with that of P = albedo.

    Estimates that are linear in photons, that is: the radius of k photons depends on how many there are. Photons that
    keep their flux, the paper's, scatter with the albedo P: .9 in the place of .4 is proven.
    """
    box = closed_box(albedo=0.4)

    def images(survival: float | None, seed: int, variant: str = variant) -> np.ndarray:
        photons = attrs.evolve(box.photons, count=100, survival=survival)
        return replicates(attrs.evolve(box, photons=photons), "direct", variant, seed=seed)

    plain = images(None, 1000)
    for number, survival in enumerate((0.2, 0.5, 0.9, 1.0)):
        assert p_value(images(survival, 2000 + 100 * number), plain) > LEVEL
    assert p_value(images(0.9, 3000, "paper-unweighted"), plain) < PROVEN


# Materials blended.


def repainted(scene: Scene, name: str, **changes) -> Scene:
    return attrs.evolve(
        scene,
        objects=tuple(
            attrs.evolve(thing, material=attrs.evolve(thing.material, **changes)) if thing.name == name else thing
            for thing in scene.objects
        ),
    )


@pytest.mark.parametrize(
    ("field", "first", "second", "middle"),
    [("color", (0.25, 0.5, 1.0), (0.75, 0.125, 0.0), (0.5, 0.3125, 0.5)), ("gloss", 0.25, 0.75, 0.5)],
    ids=("color", "gloss"),
)
@pytest.mark.parametrize(
    ("term", "variant"), [*[("ambient", name) for name in VARIANTS["ambient"]], ("direct", "next-event")]
)
def test_the_diffuse_part_is_linear_in_color_and_gloss(term: str, variant: str, field, first, second, middle):
    """`color (1 - gloss)` is a factor on AO and on E of the first hit: the image of the mean is the mean image.

    The same random numbers on both sides: a few ulp.
    """
    one, other, blended = (
        rendered(repainted(scenes()["cornell_box"], "tall block", **{field: value}), term, variant)
        for value in (first, second, middle)
    )
    np.testing.assert_allclose(blended, (one + other) / 2, rtol=1e-14)
    assert (one != other).any(axis=-1).sum() > 20


@pytest.mark.parametrize(
    ("field", "first", "second", "middle"),
    [("gloss", 0.25, 0.75, 0.5), ("f0", (0.0, 0.5, 1.0), (0.8, 0.3, 0.2), (0.4, 0.4, 0.6))],
    ids=("gloss", "f0"),
)
@pytest.mark.parametrize("variant", VARIANTS["specular"])
def test_one_bounce_is_linear_in_gloss_and_f0(variant: str, field: str, first, second, middle):
    """The block is convex and never sees itself, so with one bounce its gloss and F0 are factors of degree one.

    Roulette depends on them, so 16 replicates are compared by Welch's t. The first image alone is proven to differ
    from the blended one by the default variant, the least noisy.
    """
    scene = attrs.evolve(scenes()["cornell_box"], max_bounces=1)
    one, other, blended = (
        replicates(repainted(scene, "tall block", **{field: value}), "specular", variant, seed=seed)
        for value, seed in ((first, 1000), (second, 2000), (middle, 3000))
    )
    assert p_value(blended, (one + other) / 2) > LEVEL
    if variant == "vndf":
        assert p_value(blended, one) < PROVEN


# The sum of the terms.


def test_the_written_total_is_the_sum_of_the_terms_to_the_bit(tmp_path, monkeypatch):
    """`termwise render` writes the sum in the order of the terms, added in float64 and rounded once.

    The order counts: another one gives other bits, in the sum at least.
    """
    monkeypatch.chdir(tmp_path)
    arguments = ("render", "two_cubes", "--samples", "2", "--resolution", "24", "20", "--seed", "3", "--json")
    monkeypatch.setattr("sys.argv", ["termwise", *arguments])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 0
    written = read_exr(next(tmp_path.rglob("*.exr")))
    scene = small("two_cubes", 24, 20)
    parts = {term: renderer.render(scene, term, samples=2, seed=3).mean for term in TERMS}
    for term, image in parts.items():
        assert image.any() == (skipped(scene, term) is None)
        np.testing.assert_array_equal(written[term], image.astype(np.float32))
    whole = functools.reduce(lambda left, right: left + right, parts.values())
    np.testing.assert_array_equal(total(*parts.values()), whole)
    np.testing.assert_array_equal(written["total"], whole.astype(np.float32))
    assert (whole != functools.reduce(lambda right, left: left + right, reversed(parts.values()))).any()
