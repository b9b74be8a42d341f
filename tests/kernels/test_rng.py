"""Counter-based randomness: keys are distinct, bits are fair and independent.

Rationale: randomness is a value here, so two streams that share keys, or a bit that follows another, would bias every
estimate in a way that replicates (which share the generator) cannot show.
"""

import numpy as np
import pytest
from scipy import stats

from termwise.renderer.rng import fold, mix, root, stream
from termwise.renderer.sobol import Sampler, sample_1d


def hashes(count: int) -> np.ndarray:
    key = root(11, 3)
    return np.array([fold(key, index) for index in range(count)], np.uint64)


def test_splitmix_of_a_published_sequence():
    """SplitMix64 from state 1234567 begins 6457827717110365317, 3203168211198807973 (its authors' test values)."""
    golden = 0x9E3779B97F4A7C15
    for step, expected in enumerate((6457827717110365317, 3203168211198807973), start=1):
        assert int(mix(np.uint64((1234567 + step * golden) % 2**64))) == expected


def test_bits_are_fair(compiled):
    """Each of 64 bits is set in half of the hashes of successive integers: chi² over 64 bits, p > 1e-4 both ends."""
    values = hashes(20_000 if compiled else 3000)
    bits = (values[:, None] >> np.arange(64, dtype=np.uint64)) & np.uint64(1)
    z = (bits.sum(axis=0) - len(values) / 2) / np.sqrt(len(values) / 4)
    assert 1e-4 < stats.chi2.sf((z**2).sum(), 64) < 1 - 1e-4


def test_pairs_of_bits_are_independent(compiled):
    """The 2016 pairs of bits, and each bit with its successor's in the stream, are uncorrelated: chi², p > 1e-4."""
    values = hashes(20_000 if compiled else 3000)
    bits = ((values[:, None] >> np.arange(64, dtype=np.uint64)) & np.uint64(1)).astype(float) * 2 - 1
    within = bits.T @ bits / np.sqrt(len(bits))
    z = within[np.triu_indices(64, 1)]
    assert 1e-4 < stats.chi2.sf((z**2).sum(), len(z)) < 1 - 1e-4
    across = bits[1:].T @ bits[:-1] / np.sqrt(len(bits) - 1)
    assert 1e-4 < stats.chi2.sf((across**2).sum(), across.size) < 1 - 1e-4


def test_flipping_one_input_bit_flips_half_of_the_output():
    """Avalanche: over 64 input bits of 40 values, the share of flipped output bits is 1/2 within 4.5 sigma."""
    rng = np.random.default_rng(1)
    flips = []
    for value in rng.integers(0, 2**63, 40):
        for bit in range(63):
            key = root(1, 2)
            a, b = (int(fold(key, int(x))) for x in (value, value ^ (1 << bit)))
            flips.append((a ^ b).bit_count())
    assert abs(np.mean(flips) - 32) < 4.5 * 4 / np.sqrt(len(flips))


def test_keys_of_all_streams_are_distinct(compiled):
    """Roots of seeds and replicates, in both orders, and pixels and dimensions below them never coincide."""
    n = 40 if compiled else 10
    roots = [root(seed, replicate) for seed in range(n) for replicate in range(n)]
    below = [stream(stream(key, pixel), d) for key in roots[:10] for pixel in range(n) for d in range(n)]
    values = {int(value) for value in (*roots, *below)}
    assert len(values) == len(roots) + len(below)


def test_keys_are_64_bit_whatever_their_size():
    """A key above 2^63 and one below have one type: a kernel compiles once, and its hash is the same either way.

    Compiled functions return Python integers, which become int64 or uint64 as their size has it.
    """
    keys = [root(seed, 0) for seed in range(20)]
    assert {type(key) for key in keys} == {np.uint64}
    assert min(keys) < 2**63 <= max(keys)
    assert {type(stream(key, 1 << 40)) for key in keys} == {np.uint64}


def test_root_against_the_formula_in_python_integers():
    """`root` is fold(fold(0, seed), replicate), here with Python's unbounded integers modulo 2^64."""

    def mixed(x: int) -> int:
        x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9 % 2**64
        x = (x ^ (x >> 27)) * 0x94D049BB133111EB % 2**64
        return x ^ (x >> 31)

    def folded(key: int, value: int) -> int:
        return mixed(((key ^ 0xD1B54A32D192ED03) + (value + 1) * 0x9E3779B97F4A7C15) % 2**64)

    for seed, replicate in ((0, 0), (3, 5), (2**63, 1), (2**64 - 1, 2**64 - 1)):
        assert int(root(seed, replicate)) == folded(folded(0, seed), replicate)


@pytest.mark.parametrize(("seed", "replicate"), [(-1, 0), (0, -1), (2**64, 0), (0, 2**64)])
def test_root_refuses_what_does_not_fit(seed, replicate):
    """The message names the argument, its value and the range."""
    bad = "seed" if replicate == 0 else "replicate"
    with pytest.raises(ValueError, match=rf"{bad} = .*allowed is an integer in \[0, 2\^64\)"):
        root(seed, replicate)


def test_dimensions_of_one_pixel_are_independent(compiled):
    """Coordinates of dimensions over many pixels: uniform, and uncorrelated by Spearman, p > 1e-4 each."""
    count = 3000 if compiled else 500
    key = root(7, 0)
    values = np.array(
        [[sample_1d(Sampler(stream(key, pixel), np.uint32(0)), d) for d in range(3)] for pixel in range(count)]
    )
    for a, b in ((0, 1), (0, 2), (1, 2)):
        assert np.asarray(stats.spearmanr(values[:, a], values[:, b]))[1] > 1e-4
    for d in range(3):
        assert stats.kstest(values[:, d], "uniform").pvalue > 1e-4
