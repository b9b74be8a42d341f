"""Triangles of all objects in one list; a point on one is `x = (1 - b1 - b2) v0 + b1 v1 + b2 v2`."""

import functools
from typing import NamedTuple

import numpy as np

from termwise.renderer.by_reference import by_reference
from termwise.renderer.geometry import bvh
from termwise.renderer.geometry.bvh import Tree
from termwise.renderer.jit import device
from termwise.renderer.spheres import Spheres
from termwise.renderer.spheres import from_scene as spheres_of
from termwise.renderer.vector import Vec3, normalize, vec3
from termwise.scenes.model import Mesh, Scene


@by_reference(corners=(3, 3), normals=(3,), shading=(3, 3))
class Geometry(NamedTuple):
    """What the kernels know of the triangles.

    Attributes
    ----------
    corners : (F, 3, 3), vertex positions.
    normals : (F, 3), unit geometric normals, zero for a face without area.
    shading : (F, 3, 3), unit normals at the corners; the geometric one where shading is flat.
    smooth : (F,) bool, whether `shading` is interpolated.
    object : (F,) index of the object.
    first : (O + 1,) first face of each object, and the number of faces.
    tree : the hierarchy over the faces.
    spheres : what rays meet beside the faces, or None; each has an entry more in `normals` (0), `smooth` (False),
        `object` and `first`.
    """

    corners: np.ndarray
    normals: np.ndarray
    shading: np.ndarray
    smooth: np.ndarray
    object: np.ndarray
    first: np.ndarray
    tree: Tree
    spheres: Spheres | None


def from_scene(scene: Scene) -> Geometry:
    """The triangles of a scene and their tree, and its spheres."""
    geometry = _triangles(tuple(thing.mesh for thing in scene.objects))
    spheres = spheres_of(scene, len(geometry.corners))
    if spheres is None:
        return geometry
    count = len(spheres.radius)
    return geometry._replace(
        normals=np.concatenate([geometry.normals, np.zeros((count, 3))]),
        smooth=np.concatenate([geometry.smooth, np.zeros(count, np.bool_)]),
        object=np.concatenate([geometry.object, np.arange(count, dtype=np.int32) + np.int32(len(scene.objects))]),
        first=np.concatenate([geometry.first, geometry.first[-1] + np.arange(1, count + 1, dtype=np.int32)]),
        spheres=spheres,
    )


@functools.lru_cache(maxsize=1)
def _triangles(meshes: tuple[Mesh, ...]) -> Geometry:
    """Those of the meshes; the last ones are kept, for a scene is looked at before it is rendered, then anew relit."""
    corners, shading, smooth, owner = [], [], [], []
    for index, mesh in enumerate(meshes):
        corners.append(mesh.vertices[mesh.faces])
        is_smooth = mesh.normals is not None
        shading.append(mesh.normals[mesh.faces] if mesh.normals is not None else np.zeros_like(corners[-1]))
        smooth.append(np.full(len(mesh.faces), is_smooth))
        owner.append(np.full(len(mesh.faces), index, np.int32))
    if not corners:
        empty = np.zeros((0, 3, 3))
        none = np.zeros(0, np.int32)
        first = np.zeros(1, np.int32)
        return Geometry(empty, np.zeros((0, 3)), empty, none.astype(np.bool_), none, first, bvh.build(empty), None)
    faces = np.ascontiguousarray(np.concatenate(corners))
    area_normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    length = np.linalg.norm(area_normals, axis=1, keepdims=True)
    normals = np.divide(area_normals, length, out=np.zeros_like(area_normals), where=length > 0)
    shading_normals = np.ascontiguousarray(np.concatenate(shading))
    is_smooth = np.concatenate(smooth)
    shading_normals[~is_smooth] = normals[~is_smooth, None, :]
    return Geometry(
        corners=faces,
        normals=normals,
        shading=shading_normals,
        smooth=is_smooth,
        object=np.concatenate(owner).astype(np.int32),
        first=np.cumsum([0, *map(len, owner)]).astype(np.int32),
        tree=bvh.build(faces),
        spheres=None,
    )


@device
def shading_normal(geometry: Geometry, face: int, b1: float, b2: float) -> Vec3:
    """Unit normal at a point of a face, on the side that the face has it."""
    if not geometry.smooth[face]:
        return vec3(geometry.normals, face)
    b0 = 1.0 - b1 - b2
    n = geometry.shading
    return normalize(
        Vec3(
            b0 * n[face, 0, 0] + b1 * n[face, 1, 0] + b2 * n[face, 2, 0],
            b0 * n[face, 0, 1] + b1 * n[face, 1, 1] + b2 * n[face, 2, 1],
            b0 * n[face, 0, 2] + b1 * n[face, 1, 2] + b2 * n[face, 2, 2],
        )
    )


@device
def point_on_face(geometry: Geometry, face: int, b1: float, b2: float) -> Vec3:
    """Point with barycentric weights b1, b2 of the corners 1 and 2."""
    b0 = 1.0 - b1 - b2
    c = geometry.corners
    return Vec3(
        b0 * c[face, 0, 0] + b1 * c[face, 1, 0] + b2 * c[face, 2, 0],
        b0 * c[face, 0, 1] + b1 * c[face, 1, 1] + b2 * c[face, 2, 1],
        b0 * c[face, 0, 2] + b1 * c[face, 1, 2] + b2 * c[face, 2, 2],
    )
