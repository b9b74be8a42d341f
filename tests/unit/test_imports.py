"""Importing costs what is asked for, and nothing beside a user's script stands in the way.

Rationale: those who judge the images of their own renderer have a `renderer.py`, and need neither Numba nor Mitsuba.
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import termwise

THEIRS = "renderer.py", "scenes.py", "reference.py", "reports/__init__.py"
HEAVY = "numba", "llvmlite", "mitsuba", "drjit", "xarray", "pandas"
"""What only extras bring."""


@pytest.fixture
def theirs(tmp_path: Path) -> Path:
    """A user's folder with modules of the names of ours."""
    for name in THEIRS:
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text("raise RuntimeError(__file__)\n")
    return tmp_path


def run(folder: Path, *lines: str) -> Any:
    """What a user's script prints, as JSON."""
    script = folder / "script.py"
    script.write_text("\n".join(("import json, sys", *lines)))
    environment = os.environ | {"PYTHONPATH": str(Path(termwise.__file__).parents[1])}
    done = subprocess.run(
        [sys.executable, script], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_judging_loads_nothing_that_extras_bring(theirs: Path):
    word, loaded = run(
        theirs,
        "import numpy as np, termwise",
        "rng = np.random.default_rng(1)",
        "sides = [rng.random((4, 16, 16, 3)) for _ in range(2)]",
        "objects = np.zeros((16, 16), int)",
        "judgement = termwise.judge(*sides, objects=objects)",
        "judgement.save('out')",
        "word = judgement.verdict",
        f"print(json.dumps([word, [name for name in {HEAVY} if name in sys.modules]]))",
    )
    assert word in ("UNDERPOWERED", "BIASED", "EQUIVALENT")
    assert loaded == []


def test_furnaces_load_neither_numba_nor_mitsuba(theirs: Path):
    """First contact of a renderer that is not there: the page is written all the same."""
    (theirs / "mine.toml").write_text('name = "mine"\ncommand = ["./mine", "{scene}", "{seed}"]\nsupports = []\n')
    found, loaded = run(
        theirs,
        "from pathlib import Path",
        "import termwise",
        "from termwise.reports.judging import engines",
        "mine = termwise.engine('mine.toml').engine",
        "judged = engines.furnace([mine], Path('out'), engines.Asking(replicates=4))",
        "assert Path('out/index.html').is_file()",
        f"loaded = [name for name in {HEAVY} if name in sys.modules]",
        "print(json.dumps([[each.reason for each in judged.unjudged], loaded]))",
    )
    (reason,) = found
    assert reason.startswith("mine: command: ")
    assert reason.endswith("no such program is here, or it cannot be executed")
    assert loaded == []


def test_importing_it_loads_no_more_than_numpy(theirs: Path):
    heavy = (*HEAVY, "scipy.special", "scipy.stats", "scipy.sparse", "matplotlib", "colour")
    loaded = run(
        theirs,
        "import termwise",
        "termwise.judge",
        f"print(json.dumps([name for name in {heavy} if name in sys.modules]))",
    )
    assert loaded == []


def test_the_judge_command_waits_for_no_mesh_no_metric_no_figure(theirs: Path):
    heavy = (*HEAVY, "trimesh", "colour", "skimage", "matplotlib", "dask")
    loaded = run(
        theirs,
        "from termwise.reports import cli, judging",
        "from termwise.reports.cli import judging",
        "from termwise.reports.pages import judge, pictures",
        "from termwise.scenes.images import replicates",
        "import numpy as np",
        "pictures.display(np.ones((2, 2, 3)), exposure=1.0)",
        f"print(json.dumps([name for name in {heavy} if name in sys.modules]))",
    )
    assert loaded == []


def test_public_names_are_ours_beside_modules_of_the_same_names(theirs: Path):
    homes = run(
        theirs,
        "import termwise",
        "homes = {name: getattr(termwise, name) for name in termwise.__all__}",
        "print(json.dumps({n: getattr(v, '__module__', None) or v.__name__ for n, v in homes.items()}))",
    )
    assert set(homes) == set(termwise.__all__)
    assert all(home.startswith("termwise.") for home in homes.values()), homes
