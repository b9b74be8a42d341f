"""Real renderers as engines: ours to the bit, terms through scenes, and adapters of what is installed.

An adapter whose renderer is not installed is skipped by name; `make engines` installs them.
"""

from pathlib import Path

import attrs
import numpy as np
import pytest

import termwise
from termwise.reports.engines import engine as engines
from termwise.reports.engines.asked import rows
from termwise.reports.engines.furnaces import furnaces
from termwise.reports.engines.probe import probe
from termwise.reports.engines.replicates import rendered
from termwise.reports.engines.running import seed_of
from termwise.reports.judging.engines import against
from termwise.scenes.exchange import neutral
from termwise.scenes.model import Ambient
from termwise.scenes.store import ROOT
from termwise.scenes.terms import TERMS, total
from tests.scenes import small


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A cache of its own for images, the environments of engines where they are."""
    environments = [(engine, engine.says.environment) for engine in map(engines.load, engines.shipped())]
    for engine, folder in environments:
        if engine.installed:
            there = tmp_path / "engines" / "environments" / folder.name
            there.parent.mkdir(parents=True, exist_ok=True)
            if not there.exists():
                there.symlink_to(folder, target_is_directory=True)
    monkeypatch.setenv("TERMWISE_CACHE", str(tmp_path))


def test_ours_by_command_has_our_own_bits():
    scene = small("cornell_box", 8, 6, ambient=Ambient(), draw_lights=True)
    ((_, asked),) = rows(scene)[0].parts
    ours = termwise.engine("ours").render(scene, samples=2, seed=3, probe=False)
    seed = seed_of(asked.digest, 3, 0)
    images = [termwise.render(scene, term, samples=2, seed=seed).mean for term in TERMS]
    assert np.array_equal(ours.mean, total(*images).astype(np.float32))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "term"), [("ambient", "ambient"), ("direct", "direct")])
def test_a_term_through_scenes_is_the_term(name: str, term: str):
    """Of a room with a lamp and without a roof, by a path tracer that knows no terms."""
    box = small("cornell_box", 12, 9, ambient=Ambient((0.7, 0.5, 0.3)), scope="first-hit")
    kept = ("floor", "back wall", "lamp")
    scene = attrs.evolve(box, objects=tuple(each for each in box.objects if each.name in kept))
    (row,) = (each for each in rows(scene) if each.name == name)
    engine = engines.load(ROOT / "examples" / "tiny_renderer.toml")
    images = [rendered(engine, part, spp=64, seed=1, count=4, threads=1).stack for _, part in row.parts]
    found = np.sum([sign * stack for (sign, _), stack in zip(row.parts, images, strict=True)], axis=0)
    exact = termwise.render(scene, term, samples=256, replicates=4)
    judged = termwise.judge(found, exact, allow_negative=True, hint=False)
    assert judged.verdict != "BIASED", judged.sentence
    assert (judged.detectable_bias or 1.0) < 0.1
    assert termwise.judge(1.2 * found, exact, allow_negative=True, hint=False).verdict == "BIASED"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mitsuba", "cycles", "luxcore"])
def test_an_adapter_against_the_real_renderer(name: str):
    engine = engines.load(name)
    if engine.says.packages and not engine.installed:
        pytest.skip(f"{name} is not installed: `make engines` does it")
    assert probe(engine, threads=2) == ()
    for each in furnaces():
        if each.name.startswith(("point", "closed box of albedo 0.2")):
            image = rendered(engine, each.asked, spp=256, seed=1, count=1, threads=2).stack[0]
            assert np.allclose(image.mean(axis=(0, 1)), each.exact.mean(axis=(0, 1)), rtol=0.02), each.name


def test_the_reference_of_a_scene_is_all_light_and_knows_objects_by_name():
    scene = neutral.diffuse(small("cornell_box_unshadowed", 8, 6))
    truth, places = against(scene, spp=16, seed=1, replicates=4)
    lamp = places["object_names"].index("lamp")
    seen = places["objects"] == lamp
    assert "back wall" in places["object_names"]
    emission = np.array(scene.objects[lamp].emission)
    assert seen.any()
    inside = truth[:, seen].max(axis=(0, 1))
    assert (inside <= emission * (1 + 1e-5)).all()  # a pixel of the lamp alone has its radiance
    ours = termwise.render(attrs.evolve(scene, ambient=Ambient()), "direct", variant="path", samples=64, replicates=4)
    assert ours.images is not None
    dark = ~np.isin(places["objects"], [lamp, -1])
    judged = termwise.judge(ours.images, truth, mask=dark & ~_beside(seen), hint=False, **places)
    assert judged.verdict != "BIASED", judged.sentence


def _beside(seen: np.ndarray) -> np.ndarray:
    """Pixels of the lamp and around it."""
    padded = np.pad(seen, 1)
    height, width = seen.shape
    return np.any([padded[y : y + height, x : x + width] for y in range(3) for x in range(3)], axis=0)
