"""Background: what a camera ray sees without shading: the sky on a miss, and a light's own surface (`draw_lights`).

The paper draws no lights. An emitter shows the radiance of its front side; its back is black. A sun stands before the
sky and hides none of it.
"""

import numpy as np

from termwise.renderer.arrays import SceneArrays
from termwise.renderer.film import Work, accumulate, next_hits, no_hits
from termwise.renderer.jit import device, kernel
from termwise.renderer.lights.sun import Suns, radiance_of_suns
from termwise.renderer.material import emission
from termwise.renderer.scratch import Scratch
from termwise.renderer.sky import sky_radiance
from termwise.renderer.surface import surface_of
from termwise.renderer.terms.estimator import Compiled
from termwise.renderer.terms.variant import Variant
from termwise.renderer.vector import Vec3, add, column
from termwise.scenes.limits import Limit


@device
def _beyond(scene: SceneArrays, suns: Suns | None, origin: Vec3, direction: Vec3) -> Vec3:
    """What a ray sees that misses everything."""
    sky = sky_radiance(scene.sky, origin, direction)
    if suns is not None and scene.draw_lights:
        return add(sky, radiance_of_suns(suns, direction))
    return sky


@kernel
def _seen(scene: SceneArrays, key: np.uint64, work: Work, out: np.ndarray, scratch: Scratch) -> None:
    hits = no_hits()
    while True:
        hits = next_hits(scene, key, work, hits, scratch)
        if hits.count == 0:
            break
        for i in range(hits.count):
            surface = surface_of(scene, scratch.primary, i)
            if surface.face < 0:
                origin = column(scratch.primary.origins, i)
                direction = column(scratch.primary.directions, i)
                accumulate(out, scratch.y[i], scratch.x[i], _beyond(scene, scene.emitters.suns, origin, direction))
            elif scene.draw_lights and surface.side > 0.0:
                accumulate(out, scratch.y[i], scratch.x[i], emission(scene, surface.face, surface.b1, surface.b2))


VARIANTS = (
    Variant(
        name="seen",
        term="background",
        estimator=Compiled(_seen),
        limit=lambda scene, samples: Limit("background"),
        kind="right",
        equation=r"\frac{1}{N} \sum_k L_{\text{sky}}(\omega_k) \text{ or } L_e",
        converges_to=r"L_{\text{sky}},\ L_e",
        source="the paper's sky; lights drawn as an option",
        measured=True,
        by_contrast=True,
    ),
)
