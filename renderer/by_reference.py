"""What kernels are given by reference: a NamedTuple of arrays as one pointer to its fields, `x.field` a load.

Numba takes a tuple apart at each call, and a scene with its scratch is 900 words: to hand them from function to
function was a quarter of the time that kernels took to compile, to take them out of Python's objects most of what a
call cost. `pack` lays them out once, as compiled code has them. Fields stay as they are while a kernel runs, what their
arrays hold does not; each load says so, and leaves a loop whatever that writes.
"""

import functools
import hashlib
import math
import weakref
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, config, types
from numba.core.imputils import impl_ret_borrowed, lower_getattr_generic
from numba.core.registry import cpu_target
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


def _memory_of(kind: types.Type) -> np.dtype:
    """How the value of a type lies in memory."""
    if isinstance(kind, Reference):
        return _struct(map(_memory_of, kind.types))
    if isinstance(kind, types.Array):
        extents = np.dtype((np.int64, (kind.ndim,)))
        # Counter of references, Python's object, entries, bytes of one, the first, shape, strides.
        return _struct([*[np.dtype(np.int64)] * 5, extents, extents])
    if isinstance(kind, types.UniTuple | types.NamedUniTuple):
        return np.dtype((_memory_of(kind.dtype), (kind.count,)))
    if isinstance(kind, types.BaseTuple):
        return _struct(map(_memory_of, kind))
    if isinstance(kind, types.NoneType):
        return np.dtype(np.int64)
    return np.dtype(str(kind))


def _struct(fields: Any) -> np.dtype:
    return np.dtype([(f"f{index}", each) for index, each in enumerate(fields)], align=True)


@functools.cache
def _memory(kind: Reference) -> np.dtype:
    """As `_memory_of`, where LLVM means the same."""
    context, found = cpu_target.target_context, _memory_of(kind)
    context.refresh()
    size = context.get_abi_sizeof(context.get_value_type(kind).pointee)
    assert found.itemsize == size, f"{kind}: {found.itemsize} bytes, {size} of compiled code"
    return found


def _words(kind: types.Type, value: Any) -> Any:
    """What is written to the memory of a value."""
    if isinstance(kind, Reference):
        _refuse_other_shapes(kind, value)
        return tuple(map(_words, kind.types, value))
    if isinstance(kind, types.Array):
        # Of no counter, and no object: whoever holds what is packed holds the array.
        return 0, 0, value.size, value.itemsize, value.ctypes.data, value.shape, value.strides
    if isinstance(kind, types.BaseTuple):
        return tuple(map(_words, kind, value))
    return 0 if value is None else value


def _refuse_other_shapes(kind: Reference, value: Any) -> None:
    """Raise where an array is not as its class says: kernels know how far apart its rows lie."""
    for name, inner in _INNER[kind.cls].items():
        array = getattr(value, name)
        if array is not None and array.shape[1:] != inner:
            allowed = ", ".join(map(str, ("N", *inner)))
            raise ValueError(f"{kind.cls.__name__}.{name}: the shape allowed is ({allowed})")
        if array is not None and not array.flags.c_contiguous:
            raise ValueError(f"{kind.cls.__name__}.{name}: strides = {array.strides}: allowed are rows without gaps")


class Packed:
    """A NamedTuple as compiled code reads it, while this is held."""

    __slots__ = ("__weakref__", "_memory", "_numba_type_", "address", "value")

    def __init__(self, value: Any) -> None:
        kind = numba.typeof(value)
        self.value, self._numba_type_ = value, kind
        self._memory = np.zeros(1, _memory(kind))
        self._memory[0] = _words(kind, value)
        self.address = self._memory.ctypes.data


_PACKED: weakref.WeakValueDictionary[int, Packed] = weakref.WeakValueDictionary()


def pack(value: Any) -> Any:
    """What to call a kernel with in place of a value: of those taken by reference what is `Packed`, others as they are.

    A call packs what is not; as long as somebody holds what this gives, it finds it again.

    Raises
    ------
    ValueError : an array of another shape than its class says, or of one that it says with gaps between its rows.
    """
    if type(value) not in _INNER or cast(Any, config).DISABLE_JIT:
        return value
    found = _PACKED.get(id(value))
    if found is None or found.value is not value:
        found = _PACKED[id(value)] = Packed(value)
    return found


@unbox(Reference)
def _unbox(kind: Reference, value: Any, c: Any) -> NativeValue:
    address = c.pyapi.object_getattr_string(value, "address")
    place = c.pyapi.long_as_voidptr(address)
    c.pyapi.decref(address)
    return NativeValue(c.builder.bitcast(place, c.context.get_value_type(kind)), is_error=c.pyapi.c_api_error())
