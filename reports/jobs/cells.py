"""Cells (scene, term, variant): the replicate images of an estimator, each a job, computed once and kept on disk.

A replicate is one file: the float32 means of the first 1, 2, 4, ... N samples, the last of them in float64 too, the
seconds that each took, and the work that was done. Its name is the digest of all that decides its bits, so a run that
was interrupted, or one with nothing changed, finds it again.
"""

import hashlib
import zipfile
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Protocol

import attrs
import numpy as np

from termwise.renderer.engine import Engine
from termwise.renderer.scratch import COUNTERS
from termwise.renderer.terms import VARIANTS, Chain, Variant, find
from termwise.scenes import terms
from termwise.scenes.limits import Limit
from termwise.scenes.model import Scene
from termwise.scenes.store import versions_of, write_atomically
from termwise.scenes.terms import Term


def content(scene: Scene, variant: Variant, *, chain: Chain) -> str:
    """sha256 of what a term's image depends on in a scene: where it is equal, so is every byte of the image."""
    without = terms.PHOTONS if variant.photons(scene, chain) is None else ()
    return terms.content(scene, variant.term, without=without)


class Seat(Protocol):
    """Where a job is done: a process with a cache, and a scene that is ready.

    Attributes
    ----------
    cache : the folder that it keeps replicates in.
    threads : that a job may use; None: one a core.
    """

    cache: Path
    threads: int | None

    def ready(self, scene: Scene) -> Engine:
        """The engine of a scene, that of the job before if it had the same."""
        ...

    def compiling(self, kernels: tuple[str, ...]) -> AbstractContextManager[object]:
        """Around work that may compile these kernels."""
        ...


class Job(Protocol):
    """Work that makes files of a cache, named by all that decides them, anywhere, in any order; it can be pickled."""

    @property
    def scene(self) -> Scene:
        """The scene that it concerns, by which a failure is told."""
        ...

    @property
    def what(self) -> str:
        """As progress names it."""
        ...

    @property
    def name(self) -> tuple[object, ...]:
        """Equal for jobs that make the same file, as far as that is told cheaply."""
        ...

    def files(self, cache: Path) -> tuple[Path, ...]:
        """What it makes in a cache; where the last is whole, all are."""
        ...

    def kept(self, cache: Path) -> bool:
        """Whether a cache has it."""
        ...

    def here(self) -> "Job":
        """The job as this process would name it."""
        ...

    def take(self, seat: Seat) -> tuple[bool, float]:
        """Have it made, unless the cache has it; whether it was, and the seconds that compiling took."""
        ...


@attrs.frozen(eq=False)
class Replicate:
    """One replicate of ours, as a job: all that decides its bits, and its name in the cache.

    Attributes
    ----------
    variant : by name, so that any process which knows it can take the job.
    counts : the prefixes whose images are kept, the last of them all samples.
    key : sha256 of all that decides the bits but the number, see `key`.
    number : of the replicate.
    """

    scene: Scene
    term: Term
    variant: str
    counts: tuple[int, ...]
    seed: int
    chain: Chain
    key: str
    number: int

    @property
    def what(self) -> str:
        """As progress names it."""
        return f"{self.scene.name}: {self.term} {self.variant}"

    @property
    def name(self) -> tuple[object, ...]:
        """Equal for jobs that make the same file."""
        return self.key, self.number

    def path(self, folder: Path) -> Path:
        """Its file in the folder of cells."""
        return _path(folder, self.key, self.number)

    def files(self, cache: Path) -> tuple[Path, ...]:
        """What it makes in a cache, the last of them last."""
        return (self.path(cache / "cells"),)

    def kept(self, cache: Path) -> bool:
        """Whether a cache has it."""
        return _kept(self, cache / "cells")

    def here(self) -> "Replicate":
        """The job as this process would name it: another key where sources, versions or an estimator differ."""
        variant = find(self.term, self.variant)
        name = key(self.scene, variant, samples=self.counts[-1], seed=self.seed, chain=self.chain)
        return attrs.evolve(self, key=name)

    def take(self, seat: "Seat") -> tuple[bool, float]:
        """Have it made, unless the cache has it; whether it was, and the seconds that compiling took."""
        engine = seat.ready(self.scene)
        compiled = engine.compile_seconds
        with seat.compiling(engine.kernels_of(find(self.term, self.variant), chain=self.chain)):
            made = take(engine, self, seat.cache / "cells")
        return made, engine.compile_seconds - compiled


@attrs.frozen(eq=False)
class Cell:
    """Replicates of one variant.

    Attributes
    ----------
    own : the limit that it is judged against.
    samples : (P,) the prefixes 1, 2, 4, ..., N, or N alone.
    images : (K, P, H, W, 3) float32.
    files : of the replicates, in order.
    seconds : (K, P) float64, wall-clock up to each prefix, compilation apart.
    counts : work done for all replicates, by name of `renderer.scratch.COUNTERS`.
    kernels : that it took.
    compile_seconds : spent compiling or loading kernels in this run; 0 where all replicates were found.
    key : sha256 of all that decides a replicate's bits but its number.
    """

    variant: Variant
    own: Limit
    samples: tuple[int, ...]
    images: np.ndarray
    files: tuple[Path, ...]
    seconds: np.ndarray
    counts: dict[str, int]
    kernels: tuple[str, ...]
    compile_seconds: float
    key: str

    def rendered(self, replicate: int) -> np.ndarray:
        """Mean of all samples of a replicate as it was rendered, (H, W, 3) float64."""
        with np.load(self.files[replicate]) as arrays:
            return arrays["rendered"]


def key(
    scene: Scene, variant: Variant, *, samples: int, seed: int, chain: Chain, fingerprint: str | None = None
) -> str:
    """sha256 of all that decides a replicate's bits but its number.

    `fingerprint` : of the variant's estimator; it is asked for its own without one.
    """
    estimator = variant.estimator
    settings = (
        scene.digest(without=()) if estimator.sees_all else content(scene, variant, chain=chain),
        variant.term,
        variant.name,
        samples,
        seed,
        chain if terms.TABLE[variant.term].meets else "",
        versions_of("numba", "numpy"),
        estimator.fingerprint() if fingerprint is None else fingerprint,
    )
    return hashlib.sha256(repr(settings).encode()).hexdigest()


def take(engine: Engine, job: Replicate, folder: Path) -> bool:
    """Compute a replicate and keep it in `folder`, unless it is there; whether it was not."""
    if _kept(job, folder):
        return False
    variant = VARIANTS[job.term][job.variant]
    done = np.array(list(engine.counts.values()))
    steps = list(
        engine.prefixes(
            variant, samples=job.counts[-1], seed=job.seed, replicate=job.number, chain=job.chain, counts=job.counts
        )
    )
    arrays = {
        "images": np.stack([image for _, image, _ in steps]).astype(np.float32),
        "rendered": steps[-1][1],
        "seconds": np.array([spent for _, _, spent in steps]),
        "counts": np.array(list(engine.counts.values())) - done,
        "kernels": np.array(engine.kernels_of(variant, chain=job.chain), np.str_),
    }
    write_atomically(job.path(folder), lambda temporary: np.savez(temporary, **arrays))
    return True


def read(jobs: Sequence[Replicate], own: Limit, folder: Path, *, compile_seconds: float = 0.0) -> Cell:
    """The replicates of one cell, all of which are kept.

    Raises
    ------
    ValueError : one of them is missing or damaged.
    """
    first = jobs[0]
    width, height = first.scene.resolution
    kept = []
    for job in jobs:
        found = _read(job.path(folder), (len(job.counts), height, width, 3))
        if found is None:
            raise ValueError(f"{job.path(folder)}: is missing or damaged: allowed is a replicate that was kept")
        kept.append(found)
    counts = np.sum([each["counts"] for each in kept], axis=0)
    return Cell(
        VARIANTS[first.term][first.variant],
        own,
        first.counts,
        np.stack([each["images"] for each in kept]),
        tuple(job.path(folder) for job in jobs),
        np.stack([each["seconds"] for each in kept]),
        dict(zip(COUNTERS, counts.tolist(), strict=True)),
        tuple(kept[-1]["kernels"].tolist()),
        compile_seconds,
        first.key,
    )


def _kept(job: Replicate, folder: Path) -> bool:
    width, height = job.scene.resolution
    return _read(job.path(folder), (len(job.counts), height, width, 3)) is not None


def _path(folder: Path, name: str, number: int) -> Path:
    return folder / name[:2] / f"{name}-{number:04d}.npz"


def _read(path: Path, shape: tuple[int, ...]) -> dict[str, np.ndarray] | None:
    """The arrays of a kept replicate; None where the file is missing or damaged (NPZ has checksums)."""
    try:
        with np.load(path) as arrays:
            kept = {name: arrays[name] for name in ("images", "rendered", "seconds", "counts", "kernels")}
    except (OSError, ValueError, KeyError, EOFError, RuntimeError, zipfile.BadZipFile):
        return None
    shapes = tuple(kept[name].shape for name in ("images", "rendered", "seconds", "counts"))
    return kept if shapes == (shape, shape[1:], shape[:1], (len(COUNTERS),)) else None
