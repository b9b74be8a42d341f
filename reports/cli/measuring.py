"""Benchmarks and the stress lab: bench rays, terms, scaling, reductions, view; stress."""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from termwise.reports import progress
from termwise.reports.cli import terminal
from termwise.reports.cli.terminal import Integer, Json, MaybeInteger, Names, Quiet, Threads

Scenes = Annotated[Names, Parameter(help="two_cubes, cornell_box, cornell_box_unshadowed, monkey; all if none.")]
Side = Annotated[Integer, Parameter(help="Pixels of a side of the square image.")]
Out = Annotated[Path, Parameter(help="The numbers go to OUT/bench, into a file of the command's name.")]


def rays(
    *,
    mesh: Names = None,
    pairs: Integer = 7,
    count: Integer = 2**19,
    threads: Threads = None,
    out: Out = Path("out"),
    quiet: Quiet = False,
    json_: Json = False,
) -> int:
    """Trace the same rays with ours and with Mitsuba's Embree, in alternating pairs.

    Parameters
    ----------
    mesh
        Names of meshes: boxes, monkey, ball-20k, ball-328k, monkey-1m; all if none.
    pairs
        Pairs of runs a case; the ratio is their median.
    count
        Rays of a case, about.
    """
    from termwise.reports.bench import rays as bench

    run = functools.partial(bench.measure, threads=threads, pairs=pairs, count=count, only=tuple(mesh or ()))
    measured = _benchmark(out, "rays", run, quiet=quiet, json_=json_)
    if json_:
        return 0
    _print_cases(
        measured["cases"],
        {
            "mesh": "{mesh}",
            "triangles": "{triangles}",
            "rays": "{kind}",
            "ours": "{ours_mrays:.1f}",
            "Mitsuba": "{mitsuba_mrays:.1f}",
            "ratio": "{ratio:.2f}",
            "spread": "{ratio_low:.2f}-{ratio_high:.2f}",
            "by CPU": "{ratio_processor:.2f}",
            "default": "{ratio_default:.2f}",
        },
    )
    terminal.output.print(
        "Millions of rays a second; the ratio is the median of pairs with Mitsuba's robust flag, then the same by "
        "processor time, then with its default flags.",
        soft_wrap=True,
    )
    for row in measured["builds"]:
        terminal.output.print(
            f"{row['mesh']}: built in {row['seconds']:.2f} s, {row['bytes_per_triangle']:.0f} bytes a triangle"
        )
    _print_machine(measured["machine"])
    _say_where(out / "bench")
    return 0


def terms(
    *,
    scene: Scenes = None,
    term: Names = None,
    resolution: Side = 128,
    runs: Integer = 5,
    seconds: float = 0.5,
    threads: Threads = None,
    out: Out = Path("out"),
    quiet: Quiet = False,
    json_: Json = False,
) -> int:
    """Measure seconds to equal error, ours beside Mitsuba's best setting, term by term.

    Parameters
    ----------
    term
        ambient, direct, specular, transmission; all if none.
    runs
        Alternating runs of each side; the speed-up is their median.
    seconds
        What the longest run of a setting may take, about.
    """
    from termwise.reports.bench import equal_error

    run = functools.partial(equal_error.measure, scenes=tuple(scene or ()), terms=tuple(term or ()))
    run = functools.partial(run, resolution=resolution, runs=runs, seconds=seconds, threads=threads)
    measured = _benchmark(out, "terms", run, quiet=quiet, json_=json_)
    if json_:
        return 0
    for case in measured["cases"]:
        case["of"] = case["term"] if case["term"] != "direct" else f"direct {case['scope']}"
    _print_scenes(
        measured["cases"],
        {
            "term": "{of}",
            "variant": "{variant}",
            "RMSE": "{target_rmse:.2g}",
            "ours": "{ours_s:.3f}",
            "Mitsuba": "{mitsuba_s:.3f}",
            "times": "{speedup:.2f}",
            "spread": "{speedup_low:.2f}-{speedup_high:.2f}",
            "its setting": "{mitsuba_setting}",
        },
    )
    for case in measured["apart"]:
        terminal.output.print(f"{case['scene']}, {case['term']} {case['variant']}: no error that both sides reach")
    terminal.output.print(
        "Seconds of rendering alone to a root mean square error (radiance), and how many times as long Mitsuba takes "
        "in its fastest setting, median of runs (xN: rays that share a hit; rr: roulette).",
        soft_wrap=True,
    )
    _print_machine(measured["machine"])
    _say_where(out / "bench")
    return 0


def scaling(
    *,
    axis: Names = None,
    runs: Integer = 5,
    threads: MaybeInteger = None,
    out: Out = Path("out"),
    quiet: Quiet = False,
    json_: Json = False,
) -> int:
    """Measure what one more triangle, pixel, sample, photon or thread costs, and memory.

    Parameters
    ----------
    axis
        triangles, pixels, samples, photons, threads; all if none.
    runs
        Rounds; their median counts.
    threads
        The most threads; one per core if not given.
    """
    from termwise.reports.bench import scaling as bench

    run = functools.partial(bench.measure, axes=tuple(axis or ()), runs=runs, threads=threads)
    measured = _benchmark(out, "scaling", run, quiet=quiet, json_=json_)
    if json_:
        return 0
    for case in measured["cases"]:
        processes = case.get("processes", 1)
        case["at"] = f"{case['value']}" if processes == 1 else f"{processes} processes"
    _print_cases(
        measured["cases"],
        {
            "axis": "{axis}",
            "value": "{at}",
            "seconds": "{seconds:.4f}",
            "spread": "{seconds_low:.4f}-{seconds_high:.4f}",
            "ns each": "{per_unit_ns:.0f} / {unit}",
            "MB": "{memory_mb:.0f}",
        },
    )
    for case in measured["cases"]:
        if "of_processes" in case:
            terminal.output.print(
                f"{case['value']} threads reach {case['of_processes']:.2f} "
                f"({case['of_processes_low']:.2f}-{case['of_processes_high']:.2f}) of as many processes."
            )
    _print_machine(measured["machine"])
    _say_where(out / "bench")
    return 0


def reductions(
    *,
    scene: Scenes = None,
    reduction: Names = None,
    resolution: Side = 48,
    batches: Integer = 4,
    threads: Threads = None,
    out: Out = Path("out"),
    quiet: Quiet = False,
    json_: Json = False,
) -> int:
    """Measure what each reduction is worth at equal error, and that it shifts no mean.

    Parameters
    ----------
    reduction
        aimed, counts, lights, splitting, roulette; all if none.
    batches
        Of 8 replicates each way; the median of their ratios counts.
    """
    from termwise.reports.bench import reductions as bench

    run = functools.partial(bench.measure, scenes=tuple(scene or ()), reductions=tuple(reduction or ()))
    run = functools.partial(run, resolution=resolution, batches=batches, threads=threads)
    measured = _benchmark(out, "reductions", run, quiet=quiet, json_=json_)
    failed = [case for case in measured["cases"] if case["verdict"] in terminal.PROVEN]
    if json_:
        return 1 if failed else 0
    _print_scenes(
        measured["cases"],
        {
            "reduction": "{reduction}",
            "term": "{term}",
            "variant": "{variant}",
            "variance": "{variance:.2f}",
            "seconds": "{seconds:.2f}",
            "cost": "{cost:.2f}",
            "spread": "{cost_low:.2f}-{cost_high:.2f}",
            "verdict": "{verdict}",
        },
    )
    terminal.output.print(
        "With the reduction over without it: variance, processor seconds, and their product, which is what equal error "
        "costs; below 1 is a gain. The verdict compares the means.",
        soft_wrap=True,
    )
    _print_machine(measured["machine"])
    _say_where(out / "bench")
    return 1 if failed else 0


def bench_view(
    *,
    scene: Scenes = None,
    changes: Integer = 30,
    memory_changes: Integer = 1000,
    resolution: Side = 256,
    threads: Threads = None,
    out: Out = Path("out"),
    quiet: Quiet = False,
    json_: Json = False,
) -> int:
    """Measure how long a changed input takes to be seen on the page of `termwise view`, and whether memory stays.

    Parameters
    ----------
    changes
        Of each input; their median counts.
    memory_changes
        Changes of all inputs in turn, over which memory is measured.
    """
    from termwise.reports.bench import view as bench

    run = functools.partial(bench.measure, scenes=tuple(scene or ()), changes=changes, memory_changes=memory_changes)
    run = functools.partial(run, resolution=resolution, threads=threads)
    measured = _benchmark(out, "view", run, quiet=quiet, json_=json_)
    if json_:
        return 0
    _print_cases(
        measured["cases"],
        {
            "scene": "{scene}",
            "input": "{input}",
            "seconds": "{seconds:.3f}",
            "spread": "{seconds_low:.3f}-{seconds_high:.3f}",
            "processor": "{processor:.3f}",
            "previews": "{previews} of {changes}",
        },
    )
    memory = measured["memory"]
    said = " and ".join(
        f"{megabytes:.0f} MB after {count}"
        for count, megabytes in zip(memory["changes"], memory["megabytes"], strict=True)
    )
    terminal.output.print(
        f"From a change to the first picture, {resolution} x {resolution} pixels; a preview has a quarter of them. "
        f"Processor: seconds of all threads, which other work on the machine hardly changes. "
        f"Memory: {said} changes of {memory['scene']}.",
        soft_wrap=True,
    )
    _print_machine(measured["machine"])
    _say_where(out / "bench")
    return 0


def stress(
    *,
    group: Names = None,
    case: str = "",
    count: Integer = 4096,
    out: Path = Path("out"),
    quiet: Quiet = False,
    json_: Json = False,
) -> int:
    """Assert exact and analytic properties under hostile input, ours beside the paper's code and Mitsuba.

    Parameters
    ----------
    group
        Names of groups; all if none.
    case
        Only the row of this name, or those whose names have it in them.
    count
        Rays or samples of a row, about.
    out
        The numbers go to OUT/stress/stress.json, the page beside it.
    """
    from termwise.reports import stress as lab
    from termwise.reports.pages import stress as page

    run = functools.partial(lab.measure, groups=tuple(group or ()), case=case, count=count)
    measured = _measured(out / "stress", "stress", run, page.write, quiet=quiet, json_=json_)
    if not json_:
        _print_stress(measured)
        _say_where(out / "stress")
    return 1 if measured["failed"] else 0


def _print_stress(measured: dict[str, Any]) -> None:
    shown = lambda value: "-" if value is None else f"{value:.3g}"  # noqa: E731
    for group in dict.fromkeys(case["group"] for case in measured["cases"]):
        table = terminal.table(title=group)
        for name in ("row", "ours", "paper", "Mitsuba", "limit", ""):
            table.add_column(name, justify="left" if name in ("row", "") else "right")
        for case in measured["cases"]:
            if case["group"] == group:
                colour, word = ("green", "passed") if case["passed"] else ("red", "FAILED")
                figures = (shown(case[name]) for name in ("ours", "paper", "mitsuba", "limit"))
                table.add_row(case["name"], *figures, f"[{colour}]{word}[/{colour}]")
        terminal.output.print(table)
    for case in measured["cases"]:
        if not case["passed"]:
            why = case["faults"].get("ours", f"{case['figure']}: {shown(case['ours'])} > {shown(case['limit'])}")
            terminal.say(f"{case['group']}: {case['name']}: {why}", markup=False)
    terminal.output.print(
        f"{len(measured['cases'])} rows in {measured['seconds']:.0f} s, {measured['failed']} failed", highlight=False
    )


def _print_cases(cases: list[dict[str, Any]], columns: dict[str, str], title: str | None = None) -> None:
    """Print a row for each case: the columns' headings, and how they write a case."""
    table = terminal.table(*columns, title=title)
    for case in cases:
        table.add_row(*(form.format_map(case) for form in columns.values()))
    terminal.output.print(table)


def _print_scenes(cases: list[dict[str, Any]], columns: dict[str, str]) -> None:
    """Print a table for each scene."""
    for name in dict.fromkeys(case["scene"] for case in cases):
        _print_cases([case for case in cases if case["scene"] == name], columns, name)


def _benchmark(
    out: Path, name: str, measure: Callable[..., dict[str, Any]], *, quiet: bool, json_: bool
) -> dict[str, Any]:
    """Measure one benchmark of OUT/bench."""
    from termwise.reports.pages import bench as page

    return _measured(out / "bench", name, measure, page.write, quiet=quiet, json_=json_)


def _measured(
    folder: Path,
    name: str,
    measure: Callable[..., dict[str, Any]],
    write: Callable[[Path], Path],
    *,
    quiet: bool,
    json_: bool,
) -> dict[str, Any]:
    """Measure and show the progress; the numbers go to the folder with the command, and onto its page."""
    from termwise.reports.results import schema as stored

    terminal.folder(folder)
    with progress.stages(terminal.messages, quiet=quiet or json_, where=folder) as stage:
        measured = measure(report=stage(name.capitalize()))
    measured["command"] = terminal.command()
    stored.write(folder / f"{name}.json", measured)
    write(folder)
    if json_:
        terminal.say_json(measured)
    return measured


def _print_machine(machine: dict[str, Any]) -> None:
    text = f"{machine['processor']}, {machine['threads']} threads, load {machine['load']:.1f}"
    terminal.output.print(text)


def _say_where(folder: Path) -> None:
    terminal.output.print(f"\nReport: {(folder / 'index.html').resolve()}", soft_wrap=True)
