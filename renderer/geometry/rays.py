"""`closest_hit` and `any_hit` as this machine computes them best, and loops that trace many, in packets if it pays.

Both descents meet the same face at the same t: the wide tree's, eight boxes or triangles at a time, and the binary
tree's, the reference, which needs no vectors. Render kernels trace single rays; packets and bundles serve the loops
over many rays alone, as yet.
"""

import numpy as np

from renderer.geometry import packets, simd, traverse, wide_traverse
from renderer.geometry.bvh import STACK_SIZE, Tree
from renderer.geometry.intersect import NOTHING, FaceRange, Hit, Ray, make_ray
from renderer.jit import device, kernel
from renderer.vector import vec3

_VECTORS = simd.available()
# Groups of 8 rays that are traced as bundles after a packet that did not pay, or was none; twice as many each time.
_PATIENCE = 4
_MOST_PATIENCE = 256

if _VECTORS:

    @device
    def closest_hit(
        corners: np.ndarray, tree: Tree, ray: Ray, far: float, ignore: FaceRange, stack: np.ndarray
    ) -> Hit:
        """Nearest hit at 0 < t <= far on any face but those of `ignore`; `stack` is int32 scratch of STACK_SIZE."""
        return wide_traverse.closest_hit(tree.wide, ray, far, ignore, stack)

    @device
    def any_hit(
        corners: np.ndarray,
        tree: Tree,
        ray: Ray,
        far: float,
        ignore: FaceRange,
        target: int,
        stack: np.ndarray,
    ) -> bool:
        """Whether a face other than `target` and those of `ignore` is hit at 0 < t < far."""
        return wide_traverse.any_hit(tree.wide, ray, far, ignore, target, stack)

else:
    closest_hit, any_hit = traverse.closest_hit, traverse.any_hit


@kernel
def closest_hits(
    corners: np.ndarray,
    tree: Tree,
    origins: np.ndarray,
    directions: np.ndarray,
    far: float,
    t: np.ndarray,
    face: np.ndarray,
) -> None:
    """Distance t (N,) and face (N,) int32 of the nearest hit of rays (N, 3), (N, 3); far and -1 where none is."""
    stack = np.empty(STACK_SIZE, np.int32)
    shears = np.empty((packets.SIZE, 8))
    row = 0
    pause = 0
    patience = _PATIENCE
    while row < len(origins):
        last = min(row + packets.SIZE, len(origins))
        if _VECTORS and row + packets.SIZE == last:
            if pause > 0:
                pause -= 1
            else:
                packet = packets.make_packet(tree.wide, origins, directions, row)
                if packet.coherent and packets.closest_hits_of_packet(
                    tree.wide, packet, far, t, face, row, stack
                ):
                    row = last
                    patience = _PATIENCE
                    continue
                pause = patience
                patience = min(2 * patience, _MOST_PATIENCE)
            packets.closest_hits_of_bundle(tree.wide, origins, directions, far, t, face, row, stack, shears)
            row = last
            continue
        for i in range(row, last):
            ray = make_ray(vec3(origins, i), vec3(directions, i))
            hit = closest_hit(corners, tree, ray, far, NOTHING, stack)
            t[i] = hit.t
            face[i] = hit.face
        row = last


@kernel
def any_hits(
    corners: np.ndarray,
    tree: Tree,
    origins: np.ndarray,
    directions: np.ndarray,
    far: float,
    found: np.ndarray,
) -> None:
    """Whether each ray hits anything nearer than `far`: (N,) bool."""
    stack = np.empty(STACK_SIZE, np.int32)
    shears = np.empty((packets.SIZE, 8))
    row = 0
    pause = 0
    patience = _PATIENCE
    while row < len(origins):
        last = min(row + packets.SIZE, len(origins))
        if _VECTORS and row + packets.SIZE == last:
            if pause > 0:
                pause -= 1
            else:
                packet = packets.make_packet(tree.wide, origins, directions, row)
                if packet.coherent and packets.any_hits_of_packet(tree.wide, packet, far, found, row, stack):
                    row = last
                    patience = _PATIENCE
                    continue
                pause = patience
                patience = min(2 * patience, _MOST_PATIENCE)
            packets.any_hits_of_bundle(tree.wide, origins, directions, far, found, row, stack, shears)
            row = last
            continue
        for i in range(row, last):
            ray = make_ray(vec3(origins, i), vec3(directions, i))
            found[i] = any_hit(corners, tree, ray, far, NOTHING, -1, stack)
        row = last


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
