"""Pixel means over camera rays: `(1/N) Σ estimate(ray_k)`, the rays made from the paper's own formula.

No film, filter or sensor of Mitsuba takes part, so that no pixel-position difference can pass for a bias. A pixel's
rays, the first directions of its chains and what else is chosen once a sample lie on a randomly shifted lattice of five
dimensions: every sample is uniform, hence no bias, and edges, textures and lobes have less variance than under
independent numbers.
"""

# pyright: reportOperatorIssue=false
# Mitsuba's stubs do not know the types of the variant in use.

from collections.abc import Callable
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

WIDTH = 2**20  # rays of one pass: bounds memory
GOLDEN = 0.6180339887498949
STEPS = 3518319155, 2882110345, 2360945575  # 2^32 / r^k, r^4 = r + 1: Roberts' sequence of three dimensions
UNBOUNDED = 1e30  # a length that stands for infinity, see `translate`


class Samples(NamedTuple):
    """One camera ray per lane.

    Attributes
    ----------
    ray : mi.Ray3f at the canonical scale.
    sampler : mi.Sampler, seeded for the lanes.
    lobe : mi.Point2f, uniform: what a chain draws its first direction by.
    choice : mi.Float, uniform in [0, 1): what a chain chooses its vertex by.
    """

    ray: Any
    sampler: Any
    lobe: Any
    choice: Any


Estimator = Callable[[Samples], tuple[Any, ...]]


def pixel_means(estimate: Estimator, camera: dict[str, Any], *, spp: int, seed: int) -> np.ndarray:
    """Mean of each image that `estimate` returns, over `spp` rays a pixel.

    Parameters
    ----------
    estimate : Samples -> tuple of P mi.Color3f
    camera : as `translate.describe` gives it.
    spp : samples per pixel.
    seed : 32-bit seed; pass i of a call uses `seed + i`.

    Returns
    -------
    (P, H, W, 3) float64; passes are added in float64.
    """
    width, height = camera["resolution"]
    per_pass = min(spp, max(1, WIDTH // (width * height)))
    total = np.zeros(())
    for number, first in enumerate(range(0, spp, per_pass)):
        total = total + _pass_sums(estimate, camera, min(per_pass, spp - first), (seed + number) % 2**32)
    return total.reshape(-1, height, width, 3) / spp


def _pass_sums(estimate: Estimator, camera: dict[str, Any], count: int, seed: int) -> np.ndarray:
    """Sums over `count` samples a pixel, (P, pixels, 3) float64."""
    width, height = camera["resolution"]
    if not dr.is_jit_v(mi.Float):
        return _one_by_one(estimate, camera, count, seed)
    lanes = width * height * count
    opaque_seed, opaque_count = dr.opaque(mi.UInt32, seed), dr.opaque(mi.UInt32, count)
    lane = dr.arange(mi.UInt32, lanes)
    pixel = lane // opaque_count
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(opaque_seed, lanes)
    samples = camera_samples(camera, pixel, lane - pixel * opaque_count, opaque_count, opaque_seed, sampler)
    images = estimate(samples)
    planes = [channel + dr.zeros(mi.Float, lanes) for image in images for channel in image]  # constants too
    dr.eval(planes)  # apart from the sums, whose kernel differs with `count`
    sums = [dr.block_sum(plane, count) for plane in planes]
    totals = np.array([np.array(total) for total in sums], np.float64)
    return totals.reshape(len(images), 3, width * height).transpose(0, 2, 1)


def _one_by_one(estimate: Estimator, camera: dict[str, Any], count: int, seed: int) -> np.ndarray:
    """As `_pass_sums` in a variant that has no lanes: some thousand samples a second."""
    width, height = camera["resolution"]
    sampler = mi.load_dict({"type": "independent"})
    sums = []
    for pixel in range(width * height):
        total = 0.0
        for index in range(count):
            # Seeded per sample, as lanes are.
            sampler.seed(mi.sample_tea_32(pixel * count + index, seed)[0], 1)
            images = estimate(camera_samples(camera, pixel, index, count, seed, sampler))
            total = total + np.array([list(image) for image in images], np.float64)
        sums.append(total)
    return np.array(sums).transpose(1, 0, 2)


def camera_samples(camera: dict[str, Any], pixel: Any, index: Any, count: Any, seed: Any, sampler: Any) -> Samples:
    """Ray `index` of `count` through each pixel (numbered row by row)."""
    width, height = camera["resolution"]
    row = pixel // dr.opaque(mi.UInt32, width)
    column = pixel - row * dr.opaque(mi.UInt32, width)
    shift_x, shift_y = mi.sample_tea_32(pixel, seed)
    shift_u, shift_v = mi.sample_tea_32(shift_x, shift_y)
    shift_c, _ = mi.sample_tea_32(shift_u, shift_v)
    shifts = shift_u, shift_v, shift_c
    u, v, choice = (_unit((index * step + shift) & 0xFFFFFFFF) for step, shift in zip(STEPS, shifts, strict=True))
    if camera["pixel"] == "jitter":
        x = _fraction(mi.Float(index) / mi.Float(count) + _unit(shift_x))
        y = _fraction(mi.Float(index) * GOLDEN + _unit(shift_y))
    else:
        x = y = mi.Float(0.5 if camera["pixel"] == "centre" else 0.0)
    x = (mi.Float64(column) + mi.Float64(x)) / dr.opaque(mi.Float64, width)
    y = (mi.Float64(row) + mi.Float64(y)) / dr.opaque(mi.Float64, height)
    return Samples(camera_ray(camera, x, y), sampler, mi.Point2f(u, v), choice)


def camera_ray(camera: dict[str, Any], x: Any, y: Any) -> Any:
    """The ray through a point of the near plane, from where it enters the ball about all geometry.

    In double precision up to there: from a distance of 1e6 scenes, single precision misses the pixel.
    """
    corner, across, down = (dr.opaque(mi.Vector3d, camera[axis]) for axis in ("corner", "across", "down"))
    direction = dr.normalize(corner + x * across + y * down)
    origin = dr.opaque(mi.Point3d, camera["origin"])
    middle = -dr.dot(mi.Vector3d(origin), direction)
    half_squared = dr.square(dr.opaque(mi.Float64, camera["ball"])) - dr.squared_norm(origin + middle * direction)
    entry = dr.maximum(middle - dr.safe_sqrt(half_squared), 0.0)
    origin = dr.fma(direction, dr.select(half_squared > 0.0, entry, 0.0), origin)
    return mi.Ray3f(mi.Point3f(origin), mi.Vector3f(direction))


def _unit(bits: Any) -> Any:
    """Map 32 random bits to [0, 1): the upper 24 are what a float32 holds."""
    return mi.Float(bits >> 8) * 2.0**-24


def _fraction(x: Any) -> Any:
    return x - dr.floor(x)


def idle(active: Any) -> bool:
    """Whether a single ray, in a variant without lanes, has nothing more to do: it has no shape to call."""
    return not dr.is_jit_v(mi.Float) and not active


def meets_surface(si: Any) -> Any:
    """Lanes that hit something other than the surface of a light."""
    if dr.is_jit_v(mi.Float):
        return si.is_valid() & ~si.shape.is_emitter()
    return si.is_valid() and not si.shape.is_emitter()  # one ray, whose shape is None on a miss


def shape_pointer(shape: Any) -> Any:
    """What `si.shape` is to be compared with."""
    return mi.ShapePtr(shape) if dr.is_jit_v(mi.Float) else shape


def rowwise(function: Callable[..., tuple[Any, ...]], *columns: np.ndarray) -> list[np.ndarray]:
    """Outputs (N,) or (N, d) float64 of a function of Mitsuba's values, for rows (N,) or (N, d) of its arguments.

    All rows at once; one by one in a variant that has no lanes.
    """
    components = [np.atleast_2d(column.T) for column in columns]
    kinds = [{1: mi.UInt32, 2: mi.Point2f, 3: mi.Point3f}[len(column)] for column in components]

    def outputs(*values: Any) -> list[np.ndarray]:
        # By components: from a whole array Dr.Jit would make code that holds its length, and compile it for each.
        results = function(*(kind(*value) for kind, value in zip(kinds, values, strict=True)))
        dr.eval(results)
        return [np.array(result, np.float64).T for result in results]

    if dr.is_jit_v(mi.Float):
        count = len(columns[0])
        # What is the same for all rows comes back as one.
        return [np.broadcast_to(found, (count, *found.shape[1:])) for found in outputs(*components)]
    rows = [outputs(*row) for row in zip(*(column.T.tolist() for column in components), strict=True)]
    return [np.array(column) for column in zip(*rows, strict=True)]
