"""Before an engine is believed: one lit square, whose image is known, three times.

The square shines with a radiance of its own in each channel, its edges on those of pixels, nearer to the top left
corner; a parallelogram in the opposite corner has slanted edges, where sampling of a pixel's area has noise. So a
single scene shows the size of the image, which way is up, the order of the channels, the unit, a shift of one pixel, a
filter wider than one; and, rendered with one seed twice and with another, whether seeds do what they should.
"""

import hashlib
import itertools
import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from termwise.reports.engines import running
from termwise.reports.engines.asked import Asked
from termwise.reports.engines.engine import Engine, EngineError
from termwise.scenes.model import Camera, Mesh, Object, Scene
from termwise.scenes.store import cache_folder, write_atomically

WIDTH, HEIGHT = 24, 16
LEFT, TOP, SIDE = 3, 2, 6
"""Of the square, in pixels."""
RADIANCE = (0.25, 0.5, 1.0)
SAMPLES = 16
_NEAR, _EDGE = 0.02, 0.05
"""What an image may be off by, of the largest radiance; and beside the edges, which float32 may move."""
_FACTORS = {"π": math.pi, "1/π": 1 / math.pi, "4π": 4 * math.pi, "2": 2.0, "1/2": 0.5, "4": 4.0, "1/4": 0.25}


def scene() -> Scene:
    """The square and the parallelogram, on a plane at distance 1, through which a pixel is 1 / 8 wide."""
    pixel = 1.0 / 8.0
    camera = Camera((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), fov=2.0 * math.degrees(math.atan(WIDTH / 2 * pixel)))

    def shape(name: str, corners: list[tuple[float, float]]) -> Object:
        # Seen along y: x to the right, z up; towards the camera, which looks along +y, fronts go clockwise.
        points = [((x - WIDTH / 2) * pixel, 1.0, (HEIGHT / 2 - y) * pixel) for x, y in corners]
        return Object(name, Mesh.from_arrays(points, [[0, 1, 2], [0, 2, 3]]), emission=RADIANCE)

    low, right = TOP + SIDE, LEFT + SIDE
    square = shape("square", [(LEFT, low), (right, low), (right, TOP), (LEFT, TOP)])
    slanted = shape("parallelogram", [(13.3, 13.6), (19.8, 14.3), (22.1, 9.7), (15.6, 9.0)])
    return Scene("probe", camera, (square, slanted), resolution=(WIDTH, HEIGHT), draw_lights=True)


def expected() -> tuple[np.ndarray, np.ndarray]:
    """The image (H, W, 3), and where it is known (H, W): elsewhere is the parallelogram."""
    image = np.zeros((HEIGHT, WIDTH, 3))
    image[TOP : TOP + SIDE, LEFT : LEFT + SIDE] = RADIANCE
    known = np.ones((HEIGHT, WIDTH), bool)
    known[8:, 12:] = False
    return image, known


def probe(engine: Engine, *, threads: int, again: bool = False) -> tuple[str, ...]:
    """Probe an engine, unless this version of it was found to be right before; returns what must be said of it.

    Raises
    ------
    EngineError : it cannot be run; its image has another size, orientation, order of channels or unit; its seeds do
        nothing.
    """
    digest = hashlib.sha256(repr((engine.digest, _sources())).encode()).hexdigest()
    record = cache_folder() / "engines" / "probes" / f"{digest}.json"
    if not again:
        try:
            return tuple(json.loads(record.read_text("utf-8")))
        except (OSError, ValueError):
            pass
    notes = _probed(engine, threads)
    write_atomically(record, lambda path: path.write_text(json.dumps(notes), "utf-8"))
    return notes


def _sources() -> bytes:
    return Path(__file__).read_bytes()


def _probed(engine: Engine, threads: int) -> tuple[str, ...]:
    if "area" not in engine.says.supports:
        return ("it was not probed, for it has no area lights: size, orientation and unit are as its images show them",)
    asked = Asked.of("probe", scene(), noisy=False)
    kept = cache_folder() / "engines" / "failed"

    def image(seed: int) -> np.ndarray:
        return running.run(engine, asked, spp=SAMPLES, seed=seed, threads=threads, kept=kept).image

    first, second, other = image(1), image(1), image(2)
    if (fault := misread(first)) is not None:
        raise EngineError(f"{engine.name}: probe: {fault}; --no-probe goes on all the same")
    if np.array_equal(first, other) and not engine.says.noiseless:
        raise EngineError(
            f"{engine.name}: probe: seeds 1 and 2 give the same image: allowed are independent ones, or noiseless = "
            "true"
        )
    if np.array_equal(first, second):
        return ()
    if engine.says.seeds == "varying":
        return ("one seed gives other images each time, as its file says: what is kept is what was rendered first",)
    raise EngineError(
        f"{engine.name}: probe: seed 1 gives two images: allowed is one image a seed, or seeds = 'varying', where "
        "threads race"
    )


def misread(image: np.ndarray) -> str | None:
    """How an image of the probe differs from the expected one, None where it does not."""
    wanted, known = expected()
    if _agrees(image, wanted, known):
        return None
    for words, change in _changes():
        if _agrees(change(image), wanted, known):
            return f"its image {words}"
    inner = image[TOP + 1 : TOP + SIDE - 1, LEFT + 1 : LEFT + SIDE - 1].mean(axis=(0, 1), dtype=np.float64)
    ratios = inner / RADIANCE
    if ratios.min() > 0 and np.ptp(ratios) < _NEAR * ratios.mean():
        factor = float(ratios.mean())
        if abs(factor - 1.0) < _NEAR:
            return "a pixel is not the mean over its own area (box filter): light of the square leaks into others"
        named = next((f" = {name}" for name, value in _FACTORS.items() if abs(factor / value - 1) < 0.01), "")
        return f"the square is {factor:.4g}{named} times as bright as it should be"
    if inner.min() > 0:
        power = np.polyfit(np.log(RADIANCE), np.log(inner), 1)
        if abs(np.polyval(power, 0.0)) < 0.02 and abs(power[0] - 1) > 0.1:
            return f"values are radiance to the power {power[0]:.3g}: allowed is linear radiance"
    found = ", ".join(f"{value:.4g}" for value in inner)
    return f"the square of radiance {', '.join(map(str, RADIANCE))} has ({found})"


def _agrees(image: np.ndarray, wanted: np.ndarray, known: np.ndarray) -> bool:
    peak = max(RADIANCE)
    off = np.abs(image - wanted)[known].max(axis=-1)
    edge = _edge()[known]
    return bool((off <= np.where(edge, _EDGE, _NEAR) * peak).all())


def _edge() -> np.ndarray:
    """Pixels on both sides of the square's edges."""
    near = np.zeros((HEIGHT, WIDTH), bool)
    near[TOP - 1 : TOP + SIDE + 1, LEFT - 1 : LEFT + SIDE + 1] = True
    near[TOP + 1 : TOP + SIDE - 1, LEFT + 1 : LEFT + SIDE - 1] = False
    return near


def _changes() -> Iterator[tuple[str, Callable[[np.ndarray], np.ndarray]]]:
    """What an image may have been changed by, and what undoes it."""
    yield "is upside down: allowed is the first row at the top", lambda image: image[::-1]
    yield "is flipped left to right", lambda image: image[:, ::-1]
    yield "is turned by 180°", lambda image: image[::-1, ::-1]
    yield "has its channels in the order BGR", lambda image: image[..., ::-1]
    yield ("is upside down, and has its channels in the order BGR", lambda image: image[::-1, :, ::-1])
    for down, right in itertools.product((-1, 0, 1), repeat=2):
        if (down, right) != (0, 0):
            said = [f"{abs(n)} px {words[n > 0]}" for n, words in ((right, _ACROSS), (down, _ALONG)) if n]
            yield (
                f"is shifted by {' and '.join(said)}",
                lambda image, by=(-down, -right): np.roll(image, by, axis=(0, 1)),
            )


_ACROSS, _ALONG = ("to the left", "to the right"), ("up", "down")
