"""Tables of `nested.Nested` records as arrays of compiled code, without a function for each table.

numba's public `overload_attribute` compiles a function for each attribute, 172 in the law, which
takes a tenth of its translation time. This module generates the array of a table where the
attribute is read. It uses numba's templates of attributes and `numba.np.arrayobj`, which are not
public; if one of them is missing, `jit` does without `units`, and `nested_type` uses the public
interface.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numba
from llvmlite import ir
from numba import types
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, lower_getattr
from numba.np.arrayobj import make_array, populate_array

from osc_contact.law.layout_code import WORD, layout_word, table_address

if TYPE_CHECKING:
    from osc_contact.law.numba_types import Builder, CPUContext, Layout, Type, Value

_public: Any = numba  #: its type hints leave out `from_dtype`


def lower_tables(record: type[Type], record_layout: Layout) -> None:
    """Register the tables of a record as array attributes of its numba type.

    Args:
        record: numba type of the record (a class).
        record_layout: declaration of the record, a `Nested`.
    """
    tables = {name: _Table(record_layout, name) for name in record_layout.tables}

    # the decorator registers the class with numba, which calls it from then on; nothing is returned
    @infer_getattr
    class Tables(AttributeTemplate):
        """Types of the tables."""

        key = record

        def generic_resolve(self, value: Type, attr: str) -> Type | None:  # type: ignore[override]
            """Return the array type of a table, or None if the record has no such table.

            numba calls it for an attribute of a record; `tables` has the tables of the record by
            name.

            Args:
                value: numba type of the record.
                attr: name of the attribute.
            """
            return tables[attr].array if attr in tables else None

    for name, table in tables.items():
        lower_getattr(record, name)(table.lower)


class _Table:
    """Table of a record as an array of compiled code.

    Attributes:
        array: numba type of the array.
    """

    def __init__(self, record_layout: Layout, name: str) -> None:
        """Set element type and layout of one table of a record.

        Args:
            record_layout: declaration of the record, a `Nested`.
            name: name of the table.
        """
        dtype, sizes = record_layout.tables[name]
        self.array = types.Array(_public.from_dtype(dtype), len(sizes), "C")
        self._item = dtype.itemsize  #: size of an element (bytes)
        #: index of the layout's word with the offset of the table
        self._start = record_layout.start(name)
        #: each size: index of a word of the layout, or a constant
        self._sizes = [
            record_layout.slot(size) if isinstance(size, str) else WORD(size) for size in sizes
        ]

    def lower(self, context: CPUContext, builder: Builder, record: Type, value: Value) -> Value:
        """Generate code for the array, in the form of `numba.extending.lower_getattr`.

        Args:
            context: target context of numba.
            builder: builder of LLVM instructions.
            record: type of the record.
            value: pointer to the record.
        """
        shape = [
            size if isinstance(size, ir.Constant) else layout_word(builder, value, size)
            for size in self._sizes
        ]
        strides = [WORD(self._item)]
        for size in reversed(shape[1:]):
            strides.insert(0, builder.mul(size, strides[0]))
        place = table_address(builder, value, self._start)
        item = context.get_data_type(self.array.dtype)
        array = make_array(self.array)(context, builder)
        populate_array(
            array,
            data=builder.bitcast(place, item.as_pointer()),
            shape=shape,
            strides=strides,
            itemsize=strides[-1],
            meminfo=None,
        )
        return array._getvalue()
