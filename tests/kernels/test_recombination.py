"""Which term images are linear in an input, so that a sweep of it needs no new samples, and which are not.

With the same random numbers a term that is linear in an input is so sample by sample, to rounding. Where an input acts
at every vertex of a path (albedo, gloss along a chain) the image is a polynomial in it.
"""

import attrs
import numpy as np
import pytest

from termwise import renderer
from termwise.renderer.plan import skipped
from termwise.scenes.load import load
from termwise.scenes.model import Scene
from termwise.scenes.terms import TERMS, total
from tests.scenes import small

ROUNDING = 1e-12


def made(name: str, compiled: bool, **changes) -> Scene:
    side = 12 if compiled else 4
    scene = small(name, side, **changes)
    return attrs.evolve(scene, photons=attrs.evolve(scene.photons, count=300 if compiled else 40))


def with_gloss(scene: Scene, gloss: float) -> Scene:
    """All objects as glossy."""
    objects = tuple(attrs.evolve(thing, material=attrs.evolve(thing.material, gloss=gloss)) for thing in scene.objects)
    return attrs.evolve(scene, objects=objects)


def image(scene: Scene, term: str, variant: str | None = None) -> np.ndarray:
    """Without roulette, which chains play by their throughput: with it they are linear in the mean alone."""
    with renderer.Engine(scene, without=["roulette"]) as engine:
        return list(engine.prefixes(renderer.find(term, variant), samples=2, seed=3, replicate=0))[-1][1]


@pytest.mark.parametrize("scene", ["two_cubes", "cornell_box"])
@pytest.mark.parametrize(
    ("term", "changes", "weight"),
    [
        ("ambient", {}, lambda gloss: 1 - gloss),
        ("direct", {"scope": "first-hit"}, lambda gloss: 1 - gloss),
        ("specular", {"scope": "first-hit", "max_bounces": 1}, lambda gloss: gloss * (1 - gloss)),
    ],
)
def test_one_vertex_is_linear_in_its_weight(scene, term, changes, weight, compiled):
    """Gloss .75 from gloss .5: color (1 - g) at a diffuse vertex, g at a glossy one, whose light is diffuse."""
    if term == "specular":
        changes = changes | {"sky": attrs.evolve(load(scene).sky, color=(0.0, 0.0, 0.0), texture=None)}
    base = made(scene, compiled, **changes)
    half, other = (image(with_gloss(base, gloss), term) for gloss in (0.5, 0.75))
    assert half.any()
    np.testing.assert_allclose(other, half * (weight(0.75) / weight(0.5)), rtol=ROUNDING)


@pytest.mark.slow
@pytest.mark.parametrize(("term", "changes"), [("direct", {"scope": "all"}), ("specular", {"max_bounces": 2})])
def test_what_a_path_meets_twice_is_not_linear(term, changes, compiled):
    """Light after two bounces has the square of the weight: a sweep of gloss needs these terms anew."""
    base = made("cornell_box", compiled, **changes)
    variant = "path" if term == "direct" else None
    few, many = (image(with_gloss(base, gloss), term, variant) for gloss in (0.25, 0.75))
    assert few.any()
    share = 0.25 / 0.75 if term == "direct" else (0.75 * 0.25) / (0.25 * 0.75)
    assert not np.allclose(many, few * share, rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("term", [each for each in TERMS if each != "transmission"])  # which has no switch
def test_a_toggle_drops_its_term_and_no_other(term, compiled):
    """The picture with a term switched off is the sum of the others' images, bit for bit."""
    scene = made("two_cubes", compiled, scope="first-hit", max_bounces=1)
    whole = {each: image(scene, each) for each in TERMS}
    off = {
        "ambient": {"ambient": attrs.evolve(scene.ambient, color=(0.0, 0.0, 0.0))},
        "direct": {"toggles": attrs.evolve(scene.toggles, lighting=False)},
        "specular": {"max_bounces": 0},
        "background": {"sky": attrs.evolve(scene.sky, color=(0.0, 0.0, 0.0), texture=None)},
    }[term]
    changed = attrs.evolve(scene, **off)
    assert skipped(changed, term)
    # What a glossy surface reflects is of all the others.
    kept = [each for each in TERMS if each not in (term, "specular")]
    for each in kept:
        assert image(changed, each).tobytes() == whole[each].tobytes()
    black = np.zeros_like(whole[term])
    without = [black if each == term else whole[each] for each in TERMS]
    if term == "specular":
        assert total(*without).tobytes() == total(*(image(changed, each) for each in TERMS)).tobytes()
