"""Compilation of the law: to a library, by numba in its usual way, or none (plain Python).

The same source runs compiled and, with NUMBA_DISABLE_JIT=1, as plain Python, which a debugger can
step through and the tests compare with compiled code. `inner` and `leaf` mark functions called by
compiled functions, `entry` those called by Python. If no existing library fits the sources
(`library`), numba translates each function once, and LLVM and a C compiler make a library of them
(`units`, `c_object`). Without a C compiler, or with an unsupported numba, numba compiles in its
usual way, with the same results, in three times as long; OSC_CONTACT_LAW=jit selects this.
"""

from __future__ import annotations

import ctypes
import logging
import os
from contextlib import suppress
from functools import cache, cached_property
from importlib import import_module
from types import FunctionType
from typing import TYPE_CHECKING, Any

import numpy as np

from osc_contact.errors import missing
from osc_contact.law import library

if TYPE_CHECKING:
    from osc_contact.law.numba_types import (
        Builder,
        CPUContext,
        IntegerLiteral,
        Intrinsic,
        Signature,
        Type,
        TypingContext,
        Value,
        Values,
    )

#: Whether the law runs as Python.
PLAIN_PYTHON = os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")
#: Existing library of the law; None: the law is compiled by this process, or runs as Python.
READY: Any = None if PLAIN_PYTHON else library.found()
#: Whether numba compiles the law in this process.
COMPILES = READY is None and not PLAIN_PYTHON

_log = logging.getLogger(__name__)
_PLAIN: dict[str, Any] = {"error_model": "numpy"}


def _find_units() -> Any:
    """Module `units`, or None if numba compiles in its usual way."""
    if os.environ.get("OSC_CONTACT_LAW") == "jit":
        return None
    reason: object = library.missing_tool()
    try:
        if not reason:
            return import_module(f"{__package__}.units")
    except (ImportError, AttributeError, TypeError) as error:
        reason = f"this numba is another one ({error})"
    _log.warning("%s, so the law takes longer to compile", reason)
    return None


_config: Any = None
UNITS: Any = None
if COMPILES:
    try:
        from llvmlite import ir
        from numba import carray, config, njit, types  # type: ignore[attr-defined]
        from numba.extending import intrinsic
    except ImportError as error:
        raise ImportError(f"the law is not compiled here, and {missing(error)}") from error
    _config = config
    UNITS = _find_units()
#: Whether a library of the law exists or can be made.
HAS_LIBRARY = READY is not None or UNITS is not None


def inner(function: Any, inlined: bool = False) -> Any:
    """Decorator of a function of the law that is called by compiled functions only.

    Args:
        function: the function.
        inlined: whether it is inlined in its callers.

    Returns:
        The function itself in plain Python; else a callable of numba, translated once for all
        callers (`units`) or, without `units`, compiled by numba in its usual way.
    """
    if not COMPILES:
        return function
    if UNITS is None:
        return njit(**_PLAIN, forceinline=inlined)(function)
    return UNITS.called(UNITS.Unit(function, inlined))


def leaf(function: Any) -> Any:
    """Decorator of a small function of the law that is inlined in its callers."""
    return inner(function, inlined=True)


def entry(function: Any) -> Any:
    """Decorator of a function of the law that Python calls; `c_object.ENTRIES` are those of C.

    Args:
        function: the function.

    Returns:
        The function itself in plain Python; a callable of numba where numba compiles in its usual
        way; else an `Entry`, which calls the library.
    """
    if PLAIN_PYTHON:
        return np.errstate(all="ignore")(function)  # compiled code does not warn either
    if COMPILES and UNITS is None:
        return _as_numba_does(function)
    return Entry(function)


class Entry:
    """Entry of the library, which is made or loaded at the first call."""

    def __init__(self, function: Any) -> None:
        """Declare an entry without making or loading the library.

        Args:
            function: the function of Python whose name the library's function has.
        """
        self.__wrapped__ = function

    @cached_property
    def call(self) -> Any:
        """Function of the library."""
        return getattr(the_library(), self.__wrapped__.__name__)

    def __call__(self, *arguments: Any) -> Any:
        """Call the function of the library, which checks the types of its arguments."""
        return self.call(*arguments)


@cache
def the_library() -> Any:
    """Library of the law, which is made if none exists.

    Raises:
        OscContactError: the library cannot be made on this machine.
    """
    return READY or import_module(f"{__package__}.c_object").make()


def _as_numba_does(function: Any) -> Any:
    """Compile an entry in numba's usual way, with numba's own cache in a folder for these sources.

    numba reads the folder of its cache from its configuration when it compiles, so the
    configuration is changed meanwhile. Code is cached only where no other user may write.

    Args:
        function: the function of Python.

    Returns:
        Callable of numba that releases the GIL.
    """
    user_folder = _config.CACHE_DIR
    folder = library.kept("numba")
    with suppress(OSError):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    may_cache = bool(user_folder) or (library.may_keep(folder.parent) and library.may_keep(folder))
    _config.CACHE_DIR = user_folder or str(folder)
    try:
        return njit(nogil=True, cache=may_cache, **_PLAIN)(function)
    finally:
        _config.CACHE_DIR = user_folder


def as_python(part: Any, **instead: Any) -> Any:
    """Python function of a part of the law, which calls other parts as Python functions, too.

    Args:
        part: function decorated by `inner` or `leaf`.
        instead: replacements of global names, for example sqrt=np.sqrt, which accepts arrays.
    """
    source = getattr(part, "py_func", part)
    names = source.__globals__ | _IN_PYTHON
    for name in source.__code__.co_names:
        called = getattr(names.get(name), "py_func", names.get(name))
        if not isinstance(called, FunctionType) or called is source:  # only the name of a field
            continue
        if called.__module__.startswith(f"{__package__}."):
            names[name] = as_python(called, **instead)
    return FunctionType(source.__code__, {**names, **instead}, source.__name__)


def call_address(address: int, *arrays: Any) -> None:
    """Call the C function at an address with the addresses of arrays.

    Args:
        address: address of a function without a result, all of whose arguments are pointers.
        arrays: arrays whose addresses are passed.
    """
    addresses = [array.ctypes.data for array in arrays]
    ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * len(addresses))(int(address))(*addresses)


def _reshape(x: Any, start: int, rows: int, columns: int) -> Any:
    """View elements of a row as a matrix, in plain Python.

    Args:
        x: row.
        start: index of the first element.
        rows, columns: size of the matrix.

    Returns:
        Matrix (rows, columns) that shares its memory with x.
    """
    return x[start : start + rows * columns].reshape((rows, columns))


def _no_prefetch(raw: Any, start: int, count: int) -> None:
    """Do nothing in place of a prefetch, in plain Python.

    Args:
        raw: array of bytes.
        start: index of the first byte.
        count: number of bytes.
    """


def _empty(rows: int, columns: int | None = None) -> Any:
    """New array (rows,) or (rows, columns) of NaN, in place of `local` in plain Python.

    NaN shows where an element is read before it is written.

    Args:
        rows, columns: sizes; columns None: an array with one axis.
    """
    return np.full(rows if columns is None else (rows, columns), np.nan)


#: Python functions in place of the compiled ones that work with addresses.
_IN_PYTHON: dict[str, Any] = {
    "call_at": call_address,
    "local": _empty,
    "matrix": _reshape,
    "prefetch": _no_prefetch,
}

if not COMPILES:
    local: Any = _empty
    call_at: Any = call_address
    matrix: Any = _reshape
    prefetch: Any = _no_prefetch
    bytes_at: Any = None
    numbers_at: Any = None
    words_at: Any = None
else:

    @intrinsic(prefer_literal=True)
    def local(
        typing: TypingContext, rows: IntegerLiteral, columns: IntegerLiteral | None = None
    ) -> Intrinsic:
        """New array (rows,) or (rows, columns) of numbers on the stack, not initialised.

        It exists until the function that makes it returns; in a loop, each call returns the same
        array. Its type is that of a field of a record with the same shape, so that a function that
        accepts both is translated once.

        Args:
            rows, columns: sizes, whole numbers that are written out or are constants of a module.
        """
        shape = tuple(size.literal_value for size in (rows, columns) if size is not None)
        strides = tuple(8 * int(np.prod(shape[axis + 1 :])) for axis in range(len(shape)))
        kind = types.NestedArray(types.float64, shape)

        def generate(
            context: CPUContext, builder: Builder, signature: Signature, values: Values
        ) -> Value:
            """Generate code that reserves the memory of the array, once for each call.

            The memory is reserved at the function's entry: in a loop it would grow the stack.
            `kind` is numba's type of the array, `shape` and `strides` (bytes) are those of the
            enclosing `local`.

            Args:
                context: target context of numba.
                builder: builder of LLVM instructions.
                signature: types of the call.
                values: the sizes, which are not needed at run time.

            Returns:
                LLVM value of numba's array structure, without a reference count.
            """
            with builder.goto_entry_block():
                place = builder.alloca(ir.ArrayType(ir.DoubleType(), int(np.prod(shape))))
            array = context.make_array(kind)(context, builder)
            context.populate_array(
                array,
                data=builder.bitcast(place, array.data.type),
                shape=[context.get_constant(types.intp, size) for size in shape],
                strides=[context.get_constant(types.intp, step) for step in strides],
                itemsize=context.get_constant(types.intp, 8),
                meminfo=None,
            )
            return array._getvalue()

        return kind(rows, types.Omitted(None) if columns is None else columns), generate

    #: Options of small functions that read bytes at an address.
    VIEW: Any = {**_PLAIN, "forceinline": True, "_nrt": True}
    view = njit(**VIEW)

    @intrinsic
    def _pointer(typing: TypingContext, address: Type) -> Intrinsic:
        """Convert an address (an integer) to a pointer, in compiled code.

        Args:
            typing: typing context of numba.
            address: numba type of the address.

        Returns:
            Signature and code generator, as numba expects them of an intrinsic.
        """

        def generate(
            context: CPUContext, builder: Builder, signature: Signature, arguments: Values
        ) -> Value:
            """Generate code that converts the integer to a pointer to bytes.

            Args:
                context: target context of numba.
                builder: builder of LLVM instructions.
                signature: types of the conversion.
                arguments: the address alone.
            """
            return builder.inttoptr(arguments[0], ir.IntType(8).as_pointer())

        return types.voidptr(types.uintp), generate

    @view
    def _place(x):
        """Address of the first element of an array x, as an unsigned integer."""
        return np.uintp(x.ctypes.data)

    @view
    def bytes_at(address):
        """View all bytes from an address on as an array; its length is no limit."""
        return carray(_pointer(address), 1 << 40, np.uint8)

    @view
    def numbers_at(address, shape):
        """View numbers (float64) at an address as an array.

        Args:
            address: address of the first number.
            shape: size, or tuple of sizes.
        """
        return carray(_pointer(address), shape, np.float64)

    @view
    def words_at(address, count):
        """View integers (int64) at an address as an array.

        Args:
            address: address of the first integer.
            count: number of integers.
        """
        return carray(_pointer(address), count, np.int64)

    @view
    def matrix(x, start, rows, columns):
        """View elements of a row as a matrix, in compiled code.

        Args:
            x: row of numbers.
            start: index of the first element.
            rows, columns: size of the matrix.

        Returns:
            Matrix (rows, columns) that shares its memory with x.
        """
        return numbers_at(_place(x) + np.uintp(8 * start), (rows, columns))

    @intrinsic
    def _call(
        typing: TypingContext, at: Type, a: Type, b: Type, c: Type, d: Type, e: Type, f: Type
    ) -> Intrinsic:
        """Call the C function at an address with six addresses, in compiled code.

        Args:
            typing: typing context of numba.
            at: type of the function's address.
            a, b, c, d, e, f: types of its six arguments, unsigned integers.

        Returns:
            Signature and code generator, as numba expects them of an intrinsic.
        """

        def generate(
            context: CPUContext, builder: Builder, signature: Signature, values: Values
        ) -> Value:
            """Generate code that converts the first address to a function and calls it.

            Args:
                context: target context of numba.
                builder: builder of LLVM instructions.
                signature: types of the call.
                values: address of the function, then its six arguments.
            """
            kind = ir.FunctionType(ir.VoidType(), [ir.IntType(64)] * 6)
            builder.call(builder.inttoptr(values[0], kind.as_pointer()), values[1:])
            return context.get_dummy_value()

        return types.void(*[types.uintp] * 7), generate

    @view
    def call_at(address, a, b, c, d, e, f):
        """Call the C function at an address with the addresses of six arrays, in compiled code.

        Args:
            address: address of a function without a result, all of whose arguments are pointers.
            a, b, c, d, e, f: arrays.
        """
        at = _place(a), _place(b), _place(c), _place(d), _place(e), _place(f)
        _call(np.uintp(address), *at)

    @intrinsic
    def _prefetch(typing: TypingContext, address: Type) -> Intrinsic:
        """Prefetch the cache line at an address, in compiled code.

        Args:
            typing: typing context of numba.
            address: type of the address.

        Returns:
            Signature and code generator, as numba expects them of an intrinsic.
        """

        def generate(
            context: CPUContext, builder: Builder, signature: Signature, arguments: Values
        ) -> Value:
            """Generate a call of LLVM's prefetch for a line of data that is read soon.

            Args:
                context: target context of numba.
                builder: builder of LLVM instructions.
                signature: types of the call.
                arguments: the address alone.

            Returns:
                Placeholder of no value.
            """
            line = ir.IntType(8).as_pointer()
            flag = ir.IntType(32)
            kind = ir.FunctionType(ir.VoidType(), [line, flag, flag, flag])
            function = builder.module.declare_intrinsic("llvm.prefetch.p0", (), kind)
            at = builder.inttoptr(arguments[0], line)
            # LLVM's flags: 0 to read, 3 to keep in all levels of the cache, 1 data
            builder.call(function, [at, flag(0), flag(3), flag(1)])
            return context.get_dummy_value()

        return types.void(types.uintp), generate

    @view
    def prefetch(raw, start, count):
        """Prefetch bytes to the processor's cache, one access for each line of 64 bytes.

        Args:
            raw: array of bytes.
            start: index of the first byte.
            count: number of bytes.
        """
        for at in range(start, start + count, 64):
            _prefetch(_place(raw) + np.uintp(at))
