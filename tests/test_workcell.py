"""Everything on: what the workcell promises, in runs short enough for a test."""

import numpy as np
from command_line import read_json
from complaints import invalid_input
from numpy.testing import assert_allclose
from pytest import fixture
from scenario_runs import run_of, worst_force

import osc_contact as osc
from osc_contact.dynamics.chain_state import modes
from osc_contact.runs.hardware import flexible_joints
from paper import workcell
from paper.studies import write_study
from paper.study import Ask
from paper.workcell import STAGES, ladder


def test_the_workcell_is_real_in_every_respect():
    scenario = osc.load_scenario("workcell")
    rig = osc.build_rig(scenario)
    joints = flexible_joints(scenario, rig.chain, rig.state())
    assert 3.0 <= modes(rig.state(), rig.chain.actuated, joints.stiffness)[0] <= 10.0
    sensors = scenario.sensors
    plant = scenario.plant
    assert None not in (sensors.encoder, sensors.joint_torque, sensors.wrist, sensors.vision)
    assert plant.friction == 0.1 and plant.motors is not None and plant.joint_friction > 0.0
    for contact in scenario.contacts:
        turn = contact.face.motion.turn
        assert abs(np.dot(turn.axis, contact.face.normal)) < 1e-5  # the normal turns by all of it


#: Both faces move 20 mm and turn by 5° at once, as soon as contact is made.
SOON = [
    f"contacts.{side}_end.face.motion.{moved}signals.0.start=0.8 s"
    for side in ("left", "right")
    for moved in ("", "turn.")
]


@fixture(scope="module")
def everything():
    moved = [change.replace("start=0.8 s", "duration=2 s") for change in SOON]
    return run_of("workcell", *SOON, *moved, duration=3.2, seed=1)


def test_forces_survive_everything_while_the_faces_move(everything):
    verdict = osc.metrics(everything)
    assert worst_force(verdict) <= 0.08
    assert set(verdict["contact_fraction"].values()) == {1.0}
    assert verdict["status"]["held"] == 0
    travel = everything["face_pose"][-1, :, :3] - everything["face_pose"][0, :, :3]
    assert_allclose(np.linalg.norm(travel, axis=1), 0.02, rtol=1e-3)
    first, last = everything["face_pose"][[0, -1], :, 3:]
    cosine = np.abs(np.sum(first * last, axis=1))  # of half the angle between quaternions
    assert_allclose(2 * np.arccos(cosine), np.deg2rad(5.0), rtol=1e-3)


def test_the_monitor_raises_no_false_alarm(everything):
    settled = everything["t"] > 0.8
    assert everything["contact_seen"][settled].all()
    assert not everything["collision_seen"][settled].any()


def test_ideal_parts_cost_nothing_and_the_rest_is_named():
    (nothing,) = ladder(["nothing"], Ask(duration=1.5))
    assert nothing.worst("rms_error_rel") < 2e-3
    with invalid_input("everything"):
        list(ladder(["anything"], Ask()))
    assert set(STAGES) >= {"joints", "sensors", "contact friction", "everything"}


def test_the_study_tells_and_draws_what_a_part_costs(tmp_path, monkeypatch):
    stage = "joints, no torque loop"
    monkeypatch.setattr(workcell, "STAGES", {stage: STAGES[stage]})
    study, written = write_study("workcell", tmp_path, Ask(duration=1.2))
    told = read_json(tmp_path / "workcell.json")[stage]
    assert told["force_rms_rel"] is None or told["force_rms_rel"] > 0.25
    assert all(path.is_file() for path in written) and study.table.row_count == 1
