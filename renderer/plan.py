"""What a scene needs: every piece of work, whether it runs, and why not where it does not.

A skip is work that cannot contribute: the image is the same to the bit without it.
"""

import attrs

from renderer.terms.variant import Chain, Stored, Variant
from scenes.model import Scene
from scenes.terms import TERMS, Term


@attrs.frozen
class Step:
    """One piece of work; `reason` says why it runs or why it is skipped."""

    term: Term
    work: str
    runs: bool
    reason: str


def _first(*cases: tuple[bool, str]) -> str | None:
    """The reason of the first case that holds."""
    return next((reason for holds, reason in cases if holds), None)


def skipped(scene: Scene, term: Term) -> str | None:
    """Why a term is zero everywhere, or None where it has to be rendered."""
    surfaces = [thing.surface for thing in scene.objects]
    diffuse = any(any(scene.diffuse_weight(surface)) for surface in surfaces)
    glossy = any(scene.specular_weight(surface) for surface in surfaces)
    if term == "ambient":
        return _first(
            (not any(scene.ambient.color), "the ambient light is black"),
            (not diffuse, "no surface has color (1 - gloss) > 0"),
        )
    if term == "direct":
        return _first(
            (not scene.toggles.lighting, "lighting is off"),
            (not scene.has_lights, "the scene has no light"),
            (not diffuse, "no surface has color (1 - gloss) > 0"),
        )
    if term == "specular":
        return _first(
            (not scene.toggles.reflections, "reflections are off"),
            (not glossy, "no surface has gloss > 0"),
            (scene.max_bounces == 0, "max_bounces is 0"),
        )
    return _first(
        (
            scene.sky.is_black and not (scene.draw_lights and scene.has_lights),
            "the sky is black and lights are not drawn",
        )
    )


def check(scene: Scene, variant: Variant, *, chain: Chain = "next-event") -> None:
    """Refuse an option that the variant would ignore.

    Raises
    ------
    ValueError
        The message names the field, its value and what is allowed.
    """
    scattering = scene.photons.scattering
    if scattering == "full" and scene.shadows == "paper":
        raise ValueError(
            f"{scene.name}: photons.scattering = 'full': allowed is 'diffuse' with shadows = 'paper'"
        )
    if scattering not in variant.scatterings:
        allowed = " or ".join(map(repr, variant.scatterings))
        raise ValueError(
            f"{scene.name}: photons.scattering = {scattering!r}: allowed is {allowed} for {variant.term} "
            f"{variant.name}"
        )
    # Radiance that leaves a back as if it were the front has no flux that photons could carry.
    if scene.normals == "face" and variant.photons(scene, chain):
        raise ValueError(
            f"{scene.name}: normals = 'face': allowed is 'viewer' for {variant.term} {variant.name}, which needs "
            "photons (without: scope = 'first-hit', or direct path)"
        )


def needs_photons(scene: Scene, variant: Variant, chain: Chain) -> Stored | None:
    """Which photons the maps of a variant hold; None where no map is needed."""
    return variant.photons(scene, chain) if skipped(scene, "direct") is None else None


def plan(scene: Scene, variants: dict[Term, Variant], *, chain: Chain = "next-event") -> tuple[Step, ...]:
    """The steps of rendering `scene` with the given variants."""
    steps = []
    for term in TERMS:
        reason = skipped(scene, term)
        variant = variants[term]
        steps.append(
            Step(term, f"kernel {variant.name}", reason is None, reason or "the scene has this term")
        )
        if term == "ambient":
            off = reason or (None if scene.occlusion_range else "ambient occlusion is off: L_a0 everywhere")
            steps.append(Step(term, "occlusion rays", off is None, off or "one a sample"))
        if variant.photons(scene, chain) or term == "direct":
            kept = needs_photons(scene, variant, chain)
            why = f"{scene.photons.count} photons a pass, {kept} kept"
            off = reason or skipped(scene, "direct") or "the scope is first-hit, or the estimator is a path"
            steps.append(Step(term, "photon maps", kept is not None and reason is None, why if kept else off))
    return tuple(steps)
