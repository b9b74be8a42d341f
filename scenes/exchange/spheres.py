"""Lights that are spheres, as lamps of triangles: for formats that have no sphere.

The triangles have their corners on a sphere a little larger than the light's, so that their area is the light's: seen
from outside they send as much in all, though the outline is that of a polyhedron.
"""

from typing import Any

import numpy as np

from termwise.scenes.model import BLACK_SURFACE

SUBDIVISIONS = 4
"""Of an icosahedron: 5120 triangles."""


def meshed(described: dict[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """A scene described in which lamps stand for spheres, and a sentence for each."""
    numbers = [number for number, light in enumerate(described["lights"]) if _is(light)]
    if not numbers:
        return described, []
    others = [light for light in described["lights"] if not _is(light)]
    names = {thing["name"] for thing in described["objects"]}
    lamps = []
    for number in numbers:
        name = f"light {number}"
        while name in names:
            name += "_"
        names.add(name)
        lamps.append(_lamp(name, described["lights"][number]))
    said = [f"lights[{number}]: sphere: a lamp of {20 * 4**SUBDIVISIONS} triangles of its area" for number in numbers]
    return described | {"objects": [*described["objects"], *lamps], "lights": others}, said


def _is(light: dict[str, Any]) -> bool:
    return light["type"] == "sphere"


def _lamp(name: str, light: dict[str, Any]) -> dict[str, Any]:
    from trimesh import creation  # takes seconds to load

    ball = creation.icosphere(subdivisions=SUBDIVISIONS)
    radius = light["radius"] * np.sqrt(4.0 * np.pi / ball.area)
    material = BLACK_SURFACE
    return {
        "name": name,
        "vertices": (np.float32(light["center"] + radius * np.asarray(ball.vertices))).astype(float).tolist(),
        "faces": np.asarray(ball.faces).tolist(),
        "normals": None,
        "material": {
            "color": list(material.color),
            "gloss": material.gloss,
            "roughness": material.roughness,
            "f0": list(material.f0),
        },
        "emission": light["radiance"],
    }
