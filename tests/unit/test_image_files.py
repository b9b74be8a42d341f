"""Images of other programs come out as what was written, or are refused in a line: never as another image.

The writers are not ours: OpenEXR's library, Mitsuba's Bitmap, tifffile, NumPy; where they cannot write a kind of file,
it is put together from bytes as the format's description says.
"""

import io
import itertools
import struct
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import colour
import numpy as np
import OpenEXR
import pytest
import tifffile
from PIL import Image as Picture

from termwise.reference import backend
from termwise.reports.judging.files import index_image, mask_image
from termwise.scenes import images

HEIGHT, WIDTH = 20, 30
RNG = np.random.default_rng(1)
RGB = RNG.gamma(2.0, 0.5, (HEIGHT, WIDTH, 3)).astype(np.float32)
SCANLINES = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
REC709_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def write(path: Path, channels: dict[str, np.ndarray], **header: Any) -> Path:
    OpenEXR.File({**SCANLINES, **header}, {name: np.ascontiguousarray(at) for name, at in channels.items()}).write(
        str(path)
    )
    return path


def write_parts(path: Path, parts: dict[str, dict[str, np.ndarray]]) -> Path:
    OpenEXR.File([OpenEXR.Part(dict(SCANLINES), channels, name) for name, channels in parts.items()]).write(str(path))
    return path


def named(pattern: str, letters: str = "RGB", rgb: np.ndarray = RGB) -> dict[str, np.ndarray]:
    return {pattern.format(letter): rgb[..., k].copy() for k, letter in enumerate(letters)}


def refused(path: Path, *words: str, layer: str | None = None) -> None:
    with pytest.raises(ValueError) as caught:  # noqa: PT011  the words are looked for below
        images.read(path, layer)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert "\n" not in text
    assert all(word in text for word in words), text


def pixels(path: Path, layer: str | None = None) -> np.ndarray:
    return images.read_one(path, layer).pixels


def handmade(
    path: Path,
    channels: dict[str, tuple[np.ndarray, int]],
    *,
    tiles: tuple[int, int, int] | None = None,
    levels: Sequence[dict[str, np.ndarray]] = (),
    without: str = "",
) -> Path:
    """An uncompressed OpenEXR file of float channels with their subsampling, or of tiles (width, height, mode)."""

    def attribute(name: str, kind: str, value: bytes) -> bytes:
        return b"" if name == without else f"{name}\0{kind}\0".encode() + struct.pack("<i", len(value)) + value

    height, width = next(pixels.shape for pixels, every in channels.values() if every == 1)
    listed = b"".join(
        name.encode() + b"\0" + struct.pack("<iB3xii", 2, 0, every, every) for name, (_, every) in channels.items()
    )
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    header = struct.pack("<II", 20000630, 2 | (0x200 if tiles else 0))
    header += attribute("channels", "chlist", listed + b"\0") + attribute("compression", "compression", b"\0")
    header += attribute("dataWindow", "box2i", window) + attribute("displayWindow", "box2i", window)
    header += attribute("lineOrder", "lineOrder", b"\0") + attribute("pixelAspectRatio", "float", struct.pack("<f", 1))
    header += attribute("screenWindowCenter", "v2f", bytes(8))
    header += attribute("screenWindowWidth", "float", struct.pack("<f", 1))
    if tiles:
        header += attribute("tiles", "tiledesc", struct.pack("<IIB", *tiles))
    header += b"\0"
    chunks = []
    if tiles:
        for level, planes in enumerate(levels):
            rows, columns = next(iter(planes.values())).shape
            for y, x in itertools.product(range(0, rows, tiles[1]), range(0, columns, tiles[0])):
                part = [plane[y : y + tiles[1], x : x + tiles[0]] for plane in planes.values()]
                body = b"".join(plane[row].tobytes() for row in range(part[0].shape[0]) for plane in part)
                chunks.append(struct.pack("<5i", x // tiles[0], y // tiles[1], level, level, len(body)) + body)
    else:
        for y in range(height):
            body = b"".join(plane[y // every].tobytes() for plane, every in channels.values() if y % every == 0)
            chunks.append(struct.pack("<ii", y, len(body)) + body)
    begins = np.cumsum([len(header) + 8 * len(chunks), *map(len, chunks)])[:-1]
    path.write_bytes(header + struct.pack(f"<{len(chunks)}Q", *begins) + b"".join(chunks))
    return path


# OpenEXR: layers and parts.


@pytest.mark.parametrize(
    ("pattern", "letters"),
    [
        ("{}", "RGB"),
        ("{}", "rgb"),
        ("ViewLayer.Combined.{}", "RGB"),
        ("beauty.{}", "RGB"),
        ("rgba.{}", "rgb"),
        ("a.b.c.{}", ("Red", "Green", "Blue")),
    ],
)
def test_a_layer_of_any_name(tmp_path: Path, pattern: str, letters: str):
    others = {"ViewLayer.Depth.Z": RGB[..., 0], pattern.format("A"): RGB[..., 1]}
    others |= named("ViewLayer.Normal.{}", "XYZ") | {
        "Crypto.00.V": RGB[..., 2],
        "uv.X": RGB[..., 0],
        "uv.Y": RGB[..., 0],
    }
    assert np.array_equal(pixels(write(tmp_path / "a.exr", named(pattern, letters) | others)), RGB)


def test_of_several_layers_one_is_named(tmp_path: Path):
    path = write(tmp_path / "a.exr", named("View Layer.Combined.{}") | named("View Layer.DiffDir.{}", rgb=2 * RGB))
    refused(path, "2 layers", "'View Layer.Combined'", "'View Layer.DiffDir'", "--layer", "--reference-layer")
    refused(path, "'glossy'", "'View Layer.Combined'", "'View Layer.DiffDir'", layer="glossy")
    for name in ("View Layer.DiffDir", "DiffDir", "diffdir"):
        assert np.array_equal(pixels(path, name), 2 * RGB)
    beside = write(tmp_path / "b.exr", named("{}") | named("albedo.{}", rgb=2 * RGB))
    refused(beside, "'RGB'", "'albedo'")
    assert np.array_equal(pixels(beside, "RGB"), RGB)
    refused(write(tmp_path / "c.exr", {"Z": RGB[..., 0]} | named("n.{}", "XYZ")), "no colour, only Z, n.X, n.Y, n.Z:")
    refused(write(tmp_path / "d.exr", named("{}") | named("{}", "rgb")), "no colour")


def test_parts(tmp_path: Path):
    path = write_parts(tmp_path / "a.exr", {"depth": {"Z": RGB[..., 0].copy()}, "beauty": named("{}")})
    assert np.array_equal(pixels(path), RGB)
    path = write_parts(tmp_path / "b.exr", {"rgba": named("{}"), "direct": named("direct.{}", rgb=3 * RGB)})
    refused(path, "'rgba'", "'direct'")
    assert np.array_equal(pixels(path, "direct"), 3 * RGB)


# OpenEXR: kinds of pixels.


def test_lossless_kinds(tmp_path: Path):
    half = RGB.astype(np.float16)
    mixed = named("{}") | {"G": half[..., 1].copy()}
    assert np.array_equal(pixels(write(tmp_path / "mixed.exr", mixed)), np.stack([*RGB.T[:1], half.T[1], RGB.T[2]]).T)
    tiled = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
    for number, name in enumerate(("NO", "RLE", "ZIPS", "ZIP", "PIZ", "HTJ2K32", "HTJ2K256", "ZSTD")):
        for kind, of in {"lines": {}, "tiles": tiled}.items():
            if kind == "tiles" and number > 4:
                continue
            compression = getattr(OpenEXR, f"{name}_COMPRESSION")
            path = write(tmp_path / f"{name}-{kind}.exr", {"RGB": RGB}, compression=compression, **of)
            image = images.read_one(path)
            assert np.array_equal(image.pixels, RGB)
            assert (image.quantum, image.notes) == (0.0, ())


def test_luminance_alone_and_with_chroma(tmp_path: Path):
    grey = write(tmp_path / "y.exr", {"Y": RGB[..., 0]})
    assert np.array_equal(pixels(grey), np.repeat(RGB[..., :1], 3, axis=2))
    y = RGB @ REC709_LUMINANCE.astype(np.float32)
    chroma = {"Y": y, "RY": (RGB[..., 0] - y) / y, "BY": (RGB[..., 2] - y) / y}
    assert pixels(write(tmp_path / "yc.exr", chroma)) == pytest.approx(RGB, rel=2e-4, abs=2e-4)
    quarter = RGB[::2, ::2, 0].copy()
    path = handmade(tmp_path / "s.exr", {"BY": (quarter, 2), "RY": (quarter, 2), "Y": (RGB[..., 0].copy(), 1)})
    with OpenEXR.File(str(path), separate_channels=True) as file:
        assert np.array_equal(file.channels()["Y"].pixels, RGB[..., 0])  # a file that the library reads
    refused(path, "subsampled", "write R, G and B")


def test_levels_of_tiles(tmp_path: Path):
    sizes = [(20, 30), (10, 15), (5, 7), (2, 3), (1, 1)]
    levels = [{letter: RGB[:h, :w, k].copy() for k, letter in ((2, "B"), (1, "G"), (0, "R"))} for h, w in sizes]
    for mode, there in ((0, levels[:1]), (1, levels)):
        path = handmade(
            tmp_path / f"{mode}.exr", {n: (p, 1) for n, p in levels[0].items()}, tiles=(8, 8, mode), levels=there
        )
        assert np.array_equal(pixels(path), RGB)


def test_what_is_no_radiance_is_refused(tmp_path: Path):
    deep = np.empty((4, 4), object)
    for at in np.ndindex(deep.shape):
        deep[at] = np.ones(2, np.float32)
    header = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}
    refused(write(tmp_path / "deep.exr", {"R": deep, "G": deep, "B": deep}, **header), "deep", "flattened")
    refused(write(tmp_path / "id.exr", named("{}", rgb=RGB.astype(np.uint32))), "integers", "float or half")
    for name in ("png", "jpg", "bmp", "gif", "webp", "ppm"):
        path = tmp_path / f"a.{name}"
        Picture.fromarray((RGB * 50).astype(np.uint8)).save(path)
        refused(path, "what a screen shows", "write OpenEXR")
    (tmp_path / "a.toml").write_text("camera = 1\nresolution = [1, 2]\n")
    refused(tmp_path / "a.toml", "no image", "OpenEXR", "PFM")
    (tmp_path / "empty.exr").touch()
    refused(tmp_path / "empty.exr", "is empty, no image")
    refused(tmp_path / "none.exr", "no such file")


# OpenEXR: windows and colours.


def windowed(path: Path, data: tuple[int, int], display: tuple[int, int, int, int]) -> Path:
    left, top = data
    header = {"dataWindow": (data, (left + WIDTH - 1, top + HEIGHT - 1)), "displayWindow": (display[:2], display[2:])}
    return write(path, {"RGB": RGB}, **header)


def test_the_data_window_stands_in_the_display_window(tmp_path: Path):
    image = images.read_one(windowed(tmp_path / "a.exr", (20, 10), (0, 0, 63, 47)))
    expected = np.zeros((48, 64, 3), np.float32)
    expected[10 : 10 + HEIGHT, 20 : 20 + WIDTH] = RGB
    assert np.array_equal(image.pixels, expected)
    assert image.notes == (f"{64 * 48 - WIDTH * HEIGHT} pixels outside its data window are black",)
    over = images.read_one(windowed(tmp_path / "b.exr", (-3, -2), (0, 0, 9, 11)))
    assert np.array_equal(over.pixels, RGB[2:14, 3:13])
    assert over.notes == (f"{WIDTH * HEIGHT - 120} pixels outside its display window are left out",)
    refused(windowed(tmp_path / "c.exr", (100, 0), (0, 0, 9, 9)), "outside its display window")
    moved = images.read_one(windowed(tmp_path / "d.exr", (5, 6), (5, 6, 5 + WIDTH - 1, 6 + HEIGHT - 1)))
    assert np.array_equal(moved.pixels, RGB)
    assert (moved.window, moved.notes) == ((5, 6, 5 + WIDTH - 1, 6 + HEIGHT - 1), ())


def test_unequal_display_windows_are_refused(tmp_path: Path):
    here = windowed(tmp_path / "a.exr", (0, 0), (0, 0, WIDTH - 1, HEIGHT - 1))
    there = windowed(tmp_path / "b.exr", (5, 6), (5, 6, 5 + WIDTH - 1, 6 + HEIGHT - 1))
    with pytest.raises(ValueError, match=r"b.exr: its picture .* is 30 x 20 at \(5, 6\), that of .*a.exr 30 x 20:"):
        images.replicates([here, there])
    with pytest.raises(ValueError, match=r"is 30 x 20 at \(5, 6\)"):
        images.replicates([there]).beside(images.replicates([here]))


def test_unequal_data_windows_are_said(tmp_path: Path):
    here, there = (windowed(tmp_path / f"{x}.exr", (x, 10), (0, 0, 63, 47)) for x in (20, 26))
    one, other = images.replicates([here]), images.replicates([there])
    (note,) = one.beside(other)
    assert f"{here} holds x 20-49, y 10-29, {there} holds x 26-55, y 10-29" in note
    assert one.beside(images.replicates([here])) == []


def test_a_layer_without_colours_is_told_from_none(tmp_path: Path):
    depth = RGB[..., 0].copy()
    path = write(tmp_path / "a.exr", {"V.Depth.Z": depth, **{f"V.Combined.{c}": depth for c in "RGB"}})
    refused(path, "layer = 'Depth' has no colours: allowed are 'V.Combined'", layer="Depth")
    refused(path, "layer = 'Deep': allowed are 'V.Combined'", layer="Deep")


def test_grey_is_not_compared_with_colours(tmp_path: Path):
    colours = write(tmp_path / "a.exr", {"RGB": RGB})
    grey = write(tmp_path / "b.exr", {"Y": RGB[..., 1].copy()})
    np.save(tmp_path / "c.npy", RGB[..., 1])
    for one_channel in (grey, tmp_path / "c.npy"):
        for pair in ([one_channel, colours], [colours, one_channel]):
            one, other = (images.replicates([path]) for path in pair)
            with pytest.raises(ValueError, match="holds one channel, .* has colours: allowed are equal ones"):
                one.beside(other)
    np.save(tmp_path / "d.npy", RGB[..., 1:2].repeat(3, axis=2))  # three that are equal
    assert images.replicates([grey]).beside(images.replicates([tmp_path / "d.npy"])) == []
    with pytest.raises(ValueError, match=r"b.exr: its colours are grey, those of .*a.exr Rec. 709: allowed are"):
        images.replicates([colours, grey])


def test_replicates_of_other_primaries_are_refused(tmp_path: Path):
    usual = write(tmp_path / "a.exr", {"RGB": RGB})
    wide = write(
        tmp_path / "b.exr", {"RGB": RGB}, chromaticities=(0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.329)
    )
    with pytest.raises(ValueError, match=r"b.exr: its colours are chromaticities \(0.708.*, those of .*a.exr Rec. 709"):
        images.replicates([usual, wide])


@pytest.mark.parametrize("space", ["ITU-R BT.2020", "Display P3"])
def test_other_primaries_become_rec709(tmp_path: Path, space: str):
    there, ours = colour.RGB_COLOURSPACES[space], colour.RGB_COLOURSPACES["ITU-R BT.709"]
    path = write(tmp_path / "a.exr", {"RGB": RGB}, chromaticities=(*there.primaries.ravel(), *there.whitepoint))
    image = images.read_one(path)
    expected = colour.RGB_to_RGB(RGB, there, ours, chromatic_adaptation_transform=None)
    assert image.pixels == pytest.approx(expected, rel=1e-4, abs=1e-4)
    assert np.abs(image.pixels - RGB).max() > 0.05
    assert "converted to Rec. 709" in image.notes[0]


def test_primaries_that_are_rec709s_change_nothing(tmp_path: Path):
    path = write(tmp_path / "a.exr", {"RGB": RGB}, chromaticities=(0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.31271, 0.32902))
    image = images.read_one(path)
    assert np.array_equal(image.pixels, RGB)
    assert image.notes == ()


def test_primaries_without_an_answer_are_refused(tmp_path: Path):
    acescg = (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)
    refused(write(tmp_path / "a.exr", {"RGB": RGB}, chromaticities=acescg), "white", "write linear Rec. 709")
    flat = (0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3127, 0.329)
    refused(write(tmp_path / "b.exr", {"RGB": RGB}, chromaticities=flat), "no colour space")


def test_what_mitsuba_writes(tmp_path: Path):
    # The process keeps one variant of Mitsuba, in which the references' plugins are registered.
    mi = backend.import_mitsuba()
    bitmap = mi.Bitmap(RGB)
    for name in ("exr", "pfm", "hdr"):
        bitmap.write(str(tmp_path / f"rgb.{name}"))
    for kind in ("XYZ", "Y"):
        converted = bitmap.convert(getattr(mi.Bitmap.PixelFormat, kind), mi.Struct.Type.Float32, srgb_gamma=False)
        converted.write(str(tmp_path / f"{kind}.exr"))
    assert np.array_equal(pixels(tmp_path / "rgb.exr"), RGB)
    assert np.array_equal(pixels(tmp_path / "rgb.pfm"), RGB)
    # Mitsuba's matrix has six digits.
    assert pixels(tmp_path / "XYZ.exr") == pytest.approx(RGB, rel=1e-3, abs=1e-3)
    assert pixels(tmp_path / "Y.exr")[..., 1] == pytest.approx(RGB @ REC709_LUMINANCE, rel=1e-3)
    read = pixels(tmp_path / "rgb.hdr")
    assert (np.abs(read - RGB) <= RGB.max(axis=2, keepdims=True) / 256).all()
    assert read.mean() == pytest.approx(RGB.mean(), rel=5e-4)  # Mitsuba cuts mantissas off: not 0.3 % too dark


# How coarsely values were rounded.


def test_rounding_is_known(tmp_path: Path):
    half = RGB.astype(np.float16)
    path = write(tmp_path / "half.exr", {"RGB": half})
    error = np.abs(pixels(path) - RGB) / RGB
    assert images.read_one(path).quantum == 2**-11 >= error.max() > 2**-13
    np.save(tmp_path / "half.npy", half)
    assert images.read_one(tmp_path / "half.npy").quantum == 2**-11
    path = write(tmp_path / "pxr.exr", {"RGB": RGB}, compression=OpenEXR.PXR24_COMPRESSION)
    assert images.read_one(path).quantum >= (np.abs(pixels(path) - RGB) / RGB).max() > 0
    noise = RNG.gamma(1.0, 1.0, (64, 64, 3)).astype(np.float32)
    for name, values in (("DWAA", noise), ("DWAB", noise), ("LJ2K", noise), ("B44", noise.astype(np.float16))):
        path = write(tmp_path / f"{name}.exr", {"RGB": values}, compression=getattr(OpenEXR, f"{name}_COMPRESSION"))
        image = images.read_one(path)
        assert name in image.notes[0]
        error = (image.pixels - values).reshape(8, 8, 8, 8, 3).mean(axis=(1, 3))
        assert 1e-5 < np.sqrt(np.mean(error**2)) < image.quantum


# Files that are damaged.


def smooth() -> np.ndarray:
    y, x = np.mgrid[:48, :40] / 48
    return np.stack([x, y, x * y], -1).round(2).astype(np.float32)


def exr(**header: Any) -> Callable[[Path, np.ndarray], object]:
    return lambda path, rgb: write(path.with_suffix(".exr"), {"RGB": rgb}, **header)


DAMAGED: dict[str, Callable[[Path, np.ndarray], object]] = {
    "zip": exr(),
    "raw": exr(compression=OpenEXR.NO_COMPRESSION),
    "piz": exr(compression=OpenEXR.PIZ_COMPRESSION),
    "dwaa": exr(compression=OpenEXR.DWAA_COMPRESSION),
    "tiles": exr(type=OpenEXR.tiledimage, tiles=OpenEXR.TileDescription()),
    "parts": lambda path, rgb: write_parts(
        path.with_suffix(".exr"), {"a": named("{}", rgb=rgb), "b": {"Z": rgb[..., 0].copy()}}
    ),
    "npy": lambda path, rgb: np.save(path.with_suffix(".npy"), rgb),
    "npz": lambda path, rgb: np.savez_compressed(path.with_suffix(".npz"), rgb),
    "pfm": lambda path, rgb: path.with_suffix(".pfm").write_bytes(pfm(rgb)),
    "hdr": lambda path, rgb: path.with_suffix(".hdr").write_bytes(hdr(rgb)),
    "tif": lambda path, rgb: tifffile.imwrite(path.with_suffix(".tif"), rgb, photometric="rgb"),
    "deflated": lambda path, rgb: tifffile.imwrite(
        path.with_suffix(".tif"), rgb, photometric="rgb", compression="zlib", rowsperstrip=8
    ),
}


@pytest.mark.parametrize("kind", DAMAGED)
def test_a_file_that_is_cut_is_called_cut_short(tmp_path: Path, capfd: pytest.CaptureFixture[str], kind: str):
    DAMAGED[kind](tmp_path / "whole", smooth())
    (whole,) = tmp_path.iterdir()
    content = whole.read_bytes()
    assert images.read_one(whole).pixels == pytest.approx(smooth(), rel=0.01, abs=0.01)
    cut = tmp_path / f"cut{whole.suffix}"
    for length in (*(len(content) * tenth // 10 for tenth in range(10)), len(content) - 1):
        cut.write_bytes(content[:length])
        refused(cut, "is cut short")
    assert capfd.readouterr() == ("", "")  # the libraries say nothing beside


@pytest.mark.parametrize("kind", ["zip", "tiles", "parts", "npz", "deflated"])
def test_a_flipped_bit_is_found_by_checksums(tmp_path: Path, capfd: pytest.CaptureFixture[str], kind: str):
    rgb = smooth()
    DAMAGED[kind](tmp_path / "whole", rgb)
    (whole,) = tmp_path.iterdir()
    content = whole.read_bytes()
    bent = tmp_path / f"bent{whole.suffix}"
    first = len(content) // 3  # of what is compressed: in names and sizes of a header a bit makes another good file
    for at in RNG.integers(first, len(content), 30):
        changed = bytearray(content)
        changed[at] ^= 1 << RNG.integers(8)
        bent.write_bytes(changed)
        try:
            read = pixels(bent)
        except ValueError as error:
            assert "\n" not in str(error)  # noqa: PT017  some bits do not matter
        else:
            assert np.array_equal(read, rgb), at
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("kind", DAMAGED)
def test_a_damaged_header_is_never_a_traceback(tmp_path: Path, capfd: pytest.CaptureFixture[str], kind: str):
    DAMAGED[kind](tmp_path / "whole", smooth())
    (whole,) = tmp_path.iterdir()
    content = whole.read_bytes()
    bent = tmp_path / f"bent{whole.suffix}"
    refusals = 0
    for at in RNG.integers(0, min(len(content), 400), 40):
        changed = bytearray(content)
        changed[at] ^= RNG.integers(1, 256)
        bent.write_bytes(changed)
        try:
            images.read(bent)
        except ValueError as error:
            assert "\n" not in str(error)  # noqa: PT017  any other error fails the test
            refusals += 1
    assert refusals > 0 or kind in ("pfm", "hdr")
    assert capfd.readouterr() == ("", "")


def test_an_index_image_is_whole(tmp_path: Path):
    """Of a file whose second part is missing, the library returns the colours of the first: objects of another kind."""
    indices = RNG.integers(0, 5, (HEIGHT, WIDTH)).astype(np.uint32)
    path = write_parts(tmp_path / "a.exr", {"beauty": named("{}"), "ids": {"object index": indices}})
    assert np.array_equal(index_image(path), indices)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 3 // 4])
    with pytest.raises(ValueError, match=r"^[^:]*a.exr: is cut short: [^\n]*$"):
        index_image(path)
    with pytest.raises(ValueError, match="is not its display window"):
        mask_image(windowed(tmp_path / "b.exr", (20, 10), (0, 0, 63, 47)))


def test_a_header_without_its_window_is_refused(tmp_path: Path):
    planes = {letter: (RGB[..., k].copy(), 1) for k, letter in ((2, "B"), (1, "G"), (0, "R"))}
    assert np.array_equal(pixels(handmade(tmp_path / "a.exr", planes)), RGB)
    refused(handmade(tmp_path / "b.exr", planes, without="displayWindow"), "no displayWindow")


def test_a_chunk_that_was_never_written_is_missed(tmp_path: Path):
    path = write(tmp_path / "a.exr", {"RGB": RGB}, compression=OpenEXR.ZIPS_COMPRESSION)
    content = bytearray(path.read_bytes())
    table = _table(content, HEIGHT)
    content[table + 8 * 7 : table + 8 * 8] = bytes(8)
    path.write_bytes(content)
    refused(path, "is cut short", "1 of 20 chunks")
    content[table + 8 * 7 : table + 8 * 8] = content[table + 8 * 6 : table + 8 * 7]
    path.write_bytes(content)
    refused(path, "chunk 7 is not where its table says")


def _table(content: bytearray, chunks: int) -> int:
    """Where the table of chunks begins: its first entry points behind itself."""
    return next(
        at for at in range(len(content)) if struct.unpack_from("<Q", content, at)[0] == at + 8 * chunks and at > 100
    )


# PFM, Radiance, NumPy, TIFF.


def pfm(values: np.ndarray, order: str = "<") -> bytes:
    kind = "PF" if values.ndim == 3 else "Pf"
    header = f"{kind}\n{values.shape[1]} {values.shape[0]}\n{'-1.0' if order == '<' else '1.0'}\n".encode()
    rows = (struct.pack(f"{order}{row.size}f", *row.ravel()) for row in values[::-1])  # the lowest first
    return header + b"".join(rows)


def test_pfm_is_upright_in_both_byte_orders(tmp_path: Path):
    path = tmp_path / "a.pfm"
    for order in "<>":
        path.write_bytes(pfm(RGB, order))
        assert np.array_equal(pixels(path), RGB)
        path.write_bytes(pfm(RGB[..., 0], order))
        assert np.array_equal(pixels(path), np.repeat(RGB[..., :1], 3, axis=2))
    path.write_bytes(pfm(RGB).replace(b"-1.0", b"-2.0"))
    refused(path, "scale -2", "1 and -1")
    path.write_bytes(pfm(RGB) + b"\0")
    refused(path, "1 bytes behind")
    refused(path, "has none", layer="beauty")


def rgbe(rgb: np.ndarray) -> np.ndarray:
    """Bytes (H, W, 4): mantissas cut off, as in Radiance's own `setcolr`."""
    _, exponent = np.frexp(rgb.max(axis=-1))
    mantissas = np.floor(np.ldexp(rgb, 8 - exponent[..., None]))
    black = rgb.max(axis=-1) == 0
    return np.where(black[..., None], 0, np.concatenate([mantissas, exponent[..., None] + 128], -1)).astype(np.uint8)


def hdr(rgb: np.ndarray, size: str = "", extra: str = "") -> bytes:
    """A Radiance file in runs: of equal bytes from 3 on, and literal ones."""
    lines, width = rgb.shape[:2]
    size = size or f"-Y {lines} +X {width}"
    out = f"#?RADIANCE\n# by hand\nFORMAT=32-bit_rle_rgbe\n{extra}\n{size}\n".encode()
    for line in rgbe(rgb):
        out += bytes((2, 2, width >> 8, width & 255))
        for channel in line.T.tolist():
            for value, group in itertools.groupby(channel):
                for start in range(0, count := len(list(group)), 127):
                    run = min(127, count - start)
                    out += bytes((128 + run, value)) if run > 2 else bytes((run, *[value] * run))
    return out


def test_radiance(tmp_path: Path):
    path = tmp_path / "a.hdr"
    rgb = RGB.copy()
    rgb[:, 5:15] = rgb[0, 0]  # runs
    rgb[3, :, 1] = 0
    rgb[4] = 0
    path.write_bytes(hdr(rgb))
    image = images.read_one(path)
    read = image.pixels
    assert (np.abs(read - rgb) <= rgb.max(axis=2, keepdims=True) * image.quantum).all()
    assert read.mean() == pytest.approx(rgb.mean(), rel=5e-4)
    assert not read[3, :, 1].any()
    assert not read[4].any()
    assert "8-bit mantissas" in image.notes[0]
    height, width = rgb.shape[:2]
    for size, turned in {
        f"+Y {height} +X {width}": rgb[::-1],
        f"-Y {height} -X {width}": rgb[:, ::-1],
        f"+X {width} -Y {height}": rgb.swapaxes(0, 1),
        f"-X {width} +Y {height}": rgb[::-1, ::-1].swapaxes(0, 1),
    }.items():
        path.write_bytes(hdr(turned, size))
        assert np.array_equal(pixels(path), read), size
    path.write_bytes(hdr(rgb, extra="EXPOSURE=2\nEXPOSURE=2\nCOLORCORR=1 1 2\n"))
    assert np.allclose(pixels(path), read / [4, 4, 8])
    narrow = rgb[:, :7]
    path.write_bytes(b"#?RGBE\n\n-Y 20 +X 7\n" + rgbe(narrow).tobytes())
    assert np.array_equal(pixels(path), read[:, :7])
    for extra, words in {
        "FORMAT=32-bit_rle_xyze\n": "32-bit_rle_rgbe",
        "GAMMA=2.2\n": "GAMMA",
        "EXPOSURE=0\n": "EXPOSURE",
        "PRIMARIES=0.64 0.33 0.29 0.6 0.15 0.06 0.3333 0.3333\n": "white",
    }.items():
        path.write_bytes(hdr(rgb, extra=extra))
        refused(path, words)


def test_numpy(tmp_path: Path):
    path = tmp_path / "a.npy"
    for array in (
        RGB,
        np.asfortranarray(RGB),
        RGB.astype(">f4"),
        np.dstack([RGB, RGB[..., :1]]),
        RGB.astype(np.float64),
    ):
        np.save(path, array)
        image = images.read_one(path)
        assert np.array_equal(image.pixels, RGB)
        assert image.pixels.dtype == (np.float64 if array.dtype == np.float64 else np.float32)
    np.save(path, RGB[..., 0])
    assert np.array_equal(pixels(path), np.repeat(RGB[..., :1], 3, axis=2))
    for array, words in (
        ((RGB * 50).astype(np.uint8), "8-bit integers"),
        (RGB.astype(complex), "complex128"),
        (np.array([{}]), "no numbers"),
        (RGB[..., :2], "shape (20, 30, 2)"),
        (RGB[None, None], "shape (1, 1, 20, 30, 3)"),
    ):
        np.save(path, array)
        refused(path, words)
    np.savez(tmp_path / "a.npz", mine=RGB, theirs=2 * RGB)
    refused(tmp_path / "a.npz", "'mine', 'theirs'")
    assert np.array_equal(pixels(tmp_path / "a.npz", "theirs"), 2 * RGB)


def test_tiff(tmp_path: Path):
    path = tmp_path / "a.tif"
    planar = np.ascontiguousarray(np.moveaxis(RGB, -1, 0))
    ways: list[tuple[np.ndarray, dict[str, Any]]] = [
        (RGB, {}),
        (RGB, {"bigtiff": True, "byteorder": ">"}),
        (RGB, {"tile": (16, 16), "compression": "zlib"}),
        (RGB, {"rowsperstrip": 3}),
        (planar, {"planarconfig": "separate"}),
        (np.dstack([RGB, RGB[..., :1]]), {"extrasamples": ["assocalpha"]}),
    ]
    for array, how in ways:
        tifffile.imwrite(path, array, photometric="rgb", **how)
        assert np.array_equal(pixels(path), RGB), how
    tifffile.imwrite(path, RGB[..., 0])
    assert np.array_equal(pixels(path), np.repeat(RGB[..., :1], 3, axis=2))
    Picture.fromarray(RGB[..., 0]).save(path)  # of Pillow, mode F
    assert np.array_equal(pixels(path)[..., 2], RGB[..., 0])
    wrong: list[tuple[np.ndarray, dict[str, Any], str]] = [
        ((RGB * 50).astype(np.uint8), {"photometric": "rgb"}, "8-bit integers"),
        ((RGB * 50).astype(np.uint16), {"photometric": "rgb"}, "16-bit integers"),
        (np.stack([RGB, RGB]), {"photometric": "rgb"}, "2 pages"),
        (RGB, {"photometric": "rgb", "extratags": [(274, 3, 1, 3, True)]}, "orientation"),
        (RGB, {"photometric": "rgb", "iccprofile": b"profile"}, "ICC profile"),
        (RGB[..., 0], {"photometric": "miniswhite"}, "photometric"),
    ]
    for array, how, words in wrong:
        tifffile.imwrite(path, array, **how)
        refused(path, words)


def lzw(body: bytes) -> bytes:
    """Packed by libtiff, as the one strip of a picture of bytes."""
    content = io.BytesIO()
    Picture.frombytes("L", (len(body), 1), body).save(content, "tiff", compression="tiff_lzw")
    content.seek(0)
    with tifffile.TiffFile(content) as file:
        (at,), (count,) = (file.pages.first.dataoffsets, file.pages.first.databytecounts)
    return content.getvalue()[at : at + count]


def predicted(rgb: np.ndarray, *, side: int = 0, kind: str = "<f4", predictor: int = 3, packing: int = 8) -> bytes:
    """A packed TIFF with a predictor, by default that of floats, in tiles of a side or in strips of 7 lines."""
    height, width, samples = rgb.shape
    size = np.dtype(kind).itemsize
    high, wide = (side, side) if side else (7, width)
    bodies = []
    for y, x in itertools.product(range(0, height, high), range(0, width, wide)):
        block = rgb[y : y + high, x : x + wide]
        if side:
            block = np.pad(block, ((0, side - block.shape[0]), (0, side - block.shape[1]), (0, 0)))
        body = b""
        for row in block.astype(kind if predictor < 3 else kind.replace("<", ">")):
            ordered = np.frombuffer(row.tobytes(), kind.replace("f", "u") if predictor < 3 else np.uint8)
            if predictor == 3:
                ordered = ordered.reshape(-1, size).T.ravel()
            differences = ordered.copy()
            if predictor > 1:
                differences[samples:] -= ordered[:-samples]
            body += differences.tobytes()
        bodies.append(lzw(body) if packing == 5 else zlib.compress(body))
    count = len(bodies)
    extra = 8 + 2 + 12 * 12 + 4
    offsets = np.cumsum([extra + 12 + 8 * count, *map(len, bodies)])[:-1].tolist()
    sizes = (322, 3, 1, wide), (323, 3, 1, high), (324, 4, count, extra + 12), (325, 4, count, extra + 12 + 4 * count)
    if not side:
        sizes = (278, 3, 1, high), (273, 4, count, extra + 12), (279, 4, count, extra + 12 + 4 * count), (284, 3, 1, 1)
    tags = [(256, 3, 1, width), (257, 3, 1, height), (258, 3, 3, extra), (259, 3, 1, packing), (262, 3, 1, 2)]
    tags += [(277, 3, 1, samples), (317, 3, 1, predictor), (339, 3, 3, extra + 6), *sizes]
    directory = b"".join(struct.pack("<HHII", *tag) for tag in sorted(tags))
    shorts = struct.pack("<6H", *[8 * size] * 3, *[3] * 3)
    tables = struct.pack(f"<{2 * count}I", *offsets, *map(len, bodies))
    header = struct.pack("<2sHIH", b"II", 42, 8, len(tags))
    return header + directory + bytes(4) + shorts + tables + b"".join(bodies)


@pytest.mark.parametrize("side", [0, 16])
def test_tiff_with_predicted_floats(tmp_path: Path, side: int):
    path = tmp_path / "a.tif"
    for kind in ("<f4", "<f2"):
        path.write_bytes(predicted(RGB, side=side, kind=kind))
        assert np.array_equal(pixels(path), RGB.astype(kind).astype(np.float32))


@pytest.mark.parametrize("side", [0, 16])
@pytest.mark.parametrize("predictor", [1, 2, 3])
def test_tiff_packed_by_lzw(tmp_path: Path, predictor: int, side: int):
    path = tmp_path / "a.tif"
    for kind in ("<f4", "<f2"):
        content = predicted(RGB, side=side, kind=kind, predictor=predictor, packing=5)
        path.write_bytes(content)
        assert np.array_equal(pixels(path), RGB.astype(kind).astype(np.float32)), kind
    path.write_bytes(content[:-200] + bytes(200))
    refused(path, "is cut short, damaged, or of a kind that is not read")


def test_tiff_of_pillow_packed_by_lzw(tmp_path: Path):
    """Grey floats, which libtiff packs itself, with each predictor that it has for them."""
    path = tmp_path / "a.tif"
    for predictor in (1, 2, 3):
        Picture.fromarray(RGB[..., 0]).save(path, compression="tiff_lzw", tiffinfo={317: predictor})
        with tifffile.TiffFile(path) as file:
            assert (file.pages.first.compression, file.pages.first.predictor) == (5, predictor)
        assert np.array_equal(pixels(path)[..., 1], RGB[..., 0]), predictor


# Folders and stacks.


def test_folders(tmp_path: Path):
    folder = tmp_path / "mine"
    folder.mkdir()
    for name in ("b.EXR", "a.exr", "notes.txt", "._a.exr", ".hidden.exr"):
        if name.endswith("txt") or name.startswith("._"):
            (folder / name).write_bytes(zlib.compress(b"of another kind"))
        else:
            write(folder / "new.exr", {"RGB": RGB * (1 + ("b" in name))}).rename(folder / name)
    found = images.replicates([folder])
    assert [Path(name).name for name in found.names] == ["a.exr", "b.EXR"]
    assert np.array_equal(found.pixels, np.stack([RGB, 2 * RGB]))
    np.save(folder / "a.npy", RGB)
    with pytest.raises(ValueError, match=r"mine: holds 2 .exr and 1 .npy files"):
        images.replicates([folder])
    shown = tmp_path / "shown"
    shown.mkdir()
    (shown / "a.png").touch()
    with pytest.raises(ValueError, match=r"shown: holds no image, only .png: allowed"):
        images.replicates([shown])


def test_a_stack_is_replicates(tmp_path: Path):
    stack = RNG.random((5, 6, 7, 3)).astype(np.float32)
    np.save(tmp_path / "a.npy", stack[:2])
    np.savez(tmp_path / "b.npz", stack[2:4])
    np.save(tmp_path / "c.npy", stack[4])
    found = images.replicates([tmp_path / name for name in ("a.npy", "b.npz", "c.npy")])
    assert np.array_equal(found.pixels, stack)
    assert [Path(name).name for name in found.names] == ["a.npy[0]", "a.npy[1]", "b.npz[0]", "b.npz[1]", "c.npy"]
    with pytest.raises(ValueError, match="a stack of 2 images"):
        images.read_one(tmp_path / "a.npy")


def test_notes_and_rounding_of_replicates(tmp_path: Path):
    paths = [windowed(tmp_path / f"{k}.exr", (0, 0), (0, 0, 39, 39)) for k in range(3)]
    tail = {"dataWindow": ((0, 0), (WIDTH - 1, HEIGHT - 1)), "displayWindow": ((0, 0), (39, 39))}
    paths.append(write(tmp_path / "half.exr", {"RGB": RGB.astype(np.float16)}, **tail))
    found = images.replicates(paths)
    assert found.quantum == 2**-11
    black, half = found.notes
    assert black == f"{paths[0]} and 3 more: 1000 pixels outside its data window are black"
    assert half.startswith(f"{paths[3]}: half floats")
