"""Scenes and their images: render, reference, plan, scenes and view."""

import itertools
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import attrs
import numpy as np
from cyclopts import Parameter
from rich.table import Table

from termwise.reports import progress
from termwise.reports.cli import terminal
from termwise.reports.cli.engines import OneEngine
from termwise.reports.cli.terminal import (
    Approximate,
    Backend,
    Flag,
    Integer,
    Json,
    MaybeInteger,
    Quiet,
    Resolution,
    SceneName,
    TermName,
    Threads,
)
from termwise.scenes.exchange import neutral
from termwise.scenes.load import library, load
from termwise.scenes.model import Scene
from termwise.scenes.terms import TERMS

if TYPE_CHECKING:
    from termwise.renderer import Engine
    from termwise.renderer.plan import Step


def render(
    scene: SceneName,
    *,
    term: TermName = None,
    variant: list[str] | None = None,
    samples: Annotated[MaybeInteger, Parameter(name=("--samples", "--spp"))] = None,
    replicates: Integer = 1,
    seed: Integer = 0,
    threads: Threads = None,
    resolution: Resolution = None,
    diffuse: Flag = False,
    approximate: Approximate = False,
    engine: OneEngine = None,
    out: Path = Path("out"),
    quiet: Quiet = False,
    json_: Json = False,
) -> int:
    """Render a scene, or one of its terms, into an OpenEXR file and a PNG picture; with --engine all of its light.

    Parameters
    ----------
    variant
        An estimator of the term, its default if not given; of direct that is auto, of all bounces paths or photons, as
        the scene is. Without --term: TERM=NAME, once for each term.
    samples
        Samples per pixel and replicate, powers of two are best; 16 if not given, of an engine what its file says.
    diffuse
        Every gloss, translucency and transparency is 0, which every engine can say.
    replicates
        Independent repetitions that are averaged; two or more give a variance.
    seed
        Equal seeds give equal bits.
    out
        Files go to OUT/render.
    """
    described = terminal.scene(scene, resolution, approximate=approximate)
    described = neutral.diffuse(described) if diffuse else described
    terminal.check_seed(seed)
    folder = terminal.folder(out / "render")
    if engine is not None:
        if term is not None or variant:
            raise ValueError("engine: allowed without --term and --variant: an engine renders all light")
        from termwise.reports.judging.engines import engine as other

        found = other(engine).render(described, samples=samples, replicates=replicates, seed=seed, threads=threads)
        settings = {"samples": found.samples, "replicates": replicates, "seed": seed, "engine": engine}
        return _write_images(described, {"total": found}, folder, settings, json_)
    from termwise import renderer

    samples = 16 if samples is None else samples
    terms = TERMS if term is None else (term,)
    variants = _variants(terms, variant or []) if term is None else _variant(term, variant or [])
    with progress.stages(terminal.messages, quiet=quiet or json_, where=folder) as stage:
        found = renderer.render_terms(
            described,
            variants,
            samples=samples,
            replicates=replicates,
            seed=seed,
            threads=threads,
            report=stage("Samples of all terms"),
        )
    settings = {"samples": samples, "replicates": replicates, "seed": seed}
    taken = {each: renderer.chosen(described, each, name) for each, name in variants.items()}
    settings["variants"] = {each: found.name for each, found in taken.items()}
    settings["auto"] = {each: found.chosen for each, found in taken.items() if found.chosen}
    return _write_images(described, found, folder, settings, json_)


def _variant(term: str, given: list[str]) -> dict[str, str | None]:
    """The estimator of one term."""
    if len(given) > 1:
        raise ValueError(f"variant = {', '.join(given)}: allowed is one with term = {term!r}")
    return {term: given[0] if given else None}


def _variants(terms: tuple[str, ...], given: list[str]) -> dict[str, str | None]:
    """The estimator of each term, from words TERM=NAME."""
    chosen: dict[str, str | None] = dict.fromkeys(terms)
    for word in given:
        term, equals, name = word.partition("=")
        if not equals or term not in terms:
            raise ValueError(
                f"variant = {word!r}: allowed is TERM=NAME, or NAME with --term; terms are {', '.join(terms)}"
            )
        chosen[term] = name
    return chosen


def reference(
    scene: SceneName,
    *,
    term: TermName = None,
    physical: Flag = False,
    spp: Integer = 64,
    replicates: Integer = 4,
    seed: Integer = 0,
    resolution: Resolution = None,
    approximate: Approximate = False,
    export: Path | None = None,
    out: Path = Path("out"),
    backend: Backend = None,
    quiet: Quiet = False,
    json_: Json = False,
) -> int:
    """Render a scene's terms with Mitsuba, or export a script that does so without Termwise.

    Parameters
    ----------
    physical
        Full light transport, split by the lobe at the camera, instead of the paper's terms.
    spp
        Samples per pixel and replicate.
    replicates
        Independent repetitions that are averaged.
    seed
        Equal seeds give equal bits on one backend.
    export
        Folder for a stand-alone Mitsuba script of these references; nothing is rendered.
    out
        Files go to OUT/reference.
    """
    from termwise import reference as mitsuba
    from termwise.scenes import limits

    chosen = terminal.choose_backend(backend, quiet=quiet)
    described = terminal.scene(scene, resolution, approximate=approximate)
    terminal.check_seed(seed)
    if term is not None and term not in TERMS:
        raise ValueError(f"term = {term!r}: allowed are {', '.join(TERMS)}")
    wanted = {
        each: limits.physical(each) if physical else limits.correct(each, described.scope)
        for each in TERMS
        if term in (None, each)
    }
    if export is not None:
        from termwise.reference.export import export as write

        write(described, dict(wanted), export, spp=spp, seed=seed, replicates=replicates)
        script = export / "render.py"
        llvm = chosen.llvm_path
        if json_:
            terminal.say_json({"scene": described.name, "script": str(script)})
        else:
            terminal.say(f"Wrote {script}")
            if llvm:
                terminal.say(f"Run it with DRJIT_LIBLLVM_PATH={llvm}")
        return 0
    folder = terminal.folder(out / "reference")
    found = {}
    with progress.stages(terminal.messages, quiet=quiet or json_, where=folder) as stage:
        report, total = stage("Replicates of all terms"), len(wanted) * replicates
        for each, limit in wanted.items():
            count = itertools.count(len(found) * replicates)
            report(f"{each}, compiling", next(count), total)
            found[each] = mitsuba.render(
                described,
                limit,
                spp=spp,
                seed=seed,
                replicates=replicates,
                progress=lambda each=each, count=count: report(each, next(count), total),
            )
    settings = {"spp": spp, "replicates": replicates, "seed": seed, "backend": chosen.variant}
    return _write_images(described, found, folder, settings, json_)


def _write_images(scene: Any, found: dict[str, Any], folder: Path, settings: dict[str, Any], as_json: bool) -> int:
    """Write term images and their sum; report means and seconds."""
    from termwise.reports.pages.pictures import write_png
    from termwise.reports.results.exr import write_exr
    from termwise.scenes.terms import total

    parts = {term: image.mean for term, image in found.items()}
    if len(parts) == len(TERMS):
        parts["total"] = total(*(parts[term] for term in TERMS))
    shown = "total" if "total" in parts else next(iter(parts))
    exr, png = folder / f"{scene.name}.exr", folder / f"{scene.name}.{shown}.png"
    header = {"software": "termwise", "scene": scene.name, "digest": scene.digest(), "settings": json.dumps(settings)}
    write_exr(exr, parts, header)
    write_png(png, parts[shown], exposure=scene.exposure)
    rows = {
        term: {"mean": image.mean.mean(axis=(0, 1)).tolist(), "seconds": image.seconds} for term, image in found.items()
    }
    if as_json:
        terminal.say_json({"scene": scene.name, "settings": settings, "terms": rows, "files": [str(exr), str(png)]})
        return 0
    table = Table("term", "mean radiance (R, G, B)", "seconds")
    for term, row in rows.items():
        table.add_row(term, "  ".join(f"{x:.6f}" for x in row["mean"]), f"{row['seconds']:.2f}")
    terminal.output.print(table)
    terminal.say(f"{exr}\n{png}")
    return 0


def plan(
    scene: SceneName,
    *,
    samples: Integer = 16,
    counted: Flag = False,
    resolution: Resolution = None,
    approximate: Approximate = False,
    json_: Json = False,
) -> int:
    """Say what a scene needs: what runs, what is skipped, why, and how much work that saves.

    Parameters
    ----------
    samples
        Samples per pixel, for the counts of work.
    counted
        Sample the corners of the pixels, and say how many get how many samples; kernels are compiled for it.
    """
    from termwise.renderer.auto import chosen
    from termwise.renderer.plan import plan as steps_of

    if samples < 1:
        raise ValueError(f"samples = {samples}: allowed is at least 1")
    described = terminal.scene(scene, resolution, approximate=approximate)
    steps = steps_of(described, {term: chosen(described, term) for term in TERMS}, samples=samples, together=True)
    if counted:
        steps = _counted(described, steps, samples)
    if json_:
        found = [attrs.asdict(step) for step in steps]
        terminal.say_json({"scene": scene, "samples": samples, "steps": found})
        return 0
    colours = {"runs": "", "skip": "green", "variance reduction": "cyan", "reuse": "cyan"}
    table = terminal.table("term", "work", "", "why", "saved")
    before = None
    for step in steps:
        saved = ", ".join(f"{count:,} {name}" for name, count in step.saved.items())
        table.add_row(
            step.term if step.term != before else "",
            step.work,
            f"[{colours[step.kind]}]{step.kind}[/]" if colours[step.kind] else step.kind,
            step.reason,
            f"at most {saved}" if saved and step.at_most else saved,
        )
        before = step.term
    terminal.output.print(table)
    return 0


def _counted(scene: Scene, steps: "tuple[Step, ...]", samples: int) -> "tuple[Step, ...]":
    """The steps, those whose counts go by contrast with the pixels of each count."""
    from termwise.renderer import Engine, chosen
    from termwise.renderer.plan import REDUCTIONS

    def told(engine: "Engine", step: "Step") -> "Step":
        if step.work != REDUCTIONS["counts"].work:
            return step
        each, pixels = np.unique(engine.shares(chosen(scene, step.term), samples=samples), return_counts=True)
        of_each = ", ".join(f"{many} get {count}" for count, many in zip(each, pixels, strict=True))
        mean = each @ pixels / pixels.sum()
        return attrs.evolve(step, reason=f"{step.reason}; of {pixels.sum()} pixels {of_each}, the mean {mean:.1f}")

    with Engine(scene) as engine:
        return tuple(told(engine, step) for step in steps)


def scenes(*, json_: Json = False) -> int:
    """List the scenes of the library."""
    rows = []
    for name in library():
        scene = load(name)
        triangles = sum(len(thing.mesh.faces) for thing in scene.objects)
        lights = len(scene.lights) + sum(thing.emits for thing in scene.objects)
        rows.append({"name": name, "objects": len(scene.objects), "triangles": triangles, "lights": lights})
        rows[-1] |= {"scope": scene.scope, "max_bounces": scene.max_bounces, "digest": scene.digest()}
    if json_:
        terminal.say_json({"scenes": rows})
        return 0
    table = Table("scene", "objects", "triangles", "lights", "scope", "bounces")
    for row in rows:
        values = (row["objects"], row["triangles"], row["lights"], row["scope"], row["max_bounces"])
        table.add_row(row["name"], *map(str, values))
    terminal.output.print(table)
    return 0


def view(
    scene: SceneName = "two_cubes",
    *,
    approximate: Approximate = False,
    port: MaybeInteger = None,
    browser: bool = True,
    out: Path = Path("out"),
) -> int:
    """Open a local page on which every input is set and each term is watched while it converges.

    Parameters
    ----------
    port
        Of 127.0.0.1; a free one if not given.
    browser
        Open it in a browser.
    out
        What is saved goes to OUT/view, nothing elsewhere.
    """
    from termwise.reports.live.page import serve

    def announce(address: str) -> None:
        terminal.output.print(f"termwise view: {address} (Ctrl-C ends it)", highlight=False)

    described = terminal.scene(scene, None, approximate=approximate)
    serve(described, out / "view", port=port, browser=browser, announce=announce)
    return 0
