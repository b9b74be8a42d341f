"""Benchmarks and the stress lab: bench rays, terms, scaling, reductions, view; stress."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.table import Table

from termwise.reports import progress
from termwise.reports.cli import terminal
from termwise.reports.cli.terminal import Integer, Json, MaybeInteger, Names, Quiet
from termwise.reports.progress import Report
from termwise.scenes.store import write_atomically


def rays(
    *,
    mesh: Names = None,
    pairs: Integer = 7,
    count: Integer = 2**19,
    threads: MaybeInteger = None,
    out: Path = Path("out"),
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
    threads
        Threads of each side; one per core if not given.
    out
        The numbers go to OUT/bench/rays.json.
    quiet
        No progress on standard error.
    json_
        Print them on standard output.
    """
    from termwise.reports.bench import rays as bench_rays

    measured = _benchmark(
        out,
        "rays",
        lambda report: bench_rays.measure(
            threads=threads, pairs=pairs, count=count, only=tuple(mesh or ()), report=report
        ),
        quiet=quiet,
        json_=json_,
    )
    if json_:
        return 0
    columns = ("mesh", "triangles", "rays", "ours", "Mitsuba", "ratio", "spread", "by CPU", "default")
    table = terminal.table(*columns)
    for case in measured["cases"]:
        table.add_row(
            case["mesh"],
            str(case["triangles"]),
            case["kind"],
            f"{case['ours_mrays']:.1f}",
            f"{case['mitsuba_mrays']:.1f}",
            f"{case['ratio']:.2f}",
            f"{case['ratio_low']:.2f}-{case['ratio_high']:.2f}",
            f"{case['ratio_processor']:.2f}",
            f"{case['ratio_default']:.2f}",
        )
    terminal.output.print(table)
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
    return 0


def terms(
    *,
    scene: Names = None,
    term: Names = None,
    resolution: Integer = 128,
    runs: Integer = 5,
    seconds: float = 0.5,
    threads: MaybeInteger = None,
    out: Path = Path("out"),
    quiet: Quiet = False,
    json_: Json = False,
) -> int:
    """Measure seconds to equal error, ours beside Mitsuba's best setting, term by term.

    Parameters
    ----------
    scene
        two_cubes, cornell_box, cornell_box_unshadowed, monkey; all if none.
    term
        ambient, direct, specular; all if none.
    resolution
        Pixels of a side of the square image.
    runs
        Alternating runs of each side; the speed-up is their median.
    seconds
        What the longest run of a setting may take, about.
    threads
        Threads of each side; one per core if not given.
    out
        The numbers go to OUT/bench/terms.json.
    quiet
        No progress on standard error.
    json_
        Print them on standard output.
    """
    from termwise.reports.bench import equal_error

    measured = _benchmark(
        out,
        "terms",
        lambda report: equal_error.measure(
            scenes=tuple(scene or ()),
            terms=tuple(term or ()),
            resolution=resolution,
            runs=runs,
            seconds=seconds,
            threads=threads,
            report=report,
        ),
        quiet=quiet,
        json_=json_,
    )
    if json_:
        return 0
    for name in dict.fromkeys(case["scene"] for case in measured["cases"]):
        columns = ("term", "variant", "RMSE", "ours", "Mitsuba", "times", "spread", "its setting")
        table = terminal.table(*columns, title=name)
        for case in measured["cases"]:
            if case["scene"] == name:
                table.add_row(
                    case["term"] if case["term"] != "direct" else f"direct {case['scope']}",
                    case["variant"],
                    f"{case['target_rmse']:.2g}",
                    f"{case['ours_s']:.3f}",
                    f"{case['mitsuba_s']:.3f}",
                    f"{case['speedup']:.2f}",
                    f"{case['speedup_low']:.2f}-{case['speedup_high']:.2f}",
                    case["mitsuba_setting"],
                )
        terminal.output.print(table)
    for case in measured["apart"]:
        terminal.output.print(f"{case['scene']}, {case['term']} {case['variant']}: no error that both sides reach")
    terminal.output.print(
        "Seconds of rendering alone to a root mean square error (radiance), and how many times as long Mitsuba takes "
        "in its fastest setting, median of runs (xN: rays that share a hit; rr: roulette).",
        soft_wrap=True,
    )
    _print_machine(measured["machine"])
    return 0


def scaling(
    *,
    axis: Names = None,
    runs: Integer = 5,
    threads: MaybeInteger = None,
    out: Path = Path("out"),
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
    out
        The numbers go to OUT/bench/scaling.json.
    quiet
        No progress on standard error.
    json_
        Print them on standard output.
    """
    from termwise.reports.bench import scaling as bench_scaling

    measured = _benchmark(
        out,
        "scaling",
        lambda report: bench_scaling.measure(axes=tuple(axis or ()), runs=runs, threads=threads, report=report),
        quiet=quiet,
        json_=json_,
    )
    if json_:
        return 0
    table = terminal.table("axis", "value", "seconds", "spread", "ns each", "MB")
    for case in measured["cases"]:
        processes = case.get("processes", 1)
        table.add_row(
            case["axis"],
            f"{case['value']}" if processes == 1 else f"{processes} processes",
            f"{case['seconds']:.4f}",
            f"{case['seconds_low']:.4f}-{case['seconds_high']:.4f}",
            f"{case['per_unit_ns']:.0f} / {case['unit']}",
            f"{case['memory_mb']:.0f}",
        )
    terminal.output.print(table)
    for case in measured["cases"]:
        if "of_processes" in case:
            terminal.output.print(
                f"{case['value']} threads reach {case['of_processes']:.2f} "
                f"({case['of_processes_low']:.2f}-{case['of_processes_high']:.2f}) of as many processes."
            )
    _print_machine(measured["machine"])
    return 0


def reductions(
    *,
    scene: Names = None,
    reduction: Names = None,
    resolution: Integer = 48,
    batches: Integer = 4,
    threads: MaybeInteger = None,
    out: Path = Path("out"),
    quiet: Quiet = False,
    json_: Json = False,
) -> int:
    """Measure what each reduction is worth at equal error, and that it shifts no mean.

    Parameters
    ----------
    scene
        two_cubes, cornell_box, cornell_box_unshadowed, monkey; all if none.
    reduction
        aimed, lights, splitting, roulette, adaptive; all if none.
    resolution
        Pixels of a side of the square image.
    batches
        Of 8 replicates each way; the median of their ratios counts.
    threads
        Threads; one per core if not given.
    out
        The numbers go to OUT/bench/reductions.json.
    quiet
        No progress on standard error.
    json_
        Print them on standard output.
    """
    from termwise.reports.bench import reductions as of_reductions

    measured = _benchmark(
        out,
        "reductions",
        lambda report: of_reductions.measure(
            scenes=tuple(scene or ()),
            reductions=tuple(reduction or ()),
            resolution=resolution,
            batches=batches,
            threads=threads,
            report=report,
        ),
        quiet=quiet,
        json_=json_,
    )
    failed = [case for case in measured["cases"] if case["verdict"] in terminal.PROVEN]
    if json_:
        return 1 if failed else 0
    for name in dict.fromkeys(case["scene"] for case in measured["cases"]):
        columns = ("reduction", "term", "variant", "variance", "seconds", "cost", "spread", "verdict")
        table = terminal.table(*columns, title=name)
        for case in measured["cases"]:
            if case["scene"] == name:
                table.add_row(
                    case["reduction"],
                    case["term"],
                    case["variant"],
                    f"{case['variance']:.2f}",
                    f"{case['seconds']:.2f}",
                    f"{case['cost']:.2f}",
                    f"{case['cost_low']:.2f}-{case['cost_high']:.2f}",
                    case["verdict"],
                )
        terminal.output.print(table)
    terminal.output.print(
        "With the reduction over without it: variance, processor seconds, and their product, which is what equal error "
        "costs; below 1 is a gain. The verdict compares the means.",
        soft_wrap=True,
    )
    _print_machine(measured["machine"])
    return 1 if failed else 0


def bench_view(
    *,
    scene: Names = None,
    changes: Integer = 30,
    memory_changes: Integer = 1000,
    resolution: Integer = 256,
    threads: MaybeInteger = None,
    out: Path = Path("out"),
    quiet: Quiet = False,
    json_: Json = False,
) -> int:
    """Measure how long a changed input takes to be seen on the page of `termwise view`, and whether memory stays.

    Parameters
    ----------
    scene
        two_cubes, cornell_box, cornell_box_unshadowed, monkey; all if none.
    changes
        Of each input; their median counts.
    memory_changes
        Changes of all inputs in turn, over which memory is measured.
    resolution
        Pixels of a side of the square image.
    threads
        Threads; one per core if not given.
    out
        The numbers go to OUT/bench/view.json.
    quiet
        No progress on standard error.
    json_
        Print them on standard output.
    """
    from termwise.reports.bench import view as of_view

    measured = _benchmark(
        out,
        "view",
        lambda report: of_view.measure(
            scenes=tuple(scene or ()),
            changes=changes,
            memory_changes=memory_changes,
            resolution=resolution,
            threads=threads,
            report=report,
        ),
        quiet=quiet,
        json_=json_,
    )
    if json_:
        return 0
    columns = ("scene", "input", "seconds", "spread", "processor", "previews")
    table = terminal.table(*columns)
    for case in measured["cases"]:
        table.add_row(
            case["scene"],
            case["input"],
            f"{case['seconds']:.3f}",
            f"{case['seconds_low']:.3f}-{case['seconds_high']:.3f}",
            f"{case['processor']:.3f}",
            f"{case['previews']} of {case['changes']}",
        )
    terminal.output.print(table)
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
    quiet
        No progress on standard error.
    json_
        Print them on standard output.
    """
    from termwise.reports import stress as lab
    from termwise.reports.pages import stress as page

    measured = _measured(
        out / "stress",
        "stress",
        lambda report: lab.measure(groups=tuple(group or ()), case=case, count=count, report=report),
        page.write,
        quiet=quiet,
        json_=json_,
    )
    if not json_:
        _print_stress(measured)
    return 1 if measured["failed"] else 0


def _print_stress(measured: dict[str, Any]) -> None:
    shown = lambda value: "-" if value is None else f"{value:.3g}"  # noqa: E731
    for group in dict.fromkeys(case["group"] for case in measured["cases"]):
        title = f"\n[bold]{group}"
        table = Table(title=title, title_justify="left", box=None, padding=(0, 1, 0, 0), pad_edge=False)
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
            terminal.output.print(
                f"{case['group']}: {case['name']}: {why}", highlight=False, soft_wrap=True, markup=False
            )
    terminal.output.print(
        f"{len(measured['cases'])} rows in {measured['seconds']:.0f} s, {measured['failed']} failed", highlight=False
    )


def _benchmark(
    out: Path, name: str, measure: Callable[[Report], dict[str, Any]], *, quiet: bool, json_: bool
) -> dict[str, Any]:
    """Measure one benchmark of OUT/bench."""
    from termwise.reports.pages import bench as page

    return _measured(out / "bench", name, measure, page.write, quiet=quiet, json_=json_)


def _measured(
    folder: Path,
    name: str,
    measure: Callable[[Report], dict[str, Any]],
    write: Callable[[Path], Path],
    *,
    quiet: bool,
    json_: bool,
) -> dict[str, Any]:
    """Measure and show the progress; the numbers go to the folder with the command, and onto its page."""
    terminal.folder(folder)
    with progress.stages(terminal.messages, quiet=quiet or json_) as stage:
        measured = measure(stage(name.capitalize()))
    measured["command"] = terminal.command()
    text = json.dumps(measured, indent=1)
    write_atomically(folder / f"{name}.json", lambda path: path.write_text(text, "utf-8"))
    write(folder)
    if json_:
        print(json.dumps(measured))
    return measured


def _print_machine(machine: dict[str, Any]) -> None:
    text = f"{machine['processor']}, {machine['threads']} threads, load {machine['load']:.1f}"
    terminal.output.print(text)
