"""Faces that lie in one plane, one over the other: those of one look count once, others have no answer.

Two faces are coincident where the corners of the one lie within rounding of the other's plane and both, seen along the
normal, overlap by more than rounding: vertices are float32 numbers, so rounding is a few 2^-24 of the coordinates.
Faces that share an edge or touch are not.

A side of such a place is sealed if the camera's rays never come to it: it lies within a solid (the solid side of a face
of a closed mesh that lets no light through and that the camera is outside of), or nothing lies beyond its plane, the
camera neither. A block on a floor and two blocks side by side are sealed on both sides; what coincides there is never
seen. Elsewhere, of faces of equal look the earlier one stands and the others lose what it covers, so that a mesh with
all faces listed twice, in one winding or both, is the mesh with each once. Faces of different materials, and lights,
are refused by the names of their objects.
"""

import functools
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import attrs
import numpy as np

ROUNDING = 2.0**-21
"""Of the largest coordinate of two faces: how far they may be apart, and yet be the same."""
_TURNED = 2.0**-48  # of the largest coordinate: what a rotation in float64 leaves of another that should be 0
_FLATTEST = 1e-3  # of a face's height: no rounding tilts it further
_CELL = 1e-3  # of plane coordinates, which are of the order of 1
_SHRINK = 1e-6


class Faces(NamedTuple):
    """Triangles of several meshes in one list.

    Attributes
    ----------
    corners : (F, 3, 3) float64.
    normals : (F, 3) unit normals; zero without an area.
    height : (F,) least height of a corner over the opposite edge.
    rounding : (F,) `ROUNDING` of the largest coordinate.
    owner : (F,) index of the mesh.
    """

    corners: np.ndarray
    normals: np.ndarray
    height: np.ndarray
    rounding: np.ndarray
    owner: np.ndarray


def faces_of(meshes: Sequence[Any]) -> Faces:
    """All triangles of the meshes, in order."""
    corners = np.concatenate([mesh.vertices[mesh.faces] for mesh in meshes])
    owner = np.repeat(np.arange(len(meshes)), [len(mesh.faces) for mesh in meshes])
    edges = np.roll(corners, -1, axis=1) - corners
    across = np.cross(edges[:, 0], edges[:, 1])
    double = np.linalg.norm(across, axis=1)
    normals = np.divide(across, double[:, None], out=np.zeros_like(across), where=double[:, None] > 0)
    longest = np.sqrt(np.einsum("fex,fex->fe", edges, edges).max(axis=1))
    height = np.divide(double, longest, out=np.zeros_like(double), where=longest > 0)
    return Faces(corners, normals, height, ROUNDING * np.abs(corners).max(axis=(1, 2)), owner)


def check_camera(objects: Sequence[Any], position: Sequence[float]) -> None:
    """Refuse a camera that lies on a face.

    Raises
    ------
    ValueError : which object's.
    """
    eye = np.asarray(position)
    for thing in objects:
        mesh = thing.mesh
        rounding = _rounding(np.maximum(np.abs(eye), np.abs(mesh.vertices).max(axis=0)))
        if (eye < mesh.vertices.min(axis=0) - rounding).any() or (eye > mesh.vertices.max(axis=0) + rounding).any():
            continue
        corners = mesh.vertices[mesh.faces]
        edges = np.roll(corners, -1, axis=1) - corners
        normals = np.cross(edges[:, 0], edges[:, 1])
        away = eye - corners
        # Along a direction, of the coordinates that it has a share of: the height of a wide floor is rounded by little.
        rounding = _rounding(np.maximum(np.abs(eye), np.abs(corners).max(axis=1)))
        height = np.abs(np.einsum("fx,fx->f", away[:, 0], normals))
        near = (height <= np.einsum("fx,fx->f", np.abs(normals), rounding)) & normals.any(axis=1)
        for edge in range(3):
            inwards = np.cross(normals, edges[:, edge])
            depth = np.einsum("fx,fx->f", away[:, edge], inwards)
            near &= depth >= -np.einsum("fx,fx->f", np.abs(inwards), rounding)
        if near.any():
            raise ValueError(
                f"camera: position = {tuple(position)!r}: lies on a face of {thing.name!r}: allowed is a point "
                "off all faces"
            )


def _rounding(largest: np.ndarray) -> np.ndarray:
    """Of each coordinate of points (..., 3) that are no larger: its own, and what a rotation brings from the others."""
    return np.maximum(ROUNDING * largest, _TURNED * largest.max(axis=-1, keepdims=True))


@functools.lru_cache(maxsize=16)
def counted_once(objects: tuple[Any, ...], position: tuple[float, ...]) -> tuple[Any, ...]:
    """The objects without what lies coincident over an earlier face of equal look, where the camera's rays may come.

    Parameters
    ----------
    objects : of a scene; those of which nothing is left are left out.
    position : of the camera.

    Raises
    ------
    ValueError : faces of different looks, or a light's, coincide there.
    """
    meshes = tuple(thing.mesh for thing in objects)
    if not meshes or not len(pairs := pairs_of(meshes)):
        return objects
    faces, eye = faces_of(meshes), np.asarray(position)
    pairs = pairs[~_sealed(objects, faces, pairs, eye)]
    first, second = pairs.T
    of_first, of_second = faces.owner[first], faces.owner[second]
    looks = [thing.surface for thing in objects]
    number = np.array([looks.index(look) for look in looks])
    emits = np.array([thing.emits for thing in objects], np.bool_)
    refracts = np.array([look.transparency > 0.0 for look in looks], np.bool_)
    unlike = number[of_first] != number[of_second]
    turned = ~_shaded_alike(meshes, faces, first, second)
    bad = np.flatnonzero(
        unlike
        | emits[of_first]
        | emits[of_second]
        | refracts[of_first]
        | turned
        | ~_mapped_alike(objects, faces, first, second)
    )
    if len(bad):
        one, other = objects[of_first[bad[0]]], objects[of_second[bad[0]]]
        names = f"{one.name!r} and {other.name!r} lie" if one is not other else f"two faces of {one.name!r} lie"
        small = second if faces.height[second[bad[0]]] <= faces.height[first[bad[0]]] else first
        place = ", ".join(f"{x:.4g}" for x in faces.corners[small[bad[0]]].mean(axis=0))
        why = "differ in their shading normals" if turned[bad[0]] else "differ in where their image lies"
        why = "differ in material" if unlike[bad[0]] else why
        why = "are transparent" if refracts[of_first[bad[0]]] and not unlike[bad[0]] else why
        why = "give light" if one.emits or other.emits else why
        alike = "" if refracts[of_first[bad[0]]] else "equal looks, "
        raise ValueError(
            f"objects: {names} in one plane, one over the other, near ({place}), and {why}, so that there is no answer "
            f"which of them is seen: allowed are one of the two, {alike}or a gap between them"
        )
    return _without(objects, faces, first, second)


def _sealed(objects: Sequence[Any], faces: Faces, pairs: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """Whether the camera's rays come to neither side of pairs of faces, (N,) bool."""
    sealed = np.zeros((len(pairs), 2), np.bool_)  # before and behind the first face
    normals = faces.normals[pairs[:, 0]]
    solid = np.zeros(len(objects))
    for owner in np.unique(faces.owner[pairs]):
        if objects[owner].surface.translucency == 0.0 and objects[owner].surface.transparency == 0.0:
            solid[owner] = _solid(objects[owner].mesh, eye)
    for face in pairs.T:
        side = -solid[faces.owner[face]] * np.sign(np.einsum("nx,nx->n", faces.normals[face], normals))
        sealed |= np.column_stack([side > 0, side < 0])
    points = np.concatenate([eye[None], *(thing.mesh.vertices for thing in objects)])
    rounding = ROUNDING * np.abs(points).max()
    ways = np.array([way for way in np.ndindex(3, 3, 3) if way != (1, 1, 1)]) - 1
    extreme = np.r_[eye[None], points[(points @ ways.T).argmax(axis=0)]]
    planes = _cells(_planes(faces, pairs[:, 0]), 0.0)
    for column, sign in ((0, 1.0), (1, -1.0)):
        height = sign * np.einsum("nx,nx->n", faces.corners[pairs[:, 0], 0], normals) + rounding
        asked = np.flatnonzero(~sealed[:, column] & ((sign * normals @ extreme.T).max(axis=1) <= height))
        for key in np.unique(planes[asked]):
            of_plane = asked[planes[asked] == key]
            sealed[of_plane, column] = (sign * points @ normals[of_plane[0]]).max() <= height[of_plane[0]]
    return sealed[:, 0] & sealed[:, 1]


def _solid(mesh: Any, eye: np.ndarray) -> int:
    """1 where the mesh bounds a solid that lies behind its normals, -1 before them; 0 if none, or about the camera."""
    corners = mesh.vertices[mesh.faces]
    if not _edges_shared(corners, np.zeros(len(corners), np.int64)).all():
        return 0
    a, b, c = np.moveaxis(corners - eye, 1, 0)
    of_a, of_b, of_c = (np.linalg.norm(each, axis=1) for each in (a, b, c))
    volume = np.einsum("fx,fx->f", a, np.cross(b, c))
    # Solid angles of the faces (van Oosterom and Strackee 1983): all together 4 pi inside, 0 outside.
    rest = of_a * of_b * of_c + np.einsum("fx,fx->f", a, b) * of_c
    rest += np.einsum("fx,fx->f", b, c) * of_a + np.einsum("fx,fx->f", c, a) * of_b
    if abs(2.0 * np.arctan2(volume, rest).sum()) > 2.0 * np.pi:
        return 0
    return int(np.sign(volume.sum()))


def _shaded_alike(meshes: Sequence[Any], faces: Faces, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Whether pairs of faces show one shading normal, but for its sign: flat ones do, smooth ones corner by corner."""
    smooth = np.array([mesh.normals is not None for mesh in meshes], np.bool_)[faces.owner]
    alike = ~(smooth[first] | smooth[second])
    rest = np.flatnonzero(~alike)
    if len(rest) == 0:
        return alike
    shading = np.repeat(faces.normals[:, None], 3, axis=1)
    shading[smooth] = np.concatenate([mesh.normals[mesh.faces] for mesh in meshes if mesh.normals is not None])
    same, turned = _of_corners(shading, faces, first[rest], second[rest])
    cosine = np.einsum("nkx,nkx->nk", shading[first[rest]], turned)
    equal = (cosine > 1.0 - 1e-6).all(axis=1) | (cosine < 1e-6 - 1.0).all(axis=1)
    alike[rest] = same & equal
    return alike


def _of_corners(values: np.ndarray, faces: Faces, one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether pairs of faces have the same corners; values (N, 3, C) of the second in the order of the first."""
    same = (faces.corners[one][:, :, None] == faces.corners[other][:, None]).all(axis=-1)
    return same.any(axis=2).all(axis=1), np.take_along_axis(values[other], same.argmax(axis=2)[..., None], axis=1)


def _mapped_alike(objects: Sequence[Any], faces: Faces, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Whether pairs of faces show their image alike: those without one do, others corner by corner."""
    textured = np.array([bool(thing.surface.textures) for thing in objects], np.bool_)[faces.owner]
    alike = ~(textured[first] | textured[second])
    rest = np.flatnonzero(~alike)
    if len(rest) == 0:
        return alike
    uv = np.zeros((len(faces.owner), 3, 2))
    uv[textured] = np.concatenate([thing.mesh.uv for thing in objects if thing.surface.textures])
    same, turned = _of_corners(uv, faces, first[rest], second[rest])
    alike[rest] = same & (uv[first[rest]] == turned).all(axis=(1, 2))
    return alike


def _without(objects: Sequence[Any], faces: Faces, first: np.ndarray, second: np.ndarray) -> tuple[Any, ...]:
    """The objects, `first` cut out of `second`."""
    same = (faces.corners[first][:, :, None] == faces.corners[second][:, None]).all(axis=-1).any(axis=2).all(axis=1)
    kept = np.ones(len(faces.owner), np.bool_)
    kept[second[same]] = False
    pieces: list[list[np.ndarray]] = [[] for _ in objects]
    rest = kept[second]
    order = np.argsort(second[rest], kind="stable")
    covers, covered = first[rest][order], second[rest][order]
    for face, begin, end in zip(*_runs(covered), strict=True):
        shapes = [faces.corners[face]]
        for cover in covers[begin:end]:
            shapes = [left for shape in shapes for left in _outside(shape, faces, cover, face)]
        kept[face] = False
        pieces[faces.owner[face]] += [shape[[0, i, i + 1]] for shape in shapes for i in range(1, len(shape) - 1)]
    found = []
    starts = np.searchsorted(faces.owner, np.arange(len(objects) + 1))
    for number, thing in enumerate(objects):
        mine = kept[starts[number] : starts[number + 1]]
        corners = np.array(pieces[number]).reshape(-1, 3).astype(np.float32).astype(np.float64)
        added = len(thing.mesh.vertices) + np.arange(len(corners)).reshape(-1, 3)
        if mine.all():
            found.append(thing)
        elif mine.any() or len(added):
            # What has an image is left out whole, or not at all.
            uv = None if thing.mesh.uv is None or len(added) else thing.mesh.uv[mine]
            mesh = attrs.evolve(
                thing.mesh,
                vertices=np.concatenate([thing.mesh.vertices, corners]),
                faces=np.concatenate([thing.mesh.faces[mine], added]),
                uv=uv,
            )
            found.append(attrs.evolve(thing, mesh=mesh))
    return tuple(found)


def _outside(shape: np.ndarray, faces: Faces, cover: int, face: int) -> list[np.ndarray]:
    """Convex polygons (K, 3) that are left of one in the plane of `face` where `cover` lies over it."""
    normal, corners = faces.normals[face], faces.corners[cover]
    if normal @ faces.normals[cover] < 0.0:
        corners = corners[::-1]
    thin = max(faces.rounding[face], faces.rounding[cover])
    inwards = np.cross(normal, np.roll(corners, -1, axis=0) - corners)
    inwards /= np.linalg.norm(inwards, axis=1)[:, None]
    depths = [(shape - begin) @ way for begin, way in zip(corners, inwards, strict=True)]
    if any(depth.max() <= thin for depth in depths):
        return [shape]
    left = []
    for begin, way in zip(corners, inwards, strict=True):
        depth = (shape - begin) @ way
        if depth.min() < -thin:
            left.append(_half(shape, -depth, thin))
            shape = _half(shape, depth, thin)
    return left


def _half(shape: np.ndarray, depth: np.ndarray, thin: float) -> np.ndarray:
    """What of a convex polygon has a depth of at least 0; corners within rounding of 0 lie on the line."""
    depth = np.where(np.abs(depth) <= thin, 0.0, depth)
    found = []
    for i in range(len(shape)):
        j = (i + 1) % len(shape)
        if depth[i] >= 0.0:
            found.append(shape[i])
        if depth[i] * depth[j] < 0.0:
            found.append(shape[i] + depth[i] / (depth[i] - depth[j]) * (shape[j] - shape[i]))
    return np.array(found)


def _runs(sorted_numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Each number once, and where its run begins and ends."""
    starts = np.flatnonzero(np.r_[True, sorted_numbers[1:] != sorted_numbers[:-1]]) if len(sorted_numbers) else []
    starts = np.asarray(starts, np.int64)
    return sorted_numbers[starts], starts, np.r_[starts[1:], len(sorted_numbers)] if len(starts) else starts


@functools.lru_cache(maxsize=16)
def pairs_of(meshes: tuple[Any, ...]) -> np.ndarray:
    """Coincident faces of the meshes' list: (N, 2), the earlier one first."""
    faces = faces_of(meshes)
    some = np.flatnonzero(faces.height > 0)
    planes = _planes(faces, some)
    found = [np.zeros((0, 2), np.int64)]
    # Near the border of a cell two faces of one plane may be parted: not in the cells that are shifted by half of one.
    for shift in (0.0, 0.5):
        plane = _cells(planes, shift)
        shared = _shared(plane)
        plane, here = plane[shared], some[shared]
        free = _free(faces, here, plane)
        seen = _overlapping(faces, here, plane, free)
        hit = np.isin(plane, plane[np.isin(here, seen)])
        if not free[hit].all():
            seen = _overlapping(faces, here[hit], plane[hit], np.ones(hit.sum(), np.bool_))
        found.append(seen)
    number = _distinct(np.concatenate(found) @ np.array([len(faces.owner), 1]))
    return np.column_stack(np.divmod(number, len(faces.owner)))


def _overlapping(faces: Faces, here: np.ndarray, plane: np.ndarray, asking: np.ndarray) -> np.ndarray:
    """Coincident pairs (N, 2) among the faces `here` of equal `plane`, one of them at least `asking`."""
    found = [np.zeros((0, 2), np.int64)]
    a, b, c = np.moveaxis(faces.corners[here], 1, 0)
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    for pairs in _near(low, high, plane, asking):
        pairs = np.sort(here[pairs], axis=1)
        found.append(pairs[coincide(faces, *pairs.T)])
    return np.concatenate(found)


def coincide(faces: Faces, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Whether pairs of faces lie in one plane and overlap, (N,) bool."""
    small = faces.height[first] <= faces.height[second]
    a, b = np.where(small, first, second), np.where(small, second, first)
    rounding = np.maximum(faces.rounding[a], faces.rounding[b])
    corners, normals = faces.corners, faces.normals[b]
    away = corners[a] - corners[b, :1]
    near = np.minimum(rounding, _FLATTEST * faces.height[a])
    # A plane's own rounding grows with the distance from its face.
    reach = 1.0 + np.linalg.norm(away, axis=2).max(axis=1) / faces.height[b]
    apart = np.abs(np.einsum("nkx,nx->nk", away, normals)).max(axis=1)
    found = (apart <= np.minimum(rounding * reach, _FLATTEST * faces.height[a])) & (faces.height[a] > 0)
    # Convex shapes overlap unless one of their edges separates them.
    for one, other, turn in ((b, a, 1.0), (a, b, np.sign(np.einsum("nx,nx->n", faces.normals[a], normals)))):
        for edge in range(3):
            begin = corners[one, edge]
            inwards = np.cross(normals, corners[one, (edge + 1) % 3] - begin)
            inwards *= (turn / np.maximum(np.linalg.norm(inwards, axis=1), 1e-300))[:, None]
            depth = np.einsum("nkx,nx->nk", corners[other] - begin[:, None], inwards).max(axis=1)
            found &= depth > 2.0 * near
    return found


def _planes(faces: Faces, some: np.ndarray) -> np.ndarray:
    """(N, 3) coordinates of the planes of faces, in cells: equal for both orientations of one."""
    if len(some) == 0:
        return np.zeros((0, 3))
    low, high = faces.corners[some].min(axis=(0, 1)), faces.corners[some].max(axis=(0, 1))
    normals = faces.normals[some]
    # n n^T and the foot of the scene's centre do not turn with the face; three projections tell planes apart.
    offset = np.einsum("fx,fx->f", faces.corners[some, 0] - (low + high) / 2, normals) / (high - low).max()
    of_foot, *of_square = np.random.default_rng(0).normal(size=(4, 3, 3)) / _CELL
    turned = (normals * offset[:, None]) @ of_foot
    for axis in range(3):
        turned += (normals * normals[:, axis, None]) @ of_square[axis]
    return turned


def _cells(planes: np.ndarray, shift: float) -> np.ndarray:
    """(N,) keys: equal for planes of one cell."""
    return _hashed(np.floor(planes + shift).astype(np.int64))


def _free(faces: Faces, here: np.ndarray, plane: np.ndarray) -> np.ndarray:
    """Which faces have an edge that is not shared with exactly one neighbour, on its other side in the same plane.

    If any faces of a plane overlap, such a face does: how many faces lie over a point changes at free edges alone, and
    where it falls from two or more, the face of the edge is one of them.
    """
    turned = faces.normals[here] @ np.array([0.61, 0.53, 0.59]) < 0.0
    corners = faces.corners[here]
    corners[turned] = corners[turned, ::-1]
    return _edges_shared(corners, plane).sum(axis=1) < 3


def _edges_shared(corners: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Which edges (F, 3) one other face of the group has, and runs along the other way."""
    points = _hashed((corners + 0.0).view(np.int64).reshape(-1, 3)).reshape(-1, 3)  # no -0.0
    begin, end = points.ravel(), np.roll(points, -1, axis=1).ravel()
    keys = _hashed(np.column_stack([np.repeat(group, 3), np.minimum(begin, end), np.maximum(begin, end)]))
    order = np.argsort(keys)
    keys, forth = keys[order], (begin < end)[order]
    starts = np.flatnonzero(np.r_[True, keys[1:] != keys[:-1]]) if len(keys) else order
    pairs = starts[np.diff(np.r_[starts, len(keys)]) == 2]
    pairs = pairs[forth[pairs] != forth[pairs + 1]]
    shared = np.zeros(len(keys), np.bool_)
    shared[order[pairs]] = shared[order[pairs + 1]] = True
    return shared.reshape(-1, 3)


def _near(low: np.ndarray, high: np.ndarray, group: np.ndarray, asking: np.ndarray) -> Iterator[np.ndarray]:
    """Pairs (N, 2) of boxes of one group that overlap, one of them `asking`; some of them twice.

    By grids: the boxes of one size, and all smaller ones, in cells that none of them is larger than.
    """
    size = (high - low).max(axis=1)
    level = np.ceil(np.log2(np.maximum(size, 1e-300))).astype(np.int64)
    shrunk = _SHRINK * size[:, None]
    low, high = np.minimum(low + shrunk, (low + high) / 2), np.maximum(high - shrunk, (low + high) / 2)
    for each in np.unique(level):
        here = np.flatnonzero((level <= each) & np.isin(group, group[level == each]))
        cell = 2.0**each
        first, last = np.floor(low[here] / cell).astype(np.int64), np.floor(high[here] / cell).astype(np.int64)
        keys, boxes = [], []
        for corner in np.ndindex(2, 2, 2):
            chosen = np.arange(len(here))
            for axis in np.flatnonzero(corner):
                chosen = chosen[first[chosen, axis] < last[chosen, axis]]
            keys.append(_hashed(np.column_stack([group[here[chosen]], np.where(corner, last[chosen], first[chosen])])))
            boxes.append(here[chosen])
        key, box = np.concatenate(keys), np.concatenate(boxes)
        useful = np.isin(key, key[asking[box]])
        key, box = key[useful], box[useful]
        for a, b in _together(key):
            a, b = box[a], box[b]
            meets = (asking[a] | asking[b]) & (np.maximum(level[a], level[b]) == each)
            a, b = a[meets], b[meets]
            for axis in range(3):
                meets = (low[a, axis] <= high[b, axis]) & (low[b, axis] <= high[a, axis])
                a, b = a[meets], b[meets]
            yield np.column_stack([a, b])


def _hashed(rows: np.ndarray) -> np.ndarray:
    """(N,) int64, equal for equal rows of integers, and hardly ever for others."""
    keys = np.zeros(len(rows), np.uint64)
    for column in rows.T:  # mixed as in splitmix64
        keys += column.astype(np.uint64) + np.uint64(0x9E3779B97F4A7C15)
        keys = (keys ^ (keys >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        keys = (keys ^ (keys >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        keys ^= keys >> np.uint64(31)
    return keys.view(np.int64)


def _together(keys: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """All pairs of indices of equal keys, in blocks."""
    order = np.argsort(keys)
    ends = np.searchsorted(keys[order], keys[order], side="right") if len(keys) else order
    left = np.arange(len(keys))
    for step in range(1, len(keys)):
        left = left[left + step < ends[left]]
        if len(left) == 0:
            return
        yield order[left], order[left + step]


def repeated(faces: np.ndarray) -> np.ndarray:
    """Which faces (F, 3) have the corners of an earlier one, in any order, (F,) bool."""
    keys = _hashed(np.sort(faces, axis=1))
    order = np.argsort(keys, kind="stable")
    again = np.zeros(len(faces), np.bool_)
    again[order[1:]] = keys[order][1:] == keys[order][:-1]
    return again


def _shared(keys: np.ndarray) -> np.ndarray:
    """Indices of keys that are not alone."""
    if len(keys) == 0:
        return keys
    order = np.argsort(keys)
    same = keys[order][1:] == keys[order][:-1]
    return np.sort(order[np.r_[same, False] | np.r_[False, same]])


def _distinct(numbers: np.ndarray) -> np.ndarray:
    """Sorted, each once; `np.unique` takes far longer."""
    numbers = np.sort(numbers)
    return numbers[np.r_[True, numbers[1:] != numbers[:-1]]] if len(numbers) else numbers
