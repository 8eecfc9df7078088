"""How kernels are compiled, and how they reach the arrays that are bound to them once and for all.

Handing an array to a compiled function costs some 60 ns each time; a tick needs forty. The bound
ones are therefore handed over as one table of addresses and sizes: `vector`, `matrix` and `cube`
make arrays of its rows. Whoever makes the table keeps the arrays alive.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from numba import carray, config, njit, types  # type: ignore[attr-defined]
from numba.extending import intrinsic

__all__ = ["compiled", "entry", "cube", "integers", "matrix", "vector"]

# Sums may be reordered and multiply-adds fused (rounding only); NaN and inf keep their meaning.
_FASTMATH = {"contract", "reassoc", "nsz"}


_OPTIONS: dict[str, Any] = {
    "error_model": "numpy", "fastmath": _FASTMATH, "no_cfunc_wrapper": True,
}  # fmt: skip
_njit: Any = njit
_PLAIN_PYTHON: bool = getattr(config, "DISABLE_JIT")  # noqa: B009 - set at run time


def compiled(function: Any) -> Any:
    """A part of a kernel, to be called from other compiled functions only."""
    return _njit(no_cpython_wrapper=True, **_OPTIONS)(function)


def entry(function: Any) -> Any:
    """A kernel that Python calls; compiled at its first call, then cached on disk."""
    if _PLAIN_PYTHON:
        return np.errstate(all="ignore")(function)  # compiled code does not warn either
    return _njit(cache=True, **_OPTIONS)(function)


@intrinsic
def _doubles_at(context, address):
    pointer = types.CPointer(types.float64)

    def generate(context, builder, signature, arguments):
        return builder.inttoptr(arguments[0], context.get_value_type(pointer))

    return pointer(types.int64), generate


@intrinsic
def _integers_at(context, address):
    pointer = types.CPointer(types.int64)

    def generate(context, builder, signature, arguments):
        return builder.inttoptr(arguments[0], context.get_value_type(pointer))

    return pointer(types.int64), generate


if _PLAIN_PYTHON:

    def _view(bound: Any, row: int, axes: int, kind: Any) -> Any:
        shape = tuple(int(size) for size in bound[row, 1 : 1 + axes])
        buffer = (kind * int(np.prod(shape))).from_address(int(bound[row, 0]))
        return np.ctypeslib.as_array(buffer).reshape(shape)

    def vector(bound: Any, row: int) -> Any:
        """Bound array of floats, one axis."""
        return _view(bound, row, 1, ctypes.c_double)

    def matrix(bound: Any, row: int) -> Any:
        """Bound array of floats, two axes."""
        return _view(bound, row, 2, ctypes.c_double)

    def cube(bound: Any, row: int) -> Any:
        """Bound array of floats, three axes."""
        return _view(bound, row, 3, ctypes.c_double)

    def integers(bound: Any, row: int) -> Any:
        """Bound array of integers, two axes."""
        return _view(bound, row, 2, ctypes.c_int64)

else:

    @compiled
    def vector(bound, row):
        """Bound array of floats, one axis."""
        return carray(_doubles_at(bound[row, 0]), (bound[row, 1],))

    @compiled
    def matrix(bound, row):
        """Bound array of floats, two axes."""
        return carray(_doubles_at(bound[row, 0]), (bound[row, 1], bound[row, 2]))

    @compiled
    def cube(bound, row):
        """Bound array of floats, three axes."""
        return carray(_doubles_at(bound[row, 0]), (bound[row, 1], bound[row, 2], bound[row, 3]))

    @compiled
    def integers(bound, row):
        """Bound array of integers, two axes."""
        return carray(_integers_at(bound[row, 0]), (bound[row, 1], bound[row, 2]))
