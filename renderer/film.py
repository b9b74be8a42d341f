"""What all drivers share: the sample's ray into the scene, and the sum of its radiance into the image."""

import math
from typing import NamedTuple

import numpy as np

from termwise.renderer.arrays import CameraArrays, SceneArrays
from termwise.renderer.camera import CENTRE, JITTER, camera_ray, direction_through, point_in_pixel
from termwise.renderer.geometry.intersect import make_ray
from termwise.renderer.geometry.packets import SIZE
from termwise.renderer.jit import device, kernel
from termwise.renderer.rng import fold
from termwise.renderer.scratch import Scratch
from termwise.renderer.sobol import Sampler
from termwise.renderer.surface import closest, hit_of, occlude_group, put_hit, put_ray, trace, trace_group
from termwise.renderer.vector import Vec3, column, length, put, put_column, sub, vec3

# Samples of a pixel that have a camera ray each: edges need some before the rest shares.
ALONE = 4


class Tile(NamedTuple):
    """Pixels x0 <= x < x1, y0 <= y < y1."""

    x0: int
    y0: int
    x1: int
    y1: int


@device
def sampler_of(i: int, scratch: Scratch) -> Sampler:
    """Randomness of primary hit i."""
    return Sampler(scratch.pixel[i], np.uint32(scratch.index[i]))


@device
def _first_of(hit: int, split: int) -> int:
    return hit if hit < ALONE else ALONE + (hit - ALONE) * split


@device
def _primary_hit_of(sample: int, split: int) -> int:
    return sample if sample < ALONE else ALONE + (sample - ALONE) // split


@device
def primary_hits_of(first: int, last: int, split: int) -> tuple[int, int]:
    """Primary hits [begin, end) of the samples [first, last) of a pixel: one each of ALONE, then one for `split`."""
    return _primary_hit_of(first, split), _primary_hit_of(last - 1, split) + 1


@device
def samples_of(hit: int, split: int, first: int, last: int) -> tuple[int, int]:
    """Samples [begin, end), among [first, last) of a pixel, that a primary hit is for."""
    return max(first, _first_of(hit, split)), min(last, _first_of(hit + 1, split))


@device
def most_of(last: int, split: int) -> int:
    """The most samples that a primary hit of samples [0, last) is for."""
    return split if last > ALONE else 1


class PrimaryHits(NamedTuple):
    """The group of primary hits at hand, and where it stands in the work.

    Work is (N, 7) int64, a row `(x0, y0, x1, y1, first, last, split)`: the samples [first, last) of a tile's pixels,
    `split` of which share a camera ray. Many small tiles take one call of a kernel.

    Attributes
    ----------
    count : how many, those of `scratch.primary`; 0 where there are no more.
    y : their row of the image; a group has no second one.
    ends_row : whether they are the last ones of their row of the tile.
    first, last, split : of the item.
    item, x, index : of the next primary hit.
    """

    count: int
    y: int
    ends_row: bool
    first: int
    last: int
    split: int
    item: int
    x: int
    index: int


@device
def no_hits() -> PrimaryHits:
    """What stands before the first group."""
    return PrimaryHits(0, 0, True, 0, 0, 1, -1, 0, 0)


@device
def next_hits(scene: SceneArrays, key: np.uint64, work: np.ndarray, hits: PrimaryHits, scratch: Scratch) -> PrimaryHits:
    """Fill `scratch.primary` with the next 8 of the work, or what is left of a row, pixel by pixel.

    A primary hit is what one camera ray meets, for `split` samples. Rays of one pixel, or of a few side by side, go
    the same way: they make a packet (20 ns a ray in place of 87 singly, in the Cornell box). Rays through one point of
    their pixel are one ray, traced for its first primary hit alone. What another term has traced is taken from
    `scratch.seen`.

    A driver calls it in one place, in a loop that has no end, and leaves at `count` 0. As the condition of a `while` it
    would be compiled twice: Python repeats the condition behind the body.
    """
    y, first, last, split = hits.y, hits.first, hits.last, hits.split
    item, x, index = hits.item, hits.x, hits.index
    if hits.ends_row:
        y += 1
        while item < 0 or y >= work[item, 3] or first >= last:
            item += 1
            if item == len(work):
                return PrimaryHits(0, y, True, first, last, split, item, x, index)
            y, first, last, split = work[item, 1], work[item, 4], work[item, 5], work[item, 6]
        x = work[item, 0]
        index, _ = primary_hits_of(first, last, split)
    x1 = work[item, 2]
    begin, end = primary_hits_of(first, last, split)
    count = min(SIZE, (x1 - x) * (end - begin) - (index - begin))
    # The key of all randomness of a pixel.
    pixel = fold(key, y * scene.camera.width + x)
    known = scratch.seen.face.shape[1] > 0
    for i in range(count):
        if index == end:
            x += 1
            index = begin
            pixel = fold(key, y * scene.camera.width + x)
        scratch.x[i] = x
        scratch.pixel[i] = pixel
        scratch.index[i] = index
        known = known and index < scratch.seen.known[y, x]
        index += 1
    if known:
        for i in range(count):
            _recall(scene, y, i, scratch)
    else:
        _look(scene, y, begin, count, scratch)
    if index == end:
        x += 1
        index = begin
    return PrimaryHits(count, y, x == x1, first, last, split, item, x, index)


@device
def _look(scene: SceneArrays, y: int, begin: int, count: int, scratch: Scratch) -> None:
    """Trace the first `count` primary hits of row y, from a pixel's `begin` on, and keep those there is room for."""
    primary, camera = scratch.primary, scene.camera
    # Loops of their own: what hashes and maps eight points is vectorised.
    for i in range(count):
        scratch.u[i], scratch.v[i] = point_in_pixel(camera, sampler_of(i, scratch))
    for i in range(count):
        direction = direction_through(camera, scratch.x[i] + scratch.u[i], y + scratch.v[i])
        put_column(primary.directions, i, direction)
    for i in range(count):
        put_ray(primary, i, camera.position, column(primary.directions, i))
    if camera.rule == JITTER or not scene.skips.pixel:
        trace_group(scene, primary, count, scratch)
    else:
        for i in range(count):
            if scratch.index[i] == begin:
                ray = make_ray(camera.position, column(primary.directions, i))
                put_hit(primary, i, closest(scene, ray, math.inf, -1, scratch))
            else:
                # Before primary hit 0 comes the last one of the 8 before.
                put_hit(primary, i, hit_of(primary, (i - 1) % SIZE))
    seen = scratch.seen
    for i in range(count):
        x, index = scratch.x[i], scratch.index[i]
        if index < seen.face.shape[1] and index == seen.known[y, x]:
            seen.face[y, index, x] = primary.face[i]
            seen.ray[y, index, x, 0] = primary.b1[i]
            seen.ray[y, index, x, 1] = primary.b2[i]
            for axis in range(3):
                seen.ray[y, index, x, 2 + axis] = primary.directions[axis, i]
            seen.known[y, x] += 1


@device
def _recall(scene: SceneArrays, y: int, i: int, scratch: Scratch) -> None:
    """Take primary hit i of row y from those that are kept."""
    primary, seen = scratch.primary, scratch.seen
    x, index = scratch.x[i], scratch.index[i]
    ray = seen.ray[y, index]
    put_ray(primary, i, scene.camera.position, Vec3(ray[x, 2], ray[x, 3], ray[x, 4]))
    # Nothing asks for the distance of a primary hit.
    primary.face[i] = seen.face[y, index, x]
    primary.b1[i] = ray[x, 0]
    primary.b2[i] = ray[x, 1]


@device
def accumulate(out: np.ndarray, y: int, x: int, radiance: Vec3) -> None:
    """Add a radiance to a pixel of (H, W, 3) float64."""
    out[y, x, 0] += radiance.x
    out[y, x, 1] += radiance.y
    out[y, x, 2] += radiance.z


@device
def resolve_occlusion(
    scene: SceneArrays, waiting: int, asking: int, far: float, coherent: bool, y: int, out: np.ndarray, scratch: Scratch
) -> None:
    """Add the first `waiting` samples of a row to their pixels, in order; the first `asking` rays may hide theirs.

    `far`, `coherent`: see `occlude_group`.
    """
    if asking > 0:
        occlude_group(scene, scratch.rays, asking, far, coherent, scratch)
        for k in range(asking):
            if scratch.rays.found[k]:
                put(scratch.radiance, scratch.lane[k], vec3(scratch.hidden, scratch.lane[k]))
    for i in range(waiting):
        accumulate(out, y, scratch.column[i], vec3(scratch.radiance, i))


class GeometryImages(NamedTuple):
    """What the ray through each pixel's centre meets; (H, W) each, `normal` (H, W, 3).

    `depth` is the distance along the unit ray, inf where nothing is met; `normal` the face's own unit normal; `object`
    and `face` are indices, -1 where nothing is met.
    """

    depth: np.ndarray
    normal: np.ndarray
    object: np.ndarray
    face: np.ndarray


@kernel
def trace_centres(scene: SceneArrays, tile: Tile, images: GeometryImages, scratch: Scratch) -> None:
    """Fill a tile of the geometry images."""
    c = scene.camera
    centre = CameraArrays(c.position, c.corner, c.across, c.down, c.width, c.height, CENTRE)
    for y in range(tile.y0, tile.y1):
        for x in range(tile.x0, tile.x1):
            ray = camera_ray(centre, x, y, Sampler(np.uint64(0), np.uint32(0)))
            surface = trace(scene, ray, -1, scratch)
            # A sphere is no object of the scene's.
            met = 0 <= surface.face < len(scene.geometry.corners)
            images.object[y, x] = surface.object if met else -1
            images.face[y, x] = surface.face if met else -1
            if met:
                images.depth[y, x] = length(sub(surface.point, ray.origin))
                normal = vec3(scene.geometry.normals, surface.face)
                images.normal[y, x, 0] = normal.x
                images.normal[y, x, 1] = normal.y
                images.normal[y, x, 2] = normal.z
