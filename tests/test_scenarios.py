"""Scenarios: every refusal with its line and cure, overrides, round trip; objects from Python."""

import json
from pathlib import Path

import numpy as np
import yaml
from complaints import scenario_error
from numpy.testing import assert_array_equal
from pytest import raises
from rigs import unit, vector
from samples import ROOT, parametrize
from scenario_runs import assert_same_run, rig_of, run_of

import osc_contact as osc
from osc_contact.dynamics.environment import Conveyor
from osc_contact.lab.scenarios.loader import FILES, load_scenario, parse_scenario
from osc_contact.lab.scenarios.signals import MinimumJerk

GOOD = """\
name: small
arms:
  - name: left
    urdf: arm.urdf
    tip: tool
    posture: [30 deg, 0.1 m]
  - {name: right, urdf: arm.urdf, tip: tool, posture: [0, 0]}
object: {urdf: rod.urdf}
grasps:
  left: {xyz: [15 cm, 0, 0]}
  right: {xyz: [-0.15, 0, 0]}
contacts:
  - name: end
    type: vertex_on_face
    vertex: [0, 0, 0]
    radius: 10 mm
    face: {urdf: face.urdf, point: [0, 0, 0], normal: [0, 0, 2]}
force:
  end:
    - {type: constant, value: 3 N}
motion:
  - kind: angular
    direction: [0, 0, 1]
    signals:
      - {type: sine, amplitude: 5 deg, frequency: 1 Hz}
gains:
  motion: {stiffness: 400, damping: 40}
  force: {integral: 3e1}
control: {rate: 1 kHz}
plant: {type: mujoco, step: 0.25 ms}
duration: 2 s
"""


def complaints(text, overrides=()):
    with raises(osc.ScenarioError) as caught:
        parse_scenario(text, "f.yaml", overrides)
    return str(caught.value).splitlines()


def test_good_file():
    scenario = parse_scenario(GOOD, "some/f.yaml")
    assert scenario.arms[0].posture == (0.5235987755982988, 0.1)
    assert scenario.contacts[0].radius == 0.01
    assert scenario.contacts[0].face.normal == (0.0, 0.0, 1.0)
    assert scenario.grasps["left"].xyz == (0.15, 0.0, 0.0)
    assert scenario.gains.force.integral == 30.0 and scenario.gains.motion.integral == 0.0
    assert scenario.control.metric == "object" and scenario.tare is None
    assert scenario.source == Path("some/f.yaml")
    assert parse_scenario(GOOD).source is None


#: What is put in whose place; key and cure; the line, if not the first that changes.
BAD = {
    "unknown key": ("tip: tool\n", "tpi: tool\n", "arms.left.tpi", "did you mean 'tip'?"),
    "unknown signal key": (
        "{type: constant, value: 3 N}",
        "{type: constant, value: 3 N, stat: 1}",
        "force.end.0.stat",
        "unknown key; known: type, value",
    ),
    "missing key": (
        "    urdf: arm.urdf\n",
        "",
        "arms.left",
        "the key 'urdf' is missing: a packaged URDF",
        3,
    ),
    "missing top key": (
        "control: {rate: 1 kHz}\n",
        "",
        "",
        "the key 'control' is missing: the tick rate",
        1,
    ),
    "wrong unit": (
        "radius: 10 mm",
        "radius: 8 N",
        "contacts.end.radius",
        "expected a length in m, mm, cm, µm; got '8 N', which is a force",
    ),
    "length in angular move": (
        "5 deg",
        "5 mm",
        "motion.0.signals.0.amplitude",
        "expected an angle in rad, mrad, deg",
    ),
    "nan": ("2 s", ".nan", "duration", "got nan, which is not finite"),
    "zero normal": ("[0, 0, 2]", "[0, 0, 0]", "contacts.end.face.normal", "whose length is 0"),
    "tangent of angular move": (
        "direction: [0, 0, 1]",
        "direction: common_tangent",
        "motion.0.direction",
        "common_tangent is a direction of linear moves only; give the axis",
    ),
    "bad direction word": (
        "kind: angular\n    direction: [0, 0, 1]",
        "kind: linear\n    direction: up",
        "motion.0.direction",
        "expected a direction [x, y, z] or common_tangent; got 'up'",
        23,
    ),
    "negative radius": ("10 mm", "-1 mm", "contacts.end.radius", "must be >= 0; got '-1 mm'"),
    "zero rate": ("1 kHz}", "0 Hz}", "control.rate", "must be > 0; got '0 Hz'"),
    "step and period": (
        "0.25 ms",
        "0.3 ms",
        "plant.step",
        "the control period is 3.33333333 plant steps (control.rate 1000 Hz, plant.step 0.0003 s); "
        "it must be a whole number of them, e.g. a step of 0.333333333 ms",
    ),
    "step beyond period": ("0.25 ms", "3 ms", "plant.step", "e.g. a step of 1 ms"),
    "plant type": (
        "mujoco",
        "bullet",
        "plant.type",
        "expected 'mujoco', 'rigid' or 'drake'; got 'bul",
    ),
    "solref length": ("0.25 ms}", "0.25 ms, solref: [1]}", "plant.solref", "item 1 is missing"),
    "solimp": ("0.25 ms}", "0.25 ms, solimp: [0.2, 1, 1]}", "plant.solimp.1", "must be < 1"),
    "model error": (
        "duration: 2 s",
        "model_error: {arm_mass: 0}\nduration: 2 s",
        "model_error.arm_mass",
        "must be > 0",
    ),
    "text for group": ("object: {urdf: rod.urdf}", "object: rod", "object", "a group of keys"),
    "empty list": ("[30 deg, 0.1 m]", "[]", "arms.left.posture", "at least 1 items; got []"),
    "number for text": ("    tip: tool", "    tip: 7", "arms.left.tip", "expected text; got 7"),
    "bad name": ("name: end", "name: my.end", "contacts.my.end.name", "expected a name of"),
    "signal type": (
        "type: constant",
        "type: konstant",
        "force.end.0.type",
        "expected one of 'constant', 'step', 'sine', 'minimum_jerk', "
        "'jerk_limited', 'points'; got 'konstant'",
    ),
    "no signal type": ("{type: constant, value", "{value", "force.end.0", "'type' is missing"),
    "no signals": ("\n    - {type: constant, value: 3 N}", " []", "force.end", "at least 1"),
    "null move": ("motion:\n", "motion:\n  - null\n", "motion.0: expected a group of", "None", 22),
    "kind": ("kind: angular", "kind: spiral", "motion.0.kind", "one of 'linear', 'angular'"),
    "double arm": ("{name: right", "{name: left", "arms.left.name", "'left' is taken"),
    "grasp of nobody": ("  right: {xyz", "  rigth: {xyz", "grasps.rigth", "mean 'right'?"),
    "arm without grasp": (
        "  right: {xyz: [-0.15, 0, 0]}\n",
        "",
        "grasps",
        "arm 'right' has no entry; add right",
        9,
    ),
    "force of nobody": ("\n  end:", "\n  endd:", "force.endd", "did you mean 'end'?", 19),
    "contact without force": (
        "force:\n  end:\n    - {type: constant, value: 3 N}\n",
        "",
        "force",
        "the contact 'end' has no entry; add end: [{type: constant, value: 0 N}]",
        1,
    ),
    "key twice": (
        "    tip: tool\n",
        "    tip: tool\n    tip: hand\n",
        "arms.0.tip",
        "given twice, first in line 5; keep one",
        6,
    ),
    "anchor": ("{rate: 1 kHz}", "&c {rate: 1 kHz}", "&c", "anchors and aliases are refused"),
    "tag": ("tip: tool\n", "tip: !!python/name:os.system tool\n", "tag:", "tags are refused"),
    "tab": ("    tip: tool\n", "\ttip: tool\n", "not valid YAML", "indent with spaces, not"),
    "unclosed": ("{rate: 1 kHz}", "{rate: 1 kHz", "not valid YAML", "expected ',' or '}'", 30),
    "control character": ("rod.urdf", "rod\x07urdf", "not valid YAML", "'\\x07' is not allowed"),
    "two documents": ("name: small", "name: small\n---\nname: x", "not valid YAML", "single", 2),
    "deep": ("2 s", "[" * 5000, "nested deeper", "32 levels"),
}


def test_a_bad_item_is_not_reported_as_a_list_too_short():
    path = ROOT / "tests/scenarios/set_points.yaml"
    for wrong in (
        "force.left_end.0.points=[[0 s, 1 N], [1 s, 2 mm]]",
        "motion.0.signals.0.velocity=3 N/s",
    ):
        with raises(osc.ScenarioError) as caught:
            load_scenario(path, [wrong])
        assert len(str(caught.value).splitlines()) == 1, caught.value


@parametrize("case", BAD)
def test_bad_files_name_line_key_and_cure(case):
    old, new, key, message, *given = BAD[case]
    (line,) = given or [GOOD.count("\n", 0, GOOD.index(old)) + 1]
    found = complaints(GOOD.replace(old, new, 1))
    start = f"f.yaml:{line}: {key}"
    assert any(text.startswith(start) and message in text for text in found), found


def test_alias_is_refused_at_its_line():
    text = GOOD.replace("[0, 0, 0]", "&zero [0, 0, 0]", 1).replace("[0, 0, 1]", "*zero")
    assert [one.split(":")[1] for one in complaints(text)] == ["15", "23"]


@parametrize("text", ["", "# nothing\n", "- a\n- b\n", "just text"])
def test_a_file_without_keys(text):
    assert complaints(text) == [
        "f.yaml:1: expected keys such as name, arms, object; got no group of keys"
    ]


def test_all_complaints_come_at_once_sorted_by_line():
    text = GOOD.replace("2 s", "2 N").replace("radius: 10 mm", "radius: -1")
    text = text.replace("    tip: tool", "    tipp: tool").replace("0.25 ms", "0.3 ms")
    text = text.replace("  right: {xyz", "  rigth: {xyz").replace(
        "damping: 40", "damping: 1\n    ,damping: 2"
    )
    assert [int(one.split(":")[1]) for one in complaints(text)] == [3, 5, 9, 11, 16, 28, 31, 32]


def test_the_period_may_miss_a_whole_multiple_by_rounding_only():
    assert parse_scenario(GOOD.replace("0.25 ms", "1e-4")).plant.step == 1e-4
    parse_scenario(GOOD.replace("0.25 ms", "0.0002500000000000001"))
    assert "plant.step" in complaints(GOOD.replace("0.25 ms", "0.000250000001"))[0]


def test_at_most_eight_arms():
    data = yaml.safe_load(GOOD)
    data["arms"] = [{**data["arms"][1], "name": f"a{k}"} for k in range(9)]
    data["grasps"] = {f"a{k}": {} for k in range(9)}
    assert "arms: expected at most 8 items" in complaints(json.dumps(data))[0]


#: What they do to the file: the text in whose place another one stands.
OVERRIDES = {
    "contacts.end.radius=5 mm": ("radius: 10 mm", "radius: 5 mm"),
    "contacts.0.radius=5 mm": ("radius: 10 mm", "radius: 5 mm"),
    "plant.friction=0.1": ("0.25 ms}", "0.25 ms, friction: 0.1}"),
    "arms.right.posture=[1, 2 mm]": ("[0, 0]", "[1, 2 mm]"),
    "arms.left.posture.1=0.2": ("0.1 m", "0.2"),
    "arms.left.base.xyz=[1, 0, 0]": ("tip: tool\n", "tip: tool\n    base: {xyz: [1, 0, 0]}\n"),
    "model_error.object_mass = 1.1": ("duration", "model_error: {object_mass: 1.1}\nduration"),
    "tare.duration=0.5 s": ("duration", "tare: {duration: 0.5 s}\nduration"),
    "motion=[]": (GOOD[GOOD.index("\n  - kind") : GOOD.index("gains")], " []\n"),
    "plant={type: rigid, step: 1 ms}": ("mujoco, step: 0.25 ms", "rigid, step: 1 ms"),
    "description=a=b": ("name: small", "name: small\ndescription: a=b"),
    "force.end.0.value=7 N": ("3 N", "7 N"),
}


@parametrize("override", OVERRIDES)
def test_overrides(override):
    expected = parse_scenario(GOOD.replace(*OVERRIDES[override], 1))
    assert expected != parse_scenario(GOOD)
    key, _, value = override.partition("=")
    for changes in ([override], {key: value}):
        assert parse_scenario(GOOD, None, changes) == expected


BAD_OVERRIDES = {
    "plant.frction=0.1": "plant.frction: unknown key; did you mean 'friction' or 'joint_friction'?",
    "plnt.friction=0.1": "plnt: unknown key; did you mean 'plant' or 'plan'?",
    "contacts.edn.radius=1": "contacts has no item 'edn'; did you mean 'end'? known: end",
    "contacts.1.radius=1": "contacts has no item '1'; known: end",
    "arms.left.posture.5=1": "arms.left.posture has no item '5'; items are 0 to 1",
    "duration.x=1": "duration is '2 s' and has no keys or items",
    "duration=3 N": "duration: expected a time in s, ms, µs, min; got '3 N', which is a force",
    "duration=": "no value is given; write null to clear a key",
    "duration=[1": "its value:1: not valid YAML",
    "duration=&a 1": "its value:1: &a: anchors and aliases are refused",
    "duration": "expected path.to.key=value",
    "plant..step=1": "the path has an empty part",
    "tare.standof=1 mm": "tare.standof: unknown key; did you mean 'standoff'?",
    "plant={type: rigid, step: 1 N}": "plant.step: expected a time",
    "plant={type: rigid}": "plant: the key 'step' is missing",
    "plant.step=0.3 ms": "plant.step: the control period is 3.33333333 plant steps",
    "name=null": "name: expected text; got None",
}


@parametrize("override, message", BAD_OVERRIDES, ids=BAD_OVERRIDES)
def test_bad_overrides_are_named_instead_of_a_line(override, message):
    found = complaints(GOOD, [override])
    message = message.removeprefix(override.partition("=")[0] + ": ")  # the key is named once
    assert len(found) == 1 and found[0].startswith(f"override {override}: {message}"), found


def test_complaints_about_overrides_follow_those_about_lines():
    found = complaints(GOOD.replace("2 s", "2 N"), ["plant.friction=-1"])
    assert [text.split(":")[0] for text in found] == ["f.yaml", "override plant.friction=-1"]


def test_a_clash_of_two_keys_is_blamed_on_the_overridden_one():
    for override in ("control.rate=3 kHz", "control={rate: 3 kHz}", "plant.step=0.3 ms"):
        (found,) = complaints(GOOD, [override])
        assert found.startswith(f"override {override}: ") and "the control period is" in found


def test_round_trip():
    unlimited = load_scenario("two_contact_rod", ["control.safety.overspeed_time=.inf"])
    for scenario in (parse_scenario(GOOD, "f.yaml"), load_scenario("two_contact_rod"), unlimited):
        data = json.loads(json.dumps(scenario.as_dict(), allow_nan=False))
        assert osc.Scenario.model_validate(data) == scenario
        again = parse_scenario(yaml.safe_dump(data))
        assert again == scenario and again.as_dict() == data
        assert "source" not in data
    assert parse_scenario(GOOD, None, ["duration=3 s"]) != parse_scenario(GOOD)


def test_a_run_without_a_limit_is_recorded_with_it():
    limit = "control.safety.overspeed_time"
    recording = osc.run(load_scenario("two_contact_rod", [f"{limit}=.inf", "duration=0.01 s"]))
    again = osc.Scenario.from_dict(recording.meta["scenario"])
    assert again.control.safety.overspeed_time == np.inf


def test_loading_by_path_and_unknown_names(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(GOOD)
    scenario = load_scenario(path, {"duration": "1 s"})
    assert scenario.source == path and scenario.duration == 1.0
    assert load_scenario(str(path)).duration == 2.0
    with scenario_error("did you mean 'two_contact_rod'"):
        load_scenario("two_contact_rood")
    for bad in (tmp_path / "none.yaml", tmp_path):
        with scenario_error("cannot read the scenario file"):
            load_scenario(bad)
    path.write_bytes(b"name: \xff\xfe")
    with scenario_error("cannot read the scenario file"):
        load_scenario(path)
    path.write_text(GOOD.replace("2 s", "2 N"))
    with scenario_error(r"mine\.yaml:31: duration: expected a time"):
        load_scenario(path)


# Scenarios made in Python: pairs, moving bodies and laws of one's own, on both plants.


PLANTS = ("rigid", "mujoco")


class Ball(osc.SphereOnPlane):
    """Evaluated by Python."""

    def contact(self, *args):
        return super().contact(*args)


def task(plant, name="two_contact_rod"):
    step = {"rigid": "2 ms", "mujoco": "0.25 ms"}[plant]
    changes = (
        f"plant.type={plant}",
        f"plant.step={step}",
        "control.rate=500 Hz",
        "duration=0.04 s",
    )
    return osc.load_scenario(name, changes)


@parametrize("plant", PLANTS)
def test_pairs_of_ones_own(plant):
    plain = task(plant, "scara_peg")
    own = [
        {
            "pair": Ball(p.centre, p.radius, p.face_point, p.face_normal, name=p.name),
            "body": "socket",
        }
        for p in rig_of(plain).pairs
    ]
    ours = run_of(plain.replaced(contacts=own))
    assert_same_run(ours, run_of(plain), 1e-6)
    assert ours.magnitude_names == ["wall_x", "wall_y"] and not ours["status"].any()
    contact = json.loads(json.dumps(ours.meta["scenario"]))["contacts"][0]
    assert contact == {"name": "wall_x", "body": "socket", "pair": "Ball"}


@parametrize("plant", PLANTS)
def test_bodies_of_ones_own(plant):
    """A face driven by a function, and what the controller makes of it, as of a conveyor."""
    direction = unit(vector(-0.904196, -0.361677, 0.227199))
    signal = {"type": "minimum_jerk", "value": 0.005, "start": 0.0, "duration": 0.05}
    scenario = task(plant, "moving_face")

    def with_motion(motion):
        left, right = (contact.model_dump() for contact in scenario.contacts)
        left["face"]["motion"] = motion
        return scenario.replaced(contacts=[left, right])

    def drive(t):
        return np.array([[x, 0.0] for x in MinimumJerk(value=0.005, duration=0.05).at(t)])

    answered = []

    class Belt:
        def environment(self, X_WE, V_E, A_E, O):
            answered.append(V_E)
            return Conveyor().environment(X_WE, V_E, A_E, O)

    own = osc.OwnMotion(osc.Rail(direction, motion=drive), Belt())
    packaged = {"type": "conveyor", "direction": direction, "signals": [signal]}
    ours = run_of(with_motion(own))
    assert_same_run(ours, run_of(with_motion(packaged)), 1e-6)
    assert answered and np.ptp(ours["face_pose"][:, 0, :3], axis=0).max() > 1e-3
    late = osc.OwnMotion(osc.Rail(direction, motion=lambda t: drive(t + 0.02)))
    with scenario_error("away from where the contacts touch"):
        rig_of(with_motion(late)).plant()


@parametrize("plant", PLANTS)
def test_laws_of_ones_own(plant):
    plain = task(plant)
    made = []

    class Proportional:
        def __init__(self):
            made.append(self)
            self.calls = 0

        def __call__(self, desired, measured):
            self.calls += 1
            return desired + 0.2 * (desired - measured)

    ours = run_of(plain.replaced(laws=lambda: osc.Laws(force=Proportional())))
    theirs = run_of(plain, install=lambda c: c.with_laws(force=Proportional()))
    assert_same_run(ours, theirs)
    assert [law.calls for law in made] == [20, 1, 20, 1], "every controller has its own"
    with raises(AssertionError):
        assert_same_run(ours, run_of(plain), 1e-6)


def test_a_scenario_from_a_dict_is_that_of_the_file():
    loaded = osc.load_scenario("two_contact_rod")
    data = loaded.as_dict() | {"duration": "10 s"}
    data["object"]["pose"]["xyz"] = np.array(data["object"]["pose"]["xyz"])
    assert osc.Scenario.from_dict(data) == loaded
    assert loaded.replaced() == loaded and loaded.replaced().source == loaded.source
    assert loaded.replaced(duration=2.0).duration == 2.0


@parametrize(
    "words, parts",
    {
        "duration: must be > 0": {"duration": -1.0},
        "frequency beside stiffness": {"gains": {"motion": {"stiffness": 1, "frequency": 2}}},
        "expected osc.Laws": {"laws": "proportional"},
        "the key 'type' is missing": {"contacts": [{"pair": "cone", "body": "groove"}]},
        "environment": {"contacts": [{"pair": osc.Free(), "body": "table"}], "force": {}},
    },
)
def test_what_does_not_fit_is_reported_as_for_a_file(parts, words):
    with scenario_error(words):
        osc.load_scenario("two_contact_rod").replaced(**parts)


def test_scenarios_are_taken_by_name_and_by_path():
    """Every public function accepts them like `load_scenario`; unknown names have a cure."""
    by_name = osc.run("two_contact_rod", duration=0.02)
    by_path = osc.run(FILES / "two_contact_rod.yaml", duration=0.02)
    made = osc.run(osc.load_scenario("two_contact_rod"), duration=0.02)
    assert_array_equal(by_name["tau"], made["tau"])
    assert_array_equal(by_path["tau"], made["tau"])
    assert osc.build_rig("two_contact_rod").scenario == osc.load_scenario("two_contact_rod")
    for take in (osc.run, osc.build_rig, osc.open_viewer):
        with scenario_error("no packaged scenario 'two_contact_rodd'; did you mean"):
            take("two_contact_rodd")
