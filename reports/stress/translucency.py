"""Translucency: what crosses and what stays are all of the light, at any share and scale.

A number that chooses a side leaves one in [0, 1) for what follows, whatever the share; from each side a sheet shows
its share of the one irradiance, to rounding; a white sheet under light from all around is invisible; photons in a
closed body land `4 pi I / (1 - rho (1 - s))` on its walls, and what has crossed them lands nowhere.

What is to be expected: the paper has no translucent surfaces, and Mitsuba's are float32.
"""

import math
from collections.abc import Iterator

import attrs
import numpy as np

from termwise.renderer import Engine, find
from termwise.renderer.arrays import MAX_SURVIVAL
from termwise.renderer.material import side_of
from termwise.renderer.photon_tracing import Scattering, emit
from termwise.renderer.rng import root
from termwise.reports.stress.row import Row
from termwise.scenes.analytic import closed_box, plate
from termwise.scenes.model import Ambient, Camera, Material, PointLight, Scene

_EPS = 2.0**-52
# The ends of what the sampler of 32 bits can give, and of shares.
_NUMBERS = (0.0, 2.0**-33, 0.1, 0.5, 1.0 - 2.0**-33, 1.0 - 2.0**-53)
_SHARES = (0.0, 5e-324, 1e-9, 0.5, 1.0 - 2.0**-53, 1.0)


def sides(count: int) -> Iterator[Row]:
    """Of shares 0 and 1 one side alone is chosen; the numbers of each side fill [0, 1) again."""
    for share in _SHARES:

        def wrong(share: float = share) -> float:
            numbers = np.concatenate([_NUMBERS, np.random.default_rng(31).random(count)])
            found = [side_of(share, u) for u in numbers.tolist()]
            out = sum(not 0.0 <= left < 1.0 for _, left in found)
            crosses = np.array([crosses for crosses, _ in found])
            aside = crosses != (numbers < share)
            # Stretched by the share of its side, in order: what is left is the number's place within it.
            back = np.array([share * left if each else share + (1.0 - share) * left for each, left in found])
            return float(out + aside.sum() + (np.abs(back - numbers) > 4.0 * _EPS).sum())

        yield Row(f"sides, share {share:g}", "numbers whose side or rest is wrong", 0.0, wrong)


def _sheet(share: float, scale: float, *, above: bool) -> Scene:
    material = Material((0.8, 0.5, 0.2), translucency=share)
    corner, first, second = (-3.0 * scale, -3.1 * scale, 0.0), (6.0 * scale, 0.0, 0.0), (0.0, 6.2 * scale, 0.0)
    height = 3.0 * scale if above else -3.0 * scale
    return Scene(
        "sheet",
        Camera((0.3 * scale, -4.0 * scale, height), (0.3 * scale, 0.2 * scale, 0.0), fov=20.0, pixel="centre"),
        (plate("sheet", corner, first, second, material),),
        (PointLight((0.5 * scale, 0.25 * scale, -1.5 * scale), (3.0 * scale**2,) * 3),),
        resolution=(4, 4),
        scope="first-hit",
    )


def _image(scene: Scene, term: str) -> np.ndarray:
    with Engine(scene, threads=1, without=("open",)) as engine:
        *_, (_, image, _) = engine.prefixes(find(term), samples=4, seed=1, replicate=0)
    return image


def leaves(count: int) -> Iterator[Row]:
    """`w s E / pi` from the side without the light, `w (1 - s) E / pi` from that with it, by long doubles.

    Points of a sheet, of the order of 10 of its units, are rounded by a few 2^-53 of that; E falls as the cube of the
    distance, which is at least 1.5: within 64 roundings.
    """
    for scale in (1e-6, 1.0, 1e6):
        for share in (1e-12, 0.5, 1.0 - 2.0**-53):
            for above in (True, False):

                def error(scale: float = scale, share: float = share, above: bool = above) -> float:
                    scene = _sheet(share, scale, above=above)
                    x = (np.arange(4) + 0.5) / 4
                    ways = scene.camera.rays(np.stack(np.meshgrid(x, x), axis=-1), aspect=1.0).astype(np.longdouble)
                    eye = np.array(scene.camera.position, np.longdouble)
                    points = eye - (eye[2] / ways[..., 2:]) * ways
                    offset = np.array(scene.lights[0].centre, np.longdouble) - points
                    e = np.abs(offset[..., 2]) / np.linalg.norm(offset, axis=-1) ** 3 * 3.0 * np.longdouble(scale) ** 2
                    part = np.longdouble(share) if above else 1.0 - np.longdouble(share)
                    right = part * e[..., None] * np.array(scene.objects[0].material.color) / np.longdouble(math.pi)
                    return float(np.abs(_image(scene, "direct") / right - 1.0).max() / _EPS)

                side = "without" if above else "with"
                name = f"sheet, scale {scale:g}, share {share:g}, the side {side} the light"
                yield Row(name, "relative error in units of 2^-52", 64.0, error)


def furnaces(count: int) -> Iterator[Row]:
    """A white sheet under the ambient light 1: nothing is lost, none is gained."""
    for scale in (1e-6, 1.0, 1e6):
        for share in _SHARES[1:]:

            def error(scale: float = scale, share: float = share) -> float:
                scene = attrs.evolve(_sheet(share, scale, above=True), ambient=Ambient((1.0, 1.0, 1.0), 9.0 * scale))
                white = attrs.evolve(scene.objects[0], material=Material((1.0, 1.0, 1.0), translucency=share))
                return float(np.abs(_image(attrs.evolve(scene, objects=(white,)), "ambient") - 1.0).max() / _EPS)

            yield Row(f"furnace, scale {scale:g}, share {share:g}", "error in units of 2^-52", 0.0, error)


def photons(count: int) -> Iterator[Row]:
    """Flux that lands on the walls of a closed box over what its reflections make of it, in standard errors."""
    for albedo in (0.5, 0.95):
        for share in (0.0, 0.25, 1.0):

            def off(albedo: float = albedo, share: float = share) -> float:
                scene = closed_box(albedo=albedo)
                walls = attrs.evolve(scene.objects[0], material=Material((albedo,) * 3, translucency=share))
                # A plate out of reach of the light: of a scene that is opaque kernels are others.
                away = plate("away", (90.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), Material(translucency=0.5))
                scene = attrs.evolve(scene, objects=(walls, away))
                rule = Scattering(0.0, True, False, True, False, MAX_SURVIVAL)
                sums = []
                with Engine(scene, threads=1) as engine:
                    for index in range(16):
                        landed = emit(
                            engine.arrays,
                            root(7, 0),
                            index,
                            count=max(64, count // 4),
                            radius=0.1,
                            shape="simpson",
                            rule=rule,
                            first_hits=True,
                            pool=engine.pool,
                            scratch=engine._scratch,
                        )
                        sums.append(landed.power[:, 0].sum())
                right = 4.0 * math.pi / (1.0 - albedo * (1.0 - share))
                error = np.std(sums, ddof=1) / 4.0
                # What crosses may meet the plate: as seen from the box it is a ten-thousandth of all around.
                return float(max(abs(np.mean(sums) - right) - 1e-3 * right, 0.0) / max(error, 1e-9 * right))

            yield Row(f"photons in a box, albedo {albedo:g}, share {share:g}", "standard errors", 5.0, off)


def rows(count: int) -> Iterator[Row]:
    """All rows."""
    for group in (sides, leaves, furnaces, photons):
        yield from group(count)
