r"""Wavefront OBJ: `v`, and `f` by indices from 1, or from -1, the last vertex *so far*.

Of groups and materials the names are kept; points, lines and curves make no surface and are passed over, and so are
the words that other programs add. Names may be in any encoding. A comment runs from # to the end of its line; a line
goes on after \.
"""

import re
from collections.abc import Iterator
from pathlib import Path

import attrs
import numpy as np

from termwise.scenes.meshes.polygons import MeshError, triangulate
from termwise.scenes.numerals import reals, wholes

_SURFACES = {"surf", "bzp", "bsp", "cdp", "call", "csh"}  # free forms, and what other files hold


@attrs.frozen(eq=False)
class Content:
    """What a file says of its polygons.

    Attributes
    ----------
    points, normals, places : (V, 3), (N, 3) and (T, 2) float64, the last those in an image.
    corners, shading, mapped : (C,) int64, index of the point, the normal and the place (-1: none) of each corner,
        polygon by polygon.
    counts : (P,) int64, corners of each polygon.
    objects, materials : of each polygon, the names of `o` (or `g` where there is none) and `usemtl`, or "".
    libraries : what `mtllib` names.
    """

    points: np.ndarray
    normals: np.ndarray
    places: np.ndarray
    corners: np.ndarray
    shading: np.ndarray
    mapped: np.ndarray
    counts: np.ndarray
    objects: list[str]
    materials: list[str]
    libraries: list[str]


def read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) float64 and triangles (F, 3) int64, see `scenes.meshes.read`."""
    content = parse(path)
    return content.points, triangulate(content.points, content.corners, content.counts)


def read_mapped(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """What `read` gives, and (F, 3, 2) of `vt`, see `scenes.meshes.read_mapped`."""
    content = parse(path, mapped=True)
    if (content.mapped < 0).all():
        return *read(path), None
    if (content.mapped < 0).any():
        raise MeshError("has corners without vt beside others that have it: allowed are all, or none")
    # By corners, for a point may have several places.
    corners = triangulate(content.points[content.corners], np.arange(len(content.corners)), content.counts)
    return content.points, content.corners[corners], content.places[content.mapped[corners]]


def parse(path: Path, *, mapped: bool = False) -> Content:
    """All that a file says of its polygons; of places in an image only if it is `mapped`.

    Raises
    ------
    MeshError, OSError : as `scenes.meshes.read`.
    """
    vertices: dict[str, list[list[float]]] = {"v": [], "vn": []}
    places: list[list[float]] = []
    corners: list[int] = []
    shading: list[int] = []
    lying: list[int] = []
    counts: list[int] = []
    lines: list[int] = []
    names = {"o": "", "g": "", "usemtl": ""}
    objects, materials, libraries = [], [], []
    for line, statement in statements(path.read_bytes().decode("utf-8-sig", "replace")):
        word, *values = statement.split()
        where = f"line {line}: {statement[:60]!r}"
        if word in vertices:
            try:
                x, y, z, *_ = reals(values)
            except ValueError:
                raise MeshError(f"{where}: allowed are three numbers") from None
            vertices[word].append([x, y, z])
        elif word == "vt" and mapped:
            try:
                u, v, *_ = *reals(values), 0.0
            except ValueError:
                raise MeshError(f"{where}: allowed are two numbers") from None
            places.append([u, v])
        elif word in ("f", "fo"):
            if len(values) < 3:
                raise MeshError(f"{where}: allowed are at least 3 corners")
            for value in values:
                point, _, others = value.partition("/")
                corners.append(_index(where, value, point, len(vertices["v"])))
                place, _, normal = others.partition("/")
                shading.append(_index(where, value, normal, len(vertices["vn"])) if normal else -1)
                lying.append(_index(where, value, place, len(places)) if place and mapped else -1)
            counts.append(len(values))
            lines.append(line)
            objects.append(names["o"] or names["g"])
            materials.append(names["usemtl"])
        elif word in names:
            names[word] = " ".join(values)
        elif word == "mtllib":
            libraries.append(" ".join(values))
        elif word in _SURFACES:
            raise MeshError(f"{where}: free-form surfaces and other files are not read: allowed are polygons")
        elif not word.isidentifier():
            raise MeshError(f"{where}: is no statement of OBJ")
    # An index from 1 may name a vertex that comes later.
    for known, indices in ((vertices["v"], corners), (vertices["vn"], shading), (places, lying)):
        if (wild := np.flatnonzero(np.array(indices, np.int64) >= len(known))).size:
            face = np.searchsorted(np.cumsum(counts), wild[0], side="right")
            raise MeshError(f"line {lines[face]}: index {indices[wild[0]] + 1}: {_allowed(len(known))}")
    return Content(
        np.array(vertices["v"], np.float64).reshape(-1, 3),
        np.array(vertices["vn"], np.float64).reshape(-1, 3),
        np.array(places, np.float64).reshape(-1, 2),
        np.array(corners, np.int64),
        np.array(shading, np.int64),
        np.array(lying, np.int64),
        np.array(counts, np.int64),
        objects,
        materials,
        libraries,
    )


def _index(where: str, value: str, text: str, count: int) -> int:
    """An index from 0 of one from 1, or from -1 backwards of the last so far."""
    try:
        (index,) = wholes([text])
    except ValueError:
        raise MeshError(f"{where}: {value!r}: allowed are whole numbers, as 1, 1/1, 1//1, 1/1/1") from None
    if index == 0 or index < -count:
        raise MeshError(f"{where}: index {index}: {_allowed(count)}")
    return index - 1 if index > 0 else count + index


def _allowed(count: int) -> str:
    return f"allowed are 1 to {count}, and -1 to -{count} from the last" if count else "no vertex stands before it"


def statements(text: str) -> Iterator[tuple[int, str]]:
    """Number of the first line, and text, of all that is not empty."""
    begun, first = "", 0
    for number, line in enumerate(re.split(r"\r\n|\r|\n", text), start=1):
        content = line.partition("#")[0].strip()
        first = first if begun else number
        if content.endswith("\\"):
            begun += content[:-1] + " "
            continue
        if statement := (begun + content).strip():
            yield first, statement
        begun = ""
    if begun:
        raise MeshError(f"line {first}: ends in \\ and goes nowhere: it is cut short")
