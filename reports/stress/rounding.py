"""Rounding: no pixel loses more digits than its inputs do, and the order of its samples costs it their roundings alone.

The same random numbers are rendered with every vertex, camera and light number of the scene moved by one rounding,
2^-52 of itself at random signs, 8 times over: the relative deviation of a pixel is its rounding error, apart from
noise (the random perturbation of Monte Carlo arithmetic, Parker 1997, and CESTAC, Vignes 1993, at the inputs; what
follows rounds otherwise each time). Some pixels are ill-conditioned by nature, at grazing angles above all. The same
signs at 2^-30, where rounding is next to nothing, say how much: the `growth` is the deviation at 2^-52 over 2^-22 of
that at 2^-30. It is about 1 where inputs alone matter, large where an algorithm cancels, as `sqrt(1 - sin²)` does for a
cosine near 0, and small where a number with fewer digits does not feel 2^-52. A row's figure is it or its inverse.

Of a backward stable algorithm with 64 roundings on each of two rays, the camera's and the light's, every one as if half
of a perturbation of an input at a random sign, the growth is `sqrt(1 + 2 64 / 4)`, the limit of its median; that of the
99.9 % quantile is larger by the root of that of F(7, 7), the ratio of two variances of 8 draws. A pixel that changes by
more than 2^-12 of itself has a sample that goes another way; these are counted apart. What is to be expected: the
paper's estimators compute as ours do.
"""

import functools
import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import attrs
import numpy as np
from scipy import stats
from scipy.spatial.transform import Rotation

from termwise.renderer import Engine, find
from termwise.renderer.arrays import from_scene
from termwise.renderer.geometry.bvh import Tree
from termwise.reports.stress.row import Row
from termwise.scenes.load import load
from termwise.scenes.model import Light, Mesh, Scene

UNIT, LEVER = 2.0**-52, 2.0**-30
DRAWS = 8
FLIP = 2.0**-12
MEDIAN = math.sqrt(1.0 + 2 * 64 / 4)
HIGH = MEDIAN * math.sqrt(stats.f.ppf(0.999, DRAWS - 1, DRAWS - 1))
_PASSES = 4
_SAMPLES = 16
_SIDE = 48
_TURN = Rotation.from_euler("zyx", (0.7, 0.4, -0.5)).as_matrix()
_SHIFT = np.array([0.9, -1.3, 1.7])

Image = Callable[[Scene], np.ndarray]
Values = tuple[float, ...]


class Spread(NamedTuple):
    """What perturbations make of an image; (H, W) each.

    Attributes
    ----------
    relative : deviation at 2^-52 over the mean, of all channels together; NaN where the pixel is black.
    growth : of it over what the inputs' condition alone gives; NaN where that is nothing or a sample flips.
    flips : bool, whether a sample goes another way at 2^-52.
    """

    relative: np.ndarray
    growth: np.ndarray
    flips: np.ndarray


def perturbed(scene: Scene, unit: float, rng: np.random.Generator) -> Scene:
    """The scene with vertices, camera and lights `x (1 ± unit)`."""

    def shake(values: np.ndarray | Values) -> np.ndarray:
        return np.asarray(values) * (1.0 + unit * rng.choice([-1.0, 1.0], np.shape(values)))

    def three(values: Values) -> tuple[float, float, float]:
        x, y, z = shake(values).tolist()
        return x, y, z

    camera = scene.camera
    return attrs.evolve(
        scene,
        objects=tuple(
            attrs.evolve(
                thing,
                # Past `from_arrays`, which would round to float32.
                mesh=attrs.evolve(thing.mesh, vertices=shake(thing.mesh.vertices)),
                emission=three(thing.emission),
            )
            for thing in scene.objects
        ),
        camera=attrs.evolve(camera, position=three(camera.position), target=three(camera.target)),
        lights=tuple(
            _with(light, three, "position", "target", "center", "direction", light.sends) for light in scene.lights
        ),
        ambient=attrs.evolve(scene.ambient, color=three(scene.ambient.color)),
        sky=attrs.evolve(scene.sky, color=three(scene.sky.color)),
    )


def moved(scene: Scene) -> Scene:
    """The scene, turned and shifted to where no coordinate is 0: a perturbation of itself would not move that."""

    def place(points: np.ndarray | Values) -> np.ndarray:
        return np.asarray(points) @ _TURN.T + _SHIFT

    def three(point: Values) -> tuple[float, float, float]:
        x, y, z = place(point).tolist()
        return x, y, z

    def turned(mesh: Mesh) -> Mesh:
        return Mesh.from_arrays(place(mesh.vertices), mesh.faces, smooth=mesh.normals is not None)

    camera = scene.camera
    up = _TURN @ np.array(camera.up)
    return attrs.evolve(
        scene,
        objects=tuple(attrs.evolve(thing, mesh=turned(thing.mesh)) for thing in scene.objects),
        camera=attrs.evolve(
            camera,
            position=three(camera.position),
            target=three(camera.target),
            up=(float(up[0]), float(up[1]), float(up[2])),
        ),
        lights=tuple(
            _with(_with(light, three, "position", "target", "center"), lambda way: tuple(_TURN @ way), "direction")
            for light in scene.lights
        ),
    )


def _with(light: Light, change: Callable[[Values], Values], *fields: str) -> Light:
    """A light with those of the fields changed that it has."""
    return attrs.evolve(light, **{name: change(getattr(light, name)) for name in fields if hasattr(light, name)})


def spread(image: Image, scene: Scene) -> Spread:
    """Render a scene at both sizes of perturbation, 8 times each.

    Parameters
    ----------
    image : gives (H, W, 3) of a scene, the same random numbers each time.
    scene : see `moved`.
    """

    def deviation(unit: float) -> tuple[np.ndarray, np.ndarray]:
        draws = np.stack([image(perturbed(scene, unit, np.random.default_rng(51 + draw))) for draw in range(DRAWS)])
        size = np.linalg.norm(draws.mean(axis=0), axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = np.linalg.norm(draws.std(axis=0, ddof=1), axis=-1) / size
            flips = np.linalg.norm(np.ptp(draws, axis=0), axis=-1) > FLIP * size
        return relative, flips

    (fine, flips), (coarse, apart) = deviation(UNIT), deviation(LEVER)
    with np.errstate(divide="ignore", invalid="ignore"):
        growth = fine / UNIT / (coarse / LEVER)
    return Spread(fine, np.where(flips | apart | (coarse == 0.0), np.nan, growth), flips)


class _Samples(Engine):
    """An engine that keeps the image of each sample, if asked to.

    Its tree is that of the scene before it was perturbed, whose leaves are float32: others would compile every kernel
    a second time. Weights of a hit are so of the vertices as they were, its point and normal of those that moved.
    """

    def __init__(self, scene: Scene, tree: Tree) -> None:
        # As many samples a pixel, however the scene is perturbed.
        super().__init__(scene, threads=1, without=("counts",))
        self.arrays = self.arrays._replace(geometry=self.arrays.geometry._replace(tree=tree))
        self.images: list[np.ndarray] | None = None

    def _add(self, driver, inputs, key, items, begin, end, out, cancel):
        super()._add(driver, inputs, key, items, begin, end, out, cancel)
        if self.images is not None:
            for index in range(begin.min(), end.max()):
                alone, first, last = np.zeros_like(out), np.clip(index, begin, end), np.clip(index + 1, begin, end)
                super()._add(driver, inputs, key, items, first, last, alone, cancel)
                self.images.append(alone)


@functools.cache
def _still() -> tuple[Scene, Tree]:
    """The scene, and its tree."""
    scene = attrs.evolve(load("monkey"), resolution=(_SIDE, _SIDE))
    scene = moved(attrs.evolve(scene, photons=attrs.evolve(scene.photons, count=5000, radius=0.3)))
    return scene, from_scene(scene).geometry.tree


def _image(scene: Scene, term: str, variant: str | None) -> np.ndarray:
    with _Samples(scene, _still()[1]) as engine:
        *_, (_, image, _) = engine.prefixes(find(term, variant), samples=_PASSES, seed=1, replicate=0)
        return image


@functools.cache
def _spread(term: str, variant: str | None) -> Spread:
    return spread(lambda scene: _image(scene, term, variant), _still()[0])


def quantile(found: Spread, share: float) -> float:
    """Of the growth, or of its inverse where that is larger, over the pixels that have one."""
    growth = found.growth[~np.isnan(found.growth)]
    with np.errstate(divide="ignore"):
        return float(np.quantile(np.maximum(growth, 1.0 / growth), share, method="higher"))


def _permuted(term: str, variant: str | None) -> tuple[np.ndarray, np.ndarray]:
    """Sums of an image's samples from the first to the last, and from the last to the first."""
    with _Samples(*_still()) as engine:
        engine.images = []
        list(engine.prefixes(find(term, variant), samples=_SAMPLES, seed=1, replicate=0))
        forwards, backwards = (functools.reduce(np.add, order) for order in (engine.images, engine.images[::-1]))
    return forwards, backwards


def rows(count: int) -> Iterator[Row]:
    """All rows of the group; the size of the images is fixed, for the map."""
    for name, term, variant, paper in (
        ("ambient", "ambient", None, "paper"),
        ("direct", "direct", None, None),
        ("direct, photons", "direct", "photon-map", "paper"),
        ("specular", "specular", None, "paper"),
    ):

        def both(
            measured: Callable[[str, str | None], float],
            term: str = term,
            variant: str | None = variant,
            paper: str | None = paper,
        ) -> tuple[Callable[[], float], Callable[[], float] | None]:
            return lambda: measured(term, variant), (lambda: measured(term, paper)) if paper else None

        for word, share, limit in (("median", 0.5, MEDIAN), ("99.9 %", 0.999, HIGH)):

            def growth(term: str, variant: str | None, share: float = share) -> float:
                return quantile(_spread(term, variant), share)

            yield Row(
                f"{name}, {word}",
                "deviation at 2^-52 over 2^-22 of that at 2^-30, or its inverse",
                limit,
                *both(growth),
                picture=(lambda term=term, variant=variant: _spread(term, variant).relative) if share == 0.5 else None,
            )

        # A sample flips where a ray passes an edge by 2^-52: of all 10^4 of them, 10^-9.
        def flips(term: str, variant: str | None) -> float:
            return float(_spread(term, variant).flips.sum())

        yield Row(f"{name}, flips", f"pixels of {_SIDE * _SIDE} of which a sample goes another way", 0.0, *both(flips))

        # Either order of N numbers that are not negative errs by N - 1 roundings at most.
        def order(term: str, variant: str | None) -> float:
            forwards, backwards = _permuted(term, variant)
            lit = forwards > 0.0
            return float(np.abs(backwards[lit] / forwards[lit] - 1.0).max())

        limit = 2 * _SAMPLES * 2.0**-53
        yield Row(f"{name}, order of samples", f"relative change, {_SAMPLES} of them reversed", limit, *both(order))
