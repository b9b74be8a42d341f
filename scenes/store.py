"""Results on disk: a file is named by the digest of all that it depends on, and appears whole or not at all."""

import functools
import hashlib
import os
import uuid
from collections.abc import Callable
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent


def cache_folder() -> Path:
    """Folder of everything that can be made again: `$TERMWISE_CACHE`, or `.cache` in the project."""
    return Path(os.environ.get("TERMWISE_CACHE") or PROJECT / ".cache")


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
def sources_digest(*folders: Path) -> str:
    """sha256 over the names and contents of all Python sources below `folders`, as they were when first asked.

    A file edited during a run is not the code that runs.
    """
    state = hashlib.sha256()
    for folder in folders:
        for path in sorted(folder.rglob("*.py")):
            state.update(f"{path.relative_to(folder)}\0".encode() + path.read_bytes())
    return state.hexdigest()
