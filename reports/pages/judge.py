"""Replicates of any renderer as pages: what `reports.judging` keeps -> `index.html` of a comparison, and of a suite."""

import base64
import io
import json
import os
import shutil
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any
from urllib.parse import quote

import attrs
import h5netcdf
import numpy as np
from markupsafe import Markup, escape
from PIL import Image

from termwise.reports.pages import digits, pictures, viewer
from termwise.reports.pages.environment import WORDS, copy_static, p_maps, page_environment, render_page
from termwise.reports.statistics import verdict

NOTEBOOK_SIDE = 256
"""Pixels of the longer side of a picture in a notebook, at most."""
THUMBNAIL_SIDE = 160
VIEWED_PIXELS = 2**20
"""Of the largest image that gets a viewer: one of 1080p would add 150 MB, and half a minute."""
_LISTED = "results.json", "results.nc", "images.exr"
_COLOURS = {"bad": ("#8c1d00", "#fddfd3"), "open": ("#634400", "#fbecc4"), "good": ("#00543f", "#d9f0e7")}


def write(folder: Path, *, root: str = "") -> Path:
    """Write the page of a comparison; returns the `index.html`.

    Parameters
    ----------
    folder : holds `results.json` and `results.nc`, as `reports.judging.folder` writes them.
    root : leads from there to the folder of styles and scripts, that of the index of a suite; if empty they are written
        beside the page.

    Raises
    ------
    FileNotFoundError : if one of the two files is missing.
    """
    results = json.loads((folder / "results.json").read_text("utf-8"))
    row, settings = results["verdict"], results["settings"]
    with h5netcdf.File(folder / "results.nc", "r") as kept:
        exposure = float(np.asarray(kept.attrs["exposure"]).item())
        height, width, _ = kept.variables["image"].shape
        seen = row["verdict"] != "ABSENT" and height * width <= VIEWED_PIXELS
        # The viewer alone shows what variances say.
        names = [name for name in kept.variables if seen or not name.endswith("_variance")]
        read = {name: np.asarray(kept.variables[name][...]) for name in names}
    shutil.rmtree(folder / "pictures", ignore_errors=True)
    viewer.clear(folder)
    written: list[Future[None]] = []

    def picture(name: str, draw: Callable[..., np.ndarray], *arguments: Any, **options: Any) -> str:
        """The address of what `draw` makes of the rest, once a thread has: of large images that takes seconds."""
        path = Path("pictures") / f"{name.replace(' ', '-')}.png"
        written.append(pool.submit(lambda: pictures.save(folder / path, draw(*arguments, **options))))
        return quote(path.as_posix())

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        drawn = _drawn(picture, read, exposure)
    for each in written:
        each.result()  # or what went wrong
    viewed = _viewed(folder, row, settings, read, exposure) if seen else None
    index = folder / "index.html"
    render_page(
        page_environment(),
        "judge.html.j2",
        index,
        root=root,
        row=row,
        settings=settings,
        versions=results["versions"],
        drawn=drawn,
        viewed=viewed,
        viewable=VIEWED_PIXELS,
        beside="",  # its pixels are, whatever the root of styles
        words=WORDS,
        rule=verdict,
        downloads=[name for name in _LISTED if (folder / name).is_file()],
    )
    if not root:
        copy_static(folder)
    return index


def _drawn(picture: Callable[..., str], read: dict[str, np.ndarray], exposure: float) -> dict[str, Any]:
    """What the page shows of the images and maps: the addresses of pictures, and their scales."""
    ours, reference = read["image"], read["reference"]
    drawn: dict[str, Any] = {"height": ours.shape[0], "width": ours.shape[1]}
    drawn["reference"] = picture("reference", pictures.display, reference, exposure=exposure)
    shown = pictures.display(ours, exposure=exposure)
    drawn["ours"] = picture("ours", np.asarray, shown)
    picture("thumbnail", _reduced, shown, THUMBNAIL_SIDE)
    error, drawn["mean"] = pictures.relative_error(ours, reference)
    drawn["scale"] = pictures.error_scale([error])
    drawn["error"] = picture("error", pictures.diverge, error, scale=drawn["scale"])
    channels = pictures.channel_errors(ours, reference, drawn["mean"])
    drawn["end"] = pictures.error_scale([channels])
    colours = ("red", "green", "blue") if (channels != channels[..., :1]).any() else ()  # one picture says all of grey
    drawn["channels"] = [
        (name, picture(f"error {name}", pictures.diverge, channels[..., index], scale=drawn["end"]))
        for index, name in enumerate(colours)
    ]
    size = ours.shape[0], ours.shape[1]
    drawn["maps"] = p_maps(read, size, "tiles", lambda name, pixels: picture(name, np.asarray, pixels))
    return drawn


def _viewed(
    folder: Path, row: dict[str, Any], settings: dict[str, Any], read: dict[str, np.ndarray], exposure: float
) -> dict[str, Any] | None:
    """What the viewer knows of the pair, whose pixels are written for it: a scene of one cell and one limit."""
    one = {"cell_term": "image", "cell_variant": "ours", "own": 0}
    one["limit_name"] = f"{settings['reference_replicates']} replicates"
    variables = {name: values[None] for name, values in read.items()}
    variables |= {name: np.array([value]) for name, value in one.items()}
    written = viewer.write_data(folder, _Pair(row, settings), variables, exposure)
    return None if written is None else written | {"against": {"own": "reference"}}


def write_index(folder: Path, results: dict[str, Any]) -> Path:
    """Write the index of a suite, of what its `results.json` holds, with the styles and scripts of all its pages."""
    index = folder / "index.html"
    render_page(
        page_environment(),
        "suite.html.j2",
        index,
        root="",
        cases=results["cases"],
        unjudged=results.get("unjudged", []),
        settings=results["settings"],
        versions=results["versions"],
        words=WORDS,
        rule=verdict,
    )
    copy_static(folder)
    return index


@attrs.frozen(eq=False)
class _Pair:
    """A comparison as the viewer knows a scene."""

    verdict: dict[str, Any]
    settings: dict[str, Any]
    name: str = "images"

    def row(self, term: str, variant: str, against: str) -> dict[str, Any]:
        return self.verdict | {
            "replicates": self.settings["replicates"],
            "reference_replicates": self.settings["reference_replicates"],
        }


def notebook(judgement: Any) -> str:
    """What a notebook shows of a `Judgement`: ours, reference and error, the verdict, its words and the interval."""
    colour, sign = WORDS.get(str(judgement.verdict), ("none", "·"))
    ink, back = _COLOURS.get(colour, ("#474d56", "#e8eaec"))
    chip = Markup(
        '<span style="color:{};background:{};padding:0.1em 0.5em;border-radius:0.25em;font-weight:600">{} {}</span>'
    ).format(ink, back, sign, judgement.verdict)
    images = Markup("")
    if judgement.ours is not None and judgement.reference is not None:
        ours, reference = (np.asarray(each.mean) for each in (judgement.ours, judgement.reference))
        exposure = pictures.shown_at(reference)
        error, _ = pictures.relative_error(ours, reference)
        scale = pictures.error_scale([error])
        drawn = {
            "ours": pictures.display(ours, exposure=exposure),
            "reference": pictures.display(reference, exposure=exposure),
            f"error, ±{digits.percent(scale, signed=False)}": pictures.diverge(error, scale=scale),
        }
        images = Markup("").join(
            Markup(
                '<figure style="display:inline-block;margin:0 0.6em 0.4em 0"><img alt="{0}" src="data:image/png;base64,'
                '{1}" style="image-rendering:pixelated;max-width:16em;min-width:8em"><figcaption>{0}</figcaption>'
                "</figure>"
            ).format(name, _inline(_reduced(pixels, NOTEBOOK_SIDE)))
            for name, pixels in drawn.items()
        )
    bias = digits.interval(judgement.bias, judgement.bias_low, judgement.bias_high)
    said = Markup("").join(Markup("<br>hint: {}").format(hint.text) for hint in judgement.hints)
    return str(
        Markup("<div>{}<div>{} {}<br>bias {}, 90 % interval{}</div></div>").format(
            images, chip, escape(judgement.headline), bias, said
        )
    )


def _reduced(pixels: np.ndarray, side: int) -> np.ndarray:
    image = Image.fromarray(np.ascontiguousarray(pixels))
    image.thumbnail((side, side))
    return np.asarray(image)


def _inline(pixels: np.ndarray) -> str:
    stored = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(stored, format="PNG")
    return base64.b64encode(stored.getvalue()).decode("ascii")
