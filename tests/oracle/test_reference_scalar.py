"""`scalar_rgb`, one ray at a time or through Mitsuba's film, estimates what the vectorised backend does."""

import json
import os
import subprocess
import sys

import attrs
import numpy as np
import pytest

from termwise import reference
from termwise.reference import backend
from termwise.scenes.limits import Kernel, Limit, correct, physical
from termwise.scenes.model import Ambient, Camera, Material, Mesh, Object, PointLight, Scene, Sky
from termwise.scenes.store import ROOT

LIMITS = {
    "ambient": correct("ambient", "all"),
    "direct": correct("direct", "first-hit"),
    "point": correct("direct", "all"),
    "photons": Limit("direct", scope="all", kernel=Kernel("nearest", nearest=10, photons=500)),
    "specular": correct("specular", "first-hit"),
    "background": correct("background", "all"),
    "physical": physical("direct"),
}
COUNT = 8


def lamp_over_ground() -> Scene:
    """A glossy ground, a lamp in the picture that lights it, and sky above."""

    def rectangle(name: str, corners: list[list[float]], **fields) -> Object:
        return Object(name, Mesh.from_arrays(corners, [[0, 1, 2], [0, 2, 3]]), **fields)

    ground = [[-2.0, -2.0, 0.0], [2.0, -2.0, 0.0], [2.0, 2.0, 0.0], [-2.0, 2.0, 0.0]]
    lamp = [[-1.0, -0.5, 0.2], [-1.0, 0.5, 0.2], [-1.0, 0.5, 1.0], [-1.0, -0.5, 1.0]]
    return Scene(
        "lamp",
        Camera(position=(3.0, 0.5, 1.0), target=(0.0, 0.0, 0.3)),
        (
            rectangle("ground", ground, material=Material(gloss=0.3, f0=(0.9, 0.6, 0.3))),
            rectangle("lamp", lamp, emission=(5.0, 4.0, 3.0)),
        ),
        ambient=Ambient((1.0, 1.0, 1.0)),
        sky=Sky((0.2, 0.3, 0.4)),
        resolution=(16, 16),
    )


def means(spp: int) -> dict[str, list[list[float]]]:
    """Mean colour of each replicate of each limit, in this process's backend."""
    scene = lamp_over_ground()
    point = attrs.evolve(scene, objects=scene.objects[:1], lights=(PointLight((0.0, 0.0, 1.0), (3.0, 2.0, 1.0)),))
    return {
        name: [
            reference.replicate(point if name == "point" else scene, limit, spp=spp, seed=4, replicate=k)
            .mean(axis=(0, 1), dtype=float)
            .tolist()
            for k in range(COUNT)
        ]
        for name, limit in LIMITS.items()
    }


@pytest.mark.slow
@pytest.mark.skipif(backend.choose().variant == "scalar_rgb", reason="there is nothing to compare with")
def test_scalar_agrees_with_the_vectorised_backend():
    """Two-sample z per channel over 8 replicates each, at the level that 21 tests need."""
    done = subprocess.run(
        [sys.executable, __file__],
        env=os.environ | {"TERMWISE_BACKEND": "scalar_rgb", "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    scalar, vectorised = json.loads(done.stdout), means(64)
    for name in LIMITS:
        a, b = np.array(scalar[name]), np.array(vectorised[name])
        error = np.sqrt((a.var(axis=0, ddof=1) + b.var(axis=0, ddof=1)) / COUNT)
        assert (np.abs(a.mean(axis=0) - b.mean(axis=0)) < 6 * error).all(), name
        assert (error < 0.03 * b.mean(axis=0)).all(), name


if __name__ == "__main__":
    print(json.dumps(means(8)))
