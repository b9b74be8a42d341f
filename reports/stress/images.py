"""Images on surfaces: a lookup is bilinear whatever the size, the place and the border, and never beyond its texels.

Images of 1 x 1 to 8192 x 8192 texels, places on and beside the border, on centres of texels, and up to 1e6 images away;
the oracle is exact arithmetic of fractions. With u = 2^-53 a place is rounded by 4 u of its distance from the origin,
counted in texels, and a value by that times the difference of texels, and by 8 u of its own. Of a lamp under an image
no face may be without a chance that has a texel which shines.

What is to be expected: Mitsuba computes in float32, and so loses a place 1e6 images away. The paper's program has no
images on surfaces.
"""

import itertools
import re
from collections.abc import Callable, Iterator
from fractions import Fraction
from typing import Any

import numpy as np

from termwise.renderer.lights import emitters_of
from termwise.renderer.textures import Textures, color_at, from_scene
from termwise.reports.stress.row import Row
from termwise.scenes.model import BLACK, Camera, Material, Mesh, Object, Scene
from termwise.scenes.textures import Texture, Wrap

WRAPS: tuple[Wrap, ...] = ("repeat", "clamp")
SIZES = (1, 1), (1, 8192), (8192, 1), (2, 2), (3, 5)
LARGE = 8192, 8192
_UNIT = 2.0**-53
_ENDS = (0.0, -0.0, 1.0, 0.5, 5e-324, 2.0**-149, 1.0 - 2.0**-24, 2.0**-24, -(2.0**-24), 1.0 + 2.0**-23)

Lookup = Callable[[Texture, np.ndarray], np.ndarray]


def image(width: int, height: int, wrap: Wrap = "repeat") -> Texture:
    """Texels of few values at random: large images are tiles of a small one."""
    few = np.random.default_rng(31).random((min(height, 7), min(width, 7), 3)).astype(np.float32)
    tiles = -(-height // len(few)), -(-width // few.shape[1]), 1
    return Texture(np.tile(few, tiles)[:height, :width], wrap)


def ours(texture: Texture, places: np.ndarray) -> np.ndarray:
    """(N, 3) at places (N, 2), each a face of its own whose corners all lie there."""
    uv = np.ascontiguousarray(np.repeat(places[:, None], 3, axis=1))
    height, width, _ = texture.texels.shape
    first, wide, high = (np.array([each], np.int64) for each in (0, width, height))
    number, none = np.zeros(1, np.int32), np.full(1, -1, np.int32)
    repeats = np.array([texture.wrap == "repeat"])
    images = Textures(uv, number, none, none, None, first, wide, high, repeats, texture.texels.ravel())
    return np.array([color_at(images, 0, face, 0.0, 0.0) for face in range(len(places))])


def mitsubas(texture: Texture, places: np.ndarray) -> np.ndarray:
    """The same by the lookup that the references have."""
    from termwise.reference.backend import import_mitsuba

    mi: Any = import_mitsuba()
    import drjit as dr  # after Mitsuba has chosen its LLVM

    from termwise.scenes.textures import downwards, of_two_at_least

    made = mi.load_dict(
        {
            "type": "bitmap",
            "bitmap": mi.Bitmap(of_two_at_least(texture.texels).copy()),  # it takes none that is read-only
            "raw": True,
            "wrap_mode": texture.wrap,
            "accel": False,
        }
    )
    si = dr.zeros(mi.SurfaceInteraction3f, len(places))
    si.uv = mi.Point2f(downwards(places).astype(np.float32).T.copy())
    return np.array(made.eval(si), np.float64).T


def _along(place: Fraction, size: int, wrap: Wrap) -> tuple[int, int, Fraction]:
    at = place * size - Fraction(1, 2)
    below = at.numerator // at.denominator
    pair = (below, below + 1)
    low, high = (each % size if wrap == "repeat" else min(max(each, 0), size - 1) for each in pair)
    return low, high, at - below


def excess(texture: Texture, places: np.ndarray, lookup: Lookup) -> float:
    """The largest error over what roundings make of it."""
    found, worst = lookup(texture, places), 0.0
    height, width, _ = texture.texels.shape
    for (u, v), value in zip(places.tolist(), found.tolist(), strict=True):
        left, right, across = _along(Fraction(u), width, texture.wrap)
        top, bottom, down = _along(1 - Fraction(v), height, texture.wrap)
        # Half of it for each rounding of the place, of its share and of the weights.
        slack = 4.0 * _UNIT * (width * (1.0 + abs(u)) + height * (1.0 + abs(v)))
        for channel in range(3):
            a, b, c, d = (
                Fraction(float(texture.texels[row, column, channel]))
                for row, column in itertools.product((top, bottom), (left, right))
            )
            exact = (1 - down) * ((1 - across) * a + across * b) + down * ((1 - across) * c + across * d)
            # A place that is rounded over a centre has the next texels: all there are.
            spread = texture.high[channel] - texture.low[channel]
            allowed = 8.0 * _UNIT * float(exact) + min(slack, 1.0) * spread
            worst = max(worst, abs(value[channel] - float(exact)) / allowed if allowed else 0.0)
    return worst


def _places(count: int, reach: float, width: int, height: int) -> np.ndarray:
    """(N, 2), as float32 has them: random ones, ends, and centres of texels."""
    rng = np.random.default_rng(32)
    ends = np.array(list(itertools.product(_ENDS, _ENDS)))
    centres = (rng.integers(0, (width, height), (16, 2)) + 0.5) / (width, height)
    places = np.concatenate([rng.uniform(-reach, 1.0 + reach, (max(16, count // 8), 2)), ends, centres])
    return places.astype(np.float32).astype(np.float64)


def rows(count: int) -> Iterator[Row]:
    """Rows of the group."""
    figure = "largest error over its roundings"
    kinds: list[tuple[tuple[int, int], Wrap]] = [*itertools.product(SIZES, WRAPS), (LARGE, "repeat")]
    for (width, height), wrap in kinds:

        def error(lookup: Lookup, width: int = width, height: int = height, wrap: Wrap = wrap) -> float:
            return excess(image(width, height, wrap), _places(count, 0.1, width, height), lookup)

        yield Row(
            f"lookup, {width} x {height}, {wrap}",
            figure,
            1.0,
            lambda error=error: error(ours),
            mitsuba=lambda error=error: error(mitsubas),
        )
    for reach, wrap in itertools.product((1e2, 1e4, 1e6), WRAPS):

        def away(lookup: Lookup, reach: float = reach, wrap: Wrap = wrap) -> float:
            return excess(image(5, 3, wrap), _places(count, reach, 5, 3), lookup)

        yield Row(
            f"lookup, {reach:g} images away, {wrap}",
            figure,
            1.0,
            lambda away=away: away(ours),
            mitsuba=lambda away=away: away(mitsubas),
        )
    for wrap in WRAPS:

        def outside(wrap: Wrap = wrap) -> float:
            texture = image(3, 5, wrap)
            rng, shape = np.random.default_rng(33), (max(64, count // 4), 2)
            sizes = rng.choice([-1.0, 1.0], shape) * 10.0 ** rng.uniform(-40.0, 38.0, shape)
            places = sizes.astype(np.float32).astype(np.float64)
            found = ours(texture, places)
            slack = 8.0 * _UNIT
            good = (found >= np.array(texture.low) * (1 - slack)) & (found <= np.array(texture.high) * (1 + slack))
            return float((~good).sum())

        yield Row(f"places of 1e-40 to 1e38, {wrap}", "values beyond all texels", 0.0, outside)
    yield from _refusals()
    yield from _lamps()


def _refusals() -> Iterator[Row]:
    """What is no reflectance and what is no place is refused; what stands at the ends of the range is not."""
    texels = {
        "NaN": np.nan,
        "infinite": np.inf,
        "negative": -1e-30,
        "above 1": float(np.nextafter(np.float32(1.0), np.float32(2.0))),
        "1e300": 1e300,
    }
    for name, value in texels.items():

        def accepted(value: float = value) -> float:
            values = np.full((3, 4, 3), 0.5)
            values[2, 1, 1] = value
            return _taken(lambda: Material(Texture(values)), "color: texel .* row 2, column 1")

        yield Row(f"a texel that is {name}", "taken, or refused in other words", 0.0, accepted)
    for name, value in (("0", 0.0), ("-0", -0.0), ("1", 1.0), ("denormal", 1e-45)):

        def refused(value: float = value) -> float:
            return 1.0 - _taken(lambda: Material(Texture(np.full((3, 4, 3), value))), "")

        yield Row(f"a texel that is {name}", "refused", 0.0, refused)
    for name, value in (("NaN", np.nan), ("infinite", np.inf), ("1e300", 1e300)):

        def placed(value: float = value) -> float:
            uv = np.zeros((1, 3, 2))
            uv[0, 2, 1] = value
            return _taken(lambda: Mesh.from_arrays(np.eye(3), [[0, 1, 2]], uv=uv), "uv of corner 2 of face 0")

        yield Row(f"a place that is {name}", "taken, or refused in other words", 0.0, placed)

    def without() -> float:
        mesh = Mesh.from_arrays(np.eye(3), [[0, 1, 2]])
        return _taken(lambda: Object("shard", mesh, Material(image(2, 2))), "'shard': color: is an image")

    yield Row("an image on a mesh without uv", "taken, or refused in other words", 0.0, without)


def _lamps() -> Iterator[Row]:
    """Lamps under images: what is no radiance is refused; what shines is sampled; what does not is no lamp."""
    for name, value in {"NaN": np.nan, "infinite": np.inf, "negative": -1e-30, "1e300": 1e300}.items():

        def accepted(value: float = value) -> float:
            values = np.full((3, 4, 3), 0.5)
            values[2, 1, 1] = value
            return _taken(lambda: _lamp(Texture(values)), "emission: texel .* row 2, column 1")

        yield Row(f"a texel of a lamp that is {name}", "taken, or refused in other words", 0.0, accepted)

    def without() -> float:
        mesh = Mesh.from_arrays(np.eye(3), [[0, 1, 2]])
        return _taken(lambda: Object("lamp", mesh, emission=image(2, 2)), "'lamp': emission: is an image")

    yield Row("a lamp's image on a mesh without uv", "taken, or refused in other words", 0.0, without)
    for side in (1, 64):

        def black(side: int = side) -> float:
            return float(_lit(np.zeros((side, side, 3), np.float32)).has_lights)

        yield Row(f"a lamp under a black image of {side} x {side}", "lights", 0.0, black)
    for side in (1, 64, LARGE[0]):

        def bright(side: int = side) -> float:
            texels = np.zeros((side, side, 3), np.float32)
            texels[side // 3, side // 5, 1] = 1e30
            emitters = emitters_of(_lit(texels))
            chances = np.concatenate([np.diff(emitters.cdf), emitters.faces.strength])
            return float((~((chances > 0.0) & np.isfinite(chances))).sum())

        yield Row(f"one bright texel of {side} x {side} of a lamp", "faces without a chance", 0.0, bright)
    for side in (1, LARGE[0]):

        def constant(side: int = side) -> float:
            scene = _lit(np.full((side, side, 3), 0.7, np.float32))
            images = from_scene(scene)
            assert images is not None
            points = np.random.default_rng(34).dirichlet((1.0, 1.0, 1.0), 16)
            found = [color_at(images, 0, face, b[1], b[2]) for face in range(2) for b in points]
            return float(np.abs(np.array(found) / float(np.float32(0.7)) - 1.0).max() / _UNIT)

        yield Row(f"a lamp under {side} x {side} texels of one value", "largest error, units of 2^-53", 8.0, constant)


def _lamp(emission: Texture) -> Object:
    """A square of two triangles."""
    corners = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
    mesh = Mesh.from_arrays(np.pad(corners, ((0, 0), (0, 1))), [[0, 1, 2], [0, 2, 3]], uv=corners)
    return Object("lamp", mesh, Material(BLACK), emission)


def _lit(texels: np.ndarray) -> Scene:
    return Scene("lit", Camera((0.5, 0.5, 3.0), (0.5, 0.5, 0.0), up=(0.0, 1.0, 0.0)), (_lamp(Texture(texels)),))


def _taken(make: Callable[[], object], words: str) -> float:
    """0 where a ValueError has the words in one line."""
    try:
        make()
    except ValueError as error:
        return 0.0 if re.search(words, str(error)) and "\n" not in str(error) else 1.0
    return 1.0
