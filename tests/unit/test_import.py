"""Scenes of other renderers' files: what the model can say is read, all else is refused by name, or listed.

GLB and OBJ are written by `termwise export` and by hand; Mitsuba's XML is in tests/oracle/test_from_xml.py.
"""

import io
import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import attrs
import numpy as np
import PIL.Image
import pytest
import trimesh

from termwise.reports import cli
from termwise.reports.cli import judging, terminal
from termwise.reports.judging import engines
from termwise.reports.results.microscope import replay_command
from termwise.reports.rows.described import describe
from termwise.reports.study import subjects
from termwise.reports.study.study import load as load_study
from termwise.scenes.exchange import gltf, neutral, obj
from termwise.scenes.exchange.imported import coated
from termwise.scenes.load import load
from termwise.scenes.model import DirectionalLight, Material, PointLight, Scene, SpotLight, SunLight, largest
from termwise.scenes.save import save
from termwise.scenes.strict import FileError
from tests.scenes import small


def same_geometry(found: Scene, given: Scene) -> None:
    assert [thing.name for thing in found.objects] == [thing.name for thing in given.objects]
    for mine, theirs in zip(found.objects, given.objects, strict=True):
        corners = theirs.mesh.vertices[theirs.mesh.faces]
        np.testing.assert_array_equal(mine.mesh.vertices[mine.mesh.faces], corners)
        if theirs.mesh.normals is None or theirs.emits:
            assert mine.mesh.normals is None
        else:
            assert mine.mesh.normals is not None
            shading = theirs.mesh.normals[theirs.mesh.faces]
            np.testing.assert_allclose(mine.mesh.normals[mine.mesh.faces], shading, atol=1e-7)


def same_camera(found: Scene, given: Scene) -> None:
    film = np.random.default_rng(1).random((20, 2))
    np.testing.assert_allclose(
        found.camera.rays(film, aspect=found.aspect), given.camera.rays(film, aspect=given.aspect), atol=1e-12
    )
    np.testing.assert_allclose(found.camera.position, given.camera.position, atol=1e-12)


LIBRARY = ("cornell_box", "monkey", "smooth_monkey", "two_cubes")


@pytest.mark.parametrize("name", LIBRARY)
def test_glb_comes_back_as_it_went(name: str, tmp_path: Path):
    given = neutral.diffuse(small(name, 40, 30))
    gltf.write(given, tmp_path / "there.glb")
    found = load(tmp_path / "there.glb")
    same_geometry(found, given)
    same_camera(found, given)
    assert found.resolution == (40, 30)
    for mine, theirs in zip(found.objects, given.objects, strict=True):
        np.testing.assert_allclose(largest(mine.emission), largest(theirs.emission), rtol=1e-12)
        assert (mine.surface.color, mine.surface.gloss) == (theirs.surface.color, 0.0)
    assert len(found.lights) == len(given.lights)
    for mine, theirs in zip(found.lights, given.lights, strict=True):
        assert isinstance(mine, PointLight)
        assert isinstance(theirs, PointLight)
        np.testing.assert_allclose(mine.position, theirs.position)
        np.testing.assert_allclose(mine.intensity, theirs.intensity, rtol=1e-12)
    assert found.substitutions == ()
    assert found.draw_lights


def test_light_that_crosses_comes_back(tmp_path: Path):
    """Of another colour than the rest it has a stand-in."""
    given = small("monkey")
    given = attrs.evolve(
        given,
        objects=tuple(
            attrs.evolve(each, material=Material((0.8, 0.35, 0.1), translucency=0.25)) for each in given.objects
        ),
    )
    gltf.write(given, tmp_path / "there.glb")
    found = load(tmp_path / "there.glb")
    assert [each.material for each in found.objects] == [each.material for each in given.objects]
    data = (tmp_path / "there.glb").read_bytes()
    other = data.replace(b'"diffuseTransmissionColorFactor":[0.8,', b'"diffuseTransmissionColorFactor":[0.7,')
    assert other != data
    (tmp_path / "there.glb").write_bytes(other)
    with pytest.raises(FileError, match="diffuseTransmissionColorFactor"):
        load(tmp_path / "there.glb")


def test_glass_comes_back(tmp_path: Path):
    """All that GLB says of it, where GGX's lobe may be taken for Beckmann's; without a volume it is not refracted."""
    given = small("monkey")
    glass = Material((0.0, 0.0, 0.0), 0.5, 0.25, transparency=1.0, ior=1.25, tint=(1.0, 0.5, 0.25))
    given = attrs.evolve(given, objects=tuple(attrs.evolve(each, material=glass) for each in given.objects))
    gltf.write(given, tmp_path / "there.glb")
    with pytest.raises(FileError, match="GGX's lobe"):
        load(tmp_path / "there.glb")
    found = load(tmp_path / "there.glb", approximate=True)
    assert [each.material for each in found.objects] == [glass] * len(given.objects)
    data = (tmp_path / "there.glb").read_bytes()
    for old, new, other in (
        (b'"thicknessFactor":1.0', b'"thicknessFactor":0.0', attrs.evolve(glass, ior=1.0)),
        (b'"transmissionFactor":1.0', b'"transmissionFactor":0.7', attrs.evolve(glass, transparency=0.7)),
        (b'"roughnessFactor":0.5', b'"roughnessFactor":0.0', attrs.evolve(glass, roughness=1e-4)),
    ):
        (tmp_path / "there.glb").write_bytes(data.replace(old, new))
        assert load(tmp_path / "there.glb", approximate=True).objects[0].material == other
    for old, new in (
        (b'"transmissionFactor":1.0', b'"transmissionFactor":0.2'),
        (b'"metallicFactor":0.0', b'"metallicFactor":1.0'),  # a metal
    ):
        assert old in data
        (tmp_path / "there.glb").write_bytes(data.replace(old, new))
        assert load(tmp_path / "there.glb", approximate=True).objects[0].material.transparency == 0.0


@pytest.mark.parametrize("name", LIBRARY)
def test_obj_comes_back_as_it_went(name: str, tmp_path: Path):
    given = neutral.diffuse(small(name))
    obj.write(given, tmp_path / "there.obj")
    found = load(tmp_path / "there.obj")
    same_geometry(found, given)
    same_camera(found, given)
    assert found.resolution == given.resolution
    text = (tmp_path / "there.obj").read_text()
    assert "# camera: " in text
    (tmp_path / "there.obj").write_text(text.replace("# camera: ", "# "))  # as another program writes it
    found = load(tmp_path / "there.obj")
    closed = any("faces hide all lights" in line for line in found.substitutions)
    assert closed == (name == "cornell_box")
    for mine, theirs in zip(found.objects, given.objects, strict=True):
        assert (mine.surface.color, mine.surface.gloss) == (theirs.surface.color, 0.0)
        assert mine.emission == theirs.emission
    assert found.substitutions[0] == "assumed: a camera that sees all of it, z up, for the file has none"
    assert any("no light" in line for line in found.substitutions) == (name.endswith("monkey"))
    corners = np.concatenate([thing.mesh.vertices for thing in found.objects]) - found.camera.position
    right, up, forward = found.camera.frame()
    seen = np.stack([corners @ right, corners @ up], axis=1) / (corners @ forward)[:, None]
    assert np.abs(seen).max() < np.tan(np.radians(found.camera.fov / 2.0))


def test_gloss_comes_back_with_what_it_reflects_at_normal_incidence(tmp_path: Path):
    material = Material((0.8, 0.3, 0.1), 0.25, 0.3, (0.9, 0.5, 0.3))
    given = attrs.evolve(
        small("monkey"), objects=tuple(attrs.evolve(thing, material=material) for thing in small("monkey").objects)
    )
    expected = 0.75 * np.array(material.color) + 0.25 * np.array(material.f0)
    for module, digits in ((gltf, 1e-6), (obj, 1e-6)):
        module.write(given, tmp_path / f"there{module.SUFFIX}")
        with pytest.raises(FileError, match="--approximate takes Beckmann's"):
            load(tmp_path / f"there{module.SUFFIX}")
        found = load(tmp_path / f"there{module.SUFFIX}", approximate=True).objects[0].material
        reflected = (1.0 - largest(found.gloss)) * np.array(found.color) + largest(found.gloss) * np.array(found.f0)
        np.testing.assert_allclose(reflected, expected, rtol=digits)
        assert found.roughness == pytest.approx(0.3)


@pytest.mark.parametrize("metallic", [0.0, 0.3, 1.0])
def test_a_coat_reflects_its_parts(metallic: float):
    color = np.array([0.9, 0.4, 0.0])
    found = coated(color.tolist(), metallic=metallic, f0=0.04, roughness=0.2)
    lobe, base = largest(found.gloss) * np.array(found.f0), (1 - largest(found.gloss)) * np.array(found.color)
    np.testing.assert_allclose(lobe, (1 - metallic) * 0.04 + metallic * color, atol=1e-15)
    np.testing.assert_allclose(base, (1 - metallic) * 0.96 * color, atol=1e-15)


def test_a_plain_coat_s_lobe_reflects_all_whatever_its_index():
    """Shares of 1 that come out a rounding above it were refused: without a metal the gloss alone is F0."""
    for index in np.linspace(1.01, 4.0, 300):
        f0 = ((index - 1.0) / (index + 1.0)) ** 2
        found = coated((0.5, 0.5, 0.5), metallic=0.0, f0=f0, roughness=0.2)
        assert found.gloss == f0
        np.testing.assert_allclose(found.f0, 1.0, rtol=1e-15)


def test_lights_of_all_kinds_go_through_glb(tmp_path: Path):
    given = neutral.diffuse(small("lights"))
    missing = gltf.write(given, tmp_path / "there.glb")
    assert [line.partition(":")[0] for line in missing if line.startswith("lights")] == [
        "lights[1]",
        "lights[2]",
        "lights[4]",
    ]
    found = load(tmp_path / "there.glb", approximate=True)
    point, spot, directional, sun = found.lights
    assert point == given.lights[0]
    ball = found.objects[-1]
    assert ball.emission == given.lights[1].radiance  # type: ignore[union-attr]
    area = trimesh.Trimesh(ball.mesh.vertices, ball.mesh.faces).area
    assert area == pytest.approx(4 * np.pi * 0.22**2, rel=1e-5)
    assert isinstance(given.lights[2], SpotLight)
    assert isinstance(spot, SpotLight)
    np.testing.assert_allclose(spot.axis, given.lights[2].axis, atol=1e-12)
    np.testing.assert_allclose(spot.angles, np.radians([11.0, 16.0]))
    assert (spot.position, spot.intensity) == (given.lights[2].position, given.lights[2].intensity)
    for read, wrote in ((directional, given.lights[3]), (sun, given.lights[4])):
        assert isinstance(read, DirectionalLight)
        assert isinstance(wrote, DirectionalLight | SunLight)
        np.testing.assert_allclose(read.way, wrote.way, atol=1e-12)
        assert read.irradiance == wrote.irradiance


def test_nodes_of_glb_have_names_of_their_own(tmp_path: Path):
    given = neutral.diffuse(small("monkey"))
    named = [attrs.evolve(each, name=name) for each, name in zip(given.objects, ("camera", "monkey"), strict=True)]
    gltf.write(attrs.evolve(given, objects=tuple(named)), tmp_path / "there.glb")
    content = (tmp_path / "there.glb").read_bytes()
    names = [node["name"] for node in json.loads(content[20 : 20 + int.from_bytes(content[12:16], "little")])["nodes"]]
    assert len(names) == len({*names})
    assert {thing.name for thing in load(tmp_path / "there.glb").objects} == {"camera", "monkey"}


# GLB by hand


def changed(folder: Path, change: Callable[[dict[str, Any]], object], data: bytes = b"") -> Path:
    """The monkey without gloss, its description changed and something put behind its numbers."""
    gltf.write(neutral.diffuse(small("monkey")), folder / "plain.glb")
    content = (folder / "plain.glb").read_bytes()
    length = int.from_bytes(content[12:16], "little")
    described = json.loads(content[20 : 20 + length])
    binary = content[28 + length :] + data
    described["buffers"][0]["byteLength"] = len(binary)
    change(described)
    text = json.dumps(described).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    body = len(text).to_bytes(4, "little") + b"JSON" + text + len(binary).to_bytes(4, "little") + b"BIN\0" + binary
    head = b"glTF" + (2).to_bytes(4, "little") + (12 + len(body)).to_bytes(4, "little")
    (folder / "changed.glb").write_bytes(head + body)
    return folder / "changed.glb"


def monkey(described: dict[str, Any]) -> dict[str, Any]:
    return next(each for each in described["materials"] if each["name"] == "monkey")


def light(described: dict[str, Any]) -> dict[str, Any]:
    return described["extensions"]["KHR_lights_punctual"]["lights"][0]


# What is changed; the node and the feature that the message names; whether something may stand for it.
UNSAID: dict[str, tuple[Callable[[dict[str, Any]], object], str, str, bool]] = {
    "one side": (lambda d: monkey(d).update(doubleSided=False), "material 'monkey'", "one side", True),
    "metal": (lambda d: monkey(d)["pbrMetallicRoughness"].update(metallicFactor=0.5), "monkey", "metallic 0.5", True),
    "dielectric": (lambda d: monkey(d).update(extensions={}), "monkey", "F0 0.04", True),
    "clear coat": (
        lambda d: monkey(d)["extensions"].update(KHR_materials_clearcoat={}),
        "monkey",
        "KHR_materials_clearcoat",
        True,
    ),
    "unlit": (lambda d: monkey(d)["extensions"].update(KHR_materials_unlit={}), "monkey", "KHR_materials_unlit", False),
    "blended": (lambda d: monkey(d).update(alphaMode="BLEND"), "monkey", "alphaMode BLEND", True),
    "glass": (
        lambda d: monkey(d)["extensions"].update(KHR_materials_transmission={"transmissionFactor": 1.0}),
        "monkey",
        "glass without a volume",
        True,
    ),
    "glass of no index": (  # glTF's way to say that all is reflected
        lambda d: monkey(d)["extensions"].update(
            KHR_materials_transmission={"transmissionFactor": 1.0},
            KHR_materials_volume={"thicknessFactor": 1.0},
            KHR_materials_ior={"ior": 0.0},
        ),
        "monkey",
        "glass of ior 0",
        False,
    ),
    "a lamp of glass": (
        lambda d: monkey(d).update(
            emissiveFactor=[1, 0, 0],
            doubleSided=False,
            pbrMetallicRoughness={"baseColorFactor": [0, 0, 0, 1], "metallicFactor": 0},
            extensions={"KHR_materials_transmission": {"transmissionFactor": 1.0}},
        ),
        "monkey",
        "a lamp that reflects",
        True,
    ),
    "a lamp of two sides": (lambda d: monkey(d).update(emissiveFactor=[1, 0, 0]), "monkey", "two sides", True),
    "normal map": (lambda d: monkey(d).update(normalTexture={"index": 0}), "monkey", "normalTexture", True),
    "spot light": (lambda d: light(d).update(type="spot"), "light 0", "square of a cosine", True),
    "an unknown light": (lambda d: light(d).update(type="disc"), "light 0", "type disc", False),
    "a light that ends": (lambda d: light(d).update(range=3.0), "light 0", "range 3.0", True),
    "orthographic": (lambda d: d["cameras"][0].update(type="orthographic"), "camera", "type orthographic", False),
    "a plane that cuts": (lambda d: d["cameras"][0]["perspective"].update(zfar=1.0), "camera", "planes at", True),
    "animated": (lambda d: d.update(animations=[{}]), "animations", "1 of them", True),
    "instances": (
        lambda d: d["nodes"][1].update(extensions={"EXT_mesh_gpu_instancing": {}}),
        "ground",
        "EXT_mesh_gpu_instancing",
        False,
    ),
}


@pytest.mark.parametrize("case", UNSAID)
def test_what_the_model_cannot_say_is_refused_by_name_or_listed(case: str, tmp_path: Path):
    change, node, feature, allowed = UNSAID[case]
    path = changed(tmp_path, change)
    with pytest.raises(FileError) as refused:
        load(path)
    message = str(refused.value)
    assert message.startswith(f"{path}: ")
    assert node in message
    assert feature in message
    assert "\n" not in message
    assert ("--approximate" in message) == allowed
    if not allowed:
        with pytest.raises(FileError):
            load(path, approximate=True)
        return
    found = load(path, approximate=True)
    lines = [line for line in found.substitutions if feature in line]
    assert lines
    assert all(node in line for line in lines)
    assert load(path, approximate=True).digest() == attrs.evolve(found, substitutions=()).digest()


def extended(name: str, **values: object) -> Callable[[dict[str, Any]], object]:
    return lambda d: monkey(d)["extensions"].update({f"KHR_materials_{name}": values})


def surfaced(**values: object) -> Callable[[dict[str, Any]], object]:
    return lambda d: monkey(d)["pbrMetallicRoughness"].update(values)


# What is changed, and the node, field, value and what is allowed, as the message has them.
WRONG: tuple[tuple[Callable[[dict[str, Any]], object], str], ...] = (
    (extended("transmission", transmissionFactor=1.5), "KHR_materials_transmission.transmissionFactor = 1.5: allowed"),
    (extended("transmission", transmissionFactor=-0.1), "transmissionFactor = -0.1: allowed is a number in [0, 1]"),
    (extended("transmission", transmissionFactor="1"), "transmissionFactor = '1': allowed is a number in [0, 1]"),
    (extended("transmission", transmissionFactor=True), "transmissionFactor = True: allowed is a number in [0, 1]"),
    (extended("transmission", transmissionFactor=float("nan")), "transmissionFactor = nan: allowed is a number in"),
    (extended("volume", thicknessFactor=[1.0]), "thicknessFactor = [1.0]: allowed is a number in [0, inf)"),
    (extended("volume", attenuationDistance=0), "attenuationDistance = 0: allowed is a number in (0, inf)"),
    (extended("ior", ior=None), "extensions.KHR_materials_ior.ior = None: allowed is a number in [0, inf)"),
    (
        extended("specular", specularColorFactor=[1, 1]),
        "specularColorFactor = [1, 1]: allowed is 3 numbers in [0, inf)",
    ),
    (extended("emissive_strength", emissiveStrength="9"), "emissiveStrength = '9': allowed is a number in [0, inf)"),
    (extended("diffuse_transmission", diffuseTransmissionFactor=2), "diffuseTransmissionFactor = 2: allowed is a"),
    (lambda d: monkey(d)["extensions"].update(KHR_materials_ior=1.5), "KHR_materials_ior = 1.5: allowed is an object"),
    (surfaced(metallicFactor="x"), "pbrMetallicRoughness.metallicFactor = 'x': allowed is a number in [0, 1]"),
    (surfaced(roughnessFactor=1.01), "pbrMetallicRoughness.roughnessFactor = 1.01: allowed is a number in [0, 1]"),
    (surfaced(baseColorFactor=[1, 1, 1]), "baseColorFactor = [1, 1, 1]: allowed is 4 numbers in [0, 1]"),
    (surfaced(baseColorFactor=[1, 1, "1", 1]), "baseColorFactor = [1, 1, '1', 1]: allowed is 4 numbers in [0, 1]"),
    (surfaced(baseColorTexture={"index": 0.5}), "baseColorTexture.index = 0.5: allowed is an integer in [0, inf)"),
    (lambda d: monkey(d).update(emissiveFactor=3.0), "emissiveFactor = 3.0: allowed is 3 numbers in [0, inf)"),
    (lambda d: monkey(d).update(doubleSided=1), "doubleSided = 1: allowed is true or false"),
    (lambda d: monkey(d).update(alphaMode="CLEAR"), "alphaMode = 'CLEAR': allowed is OPAQUE, MASK, BLEND"),
)


@pytest.mark.parametrize(("change", "said"), WRONG)
def test_a_number_of_a_material_that_is_none_is_named(
    change: Callable[[dict[str, Any]], object], said: str, tmp_path: Path
):
    """With file, material, field and what is allowed, whether the feature itself is read or not."""
    path = changed(tmp_path, change)
    for approximate in (False, True):
        with pytest.raises(FileError) as refused:
            load(path, approximate=approximate)
        message = str(refused.value)
        assert message.startswith(f"{path}: material 'monkey': ")
        assert said in message
        assert "\n" not in message


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: light(d).update(intensity=[1]), "light 0: intensity = [1]: allowed is a number in [0, inf)"),
        (lambda d: light(d).update(color=[1, 1, -1]), "light 0: color = [1, 1, -1]: allowed is 3 numbers in"),
        (lambda d: d["cameras"][0]["perspective"].update(yfov=4), "camera: perspective.yfov = 4: allowed is a number"),
        (lambda d: surfaced(baseColorTexture={"index": 7})(d), "textures has no 7: allowed are none"),
    ],
)
def test_so_are_those_of_lights_and_cameras(change: Callable[[dict[str, Any]], object], said: str, tmp_path: Path):
    with pytest.raises(FileError) as refused:
        load(changed(tmp_path, change))
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_texture_is_its_mean_in_linear_light(tmp_path: Path):
    png = io.BytesIO()
    texels = np.zeros((2, 2, 3), np.uint8)
    texels[0] = [255, 188, 0]  # 188 is 0.503 in linear light
    PIL.Image.fromarray(texels).save(png, "png")

    def textured(described: dict[str, Any]) -> None:
        begin = described["buffers"][0]["byteLength"] - len(png.getvalue())
        described["bufferViews"].append({"buffer": 0, "byteOffset": begin, "byteLength": len(png.getvalue())})
        described["images"] = [{"bufferView": len(described["bufferViews"]) - 1, "mimeType": "image/png"}]
        described["textures"] = [{"source": 0}]
        monkey(described)["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}

    path = changed(tmp_path, textured, png.getvalue())
    with pytest.raises(FileError, match="material 'monkey': baseColorTexture without a TEXCOORD .* takes its mean"):
        load(path)
    found = load(path, approximate=True)
    np.testing.assert_allclose(largest(found.objects[1].material.color), [0.8 * 0.5, 0.35 * 0.5029 / 2, 0.0], atol=1e-4)


def test_a_coloured_reflection_of_glass_has_its_mean(tmp_path: Path):
    def glassy(described: dict[str, Any]) -> None:
        extensions = monkey(described)["extensions"]
        extensions["KHR_materials_transmission"] = {"transmissionFactor": 1.0}
        extensions["KHR_materials_specular"] = {"specularFactor": 0.5, "specularColorFactor": [1.0, 0.5, 0.0]}

    found = load(changed(tmp_path, glassy), approximate=True)
    assert "material 'monkey': specularColorFactor: taken is its mean" in found.substitutions
    assert found.objects[1].material.gloss == 0.25


def test_a_mirrored_node_keeps_its_outside(tmp_path: Path):
    def mirror(described: dict[str, Any]) -> None:
        described["nodes"][2]["scale"] = [-1.0, 1.0, 1.0]

    found, plain = load(changed(tmp_path, mirror)).objects[1].mesh, load(tmp_path / "plain.glb").objects[1].mesh
    volumes = [trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).volume for mesh in (found, plain)]
    assert volumes[0] == pytest.approx(volumes[1])
    np.testing.assert_allclose(found.vertices * [-1, 1, 1], plain.vertices)


def test_what_a_file_leaves_open_is_assumed_and_listed(tmp_path: Path):
    def bare(described: dict[str, Any]) -> None:
        for node in described["nodes"]:
            node.pop("camera", None)
            node.pop("extensions", None)

    path = changed(tmp_path, bare)
    dark, found = load(path), load(path, approximate=True)
    assert [line.partition(": ")[0] for line in dark.substitutions + found.substitutions] == ["assumed"] * 4
    assert dark.sky.is_black
    assert found.sky.color == found.ambient_light == (1.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ("given", "read"), [([64, 48], (64, 48)), ([64, 64], (128, 96)), ("large", (128, 96)), ([0, 3], (128, 96))]
)
def test_a_size_is_taken_where_it_has_the_cameras_shape(given: Any, read: tuple[int, int], tmp_path: Path):
    def sized(described: dict[str, Any]) -> None:
        described["cameras"][0]["perspective"]["aspectRatio"] = 4 / 3
        described["scenes"][0]["extras"] = {"resolution": given}

    assert load(changed(tmp_path, sized)).resolution == read


def test_normals_of_a_file_cannot_be_saved_and_nothing_is_written(tmp_path: Path):
    scene = small("smooth_monkey")
    mesh = scene.objects[1].mesh
    assert mesh.normals is not None
    tilted = np.array(mesh.normals) + [0.0, 0.0, 0.3]
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    own = attrs.evolve(scene.objects[1], mesh=attrs.evolve(mesh, normals=tilted.astype(np.float32).astype(float)))
    gltf.write(neutral.diffuse(attrs.evolve(scene, objects=(own,))), tmp_path / "tilted.glb")
    found = load(tmp_path / "tilted.glb")
    read = found.objects[0].mesh.normals
    assert read is not None
    np.testing.assert_allclose(read, tilted, atol=1e-7)
    with pytest.raises(ValueError, match="objects: 'monkey': normals are of another file"):
        save(found, tmp_path / "saved.toml")
    assert not list(tmp_path.glob("saved*"))


def test_a_saved_scene_keeps_its_substitutions(tmp_path: Path):
    found = load(changed(tmp_path, lambda d: light(d).update(range=3.0)), approximate=True)
    save(found, tmp_path / "saved.toml")
    assert load(tmp_path / "saved.toml").substitutions == found.substitutions != ()


# OBJ by hand

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
OBJ_UNSAID = {
    "glass": ("newmtl m\nKd 1 1 1\nillum 7\n", "illum 7"),
    "thin": ("newmtl m\nKd 1 1 1\nd 0.5\n", "an opacity of 0.5"),
    "thin by Tr": ("newmtl m\nKd 1 1 1\nTr 0.25\n", "an opacity of 0.75"),
    "bumps": ("newmtl m\nKd 1 1 1\nbump a.png\n", "bump"),
    "highlight": ("newmtl m\nKd 0.5 0.5 0.5\nKs 0.5 0.5 0.5\nNs 10\nillum 2\n", "Phong's lobe"),
    "a lamp that reflects": ("newmtl m\nKd 1 1 1\nKe 2 2 2\n", "a lamp that reflects"),
}


def triangle(folder: Path, library: str, text: str = "mtllib a.mtl\nusemtl m\nf 1 2 3\n") -> Path:
    (folder / "a.mtl").write_text(library)
    (folder / "a.obj").write_text(TRIANGLE + text)
    return folder / "a.obj"


@pytest.mark.parametrize("case", OBJ_UNSAID)
def test_what_mtl_says_beyond_the_model_is_refused_or_listed(case: str, tmp_path: Path):
    library, feature = OBJ_UNSAID[case]
    path = triangle(tmp_path, library)
    with pytest.raises(FileError, match=f"a.obj: .*{feature}.* --approximate"):
        load(path)
    assert any(feature in line for line in load(path, approximate=True).substitutions)


def test_a_material_without_a_colour_is_said_to_be_black(tmp_path: Path):
    found = load(triangle(tmp_path, "newmtl m\nNs 10\n"))
    assert found.objects[0].material.color == (0.0, 0.0, 0.0)
    assert "assumed: material 'm' is black, for it has no Kd" in found.substitutions


@pytest.mark.parametrize(
    ("library", "text", "named"),
    [
        ("newmtl other\n", "mtllib a.mtl\nusemtl m\nf 1 2 3\n", "usemtl m: no such material: allowed are other"),
        ("Kd 1 1 1\n", "mtllib a.mtl\nf 1 2 3\n", "line 1: 'Kd 1 1 1': stands before"),
        ("newmtl m\nKd 1 1\n", "mtllib a.mtl\nusemtl m\nf 1 2 3\n", "line 2: 'Kd 1 1': allowed are numbers"),
        ("newmtl m\nKd 2 2 2\n", "mtllib a.mtl\nusemtl m\nf 1 2 3\n", r"color = \(2.0, 2.0, 2.0\)"),
        ("", "mtllib b.mtl\nf 1 2 3\n", "b.mtl: cannot be read"),
        ("", "v 1 1 1\n", "holds no surface"),
    ],
)
def test_a_wrong_obj_is_one_line(library: str, text: str, named: str, tmp_path: Path):
    with pytest.raises(FileError, match=named) as refused:
        load(triangle(tmp_path, library, text))
    assert "\n" not in str(refused.value)
    assert str(tmp_path) in str(refused.value)


def test_objects_and_materials_of_obj_are_told_apart(tmp_path: Path):
    text = "mtllib a.mtl\no one\nusemtl m\nf 1 2 3\nusemtl n\nv 0 0 1\nf 1 2 4\no two\nusemtl m\nf 1 2 3\n"
    path = triangle(tmp_path, "newmtl m\nKd 0.1 0.2 0.3\nnewmtl n\nKd 0.3 0.3 0.3\n", text)
    found = load(path)
    assert [thing.name for thing in found.objects] == ["one: m", "one: n"]  # `two` is `one: m` again
    assert [largest(thing.material.color)[0] for thing in found.objects] == [0.1, 0.3]


# Wherever a scene is taken


def test_a_study_takes_files_of_others(tmp_path: Path):
    path = changed(tmp_path, lambda d: light(d).update(range=3.0))
    study = load_study("quick")
    with pytest.raises(FileError, match="range 3.0"):
        subjects.scenes_of(study, (str(path),))
    (scene,) = subjects.scenes_of(study, (str(path),), approximate=True)
    assert (scene.name, scene.resolution) == ("changed", study.resolution)
    assert len(scene.substitutions) == 1
    described = describe(study, next(subjects.subjects(study, (scene,))), [])
    assert described["substitutions"] == [*scene.substitutions]


def test_engines_are_compared_on_files_of_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    path = changed(tmp_path, lambda d: light(d).update(range=3.0))
    seen: list[Scene] = []
    monkeypatch.setattr(terminal, "choose_backend", lambda _: "any")
    monkeypatch.setattr(
        engines, "compare", lambda found, scenes, *_, **__: seen.extend(scenes) or engines.Judged([], [], [])
    )
    words = ["compare", str(path), "--study", "quick", "--engine", "ours", "--out", str(tmp_path)]
    with pytest.raises(FileError, match="range 3.0"):
        cli.app(words, exit_on_error=False, result_action="return_value")
    cli.app([*words, "--approximate"], exit_on_error=False, result_action="return_value")
    assert "range 3.0" in seen[0].substitutions[0]
    assert "range 3.0" in capsys.readouterr().err


def test_a_scene_to_judge_against_may_be_a_file_of_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = changed(tmp_path, lambda d: light(d).update(range=3.0))
    np.save(tmp_path / "mine.npy", np.ones((4, 6, 8, 3), np.float32))
    seen = []
    monkeypatch.setattr(terminal, "choose_backend", lambda _: "any")
    monkeypatch.setattr(engines, "against", lambda scene, **_: seen.append(scene) or ([], {}))

    def case(approximate: bool) -> Any:
        options: dict[str, Any] = {"diffuse": False, "resolution": None, "replicates": 4, "seed": 1, "spp": None}
        options |= {"reference_spp": 1, "probe": False, "places": {}, "approximate": approximate}
        return judging._of_scene(str(path), (tmp_path / "mine.npy",), None, **options)

    with pytest.raises(FileError, match="range 3.0"):
        case(approximate=False)
    assert "range 3.0" in case(approximate=True).settings["substitutions"]
    assert seen[0].resolution == (8, 6)


def test_a_replay_is_told_to_approximate():
    row = {"scene": "changed", "term": "direct", "variant": "path"}
    found: Any = SimpleNamespace(pixel=(1, 2), replicate=3)
    arguments = {"study": "quick", "scenes": {"changed": "changed.glb"}, "approximate": True}
    command = replay_command({"settings": {"arguments": arguments, "study": "quick"}}, row, found)
    assert command.endswith("--approximate")
    assert "--scene changed.glb" in command


def test_a_name_that_no_reader_knows_is_answered_with_those_that_are_known(tmp_path: Path):
    with pytest.raises(FileError, match=r"\.toml, \.glb, \.obj or \.xml"):
        load(tmp_path / "scene.usd")
    with pytest.raises(FileError, match="no such file"):
        load(tmp_path / "scene.glb")
