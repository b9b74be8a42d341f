"""Scenes with a known answer: every variant measured against a closed form or a quadrature, no renderer between.

| group | term | own limit of a variant |
|---|---|---|
| furnace | specular | `gloss (lobe A(mu_o) + diffuse)` at one cosine, on the variant's rings |
| closed sphere | specular | `(1 - gloss) sum_{j=1..M} (gloss T)^j 1`: the chain, bounce by bounce |
| disc over plane | ambient | the sum over the variant's rule of what the disc leaves open |

Each row's image is one number everywhere, known without noise, so that its verdict is that of `judge` with an exact
reference.
"""

import math
from collections.abc import Iterator

import attrs
import numpy as np

from renderer.terms import VARIANTS, Variant
from reports import closed_forms
from reports.study import Study
from scenes import analytic
from scenes.limits import Limit, correct
from scenes.model import Scene


@attrs.frozen(eq=False)
class Case:
    """One row to measure.

    Attributes
    ----------
    group : the kind of scene.
    at : parameter -> value within the group.
    scene, variant : what is rendered.
    samples : per pixel and replicate.
    own, correct : (3,) float64, the radiance that the variant and the right estimator converge to.
    gain : q of a chain; None elsewhere.
    """

    group: str
    at: dict[str, float]
    scene: Scene
    variant: Variant
    samples: int
    own: np.ndarray
    correct: np.ndarray
    gain: float | None = None

    @property
    def name(self) -> str:
        """Unique name of the scene."""
        return f"{self.group}: {', '.join(f'{name} {value:g}' for name, value in self.at.items())}"


def cases(study: Study) -> Iterator[Case]:
    """All cases that a study asks for."""
    if study.exact is None:
        return
    yield from _furnaces(study)
    yield from _closed_spheres(study)
    yield from _discs(study)


def _furnaces(study: Study) -> Iterator[Case]:
    assert study.exact
    for roughness in study.exact.roughness:
        for f0 in study.exact.f0:
            for mu_o in study.exact.mu_o:
                scene = analytic.furnace(roughness=roughness, mu_o=mu_o, f0=f0)
                material = scene.objects[0].material
                at = {"roughness": roughness, "F0": f0, "μ_o": mu_o}
                right = closed_forms.albedo(correct("specular", "all"), material, mu_o)
                for name in study.variants.specular:
                    variant = VARIANTS["specular"][name]
                    own = closed_forms.albedo(variant.limit(scene, study.exact.samples), material, mu_o)
                    yield Case("furnace", at, scene, variant, study.exact.samples, own, right)


def _closed_spheres(study: Study) -> Iterator[Case]:
    assert study.exact
    for gloss in study.exact.gloss:
        scenes = [
            # Facets of four subdivisions turn normals by 0.01 rad: 6e-5 of the term (measured), below the tolerance.
            analytic.glossy_sphere(gloss=gloss, roughness=0.3, max_bounces=bounces, subdivisions=4)
            for bounces in range(1, study.exact.bounces + 1)
        ]
        material = scenes[0].objects[0].material
        right = closed_forms.closed_sphere(correct("specular", "all"), material, len(scenes))
        for name in study.variants.specular:
            variant = VARIANTS["specular"][name]
            limit = variant.limit(scenes[0], study.exact.samples)
            own = closed_forms.closed_sphere(limit, material, len(scenes))
            gain = closed_forms.gain(limit, material)
            for bounces, scene in enumerate(scenes, start=1):
                at = {"gloss": gloss, "bounces": bounces}
                yield Case(
                    "closed sphere",
                    at,
                    attrs.evolve(scene, resolution=(8, 8)),
                    variant,
                    max(
                        1, study.exact.samples // 2
                    ),  # each costs several rays through thousands of triangles
                    own[bounces - 1],
                    right[bounces - 1],
                    gain,
                )


def _discs(study: Study) -> Iterator[Case]:
    """Below the centre of a disc of radius R at height h the directions with mu < h / sqrt(h² + R²) are open."""
    assert study.exact
    height = 1.0
    for radius in (0.5, 1.0, 2.0):
        # The rim is a polygon: with so many sides its AO is the disc's to 3e-6.
        scene = analytic.disc_over_plane(height=height, radius=radius, sides=1024)
        edge = height / math.hypot(height, radius)
        for name in study.variants.ambient:
            variant = VARIANTS["ambient"][name]
            limit = variant.limit(scene, 1)
            own = np.full(3, limit.factor * _open_share(limit, edge))
            right = np.full(3, edge**2)
            yield Case("disc over plane", {"radius": radius}, scene, variant, study.exact.samples, own, right)


def _open_share(limit: Limit, edge: float) -> float:
    """AO where the directions above the cosine `edge` are hidden: edge², or the sum over the rings below it."""
    if not limit.occluded:
        return 1.0
    if limit.rings is None:
        return edge**2
    mu = np.arange(1, limit.rings + 1) / (limit.rings + 1)
    return float(2.0 * np.mean(mu * (mu < edge)))
