"""Replicate images of both sides, read by bands of rows: what they must be, what is invalid, which are the same.

Replicates `I_1 … I_K` of ours and `R_1 … R_R` of the reference have independent seeds, each with its own photon map.
Pixels of one image may be correlated, replicates are not: all that is said of them rests on this.
"""

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import attrs
import numpy as np

REPLICATES_WANTED, REPLICATES_NEEDED = 16, 4
TILE_SIDES = (8, 16, 32)
CHANNELS = ("red", "green", "blue")
LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Of linear Rec. 709 (ITU-R BT.709-6, section 3)."""
QUANTITIES = ("luminance", *CHANNELS)
"""What shapes and places are judged in."""

BAND_BYTES = 64 * 2**20
LISTED_PIXELS = 10
DISTINCT_PIXELS = 40
"""Where independent images differ in so many pixels, two are equal by chance with probability e^-40 or so."""


def stacked(side: str, images: np.ndarray | Sequence[np.ndarray], names: Sequence[str] = ()) -> np.ndarray:
    """Images as one (n, H, W, 3) array; a memory map stays one."""
    if not isinstance(images, np.ndarray):
        arrays = [np.asarray(image) for image in images]
        called = labels(side, len(arrays), names)
        for name, array in zip(called, arrays, strict=True):
            if array.shape != arrays[0].shape:
                raise ValueError(f"{name}: shape {array.shape} differs from {arrays[0].shape} of {called[0]}")
        images = np.stack(arrays) if arrays else np.empty((0, 0, 0, 3))
    if images.ndim != 4 or images.shape[3] != 3 or 0 in images.shape:
        raise ValueError(f"{side}: shape {images.shape}; allowed is (replicates, height, width, 3), none of them 0")
    if not np.issubdtype(images.dtype, np.floating):
        raise ValueError(f"{side}: dtype {images.dtype}; linear radiance in floating point is needed")
    return images


def check(
    ours: np.ndarray, reference: np.ndarray, objects: np.ndarray | None, scale: float | None, exact: bool
) -> None:
    """Refuse what cannot be compared with a ValueError."""
    if ours.shape[1:] != reference.shape[1:]:
        raise ValueError(f"ours: images of shape {ours.shape[1:]}, but the reference's are {reference.shape[1:]}")
    if len(ours) < REPLICATES_NEEDED:
        raise ValueError(
            f"ours: {_counted(len(ours))}; at least {REPLICATES_NEEDED} are needed, each with a seed of its own"
        )
    if exact and len(reference) != 1:
        raise ValueError(f"reference: {len(reference)} images; an exact reference is one image")
    if not exact and len(reference) < REPLICATES_NEEDED:
        hint = "; one image needs exact (--reference-exact)" if len(reference) == 1 else ""
        raise ValueError(f"reference: {_counted(len(reference))}; at least {REPLICATES_NEEDED} are needed{hint}")
    if objects is not None and (objects.shape != ours.shape[1:3] or not np.issubdtype(objects.dtype, np.integer)):
        raise ValueError(f"objects: {objects.dtype} {objects.shape}; allowed is an integer map {ours.shape[1:3]}")
    if scale is not None and not (np.isfinite(scale) and scale > 0):
        raise ValueError(f"scale is {scale}; it must be finite and positive")


def check_mask(mask: np.ndarray, ours: np.ndarray) -> None:
    """Refuse a mask that does not fit, or that leaves nothing, with a ValueError."""
    if mask.shape != ours.shape[1:3] or mask.dtype != bool:
        raise ValueError(f"mask: {mask.dtype} {mask.shape}; allowed is a bool map {ours.shape[1:3]}")
    if not mask.any():
        raise ValueError("mask: leaves out every pixel; allowed is one that keeps some")


def _counted(replicates: int) -> str:
    return f"{replicates} replicate{'' if replicates == 1 else 's'}"


def labels(side: str, count: int, names: Sequence[str]) -> list[str]:
    """What the replicates of a side are called in messages."""
    return [names[k] if k < len(names) else f"{side}[{k}]" for k in range(count)]


def bands(*groups: np.ndarray) -> Iterator[tuple[int, list[np.ndarray]]]:
    """First row and pixels (n, rows, W, 3) of each group, views, of bands of whole 32-px tiles."""
    height, width = groups[0].shape[1:3]
    tallest = TILE_SIDES[-1]
    row = sum(len(group) for group in groups) * width * 3 * 8
    rows = max(1, BAND_BYTES // (row * tallest)) * tallest
    for top in range(0, height, rows):
        yield top, [group[:, top : top + rows] for group in groups]


@contextlib.contextmanager
def mapping(threaded: bool) -> Iterator[Callable[..., Iterable[Any]]]:
    """`map`, or one that has a thread for each core; results come in order, so that no bit depends on which."""
    if not threaded:
        yield map
        return
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        yield pool.map


def luminance_of(rgb: np.ndarray) -> np.ndarray:
    """Of the last axis. Written out: a BLAS product may round equal replicates differently."""
    return LUMINANCE[0] * rgb[..., 0] + LUMINANCE[1] * rgb[..., 1] + LUMINANCE[2] * rgb[..., 2]


def quantities(channels: np.ndarray) -> np.ndarray:
    """(4, ...): luminance, then the channels, which are the first axis of (3, ...)."""
    values = np.empty((4, *channels.shape[1:]))
    values[1:] = channels
    set_luminance(values)
    return values


def set_luminance(values: np.ndarray) -> None:
    """Luminance, `luminance_of`, as the first of (4, ...), of the channels that are the others."""
    luminance, red, *others = (values[k, ...] for k in range(4))
    np.multiply(red, LUMINANCE[0], out=luminance)
    for weight, channel in zip(LUMINANCE[1:], others, strict=True):
        luminance += weight * channel


@attrs.frozen
class InvalidPixel:
    """A value that no radiance can have, and where it stands (index into the replicates, row y, column x).

    `name` is what messages call the replicate.
    """

    replicate: int
    name: str
    y: int
    x: int
    channel: str
    value: float

    def __str__(self) -> str:
        """As messages name it."""
        return f"{self.channel} is {self.value} at x {self.x}, y {self.y}"


class Invalid:
    """Values that no radiance can have, of the first `count` replicates, which are ours; a reference has none.

    Filters with negative lobes make negative pixels of right radiance: `allow_negative` lets them pass.

    Attributes
    ----------
    non_finite, negative : values that are NaN, infinite (or beyond float32), or negative.
    first : the first of each band.
    replicates : (n,) bool, those that hold what is not finite.
    """

    def __init__(self, labels: Sequence[str], count: int, allow_negative: bool = False) -> None:
        self.labels, self.count, self.allow_negative = labels, count, allow_negative
        self.non_finite = self.negative = 0
        self.first: list[InvalidPixel] = []
        self.replicates = np.zeros(len(labels), dtype=bool)

    def replaced(self, top: int, sides: list[np.ndarray], mask: np.ndarray | None = None) -> list[np.ndarray]:
        """The two sides of a band, 0 outside a mask (rows, W), with the reference's mean for what is not finite.

        ValueError for an invalid reference. Where all is valid the sides are those given, not copies.
        """
        least, most = -np.finfo(np.float32).max if self.allow_negative else 0.0, np.finfo(np.float32).max
        if mask is not None:
            sides = [np.where(mask[..., None], side, 0.0) for side in sides]
        if all(side.min() >= least and side.max() <= most for side in sides):  # false for NaN
            return sides
        ours, reference = (side.astype(np.float64) for side in sides)
        broken, wrong = self._wrong(ours)
        _, wrong_there = self._wrong(reference)
        if wrong_there.any():
            first = _pixels(reference, wrong_there, top, self.labels[self.count :])[0]
            allowed = (
                "finite" if self.allow_negative else "finite and ≥ 0 (a filter with negative lobes: --allow-negative)"
            )
            raise ValueError(f"{first.name}: {first}; a reference is {allowed}")
        self.first += _pixels(ours, wrong, top, self.labels)
        self.non_finite += int(np.count_nonzero(broken))
        self.replicates[: self.count] |= broken.any(axis=(1, 2, 3))
        self.negative += int(np.count_nonzero(wrong & ~broken))
        return [np.where(broken, reference.mean(axis=0), ours), reference]

    def _wrong(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which are not finite, and those with the negative ones where they are not allowed."""
        broken = ~(np.abs(values) <= np.finfo(np.float32).max)  # so written, it holds for NaN too
        return broken, broken if self.allow_negative else broken | (values < 0)


def _pixels(band: np.ndarray, wrong: np.ndarray, top: int, names: Sequence[str]) -> list[InvalidPixel]:
    """The first values marked."""
    at = np.unravel_index(np.flatnonzero(wrong)[:LISTED_PIXELS], wrong.shape)
    return [
        InvalidPixel(k, names[k], top + y, x, CHANNELS[channel], float(band[k, y, x, channel]))
        for k, y, x, channel in zip(*(each.tolist() for each in at), strict=True)
    ]


class Equality:
    """Finds replicates that are the same image, which independent seeds do not give.

    Images whose sums differ are different images; few are left to be compared pixel by pixel.

    Parameters
    ----------
    sides : replicates of ours and of the reference, (K, H, W, 3) and (R, H, W, 3).
    mask : (H, W) bool, pixels that are compared; None for all.
    sums : (K + R, 3) of each replicate, those of equal images added up alike.
    zero : (K + R,) bool, black everywhere.
    """

    def __init__(
        self, sides: Sequence[np.ndarray], mask: np.ndarray | None, sums: np.ndarray, zero: np.ndarray
    ) -> None:
        self._sides, self._mask, self._sums, self._zero = sides, mask, sums, zero
        self.first: list[int] = []
        """By replicate, the first one that is the same image."""
        for k in range(len(sums)):
            earlier = (j for j in dict.fromkeys(self.first) if self._same(j, k))
            self.first.append(next(earlier, k))

    def _same(self, j: int, k: int) -> bool:
        if self._zero[j] and self._zero[k]:
            return True
        return self._sums[j].tobytes() == self._sums[k].tobytes() and not any(self._differing(j, k))

    def _differing(self, j: int, k: int) -> Iterator[int]:
        """Pixels in which two replicates differ, by bands of rows, in bits: NaN equals itself here."""
        pair = [self._image(j), self._image(k)]
        single = all(image.dtype == np.float32 for image in pair)
        for top, band in bands(*(image[None] for image in pair)):
            one, other = (np.ascontiguousarray(each[0], np.float32 if single else np.float64) for each in band)
            bits = np.uint32 if single else np.uint64
            differ = (one.view(bits) != other.view(bits)).any(axis=-1)
            if self._mask is not None:
                differ &= self._mask[top : top + len(differ)]
            yield int(np.count_nonzero(differ))

    def _image(self, k: int) -> np.ndarray:
        ours, reference = self._sides
        return ours[k] if k < len(ours) else reference[k - len(ours)]

    def _vary(self) -> bool:
        """Whether some replicate differs from the next in many pixels."""
        count, everyone = len(self._sides[0]), len(self.first)
        pairs = (k for k in range(everyone - 1) if k != count - 1)
        return any(sum(self._differing(k, k + 1)) >= DISTINCT_PIXELS for k in pairs)

    def warnings(self, labels: Sequence[str], noiseless: bool) -> list[str]:
        """What is odd but allowed; ValueError for equal seeds.

        Without `noiseless`, a side that never varies has equal seeds, too.
        """
        count, first, zero = len(self._sides[0]), self.first, self._zero
        sides = {"ours": range(count), "the reference": range(count, len(first))}
        constant = {side: len({first[k] for k in members}) == 1 for side, members in sides.items()}
        same = [side for side, members in sides.items() if constant[side] and len(members) > 1 and not zero[members[0]]]
        if same and not noiseless:
            hints = {
                "ours": "a renderer without noise needs noiseless (--noiseless)",
                "the reference": "one without noise is one image and exact (--reference-exact)",
            }
            raise ValueError(f"all replicates of {same[0]} are the same image: equal seeds? {hints[same[0]]}")
        warnings = [f"all replicates of {side} are the same image: taken as free of noise" for side in same]
        for k, other in enumerate(first):
            if other == k:
                continue
            side, other_side = ("ours" if i < count else "the reference" for i in (k, other))
            if constant[side] and constant[other_side]:
                continue
            if zero[k]:  # of a sparse estimator, whatever the seed
                continue
            text = f"{labels[other]} and {labels[k]} are the same image"
            if self._vary():
                raise ValueError(f"{text}: equal seeds? Replicates must be independent")
            warnings.append(f"{text}; possible by chance, since few pixels vary")
        return warnings
