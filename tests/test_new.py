"""`osc-contact new`: a scenario for any arm, which runs and is OK."""

import numpy as np
import yaml
from command_line import done, refused
from numpy.testing import assert_allclose
from pytest import approx, mark
from samples import chosen

import osc_contact as osc
from osc_contact import robots
from osc_contact.runs.drafts import Press, _text

ARMS = {
    "ur10": ("tool0", "Z=15"),
    "panda": ("panda_hand_tcp", "Z=15"),
    "xarm": ("link_eef", "-X=10"),
    "so100": ("jaw", "Z=3"),
    "kinova": ("j2s6s200_end_effector", "Z=10"),
    "z1": ("gripperStator", "X=10"),
    "baxter": ("left_gripper", "Z=10"),
    "tiago_pro": ("arm_left_tool_link", "Z=10"),
    "talos_left_arm": ("wrist_left_ft_tool_link", "Z=10"),
}


@mark.parametrize("robot", chosen(list(ARMS), "ur10", "xarm", "so100", "baxter"))
def test_what_it_writes_runs_and_is_ok(robot, tmp_path):
    tip, press = ARMS[robot]
    file = tmp_path / "my.yaml"
    done(f"new --robot {robot} --tip {tip} --press={press} --out", file)
    scenario = osc.load_scenario(file)
    rig = osc.build_rig(scenario)
    assert osc.preflight(rig) == ()
    verdict = osc.metrics(osc.run(scenario, seed=1))
    assert verdict["task"]["word"] == "OK" and verdict["contact_fraction"] == {"ball": 1.0}
    wanted = Press.parse(press)
    assert verdict["force"]["ball"]["mean_command_N"] == approx(wanted.force)
    assert verdict["force"]["ball"]["rms_error_rel"] < 0.05
    chain = rig.chain
    chain.state(rig.q_contact, np.zeros(chain.nq))
    pressed = chain.tip_poses()[0].rotation @ np.array(wanted.axis)
    assert_allclose(pressed, -np.array(scenario.contacts[0].face.normal), atol=1e-4)


def test_the_command_line_runs_what_it_wrote_and_keeps_files_of_others(tmp_path):
    file = tmp_path / "arm.yaml"
    line = "new --robot ur10 --tip tool0 --posture '0, -90 deg, 90 deg, -90 deg, -90 deg, 0' --out"
    done(line, file)
    assert "exists; give another file" in refused(line, file)
    assert "verdict: OK" in done("run", file, "--out", tmp_path / "out").stdout


@mark.parametrize(
    "words, said",
    [
        ("ur10 --press W=3", "an axis of the tip and newtons, such as Z=15"),
        ("ur10 --press Z=-3", "an axis of the tip and newtons"),
        ("ur10 --press Z=5000", "times their limits"),
        ("ur10 --posture '1, 2'", "2 numbers for 6 joints"),
        ("ur11", "no robot 'ur11'"),
        ("panda", "has 3 ends"),
    ],
)
def test_what_cannot_be_is_told_and_nothing_is_written(words, said, tmp_path):
    assert said in refused(f"new --robot {words} --out", tmp_path / "x.yaml")
    assert not list(tmp_path.iterdir())


def test_a_plane_wall_has_an_exact_normal():
    """Six digits of the posture turn the tip by 1e-6; on such a wall motions would be screws."""
    urdf, _ = robots.find_robot("ur10")
    arm = osc.Arm.from_urdf(urdf, name="ur10", tip="tool0")
    q = np.round(np.deg2rad([0.0, -30.0, -30.0, -30.0, -90.0, 0.0]), 6)
    data = yaml.safe_load(_text("ur10", arm, Press.parse("Z=15"), q))
    normal = data["contacts"][0]["face"]["normal"]
    assert sorted(np.abs(normal)) == [0.0, 0.0, 1.0]
    slanted = yaml.safe_load(_text("ur10", arm, Press.parse("Z=15"), q + 0.3))
    normal = np.array(slanted["contacts"][0]["face"]["normal"])
    assert np.linalg.norm(normal) == approx(1.0, abs=1e-6) and np.abs(normal).min() > 1e-3
