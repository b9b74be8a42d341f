"""The verdict on the images of any renderer: judge."""

import json
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from termwise.reports.cli import terminal
from termwise.reports.cli.terminal import Flag, Json


def judge(
    *images: Path,
    reference: Annotated[list[Path], Parameter(consume_multiple=True)],
    reference_exact: Flag = False,
    noiseless: Flag = False,
    layer: str | None = None,
    reference_layer: str | None = None,
    exposure: float | None = None,
    out: Path = Path("out"),
    json_: Json = False,
) -> int:
    """Judge any renderer's replicate images against replicates of a reference, and write a page about it.

    Parameters
    ----------
    images
        Replicates of one image (equal settings, different seeds), or folders of them: OpenEXR, NPY, NPZ, PFM, Radiance
        HDR, float TIFF. At least 4, better 16.
    reference
        Replicates of the reference, files or folders.
    reference_exact
        The one reference image has no noise.
    noiseless
        The renderer has no noise: its replicates may all be the same image.
    layer
        Name of the layer to read where a file of ours has several of colour: Combined, or ViewLayer.Combined.
    reference_layer
        The same of the reference's files.
    exposure
        Factor on the radiance in the pictures; by default the reference's mean is shown as middle grey.
    out
        Page, numbers and images go to OUT/judge.
    """
    from termwise.reports import judging
    from termwise.reports.pages import judge as page
    from termwise.scenes.images import replicates

    if not images:
        raise ValueError("images: none given: allowed are images of replicates, or folders of them")
    ours, truth = replicates(images, layer), replicates(reference, reference_layer)
    ours.check_window(truth)
    folder = terminal.folder(out / "judge")
    outcome = judging.judge(
        ours.pixels,
        truth.pixels,
        folder,
        exact=reference_exact,
        noiseless=noiseless,
        names=ours.names,
        reference_names=truth.names,
        notes=ours.notes + truth.notes,
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


def _of_tiles(size: dict[str, Any]) -> str:
    """What the tests of one size of tiles found, in a line."""
    what = f"tiles of {size['side']} px"
    if size["merged_into"] is not None:
        return f"{what}: merged into those of {size['merged_into']} px (median skewness {size['skewness']:.2f})"
    found = f"{size['holm']} of {size['tested']} found by Holm, {size['benjamini_hochberg']} by Benjamini-Hochberg"
    text = f"{what}: {found}"
    return text if size["uniform_p"] is None else f"{text}; p is uniform with p = {size['uniform_p']:.2g}"
