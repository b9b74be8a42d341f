"""Transmission in Mitsuba: closed forms, the split of full transport, and the renderer against the references.

Rationale: with g = t = 1, smooth facets and light of 1 from all around, whatever stands in a picture is invisible; one
interface alone shows the lobe's albedo over eta², by quadrature.
"""

import math
from typing import Any

import attrs
import numpy as np
import pytest
import trimesh

from termwise import reference
from termwise.reference import backend
from termwise.renderer import Engine, find
from termwise.renderer.terms import Chain
from termwise.reports.study.study import Study
from termwise.reports.study.subjects import Subject, own_limit
from termwise.scenes import limits
from termwise.scenes.analytic import plate
from termwise.scenes.limits import Kernel, Limit
from termwise.scenes.model import Ambient, Camera, Material, Mesh, Object, Photons, Scene, Sky, Vector
from termwise.scenes.terms import Term
from tests.oracle.test_reference_dielectric import albedos, fresnel
from tests.scenes import small

pytestmark = pytest.mark.skipif(backend.choose().variant == "scalar_rgb", reason="needs a vectorised variant")

WHITE = (1.0, 1.0, 1.0)
TINT = (0.9, 0.6, 0.3)
ETA = 1.5


def glass(roughness: float = 1e-4, *, eta: float = ETA, g: float = 1.0, t: float = 1.0, **fields: Any) -> Material:
    said: dict[str, Any] = {"color": (0.0, 0.0, 0.0)} | fields
    return Material(**said, gloss=g, roughness=roughness, transparency=t, ior=eta)


def ball(name: str, radius: float, material: Material, *, inwards: bool = False) -> Object:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    faces = mesh.faces[:, ::-1] if inwards else mesh.faces
    return Object(name, Mesh.from_arrays(mesh.vertices, faces, smooth=True), material)


def slab(material: Material, *, size: Vector = (40.0, 41.0, 0.5)) -> Object:
    box = trimesh.creation.box(extents=size)
    return Object("slab", Mesh.from_arrays(box.vertices, box.faces), material)


def lit(name: str, things: tuple[Object, ...], camera: Camera, **fields: object) -> Scene:
    settings = {"sky": Sky(WHITE), "ambient": Ambient(WHITE), "resolution": (8, 8), "max_bounces": 16}
    return Scene(name, camera, things, **(settings | fields))  # type: ignore[arg-type]


ASLANT = Camera((0.3, -4.0, 3.0), (0.3, 0.2, 0.0), fov=4.0)
COSINE = 3.0 / math.hypot(4.2, 3.0)
EYE = Camera((0.0, -4.0, 0.0), (0.0, 0.0, 0.0), fov=28.0)


def means(scene: Scene, term: str, *, spp: int = 256, by_second: bool = False, **fields: object) -> np.ndarray:
    """Mean of each channel of a term."""
    limit = attrs.evolve(limits.correct(term, scene.scope), **fields)
    found = reference.replicate_parts(scene, limit, spp=spp, seed=1, by_second=by_second)[term]
    return found.mean(axis=(0, 1), dtype=np.float64)


@pytest.mark.parametrize(("roughness", "eta"), [(0.3, 1 / 1.5), (0.8, 2.0)])
@pytest.mark.parametrize("by_second", [False, True])
def test_one_interface(roughness: float, eta: float, by_second: bool):
    """Radiance 1 beyond it: `t tint A_t / eta²`; on the same side `g A_r`. By both integrators."""
    corner, first, second = (-90.0, -91.0, 0.0), (180.0, 0.0, 0.0), (0.0, 182.0, 0.0)
    sheet = plate("sheet", corner, first, second, glass(roughness, eta=eta, g=0.6, t=0.7, tint=TINT))
    for side, beyond in ((1.0, eta), (-1.0, 1.0 / eta)):
        camera = Camera((0.3, -4.0, 3.0 * side), (0.3, 0.2, 0.0), fov=0.01)
        scene = lit("interface", (sheet,), camera, max_bounces=1, resolution=(4, 4))
        reflected, through = albedos(roughness, COSINE, beyond)
        spp = 2**12 if by_second else 2**11
        found = means(scene, "transmission", spp=spp, by_second=by_second)
        np.testing.assert_allclose(found, 0.7 * np.array(TINT) * through / beyond**2, rtol=0.03)
        assert means(scene, "specular", spp=spp, by_second=by_second)[0] == pytest.approx(0.6 * reflected, rel=0.05)


def test_a_slab_is_invisible_in_a_furnace():
    """Smooth, under a sky of 1: R comes from its face, 1 - R through it; of a floor behind it `(1 - R) / (1 + R)`."""
    scene = lit("slab", (slab(glass()),), ASLANT)
    r = float(fresnel(np.array(COSINE), ETA))
    assert means(scene, "specular", spp=64)[0] == pytest.approx(r, rel=5e-3)
    assert means(scene, "transmission", spp=64)[0] == pytest.approx(1.0 - r, rel=1e-3)
    behind = attrs.evolve(
        scene,
        sky=Sky(),
        ambient=Ambient(WHITE, range=1e-3),
        objects=(
            slab(glass(tint=TINT)),
            plate("floor", (-90.0, -91.0, -2.0), (180.0, 0.0, 0.0), (0.0, 182.0, 0.0), Material(WHITE)),
        ),
    )
    right = (1.0 - r) / (1.0 + r) * np.array(TINT) ** 2
    np.testing.assert_allclose(means(behind, "transmission", spp=2**12), right, rtol=5e-3)


def test_balls_in_a_furnace():
    """Rough and tinted balls lose light; smooth ones, hollow or in one another, are invisible."""
    air = ball("air", 0.6, glass(eta=1.0 / ETA))
    water = ball("water", 0.6, glass(eta=1.33 / ETA))
    for inner in ((), (air,), (water,)):
        scene = lit("ball", (ball("ball", 1.0, glass()), *inner), EYE, max_bounces=32)
        whole = sum(means(scene, term, spp=64) for term in ("specular", "transmission", "background"))
        np.testing.assert_allclose(whole, 1.0, atol=2e-3)
    rough = lit("rough", (ball("ball", 1.0, glass(0.5)),), EYE, max_bounces=32)
    found = sum(means(rough, term, spp=64) for term in ("specular", "transmission"))
    seen = 1.0 - means(rough, "background")
    assert (found < 0.97 * seen).all()
    assert (found > 0.5 * seen).all()


@pytest.mark.parametrize("eta", [1.0, 1.0 + 1e-7])
def test_a_ball_of_no_glass_changes_no_pixel(eta: float):
    """What is behind it is seen as if it were not there, pixel by pixel."""
    floor = plate("floor", (-9.0, 2.0, -9.0), (18.0, 0.0, 0.0), (0.0, 0.0, 18.1), Material((0.2, 0.5, 0.8)))
    fields = {"ambient": Ambient(WHITE, range=1e-3), "sky": Sky()}
    camera = attrs.evolve(EYE, fov=20.0)
    scene = lit("nothing", (ball("ball", 1.0, glass(eta=eta)), floor), camera, **fields)
    found = reference.replicate(scene, limits.correct("transmission", "all"), spp=64, seed=1)
    np.testing.assert_allclose(found, np.tile((0.2, 0.5, 0.8), (8, 8, 1)), rtol=2e-3)


def test_a_camera_inside_of_glass():
    """In the middle of a ball: `(1 - R) eta²` goes straight in, and what is thrown back R times that."""
    camera = Camera((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), fov=60.0)
    scene = lit("inside", (ball("ball", 1.0, glass()),), camera, max_bounces=32)
    r = float(fresnel(np.array(1.0), ETA))
    np.testing.assert_allclose(means(scene, "transmission"), (1.0 - r) * ETA**2, rtol=2e-3)
    np.testing.assert_allclose(means(scene, "specular", spp=2**12), r * ETA**2, rtol=0.02)


def room(roughness: float = 0.2) -> Scene:
    """A ball of rough glass and a pane over a floor, before a lamp and under a sky."""
    floor = plate("floor", (-4.0, -4.1, -1.01), (8.0, 0.0, 0.0), (0.0, 8.2, 0.0), Material((0.7, 0.6, 0.5), 0.2, 0.4))
    pane = plate(
        "pane", (-2.5, 1.2, -1.0), (5.0, 0.0, 0.0), (0.0, 0.0, 2.5), glass(roughness, g=0.5, t=0.6, color=TINT)
    )
    lamp = attrs.evolve(plate("lamp", (-1.0, 1.0, 2.5), (0.0, 2.0, 0.0), (2.0, 0.0, 0.0)), emission=(9.0, 8.0, 7.0))
    things = (floor, pane, ball("ball", 0.9, glass(roughness, tint=TINT)), lamp)
    camera = Camera((0.5, -5.0, 1.2), (0.0, 0.0, -0.2), fov=35.0, pixel="centre")
    return lit("room", things, camera, sky=Sky((0.3, 0.5, 0.8)), ambient=Ambient((0.3, 0.4, 0.5)), max_bounces=4)


@pytest.mark.slow
def test_the_parts_of_full_transport_add_up():
    """Five parts, with glass, to Mitsuba's `path` that meets lights by its lobes alone."""
    import drjit as dr
    import mitsuba as mi

    from termwise.reference.wavefront import meets_surface, pixel_means

    scene, count = room(), 8
    limit = reference.shared(scene, limits.physical("ambient"))
    parts = [reference.replicate_parts(scene, limit, spp=512, seed=1, replicate=k) for k in range(count)]
    assert [*parts[0]] == ["ambient", "direct", "specular", "transmission"]
    sums = np.array([np.sum(list(part.values()), axis=0).mean(axis=(0, 1), dtype=float) for part in parts])
    here = reference.loaded(scene)

    def followed(samples):
        context, scene = mi.BSDFContext(), here.scenes["physical"]

        def step(sampler, si, throughput, color, depth, active):
            bs, weight = si.bsdf().sample(context, si, sampler.next_1d(active), sampler.next_2d(active), active)
            throughput = throughput * weight
            active &= dr.any(throughput != 0.0)
            si = scene.ray_intersect(si.spawn_ray(si.to_world(bs.wo)), active)
            color = color + dr.select(active, throughput * si.emitter(scene, active).eval(si, active), 0.0)
            return sampler, si, throughput, color, depth + 1, active & meets_surface(si) & (depth < 63)

        si = scene.ray_intersect(samples.ray)
        begin = samples.sampler, si, mi.Color3f(1.0), mi.Color3f(0.0), mi.UInt32(0), mi.Bool(meets_surface(si))
        return dr.while_loop(begin, lambda *state: state[-1], step)[3]

    camera = here.description["camera"]
    whole = np.array(
        [pixel_means(lambda s: (followed(s),), camera, spp=4096, seed=10**6 + k)[0].mean((0, 1)) for k in range(count)]
    )
    error = np.sqrt((sums.var(axis=0, ddof=1) + whole.var(axis=0, ddof=1)) / count)
    assert (np.abs(sums.mean(axis=0) - whole.mean(axis=0)) < 5 * error).all()
    assert (error < 0.02 * whole.mean(axis=0)).all()
    for image in parts[0].values():
        assert image.mean() > 0.02 * whole.mean()


def test_light_that_never_gets_out_is_refused():
    """A box of glass that is reflected totally within, around the camera."""
    scene = lit("kept", (slab(glass(eta=9.0), size=(2.0, 2.1, 2.2)),), Camera((0.0, 0.0, 0.0), (1.0, 1.01, 1.02)))
    with pytest.raises(ValueError, match=r"objects: color, transparency: up to 1 of the light .* % of it") as error:
        reference.replicate(scene, limits.physical("specular"), spp=1, seed=1)
    assert "\n" not in str(error.value)


# Roughness of the glass, term, variant, chain, our samples, Mitsuba's or its photon maps, and the noise that is left.
ROWS: dict[str, tuple[float, Term, str, Chain, int, int, float]] = {
    "visible normals": (0.2, "transmission", "vndf", "path", 256, 128, 0.02),
    "uniform directions": (1.5, "transmission", "uniform", "path", 32768, 128, 0.05),
    "reflected first": (0.2, "specular", "vndf", "path", 256, 128, 0.02),
    "photons at its vertices": (0.2, "transmission", "vndf", "paper", 8, 1, 0.05),
}


@pytest.mark.slow
@pytest.mark.parametrize("row", ROWS)
def test_a_row_is_its_reference(row: str):
    """The mean of each channel, of all of the picture and of the ball."""
    roughness, term, variant, chain, samples, spp, noise = ROWS[row]
    limit = judged(room(roughness), term, variant, chain, samples, spp, noise)
    assert (limit.kernel is not None) == (chain == "paper")


# Of glass that casts no shadow: term, variant, our samples, Mitsuba's or its photon maps, and the noise that is left.
UNSHADOWED: dict[str, tuple[Term, str, int, int, float]] = {
    "light samples": ("direct", "path", 256, 256, 0.01),
    "photons": ("direct", "photon-map", 8, 1, 0.04),
    "scattered photons": ("direct", "next-event", 8, 1, 0.06),
    "occlusion": ("ambient", "cosine", 64, 64, 0.01),
    "beyond it": ("transmission", "vndf", 256, 128, 0.02),
}


def unshadowed() -> Scene:
    scene = room()
    things = (
        attrs.evolve(thing, material=attrs.evolve(thing.material, occludes=False))
        if thing in scene.transparent
        else thing
        for thing in scene.objects
    )
    return attrs.evolve(scene, objects=tuple(things))


@pytest.mark.slow
@pytest.mark.parametrize("row", UNSHADOWED)
def test_a_row_of_glass_without_a_shadow_is_its_reference(row: str):
    term, variant, samples, spp, noise = UNSHADOWED[row]
    limit = judged(unshadowed(), term, variant, "path", samples, spp, noise)
    assert (limit.kernel is not None) == ("photons" in row)


@pytest.mark.parametrize("term", ["ambient", "direct"])
def test_light_within_a_shell_that_casts_no_shadow(term: Term):
    """Each ray out of it leaves `t tint` of its light there, by both kinds of rays; photons too."""
    thin = glass(g=0.5, t=0.8, tint=TINT, occludes=False)
    floor = plate("floor", (-0.3, -0.31, -0.1), (0.6, 0.0, 0.0), (0.0, 0.62, 0.0))
    cube = attrs.evolve(slab(Material(), size=(0.2, 0.2, 0.1)), name="cube")
    lamp = attrs.evolve(plate("lamp", (-0.5, -0.5, 3.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)), emission=(9.0, 8.0, 7.0))
    camera = Camera((0.1, -0.5, 0.4), (0.0, 0.0, -0.05), fov=40.0, pixel="centre")
    bare, around = (
        lit("shell", (floor, cube, lamp, *others), camera, photons=Photons(2000, 0.2))
        for others in ((), (ball("shell", 1.0, thin),))
    )
    assert not reference.has_second(around, limits.correct(term, "all"))
    right = 0.8 * np.array(TINT) * means(bare, term)
    np.testing.assert_allclose(means(around, term), right, rtol=0.01)
    if term == "direct":
        kernel = Kernel("simpson", radius=0.2)
        right = 0.8 * np.array(TINT) * means(bare, term, spp=2, kernel=kernel)
        np.testing.assert_allclose(means(around, term, spp=2, kernel=kernel), right, rtol=0.05)


def judged(scene: Scene, term: Term, variant: str, chain: Chain, samples: int, spp: int, noise: float) -> Limit:
    """Compare a row with its reference, whose limit is returned."""
    scene = attrs.evolve(scene, photons=Photons(20_000, 0.3, nearest=50))
    subject = Subject(scene, {}, chain=chain)
    study = Study(scenes=("room",), resolution=(8, 8), nearest_maps=1, kernel_maps=1)
    limit = own_limit(study, subject, find(term, variant))
    with Engine(scene) as engine:
        mine = np.array(
            [
                [*engine.prefixes(find(term, variant), samples=samples, seed=1, replicate=k, chain=chain)][-1][1]
                for k in range(16)
            ]
        )
    right = np.array([reference.replicate(scene, limit, spp=spp, seed=2, replicate=k) for k in range(16)])
    for part in (np.s_[:], np.s_[:, 2:6, 2:6]):
        a, b = (images[part].mean(axis=(1, 2), dtype=np.float64) for images in (mine, right))
        error = np.sqrt((a.var(axis=0, ddof=1) + b.var(axis=0, ddof=1)) / 16)
        assert (np.abs(a.mean(axis=0) - b.mean(axis=0)) < 4.5 * error).all()
        assert (error < noise * b.mean(axis=0)).all()
    return limit


def test_without_transparent_surfaces_the_term_is_black():
    scene = small("two_cubes", 4)
    black = reference.render(scene, "transmission", spp=1, replicates=2)
    assert black.mean.shape == (4, 4, 3)
    assert not black.mean.any()
    assert not reference.has_second(scene, limits.named("transmission", scene))
