"""Gates: suites, all against all, exit statuses, JUnit and Markdown, pytest, and the workflow of the manual."""

import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from PIL import Image

import termwise
from termwise import pytest_plugin
from termwise.reports import cli
from termwise.reports.judging import gates
from termwise.reports.judging import suite as suites
from termwise.reports.results.exr import write_exr
from termwise.scenes.store import ROOT

SIZE = 24
BRIGHT = r"(4\.[5-9]|5|5\.[1-5]) % too bright, everywhere"
"""What is said of 5 %, noise aside."""
ROW = np.sin(np.arange(SIZE)) ** 2 + 0.5
PICTURE = (ROW[:, None] * ROW[::-1])[..., None] * np.array([1.0, 0.7, 0.4])
pytest_plugins = "pytester"

Replicates = Callable[..., None]
Run = Callable[..., int]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    """A function: the exit status of `termwise judge ...` in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def command(*arguments: object) -> int:
        monkeypatch.setattr("sys.argv", ["termwise", "judge", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        return int(str(ended.value.code))

    return command


def written(folder: str | Path, *, gain: float | np.ndarray = 1.0, noise: float = 0.1, count: int = 8) -> None:
    """A folder of replicates, each folder with noise of its own."""
    rng = np.random.default_rng(sum(str(Path(*Path(folder).parts[-2:])).encode()))
    for k in range(count):
        factor = rng.gamma(1 / noise**2, noise**2, (SIZE, SIZE, 1)) if noise else 1.0
        write_exr(Path(folder, f"{k:02d}.exr"), {"": gain * PICTURE * factor}, {})


@pytest.fixture
def replicates(run: Run) -> Replicates:
    """A function: a folder of replicates in the empty one."""
    return written


@pytest.fixture(scope="module")
def judged(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[suites.Outcome]]:
    """Three cases under one level: right, 5 % too bright, too noisy; and the folder of their pages."""
    folder = tmp_path_factory.mktemp("suite")
    for case, gain, noise in (("right", 1.0, 0.03), ("bright", 1.05, 0.03), ("noisy", 1.0, 1.0)):
        written(folder / f"mine/{case}", gain=gain, noise=noise)
        written(folder / f"ref/{case}", noise=noise)
    found = suites.judge_all(suites.of_folders(folder / "mine", folder / "ref"), folder / "out")
    return folder, found


def test_a_suite_has_one_level_and_one_index(judged: tuple[Path, list[suites.Outcome]]):
    folder, outcomes = judged
    assert {each.name: each.judgement.verdict for each in outcomes} == {
        "bright": "BIASED",
        "noisy": "UNDERPOWERED",
        "right": "EQUIVALENT",
    }
    alone = [termwise.judge(folder / "mine" / each.name, folder / "ref" / each.name, hint=False) for each in outcomes]
    assert {each.judgement.tests for each in outcomes} == {sum(each.tests or 0 for each in alone)}
    rows = suites.rows(outcomes, folder / "out")
    assert [row["name"] for row in rows] == ["bright", "noisy", "right"]  # the gravest first
    assert json.loads(json.dumps(rows)) == json.loads((folder / "out/results.json").read_text("utf-8"))["cases"]
    index = (folder / "out/index.html").read_text("utf-8")
    for row in rows:
        assert f'href="{row["page"]}"' in index
        page = (folder / "out" / row["page"]).read_text("utf-8")
        links = re.findall(r'(?:href|src)="(\.\./[^"]+)"', page)
        assert len(links) > 3
        assert all((folder / "out" / row["name"] / link).is_file() for link in links)


@pytest.mark.parametrize(
    ("verdict", "unbiased", "equivalent"),
    [("EQUIVALENT", 0, 0), ("BIASED", 1, 1), ("UNDERPOWERED", 0, 3), ("ABSENT", 0, 3)],
)
def test_exit_status_of_a_verdict(verdict: str, unbiased: int, equivalent: int):
    assert gates.status(verdict, "unbiased") == unbiased
    assert gates.status(verdict, "equivalent") == equivalent


def test_a_proven_bias_outweighs_what_is_open(judged: tuple[Path, list[suites.Outcome]]):
    _, outcomes = judged
    bright, noisy, right = outcomes
    assert [gates.worst([*each, right], "equivalent") for each in ([noisy, bright], [noisy], [])] == [1, 3, 0]
    assert [gates.worst([*each, right], "unbiased") for each in ([noisy, bright], [noisy], [])] == [1, 0, 0]


@pytest.mark.parametrize("require", ["unbiased", "equivalent"])
def test_junit_and_markdown(judged: tuple[Path, list[suites.Outcome]], require: gates.Require, tmp_path: Path):
    _, outcomes = judged
    gates.junit(tmp_path / "to/j.xml", outcomes, require)
    (found,) = ElementTree.parse(tmp_path / "to/j.xml").getroot()
    failed = {"bright"} if require == "unbiased" else {"bright", "noisy"}
    cases = {each.attrib["name"]: each for each in found}
    assert set(cases) == {"right", "bright", "noisy"}
    assert {name for name, each in cases.items() if each.find("failure") is not None} == failed
    assert (int(found.attrib["tests"]), int(found.attrib["failures"])) == (3, len(failed))
    assert (cases["noisy"].find("skipped") is None) == (require == "equivalent")
    failure = cases["bright"].find("failure")
    assert failure is not None
    assert re.fullmatch(f"BIASED: {BRIGHT}", failure.attrib["message"])
    assert "relative bias of the mean luminance" in (failure.text or "")
    assert "hint: agrees if ours is multiplied by one factor, 0.95" in (failure.text or "")
    gates.markdown(tmp_path / "m.md", outcomes, require)
    text = (tmp_path / "m.md").read_text("utf-8")
    assert text.startswith(f"**{len(failed)} of 3 comparisons failed**")
    assert re.search(rf"\| ❌ \| bright \| BIASED \| {BRIGHT} \|", text)
    assert "| ✅ | right | EQUIVALENT |" in text
    with pytest.raises(ValueError, match="cannot be written"):
        gates.markdown(tmp_path, outcomes, require)


@pytest.mark.slow
def test_the_command_says_words_hints_and_status(
    judged: tuple[Path, list[suites.Outcome]], run: Run, capsys: pytest.CaptureFixture[str]
):
    folder, _ = judged
    bright = folder / "mine/bright", "--reference", folder / "ref/bright"
    assert run(*bright, "--junit", "j.xml", "--markdown", "m.md") == 1
    lines = capsys.readouterr().out.splitlines()
    assert re.fullmatch(f"BIASED: {BRIGHT}", lines[0])
    assert lines[1].strip().startswith("hint: agrees if ours is multiplied by one factor, 0.95")
    assert Path("j.xml").is_file()
    assert "**1 of 1 comparisons failed**" in Path("m.md").read_text("utf-8")
    noisy = folder / "mine/noisy", "--reference", folder / "ref/noisy", "--json"
    assert run(*noisy, "--require", "equivalent") == 3
    found = json.loads(capsys.readouterr().out)
    assert (found["status"], found["require"], found["hints"]) == (3, "equivalent", [])
    assert found["headline"].startswith("too noisy to say: needs ")
    assert run(*noisy, "--margin", 50, "--require", "equivalent") == 3  # its shape is open still
    both = "--suite", folder / "mine", "--reference", folder / "ref", "--no-hints"
    capsys.readouterr()
    assert run(*both) == 1
    assert re.fullmatch(f"bright  BIASED: {BRIGHT}", capsys.readouterr().out.splitlines()[0])


def test_each_against_each(replicates: Replicates, run: Run, capsys: pytest.CaptureFixture[str]):
    for folder, gain in (("a", 1.0), ("b", 1.0), ("c", 1.05)):
        replicates(folder, gain=gain)
    assert run("a", "b", "c", "--json") == 1
    found = {row["name"]: row for row in json.loads(capsys.readouterr().out)["cases"]}
    assert {name: row["verdict"] for name, row in found.items()} == {
        "b against a": "EQUIVALENT",
        "c against a": "BIASED",
        "c against b": "BIASED",
    }
    assert found["c against a"]["bias"] == pytest.approx(0.05, abs=0.01)
    assert len({row["tests"] for row in found.values()}) == 1


def test_an_object_and_a_mask_from_files(replicates: Replicates, run: Run, capsys: pytest.CaptureFixture[str]):
    """3 % on 3 x 3 px, less than a thousandth of the mean; 40 % on what the mask leaves out."""
    corner, wrong = (np.zeros((SIZE, SIZE), np.uint8) for _ in range(2))
    corner[20:23, 20:23], wrong[:4] = 7, 1
    replicates("mine", gain=np.where(wrong, 1.4, np.where(corner, 1.03, 1.0))[..., None], noise=0.01)
    replicates("ref", noise=0.01)
    Image.fromarray(corner).save("objects.png")
    Image.fromarray(255 * (1 - wrong)).save("mask.png")
    compared = "mine", "--reference", "ref", "--json", "--no-hints"
    assert run(*compared) == 1
    assert "too bright" in json.loads(capsys.readouterr().out)["headline"]
    run(*compared, "--mask", "mask.png")
    within = json.loads(capsys.readouterr().out)
    assert abs(within["bias"]) < 0.003
    assert not any("object" in reason for reason in within["reasons"])
    assert run(*compared, "--mask", "mask.png", "--objects", "objects.png") == 1
    found = json.loads(capsys.readouterr().out)
    assert any("object 7" in reason for reason in found["reasons"])
    assert "object 7" in found["headline"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--suite", "mine", "--reference", "nowhere"], ["nowhere", "no folder"]),
        (["--suite", "ref", "--reference", "mine"], ["mine", "no folder extra", "case of the suite"]),
        (["--suite", "mine", "--reference", "ref"], ["mine", "no folder extra"]),
        (["--suite", "mine/right", "--reference", "ref"], ["holds no folders", "one a case"]),
        (["mine/right"], ["reference", "none given", "--reference"]),
        (["mine/right", "mine/right"], ["given twice"]),
        (["mine/right", "--reference", "ref/right", "--require", "luck"], ["require"]),
        (["mine/right", "--reference", "ref/right", "--objects", "half.npy"], ["half.npy", "not whole"]),
        (["mine/right", "--reference", "ref/right", "--objects", "small.npy"], ["objects", "3 x 3", "24 x 24"]),
        (["mine/right", "--reference", "ref/right", "--objects", "text.png"], ["text.png", "index image"]),
        (["mine/right", "--reference", "ref/right", "--mask", "none.npy"], ["mask", "every pixel"]),
        (["mine/right", "--reference", "ref/right", "--mask", "missing.png"], ["missing.png", "no such file"]),
        (["mine/right", "--reference", "ref/right", "--level", 2], ["level"]),
    ],
)
def test_bad_input_is_a_line(
    replicates: Replicates, run: Run, arguments: list, words: list[str], capsys: pytest.CaptureFixture[str]
):
    for folder in ("mine/right", "ref/right", "ref/extra"):
        replicates(folder, count=4)
    np.save("half.npy", np.full((SIZE, SIZE), 0.5))
    np.save("small.npy", np.zeros((3, 3), int))
    np.save("none.npy", np.zeros((SIZE, SIZE), int))
    Path("text.png").write_text("no image")
    assert run(*arguments, "--junit", "j.xml") == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = [line for line in captured.err.splitlines() if not re.search(r"\d of \d: ", line)]
    assert len(lines) == 1
    for word in words:
        assert word in lines[0]
    assert not Path("j.xml").exists()
    assert not Path("out/judge/index.html").exists()


def test_cases_whose_names_are_one_in_an_address_have_a_page_each(replicates: Replicates, run: Run):
    for name, gain in (("a b", 1.0), ("a-b", 1.05)):
        replicates(f"mine/{name}", gain=gain)
        replicates(f"ref/{name}")
    assert run("--suite", "mine", "--reference", "ref", "--no-hints") == 1
    rows = json.loads(Path("out/judge/results.json").read_text("utf-8"))["cases"]
    kept = {
        row["name"]: json.loads(Path("out/judge", row["page"]).with_name("results.json").read_text()) for row in rows
    }
    assert {name: Path(found["settings"]["images"][0]).parent.name for name, found in kept.items()} == {
        "a b": "a b",
        "a-b": "a-b",
    }


def test_a_broken_case_is_named(replicates: Replicates, run: Run, capsys: pytest.CaptureFixture[str]):
    for folder in ("mine/left", "ref/left", "mine/right", "ref/right"):
        replicates(folder, count=4)
    write_exr(Path("mine/right/00.exr"), {"": np.ones((8, 8, 3))}, {})
    Path("out/judge").mkdir(parents=True)
    Path("out/judge/index.html").write_text("of an earlier run")
    assert run("--suite", "mine", "--reference", "ref") == 2
    assert "case right: " in capsys.readouterr().err
    assert not Path("out/judge/index.html").exists()


# pytest

TESTS = """
import numpy as np
import pytest

rng = np.random.default_rng(1)


def replicates(gain=1.0, noise=0.05):
    return gain * rng.gamma(1 / noise**2, noise**2, (8, 24, 24, 3))


@pytest.mark.parametrize("number", [1, 2])
def test_right(number, assert_equivalent):
    assert_equivalent(replicates(), replicates())


def test_bright(assert_equivalent):
    assert_equivalent(replicates(1.05), replicates(), name="the lamp")


def test_noisy(assert_equivalent):
    assert_equivalent(replicates(noise=0.7), replicates(noise=0.7))


def test_at_once():
    from termwise.testing import assert_equivalent

    assert_equivalent(replicates(1.05), replicates())
"""


def test_tests_of_one_name_on_two_workers_have_a_page_each(tmp_path: Path):
    class Config:
        """Of a worker: what the plugin asks of it."""

        rootpath = tmp_path
        getoption = staticmethod(lambda name: "out")
        getini = staticmethod({"termwise_level": "0.05", "termwise_margin": "0.01"}.__getitem__)

    rng = np.random.default_rng(1)
    ours, reference = rng.gamma(100, 0.01, (2, 4, 8, 8, 3))
    for test in ("a.py::test_box", "b.py::test_box"):
        worker = pytest_plugin._Session(Config())  # type: ignore[arg-type]
        worker.add(test, "test_box", ours, reference, None, {})
        worker.add(test, "test_box", ours, reference, None, {})
        assert [name for _, name, *_ in worker.measured] == ["test_box", "test_box 2"]
    assert len(list((tmp_path / "out").iterdir())) == 4


def test_the_start_of_pytest_loads_nothing_heavy():
    lines = "import sys, termwise.pytest_plugin", "print([n for n in ('numpy', 'scipy', 'PIL') if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout.strip() == "[]", done.stderr


def test_the_plugin_is_registered():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert project["entry-points"]["pytest11"] == {"termwise": "termwise.pytest_plugin"}
    assert not any(each.startswith("pytest") for each in project["dependencies"])


@pytest.mark.slow
def test_a_session_of_pytest(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    pytester.makepyfile(test_it=TESTS)
    done = pytester.runpytest_inprocess("-q", "-p", "termwise.pytest_plugin", "--junitxml=j.xml")
    assert done.ret == 1
    done.assert_outcomes(passed=4, failed=1, errors=2)
    said = done.stdout.str()
    assert re.search(f"ERROR test_it.py::test_bright - the lamp: {BRIGHT}", said)
    assert "ERROR test_it.py::test_noisy - test_noisy: " in said
    assert "UNDERPOWERED" in said
    assert "ERROR test_it.py::test_right" not in said
    assert f"2 of 4 comparisons EQUIVALENT: {pytester.path / 'out/pytest/index.html'}" in said
    rows = json.loads((pytester.path / "out/pytest/results.json").read_text("utf-8"))["cases"]
    assert {row["name"] for row in rows} == {"test_right[1]", "test_right[2]", "the lamp", "test_noisy"}
    (tests,) = {row["tests"] for row in rows}
    assert tests >= 4 * 6  # of the whole session: three channels, two of shape and one of place, or more, for each
    failure = said.partition("AssertionError: ")[2]
    assert re.fullmatch(BRIGHT, failure.splitlines()[0])
    page = re.search(r"report: (.*test_at_once.*index\.html)", failure)
    assert page
    assert Path(page[1]).is_file()
    (reported,) = ElementTree.parse(pytester.path / "j.xml").getroot()
    assert (reported.attrib["failures"], reported.attrib["errors"]) == ("1", "2")


@pytest.mark.slow
def test_workers_hand_on_what_they_measured(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch):
    """Of two workers, each with comparisons of its own: one level, one report."""
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    pytester.makepyfile(test_it=TESTS)
    done = pytester.runpytest_subprocess(
        *("-q", "-p", "termwise.pytest_plugin", "-p", "xdist", "-n", "2", "-k", "right or bright")
    )
    assert done.ret == 1
    done.assert_outcomes(passed=3, errors=1)
    rows = json.loads((pytester.path / "out/pytest/results.json").read_text("utf-8"))["cases"]
    assert {row["name"]: row["verdict"] for row in rows} == {
        "the lamp": "BIASED",
        "test_right[1]": "EQUIVALENT",
        "test_right[2]": "EQUIVALENT",
    }
    assert len({row["tests"] for row in rows}) == 1


# The workflow of the manual

RENDERER = """#!/bin/bash
test "$2 $4 $6" = "--spp --seed --output" && cp "pool/$(basename "$1")/$(($5 - 1)).exr" "$7"
"""


@pytest.mark.slow
def test_the_workflow_runs_step_by_step(tmp_path: Path):
    """All that is shell in it, but the installation; the renderer hands out images that are drawn here, 5 % too bright.

    So its gate fails, by that and nothing else, and what is done always is done.
    """
    (text,) = re.findall(r"^```yaml\n(.*?)^```", (ROOT / "docs/ci.md").read_text("utf-8"), re.DOTALL | re.MULTILINE)
    steps = yaml.safe_load(text)["jobs"]["judge"]["steps"]
    assert [each["run"] for each in steps if each.get("name") == "Install"] == ["python -m pip install ./termwise"]
    rng = np.random.default_rng(3)
    for scene in ("box", "glass"):
        for folder, its_gain in ((f"pool/{scene}", 1.05), (f"references/{scene}", 1.0)):
            for k in range(16):
                write_exr(
                    tmp_path / folder / f"{k}.exr",
                    {"": its_gain * PICTURE * rng.gamma(400, 1 / 400, PICTURE.shape)},
                    {},
                )
    (tmp_path / "my-renderer").write_text(RENDERER)
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/termwise").write_text(
        f"#!{sys.executable}\nimport sys\nsys.path.insert(0, {str(ROOT)!r})\n"
        "from termwise.reports.cli import main\nmain()\n"
    )
    for name in ("my-renderer", "bin/termwise"):
        (tmp_path / name).chmod(0o755)
    environment = os.environ | {
        "PATH": f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "GITHUB_STEP_SUMMARY": str(tmp_path / "summary"),
    }

    def shell(line: str) -> int:
        return subprocess.run(
            ["bash", "-e", "-o", "pipefail", "-c", line], cwd=tmp_path, env=environment, capture_output=True
        ).returncode

    ended = {}
    for step in steps:
        if "run" in step and step["name"] != "Install":
            failed = any(ended.values())
            if not failed or step.get("if") == "always()":
                ended[step["name"]] = shell(step["run"])
    assert ended == {"Render": 0, "Judge": 1, "Summary": 0}
    assert (tmp_path / "summary").read_text("utf-8").count("<details>") == 2
    kept = next(each for each in steps if "upload-artifact" in each.get("uses", ""))["with"]["path"].split()
    assert all((tmp_path / path).exists() for path in kept)
