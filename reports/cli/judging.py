"""The verdict on the images of any renderer: judge."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from termwise.reports.cli import terminal
from termwise.reports.cli.terminal import Flag, Json


def judge(
    *images: Path,
    reference: Annotated[list[Path], Parameter(consume_multiple=True)],
    reference_exact: Flag = False,
    noiseless: Flag = False,
    part: str | None = None,
    exposure: float | None = None,
    out: Path = Path("out"),
    json_: Json = False,
) -> int:
    """Judge any renderer's replicate images against replicates of a reference, and write a page about it.

    Parameters
    ----------
    images
        OpenEXR replicates of one image (equal settings, different seeds), or folders of them. At least 4, better 16.
    reference
        Replicates of the reference, files or folders.
    reference_exact
        The one reference image has no noise.
    noiseless
        The renderer has no noise: its replicates may all be the same image.
    part
        Name of the part to read where a file has several.
    exposure
        Factor on the radiance in the pictures; by default the reference's mean is shown as middle grey.
    out
        Page, numbers and images go to OUT/judge.
    """
    from termwise.reports import judging
    from termwise.reports.pages import judge as page

    files = {name: _files(name, given) for name, given in (("images", images), ("reference", reference))}
    stacks = {name: [_read(path, part) for path in found] for name, found in files.items()}
    folder = terminal.folder(out / "judge")
    outcome = judging.judge(
        stacks["images"],
        stacks["reference"],
        folder,
        exact=reference_exact,
        noiseless=noiseless,
        names=[str(path) for path in files["images"]],
        reference_names=[str(path) for path in files["reference"]],
        exposure=exposure,
        command=terminal.command(),
    )["verdict"]
    index = page.write(folder)
    for warning in outcome["warnings"]:
        terminal.messages.print(f"termwise: {warning}", soft_wrap=True, highlight=False)
    if json_:
        print(json.dumps(outcome | {"page": str(index)}))
        return 1 if outcome["verdict"] == "BIASED" else 0
    terminal.output.print(f"[bold]{outcome['verdict']}[/bold]", highlight=False)
    terminal.say(outcome["sentence"])
    for reason in outcome["reasons"]:
        terminal.say(f"- {reason}")
    for size in outcome["tiles"]:
        terminal.say(_of_tiles(size))
    terminal.say(f"\nReport: {index.resolve()}")
    return 1 if outcome["verdict"] == "BIASED" else 0


def _files(name: str, given: Sequence[Path]) -> list[Path]:
    """The files named, and those of the folders named."""
    if not given:
        raise ValueError(f"{name}: none given: allowed are OpenEXR files, or folders of them")
    found = []
    for path in given:
        inside = sorted(path.glob("*.exr")) if path.is_dir() else [path]
        if not inside:
            raise ValueError(f"{path}: holds no .exr file: allowed are folders of OpenEXR replicates")
        found += inside
    return found


def _read(path: Path, part: str | None) -> np.ndarray:
    from termwise.reports.results.exr import read_exr

    if not path.is_file():
        raise ValueError(f"{path}: no such file: allowed are OpenEXR images")
    parts = read_exr(path)
    if part is None and len(parts) == 1:
        return next(iter(parts.values()))
    if part not in parts:
        raise ValueError(f"{path}: part = {part!r}: allowed are {', '.join(map(repr, parts))}")
    return parts[part]


def _of_tiles(size: dict[str, Any]) -> str:
    """What the tests of one size of tiles found, in a line."""
    what = f"tiles of {size['side']} px"
    if size["merged_into"] is not None:
        return f"{what}: merged into those of {size['merged_into']} px (median skewness {size['skewness']:.2f})"
    found = f"{size['holm']} of {size['tested']} found by Holm, {size['benjamini_hochberg']} by Benjamini-Hochberg"
    text = f"{what}: {found}"
    return text if size["uniform_p"] is None else f"{text}; p is uniform with p = {size['uniform_p']:.2g}"
