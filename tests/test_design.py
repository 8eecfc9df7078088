"""The walks of docs/design.md: each name is in its file, and each function is called on the way."""

import ast
import json
import re

from processes import python
from pytest import fixture, mark
from samples import ROOT

PAGE = (ROOT / "docs/design.md").read_text()
ROW = re.compile(r"\| `([\w/]+\.py)` \| (.+) \|")
NAME = re.compile(r"`([A-Za-z_][\w.]*)`")


def walk(number):
    """Rows of a walk: file, and the names of its step in their order."""
    section = PAGE.partition(f"## Walk {number}: ")[2].partition("\n## ")[0]
    return [(file, NAME.findall(step)) for file, step in ROW.findall(section)]


#: Files whose step is no name in their code: a field of a record, a command.
BY_WORD = {"osc_contact/law/records.py", "paper/__main__.py"}
ROWS = [(number, *row) for number in (1, 2, 3) for row in walk(number)]


def defined(file):
    """Names that a file defines: functions, classes, what classes have, variables, fields."""
    tree = ast.parse((ROOT / file).read_text())
    found = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            for one in node.body:
                if isinstance(one, ast.FunctionDef):
                    found[f"{node.name}.{one.name}"] = "function"
                elif isinstance(one, ast.AnnAssign):
                    found[f"{node.name}.{ast.unparse(one.target)}"] = "field"
            found[node.name] = "class"
        elif isinstance(node, ast.FunctionDef):
            found.setdefault(node.name, "function")
        elif isinstance(node, ast.keyword) and node.arg:
            found.setdefault(node.arg, "field")
    return found


def test_there_are_walks():
    assert [len(walk(number)) > 5 for number in (1, 2, 3)] == [True] * 3


@mark.parametrize("number, file, names", ROWS, ids=lambda x: x if isinstance(x, str) else "")
def test_the_names_of_a_step_are_in_its_file(number, file, names):
    text = (ROOT / file).read_text()
    assert file in BY_WORD or names[0] in defined(file)
    for name in names:
        if name.endswith(".py"):
            assert (ROOT / file).with_name(name).exists() or (ROOT / name).exists()
        else:
            assert name.rpartition(".")[2] in re.findall(r"\w+", text), name


RUN = """
import json, sys
from pathlib import Path
import osc_contact as osc
called = set()
def note(frame, event, argument):
    code = frame.f_code
    if event == "call" and "osc_contact" in code.co_filename:
        called.add((code.co_filename, code.co_qualname))
scenario = ["workcell", ["tare=null"]]
sys.setprofile(note)
recording = osc.run(osc.load_scenario(*scenario), duration=0.02)
recording["alpha_meas"]
rig = osc.build_rig(osc.load_scenario("two_contact_rod"))
controller, read = rig.controller(), rig.plant().measure()
read.q[:] = float("nan")
controller.tick(read, rig.references.at(0.0))
assert "nan" in controller.reason
sys.setprofile(None)
root = Path(osc.__file__).parents[1]
print(json.dumps([[str(Path(file).relative_to(root)), name] for file, name in called]))
"""


@fixture(scope="module")
def called():
    """File and name of every function of the package that a short run calls, in plain Python."""
    done = python("-c", RUN, NUMBA_DISABLE_JIT="1")
    return {(file, name) for file, name in json.loads(done.stdout.splitlines()[-1])}


STEPS = [
    (file, name)
    for number, file, names in ROWS
    for name in names
    if number < 3 and defined(file).get(name) == "function"
]


@mark.parametrize("file, name", STEPS)
def test_a_step_is_taken_in_a_run(file, name, called):
    assert (file, name) in called
