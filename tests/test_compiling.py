"""How the law is compiled: what its readers read, what is said meanwhile, and with public numba."""

import gc
import importlib.util
import io
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from numba import config
from pytest import fixture, mark, param
from rich.console import Console

import osc_contact as osc
from osc_contact import console
from osc_contact.law import jit, nested, records
from osc_contact.law import tick as law
from osc_contact.law.compiled import announced, parts_of, report_to

PLAIN = jit.PLAIN_PYTHON

SOURCE = """
from osc_contact.law.jit import entry, inner

@inner
def twice(x):
    return 2 * x

@entry
def kernel(x):
    return twice(x) + 1
"""

READERS = """
import numpy as np
from osc_contact.law.jit import entry, inner, leaf
from osc_contact.law.nested import Nested

HEAD = np.dtype(
    [("count", np.int64), ("mass", np.float64), ("axes", np.float64, (2, 3))], align=True
)
ROW = np.dtype([("motor", np.int64), ("force", np.float64, (3,))], align=True)
RECORD = Nested(
    HEAD, rows=(ROW, "n"), chosen=(np.int64, 2), flat=(np.float64, 6), A=(np.float64, "n", "m"),
)
record_at = RECORD.at


@leaf
def total(x):
    s = 0.0
    for i in range(x.size):
        s += x[i]
    return s


@inner
def scale(x, factor):
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            x[i, j] *= factor


@inner
def step(at, by):
    return at + by


@inner
def walk(count):
    at = 0
    for i in range(count):
        at = step(at, 2) if i else step(at, 1)
    return at


@entry
def work(raw, at, out):
    head = record_at(raw, at)
    rows, flat, A = head.rows, head.flat, head.A
    for i in range(head.count):
        rows[i].force[1] += total(rows[i].force) * head.mass
        rows[i].motor += 10
    scale(head.axes, 2.0)
    head.axes[1, 2] = rows.shape[0]
    A[A.shape[0] - 1, A.shape[1] - 1] = -flat[5]
    head.chosen[1] = walk(4) + head.chosen[0]
    out[0] = 1.0 / (head.mass - head.mass)  # as C does it, not as Python
    return A[0, 1]
"""

#: torques of ticks that end in every way: OK, near a singular posture, beyond the motors' limits,
#: held for a bad reading or none; three arms, contact phases
WAYS = """
import sys
from dataclasses import replace
import numpy as np
from benchmarks.tick import ALL_CASES

def ticks(names, count):
    for name in names:
        case = ALL_CASES[name]()
        controller = case.controller()
        rng = np.random.default_rng(4)
        for k in range(count):
            m = case.measurement
            q = m.q + 1e-4 * rng.normal(size=len(m.q)) * (np.nan if k == 3 else 1.0)
            m = replace(m, q=q, wrench_valid=k != 5)
            tau = controller.tick(m, case.reference)
            yield " ".join([name, controller.status.name, *(float(x).hex() for x in tau)])

NAMES = "two_contact_rod one_panda near_singular saturated three_arms contact_phases".split()
if __name__ == "__main__":
    print(*ticks(NAMES, 8), sep="\\n")
"""


def load(path):
    """The module anew, as another process would see it."""
    spec = importlib.util.spec_from_file_location("compiled_somewhere", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_collections_are_as_usual_when_the_last_of_two_threads_has_compiled():
    usual = gc.get_threshold()
    one = announced()
    other = announced()
    try:
        one.__enter__()
        gc.set_threshold(50_000, 20, 100)  # as a compilation does
        other.__enter__()
        one.__exit__(None, None, None)
        assert gc.get_threshold() == (50_000, 20, 100)  # the other may still compile
        other.__exit__(None, None, None)
        assert gc.get_threshold() == usual
    finally:
        gc.set_threshold(*usual)


def test_compiling_is_announced_once_and_loading_is_not(tmp_path):
    path = tmp_path / "kernel.py"
    told = []
    earlier = []
    path.write_text(SOURCE)
    report_to(earlier.append)
    report_to(told.append)
    try:
        first = load(path)
        second = load(path)
        with announced():
            assert first.kernel(3) == 7
        if getattr(config, "DISABLE_JIT"):  # noqa: B009 - set at run time
            assert not told
            return
        assert len(told) == 2
        assert told[0].startswith("compiling the control tick") and told[1].startswith("compiled")
        with announced():
            assert second.kernel(3) == 7
            assert first.kernel(5) == 11
        assert len(told) == 2 and not earlier
    finally:
        report_to(lambda text: None)


@fixture(params=["compiled", "plain"])
def parts(request, tmp_path, monkeypatch):
    """The module of `READERS`, compiled and as plain Python."""
    path = tmp_path / "parts.py"
    path.write_text(READERS)
    if request.param == "plain":
        monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
        for module in (jit, nested):
            monkeypatch.setitem(sys.modules, module.__name__, load(Path(module.__file__)))
    module = load(path)
    assert hasattr(module.work, "signatures") == (request.param == "compiled" and not PLAIN)
    return module


def test_parts_of_the_law_read_bytes_as_records_without_a_copy(parts):
    record = parts.RECORD.new({"n": 3, "m": 2})
    gap = np.full(64, 255, np.uint8)
    raw = np.concatenate([gap, record, gap])
    out = np.zeros(1)
    at = len(gap)
    view = parts.RECORD.view(raw[at : at + len(record)])
    view.count = 3
    view.mass = 0.5
    view.axes = np.arange(6.0).reshape(2, 3)
    view.rows["motor"] = [0, 1, 2]
    view.rows["force"] = np.arange(9.0).reshape(3, 3)
    view.chosen[:] = [5, 0]
    view.flat[:] = np.arange(6.0)
    view.A[:] = np.arange(6.0).reshape(3, 2)
    first = raw.copy()
    assert parts.work(raw, at, out) == 1.0
    assert out[0] == np.inf
    assert (raw[:at] == 255).all() and (raw[at + len(record) :] == 255).all()
    assert view.axes.tolist() == [[0, 2, 4], [6, 8, 3]]
    assert view.rows.motor.tolist() == [10, 11, 12]
    assert view.rows.force.tolist() == [[0, 1 + 1.5, 2], [3, 4 + 6.0, 5], [6, 7 + 10.5, 8]]
    assert view.flat.tolist() == [0, 1, 2, 3, 4, 5] and view.chosen.tolist() == [5, 12]
    assert view.A.tolist() == [[0, 1], [2, 3], [4, -5]]
    parts.work(first, np.int64(at), out)
    assert (first == raw).all()
    if hasattr(parts.work, "signatures"):
        assert len(parts.work.signatures) == 1, "one compilation serves all integers"
        assert jit._units is None or len(parts.step.unit.known) == 1, "and all constants"


RECORDS = {
    name: x if isinstance(x, np.dtype) else x.dtype
    for name, x in vars(records).items()
    if isinstance(x, np.dtype | nested.Nested)
}


@mark.parametrize("name", RECORDS)
def test_no_field_of_a_record_is_named_like_an_attribute(name):
    """In plain Python `record.field` finds attributes of `np.recarray` and `np.record` first."""
    taken = set(dir(np.recarray)) | set(dir(np.record))
    fields = RECORDS[name].names
    assert fields and not taken & set(fields)
    record = np.zeros(2, RECORDS[name]).view(np.recarray)
    for field in fields:
        assert np.shares_memory(getattr(record, field), record)
        kind, offset = RECORDS[name].fields[field][:2]
        assert kind.base in (np.int64, np.float64) and offset % 8 == 0


@mark.parametrize(
    "other",
    [
        {"NUMBA_DISABLE_JIT": "1"},
        param({"NUMBA_DISABLE_JIT": "0", "OSC_CONTACT_UNITS": "0"}, marks=mark.slow),
    ],
    ids=["plain", "public"],
)
def test_torques_are_equal_to_the_bit_however_the_law_is_compiled(tmp_path, other):
    """As plain Python, and by public numba in a process that compiles afresh: some minutes.

    LLVM does not reorder sums at any level; the lower one compiles in two thirds of the time.
    """
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "NUMBA_OPT": "1", **other}
    done = subprocess.run(
        [sys.executable, "-c", WAYS], capture_output=True, text=True, timeout=900, env=environment
    )
    assert done.returncode == 0, done.stderr[-3000:]
    space = {"__name__": "ways"}
    exec(WAYS, space)
    want = list(space["ticks"](space["NAMES"], 8))
    assert done.stdout.splitlines() == want
    assert {line.split()[1] for line in want} == {status.name for status in osc.Status}


@mark.parametrize("units", ["1", "0"])
def test_a_numba_with_other_classes_compiles_as_it_always_does(units):
    """And says so at once, not at the first compilation, where nothing would catch it."""
    script = (
        "import sys\n"
        "from numba.core import codegen, compiler\n"
        "if sys.argv[1] == '1': del codegen.CPUCodeLibrary._get_module_for_linking\n"
        "from osc_contact.law import jit\n"
        "square = jit.inner(lambda x: x * x)\n"
        "print(jit._units, square(3) if sys.argv[1] == '0' else 9)"
    )
    env = {**os.environ, "NUMBA_DISABLE_JIT": "0", "OSC_CONTACT_UNITS": units}
    command = [sys.executable, "-c", script, units]
    out = subprocess.run(command, env=env, capture_output=True, text=True)
    assert out.stdout.split() == ["None", "9"], out.stderr
    assert ("longer to compile" in out.stderr) == (units == "1")


def test_progress_rises_with_the_functions_compiled(tmp_path):
    """From 0 to 1, whatever is compiled, and nothing where it comes from the cache."""
    path = tmp_path / "kernel.py"
    shares = []
    path.write_text(SOURCE)
    report_to(lambda text: None, shares.append)
    try:
        first = load(path)
        second = load(path)
        with announced(first.kernel):
            assert first.kernel(3) == 7
        if getattr(config, "DISABLE_JIT"):  # noqa: B009 - set at run time
            assert not shares
            return
        assert shares == sorted(shares) and len(shares) >= 2
        assert 0.0 < shares[0] < 1.0 and shares[-1] == 1.0
        shares.clear()
        with announced(second.kernel):
            assert second.kernel(3) == 7
        assert not shares
    finally:
        report_to(lambda text: None)


def test_the_functions_counted_are_those_of_the_law():
    parts = {part.__qualname__ for part in parts_of(law.rows)}
    assert {"_row", "cholesky", "find_lost", "advance_phases", "guard"} <= parts
    assert not any(name.startswith("test") for name in parts)


def test_the_bar_of_the_commands_ends_with_the_compilation(monkeypatch):
    text = io.StringIO()
    monkeypatch.setattr(console, "err", Console(file=text, force_terminal=True, width=80))
    bar = console.CompilationBar()
    for share in (0.1, 0.5, 1.0):
        bar(share)
    assert "compiling" in text.getvalue() and bar._bar is None
    bar(1.0)
