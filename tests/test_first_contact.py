"""A guarded approach from further away than a contact is usually begun: docs/own_loop.md's arm."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

import osc_contact as osc
from osc_contact.scenarios.control_schema import PhaseSettings

PAGE = (Path(__file__).parents[1] / "docs" / "own_loop.md").read_text(encoding="utf-8")
MJCF = re.search(r'MJCF = """\n(.*?)"""', PAGE, re.DOTALL)
LOW = np.array([-0.39, 0.9, 0.6])


def approach(height, seconds):
    """The arm begins `height` (m) above its table; the force at the end (N), and its highest."""
    assert MJCF is not None
    model = mujoco.MjModel.from_xml_string(MJCF[1])
    data = mujoco.MjData(model)
    arm = osc.Arm.from_mjcf(model, name="arm", tip="tip", wrist_sensor="sensor")
    chain = osc.ClosedChain([arm])
    table = osc.VertexOnFace([0, 0, 0], point=[0.5, 0, 0.2], normal=[0, 0, 1], radius=0.01)
    home = LOW.copy()
    for _ in range(50):  # the shoulder alone lifts the tip
        gap = table.gap(chain.state(home, np.zeros(3)).X_WO)
        home[0] -= (height - gap) / 0.75
    controller = osc.Controller(chain, [table], posture=home, life=PhaseSettings())
    data.qpos[:] = home
    mujoco.mj_forward(model, data)
    start = chain.state(home, np.zeros(3)).X_WO
    aim = osc.pose_reference(start.translation, start.rotation, alpha_d=[8.0])
    force = np.zeros(6)
    highest = 0.0
    for _ in range(round(1e3 * seconds)):
        wrench = data.sensordata.reshape(1, 6).copy()
        measured = osc.Measurement(data.qpos.copy(), data.qvel.copy(), wrench)
        data.ctrl[:] = controller.tick(measured, aim)
        for _ in range(2):
            mujoco.mj_step(model, data)
        force[0] = 0.0
        if data.ncon:
            mujoco.mj_contactForce(model, data, 0, force)
        highest = max(highest, force[0])
    return controller, float(force[0]), highest


@pytest.mark.parametrize("height", [0.006, 0.020, 0.033])
def test_an_approach_lands_from_any_height_within_its_travel(height):
    controller, force, highest = approach(height, 1.5 + height / 0.01)
    assert controller.state is osc.SafetyState.RUN, controller.reason
    assert force == pytest.approx(8.0, rel=0.02)
    assert highest < 16.0


def test_an_approach_that_has_used_up_its_travel_stands_still():
    controller, force, _ = approach(0.070, 8.0)
    assert controller.state is osc.SafetyState.RUN, controller.reason
    assert force == 0.0 and controller.phases().tolist() == [1]
