r"""Is an image biased, by how much, where, and how sure are we? Decided from replicate images.

Replicates `I_1 … I_K` of ours and `R_1 … R_R` of the reference (independent seeds, each with its own
photon map) estimate two limits. The relative bias of a region's mean is judged by Welch's t on the
replicate means (pixels of one image may be correlated, replicates are not),

    δ = (Ī - R̄)/scale,     SE² = (s_I²/K + s_R²/R)/scale² + floor²,

and the shape of the error by its mean square over blocks of pixels, freed of both sides' noise:

    θ = mean((Ī - R̄)²) - mean(s_I²/K) - mean(s_R²/R)
      = ⟨I_k, I_l⟩_{k≠l} - 2 ⟨I_k, R_r⟩ + ⟨R_r, R_s⟩_{r≠s},

a function of the Gram matrix of all replicate images alone. Its error is a delete-one jackknife over
the replicates of both sides with `t_{min(K, R)-1}`: a bootstrap centres on the un-debiased value and
covered the truth in 0 of 240 trials.

A sparse estimator may miss its brightest samples in all replicates, agree with itself, and lack their light. If a
place lacks D (radiance summed over its pixels, mean of K replicates), one replicate elsewhere holds an event of E, and
the place's own standard error is that of `m = (K SE / E)²` of them, then `λ = K D / E` are missing. By Poisson's law so
few are met with probability `Q(m + 1, m + λ)`, `e^-λ` for m = 0: a mean is proven off only if that, too, is below the
level of its test. Shape needs no such rule: where events are met, its jackknife has them.

There are two phases because the level of each test is 5 % over the number of tests of the whole run
(Bonferroni): `measure` every row, add up their `tests`, then `decide` each.
"""

import hashlib
from collections.abc import Iterator, Sequence
from typing import Any, Literal

import attrs
import numpy as np
from scipy import sparse, special, stats

Kind = Literal["right", "wrong"]

LEVEL = 0.05
"""Chance of any false alarm in a run, shared equally by its tests, and by its looks where it takes several."""
OUTSIDE = 0.05
"""Chance that a bias of exactly the margin is called EQUIVALENT, shared by the looks: at one look, a 90 % interval."""
TOLERATED_BIAS = 0.001
"""f: a mean bias below this is never called a bias."""
MARGIN = 0.01
"""m: a mean bias inside this margin is equivalent to none."""
SHAPE_LIMITS = {2: 0.005, 8: 0.003}
"""Root mean square of the error over blocks of so many pixels' side, relative to the term's mean."""
PLACE_LIMIT = 0.005
PLACE_SIDE = 16
SHAPE_MARGIN = 0.03
"""Largest root mean square over 8-px tiles that EQUIVALENT may leave open."""
POWER = 0.8
"""A bias counts as detectable when it is found in this share of runs."""
REPLICATES_WANTED, REPLICATES_NEEDED = 16, 4
TILE_SIDES = (8, 16, 32)
IMAGE = "image"
"""Name of the region that is the whole picture."""
CHANNELS = ("red", "green", "blue")
LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Of linear Rec. 709 (ITU-R BT.709-6, section 3)."""
NO_VERDICT = "NO VERDICT"
"""In the place of a verdict where the reference failed its own audit."""
WORDS = {"right": ("BIASED", "EQUIVALENT"), "wrong": ("NOT AS PREDICTED", "AS PREDICTED")}

TERM_FLOOR, ULP_FLOOR = 1e-6, 4.0
"""Floors of every standard error: a share of the term's mean, and float32 ulp of the reference value."""
BAND_BYTES = 64 * 2**20
LISTED_PIXELS = 10
RARE_EVENT = 1e-7
"""A replicate that stands above the lower three quarters of its place as far as normal noise would with this chance
holds a rare event."""
_OF_THE_LARGEST = 2.2
"""Of n normal numbers, the largest one's distance from the mean of the lower three quarters, in their standard
deviation, is about so many times Student's t of one degree of freedom fewer than these are: 2.05 to 2.21 times at
chances of 10^-3 and 10^-4, n = 8 to 32, simulated."""
DISTINCT_PIXELS = 40
"""Where independent images differ in so many pixels, two are equal by chance with probability e^-40 or so."""


@attrs.frozen(eq=False)
class Estimate:
    """A number with its delete-one jackknife.

    Attributes
    ----------
    value : float
    leave_one_out : tuple of (n_g,) float64
        The number without one replicate, for each group that has more than one.
    floor : float
        Added to the standard error in quadrature.
    """

    value: float
    leave_one_out: tuple[np.ndarray, ...]
    floor: float = 0.0

    @property
    def standard_error(self) -> float:
        """`sqrt(Σ_g (n_g - 1)/n_g Σ_i (θ_(i) - mean θ_(·))² + floor²)` (Efron 1982, for several samples)."""
        variance = sum((len(each) - 1) * np.var(each) for each in self.leave_one_out)
        return float(np.sqrt(variance + self.floor**2))

    @property
    def dof(self) -> int:
        """Of the smallest group."""
        return min(len(each) for each in self.leave_one_out) - 1

    def low(self, level: float) -> float:
        """One-sided lower bound, above the truth in `level` of the runs."""
        return self.value - float(stats.t.isf(level, self.dof)) * self.standard_error

    def high(self, level: float) -> float:
        """One-sided upper bound, below the truth in `level` of the runs."""
        return self.value + float(stats.t.isf(level, self.dof)) * self.standard_error


@attrs.frozen(eq=False)
class Gram:
    """Inner products of the replicate images of several groups.

    Attributes
    ----------
    matrix : (N, N) float64
        Mean over pixels of the products, N the sum of `sizes`. Subtract a common image from all
        replicates first: the differences estimated here do not change, their rounding error does.
    sizes : tuple of int
        Replicates per group, in the order of the matrix. A group of one is exact, without noise.
    """

    matrix: np.ndarray
    sizes: tuple[int, ...]

    def estimate(
        self, products: np.ndarray, variances: np.ndarray | Sequence[float] | None = None
    ) -> Estimate:
        """`Σ products[g, h] ⟨E_g, E_h⟩ + Σ variances[g] V_g`, unbiased, with its jackknife.

        `E_g` is the limit of group g, `V_g` the variance of one of its replicates, both averaged over pixels.
        """
        member = np.repeat(np.eye(len(self.sizes)), self.sizes, axis=0)
        diagonal, rows = np.diag(self.matrix), self.matrix @ member
        total, trace, counts = member.T @ rows, member.T @ diagonal, np.array(self.sizes, dtype=float)
        weights = np.zeros(len(self.sizes)) if variances is None else np.asarray(variances, dtype=float)

        def value(total: np.ndarray, trace: np.ndarray, counts: np.ndarray) -> np.ndarray:
            # (..., G, G), (..., G), (..., G). Products of different replicates have no noise in the mean.
            limits = total / (counts[..., :, None] * counts[..., None, :])
            single, own = np.array(self.sizes) == 1, np.diagonal(total, axis1=-2, axis2=-1)
            pairs = np.where(single, 1.0, counts * (counts - 1))
            square = np.where(single, own, own - trace) / pairs
            limits[..., np.arange(len(single)), np.arange(len(single))] = square
            variance = np.where(single, 0.0, trace / counts - square)
            return np.sum(products * limits, axis=(-2, -1)) + np.sum(weights * variance, axis=-1)

        # Without replicate i, of which `one` marks the group: no image is read again.
        deletable = np.array([size > 1 for size in self.sizes for _ in range(size)])
        one, row, square = member[deletable], rows[deletable], diagonal[deletable]
        outer = one[:, :, None] * row[:, None, :]
        both = square[:, None, None] * one[:, :, None] * one[:, None, :]
        deleted = value(
            total - outer - outer.swapaxes(1, 2) + both, trace - square[:, None] * one, counts - one
        )
        ends = np.cumsum([size for size in self.sizes if size > 1])
        return Estimate(float(value(total, trace, counts)), tuple(np.split(deleted, ends[:-1])))

    def squared_distance(self) -> Estimate:
        """θ of two groups: `mean((E_0 - E_1)²)`; may come out negative."""
        return self.estimate(np.array([[1.0, -1.0], [-1.0, 1.0]]))

    def variance(self, group: int) -> Estimate:
        """Variance of one replicate of the group, mean over pixels."""
        return self.estimate(np.zeros((len(self.sizes),) * 2), np.eye(len(self.sizes))[group])


@attrs.frozen(eq=False)
class Comparison:
    """Welch's comparison of the replicate means of some places; all arrays have one shape.

    Attributes
    ----------
    ours, reference : float64
        Means over the place, in radiance.
    bias, standard_error : float64
        δ and its floored error, relative to `scale`.
    scale : float64
        In radiance.
    dof : float64
        Welch-Satterthwaite; K + R - 2 where both variances are 0.
    noiseless : bool
        Both variances are 0: left out of p-histograms.
    unseen : float64
        Size of δ that one rare event makes if the side that is darker here has missed it, the event being as large as
        the largest that this side shows anywhere; 0 where it shows none.
    seen : float64
        How many such events this side has met here, by its standard error.
    """

    ours: np.ndarray
    reference: np.ndarray
    bias: np.ndarray
    standard_error: np.ndarray
    scale: np.ndarray
    dof: np.ndarray
    noiseless: np.ndarray
    unseen: np.ndarray
    seen: np.ndarray

    def interval(self, level: float) -> tuple[np.ndarray, np.ndarray]:
        """Two-sided interval of δ that misses the truth in `level` of the runs."""
        half = stats.t.isf(level / 2, self.dof) * self.standard_error
        return self.bias - half, self.bias + half

    def p_values(self) -> np.ndarray:
        """Two-sided p of "no bias at all"; uniform under the null but for noiseless places, which the floor judges.

        NaN where all replicates of both sides are the same number: there is nothing to test.
        """
        p = 2 * stats.t.sf(np.abs(self.bias) / self.standard_error, self.dof)
        return np.where(self.noiseless & (self.bias == 0), np.nan, p)

    def detectable(self, level: float, limit: float) -> np.ndarray:
        """Smallest bias that this very measurement finds outside ±limit in 80 % of the runs."""
        outside = limit + stats.t.isf(level / 2, self.dof) * self.standard_error
        return (
            np.maximum(outside, self.missing(level)) + stats.t.isf(1 - POWER, self.dof) * self.standard_error
        )

    def missing(self, level: float) -> np.ndarray:
        """Size of δ up to which rare events that were not met explain it: the chance of so few is above `level`."""
        return self.unseen * (special.gammainccinv(self.seen + 1, level) - self.seen)


@attrs.frozen
class InvalidPixel:
    """A value that no radiance can have, and where it stands (index into the replicates, row y, column x)."""

    replicate: int
    y: int
    x: int
    channel: str
    value: float

    def __str__(self) -> str:
        """As messages name it."""
        return f"{self.channel} is {self.value} at x {self.x}, y {self.y}"


@attrs.frozen(eq=False)
class Statistics:
    """All that a verdict needs of a row: what `measure` returns.

    Attributes
    ----------
    replicates, reference_replicates : int
        K and R.
    exact : bool
        The reference is one image, taken as noise-free.
    height, width : int
    absent : bool
        Both sides are exactly 0 everywhere.
    reference_is_zero : bool
        The reference is exactly 0 everywhere.
    term_mean : float
        Luminance mean of the reference in radiance, or the fallback where the reference is 0.
    region_names : tuple of str
        "image", then each object present.
    regions : Comparison of (regions, 3)
        Means per region and channel, relative to the reference's mean there or to 10 % of `term_mean`
        where that is larger.
    luminance : Comparison of ()
        The image's luminance, relative to `term_mean`.
    tiles : dict of int to Comparison
        Luminance per tile of 8, 16 and 32 px, (ceil(H/side), ceil(W/side)), relative to the larger of
        the tile's reference mean and `term_mean`.
    channel_tiles : dict of int to Comparison
        The same per channel, (3, ceil(H/side), ceil(W/side)).
    tile_skewness : dict of int to float
        Of the luminance of a tile over the replicates, bias-corrected: median over the tiles that vary, of
        the side where it is larger; 0 where no tile varies.
    mean_square : dict of int to Estimate
        θ of luminance over blocks of 2 and 8 px relative to `term_mean`².
    bias_squared : Estimate
        θ over pixels and channels, in radiance².
    variance, reference_variance : float
        Of one replicate, mean over pixels and channels, in radiance².
    non_finite, negative : int
        Values of ours that are NaN, infinite (or beyond float32), or negative.
    invalid : tuple of InvalidPixel
        The first of them.
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
        return 0 if self.absent else self.mean_tests + len(SHAPE_LIMITS) + 1


@attrs.frozen
class RegionBias:
    """Relative bias of one channel over one region, 90 % interval and the one at the family's level."""

    region: str
    channel: str
    bias: float
    low: float
    high: float
    family_low: float | None
    family_high: float | None
    standard_error: float
    detectable_bias: float | None


@attrs.frozen
class Verdict:
    """What a run says about a row; biases are relative and signed, `None` where none is due.

    Attributes
    ----------
    verdict : str or None
        ABSENT, BIASED, EQUIVALENT, UNDERPOWERED, NOT AS PREDICTED, AS PREDICTED; None if not judged. A run says
        NO VERDICT where the reference failed its audit, see `reports.study.audits`.
    sentence : str
        What was tested, what was found and what is not excluded.
    reasons : tuple of str
        Why it is BIASED, the gravest first, or why not EQUIVALENT.
    bias, bias_low, bias_high, standard_error : float
        Of the image's luminance, 90 % interval; with several looks one that holds at 90 % over all of them.
    family_low, family_high : float or None
        The same interval at 5 % over `tests` and `looks`.
    regions : tuple of RegionBias
        Each channel of the image and of each object: what the mean tests judge.
    rms_bias, rms_bias_high : float
        `sign(θ) sqrt(|θ|)` over 8-px tiles and U, its upper bound at 95 %, over all looks.
    place : str
        Where the error is proven, else where it is the most likely.
    tile : tuple of int
        x, y, width, height of the 16-px tile with the most significant bias.
    detectable_bias : float or None
        Smallest bias of the image's noisiest channel found in 80 % of runs.
    samples_to_margin, seconds_to_margin : float or None
        What both sides need, at these K and R, to be found EQUIVALENT in 80 % of runs if unbiased; None
        where not asked for, or where a bias beyond the margin is likely so that no samples will do.
    margin, allowance, tests, looks, predicted_bias
        As decided with.
    warnings : tuple of str
    """

    verdict: str | None
    sentence: str
    reasons: tuple[str, ...]
    bias: float
    bias_low: float
    bias_high: float
    standard_error: float
    family_low: float | None
    family_high: float | None
    regions: tuple[RegionBias, ...]
    rms_bias: float
    rms_bias_high: float
    place: str
    tile: tuple[int, int, int, int]
    detectable_bias: float | None
    samples_to_margin: int | None
    seconds_to_margin: float | None
    margin: float
    allowance: float
    tests: int | None
    looks: int
    predicted_bias: float | None
    warnings: tuple[str, ...]

    def row(self) -> dict[str, Any]:
        """Plain values, ready for JSON."""
        return attrs.asdict(self)


@attrs.frozen(eq=False)
class ErrorSplit:
    """`MSE against physical = mean(G²) + 2 mean(G·B) + mean(B²) + mean(V)`, each part unbiased.

    In radiance², over pixels and channels. The parts add up to `total`; `cross` is the signed middle term.
    """

    model_gap: Estimate
    cross: Estimate
    bias: Estimate
    variance: Estimate
    total: Estimate


def measure(
    ours: np.ndarray | Sequence[np.ndarray],
    reference: np.ndarray | Sequence[np.ndarray],
    *,
    objects: np.ndarray | None = None,
    object_names: Sequence[str] = (),
    scale: float | None = None,
    exact: bool = False,
    noiseless: bool = True,
    names: Sequence[str] = (),
    reference_names: Sequence[str] = (),
) -> Statistics:
    """Compare replicate images of ours with replicates of the reference: phase one of a verdict.

    Parameters
    ----------
    ours : (K, H, W, 3) floating, or sequence of (H, W, 3)
        Replicates, linear Rec. 709 radiance; an array or a memory map, read by bands of rows.
    reference : (R, H, W, 3) floating, or sequence of (H, W, 3)
        Replicates of the reference in the same unit; R = 1 with `exact`.
    objects : (H, W) integer, optional
        Object index per pixel, -1 for none; each object present is judged on its own too.
    object_names : sequence of str
        Name of the object of each index.
    scale : float, optional
        Radiance that stands for the term's mean where the reference is 0 everywhere: the mean of the
        total. Without it, ours' own mean.
    exact : bool
        The one reference image has no noise.
    noiseless : bool
        Ours may be free of noise: where all its replicates are the same image that is a warning, not equal seeds.
    names, reference_names : sequence of str
        What the replicates are called in messages, say their files.

    Returns
    -------
    Statistics
        Invalid values of ours (NaN, infinite) are counted there and replaced by the reference's mean, so
        that the rest can still be measured.

    Raises
    ------
    ValueError
        For shapes that do not fit, values that are no floats, fewer than 4 replicates, two replicates that
        are the same image although others differ (or all of ours, unless it may be free of noise), an invalid
        value in the reference, a scale that is not positive.
    """
    ours, reference = _replicates("ours", ours, names), _replicates("reference", reference, reference_names)
    _check(ours, reference, objects, scale, exact)
    count, everyone = len(ours), len(ours) + len(reference)
    height, width = ours.shape[1:3]
    labels = [names[k] if k < len(names) else f"ours[{k}]" for k in range(count)] + [
        reference_names[k] if k < len(reference_names) else f"reference[{k}]" for k in range(len(reference))
    ]
    present = np.array([], dtype=int) if objects is None else np.unique(objects)
    present = present[present >= 0]

    equality = _Equality(everyone)
    pixel_products, block_products, reference_square = (
        np.zeros((everyone, everyone)),
        np.zeros((everyone, everyone)),
        0.0,
    )
    sums, areas = np.zeros((1 + len(present), everyone, 3)), np.zeros(1 + len(present))
    tile_rows, invalid, non_finite, negative, brightest = [], [], 0, 0, 0.0

    for top, band in _bands(ours, reference):
        equality.read(band)
        broken = ~(np.abs(band) <= np.finfo(np.float32).max)  # so written, it holds for NaN too
        wrong = broken | (band < 0)
        if wrong.any():
            found = [_pixel(band, index, top) for index in _first(wrong[:count])]
            if wrong[count:].any():
                first = _pixel(band[count:], _first(wrong[count:])[0], top)
                raise ValueError(f"{labels[count + first.replicate]}: {first}; a reference is finite and ≥ 0")
            invalid += found
            non_finite += int(np.count_nonzero(broken))
            negative += int(np.count_nonzero(wrong & ~broken))
            band = np.where(broken, band[count:].mean(axis=0), band)
        brightest = max(brightest, float(band.max()))

        centred = (band - band.mean(axis=0)).reshape(everyone, -1)
        pixel_products += centred @ centred.T
        luminance = _luminance(band)
        reference_square += np.sum(luminance[count:] ** 2)
        blocks, area = _block_sums(luminance, 2)
        centred = ((blocks - blocks.mean(axis=0)) / np.sqrt(area)).reshape(everyone, -1)
        block_products += centred @ centred.T
        tile_rows.append(_block_sums(np.moveaxis(band, -1, 1), TILE_SIDES[0])[0])

        sums[0] += tile_rows[-1].sum(axis=(2, 3))
        areas[0] += luminance[0].size
        if objects is not None:
            at = np.asarray(objects[top : top + band.shape[1]]).ravel()
            inside = np.flatnonzero(at >= 0)
            member = sparse.csr_array(
                (np.ones(len(inside)), (np.searchsorted(present, at[inside]), inside)),
                (len(present), len(at)),
            )
            pixels = np.ascontiguousarray(band.transpose(1, 2, 0, 3)).reshape(len(at), -1)
            sums[1:] += (member @ pixels).reshape(-1, everyone, 3)
            areas[1:] += member.sum(axis=1)

    warnings = equality.warnings(labels, count, noiseless) + [
        f"{number} replicates of {side}: fewer than {REPLICATES_WANTED}, intervals are wide and less sure"
        for side, number in (("ours", count), ("the reference", len(reference)))
        if number < REPLICATES_WANTED and not (side == "the reference" and exact)
    ]

    # Everything below is small: replicates by regions, and replicates by 8-px tiles.
    sizes = count, len(reference)
    means = sums / areas[:, None, None]
    term_mean = float(_luminance(means[0, count:].mean(axis=0)))
    reference_is_zero = bool(equality.zero[count:].all())
    if reference_is_zero:
        term_mean = scale if scale is not None else float(_luminance(means[0, :count].mean(axis=0)))
        term_mean = term_mean if term_mean > 0 else 1.0

    tile_sums = np.concatenate(tile_rows, axis=2)
    places = np.concatenate(
        [np.moveaxis(sums, 1, 0), np.moveaxis(tile_sums, 1, -1).reshape(everyone, -1, 3)], 1
    )
    rare, rare_luminance = (
        np.stack([_largest_event(values[:count]), _largest_event(values[count:])])
        for values in (places, _luminance(places)[..., None])
    )

    def compare(values: np.ndarray, least: float, area: np.ndarray | float, events: np.ndarray) -> Comparison:
        return welch(
            values[:count],
            values[count:],
            least=least,
            term_mean=term_mean,
            areas=area,
            brightest=brightest,
            events=events,
        )

    by_replicate = np.moveaxis(means, 1, 0)
    tile_area = _block_sums(np.ones((1, height, width)), TILE_SIDES[0])[1]
    tiles, channel_tiles, tile_skewness = {}, {}, {}
    for side in TILE_SIDES:
        step = side // TILE_SIDES[0]
        area = _block_sums(tile_area[None], step)[0][0]
        at_side = _block_sums(tile_sums, step)[0] / area
        at_side_luminance = _luminance(np.moveaxis(at_side, 1, -1))
        tiles[side] = compare(at_side_luminance, term_mean, area, rare_luminance)
        channel_tiles[side] = compare(at_side, term_mean, area, rare[..., None, None])
        tile_skewness[side] = max(
            _median_skewness(at_side_luminance[a:b]) for a, b in ((0, count), (count, None))
        )
    tile_means = _luminance(np.moveaxis(tile_sums / tile_area, 1, -1))
    centred = ((tile_means - tile_means.mean(axis=0)) * np.sqrt(tile_area)).reshape(everyone, -1)

    pixels = height * width
    bright = float(np.sqrt(reference_square / (len(reference) * pixels))) / term_mean
    error = np.hypot(TERM_FLOOR, ULP_FLOOR * np.finfo(np.float32).eps * bright)

    def mean_square(matrix: np.ndarray) -> Estimate:
        theta = Gram(matrix / pixels / term_mean / term_mean, sizes).squared_distance()
        # An error of `error` in every block moves a mean square θ by up to this.
        return attrs.evolve(theta, floor=float(2 * np.sqrt(max(theta.value, 0.0)) * error + error**2))

    pixel_gram = Gram(pixel_products / (3 * pixels), sizes)
    return Statistics(
        replicates=count,
        reference_replicates=len(reference),
        exact=exact,
        height=height,
        width=width,
        absent=bool(equality.zero.all()),
        reference_is_zero=reference_is_zero,
        term_mean=term_mean,
        region_names=(
            IMAGE,
            *(str(object_names[i]) if i < len(object_names) else f"object {i}" for i in present),
        ),
        regions=compare(
            by_replicate, term_mean if reference_is_zero else 0.1 * term_mean, areas[:, None], rare
        ),
        luminance=compare(_luminance(by_replicate[:, 0]), term_mean, areas[0], rare_luminance[:, 0]),
        tiles=tiles,
        channel_tiles=channel_tiles,
        tile_skewness=tile_skewness,
        mean_square={2: mean_square(block_products), 8: mean_square(centred @ centred.T)},
        bias_squared=pixel_gram.squared_distance(),
        variance=pixel_gram.variance(0).value,
        reference_variance=pixel_gram.variance(1).value,
        non_finite=non_finite,
        negative=negative,
        invalid=tuple(invalid[:LISTED_PIXELS]),
        warnings=tuple(warnings),
    )


def decide(
    statistics: Statistics,
    *,
    tests: int,
    looks: int = 1,
    kind: Kind = "right",
    allowance: float = 0.0,
    margin: float = MARGIN,
    kernel: bool = False,
    judged: bool = True,
    predicted_bias: float | None = None,
    samples: int | None = None,
    seconds: float | None = None,
    reason: str = "",
) -> Verdict:
    """Decide a row: phase two, once the number of tests of the whole run is known.

    In this order: ABSENT, BIASED (a proven error, however small the margin makes it look), EQUIVALENT
    (the interval inside the margin and the shape error below 3 %), UNDERPOWERED.

    Parameters
    ----------
    statistics : Statistics
    tests : int
        Tests of all judged rows of the run; each test is made at 5 % over it.
    looks : int
        How often the row may be decided, each time with more replicates (see `reports.statistics.sequential`): each
        look spends an equal share of the level, for BIASED and for EQUIVALENT.
    kind : "right" or "wrong"
        A wrong variant is (NOT) AS PREDICTED by its own limit.
    allowance : float
        Relative bias that the row is known to have; added to what is tolerated and to the margin.
    margin : float
        Relative; see `margin_of`.
    kernel : bool
        A kernel-based row against anything but its twin: only its means are judged; the rest is a warning.
    judged : bool
        False for rows that measure a known difference (prefixes, against `correct` or `physical`): the
        verdict, and all at the family's level, is None.
    predicted_bias : float, optional
        Relative; named by the sentence of a row that is not judged.
    samples, seconds : optional
        What this row took, to be scaled to what it would take.
    reason : str
        Why a term is absent, say the skip that the plan made.

    Raises
    ------
    ValueError
        For a value out of range.
    """
    own = statistics.mean_tests if kernel else statistics.tests
    if looks < 1:
        raise ValueError(f"looks is {looks}; it must be at least 1")
    if kind not in WORDS:
        raise ValueError(f"kind is {kind!r}; allowed: {', '.join(WORDS)}")
    if judged and tests < own:
        raise ValueError(f"tests is {tests}; it counts all rows of the run, and this row alone makes {own}")
    for name, value, allowed in (
        ("allowance", allowance, allowance >= 0),
        ("margin", margin, margin > 0),
        ("samples", samples, samples is None or samples > 0),
        ("seconds", seconds, seconds is None or seconds >= 0),
    ):
        if not allowed or (value is not None and not np.isfinite(value)):
            raise ValueError(f"{name} is {value}; it must be finite and positive")

    level, outside = LEVEL / max(tests, 1) / looks, OUTSIDE / looks
    limit = _limit(statistics, allowance)
    printed = [*_place_errors(statistics, level), *_shape_errors(statistics, level)]
    proven = [*_invalid_values(statistics), *_mean_errors(statistics, level, limit)]
    unproven = _mean_errors(statistics, level, limit, missing=True)
    if not kernel:
        proven, printed = proven + printed, []
        unproven += _place_errors(statistics, level, missing=True)
    open_questions = (
        *(each.text for each in unproven),
        *_open_questions(statistics, margin + allowance, outside),
    )
    biased, equivalent = WORDS[kind]
    if not judged:
        word, reasons = None, ()
    elif statistics.absent:
        word, reasons = "ABSENT", (reason,) if reason else ()
    elif proven:
        word, reasons = biased, tuple(each.text for each in proven)
    elif not open_questions:
        word, reasons = equivalent, ()
    else:
        word, reasons = "UNDERPOWERED", open_questions

    due = judged and not statistics.absent
    luminance = statistics.luminance
    low, high = (float(end) for end in luminance.interval(2 * outside))
    family_low, family_high = (float(end) if due else None for end in luminance.interval(level))
    tile = _worst_tile(statistics)
    theta = statistics.mean_square[8]
    needed = _samples_ratio(statistics, margin + allowance, outside)
    samples_to_margin = None if samples is None or needed is None else max(1, int(np.ceil(samples * needed)))
    verdict = Verdict(
        verdict=word,
        sentence="",
        reasons=reasons,
        bias=float(luminance.bias),
        bias_low=low,
        bias_high=high,
        standard_error=float(luminance.standard_error),
        family_low=family_low,
        family_high=family_high,
        regions=_regions(statistics, level if due else None, limit, outside),
        rms_bias=float(np.sign(theta.value) * np.sqrt(abs(theta.value))),
        rms_bias_high=_shape_bound(theta, outside),
        place=next((each.place for each in proven), _describe(tile)),
        tile=tile,
        detectable_bias=float(statistics.regions.detectable(level, limit)[0].max()) if due else None,
        samples_to_margin=samples_to_margin,
        seconds_to_margin=None if seconds is None or needed is None else seconds * needed,
        margin=margin,
        allowance=allowance,
        tests=tests if due else None,
        looks=looks,
        predicted_bias=predicted_bias,
        warnings=statistics.warnings + tuple(f"{each.text} (printed, not judged)" for each in printed),
    )
    return attrs.evolve(verdict, sentence=_sentence(verdict, statistics, kernel))


def judge(
    images: np.ndarray | Sequence[np.ndarray],
    reference: np.ndarray | Sequence[np.ndarray],
    *,
    exact: bool = False,
    noiseless: bool = False,
    names: Sequence[str] = (),
    reference_names: Sequence[str] = (),
    objects: np.ndarray | None = None,
    object_names: Sequence[str] = (),
) -> Verdict:
    """Verdict on any renderer's replicate images: a run of one row.

    Parameters
    ----------
    images, reference : (K, H, W, 3) and (R, H, W, 3) floating, or sequences of (H, W, 3)
        Independent replicates (own seed each), linear radiance in one unit. With `exact`, `reference` may
        be a single (H, W, 3) image.
    exact, noiseless, names, reference_names, objects, object_names
        As for `measure`; nothing is known of the seeds here, so replicates that are all the same image are
        refused unless `noiseless`.

    Raises
    ------
    ValueError
        As `measure`.
    """
    if exact and isinstance(reference, np.ndarray) and reference.ndim == 3:
        reference = reference[None]
    statistics = measure(
        images,
        reference,
        exact=exact,
        noiseless=noiseless,
        names=names,
        reference_names=reference_names,
        objects=objects,
        object_names=object_names,
    )
    return decide(statistics, tests=statistics.tests)


def margin_of(kind: Kind, own_mean: float = 0.0, correct_mean: float = 0.0) -> float:
    """Relative margin m of a row: 1 %; for a wrong variant one that cannot hide what makes it wrong.

    The smaller of 1 % and 5 % of `|own - correct|` relative to `own`, never below 0.5 %.
    """
    if kind == "right" or own_mean == 0:
        return MARGIN
    return max(0.005, min(MARGIN, 0.05 * abs(own_mean - correct_mean) / abs(own_mean)))


def gram(*groups: np.ndarray) -> Gram:
    """Gram matrix over pixels and channels of groups (n, H, W, 3) of equal image shape, read by bands."""
    sizes = tuple(len(group) for group in groups)
    matrix = np.zeros((sum(sizes), sum(sizes)))
    for _, band in _bands(*groups):
        centred = (band - band.mean(axis=0)).reshape(len(band), -1)
        matrix += centred @ centred.T
    return Gram(matrix / np.prod(groups[0].shape[1:]), sizes)


def split_error(ours: np.ndarray, own: np.ndarray, physical: np.ndarray) -> ErrorSplit:
    """Split the error of one replicate of ours against full light transport into its four causes.

    `G = own - physical` is the model gap, `B = E[ours] - own` the estimator's bias, `V` the variance of one
    replicate. Products are taken over different replicates only, so that no part holds noise in its mean.

    Parameters
    ----------
    ours, own, physical : (n, H, W, 3) floating
        Replicates, in one unit of radiance; a group of one is taken as exact, but ours needs more.

    Raises
    ------
    ValueError
        For groups that do not fit or fewer than 4 replicates of ours.
    """
    groups = tuple(_replicates(*each) for each in (("ours", ours), ("own", own), ("physical", physical)))
    for group in groups[1:]:
        _check(groups[0], group, None, None, len(group) == 1)
    products = gram(*groups)
    b, g = np.array([1.0, -1.0, 0.0]), np.array([0.0, 1.0, -1.0])
    return ErrorSplit(
        model_gap=products.estimate(np.outer(g, g)),
        cross=products.estimate(2 * np.outer(g, b)),
        bias=products.estimate(np.outer(b, b)),
        variance=products.estimate(np.zeros((3, 3)), (1.0, 0.0, 0.0)),
        total=products.estimate(np.outer(g + b, g + b), (1.0, 0.0, 0.0)),
    )


def float_error(kept: np.ndarray, rendered: np.ndarray) -> Estimate:
    """The share of `mean(B²)` that rounding alone makes: `mean(E[kept - rendered]²)`, unbiased.

    Parameters
    ----------
    kept, rendered : (K, H, W, 3) float32 and float64
        The same replicates, of the same random numbers, as they are judged and as they were added up.
    """
    difference = np.subtract(kept, rendered, dtype=np.float64).reshape(len(kept), -1)
    return Gram(difference @ difference.T / difference.shape[1], (len(kept),)).estimate(np.ones((1, 1)))


# The rule, part by part.


@attrs.frozen
class _Finding:
    """An error that is proven at the family's level, in words, and where it stands."""

    text: str
    place: str


def _limit(statistics: Statistics, allowance: float) -> float:
    """Tolerated mean bias, f + a; nothing is tolerated where the reference is exactly 0."""
    return 0.0 if statistics.reference_is_zero else TOLERATED_BIAS + allowance


def _invalid_values(statistics: Statistics) -> list[_Finding]:
    if not statistics.invalid:
        return []
    first = statistics.invalid[0]
    counts = f"{statistics.non_finite} values not finite, {statistics.negative} negative"
    text = f"{counts}, the first: {first} in replicate {first.replicate}"
    return [_Finding(text, f"x {first.x}, y {first.y}")]


def _outside(
    comparison: Comparison, level: float, limit: float, missing: bool = False
) -> list[tuple[int, str]]:
    """Flat index and interval of each place that lies wholly outside ±limit, the surest first.

    `missing` chooses those that rare events may explain, which no replicate met: no proof.
    """
    low, high = comparison.interval(level)
    excess = (np.abs(comparison.bias) - limit) / comparison.standard_error
    explained = np.abs(comparison.bias) <= comparison.missing(level)
    found = np.flatnonzero(((low > limit) | (high < -limit)) & (explained == missing))

    def text(i: int) -> str:
        bias = comparison.bias.flat[i]
        interval = f"{_percent(bias)} [{_percent(low.flat[i])}, {_percent(high.flat[i])}]"
        if not missing:
            return interval
        events = abs(bias) / comparison.unseen.flat[i]
        return f"{interval}, no proof: {events:.2g} rare events, as bright as others, may be missing"

    return [(int(i), text(i)) for i in found[np.argsort(-excess.flat[found])]]


def _mean_errors(statistics: Statistics, level: float, limit: float, missing: bool = False) -> list[_Finding]:
    """Rule 2a."""
    findings = []
    for index, interval in _outside(statistics.regions, level, limit, missing):
        region, channel = divmod(index, len(CHANNELS))
        place = f"{statistics.region_names[region]}, {CHANNELS[channel]}"
        findings.append(_Finding(f"mean of {place}: {interval}", place))
    return findings


def _shape_errors(statistics: Statistics, level: float) -> list[_Finding]:
    """Rule 2b."""
    findings = []
    for side, limit in SHAPE_LIMITS.items():
        theta = statistics.mean_square[side]
        if (low := theta.low(level)) > limit**2:
            found, least = np.sqrt([theta.value, low])
            place = f"spread, most of all {_describe(_worst_tile(statistics))}"
            text = f"shape over {side}-px blocks: {found:.2%} rms, at least {least:.2%} (limit {limit:.1%})"
            findings.append(_Finding(text, place))
    return findings


def _place_errors(statistics: Statistics, level: float, missing: bool = False) -> list[_Finding]:
    """Rule 2c: one finding, the surest tile and how many there are."""
    tiles = statistics.tiles[PLACE_SIDE]
    limit = 0.0 if statistics.reference_is_zero else PLACE_LIMIT
    found = _outside(tiles, level / tiles.bias.size, limit, missing)
    if not found:
        return []
    index, interval = found[0]
    place = _describe(_tile(statistics, index))
    return [_Finding(f"{place}: {interval}, the surest of {len(found)} of {tiles.bias.size} tiles", place)]


def _shape_bound(theta: Estimate, outside: float) -> float:
    """U of rule 3."""
    return float(np.sqrt(max(0.0, theta.high(outside))))


def _open_questions(statistics: Statistics, margin: float, outside: float) -> tuple[str, ...]:
    """What keeps a row from being EQUIVALENT by rule 3."""
    low, high = (end[0] for end in statistics.regions.interval(2 * outside))
    questions = [
        f"image, {channel}: [{_percent(low[c])}, {_percent(high[c])}] ({_confidence(outside)}), "
        f"not inside ±{margin:.2%}"
        for c, channel in enumerate(CHANNELS)
        if not (-margin < low[c] and high[c] < margin)
    ]
    if (bound := _shape_bound(statistics.mean_square[8], outside)) >= SHAPE_MARGIN:
        questions.append(
            f"shape error of up to {bound:.2%} rms over 8-px tiles is not below {SHAPE_MARGIN:.0%}"
        )
    return tuple(questions)


def _samples_ratio(statistics: Statistics, margin: float, outside: float) -> float | None:
    """Factor on the samples of both sides at which an unbiased row is EQUIVALENT with a power of 80 %.

    Standard errors of means fall as 1/sqrt(samples); that of a mean square around 0 falls as 1/samples.
    """
    low, high = (end[0] for end in statistics.regions.interval(2 * outside))
    theta = statistics.mean_square[8]
    if np.any((low > margin) | (high < -margin)) or theta.low(outside) > SHAPE_MARGIN**2:
        return None
    # An interval can leave the margin at either end, U only at one: hence half the misses for each end.
    error, dof = statistics.regions.standard_error[0], statistics.regions.dof[0]
    mean = np.max((stats.t.isf(outside, dof) + stats.t.isf((1 - POWER) / 2, dof)) * error) / margin
    quantiles = stats.t.isf([outside, 1 - POWER], theta.dof).sum()
    return float(max(mean**2, quantiles * theta.standard_error / SHAPE_MARGIN**2))


def _regions(
    statistics: Statistics, level: float | None, limit: float, outside: float
) -> tuple[RegionBias, ...]:
    low, high = statistics.regions.interval(2 * outside)
    at_level = (
        None
        if level is None
        else (*statistics.regions.interval(level), statistics.regions.detectable(level, limit))
    )
    return tuple(
        RegionBias(
            region=region,
            channel=channel,
            bias=float(statistics.regions.bias[r, c]),
            low=float(low[r, c]),
            high=float(high[r, c]),
            family_low=None if at_level is None else float(at_level[0][r, c]),
            family_high=None if at_level is None else float(at_level[1][r, c]),
            standard_error=float(statistics.regions.standard_error[r, c]),
            detectable_bias=None if at_level is None else float(at_level[2][r, c]),
        )
        for r, region in enumerate(statistics.region_names)
        for c, channel in enumerate(CHANNELS)
    )


def _worst_tile(statistics: Statistics) -> tuple[int, int, int, int]:
    """The 16-px tile whose bias is the most significant."""
    tiles = statistics.tiles[PLACE_SIDE]
    return _tile(statistics, int(np.argmax(np.abs(tiles.bias) / tiles.standard_error)))


def _tile(statistics: Statistics, index: int) -> tuple[int, int, int, int]:
    """x, y, width and height of a 16-px tile; those at the right and lower border may be smaller."""
    y, x = (PLACE_SIDE * i for i in divmod(index, statistics.tiles[PLACE_SIDE].bias.shape[1]))
    return x, y, min(PLACE_SIDE, statistics.width - x), min(PLACE_SIDE, statistics.height - y)


def _describe(tile: tuple[int, int, int, int]) -> str:
    x, y, width, height = tile
    return f"tile x {x}-{x + width - 1}, y {y}-{y + height - 1}"


def _confidence(outside: float) -> str:
    """Of the two-sided interval that leaves out `outside` at each end."""
    return f"{100 * (1 - 2 * outside):g} %"


def _percent(value: np.ndarray | float) -> str:
    return f"{value:+.2%}" if abs(value) < 10 else f"{100 * value:+.2e}%"


def _sentence(verdict: Verdict, statistics: Statistics, kernel: bool) -> str:
    """What was tested, what was found, and what is not excluded."""
    outside = OUTSIDE / verdict.looks
    bias = f"{_percent(verdict.bias)} [{_percent(verdict.bias_low)}, {_percent(verdict.bias_high)}]"
    if verdict.verdict is None:
        predicted = (
            "" if verdict.predicted_bias is None else f"; predicted {_percent(verdict.predicted_bias)}"
        )
        return f"Measured, not judged: luminance differs by {bias} ({_confidence(outside)}){predicted}."
    if verdict.verdict == "ABSENT":
        why = f" ({verdict.reasons[0]})" if verdict.reasons else ""
        return f"ABSENT: both sides are exactly 0 everywhere{why}; nothing was tested."
    biased, equivalent = zip(*WORDS.values(), strict=True)
    margin = f"the margin of ±{verdict.margin + verdict.allowance:.2%}"
    if verdict.allowance:
        margin += f" (an allowance of {verdict.allowance:.2%} in it)"
    objects = len(statistics.region_names) - 1
    regions = "image" + (f" and {objects} object{'s' if objects > 1 else ''}" if objects else "")
    tolerated = f"up to {_limit(statistics, verdict.allowance):.2%} tolerated"
    more = "" if kernel else f", {len(SHAPE_LIMITS)} of shape, 1 of place"
    looks = "" if verdict.looks == 1 else f"/{verdict.looks} ({verdict.looks} looks)"
    tested = (
        f"{statistics.mean_tests} Welch tests of means ({regions}; red, green, blue; {tolerated}){more}, "
        f"of n = {verdict.tests} in the run, each at {LEVEL:.0%}/{verdict.tests}{looks}"
    )
    against = (
        "one image taken as exact"
        if statistics.exact
        else f"R = {statistics.reference_replicates} of the reference"
    )
    parts = [
        f"{verdict.verdict}: relative bias of the mean luminance {bias} ({_confidence(outside)}), "
        f"K = {statistics.replicates} replicates against {against}"
    ]
    reasons = "; ".join(verdict.reasons[:3])
    if len(verdict.reasons) > 3:
        reasons += f"; and {len(verdict.reasons) - 3} more"
    if verdict.verdict in biased:
        parts.append(f"an error is proven by {tested}, whatever {margin}: {reasons}")
    elif verdict.verdict in equivalent:
        parts.append(f"the intervals of red, green and blue ({_confidence(outside)}) lie inside {margin}")
        parts.append(f"no error is proven by {tested}")
    else:
        parts.append(f"equivalence within {margin} is not shown: {reasons}")
        parts.append(_needed(verdict, statistics, outside))
        parts.append(f"no error is proven by {tested}")
    parts.append(
        f"smallest detectable bias of the image's mean {verdict.detectable_bias:.2%} (found in {POWER:.0%} of runs)"
    )
    if verdict.verdict in biased:
        parts.append("further errors are not excluded")
    else:
        shape = f"a shape error of up to {verdict.rms_bias_high:.2%} rms over 8-px tiles"
        parts.append(f"not excluded: a smaller one, and {shape}{', which was not judged' if kernel else ''}")
    return "; ".join(parts) + "."


def _needed(verdict: Verdict, statistics: Statistics, outside: float) -> str:
    """What it takes to decide an UNDERPOWERED row."""
    needed = _samples_ratio(statistics, verdict.margin + verdict.allowance, outside)
    if needed is None:
        return "a bias beyond the margin is likely, which more samples would prove rather than remove"
    if verdict.samples_to_margin is None:
        return f"an unbiased estimator would need {max(1.0, needed):.2g} times the samples on both sides"
    took = "" if verdict.seconds_to_margin is None else f", {verdict.seconds_to_margin:.3g} s"
    return f"an unbiased row would need {verdict.samples_to_margin} samples on both sides{took}"


# Reading the images.


def _replicates(
    side: str, images: np.ndarray | Sequence[np.ndarray], names: Sequence[str] = ()
) -> np.ndarray:
    """Images as one (n, H, W, 3) array; a memory map stays one."""
    if not isinstance(images, np.ndarray):
        arrays = [np.asarray(image) for image in images]
        for k, array in enumerate(arrays):
            if array.shape != arrays[0].shape:
                name, first = (names[i] if i < len(names) else f"{side}[{i}]" for i in (k, 0))
                raise ValueError(f"{name}: shape {array.shape} differs from {arrays[0].shape} of {first}")
        images = np.stack(arrays) if arrays else np.empty((0, 0, 0, 3))
    if images.ndim != 4 or images.shape[3] != 3 or 0 in images.shape:
        raise ValueError(
            f"{side}: shape {images.shape}; allowed is (replicates, height, width, 3), none of them 0"
        )
    if not np.issubdtype(images.dtype, np.floating):
        raise ValueError(f"{side}: dtype {images.dtype}; linear radiance in floating point is needed")
    return images


def _check(
    ours: np.ndarray, reference: np.ndarray, objects: np.ndarray | None, scale: float | None, exact: bool
) -> None:
    if ours.shape[1:] != reference.shape[1:]:
        raise ValueError(
            f"ours: images of shape {ours.shape[1:]}, but the reference's are {reference.shape[1:]}"
        )
    if len(ours) < REPLICATES_NEEDED:
        raise ValueError(
            f"ours: {_counted(len(ours))}; at least {REPLICATES_NEEDED} are needed, each with a seed of its own"
        )
    if exact and len(reference) != 1:
        raise ValueError(f"reference: {len(reference)} images; an exact reference is one image")
    if not exact and len(reference) < REPLICATES_NEEDED:
        hint = "; one image needs exact (--reference-exact)" if len(reference) == 1 else ""
        raise ValueError(
            f"reference: {_counted(len(reference))}; at least {REPLICATES_NEEDED} are needed{hint}"
        )
    if objects is not None and (
        objects.shape != ours.shape[1:3] or not np.issubdtype(objects.dtype, np.integer)
    ):
        raise ValueError(
            f"objects: {objects.dtype} {objects.shape}; allowed is an integer map {ours.shape[1:3]}"
        )
    if scale is not None and not (np.isfinite(scale) and scale > 0):
        raise ValueError(f"scale is {scale}; it must be finite and positive")


def _counted(replicates: int) -> str:
    return f"{replicates} replicate{'' if replicates == 1 else 's'}"


def _bands(*groups: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """First row and float64 pixels (replicates of all groups, rows, W, 3) of bands of whole 32-px tiles."""
    height, width = groups[0].shape[1:3]
    tallest = TILE_SIDES[-1]
    row = sum(len(group) for group in groups) * width * 3 * 8
    rows = max(1, BAND_BYTES // (row * tallest)) * tallest
    for top in range(0, height, rows):
        yield top, np.concatenate([group[:, top : top + rows] for group in groups]).astype(np.float64)


def _luminance(rgb: np.ndarray) -> np.ndarray:
    """Of the last axis. Written out: a BLAS product may round equal replicates differently."""
    return LUMINANCE[0] * rgb[..., 0] + LUMINANCE[1] * rgb[..., 1] + LUMINANCE[2] * rgb[..., 2]


def _block_sums(values: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Sums over blocks of the last two axes and the blocks' areas; border blocks may be smaller."""
    rows, columns = (np.arange(0, length, side) for length in values.shape[-2:])
    sums = np.add.reduceat(np.add.reduceat(values, rows, axis=-2), columns, axis=-1)
    heights, widths = (
        np.diff(starts, append=length)
        for starts, length in zip((rows, columns), values.shape[-2:], strict=True)
    )
    return sums, np.multiply.outer(heights, widths).astype(np.float64)


def welch(
    ours: np.ndarray,
    reference: np.ndarray,
    *,
    least: float,
    term_mean: float,
    areas: np.ndarray | float,
    brightest: float,
    events: np.ndarray | tuple[float, float] = (0.0, 0.0),
) -> Comparison:
    """Compare replicate means (K, ...) and (R, ...), relative to the reference or `least` if larger.

    `areas` are the pixels of each place, `brightest` is the largest pixel of any replicate, `events` are the sums over
    pixels of the largest rare event of each side (see `_largest_event`).
    """

    def mean_and_variance(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        shifted = values - values[0]  # equal replicates: exactly 0
        count = len(values)
        variance = np.var(shifted, axis=0, ddof=1) / count if count > 1 else np.zeros(values.shape[1:])
        return values[0] + shifted.mean(axis=0), np.asarray(variance)

    (mean, variance), (other, other_variance) = mean_and_variance(ours), mean_and_variance(reference)
    event = brightest / areas
    variance = _borrowed(mean, variance, other, event / len(ours))
    if len(reference) > 1:
        other_variance = _borrowed(other, other_variance, mean, event / len(reference))
    both = variance + other_variance
    noiseless = both == 0
    share = np.divide(variance, both, out=np.zeros_like(both), where=~noiseless)
    spread = share**2 / (len(ours) - 1) + (1 - share) ** 2 / max(len(reference) - 1, 1)
    dof = np.where(noiseless, len(ours) + len(reference) - 2, 1 / spread)
    floor = np.hypot(TERM_FLOOR * term_mean, ULP_FLOOR * np.spacing(other.astype(np.float32)))
    scale = np.maximum(other, least)
    error = np.hypot(np.sqrt(both), floor) / scale
    bias = np.asarray((mean - other) / scale)
    event = np.where(bias < 0, events[0] / len(ours), events[1] / len(reference)) / areas
    own = np.where(bias < 0, variance, other_variance)
    # What is below 1e-15 of the noise is rounding, no event.
    seen = np.divide(own, event**2, out=np.zeros_like(own), where=event**2 > 1e-30 * own)
    return Comparison(mean, other, bias, error, scale, dof, noiseless, event / scale, seen)


def _largest_event(sums: np.ndarray) -> np.ndarray:
    """What the largest rare event adds to one of the replicates (n, places, channels), by channel; 0 without any."""
    if len(sums) == 1:
        return np.zeros(sums.shape[2])
    usual = np.sort(sums, axis=0)[: len(sums) - max(1, len(sums) // 4)]
    far = _OF_THE_LARGEST * stats.t.isf(RARE_EVENT, len(usual) - 1) * usual.std(axis=0, ddof=1)
    excess = sums.max(axis=0) - usual.mean(axis=0)
    return np.where(excess > far, excess, 0.0).max(axis=0)


def _borrowed(
    mean: np.ndarray, variance: np.ndarray, other: np.ndarray, event: np.ndarray | float
) -> np.ndarray:
    """Variances of the means; a place where one side alone is 0 in all replicates has that of a place like the others.

    A sparse estimator may have no sample there, and its variance of 0 then proves nothing. Such a place has, for the
    mean of the other side, the larger of two: the largest variance relative to the square of the mean found anywhere on
    that side; and that of a Poisson law, mean times `event`, what one sample as bright as the brightest pixel adds to
    the mean of all replicates. A term that is lost there stays proven where the side is otherwise sure of itself.
    """
    lost = (mean == 0) & (other > 0)
    if not lost.any():
        return variance
    varying = (mean > 0) & (variance > 0)
    relative = np.max(variance[varying] / mean[varying] ** 2) if varying.any() else 0.0
    return np.where(lost, np.maximum(relative * other**2, event * other), variance)


def _median_skewness(values: np.ndarray) -> float:
    """Of replicate means (n, ...) over the places that vary; 0 where none does, or too few replicates tell."""
    shifted = (values - values[0]).reshape(len(values), -1)
    varying = shifted[:, shifted.any(axis=0)]
    if len(values) < 3 or not varying.size:
        return 0.0
    return float(np.median(stats.skew(varying, axis=0, bias=False)))


def _first(mask: np.ndarray) -> list[tuple[int, ...]]:
    """Indices of the first values marked."""
    at = np.unravel_index(np.flatnonzero(mask)[:LISTED_PIXELS], mask.shape)
    return [tuple(int(i) for i in index) for index in zip(*at, strict=True)]


def _pixel(band: np.ndarray, index: tuple[int, ...], top: int) -> InvalidPixel:
    replicate, y, x, channel = index
    return InvalidPixel(replicate, top + y, x, CHANNELS[channel], float(band[index]))


class _Equality:
    """Finds replicates that are the same image, which independent seeds do not give."""

    def __init__(self, replicates: int) -> None:
        self.digests = [hashlib.sha256() for _ in range(replicates)]  # processors have instructions for it
        self.differing = np.zeros(replicates - 1)
        self.zero = np.ones(replicates, dtype=bool)

    def read(self, band: np.ndarray) -> None:
        for digest, image in zip(self.digests, band, strict=True):
            digest.update(image)
        # By the bits, as the digests compare: NaN equals itself here.
        bits = band.view(np.uint64)
        red, green, blue = np.moveaxis(bits[1:] != bits[:-1], -1, 0)
        self.differing += np.count_nonzero(red | green | blue, axis=(1, 2))
        self.zero &= ~band.reshape(len(band), -1).any(axis=1)

    def warnings(self, labels: Sequence[str], count: int, noiseless: bool) -> list[str]:
        """What is odd but allowed; ValueError for equal seeds. The first `count` images are ours.

        Without `noiseless`, a side that never varies has equal seeds, too.
        """
        digests = [digest.digest() for digest in self.digests]
        sides = {"ours": range(count), "the reference": range(count, len(digests))}
        constant = {side: len({digests[k] for k in members}) == 1 for side, members in sides.items()}
        same = [
            side
            for side, members in sides.items()
            if constant[side] and len(members) > 1 and not self.zero[members[0]]
        ]
        if same and not noiseless:
            hints = {
                "ours": "a renderer without noise needs noiseless (--noiseless)",
                "the reference": "one without noise is one image and exact (--reference-exact)",
            }
            raise ValueError(f"all replicates of {same[0]} are the same image: equal seeds? {hints[same[0]]}")
        warnings = [f"all replicates of {side} are the same image: taken as free of noise" for side in same]
        first: dict[bytes, int] = {}
        typical = np.delete(self.differing, count - 1).max()
        for k, digest in enumerate(digests):
            if (other := first.setdefault(digest, k)) == k:
                continue
            side, other_side = ("ours" if i < count else "the reference" for i in (k, other))
            if constant[side] and constant[other_side]:
                continue
            if self.zero[k]:  # of a sparse estimator, whatever the seed
                continue
            text = f"{labels[other]} and {labels[k]} are the same image"
            if typical >= DISTINCT_PIXELS:
                raise ValueError(f"{text}: equal seeds? Replicates must be independent")
            warnings.append(f"{text}; possible by chance, since few pixels vary")
        return warnings
