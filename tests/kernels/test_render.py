"""Whole renders: closed forms, identity of bits, prefixes, skips, bad arguments.

Rationale: an image must be the number that the derivation gives, and the same bits whatever the threads; both are
tested on the product's own entry point. Closed forms are those of scenes/analytic.py.
"""

import math

import attrs
import numpy as np
import pytest
from scipy import special

from termwise import renderer
from termwise.renderer import VARIANTS, Engine, engine, photon_map, render
from termwise.renderer.plan import plan, skipped
from termwise.scenes.analytic import closed_box, disc_over_plane, furnace, glossy_sphere, rectangle_light, unit_sphere
from termwise.scenes.limits import Kernel
from termwise.scenes.load import library, load
from termwise.scenes.model import Ambient, Camera, Photons, PointLight, Scene, Sky, Toggles, largest
from termwise.scenes.terms import TERMS, Term
from tests.scenes import of_glass


def replicate_means(scene: Scene, term: str, count: int, **options) -> np.ndarray:
    """Image means of independent replicates, (count,)."""
    return np.array([render(scene, term, seed=100 + r, **options).mean.mean() for r in range(count)])


def shrunk(scene: Scene, compiled: bool, size: int = 16) -> Scene:
    """The scene at a size that plain Python can render too."""
    side = size if compiled else 3
    photons = attrs.evolve(scene.photons, count=2000 if compiled else 60)
    return attrs.evolve(scene, resolution=(side, side), photons=photons)


# Closed forms: ambient.


@pytest.mark.parametrize("sides", [3, 6, 64])
def test_disc_over_a_point(sides, compiled):
    """AO of a regular polygon over a point: Lambert's formula, and h² / (h² + R²) where it is nearly a disc."""
    height, radius = 0.8, 0.6
    samples = 1024 if compiled else 64
    image = render(disc_over_plane(height=height, radius=radius, sides=sides), "ambient", samples=samples)
    apothem = radius * math.cos(math.pi / sides)
    q = math.hypot(height, apothem)
    half_side = radius * math.sin(math.pi / sides)
    exact = 1 - sides * math.atan(half_side / q) * apothem / (math.pi * q)
    if sides == 64:
        assert exact == pytest.approx(height**2 / (height**2 + radius**2), abs=1e-3)
    # Owen-scrambled nets on a discontinuous f: well below the error of 64 pixels of independent samples.
    error = math.sqrt(exact * (1 - exact) / (64 * samples))
    assert abs(image.mean.mean() - exact) < 4.5 * error


def test_disc_within_a_range(compiled):
    """Only what lies within the range occludes: AO = h² / r² for h < r < rim, and exactly 1 for r < h."""
    samples = 1024 if compiled else 64
    scene = disc_over_plane(height=0.8, radius=0.6, occlusion_range=0.9)
    exact = (0.8 / 0.9) ** 2
    error = math.sqrt(exact * (1 - exact) / (64 * samples))
    assert abs(render(scene, "ambient", samples=samples).mean.mean() - exact) < 4.5 * error
    near = disc_over_plane(height=0.8, radius=0.6, occlusion_range=0.79)
    assert (render(near, "ambient", samples=4).mean == 1.0).all()


def test_occlusion_off():
    """L_a0 times the diffuse weight everywhere, exactly, by both variants: no ray is needed."""
    scene = disc_over_plane(height=0.8, radius=0.6)
    scene = attrs.evolve(
        scene, ambient=Ambient((0.5, 0.25, 2.0)), toggles=Toggles(ambient_occlusion=False), resolution=(2, 2)
    )
    for variant in VARIANTS["ambient"]:
        image = render(scene, "ambient", variant=variant, samples=4).mean
        np.testing.assert_array_equal(image, np.broadcast_to((0.5, 0.25, 2.0), image.shape))


def test_paper_ambient_is_pi_times_too_bright(compiled):
    """An open plate: exactly 1 by cosine sampling, and pi in the mean by the paper's integral, which lacks 1 / pi."""
    scene = furnace(roughness=0.5, mu_o=0.7, gloss=0.0)
    assert (render(scene, "ambient", samples=4).mean == 1.0).all()
    n = 256 if compiled else 32
    # 2 pi mu over a stratified mu: N strata leave an error of 2 pi / (sqrt(12) N^1.5) a pixel.
    image = render(scene, "ambient", variant="paper", samples=n).mean
    assert image.mean() == pytest.approx(math.pi, abs=4.5 * 2 * math.pi / math.sqrt(12) / n**1.5 / 8)


def test_closed_room_is_dark(compiled):
    """Unlimited occlusion inside a closed mesh: AO = 0 in every pixel, that is, no ray leaks."""
    assert (render(shrunk(closed_box(), compiled), "ambient", samples=64 if compiled else 8).mean == 0.0).all()


def test_convex_body_is_not_occluded_by_itself(compiled):
    """The outside of a convex mesh, AO = 1 exactly: no face occludes its neighbour or itself."""
    scene = unit_sphere(subdivisions=2 if compiled else 1)
    outside = attrs.evolve(
        shrunk(scene, compiled),
        camera=Camera((0.0, -4.0, 0.0), (0.0, 0.0, 0.0), fov=12.0),
        ambient=Ambient((1.0, 1.0, 1.0)),
    )
    assert (render(outside, "ambient", samples=16 if compiled else 4).mean == 0.5).all()


# Closed forms: direct.


def first_hit_of_facets(scene: Scene) -> np.ndarray:
    """Exact `rho I cos(theta) / (pi d²)` per pixel centre: the nearest plane of a convex body seen from the origin."""
    mesh = scene.objects[0].mesh
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    distance = -(normal * a).sum(axis=1)  # normals point inwards
    width, height = scene.resolution
    film = np.stack(np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height), axis=-1)
    directions = scene.camera.rays(film, aspect=width / height)
    cos = -directions @ normal.T
    d = np.where(cos > 0, distance / np.where(cos > 0, cos, 1), np.inf)
    nearest = d.argmin(axis=-1)
    d, cos = d.min(axis=-1), np.take_along_axis(cos, nearest[..., None], -1)[..., 0]
    (lamp,) = scene.lights
    assert isinstance(lamp, PointLight)
    return largest(scene.objects[0].material.color)[0] * lamp.intensity[0] * cos / (np.pi * d * d)


def test_unit_sphere_first_hit(compiled):
    """0.5 for albedo .5 and I = pi; on the facets exactly rho I cos / (pi d²), by each direct variant of that scope."""
    scene = shrunk(unit_sphere(scope="first-hit"), compiled)
    expected = first_hit_of_facets(scene)
    assert expected == pytest.approx(0.5, rel=0.03)
    image = render(scene, "direct", variant="next-event", samples=2).mean
    np.testing.assert_allclose(image[..., 0], expected, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["path", "next-event", "photon-map"])
def test_unit_sphere_all_bounces(variant, compiled):
    """1.0 for albedo .5 and I = pi: E_all lies between the extremes of E_dir over the facets, divided by 1 - rho.

    (The operator of diffuse scattering in a closed body averages, so E_dir / (1 - rho) bounds its solution.)
    """
    scene = shrunk(unit_sphere(), compiled, 12)
    if not compiled:
        scene = attrs.evolve(scene, objects=unit_sphere(subdivisions=2).objects)
    edge = scene.objects[0].mesh
    corners = edge.vertices[edge.faces]
    centre = corners.mean(axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    rho = np.abs((normal / np.linalg.norm(normal, axis=1, keepdims=True) * centre).sum(axis=1))
    # E = pi rho / d³ with rho <= d <= 1.
    low, high = rho.min(), 1 / rho.min() ** 2
    values = replicate_means(scene, "direct", 12 if compiled else 6, variant=variant, samples=16 if compiled else 4)
    error = values.std(ddof=1) / math.sqrt(len(values))
    # The kernel's own bias, r² ΔE / 16 and what a curved surface adds, is below (r / R)² / 4 of the light in the map:
    # the scattered half, or all.
    kernel = {"path": 0.0, "next-event": 0.2**2 / 8, "photon-map": 0.2**2 / 4}[variant]
    assert low - kernel - 4.5 * error < values.mean() < high + kernel + 4.5 * error
    assert error < (0.01 if compiled else 0.2)


@pytest.mark.slow
def test_nearest_is_the_paper_s_estimate_times_k_minus_one_over_k(compiled):
    """The same photons, hence the same images to the last bits but for the factor."""
    scene = shrunk(unit_sphere(), compiled, 6)
    paper, nearest = (render(scene, "direct", variant=name, samples=2).mean for name in ("paper", "nearest"))
    k = scene.photons.nearest
    np.testing.assert_allclose(nearest, paper * (k - 1) / k, rtol=1e-13)
    assert paper.any()


@pytest.mark.slow
def test_unweighted_photons_brighten_a_closed_sphere(compiled):
    """Albedo .5 and survival P = .8: rho / (1 - P) = 2.5 in place of rho / (1 - rho) = 1, both times k / (k - 1).

    E in a sphere is that of first hits over 1 minus the albedo that scatters it; the ratio is free of facets and of k.
    """
    scene = shrunk(unit_sphere(), compiled, 8)
    scene = attrs.evolve(scene, photons=attrs.evolve(scene.photons, survival=0.8))
    count, samples = (12, 4) if compiled else (6, 2)
    plain, bright = (
        replicate_means(scene, "direct", count, variant=name, samples=samples) for name in ("paper", "paper-unweighted")
    )
    ratio = bright.mean() / plain.mean()
    spread = np.hypot(bright.std(ddof=1) / bright.mean(), plain.std(ddof=1) / plain.mean())
    error = ratio * spread / math.sqrt(count)
    assert abs(ratio - 2.5) < 4.5 * error
    assert error < (0.05 if compiled else 0.5)


@pytest.mark.parametrize("variant", ["path", "paper-unweighted"])
def test_full_scattering_is_refused_where_it_would_be_ignored(variant):
    scene = attrs.evolve(unit_sphere(), photons=Photons(scattering="full"))
    with pytest.raises(ValueError, match="allowed") as caught:
        render(scene, "direct", variant=variant)
    assert str(caught.value) == (
        f"{scene.name}: photons.scattering = 'full': allowed is 'diffuse' for direct {variant}"
    )


def test_kernels_that_rows_name():
    """What a kernel reference needs of a row: shape, photons, radius and passes, k and scale; None where E is exact."""
    photons = Photons(count=7, radius=0.3, nearest=5, kernel="uniform")
    scene = attrs.evolve(unit_sphere(), photons=photons)
    rows = {name: variant.kernel(scene, 4) for name, variant in VARIANTS["direct"].items()}
    radius = Kernel("uniform", radius=0.3, passes=4)
    search = Kernel("nearest", nearest=5, photons=7)
    assert rows == {
        "next-event": attrs.evolve(radius, stored="scattered"),
        "photon-map": radius,
        "nearest": attrs.evolve(search, scale=4 / 5),
        "path": None,
        "paper": search,
        "paper-unweighted": attrs.evolve(search, weighted=False),
    }
    first_hit = attrs.evolve(scene, scope="first-hit")
    assert not VARIANTS["direct"]["next-event"].kernel_based(first_hit)
    assert VARIANTS["direct"]["next-event"].kernel_based(scene)


def test_rectangle_light(compiled):
    """L F for a rectangle over a floor, seen from below its corner (Howell, factor B-4)."""
    width, depth, height = 1.2, 0.7, 0.9
    x, y = width / height, depth / height
    form = x / math.hypot(1, x) * math.atan(y / math.hypot(1, x))
    form = (form + y / math.hypot(1, y) * math.atan(x / math.hypot(1, y))) / (2 * math.pi)
    scene = rectangle_light(width=width, depth=depth, height=height, radiance=3.0)
    samples = 256 if compiled else 16
    images = [render(scene, "direct", samples=samples, seed=s).mean.mean() for s in range(8)]
    error = np.std(images, ddof=1) / math.sqrt(8)
    assert abs(np.mean(images) - 3.0 * form) < max(5 * error, 1e-6)
    assert error < (0.01 if compiled else 0.03) * form


def test_two_unequal_lights_add_up(compiled):
    """Point lights of intensity 1 and 20 at 2 and 3 over a plate: (I1 / 4 + I2 / 9) / pi, whichever is picked."""
    scene = furnace(roughness=0.5, mu_o=0.7, gloss=0.0)
    lights = (PointLight((0.0, 0.0, 2.0), (1.0, 1.0, 1.0)), PointLight((0.0, 0.0, 3.0), (20.0, 20.0, 20.0)))
    scene = attrs.evolve(scene, lights=lights, scope="first-hit")
    exact = (1 / 4 + 20 / 9) / math.pi
    values = replicate_means(scene, "direct", 8, samples=256 if compiled else 8)
    error = values.std(ddof=1) / math.sqrt(8)
    # The pixels lie within 1e-5 of the point.
    assert abs(values.mean() - exact) < 6 * error + 1e-6
    assert error < (0.002 if compiled else 0.02) * exact


def test_light_seen_from_behind_is_dark():
    """A lamp whose back is turned gives exactly nothing."""
    scene = rectangle_light(width=1.0, depth=1.0, height=1.0)
    lamp = scene.objects[1]
    turned = attrs.evolve(lamp, mesh=attrs.evolve(lamp.mesh, faces=lamp.mesh.faces[:, ::-1]))
    scene = attrs.evolve(scene, objects=(scene.objects[0], turned), resolution=(2, 2))
    assert (render(scene, "direct", samples=8).mean == 0.0).all()


def test_shadow_of_the_disc_is_exact():
    """A point light behind the disc: exactly 0 below it; beside it I cos / (pi d²), to the width of the pixels."""
    scene = disc_over_plane(height=0.5, radius=0.4)
    light = PointLight((0.0, 0.0, 2.0), (3.0, 3.0, 3.0))
    scene = attrs.evolve(scene, lights=(light,), scope="first-hit", resolution=(2, 2))
    assert (render(scene, "direct", samples=4).mean == 0.0).all()
    beside = attrs.evolve(scene, lights=(PointLight((3.0, 0.0, 2.0), (3.0, 3.0, 3.0)),))
    np.testing.assert_allclose(render(beside, "direct", samples=4).mean, 3.0 * 2.0 / (math.pi * 13.0**1.5), rtol=1e-3)


# Closed forms: specular.


@pytest.mark.parametrize(("roughness", "mu_o", "albedo"), [(0.3, 0.7, 0.9658), (0.6, 1.0, 0.8558), (1.0, 1.0, 0.4616)])
def test_specular_furnace(roughness, mu_o, albedo, compiled):
    """A plate under a white sky: gloss A, A the lobe's albedo (quadrature, tests/kernels/test_microfacet.py).

    The paper's BRDF gives 4 / pi of it.
    """
    scene = furnace(roughness=roughness, mu_o=mu_o, gloss=0.5)
    samples, replicates = (256, 8) if compiled else (16, 4)
    for variant, factor in (("vndf", 1.0), ("paper", 4 / math.pi)):
        values = replicate_means(scene, "specular", replicates, variant=variant, samples=samples)
        error = values.std(ddof=1) / math.sqrt(replicates)
        # The table has four digits.
        assert abs(values.mean() - 0.5 * factor * albedo) < 6 * error + 1e-4
        assert error < (0.004 if compiled else 0.1)


def test_mirror_furnace_by_the_default_variant():
    """alpha = 1e-3, F0 = 1: A = 1 within 1e-4, each sample's weight G1 being that near to 1."""
    scene = attrs.evolve(furnace(roughness=1e-3, mu_o=0.8), resolution=(2, 2))
    np.testing.assert_allclose(render(scene, "specular", samples=4).mean, 1.0, rtol=1e-4)


def chain(mu_grid: int, roughness: float, factor: float, gloss: float, bounces: int) -> float:
    """(1 - g) sum_j (g k T)^j 1 at normal view: T tabulated by quadrature over mu_i (Gauss) and azimuth (midpoint)."""
    nodes, weights = np.polynomial.legendre.leggauss(mu_grid)
    mu, weights = (nodes + 1) / 2, weights / 2
    phi = np.pi * (np.arange(256) + 0.5) / 256

    def g1(c):
        a = c / (roughness * np.sqrt(np.maximum(1 - c * c, 1e-300)))
        return 1 / (1 + 0.5 * (special.erf(a) - 1) + np.exp(-a * a) / (2 * a * np.sqrt(np.pi)))

    def row(mu_o):
        sin_o, sin_i = np.sqrt(1 - mu_o**2), np.sqrt(1 - mu**2)[:, None]
        mx = sin_i * np.cos(phi) + sin_o
        my = sin_i * np.sin(phi)
        mz = mu[:, None] + mu_o
        tan2 = (mx**2 + my**2) / mz**2
        cos4 = (mz**2 / (mx**2 + my**2 + mz**2)) ** 2
        d = np.exp(-tan2 / roughness**2) / (np.pi * roughness**2 * cos4)
        return 2 * np.pi * d.mean(axis=1) * g1(mu) * g1(np.float64(mu_o)) / (4 * mu_o)

    table = np.array([row(m) for m in mu]) * weights
    at_normal = row(1 - 1e-12) * weights
    value, reached = 0.0, np.ones(mu_grid)
    for _ in range(bounces):
        value += gloss * factor * (at_normal @ reached)
        reached = gloss * factor * (table @ reached)
    return (1 - gloss) * value


@pytest.mark.parametrize(("bounces", "ratio"), [(1, 1.273), (2, 1.404), (4, 1.633)])
def test_chain_in_a_closed_sphere(bounces, ratio, compiled):
    """gloss .6 in a closed sphere of F0 = 1: sums of powers of one operator, k = 1 and k = 4 / pi at every vertex.

    Only for one bounce is the paper's image 4 / pi of the right one; at alpha -> 0 the ratios are 1.273, 1.404, 1.633.
    The facets turn normals by up to 0.04 rad: 0.5 % is allowed for them.
    """
    scene = glossy_sphere(gloss=0.6, roughness=0.3, max_bounces=bounces, subdivisions=3 if compiled else 1)
    x = 0.6 * np.array([1, 4 / math.pi])
    limit = sum(x[1] ** j for j in range(1, bounces + 1)) / sum(x[0] ** j for j in range(1, bounces + 1))
    assert limit == pytest.approx(ratio, abs=2e-3)
    scene = attrs.evolve(scene, resolution=(32, 32) if compiled else (3, 3))
    scene = attrs.evolve(scene, camera=attrs.evolve(scene.camera, fov=30.0))
    for variant, factor in (("vndf", 1.0), ("paper", 4 / math.pi)):
        exact = chain(96, 0.3, factor, 0.6, bounces)
        values = replicate_means(scene, "specular", 8, variant=variant, samples=32 if compiled else 4)
        error = values.std(ddof=1) / math.sqrt(8)
        facets = 0.005 if compiled else 0.1
        assert abs(values.mean() - exact) < 6 * error + facets * exact
        assert error < (0.015 if compiled else 0.3) * exact


def test_background_is_the_sky_and_the_front_of_lights():
    """Constant sky on a miss; a light's front where lights are drawn, its back and undrawn lights black."""
    scene = rectangle_light(width=1.0, depth=1.0, height=1.0, radiance=3.0)
    at_lamp = Camera((0.5, 0.5, 0.5), (0.5, 0.5, 1.0), up=(0.0, 1.0, 0.0), fov=1.0)
    scene = attrs.evolve(scene, camera=at_lamp, sky=Sky((0.1, 0.2, 0.3)), resolution=(2, 2))
    assert (render(scene, "background", samples=2).mean == 0.0).all()
    assert (render(attrs.evolve(scene, draw_lights=True), "background", samples=2).mean == 3.0).all()
    behind = attrs.evolve(at_lamp, position=(0.5, 0.5, 2.0))
    assert (render(attrs.evolve(scene, draw_lights=True, camera=behind), "background", samples=2).mean == 0.0).all()
    away = attrs.evolve(at_lamp, target=(0.5, 9.0, 0.6), up=(0.0, 0.0, 1.0))
    image = render(attrs.evolve(scene, camera=away), "background", samples=2).mean
    np.testing.assert_allclose(image, np.broadcast_to((0.1, 0.2, 0.3), image.shape), rtol=1e-15)


# Identity of bits.


def widened(name: str, compiled: bool) -> Scene:
    """A scene of the library, a few tiles wide where that is affordable."""
    return attrs.evolve(shrunk(load(name), compiled), resolution=(70, 40) if compiled else (5, 3))


@pytest.fixture(scope="module")
def busy(compiled) -> Scene:
    return widened("cornell_box_unshadowed", compiled)


@pytest.mark.parametrize(
    ("term", "variant"),
    [
        pytest.param(term, name, marks=pytest.mark.rare if term == "transmission" else ())
        for term in TERMS
        for name in VARIANTS[term]
    ],
)
def test_threads_and_prefixes_change_no_bit(term, variant, busy, compiled):
    """1, 2 and 3 threads give equal bytes; the prefix N = 2 of a run of 4 is the run of 2; replicates differ."""
    if term == "background":
        busy = widened("two_cubes", compiled)  # the closed box shows none
    if term == "transmission":
        busy = of_glass(widened("two_cubes", compiled))
        if variant == "uniform" and not compiled:
            pytest.skip("runs compiled: at the size of plain Python no direction meets a lobe")
    found = renderer.find(term, variant)
    images: dict[int, list[bytes]] = {}
    for threads in (1, 2, 3):
        with Engine(busy, threads=threads) as engine:
            for count, image, _ in engine.prefixes(found, samples=4, seed=5, replicate=0):
                images.setdefault(count, []).append(image.tobytes())
    assert sorted(images) == [1, 2, 4]
    assert all(len(set(same)) == 1 for same in images.values())
    with Engine(busy) as engine:
        *_, (_, short, _) = engine.prefixes(found, samples=2, seed=5, replicate=0)
        *_, (_, other, _) = engine.prefixes(found, samples=2, seed=5, replicate=1)
        *_, (_, reseeded, _) = engine.prefixes(found, samples=2, seed=6, replicate=0)
    assert short.tobytes() == images[2][0]
    assert short.any()
    assert np.isfinite(short).all()
    assert (short >= 0).all()
    assert short.tobytes() != other.tobytes()
    assert short.tobytes() != reseeded.tobytes()
    assert other.tobytes() != reseeded.tobytes()


def test_images_do_not_depend_on_the_image_s_other_tiles(busy):
    """Pixels are keyed by their index: a narrower run of the same width has the same first rows."""
    width, height = busy.resolution
    found = renderer.find("ambient")
    with Engine(busy) as engine:
        *_, (_, whole, _) = engine.prefixes(found, samples=2, seed=1, replicate=0)
        engine.tiles["ambient"] = engine.tiles["ambient"][:1]
        *_, (_, part, _) = engine.prefixes(found, samples=2, seed=1, replicate=0)
    ((_, _, x1, y1),) = engine.tiles["ambient"]
    np.testing.assert_array_equal(part[:y1, :x1], whole[:y1, :x1])
    assert not part[y1:].any()


@pytest.mark.parametrize("resolution", [(1, 1), (8, 8), (32, 32), (70, 40), (640, 360)])
def test_tiles_cover_the_image_once_and_give_every_thread_some(resolution):
    width, height = resolution
    found = engine._tiles(np.ones((height, width), np.bool_), least=8)
    covered = np.zeros((height, width), int)
    for x0, y0, x1, y1 in found:
        assert x0 < x1 <= width
        assert y0 < y1 <= height
        covered[y0:y1, x0:x1] += 1
    assert (covered == 1).all()
    assert len(found) >= 8 or max(resolution) <= 8


def test_chains_of_the_paper_share_maps_and_prefixes_keep_their_bits(busy, monkeypatch):
    """Samples 2 m and 2 m + 1 have map m, whatever the prefix; a prefix is the shorter run."""
    monkeypatch.setattr("termwise.renderer.engine._CHAINS_A_MAP", 2)
    intact, numbers = Engine._photons, []

    def counted(engine, task, key, index, *rest):
        numbers.append(index)
        return intact(engine, task, key, index, *rest)

    monkeypatch.setattr(Engine, "_photons", counted)
    found = renderer.find("specular")
    with Engine(busy) as engine:
        images = {
            count: image for count, image, _ in engine.prefixes(found, samples=5, seed=1, replicate=0, chain="paper")
        }
        assert numbers == [0, 0, 0, 1, 2]  # the first only compiles
        for samples in (2, 4):
            *_, (_, short, _) = engine.prefixes(found, samples=samples, seed=1, replicate=0, chain="paper")
            np.testing.assert_array_equal(short, images[samples])
            assert short.any()


# Skips.


def skippable() -> list[tuple[str, Scene, str]]:
    base = load("cornell_box_unshadowed")
    dull = tuple(attrs.evolve(o, material=attrs.evolve(o.material, gloss=0.0)) for o in base.objects)
    black = tuple(attrs.evolve(o, material=attrs.evolve(o.material, color=(0.0, 0.0, 0.0))) for o in base.objects)
    return [
        ("ambient", attrs.evolve(base, ambient=Ambient((0.0, 0.0, 0.0))), "black"),
        ("ambient", attrs.evolve(base, objects=black), "color"),
        ("direct", attrs.evolve(base, toggles=Toggles(lighting=False)), "lighting is off"),
        ("direct", attrs.evolve(base, objects=base.objects[:-1]), "no light"),
        ("direct", attrs.evolve(base, objects=black), "color"),
        ("specular", attrs.evolve(base, toggles=Toggles(reflections=False)), "reflections are off"),
        ("specular", attrs.evolve(base, objects=dull), "gloss"),
        ("specular", attrs.evolve(base, max_bounces=0), "max_bounces"),
        ("background", base, "sky is black"),
    ]


@pytest.mark.parametrize(("term", "scene", "reason"), skippable())
def test_a_skip_changes_no_byte(term, scene, reason, compiled):
    """Every variant of a skipped term, rendered with the skip disabled, gives the same zeros to the byte."""
    scene = shrunk(scene, compiled, 12)
    assert reason in (skipped(scene, term) or "")
    with_skip = render(scene, term, samples=2).mean
    with Engine(scene, without=("term", "photons")) as engine:
        for variant in VARIANTS[term].values():
            *_, (_, image, _) = engine.prefixes(variant, samples=2, seed=0, replicate=0)
            assert image.tobytes() == with_skip.tobytes()


@pytest.mark.slow
def test_nothing_is_skipped_that_contributes(compiled):
    """The converse: on the library, a term is skipped only where its image, rendered anyway, is zero."""
    for name in library():
        scene = shrunk(load(name), compiled, 8)
        for term in TERMS:
            if skipped(scene, term) is None and term != "background":
                # Nine pixels, as plain Python has them, meet what is glossy by few samples.
                assert render(scene, term, samples=1 if compiled else 8).mean.any(), (name, term)


def test_plan_gives_a_reason_for_every_step():
    """Each step says why it runs or does not; no photon map for first hits alone, nor without light."""
    variants: dict[Term, renderer.Variant] = {term: renderer.find(term) for term in TERMS}
    for name in library():
        steps = plan(load(name), variants)
        assert all(step.reason for step in steps)
        maps = {step.term: step.runs for step in steps if step.work == "photon maps"}
        assert maps["direct"] == (name not in ("cornell_box", "smooth_monkey"))
    dark = attrs.evolve(load("monkey"), lights=())
    assert not any(step.runs for step in plan(dark, variants) if step.work == "photon maps")


# Reuse.


@pytest.mark.parametrize("scattering", ["diffuse", "full"])
def test_terms_together_have_the_same_bits(scattering, compiled):
    """All terms by one engine are the images one by one; two replicates, each with maps of its own."""
    scene = shrunk(load("monkey"), compiled, 8)
    scene = attrs.evolve(scene, photons=attrs.evolve(scene.photons, scattering=scattering))
    found = renderer.render_terms(scene, dict.fromkeys(TERMS), samples=3, replicates=2, seed=4)
    assert list(found) == list(TERMS)
    for term, image in found.items():
        alone = render(scene, term, samples=3, replicates=2, seed=4)
        assert image.mean.tobytes() == alone.mean.tobytes()
        assert image.variance.tobytes() == alone.variance.tobytes()


@pytest.mark.parametrize(
    ("scattering", "variant", "maps_kept", "traced"),
    [
        ("diffuse", "next-event", 100, 4),
        ("diffuse", "next-event", 2, 6),
        ("diffuse", "next-event", 0, 8),
        ("diffuse", "photon-map", 100, 8),  # it stores first hits too
        ("full", "next-event", 100, 8),  # the chain means diffuse scattering
    ],
)
def test_photon_maps_are_shared(scattering, variant, maps_kept, traced, compiled, monkeypatch):
    """Direct and specular trace a map once where both mean the same, as long as memory lasts; no bit changes."""
    scene = shrunk(load("monkey"), compiled, 8)
    scene = attrs.evolve(scene, photons=attrs.evolve(scene.photons, scattering=scattering, count=400))
    wanted = renderer.find("direct", variant), renderer.find("specular")
    images = []
    with Engine(scene) as engine:
        for each in wanted:
            images.append(list(engine.prefixes(each, samples=4, seed=2, replicate=0))[-1][1])
        a_map = engine.counts["photons"] // 8
    monkeypatch.setattr(photon_map, "bytes_of", lambda photons: 1)  # so that memory counts maps
    with Engine(scene, kept_bytes=maps_kept) as engine:
        for each, image in zip(wanted, images, strict=True):
            again = list(engine.prefixes(each, samples=4, seed=2, replicate=0))[-1][1]
            assert again.tobytes() == image.tobytes()
        assert engine.counts["photons"] == traced * a_map
        before = engine.counts["photons"]
        list(engine.prefixes(wanted[1], samples=1, seed=2, replicate=1))
        assert engine.counts["photons"] == before + a_map


# Degenerate scenes and bad arguments.


def test_empty_scene(compiled):
    """No objects: every term is black but the background, which is the sky."""
    scene = Scene("void", Camera((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)), sky=Sky((0.5, 0.5, 0.8)), resolution=(3, 2))
    for term in ("ambient", "direct", "specular"):
        assert not render(scene, term, samples=2).mean.any()
    image = render(scene, "background", samples=2).mean
    np.testing.assert_allclose(image, np.broadcast_to((0.5, 0.5, 0.8), image.shape), rtol=1e-15)


def test_one_pixel_and_one_photon(busy):
    """The smallest image and map still give finite values."""
    scene = attrs.evolve(busy, resolution=(1, 1), photons=Photons(count=1, radius=0.1, nearest=2))
    for term in TERMS:
        for variant in VARIANTS[term]:
            assert np.isfinite(render(scene, term, variant=variant, samples=1).mean).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"term": "glow"}, "term = 'glow': allowed are ambient, direct, specular, transmission, background"),
        ({"variant": "best"}, "variant = 'best' of ambient: allowed are cosine, uniform, paper, paper-loop, constant"),
        ({"samples": 0}, "samples = 0: allowed is an integer of at least 1"),
        ({"samples": -4}, "samples = -4: allowed is an integer of at least 1"),
        ({"samples": 2.5}, "samples = 2.5: allowed is an integer of at least 1"),
        ({"chain": "photons"}, "chain = 'photons': allowed are next-event, path, paper"),
        ({"replicates": 0}, "replicates = 0: allowed is an integer of at least 1"),
        ({"threads": 0}, "threads = 0: allowed is an integer of at least 1"),
        ({"seed": -1}, "seed = -1: allowed is an integer in"),
    ],
)
def test_bad_arguments(options, message):
    """One line that names the argument, its value and what is allowed."""
    with pytest.raises(ValueError, match="allowed") as caught:
        render(furnace(roughness=0.5, mu_o=0.7, gloss=0.0), **({"term": "ambient"} | options))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_variance_is_that_of_the_mean(compiled):
    """Mean and variance over replicates against NumPy on the replicates; NaN for a single one."""
    scene = shrunk(disc_over_plane(height=0.8, radius=0.6), compiled, 4)
    image = render(scene, "ambient", samples=4, replicates=5, seed=3)
    single = []
    with Engine(scene) as engine:
        for replicate in range(5):
            *_, (_, one, _) = engine.prefixes(renderer.find("ambient"), samples=4, seed=3, replicate=replicate)
            single.append(one)
    np.testing.assert_allclose(image.mean, np.mean(single, axis=0), rtol=1e-15)
    np.testing.assert_allclose(image.variance, np.var(single, axis=0, ddof=1) / 5, rtol=1e-12)
    assert np.isnan(render(scene, "ambient", samples=1).variance).all()


def test_counts_that_are_asked_for_change_no_bit(compiled):
    """The first N samples are the first N samples, whatever other N are looked at."""
    scene = shrunk(load("two_cubes"), compiled, 8)
    for term in TERMS:
        with Engine(scene, threads=1) as engine:
            asked = list(engine.prefixes(renderer.find(term), samples=5, seed=1, replicate=0, counts=iter((1, 3, 5))))
        assert [count for count, _, _ in asked] == [1, 3, 5]
        for count, image, _ in asked:
            named = {"variant": renderer.find(term).name, "samples": count, "seed": 1}
            assert image.tobytes() == render(scene, term, **named).mean.tobytes()
