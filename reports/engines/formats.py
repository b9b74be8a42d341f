"""What `{scene}` is: a function a format, which writes what is asked into a folder and gives the file to name."""

import json
from collections.abc import Callable
from pathlib import Path

import attrs

from termwise.reports.engines.asked import Asked
from termwise.scenes.images import openexr
from termwise.scenes.save import save


def write(kind: str, asked: Asked, folder: Path, *, depth: int | None) -> Path:
    """Write what is asked in a format; `depth` None: light scatters as often as it likes."""
    folder.mkdir()
    return _WRITERS[kind](asked, folder, depth)


def _neutral(asked: Asked, folder: Path, depth: int | None) -> Path:
    """The depth is in the command."""
    _sky(asked, folder)
    path = folder / "scene.json"
    path.write_text(json.dumps(asked.described, allow_nan=False), "utf-8")
    return path


def _termwise(asked: Asked, folder: Path, depth: int | None) -> Path:
    """Light that scatters once is direct light of the first hit; our renderer knows no other depth."""
    assert asked.scene is not None
    path = folder / "scene.toml"
    save(asked.scene if depth is None else attrs.evolve(asked.scene, scope="first-hit"), path)
    return path


def _sky(asked: Asked, folder: Path) -> None:
    """The sky's image, by the name that the description has for it."""
    sky = asked.described["sky"]
    if sky is not None and sky["type"] == "image":
        assert asked.scene is not None
        texture = asked.scene.sky.texture
        assert texture is not None
        openexr.write(folder / sky["file"], texture)


_WRITERS: dict[str, Callable[[Asked, Path, int | None], Path]] = {"neutral": _neutral, "termwise": _termwise}
