"""Drift of an encoder that no weight shows: that of a joint whose axis is vertical.

Speeds are estimated from encoders. Motors and wrist of an arm off contacts depend on the posture by
gravity alone, which a turn about a vertical axis leaves as it is.
"""

import numpy as np
import pinocchio as pin
from numpy.random import default_rng
from rigs import assert_near, largest
from samples import parametrize
from scenario_runs import rig_of

#: scenario and joint; whether its axis is vertical at the start
JOINTS = (("panda_wrist", 0, True), ("panda_wrist", 5, False), ("two_contact_rod", 3, True))


def weights(arm, q):
    """Torques that hold an arm, as shares of the limits, and gravity in its wrist's axes (m/s²)."""
    model, data = arm.model, arm.model.createData()
    pin.framesForwardKinematics(model, data, q)
    wrist = data.oMf[model.getFrameId(arm.wrist_sensor)].rotation
    limits = np.where(model.effortLimit > 0.0, model.effortLimit, 1.0)
    torques = pin.computeGeneralizedGravity(model, data, q)
    return (torques / limits, wrist.T @ model.gravity.linear)


@parametrize("scenario, joint, is_vertical", JOINTS)
def test_weights_do_not_show_a_turn_about_a_vertical_axis(scenario, joint, is_vertical):
    """Bodies beyond the wrist turn with it: the object's weight is one more of the same kind."""
    rig = rig_of(scenario)
    arm = rig.model.arms[0]
    q = rig.q_start[: arm.model.nq]
    torques, gravity = weights(arm, q)
    for angle in default_rng(54).uniform(-1.0, 1.0, 8):
        other_torques, other_gravity = weights(arm, q + angle * (np.arange(len(q)) == joint))
        if is_vertical:
            assert_near(other_torques, torques, atol=1e-12)
            assert_near(other_gravity, gravity, atol=1e-12)
        else:
            assert largest(other_gravity - gravity) > 3.0 * abs(angle)  # 9.81 m/s², not across
