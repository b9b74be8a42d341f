"""Direct: `L_direct = color (1 - gloss) E / pi`, with E of the first hit or of all bounces (`scope`).

Photons after roulette estimate the total irradiance `E_all`: light that arrives straight and light that was scattered,
diffusely with albedo color (1 - gloss), any number of times. `first-hit` means the straight part alone.

Where a surface is translucent E is `(1 - s) E(n) + s E(-n)`: light is sampled on both sides, photons are gathered on
both, and a path goes on to one of them, with its share.
"""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np

from termwise.renderer.arrays import FAINT, SceneArrays, ShadowRule
from termwise.renderer.film import Work, accumulate, accumulate_hits, next_hits, no_hits
from termwise.renderer.geometry import simd
from termwise.renderer.geometry.intersect import make_ray
from termwise.renderer.geometry.simd import (
    bits,
    choose,
    compress,
    copy,
    count_bits,
    in_lanes,
    load,
    lowest_bit,
    numbers,
    put_rows,
    rows,
    splat,
    store,
)
from termwise.renderer.geometry.wave import SIZE, Wave
from termwise.renderer.jit import device, kernel
from termwise.renderer.light_sampling import sample_lights
from termwise.renderer.lights import sample_light
from termwise.renderer.material import diffuse_weight, scattered
from termwise.renderer.photon_density import estimate_irradiance
from termwise.renderer.photon_map import PhotonMap
from termwise.renderer.photon_search import nearest_irradiance
from termwise.renderer.rng import fold
from termwise.renderer.scratch import DENSITY_ESTIMATES, LightSamples, Scratch
from termwise.renderer.sobol import Sampler, draw_2d, sample_1d, sample_2d
from termwise.renderer.surface import (
    Surface,
    arriving,
    arriving_hidden,
    occlude_wave,
    put_all_leaving,
    put_leaving,
    put_leaving_ray,
    put_surfaces,
    shadowed,
    surface_at,
    surface_of,
    trace,
    trace_wave,
    turned,
)
from termwise.renderer.terms.estimator import Compiled
from termwise.renderer.terms.variant import Variant
from termwise.renderer.textures import Textures
from termwise.renderer.vector import (
    Vec3,
    add,
    column,
    entry,
    frame,
    is_black,
    mad,
    max_component,
    mul,
    negate,
    put,
    put_column,
    scale,
    to_world,
    vec3,
)
from termwise.renderer.warp import INV_PI
from termwise.scenes import limits
from termwise.scenes.limits import Kernel, Limit
from termwise.scenes.model import Scene

_VECTORS = simd.available()

LIGHT = 2  # the pair that places a sample on a light
BOUNCE = 4  # the direction of the next vertex of a path
ROULETTE = 5
_PATH = 64  # keys of a path's vertices: beyond the pairs above


@device
def light_irradiance(scene: SceneArrays, surface: Surface, sampler: Sampler, dimension: int, scratch: Scratch) -> Vec3:
    """E / pi of both sides of a surface, one sample; uses the pair `dimension`."""
    u, v = sample_2d(sampler, dimension)
    return _light_of_both(scene, scene.materials.translucency, surface, u, v, scratch)


@device
def _of_both(front: Vec3, back: Vec3, share: float) -> Vec3:
    """What a side receives, and the other one, which has a share of it."""
    return mad(back, share, scale(front, 1.0 - share))


@device
def _light_of_both(
    scene: SceneArrays, translucency: np.ndarray | None, surface: Surface, u: float, v: float, scratch: Scratch
) -> Vec3:
    front = _light_of_side(scene, surface, u, v, scratch)
    if translucency is not None and translucency[surface.object] > 0.0:
        back = _light_of_side(scene, turned(surface), u, v, scratch)
        return _of_both(front, back, translucency[surface.object])
    return front


@device
def _light_of_side(scene: SceneArrays, surface: Surface, u: float, v: float, scratch: Scratch) -> Vec3:
    irradiance, direction, target = sample_light(scene, surface, u, v)
    if scene.skips.horizon and is_black(irradiance):
        return irradiance
    return arriving(scene, irradiance, surface, direction, 1.0, target, scratch)


@device
def gain(throughput: Vec3, irradiance: Vec3) -> Vec3:
    """What a vertex adds to its path by the light that arrives there."""
    return mul(throughput, irradiance)


@device
def survives(survival: float, u: float) -> bool:
    """Whether a path goes on."""
    return u < survival


@device
def direct_next_event(
    scene: SceneArrays, photons: PhotonMap, surface: Surface, sampler: Sampler, scratch: Scratch
) -> Vec3:
    """Light sampling for the first hit, the photon map (without first hits) for the rest.

    With an empty map: E of the first hit, unbiased.
    """
    weight = diffuse_weight(scene, surface)
    if scene.skips.diffuse and is_black(weight):
        return weight
    straight = light_irradiance(scene, surface, sampler, LIGHT, scratch)
    return _reflected(scene, weight, straight, density_irradiance(scene, photons, surface, scratch))


@device
def density_irradiance(scene: SceneArrays, photons: PhotonMap, surface: Surface, scratch: Scratch) -> Vec3:
    """E of both sides of a surface by the kernel of a photon map."""
    return _density(scene, scene.materials.translucency, photons, surface, scratch)


@device
def _density(
    scene: SceneArrays, translucency: np.ndarray | None, photons: PhotonMap, surface: Surface, scratch: Scratch
) -> Vec3:
    front = estimate_irradiance(scene, photons, surface, scratch)
    if translucency is not None and translucency[surface.object] > 0.0:
        back = estimate_irradiance(scene, photons, turned(surface), scratch)
        return _of_both(front, back, translucency[surface.object])
    return front


@device
def _by_nearest_of_both(
    scene: SceneArrays,
    translucency: np.ndarray | None,
    photons: PhotonMap,
    surface: Surface,
    heap: np.ndarray,
    chosen: np.ndarray,
    scratch: Scratch,
) -> Vec3:
    """E of both sides of a surface, of each by its k nearest photons."""
    scratch.counts[DENSITY_ESTIMATES] += 1
    front = nearest_irradiance(photons, surface, len(heap), heap, chosen)
    if translucency is not None and translucency[surface.object] > 0.0:
        scratch.counts[DENSITY_ESTIMATES] += 1
        back = nearest_irradiance(photons, turned(surface), len(heap), heap, chosen)
        return _of_both(front, back, translucency[surface.object])
    return front


@device
def _reflected(scene: SceneArrays, weight: Vec3, straight: Vec3, scattered: Vec3) -> Vec3:
    """Radiance by E / pi that arrives straight, and by E that was scattered, of a diffuse lobe's weight."""
    return scale(mul(weight, mad(scattered, INV_PI, straight)), scene.irradiance_factor)


@device
def direct_path(scene: SceneArrays, surface: Surface, sampler: Sampler, scratch: Scratch) -> Vec3:
    """E_all by a diffusely scattered path with light sampling at every vertex. Unbiased at any N.

    A path of throughput t goes on with probability t / FAINT, at most `most_survival`, and is divided by it.
    """
    weight = diffuse_weight(scene, surface)
    if scene.skips.diffuse and is_black(weight):
        return weight
    throughput = Vec3(1.0, 1.0, 1.0)
    radiance = Vec3(0.0, 0.0, 0.0)
    vertex = 0
    while True:
        radiance = add(radiance, gain(throughput, light_irradiance(scene, surface, sampler, LIGHT, scratch)))
        u, v = sample_2d(sampler, BOUNCE)
        direction = to_world(frame(surface.normal), scattered(scene.materials.translucency, surface, u, v))
        surface = trace(scene, make_ray(surface.point, direction), surface.face, scratch)
        if surface.face < 0:
            break
        throughput = mul(throughput, diffuse_weight(scene, surface))
        survival = min(scene.most_survival, max_component(throughput) / FAINT)
        if not survives(survival, sample_1d(sampler, ROULETTE)):
            break
        throughput = scale(throughput, 1.0 / survival)
        vertex += 1
        sampler = Sampler(fold(sampler.key, _PATH + vertex), sampler.index)
    return scale(mul(weight, radiance), scene.irradiance_factor)


@device
def direct_nearest(
    scene: SceneArrays,
    photons: PhotonMap,
    factor: float,
    surface: Surface,
    heap: np.ndarray,
    chosen: np.ndarray,
    scratch: Scratch,
) -> Vec3:
    """`factor` times the paper's estimate by the k nearest photons; k is the length of the scratch arrays."""
    weight = diffuse_weight(scene, surface)
    if scene.skips.diffuse and is_black(weight):
        return weight
    translucency = scene.materials.translucency
    irradiance = _by_nearest_of_both(scene, translucency, photons, surface, heap, chosen, scratch)
    return scale(mul(weight, irradiance), factor * INV_PI * scene.irradiance_factor)


@device
def _arrive(scene: SceneArrays, count: int, coherent: bool, scratch: Scratch) -> None:
    """Sample E / pi at the first `count` points of `scratch.samples`; black at those of no face."""
    samples, wave = scratch.samples, scratch.rays
    sample_lights(scene, samples, count)
    asking = _put_asking(scene, count, scratch)
    if _VECTORS and asking == count:
        copy(wave.origins, samples.point)
        copy(wave.directions, samples.way)
        copy(wave.target, samples.target)
        put_all_leaving(scene, wave, samples.face, count)
    else:
        for i in range(count):
            if samples.face[i] < 0:
                put_column(samples.irradiance, i, Vec3(0.0, 0.0, 0.0))
        for k in range(asking):
            _put_occlusion_ray(scene, samples, entry(scratch.lane, k), wave, k)
    if asking > 0:
        occlude_wave(scene, wave, asking, 1.0, coherent, scratch)
    for k in range(asking):
        if wave.found[k]:
            i = scratch.lane[k]
            hidden = arriving_hidden(scene, column(samples.irradiance, i), wave, k, 1.0, scratch)
            put_column(samples.irradiance, i, hidden)


@device
def _put_asking(scene: SceneArrays, count: int, scratch: Scratch) -> int:
    """Put into `lane` which of the first `count` samples have a ray; how many."""
    samples, asking = scratch.samples, 0
    if _VECTORS:
        zero = splat(0.0, 8)
        for k in range(0, count, 8):
            number = numbers(8) + splat(np.int32(k), 8)
            asks = (load(samples.face, k, 8) >= splat(np.int32(0), 8)) & (number < splat(np.int32(count), 8))
            if scene.skips.horizon:
                x, y, z = rows(samples.irradiance, k)
                asks = asks & ((x != zero) | (y != zero) | (z != zero))
            store(scratch.lane, asking, compress(number, asks))
            asking += count_bits(bits(asks))
        return asking
    for i in range(count):
        scratch.lane[asking] = i
        black = scene.skips.horizon and is_black(column(samples.irradiance, i))
        asking += 1 if samples.face[i] >= 0 and not black else 0
    return asking


@device
def _put_occlusion_ray(scene: SceneArrays, samples: LightSamples, i: int, wave: Wave, k: int) -> None:
    """Let ray k of a wave go from point i to its light."""
    put_column(wave.origins, k, column(samples.point, i))
    put_column(wave.directions, k, column(samples.way, i))
    put_leaving(scene, wave, k, entry(samples.face, i))
    wave.target[k] = samples.target[i]


@device
def _arrive_on_both(
    scene: SceneArrays, translucency: np.ndarray | None, count: int, coherent: bool, scratch: Scratch
) -> None:
    """As `_arrive`, of both sides where surfaces are translucent, one sample for each side."""
    samples = scratch.samples
    _arrive(scene, count, coherent, scratch)
    if translucency is not None:
        for k in range(count):
            put_column(scratch.front, k, column(samples.irradiance, k))
            face = entry(samples.face, k)
            scratch.share[k] = translucency[entry(scene.geometry.object, face)] if face >= 0 else 0.0
            scratch.number[k] = face
            put_column(samples.normal, k, negate(column(samples.normal, k)))
            if scratch.share[k] == 0.0:
                samples.face[k] = -1
        _arrive(scene, count, coherent, scratch)
        for k in range(count):
            front = column(scratch.front, k)
            if scratch.share[k] > 0.0:
                front = _of_both(front, column(samples.irradiance, k), scratch.share[k])
            put_column(samples.irradiance, k, front)
            put_column(samples.normal, k, negate(column(samples.normal, k)))
            samples.face[k] = scratch.number[k]


@device
def _light(scene: SceneArrays, count: int, scratch: Scratch) -> None:
    """Sample the light of the first `count` primary hits, their points in `samples`, and add it to `radiance`.

    What is there already is E that was scattered.
    """
    samples = scratch.samples
    share = 1.0 / scene.light_samples
    for i in range(count):
        put_column(scratch.radiance, i, scale(column(scratch.radiance, i), INV_PI))
    for k in range(scene.light_samples):
        if scene.emitters.drawn:
            for i in range(count):
                scratch.sample[i] = scene.light_samples * scratch.index[i] + k
            draw_2d(scratch.pixel, scratch.sample, count, LIGHT, samples.u, samples.v, scratch.words)
        _arrive_on_both(scene, scene.materials.translucency, count, True, scratch)
        for i in range(count):
            straight = scale(column(samples.irradiance, i), share)
            put_column(scratch.radiance, i, add(column(scratch.radiance, i), straight))


@device
def _put_weights(
    scene: SceneArrays, rule: ShadowRule | None, images: Textures | None, count: int, scratch: Scratch
) -> None:
    """Put weights of the first `count` primary hits, in `samples` the faces of those that take light, and no light."""
    if _VECTORS and rule is None and images is None:
        for k in range(0, count, 8):
            _put_eight_weights(scene, k, scratch)
        return
    for i in range(count):
        surface = surface_at(scene, scratch.primary, i, scratch)
        weight, face = Vec3(0.0, 0.0, 0.0), -1
        if surface.face >= 0 and not shadowed(scene, surface, scratch):
            weight = diffuse_weight(scene, surface)
            if not (scene.skips.diffuse and is_black(weight)):
                face = surface.face
        scratch.samples.face[i] = face
        put_column(scratch.weight, i, weight)
        put_column(scratch.radiance, i, Vec3(0.0, 0.0, 0.0))


@device
def _put_eight_weights(scene: SceneArrays, k: int, scratch: Scratch) -> None:
    """Those of hits k ... k + 7, where a weight is its object's alone."""
    met = load(scratch.primary.face, k, 8)
    zero, none = splat(0.0, 8), splat(np.int32(-1), 8)
    weight, face = (zero, zero, zero), none
    left = bits(met > none)
    while left != 0:
        # Neighbours have mostly met one face.
        one = entry(scratch.primary.face, k + lowest_bit(left))
        mine = met == splat(np.int32(one), 8)
        left &= ~bits(mine)
        its = vec3(scene.materials.diffuse, entry(scene.geometry.object, one))
        weight = in_lanes(mine, its, weight)
        if not (scene.skips.diffuse and is_black(its)):
            face = choose(mine, met, face)
    store(scratch.samples.face, k, face)
    put_rows(scratch.weight, k, weight)
    put_rows(scratch.radiance, k, (zero, zero, zero))


@kernel
def _next_event(
    scene: SceneArrays, photons: PhotonMap, key: np.uint64, work: Work, out: np.ndarray, scratch: Scratch
) -> None:
    samples = scratch.samples
    hits = no_hits()
    while True:
        hits = next_hits(scene, key, work, hits, scratch)
        if hits.count == 0:
            break
        put_surfaces(scene, scratch.primary, hits.count, scratch)
        _put_weights(scene, scene.shadow_rule, scene.materials.textures, hits.count, scratch)
        if len(photons.face) > 0:
            for i in range(hits.count):
                if samples.face[i] >= 0:
                    surface = surface_at(scene, scratch.primary, i, scratch)
                    put_column(scratch.radiance, i, density_irradiance(scene, photons, surface, scratch))
        _light(scene, hits.count, scratch)
        for i in range(hits.count):
            radiance = mul(column(scratch.weight, i), column(scratch.radiance, i))
            put_column(scratch.radiance, i, scale(radiance, scene.irradiance_factor))
        accumulate_hits(out, hits.count, scratch)


class _Paths(NamedTuple):
    """Paths that are followed together, bounce by bounce, each from a primary hit.

    Attributes
    ----------
    column, row : (_PATHS,) int64 each, the pixel.
    weight, throughput, radiance : (_PATHS, 3) each: of the diffuse lobe at the hit, of the path, gathered on its way.
    place : (_PATHS, 6): point and normal of the surface at its end.
    face, object : (_PATHS,) int32 each, of that surface.
    key, index, vertex : (_PATHS,) uint64, uint32 and int64: its randomness there, and how often it has bounced.
    alive : (_PATHS,) int64, the paths that go on.
    """

    column: np.ndarray
    row: np.ndarray
    weight: np.ndarray
    throughput: np.ndarray
    radiance: np.ndarray
    place: np.ndarray
    face: np.ndarray
    object: np.ndarray
    key: np.ndarray
    index: np.ndarray
    vertex: np.ndarray
    alive: np.ndarray


# Paths that are followed together: waves stay full until few are left, and all lie in the second cache.
_PATHS = 8 * SIZE


@device
def _put_place(paths: _Paths, path: int, surface: Surface) -> None:
    place = paths.place[path]
    place[0], place[1], place[2] = surface.point.x, surface.point.y, surface.point.z
    place[3], place[4], place[5] = surface.normal.x, surface.normal.y, surface.normal.z
    paths.face[path] = surface.face
    paths.object[path] = surface.object


@device
def _gather(scene: SceneArrays, paths: _Paths, begin: int, count: int, coherent: bool, scratch: Scratch) -> None:
    """Add what lights send to `count` living paths where they are, one sample each."""
    samples = scratch.samples
    for k in range(count):
        path = paths.alive[begin + k]
        scratch.key[k], scratch.sample[k] = paths.key[path], paths.index[path]
    draw_2d(scratch.key, scratch.sample, count, LIGHT, samples.u, samples.v, scratch.words)
    for k in range(count):
        path = paths.alive[begin + k]
        place = paths.place[path]
        put_column(samples.point, k, Vec3(place[0], place[1], place[2]))
        put_column(samples.normal, k, Vec3(place[3], place[4], place[5]))
        samples.face[k] = paths.face[path]
    _arrive_on_both(scene, scene.materials.translucency, count, coherent, scratch)
    for k in range(count):
        path = paths.alive[begin + k]
        gained = gain(vec3(paths.throughput, path), column(samples.irradiance, k))
        put(paths.radiance, path, add(vec3(paths.radiance, path), gained))


@device
def _bounce(scene: SceneArrays, paths: _Paths, begin: int, count: int, kept: int, scratch: Scratch) -> int:
    """Send the `count` living paths on that `_gather` has met; survivors are put into `alive` from `kept` on.

    Returns where they end.
    """
    draw_2d(scratch.key, scratch.sample, count, BOUNCE, scratch.u, scratch.v, scratch.words)
    directions = scratch.rays.directions
    for k in range(count):
        path = paths.alive[begin + k]
        place = paths.place[path]
        put_leaving_ray(scene, scratch.rays, k, Vec3(place[0], place[1], place[2]), entry(paths.face, path))
        put_column(directions, k, Vec3(place[3], place[4], place[5]))
    # The normal until then.
    for k in range(count):
        normal = column(directions, k)
        surface = Surface(normal, normal, normal, -1, entry(paths.object, paths.alive[begin + k]), 1.0, 0.0, 0.0)
        local = scattered(scene.materials.translucency, surface, scratch.u[k], scratch.v[k])
        put_column(directions, k, to_world(frame(normal), local))
    trace_wave(scene, scratch.rays, count, False, scratch)
    draw_2d(scratch.key, scratch.sample, count, ROULETTE, scratch.u, scratch.v, scratch.words)
    put_surfaces(scene, scratch.rays, count, scratch)
    for k in range(count):
        surface = surface_at(scene, scratch.rays, k, scratch)
        if surface.face < 0:
            continue
        path = entry(paths.alive, begin + k)
        throughput = mul(vec3(paths.throughput, path), diffuse_weight(scene, surface))
        survival = min(scene.most_survival, max_component(throughput) / FAINT)
        if not survives(survival, scratch.u[k]):
            continue
        put(paths.throughput, path, scale(throughput, 1.0 / survival))
        _put_place(paths, path, surface)
        vertex = paths.vertex[path] + 1
        paths.vertex[path] = vertex
        paths.key[path] = fold(paths.key[path], _PATH + vertex)
        paths.alive[kept] = path
        kept += 1
    return kept


@device
def _follow(scene: SceneArrays, paths: _Paths, count: int, out: np.ndarray, scratch: Scratch) -> None:
    """Follow the first `count` paths to their ends, as `direct_path` does, and add them to their pixels in order."""
    for path in range(count):
        paths.alive[path] = path
    alive = count
    coherent = True
    while alive > 0:
        kept = 0
        for begin in range(0, alive, SIZE):
            some = min(SIZE, alive - begin)
            _gather(scene, paths, begin, some, coherent, scratch)
            kept = _bounce(scene, paths, begin, some, kept, scratch)
        alive = kept
        coherent = False
    for path in range(count):
        radiance = scale(mul(vec3(paths.weight, path), vec3(paths.radiance, path)), scene.irradiance_factor)
        accumulate(out, paths.row[path], paths.column[path], radiance)


@kernel
def _path(scene: SceneArrays, key: np.uint64, work: Work, out: np.ndarray, scratch: Scratch) -> None:
    paths = _Paths(
        np.empty(_PATHS, np.int64),
        np.empty(_PATHS, np.int64),
        np.empty((_PATHS, 3)),
        np.empty((_PATHS, 3)),
        np.empty((_PATHS, 3)),
        np.empty((_PATHS, 6)),
        np.empty(_PATHS, np.int32),
        np.empty(_PATHS, np.int32),
        np.empty(_PATHS, np.uint64),
        np.empty(_PATHS, np.uint32),
        np.empty(_PATHS, np.int64),
        np.empty(_PATHS, np.int64),
    )
    count = 0
    hits = no_hits()
    while True:
        hits = next_hits(scene, key, work, hits, scratch)
        if hits.count == 0:
            break
        put_surfaces(scene, scratch.primary, hits.count, scratch)
        for i in range(hits.count):
            surface = surface_at(scene, scratch.primary, i, scratch)
            if surface.face >= 0 and not shadowed(scene, surface, scratch):
                weight = diffuse_weight(scene, surface)
                if not (scene.skips.diffuse and is_black(weight)):
                    paths.column[count] = scratch.x[i]
                    paths.row[count] = scratch.y[i]
                    put(paths.weight, count, weight)
                    put(paths.throughput, count, Vec3(1.0, 1.0, 1.0))
                    put(paths.radiance, count, Vec3(0.0, 0.0, 0.0))
                    _put_place(paths, count, surface)
                    paths.key[count] = scratch.pixel[i]
                    paths.index[count] = scratch.index[i]
                    paths.vertex[count] = 0
                    count += 1
        if count + SIZE > _PATHS or hits.ends_tile:
            _follow(scene, paths, count, out, scratch)
            count = 0


@kernel
def _photon_map(
    scene: SceneArrays, photons: PhotonMap, key: np.uint64, work: Work, out: np.ndarray, scratch: Scratch
) -> None:
    hits = no_hits()
    while True:
        hits = next_hits(scene, key, work, hits, scratch)
        if hits.count == 0:
            break
        for i in range(hits.count):
            surface = surface_of(scene, scratch.primary, i)
            if surface.face >= 0 and not shadowed(scene, surface, scratch):
                weight = diffuse_weight(scene, surface)
                if not (scene.skips.diffuse and is_black(weight)):
                    irradiance = density_irradiance(scene, photons, surface, scratch)
                    radiance = scale(mul(weight, irradiance), INV_PI * scene.irradiance_factor)
                    accumulate(out, scratch.y[i], scratch.x[i], radiance)


@kernel
def _nearest(
    scene: SceneArrays,
    photons: PhotonMap,
    nearest: int,
    factor: float,
    key: np.uint64,
    work: Work,
    out: np.ndarray,
    scratch: Scratch,
) -> None:
    heap = np.empty(nearest)
    chosen = np.empty(nearest, np.int64)
    hits = no_hits()
    while True:
        hits = next_hits(scene, key, work, hits, scratch)
        if hits.count == 0:
            break
        for i in range(hits.count):
            surface = surface_of(scene, scratch.primary, i)
            if surface.face >= 0 and not shadowed(scene, surface, scratch):
                radiance = direct_nearest(scene, photons, factor, surface, heap, chosen, scratch)
                accumulate(out, scratch.y[i], scratch.x[i], radiance)


def _limit(scene: Scene, samples: int) -> Limit:
    """E_all; with photons that scatter on the full BSDF, all light that the diffuse lobe reflects."""
    if scene.photons.scattering == "full":
        return limits.physical("direct")
    return Limit("direct", scope="all", shadows=scene.shadows)


def _of_radius(scene: Scene, samples: int, stored: Literal["scattered", "all"]) -> Kernel:
    photons = scene.photons
    return Kernel(shape=photons.kernel, stored=stored, radius=photons.radius, passes=samples)


def _variant(name: str, driver: Callable[..., None], **fields: Any) -> Variant:
    return Variant(name=name, term="direct", estimator=Compiled(driver), **fields)


def _by_nearest(name: str, *, unbiased: bool = False, weighted: bool = True, **fields: Any) -> Variant:
    """The mean over maps, and over the sub-pixel positions of the camera's rays, of a search for k photons."""

    def factor(scene: Scene) -> float:
        return (scene.photons.nearest - 1) / scene.photons.nearest if unbiased else 1.0

    def estimate(scene: Scene, samples: int) -> Kernel:
        k, photons = scene.photons.nearest, scene.photons.count
        return Kernel(shape="nearest", nearest=k, photons=photons, scale=factor(scene), weighted=weighted)

    return _variant(
        name,
        _nearest,
        limit=_limit,
        inputs=lambda scene, chain, photons: (photons, scene.photons.nearest, factor(scene)),
        photons=lambda scene, chain: "all" if weighted else "unweighted",
        kernel=estimate,
        allowance=0.01,
        judged=False,
        why_not="only against its kernel reference: its own limit is an estimate with k photons",
        **fields,
    )


VARIANTS = (
    _variant(
        "next-event",
        _next_event,
        limit=lambda scene, samples: (
            _limit(scene, samples)
            if scene.scope == "all"
            else Limit("direct", scope="first-hit", shadows=scene.shadows)
        ),
        kind="right",
        equation=r"\frac{1}{N} \sum_k \Big[ \frac{L_e \cos\theta \cos\theta'}{d^2\, p}"
        r" + \frac{1}{\pi} \sum_p \Phi_p K_r(x_p - x) / M_r \Big]",
        converges_to=r"E / \pi \;\; (r \to 0;\ \text{exact for first-hit})",
        source="light sampling for the first hit; progressive photon mapping (Knaus, Zwicker, TOG 2011) for the rest",
        measured=True,
        samples_lights=True,
        by_contrast=True,
        several_lights=True,
        inputs=lambda scene, chain, photons: (photons,),
        photons=lambda scene, chain: "scattered" if scene.scope == "all" else None,
        kernel=lambda scene, samples: _of_radius(scene, samples, "scattered") if scene.scope == "all" else None,
        allowance=0.01,
    ),
    _variant(
        "path",
        _path,
        limit=lambda scene, samples: Limit("direct", scope="all", shadows=scene.shadows),
        kind="right",
        equation=r"\frac{1}{N} \sum_k \sum_j \beta_j \frac{L_e \cos\theta \cos\theta'}{d^2\, p}",
        converges_to=r"E_{\text{all}} / \pi",
        source="path tracing with light sampling at every vertex; roulette with 1/p (Arvo, Kirk, 1990)",
        measured=True,
        samples_lights=True,
        no_maps="paths follow the light's bounces",
        scatterings=("diffuse",),
    ),
    _by_nearest(
        "paper",
        kind="wrong",
        equation=r"\frac{1}{N} \sum_k \frac{1}{\pi} \frac{\sum_{p \le k} \Phi_p}{\pi r_k^2}",
        converges_to=r"\frac{k}{k-1} E_{\text{all}} / \pi,\ \text{blurred over } r_k",
        source="the paper's photon map: all photons after roulette, the k nearest",
        measured=True,
    ),
    _by_nearest(
        "paper-unweighted",
        kind="wrong",
        equation=r"\frac{1}{N} \sum_k \frac{1}{\pi} \frac{\sum_{p \le k} \Phi_p}{\pi r_k^2}",
        converges_to=r"\frac{k}{k-1} E / \pi \text{ with the grey albedo } P \text{ of the roulette for } \rho",
        source="the paper's photon map read without division by the survival probability",
        weighted=False,
        scatterings=("diffuse",),
    ),
    _variant(
        "photon-map",
        _photon_map,
        limit=_limit,
        kind="right",
        equation=r"\frac{1}{N} \sum_k \frac{1}{\pi} \sum_p \Phi_p K_{r_k}(x_p - x) / M_{r_k}",
        converges_to=r"E_{\text{all}} / \pi \;\; (r \to 0)",
        source="progressive photon mapping of all photons (Knaus, Zwicker, TOG 2011)",
        inputs=lambda scene, chain, photons: (photons,),
        photons=lambda scene, chain: "all",
        kernel=lambda scene, samples: _of_radius(scene, samples, "all"),
        allowance=0.01,
    ),
    _by_nearest(
        "nearest",
        kind="right",
        equation=r"\frac{1}{N} \sum_k \frac{k - 1}{k} \frac{1}{\pi} \frac{\sum_{p \le k} \Phi_p}{\pi r_k^2}",
        converges_to=r"E_{\text{all}} / \pi,\ \text{blurred over } r_k",
        source="k nearest photons without the factor k / (k - 1) (Garcia, Ureña, Sbert, CGF 2012)",
        unbiased=True,
    ),
)
