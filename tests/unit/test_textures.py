"""Images on surfaces: how their files are read, refused, laid on meshes, kept in keys and written again.

Rationale: a wrong encoding or an image upside down is a plausible picture. Values are decoded by colour-science, places
are told by one quad that three formats hold, and each refusal is one line that names object, field, file and reason.
"""

import io
import json
import struct
import zlib
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import attrs
import colour
import jsonschema
import numpy as np
import PIL.ExifTags
import PIL.Image
import PIL.ImageCms
import PIL.PngImagePlugin
import pytest

from termwise.renderer.plan import plan
from termwise.renderer.terms import DEFAULTS, VARIANTS
from termwise.reports.engines import asked
from termwise.reports.jobs import cells
from termwise.scenes import meshes, reads, textures
from termwise.scenes.analytic import plate
from termwise.scenes.exchange import gltf, mitsuba, neutral, obj, pbrt
from termwise.scenes.images import openexr
from termwise.scenes.load import load
from termwise.scenes.model import Ambient, Camera, Material, Mesh, Object, Scene, largest
from termwise.scenes.save import save
from termwise.scenes.strict import FileError
from termwise.scenes.terms import TABLE
from termwise.scenes.textures import Texture

BYTES = np.random.default_rng(1).integers(1, 256, (3, 5, 3), dtype=np.uint8)
SHARES = BYTES / 255.0
SRGB = colour.cctf_decoding(SHARES, function="sRGB")
TOML = """
resolution = [8, 8]
camera = { position = [0, 0, 3], target = [0, 0, 0], up = [0, 1, 0], pixel = "centre" }
toggles = { ambient_occlusion = false }
ambient = { color = [1, 1, 1] }

[[objects]]
name = "floor"
"""
PLACES = {
    "rectangle": 'shape = "rectangle"\norigin = [-1, -1, 0]\nedges = [[2, 0, 0], [0, 2, 0]]\n',
    "box": 'shape = "box"\nsize = [2, 2, 2]\n',
    "sphere": 'shape = "sphere"\n',
}


def png(path: Path, values: np.ndarray = BYTES, **said: Any) -> Path:
    PIL.Image.fromarray(values).save(path, **said)
    return path


def scene_of(folder: Path, color: str, shape: str = PLACES["rectangle"], *, more: str = "") -> Scene:
    path = folder / "scene.toml"
    path.write_text(f"{TOML}{shape}color = {color}\n{more}")
    return load(path)


def textured(texels: Any = SRGB, **changes: Any) -> Scene:
    """A square of one image, and a plain one beside it."""
    square = plate("floor", (-1.0, -1.0, 0.0), (2.0, 0.0, 0.0), (0.0, 2.0, 0.0), Material())
    mesh = Mesh.from_arrays(square.mesh.vertices, square.mesh.faces, uv=[[0, 0], [1, 0], [1, 1], [0, 1]])
    floor = attrs.evolve(square, mesh=mesh, material=Material(Texture(texels)))
    aside = plate("aside", (2.0, -1.0, 0.0), (2.0, 0.0, 0.0), (0.0, 2.0, 0.0), Material())
    return Scene("squares", Camera((0.0, -0.5, 3.0), (0.0, 0.0, 0.0)), (floor, aside), **changes)


# What a file says.


def test_whole_numbers_are_srgb_unless_the_file_or_the_scene_says_otherwise(tmp_path: Path):
    for suffix in (".png", ".jpg"):
        kept = png(tmp_path / f"flat{suffix}", np.full((8, 8, 3), 100, np.uint8))
        expected = colour.cctf_decoding(100 / 255, function="sRGB")
        np.testing.assert_allclose(textures.read_color(kept, None), expected, rtol=1e-6)
    path = png(tmp_path / "a.png")
    np.testing.assert_allclose(textures.read_color(path, None), SRGB, rtol=1e-6)
    np.testing.assert_allclose(textures.read_color(path, "linear"), SHARES, rtol=1e-6)
    openexr.write(tmp_path / "a.exr", SHARES.astype(np.float32))
    np.testing.assert_array_equal(textures.read_color(tmp_path / "a.exr", None), SHARES.astype(np.float32))
    np.testing.assert_allclose(textures.read_color(tmp_path / "a.exr", "sRGB"), SRGB, rtol=1e-5)
    np.testing.assert_array_equal(
        scene_of(tmp_path, '{ file = "a.png", encoding = "linear" }').objects[0].material.color.texels,  # type: ignore[union-attr]
        SHARES.astype(np.float32),
    )  # type: ignore[union-attr]


def test_a_gamma_of_png_is_heeded(tmp_path: Path):
    """1 is linear, 1 / 2.2 is what programs write for sRGB; of another one only the scene can say what it means."""

    def of_gamma(gamma: int) -> Path:
        chunks = PIL.PngImagePlugin.PngInfo()
        chunks.add(b"gAMA", gamma.to_bytes(4, "big"))
        return png(tmp_path / f"{gamma}.png", pnginfo=chunks)

    np.testing.assert_allclose(textures.read_color(of_gamma(100_000), None), SHARES, rtol=1e-6)
    np.testing.assert_allclose(textures.read_color(of_gamma(45_455), None), SRGB, rtol=1e-6)
    with pytest.raises(ValueError, match=r"its gamma is 0.5: allowed is to say the encoding"):
        textures.read_color(of_gamma(50_000), None)
    np.testing.assert_allclose(textures.read_color(of_gamma(50_000), "sRGB"), SRGB, rtol=1e-6)


def chunked(path: Path, *chunks: tuple[bytes, bytes], values: np.ndarray = BYTES) -> Path:
    """A PNG with chunks before its pixels."""
    said = PIL.PngImagePlugin.PngInfo()
    for name, data in chunks:
        said.add(name, data)
    return png(path, values, pnginfo=said)


def primaries(name: str) -> tuple[bytes, bytes]:
    """The chunk cHRM of a colour space: white, red, green, blue."""
    space = colour.RGB_COLOURSPACES[name]
    numbers = [*space.whitepoint, *np.ravel(space.primaries)]
    return b"cHRM", struct.pack(">8I", *(round(1e5 * each) for each in numbers))


MUTED = np.random.default_rng(2).integers(110, 150, (3, 5, 3), dtype=np.uint8)
"""Colours that no primaries take out of Rec. 709."""


@pytest.mark.parametrize(
    ("space", "code_points", "linear"),
    [("Display P3", (12, 13), False), ("ITU-R BT.2020", (9, 13), False), ("ITU-R BT.2020", (9, 8), True)],
)
def test_other_primaries_are_converted(space: str, code_points: tuple[int, int], linear: bool, tmp_path: Path):
    """Those of the chunks cHRM and cICP, as colour-science converts them; a chunk sRGB stands above the former."""
    shares = MUTED / 255.0
    decoded = shares if linear else colour.cctf_decoding(shares, function="sRGB")
    matrix = colour.matrix_RGB_to_RGB(
        colour.RGB_COLOURSPACES[space], colour.RGB_COLOURSPACES["sRGB"], chromatic_adaptation_transform=None
    )
    expected = decoded @ matrix.T
    assert np.abs(expected - decoded).max() > 0.01
    gamma = b"gAMA", struct.pack(">I", 100_000 if linear else 45_455)
    coded = b"cICP", bytes([*code_points, 0, 1])
    for name, chunks in (("told", [gamma, primaries(space)]), ("coded", [primaries("ACEScg"), coded])):
        path = chunked(tmp_path / f"{name}.png", *chunks, values=MUTED)
        np.testing.assert_allclose(textures.read_color(path, None), expected, atol=2e-4, err_msg=name)
        np.testing.assert_allclose(  # the scene has the last word
            textures.read_color(path, "sRGB"), colour.cctf_decoding(shares, function="sRGB"), rtol=1e-6
        )
    path = chunked(tmp_path / "srgb.png", primaries(space), (b"sRGB", b"\0"))
    np.testing.assert_allclose(textures.read_color(path, None), SRGB, rtol=1e-6)


def profile(change: dict[bytes, bytes] | None = None) -> bytes:
    """An sRGB profile, the numbers of some tags changed, its name as it was."""
    data = bytearray(PIL.ImageCms.ImageCmsProfile(PIL.ImageCms.createProfile("sRGB")).tobytes())
    for tag, numbers in (change or {}).items():
        at = data.index(tag)  # its first place is in the table of tags
        (offset,) = struct.unpack_from(">I", data, at + 4)
        data[offset + 8 : offset + 8 + len(numbers)] = numbers
    return bytes(data)


def turned(number: int) -> PIL.Image.Exif:
    said = PIL.Image.Exif()
    said[PIL.ExifTags.Base.Orientation] = number
    return said


def adobe() -> PIL.Image.Exif:
    said = PIL.Image.Exif()
    said.get_ifd(PIL.ExifTags.IFD.Exif)[PIL.ExifTags.IFD.Interop] = {1: "R03"}
    return said


def test_a_profile_is_known_by_its_numbers(tmp_path: Path):
    """A linear one, or one with another red, that calls itself sRGB is another."""
    np.testing.assert_allclose(
        textures.read_color(png(tmp_path / "a.png", icc_profile=profile()), None), SRGB, rtol=1e-6
    )
    grey = png(tmp_path / "grey.png", BYTES[..., 0], icc_profile=profile())
    np.testing.assert_allclose(textures.read_color(grey, None)[..., 1], SRGB[..., 0], rtol=1e-6)
    linear = struct.pack(">HHi", 0, 0, 65536)  # a curve of the kind 0, a power of 1
    wrong = {
        "linear": profile(dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), linear)),
        "red": profile({b"rXYZ": struct.pack(">3i", *(round(65536 * each) for each in (0.5151, 0.2412, -0.0011)))}),
    }
    for name, data in wrong.items():
        for suffix in (".png", ".jpg"):
            with pytest.raises(ValueError, match="is of the profile 'sRGB built-in': allowed is sRGB, or to say"):
                textures.read_color(png(tmp_path / f"{name}{suffix}", icc_profile=data), None)
    with pytest.raises(ValueError, match="has a profile that cannot be read"):
        textures.read_color(png(tmp_path / "bad.png", icc_profile=b"none of it"), None)
    np.testing.assert_allclose(textures.read_color(tmp_path / "bad.png", "sRGB"), SRGB, rtol=1e-6)
    with pytest.raises(ValueError, match="is of Adobe RGB, by its EXIF"):
        textures.read_color(png(tmp_path / "adobe.jpg", exif=adobe()), None)


@pytest.mark.parametrize(
    ("chunk", "message"),
    [
        ((b"cICP", bytes([9, 16, 0, 1])), "says cICP 9-16-0-1: allowed is a transfer"),  # PQ
        ((b"cICP", bytes([1, 1, 0, 1])), "says cICP 1-1-0-1: allowed is a transfer"),  # that of cameras
        ((b"cICP", bytes([3, 13, 0, 1])), "says cICP 3-13-0-1: .* of primaries"),
        ((b"cICP", bytes([1, 13, 1, 1])), "says cICP 1-13-1-1: allowed are four numbers, the last two 0 and 1"),
        ((b"cICP", bytes([1, 13, 0, 0])), "says cICP 1-13-0-0: allowed are four numbers"),
        ((b"cICP", bytes([11, 13, 0, 1])), "another white than Rec. 709"),
        (primaries("ACEScg"), "another white than Rec. 709"),
    ],
)
def test_colours_that_have_no_one_meaning_are_refused(chunk: tuple[bytes, bytes], message: str, tmp_path: Path):
    path = chunked(tmp_path / "a.png", chunk)
    with pytest.raises(ValueError, match=message):
        textures.read_color(path, None)
    np.testing.assert_allclose(textures.read_color(path, "sRGB"), SRGB, rtol=1e-6)
    np.testing.assert_allclose(textures.read_number(path, None, "G"), SHARES[..., 1], rtol=1e-6)  # no colour


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_a_picture_that_is_stored_turned_is_refused(suffix: str, tmp_path: Path):
    upright = png(tmp_path / f"upright{suffix}", exif=turned(1))
    assert textures.read_color(upright, None).shape == (3, 5, 3)
    on_its_side = png(tmp_path / f"side{suffix}", exif=turned(6))
    for read in (
        lambda: textures.read_color(on_its_side, None),
        lambda: textures.read_number(on_its_side, "linear", "R"),
        lambda: textures.read_within(on_its_side.read_bytes(), "sRGB"),
    ):
        with pytest.raises(ValueError, match="is stored turned .EXIF: orientation 6.* write it upright"):
            read()
    damaged = io.BytesIO()
    PIL.Image.fromarray(BYTES).save(damaged, "jpeg", exif=b"Exif\0\0none of it")
    assert textures.read_within(damaged.getvalue(), "sRGB").shape == (3, 5, 3)


def test_grey_palettes_and_sixteen_bits(tmp_path: Path):
    """All of what a PNG can be is itself, or is refused: Pillow would cut colours of 16 bits to 8."""
    grey = np.arange(12, dtype=np.uint16).reshape(3, 4) * 5000
    path = png(tmp_path / "wide.png", grey)
    np.testing.assert_allclose(textures.read_color(path, "linear")[..., 1], grey / 65535, rtol=1e-6)
    PIL.Image.fromarray(BYTES).quantize(16).save(tmp_path / "palette.png")
    np.testing.assert_allclose(
        textures.read_color(tmp_path / "palette.png", "linear") * 255,
        np.asarray(PIL.Image.open(tmp_path / "palette.png").convert("RGB")),
        rtol=1e-6,
    )
    header = (2).to_bytes(4, "big") * 2 + bytes([16, 2, 0, 0, 0])  # 2 x 2, 16 bits, RGB
    chunks = (b"IHDR", header), (b"IDAT", zlib.compress(2 * bytes(13))), (b"IEND", b"")
    deep = [
        len(data).to_bytes(4, "big") + kind + data + zlib.crc32(kind + data).to_bytes(4, "big") for kind, data in chunks
    ]
    (tmp_path / "deep.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(deep))
    PIL.Image.new("RGBA", (2, 2), (9, 9, 9, 100)).save(tmp_path / "clear.png")
    PIL.Image.new("CMYK", (2, 2)).save(tmp_path / "ink.jpg")
    for file, reason in (("deep.png", "16 bits"), ("clear.png", "transparent texels"), ("ink.jpg", "holds CMYK")):
        with pytest.raises(ValueError, match=reason):
            textures.read_color(tmp_path / file, None)
    PIL.Image.new("RGBA", (2, 2), (255, 255, 255, 255)).save(tmp_path / "solid.png")
    assert (textures.read_color(tmp_path / "solid.png", None) == 1.0).all()


def test_a_number_is_grey_or_one_channel(tmp_path: Path):
    """And linear, unless the scene says that it is not: 255 is 1."""
    png(tmp_path / "a.png")
    png(tmp_path / "grey.png", BYTES[..., 0])
    more = 'gloss = { file = "grey.png" }\nroughness = { file = "a.png", channel = "G", wrap = "clamp" }\n'
    found = scene_of(tmp_path, "[0.5, 0.5, 0.5]", more=more).objects[0].material
    np.testing.assert_allclose(found.gloss.texels[..., 0], SHARES[..., 0], rtol=1e-6)  # type: ignore[union-attr]
    np.testing.assert_allclose(found.roughness.texels[..., 0], SHARES[..., 1], rtol=1e-6)  # type: ignore[union-attr]
    assert found.roughness.wrap == "clamp"  # type: ignore[union-attr]
    np.testing.assert_allclose(textures.read_number(tmp_path / "a.png", None, "B"), SHARES[..., 2], rtol=1e-6)
    np.testing.assert_allclose(textures.read_number(tmp_path / "a.png", "sRGB", "R"), SRGB[..., 0], rtol=1e-6)


@pytest.mark.parametrize(
    ("color", "message"),
    [
        ('{ file = "none.png" }', r"objects: 'floor': color = 'none.png': no such file in "),
        ('{ file = "cut.png" }', r"objects: 'floor': color = 'cut.png': cannot be read: image file is truncated"),
        ('{ file = "scene.toml" }', r"color = 'scene.toml': is no image of a kind .* allowed are PNG, JPEG, OpenEXR"),
        (
            '{ file = "nan.npy" }',
            r"color = 'nan.npy': texel \[0.5, nan, 0.5\] in row 1, column 0: allowed is a number in",
        ),
        ('{ file = "bright.npy" }', r"color = 'bright.npy': texel \[1.5, .* in row 0, column 1: .* \[0, 1\]"),
        ('{ file = "two.npy" }', r"color = 'two.npy': shape \(2, 2, 2\): allowed are"),
        ('{ file = "a.png", wrap = "mirror" }', r"objects\[0\].color.wrap = 'mirror': allowed is 'repeat' or 'clamp'"),
        ('{ file = "a.png", encoding = "gamma" }', r"color.encoding = 'gamma': allowed is 'sRGB' or 'linear'"),
        (
            '{ image = "a.png" }',
            r"objects\[0\].color.image = 'a.png': unknown key: allowed are channel, encoding, file",
        ),
        ('{ file = "a.png", channel = "R" }', r"color = 'a.png': channel = 'R': allowed is none, for a colour has all"),
        (
            '[0, 0, 0]\ngloss = { file = "a.png" }',
            r"gloss = 'a.png': holds colours: allowed is a grey image, or a chan",
        ),
        (
            '[0, 0, 0]\ngloss = "a.png"',
            r"objects\[0\].gloss = 'a.png': allowed is a number, or a table with the file of",
        ),
        (
            '[0, 0, 0]\nroughness = { file = "k.npy" }',
            r"roughness = 'k.npy': texel \[0.0\] in row 0, .* \[0.0001, 1.5\]",
        ),
        ('"a.png"', r"objects\[0\].color = 'a.png': allowed is a list of 3, or a table with the file of an"),
        ('{ file = "a.png", scale = 2.0 }', r"color = 'a.png': scale = 2.0: allowed is none, but of emission"),
        ('[0, 0, 0]\nemission = { file = "a.png", scale = -1.0 }', r"emission: scale = -1.0: allowed is a number in"),
        (
            '[0, 0, 0]\nemission = { file = "a.png", channel = "R" }',
            r"emission = 'a.png': channel = 'R': allowed is none",
        ),
        (
            '[0, 0, 0]\nemission = { file = "nan.npy" }',
            r"emission = 'nan.npy': texel \[0.5, nan, 0.5\] in row 1, column 0: allowed is a number in \[0, inf\)",
        ),
        (
            '[0, 0, 0]\nemission = { file = "bright.npy", scale = 1e39 }',
            r"emission = 'bright.npy': texel \[inf, .* in row 0, column 0: allowed is a number in \[0, inf\)",
        ),
        ("[0, 0, 0]\nemission = [1.0, -1.0, 1.0]", r"emission = \(1.0, -1.0, 1.0\): allowed is a number in \[0, inf\)"),
        ('[0, 0, 0]\nemission = "a.png"', r"objects\[0\].emission = 'a.png': allowed is a list of 3, or a table"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path: Path, color: str, message: str):
    png(tmp_path / "a.png")
    (tmp_path / "cut.png").write_bytes((tmp_path / "a.png").read_bytes()[:60])
    values = np.full((2, 2, 3), 0.5, np.float32)
    np.save(tmp_path / "two.npy", values[..., :2])
    np.save(tmp_path / "k.npy", np.zeros((2, 2), np.float32))
    values[0, 1, 0] = 1.5
    np.save(tmp_path / "bright.npy", values)
    values[0, 1, 0], values[1, 0, 1] = 0.5, np.nan
    np.save(tmp_path / "nan.npy", values)
    with pytest.raises(FileError, match=message) as found:
        scene_of(tmp_path, color)
    assert "\n" not in str(found.value)


@pytest.mark.parametrize("shape", ["box", "sphere"])
def test_a_shape_without_uv_is_refused(tmp_path: Path, shape: str):
    png(tmp_path / "a.png")
    with pytest.raises(
        FileError, match=r"objects: 'floor': color: is an image, and nothing says .* allowed are a rect"
    ):
        scene_of(tmp_path, '{ file = "a.png" }', PLACES[shape])


def test_textures_are_checked_where_they_are_made():
    for wrong, message in ((np.zeros((2, 2, 2)), r"shape \(2, 2, 2\)"), (np.zeros((0, 2, 3)), "shape"), (1.0, "shape")):
        with pytest.raises(ValueError, match=message):
            Texture(wrong)
    with pytest.raises(ValueError, match="wrap = 'mirror': allowed are 'repeat' and 'clamp'"):
        Texture(SHARES, "mirror")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="color = .*: allowed is a texture of 3 channels"):
        Material(color=Texture(SHARES[..., 0]))
    square = textured().objects[0]
    for uv, message in ((np.zeros((3, 2)), r"uv \(3, 2\)"), (np.full((4, 2), np.inf), "uv of corner 0 of face 0")):
        with pytest.raises(ValueError, match=message):
            Mesh.from_arrays(square.mesh.vertices, square.mesh.faces, uv=uv)
    with pytest.raises(ValueError, match="'floor': color: is an image, and nothing says"):
        attrs.evolve(square, mesh=attrs.evolve(square.mesh, uv=None))
    assert Object("lamp", attrs.evolve(square.mesh, uv=None), square.material, (1.0, 1.0, 1.0)).emits  # black, whatever


def test_the_smallest_and_the_largest_of_an_image_bound_it():
    """Has the term means any texel has: a term is absent only where all texels are black."""
    texels = np.zeros((4, 4, 3), np.float32)
    scene = textured(texels)
    assert not TABLE["direct"].has(scene, scene.objects[0].surface)
    texels[3, 1] = 0.0, 0.25, 0.0
    scene = textured(texels)
    assert largest(scene.objects[0].material.color) == (0.0, 0.25, 0.0)
    assert scene.diffuse_weight(scene.objects[0].surface) == (0.0, 0.25, 0.0)
    assert TABLE["direct"].has(scene, scene.objects[0].surface)


def test_the_plan_names_images_where_they_are_read():
    scene = textured(lights=load("monkey").lights, ambient=Ambient((1.0, 1.0, 1.0)), draw_lights=True)
    variants = {term: VARIANTS[term][name] for term, name in DEFAULTS.items()}
    told = {step.term: step.reason for step in plan(scene, variants) if step.work == "images of surfaces"}
    assert told == dict.fromkeys(("ambient", "direct"), "color of floor (5 x 3); bilinear")


# Lamps.


def lamp(**changes: Any) -> Object:
    """The square of `textured`, above it, that shines by an image."""
    square = textured().objects[0]
    above = Mesh.from_arrays(square.mesh.vertices + (0.0, 0.0, 1.0), square.mesh.faces, uv=square.mesh.uv)
    return attrs.evolve(Object("lamp", above, emission=Texture(10.0 * SRGB, "clamp")), **changes)


def test_an_emission_may_be_an_image(tmp_path: Path):
    """`scale` times its linear values; as an image of no light it is no lamp, and the material is seen."""
    png(tmp_path / "a.png")
    thing = scene_of(tmp_path, '[0, 0, 0]\nemission = { file = "a.png", scale = 12.5, wrap = "clamp" }').objects[0]
    assert isinstance(thing.emission, Texture)
    np.testing.assert_allclose(thing.emission.texels, 12.5 * SRGB, rtol=1e-6)
    assert thing.emission.wrap == "clamp"
    assert thing.emits
    assert thing.mesh.uv is not None
    png(tmp_path / "black.png", np.zeros((2, 2, 3), np.uint8))
    dark = scene_of(tmp_path, '[0.5, 0.5, 0.5]\nemission = { file = "black.png" }')
    assert not dark.objects[0].emits
    assert dark.objects[0].surface.color == (0.5, 0.5, 0.5)
    assert TABLE["direct"].absent(dark) == "the scene has no light"
    with pytest.raises(FileError, match=r"objects: 'floor': emission: is an image, and nothing says how it lies"):
        scene_of(tmp_path, '[0, 0, 0]\nemission = { file = "a.png" }', PLACES["sphere"])


def test_the_chances_of_a_lamp_are_above_0_wherever_it_may_shine():
    """One bright texel, which no point that is looked at lies in; half of a lamp of two triangles is counted so."""
    texels = np.zeros((512, 512, 3), np.float32)
    texels[100, 37] = 1e-30, 0.0, 0.0
    assert (lamp(emission=Texture(texels)).radiances()[:, 0] > 0.0).all()
    half = np.zeros((2, 2, 3), np.float32)
    half[0] = 8.0  # the upper triangle's: three quarters of it lie there
    np.testing.assert_allclose(lamp(emission=Texture(half, "clamp")).radiances(), [[3.0] * 3, [5.0] * 3])
    assert lamp(emission=Texture(half, "clamp")).mean_radiance() == (4.0, 4.0, 4.0)
    assert lamp(emission=(0.1, 0.2, 0.3)).mean_radiance() == (0.1, 0.2, 0.3)


def test_keys_plan_and_files_know_the_image_of_a_lamp(tmp_path: Path):
    """Ambient light reads nothing of it but that there is a lamp, and the background where lights are drawn alone."""
    scene = textured(ambient=Ambient((1.0, 1.0, 1.0)))
    floor = scene.objects[0]

    def of(thing: Object, **changes: Any) -> Scene:
        return attrs.evolve(scene, objects=(floor, thing), **changes)

    def keys(each: Scene) -> dict[str, str]:
        return {term: cells.content(each, VARIANTS[term][name], chain="next-event") for term, name in DEFAULTS.items()}

    texels = 10.0 * SRGB
    texels[0, 0, 0] += 1.0
    for drawn in (False, True):
        before = keys(of(lamp(), draw_lights=drawn))
        assert before == keys(of(lamp(emission=Texture(10.0 * SRGB, "clamp")), draw_lights=drawn))
        for other in (Texture(texels, "clamp"), Texture(10.0 * SRGB)):
            after = keys(of(lamp(emission=other), draw_lights=drawn))
            changed = {term for term in before if before[term] != after[term]}
            assert changed == {"direct", "specular"} | ({"background"} if drawn else set())
    variants = {term: VARIANTS[term][name] for term, name in DEFAULTS.items()}
    told = {
        step.term: step.reason
        for step in plan(of(lamp(), draw_lights=True), variants)
        if step.work == "images of surfaces"
    }
    of_floor, of_lamp = "color of floor (5 x 3)", "emission of lamp (5 x 3)"
    assert told == {
        "ambient": f"{of_floor}; bilinear",
        "direct": f"{of_floor}, {of_lamp}; bilinear",
        "background": f"{of_lamp}; bilinear",
    }
    shown = of(lamp(material=floor.material))
    save(shown, tmp_path / "kept.toml")
    assert load(tmp_path / "kept.toml").objects[1].emission == shown.objects[1].emission
    path = neutral.write_neutral(shown, tmp_path)
    described = json.loads(path.read_text())
    jsonschema.validate(described, json.loads(neutral.SCHEMA.read_text()))
    assert described["version"] == 2
    emission = described["objects"][1]["emission"]
    assert emission["wrap"] == "clamp"
    np.testing.assert_array_equal(openexr.read(tmp_path / emission["image"], None)[0].pixels, np.float32(10.0 * SRGB))
    np.testing.assert_array_equal(described["objects"][1]["uv"], shown.objects[1].mesh.uv)
    alone = attrs.evolve(scene, objects=(lamp(),))
    for module in (gltf, obj, pbrt):
        with pytest.raises(ValueError, match="objects: 'lamp': emission: is an image, and .* is written without"):
            module.write(alone, tmp_path / f"squares{module.SUFFIX}")
    assert asked.total(alone).absent == "it has images on its surfaces, which engines are not asked for"


# Meshes.

SQUARE = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], float)
LIES = np.array([(0.25, 0.125), (1.5, 0.25), (1.0, 0.875), (0.0, 0.75)])


def write_obj(path: Path, lines: str = "f 1/1 2/2 3/3 4/4\n") -> None:
    rows = [f"v {x} {y} {z}\n" for x, y, z in SQUARE] + [f"vt {u} {v}\n" for u, v in LIES]
    path.write_text("".join(rows) + lines)


def write_ply(path: Path, names: tuple[str, str]) -> None:
    head = "ply\nformat ascii 1.0\nelement vertex 4\n" + "".join(
        f"property float {n}\n" for n in ("x", "y", "z", *names)
    )
    rows = "".join(" ".join(map(str, row)) + "\n" for row in np.hstack([SQUARE, LIES]))
    path.write_text(f"{head}element face 1\nproperty list uchar int vertex_indices\nend_header\n{rows}4 0 1 2 3\n")


def write_texcoord(path: Path) -> None:
    head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    head += "element face 1\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\nend_header\n"
    rows = "".join(" ".join(map(str, row)) + "\n" for row in SQUARE)
    path.write_text(f"{head}{rows}4 0 1 2 3 8 {' '.join(map(str, LIES.ravel()))}\n")


def write_glb(path: Path, *, mapped: bool = True, **more: Any) -> None:
    """By hand: glTF's v goes down. `more` is of the description; a material, where there are any, is the first."""
    points, places = SQUARE.astype("<f4").tobytes(), (LIES * (1, -1) + (0, 1)).astype("<f4").tobytes()
    indices = np.array([0, 1, 2, 0, 2, 3], "<u4").tobytes()
    data = points + places + indices
    ends = np.cumsum([0, len(points), len(places), len(indices)]).tolist()
    views = [{"buffer": 0, "byteOffset": a, "byteLength": b - a} for a, b in zip(ends[:-1], ends[1:], strict=True)]
    kinds = [(5126, 4, "VEC3"), (5126, 4, "VEC2"), (5125, 6, "SCALAR")]
    accessors = [{"bufferView": i, "componentType": c, "count": n, "type": t} for i, (c, n, t) in enumerate(kinds)]
    attributes = {"POSITION": 0} | ({"TEXCOORD_0": 1} if mapped else {})
    described = {
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0}],
        "meshes": [
            {
                "primitives": [
                    {"attributes": attributes, "indices": 2} | ({"material": 0} if "materials" in more else {})
                ]
            }
        ],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(data)}],
        **more,
    }
    text = json.dumps(described).encode()
    text += b" " * (-len(text) % 4)
    chunks = b"".join(len(c).to_bytes(4, "little") + k + c for k, c in ((b"JSON", text), (b"BIN\0", data)))
    path.write_bytes(b"glTF" + (2).to_bytes(4, "little") + (12 + len(chunks)).to_bytes(4, "little") + chunks)


WRITERS = {
    "a.obj": write_obj,
    "a.glb": write_glb,
    "uv.ply": lambda path: write_ply(path, ("u", "v")),
    "st.ply": lambda path: write_ply(path, ("s", "t")),
    "texture.ply": lambda path: write_ply(path, ("texture_u", "texture_v")),
    "texcoord.ply": write_texcoord,
}


@pytest.mark.parametrize("name", WRITERS)
def test_one_quad_lies_alike_whatever_file_holds_it(tmp_path: Path, name: str):
    path = tmp_path / name
    WRITERS[name](path)
    vertices, faces, uv = meshes.read_mapped(path)
    assert uv is not None
    plain = meshes.read(path)
    np.testing.assert_array_equal(plain[1], faces)
    for point, place in zip(vertices[faces].reshape(-1, 3), uv.reshape(-1, 2), strict=True):
        np.testing.assert_allclose(place, LIES[(point == SQUARE).all(axis=1).argmax()], atol=1e-7)
    png(tmp_path / "a.png")
    found = scene_of(tmp_path, '{ file = "a.png" }', f'shape = "mesh"\nfile = "{name}"\n').objects[0].mesh.uv
    np.testing.assert_allclose(np.asarray(found), uv, atol=1e-7)


def test_uv_that_is_not_there_or_not_whole(tmp_path: Path):
    """Without an image nothing of it is read, as before; with one, some corners without a place are refused."""
    write_obj(tmp_path / "some.obj", "f 1/1 2/2 3/3\nf 1 3 4\n")
    write_obj(tmp_path / "none.obj", "f 1 2 3\n")
    write_obj(tmp_path / "wild.obj", "f 1/1 2/2 3/9\n")
    write_glb(tmp_path / "none.glb", mapped=False)
    for name in ("some.obj", "wild.obj", "none.glb", "none.obj"):
        assert len(meshes.read(tmp_path / name)[1])
    assert meshes.read_mapped(tmp_path / "none.obj")[2] is None
    assert meshes.read_mapped(tmp_path / "none.glb")[2] is None
    with pytest.raises(meshes.MeshError, match="corners without vt beside others"):
        meshes.read_mapped(tmp_path / "some.obj")
    with pytest.raises(meshes.MeshError, match="line 9: index 9: allowed are 1 to 4"):
        meshes.read_mapped(tmp_path / "wild.obj")


def test_a_concave_polygon_keeps_the_places_of_its_corners(tmp_path: Path):
    """Ears are cut in another order than the corners'; u and v are those of x and y throughout."""
    outline = [(0, 0), (4, 0), (4, 3), (2, 1), (0, 3)]
    rows = "".join(f"v {x} {y} 0\nvt {x / 4} {y / 4}\n" for x, y in outline)
    (tmp_path / "a.obj").write_text(rows + "f 1/1 2/2 3/3 4/4 5/5\n")
    vertices, faces, uv = meshes.read_mapped(tmp_path / "a.obj")
    assert uv is not None
    assert len(faces) == 3
    np.testing.assert_allclose(uv, vertices[faces][..., :2] / 4)


def test_a_scene_of_obj_has_its_images(tmp_path: Path):
    """`map_Kd` times `Kd`; where it says more than a file, or corners lie nowhere, a mean may stand for it."""
    png(tmp_path / "a.png")
    library = "newmtl tiles\nKd 0.5 1 1\nmap_Kd a.png\n"
    (tmp_path / "a.mtl").write_text(library)
    for name, faces in (("mapped.obj", "f 1/1 2/2 3/3 4/4\n"), ("bare.obj", "f 1 2 3 4\n")):
        write_obj(tmp_path / name, f"mtllib a.mtl\nusemtl tiles\n{faces}")
    found = load(tmp_path / "mapped.obj").objects[0]
    assert isinstance(found.material.color, Texture)
    np.testing.assert_allclose(found.material.color.texels, SRGB * (0.5, 1.0, 1.0), rtol=1e-6)
    np.testing.assert_allclose(np.asarray(found.mesh.uv), LIES[found.mesh.faces])
    with pytest.raises(FileError, match="material 'tiles': map_Kd without vt at all corners: .* takes its mean"):
        load(tmp_path / "bare.obj")
    mean = load(tmp_path / "bare.obj", approximate=True).objects[0].material.color
    assert mean == pytest.approx(SRGB.mean(axis=(0, 1)) * (0.5, 1.0, 1.0), rel=1e-6)
    (tmp_path / "a.mtl").write_text(library.replace("map_Kd", "map_Kd -s 2 2 1"))
    with pytest.raises(FileError, match="material 'tiles': map_Kd with options: .* takes its mean"):
        load(tmp_path / "mapped.obj")
    (tmp_path / "a.mtl").write_text(library.replace("a.png", "none.png"))
    with pytest.raises(FileError, match=r"none.png: cannot be read: No such file"):
        load(tmp_path / "mapped.obj")


def test_a_lamp_of_obj_has_its_image(tmp_path: Path):
    """`map_Ke` times `Ke`, or alone; a lamp is black but for it."""
    png(tmp_path / "a.png")
    write_obj(tmp_path / "lamp.obj", "mtllib a.mtl\nusemtl screen\nf 1/1 2/2 3/3 4/4\n")
    for given, factor in (("Ke 4 2 1\n", (4.0, 2.0, 1.0)), ("", (1.0, 1.0, 1.0))):
        (tmp_path / "a.mtl").write_text(f"newmtl screen\nKd 0 0 0\n{given}map_Ke a.png\n")
        thing = load(tmp_path / "lamp.obj").objects[0]
        assert isinstance(thing.emission, Texture)
        np.testing.assert_allclose(thing.emission.texels, SRGB * factor, rtol=1e-6)
        np.testing.assert_allclose(np.asarray(thing.mesh.uv), LIES[thing.mesh.faces])
    (tmp_path / "a.mtl").write_text("newmtl screen\nKd 0 0 0\nKe 0 0 0\nmap_Ke a.png\n")
    assert not load(tmp_path / "lamp.obj").objects[0].emits
    (tmp_path / "a.mtl").write_text("newmtl screen\nKd 0 0 0\nmap_Ke -s 2 2 1 a.png\n")
    with pytest.raises(FileError, match="material 'screen': map_Ke with options: .* takes its mean"):
        load(tmp_path / "lamp.obj")
    found = load(tmp_path / "lamp.obj", approximate=True).objects[0].emission
    assert found == pytest.approx(SRGB.mean(axis=(0, 1)), rel=1e-6)


LAMBERT = {"KHR_materials_specular": {"specularFactor": 0.0}}


def material_of(path: Path, *, approximate: bool = False, sampler: dict[str, int] | None = None, **said: Any) -> Object:
    """What a GLB of the quad says of it, its images a.png; `said` is of the material, pbr of its first part."""
    pbr = {"metallicFactor": 0.0, **said.pop("pbr", {})}
    material = {"name": "tiles", "doubleSided": True, "extensions": LAMBERT, "pbrMetallicRoughness": pbr, **said}
    texture = {"source": 0} | ({} if sampler is None else {"sampler": 0})
    write_glb(path, images=[{"uri": "a.png"}], textures=[texture], materials=[material], samplers=[sampler or {}])
    return load(path, approximate=approximate).objects[0]


IMAGE = {"index": 0}
BASE = {"baseColorFactor": [0.5, 1.0, 1.0, 1.0], "baseColorTexture": IMAGE}


def test_a_scene_of_glb_has_its_images(tmp_path: Path):
    """sRGB whatever its file says, times the factor, as its sampler goes on; alpha of an opaque material is no part."""
    chunks = PIL.PngImagePlugin.PngInfo()
    chunks.add(b"gAMA", (100_000).to_bytes(4, "big"))
    alpha = np.full((*BYTES.shape[:2], 1), 7, np.uint8)
    png(tmp_path / "a.png", np.concatenate([BYTES, alpha], axis=2), pnginfo=chunks)
    for sampler, wrap in ((None, "repeat"), ({"wrapS": 33071, "wrapT": 33071}, "clamp"), ({}, "repeat")):
        found = material_of(tmp_path / "a.glb", sampler=sampler, pbr=BASE)
        color = found.material.color
        assert isinstance(color, Texture)
        np.testing.assert_allclose(color.texels, SRGB * (0.5, 1.0, 1.0), rtol=1e-6)
        assert color.wrap == wrap
        assert found.material.gloss == 0.0
        # y of the file is up: (x, y, z) is at (x, -z, y).
        corners, places = found.mesh.vertices[found.mesh.faces].reshape(-1, 3), np.asarray(found.mesh.uv).reshape(-1, 2)
        for point, place in zip(corners, places, strict=True):
            quad = (point[[0, 2]] == SQUARE[:, :2]).all(axis=1).argmax()
            np.testing.assert_allclose(place, LIES[quad], atol=1e-7)
    shifted = IMAGE | {"extensions": {"KHR_texture_transform": {"offset": [0.25, 0.5], "scale": [2.0, 0.5]}}}
    moved = material_of(tmp_path / "a.glb", pbr={"baseColorTexture": shifted}).mesh
    plain = material_of(tmp_path / "a.glb", pbr=BASE).mesh
    down = 1.0 - np.asarray(plain.uv)[..., 1]
    np.testing.assert_allclose(np.asarray(moved.uv)[..., 0], 2.0 * np.asarray(plain.uv)[..., 0] + 0.25, atol=1e-6)
    np.testing.assert_allclose(1.0 - np.asarray(moved.uv)[..., 1], 0.5 * down + 0.5, atol=1e-6)


def test_a_lamp_of_glb_has_its_image(tmp_path: Path):
    png(tmp_path / "a.png")
    said = {"emissiveFactor": [1.0, 0.5, 0.25], "emissiveTexture": IMAGE, "doubleSided": False}
    strength = {"KHR_materials_emissive_strength": {"emissiveStrength": 8.0}}
    black = {"baseColorFactor": [0.0, 0.0, 0.0, 1.0]}
    found = material_of(tmp_path / "a.glb", extensions=LAMBERT | strength, pbr=black, **said)
    assert isinstance(found.emission, Texture)
    np.testing.assert_allclose(found.emission.texels, SRGB * (8.0, 4.0, 2.0), rtol=1e-6)
    assert found.mesh.uv is not None


def test_roughness_of_glb_is_its_green_squared(tmp_path: Path):
    """Linear; the metallic share, blue, has to be one number, or its mean is taken and named."""
    png(tmp_path / "a.png")
    pbr = {"baseColorFactor": [0.5, 0.5, 0.5, 1.0], "metallicRoughnessTexture": IMAGE, "roughnessFactor": 0.5}
    found = material_of(tmp_path / "a.glb", approximate=True, extensions={}, pbr=pbr).material
    assert isinstance(found.roughness, Texture)
    np.testing.assert_allclose(found.roughness.texels[..., 0], np.maximum((0.5 * SHARES[..., 1]) ** 2, 0.01), rtol=1e-6)
    assert found.gloss == pytest.approx(0.04)
    metal = pbr | {"metallicFactor": 1.0}
    with pytest.raises(FileError, match="metallicRoughnessTexture, whose metallic part is an image: .* takes its mean"):
        material_of(tmp_path / "a.glb", extensions={}, pbr=metal)
    mean = float(SHARES[..., 2].mean())
    found = material_of(tmp_path / "a.glb", approximate=True, extensions={}, pbr=metal).material
    assert found.gloss == pytest.approx(mean + (1.0 - mean) * 0.04)


@pytest.mark.parametrize(
    ("info", "sampler", "message"),
    [
        ({"texCoord": 1}, None, "baseColorTexture without a TEXCOORD of its number"),
        ({"extensions": {"KHR_texture_transform": {"rotation": 0.1}}}, None, "baseColorTexture that is turned"),
        ({}, {"wrapS": 33648, "wrapT": 33648}, "baseColorTexture that is mirrored, or goes on otherwise along u"),
        ({}, {"wrapS": 33071}, "baseColorTexture that is mirrored, or goes on otherwise along u"),
        ({}, {"magFilter": 9728}, "baseColorTexture that is not interpolated"),
    ],
)
def test_what_no_image_of_ours_is_is_named(tmp_path: Path, info: Any, sampler: Any, message: str):
    """The mean stands for it where that is allowed, and is told."""
    png(tmp_path / "a.png")
    pbr = {"baseColorTexture": IMAGE | info}
    with pytest.raises(FileError, match=f"material 'tiles': {message}.*: --approximate takes its mean"):
        material_of(tmp_path / "a.glb", sampler=sampler, pbr=pbr)
    found = material_of(tmp_path / "a.glb", approximate=True, sampler=sampler, pbr=pbr)
    np.testing.assert_allclose(largest(found.material.color), SRGB.mean(axis=(0, 1)), rtol=1e-6)
    (tmp_path / "a.png").write_bytes(b"no image")
    with pytest.raises(FileError, match="baseColorTexture: an image that cannot be read .begins with b'no i': allowed"):
        material_of(tmp_path / "a.glb", pbr=pbr)


# Faces in one plane.


def test_coincident_faces_of_one_image_count_once_where_it_lies_alike():
    scene = textured()
    floor = scene.objects[0]
    again = attrs.evolve(floor, name="again")
    assert [thing.name for thing in attrs.evolve(scene, objects=(floor, again)).objects] == ["floor"]
    assert floor.mesh.uv is not None
    moved = attrs.evolve(again, mesh=attrs.evolve(again.mesh, uv=floor.mesh.uv + 0.5))
    with pytest.raises(ValueError, match="'floor' and 'again' lie .* differ in where their image lies"):
        attrs.evolve(scene, objects=(floor, moved))
    other = attrs.evolve(again, material=Material(Texture(SHARES)))
    with pytest.raises(ValueError, match="differ in material"):
        attrs.evolve(scene, objects=(floor, other))


# Keys.


def test_keys_see_texels_and_places():
    """Another texel, wrap or uv is another image of each term that sees it; equal content is the same key."""
    scene = textured(lights=load("monkey").lights)
    floor = scene.objects[0]
    assert floor.mesh.uv is not None
    texels = np.array(SRGB)
    texels[1, 2, 0] = 1.0 - texels[1, 2, 0]
    others = (
        attrs.evolve(floor, material=Material(Texture(texels))),
        attrs.evolve(floor, material=Material(Texture(SRGB), Texture([[0.25, 0.0]]))),
        attrs.evolve(floor, material=Material(Texture(SRGB, "clamp"))),
        attrs.evolve(floor, mesh=attrs.evolve(floor.mesh, uv=floor.mesh.uv * 0.5)),
    )

    def keys(thing: Object) -> dict[str, str]:
        changed = attrs.evolve(scene, objects=(thing, scene.objects[1]))
        found = {
            term: cells.content(changed, VARIANTS[term][name], chain="next-event") for term, name in DEFAULTS.items()
        }
        return found | {"digest": changed.digest(), "loaded": reads.digest(changed, without=reads.UNREAD)}

    before, same = keys(floor), keys(attrs.evolve(floor, material=Material(Texture(SRGB.copy()))))
    assert before == same
    for other in others:
        after = keys(other)
        for name in ("ambient", "direct", "specular", "digest", "loaded"):
            assert after[name] != before[name]
    assert keys(others[0])["background"] == before["background"]


# Files that are written.


def test_a_saved_scene_has_its_images(tmp_path: Path):
    """The rectangle stays one, and a mesh keeps a place for each corner of a face, whatever its neighbours have."""
    scene = textured(resolution=(4, 4))
    floor = scene.objects[0]
    fan = Mesh.from_arrays(
        np.random.default_rng(2).normal(size=(5, 3)) + (0, 0, -3),
        [[0, 1, 2], [0, 2, 3], [0, 3, 4]],
        uv=np.random.default_rng(3).normal(size=(3, 3, 2)),
    )
    unread = attrs.evolve(scene.objects[1], mesh=attrs.evolve(scene.objects[1].mesh, uv=floor.mesh.uv))
    gloss, roughness = Texture(SHARES[..., 0]), Texture(0.1 + SHARES[:2, :2, 1], "clamp")
    things = (floor, unread, Object("fan", fan, Material(Texture(SHARES, "clamp"), gloss, roughness)))
    scene = attrs.evolve(scene, objects=things)
    save(scene, tmp_path / "kept.toml")
    found = load(tmp_path / "kept.toml")
    assert (tmp_path / "kept.toml").read_text().count('shape = "rectangle"') == 2
    assert [each.material for each in found.objects] == [each.material for each in scene.objects]
    np.testing.assert_array_equal(found.objects[2].mesh.uv, fan.uv)
    assert found.objects[1].mesh.uv is None  # nothing reads it


def test_exports_say_images_or_refuse_them(tmp_path: Path):
    scene = textured([[[0.25, 0.5, 1.0]]])  # of one texel
    floor, aside = scene.objects
    shown = Material(floor.material.color, Texture([[0.5, 0.25]]), Texture([[0.5, 0.25]], "clamp"))
    scene = attrs.evolve(scene, objects=(attrs.evolve(floor, material=shown), aside))
    path = neutral.write_neutral(scene, tmp_path)
    described = json.loads(path.read_text())
    jsonschema.validate(described, json.loads(neutral.SCHEMA.read_text()))
    assert described["version"] == 2
    color = described["objects"][0]["material"]["color"]
    np.testing.assert_array_equal(openexr.read(tmp_path / color["image"], None)[0].pixels, [[[0.25, 0.5, 1.0]]])
    np.testing.assert_array_equal(described["objects"][0]["uv"], scene.objects[0].mesh.uv)
    assert "uv" not in described["objects"][1]
    mitsuba.write(scene, tmp_path / "squares.xml")
    bitmaps = {each.get("name"): each for each in ElementTree.parse(tmp_path / "squares.xml").getroot().iter("texture")}
    assert {*bitmaps} == {"reflectance", "weight", "alpha"}
    values = {value.get("name"): value.get("value") for value in bitmaps["reflectance"]}
    assert values["raw"] == "true"
    assert values["wrap_mode"] == "repeat"
    assert openexr.read(tmp_path / str(values["filename"]), None)[0].pixels.shape == (2, 2, 3)
    for module in (gltf, obj, pbrt):
        with pytest.raises(ValueError, match="objects: 'floor': color: is an image, and .* is written without"):
            module.write(scene, tmp_path / f"squares{module.SUFFIX}")
    plain = attrs.evolve(scene, objects=scene.objects[1:])
    assert neutral.describe(plain)["version"] == 1
    assert asked.total(scene).absent == "it has images on its surfaces, which engines are not asked for"
