"""Where the thresholds of `thresholds.toml` come from; run by hand: `python tests/images/calibrate.py [SCENE ...]`.

Two further seeds, A and B, are measured as the tests measure theirs. Of mean images without any bias,

    E MSE(ours, reference) = E MSE(ours A, ours B)/2 + E MSE(reference A, reference B)/2,

so the right side, which compares each side with itself alone, is the noise that a perfect renderer cannot fall below:
its root is the ceiling of accuracy. That of SSIM is the smaller of SSIM(ours A, ours B) and
SSIM(reference A, reference B). A fault of ours moves neither. The thresholds are the ceilings with the slack below. The
verdicts of both seeds are compared with each other as well: they must be the same words.
"""

import sys
import tempfile
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import xarray

from termwise.reports import run
from termwise.reports.statistics import metrics
from termwise.reports.study import study, subjects
from termwise.scenes.load import load

HERE = Path(__file__).parent
SEEDS = 1001, 1002
RMSE_SLACK = 1.25
"""Factor on the ceiling: an estimate from two seeds of an error that has heavy tails."""
SILHOUETTE_SLACK = 1.6
"""The same for `background`: all its noise sits in the few pixels of the silhouettes, so its estimate is the worst."""
SSIM_SLACK = 1.5
"""Factor on the ceiling's distance from 1, for the same reason."""


def default_images(folder: Path, results: dict[str, Any]) -> dict[tuple[str, str], tuple[np.ndarray, np.ndarray]]:
    """Mean images (ours, own reference), each (H, W, 3) float64, of each scene's default variants and of their sum."""
    images = {}
    for scene in results["settings"]["scenes"]:
        with xarray.open_dataset(folder / "results.nc", group=scene, engine="h5netcdf") as group:
            for index, term in enumerate(group.cell_term.values.tolist()):
                if (scene, term) not in images:  # the first of a term's variants is its default
                    pair = group.image[index], group.reference[int(group.own[index])]
                    images[scene, term] = tuple(np.asarray(each, np.float64) for each in pair)
    return images


def main(*scenes: str) -> None:
    """Print the table of some scenes, or of all, ready to be read beside `thresholds.toml`."""
    chosen = study.load(HERE / "study.toml")
    assert chosen.seed not in SEEDS
    words, images = [], []
    for seed in SEEDS:
        seeded = attrs.evolve(chosen, seed=seed)
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            results = run.measure(
                seeded, subjects.scenes_of(seeded, scenes), folder, name="calibration", report=lambda *_: None
            )
            images.append(default_images(folder, results))
        judged = [row for row in results["cells"] if row["verdict"]]
        words.append({(row["scene"], row["term"], row["variant"]): row["verdict"] for row in judged})
    print(f"# {'scene':24}{'term':12}{'rmse ceiling':>14}{'ssim ceiling':>14}{'rmse <=':>10}{'ssim >=':>10}")
    for (scene, term), first in images[0].items():
        if not first[1].any():
            continue
        pairs = list(zip(first, images[1][scene, term], strict=True))
        rmse = float(np.sqrt(np.mean([metrics.rmse(a, b) ** 2 for a, b in pairs])))
        ssim = min(metrics.ssim(a, b, exposure=load(scene).exposure) for a, b in pairs)
        slack = SILHOUETTE_SLACK if term == "background" else RMSE_SLACK
        least = 1 - SSIM_SLACK * (1 - ssim)
        print(f"  {scene:24}{term:12}{rmse:14.5f}{ssim:14.5f}{slack * rmse:10.5f}{least:10.5f}")
    for row, word in words[0].items():
        if words[1][row] != word:
            print("# verdicts differ:", *row, word, words[1][row])


if __name__ == "__main__":
    main(*sys.argv[1:])
