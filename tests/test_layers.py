"""Every door of the package loads only its own layer and what is below it.

`lint-imports` reads import statements. Here doors are opened in an interpreter that has loaded
nothing of the package, and calls of `import_module` and tables of names are read, too.
"""

import ast
import json
import tomllib
from pathlib import Path

from processes import python
from pytest import fixture, mark
from samples import ROOT

import osc_contact as osc

PACKAGE = "osc_contact"
SOURCES = ROOT / PACKAGE
#: Of other software: what the core does without.
NOT_BELOW = {"yaml", "mujoco", "matplotlib", "meshcat", "tornado", "rich", "typer", "PIL"}
#: The doors themselves, and the list of old names.
DOORS = {"__init__", "__main__", "learn", "moved", "robosuite"}


def layers():
    """The layers of the package, the highest first, each a set of rooms."""
    rules = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    (found,) = [one for one in rules["contracts"] if one.get("containers") == [PACKAGE]]
    return [{room.strip(" ()") for room in layer.split("|")} for layer in found["layers"]]


def room_of(module):
    """The room of a module: the first name below the package; empty: the package itself."""
    return module.removeprefix(PACKAGE).lstrip(".").partition(".")[0]


def allowed(room):
    """The rooms that modules of a room may load: its own and those of lower layers."""
    found = layers()
    (height,) = [i for i, layer in enumerate(found) if room in layer]
    return {room, ""}.union(*found[height + 1 :])


HOMES = sorted(
    {*osc._module_of_each_name().values(), f"{PACKAGE}.drivers.franka", f"{PACKAGE}.testing"}
)
#: Opens each door in a process of its own, which has loaded other software only.
OPEN = """
import json, os, sys
import numpy, pinocchio, pydantic
assert not [name for name in sys.modules if name.partition(".")[0] == "osc_contact"]
for door in {doors!r}:
    end, begin = os.pipe()
    if (child := os.fork()) == 0:
        __import__(door)
        os.write(begin, json.dumps(sorted(sys.modules)).encode())
        os._exit(0)
    os.close(begin)
    with open(end) as answer:
        print(answer.read())
    assert os.waitpid(child, 0)[1] == 0, door
"""


@fixture(scope="module", autouse=True)
def library():
    """The compiled law: where it is made first, numba is loaded, and YAML by numba."""
    python("-m", "osc_contact.law.c_object")


@fixture(scope="module")
def loaded():
    """Names of the modules that each door loads."""
    lines = python("-c", OPEN.format(doors=HOMES)).stdout.splitlines()
    return dict(zip(HOMES, map(json.loads, lines), strict=True))


def behind(modules):
    """Rooms of the package among modules, and other software that the core does without."""
    ours = {room_of(name) for name in modules if name.partition(".")[0] == PACKAGE}
    return ours, NOT_BELOW & {name.partition(".")[0] for name in modules}


@mark.parametrize("door", HOMES)
def test_a_door_loads_its_layer_and_those_below(door, loaded):
    rooms, others = behind(loaded[door])
    room = room_of(door)
    assert room in rooms
    assert rooms - allowed(room) - {"moved"} == set()
    assert room == "lab" or not others


CONTACT = """
import numpy as np, pinocchio as pin, osc_contact as osc
pair = osc.VertexOnFace([0, 0, 0], [0, 0, 0], [0, 0, 1])
assert pair.contact(pin.SE3.Identity(), np.zeros(6)).r == 1
"""
TICK = """
import numpy as np, pinocchio as pin, osc_contact as osc
from osc_contact import robots
arm = osc.Arm.from_urdf(
    robots.find_robot("panda")[0], name="panda", tip="panda_hand_tcp", wrist_sensor="panda_link7"
)
q = np.array([0.0, 0.1, 0.0, -2.2, 0.0, 2.3, 0.8])
chain = osc.ClosedChain([arm], payload=osc.RigidObject(pin.Inertia.FromSphere(0.3, 0.02)))
X = chain.state(q).X_WO
wall = osc.VertexOnFace([0, 0, 0], X.translation - [0, 0, 0.02], [0, 0, 1], radius=0.02)
controller = osc.Controller(chain, [wall], dt=1e-3, posture=q)
measured = osc.Measurement(q, np.zeros(7), np.zeros((1, 6)))
"""
ONE_TICK = f"{TICK}controller.tick(measured, osc.Reference(X, alpha_d=[2.0]))\n"
LOOP = f"""{TICK}
class Standing:
    def measure(self):
        return measured
    def command(self, tau, duration):
        pass
    def stop(self, reason=""):
        pass
recorder = osc.Recorder(controller)
references = [osc.Reference(X, alpha_d=[2.0])] * 3
osc.run_loop(Standing(), controller, references, recorder=recorder, check=False)
assert len(recorder.recording()["status"]) == 3
"""
USES = {"contacts": CONTACT, "control": ONE_TICK, "loop": LOOP}


@mark.parametrize("room", USES)
def test_a_first_use_loads_no_more_than_the_layer(room):
    done = python("-c", f"{USES[room]}import sys; print(*sys.modules)")
    rooms, others = behind(done.stdout.split())
    assert room in rooms
    assert rooms - allowed(room) - {"moved"} == set()
    assert not others


SCENARIO = """
import osc_contact as osc
stage = "{name: press, forces: {edge: 5 N}, until: {after: 0.1 s}, within: 1 s}"
scenario = osc.load_scenario("panda_edge", ["force={}", "motion=[]", f"plan={{stages: [{stage}]}}"])
assert scenario.plan.made().contacts == ("edge",)
"""
#: What runs a scenario, and is not needed to read one: rooms, and modules of rooms.
RUNS = {"loop", "control.controller", "dynamics.closed_chain", "law.tick", "lab.rig", "lab.plants"}


def test_a_scenario_with_a_plan_is_read_without_what_runs_it():
    loaded = python("-c", f"{SCENARIO}import sys; print(*sys.modules)").stdout.split()
    assert f"{PACKAGE}.plan.plan" in loaded
    assert {f"{PACKAGE}.{name}" for name in RUNS} & set(loaded) == set()


# --- what only a reader sees ----------------------------------------------------------------------


def docstrings(tree):
    """The nodes of docstrings, and of strings that stand alone: no names are read from these."""
    return {id(one.value) for one in ast.walk(tree) if isinstance(one, ast.Expr)}


def names_in(source, module):
    """Names of modules that a source refers to: imports anywhere, import_module, strings.

    Args:
        source: text of the module.
        module: its name, below which relative names are.
    """
    tree = ast.parse(source)
    silent = docstrings(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = module.rsplit(".", node.level)[0] + "." if node.level else ""
            base = f"{above}{node.module or ''}".strip(".")
            yield from (f"{base}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            if id(node) not in silent:
                yield node.value
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            text = ast.unparse(node.args[0])
            if not any(own in text for own in ("__name__", "__package__")):
                yield node.args[0].value if isinstance(node.args[0], ast.Constant) else "computed"


def upward(source, module, lab):
    """Of the names in a source, those of the lab, and computed ones, which may be anything.

    Args:
        source: text of the module.
        module: its name.
        lab: names of all modules of the lab.
    """
    found = []
    for name in names_in(source, module):
        short = name.removeprefix(f"{PACKAGE}.")
        if name == "computed" or any(part in lab for part in (short, short.rpartition(".")[0])):
            found.append(name)
    return found


def modules_of(folder):
    """Name below the package of each module in a folder, and its file."""
    for path in sorted(folder.rglob("*.py")):
        parts = path.relative_to(SOURCES).with_suffix("").parts
        yield ".".join(part for part in parts if part != "__init__"), path


LAB = {name for name, _ in modules_of(SOURCES / "lab")}
CORE = {
    name: path
    for name, path in modules_of(SOURCES)
    if name.partition(".")[0] not in DOORS | {"lab", ""}
}


@mark.parametrize("module", CORE)
def test_no_name_of_the_lab_stands_in_the_core(module):
    path = Path(CORE[module])
    inside = f"{PACKAGE}.{module}" + (".__init__" if path.stem == "__init__" else "")
    assert upward(path.read_text(), inside, LAB) == []


@mark.parametrize(
    "source, found",
    [
        ("from osc_contact.lab.rig.rig import Rig", ["osc_contact.lab.rig.rig.Rig"]),
        ("import osc_contact.lab", ["osc_contact.lab"]),
        ("def f():\n    from ..lab import plants", ["osc_contact.lab.plants"]),
        ("if TYPE_CHECKING:\n    from ..lab.rig import rig", ["osc_contact.lab.rig.rig"]),
        ("import_module('osc_contact.lab.rig')", ["osc_contact.lab.rig"] * 2),
        ("importlib.import_module(f'osc_contact.{room}')", ["computed"]),
        ("LATER = {'Rig': 'lab.rig.rig'}", ["lab.rig.rig"]),
        ("import_module(f'{__package__}.units')", []),
        ("'''See `lab.rig.rig`.'''\nfrom osc_contact.spatial import norm", []),
    ],
)
def test_a_name_of_the_lab_is_found(source, found):
    assert upward(source, "osc_contact.loop.loop", LAB) == found
