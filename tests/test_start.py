"""Where runs start: inverse kinematics within limits, and the pose that the posture gives."""

import numpy as np
import pinocchio as pin
from complaints import model_error
from numpy.testing import assert_allclose
from pytest import mark
from scenario_runs import rig_of

import osc_contact as osc
from osc_contact.dynamics.assembly import reach


def test_inverse_kinematics_keeps_joint_limits_and_finds_postures_all_the_same():
    """A Panda is sent from one random posture to the pose of another, 60 times."""
    chain = rig_of("panda_edge").chain
    low = chain.model.lowerPositionLimit
    high = chain.model.upperPositionLimit
    rng = np.random.default_rng(3)
    missed = []
    for _ in range(60):
        start, goal = rng.uniform(low, high, (2, chain.nq))
        pin.framesForwardKinematics(chain.model, chain.data, goal)
        X = chain.object_pose()
        q = reach(chain, start, X)
        assert np.all(q >= low) and np.all(q <= high)
        pin.framesForwardKinematics(chain.model, chain.data, q)
        missed.append(np.linalg.norm(chain.object_pose().translation - X.translation))
    assert np.mean(np.array(missed) < 1e-4) > 0.3  # the rest would have to go round end stops


@mark.parametrize("name", ["two_contact_rod", "ur5_wipe", "three_arm_plate"])
def test_the_object_is_where_the_posture_puts_it_unless_the_file_says(name):
    scenario = osc.load_scenario(name, ["object.pose=null"])
    rig = osc.build_rig(scenario)
    arm = scenario.arms[0]
    one = rig.chain.arms[0]
    data = one.model.createData()
    pin.framesForwardKinematics(one.model, data, np.array(arm.posture))
    tip = data.oMf[one.model.getFrameId(arm.tip)]
    grasp = scenario.grasps[arm.name]
    held = pin.SE3(pin.rpy.rpyToMatrix(*grasp.rpy), np.array(grasp.xyz))
    assert_allclose((one.base * tip * held).homogeneous, rig.X_given, atol=1e-12)


def test_a_scenario_whose_posture_says_where_it_starts_runs_without_a_word():
    rig = rig_of("two_contact_rod", "object.pose=null")
    assert osc.preflight(rig) == ()
    given = rig_of()
    assert np.linalg.norm(given.state().X_WO.translation - rig.state().X_WO.translation) < 1e-3


def test_where_no_arm_tells_the_pose_it_must_be_given():
    changes = ["object.pose=null", "grasps.left.type=ball", "grasps.left.axis=null"]
    with model_error("pose"):
        rig_of("hinge_ball_rod", *changes)
