"""Eight rays of a wave that go the same way, descended together inside a frustum.

A packet's rays have one main axis. Seen along this axis k_z, ray i is at depth z at `x = o_x + s_x z`,
`y = o_y + s_y z`; the packet lies between the planes `x = min o_x + min s_x z` and `x = max o_x + max s_x z`, and so in
y, and a box is passed over where it lies outside of one of them: one test of 8 boxes for 8 rays. It pays where
triangles are larger than the packet is wide, and gives up when its work is no longer less than that of the same rays
in a stream.

The planes are padded as `bvh8_traverse` pads boxes, and triangles are tested in float64 by the expressions of
`intersect_triangle`: faces and distances have the bits of single rays, in whatever company they come.
"""

from typing import NamedTuple

import numpy as np

from termwise.renderer.geometry.bvh8 import HIGH, LEAF, LINKS, NODE, Bvh8
from termwise.renderer.geometry.bvh8_traverse import (
    DISTANCE_BITS,
    NEVER,
    NODES,
    PAD,
    ROUND_UP,
    Shear,
    Triangles,
    distances,
    edges,
    face_of,
)
from termwise.renderer.geometry.intersect import component
from termwise.renderer.geometry.simd import (
    as_int,
    bits,
    choose,
    compress,
    count_bits,
    extract,
    fma,
    highest,
    load,
    load_int,
    load_ints,
    lowest,
    lowest_bit,
    magnitude,
    maximum,
    minimum,
    numbers,
    rows,
    smallest,
    splat,
    store,
    widen,
)
from termwise.renderer.geometry.wave import Wave
from termwise.renderer.jit import device
from termwise.renderer.vector import entry

SIZE = 8
MOST_BACKOFF = 256  # see `wave.BACKOFF`
# Nodes, leaves and triangles that a packet may test: with more a stream is faster.
MUCH_WORK = 48


class Packet(NamedTuple):
    """Eight rays (`shear`), the depth that each makes in a unit of its t, and the sides of their frustum.

    `coherent` says whether all have the first ray's main axis and its sign; without it nothing else is meant. Sides
    are scalars in world coordinates along the axes kx, ky, kz: at depth 0, and the slopes.
    """

    coherent: bool
    shear: Shear
    speed: int
    forward: bool
    left: float
    right: float
    bottom: float
    top: float
    front: float
    back: float
    left_slope: float
    right_slope: float
    bottom_slope: float
    top_slope: float


class Frustum(NamedTuple):
    """The sides in all lanes, in float32 for boxes or in float64 for triangles."""

    left: int
    right: int
    bottom: int
    top: int
    front: int
    back: int
    left_slope: int
    right_slope: int
    bottom_slope: int
    top_slope: int
    sign: int


@device
def make_packet(wide: Bvh8, wave: Wave, at: int) -> Packet:
    """Make a packet of 8 rays of a wave, from `at` on."""
    o = rows(wave.origins, at)
    d = rows(wave.directions, at)
    x = magnitude(d[0])
    y = magnitude(d[1])
    z = magnitude(d[2])
    # As `make_ray` chooses: the first axis of the largest component.
    kz = 0
    along, depth = d[0], x
    if extract(y, 0) > extract(depth, 0):
        kz = 1
        along, depth = d[1], y
    if extract(z, 0) > extract(depth, 0):
        kz = 2
        along, depth = d[2], z
    largest = depth >= maximum(x, maximum(y, z))
    if kz > 0:
        largest = largest & (depth > x)
    if kz > 1:
        largest = largest & (depth > y)
    backward = bits(along < splat(0.0, 8))
    coherent = bits(largest) == 255 and (backward == 0 or backward == 255)
    forward = backward == 0
    kx = (kz + 1) % 3
    ky = (kx + 1) % 3
    if not forward:
        kx, ky = ky, kx
    ox = o[0] if kx == 0 else (o[1] if kx == 1 else o[2])
    oy = o[0] if ky == 0 else (o[1] if ky == 1 else o[2])
    oz = o[0] if kz == 0 else (o[1] if kz == 1 else o[2])
    shear_x = (d[0] if kx == 0 else (d[1] if kx == 1 else d[2])) / along
    shear_y = (d[0] if ky == 0 else (d[1] if ky == 1 else d[2])) / along
    shear_z = splat(1.0, 8) / along
    sign = splat(1.0 if forward else -1.0, 8)
    slope_x = shear_x * sign
    slope_y = shear_y * sign
    left, right = lowest(ox), highest(ox)
    bottom, top = lowest(oy), highest(oy)
    low, high = lowest(oz), highest(oz)
    cx, cy, cz = component(wide.center, kx), component(wide.center, ky), component(wide.center, kz)
    reach = max(max(abs(left - cx), abs(right - cx)), max(abs(bottom - cy), abs(top - cy)))
    reach = max(reach, max(abs(low - cz), abs(high - cz)))
    pad = PAD * (reach + 1.0 / wide.scale)
    return Packet(
        coherent,
        Shear((ox, oy, oz), (shear_x, shear_y, shear_z), 8 * kx, 8 * ky, 8 * kz),
        depth,
        forward,
        left - pad,
        right + pad,
        bottom - pad,
        top + pad,
        high + pad if forward else low - pad,
        low - pad if forward else high + pad,
        lowest(slope_x),
        highest(slope_x),
        lowest(slope_y),
        highest(slope_y),
    )


@device
def _frustum_of_boxes(wide: Bvh8, p: Packet) -> Frustum:
    cx = component(wide.center, p.shear.kx // 8)
    cy = component(wide.center, p.shear.ky // 8)
    cz = component(wide.center, p.shear.kz // 8)
    return Frustum(
        splat(np.float32((p.left - cx) * wide.scale), 8),
        splat(np.float32((p.right - cx) * wide.scale), 8),
        splat(np.float32((p.bottom - cy) * wide.scale), 8),
        splat(np.float32((p.top - cy) * wide.scale), 8),
        splat(np.float32((p.front - cz) * wide.scale), 8),
        splat(np.float32((p.back - cz) * wide.scale), 8),
        splat(np.float32(p.left_slope), 8),
        splat(np.float32(p.right_slope), 8),
        splat(np.float32(p.bottom_slope), 8),
        splat(np.float32(p.top_slope), 8),
        splat(np.float32(1.0 if p.forward else -1.0), 8),
    )


@device
def _frustum_of_triangles(p: Packet) -> Frustum:
    return Frustum(
        splat(p.left, 8),
        splat(p.right, 8),
        splat(p.bottom, 8),
        splat(p.top, 8),
        splat(p.front, 8),
        splat(p.back, 8),
        splat(p.left_slope, 8),
        splat(p.right_slope, 8),
        splat(p.bottom_slope, 8),
        splat(p.top_slope, 8),
        splat(1.0 if p.forward else -1.0, 8),
    )


@device
def _cut(p: Packet, f: Frustum, low: tuple, high: tuple, zero: int, reach: int) -> tuple:
    """Depths (at least 0) where 8 boxes begin, and which of them the frustum may meet before `reach`."""
    enter = maximum(((low[2] if p.forward else high[2]) - f.front) * f.sign, zero)
    leave = ((high[2] if p.forward else low[2]) - f.back) * f.sign
    # A side recedes furthest where the box ends if its slope leads outwards, else where it begins.
    met = (enter <= minimum(leave, reach)) & (
        low[0] <= fma(f.right_slope, leave if p.right_slope > 0.0 else enter, f.right)
    )
    met = met & (high[0] >= fma(f.left_slope, enter if p.left_slope > 0.0 else leave, f.left))
    met = met & (low[1] <= fma(f.top_slope, leave if p.top_slope > 0.0 else enter, f.top))
    met = met & (high[1] >= fma(f.bottom_slope, enter if p.bottom_slope > 0.0 else leave, f.bottom))
    return enter, met


@device
def _cut_boxes(nodes: np.ndarray, node: int, p: Packet, f: Frustum, reach: int) -> tuple:
    low = node * NODE
    high = low + HIGH
    return _cut(
        p,
        f,
        (load(nodes, low + p.shear.kx, 8), load(nodes, low + p.shear.ky, 8), load(nodes, low + p.shear.kz, 8)),
        (load(nodes, high + p.shear.kx, 8), load(nodes, high + p.shear.ky, 8), load(nodes, high + p.shear.kz, 8)),
        splat(np.float32(0.0), 8),
        reach,
    )


@device
def _span(leaves: np.ndarray, start: int) -> tuple:
    """Least and greatest coordinate of 8 triangles along an axis."""
    a = widen(load(leaves, start, 8))
    b = widen(load(leaves, start + 24, 8))
    c = widen(load(leaves, start + 48, 8))
    return minimum(minimum(a, b), c), maximum(maximum(a, b), c)


@device
def _cut_triangles(leaves: np.ndarray, leaf: int, p: Packet, f: Frustum, furthest: float) -> int:
    """Which of a leaf's triangles the frustum may meet, by their own boxes, as bits."""
    x = _span(leaves, leaf * LEAF + p.shear.kx)
    y = _span(leaves, leaf * LEAF + p.shear.ky)
    z = _span(leaves, leaf * LEAF + p.shear.kz)
    _, met = _cut(p, f, (x[0], y[0], z[0]), (x[1], y[1], z[1]), splat(0.0, 8), splat(furthest, 8))
    return bits(met)


@device
def _corner(leaves: np.ndarray, start: int, s: Shear) -> tuple:
    return (
        splat(np.float64(leaves[start + s.kx]), 8),
        splat(np.float64(leaves[start + s.ky]), 8),
        splat(np.float64(leaves[start + s.kz]), 8),
    )


@device
def _triangle(leaves: np.ndarray, leaf: int, lane: int, s: Shear) -> Triangles:
    """`edges` of one triangle for 8 rays."""
    a = leaf * LEAF + lane
    return edges(_corner(leaves, a, s), _corner(leaves, a + 24, s), _corner(leaves, a + 48, s), s)


class Hits(NamedTuple):
    """The nearest hits of 8 rays so far, as `Hit` has them."""

    t: int
    face: int
    b1: int
    b2: int


@device
def _nothing(far: float) -> Hits:
    zero = splat(0.0, 8)
    return Hits(splat(far, 8), splat(np.int32(-1), 8), zero, zero)


@device
def _nearer(best: Hits, p: Packet, wave: Wave, at: int, hit: Triangles, face: int) -> tuple[Hits, int]:
    """The nearest hits with one triangle more, and which of them are new, as bits."""
    this = splat(np.int32(face), 8)
    scale = splat(1.0, 8) / hit.det
    t = distances(p.shear, hit, scale)
    better = hit.inside & (t > splat(0.0, 8)) & (t <= best.t)
    better = better & ((this < load(wave.first, at, 8)) | (this >= load(wave.end, at, 8)))
    better = better & ((t < best.t) | (best.face < splat(np.int32(0), 8)) | (this < best.face))
    nearest = Hits(
        choose(better, t, best.t),
        choose(better, this, best.face),
        choose(better, hit.v * scale, best.b1),
        choose(better, hit.w * scale, best.b2),
    )
    return nearest, bits(better)


@device
def _hidden(p: Packet, wave: Wave, at: int, hit: Triangles, face: int, far: float) -> int:
    """Which of 8 rays a triangle hides, as bits."""
    this = splat(np.int32(face), 8)
    counts = (this < load(wave.first, at, 8)) | (this >= load(wave.end, at, 8))
    counts = counts & (this != load(wave.target, at, 8))
    t = distances(p.shear, hit, splat(1.0, 8) / hit.det)
    return bits(hit.inside & counts & (t > splat(0.0, 8)) & (t < splat(far, 8)))


@device
def _put_hits(wave: Wave, at: int, hits: Hits) -> None:
    store(wave.t, at, hits.t)
    store(wave.face, at, hits.face)
    store(wave.b1, at, hits.b1)
    store(wave.b2, at, hits.b2)


@device
def _put_found(wave: Wave, at: int, hidden: int) -> None:
    for lane in range(SIZE):
        wave.found[at + lane] = (hidden >> lane) & 1 != 0


@device
def closest_hits_of_packet(wide: Bvh8, p: Packet, wave: Wave, at: int, far: float, stack: np.ndarray) -> bool:
    """Write the nearest hits of 8 rays as `closest_hit` gives them; False: gave up, nothing written."""
    boxes = _frustum_of_boxes(wide, p)
    triangles = _frustum_of_triangles(p)
    best = _nothing(far)
    furthest = highest(best.t * p.speed)
    reach = splat(np.float32(furthest * wide.scale * ROUND_UP), 8)
    work = 0
    size = 0
    node = 0
    while len(wide.nodes) > 0:
        work += 1
        if work > MUCH_WORK:
            return False
        if node >= 0:
            enter, met = _cut_boxes(wide.nodes, node, p, boxes, reach)
            lanes = bits(met)
            if lanes != 0:
                links = node * NODE + LINKS
                keys = (as_int(enter) & splat(DISTANCE_BITS, 8)) | numbers(8)
                nearest = smallest(choose(met, keys, splat(NEVER, 8)))
                rest = met & (keys != splat(nearest, 8))
                store(stack, size, compress(keys, rest))
                store(stack, NODES + size, compress(load_ints(wide.nodes, links, 8), rest))
                size += count_bits(lanes) - 1
                node = load_int(wide.nodes, links + (np.int64(nearest) & 7))
                continue
        else:
            leaf = -1 - node
            lanes = _cut_triangles(wide.leaves, leaf, p, triangles, furthest)
            work += count_bits(lanes)
            nearer = 0
            while lanes != 0:
                lane = lowest_bit(lanes)
                lanes &= lanes - 1
                hit = _triangle(wide.leaves, leaf, lane, p.shear)
                if bits(hit.inside) != 0:
                    best, new = _nearer(best, p, wave, at, hit, face_of(wide.leaves, leaf, lane))
                    nearer |= new
            if nearer != 0:
                furthest = highest(best.t * p.speed)
                reach = splat(np.float32(furthest * wide.scale * ROUND_UP), 8)
        while size > 0:
            size -= 1
            if stack[size] & DISTANCE_BITS <= extract(as_int(reach), 0):
                size += 1
                break
        if size == 0:
            break
        size -= 1
        node = entry(stack, NODES + size)
    _put_hits(wave, at, best)
    return True


@device
def any_hits_of_packet(wide: Bvh8, p: Packet, wave: Wave, at: int, far: float, stack: np.ndarray) -> bool:
    """Write what `any_hit` finds for 8 rays; False: gave up, nothing written."""
    boxes = _frustum_of_boxes(wide, p)
    triangles = _frustum_of_triangles(p)
    furthest = highest(splat(far, 8) * p.speed)
    reach = splat(np.float32(furthest * wide.scale * ROUND_UP), 8)
    hits = 0
    work = 0
    size = 0
    node = 0
    while len(wide.nodes) > 0:
        work += 1
        if work > MUCH_WORK:
            return False
        if node >= 0:
            _, met = _cut_boxes(wide.nodes, node, p, boxes, reach)
            store(stack, size, compress(load_ints(wide.nodes, node * NODE + LINKS, 8), met))
            size += count_bits(bits(met))
        else:
            leaf = -1 - node
            lanes = _cut_triangles(wide.leaves, leaf, p, triangles, furthest)
            work += count_bits(lanes)
            while lanes != 0:
                lane = lowest_bit(lanes)
                lanes &= lanes - 1
                hit = _triangle(wide.leaves, leaf, lane, p.shear)
                if bits(hit.inside) != 0:
                    hits |= _hidden(p, wave, at, hit, face_of(wide.leaves, leaf, lane), far)
            if hits == 255:
                break
        if size == 0:
            break
        size -= 1
        node = entry(stack, size)
    _put_found(wave, at, hits)
    return True
