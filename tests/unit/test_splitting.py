"""Splitting: samples that share a camera ray, how many rays that leaves, and the mean that is not moved."""

import attrs
import pytest

from renderer import Engine, find
from renderer.film import ALONE, most_of, samples_of, sights_of
from renderer.plan import camera_rays
from renderer.terms.ambient import SPLIT
from scenes.load import load
from scenes.model import Scene
from tests.unit.test_adaptive import assert_same_mean, tile_means

BOX = attrs.evolve(load("cornell_box"), resolution=(8, 6))


@pytest.mark.parametrize("split", [1, 3, 4, 8])
def test_sights_share_out_all_samples(split):
    """Of any part of a run, each sample belongs to one sight: alone at first, then `split` of them together."""
    for first in range(24):
        for last in range(first + 1, 40):
            begin, end = sights_of(first, last, split)
            parts = [range(*samples_of(sight, split, first, last)) for sight in range(begin, end)]
            assert [sample for part in parts for sample in part] == list(range(first, last))
            assert all(len(part) == 1 for part in parts if part.start < ALONE)
            assert all(len(part) == split for part in parts[1:-1] if part.start >= ALONE)
            assert all(1 <= len(part) <= most_of(last, split) for part in parts)


def test_camera_rays_are_shared():
    """All pixels of the box see something: the rays are counted, with splitting and without."""
    pixels = BOX.resolution[0] * BOX.resolution[1]
    for without, rays in (((), 8 + 24 // SPLIT), (("splitting",), 32)):
        with Engine(BOX, threads=1, without=without) as engine:
            list(engine.prefixes(find("ambient"), samples=32, seed=1, replicate=0, counts=(32,)))
        assert engine.counts["rays"] == rays * pixels
    with Engine(BOX, threads=1) as engine:
        list(engine.prefixes(find("ambient"), samples=32, seed=1, replicate=0))
    assert engine.counts["rays"] == camera_rays(32, SPLIT) * pixels


def test_a_run_in_parts_has_the_bits_of_the_whole():
    """Parts that end amid the samples of a sight."""
    with Engine(BOX, threads=2) as engine:
        *_, (_, whole, _) = engine.prefixes(find("ambient"), samples=19, seed=3, replicate=2, counts=(19,))
        *_, (_, parts, _) = engine.prefixes(
            find("ambient"), samples=19, seed=3, replicate=2, counts=(1, 6, 9, 15, 19)
        )
    assert whole.tobytes() == parts.tobytes()


@pytest.mark.parametrize("scene", [BOX, load("two_cubes")])
def test_the_mean_is_not_moved(scene: Scene, compiled):
    """Over 64 replicates of 24 samples, by Welch's test of each 8 x 8 tile and channel."""
    if not compiled:
        pytest.skip("128 images take minutes as plain Python")
    assert_same_mean(
        tile_means(scene, "ambient", samples=24, seed=3),
        tile_means(scene, "ambient", samples=24, seed=4, without=("splitting",)),
    )
