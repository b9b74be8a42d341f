"""How the error of whole renders falls, `MSE(N) ~ N^-a`, against limits in closed form.

| samples | a | published |
|---|---|---|
| independent | 1 | variance of a mean |
| Owen-scrambled Sobol, smooth f | 3, up to a logarithm | Owen, Annals of Statistics 25(4), 1997 |
| the same, a furnace's lobe that is cut at the horizon | above 1 | |
| progressive photon mapping, independent photons | 2/3 | Knaus, Zwicker, TOG 30(3), 2011 |

Rationale: seeds that overlap, a sequence that is no net, or radii that shrink at another rate leave the mean of a
render as it is, and its slope not.
"""

import math

import numpy as np
import pytest

from termwise.renderer import Engine, find, photon_map, photon_tracing
from termwise.renderer.rng import root
from termwise.renderer.sobol import Sampler, sample_2d
from termwise.reports.statistics.convergence import fit, mean_square_error
from termwise.reports.study import closed_forms
from termwise.scenes.analytic import furnace, plate
from termwise.scenes.limits import correct
from termwise.scenes.model import Camera, Material, Photons, PointLight, Scene


def prefixes(scene: Scene, term: str, variant: str, samples: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """N = 1, 2, 4, ... `samples`, and the images (P, K, H, W, 3) of `count` replicates after each."""
    images, counts = [], []
    with Engine(scene, threads=1) as engine:
        for number in range(count):
            steps = list(engine.prefixes(find(term, variant), samples=samples, seed=1, replicate=number))
            counts = [n for n, _, _ in steps]
            images.append([image for _, image, _ in steps])
    return np.array(counts), np.moveaxis(np.array(images), 1, 0)


def slope(counts: np.ndarray, errors: np.ndarray) -> float:
    """-a of a straight line through the logarithms."""
    return float(np.polyfit(np.log(counts), np.log(errors), 1)[0])


@pytest.fixture(scope="module")
def lobe() -> tuple[Scene, np.ndarray]:
    """A furnace and its image."""
    scene = furnace(roughness=0.3, mu_o=0.7)
    value = closed_forms.albedo(correct("specular", "all"), scene.objects[0].material, 0.7)
    return scene, np.broadcast_to(value, (1, 8, 8, 3))


def test_independent_replicates(lobe):
    """Means over n replicates of one sample each, n = 1 ... 32: a = 1.

    1024 replicates of 64 pixels make 2048 independent means of 32: their mean square has a relative deviation of
    sqrt(2 / 2048) = 0.03, the slope one of 0.03 / ln 32 = 0.01; 4.5 of them are granted, and replicates of which
    every second repeats its neighbour are outside.
    """
    scene, exact = lobe
    with Engine(scene, threads=1) as engine:
        images = np.array(
            [next(iter(engine.prefixes(find("specular"), samples=1, seed=3, replicate=k)))[1] for k in range(1024)]
        )

    def errors(images: np.ndarray) -> np.ndarray:
        groups = [images.reshape(-1, n, *images.shape[1:]).mean(axis=1) for n in counts]
        return np.array([np.mean((group - exact) ** 2) for group in groups])

    counts = 2 ** np.arange(6)
    granted = 4.5 * 0.01
    assert slope(counts, errors(images)) == pytest.approx(-1, abs=granted)
    assert slope(counts, errors(np.repeat(images[:512], 2, axis=0))) > -1 + granted


def test_owen_scrambled_points_of_a_smooth_function():
    """∫ sin(pi u) v² = 2 / (3 pi) by the renderer's points, 200 seeds: a = 3 up to a logarithm, so above 2.5.

    Independent points of the same counts have 1, each to sqrt(2 / 200) / ln 64 = 0.024 of a slope.
    """
    counts, seeds = 2 ** np.arange(4, 11), 200
    index = np.arange(counts[-1], dtype=np.uint32)
    net = np.array([[sample_2d(Sampler(root(seed, 0), i), 3) for i in index] for seed in range(seeds)])
    independent = np.random.default_rng(1).uniform(size=net.shape)

    def found(points: np.ndarray) -> float:
        values = np.sin(np.pi * points[..., 0]) * points[..., 1] ** 2
        errors = [np.mean((values[:, :n].mean(axis=1) - 2 / (3 * np.pi)) ** 2) for n in counts]
        return slope(counts, np.array(errors))

    assert found(net) < -2.5
    assert found(independent) == pytest.approx(-1, abs=0.15)


def test_owen_scrambled_samples_of_a_lobe(lobe):
    """The default estimator's samples under a white sky: steeper than independent ones by any doubt of the fit."""
    scene, exact = lobe
    counts, images = prefixes(scene, "specular", "vndf", 1024, 16)
    found = fit(counts, [mean_square_error(each, exact) for each in images])
    assert found.slope is not None
    assert found.slope.value - 4.5 * found.slope.standard_error > 1.2
    assert abs(found.floor.value) < 4.5 * found.floor.standard_error + 1e-12


SIDE, HALF = 12, 1.2  # pixels, and half the width that they show


def lit_plate() -> tuple[Scene, np.ndarray]:
    """A point light at height 1 over a white plate seen from above: `E / pi = (1 + x² + y²)^(-3/2) / pi`."""
    scene = Scene(
        "lit plate",
        Camera(
            (0.0, 0.0, 3.0),
            (0.0, 0.0, 0.0),
            up=(0.0, 1.0, 0.0),
            fov=2 * math.degrees(math.atan(HALF / 3)),
            pixel="centre",
        ),
        (plate("plate", (-6.0, -6.0, 0.0), (12.0, 0.0, 0.0), (0.0, 12.1, 0.0), Material((1.0, 1.0, 1.0))),),
        lights=(PointLight((0.0, 0.0, 1.0), (1.0, 1.0, 1.0)),),
        photons=Photons(count=40, radius=0.8),
        resolution=(SIDE, SIDE),
    )
    x = ((np.arange(SIDE) + 0.5) / SIDE - 0.5) * 2 * HALF
    exact = (1 + x**2 + x[:, None] ** 2) ** -1.5 / math.pi
    return scene, np.repeat(exact[None, ..., None], 3, axis=-1)


@pytest.mark.slow
def test_progressive_photon_mapping(monkeypatch):
    """16 to 512 passes of 40 photons, bias and noise both: a = 2/3, within 0.1.

    16 replicates give the errors to some 8 % (jackknife, asserted), the slope to 0.1 / ln 32 = 0.03. The law is that of
    independent photons: the product's share a low-discrepancy sequence, which lowers every error, the early ones most.
    With the radius held, the bias stays and a falls to 0: outside.
    """
    rule = photon_tracing.Scattering
    scene, exact = lit_plate()

    def measured() -> tuple[np.ndarray, np.ndarray, float]:
        counts, images = prefixes(scene, "direct", "photon-map", 512, 16)
        errors = [mean_square_error(each, exact) for each in images[4:]]
        relative = max(error.standard_error / error.value for error in errors)
        return counts[4:], np.array([error.value for error in errors]), relative

    counts, product, _ = measured()
    monkeypatch.setattr(photon_tracing, "Scattering", lambda **of: rule(**(of | {"independent": True})))
    _, independent, relative = measured()
    assert relative < 0.12
    assert slope(counts, independent) == pytest.approx(-2 / 3, abs=0.1)
    assert (product < independent).all()
    monkeypatch.setattr(photon_map, "progressive_radius", lambda first, index: first)
    _, fixed, _ = measured()
    assert slope(counts, fixed) > -2 / 3 + 0.15
