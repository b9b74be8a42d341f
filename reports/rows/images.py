"""Images for analysis: `results.nc`, a NetCDF with named dimensions, and the pictures of a run that go into it.

It has a group a scene: `image(cell, y, x, channel)` and `reference(limit, y, x, channel)`, means over replicates with
the variance of the mean, for each cell the indices of its own, correct and physical limit, -1 where there is none, and
the maps of its tiles, see `reports.statistics.tiles`. `object(y, x)` is what the pixels' centres see, and the luminance
of its pieces (see `reports.results.microscope`) stands for each replicate, which pixels' variances cannot say. One
replicate of each cell, the worst at its worst pixel, is there whole, in float64 as it was rendered:
`rendered(cell, y, x, channel)` and its number `rendered_replicate(cell)`; NaN and -1 for the total and for estimators
in Python.
`sweep_luminance(cell, prefix, tile_y_8, tile_x_8)` is the mean over replicates after `sweep_samples(cell, prefix)`,
with its variance; 0 samples and NaN where a cell has fewer prefixes, and for the total.
"""

import json
from pathlib import Path

import attrs
import numpy as np
import xarray

from termwise.reports.jobs.cells import Cell
from termwise.reports.results import microscope
from termwise.reports.results.exr import write_exr
from termwise.reports.results.microscope import SIDE
from termwise.reports.results.netcdf import write_netcdf
from termwise.reports.rows.measurement import of_sum
from termwise.reports.statistics.replicates import CHANNELS, LUMINANCE
from termwise.reports.statistics.tiles import TileMap, variables
from termwise.reports.study.subjects import Subject
from termwise.scenes import limits
from termwise.scenes.limits import Limit
from termwise.scenes.terms import TERMS, TOTAL, Term, TermImage


def limit_name(limit: Limit) -> str:
    """A limit in a few words, unique within a scene."""
    said = (
        (limit.transport == "physical", "physical"),
        (not limit.occluded, "unoccluded"),
        (limit.factor != 1.0, f"times {limit.factor:.6g}"),
        (limit.lobe != 1.0, f"lobe times {limit.lobe:.6g}"),
        (limit.diffuse != 0.0, f"plus diffuse {limit.diffuse:.6g}"),
        (limit.cosine != "incident", f"{limit.cosine} cosine"),
        (limit.ambient != 1.0, f"ambient times {limit.ambient:.6g}"),
        (limit.rings is not None, f"{limit.rings} rings"),
        (limit.shadows != "physical", f"{limit.shadows} shadows"),
        (bool(limit.scope), f"{limit.scope}"),
    )
    kernel = {} if limit.kernel is None else attrs.asdict(limit.kernel)
    words = [limit.term, *(word for holds, word in said if holds)]
    return " ".join([*words, *(f"{name} {value}" for name, value in kernel.items())])


@attrs.frozen(eq=False)
class Sweep:
    """A cell's luminance in tiles of SIDE pixels after the first of its samples: pixels' would be a sixth of a report.

    Attributes
    ----------
    samples : (P,) the prefixes 1, 2, 4, ..., N.
    mean, variance : (P, rows, columns) float64, over replicates, and of that mean.
    """

    samples: tuple[int, ...]
    mean: np.ndarray
    variance: np.ndarray


def sweep(cell: Cell) -> Sweep:
    """The sweep of a cell's replicates."""
    height, width = cell.images.shape[2:4]
    sums = np.stack([_tile_sums(image.astype(np.float64) @ LUMINANCE) for image in cell.images])
    stack = sums / _tile_sums(np.ones((height, width)))
    return Sweep(cell.samples, stack.mean(axis=0), stack.var(axis=0, ddof=1) / len(stack))


def _tile_sums(values: np.ndarray) -> np.ndarray:
    """Sums (..., H, W) over tiles, smaller ones at the right and lower border."""
    for axis in (-2, -1):
        values = np.add.reduceat(values, range(0, values.shape[axis], SIDE), axis=axis)
    return values


@attrs.define(eq=False)
class Pictures:
    """Collects the images of a run, scene by scene."""

    folder: Path
    groups: dict[str, xarray.Dataset] = attrs.field(factory=dict)

    def write(
        self,
        subject: Subject,
        measured: list[Cell],
        sweeps: list[Sweep],
        references: dict[Limit, np.ndarray],
        correct: dict[Term, np.ndarray],
        objects: np.ndarray,
        versions: dict[str, str],
    ) -> None:
        """Write the EXR of a scene and keep its group of the dataset; `objects` are (H, W) indices."""
        scene, pieces = subject.scene, microscope.pieces(objects)
        ours, ours_of = _ours(measured, pieces)
        truth, truth_of = _truth(subject, measured, references, correct, pieces)
        indices = _limits(subject, measured, list(truth))
        width, height = scene.resolution
        dataset = xarray.Dataset(
            {
                "image": _stacked("cell", [each.mean for each in ours.values()]),
                "image_variance": _stacked("cell", [each.variance for each in ours.values()]),
                "reference": _stacked("limit", [each.mean for each in truth.values()]),
                "reference_variance": _stacked("limit", [each.variance for each in truth.values()]),
                "object": (("y", "x"), objects),
                "piece_object": ("piece", pieces.object),
                "piece_x": ("piece", pieces.x),
                "piece_y": ("piece", pieces.y),
                "piece_pixels": ("piece", pieces.pixels),
                "image_pieces": (("cell", "replicate", "piece"), _padded(ours_of)),
                "reference_pieces": (("limit", "reference_replicate", "piece"), _padded(truth_of)),
                "rendered": (("cell", "y", "x", "channel"), np.full((len(ours), height, width, len(CHANNELS)), np.nan)),
                "rendered_replicate": ("cell", np.full(len(ours), -1)),
                **_swept(sweeps, len(ours)),
            },
            {
                "cell_term": ("cell", [term for term, _ in ours]),
                "cell_variant": ("cell", [variant for _, variant in ours]),
                "limit_name": ("limit", list(truth)),
                "own": ("cell", indices[:, 0]),
                "correct": ("cell", indices[:, 1]),
                "physical": ("cell", indices[:, 2]),
                "channel": list(CHANNELS),
                "object_name": ("objects", [thing.name for thing in scene.objects]),
            },
            {"exposure": scene.exposure, "units": "linear Rec. 709 radiance", "digest": scene.digest()},
        )
        _add_rendered(dataset, measured)
        self.groups[scene.name] = dataset
        parts = {f"{term}.{variant}": each.mean for (term, variant), each in ours.items()}
        parts |= {f"reference.{name}": each.mean for name, each in truth.items()}
        header = {
            "software": "termwise",
            "scene": scene.name,
            "digest": scene.digest(),
            "versions": json.dumps(versions),
        }
        write_exr(self.folder / "images" / f"{scene.name}.exr", parts, header)

    def locate(self, scene: str, maps: dict[tuple[str, str], dict[int, TileMap]]) -> None:
        """Add the maps of a scene's judged cells, by term and variant."""
        dataset = self.groups[scene]
        cells = zip(dataset.cell_term.values.tolist(), dataset.cell_variant.values.tolist(), strict=True)
        self.groups[scene] = dataset.assign(variables([maps.get(cell) for cell in cells]))

    def close(self) -> None:
        """Write `results.nc`."""
        write_netcdf(self.folder / "results.nc", {f"/{name}": dataset for name, dataset in self.groups.items()})


def _ours(measured: list[Cell], pieces: microscope.Pieces) -> tuple[dict[tuple[str, str], TermImage], list[np.ndarray]]:
    """The image of each cell at its last prefix and of the total, and the luminance of their pieces."""
    defaults = _defaults(measured)
    summed = of_sum([cell.images[:, -1] for cell in defaults])
    images = {
        (cell.variant.term, cell.variant.name): _summary(cell.images[:, -1], cell.samples[-1]) for cell in measured
    }
    images[TOTAL, "default"] = _summary(summed, max(cell.samples[-1] for cell in defaults))
    return images, [pieces.luminance(cell.images[:, -1]) for cell in measured] + [pieces.luminance(summed)]


def _truth(
    subject: Subject,
    measured: list[Cell],
    references: dict[Limit, np.ndarray],
    correct: dict[Term, np.ndarray],
    pieces: microscope.Pieces,
) -> tuple[dict[str, TermImage], list[np.ndarray]]:
    """The image of each limit and of their totals, by name, and the luminance of their pieces."""
    stacks = {limit_name(limit): stack for limit, stack in references.items()}
    own = [references[cell.own] for cell in _defaults(measured)]
    physical = [references.get(limits.physical(term)) for term in TERMS]
    sums = {"total": own, "total physical": [stack for stack in physical if stack is not None]}
    if subject.base is not None:
        stacks |= {_correct_name(subject, term): correct[term] for term in TERMS}
        sums["unchanged total"] = [correct[term] for term in TERMS]
    for name, chosen in sums.items():
        if chosen:
            stacks[name] = of_sum(chosen)
    images = {name: _summary(stack, 0) for name, stack in stacks.items()}
    return images, [pieces.luminance(stack) for stack in stacks.values()]


def _limits(subject: Subject, measured: list[Cell], names: list[str]) -> np.ndarray:
    """Indices (cells, 3) of the own, correct and physical limit of each cell and of the total; -1 without one."""
    of_cells = [
        (
            limit_name(cell.own),
            _correct_name(subject, cell.variant.term),
            limit_name(limits.physical(cell.variant.term)),
        )
        for cell in measured
    ]
    of_cells.append(("total", f"{_unchanged(subject)}total", "total physical"))
    return np.array([[names.index(name) if name in names else -1 for name in row] for row in of_cells])


def _unchanged(subject: Subject) -> str:
    """Before the names of the right terms of a changed scene, which are those of another."""
    return "" if subject.base is None else "unchanged "


def _correct_name(subject: Subject, term: Term) -> str:
    return _unchanged(subject) + limit_name(subject.correct(term))


def _defaults(measured: list[Cell]) -> list[Cell]:
    return [next(cell for cell in measured if cell.variant.term == term) for term in TERMS]


def _add_rendered(dataset: xarray.Dataset, measured: list[Cell]) -> None:
    """Put in the replicate of each cell that is the worst at its worst pixel, where it was kept."""
    for index, cell in enumerate(measured):
        x, y = microscope.branch(dataset, cell.variant.term, cell.variant.name).pixel
        replicate = microscope.worst_replicate(dataset, index, cell.images[:, -1, y, x], x, y)
        rendered = cell.rendered(replicate)
        if rendered is not None:
            dataset["rendered"].values[index] = rendered
            dataset["rendered_replicate"].values[index] = replicate


def _summary(stack: np.ndarray, samples: int) -> TermImage:
    return TermImage.from_replicates(stack, samples=samples, seconds=0.0)


def _padded(stacks: list[np.ndarray]) -> np.ndarray:
    """Stacks of so many replicates as the longest has; NaN where one has fewer."""
    longest = max(len(stack) for stack in stacks)
    return np.stack([np.pad(stack, ((0, longest - len(stack)), (0, 0)), constant_values=np.nan) for stack in stacks])


def _swept(sweeps: list[Sweep], cells: int) -> dict[str, tuple[tuple[str, ...], np.ndarray]]:
    """The sweeps of a scene's cells as variables, up to as many prefixes as the longest has."""
    longest = max(len(each.samples) for each in sweeps)
    samples = np.zeros((cells, longest), np.int64)
    mean, variance = (np.full((cells, longest, *sweeps[0].mean.shape[1:]), np.nan, np.float32) for _ in range(2))
    for cell, each in enumerate(sweeps):
        samples[cell, : len(each.samples)] = each.samples
        mean[cell, : len(each.samples)] = each.mean
        variance[cell, : len(each.samples)] = each.variance
    dims = "cell", "prefix", f"tile_y_{SIDE}", f"tile_x_{SIDE}"
    return {"sweep_samples": (dims[:2], samples), "sweep_luminance": (dims, mean), "sweep_variance": (dims, variance)}


def _stacked(dimension: str, arrays: list[np.ndarray]) -> tuple[tuple[str, ...], np.ndarray]:
    return (dimension, "y", "x", "channel"), np.stack(arrays).astype(np.float32)
