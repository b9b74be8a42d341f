"""What a scene is written as for other programs, read back by readers that are not the writers'."""

import json
import math
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import attrs
import numpy as np
import OpenEXR
import pytest
import trimesh

from termwise.reports import cli
from termwise.scenes import meshes
from termwise.scenes.exchange import gltf, mitsuba, neutral, obj, panorama, pbrt
from termwise.scenes.model import Camera, Material, Mesh, Object, PointLight, Scene, Sky
from tests.scenes import small

CAMERA = Camera((1.3, -4.6, 1.9), (0.1, 0.3, 0.9), (0.1, 0.2, 1.0), 52.0)
FILM = np.random.default_rng(1).random((40, 2))


def scene(width: int = 40, height: int = 30) -> Scene:
    """A flat lamp, a smooth and glossy ball, and a diffuse shard with a name that needs care."""
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.7)
    shard = Mesh.from_arrays(np.random.default_rng(2).normal(size=(5, 3)), [[0, 1, 2], [2, 3, 4]])
    lamp = Mesh.from_arrays([[-1, -1, 4], [1, -1, 4], [0, 1, 4]], [[0, 2, 1]])
    glossy = Material((0.8, 0.3, 0.1), 0.25, 0.3, (0.9, 0.5, 0.3))
    return Scene(
        "all",
        CAMERA,
        (
            Object("ball 1", Mesh.from_arrays(ball.vertices, ball.faces, smooth=True), glossy),
            Object('a "shard" of #1', shard, Material((0.25, 0.5, 0.75))),
            Object("lamp", lamp, emission=(24.0, 0.3, 15.0)),
        ),
        (PointLight((-2.5, -3.5, 4.5), (80.0, 72.0, 0.5)),),
        sky=Sky((0.5, 0.25, 0.125)),
        resolution=(width, height),
        draw_lights=True,
    )


def cast(right: Any, up: Any, forward: Any, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Unit directions through (x, y), to the right and up, on the plane at distance 1."""
    seen = forward + x[:, None] * right + y[:, None] * up
    return seen / np.linalg.norm(seen, axis=1, keepdims=True)


# GLB


def chunks(path: Path) -> dict[str, Any]:
    data = path.read_bytes()
    length = int.from_bytes(data[12:16], "little")
    assert data[:4] == b"glTF"
    assert int.from_bytes(data[8:12], "little") == len(data)
    return json.loads(data[20 : 20 + length])


UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""glTF's y is up: what is at (x, y, z) of a scene is at (x, z, -y)."""


def test_glb_has_the_geometry_under_the_names(tmp_path: Path):
    given, path = scene(), tmp_path / "all.glb"
    gltf.write(given, path)
    vertices, faces = meshes.read(path)
    corners = np.concatenate([thing.mesh.vertices[thing.mesh.faces] for thing in given.objects])
    np.testing.assert_array_equal(vertices[faces], corners @ UPRIGHT.T)
    loaded = trimesh.load_scene(path, process=False)
    for thing in given.objects:
        (node,) = (each for each in loaded.graph.nodes_geometry if each == thing.name)
        matrix, geometry = loaded.graph[node]
        found = loaded.geometry[geometry].apply_transform(matrix)
        np.testing.assert_array_equal(found.triangles, thing.mesh.vertices[thing.mesh.faces] @ UPRIGHT.T)
        if thing.mesh.normals is not None:
            placed = thing.mesh.normals @ UPRIGHT.T
            np.testing.assert_allclose(found.vertex_normals, placed, atol=1e-6)


def test_glb_has_the_materials_and_lights(tmp_path: Path):
    given, path = scene(), tmp_path / "all.glb"
    missing = gltf.write(given, path)
    found = chunks(path)
    materials = {each["name"]: each for each in found["materials"]}
    shard = materials['a "shard" of #1']
    assert shard["pbrMetallicRoughness"]["baseColorFactor"] == [0.25, 0.5, 0.75, 1.0]
    assert shard["pbrMetallicRoughness"]["metallicFactor"] == 0.0
    assert shard["extensions"]["KHR_materials_specular"]["specularFactor"] == 0.0
    assert shard["doubleSided"]
    lamp = materials["lamp"]
    strength = lamp["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"]
    assert max(lamp["emissiveFactor"]) <= 1.0
    np.testing.assert_allclose(np.multiply(lamp["emissiveFactor"], strength), [24.0, 0.3, 15.0])
    assert not lamp["doubleSided"]
    (light,) = found["extensions"]["KHR_lights_punctual"]["lights"]
    assert light["type"] == "point"
    assert max(light["color"]) <= 1.0
    np.testing.assert_allclose(np.multiply(light["color"], light["intensity"]), [80.0, 72.0, 0.5])
    (node,) = (each for each in found["nodes"] if "KHR_lights_punctual" in each.get("extensions", {}))
    assert node["translation"] == [-2.5, -3.5, 4.5]
    assert set(found["extensionsUsed"]) == {
        "KHR_lights_punctual",
        "KHR_materials_emissive_strength",
        "KHR_materials_specular",
    }
    assert found["asset"]["extras"]["left_out"] == missing
    assert [line.partition(": ")[0] for line in missing] == ["objects", "objects", "sky", "film"]


@pytest.mark.parametrize("size", [(40, 30), (30, 40)])
def test_glb_looks_through_the_camera(size: tuple[int, int], tmp_path: Path):
    given, path = scene(*size), tmp_path / "all.glb"
    gltf.write(given, path)
    found = chunks(path)
    (node,) = (each for each in found["nodes"] if "camera" in each)
    root = np.array(found["nodes"][found["scenes"][0]["nodes"][0]]["matrix"]).reshape(4, 4).T
    matrix = root @ np.array(node["matrix"]).reshape(4, 4).T
    lens = found["cameras"][0]["perspective"]
    high = math.tan(lens["yfov"] / 2.0)
    x, y = (2 * FILM[:, 0] - 1) * high * lens["aspectRatio"], (1 - 2 * FILM[:, 1]) * high
    seen = cast(matrix[:3, 0], matrix[:3, 1], -matrix[:3, 2], x, y)
    expected = given.camera.rays(FILM, aspect=size[0] / size[1]) @ UPRIGHT.T
    np.testing.assert_allclose(seen, expected, atol=1e-14)
    np.testing.assert_allclose(matrix[:3, 3], UPRIGHT @ given.camera.position)


def test_glb_of_few_things_is_whole(tmp_path: Path):
    bare = attrs.evolve(scene(), objects=(), lights=())
    gltf.write(bare, tmp_path / "bare.glb")
    found = chunks(tmp_path / "bare.glb")
    assert not {"extensionsUsed", "meshes", "buffers", "accessors", "materials"} & set(found)


# OBJ


def test_obj_has_the_geometry_under_the_names(tmp_path: Path):
    given, path = scene(), tmp_path / "all.obj"
    obj.write(given, path)
    vertices, faces = meshes.read(path)
    corners = np.concatenate([thing.mesh.vertices[thing.mesh.faces] for thing in given.objects])
    np.testing.assert_array_equal(vertices[faces], corners)
    loaded = trimesh.load_scene(path, process=False, split_objects=True, group_material=False)
    sizes = sorted(len(each.faces) for each in loaded.geometry.values())
    assert sizes == sorted(len(thing.mesh.faces) for thing in given.objects)
    triangles = np.concatenate([each.triangles for each in loaded.geometry.values()])
    np.testing.assert_array_equal(np.sort(triangles.reshape(-1, 9), axis=0), np.sort(corners.reshape(-1, 9), axis=0))
    assert re.findall(r"^o (.*)$", path.read_text(), re.MULTILINE) == ["ball 1", 'a "shard" of _1', "lamp"]


def test_mtl_has_the_colours(tmp_path: Path):
    missing = obj.write(scene(), tmp_path / "all.obj")
    text = (tmp_path / "all.mtl").read_text()
    used = re.findall(r"^usemtl (.*)$", (tmp_path / "all.obj").read_text(), re.MULTILINE)
    assert re.findall(r"^newmtl (.*)$", text, re.MULTILINE) == used == ["ball_1", 'a_"shard"_of__1', "lamp"]
    blocks = [dict(line.split(" ", 1) for line in block.splitlines()[1:]) for block in text.split("\n\nnewmtl")[1:]]
    values = [{key: [float(x) for x in each.split()] for key, each in block.items() if key} for block in blocks]
    np.testing.assert_allclose(values[0]["Kd"], np.multiply(0.75, [0.8, 0.3, 0.1]))
    np.testing.assert_allclose(values[0]["Ks"], np.multiply(0.25, [0.9, 0.5, 0.3]))
    assert values[1] == {"Kd": [0.25, 0.5, 0.75], "illum": [1.0]}
    assert (values[2]["Kd"], values[2]["Ke"]) == ([0.0, 0.0, 0.0], [24.0, 0.3, 15.0])
    for line in missing:
        assert f"# {line}" in text
    assert [line.partition(":")[0] for line in missing] == [
        "camera",
        "objects",
        "lights[0]",
        "sky",
        "objects",
        "objects",
    ]


def test_materials_of_obj_have_names_of_their_own():
    assert obj.material_names(["a b", "a_b", "a\tb", "a#"]) == ["a_b", "a_b_", "a_b__", "a_"]


# pbrt: a parser by the grammar that pbrt-v4 publishes as its src/pbrt/parser.cpp

TOKEN = re.compile(r'\s*(?:(#[^\n\r]*)|("(?:[^"\\\n]|\\.)*")|([\[\]])|([^\s"\[\]]+))')
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
COUNTS = {"LookAt": 9, "Scale": 3, "Translate": 3}
NAMED = {
    "Camera",
    "Film",
    "PixelFilter",
    "Sampler",
    "Integrator",
    "LightSource",
    "AreaLightSource",
    "Shape",
    "Material",
    "MakeNamedMaterial",
}
TYPES = {"integer": int, "float": float, "bool": bool, "string": str}
TYPES |= dict.fromkeys(("point3", "normal", "rgb"), float)


def tokens(text: str) -> list[str]:
    found, at = [], 0
    while text[at:].strip():
        match = TOKEN.match(text, at)
        assert match, text[at : at + 80]
        at = match.end()
        if not match[1]:
            found.append(match[0].strip())
    return found


def dequoted(token: str) -> str:
    assert token[0] == token[-1] == '"', token
    return re.sub(r"\\(.)", r"\1", token[1:-1])


def value_of(token: str, kind: type) -> Any:
    if token[0] == '"':
        assert kind is str, token
        return dequoted(token)
    if token in ("true", "false"):
        assert kind is bool, token
        return token == "true"
    assert re.fullmatch(r"[-+]?\d+", token) if kind is int else kind is float and NUMBER.fullmatch(token), token
    return kind(token)


def parse(text: str) -> list[tuple[str, list[Any], dict[str, list[Any]]]]:
    """Directives: name, arguments, parameters by `type name`."""
    left, found = tokens(text)[::-1], []
    while left:
        word = left.pop()
        if word in COUNTS:
            found.append((word, [value_of(left.pop(), float) for _ in range(COUNTS[word])], {}))
        elif word in NAMED:
            argument, parameters = dequoted(left.pop()), {}
            while left and left[-1][0] == '"':
                declared = dequoted(left.pop()).split()
                assert len(declared) == 2
                values, kind = [], TYPES[declared[0]]
                token = left.pop()
                if token != "[":
                    values.append(value_of(token, kind))
                else:
                    while (token := left.pop()) != "]":
                        values.append(value_of(token, kind))
                parameters[" ".join(declared)] = values
            found.append((word, [argument], parameters))
        else:
            assert word in ("WorldBegin", "AttributeBegin", "AttributeEnd"), word
            found.append((word, [], {}))
    return found


def written(given: Scene, folder: Path) -> list[tuple[str, list[Any], dict[str, list[Any]]]]:
    pbrt.write(given, folder / "all.pbrt")
    return parse((folder / "all.pbrt").read_text())


def one(found: list[Any], word: str) -> dict[str, list[Any]]:
    (parameters,) = (each[2] for each in found if each[0] == word)
    return parameters


def test_pbrt_has_the_geometry_under_the_names(tmp_path: Path):
    given = scene()
    found = written(given, tmp_path)
    shapes = [parameters for word, _, parameters in found if word == "Shape"]
    for parameters, thing in zip(shapes, given.objects, strict=True):
        vertices = np.array(parameters["point3 P"]).reshape(-1, 3)
        np.testing.assert_array_equal(vertices, thing.mesh.vertices)
        np.testing.assert_array_equal(np.array(parameters["integer indices"]).reshape(-1, 3), thing.mesh.faces)
        assert ("normal N" in parameters) == (thing.mesh.normals is not None)
    names = re.findall(r"^# (.*)$", (tmp_path / "all.pbrt").read_text().partition("WorldBegin")[2], re.MULTILINE)
    assert names == [thing.name for thing in given.objects]
    words = [word for word, _, _ in found]
    assert words.count("AttributeBegin") == words.count("AttributeEnd") == 3
    assert not {"Camera", "Film", "Sampler", "Integrator", "PixelFilter"} & set(words[words.index("WorldBegin") :])


def test_pbrt_has_the_materials_and_lights(tmp_path: Path):
    found = written(scene(), tmp_path)
    named = {arguments[0]: parameters for word, arguments, parameters in found if word == "MakeNamedMaterial"}
    assert named["ball 1: diffuse"] == {"string type": ["diffuse"], "rgb reflectance": [0.8, 0.3, 0.1]}
    assert named["ball 1: lobe"]["float roughness"] == [0.3]
    assert named["ball 1: lobe"]["bool remaproughness"] == [False]
    (mix,) = (parameters for word, arguments, parameters in found if (word, arguments) == ("Material", ["mix"]))
    assert mix == {"string materials": ["ball 1: diffuse", "ball 1: lobe"], "float amount": [0.25]}
    assert one(found, "AreaLightSource") == {"rgb L": [24.0, 0.3, 15.0]}
    lights = {arguments[0]: parameters for word, arguments, parameters in found if word == "LightSource"}
    assert lights["point"] == {"rgb I": [80.0, 72.0, 0.5], "point3 from": [-2.5, -3.5, 4.5]}
    assert lights["infinite"] == {"rgb L": [0.5, 0.25, 0.125]}


def test_pbrt_has_lights_of_all_kinds(tmp_path: Path):
    given = small("lights")
    found = written(given, tmp_path)
    lights = [(arguments[0], parameters) for word, arguments, parameters in found if word == "LightSource"]
    assert [name for name, _ in lights] == ["point", "spot", "distant", "distant", "infinite"]
    spot, sun = lights[1][1], lights[3][1]
    at = [word for word, _, _ in found].index("Translate")
    assert found[at][1] == [1.35, -1.1, 0.45]
    assert [word for word, _, _ in found[at + 1 : at + 5]] == ["Material", "AreaLightSource", "Shape", "AttributeEnd"]
    assert found[at + 2][2] == {"rgb L": [3.0, 3.6, 4.2]}
    assert found[at + 3][1:] == (["sphere"], {"float radius": [0.22]})
    assert (spot["float coneangle"], spot["rgb I"]) == ([16.0], [36.0, 34.0, 30.0])
    np.testing.assert_allclose(spot["float conedeltaangle"], [5.0])
    way = np.subtract(spot["point3 to"], spot["point3 from"])
    np.testing.assert_allclose(way, given.lights[2].axis, atol=1e-12)  # type: ignore[union-attr]
    assert sun["rgb L"] == [0.75, 0.62, 0.42]
    np.testing.assert_allclose(np.negative(sun["point3 from"]), given.lights[4].way)  # type: ignore[union-attr]


@pytest.mark.parametrize("size", [(40, 30), (30, 40)])
def test_pbrt_looks_through_the_camera(size: tuple[int, int], tmp_path: Path):
    given = scene(*size)
    found = written(given, tmp_path)
    (scale,), (look,) = ([arguments for word, arguments, _ in found if word == name] for name in ("Scale", "LookAt"))
    eye, target, up = np.array(look).reshape(3, 3)
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(up / np.linalg.norm(up), forward)  # of pbrt's left-handed frame
    right /= np.linalg.norm(right)
    frame = np.stack([right, np.cross(forward, right), forward]) * np.array(scale)[:, None]
    # Its film: the shorter side is [-1, 1], y up, at the distance where fov spans it.
    t = math.tan(math.radians(one(found, "Camera")["float fov"][0]) / 2.0)
    width, height = (one(found, "Film")[f"integer {axis}resolution"][0] for axis in "xy")
    x = (2 * FILM[:, 0] - 1) * t * max(width / height, 1.0)
    y = (1 - 2 * FILM[:, 1]) * t * max(height / width, 1.0)
    seen = cast(frame[0], frame[1], frame[2], x, y)
    np.testing.assert_allclose(seen, given.camera.rays(FILM, aspect=width / height), atol=1e-7)
    np.testing.assert_allclose(eye, given.camera.position)


def test_pbrt_is_told_what_its_defaults_are_not(tmp_path: Path):
    found = written(scene(), tmp_path)
    assert one(found, "Integrator")["integer maxdepth"][0] >= 100  # 5
    assert one(found, "Film")["bool savefp16"] == [False]
    assert one(found, "PixelFilter") == {"float xradius": [0.5], "float yradius": [0.5]}


# The sky's image


def stripes(projection: str, radius: float = math.inf) -> Sky:
    """Radiance is what it is called: red and green by the direction about z, blue by z, all smooth."""
    height, width = 64, 256
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    angle = 2 * np.pi * (u - 0.5)  # atan2(x, y)
    z = 1 - 2 * v if projection == "equal-area" else np.cos(np.pi * v)
    texture = np.stack([1 + np.sin(angle), 1 + np.cos(angle), 1 + z], axis=-1).astype(np.float32)
    return Sky(texture=texture, projection=projection, radius=radius)  # type: ignore[arg-type]


def of_directions(n: np.ndarray) -> np.ndarray:
    flat = np.hypot(n[..., 0], n[..., 1])
    return np.stack([1 + n[..., 0] / flat, 1 + n[..., 1] / flat, 1 + n[..., 2]], axis=-1)


@pytest.mark.parametrize("projection", ["equal-area", "lat-long"])
def test_the_sky_is_seen_where_it_is(projection: str):
    n = np.random.default_rng(3).normal(size=(200, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    n = n[np.abs(n[:, 2]) < 0.95]
    found = panorama.seen(stripes(projection), (5.0, 6.0, 7.0), n)
    np.testing.assert_allclose(found, of_directions(n), atol=5e-3)


def test_a_near_sky_is_seen_with_its_parallax():
    point = np.array([0.3, -0.5, 0.2])
    n = np.random.default_rng(4).normal(size=(200, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    n = n[np.abs(n[:, 2]) < 0.9]
    along = 2.0 * n - point  # to where they lie on the sphere of radius 2
    found = panorama.seen(stripes("lat-long", 2.0), tuple(point), along / np.linalg.norm(along, axis=1, keepdims=True))
    np.testing.assert_allclose(found, of_directions(n), atol=5e-3)
    outside = panorama.seen(stripes("lat-long", 2.0), (0.0, 0.0, 5.0), np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    assert not outside.any()


def test_maps_of_the_sky_hold_the_same_light():
    """Over the whole sphere: pbrt's texels are of equal area, those of a panorama go with the sine."""
    sky = stripes("equal-area")
    square = panorama.equal_area_square(sky, (0.0, 0.0, 0.0))
    map_ = panorama.latitude_longitude(sky, (0.0, 0.0, 0.0))
    height, width = map_.shape[:2]
    assert width == 2 * height
    weight = np.sin(np.pi * (np.arange(height) + 0.5) / height)[:, None, None]
    mean = (map_ * weight).sum(axis=(0, 1)) / (weight.sum() * width)
    np.testing.assert_allclose(square.mean(axis=(0, 1)), [1.0, 1.0, 1.0], atol=2e-3)
    np.testing.assert_allclose(mean, [1.0, 1.0, 1.0], atol=2e-3)


def test_the_square_is_folded_to_a_sphere():
    centres = (np.arange(64) + 0.5) / 64
    n = panorama.square_to_sphere(*np.meshgrid(centres, centres))
    np.testing.assert_allclose(np.linalg.norm(n, axis=-1), 1.0)
    np.testing.assert_allclose(np.mean(n, axis=(0, 1)), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.mean(n[..., 2] > 0.5), 0.25, atol=5e-3)  # a cap's area goes with its height
    assert panorama.square_to_sphere(np.array(0.5), np.array(0.5)).tolist() == [0.0, 0.0, 1.0]
    np.testing.assert_allclose(panorama.square_to_sphere(np.array(1.0), np.array(0.5)), [1.0, 0.0, 0.0], atol=1e-15)


def test_pbrts_sky_lies_beside_its_file(tmp_path: Path):
    given = small("two_cubes")
    found = written(given, tmp_path)
    assert one(found, "LightSource") == {"string filename": ["all.sky.exr"]}
    pixels = OpenEXR.File(str(tmp_path / "all.sky.exr")).parts[0].channels["RGB"].pixels
    assert pixels.shape[0] == pixels.shape[1]


# The command

FORMATS = {"neutral": ".json", "mitsuba": ".xml", "gltf": ".glb", "pbrt": ".pbrt", "obj": ".obj"}


def run(*words: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    status = cli.app(["export", *words], exit_on_error=False, result_action="return_value")
    out, err = capsys.readouterr()
    return status, out, err


@pytest.mark.parametrize("to", FORMATS)
def test_export_writes_where_it_is_told(to: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    suffix = FORMATS[to]
    status, out, _ = run("monkey", "--to", to, "-o", str(tmp_path / "new"), capsys=capsys)
    assert (status, out.strip()) == (0, str(tmp_path / f"new/monkey{suffix}"))
    assert (tmp_path / f"new/monkey{suffix}").is_file()
    run("monkey", "--to", to, "-o", str(tmp_path / f"mine{suffix}"), capsys=capsys)
    assert (tmp_path / f"mine{suffix}").is_file()


def test_export_says_what_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    arguments = ["cornell_box", "--to", "gltf", "-o", str(tmp_path)]
    _, out, err = run(*arguments, "--json", capsys=capsys)
    found = json.loads(out)
    assert found["file"] == str(tmp_path / "cornell_box.glb")
    assert err.splitlines() == [f"termwise: cornell_box.glb: {line}" for line in found["left_out"]]
    assert sum("gloss" in line for line in found["left_out"]) == 2
    _, out, _ = run(*arguments, "--diffuse", "--json", capsys=capsys)
    assert not any("gloss" in line for line in json.loads(out)["left_out"])
    assert {
        each["pbrMetallicRoughness"]["metallicFactor"] for each in chunks(tmp_path / "cornell_box.glb")["materials"]
    } == {0}


def test_export_refuses_a_name_of_another_format(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(ValueError, match=r"output = .*a\.obj: allowed is a name that ends in \.glb, or a folder"):
        run("monkey", "--to", "gltf", "-o", str(tmp_path / "a.obj"), capsys=capsys)
    assert list(tmp_path.iterdir()) == []


def test_light_that_crosses_is_said_by_each_format(tmp_path: Path):
    """Glossy too; a reader of the neutral file who does not know it is told by the version."""
    ball, shard, lamp = scene().objects
    crossed = [
        attrs.evolve(each, material=attrs.evolve(each.material, translucency=0.25)) for each in (ball, shard, lamp)
    ]
    given = attrs.evolve(scene(), objects=tuple(crossed))
    described = neutral.describe(given)
    assert (described["version"], neutral.describe(scene())["version"]) == (2, 1)
    assert [each["material"].get("translucency") for each in described["objects"]] == [0.25, 0.25, None]
    assert not any("translucency" in each["material"] for each in neutral.describe(neutral.diffuse(given))["objects"])

    gltf.write(given, tmp_path / "all.glb")
    found = chunks(tmp_path / "all.glb")
    name = "KHR_materials_diffuse_transmission"
    assert name in found["extensionsUsed"]
    first, second, third = (each["extensions"].get(name) for each in found["materials"])
    assert first == {"diffuseTransmissionFactor": 0.25, "diffuseTransmissionColorFactor": [0.8, 0.3, 0.1]}
    assert second == {"diffuseTransmissionFactor": 0.25, "diffuseTransmissionColorFactor": [0.25, 0.5, 0.75]}
    assert third is None

    parsed = written(given, tmp_path)
    both = {"rgb reflectance": [0.1875, 0.375, 0.5625], "rgb transmittance": [0.0625, 0.125, 0.1875]}
    assert ("Material", ["diffusetransmission"], both) in parsed
    named = {arguments[0]: parameters for word, arguments, parameters in parsed if word == "MakeNamedMaterial"}
    assert named["ball 1: diffuse"]["string type"] == ["diffusetransmission"]

    missing = [line for line in obj.write(given, tmp_path / "all.obj") if "translucency = 0.25" in line]
    assert [line.partition(":")[0] for line in missing] == ["objects", "objects"]


GLASS = Material((0.5, 0.25, 0.75), 0.5, 0.25, transparency=0.75, ior=1.25, tint=(1.0, 0.5, 0.25))


def test_glass_is_said_by_each_format(tmp_path: Path):
    """With its weights, beside a diffuse part; a reader of the neutral file is told by the version."""
    ball, shard, lamp = scene().objects
    clear = Material(gloss=1.0, roughness=1e-4, transparency=1.0)
    opaque = Material((0.5, 0.25, 0.75), 0.5, 0.25, ior=1.25, fresnel="dielectric")
    objects = [attrs.evolve(each, material=material) for each, material in ((ball, GLASS), (shard, clear))]
    other = attrs.evolve(shard, name="opaque", mesh=attrs.evolve(shard.mesh, vertices=shard.mesh.vertices + 9.0))
    given = attrs.evolve(scene(), objects=(*objects, attrs.evolve(other, material=opaque), lamp))
    described = neutral.describe(given)
    assert described["version"] == 3
    first, second, third, black = (each["material"] for each in described["objects"])
    assert first == {
        "color": [0.5, 0.25, 0.75], "gloss": 0.5, "roughness": 0.25, "f0": [0.04, 0.04, 0.04],
        "transparency": 0.75, "ior": 1.25, "tint": [1.0, 0.5, 0.25], "fresnel": "dielectric",
    }  # fmt: skip
    assert (third["ior"], third["fresnel"]) == (1.25, "dielectric")
    assert not {"transparency", "tint"} & {*third}
    assert not {"transparency", "tint", "ior", "fresnel"} & {*black}
    assert neutral.describe(neutral.diffuse(given))["version"] == 1

    gltf.write(given, tmp_path / "all.glb")
    found = chunks(tmp_path / "all.glb")
    used = [f"KHR_materials_{each}" for each in ("ior", "specular", "transmission", "volume")]
    assert {*used} <= {*found["extensionsUsed"]}
    assert found["materials"][0]["extensions"] == {
        "KHR_materials_ior": {"ior": 1.25}, "KHR_materials_specular": {"specularFactor": 0.5},
        "KHR_materials_transmission": {"transmissionFactor": 0.75}, "KHR_materials_volume": {"thicknessFactor": 1.0},
    }  # fmt: skip
    surface = found["materials"][0]["pbrMetallicRoughness"]
    assert surface == {"baseColorFactor": [1.0, 0.5, 0.25, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.5}

    parsed = written(given, tmp_path)
    smooth = {"float eta": [1.5], "float roughness": [1e-4], "bool remaproughness": [False]}
    assert ("Material", ["dielectric"], smooth) in parsed
    named = {arguments[0]: parameters for word, arguments, parameters in parsed if word == "MakeNamedMaterial"}
    assert named["ball 1: lobe"]["string type"] == ["dielectric"]
    assert named["opaque: lobe"]["string type"] == ["conductor"]
    said = [line for line in pbrt.write(given, tmp_path / "all.pbrt") if "gloss = 0.5, transparency = 0.75" in line]
    assert len(said) == 1

    thin = attrs.evolve(given, objects=(attrs.evolve(objects[0], material=attrs.evolve(GLASS, occludes=False)), lamp))
    (line,) = (line for line in neutral.describe(thin)["left_out"] if "occludes" in line)
    assert line == "objects: 'ball 1': occludes = False: light comes through refracted, and leaves a shadow"
    assert "occludes" not in neutral.describe(thin)["objects"][0]["material"]
    assert not neutral.diffuse(thin).unshadowing

    obj.write(given, tmp_path / "all.obj")
    lines = (tmp_path / "all.mtl").read_text("utf-8").splitlines()
    assert {"Tf 0.75 0.375 0.1875", "Ni 1.25", "illum 7"} <= {*lines}

    mitsuba.write(given, tmp_path / "all.xml")
    root = ElementTree.parse(tmp_path / "all.xml").getroot()
    blend, pane, painted, _ = (shape.find("bsdf") for shape in root.findall("shape"))
    assert blend is not None
    assert pane is not None
    assert painted is not None
    values = {value.attrib["name"]: value.attrib["value"] for value in blend.iter() if "value" in value.attrib}
    # (1 - g) (1 - t) = 1/8 is diffuse; the lobes are larger by what is left of a blend of it.
    assert blend.get("type") == "blendbsdf"
    assert float(values["weight"]) == 0.875
    assert [float(x) for x in values["specular_reflectance"].split(",")] == pytest.approx([0.5 / 0.875] * 3)
    assert [float(x) for x in values["specular_transmittance"].split(",")] == pytest.approx(
        np.array([0.75, 0.375, 0.1875]) / 0.875
    )
    assert (values["int_ior"], values["ext_ior"], values["alpha"]) == ("1.25", "1.0", "0.25")
    assert pane.get("type") == "dielectric"
    assert painted.get("type") == "twosided"


def test_diffuse_is_exact_in_all_formats():
    """Of what they can say of surfaces: nothing of a material is listed, but that pbrt makes spectra of colours."""
    described = neutral.describe(neutral.diffuse(scene()))
    for module in (gltf, mitsuba, obj, pbrt):
        said = [line for line in module.left_out(described) if "gloss" in line or "lobe" in line]
        assert said == []
