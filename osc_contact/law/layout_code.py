"""LLVM code that reads the layout of a `nested.Nested` record: starts and sizes of its tables."""

from __future__ import annotations

from typing import Any

from llvmlite import ir

BYTE = ir.IntType(8)
WORD = ir.IntType(64)


def layout_word(builder: Any, record: Any, slot: int) -> Any:
    """Code that loads a word of a record's layout, which never changes: it is loaded once.

    Args:
        builder: of LLVM's instructions. record: pointer to it. slot: number of the word.
    """
    words = builder.bitcast(record, WORD.as_pointer())
    found = builder.load(builder.gep(words, [WORD(slot)]))
    found.set_metadata("invariant.load", builder.module.add_metadata([]))
    return found


def table_address(builder: Any, record: Any, slot: int) -> Any:
    """Code for the address of a table, so many bytes behind its record as a word of layout says.

    Args:
        builder: of LLVM's instructions. record: pointer to it. slot: number of the word.
    """
    start = layout_word(builder, record, slot)
    return builder.gep(builder.bitcast(record, BYTE.as_pointer()), [start])
