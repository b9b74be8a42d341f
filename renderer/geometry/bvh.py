"""A binary bounding volume hierarchy, built with the binned surface area heuristic.

A split costs `area(left) count(left) + area(right) count(right)`; the cheapest of the bin borders over the three
axes of the centroids' box is taken (Wald, "On fast Construction of SAH-based Bounding Volume Hierarchies", 2007).
Faces whose centroids coincide are halved by index, and from a depth of 48 on every split halves, so the tree is never
deeper than 48 + log2(faces) <= 79 levels and a fixed stack suffices.
"""

from typing import NamedTuple

import numpy as np

from termwise.renderer.by_reference import by_reference
from termwise.renderer.geometry import bvh8, simd
from termwise.renderer.geometry.bvh8 import MAX_DEPTH, STACK_SIZE, Bvh8
from termwise.renderer.geometry.polygons import Polygons, polygons_of
from termwise.renderer.jit import kernel

LEAF_SIZE = 4
BINS = 16
_HALVING_DEPTH = 48

__all__ = ["STACK_SIZE", "Tree", "build", "bytes_of"]


@by_reference()
class Tree(NamedTuple):
    """Nodes in preorder: the left child of node i is i + 1.

    Attributes
    ----------
    bounds : (N, 2, 3) float64, low and high corner.
    right : (N,) int32, the right child; 0 in a leaf.
    first, count : (N,) int32, the range of `order` in a leaf.
    order : (F,) int32 face indices.
    bvh8 : the same tree with 8 children a node, for rays; empty where the processor lacks the vectors.
    polygons : the faces without a tree, if they are few, and the processor has the vectors.
    """

    bounds: np.ndarray
    right: np.ndarray
    first: np.ndarray
    count: np.ndarray
    order: np.ndarray
    bvh8: Bvh8
    polygons: Polygons


@kernel
def _build(
    lows: np.ndarray,
    highs: np.ndarray,
    bounds: np.ndarray,
    right: np.ndarray,
    first: np.ndarray,
    count: np.ndarray,
    order: np.ndarray,
) -> int:
    faces = len(order)
    # Entries: begin, end, parent whose right child this is (-1: none), depth.
    stack = np.empty((MAX_DEPTH + 1, 4), np.int64)
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = 0, faces, -1, 0
    size = 1
    nodes = 0
    bin_count = np.empty((3, BINS), np.int64)
    bin_low = np.empty((3, BINS, 3))
    bin_high = np.empty((3, BINS, 3))
    right_area = np.empty(BINS)
    middle_low = np.empty(3)
    middle_high = np.empty(3)
    low = np.empty(3)
    high = np.empty(3)
    while size > 0:
        size -= 1
        begin, end, parent, depth = stack[size, 0], stack[size, 1], stack[size, 2], stack[size, 3]
        node = nodes
        nodes += 1
        if parent >= 0:
            right[parent] = node
        for axis in range(3):
            bounds[node, 0, axis] = np.inf
            bounds[node, 1, axis] = -np.inf
            middle_low[axis] = np.inf
            middle_high[axis] = -np.inf
        for i in range(begin, end):
            face = order[i]
            for axis in range(3):
                a = lows[face, axis]
                b = highs[face, axis]
                bounds[node, 0, axis] = min(bounds[node, 0, axis], a)
                bounds[node, 1, axis] = max(bounds[node, 1, axis], b)
                m = 0.5 * a + 0.5 * b
                middle_low[axis] = min(middle_low[axis], m)
                middle_high[axis] = max(middle_high[axis], m)
        right[node] = 0
        first[node] = begin
        count[node] = end - begin
        if end - begin <= LEAF_SIZE:
            continue

        best_axis = -1
        best_bin = 0
        best_cost = np.inf
        if depth < _HALVING_DEPTH:
            bin_count[:] = 0
            bin_low[:] = np.inf
            bin_high[:] = -np.inf
            for i in range(begin, end):
                face = order[i]
                for axis in range(3):
                    extent = middle_high[axis] - middle_low[axis]
                    if extent > 0.0:
                        m = 0.5 * lows[face, axis] + 0.5 * highs[face, axis]
                        b = min(BINS - 1, int(BINS * ((m - middle_low[axis]) / extent)))
                        bin_count[axis, b] += 1
                        for k in range(3):
                            bin_low[axis, b, k] = min(bin_low[axis, b, k], lows[face, k])
                            bin_high[axis, b, k] = max(bin_high[axis, b, k], highs[face, k])
            for axis in range(3):
                if not middle_high[axis] > middle_low[axis]:
                    continue
                low[:] = np.inf
                high[:] = -np.inf
                for b in range(BINS - 1, 0, -1):
                    for k in range(3):
                        low[k] = min(low[k], bin_low[axis, b, k])
                        high[k] = max(high[k], bin_high[axis, b, k])
                    x, y, z = high[0] - low[0], high[1] - low[1], high[2] - low[2]
                    right_area[b] = x * y + y * z + z * x
                low[:] = np.inf
                high[:] = -np.inf
                left = 0
                for b in range(BINS - 1):
                    left += bin_count[axis, b]
                    for k in range(3):
                        low[k] = min(low[k], bin_low[axis, b, k])
                        high[k] = max(high[k], bin_high[axis, b, k])
                    if left == 0 or left == end - begin:
                        continue
                    x, y, z = high[0] - low[0], high[1] - low[1], high[2] - low[2]
                    cost = (x * y + y * z + z * x) * left + right_area[b + 1] * (end - begin - left)
                    if cost < best_cost:
                        best_cost = cost
                        best_axis = axis
                        best_bin = b
        split = begin + (end - begin) // 2
        if best_axis >= 0:
            extent = middle_high[best_axis] - middle_low[best_axis]
            i = begin
            j = end - 1
            while i <= j:
                face = order[i]
                m = 0.5 * lows[face, best_axis] + 0.5 * highs[face, best_axis]
                b = min(BINS - 1, int(BINS * ((m - middle_low[best_axis]) / extent)))
                if b <= best_bin:
                    i += 1
                else:
                    order[i] = order[j]
                    order[j] = face
                    j -= 1
            split = i
        count[node] = 0
        # The left child is pushed last, hence made next: preorder.
        stack[size, 0], stack[size, 1], stack[size, 2], stack[size, 3] = split, end, node, depth + 1
        stack[size + 1, 0], stack[size + 1, 1], stack[size + 1, 2], stack[size + 1, 3] = (begin, split, -1, depth + 1)
        size += 2
    return nodes


def build(corners: np.ndarray) -> Tree:
    """Build the tree over triangles `corners` (F, 3, 3) float64; an empty scene gets no node.

    Faces without area are left out: no ray meets them, but rounding lets some that are aimed at three points of a line.
    """
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    order = np.flatnonzero(normals.any(axis=1)).astype(np.int32)
    faces = len(order)
    most = max(1, 2 * faces)
    bounds = np.empty((most, 2, 3))
    right, first, count = (np.zeros(most, np.int32) for _ in range(3))
    nodes = 0
    if faces:
        lows = np.ascontiguousarray(corners.min(axis=1))
        highs = np.ascontiguousarray(corners.max(axis=1))
        nodes = _build(lows, highs, bounds, right, first, count, order)
    bounds = bounds[:nodes].copy()
    right, first, count = right[:nodes].copy(), first[:nodes].copy(), count[:nodes].copy()
    wide = bvh8.empty()
    if simd.available():
        wide = bvh8.collapse(corners, bounds, right, first, count, order)
    few = order if simd.available() else order[:0]
    polygons = polygons_of(corners, few, wide.center, wide.scale)
    return Tree(bounds, right, first, count, order, wide, polygons)


def bytes_of(tree: Tree) -> int:
    """Memory of the tree's arrays."""
    arrays = (*tree, *tree.bvh8, *tree.polygons)
    return sum(array.nbytes for array in arrays if isinstance(array, np.ndarray))
