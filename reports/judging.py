"""Replicates of any renderer judged: verdict, tiles, images, and what its page reads.

`results.json` holds the verdict, the summaries of the tiles and what was compared; `results.nc` the means `image` and
`reference` (y, x, channel) with their variances, and the maps of the tiles.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import xarray

from termwise.reports.machine import versions
from termwise.reports.results.exr import write_exr
from termwise.reports.results.netcdf import write_netcdf
from termwise.reports.results.schema import SCHEMA, plain
from termwise.reports.statistics import accumulation, replicates, rule, tiles
from termwise.scenes.store import write_atomically
from termwise.scenes.terms import TermImage

MIDDLE_GREY = 0.18
"""What the mean of the reference is shown as."""


def judge(
    images: np.ndarray | Sequence[np.ndarray],
    reference: np.ndarray | Sequence[np.ndarray],
    folder: Path,
    *,
    exact: bool = False,
    noiseless: bool = False,
    names: Sequence[str] = (),
    reference_names: Sequence[str] = (),
    notes: Sequence[str] = (),
    exposure: float | None = None,
    command: str = "",
) -> dict[str, Any]:
    """Judge replicates against a reference, and write all that is found into a folder.

    Parameters
    ----------
    images, reference, exact, noiseless, names, reference_names
        As for `reports.statistics.verdict.judge`.
    notes : what was done to the images when they were read; warnings of the verdict.
    folder : gets `results.json`, `results.nc` and `images.exr`; made if missing.
    exposure : factor on the radiance in pictures; by default the mean of the reference is shown as middle grey.
    command : what was asked for, to stand on the page.

    Returns
    -------
    What `results.json` holds.

    Raises
    ------
    ValueError : as `reports.statistics.verdict.measure`, or for an exposure that is not positive.
    """
    if exposure is not None and not (np.isfinite(exposure) and exposure > 0):
        raise ValueError(f"exposure = {exposure}: allowed is a number in (0, inf)")
    statistics = accumulation.measure(
        images, reference, exact=exact, noiseless=noiseless, names=names, reference_names=reference_names
    )
    outcome = rule.decide(statistics, tests=statistics.tests)
    outcome = attrs.evolve(outcome, warnings=(*notes, *outcome.warnings))
    maps = None if statistics.absent else tiles.tile_maps(statistics)
    with np.errstate(invalid="ignore", over="ignore"):  # the verdict has named what is not finite
        ours, truth = (
            TermImage.from_replicates(np.asarray(stack), samples=0, seconds=0.0) for stack in (images, reference)
        )
        error = ours.mean - truth.mean
    black = not truth.mean.any()
    shown = exposure or (1.0 if black else MIDDLE_GREY / statistics.term_mean)
    results = plain(
        {
            "schema": SCHEMA,
            "versions": versions(),
            "settings": {
                "command": command,
                "exposure": shown,
                "resolution": [statistics.width, statistics.height],
                "replicates": statistics.replicates,
                "reference_replicates": statistics.reference_replicates,
                "exact": exact,
                "noiseless": noiseless,
                "images": list(names),
                "reference": list(reference_names),
            },
            "verdict": outcome.row() | {"tiles": [] if maps is None else tiles.summary(maps)},
        }
    )
    dimensions = "y", "x", "channel"
    dataset = xarray.Dataset(
        {
            name: (dimensions, values.astype(np.float32))
            for name, values in (
                ("image", ours.mean),
                ("image_variance", ours.variance),
                ("reference", truth.mean),
                ("reference_variance", truth.variance),
            )
        },
        {"channel": list(replicates.CHANNELS)},
        {"exposure": shown, "units": "linear Rec. 709 radiance"},
    ).assign(xarray.Dataset(tiles.variables([maps])).isel(cell=0) if maps else {})
    parts = {"ours": ours.mean, "reference": truth.mean, "error": error}
    # A page of an earlier run must not stand beside new results, should this one end here.
    (folder / "index.html").unlink(missing_ok=True)
    write_exr(folder / "images.exr", parts, {"software": "termwise", "command": command})
    write_netcdf(folder / "results.nc", {"/": dataset})
    text = json.dumps(results, indent=1, allow_nan=False)
    write_atomically(folder / "results.json", lambda path: path.write_text(text, "utf-8"))
    return results
