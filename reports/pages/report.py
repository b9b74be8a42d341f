"""A finished run as pages: `results.json` and `results.nc` -> `index.html`, a page a scene, the method.

Nothing else is read, so the pages can be written again at any time. They open from a disk without network: pictures
are PNG files beside them, formulas MathML, and only the charts need a script (plotly's, copied once).
"""

import json
import shutil
from pathlib import Path
from typing import Any
from urllib.parse import quote

import jinja2
import numpy as np
import xarray

from termwise.renderer.terms import VARIANTS
from termwise.reports.pages import charts, method, pictures, viewer
from termwise.reports.pages.environment import (
    WORDS,
    copy_static,
    grouped,
    p_maps,
    page_environment,
    render_page,
    slug,
    word,
)
from termwise.reports.progress import Report, silent
from termwise.reports.results import findings, microscope, provenance, table
from termwise.reports.results import schema as stored
from termwise.reports.statistics import verdict
from termwise.scenes.terms import TERMS, TOTAL

_FIELDS = (
    "scene term variant kind scope against samples replicates reference_samples reference_replicates seconds "
    "reference_seconds compile_seconds rmse rmse_low rmse_high relmse ssim bias bias_low bias_high standard_error "
    "margin allowance tests family_low family_high rms_bias rms_bias_high place predicted_bias detectable_bias "
    "detectable_shape detectable_border detectable_window "
    "samples_to_margin seconds_to_margin off slope slope_low slope_high floor cause verdict headline sentence "
    "reference_shortfall "
    "reference_audit group at gain base setting reference_seconds_to_rmse speed_up command"
).split()
_LISTS = "channels", "objects", "warnings", "reasons", "tolerated", "tiles"


def write(run: Path, *, report: Report = silent) -> Path:
    """Write the pages of a finished run into its folder, and its rows as `results.csv`.

    Parameters
    ----------
    run : a folder that holds `results.json` and `results.nc`.
    report : called with (what, done, of all) as pages come in.

    Returns
    -------
    The `index.html`, written last: where it exists, all it links to does.

    Raises
    ------
    ValueError : one of the two is missing, cut short or of another schema; the message says which.
    """
    results = stored.read(run)
    stored.check_images(run)
    rows = [_complete(row | {"command": provenance.command(results, row)}) for row in results["cells"]]
    right = findings.from_right(rows)
    for row in rows:
        if row["against"] == "own" and row["verdict"]:
            row["off"] = right.get(findings.key(row))
    audits = results.get("audits", [])
    every = [_Scene(name, described, rows, audits) for name, described in results["settings"]["scenes"].items()]
    scenes = [scene for scene in every if scene.setting is None]

    # What an earlier run with other scenes left would be taken for this one's.
    for name in ("index.html", "report.html"):
        (run / name).unlink(missing_ok=True)
    for folder in ("scenes", "pictures"):
        shutil.rmtree(run / folder, ignore_errors=True)
    viewer.clear(run)
    steps = 2 * len(every) + 2
    shown = {}
    for done, scene in enumerate(every):
        report(f"{scene.name}: pictures", done, steps)
        shown[scene.name] = scene.draw(run)
        scene.look(run, results)
    copy_static(run)
    table.write_csv(rows, run / "results.csv")

    exact = _exact(rows)
    judged = [scene.row(*key, "own") for scene in every for key in scene.keys]
    judged += [row for row in rows if row["group"] and row["against"] == "own"]
    judged = [row for row in judged if row]
    common = {
        "results": results,
        "broken": results.get("failed", []),
        "settings": results["settings"],
        "versions": results["versions"],
        "scenes": scenes,
        "changed": _by_setting(every),
        "shown": shown,
        "rows": judged,
        "tally": _tally(judged),
        "margins": findings.certified(judged),
        "certifying": findings.CERTIFIED,
        "exact": exact,
        "extrapolations": results.get("extrapolations", []),
        "words": WORDS,
        "terms": TERMS,
        "variants": VARIANTS,
        "rule": verdict,
        "downloads": [
            name
            for name in ("results.csv", "results.json", "results.nc", *(f"images/{scene.name}.exr" for scene in every))
            if (run / name).is_file()
        ],
    }
    environment = _environment()
    report("method", len(every), steps)
    render_page(environment, "method.html.j2", run / "method.html", root="", **common)
    for done, scene in enumerate(every, len(every) + 1):
        report(scene.name, done, steps)
        page = run / "scenes" / f"{scene.name}.html"
        # A scene with a changed setting has static pictures alone: the report of a study of variants stays small.
        viewed = None
        if scene.setting is None:
            read = {str(name): each.values for name, each in scene.dataset(run).variables.items()}
            viewed = viewer.write_data(run, scene, read, scene.exposure(run))
        render_page(environment, "scene.html.j2", page, root="../", scene=scene, viewed=viewed, **common)
        if viewed:
            page = page.with_suffix(".viewer.html")
            render_page(environment, "viewer.html.j2", page, root="../", scene=scene, viewed=viewed, **common)
    index = run / "index.html"
    front = "variants.html.j2" if results["settings"].get("page") == "variants" else "index.html.j2"
    render_page(environment, front, index, root="", keys=_keys(scenes), **common)
    report("index", steps, steps)
    return index


class _Scene:
    """A scene's rows in the order in which they are read, and its pictures."""

    def __init__(
        self, name: str, described: dict[str, Any], rows: list[dict[str, Any]], audits: list[dict[str, Any]]
    ) -> None:
        self.name = name
        self._dataset: xarray.Dataset | None = None
        self.branches: dict[tuple[str, str], dict[str, Any]] = {}
        self.audits = [audit for audit in audits if audit["scene"] == name]
        lacking = dict.fromkeys(("resolution", "exposure")) | {name: {} for name in ("settings", "gains")}
        self.described = lacking | {name: [] for name in ("objects", "plan", "work")} | described
        self.setting: dict[str, Any] | None = described.get("setting")
        self.base: str | None = described.get("base")
        self.rows = [row for row in rows if row["scene"] == name]
        self.keys = sorted(
            dict.fromkeys((row["term"], row["variant"]) for row in self.rows), key=lambda key: _order(key[0])
        )

    @property
    def terms(self) -> dict[str, list[str]]:
        """Variants of each term."""
        return _variants(self.keys)

    def prefixes(self, term: str, variant: str) -> list[dict[str, Any]]:
        """Rows against `own` by increasing samples; the last one is the judged one."""
        rows = [row for row in self.rows if (row["term"], row["variant"], row["against"]) == (term, variant, "own")]
        return sorted(rows, key=lambda row: row["samples"] or 0)

    def row(self, term: str, variant: str, against: str) -> dict[str, Any] | None:
        """The row at the largest sample count, None if there is none."""
        rows = [row for row in self.rows if (row["term"], row["variant"], row["against"]) == (term, variant, against)]
        return max(rows, key=lambda row: row["samples"] or 0, default=None)

    def dataset(self, run: Path) -> xarray.Dataset:
        """The scene's group of `results.nc`, read once."""
        if self._dataset is None:
            with xarray.open_dataset(run / "results.nc", group=self.name, engine="h5netcdf") as opened:
                self._dataset = opened.load()
        return self._dataset

    def exposure(self, run: Path) -> float:
        """Factor on the radiance that is shown."""
        return float(self.dataset(run).attrs.get("exposure", self.described["exposure"] or 1.0))

    def look(self, run: Path, results: dict[str, Any]) -> None:
        """Find the most suspect pixel of each judged row that has light; an earlier version's run has no pieces."""
        dataset = self.dataset(run)
        if not microscope.has_pieces(dataset):
            return
        for term, variant in self.keys:
            row = self.row(term, variant, "own")
            if row and row["verdict"] not in (None, "ABSENT"):
                found = microscope.branch(dataset, term, variant)
                replay = None if found.replicate is None else microscope.replay_command(results, row, found)
                places = (found.object, found.tile, found.at)
                self.branches[term, variant] = {"places": places, "replay": replay}

    def chart(self, term: str) -> dict[str, Any] | None:
        """Convergence of all variants of a term, as a plotly figure."""
        return charts.convergence({name: self.prefixes(term, name) for name in self.terms[term]})

    def split(self, term: str) -> dict[str, Any] | None:
        """Parts of the error against full light transport: of which variant, their numbers and their figure."""
        for name in self.terms[term]:
            row = self.row(term, name, "physical")
            if row and row.get("split"):
                parts = [(label, *row["split"][part]) for part, label in charts.PARTS]
                if "float_error" in row["split"]:
                    parts.append(("of bias²: rounding to float32", *row["split"]["float_error"]))
                return {"variant": name, "parts": parts, "figure": charts.waterfall(row["split"])}
        return None

    @property
    def worst(self) -> str:
        """The gravest word among the scene's rows."""
        found = [word(self.row(*key, "own")) for key in self.keys]
        return min(found, key=list(WORDS).index, default="NOT JUDGED")

    def draw(self, run: Path) -> dict[tuple[str, str, str], dict[str, Any]]:
        """Write the scene's pictures; returns, by (term, variant, against), their addresses and scales."""
        dataset = self.dataset(run)
        self._time_reference(dataset)
        exposure = self.exposure(run)
        folder = Path("pictures") / self.name
        written: set[Path] = set()

        def picture(name: str, pixels: np.ndarray) -> str:
            path = folder / f"{slug(name)}.png"
            if path not in written:
                pictures.save(run / path, pixels)
                written.add(path)
            return quote(path.as_posix())

        cells = list(
            zip(dataset["cell_term"].values.astype(str), dataset["cell_variant"].values.astype(str), strict=True)
        )
        drawn: dict[tuple[str, str, str], dict[str, Any]] = {}
        for against in ("own", "physical"):
            for term in dict.fromkeys(term for term, _ in cells):
                if against == "physical" and term != TOTAL:
                    continue
                # The scale of colours is shared by the variants of the term.
                errors, limits = {}, {}
                for cell, (its, variant) in enumerate(cells):
                    limit = int(dataset[against].values[cell])
                    if its == term and limit >= 0:
                        reference = dataset["reference"].values[limit]
                        errors[cell] = pictures.relative_error(dataset["image"].values[cell], reference)
                        limits[cell] = limit, reference, variant
                if not errors:
                    continue
                scale = pictures.error_scale([error for error, _ in errors.values()])
                for cell, (error, mean) in errors.items():
                    limit, reference, variant = limits[cell]
                    ours = dataset["image"].values[cell]
                    name = str(dataset["limit_name"].values[limit])
                    drawn[term, variant, against] = {
                        "ours": picture(f"{term} {variant}", pictures.display(ours, exposure=exposure)),
                        "reference": picture(f"reference {name}", pictures.display(reference, exposure=exposure)),
                        "error": picture(f"{term} {variant} error {against}", pictures.diverge(error, scale=scale)),
                        "maps": p_maps(dataset.isel(cell=cell), ours.shape[:2], f"{term} {variant}", picture)
                        if against == "own"
                        else {},
                        "limit": name,
                        "scale": scale,
                        "mean": mean,
                        "height": ours.shape[0],
                        "width": ours.shape[1],
                    }
        return drawn

    def _time_reference(self, dataset: xarray.Dataset) -> None:
        """Seconds that the reference takes to the error of one replicate, and how many times as long as ours.

        Averaged replicates of the reference have the error `V_R / n` after n of them: to our mean square error, those
        of this run take `seconds · V_R / (R · MSE)`, `V_R / R` being the variance of their mean.
        """
        for cell in range(dataset.sizes["cell"]):
            term, variant = (str(dataset[name].values[cell]) for name in ("cell_term", "cell_variant"))
            row, limit = self.row(term, variant, "own"), int(dataset["own"].values[cell])
            if row is None or limit < 0 or not row["rmse"] or not row["reference_seconds"]:
                continue
            variance = float(np.mean(dataset["reference_variance"].values[limit], dtype=np.float64))
            if variance > 0 and row["seconds"] and row["replicates"]:
                row["reference_seconds_to_rmse"] = row["reference_seconds"] * variance / row["rmse"] ** 2
                ours = row["seconds"] / row["replicates"]
                row["speed_up"] = row["reference_seconds_to_rmse"] / ours


def _by_setting(scenes: list[_Scene]) -> dict[str, list[_Scene]]:
    """The changed scenes by the name of the setting that changes them."""
    return grouped((scene for scene in scenes if scene.setting), lambda scene: (scene.setting or {})["name"])


def _assignments(change: dict[str, Any], prefix: str = "") -> list[str]:
    """A table as `field = value`, tables within it as `table.field = value`."""
    found = []
    for name, value in change.items():
        if isinstance(value, dict):
            found += _assignments(value, f"{prefix}{name}.")
        else:
            found.append(f"{prefix}{name} = {'inf' if value is None else json.dumps(value, ensure_ascii=False)}")
    return found


class _Exact:
    """The rows of one group of scenes with a known answer, by place and variant: (against own, against correct)."""

    def __init__(self, title: str, rows: list[dict[str, Any]]) -> None:
        self.title = title
        self.variants = list(dict.fromkeys(row["variant"] for row in rows))
        self.parameters = ", ".join(rows[0]["at"])
        self.places: dict[str, dict[str, list[dict[str, Any]]]] = {}
        self.gains: dict[float, dict[str, float]] = {}
        for row in rows:  # own before correct, as a run writes them
            place = ", ".join(f"{value:g}" for value in row["at"].values())
            self.places.setdefault(place, {}).setdefault(row["variant"], []).append(row)
            if row["gain"] is not None:
                self.gains.setdefault(row["at"]["gloss"], {})[row["variant"]] = row["gain"]

    @property
    def size(self) -> int:
        """Number of scenes."""
        return len(self.places)


def _exact(rows: list[dict[str, Any]]) -> dict[str, _Exact]:
    groups = grouped((row for row in rows if row["group"]), lambda row: row["group"])
    return {name: _Exact(name, found) for name, found in groups.items()}


def _address(row: dict[str, Any]) -> str:
    """Where the pages show a row, from the front page."""
    if row["group"]:
        return f"#{slug(row['group'])}"
    return f"scenes/{quote(row['scene'])}.html#{slug(row['term'] + ' ' + row['variant'])}"


def _picture(scenes: list[_Scene], shown: dict[str, Any], term: str, variant: str) -> dict[str, Any] | None:
    """A variant's picture and the right one, of the first scene that has the term."""
    for scene in scenes:
        row, drawn = scene.row(term, variant, "own"), shown[scene.name]
        right = (term, scene.terms[term][0], "own") if term in scene.terms else None
        if row and row["verdict"] != "ABSENT" and right in drawn and (term, variant, "own") in drawn:
            return {"scene": scene.name, "its": drawn[term, variant, "own"], "right": drawn[right]}
    return None


def _order(term: str) -> int:
    return [*TERMS, TOTAL].index(term) if term in (*TERMS, TOTAL) else len(TERMS) + 1


def _complete(row: dict[str, Any]) -> dict[str, Any]:
    """A row in which whatever is not due is None."""
    return dict.fromkeys(_FIELDS) | dict.fromkeys(_LISTS, []) | {k: v for k, v in row.items() if v is not None}


def _tally(rows: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Rows by word, the gravest first."""
    found = {each: [row for row in rows if word(row) == each] for each in WORDS}
    return {each: rows for each, rows in found.items() if rows}


def _keys(scenes: list[_Scene]) -> dict[str, list[str]]:
    """Variants of each term over all scenes."""
    every = dict.fromkeys(key for scene in scenes for key in scene.keys)
    return _variants(sorted(every, key=lambda key: _order(key[0])))


def _variants(keys: list[tuple[str, str]]) -> dict[str, list[str]]:
    """Names of the variants of each term."""
    return {term: [name for _, name in each] for term, each in grouped(keys, lambda key: key[0]).items()}


def _environment() -> jinja2.Environment:
    """The templates of a run's pages."""
    environment = page_environment()
    environment.filters |= {"address": _address, "picture": _picture, "assignments": _assignments}
    environment.globals["variant"] = method.find
    return environment
