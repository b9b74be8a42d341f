"""Rays of a wave that go the same way, descended together: by a frustum, then 16 at a time in float32.

A packet's rays have one main axis k_z. Seen along it, and from a point c beside their origins, ray i is at depth z at
`x = h_x + s_x z`, `y = h_y + s_y z`; all of them lie between the planes `x = min o_x + min s_x z` and
`x = max o_x + max s_x z`, and so in y. One test of these planes passes 8 boxes of a node by, or 8 triangles of a leaf;
each box that it leaves is tested against 16 rays at a time, and goes onto the stack with those that it may hold. So is
each triangle, and what a ray may hit in float32 is tested in float64, by the expressions of `intersect_triangle`; where
few rays come to a leaf, each is tested so against all of its triangles. Faces and distances have the bits of single
rays, in whatever company they come.

Planes and boxes are padded by `2^-20 R`, R being the largest coordinate distance between the origins and the scene: 16
roundings of the largest number of a test. A corner of a triangle is `a_x - h_x - s_x a_z` as a ray sees it. With
u = 2^-24, A the largest coordinate of the leaf and H that of the origins, both seen from c, float32 errs in it by less
than `E = 6 u (A + 2 H)`. Of a ray that hits, all corners lie nearer than T, the triangle's extent, and an edge function
of theirs errs by less than `E (8 T + 4 E)`, the slack of `intersect_triangle` and the errors of float64 included.
"""

from typing import NamedTuple

import numpy as np

from termwise.renderer.geometry.bvh8 import FACES, HIGH, LEAF, LINKS, NODE, Bvh8
from termwise.renderer.geometry.bvh8_traverse import PAD, ROUND_UP, Shear, distances, edges, face_of
from termwise.renderer.geometry.intersect import component
from termwise.renderer.geometry.polygons import first_bits
from termwise.renderer.geometry.simd import (
    bits,
    choose,
    count_bits,
    fma,
    fms,
    highest,
    load,
    load_int,
    load_ints,
    lowest,
    lowest_bit,
    magnitude,
    maximum,
    minimum,
    narrow,
    negative,
    numbers,
    size_of,
    splat,
    store,
    widen,
)
from termwise.renderer.geometry.streams import fetch_leaf, fetch_node, is_hidden, leaf_of_ray, put_nearest
from termwise.renderer.geometry.wave import SIZE, Wave
from termwise.renderer.jit import device
from termwise.renderer.vector import entry

MOST_BACKOFF = 256  # see `wave.BACKOFF`
# A packet gives up where, after so many nodes and leaves, fewer rays than so many share one: then a stream is faster.
_SOON, _COMPANY = 64, 6
# Up to so many rays meet a leaf one by one, each all of its triangles.
_FEW = 4
_LANES = 16
_ALL = (1 << _LANES) - 1
_UNIT = 2.0**-24
# Rows of `wave.scaled`: lines of the rays and how far they reach; then the boxes, or triangles, at hand.
_H_X, _H_Y, _S_X, _S_Y, _REACH, _AT_HAND = 0, SIZE, 2 * SIZE, 3 * SIZE, 4 * SIZE, 5 * SIZE
# Beyond these float32 overflows, or lacks numbers, in products of two lengths.
_SMALLEST, _LARGEST = 2.0**-40, 2.0**40
_FAR_AWAY = 2.0**20
_SHORTEST = 2.0**-900  # of a direction whose reciprocal is no infinity


class Packet(NamedTuple):
    """The frustum of rays, whose lines are in `wave.scaled`, in world coordinates seen from c, along kx, ky, kz.

    `rays` are those that are in it, as bits; where none is, nothing else is meant. Sides are those at depth 0, where
    rays begin, `front` and `back` the range of that, both padded; (x, y, z) is c, and `spread` 2 H; `unit` is the
    length of 1 in the tree's coordinates, and (center_x, ...) its center.
    """

    rays: int
    kx: int
    ky: int
    kz: int
    forward: bool
    left: np.float32
    right: np.float32
    bottom: np.float32
    top: np.float32
    front: np.float32
    back: np.float32
    left_slope: np.float32
    right_slope: np.float32
    bottom_slope: np.float32
    top_slope: np.float32
    x: float
    y: float
    z: float
    spread: np.float32
    pad: np.float32
    unit: np.float32
    center_x: np.float32
    center_y: np.float32
    center_z: np.float32


@device
def _make_packet(wide: Bvh8, wave: Wave, left: int, count: int, far: float) -> Packet:
    """Make a packet of those eights of `left`, among the first `count` rays, that go the way of the first ray left."""
    first = lowest_bit(left)
    # As `make_ray` chooses: the first axis of the largest component.
    kz = 0
    if abs(wave.directions[1, first]) > abs(wave.directions[0, first]):
        kz = 1
    if abs(wave.directions[2, first]) > abs(wave.directions[kz, first]):
        kz = 2
    forward = wave.directions[kz, first] > 0.0
    kx = (kz + 1) % 3
    ky = (kx + 1) % 3
    if not forward:
        kx, ky = ky, kx
    x = np.float64(np.float32(wave.origins[kx, first]))
    y = np.float64(np.float32(wave.origins[ky, first]))
    z = np.float64(np.float32(wave.origins[kz, first]))
    sign = splat(1.0 if forward else -1.0, 8)
    most, least = splat(np.inf, 8), splat(-np.inf, 8)
    ox0, oy0, oz0, sx0, sy0 = most, most, most, most, most
    ox1, oy1, oz1, sx1, sy1 = least, least, least, least, least
    rays = 0
    for k in range(0, SIZE, 8):
        store(wave.scaled, _REACH + k, splat(np.float32(-1.0), 8))
        if (left >> k) & 255 == 0:
            continue
        dx = load(wave.directions, kx * SIZE + k, 8)
        dy = load(wave.directions, ky * SIZE + k, 8)
        dz = load(wave.directions, kz * SIZE + k, 8)
        ox = load(wave.origins, kx * SIZE + k, 8)
        oy = load(wave.origins, ky * SIZE + k, 8)
        oz = load(wave.origins, kz * SIZE + k, 8)
        # Lanes behind the last ray are the first one, and reach nowhere.
        some = numbers(8) < splat(np.int32(count - k), 8)
        dx = choose(some, dx, splat(wave.directions[kx, first], 8))
        dy = choose(some, dy, splat(wave.directions[ky, first], 8))
        dz = choose(some, dz, splat(wave.directions[kz, first], 8))
        ox, oy, oz = choose(some, ox, splat(x, 8)), choose(some, oy, splat(y, 8)), choose(some, oz, splat(z, 8))
        depth = magnitude(dz)
        # Of two as large the first: the axes before kz must be less.
        main = (depth >= magnitude(dx)) & (depth >= magnitude(dy)) & (dz * sign > splat(_SHORTEST, 8))
        if kz > 0:
            main = main & (depth > magnitude(dx if kx == 0 else dy))
        if kz > 1:
            main = main & (depth > magnitude(dx if kx == 1 else dy))
        if bits(main) != 255:
            continue
        rays |= 255 << k
        # As `make_ray` has them, for `_meet`.
        sx, sy = dx / dz, dy / dz
        store(wave.shears, k, ox)
        store(wave.shears, SIZE + k, oy)
        store(wave.shears, 2 * SIZE + k, oz)
        store(wave.shears, 3 * SIZE + k, sx)
        store(wave.shears, 4 * SIZE + k, sy)
        store(wave.shears, 5 * SIZE + k, splat(1.0, 8) / dz)
        store(wave.axes, 3 * SIZE + k, splat(np.int32(kx), 8))
        store(wave.axes, 4 * SIZE + k, splat(np.int32(ky), 8))
        store(wave.axes, 5 * SIZE + k, splat(np.int32(kz), 8))
        aside = oz - splat(z, 8)
        store(wave.scaled, _H_X + k, narrow(ox - splat(x, 8) - sx * aside))
        store(wave.scaled, _H_Y + k, narrow(oy - splat(y, 8) - sy * aside))
        store(wave.scaled, _S_X + k, narrow(sx))
        store(wave.scaled, _S_Y + k, narrow(sy))
        reach = narrow(splat(far * ROUND_UP, 8) * depth)
        store(wave.scaled, _REACH + k, choose(some, reach, splat(np.float32(-1.0), 8)))
        sx, sy = sx * sign, sy * sign
        ox0, oy0, oz0, sx0, sy0 = (
            minimum(ox, ox0),
            minimum(oy, oy0),
            minimum(oz, oz0),
            minimum(sx, sx0),
            minimum(sy, sy0),
        )
        ox1, oy1, oz1, sx1, sy1 = (
            maximum(ox, ox1),
            maximum(oy, oy1),
            maximum(oz, oz1),
            maximum(sx, sx1),
            maximum(sy, sy1),
        )
    left, right = lowest(ox0), highest(ox1)
    bottom, top = lowest(oy0), highest(oy1)
    low, high = lowest(oz0), highest(oz1)
    cx, cy, cz = component(wide.center, kx), component(wide.center, ky), component(wide.center, kz)
    largest = max(max(abs(left - cx), abs(right - cx)), max(abs(bottom - cy), abs(top - cy)))
    largest = max(largest, max(abs(low - cz), abs(high - cz)))
    spread = max(max(max(x - left, right - x), max(y - bottom, top - y)), max(z - low, high - z))
    pad = 2.0 * PAD * (largest + 1.0 / wide.scale)
    # Bounds do not know of a NaN, which c may be.
    held = abs(x - cx) + abs(y - cy) + abs(z - cz) + largest < _FAR_AWAY / wide.scale
    held = held and _SMALLEST < wide.scale < _LARGEST
    return Packet(
        rays & first_bits(count) if held else 0,
        8 * kx,
        8 * ky,
        8 * kz,
        forward,
        np.float32(left - pad - x),
        np.float32(right + pad - x),
        np.float32(bottom - pad - y),
        np.float32(top + pad - y),
        np.float32(high + pad - z if forward else low - pad - z),
        np.float32(low - pad - z if forward else high + pad - z),
        np.float32(lowest(sx0)),
        np.float32(highest(sx1)),
        np.float32(lowest(sy0)),
        np.float32(highest(sy1)),
        x,
        y,
        z,
        np.float32(2.0 * spread),
        np.float32(2.0 * pad),
        np.float32(1.0 / wide.scale),
        np.float32(cx - x),
        np.float32(cy - y),
        np.float32(cz - z),
    )


@device
def _cut(p: Packet, low: tuple, high: tuple, reach: int) -> tuple:
    """Depths (at least 0) where 8 boxes begin, and which of them the frustum may meet before `reach`."""
    sign = splat(np.float32(1.0 if p.forward else -1.0), 8)
    enter = maximum(((low[2] if p.forward else high[2]) - splat(p.front, 8)) * sign, splat(np.float32(0.0), 8))
    leave = ((high[2] if p.forward else low[2]) - splat(p.back, 8)) * sign
    # A side recedes furthest where the box ends if its slope leads outwards, else where it begins.
    met = (enter <= minimum(leave, reach)) & (
        low[0] <= fma(splat(p.right_slope, 8), leave if p.right_slope > 0.0 else enter, splat(p.right, 8))
    )
    met = met & (high[0] >= fma(splat(p.left_slope, 8), enter if p.left_slope > 0.0 else leave, splat(p.left, 8)))
    met = met & (low[1] <= fma(splat(p.top_slope, 8), leave if p.top_slope > 0.0 else enter, splat(p.top, 8)))
    met = met & (high[1] >= fma(splat(p.bottom_slope, 8), enter if p.bottom_slope > 0.0 else leave, splat(p.bottom, 8)))
    return enter, met


@device
def _planes(nodes: np.ndarray, start: int, p: Packet) -> tuple:
    """Planes of 8 boxes along an axis each, seen from c."""
    unit = splat(p.unit, 8)
    return (
        fma(load(nodes, start + p.kx, 8), unit, splat(p.center_x, 8)),
        fma(load(nodes, start + p.ky, 8), unit, splat(p.center_y, 8)),
        fma(load(nodes, start + p.kz, 8), unit, splat(p.center_z, 8)),
    )


@device
def _within(wave: Wave, lane: int, rays: int) -> int:
    """Which of the rays the box at hand may hold, as bits."""
    s = wave.scaled[0]
    i = _AT_HAND + lane
    x0, x1, y0, y1 = splat(s[i], 16), splat(s[i + 8], 16), splat(s[i + 16], 16), splat(s[i + 24], 16)
    z0, z1 = splat(s[i + 32], 16), splat(s[i + 40], 16)
    found = 0
    for k in range(0, SIZE, _LANES):
        if (rays >> k) & _ALL != 0:
            hx, sx = load(wave.scaled, _H_X + k, 16), load(wave.scaled, _S_X + k, 16)
            hy, sy = load(wave.scaled, _H_Y + k, 16), load(wave.scaled, _S_Y + k, 16)
            xa, xb = fma(sx, z0, hx), fma(sx, z1, hx)
            ya, yb = fma(sy, z0, hy), fma(sy, z1, hy)
            met = (minimum(xa, xb) <= x1) & (maximum(xa, xb) >= x0) & (minimum(ya, yb) <= y1) & (maximum(ya, yb) >= y0)
            found |= bits(met) << k
    return found & rays


@device
def _enter_node(
    wide: Bvh8, p: Packet, wave: Wave, node: int, rays: int, reach: int, stack: np.ndarray, size: int
) -> int:
    """Put a node's boxes that rays may meet onto the stack, the nearest last; the stack's size."""
    low = _planes(wide.nodes, node * NODE, p)
    high = _planes(wide.nodes, node * NODE + HIGH, p)
    enter, met = _cut(p, low, high, reach)
    lanes = bits(met)
    if lanes == 0:
        return size
    pad = splat(p.pad, 8)
    store(wave.scaled, _AT_HAND, low[0] - pad)
    store(wave.scaled, _AT_HAND + 8, high[0] + pad)
    store(wave.scaled, _AT_HAND + 16, low[1] - pad)
    store(wave.scaled, _AT_HAND + 24, high[1] + pad)
    back = splat(p.back, 8)
    store(wave.scaled, _AT_HAND + 32, maximum(low[2], back) if p.forward else low[2])
    store(wave.scaled, _AT_HAND + 40, high[2] if p.forward else minimum(high[2], back))
    store(wave.scaled, _AT_HAND + 48, enter)
    nearest, last = np.float32(np.inf), size
    while lanes != 0:
        lane = lowest_bit(lanes)
        lanes &= lanes - 1
        inside = _within(wave, lane, rays)
        if inside != 0:
            distance = wave.scaled[0, _AT_HAND + 48 + lane]
            wave.keys[size] = distance
            link = load_int(wide.nodes, node * NODE + LINKS + lane)
            if link < 0:
                fetch_leaf(wide.leaves, -1 - link)
            else:
                fetch_node(wide.nodes, link)
            stack[size] = link
            wave.masks[size] = inside
            if distance < nearest:
                nearest, last = distance, size
            size += 1
    if last < size:
        top = size - 1
        wave.keys[last], wave.keys[top] = wave.keys[top], wave.keys[last]
        stack[last], stack[top] = stack[top], stack[last]
        wave.masks[last], wave.masks[top] = wave.masks[top], wave.masks[last]
    return size


@device
def _reaching(wave: Wave, rays: int, distance: np.float32) -> int:
    """Which of the rays go on at a distance, as bits."""
    found = 0
    for k in range(0, SIZE, _LANES):
        found |= bits(load(wave.scaled, _REACH + k, 16) >= splat(distance, 16)) << k
    return found & rays


@device
def _seen(wave: Wave, row: int, leaves: np.ndarray, start: int, c: float) -> tuple:
    """Keep a coordinate of the 3 corners of 8 triangles, seen from c; the least and the greatest of each triangle."""
    a = narrow(widen(load(leaves, start, 8)) - splat(c, 8))
    b = narrow(widen(load(leaves, start + 24, 8)) - splat(c, 8))
    d = narrow(widen(load(leaves, start + 48, 8)) - splat(c, 8))
    store(wave.scaled, row, a)
    store(wave.scaled, row + 24, b)
    store(wave.scaled, row + 48, d)
    return minimum(minimum(a, b), d), maximum(maximum(a, b), d)


@device
def _cut_triangles(wave: Wave, leaves: np.ndarray, leaf: int, p: Packet, reach: int) -> int:
    """Which of a leaf's triangles the frustum may meet, by their own boxes, as bits; all become those at hand."""
    x = _seen(wave, _AT_HAND, leaves, leaf * LEAF + p.kx, p.x)
    y = _seen(wave, _AT_HAND + 8, leaves, leaf * LEAF + p.ky, p.y)
    z = _seen(wave, _AT_HAND + 16, leaves, leaf * LEAF + p.kz, p.z)
    _, met = _cut(p, (x[0], y[0], z[0]), (x[1], y[1], z[1]), reach)
    zero = splat(np.float32(0.0), 8)
    extent = maximum(x[1] - x[0], y[1] - y[0]) + (z[1] - z[0])
    largest = maximum(maximum(maximum(x[1], zero - x[0]), maximum(y[1], zero - y[0])), maximum(z[1], zero - z[0]))
    error = splat(np.float32(6.0 * _UNIT), 8) * (largest + splat(p.spread, 8))
    # Below the least normal number roundings have a size of their own.
    error = fma(
        error,
        fma(splat(np.float32(8.0), 8), extent, splat(np.float32(4.0), 8) * error),
        splat(np.float32(2.0**-120), 8),
    )
    store(wave.scaled, _AT_HAND + 72, error)
    faces = load_ints(leaves, (leaf * LEAF + FACES) * (size_of(leaves) // 4), 8)
    return bits(met & (faces >= splat(np.int32(0), 8)))


@device
def _inside(a: tuple, b: tuple, c: tuple, hx: int, hy: int, sx: int, sy: int, error: int, zero: int) -> int:
    """Which lanes may have a hit: a triangle's corners, and a ray's line."""
    ax, ay = fma(negative(sx), a[2], a[0] - hx), fma(negative(sy), a[2], a[1] - hy)
    bx, by = fma(negative(sx), b[2], b[0] - hx), fma(negative(sy), b[2], b[1] - hy)
    cx, cy = fma(negative(sx), c[2], c[0] - hx), fma(negative(sy), c[2], c[1] - hy)
    u, v, w = fms(cx, by, cy * bx), fms(ax, cy, ay * cx), fms(bx, ay, by * ax)
    met = (minimum(minimum(u, v), w) >= zero - error) | (maximum(maximum(u, v), w) <= error)
    return bits(met)


@device
def _may_hit(wave: Wave, lane: int, rays: int) -> int:
    """Which of the rays may hit a triangle of the leaf at hand, as bits: all that do, and few more."""
    s = wave.scaled[0]
    i = _AT_HAND + lane
    a = splat(s[i], 16), splat(s[i + 8], 16), splat(s[i + 16], 16)
    b = splat(s[i + 24], 16), splat(s[i + 32], 16), splat(s[i + 40], 16)
    c = splat(s[i + 48], 16), splat(s[i + 56], 16), splat(s[i + 64], 16)
    error, zero = splat(s[i + 72], 16), splat(np.float32(0.0), 16)
    found = 0
    for k in range(0, SIZE, _LANES):
        if (rays >> k) & _ALL != 0:
            hx, hy = load(wave.scaled, _H_X + k, 16), load(wave.scaled, _H_Y + k, 16)
            sx, sy = load(wave.scaled, _S_X + k, 16), load(wave.scaled, _S_Y + k, 16)
            found |= _inside(a, b, c, hx, hy, sx, sy, error, zero) << k
    return found & rays


@device
def _corner(leaves: np.ndarray, start: int, p: Packet) -> tuple:
    return (
        splat(np.float64(leaves[start + p.kx]), 8),
        splat(np.float64(leaves[start + p.ky]), 8),
        splat(np.float64(leaves[start + p.kz]), 8),
    )


@device
def _meet(leaves: np.ndarray, leaf: int, lane: int, p: Packet, wave: Wave, k: int, far: float, hides: bool) -> bool:
    """A triangle for rays k ... k + 7, to the last bit: whether it changes anything, which is written to the wave."""
    r = wave.shears
    s = Shear(
        (load(r, k, 8), load(r, SIZE + k, 8), load(r, 2 * SIZE + k, 8)),
        (load(r, 3 * SIZE + k, 8), load(r, 4 * SIZE + k, 8), load(r, 5 * SIZE + k, 8)),
        p.kx,
        p.ky,
        p.kz,
    )
    a = leaf * LEAF + lane
    hit = edges(_corner(leaves, a, p), _corner(leaves, a + 24, p), _corner(leaves, a + 48, p), s)
    this = splat(np.int32(face_of(leaves, leaf, lane)), 8)
    scale = splat(1.0, 8) / hit.det
    t = distances(s, hit, scale)
    best, face = load(wave.t, k, 8), load(wave.face, k, 8)
    met = hit.inside & (t > splat(0.0, 8)) & ((this < load(wave.first, k, 8)) | (this >= load(wave.end, k, 8)))
    if hides:
        met = met & (t < splat(far, 8)) & (this != load(wave.target, k, 8))
        reach = splat(np.float32(-1.0), 8)
    else:
        met = met & (t <= best) & ((t < best) | (face < splat(np.int32(0), 8)) | (this < face))
        reach = narrow(t * magnitude(load(wave.directions, p.kz * (SIZE // 8) + k, 8)) * splat(ROUND_UP, 8))
        store(wave.t, k, choose(met, t, best))
        store(wave.face, k, choose(met, this, face))
        store(wave.b1, k, choose(met, hit.v * scale, load(wave.b1, k, 8)))
        store(wave.b2, k, choose(met, hit.w * scale, load(wave.b2, k, 8)))
    store(wave.scaled, _REACH + k, choose(met, reach, load(wave.scaled, _REACH + k, 8)))
    return bits(met) != 0


@device
def _meet_leaf(wide: Bvh8, leaf: int, p: Packet, wave: Wave, r: int, far: float, hides: bool) -> bool:
    """A leaf's triangles for ray r, to the last bit: whether one changes anything, which is written to the wave."""
    hit, depth, faces, met = leaf_of_ray(wide, wave, r, leaf)
    if hides:
        if not is_hidden(wave, r, hit, depth, faces, met, far):
            return False
        wave.scaled[0, _REACH + r] = np.float32(-1.0)
        return True
    if not put_nearest(wave, r, hit, depth, faces, met):
        return False
    reach = wave.t[r] * abs(wave.directions[p.kz // 8, r]) * ROUND_UP
    wave.scaled[0, _REACH + r] = np.float32(reach)
    return True


@device
def _furthest(wave: Wave) -> int:
    """How far the rays still reach, in all lanes."""
    furthest = load(wave.scaled, _REACH, 16)
    for k in range(_LANES, SIZE, _LANES):
        furthest = maximum(load(wave.scaled, _REACH + k, 16), furthest)
    return splat(highest(furthest), 8)


@device
def _descend(wide: Bvh8, p: Packet, wave: Wave, far: float, hides: bool, stack: np.ndarray) -> bool:
    """Write the nearest hits of a packet, as `closest_hit` gives them, or what `any_hit` finds; False: gave up."""
    rays = p.rays
    for k in range(0, SIZE, 8):
        if (rays >> k) & 255 != 0 and not hides:
            store(wave.t, k, splat(far, 8))
            store(wave.face, k, splat(np.int32(-1), 8))
            store(wave.b1, k, splat(0.0, 8))
            store(wave.b2, k, splat(0.0, 8))
    reach = _furthest(wave)
    node = 0
    size = 0
    work = shared = 0
    while len(wide.nodes) > 0:
        work += 1
        shared += count_bits(rays)
        if work >= _SOON and shared < _COMPANY * work:
            return False
        if node >= 0:
            size = _enter_node(wide, p, wave, node, rays, reach, stack, size)
        else:
            leaf = -1 - node
            changed = False
            if count_bits(rays) <= _FEW:
                while rays != 0:
                    ray = lowest_bit(rays)
                    rays &= rays - 1
                    changed |= _meet_leaf(wide, leaf, p, wave, ray, far, hides)
            else:
                lanes = _cut_triangles(wave, wide.leaves, leaf, p, reach)
                while lanes != 0:
                    lane = lowest_bit(lanes)
                    lanes &= lanes - 1
                    may = _may_hit(wave, lane, rays)
                    while may != 0:
                        k = lowest_bit(may) & 56
                        may &= ~(255 << k)
                        changed |= _meet(wide.leaves, leaf, lane, p, wave, k, far, hides)
            if changed:
                reach = _furthest(wave)
        rays = 0
        while size > 0 and rays == 0:
            size -= 1
            rays = _reaching(wave, wave.masks[size], wave.keys[size])
        if rays == 0:
            break
        node = entry(stack, size)
    if hides:
        for i in range(SIZE):
            if (p.rays >> i) & 1 != 0:
                wave.found[i] = wave.scaled[0, _REACH + i] < np.float32(0.0)
    return True


@device
def hits_of_packets(wide: Bvh8, wave: Wave, count: int, far: float, hides: bool, stack: np.ndarray) -> int:
    """Write what the first `count` rays meet, a packet for each way that eights of them go.

    Which are left, as bits: the eights that do not go one way, and packets that gave up.
    """
    left = first_bits(count)
    rest = 0
    while left != 0:
        packet = _make_packet(wide, wave, left, count, far)
        taken = packet.rays if packet.rays != 0 else left & (255 << (lowest_bit(left) & 56))
        if packet.rays == 0 or not _descend(wide, packet, wave, far, hides, stack):
            rest |= taken
        left &= ~taken
    return rest
