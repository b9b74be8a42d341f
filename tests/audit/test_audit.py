"""The audit's own machinery, on few runs: `make audit` counts the many."""

import ast
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor as Threads
from queue import SimpleQueue

import attrs
import numpy as np
import pytest
from rich.console import Console

from termwise.renderer.plan import check, skipped
from termwise.renderer.terms import find
from termwise.scenes.load import load
from termwise.scenes.store import ROOT
from tests.audit import __main__ as command
from tests.audit import faults, history, nulls, power, switches
from tests.audit.plants import BACKGROUND, PLANTS, Test
from tests.audit.unseen import ALL, UNSEEN
from tests.audit.worker import Case
from tests.verdict.synthetic import picture, replicates

TINY = Case("cornell_box", "ambient", "constant", samples=1, side=2)
"""A few camera rays, and no other, which plain Python traces while a compiler would begin."""
GAIN = next(plant for plant in PLANTS if plant.name == "1 % gain")


@pytest.mark.parametrize("plant", ALL, ids=lambda plant: plant.name)
def test_every_plant_fits_the_sources(plant):
    """Each text is there exactly once, and the fault changes it into what is still Python, or TOML."""
    changed = plant.changed(ROOT)
    assert changed != (ROOT / plant.path).read_text("utf-8")
    if plant.path.endswith(".py"):
        compile(changed, plant.path, "exec")


def test_a_fault_names_nothing_that_is_not_there(tmp_path):
    """One that fails with a NameError would be found so after an hour, and be no fault of an image."""
    for number, plant in enumerate(ALL):
        if plant.path.endswith(".py"):
            (tmp_path / f"fault{number}.py").write_text(plant.changed(ROOT), "utf-8")
    words = ["ruff", "check", "--isolated", "--no-cache", "--select", "F821", "--output-format", "concise", tmp_path]
    done = subprocess.run([sys.executable, "-m", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


CASES = list(dict.fromkeys(plant.shown for plant in ALL if isinstance(plant.shown, Case)))


@pytest.mark.parametrize("plant", [plant for plant in ALL if plant.path.endswith(".toml")], ids=lambda each: each.name)
def test_a_fault_of_a_scene_file_can_be_loaded(plant, tmp_path):
    assert plant.changed(ROOT) != (ROOT / plant.path).read_text("utf-8")
    (tmp_path / "scene.toml").write_text(plant.changed(ROOT), "utf-8")
    load(tmp_path / "scene.toml")


@pytest.mark.parametrize("case", CASES, ids=str)
def test_every_case_is_a_scene_that_its_variant_fits(case: Case):
    scene, variant = case.build(), find(case.term, case.variant)
    check(scene, variant)
    assert skipped(scene, variant.term) is None
    assert variant.limit(scene, case.samples).term == case.term


class _Turned(ast.NodeTransformer):
    """Sources with the switches turned to one fault, as if no other had ever been there."""

    def __init__(self, number: int) -> None:
        self.number = number

    def visit_ImportFrom(self, node: ast.ImportFrom) -> ast.AST | None:
        return None if node.module == switches.MODULE else node

    def visit_If(self, node: ast.If) -> ast.stmt | list[ast.stmt]:
        self.generic_visit(node)
        match node.test:
            case ast.Compare(left=ast.Call(func=ast.Name(id="planted")), comparators=[ast.Constant(value=number)]):
                return node.body if number == self.number else node.orelse
        return node


def test_a_switch_that_is_on_is_the_fault_and_nothing_else():
    """With none on the sources are as they were; each file that is held behind switches is tried with each of them."""
    texts, held = switches.switched(PLANTS, ROOT)
    for path, text in texts.items():
        compile(text, path, "exec")
        sound = ast.parse((ROOT / path).read_text("utf-8"))
        here = {number: ast.parse(PLANTS[number].changed(ROOT)) for number in held if PLANTS[number].path == path}
        assert here
        for number, faulty in {switches.NONE: sound, **here}.items():
            assert ast.dump(_Turned(number).visit(ast.parse(text))) == ast.dump(faulty)


def test_nearly_all_faults_of_images_can_be_switched():
    """Each that cannot has kernels of its own compiled."""
    shown = [plant for plant in PLANTS if isinstance(plant.shown, Case) and plant.path.endswith(".py")]
    assert len(switches.switched(shown, ROOT)[1]) >= 0.9 * len(shown)


_SOURCE = '''"""A module."""

from __future__ import annotations

ONE = 1.0


@wrapped(
    ONE,
)
def f(x: float) -> float:
    for i in range(2):
        if x > i:
            y = x
        elif x < -i:
            # A comment.
            y = (
                x
                + ONE
            )
        else:
            y = 0.0
    return y
'''


@pytest.mark.parametrize(
    ("before", "after", "first"),
    [
        ("ONE = 1.0", "ONE = 2.0", None),
        ("    ONE,\n", "    2.0,\n", None),
        ("x: float", "x: int", None),
        ("return y", "return 2.0 * y", "    if planted() == 0:"),
        ("                + ONE\n", "", "            if planted() == 0:"),
        ("x > i", "x >= i", "        if planted() == 0:"),
        ("x < -i", "x <= -i", "        if planted() == 0:"),
        ("# A comment.\n            y = (", "z = 0\n            y = (", "        if planted() == 0:"),
        ("range(2)", "range(3)", "    if planted() == 0:"),
        ("            y = x\n", "", "            if planted() == 0:"),
    ],
)
def test_a_switch_stands_around_whole_statements_of_a_function(tmp_path, before, after, first):
    """Around the least of them; there is none around what is defined once: a constant, a decorator, a signature."""
    (tmp_path / "module.py").write_text(_SOURCE, "utf-8")
    plant = attrs.evolve(GAIN, path="module.py", before=before, after=after)
    texts, held = switches.switched([plant], tmp_path)
    assert held == (frozenset() if first is None else {0})
    if first is not None:
        text = texts["module.py"]
        compile(text, "module.py", "exec")
        assert first in text.splitlines()
        sound = ast.dump(_Turned(switches.NONE).visit(ast.parse(text)))
        assert sound == ast.dump(ast.parse(_SOURCE))


def test_faults_that_meet_stand_behind_one_switch(tmp_path):
    (tmp_path / "module.py").write_text(_SOURCE, "utf-8")
    pairs = [("x > i", "x >= i"), ("                + ONE\n", ""), ("            y = 0.0", "            y = 1.0")]
    plants = [attrs.evolve(GAIN, path="module.py", before=before, after=after) for before, after in pairs]
    texts, held = switches.switched(plants, tmp_path)
    assert held == {0, 1, 2}
    for number, plant in enumerate(plants):
        turned = ast.dump(_Turned(number).visit(ast.parse(texts["module.py"])))
        assert turned == ast.dump(ast.parse(plant.changed(tmp_path)))


def test_plants_are_enough_and_have_names_of_their_own():
    assert len({plant.name for plant in ALL}) == len(ALL) >= 70
    assert len({(plant.path, plant.before, plant.after) for plant in PLANTS}) == len(PLANTS)
    assert len({plant.path for plant in ALL}) >= 20


@pytest.mark.parametrize("plant", UNSEEN, ids=lambda plant: plant.name)
def test_what_shows_an_unseen_fault_exists(plant):
    """By its name: a test that was renamed would end the audit only after an hour."""
    assert isinstance(plant.shown, Test)
    path, _, name = plant.shown.name.partition("::")
    assert f"def {name.partition('[')[0]}(" in (ROOT / path).read_text("utf-8")


@pytest.mark.parametrize("before", ["no such line", "import "])
def test_a_plant_that_does_not_fit_is_an_error(before):
    """Sources that have moved on must not turn into a fault that is never planted, or planted twice."""
    with pytest.raises(ValueError, match=r"1 % gain.*matches: allowed is exactly one"):
        attrs.evolve(GAIN, before=before).changed(ROOT)


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Iterator[faults.Tree]:
    """One copy of the sources for all tests; its kernels are plain Python."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TERMWISE_CACHE", str(tmp_path_factory.mktemp("cache")))
        patch.setenv("NUMBA_DISABLE_JIT", "1")
        yield faults.Tree.copied(tmp_path_factory.mktemp("audit"))


@pytest.mark.slow
def test_a_copy_is_rendered_with_its_fault_and_without_it_again(tree, monkeypatch):
    """The gain is exact, the sources stay as they are, and what follows in the same copy has no fault."""
    source = (ROOT / GAIN.path).read_bytes()
    fault = tree.replicates(TINY, GAIN, seed=3, ahead=(5,))
    sound = tree.replicates(TINY, seed=3)
    later = tree.replicates(TINY, seed=5)
    assert (tree.root / GAIN.path).read_bytes() == source
    assert fault.shape == (faults.REPLICATES, 2, 2, 3)
    np.testing.assert_allclose(fault, 1.01 * sound, rtol=1e-6)
    # What was rendered ahead is the fault's, of its own seed, and needs no process any more.
    monkeypatch.setattr(faults.Tree, "_run", None)
    np.testing.assert_allclose(tree.replicates(TINY, GAIN, seed=5), 1.01 * later, rtol=1e-6)
    assert not np.array_equal(sound, later)
    assert (ROOT / GAIN.path).read_bytes() == source


def test_a_crash_catches_nothing(tree):
    """A fault that ends the process is no catch of the verdict: it is named."""
    first = '"""The paper'
    crash = attrs.evolve(
        GAIN, path="renderer/__init__.py", before=first, after=f'raise ArithmeticError("planted")\n{first}'
    )
    with pytest.raises(RuntimeError, match="planted"):
        tree.replicates(TINY, crash, seed=3)


def test_a_fault_that_crashes_costs_the_audit_no_other(monkeypatch):
    crash = attrs.evolve(GAIN, shown=TINY, name="a crash")

    def show(plant, by, seed, ahead, common):
        if plant is crash:
            raise RuntimeError("planted")
        return np.ones((4, 2, 2, 3)) if plant is None else np.full((4, 2, 2, 3), np.nan)

    monkeypatch.setattr(faults, "truth", lambda case, *, seed: np.ones((4, 2, 2, 3)))
    monkeypatch.setattr(faults, "_show", show)
    with Threads(1) as threads:
        _, found = faults.run((crash, attrs.evolve(GAIN, shown=TINY)), seed=3, executor=threads, report=lambda *_: None)
        assert (found["a crash"].verdict, found["a crash"].text) == (faults.CRASHED, "planted")
        assert [outcome.caught for outcome in found.values()] == [False, True]


def test_a_fault_in_no_image_is_caught_by_its_test(tree):
    """The test fails with the fault alone."""
    plant = next(plant for plant in UNSEEN if "any origin" in plant.name)
    assert isinstance(plant.shown, Test)
    assert tree.test((plant.shown,)).verdict == faults.PASSED
    found = tree.test((plant.shown,), plant)
    assert (found.verdict, found.by, found.caught) == (faults.FAILED, ("test",), True)
    assert "test_strangers_are_refused" in found.text


@pytest.mark.slow
def test_a_switch_in_a_kernel_gives_the_bits_of_the_fault_alone(tmp_path, monkeypatch):
    plant = next(plant for plant in PLANTS if plant.name == "sky: left for right")
    case = attrs.evolve(BACKGROUND, side=4, samples=1)
    images = []
    for name, plants in ("switched", [plant]), ("planted", []):
        monkeypatch.setenv("TERMWISE_CACHE", str(tmp_path / name))
        tree = faults.Tree.copied(tmp_path / name, plants)
        assert bool(tree.switches) == (name == "switched")
        images.append([tree.replicates(case, each, seed=3) for each in (None, plant)])
    np.testing.assert_array_equal(*images)
    assert not np.array_equal(*images[0])


@pytest.mark.slow
def test_faults_and_controls_are_shown_by_an_executor(tree, monkeypatch):
    """Those of a case and of a test, each without a fault too; what an executor's process copied it uses again."""
    refused = next(plant for plant in UNSEEN if "any origin" in plant.name)
    double = attrs.evolve(GAIN, shown=TINY, after=GAIN.after.replace("1.01", "2.0"))
    sound = tree.replicates(TINY, seed=4)
    monkeypatch.setattr(faults, "truth", lambda case, *, seed: sound)
    monkeypatch.setattr(faults, "_trees", SimpleQueue())
    faults._trees.put(tree)
    with Threads(1) as threads:
        controls, found = faults.run((double, refused), seed=3, executor=threads, report=lambda *_: None)
    assert [outcome.caught for outcome in controls.values()] == [False, False]
    assert [outcome.caught for outcome in found.values()] == [True, True]
    assert faults._trees.get_nowait() is tree
    assert faults._trees.empty()


def test_what_catches_a_fault_is_named():
    """A gain by the mean, two halves that cancel by the shape and the place, NaN and equal seeds by a check."""
    rng = np.random.default_rng(5)
    mean = picture(64, 64)

    def draw(mean: np.ndarray) -> np.ndarray:
        return replicates(rng, mean, noise=0.05)

    reference = draw(mean)
    assert faults.judge(draw(mean), reference).by == ()
    assert "mean" in faults.judge(draw(1.05 * mean), reference).by
    halves = np.where(np.arange(64) < 32, 1.05, 1 - 0.05)[:, None]
    halved = faults.judge(draw(mean * halves), reference)
    assert {"shape", "place"} <= set(halved.by)
    broken = draw(mean)
    broken[2, 3, 4, 1] = np.nan
    assert faults.judge(broken, reference).by == ("check",)
    twice = faults.judge(np.repeat(draw(mean)[:8], 2, axis=0), reference)
    assert (twice.verdict, twice.by) == ("REFUSED", ("check",))
    noisy = replicates(rng, mean, noise=8.0)
    assert not faults.judge(noisy, replicates(rng, mean, noise=8.0)).caught


def test_nulls_count_alarms():
    """Equal laws: hardly any alarm; a gain: an alarm in every run."""
    rng = np.random.default_rng(6)
    mean = picture(16, 16)
    runs = [(replicates(rng, mean), replicates(rng, mean)) for _ in range(20)]
    assert nulls.judged(runs).alarms <= 4
    assert nulls.judged((2 * ours, reference) for ours, reference in runs) == nulls.Alarms(20, 20, 20)


@pytest.mark.parametrize("law", nulls.LAWS)
def test_noise_of_every_law_has_no_bias(law):
    """Its mean over 2000 images is 1 within 5 standard errors, which the images themselves give."""
    images = nulls.LAWS[law](np.random.default_rng(7), (2000, nulls.SIDE, nulls.SIDE, 1)).mean(axis=(1, 2, 3))
    assert abs(images.mean() - 1) < 5 * images.std() / np.sqrt(len(images))


def test_awkward_nulls_are_all_there_is():
    """Every law, on each side and on both, each K with each R; and the limit of both sides is one."""
    listed = nulls.awkward(10_000)
    assert sum(runs for _, runs in listed) >= 10_000
    assert len({null for null, _ in listed}) == len(listed) == len(nulls.LAWS) * 3 * 16
    rng = np.random.default_rng(8)
    ours, reference = nulls.Null("half black", "ours", 4, 32).draw(rng)
    assert (ours.shape, reference.shape) == ((4, 16, 16, 3), (32, 16, 16, 3))
    assert not ours[:, :, :8].any()
    assert not reference[:, :, :8].any()
    assert ours.std(axis=0).mean() > 3 * reference.std(axis=0).mean()


def test_synthetic_nulls_are_counted():
    """By threads, which have nothing to import; the same seeds give the same alarms for any number of them."""
    few = nulls.Null("skewed", "ours", 4, 8)
    wanted = [(few, 2), (nulls.Null("correlated", "both sides", 8, 4), 1), (few, 3)]
    found = [nulls.synthetic(wanted, seed=1, executor=pool, report=lambda *_: None) for pool in map(Threads, (2, 1))]
    assert [alarms.runs for alarms in found[0].values()] == [5, 1]
    assert found[0] == found[1]


def test_synthetic_nulls_are_counted_by_what_they_share():
    alarms = {
        nulls.Null("skewed", "ours", 4, 8): nulls.Alarms(10, 1, 2),
        nulls.Null("skewed", "both sides", 8, 4): nulls.Alarms(5, 2, 2),
        nulls.Null("correlated", "ours", 4, 8): nulls.Alarms(1, 0, 0),
    }
    assert nulls.grouped(alarms, lambda null: null.law) == {
        "skewed": nulls.Alarms(15, 3, 4),
        "correlated": nulls.Alarms(1, 0, 0),
    }


ENTRY = {
    "date": "2026-11-29",
    "planted": 100,
    "caught": 98,
    "missed": ["a", "b"],
    "rendered": {"runs": 224, "alarms": 3},
    "ordinary": {"runs": 3000, "alarms": 20},
    "awkward": {"runs": 10_000, "alarms": 200},
    "laws": {"skewed": {"runs": 1000, "alarms": 30}},
}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({}, []),
        ({"caught": 100, "missed": []}, []),
        ({"awkward": {"runs": 10_000, "alarms": 215}}, []),
        ({"caught": 97, "missed": ["a", "b", "c"]}, ["score: 97 of 100", "missed, but not on 2026-11-29: c"]),
        ({"missed": ["a", "c"]}, ["missed, but not on 2026-11-29: c"]),
        ({"awkward": {"runs": 10_000, "alarms": 290}}, ["awkward nulls: 290 false alarms of 10000, 200 of 10000"]),
        ({"rendered": {"runs": 224, "alarms": 20}}, ["rendered nulls: 20 false alarms of 224"]),
        ({"laws": {"skewed": {"runs": 1000, "alarms": 70}}}, ["skewed: 70 false alarms of 1000, 30 of 1000"]),
        ({"laws": {"another": {"runs": 1000, "alarms": 70}}}, []),
    ],
)
def test_the_history_may_not_fall(change, said):
    found = history.fallen(ENTRY | change, ENTRY)
    assert len(found) == len(said)
    for text, beginning in zip(found, said, strict=True):
        assert text.startswith(beginning)


def test_the_first_run_of_the_history_had_no_awkward_noise():
    first = {name: value for name, value in ENTRY.items() if name not in ("awkward", "laws")}
    assert history.fallen(ENTRY, first) == []
    assert all({"date", "planted", "caught", "missed", "rendered", "ordinary"} <= set(each) for each in history.read())


def test_large_errors_are_found_and_small_ones_are_not():
    """One pair of noises: all of the picture, and a pixel; what is found is found at any larger size."""
    run = power.Run((3, 0))
    assert run.finds("mean", power.SIDE**2, 0.02)
    assert not run.finds("blotch", 1, 0.002)
    assert run.smallest("blotch", 1024) <= power.SIZES.index(0.25)


@pytest.mark.parametrize("kind", power.KINDS)
def test_errors_are_as_large_and_as_wide_as_they_are_said_to_be(kind):
    """So many pixels change; what cancels leaves means, and luminance in every pixel, as they were."""
    limit = picture(power.SIDE, power.SIDE)
    wrong = power.KINDS[kind](np.random.default_rng(9), limit, 256, 0.25)
    changed = (wrong != limit).any(axis=-1)
    assert changed.sum() == 256
    relative = np.abs(wrong / limit - 1)[changed].max(axis=0)
    np.testing.assert_allclose(relative[0], 0.25, rtol=0.05)
    if kind == "colour":
        np.testing.assert_allclose(wrong @ [0.2126, 0.7152, 0.0722], limit @ [0.2126, 0.7152, 0.0722])
        np.testing.assert_allclose(wrong.mean(axis=(0, 1)), limit.mean(axis=(0, 1)), rtol=1e-3)


def test_the_page_of_the_power_map_has_a_place_for_each_table():
    shares = {kind: np.full((len(power.SIZES), len(power.areas_of(kind))), 0.25) for kind in power.KINDS}
    page = power.written(power.PAGE.read_text("utf-8"), shares, dict.fromkeys(power.NAMED, 3), 12)
    for kind, each in shares.items():
        head, _, *rows = re.findall(
            r"^\|.*\|$", page.partition(f"<!-- {kind} -->")[2].partition("<!--")[0], re.MULTILINE
        )
        assert head.startswith(f"| {kind} of | ")
        assert [row.split(" | ", 1)[1] for row in rows] == [" | ".join(["25"] * len(each[0])) + " |"] * len(each)
    for name in power.NAMED:
        assert f"| {name} | 3 of 12 |" in page
    with pytest.raises(ValueError, match="0 places for 'mean'"):
        power.written("", shares, {}, 12)


def test_results_and_page(tmp_path, monkeypatch):
    """A small audit fills every row, and its page and table name each fault and what it fails by."""
    outcomes = {plant.name: faults.Judged("BIASED", ("mean",), "BIASED: by the mean.", 0.1, 0.001) for plant in ALL[1:]}
    outcomes[ALL[0].name] = faults.Judged("UNDERPOWERED", (), "UNDERPOWERED: who knows.", 0.1, 0.1)
    outcomes[ALL[1].name] = faults.Judged(faults.CRASHED, (), "no image")
    controls = {BACKGROUND: faults.Judged("BIASED", ("mean",), "BIASED: a control.", 0.1, 0.001)}
    monkeypatch.setattr(faults, "run", lambda plants, **_: (controls, outcomes))
    few = {nulls.Null("skewed", "ours", 4, 8): nulls.Alarms(40, 1, 2)}
    monkeypatch.setattr(nulls, "synthetic", lambda *_, **__: few)
    with Threads(1) as threads:
        results = command.audit(executor=threads, rendered_each=1, detections=1, rows=(), recorded=[])
    assert results["planted"] == len(ALL)
    assert results["caught"] == len(ALL) - 2
    assert f"fault {ALL[1].name}: no image" in results["failures"]
    assert any("control background seen, two_cubes" in text for text in results["failures"])
    history.record(results, tmp_path / "history.json")
    (entry,) = history.read(tmp_path / "history.json")
    assert set(entry["missed"]) == {ALL[0].name, ALL[1].name}
    assert history.fallen(entry, entry) == []
    page = command.write(tmp_path, results).read_text("utf-8")
    assert json.loads((tmp_path / "results.json").read_text("utf-8")) == results
    console = Console(width=300, record=True)
    command.show(console, results)
    table = console.export_text()
    for plant in ALL:
        assert plant.name in page.replace("&#39;", "'")
        assert plant.name in table
    assert "UNDERPOWERED" in page
