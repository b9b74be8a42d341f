"""The rivals in tracing rays: our three descents, the paper's loop over all faces, Mitsuba's Embree.

Each is one function `trace(corners, origins, directions, leaving) -> Found`, so that a property is written once for
all. Ours are the descent of the binary tree, that of the tree of 8 children, and waves of rays, in packets or bundles,
or among few polygons without a tree; renderers call the last two. Mitsuba's gets the same numbers rounded to float32,
at their own scale: its references bring a scene to a canonical scale first, and the lab shows why.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from termwise.renderer.geometry import bvh, paper, rays, traverse
from termwise.renderer.geometry.bvh import STACK_SIZE, Tree
from termwise.renderer.geometry.intersect import FaceRange, make_ray
from termwise.renderer.geometry.wave import SIZE, Wave, new_wave
from termwise.renderer.jit import kernel
from termwise.renderer.vector import put_column, vec3
from termwise.reports.bench.rays import embree_scene


class Found(NamedTuple):
    """What N rays meet.

    Attributes
    ----------
    t : (N,) float64, in lengths of direction; inf without a hit.
    face : (N,) int32, -1 without a hit.
    weights : (N, 2) float64, barycentric, of corners 1 and 2.
    any : (N,) bool, what the query for any hit says.
    """

    t: np.ndarray
    face: np.ndarray
    weights: np.ndarray
    any: np.ndarray


Trace = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], Found]


@kernel
def _binary(
    corners: np.ndarray, tree: Tree, origins: np.ndarray, directions: np.ndarray, leaving: np.ndarray, found: Found
) -> None:
    stack = np.empty(STACK_SIZE, np.int32)
    for i in range(len(origins)):
        ray = make_ray(vec3(origins, i), vec3(directions, i))
        ignore = FaceRange(leaving[i], leaving[i] + 1)
        hit = traverse.closest_hit(corners, tree, ray, math.inf, ignore, stack)
        found.t[i], found.face[i] = hit.t, hit.face
        found.weights[i, 0], found.weights[i, 1] = hit.b1, hit.b2
        found.any[i] = traverse.any_hit(corners, tree, ray, math.inf, ignore, -1, stack)


@kernel
def _bvh8(
    corners: np.ndarray, tree: Tree, origins: np.ndarray, directions: np.ndarray, leaving: np.ndarray, found: Found
) -> None:
    stack = np.empty(STACK_SIZE, np.int32)
    for i in range(len(origins)):
        ray = make_ray(vec3(origins, i), vec3(directions, i))
        ignore = FaceRange(leaving[i], leaving[i] + 1)
        hit = rays.closest_hit(corners, tree, ray, math.inf, ignore, stack)
        found.t[i], found.face[i] = hit.t, hit.face
        found.weights[i, 0], found.weights[i, 1] = hit.b1, hit.b2
        found.any[i] = rays.any_hit(corners, tree, ray, math.inf, ignore, -1, stack)


@kernel
def _waves(
    corners: np.ndarray,
    tree: Tree,
    origins: np.ndarray,
    directions: np.ndarray,
    leaving: np.ndarray,
    found: Found,
    wave: Wave,
) -> None:
    stack = np.empty(STACK_SIZE, np.int32)
    for start in range(0, len(origins), SIZE):
        count = min(SIZE, len(origins) - start)
        for i in range(count):
            put_column(wave.origins, i, vec3(origins, start + i))
            put_column(wave.directions, i, vec3(directions, start + i))
            wave.first[i] = leaving[start + i]
            wave.end[i] = leaving[start + i] + 1
        rays.closest_hits_of_wave(corners, tree, wave, count, math.inf, True, stack)
        for i in range(count):
            found.t[start + i], found.face[start + i] = wave.t[i], wave.face[i]
            found.weights[start + i, 0], found.weights[start + i, 1] = wave.b1[i], wave.b2[i]
        rays.any_hits_of_wave(corners, tree, wave, count, math.inf, True, stack)
        for i in range(count):
            found.any[start + i] = wave.found[i]


@kernel
def _paper(corners: np.ndarray, origins: np.ndarray, directions: np.ndarray, leaving: np.ndarray, found: Found) -> None:
    for i in range(len(origins)):
        ray = make_ray(vec3(origins, i), vec3(directions, i))
        ignore = FaceRange(leaving[i], leaving[i] + 1)
        hit = paper.closest_hit(corners, ray, math.inf, ignore)
        found.t[i], found.face[i] = hit.t, hit.face
        found.weights[i, 0], found.weights[i, 1] = hit.b1, hit.b2
        found.any[i] = paper.any_hit(corners, ray, math.inf, ignore, -1)


def _room(count: int) -> Found:
    return Found(np.full(count, np.inf), np.full(count, -1, np.int32), np.zeros((count, 2)), np.zeros(count, np.bool_))


_TREES: dict[bytes, Tree] = {}


def _tree(corners: np.ndarray) -> Tree:
    """The tree of triangles; the last one is kept, for several tracers take turns on it."""
    key = corners.tobytes()
    if key not in _TREES:
        _TREES.clear()
        _TREES[key] = bvh.build(corners)
    return _TREES[key]


def binary(corners: np.ndarray, origins: np.ndarray, directions: np.ndarray, leaving: np.ndarray) -> Found:
    """Descend the binary tree; arrays are (F, 3, 3), (N, 3), (N, 3) float64, `leaving` (N,) int32, -1: no face."""
    found = _room(len(origins))
    _binary(corners, _tree(corners), origins, directions, leaving, found)
    return found


def bvh8(corners: np.ndarray, origins: np.ndarray, directions: np.ndarray, leaving: np.ndarray) -> Found:
    """Descend the tree of 8 children, where the processor has its vectors; arguments as of `binary`."""
    found = _room(len(origins))
    _bvh8(corners, _tree(corners), origins, directions, leaving, found)
    return found


def waves(corners: np.ndarray, origins: np.ndarray, directions: np.ndarray, leaving: np.ndarray) -> Found:
    """Trace in waves; arguments as of `binary`."""
    found = _room(len(origins))
    _waves(corners, _tree(corners), origins, directions, leaving, found, new_wave())
    return found


def run_waves(corners: np.ndarray, tree: Tree, origins: np.ndarray, directions: np.ndarray) -> None:
    """Trace rays on a tree that exists, and throw the hits away: what is timed."""
    free = np.full(len(origins), -1, np.int32)
    _waves(corners, tree, origins, directions, free, _room(len(origins)), new_wave())


def all_faces(corners: np.ndarray, origins: np.ndarray, directions: np.ndarray, leaving: np.ndarray) -> Found:
    """The paper's intersection; arguments as of `binary`."""
    found = _room(len(origins))
    _paper(corners, origins, directions, leaving, found)
    return found


def embree(corners: np.ndarray, origins: np.ndarray, directions: np.ndarray, leaving: np.ndarray) -> Found:
    """Mitsuba's, with its robust flag, in float32. A ray that leaves a face begins at Mitsuba's own offset from it."""
    from termwise.reference.backend import import_mitsuba

    mi: Any = import_mitsuba()
    import drjit as dr  # after Mitsuba has chosen its LLVM

    scene = embree_scene(mi, corners, robust=True) if len(corners) else mi.load_dict({"type": "scene"})
    with np.errstate(over="ignore", under="ignore"):
        origin = mi.Point3f(origins.astype(np.float32).T.copy())
        direction = mi.Vector3f(directions.astype(np.float32).T.copy())
    if (leaving >= 0).any():
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[leaving]
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        si = dr.zeros(mi.SurfaceInteraction3f, len(origins))
        si.p = origin
        si.n = mi.Normal3f(normals.astype(np.float32).T.copy())
        ray = si.spawn_ray(direction)
    else:
        ray = mi.Ray3f(origin, direction, 0.0, [])
    hit = scene.ray_intersect_preliminary(ray, False, True)
    valid = np.array(hit.is_valid())
    found = _room(len(origins))
    found.t[valid] = np.array(hit.t, np.float64)[valid]
    found.face[valid] = np.array(hit.prim_index)[valid]
    found.weights[:] = np.array(hit.prim_uv, np.float64).T
    found.any[:] = np.array(scene.ray_test(ray, False, True))
    return found


OURS: dict[str, Trace] = {"binary tree": binary, "tree of 8 children": bvh8, "waves": waves}
