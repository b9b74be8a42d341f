"""All rows of a run as one table: `results.csv`."""

import csv
import io
from pathlib import Path
from typing import Any

from termwise.scenes.store import write_atomically

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
