"""JSON of results as it is written, and a finished run as it is read again: whole, or a sentence that says why not."""

import json
import math
from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np

from termwise.scenes.store import write_atomically

SCHEMA = 1
"""Of `results.json`: another number, another meaning."""
NAME, IMAGES = "results.json", "results.nc"
_PARTS = {"versions": dict, "settings": dict, "cells": list}
_OF_ROWS = "scene", "term", "variant", "against", "samples", "verdict"


def read(run: Path) -> dict[str, Any]:
    """What the `results.json` of a run holds.

    Parameters
    ----------
    run : the file, or the folder that holds it.

    Raises
    ------
    ValueError : There is none, it is cut short or no JSON, or it is of another schema; the message names it and says
        which.
    """
    path = run / NAME if run.is_dir() else run
    try:
        text = path.read_text("utf-8")
    except FileNotFoundError:
        raise ValueError(f"{path}: no such file: allowed is the folder of a finished run, {_WRITER}") from None
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: is no text ({error.reason}): allowed is {_WRITER}") from None
    try:
        results = json.loads(text)
    except json.JSONDecodeError as error:
        place = f"{error.msg.lower()} in line {error.lineno}, column {error.colno}"
        raise ValueError(f"{path}: is cut short or no JSON ({place}): allowed is {_WRITER}") from None
    schema = results.get("schema") if isinstance(results, dict) else None
    if schema != SCHEMA:
        raise ValueError(f"{path}: schema = {schema!r}: allowed is {SCHEMA}, {_WRITER} of this version")
    for name, kind in _PARTS.items():
        if not isinstance(results.get(name), kind):
            raise ValueError(f"{path}: {name}: is missing: allowed is {_WRITER}")
    for index, row in enumerate(results["cells"]):
        lacking = [name for name in _OF_ROWS if name not in row]
        if lacking:
            raise ValueError(f"{path}: cells[{index}].{lacking[0]}: is missing: allowed is {_WRITER}")
    return results


def check_images(run: Path) -> None:
    """Refuse a `results.nc` that is missing, cut short or no NetCDF with a ValueError.

    HDF5 knows the length of its file: one that is cut short does not open.
    """
    path = run / IMAGES
    if not path.is_file():
        raise ValueError(f"{path}: no such file: allowed is {_WRITER}")
    try:
        with h5netcdf.File(path, "r"):
            pass
    except Exception as error:  # h5py raises OSError, KeyError and RuntimeError alike
        reason = " ".join(str(error).split())
        raise ValueError(f"{path}: is cut short or no NetCDF ({reason}): allowed is {_WRITER}") from None


def write(path: Path, results: Any) -> None:
    """Write results as JSON; the file appears whole or not at all."""
    text = dumped(results, indent=1)
    write_atomically(path, lambda temporary: temporary.write_text(text, "utf-8"))


def dumped(results: Any, indent: int | None = None) -> str:
    """Results as JSON, made `plain` before."""
    return json.dumps(plain(results), indent=indent, allow_nan=False)


def plain(value: Any) -> Any:
    """JSON has no NaN, no infinity, no NumPy numbers: the first two become null."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


_WRITER = "what `termwise compare` writes"
