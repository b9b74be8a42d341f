"""The bias of a photon kernel, class by class, where it is known."""

import numpy as np
import pytest

from termwise.renderer import render
from termwise.renderer.engine import Engine
from termwise.reports.statistics.convergence import relative_error
from termwise.reports.study import kernel_bias
from termwise.scenes.analytic import plate
from termwise.scenes.model import Camera, Photons, PointLight, Scene


def test_the_interior_has_the_bias_of_the_laplacian():
    """A lamp above a floor: `E = h (h² + rho²)^(-3/2)`, and Simpson's kernel is off by `r² ΔE / 16` up to O(r⁴).

    `ΔE = h (9 rho² - 6 h²) (h² + rho²)^(-7/2)`. Half of the picture's pixels lie nearer to the floor's end than r.
    """
    r, h = 0.25, 1.0
    scene = Scene(
        "lamp over floor",
        Camera((0.0, -0.3, 2.2), (0.0, 0.0, 0.0), fov=50.0, pixel="centre"),
        (plate("floor", (-1.0, -1.0, 0.0), (2.0, 0.0, 0.0), (0.0, 2.0, 0.0)),),
        lights=(PointLight((0.0, 0.0, h), (1.0, 1.0, 1.0)),),
        photons=Photons(count=100_000, radius=r),
        resolution=(24, 24),
    )
    with Engine(scene) as engine:
        seen = engine.geometry()
        points = kernel_bias.points(scene, seen)
        classes = kernel_bias.classify(engine.arrays.geometry, seen.face, points, r)
    on_floor = seen.face >= 0
    assert on_floor.mean() > 0.8
    np.testing.assert_allclose(points[on_floor][:, 2], 0.0, atol=1e-6)
    # A floor alone: the class is known from the point.
    ends = 1.0 - np.abs(points[..., :2]).max(axis=-1)
    expected = np.where(ends < r, kernel_bias.CLASSES.index("boundary"), kernel_bias.CLASSES.index("interior"))
    np.testing.assert_array_equal(classes, np.where(on_floor, expected, kernel_bias.UNSEEN))

    square = (points[..., :2] ** 2).sum(axis=-1)
    irradiance = np.where(on_floor, h * (h * h + square) ** -1.5, 0.0)
    laplacian = h * (9 * square - 6 * h * h) * (h * h + square) ** -3.5
    truth = np.repeat(irradiance[None, ..., None] * np.ones(3), 2, axis=0)
    ours = np.stack([render(scene, "direct", variant="photon-map", samples=1, seed=seed).mean for seed in range(16)])
    weight = np.array(scene.diffuse_weight(scene.objects[0].material)) / np.pi
    found = kernel_bias.shares(ours / weight, truth, classes)
    interior = classes == kernel_bias.CLASSES.index("interior")
    predicted = (r * r / 16 * laplacian)[interior].sum() / irradiance.sum()
    error = found["interior"].standard_error
    assert abs(found["interior"].value - predicted) < 4.5 * error + 0.1 * abs(predicted)
    assert abs(predicted) > 9 * error, "the noise would hide it"
    assert found["leak"].value == 0.0
    whole = relative_error(ours / weight, truth)
    assert sum(each.value for each in found.values()) == pytest.approx(whole.value, abs=1e-9)
