"""Engines judged: in furnaces against exact numbers, on scenes against Mitsuba, each image a case of one family.

What an engine cannot say is ABSENT, what it fails at FAILED, each with its reason; the other cases stand.
"""

import functools
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from termwise.reports.engines import asked as asking
from termwise.reports.engines.asked import TOTAL, Asked, Row, lacking
from termwise.reports.engines.engine import Engine, EngineError
from termwise.reports.engines.engine import load as load_engine
from termwise.reports.engines.furnaces import furnaces
from termwise.reports.engines.probe import probe as check
from termwise.reports.engines.replicates import Images, rendered
from termwise.reports.judging.hints import AtDepth
from termwise.reports.judging.judge import Judgement, judge
from termwise.reports.judging.suite import Case, Outcome, Unjudged, judge_all
from termwise.reports.progress import Report, silent
from termwise.scenes.arguments import whole
from termwise.scenes.limits import Limit
from termwise.scenes.load import load
from termwise.scenes.model import Scene
from termwise.scenes.store import cache_folder
from termwise.scenes.terms import TermImage, total

if TYPE_CHECKING:
    from termwise.reports.jobs.executors import Executor

_LEAST = 4
"""Replicates that a comparison needs: an image without noise stands for so many."""
_SHORTFALL = "reference shortfall"
"""Setting of a case: why its reference has fewer samples or replicates than asked for."""


@attrs.frozen(eq=False)
class Asking:
    """How images are rendered.

    Attributes
    ----------
    replicates, seed : of both sides; of an engine without noise one image is.
    spp : samples per pixel of an engine; None: those that its file says.
    threads : None: one a core.
    probed : whether an engine is probed before it is believed.
    together : runs of an engine at a time, which share the threads.
    executor : has engines run, in other processes; None: this one.
    """

    replicates: int = 16
    seed: int = 1
    spp: int | None = None
    threads: int | None = None
    probed: bool = True
    together: int = 1
    executor: "Executor | None" = None

    def samples(self, engine: Engine) -> int:
        """Samples per pixel of an engine."""
        return self.spp or engine.says.spp


@attrs.frozen(eq=False)
class Judged:
    """What was judged, what was not, and what must be said of the engines."""

    outcomes: list[Outcome]
    unjudged: list[Unjudged]
    notes: list[str]

    @property
    def failed(self) -> bool:
        """Whether an engine failed at what it says it can do."""
        return any(each.word == "FAILED" for each in self.unjudged)


def furnace(
    engines: Sequence[Engine], folder: Path, how: Asking, *, command: str = "", report: Report = silent
) -> Judged:
    """Render the furnaces and judge them against their radiance; pages go to `folder`."""
    scenes = furnaces()
    how = attrs.evolve(how, together=_threads(how))  # of so small images most seconds are those of a start
    family = _Family(how, report, _steps(engines, ([each.asked] for each in scenes), how))
    for engine in family.believed(engines):
        for each in scenes:
            name = each.name if len(engines) == 1 else f"{engine.name}: {each.name}"
            images = family.images(engine, name, [each.asked])
            if images is not None:
                settings = {"radiance": each.formula}
                options = {"noiseless": True, "at_depth": each.at_depth}
                family.add(engine, name, images, each.exact[None], options, settings)
    return family.judge(folder, command, exact=True)


def compare(
    engines: Sequence[Engine],
    scenes: Sequence[Scene],
    folder: Path,
    how: Asking,
    *,
    reference_spp: int,
    reference_replicates: int,
    only: Sequence[str] = asking.ROWS,
    command: str = "",
    report: Report = silent,
) -> Judged:
    """Render scenes by engines and by Mitsuba, and judge all light and the terms, or `only` some; pages go to `folder`.

    Raises
    ------
    ValueError : a row that is none.
    """
    for name in only:
        if name not in asking.ROWS:
            raise ValueError(f"row = {name!r}: allowed are {', '.join(asking.ROWS)}")
    present = (row for scene in scenes for row in asking.rows(scene) if row.name in only and row.absent is None)
    family = _Family(how, report, _steps(engines, ([part for _, part in row.parts] for row in present), how))
    believed = list(family.believed(engines))
    spp = max([reference_spp, *(how.samples(engine) for engine in engines)])
    for scene in scenes:
        for row in (each for each in asking.rows(scene) if each.name in only):
            truth: _Truth | None = None
            for engine in believed:
                name = f"{scene.name}: {row.name}: {engine.name}"
                if row.absent is not None:
                    family.unjudged.append(Unjudged(name, "ABSENT", row.absent))
                    continue
                images = family.images(engine, name, [part for _, part in row.parts])
                if images is None:
                    continue
                if truth is None:
                    truth = _truth(row.limits, spp=spp, seed=how.seed, count=reference_replicates)
                # What shines was subtracted: noise leaves less than nothing.
                options = _objects(scene) | {"allow_negative": len(row.parts) > 1}
                options |= {"at_depth": _at_depth(row, truth, spp=spp, seed=how.seed, say=family.says)}
                settings = {"judged against": _against(row)} | truth.settings
                family.add(engine, name, images, truth.stack, options, settings, row)
    return family.judge(folder, command)


def against(
    scene: Scene, *, spp: int, seed: int, replicates: int, say: Callable[[str], object] = lambda text: None
) -> tuple[np.ndarray, dict[str, Any]]:
    """Mitsuba's replicates of all light of a scene (R, H, W, 3), lamps in view too; and what `judge` takes beside them.

    That is its objects, and the reference of less light for a hint, of which `say` is told when it is rendered.
    """
    row = asking.total(scene)
    if row.absent is not None:
        raise ValueError(f"{scene.name}: {row.absent}: allowed is a scene that is light transport")
    truth = _truth(row.limits, spp=spp, seed=seed, count=replicates)
    return truth.stack, _objects(scene) | {"at_depth": _at_depth(row, truth, spp=spp, seed=seed, say=say)}


def case(engine: Engine, scene: Scene, how: Asking, *, progress: Callable[[], object] | None = None) -> Case:
    """All light of a scene by an engine, without a reference yet.

    Raises
    ------
    EngineError : the engine failed, or lacks what the scene needs.
    """
    if how.probed:
        check(engine, threads=_threads(how))
    (_, part), *_ = asking.total(scene).parts
    images = [_rendered(engine, part, how, progress)]
    return _case(engine, scene.name, how, images, [1], {}, {})


def enough(replicates: int) -> int:
    """So many replicates, if they can be judged."""
    return whole("replicates", replicates, _LEAST)


def _rendered(engine: Engine, part: Asked, how: Asking, progress: Callable[[], object] | None = None) -> Images:
    if (lacks := lacking(engine, part)) is not None:
        raise EngineError(f"{engine.name}: {part.name}: {lacks}")
    return rendered(
        engine,
        part,
        spp=how.samples(engine),
        seed=how.seed,
        count=how.replicates,
        threads=how.threads,
        together=how.together,
        executor=how.executor,
        progress=progress,
    )


@attrs.frozen
class Renderer:
    """A renderer of another kind, in Python.

    Attributes
    ----------
    engine : what it is told by.
    """

    engine: Engine

    def __repr__(self) -> str:
        """Its name and its file, in a line."""
        return f"<engine {self.engine.name}: {self.engine.path}>"

    def render(
        self,
        scene: Scene | str | Path,
        *,
        samples: int | None = None,
        replicates: int = 1,
        seed: int = 0,
        threads: int | None = None,
        probe: bool = True,
    ) -> TermImage:
        """Render all light of a scene: what the camera sees of lamps and sky, and all that surfaces scatter.

        Parameters
        ----------
        scene : a scene, the name of one of the library, or the path of a scene file.
        samples : samples per pixel and replicate; None: those that the engine's file says.
        replicates : images of other seeds; of an engine without noise one.
        seed : in [0, 2^31 - 1]: names the seeds that the engine is given.
        threads : None: one a core.
        probe : whether the engine is probed before it is believed, once a version.

        Returns
        -------
        The image, its variance and its replicates: radiance, linear Rec. 709, in the scene's unit.

        Raises
        ------
        EngineError : the engine is not here, failed, or lacks what the scene needs; a `ValueError`.
        """
        how = Asking(
            replicates=whole("replicates", replicates),
            seed=whole("seed", seed, 0, 2**31 - 1),
            spp=None if samples is None else whole("samples", samples),
            threads=threads,
            probed=probe,
        )
        if how.probed:
            check(self.engine, threads=_threads(how))
        (_, part), *_ = asking.total(load(scene)).parts
        found = _rendered(self.engine, part, how)
        samples, seconds = how.samples(self.engine), float(found.seconds.sum())
        return TermImage.from_replicates(found.stack, samples=samples, seconds=seconds, keep=True)

    def judge(
        self,
        scene: Scene | str | Path,
        *,
        samples: int | None = None,
        replicates: int = 16,
        reference_samples: int = 64,
        seed: int = 1,
        probe: bool = True,
        **options: Any,
    ) -> Judgement:
        """Judge all light of a scene against Mitsuba's, objects by name.

        Parameters
        ----------
        scene, samples, replicates, seed, probe : as for `render`; replicates and seed are of the reference too.
        reference_samples : samples per pixel and replicate of the reference.
        options : of `termwise.judge`.

        Raises
        ------
        EngineError : as `render`.
        """
        found = load(scene)
        how = Asking(replicates=enough(replicates), seed=seed, spp=samples, probed=probe)
        ours = case(self.engine, found, how)
        truth, places = against(found, spp=reference_samples, seed=seed, replicates=replicates)
        judgement = judge(ours.images, truth, **(ours.options | places | options))
        return attrs.evolve(judgement, settings=judgement.settings | ours.settings)


def engine(engine: str | Path) -> Renderer:
    """Another renderer, told by a TOML file: one that ships by name, or any by its path.

    Raises
    ------
    FileError : a missing or malformed file, an unknown key, a value that is not allowed; a `ValueError`.
    """
    return Renderer(load_engine(engine))


def _steps(engines: Sequence[Engine], rows: Iterable[list[Asked]], how: Asking) -> int:
    """Images that will be rendered: those of rows for which an engine lacks nothing."""
    return sum(
        len(parts) * (1 if engine.says.noiseless else how.replicates)
        for parts in rows
        for engine in engines
        if not any(lacking(engine, part) for part in parts)
    )


class _Family:
    """Cases as they come in."""

    def __init__(self, how: Asking, report: Report, steps: int) -> None:
        self.how, self.report = how, report
        self.cases: list[Case] = []
        self.unjudged: list[Unjudged] = []
        self.notes: list[str] = []
        self._done, self._steps = 0, steps

    def believed(self, engines: Sequence[Engine]) -> Iterator[Engine]:
        """The engines that are here and read the probe's scene rightly."""
        for engine in engines:
            try:
                self.report(f"{engine.name}: probe", self._done, self._steps)
                if self.how.probed:
                    self.notes += [f"{engine.name}: {note}" for note in check(engine, threads=_threads(self.how))]
                _ = engine.digest
            except EngineError as error:
                self.unjudged.append(Unjudged(engine.name, "FAILED", str(error)))
                continue
            yield engine

    def images(self, engine: Engine, name: str, parts: list[Asked]) -> list[Images] | None:
        """The images of the parts of a row; None where there are none, which is then said."""
        for part in parts:
            if (lacks := lacking(engine, part)) is not None:
                self.unjudged.append(Unjudged(name, "ABSENT", lacks))
                return None

        def progress() -> None:
            self._done += 1
            self.report(name, self._done, max(self._steps, self._done))

        try:
            return [_rendered(engine, part, self.how, progress) for part in parts]
        except EngineError as error:
            self.unjudged.append(Unjudged(name, "FAILED", str(error)))
            return None

    def says(self, what: str) -> None:
        """Report what is done beside the images: one thing more than they are."""
        self.report(what, self._done, max(self._steps, self._done) + 1)

    def add(
        self,
        engine: Engine,
        name: str,
        images: list[Images],
        truth: np.ndarray,
        options: dict[str, Any],
        settings: dict[str, Any],
        row: Row | None = None,
    ) -> None:
        """A case."""
        signs = [1] if row is None else [sign for sign, _ in row.parts]
        found = _case(engine, name, self.how, images, signs, options, settings)
        self.cases.append(attrs.evolve(found, reference=truth))

    def judge(self, folder: Path, command: str, **options: Any) -> Judged:
        """Decide all cases under one level and write the pages."""
        outcomes = judge_all(self.cases, folder, command=command, unjudged=self.unjudged, **options)
        return Judged(outcomes, self.unjudged, self.notes)


def _case(
    engine: Engine,
    name: str,
    how: Asking,
    images: Sequence[Images],
    signs: Sequence[int],
    options: dict[str, Any],
    settings: dict[str, Any],
) -> Case:
    """A case of an engine's images, whose reference is still to come."""
    ours = np.sum([sign * each.stack for sign, each in zip(signs, images, strict=True)], axis=0)
    if len(ours) < _LEAST:
        ours = np.repeat(ours, _LEAST, axis=0)
        options = options | {"noiseless": True}
    told: dict[str, Any] = {
        "engine": engine.name,
        "version": engine.version,
        "samples a pixel": how.samples(engine),
        "seconds": round(sum(float(each.seconds.sum()) for each in images), 2),
        "command": " ".join(engine.says.command),
    }
    if notes := [note for each in images for note in each.notes]:
        told["read with"] = "; ".join(notes)
    return Case(name, ours, None, {"samples": how.samples(engine)} | options, told | settings)


def _threads(how: Asking) -> int:
    return how.threads or os.cpu_count() or 1


@attrs.frozen(eq=False)
class _Truth:
    """Replicates of a reference (R, H, W, 3), and what is said of them."""

    stack: np.ndarray
    settings: dict[str, Any]


def _truth(limits: Sequence[tuple[Scene, Limit]], *, spp: int, seed: int, count: int) -> _Truth:
    """Replicates of a sum of references, from the cache or rendered now.

    Raises
    ------
    ValueError : Mitsuba's backend affords too few.
    """
    from termwise.reference import store

    folder = cache_folder() / "reference"
    found = [store.replicates(scene, limit, spp=spp, seed=seed, count=count, folder=folder) for scene, limit in limits]
    least = min(len(each.images) for each in found)
    shortfall = "; ".join(dict.fromkeys(each.shortfall for each in found if each.shortfall))
    if least < _LEAST:
        raise ValueError(f"{limits[0][0].name}: {shortfall}: allowed are at least {_LEAST} replicates")
    stacks = [each.images[:least] for each in found]
    said: dict[str, Any] = {"reference samples a pixel": found[0].spp}
    said |= {_SHORTFALL: shortfall} if shortfall else {}
    return _Truth(total(*stacks) if len(stacks) > 1 else stacks[0], said)


def _at_depth(row: Row, truth: _Truth, *, spp: int, seed: int, say: Callable[[str], object]) -> AtDepth | None:
    """Replicates of what is left of a reference where light scatters a few times; None where there is no such thing.

    Nor is there where the reference itself took all the time that it may.
    """
    if not row.transported or _SHORTFALL in truth.settings:
        return None
    said = functools.cache(say)  # once a depth

    def replicates(depth: int, count: int) -> np.ndarray:
        often = "once" if depth == 1 else f"{depth} times"
        said(f"Mitsuba renders {row.transported[0][0].name} for a hint: light scatters {often}")
        return _truth(row.cut(depth), spp=spp, seed=seed, count=count).stack

    return replicates


def _against(row: Row) -> str:
    return "full light transport by Mitsuba" if row.name == TOTAL else f"{row.limits[0][1]!r} by Mitsuba"


def _objects(scene: Scene) -> dict[str, Any]:
    """Which object the middle of each pixel sees, and their names."""
    from termwise.renderer.engine import Engine as Renderer

    with Renderer(scene) as renderer:
        seen = renderer.geometry().object
    return {"objects": seen, "object_names": [thing.name for thing in scene.objects]}
