"""Photon map: irradiance from the photons that land near a point.

`E(x) = sum_p Phi_p K(|x_p - x|) / M(x)`, `K(d) = 3 / (pi r²) (1 - d²/r²)²` (Simpson), where `M(x) = ∫ K(|y - x|) dA(y)`
is the kernel's mass on the very faces whose photons are counted: those of x's object whose normals lie within 84°
of x's. The mass is exact for any mix of triangles, so a constant E is estimated without bias up to edges and corners,
which would otherwise lose 50 % and 75 %. Photons of the other side of a surface never count.

Each pass has a map of its own, with the radius of Knaus and Zwicker, "Progressive Photon Mapping: A Probabilistic
Approach", TOG 30(3), 2011: `r²_{i+1} = r²_i (i + 2/3) / (i + 1)`. The mean over passes is biased by O(r²) inside
a surface (`r² ΔE / 16`), by O(r) along edges and shadow borders, and unbiased as r -> 0; the MSE falls as N^(-2/3).
Photons: Jensen, "Global Illumination using Photon Maps", 1996. Russian roulette survives with the largest channel of
the albedo and divides by it: unbiased.
"""

import math
from concurrent.futures import Executor
from typing import NamedTuple

import numpy as np

from renderer.arrays import SceneArrays
from renderer.geometry.bvh import STACK_SIZE
from renderer.geometry.intersect import make_ray
from renderer.jit import device, kernel
from renderer.lights import pick
from renderer.rng import fold, stream
from renderer.sobol import Sampler, sample_1d, sample_2d
from renderer.surface import Surface, point_on_face, trace
from renderer.vector import Vec3, dot, entry, frame, max_component, mul, scale, sub, to_world, vec3
from renderer.warp import square_to_cosine_hemisphere, square_to_triangle, square_to_uniform_sphere

# Below 1, so that a path in a closed box of albedo 1 ends; 1 / p keeps the mean.
MAX_SURVIVAL = 0.99
# Photons of faces turned further than acos(0.1) from the query's are another surface (Mitsuba 0.6 has the same bound).
MIN_NORMAL_COSINE = 0.1
_CHUNK = 4096
_STREAM = 1 << 40  # beyond any pixel index: photons never share a key with a pixel


class PhotonMap(NamedTuple):
    """Photons sorted by grid cell.

    Attributes
    ----------
    position : (P, 3)
    direction : (P, 3), unit, back along the photon's path.
    power : (P, 3), flux in units of radiance x area.
    face : (P,) int32.
    start : (nx ny nz + 1,) int64, first photon of each cell.
    low, cell, nx, ny, nz : corner, edge length and counts of the grid.
    radius : kernel radius.
    """

    position: np.ndarray
    direction: np.ndarray
    power: np.ndarray
    face: np.ndarray
    start: np.ndarray
    low: Vec3
    cell: float
    nx: int
    ny: int
    nz: int
    radius: float


def progressive_radius(radius: float, index: int) -> float:
    """Kernel radius of pass `index` (from 0), the first being `radius`."""
    square = radius * radius
    for i in range(1, index + 1):
        square *= (i + 2.0 / 3.0) / (i + 1.0)
    return math.sqrt(square)


@device
def _emit(scene: SceneArrays, sampler: Sampler) -> tuple[Vec3, Vec3, Vec3, int]:
    """Origin, direction, power and face (-1: a point light) of a photon, one of one."""
    emitters = scene.emitters
    index, probability = pick(emitters, sample_1d(sampler, 0))
    points = len(emitters.point)
    if index < points:
        u, v = sample_2d(sampler, 2)
        power = scale(vec3(emitters.intensity, index), 4.0 * math.pi / probability)
        return vec3(emitters.point, index), square_to_uniform_sphere(u, v), power, -1
    face = entry(emitters.face, index - points)
    u, v = sample_2d(sampler, 1)
    b1, b2 = square_to_triangle(u, v)
    origin = point_on_face(scene.geometry, face, b1, b2)
    u, v = sample_2d(sampler, 2)
    local = square_to_cosine_hemisphere(u, v)
    direction = to_world(frame(vec3(scene.geometry.normals, face)), local)
    radiance = vec3(scene.materials.emission, scene.geometry.object[face])
    return origin, direction, scale(radiance, math.pi * emitters.area[index - points] / probability), face


@device
def _shading_ratio(scene: SceneArrays, surface: Surface, wi: Vec3, wo: Vec3) -> float:
    """Correction of a scattered photon for shading normals: light and importance see different cosines.

    Veach, "Robust Monte Carlo Methods for Light Transport Simulation", 1997, equation 5.19.
    """
    if not scene.geometry.smooth[surface.face]:
        return 1.0
    geometric = vec3(scene.geometry.normals, surface.face)
    down = abs(dot(wi, geometric)) * abs(dot(wo, surface.normal))
    return abs(dot(wi, surface.normal)) * abs(dot(wo, geometric)) / down if down > 0.0 else 0.0


@kernel
def _trace_photons(
    scene: SceneArrays,
    key: np.uint64,
    first: int,
    last: int,
    first_hits: bool,
    position: np.ndarray,
    direction: np.ndarray,
    power: np.ndarray,
    face: np.ndarray,
) -> int:
    """Trace photons [first, last); returns how many land, also where the arrays are too short to hold all."""
    stack = np.empty(STACK_SIZE, np.int32)
    landed = 0
    for index in range(first, last):
        sampler = Sampler(key, np.uint32(index))
        origin, heading, flux, origin_face = _emit(scene, sampler)
        depth = 0
        while True:
            surface = trace(scene, make_ray(origin, heading), origin_face, stack)
            if surface.face < 0:
                break
            albedo = vec3(scene.materials.diffuse, surface.object)
            survival = min(MAX_SURVIVAL, max_component(albedo))
            if survival <= 0.0:
                break
            if depth > 0 or first_hits:
                if landed < len(face):
                    position[landed, 0] = surface.point.x
                    position[landed, 1] = surface.point.y
                    position[landed, 2] = surface.point.z
                    direction[landed, 0] = surface.wo.x
                    direction[landed, 1] = surface.wo.y
                    direction[landed, 2] = surface.wo.z
                    power[landed, 0] = flux.x
                    power[landed, 1] = flux.y
                    power[landed, 2] = flux.z
                    face[landed] = surface.face
                landed += 1
            depth += 1
            branch = Sampler(fold(key, 16 + depth), np.uint32(index))
            if sample_1d(branch, 0) >= survival:
                break
            u, v = sample_2d(branch, 1)
            heading = to_world(frame(surface.normal), square_to_cosine_hemisphere(u, v))
            flux = scale(mul(flux, albedo), _shading_ratio(scene, surface, surface.wo, heading) / survival)
            origin = surface.point
            origin_face = surface.face
    return landed


@kernel
def _sort(
    position: np.ndarray,
    low: Vec3,
    cell: float,
    nx: int,
    ny: int,
    nz: int,
    start: np.ndarray,
    order: np.ndarray,
) -> None:
    """Counting sort by cell; photons of one cell keep their order, so the sum over them has one order too."""
    photons = len(position)
    cells = np.empty(photons, np.int64)
    for i in range(photons):
        x = min(nx - 1, max(0, int((position[i, 0] - low.x) / cell)))
        y = min(ny - 1, max(0, int((position[i, 1] - low.y) / cell)))
        z = min(nz - 1, max(0, int((position[i, 2] - low.z) / cell)))
        cells[i] = (np.int64(z) * ny + y) * nx + x
        start[cells[i] + 1] += 1
    for i in range(len(start) - 1):
        start[i + 1] += start[i]
    fill = start[:-1].copy()
    for i in range(photons):
        order[fill[cells[i]]] = i
        fill[cells[i]] += 1


def build(
    position: np.ndarray, direction: np.ndarray, power: np.ndarray, face: np.ndarray, radius: float
) -> PhotonMap:
    """Sort photons into a dense grid of cells at least 2 r wide: a query meets at most 8 of them."""
    if len(position):
        low = position.min(axis=0)
        extent = position.max(axis=0) - low
    else:
        low = extent = np.zeros(3)
    # A dense grid needs no hash, so no cell is ever visited twice; at most 8 cells a photon.
    cell = max(2.0 * radius, float(extent.max()) / 1024.0, 1e-300)
    while True:
        nx, ny, nz = (int(n) + 1 for n in extent / cell)
        if nx * ny * nz <= 8 * len(position) + 64:
            break
        cell *= 1.26  # halves the number of cells
    start = np.zeros(nx * ny * nz + 1, np.int64)
    order = np.empty(len(position), np.int64)
    corner = Vec3(float(low[0]), float(low[1]), float(low[2]))
    if len(position):  # an empty map compiles nothing
        _sort(position, corner, cell, nx, ny, nz, start, order)
    return PhotonMap(
        position=position[order],
        direction=direction[order],
        power=power[order],
        face=face[order],
        start=start,
        low=corner,
        cell=cell,
        nx=nx,
        ny=ny,
        nz=nz,
        radius=radius,
    )


def empty(radius: float = 1.0) -> PhotonMap:
    """A map without photons: what a kernel gets where none are needed."""
    return build(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, np.int32), radius)


def emit(
    scene: SceneArrays,
    key: np.uint64,
    index: int,
    *,
    count: int,
    radius: float,
    first_hits: bool,
    pool: Executor,
) -> PhotonMap:
    """Trace pass `index` of a replicate and build its map.

    Parameters
    ----------
    key : the replicate's root key.
    count : photons emitted.
    radius : kernel radius of this pass.
    first_hits : whether photons that come straight from a light are stored.
    pool : the chunks run here; their order, hence the map, does not depend on the number of threads.
    """
    photons_key = stream(stream(key, _STREAM), index)

    def chunk(first: int) -> tuple[np.ndarray, ...]:
        last = min(first + _CHUNK, count)
        capacity = 4 * (last - first)
        while True:
            position, direction, power = np.empty((3, capacity, 3))
            face = np.empty(capacity, np.int32)
            landed = _trace_photons(
                scene, photons_key, first, last, first_hits, position, direction, power, face
            )
            if landed <= capacity:
                return position[:landed], direction[:landed], power[:landed], face[:landed]
            capacity = landed

    chunks = list(pool.map(chunk, range(0, count, _CHUNK)))
    position, direction, power, face = (np.concatenate(parts) for parts in zip(*chunks, strict=True))
    return build(position, direction, power / count, face, radius)


@device
def _edge_mass(px: float, py: float, qx: float, qy: float, radius: float) -> float:
    """Signed Simpson mass of the triangle (origin, p, q) times 2 pi, for a kernel of unit mass in the plane.

    With d the distance of the edge's line and t the position along it, the wedge inside the disc integrates
    `1 - (1 - (d² + t²) / r²)³` over the angle atan(t / d), in closed form; outside the disc the integrand is 1.
    """
    ex = qx - px
    ey = qy - py
    size = math.sqrt(ex * ex + ey * ey)
    if size == 0.0:
        return 0.0
    ex /= size
    ey /= size
    area = px * ey - py * ex
    d = abs(area)
    tp = px * ex + py * ey
    tq = qx * ex + qy * ey
    angle = math.atan2(tq, d) - math.atan2(tp, d)
    mass = angle
    if d < radius:
        reach = math.sqrt(radius * radius - d * d)
        a = min(max(tp, -reach), reach)
        b = min(max(tq, -reach), reach)
        if b > a:
            s = 1.0 / (radius * radius)
            mass += _wedge(d, b, s) - _wedge(d, a, s) - (math.atan2(b, d) - math.atan2(a, d))
    return math.copysign(mass, area) if area != 0.0 else 0.0


@device
def _wedge(d: float, t: float, s: float) -> float:
    """Antiderivative of 1 - (1 - (d² + t²) s)³ over the angle atan(t / d); s is 1 / r²."""
    d2 = d * d * s
    t2 = t * t * s
    third = d2 * d2 + d2 * t2 * (2.0 / 3.0) + t2 * t2 * 0.2
    return d * t * s * (3.0 - 3.0 * (d2 + t2 / 3.0) + third)


@device
def face_mass(corners: np.ndarray, face: int, normal: Vec3, x: Vec3, radius: float) -> float:
    """∫ K(|y - x|) dA over one triangle, exact for the Simpson kernel in space."""
    a = sub(vec3(corners[face], 0), x)
    height = dot(a, normal)
    square = radius * radius - height * height
    if square <= 0.0:
        return 0.0
    basis = frame(normal)
    b = sub(vec3(corners[face], 1), x)
    c = sub(vec3(corners[face], 2), x)
    ax, ay = dot(basis.s, a), dot(basis.t, a)
    bx, by = dot(basis.s, b), dot(basis.t, b)
    cx, cy = dot(basis.s, c), dot(basis.t, c)
    disc = math.sqrt(square)
    mass = (
        _edge_mass(ax, ay, bx, by, disc) + _edge_mass(bx, by, cx, cy, disc) + _edge_mass(cx, cy, ax, ay, disc)
    )
    # Off the plane the kernel is (r'² / r²)³ times the Simpson kernel of the smaller disc r'.
    ratio = square / (radius * radius)
    return abs(mass) / (2.0 * math.pi) * ratio * ratio * ratio


@device
def _same_surface(scene: SceneArrays, face: int, other: int) -> bool:
    """Whether photons on `other` count at a point of `face`."""
    geometry = scene.geometry
    return geometry.object[other] == geometry.object[face] and (
        other == face or dot(vec3(geometry.normals, other), vec3(geometry.normals, face)) > MIN_NORMAL_COSINE
    )


@device
def kernel_mass(scene: SceneArrays, face: int, x: Vec3, radius: float, stack: np.ndarray) -> float:
    """Mass of the kernel at x on all faces whose photons count there."""
    geometry = scene.geometry
    tree = geometry.tree
    mass = 0.0
    size = 1
    stack[0] = 0
    while size > 0:
        size -= 1
        node = entry(stack, size)
        square = 0.0
        for axis in range(3):
            value = x.x if axis == 0 else (x.y if axis == 1 else x.z)
            gap = max(max(tree.bounds[node, 0, axis] - value, value - tree.bounds[node, 1, axis]), 0.0)
            square += gap * gap
        if square > radius * radius:
            continue
        if tree.count[node] > 0:
            for i in range(tree.first[node], tree.first[node] + tree.count[node]):
                other = entry(tree.order, i)
                if _same_surface(scene, face, other):
                    mass += face_mass(geometry.corners, other, vec3(geometry.normals, other), x, radius)
        else:
            stack[size] = tree.right[node]
            stack[size + 1] = node + 1
            size += 2
    return mass


@device
def _cell(position: float, low: float, cell: float, count: int) -> int:
    """Grid index of a coordinate, clamped in floating point: far queries must not overflow an integer."""
    return int(min(max((position - low) / cell, 0.0), count - 1.0))


@device
def estimate_irradiance(scene: SceneArrays, photons: PhotonMap, surface: Surface, stack: np.ndarray) -> Vec3:
    """E at a surface point by the Simpson kernel, divided by its mass on the surface."""
    if len(photons.face) == 0:
        return Vec3(0.0, 0.0, 0.0)
    geometry = scene.geometry
    x = surface.point
    radius = photons.radius
    inverse = 1.0 / (radius * radius)
    red = 0.0
    green = 0.0
    blue = 0.0
    for cz in range(
        _cell(x.z - radius, photons.low.z, photons.cell, photons.nz),
        _cell(x.z + radius, photons.low.z, photons.cell, photons.nz) + 1,
    ):
        for cy in range(
            _cell(x.y - radius, photons.low.y, photons.cell, photons.ny),
            _cell(x.y + radius, photons.low.y, photons.cell, photons.ny) + 1,
        ):
            row = (np.int64(cz) * photons.ny + cy) * photons.nx
            # Cells of a row are neighbours in memory: their photons are one range.
            begin = photons.start[row + _cell(x.x - radius, photons.low.x, photons.cell, photons.nx)]
            end = photons.start[row + _cell(x.x + radius, photons.low.x, photons.cell, photons.nx) + 1]
            for p in range(begin, end):
                dx = photons.position[p, 0] - x.x
                dy = photons.position[p, 1] - x.y
                dz = photons.position[p, 2] - x.z
                rest = 1.0 - (dx * dx + dy * dy + dz * dz) * inverse
                if rest <= 0.0:
                    continue
                face = entry(photons.face, p)
                if not _same_surface(scene, surface.face, face):
                    continue
                wi = vec3(photons.direction, p)
                cos = dot(wi, vec3(geometry.normals, face))
                if cos * surface.side <= 0.0:
                    continue
                weight = rest * rest
                if geometry.smooth[face]:
                    weight *= max(0.0, dot(wi, surface.normal)) / abs(cos)
                red += weight * photons.power[p, 0]
                green += weight * photons.power[p, 1]
                blue += weight * photons.power[p, 2]
    if red == 0.0 and green == 0.0 and blue == 0.0:
        return Vec3(0.0, 0.0, 0.0)
    norm = 3.0 * inverse / (math.pi * kernel_mass(scene, surface.face, x, radius, stack))
    return Vec3(red * norm, green * norm, blue * norm)


@device
def nearest_irradiance(
    photons: PhotonMap, surface: Surface, nearest: int, heap: np.ndarray, chosen: np.ndarray
) -> Vec3:
    """E by the k nearest photons in front of the surface: sum of Phi / (pi r_k²) (paper).

    Biased: too bright by k / (k - 1), since the k-th photon lies on the rim of its own disc, and blurred over r_k.
    `heap` (float64) and `chosen` (int64) are scratch of at least `nearest` entries.
    """
    total = len(photons.face)
    if total == 0:
        return Vec3(0.0, 0.0, 0.0)
    x = surface.point
    widest = photons.cell * (photons.nx + photons.ny + photons.nz)
    reach_x = abs(x.x - photons.low.x)
    reach_y = abs(x.y - photons.low.y)
    reach_z = abs(x.z - photons.low.z)
    widest += reach_x + reach_y + reach_z
    radius = photons.radius
    count = 0
    while True:
        count = 0
        for cz in range(
            _cell(x.z - radius, photons.low.z, photons.cell, photons.nz),
            _cell(x.z + radius, photons.low.z, photons.cell, photons.nz) + 1,
        ):
            for cy in range(
                _cell(x.y - radius, photons.low.y, photons.cell, photons.ny),
                _cell(x.y + radius, photons.low.y, photons.cell, photons.ny) + 1,
            ):
                row = (np.int64(cz) * photons.ny + cy) * photons.nx
                begin = photons.start[row + _cell(x.x - radius, photons.low.x, photons.cell, photons.nx)]
                end = photons.start[row + _cell(x.x + radius, photons.low.x, photons.cell, photons.nx) + 1]
                for p in range(begin, end):
                    dx = photons.position[p, 0] - x.x
                    dy = photons.position[p, 1] - x.y
                    dz = photons.position[p, 2] - x.z
                    square = dx * dx + dy * dy + dz * dz
                    if square > radius * radius or dot(vec3(photons.direction, p), surface.normal) <= 0.0:
                        continue
                    if count < nearest:
                        _sift_up(heap, chosen, count, square, p)
                        count += 1
                    elif square < heap[0]:
                        _sift_down(heap, chosen, nearest, square, p)
        if count == nearest or radius > widest:
            break
        radius *= 2.0
    if count == 0:
        return Vec3(0.0, 0.0, 0.0)
    red = 0.0
    green = 0.0
    blue = 0.0
    for i in range(count):
        red += photons.power[chosen[i], 0]
        green += photons.power[chosen[i], 1]
        blue += photons.power[chosen[i], 2]
    norm = 1.0 / (math.pi * heap[0])
    return Vec3(red * norm, green * norm, blue * norm)


@device
def _sift_up(heap: np.ndarray, chosen: np.ndarray, i: int, square: float, photon: int) -> None:
    """Add an entry to a heap whose root is the farthest photon."""
    while i > 0:
        parent = (i - 1) // 2
        if heap[parent] >= square:
            break
        heap[i] = heap[parent]
        chosen[i] = chosen[parent]
        i = parent
    heap[i] = square
    chosen[i] = photon


@device
def _sift_down(heap: np.ndarray, chosen: np.ndarray, size: int, square: float, photon: int) -> None:
    """Replace the farthest photon."""
    i = 0
    while True:
        child = 2 * i + 1
        if child >= size:
            break
        if child + 1 < size and heap[child + 1] > heap[child]:
            child += 1
        if heap[child] <= square:
            break
        heap[i] = heap[child]
        chosen[i] = chosen[child]
        i = child
    heap[i] = square
    chosen[i] = photon
