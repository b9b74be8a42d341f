"""Where the ambient light is provably unhidden, `AO = 1` without a ray: nothing can lie within the ambient range.

Other objects are out of reach if the gap between the boxes is wider than the range, or if there are none. An object
hides no light from itself on a side on which none of its vertices lies above any of its faces: the outside of a convex
mesh, both sides of a flat one. Smooth normals are out: their hemisphere dips below the face.
"""

import numpy as np

from termwise.scenes.model import Mesh, Scene

# Faces x vertices that are compared at most: larger meshes are seldom convex, and are taken to be not.
_MOST = 4_000_000
_ROUNDING = 8.0 * np.finfo(np.float64).eps


def open_sides(scene: Scene) -> np.ndarray:
    """Whether the front and the back of each object see all of the ambient light, (O, 2) bool."""
    count = len(scene.objects)
    sides = np.zeros((count, 2), np.bool_)
    reach = scene.occlusion_range
    # The paper's intersection has absolute tolerances: it may find what is not there.
    if reach == 0.0 or scene.intersection != "watertight":
        return sides
    lows, highs = scene.boxes()
    for index, thing in enumerate(scene.objects):
        apart = np.maximum(np.maximum(lows - highs[index], lows[index] - highs), 0.0)
        gaps = np.delete(np.linalg.norm(apart, axis=1), index)
        rounding = _ROUNDING * np.abs((lows, highs)).max()
        if thing.mesh.normals is None and (gaps > reach + rounding).all():
            sides[index] = True if scene.ignore == "object" else _convex(thing.mesh)
    return sides


def _convex(mesh: Mesh) -> tuple[bool, bool]:
    """Whether no vertex lies above any face, seen from the front and from the back."""
    if mesh.vertices.shape[0] * mesh.faces.shape[0] > _MOST:
        return False, False
    vertices = mesh.vertices.astype(np.float64)
    a, b, c = (vertices[mesh.faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    heights = normals @ vertices.T - np.sum(normals * a, axis=1)[:, None]
    allowed = _ROUNDING * length * np.abs(vertices).max()
    return bool((heights.max(axis=1) <= allowed).all()), bool((heights.min(axis=1) >= -allowed).all())
