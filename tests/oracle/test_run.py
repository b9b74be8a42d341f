"""A whole run, small: what `termwise compare` measures, keeps, writes and says, from a scene file to exit status."""

import contextlib
import io
import json
import math
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import attrs
import numpy as np
import OpenEXR
import pytest
import xarray

from termwise import reference
from termwise.renderer import Engine
from termwise.reports import cli, run
from termwise.reports.jobs import cells
from termwise.reports.results.exr import read_exr
from termwise.reports.study import study, subjects
from termwise.scenes.store import ROOT, cache_folder
from termwise.scenes.terms import TERMS
from tests.scenes import FLOOR

# Every term but background, which is absent; a floor under a lamp, half of it out of the picture.
SCENE = "max_bounces = 1\n" + FLOOR.replace("[0, 6, 0]]", "[0, 6, 0]]\ngloss = 0.3\nf0 = [0.9, 0.8, 0.7]")

STUDY = """
scenes = ["SCENE"]
resolution = [12, 9]
replicates = 4
reference_replicates = 4
reference_spp = 4
physical_spp = 2
photons = 200

[samples]
ambient = 2
direct = 2
specular = 2
transmission = 2
background = 2
"""

# Issue A, part 4: what every row of `results.json` has at least.
KEYS = (
    "scene term variant scope against samples replicates seconds rmse relmse ssim bias bias_low bias_high "
    "standard_error margin allowance tests family_low family_high rms_bias rms_bias_high place predicted_bias "
    "detectable_bias samples_to_margin seconds_to_margin verdict"
).split()


class Finished(NamedTuple):
    """Exit status, standard output and error of `termwise compare ... --json`, its folder, and what was computed."""

    status: Any
    output: str
    messages: str
    folder: Path
    computed: int
    rendered: int


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `scene.toml` and `study.toml`."""
    folder = tmp_path_factory.mktemp("run")
    (folder / "scene.toml").write_text(SCENE)
    (folder / "study.toml").write_text(STUDY.replace("SCENE", str(folder / "scene.toml")))
    return folder


@pytest.fixture(scope="module")
def patched() -> Iterator[pytest.MonkeyPatch]:
    with pytest.MonkeyPatch.context() as patch:
        yield patch


@pytest.fixture(scope="module")
def compare(files: Path, patched: pytest.MonkeyPatch) -> Callable[..., Finished]:
    """A function: `termwise compare --study ...` in this process, its replicates in a cache that starts empty."""
    patched.setattr(run, "cache_folder", lambda: files / "cache")
    counts = {"computed": 0, "rendered": 0}
    prefixes, replicate_parts = Engine.prefixes, reference.replicate_parts

    def counted_prefixes(self: Any, *arguments: Any, **settings: Any) -> Any:
        counts["computed"] += 1
        return prefixes(self, *arguments, **settings)

    def counted_parts(*arguments: Any, **settings: Any) -> Any:
        counts["rendered"] += 1
        return replicate_parts(*arguments, **settings)

    patched.setattr(Engine, "prefixes", counted_prefixes)
    patched.setattr(reference, "replicate_parts", counted_parts)

    def command(*arguments: str, out: str = "out", study_file: str = "study.toml") -> Finished:
        counts.update(computed=0, rendered=0)
        argv = ["termwise", "compare", "--study", str(files / study_file), "--out", str(files / out), *arguments]
        output, messages = io.StringIO(), io.StringIO()
        patched.setattr("sys.argv", argv)
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(messages):
            with pytest.raises(SystemExit) as ended:
                cli.main()
        folder = files / out / "compare"
        return Finished(ended.value.code, output.getvalue(), messages.getvalue(), folder, **counts)

    return command


@pytest.fixture(scope="module")
def first(compare: Callable[..., Finished]) -> Finished:
    """The run that finds nothing."""
    return compare("--json")


@pytest.fixture(scope="module")
def results(first: Finished) -> dict[str, Any]:
    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    return json.loads((first.folder / "results.json").read_text("utf-8"), parse_constant=refuse)


@pytest.mark.slow
def test_one_object_on_standard_output(first: Finished, results: dict[str, Any]):
    assert first.status in (0, 1)  # so few samples may be wrong by chance; the status is tested below
    assert json.loads(first.output) == results
    assert first.messages == ""


def test_every_row_has_every_key(results: dict[str, Any]):
    assert results["schema"] == 1
    assert set(results) == {"schema", "versions", "settings", "failed", "cells", "extrapolations", "audits"}
    for row in results["cells"]:
        assert [key for key in KEYS if key not in row] == []


def test_rows_are_those_of_the_study(results: dict[str, Any]):
    """Prefixes 1 and 2 of each variant against own, its last against correct, the default against physical; the sum."""
    found = [(r["term"], r["variant"], r["against"], r["samples"]) for r in results["cells"]]
    expected = [("total", "default", against, 2) for against in ("own", "physical")]
    for term in TERMS:
        names = getattr(study.Variants(), term)
        expected += [(term, name, "own", samples) for name in names for samples in (1, 2)]
        expected += [(term, name, "correct", 2) for name in names]
        expected += [(term, names[0], "physical", 2)]
    assert sorted(found) == sorted(expected)


def test_verdicts_are_due_against_own_at_the_largest_count(results: dict[str, Any]):
    unjudged = {("direct", "paper")}  # it has no limit to be judged against
    for row in results["cells"]:
        due = row["against"] == "own" and row["samples"] == 2 and (row["term"], row["variant"]) not in unjudged
        assert (row["verdict"] is not None) == due, row
        measured = due and row["verdict"] != "ABSENT"
        for key in ("tests", "family_low", "family_high", "detectable_bias"):
            assert (row[key] is not None) == measured, (key, row)


def test_the_error_against_light_transport_is_split(results: dict[str, Any]):
    """Four parts that add up, and a sum that is the row's own mean square error; a plane reflects nothing."""
    split = [row for row in results["cells"] if row["split"]]
    assert {(row["term"], row["against"]) for row in split} == {("ambient", "physical"), ("direct", "physical")}
    for row in split:
        total = row["split"]["total"][0]
        parts = [row["split"][name][0] for name in ("model_gap", "cross", "bias", "variance")]
        assert sum(parts) == pytest.approx(total, rel=1e-9)
        assert total == pytest.approx(row["rmse"] ** 2, rel=1e-6)
        assert all(low <= value <= high for value, low, high in row["split"].values())
        # Sums are of float64: what is rounded is the image that is kept.
        assert abs(row["split"]["float_error"][0]) < (2.0**-24) ** 2


def test_the_level_counts_the_tests_of_all_judged_rows(results: dict[str, Any]):
    """Of a judged row: 3 channels of the image and each object; 3 shapes and 3 kinds of place unless kernel-based."""
    judged = [row for row in results["cells"] if row["tests"] is not None]
    kernel = {"direct", "total"}  # scope `all`: scattered light comes from photons
    tests = 0
    for row in judged:
        objects = {region["region"] for region in row["objects"]}
        is_kernel = row["term"] in kernel and row["variant"] in ("default", "next-event")
        tests += 3 * (1 + len(objects)) + (0 if is_kernel else 6)
    assert {row["tests"] for row in judged} == {tests}
    assert results["settings"]["tests"] == tests


def test_an_allowance_is_for_the_light_of_photons_alone(results: dict[str, Any]):
    """A plane throws no light on itself: of 1 % of the scattered light next to nothing is left."""
    of_photons = ("next-event", "own"), ("default", "own")
    judged = [row for row in results["cells"] if row["verdict"] is not None]
    kernel = [row for row in judged if (row["variant"], row["against"]) in of_photons]
    assert len(kernel) == 2
    assert all(0 <= row["allowance"] < 1e-3 for row in kernel)


def test_absent_names_its_reason(results: dict[str, Any]):
    (row,) = (row for row in results["cells"] if row["term"] == "background" and row["verdict"])
    assert row["verdict"] == "ABSENT"
    assert row["reasons"] == ["the sky is black and lights are not drawn"]
    assert row["reasons"][0] in row["sentence"]
    assert row["headline"] == f"black on both sides: {row['reasons'][0]}"


def test_paper_rows_predict_their_factors(results: dict[str, Any]):
    against = {(r["term"], r["variant"]): r for r in results["cells"] if r["against"] == "correct"}
    assert against["ambient", "paper"]["predicted_bias"] == pytest.approx(np.pi - 1)
    assert against["specular", "paper"]["predicted_bias"] == pytest.approx(4 / np.pi - 1)


def test_bias_is_that_of_the_images(first: Finished, results: dict[str, Any]):
    """Signed, of the luminance, relative to the reference's mean, from the means in `results.nc`."""
    weights = np.array([0.2126, 0.7152, 0.0722])
    rows = {(r["term"], r["variant"]): r for r in results["cells"] if r["against"] == "own" and r["samples"] == 2}
    with xarray.open_dataset(first.folder / "results.nc", group="scene", engine="h5netcdf") as group:
        for index in range(group.sizes["cell"]):
            row = rows[str(group.cell_term[index].item()), str(group.cell_variant[index].item())]
            pair = group.image[index], group.reference[int(group.own[index])]
            ours, reference = (float(np.mean(each.values, axis=(0, 1), dtype=float) @ weights) for each in pair)
            if reference:
                assert row["bias"] == pytest.approx(ours / reference - 1, abs=1e-5)


def test_judged_rows_have_tiles_and_their_maps(first: Finished, results: dict[str, Any]):
    """12 x 9 px: 2 x 2 tiles of 8 px, one of 16 and of 32; the summary counts what the maps in `results.nc` hold."""
    judged = {
        (row["term"], row["variant"]): row["tiles"]
        for row in results["cells"]
        if row["verdict"] not in (None, "ABSENT")
    }
    assert all(not row["tiles"] for row in results["cells"] if row["verdict"] in (None, "ABSENT"))
    with xarray.open_dataset(first.folder / "results.nc", group="scene", engine="h5netcdf") as group:
        for index in range(group.sizes["cell"]):
            sizes = judged.get((str(group.cell_term[index].item()), str(group.cell_variant[index].item())))
            for side, shape in ((8, (2, 2)), (16, (1, 1)), (32, (1, 1))):
                p, holm = (group[f"tile_{name}_{side}"][index].values for name in ("p", "holm"))
                assert p.shape == shape
                if sizes is None:
                    assert np.isnan(p).all()
                    continue
                (size,) = (each for each in sizes if each["side"] == side)
                assert size["tiles"] == p.size
                assert size["tested"] == np.isfinite(p).sum()
                assert size["holm"] == np.sum(holm <= 0.05)
                assert np.all((holm >= p) | np.isnan(p))


def test_dataset(first: Finished):
    with xarray.open_dataset(first.folder / "results.nc", group="scene", engine="h5netcdf") as group:
        tiles = {f"tile_{axis}_{side}": 2 if side == 8 else 1 for axis in "xy" for side in (8, 16, 32)}
        assert dict(group.sizes) | {"cell": 0, "limit": 0} == {
            **tiles,
            "cell": 0,
            "limit": 0,
            "prefix": 2,
            "replicate": 4,
            "reference_replicate": 4,
            "piece": 4,  # of the floor and of nothing beside it, in tiles of 8 pixels
            "objects": 1,
            "y": 9,
            "x": 12,
            "channel": 3,
        }
        assert group.image.dims == group.image_variance.dims == ("cell", "y", "x", "channel")
        assert group.reference.dims == group.reference_variance.dims == ("limit", "y", "x", "channel")
        assert group.channel.values.tolist() == ["red", "green", "blue"]
        names = group.limit_name.values.tolist()
        assert len(set(names)) == len(names)
        for which in ("own", "correct", "physical"):
            chosen = group[which].values
            assert chosen.shape == (group.sizes["cell"],)
            assert ((chosen >= 0) & (chosen < len(names))).all()
        assert (group.image_variance.values >= 0).all()
        assert group.attrs["units"] == "linear Rec. 709 radiance"
        summed = sum(
            group.image.sel(cell=i).values
            for i, pair in enumerate(zip(group.cell_term.values, group.cell_variant.values, strict=True))
            if pair in (("ambient", "cosine"), ("direct", "next-event"), ("specular", "vndf"), ("background", "seen"))
        )
        total = group.image.values[group.cell_term.values.tolist().index("total")]
        np.testing.assert_allclose(total, summed, rtol=1e-5, atol=1e-7)


def test_term_images_have_named_parts_and_provenance(first: Finished, results: dict[str, Any]):
    path = first.folder / "images" / "scene.exr"
    parts = read_exr(path)
    assert {"ambient.cosine", "direct.path", "specular.vndf", "background.seen", "total.default"} <= set(parts)
    assert {"reference.total", "reference.total physical"} <= set(parts)
    assert all(image.shape == (9, 12, 3) for image in parts.values())
    with OpenEXR.File(str(path)) as file:
        header = file.header()
        assert header["scene"] == "scene"
        assert header["digest"] == results["settings"]["scenes"]["scene"]["digest"]
        assert json.loads(header["versions"]) == results["versions"]


def test_a_second_run_computes_nothing(first: Finished, compare: Callable[..., Finished]):
    again = compare("--json")
    assert (again.computed, again.rendered) == (0, 0)
    assert again.output == first.output
    assert "no cell was computed" in again.messages
    assert again.status == first.status


@pytest.mark.slow
def test_another_folder_computes_nothing_either(first: Finished, compare: Callable[..., Finished]):
    """What is kept is found by content; only the measurements are made again."""
    elsewhere = compare("--json", out="elsewhere")
    assert (elsewhere.computed, elsewhere.rendered) == (0, 0)
    same = {"settings", "versions", "schema"}
    ours, theirs = json.loads(elsewhere.output), json.loads(first.output)
    assert set(ours) == same | {"failed", "cells", "extrapolations", "audits"}
    for row, other in zip(ours["cells"], theirs["cells"], strict=True):
        assert row | {"compile_seconds": 0} == other | {"compile_seconds": 0}


@pytest.mark.slow
def test_replicates_are_allotted_where_intervals_are_wide(
    first: Finished, results: dict[str, Any], files: Path, compare: Callable[..., Finished]
):
    """Beyond those of the study, by a pilot of its own: what the study has is found again, and so is the rest later."""
    # Of a seed of its own: other tests count what they find in the cache.
    text = (files / "study.toml").read_text().replace("scenes", "seed = 3\nscenes")
    (files / "plain.toml").write_text(text)
    compare("--json", out="plain", study_file="plain.toml")
    (files / "allotted.toml").write_text(text.replace("photons", "half_width = 0.0005\nphotons"))
    run = compare("--json", out="allotted", study_file="allotted.toml")
    found = json.loads(run.output)
    allotted = found["settings"]["allotted"]
    assert (results["settings"]["allotted"], allotted["asked"]) == (None, 0.0005)
    last = {(r["term"], r["variant"]): r for r in found["cells"] if r["against"] == "own" and r["samples"] == 2}
    total, paper = last.pop(("total", "default")), last.pop(("direct", "paper"))
    assert paper["replicates"] == 4, "no verdict is due"
    wrong = [row for row in last.values() if row["kind"] == "wrong"]
    assert {row["replicates"] for row in wrong} == {4}
    last = {key: row for key, row in last.items() if row not in wrong}
    counts = [row["replicates"] for row in last.values()]
    assert set(counts) == set(allotted["replicates"])
    assert {row["reference_replicates"] for row in last.values()} == set(allotted["reference_replicates"])
    assert max(counts) > min(counts) == total["replicates"] == 4
    # Two replicates of each variant, eight of the one with photons.
    assert run.computed == sum(count - 4 for count in counts) + 2 * (len(counts) - 1) + 8
    again = compare("--json", out="allotted again", study_file="allotted.toml")
    assert (again.computed, again.rendered) == (0, 0)
    assert json.loads(again.output)["settings"]["allotted"] == allotted
    page = (run.folder / "index.html").read_text()
    assert "90&#8239;% intervals of what is meant to be right are seldom wider" in page
    assert 'id="allotment"' in (run.folder / "method.html").read_text()


@pytest.fixture(scope="module")
def sequential_run(first: Finished, compare: Callable[..., Finished]) -> Finished:
    """The study with a budget that lets every row go to its last look."""
    return compare("--json", "--budget", "1h", out="budget")


def test_a_budget_already_spent_gives_the_bits_of_a_run_without(
    first: Finished, results: dict[str, Any], compare: Callable[..., Finished]
):
    spent = compare("--json", "--budget", "0.001", out="spent")
    assert (spent.computed, spent.rendered) == (0, 0)
    found = json.loads(spent.output)
    decided = {"EQUIVALENT", "AS PREDICTED", "BIASED", "NOT AS PREDICTED"}
    for row, other in zip(found["cells"], results["cells"], strict=True):
        for key in ("bias", "standard_error", "rmse", "relmse", "ssim", "seconds", "replicates", "split"):
            assert row[key] == other[key], key
        assert row["verdict"] not in decided or row["verdict"] == other["verdict"], "a quarter of the level"
        assert row["looks"] in (4, None)
    with (
        xarray.open_dataset(first.folder / "results.nc", group="scene", engine="h5netcdf") as group,
        xarray.open_dataset(spent.folder / "results.nc", group="scene", engine="h5netcdf") as other,
    ):
        xarray.testing.assert_identical(group, other)


@pytest.mark.slow
def test_a_budget_extends_undecided_rows_alone(
    first: Finished, results: dict[str, Any], sequential_run: Finished, files: Path
):
    """Looks at K = R = 4, 8, 16, 32; a row that was decided keeps its verdict and its replicates."""
    found = json.loads(sequential_run.output)
    certified = found["settings"]["certified"]
    assert certified["looks"] == [4, 8, 16, 32]
    judged = [row for row in found["cells"] if row["verdict"] not in (None, "ABSENT")]
    for row in judged:
        assert row["replicates"] == row["reference_replicates"]
        assert row["replicates"] in certified["looks"]
        assert row["verdict"] != "UNDERPOWERED" or row["replicates"] == 32
        assert row["looks"] == 4
    absent = [row["replicates"] for row in found["cells"] if row["verdict"] == "ABSENT"]
    assert absent == [4] * len(absent) != []
    assert len({row["replicates"] for row in judged}) > 1, "some were decided before others"
    # A cell and a reference have as many replicates as the row that went furthest, and none twice.
    furthest: dict[tuple[str, str], int] = {}
    for row in judged:
        parts = [(row["term"], row["variant"])]
        if row["term"] == "total":
            parts = [(term, getattr(study.Variants(), term)[0]) for term in TERMS]
        for part in parts:
            furthest[part] = max(row["replicates"], furthest.get(part, 4))
    assert sequential_run.computed == sum(count - 4 for count in furthest.values())
    assert furthest == {
        (each["term"], each["variant"]): each["replicates"]
        for each in found["settings"]["scenes"]["scene"]["work"]
        if (each["term"], each["variant"]) in furthest
    }
    assert certified["rows"] == sum(row["verdict"] in ("EQUIVALENT", "AS PREDICTED") for row in judged)
    assert certified["of"] == len(judged)
    terms = [r for r in judged if r["verdict"] in ("EQUIVALENT", "AS PREDICTED") and r["term"] != "total"]
    assert 0 < certified["seconds"]
    assert certified["seconds"] <= sum(row["seconds"] for row in judged)
    assert certified["seconds"] >= max((row["seconds"] for row in terms), default=0.0)
    assert certified["spent"] >= certified["seconds"] + certified["reference_seconds"]


def test_a_budget_charges_kept_seconds_so_that_a_second_run_decides_the_same(
    sequential_run: Finished, compare: Callable[..., Finished]
):
    again = compare("--json", "--budget", "1h", out="budget elsewhere")
    assert (again.computed, again.rendered) == (0, 0)
    ours, theirs = json.loads(again.output), json.loads(sequential_run.output)
    for row, other in zip(ours["cells"], theirs["cells"], strict=True):
        assert row | {"compile_seconds": 0} == other | {"compile_seconds": 0}
    spent = [each["settings"]["certified"]["spent"] for each in (ours, theirs)]
    assert spent[0] == spent[1]


def test_a_budget_shows_in_the_terminal_and_on_the_pages(sequential_run: Finished, compare: Callable[..., Finished]):
    shown = compare("--budget", "1h", out="budget")
    assert shown.computed == 0
    (said,) = (line for line in shown.output.splitlines() if " s to certify " in line)
    passed = [
        row for row in json.loads(sequential_run.output)["cells"] if row["verdict"] in ("EQUIVALENT", "AS PREDICTED")
    ]
    within = [f"{round(100 * (row['margin'] + row['allowance']), 2):g} %" for row in passed]
    assert f" s to certify {len(passed)} of " in said
    for margin in set(within):
        assert f"|bias| < {margin} in {within.count(margin)}" in said
        assert f" ±{margin}" in shown.output
    assert "Budget 3600 s" in shown.output
    assert "looks at K = 4, 8, 16, 32" in shown.output
    index = (sequential_run.folder / "index.html").read_text("utf-8")
    assert f"to certify {len(passed)} of " in index
    assert "looks at K = 4, 8, 16, 32" in index
    assert "This run had a budget" in (sequential_run.folder / "method.html").read_text("utf-8")


def test_what_is_missing_is_computed_alone(first: Finished, compare: Callable[..., Finished], files: Path):
    # Its report may be there from another test, or not yet: the order is that of the workers.
    compare(out="elsewhere", study_file="study.toml")
    kept = sorted((files / "cache" / "cells").rglob("*.npz"))
    kept[0].write_bytes(kept[0].read_bytes()[:100])
    kept[1].unlink()
    before = {path: path.stat().st_mtime_ns for path in kept[2:]}
    assert compare(out="elsewhere", study_file="study.toml").computed == 0, "the report is whole and needs no cell"
    third = compare("--json", out="third")
    assert (third.computed, third.rendered) == (2, 0)
    assert {path: path.stat().st_mtime_ns for path in kept[2:]} == before


@pytest.mark.slow
def test_a_damaged_report_is_written_again(first: Finished, compare: Callable[..., Finished]):
    for damage, named in (
        (lambda: (first.folder / "results.json").write_text('{"schema": 1, "settings": {'), True),
        (lambda: (first.folder / "results.json").write_text('{"schema": 9}'), True),
        (lambda: (first.folder / "results.nc").unlink(), True),
        (lambda: os.truncate(first.folder / "results.nc", 5000), True),
        (lambda: (first.folder / "index.html").unlink(), False),
    ):
        damage()
        again = compare("--json")
        assert again.computed == 0
        assert "no cell was computed" not in again.messages
        assert ("it is written again" in again.messages) == named, again.messages
        assert all((first.folder / name).is_file() for name in ("results.json", "results.nc", "index.html"))


@pytest.mark.slow
def test_a_run_that_is_interrupted_goes_on(first: Finished, compare: Callable[..., Finished], files: Path):
    (files / "seeded.toml").write_text((files / "study.toml").read_text().replace("scenes", "seed = 2\nscenes"))
    intact: Any = cells.take
    calls = []

    def interrupted(engine: Any, job: cells.Replicate, folder: Path) -> bool:
        made = intact(engine, job, folder)
        calls.append(job.what)
        if len(calls) == 6:
            raise KeyboardInterrupt
        return made

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cells, "take", interrupted)
        stopped = compare("--json", out="seeded", study_file="seeded.toml")
    assert stopped.status == 2
    assert stopped.output == ""
    assert stopped.messages.count("\n") == 1
    assert "interrupted" in stopped.messages
    assert stopped.computed == 6
    assert not (stopped.folder / "results.json").exists()
    assert not [path for path in files.rglob(".*") if path.is_file()], "a temporary file was left"
    goes_on = compare("--json", out="seeded", study_file="seeded.toml")
    assert goes_on.status in (0, 1)
    # References were there; what audits them comes after the cells.
    audits = [each for each in json.loads(goes_on.output)["audits"] if each["test"] == "second integrator"]
    assert goes_on.rendered == 4 * len(audits)
    assert goes_on.computed == first.computed - 6


def test_the_digest_follows_study_and_scene(files: Path):
    chosen = study.load(files / "study.toml")
    scenes = subjects.scenes_of(chosen)
    changed = [
        run.digest(attrs.evolve(chosen, seed=2), scenes, "scalar_rgb"),
        run.digest(attrs.evolve(chosen, reference_spp=5), scenes, "scalar_rgb"),
        run.digest(chosen, (attrs.evolve(scenes[0], max_bounces=2),), "scalar_rgb"),
        run.digest(chosen, (attrs.evolve(scenes[0], exposure=2.0),), "scalar_rgb"),
        run.digest(chosen, (attrs.evolve(scenes[0], name="another"),), "scalar_rgb"),
        run.digest(chosen, scenes, "llvm_ad_rgb"),
    ]
    assert len({run.digest(chosen, scenes, "scalar_rgb"), *changed}) == 1 + len(changed)


def test_exit_status_1_where_an_error_is_proven(compare: Callable[..., Finished], patched: pytest.MonkeyPatch):
    intact = cells.read

    def doubled(*arguments: Any, **settings: Any) -> cells.Cell:
        cell = intact(*arguments, **settings)
        return attrs.evolve(cell, images=2 * cell.images) if cell.variant.name == "cosine" else cell

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cells, "read", doubled)
        outcome = compare("--json", out="doubled")
    assert outcome.status == 1
    words = {(r["term"], r["variant"]): r["verdict"] for r in json.loads(outcome.output)["cells"] if r["verdict"]}
    assert words["ambient", "cosine"] == "BIASED"


@pytest.mark.slow
def test_a_scene_that_fails_loses_no_others_results(compare: Callable[..., Finished], files: Path):
    """The run ends with status 2 and names the scene first; the same command tries it again; a run of one fails."""
    (files / "other.toml").write_text(SCENE.replace("gloss = 0.3", "gloss = 0.2"))
    both = str(files / "scene.toml"), str(files / "other.toml")
    intact = cells.take

    def broken(engine: Any, job: cells.Replicate, folder: Path) -> bool:
        if job.scene.name == "other" and job.term == "specular":
            raise RuntimeError("no kernel\nfor this")
        return intact(engine, job, folder)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cells, "take", broken)
        outcome = compare(*both, "--json", out="broken")
        alone = compare(both[1], "--json", out="alone")
    assert outcome.status == 2
    assert outcome.messages == ("termwise: other: failed, and stands in no row: RuntimeError: no kernel for this\n")
    results = json.loads(outcome.output)
    assert results["failed"] == [{"scene": "other", "error": "RuntimeError: no kernel for this"}]
    assert {row["scene"] for row in results["cells"]} == set(results["settings"]["scenes"]) == {"scene"}
    assert {audit["scene"] for audit in results["audits"]} <= {"scene"}
    page = (outcome.folder / "index.html").read_text("utf-8")
    assert page.index("1 of 2 scenes failed.") < page.index("Every estimate")
    again = compare(*both, "--json", out="broken")
    assert again.status in (0, 1)
    assert json.loads(again.output)["failed"] == []
    assert {row["scene"] for row in json.loads(again.output)["cells"]} == {"scene", "other"}
    assert (alone.status, alone.output) == (2, "")
    assert not (alone.folder / "results.json").exists()


def test_seconds_of_replicates_add_up(results: dict[str, Any]):
    for row in results["cells"]:
        last = row["against"] == "own" and row["samples"] == 2
        assert (row["replicate_seconds"] is not None) == last
        if last:
            assert len(row["replicate_seconds"]) == row["replicates"]
            assert sum(row["replicate_seconds"]) == pytest.approx(row["seconds"])


@pytest.mark.slow
def test_another_seed_is_another_run(first: Finished, compare: Callable[..., Finished]):
    other = compare("--json", "--seed", "5", out="seed 5")
    ours, theirs = json.loads(other.output), json.loads(first.output)
    assert (ours["settings"]["seed"], theirs["settings"]["seed"]) == (5, 1)
    assert ours["settings"]["command"].endswith("--json --seed 5")
    errors = [
        {row["rmse"] for row in each["cells"] if (row["variant"], row["against"]) == ("next-event", "own")}
        for each in (ours, theirs)
    ]
    assert len(errors[0]) == len(errors[1]) == 2
    assert not errors[0] & errors[1]


# A process of its own: what a signal or a full disk does.


def _process(
    files: Path, study_file: str, out: str, *, largest_file: int = resource.RLIM_INFINITY
) -> subprocess.Popen[str]:
    """`termwise compare` with the caches of this module, but kernels and probes of the project."""
    code = (
        "import resource, signal, sys; from pathlib import Path; from termwise.reports import cli, run;"
        # A shell's background job, as these tests may be, ignores SIGINT and lets its children inherit that.
        "signal.signal(signal.SIGINT, signal.default_int_handler);"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({largest_file}, {largest_file}));"
        f"run.cache_folder = lambda: Path({str(files / 'cache')!r}); cli.main()"
    )
    arguments = ["compare", "--quiet", "--study", str(files / study_file), "--out", str(files / out)]
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        cwd=ROOT,
        env=os.environ | {"TERMWISE_CACHE": str(cache_folder())},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def _larger(files: Path, name: str) -> str:
    """A study that shares no replicate with the others."""
    text = (files / "study.toml").read_text()
    (files / f"{name}.toml").write_text(text.replace("[12, 9]", "[24, 18]").replace("scenes", "seed = 3\nscenes"))
    return f"{name}.toml"


@pytest.mark.slow
def test_ctrl_c_is_one_line_and_the_same_command_goes_on(first: Finished, files: Path):
    kept, larger = files / "cache", _larger(files, "signal")
    before = len(list(kept.rglob("[!.]*.np[yz]")))
    process = _process(files, larger, "signal")
    deadline = time.monotonic() + 120
    while len(list(kept.rglob("[!.]*.np[yz]"))) == before and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    output, messages = process.communicate(timeout=120)
    assert process.returncode == 2, messages
    assert output == ""
    assert (
        messages
        == "termwise: interrupted: nothing is half-written; a study goes on from the replicates it has finished\n"
    )
    assert not (files / "signal" / "compare" / "results.json").exists()
    assert not [path for path in files.rglob(".*") if path.is_file()], "a temporary file was left"
    there = {path: path.stat().st_mtime_ns for path in kept.rglob("[!.]*.np[yz]")}
    assert len(there) > before
    process = _process(files, larger, "signal")
    process.communicate(timeout=300)
    assert process.returncode in (0, 1)
    assert {path: path.stat().st_mtime_ns for path in there} == there


@pytest.mark.slow
@pytest.mark.parametrize("stage", ["replicates", "images", "results"])
def test_a_full_disk_is_one_line(stage: str, first: Finished, files: Path):
    """A limit on the size of files stands for the disk: EFBIG where a full one says ENOSPC."""
    sizes = {path.name: path.stat().st_size for path in first.folder.rglob("*") if path.is_file()}
    assert 1_000 < sizes["scene.exr"] < sizes["results.nc"]
    study_file, largest = {
        "replicates": (_larger(files, "full"), 100),
        "images": ("study.toml", sizes["scene.exr"] - 100),
        "results": ("study.toml", sizes["results.nc"] - 100),
    }[stage]
    process = _process(files, study_file, f"full {stage}", largest_file=largest)
    output, messages = process.communicate(timeout=300)
    assert process.returncode == 2, messages
    assert output == ""
    assert messages.startswith("termwise: ")
    assert messages.count("\n") == 1, messages
    assert {"images": "scene.exr", "results": "", "replicates": ""}[stage] in messages
    assert not [path for path in files.rglob(".*") if path.is_file()], "a temporary file was left"
    folder = files / f"full {stage}" / "compare"
    assert not (folder / "results.json").exists()


@pytest.mark.slow
def test_settings_and_radii(compare: Callable[..., Finished], files: Path):
    """A changed scene is judged by itself and measured against the unchanged one; three radii and what they tend to."""
    (files / "settings.toml").write_text(
        (files / "study.toml").read_text().replace("scenes", "radii = [1.0, 0.7, 0.5]\nscenes")
        + """
[variants]
direct = ["next-event", "photon-map"]

[[settings]]
name = "bright"
what = "Direct light read as E"
scenes = ["scene"]
change = { irradiance = "E" }
"""
    )
    results = json.loads(compare("--json", out="settings", study_file="settings.toml").output)
    rows = {
        (row["scene"], row["term"], row["against"]): row
        for row in results["cells"]
        if row["variant"] in ("path", "cosine", "vndf", "default") and row["samples"] == 2
    }
    own, correct = rows["scene.bright", "direct", "own"], rows["scene.bright", "direct", "correct"]
    assert (own["base"], own["setting"], own["kind"]) == ("scene", "bright", "wrong")
    assert own["verdict"] in ("AS PREDICTED", "UNDERPOWERED")
    assert correct["predicted_bias"] == pytest.approx(math.pi - 1, rel=0.2)
    assert correct["bias"] == pytest.approx(correct["predicted_bias"], abs=6 * correct["standard_error"])
    assert rows["scene.bright", "ambient", "correct"]["predicted_bias"] == 0.0
    assert ("scene.bright", "total", "correct") in rows
    assert ("scene.bright", "total", "physical") not in rows
    assert results["settings"]["scenes"]["scene.bright"]["settings"]["direct light read as"] == "E"
    found = results["extrapolations"]
    assert [each["variant"] for each in found] == ["next-event", "photon-map"]
    for each in found:
        radii = [point["radius"] for point in each["points"]]
        assert radii == sorted(radii, reverse=True)
        assert radii[-1] == 0.0
        assert radii[1] / radii[0] == pytest.approx(0.7)
        for point in each["points"]:
            assert point["low"] < point["error"] < point["high"]
            parts = point["classes"]
            assert sum(part["error"] for part in parts.values()) == pytest.approx(point["error"], abs=1e-9)
            pixels = [part["pixels"] for part in parts.values()]
            assert sum(pixels) == pytest.approx(1.0) if point["radius"] else pixels == [None] * 3
        assert each["label"] in ("interior", "boundary", "none proven")
    page = (files / "settings" / "compare" / "scenes" / "scene.bright.html").read_text("utf-8")
    assert "Direct light read as E" in page
