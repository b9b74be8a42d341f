"""Radiance: light 2^k times as bright gives an image 2^k times as bright, to the bit.

From 2^-100 to 2^100, 1e-30 to 1e30: the renderer multiplies and adds light and compares it with 0 alone, and powers of
2 change no mantissa. Other work than that, a threshold or an epsilon in units of radiance, breaks the equality.
"""

from collections.abc import Iterator

import attrs
import numpy as np

from renderer import render
from reports.stress.row import Row
from scenes.analytic import closed_box, disc_over_plane, furnace, rectangle_light
from scenes.model import Scene


def _brighter(scene: Scene, factor: float) -> Scene:
    """The scene with all of its light multiplied."""

    def times(color: tuple[float, float, float]) -> tuple[float, float, float]:
        red, green, blue = (factor * each for each in color)
        return red, green, blue

    return attrs.evolve(
        scene,
        lights=tuple(attrs.evolve(each, intensity=times(each.intensity)) for each in scene.lights),
        objects=tuple(attrs.evolve(each, emission=times(each.emission)) for each in scene.objects),
        ambient=attrs.evolve(scene.ambient, color=times(scene.ambient.color)),
        sky=attrs.evolve(scene.sky, color=times(scene.sky.color)),
    )


def rows(count: int) -> Iterator[Row]:
    """All rows of the group."""
    scenes = {
        "ambient": disc_over_plane(height=0.5, radius=0.4),
        "direct": rectangle_light(width=1.0, depth=1.0, height=1.0),
        "direct, photons": closed_box(),
        "specular": furnace(roughness=0.3, mu_o=0.7),
    }
    for name, scene in scenes.items():
        for power in (-100, -40, -1, 1, 40, 100):

            def changed(name: str = name, scene: Scene = scene, power: int = power) -> float:
                term = name.partition(",")[0]
                image = render(scene, term, samples=4, threads=1).mean
                brighter = render(_brighter(scene, 2.0**power), term, samples=4, threads=1).mean
                if not image.any():
                    raise ValueError("the image is black: nothing is compared")
                return float((np.ldexp(image, power) != brighter).sum())

            yield Row(f"{name}, times 2^{power}", "numbers of the image whose bits change", 0.0, changed)
