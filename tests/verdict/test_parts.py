"""Replicates are read by parts, each by any thread: what they add up to is what plain formulas say of whole images.

Rationale: parts, bands and threads are there for speed alone. Oracles: NumPy on the whole stack in float64, scipy's
k-statistics; sizes that cut tiles, cells, parts and bands.
"""

import numpy as np
import pytest
from scipy import stats

from termwise.reports.judging.judge import mean_and_variance
from termwise.reports.statistics import accumulation, replicates
from termwise.reports.statistics.accumulation import measure
from tests.verdict.synthetic import picture

HEIGHT, WIDTH, COUNT = 45, 150, 7
WEIGHTS = np.array([0.2126, 0.7152, 0.0722])


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


@pytest.fixture
def sides(rng, monkeypatch) -> tuple[np.ndarray, np.ndarray]:
    """Skewed noise; several parts a band, several bands, threads."""
    monkeypatch.setattr(accumulation, "_ALONE", 0)
    monkeypatch.setattr(replicates, "BAND_BYTES", 0)
    mean = picture(HEIGHT, WIDTH)
    ours, reference = (mean * rng.gamma(2, 0.5, (count, *mean.shape)) for count in (COUNT, 5))
    return ours.astype(np.float32), reference.astype(np.float32)


def quantities(stack: np.ndarray) -> np.ndarray:
    """(n, 4, H, W): luminance and the channels."""
    values = stack.astype(np.float64)
    return np.concatenate([(values @ WEIGHTS)[:, None], np.moveaxis(values, -1, 1)], axis=1)


def blocks(values: np.ndarray, side: int, step: int) -> np.ndarray:
    """Sums over squares that begin at every `step`, cut by the border where they do not overlap."""
    height, width = values.shape[-2:]
    if side > step:  # as far as the last cell
        height, width = (-(-size // step) * step - step for size in (height, width))
    rows, columns = range(0, height, step), range(0, width, step)
    return np.stack(
        [
            np.stack([values[..., y : y + side, x : x + side].sum(axis=(-2, -1)) for x in columns], axis=-1)
            for y in rows
        ],
        axis=-2,
    )


@pytest.mark.parametrize("masked", [False, True])
def test_sums_are_those_of_whole_images(rng, sides, masked, monkeypatch):
    ours, reference = sides
    inside = rng.random((HEIGHT, WIDTH)) < 0.8 if masked else np.ones((HEIGHT, WIDTH), bool)
    objects, kept = rng.integers(-1, 3, (HEIGHT, WIDTH)), []
    events = accumulation._Sums.events
    monkeypatch.setattr(accumulation._Sums, "events", lambda sums, typical: kept.append(sums) or events(sums, typical))
    found = measure(ours, reference, objects=objects, mask=inside if masked else None)

    a, b = (quantities(each) * inside for each in sides)
    means = [each.mean(axis=0) for each in (a, b)]
    for side, step, places in ((8, 8, found.tiles[8]), (32, 32, found.tiles[32]), (8, 4, found.windows)):
        area = np.maximum(blocks(inside, side, step), 1)
        for mean, of_places in zip(means, (places.ours, places.reference), strict=True):
            np.testing.assert_allclose(of_places, blocks(mean, side, step) / area, rtol=1e-12)
    for index, line in enumerate((np.s_[..., 0, :], np.s_[..., -1, :], np.s_[..., 0], np.s_[..., -1])):
        expected = means[0][line].sum(axis=-1) / inside[line].sum()
        np.testing.assert_allclose(found.borders.ours[:, index], expected, rtol=1e-12)
    for region, pixels in enumerate((inside, *(inside & (objects == index) for index in range(3)))):
        expected = means[1][1:, pixels].mean(axis=-1)
        np.testing.assert_allclose(found.regions.reference[region], expected, rtol=1e-12)

    total = inside.sum()
    scale = means[1].sum(axis=(1, 2)) / total
    for side in (1, 2, 8):
        root = np.sqrt(np.maximum(blocks(inside, side, side), 1))
        one, other = (blocks(each, side, side) / root for each in (a, b))
        noise = one.var(axis=0, ddof=1) / len(one) + other.var(axis=0, ddof=1) / len(other)
        theta = ((one.mean(axis=0) - other.mean(axis=0)) ** 2 - noise).sum(axis=(1, 2)) / total / scale**2
        np.testing.assert_allclose([each.value for each in found.mean_square[side]], theta, rtol=1e-9)
    np.testing.assert_allclose(found.variance, a[:, 1:].var(axis=0, ddof=1).sum() / total / 3, rtol=1e-12)

    for side, values in enumerate((a, b)):
        for order in (2, 3):
            expected = blocks(stats.kstat(values, order, axis=0), 8, 8)
            np.testing.assert_allclose(kept[0].cumulants[side][order - 2], expected, rtol=1e-9, atol=1e-15)
    assert kept[0].brightest == max(a[:, 1:].max(), b[:, 1:].max())


def test_mean_and_variance_of_pixels(sides):
    ours = sides[0].copy()
    ours[2, 40, 100, 1] = np.nan
    found = mean_and_variance(ours)
    np.testing.assert_allclose(found.mean, ours.mean(axis=0, dtype=np.float64), rtol=1e-6)
    np.testing.assert_allclose(found.variance, ours.var(axis=0, ddof=1, dtype=np.float64) / COUNT, rtol=1e-6)
    assert np.isnan(mean_and_variance(ours[:1]).variance).all()


def test_images_of_equal_sums_are_no_equal_images(rng):
    """Of whole numbers, whose sums are exact: two pixels are exchanged."""
    ours, reference = (rng.integers(0, 9, (count, 16, 16, 3)).astype(np.float32) for count in (6, 5))
    ours[4] = ours[1]
    with pytest.raises(ValueError, match=r"ours\[1\] and ours\[4\] are the same image"):
        measure(ours, reference)
    ours[4, 0, 0], ours[4, 0, 1] = [1, 2, 3], [2, 1, 3]
    ours[1, 0, 0], ours[1, 0, 1] = [2, 1, 3], [1, 2, 3]
    assert not any("same image" in warning for warning in measure(ours, reference).warnings)


def test_an_image_is_the_same_in_another_type(rng):
    ours, reference = (rng.integers(0, 9, (5, 16, 16, 3)).astype(np.float16) for _ in range(2))
    reference[2] = ours[3]
    with pytest.raises(ValueError, match=r"ours\[3\] and reference\[2\] are the same image"):
        measure(ours, reference.astype(np.float32))


def test_what_is_not_finite_is_not_black():
    black = np.zeros((5, 8, 8, 3))
    assert measure(black, black).absent
    ours = black.copy()
    ours[2, 3, 4, 0] = np.nan
    found = measure(ours, black)
    assert not found.absent
    assert found.non_finite == 1
