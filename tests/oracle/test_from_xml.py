"""Mitsuba's XML read as a scene: what Mitsuba renders of the file itself is what the scene's own references are."""

from collections.abc import Callable
from pathlib import Path

import attrs
import numpy as np
import PIL.Image
import pytest
import trimesh
from scipy import ndimage

from termwise import reference
from termwise.reference import backend
from termwise.scenes.exchange import mitsuba, neutral
from termwise.scenes.images import openexr
from termwise.scenes.limits import physical
from termwise.scenes.load import load
from termwise.scenes.model import Material, Object, PointLight, Scene, SphereLight, largest
from termwise.scenes.strict import FileError
from termwise.scenes.textures import Texture
from tests.scenes import small

TWO = '<bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="{}"/></bsdf></bsdf>'
CAMERA = """
<sensor type="perspective" id="cam">
  <float name="fov" value="34"/><string name="fov_axis" value="y"/>
  <transform name="to_world"><lookat origin="1, 3, 5" target="0.1, 0, 0.5" up="0.1, 1, 0"/></transform>
  <film type="hdrfilm">
    <integer name="width" value="24"/><integer name="height" value="16"/>
    <rfilter type="box"/><string name="component_format" value="float32"/><string name="pixel_format" value="rgb"/>
  </film>
</sensor>"""
FLOOR = f"""
<shape type="rectangle" id="floor">
  <transform name="to_world"><scale value="60"/><rotate x="1" angle="-90"/></transform>{TWO.format("0.6 0.5 0.3")}
</shape>"""
SCENE = f"""<scene version="3.0.0">
<default name="bright" value="4"/>
<integrator type="path"><integer name="max_depth" value="-1"/></integrator>
{CAMERA}{FLOOR}
<shape type="cube" id="cube">
  <transform name="to_world"><scale x="0.4" y="0.5" z="0.6"/><rotate y="1" angle="20"/><translate y="0.6"/></transform>
  {TWO.format("0.2 0.5 0.8")}
</shape>
<shape type="obj" id="shard">
  <string name="filename" value="shard.obj"/><boolean name="face_normals" value="true"/>
  <transform name="to_world"><scale x="-1"/><translate x="1.2" y="0.3"/></transform>{TWO.format("0.9 0.9 0.2")}
</shape>
<shape type="rectangle" id="lamp">
  <transform name="to_world"><rotate x="1" angle="-90"/><scale value="0.7"/><translate x="-1" y="4" z="1"/></transform>
  <boolean name="flip_normals" value="true"/>{TWO.format("0 0 0")}
  <emitter type="area"><rgb name="radiance" value="9 8 $bright"/></emitter>
</shape>
<emitter type="point"><point name="position" x="2" y="2" z="1"/><rgb name="intensity" value="3 4 5"/></emitter>
<shape type="sphere" id="ball">
  <point name="center" x="1" y="0" z="0"/><float name="radius" value="0.3"/>
  <transform name="to_world"><scale value="1.5"/><translate x="0.4" y="4.5" z="-0.5"/></transform>
  <bsdf type="diffuse"><rgb name="reflectance" value="0 0 0"/></bsdf>
  <emitter type="area"><rgb name="radiance" value="5 10 30"/></emitter>
</shape>
<emitter type="spot">
  <transform name="to_world"><lookat origin="-1, 3, 2" target="0.3, 0, 0.4" up="0, 1, 0"/></transform>
  <float name="cutoff_angle" value="25"/><float name="beam_width" value="10"/>
  <rgb name="intensity" value="9 3 1"/>
</emitter>
<emitter type="directional">
  <vector name="direction" x="1" y="-1" z="-0.4"/><rgb name="irradiance" value="0.2 0.6 0.9"/>
</emitter>
<emitter type="constant"><rgb name="radiance" value="0.1 0.2 0.3"/></emitter>
</scene>"""


def written(folder: Path, text: str) -> Path:
    trimesh.Trimesh([[-0.4, 0, 0], [0.6, 0, 0.2], [0, 0.9, 0]], [[0, 1, 2]]).export(folder / "shard.obj")
    (folder / "scene.xml").write_text(text)
    return folder / "scene.xml"


@pytest.mark.skipif(backend.choose().variant == "scalar_rgb", reason="a million paths, one by one")
def test_the_scene_is_what_mitsuba_renders(tmp_path: Path):
    path, count, spp = written(tmp_path, SCENE), 8, 128
    scene = load(path)
    assert scene.substitutions == ()
    limit = reference.shared(scene, physical("direct"))
    ours = np.array(
        [
            np.sum(list(reference.replicate_parts(scene, limit, spp=spp, seed=1, replicate=k).values()), axis=0)
            for k in range(count)
        ]
    )
    mi = backend.import_mitsuba()
    loaded = mi.load_file(str(path))
    theirs = np.array([np.array(mi.render(loaded, spp=spp, seed=k)) for k in range(count)], np.float64)
    means = [images.reshape(count, 2, 8, 3, 8, 3).mean(axis=(2, 4)) for images in (ours, theirs)]
    error = np.sqrt(sum(each.var(axis=0, ddof=1) for each in means) / count)
    expected = means[1].mean(axis=0)
    assert (np.abs(means[0].mean(axis=0) - expected) < 5 * error).all()
    assert (error < 0.02 * expected).all()


def test_names_numbers_and_size_are_those_of_the_file(tmp_path: Path):
    scene = load(written(tmp_path, SCENE))
    assert [thing.name for thing in scene.objects] == ["floor", "cube", "shard", "lamp"]
    assert scene.resolution == (24, 16)
    assert scene.objects[1].material.color == (0.2, 0.5, 0.8)
    assert scene.objects[3].emission == (9.0, 8.0, 4.0)
    ball = scene.lights[0]
    assert isinstance(ball, SphereLight)
    assert (ball.center, ball.radiance) == ((1.9, 4.5, -0.5), (5.0, 10.0, 30.0))
    assert ball.radius == pytest.approx(0.45)
    assert scene.lights[1] == PointLight((2.0, 2.0, 1.0), (3.0, 4.0, 5.0))
    assert scene.sky.color == scene.ambient_light == (0.1, 0.2, 0.3)


@pytest.mark.parametrize("name", ["cornell_box", "smooth_monkey"])
def test_an_export_comes_back(name: str, tmp_path: Path):
    given = neutral.diffuse(small(name, 40, 30))
    mitsuba.write(given, tmp_path / "there.xml")
    found = load(tmp_path / "there.xml")
    assert found.substitutions == ()
    for mine, theirs in zip(found.objects, given.objects, strict=True):
        assert (mine.name, mine.emission, mine.surface.color) == (theirs.name, theirs.emission, theirs.surface.color)
        np.testing.assert_array_equal(mine.mesh.vertices[mine.mesh.faces], theirs.mesh.vertices[theirs.mesh.faces])
        assert (mine.mesh.normals is None) == (theirs.mesh.normals is None)
    film = np.random.default_rng(1).random((20, 2))
    expected = given.camera.rays(film, aspect=given.aspect)
    np.testing.assert_allclose(found.camera.rays(film, aspect=found.aspect), expected, atol=1e-6)


def test_light_that_crosses_comes_back(tmp_path: Path):
    """Of a surface without gloss as it was, of a glossy one beside its lobe."""
    given = small("leaf")
    mitsuba.write(given, tmp_path / "there.xml")
    with pytest.raises(FileError, match="leaf: roughconductor"):
        load(tmp_path / "there.xml")
    found = load(tmp_path / "there.xml", approximate=True)
    assert len(found.substitutions) == 1
    for mine, theirs in zip(found.objects, given.objects, strict=True):
        for field in ("color", "gloss", "translucency"):
            expected = getattr(theirs.surface, field)
            np.testing.assert_allclose(getattr(mine.surface, field), expected, rtol=1e-6)


def same_value(mine: object, theirs: object) -> None:
    """Numbers, or images to the bit."""
    assert isinstance(mine, Texture) == isinstance(theirs, Texture)
    if isinstance(mine, Texture):
        assert mine == theirs
    else:
        np.testing.assert_allclose(mine, theirs, rtol=1e-6)  # type: ignore[arg-type]


def test_images_come_back(tmp_path: Path):
    """Every field that may be one, where it lies on the mesh, and how it goes on."""
    wild = small("wild")
    stone = wild.objects[1]
    color, material = stone.material.color, stone.material
    assert isinstance(color, Texture)
    shares = Texture(color.texels[..., 1], "clamp")
    others = {
        "crossed": Material(attrs.evolve(color, wrap="clamp"), translucency=0.25),
        "glossy": attrs.evolve(material, gloss=shares),
        "lacquered": attrs.evolve(material, gloss=shares, translucency=0.25),
    }
    rectangle = wild.objects[0]
    for number, (name, look) in enumerate(others.items(), start=1):
        moved = attrs.evolve(rectangle.mesh, vertices=rectangle.mesh.vertices + [0.0, 0.0, -number])
        wild = attrs.evolve(wild, objects=(*wild.objects, Object(name, moved, look)))
    mitsuba.write(wild, tmp_path / "there.xml")
    found = load(tmp_path / "there.xml", approximate=True)
    assert [line.partition(":")[0] for line in found.substitutions] == ["stone", "glossy", "lacquered"]  # the lobe
    for mine, theirs in zip(found.objects, wild.objects, strict=True):
        same_value(mine.emission, theirs.emission)
        for field in ("color", "gloss", "roughness", "translucency"):
            if field == "color" or largest(theirs.surface.gloss) or field == "translucency":
                same_value(getattr(mine.surface, field), getattr(theirs.surface, field))
        np.testing.assert_array_equal(mine.mesh.vertices[mine.mesh.faces], theirs.mesh.vertices[theirs.mesh.faces])
        assert mine.mesh.uv is not None
        assert theirs.mesh.uv is not None
        np.testing.assert_allclose(mine.mesh.uv, theirs.mesh.uv, atol=1e-7)  # 1 - (1 - v), in float32
    plain = neutral.diffuse(attrs.evolve(wild, objects=wild.objects[:3]))
    mitsuba.write(plain, tmp_path / "plain.xml")
    assert load(tmp_path / "plain.xml").substitutions == ()


BITMAP = '<texture name="{}" type="bitmap"><string name="filename" value="{}"/>{}</texture>'
SCREENS = f"""<scene version="3.0.0">{CAMERA}
<shape type="rectangle" id="tiled"><transform name="to_world"><scale x="1" y="2"/></transform>
  <bsdf type="twosided"><bsdf type="diffuse">{BITMAP.format("reflectance", "a.png", '<transform name="to_uv"><scale x="2" y="-1.5"/><rotate z="1" angle="20"/><translate x="0.3" y="0.1"/></transform>')}</bsdf></bsdf></shape>
<shape type="obj" id="mapped"><string name="filename" value="mapped.obj"/><boolean name="flip_normals" value="true"/>
  <bsdf type="twosided"><bsdf type="diffuse">{BITMAP.format("reflectance", "a.exr", '<string name="wrap_mode" value="clamp"/>')}</bsdf></bsdf></shape>
<shape type="cube" id="cube"><transform name="to_world"><translate x="5"/></transform>
  <bsdf type="twosided"><bsdf type="diffuse">{BITMAP.format("reflectance", "grey.exr", '<string name="wrap_mode" value="mirror"/>')}</bsdf></bsdf></shape>
<shape type="rectangle" id="screen"><transform name="to_world"><translate z="3"/></transform>
  <boolean name="flip_normals" value="true"/>{TWO.format("0 0 0")}
  <emitter type="area">{BITMAP.format("radiance", "bright.exr", '<boolean name="raw" value="true"/>')}</emitter></shape>
</scene>"""  # noqa: E501


def bilinear(texture: Texture, uv: np.ndarray) -> np.ndarray:
    """The image (N, 3) at places (N, 2), by SciPy."""
    height, width, _ = texture.texels.shape
    places = np.stack([(1.0 - uv[:, 1]) * height - 0.5, uv[:, 0] * width - 0.5])
    mode = {"repeat": "grid-wrap", "clamp": "nearest"}[texture.wrap]
    return np.stack(
        [ndimage.map_coordinates(c, places, order=1, mode=mode) for c in np.moveaxis(texture.texels, 2, 0)]
    ).T


def looked_up(thing: Object, random: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (N, 3) of a surface, normals (N, 3) there, and what its image has there."""
    face = random.integers(len(thing.mesh.faces), size=count)
    weights = random.dirichlet([1.0, 1.0, 1.0], count)
    corners = thing.mesh.vertices[thing.mesh.faces[face]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    (image,) = thing.images.values()
    assert thing.mesh.uv is not None
    places = np.einsum("nk,nkc->nc", weights, thing.mesh.uv[face])
    points = np.einsum("nk,nkc->nc", weights, corners)
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True), bilinear(image, places)


@pytest.mark.skipif(backend.choose().variant == "scalar_rgb", reason="a call of it takes one place")
def test_bitmaps_lie_where_mitsuba_has_them(tmp_path: Path):
    """Tiled, turned and mirrored by `to_uv`; by a mesh's own places; on a lamp that is turned over."""
    random = np.random.default_rng(4)
    PIL.Image.fromarray(random.integers(0, 256, (5, 4, 3), dtype=np.uint8)).save(tmp_path / "a.png")
    for name, scale in (("a", 1.0), ("bright", 9.0)):
        openexr.write(tmp_path / f"{name}.exr", scale * random.random((4, 6, 3), np.float32))
    openexr.write(tmp_path / "grey.exr", np.repeat(random.random((3, 4, 1), np.float32), 3, axis=2))
    corners = "v 0 0 8\nv 1 0 8\nv 0 1 8.5\nvt -0.2 0.1\nvt 1.3 0.2\nvt 0.4 0.9\nf 1/2 2/3 3/1\n"
    (tmp_path / "mapped.obj").write_text(corners)
    (tmp_path / "screens.xml").write_text(SCREENS)
    scene = load(tmp_path / "screens.xml")
    assert scene.substitutions == ()
    points, normals, expected = (
        np.concatenate(each) for each in zip(*(looked_up(thing, random, 40) for thing in scene.objects), strict=True)
    )
    mi = backend.import_mitsuba()
    loaded = mi.load_file(str(tmp_path / "screens.xml"))
    si = loaded.ray_intersect(mi.Ray3f(mi.Point3f((points + 0.1 * normals).T), mi.Vector3f(-normals.T)))
    np.testing.assert_allclose(np.array(si.p).T, points, atol=1e-5)
    found = np.array(si.bsdf().eval_diffuse_reflectance(si)) + np.array(si.emitter(loaded).eval(si))
    np.testing.assert_allclose(found.T, expected, atol=2e-4)  # Mitsuba's places are of single precision


# What is changed in the file above; the feature that the message names; the object and the mean that it then has.
UNLAID: dict[str, tuple[str, str, str]] = {
    "mirrored": ('<string name="wrap_mode" value="clamp"/>', '<string name="wrap_mode" value="mirror"/>', "mirrored"),
    "steps": (
        '<string name="wrap_mode" value="clamp"/>',
        '<string name="filter_type" value="nearest"/>',
        "not interpolated",
    ),
    "disk": ('<shape type="rectangle" id="screen">', '<shape type="disk" id="screen">', "without places in it"),
}


@pytest.mark.parametrize("case", UNLAID)
def test_a_bitmap_that_cannot_be_laid_is_its_mean_and_listed(case: str, tmp_path: Path):
    random = np.random.default_rng(4)
    pixels = 0.5 * random.random((4, 6, 3), np.float32)
    for name in ("a.exr", "bright.exr", "grey.exr"):
        openexr.write(tmp_path / name, pixels)
    PIL.Image.fromarray(random.integers(0, 256, (5, 4, 3), dtype=np.uint8)).save(tmp_path / "a.png")
    (tmp_path / "mapped.obj").write_text("v 0 0 8\nv 1 0 8\nv 0 1 8.5\nvt 0 0\nvt 2 0\nvt 0 1\nf 1/1 2/2 3/3\n")
    old, new, said = UNLAID[case]
    assert old in SCREENS
    (tmp_path / "screens.xml").write_text(SCREENS.replace(old, new))
    name = "screen" if case == "disk" else "mapped"
    with pytest.raises(FileError, match=f"{name}: bitmap, a texture of .*, .*{said}.* --approximate takes its mean"):
        load(tmp_path / "screens.xml")
    found = load(tmp_path / "screens.xml", approximate=True)
    assert any(line.startswith(f"{name}: bitmap") and said in line for line in found.substitutions)
    thing = next(each for each in found.objects if each.name == name)
    mean = thing.emission if case == "disk" else thing.material.color
    assert not isinstance(mean, Texture)
    np.testing.assert_allclose(mean, pixels.mean(axis=(0, 1)), rtol=1e-5)


def test_a_texel_that_no_surface_has_is_named(tmp_path: Path):
    openexr.write(tmp_path / "a.exr", np.full((2, 2, 3), 1.5, np.float32))
    image = BITMAP.format("reflectance", "a.exr", "")
    shape = (
        f'<shape type="rectangle" id="wall"><bsdf type="twosided"><bsdf type="diffuse">{image}</bsdf></bsdf></shape>'
    )
    (tmp_path / "a.xml").write_text(f'<scene version="3.0.0">{shape}</scene>')
    with pytest.raises(FileError, match=r"a.xml: wall: color: texel \[1.5, 1.5, 1.5\] in row 0, column 0: allowed is"):
        load(tmp_path / "a.xml")


def test_glass_comes_back(tmp_path: Path):
    """Clear, and with a diffuse part that light crosses, or that it does not; smooth, and nearly so."""
    given = small("monkey")
    glass = Material((0.5, 0.25, 0.75), 0.5, 0.25, transparency=0.75, ior=1.25, tint=(1.0, 0.5, 0.25))
    for material in (
        glass,
        attrs.evolve(glass, translucency=0.25),
        attrs.evolve(glass, gloss=1.0, color=(0.0, 0.0, 0.0), ior=0.8),
        attrs.evolve(glass, roughness=1e-4),
        attrs.evolve(glass, roughness=1e-3),
    ):
        scene = attrs.evolve(given, objects=(attrs.evolve(given.objects[0], material=material),))
        mitsuba.write(scene, tmp_path / "there.xml")
        with pytest.raises(FileError, match="dielectric"):
            load(tmp_path / "there.xml")
        found = load(tmp_path / "there.xml", approximate=True).objects[0].material
        for field in ("color", "gloss", "roughness", "translucency", "transparency", "ior", "tint"):
            np.testing.assert_allclose(getattr(found, field), getattr(material, field), rtol=1e-6, err_msg=field)
        assert found.dielectric


def test_how_numpy_prints_changes_nothing(tmp_path: Path):
    """NumPy's old way of printing, which importing colour-science chooses, has six digits of a float32."""
    given = small("monkey")
    color = (1.0 / 3.0, 4.0 / 7.0, 1e-3 / 7.0)
    scene = attrs.evolve(given, objects=(attrs.evolve(given.objects[0], material=Material(color, 0.0)),))
    mitsuba.write(scene, tmp_path / "there.xml")
    with np.printoptions(legacy="1.13"):
        found = load(tmp_path / "there.xml").objects[0].material
    np.testing.assert_allclose(largest(found.color), color, rtol=1e-7)


def test_gloss_comes_back_listed(tmp_path: Path):
    given = small("cornell_box")
    mitsuba.write(given, tmp_path / "there.xml")
    with pytest.raises(FileError, match="short block, tall block: roughconductor"):
        load(tmp_path / "there.xml")
    found = load(tmp_path / "there.xml", approximate=True)
    for mine, theirs in zip(found.objects, given.objects, strict=True):
        if largest(theirs.material.gloss) > 0:
            for field in ("color", "gloss", "roughness", "f0"):
                expected = getattr(theirs.material, field)
                np.testing.assert_allclose(getattr(mine.material, field), expected, rtol=1e-6)


def test_an_environment_is_where_mitsuba_has_it(tmp_path: Path):
    mitsuba.write(small("two_cubes"), tmp_path / "there.xml")
    found = load(tmp_path / "there.xml", approximate=True)
    texture = found.sky.texture
    assert texture is not None
    sky = backend.import_mitsuba().load_file(str(tmp_path / "there.xml")).environment()
    mi = backend.import_mitsuba()
    n = np.random.default_rng(3).normal(size=(200, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(-n.T)
    expected = np.array(sky.eval(si)).T
    height, width = texture.shape[:2]
    u = np.arctan2(n[:, 0], n[:, 1]) / (2 * np.pi) + 0.5
    row, column = (np.arccos(n[:, 2]) / np.pi * height).astype(int), (u * width).astype(int) % width
    np.testing.assert_allclose(texture[row, column], expected, rtol=0.05, atol=0.02)


def test_a_texture_is_its_mean_and_a_round_shape_is_triangles(tmp_path: Path):
    colors = '<rgb name="color0" value="0.1"/><rgb name="color1" value="0.5"/>'
    board = f'<texture type="checkerboard" name="reflectance">{colors}</texture>'
    surface = f'<bsdf type="twosided"><bsdf type="diffuse">{board}</bsdf></bsdf>'
    ball = f'<shape type="sphere" id="ball"><float name="radius" value="2"/>{surface}</shape>'
    found = load(written(tmp_path, f'<scene version="3.0.0">{ball}</scene>'), approximate=True)
    assert found.objects[0].material.color == pytest.approx((0.3, 0.3, 0.3))
    mesh = found.objects[0].mesh
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), 2.0, rtol=1e-6)
    assert mesh.normals is not None
    np.testing.assert_allclose(mesh.normals, mesh.vertices / 2.0, atol=1e-6)
    features = [line for line in found.substitutions if not line.startswith("assumed")]
    assert any("checkerboard" in line for line in features)
    assert any("5120 triangles" in line for line in features)


def plain(inside: str) -> str:
    return f'<scene version="3.0.0">{CAMERA}{FLOOR}{inside}</scene>'


def swap(old: str, new: str) -> Callable[[], str]:
    return lambda: plain("").replace(old, new)


def disk(surface: str) -> Callable[[], str]:
    return lambda: plain(f'<shape type="rectangle" id="plate">{surface}</shape>')


# A file; the node and the feature of the message; whether something may stand for it.
UNSAID: dict[str, tuple[Callable[[], str], str, str, bool]] = {
    "one side": (disk('<bsdf type="diffuse"/>'), "plate", "diffuse on one side", True),
    "glass": (disk('<bsdf type="dielectric" id="glass"/>'), "plate: bsdf glass", "dielectric (smooth)", True),
    "rough glass": (disk('<bsdf type="roughdielectric"/>'), "plate", "roughdielectric (beckmann)", True),
    "thin glass": (disk('<bsdf type="thindielectric"/>'), "plate", "thindielectric", False),
    "mirror": (disk('<bsdf type="twosided"><bsdf type="conductor"/></bsdf>'), "plate", "conductor (a mirror)", True),
    "plastic": (disk('<bsdf type="twosided"><bsdf type="plastic"/></bsdf>'), "plate", "plastic", True),
    "principled": (disk('<bsdf type="twosided"><bsdf type="principled"/></bsdf>'), "plate", "principled", True),
    "mask": (disk('<bsdf type="mask"><bsdf type="diffuse"/></bsdf>'), "plate", "mask", False),
    "curve": (lambda: plain('<shape type="cylinder" id="pipe"/>'), "pipe", "cylinder, a shape", False),
    "round": (lambda: plain('<shape type="disk" id="coin"/>'), "coin", "disk", True),
    "squeezed": (
        lambda: plain(
            '<shape type="sphere" id="egg"><transform name="to_world"><scale x="2"/></transform>'
            f'{TWO.format("0")}<emitter type="area"/></shape>'
        ),
        "egg",
        "squeezes or shears",
        True,
    ),
    "instances": (lambda: plain('<shape type="shapegroup" id="many"/>'), "many", "shapegroup", False),
    "projector": (
        lambda: plain('<emitter type="projector" id="beam"><rgb name="irradiance" value="1"/></emitter>'),
        "beam",
        "projector, a light",
        True,
    ),
    "filter": (swap('type="box"', 'type="gaussian"'), "cam", "gaussian, a pixel filter", True),
    "lens": (
        swap('type="perspective" id="cam">', 'type="thinlens" id="cam"><float name="aperture_radius" value="0.1"/>'),
        "cam",
        "thinlens",
        True,
    ),
    "orthographic": (
        lambda: (
            plain("")
            .replace('"perspective"', '"orthographic"')
            .replace('<float name="fov" value="34"/>', "")
            .replace('<string name="fov_axis" value="y"/>', "")
        ),
        "cam",
        "orthographic, a sensor",
        False,
    ),
    "medium": (
        lambda: plain(
            f'<shape type="cube" id="fog">{TWO.format("0.5")}'
            '<medium type="homogeneous" name="interior" id="smoke"/></shape>'
        ),
        "smoke",
        "homogeneous, a medium",
        False,
    ),
    "near plane": (
        swap('<float name="fov"', '<float name="near_clip" value="9"/><float name="fov"'),
        "camera",
        "planes",
        True,
    ),
}


@pytest.mark.parametrize("case", UNSAID)
def test_what_the_model_cannot_say_is_refused_by_node_and_plugin(case: str, tmp_path: Path):
    text, node, feature, allowed = UNSAID[case]
    path = written(tmp_path, text())
    with pytest.raises(FileError) as refused:
        load(path)
    message = str(refused.value)
    assert message.startswith(f"{path}: {node}")
    assert feature in message
    assert "\n" not in message
    assert ("--approximate" in message) == allowed
    if allowed:
        found = load(path, approximate=True)
        assert any(line.startswith(node) and feature in line for line in found.substitutions)
    else:
        with pytest.raises(FileError):
            load(path, approximate=True)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("<scene", "Mitsuba does not load it"),
        ('<scene version="3.0.0"><shape type="ply"/></scene>', "Mitsuba does not load it"),
        ('<bsdf type="diffuse" version="3.0.0"/>', "is no scene"),
        ('<scene version="3.0.0"></scene>', "holds no surface"),
    ],
)
def test_a_wrong_file_is_one_line(text: str, named: str, tmp_path: Path):
    with pytest.raises(FileError, match=named) as refused:
        load(written(tmp_path, text))
    assert str(refused.value).startswith(str(tmp_path / "scene.xml"))
    assert "\n" not in str(refused.value)


def test_what_was_read_leaves_nothing_in_mitsuba(tmp_path: Path):
    """Every plugin that exists would be compiled into every kernel of the references."""
    found = load(written(tmp_path, SCENE))
    assert isinstance(found, Scene)
    import gc

    mi = backend.import_mitsuba()
    assert not [
        each for each in gc.get_objects() if isinstance(each, mi.Scene | mi.BSDF) and type(each).__module__ == "mitsuba"
    ]


# Lamps: which of their sides shines is asked of Mitsuba's own intersection.

AHEAD, ASIDE, BEHIND = "vn 0.6 0 0.8\n", "vn 0 0 1\n", "vn 0 0 -1\n"
SPECK = (
    '<shape type="rectangle" id="speck"><transform name="to_world"><scale value="0.1"/><translate x="99"/></transform>'
    f"{TWO.format('0.5')}</shape>"
)
TRANSFORMS = ('<scale value="1"/>', '<scale x="-0.7" y="0.9"/><rotate x="1" angle="30"/>')


def shard(normal: str) -> str:
    corners = "f 1//1 2//1 3//1" if normal else "f 1 2 3"
    return f"v -1 -1 0\nv 1 -1 0\nv 0 1 0\n{normal}{corners}\n"


def shining(scene: Scene, origins: np.ndarray, ways: np.ndarray) -> np.ndarray:
    """Whether rays (N, 3) see the front of the first face that they meet, or a ball from without."""
    for light in scene.lights:
        assert isinstance(light, SphereLight)
        outside = np.linalg.norm(light.center - origins, axis=1) > light.radius
        return outside & (np.linalg.norm(np.cross(light.center - origins, ways), axis=1) < light.radius)
    thing = scene.objects[1]
    mesh = trimesh.Trimesh(thing.mesh.vertices, thing.mesh.faces, process=False)
    meets, rays, faces = mesh.ray.intersects_location(origins, ways, multiple_hits=True)
    front = np.zeros(len(origins), bool)
    nearest = np.full(len(origins), np.inf)
    for meet, ray, face in zip(meets, rays, faces, strict=True):
        if (away := np.linalg.norm(meet - origins[ray])) < nearest[ray]:
            nearest[ray], front[ray] = away, mesh.face_normals[face] @ ways[ray] < 0.0
    return front


@pytest.mark.parametrize(
    "kind",
    [
        "rectangle",
        "sphere",
        "against",
        *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("disk", "cube", "bare", "with")),
    ],
)
def test_a_lamp_shines_from_the_side_that_mitsuba_s_does(kind: str, tmp_path: Path):
    given = {"bare": "", "with": ASIDE, "against": BEHIND}
    (tmp_path / "shard.obj").write_text(shard(given.get(kind, "")))
    mi = backend.import_mitsuba()
    origins = np.array([[0.1, 0.05, 4.0], [0.1, 0.05, -4.0], [0.1, 0.02, 0.1]])
    ways = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    for to_world in TRANSFORMS:
        for flip in ("true", "false"):
            file = '<string name="filename" value="shard.obj"/>' if kind in given else ""
            text = (
                f'<scene version="3.0.0">{SPECK}<shape type="{"obj" if file else kind}">{file}'
                f'<boolean name="flip_normals" value="{flip}"/><transform name="to_world">{to_world}</transform>'
                f'{TWO.format("0")}<emitter type="area"><rgb name="radiance" value="1 2 3"/></emitter></shape></scene>'
            )
            (tmp_path / "lamp.xml").write_text(text)
            found = load(tmp_path / "lamp.xml", approximate=True)
            if kind not in ("disk", "sphere"):
                assert load(tmp_path / "lamp.xml").digest() == attrs.evolve(found, substitutions=()).digest()
            theirs = mi.load_file(str(tmp_path / "lamp.xml"))
            lit = []
            for origin, way in zip(origins, ways, strict=True):
                si = theirs.ray_intersect(mi.Ray3f(mi.Point3f(*origin.tolist()), mi.Vector3f(*way.tolist())))
                emitter = theirs.emitters()[0]
                lit.append(bool(np.array(si.is_valid()).ravel()[0]) and np.array(emitter.eval(si)).max() > 0.0)
            np.testing.assert_array_equal(shining(found, origins, ways), lit)
            assert any(lit)


def test_a_lamp_with_normals_of_its_own_is_refused_or_listed(tmp_path: Path):
    path = written(
        tmp_path,
        plain(
            '<shape type="obj" id="lamp"><string name="filename" value="bent.obj"/>'
            f'{TWO.format("0")}<emitter type="area"/></shape>'
        ),
    )
    (tmp_path / "bent.obj").write_text(shard(AHEAD))
    with pytest.raises(FileError, match="lamp: a lamp whose normals are not its faces'"):
        load(path)
    assert load(path, approximate=True).objects[1].emits


def test_a_mirrored_smooth_mesh_keeps_its_normals(tmp_path: Path):
    """It looks as its normals say: which way a face is wound is nothing to a surface of two sides."""
    ball = trimesh.creation.icosphere(subdivisions=1)
    lines = [f"v {x} {y} {z}" for x, y, z in ball.vertices] + [f"vn {x} {y} {z}" for x, y, z in ball.vertices]
    lines += ["f " + " ".join(f"{i}//{i}" for i in face + 1) for face in ball.faces]
    path = written(
        tmp_path,
        plain(
            '<shape type="obj" id="ball"><string name="filename" value="ball.obj"/><transform name="to_world">'
            f'<scale x="-1"/><translate x="2"/></transform>{TWO.format("0.5")}</shape>'
        ),
    )
    (tmp_path / "ball.obj").write_text("\n".join(lines))
    mesh = load(path).objects[1].mesh
    assert mesh.normals is not None
    np.testing.assert_allclose(mesh.normals, mesh.vertices - [2.0, 0.0, 0.0], atol=1e-6)
    assert trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).volume > 0.0


@pytest.mark.parametrize("squeeze", ['<scale x="2" y="0.5"/>', '<matrix value="1 .5 0 0 0 1 .3 0 .2 0 1 0 0 0 0 1"/>'])
def test_a_squeezed_sphere_is_the_ball_that_mitsuba_makes_of_it(squeeze: str, tmp_path: Path):
    text = (
        f'<scene version="3.0.0">{SPECK}<shape type="sphere" id="egg"><point name="center" x="1" y="2" z="3"/>'
        f'<float name="radius" value="2"/><transform name="to_world">{squeeze}</transform>{TWO.format("0")}'
        '<emitter type="area"/></shape></scene>'
    )
    path = written(tmp_path, text)
    mi = backend.import_mitsuba()
    level = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)
    box = next(each.bbox() for each in mi.load_file(str(path)).shapes() if each.id() == "egg")
    mi.set_log_level(level)
    found = load(path, approximate=True).lights[0]
    assert isinstance(found, SphereLight)
    np.testing.assert_allclose(found.center, np.array(box.center()).ravel(), rtol=1e-6)
    np.testing.assert_allclose([found.radius] * 3, np.array(box.extents()).ravel() / 2.0, rtol=1e-6)


# What a whole file says


def test_all_that_is_refused_is_named_the_hopeless_first(tmp_path: Path):
    plastic = '<shape type="rectangle" id="{}"><bsdf type="twosided"><bsdf type="plastic"/></bsdf></shape>'
    path = written(
        tmp_path,
        plain(
            plastic.format("plate")
            + plastic.format("dish")
            + '<shape type="rectangle" id="pane"><bsdf type="thindielectric"/></shape>'
            + f'<shape type="cylinder" id="pipe">{TWO.format("0.5")}</shape>'
        ).replace('type="box"', 'type="gaussian"'),
    )
    with pytest.raises(FileError) as refused:
        load(path)
    said = str(refused.value).removeprefix(f"{path}: ")
    parts = [part.partition(": the model has none")[0] for part in said.split("; ")]
    assert parts == [
        "pane: thindielectric",
        "pipe: cylinder, a shape",
        "plate, dish: plastic",
        "cam: gaussian, a pixel filter",
    ]


@pytest.mark.parametrize(
    ("integrator", "said"),
    [
        ('<integrator type="path"><integer name="max_depth" value="-1"/></integrator>', ""),
        ('<integrator type="path"><integer name="max_depth" value="2"/></integrator>', "max_depth = 2"),
        (
            '<integrator type="direct"><boolean name="hide_emitters" value="true"/></integrator>',
            "direct, hide_emitters",
        ),
        (
            '<integrator type="moment"><integrator type="path"><boolean name="hide_emitters" value="true"/>'
            "</integrator></integrator>",
            "hide_emitters",
        ),
    ],
)
def test_what_an_integrator_leaves_out_is_a_note(integrator: str, said: str, tmp_path: Path):
    found = load(written(tmp_path, plain(integrator + '<emitter type="constant"/>')))
    line = f"assumed: full light transport and lamps in sight, whatever the integrator says: {said}"
    assert found.substitutions == ((line,) if said else ())


def test_a_beam_wider_than_its_spot_ends_where_mitsuba_s_does(tmp_path: Path):
    numbers = '<float name="cutoff_angle" value="{}"/><float name="beam_width" value="{}"/>'
    spot = f'<emitter type="spot">{numbers.format(20, 30)}</emitter>'
    found = load(written(tmp_path, plain(spot))).lights[0]
    mi = backend.import_mitsuba()
    theirs = mi.load_dict({"type": "spot", "cutoff_angle": 20.0, "beam_width": 30.0})
    for degrees in (0.0, 14.0, 19.0, 21.0, 29.0):
        angle = np.radians(degrees)
        at = mi.Interaction3f()
        at.p = mi.Point3f(float(np.sin(angle)), 0.0, float(np.cos(angle)))
        _, weight = theirs.sample_direction(at, mi.Point2f(0.5, 0.5), True)
        beam, cutoff = found.angles  # type: ignore[union-attr]
        assert beam == cutoff
        assert np.array(weight).max() == pytest.approx(float(angle < cutoff))


def test_a_file_without_light_is_dark_unless_one_may_stand_for_it(tmp_path: Path):
    path = written(tmp_path, plain(""))
    dark = load(path)
    assert not dark.has_lights
    assert dark.sky.is_black
    assert any("no light, for the file has none" in line for line in dark.substitutions)
    assert load(path, approximate=True).sky.color == (1.0, 1.0, 1.0)


@pytest.mark.parametrize("first", [True, False])
def test_a_caller_s_variant_stays(first: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Whether ours is chosen in the call or was before; what is read and rendered is what it is with ours."""
    path, mi = written(tmp_path, plain("")), backend.import_mitsuba()
    ours, own = mi.variant(), "scalar_spectral"
    limit = reference.shared(small("monkey", 2, 2), physical("direct"))
    expected = reference.replicate(small("monkey", 2, 2), limit, spp=1, seed=1)
    digest = load(path).digest()
    try:
        mi.set_variant(own)
        if first:
            monkeypatch.setattr(backend, "_active", None)
        assert load(path).digest() == digest
        assert mi.variant() == own
        np.testing.assert_array_equal(reference.replicate(small("monkey", 2, 2), limit, spp=1, seed=1), expected)
        assert mi.variant() == own
    finally:
        mi.set_variant(ours)
