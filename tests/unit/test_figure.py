"""Charts for print: their size, embedded fonts and vectors, what they draw, and what they refuse."""

import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from reports import figure

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


def test_convergence_draws_every_variant_against_samples_and_seconds():
    drawn = figure.convergence(CELLS, "room: direct")
    samples, seconds = drawn.axes
    for panel, scale in ((samples, 1.0), (seconds, 1.0)):
        marked = [line for line in panel.lines if line.get_linestyle() == "None" and len(line.get_xdata())]
        assert len(marked) == 2
        for line, level in zip(marked, (0.2, 0.3), strict=True):
            np.testing.assert_allclose(line.get_xdata(), scale * np.array(SAMPLES))
            np.testing.assert_allclose(line.get_ydata(), np.sqrt(1e-4 + level**2 / np.array(SAMPLES)))
        curves = [line for line in panel.lines if len(line.get_xdata()) > len(SAMPLES)]
        for line, level in zip(curves, (0.2, 0.3), strict=True):
            np.testing.assert_allclose(
                line.get_ydata(), np.sqrt(1e-4 + level**2 / line.get_xdata()), rtol=1e-9
            )
    (legend,) = drawn.legends
    assert [text.get_text() for text in legend.get_texts()] == [
        "path ($a$ = 1.00)",
        "paper ($a$ = 1.00)",
        r"$1/\sqrt{N}$",
    ]


def test_series_differ_in_more_than_colour():
    drawn = figure.convergence(CELLS, "room: direct")
    marks = {line.get_marker() for line in drawn.axes[0].lines if line.get_marker() != "None"}
    dashes = {line.get_linestyle() for line in drawn.axes[0].lines if len(line.get_xdata()) > len(SAMPLES)}
    assert len(marks) == len(dashes) == 2


def test_waterfall_stands_one_part_upon_the_other():
    (panel,) = figure.waterfall(CELLS, "room: direct").axes
    bars = [(bar.get_y(), bar.get_y() + bar.get_height()) for bar in panel.patches]
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
    wanted = {
        "scene": "room",
        "term": "direct",
        "kind": "convergence",
        "cells": CELLS,
        "path": "a.svg",
    } | changes
    path = tmp_path / wanted.pop("path")
    with pytest.raises(ValueError, match="allowed") as error:
        figure.write({"cells": wanted.pop("cells")}, path=path, **wanted)
    assert all(word in str(error.value) for word in words)
    assert not path.exists()
