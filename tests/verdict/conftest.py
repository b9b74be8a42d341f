"""Synthetic replicates whose limit is known."""

from collections.abc import Callable

import numpy as np
import pytest

from tests.verdict import synthetic

Replicates = Callable[..., np.ndarray]


@pytest.fixture
def replicates() -> Replicates:
    """A function: replicates (count, H, W, 3) of a known mean image with unbiased noise."""
    return synthetic.replicates


@pytest.fixture
def picture() -> Callable[..., np.ndarray]:
    """A function: a smooth positive colour image (H, W, 3), optionally seen `shift` pixels further right."""
    return synthetic.picture
