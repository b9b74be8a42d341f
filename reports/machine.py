"""What makes numbers here: the processor, and the versions of all that computes."""

import contextlib
import importlib.metadata
import platform
from pathlib import Path


def processor() -> str:
    """Its name, as the system has it."""
    path = Path("/proc/cpuinfo")
    if path.exists():
        for line in path.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def versions() -> dict[str, str]:
    """Versions of everything that makes numbers and is installed: who judges images alone has no renderer."""
    found = {"python": platform.python_version()}
    for name in ("termwise", "numba", "numpy", "scipy", "scikit-image", "mitsuba", "drjit", "xarray"):
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found
