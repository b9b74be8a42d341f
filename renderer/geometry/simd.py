"""Vectors of 8 or 16 lanes as values of compiled code: `a + b` on `<8 x float>` is one instruction.

Numba has scalars and arrays only, and LLVM's vectoriser does not find the 8 boxes of a node by itself. A `Vector` is a
type of Numba whose value is an LLVM vector, so it lives in a register; operators and the functions below lower to
LLVM's generic vector instructions, and LLVM chooses AVX2 or AVX-512. No instruction is contracted or reordered: a
lane of `a * b - c` has the bits of the scalar expression.

Nothing here can run as plain Python (`NUMBA_DISABLE_JIT=1`): see `available`.
"""

import functools
import operator
from typing import Any, cast

import llvmlite.binding as llvm
import llvmlite.ir as ir
import numpy as np
from numba.core import cgutils, config, types
from numba.core.datamodel.models import PrimitiveModel
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic as _intrinsic
from numba.extending import lower_builtin, register_model

from termwise.renderer.jit import device
from termwise.renderer.vector import Vec3

# pyright believes that an intrinsic is called with its typing context, and that `infer_global` may be None.
intrinsic = cast(Any, _intrinsic)
_typed = cast(Any, infer_global)


@functools.cache
def available() -> bool:
    """Whether compiled code may use vectors: it is compiled at all, and the processor has AVX2 and FMA.

    With SSE alone a vector of 8 is several instructions, `llvm.fma` a call of the C library, and the wide tree slower
    than the binary one.
    """
    features = cast(Any, llvm.get_host_cpu_features())
    return not cast(Any, config).DISABLE_JIT and bool(features.get("avx2")) and bool(features.get("fma"))


class Vector(types.Type):
    """The type of a vector: `lanes` of float32, float64, int32 or bool."""

    def __init__(self, element: types.Type, lanes: int) -> None:
        self.element, self.lanes = element, lanes
        super().__init__(f"Vector({element}, {lanes})")


_ELEMENTS: dict[types.Type, ir.Type] = {
    types.float32: ir.FloatType(),
    types.float64: ir.DoubleType(),
    types.int32: ir.IntType(32),
    types.boolean: ir.IntType(1),
}
_FLOATS = (types.float32, types.float64)


@register_model(Vector)
class _VectorModel(PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Vector) -> None:
        super().__init__(dmm, fe_type, ir.VectorType(_ELEMENTS[fe_type.element], fe_type.lanes))


def _is_float(vector: Vector) -> bool:
    return vector.element in _FLOATS


def _binary(function: Any, float_op: str | None, integer_op: str | None) -> None:
    """Let an operator take two equal vectors."""

    @_typed(function)
    class Operator(AbstractTemplate):  # pyright: ignore[reportUnusedClass]
        def generic(self, args: Any, kws: Any) -> Any:
            if len(args) == 2 and isinstance(args[0], Vector) and args[0] == args[1]:
                if (float_op if _is_float(args[0]) else integer_op) is not None:
                    return signature(args[0], *args)
            return None

    @lower_builtin(function, Vector, Vector)
    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        name = float_op if _is_float(sig.args[0]) else integer_op
        return getattr(builder, cast(str, name))(*args)


def _comparison(function: Any, sign: str) -> None:
    """Let a comparison take two equal vectors; a NaN compares false, except with `!=`, as scalars do."""

    @_typed(function)
    class Comparison(AbstractTemplate):  # pyright: ignore[reportUnusedClass]
        def generic(self, args: Any, kws: Any) -> Any:
            if len(args) == 2 and isinstance(args[0], Vector) and args[0] == args[1]:
                return signature(Vector(types.boolean, args[0].lanes), *args)
            return None

    @lower_builtin(function, Vector, Vector)
    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        if not _is_float(sig.args[0]):
            return builder.icmp_signed(sign, *args)
        return (builder.fcmp_unordered if sign == "!=" else builder.fcmp_ordered)(sign, *args)


_binary(operator.add, "fadd", "add")
_binary(operator.sub, "fsub", "sub")
_binary(operator.mul, "fmul", "mul")
_binary(operator.truediv, "fdiv", None)
_binary(operator.and_, None, "and_")
_binary(operator.or_, None, "or_")
_binary(operator.xor, None, "xor")
_comparison(operator.lt, "<")
_comparison(operator.le, "<=")
_comparison(operator.gt, ">")
_comparison(operator.ge, ">=")
_comparison(operator.eq, "==")
_comparison(operator.ne, "!=")


def _literal(value: types.Type) -> int:
    assert isinstance(value, types.IntegerLiteral)
    return value.literal_value


def _data(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    """Where the entries of the first argument, an array, begin."""
    return context.make_array(sig.args[0])(context, builder, args[0]).data


def _call(builder: Any, name: str, result: Any, operands: Any) -> Any:
    """Call one of LLVM's own functions."""
    of = ir.FunctionType(result, [operand.type for operand in operands])
    return builder.call(cgutils.get_or_insert_function(builder.module, of, name), operands)


def _named(kind: Any) -> str:
    """How LLVM's functions of float vectors name a type."""
    return f"v{kind.count}{'f32' if isinstance(kind.element, ir.FloatType) else 'f64'}"


@intrinsic(prefer_literal=True)
def load(typingctx: Any, array: Any, start: Any, lanes: Any) -> Any:
    """Entries start ... start + lanes - 1 of a C-contiguous array, counted over all of it; no alignment is needed."""
    if not (isinstance(array, types.Array) and array.layout == "C" and isinstance(lanes, types.IntegerLiteral)):
        return None
    vector = Vector(array.dtype, _literal(lanes))

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        place = builder.gep(_data(context, builder, sig, args), [args[1]], inbounds=True)
        value = context.get_value_type(vector)
        loaded = builder.load(builder.bitcast(place, value.as_pointer()))
        loaded.align = np.dtype(str(array.dtype)).itemsize
        return loaded

    return vector(array, types.intp, lanes), codegen


@intrinsic
def load_int(typingctx: Any, array: Any, start: Any) -> Any:
    """The int32 that begins `start` times 4 bytes after the begin of a C-contiguous array of any type."""
    if not (isinstance(array, types.Array) and array.layout == "C"):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        integers = builder.bitcast(_data(context, builder, sig, args), ir.IntType(32).as_pointer())
        return builder.sext(builder.load(builder.gep(integers, [args[1]], inbounds=True)), ir.IntType(64))

    return types.int64(array, types.intp), codegen


@intrinsic(prefer_literal=True)
def store(typingctx: Any, array: Any, start: Any, vector: Any) -> Any:
    """Write a vector to entries start ... of a C-contiguous array."""
    if not (isinstance(array, types.Array) and array.layout == "C" and isinstance(vector, Vector)):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        place = builder.gep(_data(context, builder, sig, args), [args[1]], inbounds=True)
        builder.store(
            args[2], builder.bitcast(place, args[2].type.as_pointer()), align=np.dtype(str(array.dtype)).itemsize
        )
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), codegen


@intrinsic(prefer_literal=True)
def splat(typingctx: Any, value: Any, lanes: Any) -> Any:
    """The same number in all lanes."""
    if value not in _ELEMENTS or not isinstance(lanes, types.IntegerLiteral):
        return None
    vector = Vector(value, _literal(lanes))

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = context.get_value_type(vector)
        empty = ir.Constant(kind, ir.Undefined)
        first = builder.insert_element(empty, args[0], ir.Constant(ir.IntType(32), 0))
        lane = ir.Constant(ir.VectorType(ir.IntType(32), vector.lanes), [0] * vector.lanes)
        return builder.shuffle_vector(first, empty, lane)

    return vector(value, lanes), codegen


@intrinsic(prefer_literal=True)
def numbers(typingctx: Any, lanes: Any) -> Any:
    """0, 1, 2, ... as int32."""
    if not isinstance(lanes, types.IntegerLiteral):
        return None
    vector = Vector(types.int32, _literal(lanes))
    return vector(lanes), lambda context, builder, sig, args: ir.Constant(
        context.get_value_type(vector), list(range(vector.lanes))
    )


@device
def rows(array: np.ndarray, first: int) -> tuple:
    """Entries first ... first + 7 of the rows of a C-contiguous (3, N) array."""
    size = array.shape[1]
    return load(array, first, 8), load(array, size + first, 8), load(array, 2 * size + first, 8)


@device
def put_rows(array: np.ndarray, first: int, vectors: tuple) -> None:
    """Write three vectors of 8 lanes to where `rows` reads them."""
    size = array.shape[1]
    store(array, first, vectors[0])
    store(array, size + first, vectors[1])
    store(array, 2 * size + first, vectors[2])


@device
def in_lanes(mask: int, v: Vec3, others: tuple) -> tuple:
    """A vector of three numbers in the lanes of a mask, and what others are in the others."""
    return (
        choose(mask, splat(v.x, 8), others[0]),
        choose(mask, splat(v.y, 8), others[1]),
        choose(mask, splat(v.z, 8), others[2]),
    )


@intrinsic(prefer_literal=True)
def copy(typingctx: Any, to: Any, array: Any) -> Any:
    """Write all entries of a C-contiguous array to another of the same shape, which does not overlap it."""
    if not (isinstance(array, types.Array) and array.layout == "C" and to.layout == "C" and to.dtype == array.dtype):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        into, given = (
            context.make_array(kind)(context, builder, arg) for kind, arg in zip(sig.args, args, strict=True)
        )
        cgutils.raw_memcpy(builder, into.data, given.data, given.nitems, given.itemsize)
        return context.get_dummy_value()

    return types.void(to, array), codegen


@intrinsic
def columns(typingctx: Any, array: Any, first: Any) -> Any:
    """Rows first ... first + 7 of a C-contiguous (N, 3) array as three vectors of float64, one a column."""
    if not (isinstance(array, types.Array) and array.layout == "C" and array.ndim == 2):
        return None
    vector = Vector(types.float64, 8)
    three = types.UniTuple(vector, 3)

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = context.get_value_type(Vector(array.dtype, 8))
        start = builder.mul(args[1], ir.Constant(args[1].type, 3))
        place = builder.gep(_data(context, builder, sig, args), [start], inbounds=True)
        place = builder.bitcast(place, kind.as_pointer())
        parts = [builder.load(builder.gep(place, [ir.Constant(ir.IntType(32), i)])) for i in range(3)]
        for part in parts:
            part.align = np.dtype(str(array.dtype)).itemsize

        def chosen(a: Any, b: Any, numbers: Any) -> Any:
            return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(ir.IntType(32), 8), list(numbers)))

        found = []
        for column in range(3):
            places = range(column, 24, 3)
            begin = chosen(parts[0], parts[1], (place % 16 for place in places))
            found.append(chosen(begin, parts[2], (i if place < 16 else place - 8 for i, place in enumerate(places))))
        if array.dtype == types.float32:
            found = [builder.fpext(each, context.get_value_type(vector)) for each in found]
        return context.make_tuple(builder, three, found)

    return three(array, types.intp), codegen


@intrinsic
def narrow(typingctx: Any, vector: Any) -> Any:
    """float64 lanes rounded to float32."""
    to = Vector(types.float32, vector.lanes)
    return to(vector), lambda context, builder, sig, args: builder.fptrunc(args[0], context.get_value_type(to))


def _reduction(sign: str) -> Any:
    """Halve the vector, and choose between the halves, until one lane is left."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        value = args[0]
        while value.type.count > 1:
            half = value.type.count // 2
            lanes = ir.VectorType(ir.IntType(32), half)
            undefined = ir.Constant(value.type, ir.Undefined)
            low, high = (
                builder.shuffle_vector(value, undefined, ir.Constant(lanes, list(range(first, first + half))))
                for first in (0, half)
            )
            value = _select(sign)(builder, low, high)
        return builder.extract_element(value, ir.Constant(ir.IntType(32), 0))

    return codegen


@intrinsic
def lowest(typingctx: Any, vector: Any) -> Any:
    """The least lane of a float vector without NaN."""
    return vector.element(vector), _reduction("<")


@intrinsic
def highest(typingctx: Any, vector: Any) -> Any:
    """The greatest lane of a float vector without NaN."""
    return vector.element(vector), _reduction(">")


@intrinsic
def magnitude(typingctx: Any, vector: Any) -> Any:
    """Absolute values."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = args[0].type
        return _call(builder, f"llvm.fabs.{_named(kind)}", kind, args)

    return vector(vector), codegen


@intrinsic
def negative(typingctx: Any, vector: Any) -> Any:
    """Float lanes with their signs turned, those of zeros too."""
    return vector(vector), lambda context, builder, sig, args: builder.fneg(args[0])


@intrinsic
def extract(typingctx: Any, vector: Any, lane: Any) -> Any:
    """One lane as a scalar."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.extract_element(args[0], args[1])

    return vector.element(vector, types.intp), codegen


@intrinsic
def bits(typingctx: Any, mask: Any) -> Any:
    """A mask as an integer: bit i is lane i."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        packed = builder.bitcast(args[0], ir.IntType(mask.lanes))
        return builder.zext(packed, ir.IntType(64))

    return types.int64(mask), codegen


def _select(sign: str) -> Any:
    def build(builder: Any, a: Any, b: Any) -> Any:
        compare = builder.fcmp_ordered if isinstance(a.type.element, ir.FloatType | ir.DoubleType) else None
        return builder.select((compare or builder.icmp_signed)(sign, a, b), a, b)

    return build


@intrinsic
def minimum(typingctx: Any, a: Any, b: Any) -> Any:
    """Lane by lane a < b ? a : b, one instruction; a NaN in a gives b."""
    return a(a, a), lambda context, builder, sig, args: _select("<")(builder, *args)


@intrinsic
def maximum(typingctx: Any, a: Any, b: Any) -> Any:
    """Lane by lane a > b ? a : b, one instruction; a NaN in a gives b."""
    return a(a, a), lambda context, builder, sig, args: _select(">")(builder, *args)


@intrinsic
def choose(typingctx: Any, mask: Any, a: Any, b: Any) -> Any:
    """Lane by lane mask ? a : b."""
    return a(mask, a, a), lambda context, builder, sig, args: builder.select(*args)


def _fused(negative: bool) -> Any:
    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        a, b, c = args
        return _call(builder, f"llvm.fma.{_named(a.type)}", a.type, (a, b, builder.fneg(c) if negative else c))

    return codegen


@intrinsic
def fma(typingctx: Any, a: Any, b: Any, c: Any) -> Any:
    """Lane by lane a b + c, rounded once."""
    return a(a, a, a), _fused(False)


@intrinsic
def fms(typingctx: Any, a: Any, b: Any, c: Any) -> Any:
    """Lane by lane a b - c, rounded once."""
    return a(a, a, a), _fused(True)


@intrinsic
def widen(typingctx: Any, vector: Any) -> Any:
    """float32 lanes as float64, exact; float64 lanes as they are."""
    wide = Vector(types.float64, vector.lanes)

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return args[0] if vector == wide else builder.fpext(args[0], context.get_value_type(wide))

    return wide(vector), codegen


@intrinsic
def as_int(typingctx: Any, vector: Any) -> Any:
    """The bits of float32 lanes: of numbers >= 0 they have the numbers' order."""
    to = Vector(types.int32, vector.lanes)
    return to(vector), lambda context, builder, sig, args: builder.bitcast(args[0], context.get_value_type(to))


@intrinsic
def smallest(typingctx: Any, vector: Any) -> Any:
    """The least lane of an int32 vector."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = args[0].type
        return _call(builder, f"llvm.vector.reduce.smin.v{kind.count}i32", kind.element, args)

    return types.int32(vector), codegen


@intrinsic
def compress(typingctx: Any, vector: Any, mask: Any) -> Any:
    """The lanes of an int32 vector where the mask is set, moved to the front; the others are undefined."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = args[0].type
        operands = [*args, ir.Constant(kind, ir.Undefined)]
        return _call(builder, f"llvm.experimental.vector.compress.v{kind.count}i32", kind, operands)

    return vector(vector, mask), codegen


@intrinsic
def count_bits(typingctx: Any, value: Any) -> Any:
    """Number of bits that are set."""
    return types.int64(types.int64), lambda context, builder, sig, args: builder.ctpop(args[0])


@intrinsic(prefer_literal=True)
def load_ints(typingctx: Any, array: Any, start: Any, lanes: Any) -> Any:
    """int32 lanes that begin `start` times 4 bytes after the begin of a C-contiguous array of any type."""
    if not (isinstance(array, types.Array) and array.layout == "C" and isinstance(lanes, types.IntegerLiteral)):
        return None
    vector = Vector(types.int32, _literal(lanes))

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        integers = builder.bitcast(_data(context, builder, sig, args), ir.IntType(32).as_pointer())
        place = builder.gep(integers, [args[1]], inbounds=True)
        loaded = builder.load(builder.bitcast(place, context.get_value_type(vector).as_pointer()))
        loaded.align = 4
        return loaded

    return vector(array, types.intp, lanes), codegen


@intrinsic
def size_of(typingctx: Any, array: Any) -> Any:
    """Bytes of an entry of an array, which the compiler knows; `array.itemsize` is read each time."""
    size = np.dtype(str(array.dtype)).itemsize
    return types.intp(array), lambda context, builder, sig, args: context.get_constant(types.intp, size)


@intrinsic
def prefetch(typingctx: Any, array: Any, index: Any) -> Any:
    """Fetch the cache line of an entry of a C-contiguous array, which need not exist."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        place = builder.gep(_data(context, builder, sig, args), [args[1]])
        number = ir.IntType(32)
        place = builder.bitcast(place, ir.IntType(8).as_pointer())
        kind = ir.FunctionType(ir.VoidType(), [place.type, number, number, number])
        fetch = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        builder.call(fetch, [place, *(ir.Constant(number, value) for value in (0, 3, 1))])
        return context.get_dummy_value()

    return types.void(array, types.intp), codegen


@intrinsic
def lowest_bit(typingctx: Any, value: Any) -> Any:
    """Index of the lowest bit that is set; the value is not 0."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.int64), codegen


@intrinsic
def highest_bit(typingctx: Any, value: Any) -> Any:
    """Index of the highest bit that is set; the value is not 0."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        zeros = builder.ctlz(args[0], ir.Constant(ir.IntType(1), 1))
        return builder.xor(zeros, ir.Constant(ir.IntType(64), 63))

    return types.int64(types.int64), codegen
