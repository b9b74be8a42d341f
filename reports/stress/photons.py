"""Photons: irradiance from a map is right or 0, never NaN: none or one, at a point, far away, at edges, behind walls.

Photons are placed by hand, so that the irradiance that they stand for is known. The paper's column is its search for
the k nearest; Mitsuba has no photon map.

What is to be expected: the paper's disc leaves the surface at edges and corners, where a half and three quarters of the
light are lost, and counts photons of whatever object is near: light leaks through doubled walls.
"""

import math
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import attrs
import numpy as np

from termwise.renderer.arrays import SceneArrays, from_scene
from termwise.renderer.photon_density import estimate_irradiance
from termwise.renderer.photon_map import PhotonMap, build, empty
from termwise.renderer.photon_search import nearest_irradiance
from termwise.renderer.photon_tracing import Scattering, emit
from termwise.renderer.rng import root
from termwise.renderer.scratch import new_scratch
from termwise.renderer.surface import Surface
from termwise.renderer.vector import Vec3
from termwise.reports.stress.row import Row
from termwise.scenes.analytic import closed_box, plate
from termwise.scenes.model import Camera, Mesh, Object, Photons, PointLight, Scene

_UP = Vec3(0.0, 0.0, 1.0)
NEAREST = 50
Estimate = Callable[[SceneArrays, PhotonMap, Surface], float]


def _ours(scene: SceneArrays, photons: PhotonMap, surface: Surface) -> float:
    return estimate_irradiance(scene, photons, surface, new_scratch()).x


def _paper(scene: SceneArrays, photons: PhotonMap, surface: Surface) -> float:
    return nearest_irradiance(photons, surface, NEAREST, np.empty(NEAREST), np.empty(NEAREST, np.int64)).x


def _row(name: str, figure: str, limit: float, measured: Callable[[Estimate], float]) -> Row:
    return Row(name, figure, limit, lambda: measured(_ours), lambda: measured(_paper))


def _plate(name: str = "plate", z: float = 0.0) -> Object:
    """[0, 1]² facing up; face 0 has x >= y, face 1 x <= y."""
    return plate(name, (0.0, 0.0, z), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))


def _scene(*objects: Object) -> SceneArrays:
    return from_scene(Scene("photons", Camera((0.0, -3.0, 1.0), (0.0, 0.0, 0.0)), objects))


def _at(x: float, y: float, z: float = 0.0, *, face: int = 0, thing: int = 0, normal: Vec3 = _UP) -> Surface:
    return Surface(Vec3(x, y, z), normal, normal, face, thing, 1.0, 0.0, 0.0)


def _map(xy: np.ndarray, power: float, radius: float, z: float = 0.0) -> PhotonMap:
    """Photons on the plate at (P, 2), each from above and of the same power."""
    face = np.where(xy[:, 0] >= xy[:, 1], 0, 1).astype(np.int32)
    above = np.tile([0.0, 0.0, 1.0], (len(xy), 1))
    position = np.column_stack([xy, np.full(len(xy), z)])
    return build(position, above, np.full((len(xy), 3), power), face, radius)


def _grid(n: int) -> np.ndarray:
    middle = (np.arange(n) + 0.5) / n
    return np.stack(np.meshgrid(middle, middle), axis=-1).reshape(-1, 2)


def _off(value: float, expected: float) -> float:
    return abs(value / expected - 1.0)


def few(count: int) -> Iterator[Row]:
    """No photon is no light; one is its kernel, `Phi 3 / (pi r²) (1 - d²/r²)²`; many at one point are so many of it."""
    scene = _scene(_plate())
    # The mass of the kernel, and sums of `count` equal numbers: some hundred roundings.
    precision = 1e-12
    yield _row("no photon", "irradiance", 0.0, lambda e: abs(e(scene, empty(), _at(0.5, 0.4))))
    for radius in (0.3, 1e-3, 1e-6, 1e-12):

        def one(estimate: Estimate, radius: float = radius) -> float:
            found = estimate(scene, _map(np.array([[0.5 + 0.5 * radius, 0.4]]), 2.0, radius), _at(0.5, 0.4))
            distance = (0.5 + 0.5 * radius) - 0.5  # as it is stored
            return _off(found, 6.0 / (math.pi * radius**2) * (1.0 - (distance / radius) ** 2) ** 2)

        # The position of the photon is rounded to 2^-53 of its coordinate, which is known; the difference is exact.
        yield _row(f"one photon, radius {radius:g}", "relative error", precision, one)

    def together(estimate: Estimate) -> float:
        many = _map(np.tile([[0.5, 0.25]], (count, 1)), 2.0, 0.1)
        return _off(estimate(scene, many, _at(0.5, 0.25)), count * 6.0 / (math.pi * 0.1**2))

    yield _row(f"{count} photons at one point", "relative error", precision, together)

    def refused() -> float:
        accepted = 0
        for radius in (0.0, -1.0, math.nan, math.inf):
            try:
                Photons(radius=radius)
                accepted += 1
            except ValueError as error:
                accepted += "radius" not in str(error)
        return float(accepted)

    yield Row("radius of 0, below, NaN, infinite", "of 4, those that are not refused by name", 0.0, refused)


def radii(count: int) -> Iterator[Row]:
    """A radius far beyond the scene gives the mean, all flux over all area: the kernel is flat to 4 / r² across it."""
    scene = _scene(_plate())
    xy = np.random.default_rng(31).random((count, 2))
    for radius in (1e2, 1e4, 1e8):
        yield _row(
            f"radius {radius:g} times the scene",
            "relative error of the mean",
            4.0 / radius**2 + 1e-9,
            lambda e, radius=radius: _off(e(scene, _map(xy, 1.0 / count, radius), _at(0.3, 0.2)), 1.0),
        )


def borders(count: int) -> Iterator[Row]:
    """A constant irradiance is estimated up to edges and corners: the kernel is divided by its mass on the surface.

    Photons on a grid of spacing h = 1 / n: a midpoint rule, whose error at a cut kernel is below 2 (h / r)² and, for
    the cut through it, h / r times the slope of the kernel there, 0: twice the former is allowed.
    """
    scene = _scene(_plate())
    n = 200
    xy = _grid(n)
    for radius in (0.05, 0.2, 0.7):
        for name, x, y in (
            ("middle", 0.5, 0.4),
            ("edge", 0.5, 0.0),
            ("corner", 1.0, 0.0),
            ("near an edge", 0.5, 0.3 * radius),
        ):
            yield _row(
                f"{name}, radius {radius:g}",
                "relative error of constant irradiance",
                4.0 / (n * radius) ** 2,
                lambda e, x=x, y=y, radius=radius: _off(e(scene, _map(xy, 1.0 / n**2, radius), _at(x, y)), 1.0),
            )


def elsewhere(count: int) -> Iterator[Row]:
    """Queries outside of the grid find nothing, and end: no index overflows."""
    scene = _scene(_plate())
    photons = _map(_grid(20), 1.0, 0.1)

    def found() -> float:
        bad = 0
        for far in (2.0, -2.0, 1e6, -1e18, 1e100, -1e300):
            for point in ((far, 0.5, 0.0), (0.5, far, 0.0), (0.5, 0.5, far), (far, far, far)):
                bad += _ours(scene, photons, _at(*point)) != 0.0
        return float(bad)

    yield Row("queries outside the grid", "of 24, those that find light", 0.0, found)


def walls(count: int) -> Iterator[Row]:
    """No light crosses a wall: not from one object to another, nor through a thin one from its other side."""
    photons = _grid(40)
    for gap in (1e-2, 1e-4, 1e-6, 1e-12):
        double = _scene(_plate(), _plate("upper", gap))
        yield _row(
            f"doubled walls {gap:g} apart",
            "irradiance that leaks, of 1",
            0.0,
            lambda e, gap=gap, double=double: e(
                double, _map(photons, 1.0 / 1600, 0.1), _at(0.5, 0.4, gap, face=2, thing=1)
            ),
        )
        lower = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
        slab = np.concatenate([lower + (0.0, 0.0, gap), lower])
        mesh = Mesh.from_arrays(slab, [[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]])
        thin = _scene(Object("slab", mesh))
        yield _row(
            f"a wall {gap:g} thin",
            "irradiance of its dark side, of 1",
            0.0,
            lambda e, gap=gap, thin=thin: e(
                thin, _map(photons, 1.0 / 1600, 0.1, gap), _at(0.5, 0.4, face=2, normal=Vec3(0.0, 0.0, -1.0))
            ),
        )


def _emitted(scene: Scene, count: int, threads: int) -> PhotonMap:
    with ThreadPoolExecutor(threads) as pool:
        return emit(
            from_scene(scene),
            root(1, 0),
            0,
            count=count,
            radius=0.2,
            shape="simpson",
            rule=Scattering(0.0, True, False, independent=False, aimed=False),
            first_hits=True,
            pool=pool,
            scratch=new_scratch,
        )


def tracing(count: int) -> Iterator[Row]:
    """The map of any number of threads has the same bytes; lights in and on walls make no photon that is no number."""
    for threads in (2, 3, 8):

        def differ(threads: int = threads) -> float:
            one, many = (_emitted(closed_box(), 4 * count, n) for n in (1, threads))
            fields = ("position", "direction", "power", "face", "start")
            return float(sum(getattr(one, each).tobytes() != getattr(many, each).tobytes() for each in fields))

        yield Row(f"{threads} threads", "of 5 arrays, those with other bytes", 0.0, differ)

    for albedo in (0.1, 0.5, 0.9):
        # Landings of a photon are geometric: their number has the mean 1 / (1 - albedo), over which its deviation is
        # the root of the albedo; 5 of them are allowed to the mean of all photons. They share one low-discrepancy
        # sequence, which brings it to 0.32 to 0.72 of that (200 seeds). Black walls keep no photon: 0 is left out.
        def flux(albedo: float = albedo) -> float:
            power = _emitted(closed_box(albedo=albedo), count, 1).power[0].sum()
            return _off(float(power), 4.0 * math.pi / (1.0 - albedo))

        limit = 5.0 * math.sqrt(albedo / count) + 1e-12
        yield Row(f"flux in a closed box of albedo {albedo:g}", "relative error", limit, flux)

    def runaway() -> float:
        return float((~np.isfinite(_emitted(closed_box(albedo=1.0), count, 1).power)).sum())

    yield Row("photons in a closed box of albedo 1", "powers that are no numbers", 0.0, runaway)

    for name, position in {
        "inside": (0.3, -0.2, 0.4),
        "on a wall": (0.3, -0.2, -1.0),
        "on an edge": (0.3, -1.0, -1.0),
        "in a corner": (-1.0, -1.0, -1.0),
        "1e-12 off a wall": (0.3, -0.2, -1.0 + 1e-12),
    }.items():

        def stray(position: tuple[float, float, float] = position) -> float:
            scene = attrs.evolve(closed_box(), lights=(PointLight(position, (1.0, 1.0, 1.0)),))
            photons = _emitted(scene, count, 1)
            good = np.isfinite(photons.power).all(axis=0) & (np.abs(photons.position) <= 1.0 + 2.0**-50).all(axis=0)
            return float((~good).sum())

        yield Row(f"light {name}", "photons that are no numbers or lie outside the box", 0.0, stray)


def rows(count: int) -> Iterator[Row]:
    """All rows of the group, of `count` photons or so each."""
    for make in (few, radii, borders, elsewhere, walls, tracing):
        yield from make(count)
