"""Audits of the references: right ones pass, wrong ones are found and judge nobody."""

from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest

from termwise import reference
from termwise.reference import backend, store
from termwise.reports import run
from termwise.reports.statistics import accumulation
from termwise.reports.study import audits, study, subjects
from termwise.scenes.limits import Limit, correct, physical
from termwise.scenes.model import Scene
from tests.scenes import small

NAMES = ("two_cubes", "cornell_box", "monkey")
TERMS = ("ambient", "direct", "specular")


def audited(scene: Scene, term: Any, folder: Path, *, spp: int = 640, change: Any = None) -> dict[str, str]:
    """Test -> word, for the true integral of a term; `change` alters the replicates of the first integrator."""
    limit = correct(term, scene.scope)
    kept = store.replicates(scene, limit, spp=spp, seed=3, count=16, folder=folder)
    if change:
        kept = kept._replace(images=change(kept.images))
    (plain,) = audits.second_limits(scene, [limit])
    spp = audits.second_samples(spp)
    second = store.replicates(scene, plain, spp=spp, seed=3, count=16, folder=folder, by_second=True)
    rows = audits.decide(
        audits.audits(
            scene,
            {limit: kept},
            {plain: second},
            compare=lambda ours, other, what: accumulation.measure(ours, other, scale=1.0),
        )
    )
    for row in rows:
        if row["word"] != audits.ABSENT:
            # Where it agrees, it could have seen a few per cent.
            assert row["detectable_bias"] < 0.04, row
    return {row["test"]: row["word"] for row in rows}


@pytest.mark.slow
@pytest.mark.parametrize("term", TERMS)
@pytest.mark.parametrize("name", NAMES)
def test_second_integrators_agree(name: str, term: str, tmp_path: Path):
    """All rooms and terms; nothing is allowed to differ, at 5 % over the tests of a pair."""
    words = audited(small(name), term, tmp_path)
    assert set(words) == {"halves", "second integrator"}
    assert audits.DISAGREES not in words.values()


def test_a_gain_is_found(tmp_path: Path):
    """5 % too bright: the halves agree, the second integrator does not."""
    words = audited(small("cornell_box"), "direct", tmp_path, change=lambda images: images * np.float32(1.05))
    assert words == {"halves": audits.AGREES, "second integrator": audits.DISAGREES}


def test_a_drift_is_found(tmp_path: Path):
    """The second half of the replicates 2 % brighter."""

    def drift(images: np.ndarray) -> np.ndarray:
        factor = np.where(np.arange(len(images)) < len(images) // 2, 1.0, 1.02).astype(np.float32)
        return images * factor[:, None, None, None]

    assert audited(small("cornell_box"), "direct", tmp_path, change=drift)["halves"] == audits.DISAGREES


@pytest.mark.slow
def test_a_wrong_weight_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Samples of the lobe without their masking G1(wo): value and density of the second integrator have it."""
    backend.import_mitsuba()
    import drjit as dr

    from termwise.reference.bsdf import CookTorrance

    right = CookTorrance.sample

    def unmasked(self: Any, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
        bs, weight = right(self, ctx, si, sample1, sample2, active)
        wh = dr.normalize(si.wi + bs.wo)
        return bs, dr.select(dr.any(weight > 0.0), self._factor(si, active) * self._fresnel(dr.dot(si.wi, wh)), 0.0)

    reference._loaded.clear()
    monkeypatch.setattr(CookTorrance, "sample", unmasked)
    try:
        words = audited(small("two_cubes"), "specular", tmp_path)
    finally:
        reference._loaded.clear()
    assert words["second integrator"] == audits.DISAGREES


def test_which_limits_have_a_second_integrator():
    """Plain light transport has; rings, kernels, the shadow rule, other rays and full transport have none."""
    scene = small("two_cubes")
    assert all(reference.has_second(scene, correct(term, "all")) for term in TERMS)
    assert reference.has_second(scene, Limit("specular", scope="all", lobe=4 / np.pi))
    others = [
        physical("direct"),
        correct("background", "all"),
        Limit("ambient", rings=8),
        Limit("ambient", occluded=False),
        Limit("direct", scope="all", shadows="paper"),
        Limit("specular", scope="all", cosine="outgoing"),
        Limit("specular", scope="all", diffuse=0.5),
    ]
    assert not any(reference.has_second(scene, limit) for limit in others)
    for change in ({"ignore": "object"}, {"normals": "face"}):
        assert not reference.has_second(attrs.evolve(scene, **change), correct("direct", "all"))


@pytest.mark.slow
def test_a_reference_that_disagrees_judges_nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Second integrators three times as bright: rows of the three terms and their sum have no verdict, and say why."""
    monkeypatch.setattr(run, "cache_folder", lambda: tmp_path / "cache")
    right = reference.replicate_parts

    def brighter(*arguments: Any, by_second: bool = False, **settings: Any) -> Any:
        parts = right(*arguments, by_second=by_second, **settings)
        return {term: image * np.float32(3.0) for term, image in parts.items()} if by_second else parts

    monkeypatch.setattr(reference, "replicate_parts", brighter)
    chosen = attrs.evolve(
        study.load("quick"),
        scenes=("two_cubes",),
        resolution=(12, 12),
        audit=True,
        variants=study.Variants(direct=("next-event",)),
    )
    scenes = subjects.scenes_of(chosen)
    results = run.measure(chosen, scenes, tmp_path, name="quick", report=lambda *_: None)
    judged = {(row["term"], row["variant"]): row for row in results["cells"] if row["verdict"] is not None}
    for key, row in judged.items():
        if key[0] == "transmission":
            assert row["verdict"] == "ABSENT"
            continue
        if key[0] == "background" or "paper" in key[1] or key == ("direct", "next-event"):
            continue  # a kernel reference has no second integrator
        assert row["verdict"] == "NO VERDICT", row
        assert row["reference_audit"] == audits.DISAGREES
        assert "second integrator" in row["sentence"]
    assert judged["background", "seen"]["verdict"] != "NO VERDICT"
    assert run.failures(results)
