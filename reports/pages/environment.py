"""What all pages share: templates and their filters, style and scripts, the colour and sign of each verdict."""

import re
import shutil
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import jinja2
import numpy as np
import plotly.offline
from markupsafe import Markup, escape

from termwise.reports.pages import charts, digits, pictures
from termwise.reports.pages.mathml import mathml
from termwise.reports.statistics import tiles
from termwise.reports.statistics.replicates import TILE_SIDES
from termwise.scenes.store import write_atomically

_HERE = Path(__file__).parent
T = TypeVar("T")

WORDS = {
    "BIASED": ("bad", "✕"),
    "NOT AS PREDICTED": ("bad", "✕"),
    "NO VERDICT": ("bad", "!"),
    "UNDERPOWERED": ("open", "?"),
    "EQUIVALENT": ("good", "✓"),
    "AS PREDICTED": ("good", "✓"),
    "ABSENT": ("none", "○"),
    "NOT JUDGED": ("none", "·"),
}
"""Each verdict's colour class and sign, the gravest first; the word itself always stands beside them."""


def p_maps(
    cell: Mapping[Any, Any], size: tuple[int, int], name: str, picture: Callable[[str, np.ndarray], str]
) -> dict[int, dict[str, Any]]:
    """Addresses and sizes of the maps of a cell's tiles by their side, drawn by `picture`; none for merged sizes.

    `cell` has the variables of `results.nc` by name, `size` is the image's height and width.
    """
    drawn = {}
    for side in TILE_SIDES:
        names = {each: f"tile_{each}_{side}" for each in tiles.MAPS}
        maps = {each: np.asarray(cell[variable]) for each, variable in names.items() if variable in cell}
        if maps and np.isfinite(maps["p"]).any():
            pixels = pictures.p_map(**maps, side=side, size=size)
            address = picture(f"{name} p-map {side}", pixels)
            drawn[side] = {"address": address, "height": pixels.shape[0], "width": pixels.shape[1]}
    return drawn


def grouped(items: Iterable[T], key: Callable[[T], Any]) -> dict[Any, list[T]]:
    """Items by their key, both in the order in which they come."""
    found: dict[Any, list[T]] = {}
    for item in items:
        found.setdefault(key(item), []).append(item)
    return found


def word(row: dict[str, Any] | None) -> str:
    """The verdict of a row, or that none is due."""
    return (row or {}).get("verdict") or "NOT JUDGED"


def sentence(row: dict[str, Any]) -> str:
    """The row's sentence without the verdict that it opens with, which stands beside it."""
    text = (row["sentence"] or "").removeprefix(f"{row['verdict']}: ")
    text = re.sub(r"(?<!\w)-(?=\d)", digits.MINUS, text)
    return text[:1].upper() + text[1:]


def short(row: dict[str, Any]) -> str:
    """The row's verdict in plain words; its whole sentence where an earlier version's run has no others."""
    text = row.get("headline")
    if not text:
        return sentence(row)
    text = re.sub(r"(?<!\w)-(?=\d)", digits.MINUS, text)
    return f"{text[:1].upper()}{text[1:]}."


def slug(text: str) -> str:
    """A name that an address can hold."""
    return re.sub(r"[^a-z0-9.]+", "-", text.lower()).strip("-")


def page_environment() -> jinja2.Environment:
    """The templates, with the filters that all of them share."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_HERE / "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {}  # not sorted: terms and references have an order
    for name in (
        "percent",
        "margin",
        "interval",
        "two_digits",
        "plus_minus",
        "number",
        "similarity",
        "duration",
        "setting",
    ):
        environment.filters[name] = getattr(digits, name)
    environment.filters["math"] = mathml
    environment.filters["equation"] = lambda latex: mathml(latex, block=True)
    environment.filters["slug"] = slug
    environment.filters["word"] = word
    environment.filters["breakable"] = lambda name: escape(name).replace("_", Markup("_<wbr>"))
    environment.filters["sentence"] = sentence
    environment.filters["short"] = short
    environment.filters["digest"] = lambda text: re.sub(r"\b([0-9a-f]{12})[0-9a-f]{52}\b", r"\1…", text)
    environment.globals["bar"] = _bar()
    environment.globals["p_histograms"] = charts.p_histograms
    environment.globals["tile_rule"] = tiles
    return environment


def _bar() -> str:
    """The diverging scale as a CSS gradient."""
    colours = pictures.diverge(np.linspace(-1.0, 1.0, 21), scale=1.0)
    return "linear-gradient(to right, " + ", ".join(f"rgb({r} {g} {b})" for r, g, b in colours.tolist()) + ")"


def render_page(environment: jinja2.Environment, template: str, path: Path, **values: Any) -> None:
    """Write a page."""
    text = environment.get_template(template).render(**values)
    write_atomically(path, lambda temporary: temporary.write_text(text, "utf-8"))


def copy_static(run: Path, *, charts: bool = True) -> None:
    """Style and scripts, shared by all pages; plotly's only where there are charts."""
    for path in sorted((_HERE / "static").iterdir()):
        write_atomically(run / path.name, lambda temporary, path=path: shutil.copyfile(path, temporary))
    if not charts:
        return
    script = run / "plotly.min.js"
    write_atomically(script, lambda temporary: temporary.write_text(plotly.offline.get_plotlyjs(), "utf-8"))
