"""What a row measures, in one reading of all replicates by bands of rows: phase one of a verdict.

Means are taken over the image, each object, tiles of 8, 16 and 32 px, windows of 8 px that overlap by half, and the
outermost rows and columns, and compared by Welch's t (`welch`). The shape of the error is its mean square over single
pixels and over blocks of 2 and 8 px (`jackknife`). A mean tells a bias of a whole place, a tile or a window where it
is, a square what cancels in every mean.
"""

import itertools
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from typing import Any

import attrs
import numpy as np
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
    mapping,
    quantities,
    set_luminance,
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
_PART = 32, 64
"""Rows and columns that are read at a time, whole tiles: what is made of a part stays in a processor's cache."""
_BUFFERED = 1024
"""Numbers of NumPy's buffers, fewer than a part has pixels: into larger ones it copies what it could read in place."""
_ALONE = 2**16
"""Pixels of the largest image that is read by one thread."""


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
    invalid = Invalid(called, count, allow_negative)
    # A BLAS that divides products this small among threads takes twice as long; parts are divided here.
    with threadpool_limits(1, "blas"), mapping(ours.shape[1] * ours.shape[2] > _ALONE) as in_order:
        for top, band in bands(ours, reference):
            inside = None if mask is None else mask[top : top + band[0].shape[1]]
            sums.read(top, invalid.replaced(top, band, inside), in_order)

    zero = sums.zero & ~invalid.replicates
    warnings = Equality((ours, reference), mask, sums.regions[0], zero).warnings(called, noiseless)
    warnings += _few({"ours": count} if exact else {"ours": count, "the reference": len(reference)})
    reference_is_zero = bool(zero[count:].all())
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
        absent=bool(zero.all()),
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


def _named(objects: np.ndarray, names: Sequence[str]) -> list[str]:
    return [str(names[i]) if i < len(names) else f"object {i}" for i in objects]


def _few(sides: dict[str, int]) -> list[str]:
    few = [f"{count} of {side}" for side, count in sides.items() if count < REPLICATES_WANTED]
    if not few:
        return []
    return [f"replicates: {' and '.join(few)}: fewer than {REPLICATES_WANTED}, intervals are wide and less sure"]


@attrs.frozen(eq=False)
class _Part:
    """What a part of a band adds to the attributes of `_Sums` of the same names, of the objects that are in it."""

    products: dict[int, np.ndarray]
    reference_square: np.ndarray
    brightest: float
    zero: np.ndarray
    objects: np.ndarray
    regions: np.ndarray
    areas: np.ndarray


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
    zero : (n,) bool, replicates that are black everywhere.
    cells : (3, n, ceil(H/4), ceil(W/4)) and (ceil(H/4), ceil(W/4)) float64, sums over cells, and their pixels.
    cumulants : (2, 2, 4, ceil(H/8), ceil(W/8)) float64
        Of each side the second and third cumulant of a pixel over the replicates, summed over tiles of 8 px.
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
        inside = self.mask.astype(np.float64)
        areas = {side: block_sums(inside, side) for side in (*SHAPE_LIMITS, CELL) if side > 1}
        self.products = {side: np.zeros((4, everyone, everyone)) for side in SHAPE_LIMITS}
        self.reference_square = np.zeros(4)
        self.regions = np.zeros((1 + len(self.objects_present), everyone, 3))
        self.areas = np.zeros(1 + len(self.objects_present))
        self.areas[0] = inside.sum()
        self.borders = np.zeros((len(BORDERS), everyone, 3))
        self.brightest, self.zero = 0.0, np.ones(everyone, dtype=bool)
        self.cells = np.empty((3, everyone, *areas[CELL].shape)), areas[CELL]
        self.cumulants = np.empty((2, 2, 4, *areas[8].shape))
        self._members = slice(sizes[0]), slice(sizes[0], None)
        self._root_areas = {side: np.sqrt(np.maximum(areas[side], 1)) for side in SHAPE_LIMITS if side > 1}

    def read(self, top: int, sides: list[np.ndarray], in_order: Callable[..., Iterable[Any]]) -> None:
        """Add a band of finite values, (K, rows, W, 3) and (R, rows, W, 3), that begins at row `top`.

        `in_order` is `map` or like it.
        """
        bottom = top + sides[0].shape[1]
        for border, line, there in (
            (0, np.s_[:, 0], top == 0),
            (1, np.s_[:, -1], bottom == self.shape[0]),
            (2, np.s_[:, :, 0], True),
            (3, np.s_[:, :, -1], True),
        ):
            if there:
                self.borders[border] += np.concatenate([side[line].sum(axis=1, dtype=np.float64) for side in sides])

        def part_at(corner: tuple[int, int]) -> _Part:
            with np.errstate():  # whose end gives the size back
                np.setbufsize(_BUFFERED)
                return self._of_part(top, sides, corner)

        corners = itertools.product(range(top, bottom, _PART[0]), range(0, self.shape[1], _PART[1]))
        for part in in_order(part_at, corners):
            for side, product in part.products.items():
                self.products[side] += product
            self.reference_square += part.reference_square
            self.brightest = max(self.brightest, part.brightest)
            self.zero &= part.zero
            self.regions[part.objects] += part.regions
            self.areas[part.objects] += part.areas
        self.regions[0] += self.cells[0][:, :, _blocks(top, bottom, CELL)].sum(axis=(2, 3)).T

    def _of_part(self, first: int, sides: list[np.ndarray], corner: tuple[int, int]) -> _Part:
        """Read a part of a band from its corner on; cells and cumulants are kept at once, sums come in order."""
        top, left = corner
        bottom, right = min(top + _PART[0], first + sides[0].shape[1]), min(left + _PART[1], self.shape[1])
        at = {side: (..., _blocks(top, bottom, side), _blocks(left, right, side)) for side in (*SHAPE_LIMITS, CELL)}
        values = np.empty((len(QUANTITIES), sum(self.sizes), bottom - top, right - left))
        for members, side in zip(self._members, sides, strict=True):
            values[1:, members] = np.moveaxis(side[:, top - first : bottom - first, left:right], -1, 0)
        set_luminance(values)
        channels = values[1:]
        objects = self._of_objects(channels, at[1])
        brightest, zero = float(channels.max()), np.logical_not(np.any(channels, axis=(0, 2, 3)))
        reference = values[:, self._members[1]].reshape(len(QUANTITIES), -1)
        square = np.einsum("ij,ij->i", reference, reference)

        pairs = block_sums(channels, 2)
        cells = block_sums(pairs, CELL // 2)
        self.cells[0][at[CELL]] = cells
        products = {}
        for side, each in ((1, values), (2, quantities(pairs)), (8, quantities(block_sums(cells, 8 // CELL)))):
            each -= each.mean(axis=1, keepdims=True)
            if side > 1:
                each /= self._root_areas[side][at[side]]
            products[side] = np.array([inner_products(quantity) for quantity in each])
        for members, of_side in zip(self._members, self.cumulants, strict=True):
            of_side[at[8]] = block_sums(cumulants(values[:, members], axis=1), 8)
        return _Part(products, square, brightest, zero, *objects)

    def _of_objects(self, channels: np.ndarray, at: tuple[Any, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Regions of the objects that are in a part, sums of each (objects, n, 3), and their pixels."""
        if self.objects is None:
            return np.empty(0, int), np.empty((0, channels.shape[1], 3)), np.empty(0)
        indices = self.objects[at].ravel()
        found, counts = np.unique(indices, return_counts=True)
        pixels = channels.reshape(*channels.shape[:2], -1)[..., np.argsort(indices, kind="stable")]
        sums = np.add.reduceat(pixels, np.cumsum(counts) - counts, axis=-1).T
        known = found >= 0
        return 1 + np.searchsorted(self.objects_present, found[known]), sums[known], counts[known]

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
            if values.shape[-2] > 1:
                values = values[..., :-1, :] + values[..., 1:, :]
            return values[..., :-1] + values[..., 1:] if values.shape[-1] > 1 else values

        cells, areas = self.cells
        areas = np.maximum(pairs(areas), 1)
        values = np.empty((len(QUANTITIES), cells.shape[1], *areas.shape))
        for channel, of_cells in zip(values[1:], cells, strict=True):
            np.divide(pairs(of_cells), areas, out=channel)
        set_luminance(values)
        return np.moveaxis(values, 1, 0), areas

    def border_means(self) -> tuple[np.ndarray, np.ndarray]:
        """Means (n, 4, borders) over the outermost rows and columns, and their pixels."""
        lines = self.mask[0], self.mask[-1], self.mask[:, 0], self.mask[:, -1]
        return _means(self.borders.transpose(2, 1, 0), np.array([line.sum() for line in lines], dtype=np.float64))

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
        found = []
        for side, part in enumerate((slice(self.sizes[0]), slice(self.sizes[0], None))):
            second, third = self.cumulants[side]
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


def _blocks(start: int, stop: int, side: int) -> slice:
    """The blocks of so many pixels that hold those of a range, which begins with a block."""
    return slice(start // side, -(-stop // side))


def block_sums(values: np.ndarray, side: int) -> np.ndarray:
    """Sums over blocks of the last two axes; border blocks may be smaller."""
    for axis in (-2, -1):
        parts = [values[(..., slice(k, None, side), *(slice(None),) * (-1 - axis))] for k in range(side)]
        even = side > 1 and parts[1].shape == parts[0].shape
        values = parts[0] + parts[1] if even else parts[0].copy()
        for part in parts[1 + even :]:
            values[(..., slice(part.shape[axis]), *(slice(None),) * (-1 - axis))] += part
    return values
