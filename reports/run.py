"""A run: measure every cell of a study against its references, decide, and write what the report reads.

scene -> jobs -> (renderer | reference) -> rows -> verdicts -> `results.json`, `results.nc`, `images/*.exr`

The level of every test depends on the number of tests of the whole run, so all rows are measured before any is decided;
with a budget, undecided ones are then measured again with more replicates (see `reports.statistics.sequential`).
Replicates are kept in the cache by content: an interrupted run goes on where it stopped, a run with nothing changed
computes nothing.
"""

import hashlib
import math
import os
import platform
import shlex
import sys
import time
from pathlib import Path
from typing import Any

import attrs

from termwise.reference import backend
from termwise.renderer.fingerprint import Unknown
from termwise.renderer.terms import find, registered
from termwise.reports.jobs.desk import Desk
from termwise.reports.jobs.executors import Executor
from termwise.reports.machine import processor, versions
from termwise.reports.progress import Report
from termwise.reports.results import schema as stored
from termwise.reports.results.findings import CERTIFIED
from termwise.reports.rows import images, pilot
from termwise.reports.rows.described import describe, work
from termwise.reports.rows.looks import Group, Source, exact_group, jobs, of_case
from termwise.reports.rows.measurement import decided, tests_of, tile_maps
from termwise.reports.statistics import sequential, verdict
from termwise.reports.study import audits, exact
from termwise.reports.study.allotment import AIM, MOST, WORK, Allotment
from termwise.reports.study.geometry_audit import Finding
from termwise.reports.study.study import Study
from termwise.reports.study.subjects import CHAIN, Subject, subjects
from termwise.scenes.model import Scene
from termwise.scenes.store import ROOT, cache_folder, sources_digest
from termwise.scenes.terms import TERMS


def digest(study: Study, scenes: tuple[Scene, ...], variant: str) -> str:
    """sha256 of all that decides a run's results but the speed of the machine.

    New each time with estimators that have no fingerprint.
    """
    sources = sources_digest(*(ROOT / name for name in ("renderer", "reference", "scenes", "reports")))
    settings = (
        attrs.asdict(study),
        [(s.name, s.exposure, s.substitutions, s.digest()) for s in scenes],
        variant,
        sources,
        versions(),
        [_fingerprint(term, name) for term in TERMS for name in study.variants_of(term) if name in registered(term)],
    )
    return hashlib.sha256(repr(settings).encode()).hexdigest()


def _fingerprint(term: str, name: str) -> str | int:
    try:
        return find(term, name).estimator.fingerprint()
    except Unknown:
        return time.time_ns()


def finished(folder: Path, fingerprint: str) -> dict[str, Any] | None:
    """The results in `folder` if they are this very run's and no scene failed; a ValueError says what is damaged."""
    if not (folder / "index.html").is_file() or not (folder / stored.NAME).is_file():
        return None
    found = stored.read(folder)
    stored.check_images(folder)
    ended = found["settings"].get("digest") == fingerprint and not found.get("failed")
    return found if ended else None


def measure(
    study: Study,
    scenes: tuple[Scene, ...],
    folder: Path,
    *,
    name: str,
    report: Report,
    arguments: dict[str, Any] | None = None,
    executor: Executor | None = None,
) -> dict[str, Any]:
    """Measure and judge a study, write results and images into `folder`; returns what `results.json` holds.

    Parameters
    ----------
    study, scenes : what to measure.
    folder : made if missing.
    name : the study's name, for the report.
    report : called with (what, done, of all) as replicates come in.
    arguments : what a command names them by: {"study": its name or file, "scenes": {name: name or file}, "approximate":
        as in `scenes.load.load`}.
    executor : does the jobs; by default this process does.
    """
    desk = Desk(study, cache_folder(), executor=executor, report=report)
    try:
        results = _Run(study, scenes, folder, desk).results(name, arguments)
    finally:
        desk.close()
    # A page of an earlier run must not stand beside new results, should this one end here.
    (folder / "index.html").unlink(missing_ok=True)
    stored.write(folder / stored.NAME, results)
    return results


class _Run:
    """What is found as a run goes on."""

    def __init__(self, study: Study, scenes: tuple[Scene, ...], folder: Path, desk: Desk) -> None:
        self.study, self.scenes, self.desk = study, scenes, desk
        self.subjects = list(subjects(study, scenes))
        self.cases = list(exact.cases(study))
        self.pictures = images.Pictures(folder)
        self.allotment = Allotment()
        self.sources: dict[str, Source] = {}
        self.described: dict[str, Any] = {}
        self.groups: list[Group] = []
        self.audits: list[audits.Audit] = []
        self.geometry: list[Finding] = []
        self.extrapolations: list[dict[str, Any]] = []

    def results(self, name: str, arguments: dict[str, Any] | None) -> dict[str, Any]:
        """Have the jobs done, make the rows, look again as far as the budget goes, decide, and write the images."""
        failed = self._first_look()
        tests = sum(tests_of(row) for group in self.groups for row in group.rows if row.judged)
        audited = audits.decide(self.audits, self.geometry)
        looks = 1
        if self.study.budget is not None:
            looks = len(sequential.LOOKS)
            self._look_again(self.study.budget, tests, audited)
        found = [[decided(row, tests, audited, looks) for row in group.rows] for group in self.groups]
        rows = [row for of_group in found for row in of_group]
        settings = self._settings(name, arguments)
        settings["tests"] = tests
        settings["certified"] = self._certified(found, looks)
        settings["allotted"] = self._allotted()
        self._write_images()
        return {
            "schema": stored.SCHEMA,
            "versions": versions(),
            "settings": settings,
            "failed": [{"scene": scene, "error": error} for scene, error in failed.items()],
            "cells": rows,
            "extrapolations": self.extrapolations,
            "audits": audited,
        }

    def _first_look(self) -> dict[str, str]:
        """Do the jobs and make the rows of the first look; returns the scenes that failed, with the reason.

        The others' results stand. What concerns the whole run is raised: a disk without room, the failure of all.
        """
        needs = {subject.scene.name: subject.unchanged.name for subject in self.subjects}
        errors = self.desk.failed
        self.allotment = pilot.allotted(self.study, self.subjects, self.desk, forgiven=needs)
        listed = []
        for subject in self.subjects:
            try:
                listed += jobs(self.study, subject, self.desk, self.allotment)
            except OSError:
                raise
            except Exception as error:
                errors[subject.scene.name] = error
        for case in self.cases:
            listed += self.desk.jobs(of_case(case))
        self.desk.run(listed, forgiven=needs)
        failed: dict[str, str] = {}
        for subject in self.subjects:
            scene, unchanged = subject.scene.name, subject.unchanged.name
            if unchanged in failed:
                failed[scene] = f"{unchanged}, which it changes, failed"
                continue
            try:
                if scene in errors:
                    raise errors[scene]
                self._measure(subject)
            except OSError:
                raise
            except Exception as error:
                errors.setdefault(scene, error)
                failed[scene] = _reason(scene, error)
        if errors and len(failed) == len(self.subjects):
            scene = next(iter(failed))
            raise ValueError(f"{scene}: {failed[scene]}") from errors[scene]
        self.groups += [exact_group(case, self.desk) for case in self.cases]
        return failed

    def _measure(self, subject: Subject) -> None:
        """Rows, audits, images and description of a subject whose jobs are done."""
        unchanged = self.sources.get(subject.unchanged.name)
        source = Source(self.study, subject, self.desk, self.allotment, unchanged)
        measured = source.measure()
        made, checked, geometry = source.groups(measured), source.audits(), source.geometry()
        sweeps = [images.sweep(cell) for cell in measured]
        self.pictures.write(subject, measured, sweeps, *source.images(), source.objects, versions())
        found = source.extrapolations()
        self.sources[subject.scene.name] = source
        self.described[subject.scene.name] = describe(self.study, subject, measured)
        self.extrapolations += found
        self.groups += made
        self.audits += checked
        self.geometry.append(geometry)

    def _look_again(self, budget: float, tests: int, audited: list[dict[str, Any]]) -> None:
        """Undecided rows with more replicates, as far as the budget goes."""
        for group in self.groups:
            group.tests, group.audited = tests, audited
        undecided = [group for group in self.groups if group.judged and not group.decided]
        sequential.go_on(undecided, self.desk.ledger, budget)
        for scene, source in self.sources.items():
            if source.extended:
                measured, sweeps = source.extend()
                self.pictures.write(source.subject, measured, sweeps, *source.images(), source.objects, versions())
                self.described[scene]["work"] = work(measured)

    def _certified(self, found: list[list[dict[str, Any]]], looks: int) -> dict[str, Any]:
        """How many rows are proven to be right, and the seconds that this took."""
        rows = [row for of_group in found for row in of_group]
        certified = [
            group.wanted(group.factor)
            for group, of_group in zip(self.groups, found, strict=True)
            if any(row["verdict"] in CERTIFIED for row in of_group)
        ]
        ledger = self.desk.ledger
        return {
            "rows": len(certified),
            "of": sum(row["verdict"] not in (None, "ABSENT") for row in rows),
            "seconds": ledger.took("ours", certified),
            "reference_seconds": ledger.took("reference", certified),
            "compile_seconds": sum(row["compile_seconds"] or 0.0 for row in rows),
            "budget": self.study.budget,
            "spent": ledger.spent,
            "looks": [factor * self.study.replicates for factor in sequential.LOOKS[:looks]],
        }

    def _allotted(self) -> dict[str, Any] | None:
        """What replicates were allotted for, and how many each side of a row got; None where a study fixes them."""
        allotment, study = self.allotment, self.study
        if allotment.half_width is None:
            return None
        sides = ((allotment.ours, study.replicates), (allotment.reference, study.reference_replicates))
        ours, references = (
            sorted({math.ceil(count * factor) for factor in factors.values()}) for factors, count in sides
        )
        return {
            "asked": study.half_width,
            "half_width": allotment.half_width,
            "aim": AIM,
            "most": MOST,
            "work": WORK,
            "replicates": ours,
            "reference_replicates": references,
        }

    def _settings(self, name: str, arguments: dict[str, Any] | None) -> dict[str, Any]:
        """What was asked for, and by whom and where it was done."""
        study, chosen = self.study, backend.choose()
        return {
            "study": name,
            "page": study.folder,
            "digest": digest(study, self.scenes, chosen.variant),
            "seed": study.seed,
            "backend": chosen.variant,
            "backend_reason": chosen.reason,
            "processor": processor(),
            "machine": platform.machine(),
            "system": f"{platform.system()} {platform.release()}",
            "cores": os.cpu_count(),
            # Empty where this process did all.
            "hosts": dict(self.desk.hosts),
            "command": shlex.join(["termwise", *sys.argv[1:]]),
            "arguments": arguments or {"study": name, "scenes": {}},
            "alpha": verdict.LEVEL,
            "options": {
                "replicates": study.replicates,
                "reference replicates": study.reference_replicates,
                "reference samples per pixel": study.reference_spp,
                "samples per pixel of full light transport": study.physical_spp,
                "direct at the vertices of a specular chain": CHAIN,
            },
            "scenes": self.described,
        }

    def _write_images(self) -> None:
        """The maps of judged rows beside the images; then `results.nc`."""
        rows = [row for group in self.groups for row in group.rows]
        for scene in self.described:
            maps = {
                (row.fields["term"], row.fields["variant"]): found
                for row in rows
                if row.fields["scene"] == scene and (found := tile_maps(row)) is not None
            }
            self.pictures.locate(scene, maps)
        self.pictures.close()


def _reason(scene: str, error: Exception) -> str:
    """Why a scene failed, in one line."""
    reason = " ".join(str(error).split()).removeprefix(f"{scene}: ")
    return reason if isinstance(error, ValueError) else f"{type(error).__name__}: {reason}"


def failures(results: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows that prove an error: of ours, or of the reference."""
    proven = ("BIASED", "NOT AS PREDICTED", verdict.NO_VERDICT)
    return [row for row in results["cells"] if row["verdict"] in proven]
