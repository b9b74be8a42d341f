"""Which pixels are compared as what, from files: index images and masks."""

import re
from pathlib import Path

import numpy as np

INDEX_KINDS = "PNG of indices, NPY, OpenEXR of one channel"
MOST_OBJECTS = 4096
"""An index image with more of them is none, but say a depth."""


def index_image(path: Path) -> np.ndarray:
    """Objects by pixel, (H, W) int: the numbers of an index image, or one for each colour of a picture of colours.

    Raises
    ------
    ValueError : for a file of another kind, or numbers that are not whole, as smoothed edges make them.
    """
    values = _planes(path)
    if values.ndim == 3:
        _, inverse = np.unique(values.reshape(-1, values.shape[2]), axis=0, return_inverse=True)
        values = inverse.reshape(values.shape[:2])
    whole = np.round(values)
    if not (np.isfinite(values).all() and np.abs(values - whole).max() < 1e-3):
        raise ValueError(f"{path}: holds numbers that are not whole: allowed is an index image without smoothed edges")
    objects = whole.astype(np.int64)
    if (found := len(np.unique(objects))) > MOST_OBJECTS:
        raise ValueError(f"{path}: holds {found} objects: allowed are {MOST_OBJECTS}; is it an index image?")
    return objects


def mask_image(path: Path) -> np.ndarray:
    """Pixels that are compared, (H, W) bool: where any channel is above 0."""
    values = _planes(path)
    if not np.isfinite(values).all():
        raise ValueError(f"{path}: holds values that are not finite: allowed are numbers, 0 where nothing counts")
    return np.any(values > 0, axis=2) if values.ndim == 3 else values > 0


def _planes(path: Path) -> np.ndarray:
    """(H, W) numbers, or (H, W, C) colours without alpha."""
    if not path.is_file():
        raise ValueError(f"{path}: no such file: allowed are {INDEX_KINDS}")
    if path.suffix.lower() == ".exr":
        values = _exr_planes(path)
    else:
        try:
            values = np.load(path, allow_pickle=False) if path.suffix.lower() == ".npy" else _picture(path)
        except (OSError, ValueError, RuntimeError, EOFError) as error:
            why = " ".join(str(error).split())
            raise ValueError(
                f"{path}: cannot be read as an index image or mask ({why}): allowed are {INDEX_KINDS}"
            ) from None
    values = values.squeeze(-1) if values.ndim == 3 and values.shape[2] == 1 else values
    if values.ndim not in (2, 3) or values.dtype.kind not in "biuf":
        raise ValueError(f"{path}: {values.dtype} {values.shape}: allowed is one number a pixel, or a colour")
    return values


def _picture(path: Path) -> np.ndarray:
    from PIL import Image

    with Image.open(path) as image:
        # A palette's indices are the objects; of grey with alpha, grey.
        mode = {"P": "P", "1": "L", "LA": "L", "RGBA": "RGB", "PA": "P"}.get(image.mode, image.mode)
        return np.asarray(image if mode == image.mode else image.convert(mode))


def _exr_planes(path: Path) -> np.ndarray:
    """The one channel of a file, whatever it is called; that of an index among several; else its colours."""
    from termwise.scenes.images import openexr

    channels = openexr.read_channels(path)
    colours = [name for name in channels if name.rpartition(".")[2].upper() in ("R", "G", "B")]
    indices = [name for name in channels if re.search(r"index|object|\bid\b", name, re.IGNORECASE)]
    chosen = list(channels) if len(channels) == 1 else indices or colours
    if len(chosen) not in (1, 3):
        raise ValueError(f"{path}: its channels are {', '.join(channels)}, where one is allowed, or R, G and B")
    return channels[chosen[0]] if len(chosen) == 1 else np.stack([channels[name] for name in chosen], axis=-1)
