"""Small scenes, once: the library's at a size that a test can afford, a cube, and the scene file of a whole run."""

from typing import Any

import attrs
import numpy as np

from termwise.scenes.load import load
from termwise.scenes.model import Material, Mesh, Object, Scene

FLOOR = """
resolution = [12, 9]

[camera]
position = [0, -1, 3]
target = [0, 0, 0]

[ambient]
color = [0.5, 0.4, 0.3]
range = 1.0

[[objects]]
shape = "rectangle"
name = "floor"
origin = [-3, -3, 0]
edges = [[6, 0, 0], [0, 6, 0]]

[[lights]]
position = [0, 0, 2]
intensity = [3, 3, 3]
"""
"""Ambient and direct light on a floor, half of it out of the picture."""


def small(name: str, width: int = 16, height: int | None = None, **changes: Any) -> Scene:
    """A scene of the library, so many pixels wide and high (a square without a height)."""
    return attrs.evolve(load(name), resolution=(width, height or width), **changes)


def box(name: str, low: tuple[float, float, float], side: float = 1.0) -> Object:
    """An axis-aligned cube whose normals point outwards."""
    corners = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)]) * side + np.array(low)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = np.array([face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))], np.int32)
    return Object(name, Mesh(corners, faces), Material((0.5, 0.5, 0.5)))
