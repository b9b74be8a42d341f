"""Background: what a camera ray sees without shading: the sky on a miss, and a light's own surface (`draw_lights`).

The paper draws no lights. An emitter shows the radiance of its front side; its back is black.
"""

import numpy as np

from renderer.arrays import SceneArrays
from renderer.camera import camera_ray
from renderer.film import Tile, accumulate
from renderer.jit import kernel
from renderer.rng import fold
from renderer.scratch import Scratch
from renderer.sky import sky_radiance
from renderer.sobol import Sampler
from renderer.surface import trace
from renderer.terms.variant import Variant
from renderer.vector import vec3
from scenes.limits import Limit


@kernel
def _seen(
    scene: SceneArrays, key: np.uint64, first: int, last: int, tile: Tile, out: np.ndarray, scratch: Scratch
) -> None:
    for y in range(tile.y0, tile.y1):
        for x in range(tile.x0, tile.x1):
            for index in range(first, last):
                sampler = Sampler(fold(key, y * scene.camera.width + x), np.uint32(index))
                ray = camera_ray(scene.camera, x, y, sampler)
                surface = trace(scene, ray, -1, scratch)
                if surface.face < 0:
                    accumulate(out, x, y, sky_radiance(scene.sky, ray.origin, ray.direction))
                elif scene.draw_lights and surface.side > 0.0:
                    accumulate(out, x, y, vec3(scene.materials.emission, surface.object))


VARIANTS = (
    Variant(
        name="seen",
        term="background",
        driver=_seen,
        limit=lambda scene, samples: Limit("background"),
        kind="right",
        equation=r"\frac{1}{N} \sum_k L_{\text{sky}}(\omega_k) \text{ or } L_e",
        converges_to=r"L_{\text{sky}},\ L_e",
        source="the paper's sky; lights drawn as an option",
    ),
)
