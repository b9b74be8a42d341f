"""`python -m tests.audit.power`: what the verdict sees, simulated: the tables of `docs/power.md`.

Errors of several kinds, sizes and areas are planted into a smooth picture of SIDE² pixels, K = R = 16, with so much
noise that the standard error of the image's mean is 0.1 %, and each is judged as a row of a run of some 60. One that is
found is taken to be found at any larger size, with the same noise: a few verdicts decide a column of the map.
"""

import multiprocessing
import os
import re
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Annotated

import cyclopts
import numpy as np
from cyclopts import Parameter
from rich.console import Console

from termwise.reports import progress
from termwise.reports.statistics.accumulation import measure
from termwise.reports.statistics.rule import decide
from termwise.scenes.store import ROOT, write_atomically
from tests.verdict.synthetic import RUN, picture

SIDE, REPLICATES, STANDARD_ERROR = 128, 16, 0.001
NOISE = STANDARD_ERROR * SIDE * np.sqrt(REPLICATES / 2)
"""Relative standard deviation of a pixel of one replicate."""
RUNS = 12
SIZES = (0.005, 0.01, 0.02, 0.05, 0.1, 0.25, 0.5, 1.0)
AREAS = (1, 4, 16, 64, 256, 1024, SIDE**2)
"""In pixels."""
PAGE = ROOT / "docs" / "power.md"
_WEIGHTS = np.array([0.2126, 0.7152, 0.0722])

Error = Callable[[np.random.Generator, np.ndarray, int, float], np.ndarray]
"""Generator for the place, limit (H, W, 3), area, size -> what is rendered in the place of the limit."""


def _square(rng: np.random.Generator, area: int) -> tuple[slice, slice]:
    """A place of so many pixels, about as high as wide."""
    rows = int(np.sqrt(area))
    columns = -(-area // rows)
    top, left = (int(rng.integers(SIDE - size + 1)) for size in (rows, columns))
    return slice(top, top + rows), slice(left, left + columns)


def _mean(rng: np.random.Generator, limit: np.ndarray, area: int, size: float) -> np.ndarray:
    chosen = rng.permutation(SIDE**2).reshape(SIDE, SIDE) < area
    return limit * (1.0 + size * chosen)[..., None]


def _blotch(rng: np.random.Generator, limit: np.ndarray, area: int, size: float) -> np.ndarray:
    wrong = limit.copy()
    wrong[_square(rng, area)] *= 1.0 + size
    return wrong


def _checkerboard(rng: np.random.Generator, limit: np.ndarray, area: int, size: float) -> np.ndarray:
    wrong, place = limit.copy(), _square(rng, area)
    wrong[place] *= 1.0 + size * (-1.0) ** np.indices(wrong[place].shape[:2]).sum(axis=0)[..., None]
    return wrong


def _border(rng: np.random.Generator, limit: np.ndarray, area: int, size: float) -> np.ndarray:
    last = np.arange(SIDE**2 - 1, -1, -1).reshape(SIDE, SIDE) < area
    return limit * (1.0 - size * last)[..., None]


def _colour(rng: np.random.Generator, limit: np.ndarray, area: int, size: float) -> np.ndarray:
    wrong, place = limit.copy(), _square(rng, area)
    red = wrong[place][..., 0]
    left = np.arange(red.shape[1]) < red.shape[1] // 2
    more = red * np.where(left, size, -size * red[:, left].sum() / red[:, ~left].sum())
    wrong[place] += more[..., None] * np.array([1.0, -_WEIGHTS[0] / _WEIGHTS[1], 0.0])
    return wrong


KINDS: dict[str, Error] = {
    "mean": _mean,
    "blotch": _blotch,
    "checkerboard": _checkerboard,
    "border": _border,
    "colour": _colour,
}
_SMALLEST = {"checkerboard": 4, "colour": 4}  # below, there is nothing to cancel
NAMED: dict[str, tuple[str, int, float]] = {
    "gain of 0.5 %": ("mean", SIDE**2, 0.005),
    "gain of 1 %": ("mean", SIDE**2, 0.01),
    "8 × 8 px 3 % brighter": ("blotch", 64, 0.03),
    "30 px 30 % brighter": ("blotch", 30, 0.3),
    "16 × 16 px 10 % brighter": ("blotch", 256, 0.1),
    "single pixels ± 50 %": ("checkerboard", SIDE**2, 0.5),
    "last row 10 % darker": ("border", SIDE, 0.1),
    "last row 25 % darker": ("border", SIDE, 0.25),
    "red ± 30 % left and right, luminance kept": ("colour", SIDE**2, 0.3),
}
"""Errors by kind, area and size."""


class Run:
    """One pair of noises, and the verdicts on errors under it."""

    def __init__(self, seed: tuple[int, ...]) -> None:
        self._seed = seed
        rng = np.random.default_rng(seed)
        self._limit = picture(SIDE, SIDE)
        shape = (REPLICATES, SIDE, SIDE, 1)
        self._noise, reference = (rng.gamma(1 / NOISE**2, NOISE**2, shape).astype(np.float32) for _ in range(2))
        self._reference = (self._limit * reference).astype(np.float32)

    def finds(self, kind: str, area: int, size: float) -> bool:
        """Whether the verdict is BIASED; at equal area errors of a kind have one place."""
        rng = np.random.default_rng((*self._seed, area))
        wrong = KINDS[kind](rng, self._limit, area, size)
        ours = (wrong * self._noise).astype(np.float32)
        return decide(measure(ours, self._reference), tests=RUN).verdict == "BIASED"

    def smallest(self, kind: str, area: int) -> int:
        """Index of the smallest of SIZES that is found; their number where none is."""
        low, high = 0, len(SIZES)
        while low < high:
            middle = (low + high) // 2
            if self.finds(kind, area, SIZES[middle]):
                high = middle
            else:
                low = middle + 1
        return low


def _one(seed: tuple[int, ...]) -> tuple[dict[str, list[int]], dict[str, bool]]:
    run = Run(seed)
    smallest = {kind: [run.smallest(kind, area) for area in areas_of(kind)] for kind in KINDS}
    return smallest, {name: run.finds(*error) for name, error in NAMED.items()}


def areas_of(kind: str) -> tuple[int, ...]:
    """Those that a kind of error can have."""
    return tuple(area for area in AREAS if area >= _SMALLEST.get(kind, 1))


def simulate(
    runs: int, *, seed: int, jobs: int, report: Callable[[str, int, int], object] = progress.silent
) -> tuple[dict[str, np.ndarray], dict[str, int]]:
    """The map.

    Returns
    -------
    shares : by kind (sizes, areas), the share of runs that find the error.
    named : in how many runs each of NAMED is found.
    """
    outcomes = []
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        for outcome in pool.map(_one, [(seed, number) for number in range(runs)]):
            outcomes.append(outcome)
            report("runs", len(outcomes), runs)
    index = np.arange(len(SIZES))[:, None]
    shares = {kind: np.mean([index >= np.array(smallest[kind]) for smallest, _ in outcomes], axis=0) for kind in KINDS}
    return shares, {name: sum(found[name] for _, found in outcomes) for name in NAMED}


def table(kind: str, shares: np.ndarray) -> str:
    """Markdown: a row for each size, a column for each area, the share found in percent; blank where none is."""
    areas = areas_of(kind)
    head = " | ".join([f"{kind} of", *(f"{area} px" if area < SIDE**2 else "all" for area in areas)])
    rows = [
        " | ".join([f"{100 * size:g} %", *(f"{100 * share:.0f}" if share else " " for share in row)])
        for size, row in zip(SIZES, shares, strict=True)
    ]
    lines = [f"| {row} |" for row in (head, *rows)]
    return "\n".join([lines[0], f"|{'---:|' * (1 + len(areas))}", *lines[1:]])


def written(page: str, shares: dict[str, np.ndarray], named: dict[str, int], runs: int) -> str:
    """The page with its tables anew: each stands between comments that name it."""
    tables = {kind: table(kind, each) for kind, each in shares.items()}
    rows = [f"| {name} | {found} of {runs} |" for name, found in named.items()]
    tables["named"] = "\n".join(["| planted | found in |", "|---|---:|", *rows])
    for name, text in tables.items():
        pattern = rf"(<!-- {name} -->\n).*?(\n<!-- end of {name} -->)"
        page, count = re.subn(
            pattern, lambda match, text=text: f"{match[1]}\n{text}\n{match[2]}", page, flags=re.DOTALL
        )
        if count != 1:
            raise ValueError(f"{PAGE}: {count} places for {name!r}: allowed is exactly one")
    return page


app = cyclopts.App(name="power", help="Simulate what the verdict sees.", version_flags=[])


@app.default
def main(
    *,
    out: Path = PAGE,
    runs: int = RUNS,
    seed: int = 1,
    jobs: int = os.cpu_count() or 1,
    quiet: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Simulate what the verdict sees, and write the tables into the manual.

    Parameters
    ----------
    out
        The page whose tables are replaced.
    runs
        Pairs of noises, under each of which all errors are judged.
    seed
        Of everything random.
    jobs
        Processes at once.
    quiet
        No progress on standard error.
    """
    page = out.read_text("utf-8")
    with progress.stages(Console(stderr=True), quiet=quiet) as stages:
        shares, named = simulate(runs, seed=seed, jobs=jobs, report=stages("power map"))
    text = written(page, shares, named, runs)
    write_atomically(out, lambda path: path.write_text(text, "utf-8"))
    for name, found in named.items():
        print(f"{name}: found in {found} of {runs}")
    print(out)


if __name__ == "__main__":
    sys.exit(app())
