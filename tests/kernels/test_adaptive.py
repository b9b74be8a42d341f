"""Adaptive counts: the allocation by hand, the same bits for any threads, and the mean that is not moved.

Rationale: a pilot whose samples were used would bias the mean (few samples where chance made them alike). This one is
discarded: over many replicates the adaptive mean must be that of even counts, by Welch's test of each tile and channel.
"""

from typing import Any

import attrs
import numpy as np
import pytest
from scipy import stats

from termwise.renderer import Engine, find
from termwise.renderer.adaptive import SIDE, shares
from termwise.renderer.film import Tile
from termwise.scenes.analytic import plate
from termwise.scenes.load import load
from termwise.scenes.model import Camera, Material, Scene, Sky
from tests.scenes import small

TILES = [Tile(0, 0, 4, 4), Tile(4, 0, 8, 4), Tile(0, 4, 4, 8), Tile(4, 4, 8, 8)]


def two_images(deviations: list[float]) -> tuple[np.ndarray, np.ndarray]:
    one = np.zeros((8, 8, 3))
    for tile, deviation in zip(TILES, deviations, strict=True):
        one[tile.y0 : tile.y1, tile.x0 : tile.x1] = deviation
    return one, np.zeros((8, 8, 3))


def test_samples_go_as_the_deviation():
    """Deviations 4, 2, 1, 1 have the mean 2: shares 2, 1, 1/2, 1/2 spend four tiles' samples exactly."""
    np.testing.assert_array_equal(shares(TILES, *two_images([4.0, 2.0, 1.0, 1.0])), [2.0, 1.0, 0.5, 0.5])


def test_no_tile_starves_and_no_more_is_spent_than_asked():
    rng = np.random.default_rng(1)
    for _ in range(100):
        found = shares(TILES, *two_images((10.0 ** rng.uniform(-6, 6, 4)).tolist()))
        assert found.min() >= 0.25
        assert found.mean() <= 1.0
        np.testing.assert_array_equal(np.log2(found) % 1, 0.0)


def test_one_sample_is_enough_where_nothing_varies():
    """Of 3 x 3 tiles one corner varies: it and the three beside it have their counts, the others one sample."""
    nine = [Tile(x, y, x + SIDE, y + SIDE) for y in range(0, 3 * SIDE, SIDE) for x in range(0, 3 * SIDE, SIDE)]
    one = np.zeros((3 * SIDE, 3 * SIDE, 3))
    one[:SIDE, :SIDE] = 1.0
    np.testing.assert_array_equal(
        shares(nine, one, np.zeros_like(one)).reshape(3, 3), [[8, 0.25, 0], [0.25, 0.25, 0], [0, 0, 0]]
    )
    np.testing.assert_array_equal(shares(nine, one, one), 0.0)
    assert shares([], one, one).shape == (0,)


def test_a_constant_sky_takes_one_sample(compiled, monkeypatch):
    """A small plate amid the sky: four tiles of 36 see it, 20 have none of these beside them."""
    if not compiled:
        pytest.skip("55 thousand rays, which plain Python traces one by one; compiled it runs")
    size = 6 * SIDE
    thing = plate("plate", (-0.1, 0.0, -0.1), (0.2, 0.0, 0.0), (0.0, 0.0, 0.2), Material((0.5, 0.5, 0.5)))
    camera = Camera((0.0, -1.0, 0.0), (0.0, 0.0, 0.0), fov=90.0)
    scene = Scene("plate", camera, (thing,), sky=Sky((0.25, 0.5, 1.0)), resolution=(size, size))
    given = []

    def spied(*arguments: Any) -> np.ndarray:
        given.append(shares(*arguments))
        return given[-1]

    monkeypatch.setattr("termwise.renderer.engine.shares", spied)
    with Engine(scene, threads=2, adaptive=True, without=("window",)) as engine:
        *_, (_, image, _) = engine.prefixes(find("background"), samples=16, seed=1, replicate=0)
    assert (given[0] == 0.0).sum() == 20
    samples = np.maximum(1, np.floor(16 * given[0]))
    assert engine.counts["rays"] == SIDE * SIDE * (36 * 8 + samples.sum())
    np.testing.assert_array_equal(image[0, 0], scene.sky.color)
    assert not image[size // 2, size // 2].any()


def test_same_bits_for_any_threads_and_prefixes(compiled):
    scene = attrs.evolve(load("cornell_box"), resolution=(20, 12) if compiled else (9, 8))
    images = []
    for threads, samples in ((1, 8), (3, 8), (2, 16)):
        with Engine(scene, threads=threads, adaptive=True) as engine:
            images.append(
                {
                    n: image
                    for n, image, _ in engine.prefixes(find("ambient", None), samples=samples, seed=2, replicate=1)
                }
            )
    for n in (1, 2, 4, 8):
        np.testing.assert_array_equal(images[0][n], images[1][n])
        np.testing.assert_array_equal(images[0][n], images[2][n])


def test_counts_are_those_of_the_shares(compiled):
    """A pixel's rays are counted: the pilot's and N of the mean pixel, and no more."""
    scene = small("cornell_box", 2 * SIDE, SIDE)
    with Engine(scene, threads=2, adaptive=True) as engine:
        *_, _ = engine.prefixes(find("ambient", None), samples=16, seed=1, replicate=0)
    pixels = 2 * SIDE * SIDE
    assert 8 * pixels < engine.counts["rays"] <= (8 + 16) * pixels


def tile_means(scene: Scene, term: str, *, samples: int, seed: int, **settings: Any) -> np.ndarray:
    """Means of the 8 x 8 tiles and channels of 32 x 24 pixels, (64 replicates, 36)."""
    with Engine(attrs.evolve(scene, resolution=(32, 24)), **settings) as engine:
        stack = []
        for replicate in range(64):
            *_, (_, image, _) = engine.prefixes(find(term, None), samples=samples, seed=seed, replicate=replicate)
            stack.append(image.reshape(3, 8, 4, 8, 3).mean(axis=(1, 3)).ravel())
    return np.array(stack)


def assert_same_mean(one: np.ndarray, other: np.ndarray) -> None:
    """By Welch's test of each tile and channel."""
    noisy = (one.var(axis=0) > 0) & (other.var(axis=0) > 0)
    tested: Any = stats.ttest_ind(one[:, noisy], other[:, noisy], equal_var=False)
    assert noisy.sum() >= 20
    assert tested.pvalue.min() > 1e-3 / noisy.sum()


@pytest.mark.parametrize(
    ("scene_name", "term"), [("cornell_box", "ambient"), ("cornell_box", "specular"), ("two_cubes", "ambient")]
)
def test_the_mean_is_not_moved(scene_name, term, compiled):
    if not compiled:
        pytest.skip("2048 renders of Python's")
    # A camera ray for each sample, as adaptive counts have it.
    adaptive, even = (
        tile_means(load(scene_name), term, samples=8, seed=seed, adaptive=adaptive, without=("splitting",))
        for adaptive, seed in ((True, 3), (False, 4))
    )
    assert_same_mean(adaptive, even)
    # And what it is for: less noise at the same count.
    assert adaptive.var(axis=0).sum() < even.var(axis=0).sum()


def test_photon_maps_are_refused():
    with (
        Engine(load("two_cubes"), adaptive=True) as engine,
        pytest.raises(ValueError, match=r"adaptive = True .* allowed are"),
    ):
        list(engine.prefixes(find("direct", "next-event"), samples=2, seed=1, replicate=0))
