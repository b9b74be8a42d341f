"""What a Python function computes, as a digest: its code, and all values, functions and modules that this reaches.

Functions and modules of a user's own are followed; of installed packages the version counts. Equal digests mean the
same code on the same values, so that results can be kept; a value that has no content of its own (an open file, a
random generator, which changes as it is used) makes the whole `Unknown`. What a function reads from disk is not seen.
"""

import builtins
import dis
import functools
import hashlib
import importlib
import importlib.metadata
import sys
import sysconfig
import types
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from termwise.scenes.store import ROOT, sources_digest

_INSTALLED = tuple(Path(sysconfig.get_path(name)).resolve() for name in ("stdlib", "platstdlib", "purelib", "platlib"))
_OURS = "termwise", "renderer", "reference", "scenes", "reports"
_DATA = (int, float, complex, str, bytes, tuple, list, dict, np.ndarray)  # of a module, which may change as it runs
_PLAIN = (int, float, complex, str, bytes, type(None), type(...))


class Unknown(ValueError):
    """A value whose content cannot be told; the message says which."""


def fingerprint(function: Any) -> str:
    """Sha256 of what a function computes.

    Raises
    ------
    Unknown : It reaches a value that has no content of its own.
    """
    state = hashlib.sha256(f"{sys.version_info[:2]} {np.__version__}".encode())
    _Absorber(state).absorb(function, getattr(function, "__qualname__", "function"))
    return state.hexdigest()


class _Absorber:
    """Feeds values into a hash, each object once."""

    def __init__(self, state: Any) -> None:
        self._state = state
        self._seen: dict[int, tuple[int, Any]] = {}

    def _add(self, *words: object) -> None:
        self._state.update(repr(words).encode())

    def absorb(self, value: Any, name: str) -> None:
        """Feed a value that goes by `name`."""
        if isinstance(value, _PLAIN):
            self._add(type(value).__name__, value)
            return
        if id(value) in self._seen:
            self._add("again", self._seen[id(value)][0])
            return
        # Held, so that no other object takes its address meanwhile.
        self._seen[id(value)] = len(self._seen), value
        self._add(type(value).__name__)
        if isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject:
            self._add(str(value.dtype), value.shape)
            self._state.update(np.ascontiguousarray(value).tobytes())
        elif isinstance(value, tuple | list):
            self._add(len(value))
            for index, item in enumerate(value):
                self.absorb(item, f"{name}[{index}]")
        elif isinstance(value, dict):
            self._add(len(value))
            for key, item in value.items():
                self.absorb(key, f"a key of {name}")
                self.absorb(item, f"{name}[{key!r}]")
        elif isinstance(value, set | frozenset) and all(isinstance(item, _PLAIN) for item in value):
            self._add(sorted(map(repr, value)))
        elif isinstance(value, types.ModuleType):
            self._module(value)
        elif isinstance(value, types.FunctionType):
            self._function(value, name)
        elif isinstance(value, types.MethodType):
            self.absorb(value.__func__, name)
            self.absorb(value.__self__, f"{name}.__self__")
        elif isinstance(value, functools.partial):
            self.absorb((value.func, value.args, value.keywords), name)
        elif isinstance(value, type):
            self._class(value, name)
        elif attrs.has(type(value)):
            self.absorb(type(value), type(value).__name__)
            for field in attrs.fields(type(value)):
                self.absorb(getattr(value, field.name), f"{name}.{field.name}")
        elif _is_installed(value):  # a builtin, a compiled function
            self._add(value.__module__, getattr(value, "__qualname__", ""), _version(value.__module__))
        elif isinstance(value, np.ufunc | np.dtype | types.BuiltinFunctionType | property):
            self._add(repr(value))
        elif not _is_installed(type(value)) and hasattr(value, "__dict__"):
            self.absorb(type(value), type(value).__name__)
            self.absorb(vars(value), name)
        else:
            raise Unknown(f"{name} is a {type(value).__name__}, whose content cannot be told")

    def _module(self, module: types.ModuleType) -> None:
        self._add(module.__name__)
        file = getattr(module, "__file__", None)
        if file is None or _is_installed_file(file):
            self._add(_version(module.__name__))
        else:
            self._add(Path(file).read_bytes())
            for name, value in list(vars(module).items()):  # to follow one may import another
                own = not name.startswith("__")
                if isinstance(value, types.ModuleType | types.FunctionType | type) or (
                    own and isinstance(value, _DATA)
                ):
                    self.absorb(value, f"{module.__name__}.{name}")

    def _function(self, function: types.FunctionType, name: str) -> None:
        # By the file of its code: a user's own module may bear an installed one's name.
        if _is_installed_file(function.__code__.co_filename):
            self._add(function.__module__, function.__qualname__, _version(function.__module__))
            return
        self.absorb((function.__defaults__, function.__kwdefaults__), f"the defaults of {name}")
        for variable, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
            self.absorb(cell.cell_contents, variable)
        self._code(function.__code__, function.__globals__)

    def _code(self, code: types.CodeType, variables: dict[str, Any]) -> None:
        self._add(code.co_code, code.co_names, code.co_varnames, code.co_flags)
        for constant in code.co_consts:
            if isinstance(constant, types.CodeType):
                self._code(constant, variables)
            else:
                self.absorb(constant, "a constant")  # a set among them has another order in each process
        for name in code.co_names:
            if name in variables:
                self.absorb(variables[name], name)
            elif hasattr(builtins, name):
                self._add("builtin", name)
        for instruction in dis.get_instructions(code):
            if instruction.opname == "IMPORT_NAME":
                try:
                    self.absorb(importlib.import_module(instruction.argval), instruction.argval)
                except (ImportError, ValueError) as error:  # a relative one has no name here
                    raise Unknown(f"import {instruction.argval}: {error}") from None

    def _class(self, kind: type, name: str) -> None:
        self._add(kind.__module__, kind.__qualname__)
        if _is_installed(kind):
            self._add(_version(kind.__module__))
            return
        for base in kind.__bases__:
            self.absorb(base, base.__name__)
        for attribute, value in vars(kind).items():
            if attribute not in ("__dict__", "__weakref__", "__doc__", "__module__"):
                value = value.__func__ if isinstance(value, staticmethod | classmethod) else value
                self._add(attribute)
                if not isinstance(value, types.GetSetDescriptorType | types.MemberDescriptorType):
                    self.absorb(value.fget if isinstance(value, property) else value, f"{name}.{attribute}")


def _is_installed(value: Any) -> bool:
    """Whether an object stands by its name in a module that is the language's, an installed package's or ours."""
    module = sys.modules.get(getattr(value, "__module__", None) or "")
    name = getattr(value, "__qualname__", None)
    if module is None or name is None or not _is_installed_file(getattr(module, "__file__", None)):
        return False
    found: Any = module
    for part in name.split("."):
        found = getattr(found, part, None)
    return found is value


@functools.cache
def _is_installed_file(file: str | None) -> bool:
    if file is None:  # built into the interpreter
        return True
    if file.startswith("<"):
        return file.startswith("<frozen ")
    path = Path(file).resolve()
    ours = (ROOT / name for name in _OURS)
    return any(path.is_relative_to(folder) for folder in (*_INSTALLED, *ours))


@functools.cache
def _version(module: str) -> str:
    """Of the package that a module belongs to."""
    package = module.split(".")[0]
    if package == "termwise":
        return sources_digest(*(ROOT / name for name in _OURS))
    found = getattr(sys.modules.get(package), "__version__", None)
    if isinstance(found, str):
        return found
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return sys.version  # of the language's own
