"""OpenEXR: layers and parts, data and display windows, chromaticities; read by the OpenEXR library.

A layer is what channels share before the last dot of their names, `ViewLayer.Combined` of `ViewLayer.Combined.R`; that
without a name is called RGB or Y. It holds colour with R, G and B, with X, Y and Z where the chromaticities are CIE
XYZ's, with Y alone, or with Y, RY and BY. In files of several parts the part's name stands before it.
"""

import contextlib
import errno
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import OpenEXR

from termwise.scenes.images import chunks
from termwise.scenes.images.image import (
    GREY,
    HALF,
    HALF_NOTE,
    LOSSY,
    REC709,
    Image,
    Window,
    check_size,
    conversion,
    in_rec709,
    luminance_weights,
)

_WORDS = {"red": "r", "green": "g", "blue": "b"}
_COLOURS = ("r", "g", "b"), ("y", "ry", "by"), ("x", "y", "z"), ("y",)
_TYPES = np.uint32, np.float16, np.float32
"""Of pixels, by the number that the format has for them."""
_LOSSY_OF_HALF = OpenEXR.B44_COMPRESSION, OpenEXR.B44A_COMPRESSION
_LOSSY = OpenEXR.DWAA_COMPRESSION, OpenEXR.DWAB_COMPRESSION, OpenEXR.LJ2K_COMPRESSION
_PXR24 = 2.0**-16
_USUAL_DWA_LEVEL = 45.0


@attrs.frozen
class _Layer:
    """Where a layer stands: its part and the library's channels of it, in the order of `kind`."""

    part: int
    kind: tuple[str, ...]
    channels: tuple[Any, ...]


def read(path: Path, layer: str | None) -> list[Image]:
    """The image of one layer; a ValueError says what is wrong, or which layers there are."""
    headers = _headers(path)
    return _images(path, headers, [_chosen(path, headers, layer)])


def read_all(path: Path) -> dict[str, Image]:
    """The images of all layers of colour, by name; a ValueError says what is wrong."""
    headers = _headers(path)
    layers = _layers(headers)
    return dict(zip(layers, _images(path, headers, list(layers.values())), strict=True))


def read_channels(path: Path) -> dict[str, np.ndarray]:
    """All channels by name, (H, W) of the numbers that the file holds; a ValueError says what is wrong.

    A data window that is not the display window is refused: what stands outside of it, no number says.
    """
    headers = _headers(path)
    if any((header["dataWindow"][k] != header["displayWindow"][k]).any() for header in headers for k in (0, 1)):
        raise ValueError(f"{path}: its data window is not its display window: write all of it")
    parts = [_Layer(part, (), tuple(header["channels"])) for part, header in enumerate(headers)]
    stored = zip(parts, _stored(path, headers, parts), strict=True)
    return {name: plane for part, planes in stored for name, plane in zip(_names(part), planes, strict=True)}


def _headers(path: Path) -> list[dict[str, Any]]:
    """Of the parts of a file that is whole and flat."""
    table = chunks.end_of_headers(path)  # a file that ends in them is cut short
    try:
        with _silent(), OpenEXR.File(str(path), header_only=True) as file:
            headers = [dict(part.header) for part in file.parts]
    except Exception as error:  # OpenEXR raises RuntimeError, TypeError, KeyError and ValueError alike
        raise ValueError(f"{path}: is damaged in its header ({_said(error)}): write or copy it again") from None
    for header in headers:
        if header["type"] in (OpenEXR.deepscanline, OpenEXR.deeptile):
            raise ValueError(f"{path}: is deep, many samples a pixel, which no verdict is about: write it flattened")
        for window in ("dataWindow", "displayWindow"):
            check_size(path, *_size(header, window))
    chunks.check(path, headers, table)
    return headers


def _size(header: dict[str, Any], window: str) -> tuple[int, int]:
    """Width and height."""
    (left, top), (right, bottom) = (each.tolist() for each in header[window])
    return right - left + 1, bottom - top + 1


def _layers(headers: list[dict[str, Any]]) -> dict[str, _Layer]:
    """The layers of colour, by name."""
    found = {}
    for part, header in enumerate(headers):
        groups: dict[str, dict[str, list[Any]]] = {}
        for channel in header["channels"]:
            name, _, last = str(channel.name).rpartition(".")
            letter = _WORDS.get(last.lower(), last.lower())
            groups.setdefault(name, {}).setdefault(letter, []).append(channel)
        for name, channels in groups.items():
            kind = _kind(header, channels)
            if kind is None:
                continue
            title = _title(header.get("name") or "", name, len(headers) > 1) or ("Y" if kind[0] == "y" else "RGB")
            found[title] = _Layer(part, kind, tuple(channels[letter][0] for letter in kind))
    return found


def _kind(header: dict[str, Any], channels: dict[str, list[Any]]) -> tuple[str, ...] | None:
    """Which channels make the colour of a layer; None for one of something else (normals, a depth)."""
    is_xyz = tuple(header.get("chromaticities", REC709))[:6] == (1.0, 0.0, 0.0, 1.0, 0.0, 0.0)
    for kind in _COLOURS:
        if all(len(channels.get(letter, ())) == 1 for letter in kind):
            if kind == ("x", "y", "z"):
                return kind if is_xyz else None
            alone = kind != ("y",) or not ({"x", "z", "u", "v", "ry", "by"} & set(channels))
            return kind if alone else None
    return None


def _title(part: str, name: str, several: bool) -> str:
    """Of a layer: a part's name leads where there are several, once where channels repeat it."""
    if not name:
        return part
    return name if not several or not part or f"{name}.".startswith(f"{part}.") else f"{part}.{name}"


def _chosen(path: Path, headers: list[dict[str, Any]], layer: str | None) -> _Layer:
    layers = _layers(headers)
    names = ", ".join(map(repr, layers))
    if not layers:
        channels = [channel.name for header in headers for channel in header["channels"]]
        there = ", ".join(channels[:12]) + (f" and {len(channels) - 12} more" if channels[12:] else "")
        raise ValueError(
            f"{path}: holds no colour, only {there}: allowed are layers with R, G and B, or Y, or Y, RY and BY"
        )
    if layer is None:
        if len(layers) > 1:
            way = "allowed is one, or to name one (judge: --layer, --reference-layer)"
            raise ValueError(f"{path}: holds {len(layers)} layers, {names}: {way}")
        return next(iter(layers.values()))
    # A name may be shortened from the left: Combined is ViewLayer.Combined where no other ends so.
    ends = [name for name in layers if f".{name.lower()}".endswith(f".{layer.lower()}")]
    name = layer if layer in layers else ends[0] if len(ends) == 1 else None
    if name is None:
        channels = [channel.name for header in headers for channel in header["channels"]]
        colourless = any(f".{each.rpartition('.')[0]}".lower().endswith(f".{layer}".lower()) for each in channels)
        what = " has no colours" if colourless else ""
        raise ValueError(f"{path}: layer = {layer!r}{what}: allowed are {names}")
    return layers[name]


def _images(path: Path, headers: list[dict[str, Any]], layers: list[_Layer]) -> list[Image]:
    found = []
    for layer, planes in zip(layers, _stored(path, headers, layers), strict=True):
        for channel, plane in zip(layer.channels, planes, strict=True):
            if plane.dtype.kind != "f":
                integers = f"channel {channel.name} holds integers"
                raise ValueError(f"{path}: {integers}, which radiance is not: write float or half")
        found.append(_image(path, headers[layer.part], layer, planes))
    return found


def _stored(path: Path, headers: list[dict[str, Any]], layers: list[_Layer]) -> list[Sequence[np.ndarray]]:
    """The pixels of each channel of some layers, (H, W) of the data window in the file's own type."""
    for channel in (each for layer in layers for each in layer.channels):
        if (channel.xSampling, channel.ySampling) != (1, 1):
            raise ValueError(
                f"{path}: channel {channel.name} is subsampled, a value for several pixels, so what is compared "
                "would be interpolated: write R, G and B of all pixels"
            )
    try:
        with _silent(), every_core():
            stored = _planes_of_one(path, layers) if len(headers) == 1 else _planes_of_several(path, layers)
    except Exception as error:  # as above
        why = f"its pixels cannot be decoded ({_said(error)})"
        raise ValueError(f"{path}: is damaged, {why}: write or copy it again") from None
    sizes = [_size(headers[layer.part], "dataWindow") for layer in layers]
    return [
        planes if isinstance(planes, np.ndarray) else [plane.reshape(height, width) for plane in planes]
        for (width, height), planes in zip(sizes, stored, strict=True)
    ]


def _planes_of_one(path: Path, layers: list[_Layer]) -> Sequence[Sequence[np.ndarray]]:
    """The pixels of each channel of some layers of a file of one part: it may hold a hundred others.

    Where R, G and B of one type are all that it holds, they are views (3, H, W) of one array (H, W, 3).
    """
    with contextlib.closing(OpenEXR.InputFile(str(path))) as file:
        there = file.header()["channels"]
        types = [[_TYPES[there[name].type.v] for name in _names(layer)] for layer in layers]
        if len(layers) == len(set(types[0])) == 1 and _names(layers[0]) == ["R", "G", "B"] and len(there) == 3:
            with OpenEXR.File(str(path)) as whole:
                if whole.parts:  # else it is damaged, and below it is said how
                    return [np.moveaxis(whole.parts[0].channels["RGB"].pixels, -1, 0)]
        return [
            [np.frombuffer(data, dtype) for data, dtype in zip(file.channels(_names(layer)), dtypes, strict=True)]
            for layer, dtypes in zip(layers, types, strict=True)
        ]


def _planes_of_several(path: Path, layers: list[_Layer]) -> Sequence[Sequence[np.ndarray]]:
    """The same of several parts, which can be read at once only; one that cannot be decoded would be left out."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        parts = {part.part_index: part.channels for part in file.parts}
        return [[np.asarray(parts[layer.part][name].pixels) for name in _names(layer)] for layer in layers]


def _names(layer: _Layer) -> list[str]:
    return [channel.name for channel in layer.channels]


def _image(path: Path, header: dict[str, Any], layer: _Layer, planes: Sequence[np.ndarray]) -> Image:
    """Planes of the data window as Rec. 709 in the display window."""
    chromaticities = tuple(header.get("chromaticities", REC709))
    colors = GREY
    if isinstance(planes, np.ndarray):  # of one array, which needs no copy
        inside = np.ascontiguousarray(np.moveaxis(planes, 0, -1), np.float32)
    else:
        inside = np.empty((*planes[0].shape, 3), np.float32)
        for channel in range(3):
            inside[..., channel] = planes[channel % len(planes)]
    if layer.kind == ("y", "ry", "by"):
        inside = _of_chroma(inside, luminance_weights(chromaticities))
    if layer.kind != ("y",):
        inside, colors = in_rec709(path, inside, chromaticities)
    pixels, window, data, placed = _in_display_window(path, header, inside)
    quantum, rounded = _quantum(header, planes)
    return Image(pixels, window, quantum, conversion(colors) + placed + rounded, colors, data)


def _of_chroma(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """R, G and B of Y, RY = (R - Y)/Y and BY = (B - Y)/Y, with Y the weighted sum of the three."""
    y, red, blue = values[..., 0], (values[..., 1] + 1) * values[..., 0], (values[..., 2] + 1) * values[..., 0]
    green = (y - weights[0] * red - weights[2] * blue) / weights[1]
    return np.stack([red, green, blue], axis=-1).astype(np.float32)


def _in_display_window(
    path: Path, header: dict[str, Any], inside: np.ndarray
) -> tuple[np.ndarray, Window, Window | None, tuple[str, ...]]:
    (left, top), (right, bottom) = (each.tolist() for each in header["displayWindow"])
    window = left, top, right, bottom
    width, height = _size(header, "displayWindow")
    x, y = (at - start for at, start in zip(header["dataWindow"][0].tolist(), (left, top), strict=True))
    rows, columns = inside.shape[:2]
    if (x, y, columns, rows) == (0, 0, width, height):
        return inside, window, None, ()
    first_x, last_x = max(x, 0), min(x + columns, width)
    first_y, last_y = max(y, 0), min(y + rows, height)
    shared = max(last_x - first_x, 0) * max(last_y - first_y, 0)
    if not shared:
        raise ValueError(f"{path}: its data window lies outside its display window: allowed are overlapping ones")
    pixels = np.zeros((height, width, 3), inside.dtype)
    pixels[first_y:last_y, first_x:last_x] = inside[first_y - y : last_y - y, first_x - x : last_x - x]
    black, left_out = height * width - shared, rows * columns - shared
    data = (left + first_x, top + first_y, left + last_x - 1, top + last_y - 1) if black else None
    notes = (
        f"{black} pixels outside its data window are black" if black else "",
        f"{left_out} pixels outside its display window are left out" if left_out else "",
    )
    return pixels, window, data, tuple(note for note in notes if note)


def _quantum(header: dict[str, Any], planes: Sequence[np.ndarray]) -> tuple[float, tuple[str, ...]]:
    """How coarsely the values were rounded, relative, and the note where that can matter."""
    compression, halves = header["compression"], any(plane.dtype == np.float16 for plane in planes)
    if compression in _LOSSY or (halves and compression in _LOSSY_OF_HALF):
        level = float(header.get("dwaCompressionLevel", _USUAL_DWA_LEVEL)) / _USUAL_DWA_LEVEL
        name = compression.name.removesuffix("_COMPRESSION")
        lossy = LOSSY * (max(level, 0.25) if name.startswith("DWA") else 1.0)
        return lossy, (f"lossy compression ({name}): means over places are known to about {lossy:.1%}: write ZIP",)
    if halves:
        return HALF, (HALF_NOTE,)
    return (_PXR24 if compression == OpenEXR.PXR24_COMPRESSION else 0.0), ()


def write(path: Path, pixels: np.ndarray) -> None:
    """Write the one layer RGB, (H, W, 3) float32, ZIP.

    Raises
    ------
    OSError : the file cannot be written, as on a full disk.
    """
    described = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    try:
        OpenEXR.File(described, {"RGB": np.ascontiguousarray(pixels, np.float32)}).write(str(path))
    except RuntimeError:  # the library's word for a full disk
        raise OSError(errno.EIO, "could not be written: is the disk full?", str(path)) from None


@contextlib.contextmanager
def every_core() -> Iterator[None]:
    """With as many of the library's threads as there are cores; none is left, so that a process can be forked."""
    before = OpenEXR.global_thread_count()
    OpenEXR.set_global_thread_count(os.cpu_count() or 1)
    try:
        yield
    finally:
        OpenEXR.set_global_thread_count(before)


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Without what the library prints, by way of Python, and what it writes to standard error past it."""
    with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
        if sys.stderr is None:  # closed: nothing would be heard
            yield
            return
        sys.stderr.flush()
        kept = os.dup(2)
        try:
            os.dup2(nowhere.fileno(), 2)
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)


def _said(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
