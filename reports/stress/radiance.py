"""Radiance: light 2^k times as bright gives an image 2^k times as bright, to the bit.

From 2^-100 to 2^100, 1e-30 to 1e30: the renderer multiplies and adds light and compares it with 0 alone, and powers of
2 change no mantissa. Other work than that, a threshold or an epsilon in units of radiance, breaks the equality.

What is to be expected: the paper's estimators multiply as ours do. Mitsuba computes in float32, from 1e-38 to 3e38,
whose products leave that range where the light is near its ends.
"""

from collections.abc import Callable, Iterator
from fractions import Fraction

import attrs
import numpy as np

from termwise import reference
from termwise.renderer import render
from termwise.renderer.film import accumulate
from termwise.renderer.jit import kernel
from termwise.renderer.vector import Vec3
from termwise.reports.stress.row import Row
from termwise.scenes.analytic import closed_box, disc_over_plane, furnace, plate, rectangle_light
from termwise.scenes.limits import correct
from termwise.scenes.model import Camera, Object, Scene, Sky
from termwise.scenes.terms import Term

_ADDITIONS = 10**8
Image = Callable[[Scene, Term], np.ndarray]


def _ours(scene: Scene, term: Term) -> np.ndarray:
    return render(scene, term, samples=4, threads=1).mean


def _paper(scene: Scene, term: Term) -> np.ndarray:
    return render(scene, term, variant="paper", samples=4, threads=1).mean


def _mitsuba(scene: Scene, term: Term) -> np.ndarray:
    return reference.render(scene, correct(term, scene.scope), spp=4, seed=0).mean


def _brighter(scene: Scene, factor: float) -> Scene:
    """The scene with all of its light multiplied."""

    def times(color: tuple[float, float, float]) -> tuple[float, float, float]:
        red, green, blue = (factor * each for each in color)
        return red, green, blue

    return attrs.evolve(
        scene,
        lights=tuple(attrs.evolve(each, **{each.sends: times(getattr(each, each.sends))}) for each in scene.lights),
        objects=tuple(attrs.evolve(each, emission=times(each.emission)) for each in scene.objects),
        ambient=attrs.evolve(scene.ambient, color=times(scene.ambient.color)),
        sky=attrs.evolve(scene.sky, color=times(scene.sky.color)),
    )


def _scenes() -> dict[str, tuple[Term, Scene]]:
    return {
        "ambient": ("ambient", disc_over_plane(height=0.5, radius=0.4)),
        "direct": ("direct", rectangle_light(width=1.0, depth=1.0, height=1.0)),
        "direct, photons": ("direct", closed_box()),
        "specular": ("specular", furnace(roughness=0.3, mu_o=0.7)),
    }


def _lit(image: np.ndarray) -> np.ndarray:
    if not image.any():
        raise ValueError("the image is black: nothing is compared")
    return image


def scaling(count: int) -> Iterator[Row]:
    """Numbers of an image whose bits change beyond their exponent."""
    for name, (term, scene) in _scenes().items():
        for power in (-100, -40, -1, 1, 40, 100):

            def changed(image: Image, term: Term = term, scene: Scene = scene, power: int = power) -> float:
                one, other = image(scene, term), image(_brighter(scene, 2.0**power), term)
                return float((np.ldexp(_lit(one), power) != other).sum())

            yield Row(
                f"{name}, times 2^{power}",
                "numbers of the image whose bits change",
                0.0,
                lambda changed=changed: changed(_ours),
                lambda changed=changed: changed(_paper),
                lambda changed=changed: changed(_mitsuba),
            )


def least(count: int) -> Iterator[Row]:
    """Light among the denormals is rounded to their spacing, 2^-1074, once an operation; -0 is no light at all.

    The terms here multiply by factors of at most 1, so that no rounding grows: 16 operations a sample are allowed.
    """
    for name, (term, scene) in _scenes().items():
        if name != "direct, photons":  # a photon's share of such a light is 0

            def lost(term: Term = term, scene: Scene = scene) -> float:
                one, other = _ours(scene, term), _ours(_brighter(scene, 2.0**-1050), term)
                return float(np.abs(np.ldexp(other, 1074) - 2.0**24 * _lit(one)).max())

            yield Row(f"{name}, times 2^-1050", "error in units of 2^-1074", 16.0, lost)

        def light(image: Image, term: Term = term, scene: Scene = scene) -> float:
            _lit(image(scene, term))
            return float((~(image(_brighter(scene, -0.0), term) == 0.0)).sum())

        yield Row(
            f"{name}, times -0",
            "numbers of the image that are not 0",
            0.0,
            lambda light=light: light(_ours),
            lambda light=light: light(_paper),
        )


def _lamp(radiance: float, sky: float) -> Scene:
    """A small lamp before a sky: it covers some pixels, some in part."""
    lamp = plate("lamp", (-0.1, 0.0, -0.1), (0.23, 0.0, 0.0), (0.0, 0.0, 0.27))
    return Scene(
        "lamp",
        Camera((0.0, -1.0, 0.0), (0.0, 0.0, 0.0), fov=60.0),
        (Object("lamp", lamp.mesh, emission=(radiance, radiance, radiance)),),
        sky=Sky((sky, sky, sky)),
        draw_lights=True,
        resolution=(16, 16),
    )


def beside(count: int) -> Iterator[Row]:
    """A pixel of 1e30 changes no bit of those beside it, and is itself right."""
    for radiance in (1e30, 1e-30, 1e300):

        def changed(image: Image, radiance: float = radiance) -> float:
            covered = _lit(image(_lamp(1.0, 0.0), "background"))
            one, other = (image(_lamp(each, 1.0), "background") for each in (1.0, radiance))
            free = covered == 0.0
            right = np.where(free, one, radiance * covered + (1.0 - covered))
            bad = np.where(free, other != one, ~(np.abs(other / right - 1.0) < 1e-12))
            return float(bad.sum())

        yield Row(
            f"a lamp of {radiance:g} beside a sky of 1",
            "numbers of the image that are wrong",
            0.0,
            lambda changed=changed: changed(_ours),
        )


@kernel
def _add(out: np.ndarray, times: int, value: float) -> None:
    for _ in range(times):
        accumulate(out, 0, 0, Vec3(value, value, value))


def additions(count: int) -> Iterator[Row]:
    """1e8 samples of one number: each addition rounds by at most 2^-53 of the sum, so N of them by N 2^-53."""
    for value in (0.1, 1.0 / 3.0, 1e-30, 1e30):

        def drift(value: float = value) -> float:
            out = np.zeros((1, 1, 3))
            _add(out, _ADDITIONS, value)
            return abs(float(Fraction(float(out[0, 0, 0])) / (_ADDITIONS * Fraction(value)) - 1))

        yield Row(f"1e8 times {value:.3g}", "relative error of the sum", _ADDITIONS * 2.0**-53, drift)


def rows(count: int) -> Iterator[Row]:
    """All rows of the group."""
    for make in (scaling, least, beside, additions):
        yield from make(count)
