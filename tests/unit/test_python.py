"""The public functions: what they are given, by value or by name, and what they show of what they give.

Rationale: a Limit that no image is the integral of was rendered as another, and an argument of a wrong type ended in a
traceback out of a kernel.
"""

import base64
import inspect
import io
import re
from typing import Any

import attrs
import numpy as np
import PIL.Image
import pytest

import termwise
from termwise import reference
from termwise.renderer.terms import find
from termwise.scenes.arguments import seed_of, whole
from termwise.scenes.limits import Kernel, Limit, named
from termwise.scenes.load import load
from termwise.scenes.model import Scene
from termwise.scenes.terms import TERMS, TermImage


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"term": "total"}, "term = 'total': allowed are ambient, direct, specular, transmission, background"),
        ({"term": None}, "term = None: allowed are ambient"),
        ({"term": ["ambient"]}, r"term = \['ambient'\]: allowed are ambient"),
        ({"factor": -1}, r"factor = -1.0: allowed is a number in \[0, inf\)"),
        ({"factor": float("nan")}, "factor = nan"),
        ({"factor": float("inf")}, "factor = inf"),
        ({"factor": "2"}, "factor = '2'"),
        ({"factor": True}, "factor = True"),
        ({"term": "specular", "lobe": -0.5}, "lobe = -0.5"),
        ({"term": "specular", "diffuse": -0.5}, "diffuse = -0.5"),
        ({"term": "specular", "ambient": None}, "ambient = None"),
        ({"term": "specular", "cosine": "both"}, "cosine = 'both': allowed are 'incident', 'outgoing'"),
        ({"rings": 0}, "rings = 0: allowed is an integer of at least 1"),
        ({"rings": 2.5}, "rings = 2.5: allowed is an integer"),
        ({"rings": True}, "rings = True: allowed is an integer"),
        ({"occluded": 1}, "occluded = 1: allowed are True, False"),
        ({"shadows": "soft"}, "shadows = 'soft': allowed are 'physical', 'paper'"),
        ({"transport": "full"}, "transport = 'full': allowed are 'decomposed', 'physical'"),
        ({"term": "direct", "scope": "some"}, "scope = 'some': allowed are 'first-hit', 'all', None"),
        ({"term": "direct", "kernel": "simpson"}, "kernel = 'simpson': allowed is a Kernel or None"),
        ({"scope": "all"}, "scope = 'all': means nothing to ambient: allowed are factor, transport, occluded"),
        ({"term": "direct", "lobe": 2.0}, "lobe = 2.0: means nothing to direct"),
        ({"term": "background", "rings": 3}, "rings = 3: means nothing to background"),
        ({"depth": 2}, "depth = 2: allowed with transport = 'physical' alone"),
        ({"depth": 0, "transport": "physical"}, "depth = 0: allowed is an integer of at least 1"),
        ({"term": "background", "depth": 1, "transport": "physical"}, "depth = 1: means nothing to background"),
    ],
    ids=str,
)
def test_impossible_limits_are_refused(fields, message):
    """One line: the field, its value, what is allowed."""
    with pytest.raises(ValueError, match=message) as caught:
        Limit(**({"term": "ambient"} | fields))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"shape": "gauss"}, "shape = 'gauss': allowed are 'simpson'"),
        ({}, r"shape = 'simpson', radius = 0.0: allowed is a number in \(0, inf\)"),
        ({"radius": -1}, "radius = -1.0"),
        ({"radius": 1, "passes": 0}, "passes = 0: allowed is an integer of at least 1"),
        ({"radius": 1, "stored": "none"}, "stored = 'none'"),
        ({"shape": "nearest", "nearest": 5}, "nearest = 5, photons = 0: allowed are at least 2 and 1"),
        ({"shape": "nearest", "nearest": 1, "photons": 9}, "nearest = 1: allowed is an integer of at least 2"),
    ],
    ids=str,
)
def test_impossible_kernels_are_refused(fields, message):
    """One line: the field, its value, what is allowed."""
    with pytest.raises(ValueError, match=message):
        Kernel(**({"shape": "simpson"} | fields))


def test_equal_limits_have_equal_seeds():
    """A whole number, or NumPy's, is the float that it equals: another name would have other random numbers."""
    factors: tuple[Any, ...] = (2, 2.0, np.float64(2.0), np.int64(2))
    same = [Limit("ambient", factor=factor) for factor in factors]
    assert len({reference.rng_seed(limit, 1, 0) for limit in same}) == 1


CHOICES: list[dict[str, Any]] = [{}, {"scope": "all"}, {"scope": "first-hit"}, {"shadows": "paper"}]
CHOICES += [{"scope": "all", "photons": {"scattering": "full"}}, {"toggles": {"ambient_occlusion": False}}]


@pytest.mark.parametrize("term", TERMS)
@pytest.mark.parametrize("choice", CHOICES, ids=str)
def test_a_name_means_what_the_default_variant_converges_to(term, choice):
    """In every scene: else `judge(render(...), reference(...))` would find a bias that is none."""
    scene = load("two_cubes")
    parts = {name: attrs.evolve(getattr(scene, name), **value) for name, value in choice.items() if type(value) is dict}
    scene = attrs.evolve(scene, **(choice | parts))
    own = find(term).limit(scene, 4)
    if not scene.toggles.ambient_occlusion:
        own = attrs.evolve(own, occluded=True)  # the scene's range is 0: no ray is blocked
    assert named(term, scene) == own


@pytest.mark.parametrize("value", [2.0, "2", True, None, -1, 2**64, [1], np.float64(2)], ids=repr)
def test_arguments_of_wrong_type(value):
    """Samples, replicates, threads and seeds, of both sides: one line, before anything is loaded."""
    scene = attrs.evolve(load("two_cubes"), resolution=(2, 2))
    calls = [
        ("seed", lambda: termwise.render(scene, "ambient", seed=value)),
        ("seed", lambda: termwise.reference(scene, "ambient", seed=value)),
    ]
    if value != 2**64:
        calls += [
            ("samples", lambda: termwise.render(scene, "ambient", samples=value)),
            ("replicates", lambda: termwise.render(scene, "ambient", replicates=value)),
            ("spp", lambda: termwise.reference(scene, "ambient", spp=value)),
            ("replicates", lambda: termwise.reference(scene, "ambient", replicates=value)),
        ]
    if value not in (None, 2**64):
        calls.append(("threads", lambda: termwise.render(scene, "ambient", threads=value)))
    for name, call in calls:
        with pytest.raises(ValueError, match=rf"^{name} = {re.escape(repr(value))}: allowed is an integer") as caught:
            call()
        assert "\n" not in str(caught.value)


def test_whole_numbers_of_numpy_are_taken():
    """They are Python's afterwards."""
    assert type(whole("samples", np.int32(4))) is int
    assert seed_of(np.uint8(7)) == 7
    with pytest.raises(
        ValueError, match=r"seed = 18446744073709551616: allowed is an integer in \[0, 18446744073709551615\]"
    ):
        seed_of(2**64)


def test_scenes_by_name_and_terms_by_name(tmp_path):
    """A scene, its name and its file are the same image; what is no scene or no term is refused in one line."""
    path = tmp_path / "own.toml"
    camera = "[camera]\nposition = [0, -3, 1]\ntarget = [0, 0, 0]\n"
    path.write_text(f"resolution = [4, 4]\n{camera}[sky]\ncolor = [1, 2, 3]\n")
    by_file = termwise.render(str(path), "background", samples=1)
    np.testing.assert_array_equal(by_file.mean, termwise.render(load(path), "background", samples=1).mean)
    assert load(load(path)).name == "own"
    with pytest.raises(ValueError, match="nowhere: no such scene: allowed are cornell_box"):
        termwise.render("nowhere", "background")
    with pytest.raises(ValueError, match="nowhere: no such scene: allowed are cornell_box"):
        termwise.reference("nowhere", "background")
    with pytest.raises(ValueError, match="term = 'total': allowed are ambient"):
        termwise.reference(path, "total")


def test_a_render_keeps_its_replicates():
    """So that `judge` takes it; not where it is told."""
    scene = attrs.evolve(load("two_cubes"), resolution=(4, 3))
    image = termwise.render(scene, "background", samples=1, replicates=4)
    assert image.images is not None
    assert image.images.shape == (4, 3, 4, 3)
    np.testing.assert_allclose(image.images.mean(axis=0), image.mean, rtol=1e-6)
    assert termwise.render(scene, "background", samples=1, replicates=4, keep=False).images is None


def test_short_reprs():
    """One line each, with what distinguishes them."""
    scene = load("two_cubes")
    thing = scene.objects[0]
    faces = sum(len(each.mesh.faces) for each in scene.objects)
    assert repr(scene).startswith(f"Scene('two_cubes', {len(scene.objects)} objects of {faces} faces")
    assert repr(thing.mesh) == f"Mesh({len(thing.mesh.vertices)} vertices, {len(thing.mesh.faces)} faces, flat)"
    assert repr(Limit("ambient")) == "Limit('ambient')"
    limit = Limit("direct", scope="all", kernel=Kernel("simpson", radius=1))
    assert repr(limit) == "Limit('direct', scope='all', kernel=Kernel('simpson', radius=1.0))"
    assert all(len(repr(each)) < 400 and "\n" not in repr(each) for each in (scene, scene.sky, thing))
    images = np.stack([np.full((2, 3, 3), value) for value in (1.0, 2.0, 3.0, 2.0)])
    kept = TermImage.from_replicates(images, samples=8, seconds=1.25, keep=True)
    assert repr(kept) == "TermImage(3 x 2, mean 2 ± 0.4, 8 samples x 4 replicates, kept, 1.25 s)"
    alone = TermImage.from_replicates(images, samples=8, seconds=1.25)
    assert repr(alone) == "TermImage(3 x 2, mean 2, 8 samples x 4 replicates, 1.25 s)"


def test_a_notebook_shows_the_picture():
    """The mean in sRGB, its 99th percentile white; black, and what is not finite, do not disturb it."""
    gray = TermImage.from_replicates(np.full((1, 2, 3, 3), 0.5) * [[[0, 1, 1]]], samples=1, seconds=0.0)
    for image, expected in ((gray, [0, 255, 255]), (attrs.evolve(gray, mean=np.zeros((2, 3, 3))), [0, 0, 0])):
        shown = image._repr_html_()
        assert repr(image) in shown
        content = re.search(r"base64,([^\"]+)", shown)
        assert content is not None
        with PIL.Image.open(io.BytesIO(base64.b64decode(content[1]))) as png:
            assert np.array(png).shape == (2, 3, 3)
            assert np.array(png)[0, 0].tolist() == expected
    broken = attrs.evolve(gray, mean=np.full((2, 3, 3), np.nan))
    assert "base64" in broken._repr_html_()
    assert isinstance(load("two_cubes"), Scene)


def test_a_reference_shows_its_parameters_and_names_the_one_that_is_missing():
    assert [*inspect.signature(termwise.reference).parameters][:3] == ["scene", "limit", "spp"]
    with pytest.raises(ValueError, match=r"limit is missing: allowed is .*direct.* or a Limit") as refused:
        termwise.reference("monkey")  # pyright: ignore[reportCallIssue]
    assert "\n" not in str(refused.value)
