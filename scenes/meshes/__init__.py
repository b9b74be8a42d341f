"""`read(path)`: the triangles of a PLY, OBJ, STL or GLB file, all of them or none.

The readers are our own, a file a format, because geometry must not be wrong silently. trimesh 5.2 reads all four, but
takes a relative index of OBJ for one from the end of the file, and index 0 for the last vertex; fans concave polygons;
drops a solid of STL that lacks its end; and does not know GLB's normalized integers, strips, fans and required
extensions. Materials, colours, normals and textures of a file are not read: a scene file says them.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from termwise.scenes.meshes import glb, obj, ply, stl
from termwise.scenes.meshes.polygons import MeshError

__all__ = ["READERS", "MeshError", "read"]

READERS: dict[str, Callable[[Path], tuple[np.ndarray, np.ndarray]]] = {
    ".ply": ply.read,
    ".obj": obj.read,
    ".stl": stl.read,
    ".glb": glb.read,
}
"""What reads a file, by the end of its name in lower case."""


def read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) float64 and triangles (F, 3) int64 of a file, F >= 1, windings as the file has them.

    Raises
    ------
    MeshError : what is wrong, without the file's name: cut short, damaged, out of range, of a kind that is not read.
    OSError : the file cannot be read.
    """
    vertices, faces = READERS[path.suffix.lower()](path)
    if len(faces) == 0:
        raise MeshError("holds no triangles: allowed is a mesh with at least one")
    return vertices, faces
