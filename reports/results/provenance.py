"""Where a row comes from: the command that makes it again, and all rows as `results.csv`.

The same command gives the same images, errors and biases, bit for bit on one machine. The level of a test depends on
the number of tests of its run, so that a verdict close to its limit may need the whole run, whose command stands on the
page as well.
"""

import csv
import io
import shlex
from pathlib import Path
from typing import Any

from termwise.scenes.load import library
from termwise.scenes.store import write_atomically

# Of `termwise compare`: those with a value that decide what is measured, not where it goes or what is printed.
_OPTIONS = "--study", "--seed", "--budget", "--estimators", "--backend"
_ELSEWHERE = ("--out",)

COLUMNS: dict[str, str | None] = {
    "scene": None,
    "base": None,
    "setting": None,
    "group": None,
    "at": None,
    "term": None,
    "variant": None,
    "kind": None,
    "scope": None,
    "against": None,
    "verdict": None,
    "bias": "1",
    "bias_low": "1",
    "bias_high": "1",
    "standard_error": "1",
    "family_low": "1",
    "family_high": "1",
    "detectable_bias": "1",
    "predicted_bias": "1",
    "margin": "1",
    "allowance": "1",
    "tests": "1",
    "rms_bias": "1",
    "rms_bias_high": "1",
    "place": None,
    "rmse": "radiance",
    "rmse_low": "radiance",
    "rmse_high": "radiance",
    "relmse": "1",
    "ssim": "1",
    "slope": "1",
    "slope_low": "1",
    "slope_high": "1",
    "floor": "radiance^2",
    "cause": None,
    "samples": "per pixel and replicate",
    "replicates": "1",
    "seconds": "s, all replicates",
    "compile_seconds": "s",
    "reference_samples": "per pixel and replicate",
    "reference_replicates": "1",
    "reference_seconds": "s, all replicates",
    "reference_seconds_to_rmse": "s",
    "speed_up": "1",
    "reference_audit": None,
    "samples_to_margin": "per pixel and replicate",
    "seconds_to_margin": "s",
    "sentence": None,
    "command": None,
}
"""Fields of a row in the order of the table, each with its unit: 1 is a number or a share, None is text."""


def command(results: dict[str, Any], row: dict[str, Any]) -> str | None:
    """The `termwise compare` that makes a row again; None where the run was not started by one.

    Of a row's scene alone where that is a scene of the library or was named; else of the whole study.
    """
    try:
        words = shlex.split(results["settings"].get("command") or "")
    except ValueError:  # an unbalanced quote, of a name that was not quoted
        return None
    if [Path(word).name for word in words[:1]] + words[1:2] != ["termwise", "compare"]:
        return None
    named, options, rest = [], [], iter(words[2:])
    for word in rest:
        name, equals, value = word.partition("=")
        if name in _OPTIONS + _ELSEWHERE:
            value = value if equals else next(rest, "")
            options += [name, value] if name in _OPTIONS else []
        elif not word.startswith("-"):
            named.append(word)
    scene = row.get("base") or row["scene"]
    of_scene = [word for word in named if Path(word).name.removesuffix(".toml") == scene]
    if row.get("group"):
        of_scene = named
    elif not of_scene and scene in library():
        of_scene = [scene]
    return shlex.join(["termwise", "compare", *of_scene, *options])


def write_csv(rows: list[dict[str, Any]], path: Path) -> None:
    """Write rows as CSV (RFC 4180: CRLF, quotes where needed, UTF-8), units in the header; what is not due is empty."""
    text = io.StringIO(newline="")
    table = csv.writer(text, lineterminator="\r\n")
    table.writerow(name if unit in (None, "1") else f"{name} ({unit})" for name, unit in COLUMNS.items())
    for row in rows:
        table.writerow(_plain(row.get(name)) for name in COLUMNS)
    write_atomically(path, lambda temporary: temporary.write_bytes(text.getvalue().encode("utf-8")))


def _plain(value: Any) -> Any:
    """A table as `name = value`, the names of a place apart by semicolons."""
    return "; ".join(f"{name} = {each}" for name, each in value.items()) if isinstance(value, dict) else value
