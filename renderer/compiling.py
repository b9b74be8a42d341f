"""Pipelines of Numba: what kernels are compiled by, and functions that are linked into kernels and run nowhere else.

Numba makes machine code of each function that it compiles, and again of each kernel that a function is linked into.
Nine functions of ten are never called but by kernels: of these LLVM's bitcode is kept, and machine code is not made.
"""

import weakref
from typing import Any

from llvmlite import binding
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler

# How names of environments begin: a variable a function, whose address Numba asks for when it has compiled it.
_ENVIRONMENT = "_ZN08NumbaEnv"
# Loops are vectorised as widely as the processor can: on Intel's LLVM goes as far as half of it.
_WIDE = '"prefer-vector-width"="512"'


class _Library(JITCodeLibrary):
    """What Numba keeps of a kernel: its module and machine code."""

    def add_ir_module(self, ir_module: Any) -> None:
        for function in ir_module.functions:
            # By the set's own method: llvmlite's refuses names that it does not know.
            set.add(function.attributes, _WIDE)
        super().add_ir_module(ir_module)


class _Bitcode(_Library):
    """What it keeps of a function of kernels: its module, and an object that defines its environments alone."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        environments = [it.name for it in self._final_module.global_variables if it.name.startswith(_ENVIRONMENT)]
        module = binding.parse_assembly(
            "\n".join(
                [
                    str(self._codegen._create_empty_module(self.name)),
                    *(f'@"{name}" = common global i8* null' for name in environments),
                ]
            )
        )
        module.name = self.name
        # By this name, of the class that Numba sets it in, the engine finds who keeps what it compiles.
        module._CPUCodeLibrary__library = weakref.proxy(self)
        self._codegen._add_module(module)
        self._finalize_specific()
        self._finalized = True


class ForPython(Compiler):
    """Numba's pipeline for a kernel, which Python calls."""

    library = _Library

    def compile_extra(self, func: Any) -> Any:
        """Type, lower and optimize a function, into a library of this kind."""
        self.state.library = self.library(self.state.targetctx.codegen(), func.__qualname__)
        # Or it could not be cached.
        self.state.library.enable_object_caching()
        return super().compile_extra(func)


class ForKernels(ForPython):
    """Numba's pipeline for a function that only kernels call."""

    library = _Bitcode
