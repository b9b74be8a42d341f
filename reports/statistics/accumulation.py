"""What a row measures, in one reading of all replicates by bands of rows: phase one of a verdict.

Means are taken over the image, each object, tiles of 8, 16 and 32 px, windows of 8 px that overlap by half, and the
outermost rows and columns, and compared by Welch's t (`welch`). The shape of the error is its mean square over single
pixels and over blocks of 2 and 8 px (`jackknife`). A mean tells a bias of a whole place, a tile or a window where it
is, a square what cancels in every mean.
"""

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any

import attrs
import numpy as np
import scipy
from threadpoolctl import threadpool_limits

from termwise.reports.statistics.jackknife import Estimate, Gram, inner_products
from termwise.reports.statistics.replicates import (
    CHANNELS,
    LISTED_PIXELS,
    QUANTITIES,
    REPLICATES_WANTED,
    TILE_SIDES,
    Equality,
    Invalid,
    InvalidPixel,
    bands,
    check,
    check_mask,
    labels,
    luminance_of,
    quantities,
    stacked,
)
from termwise.reports.statistics.verdict import DOMINATED, SHAPE_LIMITS
from termwise.reports.statistics.welch import (
    TERM_FLOOR,
    ULP_FLOOR,
    Comparison,
    cumulants,
    event_size,
    largest_event,
    median_skewness,
    stack,
    welch,
)

IMAGE = "image"
"""Name of the region that is the whole picture."""
BORDERS = ("top row", "bottom row", "left column", "right column")
CELL = 4
"""Side of the blocks that tiles and windows are put together from."""
_PART = 256
"""Columns that are read at a time, whole tiles."""


@attrs.frozen(eq=False)
class Statistics:
    """All that a verdict needs of a row: what `measure` returns.

    Attributes
    ----------
    replicates, reference_replicates : K and R.
    exact : the reference is one image, taken as noise-free.
    height, width : int
    absent : both sides are exactly 0 everywhere.
    reference_is_zero : the reference is exactly 0 everywhere.
    term_mean : luminance mean of the reference in radiance, or the fallback where the reference is 0.
    typical : luminance of the reference in radiance that half of the 8-px tiles with light exceed, or `term_mean` where
        that is smaller: a few bright pixels, which may be most of the mean, do not set it.
    region_names : "image", then each object present.
    regions : Comparison of (regions, 3), means per region and channel, relative to the reference's mean there or to 10
        % of `term_mean` where that is larger.
    luminance : Comparison of (), the image's luminance, relative to `term_mean`.
    rest : Comparison of (), or None
        Where a few bright pixels are most of the image's mean, which is blind to the others then: luminance of the lit
        8-px tiles that are darker than it, each relative to the larger of its own mean, of both sides, and the typical
        one, on average. None elsewhere.
    tiles : luminance, red, green and blue per tile of 8, 16 and 32 px, (4, ceil(H/side), ceil(W/side)), relative to the
        larger of the tile's reference mean and the typical one.
    windows : the same of windows of 8 px, one every 4 px, (4, ceil(H/4) - 1, ceil(W/4) - 1).
    borders : the same of the outermost rows and columns, (4, 4): top, bottom, left, right.
    tile_skewness : of the luminance of a tile over the replicates, bias-corrected: median over the tiles that vary, of
        the side where it is larger; 0 where no tile varies.
    mean_square : θ of luminance, red, green and blue over single pixels and blocks of 2 and 8 px, relative to the
        square of the reference's mean, or of 10 % of `term_mean` where that is larger.
    bias_squared : θ over pixels and channels, in radiance².
    variance, reference_variance : of one replicate, mean over pixels and channels, in radiance².
    non_finite, negative : values of ours that are NaN, infinite (or beyond float32), or negative.
    invalid : the first of them.
    quantum : relative rounding of the stored values of both sides, beyond float32's: what no samples make less.
    warnings : tuple of str
    """

    replicates: int
    reference_replicates: int
    exact: bool
    height: int
    width: int
    absent: bool
    reference_is_zero: bool
    term_mean: float
    typical: float
    region_names: tuple[str, ...]
    regions: Comparison
    luminance: Comparison
    rest: Comparison | None
    tiles: dict[int, Comparison]
    windows: Comparison
    borders: Comparison
    tile_skewness: dict[int, float]
    mean_square: dict[int, tuple[Estimate, ...]]
    bias_squared: Estimate
    variance: float
    reference_variance: float
    non_finite: int
    negative: int
    invalid: tuple[InvalidPixel, ...]
    quantum: float
    warnings: tuple[str, ...]

    @property
    def mean_tests(self) -> int:
        """Tests of a kernel-based row: the means per region and channel. None where the row is absent."""
        return 0 if self.absent else len(CHANNELS) * len(self.region_names)

    @property
    def tests(self) -> int:
        """Tests of this row: means, three of shape, three of places. None where the row is absent."""
        return 0 if self.absent else self.mean_tests + len(self.mean_square) + 3


def measure(
    ours: np.ndarray | Sequence[np.ndarray],
    reference: np.ndarray | Sequence[np.ndarray],
    *,
    objects: np.ndarray | None = None,
    object_names: Sequence[str] = (),
    mask: np.ndarray | None = None,
    scale: float | None = None,
    exact: bool = False,
    noiseless: bool = True,
    allow_negative: bool = False,
    names: Sequence[str] = (),
    reference_names: Sequence[str] = (),
    quantum: tuple[float, float] = (0.0, 0.0),
) -> Statistics:
    """Compare replicate images of ours with replicates of the reference.

    Parameters
    ----------
    ours : (K, H, W, 3) floating, or sequence of (H, W, 3)
        Replicates, linear Rec. 709 radiance; an array or a memory map, read by bands of rows.
    reference : (R, H, W, 3) floating, or sequence of (H, W, 3)
        Replicates of the reference in the same unit; R = 1 with `exact`.
    objects : (H, W) integer, optional
        Object index per pixel, -1 for none; each object present is judged on its own too.
    object_names : name of the object of each index.
    mask : (H, W) bool, optional
        Pixels that are compared; all that is outside counts for nothing.
    scale : radiance that stands for the term's mean where the reference is 0 everywhere: the mean of the total. Without
        it, ours' own mean.
    exact : the one reference image has no noise.
    noiseless : bool
        Ours may be free of noise: where all its replicates are the same image that is a warning, not equal seeds.
    allow_negative : negative radiance is no error, on both sides.
    names, reference_names : what the replicates are called in messages, say their files.
    quantum : relative rounding error of the stored values of ours and of the reference beyond float32's: 2^-11 for half
        floats. It enters the floor of every standard error.

    Returns
    -------
    Invalid values of ours (NaN, infinite) are counted there and replaced by the reference's mean, so that the rest can
    still be measured.

    Raises
    ------
    ValueError : for shapes that do not fit, values that are no floats, fewer than 4 replicates, two replicates that are
        the same image although others differ (or all of ours, unless it may be free of noise), an invalid value in the
        reference, a scale that is not positive, a quantum outside [0, 1).
    """
    ours, reference = stacked("ours", ours, names), stacked("reference", reference, reference_names)
    check(ours, reference, objects, scale, exact)
    if mask is not None:
        check_mask(mask, ours)
        objects = None if objects is None else np.where(mask, objects, -1)
    if not all(0 <= each < 1 for each in quantum):
        raise ValueError(f"quantum is {quantum}; both must lie in [0, 1)")
    count, sizes = len(ours), (len(ours), len(reference))
    called = labels("ours", count, names) + labels("reference", len(reference), reference_names)
    sums = _Sums(sizes, ours.shape[1:3], objects, mask, float(np.hypot(*quantum)))
    equality, invalid = Equality(sum(sizes)), Invalid(called, count, allow_negative)
    # A BLAS that divides products this small among threads takes twice as long; parts are divided here.
    with threadpool_limits(1, "blas"), _mapping(ours.shape[2] > _PART) as in_order:
        for top, band in bands(ours, reference):
            if mask is not None:
                band[:, ~mask[top : top + band.shape[1]]] = 0.0
            compared = in_order(equality.read, [band])
            sums.read(top, invalid.replaced(top, band), in_order)
            list(compared)

    warnings = equality.warnings(called, count, noiseless)
    warnings += _few({"ours": count} if exact else {"ours": count, "the reference": len(reference)})
    reference_is_zero = bool(equality.zero[count:].all())
    term_mean = sums.term_mean(reference_is_zero, scale)
    if not term_mean > 0:
        raise ValueError(f"reference: its mean luminance is {term_mean:.3g}; a relative bias needs one above 0")
    regions = sums.region_means()
    typical = sums.typical(term_mean, reference_is_zero)
    compare = sums.comparison(term_mean, sums.events(typical))
    pixels = Gram(sums.products[1][1:].sum(axis=0) / (3 * sums.pixels), sizes)
    return Statistics(
        replicates=count,
        reference_replicates=len(reference),
        exact=exact,
        height=ours.shape[1],
        width=ours.shape[2],
        absent=bool(equality.zero.all()),
        reference_is_zero=reference_is_zero,
        term_mean=term_mean,
        typical=float(typical[0]),
        region_names=(IMAGE, *_named(sums.objects_present, object_names)),
        regions=compare(regions, sums.areas[:, None], term_mean * (1 if reference_is_zero else 0.1), slice(1, 4)),
        luminance=compare(luminance_of(regions[:, 0]), sums.areas[0], term_mean, 0),
        rest=sums.rest(compare, term_mean, typical[0]) if typical[0] < DOMINATED * term_mean else None,
        tiles={side: sums.places(compare, *tiles, typical) for side, tiles in sums.tiles.items()},
        windows=sums.places(compare, *sums.windows(), typical),
        borders=sums.places(compare, *sums.border_means(), 0.1 * typical),
        tile_skewness={
            side: max(median_skewness(means[:count, 0]), median_skewness(means[count:, 0]))
            for side, (means, _) in sums.tiles.items()
        },
        mean_square=sums.mean_square(term_mean, reference_is_zero),
        bias_squared=pixels.squared_distance(),
        variance=pixels.variance(0).value,
        reference_variance=pixels.variance(1).value,
        non_finite=invalid.non_finite,
        negative=invalid.negative,
        invalid=tuple(invalid.first[:LISTED_PIXELS]),
        quantum=sums.quantum,
        warnings=tuple(warnings),
    )


@contextlib.contextmanager
def _mapping(threaded: bool) -> Iterator[Callable[..., Iterable[Any]]]:
    """`map`, or one that has a thread for each core; results come in order, so that no bit depends on which."""
    if not threaded:
        yield map
        return
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        yield pool.map


def _named(objects: np.ndarray, names: Sequence[str]) -> list[str]:
    return [str(names[i]) if i < len(names) else f"object {i}" for i in objects]


def _few(sides: dict[str, int]) -> list[str]:
    few = [f"{count} of {side}" for side, count in sides.items() if count < REPLICATES_WANTED]
    if not few:
        return []
    return [f"replicates: {' and '.join(few)}: fewer than {REPLICATES_WANTED}, intervals are wide and less sure"]


class _Sums:
    """What the bands of all replicates add up to, small whatever their resolution.

    Attributes
    ----------
    sizes : replicates of ours, which come first, and of the reference; n in all.
    quantum : relative rounding of the values, of both sides.
    products : (4, n, n) float64 by the side of blocks of 1, 2 and 8 px
        Of the replicates' distances from their mean, in luminance, red, green and blue, summed over blocks; of a block
        that is cut by the border by its share.
    reference_square : (4,) sum of the squares of the reference.
    regions, areas : (regions, n, 3) and (regions,) float64
        Sums over the image and each object present, and their pixels.
    borders : (4, n, 3) float64, sums over the outermost rows and columns.
    brightest : the largest value.
    """

    def __init__(
        self,
        sizes: tuple[int, int],
        shape: tuple[int, int],
        objects: np.ndarray | None,
        mask: np.ndarray | None,
        quantum: float,
    ) -> None:
        everyone = sum(sizes)
        present = np.array([], dtype=int) if objects is None else np.unique(objects)
        self.sizes, self.shape, self.quantum = sizes, shape, quantum
        self.objects, self.objects_present = objects, present[present >= 0]
        self.mask = np.ones(shape, dtype=bool) if mask is None else mask
        self.products = {side: np.zeros((4, everyone, everyone)) for side in SHAPE_LIMITS}
        self.reference_square = np.zeros(4)
        self.regions = np.zeros((1 + len(self.objects_present), everyone, 3))
        self.areas = np.zeros(1 + len(self.objects_present))
        self.borders = np.zeros((len(BORDERS), everyone, 3))
        self.brightest = 0.0
        self._rows: list[np.ndarray] = []
        self._areas: list[np.ndarray] = []
        self._cumulants: list[np.ndarray] = []

    def read(self, top: int, band: np.ndarray, in_order: Callable[..., Iterable[Any]]) -> None:
        """Add a band (n, rows, W, 3) of finite values that begins at row `top`; `in_order` is `map` or like it."""
        inside = self.mask[top : top + band.shape[1]].astype(np.float64)
        self.brightest = max(self.brightest, float(band.max()))
        last = top + band.shape[1] == self.shape[0]
        lines = band[:, 0] * (top == 0), band[:, -1] * last, band[:, :, 0], band[:, :, -1]
        self.borders += [line.sum(axis=1) for line in lines]
        parts = [slice(left, left + _PART) for left in range(0, band.shape[2], _PART)]
        read = in_order(self._of_part, [inside[:, part] for part in parts], [band[:, :, part] for part in parts])
        cells, of_pixels, squares, products = zip(*read, strict=True)
        for square, of_sides in zip(squares, products, strict=True):
            self.reference_square += square
            for side, product in of_sides.items():
                self.products[side] += product
        self._rows.append(np.concatenate(cells, axis=-1))
        self._cumulants.append(np.concatenate(of_pixels, axis=-1))
        self._areas.append(block_sums(inside, CELL))
        self.regions[0] += self._rows[-1].sum(axis=(2, 3)).T
        self.areas[0] += inside.sum()
        if self.objects is not None:
            self._read_objects(self.objects[top : top + band.shape[1]], band)

    def _of_part(
        self, inside: np.ndarray, band: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[int, np.ndarray]]:
        """Of a part that fits a cache: sums over cells (3, n, ...), cumulants of its pixels (2, 2, 4, ...).

        And what it adds to `reference_square` and to `products`.
        """
        values = quantities(np.moveaxis(band, -1, 0))
        reference = values[:, self.sizes[0] :].reshape(4, -1)
        square = np.einsum("ij,ij->i", reference, reference)
        products = {}
        blocks = {1: values, 2: block_sums(values, 2)}
        cells = block_sums(blocks[2], CELL // 2)
        blocks[TILE_SIDES[0]] = block_sums(cells, TILE_SIDES[0] // CELL)
        for side, each in blocks.items():
            each -= each.mean(axis=1, keepdims=True)
            if side > 1:
                each /= np.sqrt(np.maximum(block_sums(inside, side), 1))
            products[side] = np.array([inner_products(quantity) for quantity in each])
        of_pixels = [cumulants(each, axis=1) for each in (values[:, : self.sizes[0]], values[:, self.sizes[0] :])]
        return cells[1:], block_sums(np.array(of_pixels), TILE_SIDES[0]), square, products

    def _read_objects(self, objects: np.ndarray, band: np.ndarray) -> None:
        at = np.asarray(objects).ravel()
        inside = np.flatnonzero(at >= 0)
        member = scipy.sparse.csr_array(
            (np.ones(len(inside)), (np.searchsorted(self.objects_present, at[inside]), inside)),
            (len(self.objects_present), len(at)),
        )
        pixels = np.ascontiguousarray(band.transpose(1, 2, 0, 3)).reshape(len(at), -1)
        self.regions[1:] += (member @ pixels).reshape(-1, len(band), 3)
        self.areas[1:] += member.sum(axis=1)

    @property
    def pixels(self) -> float:
        """Of the image."""
        return float(self.areas[0])

    def region_means(self) -> np.ndarray:
        """Means (n, regions, 3) of each replicate."""
        return np.moveaxis(self.regions / self.areas[:, None, None], 1, 0)

    def term_mean(self, reference_is_zero: bool, scale: float | None) -> float:
        """Luminance mean of the reference; where that is 0, `scale`, or ours' own, or 1."""
        image, count = self.region_means()[:, 0], self.sizes[0]
        if not reference_is_zero:
            return float(luminance_of(image[count:].mean(axis=0)))
        mean = scale if scale is not None else float(luminance_of(image[:count].mean(axis=0)))
        return mean if mean > 0 else 1.0

    def image_scale(self, term_mean: float, reference_is_zero: bool) -> np.ndarray:
        """(4,) mean of the reference in each quantity, or 10 % of the term's where that is larger."""
        if reference_is_zero:
            return np.full(4, term_mean)
        channels = self.region_means()[self.sizes[0] :, 0].mean(axis=0)
        return np.maximum(quantities(channels), 0.1 * term_mean)

    def typical(self, term_mean: float, reference_is_zero: bool) -> np.ndarray:
        """(4,) what half of the lit 8-px tiles of the reference exceed, or the image's scale where that is smaller."""
        scale = self.image_scale(term_mean, reference_is_zero)
        if reference_is_zero:
            return scale
        tiles = self.tiles[TILE_SIDES[0]][0][self.sizes[0] :].mean(axis=0).reshape(4, -1)
        lit = np.array([np.median(each[each > 0]) if each.any() else np.inf for each in tiles])
        return np.maximum(np.minimum(scale, lit), 0.1 * min(term_mean, lit[0]))

    @cached_property
    def tiles(self) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        """By the side of tiles, means (n, 4, rows, columns) and areas, smaller ones at the right and lower border.

        Asked for once all bands are read.
        """
        return {side: _means(*(block_sums(each, side // CELL) for each in self.cells)) for side in TILE_SIDES}

    def windows(self) -> tuple[np.ndarray, np.ndarray]:
        """The same over windows of two cells' side, which overlap by one: of a large image the largest array."""

        def pairs(values: np.ndarray) -> np.ndarray:
            for axis in (-2, -1):
                if (length := values.shape[axis]) > 1:
                    values = np.take(values, range(length - 1), axis) + np.take(values, range(1, length), axis)
            return values

        cells, areas = self.cells
        areas = np.maximum(pairs(areas), 1)
        values = np.empty((len(QUANTITIES), cells.shape[1], *areas.shape))
        for channel, of_cells in zip(values[1:], cells, strict=True):
            np.divide(pairs(of_cells), areas, out=channel)
        values[0] = luminance_of(np.moveaxis(values[1:], 0, -1))
        return np.moveaxis(values, 1, 0), areas

    def border_means(self) -> tuple[np.ndarray, np.ndarray]:
        """Means (n, 4, borders) over the outermost rows and columns, and their pixels."""
        lines = self.mask[0], self.mask[-1], self.mask[:, 0], self.mask[:, -1]
        return _means(self.borders.transpose(2, 1, 0), np.array([line.sum() for line in lines], dtype=np.float64))

    @cached_property
    def cells(self) -> tuple[np.ndarray, np.ndarray]:
        """Sums (3, n, rows, columns) and areas of cells. Asked for once all bands are read."""
        found = np.concatenate(self._rows, axis=2), np.concatenate(self._areas)
        self._rows.clear()
        return found

    def events(self, typical: np.ndarray) -> np.ndarray:
        """(4,): flux of the rare, bright events that either side shows in each quantity, see `welch`.

        In units of one pixel's radiance where the event was met: a place that is ten times brighter has events that are
        ten times brighter. That radiance is 10 % of the typical one at least.
        """
        smallest, largest = self.tiles[TILE_SIDES[0]], self.tiles[TILE_SIDES[-1]]
        regions = _means(np.moveaxis(self.regions, 2, 0).swapaxes(1, 2), self.areas)
        fluxes = []
        for means, areas in (smallest, largest, regions):
            radiance = np.maximum(means.mean(axis=0), 0.1 * np.reshape(typical, (4, *(1,) * areas.ndim)))
            fluxes.append(((means * areas / radiance).reshape(*means.shape[:2], -1), radiance))
        of_pixels = np.concatenate(self._cumulants, axis=-2)
        found = []
        for side, part in enumerate((slice(self.sizes[0]), slice(self.sizes[0], None))):
            second, third = of_pixels[side]
            radiance = fluxes[0][1]
            relative = np.array([second / radiance**2, third / radiance**3]).reshape(2, 4, -1)
            found.append(event_size(relative, self.sizes[side]))
            found += [event_size(cumulants(flux[part]), self.sizes[side]) for flux, _ in fluxes[:2]]
            found += [largest_event(flux[part]) for flux, _ in (fluxes[0], fluxes[2])]
        return np.max(found, axis=0)

    def comparison(self, term_mean: float, events: np.ndarray) -> Callable[..., Comparison]:
        """Welch's comparison of means (n, ...) over places, relative to `least` at least, of quantities `of`."""

        def compare(
            means: np.ndarray, areas: np.ndarray | float, least: np.ndarray | float, of: int | slice
        ) -> Comparison:
            return welch(
                means[: self.sizes[0]],
                means[self.sizes[0] :],
                least=least,
                term_mean=term_mean,
                areas=areas,
                brightest=self.brightest,
                event=events[of],
                quantum=self.quantum,
            )

        return compare

    def places(
        self, compare: Callable[..., Comparison], means: np.ndarray, areas: np.ndarray, typical: np.ndarray
    ) -> Comparison:
        """Comparison (4, ...) of means (n, 4, ...), one quantity after the other: maps of large images are large."""
        return stack([compare(means[:, of], areas, typical[of], of) for of in range(len(QUANTITIES))])

    def rest(self, compare: Callable[..., Comparison], term_mean: float, typical: float) -> Comparison:
        """Comparison of (): `typical` times the mean share of the lit tiles that are darker than the image's mean.

        A tile's own mean is that of both sides, each by its precision. By the reference's alone the shares of tiles
        that noise has darkened there were too large, and their mean with them, however alike both sides are.
        """
        means, areas = self.tiles[TILE_SIDES[0]]
        sides = np.split(means[:, 0], [self.sizes[0]])
        reference = sides[1].mean(axis=0)
        lit = (reference > 0) & (reference < term_mean)
        noise = [(side.var(axis=0) / max(len(side) - 1, 1))[lit] / reference[lit] ** 2 for side in sides]
        ours, theirs = (float(np.median(each)) for each in noise)
        weight = theirs / (ours + theirs) if theirs > 0 else 0.0
        own = weight * sides[0].mean(axis=0) + (1 - weight) * reference
        share = means[:, 0, lit] / np.maximum(own[lit], typical)
        return compare(typical * share.mean(axis=1), areas[lit].sum(), 0.0, 0)

    def mean_square(self, term_mean: float, reference_is_zero: bool) -> dict[int, tuple[Estimate, ...]]:
        """θ of each quantity over blocks, relative to the square of the image's scale, with its floor."""
        scale = self.image_scale(term_mean, reference_is_zero)
        bright = np.sqrt(self.reference_square / (self.sizes[1] * self.pixels)) / scale
        relative = ULP_FLOOR * np.finfo(np.float32).eps + self.quantum
        errors = np.hypot(TERM_FLOOR * term_mean / scale, relative * bright)

        def theta(products: np.ndarray, scale: float, error: float) -> Estimate:
            found = Gram(products / self.pixels / scale / scale, self.sizes).squared_distance()
            # An error of `error` in every block moves a mean square θ by up to this.
            return attrs.evolve(found, floor=float(2 * np.sqrt(max(found.value, 0.0)) * error + error**2))

        return {
            side: tuple(theta(*each) for each in zip(products, scale, errors, strict=True))
            for side, products in self.products.items()
        }


def _means(sums: np.ndarray, areas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means (n, 4, ...) of sums (3, n, ...) over places, and their areas, which are 1 where a mask leaves nothing."""
    areas = np.maximum(areas, 1)
    return np.moveaxis(quantities(sums / areas), 1, 0), areas


def block_sums(values: np.ndarray, side: int) -> np.ndarray:
    """Sums over blocks of the last two axes; border blocks may be smaller."""
    for axis in (-2, -1):
        parts = [values[(..., slice(k, None, side), *(slice(None),) * (-1 - axis))] for k in range(side)]
        values = parts[0].copy()
        for part in parts[1:]:
            values[(..., slice(part.shape[axis]), *(slice(None),) * (-1 - axis))] += part
    return values
