"""The type of a `nested.Nested` record to numba: a record with tables as further attributes.

It is made of numba's interface for extensions: a type with a model, attributes, intrinsics. That
tables are arrays rests on `numba.np.arrayobj`, as in numba's own extensions.
"""

from __future__ import annotations

from hashlib import sha256
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, intrinsic, lower_getattr, models, register_model
from numba.np.arrayobj import make_array, populate_array

from osc_contact.law.jit import view

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
    tables = {name: _Table(kind, name) for name in kind.tables}

    @infer_getattr
    class Tables(AttributeTemplate):
        """Types of the tables."""

        key = Record

        def generic_resolve(self, value: Any, attr: str) -> Any:  # type: ignore[override]
            return tables[attr].array if attr in tables else None

    for name, table in tables.items():
        lower_getattr(Record, name)(table.found)

    @intrinsic
    def point(typing: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            return builder.inttoptr(given[0], context.get_value_type(record))

        return record(types.uintp), generate

    @view
    def at(raw, start):
        return point(raw.ctypes.data + np.uintp(start))

    return at


class _Table:
    """A table of a record, which compiled code takes as an array.

    Attributes:
        array: its type.
    """

    def __init__(self, kind: Any, name: str) -> None:
        dtype, sizes = kind.tables[name]
        self.array = types.Array(_public.from_dtype(dtype), len(sizes), "C")
        self._item = dtype.itemsize
        self._start = kind.start(name)
        self._sizes = [kind.slot(one) if isinstance(one, str) else _WORD(one) for one in sizes]

    def found(self, context: Any, builder: Any, record: Any, value: Any) -> Any:
        """The array, as `numba.extending.lower_getattr` takes it, at its place in the record."""
        shape = [
            one if isinstance(one, ir.Constant) else _word(builder, value, one)
            for one in self._sizes
        ]
        strides = [_WORD(self._item)]
        for size in reversed(shape[1:]):
            strides.insert(0, builder.mul(size, strides[0]))
        start = _word(builder, value, self._start)
        place = builder.gep(builder.bitcast(value, _BYTE.as_pointer()), [start])
        item = context.get_data_type(self.array.dtype)
        made = make_array(self.array)(context, builder)
        populate_array(
            made,
            data=builder.bitcast(place, item.as_pointer()),
            shape=shape,
            strides=strides,
            itemsize=strides[-1],
            meminfo=None,
        )
        return made._getvalue()


def _word(builder: Any, record: Any, slot: int) -> Any:
    """A word of a record's layout, which never changes: compiled code reads each once."""
    words = builder.bitcast(record, _WORD.as_pointer())
    found = builder.load(builder.gep(words, [_WORD(slot)]))
    found.set_metadata("invariant.load", builder.module.add_metadata([]))
    return found
