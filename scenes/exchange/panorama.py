"""The sky's image in the maps that other renderers read: radiance by direction, as a point sees it.

Others have their sky infinitely far. Ours may lie on a sphere at a finite distance, so that it is looked up by where a
ray from a given point meets it; seen from there the map is right, from elsewhere it is off by the parallax.
"""

import math

import numpy as np

from termwise.scenes.model import Sky, Vector


def seen(sky: Sky, point: Vector, directions: np.ndarray) -> np.ndarray:
    """Radiance (..., 3) float64 of a textured sky from a point along unit directions (..., 3), as `Sky` says."""
    texture = sky.texture
    assert texture is not None
    n, met = directions, np.ones(directions.shape[:-1], bool)
    if math.isfinite(sky.radius):
        offset = np.subtract(point, sky.center)
        b = directions @ offset
        square = sky.radius**2 - offset @ offset + b * b
        distance = np.sqrt(np.maximum(square, 0.0)) - b
        met = (square >= 0.0) & (distance > 0.0)
        n = (offset + distance[..., None] * directions) / sky.radius
    height, width = texture.shape[:2]
    z = np.clip(n[..., 2], -1.0, 1.0)
    u = np.arctan2(n[..., 0], n[..., 1]) / (2.0 * np.pi) + 0.5
    v = 0.5 - z / 2.0 if sky.projection == "equal-area" else np.arccos(z) / np.pi
    x, y = u * width - 0.5, np.clip(v * height - 0.5, 0.0, height - 1.0)
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    right, bottom = (left + 1) % width, np.minimum(top + 1, height - 1)
    left = left % width
    across, down = (x - np.floor(x))[..., None], (y - top)[..., None]
    upper = (1.0 - across) * texture[top, left] + across * texture[top, right]
    lower = (1.0 - across) * texture[bottom, left] + across * texture[bottom, right]
    return np.where(met[..., None], (1.0 - down) * upper + down * lower, 0.0)


def latitude_longitude(sky: Sky, point: Vector) -> np.ndarray:
    """A map (H, 2 H, 3) float32 of the sky from a point: row by the angle from +z, column by that about it.

    Texel (row, column) is the radiance along (sin t cos p, sin t sin p, cos t), t = pi (row + 1/2) / H and
    p = pi (1 - (column + 1/2) / H): the middle column looks along +x, the next ones towards -y.
    """
    height = _height(sky)
    t = np.pi * (np.arange(height) + 0.5)[:, None] / height
    p = np.pi * (1.0 - (np.arange(2 * height) + 0.5)[None, :] / height)
    directions = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t) + 0.0 * p], axis=-1)
    return seen(sky, point, directions).astype(np.float32)


def equal_area_square(sky: Sky, point: Vector) -> np.ndarray:
    """A map (N, N, 3) float32 of the sky from a point, by Clarberg's equal-area mapping of the square to the sphere."""
    size = 2 * _height(sky)
    centres = (np.arange(size) + 0.5) / size
    return seen(sky, point, square_to_sphere(*np.meshgrid(centres, centres))).astype(np.float32)


def square_to_sphere(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Unit vectors (..., 3) of points (x, y) in [0, 1]² (Clarberg 2008): +z in the middle, -z in the four corners."""
    u, v = 2.0 * x - 1.0, 2.0 * y - 1.0
    inside = 1.0 - (np.abs(u) + np.abs(v))  # signed distance from the diagonals
    r = 1.0 - np.abs(inside)
    turn = np.divide(np.abs(v) - np.abs(u), r, out=np.zeros_like(r), where=r > 0.0)
    phi = np.pi / 4.0 * (turn + 1.0)
    across = r * np.sqrt(2.0 - r * r)
    return np.stack(
        [np.copysign(np.cos(phi), u) * across, np.copysign(np.sin(phi), v) * across, np.copysign(1.0 - r * r, inside)],
        axis=-1,
    )


def _height(sky: Sky) -> int:
    """Rows of a map that loses little: twice the texture's, so that the pole's rows of either are not the coarser."""
    assert sky.texture is not None
    height, width = sky.texture.shape[:2]
    return int(np.clip(2 * max(height, width // 2), 64, 2048))
