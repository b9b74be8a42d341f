"""Pictures of radiance and of its signed error, as 8-bit PNG.

Radiance is shown at the scene's fixed exposure, sRGB-encoded. The error is one number a pixel,

    e = Y(ours - reference) / mean Y(reference),

Y the luminance, from blue (too dark) over white to red (too bright) on a scale ±q that all variants of a
term share; q is a quantile of |e|, so that one firefly does not pale the rest.

A p-map shows one tile in one colour: grey where no bias is found, in the error's colours where Benjamini and Hochberg
find one, the fuller the surer, and outlined where Holm does.
"""

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from plotly.colors import diverging, hex_to_rgb, sequential, unlabel_rgb

from termwise.reports.statistics.metrics import encode
from termwise.reports.statistics.replicates import LUMINANCE
from termwise.reports.statistics.tiles import LEVEL
from termwise.scenes.store import write_atomically

QUANTILE = 0.99
"""Share of the pixels whose error lies within the scale."""
MIDDLE_GREY = 0.18
"""What the mean of a reference is shown as where no exposure is known."""
INVALID = np.array([255, 0, 255], np.uint8)
"""Colour of a pixel that is NaN or infinite: found in no exposure of a real scene by chance."""
MAP_SIZE = 512
"""Pixels of a p-map's longer side, at least."""
SURE = 1e-6
"""Adjusted p that has the full colour."""

PALEST = 0.4
"""Of the full colour, what a tile has that is just found: it stands out against grey."""
GREYS = 200, 250
"""Of a tile that is not found, at p = 0 and p = 1."""
NOTHING = 110
"""Grey where neither side has anything."""
_OUTLINE = 3
_ROWS = 16
"""That are drawn at a time: what is made of them in between stays in a processor's cache."""
_OPTIMIZED = 2**19
"""Pixels of the largest picture whose file is made as small as can be."""

# ColorBrewer's RdBu, safe for colour-blind eyes; its middle is made white, since 0 is no error.
_KNOTS = np.array([unlabel_rgb(colour) for colour in reversed(diverging.RdBu)])
_KNOTS[len(_KNOTS) // 2] = 255.0
_RISING = np.array([hex_to_rgb(colour) for colour in sequential.Viridis], np.float64)
_LEVELS = 255  # odd: 0 has a level of its own
_SPREAD = [np.interp(np.linspace(0, len(_KNOTS) - 1, _LEVELS), np.arange(len(_KNOTS)), c) for c in _KNOTS.T]
_DIVERGING = np.vstack([np.round(_SPREAD).T.astype(np.uint8), INVALID])


def display(radiance: np.ndarray, *, exposure: float, gamma: float | None = None) -> np.ndarray:
    """(H, W, 3) uint8 of linear Rec. 709 radiance, by sRGB's curve or v^(1/gamma); invalid pixels in magenta."""
    shown = np.empty(radiance.shape, np.uint8)
    for top in range(0, len(radiance), _ROWS):
        band = radiance[top : top + _ROWS]
        valid = np.isfinite(band).all(axis=-1, keepdims=True)
        encoded = encode(np.where(valid, band, 0.0), exposure=exposure, gamma=gamma)
        shown[top : top + _ROWS] = np.where(valid, np.round(255 * encoded).astype(np.uint8), INVALID)
    return shown


def shown_at(reference: np.ndarray) -> float:
    """The exposure at which the mean of a reference is middle grey."""
    mean = float(np.mean(np.asarray(reference, np.float64) @ LUMINANCE))
    return MIDDLE_GREY / mean if np.isfinite(mean) and mean > 0 else 1.0


def relative_error(ours: np.ndarray, reference: np.ndarray) -> tuple[np.ndarray, float]:
    """Signed luminance error (H, W) and the radiance that it is relative to.

    That is the reference's mean; ours' where the reference is black, 1 where both are.
    """
    luminances = [np.asarray(image, np.float64) @ LUMINANCE for image in (ours, reference)]
    means = [float(np.mean(each[np.isfinite(each)])) if np.isfinite(each).any() else 0.0 for each in luminances]
    scale = next((mean for mean in reversed(means) if mean > 0), 1.0)
    return (luminances[0] - luminances[1]) / scale, scale


def channel_errors(ours: np.ndarray, reference: np.ndarray, scale: float) -> np.ndarray:
    """Signed errors (H, W, 3) of the channels, of `scale`, that of `relative_error`."""
    return (np.asarray(ours, np.float64) - np.asarray(reference, np.float64)) / scale


def error_scale(errors: list[np.ndarray]) -> float:
    """q: the quantile of |e| over several error images, rounded up to two digits; 1 if nothing differs."""
    magnitudes = np.concatenate([error.ravel() for error in errors])
    np.abs(magnitudes, out=magnitudes)
    if not (finite := np.isfinite(magnitudes)).all():
        magnitudes = magnitudes[finite]
    q = float(np.quantile(magnitudes, QUANTILE, overwrite_input=True)) if magnitudes.size else 0.0
    if q == 0.0:
        q = float(magnitudes.max(initial=0.0))
    if q == 0.0:
        return 1.0
    step = 10.0 ** (np.floor(np.log10(q)) - 1)
    return float(np.ceil(q / step) * step)


def diverge(error: np.ndarray, *, scale: float) -> np.ndarray:
    """(..., 3) uint8 colours of signed errors in ±scale; beyond it the end colours, invalid in magenta."""
    valid = np.isfinite(error)
    share = np.clip(np.where(valid, error, 0.0) / scale, -1.0, 1.0)
    level = np.round((share + 1.0) / 2.0 * (_LEVELS - 1)).astype(np.uint8)
    return _DIVERGING[np.where(valid, level, _LEVELS)]


def rise(values: np.ndarray, *, low: float, high: float) -> np.ndarray:
    """(H, W, 3) uint8 colours of numbers (H, W) above 0, by their logarithm from dark to bright; grey where NaN."""
    place = np.log(np.where(np.isfinite(values), values, low) / low) / np.log(high / low)
    shown = np.stack([np.interp(place, np.linspace(0, 1, len(_RISING)), c) for c in _RISING.T], axis=-1)
    return np.where(np.isfinite(values)[..., None], np.round(shown).astype(np.uint8), np.uint8(NOTHING))


def p_map(
    p: np.ndarray,
    holm: np.ndarray,
    benjamini_hochberg: np.ndarray,
    bias: np.ndarray,
    *,
    side: int,
    size: tuple[int, int],
) -> np.ndarray:
    """(zoom H, zoom W, 3) uint8 picture of a map of tiles.

    Parameters
    ----------
    p, holm, benjamini_hochberg, bias : (rows, columns) float
        As in `reports.statistics.tiles.TileMap`; only the sign of the bias is shown.
    side : of a tile, in pixels of the image.
    size : (int, int), H and W of the image; it is shown at a whole multiple of them.
    """
    grey = np.where(np.isfinite(p), GREYS[0] + (GREYS[1] - GREYS[0]) * np.nan_to_num(p), NOTHING)
    surely = np.log(np.maximum(benjamini_hochberg, SURE) / LEVEL) / np.log(SURE / LEVEL)
    colours = diverge(np.sign(bias) * (PALEST + (1.0 - PALEST) * surely), scale=1.0)
    found = benjamini_hochberg <= LEVEL
    tiles = np.where(found[..., None], colours, np.round(grey)[..., None].astype(np.uint8))

    zoom = max(1, -(-MAP_SIZE // max(size)))
    height, width = (zoom * length for length in size)
    picture = tiles.repeat(zoom * side, axis=0).repeat(zoom * side, axis=1)[:height, :width]
    line = min(_OUTLINE, max(1, zoom * side // 6))
    for row, column in np.argwhere(holm <= LEVEL):
        top, left = zoom * side * row, zoom * side * column
        tile = picture[top : top + zoom * side, left : left + zoom * side]
        tile[:line] = tile[-line:] = 0
        tile[:, :line] = tile[:, -line:] = 0
    return picture


def write_png(path: Path, radiance: np.ndarray, *, exposure: float) -> None:
    """Write (H, W, 3) linear radiance as an 8-bit sRGB PNG; it appears whole or not at all."""
    save(path, display(radiance, exposure=exposure))


def save(path: Path, pixels: np.ndarray) -> None:
    """Write (H, W, 3) uint8 as PNG; it appears whole or not at all."""
    image = Image.fromarray(np.ascontiguousarray(pixels))
    # Of large images the smallest file takes many times as long as one that is little larger.
    how: dict[str, Any] = {"optimize": True} if pixels[..., 0].size <= _OPTIMIZED else {"compress_level": 1}
    write_atomically(path, lambda temporary: image.save(temporary, format="PNG", **how))
