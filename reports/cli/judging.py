"""The verdict on the images of any renderer: judge."""

import time
from pathlib import Path
from typing import Annotated, Any

import attrs
from cyclopts import Parameter

from termwise.reports import progress
from termwise.reports.cli import terminal
from termwise.reports.cli.engines import OneEngine, Probed, Samples
from termwise.reports.cli.terminal import Approximate, Flag, Integer, Json, MaybeInteger, Resolution
from termwise.reports.judging.gates import Require
from termwise.reports.statistics.verdict import LEVEL, MARGIN


def judge(
    *images: Path,
    reference: Annotated[list[Path] | None, Parameter(consume_multiple=True, negative="")] = None,
    suite: Path | None = None,
    scene: str | None = None,
    engine: OneEngine = None,
    diffuse: Flag = False,
    approximate: Approximate = False,
    resolution: Resolution = None,
    replicates: Integer = 16,
    seed: Integer = 1,
    spp: Samples = None,
    reference_spp: Integer = 64,
    probe: Probed = True,
    require: Require = "unbiased",
    margin: float = MARGIN,
    level: float = LEVEL,
    objects: Path | None = None,
    mask: Path | None = None,
    reference_exact: Flag = False,
    noiseless: Flag = False,
    allow_negative: Flag = False,
    samples: MaybeInteger = None,
    layer: str | None = None,
    reference_layer: str | None = None,
    hints: bool = True,
    exposure: float | None = None,
    junit: Path | None = None,
    markdown: Path | None = None,
    out: Path = Path("out"),
    json_: Json = False,
) -> int:
    """Judge any renderer's replicate images against replicates of a reference, and write a page about it.

    Without --reference, two or more sets of replicates are judged each against each; with --scene Mitsuba renders the
    reference, and with --engine a renderer the images. Exit status: 0 passed; 1 a bias is proven; 2 bad input; 3 with
    --require equivalent, none is proven and equivalence is not shown either.

    Parameters
    ----------
    images
        Replicates of one image (equal settings, different seeds), or folders of them: OpenEXR, NPY, NPZ, PFM, Radiance
        HDR, float TIFF. At least 4, better 16.
    reference
        Replicates of the reference, files or folders; with --suite the folder of the cases' folders.
    suite
        A folder that holds a folder of replicates for each case, as REFERENCE does: one level over all of them.
    scene
        A scene of the library or a scene file, all light of which the images show: its reference is rendered, at the
        images' size, and its objects are known by name.
    diffuse
        Of the scene: every gloss, translucency and transparency is 0.
    resolution
        Of what an engine renders, instead of the scene's.
    replicates
        Of the scene's reference, and of an engine.
    seed
        Of the same.
    reference_spp
        Samples per pixel of the scene's reference.
    require
        What passes: unbiased (no bias is proven) or equivalent (within the margin; too much noise fails).
    margin
        Relative bias of a mean that is equivalent to none.
    level
        Chance of any false BIASED, over all tests of all comparisons.
    objects
        Index image: each object in it is judged on its own too. With --suite also a folder of CASE.*.
    mask
        Image that is 0 where nothing is compared. With --suite also a folder of CASE.*.
    reference_exact
        The one reference image has no noise.
    noiseless
        The renderer has no noise: its replicates may all be the same image.
    allow_negative
        Negative pixels are no error: the pixel filter has negative lobes.
    samples
        Samples per pixel of a replicate: an open verdict then says how many it needs.
    layer
        Name of the layer to read where a file of ours has several of colour: Combined, or ViewLayer.Combined.
    reference_layer
        The same of the reference's files.
    hints
        After BIASED, look for simple causes: a shift, a flip, a factor, with --scene light that ends too soon.
    exposure
        Factor on the radiance in the pictures; by default the reference's mean is shown as middle grey.
    junit
        File for a JUnit report, a test case for each comparison.
    markdown
        File for a table of the verdicts.
    out
        Pages, numbers and images go to OUT/judge.
    """
    from termwise.reports.judging import gates
    from termwise.reports.judging import suite as suites
    from termwise.reports.judging.folder import check_exposure

    start = time.perf_counter()
    check_exposure(exposure)
    options: dict[str, Any] = {
        "margin": margin,
        "level": level,
        "exact": reference_exact,
        "noiseless": noiseless,
        "allow_negative": allow_negative,
        "samples": samples,
        "layer": layer,
        "reference_layer": reference_layer,
        "hint": hints,
    }
    if scene is not None and (suite is not None or reference is not None or objects is not None):
        raise ValueError("scene: allowed without --reference, --suite and --objects, whose places it takes")
    if engine is not None and (scene is None or images):
        raise ValueError("engine: allowed is --engine with --scene, and no images")
    many = scene is None and (suite is not None or reference is None)
    if scene is not None:
        places = {} if mask is None else {"mask": mask}
        cases = [
            _of_scene(
                scene,
                images,
                engine,
                diffuse=diffuse,
                approximate=approximate,
                resolution=resolution,
                replicates=replicates,
                seed=seed,
                spp=spp,
                reference_spp=reference_spp,
                probe=probe,
                places=places,
            )
        ]
    elif suite is not None:
        if images or reference is None or len(reference) != 1:
            raise ValueError("suite: allowed is --suite FOLDER --reference FOLDER, and no other images")
        cases = suites.of_folders(suite, reference[0], objects=objects, mask=mask)
    elif not images and reference is not None:
        raise ValueError("images: none given: allowed are images of replicates, or folders of them")
    elif reference is None:
        if len(images) < 2:
            raise ValueError("reference: none given: allowed is --reference, or two and more sets of replicates")
        cases = suites.each_against_each(images, objects=objects, mask=mask)
    else:
        places = {key: path for key, path in (("objects", objects), ("mask", mask)) if path is not None}
        cases = [suites.Case("judge", list(images), reference, places)]
    folder = terminal.folder(out / "judge")
    if many:
        outcomes = suites.judge_all(
            cases, folder, exposure=exposure, command=terminal.command(), say=_progress, **options
        )
    else:
        from termwise.reports.judging.judge import judge as judged

        (case,) = cases
        with progress.stages(terminal.messages, quiet=json_, where=folder) as stage:
            stage("Judging")("images against those of the reference", 0, 1)
            judgement = judged(case.images, case.reference, **(options | case.options))
            judgement = attrs.evolve(judgement, settings=judgement.settings | case.settings)
            stage("Page")("pictures and numbers", 0, 1)
            page = judgement.save(folder, exposure=exposure, command=terminal.command())
        outcomes = [suites.Outcome(" ".join(map(str, images)) or case.name, judgement, page)]
    if junit is not None:
        gates.junit(junit, outcomes, require, seconds=time.perf_counter() - start)
    if markdown is not None:
        gates.markdown(markdown, outcomes, require)
    status = gates.worst(outcomes, require)
    index = folder / "index.html"
    for each in outcomes:
        for warning in each.judgement.warnings:
            terminal.messages.print(
                f"termwise: {f'{each.name}: ' if many else ''}{warning}", soft_wrap=True, highlight=False, markup=False
            )
    if json_:
        found: dict[str, Any] = {"status": status, "require": require, "page": str(index)}
        if many:
            terminal.say_json(found | {"cases": suites.rows(outcomes, folder)})
        else:
            terminal.say_json(outcomes[0].judgement.row() | found)
        return status
    if many:
        say_all(outcomes)
    else:
        _say(outcomes[0].judgement)
    terminal.say(f"\nReport: {index.resolve()}")
    return status


def _of_scene(
    scene: str,
    images: tuple[Path, ...],
    engine: str | None,
    *,
    diffuse: bool,
    approximate: bool,
    resolution: tuple[int, int] | None,
    replicates: int,
    seed: int,
    spp: int | None,
    reference_spp: int,
    probe: bool,
    places: dict[str, Any],
) -> Any:
    """A case against the reference of a scene, which is rendered, as are the images by an engine."""
    from termwise.reports.engines.engine import load
    from termwise.reports.judging import engines
    from termwise.reports.judging.suite import Case
    from termwise.scenes.exchange import neutral
    from termwise.scenes.images import replicates as read

    if engine is None and not images:
        raise ValueError("images: none given: allowed are images of the scene, or --engine")
    if engine is None and resolution is not None:
        raise ValueError("resolution: allowed with --engine alone: that of images is their own")
    described = terminal.scene(scene, resolution, approximate=approximate)
    described = neutral.diffuse(described) if diffuse else described
    terminal.check_seed(seed)
    terminal.choose_backend(None)
    settings: dict[str, Any] = {"scene": described.name}
    if described.substitutions:
        settings["substitutions"] = "; ".join(described.substitutions)
    if engine is not None:
        how = engines.Asking(replicates=engines.enough(replicates), seed=seed, spp=spp, probed=probe)
        subject = load(engine)
        _progress(f"{subject.name} renders {described.name}")
        case = engines.case(subject, described, how)
    else:
        there = read(list(images))
        described = attrs.evolve(described, resolution=there.pixels.shape[2:0:-1])
        case = Case(described.name, list(images), None)
    _progress(f"Mitsuba renders {described.name}")
    truth, found = engines.against(described, spp=reference_spp, seed=seed, replicates=replicates, say=_progress)
    return attrs.evolve(case, reference=truth, options=case.options | found | places, settings=settings | case.settings)


def _progress(text: str) -> None:
    terminal.messages.print(f"termwise: {text}", soft_wrap=True, highlight=False, markup=False)


def _say(judgement: Any) -> None:
    """A line in plain words and the hints, then the statistics."""
    terminal.say(f"[{_colour(judgement.verdict)}]{judgement.verdict}[/]: {judgement.headline}")
    for hint in judgement.hints:
        terminal.say(f"  hint: {hint.text}", markup=False)
    terminal.say(f"\n{judgement.sentence}", markup=False)
    for reason in judgement.reasons:
        terminal.say(f"- {reason}", markup=False)
    for size in judgement.tiles:
        terminal.say(_of_tiles(size))


def say_all(outcomes: list[Any]) -> None:
    """A line for each comparison."""
    widest = max((len(each.name) for each in outcomes), default=0)
    for each in outcomes:
        judgement = each.judgement
        name = each.name.ljust(widest).replace("[", r"\[")
        terminal.say(f"{name}  [{_colour(judgement.verdict)}]{judgement.verdict}[/]: {judgement.headline}")
        for hint in judgement.hints:
            terminal.say(f"{' ' * widest}  hint: {hint.text}", markup=False)


def _colour(word: str) -> str:
    return f"bold {terminal.COLOURS.get(word, '')}".strip()


_UNEVEN = 0.01
"""Of the Kolmogorov-Smirnov test that the p-values of a map are uniform."""


_FEW = 16
"""So few p-values are spread evenly by chance, whatever they are."""


def _of_tiles(size: dict[str, Any]) -> str:
    """What the tests of one size of tiles found, in a line."""
    what = f"tiles of {size['side']} px"
    if size["merged_into"] is not None:
        return f"{what}: merged into those of {size['merged_into']} px (median skewness {size['skewness']:.2f})"
    found = f"{size['holm']} of {size['tested']} found by Holm, {size['benjamini_hochberg']} by Benjamini-Hochberg"
    text = f"{what}: {found}"
    if size["uniform_p"] is None or size["tested"] < _FEW:
        return text
    if size["uniform_p"] >= _UNEVEN:
        return f"{text}; its p-values are spread evenly, as without a bias"
    return f"{text}; its p-values are not spread evenly: a bias makes them so, and so does noise that tiles share"
