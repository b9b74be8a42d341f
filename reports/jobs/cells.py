"""Cells (scene, term, variant): the replicate images of an estimator, computed once and kept on disk.

A replicate is one file: the float32 means of the first 1, 2, 4, ... N samples, the last of them in float64 too, the
seconds that each took, and the work that was done. Its name is the digest of all that decides its bits, so a run that
was interrupted, or one with nothing changed, finds it again.
"""

import hashlib
import importlib.metadata
import zipfile
from collections.abc import Callable
from pathlib import Path

import attrs
import numpy as np

from termwise.renderer.plan import powers_of_two
from termwise.renderer.scratch import COUNTERS
from termwise.renderer.terms import Chain, Variant
from termwise.renderer.tiles import Engine
from termwise.scenes import terms
from termwise.scenes.limits import Limit
from termwise.scenes.model import Scene
from termwise.scenes.store import ROOT, sources_digest, write_atomically


def content(scene: Scene, variant: Variant, *, chain: Chain) -> str:
    """sha256 of what a term's image depends on in a scene: where it is equal, so is every byte of the image."""
    without = terms.PHOTONS if variant.photons(scene, chain) is None else ()
    return terms.content(scene, variant.term, without=without)


@attrs.frozen(eq=False)
class Cell:
    """Replicates of one variant.

    Attributes
    ----------
    own : the limit that it is judged against.
    samples : (P,) the prefixes 1, 2, 4, ..., N, or N alone.
    images : (K, P, H, W, 3) float32.
    files : of the replicates, in order; none of an estimator in Python.
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

    def rendered(self, replicate: int) -> np.ndarray | None:
        """Mean of all samples of a replicate as it was rendered, (H, W, 3) float64; None of an estimator in Python."""
        if not self.files:
            return None
        with np.load(self.files[replicate]) as arrays:
            return arrays["rendered"]


def key(scene: Scene, variant: Variant, *, samples: int, seed: int, chain: Chain) -> str:
    """sha256 of all that decides a replicate's bits but its number."""
    versions = [importlib.metadata.version(package) for package in ("numba", "numpy")]
    sources = sources_digest(ROOT / "renderer", ROOT / "scenes")
    used = chain if terms.TABLE[variant.term].meets else ""
    settings = (
        content(scene, variant, chain=chain),
        variant.term,
        variant.name,
        samples,
        seed,
        used,
        versions,
        sources,
    )
    return hashlib.sha256(repr(settings).encode()).hexdigest()


def cell(
    engine: Engine,
    variant: Variant,
    *,
    own: Limit,
    samples: int,
    replicates: int,
    seed: int,
    chain: Chain,
    folder: Path,
    progress: Callable[[], object],
    before: Cell | None = None,
    swept: bool = True,
) -> Cell:
    """Take the replicates of a cell from `folder`; compute and keep those that it lacks.

    `swept`: whether images are kept at 1, 2, 4, ... samples, or at the last alone. `progress` is called after each
    replicate. `before` are the first replicates of the same cell, where a run has them at hand: they are not taken
    again.
    """
    name = key(engine.scene, variant, samples=samples, seed=seed, chain=chain)
    prefixes = powers_of_two(samples) if swept else (samples,)
    width, height = engine.scene.resolution
    compiled = engine.compile_seconds
    images, seconds, files, counts = [], [], [], np.zeros(len(COUNTERS), np.int64)
    kernels: tuple[str, ...] = ()
    if before is not None:
        images, seconds, files = list(before.images), list(before.seconds), list(before.files)
        counts += np.array(list(before.counts.values()))
        kernels = before.kernels
    for replicate in range(len(images), replicates):
        path = folder / name[:2] / f"{name}-{replicate:04d}.npz"
        # An estimator in Python is not known by its source alone: it is computed each time.
        kept = _read(path, (len(prefixes), height, width, 3)) if variant.function is None else None
        if kept is None:
            done = np.array(list(engine.counts.values()))
            steps = list(
                engine.prefixes(
                    variant, samples=samples, seed=seed, replicate=replicate, chain=chain, counts=prefixes
                )
            )
            kept = {
                "images": np.stack([image for _, image, _ in steps]).astype(np.float32),
                "rendered": steps[-1][1],
                "seconds": np.array([spent for _, _, spent in steps]),
                "counts": np.array(list(engine.counts.values())) - done,
                "kernels": np.array(engine.kernels_of(variant, chain=chain), np.str_),
            }
            if variant.function is None:
                write_atomically(path, lambda temporary, kept=kept: np.savez(temporary, **kept))
        images.append(kept["images"])
        if variant.function is None:
            files.append(path)
        seconds.append(kept["seconds"])
        counts += kept["counts"]
        kernels = tuple(kept["kernels"].tolist())
        progress()
    return Cell(
        variant,
        own,
        prefixes,
        np.stack(images),
        tuple(files),
        np.stack(seconds),
        dict(zip(COUNTERS, counts.tolist(), strict=True)),
        kernels,
        engine.compile_seconds - compiled,
        name,
    )


def _read(path: Path, shape: tuple[int, ...]) -> dict[str, np.ndarray] | None:
    """The arrays of a kept replicate; None where the file is missing or damaged (NPZ has checksums)."""
    try:
        with np.load(path) as arrays:
            kept = {name: arrays[name] for name in ("images", "rendered", "seconds", "counts", "kernels")}
    except (OSError, ValueError, KeyError, EOFError, RuntimeError, zipfile.BadZipFile):
        return None
    shapes = tuple(kept[name].shape for name in ("images", "rendered", "seconds", "counts"))
    return kept if shapes == (shape, shape[1:], shape[:1], (len(COUNTERS),)) else None
