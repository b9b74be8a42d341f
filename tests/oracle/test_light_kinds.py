"""Spot, directional light and sun in Mitsuba: its own plugins, closed forms, and the renderer against them.

Rationale: the reference of a distant light is a plugin of ours. It is held against Mitsuba's `directional`, and against
a far disc of its `area` lights, which share nothing with it; photons of all kinds against the irradiance that they
are to make.
"""

import math
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest

from termwise import reference
from termwise.reference import translate
from termwise.reference.translate import Canonical
from termwise.renderer import Engine, find
from termwise.renderer.lights import KINDS, emitters_of
from termwise.reports.study import geometry_audit
from termwise.scenes.analytic import plate
from termwise.scenes.limits import Kernel, Limit, physical
from termwise.scenes.load import load
from termwise.scenes.model import (
    Ambient,
    Camera,
    DirectionalLight,
    Material,
    Photons,
    PointLight,
    Scene,
    Sky,
    SphereLight,
    SpotLight,
    SunLight,
)
from tests.scenes import box, of_every_kind

GREY = Material((0.5, 0.5, 0.5))
LIGHTS = {
    "spot": SpotLight((1.2, -0.8, 2.5), (0.1, 0.0, 0.0), (9.0, 6.0, 3.0), cutoff=35.0, beam=15.0),
    "directional": DirectionalLight((0.3, 0.2, -0.5), (3.0, 2.0, 1.0)),
    "sun": SunLight((0.3, 0.2, -0.5), (3.0, 2.0, 1.0), angle=25.0),
    "sphere": SphereLight((0.9, -0.7, 1.3), 0.4, (3.0, 2.0, 1.0)),
}


def scene_of(*lights: Any, **changes: Any) -> Scene:
    """A cube close above a floor, seen from above."""
    floor = plate("floor", (-2.0, -2.0, 0.0), (4.0, 0.0, 0.0), (0.0, 4.0, 0.0), GREY)
    camera = Camera((0.0, -3.0, 4.0), (0.0, 0.0, 0.2), fov=40.0)
    scene = Scene("kinds", camera, (floor, box("cube", (-0.5, -0.4, 0.05), 0.8)), lights, resolution=(16, 16))
    return attrs.evolve(scene, photons=Photons(count=2000, radius=0.4), **changes)


def apart(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """Of the mean images (K, H, W, 3) and (R, H, W, 3), z of each channel."""
    a, b = (images.mean(axis=(1, 2), dtype=np.float64) for images in (ours, theirs))
    error = np.sqrt(a.var(axis=0, ddof=1) / len(a) + b.var(axis=0, ddof=1) / len(b))
    return (a.mean(axis=0) - b.mean(axis=0)) / error


def images_of(scene: Scene, variant: str, samples: int) -> np.ndarray:
    scene = attrs.evolve(scene, lights=of_every_kind(*scene.lights))
    with Engine(scene) as engine:
        return np.array(
            [
                list(engine.prefixes(find("direct", variant), samples=samples, seed=1, replicate=k))[-1][1]
                for k in range(16)
            ]
        )


def theirs_of(scene: Scene, limit: Limit, spp: int) -> np.ndarray:
    return np.array([reference.replicate(scene, limit, spp=spp, seed=2, replicate=k) for k in range(16)])


@pytest.mark.slow
@pytest.mark.parametrize("kind", LIGHTS)
def test_next_event_agrees(kind: str):
    """Shadows, penumbrae and the edge of the spot in the picture; a tenth more is told apart."""
    scene = scene_of(LIGHTS[kind], scope="first-hit")
    ours, theirs = images_of(scene, "next-event", 64), theirs_of(scene, Limit("direct", scope="first-hit"), 256)
    assert (np.abs(apart(ours, theirs)) < 4.5).all()
    assert (np.abs(ours.mean() / theirs.mean() - 1.0) < 0.003).all()
    # Pixel by pixel: the larger part is all but free of noise.
    relative = np.abs(ours.mean(axis=0) - theirs.mean(axis=0)) / theirs.mean()
    assert np.median(relative) < 0.003


@pytest.mark.slow
@pytest.mark.parametrize("kind", LIGHTS)
def test_photon_maps_agree_with_their_kernel_reference(kind: str):
    """Photons of both sides, in one kernel; with the k nearest their number counts too."""
    scene = scene_of(LIGHTS[kind])
    limit = Limit("direct", scope="all", kernel=Kernel("simpson", radius=0.4))
    assert (np.abs(apart(images_of(scene, "photon-map", 1), theirs_of(scene, limit, 1))) < 4.5).all()


def test_full_transport_under_a_textured_sky_sees_distant_light():
    """The sky is a shape there, around the scene, and hides none of it: E / pi of a plate that faces both lights."""
    lights = tuple(attrs.evolve(LIGHTS[kind], direction=(0.0, 0.0, -1.0)) for kind in ("directional", "sun"))
    floor = plate("floor", (-2.0, -2.0, 0.0), (4.0, 0.0, 0.0), (0.0, 4.0, 0.0), GREY)
    camera = Camera((0.0, -0.1, 3.0), (0.0, 0.0, 0.0), fov=0.01)
    texture = np.full((4, 8, 3), 0.25, np.float32)
    scene = Scene("sky", camera, (floor,), lights, sky=Sky(texture=texture, radius=6.0), resolution=(2, 2))
    found = reference.render(scene, physical("direct"), spp=256, seed=1).mean.mean(axis=(0, 1))
    np.testing.assert_allclose(found, 2.0 * 0.5 / math.pi * np.array([3.0, 2.0, 1.0]), rtol=5e-3)


def plain_scene(scene: Scene, folder: Path, emitter: dict[str, Any]) -> Any:
    """What `direct` is rendered in, with another emitter in the place of all lights."""
    import mitsuba as mi

    described = translate.describe(scene, folder)["scenes"]["direct"]
    kept = {key: value for key, value in described.items() if not key.startswith("light")}
    for value in kept.values():
        if isinstance(value, dict) and "filename" in value:
            value["filename"] = str(folder / value["filename"])
    return mi.load_dict(kept | {"emitter": emitter}, optimize=False)


def test_a_distant_light_is_mitsubas_directional(tmp_path: Path):
    """The same light at random points, and the same photons: power, and a uniform disc across the way."""
    scene = scene_of(LIGHTS["directional"])
    reference.loaded(scene)
    import drjit as dr
    import mitsuba as mi

    light = LIGHTS["directional"]
    irradiance = {"type": "rgb", "value": list(light.irradiance)}
    their_scene = plain_scene(
        scene, tmp_path, {"type": "directional", "direction": list(light.direction), "irradiance": irradiance}
    )
    (mine,) = reference.loaded(scene).scenes["direct"].emitters()
    (theirs,) = their_scene.emitters()
    rng = np.random.default_rng(1)
    it = dr.zeros(mi.Interaction3f, 100)
    it.p = mi.Point3f(rng.uniform(-20, 20, (3, 100)))
    (a, seen), (b, their_seen) = (
        each.sample_direction(it, mi.Point2f(rng.random((2, 100)))) for each in (mine, theirs)
    )
    np.testing.assert_allclose(np.array(a.d) + np.zeros((3, 100)), np.array(b.d) + np.zeros((3, 100)), atol=1e-6)
    np.testing.assert_allclose(np.array(seen) + np.zeros((3, 1)), np.array(their_seen)[:, :1], rtol=1e-5)
    flown = []
    for each in (mine, theirs):
        ray, flux = each.sample_ray(0.0, 0.5, mi.Point2f(rng.random((2, 40_000))), mi.Point2f(0.5))
        way = np.array(ray.d)[:, :1]
        aside = np.array(ray.o) - way * (way * np.array(ray.o)).sum(axis=0)
        flown.append((np.array(flux)[:, 0], np.linalg.norm(aside, axis=0)))
    np.testing.assert_allclose(flown[0][0], flown[1][0], rtol=1e-3)  # Mitsuba's ball is 1.8e-4 larger
    # Uniform on a disc: r² is uniform, of mean R² / 2 and deviation R² / sqrt(12).
    for _, radius in flown:
        square = radius**2 / radius.max() ** 2
        assert abs(square.mean() - 0.5) < 4.5 / math.sqrt(12 * 40_000)
    np.testing.assert_allclose(flown[0][1].max(), flown[1][1].max(), rtol=1e-3)


def test_a_sun_is_a_far_disc(tmp_path: Path):
    """An `area` light on a `disk` 1e4 scenes away, of the sun's radiance and apparent size: the same penumbrae."""
    scene = scene_of(LIGHTS["sun"], scope="first-hit")
    loaded = reference.loaded(scene)
    import mitsuba as mi

    light = LIGHTS["sun"]
    away = 1e6
    middle = -away * np.array(light.way)
    look_at = mi.ScalarTransform4f().look_at(middle.tolist(), [0.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    size = away * math.tan(light.half_angle)
    disc = {
        "type": "disk",
        "to_world": look_at @ mi.ScalarTransform4f().scale([size, size, 1.0]),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": list(light.radiance)}},
    }
    far = plain_scene(scene, tmp_path, disc)
    from termwise.reference.film import sensor

    camera, integrator = sensor(loaded.description["camera"], 64), mi.load_dict({"type": "direct"})

    def render(seed: Any) -> np.ndarray:
        return np.array(mi.render(far, sensor=camera, integrator=integrator, spp=256, seed=seed))[..., :3]

    theirs = np.array([render(k) for k in range(16)])
    mine = theirs_of(scene, Limit("direct", scope="first-hit"), 256)
    assert (np.abs(apart(mine, theirs)) < 4.5).all()
    assert abs(mine.mean() / theirs.mean() - 1.0) < 0.002


@pytest.mark.parametrize("cutoff", [0.5, 1.5])
def test_a_spot_too_narrow_for_single_precision_is_refused(cutoff: float, tmp_path: Path):
    scene = scene_of(attrs.evolve(LIGHTS["spot"], cutoff=cutoff, beam=None))
    if cutoff < translate.NARROWEST:
        with pytest.raises(ValueError, match=r"lights\[0\]\.cutoff = 0\.5: allowed is at least 1"):
            translate.describe(scene, tmp_path)
    else:
        translate.describe(scene, tmp_path)


def test_photons_of_several_kinds_are_shared_by_power():
    """A spot light of uneven rays, a point and a distant one: each gets photons, and flux, by its own closed form."""
    lights = (*LIGHTS.values(), PointLight((0.0, 0.0, 1.5), (1.0, 1.0, 1.0)))
    scene = scene_of(*lights)
    loaded = reference.loaded(scene)
    from termwise.reference import kernel_reference

    surfaces = kernel_reference.surfaces_of(loaded.scenes["direct"], loaded.description["parts"])
    scale = Canonical.of(scene).scale
    spot, directional, sun, sphere, _ = lights
    beam, cutoff = spot.angles
    shape = 1.0 - (math.sin(cutoff) - math.sin(beam)) / (cutoff - beam)
    low, high = scene.bounds()
    across = math.pi * (np.linalg.norm(high - low) / 2) ** 2
    powers = [
        2 * math.pi * 6.0 * shape,
        across * 2.0,
        across * 2.0 * 2.0 / (1.0 + math.cos(sun.half_angle)),
        4 * math.pi**2 * sphere.radius**2 * 2.0,
        4 * math.pi * 1.0,
    ]
    found = sorted(each.power.mean() for each in surfaces.emitters)
    np.testing.assert_allclose(found, scale**2 * np.sort(powers), rtol=1e-3)
    shares = sorted(each.share for each in surfaces.emitters)
    np.testing.assert_allclose(shares, np.sort(powers) / sum(powers), rtol=1e-3)
    (even,) = (each for each in surfaces.emitters if each.cone is not None)
    assert even.power.mean() == pytest.approx(scale**2 * powers[-1], rel=1e-3)
    emitters = emitters_of(scene)
    ours = np.concatenate(
        [kind.power(each, False) for kind, each in zip(KINDS, emitters[-6:], strict=True) if each is not None]
    )
    np.testing.assert_allclose(sorted(ours), sorted(powers), rtol=1e-6)


@pytest.mark.parametrize("scope", ["first-hit", "all"])
@pytest.mark.parametrize("size", [6.0, 60.0, 190.0])
def test_a_far_sphere_does_not_hide_itself(size, scope):
    """Far away `ray_test` finds what it should not. E / pi is sin² of half of its angle, times the cosine."""
    light = SphereLight((0.5, 0.3, 0.4), 0.2, (3.0, 2.0, 1.0))
    corner, side = -size, 2.0 * size
    plane = plate("plane", (corner, corner, 0.0), (side, 0.0, 0.0), (0.0, side, 0.0), GREY)
    camera = Camera((0.0, 0.0, 2.0 * size), (0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0), fov=40.0)
    scene = Scene("far", camera, (plane,), (light,), resolution=(12, 12), scope=scope)
    limit = Limit("direct", scope=scope)
    images = np.array([reference.replicate(scene, limit, spp=256, seed=seed) for seed in range(8)])

    film = (np.stack(np.meshgrid(np.arange(1200), np.arange(1200)), axis=-1).reshape(-1, 2) + 0.5) / 1200
    way = camera.rays(film, aspect=1.0)
    met = camera.position[2] / -way[:, 2:] * way + camera.position
    towards = np.array(light.center) - met
    distance = np.linalg.norm(towards, axis=1)
    share = (light.radius / distance) ** 2 * towards[:, 2] / distance
    of_pixels = share.reshape(12, 100, 12, 100).mean(axis=(1, 3))

    error = images.std(axis=0, ddof=1) / math.sqrt(len(images))
    far = distance.reshape(12, 100, 12, 100).min(axis=(1, 3)) > size / 6.0  # the lamp itself hides the pixels about it
    z = (images.mean(axis=0) - 0.5 * of_pixels[..., None] * light.radiance)[far] / error[far]
    assert np.abs(z).max() < 9.0  # t of 7 degrees of freedom, some 400 channels
    expected = 0.5 * of_pixels[far].sum() * np.array(light.radiance)
    np.testing.assert_allclose(images.mean(axis=0)[far].sum(axis=0), expected, rtol=0.01)
    assert geometry_audit.audit(scene, seed=1).place is None


def test_a_sphere_is_black_in_all_of_mitsubas_scenes():
    """It hides ambient light, `AO = 1 - sin² a cos t`, whether it shines or not, and the sky; it may be drawn."""
    light = SphereLight((0.0, 0.0, 1.0), 0.5, (3.0, 2.0, 1.0))
    floor = plate("floor", (-2.0, -2.0, 0.0), (4.0, 0.0, 0.0), (0.0, 4.0, 0.0), GREY)
    camera = Camera((0.0, -3.0, 0.5), (0.0, 0.0, 0.0), fov=0.01)
    scene = Scene("ball", camera, (floor,), (light,), ambient=Ambient((1.0, 1.0, 1.0)), resolution=(2, 2))
    for each in (light, attrs.evolve(light, radiance=(0.0, 0.0, 0.0))):
        found = reference.render(attrs.evolve(scene, lights=(each,)), "ambient", spp=2**14, seed=1).mean
        np.testing.assert_allclose(found.mean(), 0.5 * 0.75, rtol=5e-3)
    towards = attrs.evolve(scene, camera=attrs.evolve(camera, target=light.center), sky=Sky((0.5, 0.5, 0.5)))
    assert not reference.render(towards, "background", spp=1, seed=1).mean.any()
    drawn = reference.render(attrs.evolve(towards, draw_lights=True), "background", spp=1, seed=1).mean
    np.testing.assert_allclose(drawn, np.broadcast_to(light.radiance, (2, 2, 3)))


def test_the_library_scene_of_lights_passes_its_audit():
    finding = geometry_audit.audit(load("lights"), seed=1)
    assert finding.place is None
    assert finding.asked > geometry_audit.POINTS
