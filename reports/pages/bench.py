"""Benchmarks as a page: those of `terms.json`, `rays.json` and so on that exist -> `index.html` beside them."""

import json
from pathlib import Path
from typing import Any

import jinja2

from termwise.reports.pages import charts
from termwise.reports.pages.environment import copy_static, page_environment, render_page

NAMES = ("terms", "rays", "scaling", "reductions", "view")


def write(folder: Path) -> Path:
    """Write the page of the benchmarks that a folder holds; returns the `index.html`.

    Raises
    ------
    ValueError : none of the files is there, or one is no JSON or of another version.
    """
    found = {name: _read(folder / f"{name}.json") for name in NAMES if (folder / f"{name}.json").is_file()}
    if not found:
        raise ValueError(f"{folder}: no benchmark: allowed are {', '.join(f'{name}.json' for name in NAMES)}")
    index = folder / "index.html"
    try:
        render_page(
            page_environment(),
            "bench.html.j2",
            index,
            root="",
            runs=found,
            terms=_terms(found["terms"]) if "terms" in found else {},
            scaling=_scaling(found["scaling"]) if "scaling" in found else {},
            best=_best,
        )
    except (KeyError, jinja2.UndefinedError) as error:
        raise ValueError(
            f"{folder}: a benchmark of another version ({error}): allowed is what this one writes; run it again"
        ) from None
    copy_static(folder)
    return index


def _read(path: Path) -> dict[str, Any]:
    try:
        return json.loads(path.read_text("utf-8"))
    except ValueError as error:
        raise ValueError(f"{path}: {error}: allowed is what `termwise bench {path.stem}` writes") from None


def _terms(measured: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """By term (direct by scope): a scene's chart and its rows at equal error."""
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for curve in measured["curves"]:
        # A chain's scope is the scene's own, and no other's row stands beside it.
        term = f"direct, {curve['scope']}" if curve["term"] == "direct" else curve["term"]
        entry = found.setdefault(term, {}).setdefault(
            curve["scene"], {"scene": curve["scene"], "ours": [], "theirs": {}, "rows": []}
        )
        if curve["side"] == "ours":
            entry["ours"].append(curve)
            key = "scene", "term", "scope", "variant"
            entry["rows"] += [case for case in measured["cases"] if all(case[name] == curve[name] for name in key)]
        elif curve["kept"] or curve["setting"] not in entry["theirs"]:
            entry["theirs"][curve["setting"]] = curve
    for scenes in found.values():
        for entry in scenes.values():
            entry["chart"] = charts.error_against_time(entry["ours"], list(entry["theirs"].values()))
    return {term: list(scenes.values()) for term, scenes in found.items()}


def _scaling(measured: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """By axis: its rows, and a chart where it has more than two points."""
    found: dict[str, dict[str, Any]] = {}
    for row in measured["cases"]:
        found.setdefault(row["axis"], {"rows": [], "chart": None})["rows"].append(row)
    for axis, entry in found.items():
        if axis != "threads" and len(entry["rows"]) > 1:
            entry["chart"] = charts.scaling(entry["rows"])
    return found


def _best(rows: list[dict[str, Any]]) -> tuple[float, float] | None:
    """Least and greatest speed-up of rows."""
    values = [row["speedup"] for row in rows]
    return (min(values), max(values)) if values else None
