"""Pixels of a scene's images for the viewer, as scripts beside its page: browsers refuse to fetch from `file://`.

Each image is a script `data/SCENE/NAME.js`, loaded when the viewer first needs it, that hands its pixels to a
callback. Pixels are float32 in the bytes of little-endian machines, sorted by their place within the number (all first
bytes, all second ones, ...), deflated, in base64. An image is its mean, bit by bit that of the EXR, then the standard
error of that mean, kept to 11 bits; a FLIP map is one plane of 11 bits.

The maps of the viewer, Y the luminance, I ours, R the reference, s² the variance of a mean over replicates:

    signed      (Y(I) - Y(R)) / mean Y(R)
    relative    (Y(I) - Y(R)) / max(Y(R), FLOOR · mean Y(R))
    deviations  (I - R) / sqrt(s_I² + s_R²), of the channel where it is greatest
    flip        LDR-FLIP (Andersson et al. 2020) of both as displayed at the scene's exposure
"""

import base64
import json
import shutil
import zlib
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from flip_evaluator import evaluate
from plotly.colors import hex_to_rgb, sequential
from scipy import stats

from reports.metrics import encode
from reports.page import pictures
from reports.verdict import LUMINANCE
from scenes.store import write_atomically

FLOOR = 0.01
"""Least luminance that the relative error divides by, of the reference's mean: black pixels have no relative error."""
DEVIATIONS = 4.0
"""End of the scale of deviations: noise alone passes it in one of some ten thousand pixels."""
AGAINST = ("own", "correct", "physical")
_KEPT_BITS = 11
_DEGREES = 256
"""Degrees of freedom up to which the page knows Student's quantiles; beyond, they differ by less than 0.3 %."""


def write_data(run: Path, scene: Any) -> dict[str, Any] | None:
    """Write the scripts of a scene's pixels; returns what the viewer knows of them, None if the scene has no cell.

    Parameters
    ----------
    run : Path
        A folder that holds `results.nc`.
    scene
        With `name`, `described` and `row(term, variant, against)`.

    Returns
    -------
    dict or None
        `terms`: for each the variants, each with its image's key and, by name, the references' keys; `scales`: the
        ends ±q of the maps by term and reference, shared by its variants, q the quantile of the static pictures.
    """
    dataset = scene.dataset(run)
    if not dataset.sizes["cell"]:
        return None
    exposure = float(dataset.attrs.get("exposure", scene.described["exposure"] or 1.0))
    folder = run / "data" / scene.name
    ours, references = dataset["image"].values, dataset["reference"].values
    for kind, name in (("ours", "image"), ("limit", "reference")):
        means = dataset[name].values
        noisy = f"{name}_variance" in dataset
        errors = np.sqrt(dataset[f"{name}_variance"].values) if noisy else np.full_like(means, np.nan)
        for index, (mean, error) in enumerate(zip(means, errors, strict=True)):
            _write(folder, f"{kind}-{index}", np.stack([np.asarray(mean, np.float32), _rounded(error)]))

    terms: dict[str, Any] = {}
    found: dict[tuple[str, str], dict[str, list[np.ndarray]]] = {}
    for cell, (term, variant) in enumerate(
        zip(dataset["cell_term"].values.astype(str), dataset["cell_variant"].values.astype(str), strict=True)
    ):
        against = {}
        for name in AGAINST:
            limit = int(dataset[name].values[cell]) if name in dataset else -1
            if limit < 0:
                continue
            signed, mean = pictures.relative_error(ours[cell], references[limit])
            luminance = references[limit].astype(np.float64) @ LUMINANCE
            maps = found.setdefault((term, name), {"signed": [], "relative": []})
            maps["signed"].append(signed)
            maps["relative"].append(signed * mean / np.maximum(luminance, FLOOR * mean))
            row = scene.row(term, variant, name) or scene.row(term, variant, "own") or {}
            against[name] = {
                "key": f"limit-{limit}",
                "limit": str(dataset["limit_name"].values[limit]),
                "mean": mean,
                "replicates": row.get("reference_replicates"),
                "flip": _write_flip(folder, cell, limit, ours[cell], references[limit], exposure),
            }
        row = scene.row(term, variant, "own") or {}
        terms.setdefault(term, []).append(
            {
                "name": variant,
                "key": f"ours-{cell}",
                "verdict": row.get("verdict"),
                "replicates": row.get("replicates"),
                "against": against,
            }
        )
    scales: dict[str, Any] = {}
    for (term, name), maps in found.items():
        scales.setdefault(term, {})[name] = {
            each: pictures.error_scale(errors) for each, errors in maps.items()
        }
    return {
        "scene": scene.name,
        "folder": f"data/{quote(scene.name)}/",
        "exposure": exposure,
        "height": ours.shape[1],
        "width": ours.shape[2],
        "terms": terms,
        "scales": scales,
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


def _rounded(values: np.ndarray) -> np.ndarray:
    """float32 rounded to a few bits of mantissa, for deflation; not finite values as they are."""
    mantissa, exponent = np.frexp(np.asarray(values, np.float32))
    kept = np.ldexp(np.round(mantissa * 2.0**_KEPT_BITS) / 2.0**_KEPT_BITS, exponent)
    return kept.astype(np.float32)


def _sequential() -> list[list[int]]:
    """256 colours from black to pale yellow, those that FLIP is shown in."""
    knots = np.array([hex_to_rgb(colour) for colour in sequential.Magma])
    places = np.linspace(0, len(knots) - 1, 256)
    return (
        np.round([np.interp(places, np.arange(len(knots)), each) for each in knots.T]).T.astype(int).tolist()
    )
