"""sRGB's curve (IEC 61966-2-1): what a screen is sent for linear values in [0, 1], and back."""

import numpy as np


def encoded(linear: np.ndarray) -> np.ndarray:
    """`12.92 v` up to 0.0031308, else `1.055 v^(1/2.4) - 0.055`, of values from 0 on."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def decoded(shown: np.ndarray) -> np.ndarray:
    """The linear values of what a screen is sent, from 0 on."""
    return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
