"""The benchmark of compilation times what it says, and edits what it says."""

import ast
from pathlib import Path
from time import perf_counter

import pytest

import osc_contact
from benchmarks.compilation import NotCompiledError, edits, timed_python

LAW = Path(osc_contact.__file__).parent / "law"
#: A child burns half a second of the processor, then its parent sleeps as long.
BURNS = (
    "import subprocess, sys, time\n"
    "burn = 'from time import process_time as t\\nwhile t() < 0.5: pass'\n"
    "subprocess.run([sys.executable, '-c', burn])\n"
    "time.sleep(0.5)"
)


def products(source, name):
    """The products of a function, each as written."""
    return [
        ast.unparse(one)
        for function in ast.walk(ast.parse(source))
        if isinstance(function, ast.FunctionDef) and function.name == name
        for one in ast.walk(function)
        if isinstance(one, ast.BinOp) and isinstance(one.op, ast.Mult)
    ]


def test_an_edit_changes_one_product_of_one_function():
    found = list(edits(LAW))
    functions = [(file.name, name) for file, name, _ in found]
    assert len(set(functions)) == len(functions) > 50
    assert functions != sorted(functions)
    for file, name, edited in found:
        usual = file.read_text()
        new = [one for one in products(edited, name) if one not in products(usual, name)]
        assert any(one.startswith("1.5 * ") for one in new), name
        assert len(edited) == len(usual) + len("(1.5 * ())"), name


def test_children_count_as_processor_time_and_waiting_does_not(tmp_path):
    began = perf_counter()
    times = timed_python(("-c", BURNS), tmp_path, str(tmp_path))
    assert 1.0 <= times["clock (s)"] <= perf_counter() - began
    assert times["processor (s)"] >= 0.5
    times = timed_python(("-c", "import time; time.sleep(1.0)"), tmp_path, str(tmp_path))
    assert times["processor (s)"] < 0.5 <= times["clock (s)"]


def test_cores_and_cache_are_those_that_were_given(tmp_path):
    program = (
        "import os; assert os.environ['OSC_CONTACT_CACHE'] == 'a folder'; "
        "assert os.sched_getaffinity(0) == {0}"
    )
    timed_python(("-c", program), tmp_path, "a folder", {0})
    with pytest.raises(NotCompiledError, match="AssertionError"):
        timed_python(("-c", program), tmp_path, "another", {0})
