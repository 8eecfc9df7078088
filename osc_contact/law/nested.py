"""Records with tables in one array of bytes: `t.model.arms[k].mass`.

The bytes begin with their layout: the offset of each table, and the numbers of rows and columns.
Compiled functions take such a record as one pointer and read its tables in place; in plain Python a
`View` has the same attributes. Sizes, offsets and types follow from a single declaration.
"""

from __future__ import annotations

from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from osc_contact.law.jit import COMPILES

Bytes = NDArray[np.uint8]
_LINE = 64  #: bytes of a cache line, to which each table is aligned


class Nested:
    """Declaration of a record: fields of its head, and tables with their sizes.

    Attributes:
        dtype: type of the head.
        tables: for each name the dtype of a row (or element), and sizes.
        counts: names of the sizes that are known at run time.
        at: function (bytes, offset) that returns the record, for compiled code, and for plain
            Python if nothing is compiled.
    """

    def __init__(self, head: np.dtype[Any], **tables: Any) -> None:
        """Declare a record.

        Args:
            head: type with the fields of the head.
            tables: for a table of numbers name = size or (size, …), where each size is a number or
                the name of a count; for a table of another type name = (dtype, size, …).
        """
        self.tables: dict[str, tuple[np.dtype[Any], list[Any]]] = {}
        for name, declared in tables.items():
            sizes: list[Any] = [declared] if isinstance(declared, str) else list(declared)
            kind = np.float64 if isinstance(sizes[0], str) else sizes.pop(0)
            self.tables[name] = (np.dtype(kind), sizes)
        sizes = [size for _, all_sizes in self.tables.values() for size in all_sizes]
        self.counts = list(dict.fromkeys(size for size in sizes if isinstance(size, str)))
        words = len(self.tables) + len(self.counts)
        fields: Any = [(name, head[name]) for name in head.names or ()]
        if words:
            fields.insert(0, ("layout", np.int64, (words,)))
        self.dtype = np.dtype(fields, align=True)
        numbers = {name: _number(name) for name in self.dtype.names if not self.dtype[name].shape}
        self._view: Any = type("View", (View,), numbers)  #: class of the views in Python
        if not COMPILES:
            self.at: Any = lambda raw, start: self.view(raw[start:])
        else:
            from osc_contact.law.nested_type import pointer_to

            self.at = pointer_to(self)

    def slot(self, size: str) -> int:
        """Index of the word of the layout that contains a count.

        Args:
            size: name of the count, such as "k" for the number of arms.
        """
        return len(self.tables) + self.counts.index(size)

    def start(self, table: str) -> int:
        """Index of the word of the layout that contains the offset of a table.

        Args:
            table: name of the table.
        """
        return list(self.tables).index(table)

    def new(self, counts: dict[str, int]) -> Bytes:
        """Make the bytes of a record that is zero except for its layout.

        Args:
            counts: value of each count by its name.
        """
        # tables follow the head, each from a multiple of `_LINE` bytes on
        starts = []
        end = self.dtype.itemsize
        for kind, sizes in self.tables.values():
            starts.append(end := -(-end // _LINE) * _LINE)
            end += kind.itemsize * prod(counts.get(size, size) for size in sizes)
        raw: Bytes = np.zeros(-(-end // _LINE) * _LINE, np.uint8)
        layout = starts + [counts[name] for name in self.counts]
        raw[: 8 * len(layout)].view(np.int64)[:] = layout
        return raw

    def table(self, raw: Bytes, layout: NDArray[np.int64], name: str) -> NDArray[Any]:
        """Table of a record, as an array that shares its memory.

        Args:
            raw: bytes of the record.
            layout: words of its layout.
            name: name of the table.
        """
        kind, sizes = self.tables[name]
        start = layout[self.start(name)]
        shape = [int(layout[self.slot(size)]) if isinstance(size, str) else size for size in sizes]
        rows = raw[start : start + kind.itemsize * prod(shape)].view(kind).reshape(shape)
        return rows.view((np.record, kind), Table) if kind.names else rows

    def view(self, raw: Bytes) -> View:
        """View of the record at the beginning of an array of bytes, for plain Python.

        Args:
            raw: bytes of the record, and any bytes behind them.
        """
        view: View = self._view(self, raw)
        return view


class Table(np.ndarray[Any, Any]):
    """A table in plain Python: its columns are attributes, as of `numpy.recarray`, but quickly."""

    def __getattr__(self, name: str) -> Any:
        """Return a column of the table, which shares its memory.

        Python calls it for names that are not attributes of the array.

        Args:
            name: name of a field of the rows.
        """
        if name not in (self.dtype.names or ()):
            raise AttributeError(name)
        column = self[name]
        return column if column.dtype.names else column.view(np.ndarray)

    def __setattr__(self, name: str, value: Any) -> None:
        """Set all elements of a column, or an attribute of the array.

        Args:
            name: name of a field of the rows, or of an attribute.
            value: new value or values.
        """
        if name in (self.dtype.names or ()):
            self[name] = value
        else:
            super().__setattr__(name, value)


def _number(name: str) -> Any:
    """Property of a field with one number, which is faster than `View.__getattr__`.

    Args:
        name: name of the field.
    """
    return property(lambda view: view.head[name])


class View:
    """Record in plain Python, with the fields of its head and its tables as attributes.

    Tables and array fields are cached as attributes after their first use.
    """

    def __init__(self, kind: Nested, raw: Bytes) -> None:
        """Bind the view to bytes, which it shares.

        Args:
            kind: declaration of the record.
            raw: bytes that begin with the record.
        """
        head = raw[: kind.dtype.itemsize].view(kind.dtype)[0]
        self.__dict__.update(kind=kind, raw=raw, head=head)

    def __getattr__(self, name: str) -> Any:
        """Return a table or an array of the head, and store it as an attribute for the next access.

        Args:
            name: name of a table or field.

        Raises:
            AttributeError: the record has no such table or field.
        """
        attributes = self.__dict__
        try:
            if name in attributes["kind"].tables:
                value = attributes["kind"].table(
                    attributes["raw"], attributes["head"]["layout"], name
                )
            else:
                value = attributes["head"][name]
        except (KeyError, ValueError) as error:
            raise AttributeError(name) from error
        attributes[name] = value
        return value

    def __setattr__(self, name: str, value: Any) -> None:
        """Set a field of the head.

        Args:
            name: name of the field.
            value: new value; an array field is overwritten in place.
        """
        self.__dict__["head"][name] = value

    def __getitem__(self, name: str) -> Any:
        """Return a field of the head by its name, without storing it.

        Args:
            name: name of the field.
        """
        return self.__dict__["head"][name]
