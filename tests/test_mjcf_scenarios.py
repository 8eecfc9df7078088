"""MJCF arms in scenarios: on both plants, drawn, checked, and refused where joints are coupled."""

import mujoco
import numpy as np
from command_line import call, done
from complaints import model_error
from numpy.testing import assert_allclose
from pytest import approx, mark

import osc_contact as osc
from osc_contact import robots

TASK = """
name: from_mjcf
arms:
  - {name: arm, urdf: arm.xml, tip: TIP, wrist_sensor: wrist,
     posture: [0.3, -0.8, 1.2, 0.4, -0.7, 0.2]}
object: {urdf: stylus.urdf}
grasps: {arm: {}}
contacts:
  - name: ball
    type: vertex_on_face
    vertex: [0, 0, 80 mm]
    radius: 8 mm
    face: {urdf: face.urdf, point: POINT, normal: NORMAL}
force: {ball: [{type: constant, value: 5 N}]}
gains: {motion: {stiffness: 400, damping: 40}, force: {integral: 30, damping: 50}}
control: {rate: 1 kHz}
plant: {type: mujoco, step: 0.25 ms}
duration: 1.6 s
"""
SIX = """
<mujoco>
  <compiler angle="radian"/>
  <default>
    <joint armature="0.05" damping="0.3" frictionloss="0.1" limited="true" range="-3 3"/>
  </default>
  <worldbody>
    <body name="other" pos="3 0 0"><freejoint/><geom size="0.1" mass="1"/></body>
    <body name="base" pos="0 0.1 0.2">
      <geom size="0.1" mass="2"/>
      <body name="j1" pos="0 0 0.1">
        <joint name="j1" axis="0 0 1"/><geom type="cylinder" size="0.05 0.1" mass="3"/>
        <body name="j2" pos="0 0 0.1">
          <joint name="j2" axis="0 1 0" pos="0 0 0.02" ref="0.2"/>
          <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.04" mass="3"/>
          <body name="j3" pos="0.3 0 0">
            <joint name="j3" axis="0 1 0"/>
            <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.03" mass="2"/>
            <body name="j4" pos="0.25 0 0">
              <joint name="j4" axis="1 0 0"/><geom size="0.03" mass="0.6"/>
              <body name="j5">
                <joint name="j5" axis="0 1 0"/><geom size="0.03" pos="0.05 0 0" mass="0.5"/>
                <body name="hand" pos="0.08 0 0" euler="0 1.2 0">
                  <joint name="j6" axis="0 0 1"/>
                  <geom type="box" size="0.02 0.03 0.02" mass="0.3"/>
                  <site name="wrist" pos="0 0 0.01" euler="0 0 0.5"/>
                  <site name="tip" pos="0 0 0.03"/>
                  <body name="finger" pos="0 0.02 0.03">
                    <joint name="grip" type="slide" axis="0 1 0"/>
                    <geom size="0.01" mass="0.05"/>
                  </body>
                </body>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="j1" ctrllimited="true" ctrlrange="-80 80"/></actuator>
  EQUALITY
</mujoco>"""


def arm(folder, old="", new="", equality=""):
    """The file of SIX, with a change and an equality."""
    file = folder / "arm.xml"
    file.write_text(SIX.replace("EQUALITY", equality).replace(old, new, 1))
    return file


def task(folder, tip="tip", *changes):
    """A scenario whose arm is SIX; the face lies where MuJoCo itself puts the stylus."""
    mj = mujoco.MjModel.from_xml_path(str(arm(folder)))
    data = mujoco.MjData(mj)
    for k, x in enumerate((0.3, -0.8, 1.2, 0.4, -0.7, 0.2), 1):
        data.joint(f"j{k}").qpos[:] = x
    mujoco.mj_kinematics(mj, data)
    at = data.site("tip") if tip == "tip" else data.body(tip)
    out = -at.xmat[2::3]
    text = TASK.replace("TIP", tip).replace("NORMAL", str(out.tolist()))
    file = folder / "task.yaml"
    file.write_text(text.replace("POINT", str((at.xpos - 0.088 * out).tolist())))
    return osc.load_scenario(file, changes)


@mark.parametrize("tip", ["tip", "hand"])
def test_a_scenario_takes_an_mjcf_file(tmp_path, tip):
    scenario = task(tmp_path, tip)
    rig = osc.build_rig(scenario)
    assert osc.preflight(rig) == ()
    assert np.linalg.norm(rig.state().X_WO.translation - rig.X_given.translation) < 1e-9
    verdict = osc.metrics(osc.run(scenario))
    assert verdict["task"]["word"] == "OK" and verdict["contact_fraction"] == {"ball": 1.0}
    assert verdict["force"]["ball"]["rms_error_rel"] < 0.01
    exact = osc.run(scenario.replaced(plant={"type": "rigid", "step": 1e-3}))
    assert_allclose(exact["alpha_true"][-1], 5.0, rtol=1e-3)


def test_both_plants_accelerate_an_arm_from_mjcf_alike(tmp_path):
    """Free fall from a posture, damping included, two joints and a finger held where told."""
    scenario = task(
        tmp_path,
        "tip",
        "contacts=[]",
        "force={}",
        "arms.arm.locked_joints={grip: 4 mm, j2: -0.8, j4: 0.4}",
        "arms.arm.posture=[0.3, 1.2, -0.7, 0.2]",
        "arms.arm.friction=0 Nm",
        "plant.step=0.05 ms",
    )

    def fallen(scenario):
        rig = osc.build_rig(scenario)
        plant = rig.plant()
        plant.command(np.zeros(4), 0.02)
        read = plant.measure()
        assert np.abs(read.q - rig.q_start).max() > 1e-3
        return read

    ours = fallen(scenario)
    theirs = fallen(scenario.replaced(plant={"type": "rigid", "step": 5e-5}))
    assert_allclose(ours.q, theirs.q, atol=1.5e-5)
    assert_allclose(ours.wrenches, theirs.wrenches, atol=0.05)


def test_check_describes_it_and_refuses_with_exit_code_1(tmp_path):
    file = arm(tmp_path)
    report = robots.check_robot(file)
    assert report.sound and report.reader_difference < 1e-12
    assert report.summary.dof == 7 and report.summary.mass == approx(12.45)
    assert [joint.kind for joint in report.summary.joints] == 6 * ["revolute"] + ["prismatic"]
    assert report.summary.joints[0].effort == 80.0 and np.isinf(report.summary.joints[1].effort)
    assert "sound" in done(f"check {file} --tip tip").stdout
    refused = call("check", arm(tmp_path, 'name="j3"', 'name="j3" stiffness="5"'))
    assert refused.exit_code == 1 and "spring of 5" in refused.stdout


def test_joints_that_follow_others_on_the_way_to_the_tip_are_refused(tmp_path):
    how = {"name": "a", "tip": "tip"}
    follows = '<equality><joint joint1="{}" joint2="j2"/></equality>'
    file = arm(tmp_path, equality=follows.format("j3"))
    with model_error("'j3' on the way to the tip follows joint 'j2'"):
        osc.Arm.from_mjcf(file, **how)
    both = {"j2": 0.1, "j3": 0.1}
    assert osc.Arm.from_urdf(file, locked=both, **how).model.nv == 4
    file = arm(tmp_path, equality=follows.format("grip"))
    assert osc.Arm.from_mjcf(file, **how).model.nv == 6
