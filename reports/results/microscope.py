"""The bias microscope: image -> object -> tile -> pixel, each beside the reference, from a finished run's folder.

A piece is what one object covers of one tile. Pieces have a luminance a replicate, so objects, tiles and the image,
which are sums of pieces, are compared by Welch's t on replicates as a verdict is. A pixel has the variances of its
channels alone: its standard error is the sum of theirs, which is right where the channels vary together and too wide
elsewhere. A place is as suspect as its z = bias / standard error is far from 0, and the branch opens at the most
suspect object, tile and pixel. z finds a place and proves none: of many places the worst is far out by chance; what is
proven stands in the row's verdict.
"""

import json
import math
import shlex
from collections.abc import Container, Hashable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np
from scipy import stats

from termwise.reports.statistics import verdict
from termwise.reports.statistics.replicates import LUMINANCE, TILE_SIDES
from termwise.reports.statistics.welch import TERM_FLOOR, ULP_FLOOR, welch
from termwise.scenes.strict import FileError
from termwise.scenes.terms import TOTAL

if TYPE_CHECKING:
    import xarray

SIDE = TILE_SIDES[0]
NO_OBJECT = "(none)"
_RANK = ("NO VERDICT", *(verdict.WORDS[kind][0] for kind in ("right", "wrong")), "UNDERPOWERED")


@attrs.frozen(eq=False)
class Pieces:
    """What each object covers of each tile of SIDE pixels.

    Attributes
    ----------
    index : (H, W) int, the piece of each pixel.
    object, x, y, pixels : (P,) int each, the object (-1: none), the tile's corner, and how many pixels a piece has.
    """

    index: np.ndarray
    object: np.ndarray
    x: np.ndarray
    y: np.ndarray
    pixels: np.ndarray

    def luminance(self, images: np.ndarray) -> np.ndarray:
        """Mean luminance (K, P) float64 of each piece in images (K, H, W, 3)."""
        at, count = self.index.ravel(), len(self.pixels)
        sums = [np.bincount(at, _luminance(image.astype(np.float64)).ravel(), count) for image in images]
        return np.array(sums) / self.pixels


def pieces(objects: np.ndarray) -> Pieces:
    """Pieces of an image by the object (H, W) of each pixel, -1 for none."""
    height, width = objects.shape
    y, x = np.mgrid[0:height, 0:width]
    labels = np.stack([objects, SIDE * (x // SIDE), SIDE * (y // SIDE)], axis=-1).reshape(-1, 3)
    found, index, pixels = np.unique(labels, axis=0, return_inverse=True, return_counts=True)
    return Pieces(index.reshape(height, width), found[:, 0], found[:, 1], found[:, 2], pixels)


@attrs.frozen
class Place:
    """A part of the image beside the reference: relative bias of luminance, 90 % interval, z."""

    name: str
    pixels: int
    bias: float
    low: float
    high: float
    z: float


@attrs.frozen
class Branch:
    """From a row's image down to one pixel.

    Attributes
    ----------
    image : the whole.
    objects, tiles, pixels : of the image, of the object and of the object's tile that is opened, the most suspect
        first; the opened one of each is `object`, `tile`, `at`.
    pixel : (x, y) of `at`.
    ours, reference : its mean radiance.
    ours_error, reference_error : standard error of each channel of it, NaN for a side that is one image.
    replicate, value : the replicate that is stored whole, and its float64 radiance there; None where none is.
    """

    image: Place
    objects: tuple[Place, ...]
    object: Place
    tiles: tuple[Place, ...]
    tile: Place
    pixels: tuple[Place, ...]
    at: Place
    pixel: tuple[int, int]
    ours: tuple[float, ...]
    reference: tuple[float, ...]
    ours_error: tuple[float, ...]
    reference_error: tuple[float, ...]
    replicate: int | None
    value: tuple[float, ...] | None


def branch(
    dataset: "xarray.Dataset",
    term: str,
    variant: str,
    *,
    object: str | None = None,
    tile: tuple[int, int] | None = None,
    pixel: tuple[int, int] | None = None,
) -> Branch:
    """The branch of a row of a scene against its own limit, through the places that are named, else the most suspect.

    Parameters
    ----------
    dataset : the scene's group of `results.nc`.
    term, variant : which row.
    object : an object's name.
    tile : x and y of any pixel of a tile.
    pixel : x and y; its object and tile follow from it.

    Raises
    ------
    ValueError : a row or a place that is not there; the message says what is.
    """
    cell = _cell(dataset, term, variant)
    limit = int(dataset["own"].values[cell])
    height, width = dataset["object"].shape
    for what, given in (("pixel", pixel), ("tile", tile)):
        for axis, at, size in zip("xy", given or (), (width, height), strict=False):
            if not 0 <= at < size:
                name = axis if what == "pixel" else f"tile {axis}"
                raise ValueError(f"{name} = {at}: allowed is an integer in [0, {size - 1}]")
    of_piece = dataset["piece_object"].values
    corners = list(zip(dataset["piece_x"].values.tolist(), dataset["piece_y"].values.tolist(), strict=True))
    weights = dataset["piece_pixels"].values
    # Rows of NaN stand where others have more replicates.
    ours, reference = (
        each[~np.isnan(each).all(axis=1)]
        for each in (dataset["image_pieces"].values[cell], dataset["reference_pieces"].values[limit])
    )
    names = dict(enumerate(dataset["object_name"].values.astype(str))) | {-1: NO_OBJECT}
    mean = float(reference.mean(axis=0) @ weights / weights.sum()) or 1.0
    brightest = max(float(dataset["image"][cell].max()), float(dataset["reference"][limit].max()))

    def places(groups: dict[str, np.ndarray], least: float) -> list[Place]:
        """Sums of pieces, by name."""
        member = np.stack([mask * weights for mask in groups.values()], axis=1)
        counts = member.sum(axis=0)
        compared = welch(
            ours @ member / counts,
            reference @ member / counts,
            least=least,
            term_mean=mean,
            areas=counts,
            brightest=brightest,
        )
        low, high = compared.interval(0.1)
        rows = zip(groups, counts, compared.bias, low, high, compared.standard_error, strict=True)
        return [Place(name, int(n), float(b), float(lo), float(hi), _z(b, se)) for name, n, b, lo, hi, se in rows]

    everything = np.ones(len(weights), np.bool_)
    (image,) = places({"image": everything}, mean)
    if pixel is not None:
        object = names[int(dataset["object"].values[pixel[1], pixel[0]])]
        tile = pixel
    seen = {names[index]: of_piece == index for index in np.unique(of_piece)}
    if object is not None and object not in seen:
        raise ValueError(f"object = {object!r}: allowed are {', '.join(map(repr, seen))}")
    objects = _worst_first(places(seen, 0.1 * mean))
    if object is None and tile is not None:
        inside = [name for name, mask in seen.items() if _corner(tile) in _chosen(corners, mask)]
        opened = next(place for place in objects if place.name in inside)
    else:
        opened = _opened(objects, object)
    tiles_of = {
        _tile_name(corner, width, height): seen[opened.name] & np.array([each == corner for each in corners])
        for corner in dict.fromkeys(_chosen(corners, seen[opened.name]))
    }
    wanted = None if tile is None else _tile_name(_corner(tile), width, height)
    if wanted is not None and wanted not in tiles_of:
        raise ValueError(f"{wanted}: holds nothing of {opened.name!r}: allowed are {'; '.join(tiles_of)}")
    tiles = _worst_first(places(tiles_of, mean))
    opened_tile = _opened(tiles, wanted)
    x0, y0 = corners[int(np.flatnonzero(tiles_of[opened_tile.name])[0])]
    inside = dataset["object"].values[y0 : y0 + SIDE, x0 : x0 + SIDE]
    index = next(number for number, name in names.items() if name == opened.name)
    at = [(x0 + int(x), y0 + int(y)) for y, x in np.argwhere(inside == index)]
    pixels = _pixels(dataset, cell, limit, at, mean, dof=min(len(ours), max(len(reference), 2)) - 1)
    opened_pixel = _opened(pixels, None if pixel is None else _pixel_name(*pixel))
    x, y = next(each for each in at if _pixel_name(*each) == opened_pixel.name)
    replicate = int(dataset["rendered_replicate"].values[cell])
    value = tuple(map(float, dataset["rendered"].values[cell, y, x]))
    return Branch(
        image,
        tuple(objects),
        opened,
        tuple(tiles),
        opened_tile,
        tuple(pixels),
        opened_pixel,
        (x, y),
        tuple(map(float, dataset["image"].values[cell, y, x])),
        tuple(map(float, dataset["reference"].values[limit, y, x])),
        tuple(map(float, np.sqrt(dataset["image_variance"].values[cell, y, x]))),
        tuple(map(float, np.sqrt(dataset["reference_variance"].values[limit, y, x]))),
        None if replicate < 0 else replicate,
        None if replicate < 0 else value,
    )


def worst_replicate(dataset: "xarray.Dataset", cell: int, values: np.ndarray, x: int, y: int) -> int:
    """Number of the replicate, of values (K, 3) at a pixel, that lies farthest out on the side of the pixel's bias."""
    reference = _luminance(dataset["reference"].values[int(dataset["own"].values[cell]), y, x])
    bias = _luminance(values.astype(np.float64)) - reference
    if not np.isfinite(bias).all():
        return int(np.argmin(np.isfinite(bias)))
    return int(np.argmax(bias if bias.mean() >= 0 else -bias))


@attrs.frozen(eq=False)
class Run:
    """A finished run that the microscope looks into."""

    folder: Path
    results: dict[str, Any]

    def judged(self, scene: str | None, term: str | None, variant: str | None) -> list[dict[str, Any]]:
        """Judged rows that have images and fit, the worst first.

        By the gravity of the verdict, then by how far, in standard errors, a mean of theirs lies outside of the
        allowance. The sum of the terms comes by its name alone.
        """
        rows = [row for row in self.results["cells"] if row.get("verdict") and not row.get("group")]
        named = {"scene": scene, "term": term, "variant": variant}
        for field, value in named.items():
            known = list(dict.fromkeys(row[field] for row in rows))
            if value is not None and value not in known:
                raise ValueError(f"{field} = {value!r}: allowed are {', '.join(known) or 'none, nothing was judged'}")
            rows = [row for row in rows if value is None or row[field] == value]
        if term is None:
            rows = [row for row in rows if row["term"] != TOTAL]
        if not rows:
            raise ValueError(f"{self.folder}: holds no judged row with images: allowed are folders of a compare run")
        return sorted(rows, key=_gravity)

    def group(self, scene: str) -> "xarray.Dataset":
        """The images of a scene."""
        import xarray  # here: the page of large images, which knows SIDE, does not wait a second for it

        path = self.folder / "results.nc"
        try:
            with xarray.open_dataset(path, group=scene, engine="h5netcdf") as dataset:
                dataset = dataset.load()
        except (OSError, ValueError, KeyError, RuntimeError) as error:
            why = " ".join(str(error).split())
            raise FileError(f"{path}: cannot be read ({why}): allowed is what termwise compare wrote") from None
        if not has_pieces(dataset):
            raise FileError(f"{path}: {scene}: has no pieces, an older run's: allowed is what compare writes now")
        return dataset

    def replay(self, row: dict[str, Any], found: Branch) -> str:
        """The command that replays a branch's pixel."""
        return f"{replay_command(self.results, row, found)} --results {shlex.quote(str(self.folder))}"


def open_run(folder: Path) -> Run:
    """The run in a folder; a FileError says what is wrong with it."""
    path = folder / "results.json"
    if not path.is_file():
        raise FileError(f"{folder}: holds no results.json: allowed are folders that termwise compare wrote")
    try:
        results = json.loads(path.read_text("utf-8"))
        whole = {"scenes", "study"} <= results["settings"].keys() and isinstance(results["cells"], list)
    except (ValueError, KeyError, TypeError) as error:
        raise FileError(f"{path}: is damaged ({error}): allowed is what termwise compare wrote") from None
    if not whole:
        raise FileError(f"{path}: is not of a run: allowed is what termwise compare wrote")
    return Run(folder, results)


def has_pieces(dataset: Container[Hashable]) -> bool:
    """Whether a scene's images can be looked into: those of earlier versions cannot."""
    return "image_pieces" in dataset and "rendered" in dataset


def replay_command(results: dict[str, Any], row: dict[str, Any], found: Branch) -> str:
    """The command that replays a branch's pixel."""
    arguments = results["settings"].get("arguments", {})
    scene = arguments.get("scenes", {}).get(row["scene"], row["scene"])
    study = arguments.get("study", results["settings"]["study"])
    x, y = found.pixel
    words = ("termwise", "replay", "--scene", scene, "--term", row["term"], "--variant", row["variant"])
    words += ("--x", x, "--y", y, "--replicate", found.replicate, "--study", study)
    words += ("--approximate",) if arguments.get("approximate") else ()
    return shlex.join(map(str, words))


def _cell(dataset: "xarray.Dataset", term: str, variant: str) -> int:
    known = list(zip(*(dataset[name].values.astype(str) for name in ("cell_term", "cell_variant")), strict=True))
    if (term, variant) not in known:
        allowed = ", ".join(f"{its} {name}" for its, name in known)
        raise ValueError(f"{term} {variant}: was not measured: allowed are {allowed}")
    return known.index((term, variant))


def rendered(dataset: "xarray.Dataset", term: str, variant: str) -> tuple[int, np.ndarray]:
    """The replicate of a row that is stored as it was rendered, and its image (H, W, 3) float64."""
    cell = _cell(dataset, term, variant)
    return int(dataset["rendered_replicate"].values[cell]), dataset["rendered"].values[cell]


def _gravity(row: dict[str, Any]) -> tuple[int, float]:
    rank = _RANK.index(row["verdict"]) if row["verdict"] in _RANK else len(_RANK)
    outside = [
        (abs(region["bias"]) - (row.get("allowance") or 0.0)) / region["standard_error"]
        for region in row["channels"] + row["objects"]
        if region.get("standard_error") and region["bias"] is not None
    ]
    return (rank + (row["verdict"] == "ABSENT"), -max(outside, default=-math.inf))


def _pixels(
    dataset: "xarray.Dataset", cell: int, limit: int, at: list[tuple[int, int]], mean: float, *, dof: int
) -> list[Place]:
    """Pixels as places, the most suspect first."""
    x, y = (np.array(axis) for axis in zip(*at, strict=True))
    ours, reference = dataset["image"].values[cell, y, x], dataset["reference"].values[limit, y, x]
    error = [
        _luminance(np.sqrt(np.nan_to_num(dataset[name].values[index, y, x].astype(np.float64))))
        for name, index in (("image_variance", cell), ("reference_variance", limit))
    ]
    truth = _luminance(reference.astype(np.float64))
    floor = np.hypot(TERM_FLOOR * mean, ULP_FLOOR * np.spacing(np.float32(truth)))
    scale = np.maximum(truth, mean)
    bias = (_luminance(ours.astype(np.float64)) - truth) / scale
    se = np.hypot(np.hypot(*error), floor) / scale
    half = float(stats.t.isf(0.05, dof)) * se
    rows = zip(at, bias, bias - half, bias + half, se, strict=True)
    return _worst_first(
        [Place(_pixel_name(*p), 1, float(b), float(lo), float(hi), _z(b, s)) for p, b, lo, hi, s in rows]
    )


def _luminance(rgb: np.ndarray) -> np.ndarray:
    return rgb @ np.array(LUMINANCE)


def _z(bias: float, error: float) -> float:
    return float(bias / error)


def _worst_first(places: list[Place]) -> list[Place]:
    # What is not a number is worse than any.
    return sorted(places, key=lambda place: -abs(place.z) if math.isfinite(place.z) else -math.inf)


def _opened(places: list[Place], name: str | None) -> Place:
    return next(place for place in places if name in (None, place.name))


def _corner(pixel: tuple[int, int]) -> tuple[int, int]:
    return pixel[0] // SIDE * SIDE, pixel[1] // SIDE * SIDE


def _chosen(corners: list[tuple[int, int]], mask: np.ndarray) -> list[tuple[int, int]]:
    return [corner for corner, taken in zip(corners, mask, strict=True) if taken]


def _tile_name(corner: tuple[int, int], width: int, height: int) -> str:
    x, y = corner
    return f"tile x {x}-{min(x + SIDE, width) - 1}, y {y}-{min(y + SIDE, height) - 1}"


def _pixel_name(x: int, y: int) -> str:
    return f"pixel x {x}, y {y}"
