"""Specular: `L_specular = gloss S[L]`, `S[L] = ∫ f(w_i, w_o) (w_i.n) L(w_i) dw_i`, f Cook-Torrance.

L at the far end is `color (1 - gloss) (ambient + direct) + gloss specular` there, up to `max_bounces` vertices, or the
sky. One chain a sample: the paper's tree of N^M rays has the same mean at exponential cost. The chain meets other
objects and the sky, never the lights (paper). The ambient light at its vertices is the variant `cosine`; direct is
`next-event` or `path` (`Chain`).

The paper's BRDF is `D F G / (pi mu_i mu_o)`, 4 / pi times the model whose D is normalised, at every vertex.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from renderer.arrays import SceneArrays
from renderer.film import Tile, accumulate, first_surface
from renderer.geometry.bvh import STACK_SIZE
from renderer.geometry.intersect import make_ray
from renderer.jit import device, kernel
from renderer.microfacet import eval_dfg, sample_lobe
from renderer.photon_map import PhotonMap
from renderer.rng import fold
from renderer.sky import sky_radiance
from renderer.sobol import Sampler, sample_1d, sample_2d
from renderer.surface import Surface, trace
from renderer.terms.ambient import COSINE, ambient_radiance
from renderer.terms.direct import direct_next_event, direct_path
from renderer.terms.variant import Chain, Stored, Variant
from renderer.vector import Vec3, add, frame, is_black, max_component, mul, scale, to_local, to_world, vec3
from renderer.warp import hemisphere_ring
from scenes.limits import Limit
from scenes.model import Scene

LOBE = 6  # the pair of dimensions of the lobe's direction
ROULETTE = 7
# A chain of less throughput goes on with probability throughput / FAINT, at the throughput FAINT: unbiased, and 1.2 to
# 1.6 times faster for `paper`, most of whose samples weigh next to nothing, at the same variance (three scenes).
FAINT = 0.1
_CHAIN = 1 << 20  # keys of the chain's vertices: beyond those of a path


VNDF, PAPER = 0, 1


@device
def sample_variant(lobe: int, wo: Vec3, alpha: float, f0: Vec3, u: float, v: float) -> tuple[Vec3, Vec3]:
    """Direction w_i and its weight by the estimator `lobe`, in the local frame."""
    if lobe == PAPER:
        # Uniform cosine, weight 2 D F G / mu_o: 4 / pi times S (the paper's formula, its consistent reading).
        wi = hemisphere_ring(u, v)
        if wo.z <= 0.0:
            return wi, Vec3(0.0, 0.0, 0.0)
        return wi, scale(eval_dfg(wi, wo, alpha, f0), 2.0 / wo.z)
    # Visible normals, weight F G1(w_i) <= 1: unbiased for S.
    return sample_lobe(wo, alpha, f0, u, v)


@device
def _diffuse(
    scene: SceneArrays,
    photons: PhotonMap,
    unbiased: bool,
    surface: Surface,
    sampler: Sampler,
    stack: np.ndarray,
) -> Vec3:
    """Ambient + direct at a vertex of the chain."""
    ambient = ambient_radiance(scene, COSINE, surface, sampler, stack)
    if unbiased:
        return add(ambient, direct_path(scene, surface, sampler, stack))
    return add(ambient, direct_next_event(scene, photons, surface, sampler, stack))


@kernel
def _chain(
    scene: SceneArrays,
    lobe: int,
    photons: PhotonMap,
    unbiased: bool,
    key: np.uint64,
    first: int,
    last: int,
    tile: Tile,
    out: np.ndarray,
) -> None:
    stack = np.empty(STACK_SIZE, np.int32)
    for y in range(tile.y0, tile.y1):
        for x in range(tile.x0, tile.x1):
            for index in range(first, last):
                surface, sampler = first_surface(scene, key, x, y, index, stack)
                throughput = Vec3(1.0, 1.0, 1.0)
                bounce = 0
                while surface.face >= 0 and bounce < scene.max_bounces:
                    bounce += 1
                    material = surface.object
                    gloss = scene.materials.specular[material]
                    if gloss == 0.0:
                        break
                    local = frame(surface.normal)
                    wo = to_local(local, surface.wo)
                    u, v = sample_2d(sampler, LOBE)
                    f0 = vec3(scene.materials.f0, material)
                    wi, weight = sample_variant(lobe, wo, scene.materials.alpha[material], f0, u, v)
                    throughput = scale(mul(throughput, weight), gloss)
                    if is_black(throughput):
                        break
                    survival = min(1.0, max_component(throughput) / FAINT)
                    if survival < 1.0:
                        if sample_1d(sampler, ROULETTE) >= survival:
                            break
                        throughput = scale(throughput, 1.0 / survival)
                    direction = to_world(local, wi)
                    origin = surface.point
                    surface = trace(scene, make_ray(origin, direction), surface.face, stack)
                    sampler = Sampler(fold(sampler.key, _CHAIN), sampler.index)
                    if surface.face < 0:
                        radiance = sky_radiance(scene.sky, origin, direction)
                    else:
                        radiance = _diffuse(scene, photons, unbiased, surface, sampler, stack)
                    accumulate(out, x, y, mul(throughput, radiance))


def _inputs(lobe: int) -> Callable[[Scene, Chain, PhotonMap], tuple[Any, ...]]:
    # With scope `first-hit` light sampling is exact: there is no chain of diffuse bounces to follow.
    return lambda scene, chain, photons: (lobe, photons, chain == "path" and scene.scope == "all")


def _photons(scene: Scene, chain: Chain) -> Stored | None:
    return "scattered" if scene.scope == "all" and chain == "next-event" else None


VARIANTS = (
    Variant(
        name="vndf",
        term="specular",
        driver=_chain,
        inputs=_inputs(VNDF),
        photons=_photons,
        limit=lambda scene, samples: Limit("specular", scope=scene.scope),
        kind="right",
        equation=r"\frac{1}{N} \sum_k F(\omega_o \cdot m_k)\, G_1(\omega_k)\, L_k, \quad m_k \sim D_{\omega_o}",
        converges_to=r"S[L]",
        source="Beckmann visible normals: Heitz, d'Eon, EGSR 2014",
    ),
    Variant(
        name="paper",
        term="specular",
        driver=_chain,
        inputs=_inputs(PAPER),
        photons=_photons,
        limit=lambda scene, samples: Limit("specular", scope=scene.scope, lobe=4.0 / math.pi),
        kind="wrong",
        equation=r"\frac{2}{N} \sum_k \frac{D F G}{\mu_o} L_k, \quad \mu_k = \frac{k - 1 + U}{N}",
        converges_to=r"\frac{4}{\pi} S[L] \text{ at every vertex}",
        source="the paper's BRDF D F G / (π μ_i μ_o), sampled uniformly over the hemisphere",
        ratio=lambda scene: 4.0 / math.pi if scene.max_bounces == 1 else None,
    ),
)
