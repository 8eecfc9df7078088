"""The compiled tick as other compiled code calls it: without Python, and without compiling it anew.

numba would link the whole law into every caller and optimise it again, for a minute. Here it is
called by its address, with numba's own convention.
"""

from __future__ import annotations

import zlib
from functools import cache
from typing import Any

from llvmlite import binding
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import intrinsic

from osc_contact.control.controller import Controller
from osc_contact.law.compiled import rows
from osc_contact.law.jit import PLAIN_PYTHON

__all__ = ["call_tick", "tick_stamp", "tick_tables"]

_SYMBOL = "osc_contact_law_rows"


@intrinsic
def call_tick(typing: Any, arguments: Any) -> Any:
    """`law.tick.rows` for compiled code: one tuple of its arguments; ask `tick_stamp` first."""
    (wanted,) = rows().signatures
    if tuple(arguments.types) != tuple(wanted):
        raise TypingError(f"the tick takes {wanted}, got {arguments.types}")

    tools: Any = cgutils

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        call = context.call_conv
        kind = call.get_function_type(types.int64, wanted)
        function = tools.get_or_insert_function(builder.module, kind, _SYMBOL)
        values = [builder.extract_value(given[0], i) for i in range(len(wanted))]
        status, done = call.call_function(builder, function, types.int64, wanted, values)
        with tools.if_unlikely(builder, status.is_error):
            call.return_status_propagate(builder, status)
        return done

    return types.int64(arguments), generate


@cache
def tick_stamp() -> int | None:
    """Make the tick known to compiled code; a number of its arguments' types.

    None where the law is not compiled, or this numba keeps its code elsewhere.
    """
    if PLAIN_PYTHON:
        return None
    try:
        (signature,) = rows().signatures
        compiled = rows().overloads[signature]
        address = compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name)
    except (AttributeError, KeyError, ValueError):
        return None
    if not address:
        return None
    binding.add_symbol(_SYMBOL, address)
    return zlib.crc32(str(signature).encode())


def tick_tables(controller: Controller) -> tuple[Any, ...]:
    """MODEL, MEMORY, WORK, codes (1,) and rank (1,) of a controller, which its ticks go on with.

    Args:
        controller: without pairs, bodies or laws written in Python.
    """
    records = controller._records
    return (
        records.row.raw, records.memory_bytes, records.work_bytes, controller._codes, records.rank,
    )  # fmt: skip
