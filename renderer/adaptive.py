"""Adaptive counts: a pilot decides how many samples each tile gets, and is discarded, so that the mean stays unbiased.

With a variance v of one sample, A pixels in a tile and `sum A n` samples to spend, the mean square error `sum A v / n`
is least for `n ~ sqrt(v)` (Neyman, 1934). Counts are powers of two times the mean, where Sobol points are best.
Where nothing varies one sample says it all.
A decision made by samples that are used as well would be biased (Kirk, Arvo, "Unbiased Sampling Techniques for Image
Synthesis", SIGGRAPH 1991).
"""

import numpy as np

from termwise.renderer.film import Tile

SIDE = 8  # pixels of a tile: its variance is estimated from 64 pixels, and a call of a kernel costs what 200 samples do
PILOT = 4  # samples a pixel of each of the two pilot images
# No tile that varies gets less than a quarter of the mean: a pilot of 8 samples may have missed what is rare.
_LEAST, _MOST = -2, 4


def shares(tiles: list[Tile], one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Samples of each tile over the mean count, powers of two, or 0 for one; their mean over pixels is at most 1.

    One sample is enough where neither a tile nor what is beside it varies: 4608 samples of the pilot say so.

    Parameters
    ----------
    tiles : the tiles.
    one, other : (H, W, 3), two independent images of equal counts.
    """
    square = ((one - other) ** 2).sum(axis=-1)
    deviation = np.sqrt([square[t.y0 : t.y1, t.x0 : t.x1].mean() for t in tiles])
    pixels = np.array([(t.y1 - t.y0) * (t.x1 - t.x0) for t in tiles])
    quiet = np.array(
        [not square[max(0, t.y0 - SIDE) : t.y1 + SIDE, max(0, t.x0 - SIDE) : t.x1 + SIDE].any() for t in tiles]
    )
    if quiet.all():
        return np.zeros(len(tiles))
    with np.errstate(divide="ignore"):
        power = np.log2(deviation / (pixels @ deviation / pixels.sum()))
    # The largest common factor that spends no more than asked for.
    for factor in np.arange(2.0, -4.0, -1 / 16):
        found = np.where(quiet, 0.0, 2.0 ** np.clip(np.round(power + factor), _LEAST, _MOST))
        if pixels @ found <= pixels.sum():
            return found
    return np.ones(len(tiles))
