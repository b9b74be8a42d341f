"""The rule: which errors are proven, what is left open, and the verdict that follows.

There are two phases because the level of each test is 5 % over the number of tests of the whole run (Bonferroni):
`measure` every row, add up their `tests`, then `decide` each. A row makes three kinds of test, and an error is proven
by

    2a  a mean           that lies outside ±(f + a) by Welch's interval, of a region in a channel
    2b  the shape        whose mean square over single pixels, or blocks of 2 or 8 px, is above its limit, by its lower
                         bound
    2c  a place          whose mean lies outside ±0.5 %: a tile of 16 px, a window of 8 px, an outermost row or column

Shape and places are judged in luminance, red, green and blue: luminance has half of a test's level, the channels share
the rest, and in 2c the places share that. A row is EQUIVALENT by rule 3 if the intervals of the image's channels lie
inside the margin and the upper bounds of the shape error below 1 %; and where a few bright pixels are most of the
image's mean, if what is left of the picture lies inside the margin too.
"""

from collections.abc import Callable, Sequence
from typing import Any

import attrs
import numpy as np
import scipy

from termwise.reports.statistics import student
from termwise.reports.statistics.accumulation import BORDERS, CELL, Statistics, measure
from termwise.reports.statistics.jackknife import Estimate
from termwise.reports.statistics.replicates import CHANNELS, QUANTITIES
from termwise.reports.statistics.sentence import BLOCKS, confidence, percent, sentence, tile_words
from termwise.reports.statistics.verdict import (
    KERNEL_SHAPE_MARGIN,
    LEVEL,
    MARGIN,
    OUTSIDE,
    PLACE_LIMIT,
    PLACE_SIDE,
    POWER,
    SHAPE_LIMITS,
    SHAPE_MARGIN,
    SHARES,
    TOLERATED_BIAS,
    WINDOW_SIDE,
    WORDS,
    Kind,
    RegionBias,
    Verdict,
)
from termwise.reports.statistics.welch import Comparison

_SURE = 3.0
"""Standard errors by which a tile's bias is lessened before tiles are compared by it."""


def decide(
    statistics: Statistics,
    *,
    tests: int,
    looks: int = 1,
    kind: Kind = "right",
    allowance: float = 0.0,
    margin: float = MARGIN,
    level: float = LEVEL,
    kernel: bool = False,
    judged: bool = True,
    predicted_bias: float | None = None,
    samples: int | None = None,
    seconds: float | None = None,
    reason: str = "",
) -> Verdict:
    """Decide a row: phase two, once the number of tests of the whole run is known.

    In this order: ABSENT, BIASED (a proven error, however small the margin makes it look), EQUIVALENT
    (the interval inside the margin and the shape error below 1 %), UNDERPOWERED.

    Parameters
    ----------
    statistics : Statistics
    tests : tests of all judged rows of the run; each test is made at 5 % over it.
    looks : how often the row may be decided, each time with more replicates (see `reports.statistics.sequential`): each
        look spends an equal share of the level, for BIASED and for EQUIVALENT.
    kind : a wrong variant is (NOT) AS PREDICTED by its own limit.
    allowance : relative bias that the row is known to have; added to what is tolerated and to the margin.
    margin : relative; see `margin_of`.
    level : chance of any false alarm in the run.
    kernel : bool
        A kernel-based row against anything but its kernel reference: an error is proven by its means (or by invalid
        values) alone, one of the shape or of a place is a warning. EQUIVALENT asks for a shape error below 3 %.
    judged : false for rows that measure a known difference (prefixes, against `correct` or `physical`): the verdict,
        and all at the family's level, is None.
    predicted_bias : relative; named by the sentence of a row that is not judged.
    samples, seconds : what this row took, to be scaled to what it would take.
    reason : why a term is absent, say the skip that the plan made.

    Raises
    ------
    ValueError : for a value out of range.
    """
    _check(statistics, tests, looks, kind, kernel, judged)
    _check_numbers(allowance=allowance, margin=margin, level=level, samples=samples, seconds=seconds)
    each, outside, within = level / max(tests, 1) / looks, OUTSIDE / looks, margin + allowance
    limit = _limit(statistics, allowance)
    shape_margin = KERNEL_SHAPE_MARGIN if kernel else SHAPE_MARGIN
    proven, unproven, printed = _errors(statistics, each, limit, kernel)
    questions = (*(one.text for one in unproven), *_open_questions(statistics, within, shape_margin, outside))
    biased, equivalent = WORDS[kind]
    if not judged:
        word, reasons = None, ()
    elif statistics.absent:
        word, reasons = "ABSENT", (reason,) if reason else ()
    elif proven:
        word, reasons = biased, tuple(one.text for one in proven)
    elif not questions:
        word, reasons = equivalent, ()
    else:
        word, reasons = "UNDERPOWERED", questions

    due = judged and not statistics.absent
    tile, needed = _worst_tile(statistics), _samples_ratio(statistics, within, shape_margin, outside)
    samples_to_margin, seconds_to_margin = _scaled(needed, samples, seconds)
    found = Verdict(
        verdict=word,
        sentence="",
        reasons=reasons,
        **_intervals(statistics, each if due else None, limit, outside),
        tolerated=_tolerated(statistics, each, limit) if due else (),
        place=next((one.place for one in proven), tile_words(tile)),
        tile=tile,
        samples_ratio=needed,
        samples_to_margin=samples_to_margin,
        seconds_to_margin=seconds_to_margin,
        margin=margin,
        allowance=allowance,
        level=level,
        tests=tests if due else None,
        looks=looks,
        predicted_bias=predicted_bias,
        warnings=statistics.warnings + tuple(f"{one.text} (printed, not judged)" for one in printed),
    )
    said = sentence(found, statistics, kernel=kernel, tolerated=limit, needed=needed)
    return attrs.evolve(found, sentence=said)


def _check(statistics: Statistics, tests: int, looks: int, kind: str, kernel: bool, judged: bool) -> None:
    own = statistics.mean_tests if kernel else statistics.tests
    if looks < 1:
        raise ValueError(f"looks is {looks}; it must be at least 1")
    if kind not in WORDS:
        raise ValueError(f"kind is {kind!r}; allowed: {', '.join(WORDS)}")
    if judged and tests < own:
        raise ValueError(f"tests is {tests}; it counts all rows of the run, and this row alone makes {own}")


def _check_numbers(
    *, allowance: float, margin: float, level: float, samples: int | None, seconds: float | None
) -> None:
    for name, value, allowed in (
        ("allowance", allowance, allowance >= 0),
        ("margin", margin, margin > 0),
        ("level", level, level > 0),
        ("samples", samples, samples is None or samples > 0),
        ("seconds", seconds, seconds is None or seconds >= 0),
    ):
        if not allowed or (value is not None and not np.isfinite(value)):
            raise ValueError(f"{name} is {value}; it must be finite and positive")
    if not level < 1:
        raise ValueError(f"level is {level}; it must be below 1")


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
    margin: float = MARGIN,
    quantum: tuple[float, float] = (0.0, 0.0),
) -> Verdict:
    """Verdict on any renderer's replicate images: a run of one row.

    Parameters
    ----------
    images, reference : (K, H, W, 3) and (R, H, W, 3) floating, or sequences of (H, W, 3) Independent replicates (own
        seed each), linear radiance in one unit. With `exact`, `reference` may be a single (H, W, 3) image.
    exact : the reference has no noise.
    noiseless : the images may have no noise. Nothing is known of the seeds here, so replicates that are all the same
        image are refused without it.
    names, reference_names : what the replicates are called in warnings and messages; by default their numbers.
    objects : (H, W) integer, optional
        Index of the object that each pixel sees, -1 for none; each object is judged on its own too.
    object_names : names of those objects, by index.
    margin : relative bias of the mean within which the two are equivalent.
    quantum : relative rounding error of the stored values of images and reference beyond float32's, 2^-11 for half
        floats.

    Returns
    -------
    The verdict, its sentence, and the numbers behind it.

    Raises
    ------
    ValueError : images of unequal size or too few, NaN in the reference, replicates that are the same image; the
        message says which, and what is allowed.
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
        quantum=quantum,
    )
    return decide(statistics, tests=statistics.tests, margin=margin)


def margin_of(kind: Kind, own_mean: float = 0.0, correct_mean: float = 0.0) -> float:
    """Relative margin m of a row: 1 %; for a wrong variant one that cannot hide what makes it wrong.

    The smaller of 1 % and 5 % of `|own - correct|` relative to `own`, never below 0.5 %.
    """
    if kind == "right" or own_mean == 0:
        return MARGIN
    return max(0.005, min(MARGIN, 0.05 * abs(own_mean - correct_mean) / abs(own_mean)))


@attrs.frozen
class _Finding:
    """An error that is proven at the family's level, in words, and where it stands."""

    text: str
    place: str


def _limit(statistics: Statistics, allowance: float) -> float:
    """Tolerated mean bias, f + a; nothing is tolerated where the reference is exactly 0."""
    return 0.0 if statistics.reference_is_zero else TOLERATED_BIAS + allowance


def _errors(
    statistics: Statistics, level: float, limit: float, kernel: bool
) -> tuple[list[_Finding], list[_Finding], list[_Finding]]:
    """Errors that are proven, that rare events may explain, and that are printed alone, as a kernel's shape is."""
    elsewhere = [*_place_errors(statistics, level), *_shape_errors(statistics, level)]
    proven = [*_invalid_values(statistics), *_mean_errors(statistics, level, limit)]
    unproven = _mean_errors(statistics, level, limit, missing=True)
    if kernel:
        return proven, unproven, elsewhere
    return proven + elsewhere, unproven + _place_errors(statistics, level, missing=True), []


def _invalid_values(statistics: Statistics) -> list[_Finding]:
    if not statistics.invalid:
        return []
    first = statistics.invalid[0]
    counts = f"{statistics.non_finite} values not finite, {statistics.negative} negative"
    text = f"{counts}, the first: {first} in {first.name}"
    return [_Finding(text, f"x {first.x}, y {first.y}")]


def _outside(
    comparison: Comparison, level: np.ndarray | float, limit: float, missing: bool = False
) -> tuple[np.ndarray, Callable[[int], str]]:
    """Flat indices of the places that lie wholly outside ±limit, the largest first, and the words for one of them.

    The largest is that whose interval is farthest from 0, so that noise does not choose it.

    `missing` chooses those that rare events may explain, which no replicate met: no proof.
    """
    excess = ((np.abs(comparison.bias) - limit) / comparison.standard_error).ravel()
    level = np.broadcast_to(level, comparison.bias.shape).ravel()
    # Student's quantiles, which take their time, are above the normal law's.
    far = np.flatnonzero(excess > -scipy.special.ndtri(level.max() / 2))
    places, level = comparison.at(far), level[far]
    low, high = places.interval(level)
    by_size = np.argsort(-np.maximum(low, -high))
    order, places, level, low, high = far[by_size], places.at(by_size), level[by_size], low[by_size], high[by_size]
    explained = np.abs(places.bias) <= places.missing(level)

    def text(index: int) -> str:  # of a large image a million places may be outside, and two are named
        i = int(np.flatnonzero(order == index)[0])
        bias = places.bias[i]
        interval = f"{percent(bias)} [{percent(low[i])}, {percent(high[i])}]"
        if not missing:
            return interval
        return (
            f"{interval}, no proof: {abs(bias) / places.unseen[i]:.2g} rare events, as bright as others, may be missing"
        )

    return order[((low > limit) | (high < -limit)) & (explained == missing)], text


def _mean_errors(statistics: Statistics, level: float, limit: float, missing: bool = False) -> list[_Finding]:
    """Rule 2a."""
    findings = []
    outside, interval = _outside(statistics.regions, level, limit, missing)
    for index in outside.tolist():
        region, channel = divmod(index, len(CHANNELS))
        place = f"{statistics.region_names[region]}, {CHANNELS[channel]}"
        findings.append(_Finding(f"mean of {place}: {interval(index)}", place))
    return findings


def _shape_errors(statistics: Statistics, level: float, *, tolerated: bool = False) -> list[_Finding]:
    """Rule 2b: of each block size the quantity that is proven most surely. Or those proven to be tolerated."""
    findings = []
    for side, estimates in statistics.mean_square.items():
        limit = SHAPE_LIMITS[side]
        lows = np.array([each.low(level * share) for each, share in zip(estimates, SHARES, strict=True)])
        found = (lows > 0) & (lows <= limit**2) if tolerated else lows > limit**2
        if not found.any():
            continue
        of = int(np.argmax(np.where(found, lows, -np.inf)))
        rms, least = np.sqrt([estimates[of].value, lows[of]])
        place = f"spread, most of all {tile_words(_worst_tile(statistics))}"
        text = f"shape over {BLOCKS[side]}{_of(of)}: {rms:.2%} rms, at least {least:.2%} (limit {limit:.1%})"
        findings.append(_Finding(text, place))
    return findings


def _of(quantity: int) -> str:
    """Luminance goes without saying."""
    return "" if quantity == 0 else f", {QUANTITIES[quantity]}"


def _places(statistics: Statistics) -> list[tuple[str, Comparison, Callable[[int], str]]]:
    """What rule 2c tests: a family's name, its comparison (4, ...), and the words for its places by flat index."""

    def tiles(side: int, step: int, comparison: Comparison) -> Callable[[int], str]:
        def words(index: int) -> str:
            y, x = (step * i for i in divmod(index, comparison.bias.shape[2]))
            return tile_words((x, y, min(side, statistics.width - x), min(side, statistics.height - y)))

        return words

    at = {"row": ("y 0", f"y {statistics.height - 1}"), "column": ("x 0", f"x {statistics.width - 1}")}
    borders = [f"{name} ({at[name.split()[1]][i % 2]})" for i, name in enumerate(BORDERS)]
    large, small = statistics.tiles[PLACE_SIDE], statistics.windows
    return [
        ("outermost rows and columns", statistics.borders, lambda index: borders[index]),
        (f"{PLACE_SIDE}-px tiles", large, tiles(PLACE_SIDE, PLACE_SIDE, large)),
        (f"{WINDOW_SIDE}-px windows", small, tiles(WINDOW_SIDE, CELL, small)),
    ]


def _place_errors(
    statistics: Statistics, level: float, *, missing: bool = False, tolerated: bool = False
) -> list[_Finding]:
    """Rule 2c: of each family one finding, the largest and how many there are. Or those proven to be tolerated."""
    limit = 0.0 if statistics.reference_is_zero else PLACE_LIMIT
    findings = []
    for name, comparison, words in _places(statistics):
        each_level, count = _place_level(comparison, level), comparison.bias[0].size
        found, interval = _outside(comparison, each_level, 0.0 if tolerated else limit, missing)
        if tolerated:
            beyond, _ = _outside(comparison, each_level, limit)
            found = found[~np.isin(found, beyond)]
        if not found.size:
            continue
        of, at = divmod(int(found[0]), count)
        # Where luminance is off as well, that says more than the channel that is off most.
        if at in found:
            of = 0
        number = len(np.unique(found % count))
        place, words_of_it = f"{words(at)}{_of(of)}", interval(of * count + at)
        findings.append(_Finding(f"{place}: {words_of_it}, the largest of {number} of {count} {name}", place))
    return findings


def place_is_off(statistics: Statistics, *, tests: int, level: float) -> bool:
    """Whether a tile or a window is proven to be off by rule 2c: what holds of a part holds of the whole, too."""
    limit = 0.0 if statistics.reference_is_zero else PLACE_LIMIT
    places = statistics.tiles[PLACE_SIDE], statistics.windows
    return any(_outside(each, _place_level(each, level / tests), limit)[0].size for each in places)


def _place_level(comparison: Comparison, level: float) -> np.ndarray:
    """Of each place in each quantity (4, ...)."""
    shares = np.reshape(SHARES, (-1, *(1,) * (comparison.bias.ndim - 1)))
    return np.broadcast_to(level * shares / comparison.bias[0].size, comparison.bias.shape)


def _tolerated(statistics: Statistics, level: float, limit: float) -> tuple[str, ...]:
    """What is proven at the family's level but lies within what is no error."""
    beyond = {each.place for each in _mean_errors(statistics, level, limit)}
    means = [each for each in _mean_errors(statistics, level, 0.0) if each.place not in beyond]
    rest = [*_place_errors(statistics, level, tolerated=True), *_shape_errors(statistics, level, tolerated=True)]
    return tuple(each.text for each in (*means, *rest))


def _shape_bounds(estimates: Sequence[Estimate], outside: float) -> np.ndarray:
    """U of rule 3, (4,)."""
    return np.sqrt([max(0.0, each.high(outside)) for each in estimates])


def _open_questions(statistics: Statistics, margin: float, shape_margin: float, outside: float) -> tuple[str, ...]:
    """What keeps a row from being EQUIVALENT by rule 3."""
    low, high = (end[0] for end in statistics.regions.interval(2 * outside))
    questions = [
        f"image, {channel}: [{percent(low[c])}, {percent(high[c])}] ({confidence(outside)}), not inside ±{margin:.2%}"
        for c, channel in enumerate(CHANNELS)
        if not (-margin < low[c] and high[c] < margin)
    ]
    bounds = _shape_bounds(statistics.mean_square[8], outside)
    if statistics.rest is not None:
        least, most = statistics.rest.interval(2 * outside)
        if not (-margin < least and most < margin):
            interval = f"[{percent(least)}, {percent(most)}] ({confidence(outside)}), not inside ±{margin:.2%}"
            questions.append(f"the picture but for a few bright pixels, which are most of its mean: {interval}")
    if (bound := bounds.max()) >= shape_margin:
        text = f"shape error of up to {bound:.2%} rms over 8-px tiles{_of(int(bounds.argmax()))}"
        questions.append(f"{text} is not below {shape_margin:.0%}")
    return tuple(questions)


def _samples_ratio(statistics: Statistics, margin: float, shape_margin: float, outside: float) -> float | None:
    """Factor on the samples of both sides at which an unbiased row is EQUIVALENT with a power of 80 %.

    Standard errors of means fall as 1/sqrt(samples); that of a mean square around 0 falls as 1/samples.
    """
    low, high, error, dof = _means_of(statistics, outside)
    shapes = statistics.mean_square[8]
    beyond = any(theta.low(outside) > shape_margin**2 for theta in shapes)
    if np.any((low > margin) | (high < -margin)) or beyond:
        return None
    # An interval can leave the margin at either end, U only at one: hence half the misses for each end.
    mean = np.max((student.isf(outside, dof) + student.isf((1 - POWER) / 2, dof)) * error) / margin
    quantiles = student.isf(np.array([outside, 1 - POWER]), shapes[0].dof).sum()
    return float(max(mean**2, quantiles * max(theta.standard_error for theta in shapes) / shape_margin**2))


def _means_of(statistics: Statistics, outside: float) -> tuple[np.ndarray, ...]:
    """Low and high ends, standard errors and degrees of freedom of the means that rule 3 asks for."""
    image, rest = statistics.regions, statistics.rest
    ends = [*(end[0] for end in image.interval(2 * outside)), image.standard_error[0], image.dof[0]]
    if rest is not None:
        more = (*rest.interval(2 * outside), rest.standard_error, rest.dof)
        ends = [np.append(each, one) for each, one in zip(ends, more, strict=True)]
    return tuple(ends)


def _scaled(needed: float | None, samples: int | None, seconds: float | None) -> tuple[int | None, float | None]:
    """So many times the samples and the seconds that a row took."""
    if needed is None:
        return None, None
    return (
        None if samples is None else max(1, int(np.ceil(samples * needed))),
        None if seconds is None else seconds * needed,
    )


def _intervals(statistics: Statistics, level: float | None, limit: float, outside: float) -> dict[str, Any]:
    """The numbers of a `Verdict`, whatever the rule makes of them; those at the family's level if there is one."""
    luminance, shapes = statistics.luminance, statistics.mean_square[8]
    low, high = (float(end) for end in luminance.interval(2 * outside))
    family, detectable = (None, None), dict.fromkeys(("bias", "shape", "border", "window"))
    if level is not None:
        family = tuple(float(end) for end in luminance.interval(level))
        detectable = _detectable(statistics, level, limit)
    return {
        "bias": float(luminance.bias),
        "bias_low": low,
        "bias_high": high,
        "standard_error": float(luminance.standard_error),
        "family_low": family[0],
        "family_high": family[1],
        "regions": _regions(statistics, level, limit, outside),
        "rms_bias": float(np.sign(shapes[0].value) * np.sqrt(abs(shapes[0].value))),
        "rms_bias_high": float(_shape_bounds(shapes, outside).max()),
        **{f"detectable_{of}": least for of, least in detectable.items()},
    }


def _detectable(statistics: Statistics, level: float, limit: float) -> dict[str, float]:
    """The smallest errors that this run finds in 80 % of cases, see `Verdict`."""
    place = 0.0 if statistics.reference_is_zero else PLACE_LIMIT

    def luminance(places: Comparison) -> np.ndarray:
        count = places.bias[0].size
        return places.at(np.arange(count)).detectable(level * SHARES[0] / count, place)

    shapes = [
        each.detectable(level * share, SHAPE_LIMITS[8] ** 2) ** 0.5
        for each, share in zip(statistics.mean_square[8], SHARES, strict=True)
    ]
    return {
        "bias": float(statistics.regions.detectable(level, limit)[0].max()),
        "shape": float(max(shapes)),
        "border": float(luminance(statistics.borders).max()),
        "window": float(np.median(luminance(statistics.windows))),
    }


def _regions(statistics: Statistics, level: float | None, limit: float, outside: float) -> tuple[RegionBias, ...]:
    low, high = statistics.regions.interval(2 * outside)
    at_level = (
        None if level is None else (*statistics.regions.interval(level), statistics.regions.detectable(level, limit))
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
    """The 16-px tile that is off most, by what noise leaves of it."""
    tiles = statistics.tiles[PLACE_SIDE]
    return _tile(statistics, int(np.argmax(np.max(np.abs(tiles.bias) - _SURE * tiles.standard_error, axis=0))))


def _tile(statistics: Statistics, index: int) -> tuple[int, int, int, int]:
    """x, y, width and height of a 16-px tile; those at the right and lower border may be smaller."""
    y, x = (PLACE_SIDE * i for i in divmod(index, statistics.tiles[PLACE_SIDE].bias.shape[2]))
    return x, y, min(PLACE_SIDE, statistics.width - x), min(PLACE_SIDE, statistics.height - y)
