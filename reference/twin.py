"""The twin of a photon density estimate: `color (1 - g) / π · mean over maps of E(x)`, E by a kernel or the k nearest.

What the estimate's kernel does to E is part of what is meant, so its reference is the same estimate made by other
means: photons leave Mitsuba's emitters (`sample_ray`), fly by `ray_intersect`, and are gathered by scipy's k-d tree
(see `density`). They are independent of each other, and every map has its own. Roulette survives with
`P = min(0.99, largest channel of the albedo)`; a survivor is scattered with cosine density.
"""

# pyright: reportArgumentType=false, reportOperatorIssue=false, reportCallIssue=false
# Mitsuba's stubs do not know the types of the variant in use.

from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from . import density
from .density import Faces, Photons, Points
from .terms import direct
from .wavefront import camera_samples, pixel_means

MAX_SURVIVAL = 0.99
PHOTONS = 2**16  # of a map whose mean does not depend on the count
LIGHT_SAMPLES = 32  # a pixel and map, of the first hits that no photon stands for
POINTS = 2**14  # gathered together: bounds memory


class Surfaces(NamedTuple):
    """The faces of a scene, and tables by the number that Dr.Jit gives a shape; 0 is none, and black.

    Attributes
    ----------
    faces : triangles at the canonical scale.
    first : mi.UInt32, number of a shape's first face.
    albedo : mi.Color3f, `color (1 - g)` of a shape.
    """

    faces: Faces
    first: Any
    albedo: Any


def render(loaded: Any, limit: dict[str, Any], *, spp: int, seed: int) -> np.ndarray:
    """Mean over `spp` photon maps with one camera ray a pixel each, (1, H, W, 3) float64.

    Its expectation is exactly the limit's, whatever `spp`: of `passes` radii each has the same share of the maps, or
    the same chance to be among them.

    Raises
    ------
    ValueError
        The scope is not "all", the shadow rule is the paper's, or a mesh has interpolated normals.
    """
    kernel, description = limit["kernel"], loaded.description
    if limit["shadows"] != "physical":
        raise ValueError(f"shadows = {limit['shadows']!r} with a photon kernel: allowed is 'physical'")
    if limit["scope"] != "all":
        raise ValueError(f"scope = {limit['scope']!r} with a photon kernel: allowed is 'all'")
    for name, shape in description["scenes"]["direct"].items():
        if not isinstance(shape, bool | str) and not shape.get("face_normals", True):
            raise ValueError(f"{name} has interpolated normals: allowed with a photon kernel are flat ones")
    width, height = description["camera"]["resolution"]
    image = np.zeros((height * width, 3))
    if description["has_lights"]:
        surfaces = _surfaces(loaded.scenes["direct"])
        for number in range(spp):
            _add_map(loaded, surfaces, kernel, number, spp, seed, image)
    image = image.reshape(1, height, width, 3) / (np.pi * spp)
    if kernel["stored"] == "scattered" and description["has_lights"]:
        radiance = direct.reflected(loaded.scenes["direct"], direct.FIRST_HIT)
        image += pixel_means(
            lambda samples: (radiance(samples.ray, samples.sampler, True),),
            description["camera"],
            spp=spp * LIGHT_SAMPLES,
            seed=seed,
        )
    return image


def _add_map(
    loaded: Any,
    surfaces: Surfaces,
    kernel: dict[str, Any],
    number: int,
    maps: int,
    seed: int,
    image: np.ndarray,
) -> None:
    """Add `color (1 - g) E` by map `number` of `maps` to the pixels (H W, 3)."""
    by_radius = kernel["shape"] != "nearest"
    photons = trace(
        loaded.scenes["direct"],
        surfaces,
        count=PHOTONS if by_radius else kernel["photons"],
        first_hits=kernel["stored"] == "all",
        weighted=kernel["weighted"],
        seed=(seed + number) % 2**32,
    )
    radius = pass_radius(kernel, number, maps, seed) * loaded.description["scale"]
    pixel, albedo, points = _points(loaded, surfaces, number, maps, seed)
    for first in range(0, len(pixel), POINTS):
        some = slice(first, first + POINTS)
        here = Points(*(column[some] for column in points))
        if by_radius:
            irradiance = density.by_kernel(
                surfaces.faces, here, photons, shape=kernel["shape"], radius=radius
            )
        else:
            irradiance = density.by_nearest(
                surfaces.faces, here, photons, nearest=kernel["nearest"], scale=kernel["scale"]
            )
        image[pixel[some]] += albedo[some] * irradiance


def pass_radius(kernel: dict[str, Any], number: int, maps: int, seed: int) -> float:
    """Radius of map `number` of `maps`, in scene units: that of pass `floor((number + U) passes / maps)`, U uniform."""
    uniform = np.random.default_rng((seed, number)).random()
    i = np.arange(1, int((number + uniform) * kernel["passes"] / maps) + 1)
    return kernel["radius"] * float(np.sqrt(np.prod((i + 2 / 3) / (i + 1))))


def _surfaces(scene: Any) -> Surfaces:
    shapes = scene.shapes()
    vertices = [np.array(shape.vertex_positions_buffer(), np.float64).reshape(-1, 3) for shape in shapes]
    corners = [
        points[np.array(shape.faces_buffer()).reshape(-1, 3)]
        for points, shape in zip(vertices, shapes, strict=True)
    ]
    counts = [len(each) for each in corners]
    registered = np.array(dr.reinterpret_array(mi.UInt32, scene.shapes_dr()))
    first = np.zeros(registered.max() + 1, np.uint32)
    first[registered] = np.cumsum([0, *counts[:-1]])
    albedo = np.zeros((registered.max() + 1, 3))
    frontal = dr.zeros(mi.SurfaceInteraction3f)
    frontal.wi = mi.Vector3f(0.0, 0.0, 1.0)
    albedo[registered] = [
        np.array(shape.bsdf().eval_diffuse_reflectance(frontal)).ravel() for shape in shapes
    ]
    faces = density.faces(np.concatenate(corners), np.repeat(np.arange(len(shapes)), counts))
    return Surfaces(faces, mi.UInt32(first), mi.Color3f(albedo.T))


def _meets(surfaces: Surfaces, si: Any) -> tuple[Any, Any]:
    """Albedo at an intersection, black on a miss, and the number of its face."""
    shape = dr.reinterpret_array(mi.UInt32, si.shape)
    return dr.gather(mi.Color3f, surfaces.albedo, shape), dr.gather(
        mi.UInt32, surfaces.first, shape
    ) + si.prim_index


def _points(
    loaded: Any, surfaces: Surfaces, number: int, maps: int, seed: int
) -> tuple[np.ndarray, np.ndarray, Points]:
    """Pixels (N,) whose ray of a map meets what is not black, the albedo there (N, 3), and the points."""
    width, height = loaded.description["camera"]["resolution"]
    pixel = dr.arange(mi.UInt32, width * height)
    index, count, shift = (dr.opaque(mi.UInt32, value) for value in (number, maps, seed))
    ray = camera_samples(loaded.description["camera"], pixel, index, count, shift, None).ray
    si = loaded.scenes["direct"].ray_intersect(ray)
    albedo, face = _meets(surfaces, si)
    towards = dr.dot(si.n, ray.d)
    dr.eval(si.p, albedo, face, towards)
    color = np.array(albedo, np.float64).T
    seen = np.flatnonzero(color.any(axis=1))
    side = np.where(np.array(towards)[seen] <= 0.0, 1.0, -1.0)
    return seen, color[seen], Points(np.array(si.p, np.float64).T[seen], np.array(face, np.int64)[seen], side)


def trace(
    scene: Any, surfaces: Surfaces, *, count: int, first_hits: bool, weighted: bool, seed: int
) -> Photons:
    """Photons that land on what is not black, of `count` that the emitters send out; power is flux / count.

    Parameters
    ----------
    first_hits : whether photons that come straight from a light are kept.
    weighted : whether a survivor of the roulette is multiplied by albedo / P: light scattered with the albedo. Without,
        with the grey albedo P.
    seed : 32 bits; with the photon's number it names its random numbers.
    """
    state, sequence = mi.sample_tea_32(dr.arange(mi.UInt32, count), dr.opaque(mi.UInt32, seed))
    rng = mi.PCG32(size=count, initstate=state, initseq=sequence)
    ray, flux = _emit(scene, rng, count)
    landed = [Photons(*np.zeros((3, 0, 3)), np.zeros(0, np.int64))]
    kept = first_hits
    while dr.width(flux):
        si = scene.ray_intersect(ray)
        albedo, face = _meets(surfaces, si)
        survival = dr.minimum(dr.max(albedo), MAX_SURVIVAL)
        local = mi.warp.square_to_cosine_hemisphere(mi.Point2f(rng.next_float32(), rng.next_float32()))
        onward = si.spawn_ray(si.to_world(dr.mulsign(local, si.wi.z)))
        scattered = flux * albedo / survival if weighted else flux
        survives = rng.next_float32() < survival
        dr.eval(si.p, face, survival, onward, scattered, survives, rng)
        if kept:
            here = np.array(survival) > 0.0
            columns = (np.array(column, np.float64).T[here] for column in (si.p, -ray.d, flux))
            landed.append(Photons(*columns, np.array(face, np.int64)[here]))
        kept = True
        alive = dr.compress(survives)
        ray, flux, rng = (dr.gather(type(each), each, alive) for each in (onward, scattered, rng))
        dr.eval(ray, flux, rng)
    return Photons(*(np.concatenate(column) for column in zip(*landed, strict=True)))


def _emit(scene: Any, rng: Any, count: int) -> tuple[Any, Any]:
    """Ray and flux of each of `count` photons; emitters are chosen in proportion to the mean channel of their power."""
    middle = mi.Point2f(0.5, 0.5)
    # The weight of any ray is the whole power: every emitter is uniform over its surface and its directions.
    power = [np.mean(emitter.sample_ray(0.0, 0.5, middle, middle)[1]) for emitter in scene.emitters()]
    choice = mi.DiscreteDistribution(mi.Float(np.array(power, np.float32)))
    number, probability = choice.sample_pmf(rng.next_float32())
    position = mi.Point2f(rng.next_float32(), rng.next_float32())
    direction = mi.Point2f(rng.next_float32(), rng.next_float32())
    ray, flux = dr.zeros(mi.Ray3f, count), dr.zeros(mi.Color3f, count)
    # One by one: a call through pointers would compile every emitter that exists, skies written in Python too.
    for index, emitter in enumerate(scene.emitters()):
        chosen = number == index
        its_ray, its_power = emitter.sample_ray(0.0, 0.5, position, direction)
        ray = dr.select(chosen, mi.Ray3f(its_ray), ray)
        flux = dr.select(chosen, its_power, flux)
    return ray, flux / (probability * dr.opaque(mi.Float, count))
