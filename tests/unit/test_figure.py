"""Charts for print: their size, embedded fonts and vectors, what they draw, and what they refuse."""

import itertools
import re
import xml.etree.ElementTree as ElementTree
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes

from termwise.reports.pages import figure

SAMPLES = [1, 2, 4, 8]


def rows_of(variant, level, *, scene="room", term="direct"):
    """Rows that converge as `0.01² + level² / N`, one second a sample, and the split of the last."""
    for samples in SAMPLES:
        rmse = float(np.sqrt(1e-4 + level**2 / samples))
        last = samples == SAMPLES[-1]
        yield {
            "scene": scene, "term": term, "variant": variant, "against": "own", "samples": samples, "replicates": 16,
            "seconds": 16.0 * samples, "rmse": rmse, "rmse_low": 0.95 * rmse, "rmse_high": 1.05 * rmse,
            "slope": 1.0 if last else None, "floor": 1e-4 if last else None, "split": None,
        }  # fmt: skip
    split = {"model_gap": 4.0, "cross": -1.0, "bias": 0.5, "variance": 2.0, "total": 5.5}
    yield {
        "scene": scene, "term": term, "variant": variant, "against": "physical", "samples": 8, "replicates": 16,
        "seconds": 128.0, "rmse": 0.1, "rmse_low": None, "rmse_high": None, "slope": None, "floor": None,
        "split": {name: [value, value - 0.1, value + 0.2] for name, value in split.items()},
    }  # fmt: skip


CELLS = [*rows_of("path", 0.2), *rows_of("paper", 0.3)]


@pytest.mark.parametrize("kind", ["convergence", "waterfall"])
def test_files_are_of_column_width_with_their_fonts(kind, tmp_path):
    for suffix in figure.FORMATS:
        for name in ("a", "b"):
            path = tmp_path / f"{name}{suffix}"
            figure.write({"cells": CELLS}, scene="room", term="direct", kind=kind, path=path)
        assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()
    svg = ElementTree.parse(tmp_path / "a.svg").getroot()
    width = float(svg.attrib["width"].removesuffix("pt"))
    assert width / 72 * 25.4 == pytest.approx(85.0, abs=0.01)
    tags = {element.tag.split("}")[1] for element in svg.iter()}
    # Outlines in place of text, and nothing of pixels.
    assert "path" in tags
    assert not tags & {"text", "image"}
    pdf = (tmp_path / "a.pdf").read_bytes()
    (box,) = re.findall(rb"/MediaBox \[ 0 0 ([\d.]+)", pdf)
    assert float(box) / 72 * 25.4 == pytest.approx(85.0, abs=0.01)
    assert pdf.count(b"/FontFile2") >= 1
    assert b"/Type3" not in pdf
    assert b"/Subtype /Image" not in pdf


def lines_of(panel: Axes, *, dense: bool) -> list[tuple[np.ndarray, np.ndarray]]:
    """x and y of each fitted curve, or of each series of marks."""
    found = []
    for line in panel.lines:
        x, y = (np.asarray(values, float) for values in (line.get_xdata(), line.get_ydata()))
        if len(x) > len(SAMPLES) if dense else len(x) and line.get_linestyle() == "None":
            found.append((x, y))
    return found


def test_convergence_draws_every_variant_against_samples_and_seconds():
    """One sample takes one second here, so both panels hold the same points."""
    drawn = figure.convergence(CELLS, "room: direct")
    for panel in drawn.axes:
        marked, fits = lines_of(panel, dense=False), lines_of(panel, dense=True)
        assert len(marked) == len(fits) == 2
        for level, (x, y), (dense, fit) in zip((0.2, 0.3), marked, fits, strict=True):
            assert x.tolist() == SAMPLES
            np.testing.assert_allclose(y, np.sqrt(1e-4 + level**2 / x))
            np.testing.assert_allclose(fit, np.sqrt(1e-4 + level**2 / dense), rtol=1e-9)
    (legend,) = drawn.legends
    assert [text.get_text() for text in legend.get_texts()] == [
        "path ($a$ = 1.00)",
        "paper ($a$ = 1.00)",
        r"$1/\sqrt{N}$",
    ]


@pytest.mark.parametrize(
    "seconds", [(1.2e-3, 7.9e-3), (0.004, 0.7), (31, 131), (1e-3, 1200), (0.011, 0.018), (7e-5, 8)]
)
def test_numbers_of_the_axes_do_not_overlap(seconds):
    """Drawn at its size, no label touches another; before, 2 × 10⁻³ and 3 × 10⁻³ stood in each other."""
    rows = [row for variant in ("path", "photon-map") for row in rows_of(variant, 0.3)][:-1]
    for row in rows:
        share = np.log2(row["samples"]) / np.log2(SAMPLES[-1])
        row["seconds"] = row["replicates"] * seconds[0] * (seconds[1] / seconds[0]) ** share
    drawn = figure.convergence(rows, "room: direct")
    drawn.draw_without_rendering()
    for panel in drawn.axes:
        for axis, ends in ((panel.xaxis, ("x0", "x1")), (panel.yaxis, ("y0", "y1"))):
            shown = [label for label in axis.get_ticklabels(which="both") if label.get_visible() and label.get_text()]
            low, high = axis.get_view_interval()
            inside = [each for each in axis.get_majorticklocs() if low <= each <= high]
            assert len(inside) >= 2
            boxes = sorted((getattr(b, ends[0]), getattr(b, ends[1])) for b in (t.get_window_extent() for t in shown))
            assert all(end < start for (_, end), (start, _) in itertools.pairwise(boxes))


def test_series_differ_in_more_than_colour():
    drawn = figure.convergence(CELLS, "room: direct")
    lines = drawn.axes[0].lines
    marks = {str(line.get_marker()) for line in lines} - {"None"}
    dashes = {str(line.get_linestyle()) for line in lines if line.get_color() != "0.5"} - {"None"}
    assert len(marks) == len(dashes) == 2


def test_waterfall_stands_one_part_upon_the_other():
    (panel,) = figure.waterfall(CELLS, "room: direct").axes
    drawn: list[Any] = list(panel.patches)
    bars = [(bar.get_y(), bar.get_y() + bar.get_height()) for bar in drawn]
    np.testing.assert_allclose(bars, [(0, 4), (4, 3), (3, 3.5), (3.5, 5.5), (0, 5.5)])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"scene": "hall"}, ["scene = 'hall'", "room"]),
        ({"term": "glow"}, ["term = 'glow'", "direct"]),
        ({"path": "a.png"}, ["a.png", ".pdf or .svg"]),
        ({"cells": CELLS[4:5], "kind": "convergence"}, ["room: direct", "two sample counts"]),
        ({"cells": CELLS[:4], "kind": "waterfall"}, ["room: direct", "no split"]),
    ],
)
def test_what_cannot_be_drawn(changes, words, tmp_path):
    wanted = {"scene": "room", "term": "direct", "kind": "convergence", "cells": CELLS, "path": "a.svg"} | changes
    path = tmp_path / wanted.pop("path")
    with pytest.raises(ValueError, match="allowed") as error:
        figure.write({"cells": wanted.pop("cells")}, path=path, **wanted)
    assert all(word in str(error.value) for word in words)
    assert not path.exists()
