"""Tables of `nested.Nested` records as arrays of compiled code, without a function for each table.

Attributes that numba's public `overload_attribute` adds are compiled functions, of which the law
has 172: a tenth of the time that its translation takes. Here a table's array is written down where
an attribute is read. This rests on numba's templates of attributes and on `numba.np.arrayobj`;
where one of them is missing, `jit` finds no `units`, and `nested_type` takes the public way.
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
    from osc_contact.law.nested import Nested
    from osc_contact.law.numba_types import Builder, CPUContext, Type, Value

_public: Any = numba  #: its type hints leave out `from_dtype`


def lower_tables(record: type[Type], kind: Nested) -> None:
    """Make the tables of a record attributes that compiled code takes as arrays.

    Args:
        record: the numba type of the record, a class. kind: its `Nested`.
    """
    tables = {name: _Table(kind, name) for name in kind.tables}

    @infer_getattr
    class Tables(AttributeTemplate):
        """Types of the tables."""

        key = record

        def generic_resolve(self, value: Type, attr: str) -> Type | None:  # type: ignore[override]
            return tables[attr].array if attr in tables else None

    for name, table in tables.items():
        lower_getattr(record, name)(table.lower)


class _Table:
    """A table of a record, which compiled code takes as an array.

    Attributes:
        array: its type.
    """

    def __init__(self, kind: Nested, name: str) -> None:
        dtype, sizes = kind.tables[name]
        self.array = types.Array(_public.from_dtype(dtype), len(sizes), "C")
        self._item = dtype.itemsize
        self._start = kind.start(name)
        self._sizes = [kind.slot(one) if isinstance(one, str) else WORD(one) for one in sizes]

    def lower(self, context: CPUContext, builder: Builder, record: Type, value: Value) -> Value:
        """Code for the array, as `numba.extending.lower_getattr` takes it.

        Args:
            context: numba's of the target. builder: of LLVM's instructions. record: the type.
            value: pointer to the record.
        """
        shape = [
            one if isinstance(one, ir.Constant) else layout_word(builder, value, one)
            for one in self._sizes
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
