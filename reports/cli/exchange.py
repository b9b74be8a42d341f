"""Scenes as files of other renderers: export."""

import importlib
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from termwise.reports.cli import terminal
from termwise.reports.cli.terminal import Approximate, Flag, Json, Resolution, SceneName
from termwise.scenes.exchange import neutral

Format = Literal["neutral", "mitsuba", "gltf", "pbrt", "obj"]


def export(
    scene: SceneName,
    *,
    to: Format,
    diffuse: Flag = False,
    resolution: Resolution = None,
    approximate: Approximate = False,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
    json_: Json = False,
) -> int:
    """Write a scene for another renderer, in the scene's own units and with its names.

    What the format cannot say is listed in the file and on standard error.

    Parameters
    ----------
    to
        neutral (JSON, for adapters), mitsuba (XML), gltf (GLB), pbrt (version 4), obj (with MTL).
    diffuse
        Every gloss, translucency and transparency is 0: what every format says exactly.
    output
        The file, or a folder for a file of the scene's name; out/export if not given.
    """
    module = importlib.import_module(f"termwise.scenes.exchange.{to}")
    described = terminal.scene(scene, resolution, approximate=approximate)
    if diffuse:
        described = neutral.diffuse(described)
    path = _path(output, described.name, module.SUFFIX)
    missing = module.write(described, path)
    for line in missing:
        terminal.messages.print(f"termwise: {path.name}: {line}", soft_wrap=True, highlight=False, markup=False)
    if json_:
        terminal.say_json({"scene": described.name, "to": to, "file": str(path), "left_out": missing})
    else:
        terminal.say(str(path), markup=False)
    return 0


def _path(output: Path | None, name: str, suffix: str) -> Path:
    """The file to write, in a folder that there is."""
    output = output or Path("out/export")
    if output.suffix in (".json", ".xml", ".glb", ".pbrt", ".obj") and not output.is_dir():
        if output.suffix != suffix:
            raise ValueError(f"output = {output}: allowed is a name that ends in {suffix}, or a folder")
        path = output
    else:
        path = output / f"{name}{suffix}"
    terminal.folder(path.parent)
    return path
