"""What a file's image is: its pixels, where they stand, how coarsely they were rounded; and colours as Rec. 709."""

from collections.abc import Sequence
from pathlib import Path

import attrs
import numpy as np

Window = tuple[int, int, int, int]
"""First column and row, last column and row."""

HALF = 2.0**-11
"""Half a step of a half-precision float, relative."""
HALF_NOTE = f"half floats: a value is known to {HALF:.2%}, and no bias below that is looked for"
LOSSY = 2.0**-7
"""Of lossy compression with its usual settings: means over 8 px of noise came out wrong by up to so much, rms."""
GREY, REC709_COLORS = "grey", "Rec. 709"
"""What an image's numbers are."""
LARGEST = 2**28
"""Pixels of the largest image that is read: beyond, a damaged header is more likely than a picture."""

REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""Chromaticities x, y of red, green, blue and white (ITU-R BT.709-6, section 1)."""
_XYZ = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3)


@attrs.frozen(eq=False)
class Image:
    """An image from a file.

    Attributes
    ----------
    pixels : (H, W, 3) float32, or float64 where the file holds that; linear Rec. 709, top row first.
    window : the display window, H by W pixels; it begins at (0, 0) in formats without one.
    quantum : how far rounding may have moved a value, relative: 0 for float, 2⁻¹¹ for half.
    notes : what was done to the pixels, in words.
    colors : what the file's numbers were: "grey" of one channel, "CIE XYZ", other chromaticities in words.
    data : the part of the display window that the file holds, where that is less; what lies outside is black.
    """

    pixels: np.ndarray
    window: Window
    quantum: float = 0.0
    notes: tuple[str, ...] = ()
    colors: str = REC709_COLORS
    data: Window | None = None

    @classmethod
    def of_array(cls, path: Path, array: np.ndarray, notes: tuple[str, ...] = ()) -> "Image":
        """From (H, W) grey or (H, W, C) with 1 (grey), 3 (RGB) or 4 (RGBA, premultiplied: A is dropped) channels."""
        if array.dtype.kind != "f":
            bits = f"{8 * array.dtype.itemsize}-bit integers" if array.dtype.kind in "iu" else f"{array.dtype} values"
            raise ValueError(f"{path}: holds {bits}, which radiance is not: allowed are floats: write float32")
        shape = array.shape
        if array.ndim == 2:
            array = array[..., None]
        if array.ndim != 3 or array.shape[2] not in (1, 3, 4) or 0 in array.shape:
            raise ValueError(f"{path}: shape {shape}: allowed are (height, width) and (height, width, 1, 3 or 4)")
        check_size(path, *array.shape[1::-1])
        if array.dtype.itemsize == 2:
            notes += (HALF_NOTE,)
        quantum = HALF if array.dtype.itemsize == 2 else 0.0
        kept = array.astype(np.float32 if array.dtype.itemsize <= 4 else np.float64, copy=False)
        rgb = np.repeat(kept, 3, axis=2) if kept.shape[2] == 1 else kept[..., :3]
        colors = GREY if kept.shape[2] == 1 else REC709_COLORS
        return cls(rgb, (0, 0, rgb.shape[1] - 1, rgb.shape[0] - 1), quantum, notes, colors)


def check_size(path: Path, width: int, height: int) -> None:
    """Refuse images without pixels, and those too large to be true."""
    if not (width > 0 and height > 0 and width * height <= LARGEST):
        raise ValueError(
            f"{path}: says that it is {width} x {height} pixels: allowed are 1 to {LARGEST}: is it damaged?"
        )


def cut_short(path: Path, lacking: str) -> ValueError:
    """For a file whose end is missing."""
    return ValueError(f"{path}: is cut short: {lacking}: write or copy it again")


def in_rec709(path: Path | str, pixels: np.ndarray, chromaticities: Sequence[float]) -> tuple[np.ndarray, str]:
    """Pixels of other primaries as Rec. 709, and what they were; `path`, or other words, leads a message.

    `XYZ = P diag(P⁻¹ W) RGB`, with the primaries' (x, y, 1 - x - y) as the columns of P and the white W of luminance 1.

    Raises
    ------
    ValueError : for primaries that span nothing, or a white that is not Rec. 709's: whether a neutral grey then stays
        one (adaptation) no file says. CIE XYZ has no such choice.
    """
    given = np.array(chromaticities, np.float64)
    if np.allclose(given, REC709, atol=1e-4, rtol=0):
        return pixels, REC709_COLORS
    words = ", ".join(f"{value:.4g}" for value in given)
    if not np.isfinite(given).all() or abs(np.linalg.det(_columns(given)[:, :3])) < 1e-6 or given[7] <= 0:
        raise ValueError(f"{path}: chromaticities ({words}) are those of no colour space: write linear Rec. 709")
    is_xyz = np.allclose(given, _XYZ, atol=1e-4, rtol=0)
    if not is_xyz and not np.allclose(given[6:], REC709[6:], atol=1e-3, rtol=0):
        raise ValueError(
            f"{path}: chromaticities ({words}) have another white than Rec. 709, ({REC709[6]}, {REC709[7]}), "
            "and whether greys are meant to stay grey is not said: write linear Rec. 709 (sRGB primaries)"
        )
    matrix = np.linalg.solve(_to_xyz(np.array(REC709)), _to_xyz(given))
    converted = (pixels @ matrix.T.astype(pixels.dtype)).astype(pixels.dtype, copy=False)
    return converted, "CIE XYZ" if is_xyz else f"chromaticities ({words})"


def conversion(colors: str) -> tuple[str, ...]:
    """The note of an image that was converted."""
    return () if colors in (GREY, REC709_COLORS) else (f"converted to Rec. 709 from {colors}",)


def _columns(chromaticities: np.ndarray) -> np.ndarray:
    x, y = chromaticities.reshape(4, 2).T
    return np.stack([x, y, 1 - x - y])


def _to_xyz(chromaticities: np.ndarray) -> np.ndarray:
    columns = _columns(chromaticities)
    primaries, white = columns[:, :3], columns[:, 3] / chromaticities[7]
    return primaries * np.linalg.solve(primaries, white)


def luminance_weights(chromaticities: Sequence[float]) -> np.ndarray:
    """Of red, green and blue in Y, (3,) float64."""
    return _to_xyz(np.array(chromaticities, np.float64))[1]
