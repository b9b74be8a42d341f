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


def test_both_sides_look_up_alike():
    """Nothing is random here but a camera ray's rounding: no occlusion, the middles of the pixels."""
    scene = room(toggles=Toggles(ambient_occlusion=False))
    scene = attrs.evolve(scene, camera=attrs.evolve(scene.camera, pixel="centre"), resolution=(32, 32))
    ours = render(scene, "ambient", samples=1).mean
    theirs = reference.render(scene, Limit("ambient", occluded=False), spp=1).mean
    assert ours.std() > 0.05
    # A ray in 1e5 meets another face of the ball's outline.
    assert np.count_nonzero(np.abs(ours - theirs).max(axis=2) > 1e-5) <= 2


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


CASES = {
    "ambient": ("ambient", "cosine", 32, Limit("ambient"), 128),
    "path": ("direct", "path", 64, Limit("direct", scope="all"), 256),
    "photons": ("direct", "photon-map", 8, Limit("direct", scope="all", kernel=Kernel("simpson", radius=0.4)), 8),
    "specular": ("specular", "vndf", 1024, Limit("specular", scope="all"), 2048),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_terms_agree(name: str):
    """Means of each channel, and of each quarter of the picture, within their noise; photons in one kernel."""
    term, variant, samples, limit, spp = CASES[name]
    scene = room(photons=Photons(count=2000, radius=0.4))
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
