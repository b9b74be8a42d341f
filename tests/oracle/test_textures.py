"""Images on surfaces in Mitsuba: the reference's own lookups, a file that Mitsuba reads by itself, and the terms.

Rationale: the reference has Mitsuba's own `bitmap`, but texels, uv and its v are handed over by us. So a scene is made
that Mitsuba reads from the same OBJ and PNG by its own readers, which share nothing with ours.
"""

from pathlib import Path
from typing import Any

import attrs
import numpy as np
import PIL.Image
import pytest
import trimesh
from scipy import ndimage

from termwise import reference
from termwise.reference import translate
from termwise.renderer import Engine, find, render
from termwise.scenes.analytic import plate
from termwise.scenes.exchange import mitsuba, neutral
from termwise.scenes.limits import Kernel, Limit
from termwise.scenes.load import load
from termwise.scenes.model import Ambient, Camera, Material, Mesh, Object, Photons, PointLight, Scene, Toggles
from termwise.scenes.textures import Texture


def room(**changes: Any) -> Scene:
    """A ball with places at random above a square, both black in a quarter, and glossy: the square by images too."""
    texels = np.random.default_rng(7).uniform(0.1, 0.9, (5, 4, 3)).astype(np.float32)
    texels[1:3, 1:3] = 0.0
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.5)
    uv = np.random.default_rng(5).uniform(-1.5, 1.5, (len(ball.faces), 3, 2))
    upper = Object("ball", Mesh.from_arrays(ball.vertices + (0.1, 0.2, 0.7), ball.faces, uv=uv), Material())
    floor = plate("floor", (-1.5, -1.5, 0.0), (3.0, 0.0, 0.0), (0.0, 3.0, 0.0), Material())
    lies = Mesh.from_arrays(floor.mesh.vertices, floor.mesh.faces, uv=[[-0.3, 0], [1.4, -0.2], [1, 1], [0, 1.7]])
    shares = np.random.default_rng(8).uniform(0.1, 0.7, (2, 3, 4))
    steel = (0.9, 0.6, 0.3)
    by_images = Material(Texture(texels[::-1, ::-1], "clamp"), Texture(shares[0]), Texture(0.2 + shares[1]), steel)
    things = (
        attrs.evolve(upper, material=Material(Texture(texels), 0.4, 0.5, steel)),
        attrs.evolve(floor, mesh=lies, material=by_images),
    )
    camera = Camera((0.2, -2.6, 2.4), (0.05, 0.0, 0.3), fov=45.0)
    scene = Scene("room", camera, things, (PointLight((-0.9, -1.0, 1.8), (6.0, 5.0, 4.0)),), resolution=(16, 16))
    scene = attrs.evolve(scene, ambient=Ambient((0.6, 0.5, 0.4)), photons=Photons(count=2000, radius=0.4))
    return attrs.evolve(scene, **changes)


@pytest.mark.rare
def test_both_sides_look_up_alike():
    """Nothing is random here but a camera ray's rounding: no occlusion, the middles of the pixels."""
    scene = room(toggles=Toggles(ambient_occlusion=False))
    scene = attrs.evolve(scene, camera=attrs.evolve(scene.camera, pixel="centre"), resolution=(32, 32))
    ours = render(scene, "ambient", samples=1).mean
    theirs = reference.render(scene, Limit("ambient", occluded=False), spp=1).mean
    assert ours.std() > 0.05
    # A ray in 1e5 meets another face of the ball's outline.
    assert np.count_nonzero(np.abs(ours - theirs).max(axis=2) > 1e-5) <= 2


@pytest.mark.rare
@pytest.mark.parametrize("wrap", ["repeat", "clamp"])
def test_mitsubas_own_readers_see_the_same(tmp_path: Path, wrap: str):
    """OBJ and PNG by Mitsuba, its v, its sRGB and its bilinear weights, at what our camera's rays meet."""
    bytes_ = np.random.default_rng(1).integers(0, 256, (3, 5, 3), dtype=np.uint8)
    PIL.Image.fromarray(bytes_).save(tmp_path / "a.png")
    corners, places = [(-1, -1), (1, -1), (1, 1), (-1, 1)], [(-0.25, 0.125), (1.5, 0.25), (1.0, 0.875), (0.0, 1.75)]
    rows = [f"v {x} {y} 0\nvt {u} {v}\n" for (x, y), (u, v) in zip(corners, places, strict=True)]
    (tmp_path / "a.obj").write_text("".join(rows) + "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n")
    (tmp_path / "a.toml").write_text(
        f"""
resolution = [12, 12]
camera = {{ position = [0.1, 0.2, 2.2], target = [0, 0, 0], up = [0, 1, 0], pixel = "centre" }}
toggles = {{ ambient_occlusion = false }}
ambient = {{ color = [1, 1, 1] }}

[[objects]]
name = "floor"
shape = "mesh"
file = "a.obj"
color = {{ file = "a.png", wrap = "{wrap}" }}
"""
    )
    scene = load(tmp_path / "a.toml")
    reference.loaded(scene)
    import mitsuba as mi

    texture = {"type": "bitmap", "filename": str(tmp_path / "a.png"), "wrap_mode": wrap}
    bsdf = {"type": "diffuse", "reflectance": texture}
    theirs = mi.load_dict(
        {"type": "scene", "floor": {"type": "obj", "filename": str(tmp_path / "a.obj"), "bsdf": bsdf}}
    )
    film = np.stack(np.meshgrid((np.arange(12) + 0.5) / 12, (np.arange(12) + 0.5) / 12), axis=-1).reshape(-1, 2)
    ways = scene.camera.rays(film, aspect=1.0)
    si = theirs.ray_intersect(mi.Ray3f(mi.Point3f(*scene.camera.position), mi.Vector3f(ways.T)))
    found = np.array(si.bsdf().eval_diffuse_reflectance(si, si.is_valid())).T * np.array(si.is_valid())[:, None]
    ours = render(scene, "ambient", samples=1).mean.reshape(-1, 3)
    assert 0.5 < ours.any(axis=1).mean()
    np.testing.assert_allclose(ours, found, atol=2e-5)


@pytest.mark.rare
def test_mitsubas_xml_lays_the_images_as_ours(tmp_path: Path):
    """Its file by Mitsuba's own parser, every gloss 0: the colours at what our camera's rays meet."""
    scene = neutral.diffuse(room(toggles=Toggles(ambient_occlusion=False), ambient=Ambient((1.0, 1.0, 1.0))))
    scene = attrs.evolve(scene, camera=attrs.evolve(scene.camera, pixel="centre"))
    mitsuba.write(scene, tmp_path / "room.xml")
    reference.loaded(scene)
    import mitsuba as mi

    width, height = scene.resolution
    film = np.stack(np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height), axis=-1)
    ways = scene.camera.rays(film.reshape(-1, 2), aspect=1.0)
    theirs = mi.load_file(str(tmp_path / "room.xml"))
    si = theirs.ray_intersect(mi.Ray3f(mi.Point3f(*scene.camera.position), mi.Vector3f(ways.T)))
    found = np.array(si.bsdf().eval_diffuse_reflectance(si, si.is_valid())).T * np.array(si.is_valid())[:, None]
    ours = render(scene, "ambient", samples=1).mean.reshape(-1, 3)
    assert ours.std() > 0.05
    np.testing.assert_allclose(ours, found, atol=1e-4)


def test_a_color_of_numbers_under_a_gloss_of_an_image():
    """`color (1 - gloss)` at the middles of the pixels, without occlusion, by SciPy's lookups."""
    texels = np.random.default_rng(6).uniform(0.0, 1.0, (3, 4)).astype(np.float32)
    square = plate("floor", (-1.0, -1.0, 0.0), (2.0, 0.0, 0.0), (0.0, 2.0, 0.0))
    mesh = Mesh.from_arrays(square.mesh.vertices, square.mesh.faces, uv=[[0, 0], [1, 0], [1, 1], [0, 1]])
    floor = attrs.evolve(square, mesh=mesh, material=Material((0.8, 0.4, 0.2), Texture(texels)))
    camera = Camera((0.0, 0.0, 2.0), (0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0), fov=45.0, pixel="centre")
    switches = Toggles(ambient_occlusion=False)
    scene = Scene("floor", camera, (floor,), ambient=Ambient((1.0, 1.0, 1.0)), toggles=switches, resolution=(8, 8))
    film = np.stack(np.meshgrid(*2 * [(np.arange(8) + 0.5) / 8]), axis=-1).reshape(-1, 2)
    ways = camera.rays(film, aspect=1.0)
    u, v = ((2.0 * ways[:, :2] / -ways[:, 2:]) + 1.0).T / 2.0
    gloss = ndimage.map_coordinates(texels.astype(float), ((1.0 - v) * 3 - 0.5, u * 4 - 0.5), order=1, mode="grid-wrap")
    found = reference.render(scene, Limit("ambient", occluded=False), spp=1).mean.reshape(-1, 3)
    np.testing.assert_allclose(found, (1.0 - gloss)[:, None] * (0.8, 0.4, 0.2), atol=1e-5)


# Lamps.


def screen(**changes: Any) -> Scene:
    """The room under a lamp of eight triangles, on which its image, in part black, lies at random, many times over."""
    rng = np.random.default_rng(11)
    texels = rng.uniform(1.0, 20.0, (4, 3, 3)).astype(np.float32)
    texels[1:3, 1] = 0.0
    x, y = np.meshgrid(np.linspace(-1.0, 1.2, 3), np.linspace(-0.9, 0.9, 3))
    vertices = np.stack([x.ravel(), y.ravel(), np.full(9, 2.2)], axis=1)
    quads = [(i + j, i + j + 3, i + j + 4, i + j + 1) for i in (0, 3) for j in (0, 1)]  # they face down
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    mesh = Mesh.from_arrays(vertices, faces, uv=rng.uniform(-1.5, 1.5, (8, 3, 2)))
    plain = room(lights=())
    things = (*plain.objects, Object("screen", mesh, emission=Texture(texels)))
    return attrs.evolve(plain, objects=things, **changes)


def test_a_lamp_that_is_drawn_shows_its_image():
    """From below, at the middles of the pixels, against SciPy's lookups where their rays meet its plane."""
    texels = np.random.default_rng(4).uniform(0.0, 9.0, (3, 5, 3)).astype(np.float32)
    lamp = plate("lamp", (-0.4, -0.5, 1.2), (0.0, 1.1, 0.0), (0.9, 0.0, 0.0))
    mesh = Mesh.from_arrays(
        lamp.mesh.vertices, lamp.mesh.faces, uv=np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * 1.9 - 0.3
    )
    camera = Camera((0.1, 0.2, 0.2), (0.05, 0.05, 1.2), up=(0.0, 1.0, 0.0), fov=60.0, pixel="centre")
    things = (attrs.evolve(lamp, mesh=mesh, emission=Texture(texels)),)
    scene = Scene("drawn", camera, things, resolution=(12, 12), draw_lights=True)
    film = np.stack(np.meshgrid(*2 * [(np.arange(12) + 0.5) / 12]), axis=-1).reshape(-1, 2)
    ways = camera.rays(film, aspect=1.0)
    met = np.array(camera.position) + ways / ways[:, 2:]  # the lamp's plane is 1 above
    s, t = (met[:, 1] + 0.5) / 1.1, (met[:, 0] + 0.4) / 0.9
    at = (1.3 - 1.9 * t) * 3 - 0.5, (1.9 * s - 0.3) * 5 - 0.5
    planes = np.moveaxis(texels.astype(np.float64), 2, 0)
    expected = np.stack([ndimage.map_coordinates(each, at, order=1, mode="grid-wrap") for each in planes], axis=1)
    inside = (s > 0) & (s < 1) & (t > 0) & (t < 1)
    assert 0.3 < inside.mean() < 1.0
    expected = np.where(inside[:, None], expected, 0.0)
    found = reference.render(scene, Limit("background"), spp=1).mean.reshape(-1, 3)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("wrap", ["repeat", "clamp"])
def test_a_lamp_lights_as_by_mitsubas_own_sampling(tmp_path: Path, wrap: str):
    """E at a point: where uv are a rectangle's, Mitsuba's `area` samples its bitmap's texels; ours are even over faces.

    Both are held against a Riemann sum of SciPy's lookups, in its 4.5 standard errors.
    """
    texels = np.random.default_rng(3).uniform(0.0, 9.0, (3, 4, 3)).astype(np.float32)
    texels[0, 0] = 90.0, 40.0, 9.0
    lamp = plate("lamp", (-0.5, -0.6, 1.0), (0.0, 1.2, 0.0), (1.0, 0.0, 0.0))
    mesh = Mesh.from_arrays(lamp.mesh.vertices, lamp.mesh.faces, uv=[[0, 0], [1, 0], [1, 1], [0, 1]])
    lamp = attrs.evolve(lamp, mesh=mesh, emission=Texture(texels, wrap))  # type: ignore[arg-type]
    floor = plate("floor", (-1.5, -1.5, 0.0), (3.0, 0.0, 0.0), (0.0, 3.0, 0.0))
    scene = Scene("lit", Camera((0.0, -2.4, 0.6), (0.0, 0.0, 0.0)), (floor, lamp), resolution=(2, 2))
    mitsuba.write(scene, tmp_path / "lit.xml")
    loaded = reference.loaded(scene)
    import drjit as dr
    import mitsuba as mi

    s, t = np.meshgrid(*2 * [(np.arange(400) + 0.5) / 400], indexing="ij")
    mode = {"repeat": "grid-wrap", "clamp": "nearest"}[wrap]
    at = (1.0 - t) * 3 - 0.5, s * 4 - 0.5
    planes = np.moveaxis(texels.astype(np.float64), 2, 0)
    sent = np.stack([ndimage.map_coordinates(plane, at, order=1, mode=mode) for plane in planes], axis=-1)
    point = np.array([0.3, -0.2, 0.0])
    way = np.stack([-0.5 + t, -0.6 + 1.2 * s, np.ones_like(s)], axis=-1) - point
    geometry = (way[..., 2] / (way**2).sum(axis=-1)) ** 2
    expected = 1.2 * (sent * geometry[..., None]).mean(axis=(0, 1))
    place = translate.Canonical.of(scene).points(point)
    for world, here in ((mi.load_file(str(tmp_path / "lit.xml")), point), (loaded.scenes["direct"], place)):
        it = dr.zeros(mi.Interaction3f, 2**19)
        it.p = mi.Point3f(*here.tolist())
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(1, 2**19)
        ds, weight = world.emitters()[0].sample_direction(it, sampler.next_2d())
        found = np.array(weight * dr.maximum(ds.d.z, 0.0)).T
        noise = found.std(axis=0) / np.sqrt(len(found))
        assert (noise < 0.003 * expected).all()
        assert (np.abs(found.mean(axis=0) - expected) < 4.5 * noise).all()


def test_photons_of_a_lamp_carry_what_leaves_it():
    """Their power is `pi ∫ L dA` by SciPy's lookups; those that start where it is black are none.

    A second lamp of one radiance, as bright, gets its share of them.
    """
    scene = screen()
    lamp = scene.objects[2]
    assert isinstance(lamp.emission, Texture)
    again = Object("plain", attrs.evolve(lamp.mesh, vertices=lamp.mesh.vertices + (0.0, 0.0, 1.0)), emission=(6.0,) * 3)
    loaded = reference.loaded(attrs.evolve(scene, objects=(*scene.objects, again)))
    from termwise.reference import kernel_reference

    weights = np.random.default_rng(2).dirichlet((1.0, 1.0, 1.0), 4000)
    places = np.einsum("nk,fkc->fnc", weights, np.asarray(lamp.mesh.uv))
    at = (1.0 - places[..., 1]) * 4 - 0.5, places[..., 0] * 3 - 0.5
    planes = np.moveaxis(lamp.emission.texels.astype(np.float64), 2, 0)
    sent = np.stack([ndimage.map_coordinates(plane, at, order=1, mode="grid-wrap") for plane in planes], axis=-1)
    area = 2.2 * 1.8
    expected = np.pi * area * sent.mean(axis=(0, 1)) * loaded.description["scale"] ** 2
    plain = np.pi * area * 6.0 * loaded.description["scale"] ** 2
    described = loaded.description
    surfaces = kernel_reference.surfaces_of(
        loaded.scenes["direct"], described["parts"], described["varying"], described["lamp_means"]
    )
    assert surfaces.emitters[0].share == pytest.approx(expected.mean() / (expected.mean() + plain), rel=0.15)
    origin, _, power = kernel_reference._emitted(surfaces.emitters, np.random.default_rng(1), 40_000)
    assert power.any(axis=1).all()
    of_screen = origin[:, 2] < origin[:, 2].mean()
    np.testing.assert_allclose(power[of_screen].sum(axis=0), expected, rtol=0.03)
    np.testing.assert_allclose(power[~of_screen].sum(axis=0), plain, rtol=0.03)
    assert (np.ptp(power[of_screen], axis=0) > 0.0).all()


CASES = {
    "ambient": ("ambient", "cosine", 32, Limit("ambient"), 128),
    "path": ("direct", "path", 64, Limit("direct", scope="all"), 256),
    "photons": ("direct", "photon-map", 8, Limit("direct", scope="all", kernel=Kernel("simpson", radius=0.4)), 8),
    "specular": ("specular", "vndf", 1024, Limit("specular", scope="all"), 2048),
    "lamp, path": ("direct", "path", 64, Limit("direct", scope="all"), 256),
    "lamp, photons": ("direct", "photon-map", 16, None, 16),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_terms_agree(name: str):
    """Means of each channel, and of each quarter of the picture, within their noise; photons in one kernel."""
    term, variant, samples, limit, spp = CASES[name]
    scene = (screen if name.startswith("lamp") else room)(photons=Photons(count=2000, radius=0.4))
    limit = limit or attrs.evolve(Limit(term, scope="all"), kernel=find(term, variant).kernel(scene, samples))
    with Engine(scene) as engine:
        runs = (
            engine.prefixes(find(term, variant), samples=samples, seed=1, replicate=k, chain="path") for k in range(16)
        )
        ours = np.array([list(run)[-1][1] for run in runs])
    theirs = np.array([reference.replicate(scene, limit, spp=spp, seed=2, replicate=k) for k in range(16)])
    a, b = (
        images.astype(np.float64).reshape(16, 2, 8, 2, 8, 3).mean(axis=(2, 4)).reshape(16, -1)
        for images in (ours, theirs)
    )
    apart = a.mean(axis=0) - b.mean(axis=0)
    noise = np.sqrt((a.var(axis=0, ddof=1) + b.var(axis=0, ddof=1)) / 16)
    assert (np.abs(apart) < 4.5 * noise).all()
    assert (noise < 0.01 * theirs.mean()).all()
    relative = ours.mean(axis=(0, 1, 2)) / theirs.mean(axis=(0, 1, 2)) - 1.0
    assert (np.abs(relative) < 0.01).all()


def test_what_single_precision_cannot_tell_apart_is_refused(tmp_path: Path):
    scene = room()
    floor = scene.objects[1]
    assert floor.mesh.uv is not None
    far = attrs.evolve(floor, mesh=attrs.evolve(floor.mesh, uv=floor.mesh.uv * 1e7))
    with pytest.raises(ValueError, match="objects: 'floor': color: .* texels lie along one face: allowed are at most"):
        translate.describe(attrs.evolve(scene, objects=(scene.objects[0], far)), tmp_path)
