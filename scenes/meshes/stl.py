"""STL: binary, `80 bytes, n, n x 50 bytes`, or text, `facet ... endfacet` within one or more `solid ... endsolid`.

A file is binary where its length says so, whatever it begins with. Normals are not read: the corners' order says them.
"""

import re
from pathlib import Path

import numpy as np

from termwise.scenes.meshes.polygons import MeshError, triangulate
from termwise.scenes.numerals import reals

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_WORDS = "facet normal {} {} {} outer loop" + 3 * " vertex {} {} {}" + " endloop endfacet"
_PATTERN = np.array(_WORDS.split())
_NUMBERS = np.flatnonzero(_PATTERN == "{}")


def read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (3 F, 3) float64 and triangles (F, 3) int64, see `scenes.meshes.read`."""
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little")
    if len(data) == 84 + count * _FACET.itemsize:
        corners = np.frombuffer(data, _FACET, count, 84)["corners"].reshape(-1, 3)
    elif re.match(rb"(\xef\xbb\xbf)?\s*solid\b", data, re.IGNORECASE) and b"\0" not in data:
        corners = _text(data.decode("utf-8-sig", "replace"))
    elif len(data) < 84:
        raise MeshError(f"holds {len(data)} bytes: it is cut short, or no STL")
    else:
        held = (len(data) - 84) / _FACET.itemsize
        raise MeshError(f"holds {held:g} facets where its header says {count}: it is cut short, or no STL")
    vertices = corners.astype(np.float64)
    faces = np.arange(len(vertices)).reshape(-1, 3)
    return vertices, triangulate(vertices, faces.ravel(), np.full(len(faces), 3))


def _text(text: str) -> np.ndarray:
    """Corners (3 F, 3) of all solids."""
    solids: list[str] = []
    open_solid: list[str] | None = None
    for number, line in enumerate(re.split(r"\r\n|\r|\n", text.lower()), start=1):
        word = line.split(maxsplit=1)[0] if line.strip() else ""
        if word == "solid" and open_solid is None:
            open_solid = []
        elif word == "endsolid" and open_solid is not None:
            solids += open_solid
            open_solid = None
        elif word and open_solid is None:
            raise MeshError(f"line {number}: {line.strip()[:60]!r}: allowed is 'solid'")
        elif word and open_solid is not None:
            open_solid += line.split()
    if open_solid is not None:
        raise MeshError("ends within a solid: it is cut short")
    facets = np.array(solids, dtype=np.str_)
    if len(facets) % len(_PATTERN):
        facets = np.append(facets, [""] * (-len(facets) % len(_PATTERN)))
    facets = facets.reshape(-1, len(_PATTERN))
    wrong = (facets != _PATTERN) & (_PATTERN != "{}")
    if wrong.any():
        facet, place = np.argwhere(wrong)[0]
        raise MeshError(f"facet {facet}: {facets[facet, place][:60]!r}: allowed is {str(_PATTERN[place])!r}")
    try:
        return np.reshape(reals(facets[:, _NUMBERS[3:]].ravel().tolist()), (-1, 3))
    except ValueError as error:
        raise MeshError(f"vertex: {error}") from None
