"""Functions that are linked into kernels and run nowhere else: kept as bitcode of LLVM, without machine code.

Numba makes machine code of each function that it compiles, and again of each kernel that a function is linked into;
nine functions of ten are never called but by kernels.
"""

import weakref
from typing import Any

from llvmlite import binding
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler

ENVIRONMENT = "_ZN08NumbaEnv"
"""How names of environments begin: a variable a function, whose address Numba asks for when it has compiled it."""


class _Library(JITCodeLibrary):
    """What Numba keeps of a function: its module, and an object that defines its environments alone."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        environments = [each.name for each in self._final_module.global_variables if each.name.startswith(ENVIRONMENT)]
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


class ForKernels(Compiler):
    """Numba's pipeline for a function that only kernels call."""

    def compile_extra(self, func: Any) -> Any:
        """Type, lower and optimize a function, into a library without machine code."""
        self.state.library = _Library(self.state.targetctx.codegen(), func.__qualname__)
        # Or it could not be cached.
        self.state.library.enable_object_caching()
        return super().compile_extra(func)
