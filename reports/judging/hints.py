"""Hints after BIASED: simple causes, each undone on the replicates and judged by the same rule. Never a verdict.

A cause is a `Correction`: a change of each image of ours (or of the reference) and what it is called. Those that could
explain the error are found on the mean images; each is then undone on every replicate, the corrected replicates are
judged as the given ones were, and the cause is said only if no error of theirs is proven and at least half of the
distance `D`, `D² = Σ_c δ_c² + Σ_b θ_b` (the mean of each channel, the shape over blocks of each size), is gone: noise
that hides an error is no explanation of it.

The filter of a pixel is known by its width alone, so that what a blur leaves may still be proven. Where nothing else
explains the error and most of the distance is gone, a filter is named as what it is: nearer.

Of a large image a part is judged first, the one where most of the error is left: a cause that a tile or a window of it
refutes, at the level that each has in the whole, is not tried on the rest. Mean and shape of a part refute nothing: the
whole is allowed the same of its own, and an error of a part is less of it.

Light that scatters more often than an engine allows lacks differently from place to place. It cannot be put back into
ours; where references of less light can be rendered, ours is judged against one that ends it, too.
"""

import bisect
import functools
import itertools
import math
from collections.abc import Callable, Iterable, Iterator

import attrs
import numpy as np
import scipy

from termwise.reports.statistics import accumulation, rule
from termwise.reports.statistics.accumulation import Statistics
from termwise.reports.statistics.replicates import luminance_of
from termwise.scenes import srgb

REACH = 2.0
"""Largest shift in pixels that is tried, in steps of half of one."""
QUANTILE = 0.999
LISTED = 3
REPLICATES = 16
"""More replicates than these are averaged by groups, for speed."""
FACTORS = {
    "π": math.pi,
    "1/π": 1 / math.pi,
    "2π": 2 * math.pi,
    "1/(2π)": 0.5 / math.pi,
    "4π": 4 * math.pi,
    "1/(4π)": 0.25 / math.pi,
    "2": 2.0,
    "1/2": 0.5,
    "4": 4.0,
    "1/4": 0.25,
    "683": 683.0,
    "1/683": 1 / 683,
}
"""Factors that have a name: solid angles, halves, luminous efficacy in lm/W."""
_FACTOR_NEAR = 0.005
PART = 256
"""Side in pixels of the part that is judged first, in images of more than twice as many of them."""
_STEP = 64
"""Places of parts, whole tiles."""
_PROMISING = 0.25
"""Share of the mean square error of the mean images that a correction may leave to be tried on the replicates."""
_FREE = 0.9
"""Share of the value at which ours ends; a mean below it is taken to be of no clamped sample."""
_SURE = 4.0
"""Standard errors of a mean square error from which on it is one."""

DEPTHS = range(1, 33)
"""How often light may scatter at most where it is said to be too few times."""
_FEW = 4
"""Replicates by which a depth is looked for."""
_DARKER = 2.0
"""Standard errors by which ours has to be too dark."""

Image = np.ndarray
Change = Callable[[Image], Image]
AtDepth = Callable[[int, int], np.ndarray]
"""(depth, count) -> (count, H, W, 3): the first replicates of the reference if light scatters so often at most.

1 is direct light. An exact reference is one image.
"""


@attrs.frozen
class Hint:
    """A simple cause that would explain a proven error.

    Attributes
    ----------
    text : `agrees if ours is flipped upside down`, or `is nearer if the reference is blurred by …`.
    left : the distance D that remains, relative to the term's mean.
    verdict : of the corrected replicates: EQUIVALENT or UNDERPOWERED, or BIASED where it is but nearer.
    """

    text: str
    left: float
    verdict: str


def _same(image: Image) -> Image:
    return image


@attrs.frozen
class Correction:
    """What undoes a cause, image by image, and how it is said after `agrees if`.

    Attributes
    ----------
    text : str
    ours, reference : (H, W, C) -> (H, W, C) of the side.
    margin : pixels at each border that are no longer defined, or left out.
    moves : whether pixels move, so that a mask has to follow.
    always : tried on the replicates whatever the mean images say of it.
    rough : whether it is an approximation of its cause, which may leave an error.
    """

    text: str
    ours: Change = _same
    reference: Change = _same
    margin: int = 0
    moves: bool = False
    always: bool = False
    rough: bool = False

    def then(self, other: "Correction") -> "Correction":
        """Both, this one first; the reason of one stands behind both."""
        if not self.text:
            return other
        (what, *why), (also, *too) = self.text.split(": "), other.text.split(": ")
        return Correction(
            ": ".join([f"{what} and {also.removeprefix('ours is ')}", *(["; ".join(why + too)] if why or too else [])]),
            lambda image: other.ours(self.ours(image)),
            lambda image: other.reference(self.reference(image)),
            margin=max(self.margin, other.margin),
            moves=self.moves or other.moves,
            rough=self.rough or other.rough,
        )


_NONE = Correction("")
_BORDER = Correction("the outermost pixels (1 px) are left out: the border alone is off", margin=1)


@attrs.frozen(eq=False)
class _Halves:
    """Means of the first and of the second half of the replicates, of each side; an exact reference is both of its."""

    ours: tuple[Image, Image]
    reference: tuple[Image, Image]

    @classmethod
    def of(cls, ours: np.ndarray, reference: np.ndarray, mask: np.ndarray | None) -> "_Halves":
        def split(stack: np.ndarray) -> tuple[Image, Image]:
            middle = len(stack) // 2
            parts = (stack[:middle], stack[middle:]) if middle else (stack, stack)
            first, second = (np.asarray(np.mean(each, axis=0, dtype=np.float64)) for each in parts)
            if mask is None:
                return first, second
            return np.where(mask[..., None], first, 0.0), np.where(mask[..., None], second, 0.0)

        return cls(split(ours), split(reference))

    @property
    def means(self) -> tuple[Image, Image]:
        """Of each side."""
        return (self.ours[0] + self.ours[1]) / 2, (self.reference[0] + self.reference[1]) / 2

    @property
    def grey(self) -> "_Halves":
        """Of luminance alone, a channel of it."""

        def luminance(pair: tuple[Image, Image]) -> tuple[Image, Image]:
            return luminance_of(pair[0])[..., None], luminance_of(pair[1])[..., None]

        return _Halves(luminance(self.ours), luminance(self.reference))

    @property
    def level(self) -> "_Halves":
        """Ours with the mean of the reference."""
        ours, reference = (float(np.mean(each)) for each in self.means)
        if not (np.isfinite(ours) and np.isfinite(reference) and ours > 0 and reference > 0):
            return self
        first, second = (each * (reference / ours) for each in self.ours)
        return _Halves((first, second), self.reference)

    def thinned(self, correction: Correction) -> "_Halves":
        """Corrected, its undefined border left out, and of a large image every n-th row and column."""
        step = max(1, min(self.ours[0].shape[:2]) // PART)

        def changed(pair: tuple[Image, Image], change: Change) -> tuple[Image, Image]:
            first, second = (_inner(change(image), correction.margin)[::step, ::step] for image in pair)
            return first, second

        return _Halves(changed(self.ours, correction.ours), changed(self.reference, correction.reference))

    def squares(self, correction: Correction) -> Image:
        """Square error that a correction leaves, without noise: a product of two halves has none in its mean."""
        first, second = (
            _inner(correction.ours(ours) - correction.reference(reference), correction.margin)
            for ours, reference in zip(self.ours, self.reference, strict=True)
        )
        return first * second

    def left(self, correction: Correction) -> float:
        """Mean of it."""
        return float(np.mean(self.squares(correction)))

    @property
    def pixels(self) -> int:
        """Of an image."""
        return self.ours[0][..., 0].size

    def noise(self, margin: int) -> float:
        """Standard error of what `left` finds where nothing differs."""
        first, second = (_inner(a - b, margin) for a, b in zip(self.ours, self.reference, strict=True))
        return float(np.sqrt(np.mean(first**2) * np.mean(second**2) / first[..., 0].size))


def hints(
    ours: np.ndarray,
    reference: np.ndarray,
    statistics: Statistics,
    *,
    mask: np.ndarray | None = None,
    margin: float,
    level: float,
    at_depth: AtDepth | None = None,
) -> tuple[Hint, ...]:
    """Simple causes that would explain why replicates are BIASED, the best first, at most three.

    Parameters
    ----------
    ours, reference : (K, H, W, 3) and (R, H, W, 3) floating, as they were judged.
    statistics : of the two.
    mask : (H, W) bool, optional
    margin, level : as they were judged with.
    at_depth : the reference with less light, see `AtDepth`; None: none can be had.
    """
    if statistics.invalid or statistics.reference_is_zero or not np.any(ours):
        return ()
    trial = _Trial(ours, reference, mask, statistics.exact, _distance(statistics), margin, level)
    border = trial.tried(_BORDER)
    singles = list(_singles(ours, trial.halves, statistics))
    if border:  # what leaves out more than the border is explained by that alone
        singles = [each for each in singles if not each.margin]
    found = trial.all_of(singles) + ([border] if border else [])
    if at_depth is not None and (cut := _cut(trial, at_depth, statistics, alone=bool(found), rough=False)):
        found.append(cut)
    if not found:
        found = list(itertools.islice(filter(None, map(trial.tried, _several(singles, trial.halves, ours))), 1))
    if not found:
        found = trial.nearer_ones(singles)
        if at_depth is not None and (cut := _cut(trial, at_depth, statistics, rough=True)):
            found.append(cut)
    return tuple(sorted(found, key=lambda hint: hint.left)[:LISTED])


@attrs.frozen(eq=False)
class _Trial:
    """What corrections are tried on.

    Attributes
    ----------
    ours, reference, mask, exact, margin, level : as `hints`.
    far : the distance of which half has to be gone.
    """

    ours: np.ndarray
    reference: np.ndarray
    mask: np.ndarray | None
    exact: bool
    far: float
    margin: float
    level: float

    @functools.cached_property
    def halves(self) -> _Halves:
        """Of the replicates."""
        return _Halves.of(self.ours, self.reference, self.mask)

    def measured(self, correction: Correction, *part: tuple[slice, slice]) -> Statistics | None:
        """See `_measured`."""
        groups = [_grouped(each) for each in (self.ours, self.reference)]
        return _measured(correction, self.ours, self.reference, groups, self.mask, self.exact, *part)

    def all_of(self, corrections: list[Correction]) -> list[Hint]:
        """Those that hold."""
        return [hint for each in _promising(corrections, self.halves) if (hint := self.tried(each))]

    def nearer_ones(self, corrections: list[Correction]) -> list[Hint]:
        """The rough ones that leave an error, but not half of the distance."""
        rough = _promising([each for each in corrections if each.rough], self.halves)
        return [hint for each in rough if (hint := self._nearer(each))]

    def _nearer(self, correction: Correction) -> Hint | None:
        found = self.measured(correction)
        if found is None or (left := _distance(found)) > self.far / 2:
            return None
        return Hint(f"is nearer if {correction.text}; not all of the error is gone", left, "BIASED")

    def tried(self, correction: Correction) -> Hint | None:
        """A correction as a hint, if it holds."""
        if (part := _worst_part(correction, self.halves)) is not None:
            found = self.measured(correction, part)
            # Each of its places has the level that it has in the whole.
            tests = 0 if found is None else math.ceil(found.tests * self.halves.pixels / (found.height * found.width))
            if found and rule.place_is_off(found, tests=max(tests, 1), level=self.level):
                return None
        found = self.measured(correction)
        if found is None:
            return None
        verdict = rule.decide(found, tests=found.tests, margin=self.margin, level=self.level).verdict
        left = _distance(found)
        if verdict == "BIASED" or left > self.far / 2:
            return None
        return Hint(f"agrees if {correction.text}", left, str(verdict))


def _cut(trial: _Trial, at_depth: AtDepth, statistics: Statistics, *, alone: bool = False, rough: bool) -> Hint | None:
    """Whether ours is what is left where light scatters a few times; or, but for `alone`, that moved or filtered.

    `rough`: what is nearer alone.

    More depth is more light: the depth whose mean is that of ours is looked for by bisection, with few replicates of
    the reference. It and its neighbour are tried with these, and only what they do not refute with all.
    """
    darker = statistics.luminance
    if float(darker.bias + _DARKER * darker.standard_error) >= 0.0:
        return None
    every = len(trial.reference)
    few = min(_FEW, every)
    where = True if trial.mask is None else trial.mask

    @functools.cache
    def light(depth: int | None) -> float:
        stack = trial.ours if depth is None else at_depth(depth, few)
        return float(np.mean(luminance_of(np.mean(stack, axis=0, dtype=np.float64)), where=where))

    above = bisect.bisect_left(DEPTHS, light(None), key=light)
    near = sorted(DEPTHS[max(above - 1, 0) : above + 1], key=lambda depth: abs(light(depth) - light(None)))

    def held(depth: int, others: Callable[[_Trial], list[Correction]]) -> Hint | None:
        cut, best = Correction(_ending(depth), always=True), None
        for count in sorted({few, every}):
            # Whether enough of the distance is gone, all replicates say.
            far = trial.far if count == every else math.inf
            less = attrs.evolve(trial, reference=at_depth(depth, count), far=far)
            both = [each.then(cut) for each in others(less)]
            found = less.nearer_ones(both) if rough else less.all_of(both)
            if (best := min(found, key=lambda hint: hint.left, default=None)) is None:
                return None
        return best

    def moved(less: _Trial) -> list[Correction]:
        return [each for each in _singles(less.ours, less.halves, statistics) if each.moves]

    for others in (lambda less: [_NONE], moved)[: 1 if alone else 2]:
        for depth in near:
            if (hint := held(depth, others)) is not None:
                return hint
    return None


def _ending(depth: int) -> str:
    """Of light that scatters so often at most, how the reference is made to agree."""
    if depth == 1:
        return "the reference has direct light alone: raise the limit of bounces of ours"
    return f"light scatters {depth} times at most in the reference too (once is direct light): raise the limit of ours"


def _distance(statistics: Statistics) -> float:
    shape = sum(max(0.0, *(theta.value for theta in each)) for each in statistics.mean_square.values())
    return float(np.sqrt(np.sum(statistics.regions.bias[0] ** 2) + shape))


def _grouped(stack: np.ndarray) -> list[slice]:
    """Replicates that are averaged, of equal number."""
    size = max(1, len(stack) // REPLICATES)
    return [slice(start, start + size) for start in range(0, len(stack) - size + 1, size)]


def _inner(image: Image, margin: int) -> Image:
    return image[margin : image.shape[0] - margin, margin : image.shape[1] - margin]


def _worst_part(correction: Correction, halves: _Halves) -> tuple[slice, slice] | None:
    """Where the most is left, within the margin of the correction; None of a small image, which is judged whole."""
    if halves.pixels <= 2 * PART**2:
        return None
    squares = halves.squares(correction).sum(axis=2)
    height, width = (size // _STEP for size in squares.shape)
    cells = squares[: height * _STEP, : width * _STEP].reshape(height, _STEP, width, _STEP).sum(axis=(1, 3))
    rows, columns = (min(size, PART // _STEP) for size in (height, width))
    windows = np.lib.stride_tricks.sliding_window_view(cells, (rows, columns)).sum(axis=(2, 3))
    y, x = (int(at) * _STEP for at in np.unravel_index(np.argmax(windows), windows.shape))
    return slice(y, y + rows * _STEP), slice(x, x + columns * _STEP)


def _measured(
    correction: Correction,
    ours: np.ndarray,
    reference: np.ndarray,
    groups: list[list[slice]],
    mask: np.ndarray | None,
    exact: bool,
    part: tuple[slice, slice] = (slice(None), slice(None)),
) -> Statistics | None:
    """The corrected replicates, or a part of them, as they are judged; None where nothing of them is left."""
    if min(ours.shape[1:3]) <= 2 * correction.margin:
        return None
    inside = mask
    if mask is not None and correction.moves:
        both = [
            change(mask[..., None].astype(np.float64))[..., 0] for change in (correction.ours, correction.reference)
        ]
        inside = np.logical_and(*(each > 0.999 for each in both))
    if inside is not None:
        inside = _inner(inside, correction.margin)[part]
        if not inside.any():
            return None
    sides = []
    for stack, change, its in ((ours, correction.ours, groups[0]), (reference, correction.reference, groups[1])):
        if change is _same and len(its) == len(stack):
            images = np.moveaxis(np.asarray(stack), 0, -1)
            sides.append(np.moveaxis(_inner(images, correction.margin)[part], -1, 0))
            continue
        made = np.empty(0)
        for number, each in enumerate(its):
            image = np.mean([change(image) for image in stack[each]], axis=0)
            kept = _inner(image, correction.margin)[part]
            if not number:  # one by one: a list of large images would be a second stack
                made = np.empty((len(its), *kept.shape), kept.dtype)
            made[number] = kept
        sides.append(made)
    try:
        return accumulation.measure(*sides, mask=inside, exact=exact, allow_negative=True)
    except ValueError:  # a correction may make what no comparison takes: all black, say
        return None


def _promising(corrections: list[Correction], halves: _Halves, best: int | None = None) -> Iterator[Correction]:
    """Those that leave little of the mean square error between the mean images, the best of them first."""
    left = [halves.left(each) for each in corrections]
    base = {each: _seen(halves, each) for each in {each.margin for each in corrections}}
    order = sorted(range(len(corrections)), key=left.__getitem__)
    good = [each for i in order if (each := corrections[i]).always or left[i] < _PROMISING * base[each.margin]]
    yield from good[:best]


def _several(singles: list[Correction], halves: _Halves, stack: np.ndarray) -> Iterator[Correction]:
    """The best of two causes at once, of three, of four, by each curve: where pixels lie, their channels, their values.

    Two curves that differ little are told apart by replicates, whose noise they bend, not by mean images.
    The values of a large image are compared on a part of its pixels, after they were moved: a shift of one pixel
    would be none between every fourth.
    """
    lie = [()] + [(each,) for each in singles if each.moves and each.margin <= REACH + 1]
    orders = [()] + [(each,) for each in singles if "order" in each.text]
    curves = {each.text for each in _curves()}
    enough = _PROMISING * _seen(halves.thinned(_NONE), 0)
    best: dict[tuple[int, str], tuple[float, Correction]] = {}
    most = _upper_end(stack)
    for moved in lie:
        thin = halves.thinned(_all(moved))  # whose order of channels costs little
        for order in orders:
            placed = thin.thinned(_all(order))
            for changes in _values(placed, most):
                parts = (*moved, *order, *changes)
                left = placed.left(_all(changes))
                kind = len(parts), next((each.text for each in changes if each.text in curves), "")
                if len(parts) > 1 and left < best.get(kind, (enough,))[0]:
                    best[kind] = left, _all(parts)
    for kind in sorted(best, key=lambda kind: (kind[0], best[kind][0])):
        yield best[kind][1]


def _all(parts: Iterable[Correction]) -> Correction:
    return functools.reduce(Correction.then, parts, _NONE)


def _values(halves: _Halves, most: float | None) -> Iterator[tuple[Correction, ...]]:
    """Changes of values alone: none or a curve, then none, a factor, an upper end, or both.

    `most` : where ours was clamped.
    """
    for curves in ((), *((curve,) for curve in _curves())):
        yield curves
        means = halves.thinned(_all(curves)).means
        yield from ((*curves, factor) for factor in _factors(*means, None))
        if most is not None:
            end = _all(curves).ours(np.array([most]))
            yield *curves, _ended(float(end[0]))
            for factor in _factors(*_below(float(end[0]), *means), None):
                yield *curves, factor, _ended(float(factor.ours(end)[0]))


def _seen(halves: _Halves, margin: int) -> float:
    """The mean square error between the mean images; 0 where noise alone explains it, which nothing improves."""
    found = halves.left(Correction("", margin=margin))
    return found if found > _SURE * halves.noise(margin) else 0.0


def _singles(stack: np.ndarray, halves: _Halves, statistics: Statistics) -> Iterator[Correction]:
    """All simple causes, with what has to be fitted fitted to the mean images."""
    ours, reference = halves.means
    yield Correction("ours is flipped upside down", lambda image: image[::-1], moves=True)
    yield Correction("ours is flipped left to right", lambda image: image[:, ::-1], moves=True)
    yield Correction("ours is turned by 180°", lambda image: image[::-1, ::-1], moves=True)
    if ours.shape[0] == ours.shape[1]:
        yield Correction("ours is transposed (x and y exchanged)", lambda image: image.swapaxes(0, 1), moves=True)
    for order in itertools.permutations(range(3)):
        if order != (0, 1, 2):
            name = "".join("RGB"[c] for c in order)
            text = f"the channels of ours are taken in the order {name}"
            yield Correction(text, lambda image, order=order: image[..., list(order)])
    if min(ours.shape[:2]) > 4 * REACH:
        if (shift := _shift(halves)) is not None:
            yield shift
    yield from _factors(ours, reference, statistics)
    yield from _curves()
    yield from _clamps(stack, ours, reference)
    if min(ours.shape[:2]) > 16:
        yield from _blurs(ours, reference)


def _shift(halves: _Halves) -> Correction | None:
    """The best shift: of whole pixels first, then by a half around it; None where none is better than none."""
    # Of equal mean: in an image that is too bright half of a pixel would blur some of it away.
    grey = halves.grey.level

    def best(steps: Iterable[tuple[float, float]]) -> tuple[float, float]:
        return min(steps, key=lambda step: grey.left(_shifted(*step)))

    whole = np.arange(-REACH, REACH + 1)
    y, x = best(itertools.product(whole, whole))
    near = [(y + dy, x + dx) for dy, dx in itertools.product((0.0, -0.5, 0.5), repeat=2)]
    y, x = best(step for step in near if max(map(abs, step)) <= REACH)
    return _shifted(y, x) if y or x else None


def _shifted(dy: float, dx: float) -> Correction:
    """Half a pixel is a quarter on either side, so that both are interpolated alike."""
    whole, rest = np.floor([dy, dx]).astype(int), np.array([dy, dx]) % 1 / 2
    words = ", ".join(
        f"{abs(step):g} px {away if step > 0 else back}"
        for step, away, back in ((dx, "to the right", "to the left"), (dy, "down", "up"))
        if step
    )
    return Correction(
        f"ours is shifted by {words}",
        lambda image: _moved(image, whole, rest),
        _same if not rest.any() else lambda image: _moved(image, np.zeros(2, int), -rest),
        margin=int(REACH) + 1,
        moves=True,
    )


def _moved(image: Image, whole: np.ndarray, part: np.ndarray) -> Image:
    """Moved down and right by whole pixels and a part of one, interpolated linearly; the border wraps."""
    for axis in (0, 1):
        image = np.roll(image, whole[axis], axis)
        if part[axis]:
            neighbour = np.roll(image, int(np.sign(part[axis])), axis)
            share = float(abs(part[axis]))  # Python's: float32 stays float32
            image = (1 - share) * image + share * neighbour
    return image


def _factors(ours: Image, reference: Image, statistics: Statistics | None) -> Iterator[Correction]:
    """One factor on all: that of the means, by its name where it has one."""
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = float(luminance_of(ours).mean() / luminance_of(reference).mean())
    if not (np.isfinite(gain) and gain > 0):
        return
    near = _FACTOR_NEAR if statistics is None else max(3 * float(statistics.luminance.standard_error), _FACTOR_NEAR)
    for name, factor in FACTORS.items():
        if abs(gain / factor - 1) <= near:
            text = (
                f"ours is divided by {name}" if "/" not in name else f"ours is multiplied by {name.removeprefix('1/')}"
            )
            yield Correction(text.replace("(", "").replace(")", ""), lambda image, by=factor: image / by, always=True)
            return
    yield Correction(f"ours is multiplied by one factor, {1 / gain:.4g}", lambda image: image / gain, always=True)


def _curves() -> Iterator[Correction]:
    """Encodings for a screen, undone, or undone where there were none."""

    def power(exponent: float) -> Change:
        return lambda image: np.maximum(image, 0.0) ** exponent

    def decoded(image: Image) -> Image:
        return srgb.decoded(np.maximum(image, 0.0))

    def encoded(image: Image) -> Image:
        return srgb.encoded(np.maximum(image, 0.0))

    yield Correction("ours is raised to the power 2.2: it is gamma-encoded (1/2.2)", power(2.2))
    yield Correction("ours is raised to the power 1/2.2: a gamma of 2.2 was undone once too often", power(1 / 2.2))
    yield Correction("ours is decoded by sRGB's curve: it is sRGB-encoded", decoded)
    yield Correction("ours is encoded by sRGB's curve: the curve was undone once too often", encoded)


def _clamps(stack: np.ndarray, ours: Image, reference: Image) -> Iterator[Correction]:
    """Brightest pixels: clamped on both sides, or on the reference's where ours is clamped already."""
    limit = float(np.quantile(np.concatenate([ours.ravel(), reference.ravel()]), QUANTILE))
    if limit > 0:
        text = f"both are clamped at their 99.9 % quantile ({limit:.3g}): the brightest pixels alone are off"

        def clamp(image: Image, limit: float = limit) -> Image:
            return np.minimum(image, limit)

        yield Correction(text, clamp, clamp, always=True)
    if (most := _upper_end(stack)) is not None:
        yield _ended(most)


def _upper_end(stack: np.ndarray) -> float | None:
    """The greatest value, if so many pixels have it that they were clamped."""
    most = float(np.max(stack))
    return most if np.count_nonzero(stack == most) > max(3, len(stack)) else None


def _below(most: float, ours: Image, reference: Image) -> tuple[Image, Image]:
    """Both where no channel of ours is near its end, else black: no factor is found where that is everywhere."""
    free = (ours < _FREE * most).all(axis=2, keepdims=True)
    return np.where(free, ours, 0.0), np.where(free, reference, 0.0)


def _ended(most: float) -> Correction:
    return Correction(
        f"the reference is clamped at {most:.4g}, above which ours has no value",
        reference=lambda image: np.minimum(image, most),
    )


def _blurs(ours: Image, reference: Image) -> Iterator[Correction]:
    """A Gaussian on the sharper side, of the width that fits best."""
    y, r = luminance_of(ours), luminance_of(reference)

    def blurred(image: Image, sigma: float) -> Image:
        width = (sigma, sigma) + (0,) * (image.ndim - 2)
        return scipy.ndimage.gaussian_filter(image, width, truncate=4.0, mode="nearest")

    for sharper, other, ours_is in ((y, r, True), (r, y, False)):

        def left(sigma: float, sharper: Image = sharper, other: Image = other) -> float:
            return float(np.mean(_inner(blurred(sharper, sigma) - other, 4) ** 2))

        sigma = float(
            scipy.optimize.minimize_scalar(left, bounds=(0.05, 2.0), method="bounded", options={"xatol": 0.01}).x
        )
        side, has = ("ours", "a narrower") if ours_is else ("the reference", "a wider")
        text = f"{side} is blurred by {sigma:.2f} px: ours has {has} pixel filter"

        def change(image: Image, sigma: float = sigma) -> Image:
            return blurred(image, sigma)

        if ours_is:
            yield Correction(text, change, margin=4, moves=True, rough=True)
        else:
            yield Correction(text, reference=change, margin=4, moves=True, rough=True)
