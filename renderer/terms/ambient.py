"""Ambient: `L_ambient = color (1 - gloss) AO L_a0`, `AO = (1/pi) ∫ hit(w_i) (w_i.n) dw_i`.

hit is 1 where nothing lies within the ambient range along w_i. One direction a sample; the variants differ in how it
is drawn and weighted, and hence in what they converge to:

- `cosine`: density mu / pi, weight 1. AO, unbiased, and the least variance of all.
- `uniform`: mu uniform, density 1 / (2 pi), weight 2 mu. AO, unbiased.
- `paper`: the same directions, weight 2 pi mu: the paper's integral has no 1 / pi, so an open surface gets pi L_a0.
- `paper-loop`: the rings `mu_k = k / (N + 1)` of the loop in the paper's code, weight mu_k: half of the rule
  `(2 pi / N) sum mu_k hit / pi`, AO / 2 as N grows. `(1/N) sum mu_k = 1/2`: on an open surface the rule is exact.
- `constant`: no rays, weight 1: ambient occlusion off.

Where the ambient light is a textured sky, L_sky of the direction is in the place of L_a0, in every variant, and
`cosine` draws half of its directions where the sky is bright (`renderer.sky_light`).

Where a surface is translucent its light is `(1 - s) A(n) + s A(-n)`: each sample is of one side, with its share.
"""

import math
from typing import Any

import numpy as np

from termwise.renderer.arrays import SceneArrays
from termwise.renderer.film import Work, added, next_hits, no_hits, samples_of
from termwise.renderer.geometry.wave import SIZE
from termwise.renderer.jit import device, kernel
from termwise.renderer.material import diffuse_weight, sampled_side, sees_all_ambient, side_of, whole_color
from termwise.renderer.scratch import Scratch
from termwise.renderer.sky import sky_radiance
from termwise.renderer.sky_light import SkyMap, sky_light
from termwise.renderer.sobol import Sampler, draw_2d, sample_2d
from termwise.renderer.surface import (
    Surface,
    arriving,
    arriving_hidden,
    occlude_wave,
    put_occlusion_ray,
    put_surfaces,
    shadowed,
    surface_at,
)
from termwise.renderer.terms.estimator import Compiled
from termwise.renderer.terms.variant import Variant
from termwise.renderer.vector import Vec3, column, frame, is_black, mul, negate, put, put_column, scale, to_world, vec3
from termwise.renderer.warp import hemisphere_ring, ring_cosine, square_to_cosine_hemisphere
from termwise.scenes.limits import Limit
from termwise.scenes.model import Scene

OCCLUSION = 1  # the pair of dimensions of the occlusion ray
# Occlusion rays that leave what one camera ray sees: with camera rays of their own the same error takes longer.
SPLIT = 4

COSINE, UNIFORM, PAPER, PAPER_LOOP, CONSTANT = range(5)


@device
def sample_hemisphere(rule: int, rings: int, u: float, v: float) -> tuple[Vec3, float]:
    """Direction in the local frame by `rule`, and its weight in the estimate of AO."""
    if rule == COSINE:
        return square_to_cosine_hemisphere(u, v), 1.0
    if rule == PAPER_LOOP:
        u = ring_cosine(u, rings)
    weight = u
    if rule == UNIFORM:
        weight = 2.0 * u
    elif rule == PAPER:
        weight = 2.0 * math.pi * u
    return hemisphere_ring(u, v), weight


@device
def ambient_reach(scene: SceneArrays, rule: int) -> float:
    """Distance within which geometry hides the ambient light; 0: nothing does."""
    return 0.0 if rule == CONSTANT else scene.ambient_range


@device
def ambient_light(scene: SceneArrays, rule: int, surface: Surface, dark: bool) -> tuple[Vec3, bool]:
    """Ambient radiance of a surface that nothing hides, and whether rays have to ask; `dark`: by the paper's rule."""
    share = whole_color(scene, surface) if dark else diffuse_weight(scene, surface)
    radiance = mul(share, scene.ambient)
    if scene.skips.diffuse and is_black(radiance):
        return radiance, False
    return radiance, _asks(scene, scene.sky_map, rule, surface)


@device
def _asks(scene: SceneArrays, sky_map: SkyMap | None, rule: int, surface: Surface) -> bool:
    """Whether a sample has a direction."""
    if sky_map is not None:
        return True
    if scene.skips.occlusion and ambient_reach(scene, rule) == 0.0:
        return False
    return rule != COSINE or not sees_all_ambient(scene, surface)


@device
def ambient_direction(scene: SceneArrays, rule: int, normal: Vec3, u: float, v: float) -> tuple[Vec3, float]:
    """Direction of one sample, and its weight; where nothing can hide the light all weigh 1."""
    rule = COSINE if ambient_reach(scene, rule) == 0.0 else rule
    local, weight = sample_hemisphere(rule, scene.rings, u, v)
    return to_world(frame(normal), local), weight


@device
def _by_direction(
    scene: SceneArrays, sky_map: SkyMap | None, rule: int, origin: Vec3, normal: Vec3, u: float, v: float
) -> tuple[Vec3, Vec3]:
    """Direction of one sample, and its weight in each channel: that of `ambient_direction`, times the sky's light.

    Where the weight is 1 throughout, by `COSINE`, the direction is drawn by the sky as well.
    """
    if sky_map is not None and (rule == COSINE or ambient_reach(scene, rule) == 0.0):
        return sky_light(scene, sky_map, origin, normal, u, v)
    direction, weight = ambient_direction(scene, rule, normal, u, v)
    if sky_map is not None:
        return direction, scale(sky_radiance(scene.sky, origin, direction), weight)
    return direction, Vec3(weight, weight, weight)


@device
def ambient_radiance(
    scene: SceneArrays, rule: int, surface: Surface, dark: bool, sampler: Sampler, scratch: Scratch
) -> Vec3:
    """Ambient radiance of a surface by one occlusion ray, drawn by `rule`; `dark`: shadowed by the paper's rule."""
    radiance, asks = ambient_light(scene, rule, surface, dark)
    if not asks:
        return radiance
    u, v = sample_2d(sampler, OCCLUSION)
    normal, u = sampled_side(scene.materials.translucency, surface, u)
    direction, weight = _by_direction(scene, scene.sky_map, rule, surface.point, normal, u, v)
    return arriving(scene, mul(radiance, weight), surface, direction, ambient_reach(scene, rule), -1, scratch)


@device
def _ask(scene: SceneArrays, surface: Surface, i: int, samples: tuple[int, int], asking: int, scratch: Scratch) -> int:
    """Let the rays of some samples of primary hit i wait, behind `asking` others; how many wait then."""
    for sample in range(samples[0], samples[1]):
        # Its direction is the normal until `_draw_directions` has drawn one.
        put_occlusion_ray(scene, scratch.rays, asking, surface, surface.normal, -1)
        _keep_share(scene.materials.translucency, asking, surface, scratch)
        scratch.key[asking] = scratch.pixel[i]
        scratch.sample[asking] = sample
        asking += 1
    return asking


@device
def _keep_share(translucency: np.ndarray | None, asking: int, surface: Surface, scratch: Scratch) -> None:
    if translucency is not None:
        scratch.share[asking] = translucency[surface.object]


@device
def _draw_directions(scene: SceneArrays, rule: int, asking: int, scratch: Scratch) -> None:
    """Draw the directions of the first `asking` occlusion rays, which are their normals before, and weights.

    Loops of their own: those that draw and map eight points are vectorised.
    """
    draw_2d(scratch.key, scratch.sample, asking, OCCLUSION, scratch.u, scratch.v, scratch.words)
    _choose_sides(scene.materials.translucency, asking, scratch)
    _map(scene, scene.sky_map, rule, asking, scratch)


@device
def _choose_sides(translucency: np.ndarray | None, asking: int, scratch: Scratch) -> None:
    """Turn the normals of those rays that are of the other side."""
    if translucency is not None:
        for k in range(asking):
            crosses, scratch.u[k] = side_of(scratch.share[k], scratch.u[k])
            if crosses:
                put_column(scratch.rays.directions, k, negate(column(scratch.rays.directions, k)))


@device
def _map(scene: SceneArrays, sky_map: SkyMap | None, rule: int, asking: int, scratch: Scratch) -> None:
    """Directions by their points of the unit square, and weights: `scratch.u`, of a sky's light `scratch.weight`."""
    directions = scratch.rays.directions
    if sky_map is not None:
        for k in range(asking):
            origin, normal = column(scratch.rays.origins, k), column(directions, k)
            direction, weight = _by_direction(scene, sky_map, rule, origin, normal, scratch.u[k], scratch.v[k])
            put_column(directions, k, direction)
            put_column(scratch.weight, k, weight)
        return
    for k in range(asking):
        direction, scratch.u[k] = ambient_direction(scene, rule, column(directions, k), scratch.u[k], scratch.v[k])
        put_column(directions, k, direction)


@device
def _passing(
    scene: SceneArrays, sky_map: SkyMap | None, passing: np.ndarray | None, k: int, far: float, scratch: Scratch
) -> Vec3:
    """What ray k lets pass of light of radiance 1, or of the sky's."""
    weight = Vec3(scratch.u[k], scratch.u[k], scratch.u[k])
    if sky_map is not None:
        weight = column(scratch.weight, k)
    found = scratch.rays.found[k]
    if passing is not None and found:
        return arriving_hidden(scene, weight, scratch.rays, k, far, scratch)
    # Weights are finite; a branch would be guessed wrong as often as not.
    return scale(weight, 0.0 if found else 1.0)


@device
def _resolve(scene: SceneArrays, waiting: int, asking: int, far: float, out: np.ndarray, scratch: Scratch) -> None:
    """Add to their pixels, in order, the first `waiting` hits: their light times the weights of rays that pass."""
    if asking > 0:
        occlude_wave(scene, scratch.rays, asking, far, False, scratch)
    k = 0
    for j in range(waiting):
        x, y, radiance = scratch.column[j], scratch.row[j], column(scratch.radiance, j)
        total = vec3(out[y], x)
        # Sample by sample: a run in parts has the bits of the whole.
        for _ in range(scratch.number[j]):
            light = radiance
            if scratch.asks[j]:
                light = mul(radiance, _passing(scene, scene.sky_map, scene.materials.passing, k, far, scratch))
                k += 1
            total = added(total, light)
        put(out[y], x, total)


@kernel
def _occlusion(scene: SceneArrays, rule: int, key: np.uint64, work: Work, out: np.ndarray, scratch: Scratch) -> None:
    waiting = 0
    asking = 0
    hits = no_hits()
    while True:
        hits = next_hits(scene, key, work, hits, scratch)
        if hits.count == 0:
            break
        put_surfaces(scene, scratch.primary, hits.count, scratch)
        for i in range(hits.count):
            surface = surface_at(scene, scratch.primary, i, scratch)
            if surface.face >= 0:
                radiance, asks = ambient_light(scene, rule, surface, shadowed(scene, surface, scratch))
                x, y = scratch.x[i], scratch.y[i]
                samples = samples_of(scratch.index[i], hits.split, work.begin[y, x], work.end[y, x])
                scratch.column[waiting] = x
                scratch.row[waiting] = y
                scratch.number[waiting] = samples[1] - samples[0]
                scratch.asks[waiting] = asks
                put_column(scratch.radiance, waiting, radiance)
                waiting += 1
                if asks:
                    asking = _ask(scene, surface, i, samples, asking, scratch)
            if waiting == SIZE or asking + hits.split > SIZE or (hits.ends_tile and i + 1 == hits.count):
                _draw_directions(scene, rule, asking, scratch)
                _resolve(scene, waiting, asking, ambient_reach(scene, rule), out, scratch)
                waiting = 0
                asking = 0


def _limit(scene: Scene, *, factor: float = 1.0, rings: int | None = None) -> Limit:
    """What an estimator becomes where ambient occlusion is off: L_a0 without a ray, in all variants (paper)."""
    if not scene.toggles.ambient_occlusion:
        factor, rings = 1.0, None
    return Limit("ambient", occluded=scene.toggles.ambient_occlusion, factor=factor, rings=rings, shadows=scene.shadows)


def _variant(name: str, rule: int, **fields: Any) -> Variant:
    return Variant(
        name=name,
        term="ambient",
        estimator=Compiled(_occlusion),
        inputs=lambda scene, chain, photons: (rule,),
        split=lambda scene: SPLIT,
        **fields,
    )


VARIANTS = (
    _variant(
        "cosine",
        COSINE,
        limit=lambda scene, samples: _limit(scene),
        kind="right",
        equation=r"\frac{1}{N} \sum_k \mathrm{hit}(\omega_k)\, L_{a0}, \quad \omega_k \sim \frac{\cos\theta}{\pi}",
        converges_to=r"\mathrm{AO} \cdot L_{a0}",
        source="cosine-weighted sampling; Owen-scrambled Sobol points (Burley, JCGT 2020)",
        measured=True,
        open_is_one=True,
    ),
    _variant(
        "uniform",
        UNIFORM,
        limit=lambda scene, samples: _limit(scene),
        kind="right",
        equation=r"\frac{2}{N} \sum_k \mu_k\, \mathrm{hit}(\omega_k)\, L_{a0}, \quad \mu_k = \frac{k - 1 + U}{N}",
        converges_to=r"\mathrm{AO} \cdot L_{a0}",
        source="the paper's sampling with the factor that its integral lacks",
    ),
    _variant(
        "paper",
        PAPER,
        limit=lambda scene, samples: _limit(scene, factor=math.pi),
        kind="wrong",
        equation=r"\frac{2\pi}{N} \sum_k \mu_k\, \mathrm{hit}(\omega_k)\, L_{a0}, \quad \mu_k = \frac{k - 1 + U}{N}",
        converges_to=r"\pi \cdot \mathrm{AO} \cdot L_{a0}",
        source="the paper's integral, which has no 1/π",
        measured=True,
        ratio=lambda scene: math.pi if scene.toggles.ambient_occlusion else 1.0,
    ),
    _variant(
        "paper-loop",
        PAPER_LOOP,
        limit=lambda scene, samples: _limit(scene, factor=0.5, rings=scene.rings),
        kind="wrong",
        equation=r"\frac{1}{N} \sum_k \mu_k\, \mathrm{hit}(\omega_k)\, L_{a0}, \quad \mu_k = \frac{k}{N + 1}",
        converges_to=r"\frac{1}{2} \mathrm{AO} \cdot L_{a0} + O(1/N)",
        source="the loop of the paper's code: fixed rings, divided by N alone",
    ),
    _variant(
        "constant",
        CONSTANT,
        limit=lambda scene, samples: Limit("ambient", occluded=False, shadows=scene.shadows),
        kind="wrong",
        equation=r"L_{a0}",
        converges_to=r"L_{a0}",
        source="the paper's ambient light with ambient occlusion switched off",
        occludes=False,
    ),
)
