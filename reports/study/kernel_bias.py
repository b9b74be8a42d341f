"""Where the bias of a photon kernel sits: inside a face, at the end of a surface, or beside another object.

The kernel of radius r averages E over a disc around the point x that a pixel sees. As r -> 0

| class    | the disc | error of a pixel | pixels |
|----------|----------|------------------|--------|
| interior | lies whole on the flat piece of surface that x is on | O(r²), of the Laplacian of E | all |
| boundary | leaves that piece, which ends or bends within r      | O(r), of the gradient of E   | O(r) |
| leak     | has another object within r, whatever else           | up to O(1), of its shadow or its photons | O(r) |

so that the mean over an image has an error of O(r²) but for what leaks. The errors of the classes, each as a share of
the mean of the whole image, add up to the relative error of that mean.
"""

from collections.abc import Mapping

import numpy as np
import trimesh.triangles
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from termwise.renderer.film import GeometryImages
from termwise.renderer.triangles import Geometry
from termwise.reports.statistics.convergence import relative_error
from termwise.reports.statistics.jackknife import Estimate
from termwise.scenes.model import Scene

CLASSES: tuple[str, ...] = ("interior", "boundary", "leak")
UNSEEN = -1
"""Class of a pixel whose centre sees no surface."""
_COPLANAR = 1.0 - 1e-6  # least cosine between the normals of two faces of one flat piece
_PAIRS = 2**20  # of points and triangles that are compared at a time


def points(scene: Scene, seen: GeometryImages) -> np.ndarray:
    """What the rays through the pixels' centres meet, (H, W, 3) float64; the camera where they meet nothing."""
    width, height = scene.resolution
    at = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    directions = scene.camera.rays(np.stack(at, axis=-1), aspect=width / height)
    return scene.camera.position + np.where(seen.face >= 0, seen.depth, 0.0)[..., None] * directions


def classify(geometry: Geometry, faces: np.ndarray, points: np.ndarray, radius: float) -> np.ndarray:
    """The class of each point under a kernel of a radius: (...) int64, indices into CLASSES, or UNSEEN.

    Parameters
    ----------
    geometry : the triangles of a scene.
    faces : (...) integer, the triangle that each point lies on, -1 for none.
    points : (..., 3) float64
    radius : in the unit of the points.
    """
    shape, faces, points = faces.shape, faces.ravel(), points.reshape(-1, 3)
    seen = np.flatnonzero(faces >= 0)
    found = np.full(len(faces), UNSEEN)
    found[seen] = CLASSES.index("interior")
    objects = geometry.object[: len(geometry.corners)]  # without spheres
    piece, ends = _pieces(geometry)
    for number in np.unique(piece[faces[seen]]):
        on = seen[piece[faces[seen]] == number]
        distance = _to_segments(points[on], ends[number])
        found[on[distance < radius]] = CLASSES.index("boundary")
    for thing in np.unique(objects[faces[seen]]):
        on = seen[objects[faces[seen]] == thing]
        near = _near(points[on], geometry.corners[objects != thing], radius)
        found[on[near]] = CLASSES.index("leak")
    return found.reshape(shape)


def pixels(classes: np.ndarray) -> dict[str, float]:
    """Share of each class in the pixels that see a surface."""
    seen = classes[classes != UNSEEN]
    return {name: float(np.mean(seen == number)) if len(seen) else 0.0 for number, name in enumerate(CLASSES)}


def shares(ours: np.ndarray, reference: np.ndarray, classes: np.ndarray) -> dict[str, Estimate]:
    """Error of the pixels of each class, as a share of the reference's mean: they add up to `relative_error`.

    A pixel whose centre sees nothing holds at most the rim of a surface: it counts as boundary.

    Parameters
    ----------
    ours, reference : (K, H, W, 3) and (R, H, W, 3) floating
    classes : (H, W), of `classify`.
    """
    classes = np.where(classes == UNSEEN, CLASSES.index("boundary"), classes)
    return {name: relative_error(ours, reference, where=classes == number) for number, name in enumerate(CLASSES)}


def label(errors: Mapping[str, Estimate]) -> str:
    """The class that makes most of a proven error; what is proven is so at 90 %."""
    proven = {name: error for name, error in errors.items() if error.low(0.05) > 0 or error.high(0.05) < 0}
    return max(proven, key=lambda name: abs(proven[name].value), default="none proven")


def _pieces(geometry: Geometry) -> tuple[np.ndarray, list[np.ndarray]]:
    """Flat pieces, faces of one object in one plane that share edges: the piece of each face, the edges around each."""
    corners, normal, count = geometry.corners, geometry.normals, len(geometry.corners)
    _, vertex = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    vertex = vertex.reshape(count, 3)
    edge = np.sort(np.stack([vertex, np.roll(vertex, -1, axis=1)], axis=-1), axis=-1).reshape(-1, 2)
    face = np.repeat(np.arange(count), 3)
    thing = geometry.object[face]
    order = np.lexsort((*edge.T, thing))
    a, b = order[:-1], order[1:]
    joined = (edge[a] == edge[b]).all(axis=1) & (thing[a] == thing[b])
    joined &= np.abs(np.einsum("ix,ix->i", normal[face[a]], normal[face[b]])) > _COPLANAR
    a, b = a[joined], b[joined]
    graph = coo_array((np.ones(len(a)), (face[a], face[b])), (count, count))
    pieces, piece = connected_components(graph, directed=False)
    inner = np.zeros(len(edge), bool)
    inner[a] = inner[b] = True
    segments = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2, 3)
    outer = np.flatnonzero(~inner)
    outer = outer[np.argsort(piece[face[outer]], kind="stable")]
    ends = np.searchsorted(piece[face[outer]], np.arange(1, pieces))
    return piece, np.split(segments[outer], ends)


def _to_segments(points: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """Distance of points (N, 3) to the nearest of segments (S, 2, 3); infinite where there is none."""
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    offset = points[:, None] - start
    square = np.maximum(np.einsum("sx,sx->s", along, along), np.finfo(float).tiny)
    t = np.clip(np.einsum("nsx,sx->ns", offset, along) / square, 0.0, 1.0)
    return np.linalg.norm(offset - t[..., None] * along, axis=-1).min(axis=1, initial=np.inf)


def _near(points: np.ndarray, triangles: np.ndarray, radius: float) -> np.ndarray:
    """Whether any triangle (T, 3, 3) comes within the radius of each point (N, 3)."""
    low, high = triangles.min(axis=1) - radius, triangles.max(axis=1) + radius
    found = np.zeros(len(points), bool)
    step = max(1, _PAIRS // max(1, len(triangles)))
    for first in range(0, len(points), step):
        some = points[first : first + step, None]
        # Few pairs are left by the boxes.
        point, triangle = np.nonzero(((some >= low) & (some <= high)).all(axis=-1))
        at = points[first + point]
        closest = trimesh.triangles.closest_point(triangles[triangle], at)
        found[first + point[np.linalg.norm(closest - at, axis=1) < radius]] = True
    return found
