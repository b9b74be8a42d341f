"""Replicates on disk: computed once, found again, never half a file, and named by all that decides their bits."""

import pickle
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast, get_args

import attrs
import numpy as np
import pytest

from termwise.renderer import DEFAULTS, Engine, render
from termwise.renderer.scratch import COUNTERS
from termwise.renderer.terms import VARIANTS, Chain, estimator
from termwise.reports.jobs import cells
from termwise.scenes.model import Photons, PointLight, Scene, largest
from tests.scenes import small

SAMPLES, REPLICATES = 4, 3


@pytest.fixture(scope="module")
def scene() -> Scene:
    return small("two_cubes", 3, 2)


class Recorder:
    """Stands for the engine: an image that only (seed, replicate, samples) decide, and a list of what was asked for."""

    def __init__(self, scene: Scene, interrupt_at: int | None = None) -> None:
        self.scene, self.interrupt_at = scene, interrupt_at
        self.compile_seconds = 0.0
        self.asked: list[int] = []
        self.counts = dict.fromkeys(COUNTERS, 0)

    def prefixes(
        self, variant: Any, *, samples: int, seed: int, replicate: int, chain: str, counts: tuple[int, ...]
    ) -> Iterator:
        self.asked.append(replicate)
        self.compile_seconds += 1.0
        self.counts["rays"] += samples
        width, height = self.scene.resolution
        for count in counts:
            if replicate == self.interrupt_at and count == samples:
                raise KeyboardInterrupt
            yield (count, np.random.default_rng((seed, replicate, count)).random((height, width, 3)), 0.5 * count)

    def kernels_of(self, variant: Any, *, chain: str) -> tuple[str, ...]:
        return ("a", chain)


def take(
    engine: Recorder, folder: Path, *, replicates: int = REPLICATES, counts: tuple[int, ...] = (1, 2, SAMPLES)
) -> cells.Cell:
    """Take the replicates of a cell, then read them."""
    variant, taken = VARIANTS["ambient"]["cosine"], cast(Any, engine)
    name = _key(engine.scene)
    jobs = [
        cells.Replicate(engine.scene, "ambient", "cosine", counts, 1, "path", name, number)
        for number in range(replicates)
    ]
    spent = engine.compile_seconds
    for job in jobs:
        cells.take(taken, job, folder)
    own = variant.limit(engine.scene, SAMPLES)
    return cells.read(jobs, own, folder, compile_seconds=engine.compile_seconds - spent)


def files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def test_shapes_and_seconds(scene: Scene, tmp_path: Path):
    cell = take(Recorder(scene), tmp_path)
    assert cell.samples == (1, 2, 4)
    assert cell.images.shape == (REPLICATES, 3, 2, 3, 3)
    assert cell.images.dtype == np.float32
    np.testing.assert_array_equal(cell.seconds, [[0.5, 1.0, 2.0]] * REPLICATES)
    assert cell.counts == dict.fromkeys(COUNTERS, 0) | {"rays": SAMPLES * REPLICATES}
    assert cell.compile_seconds == REPLICATES


def test_without_a_sweep_the_last_image_alone(scene: Scene, tmp_path: Path):
    swept = take(Recorder(scene), tmp_path / "swept")
    last = take(Recorder(scene), tmp_path / "last", counts=(SAMPLES,))
    assert (swept.samples, last.samples) == ((1, 2, SAMPLES), (SAMPLES,))
    np.testing.assert_array_equal(last.images, swept.images[:, -1:])
    assert take(Recorder(scene), tmp_path / "swept", counts=(SAMPLES,)).images.shape == last.images.shape


def test_a_second_run_computes_nothing(scene: Scene, tmp_path: Path):
    first, engine = take(Recorder(scene), tmp_path), Recorder(scene)
    again = take(engine, tmp_path)
    assert engine.asked == []
    assert again.compile_seconds == 0
    np.testing.assert_array_equal(again.images, first.images)
    np.testing.assert_array_equal(again.seconds, first.seconds)
    assert again.counts == first.counts
    assert again.kernels == first.kernels == ("a", "path")


def test_more_replicates_keep_those_there_are(scene: Scene, tmp_path: Path):
    take(Recorder(scene), tmp_path)
    engine = Recorder(scene)
    take(engine, tmp_path, replicates=REPLICATES + 2)
    assert engine.asked == [REPLICATES, REPLICATES + 1]


def test_what_is_missing_is_not_read(scene: Scene, tmp_path: Path):
    take(Recorder(scene), tmp_path)
    files(tmp_path)[1].unlink()
    job = cells.Replicate(scene, "ambient", "cosine", (1, 2, SAMPLES), 1, "path", _key(scene), 1)
    with pytest.raises(ValueError, match="-0001.npz: is missing or damaged"):
        cells.read([job], VARIANTS["ambient"]["cosine"].limit(scene, SAMPLES), tmp_path)


def test_a_job_can_be_sent_and_makes_the_same_file(scene: Scene, tmp_path: Path):
    job = cells.Replicate(scene, "ambient", "cosine", (SAMPLES,), 1, "path", _key(scene), 0)
    with Engine(scene) as engine:
        for folder, each in ((tmp_path / "a", job), (tmp_path / "b", pickle.loads(pickle.dumps(job)))):
            assert cells.take(engine, each, folder)
    own = VARIANTS["ambient"]["cosine"].limit(scene, SAMPLES)
    first, second = (cells.read([job], own, tmp_path / name) for name in "ab")
    assert first.images.tobytes() == second.images.tobytes()


def _truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 3] ^= 0xFF
    path.write_bytes(bytes(content))


def _unknown_compression(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[content.rindex(b"PK\x01\x02") + 10] = 0xEE  # its field in the central directory of a ZIP archive
    path.write_bytes(bytes(content))


DAMAGE: dict[str, Callable[[Path], object]] = {
    "truncated": _truncate,
    "a byte flipped": _flip,
    "empty": lambda path: path.write_bytes(b""),
    "another format": lambda path: path.write_text("not an archive"),
    "an unknown compression": _unknown_compression,
    "without seconds": lambda path: np.savez(path, images=np.zeros((3, 2, 3, 3), np.float32)),
    "of another size": lambda path: np.savez(path, images=np.zeros((3, 5, 5, 3), np.float32), seconds=np.zeros(3)),
    "missing": lambda path: path.unlink(),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_replicate_is_computed_again(damage: str, scene: Scene, tmp_path: Path):
    first = take(Recorder(scene), tmp_path)
    DAMAGE[damage](files(tmp_path)[1])
    engine = Recorder(scene)
    again = take(engine, tmp_path)
    assert engine.asked == [1]
    np.testing.assert_array_equal(again.images, first.images)


def test_an_interrupted_run_leaves_whole_files_and_goes_on(scene: Scene, tmp_path: Path):
    with pytest.raises(KeyboardInterrupt):
        take(Recorder(scene, interrupt_at=1), tmp_path)
    assert [path.name[-8:] for path in files(tmp_path)] == ["0000.npz"]
    engine = Recorder(scene)
    take(engine, tmp_path)
    assert engine.asked == [1, 2]


def test_an_interrupted_write_leaves_nothing(scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def half(path: Path, **arrays: np.ndarray) -> None:
        Path(path).write_bytes(b"half an archive")
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(np, "savez", half)
        with pytest.raises(KeyboardInterrupt):
            take(Recorder(scene), tmp_path)
    assert files(tmp_path) == []


def _key(scene: Scene, term: Any = "ambient", name: str = "cosine", **changes: Any) -> str:
    settings = {"samples": SAMPLES, "seed": 1, "chain": "path"} | changes
    return cells.key(scene, VARIANTS[term][name], **settings)


def test_the_name_follows_what_decides_the_bits(scene: Scene):
    first = scene.objects[0]
    repainted = attrs.evolve(first, material=attrs.evolve(first.material, color=(0.1, 0.2, 0.3)))
    changed = [
        _key(scene, samples=8),
        _key(scene, seed=2),
        _key(scene, name="paper"),
        _key(attrs.evolve(scene, resolution=(2, 3))),
        _key(attrs.evolve(scene, ambient=attrs.evolve(scene.ambient, color=(0.5, 0.5, 0.5)))),
        _key(attrs.evolve(scene, camera=attrs.evolve(scene.camera, fov=30.0))),
        _key(attrs.evolve(scene, objects=(repainted, *scene.objects[1:]))),
        _key(attrs.evolve(scene, toggles=attrs.evolve(scene.toggles, ambient_occlusion=False))),
    ]
    assert len({_key(scene), *changed}) == 1 + len(changed)
    assert len({_key(scene, "specular", "vndf", chain=chain) for chain in get_args(Chain)}) == 3


def test_the_name_ignores_what_does_not(scene: Scene):
    lamp = PointLight((0.0, 0.0, 3.0), (1.0, 1.0, 1.0))
    for same in (
        attrs.evolve(scene, name="another", exposure=2.0),
        attrs.evolve(scene, lights=(lamp,), photons=Photons(count=7), max_bounces=5),
    ):
        assert _key(same) == _key(scene)
        assert _key(scene, chain="next-event") == _key(scene)
    assert _key(attrs.evolve(scene, lights=(lamp,)), "direct", "path") != _key(scene, "direct", "path")
    assert _key(scene, "specular", "vndf", chain="next-event") != _key(scene, "specular", "vndf")


def _painted(scene: Scene, **changes: Any) -> Scene:
    """The scene, its first object's material changed."""
    first = scene.objects[0]
    material = attrs.evolve(first.material, **changes)
    return attrs.evolve(scene, objects=(attrs.evolve(first, material=material), *scene.objects[1:]))


def _dimmed(scene: Scene) -> Scene:
    things = (attrs.evolve(thing, emission=tuple(x / 2 for x in largest(thing.emission))) for thing in scene.objects)
    return attrs.evolve(scene, objects=tuple(things))


def _switched(scene: Scene, **changes: bool) -> Scene:
    return attrs.evolve(scene, toggles=attrs.evolve(scene.toggles, **changes))


# A change, and the terms that it cannot touch; specular meets the others at its vertices.
UNTOUCHED: dict[str, tuple[Callable[[Scene], Scene], tuple[str, ...]]] = {
    "roughness": (lambda scene: _painted(scene, roughness=0.9), ("ambient", "direct", "background")),
    "gloss": (lambda scene: _painted(scene, gloss=0.25), ("background",)),
    "light": (_dimmed, ("ambient", "background")),
    "occlusion": (lambda scene: _switched(scene, ambient_occlusion=False), ("direct", "background")),
    "lighting": (lambda scene: _switched(scene, lighting=False), ("ambient", "background")),
    "names": (
        lambda scene: attrs.evolve(
            scene, objects=tuple(attrs.evolve(thing, name=thing.name[::-1]) for thing in scene.objects)
        ),
        ("ambient", "direct", "specular", "background"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("change", UNTOUCHED)
def test_equal_names_mean_equal_bytes(change: str):
    scene = small("two_cubes", 4, photons=Photons(count=50, radius=0.5))
    changed, untouched = UNTOUCHED[change][0](scene), UNTOUCHED[change][1]
    for term, name in DEFAULTS.items():
        same = _key(changed, term, name) == _key(scene, term, name)
        # The scene has no transmission, whatever changes.
        assert same == (term in (*untouched, "transmission")), term
        if same:
            images = [render(each, term, samples=2, seed=3).mean for each in (scene, changed)]
            assert images[0].tobytes() == images[1].tobytes()


def test_the_name_follows_the_sources(scene: Scene, monkeypatch: pytest.MonkeyPatch):
    before = _key(scene)
    monkeypatch.setattr(estimator, "sources_digest", lambda *folders: "other sources")
    assert _key(scene) != before
