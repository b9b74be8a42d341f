"""Replicates of any renderer as a page: `results.json` and `results.nc` of `termwise judge` -> `index.html`."""

import json
import shutil
from pathlib import Path
from urllib.parse import quote

import numpy as np
import xarray

from termwise.reports.pages import pictures
from termwise.reports.pages.environment import WORDS, copy_static, p_maps, page_environment, render_page
from termwise.reports.statistics import verdict


def write(folder: Path) -> Path:
    """Write the page of what was judged; returns the `index.html`.

    Parameters
    ----------
    folder : holds `results.json` and `results.nc`, as `reports.judging.judge` writes them.

    Raises
    ------
    FileNotFoundError : if one of the two files is missing.
    """
    results = json.loads((folder / "results.json").read_text("utf-8"))
    with xarray.open_dataset(folder / "results.nc", engine="h5netcdf") as opened:
        dataset = opened.load()
    shutil.rmtree(folder / "pictures", ignore_errors=True)

    def picture(name: str, pixels: np.ndarray) -> str:
        path = Path("pictures") / f"{name.replace(' ', '-')}.png"
        pictures.save(folder / path, pixels)
        return quote(path.as_posix())

    exposure = float(dataset.attrs["exposure"])
    ours, reference = dataset["image"].values, dataset["reference"].values
    error, mean = pictures.relative_error(ours, reference)
    scale = pictures.error_scale([error])
    drawn = {
        "ours": picture("ours", pictures.display(ours, exposure=exposure)),
        "reference": picture("reference", pictures.display(reference, exposure=exposure)),
        "error": picture("error", pictures.diverge(error, scale=scale)),
        "maps": p_maps(dataset, "tiles", picture),
        "scale": scale,
        "mean": mean,
        "height": ours.shape[0],
        "width": ours.shape[1],
    }
    index = folder / "index.html"
    render_page(
        page_environment(),
        "judge.html.j2",
        index,
        root="",
        row=results["verdict"],
        settings=results["settings"],
        versions=results["versions"],
        drawn=drawn,
        words=WORDS,
        rule=verdict,
        downloads=[name for name in ("results.json", "results.nc", "images.exr") if (folder / name).is_file()],
    )
    copy_static(folder)
    return index
