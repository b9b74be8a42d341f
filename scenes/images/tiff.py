"""Float TIFF: one page of grey, RGB or RGBA."""

import contextlib
import io
import itertools
import logging
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import attrs
import numpy as np

from termwise.scenes.images.image import Image, check_size, conversion, cut_short, in_rec709

if TYPE_CHECKING:
    from tifffile import TiffPage

_GREY, _RGB = 1, 2
_LZW, _DEFLATE = 5, (8, 32946)
_PLAIN, _DIFFERENCES, _FLOATING = 1, 2, 3


def read(path: Path, layer: str | None) -> list[Image]:
    """The image of a TIFF file; a ValueError says what is wrong."""
    import tifffile  # it takes as long to load as all the others, and few need it

    if layer is not None:
        raise ValueError(f"{path}: layer = {layer!r}: layers of TIFF are not read: allowed is to name none")
    try:
        with _heard() as complaints, tifffile.TiffFile(path) as file:
            pages = len(file.pages)
            if pages != 1:
                raise ValueError(f"{path}: has {pages} pages: allowed is one" if pages else _broken(path, "no page"))
            page = file.pages.first
            _check(path, page)
            deflated = page.compression in _DEFLATE and page.predictor == _FLOATING
            values = _decoded(path, page) if deflated or page.compression == _LZW else page.asarray()
            if complaints:  # a tag that cannot be read is left out, and the image is another one without it
                raise ValueError(complaints[0])
            white, primaries = (page.tags.valueof(code) for code in (318, 319))
    except ValueError as error:
        if str(error).startswith(f"{path}: "):
            raise
        raise ValueError(_broken(path, str(error))) from None
    except Exception as error:  # TiffFileError, struct.error, zlib.error, OSError, ...: whatever its tags hold
        raise ValueError(_broken(path, str(error) or type(error).__name__)) from None
    if page.planarconfig == 2 and values.ndim == 3:  # channels stand behind one another
        values = np.moveaxis(values, 0, -1)
    image = Image.of_array(path, values)
    if white is None and primaries is None:
        return [image]
    if white is None or primaries is None:
        raise ValueError(f"{path}: says its white or its primaries alone: allowed are both or none")
    fractions = np.array([*primaries, *white], np.float64).reshape(-1, 2)
    pixels, colors = in_rec709(path, image.pixels, (fractions[:, 0] / fractions[:, 1]).tolist())
    return [attrs.evolve(image, pixels=pixels, notes=image.notes + conversion(colors), colors=colors)]


@contextlib.contextmanager
def _heard() -> Iterator[list[str]]:
    """What the library logs as an error, which it does in place of raising it; nothing is printed."""
    logger, complaints = logging.getLogger("tifffile"), []

    def hear(record: logging.LogRecord) -> bool:
        if record.levelno >= logging.ERROR:
            complaints.append(record.getMessage())
        return False

    logger.addFilter(hear)
    try:
        yield complaints
    finally:
        logger.removeFilter(hear)


def _broken(path: Path, why: str) -> str:
    return (
        f"{path}: is cut short, damaged, or of a kind that is not read ({' '.join(why.split())}): write it uncompressed"
    )


def _check(path: Path, page: "TiffPage") -> None:
    """Refuse what cannot be read as it was meant."""
    check_size(path, page.imagewidth, page.imagelength)
    if page.dtype is None or page.dtype.kind != "f":
        raise ValueError(
            f"{path}: holds {page.bitspersample}-bit integers, rounded and mostly encoded for a screen, not radiance: "
            "write float TIFF, OpenEXR (float, ZIP), NPY or PFM"
        )
    if page.photometric not in (_GREY, _RGB):
        raise ValueError(f"{path}: photometric interpretation {page.photometric}: allowed are grey and RGB")
    if page.tags.valueof(274, 1) != 1:
        raise ValueError(f"{path}: orientation {page.tags.valueof(274)}: allowed is 1, the top row first")
    if 34675 in page.tags:
        raise ValueError(f"{path}: has an ICC profile, which may mean other colours: write linear Rec. 709 without one")
    size = path.stat().st_size
    there = sum(
        count > 0 and at + count <= size for at, count in zip(page.dataoffsets, page.databytecounts, strict=True)
    )
    if there < len(page.dataoffsets) or not page.dataoffsets:
        raise cut_short(path, f"{there} of {len(page.dataoffsets)} pieces of its pixels are whole")
    stored, needed = sum(page.databytecounts), page.nbytes
    if page.compression == 1 and stored < needed:
        raise cut_short(path, f"{stored} of {needed} bytes of pixels")


def _decoded(path: Path, page: "TiffPage") -> np.ndarray:
    """Pixels whose coding tifffile leaves to a package of 40 MB, (H, W, C), or (C, H, W) where planes stand apart.

    They are deflated floats whose bytes stand by significance and as differences, which OpenImageIO writes by default
    (Adobe Photoshop TIFF Technical Note 3), and all that LZW has packed.
    """
    apart = page.planarconfig == 2
    planes, samples = (page.samplesperpixel, 1) if apart else (1, page.samplesperpixel)
    height, width = page.imagelength, page.imagewidth
    high, wide = (page.tilelength, page.tilewidth) if page.is_tiled else (min(page.rowsperstrip, height), width)
    size, order = page.bitspersample // 8, page.parent.byteorder
    found = np.empty((planes, height, width, samples), f"f{size}")
    places = itertools.product(range(planes), range(0, height, high), range(0, width, wide))
    with path.open("rb") as file:
        for (plane, y, x), offset, count in zip(places, page.dataoffsets, page.databytecounts, strict=True):
            file.seek(offset)
            rows = high if page.is_tiled else min(high, height - y)
            packed, row = file.read(count), wide * samples * size
            unpacked = _unlzw(packed, rows, row) if page.compression == _LZW else zlib.decompress(packed)
            body = np.frombuffer(unpacked, np.uint8).reshape(rows, row)
            part = found[plane, y : y + high, x : x + wide]
            values = _unpredicted(body, page.predictor, samples, size, order)
            part[:] = values[: part.shape[0], : part.shape[1]]
    return found[..., 0] if apart else found[0]


def _unpredicted(body: np.ndarray, predictor: int, samples: int, size: int, order: str) -> np.ndarray:
    """Floats (rows, columns, samples) of the bytes (rows, n) of a piece."""
    rows = len(body)
    if predictor == _FLOATING:
        of_significance = body.reshape(rows, -1, samples).cumsum(axis=1, dtype=np.uint8)
        body, order = np.ascontiguousarray(of_significance.reshape(rows, size, -1).swapaxes(1, 2)), ">"
    elif predictor == _DIFFERENCES:
        words = body.view(f"{order}u{size}").reshape(rows, -1, samples)
        body, order = words.cumsum(axis=1, dtype=f"u{size}"), "="
    elif predictor != _PLAIN:
        raise ValueError(f"predictor {predictor}")
    return body.view(f"{order}f{size}").reshape(rows, -1, samples)


def _unlzw(packed: bytes, rows: int, row: int) -> bytes:
    """What LZW packed: Pillow's libtiff reads it as a picture of bytes, whatever they mean."""
    from PIL import TiffImagePlugin

    tags = TiffImagePlugin.ImageFileDirectory_v2()
    for code, value in ((256, row), (257, rows), (258, 8), (259, _LZW), (262, _GREY), (277, 1), (278, rows)):
        tags[code] = value
    tags[273], tags[279] = 0, len(packed)  # Pillow counts from the end of the tags
    content = struct.pack("<2sHI", b"II", 42, 8) + tags.tobytes(8) + packed
    with TiffImagePlugin.TiffImageFile(io.BytesIO(content)) as picture:
        return picture.tobytes()
