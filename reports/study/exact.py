"""Scenes with a known answer: every variant measured against a closed form or a quadrature, no renderer between.

| group | term | own limit of a variant |
|---|---|---|
| furnace | specular | `gloss (lobe A(mu_o) + diffuse)` at one cosine, on the variant's rings |
| closed sphere | specular | `(1 - gloss) sum_{j=1..M} (gloss T)^j 1`: the chain, bounce by bounce |
| disc over plane | ambient | the sum over the variant's rule of what the disc leaves open |
| unit sphere | direct | `rho I / (pi (1 - rho))`, by the k nearest `k / (k - 1)` of it, unweighted 1 - P for 1 - rho |

Each row's image is one number everywhere, known without noise, so that its verdict is that of `judge` with an exact
reference.
"""

import math
from collections.abc import Iterator

import attrs
import numpy as np

from termwise.renderer.terms import VARIANTS, Variant
from termwise.reports.study import closed_forms
from termwise.reports.study.study import Study
from termwise.scenes import analytic
from termwise.scenes.limits import Limit, correct
from termwise.scenes.model import Scene

_PASSES, _PHOTONS = 16, 8000  # samples of a photon estimate, each with a map of its own, of so many photons


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
    yield from _unit_spheres(study)


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
                    samples = _samples_of_lobe(study.exact.samples, name, roughness, mu_o)
                    yield Case("furnace", at, scene, variant, samples, own, right)


def _samples_of_lobe(samples: int, variant: str, roughness: float, mu_o: float) -> int:
    """Uniform directions seldom meet a lobe that is narrow and seen at a grazing angle.

    Where eight times as many would not decide, the study's count stands.
    """
    width = roughness * mu_o
    if variant == "vndf" or width > 0.05:
        return max(1, samples // 4)
    if width < 0.01 or (width < 0.02 and variant == "paper-literal"):
        return samples
    return samples * (8 if width < 0.02 else 2)


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
                    _samples_of_chain(study.exact.samples, name, gloss, bounces),
                    own[bounces - 1],
                    right[bounces - 1],
                    gain,
                )


def _samples_of_chain(samples: int, variant: str, gloss: float, bounces: int) -> int:
    """Uniform directions have more variance for each bounce more; visible normals have next to none.

    The Lambertian half of `paper-code` takes most of its variance away.
    """
    if variant == "vndf":
        return max(1, samples // 8)
    uniform = 2 ** round(math.log2(gloss * samples * 2**bounces / 4))
    return max(samples // 8, uniform // 4) if variant == "paper-code" else max(1, uniform)


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


def _unit_spheres(study: Study) -> Iterator[Case]:
    """A constant E, which no kernel blurs: what is left are factors, the k nearest photons' and the roulette's."""
    assert study.exact
    albedo, intensity = 0.5, math.pi
    sphere = analytic.unit_sphere(albedo=albedo, intensity=intensity, subdivisions=4)
    # The flux on the facets is the sphere's, their area is not; what they make E vary by is 1e-4 in the mean.
    mesh = sphere.objects[0].mesh
    edges = np.diff(mesh.vertices[mesh.faces], axis=1)
    area = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum()
    right = np.full(3, 4 * math.pi / area * albedo * intensity / (math.pi * (1 - albedo)))
    for survival in (albedo, 0.7):
        photons = attrs.evolve(sphere.photons, survival=survival, count=_PHOTONS)
        scene = attrs.evolve(sphere, photons=photons, resolution=(8, 8))
        for name in study.variants.direct:
            variant = VARIANTS["direct"][name]
            kernel = variant.kernel(scene, 1)
            if survival != albedo and name not in ("photon-map", "paper", "paper-unweighted"):
                continue  # one right estimate and the paper's two readings show what P does
            own = right
            if kernel is not None and not kernel.weighted:
                own = own * (1 - albedo) / (1 - survival)
            if kernel is not None and kernel.shape == "nearest":
                own = own * kernel.scale * kernel.nearest / (kernel.nearest - 1)
            samples = study.exact.samples if kernel is None else _PASSES
            yield Case("unit sphere", {"rho": albedo, "P": survival}, scene, variant, samples, own, right)


def _open_share(limit: Limit, edge: float) -> float:
    """AO where the directions above the cosine `edge` are hidden: edge², or the sum over the rings below it."""
    if not limit.occluded:
        return 1.0
    if limit.rings is None:
        return edge**2
    mu = np.arange(1, limit.rings + 1) / (limit.rings + 1)
    return float(2.0 * np.mean(mu * (mu < edge)))
