"""What a row measures, in one reading of all replicates by bands of rows: phase one of a verdict.

Means are taken over the image, each object, and tiles of 8, 16 and 32 px, and compared by Welch's t (`welch`). The
shape of the error is its mean square over blocks of 2 and 8 px (`jackknife`). A mean tells a bias of a whole place, a
tile where it is, a block's square what cancels in every mean.
"""

from collections.abc import Callable, Sequence

import attrs
import numpy as np
import scipy

from termwise.reports.statistics.jackknife import Estimate, Gram, inner_products
from termwise.reports.statistics.replicates import (
    CHANNELS,
    LISTED_PIXELS,
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
    stacked,
)
from termwise.reports.statistics.welch import TERM_FLOOR, ULP_FLOOR, Comparison, largest_event, median_skewness, welch

IMAGE = "image"
"""Name of the region that is the whole picture."""


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
    region_names : "image", then each object present.
    regions : Comparison of (regions, 3), means per region and channel, relative to the reference's mean there or to 10
        % of `term_mean` where that is larger.
    luminance : Comparison of (), the image's luminance, relative to `term_mean`.
    tiles : luminance per tile of 8, 16 and 32 px, (ceil(H/side), ceil(W/side)), relative to the larger of the tile's
        reference mean and `term_mean`.
    channel_tiles : the same per channel, (3, ceil(H/side), ceil(W/side)).
    tile_skewness : of the luminance of a tile over the replicates, bias-corrected: median over the tiles that vary, of
        the side where it is larger; 0 where no tile varies.
    mean_square : θ of luminance over blocks of 2 and 8 px relative to `term_mean`².
    bias_squared : θ over pixels and channels, in radiance².
    variance, reference_variance : of one replicate, mean over pixels and channels, in radiance².
    non_finite, negative : values of ours that are NaN, infinite (or beyond float32), or negative.
    invalid : the first of them.
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
    region_names: tuple[str, ...]
    regions: Comparison
    luminance: Comparison
    tiles: dict[int, Comparison]
    channel_tiles: dict[int, Comparison]
    tile_skewness: dict[int, float]
    mean_square: dict[int, Estimate]
    bias_squared: Estimate
    variance: float
    reference_variance: float
    non_finite: int
    negative: int
    invalid: tuple[InvalidPixel, ...]
    warnings: tuple[str, ...]

    @property
    def mean_tests(self) -> int:
        """Tests of a kernel-based row: the means per region and channel. None where the row is absent."""
        return 0 if self.absent else len(CHANNELS) * len(self.region_names)

    @property
    def tests(self) -> int:
        """Tests of this row: means, two of shape, one of place. None where the row is absent."""
        return 0 if self.absent else self.mean_tests + len(self.mean_square) + 1


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

    Returns
    -------
    Invalid values of ours (NaN, infinite) are counted there and replaced by the reference's mean, so that the rest can
    still be measured.

    Raises
    ------
    ValueError : for shapes that do not fit, values that are no floats, fewer than 4 replicates, two replicates that are
        the same image although others differ (or all of ours, unless it may be free of noise), an invalid value in the
        reference, a scale that is not positive.
    """
    ours, reference = stacked("ours", ours, names), stacked("reference", reference, reference_names)
    check(ours, reference, objects, scale, exact)
    if mask is not None:
        check_mask(mask, ours)
        objects = None if objects is None else np.where(mask, objects, -1)
    count, sizes = len(ours), (len(ours), len(reference))
    called = labels("ours", count, names) + labels("reference", len(reference), reference_names)
    sums = _Sums(sizes, objects, mask)
    equality, invalid = Equality(sum(sizes)), Invalid(called, count, allow_negative)
    for top, band in bands(ours, reference):
        if mask is not None:
            band[:, ~mask[top : top + band.shape[1]]] = 0.0
        equality.read(band)
        sums.read(top, invalid.replaced(top, band))

    warnings = equality.warnings(called, count, noiseless)
    warnings += _few("ours", count) + ([] if exact else _few("the reference", len(reference)))
    reference_is_zero = bool(equality.zero[count:].all())
    term_mean = sums.term_mean(reference_is_zero, scale)
    if not term_mean > 0:
        raise ValueError(f"reference: its mean luminance is {term_mean:.3g}; a relative bias needs one above 0")
    compare, tiles = sums.comparison(term_mean), {side: sums.tiles(side) for side in TILE_SIDES}
    rare, rare_luminance = sums.rare_events()
    regions, pixels = sums.region_means(), Gram(sums.pixel_products / (3 * sums.pixels), sizes)
    return Statistics(
        replicates=count,
        reference_replicates=len(reference),
        exact=exact,
        height=ours.shape[1],
        width=ours.shape[2],
        absent=bool(equality.zero.all()),
        reference_is_zero=reference_is_zero,
        term_mean=term_mean,
        region_names=(IMAGE, *_named(sums.objects_present, object_names)),
        regions=compare(regions, sums.areas[:, None], rare, term_mean * (1 if reference_is_zero else 0.1)),
        luminance=compare(luminance_of(regions[:, 0]), sums.areas[0], rare_luminance[:, 0]),
        tiles={side: compare(at.luminance, at.areas, rare_luminance) for side, at in tiles.items()},
        channel_tiles={side: compare(at.channels, at.areas, rare[..., None, None]) for side, at in tiles.items()},
        tile_skewness={
            side: max(median_skewness(at.luminance[:count]), median_skewness(at.luminance[count:]))
            for side, at in tiles.items()
        },
        mean_square=sums.mean_square(term_mean),
        bias_squared=pixels.squared_distance(),
        variance=pixels.variance(0).value,
        reference_variance=pixels.variance(1).value,
        non_finite=invalid.non_finite,
        negative=invalid.negative,
        invalid=tuple(invalid.first[:LISTED_PIXELS]),
        warnings=tuple(warnings),
    )


def _named(objects: np.ndarray, names: Sequence[str]) -> list[str]:
    return [str(names[i]) if i < len(names) else f"object {i}" for i in objects]


def _few(side: str, count: int) -> list[str]:
    if count >= REPLICATES_WANTED:
        return []
    return [f"{count} replicates of {side}: fewer than {REPLICATES_WANTED}, intervals are wide and less sure"]


@attrs.frozen(eq=False)
class _Tiles:
    """Means (n, 3, rows, columns) and their luminance (n, rows, columns), for each replicate, over tiles of a size."""

    channels: np.ndarray
    luminance: np.ndarray
    areas: np.ndarray


class _Sums:
    """What the bands of all replicates add up to, small whatever their resolution.

    Attributes
    ----------
    sizes : replicates of ours, which come first, and of the reference; n in all.
    pixel_products, block_products : (n, n) float64
        Of the replicates' distances from their mean: over pixels and channels, and of luminance over blocks of 2 px.
    reference_square : sum of the squares of the reference's luminance.
    regions, areas : (regions, n, 3) and (regions,) float64
        Sums over the image and each object present, and their pixels.
    brightest : the largest value.
    """

    def __init__(self, sizes: tuple[int, int], objects: np.ndarray | None, mask: np.ndarray | None = None) -> None:
        everyone = sum(sizes)
        present = np.array([], dtype=int) if objects is None else np.unique(objects)
        self.sizes = sizes
        self.objects, self.objects_present, self.mask = objects, present[present >= 0], mask
        self.pixel_products, self.block_products = (np.zeros((everyone, everyone)) for _ in range(2))
        self.reference_square = 0.0
        self.regions = np.zeros((1 + len(self.objects_present), everyone, 3))
        self.areas = np.zeros(1 + len(self.objects_present))
        self.brightest = 0.0
        self._tile_rows: list[np.ndarray] = []
        self._tile_areas: list[np.ndarray] = []

    def read(self, top: int, band: np.ndarray) -> None:
        """Add a band (n, rows, W, 3) of finite values that begins at row `top`."""
        luminance = luminance_of(band)
        self.brightest = max(self.brightest, float(band.max()))
        self.pixel_products += inner_products(band - band.mean(axis=0))
        self.reference_square += np.sum(luminance[self.sizes[0] :] ** 2)
        blocks, areas = self._block_sums(top, luminance, 2)
        self.block_products += inner_products((blocks - blocks.mean(axis=0)) / np.sqrt(np.maximum(areas, 1)))
        sums, areas = self._block_sums(top, np.moveaxis(band, -1, 1), TILE_SIDES[0])
        self._tile_rows.append(sums)
        self._tile_areas.append(areas)
        self.regions[0] += sums.sum(axis=(2, 3))
        self.areas[0] += luminance[0].size if self.mask is None else self.mask[top : top + band.shape[1]].sum()
        if self.objects is not None:
            self._read_objects(self.objects[top : top + band.shape[1]], band)

    def _block_sums(self, top: int, values: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
        """`block_sums` of rows from `top` on; areas count the pixels in the mask."""
        sums, areas = block_sums(values, side)
        if self.mask is not None:
            inside = self.mask[top : top + values.shape[-2]].astype(np.float64)
            areas = block_sums(inside, side)[0]
        return sums, areas

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

    def tiles(self, side: int) -> _Tiles:
        """Means over tiles, smaller ones at the right and lower border; `side` is a multiple of the smallest's."""
        step = side // TILE_SIDES[0]
        sums, areas = self._smallest_tiles()
        areas = np.maximum(block_sums(areas[None], step)[0][0], 1)  # 0 where the mask leaves nothing
        channels = block_sums(sums, step)[0] / areas
        return _Tiles(channels, luminance_of(np.moveaxis(channels, 1, -1)), areas)

    def _smallest_tiles(self) -> tuple[np.ndarray, np.ndarray]:
        """Sums (n, 3, rows, columns) and areas of tiles of 8 px."""
        return np.concatenate(self._tile_rows, axis=2), np.concatenate(self._tile_areas)

    def rare_events(self) -> tuple[np.ndarray, np.ndarray]:
        """The largest rare event of each side in any region or tile, (2, 3) by channel and (2, 1) of luminance."""
        tiles = np.moveaxis(self._smallest_tiles()[0], 1, -1).reshape(sum(self.sizes), -1, 3)
        places = np.concatenate([np.moveaxis(self.regions, 1, 0), tiles], 1)
        channels, luminance = (
            np.stack([largest_event(values[: self.sizes[0]]), largest_event(values[self.sizes[0] :])])
            for values in (places, luminance_of(places)[..., None])
        )
        return channels, luminance

    def comparison(self, term_mean: float) -> Callable[..., Comparison]:
        """Welch's comparison of means (n, ...) over places of some areas, relative to `least` at least."""

        def compare(
            means: np.ndarray, areas: np.ndarray | float, events: np.ndarray, least: float = term_mean
        ) -> Comparison:
            return welch(
                means[: self.sizes[0]],
                means[self.sizes[0] :],
                least=least,
                term_mean=term_mean,
                areas=areas,
                brightest=self.brightest,
                events=events,
            )

        return compare

    def mean_square(self, term_mean: float) -> dict[int, Estimate]:
        """θ of luminance over blocks of 2 and 8 px, relative to `term_mean`², with its floor."""
        sums, areas = self._smallest_tiles()
        tiles = luminance_of(np.moveaxis(sums / np.maximum(areas, 1), 1, -1))
        tile_products = inner_products((tiles - tiles.mean(axis=0)) * np.sqrt(areas))
        bright = float(np.sqrt(self.reference_square / (self.sizes[1] * self.pixels))) / term_mean
        error = np.hypot(TERM_FLOOR, ULP_FLOOR * np.finfo(np.float32).eps * bright)

        def theta(products: np.ndarray) -> Estimate:
            found = Gram(products / self.pixels / term_mean / term_mean, self.sizes).squared_distance()
            # An error of `error` in every block moves a mean square θ by up to this.
            return attrs.evolve(found, floor=float(2 * np.sqrt(max(found.value, 0.0)) * error + error**2))

        return {2: theta(self.block_products), TILE_SIDES[0]: theta(tile_products)}


def block_sums(values: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Sums over blocks of the last two axes and the blocks' areas; border blocks may be smaller."""
    rows, columns = (np.arange(0, length, side) for length in values.shape[-2:])
    sums = np.add.reduceat(np.add.reduceat(values, rows, axis=-2), columns, axis=-1)
    heights, widths = (
        np.diff(starts, append=length) for starts, length in zip((rows, columns), values.shape[-2:], strict=True)
    )
    return sums, np.multiply.outer(heights, widths).astype(np.float64)
