"""Where a row comes from: the command that makes it again.

The same command gives the same images, errors and biases, bit for bit on one machine. The level of a test depends on
the number of tests of its run, so that a verdict close to its limit may need the whole run, whose command stands on the
page as well.
"""

import shlex
from pathlib import Path
from typing import Any

from termwise.scenes.load import library

# Of `termwise compare`: those with a value that decide what is measured, not where it goes or what is printed.
_OPTIONS = "--study", "--seed", "--budget", "--estimators", "--backend"
_ELSEWHERE = ("--out",)


def command(results: dict[str, Any], row: dict[str, Any]) -> str | None:
    """The `termwise compare` that makes a row again; None where the run was not started by one.

    Of a row's scene alone where that is a scene of the library or was named; else of the whole study.
    """
    try:
        words = shlex.split(results["settings"].get("command") or "")
    except ValueError:  # an unbalanced quote, of a name that was not quoted
        return None
    if [Path(word).name for word in words[:1]] + words[1:2] != ["termwise", "compare"]:
        return None
    named, options, rest = [], [], iter(words[2:])
    for word in rest:
        name, equals, value = word.partition("=")
        if name in _OPTIONS + _ELSEWHERE:
            value = value if equals else next(rest, "")
            options += [name, value] if name in _OPTIONS else []
        elif not word.startswith("-"):
            named.append(word)
    scene = row.get("base") or row["scene"]
    of_scene = [word for word in named if Path(word).name.removesuffix(".toml") == scene]
    if row.get("group"):
        of_scene = named
    elif not of_scene and scene in library():
        of_scene = [scene]
    return shlex.join(["termwise", "compare", *of_scene, *options])
