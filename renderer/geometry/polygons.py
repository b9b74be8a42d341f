"""Rays among few polygons, without a tree: 16 rays a vector, in float32, and float64 where that leaves a doubt.

A line of direction d and moment `m = d x o` passes the edge from b to c of a triangle on the side that the sign of
`U = d.(c x b) + m.(c - b)` says (Plücker); V and W are those of the edges from c to a and from a to b. It meets the
triangle where all have one sign, and, with `N = c x b + a x c + b x a`, at `t = N.(a - o) / (U + V + W)`. Two triangles
that make a parallelogram are tested as one: it is met where V and W lie between 0 and U + V + W, and the sign of U
says which of the two is.

In coordinates in which the scene lies in [-1, 1] and the largest component of a direction is 1, r being the largest
coordinate of an origin, u = 2^-24 and |.| the sum of magnitudes, float32 errs at most by (6 roundings of a sum of 6
products, and 2 of each product's factors)

- `e = 8 u (|c x b| + 2 r |c - b|)` of an edge function, 3.6 e of their sum and 3 e of its difference from one of them;
- `7 u (|N.a| + |N| r)` of t's numerator;

and what float64 does not know itself is added: 2^-43 (1 + r)² and (1 + r)³, more than its roundings and the slack of
`intersect_triangle`. A parallelogram whose fourth corner lies beside its place by s has 6 s (1 + r) added to e. A ray
hits for sure where all signs hold beyond these bounds, and misses for sure where one of them is against it; where
neither can be said, there is a doubt, and the tree decides. So what is met has the bits of the exact test.

Of a wave of rays no polygon is asked that its rays cannot reach, by bounds of their origins and directions; nor the
faces of a closed convex piece that show their back to all of them: who is outside meets a front first.
"""

from typing import NamedTuple

import numpy as np

from termwise.renderer.by_reference import by_reference
from termwise.renderer.geometry.bvh8_traverse import Shear, distances, edges
from termwise.renderer.geometry.intersect import FaceRange, Ray, component
from termwise.renderer.geometry.simd import (
    bits,
    choose,
    fma,
    fms,
    highest,
    in_lanes,
    load,
    lowest,
    lowest_bit,
    magnitude,
    maximum,
    minimum,
    narrow,
    numbers,
    rows,
    splat,
    store,
)
from termwise.renderer.geometry.wave import SIZE, Wave
from termwise.renderer.jit import device, subroutine
from termwise.renderer.memory import on_own_lines
from termwise.renderer.vector import Vec3, entry, vec3

LANES = 16
# Polygons are bits of an integer, less its sign; up to there no tree is faster.
MOST = 63
MISS, HIT, DOUBT = range(3)
_ALL = (1 << LANES) - 1
_EIGHT = 255
_UNIT = 2.0**-24
_EXACT = 2.0**-43  # what float64 and the slack of `intersect_triangle` make, of coordinates of 1
_FAR_AWAY = 2.0**20  # rays from farther away are left to float64, as are directions of lengths near its limits
_SHORTEST, _LONGEST = 2.0**-900, 2.0**900
_PAD = 2.0**-19  # of bounds: 32 roundings of r, of which boxes, origins, directions and quotients make 24
_CONVEX = 2.0**-20  # the most that a corner of a convex piece lies above the plane of a face
_PLACE = 2.0**-21  # the most that a fourth corner lies beside its place
# Rows of the table: three edges with a moment and a direction each, N, N.a, bounds of an edge function and of t's
# numerator (each at r = 0, and what r adds), a box, and the outward plane of a face of a closed convex piece with the
# error of a height over it (both 0 of any other).
_EDGES, _NORMAL, _HEIGHT, _BOUNDS, _LOW, _HIGH, _PLANE, _TILT, _ROWS = 0, 18, 21, 22, 26, 29, 32, 36, 37
_NOWHERE = 2e30


@by_reference()
class Polygons(NamedTuple):
    """Triangles and parallelograms; nothing where there are too many.

    Attributes
    ----------
    table : (_ROWS S,) float32, S a multiple of 16: a row is one number of each polygon, parallelograms first.
    members : (2, S) int32, the faces of each polygon, twice the same of a triangle.
    count, pairs : numbers of polygons, and of parallelograms among them.
    pieces : (P,) int64, the polygons of each closed convex piece, as bits.
    piece : (F,) int64, those of the piece that each face belongs to, 0 for none.
    center, scale : of the coordinates `(x - center) scale`.
    """

    table: np.ndarray
    members: np.ndarray
    count: int
    pairs: int
    pieces: np.ndarray
    piece: np.ndarray
    center: Vec3
    scale: float


def _neighbours(vertices: np.ndarray, faces: np.ndarray) -> dict[tuple[int, int], list[tuple[int, int]]]:
    """Of each edge (lower vertex, higher vertex) the faces that have it, and the number of their corner beside it."""
    found: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for face in faces.tolist():
        ids = vertices[face].tolist()
        for corner in range(3):
            ends = ids[(corner + 1) % 3], ids[(corner + 2) % 3]
            found.setdefault((min(ends), max(ends)), []).append((face, corner))
    return found


def _parallelograms(points: np.ndarray, edges_of: dict) -> list[tuple[int, int, int, float]]:
    """(face, its corner beside the other face, that face, how far its last corner lies beside its place) of pairs."""
    found = []
    for sides in edges_of.values():
        if len(sides) == 2:
            (face, corner), (other, last) = sides
            a, b, c = np.roll(points[face], -corner, axis=0)
            beside = float(np.abs(b + c - a - points[other, last]).max())
            if beside <= _PLACE:
                found.append((face, corner, other, beside))
    # The best first, and of two as good the one with the lower faces.
    found.sort(key=lambda pair: (pair[3] > _UNIT, pair[0], pair[2]))
    chosen, taken = [], set()
    for pair in found:
        if not {pair[0], pair[2]} & taken:
            chosen.append(pair)
            taken |= {pair[0], pair[2]}
    return chosen


def _convex_pieces(vertices: np.ndarray, points: np.ndarray, faces: np.ndarray, edges_of: dict) -> list[list[int]]:
    """Faces of each closed convex piece, of corners `points` (F, 3, 3); those that show inwards too.

    Closed: each edge has two faces, which go along it in opposite ways.
    """
    parent = {face: face for face in faces.tolist()}

    def root(face: int) -> int:
        while parent[face] != face:
            parent[face] = parent[parent[face]]
            face = parent[face]
        return face

    is_open = set()
    for sides in edges_of.values():
        ways = {int(vertices[face][(corner + 1) % 3]) for face, corner in sides}
        if len(sides) != 2 or len(ways) != 2:
            is_open |= {face for face, _ in sides}
        for face, _ in sides[1:]:
            parent[root(face)] = root(sides[0][0])
    groups: dict[int, list[int]] = {}
    for face in parent:
        groups.setdefault(root(face), []).append(face)
    pieces = []
    for group in groups.values():
        if not is_open & set(group):
            heights = _planes(points[group]) @ np.vstack([points[group].reshape(-1, 3).T, np.ones(3 * len(group))])
            if heights.max() <= _CONVEX or heights.min() >= -_CONVEX:
                pieces.append(group)
    return pieces


def _planes(points: np.ndarray) -> np.ndarray:
    """(F, 4), unit normal and `-n.a` of triangles (F, 3, 3)."""
    normals = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return np.column_stack([normals, -(normals * points[:, 0]).sum(axis=1)])


def polygons_of(corners: np.ndarray, faces: np.ndarray, center: Vec3, scale: float) -> Polygons:
    """Find the polygons of triangles (F, 3, 3), those `faces` that have an area, if they are few."""
    none = np.zeros(0, np.int64)
    nothing = Polygons(np.zeros(0, np.float32), np.zeros((2, 0), np.int32), 0, 0, none, none, center, scale)
    if not 0 < len(faces) <= 2 * MOST:
        return nothing
    points = (corners - np.array(center)) * scale
    # Equal corners are one vertex: + 0.0 makes them equal to the bit.
    _, vertices = np.unique(corners.reshape(-1, 3) + 0.0, axis=0, return_inverse=True)
    vertices = vertices.reshape(-1, 3)
    edges_of = _neighbours(vertices, faces)
    pairs = _parallelograms(points, edges_of)
    paired = {face for pair in pairs for face in (pair[0], pair[2])}
    single = [(face, 0, face, 0.0) for face in sorted(faces.tolist()) if face not in paired]
    found = [*pairs, *single]
    count = len(found)
    if count > MOST:
        return nothing
    size = -(-count // LANES) * LANES
    members = np.full((2, size), -1, np.int32)
    members[:, :count] = [[one[0] for one in found], [one[2] for one in found]]
    beside = np.array([one[3] for one in found])
    a, b, c = (np.array([points[face, (corner + i) % 3] for face, corner, _, _ in found]) for i in range(3))
    whole = np.concatenate([points[members[0, :count]], points[members[1, :count]]], axis=1)

    # Differences of corners are exact where they are close, which those of products are not.
    rows = np.zeros((_ROWS, size))
    directions = (c - b, a - c, b - a)
    moments = (np.cross(c - b, b), np.cross(a - c, c), np.cross(b - a, a))
    for i in range(3):
        rows[_EDGES + 6 * i : _EDGES + 6 * i + 3, :count] = moments[i].T
        rows[_EDGES + 6 * i + 3 : _EDGES + 6 * i + 6, :count] = directions[i].T
    normal = np.cross(c - b, b - a)
    height = (a * normal).sum(axis=1)
    rows[_NORMAL : _NORMAL + 3, :count] = normal.T
    rows[_HEIGHT, :count] = height
    largest = [np.abs(np.stack(these)).sum(axis=2).max(axis=0) for these in (moments, directions)]
    edge = np.abs(np.stack(directions)).max(axis=(0, 2))
    rows[_BOUNDS, :count] = 8.5 * _UNIT * largest[0] + 6.0 * beside
    rows[_BOUNDS + 1, :count] = 17.0 * _UNIT * largest[1] + 6.0 * beside
    rows[_BOUNDS + 2, :count] = 7.5 * _UNIT * np.abs(height) + 12.0 * beside * edge
    rows[_BOUNDS + 3, :count] = 7.5 * _UNIT * np.abs(normal).sum(axis=1) + 12.0 * beside * edge
    rows[_LOW : _LOW + 3] = _NOWHERE
    rows[_HIGH : _HIGH + 3] = -_NOWHERE
    rows[_LOW : _LOW + 3, :count] = whole.min(axis=1).T
    rows[_HIGH : _HIGH + 3, :count] = whole.max(axis=1).T

    pieces, piece = [], np.zeros(len(corners), np.int64)
    numbers_of = {face: number for number, one in enumerate(found) for face in (one[0], one[2])}
    for group in _convex_pieces(vertices, points, faces, edges_of):
        mine = sorted({numbers_of[face] for face in group})
        # Both of a pair are on one piece: they share an edge.
        own = np.stack([_planes(points[members[i, mine]]) for i in range(2)])
        inside = points[group].mean(axis=(0, 1))
        own *= -np.sign(own[..., :3] @ inside + own[..., 3])[..., None]
        rows[_PLANE : _PLANE + 4, mine] = own[0].T
        rows[_TILT, mine] = _CONVEX + _PAD + np.abs(own[1] - own[0]).sum(axis=1)
        pieces.append(sum(1 << number for number in mine))
        piece[group] = pieces[-1]
    table = rows.astype(np.float32)
    table[_LOW : _LOW + 3] = np.nextafter(table[_LOW : _LOW + 3], np.float32(-np.inf))
    table[_HIGH : _HIGH + 3] = np.nextafter(table[_HIGH : _HIGH + 3], np.float32(np.inf))
    return Polygons(
        on_own_lines(table.ravel()),
        on_own_lines(members),
        count,
        len(pairs),
        np.array(pieces, np.int64),
        piece,
        center,
        scale,
    )


class Tested(NamedTuple):
    """Polygons in 16 lanes, or one in all of them: what the table has of it, and its faces."""

    u: tuple
    v: tuple
    w: tuple
    normal: tuple
    height: int
    bounds: tuple
    pair: int
    members: tuple


class Lines(NamedTuple):
    """Rays in 16 lanes, or one in all of them: its origin, direction and moment, its far end, and faces it passes."""

    origin: tuple
    direction: tuple
    moment: tuple
    reach: int
    first: int
    end: int
    target: int


class Sides(NamedTuple):
    """Edge functions with the sign of their sum, which is `size`, and bounds of the errors of e and of t's numerator.

    `inner` is the least of what has to be positive inside.
    """

    u: int
    size: int
    forward: int
    inner: int
    error: int
    depth_error: int


@device
def _polygon(polygons: Polygons, number: int) -> Tested:
    """One polygon in all lanes."""
    t, s = polygons.table, len(polygons.table) // _ROWS
    e = number + _EDGES * s
    return Tested(
        (
            splat(t[e], 16),
            splat(t[e + s], 16),
            splat(t[e + 2 * s], 16),
            splat(t[e + 3 * s], 16),
            splat(t[e + 4 * s], 16),
            splat(t[e + 5 * s], 16),
        ),
        (
            splat(t[e + 6 * s], 16),
            splat(t[e + 7 * s], 16),
            splat(t[e + 8 * s], 16),
            splat(t[e + 9 * s], 16),
            splat(t[e + 10 * s], 16),
            splat(t[e + 11 * s], 16),
        ),
        (
            splat(t[e + 12 * s], 16),
            splat(t[e + 13 * s], 16),
            splat(t[e + 14 * s], 16),
            splat(t[e + 15 * s], 16),
            splat(t[e + 16 * s], 16),
            splat(t[e + 17 * s], 16),
        ),
        (splat(t[e + _NORMAL * s], 16), splat(t[e + (_NORMAL + 1) * s], 16), splat(t[e + (_NORMAL + 2) * s], 16)),
        splat(t[e + _HEIGHT * s], 16),
        (
            splat(t[e + _BOUNDS * s], 16),
            splat(t[e + (_BOUNDS + 1) * s], 16),
            splat(t[e + (_BOUNDS + 2) * s], 16),
            splat(t[e + (_BOUNDS + 3) * s], 16),
        ),
        splat(number < polygons.pairs, 16),
        (splat(polygons.members[0, number], 16), splat(polygons.members[1, number], 16)),
    )


@device
def _block(polygons: Polygons, first: int) -> Tested:
    """16 polygons."""
    t, s = polygons.table, len(polygons.table) // _ROWS
    e = first + _EDGES * s
    return Tested(
        (
            load(t, e, 16),
            load(t, e + s, 16),
            load(t, e + 2 * s, 16),
            load(t, e + 3 * s, 16),
            load(t, e + 4 * s, 16),
            load(t, e + 5 * s, 16),
        ),
        (
            load(t, e + 6 * s, 16),
            load(t, e + 7 * s, 16),
            load(t, e + 8 * s, 16),
            load(t, e + 9 * s, 16),
            load(t, e + 10 * s, 16),
            load(t, e + 11 * s, 16),
        ),
        (
            load(t, e + 12 * s, 16),
            load(t, e + 13 * s, 16),
            load(t, e + 14 * s, 16),
            load(t, e + 15 * s, 16),
            load(t, e + 16 * s, 16),
            load(t, e + 17 * s, 16),
        ),
        (load(t, e + _NORMAL * s, 16), load(t, e + (_NORMAL + 1) * s, 16), load(t, e + (_NORMAL + 2) * s, 16)),
        load(t, e + _HEIGHT * s, 16),
        (
            load(t, e + _BOUNDS * s, 16),
            load(t, e + (_BOUNDS + 1) * s, 16),
            load(t, e + (_BOUNDS + 2) * s, 16),
            load(t, e + (_BOUNDS + 3) * s, 16),
        ),
        numbers(16) + splat(np.int32(first), 16) < splat(np.int32(polygons.pairs), 16),
        (load(polygons.members, first, 16), load(polygons.members, s + first, 16)),
    )


@device
def _edge(e: tuple, line: Lines) -> int:
    d, m = line.direction, line.moment
    return fma(e[0], d[0], fma(e[1], d[1], fma(e[2], d[2], fma(e[3], m[0], fma(e[4], m[1], e[5] * m[2])))))


@device
def _sides(q: Tested, line: Lines, r: np.float32) -> Sides:
    """The lines' sides of the polygons' edges; r is the largest coordinate of an origin."""
    u, v, w = _edge(q.u, line), _edge(q.v, line), _edge(q.w, line)
    det = u + v + w
    zero = splat(np.float32(0.0), 16)
    forward = det > zero
    size = magnitude(det)
    u = choose(forward, u, zero - u)
    v = choose(forward, v, zero - v)
    w = choose(forward, w, zero - w)
    inner = minimum(minimum(v, w), choose(q.pair, size - maximum(v, w), u))
    far = np.float32(1.0) + r
    exact = np.float32(_EXACT) * far * far
    return Sides(
        u,
        size,
        forward,
        inner,
        fma(q.bounds[1], splat(r, 16), q.bounds[0]) + splat(exact, 16),
        fma(q.bounds[3], splat(r, 16), q.bounds[2]) + splat(exact * far, 16),
    )


@device
def _times(number: float, vector: int) -> int:
    return splat(np.float32(number), 16) * vector


@device
def _passed(q: Tested, line: Lines, s: Sides) -> tuple:
    """Whether a line that meets a polygon may, and does for sure, meet a face of it that the ray does not pass."""
    a, b = q.members
    first = ((a < line.first) | (a >= line.end)) & (a != line.target)
    second = ((b < line.first) | (b >= line.end)) & (b != line.target)
    below = splat(np.float32(0.0), 16) - s.error
    may = (first & (s.u >= below)) | (second & (s.u <= s.error))
    sure = (first & second) | (first & (s.u > s.error)) | (second & (s.u < below))
    return may, sure


@device
def _depth(q: Tested, line: Lines, s: Sides) -> int:
    """T's numerator, its sign that of t."""
    n, o = q.normal, line.origin
    along = q.height - fma(n[0], o[0], fma(n[1], o[1], n[2] * o[2]))
    return choose(s.forward, along, splat(np.float32(0.0), 16) - along)


@device
def _met(q: Tested, line: Lines, s: Sides, maybe: int) -> tuple[int, int]:
    """Of the lanes `maybe`, as bits, those that are met before the far end, and those in doubt."""
    zero = splat(np.float32(0.0), 16)
    may, sure = _passed(q, line, s)
    maybe &= bits(may)
    along = _depth(q, line, s)
    left = fms(line.reach, s.size, along)
    end_error = fma(_times(4.0, s.error) + _times(4.0 * _UNIT, s.size), line.reach, s.depth_error)
    hit = bits((s.inner > _times(5.0, s.error)) & sure & (along > s.depth_error) & (left > end_error))
    # Of a sum that is not sure of its sign no side is.
    miss = bits((s.size > _times(4.0, s.error)) & ((along < zero - s.depth_error) | (left < zero - end_error)))
    return maybe & hit, maybe & ~hit & ~miss


@device
def _maybe(s: Sides) -> int:
    """Which lanes are not outside for sure, as bits."""
    return bits(s.inner >= _times(-5.0, s.error))


class Bounds(NamedTuple):
    """Boxes of a wave's origins and directions, (x, y, z) each, its furthest far end, and r; float32 all."""

    origin_low: tuple
    origin_high: tuple
    low: tuple
    high: tuple
    reach: np.float32
    r: np.float32


@device
def first_bits(count: int) -> int:
    """A set of bits, the first `count` of 64."""
    return -1 if count >= SIZE else (1 << count) - 1


@device
def _prepare(polygons: Polygons, wave: Wave, count: int, far: float) -> tuple[int, Bounds]:
    """Put the rays into the polygons' coordinates; which of them float32 can hold, as bits, and their bounds."""
    scale, one, nan = splat(polygons.scale, 8), splat(1.0, 8), splat(np.nan, 8)
    most = splat(np.float32(_NOWHERE), 8)
    least = splat(np.float32(-_NOWHERE), 8)
    o_low, o_high, d_low, d_high = (most, most, most), (least, least, least), (most, most, most), (least, least, least)
    furthest = largest = splat(np.float32(0.0), 8)
    held = 0
    for k in range(0, (count + LANES - 1) // LANES * LANES, 8):
        dx, dy, dz = (
            load(wave.directions, k, 8),
            load(wave.directions, SIZE + k, 8),
            load(wave.directions, 2 * SIZE + k, 8),
        )
        x = (load(wave.origins, k, 8) - splat(polygons.center.x, 8)) * scale
        y = (load(wave.origins, SIZE + k, 8) - splat(polygons.center.y, 8)) * scale
        z = (load(wave.origins, 2 * SIZE + k, 8) - splat(polygons.center.z, 8)) * scale
        sx, sy, sz = magnitude(dx), magnitude(dy), magnitude(dz)
        size = maximum(sx, maximum(sy, sz))
        # Sums, for NaN is lost in a maximum.
        ok = (magnitude(x) + magnitude(y) + magnitude(z) < splat(_FAR_AWAY, 8)) & (sx + sy + sz < splat(_LONGEST, 8))
        ok = ok & (size > splat(_SHORTEST, 8)) & (numbers(8) < splat(np.int32(count - k), 8))
        held |= bits(ok) << k
        # Of the others all is NaN: nothing is met, and bounds leave them out.
        inverse = one / size
        store(wave.shears, k, inverse)
        inverse = choose(ok, inverse, nan)
        dx, dy, dz = dx * inverse, dy * inverse, dz * inverse
        x, y, z = choose(ok, x, nan), choose(ok, y, nan), choose(ok, z, nan)
        r = maximum(magnitude(x), maximum(magnitude(y), magnitude(z)))
        # Nothing is farther than 1 + r.
        reach = minimum(splat(far * polygons.scale, 8) * size, splat(2.0, 8) * (one + r))
        o = narrow(x), narrow(y), narrow(z)
        d = narrow(dx), narrow(dy), narrow(dz)
        end = narrow(reach)
        store(wave.scaled, k, o[0])
        store(wave.scaled, SIZE + k, o[1])
        store(wave.scaled, 2 * SIZE + k, o[2])
        store(wave.scaled, 3 * SIZE + k, d[0])
        store(wave.scaled, 4 * SIZE + k, d[1])
        store(wave.scaled, 5 * SIZE + k, d[2])
        store(wave.scaled, 6 * SIZE + k, narrow(dy * z - dz * y))
        store(wave.scaled, 7 * SIZE + k, narrow(dz * x - dx * z))
        store(wave.scaled, 8 * SIZE + k, narrow(dx * y - dy * x))
        store(wave.scaled, 9 * SIZE + k, end)
        o_low = minimum(o[0], o_low[0]), minimum(o[1], o_low[1]), minimum(o[2], o_low[2])
        o_high = maximum(o[0], o_high[0]), maximum(o[1], o_high[1]), maximum(o[2], o_high[2])
        d_low = minimum(d[0], d_low[0]), minimum(d[1], d_low[1]), minimum(d[2], d_low[2])
        d_high = maximum(d[0], d_high[0]), maximum(d[1], d_high[1]), maximum(d[2], d_high[2])
        furthest = maximum(end, furthest)
        largest = maximum(narrow(r), largest)
    return held, Bounds(
        (lowest(o_low[0]), lowest(o_low[1]), lowest(o_low[2])),
        (highest(o_high[0]), highest(o_high[1]), highest(o_high[2])),
        (lowest(d_low[0]), lowest(d_low[1]), lowest(d_low[2])),
        (highest(d_high[0]), highest(d_high[1]), highest(d_high[2])),
        highest(furthest),
        highest(largest),
    )


@device
def _between(axis: int, low: int, high: int, b: Bounds, pad: np.float32, enter: int, leave: int) -> tuple:
    """Depths at which rays of the bounds may be between the planes of 16 boxes across one axis."""
    d0, d1, one = b.low[axis], b.high[axis], np.float32(1.0)
    if d0 > np.float32(0.0):
        enter = maximum((low - splat(b.origin_high[axis] + pad, 16)) * splat(one / d1, 16), enter)
        leave = minimum((high - splat(b.origin_low[axis] - pad, 16)) * splat(one / d0, 16), leave)
    elif d1 < np.float32(0.0):
        enter = maximum((high - splat(b.origin_low[axis] - pad, 16)) * splat(one / d0, 16), enter)
        leave = minimum((low - splat(b.origin_high[axis] + pad, 16)) * splat(one / d1, 16), leave)
    return enter, leave


@device
def _across(axis: int, low: int, high: int, b: Bounds, pad: np.float32, enter: int, leave: int) -> int:
    """Which of 16 boxes rays of the bounds may meet across one axis, between these depths."""
    d0, d1 = b.low[axis], b.high[axis]
    furthest = fma(splat(d1, 16), leave if d1 > np.float32(0.0) else enter, splat(b.origin_high[axis] + pad, 16))
    nearest = fma(splat(d0, 16), enter if d0 > np.float32(0.0) else leave, splat(b.origin_low[axis] - pad, 16))
    return (low <= furthest) & (high >= nearest)


@device
def _backs(polygons: Polygons, wave: Wave, count: int, b: Bounds) -> int:
    """Which polygons show their back to all rays, on closed convex pieces that all of them are outside of, as bits."""
    t, s = polygons.table, len(polygons.table) // _ROWS
    half = np.float32(0.5)
    zero = splat(np.float32(0.0), 16)
    low, high = b.origin_low, b.origin_high
    middle = half * (low[0] + high[0]), half * (low[1] + high[1]), half * (low[2] + high[2])
    extent = half * (high[0] - low[0]), half * (high[1] - low[1]), half * (high[2] - low[2])
    front = back = 0
    for k in range(0, s, LANES):
        n = k + _PLANE * s
        x, y, z = load(t, n, 16), load(t, n + s, 16), load(t, n + 2 * s, 16)
        height = fma(
            x, splat(middle[0], 16), fma(y, splat(middle[1], 16), fma(z, splat(middle[2], 16), load(t, n + 3 * s, 16)))
        )
        around = fma(
            magnitude(x),
            splat(extent[0], 16),
            fma(
                magnitude(y),
                splat(extent[1], 16),
                fma(magnitude(z), splat(extent[2], 16), load(t, k + _TILT * s, 16) * splat(np.float32(2.0) + b.r, 16)),
            ),
        )
        front |= bits(height > around) << k
        back |= bits(height < zero - around) << k
    hidden = 0
    for i in range(len(polygons.pieces)):
        if front & polygons.pieces[i] != 0:
            hidden |= back & polygons.pieces[i]
    # Who passes a front need not have met it before the back.
    if hidden != 0:
        for k in range(0, count, LANES):
            first, end, target = load(wave.first, k, 16), load(wave.end, k, 16), load(wave.target, k, 16)
            none = splat(np.int32(0), 16)
            left = bits((end > none) | (target >= none)) & first_bits(count - k)
            while left != 0:
                i = k + lowest_bit(left)
                for passed in range(max(wave.first[i], 0), min(wave.end[i], len(polygons.piece))):
                    hidden &= ~polygons.piece[passed]
                if 0 <= wave.target[i] < len(polygons.piece):
                    hidden &= ~polygons.piece[wave.target[i]]
                # Rays that pass and aim at the same are done with it.
                same = (first == splat(wave.first[i], 16)) & (end == splat(wave.end[i], 16))
                left &= ~bits(same & (target == splat(wave.target[i], 16)))
    return hidden


@device
def _candidates(polygons: Polygons, wave: Wave, count: int, b: Bounds) -> int:
    """Write the polygons that rays of these bounds may meet to `wave.candidates`; how many."""
    t, s = polygons.table, len(polygons.table) // _ROWS
    pad = np.float32(_PAD) * (np.float32(1.0) + b.r)
    hidden = _backs(polygons, wave, count, b) if len(polygons.pieces) > 0 else 0
    n = 0
    for k in range(0, s, LANES):
        low = load(t, k + _LOW * s, 16), load(t, k + (_LOW + 1) * s, 16), load(t, k + (_LOW + 2) * s, 16)
        high = load(t, k + _HIGH * s, 16), load(t, k + (_HIGH + 1) * s, 16), load(t, k + (_HIGH + 2) * s, 16)
        enter, leave = splat(np.float32(0.0), 16), splat(b.reach * np.float32(1.0 + 2.0**-20), 16)
        enter, leave = _between(0, low[0], high[0], b, pad, enter, leave)
        enter, leave = _between(1, low[1], high[1], b, pad, enter, leave)
        enter, leave = _between(2, low[2], high[2], b, pad, enter, leave)
        met = (enter <= leave) & _across(0, low[0], high[0], b, pad, enter, leave)
        met = met & _across(1, low[1], high[1], b, pad, enter, leave)
        met = met & _across(2, low[2], high[2], b, pad, enter, leave)
        found = bits(met) & ~(hidden >> k)
        while found != 0:
            wave.candidates[n] = k + lowest_bit(found)
            found &= found - 1
            n += 1
    return n


@device
def _lines(wave: Wave, k: int, target: int) -> Lines:
    """16 rays of a wave, and the faces that they aim at."""
    r = wave.scaled
    return Lines(
        (load(r, k, 16), load(r, SIZE + k, 16), load(r, 2 * SIZE + k, 16)),
        (load(r, 3 * SIZE + k, 16), load(r, 4 * SIZE + k, 16), load(r, 5 * SIZE + k, 16)),
        (load(r, 6 * SIZE + k, 16), load(r, 7 * SIZE + k, 16), load(r, 8 * SIZE + k, 16)),
        load(r, 9 * SIZE + k, 16),
        load(wave.first, k, 16),
        load(wave.end, k, 16),
        target,
    )


@subroutine
def _asked(polygons: Polygons, wave: Wave, count: int, far: float) -> tuple[int, int, np.float32]:
    """Prepare a wave: its rays that float32 can hold, as bits, how many candidates it has, and r."""
    held, bounds = _prepare(polygons, wave, count, far)
    return held, _candidates(polygons, wave, count, bounds), bounds.r


@device
def any_hits_among_polygons(polygons: Polygons, wave: Wave, count: int, far: float) -> int:
    """Write to `wave.found` what is sure of the first `count` rays; which are left in doubt, as bits."""
    held, n, r = _asked(polygons, wave, count, far)
    hits = doubts = 0
    for k in range(0, count, LANES):
        line = _lines(wave, k, load(wave.target, k, 16))
        left = (held >> k) & _ALL
        vague = 0
        for i in range(n):
            q = _polygon(polygons, entry(wave.candidates, i))
            s = _sides(q, line, r)
            maybe = _maybe(s) & left
            if maybe != 0:
                met, doubt = _met(q, line, s, maybe)
                left &= ~met
                vague |= doubt
                if left == 0:
                    break
        hits |= ((held >> k) & _ALL & ~left) << k
        doubts |= (vague & left) << k
    for i in range(count):
        wave.found[i] = (hits >> i) & 1 != 0
    return doubts | (first_bits(count) & ~held)


@device
def closest_hits_among_polygons(corners: np.ndarray, polygons: Polygons, wave: Wave, count: int, far: float) -> int:
    """Write the nearest hits of the first `count` rays; which are left in doubt, as bits."""
    held, n, r = _asked(polygons, wave, count, far)
    doubts = first_bits(count) & ~held
    zero = splat(np.float32(0.0), 16)
    for k in range(0, count, LANES):
        line = _lines(wave, k, splat(np.int32(-1), 16))
        best_low = _times(1.0 - 2.0**-20, line.reach)
        best_high = _times(1.0 + 2.0**-20, line.reach)
        best = splat(np.int32(-1), 16)
        doubt = splat(np.float32(_NOWHERE), 16)
        for i in range(n):
            q = _polygon(polygons, entry(wave.candidates, i))
            s = _sides(q, line, r)
            if _maybe(s) == 0:
                continue
            may, sure = _passed(q, line, s)
            may = may & (s.inner >= _times(-5.0, s.error))
            steady = s.size > _times(10.0, s.error)
            inverse = splat(np.float32(1.0), 16) / choose(steady, s.size, splat(np.float32(1.0), 16))
            t = _depth(q, line, s) * inverse
            error = _times(2.0, fma(magnitude(t), _times(4.0, s.error), s.depth_error)) * inverse
            error = fma(magnitude(t), splat(np.float32(2.0**-21), 16), error)
            low = choose(steady, t - error, zero)
            high = choose(steady, t + error, splat(np.float32(_NOWHERE), 16))
            may = may & (high > zero) & (low <= best_high)
            # Which of two triangles is met is sure beside their common edge.
            beside = (s.u > s.error) | (s.u < zero - s.error)
            sure = may & sure & beside & (s.inner > _times(5.0, s.error)) & (low > zero)
            nearer = sure & (high < best_low)
            doubt = choose(nearer, doubt, choose(may, minimum(low, doubt), doubt))
            best_low = choose(nearer, low, best_low)
            best_high = choose(nearer, high, best_high)
            best = choose(nearer, choose(s.u > zero, q.members[0], q.members[1]), best)
        store(wave.face, k, best)
        doubts |= (bits(doubt <= best_high) & (held >> k) & _ALL) << k
    for k in range(0, count, 8):
        _put_hits(corners, wave, k, far)
    return doubts


@device
def _turned(v: tuple, along_y: int, along_z: int, back: int) -> tuple:
    """Components kx, ky and kz of `make_ray`; the last axis is z, or else y, or else x, and is gone along backwards."""
    x, y = choose(along_z, v[0], choose(along_y, v[2], v[1])), choose(along_z, v[1], choose(along_y, v[0], v[2]))
    return choose(back, y, x), choose(back, x, y), choose(along_z, v[2], choose(along_y, v[1], v[0]))


@device
def _put_hits(corners: np.ndarray, wave: Wave, k: int, far: float) -> None:
    """Write distances and weights of what rays k ... k + 7 meet, by the expressions of `intersect_triangle`."""
    face = load(wave.face, k, 8)
    zero = splat(0.0, 8)
    a = b = c = zero, zero, zero
    none = face < splat(np.int32(0), 8)
    left = _EIGHT & ~bits(none)
    if left == 0:
        store(wave.t, k, splat(far, 8))
        store(wave.b1, k, zero)
        store(wave.b2, k, zero)
        return
    while left != 0:
        one = entry(wave.face, k + lowest_bit(left))
        mine = face == splat(np.int32(one), 8)
        left &= ~bits(mine)
        a = in_lanes(mine, vec3(corners[one], 0), a)
        b = in_lanes(mine, vec3(corners[one], 1), b)
        c = in_lanes(mine, vec3(corners[one], 2), c)
    o, d = rows(wave.origins, k), rows(wave.directions, k)
    along_y = magnitude(d[1]) > magnitude(d[0])
    main = choose(along_y, d[1], d[0])
    along_z = magnitude(d[2]) > magnitude(main)
    back = choose(along_z, d[2], main) < zero
    x, y, main = _turned(d, along_y, along_z, back)
    # 1 / main, whose magnitude `_prepare` knows.
    inverse = load(wave.shears, k, 8)
    inverse = choose(back, zero - inverse, inverse)
    shear = Shear(_turned(o, along_y, along_z, back), (x / main, y / main, inverse), 0, 0, 0)
    hit = edges(
        _turned(a, along_y, along_z, back),
        _turned(b, along_y, along_z, back),
        _turned(c, along_y, along_z, back),
        shear,
    )
    inverse = splat(1.0, 8) / hit.det
    store(wave.t, k, choose(none, splat(far, 8), distances(shear, hit, inverse)))
    store(wave.b1, k, choose(none, zero, hit.v * inverse))
    store(wave.b2, k, choose(none, zero, hit.w * inverse))


@device
def any_hit_among_polygons(polygons: Polygons, ray: Ray, far: float, ignore: FaceRange, target: int) -> int:
    """Whether a face other than `target` and those of `ignore` is hit at 0 < t < far: HIT, MISS or DOUBT."""
    x = (ray.origin.x - polygons.center.x) * polygons.scale
    y = (ray.origin.y - polygons.center.y) * polygons.scale
    z = (ray.origin.z - polygons.center.z) * polygons.scale
    length = abs(component(ray.direction, ray.kz))
    # The largest component decides, and the others are no larger unless they are NaN.
    known = abs(ray.direction.x) + abs(ray.direction.y) + abs(ray.direction.z) < _LONGEST
    if not (abs(x) + abs(y) + abs(z) < _FAR_AWAY and _SHORTEST < length and known):
        return DOUBT
    r = max(abs(x), max(abs(y), abs(z)))
    dx, dy, dz = ray.direction.x / length, ray.direction.y / length, ray.direction.z / length
    line = Lines(
        (splat(np.float32(x), 16), splat(np.float32(y), 16), splat(np.float32(z), 16)),
        (splat(np.float32(dx), 16), splat(np.float32(dy), 16), splat(np.float32(dz), 16)),
        (
            splat(np.float32(dy * z - dz * y), 16),
            splat(np.float32(dz * x - dx * z), 16),
            splat(np.float32(dx * y - dy * x), 16),
        ),
        splat(np.float32(min(far * length * polygons.scale, 2.0 * (1.0 + r))), 16),
        splat(np.int32(ignore.first), 16),
        splat(np.int32(ignore.end), 16),
        splat(np.int32(target), 16),
    )
    doubts = 0
    for first in range(0, polygons.count, LANES):
        q = _block(polygons, first)
        s = _sides(q, line, np.float32(r))
        maybe = _maybe(s) & first_bits(polygons.count - first)
        if maybe != 0:
            met, doubt = _met(q, line, s, maybe)
            if met != 0:
                return HIT
            doubts |= doubt
    return MISS if doubts == 0 else DOUBT
