"""Counts by contrast: the allotment by hand, the bits that do not depend on threads, and the mean that is not moved.

Rationale: nothing that a mean is made of decides how many samples a pixel gets, so that the mean of each is unbiased,
whatever the corners have missed. Over many replicates it must be that of even counts, and a bias must show.
"""

from typing import Any

import attrs
import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy import stats

from termwise.renderer import Engine, find, render_terms
from termwise.renderer.arrays import from_scene
from termwise.renderer.camera import direction_through
from termwise.renderer.counts import (
    LEAST_FEW,
    LEAST_MANY,
    UNWANTED,
    Contrast,
    coarse,
    contrast,
    corner_camera,
    corners_of,
    counts,
    least,
)
from termwise.renderer.plan import REDUCTIONS, plan
from termwise.renderer.replay import replay
from termwise.scenes.analytic import plate
from termwise.scenes.model import Camera, Material, PointLight, Scene
from termwise.scenes.terms import TERMS
from tests.scenes import small

DIRECT, BACKGROUND = find("direct", "next-event"), find("background", "seen")


def first_hits(name: str, width: int, height: int) -> Scene:
    return small(name, width, height, scope="first-hit")


def of_deviations(deviations: ArrayLike) -> Contrast:
    """Pixels in a row; 256 is the level of the mean deviation, sixteen a factor of two."""
    each = np.asarray(deviations, np.float64)
    return of_levels([np.rint(256 + 16 * np.log2(each / each.mean())).astype(int)])


def of_levels(level: ArrayLike) -> Contrast:
    """Of an image of levels (H, W); 513: of pixels that it is not about."""
    return Contrast(np.array(level), np.bincount(np.ravel(level), minlength=514))


def test_samples_go_as_the_deviation():
    """Deviations 4, 2, 1, 1 have the mean 2: 2 N, N, N / 2, N / 2 spend four pixels' samples exactly."""
    np.testing.assert_array_equal(counts(of_deviations([4.0, 2.0, 1.0, 1.0]), 16, 2), [[32, 16, 8, 8]])


def test_a_pixel_in_many():
    """One of 64 varies: it gets 16 N, the others N / 4, but two samples at least; what is known takes N."""
    one = of_levels([[512, *[0] * 63, UNWANTED, UNWANTED]])
    np.testing.assert_array_equal(counts(one, 64, 2), [[1024, *[16] * 63, 64, 64]])
    np.testing.assert_array_equal(counts(one, 4, 2)[0, 1:64], 2)
    np.testing.assert_array_equal(counts(one, 16, 8)[0, 1:64], 8)


@pytest.mark.parametrize("fewest", [LEAST_FEW, LEAST_MANY])
def test_no_pixel_starves_no_more_is_spent_than_asked_and_none_gets_fewer_for_more(fewest):
    rng = np.random.default_rng(1)
    for _ in range(50):
        found = of_levels(rng.integers(0, 513, (5, 8)))
        before = np.full((5, 8), fewest)
        for samples in range(fewest + 1, 70):
            each = counts(found, samples, fewest)
            assert each.mean() <= samples
            assert (each >= before).all()
            assert (each >= max(fewest, samples // 4)).all()
            before = each
        np.testing.assert_array_equal(np.log2(counts(found, 64, fewest)) % 1, 0.0)


def test_contrast_is_the_variance_among_corners_and_around():
    corners = np.random.default_rng(2).uniform(size=(9, 8, 3))
    wanted = np.ones((8, 7), bool)
    wanted[0] = False
    variance = np.zeros((12, 11))
    for y in range(1, 8):
        for x in range(7):
            four = corners[y : y + 2, x : x + 2].reshape(4, 3)
            variance[y + 2, x + 2] = four.var(axis=0, ddof=1).sum()
    deviation = np.sqrt(
        [variance[y + 2, x + 2] + variance[y : y + 5, x : x + 5].mean() for y in range(1, 8) for x in range(7)]
    )
    found = contrast(corners, wanted)
    assert found is not None
    np.testing.assert_array_equal(found.level[0], UNWANTED)
    expected = of_deviations(deviation + 0.2 * deviation.mean())
    np.testing.assert_array_equal(found.level[1:].ravel(), expected.level[0])
    np.testing.assert_array_equal(found.pixels[:UNWANTED], expected.pixels[:UNWANTED])
    np.testing.assert_array_equal(corners_of(wanted), np.arange(9)[:, None] + np.zeros(8) > 0)


@pytest.mark.parametrize("value", [0.0, 1.0 / 3.0, np.inf, np.nan, 1e200])
def test_without_contrast_counts_are_even(value):
    """Nor where squares are beyond all numbers."""
    corners = np.full((4, 5, 3), value)
    corners[0, 0] *= 1.0 if value < 1.0 else 2.0
    assert contrast(corners, np.ones((3, 4), bool)) is None
    assert least(corners, np.ones((3, 4), bool)) == LEAST_MANY


def test_fewer_samples_are_even_where_few_pixels_hold_the_noise():
    """An edge of two columns of 40, with those about it a quarter of the pixels, and noise in each of them."""
    corners, wanted = np.zeros((41, 41, 3)), np.ones((40, 40), bool)
    corners[:, 20:] = 1.0
    assert least(corners, wanted) == LEAST_FEW
    # Of the pixels that the edge is seen by, and no other, all hold as much as the next.
    assert least(corners, wanted & (np.abs(np.arange(40) - 19) == 1)) == LEAST_MANY
    assert least(np.random.default_rng(3).uniform(size=(41, 41, 3)), wanted) == LEAST_MANY
    assert least(np.zeros((41, 41, 3)), wanted) == LEAST_MANY


def test_a_coarse_image_wants_what_any_of_its_pixels_hold():
    wanted = np.zeros((3, 200), bool)
    wanted[1, [0, 199]] = True
    found = coarse(wanted)
    assert found.shape == (3, 64)
    assert np.argwhere(found).tolist() == [[1, 0], [1, 63]]


def test_rays_go_through_the_corners():
    camera = from_scene(small("two_cubes", 16, 9)).camera
    corners, fewer = corner_camera(camera, 16, 9), corner_camera(camera, 4, 3)
    assert (corners.width, corners.height, fewer.width, fewer.height) == (17, 10, 5, 4)
    for x, y in ((0, 0), (16, 9), (4, 3)):
        np.testing.assert_allclose(direction_through(corners, x, y), direction_through(camera, x, y), atol=1e-15)
        np.testing.assert_allclose(direction_through(fewer, x / 4, y / 3), direction_through(camera, x, y), atol=1e-15)


@pytest.mark.parametrize(("scene", "variant"), [("cornell_box", DIRECT), ("two_cubes", BACKGROUND)])
def test_same_bits_for_any_threads_windows_and_prefixes(scene, variant, compiled):
    scene = first_hits(scene, *((20, 12) if compiled else (6, 5)))
    most = 64 if compiled else 16
    images: list[dict[int, bytes]] = []
    for threads, samples, without, asked in (
        (1, most, (), None),
        (3, most, (), None),
        (2, 2 * most, ("window",), None),
        (2, most, (), (most // 2, most)),
        (2, most, (), (1, 7, 9, 15, most)),
    ):
        with Engine(scene, threads=threads, without=without) as engine:
            found = engine.prefixes(variant, samples=samples, seed=2, replicate=1, counts=asked)
            images.append({n: image.tobytes() for n, image, _ in found})
    for n, image in images[0].items():
        assert all(others.get(n, image) == image for others in images)


@pytest.mark.parametrize("variant", [find("ambient"), find("direct", "path"), DIRECT])
def test_without_counts_and_where_they_do_not_serve_all_pixels_have_the_same(variant, compiled):
    """Of direct light up to two samples; of the others at any N. Rays are counted."""
    samples = 2 if variant is DIRECT else 8
    scene = first_hits("cornell_box", 8 if compiled else 4, 6 if compiled else 3)
    with Engine(scene, threads=1) as engine, Engine(scene, threads=1, without=("counts",)) as even:
        one, other = (list(e.prefixes(variant, samples=samples, seed=1, replicate=0)) for e in (engine, even))
        assert [image.tobytes() for _, image, _ in one] == [image.tobytes() for _, image, _ in other]
        assert engine.counts == even.counts
        *_, _ = even.prefixes(DIRECT, samples=16, seed=1, replicate=0)
        before = even.counts["rays"]
        *_, _ = even.prefixes(DIRECT, samples=16, seed=1, replicate=0)
        assert even.counts["rays"] - before == 16 * scene.resolution[0] * scene.resolution[1]


def test_the_same_for_all_seeds_and_no_more_than_asked():
    """A ray for each corner of the box, once; then as many for each replicate, at most N a pixel."""
    scene = first_hits("cornell_box", 16, 12)
    with Engine(scene, threads=2) as engine:
        spent = []
        for seed in (1, 2, 3):
            before = engine.counts["rays"]
            *_, _ = engine.prefixes(DIRECT, samples=16, seed=seed, replicate=seed)
            spent.append(engine.counts["rays"] - before)
    assert spent[1] == spent[2] == spent[0] - 17 * 13
    assert 0.9 * 16 * 16 * 12 < spent[1] <= 16 * 16 * 12


def test_shares_are_those_that_are_taken():
    """By contrast of one term, unless all rays of a pixel are one; even of others, as the plan says."""
    scene = first_hits("cornell_box", 16, 12)
    with Engine(scene, threads=2) as engine:
        each = engine.shares(DIRECT, samples=16)
        before = engine.counts["rays"]
        *_, _ = engine.prefixes(DIRECT, samples=16, seed=1, replicate=0)
        assert engine.counts["rays"] - before == each.sum()
        assert each.min() < 16 < each.max()
        for variant, samples in ((DIRECT, 2), (find("ambient"), 16), (BACKGROUND, 16)):
            np.testing.assert_array_equal(engine.shares(variant, samples=samples), samples)
    with Engine(attrs.evolve(scene, camera=attrs.evolve(scene.camera, pixel="centre")), threads=2) as engine:
        np.testing.assert_array_equal(engine.shares(DIRECT, samples=16), 16)
    steps = plan(scene, {term: find(term) for term in TERMS}, samples=16)
    assert [step.term for step in steps if step.work == REDUCTIONS["counts"].work] == ["direct"]


def test_terms_together_have_the_bits_of_each_alone(compiled):
    """One engine serves terms that want other counts."""
    scene = first_hits("two_cubes", *((24, 18) if compiled else (5, 4)))
    variants = {"ambient": None, "direct": "next-event", "background": None}
    together = render_terms(scene, variants, samples=16, seed=4)
    for term, variant in variants.items():
        alone = render_terms(scene, {term: variant}, samples=16, seed=4)[term]
        np.testing.assert_array_equal(together[term].mean, alone.mean)


def test_a_pixel_alone_and_replayed_is_the_rendered_one(compiled):
    if not compiled:
        pytest.skip("compares the compiled kernel with plain Python")
    scene = first_hits("cornell_box", 12, 10)
    with Engine(scene, threads=2) as engine:
        *_, (_, image, _) = engine.prefixes(DIRECT, samples=16, seed=5, replicate=3)
        (known,) = engine.contrasts.values()
    assert known is not None
    assert (known.level < UNWANTED).all()
    each = counts(known, 16, LEAST_MANY)
    assert each.min() < each.max()
    for place in (each.argmin(), each.argmax()):
        y, x = divmod(int(place), 12)
        found = replay(scene, DIRECT, x=x, y=y, samples=16, seed=5, replicate=3)
        assert found.value.tobytes() == image[y, x].tobytes()
        assert found.astray == ()
        assert len(found.samples) == each[y, x]


def tile_means(scene: Scene, term: str, *, samples: int, seed: int, **settings: Any) -> np.ndarray:
    """Means of the 8 x 8 tiles and channels of 32 x 24 pixels, (64 replicates, 36)."""
    return tiled(replicates(attrs.evolve(scene, resolution=(32, 24)), term, samples=samples, seed=seed, **settings))


def tiled(images: np.ndarray) -> np.ndarray:
    """Means of 8 x 8 pixels."""
    return images.reshape(64, 3, 8, 4, 8, 3).mean(axis=(2, 4)).reshape(64, -1)


def replicates(scene: Scene, term: str, *, samples: int, seed: int, **settings: Any) -> np.ndarray:
    """(64, H, W, 3)."""
    with Engine(scene, **settings) as engine:
        runs = (engine.prefixes(find(term), samples=samples, seed=seed, replicate=k) for k in range(64))
        return np.array([image for run in runs for *_, (_, image, _) in [run]])


def assert_same_mean(one: np.ndarray, other: np.ndarray) -> None:
    """By Welch's test of each column of (64, M)."""
    noisy = (one.var(axis=0) > 0) & (other.var(axis=0) > 0)
    tested: Any = stats.ttest_ind(one[:, noisy], other[:, noisy], equal_var=False)
    assert noisy.sum() >= 12
    assert tested.pvalue.min() > 1e-3 / noisy.sum()


def chi_square(one: np.ndarray, other: np.ndarray) -> float:
    """Probability of so great a sum of z squared over the pixels of (64, H, W, 3), all channels of each together.

    Pixels are independent: each has its own numbers.
    """
    ours, theirs = (images.sum(axis=-1).reshape(64, -1) for images in (one, other))
    noisy = (ours.std(axis=0) > 1e-3 * ours.mean()) & (theirs.std(axis=0) > 1e-3 * theirs.mean())
    tested: Any = stats.ttest_ind(ours[:, noisy], theirs[:, noisy], equal_var=False)
    assert noisy.sum() >= 50
    return float(stats.chi2.sf(stats.chi2.isf(tested.pvalue, 1).sum(), noisy.sum()))


@pytest.mark.parametrize(
    ("scene_name", "term"), [("cornell_box", "direct"), ("monkey", "direct"), ("two_cubes", "background")]
)
def test_the_mean_is_not_moved(scene_name, term, compiled):
    """And a bias of 1 % would be seen, by tiles and by pixels."""
    if not compiled:
        pytest.skip("128 images take minutes as plain Python")
    scene = first_hits(scene_name, 32, 24)
    ours = replicates(scene, term, samples=16, seed=3)
    even = replicates(scene, term, samples=16, seed=4, without=("counts",))
    assert_same_mean(tiled(ours), tiled(even))
    assert chi_square(ours, even) > 1e-3
    with pytest.raises(AssertionError):
        assert_same_mean(1.01 * tiled(ours), tiled(even))
    assert chi_square(1.01 * ours, even) < 1e-3
    # And what it is for: less noise of no more samples.
    assert ours.var(axis=0).sum() < 0.9 * even.var(axis=0).sum()


def test_what_the_corners_miss_has_its_mean(compiled):
    """A plate that lies amid one pixel, what varies is elsewhere: N / 4 samples, and the light that it sends."""
    if not compiled:
        pytest.skip("128 images take minutes as plain Python")
    white = Material((1.0, 1.0, 1.0))
    edge = plate("edge", (-0.05, -0.43, 0.0), (0.3, 0.1, 0.0), (0.0, 0.3, 0.0), white)
    speck = plate("speck", (0.52, 0.52, 0.0), (0.05, 0.0, 0.0), (0.0, 0.05, 0.0), white)
    scene = Scene(
        "speck",
        Camera((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0), fov=90.0),
        (edge, speck),
        (PointLight((0.0, 0.0, 3.0), (1.0, 1.0, 1.0)),),
        resolution=(20, 20),
        scope="first-hit",
    )
    ours = replicates(scene, "direct", samples=16, seed=3)
    even = replicates(scene, "direct", samples=16, seed=4, without=("counts",))
    x, y = 15, 4
    lit = [images[:, y, x, 0] for images in (ours, even)]
    assert min(light.mean() for light in lit) > 0.0
    tested: Any = stats.ttest_ind(*lit, equal_var=False)
    assert tested.pvalue > 1e-3
    with Engine(scene, threads=1, pixel=(x, y)) as engine:
        *_, _ = engine.prefixes(DIRECT, samples=16, seed=3, replicate=0)
        (found,) = engine.contrasts.values()
    assert found is not None
    assert counts(found, 16, LEAST_FEW)[y, x] == 4
