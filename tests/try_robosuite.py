"""`make worlds`: the composite controller, on the installed robosuite.

Not collected by `make test`, whose environment has no robosuite.
"""

import re
from pathlib import Path

import mujoco
import numpy as np
import robosuite
from pytest import approx, fixture, mark, raises

import osc_contact as osc
from benchmarks.dragged_pad import dragged, pad_alone
from benchmarks.wiping import ARM, OscPose, Ours, Wiping, normal_force, try_wiping
from osc_contact.robosuite import osc_contact_config

PAGE = Path(__file__).parent.parent / "docs" / "robosuite.md"
TABLE = osc.VertexOnFace([0, 0, 0], point=[0, 0, 0.9], normal=[0, 0, 1], name="table")


def environment(config, name="Wipe", robots="Panda", **options):
    """An environment without pictures, after its reset."""
    np.random.seed(0)  # robosuite draws postures and markers from it
    unseen = {"has_renderer": False, "has_offscreen_renderer": False, "use_camera_obs": False}
    env = robosuite.make(
        name, robots, controller_configs=config, ignore_done=True, **unseen, **options
    )
    env.reset()
    return env


def table_force(env, robot=0):
    """Sum of normal forces between a robot's gripper and the table (N)."""
    model = env.sim.model._model
    names = [model.geom(k).name for k in range(model.ngeom)]
    words = (f"gripper{robot}", "table")
    tool, table = (np.array([word in name for name in names]) for word in words)
    return normal_force(model, env.sim.data._data, tool, table)


def test_the_program_of_the_page_prints_what_is_shown(capsys):
    program, shown = re.search(
        r"```python\n(.*?)```\n\n```text\n(.*?)```", PAGE.read_text(), re.DOTALL
    ).groups()
    exec(compile(program, str(PAGE), "exec"), {})
    assert capsys.readouterr().out == shown


def test_wiping_at_unknown_height_and_friction_succeeds():
    wiped = try_wiping("ours", Ours(), seed=0)
    assert wiped.success and wiped.end == "OK"
    assert wiped.mean == approx(12.0, abs=0.1) and wiped.aside < 0.5 and wiped.landing < 20.0


def test_thirty_newtons_on_a_smooth_table_are_constant():
    wiped = try_wiping("ours", Ours(), seed=1, force=30.0, friction=0.03)
    assert wiped.success and wiped.raw < 0.02 * 30.0


def test_the_pad_that_is_dragged_alone_lies_flat():
    task = Wiping(OscPose(75.0, 0.009), 0)
    model, data = task.env.sim.model._model, task.env.sim.data._data
    site = task.env.robots[0].eef_site_id[ARM]
    forces, corners = dragged(pad_alone(model, data, site, 15.0, 0.1), 12.0, 0.0)
    assert forces == approx(12.0, rel=1e-3) and corners == approx(4.0, rel=0.02)


@mark.parametrize("light", [True, False])
def test_displacements_move_and_press(light):
    config = osc_contact_config("Panda", [TABLE], action="displacement", most_force=40.0)
    env = environment(config, lite_physics=light)
    controller = env.robots[0].composite_controller
    low, high = env.action_spec
    assert list(low) == [-1.0] * 7 and list(high) == [1.0] * 7
    before = controller.pose("right")
    for _ in range(4):
        env.step([0.2, 0, -0.7, 0, 0, 0, -1.0])
    for _ in range(30):
        env.step([0, 0, 0, 0, 0, 0, -1.0])
    assert controller.pose("right")[:3] - before[:3] == approx([0.04, 0, -0.14], abs=2e-3)
    for _ in range(80):
        env.step([0, 0, 0, 0, 0, 0, -0.5])
    assert table_force(env) == approx(10.0, abs=0.2)


def lifted(env, arms):
    """Rise (m) of arms that are sent 50 mm upwards; everything else is given zeros."""
    controller = env.robots[0].composite_controller
    poses = {arm: controller.pose(arm) for arm in arms}
    action = np.zeros(env.action_dim)
    for arm in arms:
        part = slice(*controller._action_split_indexes[arm])
        action[part] = poses[arm] + [0, 0, 0.05, 0, 0, 0]
    for _ in range(60):
        env.step(action)
    return [controller.pose(arm)[2] - poses[arm][2] for arm in arms]


def test_arms_of_one_robot():
    """Both arms, or one beside an arm and hands that obey robosuite's controllers."""
    for arms in (["right", "left"], ["left"]):
        config = osc_contact_config("GR1ArmsOnly", {arm: [] for arm in arms})
        env = environment(config, "Lift", "GR1ArmsOnly")
        assert lifted(env, arms) == approx([0.05] * len(arms), abs=1e-3)
        assert set(env.robots[0].composite_controller.loops) == set(arms)


def test_two_robots_press_with_forces_of_their_own():
    def top(sim):
        point = np.array(sim.data.get_site_xpos("table_top"))
        return [osc.VertexOnFace([0, 0, 0], point=point, normal=[0, 0, 1], name="table")]

    configs = [osc_contact_config("Panda", top) for _ in range(2)]
    env = environment(configs, "TwoArmLift", ["Panda", "Panda"])
    robots = [robot.composite_controller for robot in env.robots]
    poses = [robot.pose("right") for robot in robots]
    for pose, aside in zip(poses, (0.3, -0.3), strict=True):
        pose[0] += aside  # of the pot between them
    for k in range(220):
        for pose in poses:
            pose[2] = 1.05 if k < 60 else 0.83  # the table's height is 0.8 m
        forces = (6.0, 9.0) if k >= 120 else (0.0, 0.0)
        pair = zip(poses, forces, strict=True)
        env.step(np.concatenate([[*pose, force, 1.0] for pose, force in pair]))
    assert [table_force(env, k) for k in range(2)] == approx([6.0, 9.0], abs=0.1)


def test_an_arm_on_a_moving_base_is_refused():
    with raises(osc.InvalidInputError, match=r"4 more joints.*fixed base"):
        env = environment(osc_contact_config("Tiago", []), "Lift", "Tiago")
        env.step(np.zeros(env.action_dim))


def test_the_wrench_is_computed_where_force_sensors_are_wrong(monkeypatch, caplog):
    monkeypatch.setattr(mujoco, "mj_versionString", lambda: "3.5.0")
    env = environment(osc_contact_config("Panda", [TABLE]))
    pose = env.robots[0].composite_controller.pose("right")
    pose[2] = 0.91
    for force in [0.0] * 60 + [12.0] * 50:
        env.step([*pose, force])
    assert table_force(env) == approx(12.0, abs=0.1)
    assert "lite_physics" in caplog.text


def test_episodes_begin_anew_and_leave_recordings():
    config = osc_contact_config("Panda", [TABLE], record=True)
    env = environment(config)
    controller = env.robots[0].composite_controller
    pose = controller.pose("right")
    env.step([*pose, 0.0])
    recording = controller.recording("right")
    assert len(recording["t"]) == round(1 / env.control_freq / env.model_timestep)
    env.reset()
    assert not env.robots[0].composite_controller.loops


@fixture
def without_contacts():
    config = osc_contact_config("Panda", [TABLE])
    del config["composite_controller_specific_configs"]["contacts"]
    return config


def test_configurations_that_cannot_be_are_refused(without_contacts):
    with raises(osc.InvalidInputError, match="osc_contact_config"):
        environment(without_contacts)
    with raises(osc.InvalidInputError, match="has no arm"):
        environment(osc_contact_config("Panda", {"left": [TABLE]}))
    with raises(osc.InvalidInputError, match="displacement"):
        osc_contact_config("Panda", [TABLE], action="velocity")
