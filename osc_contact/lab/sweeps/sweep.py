"""Sweep: all runs of a study, on all cores; an interrupted one can be continued.

Rows (`rows`) are written to a file and become a table; `workers` makes them in other processes.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING

from osc_contact.errors import InvalidInputError, missing
from osc_contact.files import hold, whole_file
from osc_contact.lab.scenarios.schema import Scenario
from osc_contact.lab.sweeps.rows import Row, make_rows, require_long_enough
from osc_contact.lab.sweeps.study import Design, SweepStudy
from osc_contact.lab.sweeps.workers import MakesRows, make_all, workers_of

if TYPE_CHECKING:
    import distributed
    import pyarrow

# --- File and table -----------------------------------------------------------------------------


class RowFile:
    """File of completed rows, one in a line, which can be continued after a kill.

    Attributes:
        path: the file.
        done: completed rows by number.
    """

    def __init__(self, path: Path, study: SweepStudy, laws: object = None) -> None:
        """Open a file to continue it, or begin one.

        Args:
            path: the file.
            study: study of the rows, which the first line identifies.
            laws: JSON data that identify controllers other than the study's; None: the study's.

        Raises:
            InvalidInputError: another program writes to the file, or it holds another study.
        """
        self.path = path
        self.done: dict[int, Row] = {}
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("ab")  #: open file, to which rows are appended
        try:
            hold(self._file.fileno(), path)
            self._continue(path.read_bytes(), study, laws)
        except BaseException:
            self._file.close()
            raise

    def _continue(self, text: bytes, study: SweepStudy, laws: object) -> None:
        """Read the rows of the file and remove an incomplete last line.

        Rows of damaged lines do not count as completed.

        Args:
            text: content of the file.
            study: study of the rows.
            laws: JSON data that identify controllers other than the study's; None: the study's.

        Raises:
            InvalidInputError: the file holds another study.
        """
        complete_lines = text[: text.rfind(b"\n") + 1]
        if not complete_lines:
            self._file.truncate(0)
            head_line = {"study": study.fingerprint, "vary": study.vary, "design": study.design}
            self._write(head_line if laws is None else head_line | {"laws": laws})
            return
        head, *rows = map(_parse, complete_lines.splitlines())
        if (head.get("study"), head.get("laws")) != (study.fingerprint, laws):
            raise InvalidInputError(
                f"{self.path} holds the rows of another study (another scenario, other "
                "distributions, another design, seed or law), or its first line is damaged; give "
                "another folder, or remove it"
            )
        self.done |= {row["row"]: row for row in rows if type(row.get("row")) is int}
        self._file.truncate(len(complete_lines))  # once all of it is sound

    def append(self, row: Row) -> None:
        """Append a completed row to the file."""
        self.done[row["row"]] = row
        self._write(row)

    def _write(self, row: Row) -> None:
        """Write a line and hand it to the operating system."""
        self._file.write(json.dumps(row).encode() + b"\n")
        self._file.flush()

    def close(self) -> None:
        """Close the file after its content has reached the disk."""
        os.fsync(self._file.fileno())
        self._file.close()


def _parse(line: bytes) -> Row:
    """JSON object of a line, an empty one for a damaged line."""
    try:
        return dict(json.loads(line))
    except (ValueError, TypeError, RecursionError):
        return {}


def make_table(rows: Iterable[Row], study: SweepStudy) -> pyarrow.Table:
    """Table of rows, sorted by number, with columns in the order of their first appearance.

    Args:
        rows: rows in any order.
        study: study of the rows, which the metadata of the table describe.

    Raises:
        InvalidInputError: a column with values of different types.
    """
    import pyarrow as pa

    ordered = sorted(rows, key=lambda row: row["row"])
    columns = {}
    for name in dict.fromkeys(name for row in ordered for name in row):
        values = [row.get(name) for row in ordered]
        try:
            columns[name] = pa.array([json.dumps(x) if isinstance(x, list) else x for x in values])
        except pa.ArrowException as error:
            raise InvalidInputError(
                f"the values of {name!r} are of several kinds ({error}): rows are damaged; remove "
                "their file, and run the study again"
            ) from error
    return pa.table(columns).replace_schema_metadata(
        {
            "study": study.fingerprint,
            "scenario": study.text,
            "vary": json.dumps(study.vary),
            "overrides": json.dumps(study.overrides),
            "design": json.dumps([study.design, study.samples, study.seed]),
        }
    )


ROWS = "rows.jsonl"  #: file of a sweep's folder
TABLE = "table.parquet"  #: file of a sweep's folder
_ROWS_OF_JOB = 4  #: runs of a job

Progress = Callable[[int, int], None]


def sweep(
    scenario: str | Path | Scenario,
    vary: Mapping[str, str] | Sequence[str],
    samples: int,
    *,
    design: Design = "halton",
    seed: int = 0,
    out: str | Path | None = None,
    workers: int | None = None,
    scheduler: str | distributed.Client | None = None,
    overrides: Sequence[str] = (),
    progress: Progress | None = None,
) -> pyarrow.Table:
    """Run a scenario many times with other values; return a table of all results.

    Row i depends on the study and on i only: not on the number of workers, and not on an
    interruption of the sweep. It equals `osc.run` of its scenario with its seed.

    Args:
        scenario: packaged name, file, or a scenario made in Python, without Python laws and pairs.
        vary: {"path.to.key": "uniform(0.8, 1.2)"}, see `lab.sweeps.study.WORDS`; the path
            "seed" is the seed of each run.
        samples: number of points; of a grid, number of values of each key with infinitely many.
        design: "halton" or "sobol" (quasi-random), "random" or "grid"; "saltelli" for
            Sobol's indices, with keys + 2 runs of each of 2^m samples.
        seed: seed of the points, and of each run if it does not vary.
        out: folder for rows and table; completed rows in it are not run again.
        workers: number of processes; None: one for each core; 1: this process only.
        scheduler: address, or `distributed.Client`, of a dask cluster whose workers run the
            samples.
        overrides: texts path=value of all runs.
        progress: function that is called with the number of completed rows and of all rows.

    Returns:
        A table sorted by row: row, seed, varied values, word, failed, why, and the numbers of
        `metrics`. Runs that were rejected, diverged or crashed have a word and a reason only.

    Raises:
        ScenarioError, InvalidInputError: errors of the study; runs too short to be judged; a folder
            with another study; a cluster that does not answer or has another version.
    """
    study = SweepStudy.of(scenario, vary, samples, design, seed, overrides)
    return run_study(study, out=out, workers=workers, scheduler=scheduler, progress=progress)


def run_study(
    study: SweepStudy,
    *,
    out: str | Path | None = None,
    workers: int | None = None,
    scheduler: str | distributed.Client | None = None,
    progress: Progress | None = None,
) -> pyarrow.Table:
    """Run the missing rows of a study and return the table of all rows.

    Args:
        study: study to run.
        out: folder for rows and table; completed rows in it are not run again. None: no files.
        workers: number of processes; None: one for each core.
        scheduler: address or client of a dask cluster; None: processes of this machine.
        progress: called with the number of completed rows and of all rows.
    """
    try:
        from pyarrow import parquet  # a missing package is reported before the runs
    except ImportError as error:
        raise InvalidInputError(missing(error)) from error

    file = None if out is None else Path(out) / ROWS
    rows = run_rows(study, file, workers=workers, scheduler=scheduler, progress=progress)
    table = make_table(rows.values(), study)
    if out is not None:
        with whole_file(Path(out) / TABLE) as unfinished:
            parquet.write_table(table, unfinished)
    return table


def run_rows(
    study: SweepStudy,
    file: Path | None,
    make: MakesRows = make_rows,
    *,
    laws: object = None,
    workers: int | None = None,
    scheduler: str | distributed.Client | None = None,
    progress: Progress | None = None,
) -> dict[int, Row]:
    """Rows of a study by number, from a file and by running the missing ones.

    Args:
        study: study to run.
        file: file of the rows; None: they are not written.
        make: function that makes rows, which other processes import.
        laws: JSON data that identify controllers other than the study's; None: the study's.
        workers: number of processes; None: one for each core.
        scheduler: address or client of a dask cluster; None: processes of this machine.
        progress: called with the number of completed rows and of all rows.
    """
    require_long_enough(study)
    with ExitStack() as stack:
        rows = None
        if file is not None:
            rows = stack.enter_context(closing(RowFile(file, study, laws)))
        finished = {} if rows is None else rows.done
        remaining = [number for number in range(study.rows) if number not in finished]
        completed = study.rows - len(remaining)
        jobs = [
            (study, remaining[i : i + _ROWS_OF_JOB]) for i in range(0, len(remaining), _ROWS_OF_JOB)
        ]
        crew = stack.enter_context(workers_of(workers, scheduler, len(jobs)))
        for _, row in make_all(crew, jobs, make):
            finished[row["row"]] = row
            completed += 1
            if rows is not None:
                rows.append(row)
            if progress is not None:
                progress(completed, study.rows)
    return {number: finished[number] for number in range(study.rows)}
