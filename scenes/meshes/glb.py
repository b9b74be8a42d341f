"""GLB, that is glTF 2.0 in one file: all triangles of its default scene, in the rest pose of its skins and morphs.

A node's `matrix`, or `translation`, `rotation` and `scale`, places its mesh below its parents; where that mirrors, the
windings are turned, as glTF says. Vertices are `M (p + sum w_j d_j)` with morph weights w, and M the node's matrix or,
with a skin, the vertex's mean of its joints'. Points and lines make no surface. glTF's y is up, and stays y.
"""

import base64
import contextlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from termwise.scenes.meshes.polygons import MeshError, strip, triangulate
from termwise.scenes.strict import FileError
from termwise.scenes.textures import downwards

# Of what a file may require, all that changes no shape; the readers of the rest would draw something else.
_SHAPELESS = ("KHR_materials_", "KHR_texture_", "KHR_lights_", "KHR_animation_", "EXT_texture_", "EXT_lights_")
_KNOWN = (*_SHAPELESS, "MSFT_texture_", "KHR_xmp", "KHR_mesh_quantization")
_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6


def read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) float64 and triangles (F, 3) int64, see `scenes.meshes.read`."""
    with described(path) as file:
        return file.triangles()


def read_mapped(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """What `read` gives, and (F, 3, 2) of TEXCOORD_0, see `scenes.meshes.read_mapped`."""
    with described(path) as file:
        primitives = [(primitive, triangles) for _, primitive, _, triangles in file.primitives()]
        found = [file.places(primitive) for primitive, _ in primitives]
        if all(places is None for places in found):
            return *file.triangles(), None
        if any(places is None for places in found):
            raise MeshError("has primitives without TEXCOORD_0 beside others that have it: allowed are all, or none")
        uv = [places[triangles] for places, (_, triangles) in zip(found, primitives, strict=True)]  # type: ignore[index]
        return *file.triangles(), np.concatenate(uv)


@contextlib.contextmanager
def described(path: Path) -> Iterator["File"]:
    """The contents of a file; what is read of it in this context, and is not glTF, is a MeshError."""
    description, chunk = _chunks(path.read_bytes())
    try:
        yield File(description, chunk, path.parent)
    except (KeyError, IndexError, TypeError, AttributeError, ValueError, RecursionError) as error:
        if isinstance(error, MeshError | FileError):
            raise
        reason = f"{error} is missing" if isinstance(error, KeyError) else " ".join(str(error).split())
        raise MeshError(f"is not valid glTF: {reason}") from None


def _chunks(data: bytes) -> tuple[Any, bytes]:
    """The JSON description and the binary chunk of a file."""
    if data[:4] != b"glTF" or len(data) < 20:
        raise MeshError("is not GLB: allowed is a file that begins with 'glTF'")
    version, length = (int.from_bytes(data[i : i + 4], "little") for i in (4, 8))
    if version != 2:
        raise MeshError(f"is glTF {version}: allowed is 2")
    if len(data) < length:
        raise MeshError(f"holds {len(data)} of {length} bytes: it is cut short")
    chunks, at = {}, 12
    while at + 8 <= length:
        size, kind = int.from_bytes(data[at : at + 4], "little"), data[at + 4 : at + 8]
        if at + 8 + size > length:
            raise MeshError(f"chunk {kind!r} holds {length - at - 8} of {size} bytes: it is cut short")
        chunks.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    try:
        return json.loads(chunks.get(b"JSON", b"")), chunks.get(b"BIN\0", b"")
    except ValueError as error:
        raise MeshError(f"its description is not JSON: {error}") from None


class File:
    """A description, whose faults are whatever Python raises where it does not hold what glTF says."""

    def __init__(self, description: Any, chunk: bytes, folder: Path) -> None:
        self.description, self.chunk, self.folder = description, chunk, folder
        for name in description.get("extensionsRequired", []):
            if not name.startswith(_KNOWN):
                raise MeshError(f"requires the extension {name}, which is not read: allowed is a file without it")
        self.nodes = description.get("nodes", [])
        self.parents = {child: i for i, node in enumerate(self.nodes) for child in node.get("children", [])}

    def triangles(self) -> tuple[np.ndarray, np.ndarray]:
        """All triangles of the scene, placed."""
        vertices, faces, count = [np.empty((0, 3))], [np.empty((0, 3), np.int64)], 0
        for _, _, points, triangles in self.primitives():
            vertices.append(points)
            faces.append(triangles + count)
            count += len(points)
        return np.concatenate(vertices), np.concatenate(faces)

    def primitives(self) -> Iterator[tuple[int, Any, np.ndarray, np.ndarray]]:
        """Number of the node, description, points (V, 3) and triangles (F, 3) of each primitive, placed."""
        for number in self.scene():
            node = self.item("nodes", number)
            if "mesh" not in node:
                continue
            mesh = self.item("meshes", node["mesh"])
            weights = node.get("weights", mesh.get("weights", []))
            for primitive in mesh["primitives"]:
                if primitive.get("mode", _TRIANGLES) < _TRIANGLES or "POSITION" not in primitive["attributes"]:
                    continue
                points = self._points(primitive, weights)
                triangles = self._faces(primitive, points)
                if "skin" in node:
                    points = self._skinned(points, primitive["attributes"], self.item("skins", node["skin"]))
                else:
                    world = self.world(number)
                    points = points @ world[:3, :3].T + world[:3, 3]
                    if np.linalg.det(world[:3, :3]) < 0:
                        triangles = triangles[:, [0, 2, 1]]
                yield number, primitive, points, triangles

    def places(self, primitive: Any, number: int = 0) -> np.ndarray | None:
        """Where in an image the points of a primitive lie (V, 2), v upwards; None where it does not say."""
        name = f"TEXCOORD_{number}"
        if name not in primitive["attributes"]:
            return None
        return downwards(self.accessor(primitive["attributes"][name]))

    def item(self, kind: str, number: int) -> Any:
        """What has a number in one of the lists: Python would take -1 for the last, and true for 1."""
        items = self.description.get(kind, [])
        if type(number) is not int or not 0 <= number < len(items):
            there = f"0 to {len(items) - 1}" if items else "none"
            raise IndexError(f"{kind} has no {number!r}: allowed are {there}")
        return items[number]

    def scene(self) -> list[int]:
        """Nodes of the default scene, or of the first; of a file without scenes, all."""
        scenes = self.description.get("scenes", [])
        roots = range(len(self.nodes))
        if scenes:
            roots = self.item("scenes", self.description.get("scene", 0)).get("nodes", [])
        left, found = list(roots)[::-1], []
        while left:
            found.append(left.pop())
            if scenes:
                left += self.item("nodes", found[-1]).get("children", [])[::-1]
            if len(found) > len(self.nodes):
                raise MeshError("a node is its own descendant, or has two parents: allowed are trees")
        return found

    def world(self, number: int) -> np.ndarray:
        """Matrix (4, 4) from a node to the scene."""
        world = _local(self.item("nodes", number))
        for _ in self.nodes:
            if number not in self.parents:
                return world
            number = self.parents[number]
            world = _local(self.nodes[number]) @ world
        raise MeshError("a node is its own descendant: allowed are trees")

    def _points(self, primitive: Any, weights: list[float]) -> np.ndarray:
        """Positions (V, 3) float64, morphed."""
        points = self.accessor(primitive["attributes"]["POSITION"])
        for weight, target in zip(weights, primitive.get("targets", []), strict=False):
            if weight and "POSITION" in target:
                points = points + weight * self.accessor(target["POSITION"])
        return points

    def _faces(self, primitive: Any, points: np.ndarray) -> np.ndarray:
        """Triangles (F, 3) of a primitive, in the order of its mode."""
        corners = np.arange(len(points))
        if "indices" in primitive:
            corners = self.accessor(primitive["indices"])[:, 0].astype(np.int64)
        mode = primitive.get("mode", _TRIANGLES)
        if mode == _TRIANGLES:
            if len(corners) % 3:
                raise MeshError(f"triangles of {len(corners)} corners: allowed is a multiple of 3")
            faces = corners.reshape(-1, 3)
        elif mode == _STRIP:
            faces = strip(corners)
        elif mode == _FAN:
            faces = np.stack([corners[1:-1], corners[2:], np.full(max(len(corners) - 2, 0), corners[0])], axis=1)
        else:
            raise MeshError(f"primitive of mode {mode}: allowed are 0 to 6")
        return triangulate(points, faces.ravel(), np.full(len(faces), 3))

    def _skinned(self, points: np.ndarray, attributes: Any, skin: Any) -> np.ndarray:
        """Points (V, 3) moved by the mean of the joints' matrices."""
        joints = np.array([self.world(joint) for joint in skin["joints"]])
        if "inverseBindMatrices" in skin:
            stored = self.accessor(skin["inverseBindMatrices"])
            joints = joints @ stored.reshape(-1, 4, 4).swapaxes(1, 2)[: len(joints)]  # glTF stores columns
        moved, whole = np.zeros_like(points), np.zeros((len(points), 1))
        for name in (name for name in attributes if name.startswith("JOINTS_")):
            which = self.accessor(attributes[name]).astype(np.int64)
            shares = self.accessor(attributes[name.replace("JOINTS", "WEIGHTS")])
            for joint, share in zip(which.T, shares.T, strict=True):
                matrix = joints[joint]
                moved += share[:, None] * (np.einsum("vij,vj->vi", matrix[:, :3, :3], points) + matrix[:, :3, 3])
                whole += share[:, None]
        return moved / whole  # weights are rounded

    def accessor(self, number: int) -> np.ndarray:
        """Values (count, width) float64, integers scaled where they are normalized."""
        accessor = self.item("accessors", number)
        kind, count = np.dtype(_TYPES[accessor["componentType"]]), accessor["count"]
        width = _WIDTHS[accessor["type"]]
        values = np.zeros((count, width), kind)
        if "bufferView" in accessor:
            values = self._view(accessor["bufferView"], accessor.get("byteOffset", 0), kind, count, width)
        if "sparse" in accessor:
            sparse = accessor["sparse"]
            places, given = sparse["indices"], sparse["values"]
            where = np.dtype(_TYPES[places["componentType"]])
            index = self._view(places["bufferView"], places.get("byteOffset", 0), where, sparse["count"], 1)[:, 0]
            values = values.copy()
            values[index] = self._view(given["bufferView"], given.get("byteOffset", 0), kind, sparse["count"], width)
        wide = values.astype(np.float64)
        if accessor.get("normalized", False) and kind.kind in "iu":
            wide = np.maximum(wide / np.iinfo(kind).max, -1.0)
        return wide

    def _view(self, number: int, offset: int, kind: np.dtype, count: int, width: int) -> np.ndarray:
        """Numbers (count, width) of a buffer view, in its stride."""
        view = self.item("bufferViews", number)
        buffer = self.buffer(view["buffer"])
        begin = view.get("byteOffset", 0)
        data = buffer[begin : begin + view["byteLength"]]
        stride = view.get("byteStride", kind.itemsize * width)
        needed = offset + (count - 1) * stride + width * kind.itemsize if count else 0
        if len(data) < needed:
            raise MeshError(f"buffer view {number} holds {len(data)} of {needed} bytes: it is cut short")
        return np.ndarray((count, width), kind, data, offset, (stride, kind.itemsize))

    def buffer(self, number: int) -> bytes:
        """All bytes of a buffer, from the file or beside it."""
        buffer = self.item("buffers", number)
        uri = buffer.get("uri")
        if uri is None and number == 0:
            data = self.chunk
        elif uri is None:
            raise MeshError(f"buffer {number} is nowhere: allowed is a file that brings it, or names its file")
        else:
            data = self.linked(uri)
        if len(data) < buffer["byteLength"]:
            raise MeshError(f"buffer {number} holds {len(data)} of {buffer['byteLength']} bytes: it is cut short")
        return data

    def linked(self, uri: str) -> bytes:
        """What an address in the file leads to: itself, or a file beside it."""
        if uri.startswith("data:"):
            return base64.b64decode(uri.partition(",")[2])
        return (self.folder / unquote(uri)).read_bytes()


def _local(node: Any) -> np.ndarray:
    """Matrix (4, 4) from a node to its parent."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T  # glTF stores columns
    x, y, z, w = np.array(node.get("rotation", (0, 0, 0, 1)), np.float64)
    turned = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    local = np.eye(4)
    local[:3, :3] = turned * np.array(node.get("scale", (1, 1, 1)), np.float64)
    local[:3, 3] = node.get("translation", (0, 0, 0))
    return local
