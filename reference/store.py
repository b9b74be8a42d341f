"""Replicates on disk, named by the sha256 of all that they depend on, so that nothing is rendered twice.

One float32 NPY file per replicate and term, beside it a JSON file with the seconds and the NPY's digest. Both appear
whole or not at all; a file that is missing, cut short or altered is rendered again.
"""

import functools
import hashlib
import io
import json
import math
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import attrs
import numpy as np

from termwise import reference
from termwise.reference import backend
from termwise.scenes import reads, terms
from termwise.scenes.limits import Limit
from termwise.scenes.model import Scene
from termwise.scenes.store import ROOT, sources_digest, versions_of, write_atomically
from termwise.scenes.terms import Term

# What full light transport leaves out of a scene.
_NOT_PHYSICAL = (
    "ambient.color",
    "ambient.range",
    "ambient.source",
    "max_bounces",
    "draw_lights",
    "objects.material.occludes",
)


class Replicates(NamedTuple):
    """Independent images of one term.

    Attributes
    ----------
    images : (R, H, W, 3) float32
    seconds : (R,) float64, wall-clock per replicate when it was rendered, compilation apart; the terms of
        physical transport, which one render gives, share its seconds equally.
    shortfall : why there are fewer replicates or samples than asked for, in one sentence; None if not.
    spp : samples per pixel and replicate.
    """

    images: np.ndarray
    seconds: np.ndarray
    spp: int
    shortfall: str | None = None


@attrs.frozen
class Pace:
    """Samples a pixel, and replicates, that the backend affords; `shortfall` says why they are fewer than asked for."""

    spp: int
    count: int
    shortfall: str | None = None


def pace(
    scene: Scene,
    limit: Limit,
    *,
    spp: int,
    seed: int,
    count: int,
    folder: Path,
    budget_s: float = 60.0,
    by_second: bool = False,
) -> Pace:
    """What is rendered of `count` replicates of `spp` samples: all, but for `scalar_rgb` what `budget_s` allows.

    The seconds are estimated from one replicate of one sample a pixel, which is kept, so that a second run makes the
    same choice.
    """
    if _variant() != "scalar_rgb":
        return Pace(spp, count)
    render_missing(scene, limit, spp=1, seed=seed, number=0, folder=folder, by_second=by_second)
    pilot = kept(scene, limit, spp=1, seed=seed, count=1, folder=folder, by_second=by_second)
    terms = reference.parts(reference.shared(scene, limit))
    found = affordable(spp, count, pilot.seconds[0] * len(terms), budget_s)
    if found == (spp, count):
        return Pace(spp, count)
    return Pace(
        *found,
        f"scalar_rgb renders {found[1]} of {count} replicates at {found[0]} of {spp} samples a pixel "
        f"in {budget_s:g} s; no faster backend: {backend.choose().reason}",
    )


def affordable(spp: int, count: int, seconds_per_sample: float, budget_s: float) -> tuple[int, int]:
    """Samples a pixel and replicates within a budget: fewer samples first (a power of two), then fewer replicates.

    At least one sample and two replicates, below which nothing can be said of the noise.
    """
    samples = budget_s / seconds_per_sample
    if samples >= spp * count:
        return spp, count
    fewer = 2 ** max(0, math.floor(math.log2(max(1.0, samples / count))))
    return fewer, min(count, max(2, int(samples / fewer)))


def replicates(
    scene: Scene,
    limit: Limit,
    *,
    spp: int,
    seed: int,
    count: int,
    folder: Path,
    progress: Callable[[], object] | None = None,
    budget_s: float = 60.0,
    by_second: bool = False,
) -> Replicates:
    """Take `count` replicates from `folder`; render and keep those that it lacks.

    Parameters
    ----------
    scene, limit, spp, seed : as in `reference.replicate`.
    count : number of replicates.
    folder : folder of the cache; made if missing.
    progress : called after each replicate.
    budget_s : seconds that the replicates of one render may take without a vectorising backend, see `pace`.
    by_second : by the limit's second integrator, see `reference.has_second`.
    """
    paced = pace(scene, limit, spp=spp, seed=seed, count=count, folder=folder, budget_s=budget_s, by_second=by_second)
    for number in range(paced.count):
        render_missing(scene, limit, spp=paced.spp, seed=seed, number=number, folder=folder, by_second=by_second)
        if progress:
            progress()
    found = kept(scene, limit, spp=paced.spp, seed=seed, count=paced.count, folder=folder, by_second=by_second)
    return found._replace(shortfall=paced.shortfall)


def render_missing(
    scene: Scene, limit: Limit, *, spp: int, seed: int, number: int, folder: Path, by_second: bool = False
) -> bool:
    """Render and keep replicate `number`, all terms that its render gives, unless it is there; whether it was not."""
    served = reference.shared(scene, limit)
    paths = _paths(scene, served, spp=spp, seed=seed, number=number, folder=folder, by_second=by_second)
    if _read(paths[limit.term], scene.resolution) is not None:
        return False
    _render(scene, served, spp, seed, number, paths, by_second)
    return True


def files(
    scene: Scene, limit: Limit, *, spp: int, seed: int, number: int, folder: Path, by_second: bool = False
) -> tuple[Path, ...]:
    """All that `render_missing` keeps of a replicate: of each term the record, then the image; the limit's last."""
    served = reference.shared(scene, limit)
    paths = _paths(scene, served, spp=spp, seed=seed, number=number, folder=folder, by_second=by_second)
    ordered = sorted(paths, key=lambda term: term == limit.term)
    return tuple(file for term in ordered for file in (paths[term].with_suffix(".json"), paths[term]))


def whole(path: Path, resolution: tuple[int, int]) -> bool:
    """Whether a replicate's image is kept there."""
    return _read(path, resolution) is not None


def _paths(
    scene: Scene, served: Limit, *, spp: int, seed: int, number: int, folder: Path, by_second: bool
) -> dict[Term, Path]:
    return {
        term: _path(
            folder, key(scene, attrs.evolve(served, term=term), spp=spp, seed=seed, by_second=by_second), number
        )
        for term in reference.parts(served)
    }


def kept(
    scene: Scene, limit: Limit, *, spp: int, seed: int, count: int, folder: Path, by_second: bool = False
) -> Replicates:
    """The first `count` replicates, all of which are kept.

    Raises
    ------
    ValueError : one of them is missing or damaged.
    """
    # One render may serve several terms, each of which is kept by its own name.
    served = attrs.evolve(reference.shared(scene, limit), term=limit.term)
    name = key(scene, served, spp=spp, seed=seed, by_second=by_second)
    images, seconds = [], []
    for number in range(count):
        path = _path(folder, name, number)
        found = _read(path, scene.resolution)
        if found is None:
            raise ValueError(f"{path}: is missing or damaged: allowed is a replicate that was kept")
        images.append(reference.scaled(found[0], limit))
        seconds.append(found[1])
    return Replicates(np.array(images), np.array(seconds), spp)


def key(scene: Scene, limit: Limit, *, spp: int, seed: int, by_second: bool = False) -> str:
    """sha256 of all that decides a replicate's bits but its number."""
    sources = sources_digest(ROOT / "reference", ROOT / "scenes")
    made_by = _variant(), versions_of("mitsuba", "drjit"), sources
    settings = repr((_content(scene, limit), attrs.astuple(limit), spp, seed, by_second, *made_by))
    return hashlib.sha256(settings.encode()).hexdigest()


@functools.lru_cache(maxsize=64)
def _content(scene: Scene, limit: Limit) -> str:
    """sha256 of what a limit's image depends on in a scene: the same for all replicates."""
    if limit.transport == "physical":
        return reads.digest(scene, without=(*reads.UNREAD, *reference.UNLOADED, *_NOT_PHYSICAL))
    ruled = attrs.evolve(scene, shadows=limit.shadows)
    return terms.content(ruled, limit.term, without=reference.UNLOADED)


def _variant() -> str:
    # `choose` does not import Mitsuba: a run that finds all replicates here never loads it.
    if "mitsuba" in sys.modules:
        return backend.active().variant
    return _chosen(*(os.environ.get(name) for name in ("TERMWISE_BACKEND", "DRJIT_LIBLLVM_PATH")))


@functools.cache
def _chosen(*asked: str | None) -> str:
    """Of equal wishes once: it looks for libraries, and a run asks for the name of each of its replicates."""
    return backend.choose().variant


def _render(
    scene: Scene, limit: Limit, spp: int, seed: int, number: int, paths: dict[Term, Path], by_second: bool
) -> None:
    reference.compile_kernels(scene, limit, by_second=by_second)
    begin = time.perf_counter()
    images = reference.replicate_parts(scene, limit, spp=spp, seed=seed, replicate=number, by_second=by_second)
    seconds = (time.perf_counter() - begin) / len(images)
    for term, path in paths.items():
        buffer = io.BytesIO()
        np.save(buffer, images[term])
        content = buffer.getvalue()
        # The image last: where it stands, its record does.
        record = json.dumps({"seconds": seconds, "sha256": hashlib.sha256(content).hexdigest()})
        write_atomically(path.with_suffix(".json"), lambda temporary, text=record: temporary.write_text(text))
        write_atomically(path, lambda temporary, content=content: temporary.write_bytes(content))


def _read(path: Path, resolution: tuple[int, int]) -> tuple[np.ndarray, float] | None:
    """Image and seconds of a kept replicate; None unless both files are whole."""
    try:
        record = json.loads(path.with_suffix(".json").read_text())
        if record["sha256"] != _digest(path):
            return None
        image = np.load(path)
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return (image, record["seconds"]) if image.shape == (*resolution[::-1], 3) else None


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _path(folder: Path, name: str, number: int) -> Path:
    return folder / name[:2] / f"{name}-{number:04d}.npy"
