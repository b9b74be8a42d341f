"""Several comparisons under one level: a folder a case, or each set of replicates against each.

All cases are measured before any is decided: the level of a test is that of the family over all their tests. The images
of a case are let go once they are on the disk.
"""

import itertools
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

import attrs

from termwise.reports.judging.judge import Images, Judgement, Measured, measure
from termwise.reports.statistics.verdict import LEVEL, MARGIN

RENDERED_BY = "engine", "version", "samples a pixel", "command"
"""Settings of a case that stand in the index too, where an engine rendered it."""


@attrs.frozen(eq=False)
class Case:
    """What is compared, by which name: it is that of its folder.

    Attributes
    ----------
    name : str
    images, reference : see `termwise.judge`.
    options : of `measure`, for this case: `objects`, `mask`.
    settings : of who rendered them, to stand on its page.
    """

    name: str
    images: Images
    reference: Images
    options: dict[str, Any] = attrs.field(factory=dict)
    settings: dict[str, Any] = attrs.field(factory=dict)


@attrs.frozen
class Unjudged:
    """A case without images, and why: ABSENT, where there is nothing to render, or FAILED."""

    name: str
    word: Literal["ABSENT", "FAILED"]
    reason: str


@attrs.frozen(eq=False)
class Outcome:
    """A case that was judged, and its page."""

    name: str
    judgement: Judgement
    page: Path


def of_folders(suite: Path, reference: Path, *, objects: Path | None = None, mask: Path | None = None) -> list[Case]:
    """A case for each folder in `suite`, whose reference is the folder of the same name in `reference`.

    Parameters
    ----------
    suite, reference : folders of folders of replicates.
    objects, mask : for all cases, or a folder that holds one of the name of each case, whatever its suffix.

    Raises
    ------
    ValueError : for no folder, or one that stands on one side alone.
    """
    names = {side: _folders(side, path) for side, path in (("suite", suite), ("reference", reference))}
    for side, other, there in (("suite", "reference", reference), ("reference", "suite", suite)):
        if lacking := sorted(names[side] - names[other]):
            raise ValueError(f"{there}: has no folder {lacking[0]}, a case of the {side}: allowed are the same folders")
    return [
        Case(
            name,
            [suite / name],
            [reference / name],
            {key: _beside(path, name) for key, path in (("objects", objects), ("mask", mask)) if path is not None},
        )
        for name in sorted(names["suite"])
    ]


def _folders(side: str, path: Path) -> set[str]:
    if not path.is_dir():
        raise ValueError(f"{side} = {path}: is no folder: allowed is a folder of folders, one a case")
    found = {each.name for each in path.iterdir() if each.is_dir() and not each.name.startswith(".")}
    if not found:
        raise ValueError(f"{side} = {path}: holds no folders: allowed is a folder of folders, one a case")
    return found


def _beside(path: Path, name: str) -> Path:
    if not path.is_dir():
        return path
    found = sorted(each for each in path.iterdir() if each.is_file() and each.stem == name)
    if len(found) != 1:
        raise ValueError(f"{path}: holds {len(found)} files {name}.*: allowed is one for each case")
    return found[0]


def each_against_each(sets: Sequence[Path], *, objects: Path | None = None, mask: Path | None = None) -> list[Case]:
    """A case for each pair of sets of replicates, the earlier one in the place of the reference."""
    names = [path.stem if path.is_file() else path.resolve().name for path in sets]
    if len(set(names)) < len(names):
        names = [path.as_posix().strip("./").replace("/", "_") for path in sets]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"{twice}: is given twice: allowed are different sets of replicates")
    options = {key: path for key, path in (("objects", objects), ("mask", mask)) if path is not None}
    return [
        Case(f"{names[b]} against {names[a]}", [sets[b]], [sets[a]], options)
        for a, b in itertools.combinations(range(len(sets)), 2)
    ]


def judge_all(
    cases: Sequence[Case],
    folder: Path,
    *,
    margin: float = MARGIN,
    level: float = LEVEL,
    exposure: float | None = None,
    command: str = "",
    say: Callable[[str], object] = lambda text: None,
    unjudged: Sequence[Unjudged] = (),
    **options: Any,
) -> list[Outcome]:
    """Judge cases under one level, and write a page for each and an index.

    Parameters
    ----------
    cases : of different names.
    folder : gets `index.html`, `results.json`, and a folder for each case; made if missing.
    margin, level, options : as for `termwise.judge`; the level is that of all cases together.
    exposure, command : as for `Judgement.save`.
    say : told what is done, a line a case.
    unjudged : others, that stand in the index alone.

    Raises
    ------
    ValueError : as `termwise.judge`, with the case named.
    """
    from termwise.reports.judging.folder import keep

    for name in ("index.html", "results.json"):
        (folder / name).unlink(missing_ok=True)
    found: list[tuple[str, str, Measured]] = []
    places = _places([case.name for case in cases])
    for number, (case, place) in enumerate(zip(cases, places, strict=True), 1):
        say(f"{number} of {len(cases)}: {case.name}")
        try:
            measured = measure(case.images, case.reference, margin=margin, level=level, **options, **case.options)
        except ValueError as error:
            raise ValueError(f"case {case.name}: {error}") from None
        measured = attrs.evolve(measured, settings=measured.settings | case.settings)
        keep(folder / place, measured, exposure=exposure, command=command)
        found.append((case.name, place, measured.without_images()))
    return decide_all(found, folder, margin=margin, level=level, command=command, unjudged=unjudged)


def decide_all(
    measured: Sequence[tuple[str, str, Measured]],
    folder: Path,
    *,
    margin: float = MARGIN,
    level: float = LEVEL,
    margins: Sequence[float] = (),
    command: str = "",
    unjudged: Sequence[Unjudged] = (),
) -> list[Outcome]:
    """Decide what was measured and kept, all under one level, and write the pages and the index.

    `measured` are a name, the folder in `folder` that holds its images, and what was found; `margins` are those of
    each, where they differ; `unjudged` are others, that stand in the index alone.
    """
    from termwise.reports.judging.folder import publish
    from termwise.reports.machine import versions
    from termwise.reports.pages import judge as pages
    from termwise.reports.results.schema import SCHEMA, plain, write

    tests = sum(each.statistics.tests for *_, each in measured)
    outcomes = []
    for index, (name, place, each) in enumerate(measured):
        judgement = each.decide(tests=max(tests, 1), margin=margins[index] if margins else margin, level=level)
        page = publish(folder / place, judgement, command=command, root="../")
        outcomes.append(Outcome(name, judgement, page))
    results = plain(
        {
            "schema": SCHEMA,
            "versions": versions(),
            "settings": {"command": command, "level": level, "tests": tests, "cases": len(outcomes)},
            "cases": rows(outcomes, folder),
            "unjudged": [attrs.asdict(each) for each in unjudged],
        }
    )
    write(folder / "results.json", results)
    pages.write_index(folder, results)
    return outcomes


def rows(outcomes: Iterable[Outcome], folder: Path) -> list[dict[str, Any]]:
    """What JSON holds of each case, the gravest first."""
    from termwise.reports.pages.environment import WORDS

    grave = {word: place for place, word in enumerate(WORDS)}
    ordered = sorted(outcomes, key=lambda each: grave.get(str(each.judgement.verdict), len(grave)))
    return [
        {
            "name": each.name,
            "page": each.page.relative_to(folder).as_posix(),
            "rendered_by": {name: value for name, value in each.judgement.settings.items() if name in RENDERED_BY},
        }
        | each.judgement.row()
        for each in ordered
    ]


def _places(names: Sequence[str]) -> list[str]:
    """A folder for each name, numbered where two would share one."""
    found: list[str] = []
    for name in names:
        numbered = (f"{slug(name)}-{number}" for number in itertools.count(2))
        found.append(next(each for each in itertools.chain([slug(name)], numbered) if each not in found))
    return found


def slug(name: str) -> str:
    """The folder of a case: its name, without what an address or a file system may not hold."""
    kept = "".join(letter if letter.isalnum() or letter in "._-" else "-" for letter in name).strip("-.")
    return kept or "case"
