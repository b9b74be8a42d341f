"""What all commands share: the two streams, the types of options, tables, and how a fault is said."""

import os
import re
import shlex
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import attrs
from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from termwise.scenes.load import load
from termwise.scenes.model import Scene

if TYPE_CHECKING:
    from termwise.reference.backend import Backend as Chosen

messages = Console(stderr=True, soft_wrap=True)
output = Console()


def _integer(_kind: Any, tokens: Any) -> int:
    """Cyclopts alone takes 1.5 for an integer, and rounds it."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f"{tokens[0].value!r}: allowed is an integer") from None


_whole = Parameter(converter=_integer, n_tokens=1)
_whole_threads = Parameter(
    converter=_integer, n_tokens=1, help="Threads, of each side where two are timed; one per core if not given."
)
Integer = Annotated[int, _whole]
MaybeInteger = Annotated[int | None, _whole]
Threads = Annotated[int | None, _whole_threads]
Names = Annotated[list[str] | None, Parameter(consume_multiple=True)]
SceneName = Annotated[
    str, Parameter(help="A name of the library or the path of a file: TOML, Mitsuba's XML, GLB or OBJ.")
]
TermName = Annotated[
    str | None,
    Parameter(help="ambient, direct, specular, transmission or background; without it all of them and their sum."),
]
Size = tuple[int, int] | None
Resolution = Annotated[Size, Parameter(help="Width and height, instead of the scene's.")]
Backend = Annotated[
    str | None,
    Parameter(help="Mitsuba variant: llvm_ad_rgb, scalar_rgb or cuda_ad_rgb; chosen by itself if not given."),
]
Flag = Annotated[bool, Parameter(negative="")]
Approximate = Annotated[
    bool,
    Parameter(negative="", help="Let the nearest thing stand for what the model lacks of another renderer's scene."),
]
Json = Annotated[bool, Parameter(name="--json", negative="", help="One JSON object on standard output.")]
Quiet = Annotated[bool, Parameter(negative="", help="No progress on standard error.")]

PROVEN = ("BIASED", "NOT AS PREDICTED", "NO VERDICT")
COLOURS = {"EQUIVALENT": "green", "AS PREDICTED": "green"} | dict.fromkeys(PROVEN, "red")


def say(text: str, *, markup: bool = True) -> None:
    """Print a sentence of the results as it stands: the terminal breaks it."""
    output.print(text, highlight=False, soft_wrap=True, markup=markup)


def say_json(results: Any) -> None:
    """One JSON object on standard output."""
    from termwise.reports.results.schema import dumped

    print(dumped(results))


def fail(message: str) -> None:
    """Say what went wrong in one line."""
    print(f"termwise: {' '.join(message.split())}", file=sys.stderr)


def scene(name: str, resolution: Size, *, approximate: bool = False) -> Scene:
    """A scene of the library or of a file, of another size if one is given; what stands for something else is said."""
    found = load(name, approximate=approximate)
    say_substitutions(found)
    return found if resolution is None else attrs.evolve(found, resolution=resolution)


def say_substitutions(found: Scene) -> None:
    """Name on standard error what stands in a scene for what its file says."""
    for line in found.substitutions:
        messages.print(f"termwise: {found.name}: {line}", soft_wrap=True, highlight=False, markup=False)


def check_seed(seed: int) -> None:
    """Refuse a seed that not every generator takes."""
    if not 0 <= seed < 2**31:
        raise ValueError(f"seed = {seed}: allowed is an integer in [0, {2**31 - 1}]")


def choose_backend(requested: str | None, *, quiet: bool = False) -> "Chosen":
    """Mitsuba's variant, for all that this command starts: the one requested, else the fastest that runs here.

    One that is slow and was not asked for is named, unless `quiet`.
    """
    from termwise.reference import backend

    chosen = backend.choose(requested)
    if requested is not None:
        os.environ["TERMWISE_BACKEND"] = requested  # read wherever Mitsuba is loaded, in other processes too
    words = backend.slow(chosen)
    if words:
        warnings.filterwarnings("ignore", message=re.escape(words))  # said here, once
        if not quiet:
            messages.print(f"termwise: {words}", highlight=False, markup=False)
    return chosen


def folder(path: Path) -> Path:
    """Make a folder for results before the work starts that is to go there."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (NotADirectoryError, FileExistsError):
        raise ValueError(f"out = {path}: is a file, or lies in one: allowed is a folder, old or new") from None
    return path


def table(*columns: str, title: str | None = None) -> Table:
    """A table without lines, narrow enough for 80 columns: what is not a terminal has no more."""
    heading = None if title is None else f"\n[bold]{title}"
    return Table(*columns, title=heading, title_justify="left", box=None, padding=(0, 1, 0, 0), pad_edge=False)


def command() -> str:
    """What was typed, fit to be typed again."""
    return shlex.join(["termwise", *sys.argv[1:]])
