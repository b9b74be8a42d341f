"""Where an error is: Welch's test of "no bias at all" in each tile (Jung, Hanika, Dachsbacher, JCGT 2020).

Of m p-values, the i-th smallest p_(i) is adjusted for the size of the map by

    Holm                max_{j ≤ i} (m - j + 1) p_(j)      any false tile in 5 % of maps
    Benjamini-Hochberg  min_{j ≥ i} (m / j) p_(j)          5 % of the tiles found are false, on average

and a tile is found where the adjusted p is at most 5 %. Each map has its own 5 %, and no bias is tolerated in it: it
shows where to look, and the verdict, whose level is that of the whole run, decides.

Luminance is tested first, channels in the tiles that Holm finds by it. Their p-values are adjusted over all three
channels of all tiles: whichever tiles luminance picks out, a false channel is named in 5 % of maps at most.

Under the null p is uniform, if the means over a tile are about normal: where the replicates of half the tiles have a
skewness above 1, tiles of this size are merged into those of the next one.
"""

from collections.abc import Callable
from typing import Any

import attrs
import numpy as np
from scipy import stats

from termwise.reports.statistics.accumulation import Statistics
from termwise.reports.statistics.replicates import CHANNELS, TILE_SIDES

LEVEL = 0.05
"""Of one map."""
SKEWNESS = 1.0
"""Median over the tiles of a size, above which they are merged."""
BINS = 20
"""Of a p-histogram, over [0, 1]."""
LISTED_TILES = 10
MAPS = "bias", "p", "holm", "benjamini_hochberg"
"""Those that `results.nc` keeps."""


@attrs.frozen(eq=False)
class TileMap:
    """The tests of all tiles of one size.

    Attributes
    ----------
    side : in pixels; tiles at the right and lower border may be smaller.
    height, width : of the image.
    skewness : median over the tiles.
    merged_into : the side of the tiles that stand for these, all of whose values are NaN then.
    bias : (rows, columns) float64, of luminance, relative to the larger of the tile's mean and the typical one.
    p : (rows, columns) float64, of no bias in luminance; NaN where all replicates of both sides are the same number.
    holm, benjamini_hochberg : (rows, columns) float64, adjusted p, at most 1.
    channels : (3, rows, columns) float64, p of each channel, adjusted by Holm over all channels of all tiles.
    noiseless : (rows, columns) bool
        Neither side varies: p is that of the rounding floor, and left out of the histogram.
    """

    side: int
    height: int
    width: int
    skewness: float
    merged_into: int | None
    bias: np.ndarray
    p: np.ndarray
    holm: np.ndarray
    benjamini_hochberg: np.ndarray
    channels: np.ndarray
    noiseless: np.ndarray

    @property
    def rejected(self) -> np.ndarray:
        """(n, 2) row and column of the tiles found by Holm, the surest first."""
        found = np.argwhere(self.holm <= LEVEL)
        return found[np.argsort(self.p[tuple(found.T)], kind="stable")]

    @property
    def varying(self) -> np.ndarray:
        """The p-values of the tiles that vary: uniform under the null."""
        return self.p[~self.noiseless & np.isfinite(self.p)]


def tile_maps(statistics: Statistics) -> dict[int, TileMap]:
    """Test the tiles of a row, by their side: 8, 16 and 32 px."""
    return {side: _tested(statistics, side) for side in TILE_SIDES}


def _tested(statistics: Statistics, side: int) -> TileMap:
    even = (each for each in TILE_SIDES if each >= side and statistics.tile_skewness[each] <= SKEWNESS)
    stands = next(even, TILE_SIDES[-1])
    tested = statistics.tiles[side]
    luminance, *channels = tested.p_values()

    def unless_merged(values: np.ndarray) -> np.ndarray:
        return values if stands == side else np.full_like(values, np.nan)

    p = unless_merged(luminance)
    return TileMap(
        side=side,
        height=statistics.height,
        width=statistics.width,
        skewness=statistics.tile_skewness[side],
        merged_into=None if stands == side else stands,
        bias=unless_merged(tested.bias[0]),
        p=p,
        holm=_adjusted(p, holm),
        benjamini_hochberg=_adjusted(p, stats.false_discovery_control),
        channels=_adjusted(unless_merged(np.array(channels)), holm),
        noiseless=tested.noiseless[0],
    )


def _adjusted(p: np.ndarray, adjust: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Adjust what is not NaN."""
    adjusted, tested = np.full_like(p, np.nan), np.isfinite(p)
    if tested.any():
        adjusted[tested] = adjust(p[tested])
    return adjusted


def holm(p: np.ndarray) -> np.ndarray:
    """Adjust (m,) p-values: rejecting those up to α errs anywhere with probability α at most (Holm 1979)."""
    order = np.argsort(p)
    adjusted = np.empty_like(p)
    adjusted[order] = np.maximum.accumulate(np.arange(len(p), 0, -1) * p[order]).clip(max=1.0)
    return adjusted


def summary(maps: dict[int, TileMap]) -> list[dict[str, Any]]:
    """What `results.json` holds of each size.

    Returns
    -------
    `side`, `tiles`, `tested`; `holm` and `benjamini_hochberg`: tiles found; `fraction`: the latter of those tested;
    `found`: the surest that Holm finds, with `bias`, adjusted `p` and `channels`; `histogram`: counts of p, `left_out`
    of it where neither side varies; `uniform_p` of the Kolmogorov-Smirnov test that p is uniform, None without p;
    `skewness`; `merged_into`, the side of the tiles that stand for these, or None.
    """
    return [_summary(each) for each in maps.values()]


def _summary(tiles: TileMap) -> dict[str, Any]:
    tested, varying = int(np.isfinite(tiles.p).sum()), tiles.varying
    found = int((tiles.benjamini_hochberg <= LEVEL).sum())
    return {
        "side": tiles.side,
        "tiles": tiles.p.size,
        "tested": tested,
        "holm": len(tiles.rejected),
        "benjamini_hochberg": found,
        "fraction": found / tested if tested else 0.0,
        "found": [_described(tiles, row, column) for row, column in tiles.rejected[:LISTED_TILES].tolist()],
        "histogram": np.histogram(varying, bins=BINS, range=(0.0, 1.0))[0].tolist(),
        "left_out": int(tiles.noiseless.sum()),
        "uniform_p": float(stats.kstest(varying, "uniform").pvalue) if varying.size else None,
        "skewness": tiles.skewness,
        "merged_into": tiles.merged_into,
    }


def _described(tiles: TileMap, row: int, column: int) -> dict[str, Any]:
    x, y = tiles.side * column, tiles.side * row
    return {
        "x": x,
        "y": y,
        "width": min(tiles.side, tiles.width - x),
        "height": min(tiles.side, tiles.height - y),
        "bias": float(tiles.bias[row, column]),
        "p": float(tiles.holm[row, column]),
        "channels": [name for c, name in enumerate(CHANNELS) if tiles.channels[c, row, column] <= LEVEL],
    }


def variables(cells: list[dict[int, TileMap] | None]) -> dict[str, tuple[tuple[str, ...], np.ndarray]]:
    """The maps of a scene's cells as variables of `results.nc`, NaN for a cell without any.

    `tile_p_8`, `tile_holm_8`, `tile_benjamini_hochberg_8` and `tile_bias_8` (cell, tile_y_8, tile_x_8), and so for
    16 and 32.
    """
    known = next((maps for maps in cells if maps is not None), {})
    return {
        f"tile_{name}_{side}": (
            ("cell", f"tile_y_{side}", f"tile_x_{side}"),
            np.stack([np.full_like(like.p, np.nan) if maps is None else getattr(maps[side], name) for maps in cells]),
        )
        for side, like in known.items()
        for name in MAPS
    }
