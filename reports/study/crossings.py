"""Which face a segment crosses, in float64 by brute force: what a ray tracer in single precision is held against.

A segment from a to b crosses a face where a and b lie on both sides of its plane and the point of crossing lies within
its edges. Its *margin* is the length by which it does: the least of the two heights above the plane, and of the point's
distances to the edges times the cosine at which it arrives; negative by how much it misses. What moves by less than
the margin changes nothing.

Faces are sorted along a curve into blocks, whose boxes are tested first.
"""

from typing import NamedTuple

import numpy as np

BLOCK = 64  # faces
PAIRS = 2**18  # of a segment and a box, or a face, tested together: bounds memory
_BITS = 10  # of each coordinate on the curve


class Crossings(NamedTuple):
    """Pairs of a segment and a face that it crosses, or misses by less than was asked for.

    Attributes
    ----------
    segment, face : (C,) indices.
    margin : (C,) float64
    fraction : (C,) of the segment, in [0, 1], up to the plane of the face.
    """

    segment: np.ndarray
    face: np.ndarray
    margin: np.ndarray
    fraction: np.ndarray


class Soup:
    """Triangles, `corners` (F, 3, 3) float64; those without an area are never crossed."""

    def __init__(self, corners: np.ndarray) -> None:
        """Sort the faces into blocks."""
        self.corners = corners
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        self.normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
        flat = np.flatnonzero(length[:, 0] > 0)
        self._order = flat[np.argsort(_curve(corners[flat].mean(axis=1)), kind="stable")]
        first = np.arange(0, len(self._order), BLOCK)
        sorted_corners = corners[self._order].reshape(-1, 9)
        low = np.minimum.reduceat(sorted_corners, first).reshape(-1, 3, 3) if len(first) else np.zeros((0, 3, 3))
        high = np.maximum.reduceat(sorted_corners, first).reshape(-1, 3, 3) if len(first) else np.zeros((0, 3, 3))
        self._low, self._high = low.min(axis=1), high.max(axis=1)

    def crossings(self, begin: np.ndarray, end: np.ndarray, *, within: float) -> Crossings:
        """Crossings of the segments from `begin` to `end` (N, 3) whose margin is above `-within`."""
        found = [Crossings(*np.zeros((2, 0), np.int64), *np.zeros((2, 0)))]
        for segment, block in self._boxes(begin, end, within):
            place = block[:, None] * BLOCK + np.arange(BLOCK)
            here = place < len(self._order)
            segments = np.repeat(segment, here.sum(axis=1))
            faces = self._order[place[here]]
            for start in range(0, len(faces), PAIRS):
                pair = slice(start, start + PAIRS)
                found.append(self._pairs(begin, end, segments[pair], faces[pair], within))
        return Crossings(*(np.concatenate(column) for column in zip(*found, strict=True)))

    def _boxes(self, begin: np.ndarray, end: np.ndarray, within: float):
        """Pairs of segments and blocks whose box, grown by `within`, they meet."""
        step = max(1, PAIRS // max(1, len(self._low)))
        for start in range(0, len(begin), step):
            a, way = begin[start : start + step, None], (end - begin)[start : start + step, None]
            with np.errstate(divide="ignore", invalid="ignore"):
                one, other = (self._low - within - a) / way, (self._high + within - a) / way
            # A segment along a side of a box: 0 / 0 is inside.
            enters = np.nanmax(np.minimum(one, other), axis=2, initial=0.0)
            leaves = np.nanmin(np.maximum(one, other), axis=2, initial=1.0)
            segment, block = np.nonzero(enters <= leaves)
            yield segment + start, block

    def _pairs(
        self, begin: np.ndarray, end: np.ndarray, segment: np.ndarray, face: np.ndarray, within: float
    ) -> Crossings:
        corners, normal = self.corners[face], self.normals[face]
        a, b = begin[segment], end[segment]
        before = np.einsum("px,px->p", a - corners[:, 0], normal)
        after = np.einsum("px,px->p", b - corners[:, 0], normal)
        across = np.abs(before - after)
        fraction = np.clip(np.divide(np.abs(before), across, out=np.zeros_like(across), where=across > 0), 0.0, 1.0)
        apart = before * after < 0
        fraction = np.where(apart | (np.abs(before) > np.abs(after)), fraction, 0.0)
        fraction = np.where(~apart & (np.abs(before) > np.abs(after)), 1.0, fraction)
        height = np.where(apart, 1.0, -1.0) * np.minimum(np.abs(before), np.abs(after))
        point = a + fraction[:, None] * (b - a)
        inside = np.full(len(face), np.inf)
        for corner, following in ((0, 1), (1, 2), (2, 0)):
            edge = corners[:, following] - corners[:, corner]
            inward = np.cross(normal, edge)
            inward /= np.maximum(np.linalg.norm(inward, axis=1, keepdims=True), 1e-300)
            inside = np.minimum(inside, np.einsum("px,px->p", point - corners[:, corner], inward))
        cosine = across / np.maximum(np.linalg.norm(b - a, axis=1), 1e-300)
        margin = np.minimum(height, inside * cosine)
        kept = margin > -within
        return Crossings(segment[kept], face[kept], margin[kept], fraction[kept])


def _curve(points: np.ndarray) -> np.ndarray:
    """Places of points (N, 3) on the Z-order curve through their box."""
    low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(3), np.ones(3))
    cell = ((points - low) / np.where(high > low, high - low, 1.0) * (2**_BITS - 1)).astype(np.int64)
    code = np.zeros(len(points), np.int64)
    for bit in range(_BITS):
        for axis in range(3):
            code |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code
