"""Pictures of a robot in a MuJoCo scene of one's own, and of recordings that it leaves."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
from command_line import done, refused
from headless import Browser, near
from pytest import fixture, mark
from test_own_mujoco import START, WALL, robot_of, scene, wiping

import osc_contact as osc
from osc_contact.robots.pictures import read_picture


@fixture(scope="module")
def recorded(tmp_path_factory):
    """A robot, its recording and the file of it."""
    robot = robot_of(scene(), locked={"grip": 0.02})
    start = robot.touching(START)
    robot.reset(start)
    controller = osc.Controller(robot.chain, [WALL], posture=start)
    recorder = osc.Recorder(controller, robot)
    along = wiping(robot.chain.state(start, np.zeros(3)).X_WO)
    osc.run_loop(robot, controller, map(along, np.arange(0, 0.4, 1e-3)), recorder=recorder)
    file = tmp_path_factory.mktemp("own") / "own.npz"
    recorder.recording().save(file)
    return robot, osc.Recording.load(file), file


def test_the_picture_stands_where_mujoco_puts_the_shapes(recorded):
    robot, recording, _ = recorded
    model, shapes = read_picture(recording.meta["picture"])
    data = model.createData()
    q = np.array([0.7, -0.4, 1.1])
    robot.reset(q)
    robot.data.joint("grip").qpos[:] = 0.02
    mujoco.mj_forward(robot.model, robot.data)
    pin.forwardKinematics(model, data, q)
    drawn = {True: [], False: []}
    for one in shapes.geometryObjects:
        X = data.oMi[one.parentJoint] * one.placement
        drawn[one.parentJoint > 0].append(X.translation)
    for name in ("upper", "lower", "tool", "wall"):
        away = drawn[name != "wall"] - robot.data.geom(name).xpos
        assert np.linalg.norm(away, axis=1).min() < 1e-6, name


def test_a_recording_carries_no_path_and_is_drawn(recorded, tmp_path):
    _, recording, file = recorded
    text = json.dumps(recording.meta)
    assert str(Path.cwd()) not in text and "/home" not in text and "/tmp" not in text
    page = tmp_path / "own.html"
    png = tmp_path / "own.png"
    done("view", file, "--html", page)
    assert "arms/arm/elbow" in page.read_text() or page.stat().st_size > 5e5
    done("view", file, "--png", png)
    from PIL import Image

    pixels = np.asarray(Image.open(png).convert("RGB")).astype(int)
    assert pixels.reshape(-1, 3).std(axis=0).max() > 10.0


def test_a_viewer_takes_the_robot_and_its_recording(recorded, tmp_path):
    robot, recording, _ = recorded
    with osc.open_viewer(robot) as viewer:
        for tick in (0, 200):
            viewer._due = 0.0
            viewer.show(recording.at(tick))
        with Browser(viewer.url) as page:
            page.until("element('live').textContent === 'LIVE'")
            goal = float(recording["t"][200])
            page.until(f"Math.abs(player.time - {goal}) < 1e-6")
            pixels = page.picture(tmp_path / "live.png")[:600]
            assert pixels.std() > 10 and near(pixels, "#0072B2") > 20
            assert viewer.error is None and viewer.count_browsers() == 1
            viewer.close()
            page.until("element('live').textContent === 'ENDED'")


@mark.parametrize(
    "damage",
    [
        lambda p: None,
        lambda p: p | {"joints": p["joints"][:1]},
        lambda p: p | {"shapes": [p["shapes"][0] | {"place": [0, 0, 0]}]},
        lambda p: p | {"shapes": [p["shapes"][0] | {"joint": 99}]},
        lambda p: p | {"shapes": [{**p["shapes"][0], "kind": 7, "corners": "???", "faces": ""}]},
    ],
)
def test_damaged_pictures_are_refused(recorded, damage, tmp_path):
    _, recording, _ = recorded
    file = tmp_path / "bad.npz"
    bad = {"picture": damage(recording.meta["picture"])}
    osc.Recording(recording.meta | bad, dict(recording.channels)).save(file)
    assert "picture" in refused("view", file, "--html", tmp_path / "page.html")
