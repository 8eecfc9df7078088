"""Contact pairs as rows of numbers for `law.contact`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from osc_contact.contacts.pairs.law_pair import PairRow, law_row
from osc_contact.contacts.pairs.pair import ContactPair
from osc_contact.law.tables import GIVEN
from osc_contact.spatial import Array

__all__ = ["PairRows"]

_GIVEN = PairRow(GIVEN, ())


class PairRows:
    """The pairs of a controller as arrays.

    Attributes:
        table: kind, first column, columns, first shape, freedoms, whether it knows where it slides,
            of each pair. shapes: (16,) each. owners: (r_all,) pair of each column of N. r_all:
            their number. given: columns of the pairs that only Python can evaluate, by number.
        elsewhere: (pair, its first column) where only Python code can evaluate the pair.
    """

    def __init__(self, pairs: Sequence[ContactPair], columns: Mapping[int, int]) -> None:
        """Pack them; `columns`: of the pairs evaluated elsewhere, by number, unknown: 0."""
        table: list[tuple[int, ...]] = []
        shapes: list[Array] = []
        owners: list[int] = []
        self.elsewhere: list[tuple[int, ContactPair, int]] = []
        for number, pair in enumerate(pairs):
            row = law_row(pair) or _GIVEN
            r = len(row.shapes) - row.freedoms
            if row.kind == GIVEN:
                r = columns.get(number, 0)
                self.elsewhere.append((number, pair, len(owners)))
            table.append((row.kind, len(owners), r, len(shapes), row.freedoms, int(row.rubs)))
            shapes.extend(row.shapes)
            owners.extend([number] * r)
        self.table, self.shapes, self.owners = table, shapes, owners
        self.given = dict(columns)
        self.r_all = len(owners)
