"""Rays per second, ours against Mitsuba's (Embree): rate = rays / seconds, ratio = ours / theirs, for the same rays.

Both sides run on the same number of threads in one process, in alternating pairs, because other work on the machine
slows both members of a pair alike; the ratio of a case is the median over its pairs. Mitsuba's robust flag is what
makes Embree watertight, as ours always is, so the ratio that counts is the one with it; the one with default flags
stands beside it. Mitsuba is told that rays are coherent where that makes it faster. Both trace arrays of rays: ours by
`renderer.geometry.rays`, in the waves that render kernels trace.
"""

import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from termwise.renderer.by_reference import Packed, pack
from termwise.renderer.geometry import bvh
from termwise.renderer.geometry.rays import any_hits, closest_hits
from termwise.renderer.geometry.wave import new_wave
from termwise.reports.bench.common import BACKEND, known, machine, positive, timed
from termwise.scenes.load import load

KINDS = ("primary", "diffuse", "shadow", "ao")
PAIRS = 7
RAYS = 2**19
# Rays of one occlusion origin.
_FAN = 64
# Pixels along the edge of a block whose camera rays follow each other.
_BLOCK = 8
# Seconds of a side's part of a pair: a shorter one runs at once on all cores where a longer one shares them.
_SHORTEST = 0.2
# Rays that a thread takes at a time.
_CHUNK = 2**15


class Rays(NamedTuple):
    """Arrays (N, 3) of float32, as both sides read them; `far` in lengths of direction.

    `coherent`: those that follow each other go the same way, as our kernels say of such rays.
    """

    origins: np.ndarray
    directions: np.ndarray
    far: float
    coherent: bool


class Prepared(NamedTuple):
    """Triangles (F, 3, 3) with our tree."""

    corners: np.ndarray
    tree: bvh.Tree
    build_seconds: float


def meshes() -> dict[str, Callable[[], np.ndarray]]:
    """Triangles (F, 3, 3) by name, float32 numbers; displaced, so that rays meet concave places and silhouettes."""
    return {
        "boxes": _boxes,
        "monkey": lambda: _monkey(0),
        "ball-20k": lambda: ball(5),
        "ball-328k": lambda: ball(7),
        "monkey-1m": lambda: _monkey(5),
    }


def _boxes() -> np.ndarray:
    import trimesh

    boxes = [
        trimesh.creation.box((4.0, 4.0, 0.2)),
        trimesh.creation.box((1.0, 1.0, 1.0)),
        trimesh.creation.box((0.7, 0.7, 1.8)),
    ]
    for box, offset, angle in zip(boxes, ((0, 0, -0.6), (-0.7, -0.4, 0), (0.8, 0.6, 0.4)), (0, 0.4, -0.3), strict=True):
        box.apply_transform(trimesh.transformations.rotation_matrix(angle, (0, 0, 1)))
        box.apply_translation(offset)
    return _round(np.concatenate([box.vertices[box.faces] for box in boxes]))


def ball(subdivisions: int) -> np.ndarray:
    """A bumpy ball around the origin, its radius 1 on average: (20 * 4^subdivisions, 3, 3), float32 numbers."""
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
    return _round(_displace(sphere.vertices, sphere.vertices, 0.15)[sphere.faces])


def _monkey(subdivisions: int) -> np.ndarray:
    import trimesh

    mesh = next(thing.mesh for thing in load("monkey").objects if len(thing.mesh.faces) > 100)
    faces = trimesh.Trimesh(mesh.vertices, mesh.faces)
    for _ in range(subdivisions):
        faces = faces.subdivide()
    vertices = faces.vertices
    if subdivisions:
        vertices = _displace(vertices, faces.vertex_normals, 0.03)
    return _round(vertices[faces.faces])


def _displace(vertices: np.ndarray, normals: np.ndarray, height: float) -> np.ndarray:
    """Bumps of three wavelengths, each a third of the last one's height and length."""
    moved = np.array(vertices)
    for octave in range(3):
        wave = np.sin(5.0 * 3.0**octave * vertices + octave).prod(axis=1, keepdims=True)
        moved += height / 3.0**octave * wave * normals
    return moved


def _round(values: np.ndarray) -> np.ndarray:
    return values.astype(np.float32).astype(np.float64)


def prepare(corners: np.ndarray) -> Prepared:
    """Build our tree."""
    start = time.perf_counter()
    tree = bvh.build(corners)
    return Prepared(corners, tree, time.perf_counter() - start)


def rays_of(kind: str, mesh: Prepared, count: int) -> Rays:
    """About `count` rays: through a camera's pixels in blocks of 8 x 8, or leaving the points that those see.

    Both sides trace blocks in less time than rows of pixels (0.6 to 1 of it ours, 0.7 to 1.1 Mitsuba's).

    diffuse: cosine directions; shadow: to points of a square light; ao: `_FAN` cosine directions from one point,
    as far as half of the mesh's extent. Points are lifted by 1e-4 of the extent, so that neither side meets the face
    that a ray leaves.
    """
    rng = np.random.default_rng(1)
    low, high = mesh.corners.min(axis=(0, 1)), mesh.corners.max(axis=(0, 1))
    centre, extent = (low + high) / 2, float((high - low).max())
    eye = centre + extent * np.array([0.5, -1.2, 0.7])
    side = -(-int(np.sqrt(count)) // _BLOCK) * _BLOCK
    row, block_row, column, block_column = np.indices((side // _BLOCK, _BLOCK) * 2)
    order = (0, 2, 1, 3)
    x = (_BLOCK * column + block_column).transpose(order).ravel() / side - 0.5
    y = (_BLOCK * row + block_row).transpose(order).ravel() / side - 0.5
    forward = (centre - eye) / np.linalg.norm(centre - eye)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    directions = forward + 0.75 * (x[:, None] * right - y[:, None] * up)
    primary = Rays(
        np.full(directions.shape, eye, np.float32),
        (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32),
        np.inf,
        coherent=True,
    )
    if kind == "primary":
        return primary
    t, face = np.empty(len(directions)), np.empty(len(directions), np.int32)
    closest_hits(mesh.corners, mesh.tree, primary.origins, primary.directions, np.inf, t, face, new_wave(), True)
    hit = np.flatnonzero(face >= 0)
    if kind == "ao":
        # Every 64th pixel of a row or so, each with its fan.
        hit = np.repeat(hit[:: max(1, len(hit) * _FAN // count)], _FAN)
    else:
        # As many rays as the other kinds have, in the pixels' order.
        hit = np.sort(np.concatenate([hit, rng.choice(hit, max(0, count - len(hit)))]))
    edges = mesh.corners[face[hit]]
    normals = np.cross(edges[:, 1] - edges[:, 0], edges[:, 2] - edges[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals *= -np.sign((normals * primary.directions[hit]).sum(axis=1, keepdims=True))
    points = primary.origins[hit] + t[hit, None] * primary.directions[hit] + 1e-4 * extent * normals
    if kind == "shadow":
        light = centre + extent * np.array([0.6, -0.4, 1.5])
        light = light + extent * 0.4 * np.c_[rng.uniform(-0.5, 0.5, (len(hit), 2)), np.zeros(len(hit))]
        return Rays(points.astype(np.float32), (light - points).astype(np.float32), 1.0, coherent=True)
    # A point of the unit sphere added to the normal is cosine-weighted.
    sphere = rng.normal(size=points.shape)
    cosine = normals + sphere / np.linalg.norm(sphere, axis=1, keepdims=True)
    cosine /= np.linalg.norm(cosine, axis=1, keepdims=True)
    far = 0.5 * extent if kind == "ao" else np.inf
    return Rays(points.astype(np.float32), cosine.astype(np.float32), far, coherent=False)


def is_any(kind: str) -> bool:
    """Whether rays of this kind ask for any hit and not for the nearest."""
    return kind in ("shadow", "ao")


class Ours:
    """Our side of a case: `run()` traces all rays on `threads` threads, those of `pool`."""

    def __init__(self, mesh: Prepared, rays: Rays, *, any_hit: bool, pool: ThreadPoolExecutor, threads: int) -> None:
        self.mesh, self.rays, self.pool, self.threads = mesh, rays, pool, threads
        count = len(rays.origins)
        self.t, self.face = np.empty(count), np.empty(count, np.int32)
        self.found = np.empty(count, np.bool_)
        self._trace = self._any if any_hit else self._closest
        # A thread that renders has its wave before it traces, and to make one takes as long as some 10 thousand rays.
        self._tree = pack(mesh.tree)
        self._chunks = [(slice(i, i + _CHUNK), pack(new_wave())) for i in range(0, count, _CHUNK)]

    def _closest(self, chunk: tuple[slice, Packed]) -> None:
        mesh, rays = self.mesh, self.rays
        part, wave = chunk
        closest_hits(
            mesh.corners,
            self._tree,
            rays.origins[part],
            rays.directions[part],
            rays.far,
            self.t[part],
            self.face[part],
            wave,
            rays.coherent,
        )

    def _any(self, chunk: tuple[slice, Packed]) -> None:
        mesh, rays = self.mesh, self.rays
        part, wave = chunk
        any_hits(
            mesh.corners,
            self._tree,
            rays.origins[part],
            rays.directions[part],
            rays.far,
            self.found[part],
            wave,
            rays.coherent,
        )

    def run(self) -> None:
        """Trace all rays once.

        A thread that is done takes the next chunk, as those that render take tiles. Handed to the pool one by one
        chunks of few polygons took 1.15 and 1.4 times as long.
        """
        chunks = iter(self._chunks)
        for taker in [self.pool.submit(self._take, chunks) for _ in range(self.threads)]:
            taker.result()

    def _take(self, chunks: Iterator[tuple[slice, Packed]]) -> None:
        for chunk in chunks:
            self._trace(chunk)

    def hits(self, *, any_hit: bool) -> np.ndarray:
        """Which rays hit something."""
        return self.found if any_hit else self.face >= 0


def embree_scene(mi: Any, corners: np.ndarray, *, robust: bool) -> Any:
    """Triangles (F, 3, 3) in float32 as a scene of Mitsuba's."""
    mesh = mi.Mesh("mesh", vertex_count=3 * len(corners), face_count=len(corners))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = corners.astype(np.float32).ravel()
    parameters["faces"] = np.arange(3 * len(corners), dtype=np.uint32)
    parameters.update()
    return mi.load_dict({"type": "scene", "embree_use_robust_intersections": robust, "mesh": mesh})


class Theirs:
    """Mitsuba's side of a case, with or without the robust flag."""

    def __init__(self, corners: np.ndarray, *, robust: bool) -> None:
        from termwise.reference.backend import import_mitsuba

        self.mi: Any = import_mitsuba(BACKEND)
        mi = self.mi
        self.scene = embree_scene(mi, corners, robust=robust)

    def case(self, rays: Rays, *, any_hit: bool) -> "Case":
        """Bind rays."""
        return Case(self, rays, any_hit)


class Case:
    """Rays on Mitsuba's side."""

    def __init__(self, side: Theirs, rays: Rays, any_hit: bool) -> None:
        import drjit as dr

        mi = side.mi
        self.dr: Any = dr
        self.scene, self.any_hit = side.scene, any_hit
        far = mi.Float(rays.far) if np.isfinite(rays.far) else mi.Float(3.4e38)
        self.ray = mi.Ray3f(mi.Point3f(rays.origins.T.copy()), mi.Vector3f(rays.directions.T.copy()), 0.0, [])
        self.ray.maxt = far
        dr.eval(self.ray)
        self.coherent = False
        seconds = []
        for flag in (False, True):
            self.coherent = flag
            self.run()  # compiles
            seconds.append(min(timed(self.run, 1)[0] for _ in range(3)))
        self.coherent = seconds[1] < seconds[0]

    def run(self) -> None:
        """Trace all rays once."""
        if self.any_hit:
            self.result = self.scene.ray_test(self.ray, self.coherent, True)
        else:
            found = self.scene.ray_intersect_preliminary(self.ray, self.coherent)
            self.result = (found.t, found.prim_index, found.shape)
        self.dr.eval(self.result)
        self.dr.sync_thread()

    def hits(self) -> np.ndarray:
        """Which rays hit something."""
        result = self.result if self.any_hit else self.result[0] < np.inf
        return np.array(result)


def measure(
    *,
    threads: int | None = None,
    pairs: int = PAIRS,
    count: int = RAYS,
    only: tuple[str, ...] = (),
    report: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> dict[str, Any]:
    """Measure all cases; JSON values.

    Parameters
    ----------
    threads : threads of each side; None: one a core.
    pairs : alternating pairs a case; their median counts.
    count : rays of a case, about.
    only : names of meshes; all if none.
    report : called with (what runs, done, total).
    """
    from termwise.reference.backend import import_mitsuba

    positive(pairs=pairs, count=count, threads=1 if threads is None else threads)
    threads = threads or os.cpu_count() or 1
    made = meshes()
    known("mesh", only, made)
    import_mitsuba(BACKEND)
    import drjit as dr  # reads which LLVM to use when it is first imported, so after the backend has chosen

    dr.set_thread_count(threads)
    about = machine(threads)
    prepare(_boxes())  # compiles the builder
    cases: list[dict[str, Any]] = []
    builds: list[dict[str, Any]] = []
    names = only or tuple(made)
    with ThreadPoolExecutor(threads) as pool:
        for place, name in enumerate(names):
            report(name, place, len(names))
            mesh = prepare(made[name]())
            builds.append(_build_row(name, mesh))
            sides = {"robust": Theirs(mesh.corners, robust=True), "default": Theirs(mesh.corners, robust=False)}
            for kind in KINDS:
                rays = rays_of(kind, mesh, count)
                cases.append({"mesh": name, "triangles": len(mesh.corners), "kind": kind})
                cases[-1] |= _compare(mesh, rays, sides, kind, pairs, pool, threads)
    about["load_end"] = os.getloadavg()[0]
    settings = {"pairs": pairs, "count": count}
    return {"cases": cases, "builds": builds, "machine": about, "settings": settings}


def _build_row(name: str, mesh: Prepared) -> dict[str, Any]:
    faces = len(mesh.corners)
    return {
        "mesh": name,
        "triangles": faces,
        "seconds": mesh.build_seconds,
        "bytes_per_triangle": bvh.bytes_of(mesh.tree) / faces,
    }


def _compare(
    mesh: Prepared, rays: Rays, sides: dict[str, Theirs], kind: str, pairs: int, pool: ThreadPoolExecutor, threads: int
) -> dict[str, Any]:
    any_hit = is_any(kind)
    mine = Ours(mesh, rays, any_hit=any_hit, pool=pool, threads=threads)
    theirs = {flags: side.case(rays, any_hit=any_hit) for flags, side in sides.items()}
    runs = [mine.run, *(case.run for case in theirs.values())]
    times = [max(1, round(_SHORTEST / min(timed(run, 1)[0] for _ in range(3)))) for run in runs]
    # (pairs, side, wall and processor)
    seconds = np.array([[timed(*each) for each in zip(runs, times, strict=True)] for _ in range(pairs)])
    rates = len(rays.origins) / 1e6 / np.median(seconds[:, :, 0], axis=0)
    ratio = seconds[:, 1] / seconds[:, 0]
    differ = mine.hits(any_hit=any_hit) != theirs["robust"].hits()
    return {
        "rays": len(rays.origins),
        "ours_mrays": float(rates[0]),
        "mitsuba_mrays": float(rates[1]),
        "ratio": float(np.median(ratio[:, 0])),
        "ratio_low": float(ratio[:, 0].min()),
        "ratio_high": float(ratio[:, 0].max()),
        # Processor time is blind to what else the machine does, and to threads that wait.
        "ratio_processor": float(np.median(ratio[:, 1])),
        "pairs": pairs,
        "coherent": theirs["robust"].coherent,
        "mitsuba_default_mrays": float(rates[2]),
        "ratio_default": float(np.median(seconds[:, 2, 0] / seconds[:, 0, 0])),
        # Float32 against float64: rays within a rounding of a silhouette.
        "differ": int(differ.sum()),
    }
