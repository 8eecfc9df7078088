"""Pages, plots, diagrams and contact pictures: decoded, measured, and looked at by a browser."""

from __future__ import annotations

import io
import math
import shutil
import subprocess
from collections import namedtuple
from html.parser import HTMLParser
from itertools import combinations
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from osc_contact.errors import InvalidInputError
from osc_contact.recorder import Recording
from osc_contact.visual import contact_colour, plots
from osc_contact.visual.contact_picture import common_perpendicular, draw_contact_state
from osc_contact.visual.diagram_text import folded_equation
from osc_contact.visual.diagrams import draw_blocks
from osc_contact.visual.page import CommandSink, read_commands, write_page
from osc_contact.visual.primitives import along, arrow_lengths, track, urdf_geometry
from osc_contact.visual.scene import ArmVisual, BodyVisual, write_scene

URDF = Path(__file__).parents[1] / "urdf"
BASE = pin.SE3(np.eye(3), np.array([-0.35, -0.4, 0.0]))
FACE = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.4, 0.0), np.array([-0.3, 0.0, 0.19]))
ARMS = [ArmVisual("left", URDF / "scara_left.urdf", [URDF], BASE, slice(0, 5))]
BODIES = [
    BodyVisual("rod", URDF / "rod.urdf", [URDF], None),
    BodyVisual("face", URDF / "face.urdf", [URDF], FACE),
]


def make_recording(contacts: int = 2, without: tuple[str, ...] = ()) -> Recording:
    """One second at 100 Hz: a turning arm, a rod on its way, forces rising from 0 to 12 N."""
    t = np.arange(101) / 100.0
    ticks = len(t)
    q = np.column_stack([0.3 + t, -1.0 - t, 0.1 + 0.1 * t, t, 0.0 * t])
    pose = np.tile([0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0], (ticks, 1))
    pose[:, 1] = 0.05 * np.sin(t)
    alpha = np.column_stack([12.0 * t, 9.0 * t])[:, :contacts]
    closed = np.ones((ticks, contacts), dtype=bool)
    closed[40:60, :1] = False
    points = np.tile([[-0.3, 0.0, 0.2], [0.3, 0.0, 0.2]], (ticks, 1, 1))[:, :contacts]
    points[:, :, 1] += pose[:, 1:2]
    directions = np.tile([[-0.6, 0.0, -0.8], [0.6, -0.8, 0.0]], (ticks, 1, 1))[:, :contacts]
    channels = {
        "t": t, "q": q, "pose": pose, "tau": np.outer(t, np.arange(1.0, 5.0)),
        "alpha_cmd": alpha + 1.0, "alpha_meas": alpha + 0.1, "alpha_true": alpha,
        "closed": closed, "contact_point": points, "contact_direction": directions,
        "power_total": np.sin(20.0 * t),
        "power_projected": np.where(t < 0.5, 0.01, 2.0 * (t < 0.54)),
        "motion_error": np.outer(t, [3e-3, 0.0, 4e-3, 0.0, 5e-3, 0.0]),
    }  # fmt: skip
    names = ["left_end", "right_end"][:contacts]
    joints = [f"left/{name}" for name in ("joint1", "joint2", "joint3", "joint4", "hinge")]
    scenario = {"name": "test_<scene>", "arms": [{"name": "left", "passive_joints": ["hinge"]}]}
    meta = {
        "scenario": scenario, "contact_names": names, "arm_names": ["left"], "joint_names": joints
    }  # fmt: skip
    return Recording(meta, {k: v for k, v in channels.items() if k not in without})


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "scene.html"
    return write_scene(make_recording(), ARMS, BODIES, path, fps=10)


def tracks(page: Path) -> dict[str, dict[str, dict[int, list[float]]]]:
    """{path: {property: {frame: value}}} of the page's animation."""
    (command,) = [c for c in read_commands(page) if c["type"] == "set_animation"]
    return {
        a["path"]: {
            t["name"].lstrip("."): {k["time"]: k["value"] for k in t["keys"]}
            for t in a["clip"]["tracks"]
        }
        for a in command["animations"]
    }


def at(keys: dict[int, object], frame: int) -> object:
    """Value of a track whose repeated keys were left out."""
    return keys[max(k for k in keys if k <= frame)]


class Fetches(HTMLParser):
    """Collects every address that an HTML page would load."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.addresses += [v or "" for k, v in attrs if k in ("src", "href", "srcset", "data")]


def test_page_fetches_nothing_and_escapes_its_title(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    reader = Fetches()
    reader.feed(text)
    assert reader.addresses == []
    assert "default-src 'none'" in text and "connect-src data: blob:" in text
    assert "new WebSocket" not in text.rsplit("<script>", 1)[1]
    assert "<title>test &lt;scene&gt;</title>" in text
    assert "http" not in repr(read_commands(page))


def test_page_holds_every_body_and_plays_for_ever(page: Path) -> None:
    commands = read_commands(page)
    objects = {c["path"] for c in commands if c["type"] == "set_object"}
    for prefix in (
        "/meshcat/arms/left/base/", "/meshcat/arms/left/joint3/", "/meshcat/bodies/rod/",
        "/meshcat/bodies/face/", "/meshcat/contacts/left_end/force/shaft/rod",
        "/meshcat/contacts/right_end/desired/head/cone", "/meshcat/contacts/left_end/line_of_force",
        "/meshcat/floor",
    ):  # fmt: skip
        assert any(path.startswith(prefix) for path in objects), prefix
    (face,) = [
        c for c in commands if c["path"] == "/meshcat/bodies/face" and c["type"] == "set_transform"
    ]
    assert np.allclose(np.reshape(face["matrix"], (4, 4)).T, FACE.homogeneous)
    (animation,) = [c for c in commands if c["type"] == "set_animation"]
    assert animation["options"] == {"play": True, "repetitions": math.inf}
    last = {max(k["time"] for k in t["keys"])
            for a in animation["animations"] for t in a["clip"]["tracks"]}  # fmt: skip
    assert last == {10}, "tracks of unequal length would drift apart when repeated"


def test_arm_and_object_stand_where_the_recording_says(page: Path) -> None:
    recording, found = make_recording(), tracks(page)
    model = pin.buildModelFromUrdf(str(URDF / "scara_left.urdf"))
    data = model.createData()
    for frame in (0, 4, 10):
        tick = 10 * frame
        pin.forwardKinematics(model, data, recording["q"][tick])
        for joint in ("joint1", "joint3", "hinge"):
            keys = found[f"/meshcat/arms/left/{joint}"]
            shown = pin.XYZQUATToSE3(
                np.concatenate([at(keys["position"], frame), at(keys["quaternion"], frame)])
            )
            assert shown.isApprox(BASE * data.oMi[model.getJointId(joint)], 1e-9)
        assert np.allclose(
            at(found["/meshcat/bodies/rod"]["position"], frame), recording["pose"][tick, :3]
        )


def test_force_arrow_has_its_tip_at_the_contact_and_10_mm_per_newton(page: Path) -> None:
    recording, found = make_recording(), tracks(page)
    for i, name in enumerate(("left_end", "right_end")):
        node = f"/meshcat/contacts/{name}"
        for frame in (3, 8):
            tick = 10 * frame
            assert np.allclose(
                at(found[node]["position"], frame), recording["contact_point"][tick, i]
            )
            turn = pin.Quaternion(np.array(at(found[node]["quaternion"], frame)))
            direction = recording["contact_direction"][tick, i]
            assert np.allclose(turn.matrix()[:, 1], direction, atol=1e-6)
            for arrow, extra in (("force", 0.0), ("desired", 1.0)):
                shaft = found[f"{node}/{arrow}/shaft"]
                tail = at(shaft["position"], frame)[1] - at(shaft["scale"], frame)[1]
                alpha = recording["alpha_true"][tick, i] + extra
                assert tail == pytest.approx(-0.01 * alpha, abs=1e-5)


def test_open_contact_shows_no_force(page: Path) -> None:
    found = tracks(page)
    left, right = (f"/meshcat/contacts/{name}_end" for name in ("left", "right"))
    for node in (f"{left}/force", f"{left}/line_of_force"):
        shown = [at(found[node]["visible"], frame) for frame in range(1, 11)]
        assert shown == [True] * 3 + [False] * 2 + [True] * 5
    assert at(found[f"{right}/force"]["visible"], 5) is True
    assert at(found[f"{right}/force"]["visible"], 0) is False, "no arrow for 0 N"


def test_track_leaves_out_only_what_changes_nothing() -> None:
    from meshcat.animation import Animation

    animation, scene = Animation(default_framerate=30), CommandSink().visualizer()
    values = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 2.0, 2.0])
    track(scene["node"], animation, "opacity", "number", values)
    (clip,) = animation.lower()
    keys = {key["time"]: key["value"] for key in clip["clip"]["tracks"][0]["keys"]}
    assert keys == {0: 0.0, 3: 0.0, 4: 1.0, 5: 2.0, 7: 2.0}
    assert np.allclose(np.interp(np.arange(8), list(keys), list(keys.values())), values)


def test_short_arrow_is_a_smaller_head() -> None:
    shaft, shaft_y, head = arrow_lengths(np.array([0.01, 0.035, 0.135, np.nan]))
    assert np.allclose(head[:3, 1], [0.01 / 0.035, 1.0, 1.0])
    assert np.allclose(shaft[:3, 1] - shaft_y[:3], [0.01, 0.035, 0.135], atol=2e-6)
    assert np.isfinite(np.concatenate([shaft.ravel(), shaft_y, head.ravel()])).all()


@pytest.mark.parametrize(
    "recording",
    [
        make_recording(contacts=0),
        make_recording(without=("contact_point", "contact_direction", "closed", "alpha_true")),
    ],
    ids=["no contacts", "no contact channels"],
)
def test_scene_without_contacts(recording: Recording, tmp_path: Path) -> None:
    path = write_scene(recording, ARMS, BODIES, tmp_path / "scene.html")
    paths = {c["path"] for c in read_commands(path)}
    assert "/meshcat/bodies/rod" in paths
    assert not any("contacts" in p for p in paths)


def test_scene_refuses_what_does_not_fit(tmp_path: Path) -> None:
    path = tmp_path / "scene.html"
    with pytest.raises(InvalidInputError, match=r"takes 4 numbers of q.*nq = 5"):
        write_scene(make_recording(), [ARMS[0]._replace(q_slice=slice(0, 4))], [], path)
    with pytest.raises(InvalidInputError, match="'pose'"):
        write_scene(make_recording(without=("pose",)), [], BODIES, path)
    with pytest.raises(InvalidInputError, match="0 frames/s"):
        write_scene(make_recording(), [], [], path, fps=0)
    with pytest.raises(InvalidInputError, match="#RRGGBB"):
        write_page(CommandSink(), path, "t", [("red;}", "x")])
    assert list(tmp_path.iterdir()) == []


def test_page_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    (tmp_path / "taken").mkdir()
    with pytest.raises(OSError):
        write_page(CommandSink(), tmp_path / "taken", "title")
    assert [p.name for p in tmp_path.iterdir()] == ["taken"]
    (tmp_path / "other.html").write_text("<html></html>")
    with pytest.raises(InvalidInputError, match="no drawing commands"):
        read_commands(tmp_path / "other.html")


def test_urdf_shapes_lie_as_in_the_urdf(tmp_path: Path) -> None:
    mesh = tmp_path / "tetra.stl"
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype="<f4")
    facets = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    body = b"".join(b"\0" * 12 + corners[list(f)].tobytes() + b"\0\0" for f in facets)
    mesh.write_bytes(b"\0" * 80 + len(facets).to_bytes(4, "little") + body)
    shapes = (
        '<box size="1 2 3"/>', '<cylinder radius="0.1" length="0.7"/>', '<sphere radius="0.2"/>',
        f'<mesh filename="{mesh}" scale="2 2 2"/>',
    )  # fmt: skip
    visuals = "".join(
        f'<visual><origin xyz="{i} 0 0"/><geometry>{s}</geometry><material name="m{i}">'
        '<color rgba="1 0.5 0 0.4"/></material></visual>'
        for i, s in enumerate(shapes)
    )
    urdf = tmp_path / "shapes.urdf"
    urdf.write_text(f'<robot name="r"><link name="l">{visuals}</link></robot>')
    model = pin.buildModelFromUrdf(str(urdf))
    sink = CommandSink()
    scene = sink.visualizer()
    geometry = pin.buildGeomFromUrdf(model, str(urdf), pin.GeometryType.VISUAL)
    for i, shape in enumerate(geometry.geometryObjects):
        urdf_geometry(scene[str(i)], shape)
    capsule = pin.GeometryObject.CreateCapsule(0.1, 0.4)
    urdf_geometry(scene["capsule"], capsule)
    drawn = {c["path"]: c["object"] for c in sink.commands if c["type"] == "set_object"}
    placed = {c["path"]: np.reshape(c["matrix"], (4, 4)).T
              for c in sink.commands if c["type"] == "set_transform"}  # fmt: skip
    box, cylinder, sphere, tetra = (drawn[f"/meshcat/{i}/shape"]["geometries"][0] for i in range(4))
    assert (box["width"], box["height"], box["depth"]) == (1.0, 2.0, 3.0)
    assert (cylinder["radiusTop"], cylinder["height"]) == (0.1, 0.7)
    assert np.allclose(placed["/meshcat/1/shape"][:3, :3] @ [0, 1, 0], [0, 0, 1])
    assert sphere["radius"] == 0.2
    vertices = np.frombuffer(tetra["data"]["attributes"]["position"]["array"].data, np.float32)
    assert vertices.max() == 2.0 and len(vertices) % 3 == 0
    assert placed["/meshcat/2"][0, 3] == 2.0
    paint = drawn["/meshcat/0/shape"]["materials"][0]
    assert paint["color"] == 0xFF8000 and paint["opacity"] == pytest.approx(0.4)
    assert placed["/meshcat/capsule/shape/top"][2, 3] == pytest.approx(capsule.geometry.halfLength)


def test_along_takes_y_to_the_direction() -> None:
    for direction in ([0, 3, 0], [0, -2, 0], [1, 2, -2]):
        pose = along([1, 2, 3], direction)
        assert np.allclose(pose.rotation[:, 1], np.array(direction) / np.linalg.norm(direction))
    with pytest.raises(InvalidInputError, match="no finite length"):
        along([0, 0, 0], [0, 0, 0])


def screenshot(browser: str, page: Path, seconds: float, folder: Path) -> np.ndarray:
    """Pixels (800,1200,3) of the page's still at a time, by a headless browser without network."""
    from PIL import Image

    picture = folder / f"still_{seconds}.png"
    flags = (
        "--headless --no-sandbox --disable-quic --no-first-run --disable-background-networking "
        "--disable-component-update --disable-sync --use-angle=swiftshader "
        "--enable-unsafe-swiftshader --hide-scrollbars --window-size=1200,800 "
        "--virtual-time-budget=5000"
    )
    address = f"{page.resolve().as_uri()}#t={seconds}"
    profile = f"--user-data-dir={folder / 'profile'}"
    command = [browser, *flags.split(), profile, f"--screenshot={picture}", address]
    subprocess.run(command, check=True, timeout=90, capture_output=True)
    return np.asarray(Image.open(io.BytesIO(picture.read_bytes())).convert("RGB")).astype(int)


def test_browser_shows_the_forces(page: Path, tmp_path: Path) -> None:
    names = ("chromium", "chromium-browser", "google-chrome")
    browser = next((path for path in map(shutil.which, names) if path), None)
    colours = {
        c["path"]: c["object"]["materials"][0]["color"]
        for c in read_commands(page)
        if c["type"] == "set_object"
    }
    for i, name in enumerate(("left_end", "right_end")):
        wanted = int(contact_colour(i)[1:], 16)
        assert colours[f"/meshcat/contacts/{name}/force/shaft/rod"] == wanted
    if browser is None:
        return
    without, pushed = (screenshot(browser, page, t, tmp_path)[100:] for t in (0.0, 1.0))

    def blue(p: np.ndarray) -> int:
        return int(np.sum((p[..., 0] < 30) & (p[..., 1] > 90) & (p[..., 2] > 170)))

    def vermillion(p: np.ndarray) -> int:
        return int(np.sum((p[..., 0] > 200) & (np.abs(p[..., 1] - 110) < 35) & (p[..., 2] < 40)))

    assert pushed.std() > 20 and len(np.unique(pushed.reshape(-1, 3), axis=0)) > 300
    assert blue(pushed) > blue(without) + 200
    assert vermillion(pushed) > vermillion(without) + 200


def test_contact_force_figure() -> None:
    figure = plots.contact_forces(make_recording())
    left, right, error = figure.axes
    assert [line.get_label() for line in left.lines] == ["desired", "true", "measured"]
    assert [ax.get_title(loc="left") for ax in (left, right)] == ["left end", "right end"]
    desired, true, measured = left.lines
    assert np.allclose(true.get_ydata(), make_recording()["alpha_true"][:, 0])
    widths = [line.get_linewidth() for line in (desired, true, measured)]
    assert widths[0] > 2 * widths[1] > 3 * widths[2] and measured.is_dashed(), "seen when equal"
    assert np.allclose(error.lines[1].get_ydata(), -1.0)
    assert "rms 1 N, peak 1 N" in error.lines[1].get_label()
    assert left.get_ylabel().endswith("(N)") and error.get_xlabel() == "time (s)"
    (empty,) = plots.contact_forces(make_recording(contacts=0)).axes
    assert [text.get_text() for text in empty.texts] == ["no contacts"]


def test_force_error_is_scaled_by_what_counts() -> None:
    recording = make_recording()
    recording.channels["alpha_true"] = recording["alpha_cmd"] + 1e-3
    recording.channels["alpha_true"][:20] += 7.0  # touching down
    recording.channels["alpha_true"][51:54] -= 5.0  # after a step
    error = plots.contact_forces(recording, blank_after=[0.5], judged_from=0.2).axes[-1]
    assert error.get_ylim()[1] < 3e-3 and error.get_ylim()[0] > -3e-3
    assert "rms 1 mN, peak 1 mN" in error.lines[0].get_label()
    assert len(error.patches) == 2
    beyond = plots.contact_forces(recording, judged_from=9.0).axes[-1]
    assert beyond.get_ylim()[1] > 7.0, "if nothing counts, everything does"


def test_power_figure_leaves_steps_out_of_the_rms() -> None:
    recording = make_recording()
    plain, blanked = plots.power(recording), plots.power(recording, blank_after=[0.5])
    assert plain.axes[0].get_ylim() == plain.axes[1].get_ylim()
    assert "398 mW" in plain.axes[1].get_title(loc="left")
    counted = np.r_[0:50, 55:101]
    rms = 1e3 * np.sqrt(np.mean(recording["power_projected"][counted] ** 2))
    assert f"rms {rms:.3g} mW" in blanked.axes[1].get_title(loc="left")
    assert len(blanked.axes[2].patches) == 1 and not plain.axes[2].patches
    assert blanked.axes[2].get_ylim()[1] < 0.02 < plain.axes[2].get_ylim()[1]


def test_tracking_and_torque_figures() -> None:
    linear, angular, way = plots.tracking(make_recording()).axes
    assert np.allclose(linear.lines[2].get_ydata()[-1], 4.0), "mm"
    assert np.allclose(angular.lines[1].get_ydata()[-1], 5.0), "mrad"
    late = plots.tracking(make_recording(), judged_from=1.0).axes
    assert "rms 5 mm" in late[0].get_title(loc="left") and len(late[0].patches) == 1
    assert np.allclose(way.lines[1].get_ydata()[-1], 50.0 * np.sin(1.0)), "mm from the start"
    (arm,) = plots.torques(make_recording()).axes
    labels = [line.get_label() for line in arm.lines]
    assert labels == ["joint1", "joint2", "joint3", "joint4"], "the passive hinge has no actuator"
    with pytest.raises(InvalidInputError, match="no channel 'tau'"):
        plots.torques(make_recording(without=("tau",)))


def test_save_writes_png_and_svg(tmp_path: Path) -> None:
    paths = plots.save(plots.torques(make_recording()), tmp_path / "run.1" / "torques")
    assert [p.name for p in paths] == ["torques.png", "torques.svg"]
    assert sorted(p.name for p in (tmp_path / "run.1").iterdir()) == ["torques.png", "torques.svg"]
    assert paths[0].read_bytes().startswith(b"\x89PNG") and "<svg" in paths[1].read_text()


Piece = namedtuple("Piece", "name inputs outputs equation group")
WIRING = [
    Piece("wrist sensors", (), ("f_meas",), "", "filter"),
    Piece("encoders", (), ("q", "v"), "", "model"),
    Piece("chain model", ("q", "v"), ("state",), r"$\Lambda_S, S$", "model"),
    Piece("contact geometry", ("state",), ("contact",), "$N, T$", "model"),
    Piece("wrist filter", ("f_meas", "state", "contact"), ("alpha_meas",), r"$\Omega_f$", "filter"),
    Piece("force law", ("alpha_d", "alpha_meas"), ("alpha_u",), "", "force"),
    Piece("motion law", ("X_d", "state"), ("a_u",), r"$\ddot X_d$", "motion"),
    Piece("command filter", ("a_u", "alpha_u", "state", "contact"), ("f_S", "log"), "", "filter"),
    Piece("allocation", ("f_S", "squeeze_d", "state"), ("tau",), r"$G\tau = f_S$", "model"),
    Piece("plant", ("tau",), ("q", "v", "f_meas"), "two arms,\nobject", "plant"),
]


def test_diagram_names_every_block_and_signal_without_overlap() -> None:
    figure = draw_blocks(WIRING, "architecture")
    (ax,) = figure.axes
    shown = [text for text in ax.texts if text.get_text()]
    words = {text.get_text().replace("\n", " ") for text in shown}
    assert {piece.name for piece in WIRING} <= words
    for signal in (r"$\tau$", "state", r"$\alpha_{\mathrm{d}}$", r"$f_{\mathrm{meas}}$", "log"):
        assert signal in words
    boxes = [(text.get_text(), text.get_window_extent()) for text in shown]
    for (first, a), (second, b) in combinations(boxes, 2):
        assert not a.overlaps(b), f"{first!r} covers {second!r}"
    arrows = sum(1 for text in ax.texts if getattr(text, "arrow_patch", None) is not None)
    inputs = sum(len(piece.inputs) for piece in WIRING)
    returns, ends = 3, 1
    assert arrows == inputs + returns + ends


def test_diagram_wires_do_not_cross_blocks_or_names() -> None:
    (ax,) = draw_blocks(WIRING, "architecture").axes
    from matplotlib.patches import FancyBboxPatch

    rooms = [p.get_window_extent() for p in ax.patches if isinstance(p, FancyBboxPatch)]
    assert len(rooms) == len(WIRING)
    names = [t.get_window_extent() for t in ax.texts if t.get_text()]
    for line in ax.lines:
        (x0, y0), (x1, y1) = ax.transData.transform(line.get_xydata()[[0, -1]])
        for box in rooms:
            inside_x = min(x0, x1) < box.x1 - 3 and max(x0, x1) > box.x0 + 3
            inside_y = min(y0, y1) < box.y1 - 3 and max(y0, y1) > box.y0 + 3
            assert not (inside_x and inside_y)
        if x0 == x1 and y0 != y1:
            assert not any(
                b.x0 < x0 < b.x1 and min(y0, y1) < b.y1 and max(y0, y1) > b.y0 for b in names
            )


def test_a_bus_is_named_below_its_readers_instead_of_wired() -> None:
    (ax,) = draw_blocks(WIRING, "buses", buses=("state", "contact"), labels={"contact": "N"}).axes
    from matplotlib.patches import FancyBboxPatch

    texts = [text.get_text() for text in ax.texts]
    readers = sum("state" in piece.inputs for piece in WIRING)
    assert texts.count("state") == readers + 1, "each reader, and the block that puts it out"
    assert texts.count("N") == 3 and "contact" not in texts
    low = [p.get_window_extent() for p in ax.patches if isinstance(p, FancyBboxPatch)]
    below = [
        text for text in ax.texts if text.get_text() in ("state", "N") and text.get_va() == "top"
    ]
    assert len(below) == readers + 2
    for text in below:
        box = text.get_window_extent()
        assert any(b.x0 < box.x0 and box.x1 < b.x1 and b.y0 > box.y1 for b in low)
    shown = [(t.get_text(), t.get_window_extent()) for t in ax.texts if t.get_text()]
    for (first, a), (second, b) in combinations(shown, 2):
        assert not a.overlaps(b), f"{first!r} covers {second!r}"


@pytest.mark.parametrize(
    ("equation", "shown"),
    [
        (r"$\Omega_m(B)$  (24)", r"$\Omega_m(B)$  (24)"),
        (r"$\Lambda_S\dot\eta_c+b_S+S^Tf$  (21)", "$\\Lambda_S\\dot\\eta_c+b_S+S^Tf$\n(21)"),
        (r"$G\tau = f_S$, squeeze in null$(G)$", "$G\\tau = f_S$,\nsqueeze in null$(G)$"),
        (r"$\Lambda_S, \mu, p, S, \sigma, G, J$", r"$\Lambda_S, \mu, p, S, \sigma, G, J$"),
        (r"$\int\! e$", r"$\int e$"),
    ],
)
def test_long_equations_are_folded_outside_mathtext(equation: str, shown: str) -> None:
    assert folded_equation(equation) == shown


def test_diagram_refuses_bad_wirings() -> None:
    loop = [Piece("a", ("y",), ("x",), "", "force"), Piece("b", ("x",), ("y",), "", "force")]
    end = Piece("end", ("x",), (), "", "plant")
    with pytest.raises(InvalidInputError, match=r"'a', 'b', 'end'.*cut the loop"):
        draw_blocks([*loop, end], "loop")
    with pytest.raises(InvalidInputError, match="both put out 'x'"):
        draw_blocks([loop[0], loop[0]._replace(name="c"), end], "twice")
    with pytest.raises(InvalidInputError, match="'magic'"):
        draw_blocks([end._replace(group="magic")], "group")
    with pytest.raises(InvalidInputError, match="at least one"):
        draw_blocks([], "none")
    assert draw_blocks(loop, "closed by the last block").axes


def test_common_perpendicular_of_known_lines() -> None:
    pair = common_perpendicular([1, 0, 0], [2, 0, 0], [5, 4, 0.3], [0.0, 1.0, 0.0])
    assert np.allclose(pair.first, [5, 0, 0]) and np.allclose(pair.second, [5, 0, 0.3])
    assert pair.distance == pytest.approx(0.3) and pair.angle == pytest.approx(np.pi / 2)
    rng = np.random.default_rng(3)
    p, d, q, e = rng.standard_normal((4, 3))
    pair = common_perpendicular(p, d, q, e)
    assert (pair.second - pair.first) @ d == pytest.approx(0.0, abs=1e-12)
    assert (pair.second - pair.first) @ e == pytest.approx(0.0, abs=1e-12)
    parallel = common_perpendicular([0, 0, 0], [1, 0, 0], [7, 0, 2], [-3, 0, 0])
    assert parallel.distance == pytest.approx(2.0) and parallel.angle == 0.0


def test_contact_picture_projects_no_uninitialised_numbers() -> None:
    rod = np.array([[-0.3, 0, 0], [0.3, 0, 0]])
    figure = draw_contact_state(rod, np.array([[0, 0, -1.0], [0, 1, 0]]), [rod], [], "arrows")
    solids = [c for c in figure.axes[0].collections if hasattr(c, "_faces")]
    assert len(solids) == 2
    for cone in solids:
        assert not np.any(cone._invalid_vertices), "polygons of unequal size are padded with junk"
        assert np.abs(cone._faces).max() < 1.0


def test_contact_picture_tells_how_the_lines_lie() -> None:
    rod = np.array([[-0.3, 0, 0], [0.3, 0, 0]])
    face = np.array([[-0.4, -0.1, 0], [-0.2, -0.1, 0], [-0.2, 0.1, 0], [-0.4, 0.1, 0]])
    directions = np.array([[0, 0, -1], [0, 1, 0]])
    figure = draw_contact_state(rod, directions, [rod], [face], "skew")
    (ax,) = figure.axes
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert any("skew, 600.0 mm apart, angle 90.0°" in label for label in labels)
    (line,) = [line for line in ax.lines if line.get_label() == "line of force of $f_{c1}$"]
    x, y, z = line.get_data_3d()
    assert np.allclose(x, -0.3) and np.allclose(y, 0.0)
    assert z.min() < -0.25 and z.max() > 0.25, "extended both ways"
    spans = [np.ptp(limits) for limits in (ax.get_xlim(), ax.get_ylim(), ax.get_zlim())]
    assert np.allclose(spans, spans[0])
    axes = [([0, 0, 0], [0, 1, 1], "$t_1$: rotation"), ([0, 0, 0], [0, 1, 0], "$t_2$")]
    (ax,) = draw_contact_state(np.zeros((0, 3)), np.zeros((0, 3)), [], [face], "axes", axes).axes
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels[-1] == "angle between $t_1$ and $t_2$: 45.0°"
    with pytest.raises(InvalidInputError, match="2 points but 1 directions"):
        draw_contact_state(rod, directions[:1], [], [], "bad")
