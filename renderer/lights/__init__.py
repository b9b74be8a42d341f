"""Light sampling: irradiance `E / pi` at a point from one emitter, picked in proportion to its power.

An emitter is an emitting face or a light of the scene's list: each kind has a file of its own, with the same words (see
KINDS). What it sends is divided by the probability of the pick. Unbiased at any count: what may light the point has a
probability above 0.

One number picks the emitter, and what is left of it, stretched to [0, 1), places the point: the points on each face are
then as evenly spread as those of the square. With a number of its own for the pick, a face gets a random half of them:
in the Cornell box, whose lamp is two triangles, 64 samples had 4 times the variance of direct light.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from termwise.renderer.by_reference import by_reference
from termwise.renderer.jit import device
from termwise.renderer.lights import directional, face, point, sphere, spot, sun
from termwise.renderer.lights.directional import Directionals
from termwise.renderer.lights.face import Faces
from termwise.renderer.lights.point import Points
from termwise.renderer.lights.sphere import SphereLights
from termwise.renderer.lights.spot import Spots
from termwise.renderer.lights.sun import Suns
from termwise.renderer.vector import Vec3, entry
from termwise.scenes.model import Scene

if TYPE_CHECKING:  # they hold what is defined here
    from termwise.renderer.arrays import SceneArrays
    from termwise.renderer.surface import Surface

BELOW_ONE = 1.0 - 2.0**-53

# A kind of light is a module. For a scene it has SOURCE, the class whose values it reads, DRAWS, whether its samples of
# one light differ, `from_scene`, its arrays, which have a row and a `strength` for each emitter, or None, and `power`;
# for a record of a sample `density`. For a kernel it has `bound`, `sample` and `emit`, each given the row: the three
# chains of `if` below, for Numba has no table of functions. Emitters are numbered kind by kind in this order.
KINDS = (point, face, spot, directional, sun, sphere)
POINT, FACE, SPOT, DIRECTIONAL, SUN, SPHERE = range(len(KINDS))


@by_reference()
class Emitters(NamedTuple):
    """All emitters of a scene.

    Attributes
    ----------
    kind, row : (N,) int32 each, index into KINDS and into the arrays of that kind.
    cdf : (N + 1,), running sum of the picking probabilities, from 0 to 1; 0 alone without lights.
    aimed : (N + 1,), the same sum, the power being that which is sent towards the scene.
    share : that power over all power.
    drawn : whether samples of the light differ: False where there is one emitter, of a kind that draws nothing.
    points, faces, spots, directionals, suns, spheres : the arrays of each kind, in the order of KINDS; None of one that
        the scene has not and that the kernels are compiled without: they pay nothing for it.
    """

    kind: np.ndarray
    row: np.ndarray
    cdf: np.ndarray
    aimed: np.ndarray
    share: float
    drawn: bool
    points: Points
    faces: Faces
    # None of a kind that the scene has not; what reads one is called where it has.
    spots: Spots
    directionals: Directionals
    suns: Suns
    spheres: SphereLights


@functools.lru_cache(maxsize=4)
def emitters_of(scene: Scene) -> Emitters:
    """The lights of a scene, without its tree; kept, because the plan asks often and a cone looks at all vertices."""
    arrays = [kind.from_scene(scene, scene.toggles.lighting) for kind in KINDS]
    counts = [0 if each is None else len(each.strength) for each in arrays]
    power, towards = (
        np.concatenate([kind.power(each, aimed) for kind, each in zip(KINDS, arrays, strict=True) if each is not None])
        for aimed in (False, True)
    )
    kinds = np.repeat(np.arange(len(KINDS), dtype=np.int32), counts)
    return Emitters(
        kinds,
        np.concatenate([np.arange(count, dtype=np.int32) for count in counts]),
        running_sum(power),
        running_sum(towards),
        float(towards.sum() / power.sum()) if len(power) else 1.0,
        len(kinds) > 1 or any(KINDS[kind].DRAWS for kind in kinds),
        *arrays,
    )


def running_sum(weights: np.ndarray) -> np.ndarray:
    """Of the probabilities that go as `weights`, from 0 to 1; 0 alone without any."""
    if not len(weights):
        return np.zeros(1)
    return np.concatenate([[0.0], np.cumsum(weights[:-1]) / weights.sum(), [1.0]])


def samples_differ(scene: Scene) -> bool:
    """Whether the light samples of a point may differ: not where one light stands in the scene that draws nothing."""
    sources = [*scene.lights, *(thing for thing in scene.objects if thing.emits)]
    draws = any(kind.DRAWS and isinstance(source, kind.SOURCE) for source in sources for kind in KINDS)
    return len(sources) != 1 or draws


# Numba leaves out a branch that asks an argument of type None whether it is None, and compiles nothing behind it.


@device
def bound(scene: SceneArrays, surface: Surface, index: int) -> float:
    """About what an emitter sends to a surface were it not hidden; 0 only where no point of it can."""
    emitters = scene.emitters
    row = entry(emitters.row, index)
    kind = emitters.kind[index]
    return _bound(scene, surface, kind, row, emitters.spots, emitters.directionals, emitters.suns, emitters.spheres)


@device
def _bound(
    scene: SceneArrays,
    surface: Surface,
    kind: int,
    row: int,
    spots: Spots | None,
    directionals: Directionals | None,
    suns: Suns | None,
    spheres: SphereLights | None,
) -> float:
    if kind == POINT:
        return point.bound(scene, row, surface)
    if spots is not None and kind == SPOT:
        return spot.bound(scene, row, surface)
    if directionals is not None and kind == DIRECTIONAL:
        return directional.bound(scene, row, surface)
    if suns is not None and kind == SUN:
        return sun.bound(scene, row, surface)
    if spheres is not None and kind == SPHERE:
        return sphere.bound(scene, row, surface)
    return face.bound(scene, row, surface)


@device
def _sample(
    scene: SceneArrays,
    index: int,
    probability: float,
    surface: Surface,
    u: float,
    v: float,
    spots: Spots | None,
    directionals: Directionals | None,
    suns: Suns | None,
    spheres: SphereLights | None,
) -> tuple[Vec3, Vec3, int]:
    kind = scene.emitters.kind[index]
    row = entry(scene.emitters.row, index)
    if kind == POINT:
        return point.sample(scene, row, probability, surface, u, v)
    if spots is not None and kind == SPOT:
        return spot.sample(scene, row, probability, surface, u, v)
    if directionals is not None and kind == DIRECTIONAL:
        return directional.sample(scene, row, probability, surface, u, v)
    if suns is not None and kind == SUN:
        return sun.sample(scene, row, probability, surface, u, v)
    if spheres is not None and kind == SPHERE:
        return sphere.sample(scene, row, probability, surface, u, v)
    return face.sample(scene, row, probability, surface, u, v)


@device
def _emit(
    scene: SceneArrays,
    index: int,
    probability: float,
    aimed: bool,
    place: tuple[float, float],
    way: tuple[float, float],
    spots: Spots | None,
    directionals: Directionals | None,
    suns: Suns | None,
    spheres: SphereLights | None,
) -> tuple[Vec3, Vec3, Vec3, int]:
    kind = scene.emitters.kind[index]
    row = entry(scene.emitters.row, index)
    if kind == POINT:
        return point.emit(scene, row, probability, aimed, place, way)
    if spots is not None and kind == SPOT:
        return spot.emit(scene, row, probability, aimed, place, way)
    if directionals is not None and kind == DIRECTIONAL:
        return directional.emit(scene, row, probability, aimed, place, way)
    if suns is not None and kind == SUN:
        return sun.emit(scene, row, probability, aimed, place, way)
    if spheres is not None and kind == SPHERE:
        return sphere.emit(scene, row, probability, aimed, place, way)
    return face.emit(scene, row, probability, aimed, place, way)


@device
def pick(cdf: np.ndarray, u: float) -> tuple[int, float, float]:
    """Index of an emitter by the running sum of the probabilities, the probability of it, and what is left of u."""
    low = 0
    high = len(cdf) - 2
    while low < high:
        middle = (low + high) // 2
        # Chosen, not branched to: half of the guesses at a branch fail, and two emitters take 7.7 ns in place of 2.4.
        behind = u >= cdf[middle + 1]
        low = middle + 1 if behind else low
        high = high if behind else middle
    before = cdf[low]
    probability = cdf[low + 1] - before
    return low, probability, min((u - before) * (1.0 / probability), BELOW_ONE)


@device
def pick_by_light(scene: SceneArrays, surface: Surface, u: float) -> tuple[int, float, float]:
    """What `pick` gives, by `bound`; probability 0 where none lights the point."""
    count = len(scene.emitters.kind)
    total = 0.0
    for index in range(count):
        total += bound(scene, surface, index)
    if not total > 0.0:
        return 0, 0.0, 0.0
    left = u * total
    last, its, rest = 0, 0.0, 0.0
    for index in range(count):
        may = bound(scene, surface, index)
        if may > 0.0:
            last, its, rest = index, may, left
            if left < may:
                break
            left -= may
    return last, its / total, min(rest / its, BELOW_ONE)


@device
def sample_light(scene: SceneArrays, surface: Surface, u: float, v: float) -> tuple[Vec3, Vec3, int]:
    """E / pi at a surface by the sample (u, v), were it not hidden; the way to the light, and its face (-1: none).

    Black where no light can come from, without a ray.
    """
    black = Vec3(0.0, 0.0, 0.0)
    emitters = scene.emitters
    if len(emitters.kind) == 0:
        return black, black, -1
    index = 0
    probability = 1.0
    if scene.pick_by_light:
        index, probability, u = pick_by_light(scene, surface, u)
        if probability == 0.0:
            return black, black, -1
    elif len(emitters.kind) > 1:
        index, probability, u = pick(emitters.cdf, u)
    further = emitters.spots, emitters.directionals, emitters.suns, emitters.spheres
    return _sample(scene, index, probability, surface, u, v, *further)


@device
def emit_photon(
    scene: SceneArrays, aimed: bool, place: tuple[float, float], way: tuple[float, float]
) -> tuple[Vec3, Vec3, Vec3, int]:
    """Origin, direction, power and face (-1: none) of a photon, one of one, by two points of the unit square."""
    emitters = scene.emitters
    index, probability, u = pick(emitters.aimed if aimed else emitters.cdf, place[0])
    further = emitters.spots, emitters.directionals, emitters.suns, emitters.spheres
    return _emit(scene, index, probability, aimed, (u, place[1]), way, *further)
