"""Mesh files: area, volume and number of triangles are those of the solid that was written, or the file is refused.

Rationale: a wrong triangle is an error of neither renderer, and both would agree on it. A closed surface that points
outwards has the volume `(1/6) sum v0 . (v1 x v2)`, so that a turned face shows, and a missing one too.
"""

import base64
import itertools
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from termwise.scenes import meshes
from termwise.scenes.load import load
from termwise.scenes.meshes.polygons import MeshError, triangulate
from termwise.scenes.model import Mesh

CUBE = np.array(list(itertools.product((0, 1), repeat=3)), float)
QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
U = np.array([[0, 0], [3, 0], [3, 3], [2, 3], [2, 1], [1, 1], [1, 3], [0, 3]], float)  # area 7


def measure(vertices, faces) -> tuple[int, Any, Any]:
    """Number of triangles, area, and volume within."""
    a, b, c = np.asarray(vertices)[np.asarray(faces)].swapaxes(0, 1)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    return len(faces), pytest.approx(area, rel=1e-6), pytest.approx(np.sum(a * np.cross(b, c)) / 6, abs=1e-6)


def read(path: Path, content: str | bytes) -> tuple[int, Any, Any]:
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return measure(*meshes.read(path))


def flat(points: np.ndarray) -> np.ndarray:
    return np.column_stack([points, np.zeros(len(points))])


# Polygons.


def areas(vertices, corners=None) -> float:
    corners = np.arange(len(vertices)) if corners is None else np.array(corners)
    faces = triangulate(np.asarray(vertices, float), corners, np.array([len(corners)]))
    assert len(faces) == len(corners) - 2
    return measure(vertices, faces)[1].expected


@pytest.mark.parametrize("first", range(8))
def test_a_concave_polygon_keeps_its_area(first):
    """Wherever its corners begin to be counted, and whichever way it lies."""
    turned, _ = np.linalg.qr(np.random.default_rng(first).normal(size=(3, 3)))
    assert areas(np.roll(flat(U), first, axis=0) @ turned + 5.0) == pytest.approx(7.0, rel=1e-6)
    assert areas(np.roll(flat(U), first, axis=0)[::-1]) == pytest.approx(7.0, rel=1e-6)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(0.1, 1.0), min_size=4, max_size=24), st.floats(1e-3, 1e3), st.integers(0, 2**32 - 1))
def test_any_star_keeps_its_area(radii, size, seed):
    """Corners at equal angles around a point, at any distance: the shoelace formula in its own plane."""
    angle = 2 * np.pi * np.arange(len(radii)) / len(radii)
    x, y = np.array(radii) * np.cos(angle), np.array(radii) * np.sin(angle)
    shoelace = np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2
    rng = np.random.default_rng(seed)
    turned, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    points = np.roll(flat(np.column_stack([x, y])), rng.integers(len(radii)), axis=0) @ turned
    assert areas(size * (points + rng.normal(size=3))) == pytest.approx(size**2 * shoelace, rel=1e-5)


@pytest.mark.parametrize(
    ("corners", "area"),
    [
        ([0, 1, 2, 3, 0, 4, 7, 6, 5, 4], 12.0),  # a hole, reached by a slit
        ([0, 1, 2, 3, 3, 0], 16.0),  # corners that repeat
        ([0, 8, 1, 2, 3], 16.0),  # a corner on a side
        ([8, 1, 2, 3, 0], 16.0),
        ([0, 1, 9], 8.0),
        ([0, 1, 2, 9, 3], 12.0),  # an arrow
        ([3, 9, 0, 1, 2], 12.0),
    ],
)
def test_polygons_that_touch_themselves(corners, area):
    """A square of 4 with a hole of 2, a corner halfway along its side, and its middle."""
    square = [[0, 0], [4, 0], [4, 4], [0, 4]]
    points = flat(np.array([*square, [1, 1], [3, 1], [3, 3], [1, 3], [2, 0], [2, 4]], float))
    points[9] = [2, 2, 0] if area == 12.0 else [4, 4, 0]
    assert areas(points, corners) == pytest.approx(area)


def test_quads_that_are_not_flat_or_have_no_area():
    """Both halves of a bent one count; one in a line is kept and has no area; one that crosses itself is refused."""
    assert areas([[0, 0, 0], [1, 0, 1], [1, 1, 0], [0, 1, 1]]) == pytest.approx(np.sqrt(3), rel=1e-6)
    assert areas([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]]) == 0.0
    assert areas([[0, 0, 0]] * 4) == 0.0
    for bow in ([[0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 0], [3, 3, 0], [3, 0, 0], [0, 2, 0]]):
        with pytest.raises(MeshError, match="face 0, 4 corners .*: crosses itself"):
            areas(bow)


# OBJ.

VERTICES = "".join(f"v {x:g} {y:g} {z:g}\n" for x, y, z in CUBE)
FACES = "".join("f " + " ".join(str(i + 1) for i in quad) + "\n" for quad in QUADS)
BLOCKS = "".join(
    "".join(f"v {x:g} {y:g} {z:g}\n" for x, y, z in CUBE[quad]) + "f -4 -3 -2 -1\n" for quad in QUADS
)  # each face behind its own vertices
OBJ = {
    "plain": VERTICES + FACES,
    "relative indices between blocks": BLOCKS,
    "relative, spread": VERTICES
    + "".join(f"f {' '.join(str(i - 8) for i in q)}\n" for q in QUADS[:3])
    + "v 9 9 9\n"
    + "".join(f"f {' '.join(str(i - 9) for i in q)}\n" for q in QUADS[3:]),
    "byte order mark": "\ufeff" + VERTICES + FACES,
    "tabs": (VERTICES + FACES).replace(" ", "\t"),
    "spaces before and behind": (VERTICES + FACES).replace("\n", "  \n\t "),
    "CRLF": (VERTICES + FACES).replace("\n", "\r\n"),
    "CR": (VERTICES + FACES).replace("\n", "\r"),
    "trailing comments": VERTICES + FACES.replace("\n", " # face\n"),
    "comments": "# 8 vertices \\\n" + VERTICES + "# f 1 2 3\n\n" + FACES + "#",
    "continued lines": (VERTICES + FACES).replace("f ", "f \\\n").replace("v ", "v \\ \r\n\t"),
    "texture and normal": "vt 0 0\nvn 0 0 1\n" + VERTICES + FACES.replace(" ", "/1/1 ").replace("f/1/1", "f"),
    "normal alone": "vn 0 0 1\n" + VERTICES + FACES.replace("\n", "//1\n"),
    "texture alone": VERTICES + FACES.replace("\n", "/1\n"),
    "groups and materials": "mtllib a b.mtl\no one\n"
    + VERTICES
    + "g x y\ns off\nusemtl m\n"
    + FACES[:20]
    + "s 1\n"
    + FACES[20:],
    "points and lines": VERTICES + "p 1 2\nl 1 2 3\n" + FACES,
    "words of others": "vc 1 1 1\n" + VERTICES + "mycolor 3\n" + FACES,
    "faces first": FACES + VERTICES,
    "a weight": VERTICES.replace("\n", " 1.0\n") + FACES,
    "vertex colours": VERTICES.replace("\n", " 0.5 0.5 1\n") + FACES,
    "negative zero": VERTICES.replace("0", "-0.0") + FACES,
    "exponents": VERTICES.replace("1", "+1.0E+00") + FACES,
    "names of another encoding": ("o Würfel\n" + VERTICES + FACES).encode("latin-1"),
    "no newline at the end": (VERTICES + FACES).rstrip(),
}


@pytest.mark.parametrize("dialect", OBJ)
def test_obj(dialect, tmp_path):
    """A cube in every dialect: 12 triangles, area 6, volume 1."""
    assert read(tmp_path / "a.OBJ", OBJ[dialect]) == (12, 6.0, 1.0)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (VERTICES + "f 0 1 3\n", "line 9: 'f 0 1 3': index 0: allowed are 1 to 8, and -1 to -8 from the last"),
        (VERTICES + "f -0 1 3\n", "line 9: .*index 0"),
        (VERTICES + "f -9 -1 -2\n", "line 9: .*index -9: allowed are 1 to 8"),
        ("v 0 0 0\nf -1 -2 -3\n" + VERTICES, "line 2: .*index -2: allowed are 1 to 1"),
        (VERTICES + FACES + "f 1 2 9\n", "line 15: index 9: allowed are 1 to 8"),
        (FACES, "line 1: index 1: no vertex"),
        (VERTICES + "f 1 2\n", "line 9: 'f 1 2': allowed are at least 3 corners"),
        (VERTICES + "f 1 2 x\n", "line 9: .*'x': allowed are whole numbers"),
        (VERTICES + "f 1.0 2 3\n", "line 9: .*'1.0': allowed are whole numbers"),
        ("v 1 2\n", "line 1: 'v 1 2': allowed are three numbers"),
        ("v 1_0 2 3\n", "line 1: .*: allowed are three numbers"),
        (VERTICES + "f 1 2 0_3\n", "line 9: .*'0_3': allowed are whole numbers"),
        (VERTICES + "f 1 2 \N{ARABIC-INDIC DIGIT THREE}\n", "line 9: .*: allowed are whole numbers"),
        ("v 1,0 2,0 3,0\n", "line 1: .*: allowed are three numbers"),
        ("v 0 0 inf\n" + VERTICES + FACES, r"vertices\[0\] = \(0.0, 0.0, inf\): allowed are finite numbers"),
        (VERTICES + FACES + "1 2 3\n", "line 15: '1 2 3': is no statement of OBJ"),
        (VERTICES + "f 1 2 \\", "line 9: .*cut short"),
        (VERTICES + "surf 0 1 0 1 1 2 3 4\n", "line 9: .*free-form surfaces .* not read"),
        (VERTICES, "holds no triangles"),
        ("", "holds no triangles"),
    ],
)
def test_bad_obj(content, message, tmp_path):
    """The line, what stands there, what is allowed."""
    with pytest.raises(MeshError, match=message):
        read(tmp_path / "a.obj", content)


# PLY.


def ply(
    form: str, *, count="uchar", index="int", name="vertex_indices", number="float", extra=False, mixed=False
) -> bytes:
    """The cube as PLY of any kind: mixed, two sides as triangles; `extra`, other properties and elements around."""
    order = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}[form]
    polygons = (
        QUADS[2:] + [[q[0], q[1], q[2]] for q in QUADS[:2]] + [[q[0], q[2], q[3]] for q in QUADS[:2]]
        if mixed
        else QUADS
    )
    kinds = {
        "char": "b",
        "uchar": "B",
        "short": "h",
        "ushort": "H",
        "int": "i",
        "uint": "I",
        "float": "f",
        "double": "d",
    }
    elements: list[tuple[str, list[str], list]] = [
        ("vertex", [f"{number} x", f"{number} y", f"{number} z"], CUBE.tolist()),
        ("face", [f"list {count} {index} {name}"], [[polygon] for polygon in polygons]),
    ]
    if extra:
        vertex, face = elements
        vertex = (
            "vertex",
            ["uchar red", *vertex[1], "list uchar short more"],
            [[7, *p, [5] * (i % 3)] for i, p in enumerate(vertex[2])],
        )
        face = (
            "face",
            ["float quality", *face[1], "list uchar float texcoord", "int texnumber"],
            [[0.5, *f, [0.25] * 8, -1] for f in face[2]],
        )
        material = ("material", ["int a", "double b"], [[1, 2.5]] * 3)
        edge = ("edge", ["int vertex1", "int vertex2"], [[0, 1]] * 5)
        elements = [material, face, vertex, edge]
    lines, body = ["ply", f"format {form} 1.0", "comment TextureFile none.png", "obj_info end_header"], b""
    for element, properties, rows in elements:
        lines += [f"element {element} {len(rows)}", *(f"property {each}" for each in properties)]
        for row in rows:
            for each, value in zip(properties, row, strict=True):
                words = each.split()
                if order is None:
                    values = [len(value), *value] if words[0] == "list" else [value]
                    body += b"".join(f"{v:g} ".encode() for v in values)
                elif words[0] == "list":
                    body += struct.pack(order + kinds[words[1]], len(value))
                    body += struct.pack(f"{order}{len(value)}{kinds[words[2]]}", *value)
                else:
                    body += struct.pack(order + kinds[words[0]], int(value) if kinds[words[0]] in "bBhHiI" else value)
            body += b"\n" if order is None else b""
    return "\n".join([*lines, "end_header", ""]).encode() + body


FORMS = ("ascii", "binary_little_endian", "binary_big_endian")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    "kind",
    [
        {},
        {"mixed": True},
        {"extra": True},
        {"extra": True, "mixed": True},
        {"name": "vertex_index"},
        {"count": "int", "index": "uint"},
        {"count": "ushort", "index": "short"},
        {"count": "char", "index": "uchar", "number": "double"},
        {"number": "short"},
    ],
    ids=str,
)
def test_ply(form, kind, tmp_path):
    """A cube of every kind and byte order: 12 triangles, area 6, volume 1."""
    assert read(tmp_path / "a.ply", ply(form, **kind)) == (12, 6.0, 1.0)


def test_ply_of_other_systems(tmp_path):
    """Lines that end in CRLF or CR, with binary data that begins with a line feed."""
    binary, text = ply("binary_little_endian", extra=True, mixed=True), ply("ascii")
    end = binary.index(b"\nend_header\n") + len("\nend_header\n")
    for newline in (b"\r\n", b"\r"):
        assert read(tmp_path / "a.ply", binary[:end].replace(b"\n", newline) + binary[end:]) == (12, 6.0, 1.0)
        assert read(tmp_path / "a.ply", text.replace(b"\n", newline)) == (12, 6.0, 1.0)
    head = ply("binary_little_endian", number="uchar")
    end = head.index(b"\nend_header\n") + len("\nend_header\n")
    moved = head[:end].replace(b"\n", b"\r") + bytes(10 + value for value in head[end : end + 24]) + head[end + 24 :]
    assert read(tmp_path / "a.ply", moved) == (12, 6.0, 1.0)


def test_ply_concave_and_strips(tmp_path):
    """A polygon of eight, area 7; strips that end at -1, area 6 and volume 1."""
    points = "".join(f"{x:g} {y:g} 0\n" for x, y in U)
    head = "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
    polygon = (
        head + "element face 1\nproperty list uchar int vertex_indices\nend_header\n" + points + "8 0 1 2 3 4 5 6 7\n"
    )
    assert read(tmp_path / "a.ply", polygon) == (6, 7.0, 0.0)
    strips = [each for a, b, c, d in QUADS for each in (b, c, a, d, -1)]
    head += "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    points = "".join(f"{x:g} {y:g} {z:g}\n" for x, y, z in CUBE)
    assert read(tmp_path / "a.ply", head + points + f"{len(strips)} {' '.join(map(str, strips))}\n") == (12, 6.0, 1.0)


@pytest.mark.parametrize("form", FORMS)
def test_ply_element_without_properties(form, tmp_path):
    """It has no data, however many rows it says."""
    whole = ply(form).replace(b"element vertex", b"element nothing 9999999999999\nelement vertex", 1)
    assert read(tmp_path / "a.ply", whole) == (12, 6.0, 1.0)


@pytest.mark.parametrize("form", FORMS)
def test_a_ply_cut_anywhere_is_refused(form, tmp_path):
    """At any byte but those of the last line's end; and with anything more than it says."""
    whole = ply(form, extra=True, mixed=True)
    for length in range(0, len(whole.rstrip()) - 1, 7):
        with pytest.raises(MeshError):
            read(tmp_path / "a.ply", whole[:length])
    with pytest.raises(MeshError, match="more"):
        read(tmp_path / "a.ply", whole + b"7 7 7")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("element vertex 8", "element vertex x", "header: 'element vertex x': is no line"),
        ("property float x", "property real x", "type 'real': allowed are char, uchar"),
        ("property float x", "property float w", "no element vertex with x, y and z"),
        ("vertex_indices", "corners", "face has no list vertex_indices or vertex_index"),
        ("format ascii 1.0", "comment", "names no format: allowed are ascii"),
        ("ascii", "binary", "header: 'format binary 1.0'"),
        ("\nend_header\n", "\n", "no line 'end_header'"),
        ("4 0 1 3 2", "4 0 1 3 8", r"face 0 has the index 8: allowed is \[0, 7\]"),
        ("4 0 1 3 2", "4 0 1 3 -1", "face 0 has the index -1"),
        ("4 0 1 3 2", "4 0 1 3 2.5", "element face: .*2.5"),
        ("4 0 1 3 2", "2 0 1", "face 0 has 2 corners: allowed are at least 3"),
        ("1 1 1", "1 1 nan", r"vertices\[7\] = \(1.0, 1.0, nan\)"),
        ("1 1 1", "1 1 one", "element vertex: .*one"),
        ("1 1 1", "1 1 1_0", "element vertex: '1_0' is no number"),
        ("4 0 1 3 2", "4 0 1 3 0_2", "element face: '0_2' is no number"),
    ],
)
def test_bad_ply(old, new, message, tmp_path):
    """What stands there, and what is allowed."""
    content = ply("ascii").decode()
    assert old in content
    with pytest.raises(MeshError, match=message):
        read(tmp_path / "a.ply", content.replace(old, new, 1))


# STL.

TRIANGLES = [[q[i] for i in half] for q in QUADS for half in ((0, 1, 2), (0, 2, 3))]


def facet(corners) -> str:
    lines = "".join(f"vertex {x:g} {y:g} {z:g}\n" for x, y, z in CUBE[corners])
    return f"facet normal 0 0 0\nouter loop\n{lines}endloop\nendfacet\n"


def solid(triangles, name="") -> str:
    return f"solid {name}\n{''.join(map(facet, triangles))}endsolid {name}\n"


def binary_stl(header: bytes = b"") -> bytes:
    facets = b"".join(struct.pack("<12fH", 0, 0, 0, *CUBE[t].ravel(), 0) for t in TRIANGLES)
    return header.ljust(80, b" ") + struct.pack("<I", len(TRIANGLES)) + facets


def test_stl(tmp_path):
    """Text of one or two solids, in capitals, with tabs, CRLF, odd names; binary whatever it begins with."""
    whole, halves = solid(TRIANGLES, "a facet"), solid(TRIANGLES[:5], "a") + "\n" + solid(TRIANGLES[5:], "endsolid")
    for content in (
        whole,
        halves,
        whole.upper(),
        halves.replace("\n", "\r\n\t"),
        "\ufeff" + whole.replace("0 0", "0\t0"),
    ):
        assert read(tmp_path / "a.stl", content) == (12, 6.0, 1.0)
    for header in (b"", b"solid cube", b"\0"):
        assert read(tmp_path / "a.stl", binary_stl(header)) == (12, 6.0, 1.0)


def test_a_cut_stl_is_refused(tmp_path):
    """Text at any line, and binary at any facet, but where a solid ends and nothing says that another follows."""
    text = solid(TRIANGLES[:6], "a") + solid(TRIANGLES[6:], "b")
    lines, ends = text.splitlines(keepends=True), len(solid(TRIANGLES[:6], "a").splitlines())
    for count in (*range(1, ends, 5), *range(ends + 1, len(lines) - 1, 5)):
        with pytest.raises(MeshError, match="cut short|holds no triangles"):
            read(tmp_path / "a.stl", "".join(lines[:count]))
    for header, length in itertools.product((b"", b"solid cube"), (0, 50, 84, 134, 500)):
        with pytest.raises(MeshError):
            read(tmp_path / "a.stl", binary_stl(header)[:length])
    with pytest.raises(MeshError, match="holds 12.02 facets where its header says 12"):
        read(tmp_path / "a.stl", binary_stl() + b"x")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("endloop", "vertex 0 0 0\nendloop", "facet 0: 'vertex': allowed is 'endloop'"),
        ("endfacet", "", "facet 0: .*: allowed is 'endfacet'"),
        ("vertex 0 0 0", "vertex 0 0", "facet 0: .*: allowed is 'vertex'"),
        ("vertex 0 0 0", "vertex 0 0 x", "vertex: .*x"),
        ("vertex 0 0 0", "vertex 0 0 0_1", "vertex: '0_1' is no number"),
        ("vertex 0 0 0", "vertex 0 0 inf", r"vertices\[0\] = \(0.0, 0.0, inf\)"),
        ("endsolid", "endsolid\nfacet", "line 87: 'facet': allowed is 'solid'"),
    ],
)
def test_bad_stl(old, new, message, tmp_path):
    """The facet or line, and what is allowed."""
    with pytest.raises(MeshError, match=message):
        read(tmp_path / "a.stl", solid(TRIANGLES).replace(old, new, 1))


# GLB.


class Glb:
    """A file in the making."""

    def __init__(self, **description):
        self.description = {
            "asset": {"version": "2.0"},
            "bufferViews": [],
            "accessors": [],
            "meshes": [],
            **description,
        }
        self.data = b""

    def view(self, values: np.ndarray, **more) -> int:
        self.data += b"\0" * (-len(self.data) % 4)
        content = np.ascontiguousarray(values).tobytes()
        self.description["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(content), **more}
        )
        self.data += content
        return len(self.description["bufferViews"]) - 1

    def accessor(self, values, kind: str, **more) -> int:
        """Number of an accessor of all values; `view=None`: of zeros."""
        kinds = {"<i1": 5120, "<u1": 5121, "<i2": 5122, "<u2": 5123, "<u4": 5125, "<f4": 5126}
        values = np.asarray(values).astype(kind)
        width = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}[1 if values.ndim == 1 else values.shape[1]]
        described = {"componentType": kinds[kind], "count": len(values), "type": width}
        if "view" not in more:
            described["bufferView"] = self.view(values)
        described |= {key: value for key, value in more.items() if value is not None}
        self.description["accessors"].append({key: value for key, value in described.items() if key != "view"})
        return len(self.description["accessors"]) - 1

    def mesh(self, points: int, indices: int | None = None, **more) -> int:
        primitive = {"attributes": {"POSITION": points}, **more}
        if indices is not None:
            primitive["indices"] = indices
        self.description["meshes"].append({"primitives": [primitive]})
        return len(self.description["meshes"]) - 1

    def bytes(self) -> bytes:
        described = {"nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}], **self.description}
        described["buffers"] = described.get("buffers", [{"byteLength": len(self.data)}])
        text = json.dumps(described).encode()
        chunks = [(b"JSON", text + b" " * (-len(text) % 4)), (b"BIN\0", self.data + b"\0" * (-len(self.data) % 4))]
        body = b"".join(struct.pack("<I", len(content)) + kind + content for kind, content in chunks)
        return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


INDICES = np.array(TRIANGLES).ravel()


def cube(**description) -> Glb:
    glb = Glb(**description)
    glb.mesh(glb.accessor(CUBE, "<f4"), glb.accessor(INDICES, "<u2"))
    return glb


@pytest.mark.parametrize("kind", ["<i1", "<u1", "<i2", "<u2"])
@pytest.mark.parametrize("normalized", [False, True])
def test_glb_integers(kind, normalized, tmp_path):
    """Positions as whole numbers, and as shares of the largest; indices of every width."""
    glb = Glb(extensionsRequired=["KHR_mesh_quantization", "KHR_materials_unlit"])
    top = np.iinfo(kind).max if normalized else 1
    points = glb.accessor(CUBE * top, kind, normalized=normalized)
    glb.mesh(points, glb.accessor(INDICES, {"<i1": "<u1", "<i2": "<u2"}.get(kind, "<u4")))
    assert read(tmp_path / "a.glb", glb.bytes()) == (12, 6.0, 1.0)
    if normalized and kind[1] == "i":  # the lowest is -1 too
        low = Glb()
        low.mesh(low.accessor(np.where(CUBE > 0, top, -top - 1), kind, normalized=True), low.accessor(INDICES, "<u2"))
        assert read(tmp_path / "a.glb", low.bytes()) == (12, 24.0, 8.0)


def test_glb_strips_fans_points_and_lines(tmp_path):
    """Modes 4, 5 and 6 of each side, with and without indices; points and lines are no surface."""
    for mode, order in ((4, (0, 1, 2, 0, 2, 3)), (5, (1, 2, 0, 3)), (6, (0, 1, 2, 3))):
        glb = Glb()
        points = glb.accessor(CUBE, "<f4")
        sides = [glb.accessor([q[i] for i in order], "<u2") for q in QUADS]
        spread = glb.accessor(CUBE[[QUADS[0][i] for i in order]], "<f4")
        primitives = [{"attributes": {"POSITION": points}, "indices": side, "mode": mode} for side in sides[1:]]
        primitives += [{"attributes": {"POSITION": spread}, "mode": mode}]
        primitives += [{"attributes": {"POSITION": points}, "mode": other} for other in (0, 1, 2, 3)]
        glb.description["meshes"] = [{"primitives": primitives}]
        assert read(tmp_path / "a.glb", glb.bytes()) == (12, 6.0, 1.0)


def test_glb_nodes(tmp_path):
    """Parents and children, matrices, a mirror, an instance; and what no scene holds is not drawn."""
    turned = [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]  # a quarter about z
    nodes = [
        {"children": [1, 2], "scale": [2, 2, 2], "translation": [1, 2, 3]},
        {"mesh": 0, "rotation": turned, "scale": [1, 2, -1]},  # mirrored: 2 x 2 x 2 x 2 in volume
        {"mesh": 0, "matrix": [3, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1]},
        {"mesh": 0},
    ]
    glb = cube(nodes=nodes, scenes=[{"nodes": [3]}, {"nodes": [0]}], scene=1)
    (tmp_path / "a.glb").write_bytes(glb.bytes())
    vertices, faces = meshes.read(tmp_path / "a.glb")
    assert measure(vertices[:8], faces[:12]) == (12, 4 * (2 * (2 + 1 + 2)), 16.0)
    assert measure(vertices[8:], faces[12:] - 8) == (12, 4 * (2 * (3 + 1 + 3)), 24.0)
    corner = 2 * np.array([0, 1, -1]) + [1, 2, 3]  # x to y by the quarter turn
    assert (np.abs(vertices[:8] - corner).max(axis=1) < 1e-9).any()
    assert np.allclose(vertices[8:].min(axis=0), [11, 14, 17])
    assert read(tmp_path / "a.glb", cube(nodes=nodes).bytes())[0] == 24  # no scene is named: the first


def test_glb_sparse_strided_and_zero_accessors(tmp_path):
    """Values that are replaced, of a view with a stride, and of none at all."""
    glb = Glb()
    glb.mesh(0, 1)
    wrong = CUBE.copy()
    wrong[[2, 5]] = 9.0
    table = np.zeros((8, 5), "<f4")
    table[:, 1:4] = wrong
    view = glb.view(table, byteStride=20)
    places, values = glb.view(np.array([2, 5], "<u1")), glb.view(CUBE[[2, 5]].astype("<f4"))
    sparse = {"count": 2, "indices": {"bufferView": places, "componentType": 5121}, "values": {"bufferView": values}}
    glb.accessor(CUBE, "<f4", view=None, bufferView=view, byteOffset=4, sparse=sparse)
    glb.accessor(INDICES, "<u2")
    assert read(tmp_path / "a.glb", glb.bytes()) == (12, 6.0, 1.0)
    every = {"count": 8, "indices": {"bufferView": glb.view(np.arange(8, dtype="<u4")), "componentType": 5125}}
    every["values"] = {"bufferView": glb.view(CUBE.astype("<f4"))}
    glb.description["accessors"][0] = {"componentType": 5126, "count": 8, "type": "VEC3", "sparse": every}
    assert read(tmp_path / "a.glb", glb.bytes()) == (12, 6.0, 1.0)


def test_glb_morphs_and_skins(tmp_path):
    """Half a morph that adds 2 along x: a box of 2 x 1 x 1; half its corners at a joint that is moved by 3 along z."""
    glb = Glb(nodes=[{"mesh": 0, "weights": [0.5]}])
    delta = glb.accessor(CUBE * [2, 0, 0], "<f4")
    glb.mesh(glb.accessor(CUBE, "<f4"), glb.accessor(INDICES, "<u2"), targets=[{"POSITION": delta}])
    assert read(tmp_path / "a.glb", glb.bytes()) == (12, 10.0, 2.0)
    nodes = [{"mesh": 0, "skin": 0, "translation": [7, 7, 7]}, {"translation": [1, 0, 0]}, {"translation": [1, 0, 3]}]
    glb = Glb(nodes=nodes, scenes=[{"nodes": [0, 1, 2]}])
    inverse = np.eye(4)
    inverse[:3, 3] = -1, 0, 0
    joints = np.zeros((8, 4))
    joints[:, 0] = CUBE[:, 2]
    attributes = {"POSITION": glb.accessor(CUBE, "<f4"), "JOINTS_0": glb.accessor(joints, "<u1")}
    attributes["WEIGHTS_0"] = glb.accessor([[255, 0, 0, 0]] * 8, "<u1", normalized=True)
    glb.description["meshes"] = [{"primitives": [{"attributes": attributes, "indices": glb.accessor(INDICES, "<u2")}]}]
    matrices = glb.accessor([inverse.T.ravel()] * 2, "<f4")
    glb.description["skins"] = [{"joints": [1, 2], "inverseBindMatrices": matrices}]
    assert read(tmp_path / "a.glb", glb.bytes()) == (12, 18.0, 4.0)


def test_glb_buffers_elsewhere(tmp_path):
    """In a file beside it, or in its own text."""
    glb = cube()
    (tmp_path / "a b.bin").write_bytes(glb.data)
    size, glb.data = len(glb.data), b""
    glb.description["buffers"] = [{"byteLength": size, "uri": "a%20b.bin"}]
    assert read(tmp_path / "a.glb", glb.bytes()) == (12, 6.0, 1.0)
    content = base64.b64encode((tmp_path / "a b.bin").read_bytes()).decode()
    glb.description["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{content}"
    assert read(tmp_path / "a.glb", glb.bytes()) == (12, 6.0, 1.0)


@pytest.mark.parametrize("name", ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "ACME_terrain"])
def test_glb_of_a_required_extension_is_refused(name, tmp_path):
    """By name; what is used but not required is as the rest of the file says."""
    assert read(tmp_path / "a.glb", cube(extensionsUsed=[name]).bytes()) == (12, 6.0, 1.0)
    with pytest.raises(MeshError, match=f"requires the extension {name}"):
        read(tmp_path / "a.glb", cube(extensionsUsed=[name], extensionsRequired=[name]).bytes())


def test_a_cut_or_damaged_glb_is_refused(tmp_path):
    """At any byte; and where an index, a child, a kind or a value is not what glTF says."""
    whole = cube().bytes()
    for length in range(0, len(whole), 13):
        with pytest.raises(MeshError):
            read(tmp_path / "a.glb", whole[:length])
    for old, new, message in (
        (b'"mesh": 0', b'"mesh": 7', "not valid glTF"),
        (b'"mesh": 0', b'"mesh":-1', "meshes has no -1"),  # no last one, as in Python
        (b'"nodes": [0]', b'"nodes":[-1]', "nodes has no -1"),
        (b'"indices": 1', b'"indices":-1', "accessors has no -1"),
        (b'"bufferView": 0', b'"bufferView":-2', "bufferViews has no -2"),
        (b'"count": 8', b'"count": 7', "index 7: allowed is"),
        (b'"count": 8', b'"count": 9', "holds 96 of 108 bytes"),
        (b"5126", b"5127", "5127"),
        (b"POSITION", b"POSITIOM", "no triangles"),
        (b'"nodes": [0]', b'"nodes": [3]', "not valid glTF"),
        (b'"mesh": 0', b'"mesh": {', "not JSON"),
        (b"glTF\x02", b"glTF\x01", "is glTF 1: allowed is 2"),
    ):
        assert old in whole
        with pytest.raises(MeshError, match=message):
            read(tmp_path / "a.glb", whole.replace(old, new))
    for nodes in ([{"mesh": 0, "children": [0]}], [{"children": [1, 1]}, {"mesh": 0}]):
        with pytest.raises(MeshError, match="allowed are trees"):
            read(tmp_path / "a.glb", cube(nodes=nodes).bytes())


# Scenes.


def scene(folder: Path, file: str, more: str = "") -> Path:
    path = folder / "scene.toml"
    camera = "[camera]\nposition = [0.0, -3.0, 1.0]\ntarget = [0.0, 0.0, 0.0]\n"
    path.write_text(f'{camera}[[objects]]\nname = "m"\nshape = "mesh"\nfile = "{file}"\n{more}')
    return path


def test_smooth_is_smooth_in_every_format(tmp_path):
    """STL has three vertices a face, and others split them where a texture has a seam: one normal a place."""
    (tmp_path / "cube.obj").write_text(VERTICES + FACES)
    (tmp_path / "cube.stl").write_bytes(binary_stl())
    glb = Glb()
    glb.mesh(glb.accessor(CUBE[INDICES] * [1, 1, 1] + [0, 0, -0.0], "<f4"))
    (tmp_path / "cube.glb").write_bytes(glb.bytes())

    def normal_of_places(file: str) -> dict[tuple[float, ...], np.ndarray]:
        mesh = load(scene(tmp_path, file, 'normals = "smooth"\n')).objects[0].mesh
        assert mesh.normals is not None
        assert np.allclose(np.linalg.norm(mesh.normals, axis=1), 1.0)
        return {tuple(place): normal for place, normal in zip(mesh.vertices.tolist(), mesh.normals, strict=True)}

    expected = normal_of_places("cube.obj")
    assert all(normal @ (np.array(place) - 0.5) > 0.4 for place, normal in expected.items())  # outwards, not flat
    for name in ("cube.stl", "cube.glb"):
        for place, normal in normal_of_places(name).items():
            np.testing.assert_allclose(normal, expected[place], atol=1e-6)


@pytest.mark.filterwarnings("error")
def test_no_warning_beside_the_refusal(tmp_path):
    """An infinite vertex, one that float32 cannot hold: a refusal of one line; a texture that is missing: none."""
    for value, name in (("inf", "inf"), ("1e39", "inf"), ("1e300", "inf")):
        (tmp_path / "a.obj").write_text(VERTICES + f"v 0 0 {value}\n" + FACES)
        with pytest.raises(
            ValueError, match=f"'m': file = 'a.obj': vertices.8. = .*{name}.*: allowed are finite"
        ) as caught:
            load(scene(tmp_path, "a.obj", "rotation = [30.0, 0.0, 0.0]\n"))
        assert "\n" not in str(caught.value)
    (tmp_path / "a.ply").write_bytes(ply("ascii"))  # names a texture that is nowhere
    assert len(load(scene(tmp_path, "a.ply")).objects[0].mesh.faces) == 12
    assert Mesh.from_arrays(CUBE, TRIANGLES).faces.shape == (12, 3)
