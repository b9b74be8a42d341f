"""Splitting: samples that share a camera ray, or an estimate by photons; what that leaves, and the mean, not moved."""

import attrs
import pytest

from termwise.renderer import Engine, find
from termwise.renderer.arrays import LIGHT_SAMPLES, light_samples
from termwise.renderer.film import ALONE, primary_hits_of, samples_of
from termwise.renderer.plan import camera_rays
from termwise.renderer.terms.ambient import SPLIT
from termwise.scenes.load import load
from termwise.scenes.model import Scene
from tests.kernels.test_counts import assert_same_mean, tile_means
from tests.scenes import small

BOX = small("cornell_box", 8, 6)
_UNSHADOWED = load("cornell_box_unshadowed")
PHOTONS = attrs.evolve(_UNSHADOWED, resolution=(8, 6), photons=attrs.evolve(_UNSHADOWED.photons, count=500))


@pytest.mark.parametrize("split", [1, 3, 4, 8])
def test_sights_share_out_all_samples(split):
    """Of any part of a run, each sample belongs to one primary hit: alone at first, then `split` of them together."""
    for first in range(24):
        for last in range(first + 1, 40):
            begin, end = primary_hits_of(first, last, split)
            parts = [range(*samples_of(hit, split, first, last)) for hit in range(begin, end)]
            assert [sample for part in parts for sample in part] == list(range(first, last))
            assert all(len(part) == 1 for part in parts if part.start < ALONE)
            assert all(len(part) == split for part in parts[1:-1] if part.start >= ALONE)
            assert all(1 <= len(part) <= split for part in parts)


def test_camera_rays_are_shared():
    """All pixels of the box see something: the rays are counted, with splitting and without."""
    pixels = BOX.resolution[0] * BOX.resolution[1]
    for without, rays in (((), ALONE + (32 - ALONE) // SPLIT), (("splitting",), 32)):
        with Engine(BOX, threads=1, without=without) as engine:
            list(engine.prefixes(find("ambient"), samples=32, seed=1, replicate=0, counts=(32,)))
        assert engine.counts["rays"] == rays * pixels
    with Engine(BOX, threads=1) as engine:
        list(engine.prefixes(find("ambient"), samples=32, seed=1, replicate=0))
    assert engine.counts["rays"] == camera_rays(32, SPLIT) * pixels


@pytest.mark.parametrize(
    ("term", "variant", "scope"),
    [("ambient", "cosine", "all"), ("direct", "next-event", "first-hit"), ("direct", "path", "all")],
)
def test_a_run_in_parts_has_the_bits_of_the_whole(term, variant, scope, compiled):
    """Parts that end amid the samples of a primary hit; the whole has more samples than are followed together."""
    scene = attrs.evolve(BOX if compiled else small("cornell_box", 2), scope=scope)
    with Engine(scene, threads=2) as engine:
        *_, (_, whole, _) = engine.prefixes(find(term, variant), samples=19, seed=3, replicate=2, counts=(19,))
        parts = engine.prefixes(find(term, variant), samples=19, seed=3, replicate=2, counts=(1, 6, 9, 15, 19))
        *_, (_, image, _) = parts
    assert whole.tobytes() == image.tobytes()


def test_light_samples_stand_beside_one_estimate_by_photons():
    """As many estimates as without splitting, and four times the shadow rays, but for those below a horizon."""
    counts = {}
    for without in ((), ("splitting",)):
        with Engine(PHOTONS, threads=1, without=without) as engine:
            list(engine.prefixes(find("direct"), samples=2, seed=1, replicate=0))
        counts[without] = engine.counts
    ours, alone = counts[()], counts[("splitting",)]
    assert ours["rays"] == alone["rays"]
    assert ours["density estimates"] == alone["density estimates"] > 0
    assert 3.5 < ours["occlusion rays"] / alone["occlusion rays"] < 4.5


def test_where_light_samples_are_alike_one_is_enough():
    """One point light; lights without photons, whose samples have camera rays."""
    assert light_samples(PHOTONS) == LIGHT_SAMPLES
    assert light_samples(PHOTONS, without=("splitting",)) == 1
    assert light_samples(BOX) == 1
    assert light_samples(load("monkey")) == 1


@pytest.mark.parametrize(
    ("scene", "term", "samples"), [(BOX, "ambient", 24), (load("two_cubes"), "ambient", 24), (PHOTONS, "direct", 4)]
)
def test_the_mean_is_not_moved(scene: Scene, term, samples, compiled):
    """Over 64 replicates, by Welch's test of each 8 x 8 tile and channel."""
    if not compiled:
        pytest.skip("128 images take minutes as plain Python")
    assert_same_mean(
        tile_means(scene, term, samples=samples, seed=3),
        tile_means(scene, term, samples=samples, seed=4, without=("splitting",)),
    )
