"""The command `termwise`: compare, judge, render, reference, plan, scenes, view, bench.

Exit status 0: ran; 1: an error was proven (BIASED or NOT AS PREDICTED against `own`); 2: bad input, or a run that
could not end. With --json one object goes to standard output, all else to standard error.
"""

import importlib.metadata
import json
import runpy
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import attrs
import cyclopts
import numpy as np
from cyclopts import Parameter
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from scenes.load import library, load
from scenes.strict import FileError
from scenes.terms import TERMS

_messages = Console(stderr=True, soft_wrap=True)
_output = Console()

app = cyclopts.App(
    name="termwise",
    help="The rendering equation term by term: is an estimator biased, by how much, where, and how sure are you?",
    error_console=_messages,
    error_formatter=lambda error: f"termwise: {' '.join(str(error).split())}",
    version=lambda: importlib.metadata.version("termwise"),
    print_error=True,
    exit_on_error=False,
    suppress_keyboard_interrupt=False,
)


def _integer(_kind: Any, tokens: Any) -> int:
    """Cyclopts alone takes 1.5 for an integer, and rounds it."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f"{tokens[0].value!r}: allowed is an integer") from None


_whole = Parameter(converter=_integer, n_tokens=1)
Integer = Annotated[int, _whole]
bench = cyclopts.App(name="bench", help="Measure speed beside Mitsuba's, both in one run.")
app.command(bench)

Json = Annotated[bool, Parameter(negative="", help="One JSON object on standard output.")]


@app.command
def compare(
    *scenes: str,
    study: str = "standard",
    estimators: Path | None = None,
    out: Path = Path("out"),
    backend: str | None = None,
    json_: Annotated[Json, Parameter(name="--json")] = False,
) -> int:
    """Render scenes with ours and with Mitsuba, judge every term, write the report.

    Parameters
    ----------
    scenes
        Names of the library or paths of scene files; all scenes of the study if none.
    study
        quick, standard, full, or the path of a study file.
    estimators
        A Python file that calls `termwise.register`: what it registers is measured too.
    out
        The report goes to OUT/compare, or to the folder that the study names.
    backend
        Mitsuba variant: llvm_ad_rgb, scalar_rgb or cuda_ad_rgb; chosen by itself if not given.
    json_
        Print results.json on standard output.
    """
    from reports import page, run, subjects
    from reports import study as studies

    mitsuba = _choose_backend(backend)
    if estimators is not None:
        _run_file(estimators)
    chosen = studies.with_registered(studies.load(study))
    prepared = subjects.scenes_of(chosen, scenes)
    folder = _folder(out / chosen.folder)
    results = run.finished(folder, run.digest(chosen, prepared, mitsuba))
    if results is None:
        with _progress() as bar:
            task = bar.add_task("starting", total=None)

            def report(what: str, done: int, total: int) -> None:
                bar.update(task, description=what, completed=done, total=total)

            results = run.measure(chosen, prepared, folder, name=Path(study).stem, report=report)
        page.write(folder)
    else:
        _messages.print("Nothing has changed since the last run: no cell was computed.")
    index = folder / "index.html"
    if json_:
        print(json.dumps(results))
    else:
        _print_results(results)
        _output.print(f"\nReport: {index.resolve()}", soft_wrap=True)
    return 1 if run.failures(results) else 0


def _run_file(path: Path) -> None:
    """Execute a Python file of the user's."""
    if not path.is_file():
        raise FileError(f"{path}: no such file: allowed is a Python file that calls termwise.register")
    runpy.run_path(str(path), run_name=path.stem)


@app.command
def judge(
    *images: Path,
    reference: Annotated[list[Path], Parameter(consume_multiple=True)],
    reference_exact: Annotated[bool, Parameter(negative="")] = False,
    part: str | None = None,
    json_: Annotated[Json, Parameter(name="--json")] = False,
) -> int:
    """Judge any renderer's replicate images against replicates of a reference.

    Parameters
    ----------
    images
        OpenEXR replicates of one image: equal settings, different seeds. At least 4, better 16.
    reference
        Replicates of the reference.
    reference_exact
        The one reference image has no noise.
    part
        Name of the part to read where a file has several.
    json_
        Print the verdict as JSON on standard output.
    """
    from reports.run import plain
    from reports.verdict import judge as decide

    for name, given in (("images", images), ("reference", reference)):
        if not given:
            raise ValueError(f"{name}: none given: allowed are OpenEXR files")
    outcome = decide(
        [_read(path, part) for path in images],
        [_read(path, part) for path in reference],
        exact=reference_exact,
        names=[str(path) for path in images],
        reference_names=[str(path) for path in reference],
    )
    for warning in outcome.warnings:
        _messages.print(f"termwise: {warning}", soft_wrap=True, highlight=False)
    if json_:
        print(json.dumps(plain(attrs.asdict(outcome))))
    else:
        _output.print(f"[bold]{outcome.verdict}[/bold]", highlight=False)
        _output.print(outcome.sentence, highlight=False, soft_wrap=True)
        for reason in outcome.reasons:
            _output.print(f"- {reason}", highlight=False, soft_wrap=True)
    return 1 if outcome.verdict == "BIASED" else 0


@app.command
def render(
    scene: str,
    *,
    term: str | None = None,
    variant: list[str] | None = None,
    samples: Integer = 16,
    replicates: Integer = 1,
    seed: Integer = 0,
    threads: Annotated[int | None, _whole] = None,
    resolution: tuple[int, int] | None = None,
    adaptive: bool = False,
    out: Path = Path("out"),
    json_: Annotated[Json, Parameter(name="--json")] = False,
) -> int:
    """Render a scene, or one of its terms, into an OpenEXR file and a PNG picture.

    Parameters
    ----------
    scene
        A name of the library or the path of a scene file.
    term
        ambient, direct, specular or background; without it all four and their sum.
    variant
        An estimator of the term, its default if not given. Without --term: TERM=NAME, once for each term.
    samples
        Samples per pixel and replicate; powers of two are best.
    replicates
        Independent repetitions that are averaged; two or more give a variance.
    seed
        Equal seeds give equal bits.
    threads
        One per core if not given.
    resolution
        Width and height, instead of the scene's.
    adaptive
        Give noisier tiles more samples, as a discarded pilot of 8 says; SAMPLES is then the mean. For estimators
        without photon maps; it pays from about 100 samples on.
    out
        Files go to OUT/render.
    json_
        Print what was rendered as JSON on standard output.
    """
    import renderer

    described = _scene(scene, resolution)
    _check_seed(seed)
    folder = _folder(out / "render")
    terms = TERMS if term is None else (term,)
    variants = _variants(terms, variant or []) if term is None else _variant(term, variant or [])
    found = renderer.render_terms(
        described,
        variants,
        samples=samples,
        replicates=replicates,
        seed=seed,
        threads=threads,
        adaptive=adaptive,
    )
    settings = {
        "samples": samples,
        "replicates": replicates,
        "seed": seed,
        "variant": " ".join(variant or ["default"]),
    }
    return _write_images(described, found, folder, settings | {"adaptive": adaptive}, json_)


@app.command
def reference(
    scene: str,
    *,
    term: str | None = None,
    physical: Annotated[bool, Parameter(negative="")] = False,
    spp: Integer = 64,
    replicates: Integer = 4,
    seed: Integer = 0,
    resolution: tuple[int, int] | None = None,
    export: Path | None = None,
    out: Path = Path("out"),
    backend: str | None = None,
    json_: Annotated[Json, Parameter(name="--json")] = False,
) -> int:
    """Render a scene's terms with Mitsuba, or export a script that does so without Termwise.

    Parameters
    ----------
    scene
        A name of the library or the path of a scene file.
    term
        ambient, direct, specular or background; without it all four and their sum.
    physical
        Full light transport, split by the lobe at the camera, instead of the paper's terms.
    spp
        Samples per pixel and replicate.
    replicates
        Independent repetitions that are averaged.
    seed
        Equal seeds give equal bits on one backend.
    resolution
        Width and height, instead of the scene's.
    export
        Folder for a stand-alone Mitsuba script of these references; nothing is rendered.
    out
        Files go to OUT/reference.
    backend
        Mitsuba variant: llvm_ad_rgb, scalar_rgb or cuda_ad_rgb.
    json_
        Print what was rendered as JSON on standard output.
    """
    import reference as mitsuba
    from scenes import limits

    _choose_backend(backend)
    described = _scene(scene, resolution)
    _check_seed(seed)
    if term is not None and term not in TERMS:
        raise ValueError(f"term = {term!r}: allowed are {', '.join(TERMS)}")
    wanted = {
        each: limits.physical(each) if physical else limits.correct(each, described.scope)
        for each in TERMS
        if term in (None, each)
    }
    if export is not None:
        from reference.backend import active
        from reference.export import export as write

        write(described, dict(wanted), export, spp=spp, seed=seed, replicates=replicates)
        script = export / "render.py"
        llvm = active().llvm_path
        if json_:
            print(json.dumps({"scene": described.name, "script": str(script)}))
        else:
            _output.print(f"Wrote {script}", soft_wrap=True, highlight=False)
            if llvm:
                _output.print(f"Run it with DRJIT_LIBLLVM_PATH={llvm}", soft_wrap=True, highlight=False)
        return 0
    folder = _folder(out / "reference")
    found = {
        each: mitsuba.render(described, limit, spp=spp, seed=seed, replicates=replicates)
        for each, limit in wanted.items()
    }
    return _write_images(
        described, found, folder, {"spp": spp, "replicates": replicates, "seed": seed}, json_
    )


@app.command
def plan(
    scene: str,
    *,
    samples: Integer = 16,
    resolution: tuple[int, int] | None = None,
    json_: Annotated[Json, Parameter(name="--json")] = False,
) -> int:
    """Say what a scene needs: what runs, what is skipped, why, and how much work that saves.

    Parameters
    ----------
    scene
        A name of the library or the path of a scene file.
    samples
        Samples per pixel, for the counts of work.
    resolution
        Width and height, instead of the scene's.
    json_
        Print the plan as JSON on standard output.
    """
    from renderer.plan import plan as steps_of
    from renderer.terms import find

    if samples < 1:
        raise ValueError(f"samples = {samples}: allowed is at least 1")
    steps = steps_of(
        _scene(scene, resolution), {term: find(term) for term in TERMS}, samples=samples, together=True
    )
    if json_:
        found = [attrs.asdict(step) for step in steps]
        print(json.dumps({"scene": scene, "samples": samples, "steps": found}))
        return 0
    colours = {"runs": "", "skip": "green", "economy": "cyan", "reuse": "cyan"}
    table = Table("term", "work", "", "why", "saved", box=None, padding=(0, 1, 0, 0), pad_edge=False)
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
    _output.print(table)
    return 0


@app.command
def scenes(*, json_: Annotated[Json, Parameter(name="--json")] = False) -> int:
    """List the scenes of the library.

    Parameters
    ----------
    json_
        Print the list as JSON on standard output.
    """
    rows = []
    for name in library():
        scene = load(name)
        triangles = sum(len(thing.mesh.faces) for thing in scene.objects)
        lights = len(scene.lights) + sum(thing.emits for thing in scene.objects)
        rows.append({"name": name, "objects": len(scene.objects), "triangles": triangles, "lights": lights})
        rows[-1] |= {"scope": scene.scope, "max_bounces": scene.max_bounces, "digest": scene.digest()}
    if json_:
        print(json.dumps({"scenes": rows}))
        return 0
    table = Table("scene", "objects", "triangles", "lights", "scope", "bounces")
    for row in rows:
        values = (row["objects"], row["triangles"], row["lights"], row["scope"], row["max_bounces"])
        table.add_row(row["name"], *map(str, values))
    _output.print(table)
    return 0


@app.command
def view(
    scene: str = "two_cubes",
    *,
    port: Annotated[int | None, _whole] = None,
    browser: bool = True,
    out: Path = Path("out"),
) -> int:
    """Open a local page on which every input is set and each term is watched while it converges.

    Parameters
    ----------
    scene
        A name of the library or the path of a scene file.
    port
        Of 127.0.0.1; a free one if not given.
    browser
        Open it in a browser.
    out
        What is saved goes to OUT/view, nothing elsewhere.
    """
    from reports.view.page import serve

    def announce(address: str) -> None:
        _output.print(f"termwise view: {address} (Ctrl-C ends it)", highlight=False)

    serve(scene, out / "view", port=port, browser=browser, announce=announce)
    return 0


@bench.command
def rays(
    *,
    mesh: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    pairs: Integer = 7,
    count: Integer = 2**19,
    threads: Annotated[int | None, _whole] = None,
    out: Path = Path("out"),
    json_: Annotated[Json, Parameter(name="--json")] = False,
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
    json_
        Print them on standard output.
    """
    from reports.bench import rays as bench_rays

    measured = _measured(
        out / "bench",
        "rays",
        lambda report: bench_rays.measure(
            threads=threads, pairs=pairs, count=count, only=tuple(mesh or ()), report=report
        ),
    )
    if json_:
        print(json.dumps(measured))
        return 0
    columns = ("mesh", "triangles", "rays", "ours", "Mitsuba", "ratio", "spread", "by CPU", "default")
    # 80 columns hold it: what is not a terminal has no more.
    table = Table(*columns, box=None, padding=(0, 1, 0, 0), pad_edge=False)
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
    _output.print(table)
    _output.print(
        "Millions of rays a second; the ratio is the median of pairs with Mitsuba's robust flag, then the same by "
        "processor time, then with its default flags.",
        soft_wrap=True,
    )
    for row in measured["builds"]:
        _output.print(
            f"{row['mesh']}: built in {row['seconds']:.2f} s, {row['bytes_per_triangle']:.0f} bytes a triangle"
        )
    _print_machine(measured["machine"])
    return 0


@bench.command
def terms(
    *,
    scene: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    term: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    resolution: Integer = 128,
    runs: Integer = 5,
    seconds: float = 0.5,
    threads: Annotated[int | None, _whole] = None,
    out: Path = Path("out"),
    json_: Annotated[Json, Parameter(name="--json")] = False,
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
    json_
        Print them on standard output.
    """
    from reports.bench import terms as bench_terms

    measured = _measured(
        out / "bench",
        "terms",
        lambda report: bench_terms.measure(
            scenes=tuple(scene or ()),
            terms=tuple(term or ()),
            resolution=resolution,
            runs=runs,
            seconds=seconds,
            threads=threads,
            report=report,
        ),
    )
    if json_:
        print(json.dumps(measured))
        return 0
    for name in dict.fromkeys(case["scene"] for case in measured["cases"]):
        # 80 columns hold it: what is not a terminal has no more.
        columns = ("term", "variant", "RMSE", "ours", "Mitsuba", "times", "spread", "its setting")
        table = Table(
            *columns,
            title=f"\n[bold]{name}",
            title_justify="left",
            box=None,
            padding=(0, 1, 0, 0),
            pad_edge=False,
        )
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
        _output.print(table)
    for case in measured["apart"]:
        _output.print(f"{case['scene']}, {case['term']} {case['variant']}: no error that both sides reach")
    _output.print(
        "Seconds of rendering alone to a root mean square error (radiance), and how many times as long Mitsuba takes "
        "in its fastest setting, median of runs (xN: rays that share a hit; rr: roulette).",
        soft_wrap=True,
    )
    _print_machine(measured["machine"])
    return 0


@bench.command
def scaling(
    *,
    axis: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    runs: Integer = 5,
    threads: Annotated[int | None, _whole] = None,
    out: Path = Path("out"),
    json_: Annotated[Json, Parameter(name="--json")] = False,
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
    json_
        Print them on standard output.
    """
    from reports.bench import scaling as bench_scaling

    measured = _measured(
        out / "bench",
        "scaling",
        lambda report: bench_scaling.measure(
            axes=tuple(axis or ()), runs=runs, threads=threads, report=report
        ),
    )
    if json_:
        print(json.dumps(measured))
        return 0
    table = Table("axis", "value", "seconds", "spread", "ns each", "MB", box=None, pad_edge=False)
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
    _output.print(table)
    for case in measured["cases"]:
        if "of_processes" in case:
            _output.print(
                f"{case['value']} threads reach {case['of_processes']:.2f} "
                f"({case['of_processes_low']:.2f}-{case['of_processes_high']:.2f}) of as many processes."
            )
    _print_machine(measured["machine"])
    return 0


@bench.command
def economies(
    *,
    scene: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    economy: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    resolution: Integer = 48,
    batches: Integer = 4,
    threads: Annotated[int | None, _whole] = None,
    out: Path = Path("out"),
    json_: Annotated[Json, Parameter(name="--json")] = False,
) -> int:
    """Measure what each economy is worth at equal error, and that it shifts no mean.

    Parameters
    ----------
    scene
        two_cubes, cornell_box, cornell_box_unshadowed, monkey; all if none.
    economy
        aimed, roulette, adaptive; all if none.
    resolution
        Pixels of a side of the square image.
    batches
        Of 8 replicates each way; the median of their ratios counts.
    threads
        Threads; one per core if not given.
    out
        The numbers go to OUT/bench/economies.json.
    json_
        Print them on standard output.
    """
    from reports.bench import economies as bench_economies

    measured = _measured(
        out / "bench",
        "economies",
        lambda report: bench_economies.measure(
            scenes=tuple(scene or ()),
            economies=tuple(economy or ()),
            resolution=resolution,
            batches=batches,
            threads=threads,
            report=report,
        ),
    )
    failed = [case for case in measured["cases"] if case["verdict"] in _PROVEN]
    if json_:
        print(json.dumps(measured))
        return 1 if failed else 0
    for name in dict.fromkeys(case["scene"] for case in measured["cases"]):
        # 80 columns hold it: what is not a terminal has no more.
        columns = ("economy", "term", "variant", "variance", "seconds", "cost", "spread", "verdict")
        table = Table(
            *columns,
            title=f"\n[bold]{name}",
            title_justify="left",
            box=None,
            padding=(0, 1, 0, 0),
            pad_edge=False,
        )
        for case in measured["cases"]:
            if case["scene"] == name:
                table.add_row(
                    case["economy"],
                    case["term"],
                    case["variant"],
                    f"{case['variance']:.2f}",
                    f"{case['seconds']:.2f}",
                    f"{case['cost']:.2f}",
                    f"{case['cost_low']:.2f}-{case['cost_high']:.2f}",
                    case["verdict"],
                )
        _output.print(table)
    _output.print(
        "With the economy over without it: variance, processor seconds, and their product, which is what equal error "
        "costs; below 1 is a gain. The verdict compares the means.",
        soft_wrap=True,
    )
    _print_machine(measured["machine"])
    return 1 if failed else 0


@bench.command(name="view")
def bench_view(
    *,
    scene: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    changes: Integer = 30,
    resolution: Integer = 256,
    threads: Annotated[int | None, _whole] = None,
    out: Path = Path("out"),
    json_: Annotated[Json, Parameter(name="--json")] = False,
) -> int:
    """Measure how long a changed input takes to be seen on the page of `termwise view`.

    Parameters
    ----------
    scene
        two_cubes, cornell_box, cornell_box_unshadowed, monkey; all if none.
    changes
        Of each input; their median counts.
    resolution
        Pixels of a side of the square image.
    threads
        Threads; one per core if not given.
    out
        The numbers go to OUT/bench/view.json.
    json_
        Print them on standard output.
    """
    from reports.bench import view as of_view

    measured = _measured(
        out / "bench",
        "view",
        lambda report: of_view.measure(
            scenes=tuple(scene or ()),
            changes=changes,
            resolution=resolution,
            threads=threads,
            report=report,
        ),
        charted=False,
    )
    if json_:
        print(json.dumps(measured))
        return 0
    columns = ("scene", "input", "seconds", "spread", "previews")
    table = Table(*columns, box=None, padding=(0, 1, 0, 0), pad_edge=False)
    for case in measured["cases"]:
        table.add_row(
            case["scene"],
            case["input"],
            f"{case['seconds']:.3f}",
            f"{case['seconds_low']:.3f}-{case['seconds_high']:.3f}",
            f"{case['previews']} of {case['changes']}",
        )
    _output.print(table)
    before, after = measured["memory_mb"]
    _output.print(
        f"From a change to the first picture, {resolution} x {resolution} pixels; a preview has a quarter of them. "
        f"Memory {before:.0f} MB after the first change, {after:.0f} MB after the last.",
        soft_wrap=True,
    )
    _print_machine(measured["machine"])
    return 0


def _measured(
    folder: Path,
    name: str,
    measure: Callable[[Callable[[str, int, int], None]], dict[str, Any]],
    *,
    charted: bool = True,
) -> dict[str, Any]:
    """Run a benchmark under a bar of progress; its numbers go to the folder and, `charted`, onto its page."""
    from reports.page import bench as page

    _folder(folder)
    with _progress() as bar:
        task = bar.add_task("starting", total=None)

        def report(what: str, done: int, total: int) -> None:
            bar.update(task, description=what, completed=done, total=total)

        measured = measure(report)
    measured["command"] = " ".join(["termwise", *sys.argv[1:]])
    (folder / f"{name}.json").write_text(json.dumps(measured, indent=1), "utf-8")
    if charted:
        page.write(folder)
    return measured


def _print_machine(machine: dict[str, Any]) -> None:
    _output.print(f"{machine['processor']}, {machine['threads']} threads, load {machine['load']:.1f}")


def main() -> None:
    """Run the command; every foreseeable fault is one line on standard error and exit status 2."""
    from reference.backend import BackendError

    try:
        status = app(sys.argv[1:], exit_on_error=False)
    except cyclopts.CycloptsError:
        status = 2  # already printed, in one line
    except KeyboardInterrupt:
        _fail("interrupted: finished replicates are kept, the same command goes on from there")
        status = 2
    except OSError as error:
        # NumPy says how much of an array it wrote, without a file or a number for the error.
        why = error.strerror or f"a file was cut short ({error}): is the disk full?"
        _fail(f"{error.filename or 'writing'}: {why}")
        status = 2
    except (ValueError, BackendError) as error:
        _fail(str(error))
        status = 2
    sys.exit(status)


def _fail(message: str) -> None:
    print(f"termwise: {' '.join(message.split())}", file=sys.stderr)


def _choose_backend(requested: str | None) -> str:
    from reference import backend

    return backend.choose(requested).variant


def _scene(name: str, resolution: tuple[int, int] | None) -> Any:
    scene = load(name)
    return scene if resolution is None else attrs.evolve(scene, resolution=resolution)


def _check_seed(seed: int) -> None:
    if not 0 <= seed < 2**31:
        raise ValueError(f"seed = {seed}: allowed is an integer in [0, {2**31 - 1}]")


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


def _folder(path: Path) -> Path:
    """Make a folder for results before the work starts that is to go there."""
    path.mkdir(parents=True, exist_ok=True)
    return path


def _read(path: Path, part: str | None) -> np.ndarray:
    from reports.images import read_exr

    if not path.is_file():
        found = "is a folder" if path.is_dir() else "no such file"
        raise ValueError(f"{path}: {found}: allowed are OpenEXR images")
    parts = read_exr(path)
    if part is None and len(parts) == 1:
        return next(iter(parts.values()))
    if part not in parts:
        raise ValueError(f"{path}: part = {part!r}: allowed are {', '.join(map(repr, parts))}")
    return parts[part]


def _write_images(
    scene: Any, found: dict[str, Any], folder: Path, settings: dict[str, Any], as_json: bool
) -> int:
    """Write term images and their sum; report means and seconds."""
    from reports.images import write_exr
    from reports.page.pictures import write_png
    from scenes.terms import total

    parts = {term: image.mean for term, image in found.items()}
    if len(parts) == len(TERMS):
        parts["total"] = total(*(parts[term] for term in TERMS))
    shown = "total" if "total" in parts else next(iter(parts))
    exr, png = folder / f"{scene.name}.exr", folder / f"{scene.name}.{shown}.png"
    header = {
        "software": "termwise",
        "scene": scene.name,
        "digest": scene.digest(),
        "settings": json.dumps(settings),
    }
    write_exr(exr, parts, header)
    write_png(png, parts[shown], exposure=scene.exposure)
    rows = {
        term: {"mean": image.mean.mean(axis=(0, 1)).tolist(), "seconds": image.seconds}
        for term, image in found.items()
    }
    if as_json:
        print(
            json.dumps(
                {"scene": scene.name, "settings": settings, "terms": rows, "files": [str(exr), str(png)]}
            )
        )
        return 0
    table = Table("term", "mean radiance (R, G, B)", "seconds")
    for term, row in rows.items():
        table.add_row(term, "  ".join(f"{x:.6f}" for x in row["mean"]), f"{row['seconds']:.2f}")
    _output.print(table)
    _output.print(f"{exr}\n{png}", soft_wrap=True, highlight=False)
    return 0


def _progress() -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=_messages,
        transient=True,
        disable=not _messages.is_terminal,
    )


_PROVEN = ("BIASED", "NOT AS PREDICTED", "NO VERDICT")
_COLOURS = {"EQUIVALENT": "green", "AS PREDICTED": "green"} | dict.fromkeys(_PROVEN, "red")


def _print_results(results: dict[str, Any]) -> None:
    judged = [row for row in results["cells"] if row["verdict"] is not None]
    for scene in results["settings"]["scenes"]:
        # 80 columns hold it: what is not a terminal has no more.
        columns = ("term", "variant", "bias [90 %] in %", "RMSE", "SSIM", "s", "verdict")
        title = f"\n[bold]{scene}"
        table = Table(
            *columns, title=title, title_justify="left", box=None, padding=(0, 1, 0, 0), pad_edge=False
        )
        for row in judged:
            if row["scene"] != scene:
                continue
            absent = row["verdict"] == "ABSENT"
            low, high = 100 * row["bias_low"], 100 * row["bias_high"]
            colour = _COLOURS.get(row["verdict"], "dim" if absent else "yellow")
            table.add_row(
                row["term"],
                row["variant"],
                "" if absent else f"{100 * row['bias']:+.2f} \\[{low:+.2f}, {high:+.2f}]",
                "" if absent else f"{row['rmse']:.3g}",
                "" if absent or row["ssim"] is None else f"{row['ssim']:.3f}",
                f"{row['seconds']:.1f}",
                f"[{colour}]{row['verdict']}[/{colour}]",
            )
        _output.print(table)
    known = [row for row in judged if row.get("group")]
    for group in dict.fromkeys(row["group"] for row in known):
        words = [row["verdict"] for row in known if row["group"] == group]
        counts = ", ".join(f"{words.count(word)} {word}" for word in dict.fromkeys(words))
        _output.print(f"\n[bold]{group}[/bold], its answer known: {counts}", highlight=False)
    for row in judged:
        if row["verdict"] in _PROVEN or (row["verdict"] == "UNDERPOWERED" and not row.get("group")):
            where = f"{row['scene']}: {row['term']} {row['variant']}"
            _output.print(f"{where}: {row['sentence']}", highlight=False, soft_wrap=True)
