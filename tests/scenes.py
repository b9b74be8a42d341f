"""Small scenes, once: the library's at a size that a test can afford, a cube, and the scene file of a whole run."""

from typing import Any

import attrs
import numpy as np

from termwise.scenes.load import load
from termwise.scenes.model import (
    LIGHTS,
    DirectionalLight,
    Light,
    Material,
    Mesh,
    Object,
    Scene,
    SphereLight,
    SpotLight,
    SunLight,
)

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


def of_glass(scene: Scene) -> Scene:
    """The scene with its bodies, all that is no plate, of glass so rough that any direction may be right."""
    glass = Material((0.0, 0.0, 0.0), gloss=1.0, roughness=1.0, transparency=1.0)
    things = (attrs.evolve(t, material=glass) if len(t.mesh.faces) > 2 else t for t in scene.objects)
    return attrs.evolve(scene, objects=tuple(things))


def of_every_kind(*lights: Light) -> tuple[Light, ...]:
    """The lights, and one of each other kind that sends nothing to the upper side of z = 0, nor hides anything there.

    Kernels are compiled for the kinds that a scene has: so those of all tests are the same, and the library's.
    """
    white = (1.0, 1.0, 1.0)
    below = (
        SpotLight((0.0, 0.0, -5.0), (0.0, 0.0, -6.0), white),
        DirectionalLight((0.0, 0.0, 1.0), white),
        SunLight((0.0, 0.0, 1.0), white),
        SphereLight((0.0, 0.0, -0.3), 0.1, white),
    )
    there = {light.kind for light in lights}
    assert {light.kind for light in below} == {*LIGHTS} - {"point"}
    return (*lights, *(light for light in below if light.kind not in there))


def box(name: str, low: tuple[float, float, float], side: float = 1.0) -> Object:
    """An axis-aligned cube whose normals point outwards."""
    corners = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)]) * side + np.array(low)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = np.array([face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))], np.int32)
    return Object(name, Mesh(corners, faces), Material((0.5, 0.5, 0.5)))
