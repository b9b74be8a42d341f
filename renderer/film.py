"""What all drivers share: the sample's ray into the scene, and the sum of its radiance into the image."""

from typing import NamedTuple

import numpy as np

from termwise.renderer.arrays import CameraArrays, SceneArrays
from termwise.renderer.camera import CENTRE, JITTER, camera_ray, direction_through, draw_on_film
from termwise.renderer.dealing import deal
from termwise.renderer.geometry.wave import SIZE, hit_of, put_hit, put_ray
from termwise.renderer.jit import device, kernel
from termwise.renderer.rng import fold
from termwise.renderer.scratch import Scratch
from termwise.renderer.sobol import Sampler
from termwise.renderer.surface import trace, trace_wave
from termwise.renderer.vector import Vec3, add, column, length, put, put_column, sub, vec3

# Samples of a pixel that have a camera ray each: edges need some before the rest shares.
ALONE = 4
# Pixels side by side that waves go down a tile by, a power of 2: 64 of one sample each are a square.
_STRIP = 8


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


class Work(NamedTuple):
    """What is rendered: threads are dealt its items one by one, and one call of a kernel may take many.

    Attributes
    ----------
    items : (N, 5) int64, rows `(x0, y0, x1, y1, split)`: a tile of pixels, `split` of whose samples share a camera ray.
    begin, end : (H, W) int32 each, the samples [begin, end) of each pixel that are taken.
    dealt : (1,) int64, how many items are taken, see `dealing`; all threads share it.
    most : how many of them one call may take.
    """

    items: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    dealt: np.ndarray
    most: int


class PrimaryHits(NamedTuple):
    """The wave of primary hits at hand, and where it stands in the work.

    Attributes
    ----------
    count : how many, those of `scratch.primary`; 0 where there are no more.
    ends_tile : whether they are the last ones of their tile; a wave has no second one.
    split : of the item.
    taken : how many items this call has been dealt.
    item, next_x, next_y, next_index : of the next primary hit.
    """

    count: int
    ends_tile: bool
    split: int
    taken: int
    item: int
    next_x: int
    next_y: int
    next_index: int


@device
def no_hits() -> PrimaryHits:
    """What stands before the first wave."""
    return PrimaryHits(0, True, 1, 0, 0, 0, 0, 0)


@device
def _following(tile: np.ndarray, x: int, y: int) -> tuple[int, int]:
    """The pixel after (x, y), row by row of each strip of a tile; below the tile after the last."""
    strip = x - ((x - tile[0]) & (_STRIP - 1))
    if x + 1 < min(strip + _STRIP, tile[2]):
        return x + 1, y
    if y + 1 == tile[3] and strip + _STRIP < tile[2]:
        return strip + _STRIP, tile[1]
    return strip, y + 1


@device
def _next_pixel(work: Work, tile: np.ndarray, x: int, y: int) -> tuple[int, int]:
    """The first pixel of a tile, from (x, y) on, that takes samples; below the tile where none does."""
    while y < tile[3] and work.begin[y, x] >= work.end[y, x]:
        x, y = _following(tile, x, y)
    return x, y


@device
def next_hits(scene: SceneArrays, key: np.uint64, work: Work, hits: PrimaryHits, scratch: Scratch) -> PrimaryHits:
    """Fill `scratch.primary` with the next 64 of the work, or what is left of a tile, pixel by pixel of its strips.

    A primary hit is what one camera ray meets, for `split` samples. Rays of one pixel, or of a few side by side, go
    the same way: they make packets. Rays through one point of their pixel are one ray, traced for its first primary hit
    alone.

    A driver calls it in one place, in a loop that has no end, and leaves at `count` 0. As the condition of a `while` it
    would be compiled twice: Python repeats the condition behind the body.
    """
    split, taken, item, x, y, index = hits.split, hits.taken, hits.item, hits.next_x, hits.next_y, hits.next_index
    begins = hits.ends_tile
    while begins:
        item = deal(work.dealt) if taken < work.most else len(work.items)
        if item >= len(work.items):
            return PrimaryHits(0, True, split, taken, item, x, y, index)
        if taken == 0:
            # All rays of a call leave one point, and pass no face.
            for i in range(SIZE):
                put_ray(scratch.primary, i, scene.camera.position, column(scratch.primary.directions, i))
        taken += 1
        x, y = _next_pixel(work, work.items[item], work.items[item, 0], work.items[item, 1])
        begins = y == work.items[item, 3]
    if hits.ends_tile:
        split = work.items[item, 4]
        index = primary_hits_of(work.begin[y, x], work.end[y, x], split)[0]
    tile = work.items[item]
    end = primary_hits_of(work.begin[y, x], work.end[y, x], split)[1]
    count = 0
    # The key of all randomness of a pixel.
    pixel = fold(key, y * scene.camera.width + x)
    while count < SIZE and y < tile[3]:
        scratch.x[count] = x
        scratch.y[count] = y
        scratch.pixel[count] = pixel
        scratch.index[count] = index
        count += 1
        index += 1
        if index == end:
            x, y = _following(tile, x, y)
            x, y = _next_pixel(work, tile, x, y)
            if y < tile[3]:
                index, end = primary_hits_of(work.begin[y, x], work.end[y, x], split)
                pixel = fold(key, y * scene.camera.width + x)
    _look(scene, work, split, count, scratch)
    return PrimaryHits(count, y == tile[3], split, taken, item, x, y, index)


@device
def _is_first(work: Work, i: int, split: int, scratch: Scratch) -> bool:
    """Whether primary hit i is the first one of its pixel that is asked for."""
    return scratch.index[i] == _primary_hit_of(work.begin[scratch.y[i], scratch.x[i]], split)


@device
def _look(scene: SceneArrays, work: Work, split: int, count: int, scratch: Scratch) -> None:
    """Trace the first `count` primary hits."""
    primary, camera = scratch.primary, scene.camera
    # In loops of their own, which are vectorised.
    draw_on_film(camera, scratch.pixel, scratch.index, count, scratch.u, scratch.v, scratch.words)
    for i in range(count):
        direction = direction_through(camera, scratch.x[i] + scratch.u[i], scratch.y[i] + scratch.v[i])
        put_column(primary.directions, i, direction)
    shared = camera.rule != JITTER and scene.skips.pixel
    before, asked = hit_of(primary, SIZE - 1), count
    if shared:
        # The rays of a pixel are one; where a pixel goes on, it was traced with the 64 before.
        asked = 0
        for i in range(count):
            put_column(primary.directions, asked, column(primary.directions, i))
            asked += 1 if _is_first(work, i, split, scratch) else 0
    if asked > 0:
        trace_wave(scene, primary, asked, True, scratch)
    if shared and asked < count:
        for i in range(count - 1, -1, -1):
            put_hit(primary, i, hit_of(primary, asked - 1) if asked > 0 else before)
            asked -= 1 if _is_first(work, i, split, scratch) else 0
        for i in range(count):
            direction = direction_through(camera, scratch.x[i] + scratch.u[i], scratch.y[i] + scratch.v[i])
            put_ray(primary, i, camera.position, direction)


@device
def accumulate(out: np.ndarray, y: int, x: int, radiance: Vec3) -> None:
    """Add a radiance to a pixel of (H, W, 3) float64."""
    out[y, x, 0] += radiance.x
    out[y, x, 1] += radiance.y
    out[y, x, 2] += radiance.z


@device
def added(total: Vec3, radiance: Vec3) -> Vec3:
    """A pixel's sum with a sample more, where it is not written for each."""
    return add(total, radiance)


@device
def accumulate_hits(out: np.ndarray, count: int, scratch: Scratch) -> None:
    """Add `scratch.radiance` of the first `count` primary hits to their pixels, one by one and in this order."""
    if count > 0:
        y, x = scratch.y[0], scratch.x[0]
        total = vec3(out[y], x)
        for i in range(count):
            if scratch.y[i] != y or scratch.x[i] != x:
                put(out[y], x, total)
                y, x = scratch.y[i], scratch.x[i]
                total = vec3(out[y], x)
            total = added(total, column(scratch.radiance, i))
        put(out[y], x, total)


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
