"""One comparison of replicates with a reference: measured, then decided once the tests of the whole family are known.

`measure` reads the replicates and gives what a verdict and its page need of them; `Measured.decide` makes the
`Judgement`. `judge` is both, for a family of one.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from termwise.reports.judging.hints import AtDepth, Hint, hints
from termwise.reports.statistics import accumulation, rule
from termwise.reports.statistics.accumulation import Statistics
from termwise.reports.statistics.headline import headline
from termwise.reports.statistics.replicates import mapping, stacked
from termwise.reports.statistics.verdict import LEVEL, MARGIN, Verdict
from termwise.scenes.terms import TermImage

Images = Any
"""Replicates: an array (K, H, W, 3), a `TermImage` that holds them, files or folders, or a sequence of (H, W, 3)."""

_CACHED = 2**18
"""Numbers that a processor's cache holds, in float64."""


@attrs.frozen(eq=False, repr=False, kw_only=True)
class Judgement(Verdict):
    """A `Verdict` on images, with what can be seen of it; a notebook shows picture, verdict and interval.

    Attributes
    ----------
    headline : the verdict in plain words: `2 % too bright, everywhere`.
    hints : simple causes that would explain an error that is proven; never a part of the verdict.
    maps : the tests of tiles by their side, see `reports.statistics.tiles.TileMap`; empty where nothing was compared.
    ours, reference : TermImage or None
        Mean and variance over the replicates; None where they were not kept, as in a suite.
    settings : what was compared, and how.
    """

    headline: str
    hints: tuple[Hint, ...]
    maps: dict[int, Any]
    ours: TermImage | None
    reference: TermImage | None
    settings: dict[str, Any]

    @property
    def tiles(self) -> list[dict[str, Any]]:
        """For each size of tiles what their tests found, see `reports.statistics.tiles.summary`."""
        from termwise.reports.statistics import tiles

        return tiles.summary(self.maps)

    def row(self) -> dict[str, Any]:
        """Plain values, ready for JSON; images are left out."""
        shown = [field.name for field in attrs.fields(Verdict)]
        row = attrs.asdict(self, filter=lambda field, _: field.name in shown, recurse=False)
        row["regions"] = [attrs.asdict(each) for each in self.regions]
        return row | {
            "headline": self.headline,
            "hints": [attrs.asdict(each) for each in self.hints],
            "tiles": self.tiles,
        }

    def __repr__(self) -> str:
        """The verdict, in a line."""
        return f"<{self.verdict}: {self.headline}>"

    def _repr_html_(self) -> str:
        """Picture, verdict and interval, for a notebook."""
        from termwise.reports.pages.judge import notebook

        return notebook(self)

    def save(self, folder: Path | str, *, exposure: float | None = None, command: str = "") -> Path:
        """Write the page of this comparison with its numbers and images; returns its `index.html`.

        Parameters
        ----------
        folder : gets `index.html`, `results.json`, `results.nc` and `images.exr`; made if missing.
        exposure : factor on the radiance in pictures; by default the mean of the reference is shown as middle grey.
        command : what was asked for, to stand on the page.

        Raises
        ------
        ValueError : the images were not kept, or the exposure is not positive.
        """
        from termwise.reports.judging.folder import keep, publish

        folder = Path(folder)
        keep(folder, self, exposure=exposure, command=command)
        return publish(folder, self, command=command)


@attrs.frozen(eq=False, kw_only=True)
class Measured:
    """What is known of a comparison before the tests of its family are counted.

    Attributes
    ----------
    statistics : of the rule.
    hints : that hold at its own level; said only if the verdict is BIASED.
    maps : see `Judgement`.
    ours, reference : TermImage or None, see `Judgement`.
    samples, seconds : that a replicate of ours took, where they are known.
    notes : what was done to the images when they were read; warnings of the verdict.
    settings : what was compared, and how.
    """

    statistics: Statistics
    hints: tuple[Hint, ...]
    maps: dict[int, Any]
    ours: TermImage | None
    reference: TermImage | None
    samples: int | None
    seconds: float | None
    notes: tuple[str, ...]
    settings: dict[str, Any]

    def decide(self, *, tests: int, margin: float = MARGIN, level: float = LEVEL) -> Judgement:
        """The verdict, once the tests of the whole family are known; see `reports.statistics.rule.decide`."""
        verdict = rule.decide(
            self.statistics, tests=tests, margin=margin, level=level, samples=self.samples, seconds=self.seconds
        )
        verdict = attrs.evolve(verdict, warnings=self.notes + verdict.warnings)
        found = self.hints if verdict.verdict == "BIASED" else ()
        return Judgement(
            **{field.name: getattr(verdict, field.name) for field in attrs.fields(Verdict)},
            headline=headline(verdict, self.statistics),
            hints=found,
            maps=self.maps,
            ours=self.ours,
            reference=self.reference,
            settings=self.settings | {"margin": margin, "level": level},
        )

    def without_images(self) -> "Measured":
        """The same, small."""
        return attrs.evolve(self, ours=None, reference=None)


def judge(
    images: Images,
    reference: Images,
    *,
    margin: float = MARGIN,
    level: float = LEVEL,
    objects: np.ndarray | Path | str | None = None,
    object_names: Sequence[str] = (),
    mask: np.ndarray | Path | str | None = None,
    exact: bool = False,
    noiseless: bool = False,
    allow_negative: bool = False,
    samples: int | None = None,
    layer: str | None = None,
    reference_layer: str | None = None,
    names: Sequence[str] = (),
    reference_names: Sequence[str] = (),
    hint: bool = True,
    at_depth: AtDepth | None = None,
) -> Judgement:
    """Whether the images of any renderer are biased against a reference: by how much, where, and how sure that is.

    BIASED means that an error is proven, of a mean, of the shape or of a place, at `level` over all tests; EQUIVALENT
    that the mean of every channel lies within `margin` and the shape error is small; UNDERPOWERED that neither is
    shown; ABSENT that both sides are black everywhere.

    Parameters
    ----------
    images, reference : (K, H, W, 3) and (R, H, W, 3) floating, or what holds such replicates
        Images of equal settings and different seeds, linear radiance in one unit, at least 4 of each, better 16: an
        array, a sequence of (H, W, 3) arrays, a `TermImage` of `termwise.render` or `termwise.reference`, or paths of
        image files and of folders of them. With `exact`, `reference` may be one (H, W, 3) image.
    margin : relative bias of a mean that is equivalent to none, 1 % by default. It excuses noise, not a proven error.
    level : chance of any false BIASED, 5 % by default.
    objects : (H, W) integer or the path of an index image, optional
        Index of the object that each pixel sees, -1 for none. Each object is judged on its own too, so that an error
        of a small one is not lost in the image's mean.
    object_names : names of those objects, by index.
    mask : (H, W) bool or the path of an image, optional
        Pixels that are compared; where it is 0 nothing is.
    exact : the reference has no noise; it is one image then.
    noiseless : the images may have no noise. Nothing is known of the seeds here, so replicates that are all the same
        image are refused without it.
    allow_negative : negative pixels are no error, as filters with negative lobes make them.
    samples : samples per pixel of one replicate, so that an open verdict can say how many it needs.
    layer, reference_layer : names of the layers to read from files that hold several.
    names, reference_names : what the replicates are called in warnings and messages; by default files or numbers.
    hint : after BIASED, look for simple causes (a shift, a flip, a factor), which takes a few times as long.
    at_depth : function, optional
        (depth, count) -> (count, H, W, 3), the first replicates of the reference where light scatters at surfaces so
        often at most, 1 being direct light. Called for a hint alone, where the images are too dark: it says whether
        their light ends too soon.

    Returns
    -------
    Judgement : `verdict`, `headline`, `sentence`, and the numbers behind them; `save(folder)` writes its page.

    Raises
    ------
    ValueError : images of unequal size or too few, NaN in the reference, replicates that are the same image; the
        message says which, and what is allowed.

    Examples
    --------
    >>> import numpy as np, termwise
    >>> rng = np.random.default_rng(1)
    >>> ours, reference = 1.05 * rng.gamma(100, 0.01, (16, 32, 32, 3)), rng.gamma(100, 0.01, (16, 32, 32, 3))
    >>> termwise.judge(ours, reference).verdict
    'BIASED'
    """
    measured = measure(
        images,
        reference,
        objects=objects,
        object_names=object_names,
        mask=mask,
        exact=exact,
        noiseless=noiseless,
        allow_negative=allow_negative,
        samples=samples,
        layer=layer,
        reference_layer=reference_layer,
        names=names,
        reference_names=reference_names,
        margin=margin,
        level=level,
        hint=hint,
        at_depth=at_depth,
    )
    return measured.decide(tests=measured.statistics.tests, margin=margin, level=level)


def measure(
    images: Images,
    reference: Images,
    *,
    margin: float = MARGIN,
    level: float = LEVEL,
    objects: np.ndarray | Path | str | None = None,
    object_names: Sequence[str] = (),
    mask: np.ndarray | Path | str | None = None,
    exact: bool = False,
    noiseless: bool = False,
    allow_negative: bool = False,
    samples: int | None = None,
    layer: str | None = None,
    reference_layer: str | None = None,
    names: Sequence[str] = (),
    reference_names: Sequence[str] = (),
    hint: bool = True,
    at_depth: AtDepth | None = None,
) -> Measured:
    """Measure a comparison that may be one of several; parameters as for `judge`.

    A margin or a level that is out of range is refused here, before the time is spent.
    """
    ours = _side("images", images, layer, names)
    truth = _side("reference", reference, reference_layer, reference_names, exact=exact)
    notes = [note for side in (ours, truth) if side.files is not None for note in side.files.notes]
    if ours.files is not None and truth.files is not None:
        notes += ours.files.beside(truth.files)
    if ours.names and set(ours.names) == set(truth.names):
        raise ValueError(f"images and reference are the same files ({ours.names[0]}, ...): allowed are two renderings")
    places, inside = index_map(objects), mask_map(mask)
    for name, given, found in (("objects", objects, places), ("mask", mask, inside)):
        if isinstance(given, str | Path) and found is not None and found.shape != ours.stack.shape[1:3]:
            sizes = [f"{shape[1]} x {shape[0]}" for shape in (found.shape, ours.stack.shape[1:3])]
            raise ValueError(f"{name}: {given}: is {sizes[0]} pixels: allowed are {sizes[1]}, those of the images")
    statistics = accumulation.measure(
        ours.stack,
        truth.stack,
        objects=places,
        object_names=object_names,
        mask=inside,
        exact=exact,
        noiseless=noiseless,
        allow_negative=allow_negative,
        quantum=(ours.quantum, truth.quantum),
        names=ours.names,
        reference_names=truth.names,
    )
    alone = rule.decide(statistics, tests=statistics.tests, margin=margin, level=level)
    found: tuple[Hint, ...] = ()
    if hint and alone.verdict == "BIASED":
        found = hints(ours.stack, truth.stack, statistics, mask=inside, margin=margin, level=level, at_depth=at_depth)
    return Measured(
        statistics=statistics,
        hints=found,
        maps=_maps(statistics),
        ours=mean_and_variance(ours.stack),
        reference=mean_and_variance(truth.stack),
        samples=samples or ours.samples,
        seconds=ours.seconds,
        notes=tuple(notes),
        settings={
            "resolution": [statistics.width, statistics.height],
            "replicates": statistics.replicates,
            "reference_replicates": statistics.reference_replicates,
            "exact": exact,
            "noiseless": noiseless,
            "allow_negative": allow_negative,
            "objects": len(statistics.region_names) - 1,
            "mask": None if inside is None else f"{inside.mean():.1%} of the pixels",
            "images": ours.names,
            "reference": truth.names,
        },
    )


def _maps(statistics: Statistics) -> dict[int, Any]:
    from termwise.reports.statistics import tiles

    return {} if statistics.absent else tiles.tile_maps(statistics)


@attrs.frozen(eq=False)
class _Side:
    """Replicates (n, H, W, 3), what they are called, and samples and seconds of one where they are known.

    `files` is what was read, where they are from files.
    """

    stack: np.ndarray
    names: list[str]
    samples: int | None = None
    seconds: float | None = None
    files: Any = None

    @property
    def quantum(self) -> float:
        """How far their storage may have rounded a value beyond float32, relative."""
        half = np.finfo(np.float16).eps / 2 if self.stack.dtype == np.float16 else 0.0
        return max(half, 0.0 if self.files is None else self.files.quantum)


def _side(side: str, given: Images, layer: str | None, names: Sequence[str], *, exact: bool = False) -> _Side:
    if isinstance(given, TermImage):
        kept = getattr(given, "images", None)
        if kept is None:
            raise ValueError(f"{side}: holds its mean alone: allowed is a TermImage that keeps its replicates")
        seconds = given.seconds / max(given.replicates, 1)
        return _Side(stacked(side, kept), list(names), given.samples or None, seconds or None)
    if isinstance(given, str | Path):
        given = [given]
    if not isinstance(given, np.ndarray) and len(given) and all(isinstance(each, str | Path) for each in given):
        from termwise.scenes.images import replicates

        read = replicates([Path(each) for each in given], layer)
        return _Side(read.pixels, list(names) or read.names, files=read)
    if layer is not None:
        raise ValueError(f"{side}: layer = {layer!r}: allowed for files alone")
    if exact and isinstance(given, np.ndarray) and given.ndim == 3:
        given = given[None]
    return _Side(stacked(side, given, names), list(names))


def index_map(given: np.ndarray | Path | str | None) -> np.ndarray | None:
    """Objects by pixel, from an array or an index image."""
    if isinstance(given, str | Path):
        from termwise.reports.judging import files

        return files.index_image(Path(given))
    return None if given is None else np.asarray(given)


def mask_map(given: np.ndarray | Path | str | None) -> np.ndarray | None:
    """Pixels that are compared, from an array or an image: where any channel is not 0."""
    if isinstance(given, str | Path):
        from termwise.reports.judging import files

        return files.mask_image(Path(given))
    return None if given is None else np.asarray(given).astype(bool)


def mean_and_variance(stack: np.ndarray) -> TermImage:
    """Of replicates (n, H, W, 3), read by rows; what is not finite is named by the verdict."""
    count, (height, *row) = len(stack), stack.shape[1:]
    mean, variance = (np.full((height, *row), np.nan, np.float32) for _ in range(2))
    rows = max(1, _CACHED // (count * math.prod(row)))

    def read(top: int) -> None:
        with np.errstate(invalid="ignore", over="ignore"):
            band = stack[:, top : top + rows].astype(np.float64)
            mean[top : top + rows] = of_band = band.mean(axis=0)
            if count > 1:
                band -= of_band  # as `np.var` does, which would take the mean again
                band *= band
                variance[top : top + rows] = band.sum(axis=0) / (count - 1) / count

    with mapping(stack.size > _CACHED) as each:
        list(each(read, range(0, height, rows)))
    return TermImage(mean, variance, samples=0, replicates=count, seconds=0.0)
