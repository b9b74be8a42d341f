"""Reference of a photon density estimate: `color (1 - g) / π · mean over maps of E(x)`, E by a kernel or the k nearest.

For `direct` x is what the camera sees; for `specular` and `transmission` it is a vertex of a chain, as in
`terms.specular`, whose sky and ambient light are added. Photons scatter on the diffuse part alone: what is transparent
is to them what its diffuse part is.

What the kernel does to E is part of what is meant, so the reference is the same estimate made by other means: photons
leave Mitsuba's emitters (`sample_ray`; those of a light that is the same all around, into a cone about all faces), fly
by its `ray_intersect`, and are gathered by scipy's k-d tree (see `density`). They are independent of each other, and
every map has its own.
Roulette survives with `P = min(0.99, largest channel of the albedo)`; a survivor is scattered with cosine density
about the normal n that is shaded, turned with the chance s that light crosses, times
`|wi·n| |wo·m| / (|wi·m| |wo·n|)` where that is not the face's own m: light and importance see different cosines (Veach
1997, equation 5.19). Where glass casts no shadow, what comes straight from a light lands on it and flies on besides, a
photon for each.
"""

# pyright: reportArgumentType=false, reportCallIssue=false
# Mitsuba's stubs do not know the types of the variant in use.

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from . import bsdf, density
from .density import Faces, Photons, Points
from .rays import LIFT, lifted
from .terms import direct, shadows, specular
from .wavefront import camera_samples, idle, pixel_means, rowwise, shape_pointer

MAX_SURVIVAL = 0.99
PHOTONS = 100_000  # that are traced for a map whose mean does not depend on their count
LIGHT_SAMPLES = 8  # a pixel and map, of the first hits that no photon stands for
CHAINS = 16  # a pixel and map: they share the map
POINTS = 2**14  # gathered together: bounds memory
# Numbers of the rays by which an emitter's power is read.
MIDDLE = np.full((1, 4), 0.5)
GRID = np.tile(np.stack(np.meshgrid(*2 * [(np.arange(64) + 0.5) / 64]), axis=-1).reshape(-1, 2), 2)
EVEN = 0.1  # length of the mean direction below which a light is one that goes all around
_CHAINED = "specular", "transmission"


class Emitter(NamedTuple):
    """One of Mitsuba's emitters.

    Attributes
    ----------
    plugin : mi.Emitter
    share : of the photons: the power's mean channel over that of all emitters.
    power : (1, 3), flux of the emitter; the rays of a spot light differ in what they carry, and this is their mean.
    origin : (1, 3), where a point light is.
    cone : of a point light that is the same all around, unit axis (3,) and cosine of the edge of a cone about all
        faces; None for other lights.
    """

    plugin: Any
    share: float
    power: np.ndarray
    origin: np.ndarray
    cone: tuple[np.ndarray, float] | None

    @property
    def aimed(self) -> float:
        """Share of its photons that are traced."""
        return 1.0 if self.cone is None else 0.5 * (1.0 - self.cone[1])


class Surfaces(NamedTuple):
    """The triangles of a Mitsuba scene in one list, at the canonical scale.

    Attributes
    ----------
    scene : mi.Scene
    first : (O,) number of each shape's first face.
    faces : the triangles.
    albedo : (F + 1, 3), `color (1 - g)` of each face, of an image the largest; the last, black, is that of a miss.
    crossing : (F + 1,), the share s of it that leaves on the other side.
    passing : (F + 1, 3), what is left behind the face of light that comes straight; 0 where it casts a shadow.
    survival : (F + 1,), `P = min(MAX_SURVIVAL, largest channel of the albedo)`.
    emitters : all of them.
    varies : whether any albedo is an image's.
    """

    scene: Any
    first: np.ndarray
    faces: Faces
    albedo: np.ndarray
    crossing: np.ndarray
    passing: np.ndarray
    survival: np.ndarray
    emitters: tuple[Emitter, ...]
    varies: bool


class Sights(NamedTuple):
    """Rays from where light is wanted: origins, directions and weights (N, 3), and the pixel (N,) of each."""

    origin: np.ndarray
    direction: np.ndarray
    weight: np.ndarray
    pixel: np.ndarray


def render(loaded: Any, limit: dict[str, Any], *, spp: int, seed: int) -> np.ndarray:
    """Mean over `spp` photon maps with one camera ray (or CHAINS chains) a pixel each, (1, H, W, 3) float64.

    Its expectation is the limit's exactly, whatever `spp`: the radii of the passes have equal shares of the maps, or
    equal chances to be among them.

    Raises
    ------
    ValueError : the term has no photons, the scope is not "all", rays or normals are not Mitsuba's.
    """
    kernel, description = limit["kernel"], loaded.description
    _check(description, limit)
    width, height = description["camera"]["resolution"]
    image = np.zeros((height * width, 3))
    if description["has_lights"]:
        told = (description[name] for name in ("parts", "varying", "lamp_means", "passing"))
        surfaces = surfaces_of(loaded.scenes["direct"], *told)
        dark = shadows.rule(loaded, limit, "direct")
        sights = _sights(loaded, limit, spp, seed)
        count = kernel["photons"]
        if kernel["shape"] != "nearest":
            count = round(PHOTONS / sum(each.share * each.aimed for each in surfaces.emitters))
        # Mitsuba's part of a map runs beside numpy's and scipy's of the one before.
        with ThreadPoolExecutor(1) as gatherer:
            gathered: list[Future[tuple[np.ndarray, np.ndarray]]] = []
            for number in range(spp):
                rng = np.random.default_rng((seed, number))
                radius = pass_radius(kernel, (number + rng.random()) / spp) * description["scale"]
                photons = trace(
                    surfaces, rng, count=count, first_hits=kernel["stored"] == "all", weighted=kernel["weighted"]
                )
                seen = sights(number)
                points, albedo = _hits(surfaces, seen.origin, seen.direction, dark)
                gathered.append(gatherer.submit(_gather, kernel, radius, surfaces, seen, points, albedo, photons))
                if len(gathered) == 2:
                    _add(image, gathered.pop(0))
            for each in gathered:
                _add(image, each)
    image = image.reshape(1, height, width, 3) * (description["irradiance_factor"] / (np.pi * spp))
    return image + _rest(loaded, limit, spp=spp, seed=seed)


def _check(description: dict[str, Any], limit: dict[str, Any]) -> None:
    if limit["term"] not in ("direct", *_CHAINED):
        raise ValueError(f"term = {limit['term']!r} with a photon kernel: allowed are direct, {', '.join(_CHAINED)}")
    wanted = {"ignore": "face", "normals": "viewer", "scope": "all"}
    for name, value in wanted.items():
        found = limit[name] if name in limit else description[name]
        if found != value:
            raise ValueError(f"{name} = {found!r} with a photon kernel: allowed is {value!r}")


def _rest(loaded: Any, limit: dict[str, Any], *, spp: int, seed: int) -> Any:
    """What no photon stands for: first hits that are not stored, the sky and ambient light of a chain."""
    if limit["term"] in _CHAINED:
        estimate, rays = specular.estimator(loaded, limit), CHAINS
    elif limit["kernel"]["stored"] == "scattered" and loaded.description["has_lights"]:
        straight = limit | {"scope": "first-hit"}
        estimate, rays = direct.estimator(loaded, straight), LIGHT_SAMPLES
    else:
        return 0.0
    count = spp * (rays if dr.is_jit_v(mi.Float) else 1)
    return pixel_means(estimate, loaded.description["camera"], spp=count, seed=seed)


def _sights(loaded: Any, limit: dict[str, Any], maps: int, seed: int) -> Callable[[int], Sights]:
    """Number of a map -> its rays; over the maps they are spread in the pixel."""
    camera = loaded.description["camera"]
    width, height = camera["resolution"]
    chained = limit["term"] in _CHAINED
    chains = CHAINS if chained else 1
    share = dr.opaque(mi.Float, 1.0 / chains)
    pixel = np.repeat(np.arange(width * height), chains)
    index = np.tile(np.arange(chains), width * height)
    count, shift = (dr.opaque(mi.UInt32, value) for value in (maps * chains, seed))
    follow = specular.segments(loaded, limit, specular.lobes(loaded, limit)) if chained else None

    def sights(number: int) -> Sights:
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed((seed + number) % 2**32, len(pixel))

        def ray(pixel: Any, index: Any) -> tuple[Any, ...]:
            samples = camera_samples(camera, pixel, index, count, shift, sampler)
            if follow is None:
                return samples.ray.o, samples.ray.d, mi.Color3f(1.0)
            _, segment, weight, active = follow(samples)
            return segment.o, segment.d, dr.select(active, weight * share, 0.0)

        origin, direction, weight = rowwise(ray, pixel, index + number * chains)
        useful = weight.any(axis=1)
        return Sights(origin[useful], direction[useful], weight[useful], pixel[useful])

    return sights


def _gather(
    kernel: dict[str, Any],
    radius: float,
    surfaces: Surfaces,
    seen: Sights,
    points: Points,
    albedo: np.ndarray,
    photons: Photons,
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (N,) and radiances (N, 3) times pi of the points that are lit."""
    lit = np.flatnonzero(surfaces.survival[points.face])
    radiance = np.empty((len(lit), 3))
    for start in range(0, len(lit), POINTS):
        block = lit[start : start + POINTS]
        here = Points(*(column[block] for column in points))
        irradiance = _irradiance(kernel, radius, surfaces.faces, here, photons)
        share = surfaces.crossing[here.face][:, None]
        if share.any():
            back = here._replace(side=-here.side, normal=-here.normal)
            behind = _irradiance(kernel, radius, surfaces.faces, back, photons)
            irradiance = (1.0 - share) * irradiance + share * behind
        radiance[start : start + POINTS] = seen.weight[block] * albedo[block] * irradiance
    return seen.pixel[lit], radiance


def _add(image: np.ndarray, gathered: Future[tuple[np.ndarray, np.ndarray]]) -> None:
    np.add.at(image, *gathered.result())


def pass_radius(kernel: dict[str, Any], fraction: float) -> float:
    """Radius of the pass that stands at a fraction in [0, 1) of all, in scene units."""
    i = np.arange(1, int(fraction * kernel["passes"]) + 1)
    return kernel["radius"] * float(np.sqrt(np.prod((i + 2 / 3) / (i + 1))))


def _irradiance(kernel: dict[str, Any], radius: float, faces: Faces, points: Points, photons: Photons) -> np.ndarray:
    if kernel["shape"] == "nearest":
        return density.by_nearest(points, photons, nearest=kernel["nearest"], scale=kernel["scale"])
    return density.by_kernel(faces, points, photons, shape=kernel["shape"], radius=radius)


def surfaces_of(
    scene: Any,
    parts: list[list[list[int]]],
    varying: Sequence[list[float] | None] = (),
    lamps: Sequence[list[float] | None] = (),
    passing: Sequence[list[float]] = (),
) -> Surfaces:
    """Read the triangles and their albedos back from a scene of diffuse meshes, and whose they are from its parts.

    `varying` : of each shape whose albedo is an image's the largest; None of others.
    `lamps` : of each shape whose radiance is an image's its mean; None of others.
    `passing` : of each shape what it leaves of the light on shadow rays; nothing where all occlude.
    """
    frontal = dr.zeros(mi.SurfaceInteraction3f)
    frontal.wi = mi.Vector3f(0.0, 0.0, 1.0)
    corners, albedo, crossing = [], [], []
    meshes = [shape for shape in scene.shapes() if shape.is_mesh()]
    for shape in meshes:
        vertices = np.array(shape.vertex_positions_buffer(), np.float64).reshape(-1, 3)
        corners.append(vertices[np.array(shape.faces_buffer(), np.int64).reshape(-1, 3)])
        albedo.append(np.array(shape.bsdf().eval_diffuse_reflectance(frontal), np.float64).reshape(3))
        crossing.append(bsdf.share_of(shape.bsdf()))
    albedo = [
        each if most is None else most for each, most in zip(albedo, varying or [None] * len(albedo), strict=True)
    ]
    counts = [len(each) for each in corners]
    owner = np.repeat(np.arange(len(counts)), counts)
    smooth = np.array([shape.has_vertex_normals() for shape in meshes])[owner]
    thing, _, first = density.origins(parts)
    faces = density.faces(np.concatenate(corners), thing, smooth)
    of_faces = np.array([*albedo, np.zeros(3)])[[*owner, -1]]
    survival = np.minimum(of_faces.max(axis=1), MAX_SURVIVAL)
    of_sides = np.array([*crossing, 0.0])[[*owner, -1]]
    left = np.array([*(passing[: len(counts)] or np.zeros((len(counts), 3))), np.zeros(3)])[[*owner, -1]]
    varies = any(most is not None for most in varying)
    return Surfaces(scene, first, faces, of_faces, of_sides, left, survival, emitters_of(scene, faces, lamps), varies)


def trace(surfaces: Surfaces, rng: np.random.Generator, *, count: int, first_hits: bool, weighted: bool) -> Photons:
    """Photons that land on an object that is not black, of `count` that the emitters send out; power is flux / count.

    Parameters
    ----------
    first_hits : whether photons that come straight from a light are kept.
    weighted : whether a survivor of the roulette is multiplied by albedo / P, so that the flux is that of the light;
        without, it is that of light scattered with the grey albedo P.
    """
    origin, direction, power = _emitted(surfaces.emitters, rng, count)
    landed = [Photons(*np.zeros((3, 0, 3)), np.zeros(0, np.int64))]
    straight = np.ones(len(origin), bool)
    while len(origin):
        hit, albedo = _hits(surfaces, origin, direction)
        survival = np.minimum(albedo.max(axis=1), MAX_SURVIVAL)
        # Most photons of a point light meet nothing: what follows is of the others alone.
        here = np.flatnonzero(surfaces.survival[hit.face])
        kept = here[first_hits | ~straight[here]]
        if len(kept):
            landed.append(Photons(hit.position[kept], -direction[kept], power[kept], hit.face[kept]))
        through = _flown_on(surfaces, hit, direction, power, straight)
        alive = here[rng.random(len(here)) < survival[here]]
        face = hit.face[alive]
        came, normal = -direction[alive], surfaces.faces.normals[face]
        shaded = hit.normal[alive]
        if surfaces.crossing.any():
            shaded = np.where(rng.random((len(face), 1)) < surfaces.crossing[face, None], -shaded, shaded)
        direction = _cosine_distributed(shaded, rng.random((len(face), 2)))
        # A direction about an interpolated normal may lead below the face.
        origin = hit.position[alive] + (LIFT * np.sign(_dot(direction, normal)))[:, None] * normal
        power = power[alive]
        if surfaces.faces.smooth.any():
            power = power * _adjoint(surfaces.faces.smooth[face], came, direction, hit.normal[alive], normal)
        if weighted:
            power = power * (albedo[alive] / survival[alive, None])
        straight = np.zeros(len(origin), bool)
        if len(through[0]):
            straight = np.concatenate([straight, np.ones(len(through[0]), bool)])
            origin, direction, power = map(np.concatenate, zip((origin, direction, power), through, strict=True))
    return Photons(*(np.concatenate(column) for column in zip(*landed, strict=True)))


def _flown_on(
    surfaces: Surfaces, hit: Points, direction: np.ndarray, power: np.ndarray, straight: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Origins, directions and powers (M, 3) of what flies on, of light that came straight to glass without a shadow."""
    flies = np.flatnonzero(straight & surfaces.passing[hit.face].any(axis=1))
    face, way = hit.face[flies], direction[flies]
    normal = surfaces.faces.normals[face]
    origin = hit.position[flies] + (LIFT * np.sign(_dot(way, normal)))[:, None] * normal
    return origin, way, power[flies] * surfaces.passing[face]


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("nx,nx->n", a, b)


def _adjoint(
    smooth: np.ndarray, came: np.ndarray, leaves: np.ndarray, normal: np.ndarray, geometric: np.ndarray
) -> np.ndarray:
    """Factor (N, 1) on the flux of a photon that is scattered about a normal which is not its face's."""
    seen = np.abs(_dot(came, normal) * _dot(leaves, geometric))
    lit = np.abs(_dot(came, geometric) * _dot(leaves, normal))
    return np.where(smooth, np.divide(seen, lit, out=np.zeros_like(seen), where=lit > 0.0), 1.0)[:, None]


def _cosine_distributed(normal: np.ndarray, uniform: np.ndarray) -> np.ndarray:
    """Unit directions (N, 3) of density cosine / π about the normals, from `uniform` (N, 2)."""
    z, azimuth = 1.0 - 2.0 * uniform[:, 0], 2.0 * np.pi * uniform[:, 1]
    ring = np.sqrt(1.0 - z * z)
    # The normal plus a point of the unit sphere: the chord from a pole to uniform area has cosine density.
    chord = normal + np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z], axis=1)
    length = np.linalg.norm(chord, axis=1, keepdims=True)
    return np.where(length > 0.0, chord / np.where(length > 0.0, length, 1.0), normal)


def emitters_of(scene: Any, faces: Faces, lamps: Sequence[list[float] | None] = ()) -> tuple[Emitter, ...]:
    """Read the emitters of a scene, `lamps` as in `surfaces_of`."""
    found = []
    meshes = [shape for shape in scene.shapes() if shape.is_mesh()]
    for emitter in scene.emitters():
        point = mi.has_flag(emitter.flags(), mi.EmitterFlags.DeltaPosition)
        origin, direction, power = _rays(emitter, GRID if point else MIDDLE)
        # A spot light is a point too, but its rays go one way.
        even = point and np.linalg.norm(direction.mean(axis=0)) < EVEN
        if even:
            power = power[:1]
        cone = _cone(faces, origin[:1]) if even else None
        for shape, mean in zip(meshes, lamps, strict=False):
            if mean is not None and shape.emitter() is emitter:  # its rays differ, and that of its middle may be dark
                power = np.pi * np.array(shape.surface_area()).item() * np.array([mean])
        found.append(Emitter(emitter, power.mean(), power.mean(axis=0, keepdims=True), origin[:1], cone))
    total = sum(each.share for each in found)
    return tuple(each._replace(share=each.share / total) for each in found)


def _rays(emitter: Any, uniform: np.ndarray) -> list[np.ndarray]:
    """Origins, directions and weights (N, 3) of an emitter's rays by numbers (N, 4)."""
    on_surface = mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface)

    def sample(position: Any, direction: Any) -> tuple[Any, ...]:
        ray, power = emitter.sample_ray(0.0, 0.5, position, direction)
        if not on_surface:
            return ray.o, ray.d, power
        # Mitsuba's rays start further off the face than a cover may be away: the same point, lifted by less.
        on_face, _ = emitter.sample_position(0.0, position)
        return lifted(on_face.p, on_face.n, ray.d), ray.d, power

    return rowwise(sample, uniform[:, :2], uniform[:, 2:])


def _cone(faces: Faces, light: np.ndarray) -> tuple[np.ndarray, float]:
    """Axis and cosine of the edge of a cone from a light (1, 3) about all faces; all directions if it is not convex."""
    ways = faces.corners.reshape(-1, 3) - light
    distance = np.linalg.norm(ways, axis=1, keepdims=True)
    if distance.all():
        ways /= distance
        axis = ways.min(axis=0) + ways.max(axis=0)
        axis /= np.linalg.norm(axis) or 1.0
        edge = (ways @ axis).min()
        if edge > 0.0:
            return axis, edge
    return np.array([0.0, 0.0, 1.0]), -1.0


def _emitted(emitters: Sequence[Emitter], rng: np.random.Generator, count: int) -> tuple[np.ndarray, ...]:
    """Origin, direction and power (N, 3) of photons; emitters are chosen by the mean channel of their power.

    Of the `count` photons those of a point light that pass by all faces are left out, as many as chance has it.
    """
    rays = []
    for emitter, number in zip(emitters, rng.multinomial(count, [e.share for e in emitters]), strict=True):
        if emitter.cone is not None:
            direction = _uniform_cone(*emitter.cone, rng, rng.binomial(number, emitter.aimed))
            origin, power = (np.broadcast_to(row, direction.shape) for row in (emitter.origin, emitter.power))
        elif number:
            origin, direction, power = _rays(emitter.plugin, rng.random((number, 4)))
            lit = power.any(axis=1)  # of a lamp under an image some are not, and are no photons
            origin, direction, power = origin[lit], direction[lit], power[lit]
        else:
            continue
        rays.append((origin, direction, power / (count * emitter.share)))
    return tuple(np.concatenate(column) for column in zip(*rays, strict=True))


def _uniform_cone(axis: np.ndarray, edge: float, rng: np.random.Generator, count: int) -> np.ndarray:
    """Directions (count, 3) uniform in a cone."""
    z, azimuth = rng.uniform(edge, 1.0, count), rng.uniform(0.0, 2.0 * np.pi, count)
    ring = np.sqrt(1.0 - z * z)
    frame = np.linalg.svd(axis[None])[2]  # an orthonormal basis, its first vector the axis up to its sign
    frame = np.stack([frame[1], frame[2], axis])
    return np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z], axis=1) @ frame


def _hits(surfaces: Surfaces, origin: np.ndarray, direction: np.ndarray, dark: Any = None) -> tuple[Points, np.ndarray]:
    """Where rays (N, 3) meet a surface, seen from their origin, and its albedo (N, 3) there.

    The face is -1 on a miss, a sphere, and where it is `dark`.
    """
    meshes = [shape for shape in surfaces.scene.shapes() if shape.is_mesh()]
    shapes = [(shape_pointer(shape), int(first)) for shape, first in zip(meshes, surfaces.first, strict=True)]

    def intersect(origin: Any, direction: Any) -> tuple[Any, ...]:
        si = surfaces.scene.ray_intersect(mi.Ray3f(origin, mi.Vector3f(direction)))
        face = mi.Int32(-1)
        for shape, first in shapes:
            face = dr.select(si.shape == shape, mi.Int32(si.prim_index) + first, face)
        if dark is not None:
            face = dr.select(dark(si, si.is_valid()), -1, face)
        if not surfaces.varies:
            return si.p, face, si.sh_frame.n
        if idle(si.is_valid()):
            return si.p, face, si.sh_frame.n, mi.Color3f(0.0)
        return si.p, face, si.sh_frame.n, si.bsdf().eval_diffuse_reflectance(si, si.is_valid())

    position, number, shading, *varying = rowwise(intersect, origin, direction)
    face = number.astype(np.int64)
    albedo = varying[0] if varying else surfaces.albedo[face]
    normal = np.where(surfaces.faces.smooth[face, None], shading, surfaces.faces.normals[face])
    normal = np.where(_dot(direction, normal)[:, None] <= 0.0, normal, -normal)
    side = np.where(_dot(direction, surfaces.faces.normals[face]) <= 0.0, 1.0, -1.0)
    return Points(position, face, side, normal), albedo
