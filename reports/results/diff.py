"""What changed between two runs in verdict, bias, error and time; "worse" and "slower" only where a test says so.

A row is a scene, a term and a variant, against its own limit at its largest sample count. Of each, B after A,

    bias     δ_A, δ_B with standard errors            no change: ||δ_B| - |δ_A|| ≤ 0.1 %
    error    ln RMSE_A, ln RMSE_B, by the jackknife   no change: |ln ratio| ≤ ln 1.01
    time     ln of the seconds of each replicate      no change: |ln ratio| ≤ ln 1.05

are compared by Welch's t. As `||b| - |a|| = min(|b - a|, |b + a|)`, a bias moved away from 0, or towards it, where
both the difference and the sum exceed the tolerance: the larger p of the two is that of the row (an intersection-union
test). Runs that share a reference share its noise, which makes the test of bias and error conservative. All tests of
all rows share one chance of 5 % of a false finding (Holm). A verdict that proves an error, where it was no error
before, counts as worse: its test is that of its own run (`reports.statistics.rule`).

Replicates of one estimate follow each other in milliseconds, so whatever else the machine does then slows them all
alike, and Welch's t on them knows nothing of it: two runs of the same code, minutes apart, gave -61 ± 6 %. What the
machine does shows in the other estimates of the two runs, of other variants: the variance of a change is Welch's and
the mean square of their changes, and "slower" is what stands out of both. A factor that all share is never proven: it
stands beside the rows, as their median, and benchmarks whose sides take turns tell it from the machine
(`termwise bench`).
"""

import math
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from termwise.reports.statistics import tiles
from termwise.reports.statistics.verdict import LEVEL, NO_VERDICT, TOLERATED_BIAS, WORDS
from termwise.scenes.terms import TOTAL

TOLERATED = {"bias": TOLERATED_BIAS, "error": 0.01, "time": 0.05}
"""Changes up to these are none, however sure: a bias of the mean, a share of the RMSE, of the seconds."""
MEASURES = tuple(TOLERATED)
OTHERS_NEEDED = 4
"""Estimates beside one, for what the machine does to be told."""
FINDINGS = ("worse", "better", "changed")
"""The gravest first; "changed" is said of verdicts alone."""
FAILING = (*(wrong for wrong, _ in WORDS.values()), NO_VERDICT)
PASSING = tuple(right for _, right in WORDS.values())

Key = tuple[str, str, str]


class Effect(NamedTuple):
    """A difference, 0 without one, and how sure it is."""

    value: float
    standard_error: float
    dof: float

    def p(self, tolerated: float) -> float:
        """Chance of a value so far from 0 where the true one is `tolerated`."""
        if self.standard_error == 0.0:
            return float(abs(self.value) <= tolerated)
        ends = (
            (abs(self.value) - tolerated) / self.standard_error,
            (abs(self.value) + tolerated) / self.standard_error,
        )
        return min(1.0, float(sum(stats.t.sf(end, self.dof) for end in ends)))

    def interval(self) -> tuple[float, float]:
        """90 %."""
        half = float(stats.t.isf(0.05, self.dof)) * self.standard_error
        return self.value - half, self.value + half


def welch(before: tuple[float, float, float], after: tuple[float, float, float], *, sign: float = 1.0) -> Effect:
    """`after - sign * before` of two independent (value, standard error, degrees of freedom) (Welch 1947)."""
    (a, s_a, dof_a), (b, s_b, dof_b) = before, after
    square = s_a**2 + s_b**2
    if square == 0.0:
        return Effect(b - sign * a, 0.0, dof_a + dof_b)
    return Effect(b - sign * a, math.sqrt(square), square**2 / (s_a**4 / dof_a + s_b**4 / dof_b))


def diff(before: dict[str, Any], after: dict[str, Any]) -> dict[str, Any]:
    """Compare two runs, as `reports.results.read` gives them.

    Returns
    -------
    `settings`: differences, each with name, before, after. `rows`: scene, term, variant; `verdict`: before, after,
    finding; each of MEASURES: before, after, change with its 90 % interval (of a bias the difference, else the ratio
    minus 1), adjusted p and finding, or None where it is not tested. A finding is one of FINDINGS or ""; that of the
    row is the gravest. `only_before`, `only_after`: rows of one run. `failed`: scenes that failed, with the error in
    each run. `untested`: why a measure is not. `tests`, `level`, `tolerated`: of the tests. `time_median`: median over
    rows of the ratio of seconds. `worse`, `better`: how many rows have such a finding; `any_worse`: also where a scene
    fails in the second run alone.
    """
    old, new = _rows(before), _rows(after)
    pairs = {key: (old[key], new[key]) for key in old if key in new}
    times = _times(pairs)
    rows: list[dict[str, Any]] = [
        {
            "scene": key[0],
            "term": key[1],
            "variant": key[2],
            "verdict": _verdict(*(row["verdict"] for row in pair)),
            "bias": _bias(*pair),
            "error": _error(*pair),
            "time": times.get(key),
        }
        for key, pair in pairs.items()
    ]
    tested = [row[name] for row in rows for name in MEASURES if row[name]]
    for change, p in zip(tested, tiles.holm(np.array([change["p"] for change in tested])).tolist(), strict=True):
        direction = "worse" if change.pop("grew") else "better"
        change |= {"p": p, "finding": direction if p <= LEVEL else ""}
    failed = _failed(before, after)
    found = [{row[name]["finding"] for name in ("verdict", *MEASURES) if row[name]} for row in rows]
    for row, findings in zip(rows, found, strict=True):
        row["finding"] = next((word for word in FINDINGS if word in findings), "")
    ratios = [1.0 + row["time"]["change"] for row in rows if row["time"]]
    return {
        "before": _described(before),
        "after": _described(after),
        "settings": _settings(before, after, old, new),
        "level": LEVEL,
        "tests": len(tested),
        "tolerated": dict(TOLERATED),
        "rows": rows,
        "only_before": [list(key) for key in old if key not in new],
        "only_after": [list(key) for key in new if key not in old],
        "failed": failed,
        "untested": _untested(old, new, times),
        "time_median": float(np.median(ratios)) if ratios else None,
        "any_worse": any("worse" in each for each in found)
        or any(each["after"] and not each["before"] for each in failed),
        "worse": sum("worse" in each for each in found),
        "better": sum("better" in each for each in found),
    }


def said(measure: str, finding: str) -> str:
    """A finding as it is read: what is worse in time is slower."""
    return {"worse": "slower", "better": "faster"}.get(finding, finding) if measure == "time" else finding


def _rows(results: dict[str, Any]) -> dict[Key, dict[str, Any]]:
    """Rows against the own limit, at their largest sample count."""
    found: dict[Key, dict[str, Any]] = {}
    for row in results["cells"]:
        key = row["scene"], row["term"], row["variant"]
        if row["against"] == "own" and (key not in found or row["samples"] > found[key]["samples"]):
            found[key] = row
    return found


def _verdict(before: str | None, after: str | None) -> dict[str, Any]:
    finding = "changed" if before != after else ""
    if after in FAILING and before not in FAILING:
        finding = "worse"
    if before in FAILING and after in PASSING:
        finding = "better"
    return {"before": before, "after": after, "finding": finding}


def _dof(row: dict[str, Any]) -> float:
    """Of an estimate from replicates of both sides, at least; an exact reference has none."""
    counts = [row["replicates"], row["reference_replicates"]]
    return min(count for count in counts if count > 1) - 1


def _bias(before: dict[str, Any], after: dict[str, Any]) -> dict[str, Any] | None:
    if not (_has_light(before, "bias") and _has_light(after, "bias")):
        return None
    a, b = ((row["bias"], row["standard_error"], _dof(row)) for row in (before, after))
    difference, total = welch(a, b), welch(a, b, sign=-1.0)
    low, high = difference.interval()
    return {
        "before": a[0],
        "after": b[0],
        "change": difference.value,
        "low": low,
        "high": high,
        "p": max(each.p(TOLERATED["bias"]) for each in (difference, total)),
        "grew": abs(b[0]) > abs(a[0]),
    }


def _error(before: dict[str, Any], after: dict[str, Any]) -> dict[str, Any] | None:
    if not (_has_light(before, "rmse_high") and _has_light(after, "rmse_high")):
        return None

    def logarithm(row: dict[str, Any]) -> tuple[float, float, float]:
        # The interval of the MSE, symmetric, is that of the jackknife: t times its standard error.
        square, dof = row["rmse"] ** 2, _dof(row)
        error = (row["rmse_high"] ** 2 - square) / float(stats.t.isf(0.05, dof))
        return math.log(row["rmse"]), 0.5 * error / square, dof

    effect = welch(logarithm(before), logarithm(after))
    return _ratio("error", before["rmse"], after["rmse"], effect)


def _times(pairs: dict[Key, tuple[dict[str, Any], dict[str, Any]]]) -> dict[Key, dict[str, Any]]:
    """Changes of the seconds of a replicate; none where too few other estimates say what the machine does."""
    logarithms: dict[Key, list[np.ndarray]] = {}
    for key, rows in pairs.items():
        seconds = [np.array(row.get("replicate_seconds") or (), float) for row in rows]
        timed = all(len(each) > 1 and (each > 0).all() for each in seconds)
        # Equal seconds are those of kept replicates, which were rendered once.
        if timed and all(_has_light(row, "seconds") for row in rows) and seconds[0].tolist() != seconds[1].tolist():
            logarithms[key] = [np.log(each) for each in seconds]
    effects = {key: welch(*map(_mean, pair)) for key, pair in logarithms.items()}
    found = {}
    for key, effect in effects.items():
        # A change of the code changes its variant on all scenes; totals are the others once more.
        others = [o.value for each, o in effects.items() if each[1:] != key[1:] and each[1] != TOTAL]
        if len(others) < OTHERS_NEEDED:
            continue
        machine = 0.0, float(np.sqrt(np.mean(np.square(others)))), float(len(others))
        widened = welch(machine, (effect.value, effect.standard_error, effect.dof))
        before, after = (math.exp(each.mean()) for each in logarithms[key])
        found[key] = _ratio("time", before, after, widened)
    return found


def _mean(values: np.ndarray) -> tuple[float, float, float]:
    """Of independent values, its standard error and degrees of freedom."""
    return float(values.mean()), float(values.std(ddof=1) / math.sqrt(len(values))), len(values) - 1.0


def _ratio(name: str, before: float, after: float, effect: Effect) -> dict[str, Any]:
    change, low, high = (math.expm1(value) for value in (effect.value, *effect.interval()))
    return {
        "before": before,
        "after": after,
        "change": change,
        "low": low,
        "high": high,
        "p": effect.p(math.log1p(TOLERATED[name])),
        "grew": effect.value > 0,
    }


def _has_light(row: dict[str, Any], field: str) -> bool:
    return row["verdict"] != "ABSENT" and bool(row.get("rmse")) and row.get(field) is not None


def _untested(
    old: dict[Key, dict[str, Any]], new: dict[Key, dict[str, Any]], times: dict[Key, dict[str, Any]]
) -> list[str]:
    """Why whole measures are not tested, a sentence each."""
    without = [
        name
        for name, rows in (("first", old), ("second", new))
        if not any(row.get("replicate_seconds") for row in rows.values())
    ]
    if without:
        return [f"time: the {' and the '.join(without)} run holds no seconds of single replicates"]
    few = f"time: fewer than {OTHERS_NEEDED + 1} estimates were timed anew in both runs"
    return [] if times else [few]


def _failed(before: dict[str, Any], after: dict[str, Any]) -> list[dict[str, Any]]:
    old, new = ({each["scene"]: each["error"] for each in run.get("failed", [])} for run in (before, after))
    return [
        {"scene": scene, "before": old.get(scene), "after": new.get(scene)} for scene in dict.fromkeys([*new, *old])
    ]


def _described(results: dict[str, Any]) -> dict[str, Any]:
    settings = results["settings"]
    return {
        name: settings.get(name) for name in ("study", "seed", "command", "processor", "machine", "system", "cores")
    } | {"versions": results["versions"]}


def _settings(
    before: dict[str, Any], after: dict[str, Any], old: dict[Key, dict[str, Any]], new: dict[Key, dict[str, Any]]
) -> list[dict[str, Any]]:
    """Differences of what the two runs were told, and by what they were made."""
    names = "study", "seed", "backend", "processor", "machine", "system", "cores", "alpha"
    flat = []
    for results in (before, after):
        settings = results["settings"]
        found = {name: settings.get(name) for name in names}
        found |= {f"version of {name}": value for name, value in results["versions"].items()}
        found |= settings.get("options", {})
        flat.append(found)
    differences = [
        {"name": name, "before": flat[0].get(name), "after": flat[1].get(name)}
        for name in dict.fromkeys([*flat[0], *flat[1]])
        if flat[0].get(name) != flat[1].get(name)
    ]
    scenes = [results["settings"].get("scenes", {}) for results in (before, after)]
    for scene in scenes[0]:
        if scene in scenes[1]:
            a, b = (_flat(each[scene]) for each in scenes)
            differences += [
                {"name": f"{scene}: {name}", "before": a.get(name), "after": b.get(name)}
                for name in dict.fromkeys([*a, *b])
                if a.get(name) != b.get(name)
            ]
    return differences + _counts(old, new)


def _flat(described: dict[str, Any]) -> dict[str, Any]:
    names = "resolution", "exposure", "scope", "max_bounces", "objects", "setting", "digest"
    return {name: described.get(name) for name in names} | described.get("settings", {})


def _counts(old: dict[Key, dict[str, Any]], new: dict[Key, dict[str, Any]]) -> list[dict[str, Any]]:
    """Differences in how much was rendered, the rows of each counted together."""
    fields = {
        "samples": "samples per pixel",
        "replicates": "replicates",
        "reference_samples": "samples per pixel of the reference",
        "reference_replicates": "replicates of the reference",
    }
    found: dict[tuple[str, Any, Any], dict[str, None]] = {}
    for key, row in old.items():
        for field, label in fields.items():
            if key in new and row.get(field) != new[key].get(field):
                change = label, row.get(field), new[key].get(field)
                found.setdefault(change, {})[f"{key[1]} {key[2]}"] = None
    return [
        {"name": f"{label} of {', '.join(names)}", "before": a, "after": b} for (label, a, b), names in found.items()
    ]
