"""README and manual: what they name exists, what they type can be typed, what they run runs."""

import importlib
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest

import termwise
from termwise.reports import cli
from termwise.scenes import load
from termwise.scenes.model import LIGHTS, Ambient, Camera, Photons, Toggles
from termwise.scenes.store import ROOT

README = ROOT / "README.md"
PAGES = [README, *sorted((ROOT / "docs").glob("*.md"))]
FOLDERS = "scenes|renderer|reference|reports|tests|examples|docs|termwise"

page = pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)


def fenced(path: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", path.read_text("utf-8"), re.DOTALL | re.MULTILINE)


def prose(path: Path) -> str:
    return re.sub(r"^```.*?^```", "", path.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)


def spans(path: Path) -> list[str]:
    return re.findall(r"`([^`\n]+)`", prose(path))


def anchors(path: Path) -> set[str]:
    titles = re.findall(r"^#+ (.*)$", prose(path), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def test_readme_is_a_page():
    assert len(README.read_text("utf-8").splitlines()) <= 130


@page
def test_links_lead_somewhere(path: Path):
    for target in re.findall(r"\]\(([^)]+)\)", prose(path)):
        if not target.startswith("http"):
            name, _, anchor = target.partition("#")
            there = (path.parent / name).resolve() if name else path
            assert there.exists(), target
            assert not anchor or anchor in anchors(there), target


@page
def test_files_that_are_named_exist(path: Path):
    for span in spans(path):
        if re.fullmatch(rf"({FOLDERS})/[\w./-]*", span) and "NAME" not in span:
            assert (ROOT / span).exists(), span


@page
def test_python_names_exist(path: Path):
    for span in spans(path):
        found = re.match(r"(?:termwise\.)?((?:scenes|renderer|reference|reports)(?:\.\w+)+)", span)
        if found:
            module, _, name = found[1].rpartition(".")
            try:
                assert hasattr(importlib.import_module(f"termwise.{module}"), name), span
            except ModuleNotFoundError:
                pytest.fail(f"{span}: no such module")


def typed(path: Path) -> list[str]:
    """The lines of all shell blocks, without their comments."""
    lines = [line.partition("  #")[0].strip() for block in fenced(path, "sh") for line in block.splitlines()]
    return [line for line in lines if line]


def app_of(words: list[str]) -> tuple[Any, list[str]]:
    """The command that words begin with, and what is left of them."""
    here: Any = cli.app
    for at, word in enumerate(words):
        if word not in [*here]:
            return here, words[at:]
        here = here[word]
    return here, []


@page
def test_command_lines_are_understood(path: Path):
    for line in typed(path):
        if line.startswith("termwise "):
            command, _, _ = cli.app.parse_args(shlex.split(line)[1:], exit_on_error=False, print_error=False)
            assert command is not None, line


@page
def test_commands_in_the_text_have_their_options(path: Path):
    for span in spans(path):
        words = span.split()
        if words[0] == "termwise" and len(words) > 1:
            command, rest = app_of(words[1:])
            assert command is not cli.app, span
            names = {name for each in command.assemble_argument_collection() for name in each.names}
            assert {word for word in rest if word.startswith("--")} <= names, span


@page
def test_make_has_its_targets(path: Path):
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE))
    for line in [*typed(path), *spans(path)]:
        found = re.match(r"make (\w+)", line)
        assert not found or found[1] in targets, line


def test_the_readmes_verdict(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """On images made here."""
    monkeypatch.chdir(tmp_path)
    (block,) = fenced(README, "python")
    random = np.random.default_rng(1)
    names = {name: random.gamma(4.0, 0.25, (8, 16, 16, 3)) for name in ("images", "reference")}
    exec(block, names)
    assert names["verdict"].sentence  # type: ignore[attr-defined]
    assert (tmp_path / "out/mine/index.html").is_file()


def test_the_neutral_file_of_the_manual(tmp_path: Path):
    (block,) = fenced(ROOT / "docs" / "exchange.md", "python")
    names: dict[str, Any] = {"folder": tmp_path}
    exec(block, names)
    assert names["path"] == tmp_path / "monkey.json"
    assert names["path"].is_file()


def test_the_example_is_the_one_that_is_printed():
    example = (ROOT / "examples" / "gamma_space.py").read_text("utf-8")
    example = re.sub(r'    """.*?"""\n', "", example, flags=re.DOTALL)
    (block,) = [each for each in fenced(ROOT / "docs" / "engines.md", "python") if "gamma_space" in each]
    assert block.strip() in example


@pytest.mark.slow
def test_the_walk_through(tmp_path: Path):
    """All of it, as one program, in a process of its own: it adds to the tables."""
    program = tmp_path / "extending.py"
    program.write_text("\n".join(fenced(ROOT / "docs" / "extending.md", "python")), "utf-8")
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, program.name],
        cwd=tmp_path,
        env=os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": paths},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr


def test_public_names_are_in_the_manual():
    text = (ROOT / "docs" / "python.md").read_text("utf-8")
    assert [name for name in termwise.__all__ if f"termwise.{name}" not in text] == []


def test_every_field_of_a_scene_file_is_in_the_manual():
    """By its path; those of a shape in the table of shapes."""
    text = (ROOT / "docs" / "scenes.md").read_text("utf-8")
    shapes = {field.name for kind in load._SHAPES.values() for field in attrs.fields(kind)}
    placed = {field.name for field in attrs.fields(load._Placed)}
    kinds = {"camera": Camera, "ambient": Ambient, "sky": load._SkyFile, "photons": Photons, "toggles": Toggles}
    paths = {f"{name}.{field.name}" for name, kind in kinds.items() for field in attrs.fields(kind)}
    paths |= {f"lights.{field.name}" for kind in LIGHTS.values() for field in attrs.fields(kind)}
    paths |= {"lights.kind", *(f"objects.{name}" for name in placed)}
    paths |= {f"….{field.name}" for field in attrs.fields(load._Image)}
    paths |= {field.name for field in attrs.fields(load._SceneFile)} - {*kinds, "lights", "objects"} | shapes - placed
    assert len(paths) > 50
    assert {path for path in paths if f"`{path}`" not in text} == set()
