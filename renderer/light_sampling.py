"""Samples of the lights for a wave of points: where all lights are few emitting faces, eight at a time.

The bits are those of `lights.sample_light`, whose expressions the lanes repeat: `E / pi = L A cos cos' / (pi p d²)` of
the point that (u, v) places on the face that u picks.
"""

import numpy as np

from termwise.renderer.arrays import SceneArrays
from termwise.renderer.geometry import simd
from termwise.renderer.geometry.simd import choose, in_lanes, load, minimum, put_rows, rows, splat, store
from termwise.renderer.jit import device
from termwise.renderer.lights import BELOW_ONE, FACE, sample_light
from termwise.renderer.material import emission
from termwise.renderer.scratch import LightSamples
from termwise.renderer.surface import Surface
from termwise.renderer.textures import Textures
from termwise.renderer.vector import column, entry, put_column, scale, vec3
from termwise.renderer.warp import INV_PI

_VECTORS = simd.available()
# Faces among which eight lanes look for theirs one after the other.
_FEW = 8


@device
def sample_lights(scene: SceneArrays, samples: LightSamples, count: int) -> None:
    """Sample a light for each of the first `count` points."""
    if _VECTORS and not scene.pick_by_light and _faces_alone(scene):
        for k in range(0, count, 8):
            _sample_faces(scene, samples, k)
        _by_images(scene, scene.materials.textures, samples, count)
        return
    for i in range(count):
        point, normal = column(samples.point, i), column(samples.normal, i)
        # What arrives depends on the place and the normal alone.
        surface = Surface(point, normal, normal, -1, -1, 1.0, 0.0, 0.0)
        irradiance, way, target = sample_light(scene, surface, samples.u[i], samples.v[i])
        put_column(samples.irradiance, i, irradiance)
        put_column(samples.way, i, way)
        samples.target[i] = target


@device
def _faces_alone(scene: SceneArrays) -> bool:
    count = len(scene.emitters.kind)
    # Emitters are numbered kind by kind.
    return 0 < count <= _FEW and scene.emitters.kind[0] == FACE and scene.emitters.kind[count - 1] == FACE


@device
def _by_images(scene: SceneArrays, images: Textures | None, samples: LightSamples, count: int) -> None:
    """Put what the points of lights send where images say it."""
    if images is not None:
        for i in range(count):
            if samples.weight[i] > 0.0:
                radiant = emission(scene, entry(samples.target, i), samples.b1[i], samples.b2[i])
                put_column(samples.irradiance, i, scale(radiant, samples.weight[i]))


@device
def _sample_faces(scene: SceneArrays, samples: LightSamples, k: int) -> None:
    """Samples k ... k + 7, with the radiance that objects send throughout."""
    geometry, emitters = scene.geometry, scene.emitters
    corners, faces = geometry.corners, emitters.faces
    u, v = load(samples.u, k, 8), load(samples.v, k, 8)
    zero, one = splat(0.0, 8), splat(1.0, 8)
    picked, before = splat(np.int32(0), 8), zero
    count = len(emitters.kind)
    if count > 1:
        for index in range(1, count):
            behind = u >= splat(emitters.cdf[index], 8)
            picked = choose(behind, splat(np.int32(index), 8), picked)
            before = choose(behind, splat(emitters.cdf[index], 8), before)
    # Of few faces each in turn is put where it was picked: faster than to gather what each lane has picked.
    a = b = c = n = radiant = zero, zero, zero
    strength, stretch, face = zero, zero, splat(np.int32(0), 8)
    for index in range(count):
        mine = picked == splat(np.int32(index), 8)
        row = entry(emitters.row, index)
        lamp = entry(faces.face, row)
        a = in_lanes(mine, vec3(corners[lamp], 0), a)
        b = in_lanes(mine, vec3(corners[lamp], 1), b)
        c = in_lanes(mine, vec3(corners[lamp], 2), c)
        n = in_lanes(mine, vec3(geometry.normals, lamp), n)
        radiant = in_lanes(mine, vec3(scene.materials.emission, entry(geometry.object, lamp)), radiant)
        probability = emitters.cdf[index + 1] - emitters.cdf[index]
        strength = choose(mine, splat(INV_PI * faces.area[row] / probability, 8), strength)
        stretch = choose(mine, splat(1.0 / probability, 8), stretch)
        face = choose(mine, splat(np.int32(lamp), 8), face)
    if count > 1:
        u = minimum((u - before) * stretch, splat(BELOW_ONE, 8))
    half = splat(0.5, 8)
    up = v > u
    # As `square_to_triangle`.
    b1 = choose(up, u * half, u - v * half)
    b2 = choose(up, v - u * half, v * half)
    b0 = one - b1 - b2
    p, normal = rows(samples.point, k), rows(samples.normal, k)
    x = b0 * a[0] + b1 * b[0] + b2 * c[0] - p[0]
    y = b0 * a[1] + b1 * b[1] + b2 * c[1] - p[1]
    z = b0 * a[2] + b1 * b[2] + b2 * c[2] - p[2]
    cos_light = simd.negative(n[0] * x + n[1] * y + n[2] * z)
    cos_surface = normal[0] * x + normal[1] * y + normal[2] * z
    near = one / (x * x + y * y + z * z)
    strength = strength * ((cos_light * near) * (cos_surface * near))
    lit = (cos_light > zero) & (cos_surface > zero)
    strength = choose(lit, strength, zero)
    put_rows(samples.way, k, (x, y, z))
    put_rows(samples.irradiance, k, (radiant[0] * strength, radiant[1] * strength, radiant[2] * strength))
    store(samples.weight, k, strength)
    store(samples.b1, k, b1)
    store(samples.b2, k, b2)
    store(samples.target, k, face)
