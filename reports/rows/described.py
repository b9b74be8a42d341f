"""What results say of a scene beside its rows: settings, the plan, the work that was counted, and gains."""

import math
from typing import Any

import attrs

from termwise.renderer.plan import plan
from termwise.renderer.terms import Variant
from termwise.reports.jobs.cells import Cell
from termwise.reports.study import closed_forms
from termwise.reports.study.study import Study
from termwise.reports.study.subjects import Subject
from termwise.scenes.model import LIGHTS, PointLight
from termwise.scenes.terms import TERMS, Term


def describe(study: Study, subject: Subject, measured: list[Cell]) -> dict[str, Any]:
    """What a scene's page says of it, by names that can be read."""
    scene = subject.scene
    samples: dict[Term, int] = {term: study.samples_of(subject.variants[term][0]) for term in TERMS}
    chosen: dict[Term, Variant] = {term: subject.variants[term][0] for term in TERMS}
    return {
        "base": subject.base.name if subject.base else None,
        "setting": attrs.asdict(subject.setting) if subject.setting else None,
        "resolution": list(scene.resolution),
        "exposure": scene.exposure,
        "scope": scene.scope,
        "max_bounces": scene.max_bounces,
        "digest": scene.digest(),
        "substitutions": list(scene.substitutions),
        "objects": [thing.name for thing in scene.objects],
        "settings": {
            "triangles": sum(len(thing.mesh.faces) for thing in scene.objects),
            "ambient light": "the sky" if scene.ambient.source == "sky" else list(scene.ambient.color),
            "ambient occlusion range": scene.ambient.range if math.isfinite(scene.ambient.range) else "infinite",
            **{
                f"{kind} lights": count
                for kind in LIGHTS
                if (count := sum(light.kind == kind for light in scene.lights)) or kind == PointLight.kind
            },
            "area lights": sum(thing.emits for thing in scene.objects),
            "sky": f"texture, {scene.sky.projection}" if scene.sky.texture is not None else list(scene.sky.color),
            "pixel rule": scene.camera.pixel,
            "field of view (degrees)": scene.camera.fov,
            "photons per pass": scene.photons.count,
            "radius of the first pass": scene.photons.radius,
            "k of the paper's photon search": scene.photons.nearest,
            "rings of the paper's rule": scene.rings,
            "shadows": scene.shadows,
            "direct light read as": scene.irradiance,
            "what a ray ignores that leaves a face": f"the same {scene.ignore}",
            "normals": f"of the {scene.normals}",
            "intersection": scene.intersection,
            "lights drawn": scene.draw_lights,
            **{f"toggle {name.replace('_', ' ')}": value for name, value in attrs.asdict(scene.toggles).items()},
        },
        "gains": _gains(subject),
        "plan": [
            attrs.asdict(step) | {"samples": samples[step.term]}
            for step in plan(scene, chosen, chain=subject.chain, samples=samples)
        ],
        "work": work(measured),
    }


def work(measured: list[Cell]) -> list[dict[str, Any]]:
    """The work that was counted for each variant, in all replicates."""
    return [
        {"term": cell.variant.term, "variant": cell.variant.name, "samples": cell.samples[-1]}
        | {"replicates": len(cell.images), "kernels": list(cell.kernels), "counts": cell.counts}
        for cell in measured
    ]


def _gains(subject: Subject) -> dict[str, dict[str, float]]:
    """Q of each specular variant on each glossy object, as if all light met this object (see `closed_forms.gain`).

    Of objects of one gloss and one roughness, where an image stands in their place there is no one number; and of
    Schlick's reflectance: no variant has gains of a dielectric's.
    """
    scene = subject.scene
    glossy = [
        thing
        for thing in scene.objects
        if scene.specular_weight(thing.surface) > 0.0
        and not {"gloss", "roughness"} & {*thing.surface.textures}
        and not thing.surface.dielectric
    ]
    return {
        variant.name: {thing.name: closed_forms.gain(variant.limit(scene, 1), thing.surface) for thing in glossy}
        for variant in subject.variants["specular"]
    }
