"""What `{scene}` is: a function a format, which writes what is asked into a folder and gives the file to name.

`neutral` holds all of it. `mitsuba`, `gltf` and `pbrt` are those of `scenes.exchange`; in Mitsuba's XML lamps may
reflect, and samples, seed and depth stand in it too. `termwise` is a scene file of ours.
"""

import importlib
import json
from collections.abc import Callable
from pathlib import Path

import attrs
import numpy as np

from termwise.reports.engines.asked import Asked
from termwise.scenes.exchange import mitsuba
from termwise.scenes.images import openexr
from termwise.scenes.save import save


def write(kind: str, asked: Asked, folder: Path, *, depth: int | None, spp: int, seed: int) -> Path:
    """Write what is asked in a format; `depth` None: light scatters as often as it likes."""
    folder.mkdir()
    return _WRITERS[kind](asked, folder, depth, spp, seed)


def _neutral(asked: Asked, folder: Path, depth: int | None, spp: int, seed: int) -> Path:
    sky = asked.described["sky"]
    if sky is not None and sky["type"] == "image":
        openexr.write(folder / sky["file"], _texture(asked))
    path = folder / "scene.json"
    path.write_text(json.dumps(asked.described, allow_nan=False), "utf-8")
    return path


def _termwise(asked: Asked, folder: Path, depth: int | None, spp: int, seed: int) -> Path:
    """Light that scatters once is direct light of the first hit; our renderer knows no other depth."""
    path = folder / "scene.toml"
    save(asked.scene if depth is None else attrs.evolve(asked.scene, scope="first-hit"), path)
    return path


def _exchanged(kind: str) -> Callable[[Asked, Path, int | None, int, int], Path]:
    def written(asked: Asked, folder: Path, depth: int | None, spp: int, seed: int) -> Path:
        module = importlib.import_module(f"termwise.scenes.exchange.{kind}")
        path = folder / f"scene{module.SUFFIX}"
        module.write(asked.scene, path)
        return path

    return written


def _texture(asked: Asked) -> np.ndarray:
    assert asked.scene.sky.texture is not None
    return asked.scene.sky.texture


def _mitsuba(asked: Asked, folder: Path, depth: int | None, spp: int, seed: int) -> Path:
    path = folder / "scene.xml"
    mitsuba.write_described(asked.described, asked.scene, path, depth=depth, spp=spp, seed=seed)
    return path


_WRITERS: dict[str, Callable[[Asked, Path, int | None, int, int], Path]] = {
    "neutral": _neutral,
    "mitsuba": _mitsuba,
    "termwise": _termwise,
    **{kind: _exchanged(kind) for kind in ("gltf", "pbrt")},
}
