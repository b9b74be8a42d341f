"""Other renderers: furnace, and what compare, render and judge do with --engine."""

from pathlib import Path
from typing import Annotated, Any

import attrs
from cyclopts import Parameter

from termwise.reports import progress
from termwise.reports.cli import terminal
from termwise.reports.cli.terminal import Integer, Json, MaybeInteger, Quiet, Threads

Engines = Annotated[
    list[str] | None,
    Parameter(name="--engine", negative="", help="A renderer as a command: its TOML file, or one that ships by name."),
]
OneEngine = Annotated[
    str | None, Parameter(name="--engine", help="A renderer as a command: its TOML file, or one that ships by name.")
]
Probed = Annotated[
    bool, Parameter(name="--probe", help="Probe an engine before it is believed: size, orientation, unit, seeds.")
]
Samples = Annotated[MaybeInteger, Parameter(name="--spp", help="Of an engine; what its file says if not given.")]


def furnace(
    *,
    engine: Engines = None,
    replicates: Integer = 8,
    seed: Integer = 1,
    spp: Samples = None,
    threads: Threads = None,
    probe: Probed = True,
    out: Path = Path("out"),
    quiet: Quiet = False,
    json_: Json = False,
) -> int:
    """Judge a renderer where its radiance is known exactly: closed boxes, open furnaces, lamps over a plate.

    No reference is rendered, and neither Numba nor Mitsuba is needed. Exit status: 0 no bias is proven; 1 one is; 2 the
    engine failed.

    Parameters
    ----------
    replicates
        Images of each scene, with other seeds.
    seed
        Names the seeds of all images.
    out
        Pages and numbers go to OUT/furnace.
    """
    from termwise.reports.judging import engines as judging

    found = [_load(name) for name in engine or ()]
    if not found:
        raise ValueError("engine: none given: allowed is --engine with the path or the name of one")
    how = judging.Asking(replicates=judging.enough(replicates), seed=seed, spp=spp, threads=threads, probed=probe)
    folder = terminal.folder(out / "furnace")
    with progress.stages(terminal.messages, quiet=quiet or json_, where=folder) as stage:
        judged = judging.furnace(found, folder, how, command=terminal.command(), report=stage("Furnaces"))
    return say(judged, folder, json_)


def compare(
    scenes: tuple[str, ...],
    engines: list[str],
    study: str,
    seed: int | None,
    *,
    spp: int | None,
    diffuse: bool,
    row: list[str] | None,
    probe: bool,
    approximate: bool,
    executor: Any,
    out: Path,
    quiet: bool,
    json_: bool,
) -> int:
    """`compare --engine`: all light and the terms of the study's scenes, by engines, against Mitsuba."""
    from termwise.reports.engines import asked
    from termwise.reports.judging import engines as judging
    from termwise.reports.study.study import load as study_of
    from termwise.reports.study.subjects import scenes_of
    from termwise.scenes.exchange import neutral

    found = [_load(name) for name in engines]
    names = [each.name for each in found]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"engine: {name!r} is given twice: allowed are distinct names")
    chosen = study_of(study)
    chosen = chosen if seed is None else attrs.evolve(chosen, seed=seed)
    read = scenes_of(chosen, scenes, approximate=approximate)
    for scene in read:
        terminal.say_substitutions(scene)
    prepared = [neutral.diffuse(scene) if diffuse else scene for scene in read]
    how = judging.Asking(replicates=chosen.replicates, seed=chosen.seed, spp=spp, probed=probe, executor=executor)
    folder = terminal.folder(out / "engines")
    with progress.stages(terminal.messages, quiet=quiet or json_, where=folder) as stage:
        judged = judging.compare(
            found,
            prepared,
            folder,
            how,
            reference_spp=chosen.reference_spp,
            reference_replicates=chosen.reference_replicates,
            only=tuple(row or asked.ROWS),
            command=terminal.command(),
            report=stage("Images"),
        )
    return say(judged, folder, json_)


def _load(name: str) -> Any:
    from termwise.reports.engines.engine import load

    return load(name)


def say(judged: Any, folder: Path, json_: bool) -> int:
    """Print a line for each case, the hints, and what could not be judged; the exit status."""
    from termwise.reports.cli.judging import say_all
    from termwise.reports.judging import gates
    from termwise.reports.judging.suite import rows

    for each in judged.unjudged:
        if each.word == "FAILED":
            terminal.fail(each.reason)
    status = 2 if judged.failed else gates.worst(judged.outcomes, "unbiased")
    index = folder / "index.html"
    if json_:
        unjudged = [{"name": each.name, "verdict": each.word, "reason": each.reason} for each in judged.unjudged]
        cases = rows(judged.outcomes, folder)
        terminal.say_json({"status": status, "page": str(index), "cases": cases, "unjudged": unjudged})
        return status
    for note in judged.notes:
        terminal.messages.print(f"termwise: {note}", soft_wrap=True, highlight=False, markup=False)
    say_all(judged.outcomes)
    for each in judged.unjudged:
        if each.word == "ABSENT":
            terminal.say(f"{each.name}  ABSENT: {each.reason}", markup=False)
    terminal.say(f"\nReport: {index.resolve()}")
    return status
