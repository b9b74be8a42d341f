"""Renders replicates in a tree of sources that is not this one: `python worker.py CASE IMAGES`, its root the path.

CASE is a case as JSON, IMAGES the file for what comes out, (K, H, W, 3) float32. Nothing but `renderer` and `scenes`
is imported: the copy that a fault is planted in holds no more.
"""

import json
import sys
from pathlib import Path

import attrs
import numpy as np

from termwise import renderer
from termwise.renderer import Engine, find
from termwise.scenes.load import load
from termwise.scenes.model import Scene

_LOBES = {
    "glossy": {"gloss": 0.5, "roughness": 0.6, "f0": (0.04, 0.04, 0.04)},
    "metal": {"gloss": 0.7, "roughness": 0.5, "f0": (0.9, 0.9, 0.9)},
}


@attrs.frozen
class Case:
    """What is rendered to show a fault.

    Attributes
    ----------
    scene : a library scene; "glossy" or "metal" before its name: all surfaces have that lobe; "turned": the first
        object's faces look the other way.
    term, variant, samples : the estimator, and its samples a pixel in each replicate.
    side : pixels of an edge of the image.
    """

    scene: str
    term: str
    variant: str
    samples: int
    side: int = 32

    def build(self) -> Scene:
        """The scene at the case's resolution."""
        change, _, name = self.scene.rpartition(" ")
        scene = load(name)
        things = scene.objects
        if change in _LOBES:
            things = tuple(
                attrs.evolve(thing, material=attrs.evolve(thing.material, **_LOBES[change])) for thing in things
            )
        elif change == "turned":
            mesh = attrs.evolve(things[0].mesh, faces=np.ascontiguousarray(things[0].mesh.faces[:, ::-1]))
            things = (attrs.evolve(things[0], mesh=mesh), *things[1:])
        return attrs.evolve(
            scene,
            resolution=(self.side, self.side),
            objects=things,
            max_bounces=2,
            photons=attrs.evolve(scene.photons, count=8000, radius=0.6),
        )


def replicates(case: Case, count: int, seed: int) -> np.ndarray:
    """(count, H, W, 3) float32."""
    images = []
    with Engine(case.build(), threads=1) as engine:
        for k in range(count):
            *_, (_, image, _) = engine.prefixes(
                find(case.term, case.variant), samples=case.samples, seed=seed, replicate=k
            )
            images.append(image)
    return np.array(images, np.float32)


if __name__ == "__main__":
    # The environment also knows an installed renderer, in which no fault is planted.
    if not Path(renderer.__file__).is_relative_to(Path.cwd()):
        sys.exit(f"{renderer.__file__}: not of the tree {Path.cwd()}")
    settings = json.loads(sys.argv[1])
    np.save(sys.argv[2], replicates(Case(**settings["case"]), settings["count"], settings["seed"]))
