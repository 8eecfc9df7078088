"""How kernels are compiled, and how they reach the arrays that are bound to them once and for all.

Handing an array to a compiled function costs some 60 ns each time; a tick needs forty. The bound
ones are therefore handed over as one table of addresses and sizes: `vector`, `matrix` and `cube`
make arrays of its rows. Whoever makes the table keeps the arrays alive.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from numba import config, njit, types
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from osc_contact.kernels.parts import PartCompiler, once_per_type

__all__ = ["compiled", "entry", "cube", "integers", "matrix", "pose_in", "vector"]

# Sums may be reordered and multiply-adds fused (rounding only); NaN and inf keep their meaning.
_FASTMATH = {"contract", "reassoc", "nsz"}


_OPTIONS: dict[str, Any] = {
    "error_model": "numpy", "fastmath": _FASTMATH, "no_cfunc_wrapper": True,
    "_nrt": False,  # nothing is made, so nothing is counted
}  # fmt: skip
_njit: Any = njit
_PLAIN_PYTHON: bool = getattr(config, "DISABLE_JIT")  # noqa: B009 - set at run time


def compiled(function: Any) -> Any:
    """A part of a kernel, to be called from other compiled functions only."""
    if _PLAIN_PYTHON:
        return function
    options = {**_OPTIONS, "no_cpython_wrapper": True, "pipeline_class": PartCompiler}
    return once_per_type(_njit(**options)(function))


def entry(function: Any) -> Any:
    """A kernel that Python calls; compiled at its first call, then cached on disk."""
    if _PLAIN_PYTHON:
        return np.errstate(all="ignore")(function)  # compiled code does not warn either
    return _njit(cache=True, **_OPTIONS)(function)


def _array(dtype: Any, axes: int) -> Any:
    """An intrinsic that makes an array, `axes` axes, of a row of the table."""

    @intrinsic
    def made(context: Any, bound: Any, row: Any) -> Any:
        array = types.Array(dtype, axes, "C")

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            table = context.make_array(signature.args[0])(context, builder, arguments[0])
            row = context.cast(builder, arguments[1], signature.args[1], types.intp)
            first = builder.mul(row, row.type(4))
            address, *shape = (
                builder.load(builder.gep(table.data, [builder.add(first, first.type(i))]))
                for i in range(1 + axes)
            )
            data = builder.inttoptr(address, context.get_data_type(dtype).as_pointer())
            return _made(context, builder, array, data, shape)

        return array(bound, row), generate

    return made


def _made(context: Any, builder: Any, array: Any, data: Any, shape: Any) -> Any:
    """An array that owns nothing."""
    itemsize = context.get_abi_sizeof(context.get_data_type(array.dtype))
    strides = [shape[0].type(itemsize)]
    for size in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], size))
    made = context.make_array(array)(context, builder)
    populate_array(made, data, shape, strides, itemsize, None)
    return made._getvalue()


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

    def pose_in(x: Any, first: int) -> Any:
        """Elements first … first + 15 of a vector as a matrix (4, 4)."""
        return x[first : first + 16].reshape(4, 4)

else:
    vector, matrix, cube = (_array(types.float64, axes) for axes in (1, 2, 3))
    integers = _array(types.int64, 2)

    @intrinsic
    def pose_in(context: Any, x: Any, first: Any) -> Any:
        """Elements first … first + 15 of a vector as a matrix (4, 4)."""
        array = types.Array(types.float64, 2, "C")

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            whole = context.make_array(signature.args[0])(context, builder, arguments[0])
            start = context.cast(builder, arguments[1], signature.args[1], types.intp)
            data = builder.gep(whole.data, [start])
            return _made(context, builder, array, data, [start.type(4)] * 2)

        return array(x, first), generate
