"""The table of a study: rows appended one by one, so that a kill loses nothing; then Parquet."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from osc_contact.errors import InvalidInputError
from osc_contact.files import hold, whole_file
from osc_contact.sweeps.study import SweepStudy

__all__ = ["RowFile", "make_table", "write_table"]

Row = dict[str, Any]


class RowFile:
    """Rows that are done, one a line; what is written survives a kill, also amid a line.

    Attributes:
        path: of the file. done: rows by number.
    """

    def __init__(self, path: Path, study: SweepStudy, laws: Any = None) -> None:
        """Go on with a file, or begin one.

        Args:
            path: of the file. study: that the rows belong to; its first line names it.
            laws: JSON-able, of the controllers that make the rows where they are not the study's.

        Raises:
            InvalidInputError: another program writes to it, it is damaged, or it holds another
                study.
        """
        self.path = path
        self.done: dict[int, Row] = {}
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("ab")
        try:
            hold(self._file.fileno(), path)
            self._go_on(path.read_bytes(), study, laws)
        except BaseException:
            self._file.close()
            raise

    def _go_on(self, text: bytes, study: SweepStudy, laws: Any) -> None:
        """Take in what the file holds, and make it end with a whole line."""
        whole = text[: text.rfind(b"\n") + 1]
        lines = whole.splitlines()
        head = self._read(1, lines[0], "study", str) if lines else {}
        if lines and (head.get("study"), head.get("laws")) != (study.fingerprint, laws):
            raise InvalidInputError(
                f"{self.path} holds the rows of another study: another scenario, other "
                "distributions, another design, seed or law; give another folder, or remove it"
            )
        for number, line in enumerate(lines[1:], 2):
            row = self._read(number, line, "row", int)
            self.done[row["row"]] = row
        self._file.truncate(len(whole))
        if not lines:
            named = {"study": study.fingerprint, "vary": study.vary, "design": study.design}
            self._write(named if laws is None else named | {"laws": laws})

    def _read(self, number: int, line: bytes, key: str, kind: type) -> Row:
        """A line as an object with a key of a kind.

        Raises:
            InvalidInputError: it is damaged.
        """
        try:
            row = json.loads(line)
            if type(row[key]) is kind:
                return row
            cause = f"its {key!r} is {row[key]!r}"
        except (ValueError, KeyError, TypeError, IndexError, RecursionError) as error:
            cause = f"{type(error).__name__}: {error}"
        cure = (
            "remove it: its run is done again" if number > 1 else "remove the file, and begin anew"
        )
        raise InvalidInputError(f"{self.path}: line {number} is damaged ({cause}); {cure}")

    def append(self, rows: Iterable[Row]) -> None:
        """Keep rows, now."""
        for row in rows:
            self.done[row["row"]] = row
            self._write(row)

    def _write(self, row: Row) -> None:
        self._file.write(json.dumps(row).encode() + b"\n")
        self._file.flush()

    def close(self) -> None:
        """Nothing more comes."""
        os.fsync(self._file.fileno())
        self._file.close()


def make_table(rows: Sequence[Row], study: SweepStudy) -> Any:
    """A `pyarrow.Table`, sorted by row, columns in the order in which they first appear.

    Args:
        rows: of the study, in any order. study: kept in the table's metadata.
    """
    import pyarrow as pa

    ordered = sorted(rows, key=lambda row: int(row["row"]))
    names = list(dict.fromkeys(name for row in ordered for name in row))
    columns = {}
    for name in names:
        try:
            columns[name] = pa.array([_plain(row.get(name)) for row in ordered])
        except pa.ArrowException as error:
            raise InvalidInputError(
                f"the values of {name!r} are of several kinds ({error}): rows are damaged; remove "
                "their file, and run the study again"
            ) from error
    about = {
        "study": study.fingerprint,
        "scenario": study.text,
        "vary": json.dumps(study.vary),
        "overrides": json.dumps(study.overrides),
        "design": json.dumps([study.design, study.samples, study.seed]),
    }
    return pa.table(columns).replace_schema_metadata(about)


def write_table(table: Any, path: Path) -> None:
    """Write it as Parquet."""
    from pyarrow import parquet

    with whole_file(path) as unfinished:
        parquet.write_table(table, unfinished)


def _plain(value: Any) -> Any:
    return json.dumps(value) if isinstance(value, list | dict) else value
