"""The type of a `nested.Nested` record to numba: a record with tables as further attributes.

All of it is numba's public interface for extensions: a type with a model, attributes, intrinsics.
"""

from __future__ import annotations

from hashlib import sha256
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, models, register_model

from osc_contact.law.jit import VIEW, view

_public: Any = numba  #: its type hints leave out `carray` and options of `overload_attribute`
_BYTE = ir.IntType(8)
_WORD = ir.IntType(64)


class _Pointer(models.PrimitiveModel):
    """Unlike other records one of these may be part of a tuple."""

    def __init__(self, manager: Any, record: Any) -> None:
        super().__init__(manager, record, ir.ArrayType(_BYTE, record.size).as_pointer())


_records: dict[str, Any] = {}  #: types of records by their names


def record_named(name: str) -> Any:
    """The type of a record that was made in this process."""
    return _records[name]


def pointer_to(kind: Any) -> Any:
    """A compiled function (bytes, offset) that takes what is there for a record of this kind."""

    class Record(types.Record):
        """The head; its tables are further attributes.

        Its name is a hash of the layout: numba's own would have thousands of characters.
        """

        def __init__(self) -> None:
            head: Any = _public.from_dtype(kind.dtype)
            fields = [(name, field._asdict()) for name, field in head.fields.items()]
            super().__init__(fields, head.size, head.aligned)
            layout = f"{kind.dtype} {kind.tables}"
            self.name = f"record_{sha256(layout.encode()).hexdigest()[:16]}"

        def __reduce__(self) -> Any:
            return record_named, (self.name,)

    register_model(Record)(_Pointer)
    record = Record()
    _records[record.name] = record
    for slot, (name, (dtype, sizes)) in enumerate(kind.tables.items()):
        shape = [_word(kind.slot(one)) if isinstance(one, str) else _fixed(one) for one in sizes]
        _public.extending.overload_attribute(Record, name, jit_options=VIEW)(
            _table(dtype, _word(slot, behind=True), shape)
        )

    @intrinsic
    def point(typing: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            return builder.inttoptr(given[0], context.get_value_type(record))

        return record(types.uintp), generate

    @view
    def at(raw, start):
        return point(raw.ctypes.data + np.uintp(start))

    return at


def _table(dtype: Any, start: Any, shape: list[Any]) -> Any:
    """What an attribute of a record is: the array that begins at `start`."""
    rows = shape[0]
    columns = shape[-1]

    carray = _public.carray

    def one(record: Any) -> Any:
        return carray(start(record), (rows(record),), dtype)

    def two(record: Any) -> Any:
        return carray(start(record), (rows(record), columns(record)), dtype)

    def choose(record: Any) -> Any:
        return one if len(shape) == 1 else two

    return choose


def _word(slot: int, behind: bool = False) -> Any:
    """A compiled function of a record: a word of its layout; the address so many bytes behind it.

    The layout never changes: compiled code reads each word once.
    """

    @intrinsic
    def word(typing: Any, record: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            words = builder.bitcast(given[0], _WORD.as_pointer())
            found = builder.load(builder.gep(words, [_WORD(slot)]))
            found.set_metadata("invariant.load", builder.module.add_metadata([]))
            if behind:
                return builder.gep(builder.bitcast(given[0], _BYTE.as_pointer()), [found])
            return found

        return (types.voidptr if behind else types.intp)(record), generate

    return word


def _fixed(size: int) -> Any:
    """The same of a size that is known."""

    @intrinsic
    def word(typing: Any, record: Any) -> Any:
        return types.intp(record), lambda context, builder, signature, given: _WORD(size)

    return word
