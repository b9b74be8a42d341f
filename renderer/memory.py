"""Arrays on cache lines of their own.

A vector of 64 bytes that lies on two lines is read twice, and threads that write to one line wait for each other.
"""

import numpy as np
from numpy.typing import DTypeLike

_LINE = 64


def aligned(shape: int | tuple[int, ...], dtype: DTypeLike) -> np.ndarray:
    """Array of undefined entries that begins at a cache line; no other array lies on its last one."""
    count = int(np.prod(shape)) * np.dtype(dtype).itemsize
    memory = np.empty(count + 2 * _LINE, np.uint8)
    skip = -memory.ctypes.data % _LINE
    return memory[skip : skip + count].view(dtype).reshape(shape)


def on_own_lines(array: np.ndarray) -> np.ndarray:
    """Copy of an array with the alignment of `aligned`."""
    copy = aligned(array.shape, array.dtype)
    copy[...] = array
    return copy
