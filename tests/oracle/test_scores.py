"""The scores of independent rows, `z = (mean of ours - reference) / SE`, follow Student's t with Welch's dof.

Rationale: every verdict is read off that distribution. A standard error that is too small proves biases that are not
there, one too large hides those that are; neither shows in a single row. Under the null F_t(z) is uniform, which the
Kolmogorov-Smirnov test of SciPy decides, but only over rows that share nothing: here each has seeds of its own on our
side and a reference of its own, Mitsuba's or exact. Rows are of all terms, of unbiased variants against the term's
integral and of wrong ones against their own limits; kernel estimates are biased by design and take no part.
"""

import numpy as np
import pytest
from scipy import stats

from termwise import reference
from termwise.renderer import VARIANTS, Engine, find
from termwise.renderer.terms import Variant
from termwise.reports.statistics.accumulation import measure
from termwise.reports.study import closed_forms
from termwise.scenes.analytic import furnace
from termwise.scenes.terms import Term
from tests.scenes import small

# The fewest of which a variance is asked, 4 a side: fat tails, which a normal distribution would not fit.
REPLICATES = 4
SAMPLES = 4


def replicates(engine: Engine, variant: Variant, seed: int) -> np.ndarray:
    """Ours, (REPLICATES, H, W, 3)."""
    images = []
    for number in range(REPLICATES):
        *_, (_, image, _) = engine.prefixes(variant, samples=SAMPLES, seed=seed, replicate=number, chain="path")
        images.append(image)
    return np.array(images)


def score(ours: np.ndarray, theirs: np.ndarray, *, exact: bool = False) -> tuple[float, float]:
    """z and its degrees of freedom, of the luminance of the image's mean, as a verdict has them."""
    found = measure(ours, theirs, exact=exact).luminance
    return float(found.bias / found.standard_error), float(found.dof)


def exact_scores() -> list[tuple[float, float]]:
    """Furnaces, `gloss (lobe A(mu_o) + diffuse)` by quadrature: each specular variant at 18 settings."""
    scores = []
    settings = [(a, mu, f0) for a in (0.3, 0.6) for mu in (0.3, 0.6, 0.9) for f0 in (0.1, 0.5, 1.0)]
    for roughness, mu_o, f0 in settings:
        scene = furnace(roughness=roughness, mu_o=mu_o, f0=f0)
        with Engine(scene, threads=1) as engine:
            for variant in VARIANTS["specular"].values():
                limit = variant.limit(scene, SAMPLES)
                value = closed_forms.albedo(limit, scene.objects[0].material, mu_o)
                ours = replicates(engine, variant, seed=1000 + len(scores))
                scores.append(score(ours, np.broadcast_to(value, (1, *ours.shape[1:])), exact=True))
    return scores


# How many rows of each scene and variant, which differ by the seeds of both sides: more where Mitsuba is quick.
ROWS: dict[str, dict[tuple[Term, str], int]] = {
    "cornell_box": {("ambient", "cosine"): 14, ("direct", "next-event"): 6, ("direct", "path"): 6},
    "monkey": {
        ("ambient", "cosine"): 12,
        ("direct", "next-event"): 12,
        ("direct", "path"): 12,
        ("specular", "vndf"): 3,
        ("background", "seen"): 20,
    },
    "two_cubes": {("ambient", "cosine"): 4, ("direct", "next-event"): 4, ("background", "seen"): 12},
}


def mitsuba_scores() -> list[tuple[float, float]]:
    scores = []
    for name, rows in ROWS.items():
        # Without scattered light `next-event` is unbiased; `path` has it always.
        scene = small(name, 16, scope="first-hit")
        with Engine(scene, threads=1) as engine:
            for (term, variant), count in rows.items():
                limit = find(term, variant).limit(scene, SAMPLES)
                for _ in range(count):
                    seed = len(scores)
                    theirs = [
                        reference.replicate(scene, limit, spp=SAMPLES, seed=seed, replicate=k)
                        for k in range(REPLICATES)
                    ]
                    ours = replicates(engine, find(term, variant), seed=seed + 1)
                    scores.append(score(ours, np.array(theirs)))
    return scores


def p_value(z: np.ndarray, dof: np.ndarray) -> float:
    return float(stats.kstest(stats.t.cdf(z, dof), "uniform").pvalue)


@pytest.mark.slow
def test_scores_follow_student_s_t(record_property):
    """p > 1 % over the rows of each kind of reference and over all of them.

    What the test must see is planted in the same rows and rejected: all scores shifted by 3, and, over all rows,
    standard errors that are off by a factor of 2 either way. That factor moves the distribution function by 0.16 at
    z = 0.7, and 200 rows resolve 1.63 / sqrt(200) = 0.12 at 1 %.
    """
    kinds = [np.array(exact_scores()).T, np.array(mitsuba_scores()).T]
    z, dof = np.concatenate(kinds, axis=1)
    assert len(z) > 200
    for name, rows in (("exact", kinds[0]), ("Mitsuba", kinds[1]), ("all", (z, dof))):
        p = p_value(*rows)
        record_property(f"rows and p, {name}", f"{len(rows[0])}, {p:.3f}")
        assert p > 0.01
        assert p_value(rows[0] + 3, rows[1]) < 1e-6
    assert p_value(z / 2, dof) < 0.01
    assert p_value(2 * z, dof) < 0.01
    # Nor does the normal distribution fit: with so few replicates the t has fatter tails.
    assert np.mean(np.abs(z) > 3) > 2 * stats.norm.sf(3) * 2


def test_rows_that_share_a_reference_do_not():
    """Why each row has its own: 100 rows against one noisy reference are all off by its error, and rejected."""
    rng = np.random.default_rng(1)
    theirs = 1 + 0.1 * rng.normal(size=(REPLICATES, 8, 8, 3)) + 0.05 * rng.normal(size=(REPLICATES, 1, 1, 1))
    shared = [score(1 + 0.1 * rng.normal(size=theirs.shape), theirs) for _ in range(100)]
    assert p_value(*np.array(shared).T) < 1e-6
