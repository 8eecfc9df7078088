"""Type checkers accept every program of the docs and every example: numbers in, arrays out.

As a user's own programs: `mypy --strict` and pyright (basedpyright, whose wheels bring all that it
needs), with the package as it is installed, and without plugins. Pinocchio with its collision
library coal and MuJoCo have no types.
"""

import doctest
import json
import re
import subprocess
import sys
from pathlib import Path

from samples import ROOT, module_fixture
from test_docs import programs

import osc_contact as osc

UNTYPED = ("pinocchio", "coal", "mujoco")

#: What constructors take and give; the marked lines are mistakes, which must stay ones.
TAKEN = """
import numpy as np
import osc_contact as osc
import pinocchio as pin
from numpy.typing import NDArray

face = osc.VertexOnFace([0, 0, 0], point=[0.5, 0, 0.2], normal=(0, 0, 1), radius=0.01)
normal: NDArray[np.float64] = face.normal
hinge = osc.Revolute([0, 0, 0], axis=(0, 0, 1))
axis: NDArray[np.float64] = hinge.axis
rail = osc.Rail([1, 0, 0], inertia=20.0)
direction: NDArray[np.float64] = rail.direction
edges = osc.EdgeOnEdge([0, 0, 0], [1, 0, 0], [0, 0, 0], [0, 1, 0], edge_outward=[0, 0, 1])
reference = osc.Reference(pin.SE3.Identity(), V_D=[0.0] * 6, alpha_d=[5.0])
matrix = osc.Reference(np.eye(4), alpha_d=5.0)
forces: tuple[int, ...] = reference.alpha_d.shape
read = osc.Measurement([0.0], np.zeros(1, np.float32), [[0.0] * 6])
gains = osc.Gains(osc.MotionGains(400.0, 40.0), osc.ForceGains(bandwidth=5.0))
stiffness: float = gains.motion.stiffness
text = osc.VertexOnFace([0, 0, 0], [0, 0, 0], [0, 0, 1], radius="10 mm")  # mistake
reference.alpha_d = np.ones(1)  # mistake
osc.Reference(pin.SE3.Identity(), alpha_d=None)  # mistake
osc.Gains(osc.ForceGains(bandwidth=5.0))  # mistake
osc.MotionGains(frequncy=3.0)  # mistake
"""

#: `benchmarks`, which a page imports, is no part of what is installed.
CONFIG = f"""[mypy]
strict = true
mypy_path = beside
[mypy-benchmarks.*]
follow_imports = silent
[mypy-{",".join(f"{name}.*" for name in UNTYPED)}]
ignore_missing_imports = true
"""


def example_of(name):
    """The program of the example in a class's description."""
    pieces = doctest.DocTestParser().get_examples(getattr(osc, name).__doc__)
    head = ("numpy as np", "osc_contact as osc", "pinocchio as pin")
    return "".join([*(f"import {one}\n" for one in head), *(piece.source for piece in pieces)])


@module_fixture
def folder(tmp_path_factory):
    """Programs of the docs, the examples and `TAKEN`, a file each."""
    made = tmp_path_factory.mktemp("programs")
    (made / "taken.py").write_text(TAKEN)
    for number, program in enumerate(programs()):
        page, code, _ = program.values
        (made / f"{page.stem}_{number}.py").write_text(code)
    for name in osc.__all__:
        if name[0].isupper():
            (made / f"example_{name}.py").write_text(example_of(name))
    return made


def run(*words, cwd):
    return subprocess.run(words, cwd=cwd, capture_output=True, text=True).stdout


def mypy(folder):
    """(file, line, message) of every complaint."""
    (folder / "mypy.ini").write_text(CONFIG)
    (folder / "beside").mkdir()
    (folder / "beside" / "benchmarks").symlink_to(ROOT / "benchmarks")
    files = [path.name for path in sorted(folder.glob("*.py"))]
    how = ("--config-file", "mypy.ini", "--hide-error-context")
    printed = run(sys.executable, "-m", "mypy", *how, *files, cwd=folder)
    assert re.search(r"^(Success: no issues found|Found \d+ errors) ", printed, re.M), printed
    found = re.findall(r"^(\w+)\.py:(\d+): error: (.*)$", printed, re.M)
    assert len(found) == printed.count(": error: "), printed
    return [(file, int(line), text) for file, line, text in found]


def pyright(folder):
    """Likewise; that a module without types lacks what it has is none."""
    (folder / "pyrightconfig.json").write_text(json.dumps({"typeCheckingMode": "standard"}))
    where = Path(sys.executable).parent / "basedpyright"
    printed = run(where, "--outputjson", "--pythonpath", sys.executable, cwd=folder)
    found = json.loads(printed)["generalDiagnostics"]
    lacks = re.compile(rf'"\w+" is not a known attribute of module "({"|".join(UNTYPED)})"')
    return [
        (Path(one["file"]).stem, one["range"]["start"]["line"] + 1, one["message"])
        for one in found
        if not lacks.fullmatch(one["message"])
    ]


@module_fixture
def complaints(folder):
    """Messages of each type checker."""
    return {checker.__name__: checker(folder) for checker in (mypy, pyright)}


def test_documented_programs_and_examples_pass(complaints):
    found = {
        checker: [one for one in all_of_it if one[0] != "taken"]
        for checker, all_of_it in complaints.items()
    }
    assert found == {"mypy": [], "pyright": []}


def test_numbers_of_any_kind_go_in_and_arrays_come_out(complaints):
    mistakes = [k for k, line in enumerate(TAKEN.splitlines(), 1) if line.endswith("# mistake")]
    for checker, all_of_it in complaints.items():
        found = {line: text for file, line, text in all_of_it if file == "taken"}
        assert sorted(found) == mistakes, (checker, found)
