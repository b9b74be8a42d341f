"""Lights: what spot, directional light, sun and sphere send at the ends of their ranges is what their formulas say.

A spot light has an angle of a float64's digits whatever its width and the scale of the scene; a sun has the irradiance
of its projected disc, `L pi sin² a cos t`, and `L (a - sin a cos a)` on the horizon, and so has a sphere,
`sin a = r / d`, far away and nearly touched. Photons carry the power; those of distant light begin outside of the
scene, and shadow rays end there.

What is to be expected: the paper shows no such lights. Mitsuba takes a spot light's angle from its cosine in float32.
"""

import functools
import math
from collections.abc import Iterator

import attrs
import numpy as np
from scipy import stats

from termwise.renderer.arrays import SceneArrays, from_scene
from termwise.renderer.jit import kernel
from termwise.renderer.lights import DIRECTIONAL, KINDS, SPHERE, SPOT, SUN, directional, sphere, spot, sun
from termwise.renderer.lights.distant import ball_of, before, out_of
from termwise.renderer.spheres import Spheres, distance_to
from termwise.renderer.surface import Surface
from termwise.renderer.vector import Vec3, vec3
from termwise.reports.stress.row import Row
from termwise.scenes.analytic import plate
from termwise.scenes.model import Camera, DirectionalLight, Scene, SphereLight, SpotLight, SunLight, Vector

_EPS = 2.0**-52
_SPOTS = ((0.0, 90.0), (89.999, 90.0), (0.0, 0.01), (20.0, 20.0), (19.999999, 20.0))
_SCALES = (1e-6, 1.0, 1e6)
_OFFSETS = (0.0, 1e5)
_SUNS = (1e-3, 0.533, 60.0, 180.0)


@functools.lru_cache(maxsize=4)
def _lit(
    spot_light: SpotLight, sun_light: SunLight, way: Vector, scale: float = 1.0, ball: SphereLight | None = None
) -> SceneArrays:
    """A plate with a light of each kind: one type for all rows, hence one compilation."""
    floor = plate("floor", (-3.0 * scale, -3.0 * scale, 0.0), (6.0 * scale, 0.0, 0.0), (0.0, 6.0 * scale, 0.0))
    ball = ball or SphereLight((0.0, 0.0, scale), 0.25 * scale, (1.0, 1.0, 1.0))
    camera = Camera((0.0, -9.0 * scale, scale), (0.0, 0.0, 0.0))
    lights = (spot_light, DirectionalLight(way, (1.0, 1.0, 1.0)), sun_light, ball)
    return from_scene(Scene("lights", camera, (floor,), lights))


_SPOT = SpotLight((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
_SUN = SunLight((0.0, 0.0, -1.0), (1.0, 1.0, 1.0))
_DOWN = (0.0, 0.0, -1.0)


@kernel
def _sample(scene: SceneArrays, kind: int, points: np.ndarray, numbers: np.ndarray, out: np.ndarray) -> None:
    """E (N,) of samples of the first light of a kind, at points (N, 3) whose normal is up."""
    up = Vec3(0.0, 0.0, 1.0)
    for i in range(len(points)):
        surface = Surface(vec3(points, i), up, up, 0, 0, 1.0, 0.0, 0.0)
        u, v = numbers[i, 0], numbers[i, 1]
        if kind == SPOT:
            irradiance, _, _ = spot.sample(scene, 0, 1.0, surface, u, v)
        elif kind == DIRECTIONAL:
            irradiance, _, _ = directional.sample(scene, 0, 1.0, surface, u, v)
        elif kind == SUN:
            irradiance, _, _ = sun.sample(scene, 0, 1.0, surface, u, v)
        else:
            irradiance, _, _ = sphere.sample(scene, 0, 1.0, surface, u, v)
        out[i] = math.pi * irradiance.x


@kernel
def _emit(scene: SceneArrays, kind: int, numbers: np.ndarray, out: np.ndarray) -> None:
    """Flux (N,) of photons of the first light of a kind."""
    for i in range(len(numbers)):
        place, way = (numbers[i, 0], numbers[i, 1]), (numbers[i, 2], numbers[i, 3])
        if kind == SPOT:
            _, _, flux, _ = spot.emit(scene, 0, 1.0, False, place, way)
        elif kind == DIRECTIONAL:
            _, _, flux, _ = directional.emit(scene, 0, 1.0, False, place, way)
        elif kind == SUN:
            _, _, flux, _ = sun.emit(scene, 0, 1.0, False, place, way)
        else:
            _, _, flux, _ = sphere.emit(scene, 0, 1.0, False, place, way)
        out[i] = flux.x


def _irradiance(arrays: SceneArrays, kind: int, points: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """E (N,) of samples of a kind."""
    points, numbers = np.ascontiguousarray(points, np.float64), np.ascontiguousarray(numbers, np.float64)
    out = np.zeros(len(points))
    _sample(arrays, kind, points, numbers, out)
    return out


def spots(count: int) -> Iterator[Row]:
    """The share of the intensity, times the width of the slope: by long doubles."""
    for beam, cutoff in _SPOTS:
        for scale in _SCALES:

            def wrong(beam: float = beam, cutoff: float = cutoff, scale: float = scale) -> float:
                light = SpotLight((0.0, 0.0, scale), (0.25 * scale, 0.0, 0.0), (1.0, 1.0, 1.0), cutoff, beam)
                arrays = _lit(light, _SUN, _DOWN, scale)
                inner, outer = map(np.longdouble, light.angles)
                share = np.linspace(0.0, 1.25, 26)
                x = scale * np.tan(np.minimum(math.atan(0.25) + share * min(light.angles[1], 1.0), 1.5))
                points = np.stack([x, np.zeros_like(x), np.zeros_like(x)], axis=1)
                found = _irradiance(arrays, SPOT, points, np.zeros((len(x), 2)))
                along, height = x.astype(np.longdouble), np.longdouble(scale)
                away = np.abs(np.arctan2(along, height) - np.arctan2(np.longdouble(0.25) * height, height))
                width = outer - inner
                slope = np.clip((outer - away) / width, 0.0, 1.0) if width > 0 else (away < outer) * np.longdouble(1.0)
                right = slope * height / np.sqrt(along * along + height * height) ** 3
                error = np.abs(found - right) * (width if width > 0 else 1.0) * height**2
                # Where there is no slope, an angle that is the edge's to its rounding lies on either side of it.
                error = error[np.abs(away - outer) > 8 * _EPS] if width == 0 else error
                worst = float(error.max())
                return worst / _EPS

            yield Row(f"spot {beam} to {cutoff} degrees, scale {scale:g}", "error in units of 2^-52", 16.0, wrong)


def suns(count: int) -> Iterator[Row]:
    """Irradiance by evenly spread points, whose error falls as one over their number, as it may on a smooth disc."""
    points = stats.qmc.Sobol(2, rng=1).random(1 << (count - 1).bit_length())
    for angle in _SUNS:
        half = math.radians(angle) / 2.0
        radiance = 1.0 / (math.pi * math.sin(half) ** 2)
        on_horizon = radiance * (half - math.sin(half) * math.cos(half))
        cases = {"overhead": (_DOWN, 1.0), "on the horizon": ((1.0, 0.0, 0.0), on_horizon)}
        if half < 0.7:
            cases["45 degrees up"] = ((1.0, 0.0, -1.0), math.sqrt(0.5))
        for where, (way, right) in cases.items():

            def wrong(angle: float = angle, way: Vector = way, right: float = right) -> float:
                arrays = _lit(_SPOT, SunLight(way, (1.0, 1.0, 1.0), angle), _DOWN)
                found = _irradiance(arrays, SUN, np.zeros((len(points), 3)), points).mean()
                return abs(float(found) / right - 1.0)

            yield Row(f"sun of {angle:g} degrees {where}", "relative error", 1.0 / len(points), wrong)


def grazing(count: int) -> Iterator[Row]:
    """A directional light along a surface: its cosine is that of the direction, to the rounding of unit vectors."""
    for cosine in (1.0, 1e-4, 1e-8, 0.0, -1e-8):

        def wrong(cosine: float = cosine) -> float:
            arrays = _lit(_SPOT, _SUN, (math.sqrt(1.0 - cosine * cosine), 0.0, -cosine))
            found = _irradiance(arrays, DIRECTIONAL, np.zeros((1, 3)), np.zeros((1, 2)))[0]
            return abs(found - max(cosine, 0.0)) / max(abs(cosine), 1e-300) / _EPS

        yield Row(f"directional light of cosine {cosine:g}", "relative error in units of 2^-52", 4.0, wrong)


def spheres(count: int) -> Iterator[Row]:
    """Irradiance straight below a sphere, `pi L (r / d)²`."""
    points = stats.qmc.Sobol(2, rng=1).random(1 << (count - 1).bit_length())
    for share in (1e-8, 0.5, 1.0 - 1e-9):
        for scale in _SCALES:

            def wrong(share: float = share, scale: float = scale) -> float:
                ball = SphereLight((0.0, 0.0, scale), share * scale, (1.0, 1.0, 1.0))
                arrays = _lit(_SPOT, _SUN, _DOWN, scale, ball)
                found = _irradiance(arrays, SPHERE, np.zeros((len(points), 3)), points).mean()
                return abs(float(found) / (math.pi * share**2) - 1.0)

            yield Row(f"sphere of {share} of its distance, scale {scale:g}", "relative error", 1.0 / len(points), wrong)


def meeting(count: int) -> Iterator[Row]:
    """Where rays meet a sphere, against long doubles; rays that graze it are left out."""
    rng = np.random.default_rng(2)
    for scale in _SCALES:
        for away in (1.5, 1e3, 1e6):

            def wrong(scale: float = scale, away: float = away) -> float:
                ball = Spheres(np.zeros((1, 3)), np.array([scale]), 0)
                origins = rng.normal(size=(count, 3))
                origins *= away * scale / np.linalg.norm(origins, axis=1, keepdims=True)
                aims = rng.uniform(-0.5, 0.5, (count, 3)) * scale
                worst = 0.0
                for origin, direction in zip(origins.tolist(), (aims - origins).tolist(), strict=True):
                    found = distance_to(ball, 0, Vec3(*origin), Vec3(*direction))
                    o, d = np.array(origin, np.longdouble), np.array(direction, np.longdouble)
                    middle = -(o @ d) / (d @ d)
                    aside = o + middle * d
                    right = middle - np.sqrt((np.longdouble(scale) ** 2 - aside @ aside) / (d @ d))
                    worst = max(worst, abs(float((found - right) / right)))
                return worst / _EPS

            yield Row(f"rays to a sphere from {away:g} radii, scale {scale:g}", "error in units of 2^-52", 16.0, wrong)


def outside(count: int) -> Iterator[Row]:
    """Shadow rays to distant light end beyond all surfaces, its photons begin before them, at any place and scale."""
    rng = np.random.default_rng(1)
    ways = rng.normal(size=(count, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    numbers = rng.random((count, 5))
    for scale in _SCALES:
        for offset in _OFFSETS:

            def inside(scale: float = scale, offset: float = offset * scale) -> float:
                low, high = np.array([offset, -offset, 0.0]), np.array([offset, -offset, 0.0]) + scale
                thing = plate("plate", tuple(low), (scale, 0.0, 0.0), (0.0, scale, scale))
                ball = ball_of(Scene("ball", Camera((0.0, -scale, 3.0 * scale), (0.0, 0.0, 0.0)), (thing,)))
                bad = 0
                for way, (u, v, *place) in zip(ways, numbers, strict=True):
                    direction = Vec3(*way.tolist())
                    point = low + np.array(place) * (high - low)
                    end = point + np.array(out_of(ball, direction))
                    begin = np.array(before(ball, direction, u, v))
                    # Beyond the plane that touches the box on that side, and before that on the other.
                    corners = np.where([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)], high, low) @ way
                    bad += not (end @ way > corners.max() and begin @ way < corners.min())
                return float(bad)

            yield Row(
                f"distant light, scale {scale:g}, offset {offset:g}", "rays that end or begin inside", 0.0, inside
            )


def powers(count: int) -> Iterator[Row]:
    """The mean of the photons is the power that the light is picked by."""
    points = stats.qmc.Sobol(4, rng=1).random(1 << (count - 1).bit_length())
    for kind in (spot, directional, sun, sphere):
        for scale in _SCALES:

            def wrong(kind=kind, scale: float = scale) -> float:
                light = attrs.evolve(_SPOT, position=(0.0, 0.0, scale))
                arrays = _lit(light, attrs.evolve(_SUN, angle=60.0), _DOWN, scale)
                found = np.zeros(len(points))
                _emit(arrays, KINDS.index(kind), points, found)
                power = kind.power(getattr(arrays.emitters, f"{kind.SOURCE.kind}s"), False)[0]
                return abs(float(found.mean() / power) - 1.0)

            yield Row(f"photons of {kind.SOURCE.kind}, scale {scale:g}", "relative error", 1.0 / len(points), wrong)


def rows(count: int) -> Iterator[Row]:
    """All rows of the group."""
    for make in (spots, suns, grazing, spheres, meeting, outside, powers):
        yield from make(count)
