"""Rays of a wave descended together, each on its own way: while one waits for a node or for a test, others go on.

Any hit: pairs (ray, node) lie on one stack, of which the last 64 are taken at a time. Each puts the boxes that its ray
meets on top, as pairs, and leaves into a queue of their own, which is tested when it is long enough. Nearest hit: in
rounds, in each of which every ray takes one step, into a node, through a leaf, or back to the last box that it passed
by; each has a stack. No branch depends on which boxes are met, so that the processor goes on to the next ray where a
single descent would wait for its guess to be proven wrong.

Boxes are padded as `bvh8_traverse` pads them and triangles tested in float64 by its expressions: faces and distances
have the bits of single rays, in whatever company they come.
"""

import numpy as np

from termwise.renderer.geometry.bvh8 import DEEPEST, FACES, HIGH, LEAF, LINKS, NODE, Bvh8
from termwise.renderer.geometry.bvh8_traverse import (
    DISTANCE_BITS,
    MAX_INVERSE,
    NEVER,
    PAD,
    ROUND_UP,
    Shear,
    Triangles,
    depths,
    triangles_of,
)
from termwise.renderer.geometry.simd import (
    as_int,
    bits,
    choose,
    compress,
    count_bits,
    extract,
    fma,
    load,
    load_int,
    load_ints,
    lowest_bit,
    magnitude,
    maximum,
    minimum,
    narrow,
    numbers,
    prefetch,
    rows,
    size_of,
    smallest,
    splat,
    store,
)
from termwise.renderer.geometry.wave import SIZE, Wave
from termwise.renderer.jit import device
from termwise.renderer.vector import entry

# Pairs that are fetched ahead of the one at hand.
_AHEAD = 8
# Where the parts of the stack begin. Any hit: rays and nodes of the pairs, of the leaves that wait, of those taken.
# 64 pairs are taken and at most 8 put for each, so that a level leaves no more behind than 64 rays' own stacks do.
_MOST_PAIRS = SIZE * DEEPEST
_LEAF_RAYS, _LEAF_NODES = 2 * _MOST_PAIRS, 2 * _MOST_PAIRS + 10 * SIZE
_TAKEN_RAYS = _LEAF_NODES + 10 * SIZE
_TAKEN_NODES = _TAKEN_RAYS + 2 * SIZE
# Leaves that make a queue long enough.
_MANY = SIZE // 2
# Nearest hit: distances and nodes of each ray's stack, then a number of each ray, and lists of rays.
_KEYS, _NODES = 0, SIZE * DEEPEST
_TOP = 2 * SIZE * DEEPEST
_NODE = _TOP + SIZE
_LISTS = _NODE + SIZE


@device
def _put_axis(wide: Bvh8, wave: Wave, axis: int, k: int, origin: int, center: float, largest: int, pad: int) -> None:
    """What boxes ask of an axis of rays k ... k + 7: inverse, near and far, and where a node's near planes begin."""
    zero = splat(0.0, 8)
    direction = load(wave.directions, axis * SIZE + k, 8)
    finite = minimum(magnitude(largest / direction), splat(MAX_INVERSE, 8))
    back = direction < zero
    inverse = choose(back, zero - finite, finite)
    o = (origin - splat(center, 8)) * splat(wide.scale, 8)
    signed = choose(back, zero - pad, pad)
    store(wave.scaled, axis * SIZE + k, narrow(inverse))
    store(wave.scaled, (3 + axis) * SIZE + k, narrow((zero - (o + signed)) * inverse))
    store(wave.scaled, (6 + axis) * SIZE + k, narrow((signed - o) * inverse))
    near = choose(back, splat(np.int32(HIGH), 8), splat(np.int32(0), 8))
    store(wave.axes, axis * SIZE + k, near + splat(np.int32(8 * axis), 8))


@device
def _prepare(wide: Bvh8, wave: Wave, rays: int, far: float) -> None:
    """Put what boxes and triangles ask of rays into `wave.scaled`, `wave.shears` and `wave.axes`."""
    zero, one, two = splat(np.int32(0), 8), splat(np.int32(1), 8), splat(np.int32(2), 8)
    for k in range(0, SIZE, 8):
        if (rays >> k) & 255 == 0:
            continue
        o, d = rows(wave.origins, k), rows(wave.directions, k)
        # As `make_ray` chooses: the first axis of the largest component.
        along_y = magnitude(d[1]) > magnitude(d[0])
        main = choose(along_y, d[1], d[0])
        along_z = magnitude(d[2]) > magnitude(main)
        main = choose(along_z, d[2], main)
        largest = magnitude(main)
        distance = maximum(
            magnitude(o[0] - splat(wide.center.x, 8)),
            maximum(magnitude(o[1] - splat(wide.center.y, 8)), magnitude(o[2] - splat(wide.center.z, 8))),
        )
        pad = splat(PAD, 8) * (splat(1.0, 8) + distance * splat(wide.scale, 8))
        _put_axis(wide, wave, 0, k, o[0], wide.center.x, largest, pad)
        _put_axis(wide, wave, 1, k, o[1], wide.center.y, largest, pad)
        _put_axis(wide, wave, 2, k, o[2], wide.center.z, largest, pad)
        speed = largest * splat(wide.scale * ROUND_UP, 8)
        store(wave.scaled, 9 * SIZE + k, narrow(splat(far, 8) * speed))
        kz = choose(along_z, two, choose(along_y, one, zero))
        kx = choose(along_z, zero, choose(along_y, two, one))
        ky = choose(along_z, one, choose(along_y, zero, two))
        dx, ox = choose(along_z, d[0], choose(along_y, d[2], d[1])), choose(along_z, o[0], choose(along_y, o[2], o[1]))
        dy, oy = choose(along_z, d[1], choose(along_y, d[0], d[2])), choose(along_z, o[1], choose(along_y, o[0], o[2]))
        back = main < splat(0.0, 8)
        store(wave.axes, 3 * SIZE + k, choose(back, ky, kx))
        store(wave.axes, 4 * SIZE + k, choose(back, kx, ky))
        store(wave.axes, 5 * SIZE + k, kz)
        store(wave.shears, k, choose(back, oy, ox))
        store(wave.shears, SIZE + k, choose(back, ox, oy))
        store(wave.shears, 2 * SIZE + k, choose(along_z, o[2], choose(along_y, o[1], o[0])))
        store(wave.shears, 3 * SIZE + k, choose(back, dy, dx) / main)
        store(wave.shears, 4 * SIZE + k, choose(back, dx, dy) / main)
        store(wave.shears, 5 * SIZE + k, splat(1.0, 8) / main)
        store(wave.shears, 6 * SIZE + k, speed)


@device
def _slabs(nodes: np.ndarray, start: int, wave: Wave, r: int) -> tuple:
    """Distances at which ray r enters a node's 8 boxes, at least 0, and leaves them, at most its reach."""
    s = wave.scaled
    x, y, z = entry(wave.axes[0], r), entry(wave.axes[1], r), entry(wave.axes[2], r)
    ix, iy, iz = splat(s[0, r], 8), splat(s[1, r], 8), splat(s[2, r], 8)
    enter = maximum(
        maximum(
            fma(load(nodes, start + x, 8), ix, splat(s[3, r], 8)), fma(load(nodes, start + y, 8), iy, splat(s[4, r], 8))
        ),
        maximum(fma(load(nodes, start + z, 8), iz, splat(s[5, r], 8)), splat(np.float32(0.0), 8)),
    )
    leave = minimum(
        minimum(
            fma(load(nodes, start + HIGH - x, 8), ix, splat(s[6, r], 8)),
            fma(load(nodes, start + HIGH + 16 - y, 8), iy, splat(s[7, r], 8)),
        ),
        minimum(fma(load(nodes, start + HIGH + 32 - z, 8), iz, splat(s[8, r], 8)), splat(s[9, r], 8)),
    )
    return enter, leave


@device
def _shear(wave: Wave, r: int) -> Shear:
    s = wave.shears
    return Shear(
        (splat(s[0, r], 8), splat(s[1, r], 8), splat(s[2, r], 8)),
        (splat(s[3, r], 8), splat(s[4, r], 8), splat(s[5, r], 8)),
        8 * entry(wave.axes[3], r),
        8 * entry(wave.axes[4], r),
        8 * entry(wave.axes[5], r),
    )


@device
def leaf_of_ray(wide: Bvh8, wave: Wave, r: int, leaf: int) -> tuple:
    """Ray r against a leaf's triangles: what its line meets of them, `t det`, faces, and which it may hit."""
    shear = _shear(wave, r)
    hit = triangles_of(wide.leaves, leaf, shear)
    depth = depths(shear, hit)
    faces = load_ints(wide.leaves, (leaf * LEAF + FACES) * (size_of(wide.leaves) // 4), 8)
    left = (faces < splat(wave.first[r], 8)) | (faces >= splat(wave.end[r], 8))
    return hit, depth, faces, hit.inside & left


@device
def fetch_node(nodes: np.ndarray, node: int) -> None:
    """Fetch a node into the cache."""
    for line in range(0, NODE, 16):
        prefetch(nodes, node * NODE + line)


@device
def fetch_leaf(leaves: np.ndarray, leaf: int) -> None:
    """Fetch a leaf into the cache."""
    for line in range(0, LEAF, 64 // size_of(leaves)):
        prefetch(leaves, leaf * LEAF + line)


@device
def any_hits_of_stream(wide: Bvh8, wave: Wave, rays: int, far: float, stack: np.ndarray) -> None:
    """Write what `any_hit` finds for those rays of a wave that `rays` has as bits; `stack`: int32, of STACK_SIZE."""
    _prepare(wide, wave, rays, far)
    size = 0
    while rays != 0:
        r = lowest_bit(rays)
        rays &= rays - 1
        wave.found[r] = False
        stack[size] = r
        stack[_MOST_PAIRS + size] = 0
        size += 1
    if len(wide.nodes) == 0:
        return
    waiting = 0
    none = splat(np.int32(0), 8)
    while size > 0:
        taken = min(size, SIZE)
        size -= taken
        for k in range(0, taken, 8):
            store(stack, _TAKEN_RAYS + k, load(stack, size + k, 8))
            store(stack, _TAKEN_NODES + k, load(stack, _MOST_PAIRS + size + k, 8))
        for k in range(taken):
            r, start = entry(stack, _TAKEN_RAYS + k), entry(stack, _TAKEN_NODES + k) * NODE
            fetch_node(wide.nodes, entry(stack, _TAKEN_NODES + min(k + _AHEAD, taken - 1)))
            if wave.found[r]:
                continue
            enter, leave = _slabs(wide.nodes, start, wave, r)
            met = enter <= leave
            links = load_ints(wide.nodes, start + LINKS, 8)
            inner, leaf = met & (links >= none), met & (links < none)
            ray = splat(np.int32(r), 8)
            store(stack, _MOST_PAIRS + size, compress(links, inner))
            store(stack, size, ray)
            size += count_bits(bits(inner))
            store(stack, _LEAF_NODES + waiting, compress(links, leaf))
            store(stack, _LEAF_RAYS + waiting, ray)
            waiting += count_bits(bits(leaf))
        if waiting >= _MANY or size == 0:
            _test_leaves(wide, wave, waiting, far, stack)
            waiting = 0


@device
def _test_leaves(wide: Bvh8, wave: Wave, waiting: int, far: float, stack: np.ndarray) -> None:
    for k in range(waiting):
        r, leaf = entry(stack, _LEAF_RAYS + k), -1 - entry(stack, _LEAF_NODES + k)
        fetch_leaf(wide.leaves, -1 - entry(stack, _LEAF_NODES + min(k + _AHEAD, waiting - 1)))
        if wave.found[r]:
            continue
        hit, depth, faces, met = leaf_of_ray(wide, wave, r, leaf)
        wave.found[r] = is_hidden(wave, r, hit, depth, faces, met, far)


@device
def is_hidden(wave: Wave, r: int, hit: Triangles, depth: int, faces: int, met: int, far: float) -> bool:
    """Whether one of what ray r may hit of a leaf hides what lies `far` away."""
    t = depth * (splat(1.0, 8) / hit.det)
    # No branch for leaves that hold nothing: it is guessed wrong too often (ambient takes 1.02 of the time with it).
    met = met & (faces != splat(wave.target[r], 8))
    return bits(met & (t > splat(0.0, 8)) & (t < splat(far, 8))) != 0


@device
def closest_hits_of_stream(wide: Bvh8, wave: Wave, rays: int, far: float, stack: np.ndarray) -> None:
    """Write the nearest hits of those rays of a wave that `rays` has as bits, as `closest_hit` gives them."""
    _prepare(wide, wave, rays, far)
    # Of the rays: those before a node, before a leaf, and those that go back; lists that are read, and written.
    nodes, leaves, back = _LISTS, _LISTS + SIZE, _LISTS + 2 * SIZE
    next_nodes, next_back = _LISTS + 3 * SIZE, _LISTS + 4 * SIZE
    at_nodes, at_leaves, going_back = 0, 0, 0
    while rays != 0:
        r = lowest_bit(rays)
        rays &= rays - 1
        wave.t[r], wave.face[r], wave.b1[r], wave.b2[r] = far, -1, 0.0, 0.0
        stack[_TOP + r] = r * DEEPEST
        stack[_NODE + r] = 0
        stack[nodes + at_nodes] = r
        at_nodes += 1
    if len(wide.nodes) == 0:
        return
    while at_nodes + at_leaves + going_back > 0:
        staying, left = 0, 0
        for k in range(at_nodes):
            r = entry(stack, nodes + k)
            start = entry(stack, _NODE + r) * NODE
            enter, leave = _slabs(wide.nodes, start, wave, r)
            met = enter <= leave
            keys = (as_int(enter) & splat(DISTANCE_BITS, 8)) | numbers(8)
            nearest = smallest(choose(met, keys, splat(NEVER, 8)))
            rest = met & (keys != splat(nearest, 8))
            top = entry(stack, _TOP + r)
            store(stack, _KEYS + top, compress(keys, rest))
            store(stack, _NODES + top, compress(load_ints(wide.nodes, start + LINKS, 8), rest))
            stack[_TOP + r] = top + count_bits(bits(rest))
            node = load_int(wide.nodes, start + LINKS + (np.int64(nearest) & 7))
            stack[_NODE + r] = node
            here = 1 if bits(met) != 0 else 0
            leaf = 1 if node < 0 else 0
            stack[next_nodes + staying] = r
            staying += here & (1 - leaf)
            stack[leaves + at_leaves] = r
            at_leaves += here & leaf
            stack[back + going_back] = r
            going_back += 1 - here
        for k in range(at_leaves):
            r = entry(stack, leaves + k)
            hit, depth, faces, met = leaf_of_ray(wide, wave, r, -1 - entry(stack, _NODE + r))
            if put_nearest(wave, r, hit, depth, faces, met):
                wave.scaled[9, r] = np.float32(wave.t[r] * wave.shears[6, r])
            stack[back + going_back] = r
            going_back += 1
        at_leaves = 0
        for k in range(going_back):
            r = entry(stack, back + k)
            top = entry(stack, _TOP + r) - 1
            some = 1 if top >= r * DEEPEST else 0
            top = max(top, r * DEEPEST)
            good = some if stack[_KEYS + top] & DISTANCE_BITS <= load_int(wave.scaled, 9 * SIZE + r) else 0
            node = entry(stack, _NODES + top)
            stack[_TOP + r] = top
            stack[_NODE + r] = node
            leaf = 1 if node < 0 else 0
            stack[next_nodes + staying] = r
            staying += good & (1 - leaf)
            stack[leaves + at_leaves] = r
            at_leaves += good & leaf
            stack[next_back + left] = r
            left += some & (1 - good)
        nodes, next_nodes = next_nodes, nodes
        back, next_back = next_back, back
        at_nodes, going_back = staying, left
        for k in range(at_nodes):
            fetch_node(wide.nodes, entry(stack, _NODE + entry(stack, nodes + k)))
        for k in range(at_leaves):
            fetch_leaf(wide.leaves, -1 - entry(stack, _NODE + entry(stack, leaves + k)))


@device
def put_nearest(wave: Wave, r: int, hit: Triangles, depth: int, faces: int, met: int) -> bool:
    """Write the nearest of what ray r may hit of a leaf; whether any is nearer than what it had."""
    if bits(met) == 0:  # as in most leaves
        return False
    nearer = False
    scale = splat(1.0, 8) / hit.det
    t = depth * scale
    lanes = bits(met & (t > splat(0.0, 8)) & (t <= splat(wave.t[r], 8)))
    while lanes != 0:
        lane = lowest_bit(lanes)
        lanes &= lanes - 1
        distance, face = extract(t, lane), extract(faces, lane)
        if distance < wave.t[r] or (distance == wave.t[r] and (wave.face[r] < 0 or face < wave.face[r])):
            nearer = True
            wave.t[r] = distance
            wave.face[r] = face
            wave.b1[r] = extract(hit.v, lane) * extract(scale, lane)
            wave.b2[r] = extract(hit.w, lane) * extract(scale, lane)
    return nearer
