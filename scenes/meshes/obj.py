r"""Wavefront OBJ: `v`, and `f` by indices from 1, or from -1, the last vertex *so far*.

Groups, materials, points, lines and curves make no surface and are passed over, and so are the words that other
programs add. Names may be in any encoding. A comment runs from # to the end of its line; a line goes on after \.
"""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from termwise.scenes.meshes.polygons import MeshError, triangulate
from termwise.scenes.numerals import reals, wholes

_SURFACES = {"surf", "bzp", "bsp", "cdp", "call", "csh"}  # free forms, and what other files hold


def read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) float64 and triangles (F, 3) int64, see `scenes.meshes.read`."""
    vertices: list[list[float]] = []
    corners: list[int] = []
    counts: list[int] = []
    lines: list[int] = []
    for line, statement in _statements(path.read_bytes().decode("utf-8-sig", "replace")):
        word, *values = statement.split()
        where = f"line {line}: {statement[:60]!r}"
        if word == "v":
            try:
                x, y, z, *_ = reals(values)
            except ValueError:
                raise MeshError(f"{where}: allowed are three numbers") from None
            vertices.append([x, y, z])
        elif word in ("f", "fo"):
            if len(values) < 3:
                raise MeshError(f"{where}: allowed are at least 3 corners")
            for value in values:
                try:
                    (index,) = wholes([value.partition("/")[0]])
                except ValueError:
                    raise MeshError(f"{where}: {value!r}: allowed are whole numbers, as 1, 1/1, 1//1, 1/1/1") from None
                if index == 0 or index < -len(vertices):
                    raise MeshError(f"{where}: index {index}: {_allowed(len(vertices))}")
                corners.append(index - 1 if index > 0 else len(vertices) + index)
            counts.append(len(values))
            lines.append(line)
        elif word in _SURFACES:
            raise MeshError(f"{where}: free-form surfaces and other files are not read: allowed are polygons")
        elif not word.isidentifier():
            raise MeshError(f"{where}: is no statement of OBJ")
    # An index from 1 may name a vertex that comes later.
    if (wild := np.flatnonzero(np.array(corners, np.int64) >= len(vertices))).size:
        face = np.searchsorted(np.cumsum(counts), wild[0], side="right")
        raise MeshError(f"line {lines[face]}: index {corners[wild[0]] + 1}: {_allowed(len(vertices))}")
    points = np.array(vertices, np.float64).reshape(-1, 3)
    return points, triangulate(points, np.array(corners, np.int64), np.array(counts, np.int64))


def _allowed(count: int) -> str:
    return f"allowed are 1 to {count}, and -1 to -{count} from the last" if count else "no vertex stands before it"


def _statements(text: str) -> Iterator[tuple[int, str]]:
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
