"""The neutral scene file says the scene: by its published schema, and as a reader that knows nothing else takes it."""

import json
import math
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import OpenEXR
import pytest

from termwise.reports.engines import asked
from termwise.scenes.exchange.neutral import SCHEMA, describe, diffuse, left_out, write_neutral
from termwise.scenes.load import library
from termwise.scenes.model import Camera, Material, Scene, Sky, Toggles
from tests.scenes import small


def written(scene: Scene, folder: Path) -> dict[str, Any]:
    return json.loads(write_neutral(scene, folder).read_text("utf-8"))


def schema() -> Any:
    found = json.loads(SCHEMA.read_text("utf-8"))
    validator = pytest.importorskip("jsonschema").Draft202012Validator
    validator.check_schema(found)
    return validator(found)


@pytest.mark.parametrize("name", library())
def test_written_files_are_of_the_published_schema(name: str, tmp_path: Path):
    schema().validate(written(small(name), tmp_path))


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("version",), 4),
        (("objects", 0, "material", "transparency"), 0.5),
        (("objects", 0, "material", "ior"), 1.5),
        (("objects", 0, "material", "translucency"), 1.5),
        (("camera", "horizontal_fov"), 180.0),
        (("objects", 0, "material", "color"), [0.5, 0.5, 1.5]),
        (("objects", 0, "faces"), [[0, 1]]),
        (("lights", 0, "intensity"), [-1.0, 0.0, 0.0]),
        (("sky",), {"type": "constant"}),
        (("colour",), 1),
    ],
)
def test_the_schema_refuses_what_is_no_scene(path: tuple[Any, ...], value: Any, tmp_path: Path):
    found = written(small("monkey"), tmp_path)
    here = found
    for step in path[:-1]:
        here = here[step]
    here[path[-1]] = value
    assert not schema().is_valid(found)


def test_glass_is_of_the_schema(tmp_path: Path):
    scene = small("monkey")
    clear = Material(gloss=1.0, transparency=1.0)
    for material in (clear, Material(gloss=1.0, fresnel="dielectric")):
        glass = attrs.evolve(scene, objects=(attrs.evolve(scene.objects[0], material=material), *scene.objects[1:]))
        found = written(glass, tmp_path)
        assert found["version"] == 3
        schema().validate(found)
        del found["objects"][0]["material"]["ior"]
        assert not schema().is_valid(found)


def test_geometry_names_and_materials_are_the_scenes_own(tmp_path: Path):
    scene = small("cornell_box")
    found = written(scene, tmp_path)
    assert [each["name"] for each in found["objects"]] == [thing.name for thing in scene.objects]
    for each, thing in zip(found["objects"], scene.objects, strict=True):
        np.testing.assert_array_equal(each["vertices"], thing.mesh.vertices)
        np.testing.assert_array_equal(each["faces"], thing.mesh.faces)
    blocks = {each["name"]: each["material"] for each in found["objects"]}
    assert blocks["tall block"] == {
        "color": [0.7384, 0.7360, 0.7385],
        "gloss": 0.7,
        "roughness": 0.2,
        "f0": [0.9, 0.9, 0.9],
    }
    (lamp,) = (each for each in found["objects"] if any(each["emission"]))
    assert (lamp["name"], lamp["emission"]) == ("lamp", [24.0, 20.0, 15.0])
    assert lamp["material"]["color"] == [0.0, 0.0, 0.0]


def test_smooth_objects_bring_their_normals_and_lamps_none(tmp_path: Path):
    scene = small("smooth_monkey")
    for each, thing in zip(written(scene, tmp_path)["objects"], scene.objects, strict=True):
        if thing.mesh.normals is None:
            assert each["normals"] is None
        else:
            np.testing.assert_array_equal(each["normals"], thing.mesh.normals)
    shining = [attrs.evolve(thing, emission=(1.0, 1.0, 1.0)) for thing in scene.objects]
    lamps = attrs.evolve(scene, objects=tuple(shining))
    assert all(each["normals"] is None for each in written(lamps, tmp_path)["objects"])


@pytest.mark.parametrize("resolution", [(40, 30), (30, 40)])
def test_the_camera_by_its_convention_casts_the_scenes_rays(resolution: tuple[int, int], tmp_path: Path):
    camera = Camera((1.0, -2.0, 3.0), (0.2, 0.4, 1.0), (0.1, 0.2, 1.0), 71.0)
    scene = small("monkey", *resolution, camera=camera)
    found = written(scene, tmp_path)
    width, height = found["film"]["resolution"]
    frame = {key: np.array(found["camera"][key]) for key in ("right", "up", "forward")}
    t = math.tan(math.radians(found["camera"]["horizontal_fov"]) / 2.0)
    film = np.random.default_rng(1).random((50, 2))
    x, y = film[:, :1], film[:, 1:]
    seen = frame["forward"] + (2 * x - 1) * t * frame["right"] + (1 - 2 * y) * t * (height / width) * frame["up"]
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    np.testing.assert_allclose(seen, camera.rays(film, aspect=width / height), rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(np.cross(frame["forward"], frame["up"]), frame["right"], atol=1e-14)


def test_a_sky_of_texels_lies_beside_the_file(tmp_path: Path):
    scene = small("two_cubes")
    found = written(scene, tmp_path)
    assert found["sky"] == {
        "type": "image",
        "file": "two_cubes.sky.exr",
        "projection": "equal-area",
        "center": [0.0, 0.0, -12.0],
        "radius": 100.0,
    }
    (part,) = OpenEXR.File(str(tmp_path / "two_cubes.sky.exr")).parts
    np.testing.assert_array_equal(part.channels["RGB"].pixels, scene.sky.texture)
    endless = attrs.evolve(scene, sky=attrs.evolve(scene.sky, radius=math.inf))
    assert written(endless, tmp_path)["sky"]["radius"] is None


def test_a_constant_sky_and_none(tmp_path: Path):
    assert written(small("monkey"), tmp_path)["sky"] == {"type": "constant", "radiance": [0.5, 0.5, 0.8]}
    assert written(small("monkey", sky=Sky()), tmp_path)["sky"] is None


def test_switches_are_obeyed(tmp_path: Path):
    off = written(small("monkey", toggles=Toggles(lighting=False, reflections=False)), tmp_path)
    assert off["lights"] == []
    assert {each["material"]["gloss"] for each in off["objects"]} == {0.0}
    assert off["objects"][1]["material"]["color"] == [0.80, 0.35, 0.10]
    dark = written(small("cornell_box", toggles=Toggles(lighting=False)), tmp_path)
    assert not any(any(each["emission"]) for each in dark["objects"])


def test_diffuse_has_no_gloss_and_keeps_colours(tmp_path: Path):
    found = written(diffuse(small("cornell_box")), tmp_path)
    materials = {each["name"]: each["material"] for each in found["objects"]}
    assert {each["gloss"] for each in materials.values()} == {0.0}
    assert materials["tall block"]["color"] == [0.7384, 0.7360, 0.7385]


def test_what_light_transport_does_not_have_is_named(tmp_path: Path):
    paper = small("cornell_box", shadows="paper", irradiance="E", ignore="object", normals="face", intersection="paper")
    paper = attrs.evolve(paper, camera=attrs.evolve(paper.camera, pixel="corner"))
    named = {line.partition(" = ")[0] for line in written(paper, tmp_path)["left_out"]}
    assert named == {
        "ambient",
        "draw_lights",
        "scope",
        "shadows",
        "irradiance",
        "ignore",
        "normals",
        "intersection",
        "camera.pixel",
    }
    scene = attrs.evolve(small("cornell_box_unshadowed"), draw_lights=True)
    plain = attrs.evolve(scene, ambient=attrs.evolve(scene.ambient, color=(0.0, 0.0, 0.0)))
    assert written(plain, tmp_path)["left_out"] == []


def test_a_file_or_a_folder_is_named(tmp_path: Path):
    scene = small("two_cubes")
    assert write_neutral(scene, tmp_path / "new") == tmp_path / "new/two_cubes.json"
    assert write_neutral(scene, tmp_path / "mine.json") == tmp_path / "mine.json"
    assert (tmp_path / "mine.sky.exr").exists()
    assert sorted(each.name for each in (tmp_path / "new").iterdir()) == ["two_cubes.json", "two_cubes.sky.exr"]


def test_lights_of_all_kinds_are_said():
    scene = small("lights")
    described = describe(scene)
    assert [light["type"] for light in described["lights"]] == ["point", "sphere", "spot", "directional", "sun"]
    assert described["lights"][1] == {
        "type": "sphere",
        "center": [1.35, -1.1, 0.45],
        "radius": 0.22,
        "radiance": [3.0, 3.6, 4.2],
    }
    assert not [line for line in left_out(scene) if line.startswith("lights")]
    (unsaid,) = (row for row in asked.rows(scene) if row.absent)
    assert unsaid.name == "ambient"
    assert "sphere that shines" in str(unsaid.absent)
    for kind in ("point", "spot", "directional", "sun", "sphere"):
        assert asked.FEATURES[kind](described)
        others = [light for light in described["lights"] if light["type"] != kind]
        assert not asked.FEATURES[kind](described | {"lights": others})


def test_a_sphere_that_does_not_shine_hides_things_and_is_named():
    scene = small("lights")
    dark = attrs.evolve(scene, toggles=attrs.evolve(scene.toggles, lighting=False))
    assert describe(dark)["lights"] == []
    (line,) = (line for line in left_out(dark) if line.startswith("lights"))
    assert line.startswith("lights = SphereLight(")
