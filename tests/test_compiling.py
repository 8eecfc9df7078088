"""How parts of the law are compiled: what they read, in which ways, and that all ways agree."""

import ast
import ctypes
import importlib.util
import io
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from pytest import fixture, mark, param
from rich.console import Console

import osc_contact as osc
from osc_contact import console
from osc_contact.law import jit, library, nested, records

READERS = """
import numpy as np
from osc_contact.law.jit import bytes_at, entry, inner, leaf, row_at
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


@inner
def read_all(raw, at, out):
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


@entry
def work(raw, at, out):
    return read_all(raw, at, out)


def work_at(raw, at, out, result):
    row_at(result, 1)[0] = read_all(bytes_at(raw), at, row_at(out, 1))
    return 0
"""

#: torques of ticks that end in every way: OK, near a singular posture, beyond the motors' limits,
#: held for a bad reading or none; three arms, contact phases. Then runs of all packaged scenarios
WAYS = """
import hashlib
import sys
from dataclasses import replace
import numpy as np
import osc_contact as osc
from benchmarks.tick import ALL_CASES

def ticks(name, count):
    case = ALL_CASES[name]()
    controller = case.controller()
    rng = np.random.default_rng(4)
    for k in range(count):
        m = case.measurement
        q = m.q + 1e-4 * rng.normal(size=len(m.q)) * (np.nan if k == 3 else 1.0)
        tau = controller.tick(replace(m, q=q, wrench_valid=k != 5), case.reference)
        yield " ".join([name, controller.status.name, *(float(x).hex() for x in tau)])

def recorded(name, duration):
    found = hashlib.sha256()
    recording = osc.run(osc.load_scenario(name), duration=duration)
    for channel in sorted({*recording.channels} - {"tick_s"}):
        found.update(np.ascontiguousarray(recording[channel]).tobytes())
    return f"{name} {found.hexdigest()}"

CASES = "two_contact_rod one_panda near_singular saturated three_arms contact_phases".split()
def lines(duration):
    for name in CASES:
        yield from ticks(name, 8)
    for name in osc.list_scenarios():
        yield recorded(name, duration)

if __name__ == "__main__":
    print(*lines(float(sys.argv[1])), sep="\\n")
"""


def load(path, name="compiled_somewhere"):
    """The module anew, as another process would see it."""
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Linked:
    """`work` out of an object that units make, linked by a C compiler."""

    def __init__(self, module, units, folder):
        from numba import types

        kinds = types.uintp, types.int64, types.uintp, types.uintp
        code = units.emit({"work": units.Unit(module.work_at, False).translated(kinds)})
        (folder / "work.o").write_bytes(code)
        names = [str(folder / name) for name in ("work.o", "work.so")]
        subprocess.run(["cc", "-shared", names[0], "-lm", "-o", names[1]], check=True)
        self.call = ctypes.CDLL(names[1]).work
        self.call.argtypes = [ctypes.c_void_p] * 3 + [ctypes.c_int64] + [ctypes.c_void_p] * 2

    def __call__(self, raw, at, out):
        found = np.zeros((2, 1))
        result = found[0].view(np.int64).ctypes.data
        error = self.call(result, None, raw.ctypes.data, at, out.ctypes.data, found[1].ctypes.data)
        assert error == 0
        return found[1, 0]


WAYS_TO_COMPILE = {
    "plain": {"NUMBA_DISABLE_JIT": "1"},
    "jit": {"NUMBA_DISABLE_JIT": "0", "OSC_CONTACT_LAW": "jit"},
    "units": {"NUMBA_DISABLE_JIT": "0", "OSC_CONTACT_LAW": ""},
}


@fixture(params=WAYS_TO_COMPILE)
def parts(request, tmp_path, monkeypatch):
    """The module of `READERS` in each way."""
    path = tmp_path / "parts.py"
    path.write_text(READERS)
    for name, value in WAYS_TO_COMPILE[request.param].items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("OSC_CONTACT_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(library, "found", lambda: None)
    package = "osc_contact.law."
    monkeypatch.delitem(sys.modules, package + "nested_type", raising=False)
    for module in (jit, nested):
        made = load(Path(module.__file__), module.__name__)
        monkeypatch.setitem(sys.modules, module.__name__, made)
    own = sys.modules[jit.__name__]
    module = load(path)
    assert (own.PLAIN_PYTHON, own.UNITS is not None) == (
        request.param == "plain",
        request.param == "units",
    )
    assert hasattr(module.work, "signatures") == (request.param == "jit")
    if own.UNITS is not None:
        module.work = Linked(module, own.UNITS, tmp_path)
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
    if hasattr(parts.step, "unit"):
        assert len(parts.step.unit.known) == 1, "and all constants"


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
    "other, duration",
    [
        ({"NUMBA_DISABLE_JIT": "1"}, 0.02),
        param({"NUMBA_DISABLE_JIT": "1"}, 0.25, marks=mark.slow),
        param({"NUMBA_DISABLE_JIT": "0", "OSC_CONTACT_LAW": "jit"}, 0.25, marks=mark.slow),
    ],
    ids=["plain", "plain for longer", "jit"],
)
def test_torques_are_equal_to_the_bit_however_the_law_is_compiled(tmp_path, other, duration):
    """As plain Python, and by numba in its usual way in another process: some minutes.

    LLVM does not reorder sums at any level; the lower one compiles in two thirds of the time.
    """
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "NUMBA_OPT": "1", **other}
    done = subprocess.run(
        [sys.executable, "-c", WAYS, str(duration)],
        capture_output=True,
        text=True,
        timeout=900,
        env=environment,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    space = {"__name__": "ways"}
    exec(WAYS, space)
    want = list(space["lines"](duration))
    assert done.stdout.splitlines() == want
    assert {status.name for status in osc.Status} <= {line.split()[1] for line in want}


ANOTHER_NUMBA = """
import sys
from numba.core import codegen
if sys.argv[1] == "other numba":
    del codegen.CPUCodeLibrary._get_module_for_linking
from osc_contact.law import jit
square = jit.inner(lambda x: x * x)
print(jit.UNITS, square(3) if sys.argv[1] != "other numba" else 9)
"""


@mark.parametrize(
    "changes",
    [{}, {"CC": "no-such-compiler"}, {"OSC_CONTACT_LAW": "jit"}],
    ids=["other numba", "no compiler", "asked for"],
)
def test_what_lacks_for_a_library_is_said_and_numba_compiles_as_it_always_does(
    changes, request, tmp_path
):
    """At once, not at the first compilation, where nothing would catch it."""
    which = request.node.callspec.id
    env = {**os.environ, "NUMBA_DISABLE_JIT": "0", "OSC_CONTACT_LAW": "", **changes}
    env["OSC_CONTACT_CACHE"] = str(tmp_path)
    command = [sys.executable, "-c", ANOTHER_NUMBA, which]
    out = subprocess.run(command, env=env, capture_output=True, text=True)
    assert out.stdout.split() == ["None", "9"], out.stderr
    assert ("longer to compile" in out.stderr) == (which != "asked for")


def test_progress_rises_with_the_parts_translated(parts):
    units = sys.modules[jit.__name__].UNITS
    if units is None:
        return
    shares = []
    units.watchers[:] = [shares.append]
    from numba import types

    @units.called
    @lambda function: units.Unit(function, False)
    def first(x):
        return 2.0 * x

    second = units.Unit(lambda x: first(x) + 1.0, False)
    second.translated((types.float64,))
    units.watchers.clear()
    assert len(shares) == 2 and 0.0 < shares[0] < shares[1] <= 1.0


def test_the_bar_of_the_commands_ends_with_the_compilation(monkeypatch):
    text = io.StringIO()
    monkeypatch.setattr(console, "err", Console(file=text, force_terminal=True, width=80))
    bar = console.CompilationBar()
    for share in (0.1, 0.5, 1.0):
        bar(share)
    assert "compiling" in text.getvalue() and bar._bar is None
    bar(1.0)


def test_the_law_has_no_powers_of_what_varies():
    """In plain Python those are `pow`, which rounds a square in another way now and then."""
    powers = [
        f"{path.name}:{node.lineno}"
        for path in sorted(Path(records.__file__).parent.glob("*.py"))
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow)
        if not (isinstance(node.left, ast.Name) and node.left.id.isupper())
    ]
    assert not powers
