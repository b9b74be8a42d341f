"""Descent of the tree of 8 children: one ray against 8 boxes, or 8 triangles, at a time.

Boxes are tested in float32 in the tree's coordinates, `enter = max over axes of (near plane - o) / d`, with both planes
moved outwards by 2^-21 R, R being the largest coordinate distance between the ray's origin and the scene. That is 8
roundings of the largest number in the test, more than all its errors together (the origin's, the reciprocal's, the
product's, the sum's) and those of the float64 triangle test, so no triangle is missed; and the signs of the
direction, not a minimum, choose the near planes (Ize, "Robust BVH Ray Traversal", JCGT 2(2), 2013).

Triangles are tested in float64 by the expressions of `intersect_triangle`, so that a lane has its bits: face and
distance are those of the binary tree, ties included.
"""

import math
from typing import NamedTuple

import numpy as np

from termwise.renderer.geometry.bvh8 import DEEPEST, FACES, HIGH, LEAF, LINKS, NODE, Bvh8
from termwise.renderer.geometry.intersect import EDGE_SLACK, FaceRange, Hit, Ray, component
from termwise.renderer.geometry.simd import (
    as_int,
    bits,
    choose,
    compress,
    count_bits,
    extract,
    fma,
    highest_bit,
    load,
    load_int,
    load_ints,
    lowest_bit,
    magnitude,
    maximum,
    minimum,
    numbers,
    size_of,
    smallest,
    splat,
    store,
    widen,
)
from termwise.renderer.jit import device
from termwise.renderer.vector import entry

# Entries of the stack from here on are nodes, their distances, and before both what a packet needs beside.
NODES, KEYS = DEEPEST, 2 * DEEPEST
PAD = 2.0**-21
MAX_INVERSE = 2.0**60
# Rounded up by this much, a distance in float32 is not less than in float64.
ROUND_UP = 1.0 + 2.0**-22
DISTANCE_BITS = np.int32(-8)  # the last 3 bits of a distance make room for a lane
NEVER = np.int32(0x7FFFFFFF)
_ZERO = np.float32(0.0)


class Slabs(NamedTuple):
    """A ray for 8 boxes: `t = plane * inverse + near` (or far), t in units of the largest component of direction.

    `x, y, z` are the entries of a node where its near planes begin; `speed` is what t grows by in a unit of the ray's.
    """

    inverse_x: np.float32
    inverse_y: np.float32
    inverse_z: np.float32
    near_x: np.float32
    near_y: np.float32
    near_z: np.float32
    far_x: np.float32
    far_y: np.float32
    far_z: np.float32
    x: int
    y: int
    z: int
    speed: float


@device
def _clamped(inverse: float) -> float:
    """A finite reciprocal: no inf - inf for rays that lie in a plane, and an error far below the padding."""
    return math.copysign(min(abs(inverse), MAX_INVERSE), inverse)


@device
def _slabs(wide: Bvh8, ray: Ray) -> Slabs:
    largest = abs(component(ray.direction, ray.kz))
    ix = _clamped(ray.inverse.x * largest)
    iy = _clamped(ray.inverse.y * largest)
    iz = _clamped(ray.inverse.z * largest)
    ox = (ray.origin.x - wide.center.x) * wide.scale
    oy = (ray.origin.y - wide.center.y) * wide.scale
    oz = (ray.origin.z - wide.center.z) * wide.scale
    pad = PAD * (1.0 + max(abs(ox), max(abs(oy), abs(oz))))
    px = math.copysign(pad, ix)
    py = math.copysign(pad, iy)
    pz = math.copysign(pad, iz)
    return Slabs(
        np.float32(ix),
        np.float32(iy),
        np.float32(iz),
        np.float32(-(ox + px) * ix),
        np.float32(-(oy + py) * iy),
        np.float32(-(oz + pz) * iz),
        np.float32(-(ox - px) * ix),
        np.float32(-(oy - py) * iy),
        np.float32(-(oz - pz) * iz),
        0 if ix > 0.0 else HIGH,
        8 if iy > 0.0 else HIGH + 8,
        16 if iz > 0.0 else HIGH + 16,
        wide.scale * largest * ROUND_UP,
    )


class Boxes(NamedTuple):
    """`Slabs` in all lanes: `inverse`, `near`, `far` are (x, y, z)."""

    inverse: tuple
    near: tuple
    far: tuple


class Shear(NamedTuple):
    """Origin and shear of a ray along its axes kx, ky, kz, in all lanes, and the entries where a leaf's axes begin."""

    origin: tuple
    shear: tuple
    kx: int
    ky: int
    kz: int


class Triangles(NamedTuple):
    """Scaled edge functions and depths of 8 triangles, and which of them the ray's line meets."""

    u: int
    v: int
    w: int
    az: int
    bz: int
    cz: int
    det: int
    inside: int


@device
def _boxes(s: Slabs) -> Boxes:
    return Boxes(
        (splat(s.inverse_x, 8), splat(s.inverse_y, 8), splat(s.inverse_z, 8)),
        (splat(s.near_x, 8), splat(s.near_y, 8), splat(s.near_z, 8)),
        (splat(s.far_x, 8), splat(s.far_y, 8), splat(s.far_z, 8)),
    )


@device
def _enter(nodes: np.ndarray, node: int, s: Slabs, b: Boxes) -> int:
    """Distance at which the ray enters each of a node's 8 boxes, at least 0."""
    start = node * NODE
    return maximum(
        maximum(
            fma(load(nodes, start + s.x, 8), b.inverse[0], b.near[0]),
            fma(load(nodes, start + s.y, 8), b.inverse[1], b.near[1]),
        ),
        maximum(fma(load(nodes, start + s.z, 8), b.inverse[2], b.near[2]), splat(_ZERO, 8)),
    )


@device
def _leave(nodes: np.ndarray, node: int, s: Slabs, b: Boxes, reach: int) -> int:
    """Distance at which it leaves them, at most `reach`."""
    start = node * NODE
    return minimum(
        minimum(
            fma(load(nodes, start + HIGH - s.x, 8), b.inverse[0], b.far[0]),
            fma(load(nodes, start + HIGH + 16 - s.y, 8), b.inverse[1], b.far[1]),
        ),
        minimum(fma(load(nodes, start + HIGH + 32 - s.z, 8), b.inverse[2], b.far[2]), reach),
    )


@device
def shear_of(ray: Ray) -> Shear:
    """The ray for 8 triangles."""
    return Shear(
        (
            splat(component(ray.origin, ray.kx), 8),
            splat(component(ray.origin, ray.ky), 8),
            splat(component(ray.origin, ray.kz), 8),
        ),
        (splat(ray.sx, 8), splat(ray.sy, 8), splat(ray.sz, 8)),
        8 * ray.kx,
        8 * ray.ky,
        8 * ray.kz,
    )


@device
def triangles_of(leaves: np.ndarray, leaf: int, s: Shear) -> Triangles:
    """`edges` of the 8 triangles of a leaf."""
    a = leaf * LEAF
    b = a + 24
    c = b + 24
    return edges(
        (widen(load(leaves, a + s.kx, 8)), widen(load(leaves, a + s.ky, 8)), widen(load(leaves, a + s.kz, 8))),
        (widen(load(leaves, b + s.kx, 8)), widen(load(leaves, b + s.ky, 8)), widen(load(leaves, b + s.kz, 8))),
        (widen(load(leaves, c + s.kx, 8)), widen(load(leaves, c + s.ky, 8)), widen(load(leaves, c + s.kz, 8))),
        s,
    )


@device
def edges(a: tuple, b: tuple, c: tuple, s: Shear) -> Triangles:
    """`intersect_triangle` in 8 lanes, as far as the signs of the edge functions; corners are (kx, ky, kz)."""
    az = a[2] - s.origin[2]
    bz = b[2] - s.origin[2]
    cz = c[2] - s.origin[2]
    ax = a[0] - s.origin[0] - s.shear[0] * az
    ay = a[1] - s.origin[1] - s.shear[1] * az
    bx = b[0] - s.origin[0] - s.shear[0] * bz
    by = b[1] - s.origin[1] - s.shear[1] * bz
    cx = c[0] - s.origin[0] - s.shear[0] * cz
    cy = c[1] - s.origin[1] - s.shear[1] * cz
    u = cx * by - cy * bx
    v = ax * cy - ay * cx
    w = bx * ay - by * ax
    det = u + v + w
    slack = splat(EDGE_SLACK, 8) * magnitude(det)
    zero = splat(0.0, 8)
    one_sign = (minimum(minimum(u, v), w) + slack >= zero) | (maximum(maximum(u, v), w) - slack <= zero)
    return Triangles(u, v, w, az, bz, cz, det, one_sign & (det != zero))


@device
def depths(s: Shear, hit: Triangles) -> int:
    """Distances of 8 hits, times det."""
    return (hit.u * hit.az + hit.v * hit.bz + hit.w * hit.cz) * s.shear[2]


@device
def distances(s: Shear, hit: Triangles, scale: int) -> int:
    """Distances of 8 hits, `scale` being 1 / det."""
    return depths(s, hit) * scale


@device
def face_of(leaves: np.ndarray, leaf: int, lane: int) -> int:
    """Face of a leaf's triangle."""
    return load_int(leaves, (leaf * LEAF + FACES) * (size_of(leaves) // 4) + lane)


@device
def closest_hit(wide: Bvh8, ray: Ray, far: float, ignore: FaceRange, stack: np.ndarray) -> Hit:
    """Nearest hit at 0 < t <= far on any face but those of `ignore`; `stack` is int32 scratch of STACK_SIZE."""
    best = Hit(far, -1, 0.0, 0.0)
    if len(wide.nodes) == 0:
        return best
    slabs = _slabs(wide, ray)
    boxes = _boxes(slabs)
    shear = shear_of(ray)
    reach = splat(np.float32(far * slabs.speed), 8)
    size = 0
    node = 0
    while True:
        if node >= 0:
            enter = _enter(wide.nodes, node, slabs, boxes)
            met = enter <= _leave(wide.nodes, node, slabs, boxes, reach)
            lanes = bits(met)
            if lanes != 0:
                links = node * NODE + LINKS
                lane = lowest_bit(lanes)
                if lanes & (lanes - 1) != 0:
                    # The nearest is entered, the rest are pushed as they lie, without a branch for each: sorting
                    # them saves fewer nodes than it costs (measured).
                    keys = (as_int(enter) & splat(DISTANCE_BITS, 8)) | numbers(8)
                    nearest = smallest(choose(met, keys, splat(NEVER, 8)))
                    lane = np.int64(nearest) & 7
                    rest = met & (keys != splat(nearest, 8))
                    store(stack, KEYS + size, compress(keys, rest))
                    store(stack, NODES + size, compress(load_ints(wide.nodes, links, 8), rest))
                    size += count_bits(lanes) - 1
                node = load_int(wide.nodes, links + lane)
                continue
        else:
            leaf = -1 - node
            triangles = triangles_of(wide.leaves, leaf, shear)
            if bits(triangles.inside) != 0:
                scale = splat(1.0, 8) / triangles.det
                t = distances(shear, triangles, scale)
                lanes = bits(triangles.inside & (t > splat(0.0, 8)) & (t <= splat(best.t, 8)))
                while lanes != 0:
                    lane = lowest_bit(lanes)
                    lanes &= lanes - 1
                    distance = extract(t, lane)
                    face = face_of(wide.leaves, leaf, lane)
                    if (face < ignore.first or face >= ignore.end) and (
                        distance < best.t or (distance == best.t and (best.face < 0 or face < best.face))
                    ):
                        b1 = extract(triangles.v, lane) * extract(scale, lane)
                        b2 = extract(triangles.w, lane) * extract(scale, lane)
                        best = Hit(distance, face, b1, b2)
                        reach = splat(np.float32(distance * slabs.speed), 8)
        while True:
            if size == 0:
                return best
            size -= 1
            if stack[KEYS + size] & DISTANCE_BITS <= extract(as_int(reach), 0):
                break
        node = entry(stack, NODES + size)


@device
def any_hit(wide: Bvh8, ray: Ray, far: float, ignore: FaceRange, target: int, stack: np.ndarray) -> bool:
    """Whether a face other than `target` and those of `ignore` is hit at 0 < t < far."""
    if len(wide.nodes) == 0:
        return False
    slabs = _slabs(wide, ray)
    boxes = _boxes(slabs)
    shear = shear_of(ray)
    reach = splat(np.float32(far * slabs.speed), 8)
    size = 0
    node = 0
    while True:
        if node >= 0:
            met = _enter(wide.nodes, node, slabs, boxes) <= _leave(wide.nodes, node, slabs, boxes, reach)
            lanes = bits(met)
            if lanes != 0:
                # The last is entered at once, which waits for no store; the next store writes over it.
                links = node * NODE + LINKS
                store(stack, size, compress(load_ints(wide.nodes, links, 8), met))
                size += count_bits(lanes) - 1
                node = load_int(wide.nodes, links + highest_bit(lanes))
                continue
        else:
            leaf = -1 - node
            triangles = triangles_of(wide.leaves, leaf, shear)
            if bits(triangles.inside) != 0:
                t = distances(shear, triangles, splat(1.0, 8) / triangles.det)
                lanes = bits(triangles.inside & (t > splat(0.0, 8)) & (t < splat(far, 8)))
                while lanes != 0:
                    face = face_of(wide.leaves, leaf, lowest_bit(lanes))
                    lanes &= lanes - 1
                    if (face < ignore.first or face >= ignore.end) and face != target:
                        return True
        if size == 0:
            return False
        size -= 1
        node = entry(stack, size)
