"""One pixel of one replicate again, sample by sample, with all that happens on the way.

The value is that of the compiled kernel, run for this pixel alone: randomness is keyed by (seed, replicate, pixel,
sample), a ray has the same bits in whatever company it is traced, and the sum over samples has one order, so it is the
rendered pixel to the bit. Photon maps belong to a replicate and not to a pixel: they are traced whole.

The trace is the same kernel as plain Python (`renderer.recorder`), given the same photon maps. Its radiance of a sample
was the kernel's to the bit in all variants on the library's scenes; another mathematical library than LLVM's may cost a
few units in the last place, and what is more than TOLERATED_ULP says that the trace took another way.
"""

import errno
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Any

import attrs
import numpy as np

from termwise.renderer.engine import Engine
from termwise.renderer.plan import skipped
from termwise.renderer.recorder import Event
from termwise.renderer.terms import Chain, Variant
from termwise.renderer.terms.estimator import Compiled
from termwise.scenes.model import Scene

TOLERATED_ULP = 16.0
"""Of the brightest channel of a sample."""


@attrs.frozen(eq=False)
class Sample:
    """One sample of the pixel.

    Attributes
    ----------
    index : its number.
    events : what happened, in order; each has its name under "event", the rest are numbers and lists of them.
    radiance : (3,) float64, by the compiled kernel.
    ulp : how far the trace's radiance is from it, in units in the last place of its brightest channel.
    """

    index: int
    events: list[Event]
    radiance: np.ndarray
    ulp: float


@attrs.frozen(eq=False)
class Replay:
    """A pixel of a replicate.

    Attributes
    ----------
    value : (3,) float64, the mean of the samples: the rendered pixel to the bit.
    samples : all of them; none where the term is skipped.
    skipped : why the scene has nothing of the term, or None.
    """

    value: np.ndarray
    samples: tuple[Sample, ...]
    skipped: str | None

    @property
    def astray(self) -> tuple[int, ...]:
        """Samples whose trace is not that of the kernel."""
        return tuple(sample.index for sample in self.samples if not sample.ulp <= TOLERATED_ULP)


class _Recorded(Engine):
    """An engine of one pixel that keeps every sample and has it traced by a recorder beside it."""

    def __init__(self, scene: Scene, variant: Variant, pixel: tuple[int, int]) -> None:
        # The window skips pixels that see no object: their bytes are the same, and here their rays are wanted.
        super().__init__(scene, pixel=pixel, without=("window",))
        self.samples: list[Sample] = []
        self._objects = [thing.name for thing in scene.objects]
        self._recorder = subprocess.Popen(
            [sys.executable, "-m", "termwise.renderer.recorder"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        )
        self._send((self.arrays, variant.term, variant.name))

    def __exit__(self, *exception: object) -> None:
        """End the recorder too."""
        super().__exit__(*exception)
        self._recorder.communicate()

    def _send(self, request: Any) -> None:
        assert self._recorder.stdin is not None
        pickle.dump(request, self._recorder.stdin)
        self._recorder.stdin.flush()

    def _trace(self, request: Any) -> tuple[list[Event], np.ndarray]:
        assert self._recorder.stdout is not None
        self._send(request)
        try:
            events, radiance = pickle.load(self._recorder.stdout)
        except EOFError:
            raise ChildProcessError(
                errno.ECHILD, "ended before it had answered", "termwise.renderer.recorder"
            ) from None
        for event in events:
            if "object" in event:
                event["object"] = self._objects[event["object"]]
        return events, radiance

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
        ((x, y, _, _, split),) = items.tolist()
        given: tuple | None = inputs
        for index in range(begin[y, x], end[y, x]):
            alone, one = np.zeros_like(out), (np.full_like(begin, index), np.full_like(end, index + 1))
            super()._add(driver, inputs, key, items, *one, alone, cancel)
            super()._add(driver, inputs, key, items, *one, out, cancel)
            events, traced = self._trace((given, key, x, y, index, split))
            given = None
            self.samples.append(Sample(index, events, alone[y, x], _ulp(traced, alone[y, x])))


def _ulp(traced: np.ndarray, radiance: np.ndarray) -> float:
    if np.array_equal(traced, radiance, equal_nan=True):
        return 0.0
    return float(np.max(np.abs(traced - radiance)) / np.spacing(np.max(np.abs(radiance))))


def replay(
    scene: Scene,
    variant: Variant,
    *,
    x: int,
    y: int,
    samples: int,
    seed: int,
    replicate: int,
    chain: Chain = "next-event",
) -> Replay:
    """Render one pixel of one replicate again; see `Engine.prefixes` for the settings.

    Raises
    ------
    ValueError : a pixel outside of the image, an estimator in Python, and what `Engine.prefixes` refuses.
    """
    if not isinstance(variant.estimator, Compiled):
        raise ValueError(f"{variant.term} {variant.name}: is an estimator in Python: allowed are those of the renderer")
    with _Recorded(scene, variant, (x, y)) as engine:
        *_, (_, image, _) = engine.prefixes(variant, samples=samples, seed=seed, replicate=replicate, chain=chain)
        return Replay(image[y, x], tuple(engine.samples), skipped(scene, variant.term))
