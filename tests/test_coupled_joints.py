"""Joints and sensors out of the ordinary: mimics, endless joints, a wrist that carries nothing."""

import numpy as np
import pinocchio as pin
from complaints import model_error
from numpy.testing import assert_allclose
from pytest import fixture, mark
from rigs import panda_arm, ticked

import osc_contact as osc

LINK = (
    '<link name="{0}"><inertial><mass value="1"/><origin xyz="0 0 0.1"/>'
    '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)
JOINT = (
    '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/><origin xyz="0 0 0.2"/>'
    '<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="10" velocity="3"/>{4}</joint>'
)


@fixture
def urdf(tmp_path):
    """A chain a, b, c, then a gripper g beside c; b and g follow a's joint; c has no end stops."""
    follows = '<mimic joint="ja" multiplier="-1"/>'
    parts = ['<link name="base"/>', *(LINK.format(name) for name in "abcg")]
    parts += [
        JOINT.format("ja", "revolute", "base", "a", ""),
        JOINT.format("jb", "revolute", "a", "b", follows),
        JOINT.format("jc", "continuous", "b", "c", ""),
        JOINT.format("jg", "revolute", "b", "g", follows),
    ]
    file = tmp_path / "mimic.urdf"
    file.write_text(f'<robot name="r">{"".join(parts)}</robot>')
    return file


def test_a_joint_that_follows_another_one_on_the_way_to_the_tip_is_refused_with_the_cure(urdf):
    for file in (urdf, pin.buildModelFromUrdf(str(urdf), mimic=True)):
        with model_error(r"'jb' on the way .* follows joint 'ja'.* Lock"):
            osc.Arm.from_urdf(file, name="arm", tip="c")


def test_before_it_or_with_both_locked_the_arm_is_there(urdf, caplog):
    """Followers that the tip does not need are held; masters that move the tip are reported."""
    assert list(osc.Arm.from_urdf(urdf, name="arm", tip="a").model.names)[1:] == ["ja"]
    assert "joint 'jg' follows 'ja', which moves the tip; it is locked at 0" in caplog.text
    caplog.clear()
    arm = osc.Arm.from_urdf(urdf, name="arm", tip="c", locked={"ja": 0.2, "jb": -0.2})
    assert not caplog.text
    assert list(arm.model.names)[1:] == ["jc"]
    assert np.isinf(arm.model.upperPositionLimit).all()


def test_a_model_with_an_endless_joint_of_its_own_is_refused_with_the_cure(urdf):
    model = pin.buildModelFromUrdf(str(urdf))
    with model_error("nq = 2 but nv = 1; load the URDF by its path"):
        osc.Arm.from_urdf(model, name="arm", tip="c")


@mark.parametrize("reading", ["filter", "least_squares", None])
def test_a_wrist_sensor_with_nothing_beyond_it_reads_the_contact_wrench(reading):
    """7 N on the tip of a Panda, whose sensor sits in the massless frame of the tip."""
    chain = osc.ClosedChain([panda_arm(wrist_sensor="panda_hand_tcp")])
    q = np.array([0.0, -0.7, 0.2, -2.2, 0.1, 1.6, 0.7])
    state = chain.state(q, np.zeros(7))
    p = state.X_WO.translation
    R = state.X_WO.rotation
    face = osc.VertexOnFace([0, 0, 0], p, [0, 0, 1], name="face")
    controller = osc.Controller(chain, [face], posture=q, reading=reading)
    wrench = np.concatenate((R.T @ [0.0, 0.0, -7.0], np.zeros(3)))  # of the arm on the surface
    reference = osc.pose_reference(p, R, alpha_d=[10.0])
    for _ in range(3):
        ticked(controller, osc.Measurement(q, np.zeros(7), wrench[None]), reference)
        assert_allclose(controller.result().alpha_meas, 7.0, atol=1e-9)
