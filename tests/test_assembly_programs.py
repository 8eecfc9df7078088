"""Programs that judge insertions: other laws, faults in stages, a peg that slips; ends at rest."""

import logging
from dataclasses import replace
from hashlib import sha256

import numpy as np
import pinocchio as pin
from numpy.testing import assert_allclose
from pytest import approx, fixture
from samples import parametrize

import osc_contact as osc
from benchmarks import plan_faults, slipping_peg
from benchmarks.fault_judge import FaultySensors
from benchmarks.guided_laws import LAWS, controlled_by
from benchmarks.peg_rivals import PEG, RIVALS, SELECTION, selected_axes
from benchmarks.plan_faults import Run, possible
from benchmarks.recorded_insertions import result_in
from benchmarks.slipping_peg import SlippingPeg
from benchmarks.two_pin_rivals import Press, guided_plan, presses_of
from osc_contact.control.status import Phase
from osc_contact.lab.tasks.insertion import CLEARANCE, PERIOD, Insertion
from osc_contact.lab.tasks.pegs import Inserted, controller_for, peg_plan, peg_start
from osc_contact.lab.tasks.two_pin_plan import INTO, POINTS, SIDEWAYS, bar_start, two_pin_plan
from osc_contact.lab.tasks.two_pins import TwoPins
from osc_contact.plan.sensed import Sensed

TASK = Insertion(PEG, CLEARANCE, 3)


@fixture
def robot():
    return TASK.robot(peg_start(PEG, TASK.hole))


def sensed(speed):
    """Signals of an object that moves down at a speed (m/s)."""
    V = np.array([0.0, 0.0, -speed, 0.0, 0.0, 0.0])
    here = pin.SE3.Identity()
    forces, phases = {"hole": 0.0}, {"hole": Phase.CLOSED}
    return Sensed(here, V, here, np.zeros(6), forces, phases, here, np.zeros((6, 0)))


@parametrize("plan", [lambda: peg_plan(PEG, TASK.hole), lambda: two_pin_plan(TwoPins(3))])
@parametrize("speed", [5e-3, 1.5e-3])
def test_the_last_stage_goes_on_until_the_object_rests(plan, speed):
    """Speeds below 2 mm/s are not distinguished from rest by a peg; a bar must stay in place."""
    done = plan().stages[-1]
    assert done.name == "done"
    creeps = speed < 2e-3 and "carried" in done.until.words
    now = sensed(speed)
    now.wrench[:3] = 12.0 * TASK.hole.pose.rotation[:, 2]
    watch = done.until.begin(now)
    for v, ticks, is_met in ((speed, 800, creeps), (0.0, 50, creeps), (0.0, 250, True)):
        now.V = np.array([0.0, 0.0, -v, 0.0, 0.0, 0.0])
        for _ in range(ticks):
            now.t += PERIOD
            now.X = pin.SE3(np.eye(3), now.X.translation + PERIOD * now.V[:3])
            met = watch(now, PERIOD)
        assert met == is_met


def test_a_peg_that_walls_press_is_not_done():
    """Until the force law has reduced their couple, or for two seconds."""
    done = peg_plan(PEG, TASK.hole).stages[-1]
    into = TASK.hole.pose.rotation[:, 2]
    for couple, seconds, is_met in ((0.3, 1.0, False), (0.3, 2.1, True), (0.1, 0.2, True)):
        now = sensed(0.0)
        now.wrench[:3] = 12.0 * into  # at most 12 N × 14 mm = 0.17 N m by the bottom
        now.wrench[3] = couple
        watch = done.until.begin(now)
        met = False
        for _ in range(round(seconds / PERIOD)):
            now.t += PERIOD
            met = watch(now, PERIOD)
        assert met == is_met


def test_selected_axes_carry_the_forces_of_our_contacts():
    """In each stage that they replace, with the same motion; in the hole the contact is ours."""
    ours = {stage.name: stage for stage in peg_plan(PEG, TASK.hole).stages}
    stages = RIVALS[SELECTION].plan(TASK.hole).stages
    forces = {stage.name: stage.forces for stage in stages if stage.forces}
    assert forces == {
        "find": {"down": 6.0},
        "slide": {"down": 6.0},
        "drop": {"down": 6.0},
        "two points": {"down": 7.0},
        "corner": {"x": 4.0, "y": 4.0, "down": 4.0},
        "upright": {"x": 4.0, "y": 4.0, "turn": 0.0},
        "insert": {"hole": 0.0},
        "done": {"hole": 0.0},
    }
    for stage in stages:
        assert stage.motion.words == ours[stage.name].motion.words


def test_selected_axes_are_those_of_the_modelled_hole():
    X = peg_start(PEG, TASK.hole)
    R = TASK.hole.pose.rotation
    for name, k in (("x", 0), ("y", 1), ("down", 2)):
        N = selected_axes(TASK.hole)[name].contact(X, np.zeros(6)).N
        assert_allclose(N[:, 0], np.concatenate((R[:, k], np.zeros(3))), atol=1e-12)
    turn = selected_axes(TASK.hole)["turn"].contact(X, np.zeros(6)).N[:, 0]
    assert_allclose(np.abs(turn), np.concatenate((np.zeros(3), np.abs(R[:, 2]))), atol=1e-12)


@parametrize("name", list(RIVALS))
def test_every_rival_begins(name, robot):
    """Each plan fits its controller, and its first ticks are computed by its law."""
    rival = RIVALS[name]
    plan = rival.plan(TASK.hole)
    pairs = {**osc.pairs_between(PEG, TASK.hole), **selected_axes(TASK.hole)}
    controller = rival.controller(controller_for(TASK.model, pairs, plan, robot))
    assert (controller.laws.structure is None) == (rival.laws in (None, osc.Laws))
    assert bool(plan.contacts) == (rival.laws is None)
    with osc.SteppedLoop(controller, plan=plan, check=False) as loop:
        for _ in range(30):
            robot.command(loop.step(robot.measure()), PERIOD)
    assert controller.status is osc.Status.OK
    assert plan.stage.name == "weigh"


@parametrize("name", [SELECTION, "position"])
def test_rivals_press_on_the_face_that_they_find(name):
    """From 2 mm above the modelled face: by a selected axis, and by a motion that yields."""
    rival = RIVALS[name]
    into = TASK.hole.pose.rotation[:, 2]
    lower = peg_start(PEG, TASK.hole)
    lower.translation += 4e-3 * into
    robot = TASK.robot(lower)
    plan = rival.plan(TASK.hole)
    pairs = {**osc.pairs_between(PEG, TASK.hole), **selected_axes(TASK.hole)}
    controller = rival.controller(controller_for(TASK.model, pairs, plan, robot))
    with osc.SteppedLoop(controller, plan=plan, check=False) as loop:
        for _ in range(3000):
            robot.command(loop.step(robot.measure()), PERIOD)
            if plan.stage.name == "slide":
                break
    assert [verdict.failed for verdict in plan.verdicts] == [False, False], plan.reason
    force = robot.contact_forces().sum(axis=0) @ into
    assert 2.0 < abs(force) < 12.0


def test_guided_stages_press_with_half_of_our_forces_before_they_end(robot):
    plan = RIVALS["position"].plan(TASK.hole)
    into = TASK.hole.pose.rotation[:, 2]
    find = next(stage for stage in plan.stages if stage.name == "find")
    for force, is_met in ((2.9, False), (3.1, True)):
        now = sensed(0.0)
        now.wrench[:3] = force * into
        watch = find.until.begin(now)
        assert [watch(now, PERIOD) for _ in range(200)][-1] == is_met


def test_a_fault_in_a_stage_stops_the_plan_with_its_name():
    verdict = Run("wrench 100 kN for ever", 5, np.random.default_rng(2)).judge()
    assert verdict.wrong == []
    assert verdict.stopped is not None and verdict.stopped < 0.1
    assert f"stage {verdict.stage!r}" in verdict.reason
    assert 20 < len(possible()) < 60


def test_readings_of_a_task_are_checked_as_those_of_scenarios(robot):
    """A spike was believed: the estimated speed was above its limit for 20 ms, and the arm stopped.

    An encoder that jumps by one degree seemed to move; a stopped arm braked this by 147 N.
    """
    robot.sensed = sensors = FaultySensors(robot.sensed)
    model = robot.chain.model
    weight = pin.computeGeneralizedGravity(model, model.createData(), robot.q_start)

    def read(offset):
        sensors.change = lambda m: (replace(m, q=m.q + offset * np.eye(7)[3]), None)
        robot.command(weight, PERIOD)
        return robot.measure()

    for _ in range(30):
        read(0.0)
    spike = read(1.0)
    assert np.flatnonzero(np.isnan(spike.q)).tolist() == [3]
    for offset in (0.0, np.deg2rad(1.0)):
        read(offset)
        for _ in range(20):
            assert np.abs(read(offset).v).max() < 0.02


def test_a_fault_that_does_not_begin_is_not_as_it_should_be():
    run = Run("encoder NaN once", 5, np.random.default_rng(2))
    run._judge_end()  # the plan has ended before the stage of the fault
    assert "not tried" in str(run.verdict)


def test_a_peg_slips_once_it_is_pressed(robot):
    """By the whole slip, along the force on it, out of the block; encoders do not show it."""

    class InStage:
        """Plan that is in its stage."""

        class stage:
            name = "slide"

    below = TASK.true_hole.pose * pin.SE3(np.eye(3), np.array([0.03, 0.0, 1e-4]))
    pressed = TASK.robot(below)  # the tip is in the face beside the hole
    peg = SlippingPeg(pressed, InStage(), "slide", 1e-3)
    before = pressed.chain.state(pressed.measure().q).X_WO.actInv(pressed.pose())
    model = pressed.chain.model
    weight = pin.computeGeneralizedGravity(model, model.createData(), pressed.q_start)
    for _ in range(120):
        peg.command(weight, PERIOD)
    after = pressed.chain.state(pressed.measure().q).X_WO.actInv(pressed.pose())
    assert_allclose(before.translation, 0.0, atol=1e-4)
    slipped = after.translation - before.translation
    assert np.linalg.norm(slipped) == approx(1e-3, abs=1e-4)
    assert slipped[2] < -0.5e-3  # towards the gripper
    assert np.linalg.norm(peg.slipped) == approx(1e-3, abs=2e-5)


def test_a_fault_begins_within_a_stage_that_is_shorter_than_the_moment_drawn(monkeypatch):
    monkeypatch.setattr(plan_faults, "STOPPED_FOR", 0.01)
    run = Run("wrench 100 kN for ever", 5, np.random.default_rng(2))
    run._stage, run._moment = "weigh", 0.9  # which lasts 0.4 s
    verdict = run.judge()
    assert verdict.stage == "weigh"
    assert verdict.stopped is not None
    assert verdict.wrong == []


def test_noise_of_the_wrist_is_not_taken_for_a_rotor():
    """The last joint had 0.13 kg m^2 of it within 0.2 s of motion, and oscillated with 5 rad/s."""
    name = "wrist noise of 5 N"
    rng = np.random.default_rng([990121, *sha256(name.encode()).digest()])
    run = Run(name, 990150, rng)
    verdict = run.judge()
    assert verdict.wrong == [] and verdict.stopped is not None
    assert_allclose(run._controller.records.memory.joints.rotor, 0.0, atol=1e-3)


@parametrize("seed, insertion", [(930998, 931000), (770107, 770107), (770118, 770118)])
def test_brakes_are_requested_of_a_joint_whose_encoder_without_noise_is_stuck(seed, insertion):
    """The arm was stopped for another reason, and the joint swung with 9 to 20 rad/s."""
    name = "encoder stuck"
    rng = np.random.default_rng([seed, *sha256(name.encode()).digest()])
    verdict = Run(name, insertion, rng).judge()
    assert verdict.wrong == []
    assert verdict.unbraked


def test_a_stopped_arm_does_not_follow_a_drifting_encoder_into_the_face(monkeypatch):
    """The force had grown by 220 N/s since the stop, to 114 N and more."""
    name = "encoder drifts by 0.2 rad/s"
    rng = np.random.default_rng([224844, *sha256(name.encode()).digest()])
    monkeypatch.setattr(plan_faults, "STOPPED_FOR", 1.5)
    verdict = Run(name, 224847, rng).judge()
    assert verdict.wrong == [] and verdict.stopped is not None
    assert verdict.force < 70.0


def test_pegs_that_did_not_slip_are_counted_apart(monkeypatch, capsys):
    """One peg slips, one slips by a part of the distance, one does not; all three are inserted."""
    shares = iter((1.0, 0.5, 0.0))

    def insert(seed, slip):
        share = next(shares)
        peg = SlippingPeg.__new__(SlippingPeg)
        peg.slipped, peg.slipped_in = np.array([0.0, 0.0, -share * slip]), "drop" if share else ""
        return Inserted(True, "", 0.03, 0.0, 9.0, 1, 20.0, 15.0, 6.0), peg, share * slip

    monkeypatch.setattr(slipping_peg, "insert_slipping", insert)
    slipping_peg.main(count=3, seed=1)
    first, second, third, last = capsys.readouterr().out.splitlines()
    assert "slipped in 'drop' by -1.00 mm along" in first
    assert "slipped by a part only" in second
    assert "did not slip" in third
    assert last.startswith("2 of 3 did not slip by 1 mm; of the others 1 of 1; time")
    assert logging.root.manager.disable == logging.NOTSET  # other programs log as before


def test_a_recorded_result_is_read_as_it_was():
    text = '{"success": true, "reason": "", "depth": 0.03, "tilt": 0.0, "time": 9.0, "tries": 1,'
    text += ' "largest_sum": 20.0, "largest_single": 15.0, "mean_sum": 6.0}'
    expected = Inserted(True, "", 0.03, 0.0, 9.0, 1, 20.0, 15.0, 6.0)
    assert result_in({"result": np.array(text)}) == expected


def test_forces_at_both_tips_follow_from_the_lever():
    """Two forces along one direction are measured each; the sum alone, if one tip presses."""
    X = bar_start(TwoPins(3))
    now = sensed(0.0)
    now.X = X
    for direction in (INTO, SIDEWAYS):
        forces = {"left": 2.0, "right": 5.0}
        for tip, force in forces.items():
            place = X.rotation @ POINTS[tip]
            now.wrench += force * np.concatenate((direction, np.cross(place, direction)))
        for tip, force in forces.items():
            assert Press(tip, direction, 1.0, alone=False).measured(now) == approx(force, abs=1e-9)
            assert Press(tip, direction, 1.0, alone=True).measured(now) == approx(7.0)
        now.wrench[:] = 0.0


def test_a_tip_is_led_along_the_force_until_it_presses():
    X = bar_start(TwoPins(3))
    now = sensed(0.0)
    now.X = now.aim = X
    press = Press("right", INTO, 6.0, alone=True)
    place = X.rotation @ POINTS["right"]
    course = press.motion().begin(now)
    for force, share in ((0.0, 1.0), (3.0, 0.5), (6.0, 0.0)):
        now.wrench[:3] = force * INTO
        demand = course(now, PERIOD)
        assert demand.values == approx(share * osc.PhaseSettings().speed)
        V = np.arange(6.0)
        assert demand.rows[0] @ V == approx(INTO @ (V[:3] + np.cross(V[3:], place)))


def test_guided_stages_have_the_forces_of_ours():
    stages = two_pin_plan(TwoPins(3)).stages
    found = {stage.name: presses_of(stage) for stage in stages if len(stage.forces) == 2}
    stated = {
        name: [(press.tip, press.force, press.alone) for press in presses]
        for name, presses in found.items()
    }
    assert stated == {
        "find": [("left", 6.0, False), ("right", 6.0, False)],
        "slide": [("left", 6.0, False), ("right", 6.0, False)],
        "left rim": [("left", 5.0, True), ("right", 6.0, True)],
        "turn": [("left", 5.0, True), ("right", 6.0, True)],
        "corner": [("left", 5.0, False), ("right", 5.0, False)],
        "upright": [("left", 5.0, False), ("right", 5.0, False)],
    }
    guided = guided_plan(TwoPins(3)).stages
    names = [stage.name for stage in stages]
    names.insert(names.index("insert"), "release")
    assert [stage.name for stage in guided] == names
    assert not any(stage.forces for stage in guided)


@parametrize("name", ["impedance, 600 N/m", "admittance", "position"])
def test_laws_without_contacts_begin_with_two_arms(name):
    task = TwoPins(3)
    plan = guided_plan(task)
    robot = task.robot(bar_start(task))
    controller = controlled_by(LAWS[name](), controller_for(task.model, {}, plan, robot))
    with osc.SteppedLoop(controller, plan=plan, check=False) as loop:
        for _ in range(30):
            robot.command(loop.step(robot.measure()), PERIOD)
    assert controller.status is osc.Status.OK
