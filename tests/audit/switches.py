"""All planted faults in one copy of the sources, each behind a switch: `if planted() == 7: FAULTY else: SOUND`.

A kernel is compiled once for all its faults; which of them is on, a process is told by its environment. (Mutant
schemata: Untch, Offutt and Harrold, ISSTA 1993.) A switch stands around whole statements of a function. A fault that
lies elsewhere, in a signature, a constant of a module, a scene file, is planted on its own.
"""

import ast
import collections
from collections.abc import Iterator, Sequence
from pathlib import Path

import attrs

from tests.audit.plants import Plant

VARIABLE = "TERMWISE_PLANTED"
NONE = -1
MODULE = "planted"
# Kernels read a word of memory, by the name of a symbol: an address, or a global's value, would be compiled into them.
SOURCE = f'''"""Which fault is on: `planted()`, in Python and in kernels."""

import ctypes
import os

import llvmlite.binding
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload

_NUMBER = ctypes.c_int32(int(os.environ.get("{VARIABLE}", {NONE})))
llvmlite.binding.add_symbol("termwise_planted", ctypes.addressof(_NUMBER))


def planted():
    return _NUMBER.value


@intrinsic
def _load(typing):
    def generate(context, builder, signature, arguments):
        module = builder.module
        if "termwise_planted" not in module.globals:
            ir.GlobalVariable(module, ir.IntType(32), "termwise_planted").linkage = "external"
        return builder.load(module.globals["termwise_planted"])

    return types.int32(), generate


@overload(planted, inline="always")
def _planted():
    return lambda: _load()
'''


@attrs.frozen
class _Change:
    """Lines first to last (from 1) of a file, that a fault replaces by others."""

    number: int
    first: int
    last: int
    lines: tuple[str, ...]


def switched(plants: Sequence[Plant], root: Path) -> tuple[dict[str, str], frozenset[int]]:
    """Sources with all faults that can be switched.

    Returns
    -------
    texts, numbers
        The changed files by path, and which of the plants they hold: their places in `plants`.

    Raises
    ------
    ValueError
        A plant does not fit the sources.
    """
    by_path: dict[str, list[int]] = collections.defaultdict(list)
    for number, plant in enumerate(plants):
        by_path[plant.path].append(number)
    texts, held = {}, set()
    for path, numbers in by_path.items():
        if not path.endswith(".py"):
            continue
        sound = (root / path).read_text("utf-8")
        changes = [change for number in numbers if (change := _change(number, plants[number], sound, root)) is not None]
        if changes:
            texts[path] = _with_switches(sound, changes)
            held |= {change.number for change in changes}
    return texts, frozenset(held)


def _change(number: int, plant: Plant, sound: str, root: Path) -> _Change | None:
    """What a fault changes, as whole statements of one function; None where it is not in one."""
    faulty = plant.changed(root)
    begins = sound.index(plant.before)
    first = sound.count("\n", 0, begins) + 1
    last = sound.count("\n", 0, begins + len(plant.before) - 1) + 1
    lines = sound.splitlines()
    found = _statements(ast.parse(sound), lines, first, last)
    if found is None:
        return None
    more = plant.after.count("\n") - plant.before.count("\n")
    return _Change(number, *found, tuple(faulty.splitlines()[found[0] - 1 : found[1] + more]))


def _statements(module: ast.Module, lines: list[str], first: int, last: int) -> tuple[int, int] | None:
    """Lines of the shortest run of statements, in a function, that has all of the given lines."""
    found, inside, body = None, False, module.body
    while True:
        met = [each for each in body if _first(each) <= last and _last(each) >= first]
        if not met or _first(met[0]) > first or _last(met[-1]) < last:
            return found
        # What begins with `elif` cannot stand behind a switch, but what it holds can.
        if inside and not lines[met[0].lineno - 1].lstrip().startswith("elif "):
            found = _first(met[0]), _last(met[-1])
        if len(met) > 1:
            return found
        [statement] = met
        inside |= isinstance(statement, ast.FunctionDef)
        body = next((each for each in _bodies(statement) if _first(each[0]) <= first and last <= _last(each[-1])), [])


def _first(statement: ast.stmt) -> int:
    """The first line of a statement, with its decorators."""
    return min([statement.lineno, *(each.lineno for each in getattr(statement, "decorator_list", ()))])


def _last(statement: ast.stmt) -> int:
    assert statement.end_lineno is not None  # parsed, it has one
    return statement.end_lineno


def _bodies(statement: ast.stmt) -> Iterator[list[ast.stmt]]:
    """The statements that a statement holds."""
    holders = [statement, *getattr(statement, "handlers", ())]
    for holder in holders:
        for name in ("body", "orelse", "finalbody"):
            if isinstance(body := getattr(holder, name, None), list) and body:
                yield body


def _with_switches(sound: str, changes: list[_Change]) -> str:
    """The text with its faults behind switches; those that meet stand behind one, each with all of its lines."""
    lines = sound.splitlines()
    groups: list[list[_Change]] = []
    for change in sorted(changes, key=lambda each: (each.first, -each.last)):
        if groups and change.first <= max(each.last for each in groups[-1]):
            groups[-1].append(change)
        else:
            groups.append([change])
    for group in reversed(groups):
        first, last = group[0].first, max(each.last for each in group)
        here = lines[first - 1 : last]
        indent = here[0][: len(here[0]) - len(here[0].lstrip())]
        switch = []
        for change in group:
            faulty = [*lines[first - 1 : change.first - 1], *change.lines, *lines[change.last : last]]
            word = "elif" if switch else "if"
            switch += [f"{indent}{word} planted() == {change.number}:", *_deeper(faulty, indent)]
        lines[first - 1 : last] = [*switch, f"{indent}else:", *_deeper(here, indent)]
    # After the docstring, with which every module of ours begins, and what must stand before all else.
    opening = [each for each in ast.parse(sound).body if getattr(each, "module", "") == "__future__"]
    lines.insert(_last(opening[-1] if opening else ast.parse(sound).body[0]), f"from {MODULE} import planted")
    return "\n".join(lines) + "\n"


def _deeper(lines: list[str], indent: str) -> list[str]:
    """Statements as the body of a switch; one of none is `pass`."""
    deeper = [f"    {line}" for line in lines if line.strip()]
    return deeper or [f"{indent}    pass"]
