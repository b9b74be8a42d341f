"""Intersection: no ray depends on scale, place or orientation, slips through a mesh, or meets the face it leaves.

Each row traces the same rays by the three descents of ours (the figure is the worst of the three), by the paper's loop
and by Embree. Errors of distance are relative, and 1 where one side hits and the other misses. The oracles are the
geometry at scale 1, closed forms, and rational arithmetic (`exact`).

What is to be expected: the paper's tests are absolute, 1e-5, so it loses what is small and near, and its angles open
gaps along edges. Mitsuba computes in float32, 2^-24 = 6e-8, and lifts a ray that leaves a surface by about
1e-4 (1 + |p|): it misses what is nearer than that.
"""

import functools
import math
import time
from collections.abc import Callable, Iterator

import numpy as np
import trimesh

from termwise.renderer.geometry import bvh
from termwise.reports.bench.rays import ball
from termwise.reports.stress import exact, tracers
from termwise.reports.stress.row import Row
from termwise.reports.stress.tracers import Found, Trace

# Of the distance, with room for 1 / cos up to 1e6: a hundred roundings are 1e-14.
PRECISION = 1e-9
# A long edge and the two short ones along it share no edge function: sheared, each corner is rounded by itself, and
# without slack a crack of some 2^-53 opens, through which one in a thousand of the rays aimed to the bit slips.
_JUNCTION_RAYS = 4096


def _row(name: str, figure: str, limit: float, measured: Callable[[Trace], float]) -> Row:
    """A row that all tracers take part in; ours is the worst of three."""
    return Row(
        name,
        figure,
        limit,
        lambda: max(measured(trace) for trace in tracers.OURS.values()),
        lambda: measured(tracers.all_faces),
        lambda: measured(tracers.embree),
    )


def _go(trace: Trace, corners: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> Found:
    """Trace rays that leave no face."""
    return trace(np.ascontiguousarray(corners), origins, directions, np.full(len(origins), -1, np.int32))


def _misses(found: Found) -> float:
    """Rays that one of the two queries, for the nearest and for any hit, lets through."""
    return float(((found.face < 0) | ~found.any).sum())


def _errors(t: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Relative differences of distances (N,), inf being a miss: 1 where one misses."""
    both = np.isfinite(t) & np.isfinite(expected)
    error = np.where(np.isfinite(t) == np.isfinite(expected), 0.0, 1.0)
    error[both] = np.minimum(np.abs(t[both] / expected[both] - 1.0), 1.0)
    return error


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def _around(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays from the sphere of radius 3 at points of the one of radius 1.2: most hit `ball`, some miss."""
    origins = 3.0 * _unit(rng.normal(size=(count, 3)))
    return origins, _unit(1.2 * rng.uniform(0, 1, (count, 1)) * _unit(rng.normal(size=(count, 3))) - origins)


def _rotation(rng: np.random.Generator) -> np.ndarray:
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.sign(np.diag(r))


def scales(count: int) -> Iterator[Row]:
    """t(s) = s t(1) for s = 1e-6 .. 1e6, faces equal: numbers keep 53 bits at any scale."""
    corners = ball(3)
    origins, directions = _around(np.random.default_rng(1), count)
    for power in range(-6, 7):
        scale = 10.0**power

        def error(trace: Trace, scale: float = scale) -> float:
            expected = _go(tracers.binary, corners, origins, directions).t
            found = _go(trace, scale * corners, scale * origins, directions)
            return float(_errors(found.t / scale, expected).max())

        yield _row(f"scale 1e{power}", "relative error of distance", PRECISION, error)


def offsets(count: int) -> Iterator[Row]:
    """Distances do not depend on the place T, but for the rounding of the vertices there.

    A vertex at T has an error of 2^-53 T, and a distance that over the cosine of incidence; with the origin's, and the
    shear's of both, 64 of them are allowed. Rays whose face or visibility flips are counted apart: an edge moves by as
    much, so with L/A < 200 the length of edges over the area that is seen, at most N 64 2^-53 T L / A, far below 1.
    """
    corners = ball(3)
    size = float((corners.max(axis=(0, 1)) - corners.min(axis=(0, 1))).max())
    origins, directions = _around(np.random.default_rng(2), count)
    normals = _unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))

    def both(trace: Trace, place: np.ndarray) -> tuple[Found, Found]:
        there = _go(trace, corners + place, origins + place, directions)
        return _go(tracers.binary, corners, origins, directions), there

    for offset in (0.0, *(10.0**power for power in range(7))):
        place = offset * size * np.array([1.0, -0.7, 0.4])

        def error(trace: Trace, offset: float = offset, place: np.ndarray = place) -> float:
            expected, found = both(trace, place)
            same = (found.face == expected.face) & (expected.face >= 0)
            cosine = np.abs((normals[expected.face] * directions).sum(axis=1))
            allowed = np.maximum(PRECISION, 64 * 2.0**-53 * offset / cosine)
            return float((_errors(found.t, expected.t) / allowed)[same].max(initial=0.0))

        def flips(trace: Trace, place: np.ndarray = place) -> float:
            expected, found = both(trace, place)
            return float((found.face != expected.face).sum())

        name = f"offset {offset:g} sizes"
        yield _row(name, "error of distance over max(1e-9, 64 roundings)", 1.0, error)
        yield _row(f"{name}: faces", f"rays of {count} that meet another face", 0.0, flips)


def speed(count: int) -> Iterator[Row]:
    """Rays a second are the same at any offset: boxes are kept relative to the scene's centre.

    Other work on the machine only adds: of 9 alternating pairs the least processor times count, and 20 % are allowed.
    """
    corners = ball(4)
    origins, directions = _around(np.random.default_rng(3), max(count, 2**14))
    for offset in (1e3, 1e6):
        moved = np.ascontiguousarray(corners + 2.0 * offset)

        def slower(moved: np.ndarray = moved, offset: float = offset) -> float:
            near, far = bvh.build(corners), bvh.build(moved)
            there = np.ascontiguousarray(origins + 2.0 * offset)
            seconds = []
            for _ in range(10):
                for mesh, tree, start in ((corners, near, origins), (moved, far, there)):
                    begin = time.process_time()
                    tracers.run_waves(mesh, tree, start, directions)
                    seconds.append(time.process_time() - begin)
            return min(seconds[3::2]) / min(seconds[2::2])  # the first two compile

        yield Row(f"speed at offset {offset:g} sizes", "time over that at offset 0", 1.2, slower, timed=True)


def rotations(count: int) -> Iterator[Row]:
    """Distances do not depend on the orientation of scene and ray together."""
    corners = ball(3)
    rng = np.random.default_rng(4)
    origins, directions = _around(rng, count)
    for index in range(6):
        turn = _rotation(rng).T

        def error(trace: Trace, turn: np.ndarray = turn) -> float:
            expected = _go(tracers.binary, corners, origins, directions).t
            found = _go(trace, corners @ turn, origins @ turn, directions @ turn)
            return float(_errors(found.t, expected).max())

        yield _row(f"rotation {index + 1}", "relative error of distance", PRECISION, error)


def slivers(count: int) -> Iterator[Row]:
    """A triangle of height h and base 1 is hit by rays aimed inside of it, at the exact distance, down to h = 1e-12.

    Its edge functions are h times those of h = 1, their errors are not: the weights of its corners err by some
    2^-53 / h, and the distance by as much times the depth of the base, less than 1: 64 of them are allowed.
    """
    rng = np.random.default_rng(5)
    rays = max(8, count // 40)
    weights = rng.dirichlet((4, 4, 4), rays)
    for power in range(13):
        height = 10.0**-power
        flat = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.4, height, 0.0]])
        corners = np.ascontiguousarray((flat @ _rotation(rng).T)[None])
        origins = rng.normal(size=(rays, 3)) + np.array([0.0, 0.0, 3.0])
        directions = weights @ corners[0] - origins

        def error(
            trace: Trace,
            corners: np.ndarray = corners,
            origins: np.ndarray = origins,
            directions: np.ndarray = directions,
        ) -> float:
            meetings = [exact.closest(corners, *ray) for ray in zip(origins, directions, strict=True)]
            # Rounded directions may pass the thinnest by: only what rational arithmetic meets is asked for.
            sure = np.array([meeting.t is not None and meeting.sure for meeting in meetings])
            expected = np.array([float(meeting.t or 1) for meeting in meetings])
            return float(_errors(_go(trace, corners, origins, directions).t, expected)[sure].max(initial=0.0))

        limit = max(PRECISION, 64 * 2.0**-53 / height)
        yield _row(f"sliver h = 1e-{power}", "relative error of distance, exact arithmetic", limit, error)


def degenerate(count: int) -> Iterator[Row]:
    """Faces without area are as if they were not there; of equal distances the lower face counts."""
    rng = np.random.default_rng(6)
    real = ball(2)
    origins, directions = _around(rng, count)
    low = rng.integers(-8, 8, (200, 1, 3)) / 8.0
    step = rng.integers(-8, 8, (200, 1, 3)) / 8.0
    kinds = {
        "points": np.repeat(low, 3, axis=1),
        "repeated vertices": np.concatenate([low, low + step, low + step], axis=1),
        "needles": np.concatenate([low, low + step, low + 2 * step], axis=1),
    }
    for name, faces in kinds.items():
        # In a random order, so that they share leaves with real ones; half of the rays are aimed at them.
        corners = np.concatenate([real, faces])[rng.permutation(len(real) + len(faces))]
        half = len(origins) // 2
        aimed = np.array(directions)
        target = faces[rng.integers(0, len(faces), half)]
        aimed[:half] = np.einsum("nc,ncx->nx", rng.dirichlet((1, 1, 1), half), target) - origins[:half]

        def changed(trace: Trace, corners: np.ndarray = corners, aimed: np.ndarray = aimed) -> float:
            without = _go(trace, real, origins, aimed).t
            return float((_go(trace, corners, origins, aimed).t != without).sum())

        yield _row(f"no area: {name}", f"rays of {count} whose hit they change", 0.0, changed)

    which = rng.permutation(np.repeat(np.arange(len(real)), 3))
    lowest = np.array([np.flatnonzero(which == each)[0] for each in range(len(real))])

    def not_lowest(trace: Trace) -> float:
        found = _go(trace, real[which], origins, directions)
        hit = found.face >= 0
        return float((lowest[which[found.face[hit]]] != found.face[hit]).sum())

    yield _row("duplicate faces", f"rays of {count} that do not meet the lowest index", 0.0, not_lowest)

    # Many triangles of one plane, overlapping: the distance is the plane's.
    plane = np.concatenate([rng.uniform(-1, 1, (60, 3, 2)), np.zeros((60, 3, 1))], axis=2)
    turn = _rotation(rng)
    start = np.c_[rng.uniform(-0.2, 0.2, (count, 2)), rng.uniform(0.5, 2.0, count)]
    way = np.c_[rng.uniform(-0.2, 0.2, (count, 2)), -np.ones(count)]

    def off_plane(trace: Trace) -> float:
        found = _go(trace, plane @ turn.T, start @ turn.T, way @ turn.T)
        return float(_errors(found.t, start[:, 2])[found.face >= 0].max(initial=0.0))

    yield _row("coplanar overlapping faces", "relative error of distance", PRECISION, off_plane)

    few = max(8, count // 64)
    single = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    many = np.tile(single, (100_000, 1, 1))
    above = np.c_[rng.dirichlet((1, 1, 1), few)[:, :2], np.ones(few)]
    down = np.tile([0.0, 0.0, -1.0], (few, 1))

    def not_first(trace: Trace) -> float:
        return float((_go(trace, many, above, down).face != 0).sum())

    yield _row("100 000 equal centroids", f"rays of {few} that do not meet face 0", 0.0, not_first)


def few_faces(count: int) -> Iterator[Row]:
    """Nothing is hit in an empty scene; one triangle is hit by exactly the rays that meet it."""
    rng = np.random.default_rng(7)
    origins, directions = _around(rng, count)
    nothing = np.zeros((0, 3, 3))

    def hits(trace: Trace) -> float:
        found = _go(trace, nothing, origins, directions)
        return float(((found.face >= 0) | found.any | np.isfinite(found.t)).sum())

    yield _row("empty scene", f"rays of {count} that hit something", 0.0, hits)

    rays = max(32, count // 10)
    corners = rng.normal(size=(1, 3, 3))
    starts = rng.normal(scale=2.0, size=(rays, 3))
    aims = rng.dirichlet((0.6, 0.6, 0.6), rays) @ corners[0] + rng.normal(scale=0.3, size=(rays, 3))

    def wrong(trace: Trace) -> float:
        return _against_exact(trace, corners, starts, aims - starts)

    yield _row("one triangle", f"rays of {rays} that exact arithmetic contradicts", 0.0, wrong)


def _against_exact(trace: Trace, corners: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> float:
    """Rays whose face is none of the exact ones, or whose distance errs; those that float64 cannot decide are left out.

    A distance may err by 1e-9, or by 64 roundings of the coordinates it is made of.
    """
    found = _go(trace, corners, origins, directions)
    wrong = 0
    for ray in range(len(origins)):
        meeting = exact.closest(corners, origins[ray], directions[ray])
        if not meeting.sure:
            continue
        if meeting.t is None:
            wrong += int(found.face[ray] >= 0 or bool(found.any[ray]))
            continue
        allowed = max(PRECISION, 64 * 2.0**-53 * meeting.condition)
        near = abs(found.t[ray] / float(meeting.t) - 1.0) <= allowed
        wrong += not (near and bool(found.any[ray]) and found.face[ray] in meeting.faces)
    return float(wrong)


def magnitudes(count: int) -> Iterator[Row]:
    """Triangles whose coordinates are ±10^U(-8, 8), each its own: the face and distance of rational arithmetic.

    Rays are aimed at points of faces, from points of the same kind. Those that pass within the rounding error of an
    edge of any face are left out; the second row says that they are few.
    """
    rng = np.random.default_rng(8)
    faces, rays = 40, max(16, count // 40)

    def numbers(*shape: int) -> np.ndarray:
        return rng.choice([-1.0, 1.0], shape) * 10.0 ** rng.uniform(-8, 8, shape)

    corners = numbers(faces, 3, 3)
    target = corners[rng.integers(0, faces, rays)]
    origins = numbers(rays, 3)
    directions = np.einsum("nc,ncx->nx", rng.dirichlet((1, 1, 1), rays), target) - origins
    yield _row(
        "vertices 10^U(-8, 8)",
        f"rays of {rays} that exact arithmetic contradicts",
        0.0,
        lambda trace: _against_exact(trace, corners, origins, directions),
    )
    yield Row(
        "vertices 10^U(-8, 8): left out",
        f"share of {rays} rays that float64 cannot decide",
        0.25,  # a test that leaves out many of its rays tests little
        lambda: float(
            np.mean([not exact.closest(corners, *ray).sure for ray in zip(origins, directions, strict=True)])
        ),
    )


def _closed() -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Closed meshes by name: vertices, faces, edges (E, 2) and a point inside."""
    found = {}
    for name, mesh, inside in (
        ("sphere", trimesh.creation.icosphere(subdivisions=3), (0.05, -0.03, 0.02)),
        ("box", trimesh.creation.box(), (0.05, -0.03, 0.02)),
        ("torus", trimesh.creation.torus(1.0, 0.4, major_sections=24, minor_sections=12), (1.0, 0.0, 0.0)),
    ):
        arrays = (mesh.vertices, mesh.faces, mesh.edges_unique, inside)
        found[name] = tuple(np.array(each) for each in arrays)
    return found


def _split_box() -> tuple[np.ndarray, np.ndarray]:
    """A cube whose top is a fan to the thirds and sevenths of its edges, which the sides do not share: T-junctions.

    Returns corners (F, 3, 3) and the junctions (J, 3). Every edge is parallel to an axis, so each junction lies
    exactly on the side's edge.
    """
    box = trimesh.creation.box()
    top = (box.vertices[box.faces][:, :, 2] == 0.5).all(axis=1)
    square = np.array([[-0.5, -0.5, 0.5], [0.5, -0.5, 0.5], [0.5, 0.5, 0.5], [-0.5, 0.5, 0.5]])
    rim, junctions = [], []
    for a, b in zip(square, np.roll(square, -1, axis=0), strict=True):
        points = [np.where(a == b, a, a + share * (b - a)) for share in (1 / 7, 1 / 3, 2 / 3)]
        rim += [a, *points]
        junctions += points
    centre = np.array([0.0, 0.0, 0.5])
    fan = [np.stack([centre, p, q]) for p, q in zip(rim, rim[1:] + rim[:1], strict=True)]
    return np.concatenate([box.vertices[box.faces[~top]], np.array(fan)]), np.array(junctions)


def watertight(count: int) -> Iterator[Row]:
    """From inside a closed mesh nothing escapes, through edges, vertices or T-junctions, at any scale and offset."""
    rng = np.random.default_rng(9)
    most = max(64, count)
    for name, (vertices, faces, edges, inside) in _closed().items():
        weight = rng.uniform(size=(len(edges), 1))
        for scale, offset in ((1e-6, 0.0), (1.0, 0.0), (1e6, 0.0), (1.0, 10.0), (1.0, 1e4), (1e-6, 1e4)):
            # Of the mesh as it is rounded there.
            moved = scale * (vertices + offset)
            ends = moved[edges]
            targets = {
                "edges": weight * ends[:, 0] + (1 - weight) * ends[:, 1],
                "edge midpoints": ends.mean(axis=1),
                "vertices": moved,
            }
            for what, aims in targets.items():
                aims = aims[rng.permutation(len(aims))[:most]]
                origin = np.tile(scale * (inside + offset), (len(aims), 1))

                def missed(
                    trace: Trace,
                    corners: np.ndarray = moved[faces],
                    origin: np.ndarray = origin,
                    aims: np.ndarray = aims,
                ) -> float:
                    return _misses(_go(trace, corners, origin, aims - origin))

                place = f"scale {scale:g}" + (f", offset {offset:g}" if offset else "")
                yield _row(f"{name}: {what}, {place}", f"rays of {len(aims)} that miss", 0.0, missed)

    corners, junctions = _split_box()
    aims = np.repeat(junctions, _JUNCTION_RAYS // len(junctions), axis=0)
    origins = rng.uniform(-0.4, 0.4, aims.shape)
    beside = aims + 10.0 ** rng.uniform(-12, -3, (len(aims), 1)) * rng.normal(size=aims.shape)
    for scale in (1e-6, 1.0, 1e6):

        def leaked(trace: Trace, scale: float = scale, aims: np.ndarray = aims) -> float:
            return _misses(_go(trace, scale * corners, scale * origins, scale * aims - scale * origins))

        figure = f"rays of {len(aims)} that miss"
        yield _row(f"T-junctions, scale {scale:g}", figure, 0.0, functools.partial(leaked, aims=beside))
        yield _row(f"T-junctions, scale {scale:g}, to the bit", figure, 0.0, leaked)


def directions(count: int) -> Iterator[Row]:
    """Rays along axes, with zeros of both signs, from the planes of boxes: all hit, at the exact distance.

    A grid of unit squares at height 0: every ray starts over a grid line, a grid point or a middle, where boxes end.
    And t(2^k d) = 2^-k t(d), to the bit, for |k| <= 1000: numbers and their products with lengths are normal there.
    Beyond, the reciprocals of components leave the range of float64, so boxes may be missed; the descent ends, and
    no distance is NaN.
    """
    n = 8
    corner = np.stack(np.meshgrid(np.arange(n), np.arange(n)), axis=-1).reshape(-1, 1, 2)
    square = corner + np.array([[[0, 0], [1, 0], [1, 1], [0, 1]]])
    place = np.stack(np.meshgrid(np.arange(0, n + 0.1, 0.5), np.arange(0, n + 0.1, 0.5)), -1).reshape(-1, 2)
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        grid = np.zeros((2 * n * n, 3, 3))
        for part, ends in enumerate(([0, 1, 2], [0, 2, 3])):
            grid[part::2, :, u], grid[part::2, :, v] = square[:, ends, 0], square[:, ends, 1]
        for sign in (1.0, -1.0):
            for zero in (0.0, -0.0):
                origins = np.zeros((len(place), 3))
                origins[:, u], origins[:, v], origins[:, axis] = place[:, 0], place[:, 1], -sign * 2.5
                way = np.full((len(place), 3), zero)
                way[:, axis] = sign

                def wrong(
                    trace: Trace, grid: np.ndarray = grid, origins: np.ndarray = origins, way: np.ndarray = way
                ) -> float:
                    found = _go(trace, grid, origins, way)
                    return float(((found.t != 2.5) | ~found.any).sum())

                name = f"along {'+' if sign > 0 else '-'}{'xyz'[axis]}, zeros {zero:+.0f}"
                yield _row(name, f"rays of {len(place)} that do not hit at 2.5", 0.0, wrong)

    corners = ball(3)
    origins, unit = _around(np.random.default_rng(10), count)
    for power in (-1000, -600, -100, 100, 600, 1000):
        longer = np.ldexp(unit, power)

        def changed(trace: Trace, power: int = power, longer: np.ndarray = longer) -> float:
            expected, found = _go(trace, corners, origins, unit), _go(trace, corners, origins, longer)
            bits = (np.ldexp(found.t, power) != expected.t) | (found.face != expected.face)
            return float((bits | (found.any != expected.any)).sum())

        yield _row(f"direction times 2^{power}", f"rays of {count} whose bits change", 0.0, changed)

    for power in (-1060, -1020, 1020):
        longer = np.ldexp(unit, power)

        def no_number(trace: Trace, longer: np.ndarray = longer) -> float:
            found = _go(trace, corners, origins, longer)
            return float((np.isnan(found.t) | ((found.face < 0) & np.isfinite(found.t))).sum())

        yield _row(f"direction times 2^{power}", f"rays of {count} of a distance that is none", 0.0, no_number)

    # Denormal components beside a normal one are as good as zeros.
    main = np.abs(unit) == np.abs(unit).max(axis=1, keepdims=True)
    straight = np.where(main, np.sign(unit), 0.0)
    starts = -2.0 * straight + np.random.default_rng(11).uniform(-0.4, 0.4, straight.shape)
    for tiny in (5e-324, -1e-310, 1e-300):
        slanted = np.where(main, np.sign(unit), tiny)

        def error(trace: Trace, slanted: np.ndarray = slanted) -> float:
            expected = _go(tracers.binary, corners, starts, straight).t
            return float(_errors(_go(trace, corners, starts, slanted).t, expected).max())

        yield _row(f"components of {tiny:g}", "relative error of distance", PRECISION, error)


def origins_on_surfaces(count: int) -> Iterator[Row]:
    """From a point on a face of the unit cube inwards: the opposite walls, at the distance of the slab formula.

    Points are multiples of 1/64 and lie on the planes of the cube and of its tree's boxes; the own face is ignored,
    its neighbour in the same plane is not.
    """
    rng = np.random.default_rng(12)
    box = trimesh.creation.box()
    corners = np.array(box.vertices[box.faces])
    face = rng.integers(0, len(corners), count).astype(np.int32)
    first, second = rng.integers(1, 31, (2, count))
    weights = np.stack([64 - first - second, first, second], axis=1) / 64.0
    origins = np.einsum("nc,ncx->nx", weights, corners[face])
    way = _unit(rng.normal(size=(count, 3)))
    way *= np.sign((way * -np.array(box.face_normals)[face]).sum(axis=1, keepdims=True))
    walls = (np.copysign(0.5, way) - origins) / way
    expected = np.where(walls > 0, walls, np.inf).min(axis=1)

    def error(trace: Trace) -> float:
        return float(_errors(trace(corners, origins, way, face).t, expected).max())

    yield _row("origins on surfaces", "relative error of distance", PRECISION, error)


def spawned(count: int) -> Iterator[Row]:
    """1000 rays from each hit, of any slope down to 1e-6: none meets the face that it leaves, whatever the scale.

    From a convex mesh none meets anything. Against a wall at a gap g above it all meet the wall, however small g is.
    """
    rng = np.random.default_rng(13)
    hits, each = max(4, count // 80), 1000
    sphere = trimesh.creation.icosphere(subdivisions=2)
    for name, mesh, grazing in (
        ("bumpy ball", ball(3), 1e-6),
        ("convex ball", np.array(sphere.vertices[sphere.faces]), 2e-3),
    ):
        normals = _unit(np.cross(mesh[:, 1] - mesh[:, 0], mesh[:, 2] - mesh[:, 0]))
        leaving = np.repeat(rng.integers(0, len(mesh), hits), each).astype(np.int32)
        weights = np.repeat(rng.dirichlet((1, 1, 1), hits), each, axis=0)
        tangent = _unit(np.cross(normals[leaving], rng.normal(size=(len(leaving), 3))))
        slope = 10.0 ** rng.uniform(math.log10(grazing), 1.0, (len(leaving), 1))
        way = _unit(tangent + slope * normals[leaving])
        convex = name == "convex ball"
        for scale, offset in ((1e-6, 0.0), (1.0, 0.0), (1e6, 0.0), (1.0, 1e3), (1.0, 1e6)):

            def again(
                trace: Trace,
                moved: np.ndarray = scale * (mesh + offset),
                weights: np.ndarray = weights,
                leaving: np.ndarray = leaving,
                way: np.ndarray = way,
                convex: bool = convex,
            ) -> float:
                points = np.einsum("nc,ncx->nx", weights, moved[leaving])
                found = trace(moved, points, way, leaving)
                return float(found.any.sum() if convex else (found.face == leaving).sum())

            place = f"scale {scale:g}" + (f", offset {offset:g}" if offset else "")
            figure = f"rays of {len(leaving)} that hit {'anything' if convex else 'their own face'}"
            yield _row(f"spawned from a {name}, {place}", figure, 0.0, again)

    turn = _rotation(rng)
    rim = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    lower = rim[[[0, 1, 2], [0, 2, 3]]]
    rays = max(64, count)
    leaving = rng.integers(0, 2, rays).astype(np.int32)
    weights = rng.dirichlet((4, 4, 4), rays)
    # At most 55 degrees from the normal: they meet the wall, which is three times as wide.
    way = _unit(np.c_[rng.uniform(-1, 1, (rays, 2)), np.ones(rays)] @ turn.T)
    for power in range(-1, -14, -2):
        upper = lower * np.array([3.0, 3.0, 0.0]) + np.array([0.0, 0.0, 10.0**power])
        walls = np.concatenate([lower, upper]) @ turn.T

        def passed(trace: Trace, walls: np.ndarray = walls) -> float:
            points = np.einsum("nc,ncx->nx", weights, walls[leaving])
            found = trace(walls, points, way, leaving)
            return float(((found.face < 2) | ~found.any).sum())

        yield _row(f"a wall at a gap of 1e{power}", f"rays of {rays} that pass it", 0.0, passed)


def rows(count: int) -> Iterator[Row]:
    """All rows of the group, of about `count` rays each."""
    for make in (
        scales,
        offsets,
        speed,
        rotations,
        slivers,
        degenerate,
        few_faces,
        magnitudes,
        watertight,
        directions,
        origins_on_surfaces,
        spawned,
    ):
        yield from make(count)
