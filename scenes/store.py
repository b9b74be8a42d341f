"""Results on disk: a file is named by the digest of all that it depends on, and appears whole or not at all."""

import functools
import hashlib
import importlib.metadata
import os
import uuid
from collections.abc import Callable
from pathlib import Path

import platformdirs

ROOT = Path(__file__).resolve().parent.parent
"""Folder of `scenes`, `renderer`, `reference` and `reports`: the checkout, or the package where it is installed."""


def cache_folder() -> Path:
    """Folder of everything that can be made again: `$TERMWISE_CACHE`, or `.cache` in a checkout, or the user's."""
    if given := os.environ.get("TERMWISE_CACHE"):
        return Path(given)
    if (ROOT / "pyproject.toml").is_file():
        return ROOT / ".cache"
    return platformdirs.user_cache_path("termwise")


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Call `write` with a temporary name beside `path`, then rename: readers never see half a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    # Not mkstemp: its files are readable by their owner alone, whatever the umask.
    temporary = path.with_name(f".{path.stem}-{uuid.uuid4().hex}{path.suffix}")
    try:
        write(temporary)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@functools.cache
def versions_of(*packages: str) -> list[str]:
    """Versions of installed packages, as they were when first asked: finding them reads files."""
    return [importlib.metadata.version(package) for package in packages]


@functools.cache
def sources_digest(*folders: Path) -> str:
    """sha256 over the names and contents of all Python sources below `folders`, as they were when first asked.

    A file edited during a run is not the code that runs.
    """
    state = hashlib.sha256()
    for folder in folders:
        for path in sorted(folder.rglob("*.py")):
            state.update(f"{path.relative_to(folder)}\0".encode() + path.read_bytes())
    return state.hexdigest()
