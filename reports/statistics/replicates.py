"""Replicate images of both sides, read by bands of rows: what they must be, what is invalid, which are the same.

Replicates `I_1 … I_K` of ours and `R_1 … R_R` of the reference have independent seeds, each with its own photon map.
Pixels of one image may be correlated, replicates are not: all that is said of them rests on this.
"""

import hashlib
from collections.abc import Iterator, Sequence

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


def bands(*groups: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """First row and float64 pixels (replicates of all groups, rows, W, 3), a copy, of bands of whole 32-px tiles."""
    height, width = groups[0].shape[1:3]
    tallest = TILE_SIDES[-1]
    row = sum(len(group) for group in groups) * width * 3 * 8
    rows = max(1, BAND_BYTES // (row * tallest)) * tallest
    for top in range(0, height, rows):
        band = np.empty((sum(map(len, groups)), min(rows, height - top), width, 3))
        start = 0
        for group in groups:
            band[start : start + len(group)] = group[:, top : top + rows]
            start += len(group)
        yield top, band


def luminance_of(rgb: np.ndarray) -> np.ndarray:
    """Of the last axis. Written out: a BLAS product may round equal replicates differently."""
    return LUMINANCE[0] * rgb[..., 0] + LUMINANCE[1] * rgb[..., 1] + LUMINANCE[2] * rgb[..., 2]


def quantities(channels: np.ndarray) -> np.ndarray:
    """(4, ...): luminance, then the channels, which are the first axis of (3, ...)."""
    values = np.empty((4, *channels.shape[1:]))
    values[1:] = channels
    values[0] = luminance_of(np.moveaxis(values[1:], 0, -1))
    return values


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
    """

    def __init__(self, labels: Sequence[str], count: int, allow_negative: bool = False) -> None:
        self.labels, self.count, self.allow_negative = labels, count, allow_negative
        self.non_finite = self.negative = 0
        self.first: list[InvalidPixel] = []

    def replaced(self, top: int, band: np.ndarray) -> np.ndarray:
        """The band with the reference's mean for what is not finite; ValueError for an invalid reference."""
        least = -np.finfo(np.float32).max if self.allow_negative else 0.0
        if band.min() >= least and band.max() <= np.finfo(np.float32).max:  # false for NaN
            return band
        broken = ~(np.abs(band) <= np.finfo(np.float32).max)  # so written, it holds for NaN too
        wrong = broken if self.allow_negative else broken | (band < 0)
        if not wrong.any():
            return band
        ours, reference = band[: self.count], band[self.count :]
        if wrong[self.count :].any():
            first = _pixels(reference, wrong[self.count :], top, self.labels[self.count :])[0]
            allowed = (
                "finite" if self.allow_negative else "finite and ≥ 0 (a filter with negative lobes: --allow-negative)"
            )
            raise ValueError(f"{first.name}: {first}; a reference is {allowed}")
        self.first += _pixels(ours, wrong[: self.count], top, self.labels)
        self.non_finite += int(np.count_nonzero(broken))
        self.negative += int(np.count_nonzero(wrong & ~broken))
        return np.where(broken, reference.mean(axis=0), band)


def _pixels(band: np.ndarray, wrong: np.ndarray, top: int, names: Sequence[str]) -> list[InvalidPixel]:
    """The first values marked."""
    at = np.unravel_index(np.flatnonzero(wrong)[:LISTED_PIXELS], wrong.shape)
    return [
        InvalidPixel(k, names[k], top + y, x, CHANNELS[channel], float(band[k, y, x, channel]))
        for k, y, x, channel in zip(*(each.tolist() for each in at), strict=True)
    ]


class Equality:
    """Finds replicates that are the same image, which independent seeds do not give."""

    def __init__(self, replicates: int) -> None:
        self.digests = [hashlib.sha256() for _ in range(replicates)]  # processors have instructions for it
        self.differing = np.zeros(replicates - 1)
        self.zero = np.ones(replicates, dtype=bool)

    def read(self, band: np.ndarray) -> None:
        """Take in a band of all replicates."""
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
            side for side, members in sides.items() if constant[side] and len(members) > 1 and not self.zero[members[0]]
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
