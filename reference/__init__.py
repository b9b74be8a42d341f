"""The same scene through Mitsuba 3: a term's true integral, in independent replicates.

Importing this package is cheap; Mitsuba is imported by the functions that render.
"""

import hashlib
import inspect
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import attrs
import numpy as np

from termwise.scenes import reads
from termwise.scenes.arguments import seed_of, whole
from termwise.scenes.limits import Limit, named
from termwise.scenes.load import load
from termwise.scenes.model import Scene
from termwise.scenes.terms import PHOTONS, TABLE, Term, TermImage

PASSES = 4096  # passes that one replicate may use without sharing random numbers with the next
UNLOADED = (*PHOTONS, "scope", "rings", "shadows", "intersection")
"""Fields of a scene that Mitsuba never sees: a limit says them in their place, or there is no such choice."""
# Those that full transport is split into, see `physical.PARTS`: of any other its share is the term itself.
_SPLIT: tuple[Term, ...] = ("ambient", "direct", "specular", "transmission")
_SECOND: tuple[Term, ...] = ("ambient", "direct", "specular", "transmission")


def render(
    scene: Scene | str | Path,
    limit: Limit | Term,
    *,
    spp: int = 16,
    seed: int = 0,
    replicates: int = 1,
    keep: bool = True,
    progress: Callable[[], object] | None = None,
) -> TermImage:
    """Render a term's integral with Mitsuba.

    Parameters
    ----------
    scene : a scene, the name of one of the library, or the path of a scene file.
    limit : the integral that is meant; a term's name means what the scene does by it (`scenes.limits.named`), to which
        the default variant of `termwise.render` converges.
    spp : samples per pixel and replicate; with a kernel, photon maps.
    seed : in [0, 2^64 - 1]; equal seeds give equal bits on one backend.
    replicates : independent repetitions; the variance needs at least two, and `judge` takes 4 or more.
    keep : whether the replicates are kept beside their mean, as `judge` needs them; R images in place of two.
    progress : called after each replicate.

    Returns
    -------
    The image, its variance and its replicates: radiance, linear Rec. 709, in the scene's unit.

    Raises
    ------
    ValueError : an unknown term, a count or a seed that is none, a scene that single precision cannot hold. A scene
        that cannot be loaded is a `FileError`, which is one too.
    reference.backend.BackendError : Mitsuba cannot run here.
    """
    spp, replicates, seed = whole("spp", spp), whole("replicates", replicates), seed_of(seed)
    scene = load(scene)
    limit = limit if isinstance(limit, Limit) else named(limit, scene)
    from termwise.reference import backend

    if words := backend.slow(backend.active()):
        warnings.warn(words, stacklevel=2)
    with backend.rendering():
        compile_kernels(scene, limit)
        begin = time.perf_counter()
        images = []
        for number in range(replicates):
            images.append(replicate(scene, limit, spp=spp, seed=seed, replicate=number))
            if progress:
                progress()
    return TermImage.from_replicates(np.array(images), samples=spp, seconds=time.perf_counter() - begin, keep=keep)


def replicate(scene: Scene, limit: Limit, *, spp: int, seed: int, replicate: int = 0) -> np.ndarray:
    """One independent estimate of a term: (H, W, 3) float32 radiance, weights inside, linear Rec. 709.

    `seed` and `replicate` name the random numbers: equal pairs give equal bits on one backend, and no two
    replicates of a seed share any. Unbiased.
    """
    parts = replicate_parts(scene, shared(scene, limit), spp=spp, seed=seed, replicate=replicate)
    return scaled(parts[limit.term], limit)


def replicate_parts(
    scene: Scene, limit: Limit, *, spp: int, seed: int, replicate: int = 0, by_second: bool = False
) -> dict[Term, np.ndarray]:
    """All images that one render of a `shared` limit gives, factor 1: four for physical transport, else one.

    `by_second`: by another integrator that means the same, with random numbers of its own; see `has_second`.
    """
    spp = whole("spp", spp)
    from termwise.reference import backend

    number = rng_seed(limit, seed, replicate, by_second=by_second)
    with backend.rendering():
        images = loaded(scene).render(attrs.asdict(limit), spp=spp, seed=number, by_second=by_second)
    return dict(zip(parts(limit), images.astype(np.float32), strict=True))


def has_second(scene: Scene, limit: Limit) -> bool:
    """Whether a limit has a second integrator, see `reference.second`: all that is plain light transport."""
    plain = Limit(limit.term, scope=limit.scope, factor=limit.factor, lobe=limit.lobe, ambient=limit.ambient)
    by_mitsuba = scene.ignore == "face" and scene.normals == "viewer" and not scene.unshadowing
    is_there = limit.term != "transmission" or bool(scene.transparent)
    return limit == plain and limit.term in _SECOND and by_mitsuba and is_there


def scaled(image: np.ndarray, limit: Limit) -> np.ndarray:
    """Apply the limit's constant factor, in float32."""
    return image if limit.factor == 1.0 else image * np.float32(limit.factor)


def compile_kernels(scene: Scene, limit: Limit, *, by_second: bool = False) -> None:
    """Render a throw-away sample, so that compilation is not counted as rendering."""
    served = shared(scene, limit), by_second
    compiled = loaded(scene).compiled
    if served not in compiled:
        replicate_parts(scene, served[0], spp=1, seed=0, by_second=by_second)
        compiled.add(served)


def parts(limit: Limit) -> tuple[Term, ...]:
    """Terms that one render of a limit yields, in the estimator's order."""
    return _SPLIT if limit.transport == "physical" and limit.term in _SPLIT else (limit.term,)


def shared(scene: Scene, limit: Limit) -> Limit:
    """The limit whose render serves this one: all that does not change the render is put at its default."""
    term = parts(limit)[0]
    if limit.transport == "physical" and term in _SPLIT:
        return Limit(term, transport="physical", depth=limit.depth)
    others = {name for row in TABLE.values() for name in row.limit} - {*TABLE[term].limit}
    kept = {
        field.name: getattr(limit, field.name)
        for field in attrs.fields(Limit)
        if field.name not in others | {"term", "factor", "transport"}
    }
    if TABLE[term].scoped:
        kept["scope"] = limit.scope or scene.scope
    return Limit(term, **kept)


def rng_seed(limit: Limit, seed: int, replicate: int, *, by_second: bool = False) -> int:
    """32-bit seed of a replicate's first pass; the passes of one seed's replicates never coincide.

    All depths share it: what is cut are the same paths.
    """
    settings = attrs.astuple(limit, filter=lambda field, _: field.name != "depth")
    name = (seed, settings, *(["second"] if by_second else []))
    digest = hashlib.sha256(repr(name).encode()).digest()
    return (int.from_bytes(digest[:4], "little") + replicate * PASSES) % 2**32


def loaded(scene: Scene) -> Any:
    """Load a scene into Mitsuba: a `prepare.Loaded`, kept until another scene is asked for.

    Only one is kept, because every material that exists is compiled into every kernel.
    """
    content = reads.digest(scene, without=(*reads.UNREAD, *UNLOADED))
    if content not in _loaded:
        from termwise.reference.backend import import_mitsuba

        import_mitsuba()  # before the modules that subclass Mitsuba's plugins
        from termwise.reference import prepare, translate

        _loaded.clear()
        with tempfile.TemporaryDirectory() as folder:
            _loaded[content] = prepare.Loaded(translate.describe(scene, Path(folder)), Path(folder))
    return _loaded[content]


_loaded: dict[str, Any] = {}


class _Package(ModuleType):
    """`termwise.reference` is this package and, for users, the function `render`: a call of the one is the other."""

    def __call__(self, scene: Any = None, limit: Any = None, **options: Any) -> TermImage:
        """See `render`."""
        for name, value, allowed in (
            ("scene", scene, "the name of one, a path or a Scene"),
            ("limit", limit, f"{', '.join(TABLE)} or a Limit"),
        ):
            if value is None:
                raise ValueError(f"termwise.reference: {name} is missing: allowed is {allowed}")
        return render(scene, limit, **options)


__signature__ = inspect.signature(render)
"""What `help` and notebooks show of the call."""

sys.modules[__name__].__class__ = _Package
