"""References audited: one that disagrees with itself or with a second integrator judges nobody.

Each reference that a judged row is measured against is put to the very rule that estimators are put to (`verdict`), no
margin needed and nothing allowed, at a level of its own over all audits of the run:

- *halves*: the first half of its replicates against the second half. Finds replicates that share random numbers or
  drift, and noise that the replicates do not show.
- *geometry*: a thousand of Mitsuba's answers, what rays meet and which points see each other, against float64 (see
  `geometry_audit`). Finds what both integrators share: rays that leak, and single precision that does not hold a scene.
- *second integrator*: the same integral by other sampling (`reference.second`), from other random numbers. Finds what
  both halves share: a wrong weight, a density that is not that of the samples, a strategy that misses light.

What an audit does not exclude is printed with it: its smallest detectable bias. Closed forms are checked by the tests.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Literal

import attrs
import numpy as np

from termwise import reference
from termwise.reference import store
from termwise.reports.statistics import replicates, rule
from termwise.reports.statistics.accumulation import Statistics
from termwise.reports.study.geometry_audit import Finding
from termwise.scenes.limits import Limit, correct
from termwise.scenes.model import Scene

Test = Literal["halves", "second integrator"]
GEOMETRY = "geometry"

AGREES, DISAGREES, UNDECIDED, ABSENT = "agrees", "disagrees", "undecided", "absent"
# Of a verdict, what an audit says too.
_MEASURED = "bias", "bias_low", "bias_high", "standard_error", "detectable_bias", "rms_bias_high"
_WORDS = {"EQUIVALENT": AGREES, "BIASED": DISAGREES, "UNDERPOWERED": UNDECIDED, "ABSENT": ABSENT}


@attrs.frozen(eq=False)
class Audit:
    """A reference measured against itself, before the number of audits of the run is known.

    Attributes
    ----------
    scene : name.
    limit : what was rendered, see `reference.shared`.
    test : how.
    statistics : of the one side against the other.
    samples : per pixel and replicate of the other side; with a kernel, photon maps.
    seconds : of the second integrator; 0 of halves, which were there.
    """

    scene: str
    limit: Limit
    test: Test
    statistics: Statistics
    samples: int
    seconds: float


def second_limits(scene: Scene, asked: Iterable[Limit]) -> list[Limit]:
    """Those of the limits that a second integrator is rendered for: each that serves the true integral of a term."""
    found: dict[Limit, Limit] = {}
    for limit in asked:
        served = reference.shared(scene, limit)
        plain = limit.transport != "physical" and served == reference.shared(scene, correct(limit.term, scene.scope))
        if plain and reference.has_second(scene, served):
            found.setdefault(served, limit)
    return list(found.values())


def second_samples(spp: int) -> int:
    """Samples of a second integrator's replicate: a quarter of the reference's."""
    return max(1, spp // 4)


def audits(
    scene: Scene,
    rendered: Mapping[Limit, store.Replicates],
    seconds: Mapping[Limit, store.Replicates],
    *,
    compare: Callable[[np.ndarray, np.ndarray, str], Statistics],
) -> list[Audit]:
    """Measure the references of a scene against themselves.

    Parameters
    ----------
    scene, rendered : replicates of each limit that a judged row is measured against.
    seconds : by a second integrator, of those of `second_limits` that were rendered: as many replicates.
    compare : (ours, reference, what) -> `accumulation.measure` with the objects of the scene.
    """
    found: list[Audit] = []
    done: set[Limit] = set()
    for limit, kept in rendered.items():
        served = reference.shared(scene, limit)
        if served in done or limit.transport == "physical":
            continue
        done.add(served)
        images = kept.images
        half = len(images) // 2
        if half >= replicates.REPLICATES_NEEDED:
            halves = compare(images[:half], images[half:], f"reference {limit.term}, halves")
            found.append(Audit(scene.name, served, "halves", halves, kept.spp, 0.0))
        if (other := seconds.get(limit)) is not None:
            against = compare(images, other.images, f"reference {limit.term}, second integrator")
            spent = float(np.sum(other.seconds))
            found.append(Audit(scene.name, served, "second integrator", against, other.spp, spent))
    return found


def decide(found: Iterable[Audit], geometry: Iterable[Finding] = ()) -> list[dict[str, Any]]:
    """A row for each audit: scene, term, limit, test, word, bias with its intervals, what it cannot see.

    `geometry` : of each scene, whose rows stand for all of its terms and have no bias.
    """
    every = list(found)
    tests = sum(each.statistics.tests for each in every)
    rows = []
    for each in every:
        outcome = rule.decide(each.statistics, tests=max(tests, 1))
        assert outcome.verdict is not None
        rows.append(
            {
                "scene": each.scene,
                "term": each.limit.term,
                "limit": described(each.limit),
                "test": each.test,
                "word": _WORDS[outcome.verdict],
                **{name: getattr(outcome, name) for name in _MEASURED},
                "reasons": list(outcome.reasons),
                "samples": each.samples,
                "seconds": each.seconds,
            }
        )
    for finding in geometry:
        rows.append(
            {
                "scene": finding.scene,
                "term": None,
                "limit": "every term",
                "test": GEOMETRY,
                "word": AGREES if finding.place is None else DISAGREES,
                **dict.fromkeys(_MEASURED),
                "reasons": [] if finding.place is None else [_told(finding)],
                "samples": finding.asked,
                "seconds": finding.seconds,
            }
        )
    return rows


def _told(finding: Finding) -> str:
    return f"{finding.differ} of {finding.asked} answers of Mitsuba's differ from float64's: {finding.place}"


def findings(rows: Iterable[dict[str, Any]], scene: Scene, used: Iterable[Limit]) -> tuple[str | None, list[str]]:
    """What the audits say of the references that a row is measured against.

    The worst word, None without any audit; and why those that disagree do.
    """
    limits = [reference.shared(scene, limit) for limit in used]
    names = {described(limit) for limit in limits}
    here = [row for row in rows if row["scene"] == scene.name]
    about = [row for row in here if row["limit"] in names]
    # It has no noise that could hide anything: where it agrees, it leaves the word to the others.
    about += [row for row in here if limits and row["test"] == GEOMETRY and row["word"] == DISAGREES]
    words = {row["word"] for row in about}
    worst = next((word for word in (DISAGREES, UNDECIDED, AGREES, ABSENT) if word in words), None)
    failed = [f"{row['limit']}, {row['test']}: {row['reasons'][0]}" for row in about if row["word"] == DISAGREES]
    return worst, failed


def described(limit: Limit) -> str:
    """The fields of a limit that are not its defaults."""
    fields = attrs.fields_dict(Limit)
    told = {name: value for name, value in attrs.asdict(limit, recurse=False).items() if name != "term"}
    rest = ", ".join(
        f"{name} = {value}" for name, value in told.items() if value != fields[name].default and value is not None
    )
    return f"{limit.term}, {rest}" if rest else limit.term
