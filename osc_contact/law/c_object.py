"""The compiled law as an object file for C: entries that take addresses and whole numbers.

By the calling convention of `units` a C program declares them as

    int32_t name(int64_t *result, void **unused, uintptr_t or int64_t …)

Sizes of arrays are those of MODEL; nobody checks them here.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import zlib
from contextlib import suppress
from pathlib import Path

from osc_contact.errors import OscContactError
from osc_contact.files import whole_file
from osc_contact.law import jit, limits, ready, terms, tick
from osc_contact.law.compiled import announced
from osc_contact.law.jit import bytes_at, inner, row_at, table_at, words_at
from osc_contact.law.limits import PROGRAM
from osc_contact.law.records import JOB, MODEL
from osc_contact.law.sources import law_hash

_job = JOB.at
_model = MODEL.at
_program = PROGRAM.at

_rows, _terms, _prepare, _finish, _fill, _settle = (
    inner(part.__wrapped__)
    for part in (
        tick.rows,
        terms.operational_space,
        limits.prepare,
        limits.finish,
        limits.fill_program,
        limits.settle,
    )
)


def osc_law_rows(raw, at, q, v, wrenches, X_WD, V_D, A_D, alpha_d, touched):
    """`tick.rows` of one controller.

    Args:
        raw, q, v, wrenches, X_WD, V_D, A_D, alpha_d, touched: addresses; `touched` counts where the
            JOB says MOVING. at: where the JOB is.
    """
    data = bytes_at(raw)
    job = _job(data, at)
    head = _model(data, job.model)
    moving = job.switches & tick.MOVING != 0
    return _rows(
        data,
        at,
        row_at(q, head.n_joints),
        row_at(v, head.n_joints),
        table_at(wrenches, head.n_arms, 6),
        table_at(X_WD, 4, 4),
        row_at(V_D, 6),
        row_at(A_D, 6),
        row_at(alpha_d, head.n_columns),
        table_at(touched, head.n_contacts if moving else 0, 28),
    )


def osc_law_many(raw, at, q, v, wrenches, X_WD, V_D, A_D, alpha_d, touched, sizes):
    """`tick.rows` of any arrays.

    Args:
        raw, q, v, wrenches, X_WD, V_D, A_D, alpha_d, touched: addresses. at: where the JOB is.
        sizes: address of the number of bytes, elements or rows of each array.
    """
    n = words_at(sizes, 9)
    return _rows(
        bytes_at(raw),
        at,
        row_at(q, n[1]),
        row_at(v, n[2]),
        table_at(wrenches, n[3], 6),
        table_at(X_WD, n[4], 4),
        row_at(V_D, n[5]),
        row_at(A_D, n[6]),
        row_at(alpha_d, n[7]),
        table_at(touched, n[8], 28),
    )


def osc_law_terms(raw, q, v, out, sizes):
    """`terms.operational_space`.

    Args:
        raw, q, v, out: addresses. sizes: address of the columns of `out`, then the number of
            elements or rows of each.
    """
    n = words_at(sizes, 4)
    return _terms(bytes_at(raw), row_at(q, n[1]), row_at(v, n[2]), table_at(out, n[3], n[0]))


def osc_law_fill(raw, at, i, program):
    """`limits.fill_program`; returns k, how many forces must not pull.

    Args:
        raw, program: addresses. at, i: as there.
    """
    data = bytes_at(program)
    _fill(bytes_at(raw), at, i, data)
    return _program(data, 0).k


def osc_law_prepare(program, slack):
    """`limits.prepare`.

    Args:
        program: address. slack: as there.
    """
    return 1 if _prepare(bytes_at(program), slack) else 0


def osc_law_finish(program, slack):
    """`limits.finish`.

    Args:
        program: address. slack: as there.
    """
    return 1 if _finish(bytes_at(program), slack) else 0


def osc_law_settle(raw, at, i, program):
    """`limits.settle`.

    Args:
        raw, program: addresses. at, i: as there.
    """
    _settle(bytes_at(raw), at, i, bytes_at(program))
    return 0


#: Arguments of each: p address, i whole number.
ENTRIES = {
    osc_law_rows: "pipppppppp",
    osc_law_many: "pippppppppp",
    osc_law_terms: "ppppp",
    osc_law_fill: "piip",
    osc_law_prepare: "pi",
    osc_law_finish: "pi",
    osc_law_settle: "piip",
}


def object_file() -> bytes:
    """Of all entries, for every processor of this platform; made once, then cached.

    Raises:
        OscContactError: nothing is compiled here, or not in units.
    """
    if jit.READY is not None:
        return Path(jit.READY.__file__).with_name(ready.OBJECT).read_bytes()
    if jit._units is None:
        raise OscContactError(
            "the law is not compiled to objects here: see the log, or set neither "
            "NUMBA_DISABLE_JIT nor OSC_CONTACT_UNITS"
        )
    units = jit._units
    folder = tick.rows._cache.cache_path  # None: nothing is cached here
    path = folder and Path(folder) / f"law-{units.baseline()}-{law_hash()[:16]}.o"
    code = _kept(path) if path else b""
    if code:
        return code
    from numba import types

    kinds = {"p": types.uintp, "i": types.int64}
    with announced(tick.rows):
        roots = {
            entry.__name__: units.Unit(entry, False).translated(tuple(kinds[one] for one in given))
            for entry, given in ENTRIES.items()
        }
        code = units.emit(roots, units.baseline())
    if path:
        with suppress(OSError), whole_file(path) as unfinished:
            unfinished.write_bytes(zlib.crc32(code).to_bytes(4, "little") + code)
    return code


def _kept(path: Path) -> bytes:
    """The content of a file behind its checksum; nothing where it is damaged or not there."""
    with suppress(OSError):
        content = path.read_bytes()
        if zlib.crc32(content[4:]).to_bytes(4, "little") == content[:4]:
            return content[4:]
    return b""


def build(folder: Path) -> None:
    """Make the library of `ready`, and the object beside it.

    Args:
        folder: where.

    Raises:
        OscContactError: there is no C compiler, or it has no headers of Python.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / ready.OBJECT).write_bytes(object_file())
    source = Path(__file__).with_name("extension.c")
    include = sysconfig.get_paths()["include"]
    compiler = os.environ.get("CC", "cc")
    command = [compiler, "-O2", "-shared", "-fPIC", f"-I{include}", f'-DLAW="{law_hash()}"']
    command += [str(source), str(folder / ready.OBJECT), "-lm", "-o", str(folder / ready.LIBRARY)]
    try:
        done = subprocess.run(command, capture_output=True, text=True)
    except OSError as error:
        raise OscContactError(f"no C compiler: {error}") from error
    if done.returncode != 0:
        raise OscContactError(f"{compiler} cannot build the law: {done.stderr.strip()[-500:]}")


if __name__ == "__main__":  # with OSC_CONTACT_LAW=jit where there is a library already
    build(Path(sys.argv[1]))
