"""Benchmarks: what is computed from measured points, what is refused, the page; never a speed."""

import json
import math

import attrs
import numpy as np
import pytest

from termwise import renderer
from termwise.reports import cli
from termwise.reports.bench import common, curves, equal_error, reductions, scaling, view
from termwise.reports.bench.worker import Load
from termwise.reports.pages import bench as page
from termwise.reports.progress import silent
from termwise.scenes.load import load
from termwise.scenes.terms import TERMS

MACHINE = {"processor": "a <fast> one", "cores": 2, "threads": 2, "load": 0.5, "versions": {"python": "3.11"}}


@pytest.mark.parametrize("slope", [0.5, 0.75, 1.0])
def test_power_laws_are_interpolated_exactly(slope):
    """RMSE = N^-slope at N microseconds: e is reached after e^(-1 / slope) of them, between any two points."""
    samples = 4.0 ** np.arange(6)
    rmse, seconds = samples**-slope, 1e-6 * samples
    for target in np.geomspace(rmse[0], rmse[-1], 17)[1:-1]:
        expected = 1e-6 * target ** (-1.0 / slope)
        assert curves.seconds_to(target, rmse.tolist(), seconds.tolist()) == pytest.approx(expected)


def test_an_error_that_is_never_reached_takes_for_ever():
    assert curves.seconds_to(0.09, [0.4, 0.2, 0.1], [1.0, 4.0, 16.0]) == math.inf


def test_a_coarsest_point_serves_greater_errors():
    assert curves.seconds_to(0.7, [0.4, 0.2], [1.0, 4.0]) == 1.0


def test_a_curve_that_noise_lifts_is_crossed_where_it_first_falls():
    assert curves.seconds_to(0.2, [0.4, 0.1, 0.3, 0.1], [1.0, 4.0, 16.0, 64.0]) == pytest.approx(2.0)


def test_targets_lie_inside_both_curves():
    """Three falling errors between 0.05, the best that ours has, and 0.3, the worst of Mitsuba's settings."""
    found = curves.targets([0.4, 0.2, 0.05], [[0.3, 0.01], [0.2, 0.02]])
    assert len(found) == 3
    assert 0.3 > found[0] > found[1] > found[2] > 0.05


def test_who_leads_where_its_curve_ends():
    """The fast one, which stops at 0.1, and the slow one, which alone goes further; not one that is behind both."""
    fast, slow = ([0.4, 0.1], [1.0, 16.0]), ([0.4, 0.02], [10.0, 4000.0])
    behind = [0.4, 0.2], [50.0, 200.0]
    assert curves.leaders([fast, behind, slow], 1.5) == [0, 2]
    # Below 0.1 the slow one would pass for the best.
    assert min(curves.targets([0.4, 0.2, 0.05], [fast[0], slow[0]])) > 0.1


def test_curves_that_do_not_meet_have_no_targets():
    assert curves.targets([0.4, 0.3], [[0.2, 0.1]]) == ()
    assert curves.targets([0.0, 0.0], [[0.0, 0.0]]) == ()


def _curve(rmse: list[float], seconds: list[float]) -> equal_error.Curve:
    samples = tuple(2**k for k in range(len(rmse)))
    return equal_error.Curve(samples, np.array([rmse]) ** 2, np.array([seconds]))


@pytest.mark.parametrize(
    ("theirs", "expected"),
    [
        # One that is behind where it ends counts for nothing; 4 samples of ours get below 0.1.
        ({"fast": _curve([0.4, 0.1], [1.0, 16.0]), "behind": _curve([0.4, 0.06], [50.0, 9000.0])}, 4),
        # Below 0.1 the slow one would pass for the best: no target is there.
        ({"fast": _curve([0.4, 0.1], [1.0, 16.0]), "slow": _curve([0.4, 0.02], [10.0, 4000.0])}, 4),
        # Ours never gets so far.
        ({"slow": _curve([0.4, 0.02], [10.0, 4000.0])}, 8),
        ({}, 8),
    ],
    ids=["one leads", "two lead", "further than ours", "apart"],
)
def test_ours_goes_as_far_as_what_may_be_their_best(theirs, expected):
    ours = _curve([0.4, 0.2, 0.09, 0.05], [1.0, 2.0, 4.0, 8.0])
    assert equal_error._far_enough(ours, theirs, equal_error.Truth(np.zeros((1, 1, 3)), 0.0, 0.0)) == expected


def test_the_error_of_the_truth_is_taken_away():
    """Mean squares of 0.05 about a truth that is itself 0.01 off: the error is the root of 0.04."""
    square = np.array([[0.04, 0.005], [0.06, 0.007]])
    assert curves.pooled(square, 0.01) == pytest.approx([0.2, 0.0])


def test_the_truth_leans_on_the_quieter_side():
    """Variance of the mean over runs: (1 + 1) / (2 - 1) / 2 = 1 for 1 and 3."""
    mean, noise = equal_error._mean_and_noise(np.array([1.0, 3.0]).reshape(2, 1, 1, 1))
    assert (float(mean.squeeze()), noise) == (2.0, 1.0)


def test_every_right_estimator_is_a_case():
    """Direct twice, by scope; with all bounces a kernel estimate and an unbiased one, of which the default says so."""
    found = list(equal_error.cases(("cornell_box", "monkey"), ("ambient", "direct", "specular"), 8))
    labels = [case.label.removesuffix(" (auto)") for case in found]
    assert [
        (each.scene.name, each.variant.term, each.scope, label) for each, label in zip(found, labels, strict=True)
    ] == [
        ("cornell_box", "ambient", None, "cosine"),
        ("cornell_box", "direct", "first-hit", "next-event"),
        ("cornell_box", "direct", "all", "next-event"),
        ("cornell_box", "direct", "all", "path"),
        ("cornell_box", "specular", "first-hit", "vndf"),
        ("monkey", "ambient", None, "cosine"),
        ("monkey", "direct", "first-hit", "next-event"),
        ("monkey", "direct", "all", "next-event"),
        ("monkey", "direct", "all", "path"),
        ("monkey", "specular", "all", "vndf+next-event"),
        ("monkey", "specular", "all", "vndf+path"),
    ]
    assert [case.kernel_based for case in found if case.variant.name == "next-event"] == [False, True] * 2
    taken = [(each.scene.name, each.scope, each.variant.name) for each in found if each.label.endswith(" (auto)")]
    scenes = [attrs.evolve(load(name), scope="all", resolution=(8, 8)) for name in ("cornell_box", "monkey")]
    assert taken == [(scene.name, "all", renderer.chosen(scene, "direct").name) for scene in scenes]
    assert set(equal_error.TERMS) < set(TERMS)


def test_spread_is_median_and_ends():
    assert common.spread([3.0, 1.0, 2.0, 10.0]) == (2.5, 1.0, 10.0)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["terms", "--scene", "teapot"], ["scene = 'teapot'", "two_cubes", "monkey"]),
        (["terms", "--term", "glow"], ["term = 'glow'", "ambient, direct, specular"]),
        (["terms", "--term", "background"], ["term = 'background'", "ambient, direct, specular"]),
        (["terms", "--runs", "0"], ["runs = 0", "at least 1"]),
        (["terms", "--resolution", "-1"], ["resolution = -1", "at least 1"]),
        (["terms", "--seconds", "0"], ["seconds = 0.0", "(0, inf)"]),
        (["terms", "--seconds", "nan"], ["seconds = nan", "(0, inf)"]),
        (["terms", "--threads", "0"], ["threads = 0", "at least 1"]),
        (["terms", "--out", "file"], ["file/bench", "is a file"]),
        (["scaling", "--axis", "depth"], ["axis = 'depth'", "triangles", "threads"]),
        (["scaling", "--runs", "0"], ["runs = 0", "at least 1"]),
        (["scaling", "--threads", "-2"], ["threads = -2", "at least 1"]),
        (
            ["reductions", "--reduction", "thrift"],
            ["reduction = 'thrift'", "aimed, counts, lights, splitting, roulette"],
        ),
        (["reductions", "--scene", "teapot"], ["scene = 'teapot'", "two_cubes", "monkey"]),
        (["reductions", "--batches", "0"], ["batches = 0", "at least 1"]),
        (["rays", "--mesh", "teapot"], ["mesh = 'teapot'", "boxes"]),
        (["rays", "--pairs", "0"], ["pairs = 0", "at least 1"]),
        (["rays", "--count", "0"], ["count = 0", "at least 1"]),
        (["view", "--scene", "teapot"], ["scene = 'teapot'", "two_cubes", "monkey"]),
        (["view", "--changes", "0"], ["changes = 0", "at least 1"]),
        (["view", "--memory-changes", "0"], ["memory_changes = 0", "at least 1"]),
    ],
)
def test_bad_input_is_one_line(arguments, named, monkeypatch, capsys, tmp_path):
    """Exit status 2, and a line that names field, value and what is allowed."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("not a folder\n")
    monkeypatch.setattr("sys.argv", ["termwise", "bench", *arguments])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    captured = capsys.readouterr()
    assert ended.value.code == 2
    assert captured.out == ""
    assert len(captured.err.splitlines()) == 1
    for words in named:
        assert words in captured.err


@pytest.mark.slow
def test_a_tiny_scaling_run_says_all(monkeypatch, tmp_path):
    """One load of 4 x 4 pixels on two axes, in processes of their own: times, memory, and threads beside processes."""
    tiny = scaling.Axis({16: Load("two_cubes", "ambient", resolution=4, samples=2)}, "sample", lambda load: 32)
    monkeypatch.setattr(scaling, "AXES", {"pixels": tiny, "threads": tiny})
    assert cli.measuring.scaling(axis=["pixels", "threads"], runs=2, threads=2, out=tmp_path) == 0
    measured = json.loads((tmp_path / "bench" / "scaling.json").read_text("utf-8"))
    assert [(case["axis"], case["value"], case.get("processes")) for case in measured["cases"]] == [
        ("pixels", 16, None), ("threads", 1, 1), ("threads", 2, 1), ("threads", 2, 2),
    ]  # fmt: skip
    for case in measured["cases"]:
        assert case["seconds_low"] <= case["seconds"] <= case["seconds_high"]
        assert case["per_unit_ns"] == pytest.approx(1e9 * case["seconds"] / 32)
        assert case["memory_mb"] >= case["memory_scene_mb"] >= case["memory_before_mb"] > 0
        assert case["bytes_per_triangle"] > 0
    assert measured["cases"][2]["of_processes"] > 0
    assert set(measured["machine"]) >= {"processor", "cores", "threads", "load", "load_end", "versions"}
    assert (tmp_path / "bench" / "index.html").is_file()


@pytest.mark.slow
def test_a_tiny_run_of_reductions_says_all(compiled):
    """4 x 4 pixels, two batches: reductions with the estimators they serve, cost the product of two ratios."""
    if not compiled:
        pytest.skip("photon maps of thousands of photons")
    found = reductions.measure(scenes=("monkey", "cornell_box"), resolution=4, batches=2)
    rows = found["cases"]
    assert {row["reduction"] for row in rows if row["scene"] == "monkey"} == {
        *("aimed", "counts", "splitting", "roulette")
    }
    # The box hides its light from nothing: no photon of it misses the scene.
    assert {row["reduction"] for row in rows if row["scene"] == "cornell_box"} == {"counts", "splitting", "roulette"}
    names = [tuple(row[name] for name in ("scene", "reduction", "term", "variant")) for row in rows]
    assert len(set(names)) == len(names)
    for row in rows:
        for name in ("variance", "seconds", "cost"):
            assert row[f"{name}_low"] <= row[name] <= row[f"{name}_high"]
        assert row["cost_low"] >= row["variance_low"] * row["seconds_low"] * (1 - 1e-12)
        assert row["cost_high"] <= row["variance_high"] * row["seconds_high"] * (1 + 1e-12)
        assert row["verdict"] in ("EQUIVALENT", "UNDERPOWERED")


def test_a_tiny_run_of_view_says_all(compiled):
    """8 x 8 pixels: each input of each scene, and memory at a tenth of the changes and at all of them."""
    if not compiled:
        pytest.skip("photon maps of thousands of photons")
    found = view.measure(scenes=("cornell_box", "monkey"), changes=2, memory_changes=10, resolution=8, report=silent)
    assert [(case["scene"], case["input"]) for case in found["cases"]] == [
        (name, what) for name in ("cornell_box", "monkey") for what in ("camera", "roughness", "gloss", "light")
    ]
    for case in found["cases"]:
        assert 0.0 < case["seconds_low"] <= case["seconds"] <= case["seconds_high"]
        assert case["processor"] > 0.0
        assert 0 <= case["previews"] <= case["changes"] == 2
    assert found["memory"]["changes"] == [1, 10]
    assert len(found["memory"]["megabytes"]) == 2


def curve(side, setting, **facts):
    common = {"scene": "monkey", "term": "direct", "scope": "all", "variant": "path <1>", "side": side}
    points = {"samples": [1, 4], "rmse": [0.2, 0.1], "seconds": [0.1, 0.4]}
    ends = {"seconds_low": [0.1, 0.3], "seconds_high": [0.2, 0.5]}
    return common | {"setting": setting, "compile_seconds": 1.0} | points | ends | facts


def made(folder, *names):
    """Files of benchmarks as runs write them."""
    case = {"scene": "monkey", "term": "direct", "scope": "all", "variant": "path <1>", "target_rmse": 0.15}
    case |= {"ours_s": 0.2, "mitsuba_s": 0.3, "mitsuba_setting": "ldsampler rr", "speedup": 1.5}
    case |= {"speedup_low": 1.25, "speedup_high": 2.0, "floor": 0.01, "truth_rmse": 0.001, "truth_differs": 0.0}
    rays = {"mesh": "boxes", "triangles": 36, "kind": "primary", "ours_mrays": 20.0, "mitsuba_mrays": 10.0}
    rays |= {"ratio": 2.0, "ratio_low": 1.5, "ratio_high": 2.5, "ratio_processor": 2.1, "ratio_default": 1.1}
    row = {"axis": "pixels", "seconds": 0.1, "seconds_low": 0.09, "seconds_high": 0.2, "unit": "sample"}
    row |= {"per_unit_ns": 900.0, "bytes_per_triangle": 112.0}
    row |= {"memory_mb": 200.0, "memory_scene_mb": 160.0, "memory_before_mb": 150.0}
    found = {
        "terms": {
            "cases": [case],
            "apart": [case | {"variant": "next-event"}],
            "curves": [
                curve("ours", "path <1>", floor=0.01),
                curve("mitsuba", "ldsampler rr", kept=True, trace_seconds=0.01, load_seconds=0.1),
                curve("mitsuba", "independent", kept=False, trace_seconds=0.02, load_seconds=0.1),
            ],
            "settings": {"resolution": 64, "runs": 3, "seconds": 0.5},
        },
        "rays": {"cases": [rays], "builds": []},
        "scaling": {
            "cases": [
                row | {"value": 16},
                row | {"value": 64},
                row | {"axis": "threads", "value": 2, "processes": 1, "of_processes": 0.97}
                | {"of_processes_low": 0.9, "of_processes_high": 1.0},
                row | {"axis": "threads", "value": 2, "processes": 2},
            ],
            "settings": {"runs": 3},
        },
        "reductions": {
            "cases": [
                {"scene": "monkey", "reduction": "aimed", "term": "direct", "variant": "path <1>"}
                | {"variance": 1.0, "variance_low": 0.9, "variance_high": 1.1}
                | {"seconds": 0.6, "seconds_low": 0.5, "seconds_high": 0.7}
                | {"cost": 0.62, "cost_low": 0.45, "cost_high": 0.77, "verdict": "EQUIVALENT"}
                | {"bias": 0.001, "bias_low": -0.001, "bias_high": 0.003}
            ],
            "settings": {"batches": 4},
        },
        "view": {
            "cases": [
                {"scene": "monkey", "input": "light", "seconds": 0.12, "seconds_low": 0.1, "seconds_high": 0.34}
                | {"processor": 0.18, "previews": 3, "changes": 30}
            ],
            "memory": {"scene": "monkey", "resolution": 32, "changes": [100, 1000], "megabytes": [251.0, 252.0]},
            "settings": {"resolution": 256, "changes": 30},
        },
    }  # fmt: skip
    for name in names:
        text = json.dumps(found[name] | {"machine": MACHINE, "command": f"termwise bench {name}"})
        (folder / f"{name}.json").write_text(text)


@pytest.mark.parametrize("names", [("terms",), ("rays",), ("scaling",), ("reductions",), ("view",), page.NAMES])
def test_the_page_shows_whatever_exists(names, tmp_path):
    made(tmp_path, *names)
    text = page.write(tmp_path).read_text("utf-8")
    for name in page.NAMES:
        assert (f'id="{name}"' in text) == (name in names)
        assert (f"termwise bench {name}" in text) == (name in names)
    assert "a &lt;fast&gt; one" in text
    assert "http" not in text
    if "terms" in names:
        assert "path &lt;1&gt;" in text
        assert "[1.2, 2.0]" in text  # two digits, halves to even
        assert "No error that both sides reach: monkey, direct next-event" in text
    if "rays" in names:
        assert "[1.5, 2.5]" in text
    if "scaling" in names:
        assert "0.97" in text
        assert "2 processes" in text
    if "reductions" in names:
        assert "0.62" in text
        assert "EQUIVALENT" in text
    if "view" in names:
        assert "3 of 30" in text
        assert "252&#8239;MB after 1\u202f000 changes of monkey" in text
    assert (tmp_path / "plotly.min.js").is_file() == (tmp_path / "charts.js").is_file() is True


def test_an_empty_folder_or_a_broken_file_is_refused(tmp_path):
    with pytest.raises(
        ValueError, match=r"no benchmark: allowed are terms.json, rays.json, scaling.json, reductions.json, view.json"
    ):
        page.write(tmp_path)
    (tmp_path / "rays.json").write_text("{")
    with pytest.raises(ValueError, match=r"rays\.json.*termwise bench rays"):
        page.write(tmp_path)
    (tmp_path / "rays.json").write_text('{"cases": [{"mesh": "boxes"}]}')
    with pytest.raises(ValueError, match="another version"):
        page.write(tmp_path)
