"""The type of a `nested.Nested` record to numba: a record with tables as further attributes."""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    infer_getattr,
    intrinsic,
    lower_getattr_generic,
    models,
    register_model,
)
from numba.np.arrayobj import make_array, populate_array, record_getattr
from numba.np.numpy_support import from_dtype

from osc_contact.law.jit import view


class _Record(types.Record):
    """The head as a record; `tables`: declaration."""

    def __init__(self, kind: Any) -> None:
        head: Any = from_dtype(kind.dtype)
        fields = [(name, field._asdict()) for name, field in head.fields.items()]
        super().__init__(fields, head.size, head.aligned)
        self.kind = kind
        self.arrays = {
            name: types.Array(from_dtype(dtype), len(sizes), "C")
            for name, (dtype, sizes) in kind.tables.items()
        }


@register_model(_Record)
class _Pointer(models.PrimitiveModel):
    """Unlike other records it may be part of a tuple."""

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, ir.ArrayType(ir.IntType(8), kind.size).as_pointer())


@infer_getattr
class _Attributes(AttributeTemplate):
    key = _Record

    def generic_resolve(self, record: Any, name: str) -> Any:  # type: ignore[override]
        return record.arrays.get(name)  # None: a field


@lower_getattr_generic(_Record)
def _get(context: Any, builder: Any, record: Any, value: Any, name: str) -> Any:
    if name not in record.arrays:
        return record_getattr(context, builder, record, value, name)
    kind, array = record.kind, record.arrays[name]
    word = context.get_value_type(types.intp)

    def number(x: int) -> Any:
        return context.get_constant(types.intp, x)

    def layout(slot: int) -> Any:
        """A word of the layout, which never changes: it is read once."""
        found = builder.load(cgutils.get_record_member(builder, value, 8 * slot, word))
        found.set_metadata("invariant.load", builder.module.add_metadata([]))
        return found

    sizes = kind.tables[name][1]
    shape = [layout(kind.slot(one)) if isinstance(one, str) else number(one) for one in sizes]
    size = number(context.get_abi_sizeof(context.get_data_type(array.dtype)))
    strides = [size]
    for length in shape[:0:-1]:
        strides.insert(0, builder.mul(strides[0], length))
    out = make_array(array)(context, builder)
    start = layout(list(kind.tables).index(name))
    populate_array(
        out,
        data=cgutils.pointer_add(builder, value, start, return_type=out.data.type),
        shape=cgutils.pack_array(builder, shape),
        strides=cgutils.pack_array(builder, strides),
        itemsize=size,
        meminfo=None,
        parent=None,
    )
    return out._getvalue()


def pointer_to(kind: Any) -> Any:
    """A compiled function (bytes, offset) that takes what is there for a record of this kind."""
    record = _Record(kind)

    @intrinsic
    def point(typing: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            return builder.inttoptr(given[0], context.get_value_type(record))

        return record(types.uintp), generate

    @view
    def at(raw, start):
        return point(raw.ctypes.data + np.uintp(start))

    return at
