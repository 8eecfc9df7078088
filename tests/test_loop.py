"""The control loop: hardware without a truth, judges, own controllers, recorders without end."""

from dataclasses import replace
from itertools import islice, repeat

import numpy as np
from complaints import invalid_input, recording_error
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, mark, raises
from scenario_runs import assert_same_run, rig_of

import osc_contact as osc
from osc_contact.runs.run import start

TICKS = 30


RIGID = ("two_contact_rod", "plant.type=rigid", "plant.step=1 ms")


def plan(rig, ticks=TICKS):
    return rig.references.over(np.arange(ticks) * 1e-3)


def started(*scenario):
    """A rig, its plant and its controller."""
    rig = rig_of(*scenario)
    return rig, *start(rig)


class Hardware:
    """A robot as a driver offers it: no truth, no start to choose; a plant plays the machine."""

    def __init__(self, plant, broken_at=None):
        self._plant = plant
        self.broken_at = broken_at
        self.sent = []
        self.stopped = 0

    def measure(self):
        return self._plant.measure()

    def command(self, tau, duration):
        if len(self.sent) == self.broken_at:
            raise ConnectionError("the cable is out")
        self.sent.append((tau, duration))
        self._plant.command(tau, duration)

    def stop(self, reason=""):
        self.stopped += 1


@mark.parametrize("scenario", [RIGID, RIGID[:1]], ids=["rigid", "mujoco"])
def test_a_plant_in_the_loop_leaves_what_run_leaves(scenario):
    rig, plant, controller = started(*scenario)
    recorder = osc.Recorder(controller, plant, subject=rig.subject(controller))
    osc.run_loop(plant, controller, plan(rig), recorder=recorder)
    assert_same_run(recorder.recording(), osc.run(rig.scenario, duration=TICKS * 1e-3))


def test_hardware_without_a_truth_leaves_a_recording():
    rig, plant, controller = started(*RIGID)
    robot = Hardware(plant)
    truths = []

    class Both(osc.Recorder):
        def append(self, *tick):
            super().append(*tick)
            truths.append(plant.truth())

    recorder = Both(controller)
    osc.run_loop(robot, controller, plan(rig), recorder=recorder)
    found = recorder.recording({"where": "cell 3"})
    assert robot.stopped == 1 and len(robot.sent) == TICKS
    assert "alpha_true" not in found and found.meta["where"] == "cell 3"
    assert_array_equal(found["tau"], [tau for tau, _ in robot.sent])
    assert {duration for _, duration in robot.sent} == {1e-3}
    assert_allclose(found["pose"][:, :3], [truth.X_WO.translation for truth in truths], atol=1e-12)
    assert_allclose(found["twist"], [truth.V_O for truth in truths], atol=1e-9)
    alpha = [truth.alpha for truth in truths]  # the forces rise from nothing
    assert_allclose(found["alpha_meas"], alpha, rtol=1e-6, atol=1e-12)
    N = [pair.contact(truths[-1].X_WO, np.zeros(6)).N for pair in rig.pairs]
    assert_allclose(found["N"][-1], np.hstack(N), atol=1e-12)
    assert found["closed"].all() and found.magnitude_names == ["left_end", "right_end"]
    with recording_error("no judge took part"):
        osc.metrics(found)


def test_measured_faces_take_part_without_a_judge():
    rig, plant, controller = started("moving_face", "plant.type=rigid")
    recorder = osc.Recorder(controller, subject=rig.subject(controller))
    osc.run_loop(Hardware(plant), controller, plan(rig), recorder=recorder)
    ours = recorder.recording()
    run = osc.run(rig.scenario, duration=TICKS * 1e-3)
    for channel in ("face_pose", "N", "contact_point", "pose"):
        assert_allclose(ours[channel], run[channel], atol=1e-9, err_msg=channel)
    assert np.ptp(ours["face_pose"][:, 0, :3], axis=0).max() > 1e-7


def test_the_robot_is_stopped_when_the_loop_ends_badly():
    rig, plant, controller = started(*RIGID)
    robot = Hardware(plant, broken_at=5)
    recorder = osc.Recorder(controller)
    with raises(ConnectionError):
        osc.run_loop(robot, controller, plan(rig), recorder=recorder)
    assert robot.stopped == 1 and len(recorder.recording()) == 6


def test_ticks_that_are_held_are_recorded_and_do_not_end_the_loop():
    rig, plant, _ = started(*RIGID)

    class Deaf(Hardware):
        def measure(self):
            read = super().measure()
            if len(self.sent) in (0, 9):
                return replace(read, q=read.q * np.nan)
            return replace(read, v=read.v[:3]) if len(self.sent) == 4 else read

    controller = rig.controller()  # held before its first tick
    recorder = osc.Recorder(controller)
    osc.run_loop(Deaf(plant), controller, plan(rig), recorder=recorder)
    found = recorder.recording()
    assert found["status"].tolist() == [2 if k in (0, 4, 9) else 0 for k in range(TICKS)]
    assert np.isnan(found["q"][[0, 4, 9]]).all() and np.isfinite(found["tau"]).all()
    assert np.isfinite(found["pose"][10:]).all()


def test_references_may_have_no_end_and_the_controller_may_be_ones_own():
    rig, plant, _ = started(*RIGID)
    asked = []
    shown = []

    class Hold:
        dt = 2e-3

        def tick(self, measurement, reference):
            asked.append(reference)
            return np.zeros(rig.chain.n_a)

    robot = Hardware(plant)
    endless = repeat(rig.references.at(0.0))
    osc.run_loop(robot, Hold(), islice(endless, 200), progress=shown.append)
    assert len(asked) == 200 and {duration for _, duration in robot.sent} == {2e-3}
    assert shown == approx([0.2, 0.4])


def test_a_viewer_needs_what_is_recorded():
    rig, plant, controller = started(*RIGID)

    class Viewer:
        def show(self, tick):
            seen.append({name: np.array(tick[name]) for name in tick})

    seen = []
    with invalid_input("recorder"):
        osc.run_loop(plant, controller, plan(rig), viewer=Viewer())
    recorder = osc.Recorder(controller)
    osc.run_loop(Hardware(plant), controller, plan(rig, 3), recorder=recorder, viewer=Viewer())
    recording = recorder.recording()
    assert len(seen) == 3 and len(seen[0]) > 10 and seen[2]["N"].shape == (6, 2)
    for k, tick in enumerate(seen):
        for name, value in tick.items():
            assert_allclose(value, recording[name][k], atol=1e-14, err_msg=name)
