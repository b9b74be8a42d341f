"""PLY: text or binary of either byte order, elements and properties of any kind in any order.

The vertices are x, y, z of `vertex`; the polygons the list `vertex_indices` or `vertex_index` of `face`, and the strips
that of `tristrips`, which end at -1. Where in an image they lie say u, v or s, t of `vertex` (also named `texture_u`,
`texture_v`), or the list `texcoord` of `face`, two for each corner. All else is passed over, and must be whole.
"""

import re
from pathlib import Path

import attrs
import numpy as np

from termwise.scenes.meshes.polygons import MeshError, strip, triangulate
from termwise.scenes.numerals import reals, wholes

_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_TYPES |= {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"}
_TYPES |= {"int64": "i8", "uint64": "u8", "float": "f4", "double": "f8", "float32": "f4", "float64": "f8"}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_LISTS = ("vertex_indices", "vertex_index")
_PLACES = ("u", "v"), ("s", "t"), ("texture_u", "texture_v")


@attrs.frozen
class _Property:
    """A number, or where `count` is the type of its length, a list of numbers."""

    name: str
    kind: str
    count: str | None = None


@attrs.frozen
class _Element:
    name: str
    rows: int
    properties: list[_Property] = attrs.field(factory=list)

    @property
    def has_lists(self) -> bool:
        return any(each.count for each in self.properties)


Column = tuple[np.ndarray, np.ndarray]
"""Values of all rows of a property, one row behind the other, and how many each row has."""


def write(
    path: Path,
    vertices: np.ndarray,
    normals: np.ndarray | None,
    faces: np.ndarray,
    *,
    uv: np.ndarray | None = None,
    by_vertex: bool = True,
) -> None:
    """Write binary PLY, little-endian float32, vertices (V, 3) in their order and none merged; triangles (F, 3).

    `uv` (F, 3, 2) is written as u, v of vertices, of which each corner then is one of its own, or as `texcoord` of
    faces, which fewer programs read.
    """
    columns, names = [vertices], ["x", "y", "z"]
    if normals is not None:
        columns.append(normals)
        names += ["nx", "ny", "nz"]
    fields, lists = [("count", "u1"), ("indices", "<i4", 3)], ["property list uchar int vertex_indices"]
    if uv is not None and by_vertex:
        columns = [*(column[faces.ravel()] for column in columns), uv.reshape(-1, 2)]
        names += ["u", "v"]
        faces = np.arange(faces.size).reshape(-1, 3)
    elif uv is not None:
        fields += [("numbers", "u1"), ("texcoord", "<f4", 6)]
        lists.append("property list uchar float texcoord")
    polygons = np.empty(len(faces), np.dtype(fields))
    polygons["count"], polygons["indices"] = 3, faces
    if uv is not None and not by_vertex:
        polygons["numbers"], polygons["texcoord"] = 6, uv.reshape(-1, 6)
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(columns[0])}"]
    header += [f"property float {name}" for name in names]
    header += [f"element face {len(faces)}", *lists, "end_header", ""]
    content = np.ascontiguousarray(np.hstack(columns), "<f4")
    path.write_bytes("\n".join(header).encode() + content.tobytes() + polygons.tobytes())


def read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) float64 and triangles (F, 3) int64, see `scenes.meshes.read`."""
    return _triangles(_columns(path))


def read_mapped(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """What `read` gives, and (F, 3, 2), see `scenes.meshes.read_mapped`."""
    columns = _columns(path)
    vertices, faces = _triangles(columns)
    of_vertices = columns["vertex"]
    if names := next((names for names in _PLACES if {*names} <= of_vertices.keys()), None):
        places = np.stack([of_vertices[name][0].astype(np.float64) for name in names], axis=1)
        return vertices, faces, places[faces]
    numbers, lengths = columns.get("face", {}).get("texcoord", (np.empty(0), np.empty(0, np.int64)))
    if not lengths.any():
        return vertices, faces, None
    corners, counts = _indices(columns, "face")
    if (lengths != 2 * counts).any() or len(faces) != (counts - 2).sum():
        raise MeshError("has faces without texcoord beside others that have it: allowed are two for each corner")
    by_corner = triangulate(vertices[corners], np.arange(len(corners)), counts)
    return vertices, corners[by_corner], numbers.astype(np.float64).reshape(-1, 2)[by_corner]


def _columns(path: Path) -> dict[str, dict[str, Column]]:
    """Columns of each element, at least x, y and z of the vertices."""
    data = path.read_bytes()
    order, elements, start = _header(data)
    columns = (
        _binary(elements, data, start, order) if order else _ascii(elements, data[start:].decode("ascii", "replace"))
    )
    if not {"x", "y", "z"} <= columns.get("vertex", {}).keys():
        raise MeshError("has no element vertex with x, y and z")
    return columns


def _triangles(columns: dict[str, dict[str, Column]]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices, and the triangles of faces and of strips."""
    vertices = np.stack([columns["vertex"][axis][0].astype(np.float64) for axis in "xyz"], axis=1)
    faces = triangulate(vertices, *_indices(columns, "face"))
    strips, lengths = _indices(columns, "tristrips")
    if len(lengths):
        ends = np.flatnonzero(np.append(strips, -1) == -1)
        runs = [run[run != -1] for run in np.split(strips, ends)]
        pieces = np.concatenate([strip(run) for run in runs if len(run) >= 3] or [np.empty((0, 3), np.int64)])
        faces = np.concatenate([faces, triangulate(vertices, pieces.ravel(), np.full(len(pieces), 3))])
    return vertices, faces


def _header(data: bytes) -> tuple[str, list[_Element], int]:
    """Byte order ("" for text), elements, and where the header ends."""
    if not re.match(rb"ply[ \t]*[\r\n]", data):
        raise MeshError("is not PLY: allowed is a file that begins with 'ply'")
    # A file of one \r a line is followed by binary data, which may begin with \n.
    newline = rb"\r" if re.match(rb"ply[ \t]*\r[^\n]", data) else rb"\r?\n"
    end = re.search(newline + rb"end_header[ \t]*" + newline, data)
    if end is None:
        raise MeshError("has no line 'end_header': it is cut short")
    order, elements = None, []
    for line in re.split(newline, data[: end.start()])[1:]:
        words = line.decode("utf-8", "replace").split()
        match words:
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", name, "1.0"] if name in _ORDERS:
                order = _ORDERS[name]
            case ["element", name, rows] if rows.isascii() and rows.isdecimal():
                elements.append(_Element(name, int(rows)))
            case ["property", "list", count, kind, name] if elements and _TYPES.get(count, "f")[0] != "f":
                elements[-1].properties.append(_Property(name, _type(kind), _TYPES[count]))
            case ["property", kind, name] if elements:
                elements[-1].properties.append(_Property(name, _type(kind)))
            case _:
                raise MeshError(f"header: {' '.join(words)[:60]!r}: is no line of PLY 1.0")
    if order is None:
        raise MeshError(f"header: names no format: allowed are {', '.join(_ORDERS)}")
    return order, [each for each in elements if each.properties], end.end()  # the others have no data


def _type(name: str) -> str:
    if name not in _TYPES:
        raise MeshError(f"header: type {name!r}: allowed are {', '.join(_TYPES)}")
    return _TYPES[name]


def _ascii(elements: list[_Element], text: str) -> dict[str, dict[str, Column]]:
    columns: dict[str, dict[str, Column]] = {}
    tokens, at = text.split(), 0
    for element in elements:
        values: list[list[str]] = [[] for _ in element.properties]
        counts: list[list[int]] = [[] for _ in element.properties]
        if not element.has_lists:
            width = len(element.properties)
            stop = at + element.rows * width
            if stop > len(tokens):
                raise _cut(element, (len(tokens) - at) // width)
            values = [tokens[at + i : stop : width] for i in range(width)]
            counts = [[1] * element.rows] * width
            at = stop
        for row in range(element.rows if element.has_lists else 0):
            for i, each in enumerate(element.properties):
                count = 1
                if each.count:
                    count = int(_numbers(tokens[at : at + 1], each.count, element)[0]) if at < len(tokens) else 1
                    at += 1
                if count < 0 or at + count > len(tokens):
                    raise _cut(element, row)
                values[i] += tokens[at : at + count]
                counts[i].append(count)
                at += count
        columns[element.name] = {
            each.name: (_numbers(values[i], each.kind, element), np.array(counts[i], np.int64))
            for i, each in enumerate(element.properties)
        }
    if at < len(tokens):
        raise MeshError(f"holds {len(tokens) - at} more values than its header says")
    return columns


def _numbers(tokens: list[str], kind: str, element: _Element) -> np.ndarray:
    """Whole numbers where the type is one, else of float32 or float64 as it is."""
    try:
        return np.array(wholes(tokens), np.int64) if kind[0] in "iu" else np.array(reals(tokens), kind)
    except (ValueError, OverflowError) as error:
        raise MeshError(f"element {element.name}: {error}") from None


def _binary(elements: list[_Element], data: bytes, at: int, order: str) -> dict[str, dict[str, Column]]:
    columns: dict[str, dict[str, Column]] = {}
    for element in elements:
        if element.has_lists:
            columns[element.name], at = _ragged(element, data, at, order)
            continue
        # By number: two properties may have one name.
        row = np.dtype([(str(i), order + each.kind) for i, each in enumerate(element.properties)])
        if at + element.rows * row.itemsize > len(data):
            raise _cut(element, (len(data) - at) // row.itemsize)
        table = np.frombuffer(data, row, element.rows, at)
        once = np.ones(element.rows, np.int64)
        columns[element.name] = {each.name: (table[str(i)], once) for i, each in enumerate(element.properties)}
        at += element.rows * row.itemsize
    if data[at:].strip(b"\0\r\n\t \x1a"):
        raise MeshError(f"holds {len(data) - at} bytes more than its header says")
    return columns


def _ragged(element: _Element, data: bytes, at: int, order: str) -> tuple[dict[str, Column], int]:
    """Columns of an element whose rows have lists, and where it ends."""
    sizes = [np.dtype(each.kind).itemsize for each in element.properties]
    byteorder = "little" if order == "<" else "big"
    places: list[list[int]] = [[] for _ in element.properties]
    counts: list[list[int]] = [[] for _ in element.properties]
    for row in range(element.rows):
        for i, each in enumerate(element.properties):
            count = 1
            if each.count:
                end = at + int(each.count[1])
                count = int.from_bytes(data[at:end], byteorder, signed=each.count[0] == "i")
                at = end
            if count < 0 or at + count * sizes[i] > len(data):
                raise _cut(element, row)
            places[i].append(at)
            counts[i].append(count)
            at += count * sizes[i]
    columns = {}
    for i, each in enumerate(element.properties):
        count = np.array(counts[i], np.int64)
        within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        first = np.repeat(np.array(places[i], np.int64), count) + within * sizes[i]
        gathered = np.frombuffer(data, np.uint8)[first[:, None] + np.arange(sizes[i])]
        columns[each.name] = np.ascontiguousarray(gathered).view(order + each.kind).ravel(), count
    return columns, at


def _indices(columns: dict[str, dict[str, Column]], element: str) -> Column:
    """The lists of vertices of an element, none where it is missing; (N,) int64 and (P,) int64."""
    found = columns.get(element)
    if found is None:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    name = next((name for name in _LISTS if name in found), None)
    if name is None:
        raise MeshError(f"element {element} has no list {' or '.join(_LISTS)}")
    values, counts = found[name]
    if values.dtype.kind == "f":
        raise MeshError(f"element {element}: {name} is a list of {values.dtype.name}: allowed are whole numbers")
    return values.astype(np.int64), counts


def _cut(element: _Element, rows: int) -> MeshError:
    return MeshError(f"holds {rows} of {element.rows} rows of element {element.name}: it is cut short")
