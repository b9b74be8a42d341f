"""`python -m tests.audit`: false alarms and misses of the verdict counted, as `results.json` and a page.

Exit status 0: the gates hold; 1: too many false alarms, a test that is blind, a control that is BIASED, or fewer than
95 % of the planted faults caught.
"""

import json
import os
import sys
import time
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
from termwise.reports.run import plain
from termwise.reports.statistics.verdict import LEVEL, POWER
from termwise.scenes.store import write_atomically
from tests.audit import faults, nulls
from tests.audit.nulls import Alarms
from tests.audit.plants import PLANTS
from tests.verdict.synthetic import share_found

SYNTHETIC, RENDERED_EACH, DETECTIONS = 10_000, 32, 200
BLIND = 0.001
"""Chance that a sound test is called too quick or too slow to alarm."""
CAUGHT_LEAST = 0.95
POWER_WITHIN = 0.06


def audit(
    *,
    synthetic: int = SYNTHETIC,
    rendered_each: int = RENDERED_EACH,
    detections: int = DETECTIONS,
    rows: tuple[nulls.Rendered, ...] = nulls.ROWS,
    plants: tuple[faults.Plant, ...] = PLANTS,
    seed: int = 1,
    jobs: int = 1,
    stages: progress.Stages = lambda name: progress.silent,
) -> dict[str, Any]:
    """Run the audit.

    Parameters
    ----------
    synthetic, rendered_each, detections : synthetic nulls, comparisons of each rendered row with itself, and runs that
        are given the bias that they print.
    rows, plants : what is rendered.
    seed : of everything random.
    jobs : processes at once.
    stages : shows the progress.

    Returns
    -------
    dict
        What `results.json` holds; `failures` says in words why it does not pass.
    """
    began = time.monotonic()
    of_pixels = nulls.synthetic(synthetic, seed=seed, jobs=jobs, report=stages("synthetic nulls"))
    of_rows = nulls.rendered(rendered_each, seed=seed, rows=rows, report=stages("rendered nulls"))
    rendered = sum(of_rows.values(), Alarms(0, 0, 0))
    detected = share_found(np.random.default_rng(seed), detections)
    controls, found = faults.run(plants, seed=seed, jobs=jobs, report=stages("planted faults"))
    caught = sum(outcome.caught for outcome in found.values())
    welch = stats.binomtest(of_pixels.welch, of_pixels.runs, LEVEL)
    interval = welch.proportion_ci(1 - BLIND)
    failures = [
        f"{name}: {alarms.alarms} false alarms in {alarms.runs} runs: allowed is {LEVEL:.0%} of them"
        for name, alarms in (("synthetic nulls", of_pixels), ("rendered nulls", rendered))
        if alarms.alarms > LEVEL * alarms.runs
    ]
    if welch.pvalue < BLIND:
        failures.append(f"Welch alone: p < {LEVEL} in {of_pixels.welch} of {of_pixels.runs} nulls")
    if abs(detected - POWER) > POWER_WITHIN:
        failures.append(f"the printed detectable bias is found in {detected:.1%} of runs, not in {POWER:.0%}")
    failures += [
        f"control {case.scene}, {case.term} {case.variant}: {outcome.text}"
        for case, outcome in controls.items()
        if outcome.caught
    ]
    if caught < CAUGHT_LEAST * len(found):
        missed = [name for name, outcome in found.items() if not outcome.caught]
        failures.append(f"{caught} of {len(found)} faults caught; missed: {', '.join(missed)}")
    return plain(
        {
            "level": LEVEL,
            "null_runs": rendered.runs,
            "null_false_alarms": rendered.alarms,
            "synthetic_null_runs": of_pixels.runs,
            "synthetic_false_alarms": of_pixels.alarms,
            "welch_alarms": of_pixels.welch,
            "welch_low": interval.low,
            "welch_high": interval.high,
            "detectable_runs": detections,
            "detectable_found": detected,
            "planted": len(found),
            "caught": caught,
            "matrix": [
                {"fault": plant.name, **_case(plant.case), "path": plant.path, **_outcome(found[plant.name])}
                for plant in plants
            ],
            "controls": [{**_case(case), **_outcome(outcome)} for case, outcome in controls.items()],
            "nulls": [
                {**attrs.asdict(row), "runs": alarms.runs, "false_alarms": alarms.alarms}
                for row, alarms in of_rows.items()
            ],
            "failures": failures,
            "seed": seed,
            "seconds": time.monotonic() - began,
            "versions": versions(),
        }
    )


def _case(case: faults.Case) -> dict[str, Any]:
    return {"scene": case.scene, "term": case.term, "variant": case.variant, "side": case.side, "samples": case.samples}


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
        table.add_row(row["fault"], f"{row['term']} {row['variant']}", *marks, row["verdict"], *numbers)
    console.print(table)
    lines = (
        f"caught {results['caught']} of {results['planted']} planted faults",
        f"{results['null_false_alarms']} false alarms in {results['null_runs']} rendered nulls, "
        f"{results['synthetic_false_alarms']} in {results['synthetic_null_runs']} synthetic ones "
        f"(level {results['level']:.0%})",
        f"Welch alone: {results['welch_alarms'] / results['synthetic_null_runs']:.2%} "
        f"[{results['welch_low']:.2%}, {results['welch_high']:.2%}] of them (99.9 %)",
        f"detectable bias found in {results['detectable_found']:.1%} of {results['detectable_runs']} runs",
        *(f"FAILED: {text}" for text in results["failures"]),
    )
    for line in lines:
        console.print(line, highlight=False, markup=False, soft_wrap=True)


app = cyclopts.App(name="audit", help="Count the verdict's false alarms and misses.", version_flags=[])


@app.default
def main(
    *,
    out: Path = Path("out"),
    seed: int = 1,
    jobs: int = os.cpu_count() or 1,
    quiet: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Count the verdict's false alarms and misses, and write OUT/audit.

    Parameters
    ----------
    out
        Gets audit/results.json and audit/index.html.
    seed
        Of everything random.
    jobs
        Processes at once.
    quiet
        No progress on standard error.
    """
    with progress.stages(Console(stderr=True), quiet=quiet) as stages:
        results = audit(seed=seed, jobs=jobs, stages=stages)
    console = Console(width=None if sys.stdout.isatty() else 140)
    show(console, results)
    console.print(f"{write(out / 'audit', results)}", soft_wrap=True)
    return 1 if results["failures"] else 0


if __name__ == "__main__":
    sys.exit(app())
