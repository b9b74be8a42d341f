"""`read(path)`: the triangles of a PLY, OBJ, STL or GLB file, all of them or none; `read_mapped`: with their uv.

The readers are our own, a file a format, because geometry must not be wrong silently. trimesh 5.2 reads all four, but
takes a relative index of OBJ for one from the end of the file, and index 0 for the last vertex; fans concave polygons;
drops a solid of STL that lacks its end; and does not know GLB's normalized integers, strips, fans and required
extensions. Materials, colours, normals and images of a file are not read: a scene file says them.

In uv, (0, 0) is the lower left corner of an image and v goes up, as OBJ has it and programs write it into PLY; glTF's
v goes down, and is turned.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from termwise.scenes.meshes import glb, obj, ply, stl
from termwise.scenes.meshes.polygons import MeshError

__all__ = ["READERS", "MeshError", "read", "read_mapped"]

READERS: dict[str, Callable[[Path], tuple[np.ndarray, np.ndarray]]] = {
    ".ply": ply.read,
    ".obj": obj.read,
    ".stl": stl.read,
    ".glb": glb.read,
}
"""What reads a file, by the end of its name in lower case."""

_MAPPED: dict[str, Callable[[Path], tuple[np.ndarray, np.ndarray, np.ndarray | None]]] = {
    ".ply": ply.read_mapped,
    ".obj": obj.read_mapped,
    ".stl": lambda path: (*stl.read(path), None),
    ".glb": glb.read_mapped,
}


def read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) float64 and triangles (F, 3) int64 of a file, F >= 1, windings as the file has them.

    Raises
    ------
    MeshError : what is wrong, without the file's name: cut short, damaged, out of range, of a kind that is not read.
    OSError : the file cannot be read.
    """
    vertices, faces = READERS[path.suffix.lower()](path)
    _check(faces)
    return vertices, faces


def read_mapped(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """What `read` gives, and where in an image the triangles' corners lie, (F, 3, 2) float64; None where no file says.

    Raises
    ------
    MeshError, OSError : as `read`; some of the triangles have such places, and some have none.
    """
    vertices, faces, uv = _MAPPED[path.suffix.lower()](path)
    _check(faces)
    return vertices, faces, uv


def _check(faces: np.ndarray) -> None:
    if len(faces) == 0:
        raise MeshError("holds no triangles: allowed is a mesh with at least one")
