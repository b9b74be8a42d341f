"""Charts for print: convergence and waterfall of a term on a scene, as PDF or SVG, from `results.json` alone.

Chosen for a column of a paper, and why:

- 85 mm wide, the column of SIGGRAPH, EGSR and JCGT layouts, so that 8 pt stays 8 pt; scaled figures have odd type.
- STIX, Times' metrics with mathematics, as these papers are set. PDF embeds it as TrueType (42, not 3: some publishers
  refuse type 3); SVG has outlines in its place, which look the same wherever they are opened.
- Vectors throughout. Okabe and Ito's colours from dark to light, and a mark, a dash, a shade or a hatch of its own for
  each series: the figure says the same in grey and to colour-blind eyes.
- No title: the caption says what it is. Axes carry units. The same input gives the same bytes.
"""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedFormatter, FixedLocator, MaxNLocator, NullFormatter, NullLocator, ScalarFormatter

from termwise.reports.pages.charts import PARTS, fitted_curve
from termwise.scenes.store import write_atomically

WIDTH_MM = 85.0
FORMATS = ".pdf", ".svg"
Kind = Literal["convergence", "waterfall"]

_COLOURS = ("#000000", "#D55E00", "#0072B2", "#009E73", "#E69F00")
_MARKS = "osD^v"
_DASHES = ("-", "--", "-.", (0, (1, 1)), (0, (5, 1, 1, 1, 1, 1)))
_HATCHES = ("", "////", "", "....", "")
_TICKS_ALONG, _TICKS_UP = 3, 6
"""So many numbers have room on an axis of 30 mm, and beside one of 40 mm."""
_STYLE: dict[Any, Any] = {
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 8.0,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "hatch.linewidth": 0.5,
    "pdf.fonttype": 42,
    "svg.fonttype": "path",
    "svg.hashsalt": "termwise",
}


def write(results: dict[str, Any], *, scene: str, term: str, kind: Kind, path: Path) -> None:
    """Write a chart; it appears whole or not at all.

    Parameters
    ----------
    results : of `reports.results.schema.read`.
    scene, term : of the rows.
    kind : "convergence": RMSE of one replicate (radiance) against samples a pixel and seconds, with 90 % bands and the
        fit `MSE = b² + c N^-a` of each variant; "waterfall": the parts of the mean square error (radiance²) of the
        default variant against full light transport, with 90 % intervals.
    path : ends in .pdf or .svg.

    Raises
    ------
    ValueError : Another ending, no such scene or term in the run, or nothing to draw; the message lists what is
        allowed.
    """
    if path.suffix not in FORMATS:
        raise ValueError(f"{path}: allowed is a name that ends in {' or '.join(FORMATS)}")
    draw = _DRAWN[kind]
    with matplotlib.rc_context(_STYLE):
        figure = draw(_rows(results["cells"], scene, term), f"{scene}: {term}")
        content = io.BytesIO()
        # No date, so that the bytes are those of the results.
        date = {"CreationDate": None} if path.suffix == ".pdf" else {"Date": None}
        about = {"Title": f"{scene}: {term}, {kind}", "Creator": "termwise"}
        figure.savefig(content, format=path.suffix[1:], metadata=about | date)
    write_atomically(path, lambda temporary: temporary.write_bytes(content.getvalue()))


def _rows(cells: list[dict[str, Any]], scene: str, term: str) -> list[dict[str, Any]]:
    for name, wanted in (("scene", scene), ("term", term)):
        known = list(dict.fromkeys(row[name] for row in cells))
        if wanted not in known:
            raise ValueError(f"{name} = {wanted!r}: allowed are {', '.join(known)}")
    return [row for row in cells if (row["scene"], row["term"]) == (scene, term)]


def _canvas(height_mm: float, columns: int = 1) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(WIDTH_MM / 25.4, height_mm / 25.4), layout="constrained")
    axes = figure.subplots(1, columns, sharey=True, squeeze=False)
    return figure, list(axes[0])


def convergence(rows: list[dict[str, Any]], what: str) -> Figure:
    """RMSE against samples and against seconds, both of one replicate; dotted: 1/√N."""
    curves: dict[str, list[dict[str, Any]]] = {}
    for row in sorted(rows, key=lambda row: row["samples"]):
        if row["against"] == "own" and row["rmse"]:
            curves.setdefault(row["variant"], []).append(row)
    curves = {name: found for name, found in curves.items() if len(found) > 1}
    if not curves:
        raise ValueError(f"{what}: no variant has an error at two sample counts: allowed are terms that converge")
    figure, panels = _canvas(62.0, 2)
    for index, (name, found) in enumerate(curves.items()):
        colour, mark, dash = (each[index % len(each)] for each in (_COLOURS, _MARKS, _DASHES))
        samples = np.array([row["samples"] for row in found], float)
        rmse = np.array([row["rmse"] for row in found])
        seconds = np.array([row["seconds"] / row["replicates"] for row in found])
        banded = [row for row in found if row["rmse_low"] and row["rmse_high"]]
        fit = fitted_curve(found, samples, rmse)
        label = name if found[-1]["slope"] is None else f"{name} ($a$ = {found[-1]['slope']:.2f})"
        for panel, x in zip(panels, (samples, seconds), strict=True):
            if len(banded) == len(found):
                low, high = ([row[end] for row in found] for end in ("rmse_low", "rmse_high"))
                panel.fill_between(x, low, high, color=colour, alpha=0.2, linewidth=0)
            # A fit in samples: where the axis is time, samples are placed between the measured times.
            dense, line = (samples, rmse) if fit is None else fit
            along = np.exp(np.interp(np.log(dense), np.log(samples), np.log(x)))
            panel.plot(along, line, color=colour, linestyle=dash, linewidth=0.9)
            panel.plot(x, rmse, mark, color=colour, markersize=3.4, markerfacecolor="white", markeredgewidth=0.8)
        panels[0].plot(
            [], [], marker=mark, color=colour, linestyle=dash, linewidth=0.9, markersize=3.4,
            markerfacecolor="white", markeredgewidth=0.8, label=label,
        )  # fmt: skip
        if index == 0:
            for panel, x in zip(panels, (samples, seconds), strict=True):
                ends = np.array([x[0], x[-1]])
                guide = panel.plot(ends, rmse[0] * np.sqrt(ends[0] / ends), ":", color="0.5", linewidth=0.9)
            guide[0].set_label(r"$1/\sqrt{N}$")
    for panel, label in zip(panels, ("samples per pixel $N$", "seconds"), strict=True):
        panel.set(xscale="log", yscale="log", xlabel=label)
    panels[0].set_ylabel("RMSE of one replicate (radiance)")
    for axis, most in ((panels[0].yaxis, _TICKS_UP), (panels[1].xaxis, _TICKS_ALONG)):
        low, high = sorted(axis.get_view_interval())
        found = ticks(low, high, most)
        axis.set_major_locator(FixedLocator(found))
        axis.set_major_formatter(FixedFormatter(_written(found)))
        axis.set_minor_formatter(NullFormatter())
    panels[1].yaxis.set_minor_formatter(NullFormatter())
    every = sorted({row["samples"] for found in curves.values() for row in found})
    panels[0].xaxis.set_major_locator(FixedLocator(every[:: -(-len(every) // 5)]))
    panels[0].xaxis.set_major_formatter(ScalarFormatter())
    panels[0].xaxis.set_minor_locator(NullLocator())
    handles, labels = (sum(found, []) for found in zip(*(p.get_legend_handles_labels() for p in panels), strict=True))
    figure.legend(handles, labels, loc="outside upper center", ncols=2, columnspacing=1.2, handlelength=2.4)
    return figure


def ticks(low: float, high: float, most: int) -> list[float]:
    """Two to `most` places on a logarithmic axis: 1, 2 and 5 times the powers of ten, else as many of them as fit.

    Where the axis is too short for two of them, places at equal distances.
    """
    first, last = (int(np.floor(np.log10(end))) for end in (low, high))
    for steps, stride in ((1, 2, 5), 1), ((1, 3), 1), *(((1,), stride) for stride in range(1, last - first + 2)):
        powers = (power for power in range(first, last + 1) if power % stride == 0)
        found = [each for power in powers for step in steps if low <= (each := float(f"{step}e{power}")) <= high]
        if 2 <= len(found) <= most:
            return found
    even = MaxNLocator(most, steps=[1, 2, 5, 10], min_n_ticks=2).tick_values(low, high)
    found = [float(f"{each:.6g}") for each in even if low <= each <= high]
    return found[:: -(-len(found) // most)]


def _written(values: list[float]) -> list[str]:
    """All of them as numbers that are easily read, or as multiples of powers of ten."""
    if all(1e-3 <= value < 1e4 for value in values):
        return [f"{value:g}" for value in values]
    parts = [f"{value:.6e}".split("e") for value in values]
    factors = ["" if float(factor) == 1 else rf"{float(factor):g} \times " for factor, _ in parts]
    return [f"${factor}10^{{{int(power)}}}$" for factor, (_, power) in zip(factors, parts, strict=True)]


def waterfall(rows: list[dict[str, Any]], what: str) -> Figure:
    """Model gap, its signed product with the bias, bias and variance, one upon the other, and their sum."""
    split = next((row["split"] for row in rows if row["against"] == "physical" and row.get("split")), None)
    if split is None:
        raise ValueError(
            f"{what}: no split of the error: allowed are terms that a study measures against full light transport"
        )
    value, low, high = (np.array([split[name][k] for name, _ in PARTS]) for k in range(3))
    base = np.concatenate([[0.0], np.cumsum(value[:-2]), [0.0]])
    figure, (panel,) = _canvas(52.0)
    bars = panel.bar(range(len(PARTS)), value, bottom=base, width=0.62, linewidth=0.6, edgecolor="black")
    shades = ("0.75", "white", "0.35", "white", "0.9")
    for bar, shade, hatch in zip(bars, shades, _HATCHES, strict=True):
        bar.set(facecolor=shade, hatch=hatch)
    panel.errorbar(
        range(len(PARTS)), base + value, yerr=[value - low, high - value], fmt="none", color="#D55E00",
        linewidth=0.9, capsize=2.0, capthick=0.9,
    )  # fmt: skip
    tops = (base + value)[:-1]
    for place, top in enumerate(tops):
        panel.plot([place + 0.31, place + 0.69], [top, top], color="0.4", linewidth=0.5)
    panel.axhline(0.0, color="black", linewidth=0.6)
    # STIX has the raised 2 of a text in bold alone.
    labels = [label.replace("²", "$^2$") for _, label in PARTS]
    panel.set_xticks(range(len(PARTS)), labels)
    panel.tick_params(axis="x", length=0)
    panel.set_ylabel("mean square error (radiance$^2$)")
    panel.ticklabel_format(axis="y", style="sci", scilimits=(-2, 3), useMathText=True)
    return figure


_DRAWN: dict[Kind, Callable[[list[dict[str, Any]], str], Figure]] = {"convergence": convergence, "waterfall": waterfall}
