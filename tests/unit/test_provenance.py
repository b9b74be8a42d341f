"""Commands that make rows again, the table of all rows, and files that are no finished run."""

import csv
import io
import shlex

import h5netcdf
import pytest

from termwise.reports.results import provenance, table
from termwise.reports.results import schema as stored


def results(command):
    return {"settings": {"command": command}}


@pytest.mark.parametrize(
    ("typed", "row", "expected"),
    [
        ("termwise compare", {"scene": "monkey"}, "termwise compare monkey"),
        (
            "termwise compare --study standard --out out --json",
            {"scene": "monkey"},
            "termwise compare monkey --study standard",
        ),
        (
            "/bin/termwise compare monkey two_cubes --study=quick --seed 3 --quiet",
            {"scene": "two_cubes"},
            "termwise compare two_cubes --study quick --seed 3",
        ),
        (
            "termwise compare 'my scenes/hall.toml' monkey --estimators mine.py",
            {"scene": "hall"},
            "termwise compare 'my scenes/hall.toml' --estimators mine.py",
        ),
        # A scene of a study file, whose path the command does not hold.
        ("termwise compare --study mine.toml", {"scene": "hall"}, "termwise compare --study mine.toml"),
        (
            "termwise compare --study variants",
            {"scene": "monkey.no-shadow", "base": "monkey"},
            "termwise compare monkey --study variants",
        ),
        (
            "termwise compare --study variants",
            {"scene": "furnace 0.3", "group": "furnace"},
            "termwise compare --study variants",
        ),
        ("pytest -q", {"scene": "monkey"}, None),
        ("", {"scene": "monkey"}, None),
        ("termwise compare it's", {"scene": "monkey"}, None),
    ],
)
def test_the_command_of_a_row(typed, row, expected):
    assert provenance.command(results(typed), row) == expected


def test_a_command_goes_through_a_shell():
    typed = shlex.join(["termwise", "compare", "a b/hall.toml", "--study", "quick"])
    found = provenance.command(results(typed), {"scene": "hall"})
    assert found is not None
    assert shlex.split(found)[2] == "a b/hall.toml"


def test_the_table_is_rfc_4180(tmp_path):
    rows = [
        {"scene": 'the "blue", room', "rmse": 0.1, "sentence": "two\nlines", "at": {"gloss": 1.0, "bounces": 2}},
        {"scene": "hall", "rmse": None, "seconds": 2.5},
    ]
    path = tmp_path / "results.csv"
    table.write_csv(rows, path)
    text = path.read_bytes().decode("utf-8")
    # CRLF ends each record; the feed within a quoted field stays what it was.
    assert text.count("\r\n") == text.endswith("\r\n") + 2
    assert '"the ""blue"", room"' in text
    header, *read = csv.reader(io.StringIO(text, newline=""))
    assert {len(each) for each in read} == {len(header)}
    assert "rmse (radiance)" in header
    assert "seconds (s, all replicates)" in header
    first, second = (dict(zip(header, each, strict=True)) for each in read)
    assert first["scene"] == 'the "blue", room'
    assert first["sentence"] == "two\nlines"
    assert first["at"] == "gloss = 1.0; bounces = 2"
    assert float(first["rmse (radiance)"]) == 0.1
    assert second["rmse (radiance)"] == ""


def test_images_that_are_cut_short_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"results\.nc: no such file"):
        stored.check_images(tmp_path)
    with h5netcdf.File(tmp_path / "results.nc", "w") as file:
        file.dimensions = {"x": 1000}
        file.create_variable("image", ("x",), float)[:] = 1.0
    stored.check_images(tmp_path)
    whole = (tmp_path / "results.nc").read_bytes()
    for content in (whole[:-1], whole[: len(whole) // 2], b"", b"this is no NetCDF"):
        (tmp_path / "results.nc").write_bytes(content)
        with pytest.raises(ValueError, match=r"results\.nc: is cut short or no NetCDF"):
            stored.check_images(tmp_path)


def test_every_cut_of_a_file_is_refused(tmp_path):
    whole = '{"schema": 1, "versions": {}, "settings": {"seed": 1}, "cells": [], "failed": null}'
    (tmp_path / "results.json").write_text(whole)
    assert stored.read(tmp_path) == stored.read(tmp_path / "results.json")
    for length in range(len(whole)):
        (tmp_path / "results.json").write_text(whole[:length])
        with pytest.raises(ValueError, match=r"results\.json: is cut short"):
            stored.read(tmp_path)
    (tmp_path / "results.json").write_bytes(b"\xff\xfe{}")
    with pytest.raises(ValueError, match="is no text"):
        stored.read(tmp_path)
