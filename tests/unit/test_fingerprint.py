"""What decides whether images of a Python estimator are kept: equal code on equal values, and nothing less."""

import functools
import importlib
import os
import subprocess
import sys

import numpy as np
import pytest

import termwise
from termwise.renderer.fingerprint import Unknown, fingerprint
from termwise.renderer.terms.estimator import Called
from termwise.scenes.store import ROOT

LEVEL = 3.0
GENERATOR = np.random.default_rng(0)


def scaled(scene, samples, seed):
    return np.full((2, 2, 3), LEVEL)


def outer(scene, samples, seed):
    return [scaled(scene, each, seed) for each in range(samples)]


def stateful(scene, samples, seed):
    return GENERATOR.random(3)


class Constant:
    def __init__(self, value):
        self.value = value

    def __call__(self, scene, samples, seed):
        return self.value


def closed_over(value):
    return lambda scene, samples, seed: value


def test_it_follows_values_through_calls(monkeypatch):
    """A global two calls away counts; put back, the fingerprint is the first one again."""
    before = fingerprint(outer)
    monkeypatch.setitem(globals(), "LEVEL", 4.0)
    assert fingerprint(outer) != before
    monkeypatch.undo()
    assert fingerprint(outer) == before


@pytest.mark.parametrize(
    "make",
    [
        closed_over,
        Constant,
        lambda value: functools.partial(scaled, seed=value),
        lambda value: closed_over({"a": [value]}),
        lambda value: closed_over(np.array([value])),
        lambda value: closed_over(Constant(value)),
    ],
)
def test_equal_values_are_equal_and_others_are_not(make):
    assert fingerprint(make(1.0)) == fingerprint(make(1.0)) != fingerprint(make(2.0))


def test_code_counts():
    assert fingerprint(lambda scene, samples, seed: 1) != fingerprint(lambda scene, samples, seed: 2)
    assert fingerprint(lambda scene, samples, seed: scene) != fingerprint(lambda scene, samples, seed: seed)


def test_names_of_ours_that_are_resolved_later_change_nothing(monkeypatch):
    """`termwise` fills its names as they are asked for: who asked before decides nothing of what is computed."""

    def function(scene):
        return termwise.load(scene)

    monkeypatch.delitem(vars(termwise), "load", raising=False)
    before = fingerprint(function)
    assert termwise.load is not None
    assert fingerprint(function) == before


def test_what_has_no_content_is_named():
    with pytest.raises(Unknown, match="GENERATOR is a Generator"):
        fingerprint(stateful)
    assert Called(stateful, "mine").fingerprint() == "mine"


@pytest.mark.slow
def test_it_is_the_same_in_every_process():
    """Sets have another order for each hash seed."""
    source = "def f(scene, samples, seed):\n    return seed in {'red', 'green', 'blue', 'grey'}"
    code = (
        "from termwise.renderer.fingerprint import fingerprint\n"
        f"exec(compile({source!r}, 'user.py', 'exec'))\n"
        "print(fingerprint(f))"
    )
    found = {
        subprocess.run(
            [sys.executable, "-c", code],
            cwd=ROOT,
            env=os.environ | {"PYTHONHASHSEED": str(seed)},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in range(4)
    }
    assert len(found) == 1


def test_a_users_module_counts_whatever_its_name(tmp_path, monkeypatch):
    """Its source, and its values as they are when asked; the name of an installed module hides neither."""
    (tmp_path / "shading.py").write_text("LEVEL = 1.0\ndef light(seed):\n    return LEVEL * seed\n")
    monkeypatch.syspath_prepend(tmp_path)
    shading = importlib.import_module("shading")
    monkeypatch.setattr(shading.light, "__module__", "statistics")

    def mine(scene, samples, seed):
        return shading.light(seed)

    before = fingerprint(mine)
    monkeypatch.setattr(shading, "LEVEL", 2.0)
    changed = fingerprint(mine)
    monkeypatch.setattr(shading, "LEVEL", 1.0)
    assert changed != before == fingerprint(mine)
    (tmp_path / "shading.py").write_text("LEVEL = 1.0\ndef light(seed):\n    return LEVEL * seed  # other\n")
    assert fingerprint(mine) != before
