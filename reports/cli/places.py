"""From an image to a sample: inspect and replay."""

from pathlib import Path
from typing import Annotated, Any

import attrs
import numpy as np
from cyclopts import Parameter
from rich.console import Console

from termwise.reports.cli import terminal
from termwise.reports.cli.terminal import Approximate, Integer, Json, MaybeInteger


def inspect(
    folder: Path,
    *,
    scene: str | None = None,
    term: str | None = None,
    variant: str | None = None,
    object_: Annotated[str | None, Parameter(name="--object")] = None,
    tile: tuple[int, int] | None = None,
    x: MaybeInteger = None,
    y: MaybeInteger = None,
    json_: Json = False,
) -> int:
    """Look into a finished run: image, term, object, tile, pixel; opens where the bias is.

    Parameters
    ----------
    folder
        What `compare` wrote, say out/compare.
    scene
        Only rows of this scene.
    term
        Only rows of this term, or "total".
    variant
        Only rows of this variant.
    object_
        Open this object; the most suspect if not given.
    tile
        Open the tile of 8 pixels that holds the pixel X Y.
    x
        Open the pixel of this column; needs Y.
    y
        Its row.
    """
    from termwise.reports.results import microscope

    if (x is None) != (y is None):
        raise ValueError(f"{'x' if x is None else 'y'}: is missing: allowed are both x and y, or none")
    opened = microscope.open_run(folder)
    rows = opened.judged(scene, term, variant)
    row = rows[0]
    try:
        found = microscope.branch(
            opened.group(row["scene"]),
            row["term"],
            row["variant"],
            object=object_,
            tile=tile,
            pixel=None if x is None or y is None else (x, y),
        )
    except ValueError as error:
        raise ValueError(f"{row['scene']}, {row['term']} {row['variant']}: {error}") from None
    command = None if found.replicate is None else opened.replay(row, found)
    if json_:
        identity = {name: row[name] for name in ("scene", "term", "variant", "verdict", "sentence")}
        terminal.say_json(identity | attrs.asdict(found) | {"replay": command})
        return 0
    _print_branch(rows, found)
    if command is not None:
        terminal.say(command, markup=False)
    return 0


_SHOWN_PLACES, _SHOWN_ROWS = 4, 6


def _print_branch(rows: list[dict[str, Any]], found: Any) -> None:
    """A tree: the rows, worst first, and the branch of the first of them."""
    from rich.text import Text
    from rich.tree import Tree

    from termwise.reports.pages.digits import interval

    def label(name: str, place: Any) -> Text:
        size = f", {place.pixels} pixels" if place.pixels > 1 else ""
        return Text(f"{name}{size}: {interval(place.bias, place.low, place.high)}  z = {place.z:+.1f}")

    row = rows[0]
    tree = Tree(Text(f"{row['scene']}: bias [90 %], z of luminance", "bold"))
    opened = tree.add(
        Text(f"{row['term']} {row['variant']}: {row['verdict']}", terminal.COLOURS.get(row["verdict"], ""))
    )
    at = opened.add(label("image", found.image))
    for level, chosen, places in (
        ("object ", found.object, found.objects),
        ("", found.tile, found.tiles),
        ("", found.at, found.pixels),
    ):
        others = [place for place in places if place is not chosen]
        inner = at.add(label(level + chosen.name, chosen))
        for place in others[: _SHOWN_PLACES - 1]:
            at.add(label(level + place.name, place))
        if len(others) >= _SHOWN_PLACES:
            at.add(Text(f"{len(others) - _SHOWN_PLACES + 1} more", "dim"))
        at = inner
    at.add(Text(f"mean of ours  {_known(found.ours, found.ours_error)}"))
    at.add(Text(f"reference     {_known(found.reference, found.reference_error)}"))
    if found.value is not None:
        at.add(Text(f"replicate {found.replicate}: {'  '.join(f'{each:.7g}' for each in found.value)}"))
    for other in rows[1:_SHOWN_ROWS]:
        where = "" if other["scene"] == row["scene"] else f"{other['scene']}: "
        bias = "" if other["bias"] is None else f", {100 * other['bias']:+.2f} %"
        tree.add(Text(f"{where}{other['term']} {other['variant']}: {other['verdict']}{bias}"))
    if len(rows) > _SHOWN_ROWS:
        tree.add(Text(f"{len(rows) - _SHOWN_ROWS} more rows", "dim"))
    # What is not a terminal has 80 columns, where the numbers would be cut.
    Console(width=max(terminal.output.width, 120)).print(tree)


def replay(
    *,
    scene: str,
    term: str,
    variant: str | None = None,
    x: Integer,
    y: Integer,
    replicate: Integer,
    study: str = "standard",
    samples: MaybeInteger = None,
    seed: MaybeInteger = None,
    approximate: Approximate = False,
    results: Path | None = None,
    json_: Json = False,
) -> int:
    """Compute one pixel of one replicate of a study again, and print what happens in each of its samples.

    Parameters
    ----------
    scene
        A scene as the study has it: a name of the library, the path of a scene file, or SCENE.SETTING.
    term
        ambient, direct, specular, transmission or background.
    variant
        An estimator of the term; its default if not given, which of direct is the one that auto takes in the scene.
    x
        The pixel's column, from 0 at the left.
    y
        Its row, from 0 at the top.
    replicate
        Number of the replicate, from 0.
    study
        quick, standard, full, or the path of a study file; it says resolution, photons, samples and seed.
    samples
        Samples per pixel, instead of the study's.
    seed
        Instead of the study's.
    results
        Folder of a run: the value is held against the one stored there. Exit status 1 where they differ.
    """
    from termwise.renderer.auto import chosen
    from termwise.renderer.replay import replay as replayed
    from termwise.renderer.terms import AUTO, find, named
    from termwise.reports.results import microscope
    from termwise.reports.statistics import sequential
    from termwise.reports.study import allotment, subjects
    from termwise.reports.study import study as studies

    asked = studies.load(study)
    name = named(term, variant)
    # Which scene it is tells what `auto` takes there.
    subject, count = subjects.named(asked, scene, find(term, None if name == AUTO else name), approximate=approximate)
    estimator = chosen(subject.scene, term, name)
    if name == AUTO:
        subject, count = subjects.named(asked, scene, estimator, approximate=approximate)
    most = asked.replicates * sequential.LOOKS[-1] * (1 if asked.half_width is None else allotment.MOST)
    if not 0 <= replicate < most:
        allowed = f"an integer in [0, {most - 1}], those that the study {study} may have"
        raise ValueError(f"replicate = {replicate}: allowed is {allowed}")
    if seed is not None:
        terminal.check_seed(seed)
    kept = None
    if results is not None:
        kept, image = microscope.rendered(
            microscope.open_run(results).group(subject.scene.name), estimator.term, estimator.name
        )
        if replicate != kept:
            raise ValueError(f"replicate = {replicate}: allowed is {kept}, the one that {results} stores whole")
        height, width = image.shape[:2]
        if (width, height) != subject.scene.resolution:
            raise ValueError(
                f"{results}: is of {width} x {height} pixels: allowed is a run of the study {study}, of "
                f"{' x '.join(map(str, subject.scene.resolution))}"
            )
    found = replayed(
        subject.scene,
        estimator,
        x=x,
        y=y,
        samples=count if samples is None else samples,
        seed=asked.seed if seed is None else seed,
        replicate=replicate,
        chain=subject.chain,
    )
    stored = None if kept is None else image[y, x]
    same = None if stored is None else found.value.tobytes() == stored.tobytes()
    if json_:
        described = {
            "scene": subject.scene.name,
            "term": estimator.term,
            "variant": estimator.name,
            "auto": estimator.chosen,
            "x": x,
            "y": y,
            "replicate": replicate,
            "value": found.value.tolist(),
            "skipped": found.skipped,
            "stored": None if stored is None else stored.tolist(),
            "equals_stored": same,
            "samples": [attrs.asdict(sample) | {"radiance": sample.radiance.tolist()} for sample in found.samples],
        }
        terminal.say_json(described)
    else:
        if estimator.chosen:
            terminal.say(f"{term} {estimator.name}: {estimator.chosen}")
        _print_replay(found)
        if same is not None:
            word = "equal to the bit" if same else f"NOT equal: {_numbers(stored)}; other sources, seed or samples?"
            terminal.say(f"stored in {results}: {word}")
    if found.astray:
        terminal.messages.print(
            f"termwise: the trace of samples {', '.join(map(str, found.astray))} took another way than the kernel",
            highlight=False,
        )
    return 1 if same is False else 0


def _print_replay(found: Any) -> None:
    """Sample by sample what happened, then the pixel."""
    for sample in found.samples:
        terminal.output.print(f"[bold]sample {sample.index}[/bold]")
        for event in sample.events:
            rest = {name: value for name, value in event.items() if name not in ("event", "gathered")}
            line = "  ".join(f"{name} {'-' if value is None else _numbers(value)}" for name, value in rest.items())
            terminal.say(f"  {event['event']}: {line}", markup=False)
        terminal.say(f"  radiance {_numbers(sample.radiance)}  (trace: {sample.ulp:.2g} ulp apart)")
    if found.skipped is not None:
        terminal.say(f"no sample: {found.skipped}")
    terminal.say(f"pixel {_numbers(found.value)}")


def _known(values: Any, errors: Any) -> str:
    """Numbers to the second digit of their standard errors; where there is none, as float32 knows them."""

    def shown(value: float, error: float) -> str:
        if not (np.isfinite(value) and 0 < error < np.inf):
            return f"{value:.7g}"
        decimals = max(0, 1 - int(f"{error:.1e}".partition("e")[2]))
        return f"{value:.{decimals}f} ± {error:.{decimals}f}"

    return "  ".join(map(shown, values, errors))


def _numbers(values: Any) -> str:
    """All digits of numbers, which bits need; truths as words."""
    if isinstance(values, list | tuple | np.ndarray):
        return " ".join(repr(float(value)) for value in values)
    return repr(values) if isinstance(values, float) else str(values)
