"""A variant: one named estimator of a term, with the integral that it converges to."""

from collections.abc import Callable
from typing import Any, Literal

import attrs

from termwise.renderer.photon_map import PhotonMap
from termwise.renderer.terms.estimator import Estimator
from termwise.scenes.limits import Kernel, Limit
from termwise.scenes.model import Scene, least
from termwise.scenes.terms import Term

# What the other terms are at the vertices of a specular chain. Direct is "next-event", the product's default, or
# "path", the unbiased one that a study of specular variants uses, so that kernel bias cannot leak into its verdict;
# ambient is `cosine` with both. "paper": the variants `paper` of both, as the paper's program has them.
Chain = Literal["next-event", "path", "paper"]
CHAINS: dict[Chain, dict[Term, str]] = {
    "next-event": {"ambient": "cosine", "direct": "next-event"},
    "path": {"ambient": "cosine", "direct": "path"},
    "paper": {"ambient": "paper", "direct": "paper"},
}
# Photons kept in a map: those that were scattered at least once, or all; or all, those that survive the roulette being
# left as they were.
Stored = Literal["scattered", "all", "unweighted"]


# A lobe of refraction is about |ior - 1| roughness wide. With 0.03 a thousandth of the far side's directions are its
# (ior 1.1, roughness 0.3, a view 29 degrees aside: 0.00098; 1.01: 0.000012), and of two in a row, which a body takes,
# a millionth: a run may meet no light at all, with no noise that would say so.
NARROWEST = 0.03


@attrs.frozen
class Variant:
    """One row of a term's table.

    Attributes
    ----------
    name : the variant's name within its term.
    term : the term it estimates.
    estimator : what computes it: a kernel, or a function in Python (see `renderer.terms.register`).
    inputs : (scene, chain, photon map) -> a kernel's further arguments.
    limit : (scene, samples) -> Limit, what it converges to; for estimates with a shrinking kernel the limit is that of
        so many samples.
    kind : "right" where the limit is the term's true integral, else "wrong".
    equation : the estimator, as LaTeX.
    converges_to : its limit, as LaTeX.
    source : where it comes from.
    split : scene -> how many samples of a pixel share a camera ray: splitting (Arvo, Kirk, 1990).
    photons : (scene, chain) -> which photons its maps hold: None for no map at all.
    kernel : (scene, samples) -> Kernel, the photon density estimate that stands in its place of E, whose bias vanishes
        only as the kernel shrinks; None where E is estimated without bias.
    scatterings : values of `scene.photons.scattering` that it can follow.
    allowance : share of bias that is granted to a kernel-based variant, printed beside every verdict.
    ratio : scene -> predicted own / correct where that is one number for the whole image, else None.
    judged : whether a verdict is due without a kernel reference; `why_not` says why where it is not.
    measured : whether a study measures it that names no variants.
    occludes : of the ambient term, whether it traces occlusion rays.
    open_is_one : whether it knows without a ray that AO is 1 where nothing lies within reach.
    samples_lights : whether it sends shadow rays to points of the lights.
    dielectrics : whether it has a rule for surfaces that reflect as dielectrics do.
    by_direction : whether it draws directions by no lobe: one that is narrow it hardly ever meets.
    by_contrast : whether the contrast between pixels' corners says how many samples each gets, where it has no maps.
    several_lights : whether `arrays.light_samples` of them stand beside one estimate by photons.
    no_maps : of the direct term, why it has no photon maps where it has none.
    chosen : where `auto` took it for a scene with all bounces, why: by which number (see `renderer.auto`).
    """

    name: str
    term: Term
    limit: Callable[[Scene, int], Limit]
    kind: Literal["right", "wrong"]
    equation: str
    converges_to: str
    source: str
    estimator: Estimator
    inputs: Callable[[Scene, Chain, PhotonMap], tuple[Any, ...]] = lambda scene, chain, photons: ()
    split: Callable[[Scene], int] = lambda scene: 1
    photons: Callable[[Scene, Chain], Stored | None] = lambda scene, chain: None
    kernel: Callable[[Scene, int], Kernel | None] = lambda scene, samples: None
    scatterings: tuple[Literal["diffuse", "full"], ...] = ("diffuse", "full")
    allowance: float = 0.0
    ratio: Callable[[Scene], float | None] = lambda scene: None
    judged: bool = True
    why_not: str = ""
    measured: bool = False
    occludes: bool = True
    open_is_one: bool = False
    samples_lights: bool = False
    dielectrics: bool = True
    by_direction: bool = False
    by_contrast: bool = False
    several_lights: bool = False
    no_maps: str = "first hits need none"
    chosen: str = attrs.field(default="", eq=False)

    def by_nearest(self, scene: Scene, chain: Chain) -> bool:
        """Whether its maps are searched for the k nearest photons, whose mean depends on how many are emitted."""
        kernel = self.kernel(scene, 1)
        return kernel.shape == "nearest" if kernel else chain == "paper"

    def unfit(self, scene: Scene) -> str | None:
        """Why its images mean nothing in a scene, or None."""
        for thing in scene.objects:
            surface = thing.surface
            if surface.transparency > 0.0 and not self.dielectrics:
                return f"objects: {thing.name!r}: transparency = {surface.transparency!r}: allowed is 0"
            if surface.dielectric and not self.dielectrics:
                return f"objects: {thing.name!r}: fresnel = 'dielectric': allowed is 'schlick'"
            if surface.transparency > 0.0 and self.by_direction:
                width = abs(surface.ior - 1.0) * least(surface.roughness)
                if width < NARROWEST:
                    said = f"ior = {surface.ior!r} with roughness = {surface.roughness!r}"
                    return f"objects: {thing.name!r}: {said}: allowed is |ior - 1| roughness >= {NARROWEST}"
        return None

    def kernel_based(self, scene: Scene) -> bool:
        """Whether its bias vanishes only as a photon kernel shrinks."""
        return self.kernel(scene, 1) is not None
