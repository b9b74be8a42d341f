"""Pictures of radiance and of its signed error, as 8-bit PNG.

Radiance is shown at the scene's fixed exposure, sRGB-encoded. The error is one number a pixel,

    e = Y(ours - reference) / mean Y(reference),

Y the luminance, from blue (too dark) over white to red (too bright) on a scale ±q that all variants of a
term share; q is a quantile of |e|, so that one firefly does not pale the rest.
"""

from pathlib import Path

import numpy as np
from PIL import Image
from plotly.colors import diverging, unlabel_rgb

from reports.metrics import encode
from reports.verdict import LUMINANCE
from scenes.store import write_atomically

QUANTILE = 0.99
"""Share of the pixels whose error lies within the scale."""
INVALID = np.array([255, 0, 255], np.uint8)
"""Colour of a pixel that is NaN or infinite: found in no exposure of a real scene by chance."""

# ColorBrewer's RdBu, safe for colour-blind eyes; its middle is made white, since 0 is no error.
_KNOTS = np.array([unlabel_rgb(colour) for colour in reversed(diverging.RdBu)])
_KNOTS[len(_KNOTS) // 2] = 255.0
_LEVELS = 255  # odd: 0 has a level of its own
_DIVERGING = np.stack(
    [np.interp(np.linspace(0, len(_KNOTS) - 1, _LEVELS), np.arange(len(_KNOTS)), c) for c in _KNOTS.T], axis=1
)


def display(radiance: np.ndarray, *, exposure: float) -> np.ndarray:
    """(H, W, 3) uint8 sRGB of linear Rec. 709 radiance; invalid pixels in magenta."""
    valid = np.isfinite(radiance).all(axis=-1, keepdims=True)
    shown = np.round(255 * encode(np.where(valid, radiance, 0.0), exposure=exposure)).astype(np.uint8)
    return np.where(valid, shown, INVALID)


def relative_error(ours: np.ndarray, reference: np.ndarray) -> tuple[np.ndarray, float]:
    """Signed luminance error (H, W) and the radiance that it is relative to.

    That is the reference's mean; ours' where the reference is black, 1 where both are.
    """
    luminances = [np.asarray(image, np.float64) @ LUMINANCE for image in (ours, reference)]
    means = [
        float(np.mean(each[np.isfinite(each)])) if np.isfinite(each).any() else 0.0 for each in luminances
    ]
    scale = next((mean for mean in reversed(means) if mean > 0), 1.0)
    return (luminances[0] - luminances[1]) / scale, scale


def error_scale(errors: list[np.ndarray]) -> float:
    """q: the quantile of |e| over several error images, rounded up to two digits; 1 if nothing differs."""
    magnitudes = np.abs(np.concatenate([error.ravel() for error in errors]))
    magnitudes = magnitudes[np.isfinite(magnitudes)]
    q = float(np.quantile(magnitudes, QUANTILE)) if magnitudes.size else 0.0
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
    level = np.round((share + 1.0) / 2.0 * (_LEVELS - 1)).astype(int)
    return np.where(valid[..., None], np.round(_DIVERGING[level]).astype(np.uint8), INVALID)


def write_png(path: Path, radiance: np.ndarray, *, exposure: float) -> None:
    """Write (H, W, 3) linear radiance as an 8-bit sRGB PNG; it appears whole or not at all."""
    save(path, display(radiance, exposure=exposure))


def save(path: Path, pixels: np.ndarray) -> None:
    """Write (H, W, 3) uint8 as PNG; it appears whole or not at all."""
    image = Image.fromarray(np.ascontiguousarray(pixels))
    write_atomically(path, lambda temporary: image.save(temporary, format="PNG", optimize=True))
