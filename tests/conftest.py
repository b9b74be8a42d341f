"""What all lanes share."""

import os

import pytest


@pytest.fixture(scope="session")
def compiled() -> bool:
    """Whether kernels are compiled; as plain Python (NUMBA_DISABLE_JIT=1) tests keep their sizes small."""
    return os.environ.get("NUMBA_DISABLE_JIT", "0") == "0"
