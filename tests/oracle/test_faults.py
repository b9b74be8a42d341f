"""Runs that are killed, run at once, or cannot write: what stands on the disk is whole, and the next run is right.

A process of its own each. Equal results means `results.json` apart from seconds: nothing else in it may depend on where
a run was cut or on what ran beside it.
"""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from termwise.scenes.store import ROOT, cache_folder
from tests.scenes import FLOOR

SCENE = FLOOR.replace("[12, 9]", "[8, 6]")

STUDY = """
scenes = ["SCENE"]
resolution = [8, 6]
replicates = 4
reference_replicates = 4
reference_spp = 4
physical_spp = 2

[samples]
ambient = 2
direct = 2
"""

# A process that ends itself by SIGKILL in place of its Nth rename: beside what it has finished lies a temporary file.
CODE = """
import os, pathlib, signal, sys
from termwise.reports import cli
from termwise.reports import run
last, cache = int(sys.argv.pop(1)), pathlib.Path(sys.argv.pop(1))
rename, count = pathlib.Path.replace, 0

def replace(path, target):
    global count
    count += 1
    if count == last:
        os.kill(os.getpid(), signal.SIGKILL)
    return rename(path, target)

pathlib.Path.replace = replace
run.cache_folder = lambda: cache
try:
    cli.main()
finally:
    (cache.parent / "renames").write_text(str(count))
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("faults")
    (folder / "scene.toml").write_text(SCENE)
    (folder / "study.toml").write_text(STUDY.replace("SCENE", str(folder / "scene.toml")))
    return folder


def start(files: Path, *, last: int = 0, before: tuple[str, ...] = ()) -> subprocess.Popen[str]:
    """`termwise compare`, killed at its rename `last`; kernels are those of the project."""
    arguments = [str(last), str(files / "cache"), "compare", "--quiet", "--study", str(files / "study.toml")]
    return subprocess.Popen(
        [*before, sys.executable, "-c", CODE, *arguments, "--out", str(files / "out")],
        cwd=ROOT,
        env=os.environ | {"TERMWISE_CACHE": str(cache_folder())},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(process: subprocess.Popen[str]) -> None:
    _, messages = process.communicate()
    assert process.returncode in (0, 1), messages


def afresh(files: Path) -> None:
    for name in ("cache", "out"):
        shutil.rmtree(files / name, ignore_errors=True)


def timeless(value: Any) -> Any:
    """JSON without its seconds, at any depth, those in sentences included."""
    if isinstance(value, dict):
        return {name: timeless(each) for name, each in value.items() if "seconds" not in name and name != "spent"}
    if isinstance(value, str):
        return re.sub(r"[\d.]+\s(?:ms|s|min|h|d)\b", "", value)
    return [timeless(each) for each in value] if isinstance(value, list) else value


def results(files: Path) -> Any:
    return timeless(json.loads((files / "out" / "compare" / "results.json").read_text("utf-8")))


def pages(files: Path) -> list[str]:
    return sorted(
        path.relative_to(files / "out").as_posix() for path in (files / "out").rglob("[!.]*") if path.is_file()
    )


@pytest.fixture(scope="module")
def undisturbed(files: Path) -> tuple[Any, list[str], int]:
    """Results, names of all files, and the number of renames of a run that nothing disturbs."""
    afresh(files)
    finish(start(files))
    return results(files), pages(files), int((files / "renames").read_text())


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_killed_and_run_again_gives_the_same(seed: int, files: Path, undisturbed: tuple[Any, list[str], int]):
    """A kill at a random rename, among replicates, images or pages, then a run to the end."""
    expected, names, renames = undisturbed
    afresh(files)
    process = start(files, last=int(np.random.default_rng(seed).integers(1, renames + 1)))
    _, messages = process.communicate()
    assert process.returncode == -signal.SIGKILL, messages
    finish(start(files))
    assert results(files) == expected
    assert pages(files) == names


@pytest.mark.slow
def test_two_runs_at_once_in_one_folder(files: Path, undisturbed: tuple[Any, list[str], int]):
    expected, names, _ = undisturbed
    afresh(files)
    for process in [start(files), start(files)]:
        finish(process)
    assert results(files) == expected
    assert pages(files) == names


@pytest.mark.slow
@pytest.mark.parametrize("name", ["out", "cache"])
def test_a_folder_that_may_not_be_written_is_one_line(name: str, files: Path):
    afresh(files)
    (files / name).mkdir(mode=0o555)
    before: tuple[str, ...] = ()
    if os.geteuid() == 0:  # who may write everywhere, but for this
        if shutil.which("setpriv") is None:
            pytest.skip("root, and no setpriv to take its rights")
        before = ("setpriv", "--bounding-set", "-dac_override", "--inh-caps", "-dac_override")
    output, messages = (process := start(files, before=before)).communicate()
    assert process.returncode == 2, messages
    assert output == ""
    assert messages.startswith(f"termwise: {files / name}")
    assert messages.endswith("Permission denied\n")
    assert messages.count("\n") == 1
    assert list((files / name).iterdir()) == []
    assert not (files / "out" / "compare" / "results.json").exists()
