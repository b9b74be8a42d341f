"""termwise: compare, diff, figure, judge, inspect, replay, render, reference, plan, scenes, view, bench and stress.

Exit status 0: ran; 1: an error was proven (BIASED or NOT AS PREDICTED against `own`; of `diff`, something became
worse; of `stress`, a row failed); 2: bad input, or a run, or one of its scenes, that could not end. With --json one
object goes to standard output, all else to standard error.
"""

import functools
import importlib.metadata
import json
import re
import runpy
import shlex
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import attrs
import cyclopts
import numpy as np
from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from reports import progress
from reports.progress import Report
from scenes.load import library, load
from scenes.store import write_atomically
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


def _duration(_kind: Any, tokens: Any) -> float:
    """Seconds of `90`, `90s`, `2m` or `1h`."""
    found = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+)([smh]?)", tokens[0].value)
    seconds = float(found[1]) * {"": 1, "s": 1, "m": 60, "h": 3600}[found[2]] if found else 0.0
    if not 0.0 < seconds < float("inf"):
        raise ValueError(f"{tokens[0].value!r}: allowed is a time above 0 such as 90, 90s, 2m or 1h")
    return seconds


_whole = Parameter(converter=_integer, n_tokens=1)
Integer = Annotated[int, _whole]
bench = cyclopts.App(name="bench", help="Measure speed beside Mitsuba's, both in one run.")
app.command(bench)

Json = Annotated[bool, Parameter(negative="", help="One JSON object on standard output.")]
Quiet = Annotated[bool, Parameter(negative="", help="No progress on standard error.")]


@app.command
def compare(
    *scenes: str,
    study: str = "standard",
    budget: Annotated[float | None, Parameter(converter=_duration, n_tokens=1)] = None,
    seed: Annotated[int | None, _whole] = None,
    estimators: Path | None = None,
    out: Path = Path("out"),
    backend: str | None = None,
    quiet: Quiet = False,
    single_file: Annotated[bool, Parameter(negative="")] = False,
    json_: Annotated[Json, Parameter(name="--json")] = False,
) -> int:
    """Render scenes with ours and with Mitsuba, judge every term, write the report.

    Parameters
    ----------
    scenes
        Names of the library or paths of scene files; all scenes of the study if none.
    study
        quick, standard, full, or the path of a study file.
    budget
        Seconds of rendering (90, 90s, 2m, 1h), ours and Mitsuba's together: rows that the study leaves undecided get
        2, 4, 8 times its replicates, until they are decided or the budget is spent.
    seed
        Instead of the study's: the whole run again with other random numbers.
    estimators
        A Python file that calls `termwise.register`: what it registers is measured too.
    out
        The report goes to OUT/compare, or to the folder that the study names.
    backend
        Mitsuba variant: llvm_ad_rgb, scalar_rgb or cuda_ad_rgb; chosen by itself if not given.
    quiet
        No progress on standard error.
    single_file
        Write report.html too: all pages in one file, to mail.
    json_
        Print results.json on standard output; no progress.
    """
    from reports import page, run, subjects
    from reports import study as studies

    mitsuba = _choose_backend(backend)
    if estimators is not None:
        _run_file(estimators)
    chosen = studies.with_registered(studies.load(study))
    if budget is not None:
        chosen = attrs.evolve(chosen, budget=budget)
    if seed is not None:
        chosen = attrs.evolve(chosen, seed=seed)
    prepared = subjects.scenes_of(chosen, scenes)
    folder = _folder(out / chosen.folder)
    try:
        results = run.finished(folder, run.digest(chosen, prepared, mitsuba))
    except ValueError as error:
        _messages.print(f"termwise: {error}; it is written again", highlight=False, markup=False)
        results = None
    if results is None:
        with progress.stages(_messages, quiet=quiet or json_) as stage:
            named = {
                scene.name: given for scene, given in zip(prepared, scenes or chosen.scenes, strict=True)
            }
            results = run.measure(
                chosen,
                prepared,
                folder,
                name=Path(study).stem,
                report=stage("Measuring"),
                arguments={"study": study, "scenes": named},
            )
            page.write(folder, report=stage("Pages"))
    elif not quiet:
        _messages.print("Nothing has changed since the last run: no cell was computed.")
    index = folder / "index.html"
    if single_file:
        from reports.page import single

        index = single.write(folder)
    if json_:
        print(json.dumps(results))
    else:
        _print_results(results)
        _output.print(f"\nReport: {index.resolve()}", soft_wrap=True)
    for each in results["failed"]:
        _fail(f"{each['scene']}: failed, and stands in no row: {each['error']}")
    if results["failed"]:
        return 2
    return 1 if run.failures(results) else 0


def _run_file(path: Path) -> None:
    """Execute a Python file of the user's."""
    if not path.is_file():
        raise FileError(f"{path}: no such file: allowed is a Python file that calls termwise.register")
    runpy.run_path(str(path), run_name=path.stem)


@app.command
def diff(
    run_a: Path,
    run_b: Path,
    *,
    out: Path = Path("out"),
    json_: Annotated[Json, Parameter(name="--json")] = False,
) -> int:
    """Say what changed from one run to another in verdict, bias, error and time, with a test before "worse" is said.

    Parameters
    ----------
    run_a
        The folder of a finished run: what was before.
    run_b
        Another: what is now.
    out
        The page goes to OUT/diff.
    json_
        Print the differences as JSON on standard output.
    """
    from reports import stored
    from reports.diff import diff as compared
    from reports.page import diff as page

    found = compared(stored.read(run_a), stored.read(run_b)) | {
        "runs": [str(run_a), str(run_b)],
        "command": _command(),
    }
    folder = _folder(out / "diff")
    index = page.write(found, folder)
    if json_:
        print(json.dumps(found))
    else:
        _print_diff(found)
        _output.print(f"\nReport: {index.resolve()}", soft_wrap=True)
    return 1 if found["any_worse"] else 0


@app.command
def figure(
    run: Path,
    *,
    scene: str,
    term: str,
    kind: Literal["convergence", "waterfall"] = "convergence",
    out: Path,
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
    from reports import figure as figures
    from reports import stored

    figures.write(stored.read(run), scene=scene, term=term, kind=kind, path=out)
    _output.print(str(out), soft_wrap=True, highlight=False)
    return 0


@app.command
def judge(
    *images: Path,
    reference: Annotated[list[Path], Parameter(consume_multiple=True)],
    reference_exact: Annotated[bool, Parameter(negative="")] = False,
    noiseless: Annotated[bool, Parameter(negative="")] = False,
    part: str | None = None,
    exposure: float | None = None,
    out: Path = Path("out"),
    json_: Annotated[Json, Parameter(name="--json")] = False,
) -> int:
    """Judge any renderer's replicate images against replicates of a reference, and write a page about it.

    Parameters
    ----------
    images
        OpenEXR replicates of one image (equal settings, different seeds), or folders of them. At least 4, better 16.
    reference
        Replicates of the reference, files or folders.
    reference_exact
        The one reference image has no noise.
    noiseless
        The renderer has no noise: its replicates may all be the same image.
    part
        Name of the part to read where a file has several.
    exposure
        Factor on the radiance in the pictures; by default the reference's mean is shown as middle grey.
    out
        Page, numbers and images go to OUT/judge.
    json_
        Print the verdict as JSON on standard output.
    """
    from reports import judging
    from reports.page import judge as page

    files = {name: _files(name, given) for name, given in (("images", images), ("reference", reference))}
    stacks = {name: [_read(path, part) for path in found] for name, found in files.items()}
    folder = _folder(out / "judge")
    outcome = judging.judge(
        stacks["images"],
        stacks["reference"],
        folder,
        exact=reference_exact,
        noiseless=noiseless,
        names=[str(path) for path in files["images"]],
        reference_names=[str(path) for path in files["reference"]],
        exposure=exposure,
        command=_command(),
    )["verdict"]
    index = page.write(folder)
    for warning in outcome["warnings"]:
        _messages.print(f"termwise: {warning}", soft_wrap=True, highlight=False)
    if json_:
        print(json.dumps(outcome | {"page": str(index)}))
        return 1 if outcome["verdict"] == "BIASED" else 0
    _output.print(f"[bold]{outcome['verdict']}[/bold]", highlight=False)
    _output.print(outcome["sentence"], highlight=False, soft_wrap=True)
    for reason in outcome["reasons"]:
        _output.print(f"- {reason}", highlight=False, soft_wrap=True)
    for size in outcome["tiles"]:
        _output.print(_of_tiles(size), highlight=False, soft_wrap=True)
    _output.print(f"\nReport: {index.resolve()}", highlight=False, soft_wrap=True)
    return 1 if outcome["verdict"] == "BIASED" else 0


def _files(name: str, given: Sequence[Path]) -> list[Path]:
    """The files named, and those of the folders named."""
    if not given:
        raise ValueError(f"{name}: none given: allowed are OpenEXR files, or folders of them")
    found = []
    for path in given:
        inside = sorted(path.glob("*.exr")) if path.is_dir() else [path]
        if not inside:
            raise ValueError(f"{path}: holds no .exr file: allowed are folders of OpenEXR replicates")
        found += inside
    return found


def _of_tiles(size: dict[str, Any]) -> str:
    """What the tests of one size of tiles found, in a line."""
    what = f"tiles of {size['side']} px"
    if size["merged_into"] is not None:
        return (
            f"{what}: merged into those of {size['merged_into']} px (median skewness {size['skewness']:.2f})"
        )
    found = f"{size['holm']} of {size['tested']} found by Holm, {size['benjamini_hochberg']} by Benjamini-Hochberg"
    text = f"{what}: {found}"
    return text if size["uniform_p"] is None else f"{text}; p is uniform with p = {size['uniform_p']:.2g}"


@app.command
def inspect(
    folder: Path,
    *,
    scene: str | None = None,
    term: str | None = None,
    variant: str | None = None,
    object_: Annotated[str | None, Parameter(name="--object")] = None,
    tile: tuple[int, int] | None = None,
    x: Annotated[int | None, _whole] = None,
    y: Annotated[int | None, _whole] = None,
    json_: Annotated[Json, Parameter(name="--json")] = False,
) -> int:
    """Look into a finished run: image, term, object, tile, pixel; opens where the bias is.

    Parameters
    ----------
    folder
        What `compare` wrote, say out/compare.
    scene
        Only rows of this scene.
    term
        Only rows of this term, or "total".
    variant
        Only rows of this variant.
    object_
        Open this object; the most suspect if not given.
    tile
        Open the tile of 8 pixels that holds the pixel X Y.
    x
        Open the pixel of this column; needs Y.
    y
        Its row.
    json_
        Print the branch as JSON on standard output.
    """
    from reports import microscope
    from reports.run import plain

    if (x is None) != (y is None):
        raise ValueError(f"{'x' if x is None else 'y'}: is missing: allowed are both x and y, or none")
    opened = microscope.open_run(folder)
    rows = opened.judged(scene, term, variant)
    row = rows[0]
    try:
        found = microscope.branch(
            opened.group(row["scene"]),
            row["term"],
            row["variant"],
            object=object_,
            tile=tile,
            pixel=None if x is None or y is None else (x, y),
        )
    except ValueError as error:
        raise ValueError(f"{row['scene']}, {row['term']} {row['variant']}: {error}") from None
    command = None if found.replicate is None else opened.replay(row, found)
    if json_:
        identity = {name: row[name] for name in ("scene", "term", "variant", "verdict", "sentence")}
        print(json.dumps(plain(identity | attrs.asdict(found) | {"replay": command})))
        return 0
    _print_branch(rows, found)
    if command is not None:
        _output.print(command, highlight=False, soft_wrap=True, markup=False)
    return 0


@app.command
def replay(
    *,
    scene: str,
    term: str,
    variant: str | None = None,
    x: Integer,
    y: Integer,
    replicate: Integer,
    study: str = "standard",
    samples: Annotated[int | None, _whole] = None,
    seed: Annotated[int | None, _whole] = None,
    results: Path | None = None,
    json_: Annotated[Json, Parameter(name="--json")] = False,
) -> int:
    """Compute one pixel of one replicate of a study again, and print what happens in each of its samples.

    Parameters
    ----------
    scene
        A scene as the study has it: a name of the library, the path of a scene file, or SCENE.SETTING.
    term
        ambient, direct, specular or background.
    variant
        An estimator of the term; its default if not given.
    x
        The pixel's column, from 0 at the left.
    y
        Its row, from 0 at the top.
    replicate
        Number of the replicate, from 0.
    study
        quick, standard, full, or the path of a study file; it says resolution, photons, samples and seed.
    samples
        Samples per pixel, instead of the study's.
    seed
        Instead of the study's.
    results
        Folder of a run: the value is held against the one stored there. Exit status 1 where they differ.
    json_
        Print all samples as JSON on standard output.
    """
    from renderer.replay import replay as replayed
    from renderer.terms import find
    from reports import microscope, subjects
    from reports import study as studies
    from reports.run import plain

    estimator = find(term, variant)
    chosen = studies.load(study)
    subject, count = subjects.named(chosen, scene, estimator)
    if not 0 <= replicate < chosen.replicates:
        allowed = f"an integer in [0, {chosen.replicates - 1}], those of the study {study}"
        raise ValueError(f"replicate = {replicate}: allowed is {allowed}")
    if seed is not None:
        _check_seed(seed)
    kept = None
    if results is not None:
        kept, image = microscope.rendered(
            microscope.open_run(results).group(subject.scene.name), estimator.term, estimator.name
        )
        if replicate != kept:
            raise ValueError(
                f"replicate = {replicate}: allowed is {kept}, the one that {results} stores whole"
            )
        height, width = image.shape[:2]
        if (width, height) != subject.scene.resolution:
            raise ValueError(
                f"{results}: is of {width} x {height} pixels: allowed is a run of the study {study}, of "
                f"{' x '.join(map(str, subject.scene.resolution))}"
            )
    found = replayed(
        subject.scene,
        estimator,
        x=x,
        y=y,
        samples=count if samples is None else samples,
        seed=chosen.seed if seed is None else seed,
        replicate=replicate,
        chain=subject.chain,
    )
    stored = None if kept is None else image[y, x]
    same = None if stored is None else found.value.tobytes() == stored.tobytes()
    if json_:
        described = {
            "scene": subject.scene.name,
            "term": estimator.term,
            "variant": estimator.name,
            "x": x,
            "y": y,
            "replicate": replicate,
            "value": found.value.tolist(),
            "skipped": found.skipped,
            "stored": None if stored is None else stored.tolist(),
            "equals_stored": same,
            "samples": [
                attrs.asdict(sample) | {"radiance": sample.radiance.tolist()} for sample in found.samples
            ],
        }
        print(json.dumps(plain(described)))
    else:
        _print_replay(found)
        if same is not None:
            word = (
                "equal to the bit"
                if same
                else f"NOT equal: {_numbers(stored)}; other sources, seed or samples?"
            )
            _output.print(f"stored in {results}: {word}", highlight=False, soft_wrap=True)
    if found.astray:
        _messages.print(
            f"termwise: the trace of samples {', '.join(map(str, found.astray))} took another way than the kernel",
            highlight=False,
        )
    return 1 if same is False else 0


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
    table = _table("term", "work", "", "why", "saved")
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
    quiet: Quiet = False,
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
    quiet
        No progress on standard error.
    json_
        Print them on standard output.
    """
    from reports.bench import rays as bench_rays
    from reports.page import bench as page

    measured = _measured(
        out / "bench",
        "rays",
        lambda report: bench_rays.measure(
            threads=threads, pairs=pairs, count=count, only=tuple(mesh or ()), report=report
        ),
        page.write,
        quiet=quiet or json_,
    )
    if json_:
        print(json.dumps(measured))
        return 0
    columns = ("mesh", "triangles", "rays", "ours", "Mitsuba", "ratio", "spread", "by CPU", "default")
    table = _table(*columns)
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
    quiet: Quiet = False,
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
    quiet
        No progress on standard error.
    json_
        Print them on standard output.
    """
    from reports.bench import terms as bench_terms
    from reports.page import bench as page

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
        page.write,
        quiet=quiet or json_,
    )
    if json_:
        print(json.dumps(measured))
        return 0
    for name in dict.fromkeys(case["scene"] for case in measured["cases"]):
        columns = ("term", "variant", "RMSE", "ours", "Mitsuba", "times", "spread", "its setting")
        table = _table(*columns, title=name)
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
    quiet: Quiet = False,
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
    quiet
        No progress on standard error.
    json_
        Print them on standard output.
    """
    from reports.bench import scaling as bench_scaling
    from reports.page import bench as page

    measured = _measured(
        out / "bench",
        "scaling",
        lambda report: bench_scaling.measure(
            axes=tuple(axis or ()), runs=runs, threads=threads, report=report
        ),
        page.write,
        quiet=quiet or json_,
    )
    if json_:
        print(json.dumps(measured))
        return 0
    table = _table("axis", "value", "seconds", "spread", "ns each", "MB")
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
    quiet: Quiet = False,
    json_: Annotated[Json, Parameter(name="--json")] = False,
) -> int:
    """Measure what each economy is worth at equal error, and that it shifts no mean.

    Parameters
    ----------
    scene
        two_cubes, cornell_box, cornell_box_unshadowed, monkey; all if none.
    economy
        aimed, lights, roulette, adaptive; all if none.
    resolution
        Pixels of a side of the square image.
    batches
        Of 8 replicates each way; the median of their ratios counts.
    threads
        Threads; one per core if not given.
    out
        The numbers go to OUT/bench/economies.json.
    quiet
        No progress on standard error.
    json_
        Print them on standard output.
    """
    from reports.bench import economies as bench_economies
    from reports.page import bench as page

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
        page.write,
        quiet=quiet or json_,
    )
    failed = [case for case in measured["cases"] if case["verdict"] in _PROVEN]
    if json_:
        print(json.dumps(measured))
        return 1 if failed else 0
    for name in dict.fromkeys(case["scene"] for case in measured["cases"]):
        columns = ("economy", "term", "variant", "variance", "seconds", "cost", "spread", "verdict")
        table = _table(*columns, title=name)
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
    memory_changes: Integer = 1000,
    resolution: Integer = 256,
    threads: Annotated[int | None, _whole] = None,
    out: Path = Path("out"),
    quiet: Quiet = False,
    json_: Annotated[Json, Parameter(name="--json")] = False,
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
    from reports.bench import view as of_view
    from reports.page import bench as page

    measured = _measured(
        out / "bench",
        "view",
        lambda report: of_view.measure(
            scenes=tuple(scene or ()),
            changes=changes,
            memory_changes=memory_changes,
            resolution=resolution,
            threads=threads,
            report=report,
        ),
        page.write,
        quiet=quiet or json_,
    )
    if json_:
        print(json.dumps(measured))
        return 0
    columns = ("scene", "input", "seconds", "spread", "processor", "previews")
    table = Table(*columns, box=None, padding=(0, 1, 0, 0), pad_edge=False)
    for case in measured["cases"]:
        table.add_row(
            case["scene"],
            case["input"],
            f"{case['seconds']:.3f}",
            f"{case['seconds_low']:.3f}-{case['seconds_high']:.3f}",
            f"{case['processor']:.3f}",
            f"{case['previews']} of {case['changes']}",
        )
    _output.print(table)
    memory = measured["memory"]
    said = " and ".join(
        f"{megabytes:.0f} MB after {count}"
        for count, megabytes in zip(memory["changes"], memory["megabytes"], strict=True)
    )
    _output.print(
        f"From a change to the first picture, {resolution} x {resolution} pixels; a preview has a quarter of them. "
        f"Processor: seconds of all threads, which other work on the machine hardly changes. "
        f"Memory: {said} changes of {memory['scene']}.",
        soft_wrap=True,
    )
    _print_machine(measured["machine"])
    return 0


@app.command
def stress(
    *,
    group: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    case: str = "",
    count: Integer = 4096,
    out: Path = Path("out"),
    quiet: Quiet = False,
    json_: Annotated[Json, Parameter(name="--json")] = False,
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
    from reports import stress as lab
    from reports.page import stress as page

    measured = _measured(
        out / "stress",
        "stress",
        lambda report: lab.measure(groups=tuple(group or ()), case=case, count=count, report=report),
        page.write,
        quiet=quiet or json_,
    )
    status = 1 if measured["failed"] else 0
    if json_:
        print(json.dumps(measured, allow_nan=False))
        return status
    _print_stress(measured)
    return status


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
        _output.print(table)
    for case in measured["cases"]:
        if not case["passed"]:
            why = case["faults"].get(
                "ours", f"{case['figure']}: {shown(case['ours'])} > {shown(case['limit'])}"
            )
            _output.print(
                f"{case['group']}: {case['name']}: {why}", highlight=False, soft_wrap=True, markup=False
            )
    _output.print(
        f"{len(measured['cases'])} rows in {measured['seconds']:.0f} s, {measured['failed']} failed",
        highlight=False,
    )


def _measured(
    folder: Path,
    name: str,
    measure: Callable[[Report], dict[str, Any]],
    write: Callable[[Path], Path],
    *,
    quiet: bool,
) -> dict[str, Any]:
    """Measure and show the progress; the numbers go to the folder with the command, and onto its page."""
    _folder(folder)
    with progress.stages(_messages, quiet=quiet) as stage:
        measured = measure(stage(name.capitalize()))
    measured["command"] = _command()
    text = json.dumps(measured, indent=1)
    write_atomically(folder / f"{name}.json", lambda path: path.write_text(text, "utf-8"))
    write(folder)
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


def _scene(name: str, resolution: tuple[int, int] | None) -> Any:
    scene = load(name)
    return scene if resolution is None else attrs.evolve(scene, resolution=resolution)


def _check_seed(seed: int) -> None:
    if not 0 <= seed < 2**31:
        raise ValueError(f"seed = {seed}: allowed is an integer in [0, {2**31 - 1}]")


def _folder(path: Path) -> Path:
    """Make a folder for results before the work starts that is to go there."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (NotADirectoryError, FileExistsError):
        raise ValueError(
            f"out = {path}: is a file, or lies in one: allowed is a folder, old or new"
        ) from None
    return path


def _read(path: Path, part: str | None) -> np.ndarray:
    from reports.images import read_exr

    if not path.is_file():
        raise ValueError(f"{path}: no such file: allowed are OpenEXR images")
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


def _table(*columns: str, title: str | None = None) -> Table:
    """A table without lines, narrow enough for 80 columns: what is not a terminal has no more."""
    heading = None if title is None else f"\n[bold]{title}"
    return Table(
        *columns, title=heading, title_justify="left", box=None, padding=(0, 1, 0, 0), pad_edge=False
    )


def _command() -> str:
    """What was typed, fit to be typed again."""
    return shlex.join(["termwise", *sys.argv[1:]])


_FINDINGS = {"worse": "red", "better": "green", "changed": "yellow"}


def _print_diff(found: dict[str, Any]) -> None:
    """Differences of settings, then what is proven, then every row."""
    say = functools.partial(_output.print, highlight=False, soft_wrap=True)
    for each in found["settings"]:
        say(f"{each['name']}: {_plain(each['before'])} -> {_plain(each['after'])}", markup=False)
    if not found["settings"]:
        say("Settings: the same.")
    for each in found["failed"]:
        was = "failed before too" if each["before"] and each["after"] else "failed"
        say(
            f"{each['scene']}: {was if each['after'] else 'failed before'}: {each['after'] or each['before']}"
        )
    for scene in dict.fromkeys(row["scene"] for row in found["rows"]):
        table = _table("term", "variant", "bias", "RMSE", "time", "verdict", title=scene)
        for row in found["rows"]:
            if row["scene"] == scene:
                changes = [_change(name, row[name]) for name in ("bias", "error", "time")]
                table.add_row(row["term"], row["variant"], *changes, _verdicts(row["verdict"]))
        _output.print(table)
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
    from reports.diff import said

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


_SHOWN_PLACES, _SHOWN_ROWS = 4, 6


def _print_branch(rows: list[dict[str, Any]], found: Any) -> None:
    """A tree: the rows, worst first, and the branch of the first of them."""
    from rich.text import Text
    from rich.tree import Tree

    def label(name: str, place: Any) -> Text:
        size = f", {place.pixels} pixels" if place.pixels > 1 else ""
        interval = f"[{100 * place.low:+.2f}, {100 * place.high:+.2f}]"
        return Text(f"{name}{size}: {100 * place.bias:+.2f} % {interval}  z = {place.z:+.1f}")

    row = rows[0]
    tree = Tree(Text(f"{row['scene']}: bias [90 %], z of luminance", "bold"))
    opened = tree.add(
        Text(f"{row['term']} {row['variant']}: {row['verdict']}", _COLOURS.get(row["verdict"], ""))
    )
    at = opened.add(label("image", found.image))
    for level, chosen, places in (
        ("object ", found.object, found.objects),
        ("", found.tile, found.tiles),
        ("", found.at, found.pixels),
    ):
        others = [place for place in places if place is not chosen]
        inner = at.add(label(level + chosen.name, chosen))
        for place in others[: _SHOWN_PLACES - 1]:
            at.add(label(level + place.name, place))
        if len(others) >= _SHOWN_PLACES:
            at.add(Text(f"{len(others) - _SHOWN_PLACES + 1} more", "dim"))
        at = inner
    at.add(Text(f"mean {_numbers(found.ours)}  reference {_numbers(found.reference)}"))
    if found.value is not None:
        at.add(Text(f"replicate {found.replicate}: {_numbers(found.value)}"))
    for other in rows[1:_SHOWN_ROWS]:
        where = "" if other["scene"] == row["scene"] else f"{other['scene']}: "
        bias = "" if other["bias"] is None else f", {100 * other['bias']:+.2f} %"
        tree.add(Text(f"{where}{other['term']} {other['variant']}: {other['verdict']}{bias}"))
    if len(rows) > _SHOWN_ROWS:
        tree.add(Text(f"{len(rows) - _SHOWN_ROWS} more rows", "dim"))
    # What is not a terminal has 80 columns, where the numbers would be cut.
    Console(width=max(_output.width, 120)).print(tree)


def _numbers(values: Any) -> str:
    """All digits of numbers, which bits need; truths as words."""
    if isinstance(values, list | tuple | np.ndarray):
        return " ".join(repr(float(value)) for value in values)
    return repr(values) if isinstance(values, float) else str(values)


def _print_replay(found: Any) -> None:
    """Sample by sample what happened, then the pixel."""
    for sample in found.samples:
        _output.print(f"[bold]sample {sample.index}[/bold]")
        for event in sample.events:
            rest = {name: value for name, value in event.items() if name not in ("event", "gathered")}
            line = "  ".join(
                f"{name} {'-' if value is None else _numbers(value)}" for name, value in rest.items()
            )
            _output.print(f"  {event['event']}: {line}", highlight=False, soft_wrap=True, markup=False)
        _output.print(
            f"  radiance {_numbers(sample.radiance)}  (trace: {sample.ulp:.2g} ulp apart)",
            highlight=False,
            soft_wrap=True,
        )
    if found.skipped is not None:
        _output.print(f"no sample: {found.skipped}", highlight=False, soft_wrap=True)
    _output.print(f"pixel {_numbers(found.value)}", highlight=False, soft_wrap=True)


_PROVEN = ("BIASED", "NOT AS PREDICTED", "NO VERDICT")
_COLOURS = {"EQUIVALENT": "green", "AS PREDICTED": "green"} | dict.fromkeys(_PROVEN, "red")


def _print_results(results: dict[str, Any]) -> None:
    judged = [row for row in results["cells"] if row["verdict"] is not None]
    certified = results["settings"]["certified"]
    for scene in results["settings"]["scenes"]:
        columns = ("term", "variant", "bias [90 %] in %", "RMSE", "SSIM", "s", "verdict")
        if certified["budget"] is not None:
            columns = ("term", "variant", "bias [90 %] in %", "K", "ours s", "ref. s", "verdict")
        table = _table(*columns, title=scene)
        for row in judged:
            if row["scene"] != scene:
                continue
            absent = row["verdict"] == "ABSENT"
            low, high = 100 * row["bias_low"], 100 * row["bias_high"]
            colour = _COLOURS.get(row["verdict"], "dim" if absent else "yellow")
            if certified["budget"] is not None:
                numbers = str(row["replicates"]), f"{row['seconds']:.1f}", f"{row['reference_seconds']:.1f}"
            else:
                numbers = (
                    "" if absent else f"{row['rmse']:.3g}",
                    "" if absent or row["ssim"] is None else f"{row['ssim']:.3f}",
                    f"{row['seconds']:.1f}",
                )
            table.add_row(
                row["term"],
                row["variant"],
                "" if absent else f"{100 * row['bias']:+.2f} \\[{low:+.2f}, {high:+.2f}]",
                *numbers,
                f"[{colour}]{row['verdict']}[/{colour}]",
            )
        _output.print(table)
    known = [row for row in judged if row.get("group")]
    for group in dict.fromkeys(row["group"] for row in known):
        words = [row["verdict"] for row in known if row["group"] == group]
        counts = ", ".join(f"{words.count(word)} {word}" for word in dict.fromkeys(words))
        _output.print(f"\n[bold]{group}[/bold], its answer known: {counts}", highlight=False)
    _print_certified(certified)
    for row in judged:
        if row["verdict"] in _PROVEN or (row["verdict"] == "UNDERPOWERED" and not row.get("group")):
            where = f"{row['scene']}: {row['term']} {row['variant']}"
            _output.print(f"{where}: {row['sentence']}", highlight=False, soft_wrap=True)


def _print_certified(certified: dict[str, Any]) -> None:
    """What it took to show that the rows that passed are right."""
    ours, reference = certified["seconds"], certified["reference_seconds"]
    text = (
        f"[bold]{ours + reference:.1f} s to certify |bias| < {certified['margin']:.0%}[/bold] in {certified['rows']} "
        f"of {certified['of']} rows: ours {ours:.1f} s, reference {reference:.1f} s; our kernels compiled in "
        f"{certified['compile_seconds']:.1f} s, apart."
    )
    if certified["budget"] is not None:
        looks = ", ".join(map(str, certified["looks"]))
        text += f" Budget {certified['budget']:g} s: {certified['spent']:.1f} s spent, looks at K = {looks}."
    _output.print(f"\n{text}", highlight=False, soft_wrap=True)
