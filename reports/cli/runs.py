"""Studies and what is made of them: compare, diff and figure."""

import contextlib
import re
import runpy
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import attrs
from cyclopts import Parameter

from termwise.reports import progress
from termwise.reports.cli import engines as others
from termwise.reports.cli import terminal
from termwise.reports.cli.engines import Engines, Probed, Samples
from termwise.reports.cli.terminal import Approximate, Backend, Flag, Json, MaybeInteger, Names, Quiet
from termwise.scenes.strict import FileError


def _duration(_kind: Any, tokens: Any) -> float:
    """Seconds of `90`, `90s`, `2m` or `1h`."""
    found = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+)([smh]?)", tokens[0].value)
    seconds = float(found[1]) * {"": 1, "s": 1, "m": 60, "h": 3600}[found[2]] if found else 0.0
    if not 0.0 < seconds < float("inf"):
        raise ValueError(f"{tokens[0].value!r}: allowed is a time above 0 such as 90, 90s, 2m or 1h")
    return seconds


def compare(
    *scenes: str,
    study: str = "standard",
    budget: Annotated[float | None, Parameter(converter=_duration, n_tokens=1)] = None,
    seed: MaybeInteger = None,
    approximate: Approximate = False,
    estimators: Path | None = None,
    engine: Engines = None,
    spp: Samples = None,
    diffuse: Flag = False,
    row: Names = None,
    probe: Probed = True,
    workers: MaybeInteger = None,
    scheduler: str | None = None,
    out: Path = Path("out"),
    backend: Backend = None,
    quiet: Quiet = False,
    single_file: Flag = False,
    json_: Json = False,
) -> int:
    """Render scenes with ours and with Mitsuba, judge every term, write the report.

    With --engine other renderers take the place of ours: all their light is judged, and the terms that are scenes.

    Parameters
    ----------
    scenes
        Names of the library or paths of files (TOML, Mitsuba's XML, GLB, OBJ); all scenes of the study if none.
    study
        quick, standard, full, or the path of a study file.
    budget
        Seconds of rendering (90, 90s, 2m, 1h), ours and Mitsuba's together: rows that the study leaves undecided get
        2, 4, 8 times its replicates, until they are decided or the budget is spent.
    seed
        Instead of the study's: the whole run again with other random numbers.
    estimators
        A Python file that calls `termwise.register`: what it registers is measured too.
    diffuse
        With --engine: every gloss, translucency and transparency is 0, which every renderer can say.
    row
        With --engine: only these of total, ambient, direct (first hit), "direct all" (bounces).
    workers
        Processes of this machine that render, by dask.distributed; without it threads of this process do.
    scheduler
        Instead, the address of a dask scheduler, as tcp://host:8786: its workers render.
    out
        The report goes to OUT/compare, or to the folder that the study names.
    single_file
        Write report.html too: all pages in one file, to mail.
    """
    if engine:
        given = {"budget": budget, "estimators": estimators, "single_file": single_file or None}
        for name, value in given.items():
            if value is not None:
                raise ValueError(f"{name}: allowed without --engine alone")
        terminal.choose_backend(backend)
        with _executor(workers, scheduler, None) as executor:
            return others.compare(
                scenes,
                engine,
                study,
                seed,
                spp=spp,
                diffuse=diffuse,
                row=row,
                probe=probe,
                approximate=approximate,
                executor=executor,
                out=out,
                quiet=quiet,
                json_=json_,
            )
    from termwise.reports import run
    from termwise.reports.pages import report as page
    from termwise.reports.study import study as studies
    from termwise.reports.study import subjects

    mitsuba = terminal.choose_backend(backend, quiet=quiet).variant
    if estimators is not None:
        run_file(estimators)
        for term, name, why in studies.unkept():
            line = f"termwise: {term} {name}: is computed anew in each run: {why}"
            terminal.messages.print(line, highlight=False, markup=False)
    chosen = studies.with_registered(studies.load(study))
    if budget is not None:
        chosen = attrs.evolve(chosen, budget=budget)
    if seed is not None:
        chosen = attrs.evolve(chosen, seed=seed)
    prepared = subjects.scenes_of(chosen, scenes, approximate=approximate)
    for scene in prepared:
        terminal.say_substitutions(scene)
    folder = terminal.folder(out / chosen.folder)
    try:
        results = run.finished(folder, run.digest(chosen, prepared, mitsuba))
    except ValueError as error:
        terminal.messages.print(f"termwise: {error}; it is written again", highlight=False, markup=False)
        results = None
    if results is None:
        with progress.stages(terminal.messages, quiet=quiet or json_, where=folder) as stage:
            named = {scene.name: given for scene, given in zip(prepared, scenes or chosen.scenes, strict=True)}
            with _executor(workers, scheduler, estimators) as executor:
                results = run.measure(
                    chosen,
                    prepared,
                    folder,
                    name=Path(study).stem,
                    report=stage("Measuring"),
                    arguments={"study": study, "scenes": named, "approximate": approximate},
                    executor=executor,
                )
            page.write(folder, report=stage("Pages"))
    elif not quiet:
        terminal.messages.print("Nothing has changed since the last run: no cell was computed.")
    index = folder / "index.html"
    if single_file:
        from termwise.reports.pages import single

        index = single.write(folder)
    if json_:
        terminal.say_json(results)
    else:
        _print_results(results)
        terminal.output.print(f"\nReport: {index.resolve()}", soft_wrap=True)
    for each in results["failed"]:
        terminal.fail(f"{each['scene']}: failed, and stands in no row: {each['error']}")
    if results["failed"]:
        return 2
    return 1 if run.failures(results) else 0


@contextlib.contextmanager
def _executor(workers: int | None, scheduler: str | None, estimators: Path | None) -> Iterator[Any]:
    """A cluster where one is asked for, which alone loads dask; else None: this process."""
    if workers is None and scheduler is None:
        yield None
        return
    from termwise.reports.jobs.cluster import connected

    def say(line: str) -> None:
        terminal.messages.print(f"termwise: {line}", highlight=False, markup=False)

    with connected(say, workers=workers, scheduler=scheduler, estimators=estimators) as executor:
        yield executor


def run_file(path: Path) -> None:
    """Execute a Python file of the user's."""
    if not path.is_file():
        raise FileError(f"{path}: no such file: allowed is a Python file that calls termwise.register")
    runpy.run_path(str(path), run_name=path.stem)


def _print_results(results: dict[str, Any]) -> None:
    """A table for each scene, what wrong formulas are off by, what was certified, and a line for each open question."""
    from termwise.reports.results import findings

    judged = [row for row in results["cells"] if row["verdict"] is not None]
    certified, right = results["settings"]["certified"], findings.from_right(results["cells"])
    for scene in results["settings"]["scenes"]:
        columns = ("term", "variant", "bias [90 %] in %", "RMSE", "SSIM", "s", "verdict")
        if certified["budget"] is not None:
            columns = ("term", "variant", "bias [90 %] in %", "K", "ours s", "ref. s", "verdict")
        table = terminal.table(*columns, title=scene)
        rows = [row for row in judged if row["scene"] == scene]
        for row in rows:
            table.add_row(*_cells(row, budgeted=certified["budget"] is not None))
        terminal.output.print(table)
        for row in rows:
            if (off := right.get(findings.key(row))) and row["against"] == "own":
                bias = float(f"{100 * off['bias']:.3g}")
                where = f"{row['term']} {row['variant']}: {row['verdict']}"
                terminal.say(f"{where}, {bias:+g} % from the right integral", markup=False)
    known = [row for row in judged if row.get("group")]
    for group in dict.fromkeys(row["group"] for row in known):
        words = [row["verdict"] for row in known if row["group"] == group]
        counts = ", ".join(f"{words.count(word)} {word}" for word in dict.fromkeys(words))
        terminal.output.print(f"\n[bold]{group}[/bold], its answer known: {counts}", highlight=False)
    margins = findings.certified(judged)
    _print_certified(certified, margins, allotted=bool(results["settings"].get("allotted")))
    for row in judged:
        if row["verdict"] in terminal.PROVEN or (row["verdict"] == "UNDERPOWERED" and not row.get("group")):
            where = f"{row['scene']}: {row['term']} {row['variant']}"
            terminal.say(f"{where}: {row['verdict']}: {row['headline']}", markup=False)


def _cells(row: dict[str, Any], *, budgeted: bool) -> tuple[str, ...]:
    """A judged row as the table of its scene has it; behind a verdict that certifies, within what."""
    from termwise.reports.results.findings import CERTIFIED

    absent = row["verdict"] == "ABSENT"
    low, high = 100 * row["bias_low"], 100 * row["bias_high"]
    if budgeted:
        numbers = str(row["replicates"]), f"{row['seconds']:.1f}", f"{row['reference_seconds']:.1f}"
    else:
        numbers = (
            "" if absent else f"{row['rmse']:.3g}",
            "" if absent or row["ssim"] is None else f"{row['ssim']:.3f}",
            f"{row['seconds']:.1f}",
        )
    bias = "" if absent else f"{100 * row['bias']:+.2f} \\[{low:+.2f}, {high:+.2f}]"
    colour = terminal.COLOURS.get(row["verdict"], "dim" if absent else "yellow")
    within = f" ±{_share(row['margin'] + row['allowance'])}" if row["verdict"] in CERTIFIED else ""
    return row["term"], row["variant"], bias, *numbers, f"[{colour}]{row['verdict']}[/{colour}]{within}"


def _share(value: float) -> str:
    """In percent, without zeros that say nothing."""
    return f"{round(100 * value, 2):g} %"


def _print_certified(certified: dict[str, Any], margins: dict[float, int], *, allotted: bool) -> None:
    """What it took to show that the rows that passed are right, and within what."""
    ours, reference = certified["seconds"], certified["reference_seconds"]
    shown = [f"|bias| < {_share(margin)} in {count}" for margin, count in margins.items()]
    within = f": {', '.join(shown)}" if shown else ""
    text = (
        f"[bold]{ours + reference:.1f} s to certify {certified['rows']} of {certified['of']} rows[/bold]{within}; ours "
        f"{ours:.1f} s, reference {reference:.1f} s; our kernels compiled in {certified['compile_seconds']:.1f} s, "
        "apart."
    )
    if certified["budget"] is not None:
        looks = ", ".join(map(str, certified["looks"]))
        text += f" Budget {certified['budget']:g} s: {certified['spent']:.1f} s spent, looks at K = {looks}"
        text += ", times what was allotted to each side." if allotted else "."
    terminal.say(f"\n{text}")


def diff(run_a: Path, run_b: Path, *, out: Path = Path("out"), json_: Json = False) -> int:
    """Say what changed from one run to another in verdict, bias, error and time, with a test before "worse" is said.

    Parameters
    ----------
    run_a
        The folder of a finished run: what was before.
    run_b
        Another: what is now.
    out
        The page goes to OUT/diff.
    """
    from termwise.reports.pages import diff as page
    from termwise.reports.results import schema as stored
    from termwise.reports.results.diff import diff as compared

    found = compared(stored.read(run_a), stored.read(run_b)) | {
        "runs": [str(run_a), str(run_b)],
        "command": terminal.command(),
    }
    folder = terminal.folder(out / "diff")
    index = page.write(found, folder)
    if json_:
        terminal.say_json(found)
    else:
        _print_diff(found)
        terminal.output.print(f"\nReport: {index.resolve()}", soft_wrap=True)
    return 1 if found["any_worse"] else 0


_FINDINGS = {"worse": "red", "better": "green", "changed": "yellow"}


def _print_diff(found: dict[str, Any]) -> None:
    """Differences of settings, then what is proven, then every row."""
    say = terminal.say
    for each in found["settings"]:
        say(f"{each['name']}: {_plain(each['before'])} -> {_plain(each['after'])}", markup=False)
    if not found["settings"]:
        say("Settings: the same.")
    for each in found["failed"]:
        was = "failed before too" if each["before"] and each["after"] else "failed"
        say(f"{each['scene']}: {was if each['after'] else 'failed before'}: {each['after'] or each['before']}")
    for scene in dict.fromkeys(row["scene"] for row in found["rows"]):
        table = terminal.table("term", "variant", "bias", "RMSE", "time", "verdict", title=scene)
        for row in found["rows"]:
            if row["scene"] == scene:
                changes = [_change(name, row[name]) for name in ("bias", "error", "time")]
                table.add_row(row["term"], row["variant"], *changes, _verdicts(row["verdict"]))
        terminal.output.print(table)
    for which, keys in (("first", found["only_before"]), ("second", found["only_after"])):
        if keys:
            say(f"\nOnly in the {which} run: {', '.join(' '.join(key) for key in keys)}", markup=False)
    say(
        "\nBias: difference in percentage points; RMSE and time: in percent; 90 % intervals. Coloured where proven by "
        f"{found['tests']} tests at {found['level']:.0%} together (Holm), beyond "
        f"{found['tolerated']['bias']:.1%}, {found['tolerated']['error']:.0%} and {found['tolerated']['time']:.0%}."
    )
    for sentence in found["untested"]:
        say(f"Not tested: {sentence}.")
    if found["time_median"] is not None:
        say(f"Seconds, median over all rows: {found['time_median']:.2f} times as many.")
    say(f"[bold]Worse: {found['worse']} of {len(found['rows'])} rows; better: {found['better']}.[/bold]")


def _change(measure: str, change: dict[str, Any] | None) -> str:
    """A change and half its interval, named and coloured where it is proven."""
    from termwise.reports.results.diff import said

    if change is None:
        return ""
    half = max(change["high"] - change["change"], change["change"] - change["low"])
    text = f"{100 * change['change']:+.2f} ± {100 * half:.2f}"
    finding = change["finding"]
    return f"[{_FINDINGS[finding]}]{text} {said(measure, finding)}[/]" if finding else text


def _verdicts(verdict: dict[str, Any]) -> str:
    before, after = (verdict[name] or "NOT JUDGED" for name in ("before", "after"))
    finding = verdict["finding"]
    return f"{before} -> [{_FINDINGS[finding]}]{after}[/]" if finding else after


def _plain(value: Any) -> str:
    """A setting in a word or two; a digest by its first digits."""
    text = "none" if value is None else ", ".join(map(str, value)) if isinstance(value, list) else str(value)
    return text[:12] if len(text) == 64 and " " not in text else text


def figure(
    run: Path, *, scene: str, term: str, kind: Literal["convergence", "waterfall"] = "convergence", out: Path
) -> int:
    """Draw a chart of a finished run for print: vectors, 85 mm wide, legible in grey.

    Parameters
    ----------
    run
        The folder of a finished run.
    scene, term
        Of the chart.
    kind
        convergence: error against samples and seconds; waterfall: the parts of the error against full light
        transport.
    out
        The file to write, .pdf or .svg.
    """
    from termwise.reports.pages import figure as figures
    from termwise.reports.results import schema as stored

    figures.write(stored.read(run), scene=scene, term=term, kind=kind, path=out)
    terminal.say(str(out))
    return 0
