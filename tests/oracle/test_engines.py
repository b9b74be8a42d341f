"""Real renderers as engines: ours to the bit, terms through scenes, and adapters of what is installed.

An adapter whose renderer is not installed is skipped by name; `make engines` installs them.
"""

from pathlib import Path

import attrs
import numpy as np
import pytest

import termwise
from termwise.reports.engines import engine as engines
from termwise.reports.engines.asked import Asked, rows
from termwise.reports.engines.engine import Engine
from termwise.reports.engines.furnaces import furnaces
from termwise.reports.engines.probe import probe
from termwise.reports.engines.replicates import Here, collected, replicates
from termwise.reports.engines.running import seed_of
from termwise.reports.judging import engines as judging
from termwise.reports.judging.engines import against
from termwise.scenes.exchange import neutral
from termwise.scenes.model import Ambient, largest
from termwise.scenes.store import ROOT
from termwise.scenes.terms import TERMS, total
from tests.scenes import small


def taken(engine: Engine, asked: Asked, cache: Path, *, spp: int, seed: int = 1, count: int = 1) -> np.ndarray:
    """Images of an engine (count, H, W, 3), rendered into a cache of the test's own; kernels stay where they are."""
    jobs = replicates(engine, asked, spp=spp, seed=seed, count=count)
    for job in jobs:
        job.take(Here(cache, 2))
    return collected(jobs, cache).stack


@pytest.mark.slow
def test_ours_by_command_has_our_own_bits(tmp_path: Path):
    scene = small("cornell_box", 8, 6, ambient=Ambient(), draw_lights=True)
    ((_, asked),) = rows(scene)[0].parts
    (ours,) = taken(engines.load("ours"), asked, tmp_path, spp=2, seed=3)
    seed = seed_of(asked.digest, 3, 0)
    images = [termwise.render(scene, term, samples=2, seed=seed).mean for term in TERMS]
    assert np.array_equal(ours, total(*images).astype(np.float32))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "term"), [("ambient", "ambient"), ("direct", "direct")])
def test_a_term_through_scenes_is_the_term(name: str, term: str, tmp_path: Path):
    """Of a plate below a large lamp, by a path tracer that knows no terms."""
    (lamp,) = [each.asked.scene for each in furnaces() if each.name.startswith("rectangle")]
    scene = attrs.evolve(lamp, ambient=Ambient((0.7, 0.5, 0.3)), scope="first-hit")
    (row,) = (each for each in rows(scene) if each.name == name)
    engine = engines.load(ROOT / "examples" / "tiny_renderer.toml")
    images = [taken(engine, part, tmp_path, spp=64, count=4) for _, part in row.parts]
    found = np.sum([sign * stack for (sign, _), stack in zip(row.parts, images, strict=True)], axis=0)
    exact = termwise.render(scene, term, samples=256, replicates=4)
    judged = termwise.judge(found, exact, allow_negative=True, hint=False)
    assert judged.verdict != "BIASED", judged.sentence
    assert (judged.detectable_bias or 1.0) < 0.1
    assert termwise.judge(1.2 * found, exact, allow_negative=True, hint=False).verdict == "BIASED"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mitsuba", "cycles", "luxcore"])
def test_an_adapter_against_the_real_renderer(name: str, tmp_path: Path):
    engine = engines.load(name)
    if engine.says.packages and not engine.installed:
        pytest.skip(f"{name} is not installed: `make engines` does it")
    assert len(probe(engine, threads=2, again=True)) == (engine.says.seeds == "varying")
    for each in furnaces():
        if each.name.startswith("point") or each.asked.depth == 1:
            (image,) = taken(engine, each.asked, tmp_path, spp=64)
            off, exact = image - each.exact, each.exact.mean(axis=(0, 1))
            error = off.std(axis=(0, 1), ddof=1) / np.sqrt(off[..., 0].size)
            # What is not noise: the rule by which the exact image is averaged over pixels, and float32.
            assert (np.abs(off.mean(axis=(0, 1))) < 5 * error + 1e-3 * exact).all(), each.name
            assert (error < 0.01 * exact).all(), each.name


@pytest.mark.slow
def test_the_reference_of_a_scene_is_all_light_and_knows_objects_by_name():
    box = neutral.diffuse(small("cornell_box_unshadowed", 12, 9))
    scene = attrs.evolve(box, camera=attrs.evolve(box.camera, target=(0.0, 0.0, 4.5)))
    truth, places = against(scene, spp=16, seed=1, replicates=4)
    assert places["object_names"][places["objects"][5, 6]] == "back wall"
    lit = truth.max(axis=(0, 3))
    assert 3.0 < lit.max() <= max(largest(scene.objects[-1].emission))  # the lamp is seen to shine
    ours = termwise.render(scene, "direct", variant="path", samples=64, replicates=4)
    judged = termwise.judge(ours, truth, mask=lit < 2.0, hint=False, **places)
    assert judged.verdict != "BIASED", judged.sentence
    assert "back wall" in {region.region for region in judged.regions}


@pytest.mark.slow
def test_an_engine_whose_light_ends_too_soon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """It is said after how many bounces, of all light and of the direct term; and of nothing but an error."""
    monkeypatch.setenv("TERMWISE_CACHE", str(tmp_path / "cache"))
    told = (ROOT / "examples" / "tiny_renderer.toml").read_text()
    (tmp_path / "tiny_renderer.py").write_bytes((ROOT / "examples" / "tiny_renderer.py").read_bytes())
    (tmp_path / "ends.toml").write_text(told.replace("{depth}", "2").replace('"tiny"', '"ends"'))
    box = neutral.diffuse(small("cornell_box_unshadowed", 12, 9))
    subjects = [engines.load(tmp_path / "ends.toml"), engines.load(ROOT / "examples" / "tiny_renderer.toml")]
    how = judging.Asking(replicates=8, spp=128, probed=False)
    rows = ("total", "direct all")
    judged = judging.compare(
        subjects, [box], tmp_path / "out", how, only=rows, reference_spp=64, reference_replicates=8
    )
    found = {each.name: each.judgement for each in judged.outcomes}
    assert len(found) == 4
    for name, judgement in found.items():
        said = [hint.text for hint in judgement.hints if "light scatters 2 times at most" in hint.text]
        assert (judgement.verdict == "BIASED", len(said)) == (("ends" in name), int("ends" in name)), name
