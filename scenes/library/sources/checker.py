"""The ground of `glass.toml`: 8 x 8 cells of two greys, 8 texels each, 8-bit sRGB: `python checker.py checker.png`."""

import sys

import numpy as np
import PIL.Image

CELLS, TEXELS = 8, 8
DARK, LIGHT = 72, 214  # of 255, sRGB: 0.065 and 0.672 linear


def texels() -> np.ndarray:
    """The image, (64, 64) uint8."""
    cell = np.indices((CELLS, CELLS)).sum(axis=0) % 2
    return np.where(cell == 0, DARK, LIGHT).astype(np.uint8).repeat(TEXELS, axis=0).repeat(TEXELS, axis=1)


if __name__ == "__main__":
    PIL.Image.fromarray(texels()).convert("RGB").save(sys.argv[1], optimize=True)
