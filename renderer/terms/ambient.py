"""Ambient: `L_ambient = color (1 - gloss) AO L_a0`, `AO = (1/pi) ∫ hit(w_i) (w_i.n) dw_i`.

hit is 1 where nothing lies within the ambient range along w_i. The paper's integral has no 1 / pi, so it is pi times
brighter; an open surface there gets pi L_a0 and not L_a0.
"""

import math

import numpy as np

from renderer.arrays import SceneArrays
from renderer.film import Tile, accumulate, first_surface
from renderer.geometry.bvh import STACK_SIZE
from renderer.jit import device, kernel
from renderer.sobol import Sampler, sample_2d
from renderer.surface import Surface, occluded
from renderer.terms.variant import Variant
from renderer.vector import Vec3, frame, is_black, mul, scale, to_world, vec3
from renderer.warp import hemisphere_ring, square_to_cosine_hemisphere
from scenes.limits import Limit

OCCLUSION = 1  # the pair of dimensions of the occlusion ray


COSINE, PAPER = 0, 1


@device
def ambient_radiance(
    scene: SceneArrays, rule: int, surface: Surface, sampler: Sampler, stack: np.ndarray
) -> Vec3:
    """Ambient radiance of a surface by one occlusion ray, drawn by `rule`."""
    weight = mul(vec3(scene.materials.diffuse, surface.object), scene.ambient)
    if is_black(weight) or scene.ambient_range == 0.0:
        return weight
    u, v = sample_2d(sampler, OCCLUSION)
    if rule == PAPER:
        # Uniform cosine, weight 2 pi mu: the integral without 1 / pi (paper).
        local = hemisphere_ring(u, v)
        weight = scale(weight, 2.0 * math.pi * u)
    else:
        local = square_to_cosine_hemisphere(u, v)
    direction = to_world(frame(surface.normal), local)
    if occluded(scene, surface, direction, scene.ambient_range, -1, stack):
        return Vec3(0.0, 0.0, 0.0)
    return weight


@kernel
def _occlusion(
    scene: SceneArrays, rule: int, key: np.uint64, first: int, last: int, tile: Tile, out: np.ndarray
) -> None:
    stack = np.empty(STACK_SIZE, np.int32)
    for y in range(tile.y0, tile.y1):
        for x in range(tile.x0, tile.x1):
            for index in range(first, last):
                surface, sampler = first_surface(scene, key, x, y, index, stack)
                if surface.face >= 0:
                    accumulate(out, x, y, ambient_radiance(scene, rule, surface, sampler, stack))


VARIANTS = (
    Variant(
        name="cosine",
        term="ambient",
        driver=_occlusion,
        inputs=lambda scene, chain, photons: (COSINE,),
        limit=lambda scene, samples: Limit("ambient"),
        kind="right",
        equation=r"\frac{1}{N} \sum_k \mathrm{hit}(\omega_k)\, L_{a0}, \quad \omega_k \sim \frac{\cos\theta}{\pi}",
        converges_to=r"\mathrm{AO} \cdot L_{a0}",
        source="cosine-weighted sampling; Owen-scrambled Sobol points (Burley, JCGT 2020)",
    ),
    Variant(
        name="paper",
        term="ambient",
        driver=_occlusion,
        inputs=lambda scene, chain, photons: (PAPER,),
        limit=lambda scene, samples: Limit(
            "ambient", factor=math.pi if scene.toggles.ambient_occlusion else 1.0
        ),
        kind="wrong",
        equation=r"\frac{2\pi}{N} \sum_k \mu_k\, \mathrm{hit}(\omega_k)\, L_{a0}, \quad \mu_k = \frac{k - 1 + U}{N}",
        converges_to=r"\pi \cdot \mathrm{AO} \cdot L_{a0}",
        source="the paper's integral, which has no 1/π",
        ratio=lambda scene: math.pi if scene.toggles.ambient_occlusion else 1.0,
    ),
)
