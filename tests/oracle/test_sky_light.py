"""The sky as ambient light, in both renderers: one against the other, and Mitsuba's own light transport.

Rationale: on a plate that sees none of itself the ambient part of full light transport is `w / pi ∫ L_sky cos`, by
Mitsuba's light sampling of a sphere about the scene, which shares nothing with the lookup along rays.
"""

import math

import attrs
import numpy as np
import pytest

from termwise import reference
from termwise.renderer import Engine, find
from termwise.scenes.analytic import plate
from termwise.scenes.limits import Limit, physical
from termwise.scenes.model import Ambient, Camera, Material, Scene, Sky
from tests.scenes import box

GREY = Material((0.5, 0.5, 0.5))
TEXTURE = np.random.default_rng(1).uniform(0.1, 0.3, (8, 16, 3)).astype(np.float32)
TEXTURE[1, 5] += 5.0
SKIES = {
    "paper": Sky(texture=TEXTURE, center=(0.5, -1.0, -2.0), radius=9.0),
    "panorama": Sky(texture=TEXTURE, radius=math.inf, projection="lat-long"),
}


def scene_of(sky: Sky, **changes: object) -> Scene:
    floor = plate("floor", (-2.0, -2.0, 0.0), (4.0, 0.0, 0.0), (0.0, 4.0, 0.0), GREY)
    camera = Camera((0.0, -3.0, 4.0), (0.0, 0.0, 0.2), fov=40.0)
    objects = (floor, box("cube", (-0.5, -0.4, 0.05), 0.8))
    scene = Scene("sky", camera, objects, ambient=Ambient(source="sky"), sky=sky, resolution=(12, 12))
    return attrs.evolve(scene, **changes)


@pytest.mark.slow
@pytest.mark.parametrize("name", SKIES)
@pytest.mark.parametrize("variant", ["cosine", "paper"])
def test_ours_is_the_reference(name: str, variant: str):
    """Sixteen replicates each: z of the mean of each channel; a map upside down is proven."""
    scene = scene_of(SKIES[name])
    chosen = find("ambient", variant)
    limit = chosen.limit(scene, 64)

    def ours(scene: Scene) -> np.ndarray:
        with Engine(scene) as engine:
            return np.array(
                [list(engine.prefixes(chosen, samples=64, seed=1, replicate=k))[-1][1] for k in range(16)]
            ).mean(axis=(1, 2))

    found = [reference.replicate(scene, limit, spp=64, seed=2, replicate=k).mean(axis=(0, 1)) for k in range(16)]
    theirs = np.array(found, np.float64)
    turned = attrs.evolve(scene, sky=attrs.evolve(scene.sky, texture=np.ascontiguousarray(TEXTURE[::-1])))
    for ours_of, wrong in ((ours(scene), False), (ours(turned), True)):
        error = np.sqrt((ours_of.var(axis=0, ddof=1) + theirs.var(axis=0, ddof=1)) / 16)
        z = (ours_of.mean(axis=0) - theirs.mean(axis=0)) / error
        assert (np.abs(z) < 4.5).all() != wrong


def test_on_a_plate_it_is_the_ambient_part_of_light_transport():
    scene = scene_of(SKIES["paper"])
    scene = attrs.evolve(
        scene, objects=scene.objects[:1], camera=attrs.evolve(scene.camera, fov=1.0), resolution=(4, 4)
    )
    mean, theirs = (
        reference.render(scene, limit, spp=2048, seed=1, replicates=4)
        for limit in (Limit("ambient"), physical("ambient"))
    )
    np.testing.assert_allclose(mean.mean.mean(axis=(0, 1)), theirs.mean.mean(axis=(0, 1)), rtol=0.01)
    assert mean.mean.all()
    from termwise.reference import film  # Mitsuba's variant is chosen now

    assert not film.serves(reference.loaded(scene), attrs.asdict(Limit("ambient")))
