"""Rays traced together: 64 of them, of which 16 fill a vector of float32 and 8 one of float64."""

from typing import NamedTuple

import numpy as np

from termwise.renderer.by_reference import by_reference
from termwise.renderer.geometry.bvh8 import DEEPEST
from termwise.renderer.geometry.intersect import Hit
from termwise.renderer.jit import device
from termwise.renderer.memory import on_own_lines
from termwise.renderer.vector import Vec3, entry, put_column

SIZE = 64
# Packets that go with the stream after one that did not pay, or was none; twice as many each time.
BACKOFF = 4


@by_reference(origins=(SIZE,), directions=(SIZE,), scaled=(SIZE,), shears=(SIZE,), axes=(SIZE,), backoff=(2,))
class Wave(NamedTuple):
    """Rays and what they meet; a part of them counts, the first ones.

    Attributes
    ----------
    origins, directions : (3, 64) float64 each.
    first, end : (64,) int32, the faces first <= face < end that each ray passes because it leaves them.
    target : (64,) int32, a face that hides nothing (-1: none).
    t, b1, b2, face : (64,) float64, the last int32: the nearest hits, as `Hit` has them.
    found : (64,) bool, whether anything is hit.
    scaled : (10, 64) float32 scratch: origins, directions, moments and far ends in the coordinates of `polygons`, what
        the boxes of `streams` ask, or the lines of `packets`, with the boxes or triangles at hand.
    candidates : (64,) int32 scratch.
    shears, axes : (7, 64) float64 and (6, 64) int32 scratch of `streams`; of the shears the first row of `polygons`,
        and three of `packets`.
    backoff : (2, 2) int64, for nearest and for any hits: how many packets more go with the stream at once, and how
        many after the next packet that does not pay.
    keys, masks : (DEEPEST,) float32 and int64 scratch of `packets`: how far the nodes on the stack are, and which rays
        they may hold.
    """

    origins: np.ndarray
    directions: np.ndarray
    first: np.ndarray
    end: np.ndarray
    target: np.ndarray
    t: np.ndarray
    b1: np.ndarray
    b2: np.ndarray
    face: np.ndarray
    found: np.ndarray
    scaled: np.ndarray
    candidates: np.ndarray
    shears: np.ndarray
    axes: np.ndarray
    backoff: np.ndarray
    keys: np.ndarray
    masks: np.ndarray


def new_wave() -> Wave:
    """Make a wave whose rays leave no face and aim at none."""
    arrays = (
        np.zeros((3, SIZE)),
        np.ones((3, SIZE)),
        np.full(SIZE, -1, np.int32),
        np.zeros(SIZE, np.int32),
        np.full(SIZE, -1, np.int32),
        np.zeros(SIZE),
        np.zeros(SIZE),
        np.zeros(SIZE),
        np.full(SIZE, -1, np.int32),
        np.zeros(SIZE, np.bool_),
        np.zeros((10, SIZE), np.float32),
        np.zeros(SIZE, np.int32),
        np.zeros((7, SIZE)),
        np.zeros((6, SIZE), np.int32),
        np.array([[0, BACKOFF], [0, BACKOFF]]),
        np.zeros(DEEPEST, np.float32),
        np.zeros(DEEPEST, np.int64),
    )
    return Wave(*map(on_own_lines, arrays))


@device
def put_ray(wave: Wave, i: int, origin: Vec3, direction: Vec3) -> None:
    """Make ray i one that leaves no face."""
    put_column(wave.origins, i, origin)
    put_column(wave.directions, i, direction)
    wave.first[i] = -1
    wave.end[i] = 0
    wave.target[i] = -1


@device
def hit_of(wave: Wave, i: int) -> Hit:
    """What ray i has met."""
    return Hit(wave.t[i], entry(wave.face, i), wave.b1[i], wave.b2[i])


@device
def put_hit(wave: Wave, i: int, hit: Hit) -> None:
    """Write what ray i has met."""
    wave.t[i] = hit.t
    wave.face[i] = hit.face
    wave.b1[i] = hit.b1
    wave.b2[i] = hit.b2
