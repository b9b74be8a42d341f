"""Owen-scrambled Sobol points, padded in pairs of dimensions.

Every pair of dimensions is the (0, 2)-sequence of Sobol, its index shuffled and its values scrambled by hashes of the
pair's own key: within a pair every power-of-two prefix is a scrambled net, between pairs points are unrelated.
Burley, "Practical Hash-based Owen Scrambling", JCGT 9(4), 2020; the hash is Laine and Karras' of that paper.
At 4096 samples the RMSE is 9 to 30 times less than that of independent samples (measured on AO and on VNDF).
Unbiased: each point alone is uniform on [0, 1)².
"""

from typing import NamedTuple

import numpy as np

from termwise.renderer.jit import device
from termwise.renderer.rng import fold


class Sampler(NamedTuple):
    """Sample `index` (below 2^32) of the sequence that belongs to `key` (a pixel, or a photon pass)."""

    key: np.uint64
    index: np.uint32


_U1, _U2, _U4, _U8, _U16 = (np.uint32(n) for n in (1, 2, 4, 8, 16))
_BITS_1, _BITS_2 = np.uint32(0x55555555), np.uint32(0x33333333)
_BITS_4, _BITS_8 = np.uint32(0x0F0F0F0F), np.uint32(0x00FF00FF)
_LK_1, _LK_2, _LK_3 = np.uint32(0x3D20ADEA), np.uint32(0x05526C56), np.uint32(0x53A22864)
_LOW = np.uint64(0xFFFFFFFF)
_TO_UNIT = 2.0**-32


@device
def _reverse(x: np.uint32) -> np.uint32:
    x = ((x >> _U1) & _BITS_1) | ((x & _BITS_1) << _U1)
    x = ((x >> _U2) & _BITS_2) | ((x & _BITS_2) << _U2)
    x = ((x >> _U4) & _BITS_4) | ((x & _BITS_4) << _U4)
    x = ((x >> _U8) & _BITS_8) | ((x & _BITS_8) << _U8)
    return np.uint32((x >> _U16) | (x << _U16))


@device
def _second_dimension(x: np.uint32) -> np.uint32:
    """Sobol's second dimension of an index, in reversed bits: `r_k = XOR of i_b with C(b, k) odd`.

    C(b, k) is odd where b has all bits of k (Lucas), so that the sum over b is one over each bit of k in turn.
    """
    x = np.uint32(x ^ (x >> _U16))
    x = np.uint32(x ^ ((x >> _U8) & _BITS_8))
    x = np.uint32(x ^ ((x >> _U4) & _BITS_4))
    x = np.uint32(x ^ ((x >> _U2) & _BITS_2))
    return np.uint32(x ^ ((x >> _U1) & _BITS_1))


@device
def _scramble_reversed(x: np.uint32, seed: np.uint32) -> np.uint32:
    """Owen scrambling of a bit-reversed value."""
    x = np.uint32(x ^ np.uint32(x * _LK_1))
    x = np.uint32(x + seed)
    x = np.uint32(x * np.uint32((seed >> _U16) | _U1))
    x = np.uint32(x ^ np.uint32(x * _LK_2))
    return np.uint32(x ^ np.uint32(x * _LK_3))


@device
def _seeds(key: np.uint64, dimension: int) -> tuple[np.uint32, np.uint32, np.uint32]:
    """Seeds of a pair of dimensions: by which its index is shuffled, and its two values are scrambled."""
    key = fold(key, dimension)
    more = fold(key, 0)
    return np.uint32(key & _LOW), np.uint32(key >> np.uint64(32)), np.uint32(more & _LOW)


@device
def _point(index: np.uint32, shuffle: np.uint32, first: np.uint32, second: np.uint32) -> tuple[np.uint32, np.uint32]:
    """Point of a pair of dimensions, times 2^32, by its seeds."""
    index = _reverse(_scramble_reversed(_reverse(index), shuffle))
    # The reversed bits of an index are Sobol's first dimension.
    u = _reverse(_scramble_reversed(index, first))
    return u, _reverse(_scramble_reversed(_second_dimension(index), second))


@device
def _unit(x: np.uint32) -> float:
    return (x + 0.5) * _TO_UNIT


@device
def sample_2d(sampler: Sampler, dimension: int) -> tuple[float, float]:
    """Point of a pair of dimensions, in (0, 1)²; `dimension` is the pair's number."""
    shuffle, first, second = _seeds(sampler.key, dimension)
    u, v = _point(sampler.index, shuffle, first, second)
    return _unit(u), _unit(v)


@device
def draw_2d(
    key: np.ndarray, index: np.ndarray, count: int, dimension: int, u: np.ndarray, v: np.ndarray, words: np.ndarray
) -> None:
    """`sample_2d` of the first `count` keys (uint64) and indices; `words` is (4, `count` at least) uint32 scratch.

    A loop for each width of number: vectorised, what takes 32 bits goes twice as many at a time as what takes 64.
    """
    for k in range(count):
        words[0, k], words[1, k], words[2, k] = _seeds(key[k], dimension)
        words[3, k] = index[k]
    for k in range(count):
        words[0, k], words[1, k] = _point(words[3, k], words[0, k], words[1, k], words[2, k])
    for k in range(count):
        u[k], v[k] = _unit(words[0, k]), _unit(words[1, k])


@device
def sample_1d(sampler: Sampler, dimension: int) -> float:
    """Coordinate in (0, 1) of a dimension used alone."""
    return sample_2d(sampler, dimension)[0]
