"""The benchmark of rays: both sides trace the same rays and meet the same scene; speed itself is not tested.

Rationale: a ratio of rates means nothing if one side misses what the other hits.
"""

import json

import pytest

from termwise.reports import cli
from termwise.reports.bench import rays

KEYS = {"mesh", "triangles", "kind", "ours_mrays", "mitsuba_mrays", "ratio", "ratio_low", "ratio_high"}


def test_every_kind_of_ray_hits_alike(monkeypatch, tmp_path):
    """36 and 968 triangles, all kinds: hit or miss is Mitsuba's for all but 1 ray in 1000, and the file says all."""
    monkeypatch.setattr(rays, "_SHORTEST", 0.0)
    assert cli.measuring.rays(mesh=["boxes", "monkey"], pairs=1, count=4096, out=tmp_path) == 0
    measured = json.loads((tmp_path / "bench" / "rays.json").read_text("utf-8"))
    assert [(case["mesh"], case["kind"]) for case in measured["cases"]] == [
        (mesh, kind) for mesh in ("boxes", "monkey") for kind in rays.KINDS
    ]
    for case in measured["cases"]:
        assert set(case) >= KEYS
        assert case["ratio"] > 0
        assert case["differ"] <= case["rays"] / 1000
    # Few polygons are kept twice, for waves and for what they leave to the tree.
    boxes, monkey = (row["bytes_per_triangle"] for row in measured["builds"])
    assert boxes <= 300
    assert monkey <= 200


def test_unknown_mesh_is_named():
    with pytest.raises(ValueError, match="mesh = 'teapot'"):
        rays.measure(only=("teapot",))
