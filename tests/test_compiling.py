"""Compilation of the law: values that parts read, ways of compiling, and their agreement."""

import ast
import io
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np
from processes import python
from pytest import mark, param
from rich.console import Console
from samples import parametrize

import osc_contact as osc
from osc_contact.lab.cli import console
from osc_contact.law import c_object, nested, records

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

# A contact of 10 N whose reading is 0.7 N in every second tick, with limits that name it soon.
def hops(count):
    case = ALL_CASES["one_panda"]()
    safety = osc.SafetySettings.motors_only(hop_share=1e-4, hop_rate=0.1, stop_after=count + 1)
    made = dict(dt=1e-3, posture=case.posture, safety=safety)
    controller = osc.Controller(case.chain, case.pairs, case.gains, **made)
    for k in range(count):
        wrenches = case.measurement.wrenches * (1.0 if k % 2 == 0 else -1.5)  # 9.9 N, 0.7 N
        tau = controller.tick(replace(case.measurement, wrenches=wrenches), case.reference)
        yield " ".join(["hops", controller.status.name, *(float(x).hex() for x in tau)])

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
    yield from hops(8)
    for name in osc.list_scenarios():
        yield recorded(name, duration)

if __name__ == "__main__":
    print(*lines(float(sys.argv[1])), sep="\\n")
"""


RECORDS = {
    name: x if isinstance(x, np.dtype) else x.dtype
    for name, x in vars(records).items()
    if isinstance(x, np.dtype | nested.Nested)
}


@parametrize("name", RECORDS)
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


@parametrize(
    "other, duration",
    [
        ({"NUMBA_DISABLE_JIT": "1"}, 0.003),
        param({"NUMBA_DISABLE_JIT": "1"}, 0.25, marks=mark.slow),
        param(
            {"NUMBA_DISABLE_JIT": "0", "OSC_CONTACT_LAW": "jit", "NUMBA_OPT": "1"},
            0.25,
            marks=mark.slow,
        ),
        param({"NUMBA_DISABLE_JIT": "0", "OSC_CONTACT_LAW": "quick"}, 0.25),
    ],
    ids=["plain", "plain for longer", "jit", "quick"],
)
def test_torques_are_equal_to_the_bit_however_the_law_is_compiled(tmp_path, other, duration):
    """Compare the law as plain Python, by numba in its usual way, and function by function.

    LLVM does not reorder sums at any level; the lower one compiles in two thirds of the time.
    """
    environment = {"NUMBA_CACHE_DIR": str(tmp_path), **other}
    done = python("-c", WAYS, duration, **environment)
    space = {"__name__": "ways"}
    exec(WAYS, space)
    expected = list(space["lines"](duration))
    assert done.stdout.splitlines() == expected
    assert {status.name for status in osc.Status} <= {line.split()[1] for line in expected}


def compiling(program, folder, **changes):
    """A program in which no library of the law is ready."""
    env = {"NUMBA_DISABLE_JIT": "0", "OSC_CONTACT_LAW": "", **changes}
    return python("-c", program, OSC_CONTACT_CACHE=str(folder), **env)


OTHER_NUMBA = """
from numba.core.codegen import CPUCodeLibrary as Library
kept = Library._get_module_for_linking
del Library._get_module_for_linking
import osc_contact.law.jit
Library._get_module_for_linking = kept
"""
OTHER_ARRAYS = """
from numba.np import arrayobj
kept = arrayobj.populate_array
del arrayobj.populate_array
import osc_contact.law.jit
arrayobj.populate_array = kept
"""
#: Compiled functions: one of numbers; one that reads a record's table of two sizes.
SQUARE = """
import numpy as np
from osc_contact.law import jit
from osc_contact.law.nested import Nested
kind = Nested(np.dtype([("a", float)]), table=("rows", 3))
raw = kind.new({"rows": 2})
kind.table(raw, raw.view(np.int64), "table")[1, 2] = 5.0
at = kind.at
found = jit.inner(lambda raw: at(raw, 0).table[1, 2] + at(raw, 0).table.shape[0])(raw)
print(jit.UNITS, jit.inner(lambda x: x * x)(3), found)
"""


@parametrize(
    "before, changes",
    [
        (OTHER_NUMBA, {}),
        (OTHER_ARRAYS, {}),
        ("", {"CC": "no-such-compiler"}),
        ("", {"OSC_CONTACT_LAW": "jit"}),
    ],
    ids=["other numba", "other arrays", "no compiler", "requested"],
)
def test_what_lacks_for_a_library_is_reported_and_numba_compiles_as_always(
    before, changes, tmp_path
):
    """At once, not at the first compilation, where nothing would catch it."""
    out = compiling(before + SQUARE, tmp_path, **changes)
    assert out.stdout.split() == ["None", "9", "7.0"], out.stderr
    assert ("longer to compile" in out.stderr) == ("OSC_CONTACT_LAW" not in changes)


PARTS = """
from numba import types
from osc_contact.law.jit import UNITS
shares = []
UNITS.watchers[:] = [lambda share, kept: shares.append(share)]
first = UNITS.called(UNITS.Unit(lambda x: 2.0 * x, False))
UNITS.Unit(lambda x: first(x) + first(3), False).translated((types.int64,))
print(*shares)
"""


def test_progress_rises_with_the_parts_translated(tmp_path):
    """One translation of a part serves whole numbers and constants."""
    out = compiling(PARTS, tmp_path)
    shares = list(map(float, out.stdout.split()))
    assert len(shares) == 2 and 0.0 < shares[0] < shares[1] <= 1.0, out.stderr


@parametrize("command, said", [("/bin/false", ["ended with 1"]), ("/bin/true", [])])
def test_a_second_process_that_fails_is_logged(command, said, monkeypatch, caplog):
    """It is started with the first parts that are new, and the compilation goes on without it."""
    monkeypatch.setattr(c_object.sys, "executable", command)
    monkeypatch.setattr(c_object, "_cores", lambda: 2)
    with TemporaryFile() as errors, c_object._Assistant(errors) as assistant:
        for _ in range(c_object._MANY_NEW_PARTS):
            assert assistant._process is None
            assistant.start_if_needed(0.1, False)
        assistant._process.wait()
    assert len(caplog.messages) == len(said)
    assert all(one in message for one, message in zip(said, caplog.messages, strict=True))


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
