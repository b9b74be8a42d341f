"""One load of `scaling` in a process of its own: its peak memory is its own, and several may run side by side.

`python -m reports.bench.worker LOAD` prints what it made ready, then waits: each line on standard input is one run,
each answer the seconds by numbers of samples. At the end of the input it prints its peak memory. Lines are JSON.
"""

import json
import resource
import sys
from typing import Any

import attrs
import cattrs
import numpy as np

from termwise.renderer import Engine, find
from termwise.renderer.geometry import bvh
from termwise.reports.bench.rays import ball
from termwise.scenes.load import load
from termwise.scenes.model import Ambient, Camera, Mesh, Object, Scene


@attrs.frozen
class Load:
    """What one process renders.

    Attributes
    ----------
    scene : a name of the library, or "ball": a bumpy ball of 20 * 4^`subdivisions` triangles that fills the picture.
    term, variant : of the renderer; without a variant the default.
    resolution : pixels of a side.
    samples : samples a pixel.
    sweep : whether the prefixes of 1, 2, 4, ... samples are timed, too.
    threads : threads of the process.
    photons : photons a map; None: the scene's.
    subdivisions : of the ball.
    """

    scene: str
    term: str
    variant: str | None = None
    resolution: int = 128
    samples: int = 16
    sweep: bool = False
    threads: int = 1
    photons: int | None = None
    subdivisions: int = 5


def scene_of(load_: Load) -> Scene:
    """The scene of a load."""
    if load_.scene == "ball":
        corners = ball(load_.subdivisions)
        mesh = Mesh.from_arrays(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
        # At twice the radius the ball is 60 degrees wide, and the picture's diagonal 52.
        camera = Camera((0.0, -2.0, 0.0), (0.0, 0.0, 0.0), fov=38.0)
        scene = Scene("ball", camera, (Object("ball", mesh),), ambient=Ambient((1.0, 1.0, 1.0)))
    else:
        scene = load(load_.scene)
    photons = scene.photons if load_.photons is None else attrs.evolve(scene.photons, count=load_.photons)
    return attrs.evolve(scene, resolution=(load_.resolution, load_.resolution), photons=photons)


def peak_mb() -> float:
    """Peak resident memory of this process so far, in MB of 10^6 bytes."""
    # Kilobytes, but on macOS.
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def main() -> None:
    """Serve one load until the input ends."""
    described = cattrs.structure(json.loads(sys.argv[1]), Load)
    memory = {"memory_before_mb": peak_mb()}
    scene, variant = scene_of(described), find(described.term, described.variant)
    # A library that makes a mesh may have held more than the mesh.
    memory["memory_scene_mb"] = peak_mb()
    with Engine(scene, threads=described.threads) as engine:
        counts = None if described.sweep else (described.samples,)

        def run() -> list[tuple[int, float]]:
            steps = engine.prefixes(variant, samples=described.samples, seed=1, replicate=0, counts=counts)
            return [(count, seconds) for count, _, seconds in steps]

        run()
        faces = sum(len(thing.mesh.faces) for thing in scene.objects)
        _say(
            {
                "triangles": faces,
                "bytes_per_triangle": bvh.bytes_of(engine.arrays.geometry.tree) / faces,
                "compile_seconds": engine.compile_seconds,
            }
        )
        for _ in sys.stdin:
            _say(run())
    _say({"memory_mb": peak_mb()} | memory)


def _say(value: Any) -> None:
    print(json.dumps(value), flush=True)


if __name__ == "__main__":
    main()
