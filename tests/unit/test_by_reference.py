"""NamedTuples that kernels take by reference: what they read of them, in time, and what they give back.

Rationale: the pointer, its loads and the counters of arrays are machine code that is written by hand: a wrong field, a
load that is moved over a write, or an array that is never freed would show in no image of a run that is short.
"""

import gc
import os
import re
import sys
import weakref
from typing import NamedTuple

import numpy as np
import pytest

from termwise.renderer.by_reference import by_reference, pack
from termwise.renderer.jit import device, kernel
from termwise.renderer.vector import Vec3

pytestmark = pytest.mark.skipif(os.environ.get("NUMBA_DISABLE_JIT", "0") != "0", reason="compilation is what is tested")


class _Pair(NamedTuple):
    first: np.ndarray
    second: int


@by_reference()
class _Inner(NamedTuple):
    flags: np.ndarray
    numbers: np.ndarray
    weight: Vec3


@by_reference(rows=(3,), corners=(3, 2))
class _Known(NamedTuple):
    rows: np.ndarray
    corners: np.ndarray | None


@by_reference()
class _Outer(NamedTuple):
    on: bool
    missing: _Inner | None
    inner: _Inner
    pair: _Pair
    far: float


@device
def _of_missing(missing: _Inner | None) -> float:
    if missing is not None:
        return missing.weight.x
    return 0.5


@kernel
def _read(outer: _Outer, out: np.ndarray) -> None:
    inner = outer.inner
    out[0] = 1.0 if outer.on else 0.0
    out[1] = _of_missing(outer.missing)
    out[2] = inner.weight.x + 10.0 * inner.weight.y + 100.0 * inner.weight.z
    out[3] = outer.pair.first[1, 0]
    out[4] = outer.pair.second
    out[5] = outer.far
    for i in range(len(inner.numbers)):
        if inner.flags[i]:
            out[6] += inner.numbers[i]


@kernel
def _double(outer: _Outer, times: int) -> float:
    total = 0.0
    for _ in range(times):
        for i in range(len(outer.inner.numbers)):
            outer.inner.numbers[i] *= 2.0
            total += outer.inner.numbers[0]
    return total


@device
def _more(outer: _Outer, count: int) -> int:
    return count + len(outer.inner.numbers)


@kernel
def _count(outer: _Outer, times: int) -> int:
    count = 0
    for _ in range(times):
        count = _more(outer, count)
    return count


def outer(*, on: bool = True, missing: _Inner | None = None) -> _Outer:
    inner = _Inner(np.array([True, False, True]), np.array([1.0, 2.0, 4.0]), Vec3(1.0, 2.0, 3.0))
    return _Outer(on, missing, inner, _Pair(np.arange(4, dtype=np.int32).reshape(2, 2), 7), 9.0)


@kernel
def _sum(known: _Known, row: int, out: np.ndarray) -> None:
    for j in range(known.rows.shape[1]):
        out[0] += known.rows[row, j]
    out[1] = known.rows[row].sum()
    out[2] = len(known.rows)


@device
def _corner_of(corners: np.ndarray | None, row: int) -> float:
    if corners is not None:
        return corners[row, 2, 1] + 1000.0 * corners[row, 1].sum()
    return 0.5


@kernel
def _corner(known: _Known, row: int) -> float:
    return _corner_of(known.corners, row)


@pytest.mark.parametrize("on", [False, True])
def test_fields_are_read(on):
    """Numbers, flags, tuples, arrays of each shape, a reference and a plain tuple within, and one that is missing."""
    out = np.zeros(7)
    _read(outer(on=on), out)
    assert out.tolist() == [float(on), 0.5, 321.0, 2.0, 7.0, 9.0, 5.0]
    _read(outer(on=on, missing=outer().inner._replace(weight=Vec3(8.0, 0.0, 0.0))), out)
    assert out[1] == 8.0


def test_inner_shapes_are_known():
    """Arrays whose rows lie as far apart as the class says have the numbers, the sums and the length of any other."""
    known = _Known(np.arange(15.0).reshape(5, 3), np.arange(24.0).reshape(4, 3, 2))
    out = np.zeros(3)
    _sum(known, 3, out)
    assert out.tolist() == [9.0 + 10.0 + 11.0, 9.0 + 10.0 + 11.0, 5.0]
    assert _corner(known, 2) == 17.0 + 1000.0 * (14.0 + 15.0)
    assert _corner(known._replace(corners=None), 2) == 0.5


@pytest.mark.parametrize(("name", "shape"), [("rows", (5, 4)), ("corners", (4, 2, 3)), ("corners", (4, 3, 1))])
def test_another_inner_shape_is_refused(name, shape):
    """By the class, the field and what is allowed, before anything is read."""
    known = _Known(np.zeros((5, 3)), np.zeros((4, 3, 2)))._replace(**{name: np.zeros(shape)})
    allowed = {"rows": "(N, 3)", "corners": "(N, 3, 2)"}[name]
    out = np.zeros(3)
    with pytest.raises(ValueError, match=re.escape(f"_Known.{name}: the shape allowed is {allowed}")):
        _sum(known, 0, out)
    assert not out.any()


def test_what_is_packed_is_found_again_while_it_is_held():
    """By the tuple itself: an equal one is another, and what nobody holds is laid out anew."""
    given = outer()
    held = pack(given)
    assert pack(given) is held
    assert pack(given._replace()) is not held
    assert held.value is given
    end = weakref.ref(held)
    del held
    gc.collect()
    assert end() is None
    assert pack(7) == 7


def test_a_tuple_that_is_laid_out_otherwise_is_refused():
    """A tuple that has one of these in it and is none itself: compiled code has its address there."""

    class _Around(NamedTuple):
        inner: _Inner

    @by_reference()
    class _Wrong(NamedTuple):
        around: _Around

    with pytest.raises(AssertionError, match="bytes"):
        pack(_Wrong(_Around(outer().inner)))


def test_gaps_between_rows_are_refused():
    """Every second row has the shape that is allowed, and lies where none would be looked for."""
    known = _Known(np.zeros((10, 3))[::2], np.zeros((4, 3, 2)))
    with pytest.raises(ValueError, match=re.escape("_Known.rows: strides = (48, 8): allowed are rows without gaps")):
        _sum(known, 0, np.zeros(3))


def test_what_arrays_hold_is_read_anew():
    """Fields stay, their arrays' content does not: 1, 2, 4 doubled five times, the first summed up after each."""
    given = outer()
    assert _double(given, 5) == 3 * (2 + 4 + 8 + 16 + 32)
    assert given.inner.numbers.tolist() == [32.0, 64.0, 128.0]


def test_arrays_are_given_back():
    """Their counts of references are what they were, and they can be freed."""
    given = outer()
    arrays = given.inner.flags, given.inner.numbers, given.pair.first
    before = [sys.getrefcount(array) for array in arrays]
    for _ in range(10):
        _double(given, 1)
        _count(given, 3)
    assert [sys.getrefcount(array) for array in arrays] == before
    ends = [weakref.ref(array) for array in arrays]
    del given, arrays
    gc.collect()
    assert all(end() is None for end in ends)


def test_other_fields_are_another_type():
    """A field of another type has code of its own, and the right one is called."""
    given = outer()
    assert _count(given, 2) == 6
    wide = given._replace(inner=given.inner._replace(numbers=np.zeros(5, np.float32)))
    assert (_count(wide, 2), _count(given, 1)) == (10, 3)


def test_a_count_that_begins_at_0_is_compiled_once(tmp_path, monkeypatch):
    """A kernel hands on a 0, then an integer: to Numba the 0 is a type of its own, and all behind it compiled twice."""
    monkeypatch.setenv("TERMWISE_CACHE", str(tmp_path))  # a kernel that is found there compiles nothing

    @device
    def more(outer: _Outer, count: int) -> int:
        return count + len(outer.inner.numbers)

    @kernel
    def count(outer: _Outer, times: int) -> int:
        count = 0
        for _ in range(times):
            count = more(outer, count)
        return count

    assert count(outer(), 2) == 6
    kinds = [signature[1] for signature in more._for_kernels.overloads]
    assert kinds
    assert all(str(kind) == "int64" for kind in kinds)


def test_an_unknown_field_is_refused():
    """As of any type: a typing error that names it."""

    @kernel
    def wrong(outer: _Outer) -> float:
        return outer.nothing  # pyright: ignore

    with pytest.raises(Exception, match="nothing"):
        wrong(outer())
