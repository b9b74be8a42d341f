"""The benchmark of terms: every setting of Mitsuba's renders the reference's own integral; speed is not tested.

Rationale: seconds to equal error mean nothing for a setting that converges to something else. Mitsuba's `direct` does,
with several samples of a point light.
"""

import json

import numpy as np
import pytest

from termwise import reference
from termwise.reference.backend import active, import_mitsuba
from termwise.reports import cli
from termwise.scenes import limits
from tests.scenes import small

CASE = {"scene", "term", "scope", "variant", "target_rmse", "ours_s", "mitsuba_s", "mitsuba_setting"}
CASE |= {"speedup", "speedup_low", "speedup_high"}


@pytest.fixture(autouse=True)
def _vectorised():
    import_mitsuba()
    if active().variant != "llvm_ad_rgb":
        pytest.skip("the benchmark needs llvm_ad_rgb")


@pytest.mark.parametrize(
    ("name", "term", "scope", "step"),
    [
        ("cornell_box", "ambient", "first-hit", 1),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                ("cornell_box", "direct", "first-hit", 1),
                ("monkey", "direct", "first-hit", 1),
                ("two_cubes", "direct", "all", 1),
                ("two_cubes", "specular", "all", 3),
            )
        ),
    ],
)
def test_every_setting_converges_to_the_reference(name, term, scope, step):
    """16 x 16 pixels, 64 samples or so of each: the mean lies within 4 % of the reference's.

    The noisiest, chains with independent samples, have a standard error of about 1 %. Chains take long to compile: of
    theirs every third setting, which has each number of occlusion rays.
    """
    from termwise.reports.bench import yardstick

    scene, limit = small(name, 16), limits.correct(term, scope)
    truth = np.mean([reference.replicate(scene, limit, spp=256, seed=0, replicate=k) for k in range(2)])
    assert truth > 0
    for setting in list(yardstick.settings(reference.loaded(scene), limit))[::step]:
        image, seconds = setting.render(setting.samples(64), seed=3)
        assert image.shape == (16, 16, 3)
        assert seconds > 0
        assert image.mean() == pytest.approx(truth, rel=0.04), setting.name


def test_a_tiny_run_says_all(tmp_path):
    """16 x 16 pixels of one term: the keys of cases and curves, and errors inside both sides' curves."""
    assert (
        cli.measuring.terms(scene=["monkey"], term=["ambient"], resolution=16, runs=1, seconds=0.01, out=tmp_path) == 0
    )
    measured = json.loads((tmp_path / "bench" / "terms.json").read_text("utf-8"))
    assert set(measured) >= {"cases", "curves", "machine"}
    assert len(measured["cases"]) == 3
    (ours,) = [each for each in measured["curves"] if each["side"] == "ours"]
    for case in measured["cases"]:
        assert set(case) >= CASE
        assert (case["scene"], case["term"], case["variant"]) == ("monkey", "ambient", "cosine")
        assert min(ours["rmse"]) < case["target_rmse"] < max(ours["rmse"])
        assert case["speedup_low"] <= case["speedup"] <= case["speedup_high"]
        assert case["truth_rmse"] < case["target_rmse"] / 3
    for each in measured["curves"]:
        assert len(each["samples"]) == len(each["rmse"]) == len(each["seconds"]) > 1
    assert (tmp_path / "bench" / "index.html").is_file()
