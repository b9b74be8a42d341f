"""The audit's history: what each run that was recorded has counted. The next may not miss more, nor alarm more often.

`history.json` is a list, the latest run last: `python -m tests.audit --record` adds one.
"""

import datetime
import json
from pathlib import Path
from typing import Any

from scipy import stats

from termwise.scenes.store import write_atomically

HISTORY = Path(__file__).with_name("history.json")
UNLIKELY = 0.001
"""Chance that alarms which are as frequent as before are called more."""


def entry(results: dict[str, Any]) -> dict[str, Any]:
    """What is kept of a run's results."""
    return {
        "date": datetime.date.today().isoformat(),
        "seed": results["seed"],
        "planted": results["planted"],
        "caught": results["caught"],
        "missed": sorted(row["fault"] for row in results["matrix"] if not row["caught"]),
        "rendered": {"runs": results["null_runs"], "alarms": results["null_false_alarms"]},
        "ordinary": {"runs": results["ordinary_null_runs"], "alarms": results["ordinary_false_alarms"]},
        "awkward": {"runs": results["awkward_null_runs"], "alarms": results["awkward_false_alarms"]},
        "laws": results["laws"],
        "seconds": round(results["seconds"]),
    }


def read(path: Path = HISTORY) -> list[dict[str, Any]]:
    """All runs that were recorded."""
    return json.loads(path.read_text("utf-8")) if path.is_file() else []


def record(results: dict[str, Any], path: Path = HISTORY) -> None:
    """Add a run."""
    text = json.dumps([*read(path), entry(results)], indent=1, ensure_ascii=False) + "\n"
    write_atomically(path, lambda temporary: temporary.write_text(text, "utf-8"))


def fallen(now: dict[str, Any], before: dict[str, Any]) -> list[str]:
    """In words, what is worse in one entry than in an earlier one."""
    found = []
    if now["caught"] / now["planted"] < before["caught"] / before["planted"]:
        found.append(
            f"score: {now['caught']} of {now['planted']} faults caught, {before['caught']} of {before['planted']} on "
            f"{before['date']}"
        )
    if lost := [name for name in now["missed"] if name not in before["missed"]]:
        found.append(f"missed, but not on {before['date']}: {', '.join(lost)}")
    kinds = {
        f"{kind} nulls": (now[kind], before[kind]) for kind in ("rendered", "ordinary", "awkward") if kind in before
    }
    # The first runs had no awkward noise.
    kinds |= {law: (each, before["laws"][law]) for law, each in now["laws"].items() if law in before.get("laws", {})}
    for kind, each in kinds.items():
        (alarms, runs), (earlier, of) = ((side["alarms"], side["runs"]) for side in each)
        # Fisher's exact test.
        if stats.hypergeom.sf(alarms - 1, runs + of, alarms + earlier, runs) < UNLIKELY:
            found.append(f"{kind}: {alarms} false alarms of {runs}, {earlier} of {of} on {before['date']}")
    return found
