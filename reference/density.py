"""Irradiance from photons: `E(x) = Σ_p Φ_p K(|x_p - x|) / M(x)`, or `s Σ_p Φ_p / (π r_k²)` over the k nearest.

`K(d) = (m + 1) (1 - d²/r²)^m / (π r²)`, m = 0 uniform, 1 Epanechnikov, 2 Simpson; `M(x) = ∫ K(|y - x|) dA(y)` over the
faces whose photons count at x. With x0 the foot of x on the plane of a face, h its height, `q = 1 - h²/r²` and
`v = |y - x0|²/r²`, K is there the divergence of the radial field

    F(y) = (y - x0) / (2π r² v) · [q^{m+1} - max(q - v, 0)^{m+1}].

The mass of a triangle is therefore the flux of F through its three edges: inside the kernel's disc the integral of a
polynomial of degree 2m along the edge, for which three Gauss-Legendre points are exact, and outside q^{m+1} / 2π times
the angle that the rest of the edge subtends at x0.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

POWERS = {"uniform": 0, "epanechnikov": 1, "simpson": 2}
# Photons of faces turned further than acos(0.1) from the point's are another surface.
MIN_NORMAL_COSINE = 0.1
# So are those whose plane passes further away than this share of the radius.
MAX_PLANE_DISTANCE = 0.1
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)
_CANDIDATES = 2**22  # entries of one k-nearest search: bounds memory


class Faces(NamedTuple):
    """Triangles of all objects in one list.

    Attributes
    ----------
    corners : (F, 3, 3)
    normals : (F, 3), unit.
    object : (F,) index.
    smooth : (F,) bool, whether the normals that light falls on are interpolated.
    """

    corners: np.ndarray
    normals: np.ndarray
    object: np.ndarray
    smooth: np.ndarray


def faces(corners: np.ndarray, owner: np.ndarray, smooth: np.ndarray | None = None) -> Faces:
    """Faces with their unit geometric normals, zero without an area; flat ones if nothing is said."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    unit = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
    return Faces(corners, unit, owner, np.zeros(len(owner), bool) if smooth is None else smooth)


def origins(parts: list[list[list[int]]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Object (F,) and face in it (F,) of all faces of all shapes, and the first face (S,) of each shape.

    `parts` as `translate.gathered` gives them: a shape holds an object, or several.
    """
    held = np.array([part for shape in parts for part in shape], np.int64).reshape(-1, 2)
    begins = np.cumsum(held[:, 1]) - held[:, 1]
    face = np.arange(held[:, 1].sum()) - np.repeat(begins, held[:, 1])
    sizes = [sum(count for _, count in shape) for shape in parts]
    return np.repeat(held[:, 0], held[:, 1]), face, np.cumsum([0, *sizes])[:-1]


class Points(NamedTuple):
    """Where E is asked for.

    Attributes
    ----------
    position : (N, 3) float64, on the surface.
    face : (N,) index into the faces.
    side : (N,) +1 where the viewer is on the side that the face's normal points to, else -1.
    normal : (N, 3), unit: the one that light falls on, turned to the viewer; the face's own where it is flat.
    """

    position: np.ndarray
    face: np.ndarray
    side: np.ndarray
    normal: np.ndarray


class Photons(NamedTuple):
    """What landed; lengths as those of the points, power in radiance x area.

    Attributes
    ----------
    position : (P, 3) float64
    direction : (P, 3) unit, back along the photon's path.
    power : (P, 3)
    face : (P,) index into the faces.
    """

    position: np.ndarray
    direction: np.ndarray
    power: np.ndarray
    face: np.ndarray


def _tree(photons: Photons) -> KDTree:
    """Of the photons; neither balanced nor shrunk to them, which would take 2.5 times as long and serve few queries."""
    return KDTree(photons.position, balanced_tree=False, compact_nodes=False)


def by_kernel(faces: Faces, points: Points, photons: Photons, *, shape: str, radius: float) -> np.ndarray:
    """E by a kernel of a radius, (N, 3); unbiased for constant E on the faces within the radius.

    A photon counts on the point's own object, on faces of its surface (`same_surface`), on the viewer's side. Its flux
    through a face with interpolated normals is weighed by the cosine at x over that at the face.
    """
    shares = mass(faces, points, shape=shape, radius=radius)
    pairs = KDTree(points.position).sparse_distance_matrix(_tree(photons), radius, output_type="ndarray")
    point, photon = pairs["i"], pairs["j"]
    landed = photons.face[photon]
    arrival = np.einsum("px,px->p", photons.direction, faces.normals[photons.face])
    counts = same_surface(faces, points, point, landed, radius) & (arrival[photon] * points.side[point] > 0)
    point, photon, distance = point[counts], photon[counts], pairs["v"][counts]
    power = POWERS[shape]
    weight = (power + 1) * (1 - (distance / radius) ** 2) ** power / (np.pi * radius**2)
    if faces.smooth.any():
        at_point = np.einsum("px,px->p", photons.direction[photon], points.normal[point])
        ratio = np.maximum(at_point, 0.0) / np.abs(arrival[photon])
        weight = weight * np.where(faces.smooth[photons.face[photon]], ratio, 1.0)
    flux = photons.power[photon] * weight[:, None]
    sums = [np.bincount(point, flux[:, channel], len(points.face)) for channel in range(3)]
    return np.stack(sums, axis=-1) / shares[:, None]


def same_surface(faces: Faces, points: Points, point: np.ndarray, face: np.ndarray, radius: float) -> np.ndarray:
    """Whether photons on a face count at a point, by pairs of indices: see `scenes.limits.Kernel`."""
    its, normals = points.face[point], faces.normals[face]
    cosine = np.einsum("px,px->p", faces.normals[its], normals)
    distance = np.abs(np.einsum("px,px->p", faces.corners[face, 0] - points.position[point], normals))
    near = (cosine > MIN_NORMAL_COSINE) & (distance < MAX_PLANE_DISTANCE * radius)
    return (its == face) | ((faces.object[its] == faces.object[face]) & near)


def mass(faces: Faces, points: Points, *, shape: str, radius: float) -> np.ndarray:
    """M at the points, (N,); exact."""
    centre = faces.corners.mean(axis=1)
    reach = radius + np.linalg.norm(faces.corners - centre[:, None], axis=-1).max(axis=1)
    found = KDTree(points.position).query_ball_point(centre, reach, return_sorted=False)
    face = np.repeat(np.arange(len(centre)), [len(near) for near in found])
    point = np.concatenate([np.asarray(near, np.int64) for near in found])
    counts = same_surface(faces, points, point, face, radius)
    face, point = face[counts], point[counts]
    relative = faces.corners[face] - points.position[point, None]
    each = triangle_mass(relative, faces.normals[face], shape=shape, radius=radius)
    return np.bincount(point, each, len(points.face))


def triangle_mass(corners: np.ndarray, normals: np.ndarray, *, shape: str, radius: float) -> np.ndarray:
    """∫ K(|y|) dA over triangles (T, 3, 3) relative to x, `normals` (T, 3) their unit normals; (T,), exact."""
    power = POWERS[shape]
    height = np.einsum("tx,tx->t", corners[:, 0], normals)
    q = np.maximum(1 - (height / radius) ** 2, 0.0)[:, None]
    edge = np.roll(corners, -1, axis=1) - corners
    length = np.linalg.norm(edge, axis=-1)
    edge = np.divide(edge, length[..., None], out=np.zeros_like(edge), where=length[..., None] > 0)
    begin = np.einsum("tex,tex->te", corners, edge)
    end = begin + length
    # Signed distance of the edge's line from x0, and half of the chord that the disc cuts from that line.
    d = np.einsum("tex,tx->te", np.cross(corners, edge), normals)
    half = np.sqrt(np.maximum(q * radius**2 - d**2, 0.0))
    first, last = np.clip(begin, -half, half), np.clip(end, -half, half)
    t = (first + last)[..., None] / 2 + (last - first)[..., None] / 2 * _NODES
    rest = q[..., None] - (d[..., None] ** 2 + t**2) / radius**2
    inside = sum(q[..., None] ** (power - j) * rest**j for j in range(power + 1)) @ _WEIGHTS
    flux = d * (last - first) / 2 * inside / radius**2
    flux += q ** (power + 1) * (_angle(d, begin, end) - _angle(d, first, last))
    return np.abs(flux.sum(axis=1)) / (2 * np.pi)


def _angle(d: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Signed angle at x0 of the piece from `begin` to `end` of a line at distance d."""
    return np.arctan2(d * (end - begin), d**2 + begin * end)


def by_nearest(points: Points, photons: Photons, *, nearest: int, scale: float) -> np.ndarray:
    """E by the k nearest photons in front of the surface, (N, 3); all of them where there are fewer than k.

    Biased: with scale 1 too bright by k / (k - 1), since the k-th photon lies on the rim of its own disc.
    """
    total = len(photons.face)
    irradiance = np.zeros((len(points.face), 3))
    tree = _tree(photons)
    waiting, count = np.arange(len(points.face)), min(2 * nearest, total)
    while count and len(waiting):
        found = np.zeros(len(waiting), bool)
        size = max(1, _CANDIDATES // count)
        for start in range(0, len(waiting), size):
            block = waiting[start : start + size]
            distance, photon = (each.reshape(len(block), count) for each in tree.query(points.position[block], count))
            front = np.einsum("nkx,nx->nk", photons.direction[photon], points.normal[block]) > 0
            rank = np.cumsum(front, axis=1)
            chosen = front & (rank <= nearest)
            flux = np.einsum("nk,nkx->nx", chosen, photons.power[photon])
            area = np.pi * np.max(distance * chosen, axis=1, keepdims=True) ** 2
            irradiance[block] = scale * np.divide(flux, area, out=np.zeros_like(flux), where=area > 0)
            found[start : start + size] = rank[:, -1] >= nearest
        waiting = waiting[~found & (count < total)]
        count = min(2 * count, total)
    return irradiance
