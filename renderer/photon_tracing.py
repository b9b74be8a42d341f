"""Photon tracing: flux from the lights, deposited where it lands, `Phi_{j+1} = Phi_j f cos(theta) / (p P)`.

A photon starts with what its light sends (`4 pi I` of a point, `pi A L` of a face, see `renderer.lights`) over the
probability of the pick and goes on by Russian roulette of probability P. Diffuse scattering has the weight
`f cos(theta) / p = albedo = color (1 - gloss) (1 - t)`, and leaves a translucent surface on either side; with full
scattering the specular lobes are picked besides, in proportion to the larger of gloss and transparency, and sampled by
visible normals. A photon is flux, and keeps all of it where it is refracted, as radiance does not.

Weighted photons carry the mean flux of light transport for any P. Unweighted ones keep the flux that they had, which
scatters light with the grey albedo P: `rho / (1 - rho)` becomes `P / (1 - P)` (paper).
Jensen, "Global Illumination using Photon Maps", EGWR 1996; Arvo, Kirk, "Particle Transport and Image Synthesis",
SIGGRAPH 1990.
"""

import math
from collections.abc import Callable
from concurrent.futures import Executor
from typing import NamedTuple

import numpy as np

from termwise.renderer.arrays import MAX_SURVIVAL, SceneArrays
from termwise.renderer.dielectric import EITHER, sample_interface
from termwise.renderer.geometry.wave import SIZE
from termwise.renderer.jit import device, kernel
from termwise.renderer.lights import emit_photon
from termwise.renderer.material import (
    Dielectrics,
    diffuse_weight,
    holds_photons,
    interface,
    lobe_alpha,
    lobe_f0,
    scattered,
    specular_weight,
)
from termwise.renderer.microfacet import sample_lobe
from termwise.renderer.photon_map import PhotonMap, build, empty
from termwise.renderer.rng import fold, stream
from termwise.renderer.scratch import PHOTONS, Scratch
from termwise.renderer.sobol import Sampler, draw_2d, sample_1d
from termwise.renderer.surface import Surface, put_leaving_ray, surface_of, trace_wave
from termwise.renderer.vector import (
    Vec3,
    dot,
    entry,
    frame,
    is_black,
    max_component,
    mul,
    negate,
    put,
    put_column,
    scale,
    to_local,
    to_world,
    vec3,
)

_CHUNK = 4096
# Photons that are followed together: waves stay full until few are left, and all lie in the second cache.
_FLIGHT = 8 * SIZE
_STREAM = 1 << 40  # beyond any pixel index: photons never share a key with a pixel
_VERTEX = 16  # keys of a photon's vertices: beyond the pairs of its emission
_PHOTON = 1 << 32  # keys of photons that have a sequence each: beyond those of the vertices
_PLACE, _WAY = 1, 2
_ROULETTE, _DIRECTION, _LOBE, _CHOICE, _PASSES = 0, 1, 2, 3, 4


class Scattering(NamedTuple):
    """How photons go on.

    Attributes
    ----------
    survival : P, at most `most` of it; 0: the largest channel of what the photon would carry on.
    weighted : whether survivors are multiplied by weight / P.
    full : whether they scatter on the specular lobe too, and go through what is transparent.
    independent : whether each photon has randomness of its own. Else all photons of a map share one low-discrepancy
        sequence: less noise in a sum over them, but they land too evenly for a search of the k nearest, whose k-th
        photon then stands too far (k = 50 of 16384 under a point light: E comes out 1.004 and not k / (k - 1) = 1.020
        times too bright).
    aimed : whether point lights emit into the cone around the scene alone, fewer photons of the same flux: those that
        are left out meet nothing. Not for a search of the k nearest, whose mean depends on how many are emitted.
    most : see `arrays.most_survival`; MAX_SURVIVAL where survivors are not weighted, for there P is what is meant.
    """

    survival: float
    weighted: bool
    full: bool
    independent: bool
    aimed: bool
    most: float = MAX_SURVIVAL


@device
def _sampler(rule: Scattering, key: np.uint64, index: int) -> Sampler:
    """Randomness of a photon: its place in the sequence of all photons, or a sequence of its own."""
    if rule.independent:
        return Sampler(fold(key, _PHOTON + index), np.uint32(0))
    return Sampler(key, np.uint32(index))


@device
def _shading_ratio(scene: SceneArrays, surface: Surface, wi: Vec3, wo: Vec3) -> float:
    """Correction of a scattered photon for shading normals: light and importance see different cosines.

    Veach, "Robust Monte Carlo Methods for Light Transport Simulation", 1997, equation 5.19.
    """
    if not scene.geometry.smooth[surface.face]:
        return 1.0
    geometric = vec3(scene.geometry.normals, surface.face)
    down = abs(dot(wi, geometric)) * abs(dot(wo, surface.normal))
    return abs(dot(wi, surface.normal)) * abs(dot(wo, geometric)) / down if down > 0.0 else 0.0


@device
def _lobes(dielectrics: Dielectrics | None, gloss: float, surface: Surface) -> float:
    """The most of a photon's flux that the lobes of a surface send on."""
    if dielectrics is not None and dielectrics.here[surface.object]:
        return max(gloss, max_component(vec3(dielectrics.transmission, surface.object)))
    return gloss


@device
def _sample_lobes(
    scene: SceneArrays,
    dielectrics: Dielectrics | None,
    gloss: float,
    surface: Surface,
    wo: Vec3,
    share: float,
    sampler: Sampler,
    u: float,
    v: float,
) -> tuple[Vec3, Vec3]:
    """Direction by the lobes of a surface, picked with probability `share`, and its weight."""
    if dielectrics is not None and dielectrics.here[surface.object]:
        lobes = interface(scene, dielectrics, gloss, surface)
        wi, weight, spread = sample_interface(EITHER, lobes, wo, u, v, sample_1d(sampler, _CHOICE))
        return wi, scale(weight, 1.0 / (share * spread))
    # The BRDF is reciprocal: the photon's w_i is sampled as a view's would be.
    wi, weight = sample_lobe(wo, lobe_alpha(scene, surface), lobe_f0(scene, surface), u, v)
    return wi, scale(weight, gloss / share)


@device
def _scatter(
    scene: SceneArrays, rule: Scattering, surface: Surface, sampler: Sampler, u: float, v: float, roulette: float
) -> tuple[Vec3, Vec3]:
    """Direction by (u, v) of a photon that goes on, and the factor on its flux, black where it is absorbed."""
    black = Vec3(0.0, 0.0, 0.0)
    weight = diffuse_weight(scene, surface)
    diffuse = max_component(weight)
    gloss = specular_weight(scene, surface) if rule.full else 0.0
    lobes = _lobes(scene.materials.dielectrics, gloss, surface) if rule.full else 0.0
    if diffuse + lobes == 0.0:
        return black, black
    share = diffuse / (diffuse + lobes)
    local = frame(surface.normal)
    if lobes == 0.0 or sample_1d(sampler, _LOBE) < share:
        weight = scale(weight, 1.0 / share)
        survival = _survival(rule, weight)
        if roulette >= survival:
            return black, black
        wi = scattered(scene.materials.translucency, surface, u, v)
    else:
        wo = to_local(local, surface.wo)
        wi, weight = _sample_lobes(scene, scene.materials.dielectrics, gloss, surface, wo, 1.0 - share, sampler, u, v)
        survival = _survival(rule, weight)
        if roulette >= survival:
            return black, black
    heading = to_world(local, wi)
    factor = scale(weight, 1.0 / survival) if rule.weighted else Vec3(1.0, 1.0, 1.0)
    return heading, scale(factor, _shading_ratio(scene, surface, surface.wo, heading))


@device
def _survival(rule: Scattering, weight: Vec3) -> float:
    """Probability that a photon goes on that would carry so much of its flux."""
    return min(rule.most, rule.survival if rule.survival > 0.0 else max_component(weight))


@device
def _pass(
    scene: SceneArrays, passing: np.ndarray | None, straight: bool, surface: Surface, sampler: Sampler
) -> tuple[bool, Vec3]:
    """Whether a photon that comes straight from its light flies on through a surface, and the factor on its flux.

    It is the light of shadow rays, which goes through what does not occlude, and is scattered there besides: one of the
    two by chance.
    """
    if passing is not None and straight:
        left = vec3(passing, surface.object)
        share = max_component(left)
        if share > 0.0:
            share /= share + max_component(diffuse_weight(scene, surface))
            if sample_1d(sampler, _PASSES) < share:
                return True, scale(left, 1.0 / share)
            chance = 1.0 / (1.0 - share)
            return False, Vec3(chance, chance, chance)
    return False, Vec3(1.0, 1.0, 1.0)


class _Flight(NamedTuple):
    """Photons that are followed together, bounce by bounce, those that still fly first.

    Attributes
    ----------
    index : (_FLIGHT,) int64, the number of each.
    origin, heading, flux : (_FLIGHT, 3) each.
    face : (_FLIGHT,) int32, the face that it leaves, -1: none.
    straight : (_FLIGHT,) bool, whether it comes straight from its light.
    """

    index: np.ndarray
    origin: np.ndarray
    heading: np.ndarray
    flux: np.ndarray
    face: np.ndarray
    straight: np.ndarray


@device
def _put_photon(
    flight: _Flight, i: int, index: int, origin: Vec3, heading: Vec3, flux: Vec3, face: int, straight: bool
) -> None:
    flight.index[i] = index
    put(flight.origin, i, origin)
    put(flight.heading, i, heading)
    put(flight.flux, i, flux)
    flight.face[i] = face
    flight.straight[i] = straight


@device
def _put_sampler(k: int, sampler: Sampler, scratch: Scratch) -> None:
    scratch.key[k] = sampler.key
    scratch.sample[k] = sampler.index


@device
def _depart(
    scene: SceneArrays, rule: Scattering, key: np.uint64, first: int, last: int, flight: _Flight, scratch: Scratch
) -> int:
    """Emit photons [first, last); how many carry anything."""
    place, way = scratch.samples, scratch
    flying = 0
    for begin in range(first, last, SIZE):
        count = min(SIZE, last - begin)
        for k in range(count):
            _put_sampler(k, _sampler(rule, key, begin + k), scratch)
        draw_2d(scratch.key, scratch.sample, count, _PLACE, place.u, place.v, scratch.words)
        draw_2d(scratch.key, scratch.sample, count, _WAY, way.u, way.v, scratch.words)
        for k in range(count):
            origin, heading, flux, face = emit_photon(scene, rule.aimed, (place.u[k], place.v[k]), (way.u[k], way.v[k]))
            if not is_black(flux):
                _put_photon(flight, flying, begin + k, origin, heading, flux, face, True)
                flying += 1
    return flying


@device
def _fly(scene: SceneArrays, flight: _Flight, begin: int, count: int, scratch: Scratch) -> None:
    """Find what `count` photons meet next."""
    for k in range(count):
        put_leaving_ray(scene, scratch.rays, k, vec3(flight.origin, begin + k), entry(flight.face, begin + k))
        put_column(scratch.rays.directions, k, vec3(flight.heading, begin + k))
    trace_wave(scene, scratch.rays, count, False, scratch)


@kernel
def _trace_photons(
    scene: SceneArrays,
    rule: Scattering,
    first_hits: bool,
    key: np.uint64,
    first: int,
    last: int,
    position: np.ndarray,
    direction: np.ndarray,
    power: np.ndarray,
    face: np.ndarray,
    scratch: Scratch,
) -> int:
    """Trace photons [first, last); returns how many land, also where the arrays are too short to hold all.

    A photon is deposited wherever the object has a diffuse weight, however it came there.
    """
    landed = 0
    roulette = scratch.samples
    scratch.counts[PHOTONS] += last - first
    flight = _Flight(
        np.empty(_FLIGHT, np.int64),
        np.empty((_FLIGHT, 3)),
        np.empty((_FLIGHT, 3)),
        np.empty((_FLIGHT, 3)),
        np.empty(_FLIGHT, np.int32),
        np.empty(_FLIGHT, np.bool_),
    )
    for start in range(first, last, _FLIGHT):
        flying = _depart(scene, rule, key, start, min(start + _FLIGHT, last), flight, scratch)
        vertex = _VERTEX
        while flying > 0:
            vertex += 1
            kept = 0
            for begin in range(0, flying, SIZE):
                count = min(SIZE, flying - begin)
                _fly(scene, flight, begin, count, scratch)
                for k in range(count):
                    _put_sampler(k, _sampler(rule, fold(key, vertex), flight.index[begin + k]), scratch)
                draw_2d(scratch.key, scratch.sample, count, _ROULETTE, roulette.u, roulette.v, scratch.words)
                draw_2d(scratch.key, scratch.sample, count, _DIRECTION, scratch.u, scratch.v, scratch.words)
                for k in range(count):
                    surface = surface_of(scene, scratch.rays, k)
                    if surface.face < 0:
                        continue
                    straight, flux = flight.straight[begin + k], vec3(flight.flux, begin + k)
                    if (not straight or first_hits) and holds_photons(scene, surface):
                        if landed < len(face):
                            put(position, landed, surface.point)
                            put(direction, landed, surface.wo)
                            put(power, landed, flux)
                            face[landed] = surface.face
                        landed += 1
                    branch = Sampler(scratch.key[k], scratch.sample[k])
                    straight, factor = _pass(scene, scene.materials.passing, straight, surface, branch)
                    flux = mul(flux, factor)
                    heading = negate(surface.wo)
                    if not straight:
                        heading, factor = _scatter(
                            scene, rule, surface, branch, scratch.u[k], scratch.v[k], roulette.u[k]
                        )
                        flux = mul(flux, factor)
                    if not is_black(flux):
                        # None is overwritten before it was read: no more fly on than have come.
                        index = flight.index[begin + k]
                        _put_photon(flight, kept, index, surface.point, heading, flux, surface.face, straight)
                        kept += 1
            flying = kept
    return landed


def emit(
    scene: SceneArrays,
    key: np.uint64,
    index: int,
    *,
    count: int,
    radius: float,
    shape: str,
    rule: Scattering,
    first_hits: bool,
    pool: Executor,
    scratch: Callable[[], Scratch],
) -> PhotonMap:
    """Trace pass `index` of a replicate and build its map.

    Parameters
    ----------
    key : the replicate's root key.
    count : photons emitted; fewer where they are aimed.
    radius, shape : of the kernel of this pass, see `photon_map.build`.
    rule : how photons go on.
    first_hits : whether photons that come straight from a light are stored.
    pool : the chunks run here; their order, hence the map, does not depend on the number of threads.
    scratch : gives the calling thread its memory.
    """
    if len(scene.emitters.kind) == 0:
        return empty(radius)
    emitted = max(1, math.ceil(count * scene.emitters.share)) if rule.aimed else count
    photons_key = stream(stream(key, _STREAM), index)

    def chunk(first: int) -> tuple[np.ndarray, ...]:
        last = min(first + _CHUNK, emitted)
        capacity = 4 * (last - first)
        while True:
            position, direction, power = np.empty((3, capacity, 3))
            face = np.empty(capacity, np.int32)
            landed = _trace_photons(
                scene, rule, first_hits, photons_key, first, last, position, direction, power, face, scratch()
            )
            if landed <= capacity:
                return position[:landed], direction[:landed], power[:landed], face[:landed]
            capacity = landed

    chunks = list(pool.map(chunk, range(0, emitted, _CHUNK)))
    position, direction, power, face = (np.concatenate(parts) for parts in zip(*chunks, strict=True))
    power /= emitted
    return build(position, direction, power, face, radius, shape, pool)
