"""`python -m tests.audit`: false alarms and misses of the verdict counted, as `results.json` and a page.

Exit status 0: the gates hold; 1: too many false alarms, a test that is blind, a control that is BIASED, fewer than 95 %
of the planted faults caught, or anything worse than in the run that was recorded last (`tests.audit.history`).
"""

import contextlib
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from pathlib import Path
from typing import Annotated, Any

import attrs
import cyclopts
import jinja2
import numpy as np
from cyclopts import Parameter
from rich.console import Console
from rich.table import Table
from scipy import stats

from termwise.reports import progress
from termwise.reports.machine import versions
from termwise.reports.pages.environment import copy_static, page_environment, render_page
from termwise.reports.results.schema import plain
from termwise.reports.statistics.verdict import LEVEL, POWER
from termwise.scenes.store import write_atomically
from tests.audit import faults, history, nulls
from tests.audit.nulls import Alarms
from tests.audit.plants import Plant
from tests.audit.unseen import ALL
from tests.verdict.synthetic import share_found

ORDINARY, AWKWARD, RENDERED_EACH, DETECTIONS = 3000, 10_000, 32, 200
BLIND = 0.001
"""Chance that a sound test is called too quick or too slow to alarm."""
CAUGHT_LEAST = 0.95
POWER_WITHIN = 0.06


def audit(
    *,
    ordinary: int = ORDINARY,
    awkward: int = AWKWARD,
    rendered_each: int = RENDERED_EACH,
    detections: int = DETECTIONS,
    rows: tuple[nulls.Rendered, ...] = nulls.ROWS,
    plants: tuple[Plant, ...] = ALL,
    seed: int = 1,
    ahead: tuple[int, ...] = (),
    executor: Executor,
    recorded: list[dict[str, Any]] | None = None,
    stages: progress.Stages = lambda name: progress.silent,
) -> dict[str, Any]:
    """Run the audit.

    Parameters
    ----------
    ordinary, awkward, rendered_each, detections : synthetic nulls of both kinds, comparisons of each rendered row with
        itself, and runs that are given the bias that they print.
    rows, plants : what is rendered.
    seed : of everything random.
    ahead : seeds of later runs, for which the images of cases and faults are rendered as well, and kept.
    executor : its processes draw and render, each in a copy of the sources.
    recorded : runs of the history; by default those that are kept.
    stages : shows the progress.

    Returns
    -------
    dict
        What `results.json` holds; `failures` says in words why it does not pass.
    """
    began = time.monotonic()
    of_laws = nulls.synthetic(nulls.ordinary(ordinary), seed=seed, executor=executor, report=stages("ordinary nulls"))
    of_all = nulls.synthetic(nulls.awkward(awkward), seed=seed + 1, executor=executor, report=stages("awkward nulls"))
    of_rows = nulls.rendered(rendered_each, seed=seed, rows=rows, report=stages("rendered nulls"))
    usual, synthetic, rendered = (sum(each.values(), Alarms()) for each in (of_laws, of_all, of_rows))
    detected = share_found(np.random.default_rng(seed), detections)
    controls, found = faults.run(plants, seed=seed, ahead=ahead, executor=executor, report=stages("planted faults"))
    caught = sum(outcome.caught for outcome in found.values())
    welch = stats.binomtest(usual.welch, usual.runs, LEVEL)
    interval = welch.proportion_ci(1 - BLIND)
    by_law = nulls.grouped(of_all, lambda null: null.law)
    groups = {
        **by_law,
        **nulls.grouped(of_all, lambda null: f"K = {null.replicates}, R = {null.reference_replicates}"),
        **nulls.grouped(of_all, lambda null: f"noise of {null.noisy}"),
    }
    failures = [
        f"{name}: {alarms.alarms} false alarms in {alarms.runs} runs: allowed is {LEVEL:.0%} of them"
        for name, alarms in (("ordinary nulls", usual), ("awkward nulls", synthetic), ("rendered nulls", rendered))
        if alarms.alarms > LEVEL * alarms.runs
    ]
    failures += [
        f"nulls, {name}: {alarms.alarms} false alarms in {alarms.runs} runs: allowed is {LEVEL:.0%}, and chance"
        for name, alarms in groups.items()
        if name not in nulls.UNMET and alarms.alarms > stats.binom.isf(BLIND / len(groups), alarms.runs, LEVEL)
    ]
    if welch.pvalue < BLIND:
        failures.append(f"Welch alone: p < {LEVEL} in {usual.welch} of {usual.runs} ordinary nulls")
    if abs(detected - POWER) > POWER_WITHIN:
        failures.append(f"the printed detectable bias is found in {detected:.1%} of runs, not in {POWER:.0%}")
    failures += [f"control {shown}: {outcome.text}" for shown, outcome in controls.items() if outcome.caught]
    failures += [f"fault {name}: {each.text}" for name, each in found.items() if each.verdict == faults.CRASHED]
    if caught < CAUGHT_LEAST * len(found):
        missed = [name for name, outcome in found.items() if not outcome.caught]
        failures.append(f"{caught} of {len(found)} faults caught; missed: {', '.join(missed)}")
    results = plain(
        {
            "level": LEVEL,
            "null_runs": rendered.runs,
            "null_false_alarms": rendered.alarms,
            "ordinary_null_runs": usual.runs,
            "ordinary_false_alarms": usual.alarms,
            "awkward_null_runs": synthetic.runs,
            "awkward_false_alarms": synthetic.alarms,
            "welch_alarms": usual.welch,
            "welch_low": interval.low,
            "welch_high": interval.high,
            "detectable_runs": detections,
            "detectable_found": detected,
            "planted": len(found),
            "caught": caught,
            "matrix": [
                {"fault": plant.name, "shown": str(plant.shown), "path": plant.path, **_outcome(found[plant.name])}
                for plant in plants
            ],
            "controls": [{"shown": str(shown), **_outcome(outcome)} for shown, outcome in controls.items()],
            "nulls": [
                {**attrs.asdict(row), "runs": alarms.runs, "false_alarms": alarms.alarms}
                for row, alarms in of_rows.items()
            ],
            "laws": {law: {"runs": alarms.runs, "alarms": alarms.alarms} for law, alarms in by_law.items()},
            "null_groups": [
                {"group": name, "runs": alarms.runs, "false_alarms": alarms.alarms} for name, alarms in groups.items()
            ],
            "failures": failures,
            "seed": seed,
            "seconds": time.monotonic() - began,
            "versions": versions(),
        }
    )
    recorded = history.read() if recorded is None else recorded
    if recorded:
        results["failures"] += history.fallen(history.entry(results), recorded[-1])
    return results


def _outcome(outcome: faults.Judged) -> dict[str, Any]:
    """A row of the matrix: which tests speak against it, and the verdict in words."""
    tests = {test: test in outcome.by for test in faults.TESTS}
    fields = "verdict", "caught", "bias", "standard_error", "text"
    return tests | {name: getattr(outcome, name) for name in fields}


def write(folder: Path, results: dict[str, Any]) -> Path:
    """Write `results.json` and the page beside it; returns the page."""
    text = json.dumps(results, indent=1, allow_nan=False)
    write_atomically(folder / "results.json", lambda path: path.write_text(text, "utf-8"))
    environment = page_environment()
    here = jinja2.FileSystemLoader(Path(__file__).parent)
    assert environment.loader is not None
    environment.loader = jinja2.ChoiceLoader([here, environment.loader])
    index = folder / "index.html"
    render_page(environment, "page.html.j2", index, root="", results=results, tests=faults.TESTS)
    copy_static(folder, charts=False)
    return index


def show(console: Console, results: dict[str, Any]) -> None:
    """Print the matrix and the counts."""
    table = Table("fault", "shown by", *faults.TESTS, "verdict", "bias", "s.e.", title="Planted faults")
    for row in results["matrix"]:
        marks = ("x" if row[test] else "" for test in faults.TESTS)
        numbers = ("" if row[name] is None else f"{row[name]:.2%}" for name in ("bias", "standard_error"))
        table.add_row(row["fault"], row["shown"], *marks, row["verdict"], *numbers)
    console.print(table)
    lines = (
        f"caught {results['caught']} of {results['planted']} planted faults",
        f"{results['null_false_alarms']} false alarms in {results['null_runs']} rendered nulls, "
        f"{results['ordinary_false_alarms']} in {results['ordinary_null_runs']} synthetic ones with ordinary noise, "
        f"{results['awkward_false_alarms']} in {results['awkward_null_runs']} with awkward noise "
        f"(level {results['level']:.0%})",
        f"Welch alone: {results['welch_alarms'] / results['ordinary_null_runs']:.2%} "
        f"[{results['welch_low']:.2%}, {results['welch_high']:.2%}] of the ordinary ones (99.9 %)",
        f"detectable bias found in {results['detectable_found']:.1%} of {results['detectable_runs']} runs",
        *(f"FAILED: {text}" for text in results["failures"]),
    )
    for line in lines:
        console.print(line, highlight=False, markup=False, soft_wrap=True)


@contextlib.contextmanager
def _executor(jobs: int, workers: int | None, scheduler: str | None) -> Iterator[Executor]:
    """Processes of this machine, or of a cluster."""
    if workers is None and scheduler is None:
        # Not forked: this process may have threads.
        with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
            yield pool
    else:
        from termwise.reports.jobs.cluster import connected

        def say(line: str) -> None:
            print(line, file=sys.stderr)

        with connected(say, workers=workers, scheduler=scheduler) as cluster:
            yield cluster.executor()


app = cyclopts.App(name="audit", help="Count the verdict's false alarms and misses.", version_flags=[])


@app.default
def main(
    *,
    out: Path = Path("out"),
    seed: int = 1,
    ahead: Annotated[tuple[int, ...], Parameter(negative="")] = (),
    jobs: int = os.cpu_count() or 1,
    workers: int | None = None,
    scheduler: str | None = None,
    record: Annotated[bool, Parameter(negative="")] = False,
    quiet: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Count the verdict's false alarms and misses, and write OUT/audit.

    Parameters
    ----------
    out
        Gets audit/results.json and audit/index.html.
    seed
        Of everything random.
    ahead
        Seeds of later runs, whose images are rendered too, and kept: kernels of a fault are compiled but once.
    jobs
        Processes at once.
    workers
        Instead, so many processes as workers of dask.distributed on this machine.
    scheduler
        Instead, the address of a dask scheduler, as tcp://host:8786, whose workers have this checkout.
    record
        Add the run to the history, by which later ones are measured.
    quiet
        No progress on standard error.
    """
    with (
        _executor(jobs, workers, scheduler) as executor,
        progress.stages(Console(stderr=True), quiet=quiet, where=out / "audit") as stages,
    ):
        results = audit(seed=seed, ahead=ahead, executor=executor, stages=stages)
    console = Console(width=None if sys.stdout.isatty() else 140)
    show(console, results)
    if record:
        history.record(results)
    console.print(f"{write(out / 'audit', results)}", soft_wrap=True)
    return 1 if results["failures"] else 0


if __name__ == "__main__":
    sys.exit(app())
