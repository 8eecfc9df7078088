"""How the law is compiled: every part once, called by its symbol, or not at all.

The same source runs compiled and, with NUMBA_DISABLE_JIT=1, as plain Python: a debugger steps
through it and the tests compare the two. `inner` and `leaf` mark functions that compiled ones call,
`entry` those that Python calls. numba translates, LLVM makes one object of an entry and all that it
calls (`units`); a numba without what that takes compiles as it always does, in three times as long.
"""

from __future__ import annotations

import ctypes
import inspect
import logging
import os
from types import FunctionType
from typing import Any

import numpy as np

from osc_contact.errors import missing
from osc_contact.law import ready

#: Whether the law runs as Python.
PLAIN_PYTHON = os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")
#: The library that holds the law; None: it is compiled, or runs as Python.
READY: Any = None if PLAIN_PYTHON else ready.load()
#: Whether numba compiles it.
COMPILES = READY is None and not PLAIN_PYTHON

_log = logging.getLogger(__name__)
_PLAIN: dict[str, Any] = {"error_model": "numpy"}


def _private(name: str, otherwise: str) -> Any:
    """A module of the law that rests on numba's own classes; None where this numba has others."""
    try:
        return getattr(__import__(f"{__package__}.{name}").law, name)
    except (ImportError, AttributeError, TypeError) as error:
        _log.warning("this numba is another one, so %s: %s", otherwise, error)
        return None


_njit: Any = None
_units: Any = None
_cache: Any = None
if COMPILES:
    try:
        from llvmlite import ir
        from numba import carray, njit, types  # type: ignore[attr-defined]
        from numba.core import cgutils
        from numba.extending import intrinsic
    except ImportError as error:
        raise ImportError(f"the law is not compiled here, and {missing(error)}") from error
    _njit = njit
    if os.environ.get("OSC_CONTACT_UNITS", "1") != "0":
        _units = _private("units", "the law takes longer to compile")
    _cache = _private("code_cache", "every process compiles the law")


def inner(function: Any, inlined: bool = False) -> Any:
    """A part of the law, called by compiled functions only."""
    if not COMPILES:
        return function
    if _units is None:
        return _njit(**_PLAIN, forceinline=inlined)(function)
    return _units.called(_units.Unit(function, inlined))


def leaf(function: Any) -> Any:
    """A small part, inlined wherever it is called."""
    return inner(function, inlined=True)


def entry(function: Any) -> Any:
    """What Python calls: compiled at the first call, then cached on disk. Releases the GIL.

    An edit of any source of the law, or a damaged cache, has it compiled anew, see `code_cache`.
    """
    if READY is not None:
        return Ready(function)
    if PLAIN_PYTHON:
        return np.errstate(all="ignore")(function)  # compiled code does not warn either
    machine_code = None
    call = function
    options = _PLAIN
    if _units is not None:
        machine_code = _units.MachineCode(function)
        names = ", ".join(inspect.signature(function).parameters)
        space = {"part": machine_code.called, "__name__": function.__module__}
        exec(f"def call({names}): return part({names})", space)
        call = space["call"]
        options = {**_PLAIN, "_nrt": False}  # makes no handles of the arrays handed over
    made = _njit(nogil=True, no_cfunc_wrapper=True, **options)(call)
    made.__wrapped__ = function
    if _cache is not None:
        made._cache = _cache.CodeCache(function, machine_code)
    return made


class Ready:
    """An entry of the library.

    Attributes:
        call: what Python calls.
    """

    def __init__(self, function: Any) -> None:
        self.__wrapped__ = function
        self.call = getattr(READY, function.__name__)

    def __call__(self, *arguments: Any) -> Any:
        return self.call(*arguments)


def as_python(part: Any, **instead: Any) -> Any:
    """A part of the law as a Python function, and so are all parts that it calls.

    Args:
        part: made by `inner` or `leaf`.
        instead: other values of global names, such as sqrt=np.sqrt, which takes arrays.
    """
    source = getattr(part, "py_func", part)
    names = dict(source.__globals__)
    for name in source.__code__.co_names:
        called = getattr(names.get(name), "py_func", names.get(name))
        if not isinstance(called, FunctionType) or called is source:  # a field has its name
            continue
        if called.__module__.startswith(f"{__package__}."):
            names[name] = as_python(called, **instead)
    return FunctionType(source.__code__, {**names, **instead}, source.__name__)


def call_address(address: int, *arrays: Any) -> None:
    """Call the C function at an address with the addresses of arrays."""
    given = [one.ctypes.data for one in arrays]
    ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * len(given))(int(address))(*given)


if not COMPILES:
    call_at: Any = call_address
    view: Any = None
    bytes_at: Any = None
    row_at: Any = None
    words_at: Any = None
    table_at: Any = None

    def matrix(x: Any, start: int, rows: int, columns: int) -> Any:
        """Numbers of a row from `start` as (rows, columns)."""
        return x[start : start + rows * columns].reshape((rows, columns))

    def prefetch(raw: Any, start: int, count: int) -> None:
        """Bring bytes near that are read soon: nothing to do in plain Python."""

else:
    #: A small part that reads bytes at an address.
    VIEW: Any = {**_PLAIN, "forceinline": True, "_nrt": True}
    view = _njit(**VIEW)

    @intrinsic
    def _pointer(typing: Any, address: Any) -> Any:
        """An address as a pointer."""

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.inttoptr(arguments[0], ir.IntType(8).as_pointer())

        return types.voidptr(types.uintp), generate

    @view
    def bytes_at(address):
        """All bytes from an address."""
        return carray(_pointer(address), (1 << 40,), np.uint8)

    @view
    def row_at(address, count):
        """Numbers at an address."""
        return carray(_pointer(address), (count,), np.float64)

    @view
    def words_at(address, count):
        """Whole numbers at an address."""
        return carray(_pointer(address), (count,), np.int64)

    @view
    def table_at(address, rows, columns):
        """Numbers at an address as (rows, columns)."""
        return carray(_pointer(address), (rows, columns), np.float64)

    @view
    def matrix(x, start, rows, columns):
        """Numbers of a row from `start` as (rows, columns)."""
        return table_at(x.ctypes.data + np.uintp(8 * start), rows, columns)

    @intrinsic
    def _call(typing: Any, at: Any, a: Any, b: Any, c: Any, d: Any, e: Any, f: Any) -> Any:
        """Call the C function at an address with addresses."""

        def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            kind = ir.FunctionType(ir.VoidType(), [ir.IntType(64)] * 6)
            builder.call(builder.inttoptr(given[0], kind.as_pointer()), given[1:])
            return context.get_dummy_value()

        return types.void(*[types.uintp] * 7), generate

    @view
    def call_at(address, a, b, c, d, e, f):
        """Call the C function at an address with the addresses of six arrays."""
        _call(
            np.uintp(address),
            np.uintp(a.ctypes.data),
            np.uintp(b.ctypes.data),
            np.uintp(c.ctypes.data),
            np.uintp(d.ctypes.data),
            np.uintp(e.ctypes.data),
            np.uintp(f.ctypes.data),
        )

    @intrinsic
    def _prefetch(typing: Any, address: Any) -> Any:
        """Prefetch the cache line at an address."""

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            line = ir.IntType(8).as_pointer()
            flag = ir.IntType(32)
            kind = ir.FunctionType(ir.VoidType(), [line, flag, flag, flag])
            function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
            at = builder.inttoptr(arguments[0], line)
            builder.call(function, [at, flag(0), flag(3), flag(1)])  # to read, near, data
            return context.get_dummy_value()

        return types.void(types.uintp), generate

    @view
    def prefetch(raw, start, count):
        """Bring bytes near that are read soon."""
        for at in range(start, start + count, 64):
            _prefetch(raw.ctypes.data + np.uintp(at))
