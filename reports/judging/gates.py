"""Verdicts for machines: what a gate asks for, exit statuses, JUnit and Markdown.

    status  verdicts                                            require = unbiased    require = equivalent
    0       all EQUIVALENT                                      pass                  pass
    1       one BIASED                                          fail                  fail
    2       bad input: nothing was judged                       error                 error
    3       none BIASED, one UNDERPOWERED or ABSENT             pass (as 0)           fail

A gate that asks for no bias passes on no evidence; one that asks for equivalence does not.
"""

import datetime
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

from termwise.reports.judging.judge import Judgement
from termwise.reports.judging.suite import Outcome
from termwise.reports.pages import digits
from termwise.scenes.store import write_atomically

Require = Literal["unbiased", "equivalent"]
PASSED, PROVEN, BAD_INPUT, NOT_SHOWN = 0, 1, 2, 3


def status(verdict: str | None, require: Require) -> int:
    """Exit status of one verdict."""
    if verdict == "BIASED":
        return PROVEN
    return NOT_SHOWN if require == "equivalent" and verdict != "EQUIVALENT" else PASSED


def worst(outcomes: Sequence[Outcome], require: Require) -> int:
    """Exit status of several: of a proven bias if there is one."""
    found = {status(each.judgement.verdict, require) for each in outcomes}
    return next((each for each in (PROVEN, NOT_SHOWN) if each in found), PASSED)


def words(judgement: Judgement) -> str:
    """A verdict with all that is said of it, by lines."""
    lines = [judgement.sentence, *(f"hint: {hint.text}" for hint in judgement.hints)]
    return "\n".join([*lines, *(f"warning: {text}" for text in judgement.warnings)])


def junit(path: Path, outcomes: Sequence[Outcome], require: Require, *, seconds: float = 0.0) -> None:
    """Write a JUnit report, a test case for each comparison; it appears whole or not at all.

    BIASED, and what `require` lacks, are failures; what is not decided and need not be is skipped.
    """
    failed = [each for each in outcomes if status(each.judgement.verdict, require)]
    skipped = [each for each in outcomes if each not in failed and each.judgement.verdict != "EQUIVALENT"]
    suite = ElementTree.Element(
        "testsuite",
        name="termwise judge",
        tests=str(len(outcomes)),
        failures=str(len(failed)),
        errors="0",
        skipped=str(len(skipped)),
        time=f"{seconds:.3f}",
        timestamp=datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%S"),
    )
    for each in outcomes:
        judgement = each.judgement
        case = ElementTree.SubElement(suite, "testcase", classname="termwise.judge", name=each.name)
        message = f"{judgement.verdict}: {judgement.headline}"
        if each in failed:
            fault = ElementTree.SubElement(case, "failure", message=message, type=str(judgement.verdict))
            fault.text = words(judgement)
        elif each in skipped:
            ElementTree.SubElement(case, "skipped", message=message)
        ElementTree.SubElement(case, "system-out").text = f"{message}\n{words(judgement)}\nreport: {each.page}"
    root = ElementTree.Element("testsuites")
    root.append(suite)
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode", xml_declaration=False)
    _write(path, f'<?xml version="1.0" encoding="utf-8"?>\n{text}\n')


def markdown(path: Path, outcomes: Sequence[Outcome], require: Require) -> None:
    """Write a table for a pull request or a job's summary; it appears whole or not at all."""
    failed = sum(bool(status(each.judgement.verdict, require)) for each in outcomes)
    head = (
        f"**{failed} of {len(outcomes)} comparisons failed**" if failed else f"**{len(outcomes)} comparisons passed**"
    )
    lines = [
        f"{head} (required: {require})",
        "",
        "| | comparison | verdict | in words | bias [90 %] |",
        "|---|---|---|---|---|",
    ]
    for each in outcomes:
        judgement = each.judgement
        sign = "❌" if status(judgement.verdict, require) else "✅" if judgement.verdict == "EQUIVALENT" else "❔"
        bias = digits.interval(judgement.bias, judgement.bias_low, judgement.bias_high)
        cells = (sign, _cell(each.name), str(judgement.verdict), _cell(judgement.headline), bias)
        lines.append(f"| {' | '.join(cells)} |")
    for each in outcomes:
        said = "\n".join(f"- {line}" for line in words(each.judgement).splitlines())
        title = f"{each.judgement.verdict}: {_cell(each.name)}"
        lines += ["", f"<details><summary>{title}</summary>", "", said, "", f"Report: `{each.page}`", "</details>"]
    _write(path, "\n".join(lines) + "\n")


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("<", "&lt;")


def _write(path: Path, text: str) -> None:
    if path.is_dir() or path.exists() and not os.access(path, os.W_OK):
        raise ValueError(f"{path}: cannot be written: allowed is the path of a file, old or new")
    # A device or a pipe, as /dev/stdout is, has no place beside it.
    if path.exists() and not path.is_file():
        path.write_text(text, "utf-8")
    else:
        write_atomically(path, lambda temporary: temporary.write_text(text, "utf-8"))
