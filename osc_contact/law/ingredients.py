"""Ingredients on which the translation of a function depends, as text to be hashed to a key.

numba translates bytecode, and reads the values of global names in it: constants, other functions,
members of modules. A value whose content cannot be written as text is an error, because a change
of it would not be detected and old code would run.
"""

from __future__ import annotations

import dis
import sys
from functools import cache
from hashlib import sha256
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

#: Packages whose versions are part of every key, so that their members are identified by name.
VERSIONED = {"numba", "numpy", "llvmlite", *sys.stdlib_module_names} - {"__main__"}
_PLAIN = (bool, int, float, complex, str, bytes, type(None), type(Ellipsis))


def digest(function: FunctionType) -> str:
    """SHA-256 of the ingredients of a function, from which its key in the cache is made.

    Args:
        function: a Python function that numba translates.

    Raises:
        TypeError: the function reads a value whose content cannot be written as text.
    """
    return sha256("\n".join(ingredients(function)).encode()).hexdigest()


def ingredients(function: FunctionType) -> list[str]:
    """Lines of text with the bytecode of a function and every value that it reads.

    Args:
        function: a Python function that numba translates.

    Returns:
        The same lines in every process. A called part of the law is listed by name, because it has
        a translation of its own; another called function is listed with its ingredients.

    Raises:
        TypeError: the function reads a value whose content cannot be written as text.
    """
    lines = [_bytecode(function.__code__), f"defaults {_text_of(function.__defaults__)}"]
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    values = {name: cell.cell_contents for name, cell in cells} | values_read(function)
    for name, value in sorted(values.items()):
        try:
            lines.append(f"{name} = {_text_of(value)}")
        except TypeError as error:
            raise TypeError(f"{function.__qualname__} reads {name}: {error}") from error
    return lines


def values_read(function: FunctionType) -> dict[str, Any]:
    """Global values that a function names, by name or, in a module, by path: `math.sqrt`.

    Args:
        function: a Python function. Names of Python's builtins are left out.
    """
    values: dict[str, Any] = {}
    for name, *members in _paths(function.__code__):
        if name not in function.__globals__:
            continue  # a name of Python's builtins
        value = function.__globals__[name]
        path = name
        for member in members:
            if not isinstance(value, ModuleType):
                break
            value = getattr(value, member)
            path = f"{path}.{member}"
        values[path] = value
    return values


@cache
def _paths(code: CodeType) -> tuple[tuple[str, ...], ...]:
    """List the global names in a function's code, each with the attributes that directly follow it.

    Nested functions are included.

    Args:
        code: code object of the function.
    """
    paths_here: list[tuple[str, ...]] = []
    follows = False
    for step in dis.get_instructions(code):
        if step.opname == "LOAD_GLOBAL":
            paths_here.append((str(step.argval),))
            follows = True
        elif step.opname in ("LOAD_ATTR", "LOAD_METHOD") and follows:
            paths_here[-1] += (str(step.argval),)
        elif step.opname not in ("CACHE", "EXTENDED_ARG", "PUSH_NULL"):
            follows = False
    inner_paths = [
        _paths(constant) for constant in code.co_consts if isinstance(constant, CodeType)
    ]
    return (*paths_here, *(path for paths in inner_paths for path in paths))


@cache
def _bytecode(code: CodeType) -> str:
    """Text of a function's code without its docstring and its line numbers.

    It is equal before and after an edit of comments, so that such an edit needs no new translation.

    Args:
        code: code object of the function.
    """
    constants = [
        _bytecode(constant) if isinstance(constant, CodeType) else repr(constant)
        for place, constant in enumerate(code.co_consts)
        if place > 0 or not isinstance(constant, str) or _uses_constant(code, place)
    ]
    counts = (code.co_argcount, code.co_kwonlyargcount, code.co_flags)
    names = (code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
    return f"code {code.co_code.hex()} {counts} {names} {constants}"


def _uses_constant(code: CodeType, place: int) -> bool:
    """Whether the instructions of a function load one of the constants in its table.

    Args:
        code: code object.
        place: index of the constant in `code.co_consts`.
    """
    return any(
        step.opname == "LOAD_CONST" and step.arg == place for step in dis.get_instructions(code)
    )


def _text_of(value: Any) -> str:
    """Text that identifies a value by its content, the same in every process.

    It is part of the key under which machine code is stored: a function that uses another value
    must have another key, so memory addresses are not part of it.

    Args:
        value: number, text, tuple, type, module or function.

    Raises:
        TypeError: the content cannot be written as text.
    """
    module = getattr(value, "__module__", None) or ""
    if module.partition(".")[0] in VERSIONED and hasattr(value, "__qualname__"):
        return f"{module}.{value.__qualname__}"
    if type(value) in _PLAIN:
        return repr(value)
    if isinstance(value, tuple | list):
        return f"{type(value).__name__}({', '.join(map(_text_of, value))})"
    if isinstance(value, np.dtype):
        return repr(value.descr if value.names else value)
    if isinstance(value, np.generic):
        return f"{value.dtype} {value!r}"
    if hasattr(value, "unit"):  # a part of the law, called by its symbol
        return f"part {value.unit.name}, inlined: {value.unit.inlined}"
    if hasattr(value, "_defn"):  # another intrinsic of numba
        return f"intrinsic {ingredients(value._defn)}"
    if hasattr(value, "py_func"):  # a function that numba compiles as usual
        return f"function {ingredients(value.py_func)} {sorted(value.targetoptions.items())}"
    if isinstance(value, FunctionType):
        return f"function {ingredients(value)}"
    if isinstance(value, type) and hasattr(value, "_fields"):
        return f"named tuple {value.__module__}.{value.__qualname__} {value._fields}"
    if isinstance(value, ModuleType):
        return f"module {value.__name__}"
    if hasattr(value, "mangling_args"):  # a type of numba
        return f"type {value}"
    raise TypeError(
        f"a {type(value).__name__}, whose content no key of a translated part would hold: pass a "
        "number, a tuple of numbers or a function"
    )
