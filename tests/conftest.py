"""What all lanes share."""

import gc
import os
from collections.abc import Iterator

import pytest

# A worker has one core: with threads of its own, BLAS takes four times as long for products of small matrices.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


COMPILED = os.environ.get("NUMBA_DISABLE_JIT", "0") == "0"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave tests marked `plain` to plain Python: what they call would be compiled for them alone."""
    if COMPILED:
        for item in items:
            if item.get_closest_marker("plain"):
                item.add_marker(pytest.mark.skip("runs as plain Python: compiled it needs kernels of its own"))


def pytest_collection_finish() -> None:
    """Leave what was imported and collected out of garbage collections, which took a second each: it stays."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def compiled() -> bool:
    """Whether kernels are compiled; as plain Python (NUMBA_DISABLE_JIT=1) tests keep their sizes small."""
    return COMPILED


@pytest.fixture
def _tables() -> Iterator[None]:
    """Estimators that a test registers are gone after it."""
    from termwise.renderer.terms import VARIANTS

    before = {term: dict(table) for term, table in VARIANTS.items()}
    yield
    for term, table in VARIANTS.items():
        table.clear()
        table.update(before[term])
