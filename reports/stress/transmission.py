"""Transmission: light goes as Snell and Fresnel say, and none is lost or made, at any index, angle and roughness.

Indices from 0.1 to 10, 1 and its neighbours among them; cosines from 1 to 1e-12, total reflection from within; alpha
from 1e-4 to 1.5; slabs and balls, hollow and in one another, of sizes from 1e-6 to 1e6. The oracles are Fresnel's
equations in long doubles, Snell's law itself, quadrature over slopes, and what a smooth dielectric is in light of 1
from all around: invisible.

What is to be expected: the paper has no transparent surfaces. Mitsuba's lobes are computed in float32.
"""

import itertools
import math
from collections.abc import Iterator
from typing import Any

import attrs
import numpy as np
import trimesh

from termwise.renderer import Engine, find, render
from termwise.renderer.arrays import SceneArrays, from_scene
from termwise.renderer.dielectric import (
    EITHER,
    REFLECTED,
    REFRACTED,
    Interface,
    eval_transmission,
    fresnel_dielectric,
    refract,
    sample_interface,
)
from termwise.renderer.jit import kernel
from termwise.renderer.scratch import Scratch, new_scratch
from termwise.renderer.surface import beyond
from termwise.renderer.vector import Vec3, put, vec3
from termwise.reports.stress.row import Row
from termwise.reports.stress.shading import ALPHAS, COSINES, _direction, _g1, _points
from termwise.scenes.analytic import plate
from termwise.scenes.model import Ambient, Camera, Material, Mesh, Object, Scene, Sky

_INDICES = (0.1, 1.0 / 1.5, 1.0 - 1e-7, 1.0, 1.0 + 1e-7, 1.5, 10.0)
_WHITE = Vec3(1.0, 1.0, 1.0)
_EPS = 2.0**-52


def _exact_fresnel(cosine: np.ndarray, eta: float) -> np.ndarray:
    """Reflectance in long doubles, by the cosines on both sides."""
    index, near = np.longdouble(eta), cosine.astype(np.longdouble)
    square = 1.0 - (1.0 - near) * (1.0 + near) / index**2
    far = np.sqrt(np.maximum(square, 0.0)) if eta != 1.0 else near
    across = (near - index * far) / (near + index * far)
    along = (index * near - far) / (index * near + far)
    return (across**2 + along**2) / 2.0


def fresnel(count: int) -> Iterator[Row]:
    """F at cosines of 1 to 1e-12, but for the last digits before total reflection, where it rises as a root.

    The far cosine is a root of 1 minus what is rounded: its error is 2^-52 over itself, twice that in each quotient.
    """
    cosine = np.concatenate([10.0 ** -np.linspace(0, 12, 200), np.random.default_rng(41).random(count // 8)])
    for eta in _INDICES:

        def error(eta: float = eta) -> float:
            found = np.array([fresnel_dielectric(each, eta) for each in cosine.tolist()])
            far = np.sqrt(np.maximum(1.0 - (1.0 - cosine**2) / eta**2, 0.0))
            allowed = _EPS * (16.0 + 16.0 / np.maximum(far, 2.0**-26))
            return float((np.abs(found - _exact_fresnel(cosine, eta).astype(float)) / allowed).max())

        yield Row(f"Fresnel, index {eta:.9g}", "error over its roundings, 16 + 16 / far cosine of 2^-52", 1.0, error)


def snell(count: int) -> Iterator[Row]:
    """A refracted direction is a unit vector in the plane of view and normal, and its sine is the view's over eta."""
    rng = np.random.default_rng(42)
    for eta in _INDICES:

        def error(eta: float = eta) -> float:
            worst = 0.0
            for _ in range(max(32, count // 16)):
                m, other = rng.normal(size=(2, 3))
                m /= np.linalg.norm(m)
                aside = np.cross(m, other)
                aside /= np.linalg.norm(aside)
                sine = rng.random() * min(1.0, eta) * (1.0 - 1e-9)
                o = math.sqrt(1.0 - sine * sine) * m + sine * aside
                i = np.array(refract(Vec3(*o.tolist()), Vec3(*m.tolist()), eta))
                out = (abs(i @ i - 1.0), abs(np.linalg.norm(np.cross(i, m)) - sine / eta), abs(i @ np.cross(m, aside)))
                worst = max(worst, *out, 0.0 if i @ m < 0.0 else math.inf)
            return float(worst * min(1.0, eta) ** 2 / _EPS)

        yield Row(f"Snell, index {eta:.9g}", "error of length, sine and plane in units of 2^-52", 16.0, error)


def weights(count: int) -> Iterator[Row]:
    """A sample's weight, of flux, is a number in [0, 1] and its direction a unit vector, of either lobe at any view."""
    points = _points(max(16, count // 64)).tolist()
    choices = np.random.default_rng(43).random(len(points)).tolist()
    for alpha, eta in itertools.product(ALPHAS, _INDICES):
        lobes = Interface(alpha, eta, 1.0, _WHITE)

        def faulty(lobes: Interface = lobes) -> float:
            bad = 0
            for mu, way in itertools.product(COSINES, (REFLECTED, REFRACTED, EITHER)):
                for (u, v), choice in zip(points, choices, strict=True):
                    wi, weight, spread = sample_interface(way, lobes, _direction(mu, 0.3), u, v, choice)
                    flux, length = weight.x / spread, math.hypot(*wi)
                    good = 0.0 <= flux <= 1.0 + 4.0 * _EPS and weight.x == weight.y == weight.z
                    # A sample that weighs nothing may go anywhere.
                    side = way == EITHER or (wi.z < 0.0) == (way == REFRACTED)
                    good &= weight.x == 0.0 or (abs(length - 1.0) < 1e-6 and side)
                    bad += not good
            return float(bad)

        figure = "samples on a wrong side, without a unit direction or a weight in [0, 1]"
        yield Row(
            f"lobes, alpha {alpha:g}, index {eta:.9g}", figure, 0.0, faulty, None, _in_mitsuba(alpha, eta, points)
        )


def _in_mitsuba(alpha: float, eta: float, points: list[Any]) -> Any:
    """The same of the references' own lobes, which keep 24 bits."""

    def faulty() -> float:
        from termwise.reference.backend import import_mitsuba

        mi: Any = import_mitsuba()
        import drjit as dr  # after Mitsuba has chosen its LLVM

        from termwise.reference import dielectric

        dielectric.register()
        told = {"alpha": alpha, "eta": eta, "factor": 1.0, "transparency": 1.0, "tint": mi.ScalarColor3f(1.0)}
        lobes, bad = mi.load_dict({"type": "microfacet_dielectric"} | told), 0.0
        context = mi.BSDFContext(mi.TransportMode.Importance)
        numbers = np.array(points, np.float32)
        for mu in COSINES:
            si = dr.zeros(mi.SurfaceInteraction3f, len(points))
            si.wi = mi.Vector3f(*_direction(mu, 0.3))
            choice = mi.Float(np.linspace(0.0, 1.0, len(points), endpoint=False).astype(np.float32))
            found, weight = lobes.sample(context, si, choice, mi.Point2f(numbers.T.copy()), True)
            flux, wi = np.array(weight.x, np.float64), np.array(found.wo, np.float64).T
            good = (flux >= 0.0) & (flux <= 1.0 + 1e-6)
            good &= (flux == 0.0) | (np.abs(np.linalg.norm(wi, axis=1) - 1.0) < 1e-6)
            bad += float((~good).sum())
        return bad

    return faulty


def nothing(count: int) -> Iterator[Row]:
    """Of index 1 an interface reflects nothing, and sends light straight on to the bit, less what the facets hide."""
    points = _points(max(16, count // 64)).tolist()
    for alpha in ALPHAS:
        lobes = Interface(alpha, 1.0, 1.0, Vec3(0.75, 0.5, 0.25))

        def faulty(lobes: Interface = lobes, alpha: float = alpha) -> float:
            bad = 0
            for mu in COSINES:
                wo = _direction(mu, 0.3)
                right = 0.75 * float(_g1(np.array(mu), alpha))
                for u, v in points:
                    for choice in (0.0, 1.0 - 2.0**-33):
                        wi, weight, spread = sample_interface(EITHER, lobes, wo, u, v, choice)
                        seen = weight.x != 0.0  # a facet that is seen from behind, which rounding may give
                        bad += seen and (wi != Vec3(-wo.x, -wo.y, -wo.z) or spread != 1.0)
                        bad += seen and not abs(weight.x - right) <= 1e-12 * right
                        bad += sample_interface(REFLECTED, lobes, wo, u, v, choice)[1].x != 0.0
            return float(bad)

        yield Row(f"index 1, alpha {alpha:g}", "samples that are turned, reflected or weighed wrongly", 0.0, faulty)


def kept(count: int) -> Iterator[Row]:
    """From within a smooth body, beyond the critical angle by 1e-3 and more, all is reflected, none goes through."""
    points = _points(max(16, count // 64)).tolist()
    for index in (1.0 + 1e-5, 1.5, 10.0):
        lobes = Interface(1e-4, 1.0 / index, 1.0, _WHITE)
        critical = math.sqrt((1.0 - 1.0 / index) * (1.0 + 1.0 / index))

        def faulty(lobes: Interface = lobes, critical: float = critical) -> float:
            bad = 0
            for mu in (0.999 * critical - 1e-3, 0.3 * critical, 1e-6, 1e-12):
                wo = _direction(mu, 0.3)
                for u, v in points:
                    wi, weight, _ = sample_interface(EITHER, lobes, wo, u, v, 0.0)
                    bad += not (weight.x == 0.0 or (wi.z > 0.0 and weight.x <= 1.0))
                    bad += sample_interface(REFRACTED, lobes, wo, u, v, 0.0)[1].x != 0.0
            return float(bad)

        yield Row(f"total reflection, index {index:g}", "samples that go through", 0.0, faulty)


def _albedos(mu: float, alpha: float, eta: float) -> tuple[float, float]:
    """Flux that is reflected and let through, by the midpoint rule over slopes of the facet, see `shading._albedo`."""
    n = 1000
    t = 6.5 * alpha * (2 * (np.arange(n) + 0.5) / n - 1)
    x, y = np.meshgrid(t, t, indexing="ij", sparse=True)
    mz = 1 / np.sqrt(1 + x * x + y * y)
    cos = (mu - x * math.sqrt((1 - mu) * (1 + mu))) * mz
    seen = cos > 0
    cos = np.where(seen, cos, 0.5)
    fresnel = _exact_fresnel(cos, eta).astype(float)
    beyond = np.sqrt(np.maximum(1.0 - (1.0 - cos**2) / eta**2, 0.0))
    up, down = 2 * cos * mz - mu, mu / eta - (cos / eta - beyond) * mz
    facets = np.exp(-(x * x + y * y) / alpha**2) / (np.pi * alpha**2) * np.where(seen, cos / (mu * mz), 0.0)

    def albedo(part: np.ndarray, cosine: np.ndarray) -> float:
        masked = np.where(cosine > 0, _g1(np.clip(cosine, 1e-12, 1.0), alpha), 0.0) * float(_g1(np.array(mu), alpha))
        return float((13 * alpha / n) ** 2 * (facets * part * masked).sum())

    return albedo(fresnel, up), albedo(1.0 - fresnel, down)


def energy(count: int) -> Iterator[Row]:
    """Mean weights of both lobes, of flux, are their albedos by quadrature, which add up to 1 at most.

    A midpoint rule of n² points errs by the length of the curves in the square where a lobe ends, see `shading`.
    """
    n = max(12, math.isqrt(count))
    middle = (np.arange(n) + 0.5) / n
    points = [(u, v) for u in middle.tolist() for v in middle.tolist()]
    for alpha, mu, eta in ((0.05, 1.0, 1.5), (0.3, 0.7, 1.5), (0.3, 0.7, 1 / 1.5), (0.3, 1e-3, 1.5), (1.5, 0.5, 10.0)):
        lobes = Interface(alpha, eta, 1.0, _WHITE)

        def error(lobes: Interface = lobes, mu: float = mu) -> float:
            right, wo, found = _albedos(mu, lobes.alpha, lobes.eta), _direction(mu, 0.0), []
            for way in (REFLECTED, REFRACTED):
                drawn = (sample_interface(way, lobes, wo, u, v, 0.5) for u, v in points)
                found.append(np.mean([weight.x / spread for _, weight, spread in drawn]))
            return max(abs(a - b) for a, b in zip(found, right, strict=True)) + max(0.0, sum(right) - 1.0 - 1e-6)

        name = f"energy, alpha {alpha:g}, cosine {mu:g}, index {eta:.9g}"
        yield Row(name, "error of the two albedos", 2.0 / n, error)


def reciprocity(count: int) -> Iterator[Row]:
    """f(i, o) / eta_o² = f(o, i) / eta_i², pairs on the two sides.

    Both orders find the facet from the same sum, of length |eta - 1| at least, in which it is rounded; D multiplies
    that by twice its slope over alpha², and by the tangent's share. From the denser side 1 - F is of the root of what
    is left of 1 up to total reflection, the square of the cosine on the rarer side over eta.
    """
    for alpha, eta in itertools.product((0.05, 0.3, 1.5), (1.01, 1.5, 10.0)):

        def error(alpha: float = alpha, eta: float = eta) -> float:
            rng, worst = np.random.default_rng(44), 0.0
            for u, v, choice, mu in rng.random((count // 8, 4)).tolist():
                o = _direction(mu, 6.0 * choice)
                i, weight, _ = sample_interface(REFRACTED, Interface(alpha, eta, 1.0, _WHITE), o, u, v, choice)
                if weight.x == 0.0 or i.z > -1e-6:
                    continue
                one = eval_transmission(i, o, alpha, eta) / -i.z
                other = eval_transmission(Vec3(o.x, o.y, -o.z), Vec3(i.x, i.y, -i.z), alpha, 1.0 / eta) / o.z
                h = np.array(o) + eta * np.array(i)
                slope = math.hypot(h[0], h[1]) / abs(h[2])
                steep = (2.0 * slope / alpha**2 + 4.0) * (1.0 + slope) ** 2
                left = (np.array(o) @ h / np.linalg.norm(h) / eta) ** 2
                allowed = _EPS * (64.0 + 16.0 * steep * eta / np.linalg.norm(h) + 4.0 / left)
                worst = max(worst, abs(one * eta**2 / other - 1.0) / allowed)
            return worst

        name = f"reciprocity across, alpha {alpha:g}, index {eta:g}"
        yield Row(name, "relative difference over its roundings", 1.0, error)


def _glass(eta: float, **fields: Any) -> Material:
    return Material((0.0, 0.0, 0.0), 1.0, 1e-4, transparency=1.0, ior=eta, **fields)


def _ball(name: str, radius: float, eta: float) -> Object:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=radius)
    return Object(name, Mesh.from_arrays(mesh.vertices, mesh.faces, smooth=True), _glass(eta))


def _slab(scale: float, eta: float) -> Object:
    box = trimesh.creation.box(extents=(scale * 40.0, scale * 41.0, scale * 0.5))
    return Object("slab", Mesh.from_arrays(box.vertices, box.faces), _glass(eta))


def _furnace(things: tuple[Object, ...], scale: float, eye: tuple[float, float, float]) -> Scene:
    x, y, z = (scale * each for each in eye)
    camera = Camera((x, y, z), (0.02 * scale, 0.03 * scale, 0.01 * scale), fov=4.0, pixel="centre")
    sky, ambient = Sky((1.0, 1.0, 1.0)), Ambient((1.0, 1.0, 1.0))
    return Scene("furnace", camera, things, ambient=ambient, sky=sky, resolution=(8, 8), max_bounces=64)


def furnaces(count: int) -> Iterator[Row]:
    """Smooth bodies in light of 1 from all around: every pixel is what it is from where the camera stands.

    That is 1 outside, and eta² inside, where each chain has what it loses at one interface back at the next. Of chains
    that are still within after 64 vertices there are R^64, 1e-11 of the densest. Without roulette, whose 1/p is noise.
    """
    outside = (0.3, -4.0, 3.0)
    cases: dict[str, tuple[Scene, float]] = {}
    for scale, eta in (
        (1e-6, 1.5),
        (1.0, 1.5),
        (1e6, 1.5),
        (1.0, 1.0),
        (1.0, 1.0 + 1e-7),
        (1.0, 1.0 - 1e-7),
        (1.0, 0.5),
    ):
        name = f"slab, scale {scale:g}, index {eta:.9g}"
        cases[name] = _furnace((_slab(scale, eta),), scale, outside), 1.0
    cases["ball, index 1"] = _furnace((_ball("ball", 1.0, 1.0),), 1.0, outside), 1.0
    cases["ball, index 1.5"] = _furnace((_ball("ball", 1.0, 1.5),), 1.0, outside), 1.0
    shells = tuple(_ball(f"ball {n}", r, eta) for n, (r, eta) in enumerate(((1.0, 1.5), (0.8, 1 / 1.5), (0.6, 2.4))))
    cases["three balls in one another"] = _furnace(shells, 1.0, outside), 1.0
    cases["a camera inside of a slab"] = _furnace((_slab(1.0, 1.5),), 1.0, (0.03, 0.02, 0.2)), 1.5**2
    for name, (scene, right) in cases.items():

        def error(scene: Scene = scene, right: float = right) -> float:
            terms = ("specular", "transmission")
            with Engine(scene, threads=1, without=("roulette",)) as engine:
                ends = [[*engine.prefixes(find(t), samples=8, seed=1, replicate=0, chain="path")][-1] for t in terms]
            return float(np.abs(np.sum([image for _, image, _ in ends], axis=0) / right - 1.0).max())

        yield Row(f"furnace, {name}", "largest error of a pixel", 1e-7, error)


def hidden(count: int) -> Iterator[Row]:
    """A lamp in a ball of glass: no shadow ray and no chain meets it, and the floor around is black."""
    ball = _ball("ball", 1.0, 1.5)
    lamp = attrs.evolve(plate("lamp", (-0.3, -0.3, 0.1), (0.0, 0.6, 0.0), (0.6, 0.0, 0.0)), emission=(9.0, 9.0, 9.0))
    floor = plate("floor", (-9.0, -9.1, -1.5), (18.0, 0.0, 0.0), (0.0, 18.2, 0.0), Material((1.0, 1.0, 1.0)))
    camera = Camera((0.3, -5.0, 3.0), (0.0, 0.0, -0.5), fov=40.0)
    scene = Scene("lantern", camera, (ball, lamp, floor), resolution=(8, 8), max_bounces=8)
    for term in ("direct", "specular", "transmission"):

        def seen(term: str = term) -> float:
            return float((render(scene, term, samples=16, chain="path", threads=1).mean != 0.0).sum())

        yield Row(f"a lamp inside of glass, {term}", "numbers of the image that are not 0", 0.0, seen)


@kernel
def _left(
    scene: SceneArrays, origin: np.ndarray, ways: np.ndarray, far: np.ndarray, out: np.ndarray, scratch: Scratch
) -> None:
    """What is left (N, 3) of light on ways (N, 3) from a point (1, 3) to `far` (N,) times their length."""
    for i in range(len(ways)):
        passing, light, middle = scene.materials.passing, Vec3(1.0, 1.0, 1.0), vec3(origin, 0)
        put(out, i, beyond(scene, passing, light, middle, -1, vec3(ways, i), far[i], -1, scratch))


def passages(count: int) -> Iterator[Row]:
    """Light out of the middle of boxes in one another that cast no shadow loses its share in each, and no more.

    Through edges and vertices too, where up to six faces are met in one place. Shares are powers of two.
    """
    shells, tint = 6, (0.5, 1.0, 0.25)
    thin = _glass(1.5, tint=tint, occludes=False)
    for scale, offset in itertools.product((1e-6, 1.0, 1e6), (0.0, 100.0)):

        def wrong(scale: float = scale, offset: float = offset) -> float:
            middle = scale * offset * np.array([1.0, -0.5, 0.25])
            meshes = [trimesh.creation.box(extents=(scale * (n + 1.0),) * 3) for n in range(shells)]
            meshes = [Mesh.from_arrays(mesh.vertices + middle, mesh.faces) for mesh in meshes]
            x, y, z = middle.tolist()
            camera = Camera((x + 0.03 * scale, y + 0.05 * scale, z), (x, y, z))
            things = tuple(Object(f"box {n}", mesh, thin) for n, mesh in enumerate(meshes))
            arrays, scratch = from_scene(Scene("boxes", camera, things)), new_scratch()
            rng = np.random.default_rng(45)
            first, second = (meshes[-1].vertices - middle)[rng.integers(8, size=(2, max(32, count // 16)))]
            ways = first + (second - first) * rng.choice([0.0, 0.25, 0.5, 0.7], (len(first), 1))
            reach = np.abs(ways).max(axis=1)
            ways, reach = ways[reach > 0.1 * scale], reach[reach > 0.1 * scale]  # one to the middle leads nowhere
            bad, found = 0, np.empty_like(ways)
            for passed in (1, 3, shells):
                _left(arrays, middle[None], ways, 0.5 * (passed + 0.5) * scale / reach, found, scratch)
                bad += int((found != np.array(tint) ** passed).any(axis=1).sum())
            return float(bad)

        name = f"boxes without a shadow, scale {scale:g}, {offset:g} sizes away"
        yield Row(name, "ways whose light is not that of one passage a box", 0.0, wrong)


def rows(count: int) -> Iterator[Row]:
    """All rows of the group."""
    for make in (fresnel, snell, weights, nothing, kept, energy, reciprocity, furnaces, hidden, passages):
        yield from make(count)
