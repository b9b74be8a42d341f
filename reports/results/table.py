"""All rows of a run as one table: `results.csv`."""

import csv
import io
from pathlib import Path
from typing import Any

from termwise.scenes.store import write_atomically

_UNITS: tuple[tuple[str | None, str], ...] = (
    (None, "scene base setting group at term variant kind scope against verdict"),
    ("1", "bias bias_low bias_high standard_error family_low family_high detectable_bias predicted_bias"),
    ("1", "margin allowance tests rms_bias rms_bias_high"),
    (None, "place"),
    ("radiance", "rmse rmse_low rmse_high"),
    ("1", "relmse ssim slope slope_low slope_high"),
    ("radiance^2", "floor"),
    (None, "cause"),
    ("per pixel and replicate", "samples"),
    ("1", "replicates"),
    ("s, all replicates", "seconds"),
    ("s", "compile_seconds"),
    ("per pixel and replicate", "reference_samples"),
    ("1", "reference_replicates"),
    ("s, all replicates", "reference_seconds"),
    ("s", "reference_seconds_to_rmse"),
    ("1", "speed_up"),
    (None, "reference_audit"),
    ("per pixel and replicate", "samples_to_margin"),
    ("s", "seconds_to_margin"),
    (None, "headline sentence command"),
)
COLUMNS = {name: unit for unit, names in _UNITS for name in names.split()}
"""Fields of a row in the order of the table, each with its unit: 1 is a number or a share, None is text."""


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
