"""A comparison in a folder: `results.json`, `results.nc`, `images.exr`, and the page that is made of them.

`results.json` holds the verdict, the hints, the summaries of the tiles and what was compared; `results.nc` the means
`image` and `reference` (y, x, channel) with their variances, and the maps of the tiles.
"""

from pathlib import Path

import h5py
import numpy as np

from termwise.reports.judging.judge import Judgement, Measured
from termwise.reports.machine import versions
from termwise.reports.pages import pictures
from termwise.reports.results.exr import write_exr
from termwise.reports.results.netcdf import write_variables
from termwise.reports.results.schema import SCHEMA, write
from termwise.reports.statistics import replicates, tiles


def check_exposure(exposure: float | None) -> None:
    """Refuse an exposure that is not positive with a ValueError."""
    if exposure is not None and not (np.isfinite(exposure) and exposure > 0):
        raise ValueError(f"exposure = {exposure}: allowed is a number in (0, inf)")


def keep(folder: Path, compared: Judgement | Measured, *, exposure: float | None = None, command: str = "") -> None:
    """Write images and maps of a comparison, whatever becomes of its verdict.

    Parameters
    ----------
    folder : gets `results.nc` and `images.exr`; made if missing.
    compared : with its images.
    exposure : factor on the radiance in pictures; by default the mean of the reference is shown as middle grey.
    command : what was asked for, to stand in the header.
    """
    check_exposure(exposure)
    ours, truth = compared.ours, compared.reference
    if ours is None or truth is None:
        raise ValueError("the images of this comparison were not kept: allowed is what `judge` returns")
    shown = exposure or pictures.shown_at(truth.mean)
    variables: dict[str, tuple[tuple[str, ...], np.ndarray]] = {
        name: (("y", "x", "channel"), values.astype(np.float32, copy=False))
        for name, values in (
            ("image", ours.mean),
            ("image_variance", ours.variance),
            ("reference", truth.mean),
            ("reference_variance", truth.variance),
        )
    }
    variables["channel"] = ("channel",), np.array(replicates.CHANNELS, object)
    for name, (dimensions, maps) in tiles.variables([compared.maps]).items():
        variables[name] = dimensions[1:], maps[0]  # of the one cell
    # A page of an earlier run must not stand beside new results, should this one end here.
    for name in ("index.html", "results.json"):
        (folder / name).unlink(missing_ok=True)
    with np.errstate(invalid="ignore"):
        parts = {"ours": ours.mean, "reference": truth.mean, "error": ours.mean - truth.mean}
    write_exr(folder / "images.exr", parts, {"software": "termwise", "command": command})
    write_variables(folder / "results.nc", variables, {"exposure": shown, "units": "linear Rec. 709 radiance"})


def publish(folder: Path, judgement: Judgement, *, command: str = "", root: str = "") -> Path:
    """Write `results.json` and the page of a comparison whose images are kept; returns the `index.html`.

    `root` leads from the folder to that of the index of a suite; empty where there is none.
    """
    from termwise.reports.pages import judge as page

    with h5py.File(folder / "results.nc") as kept:
        exposure = float(np.asarray(kept.attrs["exposure"]).item())
    results = {
        "schema": SCHEMA,
        "versions": versions(),
        "settings": {"command": command, "exposure": exposure, **judgement.settings},
        "verdict": judgement.row(),
    }
    write(folder / "results.json", results)
    return page.write(folder, root=root)
