"""The references against closed forms: what Mitsuba is made to compute is the integral that is meant."""

from typing import Any

import attrs
import numpy as np
import pytest
import trimesh

from termwise import reference
from termwise.reference import backend
from termwise.reports.study import closed_forms
from termwise.scenes.analytic import furnace
from termwise.scenes.limits import Limit, correct, physical
from termwise.scenes.model import Ambient, Camera, Material, Mesh, Object, PointLight, Scene, Sky, Toggles

WHITE = (1.0, 1.0, 1.0)
SEED = 7


def plane(size: float = 4.0, material: Material | None = None, height: float = 0.0, name: str = "plane") -> Object:
    corners = size / 2 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) + [0, 0, height]
    return Object(name, Mesh.from_arrays(corners, [[0, 1, 2], [0, 2, 3]]), material or Material(color=WHITE))


def disc(radius: float, height: float, segments: int = 256) -> Object:
    """A polygon of the disc's area, facing down."""
    angle = 2 * np.pi * np.arange(segments) / segments
    radius = radius / np.sqrt(np.sinc(2 / segments))
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(segments, height)], axis=1)
    first = np.arange(segments) + 1
    faces = np.stack([np.zeros(segments, int), np.roll(first, -1), first], axis=1)
    return Object("disc", Mesh.from_arrays(np.vstack([[[0, 0, height]], ring]), faces))


def sphere(material: Material, subdivisions: int = 4) -> Object:
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    return Object("sphere", Mesh.from_arrays(ball.vertices, ball.faces), material)


# A pinhole that sees the origin alone, from below any disc.
SPOT = Camera(position=(0.4, 0.0, 0.2), target=(0.0, 0.0, 0.0), fov=0.01)


@pytest.mark.parametrize(("radius", "height"), [(1.0, 1.0), (0.5, 1.0), (2.0, 0.5)])
def test_ambient_below_a_disc(radius, height):
    """AO = h² / (h² + R²) over a point below a disc (form factor of a disc); binomial noise of 4 rays a sample."""
    scene = Scene("disc", SPOT, (plane(), disc(radius, height)), ambient=Ambient(WHITE), resolution=(16, 16))
    image = reference.replicate(scene, correct("ambient", "all"), spp=256, seed=SEED)
    expected = height**2 / (height**2 + radius**2)
    sigma = np.sqrt(expected * (1 - expected) / (4 * 256 * 256))
    assert image.mean(dtype=float) == pytest.approx(expected, abs=4.5 * sigma + 2e-4)  # 2e-4: polygon, ray offset


@pytest.mark.parametrize("reach", [1.5, 1.2, 0.9])
def test_ambient_range_ends_within_the_disc(reach):
    """A range between h and the rim: only directions with h / cos < range are hidden, AO = h² / range²."""
    scene = Scene("disc", SPOT, (plane(), disc(3.0, 1.0)), ambient=Ambient(WHITE, range=reach), resolution=(16, 16))
    image = reference.replicate(scene, correct("ambient", "all"), spp=256, seed=SEED)
    expected = min(1.0, 1.0 / reach**2)
    assert image.mean(dtype=float) == pytest.approx(expected, abs=4.5 * 0.5 / 512 + 2e-4)


@pytest.mark.skipif(backend.choose().variant == "scalar_rgb", reason="a million rays, one by one")
@pytest.mark.parametrize("reach", [np.inf, 100.0])
def test_occlusion_agrees_with_the_built_in_integrator(reach):
    """Without a range, and with one beyond the whole scene, our occlusion rays find what Mitsuba's `direct` does."""
    thing = sphere(Material(color=(0.2, 0.5, 0.9), gloss=0.25))
    thing = attrs.evolve(thing, mesh=attrs.evolve(thing.mesh, vertices=thing.mesh.vertices + [0, 0, 1.2]))
    camera = Camera(position=(4.0, 1.0, 2.0), target=(0.0, 0.0, 0.6))
    scene = Scene("ball", camera, (plane(), thing), ambient=Ambient((1.0, 2.0, 3.0)), resolution=(32, 32))
    own = reference.render(
        attrs.evolve(scene, ambient=Ambient((1.0, 2.0, 3.0), range=reach)),
        Limit("ambient"),
        spp=64,
        seed=3,
        replicates=8,
    )
    here = reference.loaded(scene)
    import mitsuba as mi

    from termwise.reference.wavefront import pixel_means

    direct = mi.load_dict({"type": "direct", "emitter_samples": 0, "bsdf_samples": 4, "hide_emitters": True})

    def built_in(samples):
        return (direct.sample(here.scenes["ambient"], samples.sampler, mi.RayDifferential3f(samples.ray))[0],)

    theirs = np.array([pixel_means(built_in, here.description["camera"], spp=64, seed=SEED + k)[0] for k in range(8)])
    deviation = (own.mean - theirs.mean(axis=0)).sum(axis=(0, 1))
    sigma = np.sqrt((own.variance + theirs.var(axis=0, ddof=1) / 8).sum(axis=(0, 1)))
    assert (np.abs(deviation) < 4.5 * sigma).all()
    assert (sigma < 2e-3 * own.mean.sum(axis=(0, 1))).all()


def test_ambient_occlusion_off_is_the_weight_times_the_light():
    material = Material(color=(0.2, 0.5, 0.9), gloss=0.25)
    scene = Scene(
        "off", SPOT, (plane(material=material), disc(1.0, 1.0)), ambient=Ambient((1.0, 2.0, 3.0)), resolution=(4, 4)
    )
    scene = attrs.evolve(scene, toggles=Toggles(ambient_occlusion=False))
    image = reference.replicate(scene, correct("ambient", "all"), spp=2, seed=SEED)
    np.testing.assert_allclose(image, np.broadcast_to([0.15, 0.75, 2.025], (4, 4, 3)), rtol=1e-6)
    paper = reference.replicate(scene, Limit("ambient", factor=np.pi), spp=2, seed=SEED)
    np.testing.assert_allclose(paper, np.pi * image, rtol=1e-6)


def inside(material: Material, **changes) -> Scene:
    """A camera and a point light of intensity π at the centre of a unit sphere."""
    lights = (PointLight((0.0, 0.0, 0.0), (np.pi, np.pi, np.pi)),)
    fields: dict[str, Any] = {"lights": lights} | changes
    camera = Camera(position=(0.0, 0.0, 0.0), target=(1.0, 0.3, 0.2), fov=120.0, pixel="centre")
    return Scene("inside", camera, (sphere(material),), resolution=(32, 32), **fields)


def test_direct_first_hit_inside_a_sphere():
    """L = rho/π · I h / d³ at distance d on a facet whose plane is h away: .5 on the sphere itself, no noise."""
    scene = inside(Material(color=(0.5, 0.5, 0.5)))
    from termwise.reference.geometry import geometry

    hits = geometry(scene)
    axis = (np.arange(32) + 0.5) / 32
    directions = scene.camera.rays(np.stack(np.meshgrid(axis, axis), axis=-1), aspect=1.0)
    height = np.abs((directions * hits.normal).sum(axis=-1)) * hits.depth
    image = reference.replicate(scene, correct("direct", "first-hit"), spp=2, seed=SEED)
    np.testing.assert_allclose(image[..., 0], 0.5 * height / hits.depth**3, rtol=2e-4)
    assert image.mean() == pytest.approx(0.5, rel=3e-3)


def test_direct_all_inside_a_sphere():
    """Closed and diffuse: the mean irradiance is Φ / (A (1 - rho)), L = 1 on the sphere, 4π/A on its facets."""
    scene = inside(Material(color=(0.5, 0.5, 0.5)))
    image = reference.replicate(scene, correct("direct", "all"), spp=64, seed=SEED)
    mesh = scene.objects[0].mesh
    area = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).area
    # 5e-4 tail of the depth; the facets' first-hit irradiance varies by 2e-3 over the picture.
    assert image.mean(dtype=float) == pytest.approx(4 * np.pi / area, rel=2e-3)


@pytest.mark.parametrize("bounces", [1, 2, 4])
@pytest.mark.parametrize("lobe", [1.0, 4 / np.pi])
def test_specular_chain_in_a_closed_sphere(bounces, lobe):
    """L_specular = D (q + q² + ... + q^M), q = lobe · g: the lobe is narrow and F0 = 1, so that A = 1 (to 1e-3).

    D = color (1 - g) L_a0 with ambient occlusion off. The ratio of lobe 4/π to 1 is 1.273, 1.404, 1.633.
    """
    material = Material(color=(0.5, 0.5, 0.5), gloss=0.6, roughness=0.05, f0=WHITE)
    scene = inside(
        material, lights=(), ambient=Ambient(WHITE), toggles=Toggles(ambient_occlusion=False), max_bounces=bounces
    )
    image = reference.replicate(scene, Limit("specular", scope="all", lobe=lobe), spp=64, seed=SEED)
    q = 0.6 * lobe
    expected = 0.5 * 0.4 * sum(q**k for k in range(1, bounces + 1))
    # The chosen vertex varies within a pixel: its weight M q^k has a spread that 65536 chains average out.
    weights = bounces * 0.2 * q ** np.arange(1, bounces + 1)
    assert image.mean(dtype=float) == pytest.approx(expected, abs=4.5 * weights.std() / 256 + 1e-3 * expected)


FURNACES = [(0.3, 0.7, 1.0), (0.6, 0.9, 0.04), (1.0, 0.3, 0.5)]
LIMITS = {
    "correct": Limit("specular", scope="all"),
    "lobe": Limit("specular", scope="all", lobe=4 / np.pi),
    "outgoing cosine": Limit("specular", scope="all", lobe=4 / np.pi, cosine="outgoing"),
    "blend": Limit("specular", scope="all", lobe=2 / np.pi, diffuse=0.5),
    "rings": Limit("specular", scope="all", lobe=2 / np.pi, diffuse=0.5, rings=16),
    "few rings": Limit("specular", scope="all", lobe=2.0, diffuse=0.5, rings=3),
}


@pytest.mark.parametrize("name", LIMITS)
@pytest.mark.parametrize(("alpha", "mu_o", "f0"), FURNACES)
def test_specular_limits_in_a_furnace(alpha, mu_o, f0, name):
    """A plate under a white sky, gloss .7: `gloss (lobe A + diffuse)` by quadrature, and the paper's rule on rings."""
    scene = attrs.evolve(furnace(roughness=alpha, mu_o=mu_o, f0=f0, gloss=0.7, color=0.5), resolution=(16, 16))
    image = reference.render(scene, LIMITS[name], spp=128, seed=SEED, replicates=8)
    expected = 0.7 * closed_forms.albedo(LIMITS[name], scene.objects[0].material, mu_o)[0]
    error = np.sqrt(image.variance[..., 0].mean()) / 16
    assert error < 0.01 * expected
    # 2e-4: float32, and the field of view.
    assert image.mean[..., 0].mean() == pytest.approx(expected, abs=4.5 * error + 2e-4 * expected)


@pytest.mark.parametrize("rings", [1, 4, 16])
def test_ambient_rings_below_a_disc(rings):
    """Rings lower than the rim's cosine are open: `(2/N) sum mu_k` over them, to the bit for any azimuth."""
    scene = Scene("disc", SPOT, (plane(), disc(1.0, 1.0)), ambient=Ambient(WHITE), resolution=(8, 8))
    image = reference.replicate(scene, Limit("ambient", rings=rings), spp=64, seed=SEED)
    mu = np.arange(1, rings + 1) / (rings + 1)
    seen = 2 * mu * (mu < np.sqrt(0.5))
    sigma = seen.std() / np.sqrt(4 * 64 * 64)
    assert image.mean(dtype=float) == pytest.approx(seen.mean(), abs=4.5 * sigma + 1e-6)


def test_ambient_without_occlusion():
    scene = Scene("disc", SPOT, (plane(), disc(1.0, 1.0)), ambient=Ambient((0.2, 0.4, 0.8)), resolution=(8, 8))
    image = reference.replicate(scene, Limit("ambient", occluded=False), spp=4, seed=SEED)
    np.testing.assert_allclose(image, np.broadcast_to((0.2, 0.4, 0.8), image.shape), rtol=1e-6)


def test_specular_mirror_sees_the_sky_with_parallax():
    """A nearly perfect mirror shows F0 times the sky where the reflected ray, from its own origin, meets the sphere."""
    texture = np.random.default_rng(0).random((8, 16, 3)).astype(np.float32)
    sky = Sky(texture=texture, center=(0.0, 1.0, 0.0), radius=5.0)
    mirror = Material(gloss=1.0, roughness=1e-4, f0=(1.0, 0.5, 0.25))
    camera = Camera(position=(2.0, 0.0, 1.0), target=(0.0, 0.0, 0.0), fov=20.0, pixel="centre")
    scene = Scene("mirror", camera, (plane(8.0, mirror),), sky=sky, resolution=(24, 24), max_bounces=1)
    axis = (np.arange(24) + 0.5) / 24
    directions = camera.rays(np.stack(np.meshgrid(axis, axis), axis=-1), aspect=1.0)
    hits = np.array(camera.position) - directions * (camera.position[2] / directions[..., 2:])
    fresnel = np.array(mirror.f0) + (1 - np.array(mirror.f0)) * (1 + directions[..., 2:]) ** 5
    expected = fresnel * looked_up(sky, hits, directions * [1, 1, -1])
    image = reference.replicate(scene, correct("specular", "all"), spp=64, seed=SEED)
    np.testing.assert_allclose(image, expected, atol=2e-3)


def looked_up(sky: Sky, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """The sky of `Sky`'s docstring, in float64."""
    assert sky.texture is not None
    offset = origins - np.array(sky.center)
    b = (directions * offset).sum(axis=-1)
    t = -b + np.sqrt(b * b - (offset * offset).sum(axis=-1) + sky.radius**2)
    n = (offset + t[..., None] * directions) / sky.radius
    height, width, _ = sky.texture.shape
    x = (np.arctan2(n[..., 0], n[..., 1]) / (2 * np.pi) + 0.5) * width - 0.5
    y = np.clip((0.5 - n[..., 2] / 2) * height - 0.5, 0, height - 1)
    i, j = np.floor(x).astype(int), np.minimum(np.floor(y).astype(int), height - 2)
    fx, fy = (x - i)[..., None], (y - j)[..., None]
    row = [(1 - fx) * sky.texture[j + k, i % width] + fx * sky.texture[j + k, (i + 1) % width] for k in (0, 1)]
    return (1 - fy) * row[0] + fy * row[1]


def test_physical_ambient_under_a_textured_sphere():
    """ambient = rho/π ∫ sky(w) cos dw, the sky looked up where the ray from this very point meets the sphere."""
    texture = np.random.default_rng(0).random((8, 16, 3)).astype(np.float32)
    sky = Sky(texture=texture, center=(0.5, 1.0, 0.0), radius=4.0)
    ground = plane(2.0, Material(color=(0.5, 0.5, 0.5)))
    camera = Camera(position=(0.2, 0.3, 1.0), target=(0.0, 0.0, 0.0), fov=0.01)
    scene = Scene("ground", camera, (ground,), sky=sky, resolution=(16, 16))
    image = reference.replicate(scene, physical("ambient"), spp=256, seed=1)
    u, v = np.meshgrid((np.arange(512) + 0.5) / 512, (np.arange(1024) + 0.5) / 1024)
    r, phi = np.sqrt(u), 2 * np.pi * v
    directions = np.stack([r * np.cos(phi), r * np.sin(phi), np.sqrt(1 - u)], axis=-1)
    expected = 0.5 * looked_up(sky, np.zeros_like(directions), directions).mean(axis=(0, 1))
    np.testing.assert_allclose(image.mean(axis=(0, 1), dtype=float), expected, rtol=5e-3)
    assert not reference.replicate(scene, physical("direct"), spp=4, seed=1).any()
    assert not reference.replicate(scene, physical("specular"), spp=4, seed=1).any()


def test_background_is_the_sky_and_the_front_of_drawn_lights():
    texture = np.random.default_rng(1).random((8, 16, 3)).astype(np.float32)
    sky = Sky(texture=texture, center=(0.0, 1.0, 0.0), radius=5.0)
    lamp = attrs.evolve(plane(1.0, name="lamp"), emission=(3.0, 2.0, 1.0))
    camera = Camera(position=(1.0, 0.5, 2.0), target=(0.0, 0.0, 0.0), fov=100.0, pixel="centre")
    scene = Scene("sky", camera, (lamp,), sky=sky, resolution=(48, 32))
    film = np.stack(np.meshgrid((np.arange(48) + 0.5) / 48, (np.arange(32) + 0.5) / 32), axis=-1)
    directions = camera.rays(film, aspect=1.5)
    expected = looked_up(sky, np.broadcast_to(camera.position, directions.shape), directions)
    from termwise.reference.geometry import geometry

    hit = geometry(scene).object == 0
    assert 0.01 < hit.mean() < 0.5
    off = Toggles(lighting=False)
    for changes, emission in [
        ({}, 0.0),
        ({"draw_lights": True}, lamp.emission),
        ({"draw_lights": True, "toggles": off}, 0.0),
    ]:
        image = reference.replicate(attrs.evolve(scene, **changes), correct("background", "all"), spp=1, seed=SEED)
        np.testing.assert_allclose(image, np.where(hit[..., None], emission, expected), atol=3e-5)
    behind = attrs.evolve(scene, draw_lights=True, camera=attrs.evolve(camera, position=(1.0, 0.5, -2.0)))
    image = reference.replicate(behind, correct("background", "all"), spp=1, seed=SEED)
    assert (image[geometry(behind).object == 0] == 0.0).all()


def test_lights_are_black_surfaces_in_every_term():
    """A lamp hides the ambient light and reflects nothing, in front and behind, whether it is lit or not."""
    lamp = attrs.evolve(plane(1.0, height=1.0, name="lamp"), emission=(3.0, 2.0, 1.0))
    camera = Camera(position=(0.0, 3.0, 1.5), target=(0.0, 0.0, 0.9), fov=50.0, pixel="centre")
    shiny = Material(gloss=0.5, f0=WHITE)
    scene = Scene(
        "lamp",
        camera,
        (plane(material=shiny), lamp),
        lights=(PointLight((0.0, 1.0, 2.0), WHITE),),
        ambient=Ambient(WHITE),
        sky=Sky(WHITE),
        resolution=(32, 32),
        scope="first-hit",
    )
    from termwise.reference.geometry import geometry

    on_lamp = geometry(scene).object == 1
    assert on_lamp.any()
    for term in ("ambient", "direct", "specular"):
        image = reference.replicate(scene, correct(term, "first-hit"), spp=4, seed=SEED)
        assert (image[on_lamp] == 0.0).all()
        assert image.max() > 0.0
    off = attrs.evolve(scene, toggles=Toggles(lighting=False))
    assert not reference.replicate(off, correct("direct", "first-hit"), spp=4, seed=SEED).any()
    same = reference.replicate(off, correct("ambient", "all"), spp=4, seed=SEED)
    np.testing.assert_array_equal(same, reference.replicate(scene, correct("ambient", "all"), spp=4, seed=SEED))


@pytest.fixture(scope="module")
def cubes() -> Scene:
    box = trimesh.creation.box(extents=(1.0, 1.0, 1.0))
    cube = Object("cube", Mesh.from_arrays(box.vertices + [0, 0, 0.5], box.faces), Material(gloss=0.4, f0=WHITE))
    lamp = attrs.evolve(plane(0.5, height=-2.0, name="lamp"), emission=(9.0, 8.0, 7.0))
    lamp = attrs.evolve(
        lamp, mesh=attrs.evolve(lamp.mesh, vertices=-lamp.mesh.vertices, faces=lamp.mesh.faces[:, ::-1])
    )
    return Scene(
        "cubes",
        Camera(position=(3.0, 2.0, 2.0), target=(0.0, 0.0, 0.4)),
        (plane(), cube, lamp),
        lights=(PointLight((1.0, 1.0, 1.5), (3.0, 3.0, 3.0)),),
        ambient=Ambient(WHITE, range=0.7),
        sky=Sky((0.2, 0.4, 0.8)),
        resolution=(32, 32),
    )


def moved(scene: Scene, scale: float, shift: np.ndarray) -> Scene:
    """The same scene at another size and place, its radiance unchanged."""

    def point(p):
        return tuple(float(x) for x in np.array(p) * scale + shift)

    return attrs.evolve(
        scene,
        camera=attrs.evolve(scene.camera, position=point(scene.camera.position), target=point(scene.camera.target)),
        objects=tuple(
            attrs.evolve(thing, mesh=Mesh.from_arrays(thing.mesh.vertices * scale + shift, thing.mesh.faces))
            for thing in scene.objects
        ),
        lights=tuple(
            attrs.evolve(light, position=point(light.position), intensity=tuple(x * scale**2 for x in light.intensity))
            for light in scene.lights
            if isinstance(light, PointLight)
        ),
        ambient=attrs.evolve(scene.ambient, range=scene.ambient.range * scale),
    )


@pytest.mark.slow
@pytest.mark.parametrize(("scale", "shift"), [(1e-3, 0.0), (1.0, 1024.0), (1e4, 0.0)])
@pytest.mark.parametrize("term", ["ambient", "direct", "specular"])
def test_size_and_place_do_not_matter(cubes, term, scale, shift):
    """Without the canonical scale Mitsuba loses 9 % of the occlusion at size 1e-3 or 1e3 from the origin.

    Equal seeds give equal rays, so the images differ by rounding and by a few rays that change sides.
    """
    limit = correct(term, "first-hit")
    image = reference.replicate(cubes, limit, spp=16, seed=SEED)
    other = reference.replicate(moved(cubes, scale, np.full(3, shift)), limit, spp=16, seed=SEED)
    assert np.abs(other - image).mean() < 2e-3 * image.mean()


@pytest.mark.slow
def test_seeds(cubes):
    """Equal seeds: equal bits. Another seed or replicate, a different image."""
    limit = correct("specular", "first-hit")
    image = reference.replicate(cubes, limit, spp=4, seed=1, replicate=0)
    np.testing.assert_array_equal(image, reference.replicate(cubes, limit, spp=4, seed=1, replicate=0))
    for seed, number in [(1, 1), (2, 0), (2, 1)]:
        other = reference.replicate(cubes, limit, spp=4, seed=seed, replicate=number)
        assert (other != image).any(axis=-1).sum() > 0.5 * image.any(axis=-1).sum() > 50
    seeds = {reference.rng_seed(limit, 1, number) + i for number in range(64) for i in range(reference.PASSES)}
    assert len(seeds) == 64 * reference.PASSES


def test_passes_split_a_replicate_without_changing_its_mean(cubes, monkeypatch):
    """Three passes of 16, 16 and 8 samples estimate what one pass of 40 does."""
    from termwise.reference import wavefront

    limit = correct("ambient", "all")
    whole = reference.render(cubes, limit, spp=40, seed=1, replicates=8)
    monkeypatch.setattr(wavefront, "WIDTH", 16 * 32 * 32)
    split = reference.render(cubes, limit, spp=40, seed=2, replicates=8)
    deviation = np.abs((split.mean - whole.mean).sum(axis=(0, 1)))
    assert (deviation < 4.5 * np.sqrt((split.variance + whole.variance).sum(axis=(0, 1)))).all()
    assert np.abs(split.mean - whole.mean).mean() > 0
