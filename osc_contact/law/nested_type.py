"""The type of a `nested.Nested` record to numba: a record with tables as further attributes.

It is made of numba's public interface for extensions: a type with a model, attributes, intrinsics.
Where the law is compiled by parts, tables are lowered by `nested_tables` instead, which compiles no
function for each of them.
"""

from __future__ import annotations

from collections.abc import Callable
from hashlib import sha256
from typing import TYPE_CHECKING, Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, models, register_model
from numpy.typing import NDArray

from osc_contact.law import jit
from osc_contact.law.jit import VIEW, view
from osc_contact.law.layout_code import BYTE, WORD, layout_word, table_address

if TYPE_CHECKING:
    from osc_contact.law.numba_types import (
        Builder,
        CPUContext,
        Intrinsic,
        Layout,
        Signature,
        Type,
        TypingContext,
        Value,
        Values,
    )

#: Function of a record that numba compiles to read a table.
Implementation = Callable[[np.record], NDArray[Any]]

_public: Any = numba  #: its type hints leave out `carray` and options of `overload_attribute`


class _Pointer(models.PrimitiveModel):
    """Data model of a record as a pointer, so that it may be part of a tuple."""

    def __init__(self, manager: Any, record: Any) -> None:
        """Set the pointer's type: bytes of the size of the record's head.

        Args:
            manager: manager of numba's data models.
            record: numba type of the record.
        """
        super().__init__(manager, record, ir.ArrayType(BYTE, record.size).as_pointer())


_records: dict[str, Type] = {}  #: types of records by their names


def record_named(name: str) -> Type:
    """Return the numba type of a record.

    It is how pickled types of cached parts find the record of the present process.

    Args:
        name: name of the type, which contains the hash of the layout.

    Raises:
        KeyError: this process has no record with this layout.
    """
    return _records[name]


def _record_class(record_layout: Layout) -> Any:
    """Make the class of the numba type of a record.

    The type has the fields of the record's head, the part of fixed size at its front. Its tables,
    arrays whose sizes are known at run time, are registered by `pointer_to` as attributes of the
    class; each record has a class of its own, because numba registers attributes by class.

    Args:
        record_layout: declaration of the record, a `Nested`: fields of its head, and tables.
    """

    class Record(types.Record):
        """Numba type of the record: fields of the head, and tables as further attributes.

        Its name contains a hash of the layout; numba's own name would have thousands of characters.
        """

        def __init__(self) -> None:
            """Make the type from the fields of the head; name it after head and tables.

            `record_layout`, of the enclosing function, declares both. The name is "record_" and a
            hash.
            """
            head: Any = _public.from_dtype(record_layout.dtype)
            fields = [(name, field._asdict()) for name, field in head.fields.items()]
            super().__init__(fields, head.size, head.aligned)
            declared = f"{record_layout.dtype} {record_layout.tables}"
            self.name = f"record_{sha256(declared.encode()).hexdigest()[:16]}"

        def __reduce__(self) -> tuple[Callable[[str], Type], tuple[str]]:
            """Reduce the type to its name for pickle."""
            return record_named, (self.name,)

        def __repr__(self) -> str:
            """Name with the hash of the layout, for keys of parts; numba's own omits tables."""
            return str(self.name)

    return Record


def pointer_to(record_layout: Layout) -> Any:
    """Compiled function (bytes, offset) that returns the record at an offset.

    numba gets a type of its own for the record, whose value is a pointer to the first byte. Tables
    of the record become its attributes, in units (`jit.UNITS`) by code that `lower_tables`
    generates.

    Args:
        record_layout: declaration of the record, a `Nested`: fields of its head, and tables.
    """
    Record = _record_class(record_layout)
    register_model(Record)(_Pointer)
    record = Record()
    _records[record.name] = record
    if jit.UNITS is None:
        for name in record_layout.tables:
            _public.extending.overload_attribute(Record, name, jit_options=VIEW)(
                _attribute(record_layout, name)
            )
    else:
        jit.UNITS.lower_tables(Record, record_layout)

    @intrinsic
    def point(typing: TypingContext, address: Type) -> Intrinsic:
        """Convert an address to the record there, in compiled code.

        Args:
            typing: typing context of numba.
            address: type of the address, an unsigned integer.

        Returns:
            Signature and code generator, as numba expects them of an intrinsic.
        """

        def generate(
            context: CPUContext, builder: Builder, signature: Signature, values: Values
        ) -> Value:
            """Generate code that converts the integer to a pointer to the record.

            `record` is the numba type of the record, of the enclosing `pointer_to`.

            Args:
                context: target context of numba.
                builder: builder of LLVM instructions.
                signature: types of the conversion.
                values: the address alone.
            """
            return builder.inttoptr(values[0], context.get_value_type(record))

        return record(types.uintp), generate

    @view
    def at(raw, start):
        """Return the record at an offset of an array of bytes.

        Args:
            raw: array of bytes.
            start: offset of the record.
        """
        return point(raw.ctypes.data + np.uintp(start))

    return at


def _attribute(record_layout: Layout, name: str) -> Callable[[Type], Implementation]:
    """Make the implementation of a table for `numba.extending.overload_attribute`.

    Args:
        record_layout: declaration of the record, a `Nested`: fields of its head, and tables.
        name: name of the table.

    Returns:
        Function that chooses, for the type of a record, the function that returns the table as an
        array.
    """
    dtype, sizes = record_layout.tables[name]
    start = _start(record_layout.start(name))
    shape = [
        _count(record_layout.slot(size)) if isinstance(size, str) else _fixed(size)
        for size in sizes
    ]
    rows = shape[0]
    columns = shape[-1]
    carray = _public.carray

    # numba compares the parameters of `choose` with those of its results, annotations included
    def one_size(record: Any) -> NDArray[Any]:
        """Return the table of a record as an array with one axis, in compiled code."""
        return carray(start(record), (rows(record),), dtype)

    def two_sizes(record: Any) -> NDArray[Any]:
        """Return the table of a record as an array with two axes, in compiled code."""
        return carray(start(record), (rows(record), columns(record)), dtype)

    def choose(record: Any) -> Implementation:
        """Choose the implementation for a record by the table's number of sizes."""
        return one_size if len(shape) == 1 else two_sizes

    return choose


def _start(slot: int) -> Any:
    """Make a compiled function that returns the address of a table of a record.

    The layout at the front of a record has words of 64 bits: offsets (bytes) of the tables, then
    sizes.

    Args:
        slot: index of the word of the layout that contains the offset of the table.
    """

    @intrinsic
    def start(typing: TypingContext, record: Type) -> Intrinsic:
        """Return the address of the table of a record.

        Args:
            typing: typing context of numba.
            record: type of the record.

        Returns:
            Signature and code generator, as numba expects them of an intrinsic.
        """

        def generate(
            context: CPUContext, builder: Builder, signature: Signature, values: Values
        ) -> Value:
            """Generate code that adds the offset of the table to the address of the record.

            The offset (bytes) is the word `slot` of the layout at the front of the record.

            Args:
                context: target context of numba.
                builder: builder of LLVM instructions.
                signature: types of the call.
                values: pointer to the record alone.
            """
            return table_address(builder, values[0], slot)

        return types.voidptr(record), generate

    return start


def _count(slot: int) -> Any:
    """Make a compiled function that returns a size of a record's tables, read from its layout.

    The layout at the front of a record has words of 64 bits: offsets (bytes) of the tables, then
    sizes.

    Args:
        slot: index of the word of the layout that contains the size.
    """

    @intrinsic
    def count(typing: TypingContext, record: Type) -> Intrinsic:
        """Return the size from the layout of a record.

        Args:
            typing: typing context of numba.
            record: type of the record.

        Returns:
            Signature and code generator, as numba expects them of an intrinsic.
        """

        def generate(
            context: CPUContext, builder: Builder, signature: Signature, values: Values
        ) -> Value:
            """Generate code that loads the size from the layout at the front of the record.

            It is the word `slot` of the layout.

            Args:
                context: target context of numba.
                builder: builder of LLVM instructions.
                signature: types of the call.
                values: pointer to the record alone.
            """
            return layout_word(builder, values[0], slot)

        return types.intp(record), generate

    return count


def _fixed(size: int) -> Any:
    """Compiled function of a record that returns a constant size of its tables.

    Args:
        size: the size, such as 6 for rows of six numbers.
    """

    @intrinsic
    def fixed(typing: TypingContext, record: Type) -> Intrinsic:
        """Return the size for any record.

        Args:
            typing: typing context of numba.
            record: type of the record.

        Returns:
            Signature and code generator of the constant `size`, as numba expects them of an
            intrinsic.
        """
        return types.intp(record), lambda context, builder, signature, given: WORD(size)

    return fixed
