"""Randomness is a value: `key(seed, replicate, pixel or photon, dimension)`, hashed, never a state.

Whatever order or thread asks, the same key gives the same bits.
"""

import numpy as np

from termwise.renderer.jit import device

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_SHIFT_30 = np.uint64(30)
_SHIFT_27 = np.uint64(27)
_SHIFT_31 = np.uint64(31)
_FACTOR_1 = np.uint64(0xBF58476D1CE4E5B9)
_FACTOR_2 = np.uint64(0x94D049BB133111EB)
_ONE = np.uint64(1)
# `seed` and `replicate` fill 64 bits each before mixing, so streams of different pairs are unrelated, not shifted.
_DOMAIN = np.uint64(0xD1B54A32D192ED03)


@device
def mix(x: np.uint64) -> np.uint64:
    """Bijective 64-bit finaliser of SplitMix64 (Steele, Lea, Flood, OOPSLA 2014; Stafford's variant 13)."""
    x = (x ^ (x >> _SHIFT_30)) * _FACTOR_1
    x = (x ^ (x >> _SHIFT_27)) * _FACTOR_2
    return x ^ (x >> _SHIFT_31)


@device
def fold(key: np.uint64, value: int | np.uint64) -> np.uint64:
    """The key of a sub-stream: `value` is a pixel, a photon pass or a dimension."""
    return mix((key ^ _DOMAIN) + (np.uint64(value) + _ONE) * _GOLDEN)


def root(seed: int, replicate: int) -> np.uint64:
    """The key from which all randomness of one replicate is folded.

    Raises
    ------
    ValueError : `seed` or `replicate` outside [0, 2^64).
    """
    for name, value in (("seed", seed), ("replicate", replicate)):
        if not 0 <= value < 2**64:
            raise ValueError(f"{name} = {value}: allowed is an integer in [0, 2^64)")
    return stream(stream(np.uint64(0), seed), replicate)


def stream(key: np.uint64, value: int) -> np.uint64:
    """`fold` for callers outside kernels.

    Compiled code returns an integer of Python, which would enter the next kernel as int64 or uint64 as its size has it.
    """
    return np.uint64(fold(np.uint64(key), np.uint64(value)))
