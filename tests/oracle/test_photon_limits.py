"""What photon estimates converge to: the fall of their error, radius 0, and full light transport by Mitsuba.

Rationale: a kernel estimate is biased at any radius, so its limit is reached by extrapolation, or within a bias that
is known; and photons that scatter on the full BSDF must add up to what another program finds.
"""

import attrs
import numpy as np
import pytest
import trimesh

from termwise import reference
from termwise.reference import backend, density
from termwise.renderer import render
from termwise.renderer.arrays import from_scene
from termwise.renderer.photon_density import estimate_irradiance
from termwise.renderer.photon_map import build, progressive_radius
from termwise.renderer.scratch import new_scratch
from termwise.renderer.surface import Surface
from termwise.renderer.vector import Vec3
from termwise.reports.statistics.convergence import extrapolate
from termwise.reports.statistics.jackknife import Estimate
from termwise.scenes import limits
from termwise.scenes.analytic import plate, unit_sphere
from termwise.scenes.load import load
from termwise.scenes.model import Camera, Material, Mesh, Object, Photons, PointLight, Scene

SCRATCH = new_scratch()
UP = Vec3(0.0, 0.0, 1.0)


# E = 1 + A ρ² on the unit plate, ρ the distance from CENTRE: Laplacian 4 A.
A = 8.0
CENTRE = np.array([0.5, 0.45])
FLUX = 1 + A * (2 / 12 + 0.05**2)


def quadratic_photons(rng: np.random.Generator, count: int) -> np.ndarray:
    """Photons of density E, (count, 2), by rejection."""
    kept = np.empty((0, 2))
    while len(kept) < count:
        xy = rng.uniform(size=(8 * count, 2))
        density = 1 + A * ((xy - CENTRE) ** 2).sum(axis=1)
        kept = np.concatenate([kept, xy[rng.uniform(size=len(xy)) * (1 + A) < density]])
    return kept[:count]


def at_centre(scene, xy: np.ndarray, radius: float) -> float:
    """The Simpson estimate of E at CENTRE, where E is 1."""
    position = np.column_stack([xy, np.zeros(len(xy))])
    face = np.where(xy[:, 0] >= xy[:, 1], 0, 1).astype(np.int32)
    photons = build(position, np.tile(UP, (len(xy), 1)), np.full((len(xy), 3), FLUX / len(xy)), face, radius)
    point = Surface(Vec3(float(CENTRE[0]), float(CENTRE[1]), 0.0), UP, UP, 0, 0, 1.0, 0.0, 0.0)
    return estimate_irradiance(scene, photons, point, SCRATCH).x


def jackknifed(values: np.ndarray) -> Estimate:
    """The mean of replicates (K,), and the means without each."""
    return Estimate(float(values.mean()), ((values.sum() - values) / (len(values) - 1),))


@pytest.fixture(scope="module")
def plane():
    scene = Scene(
        "plane",
        Camera((0.0, -3.0, 1.0), (0.0, 0.0, 0.0)),
        (plate("plate", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),),
    )
    return from_scene(scene)


def progressive_mse(passes: int, photons: int, radius: float) -> float:
    """Closed form at CENTRE: `(A mean(r_i²) / 4)² + Σ V_i / N²`, the variance V_i that of a sum of independent photons.

    `V = (FLUX ∫ K² E dA - (∫ K E dA)²) / photons`, `∫ K² dA = 9 / (5 pi r²)`, `∫ K² ρ² dA = 3 / (10 pi)`.
    """
    square = np.array([progressive_radius(radius, i) ** 2 for i in range(passes)])
    mean = 1 + A * square / 4
    variance = (FLUX * (9 / (5 * np.pi * square) + 3 * A / (10 * np.pi)) - mean**2) / photons
    return (A * square.mean() / 4) ** 2 + variance.sum() / passes**2


@pytest.mark.slow
def test_progressive_error_falls_as_the_law_says(plane):
    """Mean over 1, 8 and 64 passes of 100 photons, 300 runs: the MSE is the closed form's, which falls as N^(-2/3).

    The squares of 300 nearly normal errors have a relative deviation of sqrt(2 / 300); 4.5 of them are granted, and a
    fixed radius, or one that shrinks as that of independent samples would, is far outside.
    """
    rng = np.random.default_rng(30)
    runs, passes, radius = 300, 64, 0.4
    estimates = np.array(
        [
            [at_centre(plane, quadratic_photons(rng, 100), progressive_radius(radius, i)) for i in range(passes)]
            for _ in range(runs)
        ]
    )
    granted = 4.5 * np.sqrt(2 / runs)
    for n in (1, 8, 64):
        found = np.mean((estimates[:, :n].mean(axis=1) - 1) ** 2)
        assert found == pytest.approx(progressive_mse(n, 100, radius), rel=granted)
    fixed = (A * radius**2 / 4) ** 2
    assert progressive_mse(64, 100, radius) * (1 + granted) < fixed
    slope = np.log(progressive_mse(2048, 100, radius) / progressive_mse(256, 100, radius)) / np.log(8)
    assert slope == pytest.approx(-2 / 3, abs=0.03)


def test_extrapolation_of_a_quadratic_irradiance(plane):
    """Radii .2, .3, .4 over the same photons: each is too bright by r² ΔE / 16, their extrapolation is 1."""
    rng = np.random.default_rng(31)
    radii = (0.2, 0.3, 0.4)
    values = []
    for _ in range(400):
        xy = quadratic_photons(rng, 400)
        values.append([at_centre(plane, xy, r) for r in radii])
    estimates = [jackknifed(column) for column in np.transpose(values)]
    for r, estimate in zip(radii, estimates, strict=True):
        assert abs(estimate.value - (1 + A * r * r / 4)) < 4.5 * estimate.standard_error
    found = extrapolate(radii, estimates)
    assert abs(found.value - 1) < 4.5 * found.standard_error
    assert estimates[0].value - 1 > 4.5 * found.standard_error


@pytest.mark.parametrize("shape", ["uniform", "epanechnikov", "simpson"])
def test_both_sides_make_the_same_of_the_same_photons(shape):
    """Photons strewn over the monkey: E by the renderer and by the reference's density, to 1e-9, on its faces.

    The two share the definition of the surface whose photons and areas count, and no code.
    """
    scene = from_scene(load("monkey"))
    g = scene.geometry
    rng = np.random.default_rng(32)
    area = np.linalg.norm(np.cross(g.corners[:, 1] - g.corners[:, 0], g.corners[:, 2] - g.corners[:, 0]), axis=1)

    def strewn(count: int) -> tuple[np.ndarray, np.ndarray]:
        # As many on the small faces of the head as on the floor.
        face = rng.choice(len(area), count, p=np.sqrt(area) / np.sqrt(area).sum())
        return face, np.einsum("pc,pcx->px", rng.dirichlet((1, 1, 1), count), g.corners[face])

    face, position = strewn(4000)
    direction = rng.normal(size=position.shape)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    power = rng.uniform(size=position.shape)
    query, points = strewn(200)
    side = rng.choice([-1.0, 1.0], len(query))
    theirs = density.by_kernel(
        density.faces(g.corners, g.object),
        density.Points(points, query, side, side[:, None] * g.normals[query]),
        density.Photons(position, direction, power, face),
        shape=shape,
        radius=0.3,
    )
    photons = build(position, direction, power, face.astype(np.int32), 0.3, shape)
    for i, expected in enumerate(theirs):
        normal = Vec3(*(side[i] * g.normals[query[i]]).tolist())
        point = Vec3(*points[i].tolist())
        surface = Surface(point, normal, normal, int(query[i]), int(g.object[query[i]]), float(side[i]), 0.0, 0.0)
        found = estimate_irradiance(scene, photons, surface, SCRATCH)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * theirs.mean())
    assert (theirs > 0).any(axis=1).sum() > 50


def small_box(block: Material, *, photons: Photons) -> Scene:
    """A closed box with a block in it, which hovers, lit by a lamp below its ceiling and a point light."""
    room = trimesh.creation.box(extents=(2.0, 2.0, 2.0))
    cube = trimesh.creation.box(extents=(0.8, 0.7, 0.9))
    lamp = plate("lamp", (-0.5, -0.6, 0.95), (0.0, 0.8, 0.0), (0.7, 0.0, 0.0))
    return Scene(
        "small box",
        Camera((-0.8, -0.8, 0.5), (0.3, 0.4, -0.5), fov=90.0),
        (
            Object("room", Mesh.from_arrays(room.vertices, room.faces[:, ::-1]), Material((0.6, 0.5, 0.4))),
            Object("block", Mesh.from_arrays(cube.vertices + (0.3, 0.3, -0.4), cube.faces), block),
            attrs.evolve(lamp, emission=(10.0, 10.0, 10.0)),
        ),
        lights=(PointLight((-0.6, 0.5, 0.2), (1.0, 1.0, 1.0)),),
        photons=photons,
        resolution=(16, 16),
    )


def image_means(scene: Scene, variant: str, count: int, samples: int) -> np.ndarray:
    """Image means of independent replicates, (count, 3)."""
    return np.array(
        [
            render(scene, "direct", variant=variant, samples=samples, seed=seed).mean.mean(axis=(0, 1))
            for seed in range(count)
        ]
    )


@pytest.mark.slow
def test_extrapolation_in_a_box_agrees_with_path():
    """One pass of each radius, .3, .42 and .6: the largest is off `path` by more than the extrapolation's error."""
    scene = small_box(Material((0.5, 0.6, 0.7)), photons=Photons(count=20_000))
    radii = (0.3, 0.42, 0.6)
    estimates = []
    for radius in radii:
        photons = attrs.evolve(scene.photons, radius=radius)
        values = image_means(attrs.evolve(scene, photons=photons), "photon-map", 24, 1)
        estimates.append(jackknifed(values[:, 1]))
    found = extrapolate(radii, estimates)
    path = jackknifed(image_means(scene, "path", 16, 64)[:, 1])
    error = np.hypot(found.standard_error, path.standard_error)
    assert abs(found.value - path.value) < 4.5 * error
    assert abs(estimates[-1].value - path.value) > 4.5 * error


@pytest.fixture(scope="module")
def glossy_box() -> Scene:
    glossy = Material((0.5, 0.6, 0.7), gloss=0.7, roughness=0.3, f0=(0.9, 0.8, 0.6))
    return small_box(glossy, photons=Photons(count=20_000, radius=0.1, scattering="full"))


@pytest.fixture(scope="module")
def full_transport(glossy_box) -> np.ndarray:
    """Image means of Mitsuba's replicates, (8, 3): light that the diffuse lobe reflects, however it came."""
    limit = limits.physical("direct")
    images = [reference.replicate(glossy_box, limit, spp=64, seed=1, replicate=k) for k in range(8)]
    return np.mean(images, axis=(1, 2), dtype=float)


@pytest.mark.slow
@pytest.mark.skipif(backend.choose().variant == "scalar_rgb", reason="a million paths, one by one")
@pytest.mark.parametrize("variant", ["photon-map", "next-event", "nearest"])
def test_photons_that_scatter_fully_against_mitsuba(variant, glossy_box, full_transport):
    """A room with a glossy block: E with what the block throws agrees with Mitsuba's within noise and 0.5 %.

    The half per cent is for the kernel's bias at r = 0.1. Photons that scatter diffusely alone are over 5 % too dark.
    """
    diffuse = attrs.evolve(glossy_box, photons=attrs.evolve(glossy_box.photons, scattering="diffuse"))
    without = image_means(diffuse, variant, 4, 8).mean(axis=0)
    ours = image_means(glossy_box, variant, 8, 8)
    exact = full_transport.mean(axis=0)
    error = np.sqrt((ours.var(axis=0, ddof=1) + full_transport.var(axis=0, ddof=1)) / 8)
    assert (np.abs(ours.mean(axis=0) - exact) < 4.5 * error + 0.005 * exact).all()
    assert (4.5 * error < 0.015 * exact).all()
    assert (exact - without > 0.05 * exact).all()


@pytest.mark.parametrize(("variant", "factor"), [("paper", 10 / 9), ("nearest", 1.0)])
def test_nearest_photons_in_a_sphere(variant, factor):
    """A point light at the centre of a black-walled sphere: E = I, and `n / (k - 1)` is the mean density, exactly.

    The chord r cuts a cap of area pi r² from a sphere, so no curvature enters. It needs photons that land independently
    of each other: spread evenly, as by one low-discrepancy sequence, they would give 1.06 in place of 1.11.
    """
    scene = unit_sphere(albedo=1e-3, intensity=np.pi, subdivisions=4)
    scene = attrs.evolve(scene, photons=Photons(count=4000, nearest=10), resolution=(8, 8))
    image = render(scene, "direct", variant=variant, samples=16, replicates=16, seed=5)
    expected = factor * 1e-3  # rho E / pi
    error = np.sqrt(image.variance.mean() / 16)  # views share maps: some of the pixels are one
    assert error < 0.006 * expected
    assert image.mean.mean() == pytest.approx(expected, abs=4.5 * error + 3e-3 * expected)
