"""Photon kernels at several radii: the relative error of their mean extrapolated to radius 0, whole and in parts."""

from collections.abc import Callable
from typing import Any

import attrs
import numpy as np

from termwise.renderer import photon_map
from termwise.renderer.engine import Engine
from termwise.renderer.plan import skipped
from termwise.renderer.terms import Variant
from termwise.reports.jobs.cells import Cell
from termwise.reports.jobs.desk import Measured
from termwise.reports.statistics.convergence import extrapolate, relative_error
from termwise.reports.statistics.jackknife import Estimate
from termwise.reports.study import kernel_bias
from termwise.reports.study.study import Study
from termwise.reports.study.subjects import Subject


def of_radius(subject: Subject) -> list[Variant]:
    """The right direct estimators of a scene whose photon kernel has a radius."""
    if subject.setting is not None or skipped(subject.scene, "direct"):
        return []
    kernels = {variant: variant.kernel(subject.scene, 1) for variant in subject.variants["direct"]}
    return [variant for variant, kernel in kernels.items() if kernel and kernel.shape != "nearest"]


def asked(study: Study, subject: Subject, variant: Variant) -> list[Measured]:
    """A variant at each of the study's radii."""
    scene, samples = subject.scene, study.samples_of(variant)
    photons = (attrs.evolve(scene.photons, radius=factor * scene.photons.radius) for factor in study.radii)
    return [
        Measured(attrs.evolve(scene, photons=each), variant, variant.limit(scene, samples), samples, subject.chain)
        for each in photons
    ]


def extrapolations(
    study: Study, subject: Subject, correct: np.ndarray, take: Callable[[Measured], Cell]
) -> list[dict[str, Any]]:
    """Relative error against the true integral, whole and in parts, at the study's radii and at 0.

    Parameters
    ----------
    correct : (R, H, W, 3), replicates of the true integral.
    take : reads a cell.
    """
    variants = of_radius(subject) if study.radii else []
    if not variants:
        return []
    scene = subject.scene
    with Engine(scene) as engine:
        seen, geometry = engine.geometry(), engine.arrays.geometry
    points = kernel_bias.points(scene, seen)
    found = []
    for variant in variants:
        radii, errors, by_class, pixels = [], [], [], []
        for each in asked(study, subject, variant):
            radius = photon_map.mean_radius(each.scene.photons.radius, each.samples)
            images = take(each).images[:, -1]
            classes = kernel_bias.classify(geometry, seen.face, points, radius)
            radii.append(radius)
            errors.append(relative_error(images, correct))
            by_class.append(kernel_bias.shares(images, correct, classes))
            pixels.append(kernel_bias.pixels(classes))
        found.append(
            {
                "scene": scene.name,
                "variant": variant.name,
                "label": kernel_bias.label(by_class[int(np.argmax(radii))]),
                "points": _points(radii, errors, by_class, pixels),
            }
        )
    return found


def _points(
    radii: list[float], errors: list[Estimate], by_class: list[dict], pixels: list[dict]
) -> list[dict[str, Any]]:
    """What is measured at each radius, and what it tends to."""
    at_zero = {name: extrapolate(radii, [each[name] for each in by_class]) for name in kernel_bias.CLASSES}
    points = zip(
        (*radii, 0.0),
        (*errors, extrapolate(radii, errors)),
        (*by_class, at_zero),
        (*pixels, dict.fromkeys(kernel_bias.CLASSES)),
        strict=True,
    )
    return [
        {
            "radius": radius,
            **_interval(error),
            "classes": {name: {"pixels": shown[name], **_interval(part)} for name, part in parts.items()},
        }
        for radius, error, parts, shown in points
    ]


def _interval(error: Estimate) -> dict[str, float]:
    """A number with its 90 % interval."""
    return {
        "error": error.value,
        "low": error.low(0.05),
        "high": error.high(0.05),
        "standard_error": error.standard_error,
    }
