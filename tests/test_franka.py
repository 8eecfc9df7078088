"""The Franka driver against franky-sim: libfranka's own protocol, and a plant that is not ours."""

import os
import re
import sys
from pathlib import Path
from subprocess import DEVNULL

import numpy as np
import pinocchio as pin
from command_line import call
from complaints import invalid_input, plant_error
from franka_rig import PROBE, RADIUS, FrankaServer, Press, franka
from processes import python, started
from pytest import approx, mark
from rigs import assert_near, largest, placed, vector
from samples import ROOT, first, parametrize

import osc_contact as osc
from osc_contact.drivers.franka import FrankaRobot
from osc_contact.lab.visual.plots import draw_forces
from osc_contact.loop.commissioning import Commissioning
from osc_contact.testing import check_robot

OK = osc.Status.OK
__all__ = ["franka"]

# --- item 6: contact without any knowledge of joint friction and rotors ---------------------------

CASES = {  # force, gap, gap believed in, joint friction, tilt, friction, stiffness of the plate
    "from 50 mm": (5.0, 0.05, 0.05, 1.0, 0.0, 0.0, 7e4),
    "no joint friction": (5.0, 0.004, 0.004, 0.0, 0.0, 0.2, 7e4),
    "no joint friction, hard": (20.0, 0.004, 0.004, 0.0, 0.0, 0.2, 3e5),
    "20 mm off, tilted, rough": (10.0, 0.005, 0.025, 1.0, np.deg2rad(5.0), 0.2, 7e4),
    "twice the joint friction": (10.0, 0.004, 0.004, 2.0, 0.0, 0.2, 7e4),
    "soft": (15.0, 0.004, 0.004, 1.0, 0.0, 0.2, 1e4),
    "hard, 5 N": (5.0, 0.004, 0.004, 1.0, 0.0, 0.2, 3e5),
}
#: Of the command, of the last cases; twice, the aim, is missed: mass, speed, stiffness.
IMPACT = {"hard, 5 N": 3.0}


@parametrize("case", first(CASES, len(CASES) - len(IMPACT)))
def test_it_approaches_presses_slides_and_retreats(franka, case):
    force, gap, believed, losses, tilt, friction, stiffness = CASES[case]
    scene = {"joint_friction": losses, "tilt": tilt, "friction": friction, "stiffness": stiffness}
    task = Press(franka, force, gap, believed, scene=scene)
    task.prepare()
    task.run()
    landing = task.normal[: task.landed + 500].max() / force
    slid = np.ptp(task.probe[task.landed : task.released, 1])
    assert set(task.status) == {OK}
    assert task.released, "it has slid and was released"
    assert task.error() < (0.05 if losses else 0.02)
    assert landing < IMPACT.get(case, 2.0)
    assert slid == approx(task.slide, rel=0.05)
    assert task.normal[-1] == 0.0 and task.probe[-1, 2] - task.probe[task.released, 2] > 0.015


def test_the_page_has_a_program_that_runs_against_its_command_line(tmp_path):
    """Uses an address that no other test uses."""
    page = (ROOT / "docs" / "franka.md").read_text().split("## On franky-sim")[1]
    (line,) = re.findall(r"^\$ franky-sim (.*)$", page, re.MULTILINE)
    (program, *_) = re.findall(
        r"^```{code-block} python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL
    )
    shown = re.findall("It prints `(.*?)`", page)
    address = "127.0.0.99"
    command = Path(sys.executable).with_name("franky-sim")
    options = line.replace("127.0.0.1", address).split()
    unbuffered = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with started([command, *options], stdin=DEVNULL, env=unbuffered) as server:
        try:
            lines = iter(server.stdout.readline, "")
            assert any(f"'{address}'" in said for said in lines), server.stderr.read()
            done = python("-c", program.replace("127.0.0.1", address), cwd=tmp_path)
        finally:
            server.terminate()
    assert done.stdout.splitlines() == shown


# --- item 5: faults over the wire -----------------------------------------------------------------

AT = 1300  #: packets of the motion; contact has been made


def run_faulty(task, **driver):
    """The task, how it ended, and what always holds: forces, arms at rest, stopped in its tick."""
    task.hold = 0.7
    task.prepare(**driver)
    stops = []
    ended = None
    stop = task.robot.stop

    def note(reason=""):
        stops.append((len(task.status), reason))
        stop(reason)

    task.robot.stop = note
    try:
        task.run()
    except osc.PlantError as error:
        ended = error
    assert task.normal.max(initial=0.0) < max(3.0 * task.force, 30.0)
    if osc.SafetyState.SAFE_STOP in task.state:
        assert stops[0][0] == task.state.index(osc.SafetyState.SAFE_STOP), "in its very tick"
        assert stops[0][1] and stops[-1][1] == ""
    if not task.faults.get("kill"):
        task.server.wait(300)
        assert largest(task.server.truth()[-1, 4:]) < 0.1, "at rest, held by the robot"
    task.reason = stops[0][1]
    return ended


BENIGN = {
    "robot frozen": {"freeze": {"1": 0.01, "60": 0.02, "120": 0.05, "180": 0.3}},
    "client frozen 10 ms": {"away": 10},
    "dropped, repeated, reordered": {"drop": 2, "repeat": 3, "swap": 5},
}


@parametrize("fault", BENIGN)
def test_what_the_robot_forgives_disturbs_no_contact(franka, fault):
    task = Press(franka, gap=0.001, faults=BENIGN[fault] | {"at": AT})
    assert run_faulty(task) is None
    assert set(task.status) == {OK} and len(task.status) > AT
    assert task.normal[AT:-50] == approx(10.0, rel=0.3)


@parametrize(
    "fault, sentence",
    [
        ({"away": 20}, "communication_constraints_violation"),
        ({"away": 300}, "communication_constraints_violation"),
        ({"reflex": True}, "communication_constraints_violation"),
        ({"kill": True}, "ended the motion: libfranka: .*Look at the robot"),
    ],
    ids=["client frozen 20 ms", "client frozen 300 ms", "reflex", "robot killed"],
)
def test_a_robot_that_ends_the_motion_ends_the_loop(franka, fault, sentence):
    task = Press(franka, gap=0.001, faults=fault | {"at": AT})
    ended = run_faulty(task)
    assert ended is not None and re.search(sentence, str(ended)), ended
    assert task.reason.startswith("PlantError: ")
    if "kill" in fault:
        return
    task.robot.close()
    with plant_error(r"is stopped \(.*Reflex.* connect with recover=True"):
        FrankaRobot(franka.host, task.chain)
    assert "Idle" in str(FrankaRobot(franka.host, task.chain, recover=True).state.robot_mode)


def without_weight(robot):
    weight = 9.81 * 0.73 * robot._data.oMf[robot._sensor].rotation[2]
    return robot._estimate_wrench(robot.state) - [*weight, 0.0, 0.0, 0.0]


@parametrize(
    "scene, driver, sentence",
    [
        ({"mass": 0.5}, {}, "reads another load than it carries"),
        ({"sign": -1.0}, {}, ""),
        ({}, {"sensor": "hand"}, "without gravity"),
    ],
    ids=["wrong payload", "mirrored wrench", "no gravity"],
)
def test_a_wrist_that_is_wrong_ends_in_a_stop(franka, scene, driver, sentence):
    """In the loop; the check before the first command refuses two of them, see the next test."""
    task = Press(franka, gap=0.003, scene=scene, ticks=4000, check=False)
    if driver:
        driver["wrench"] = lambda: without_weight(task.robot) if hasattr(task, "robot") else None
    assert run_faulty(task, **driver) is None
    assert task.state[-1] is osc.SafetyState.SAFE_STOP and sentence in task.reason


def test_a_wrist_that_reads_another_load_is_refused_before_the_first_command(franka):
    task = Press(franka, gap=0.003, scene={"mass": 0.5}, ticks=4000)
    task.prepare()
    with invalid_input("reads another load than it carries"):
        task.run()
    assert not task.status, "no command was sent"


# --- item 1: what goes in and what comes out ------------------------------------------------------


def at_rest(server, ticks, sensor="tcp", **scene):
    """The driver, and its measurements while the model's own weight is commanded."""
    server.begin(height=0.0, **scene)
    chain = osc.ClosedChain([server.arm(sensor=sensor)])
    robot = FrankaRobot(server.host, chain)
    data = chain.model.createData()
    read = [robot.measure()]
    for _ in range(ticks):
        robot.command(pin.computeGeneralizedGravity(chain.model, data, read[-1].q), 1e-3)
        read.append(robot.measure())
    return (robot, read)


def test_the_weight_that_the_robot_carries_is_taken_from_the_torques(franka):
    robot, read = at_rest(franka, 200)
    assert largest(robot._sent_torques.tau_J) < 1e-9, "the robot adds gravity by itself"
    assert largest(read[-1].q - read[0].q) < 1e-3
    assert largest(read[-1].joint_torques) > 20.0, "as its own sensors read"
    steps = np.diff([m.sequence for m in read[2:]])
    assert set(steps) == {1} and read[-1].stamps.encoders == approx(1e-3 * read[-1].sequence)
    assert robot.success_rate > 0.99
    robot.stop("enough")
    robot.stop()
    assert "Idle" in str(robot._robot.read_once().robot_mode)
    robot.command(np.zeros(7), 1e-3)  # it holds by itself: nothing is sent
    assert largest(robot.measure().q - read[-1].q) < 1e-2


@parametrize("sensor", ["tcp", "hand"])
def test_the_wrench_is_that_of_the_arm_on_its_gripper(franka, sensor):
    robot, read = at_rest(franka, 60, sensor, push=[8.0, 20.0], noise=0.0)
    X = pin.SE3(robot._data.oMf[robot._sensor])
    t = 20.0 * 1e-3 * (franka.send()["steps"] - 1) * vector(1.0, 1.3, 0.7)
    force = -8.0 * vector(1.0, 1.0, 0.3) * np.cos(t)
    wrench = X.act(pin.Force(read[-1].wrenches[0]))
    weight = [0, 0, 9.81 * (0.73 if sensor == "hand" else 0.0)]
    assert_near(wrench.linear - weight, force, atol=1.5)
    tip = robot._base.act(robot._data.oMf[robot._tip]).translation
    lever = X.act(vector(-0.01, 0.0, 0.03))
    assert_near(wrench.angular, np.cross(tip, force) + np.cross(lever, weight), atol=0.5, rtol=0)
    robot.stop()


def test_torques_stay_within_the_limits_of_the_robot(franka):
    robot, _ = at_rest(franka, 1)
    before = np.array(robot.state.tau_J_d)
    robot.command(np.full(7, 1e6), 1e-3)
    assert largest(np.array(robot._sent_torques.tau_J) - before) == approx(0.99)
    robot._v = robot.chain.model.upperVelocityLimit.copy()  # every joint at its limit
    robot.state = type("state", (), {"tau_J_d": robot.chain.tau_max})
    weight = pin.computeGeneralizedGravity(robot._model, robot._data, robot._q)
    robot.command(robot.chain.tau_max + weight, 1e-3)
    assert (np.array(robot._sent_torques.tau_J) < robot.chain.tau_max).all(), "braked"
    with invalid_input("tau"):
        robot.command(np.full(7, np.nan), 1e-3)
    with invalid_input(r"each 1 ms, not each 2 ms"):
        robot.command(np.zeros(7), 2e-3)
    robot.stop()


def test_payload_end_effector_and_mounted_sensor(franka):
    franka.begin(height=0.0)
    ball = osc.RigidObject(pin.Inertia.FromSphere(0.5, 0.03))
    chain = osc.ClosedChain([franka.arm()], [placed(0, 0, 0.1)], ball)
    readings = iter([np.arange(6.0), None, [np.nan] * 6])
    robot = FrankaRobot(franka.host, chain, wrench=lambda: next(readings))
    assert robot.state.m_load == approx(0.5, rel=1e-6)
    assert_near(robot.state.F_x_Cload, [0.0, 0.0, 0.2034], atol=1e-6)
    first, second, third = (robot.measure() for _ in range(3))
    assert first.wrench_valid and first.wrenches[0].tolist() == [0, 1, 2, 3, 4, 5]
    assert not second.wrench_valid and not third.wrench_valid and not third.wrenches.any()
    robot._wrench = None
    assert_near(robot._load.mass, 0.5)
    franka.begin(height=0.0, tcp_off=0.02)
    with plant_error(r"tip 'tcp' is 20 mm and .* give end_effector="):
        FrankaRobot(franka.host, chain)


def test_what_it_refuses(franka, monkeypatch):
    chain = osc.ClosedChain([franka.arm()])
    with plant_error(r"cannot be prepared: libfranka: Connection .* FCI"):
        FrankaRobot("127.0.0.77", chain)
    bare = osc.ClosedChain([osc.Arm.from_urdf(franka.urdf, name="fr3", tip="tcp")])
    with invalid_input("give the arm a frame beyond the last joint"):
        FrankaRobot(franka.host, bare)
    monkeypatch.setitem(sys.modules, "pylibfranka", None)
    with plant_error(r"pip install 'osc-contact\[franka\]'"):
        FrankaRobot(franka.host, chain)


class Nudged(FrankaRobot):
    """Somebody pushes its tip at some tick."""

    server: FrankaServer
    at = 2500
    ticks = 0

    def measure(self):
        self.ticks += 1
        if self.ticks == self.at:
            self.server.send(nudge=[0.0, 8.0, 0.0])
        return super().measure()


def nudged(server, **scene):
    server.begin(height=0.0, **scene)
    robot = Nudged(server.host, osc.ClosedChain([server.arm()]))
    robot.server = server
    return robot


def test_it_keeps_the_contract_of_drivers(franka):
    """`check_robot` on the wire, with a push that shows which way the wrench is."""
    robot = nudged(franka)
    (left_out,) = check_robot(robot, nudge=[0.0, 1.0, 0.0])
    assert left_out.startswith("the sign of the wrench is not checked by 0 N")
    assert robot._control is None


# --- item 4: commissioning ------------------------------------------------------------------------


@mark.slow
def test_commissioning_goes_from_the_model_to_the_first_contact(franka, tmp_path):
    """The arm's joints rub half as much as an FR3's; somebody leads it in shadow mode."""
    robot = nudged(franka, joint_friction=0.5)
    steps = []

    def confirm(what):
        steps.append(what.split(":")[0])
        robot.at = robot.ticks + 100 * (steps[-1] == "wrench")
        franka.send(nudge=[0.0, 0.0, 0.0], push=None)
        franka.wait(500)  # until it rests: the plate is put below the place where it is
        push = [8.0, 6.0] if steps[-1] == "shadow" else None
        franka.send(push=push, plate=0.003 if steps[-1] == "contact" else 0.2)
        return True

    course = Commissioning(
        robot,
        tmp_path,
        PROBE + RADIUS + 0.003,
        confirm,
        shadow_time=3.0,
        realtime=False,
        draw=draw_forces,
        holds_itself=True,
    )
    assert course.run(), course.lines
    assert steps == ["model", "wrench", "shadow", "contact"]
    report = (tmp_path / "report.md").read_text()
    assert "forces may be commanded" in report and (tmp_path / "forces.png").exists()
    robot.close()


@parametrize("sentence, sign", {"was not moved; push the tool": 1.0, "N more in world axes": -1.0})
def test_commissioning_ends_where_a_step_fails(franka, tmp_path, monkeypatch, sign, sentence):
    franka.begin(height=0.0, sign=sign)
    monkeypatch.setattr("osc_contact.drivers.franka.FrankaRobot", Nudged)
    monkeypatch.setattr(Nudged, "server", franka, raising=False)
    monkeypatch.setattr(Nudged, "at", 400)
    line = f"commission franka --host {franka.host} --urdf {franka.urdf} --tip tcp --out {tmp_path}"
    done = call(f"{line} --yes --no-realtime --shadow-time 1.1")
    assert done.exit_code == 1 and sentence in " ".join(done.output.split()), done.output
    assert "failed" in (tmp_path / "report.md").read_text()
