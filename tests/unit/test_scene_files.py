"""Scene files and the model: every bad input is one line that names the file, the field, the value, what is allowed.

Rationale: TOML itself has nan and inf, cattrs takes "0.5" for a number, and a mesh file may hold anything.
"""

import math
import re
from pathlib import Path

import attrs
import numpy as np
import OpenEXR
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from termwise.scenes.load import library, load
from termwise.scenes.model import (
    Ambient,
    Camera,
    Material,
    Mesh,
    Object,
    Photons,
    PointLight,
    Scene,
    Sky,
    largest,
    least,
)
from termwise.scenes.strict import FileError

CAMERA = "[camera]\nposition = [0.0, -3.0, 1.0]\ntarget = [0.0, 0.0, 0.0]\n"
OBJECT = '[[objects]]\nname = "a"\nshape = "box"\nsize = [1.0, 1.0, 1.0]\n'
GOOD = CAMERA + OBJECT
SPOT = '[[lights]]\nkind = "spot"\nposition = [0, 0, 1]\nintensity = [1, 1, 1]\ntarget = {}\n{}\n'


def write(folder: Path, text: str) -> Path:
    path = folder / "scene.toml"
    path.write_text(text, "utf-8")
    return path


def mesh_object(file: str) -> str:
    return CAMERA + f'[[objects]]\nname = "m"\nshape = "mesh"\nfile = "{file}"\n'


# Text of the file, and what the message must name: the field, its value, what is allowed.
BAD = {
    "not toml": ("camera = [", ["is not TOML"]),
    "no camera": (OBJECT, ["camera", "missing"]),
    "no position": ("[camera]\ntarget = [0.0, 0.0, 0.0]\n", ["camera.position", "missing"]),
    "unknown key": ("colour = 3\n" + GOOD, ["colour = 3", "unknown key", "allowed are", "camera"]),
    "unknown key in a table": (
        GOOD.replace("[camera]", "[camera]\nfow = 40.0"),
        ["camera.fow = 40.0", "unknown key", "fov"],
    ),
    "unknown key of an object": (GOOD + "glos = 0.5\n", ["objects", "glos = 0.5", "unknown key", "gloss"]),
    "gloss above 1": (GOOD + "gloss = 1.2\n", ["objects", "gloss = 1.2", "[0, 1]"]),
    "negative roughness": (GOOD + "roughness = -0.1\n", ["objects", "roughness = -0.1", "[0.0001, 1.5]"]),
    "roughness too large": (GOOD + "roughness = 2.0\n", ["roughness = 2.0", "[0.0001, 1.5]"]),
    "nan color": (GOOD + "color = [nan, 0.5, 0.5]\n", ["color = (nan, 0.5, 0.5)", "[0, 1]"]),
    "color above 1": (GOOD + "color = [0.5, 1.5, 0.5]\n", ["color = (0.5, 1.5, 0.5)", "[0, 1]"]),
    "inf emission": (GOOD + "emission = [inf, 1.0, 1.0]\n", ["emission = (inf, 1.0, 1.0)", "[0, inf)"]),
    "translucency above 1": (GOOD + "translucency = 1.5\n", ["objects", "translucency = 1.5", "[0, 1]"]),
    "transparency above 1": (GOOD + "transparency = 1.5\n", ["objects", "transparency = 1.5", "[0, 1]"]),
    "index of refraction of nothing": (GOOD + "ior = 0\n", ["objects", "ior = 0", "[0.1, 10]"]),
    "tint above 1": (GOOD + "tint = [1, 2, 1]\n", ["objects", "tint = ", "[0, 1]"]),
    "unknown fresnel": (GOOD + 'fresnel = "metal"\n', ["objects", "fresnel = 'metal'", "'dielectric'"]),
    "Schlick's glass": (
        GOOD + 'transparency = 0.5\nfresnel = "schlick"\n',
        ["objects", "fresnel = 'schlick'", "'dielectric'", "transparency = 0.5"],
    ),
    "a lamp of glass": (
        GOOD + "transparency = 0.5\nemission = [1, 1, 1]\n",
        ["objects", "'a'", "transparency = 0.5", "allowed is 0", "emission"],
    ),
    "transparency with normals of the face": (
        'normals = "face"\n' + GOOD + "transparency = 0.5\n",
        ["objects", "'a'", "transparency = 0.5", "allowed is 0", "normals = 'face'"],
    ),
    "transparency with rays that ignore an object": (
        'ignore = "object"\n' + GOOD + "transparency = 0.5\n",
        ["objects", "'a'", "transparency = 0.5", "allowed is 0", "ignore = 'object'"],
    ),
    "transparency with the paper's shadow": (
        'shadows = "paper"\n' + GOOD + "transparency = 0.5\n",
        ["objects", "'a'", "transparency = 0.5", "allowed is 0", "shadows = 'paper'"],
    ),
    "what is opaque casts a shadow": (
        GOOD + "occludes = false\n",
        ["objects", "occludes = False", "allowed is True", "transparency = 0.0"],
    ),
    "a number for whether it occludes": (
        GOOD + "transparency = 1\noccludes = 0\n",
        ["objects", "occludes = 0", "true or false"],
    ),
    "light that goes through straight and refracted": (
        GOOD + 'transparency = 1\noccludes = false\n[photons]\nscattering = "full"\n',
        ["objects", "'a'", "occludes = False", "allowed is True", "photons.scattering = 'full'"],
    ),
    "translucency with normals of the face": (
        'normals = "face"\n' + GOOD + "translucency = 0.5\n",
        ["objects", "'a'", "translucency = 0.5", "allowed is 0", "normals = 'face'"],
    ),
    "negative f0": (GOOD + "f0 = [-0.1, 0.0, 0.0]\n", ["f0 = (-0.1, 0.0, 0.0)", "[0, 1]"]),
    "color of two": (GOOD + "color = [0.5, 0.5]\n", ["color = [0.5, 0.5]", "a list of 3"]),
    "text for a number": (GOOD + 'gloss = "0.5"\n', ["gloss = '0.5'", "a number"]),
    "true for a number": (GOOD + "gloss = true\n", ["gloss = True", "a number"]),
    "number for a switch": (GOOD + "[toggles]\nlighting = 1\n", ["toggles.lighting = 1", "true or false"]),
    "no survival": (GOOD + "[photons]\nsurvival = 0.0\n", ["photons", "survival = 0.0", "a number in (0, 1]"]),
    "survival beyond 1": (GOOD + "[photons]\nsurvival = 1.5\n", ["survival = 1.5", "a number in (0, 1]"]),
    "unknown kernel": (
        GOOD + '[photons]\nkernel = "cone"\n',
        ["photons.kernel = 'cone'", "'simpson' or 'epanechnikov' or 'uniform'"],
    ),
    "unknown scattering": (
        GOOD + '[photons]\nscattering = "all"\n',
        ["photons.scattering = 'all'", "'diffuse' or 'full'"],
    ),
    "survival as a word": (GOOD + '[photons]\nsurvival = "0.5"\n', ["photons.survival = '0.5'", "a number"]),
    "float for a count": (GOOD + "[photons]\ncount = 2.5\n", ["photons.count = 2.5", "an integer"]),
    "no photons": (GOOD + "[photons]\ncount = 0\n", ["photons", "count = 0", "[1, "]),
    "radius 0": (GOOD + "[photons]\nradius = 0.0\n", ["photons", "radius = 0.0", "(0, inf)"]),
    "one nearest photon": (GOOD + "[photons]\nnearest = 1\n", ["nearest = 1", "[2, "]),
    "scope": ('scope = "some"\n' + GOOD, ["scope = 'some'", "'first-hit' or 'all'"]),
    "pixel rule": (
        GOOD.replace("[camera]", '[camera]\npixel = "middle"'),
        ["camera.pixel = 'middle'", "'corner'", "'jitter'"],
    ),
    "fov 180": (GOOD.replace("[camera]", "[camera]\nfov = 180.0"), ["fov = 180.0", "(0, 180)"]),
    "near 0": (GOOD.replace("[camera]", "[camera]\nnear = 0.0"), ["near = 0.0", "(0, inf)"]),
    "nan position": (GOOD.replace("[0.0, -3.0, 1.0]", "[nan, -3.0, 1.0]"), ["position = (nan, -3.0, 1.0)"]),
    "target beyond squares": (
        GOOD.replace("target = [0.0,", "target = [1e300,"),
        ["target = (1e+300, 0.0, 0.0)", "allowed are points"],
    ),
    "view along up": (GOOD.replace("[0.0, -3.0, 1.0]", "[0.0, 0.0, 1.0]"), ["up = (0.0, 0.0, 1.0)", "not parallel"]),
    "resolution 0": ("resolution = [0, 4]\n" + GOOD, ["resolution = (0, 4)", "[1, 65536]"]),
    "negative bounces": ("max_bounces = -1\n" + GOOD, ["max_bounces = -1", "[0, 64]"]),
    "exposure inf": ("exposure = inf\n" + GOOD, ["exposure = inf", "(0, inf)"]),
    "range 0": (GOOD + "[ambient]\nrange = 0.0\n", ["range = 0.0", "(0, inf]"]),
    "negative ambient": (GOOD + "[ambient]\ncolor = [-1.0, 0.0, 0.0]\n", ["color = (-1.0, 0.0, 0.0)", "[0, inf)"]),
    "unknown shape": (GOOD.replace('"box"', '"cone"'), ["shape = 'cone'", "rectangle, box, sphere, mesh"]),
    "no shape": (GOOD.replace('shape = "box"\n', ""), ["shape: is missing", "rectangle, box, sphere, mesh"]),
    "size 0": (GOOD.replace("[1.0, 1.0, 1.0]", "[1.0, 0.0, 1.0]"), ["size = (1.0, 0.0, 1.0)", "(0, inf)"]),
    "negative scale": (GOOD + "scale = -1.0\n", ["scale = -1.0", "(0, inf)"]),
    "object is a number": ("objects = [3]\n" + CAMERA, ["objects", "3", "a table"]),
    "name used twice": (GOOD + OBJECT, ["'a' is used twice", "distinct names"]),
    "edges in line": (
        CAMERA + '[[objects]]\nname = "r"\nshape = "rectangle"\nedges = [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]\n',
        ["'r'", "edges = ((1.0, 0.0, 0.0), (2.0, 0.0, 0.0))", "span an area"],
    ),
    "subdivisions": (
        CAMERA + '[[objects]]\nname = "s"\nshape = "sphere"\nsubdivisions = 9\n',
        ["subdivisions = 9", "[0, 8]"],
    ),
    "light of negative intensity": (
        GOOD + "[[lights]]\nposition = [0.0, 0.0, 1.0]\nintensity = [-1.0, 0.0, 0.0]\n",
        ["lights", "intensity = (-1.0, 0.0, 0.0)", "[0, inf)"],
    ),
    "kind of light": (
        GOOD + '[[lights]]\nkind = "laser"\nposition = [0.0, 0.0, 1.0]\n',
        ["lights[0]", "kind = 'laser'", "point, spot, directional, sun, sphere"],
    ),
    "light of a type": (
        GOOD + "[[lights]]\ntype = 'point'\nposition = [0.0, 0.0, 2.0]\nintensity = [1.0, 1.0, 1.0]\n",
        ["lights[0]", "type = 'point'", "allowed is kind, one of point, spot"],
    ),
    "light that is a number": (GOOD + "[[lights]]\nkind = 1\n", ["lights[0]", "kind = 1", "point, spot"]),
    "spot without a direction": (
        GOOD + SPOT.format("[0, 0, 1]", "cutoff = 20"),
        ["lights[0]", "target = (0.0, 0.0, 1.0)", "other than position"],
    ),
    "beam beyond the cutoff": (
        GOOD + SPOT.format("[0, 0, 0]", "cutoff = 20\nbeam = 21"),
        ["lights[0]", "beam = 21.0", "[0, cutoff]", "cutoff = 20.0"],
    ),
    "cutoff of more than a half space": (
        GOOD + SPOT.format("[0, 0, 0]", "cutoff = 91"),
        ["lights[0]", "cutoff = 91.0", "[0.01, 90]"],
    ),
    "spot with a direction": (
        GOOD + SPOT.format("[0, 0, 0]", "direction = [0, 0, 1]"),
        ["lights[0].direction", "unknown key", "cutoff"],
    ),
    "light along nothing": (
        GOOD + '[[lights]]\nkind = "directional"\ndirection = [0, 0, 0]\nirradiance = [1, 1, 1]\n',
        ["lights[0]", "direction = (0.0, 0.0, 0.0)", "a vector other than 0"],
    ),
    "sun wider than the sky": (
        GOOD + '[[lights]]\nkind = "sun"\ndirection = [0, 0, -1]\nirradiance = [1, 1, 1]\nangle = 181\n',
        ["lights[0]", "angle = 181.0", "[0.001, 180]"],
    ),
    "color of a sky's ambient light": (
        GOOD + '[ambient]\nsource = "sky"\ncolor = [0.1, 0.1, 0.1]\n',
        ["ambient", "color = (0.1, 0.1, 0.1)", "none with source = 'sky'"],
    ),
    "source of ambient light": (
        GOOD + '[ambient]\nsource = "sun"\n',
        ["ambient.source = 'sun'", "'constant' or 'sky'"],
    ),
    "camera in a light": (
        GOOD + '[[lights]]\nkind = "sphere"\ncenter = [0, -3, 0]\nradius = 1.5\nradiance = [1, 1, 1]\n',
        ["lights[0]", "radius = 1.5", "the camera at (0.0, -3.0, 1.0) is outside of"],
    ),
    "sphere of no size": (
        GOOD + '[[lights]]\nkind = "sphere"\ncenter = [0, 0, 3]\nradius = 0\nradiance = [1, 1, 1]\n',
        ["lights[0]", "radius = 0.0", "(0, inf)"],
    ),
    "the paper's shadow of a light that is nowhere": (
        'shadows = "paper"\n' + GOOD + '[[lights]]\nkind = "sun"\ndirection = [0, 0, -1]\nirradiance = [1, 1, 1]\n',
        ["lights[0]", "kind = 'sun'", "shadows = 'paper'", "point, spot, sphere"],
    ),
    "light without intensity": (GOOD + "[[lights]]\nposition = [0.0, 0.0, 1.0]\n", ["lights", "intensity", "missing"]),
    "mesh that is missing": (mesh_object("none.ply"), ["file = 'none.ply'", "no such file"]),
    "mesh of another kind": (mesh_object("mesh.fbx"), ["file = 'mesh.fbx'", ".ply, .obj, .stl or .glb"]),
    "mesh that is none": (mesh_object("text.ply"), ["file = 'text.ply'", "is not PLY"]),
    "mesh cut short": (mesh_object("short.ply"), ["file = 'short.ply'"]),
    "mesh that promises more": (
        mesh_object("promise.ply"),
        ["file = 'promise.ply'", "1 of 3 rows of element face", "cut short"],
    ),
    "mesh without area": (mesh_object("line.ply"), ["'m'", "file = 'line.ply'", "no area"]),
    "name of the whole picture": (GOOD.replace('"a"', '"image"'), ["objects", "name = 'image'"]),
    "view of nothing": (GOOD.replace("[0.0, -3.0, 1.0]", "[0.0, 0.0, 0.0]"), ["target = (0.0, 0.0, 0.0)", "position"]),
    "objects in a string": ('objects = "box"\n' + CAMERA, ["objects = 'box'", "a list"]),
    "mesh without faces": (mesh_object("empty.ply"), ["file = 'empty.ply'"]),
    "mesh with a nan": (mesh_object("nan.ply"), ["'m'", "vertices[1]", "finite"]),
    "mesh with a wild index": (mesh_object("index.ply"), ["'m'", "file = 'index.ply'"]),
    "texture that is missing": (GOOD + '[sky]\ntexture = "no.exr"\n', ["sky", "texture = 'no.exr'", "no such file"]),
    "texture that is none": (
        GOOD + '[sky]\ntexture = "text.ply"\n',
        ["sky", "texture = 'text.ply'", "no image of a kind", "OpenEXR"],
    ),
    "sky of both kinds": (GOOD + '[sky]\ntexture = "a.exr"\ncolor = [0.0, 0.0, 0.0]\n', ["sky", "one of the two"]),
}

PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face {faces}
property list uchar int vertex_indices
end_header
0 0 0
{second} 0 0
0 1 0
"""


@pytest.fixture
def folder(tmp_path) -> Path:
    """A folder with meshes that are broken in one way each."""
    (tmp_path / "mesh.fbx").write_text("x")
    (tmp_path / "text.ply").write_text("this is not a mesh\n" * 20)
    (tmp_path / "short.ply").write_text(PLY.format(faces=5, second="1")[:-9])
    (tmp_path / "promise.ply").write_text(PLY.format(faces=3, second="1") + "3 0 1 2\n")
    (tmp_path / "line.ply").write_text(PLY.format(faces=1, second="1") + "3 0 1 1\n")
    (tmp_path / "empty.ply").write_text(PLY.format(faces=0, second="1"))
    (tmp_path / "nan.ply").write_text(PLY.format(faces=1, second="nan") + "3 0 1 2\n")
    (tmp_path / "index.ply").write_text(PLY.format(faces=1, second="1") + "3 0 1 7\n")
    return tmp_path


@pytest.mark.parametrize("case", BAD)
def test_bad_scene_file(case, folder):
    """A FileError of one line: the file's path, then the field, the value, and what is allowed."""
    text, parts = BAD[case]
    path = write(folder, text)
    with pytest.raises(FileError) as caught:
        load(path)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(path))
    for part in parts:
        assert part in message, message


@pytest.mark.parametrize("name", ["no_such_scene", "scene.json", ""])
def test_unknown_name(name):
    """Neither a library scene nor a path to a TOML file: the library is listed."""
    with pytest.raises(FileError, match="no such scene: allowed are cornell_box") as caught:
        load(name)
    assert "\n" not in str(caught.value)


def test_missing_and_unreadable_files(tmp_path):
    """A missing file, a folder, and bytes that are no text: one line that names the path."""
    (tmp_path / "folder.toml").mkdir()
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe\x00")
    for name, reason in (
        ("none.toml", "cannot be read"),
        ("folder.toml", "cannot be read"),
        ("bytes.toml", "is not TOML"),
    ):
        with pytest.raises(FileError, match=reason) as caught:
            load(tmp_path / name)
        assert str(tmp_path / name) in str(caught.value)


def test_the_texture_of_a_sky_is_one_whole_image(tmp_path):
    """RGBA and any other format that holds the same; not the first of two parts, nor what is left of a file."""
    rgb = np.random.default_rng(1).random((16, 16, 3)).astype(np.float32)
    lines = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    OpenEXR.File(lines, {"RGBA": np.dstack([rgb, rgb[..., :1]])}).write(str(tmp_path / "a.EXR"))
    np.save(tmp_path / "a.npy", rgb)
    for name in ("a.EXR", "a.npy"):
        texture = load(write(tmp_path, GOOD + f'[sky]\ntexture = "{name}"\n')).sky.texture
        assert texture is not None
        assert np.array_equal(texture, rgb)
    OpenEXR.File([OpenEXR.Part(dict(lines), {"RGB": rgb}, name) for name in "ab"]).write(str(tmp_path / "two.exr"))
    (tmp_path / "cut.exr").write_bytes((tmp_path / "two.exr").read_bytes()[:-500])
    for name, words in (("two.exr", "'a', 'b'"), ("cut.exr", "is cut short")):
        with pytest.raises(FileError, match=f"sky: texture = '{name}': .*{words}"):
            load(write(tmp_path, GOOD + f'[sky]\ntexture = "{name}"\n'))


def test_good_file(tmp_path):
    """The file that the bad ones are made from loads, with the model's defaults."""
    scene = load(write(tmp_path, GOOD))
    assert scene.name == "scene"
    assert scene.camera.position == (0.0, -3.0, 1.0)
    assert scene.objects[0].material == Material()
    assert len(scene.objects[0].mesh.faces) == 12


@pytest.mark.parametrize("name", library())
def test_library_loads(name):
    """Each scene has objects, a light, glossy objects of alpha >= 0.2, and vertices that float32 holds."""
    scene = load(name)
    assert scene.name == name
    assert scene.has_lights
    glossy = [o.material for o in scene.objects if largest(o.material.gloss) > 0]
    assert all(least(material.roughness) >= 0.2 for material in glossy if material.transparency == 0)
    assert any(largest(o.material.gloss) > 0 for o in scene.objects)
    for thing in scene.objects:
        np.testing.assert_array_equal(thing.mesh.vertices, thing.mesh.vertices.astype(np.float32))


def test_the_names_of_the_library():
    """Their names are the product's vocabulary."""
    assert library() == (
        "cornell_box",
        "cornell_box_unshadowed",
        "glass",
        "leaf",
        "lights",
        "monkey",
        "smooth_monkey",
        "two_cubes",
        "wild",
    )


def test_the_two_boxes_differ_in_scope_alone():
    """They share geometry, and hence references."""
    box, unshadowed = load("cornell_box"), load("cornell_box_unshadowed")
    assert (box.scope, unshadowed.scope) == ("first-hit", "all")
    assert attrs.evolve(box, scope="all").digest() == unshadowed.digest()


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl", ".glb"])
def test_mesh_formats(suffix, tmp_path):
    """One icosahedron through four formats: the same set of triangles, normals outwards."""
    icosahedron = trimesh.creation.icosphere(subdivisions=0)
    icosahedron.export(tmp_path / f"ball{suffix}")
    mesh = load(write(tmp_path, mesh_object(f"ball{suffix}"))).objects[0].mesh
    corners = mesh.vertices[mesh.faces]
    assert len(corners) == len(icosahedron.faces)
    expected = np.sort(icosahedron.triangles_center.round(5), axis=0)
    np.testing.assert_allclose(np.sort(corners.mean(axis=1).round(5), axis=0), expected, atol=2e-5)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((normal * corners.mean(axis=1)).sum(axis=1) > 0).all()


def test_placement_scales_then_rotates_then_moves(tmp_path):
    """A vertex (1, 0, 0): scale 2, 90 degrees about z, then the translation: (0, 2, 0) + (5, 6, 7)."""
    text = CAMERA + (
        '[[objects]]\nname = "r"\nshape = "rectangle"\nedges = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]\n'
        "scale = 2.0\nrotation = [0.0, 0.0, 90.0]\ntranslation = [5.0, 6.0, 7.0]\n"
    )
    vertices = load(write(tmp_path, text)).objects[0].mesh.vertices
    np.testing.assert_allclose(vertices, [[5, 6, 7], [5, 8, 7], [3, 8, 7], [3, 6, 7]], atol=1e-6)


def test_rotation_is_about_x_then_y_then_z(tmp_path):
    """Vertex (0, 1, 0): 90 degrees about x gives (0, 0, 1), about y (1, 0, 0), about z (0, 1, 0)."""
    text = CAMERA + (
        '[[objects]]\nname = "r"\nshape = "rectangle"\nedges = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]\n'
        "rotation = [90.0, 90.0, 90.0]\n"
    )
    vertices = load(write(tmp_path, text)).objects[0].mesh.vertices
    np.testing.assert_allclose(vertices[3], [0, 1, 0], atol=1e-6)


def test_smooth_normals_of_a_sphere(tmp_path):
    """Area-weighted vertex normals of an icosphere point along the radius within 1 degree; flat ones are absent."""
    text = CAMERA + '[[objects]]\nname = "s"\nshape = "sphere"\n'
    flat = load(write(tmp_path, text)).objects[0].mesh
    assert flat.normals is None
    smooth = load(write(tmp_path, text + 'normals = "smooth"\n')).objects[0].mesh
    assert smooth.normals is not None
    assert ((smooth.normals * smooth.vertices).sum(axis=1) > math.cos(math.radians(1))).all()


# The model itself.


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (np.zeros((3, 2)), [[0, 1, 2]], "allowed is (V, 3) and (F, 3)"),
        (np.zeros((3, 3)), [[0, 1]], "allowed is (V, 3) and (F, 3)"),
        (np.zeros((3, 3)), np.zeros((0, 3)), "at least one triangle"),
        (np.full((3, 3), np.inf), [[0, 1, 2]], "vertices[0] = (inf, inf, inf)"),
        (np.full((3, 3), 1e39), [[0, 1, 2]], "vertices[0] = (inf, inf, inf)"),
        (np.zeros((3, 3)), [[0, 1, 2], [0, 1, 3]], "faces[1] = (0, 1, 3): allowed are indices in [0, 2]"),
        (np.zeros((3, 3)), [[0, -1, 2]], "faces[0] = (0, -1, 2)"),
    ],
)
def test_bad_mesh(vertices, faces, message):
    """Shape, emptiness, finiteness (after rounding to float32) and indices."""
    with np.errstate(over="ignore"), pytest.raises(ValueError, match="allowed") as caught:
        Mesh.from_arrays(vertices, faces)
    assert message in str(caught.value)


TRIANGLE = Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
SCENE = Scene(
    "a",
    Camera((0.0, -3.0, 0.0), (0.0, 0.0, 0.0)),
    (Object("t", TRIANGLE),),
    lights=(PointLight((0.0, 0.0, 1.0), (1.0, 1.0, 1.0)),),
)


def test_equal_scenes_have_one_digest():
    """Content counts: arrays by value, not by identity; name and exposure do not count."""
    again = Mesh.from_arrays(TRIANGLE.vertices.copy(), TRIANGLE.faces.copy())
    same = attrs.evolve(SCENE, name="b", exposure=2.0, objects=(Object("t", again),))
    assert same.digest() == SCENE.digest()
    assert attrs.evolve(SCENE, exposure=2.0).digest(without=()) != SCENE.digest(without=())


def changed_scenes() -> list[Scene]:
    thing = SCENE.objects[0]
    moved = Mesh.from_arrays(TRIANGLE.vertices + [0, 0, 1e-6], TRIANGLE.faces)
    turned = Mesh.from_arrays(TRIANGLE.vertices, [[0, 2, 1]])
    return [
        SCENE,
        attrs.evolve(SCENE, camera=attrs.evolve(SCENE.camera, fov=45.0000001)),
        attrs.evolve(SCENE, camera=attrs.evolve(SCENE.camera, pixel="corner")),
        attrs.evolve(SCENE, objects=(attrs.evolve(thing, mesh=moved),)),
        attrs.evolve(SCENE, objects=(attrs.evolve(thing, mesh=turned),)),
        attrs.evolve(SCENE, objects=(attrs.evolve(thing, name="u"),)),
        attrs.evolve(SCENE, objects=(attrs.evolve(thing, material=Material(gloss=0.1)),)),
        attrs.evolve(SCENE, objects=(attrs.evolve(thing, emission=(0.0, 0.0, 1.0)),)),
        attrs.evolve(SCENE, objects=(thing, attrs.evolve(thing, name="v"))),
        attrs.evolve(SCENE, objects=()),
        attrs.evolve(SCENE, lights=()),
        attrs.evolve(SCENE, lights=(PointLight((0.0, 0.0, 1.0), (1.0, 1.0, 2.0)),)),
        attrs.evolve(SCENE, lights=(PointLight((0.0, 0.0, 1.5), (1.0, 1.0, 1.0)),)),
        attrs.evolve(SCENE, ambient=Ambient(range=1.0)),
        attrs.evolve(SCENE, sky=Sky(texture=np.zeros((2, 2, 3), np.float32))),
        attrs.evolve(SCENE, sky=Sky(texture=np.zeros((1, 4, 3), np.float32))),
        attrs.evolve(SCENE, photons=Photons(count=7)),
        attrs.evolve(SCENE, resolution=(128, 127)),
        attrs.evolve(SCENE, resolution=(127, 128)),
        attrs.evolve(SCENE, max_bounces=3),
        attrs.evolve(SCENE, scope="first-hit"),
        attrs.evolve(SCENE, draw_lights=True),
    ]


def test_different_scenes_have_different_digests():
    """Every field that changes an image changes the digest, and no two of these run together."""
    digests = [scene.digest() for scene in changed_scenes()]
    assert len(set(digests)) == len(digests)


unit = st.floats(0, 1)
colors = st.tuples(unit, unit, unit)


@settings(max_examples=50, deadline=None)
@given(color=colors, gloss=unit, roughness=st.floats(1e-4, 1.5), f0=colors)
def test_any_valid_material_survives_the_file(tmp_path_factory, color, gloss, roughness, f0):
    """Written as TOML and read back, every number is the same to the bit."""
    text = GOOD + f"color = {list(color)}\ngloss = {gloss!r}\nroughness = {roughness!r}\nf0 = {list(f0)}\n"
    scene = load(write(tmp_path_factory.mktemp("material"), text))
    assert scene.objects[0].material == Material(color, gloss, roughness, f0)


@settings(max_examples=50, deadline=None)
@given(gloss=st.floats(allow_nan=True, allow_infinity=True).filter(lambda g: not 0 <= g <= 1))
def test_no_invalid_gloss_survives_the_file(tmp_path_factory, gloss):
    """Anything outside [0, 1], NaN and infinities included, is refused in one line."""
    with pytest.raises(FileError, match=r"gloss = .*\[0, 1\]") as caught:
        load(write(tmp_path_factory.mktemp("material"), GOOD + f"gloss = {gloss!r}\n"))
    assert "\n" not in str(caught.value)


def test_weights_of_a_material():
    """color (1 - gloss) and gloss; with reflections off the paper's code drops the factor and the lobe."""
    material = Material((0.8, 0.4, 0.2), gloss=0.25)
    assert SCENE.diffuse_weight(material) == pytest.approx((0.6, 0.3, 0.15))
    assert SCENE.specular_weight(material) == 0.25
    off = attrs.evolve(SCENE, toggles=attrs.evolve(SCENE.toggles, reflections=False))
    assert off.diffuse_weight(material) == (0.8, 0.4, 0.2)
    assert off.specular_weight(material) == 0.0


def test_an_emitter_is_black():
    """Its surface neither reflects nor glows in any term but through its emission."""
    lamp = Object("lamp", TRIANGLE, Material((0.9, 0.9, 0.9), gloss=0.5), emission=(1.0, 0.0, 0.0))
    assert lamp.emits
    assert lamp.surface.color == (0.0, 0.0, 0.0)
    assert lamp.surface.gloss == 0.0


NUMBERS = {
    "integers": (Material((1, 1, 1), 0, 1, (0, 1, 0)), Material((1.0, 1.0, 1.0), 0.0, 1.0, (0.0, 1.0, 0.0))),
    "numpy": (
        Material(np.array([0.5, 0.25, 1.0], np.float32), np.float64(0.5), np.float32(0.5), list(np.ones(3, np.int64))),
        Material((0.5, 0.25, 1.0), 0.5, 0.5, (1.0, 1.0, 1.0)),
    ),
    "lights": (PointLight((0, np.int32(1), 2), [1, 2, 3]), PointLight((0.0, 1.0, 2.0), (1.0, 2.0, 3.0))),
    "ambient": (Ambient((1, 0, 0), np.int64(2)), Ambient((1.0, 0.0, 0.0), 2.0)),
    "sky": (Sky((1, 1, 0), None, (0, 0, 1), 5), Sky((1.0, 1.0, 0.0), None, (0.0, 0.0, 1.0), 5.0)),
    "camera": (
        Camera((0, 0, 1), np.zeros(3, int), [0, 1, 0], 45, 1),
        Camera((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 45.0, 1.0),
    ),
    "photons": (Photons(np.int64(5), 1, 7.0, survival=1), Photons(5, 1.0, 7, survival=1.0)),
    "scene": (
        Scene(
            "s",
            Camera((0, 0, 1), (0, 0, 0), (0, 1, 0)),
            resolution=np.array([3, 4]),
            exposure=2,
            max_bounces=np.int8(1),
        ),
        Scene("s", Camera((0, 0, 1), (0, 0, 0), (0, 1, 0)), resolution=(3, 4), exposure=2.0, max_bounces=1),
    ),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_a_number_is_pythons_own_whatever_made_it(name):
    """Integers where a float is meant, numpy's scalars and arrays: types and all are those of plain numbers."""
    given_so, plain = NUMBERS[name]
    assert repr(given_so) == repr(plain)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Material(0.5), "color = 0.5: allowed is 3 numbers"),
        (lambda: Material((1.0, 1.0)), "color = (1.0, 1.0): allowed is 3 numbers"),
        (lambda: Material("abc"), "color = 'abc': allowed is 3 numbers"),
        (lambda: Material((1.0, 1.0, True)), "color = True: allowed is a number"),
        (lambda: Material(gloss=1j), "gloss = 1j: allowed is a number"),
        (lambda: Material((math.nan, 0, 0)), "color = (nan, 0.0, 0.0): allowed is a number in [0, 1]"),
        (lambda: Photons(count=1.5), "count = 1.5: allowed is an integer"),
        (lambda: Photons(count=math.inf), "count = inf: allowed is a number in [1, 2.14748e+09]"),
        (lambda: Photons(survival="1"), "survival = '1': allowed is a number"),
    ],
)
def test_what_is_no_number_is_refused_by_name(make, message):
    """Classes of the model, used from Python: the message of a file, less the file."""
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        make()
