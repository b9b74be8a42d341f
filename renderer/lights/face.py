"""Emitting triangle of radiance L and area A: `E = L cos(theta) cos(theta') A / d²` of a uniform point, power `pi A L`.

The front side alone, that of the face's normal, shines. Where L is an image it is looked up at the point. Light samples
choose among many faces by the mean radiance of each; photons leave all faces of an object alike, and carry what leaves
there: an estimate by the k nearest asks where they start.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from termwise.renderer.by_reference import by_reference
from termwise.renderer.jit import device
from termwise.renderer.material import emission
from termwise.renderer.triangles import point_on_face
from termwise.renderer.vector import Vec3, add, dot, entry, frame, scale, sub, to_world, vec3
from termwise.renderer.warp import INV_PI, square_to_cosine_hemisphere, square_to_triangle
from termwise.scenes.model import Object, Scene

if TYPE_CHECKING:  # they hold what is defined here
    from termwise.renderer.arrays import SceneArrays
    from termwise.renderer.surface import Surface

SOURCE = Object
DRAWS = True


@by_reference()
class Faces(NamedTuple):
    """The emitting faces of a scene.

    Attributes
    ----------
    face : (E,) int32, face indices.
    area : (E,), area of each.
    radiance : (E,), mean channel, and mean of an image over the object.
    strength : (E,), area times mean channel, and mean of an image over the face.
    """

    face: np.ndarray
    area: np.ndarray
    radiance: np.ndarray
    strength: np.ndarray


def from_scene(scene: Scene, lit: bool) -> Faces:
    """Those of objects that emit, where they have an area; none where a scene is not lit."""
    lamps = [index for index, thing in enumerate(scene.objects) if lit and thing.emits]
    meshes = [thing.mesh for thing in scene.objects]
    first = np.cumsum([0, *(len(mesh.faces) for mesh in meshes)])
    faces = np.concatenate([np.zeros(0, np.int64), *(np.arange(first[i], first[i + 1]) for i in lamps)])
    edges = np.concatenate([np.zeros((0, 3, 3)), *(meshes[i].vertices[meshes[i].faces] for i in lamps)])
    of_faces = np.concatenate([np.zeros((0, 3)), *(scene.objects[i].radiances() for i in lamps)]).mean(axis=1)
    of_lamps = np.reshape([scene.objects[i].mean_radiance() for i in lamps], (-1, 3)).mean(axis=1)
    radiance = np.repeat(of_lamps, [len(meshes[i].faces) for i in lamps])
    area = 0.5 * np.linalg.norm(np.cross(edges[:, 1] - edges[:, 0], edges[:, 2] - edges[:, 0]), axis=1)
    some = area > 0
    return Faces(faces[some].astype(np.int32), area[some], radiance[some], area[some] * of_faces[some])


def power(faces: Faces, aimed: bool) -> np.ndarray:
    """Power of each (E,), mean channel, aimed or not."""
    return math.pi * faces.area * faces.radiance


def density(scene: SceneArrays, row: int, surface: Surface, direction: Vec3, face: int) -> float | None:
    """Of a sample, per solid angle; 0 where the face shows its back."""
    square = dot(direction, direction)
    cosine = -dot(vec3(scene.geometry.normals, face), direction) / math.sqrt(square)
    return square / (scene.emitters.faces.area[row] * cosine) if cosine > 0.0 else 0.0


@device
def bound(scene: SceneArrays, row: int, surface: Surface) -> float:
    """About what a face sends to a surface were it not hidden; 0 only where no point of it can.

    As if all of it stood at its centre, a little farther away, and as if the cosine at the surface were a tenth at
    least.
    """
    faces = scene.emitters.faces
    face = entry(faces.face, row)
    a = sub(point_on_face(scene.geometry, face, 0.0, 0.0), surface.point)
    b = sub(point_on_face(scene.geometry, face, 1.0, 0.0), surface.point)
    c = sub(point_on_face(scene.geometry, face, 0.0, 1.0), surface.point)
    before = -dot(vec3(scene.geometry.normals, face), a)
    above = max(dot(surface.normal, a), dot(surface.normal, b), dot(surface.normal, c))
    if before <= 0.0 or above <= 0.0:
        return 0.0
    centre = scale(add(add(a, b), c), 1.0 / 3.0)
    square = dot(centre, centre) + faces.area[row]
    distance = math.sqrt(square)
    cosine = max(dot(surface.normal, centre) / distance, 0.1)
    return faces.strength[row] * cosine * before / (square * distance)


@device
def sample(
    scene: SceneArrays, row: int, probability: float, surface: Surface, u: float, v: float
) -> tuple[Vec3, Vec3, int]:
    """E / pi at a surface over the probability of the pick, the way to a uniform point, and its face."""
    faces = scene.emitters.faces
    face = entry(faces.face, row)
    b1, b2 = square_to_triangle(u, v)
    direction = sub(point_on_face(scene.geometry, face, b1, b2), surface.point)
    # `direction` is not normalised: each cosine carries one factor of the distance.
    cos_light = -dot(vec3(scene.geometry.normals, face), direction)
    cos_surface = dot(surface.normal, direction)
    if cos_light <= 0.0 or cos_surface <= 0.0:
        return Vec3(0.0, 0.0, 0.0), direction, face
    near = 1.0 / dot(direction, direction)
    strength = INV_PI * faces.area[row] / probability * ((cos_light * near) * (cos_surface * near))
    return scale(emission(scene, face, b1, b2), strength), direction, face


@device
def emit(
    scene: SceneArrays, row: int, probability: float, aimed: bool, place: tuple[float, float], way: tuple[float, float]
) -> tuple[Vec3, Vec3, Vec3, int]:
    """Origin, direction, power over the probability of the pick, and face of a photon."""
    faces = scene.emitters.faces
    face = entry(faces.face, row)
    b1, b2 = square_to_triangle(place[0], place[1])
    origin = point_on_face(scene.geometry, face, b1, b2)
    local = square_to_cosine_hemisphere(way[0], way[1])
    direction = to_world(frame(vec3(scene.geometry.normals, face)), local)
    radiance = emission(scene, face, b1, b2)
    return origin, direction, scale(radiance, math.pi * faces.area[row] / probability), face
