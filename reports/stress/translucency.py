"""Translucency: what crosses and what stays are all of the light, at any share and scale.

A number that chooses a side leaves one in [0, 1) for what follows, whatever the share; from each side a sheet shows
its share of the one irradiance, to rounding; a white sheet under light from all around is invisible.

What is to be expected: the paper has no translucent surfaces, and Mitsuba's are float32.
"""

from collections.abc import Iterator

import numpy as np

from termwise.renderer.arrays import SceneArrays, from_scene
from termwise.renderer.jit import kernel
from termwise.renderer.material import diffuse_weight, side_of
from termwise.renderer.scratch import Scratch, new_scratch
from termwise.renderer.sobol import Sampler
from termwise.renderer.surface import Surface
from termwise.renderer.terms.ambient import COSINE, ambient_radiance
from termwise.renderer.terms.direct import LIGHT, light_irradiance
from termwise.renderer.vector import Vec3, mul, put
from termwise.reports.stress.row import Row
from termwise.scenes.analytic import plate
from termwise.scenes.model import Ambient, Camera, Color, Material, PointLight, Scene

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

        yield Row(f"sides, share {share:.17g}", "numbers whose side or rest is wrong", 0.0, wrong)


def _sheet(share: float, scale: float, *, color: Color = (0.8, 0.5, 0.2)) -> Scene:
    """In the plane z = 0, a point light below, under the ambient light 1."""
    material = Material(color, translucency=share)
    corner, first, second = (-3.0 * scale, -3.1 * scale, 0.0), (6.0 * scale, 0.0, 0.0), (0.0, 6.2 * scale, 0.0)
    return Scene(
        "sheet",
        Camera((0.0, -4.0 * scale, 3.0 * scale), (0.0, 0.0, 0.0)),
        (plate("sheet", corner, first, second, material),),
        (PointLight((0.5 * scale, 0.25 * scale, -1.5 * scale), (3.0 * scale**2,) * 3),),
        ambient=Ambient((1.0, 1.0, 1.0), 9.0 * scale),
        scope="first-hit",
    )


@kernel
def _shown(
    scene: SceneArrays, side: float, points: np.ndarray, direct: bool, out: np.ndarray, scratch: Scratch
) -> None:
    """Direct or ambient light (N, 3) that points (N, 2) of the sheet show on a side, by a sample each."""
    normal = Vec3(0.0, 0.0, side)
    for i in range(len(points)):
        surface = Surface(Vec3(points[i, 0], points[i, 1], 0.0), normal, normal, 0, 0, side, 0.0, 0.0)
        sampler = Sampler(np.uint64(i), np.uint32(i))
        if direct:
            light = light_irradiance(scene, surface, sampler, LIGHT, scratch)
            put(out, i, mul(diffuse_weight(scene, surface), light))
        else:
            put(out, i, ambient_radiance(scene, COSINE, surface, False, sampler, scratch))


def _seen(scene: Scene, above: bool, points: np.ndarray, *, direct: bool) -> np.ndarray:
    out = np.zeros((len(points), 3))
    arrays = from_scene(scene, without=("open",))
    _shown(arrays, 1.0 if above else -1.0, np.ascontiguousarray(points), direct, out, new_scratch())
    return out


def _places(count: int, scale: float) -> np.ndarray:
    """Points (N, 2) of the sheet's first face."""
    return scale * np.random.default_rng(32).uniform((0.0, -2.0), (2.0, 0.0), (min(count, 256), 2))


def leaves(count: int) -> Iterator[Row]:
    """`w s E / pi` from the side without the light, `w (1 - s) E / pi` from that with it, by long doubles.

    Some ten products and one root, each rounded; 1 - s is exact where s is.
    """
    for scale in (1e-6, 1.0, 1e6):
        for share in (1e-12, 0.5, 1.0 - 2.0**-53):
            for above in (True, False):

                def error(scale: float = scale, share: float = share, above: bool = above) -> float:
                    scene, points = _sheet(share, scale), _places(count, scale)
                    (light,) = scene.lights
                    assert isinstance(light, PointLight)
                    at = np.column_stack([points, np.zeros(len(points))]).astype(np.longdouble)
                    offset = np.array(light.position, np.longdouble) - at
                    square = np.sum(offset * offset, axis=1)
                    e = np.abs(offset[:, 2]) / (square * np.sqrt(square)) * np.longdouble(light.intensity[0])
                    part = np.longdouble(share) if above else 1.0 - np.longdouble(share)
                    weight = np.array(scene.diffuse_weight(scene.objects[0].material), np.longdouble)
                    right = part * e[:, None] * weight / (4.0 * np.arctan(np.longdouble(1.0)))
                    return float(np.abs(_seen(scene, above, points, direct=True) / right - 1.0).max() / _EPS)

                side = "without" if above else "with"
                name = f"sheet, scale {scale:g}, share {share:.17g}, the side {side} the light"
                yield Row(name, "relative error in units of 2^-52", 16.0, error)


def furnaces(count: int) -> Iterator[Row]:
    """A white sheet under the ambient light 1, by samples of both sides: nothing is lost, none is gained."""
    for scale in (1e-6, 1.0, 1e6):
        for share in _SHARES[1:]:

            def error(scale: float = scale, share: float = share) -> float:
                scene = _sheet(share, scale, color=(1.0, 1.0, 1.0))
                found = _seen(scene, True, _places(count, scale), direct=False)
                return float(np.abs(found - 1.0).max() / _EPS)

            yield Row(f"furnace, scale {scale:g}, share {share:.17g}", "error in units of 2^-52", 0.0, error)


def rows(count: int) -> Iterator[Row]:
    """All rows."""
    for group in (sides, leaves, furnaces):
        yield from group(count)
