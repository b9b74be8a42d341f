"""Tiles on a thread pool: the image is a sum over samples, each pixel's in the same order whatever the threads.

Sweeps are prefixes: the sums after 1, 2, 4, ... samples of one run, so that a sweep costs no more than its last point.
"""

import os
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from typing import NamedTuple, Self

import numpy as np

from termwise.renderer import photon_map, photon_tracing
from termwise.renderer.arrays import MAX_SURVIVAL, SceneArrays, from_scene, most_survival
from termwise.renderer.by_reference import pack
from termwise.renderer.counts import (
    Contrast,
    Corners,
    coarse,
    contrast,
    corner_camera,
    corners_of,
    counts,
    grade,
    least,
    prepare,
    scatter,
    spend,
)
from termwise.renderer.film import ALONE, GeometryImages, Tile, Work, trace_centres
from termwise.renderer.jit import warm
from termwise.renderer.plan import (
    REDUCTIONS,
    SKIPS,
    by_contrast,
    check,
    may_see,
    needs_every_pixel,
    needs_photons,
    powers_of_two,
    skipped,
)
from termwise.renderer.rng import root, stream
from termwise.renderer.scratch import COUNTERS, Scratch, new_scratch
from termwise.renderer.terms.estimator import Cancelled, Compiled, Prefix, Progress, Request
from termwise.renderer.terms.variant import Chain, Stored, Variant
from termwise.scenes.arguments import whole
from termwise.scenes.model import Scene
from termwise.scenes.terms import TABLE, TERMS, Term

TILE = 32
# Calls of a kernel are begun by Python, one thread at a time: of little work each thread takes all that it is dealt in
# one. Of much work a call takes so many samples, about: who calls it off does not wait long.
_MOST_CALLS, _SAMPLES_A_CALL = 8, 2**16
# Small images get smaller tiles, so many a thread at least that none waits long for the others.
_TILES_A_THREAD, _SMALLEST = 16, 4
# Samples that share a map of a search for the k nearest at the vertices of a chain: its radius does not shrink.
_CHAINS_A_MAP = 128

_NO_PHOTONS = photon_map.empty()

# What the corners of pixels are seen with: the same for every seed, beyond the streams of pixels and of photons.
_CORNERS = stream(root(0, 0), 1 << 41)


def _tiles(wanted: np.ndarray, *, least: int) -> np.ndarray:
    """Tiles (T, 4) int64 that hold the wanted pixels (H, W) bool; `least` or more, if the image is large enough.

    A row is `(x0, y0, x1, y1)`, as of `film.Tile`.
    """
    height, width = wanted.shape
    side = TILE
    while side > _SMALLEST and -(-width // side) * -(-height // side) < least:
        side //= 2
    down, across = -(-height // side), -(-width // side)
    padded = np.zeros((down * side, across * side), np.bool_)
    padded[:height, :width] = wanted
    cut = padded.reshape(down, side, across, side)
    rows, columns = cut.any(axis=3).swapaxes(1, 2), cut.any(axis=1)
    row, column = np.nonzero(rows.any(axis=2))
    rows, columns = rows[row, column], columns[row, column]
    x, y = column * side, row * side
    # The first and the last row and column of each that holds any.
    low, high = (columns.argmax(axis=1), rows.argmax(axis=1)), (columns[:, ::-1], rows[:, ::-1])
    far = (side - each.argmax(axis=1) for each in high)
    return np.column_stack([x + low[0], y + low[1], *(begin + end for begin, end in zip((x, y), far, strict=True))])


def _items(tiles: np.ndarray, split: int) -> np.ndarray:
    """Samples of the tiles' pixels, (N, 5) int64, see `film.Work`."""
    return np.column_stack([tiles, np.full(len(tiles), split)])


def _corner_image(wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A black image of the corners of pixels (H, W), and the samples [begin, end) of each, of which there is one."""
    height, width = wanted.shape[0] + 1, wanted.shape[1] + 1
    return np.zeros((height, width, 3)), np.zeros((height, width), np.int32), np.ones((height, width), np.int32)


class _Task(NamedTuple):
    """What is rendered: `stored` says which photons its maps hold, None for no map."""

    variant: Variant
    driver: Callable[..., None]
    chain: Chain
    stored: Stored | None


class Engine:
    """A scene made ready for kernels, and the threads that run them.

    Parameters
    ----------
    scene : the scene.
    threads : number of threads; None: one a core.
    without : names of `renderer.plan.SKIPS` that are not taken: the same bytes for more work; or of REDUCTIONS: the
        same mean for more noise.
    kept_bytes : memory for photon maps that are kept while one replicate is rendered: terms that mean the same maps
        trace them once, which changes no bit, but the seconds of those that come later.
    pixel : (x, y) of the one pixel that is rendered, to the bit as in a whole image; all others stay black.

    Attributes
    ----------
    kernels : names of the kernels that were compiled, or loaded, for this scene.
    compile_seconds : how long that took.
    contrasts : how much pixels vary, of each estimator that counts by it; found once, for all replicates.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        threads: int | None = None,
        without: Collection[str] = (),
        kept_bytes: int = 0,
        pixel: tuple[int, int] | None = None,
    ) -> None:
        threads = (os.cpu_count() or 1) if threads is None else whole("threads", threads)
        allowed = *SKIPS, *REDUCTIONS
        for name in without:
            if name not in allowed:
                raise ValueError(f"without = {name!r}: allowed are {', '.join(allowed)}")
        self.scene = scene
        self.without = frozenset(without)
        self.arrays: SceneArrays = from_scene(scene, without=self.without)
        # Held, so that calls find what is packed.
        self._packed = [pack(self.arrays), pack(_NO_PHOTONS)]
        self.pool = ThreadPoolExecutor(threads)
        self.compile_seconds = 0.0
        # One of each thread, made once: 14 µs each, a tenth of a tile of 32 x 32 pixels at one sample.
        self._scratches: list[Scratch] = []
        self._local = threading.local()
        self.kernels: set[str] = set()
        self._warmed: set[_Task] = set()
        self._kept_bytes = kept_bytes
        self._maps: dict[tuple, photon_map.PhotonMap] = {}
        self.contrasts: dict[_Task, Contrast | None] = {}
        self._corners: dict[Term, Corners] = {}
        self._fewest: dict[_Task, int] = {}
        width, height = scene.resolution
        everywhere = np.full((height, width), pixel is None)
        if pixel is not None:
            for name, at, size in zip("xy", pixel, (width, height), strict=True):
                if not 0 <= at < size:
                    raise ValueError(f"{scene.name}: {name} = {at}: allowed is an integer in [0, {size - 1}]")
            everywhere[pixel[1], pixel[0]] = True
        self._threads = threads
        self._everywhere = self._tiles(everywhere)
        # Of each term, those that may see an object that has it. All others are black, or the constant sky.
        self.tiles = {
            term: self._everywhere
            if "window" in self.without or needs_every_pixel(scene, term)
            else self._tiles(everywhere & may_see(scene, term))
            for term in TERMS
        }

    def _tiles(self, wanted: np.ndarray) -> np.ndarray:
        """Tiles that hold the wanted pixels."""
        return _tiles(wanted, least=_TILES_A_THREAD * self._threads)

    def __enter__(self) -> Self:
        """Return the engine; its threads end with the block."""
        return self

    def __exit__(self, *exception: object) -> None:
        """Let running tiles finish and drop the rest."""
        self.pool.shutdown(cancel_futures=True)

    @property
    def counts(self) -> dict[str, int]:
        """Work done so far by all runs, by name of `renderer.scratch.COUNTERS`."""
        total = sum((scratch.counts for scratch in self._scratches), np.zeros(len(COUNTERS), np.int64))
        return dict(zip(COUNTERS, map(int, total), strict=True))

    def _scratch(self) -> Scratch:
        """Memory of the calling thread."""
        if not hasattr(self._local, "scratch"):
            self._local.scratch = new_scratch()
            self._scratches.append(self._local.scratch)
            self._packed.append(pack(self._local.scratch))
        return self._local.scratch

    def _unless(self, cancel: threading.Event | None) -> Callable[[], Scratch]:
        """What gives the calling thread its memory for a part of the work, unless the work is called off."""

        def scratch() -> Scratch:
            if cancel is not None and cancel.is_set():
                raise Cancelled
            return self._scratch()

        return scratch

    def kernels_of(self, variant: Variant, *, chain: Chain = "next-event") -> tuple[str, ...]:
        """Names of the kernels that a variant takes here; none where its term is skipped."""
        if not isinstance(variant.estimator, Compiled):
            return (f"{variant.estimator.name}, in Python",)
        if "term" not in self.without and skipped(self.scene, variant.term) is not None:
            return ()
        traced = needs_photons(self.scene, variant, chain, without=self.without)
        return (variant.estimator.name, *(("trace_photons", "sort") if traced else ()))

    def prefixes(
        self,
        variant: Variant,
        *,
        samples: int,
        seed: int,
        replicate: int,
        chain: Chain = "next-event",
        progress: Progress | None = None,
        cancel: threading.Event | None = None,
        counts: Iterable[int] | None = None,
    ) -> Iterator[tuple[int, np.ndarray, float]]:
        """Yield (N, image, seconds) for N = 1, 2, 4, ..., samples of one replicate.

        `image` is the mean of the first N samples, (H, W, 3) float64; `seconds` the time since the start,
        compilation excluded. `progress` is called with (samples done, samples).
        `counts`: other values of N, ascending and read one at a time, the last of them `samples`; each image has the
        same bits as if no other were asked for.

        Raises
        ------
        ValueError : `samples` below 1, or an option that the variant would ignore.
        """
        samples = whole("samples", samples)
        check(self.scene, variant, chain=chain)
        request = Request(
            samples=samples,
            seed=seed,
            replicate=replicate,
            chain=chain,
            counts=powers_of_two(samples) if counts is None else counts,
            progress=progress,
            cancel=cancel,
        )
        yield from variant.estimator.prefixes(self, variant, request)

    def shares(self, variant: Variant, *, samples: int, chain: Chain = "next-event") -> np.ndarray:
        """How many of `samples` of the mean pixel each pixel gets, (H, W) int32, for any seed; see `renderer.counts`.

        Raises
        ------
        ValueError : `samples` below 1, or an option that the variant would ignore.
        """
        samples = whole("samples", samples)
        check(self.scene, variant, chain=chain)
        width, height = self.scene.resolution
        if not (isinstance(variant.estimator, Compiled) and self._counts_by_contrast(variant, chain)):
            return np.full((height, width), samples, np.int32)
        task = _Task(variant, variant.estimator.driver, chain, None)
        self._warm(task, _CORNERS, np.zeros((height, width, 3)))
        return self._counts(task, samples, None)

    def summed(self, variant: Variant, driver: Callable[..., None], request: Request) -> Iterator[Prefix]:
        """The prefixes of a kernel's sums; see `prefixes`."""
        chain, cancel = request.chain, request.cancel
        width, height = self.scene.resolution
        out = np.zeros((height, width, 3))
        if "term" not in self.without and skipped(self.scene, variant.term) is not None:
            yield from ((count, out.copy(), 0.0) for count in request.counts)
            return
        key = root(request.seed, request.replicate)
        stored = needs_photons(self.scene, variant, chain, without=self.without)
        task = _Task(variant, driver, chain, stored)
        photons = _NO_PHOTONS
        # Each pass has its own radius, hence its own map.
        per_map = _CHAINS_A_MAP if chain == "paper" and TABLE[variant.term].meets else 1
        split = 1 if "splitting" in self.without else variant.split(self.scene)
        begin, taken = np.zeros((height, width), np.int32), np.ones((height, width, 1))
        done = 0
        self._warm(task, key, out)
        seconds = 0.0
        for count in request.counts:
            start = time.perf_counter()
            while done < count:
                first, last = done, count
                if stored:
                    number = first // per_map
                    last = min(count, (number + 1) * per_map)
                    photons = self._shared(task, key, number, self._unless(cancel))
                inputs = variant.inputs(self.scene, chain, photons)
                items = _items(self.tiles[variant.term], split if last > ALONE else 1)
                end = self._counts(task, last, cancel)
                self._add(driver, inputs, key, items, begin, end, out, cancel)
                self._add_beyond(variant.term, out, last - first)
                taken[:, :, 0] = end
                begin, done = end, last
                request.done(last)
            seconds += time.perf_counter() - start
            yield count, out / taken, seconds

    def _counts(self, task: _Task, samples: int, cancel: threading.Event | None) -> np.ndarray:
        """How many of a run's first samples are each pixel's, (H, W) int32: what all prefixes agree upon."""
        width, height = self.scene.resolution
        even = np.full((height, width), samples, np.int32)
        # What `_warm` has found.
        fewest = self._fewest.get(task, samples)
        if samples <= fewest:
            return even
        if task not in self.contrasts:
            self.contrasts[task] = self._contrast(task, cancel)
        found = self.contrasts[task]
        return even if found is None else counts(found, samples, fewest)

    def _counts_by_contrast(self, variant: Variant, chain: Chain) -> bool:
        decided = by_contrast(self.scene, variant, chain, self.without)
        return decided and skipped(self.scene, variant.term) is None

    def _contrast(self, task: _Task, cancel: threading.Event | None) -> Contrast | None:
        """How much pixels vary, by a sample at each of their corners: the same for all replicates."""
        corners = self._corners[task.variant.term]
        inputs = task.variant.inputs(self.scene, task.chain, _NO_PHOTONS)
        image, first, last = _corner_image(corners.wanted)
        self._run(corners.arrays, task.driver, inputs, _CORNERS, corners.items, first, last, image, cancel)
        return contrast(image, corners.wanted)

    def _least(self, task: _Task) -> int:
        """Up to how many samples all pixels get the same, by a coarse image; its rays do not count."""
        corners = self._corners_of(coarse(self._corners[task.variant.term].wanted))
        inputs = task.variant.inputs(self.scene, task.chain, _NO_PHOTONS)
        image, first, last = _corner_image(corners.wanted)
        work = Work(corners.items, first, last, np.zeros(1, np.int64), len(corners.items))
        task.driver(corners.arrays, *inputs, _CORNERS, work, image, new_scratch())
        return least(image, corners.wanted)

    def _corners_of(self, wanted: np.ndarray) -> Corners:
        """The corners of the wanted pixels, of an image of any resolution."""
        height, width = wanted.shape
        arrays = self.arrays._replace(camera=corner_camera(self.arrays.camera, width, height))
        return Corners(arrays, wanted, _items(self._tiles(corners_of(wanted)), 1))

    def _add_beyond(self, term: Term, out: np.ndarray, samples: int) -> None:
        """What `samples` of a term add beyond its window, the constant sky, rounded as a kernel's sum is."""
        radiance = TABLE[term].beyond(self.scene)
        if radiance is None or not any(radiance):
            return
        beyond = np.zeros(out.shape[:2], np.bool_)
        for tiles, is_beyond in ((self._everywhere, True), (self.tiles[term], False)):
            for x0, y0, x1, y1 in tiles.tolist():
                beyond[y0:y1, x0:x1] = is_beyond
        if not beyond.any():
            return
        constant, summed = np.array(radiance), out[beyond][0]
        for _ in range(samples):
            summed = summed + constant
        out[beyond] = summed

    def geometry(self) -> GeometryImages:
        """Depth, normal, object and face along the rays through the pixels' centres."""
        width, height = self.scene.resolution
        shape = (height, width)
        images = GeometryImages(np.full(shape, np.inf), np.zeros((*shape, 3)), np.full(shape, -1), np.full(shape, -1))

        def draw(tile: list[int]) -> None:
            trace_centres(self.arrays, Tile(*tile), images, self._scratch())

        for _ in self.pool.map(draw, self._everywhere.tolist()):
            pass
        return images

    def _add(
        self,
        driver: Callable[..., None],
        inputs: tuple,
        key: np.uint64,
        items: np.ndarray,
        begin: np.ndarray,
        end: np.ndarray,
        out: np.ndarray,
        cancel: threading.Event | None,
    ) -> None:
        """Add the samples [begin, end) of each pixel to the image."""
        self._run(self.arrays, driver, inputs, key, items, begin, end, out, cancel)

    def _run(
        self,
        arrays: SceneArrays,
        driver: Callable[..., None],
        inputs: tuple,
        key: np.uint64,
        items: np.ndarray,
        begin: np.ndarray,
        end: np.ndarray,
        out: np.ndarray,
        cancel: threading.Event | None,
    ) -> None:
        scratch = self._unless(cancel)
        inputs = tuple(map(pack, inputs))
        threads = max(1, min(self._threads, len(items)))
        calls = max(1, min(_MOST_CALLS, int((end - begin).sum()) // (threads * _SAMPLES_A_CALL)))
        most = len(items) if calls == 1 else -(-len(items) // (threads * calls))
        work = Work(items, begin, end, np.zeros(1, np.int64), most)

        def draw() -> None:
            while work.dealt[0] < len(items):
                driver(arrays, *inputs, key, work, out, scratch())

        # The calling thread is one of them: another takes 0.1 ms to wake.
        others = [self.pool.submit(draw) for _ in range(threads - 1)]
        try:
            draw()
        finally:
            work.dealt[0] = len(items)
            wait(others)
        for other in others:
            other.result()

    def _warm(self, task: _Task, key: np.uint64, out: np.ndarray) -> None:
        """Compile before the clock starts; once is enough."""
        if task in self._warmed:
            return
        start = time.perf_counter()
        self.kernels.update(self.kernels_of(task.variant, chain=task.chain))
        # The one photon does not count.
        photons = self._photons(task, key, 0, 1, new_scratch) if task.stored else _NO_PHOTONS
        inputs = task.variant.inputs(self.scene, task.chain, photons)
        one = np.zeros((1, 1), np.int32)
        nothing = Work(np.zeros((0, 5), np.int64), one, one, np.zeros(1, np.int64), 0)
        warm(task.driver, self.arrays, *inputs, key, nothing, out, self._scratch())
        if by_contrast(self.scene, task.variant, task.chain):
            warm(scatter, *prepare(0, 0))
            level, pixels = np.empty((0, 0), np.int64), np.empty(0, np.int64)
            warm(grade, np.empty((0, 0)), np.empty((0, 0), np.bool_), level, pixels)
            warm(spend, level, pixels, 0, 0, np.empty((0, 0), np.int32))
        if self._counts_by_contrast(task.variant, task.chain):
            term = task.variant.term
            wanted = may_see(self.scene, term)
            if needs_every_pixel(self.scene, term):
                wanted[:] = True
            self._corners[term] = self._corners_of(wanted)
            self._packed.append(pack(self._corners[term].arrays))
            self._fewest[task] = self._least(task)
        self._warmed.add(task)
        self.compile_seconds += time.perf_counter() - start

    def _shared(self, task: _Task, key: np.uint64, index: int, scratch: Callable[[], Scratch]) -> photon_map.PhotonMap:
        """The map of pass `index`: one that was kept, or a new one, kept while there is room."""
        # The first maps stay: all terms ask from the first to the last, where the latest used would help none.
        if self._maps and next(iter(self._maps))[0] != key:
            self._maps.clear()
        name = (key, index, task.stored, self._scattering(task))
        if name in self._maps:
            return self._maps[name]
        made = self._photons(task, key, index, self.scene.photons.count, scratch)
        if sum(map(photon_map.bytes_of, (*self._maps.values(), made))) <= self._kept_bytes:
            self._maps[name] = made
        return made

    def _scattering(self, task: _Task) -> photon_tracing.Scattering:
        """How the photons of a variant go on."""
        photons = self.scene.photons
        by_nearest = task.variant.by_nearest(self.scene, task.chain)
        return photon_tracing.Scattering(
            survival=photons.survival or 0.0,
            weighted=task.stored != "unweighted",
            # The operator of a specular chain means diffuse scattering.
            full=photons.scattering == "full" and task.variant.term == "direct",
            independent=by_nearest,
            aimed=not by_nearest and "aimed" not in self.without,
            most=MAX_SURVIVAL if task.stored == "unweighted" else most_survival(self.scene),
        )

    def _photons(
        self, task: _Task, key: np.uint64, index: int, count: int, scratch: Callable[[], Scratch]
    ) -> photon_map.PhotonMap:
        """The map of pass `index`."""
        photons = self.scene.photons
        return photon_tracing.emit(
            self.arrays,
            key,
            index,
            count=count,
            radius=photon_map.progressive_radius(photons.radius, index),
            shape=photons.kernel,
            rule=self._scattering(task),
            first_hits=task.stored != "scattered",
            pool=self.pool,
            scratch=scratch,
        )
