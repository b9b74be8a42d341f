"""`closest_hit` and `any_hit` as this machine computes them best, singly and in groups of 8 rays.

Both descents meet the same face at the same t: the wide tree's, eight boxes or triangles at a time, and the binary
tree's, the reference, which needs no vectors. A group is traced as a packet where that pays, else as a bundle. Among
few triangles packets need no tree, nor does any hit of other rays.
"""

import numpy as np

from termwise.renderer.geometry import packets, simd, traverse, wide_traverse
from termwise.renderer.geometry.bvh import STACK_SIZE, Tree
from termwise.renderer.geometry.few import DOUBT, HIT, answer, any_hit_of_few, put_queries, query_of
from termwise.renderer.geometry.intersect import NOTHING, FaceRange, Hit, Ray, make_ray
from termwise.renderer.geometry.packets import Rays8, put_hit
from termwise.renderer.jit import device, kernel
from termwise.renderer.vector import column, vec3

_VECTORS = simd.available()
_NEAREST, _ANY = range(2)


@device
def _hopeful(group: Rays8, kind: int) -> bool:
    """Whether a packet of this kind is tried: not for a while after one that did not pay."""
    if group.backoff[kind, 0] > 0:
        group.backoff[kind, 0] -= 1
        return False
    return True


@device
def _give_up(group: Rays8, kind: int) -> None:
    group.backoff[kind, 0] = group.backoff[kind, 1]
    group.backoff[kind, 1] = min(2 * group.backoff[kind, 1], packets.MOST_BACKOFF)


if _VECTORS:

    @device
    def closest_hit(corners: np.ndarray, tree: Tree, ray: Ray, far: float, ignore: FaceRange, stack: np.ndarray) -> Hit:
        """Nearest hit at 0 < t <= far on any face but those of `ignore`; `stack` is int32 scratch of STACK_SIZE."""
        return wide_traverse.closest_hit(tree.wide, ray, far, ignore, stack)

    @device
    def any_hit(
        corners: np.ndarray, tree: Tree, ray: Ray, far: float, ignore: FaceRange, target: int, stack: np.ndarray
    ) -> bool:
        """Whether a face other than `target` and those of `ignore` is hit at 0 < t < far."""
        if len(tree.wide.few.corners) > 0:
            found = any_hit_of_few(tree.wide.few, ray, far, ignore, target)
            if found != DOUBT:
                return found == HIT
        return wide_traverse.any_hit(tree.wide, ray, far, ignore, target, stack)

    @device
    def closest_hits_of_group(
        corners: np.ndarray, tree: Tree, group: Rays8, count: int, far: float, coherent: bool, stack: np.ndarray
    ) -> None:
        """Write what `closest_hit` gives for the first `count` rays of a group; `coherent`: a packet may pay."""
        if coherent and count == packets.SIZE and _hopeful(group, _NEAREST):
            packet = packets.make_packet(tree.wide, group)
            if packet.coherent and (
                packets.closest_hits_among_few(corners, tree.wide, packet, group, far)
                if len(tree.wide.few.corners) > 0
                else packets.closest_hits_of_packet(tree.wide, packet, group, far, stack)
            ):
                group.backoff[_NEAREST, 1] = packets.BACKOFF
                return
            _give_up(group, _NEAREST)
        packets.closest_hits_of_bundle(tree.wide, group, count, far, stack)

    @device
    def _any_hits_of_few(tree: Tree, group: Rays8, count: int, far: float, stack: np.ndarray) -> None:
        """Write what `any_hit` gives for the first `count` rays of a group, where triangles are few."""
        doubts = 0
        put_queries(tree.wide.few, group.origins, group.directions, far, group.numbers, group.axes)
        for i in range(count):
            ignore = FaceRange(group.first[i], group.end[i])
            asked = query_of(group.numbers, group.axes, i)
            found = answer(tree.wide.few, asked, ignore, group.target[i])
            group.found[i] = found == HIT
            if found == DOUBT:
                doubts |= 1 << i
        # In a loop of its own: what a descent needs would not leave the registers to the loop above.
        for i in range(count):
            if (doubts >> i) & 1 != 0:
                ray = make_ray(column(group.origins, i), column(group.directions, i))
                ignore = FaceRange(group.first[i], group.end[i])
                group.found[i] = wide_traverse.any_hit(tree.wide, ray, far, ignore, group.target[i], stack)

    @device
    def any_hits_of_group(
        corners: np.ndarray, tree: Tree, group: Rays8, count: int, far: float, coherent: bool, stack: np.ndarray
    ) -> None:
        """Write what `any_hit` gives for the first `count` rays of a group; `coherent`: a packet may pay."""
        if coherent and count == packets.SIZE and _hopeful(group, _ANY):
            packet = packets.make_packet(tree.wide, group)
            if packet.coherent and (
                packets.any_hits_among_few(corners, tree.wide, packet, group, far)
                if len(tree.wide.few.corners) > 0
                else packets.any_hits_of_packet(tree.wide, packet, group, far, stack)
            ):
                group.backoff[_ANY, 1] = packets.BACKOFF
                return
            _give_up(group, _ANY)
        if len(tree.wide.few.corners) > 0:
            _any_hits_of_few(tree, group, count, far, stack)
            return
        packets.any_hits_of_bundle(tree.wide, group, count, far, stack)

else:
    closest_hit, any_hit = traverse.closest_hit, traverse.any_hit

    @device
    def closest_hits_of_group(
        corners: np.ndarray, tree: Tree, group: Rays8, count: int, far: float, coherent: bool, stack: np.ndarray
    ) -> None:
        """Write what `closest_hit` gives for the first `count` rays of a group; `coherent`: a packet may pay."""
        for i in range(count):
            ray = make_ray(column(group.origins, i), column(group.directions, i))
            ignore = FaceRange(group.first[i], group.end[i])
            put_hit(group, i, traverse.closest_hit(corners, tree, ray, far, ignore, stack))

    @device
    def any_hits_of_group(
        corners: np.ndarray, tree: Tree, group: Rays8, count: int, far: float, coherent: bool, stack: np.ndarray
    ) -> None:
        """Write what `any_hit` gives for the first `count` rays of a group; `coherent`: a packet may pay."""
        for i in range(count):
            ray = make_ray(column(group.origins, i), column(group.directions, i))
            ignore = FaceRange(group.first[i], group.end[i])
            group.found[i] = traverse.any_hit(corners, tree, ray, far, ignore, group.target[i], stack)


@device
def _load_group(origins: np.ndarray, directions: np.ndarray, row: int, count: int, group: Rays8) -> None:
    for axis in range(3):
        for i in range(count):
            group.origins[axis, i] = origins[row + i, axis]
            group.directions[axis, i] = directions[row + i, axis]


@kernel
def closest_hits(
    corners: np.ndarray,
    tree: Tree,
    origins: np.ndarray,
    directions: np.ndarray,
    far: float,
    t: np.ndarray,
    face: np.ndarray,
    group: Rays8,
) -> None:
    """Distance t (N,) and face (N,) int32 of the nearest hit of rays (N, 3), (N, 3); far and -1 where none is."""
    stack = np.empty(STACK_SIZE, np.int32)
    for row in range(0, len(origins), packets.SIZE):
        count = min(packets.SIZE, len(origins) - row)
        _load_group(origins, directions, row, count, group)
        closest_hits_of_group(corners, tree, group, count, far, True, stack)
        for i in range(count):
            t[row + i] = group.t[i]
            face[row + i] = group.face[i]


@kernel
def any_hits(
    corners: np.ndarray,
    tree: Tree,
    origins: np.ndarray,
    directions: np.ndarray,
    far: float,
    found: np.ndarray,
    group: Rays8,
) -> None:
    """Whether each ray hits anything nearer than `far`: (N,) bool."""
    stack = np.empty(STACK_SIZE, np.int32)
    for row in range(0, len(origins), packets.SIZE):
        count = min(packets.SIZE, len(origins) - row)
        _load_group(origins, directions, row, count, group)
        any_hits_of_group(corners, tree, group, count, far, True, stack)
        for i in range(count):
            found[row + i] = group.found[i]


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
