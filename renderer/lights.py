"""Light sampling: irradiance `E / pi` at a point from one emitter, picked in proportion to its power.

Point light of intensity I: `E = I cos(theta) / d²`. Face of radiance L and area A, uniform point on it:
`E = L cos(theta) cos(theta') A / d²`, the front side of the face only. Divided by the probability of the pick.
Unbiased at any count: what may light the point has a probability above 0.

One number picks the emitter, and what is left of it, stretched to [0, 1), places the point: the points on each face are
then as evenly spread as those of the square. With a number of its own for the pick, a face gets a random half of them:
in the Cornell box, whose lamp is two triangles, 64 samples had 4 times the variance of direct light.
"""

import math

import numpy as np

from termwise.renderer.arrays import SceneArrays
from termwise.renderer.jit import device
from termwise.renderer.material import emission
from termwise.renderer.scratch import Scratch
from termwise.renderer.sobol import Sampler, sample_2d
from termwise.renderer.surface import Surface, occluded
from termwise.renderer.triangles import point_on_face
from termwise.renderer.vector import Vec3, add, dot, entry, is_black, length, scale, sub, vec3
from termwise.renderer.warp import INV_PI, square_to_triangle

_BELOW_ONE = 1.0 - 2.0**-53


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
    return low, probability, min((u - before) / probability, _BELOW_ONE)


@device
def _bound(scene: SceneArrays, surface: Surface, index: int) -> float:
    """About what an emitter sends to a surface were it not hidden; 0 only where no point of it can.

    A face counts as if all of it stood at its centre, a little farther away, and as if the cosine at the surface were a
    tenth at least.
    """
    emitters = scene.emitters
    points = len(emitters.point)
    if index < points:
        offset = sub(vec3(emitters.point, index), surface.point)
        cosine = dot(surface.normal, offset)
        if cosine <= 0.0:
            return 0.0
        square = dot(offset, offset)
        return emitters.strength[index] * cosine / (square * math.sqrt(square))
    face = entry(emitters.face, index - points)
    a = sub(point_on_face(scene.geometry, face, 0.0, 0.0), surface.point)
    b = sub(point_on_face(scene.geometry, face, 1.0, 0.0), surface.point)
    c = sub(point_on_face(scene.geometry, face, 0.0, 1.0), surface.point)
    before = -dot(vec3(scene.geometry.normals, face), a)
    above = max(dot(surface.normal, a), dot(surface.normal, b), dot(surface.normal, c))
    if before <= 0.0 or above <= 0.0:
        return 0.0
    centre = scale(add(add(a, b), c), 1.0 / 3.0)
    square = dot(centre, centre) + emitters.area[index - points]
    distance = math.sqrt(square)
    cosine = max(dot(surface.normal, centre) / distance, 0.1)
    return emitters.strength[index] * cosine * before / (square * distance)


@device
def _pick_by_light(scene: SceneArrays, surface: Surface, u: float) -> tuple[int, float, float]:
    """What `pick` gives, by `_bound`; probability 0 where none lights the point."""
    count = len(scene.emitters.strength)
    total = 0.0
    for index in range(count):
        total += _bound(scene, surface, index)
    if not total > 0.0:
        return 0, 0.0, 0.0
    left = u * total
    last, its, rest = 0, 0.0, 0.0
    for index in range(count):
        bound = _bound(scene, surface, index)
        if bound > 0.0:
            last, its, rest = index, bound, left
            if left < bound:
                break
            left -= bound
    return last, its / total, min(rest / its, _BELOW_ONE)


@device
def sample_light(scene: SceneArrays, surface: Surface, u: float, v: float) -> tuple[Vec3, Vec3, int]:
    """E / pi at a surface by the sample (u, v), were it not hidden; the way to the light, and its face (-1: a point).

    Black where no light can come from, without a ray.
    """
    black = Vec3(0.0, 0.0, 0.0)
    emitters = scene.emitters
    if len(emitters.strength) == 0:
        return black, black, -1
    index = 0
    probability = 1.0
    if scene.pick_by_light:
        index, probability, u = _pick_by_light(scene, surface, u)
        if probability == 0.0:
            return black, black, -1
    elif len(emitters.strength) > 1:
        index, probability, u = pick(emitters.cdf, u)
    points = len(emitters.point)
    target = -1
    if index < points:
        direction = sub(vec3(emitters.point, index), surface.point)
        radiant = vec3(emitters.intensity, index)
        strength = INV_PI / probability
    else:
        target = entry(emitters.face, index - points)
        b1, b2 = square_to_triangle(u, v)
        direction = sub(point_on_face(scene.geometry, target, b1, b2), surface.point)
        cos_light = -dot(vec3(scene.geometry.normals, target), direction)
        if cos_light <= 0.0:
            return black, direction, target
        radiant = emission(scene, target, b1, b2)
        strength = INV_PI * emitters.area[index - points] * cos_light / (length(direction) * probability)
    # `direction` is not normalised: each cosine carries one factor of the distance.
    cos_surface = dot(surface.normal, direction)
    if cos_surface <= 0.0:
        return black, direction, target
    square = dot(direction, direction)
    strength *= cos_surface / (square * math.sqrt(square))
    return scale(radiant, strength), direction, target


@device
def light_irradiance(
    scene: SceneArrays, surface: Surface, sampler: Sampler, dimension: int, scratch: Scratch
) -> Vec3:
    """E / pi at a surface, one sample; uses the pair `dimension`."""
    u, v = sample_2d(sampler, dimension)
    irradiance, direction, target = sample_light(scene, surface, u, v)
    if scene.skips.horizon and is_black(irradiance):
        return irradiance
    if occluded(scene, surface, direction, 1.0, target, scratch):
        return Vec3(0.0, 0.0, 0.0)
    return irradiance
