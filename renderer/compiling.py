"""Numba's pipelines for kernels, and for functions that are linked into kernels and run nowhere else.

Loops are vectorised as widely as the processor can, and indices counted from the begin of an array. Numba makes machine
code of each function that it compiles, and again of each kernel that a function is linked into: nine functions of ten
are never called but by kernels, and of these only LLVM's bitcode is kept.
"""

import weakref
from typing import Any

from llvmlite import binding
from numba.core import types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_machinery import register_pass
from numba.core.ir import Expr
from numba.core.ir_utils import find_const, get_definition, guard
from numba.core.lowering import Lower
from numba.core.typed_passes import BaseNativeLowering, NativeLowering

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


def _counted(index: types.Type) -> types.Type | None:
    """Type of an index, or a tuple of them, that is counted from an array's begin; None if it is no such index."""
    if isinstance(index, types.BaseTuple):
        each = [_counted(part) for part in index]
        return None if None in each else types.Tuple(each)
    return types.uintp if isinstance(index, types.Integer) else None


class _FromBegin(Lower):
    """Indices of arrays are counted from their begin: none is negative, which Numba makes three instructions sure of.

    A negative constant is Python's, from the end.
    """

    def lower_getitem(self, resty: Any, expr: Any, value: Any, index: Any, signature: Any) -> Any:
        return super().lower_getitem(resty, expr, value, index, self._counted(signature, index))

    def lower_setitem(self, target_var: Any, index_var: Any, value_var: Any, signature: Any) -> Any:
        return super().lower_setitem(target_var, index_var, value_var, self._counted(signature, index_var))

    def _counted(self, signature: Any, index: Any) -> Any:
        """The signature of an access to an array, its index without a sign."""
        container, kind, *value = signature.args
        counted = _counted(kind) if isinstance(container, types.Array) else None
        if counted is None or self._is_from_end(index):
            return signature
        return signature.replace(args=(container, counted, *value))

    def _is_from_end(self, index: Any) -> bool:
        """Whether an index, or one of a tuple, is a negative constant."""
        found = guard(get_definition, self.func_ir, index)
        if isinstance(found, Expr) and found.op == "build_tuple":
            return any(map(self._is_from_end, found.items))
        constant = guard(find_const, self.func_ir, index)
        return isinstance(constant, int) and constant < 0


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(BaseNativeLowering):
    _name = "lowering_with_indices_from_the_begin"

    @property
    def lowering_class(self) -> type[Lower]:
        return _FromBegin


class ForPython(Compiler):
    """Numba's pipeline for a kernel, which Python calls."""

    library = _Library

    def define_pipelines(self) -> Any:
        """Those of Numba, but for how arrays are indexed."""
        pipelines = super().define_pipelines()
        for pipeline in pipelines:
            pipeline.passes = [(_Lowering if each is NativeLowering else each, why) for each, why in pipeline.passes]
            pipeline.finalize()
        return pipelines

    def compile_extra(self, func: Any) -> Any:
        """Type, lower and optimize a function, into a library of this kind."""
        self.state.library = self.library(self.state.targetctx.codegen(), func.__qualname__)
        # Or it could not be cached.
        self.state.library.enable_object_caching()
        return super().compile_extra(func)


class ForKernels(ForPython):
    """Numba's pipeline for a function that only kernels call."""

    library = _Bitcode
