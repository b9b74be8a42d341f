"""Tiles: each p is Welch's, the map keeps its level, and a planted error is found where it was put.

Rationale: a p-map persuades, so what it shows must be right to the letter. Oracles: scipy's own `ttest_ind` on the
pixels of a tile, the definitions of Holm's and of Benjamini and Hochberg's procedures, the binomial law of counts.
"""

import itertools
import json

import numpy as np
import pytest
from scipy import stats

from termwise.reports.statistics import tiles
from termwise.reports.statistics.accumulation import measure
from termwise.reports.statistics.tiles import summary, tile_maps, variables

WEIGHTS = np.array([0.2126, 0.7152, 0.0722])


def gamma(rng, mean, count=16, noise=0.5):
    """Replicates (count, H, W, 3) with independent noise of each pixel, shared by its channels."""
    factor = rng.gamma(1 / noise**2, noise**2, (count, *mean.shape[:2], 1))
    return (mean * factor).astype(np.float32)


def null(rng, size, **settings):
    """The maps of two sides of one limit, a grey of 1."""
    mean = np.ones((*size, 3))
    return tile_maps(measure(gamma(rng, mean, **settings), gamma(rng, mean, **settings)))


# Each tile's p.


@pytest.mark.parametrize("exact", [False, True], ids=["noisy reference", "exact reference"])
def test_p_of_each_tile_is_scipys(replicates, picture, exact):
    """Tiles of all sizes, cut by the border, in luminance and by channel."""
    rng = np.random.default_rng(21)
    mean = picture(41, 50)
    ours = replicates(rng, mean * [1.01, 1.0, 1.0], 7)
    reference = mean[None] if exact else replicates(rng, mean, 12)
    statistics = measure(ours, reference, exact=exact)
    maps = tile_maps(statistics)
    for side, found in maps.items():
        channels = statistics.tiles[side].p_values()[1:]
        assert found.merged_into is None
        assert found.p.shape == (-(-41 // side), -(-50 // side))
        for row, column in np.ndindex(found.p.shape):
            y, x = (slice(side * i, side * (i + 1)) for i in (row, column))
            a, b = (each[:, y, x].mean(axis=(1, 2), dtype=np.float64) for each in (ours, reference))

            def p_of(a, b):
                _, p = stats.ttest_1samp(a, b[0]) if exact else stats.ttest_ind(a, b, equal_var=False)
                return p

            assert found.p[row, column] == pytest.approx(p_of(a @ WEIGHTS, b @ WEIGHTS), rel=1e-5)
            assert channels[:, row, column] == pytest.approx(p_of(a, b), rel=1e-5)


@pytest.mark.slow
def test_p_is_uniform_under_the_null():
    """1024, 256 and 64 independent tiles of gamma pixels; over 40 maps of 8 px the test's own p is uniform, too."""
    rng = np.random.default_rng(22)
    for found in null(rng, (256, 256)).values():
        assert stats.kstest(found.p.ravel(), "uniform").pvalue > 1e-3
    of_maps = [summary(null(rng, (96, 96)))[0]["uniform_p"] for _ in range(40)]
    assert stats.kstest(of_maps, "uniform").pvalue > 1e-3


def test_places_without_noise_are_tested_against_rounding_and_left_out_of_the_histogram(picture):
    """Black on both sides: nothing to test. Equal up to rounding: p near 1. Off by 1 %: found. All without noise."""
    rng = np.random.default_rng(23)
    mean = picture(32, 48)
    ours, reference = gamma(rng, mean), gamma(rng, mean)
    for images, values in ((ours, (0.0, 0.7, 0.707)), (reference, (0.0, np.float32(0.7) * (1 + 1e-7), 0.7))):
        for k, value in enumerate(values):
            images[:, :16, 16 * k : 16 * (k + 1)] = value
    maps = tile_maps(measure(ours, reference))
    assert np.isnan(maps[16].p[0, 0])
    assert maps[16].p[0, 1] > 0.1
    assert maps[16].holm[0, 2] < 1e-6
    eight, sixteen, _ = summary(maps)
    assert (sixteen["tiles"], sixteen["tested"], sixteen["left_out"], sum(sixteen["histogram"])) == (6, 5, 3, 3)
    assert (eight["tiles"], eight["tested"], eight["left_out"], sum(eight["histogram"])) == (24, 20, 12, 12)


# Many tiles at once.


def holm_by_closure(p, level):
    """Holm's procedure as Bonferroni's, closed: reject i if every set of hypotheses with i in it is rejected."""
    sets = [s for size in range(1, len(p) + 1) for s in itertools.combinations(range(len(p)), size)]
    return [all(min(p[list(s)]) <= level / len(s) for s in sets if i in s) for i in range(len(p))]


def test_holm_and_benjamini_hochberg_by_their_definitions(picture):
    """9 tiles of 8 px, of which some are off, at several levels."""
    rng = np.random.default_rng(24)
    mean = np.ones((24, 24, 3))
    rejected = []
    for _ in range(20):
        field = 1 + 0.05 * rng.normal(size=(3, 3)).repeat(8, axis=0).repeat(8, axis=1)[..., None]
        found = tile_maps(measure(gamma(rng, mean * field), gamma(rng, mean)))[8]
        p = found.p.ravel()
        for level in (0.01, 0.05, 0.3):
            assert (found.holm.ravel() <= level).tolist() == holm_by_closure(p, level)
            ordered = np.sort(p)
            below = np.flatnonzero(ordered <= level * np.arange(1, 10) / 9)
            largest = ordered[below[-1]] if len(below) else -1.0
            assert (found.benjamini_hochberg.ravel() <= level).tolist() == (p <= largest).tolist()
        rejected.append(int(np.sum(found.holm <= 0.05)))
    assert 0 < min(rejected) + 1 < max(rejected), "none and many are visited"


@pytest.mark.slow
def test_holm_keeps_the_level_of_a_map():
    """1000 nulls of 16 tiles: any tile is found in 5 % of maps; independent tiles leave 1 - (1 - 5 %/16)^16."""
    rng = np.random.default_rng(25)
    alarms = sum(bool((null(rng, (32, 32))[8].holm <= 0.05).any()) for _ in range(1000))
    low, high = stats.binom.ppf([0.0005, 0.9995], 1000, 1 - (1 - 0.05 / 16) ** 16)
    assert low <= alarms <= high


@pytest.mark.slow
def test_a_channel_that_is_right_is_rarely_named():
    """Red is off in a quarter of the tiles, so luminance finds them; green or blue is named in 5 % of maps at most."""
    rng = np.random.default_rng(26)
    mean, wrong = np.ones((32, 32, 3)), np.ones((32, 32, 3))
    wrong[:16, :16, 0] = 1.6
    named, reds = 0, []
    for _ in range(300):
        # Channels with noise of their own, which a right one may have in common with luminance.
        ours, reference = ((each * rng.gamma(4.0, 0.25, (16, 32, 32, 3))).astype(np.float32) for each in (wrong, mean))
        found = summary(tile_maps(measure(ours, reference)))[0]["found"]
        named += any({"green", "blue"} & set(tile["channels"]) for tile in found)
        reds.append(sum("red" in tile["channels"] for tile in found))
    assert named <= stats.binom.ppf(0.999, 300, 0.05)
    assert np.mean(reds) > 3.5


@pytest.mark.slow
def test_benjamini_hochberg_keeps_the_share_of_false_tiles():
    """64 tiles, 16 of them off by a few standard errors: of those found 5 % × 48/64 are false on average, 200 maps."""
    rng = np.random.default_rng(27)
    mean = np.ones((64, 64, 3))
    wrong = mean.copy()
    wrong[:32, :32] *= 1.08  # standard error of a tile's difference: 2.2 %
    shares, missed = [], []
    for _ in range(200):
        found = tile_maps(measure(gamma(rng, wrong), gamma(rng, mean)))[8].benjamini_hochberg <= 0.05
        false = found.sum() - found[:4, :4].sum()
        shares.append(false / max(found.sum(), 1))
        missed.append(16 - found[:4, :4].sum())
    expected = 0.05 * 48 / 64
    assert np.mean(shares) == pytest.approx(expected, abs=4 * np.std(shares) / np.sqrt(200))
    assert 0 < np.mean(missed) < 8


# Where.


@pytest.mark.parametrize("side", [8, 16, 32])
def test_a_planted_tile_is_found_at_its_place(picture, side):
    """Blue is 20 % low, so luminance about 1 %, in one tile of the size; nothing else is found by Holm."""
    rng = np.random.default_rng(28)
    mean = picture(90, 100)
    wrong = mean.copy()
    row, column = 64 // side, 32 // side
    wrong[64 : 64 + side, 32 : 32 + side] *= [1.0, 1.0, 0.8]
    ours, reference = (gamma(rng, each, noise=0.02) for each in (wrong, mean))
    maps = tile_maps(measure(ours, reference))
    assert maps[side].rejected.tolist() == [[row, column]]
    (found,) = next(size["found"] for size in summary(maps) if size["side"] == side)
    height = min(side, 90 - 64)
    assert (found["x"], found["y"], found["width"], found["height"]) == (32, 64, side, height)
    assert found["channels"] == ["blue"]
    assert found["bias"] < 0
    assert found["p"] <= 0.05
    others = maps[side].p[maps[side].holm > 0.05]
    assert np.all(others > found["p"] / maps[side].p.size)


def test_border_tiles_have_their_own_size(picture):
    rng = np.random.default_rng(29)
    mean = picture(20, 37)
    wrong = mean.copy()
    wrong[16:, 32:] *= 1.5
    found = summary(tile_maps(measure(gamma(rng, wrong, noise=0.05), gamma(rng, mean, noise=0.05))))
    for size in found:
        expected = {8: (32, 16, 5, 4), 16: (32, 16, 5, 4), 32: (32, 0, 5, 20)}[size["side"]]
        tile = size["found"][0]
        assert (tile["x"], tile["y"], tile["width"], tile["height"]) == expected


def test_the_surest_tiles_are_listed_first_and_no_more_than_ten(picture):
    rng = np.random.default_rng(30)
    mean = picture(64, 64)
    wrong = mean * np.linspace(1.02, 1.3, 64)[:, None]
    sizes = summary(tile_maps(measure(gamma(rng, wrong, noise=0.02), gamma(rng, mean, noise=0.02))))
    assert sizes[0]["holm"] > 10 == len(sizes[0]["found"])
    p = [tile["p"] for tile in sizes[0]["found"]]
    assert p == sorted(p)
    assert sizes[0]["fraction"] == sizes[0]["benjamini_hochberg"] / 64


# Skewed tiles.


def test_skewed_tiles_are_merged_to_the_next_size():
    """One pixel in 200 gets light: tiles of 8 px hold 0.3 of them, of 16 px 1.3, of 32 px 5; skewness is 1/√."""
    rng = np.random.default_rng(31)

    def sparse(probability):
        hits = rng.random((16, 128, 128, 1)) < probability
        return np.broadcast_to(hits / probability, (16, 128, 128, 3))

    statistics = measure(sparse(0.005), sparse(0.005))
    skewness = statistics.tile_skewness
    assert skewness[8] > 1 > skewness[16] > skewness[32]
    maps = tile_maps(statistics)
    assert [maps[side].merged_into for side in (8, 16, 32)] == [16, None, None]
    assert np.isnan(maps[8].holm).all()
    eight = summary(maps)[0]
    assert (eight["tested"], eight["holm"], eight["found"], eight["uniform_p"]) == (0, 0, [], None)
    # Both small sizes are skewed: 32 px stands for them; and where it is skewed itself, there is no larger one.
    for probability, skewed in ((0.0015, False), (2e-5, True)):
        statistics = measure(sparse(probability), sparse(probability))
        assert (statistics.tile_skewness[32] > 1) is skewed
        merged = [each.merged_into for each in tile_maps(statistics).values()]
        assert merged == [32, 32, None]


def test_skewness_is_the_worse_sides_median_and_scipys():
    rng = np.random.default_rng(32)
    mean = np.ones((16, 24, 3))
    ours, reference = gamma(rng, mean, 9, noise=3.0), gamma(rng, mean, 11, noise=0.1)
    tile_values = [(each @ WEIGHTS).reshape(len(each), 2, 8, 3, 8).mean(axis=(2, 4)) for each in (ours, reference)]
    expected = max(np.median(stats.skew(values, axis=0, bias=False)) for values in tile_values)
    assert measure(ours, reference).tile_skewness[8] == pytest.approx(expected, rel=1e-4)


# What is kept.


def test_summaries_are_plain_json_and_maps_are_variables(picture):
    rng = np.random.default_rng(33)
    maps = tile_maps(measure(gamma(rng, picture(20, 37)), gamma(rng, picture(20, 37))))
    sizes = json.loads(json.dumps(summary(maps), allow_nan=False))
    assert [size["side"] for size in sizes] == [8, 16, 32]
    assert all(len(size["histogram"]) == tiles.BINS for size in sizes)
    kept = variables([None, maps])
    assert set(kept) == {f"tile_{name}_{side}" for name in tiles.MAPS for side in (8, 16, 32)}
    dimensions, values = kept["tile_holm_8"]
    assert dimensions == ("cell", "tile_y_8", "tile_x_8")
    assert np.isnan(values[0]).all()
    np.testing.assert_array_equal(values[1], maps[8].holm)
    assert variables([None]) == {}
