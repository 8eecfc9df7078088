"""Fig. 3: what the picture of the workcell shows, where, and that it is rendered."""

import json

import numpy as np
import pinocchio as pin
from command_line import read_json
from matplotlib.image import imread
from numpy.testing import assert_allclose
from pytest import fixture
from scene_samples import read_commands

from osc_contact import robots
from osc_contact.visual.browser import VARIABLE
from paper import fig3
from paper.studies import write_study
from paper.study import Ask

SOON = [
    f"contacts.{side}_end.face.motion.{kind}{key}=0.{what} s"
    for side in ("left", "right")
    for kind in ("signals.0.", "turn.signals.0.")
    for key, what in (("start", "6"), ("duration", "8"))
]


@fixture(scope="module")
def cell():
    return fig3.run(1.45, changes=SOON)


def by_urdf(cell, arm, frame):
    """Placement of a frame by its own reading of the arm's URDF."""
    spec = next(spec for spec in cell.rig.scenario.arms if spec.name == arm)
    model = pin.buildModelFromUrdf(str(robots.resolve_urdf(spec.urdf, None)[0]))
    data = model.createData()
    q = np.split(np.asarray(cell.sample["q"]), 2)[arm == "right"]
    pin.framesForwardKinematics(model, data, q)
    return pin.SE3(np.eye(3), np.array(spec.base.xyz)) * data.oMf[model.getFrameId(frame)]


def test_the_camera_sees_rod_grippers_and_faces_where_they_moved_to(cell):
    corners = cell.camera.corners
    low = corners.min(axis=0)[:2]
    high = corners.max(axis=0)[:2]
    seen = [X.translation for X in cell.faces()]
    seen += [by_urdf(cell, arm, "wrist_sensor").translation for arm in ("left", "right")]
    rod = pin.XYZQUATToSE3(np.asarray(cell.sample["pose"], dtype=float))
    seen += [rod.act(np.array([x, 0.0, 0.0])) for x in (-0.3, 0.3)]
    for point in seen:
        assert (low < point[:2]).all() and (point[:2] < high).all()
        assert point[2] < cell.camera.eye[2]
    turned = [
        X.rotation.T @ b.placement.rotation
        for X, b in zip(cell.faces(), cell.rig.bodies, strict=True)
    ]
    angles = [np.linalg.norm(pin.log3(R)) for R in turned]
    assert_allclose(angles, np.deg2rad(5.0), atol=1e-3)


def test_every_label_hangs_on_a_node_and_says_what_the_scenario_says(cell, tmp_path):
    words = []
    for k, shot in enumerate(cell.shots()):
        page = cell.page(shot, tmp_path / f"{k}.html")
        drawn = {c["path"] for c in read_commands(page)}
        text = page.read_text()
        for i, callout in enumerate(shot.callouts):
            assert f"/meshcat/callouts/{i}/label" in drawn
            assert json.dumps(callout.text) in text
        words += [callout.text for callout in shot.callouts]
        assert ("/meshcat/vision/view/rim0" in drawn) == shot.whole
        assert "/meshcat/sensors/wrist/left" in drawn and "/meshcat/bodies/object" in str(drawn)
    told = " ".join(words)
    for part in (
        "60 Hz, 30 ms old, ±1 mm, ±5 mrad",
        "20 mm and 5°",
        "left arm",
        "right arm",
        "rod",
        "joint torque sensors",
        "wrist force/torque sensor",
        "hinge",
    ):
        assert part in told
    force = cell.sample["alpha_true"][0]
    assert force > 1.0 and f"left end: {force:.1f} N" in told


def test_reproduce_fig3_renders_it(cell, tmp_path, monkeypatch):
    monkeypatch.setattr(fig3, "run", lambda *_: cell)
    _, written = write_study("fig3", tmp_path, Ask())
    assert {path.name for path in written} >= {"fig3.png", "fig3.html", "fig3.json"}
    picture = imread(tmp_path / "fig3.png")[..., :3]
    assert picture.shape[1] > 1500 and picture.std(axis=(0, 1)).min() > 0.05
    view = np.array([0x2B, 0x7C, 0xAE]) / 255  # edges of what the camera sees, on the left half
    near = np.abs(picture[:, : picture.shape[1] // 2] - view).max(axis=2) < 0.1
    assert near.sum() > 500
    told = read_json(tmp_path / "fig3.json")
    assert told["overhead vision"].startswith("60 Hz") and "8 motors" in told["arms"]


def test_without_a_browser_there_is_the_page_and_a_word(cell, tmp_path, monkeypatch):
    monkeypatch.setattr(fig3, "run", lambda *_: cell)
    monkeypatch.setenv(VARIABLE, str(tmp_path / "none"))
    study, written = write_study("fig3", tmp_path, Ask())
    assert {path.name for path in written} == {"fig3.html", "fig3.json"}
    assert "not rendered: no browser" in str(list(study.table.columns[1].cells))
