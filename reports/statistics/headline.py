"""A verdict in plain words, one line: what a person says first, before any statistics."""

import attrs
import numpy as np

from termwise.reports.statistics.accumulation import Statistics
from termwise.reports.statistics.replicates import CHANNELS
from termwise.reports.statistics.sentence import tile_words
from termwise.reports.statistics.verdict import OUTSIDE, PLACE_SIDE, TOLERATED_BIAS, Verdict
from termwise.reports.statistics.welch import Comparison

EVERYWHERE = 0.5
"""Share of the lit tiles that must be seen to be off, the same way, for an error to be called everywhere."""
COARSE = 0.1
"""Share of the margin above which rounding alone leaves a row open."""
HOPELESS = 1e5
"""Times the samples that nobody takes."""
_WIDESPREAD = 0.2
"""Share of the tiles, of which noise shows a twentieth, above which an error is of the picture, not of a place."""
_SEEN = 2.0
"""Standard errors beyond which a tile is seen to be off: it names a place and proves nothing."""
_UNEVEN = 0.1
"""Share of the mean's error by which that of a tile must differ for the error to be called uneven there."""
_CANCELLED = 1 / 3
"""Share of the differences of the tiles that are seen to be off below which their sum is no measure of them."""
_BUT_FOR = "but for a few bright pixels, which are most of the mean: "


def headline(verdict: Verdict, statistics: Statistics) -> str:
    """`2 % too bright, everywhere`; `too noisy to say: needs 48 replicates a side`.

    Parameters
    ----------
    verdict : of the rule.
    statistics : of the same comparison.
    """
    match verdict.verdict:
        case "ABSENT":
            return f"black on both sides: {verdict.reasons[0] if verdict.reasons else 'nothing to compare'}"
        case "EQUIVALENT" | "AS PREDICTED":
            half = max(verdict.bias_high - verdict.bias, verdict.bias - verdict.bias_low)
            within = verdict.margin + verdict.allowance
            return f"agrees: off by {_signed(verdict.bias)} ± {_share(half)}, and ±{_share(within)} is allowed"
        case "UNDERPOWERED":
            return _open(verdict, statistics)
        case _:
            return _proven(verdict, statistics)


def _open(verdict: Verdict, statistics: Statistics) -> str:
    if verdict.samples_ratio is None:
        low, high, what = verdict.bias_low, verdict.bias_high, ""
        if (rest := _apart(verdict, statistics)) is not None:
            (low, high), what = rest, _BUT_FOR
        between = f"{what}between {_signed(low)} and {_signed(high)}"
        return f"not decided: {between}, likely off by more than ±{_share(verdict.margin + verdict.allowance)}"
    if statistics.quantum > COARSE * (verdict.margin + verdict.allowance):
        return "not decided: lossy compression hides what is looked for, and no samples help: write ZIP"
    if verdict.samples_to_margin is not None:
        return f"too noisy to say: needs {verdict.samples_to_margin} samples a pixel"
    if verdict.samples_ratio <= 1:
        return f"not decided: {verdict.reasons[0]}" if verdict.reasons else "not decided"
    replicates = int(np.ceil(verdict.samples_ratio * statistics.replicates))
    if verdict.samples_ratio > HOPELESS:
        return f"too noisy to say, by {HOPELESS:.0e} times the samples too: do a few pixels hold all the light?"
    times = f"{float(f'{verdict.samples_ratio:.2g}'):g}"
    return f"too noisy to say: needs {times} times the samples, or {replicates} replicates a side"


def _proven(verdict: Verdict, statistics: Statistics) -> str:
    if statistics.invalid:
        counts = [(statistics.non_finite, "NaN or infinite"), (statistics.negative, "negative")]
        said = " and ".join(f"{n} value{'s' if n > 1 else ''} {what}" for n, what in counts if n)
        return f"{said}, the first at {verdict.place} of {statistics.invalid[0].name}"
    limit = 0.0 if statistics.reference_is_zero else TOLERATED_BIAS + verdict.allowance
    if (rest := _apart(verdict, statistics)) is not None:
        return f"{_BUT_FOR}{_off(sum(rest) / 2)}"
    proven = [each for each in verdict.regions if _outside(each.family_low, each.family_high, limit)]
    sure = [each for each in proven if each.region == "image"]
    place = tile_words(verdict.tile)
    rms = np.sqrt(max(0.0, *(theta.value for each in statistics.mean_square.values() for theta in each)))
    # Of a kernel the means alone are judged.
    if _cancels(statistics) and any(not reason.startswith("mean of ") for reason in verdict.reasons):
        mean = ", ".join(f"{each.channel} {_off(each.bias)}" for each in sure) or "right"
        return f"misplaced by {_share(rms)} rms, most of all at {place}; on average {mean}"
    if sure:
        signs = {np.sign(each.bias) for each in sure}
        if len(signs) > 1:
            return "wrong colours: " + ", ".join(f"{each.channel} {_off(each.bias)}" for each in sure)
        if len(sure) < len(CHANNELS) and not _outside(verdict.family_low, verdict.family_high, limit):
            return ", ".join(f"{each.channel} {_off(each.bias)}" for each in sure)
        largest = max(sure, key=lambda each: abs(each.bias))
        bias = verdict.bias if len(sure) == len(CHANNELS) else largest.bias
        who = "" if len(sure) == len(CHANNELS) else f"{largest.channel} "
        return f"{who}{_off(bias)}, {_where(verdict, statistics)}"
    if proven:
        worst = max(proven, key=lambda each: abs(each.bias))
        return f"{worst.region} {_off(worst.bias)}, the image's mean is not seen to be off"
    tile = _tiles(statistics)
    x, y, _, _ = verdict.tile
    bias = float(tile.bias[y // PLACE_SIDE, x // PLACE_SIDE])
    if (np.abs(tile.bias) > _SEEN * tile.standard_error).mean() < _WIDESPREAD and abs(bias) > _small(statistics):
        return f"{_off(bias)} at {place}, right on average"
    return f"right on average, but misplaced by {_share(rms)} rms, most of all at {place}"


def _where(verdict: Verdict, statistics: Statistics) -> str:
    """Everywhere, or where most of all: whether one factor explains the tiles."""
    tiles, sign = _tiles(statistics), np.sign(verdict.bias)
    lit = tiles.reference > 0.01 * statistics.term_mean
    if not lit.any():
        return "where the reference is black"
    off = (sign * tiles.bias > _SEEN * tiles.standard_error)[lit].mean()
    # Relative to the tile: what one factor, as well as it is known, leaves.
    rest = np.abs(tiles.ours - (1 + verdict.bias) * tiles.reference) / tiles.scale
    error = np.hypot(tiles.standard_error, verdict.standard_error * tiles.reference / tiles.scale)
    uneven = ((rest > 2 * _SEEN * error) & (rest > _UNEVEN * abs(verdict.bias)))[lit].mean()
    if off >= EVERYWHERE and uneven < 0.1:
        return "everywhere"
    return f"most of all at {tile_words(verdict.tile)}" if uneven >= 0.1 or off < 0.1 else "on average"


def _tiles(statistics: Statistics) -> Comparison:
    """Of luminance."""
    tiles = statistics.tiles[PLACE_SIDE]
    return Comparison(*(getattr(tiles, field.name)[0] for field in attrs.fields(Comparison)))


def _small(statistics: Statistics) -> float:
    """Relative bias of a tile that noise alone may show."""
    return 3 * float(np.median(_tiles(statistics).standard_error))


def _apart(verdict: Verdict, statistics: Statistics) -> tuple[float, float] | None:
    """90 % interval of what few bright pixels hide, where it is off by far more than the image's mean."""
    if statistics.rest is None:
        return None
    low, high = (float(end) for end in statistics.rest.interval(2 * OUTSIDE / verdict.looks))
    return (low, high) if min(abs(low), abs(high)) > 3 * abs(verdict.bias) and low * high > 0 else None


def _cancels(statistics: Statistics) -> bool:
    """Whether what is too bright makes up for what is too dark, so that the mean says little of the error.

    In luminance, or in the channel that is off by more.
    """
    tiles = statistics.tiles[PLACE_SIDE]
    # Twice as far as noise: of many tiles some are seen by chance, either way.
    far = np.abs(tiles.bias) > 2 * _SEEN * tiles.standard_error
    seen = np.where(far, tiles.ours - tiles.reference, 0.0).reshape(4, -1)
    most = np.argmax(np.abs(seen).sum(axis=1))
    return bool(np.abs(seen[most].sum()) < _CANCELLED * np.abs(seen[most]).sum())


def _outside(low: float | None, high: float | None, limit: float) -> bool:
    return low is not None and high is not None and (low > limit or high < -limit)


def _off(bias: float) -> str:
    if bias >= 1 or -0.9999 < bias < -0.9:
        return f"{1 + bias:.3g} times as bright as the reference"
    return f"{_share(abs(bias))} too {'bright' if bias > 0 else 'dark'}" if bias > -0.9999 else "black"


def _share(value: float) -> str:
    """Two digits that mean something: `0.042 %`, `2 %`, `31 %`, `140 %`."""
    return f"{float(f'{100 * value:.2g}'):g} %"


def _signed(value: float) -> str:
    return ("+" if value > 0 else "-" if value < 0 else "") + _share(abs(value))
