"""Replicates are allotted by what a pilot found to vary: as many as a half width asks for, and no more than that."""

import itertools

import numpy as np
import pytest
from scipy import stats

from termwise.reports.study.allotment import AIM, DOF, MOST, WORK, Noise, allot, scale, variance

HALF_WIDTH = 1e-3
ERROR = AIM * HALF_WIDTH / stats.t.ppf(0.95, DOF)
"""Standard error at which an interval is as wide as is aimed for."""
# What keeps the work of all rows together small, as most rows of a study do.
QUIET = [Noise(f"quiet {i}", f"still {i}", np.zeros(3), np.zeros(3), 1.0, 1.0) for i in range(200)]


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(1)


def noise(ours: float, reference: float, name: str = "reference", price: float = 4.0) -> Noise:
    """A row whose worst channel has these standard errors, in units of the one aimed for."""
    v, w = ((each * ERROR * np.array([0.5, 1.0, 0.1])) ** 2 for each in (ours, reference))
    return Noise(f"ours of {ours}", name, v, w, 1.0, price)


@pytest.mark.parametrize("ours", [0.2, 0.9, 1.7, 2.2])
@pytest.mark.parametrize("reference", [0.0, 0.7, 2.0])
@pytest.mark.parametrize("price", [0.5, 4.0])
def test_a_row_is_as_narrow_as_asked_for_at_the_least_cost(ours: float, reference: float, price: float):
    """By trying all pairs of quarters: rounding up costs a quarter of each side at most."""
    row = noise(ours, reference, price=price)
    factors, given = allot([row, *QUIET], HALF_WIDTH)
    f, g = factors[row.ours], factors[row.reference]
    assert given == HALF_WIDTH
    assert ours**2 / f + reference**2 / g <= 1 + 1e-9
    pairs = itertools.product(np.arange(1, MOST + 0.25, 0.25), repeat=2)
    least = min(a + price * b for a, b in pairs if ours**2 / a + reference**2 / b <= 1)
    assert least <= f + price * g <= least + 0.25 * (1 + price)


def test_a_shared_reference_serves_its_noisiest_row():
    quiet, noisy = noise(0.5, 1.5), noise(3.0, 1.5)
    together, _ = allot([quiet, noisy, *QUIET], HALF_WIDTH)
    alone, _ = allot([noisy, *QUIET], HALF_WIDTH)
    assert together["reference"] == alone["reference"] > 1
    assert together[quiet.ours] == 1


def test_nothing_is_allotted_where_nothing_is_wide():
    factors, given = allot([noise(0.6, 0.6), *QUIET], HALF_WIDTH)
    assert set(factors.values()) == {1.0}
    assert given == HALF_WIDTH
    assert allot([], HALF_WIDTH) == ({}, HALF_WIDTH)


def test_the_work_of_all_rows_is_bounded():
    """Ten rows that ask for 18 times the replicates of both sides: the half width gives way, for all of them alike."""
    rows = [noise(3.0 + i / 10, 3.0, name=f"reference {i}") for i in range(10)]
    factors, given = allot(rows, HALF_WIDTH)
    cost = sum(count * (4.0 if "reference" in str(name) else 1.0) for name, count in factors.items())
    assert 0.7 * WORK <= cost / (10 * (1.0 + 4.0)) <= WORK
    assert given > HALF_WIDTH
    hopeless, _ = allot([noise(50.0, 0.1), *QUIET], HALF_WIDTH)
    assert hopeless["ours of 50.0"] == MOST


def test_variance_of_a_mean_from_independent_pixels(rng):
    """Two replicates of 48² pixels: the variance to 3 %, where their two means would tell next to nothing."""
    sigma = np.array([0.1, 0.2, 0.3])
    images = 1 + sigma * rng.normal(size=(2, 48, 48, 3))
    np.testing.assert_allclose(variance(images, correlated=False), sigma**2 / 48**2, rtol=5 * np.sqrt(2 / 48**2))


def test_variance_of_a_mean_from_correlated_pixels(rng):
    """A factor of 1 % common to all pixels, which no pixel's own variance shows."""
    images = 1 + 0.01 * rng.normal(size=(64, 1, 1, 1)) + 0.01 * rng.normal(size=(64, 16, 16, 3))
    assert variance(images, correlated=True) == pytest.approx(1e-4, rel=5 * np.sqrt(2 / 63))
    assert (variance(images, correlated=False) < 1e-6).all()


def test_scale_is_that_of_a_bias():
    """A channel's mean, or a tenth of the luminance where the channel is darker than that."""
    images = np.broadcast_to([1.0, 0.5, 0.01], (2, 4, 4, 3))
    luminance = 0.2126 + 0.7152 * 0.5 + 0.0722 * 0.01
    np.testing.assert_allclose(scale(images), [1.0, 0.5, 0.1 * luminance], rtol=1e-4)
