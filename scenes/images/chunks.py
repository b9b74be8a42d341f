"""Whether an OpenEXR file is whole: its headers, its table of chunks, and each chunk that the table points to.

The library reads what there is: of a file of two parts that is cut short it returns the first, as if it were alone.
Layout: https://openexr.com/en/latest/OpenEXRFileLayout.html
"""

import math
import mmap
import struct
from pathlib import Path
from typing import Any

import OpenEXR

from termwise.scenes.images.image import cut_short

_MULTIPART = 0x1000
_REQUIRED = {
    b"channels": b"chlist",
    b"compression": b"compression",
    b"dataWindow": b"box2i",
    b"displayWindow": b"box2i",
    b"lineOrder": b"lineOrder",
}
_TYPES = _REQUIRED | {b"chromaticities": b"chromaticities", b"tiles": b"tiledesc", b"type": b"string"}
"""Attributes in place of which the library would take a default, were they missing or of another type."""
_LINES = {
    "NO": 1,
    "RLE": 1,
    "ZIPS": 1,
    "ZSTD": 1,
    "ZIP": 16,
    "PXR24": 16,
    "PIZ": 32,
    "B44": 32,
    "B44A": 32,
    "DWAA": 32,
    "HTJ2K32": 32,
    "DWAB": 256,
    "HTJ2K256": 256,
    "LJ2K": 256,
}
"""Lines in a chunk, by compression."""


def end_of_headers(path: Path) -> int:
    """Where the table of chunks begins; a ValueError for a file that ends before."""
    data = path.read_bytes() if path.stat().st_size < 2**16 else None
    with path.open("rb") as file:
        if data is not None:
            return _end_of_headers(path, data)
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as mapped:
            return _end_of_headers(path, mapped)


def _end_of_headers(path: Path, data: bytes | mmap.mmap) -> int:
    ended = cut_short(path, "it ends in its header")
    if len(data) < 9:
        raise ended
    several = struct.unpack_from("<I", data, 4)[0] & _MULTIPART
    at = 8
    while True:
        at = _end_of_header(path, data, at, ended)
        if not several:
            return at
        if at >= len(data):
            raise ended
        if data[at] == 0:
            return at + 1


def _end_of_header(path: Path, data: bytes | mmap.mmap, at: int, ended: ValueError) -> int:
    """Skip attributes (name, type, size, value) up to the empty name."""
    lacking = set(_REQUIRED)
    while True:
        if at >= len(data):
            raise ended
        if data[at] == 0:
            if lacking:
                raise ValueError(f"{path}: has no {min(lacking).decode()} in its header: is it damaged?")
            return at + 1
        words = []
        for _ in range(2):
            end = data.find(b"\0", at)
            if end < 0:
                raise ended
            words.append(data[at:end])
            at = end + 1
        name, kind = words
        if _TYPES.get(name, kind) != kind:
            raise ValueError(f"{path}: is damaged in its header: its {name.decode()} is none: write or copy it again")
        lacking.discard(name)
        if at + 4 > len(data):
            raise ended
        (size,) = struct.unpack_from("<i", data, at)
        if size < 0:
            raise ValueError(f"{path}: is damaged in its header: write or copy it again")
        at += 4 + size


def check(path: Path, headers: list[dict[str, Any]], table: int) -> None:
    """Refuse a file of which any chunk is missing or stands at a wrong place.

    Parameters
    ----------
    path : of the file.
    headers : of its parts, as the library reads them; none of them deep.
    table : where that of chunks begins, `end_of_headers`.

    Raises
    ------
    ValueError : one line.
    """
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        several = bool(struct.unpack_from("<I", data, 4)[0] & _MULTIPART)
        counts = [_count(header) for header in headers]
        start = table + 8 * sum(counts)
        if start > len(data):
            raise cut_short(path, "it ends in its table of chunks")
        missing = 0
        for part, (header, count) in enumerate(zip(headers, counts, strict=True)):
            if header.get("chunkCount", count) != count:
                raise ValueError(
                    f"{path}: is damaged: part {part} says {header['chunkCount']} chunks and needs {count}"
                )
            offsets = struct.unpack_from(f"<{count}Q", data, table)
            table += 8 * count
            seen = set()
            for number, offset in enumerate(offsets):
                place = _place(data, header, offset, part if several else None) if offset >= start else None
                if place is None:
                    missing += 1
                elif place == () or place in seen or (len(place) == 1 and place[0] != _line(header, number)):
                    raise ValueError(f"{path}: is damaged: chunk {number} is not where its table says: copy it again")
                else:
                    seen.add(place)
    if missing:
        raise cut_short(path, f"{missing} of {sum(counts)} chunks of its pixels are missing")


def _place(data: mmap.mmap, header: dict[str, Any], offset: int, part: int | None) -> tuple[int, ...] | None:
    """The first line of a chunk, or its tile and level; None where it is not whole, () where it is another part's."""
    names = struct.Struct("<" + "i" * ((part is not None) + (4 if _tiled(header) else 1) + 1))
    if offset + names.size > len(data):
        return None
    *place, size = names.unpack_from(data, offset)
    if part is not None and place.pop(0) != part:
        return ()
    return tuple(place) if 0 < size <= len(data) - offset - names.size else None


def _tiled(header: dict[str, Any]) -> bool:
    return header["type"] == OpenEXR.tiledimage


def _lines(header: dict[str, Any]) -> int:
    compression = header["compression"].name.removesuffix("_COMPRESSION")
    if compression not in _LINES:
        raise ValueError(f"compression {compression} is not known here: allowed are {', '.join(_LINES)}")
    return _LINES[compression]


def _line(header: dict[str, Any], number: int) -> int:
    """The first line of a chunk of lines."""
    return int(header["dataWindow"][0][1]) + number * _lines(header)


def _count(header: dict[str, Any]) -> int:
    """Chunks of a part: tiles of all levels, or blocks of lines."""
    (left, top), (right, bottom) = (each.tolist() for each in header["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    if not _tiled(header):
        return -(-height // _lines(header))
    tiles = header["tiles"]

    def across(size: int, side: int) -> list[int]:
        """Tiles along a side of each level."""
        up = tiles.roundingMode == OpenEXR.ROUND_UP
        levels = range((math.ceil if up else math.floor)(math.log2(size)) + 1)
        return [-(-max(1, -(-size // 2**level) if up else size // 2**level) // side) for level in levels]

    if tiles.mode == OpenEXR.ONE_LEVEL:
        return across(width, tiles.xSize)[0] * across(height, tiles.ySize)[0]
    if tiles.mode == OpenEXR.RIPMAP_LEVELS:
        return sum(across(width, tiles.xSize)) * sum(across(height, tiles.ySize))
    longest = max(width, height)
    levels = len(across(longest, 1))
    wide, high = across(width, tiles.xSize), across(height, tiles.ySize)
    return sum(wide[min(level, len(wide) - 1)] * high[min(level, len(high) - 1)] for level in range(levels))
