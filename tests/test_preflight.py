"""Mistakes in a scenario, in Python and at the command line: found before it runs, with a cure."""

import logging
from dataclasses import replace

import numpy as np
from command_line import call, done, refused
from complaints import invalid_input, scenario_error
from pytest import approx, raises
from rigs import largest
from samples import parametrize
from scenario_runs import rig_of, run_of

import osc_contact as osc
from osc_contact.lab.runs.run import start
from osc_contact.loop.arm_rules import least_peak

SINE = "signals: [{type: sine, amplitude: 50 mm, frequency: 0.5 Hz, start: 0 s, ramp: 1 s}]"
LEFT = "contacts.left_end.face"


@parametrize("name", osc.list_scenarios())
def test_packaged_scenarios_pass_without_a_word(name):
    assert osc.preflight(rig_of(name)) == ()


@parametrize(
    "change, cure",
    {
        f"{LEFT}.point=[-0.295, 0, -0.8]": "move object, faces or base",  # plate 1 m away
        f"{LEFT}.normal=[-0.501104, -0.200441, -0.841854]": "reverse contacts.l",
        f"{LEFT}.point=[-0.595011, -0.002004, 0.37]": "219 mm beside",  # contact outside the face
        "motion.0.signals.0.amplitude=80 m": "are its signals in the right unit?",
        "force.left_end=[{type: constant, value: 5 kN}]": "30 times their limits",
        "force.right_end.0.value=-9 N": "this contact cannot pull",
        "arms.left.posture=[0, 0, 0]": "8 joint positions given",
        "arms.left.wrist_sensor=null": "name a frame of its URDF as wrist_sensor",
    },
)
def test_what_cannot_run_is_refused_at_every_door(change, cure, tmp_path):
    for line in ("inspect two_contact_rod --set", f"run two_contact_rod --out {tmp_path} --set"):
        assert cure in refused(line, change)
    with scenario_error(cure.replace("?", r"\?")):
        run_of("two_contact_rod", change, duration=0.5)


@parametrize(
    "change, words",
    {
        f"motion=[{{kind: linear, direction: [0, 0, 1], {SINE}}}]": "which does not permit it",
        f"{LEFT}.motion={{type: cart, direction: [0, 0, 1], mass: 2 kg}}": (
            "nothing balances the cart of 'face_left_end'"
        ),
        "plant.flexible_joints.frequency=60 Hz": "set control.joint_torque={rate: 4 kHz}",
        "model_error.arm_mass=1.2": "arm_mass is 1.2, and nothing zeroes",  # no tare
        # out of reach
        "motion.0.signals=[{type: minimum_jerk, value: 0.5 m, duration: 2.1 s}]": (
            "where no posture near the start puts it"
        ),
        # friction that the filter reads
        "plant.friction=0.2": "set control.force.reading=least_squares, or give control.friction",
        "sensors.wrist={rate: 1 kHz, torque: {bias: 0.1 Nm}}": "set tare={} to zero them",
    },
)
def test_what_is_doubtful_is_reported_at_every_door(change, words, caplog):
    with caplog.at_level(logging.WARNING, "osc_contact.preflight"):
        result = call("inspect two_contact_rod --set", change)
        assert result.exit_code == 1 and "free motion 1" in result.stdout
        assert words in caplog.text
        caplog.clear()
        slow = "minimum_jerk" in change  # it is out of reach at its end only
        recording = run_of("two_contact_rod", change, duration=2.1 if slow else 0.5)
        assert words in caplog.text and words in recording.meta["doubts"][0]


# --- sets of active contacts ----------------------------------------------------------------------


def doubts(*changes):
    """Sentences about the rod with changes."""
    return "\n".join(one.text for one in osc.preflight(rig_of("two_contact_rod", *changes)))


def test_forces_of_contacts_that_are_not_active_are_not_counted():
    """Each contact of the rod is pressed with 190 N, which only one at a time bears."""
    hard = ("force.left_end=[{type: constant, value: 190 N}]", "force.right_end.0.value=190 N")
    hard += ("control.safety.wrist_ceiling=300 N", "control.safety.contact_ceiling=300 N")
    turns = ("active.left_end=[[0 s, 5 s]]", "active.right_end=[[5 s, 99 s]]")
    assert "the sum of all commanded forces is 394 N" in doubts(*hard)
    assert "sum of all" not in doubts(*hard, *turns)
    one, two = (rig_of("two_contact_rod", *more) for more in (turns, ()))
    assert one.safety.wrist_ceiling < two.safety.wrist_ceiling


LIFTED = (
    "motion=[{kind: linear, direction: [0, 0, 1], signals: [{type: minimum_jerk, value: 30 mm, "
)
LIFTED += "start: 1 s, duration: 1 s}]}]"


def test_a_motion_may_leave_contacts_that_are_not_active():
    """One that becomes active later is approached from where it is, or taken as closed there."""
    off = "contact 'left_end', which does not permit it"
    assert off in doubts(LIFTED)
    away = ("active.left_end=[[0 s, 0.9 s]]", "active.right_end=[[0 s, 0.9 s]]")
    assert doubts(LIFTED, *away) == ""
    late = ("active.left_end=[[0 s, 0.9 s], [2.5 s, 99 s]]", away[1])
    assert doubts(LIFTED, *late) == ""
    assert off in doubts(LIFTED, "active.left_end=[[0 s, 1.5 s]]", away[1])
    closed = doubts(LIFTED, *late, "control.life=off")
    assert "'left_end' becomes active at t = 2.5 s, where the motion has it 25 mm away" in closed
    assert "have it approached (control.life)" in closed


def test_a_motion_into_a_contact_that_is_not_active_is_doubtful():
    """Its force is controlled by nothing, though the same motion is harmless while it is active."""
    span = "active.post_1=[[0 s, 0.4 s], [1.5 s, 99 s]]"
    found = [one.text for one in osc.preflight(rig_of("three_arm_plate", span, "duration=2 s"))]
    (doubt,) = [text for text in found if "nothing controls" in text]
    assert "into what contact 'post_1' touches, which is not active then" in doubt
    assert float(doubt.split("the object ")[1].split(" mm")[0]) > 2.0


def test_each_set_of_contacts_is_tried_once_before_the_run():
    """Two contacts on one line of force but on two bodies cannot be controlled together."""
    data = rig_of().scenario.as_dict()
    again = {**data["contacts"][0], "name": "again", "face": {**data["contacts"][0]["face"]}}
    again["face"]["motion"] = {
        "type": "cart",
        "direction": [0, 0, 1],
        "mass": 2.0,
        "stiffness": 1e4,
    }
    data["contacts"] = [*data["contacts"], again]
    data["force"]["again"] = [{"type": "constant", "value": 5.0}]
    words = "left_end and right_end and again, active together from t = 2 s on, cannot be"
    data["active"] = {"again": [[2.0, 99.0]]}
    with scenario_error(words):
        osc.run(osc.Scenario.from_dict(data))
    data["active"] |= {"left_end": [[0.0, 2.0]]}
    found = osc.preflight(osc.build_rig(osc.Scenario.from_dict(data)))
    assert not any(one.refused for one in found)


def test_a_span_of_time_ends_after_it_begins():
    with scenario_error(r"expected \[from, to\] with to > from, got \[2 s, 1 s\]"):
        rig_of("two_contact_rod", "active.left_end=[[2 s, 1 s]]")


ELSEWHERE = {
    "table 1 m away": ("panda_edge", "mm away from", "environment.table.pose.xyz=[1.5, 0, 0.32]"),
    "board 1 m below": (
        "ur5_wipe",
        "At object.pose contact 'cloth' is 866 mm away from what it touches",
        "environment.board.pose.xyz=[0.47, 0, -0.76]",
    ),
    "posts 1 m aside": (
        "three_arm_plate",
        "mm beside the object",
        "environment.tripod.pose.xyz=[1, 0, 0]",
    ),
    "face's normal": (
        "ur5_wipe",
        "out of 'board', .* reverse contacts.cloth.face_normal",
        "contacts.cloth.face_normal=[0, 0, -1]",
    ),
    "edge's normal": (
        "panda_edge",
        "reverse contacts.edge.edge_outward",
        "contacts.edge.edge_outward=[1, 0, -1]",
    ),
    "object's normal": (
        "three_arm_plate",
        "out of the object, .* reverse contacts.post_1.normal",
        "contacts.post_1.normal=[0, 0, 1]",
    ),
    "two normals": (
        "scara_peg",
        "starts 9 mm inside 'socket'",
        "contacts.wall_x.face_normal=[1, 0, 0]",
        "contacts.wall_y.face_normal=[0, 1, 0]",
    ),
    "force": (
        "dual_panda_rod",
        "need 4 times their limits",
        "force.left_end=[{type: constant, value: 1600 N}]",
    ),
}


@parametrize("name", ELSEWHERE)
def test_other_kinds_of_contact_are_looked_at_too(name):
    scenario, cure, *changes = ELSEWHERE[name]
    with raises((osc.ScenarioError, osc.ModelError), match=cure):
        run_of(scenario, *changes, duration=0.5)
    words = [word for change in changes for word in ("--set", change)]
    assert call("inspect", scenario, *words).exit_code == 2


@parametrize(
    "name, force, reported",
    [
        ("scara_peg", 90, False),
        ("scara_peg", 160, True),
        ("panda_edge", 170, False),
        ("panda_edge", 210, True),
    ],
)
def test_forces_are_reported_where_the_motors_end(name, force, reported):
    """Judged by a run: it loses more than 5 % of the force where this is reported only."""
    contact = {"scara_peg": "wall_x", "panda_edge": "edge"}[name]
    change = f"force.{contact}=[{{type: constant, value: {force} N}}]"
    scenario = osc.load_scenario(name, [change, "motion=[]", "duration=1 s"])
    found = osc.preflight(rig_of(scenario))
    assert [one.text.startswith(f"force.{contact} is") for one in found] == [True] * reported
    recording = run_of(scenario)
    lost = (recording["alpha_cmd"] - recording["alpha_true"])[-200:, 0].mean() / force
    assert (lost > 0.05) == reported


def test_the_least_peak_is_that_of_the_dual_problem():
    """min |x|∞ with A x = b is max bᵀy with |Aᵀy|₁ ≤ 1, here at vertices found by trying."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        A = rng.standard_normal((2, 5))
        b = rng.standard_normal(2)
        angles = np.linspace(0.0, 2.0 * np.pi, 20_001)
        y = np.array((np.cos(angles), np.sin(angles)))
        assert least_peak(A, b) == approx((b @ y / np.abs(A.T @ y).sum(axis=0)).max(), rel=0.002)
    contrary = (np.vstack((A, A[0])), np.append(b, b[0] + 1.0))  # no x: of the least squares
    assert least_peak(*contrary) == approx(largest(np.linalg.pinv(contrary[0]) @ contrary[1]))


def test_a_contact_without_forces_is_no_trouble():
    data = osc.load_scenario("two_contact_rod").as_dict()
    data["contacts"] = [{"pair": osc.Free(), "body": "table"}]
    data |= {"environment": [{"name": "table", "urdf": "table.urdf"}], "force": {}, "motion": []}
    assert osc.preflight(rig_of(osc.Scenario.from_dict(data))) == ()


def test_a_contact_that_lives_is_kept_only_while_it_is_pressed():
    motion = f"motion=[{{kind: linear, direction: [0, 0, 1], {SINE}}}]"
    for change in (motion, "motion.1.signals.0.start=1.5 s"):
        found = findings("approach_and_slide", change)
        assert any("does not permit it" in text for _, text in found)


@parametrize(
    "changes",
    [
        [
            "plant.flexible_joints.frequency=60 Hz",
            "control.joint_torque={rate: 20 kHz}",
            "plant.step=0.05 ms",
        ],
        ["plant.flexible_joints.frequency=200 Hz"],
        ["model_error.arm_mass=1.2", "tare={}"],
        ["model_error.arm_mass=1.2", "plant.type=rigid", "plant.step=1 ms"],
        ["sensors.wrist={rate: 1 kHz, force: {noise: 1 N}}"],
    ],
)
def test_what_is_cured_is_not_reported(changes):
    assert osc.preflight(rig_of("two_contact_rod", *changes)) == ()


def test_a_torque_loop_that_diverges_is_refused_before_it_runs():
    changes = ["plant.flexible_joints.frequency=60 Hz", "control.joint_torque={rate: 4 kHz}"]
    ((kind, text),) = findings("two_contact_rod", *changes)
    assert kind == "refused" and "lower control.joint_torque.gain" in text


def findings(name, *changes):
    """Findings as "doubtful" or "refused", with their texts."""
    found = osc.preflight(rig_of(name, *np.ravel(changes).tolist()))
    return [(("doubtful", "refused")[one.refused], one.text) for one in found]


LEAN = 0.841854  #: cos of the angle between the faces' normals and the vertical


def drop(mm):
    return f"object.pose.xyz=[0, 0, {0.2 + mm / 1.067e3}]"  # it turns a little on the way


def balanced(newtons):
    """A cart of 2 kg; preload, weight and 8 N on a face that leans leave so much along its rail."""
    preload = 2.0 * 9.81 + 8.0 * LEAN + newtons
    cart = f"{{type: cart, direction: [0, 0, 1], mass: 2 kg, preload: {preload:.6f} N}}"
    return (f"{LEFT}.motion={cart}", "force.left_end=[{type: constant, value: 8 N}]")


def lift(mm):
    signal = f"{{type: minimum_jerk, value: {mm} mm, start: 1 s, duration: 1 s}}"
    return f"motion=[{{kind: linear, direction: [0, 0, 1], signals: [{signal}]}}]"


#: Changes just below a limit and just above it; from where on it is doubtful, or refused.
LIMITS = {
    "20 mm to the start": (drop(19.5), drop(20.5), "doubtful", "mm away from"),
    "100 mm to the start": (drop(98), drop(102), "refused", "102 mm away from"),
    "5 mm off a face": (lift(4.8 / LEAN), lift(5.2 / LEAN), "doubtful", "5 mm off"),
    "5 mm into a face": (lift(-4.8 / LEAN), lift(-5.2 / LEAN), "doubtful", "5 mm into"),
    "motion damping": (
        "gains.motion.damping=690",
        "gains.motion.damping=710",
        "doubtful",
        "raise the rate to 7100 Hz",
    ),
    "motion damping, twice": (
        "gains.motion.damping=1990",
        "gains.motion.damping=2010",
        "refused",
        "raise the rate to 20100 Hz",
    ),
    "force integral": (
        "gains.force.integral=690",
        "gains.force.integral=710",
        "doubtful",
        "gains.force.integral 710 1/s",
    ),
    "force brake": (
        "gains.force={bandwidth: 25 Hz, damping_ratio: 2.2}",
        "gains.force={bandwidth: 26 Hz, damping_ratio: 2.2}",
        "doubtful",
        "bandwidth 26 Hz, brake 718.796",
    ),
    "springs": (
        "plant.flexible_joints.frequency=102 Hz",
        "plant.flexible_joints.frequency=98 Hz",
        "doubtful",
        "oscillate at 98 Hz",
    ),
    # s = F t² / 2m in 10 s
    "cart up": (balanced(0.0076), balanced(0.0084), "doubtful", "0.0084 N along its rail"),
    "cart down": (balanced(-0.0076), balanced(-0.0084), "doubtful", "-0.0084 N along its rail"),
    "weight": (
        "model_error.object_mass=1",
        "model_error.object_mass=1.1",
        "doubtful",
        "object_mass is 1.1, and nothing zeroes",
    ),
    "bias of forces": (
        "sensors.wrist={rate: 1 kHz, force: {noise: 1 N}}",
        "sensors.wrist={rate: 1 kHz, force: {bias: 1 N}}",
        "doubtful",
        "force has a bias of 1 N, and nothing zeroes",
    ),
}


@parametrize("name", LIMITS)
def test_what_is_reported_begins_at_its_limit(name):
    below, above, kind, words = LIMITS[name]
    assert kind not in [one for one, _ in findings("two_contact_rod", below)]
    assert any(one == kind and words in text for one, text in findings("two_contact_rod", above))


def test_a_contact_may_lie_five_millimetres_beside_its_body():
    def aside(metres):
        return findings("ur5_wipe", f"environment.board.pose.xyz=[0.47, {metres}, 0.24]")

    ((_, text),) = aside(0.3)
    beyond = 1e-3 * float(text.split(" mm beside")[0].split()[-1])
    assert aside(0.3 - beyond + 0.004) == []
    ((kind, text),) = aside(0.3 - beyond + 0.006)
    assert kind == "refused" and "6 mm beside 'board'" in text


def test_forces_beyond_the_motors_are_doubtful_then_refused():
    fine, *beyond = (
        findings("dual_panda_rod", f"force.left_end=[{{type: constant, value: {newtons} N}}]")
        for newtons in (430, 460, 1180, 1250)
    )
    assert fine == []
    assert [found[0][0] for found in beyond] == ["doubtful", "doubtful", "refused"]
    assert "2.9 times their limits" in beyond[1][0][1]


# Mistakes in Python and at the command line that are reported in a sentence with its cure.


class Floor:
    """A pair of one's own: the object's origin on the floor, with N of the wrong sign."""

    name = "floor"
    pushes = True

    def contact(self, X_WO, V_O, X_WE=None, V_E=None):
        return osc.Contact(np.array([[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]).T, np.zeros(1))

    def gaps(self, X_WO, X_WE=None):
        return np.array([X_WO.translation[2] - 0.3])


class Gapless:
    name = "floor"
    contact = Floor.contact


class TwoGaps(Floor):
    def gaps(self, X_WO, X_WE=None):
        return np.zeros(2)


def on_the_table(pair, *names):
    scenario = osc.load_scenario("panda_edge")
    force = {name: [{"type": "constant", "value": 10.0}] for name in names or ("floor",)}
    return scenario.replaced(contacts=[{"pair": pair, "body": "table"}], force=force)


def test_pairs_of_ones_own_that_do_not_fit():
    with scenario_error(r"Gapless has no gaps; a custom pair has"):
        on_the_table(Gapless())
    with scenario_error("reverse the sign of N or of gaps"):
        rig_of(on_the_table(Floor()))
    with scenario_error("one column of N"):
        rig_of(on_the_table(TwoGaps(), "floor.1", "floor.2"))


@parametrize(
    "words, install",
    {
        "got 5": 5,
        "takes 0 positional arguments": lambda: None,
        "which has no tick": lambda controller: None,
        "missing 1 required positional argument": osc.Controller,
    },
)
def test_what_install_takes(install, words):
    scenario = osc.load_scenario("panda_edge", ["duration=1.1 s"])
    with invalid_input(f"install= takes a function.*{words}"):
        run_of(scenario, install=install)


def test_mistakes_of_an_install_are_its_own():
    def install(controller):
        return controller + 1

    with raises(TypeError, match="unsupported operand"):
        run_of("panda_edge", install=install)


def test_one_force_for_two_contacts():
    rig = rig_of()
    controller = rig.controller()
    controller.tick(rig.plant().measure(), osc.Reference(rig.references.at(0.0).X_WD, alpha_d=10.0))
    assert controller.status is osc.Status.HELD
    assert "1 forces for 2 columns of N; give one for each degree" in controller.reason


class BeforeItsFirstStep:
    """A simulator whose force sensor reads exact zeros until it is stepped."""

    def __init__(self, plant):
        self.plant = plant
        self.stepped = False

    def measure(self):
        m = self.plant.measure()
        return m if self.stepped else replace(m, wrenches=np.zeros_like(m.wrenches))


def test_a_sensor_that_was_not_read_yet_is_called_so():
    rig = rig_of("panda_edge", "tare={standoff: 5 mm}")
    plant, controller = start(rig)
    robot = BeforeItsFirstStep(plant)
    controller.engaged = True
    references = [replace(rig.references.at(0.0), A_D=np.zeros(6))]
    (found,) = osc.preflight(robot, controller, references)
    assert not found.refused and "exactly zero" in found.text and "step once" in found.text
    assert "add the weight" not in found.text
    robot.stepped = True
    assert osc.preflight(robot, controller, references) == ()


def test_a_posture_that_does_not_serve_is_called_so(tmp_path):
    line = "new --robot panda --tip panda_hand_tcp --press Z=10 --posture '0, 0, 0' --out"
    message = refused(line, tmp_path / "my.yaml")
    assert "in the posture given" in message and "or none to have one sought" in message


def test_seeds_find_other_postures():
    line = "pose panda --tip panda_hand_tcp --xyz '0.4, 0.1, 0.4'"
    assert len({done(f"{line} {seed}").stdout for seed in ("", "--seed 1", "--seed 2")}) == 3
    assert "give --xyz or --rpy" in refused("pose panda --tip panda_hand_tcp --seed 1")


def test_inspect_prints_motions_of_a_light_object_in_small_numbers():
    rig = rig_of("panda_edge")
    rows = done("inspect panda_edge").stdout.splitlines()
    numbers = [
        float(x) for row in rows if "(m/s)" in row or "(rad/s)" in row for x in row.split("│")[2:-1]
    ]
    assert len(numbers) == 30 and max(map(abs, numbers)) == 1.0
    assert largest(rig.contact.T) > 1.5  # as they are
