"""Owen-scrambled Sobol points: nets, unbiasedness, and SciPy's unscrambled table.

Rationale: the low-discrepancy gain is lost silently when a prefix is no net, and a scrambling whose points are not
uniform biases every estimate by an amount that no convergence plot shows.
"""

import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc

from termwise.renderer.rng import root
from termwise.renderer.sobol import Sampler, _second_dimension, sample_1d, sample_2d


def points(seed: int, count: int, first: int = 0, dimension: int = 3) -> np.ndarray:
    key = root(seed, 0)
    return np.array([sample_2d(Sampler(key, np.uint32(i)), dimension) for i in range(first, first + count)])


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_prefixes_are_nets(seed, compiled):
    """(0, m, 2)-net: each elementary interval 2^-j x 2^-(m-j), for all j, holds exactly one of the first 2^m points."""
    most = 10 if compiled else 7
    all_points = points(seed, 2**most)
    for m in range(most + 1):
        prefix = all_points[: 2**m]
        for j in range(m + 1):
            cell = np.floor(prefix[:, 0] * 2**j) * 2 ** (m - j) + np.floor(prefix[:, 1] * 2 ** (m - j))
            assert len(np.unique(cell)) == 2**m, (m, j)


def test_blocks_are_nets(compiled):
    """A (0, 2)-sequence: blocks [k 2^m, (k + 1) 2^m) are nets too, so that samples added later fill the gaps."""
    m = 6 if compiled else 4
    for block in (1, 2, 5):
        chunk = points(4, 2**m, first=block * 2**m)
        for j in range(m + 1):
            cell = np.floor(chunk[:, 0] * 2**j) * 2 ** (m - j) + np.floor(chunk[:, 1] * 2 ** (m - j))
            assert len(np.unique(cell)) == 2**m, (block, j)


def test_points_lie_inside_the_open_square(compiled):
    """0 and 1 would give infinities in the warps."""
    values = points(5, 4096 if compiled else 256)
    assert values.min() > 0.0
    assert values.max() < 1.0


def test_scrambling_is_unbiased(compiled):
    """Mean over seeds of a 4-point estimate of the area of a disc, a discontinuous f: pi / 16 within 4.5 sigma.

    Each point alone must be uniform, so the N-point mean has expectation ∫ f for any N, here 1, 3 and 4.
    """
    seeds = 2000 if compiled else 300
    chosen = np.array([points(seed, 4) for seed in range(seeds)])
    inside = ((chosen - 0.3) ** 2).sum(axis=2) < 0.0625
    for count in (1, 3, 4):
        means = inside[:, :count].mean(axis=1)
        z = (means.mean() - np.pi * 0.0625) / (means.std(ddof=1) / np.sqrt(seeds))
        assert abs(z) < 4.5, (count, z)


def test_each_point_is_uniform(compiled):
    """Point `index` over seeds: chi² on an 8 x 8 grid, p > 1e-4, for the first, and a far index."""
    seeds = 4000 if compiled else 500
    for index in (0, 5, 2**31 + 12345):
        values = np.array([points(seed, 1, first=index)[0] for seed in range(seeds)])
        counts, _, _ = np.histogram2d(*values.T, bins=8, range=[[0, 1], [0, 1]])
        assert stats.chisquare(counts.ravel()).pvalue > 1e-4


def test_second_dimension_against_scipy():
    """The index's bits give SciPy's unscrambled Sobol points (Joe and Kuo) as a set, prefix by prefix.

    SciPy orders points by Gray code, which permutes within each power-of-two prefix.
    """
    with np.errstate(all="ignore"):
        table = qmc.Sobol(2, scramble=False, bits=32).random(256)
    index = np.arange(256, dtype=np.uint32)
    first, second = (
        np.array([int(f"{i:032b}"[::-1], 2) for i in bits]) / 2**32
        for bits in (index, [_second_dimension(i) for i in index])
    )
    for m in range(9):
        ours = np.stack([first, second], axis=1)[: 2**m]
        theirs = table[: 2**m]
        assert {tuple(p) for p in ours.tolist()} == {tuple(p) for p in theirs.tolist()}


def test_second_dimension_is_linear_over_bits():
    """Sobol's map is linear over GF(2): its value of a ^ b is the XOR of theirs; no bit is lost."""
    pairs = np.random.default_rng(1).integers(0, 2**32, (100, 2), np.uint32)
    for a, b in pairs:
        assert _second_dimension(a ^ b) == _second_dimension(a) ^ _second_dimension(b)
    assert len({int(_second_dimension(np.uint32(1 << bit))) for bit in range(32)}) == 32


def test_rmse_falls_faster_than_that_of_independent_points(compiled):
    """For a smooth f the RMSE of 256 points is below a fifth of sigma / 16, that of independent ones."""
    seeds = 50 if compiled else 8
    estimates = []
    for seed in range(seeds):
        u, v = points(seed, 256).T
        estimates.append(np.mean(np.sin(np.pi * u) * v * v))
    exact = 2 / np.pi / 3
    sigma = np.sqrt(0.5 / 5 - exact**2)
    assert np.sqrt(np.mean((np.array(estimates) - exact) ** 2)) < sigma / 16 / 5


def test_one_dimension_is_the_first_of_a_pair():
    """`sample_1d` stratifies too: 64 points fill 64 strata."""
    key = root(1, 1)
    values = [sample_1d(Sampler(key, np.uint32(i)), 9) for i in range(64)]
    assert sorted(int(64 * value) for value in values) == list(range(64))
