"""LLVM code that reads the layout of a `nested.Nested` record: starts and sizes of its tables."""

from __future__ import annotations

from typing import TYPE_CHECKING

from llvmlite import ir

if TYPE_CHECKING:
    from osc_contact.law.numba_types import Builder, Value

BYTE = ir.IntType(8)
WORD = ir.IntType(64)


def layout_word(builder: Builder, record: Value, slot: int) -> Value:
    """Code that loads a word of a record's layout, which never changes: it is loaded once.

    Args:
        builder: of LLVM's instructions. record: pointer to it. slot: number of the word.
    """
    words = builder.bitcast(record, WORD.as_pointer())
    found = builder.load(builder.gep(words, [WORD(slot)]))
    found.set_metadata("invariant.load", builder.module.add_metadata([]))
    return found


def table_address(builder: Builder, record: Value, slot: int) -> Value:
    """Code for the address of a table, so many bytes behind its record as a word of layout says.

    Args:
        builder: of LLVM's instructions. record: pointer to it. slot: number of the word.
    """
    start = layout_word(builder, record, slot)
    return builder.gep(builder.bitcast(record, BYTE.as_pointer()), [start])
