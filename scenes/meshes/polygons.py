"""Polygons to triangles that cover the same area once.

With `a_k` the areas of the fan about the first corner, signed about the polygon's normal (Newell's: the sum of the
fan's cross products), the fan is right where `sum |a_k| = sum a_k`, and it is for convex polygons. From others ears are
cut: three corners in a row that turn with the polygon, whose triangle holds no other corner and whose third side
crosses no other side (Meisters 1975). A polygon that is not flat is judged as it is seen along its normal.
"""

import numpy as np

# In a polygon of size 1: areas as float32 vertices have them, and points in float64.
_AREA = 1e-6
_POINT = 1e-9

Point = tuple[float, float]


class MeshError(ValueError):
    """A mesh that cannot be used; the message is one line and does not name the file."""


def triangulate(vertices: np.ndarray, corners: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Triangles (F, 3) int64 of polygons, those of fewest corners first; each polygon of n corners gives n - 2.

    Parameters
    ----------
    vertices : (V, 3) float64.
    corners : (N,) int64, the polygons' corners, one polygon behind the other.
    counts : (P,) int64, corners of each polygon; their sum is N.

    Raises
    ------
    MeshError : a polygon of fewer than 3 corners, an index out of range, a vertex that is not finite, a polygon that
        crosses itself.
    """
    starts = np.cumsum(counts) - counts
    _check(vertices, corners, counts, starts)
    faces = [np.empty((0, 3), np.int64)]
    for count in np.unique(counts):
        chosen = np.flatnonzero(counts == count)
        polygons = corners[starts[chosen, None] + np.arange(count)]
        fans = np.array([[0, 1, 2], *([k, k + 1, 0] for k in range(2, count - 1))])
        if count == 3:
            faces.append(polygons)
            continue
        points = vertices[polygons] - vertices[polygons[:, :1]]
        size = np.abs(points).max(axis=(1, 2), keepdims=True)
        points = np.divide(points, size, out=points, where=size > 0)
        crosses = np.cross(points[:, 1:-1], points[:, 2:])
        normals = crosses.sum(axis=1)
        area = np.linalg.norm(normals, axis=1)
        unit = np.divide(normals, area[:, None], out=np.zeros_like(normals), where=area[:, None] > 0)
        covered = np.abs((crosses * unit[:, None]).sum(axis=2)).sum(axis=1)
        fanned = (covered <= area * (1 + _AREA)) & (area > _AREA)
        fanned |= np.linalg.norm(crosses, axis=2).sum(axis=1) <= _AREA
        faces.append(polygons[fanned][:, fans].swapaxes(0, 1).reshape(-1, 3))
        others = np.flatnonzero(~fanned)
        seen = _along(points[others], unit[others])
        for i, outline in zip(others, seen, strict=True):
            ears = _ears([(x, y) for x, y in outline]) if area[i] > _AREA else None
            if ears is None:
                raise MeshError(
                    f"face {chosen[i]}, {count} corners from {vertices[polygons[i, 0]].tolist()}: crosses itself: "
                    "allowed are polygons with one inside"
                )
            faces.append(polygons[i][ears])
    return np.concatenate(faces)


def strip(corners: np.ndarray) -> np.ndarray:
    """Triangles (N - 2, 3) of a strip (N,): every other one is turned."""
    faces = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
    faces[1::2] = faces[1::2, [0, 2, 1]]
    return faces


def _check(vertices: np.ndarray, corners: np.ndarray, counts: np.ndarray, starts: np.ndarray) -> None:
    if (few := np.flatnonzero(counts < 3)).size:
        raise MeshError(f"face {few[0]} has {counts[few[0]]} corners: allowed are at least 3")
    if (wild := np.flatnonzero((corners < 0) | (corners >= len(vertices)))).size:
        face = np.searchsorted(starts, wild[0], side="right") - 1
        raise MeshError(f"face {face} has the index {corners[wild[0]]}: allowed is [0, {len(vertices) - 1}]")
    if (bad := np.flatnonzero(~np.isfinite(vertices).all(axis=1))).size:
        raise MeshError(f"vertices[{bad[0]}] = {tuple(vertices[bad[0]].tolist())}: allowed are finite numbers")


def _along(points: np.ndarray, normals: np.ndarray) -> list[list[list[float]]]:
    """Polygons (P, n, 3) as they are seen against their unit normals (P, 3), counter-clockwise."""
    aside = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    aside /= np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), np.finfo(float).tiny)
    axes = np.stack([aside, np.cross(normals, aside)], axis=2)
    return (points @ axes).tolist()


def _ears(points: list[Point]) -> list[list[int]] | None:
    """Triangles, n - 2 of a counter-clockwise polygon of n corners, or None where it crosses itself."""
    left, ears, at = list(range(len(points))), [], 0
    twice = {point for point in points if points.count(point) > 1}
    while len(left) > 3:
        at = _ear([points[i] for i in left], at, twice)
        if at is None:
            break
        ears.append([left[at - 1], left[at], left[(at + 1) % len(left)]])
        del left[at]
    ears += [[left[0], left[k], left[k + 1]] for k in range(1, len(left) - 1)]  # a triangle, or what has no area
    areas = [_turn(*(points[i] for i in ear)) for ear in ears]
    return ears if sum(map(abs, areas)) <= sum(areas) * (1 + _AREA) else None


def _ear(points: list[Point], start: int, twice: set[Point]) -> int | None:
    """Index of a corner that can be cut off, the first from `start` on, or None; `twice`: where the outline returns."""
    count = len(points)
    # A corner on a side of the triangle spoils it, unless nothing else is left: the outline touches itself there.
    for margin in (-_POINT, _POINT):
        for at in ((start + step) % count for step in range(count)):
            a, b, c = points[at - 1], points[at], points[(at + 1) % count]
            if _turn(a, b, c) <= 0.0 or _holds(a, b, c, points, margin):
                continue
            # Where no corner coincides with the triangle's, a side that enters it ends in it, or crosses the outline.
            if twice.isdisjoint((a, b, c)) or not _crosses(a, c, points):
                return at
    return None


def _holds(a: Point, b: Point, c: Point, points: list[Point], margin: float) -> bool:
    """Whether a triangle holds a point that is none of its corners."""
    return any(
        _turn(a, b, p) > margin and _turn(b, c, p) > margin and _turn(c, a, p) > margin and p not in (a, b, c)
        for p in points
    )


def _crosses(a: Point, c: Point, points: list[Point]) -> bool:
    """Whether the line from a to c crosses the outline."""
    return any(
        _apart(_turn(a, c, p), _turn(a, c, q)) and _apart(_turn(p, q, a), _turn(p, q, c))
        for p, q in zip(points, points[1:] + points[:1], strict=True)
    )


def _apart(first: float, second: float) -> bool:
    """Whether two are of opposite signs, by more than rounding."""
    return min(first, second) < -_POINT and max(first, second) > _POINT


def _turn(a: Point, b: Point, c: Point) -> float:
    """Twice the signed area of a triangle."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
