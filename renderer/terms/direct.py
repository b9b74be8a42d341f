"""Direct: `L_direct = color (1 - gloss) E / pi`, with E of the first hit or of all bounces (`scope`).

Photons after roulette estimate the total irradiance `E_all`: light that arrives straight and light that was scattered,
diffusely with albedo color (1 - gloss), any number of times. `first-hit` means the straight part alone.

Where a surface is translucent E is `(1 - s) E(n) + s E(-n)`: light is sampled on both sides, photons are gathered on
both, and a path goes on to one of them, with its share.
"""

from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from termwise.renderer.arrays import FAINT, SceneArrays
from termwise.renderer.film import accumulate, next_hits, no_hits, resolve_occlusion, sampler_of
from termwise.renderer.geometry.intersect import make_ray
from termwise.renderer.geometry.packets import SIZE
from termwise.renderer.jit import device, kernel
from termwise.renderer.lights import sample_light
from termwise.renderer.material import diffuse_weight, scattered
from termwise.renderer.photon_map import PhotonMap, estimate_irradiance
from termwise.renderer.photon_search import nearest_irradiance
from termwise.renderer.rng import fold
from termwise.renderer.scratch import DENSITY_ESTIMATES, Scratch
from termwise.renderer.sobol import Sampler, sample_1d, sample_2d
from termwise.renderer.surface import Surface, occluded, put_occlusion_ray, shadowed, surface_of, trace, turned
from termwise.renderer.terms.estimator import Compiled
from termwise.renderer.terms.variant import Variant
from termwise.renderer.vector import Vec3, add, frame, is_black, mad, max_component, mul, put, scale, to_world
from termwise.renderer.warp import INV_PI
from termwise.scenes import limits
from termwise.scenes.limits import Kernel, Limit
from termwise.scenes.model import Scene

LIGHT = 2  # the pair that places a sample on a light
BOUNCE = 4  # the direction of the next vertex of a path
ROULETTE = 5
_PATH = 64  # keys of a path's vertices: beyond the pairs above


@device
def light_irradiance(scene: SceneArrays, surface: Surface, sampler: Sampler, dimension: int, scratch: Scratch) -> Vec3:
    """E / pi of both sides of a surface, one sample; uses the pair `dimension`."""
    u, v = sample_2d(sampler, dimension)
    return _light(scene, scene.materials.translucency, surface, u, v, scratch)


@device
def _of_both(front: Vec3, back: Vec3, share: float) -> Vec3:
    """What a side receives, and the other one, which has a share of it."""
    return mad(back, share, scale(front, 1.0 - share))


@device
def _light(
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
    if occluded(scene, surface, direction, 1.0, target, scratch):
        return Vec3(0.0, 0.0, 0.0)
    return irradiance


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
    return _reflected(scene, surface, straight, density_irradiance(scene, photons, surface, scratch))


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
def _reflected(scene: SceneArrays, surface: Surface, straight: Vec3, scattered: Vec3) -> Vec3:
    """Radiance by E / pi that arrives straight, and by E that was scattered."""
    weight = diffuse_weight(scene, surface)
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
        radiance = add(radiance, mul(throughput, light_irradiance(scene, surface, sampler, LIGHT, scratch)))
        u, v = sample_2d(sampler, BOUNCE)
        direction = to_world(frame(surface.normal), scattered(scene.materials.translucency, surface, u, v))
        surface = trace(scene, make_ray(surface.point, direction), surface.face, scratch)
        if surface.face < 0:
            break
        throughput = mul(throughput, diffuse_weight(scene, surface))
        survival = min(scene.most_survival, max_component(throughput) / FAINT)
        if sample_1d(sampler, ROULETTE) >= survival:
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
def _draw_light_points(scene: SceneArrays, count: int, scratch: Scratch) -> None:
    """Draw the points of the light samples of the first `count` primary hits: the k-th of hit i is point `8 k + i`.

    In a loop of its own, which is vectorised.
    """
    if not scene.emitters.drawn:
        return
    for k in range(scene.light_samples):
        for i in range(count):
            sample = np.uint32(scene.light_samples * scratch.index[i] + k)
            sampler = Sampler(scratch.pixel[i], sample)
            scratch.u[SIZE * k + i], scratch.v[SIZE * k + i] = sample_2d(sampler, LIGHT)


@device
def _lanes(scene: SceneArrays, translucency: np.ndarray | None) -> int:
    """The most shadow rays of a primary hit."""
    if translucency is None:
        return scene.light_samples
    return 2 * scene.light_samples


@device
def _of_front(translucency: np.ndarray | None, surface: Surface, straight: Vec3) -> Vec3:
    """What a surface receives on the viewer's side, times that side's share."""
    if translucency is None:
        return straight
    return scale(straight, 1.0 - translucency[surface.object])


@device
def _ask_back(
    scene: SceneArrays,
    translucency: np.ndarray | None,
    surface: Surface,
    k: int,
    x: int,
    waiting: int,
    asking: int,
    scratch: Scratch,
) -> tuple[int, int]:
    """Light sample k on the other side of a surface, as one more that waits; how many wait and ask then."""
    if translucency is None or translucency[surface.object] == 0.0:
        return waiting, asking
    share = translucency[surface.object] / scene.light_samples
    straight, direction, target = sample_light(scene, turned(surface), scratch.u[k], scratch.v[k])
    scratch.column[waiting] = x
    nothing = Vec3(0.0, 0.0, 0.0)
    put(scratch.radiance, waiting, scale(_reflected(scene, surface, straight, nothing), share))
    put(scratch.hidden, waiting, nothing)
    if not (scene.skips.horizon and is_black(straight)):
        put_occlusion_ray(scene, scratch.rays, asking, surface, direction, target)
        scratch.lane[asking] = waiting
        asking += 1
    return waiting + 1, asking


@kernel
def _next_event(
    scene: SceneArrays, photons: PhotonMap, key: np.uint64, work: np.ndarray, out: np.ndarray, scratch: Scratch
) -> None:
    share = 1.0 / scene.light_samples
    translucency = scene.materials.translucency
    lanes = _lanes(scene, translucency)
    hits = no_hits()
    while True:
        hits = next_hits(scene, key, work, hits, scratch)
        if hits.count == 0:
            break
        _draw_light_points(scene, hits.count, scratch)
        waiting = 0
        asking = 0
        for i in range(hits.count):
            surface = surface_of(scene, scratch.primary, i)
            if (
                surface.face >= 0
                and not (scene.skips.diffuse and is_black(diffuse_weight(scene, surface)))
                and not shadowed(scene, surface, scratch)
            ):
                bounced = density_irradiance(scene, photons, surface, scratch)
                hidden = scale(_reflected(scene, surface, Vec3(0.0, 0.0, 0.0), bounced), share)
                for k in range(i, scene.light_samples * SIZE, SIZE):
                    straight, direction, target = sample_light(scene, surface, scratch.u[k], scratch.v[k])
                    straight = _of_front(translucency, surface, straight)
                    radiance = scale(_reflected(scene, surface, straight, bounced), share)
                    scratch.column[waiting] = scratch.x[i]
                    put(scratch.radiance, waiting, radiance)
                    put(scratch.hidden, waiting, hidden)
                    if not (scene.skips.horizon and is_black(straight)):
                        put_occlusion_ray(scene, scratch.rays, asking, surface, direction, target)
                        scratch.lane[asking] = waiting
                        asking += 1
                    waiting += 1
                    waiting, asking = _ask_back(scene, translucency, surface, k, scratch.x[i], waiting, asking, scratch)
            if waiting + lanes > SIZE or i + 1 == hits.count:
                resolve_occlusion(scene, waiting, asking, 1.0, True, hits.y, out, scratch)
                waiting = 0
                asking = 0


@kernel
def _path(scene: SceneArrays, key: np.uint64, work: np.ndarray, out: np.ndarray, scratch: Scratch) -> None:
    hits = no_hits()
    while True:
        hits = next_hits(scene, key, work, hits, scratch)
        if hits.count == 0:
            break
        for i in range(hits.count):
            surface = surface_of(scene, scratch.primary, i)
            if surface.face >= 0 and not shadowed(scene, surface, scratch):
                sampler = sampler_of(i, scratch)
                accumulate(out, hits.y, scratch.x[i], direct_path(scene, surface, sampler, scratch))


@kernel
def _photon_map(
    scene: SceneArrays, photons: PhotonMap, key: np.uint64, work: np.ndarray, out: np.ndarray, scratch: Scratch
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
                    accumulate(out, hits.y, scratch.x[i], radiance)


@kernel
def _nearest(
    scene: SceneArrays,
    photons: PhotonMap,
    nearest: int,
    factor: float,
    key: np.uint64,
    work: np.ndarray,
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
                accumulate(out, hits.y, scratch.x[i], radiance)


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
