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
from termwise.renderer.geometry.intersect import make_ray
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
from termwise.renderer.sobol import Sampler, sample_1d, sample_2d
from termwise.renderer.surface import Surface, trace
from termwise.renderer.vector import Vec3, dot, frame, is_black, max_component, mul, scale, to_local, to_world, vec3

_CHUNK = 4096
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
def _scatter(scene: SceneArrays, rule: Scattering, surface: Surface, sampler: Sampler) -> tuple[Vec3, Vec3]:
    """Direction of a photon that goes on and the factor on its flux; a black factor where it is absorbed."""
    black = Vec3(0.0, 0.0, 0.0)
    weight = diffuse_weight(scene, surface)
    diffuse = max_component(weight)
    gloss = specular_weight(scene, surface) if rule.full else 0.0
    lobes = _lobes(scene.materials.dielectrics, gloss, surface) if rule.full else 0.0
    if diffuse + lobes == 0.0:
        return black, black
    share = diffuse / (diffuse + lobes)
    local = frame(surface.normal)
    u, v = sample_2d(sampler, _DIRECTION)
    if lobes == 0.0 or sample_1d(sampler, _LOBE) < share:
        weight = scale(weight, 1.0 / share)
        wi = scattered(scene.materials.translucency, surface, u, v)
    else:
        wo = to_local(local, surface.wo)
        wi, weight = _sample_lobes(scene, scene.materials.dielectrics, gloss, surface, wo, 1.0 - share, sampler, u, v)
    survival = min(rule.most, rule.survival if rule.survival > 0.0 else max_component(weight))
    if sample_1d(sampler, _ROULETTE) >= survival:
        return black, black
    heading = to_world(local, wi)
    factor = scale(weight, 1.0 / survival) if rule.weighted else Vec3(1.0, 1.0, 1.0)
    return heading, scale(factor, _shading_ratio(scene, surface, surface.wo, heading))


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
    scratch.counts[PHOTONS] += last - first
    for index in range(first, last):
        emission = _sampler(rule, key, index)
        place, way = sample_2d(emission, _PLACE), sample_2d(emission, _WAY)
        origin, heading, flux, origin_face = emit_photon(scene, rule.aimed, place, way)
        depth = 0
        straight = True
        while not is_black(flux):
            surface = trace(scene, make_ray(origin, heading), origin_face, scratch)
            if surface.face < 0:
                break
            if (not straight or first_hits) and holds_photons(scene, surface):
                if landed < len(face):
                    position[landed, 0] = surface.point.x
                    position[landed, 1] = surface.point.y
                    position[landed, 2] = surface.point.z
                    direction[landed, 0] = surface.wo.x
                    direction[landed, 1] = surface.wo.y
                    direction[landed, 2] = surface.wo.z
                    power[landed, 0] = flux.x
                    power[landed, 1] = flux.y
                    power[landed, 2] = flux.z
                    face[landed] = surface.face
                landed += 1
            depth += 1
            branch = _sampler(rule, fold(key, _VERTEX + depth), index)
            straight, factor = _pass(scene, scene.materials.passing, straight, surface, branch)
            flux = mul(flux, factor)
            if not straight:
                heading, factor = _scatter(scene, rule, surface, branch)
                flux = mul(flux, factor)
            origin = surface.point
            origin_face = surface.face
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
