"""The rule in its order: ABSENT, BIASED, EQUIVALENT, UNDERPOWERED; and what may not reach it.

Rationale: the words decide whether a renderer is trusted, so the rule is written a second time here, from the
pixels, with scipy's own Welch interval and a jackknife that really leaves replicates out.
"""

import contextlib
import json
import pickle

import attrs
import numpy as np
import pytest
from scipy import stats

from termwise.reports.statistics import accumulation
from termwise.reports.statistics.accumulation import measure
from termwise.reports.statistics.headline import headline
from termwise.reports.statistics.rule import decide, judge, margin_of
from termwise.reports.statistics.sentence import percent
from termwise.reports.statistics.verdict import LEVEL
from tests.verdict import synthetic

WEIGHTS = np.array([0.2126, 0.7152, 0.0722])


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


@pytest.fixture
def pair(rng, replicates, picture) -> tuple[np.ndarray, np.ndarray]:
    """Ours and reference of one limit, K = R = 16, 32 × 48 px."""
    ours, reference = (replicates(rng, picture(32, 48)) for _ in range(2))
    return ours, reference


# The rule, written again.

QUANTITIES = np.array([WEIGHTS, *np.eye(3)])
SHARES = (1 / 2, 1 / 6, 1 / 6, 1 / 6)


def blocks(images: np.ndarray, side: int) -> np.ndarray:
    count, height, width = images.shape
    return images.reshape(count, height // side, side, width // side, side).mean(axis=(2, 4))


def windows(images: np.ndarray) -> np.ndarray:
    _, height, width = images.shape
    corners = [(y, x) for y in range(0, height - 4, 4) for x in range(0, width - 4, 4)]
    return np.stack([images[:, y : y + 8, x : x + 8].mean(axis=(1, 2)) for y, x in corners], axis=1)


def borders(images: np.ndarray) -> np.ndarray:
    lines = images[:, 0], images[:, -1], images[:, :, 0], images[:, :, -1]
    return np.stack([line.mean(axis=1) for line in lines], axis=1)


def off(ours: np.ndarray, reference: np.ndarray, level: float, limit: float, least: float) -> bool:
    """Whether any of some places (n, places) lies outside ±limit."""
    interval = stats.ttest_ind(ours, reference, equal_var=False).confidence_interval(1 - level)
    scale = np.maximum(reference.mean(axis=0), least)
    return bool(np.any((interval.low > limit * scale) | (interval.high < -limit * scale)))


def shape(ours: np.ndarray, reference: np.ndarray, side: int) -> tuple[float, float]:
    """θ and its jackknife error, in radiance²."""
    a, b = blocks(ours, side), blocks(reference, side)

    def theta(a: np.ndarray, b: np.ndarray) -> float:
        square = (a.mean(axis=0) - b.mean(axis=0)) ** 2
        return float(np.mean(square - a.var(axis=0, ddof=1) / len(a) - b.var(axis=0, ddof=1) / len(b)))

    variance = 0.0
    for left in (
        [theta(np.delete(a, i, axis=0), b) for i in range(len(a))],
        [theta(a, np.delete(b, i, axis=0)) for i in range(len(b))],
    ):
        variance += (len(left) - 1) * np.var(left)
    return theta(a, b), float(np.sqrt(variance))


def rule(ours, reference, objects, tests, allowance, margin, kernel) -> str:
    """docs/verdicts.md, for images whose noise is far above every floor and hardly skewed."""
    ours, reference = ours.astype(np.float64), reference.astype(np.float64)
    level, tolerated = 0.05 / tests, 0.001 + allowance
    mean = reference.mean(axis=(0, 1, 2)) @ WEIGHTS
    for inside in [np.ones(objects.shape, dtype=bool)] + [objects == i for i in np.unique(objects[objects >= 0])]:
        x, y = (each[:, inside].mean(axis=1) for each in (ours, reference))
        if off(x, y, level, tolerated, 0.1 * mean):
            return "BIASED"
    degrees = min(len(ours), len(reference)) - 1
    bound, typical = 0.0, np.median(blocks(reference @ WEIGHTS, 8).mean(axis=0))
    for quantity, share in zip(QUANTITIES, SHARES, strict=True):
        a, b = ours @ quantity, reference @ quantity
        scale = max(b.mean(), 0.1 * mean)
        for side, limit in ((1, 0.01), (2, 0.005), (8, 0.003)):
            theta, error = shape(a, b, side)
            if not kernel and theta - stats.t.ppf(1 - share * level, degrees) * error > (limit * scale) ** 2:
                return "BIASED"
        bound = max(bound, (theta + stats.t.ppf(0.95, degrees) * error) / scale**2)
        usual = max(min(scale, np.median(blocks(b, 8).mean(axis=0))), 0.1 * min(mean, typical))
        tiles = [blocks(each, 16).reshape(len(each), -1) for each in (a, b)]
        for x, y, least in ((*tiles, usual), (windows(a), windows(b), usual), (borders(a), borders(b), 0.1 * usual)):
            if not kernel and off(x, y, share * level / x.shape[1], 0.005, least):
                return "BIASED"
    if bound >= (0.03 if kernel else 0.01) ** 2:
        return "UNDERPOWERED"
    for channel in range(3):
        x, y = (each[..., channel].mean(axis=(1, 2)) for each in (ours, reference))
        low, high = stats.ttest_ind(x, y, equal_var=False).confidence_interval(0.9)
        scale = max(y.mean(), 0.1 * mean)
        if low <= (-margin - allowance) * scale or high >= (margin + allowance) * scale:
            return "UNDERPOWERED"
    return "EQUIVALENT"


@pytest.mark.slow
def test_the_rule_written_twice(rng, replicates, picture):
    """200 random rows: gains, tiles, ramps, colours, single pixels, borders and noises around every limit.

    Expected: the same word in each.
    """
    y, x = np.mgrid[:32, :48]
    objects = np.where(x < 10, 0, np.where(y > 25, 3, -1))
    words = []
    for _ in range(200):
        mean = picture(32, 48)
        field = 1 + rng.choice([0.0, rng.normal(0, 0.01)])
        field = field + rng.choice([0.0, rng.normal(0, 0.06)]) * ((y < 16) & (x < 16))
        field = field + rng.choice([0.0, rng.normal(0, 0.03)]) * (x / 24 - 1)
        noise = 10 ** rng.uniform(-2.5, -0.5)
        field = field + rng.choice([0.0, rng.normal(0, 0.05)], p=[0.7, 0.3]) * ((x + y) % 2 - 0.5)
        field = field + rng.choice([0.0, rng.normal(0, 0.05)], p=[0.7, 0.3]) * (x == 47)
        colour = rng.choice([0.0, rng.normal(0, 0.03)], p=[0.7, 0.3]) * (x / 24 - 1)
        field = field[..., None] + colour[..., None] * [1.0, -0.2126 / 0.7152 / 0.7, 0.0]  # luminance is kept
        ours = replicates(rng, mean * field, int(rng.integers(8, 17)), noise=noise)
        reference = replicates(rng, mean, 12, noise=noise)
        options = {
            "allowance": float(rng.choice([0.0, 0.01])),
            "margin": float(rng.choice([0.005, 0.01])),
            "kernel": bool(rng.integers(2)),
        }
        tests = int(rng.choice([15, 600]))
        statistics = measure(ours, reference, objects=objects)
        assert statistics.tests == 15
        assert statistics.mean_tests == 9
        found = decide(statistics, tests=tests, **options).verdict
        assert found == rule(ours, reference, objects, tests=tests, **options)
        words.append(found)
    assert min(words.count(word) for word in ("BIASED", "EQUIVALENT", "UNDERPOWERED")) >= 10, "all are visited"


def test_wrong_variants_have_their_own_words(rng, replicates, picture):
    ours, reference = (replicates(rng, picture(32, 32), noise=0.01) for _ in range(2))
    same, doubled = measure(ours, reference), measure(ours * np.float32(2), reference)
    assert [decide(each, tests=9).verdict for each in (same, doubled)] == ["EQUIVALENT", "BIASED"]
    wrong = [decide(each, tests=9, kind="wrong").verdict for each in (same, doubled)]
    assert wrong == ["AS PREDICTED", "NOT AS PREDICTED"]


def test_a_proven_bias_inside_the_margin_is_still_a_bias(rng, replicates, picture):
    """+0.5 % at a standard error of 0.01 %: the interval lies inside ±1 %, and outside ±0.1 %."""
    ours, reference = (replicates(rng, gain * picture(32, 32), noise=0.009) for gain in (1.005, 1.0))
    statistics = measure(ours, reference)
    assert decide(statistics, tests=9).verdict == "BIASED"
    assert decide(statistics, tests=9, allowance=0.01, kernel=True).verdict == "EQUIVALENT"


def test_what_is_proven_and_tolerated_is_said(rng, replicates, picture):
    """-0.07 % at a standard error of 0.003 %: no error by the rule, and the sentence names it."""
    ours, reference = (replicates(rng, gain * picture(32, 32), noise=0.003) for gain in (0.9993, 1.0))
    verdict = judge(ours, reference)
    assert verdict.verdict == "EQUIVALENT"
    assert verdict.tolerated[0].startswith("mean of image, ")
    assert "proven, but too small to be an error: mean of image, " in verdict.sentence
    null = judge(*(replicates(rng, picture(32, 32), noise=0.003) for _ in range(2)))
    assert null.tolerated == ()
    assert "too small" not in null.sentence


def test_a_mean_of_a_few_pixels_certifies_nothing_of_the_others(rng, replicates, picture):
    """Four pixels are 99 % of the light, and the noise of all others, 3 % off, is too large to prove it anywhere."""
    mean, bright = picture(64, 64), np.zeros((64, 64, 1), dtype=bool)
    bright[[5, 20, 50, 60], [7, 40, 10, 60]] = True

    def lit(gain: float, noise: float) -> np.ndarray:
        return np.where(bright, 1e5, replicates(rng, gain * mean, noise=noise))

    off = measure(lit(1.03, 0.7), lit(1.0, 0.7))
    verdict = decide(off, tests=off.tests)
    assert abs(verdict.bias) < 0.001
    assert verdict.verdict == "UNDERPOWERED"
    assert any(each.startswith("the picture but for a few bright pixels, which are most") for each in verdict.reasons)
    assert headline(verdict, off).startswith(
        "not decided: but for a few bright pixels, which are most of the mean: betw"
    )
    sure = measure(lit(1.1, 0.1), lit(1.0, 0.1))
    proven = decide(sure, tests=sure.tests)
    assert proven.verdict == "BIASED"
    assert headline(proven, sure).endswith(", which are most of the mean: 10 % too bright")
    # The mean of the others' own shares, by hand.
    tiles = [
        images.reshape(16, 8, 8, 8, 8, 3).mean(axis=(2, 4)) @ WEIGHTS for images in (lit(1.03, 0.7), lit(1.0, 0.7))
    ]
    assert off.rest is not None
    truth = tiles[1].mean(axis=0)
    dark = truth < off.term_mean
    assert dark.sum() == 60
    shares = [np.mean((each / np.maximum(truth, off.typical))[:, dark], axis=1) for each in tiles]
    assert abs(off.rest.bias - (shares[0].mean() / shares[1].mean() - 1)) < 6 * off.rest.standard_error
    assert verdict.samples_ratio is None  # more samples would prove it
    noisy = measure(lit(1.0, 3.0), lit(1.0, 3.0))
    verdict = decide(noisy, tests=noisy.tests)
    assert verdict.verdict == "UNDERPOWERED"
    assert verdict.samples_ratio is not None
    assert verdict.samples_ratio > 1
    right = measure(lit(1.0, 0.1), lit(1.0, 0.1))
    assert decide(right, tests=right.tests).verdict == "EQUIVALENT"
    plain = measure(replicates(rng, mean), replicates(rng, mean))
    assert plain.rest is None


@pytest.mark.parametrize(("count", "others"), [(4, 4), (16, 4), (4, 16)])
def test_noise_of_dark_tiles_is_no_bias_of_their_mean(rng, count, others):
    """Of two sides that are alike; divided by the reference's noisy tiles alone, ours was 2 % too bright of 4 and 4."""

    def lit(n: int, gain: float = 1.0) -> np.ndarray:
        images = gain * rng.gamma(1 / 9, 9.0, (n, 256, 256, 1)) * np.ones(3)
        images[:, :4, :4] = 2e5
        return images

    found = []
    for gain in (1.0, 1.1):
        rests = [rest for _ in range(3) if (rest := measure(lit(count, gain), lit(others)).rest)]
        error = np.sqrt(np.sum([rest.standard_error**2 for rest in rests])) / len(rests)
        found.append((np.mean([rest.bias for rest in rests]) - (gain - 1)) / error)
    assert np.abs(found).max() < 3.5


def test_words_are_made_for_what_is_named_alone(rng, replicates, picture, monkeypatch):
    """Of two thousand places that are off; at 1080p there may be half a million."""
    ours, reference = replicates(rng, 1.2 * picture(96, 96), noise=0.02), replicates(rng, picture(96, 96), noise=0.02)
    statistics, made = measure(ours, reference), []
    counted = lambda value: made.append(value) or percent(value)  # noqa: E731
    monkeypatch.setattr("termwise.reports.statistics.rule.percent", counted)
    verdict = decide(statistics, tests=9)
    assert "the largest of 529 of 529 8-px windows" in " ".join(verdict.reasons)
    assert 0 < len(made) < 100


def test_threads_change_no_bit(rng, replicates, picture, monkeypatch):
    """Parts of a wide image are read by several threads, and added up in their order."""
    monkeypatch.setattr(accumulation, "_ALONE", 0)
    ours, reference = (replicates(rng, picture(40, 600), noise=0.1) for _ in range(2))
    threaded = measure(ours, reference)
    monkeypatch.setattr(accumulation, "mapping", lambda threaded: contextlib.nullcontext(map))
    alone = measure(ours, reference)
    assert pickle.dumps(attrs.asdict(threaded)) == pickle.dumps(attrs.asdict(alone))


@pytest.mark.parametrize(("noise", "words"), [(0.0, ("BIASED",)), (0.3, ("UNDERPOWERED", "BIASED"))])
def test_a_few_bright_pixels_hide_nothing(rng, replicates, picture, noise, words):
    """Four pixels are 99 % of the light, all others 10 % off: the image's mean is right, and the image is not."""
    mean, bright = picture(64, 64), np.zeros((64, 64, 1), dtype=bool)
    bright[[5, 20, 50, 60], [7, 40, 10, 60]] = True
    ours, reference = replicates(rng, 1.1 * mean, noise=0.1), replicates(rng, mean, noise=0.1)
    for images in (ours, reference):
        lamps = 1e5 * (rng.gamma(1 / noise**2, noise**2, (16, 64, 64, 1)) if noise else np.ones((16, 64, 64, 1)))
        images[:] = np.where(bright, lamps, images)
    verdict = judge(ours, reference)
    assert abs(verdict.bias) < 0.002 or noise
    assert verdict.verdict in words
    assert any("8-px windows" in reason and "tile x" in reason for reason in verdict.reasons)


def test_rounding_of_stored_values_is_no_bias(rng):
    """A constant that half floats cannot hold, on one side alone: off by 0.02 %, which is the file format's."""
    exact = np.full((8, 32, 32, 3), 0.3001) * rng.uniform(0.99, 1.01, (1, 32, 32, 1))
    half = exact.astype(np.float16).astype(np.float32)
    off = np.abs(half / exact - 1).max()
    assert 1e-4 < off < 2**-11
    plain = measure(half, exact[:1].astype(np.float32), exact=True)
    known = measure(half, exact[:1].astype(np.float32), exact=True, quantum=(2**-11, 0.0))
    assert np.any(plain.tiles[8].p_values() < 1e-6)
    assert np.all(known.tiles[8].p_values() > 0.5)
    doubled = measure(1.01 * half, exact[:1].astype(np.float32), exact=True, quantum=(2**-11, 0.0))
    assert decide(doubled, tests=9).verdict == "BIASED"
    with pytest.raises(ValueError, match="quantum is"):
        measure(half, half, quantum=(-0.1, 0.0))


def test_kernel_rows_print_the_shape_without_judging_it(rng, replicates, picture):
    mean = picture(32, 32)
    ramp = np.where(np.arange(32) < 16, 1.01, 0.99)[None, :, None]
    statistics = measure(*(replicates(rng, each, noise=0.01) for each in (mean * ramp, mean)))
    assert decide(statistics, tests=9).verdict == "BIASED"
    kernel = decide(statistics, tests=9, kernel=True, allowance=0.02)
    assert kernel.verdict == "EQUIVALENT"
    assert any("printed, not judged" in warning for warning in kernel.warnings)


def test_objects_are_judged_by_name(rng, replicates, picture):
    """A gain of 5 % on an object of 36 px, which the image's mean cannot see."""
    mean = picture(64, 64)
    objects = np.full((64, 64), -1, dtype=np.int32)
    objects[40:46, 20:26] = 1
    field = np.where(objects == 1, 1.05, 1.0)[..., None]
    ours, reference = (replicates(rng, each, noise=0.02) for each in (mean * field, mean))
    verdict = judge(ours, reference, objects=objects, object_names=("floor", "lamp"))
    assert verdict.verdict == "BIASED"
    assert any(reason.startswith("mean of lamp, ") for reason in verdict.reasons)
    assert verdict.tests == 3 * 2 + 6
    lamp = next(region for region in verdict.regions if (region.region, region.channel) == ("lamp", "green"))
    assert lamp.low < 0.05 < lamp.high


# Zeros and floors.


def test_absent_needs_exact_zeros_on_both_sides():
    zeros = np.zeros((4, 20, 20, 3))
    verdict = judge(zeros, zeros)
    assert verdict.verdict == "ABSENT"
    assert verdict.tests is None
    assert measure(zeros, zeros).tests == 0
    named = decide(measure(zeros, zeros, scale=2.0), tests=0, reason="no light in the scene")
    assert "no light in the scene" in named.sentence
    almost = zeros.copy()
    almost[2, 3, 4, 1] = 1e-30
    assert judge(almost, zeros).verdict != "ABSENT"
    assert judge(zeros, almost[2:3], exact=True).verdict != "ABSENT"


def test_zero_reference_tolerates_nothing_that_is_proven(rng):
    """A stray 0.05 % of the total, below what is tolerated elsewhere, is BIASED where nothing should be."""
    zeros = np.zeros((16, 16, 16, 3))
    stray = np.abs(rng.normal(5e-4, 1e-4, zeros.shape))
    assert decide(measure(stray, zeros, scale=1.0), tests=9).verdict == "BIASED"
    assert judge(stray, zeros).bias == pytest.approx(1.0)
    # One photon in one replicate proves nothing (t = 1), and is far below the margin of the total.
    once = zeros.copy()
    once[3, 4, 4] = 1e-3
    assert decide(measure(once, zeros, scale=1.0), tests=9).verdict == "EQUIVALENT"


def test_places_that_a_sparse_estimator_never_reached_prove_nothing(rng):
    """value / p with probability p, unbiased: 16-px tiles without a sample have no variance, and a bias of -100 %."""
    false_alarms = 0
    for _ in range(40):
        ours, reference = ((rng.random((16, 64, 64, 1)) < 1e-3) * np.full(3, 1e3) for _ in range(2))
        false_alarms += judge(ours, reference).verdict == "BIASED"
    # 5 % by the rule; the t test of so skewed a mean has a little more. Without the loan: 14 of 40.
    assert false_alarms <= 6


def test_an_object_with_hardly_an_event_proves_nothing(rng):
    """Its light lies in 2 pixels that one sample in 60 finds: all 16 replicates of one sample miss it half the time."""
    objects = np.zeros((32, 32), int)
    objects[:16, :28] = 1
    chance = np.where(objects == 0, 0.9, 0.0)
    chance[3, 4:6] = 1 / 60

    def draw(samples: int) -> np.ndarray:
        return rng.binomial(samples, chance, (16, 32, 32))[..., None] * np.full(3, 0.4 / samples)

    missed, alarms = 0, 0
    for _ in range(100):
        ours = draw(1)
        missed += not ours[:, objects == 1].any()
        alarms += decide(measure(ours, draw(64), objects=objects), tests=600).verdict == "BIASED"
    assert missed > 40
    assert alarms <= 2
    # Where the object is bright as others are, to have lost it is proven.
    chance[objects == 1] = 0.5
    ours = draw(1)
    ours[:, objects == 1] = 0.0
    assert decide(measure(ours, draw(64), objects=objects), tests=600).verdict == "BIASED"


def photons(rng, per_replicate: int) -> np.ndarray:
    """16 replicates (48 x 48): steady light 1, and 0.1 more in rare events of 4 x 4 px, Poisson in number."""
    counts = rng.poisson(per_replicate / 144, (16, 12, 12, 1))
    event = 0.1 * 48 * 48 / per_replicate
    steady = synthetic.replicates(rng, np.ones((48, 48, 3)), noise=0.02)
    return steady + counts.repeat(4, axis=1).repeat(4, axis=2) * np.full(3, event / 16)


@pytest.mark.slow
def test_events_that_no_replicate_met_prove_nothing(rng):
    """One photon a replicate: an object of 1/12 of the image gets none of 16 in a quarter of the runs, unbiased."""
    objects = np.zeros((48, 48), int)
    objects[:, :4] = 1
    missed = 0
    for _ in range(100):
        ours = photons(rng, 1)
        statistics = measure(ours, photons(rng, 256), objects=objects)
        verdict = decide(statistics, tests=600)
        assert verdict.verdict == "UNDERPOWERED"
        # Welch's test alone is sure of the lack: -9 % with intervals of a few tenths.
        alone = statistics.regions.interval(LEVEL / 600)[1][2] < -0.05
        assert any("no proof" in reason and "object 1" in reason for reason in verdict.reasons) == alone.any()
        missed += alone.any()
    assert 10 < missed < 45, "exp(-16/12) = 0.26 of the runs"
    # That 40 events are missing, or 20 of twice the size, cannot be.
    objects[:, :12] = 1
    ours = photons(rng, 1)
    ours[:, :, :12] *= 0.02
    verdict = decide(measure(ours, photons(rng, 256), objects=objects), tests=600)
    assert verdict.verdict == "BIASED"
    assert verdict.place.startswith("object 1")


@pytest.mark.slow
def test_ordinary_noise_has_no_rare_events(rng, replicates, picture):
    """Gamma noise: wherever t proves a bias, no events that were missed explain it."""
    for noise, count in ((0.05, 4), (0.3, 8), (1.0, 16), (0.3, 32)):
        for _ in range(20):
            ours, reference = (replicates(rng, picture(64, 64), count, noise=noise) for _ in range(2))
            statistics = measure(ours, reference)
            for places in (statistics.regions, statistics.tiles[16]):
                level = 0.05 / 600 / 64
                half = places.interval(level)[1] - places.bias
                # Not of each place: of some, few replicates agree by chance, and t trusts them too much.
                assert np.median(places.missing(level)) < np.median(half)


def test_a_term_that_is_lost_everywhere_is_proven(replicates, picture, rng):
    """Black replicates against light; exact ones too."""
    mean = picture(32, 32)
    black = np.zeros((16, 32, 32, 3))
    assert judge(black, replicates(rng, mean), noiseless=True).verdict == "BIASED"
    assert judge(black, mean[None], exact=True, noiseless=True).verdict == "BIASED"
    assert judge(replicates(rng, mean), np.zeros((1, 32, 32, 3)), exact=True).verdict == "BIASED"


def test_a_term_that_is_lost_in_one_place_is_proven(rng, replicates, picture):
    """16 x 16 px are 0 in all replicates of ours, which is sure of itself everywhere else."""
    mean = picture(64, 64)
    ours, reference = (replicates(rng, mean, noise=0.3) for _ in range(2))
    ours[:, 16:32, 32:48] = 0.0
    verdict = judge(ours, reference)
    assert verdict.verdict == "BIASED"
    assert any("tile x 32-47, y 16-31" in reason for reason in verdict.reasons)


def test_black_replicates_are_no_equal_seeds(rng):
    """A few replicates of a sparse estimator are black alike; the rest differ everywhere."""
    ours, reference = rng.gamma(4.0, 0.25, (2, 16, 16, 16, 3))
    ours[[3, 7, 9]] = 0.0
    assert judge(ours, reference).verdict in ("UNDERPOWERED", "BIASED")


def test_noise_free_rows_are_judged_by_the_floors():
    """Equal replicates of a constant: an error of 1e-7 is rounding, 1 % is not, and no number is NaN."""
    constant = np.full((4, 16, 16, 3), 0.5)
    assert judge(constant, constant, noiseless=True).verdict == "EQUIVALENT"
    near = judge(constant * (1 + 1e-7), constant[:1], exact=True, noiseless=True)
    assert near.verdict == "EQUIVALENT"
    verdict = judge(constant * 1.01, constant, noiseless=True)
    assert verdict.verdict == "BIASED"
    assert any("taken as free of noise" in warning for warning in verdict.warnings)
    assert "NaN" not in json.dumps(verdict.row())


# Input that is no estimate.


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
def test_values_that_are_not_finite_are_a_bias(pair, value):
    ours, reference = pair[0].astype(np.float64), pair[1]
    ours[5, 20, 7, 2] = value
    verdict = judge(ours, reference)
    assert verdict.verdict == "BIASED"
    assert verdict.reasons[0].startswith("1 values not finite, 0 negative, the first: blue is")
    assert "in ours[5]" in verdict.reasons[0]
    assert verdict.place == "x 7, y 20"
    assert "NaN" not in json.dumps(verdict.row()), "the rest is measured all the same"


def test_negative_values_are_a_bias_for_every_kind(pair):
    ours = pair[0].copy()
    ours[:, 0, 0, 0] = -1e-6
    statistics = measure(ours, pair[1])
    assert (statistics.negative, statistics.non_finite) == (16, 0)
    assert decide(statistics, tests=9).verdict == "BIASED"
    assert decide(statistics, tests=9, kind="wrong", kernel=True).verdict == "NOT AS PREDICTED"


@pytest.mark.parametrize("value", [np.nan, np.inf, -0.5])
def test_a_broken_reference_is_refused(pair, value):
    pair[1][2, 3, 4, 0] = value
    with pytest.raises(ValueError, match=r"^reference\[2\]: red is .* at x 4, y 3; a reference is finite"):
        measure(*pair)


def test_equal_replicates_are_refused(pair):
    ours, reference = pair
    twice = ours.copy()
    twice[9] = twice[2]
    with pytest.raises(ValueError, match=r"ours\[2\] and ours\[9\] are the same image: equal seeds"):
        measure(twice, reference)
    with pytest.raises(ValueError, match=r"a.exr and j.exr are the same"):
        judge(twice[2:], reference, names=["a.exr", *"bcdefg", "j.exr"])
    with pytest.raises(ValueError, match=r"ours\[0\] and reference\[0\] are the same"):
        measure(ours, ours)
    with pytest.raises(ValueError, match=r"ours\[7\] and reference\[0\] are the same"):
        measure(ours, ours[7:8], exact=True)


def test_a_side_that_never_varies_has_equal_seeds_unless_it_has_no_noise(pair):
    """16 copies of one image would halve the noise that the judge sees, and a pass would mean nothing."""
    ours, reference = pair
    copies = np.repeat(ours[:1], 16, axis=0)
    with pytest.raises(ValueError, match=r"all replicates of ours .* equal seeds\? .*--noiseless"):
        judge(copies, reference)
    with pytest.raises(ValueError, match=r"all replicates of the reference .* equal seeds\? .*--reference-exact"):
        judge(ours, np.repeat(reference[:1], 16, axis=0))
    assert "ours are the same image" in judge(copies, reference, noiseless=True).warnings[0]


def test_equal_replicates_by_chance_are_a_warning(rng):
    """Two pixels that flip between two values: of 16 images many must be equal, and no seed is."""
    ours, reference = np.ones((2, 16, 12, 12, 3))
    for images in (ours, reference):
        images[:, :2, 0] += rng.integers(0, 2, (16, 2, 1))
    assert any("possible by chance" in warning for warning in measure(ours, reference).warnings)


def test_few_replicates(pair):
    ours, reference = pair
    for arguments, message in (
        ((ours[:3], reference), "ours: 3 replicates; at least 4"),
        ((ours[:1], reference), "ours: 1 replicate; at least 4 are needed, each with a seed of its own"),
        ((ours, reference[:3]), "reference: 3 replicates"),
        ((ours, reference[:1]), "reference: 1 replicate; .* exact"),
    ):
        with pytest.raises(ValueError, match=message):
            measure(*arguments)
    with pytest.raises(ValueError, match="an exact reference is one image"):
        measure(ours, reference, exact=True)
    assert any(warning.startswith("replicates: 8 of ours: fewer") for warning in measure(ours[:8], reference).warnings)
    assert measure(ours, reference).warnings == ()
    assert "taken as exact" in judge(ours, reference[0].mean(axis=0) + 0 * reference[0], exact=True).sentence


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ours": np.ones((4, 8, 9, 3))}, r"ours: images of shape \(8, 9, 3\), but the reference's are \(8, 8, 3\)"),
        ({"ours": np.ones((4, 8, 8))}, r"ours: shape \(4, 8, 8\); allowed"),
        ({"ours": np.ones((4, 8, 8, 4))}, "ours: shape"),
        ({"ours": np.ones((4, 0, 8, 3))}, "ours: shape"),
        ({"ours": np.ones((4, 8, 8, 3), dtype=np.uint8)}, "ours: dtype uint8"),
        ({"objects": np.zeros((8, 9), dtype=int)}, "objects: int64"),
        ({"objects": np.zeros((8, 8))}, "objects: float64"),
        ({"scale": 0.0}, "scale is 0.0"),
        ({"scale": np.nan}, "scale is nan"),
    ],
)
def test_bad_input_is_named(change, message):
    arguments = {"ours": np.ones((4, 8, 8, 3)), "reference": np.ones((4, 8, 8, 3))} | change
    with pytest.raises(ValueError, match=message):
        measure(**arguments)


def test_judge_takes_lists_of_images_and_names_the_one_that_differs():
    images = [np.full((8, 8, 3), 0.5, dtype=np.float32) for _ in range(4)]
    assert judge(images, images[0], exact=True, noiseless=True).verdict == "EQUIVALENT"
    with pytest.raises(ValueError, match=r"c.exr: shape \(9, 8, 3\) differs from \(8, 8, 3\) of a.exr"):
        judge([*images[:2], np.ones((9, 8, 3)), images[3]], images, names=["a.exr", "b.exr", "c.exr"])
    with pytest.raises(ValueError, match="ours: shape"):
        judge([], images)


@pytest.mark.parametrize(
    "options", [{"kind": "odd"}, {"tests": 8}, {"margin": 0.0}, {"allowance": -0.1}, {"margin": np.nan}, {"samples": 0}]
)
def test_bad_options_are_refused(pair, options):
    with pytest.raises(ValueError, match=next(iter(options))):
        decide(measure(*pair), **{"tests": 9, **options})


# What is reported.


def test_rows_that_are_not_judged_have_numbers_but_no_word(pair):
    verdict = decide(measure(pair[0] * np.float32(1.5), pair[1]), tests=600, judged=False, predicted_bias=0.5)
    assert verdict.verdict is None
    assert (verdict.family_low, verdict.detectable_bias, verdict.tests) == (None, None, None)
    assert verdict.bias_low < 0.5 < verdict.bias_high
    assert "predicted +50.00%" in verdict.sentence


def test_a_smaller_level_means_a_wider_interval_and_a_larger_detectable_bias(pair):
    few, many = (decide(measure(*pair), tests=tests).row() for tests in (9, 6000))
    ends = [many["family_low"], few["family_low"], few["bias_low"], few["bias"], few["bias_high"], few["family_high"]]
    assert ends == sorted(ends)
    assert many["detectable_bias"] > few["detectable_bias"] > 0.001
    assert "5%/6000" in many["sentence"]


@pytest.mark.parametrize("noise", [0.01, 3.0], ids=["quiet", "noisy"])
@pytest.mark.parametrize("gain", [1.0, 1.1])
@pytest.mark.parametrize("options", [{}, {"kernel": True, "allowance": 0.01}, {"kind": "wrong"}], ids=str)
def test_the_sentence_says_all_that_a_paper_needs(rng, replicates, picture, noise, gain, options):
    """Word, interval and its level, K and R, what was tested, n and level, margin, detectable bias, what stays open."""
    mean = picture(32, 32)
    ours, reference = replicates(rng, gain * mean, 12, noise), replicates(rng, mean, 16, noise)
    statistics = measure(ours, reference, objects=np.zeros((32, 32), dtype=int))
    verdict = decide(statistics, tests=600, **options)
    kernel, allowance = options.get("kernel", False), options.get("allowance", 0.0)
    for words in (
        f"{verdict.verdict}: relative bias of the mean luminance {verdict.bias:+.2%} [{verdict.bias_low:+.2%}, "
        f"{verdict.bias_high:+.2%}] (90 %)",
        "K = 12 replicates against R = 16",
        f"6 Welch tests of means (image and 1 object; red, green, blue; up to {0.001 + allowance:.2%} tolerated)",
        "of n = 600 in the run, each at 5%/600",
        f"the margin of ±{0.01 + allowance:.2%}",
        f"smallest detectable bias of the image's mean {verdict.detectable_bias:.2%} (found in 80% of runs)",
    ):
        assert words in verdict.sentence
    for words in (
        "3 of shape (single pixels, 2-px blocks, 8-px tiles), 3 of places (outermost rows and columns, 16-px tiles, "
        "8-px windows)",
        f"of an outermost row or column {verdict.detectable_border:.2%}, of 8 × 8 px {verdict.detectable_window:.2%}, "
        f"of the shape over 8-px tiles {verdict.detectable_shape:.2%} rms",
    ):
        assert (words in verdict.sentence) is not kernel
    if verdict.verdict in ("BIASED", "NOT AS PREDICTED"):
        assert verdict.reasons[0] in verdict.sentence
        assert verdict.sentence.endswith("further errors are not excluded.")
    else:
        few = "one of the shape or of a place, which is printed and not judged"
        few = few if kernel else "one of fewer than 8 × 8 px that adds less to these"
        left = f"not excluded: a smaller one, {few}, and a shape error of up to {verdict.rms_bias_high:.2%} rms"
        assert left in verdict.sentence
    if verdict.verdict == "UNDERPOWERED":
        assert "times the samples on both sides" in verdict.sentence or "likely" in verdict.sentence


def test_the_row_is_plain_json(pair):
    verdict = decide(measure(*pair), tests=9, samples=16, seconds=2.5)
    assert json.loads(json.dumps(verdict.row()))["verdict"] == verdict.verdict
    assert {field.name for field in attrs.fields(type(verdict))} == set(verdict.row())


def test_margins_of_wrong_variants():
    assert margin_of("right", 1.0, 1.0) == 0.01
    assert margin_of("wrong", 1.0, 2.0) == 0.01
    assert margin_of("wrong", 2.0, 1.7) == pytest.approx(0.0075)
    assert margin_of("wrong", 1.0, 1.01) == 0.005
    assert margin_of("wrong", 0.0, 1.0) == 0.01


# Reading.


def test_bands_and_memory_maps_change_nothing(tmp_path, rng, replicates, picture, monkeypatch):
    """Three bands and a memory map give what one band of an array gives; borders cut tiles of every size."""
    ours, reference = (replicates(rng, picture(75, 45), count=6) for _ in range(2))
    objects = rng.integers(-1, 3, (75, 45))
    whole = decide(measure(ours, reference, objects=objects), tests=600)
    np.save(tmp_path / "ours.npy", ours)
    monkeypatch.setattr("termwise.reports.statistics.replicates.BAND_BYTES", 1)
    banded = measure(np.load(tmp_path / "ours.npy", mmap_mode="r"), reference, objects=objects)
    found, expected = decide(banded, tests=600).row(), whole.row()
    numbers = ["bias", "bias_low", "standard_error", "rms_bias", "rms_bias_high", "detectable_bias"]
    np.testing.assert_allclose([found[key] for key in numbers], [expected[key] for key in numbers], rtol=1e-9)
    assert found["tile"] == expected["tile"]
    np.testing.assert_allclose(
        [region["bias"] for region in found["regions"]], [region["bias"] for region in expected["regions"]], rtol=1e-9
    )


def test_tiles_cover_the_image_once(rng, replicates, picture):
    """The image's mean is the area-weighted mean of the tiles of any size."""
    statistics = measure(*(replicates(rng, picture(37, 50), count=5) for _ in range(2)))
    for side, tiles in statistics.tiles.items():
        edges = [np.diff(np.append(np.arange(0, length, side), length)) for length in (37, 50)]
        area = np.outer(*edges)
        assert tiles.bias.shape == (4, *area.shape)
        assert np.average(tiles.ours[0], weights=area) == pytest.approx(float(statistics.luminance.ours))


def test_p_values_leave_out_what_does_not_vary(rng, replicates, picture):
    mean = picture(32, 32)
    mean[:16, :16] = 0.0
    p = measure(*(replicates(rng, mean) for _ in range(2))).tiles[16].p_values()[0]
    assert np.isnan(p[0, 0])
    assert np.count_nonzero(np.isnan(p)) == 1
