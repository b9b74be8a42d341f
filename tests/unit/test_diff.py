"""Two runs compared: words are said where a test says so, against scipy, closed forms and simulated nulls."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from termwise.reports import cli
from termwise.reports.results import diff
from termwise.reports.statistics import tiles

KEYS = [("room", "ambient", "cosine"), ("room", "direct", "path"), ("room", "direct", "paper")]
KEYS += [("room", "specular", name) for name in ("vndf", "uniform")] + [("room", "total", "default")]
COUNT = 16


def row_of(key, *, bias=0.0, rmse=0.01, seconds=0.1, verdict="EQUIVALENT", rng=None, error=0.001, burst=0.0):
    """A judged row; with `rng` its numbers scatter as those of a run do, times by a `burst` that replicates share."""
    noise = (lambda *shape: np.zeros(shape)) if rng is None else rng.standard_normal
    square = rmse**2 * float(1 + 0.02 * noise(1)[0])
    half = float(stats.t.isf(0.05, COUNT - 1)) * 0.02 * rmse**2
    times = seconds * np.exp(0.02 * noise(COUNT) + burst * noise(1))
    return dict(zip(("scene", "term", "variant"), key, strict=True)) | {
        "against": "own", "samples": 8, "replicates": COUNT, "reference_replicates": COUNT, "verdict": verdict,
        "bias": bias + error * float(noise(1)[0]), "standard_error": error, "rmse": math.sqrt(square),
        "rmse_high": math.sqrt(square + half), "rmse_low": math.sqrt(square - half), "seconds": float(times.sum()),
        "replicate_seconds": times.tolist(),
    }  # fmt: skip


def run_of(rows, **settings):
    common = {"study": "quick", "seed": 1, "options": {"replicates": COUNT}}
    scenes = {"room": {"digest": "a" * 64, "resolution": [8, 8], "settings": {"triangles": 12}}}
    return {
        "schema": 1, "versions": {"numba": "1"}, "settings": common | {"scenes": scenes} | settings, "cells": rows
    }  # fmt: skip


def run(rng=None, changes=None, **settings):
    return run_of([row_of(key, rng=rng, **(changes or {}).get(key, {})) for key in KEYS], **settings)


def row(found, key):
    return next(each for each in found["rows"] if (each["scene"], each["term"], each["variant"]) == key)


def test_welch_is_scipys():
    rng = np.random.default_rng(1)
    a, b = rng.normal(0, 1, 7), rng.normal(0.8, 3, 12)
    effect = diff.welch(diff._mean(a), diff._mean(b))
    expected: Any = stats.ttest_ind(b, a, equal_var=False)
    assert effect.dof == pytest.approx(expected.df)
    assert effect.p(0.0) == pytest.approx(expected.pvalue)
    assert effect.interval() == pytest.approx(tuple(expected.confidence_interval(0.9)))


def test_a_tolerance_is_the_null_farthest_from_zero():
    """p is the chance of a value so far from 0 where the true one is the tolerance: simulated."""
    effect = diff.Effect(2.0, 1.0, 9)
    drawn = 0.5 + np.random.default_rng(2).standard_t(9, 400_000)
    share = np.mean(np.abs(drawn) >= 2.0)
    assert effect.p(0.5) == pytest.approx(share, abs=5 * math.sqrt(share / len(drawn)))
    assert diff.Effect(0.3, 0.0, 9).p(0.5) == 1.0
    assert diff.Effect(0.7, 0.0, 9).p(0.5) == 0.0


def test_holm_of_a_textbook_example():
    assert tiles.holm(np.array([0.01, 0.04, 0.03, 0.005])) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert len(tiles.holm(np.array([]))) == 0


@pytest.mark.slow
def test_nothing_is_said_of_equal_runs_more_often_than_the_level():
    """Bias, error and time scatter between 300 pairs of runs, times with bursts that all replicates of a row share."""
    rng = np.random.default_rng(3)
    found = []
    for _ in range(300):
        changes = {key: {"burst": 0.3} for key in KEYS}
        found.append(diff.diff(run(rng, changes), run(rng, changes)))
    false = sum(bool(each["worse"] or each["better"]) for each in found)
    assert all(each["tests"] == 3 * len(KEYS) for each in found)
    # Tests have tolerances, so they find less than the level.
    assert stats.binom.sf(false - 1, len(found), diff.LEVEL) > 0.01


@pytest.mark.parametrize(
    ("change", "measure", "finding"),
    [
        ({"bias": 0.02}, "bias", "worse"),
        ({"bias": -0.02}, "bias", "worse"),
        ({"rmse": 0.015}, "error", "worse"),
        ({"rmse": 0.007}, "error", "better"),
        ({"seconds": 0.2}, "time", "worse"),
        ({"seconds": 0.05}, "time", "better"),
    ],
)
def test_a_change_is_found_where_it_is_and_nowhere_else(change, measure, finding):
    rng = np.random.default_rng(4)
    key = KEYS[0]
    found = diff.diff(run(rng), run(rng, {key: change}))
    for each in found["rows"]:
        for name in diff.MEASURES:
            here = (each["scene"], each["term"], each["variant"]) == key and name == measure
            assert each[name]["finding"] == (finding if here else ""), (each["term"], name)
    assert row(found, key)["finding"] == finding
    assert found["any_worse"] == (finding == "worse")
    assert (found["worse"], found["better"]) == ((1, 0) if finding == "worse" else (0, 1))
    low, change_of, high = (row(found, key)[measure][name] for name in ("low", "change", "high"))
    assert low < change_of < high
    assert diff.said(measure, finding) == (
        {"worse": "slower", "better": "faster"}[finding] if measure == "time" else finding
    )


def test_a_bias_on_the_other_side_is_no_worse():
    key = KEYS[0]
    changes = [{key: {"bias": bias}} for bias in (-0.02, 0.02)]
    found = diff.diff(run(None, changes[0]), run(None, changes[1]))
    assert row(found, key)["bias"]["change"] == pytest.approx(0.04)
    assert row(found, key)["bias"]["finding"] == ""
    back = diff.diff(run(None, changes[0]), run(None, {key: {"bias": 0.001}}))
    assert row(back, key)["bias"]["finding"] == "better"


def test_a_factor_that_all_rows_share_is_the_machines():
    rng = np.random.default_rng(5)
    found = diff.diff(run(rng), run(rng, {key: {"seconds": 0.2} for key in KEYS}))
    assert found["time_median"] == pytest.approx(2.0, rel=0.05)
    assert not found["any_worse"]


def test_kept_replicates_were_timed_once():
    """Equal seconds say nothing of two hours; too few others leave the time untested, and the reason is named."""
    before = run(np.random.default_rng(6))
    found = diff.diff(before, json.loads(json.dumps(before)))
    assert all(each["time"] is None for each in found["rows"])
    assert "timed anew" in found["untested"][0]
    for each in before["cells"]:
        del each["replicate_seconds"]
    assert "the first and the second run" in diff.diff(before, before)["untested"][0]


@pytest.mark.parametrize(
    ("before", "after", "finding"),
    [
        ("EQUIVALENT", "BIASED", "worse"),
        ("UNDERPOWERED", "NOT AS PREDICTED", "worse"),
        ("EQUIVALENT", "NO VERDICT", "worse"),
        (None, "BIASED", "worse"),
        ("BIASED", "EQUIVALENT", "better"),
        ("BIASED", "UNDERPOWERED", "changed"),
        ("EQUIVALENT", "UNDERPOWERED", "changed"),
        ("EQUIVALENT", "EQUIVALENT", ""),
    ],
)
def test_verdicts(before, after, finding):
    key = KEYS[1]
    found = diff.diff(run(None, {key: {"verdict": before}}), run(None, {key: {"verdict": after}}))
    assert row(found, key)["verdict"] == {"before": before, "after": after, "finding": finding}
    assert found["any_worse"] == (finding == "worse")


def test_settings_that_differ_are_named():
    before, after = run(), run(seed=2)
    after["versions"]["numba"] = "2"
    after["settings"]["scenes"]["room"] |= {"digest": "b" * 64, "resolution": [9, 9]}
    after["cells"][0] |= {"samples": 16}
    found = {each["name"]: (each["before"], each["after"]) for each in diff.diff(before, after)["settings"]}
    assert found == {
        "seed": (1, 2),
        "version of numba": ("1", "2"),
        "room: resolution": ([8, 8], [9, 9]),
        "room: digest": ("a" * 64, "b" * 64),
        "samples per pixel of ambient cosine": (8, 16),
    }
    assert diff.diff(before, before)["settings"] == []


def test_rows_of_one_run_and_scenes_that_failed_are_listed():
    before, after = run(), run()
    del after["cells"][0]
    after["cells"].append(row_of(("hall", "ambient", "cosine")))
    after["failed"] = [{"scene": "attic", "error": "MemoryError: no room"}]
    found = diff.diff(before, after)
    assert found["only_before"] == [list(KEYS[0])]
    assert found["only_after"] == [["hall", "ambient", "cosine"]]
    assert found["failed"] == [{"scene": "attic", "before": None, "after": "MemoryError: no room"}]
    assert found["any_worse"]
    assert not diff.diff(after, after)["any_worse"]


def test_the_largest_sample_count_counts():
    before = run()
    before["cells"].insert(0, before["cells"][0] | {"samples": 4, "rmse": 0.5, "verdict": None})
    assert row(diff.diff(before, run()), KEYS[0])["error"]["before"] == pytest.approx(0.01)


# The command.


@pytest.fixture
def command(tmp_path, monkeypatch, capsys):
    """A function: `termwise diff a b` on two runs, its exit status, output and messages."""
    monkeypatch.chdir(tmp_path)

    def call(before, after, *options):
        for name, content in (("a", before), ("b", after)):
            Path(name).mkdir(exist_ok=True)
            Path(name, "results.json").write_text(content if isinstance(content, str) else json.dumps(content), "utf-8")
        monkeypatch.setattr("sys.argv", ["termwise", "diff", "a", "b", *options])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        captured = capsys.readouterr()
        return ended.value.code, captured.out, captured.err

    return call


def test_exit_status_text_json_and_page(command):
    worse = run(None, {KEYS[0]: {"bias": 0.05, "verdict": "BIASED"}}, seed=2)
    status, output, messages = command(run(), worse)
    assert (status, messages) == (1, "")
    assert output.index("seed: 1 -> 2") < output.index("BIASED")
    assert "worse" in output
    page = Path("out/diff/index.html").read_text("utf-8")
    assert "1 of 6 estimates became worse" in page
    assert page.index("Settings that differ") < page.index("What is proven")
    assert "//" not in page.replace("<!doctype", "")
    assert Path("out/diff/table.js").is_file()
    status, output, _ = command(run(), run(), "--json")
    assert status == 0
    assert json.loads(output) == json.loads(Path("out/diff/diff.json").read_text("utf-8"))
    assert "No change is proven" in Path("out/diff/index.html").read_text("utf-8")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (json.dumps(run())[:-40], ["cut short", "line 1"]),
        ('{"schema": 7}', ["schema = 7", "allowed is 1"]),
        ("[]", ["schema = None"]),
        ('{"schema": 1, "settings": {}, "versions": {}}', ["cells", "is missing"]),
        ('{"schema": 1, "settings": {}, "versions": {}, "cells": [{"scene": "a"}]}', ["cells[0].term"]),
    ],
)
def test_what_is_no_run_is_refused_by_name(content, words, command):
    for before, after, name in ((content, run(), "a"), (run(), content, "b")):
        status, output, messages = command(before, after)
        assert (status, output) == (2, "")
        assert messages.count("\n") == 1
        assert f"{name}/results.json" in messages
        assert all(word in messages for word in words)
