"""Mitsuba's XML of a scene: Mitsuba alone renders from it what our reference renders, in the scene's own units."""

from pathlib import Path

import attrs
import numpy as np
import pytest
import trimesh

from termwise import reference
from termwise.reference import backend
from termwise.reports.engines.furnaces import furnaces
from termwise.scenes.exchange import mitsuba as exchanged
from termwise.scenes.exchange import panorama
from termwise.scenes.limits import physical
from termwise.scenes.model import (
    Camera,
    DirectionalLight,
    Material,
    Mesh,
    Object,
    PointLight,
    Scene,
    Sky,
    SphereLight,
    SpotLight,
)


def rectangle(name: str, height: float, half: float, *, down: bool = False, **options: object) -> Object:
    corners = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) + [0, 0, height]
    faces = [[0, 2, 1], [0, 3, 2]] if down else [[0, 1, 2], [0, 2, 3]]
    return Object(name, Mesh.from_arrays(corners, faces), **options)  # type: ignore[arg-type]


def diffuse_scene(sky: Sky) -> Scene:
    """A box between two lamps and a point light, all in the picture but the lights; no axis is like another."""
    box = trimesh.creation.box(extents=(0.8, 0.5, 1.0))
    return Scene(
        "lit",
        Camera((1.5, 1.0, 2.5), (0.1, -0.1, 0.3), fov=35.0),
        (
            rectangle("the ground", 0.0, 4.0, material=Material((0.7, 0.5, 0.2))),
            Object("v1.5: box", Mesh.from_arrays(box.vertices + [0, 0, 0.6], box.faces), Material((0.2, 0.6, 0.9))),
            rectangle("lamp", 4.0, 0.5, down=True, emission=(9.0, 8.0, 1.0)),
        ),
        (
            PointLight((1.0, -1.5, 2.0), (1.0, 3.0, 2.0)),
            SpotLight((-1.0, 1.5, 2.5), (0.2, 0.0, 0.0), (9.0, 4.0, 1.0), 25.0, 10.0),
            DirectionalLight((0.3, 0.8, -1.0), (0.1, 0.4, 0.8)),
            SphereLight((-1.2, -2.0, 2.2), 0.3, (4.0, 1.0, 2.0)),
        ),
        sky=sky,
        resolution=(16, 12),
        draw_lights=True,
    )


def sky_of_texels() -> Sky:
    """Bright from one side, so that a map that is turned or mirrored shows."""
    texels = np.full((16, 32, 3), 0.1, np.float32)
    texels[3:9, 5:11] = [6.0, 2.0, 0.5]
    return Sky(texture=texels, radius=np.inf, projection="lat-long")


@pytest.mark.skipif(backend.choose().variant == "scalar_rgb", reason="a million paths, one by one")
def test_mitsuba_renders_the_references_image(tmp_path: Path):
    scene, count, spp = diffuse_scene(Sky((0.2, 0.4, 0.8))), 8, 128
    assert exchanged.write(scene, tmp_path / "lit.xml") == ["objects: 'v1.5: box': is called 'v1_5_ box'"]
    limit = reference.shared(scene, physical("direct"))
    ours = np.array(
        [
            np.sum(list(reference.replicate_parts(scene, limit, spp=spp, seed=1, replicate=k).values()), axis=0)
            for k in range(count)
        ]
    )
    mi = backend.import_mitsuba()
    loaded = mi.load_file(str(tmp_path / "lit.xml"), optimize=False)
    assert [shape.id() for shape in loaded.shapes()] == ["the ground", "v1_5_ box", "lamp", "light: 3"]
    box = loaded.shapes()[1]
    vertices = np.array(box.vertex_positions_buffer()).reshape(-1, 3)
    np.testing.assert_array_equal(vertices, scene.objects[1].mesh.vertices)
    theirs = np.array([np.array(mi.render(loaded, spp=spp, seed=k)) for k in range(count)], np.float64)
    # Means over quarters of the picture, so that one that is turned or mirrored shows.
    means = [images.reshape(count, 2, 6, 2, 8, 3).mean(axis=(2, 4)) for images in (ours, theirs)]
    error = np.sqrt(sum(each.var(axis=0, ddof=1) for each in means) / count)
    expected = means[0].mean(axis=0)
    assert (np.abs(means[1].mean(axis=0) - expected) < 5 * error).all()
    assert (error < 0.01 * expected).all()
    assert expected.max() / expected.min() > 2.0


def test_mitsubas_sky_is_seen_where_ours_is(tmp_path: Path):
    scene = diffuse_scene(attrs.evolve(sky_of_texels(), radius=50.0, projection="equal-area"))
    exchanged.write(scene, tmp_path / "lit.xml")
    mi = backend.import_mitsuba()
    sky = mi.load_file(str(tmp_path / "lit.xml")).environment()
    random = np.random.default_rng(5)
    n = random.normal(size=(60, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(-n.T)
    found = np.array(sky.eval(si)).T
    expected = panorama.seen(scene.sky, scene.camera.position, n)
    np.testing.assert_allclose(found, expected, atol=0.3)  # texels of the resampled map stand between ours
    assert np.abs(found - expected).mean() < 0.02


def test_names_that_mitsuba_has_itself_are_changed(tmp_path: Path):
    named = [rectangle(name, float(z), 1.0) for z, name in enumerate(("sensor", "a.b", "a_b", "a:b"))]
    scene = attrs.evolve(diffuse_scene(Sky()), objects=tuple(named), lights=())
    missing = exchanged.write(scene, tmp_path / "lit.xml")
    loaded = backend.import_mitsuba().load_file(str(tmp_path / "lit.xml"), optimize=False)
    assert [shape.id() for shape in loaded.shapes()] == ["sensor_", "a_b", "a_b_", "a_b__"]
    assert len(missing) == 4


def test_what_glossy_surfaces_lose_is_in_the_file(tmp_path: Path):
    glossy = rectangle("plate", 1.0, 1.0, material=Material((0.5, 0.5, 0.5), 0.5, 0.3, (0.9, 1.0, 0.04)))
    scene = attrs.evolve(diffuse_scene(Sky()), objects=(glossy,))
    (line,) = exchanged.write(scene, tmp_path / "lit.xml")
    assert "'plate': gloss = 0.5" in line
    assert line in (tmp_path / "lit.xml").read_text()
    backend.import_mitsuba().load_file(str(tmp_path / "lit.xml"))


def test_lamps_that_reflect_depth_and_samples_are_said(tmp_path: Path):
    """A closed box of emission e and albedo rho, in which light scatters once, shines e (1 + rho)."""
    (once,) = (each for each in furnaces() if each.asked.depth == 1)
    path = tmp_path / "box.xml"
    exchanged.write_described(once.asked.described, once.asked.scene, path, spp=32, seed=7, depth=1)
    mi = backend.import_mitsuba()
    loaded = mi.load_file(str(path))
    assert loaded.sensors()[0].sampler().sample_count() == 32
    off = np.array(mi.render(loaded), np.float64) - once.exact
    error = off.std(axis=(0, 1), ddof=1) / np.sqrt(off[..., 0].size)
    assert (np.abs(off.mean(axis=(0, 1))) < 5 * error + 1e-5).all()
    assert (error < 0.01 * once.exact[0, 0]).all()
