"""Radiance HDR: mantissas of 8 bits and a shared exponent, `value = (m + 1/2) 2^(e - 136)`, in runs.

Writers cut mantissas off, so the middle of a step is meant, as Radiance's own reader takes it: without it all would be
0.2 to 0.4 % too dark. A mantissa of 0 is taken as 0: a black channel, not a quarter of a percent of a bright one.
(G. Ward, "Real Pixels", Graphics Gems II, 1991; Radiance's `color.c`.)
"""

import re
from pathlib import Path

import numpy as np

from termwise.scenes.images.image import REC709_COLORS, Image, check_size, conversion, cut_short, in_rec709
from termwise.scenes.numerals import reals

MANTISSA = 2.0**-8
"""Half a step of the smallest mantissa of the largest channel, relative."""
_SIZE = re.compile(rb"([-+][XY]) +(\d{1,9}) +([-+][XY]) +(\d{1,9})\n")
_BACKWARDS = b"+Y", b"-X"


def read(path: Path, layer: str | None) -> list[Image]:
    """The image of a Radiance file; a ValueError says what is wrong."""
    if layer is not None:
        raise ValueError(f"{path}: layer = {layer!r}: a Radiance file has none: allowed is to name none")
    data = path.read_bytes()
    end = data.find(b"\n\n")
    size = _SIZE.match(data, end + 2) if end >= 0 else None
    if size is None or size[1][1:] == size[3][1:]:
        raise ValueError(
            f"{path}: is cut short or damaged in its header: allowed is a blank line, then -Y height +X width"
        )
    slow, fast = int(size[2]), int(size[4])
    check_size(path, fast, slow)
    factors, chromaticities, notes = _header(path, data[:end])
    rgbe = _decoded(path, data, size.end(), slow, fast)
    mantissas, exponents = rgbe[..., :3].astype(np.float32), rgbe[..., 3:].astype(np.int32) - 136
    values = np.where((mantissas > 0) & (exponents > -136), np.ldexp(mantissas + np.float32(0.5), exponents), 0.0)
    pixels = np.asarray(values / factors, np.float32)
    # The slow axis comes first; -Y runs down, +X to the right.
    if size[3] in _BACKWARDS:
        pixels = pixels[:, ::-1]
    if size[1] in _BACKWARDS:
        pixels = pixels[::-1]
    if size[1][1:] == b"X":
        pixels = pixels.swapaxes(0, 1)
    colors = REC709_COLORS
    if chromaticities:
        pixels, colors = in_rec709(path, pixels, chromaticities)
    height, width = pixels.shape[:2]
    return [Image(pixels, (0, 0, width - 1, height - 1), MANTISSA, notes + conversion(colors), colors)]


def _header(path: Path, text: bytes) -> tuple[np.ndarray, list[float], tuple[str, ...]]:
    """Factors that were applied to the channels, chromaticities where they are given, and notes."""
    factors, chromaticities = np.ones(3), []
    notes = ("8-bit mantissas of Radiance HDR: each value is known to 0.4 % only",)
    for line in text.decode("latin-1").splitlines()[1:]:
        name, _, value = (each.strip() for each in line.partition("="))
        if name == "FORMAT" and value != "32-bit_rle_rgbe":
            raise ValueError(f"{path}: FORMAT={value}: allowed is 32-bit_rle_rgbe")
        if name not in ("EXPOSURE", "COLORCORR", "PRIMARIES", "GAMMA"):
            continue
        try:
            numbers = reals(value.split())
        except ValueError:
            numbers = []
        if len(numbers) != {"COLORCORR": 3, "PRIMARIES": 8}.get(name, 1) or not np.isfinite(numbers).all():
            raise ValueError(f"{path}: {name}={value}: allowed are numbers: is it damaged?")
        if name == "GAMMA" and numbers != [1.0]:
            raise ValueError(f"{path}: GAMMA={value}: allowed is linear radiance, 1")
        if name in ("EXPOSURE", "COLORCORR"):
            if not all(number > 0 for number in numbers):
                raise ValueError(f"{path}: {name}={value}: allowed are positive numbers")
            factors = factors * numbers
        if name == "PRIMARIES":
            chromaticities = numbers
    if (factors != 1).any():
        notes += (f"divided by the factors in its header ({', '.join(f'{each:g}' for each in factors)})",)
    return factors, chromaticities, notes


def _decoded(path: Path, data: bytes, start: int, lines: int, width: int) -> np.ndarray:
    """Bytes (lines, width, 4) of the pixels."""
    in_runs = 8 <= width < 2**15 and data[start : start + 2] == b"\2\2"
    if not in_runs:
        if len(data) - start != 4 * lines * width:
            raise cut_short(path, f"{len(data) - start} of {4 * lines * width} bytes of pixels")
        return np.frombuffer(data, np.uint8, offset=start).reshape(lines, width, 4)
    pixels = np.empty((lines, 4, width), np.uint8)
    at = start
    for line in range(lines):
        if len(data) < at + 4:
            raise cut_short(path, f"{line} of {lines} lines")
        if data[at : at + 4] != bytes((2, 2, width >> 8, width & 255)):
            raise ValueError(f"{path}: is damaged in line {line}: write or copy it again")
        at += 4
        for channel in range(4):
            at = _channel(path, data, at, pixels[line, channel], line)
    if at != len(data):
        raise ValueError(f"{path}: has {len(data) - at} bytes behind its pixels: is it damaged?")
    return pixels.transpose(0, 2, 1)


def _channel(path: Path, data: bytes, at: int, into: np.ndarray, line: int) -> int:
    """Decode the runs of a channel of a line; returns where the next begins."""
    x, width = 0, len(into)
    while x < width:
        if at + 1 >= len(data):
            raise cut_short(path, f"it ends in line {line} of {width} pixels")
        repeated, count = data[at] > 128, data[at]
        count -= 128 * repeated
        stored = 1 if repeated else count
        run = np.frombuffer(data, np.uint8, min(stored, len(data) - at - 1), at + 1)
        if len(run) < stored:
            raise cut_short(path, f"it ends in line {line}")
        if count == 0 or count > width - x:
            raise ValueError(f"{path}: is damaged in line {line}: write or copy it again")
        into[x : x + count] = run
        x, at = x + count, at + 1 + stored
    return at
