"""Images on surfaces and lamps: `u = (1 - b1 - b2) u0 + b1 u1 + b2 u2`, and bilinear between centres of texels.

What an image means says `scenes.textures`. Coordinates are float64, texels the float32 that they are given as.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from termwise.renderer.by_reference import by_reference
from termwise.renderer.jit import device
from termwise.renderer.vector import Vec3
from termwise.scenes.model import Scene
from termwise.scenes.textures import Texture


@by_reference()
class Textures(NamedTuple):
    """The images of a scene, one behind the other, each once.

    Attributes
    ----------
    uv : (F, 3, 2), place of each face's corners in an image; 0 of what has none.
    color, gloss, roughness : (O,) int32, which image an object has there; -1: none.
    emission : the same of what it sends; None of a scene without, whose kernels are compiled without.
    first : (T,) int64, where an image begins among the texels.
    width, height : (T,) int64.
    repeats : (T,) bool; else the border goes on.
    texels : (N,) float32, row by row from the top, channel by channel.
    """

    uv: np.ndarray
    color: np.ndarray
    gloss: np.ndarray
    roughness: np.ndarray
    emission: np.ndarray | None
    first: np.ndarray
    width: np.ndarray
    height: np.ndarray
    repeats: np.ndarray
    texels: np.ndarray


def from_scene(scene: Scene) -> Textures | None:
    """Those of its surfaces and lamps; None without."""
    emitted = [thing.emission if scene.toggles.lighting else None for thing in scene.objects]
    of_lamps = [image for image in emitted if isinstance(image, Texture)]
    of_surfaces = (image for surface in scene.surfaces for image in surface.textures.values())
    images = list(dict.fromkeys((*of_surfaces, *of_lamps)))
    if not images:
        return None
    meshes = [thing.mesh for thing in scene.objects]
    sizes = [image.texels.size for image in images]
    return Textures(
        np.concatenate([np.zeros((len(mesh.faces), 3, 2)) if mesh.uv is None else mesh.uv for mesh in meshes]),
        _numbers(images, [surface.color for surface in scene.surfaces]),
        _numbers(images, [surface.gloss if scene.toggles.reflections else 0.0 for surface in scene.surfaces]),
        _numbers(images, [surface.roughness for surface in scene.surfaces]),
        _numbers(images, [*emitted, *(None for _ in scene.spheres)]) if of_lamps else None,
        np.cumsum([0, *sizes[:-1]]),
        np.array([image.texels.shape[1] for image in images]),
        np.array([image.texels.shape[0] for image in images]),
        np.array([image.wrap == "repeat" for image in images]),
        np.concatenate([image.texels.ravel() for image in images]),
    )


def _numbers(images: list[Texture], values: Sequence[object]) -> np.ndarray:
    return np.array([images.index(value) if isinstance(value, Texture) else -1 for value in values], np.int32)


@device
def _along(place: float, size: int, repeats: bool) -> tuple[int, int, float]:
    """The texels on both sides of a place along an axis of [0, 1], and the share of the second."""
    # Not math.floor, which is an int64 in kernels: a place may be further away.
    place = place - np.floor(place) if repeats else min(max(place, 0.0), 1.0)
    at = place * size - 0.5
    below = math.floor(at)
    low, high = int(below), int(below) + 1
    if repeats:
        low = size - 1 if low < 0 else low
        high = 0 if high == size else high
    else:
        low, high = max(low, 0), min(high, size - 1)
    return low, high, at - below


@device
def _place(images: Textures, face: int, b1: float, b2: float) -> tuple[float, float]:
    b0 = 1.0 - b1 - b2
    uv = images.uv
    return (
        b0 * uv[face, 0, 0] + b1 * uv[face, 1, 0] + b2 * uv[face, 2, 0],
        b0 * uv[face, 0, 1] + b1 * uv[face, 1, 1] + b2 * uv[face, 2, 1],
    )


class _Corners(NamedTuple):
    """The four texels around a place, by their number in the image, and their weights."""

    top_left: int
    top_right: int
    bottom_left: int
    bottom_right: int
    a: float
    b: float
    c: float
    d: float


@device
def _corners(images: Textures, image: int, face: int, b1: float, b2: float) -> _Corners:
    u, v = _place(images, face, b1, b2)
    width, repeats = images.width[image], images.repeats[image]
    left, right, across = _along(u, width, repeats)
    top, bottom, down = _along(1.0 - v, images.height[image], repeats)
    return _Corners(
        top * width + left,
        top * width + right,
        bottom * width + left,
        bottom * width + right,
        (1.0 - across) * (1.0 - down),
        across * (1.0 - down),
        (1.0 - across) * down,
        across * down,
    )


@device
def number_at(images: Textures, image: int, face: int, b1: float, b2: float) -> float:
    """Number of an image of one channel at a point of a face."""
    at, first, t = _corners(images, image, face, b1, b2), images.first[image], images.texels
    upper = at.a * t[first + at.top_left] + at.b * t[first + at.top_right]
    return upper + at.c * t[first + at.bottom_left] + at.d * t[first + at.bottom_right]  # type: ignore[return-value]


@device
def _channel(images: Textures, image: int, at: _Corners, channel: int) -> float:
    first, t = images.first[image] + channel, images.texels
    upper = at.a * t[first + 3 * at.top_left] + at.b * t[first + 3 * at.top_right]
    lower = at.c * t[first + 3 * at.bottom_left] + at.d * t[first + 3 * at.bottom_right]
    return upper + lower  # type: ignore[return-value]


@device
def color_at(images: Textures, image: int, face: int, b1: float, b2: float) -> Vec3:
    """Colour of an image of three channels at a point of a face."""
    at = _corners(images, image, face, b1, b2)
    return Vec3(_channel(images, image, at, 0), _channel(images, image, at, 1), _channel(images, image, at, 2))
