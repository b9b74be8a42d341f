"""`auto`, the direct term's default: the faster of its right variants in a scene, photons where light is trapped.

With all bounces, of the time that photons take to the same error paths take about
`n V / (GATHERED + TRACED n photons / pixels)`: n rays a path, of the variance V mean^2. It is large where paths are
long, in a closed room, or where few of them find the light, in a lantern; a pass of photons serves all pixels, and each
photon is traced as often as a path is, about. n and V are known after a few paths in each of a few pixels.

They are always the same paths, so that the choice is one of the scene, its resolution and its photons included, and of
neither seed nor threads.
"""

import functools
from typing import NamedTuple

import attrs
import numpy as np

from termwise.renderer.engine import Engine
from termwise.renderer.plan import photons_of_a_pass
from termwise.renderer.terms import AUTO, VARIANTS, Variant, named
from termwise.scenes.model import Scene
from termwise.scenes.terms import TABLE

# What photons take, in rays times relative variance: a pixel, and each ray of a photon.
GATHERED, TRACED = 0.15, 0.0133
# Pixels of a side, and paths a pixel.
_SIDE, _PATHS = 16, 8


class Pilot(NamedTuple):
    """What some paths showed: rays of each, its relative variance, and the share of pixels that see direct light.

    Rays are those that leave the points which the camera sees, and go on from there.
    """

    rays: float
    variance: float
    seen: float


class Choice(NamedTuple):
    """The variant that `auto` takes, and why; where only one of them makes sense, "" where that says all."""

    name: str
    reason: str


def chosen(scene: Scene, term: str, name: str | None = None) -> Variant:
    """The variant that a name means in a scene, the default without a name; a ValueError lists those that exist.

    What `auto` has taken says so in its `chosen`, and is the named one in all else.
    """
    name = named(term, name)
    if name != AUTO:
        return VARIANTS[term][name]
    found = choice(scene)
    return attrs.evolve(VARIANTS[term][found.name], chosen=found.reason)


@functools.lru_cache(maxsize=16)
def choice(scene: Scene) -> Choice:
    """What `auto` is in a scene: `path`, or `next-event`, which with first hits alone has no photons."""
    if scene.scope == "first-hit" or TABLE["direct"].absent(scene) is not None:
        return Choice("next-event", "")
    if scene.photons.scattering == "full":
        return Choice("next-event", "photons scatter on the full BSDF, which paths do not")
    if scene.normals == "face":
        return Choice("path", "photons have no flux that leaves a back as if it were the front")
    times = paths_over_photons(scene)
    said = f"to equal error paths take about {times:.2g} times what photons do"
    return Choice("next-event", f"light is trapped: {said}") if times >= 1.0 else Choice("path", said)


def paths_over_photons(scene: Scene) -> float:
    """Time of `path` over that of `next-event` to the same error, about."""
    found = pilot(scene)
    if not found.seen:
        return 0.0
    width, height = scene.resolution
    photons = photons_of_a_pass(scene, VARIANTS["direct"]["next-event"], "next-event")
    traced = found.rays * photons / (found.seen * width * height)
    return found.rays * found.variance / (GATHERED + TRACED * traced)


def pilot(scene: Scene) -> Pilot:
    """Follow 8 paths from the middle of each of 16 x 16 pixels: edges are noise to both variants alike."""
    camera = attrs.evolve(scene.camera, pixel="centre")
    coarse = attrs.evolve(scene, camera=camera, resolution=(_SIDE, _SIDE))
    # All camera rays are traced, so that they are known, one of each pixel and replicate.
    with Engine(coarse, threads=1, without=("window",)) as engine:
        images = np.array([
            next(engine.prefixes(VARIANTS["direct"]["path"], samples=1, seed=0, replicate=number))[1]
            for number in range(_PATHS)
        ])  # fmt: skip
        rays = engine.counts["rays"] - _PATHS * _SIDE**2
    lit = images[:, images.any(axis=(0, -1))]
    if not lit.size:
        return Pilot(0.0, 0.0, 0.0)
    # Of the brightest: squares of what a scene may send are no float64.
    lit = lit / lit.max()
    seen = lit.shape[1]
    variance = float(lit.var(axis=0, ddof=1).mean() / lit.mean() ** 2)
    return Pilot(rays / (_PATHS * seen), variance, seen / _SIDE**2)
