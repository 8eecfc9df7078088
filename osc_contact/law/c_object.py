"""Object file of the compiled law for C, with entries that take addresses and integers.

By numba's calling convention a C program declares the entries as

    int32_t name(int64_t *result, void **unused, uint64_t or int64_t …)

with uint64_t for addresses, even if a pointer has 32 bits. Sizes of arrays are those of MODEL; they
are not checked.
"""

from __future__ import annotations

import logging
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile, mkdtemp
from time import perf_counter
from typing import IO, Any, Self

import numpy as np

from osc_contact.errors import OscContactError
from osc_contact.files import one_by_one
from osc_contact.law import jit, library, limits, operational, records, rows, saturation
from osc_contact.law.compiled import announced, report_to
from osc_contact.law.jit import bytes_at, inner, numbers_at, words_at
from osc_contact.law.limits import PROGRAM

_log = logging.getLogger(__name__)
KEPT = 16  #: number of libraries, of 2 MB each, that remain in the cache, the newest included
MACHINE_CODE = 20.0  #: s of processor time for linking, optimising and emitting all parts
_MANY_NEW_PARTS = 10  #: number of new parts from which on a second process is started
_program = PROGRAM.at

_rows, _terms, _prepare, _finish, _fill, _settle = (
    inner(part.__wrapped__)
    for part in (
        rows.rows,
        operational.operational_space,
        limits.prepare,
        limits.finish,
        saturation.fill_program,
        saturation.settle,
    )
)


def osc_law_rows(raw, at, arrays, sizes):
    """Run `rows.rows`, the law over many rows of inputs, as a function called from C.

    Args:
        raw: address of the bytes of `records.Rows`.
        at: offset of the JOB in them (bytes).
        arrays: address of nine addresses, those of the float64 arrays q, v, wrenches (…, 6), X_WD
            (…, 4), V_D, A_D, alpha_d, touched (…, 28) and active of `rows.rows`.
        sizes: address of nine integers, the number of elements of each array, or the number of its
            rows if it has two axes.

    Returns:
        Twice the number of the next row, plus 1 if some row did not end OK, as `rows.rows` returns
        it.
    """
    addresses = words_at(arrays, 9)
    counts = words_at(sizes, 9)
    inputs = (
        numbers_at(addresses[0], counts[0]),
        numbers_at(addresses[1], counts[1]),
        numbers_at(addresses[2], (counts[2], 6)),
        numbers_at(addresses[3], (counts[3], 4)),
        numbers_at(addresses[4], counts[4]),
        numbers_at(addresses[5], counts[5]),
        numbers_at(addresses[6], counts[6]),
        numbers_at(addresses[7], (counts[7], 28)),
        numbers_at(addresses[8], counts[8]),
    )
    return _rows(bytes_at(raw), at, inputs)


def osc_law_terms(raw, q, v, out, sizes):
    """Run `operational.operational_space`, Λ, μ, p and further terms of one arm, called from C.

    Args:
        raw: address of the bytes of `records.Rows`.
        q, v: addresses of joint positions and velocities (float64).
        out: address of the matrix (rows, columns) of results (float64).
        sizes: address of four integers: columns of `out`, elements of q and of v, rows of `out`.

    Returns:
        Number of rows that were filled.
    """
    n = words_at(sizes, 4)
    return _terms(
        bytes_at(raw), numbers_at(q, n[1]), numbers_at(v, n[2]), numbers_at(out, (n[3], n[0]))
    )


def osc_law_fill(raw, at, i, program):
    """Run `saturation.fill_program`, which fills the program of a saturated tick, called from C.

    Args:
        raw: address of the bytes of `records.Rows`.
        at: offset of the JOB.
        i: row of the saturated tick.
        program: address of the bytes of PROGRAM.

    Returns:
        k, the number of contact forces that must not pull.
    """
    data = bytes_at(program)
    _fill(bytes_at(raw), at, i, data)
    return _program(data, 0).k


def osc_law_prepare(program, slack):
    """Run `limits.prepare`, which makes the quadratic program of the motor limits, called from C.

    Args:
        program: address of the bytes of PROGRAM.
        slack: number of slack variables.

    Returns:
        1, or 0 if the response of the chain to the motors is singular.
    """
    return int(_prepare(bytes_at(program), slack))


def osc_law_finish(program, slack):
    """Run `limits.finish`, which computes torques from the solver's answer, called from C.

    Args:
        program: address of the bytes of PROGRAM.
        slack: number of slack variables.

    Returns:
        1 if the torques are finite, else 0.
    """
    return int(_finish(bytes_at(program), slack))


def osc_law_settle(raw, at, i, program):
    """Run `saturation.settle`, which applies torques of a solved program to a row, called from C.

    Args:
        raw: address of the bytes of `records.Rows`.
        at: offset of the JOB.
        i: row of the saturated tick.
        program: address of the bytes of PROGRAM.

    Returns:
        0, since every entry returns an integer.
    """
    _settle(bytes_at(raw), at, i, bytes_at(program))
    return 0


#: Entries with the types of their arguments: p address, i integer.
ENTRIES = {
    osc_law_rows: "pipp",
    osc_law_terms: "ppppp",
    osc_law_fill: "piip",
    osc_law_prepare: "pi",
    osc_law_finish: "pi",
    osc_law_settle: "piip",
}


def object_file() -> bytes:
    """Content of law.o with all entries, for every processor of this platform.

    Raises:
        OscContactError: the library cannot be made on this machine.
    """
    return Path(jit.the_library().__file__).with_name(library.OBJECT).read_bytes()


def make() -> Any:
    """Make the library of the law and load it, unless the cache has one of these sources.

    Where the cache cannot be written, a temporary folder takes its place, with a warning.

    Returns:
        Extension module whose functions are the entry points of the law.

    Raises:
        OscContactError: the law is compiled in numba's usual way, or the C compiler fails.
    """
    if jit.UNITS is None:
        raise OscContactError(
            "no library of the law is made here: that takes a C compiler, Python.h and a numba "
            "within the bounds of pyproject.toml, and neither NUMBA_DISABLE_JIT nor OSC_CONTACT_LAW"
        )
    folder = library.kept(library.QUICK if library.is_quick() else library.LAW)
    try:
        with one_by_one(folder.parent):
            return library.found_in(folder) or _make(folder)
    except OSError as error:
        _log.warning("the compiled law cannot be kept, so every process compiles it: %s", error)
        return _make(Path(mkdtemp()) / folder.name)


def _make(folder: Path) -> Any:
    """Make a folder with object file, library and checksum, delete old ones, load the library.

    The folder appears complete or not at all: it is filled under another name and renamed. Of the
    folders beside it whose names have the same beginning before the first hyphen, all are deleted
    but the `KEPT` that were changed last, the new one included.

    Args:
        folder: path of the new folder; a folder of that name, which is damaged, is replaced.

    Returns:
        The module of the library.

    Raises:
        OscContactError: the C compiler fails, or Python cannot load the library.
    """
    with announced() as show, TemporaryDirectory(dir=folder.parent) as unfinished:
        new = Path(unfinished) / folder.name
        new.mkdir(mode=0o700)
        (new / library.OBJECT).write_bytes(_object(show))
        _link(new)
        (new / library.CHECKSUM).write_text(library.checksum(new))
        shutil.rmtree(folder, ignore_errors=True)  # a damaged folder of the same sources
        new.rename(folder)
    kind = folder.name.partition("-")[0]
    others = sorted(folder.parent.glob(f"{kind}-*"), key=lambda path: path.stat().st_mtime)
    for old in others[:-KEPT]:
        shutil.rmtree(old, ignore_errors=True)
    module = library.load(folder / library.LIBRARY)
    if module is None:
        raise OscContactError(f"Python cannot load {folder / library.LIBRARY}, which was just made")
    return module


def _object(show: Callable[[float], None], triple: str = "") -> bytes:
    """Content of law.o with all entries.

    Args:
        show: called with the completed share of the work.
        triple: LLVM's name of another platform; empty: this platform.
    """
    from osc_contact.law import machine_code, platforms

    units = jit.UNITS
    target = platforms.target_of(triple)
    progress = Progress(show)
    with TemporaryFile() as errors, _Assistant(errors) as assistant:
        units.watchers[:] = [progress.part_is_ready, assistant.start_if_needed]
        roots = {entry.__name__: _translated(entry) for entry in ENTRIES}
    emit = machine_code.emit_separately if library.is_quick() else machine_code.emit
    return emit(roots, target, progress.stage_is_over)


class Progress:
    """Progress of a compilation: the elapsed share of the time, estimated from the pace so far.

    The time of parts is not known in advance, because most of them may be cached.
    """

    def __init__(self, show: Callable[[float], None]) -> None:
        """Start the clock of the compilation, with no progress so far.

        Args:
            show: called after each part and stage with the completed share of the time, 0 … 1.
        """
        self._show = show  #: function that is called with the completed share
        self._began = perf_counter()  #: instant of the start (s)
        self._shown = 0.0  #: largest share that was shown
        self._translated = 1.0  #: s from the start until the last part was ready; updated by each

    def part_is_ready(self, share: float, was_cached: bool) -> None:
        """Show the progress after another part.

        Args:
            share: share of the units with a finished part.
            was_cached: whether this one was cached.
        """
        elapsed = perf_counter() - self._began
        self._translated = elapsed
        self._show_at_least(elapsed / (elapsed / share + MACHINE_CODE))

    def stage_is_over(self, share: float) -> None:
        """Show the progress after a stage of making the machine code.

        The whole time is estimated as that of the translation so far (`_translated`, s) and that of
        the machine code (`MACHINE_CODE`, s).

        Args:
            share: share of the time of this work that is over after the stage.
        """
        whole = self._translated + MACHINE_CODE
        self._show_at_least((self._translated + share * MACHINE_CODE) / whole)

    def _show_at_least(self, share: float) -> None:
        """Show a completed share (0 … 1), or the largest one so far, so that it never falls."""
        self._shown = max(self._shown, min(share, 1.0))
        self._show(self._shown)


def _translated(entry: Any) -> Any:
    """Translate an entry for the types of its arguments in ENTRIES.

    Args:
        entry: a function of ENTRIES.

    Returns:
        The `units.Part` of the entry.
    """
    from numba import types

    kinds = {"p": types.uintp, "i": types.int64}  # letters of ENTRIES
    unit = jit.UNITS.Unit(entry, False)
    return unit.translated(tuple(kinds[letter] for letter in ENTRIES[entry]))


def _cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class _Assistant:
    """Second process that translates parts in reverse order, for the first one to find cached."""

    def __init__(self, errors: IO[bytes]) -> None:
        """Prepare the process without starting it.

        Args:
            errors: file for its standard error.
        """
        self._new_parts = 0  #: number of parts so far that were not cached
        #: the process; None until it is started
        self._process: subprocess.Popen[bytes] | None = None
        self._errors = errors  #: file for its standard error

    def start_if_needed(self, share: float, was_cached: bool) -> None:
        """Start the process once many parts are new, if a core is available for it.

        Args:
            share: share of the units with a finished part.
            was_cached: whether the last one was cached.
        """
        self._new_parts += not was_cached
        if self._new_parts == _MANY_NEW_PARTS and self._process is None and _cores() > 1:
            self._process = subprocess.Popen(
                [sys.executable, "-m", __spec__.name, "assist"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=self._errors,
            )

    def __enter__(self) -> Self:
        """Enter a block in which the process may be started."""
        return self

    def __exit__(self, *error: object) -> None:
        """End the process; log if it failed, since the compilation then took longer."""
        if self._process is None:
            return
        if self._process.poll():
            self._errors.seek(0)
            _log.warning(
                "the law was translated by one process, since the second one ended with %d: %s",
                self._process.returncode,
                self._errors.read().decode(errors="replace").strip()[-500:],
            )
        self._process.kill()
        self._process.wait()


def _assist() -> None:
    """Translate small entries, then the parts with the argument `t`, in reverse order."""
    from numba import types

    for entry in reversed(ENTRIES):
        if entry is not osc_law_rows:
            _translated(entry)
    of_bytes = types.Array(types.uint8, 1, "C")
    row = records.row_of.unit.translated((of_bytes, types.int64, types.int64))
    jit.UNITS.translate_from_the_end("t", row.returned)


def _link(folder: Path) -> None:
    """Link the library from the object file in a folder.

    Args:
        folder: folder with the object file, in which the library is made.

    Raises:
        OscContactError: the C compiler fails.
    """
    source = Path(__file__).with_name("extension.c")
    command = [library.COMPILER, "-O2", "-shared", "-fPIC"]
    command += [f"-I{library.HEADERS}", f"-I{np.get_include()}"]
    command += [f'-DLAW="{library.law_hash()}"', str(source), str(folder / library.OBJECT)]
    command += ["-lm", "-o", str(folder / library.LIBRARY)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        raise OscContactError(f"the C compiler cannot build the law: {done.stderr.strip()[-500:]}")


if __name__ == "__main__":  # with the arguments PLATFORM FILE: only law.o, for that platform
    report_to(print)
    if sys.argv[1:] == ["assist"]:
        _assist()
    elif len(sys.argv) == 3:
        with announced() as show:
            Path(sys.argv[2]).write_bytes(_object(show, sys.argv[1]))
    elif jit.HAS_LIBRARY:
        print(f"the compiled law: {jit.the_library().__file__}")
