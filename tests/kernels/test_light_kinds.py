"""Spot, directional light, sun and sphere: what each sends to a surface, and that its photons carry just that.

Rationale: irradiance has a closed form, or is a quadrature over the light that shares no code with the sampler. Power
and photons are held against the integral of that irradiance, by points of a lattice, which is a sum that converges.
"""

import math
from typing import Any

import attrs
import numpy as np
import pytest
from scipy import integrate, stats

from termwise import renderer
from termwise.renderer import spheres
from termwise.renderer.arrays import from_scene
from termwise.renderer.lights import directional, emitters_of, sample_light, sphere, spot, sun
from termwise.renderer.plan import needs_every_pixel
from termwise.renderer.surface import Surface
from termwise.renderer.vector import Vec3
from termwise.scenes.analytic import plate
from termwise.scenes.load import library, load
from termwise.scenes.model import (
    Ambient,
    Camera,
    DirectionalLight,
    Material,
    Scene,
    Sky,
    SphereLight,
    SpotLight,
    SunLight,
    Vector,
)
from tests.scenes import of_every_kind

FLOOR = plate("floor", (-3.0, -3.0, 0.0), (6.0, 0.0, 0.0), (0.0, 6.0, 0.0), Material((0.5, 0.5, 0.5)))
SPOT = SpotLight((0.5, 0.25, 2.0), (0.25, 0.0, 0.0), (3.0, 2.0, 1.0), cutoff=35.0, beam=15.0)
DIRECTIONAL = DirectionalLight((0.2, 0.1, -0.5), (3.0, 2.0, 1.0))
SUN = SunLight((0.2, 0.1, -0.5), (3.0, 2.0, 1.0), angle=40.0)
SPHERE = SphereLight((0.5, 0.25, 1.5), 0.5, (3.0, 2.0, 1.0))
KINDS = {"spot": (SPOT, spot), "directional": (DIRECTIONAL, directional), "sun": (SUN, sun), "sphere": (SPHERE, sphere)}


def lit_by(*lights: Any, **changes: Any) -> Scene:
    camera = Camera((0.0, -4.0, 3.0), (0.0, 0.0, 0.0), fov=20.0)
    scene = Scene("lit", camera, (FLOOR,), of_every_kind(*lights), resolution=(2, 2), scope="first-hit")
    return attrs.evolve(scene, **changes)


def at(x: float, y: float, normal: Vector = (0.0, 0.0, 1.0)) -> Surface:
    return Surface(Vec3(x, y, 0.0), Vec3(*normal), Vec3(*normal), 0, 0, 1.0, 0.0, 0.0)


def lattice(side: int, dimensions: int) -> np.ndarray:
    """Points of the unit cube, evenly spread, (side², dimensions)."""
    return stats.qmc.Halton(dimensions, rng=1).random(side * side)


def irradiance(scene: Scene, surface: Surface, points: np.ndarray) -> np.ndarray:
    """Mean of E over samples, (3,)."""
    arrays = from_scene(scene)
    return math.pi * np.mean(np.array([sample_light(arrays, surface, u, v)[0] for u, v in points]), axis=0)


def by_spot(light: SpotLight, point: np.ndarray) -> np.ndarray:
    """E on the floor, (..., 3): I cos / d², times the falloff."""
    way = point - np.array(light.position)
    distance = np.linalg.norm(way, axis=-1)
    axis = np.subtract(light.target, light.position)
    angle = np.degrees(np.arccos(way @ axis / (distance * np.linalg.norm(axis))))
    assert light.beam is not None
    share = np.clip((light.cutoff - angle) / (light.cutoff - light.beam), 0.0, 1.0)
    return (share * -way[..., 2] / distance**3)[..., None] * np.array(light.intensity)


@pytest.mark.plain
def test_spot_falls_off_linearly_in_the_angle():
    """In the beam, on the slope, and beyond the cutoff."""
    points = np.array([[0.3, 0.0, 0.0], [1.1, 0.6, 0.0], [-0.5, -0.4, 0.0], [2.4, 0.0, 0.0]])
    expected = by_spot(SPOT, points)
    shares = expected / by_spot(attrs.evolve(SPOT, cutoff=90.0, beam=89.0), points)
    assert shares[0] == pytest.approx(1.0)
    assert ((shares[1:3] > 0.1) & (shares[1:3] < 0.9)).all()
    assert not shares[3].any()
    for (x, y, _), e in zip(points.tolist(), expected, strict=True):
        np.testing.assert_allclose(irradiance(lit_by(SPOT), at(x, y), np.array([[0.5, 0.5]])), e, rtol=1e-12)


@pytest.mark.plain
@pytest.mark.parametrize(("beam", "cutoff"), [(15.0, 35.0), (0.0, 90.0), (30.0, 30.0), (29.999999, 30.0), (0.0, 0.01)])
def test_power_of_a_spot(beam: float, cutoff: float):
    """`∫ I(t) 2 pi sin t dt`, and the mean of the photons."""
    light = attrs.evolve(SPOT, beam=beam, cutoff=cutoff)
    b, c = math.radians(beam), math.radians(cutoff)

    def radiated(t: float) -> float:
        return (1.0 if t <= b else (c - t) / (c - b)) * math.sin(t)

    integral = sum(integrate.quad(radiated, *ends, epsabs=0.0)[0] for ends in ((0.0, b), (b, c)) if ends[0] < ends[1])
    emitters = emitters_of(lit_by(light))
    assert emitters.spots is not None
    assert spot.power(emitters.spots, False)[0] == pytest.approx(2.0 * 2.0 * math.pi * integral, rel=1e-8)
    arrays = from_scene(lit_by(light))
    u = (np.arange(400) + 0.5) / 400
    flux = np.mean(np.array([spot.emit(arrays, 0, 1.0, False, (0.5, 0.5), (each, 0.3))[2] for each in u]), axis=0)
    assert flux.mean() == pytest.approx(2.0 * 2.0 * math.pi * integral, rel=1e-4)


def by_quadrature(radiance: Vector, middle: np.ndarray, half_angle: float, normal: np.ndarray) -> np.ndarray:
    """`L ∫ max(0, n·w) dw` over a cone about a unit vector, by its rings: a Riemann sum, (3,)."""
    steps = 2000
    angle = (np.arange(steps) + 0.5) / steps * half_angle
    azimuth = (np.arange(steps) + 0.5) / steps * 2.0 * math.pi
    aside = np.linalg.svd(middle[None])[2][1:]
    across = np.cos(azimuth)[:, None] * aside[0] + np.sin(azimuth)[:, None] * aside[1]
    cosine = np.cos(angle)[:, None] * (middle @ normal) + np.sin(angle)[:, None] * (across @ normal)
    rings = np.maximum(cosine, 0.0).mean(axis=1) * 2.0 * math.pi * np.sin(angle)
    return np.array(radiance) * rings.sum() * half_angle / steps


@pytest.mark.plain
@pytest.mark.parametrize("angle", [1e-3, 0.533, 40.0, 120.0])
def test_all_of_a_sun_is_its_irradiance_times_the_cosine(angle: float):
    """`L pi sin² a cos t`: a disc's projection, however wide it is; facing it, `irradiance`."""
    points = lattice(24, 2)
    light = attrs.evolve(SUN, angle=angle)
    for normal in (-np.array(light.way), np.array([0.0, 0.0, 1.0])):
        cosine = float(-np.array(light.way) @ normal)
        if math.acos(min(cosine, 1.0)) + light.half_angle < math.pi / 2:
            found = irradiance(lit_by(light), at(0.0, 0.0, tuple(normal.tolist())), points)
            np.testing.assert_allclose(found, cosine * np.array(light.irradiance), rtol=5e-3)


@pytest.mark.plain
@pytest.mark.parametrize("height", [-15.0, -5.0, 0.0, 10.0])
def test_a_sun_on_the_horizon(height: float):
    """Partly below: by quadrature. `bound` is 0 where all of it is, and only there."""
    slope = math.radians(height)
    light = attrs.evolve(SUN, direction=(math.cos(slope), 0.0, -math.sin(slope)))
    scene = lit_by(light)
    expected = by_quadrature(light.radiance, -np.array(light.way), light.half_angle, np.array([0.0, 0.0, 1.0]))
    assert expected.all()
    found = irradiance(scene, at(0.0, 0.0), lattice(40, 2))
    np.testing.assert_allclose(found, expected, rtol=0.02, atol=1e-3)
    assert sun.bound(from_scene(scene), 0, at(0.0, 0.0)) > 0.0
    below = attrs.evolve(light, direction=(math.cos(-0.36), 0.0, -math.sin(-0.36)))  # 20.6 degrees
    assert sun.bound(from_scene(lit_by(below)), 0, at(0.0, 0.0)) == 0.0
    assert not irradiance(lit_by(below), at(0.0, 0.0), lattice(8, 2)).any()


@pytest.mark.plain
def test_a_small_sun_is_a_directional_light():
    narrow = attrs.evolve(SUN, angle=1e-3)
    theirs = irradiance(lit_by(DIRECTIONAL), at(0.0, 0.0), np.array([[0.5, 0.5]]))
    np.testing.assert_allclose(irradiance(lit_by(narrow), at(0.0, 0.0), lattice(4, 2)), theirs, rtol=1e-4)
    cosine = 0.5 / math.sqrt(0.2**2 + 0.1**2 + 0.5**2)
    np.testing.assert_allclose(theirs, cosine * np.array(DIRECTIONAL.irradiance), rtol=1e-12)


@pytest.mark.plain
@pytest.mark.parametrize("kind", KINDS)
def test_photons_land_as_irradiance(kind: str):
    """In a square of the floor lands `∫ E dA`; all of them together carry the power."""
    light, module = KINDS[kind]
    scene = lit_by(light)
    arrays = from_scene(scene)
    side, low, high = 64, -0.8, 1.2
    photons = [module.emit(arrays, 0, 1.0, False, (a, b), (c, d)) for a, b, c, d in lattice(side, 4)]
    origin, way, flux = (np.array([photon[i] for photon in photons]) for i in range(3))
    place = origin - (origin[:, 2] / way[:, 2])[:, None] * way
    landed = (way[:, 2] < 0) & ((place[:, :2] > low) & (place[:, :2] < high)).all(axis=1)
    x = low + (np.arange(200) + 0.5) / 200 * (high - low)
    points = np.stack([*np.meshgrid(x, x), np.zeros((200, 200))], axis=-1)
    if isinstance(light, SpotLight):
        mean = by_spot(light, points).mean(axis=(0, 1))
    elif isinstance(light, SphereLight):
        mean = by_sphere(light, points).mean(axis=(0, 1))
    else:
        mean = np.array(light.irradiance) * -light.way[2]
    np.testing.assert_allclose(flux[landed].sum(axis=0) / len(photons), mean * (high - low) ** 2, rtol=0.03)
    power = module.power(getattr(arrays.emitters, f"{kind}s"), False)
    assert flux.mean() == pytest.approx(power[0], rel=0.02)


@pytest.mark.rare
def test_distant_light_is_hidden_across_the_scene():
    """By a screen at the other end of it, and not by one that lies behind the point."""
    far = plate("far", (40.0, -9.0, 20.0), (0.0, 18.0, 0.0), (0.0, 0.0, 30.0))
    light = DirectionalLight((-1.0, 0.0, -0.75), (1.0, 1.0, 1.0))
    open_, hidden = (
        renderer.render(lit_by(each, objects=(FLOOR, far)), "direct", samples=1).mean
        for each in (attrs.evolve(light, direction=(1.0, 0.0, -0.75)), light)
    )
    np.testing.assert_allclose(open_, 0.5 / math.pi * 0.6, rtol=1e-12)
    assert not hidden.any()


@pytest.mark.slow
def test_a_drawn_sun_stands_before_the_sky():
    """Its radiance is added within half its diameter alone; the pixels beside all objects are not skipped."""
    light = SunLight((0.0, -1.0, 0.0), (1.0, 0.5, 0.25), angle=20.0)
    sky = (0.25, 0.25, 0.5)
    for angle, shown in ((0.0, True), (9.9, True), (10.1, False), (180.0, False)):
        target = (0.0, math.cos(math.radians(angle)), math.sin(math.radians(angle)))
        camera = Camera((0.0, 0.0, 1.0), (target[0], target[1], 1.0 + target[2]), fov=0.01)
        scene = lit_by(light, camera=camera, sky=Sky(sky), draw_lights=True)
        expected = np.array(sky) + (np.array(light.radiance) if shown else 0.0)
        np.testing.assert_allclose(
            renderer.render(scene, "background", samples=1).mean, np.broadcast_to(expected, (2, 2, 3))
        )
        assert needs_every_pixel(scene, "background")
        hidden = attrs.evolve(scene, draw_lights=False)
        np.testing.assert_allclose(
            renderer.render(hidden, "background", samples=1).mean, np.broadcast_to(sky, (2, 2, 3))
        )
        assert not needs_every_pixel(hidden, "background")


def test_the_paper_scenes_have_nothing_of_it():
    """What is None is left out of the kernels of a scene: its branches are not compiled."""
    for name in library():
        arrays = from_scene(load(name))
        found = *arrays.emitters[-4:], arrays.geometry.spheres
        assert len([each for each in found if each is not None]) == (5 if name == "lights" else 0)
    lights = load("lights")
    dark = from_scene(attrs.evolve(lights, toggles=attrs.evolve(lights.toggles, lighting=False)))
    assert all(each is None for each in dark.emitters[-4:])
    assert dark.geometry.spheres is not None


# Spheres.


def by_sphere(light: SphereLight, point: np.ndarray) -> np.ndarray:
    """E on the floor, (..., 3): pi L sin² a cos t, all of the sphere above it."""
    way = np.array(light.center) - point
    distance = np.linalg.norm(way, axis=-1)
    return (math.pi * light.radius**2 * way[..., 2] / distance**3)[..., None] * np.array(light.radiance)


@pytest.mark.plain
@pytest.mark.parametrize("place", [(0.5, 0.25), (1.5, -1.0), (-2.5, 2.0)])
def test_a_sphere_above_the_horizon(place: tuple[float, float]):
    points = lattice(32, 2)
    expected = by_sphere(SPHERE, np.array([*place, 0.0]))
    np.testing.assert_allclose(irradiance(lit_by(SPHERE), at(*place), points), expected, rtol=5e-3)


@pytest.mark.plain
@pytest.mark.parametrize("height", [-0.4, 0.0, 0.3, 0.6])
def test_a_sphere_on_the_horizon(height: float):
    """Partly below: by quadrature over the cone; `bound` is 0 where all of it is, and only there."""
    light = SphereLight((1.0, 0.0, height), 0.5, (3.0, 2.0, 1.0))
    center = np.array(light.center)
    distance = float(np.linalg.norm(center))
    normal = np.array([0.0, 0.0, 1.0])
    expected = by_quadrature(light.radiance, center / distance, math.asin(light.radius / distance), normal)
    found = irradiance(lit_by(light), at(0.0, 0.0), lattice(40, 2))
    np.testing.assert_allclose(found, expected, rtol=0.02, atol=1e-3)
    assert sphere.bound(from_scene(lit_by(light)), 0, at(0.0, 0.0)) > 0.0
    below = from_scene(lit_by(attrs.evolve(light, center=(1.0, 0.0, -0.51))))
    assert sphere.bound(below, 0, at(0.0, 0.0)) == 0.0


@pytest.mark.plain
def test_inside_a_sphere_it_is_dark():
    """Its outside shines; the floor within it sees its back, as that of any lamp."""
    scene = lit_by(attrs.evolve(SPHERE, center=(0.0, 0.0, 0.0)))
    assert not irradiance(scene, at(0.1, 0.1), lattice(8, 2)).any()
    assert sphere.bound(from_scene(scene), 0, at(0.1, 0.1)) == 0.0


@pytest.mark.plain
@pytest.mark.parametrize("radius", [1e-6, 0.1, 0.9, 1.0 - 1e-9])
def test_density_of_a_sphere_is_that_of_its_cone(radius: float):
    """1 over its solid angle; the samples are points of the near side, within the cone."""
    light = SphereLight((0.0, 0.0, 1.0), radius, (1.0, 1.0, 1.0))
    arrays = from_scene(lit_by(light))
    surface = at(0.0, 0.0)
    for u, v in lattice(6, 2):
        _, way, face = sample_light(arrays, surface, u, v)
        assert np.linalg.norm(np.subtract(way, light.center)) == pytest.approx(radius, rel=1e-6)
        assert way[2] / np.linalg.norm(way) >= math.sqrt(1.0 - radius**2) - 1e-12
        solid_angle = 4.0 * math.pi * math.sin(0.5 * math.asin(radius)) ** 2
        assert sphere.density(arrays, 0, surface, way, face) == pytest.approx(1.0 / solid_angle, rel=1e-6)


@pytest.mark.plain
def test_rays_meet_a_sphere_where_it_is():
    """Against the quadratic in long doubles: random rays, from outside, from inside and from far away."""
    rng = np.random.default_rng(1)
    balls = spheres.Spheres(np.array([[0.5, -0.25, 2.0]]), np.array([0.75]), 10)
    met = 0
    for distance in (0.5, 3.0, 1e4):
        for _ in range(200):
            origin = balls.center[0] + distance * rng.normal(size=3)
            aim = balls.center[0] + rng.normal(size=3) * 0.5
            direction = (aim - origin) * rng.uniform(0.1, 3.0)
            found = spheres.distance_to(balls, 0, Vec3(*origin.tolist()), Vec3(*direction.tolist()))
            o, d = (np.array(each, np.longdouble) for each in (origin - balls.center[0], direction))
            a, b, c = d @ d, 2 * (o @ d), o @ o - np.longdouble(0.75) ** 2
            square = b * b - 4 * a * c
            roots = sorted(((-b - np.sqrt(square)) / (2 * a), (-b + np.sqrt(square)) / (2 * a))) if square >= 0 else []
            right = next((float(root) for root in roots if root > 0), math.inf)
            met += right < math.inf
            if abs(square) > 1e-9 * b * b:  # else it only touches
                assert found == pytest.approx(right, rel=1e-9)
    assert met > 300


@pytest.mark.slow
def test_a_sphere_hides_ambient_light(compiled):
    """AO under it is `1 - sin² a cos t`, whether it shines or not: to the byte."""
    light = attrs.evolve(SPHERE, center=(0.0, 0.0, 1.0))
    camera = Camera((0.0, -3.0, 0.5), (0.0, 0.0, 0.0), fov=0.01)
    scene = lit_by(light, camera=camera, ambient=Ambient((1.0, 1.0, 1.0)))
    samples = 4096 if compiled else 128
    found = renderer.render(scene, "ambient", samples=samples, seed=1).mean
    np.testing.assert_allclose(found.mean(), 0.5 * (1.0 - 0.25), rtol=0.002 if compiled else 0.05)
    off = attrs.evolve(scene, toggles=attrs.evolve(scene.toggles, lighting=False))
    assert renderer.render(off, "ambient", samples=samples, seed=1).mean.tobytes() == found.tobytes()


@pytest.mark.slow
def test_a_sphere_is_in_the_way():
    """Of the camera, of the sky, and of another light's; it is drawn where lights are."""
    above = DirectionalLight((0.0, 0.0, -1.0), (1.0, 1.0, 1.0))
    ball = SphereLight((0.0, 0.0, 1.0), 0.5, (0.0, 0.0, 0.0))
    under, beside = (lit_by(ball, above, camera=Camera((x, -3.0, 0.4), (x, 0.0, 0.0), fov=0.01)) for x in (0.0, 2.0))
    assert not renderer.render(under, "direct", samples=1).mean.any()
    np.testing.assert_allclose(renderer.render(beside, "direct", samples=1).mean, 0.5 / math.pi)
    shining = attrs.evolve(ball, radiance=(3.0, 2.0, 1.0))
    camera = Camera((0.0, -3.0, 1.0), (0.0, 0.0, 1.0), fov=0.01)
    for drawn, expected in ((True, (3.0, 2.0, 1.0)), (False, (0.0, 0.0, 0.0))):
        scene = lit_by(shining, camera=camera, sky=Sky((0.25, 0.25, 0.5)), draw_lights=drawn)
        np.testing.assert_array_equal(
            renderer.render(scene, "background", samples=1).mean, np.broadcast_to(expected, (2, 2, 3))
        )
        assert not renderer.render(scene, "ambient", samples=1).mean.any()


@pytest.mark.plain
def test_the_papers_shadow_asks_for_the_center_of_a_sphere():
    """Seen through its own surface; a plate between hides it, though not all of the sphere."""
    shield = plate("shield", (-0.05, -0.05, 0.3), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0))
    light = SphereLight((0.0, 0.0, 1.5), 0.5, (1.0, 1.0, 1.0))
    camera = Camera((0.0, -3.0, 0.1), (0.0, 0.0, 0.0), fov=0.01)
    for objects, dark in (((FLOOR,), False), ((FLOOR, shield), True)):
        scene = lit_by(light, camera=camera, objects=objects, lights=(light,), shadows="paper")
        assert renderer.render(scene, "direct", samples=16).mean.any() != dark
        if dark:
            plain = attrs.evolve(scene, shadows="physical")
            assert renderer.render(plain, "direct", samples=64).mean.any()
