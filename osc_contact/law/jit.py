"""How the law is compiled: by numba, once for every rig, or not at all.

The same source runs compiled and, with NUMBA_DISABLE_JIT=1, as plain Python: a debugger steps
through it and the tests compare the two. `inner` marks functions that compiled ones call, `entry`
those that Python calls. Public numba is enough; `accelerator` halves the time of the first
compilation and lets compiled runs call the tick, where the installed numba allows it.
"""

from __future__ import annotations

import logging
import os
from types import FunctionType
from typing import Any

import numpy as np
from llvmlite import ir
from numba import config, njit, types
from numba.core import cgutils
from numba.extending import intrinsic

PLAIN_PYTHON: bool = bool(getattr(config, "DISABLE_JIT"))  # noqa: B009 - set at run time

_log = logging.getLogger(__name__)
_njit: Any = njit
_PLAIN: dict[str, Any] = {"error_model": "numpy"}


def _accelerator() -> Any:
    """The module `accelerator`; None where it is left out or this numba has other classes."""
    if PLAIN_PYTHON or os.environ.get("OSC_CONTACT_ACCELERATOR", "1") == "0":
        return None
    try:
        import osc_contact.law.accelerator as accelerator
    except (ImportError, AttributeError, TypeError) as error:
        _log.info("public numba only, which takes longer to compile: %s", error)
        return None
    return accelerator


def _options(fast: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Options of parts, and of entries."""
    if fast is None:
        return _PLAIN, _PLAIN
    return {**_PLAIN, **fast.part_options()}, {**_PLAIN, **fast.entry_options()}


def _code_cache() -> Any:
    """The class `code_cache.CodeCache`; None where this numba has other classes."""
    if PLAIN_PYTHON:
        return None
    try:
        import osc_contact.law.code_cache as code_cache
    except (ImportError, AttributeError) as error:
        _log.warning("this numba caches otherwise, so every process compiles the law: %s", error)
        return None
    return code_cache.CodeCache


_fast = _accelerator()
_cache = _code_cache()
_INNER, _ENTRY = ({}, {}) if PLAIN_PYTHON else _options(_fast)
#: Of the accelerator: gives back what numba keeps of an entry beside its machine code.
forget_code: Any = (lambda entry: None) if _fast is None else _fast.forget_code


def inner(function: Any) -> Any:
    """A part of the law, called by compiled functions only."""
    return function if PLAIN_PYTHON else _njit(**_INNER)(function)


def leaf(function: Any) -> Any:
    """A small part, inlined wherever it is called."""
    return function if PLAIN_PYTHON else _njit(**_INNER, forceinline=True)(function)


def entry(function: Any) -> Any:
    """What Python calls: compiled at the first call, then cached on disk. Releases the GIL.

    An edit of any source of the law, or a damaged cache, has it compiled anew, see `code_cache`.
    """
    if PLAIN_PYTHON:
        return np.errstate(all="ignore")(function)  # compiled code does not warn either
    made = _njit(nogil=True, **_ENTRY)(function)
    if _cache is not None:
        made._cache = _cache(function)
    return made


def direct(entry: Any) -> Any:
    """An entry that was called before, from now on without a look at the types of its arguments.

    numba looks at each array of a tuple, which takes longer than small functions do. Only for
    arguments that the caller makes itself: those of other types would be misread.
    """
    return entry if _fast is None else _fast.direct(entry)


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


if PLAIN_PYTHON:
    pointer: Any = None
    view: Any = None

    def prefetch(raw: Any, start: int, count: int) -> None:
        """Bring bytes near that are read soon: nothing to do in plain Python."""

else:
    #: A small part that reads bytes at an address.
    VIEW: Any = {**_INNER, "forceinline": True, "_nrt": True} if _INNER is not _PLAIN else _PLAIN
    view = _njit(**VIEW)

    @intrinsic
    def pointer(typing: Any, address: Any) -> Any:
        """An address as a pointer."""

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.inttoptr(arguments[0], ir.IntType(8).as_pointer())

        return types.voidptr(types.uintp), generate

    @intrinsic
    def _prefetch(typing: Any, address: Any) -> Any:
        """Ask for the cache line at an address."""

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            line = ir.IntType(8).as_pointer()
            flag = ir.IntType(32)
            kind = ir.FunctionType(ir.VoidType(), [line, flag, flag, flag])
            ask = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
            at = builder.inttoptr(arguments[0], line)
            builder.call(ask, [at, flag(0), flag(3), flag(1)])  # to read, near, data
            return context.get_dummy_value()

        return types.void(types.uintp), generate

    @view
    def prefetch(raw, start, count):
        """Bring bytes near that are read soon."""
        for at in range(start, start + count, 64):
            _prefetch(raw.ctypes.data + np.uintp(at))
