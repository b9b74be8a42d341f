"""What computes a variant's images: a compiled kernel, or a function in Python. Both are asked, named and kept alike.

A replicate is what `prefixes` yields: the mean images after N = 1, 2, 4, ... samples, all from the same random numbers.
What decides their bits, beside the scene and the request, is the `fingerprint`: images of equal fingerprints are taken
for one another wherever they are kept.
"""

import pickle
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Protocol

import attrs
import numpy as np

from termwise.renderer.fingerprint import fingerprint
from termwise.renderer.rng import root
from termwise.scenes.model import Scene
from termwise.scenes.store import ROOT, sources_digest

if TYPE_CHECKING:
    from termwise.renderer.terms.variant import Chain, Variant

Prefix = tuple[int, np.ndarray, float]
"""(N, mean image of the first N samples (H, W, 3) float64, seconds since the start)."""
Function = Callable[[Scene, int, int], np.ndarray]
"""(scene, samples, seed) -> image (H, W, 3), linear radiance."""


Progress = Callable[[int, int], object]
"""Called with (samples done, samples)."""


class Cancelled(Exception):
    """The caller asked the run to stop."""


@attrs.frozen(eq=False, kw_only=True)
class Request:
    """One replicate of an estimate.

    Attributes
    ----------
    samples : samples per pixel, of the last image.
    seed, replicate : name the random numbers.
    chain : what the other terms are at the vertices of a specular chain.
    counts : the values of N, ascending and read one at a time, the last of them `samples`.
    progress : called with (samples done, samples).
    cancel : set by whoever no longer wants the rest.
    """

    samples: int
    seed: int
    replicate: int
    chain: "Chain"
    counts: Iterable[int]
    progress: Progress | None = None
    cancel: threading.Event | None = None

    def go_on(self) -> None:
        """Raise Cancelled where the rest is no longer wanted."""
        if self.cancel is not None and self.cancel.is_set():
            raise Cancelled

    def done(self, samples: int) -> None:
        """Report how many samples are taken."""
        if self.progress:
            self.progress(samples, self.samples)


class Engine(Protocol):
    """What an estimator takes of `renderer.engine.Engine`: naming it would have each of its edits recompile kernels."""

    @property
    def scene(self) -> Scene:
        """The scene."""
        ...

    def summed(self, variant: "Variant", driver: Callable[..., None], request: Request) -> Iterator[Prefix]:
        """The prefixes of a kernel's sums."""
        ...


class Estimator(Protocol):
    """What a variant is computed by.

    Attributes
    ----------
    name : of the kernel or the function.
    sees_all : whether it may look at the whole scene: else the term's `reads` say what its images depend on.
    """

    sees_all: bool

    @property
    def name(self) -> str:
        """Of the kernel or the function."""
        ...

    def fingerprint(self) -> str:
        """What decides its bits beside scene and request; an `Unknown` says why that cannot be told."""
        ...

    def prefixes(self, engine: Engine, variant: "Variant", request: Request) -> Iterator[Prefix]:
        """The images of one replicate, one for each of `request.counts`."""
        ...


@attrs.frozen
class Compiled:
    """A kernel `driver(scene, *inputs, key, work, out, scratch)`.

    It adds the samples of all tiles of `work` (see `film.Work`) to `out` (H, W, 3) float64; the engine runs it
    on tiles, `Variant.inputs` are its further arguments.
    """

    driver: Callable[..., None]
    sees_all = False

    @property
    def name(self) -> str:
        """Of the kernel."""
        return getattr(self.driver, "__name__", "kernel").strip("_")

    def fingerprint(self) -> str:
        """Of the renderer's sources: a kernel may reach any of them."""
        return sources_digest(ROOT / "renderer", ROOT / "scenes")

    def prefixes(self, engine: Engine, variant: "Variant", request: Request) -> Iterator[Prefix]:
        """Sums of samples by tiles, on the engine's threads."""
        return engine.summed(variant, self.driver, request)


@attrs.frozen
class Called:
    """A function in Python; it is called for each N, and the seconds are those of that call.

    Attributes
    ----------
    function : (scene, samples, seed) -> image.
    identity : what its images depend on beside the arguments, where its author knows better than its code tells.
    """

    function: Function
    identity: str | None = None
    sees_all = True

    @property
    def name(self) -> str:
        """Of the function."""
        return getattr(self.function, "__name__", "function").strip("_")

    def fingerprint(self) -> str:
        """Of its code and all that this reaches, see `renderer.fingerprint`.

        Raises
        ------
        Unknown : It reaches a value whose content cannot be told.
        """
        return fingerprint(self.function) if self.identity is None else self.identity

    def prefixes(self, engine: Engine, variant: "Variant", request: Request) -> Iterator[Prefix]:
        """Call the function for each count, all from one seed.

        Raises
        ------
        ValueError : an image of another size.
        """
        width, height = engine.scene.resolution
        # 63 bits: of those that take a seed many take no more.
        seed = int(root(request.seed, request.replicate) >> np.uint64(1))
        for count in request.counts:
            request.go_on()
            start = time.perf_counter()
            image = np.asarray(self.function(engine.scene, count, seed), np.float64)
            seconds = time.perf_counter() - start
            if image.shape != (height, width, 3):
                raise ValueError(
                    f"{variant.term} {variant.name}: shape = {image.shape}: allowed is {(height, width, 3)}, the "
                    "resolution of the scene it was given"
                )
            request.done(count)
            yield count, image, seconds


def sent(term: str, name: str, estimator: Estimator) -> bytes:
    """An estimator as bytes for another process.

    Raises
    ------
    ValueError : it cannot be pickled; the message names the variant.
    """
    try:
        return pickle.dumps(estimator)
    except Exception as error:  # pickle raises whatever an object's own methods do
        reason = " ".join(str(error).split())
        raise ValueError(
            f"{term} {name}: cannot be sent to another process ({reason}): allowed is a function at the top level of a "
            "module that can be imported there"
        ) from None
