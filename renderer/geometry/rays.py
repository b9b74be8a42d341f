"""`closest_hit` and `any_hit` as this machine computes them best, singly and in waves of up to 64 rays.

All meet the same face at the same t: the descent of the binary tree, the reference, which needs no vectors; that of
the tree of 8 children, eight boxes or triangles at a time; and among few polygons float32, as far as it is sure. A
wave whose rays go the same way is a packet where that pays, and else a stream.
"""

import numpy as np

from termwise.renderer.geometry import bvh8_traverse, packets, simd, traverse
from termwise.renderer.geometry.bvh import STACK_SIZE, Tree
from termwise.renderer.geometry.intersect import NOTHING, FaceRange, Hit, Ray, make_ray
from termwise.renderer.geometry.polygons import (
    DOUBT,
    HIT,
    any_hit_among_polygons,
    any_hits_among_polygons,
    closest_hits_among_polygons,
    first_bits,
)
from termwise.renderer.geometry.simd import count_bits
from termwise.renderer.geometry.streams import any_hits_of_stream, closest_hits_of_stream
from termwise.renderer.geometry.wave import BACKOFF, SIZE, Wave, put_hit
from termwise.renderer.jit import device, kernel, subroutine
from termwise.renderer.vector import column, put_column, vec3

_VECTORS = simd.available()
_NEAREST, _ANY = range(2)


@device
def _hopeful(wave: Wave, kind: int) -> bool:
    """Whether a packet of this kind is tried: not for a while after one that did not pay."""
    if wave.backoff[kind, 0] > 0:
        wave.backoff[kind, 0] -= 1
        return False
    return True


@device
def _learn(wave: Wave, kind: int, paid: bool) -> None:
    """Remember whether packets paid."""
    if paid:
        wave.backoff[kind, 1] = BACKOFF
    else:
        wave.backoff[kind, 0] = wave.backoff[kind, 1]
        wave.backoff[kind, 1] = min(2 * wave.backoff[kind, 1], packets.MOST_BACKOFF)


@device
def _ray_of(wave: Wave, i: int) -> Ray:
    return make_ray(column(wave.origins, i), column(wave.directions, i))


if _VECTORS:

    @device
    def closest_hit(corners: np.ndarray, tree: Tree, ray: Ray, far: float, ignore: FaceRange, stack: np.ndarray) -> Hit:
        """Nearest hit at 0 < t <= far on any face but those of `ignore`; `stack` is int32 scratch of STACK_SIZE."""
        return bvh8_traverse.closest_hit(tree.bvh8, ray, far, ignore, stack)

    @device
    def any_hit(
        corners: np.ndarray, tree: Tree, ray: Ray, far: float, ignore: FaceRange, target: int, stack: np.ndarray
    ) -> bool:
        """Whether a face other than `target` and those of `ignore` is hit at 0 < t < far."""
        if tree.polygons.count > 0:
            found = any_hit_among_polygons(tree.polygons, ray, far, ignore, target)
            if found != DOUBT:
                return found == HIT
        return bvh8_traverse.any_hit(tree.bvh8, ray, far, ignore, target, stack)

    @device
    def _left_by_packets(tree: Tree, wave: Wave, count: int, far: float, kind: int, stack: np.ndarray) -> int:
        """Which of the first `count` rays no packet has taken, as bits."""
        if not _hopeful(wave, kind):
            return first_bits(count)
        left = packets.hits_of_packets(tree.bvh8, wave, count, far, kind == _ANY, stack)
        _learn(wave, kind, 2 * count_bits(left) < count)
        return left

    @subroutine
    def closest_hits_of_wave(
        corners: np.ndarray, tree: Tree, wave: Wave, count: int, far: float, coherent: bool, stack: np.ndarray
    ) -> None:
        """Write what `closest_hit` gives for the first `count` rays of a wave; `coherent`: a packet may pay."""
        left = first_bits(count)
        if tree.polygons.count > 0:
            left = closest_hits_among_polygons(corners, tree.polygons, wave, count, far)
        elif coherent:
            left = _left_by_packets(tree, wave, count, far, _NEAREST, stack)
        if left != 0:
            closest_hits_of_stream(tree.bvh8, wave, left, far, stack)

    @subroutine
    def any_hits_of_wave(
        corners: np.ndarray, tree: Tree, wave: Wave, count: int, far: float, coherent: bool, stack: np.ndarray
    ) -> None:
        """Write what `any_hit` gives for the first `count` rays of a wave; `coherent`: a packet may pay."""
        left = first_bits(count)
        if tree.polygons.count > 0:
            left = any_hits_among_polygons(tree.polygons, wave, count, far)
        elif coherent:
            left = _left_by_packets(tree, wave, count, far, _ANY, stack)
        if left != 0:
            any_hits_of_stream(tree.bvh8, wave, left, far, stack)

else:
    closest_hit = traverse.closest_hit
    any_hit = traverse.any_hit

    @subroutine
    def closest_hits_of_wave(
        corners: np.ndarray, tree: Tree, wave: Wave, count: int, far: float, coherent: bool, stack: np.ndarray
    ) -> None:
        """Write what `closest_hit` gives for the first `count` rays of a wave."""
        for i in range(count):
            ignore = FaceRange(wave.first[i], wave.end[i])
            put_hit(wave, i, closest_hit(corners, tree, _ray_of(wave, i), far, ignore, stack))

    @subroutine
    def any_hits_of_wave(
        corners: np.ndarray, tree: Tree, wave: Wave, count: int, far: float, coherent: bool, stack: np.ndarray
    ) -> None:
        """Write what `any_hit` gives for the first `count` rays of a wave."""
        for i in range(count):
            ignore = FaceRange(wave.first[i], wave.end[i])
            wave.found[i] = any_hit(corners, tree, _ray_of(wave, i), far, ignore, wave.target[i], stack)


@device
def _load_wave(origins: np.ndarray, directions: np.ndarray, row: int, count: int, wave: Wave) -> None:
    if _VECTORS and count == SIZE:
        for k in range(0, SIZE, 8):
            o, d = simd.columns(origins, row + k), simd.columns(directions, row + k)
            for axis in range(3):
                simd.store(wave.origins, axis * SIZE + k, o[axis])
                simd.store(wave.directions, axis * SIZE + k, d[axis])
    else:
        for i in range(count):
            put_column(wave.origins, i, vec3(origins, row + i))
            put_column(wave.directions, i, vec3(directions, row + i))


@kernel
def closest_hits(
    corners: np.ndarray,
    tree: Tree,
    origins: np.ndarray,
    directions: np.ndarray,
    far: float,
    t: np.ndarray,
    face: np.ndarray,
    wave: Wave,
    coherent: bool,
) -> None:
    """Distance t (N,) and face (N,) int32 of the nearest hit of rays (N, 3), (N, 3); far and -1 where none is.

    `coherent`: rays that follow each other begin near each other and go the same way.
    """
    stack = np.empty(STACK_SIZE, np.int32)
    for row in range(0, len(origins), SIZE):
        count = min(SIZE, len(origins) - row)
        _load_wave(origins, directions, row, count, wave)
        closest_hits_of_wave(corners, tree, wave, count, far, coherent, stack)
        for i in range(count):
            t[row + i] = wave.t[i]
            face[row + i] = wave.face[i]


@kernel
def any_hits(
    corners: np.ndarray,
    tree: Tree,
    origins: np.ndarray,
    directions: np.ndarray,
    far: float,
    found: np.ndarray,
    wave: Wave,
    coherent: bool,
) -> None:
    """Whether each ray hits anything nearer than `far`: (N,) bool; `coherent` as in `closest_hits`."""
    stack = np.empty(STACK_SIZE, np.int32)
    for row in range(0, len(origins), SIZE):
        count = min(SIZE, len(origins) - row)
        _load_wave(origins, directions, row, count, wave)
        any_hits_of_wave(corners, tree, wave, count, far, coherent, stack)
        for i in range(count):
            found[row + i] = wave.found[i]


@kernel
def reference_hits(
    corners: np.ndarray,
    tree: Tree,
    origins: np.ndarray,
    directions: np.ndarray,
    far: float,
    t: np.ndarray,
    face: np.ndarray,
    found: np.ndarray,
) -> None:
    """What `closest_hits` and `any_hits` find, by descending the binary tree."""
    stack = np.empty(STACK_SIZE, np.int32)
    for i in range(len(origins)):
        ray = make_ray(vec3(origins, i), vec3(directions, i))
        hit = traverse.closest_hit(corners, tree, ray, far, NOTHING, stack)
        t[i] = hit.t
        face[i] = hit.face
        found[i] = traverse.any_hit(corners, tree, ray, far, NOTHING, -1, stack)
