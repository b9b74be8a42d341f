"""Pixels of a scene's images for the viewer, as scripts beside its page: browsers refuse to fetch from `file://`.

Each image is a script `data/SCENE/NAME.js`, loaded when the viewer first needs it, that hands its pixels to a
callback. Pixels are float32 in the bytes of little-endian machines, sorted by their place within the number (all first
bytes, all second ones, ...), deflated, in base64. An image is its mean, bit by bit that of the EXR, then the standard
error of that mean, kept to 11 bits; a FLIP map is one plane of 11 bits. The tests of a cell's tiles are one script,
of `reports.statistics.tiles.MAPS` for each size, in this order, row by row. A cell's sweep is, for each of its
prefixes, the luminance of each tile of 8 px and its standard error; the reference's is one such pair.

The maps of the viewer, Y the luminance, I ours, R the reference, s² the variance of a mean over replicates:

    signed      (Y(I) - Y(R)) / mean Y(R)
    relative    (Y(I) - Y(R)) / max(Y(R), FLOOR · mean Y(R))
    deviations  (I - R) / sqrt(s_I² + s_R²), of the channel where it is greatest
    p           Welch's test of no bias in a tile, against the own limit alone (see `reports.statistics.tiles`)
    flip        LDR-FLIP (Andersson et al. 2020) of both as displayed at the scene's exposure
"""

import base64
import json
import shutil
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from flip_evaluator import evaluate
from plotly.colors import hex_to_rgb, sequential
from scipy import stats

from termwise.reports.pages import pictures
from termwise.reports.results import microscope
from termwise.reports.statistics.metrics import encode
from termwise.reports.statistics.replicates import LUMINANCE, TILE_SIDES
from termwise.reports.statistics.tiles import LEVEL, MAPS
from termwise.scenes.store import write_atomically

FLOOR = 0.01
"""Least luminance that the relative error divides by, of the reference's mean: black pixels have no relative error."""
DEVIATIONS = 4.0
"""End of the scale of deviations: noise alone passes it in one of some ten thousand pixels."""
AGAINST = ("own", "correct", "physical")
_KEPT_BITS = 11
_DEGREES = 256
"""Degrees of freedom up to which the page knows Student's quantiles; beyond, they differ by less than 0.3 %."""


def write_data(run: Path, scene: Any, variables: Mapping[str, np.ndarray], exposure: float) -> dict[str, Any] | None:
    """Write the scripts of a scene's pixels; returns what the viewer knows of them, None if the scene has no cell.

    Parameters
    ----------
    run : a folder, which gets the folder `data`.
    scene
        With `name` and `row(term, variant, against)`.
    variables : by name, those of the scene in `results.nc`.
    exposure : factor on the radiance that is shown.

    Returns
    -------
    `terms`: for each the variants, each with its image's key and, by name, the references' keys; `scales`: the ends ±q
    of the maps, of luminance and of a channel, by term and reference, shared by its variants, q the quantile of the
    static pictures.
    """
    cells = [variables[name].astype(str).tolist() for name in ("cell_term", "cell_variant")]
    if not cells[0]:
        return None
    folder = run / "data" / scene.name
    ours, references = variables["image"], variables["reference"]
    for kind, name in (("ours", "image"), ("limit", "reference")):
        means = variables[name]
        noisy = f"{name}_variance" in variables
        errors = np.sqrt(variables[f"{name}_variance"]) if noisy else np.full_like(means, np.nan)
        for index, (mean, error) in enumerate(zip(means, errors, strict=True)):
            _write(folder, f"{kind}-{index}", np.stack([np.asarray(mean, np.float32), _rounded(error)]))

    swept = "sweep_luminance" in variables and microscope.has_pieces(variables)  # an earlier version's run has neither
    if swept:
        for limit in range(len(references)):
            _write(folder, f"sweep-limit-{limit}", _reference_tiles(variables, limit))

    terms: dict[str, Any] = {}
    found: dict[tuple[str, str], dict[str, list[np.ndarray]]] = {}
    for cell, (term, variant) in enumerate(zip(*cells, strict=True)):
        against = {}
        for name in AGAINST:
            limit = int(variables[name][cell]) if name in variables else -1
            if limit < 0:
                continue
            signed, mean = pictures.relative_error(ours[cell], references[limit])
            luminance = references[limit].astype(np.float64) @ LUMINANCE
            channels = pictures.channel_errors(ours[cell], references[limit], mean)
            share = mean / np.maximum(luminance, FLOOR * mean)
            each = {
                "signed": signed,
                "relative": signed * share,
                "signed channel": channels,
                "relative channel": channels * share[..., None],
            }
            maps = found.setdefault((term, name), {kind: [] for kind in each})
            for kind, error in each.items():
                maps[kind].append(error)
            row = scene.row(term, variant, name) or scene.row(term, variant, "own") or {}
            against[name] = {
                "key": f"limit-{limit}",
                "sweep": f"sweep-limit-{limit}" if swept else None,
                "limit": str(variables["limit_name"][limit]),
                "mean": mean,
                "replicates": row.get("reference_replicates"),
                "flip": _write_flip(folder, cell, limit, ours[cell], references[limit], exposure),
            }
        row = scene.row(term, variant, "own") or {}
        samples = _write_sweep(folder, variables, cell, f"sweep-ours-{cell}") if swept else []
        terms.setdefault(term, []).append(
            {
                "name": variant,
                "key": f"ours-{cell}",
                "verdict": row.get("verdict"),
                "replicates": row.get("replicates"),
                "samples": samples,
                "sweep": f"sweep-ours-{cell}",
                "tiles": _write_tiles(folder, variables, cell, f"tiles-{cell}"),
                "merged": {each["side"]: each["merged_into"] for each in row.get("tiles", [])},
                "against": against,
            }
        )
    scales: dict[str, Any] = {}
    for (term, name), maps in found.items():
        scales.setdefault(term, {})[name] = {each: pictures.error_scale(errors) for each, errors in maps.items()}
    return {
        "scene": scene.name,
        "folder": f"data/{quote(scene.name)}/",
        "exposure": exposure,
        "height": ours.shape[1],
        "width": ours.shape[2],
        "terms": terms,
        "scales": scales,
        "sweep_side": microscope.SIDE,
        "sides": TILE_SIDES,
        "maps": MAPS,
        "level": LEVEL,
        "sure": pictures.SURE,
        "palest": pictures.PALEST,
        "greys": pictures.GREYS,
        "nothing": pictures.NOTHING,
        "floor": FLOOR,
        "deviations": DEVIATIONS,
        "luminance": LUMINANCE,
        "invalid": pictures.INVALID.tolist(),
        "diverging": pictures.diverge(np.linspace(-1.0, 1.0, 255), scale=1.0).tolist(),
        "sequential": _sequential(),
        "quantiles": [
            round(float(each), 5) for each in stats.t.ppf(0.95, np.arange(1, _DEGREES + 1))
        ],  # of a 90 % interval
    }


def clear(run: Path) -> None:
    """Remove the scripts that an earlier run left."""
    shutil.rmtree(run / "data", ignore_errors=True)


def pack(values: np.ndarray) -> str:
    """float32 of any shape as text: bytes sorted by place, deflated, base64."""
    places = np.ascontiguousarray(values, "<f4").reshape(-1, 1).view(np.uint8).T
    return base64.b64encode(zlib.compress(np.ascontiguousarray(places).tobytes())).decode("ascii")


def _write(folder: Path, key: str, values: np.ndarray) -> None:
    text = f"termwisePixels({json.dumps(key)}, {json.dumps(pack(values))});\n"
    write_atomically(folder / f"{key}.js", lambda temporary: temporary.write_text(text, "ascii"))


def _write_flip(
    folder: Path, cell: int, limit: int, ours: np.ndarray, reference: np.ndarray, exposure: float
) -> str | None:
    """The key of the FLIP map of a pair; None where a pixel is invalid, of which FLIP knows nothing."""
    if not (np.isfinite(ours).all() and np.isfinite(reference).all()):
        return None
    key = f"flip-{cell}-{limit}"
    if (folder / f"{key}.js").exists():  # the own limit of a right variant is the correct one too
        return key
    right, its = (encode(image, exposure=exposure).astype(np.float32) for image in (reference, ours))
    flip, _, _ = evaluate(right, its, "LDR", inputsRGB=True, applyMagma=False, computeMeanError=False)
    _write(folder, key, _rounded(np.asarray(flip)[..., 0]))
    return key


def _write_tiles(folder: Path, variables: Mapping[str, np.ndarray], cell: int, key: str) -> str | None:
    """The key of the tests of a cell's tiles; None where the run has none of it."""
    names = [f"tile_{name}_{side}" for side in TILE_SIDES for name in MAPS]
    if not all(name in variables for name in names):
        return None
    tests = np.concatenate([variables[name][cell].ravel() for name in names])
    if not np.isfinite(tests).any():
        return None
    _write(folder, key, tests)
    return key


def _write_sweep(folder: Path, variables: Mapping[str, np.ndarray], cell: int, key: str) -> list[int]:
    """Write a cell's sweep; its prefixes, none for the total."""
    samples = [count for count in variables["sweep_samples"][cell].tolist() if count]
    if samples:
        mean, variance = (variables[f"sweep_{name}"][cell][: len(samples)] for name in ("luminance", "variance"))
        _write(folder, key, _rounded(np.stack([mean, np.sqrt(variance)], axis=1)))
    return samples


def _reference_tiles(variables: Mapping[str, np.ndarray], limit: int) -> np.ndarray:
    """(2, tiles) luminance of a reference's tiles and its standard error, of their pieces in each replicate."""
    stack = variables["reference_pieces"][limit]
    stack = stack[~np.isnan(stack).all(axis=1)]
    rows, columns = (variables[f"piece_{axis}"] // microscope.SIDE for axis in "yx")
    tile, pixels = rows * (columns.max() + 1) + columns, variables["piece_pixels"]
    means = np.array([np.bincount(tile, pixels * each) for each in stack]) / np.bincount(tile, pixels)
    if len(stack) < 2:
        return np.stack([means.mean(axis=0), np.full(means.shape[1], np.nan)])
    return np.stack([means.mean(axis=0), means.std(axis=0, ddof=1) / np.sqrt(len(stack))])


def _rounded(values: np.ndarray) -> np.ndarray:
    """float32 rounded to a few bits of mantissa, for deflation; not finite values as they are."""
    mantissa, exponent = np.frexp(np.asarray(values, np.float32))
    kept = np.ldexp(np.round(mantissa * 2.0**_KEPT_BITS) / 2.0**_KEPT_BITS, exponent)
    return kept.astype(np.float32)


def _sequential() -> list[list[int]]:
    """256 colours from black to pale yellow, those that FLIP is shown in."""
    knots = np.array([hex_to_rgb(colour) for colour in sequential.Magma])
    places = np.linspace(0, len(knots) - 1, 256)
    return np.round([np.interp(places, np.arange(len(knots)), each) for each in knots.T]).T.astype(int).tolist()
