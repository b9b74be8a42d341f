"""What kernels are given by reference: a NamedTuple of arrays as one pointer to its fields, `x.field` a load.

Numba takes a tuple apart at each call, and a scene with its scratch is 900 words: to hand them from function to
function was a quarter of the time that kernels took to compile. Fields stay as they are while a kernel runs, what their
arrays hold does not; each load says so, and leaves a loop whatever that writes.
"""

import hashlib
import math
from collections.abc import Callable
from typing import Any, TypeVar

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.imputils import impl_ret_borrowed, lower_getattr_generic
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import NativeValue, models, register_model, typeof_impl, unbox

C = TypeVar("C", bound=type[tuple[Any, ...]])


class Reference(types.Type):
    """Numba's type of a NamedTuple `cls` whose fields have the `types`."""

    def __init__(self, cls: Any, fields: tuple[types.Type, ...]) -> None:
        self.cls, self.types = cls, fields
        # Names of functions are made of those of their arguments' types: in full they are pages long.
        digest = hashlib.sha256(", ".join(map(str, fields)).encode()).hexdigest()
        super().__init__(f"{cls.__qualname__}&{digest[:16]}")

    @property
    def key(self) -> Any:
        """What makes two types one."""
        return self.cls, self.types

    def index(self, name: str) -> int:
        """Of a field."""
        return self.cls._fields.index(name)


def by_reference(**inner: tuple[int, ...]) -> Callable[[C], C]:
    """Have kernels take a NamedTuple of this class by reference. They read its fields, and make none themselves.

    One that is not so decorated is taken apart at each call: the same images, compiled in more time.

    Parameters
    ----------
    inner : of arrays the shape behind the first axis, where it is always the same: kernels need not read how far apart
        rows lie.
    """

    def decorate(cls: C) -> C:
        def typeof(value: Any, context: Any) -> Reference:
            return Reference(cls, tuple(typeof_impl(each, context) for each in value))

        typeof_impl.register(cls)(typeof)
        _INNER[cls] = inner
        return cls

    return decorate


_INNER: dict[Any, dict[str, tuple[int, ...]]] = {}


@register_model(Reference)
class _Model(models.PrimitiveModel):
    """A pointer to the fields, those that are references themselves within."""

    def __init__(self, dmm: Any, kind: Reference) -> None:
        inner = [dmm.lookup(each).get_value_type() for each in kind.types]
        fields = [
            value.pointee if isinstance(each, Reference) else value
            for each, value in zip(kind.types, inner, strict=True)
        ]
        super().__init__(dmm, kind, ir.LiteralStructType(fields).as_pointer())


@infer_getattr
class _Fields(AttributeTemplate):
    key = Reference

    def generic_resolve(self, kind: Reference, name: str) -> types.Type | None:
        return kind.types[kind.index(name)] if name in kind.cls._fields else None


@lower_getattr_generic(Reference)
def _field(context: Any, builder: Any, kind: Reference, pointer: Any, name: str) -> Any:
    index = kind.index(name)
    place = cgutils.gep_inbounds(builder, pointer, 0, index)
    field = kind.types[index]
    value = place if isinstance(field, Reference) else _load(builder, place, _known(context, kind, index))
    return impl_ret_borrowed(context, builder, field, value)


def _known(context: Any, kind: Reference, index: int) -> dict[tuple[int, ...], int]:
    """Numbers of an array whose inner shape is known, each by its place in what Numba has of an array."""
    array, inner = kind.types[index], _INNER[kind.cls].get(kind.cls._fields[index])
    if inner is None or not isinstance(array, types.Array):
        return {}
    model = context.data_model_manager[array]
    size = context.get_abi_sizeof(context.get_data_type(array.dtype))
    shape, strides = model.get_field_position("shape"), model.get_field_position("strides")
    known = {(strides, axis): size * math.prod(inner[axis:]) for axis in range(array.ndim)}
    return known | {(shape, axis + 1): extent for axis, extent in enumerate(inner)}


def _load(builder: Any, place: Any, known: dict[tuple[int, ...], int], at: tuple[int, ...] = ()) -> Any:
    """What stands at a place, number by number: LLVM would take a whole apart, and forget that it stays."""
    kind = place.type.pointee
    if at in known:
        return ir.Constant(kind, known[at])
    if not isinstance(kind, ir.LiteralStructType | ir.ArrayType):
        value = builder.load(place)
        value.set_metadata("invariant.load", builder.module.add_metadata([]))
        return value
    value = ir.Constant(kind, ir.Undefined)
    for index in range(len(kind)):
        inner = _load(builder, cgutils.gep_inbounds(builder, place, 0, index), known, (*at, index))
        value = builder.insert_value(value, inner, index)
    return value


def _refuse_other_shapes(c: Any, kind: Reference, index: int, place: Any, failed: Any) -> None:
    """Raise where an array at a place is not as its class says."""
    name = kind.cls._fields[index]
    inner = _INNER[kind.cls].get(name, ()) if isinstance(kind.types[index], types.Array) else ()
    for axis, extent in enumerate(inner):
        # Not its strides: those of an array of nothing may be 0.
        shape = c.context.data_model_manager[kind.types[index]].get_field_position("shape")
        found = c.builder.load(cgutils.gep_inbounds(c.builder, place, 0, shape, axis + 1))
        with cgutils.if_unlikely(c.builder, c.builder.icmp_signed("!=", found, ir.Constant(found.type, extent))):
            allowed = ", ".join(map(str, ("N", *inner)))
            c.pyapi.err_set_string("PyExc_ValueError", f"{kind.cls.__name__}.{name}: the shape allowed is ({allowed})")
            c.builder.store(cgutils.true_bit, failed)


@unbox(Reference)
def _unbox(kind: Reference, value: Any, c: Any) -> NativeValue:
    place = cgutils.alloca_once(c.builder, c.context.get_value_type(kind).pointee)
    failed = cgutils.alloca_once_value(c.builder, cgutils.false_bit)
    held: list[tuple[types.Type, NativeValue]] = []

    def fill(kind: Reference, value: Any, place: Any) -> None:
        for index, each in enumerate(kind.types):
            item = c.pyapi.tuple_getitem(value, index)
            where = cgutils.gep_inbounds(c.builder, place, 0, index)
            if isinstance(each, Reference):
                fill(each, item, where)
                continue
            native = c.unbox(each, item)
            c.builder.store(native.value, where)
            with cgutils.if_unlikely(c.builder, native.is_error):
                c.builder.store(cgutils.true_bit, failed)
            _refuse_other_shapes(c, kind, index, where, failed)
            held.append((each, native))

    def release() -> None:
        for each, native in held:
            if native.cleanup is not None:
                native.cleanup()
            if c.context.enable_nrt:
                c.context.nrt.decref(c.builder, each, native.value)

    fill(kind, value, place)
    # These writes and the loads that never change are not seen together: Numba's wrapper inlines no call.
    return NativeValue(place, is_error=c.builder.load(failed), cleanup=release)
