"""One run of an engine: a scene into an empty folder, the command in a process group of its own, an image out of it.

Whatever goes wrong is an EngineError of one line: engine, scene, seed, what happened, the end of what it printed. The
folder of a run that failed is kept (the last one of each engine): scene, log and `command.txt`.
"""

import contextlib
import hashlib
import os
import shlex
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from pathlib import Path

import attrs
import numpy as np

from termwise.reports.engines import formats
from termwise.reports.engines.asked import Asked
from termwise.reports.engines.engine import Engine, EngineError
from termwise.scenes import images

_SAID = 240
"""Characters of a log's end that a message holds."""
_ENDS_S = 2.0
"""Seconds between asking a process to end and ending it."""
_GROUPS: set[int] = set()
"""Process groups that run."""
_READING = threading.Lock()
"""Readers of images silence their libraries by way of the whole process's standard error."""


@attrs.frozen(eq=False)
class Ran:
    """What a run gave: the image (H, W, 3), float32 or float64, seconds, and what was done to read it."""

    image: np.ndarray
    seconds: float
    notes: tuple[str, ...]


def seed_of(asked: str, seed: int, number: int) -> int:
    """The seed of a replicate, in [0, 2^31): of each scene (its digest) and number another."""
    digest = hashlib.sha256(repr((asked, seed, number)).encode()).digest()
    return int.from_bytes(digest[:4], "little") >> 1


def run(engine: Engine, asked: Asked, *, spp: int, seed: int, threads: int, kept: Path) -> Ran:
    """Have an engine render an image.

    Parameters
    ----------
    spp, seed, threads : as `{spp}`, `{seed}`, `{threads}`.
    kept : gets the folder of the run if it fails.

    Raises
    ------
    EngineError : the engine is not here, hangs, dies, or leaves no image, an old one, one of another size, or NaN.
    """
    _ = engine.version  # an engine that is not here says so
    folder = Path(tempfile.mkdtemp(prefix=f"termwise-{engine.name}-"))
    where = f"{engine.name}: {asked.name}: seed {seed}"
    try:
        return _run(engine, asked, folder, spp=spp, seed=seed, threads=threads)
    except EngineError as error:
        place = kept / engine.name
        shutil.rmtree(place, ignore_errors=True)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.move(folder, place)
        said = _end(place / "log.txt")
        raise EngineError(
            f"{where}: {error}{f'; it printed: {said}' if said else '; it printed nothing'} (kept in {place})"
        ) from None
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _run(engine: Engine, asked: Asked, folder: Path, *, spp: int, seed: int, threads: int) -> Ran:
    says = engine.says
    scene = formats.write(says.scene, asked, folder / "scene", depth=asked.depth, spp=spp, seed=seed)
    output = Path(says.output.replace("{folder}", str(folder)).replace("{seed}", str(seed)))
    command = engine.filled(
        says.command,
        {
            "scene": scene,
            "output": output,
            "folder": folder,
            "spp": spp,
            "seed": seed,
            "depth": says.scatters(asked.depth),
            "threads": threads,
        },
    )
    (folder / "command.txt").write_text(shlex.join(command) + "\n", "utf-8")
    # Whole seconds: file systems' clocks lag behind.
    begin, start = time.perf_counter(), time.time() - 2.0
    status = _status(command, folder, says.timeout_s, engine.variables())
    seconds = time.perf_counter() - begin
    if status is None:
        raise EngineError(f"took longer than timeout_s = {says.timeout_s:g} and was ended")
    if status not in says.accept_exit:
        raise EngineError(f"{_died(status)}: allowed is {', '.join(map(str, says.accept_exit))}")
    with _READING:
        return attrs.evolve(_read(engine, asked, output, folder, start), seconds=seconds)


def end_all() -> None:
    """End the runs of all threads, and what they have started."""
    for group in tuple(_GROUPS):
        _signal(group, signal.SIGKILL)


def _status(command: list[str], folder: Path, timeout_s: float, variables: dict[str, str]) -> int | None:
    """Exit status of a command, below 0 that of a signal; None where it was ended. What it started ends with it."""
    with (folder / "log.txt").open("wb") as log:
        try:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                cwd=folder,
                env=variables,
                start_new_session=True,
            )
        except OSError as error:
            raise EngineError(f"{command[0]!r} cannot be run: {error.strerror or error}") from None
        _GROUPS.add(process.pid)
        try:
            return process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            _signal(process.pid, signal.SIGTERM)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_ENDS_S)
            return None
        finally:
            _signal(process.pid, signal.SIGKILL)
            process.wait()
            _GROUPS.discard(process.pid)


def _signal(group: int, number: signal.Signals) -> None:
    """Signal a process group, if any of it is left."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(group, number)


def _died(status: int) -> str:
    if status >= 0:
        return f"exit status {status}"
    with contextlib.suppress(ValueError):
        return f"was ended by {signal.Signals(-status).name} (exit status {status})"
    return f"was ended by signal {-status}"


def _read(engine: Engine, asked: Asked, output: Path, folder: Path, start: float) -> Ran:
    if not output.is_file():
        others = sorted(
            path.relative_to(folder).as_posix()
            for path in folder.rglob("*")
            if path.suffix.lower() in images.SUFFIXES and "scene" not in path.relative_to(folder).parts[0]
        )
        found = f", but {', '.join(others[:4])}: name it as `output`" if others else ""
        raise EngineError(f"wrote no {output.relative_to(folder)}{found}")
    if output.stat().st_mtime < start:
        raise EngineError(f"{output.relative_to(folder)} is older than the run: it is of another one")
    try:
        image = images.read_one(output, engine.says.layer)
    except ValueError as error:
        raise EngineError(str(error).replace(f"{folder}{os.sep}", "")) from None
    height, width = image.pixels.shape[:2]
    if (width, height) != asked.resolution:
        wanted = " x ".join(map(str, asked.resolution))
        raise EngineError(f"{output.name} is {width} x {height} pixels: allowed is {wanted}, as the scene says")
    broken = ~np.isfinite(image.pixels)
    if broken.any():
        y, x, _ = np.argwhere(broken)[0]
        raise EngineError(f"{output.name} holds {broken.sum()} values NaN or infinite, the first at pixel ({x}, {y})")
    return Ran(image.pixels, 0.0, image.notes)


def _end(log: Path) -> str:
    """The last lines of a log, in one."""
    try:
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - 4 * _SAID))
            text = file.read().decode("utf-8", "replace")
    except OSError:
        return ""
    lines = [" ".join(line.split()) for line in text.splitlines()]
    said = " | ".join(line for line in lines if line)
    return said if len(said) <= _SAID else f"...{said[-_SAID:]}"
