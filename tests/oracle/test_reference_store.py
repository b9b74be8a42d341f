"""The cache of replicates: nothing rendered twice, nothing wrong ever served."""

import attrs
import numpy as np
import pytest

from termwise import reference
from termwise.reference import store
from termwise.scenes.limits import Limit, correct, physical
from termwise.scenes.model import Ambient, Camera, Mesh, Object, PointLight, Scene, Sky
from termwise.scenes.terms import TERMS
from tests.scenes import small


@pytest.fixture(scope="module")
def scene() -> Scene:
    corners = [[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]]
    ground = Object("ground", Mesh.from_arrays(corners, [[0, 1, 2], [0, 2, 3]]))
    return Scene(
        "ground",
        Camera(position=(2.0, 2.0, 2.0), target=(0.0, 0.0, 0.0)),
        (ground,),
        lights=(PointLight((0.0, 0.0, 1.0), (1.0, 1.0, 1.0)),),
        ambient=Ambient((1.0, 1.0, 1.0)),
        sky=Sky((0.1, 0.2, 0.3)),
        resolution=(8, 6),
    )


@pytest.fixture
def renders(monkeypatch) -> list[int]:
    """Replicate numbers in the order in which they are rendered."""
    rendered: list[int] = []
    original = reference.replicate_parts

    def counted(*arguments, replicate: int = 0, **options):
        rendered.append(replicate)
        return original(*arguments, replicate=replicate, **options)

    monkeypatch.setattr(reference, "compile_kernels", lambda *_, **__: None)
    monkeypatch.setattr(store, "_variant", lambda: "any that has no budget")
    monkeypatch.setattr(reference, "replicate_parts", counted)
    return rendered


def test_replicates_are_rendered_once(scene, renders, tmp_path):
    ticks = []
    first = store.replicates(
        scene, correct("direct", "all"), spp=2, seed=1, count=2, folder=tmp_path, progress=lambda: ticks.append(1)
    )
    assert (renders, len(ticks)) == ([0, 1], 2)
    more = store.replicates(scene, correct("direct", "all"), spp=2, seed=1, count=3, folder=tmp_path)
    assert renders == [0, 1, 2]
    np.testing.assert_array_equal(more.images[:2], first.images)
    assert first.images.dtype == np.float32
    assert first.images.shape == (2, 6, 8, 3)
    assert (more.seconds[:2] == first.seconds).all()
    assert (more.images[0] != more.images[1]).any()
    np.testing.assert_array_equal(
        more.images[2], reference.replicate(scene, correct("direct", "all"), spp=2, seed=1, replicate=2)
    )


def test_constant_factors_and_irrelevant_fields_share_replicates(scene, renders, tmp_path):
    plain = store.replicates(scene, correct("ambient", "all"), spp=2, seed=1, count=1, folder=tmp_path)
    other = attrs.evolve(scene, name="other", lights=(), sky=Sky(), max_bounces=0, scope="first-hit", exposure=9.0)
    paper = store.replicates(other, Limit("ambient", factor=np.pi), spp=2, seed=1, count=1, folder=tmp_path)
    assert renders == [0]
    np.testing.assert_allclose(paper.images, np.pi * plain.images, rtol=1e-6)


def _painted(scene, **changes):
    """The scene, the material and the emission of all things changed."""
    emission = changes.pop("emission", 1.0)
    things = tuple(
        attrs.evolve(
            thing,
            material=attrs.evolve(thing.material, **changes),
            emission=tuple(emission * channel for channel in thing.emission),
        )
        for thing in scene.objects
    )
    return attrs.evolve(scene, objects=things)


# What is changed, and the terms that it cannot touch.
UNTOUCHED = {
    "lobe": (lambda scene: _painted(scene, roughness=0.9, f0=(0.9, 0.5, 0.1)), ("ambient", "direct", "background")),
    "share": (lambda scene: _painted(scene, color=(0.2, 0.1, 0.3), gloss=0.0), ("ambient", "direct", "background")),
    "light": (lambda scene: _painted(scene, emission=0.5), ("ambient", "background")),
    "lighting": (
        lambda scene: attrs.evolve(scene, toggles=attrs.evolve(scene.toggles, lighting=False)),
        ("ambient", "background"),
    ),
    "occlusion": (
        lambda scene: attrs.evolve(scene, toggles=attrs.evolve(scene.toggles, ambient_occlusion=False)),
        ("direct", "background"),
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def shining() -> tuple[Scene, dict[str, np.ndarray]]:
    """A scene whose lobes, lights and shares are all at work, and the image of each term."""
    scene = _painted(small("two_cubes", 8, 6), color=(0.4, 0.2, 0.6), gloss=0.5)
    terms = ("ambient", "direct", "background")  # no change leaves specular alone
    return scene, {term: reference.replicate(scene, correct(term, "all"), spp=2, seed=1) for term in terms}


@pytest.mark.parametrize("change", UNTOUCHED)
def test_equal_names_mean_equal_bytes(shining, change):
    """`color (1 - gloss)` is the same to the bit."""
    (scene, images), (made, untouched) = shining, UNTOUCHED[change]
    changed = made(scene)
    for term in TERMS:
        limit = correct(term, "all")
        names = {store.key(each, limit, spp=2, seed=1) for each in (scene, changed)}
        # The scene has no transmission, whatever changes.
        assert (len(names) == 1) == (term in (*untouched, "transmission")), term
    for term in untouched:
        again = reference.replicate(changed, correct(term, "all"), spp=2, seed=1)
        assert again.any() or term == "background"
        assert again.tobytes() == images[term].tobytes(), term


def test_physical_parts_come_from_one_render(scene, renders, tmp_path):
    for term in ("ambient", "direct", "specular"):
        store.replicates(scene, physical(term), spp=2, seed=1, count=2, folder=tmp_path)
    assert renders == [0, 1]


@pytest.mark.parametrize("change", ["scene", "limit", "spp", "seed", "sources", "by_second"])
def test_whatever_matters_changes_the_name(scene, monkeypatch, change):
    limit = correct("specular", "all")
    before = store.key(scene, limit, spp=2, seed=1)
    if change == "scene":
        after = store.key(attrs.evolve(scene, sky=Sky((0.1, 0.2, 0.31))), limit, spp=2, seed=1)
    elif change == "limit":
        after = store.key(scene, attrs.evolve(limit, scope="first-hit"), spp=2, seed=1)
    elif change == "sources":
        monkeypatch.setattr(store, "sources_digest", lambda *_: "other")
        after = store.key(scene, limit, spp=2, seed=1)
    elif change == "by_second":
        after = store.key(scene, limit, spp=2, seed=1, by_second=True)
    elif change == "spp":
        after = store.key(scene, limit, spp=3, seed=1)
    else:
        after = store.key(scene, limit, spp=2, seed=3)
    assert after != before


@pytest.mark.parametrize("damage", ["cut", "altered", "removed", "record"])
def test_damaged_files_are_rendered_again(scene, renders, tmp_path, damage):
    limit = correct("ambient", "all")
    whole = store.replicates(scene, limit, spp=2, seed=1, count=1, folder=tmp_path)
    (path,) = tmp_path.rglob("*.npy")
    content = path.read_bytes()
    if damage == "cut":
        path.write_bytes(content[:-7])
    elif damage == "altered":
        path.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    elif damage == "removed":
        path.unlink()
    else:
        path.with_suffix(".json").write_text("{")
    again = store.replicates(scene, limit, spp=2, seed=1, count=1, folder=tmp_path)
    assert renders == [0, 0]
    np.testing.assert_array_equal(again.images, whole.images)
    assert path.read_bytes() == content


@pytest.mark.parametrize(
    ("seconds_per_sample", "expected"),
    [(0.01, (64, 16)), (0.1, (32, 16)), (1.0, (2, 16)), (10.0, (1, 6)), (99.0, (1, 2))],
)
def test_a_budget_buys_replicates_before_samples(seconds_per_sample, expected):
    assert store.affordable(64, 16, seconds_per_sample, 60.0) == expected


def test_scalar_backend_says_what_it_left_out(scene, renders, monkeypatch, tmp_path):
    """Samples are given up for the budget, the shortfall says so, and a second run renders nothing."""
    monkeypatch.setattr(store, "_variant", lambda: "scalar_rgb")
    options = {"spp": 2**30, "seed": 1, "count": 2, "folder": tmp_path, "budget_s": 1e-9}
    first = store.replicates(scene, correct("ambient", "all"), **options)
    assert (first.spp, len(first.images)) == (1, 2)
    assert first.shortfall
    assert "2 of 2 replicates at 1 of 1073741824 samples" in first.shortfall
    assert renders == [0, 1]
    assert store.replicates(scene, correct("ambient", "all"), **options).shortfall == first.shortfall
    assert renders == [0, 1]


def test_an_interrupted_render_leaves_nothing(scene, monkeypatch, tmp_path):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(reference, "replicate_parts", interrupted)
    with pytest.raises(KeyboardInterrupt):
        store.replicates(scene, correct("ambient", "all"), spp=2, seed=1, count=1, folder=tmp_path)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]
