"""The only place that names a Numba option: `@device` for functions called in kernels, `@kernel` for tile drivers.

No fastmath: it deletes NaN and infinity checks, and bias is what is measured here. A kernel releases the GIL, so
that tiles run on a thread pool.

A cached Numba function keeps the stale result of an edited callee in another module. The cache directory of a
function is therefore named by the sha256 of its module and of every module of `renderer` that it imports, directly or
not: an edit recompiles what it reaches, and nothing else.
"""

import ast
import functools
import hashlib
import importlib
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core import config, types
from numba.extending import models, register_model

from termwise.renderer.by_reference import pack
from termwise.renderer.compiling import ForKernels, ForPython
from termwise.scenes.store import cache_folder

F = TypeVar("F", bound=Callable[..., Any])

PACKAGE = "termwise.renderer"


def _file_of(module: str) -> Path:
    """Where a module's source is; of one of `renderer` without importing it, which may be under way."""
    if not module.startswith(f"{PACKAGE}."):
        return Path(inspect.getfile(importlib.import_module(module)))
    place = Path(__file__).parent.joinpath(*module.split(".")[2:])
    return place / "__init__.py" if place.is_dir() else place.with_name(f"{place.name}.py")


@functools.cache
def _imports(module: str) -> tuple[Path, frozenset[str]]:
    """File of a module, and the modules of `renderer` that it imports.

    Those for annotations alone too: their types may be those of a function's arguments, and a cached function keeps
    the layout that they had.
    """
    path = _file_of(module)
    found = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith(PACKAGE):
            found.add(node.module)
            # `from termwise.renderer import sobol` names a module, `….sobol import x` a function.
            nested = (f"{node.module}.{name.name}" for name in node.names)
            found.update(name for name in nested if _file_of(name).is_file())
        elif isinstance(node, ast.Import):
            found.update(name.name for name in node.names if name.name.startswith(PACKAGE))
    return path, frozenset(found - {PACKAGE})


@functools.cache
def closure_digest(module: str) -> str:
    """sha256 over the sources of `module` and of all modules of `renderer` that it reaches by imports."""
    reached: dict[str, Path] = {}
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if name not in reached:
            reached[name], imported = _imports(name)
            waiting.extend(imported)
    state = hashlib.sha256(numba.__version__.encode())
    for name in sorted(reached):
        state.update(f"{name}\0".encode() + reached[name].read_bytes())
    return state.hexdigest()


def _compile(function: F, folder: str = "", pipeline: type[ForPython] = ForPython, **options: Any) -> F:
    # Numba's settings are untyped attributes.
    settings = cast(Any, config)
    before = settings.CACHE_DIR
    # Set around this call only: the user's own Numba cache stays where it is.
    settings.CACHE_DIR = str(cache_folder() / "numba" / closure_digest(function.__module__)[:16] / folder)
    try:
        compiled = numba.njit(cache=True, nogil=True, error_model="numpy", pipeline_class=pipeline, **options)(function)
    finally:
        settings.CACHE_DIR = before
    if settings.DISABLE_JIT:
        # Compiled code wraps integers and makes inf and NaN in silence; NumPy's scalars would warn of it.
        return cast(F, np.errstate(all="ignore")(function))
    # The dispatcher is called like the function it was made from.
    return cast(F, compiled)


def device(function: F) -> F:
    """Compile a function that kernels call; it may not make an array.

    It is inlined into the kernel, always: renders take longer where LLVM leaves calls (docs/performance.md). It counts
    no references: the kernel holds all arrays while it runs, and threads would share the counters, which are atomic.
    """
    if cast(Any, config).DISABLE_JIT:
        return _compile(function)
    return cast(F, _Device(function, inline=True))


def subroutine(function: F) -> F:
    """Compile a function that kernels call, as `device` does, but let LLVM leave it a call.

    For what does so much at once that a call is lost in it, a wave of rays: a kernel that calls it twice has it once.
    Tuples of many words that it takes are `by_reference`.
    """
    if cast(Any, config).DISABLE_JIT:
        return _compile(function)
    return cast(F, _Device(function, inline=False))


class _Callee(types.Dispatcher):
    """Numba's type of a function that kernels call, to which a constant is a number like any other.

    A count that begins at 0 would have all that it is handed to compiled twice, for a 0 and for any integer.
    """

    def get_call_type(self, context: Any, args: Any, kws: Any) -> Any:
        """Signature of a call, compiled."""
        named = {name: types.unliteral(each) for name, each in dict(kws).items()}
        return super().get_call_type(context, tuple(map(types.unliteral, args)), named)


register_model(_Callee)(models.OpaqueModel)


class _Device:
    """A function that is compiled for kernels alone, and a second time should Python call it.

    A call by Python has its arguments taken out of their objects, hundreds of arrays of a scene: compiled with each
    function that takes a scene, this took more than half of the time.
    """

    def __init__(self, function: Callable[..., Any], *, inline: bool) -> None:
        functools.update_wrapper(self, function)
        self._for_kernels = _compile(
            function,
            pipeline=ForKernels,
            _nrt=False,
            forceinline=inline,
            no_cpython_wrapper=True,
            no_cfunc_wrapper=True,
        )
        # In a folder of its own: Numba's cache does not tell apart how a function was compiled.
        self._for_python = _compile(function, "python", _nrt=False, no_cfunc_wrapper=True)

    @property
    def _numba_type_(self) -> Any:
        """What kernels that name this see: Numba asks each value for its type by this name."""
        return _Callee(self._for_kernels)

    def __call__(self, *arguments: Any) -> Any:
        return self._for_python(*map(pack, arguments))


class _Kernel:
    """A compiled driver, which is called with what is packed."""

    def __init__(self, compiled: Any) -> None:
        functools.update_wrapper(self, compiled.py_func)
        self.compiled = compiled

    def __call__(self, *arguments: Any) -> Any:
        return self.compiled(*map(pack, arguments))

    def __reduce__(self) -> str:
        """Pickled by its name."""
        return self.__qualname__


KERNELS: list[Any] = []


def kernel(function: F) -> F:
    """Compile a driver that Python calls, once per tile."""
    compiled = _compile(function, no_cfunc_wrapper=True)
    if cast(Any, config).DISABLE_JIT:
        return compiled
    KERNELS.append(_Kernel(compiled))
    return cast(F, KERNELS[-1])


def compiled_kernels() -> list[str]:
    """Names of the kernels compiled or loaded so far: a scene's skips show here."""
    return [item.__name__ for item in KERNELS if item.compiled.signatures]


def warm(function: Callable[..., Any], *arguments: Any) -> None:
    """Compile `function` for the types of `arguments`, or load it, without running it."""
    if isinstance(function, _Kernel):  # not with NUMBA_DISABLE_JIT=1
        function.compiled.compile(tuple(numba.typeof(argument) for argument in arguments))
