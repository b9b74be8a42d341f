"""`judge(render(...), reference(...))`: from names to a verdict, with nothing between."""

import attrs

import termwise

SCENE = attrs.evolve(termwise.load("two_cubes"), resolution=(16, 16))


def test_render_against_reference_by_name():
    """The default variant is not biased against what the term's name means; the paper's, pi times too bright, is."""
    theirs = termwise.reference(SCENE, "ambient", spp=8, replicates=4)
    for variant, biased in ((None, False), ("paper", True)):
        ours = termwise.render(SCENE, "ambient", variant=variant, samples=8, replicates=4)
        verdict = termwise.judge(ours, theirs)
        assert (verdict.verdict == "BIASED") is biased, verdict.sentence
    assert verdict.bias_low > 1.5  # relative: pi - 1
