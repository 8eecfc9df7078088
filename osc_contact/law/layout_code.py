"""LLVM code that reads the layout of a `nested.Nested` record: offsets and sizes of its tables."""

from __future__ import annotations

from typing import TYPE_CHECKING

from llvmlite import ir

if TYPE_CHECKING:
    from osc_contact.law.numba_types import Builder, Value

BYTE = ir.IntType(8)
WORD = ir.IntType(64)


def layout_word(builder: Builder, record: Value, slot: int) -> Value:
    """Generate code that loads a word of a record's layout, as an invariant that is loaded once.

    Args:
        builder: builder of LLVM instructions.
        record: pointer to the record.
        slot: index of the word.
    """
    words = builder.bitcast(record, WORD.as_pointer())
    word = builder.load(builder.gep(words, [WORD(slot)]))
    word.set_metadata("invariant.load", builder.module.add_metadata([]))
    return word


def table_address(builder: Builder, record: Value, slot: int) -> Value:
    """Generate code for the address of a table, whose offset in the record is a word of its layout.

    Args:
        builder: builder of LLVM instructions.
        record: pointer to the record.
        slot: index of the word.
    """
    start = layout_word(builder, record, slot)
    return builder.gep(builder.bitcast(record, BYTE.as_pointer()), [start])
