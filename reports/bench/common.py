"""What every benchmark says of itself: `spread = (median, least, greatest)` over runs, and the machine they ran on."""

import importlib.metadata
import os
import platform
import time
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from termwise.reports.machine import processor

# Mitsuba's rays go through Embree in packets there; another variant would be no yardstick.
BACKEND = "llvm_ad_rgb"


def settle() -> None:
    """Wait until the other side's threads sleep: Mitsuba's look for work for some 20 ms before they do.

    Without, 16 samples of ours that take 5.4 ms on two cores took 10.9 behind a render of Mitsuba's.
    """
    time.sleep(0.05)


def timed(run: Callable[[], object], times: int = 1) -> tuple[float, float]:
    """Wall time and processor time of one run, as a mean of several."""
    settle()
    wall, processor = time.perf_counter(), time.process_time()
    for _ in range(times):
        run()
    return (time.perf_counter() - wall) / times, (time.process_time() - processor) / times


def spread(values: Iterable[float]) -> tuple[float, float, float]:
    """Median, least and greatest."""
    values = np.array(list(values), np.float64)
    return float(np.median(values)), float(values.min()), float(values.max())


def known(field: str, names: Iterable[str], allowed: Iterable[str]) -> None:
    """Refuse a name that is not allowed; a ValueError lists those that are."""
    allowed = tuple(allowed)
    for name in names:
        if name not in allowed:
            raise ValueError(f"{field} = {name!r}: allowed are {', '.join(allowed)}")


def positive(**fields: float) -> None:
    """Refuse a count or a length of time that is not above 0."""
    for name, value in fields.items():
        if isinstance(value, int):
            if value < 1:
                raise ValueError(f"{name} = {value}: allowed is at least 1")
        elif not 0.0 < value < float("inf"):
            raise ValueError(f"{name} = {value}: allowed is a number in (0, inf)")


def machine(threads: int) -> dict[str, Any]:
    """What ran, and beside how much other work: `load` is that of the last minute, before it and the run included."""
    versions = {name: importlib.metadata.version(name) for name in ("numba", "llvmlite", "mitsuba", "drjit")}
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "threads": threads,
        "load": os.getloadavg()[0],
        "versions": versions | {"python": platform.python_version()},
    }
