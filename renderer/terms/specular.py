"""Specular: `L_specular = gloss S[L]`, `S[L] = ∫ f(w_i, w_o) (w_i.n) L(w_i) dw_i`, f Cook-Torrance.

L at the far end is `color (1 - gloss) (ambient + direct) + gloss specular` there, up to `max_bounces` vertices, or the
sky. One chain a sample: the paper's tree of N^M rays has the same mean at exponential cost. The chain meets other
objects and the sky, never the lights (paper). The ambient light at its vertices is the variant `cosine`; direct is
`next-event` or `path` (`Chain`).

Where a surface is transparent L holds the term `transmission` too: a chain is then reflected or refracted at each of
its vertices, one of the two by chance, but for the camera's, whose lobe says which term it is of.

The variants differ in how w_i is drawn and weighted. `vndf` and `uniform` are unbiased. The others are the paper's;
with H[L] = (1/pi) ∫ mu_i L dw and a density 1 / (2 pi) the mean of a weight w is (1 / 2 pi) ∫ w L dw:

- `paper`: w = 2 D F G / mu_o = (4/pi) 2 pi f mu_i, from the BRDF `D F G / (pi mu_i mu_o)`: (4/pi) S.
- `paper-literal`: w = 2 D F G / mu_i, the letters as printed: mu_o in the place of mu_i, (4/pi) ∫ f mu_o L dw.
- `paper-code`: w = mu_k + D F G / mu_o, a sum where a product is meant: H / 2 + (2/pi) S, on rings.
- `paper-code-no-pi`: the same with D of 1982, which has no 1 / pi: H / 2 + 2 S.

Each factor acts at every vertex: a chain in a closed scene gains q = gloss (diffuse + lobe A) a bounce, A = S[1], and
its series over the bounces diverges where q > 1.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from termwise.renderer.arrays import SceneArrays
from termwise.renderer.dielectric import EITHER, REFLECTED, sample_interface, sample_uniformly
from termwise.renderer.film import Work, accumulate, next_hits, no_hits, sampler_of
from termwise.renderer.geometry.intersect import make_ray
from termwise.renderer.jit import device, kernel
from termwise.renderer.material import Dielectrics, chain_ends, interface, lobe_alpha, lobe_f0, specular_weight
from termwise.renderer.microfacet import eval_dfg, sample_lobe
from termwise.renderer.photon_map import PhotonMap
from termwise.renderer.rng import fold
from termwise.renderer.scratch import Scratch
from termwise.renderer.sky import sky_radiance
from termwise.renderer.sobol import Sampler, sample_1d, sample_2d
from termwise.renderer.surface import Surface, shadowed, surface_of, trace
from termwise.renderer.terms.ambient import COSINE, ambient_radiance
from termwise.renderer.terms.ambient import PAPER as PAPER_AMBIENT
from termwise.renderer.terms.direct import direct_nearest, direct_next_event, direct_path
from termwise.renderer.terms.estimator import Compiled
from termwise.renderer.terms.variant import Chain, Stored, Variant
from termwise.renderer.vector import Vec3, add, frame, is_black, mad, max_component, mul, scale, to_local, to_world
from termwise.renderer.warp import hemisphere_ring, ring_cosine
from termwise.scenes.limits import Limit
from termwise.scenes.model import Scene

LOBE = 6  # the pair of dimensions of the lobe's direction
ROULETTE = 7
CHOICE = 8  # between the lobes of a dielectric
_CHAIN = 1 << 20  # keys of the chain's vertices: beyond those of a path


VNDF, UNIFORM, PAPER, PAPER_LITERAL, PAPER_CODE, PAPER_CODE_NO_PI = range(6)


@device
def sample_variant(lobe: int, rings: int, wo: Vec3, alpha: float, f0: Vec3, u: float, v: float) -> tuple[Vec3, Vec3]:
    """Direction w_i and its weight by the estimator `lobe`, in the local frame."""
    if lobe == VNDF and wo.z > 0.0:
        return sample_lobe(wo, alpha, f0, u, v)
    if lobe == PAPER_CODE or lobe == PAPER_CODE_NO_PI:
        u = ring_cosine(u, rings)
    wi = hemisphere_ring(u, v)
    if wo.z <= 0.0:
        # Seen from behind: the lobe is 0, what the paper's code adds to it is not.
        rest = wi.z if lobe == PAPER_CODE or lobe == PAPER_CODE_NO_PI else 0.0
        return wi, Vec3(rest, rest, rest)
    dfg = eval_dfg(wi, wo, alpha, f0)
    if lobe == UNIFORM:
        return wi, scale(dfg, 0.5 * math.pi / wo.z)
    if lobe == PAPER:
        return wi, scale(dfg, 2.0 / wo.z)
    if lobe == PAPER_LITERAL:
        return wi, scale(dfg, 2.0 / wi.z)
    weight = math.pi / wo.z if lobe == PAPER_CODE_NO_PI else 1.0 / wo.z
    return wi, mad(dfg, weight, Vec3(wi.z, wi.z, wi.z))


@device
def _sample_lobes(
    scene: SceneArrays,
    dielectrics: Dielectrics | None,
    lobe: int,
    way: int,
    gloss: float,
    surface: Surface,
    wo: Vec3,
    throughput: Vec3,
    spread: float,
    sampler: Sampler,
) -> tuple[Vec3, Vec3, float]:
    """Direction in the local frame, and what throughput and spread are beyond."""
    u, v = sample_2d(sampler, LOBE)
    if dielectrics is not None and dielectrics.here[surface.object]:
        lobes = interface(scene, dielectrics, gloss, surface)
        way = REFLECTED if dielectrics.opaque[surface.object] else way
        if lobe == VNDF:
            wi, weight, squeezed = sample_interface(way, lobes, wo, u, v, sample_1d(sampler, CHOICE))
        else:
            wi, weight, squeezed = sample_uniformly(way, lobes, wo, u, v)
        return wi, mul(throughput, weight), spread * squeezed
    wi, weight = sample_variant(lobe, scene.rings, wo, lobe_alpha(scene, surface), lobe_f0(scene, surface), u, v)
    return wi, scale(mul(throughput, weight), gloss), spread


@device
def _brightest(dielectrics: Dielectrics | None, throughput: Vec3, spread: float) -> float:
    """What the roulette goes by: of flux, for radiance that a chain finds in a denser medium it loses where it left."""
    if dielectrics is not None:
        return max_component(throughput) / spread
    return max_component(throughput)


_NEXT_EVENT, _PATH, _NEAREST = range(3)


@device
def _diffuse(
    scene: SceneArrays,
    direct: int,
    photons: PhotonMap,
    heap: np.ndarray,
    chosen: np.ndarray,
    surface: Surface,
    sampler: Sampler,
    scratch: Scratch,
) -> Vec3:
    """Ambient + direct at a vertex of the chain."""
    dark = shadowed(scene, surface, scratch)
    rule = PAPER_AMBIENT if direct == _NEAREST else COSINE
    radiance = ambient_radiance(scene, rule, surface, dark, sampler, scratch)
    if dark:
        return radiance
    if direct == _PATH:
        return add(radiance, direct_path(scene, surface, sampler, scratch))
    if direct == _NEAREST:
        return add(radiance, direct_nearest(scene, photons, 1.0, surface, heap, chosen, scratch))
    return add(radiance, direct_next_event(scene, photons, surface, sampler, scratch))


@kernel
def chain(
    scene: SceneArrays,
    begins: int,
    lobe: int,
    direct: int,
    photons: PhotonMap,
    nearest: int,
    key: np.uint64,
    work: Work,
    out: np.ndarray,
    scratch: Scratch,
) -> None:
    """Chains that begin with the lobe `begins` of the camera's vertex, drawn by the rule `lobe`: see `inputs_of`."""
    heap = np.empty(nearest)
    chosen = np.empty(nearest, np.int64)
    dielectrics = scene.materials.dielectrics
    hits = no_hits()
    while True:
        hits = next_hits(scene, key, work, hits, scratch)
        if hits.count == 0:
            break
        for i in range(hits.count):
            surface = surface_of(scene, scratch.primary, i)
            sampler = sampler_of(i, scratch)
            throughput, spread = Vec3(1.0, 1.0, 1.0), 1.0
            way = begins
            bounce = 0
            while surface.face >= 0 and bounce < scene.max_bounces:
                bounce += 1
                gloss = specular_weight(scene, surface)
                if chain_ends(dielectrics, way, gloss, surface) or shadowed(scene, surface, scratch):
                    break
                local = frame(surface.normal)
                wo = to_local(local, surface.wo)
                wi, throughput, spread = _sample_lobes(
                    scene, dielectrics, lobe, way, gloss, surface, wo, throughput, spread, sampler
                )
                way = EITHER
                if scene.skips.throughput and is_black(throughput):
                    break
                brightest = _brightest(dielectrics, throughput, spread)
                if 0.0 < brightest < scene.faint:
                    survival = brightest / scene.faint
                    if sample_1d(sampler, ROULETTE) >= survival:
                        break
                    throughput = scale(throughput, 1.0 / survival)
                direction = to_world(local, wi)
                origin = surface.point
                surface = trace(scene, make_ray(origin, direction), surface.face, scratch)
                sampler = Sampler(fold(sampler.key, _CHAIN), sampler.index)
                if surface.face < 0:
                    radiance = sky_radiance(scene.sky, origin, direction)
                else:
                    radiance = _diffuse(scene, direct, photons, heap, chosen, surface, sampler, scratch)
                accumulate(out, scratch.y[i], scratch.x[i], mul(throughput, radiance))


def inputs_of(begins: int, lobe: int) -> Callable[[Scene, Chain, PhotonMap], tuple[Any, ...]]:
    """The arguments of `chain` for chains that begin with a lobe of the camera's vertex, drawn by the rule `lobe`."""

    def inputs(scene: Scene, chain: Chain, photons: PhotonMap) -> tuple[Any, ...]:
        if chain == "paper":
            return begins, lobe, _NEAREST, photons, scene.photons.nearest
        # With scope `first-hit` light sampling is exact: there is no chain of diffuse bounces to follow.
        unbiased = chain == "path" and scene.scope == "all"
        return begins, lobe, _PATH if unbiased else _NEXT_EVENT, photons, 0

    return inputs


def photons_of(scene: Scene, chain: Chain) -> Stored | None:
    """Which photons a chain gathers."""
    if chain == "paper":
        return "all"
    return "scattered" if scene.scope == "all" and chain == "next-event" else None


def _limit(lobe: float = 1.0, **changes: Any) -> Callable[[Scene, int], Limit]:
    return lambda scene, samples: Limit("specular", scope=scene.scope, lobe=lobe, shadows=scene.shadows, **changes)


def _rings(lobe: float) -> Callable[[Scene, int], Limit]:
    return lambda scene, samples: Limit(
        "specular", scope=scene.scope, lobe=lobe, diffuse=0.5, rings=scene.rings, shadows=scene.shadows
    )


def _variant(name: str, lobe: int, **fields: Any) -> Variant:
    return Variant(
        name=name,
        term="specular",
        estimator=Compiled(chain),
        inputs=inputs_of(REFLECTED, lobe),
        photons=photons_of,
        dielectrics=lobe in (VNDF, UNIFORM),
        by_direction=lobe == UNIFORM,
        **fields,
    )


VARIANTS = (
    _variant(
        "vndf",
        VNDF,
        limit=_limit(),
        kind="right",
        equation=r"\frac{1}{N} \sum_k F(\omega_o \cdot m_k)\, G_1(\omega_k)\, L_k, \quad m_k \sim D_{\omega_o}",
        converges_to=r"S[L]",
        source="Beckmann visible normals: Heitz, d'Eon, EGSR 2014",
        measured=True,
    ),
    _variant(
        "uniform",
        UNIFORM,
        limit=_limit(),
        kind="right",
        equation=r"\frac{2 \pi}{N} \sum_k f\, \mu_k L_k, \quad \mu_k = \frac{k - 1 + U}{N}",
        converges_to=r"S[L]",
        source="the paper's sampling with a normalised BRDF",
    ),
    _variant(
        "paper",
        PAPER,
        limit=_limit(4.0 / math.pi),
        kind="wrong",
        equation=r"\frac{2}{N} \sum_k \frac{D F G}{\mu_o} L_k, \quad \mu_k = \frac{k - 1 + U}{N}",
        converges_to=r"\frac{4}{\pi} S[L] \text{ at every vertex}",
        source="the paper's BRDF D F G / (π μ_i μ_o), sampled uniformly over the hemisphere",
        measured=True,
        ratio=lambda scene: 4.0 / math.pi if scene.max_bounces == 1 else None,
    ),
    _variant(
        "paper-literal",
        PAPER_LITERAL,
        limit=_limit(4.0 / math.pi, cosine="outgoing"),
        kind="wrong",
        equation=r"\frac{2}{N} \sum_k \frac{D F G}{\mu_k} L_k, \quad \mu_k = \frac{k - 1 + U}{N}",
        converges_to=r"\frac{4}{\pi} \int_\Omega f\, \mu_o L\, d\omega",
        source="the paper's Monte Carlo formula, letter by letter: not its own integral",
    ),
    _variant(
        "paper-code",
        PAPER_CODE,
        limit=_rings(2.0 / math.pi),
        kind="wrong",
        equation=r"\frac{1}{N} \sum_k \Big( \mu_k + \frac{F D G}{\mu_o} \Big) L_k, \quad \mu_k = \frac{k}{N + 1}",
        converges_to=r"\frac{1}{2} H[L] + \frac{2}{\pi} S[L] + O(1/N)",
        source="the paper's code, which adds where its formula multiplies; D normalised",
    ),
    _variant(
        "paper-code-no-pi",
        PAPER_CODE_NO_PI,
        limit=_rings(2.0),
        kind="wrong",
        equation=r"\frac{1}{N} \sum_k \Big( \mu_k + \frac{\pi F D G}{\mu_o} \Big) L_k, \quad \mu_k = \frac{k}{N + 1}",
        converges_to=r"\frac{1}{2} H[L] + 2\, S[L] + O(1/N)",
        source="the same with Cook and Torrance's D of 1982, which has no 1/π",
    ),
)
