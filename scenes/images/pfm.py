"""PFM: a line of text with size and byte order, then float32, the lowest row first."""

import re
from pathlib import Path

import numpy as np

from termwise.scenes.images.image import Image, check_size, cut_short

_HEADER = re.compile(rb"(PF|Pf)\s+(\d{1,9})\s+(\d{1,9})\s+([-+.\deE]+)\s")


def read(path: Path, layer: str | None) -> list[Image]:
    """The image of a PFM file, colour or grey; a ValueError says what is wrong."""
    if layer is not None:
        raise ValueError(f"{path}: layer = {layer!r}: a PFM file has none: allowed is to name none")
    data = path.read_bytes()
    header = _HEADER.match(data)
    try:
        scale = float(header[4]) if header else np.nan
    except ValueError:
        scale = np.nan
    if header is None or not np.isfinite(scale):
        raise ValueError(f"{path}: is cut short or damaged in its header: allowed is PF or Pf, width, height, scale")
    width, height, channels = int(header[2]), int(header[3]), 3 if header[1] == b"PF" else 1
    check_size(path, width, height)
    if abs(scale) != 1:
        raise ValueError(f"{path}: scale {scale:g}: programs disagree on what it does: allowed are 1 and -1")
    count, stored = 4 * width * height * channels, len(data) - header.end()
    if stored < count:
        raise cut_short(path, f"{stored} of {count} bytes of pixels")
    if stored > count:
        raise ValueError(f"{path}: has {stored - count} bytes behind its {width} x {height} pixels: is it damaged?")
    values = np.frombuffer(data, "<f4" if scale < 0 else ">f4", offset=header.end())
    return [Image.of_array(path, values.reshape(height, width, channels)[::-1])]
