"""What all lanes share."""

import os

import pytest

# A worker has one core: with threads of its own, BLAS takes four times as long for products of small matrices.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


@pytest.fixture(scope="session")
def compiled() -> bool:
    """Whether kernels are compiled; as plain Python (NUMBA_DISABLE_JIT=1) tests keep their sizes small."""
    return os.environ.get("NUMBA_DISABLE_JIT", "0") == "0"
