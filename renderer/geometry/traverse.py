"""`closest_hit` and `any_hit`: depth-first descent of the tree, nearer child first.

A box is entered where its three slabs overlap on (0, far]. The slab test compares and keeps, so that the NaN of a ray
lying in a slab plane is passed over: a plain min/max test misses half of the axis-aligned rays that start in one. Its
planes are moved outwards by 2^-48 of the largest coordinate distance from the ray's origin to the box, 32 roundings of
the largest number in the tests of the box and of its triangles; a widening of far by a few ulp (Ize, "Robust BVH Ray
Traversal", JCGT 2(2), 2013) is not enough for rays aimed at edges: 1 in 100 of them then met another face than a test
of all faces, one ulp further, as the nearer one's box began an ulp behind its triangle.
Of two faces at the same distance the lower index is hit, whatever the order of descent.

This is the reference of the descent with 8 children (`bvh8_traverse`), which must meet the same faces, and what runs
where vectors are not available; callers take either from `rays`.
"""

import math

import numpy as np

from termwise.renderer.geometry.bvh import Tree
from termwise.renderer.geometry.intersect import FaceRange, Hit, Ray, intersect_triangle
from termwise.renderer.jit import device
from termwise.renderer.vector import entry

_SLACK = 2.0**-48


@device
def _enter(bounds: np.ndarray, node: int, ray: Ray, far: float) -> float:
    """Distance at which the ray enters a box, inf where it misses it."""
    sx = 1 if ray.inverse.x < 0.0 else 0
    sy = 1 if ray.inverse.y < 0.0 else 0
    sz = 1 if ray.inverse.z < 0.0 else 0
    near_x = bounds[node, sx, 0] - ray.origin.x
    near_y = bounds[node, sy, 1] - ray.origin.y
    near_z = bounds[node, sz, 2] - ray.origin.z
    far_x = bounds[node, 1 - sx, 0] - ray.origin.x
    far_y = bounds[node, 1 - sy, 1] - ray.origin.y
    far_z = bounds[node, 1 - sz, 2] - ray.origin.z
    slack = _SLACK * max(max(max(abs(near_x), abs(far_x)), max(abs(near_y), abs(far_y))), max(abs(near_z), abs(far_z)))
    x = math.copysign(slack, ray.inverse.x)
    y = math.copysign(slack, ray.inverse.y)
    z = math.copysign(slack, ray.inverse.z)
    near = 0.0
    t = (near_x - x) * ray.inverse.x
    near = t if t > near else near
    t = (near_y - y) * ray.inverse.y
    near = t if t > near else near
    t = (near_z - z) * ray.inverse.z
    near = t if t > near else near
    t = (far_x + x) * ray.inverse.x
    far = t if t < far else far
    t = (far_y + y) * ray.inverse.y
    far = t if t < far else far
    t = (far_z + z) * ray.inverse.z
    far = t if t < far else far
    return near if near <= far else math.inf


@device
def closest_hit(corners: np.ndarray, tree: Tree, ray: Ray, far: float, ignore: FaceRange, stack: np.ndarray) -> Hit:
    """Nearest hit at 0 < t <= far on any face but those of `ignore`; `stack` is int32 scratch of STACK_SIZE."""
    best = Hit(far, -1, 0.0, 0.0)
    if len(tree.right) == 0:
        return best
    size = 0
    node = 0
    if _enter(tree.bounds, 0, ray, far) == math.inf:
        return best
    while True:
        if tree.count[node] > 0:
            for i in range(tree.first[node], tree.first[node] + tree.count[node]):
                face = entry(tree.order, i)
                if face < ignore.first or face >= ignore.end:
                    hit = intersect_triangle(ray, corners, face, best.t)
                    if hit.face >= 0 and (hit.t < best.t or best.face < 0 or face < best.face):
                        best = hit
        else:
            left = node + 1
            right = entry(tree.right, node)
            enter_left = _enter(tree.bounds, left, ray, best.t)
            enter_right = _enter(tree.bounds, right, ray, best.t)
            if enter_left < math.inf:
                if enter_right < math.inf:
                    if enter_left <= enter_right:
                        stack[size] = right
                        node = left
                    else:
                        stack[size] = left
                        node = right
                    size += 1
                else:
                    node = left
                continue
            if enter_right < math.inf:
                node = right
                continue
        if size == 0:
            return best
        size -= 1
        node = entry(stack, size)


@device
def any_hit(
    corners: np.ndarray, tree: Tree, ray: Ray, far: float, ignore: FaceRange, target: int, stack: np.ndarray
) -> bool:
    """Whether a face other than `target` and those of `ignore` is hit at 0 < t < far."""
    if len(tree.right) == 0 or _enter(tree.bounds, 0, ray, far) == math.inf:
        return False
    size = 0
    node = 0
    while True:
        if tree.count[node] > 0:
            for i in range(tree.first[node], tree.first[node] + tree.count[node]):
                face = entry(tree.order, i)
                if (face < ignore.first or face >= ignore.end) and face != target:
                    hit = intersect_triangle(ray, corners, face, far)
                    if hit.face >= 0 and hit.t < far:
                        return True
        else:
            left = node + 1
            right = entry(tree.right, node)
            enter_left = _enter(tree.bounds, left, ray, far) < math.inf
            enter_right = _enter(tree.bounds, right, ray, far) < math.inf
            if enter_left:
                if enter_right:
                    stack[size] = right
                    size += 1
                node = left
                continue
            if enter_right:
                node = right
                continue
        if size == 0:
            return False
        size -= 1
        node = entry(stack, size)
