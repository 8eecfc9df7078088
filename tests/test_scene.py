"""Pages of scenes, decoded: poses, lengths, colours, what is shown when, what the page fetches."""

from __future__ import annotations

import json
import math
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scene_samples import (
    ARMS,
    BASE,
    BODIES,
    FACE,
    URDF,
    Shown,
    make_recording,
    read_commands,
    tracks,
)

from osc_contact.errors import InvalidInputError
from osc_contact.recorder import Recording
from osc_contact.visual import contact_colour
from osc_contact.visual.browser import write_png
from osc_contact.visual.marks import BestFrame
from osc_contact.visual.page import EMPTY, CommandSink, write_page
from osc_contact.visual.parts import State, changes, track
from osc_contact.visual.scene import (
    ASPECT,
    FIELD_OF_VIEW_DEG,
    MOST_FRAMES,
    fitted,
    panels_of,
    thinned,
    write_scene,
)
from osc_contact.visual.shapes import along, arrow_lengths, tube, urdf_geometry

FRAME = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 0.3), np.array([0.01, 0.02, 0.25]))


def find(N: np.ndarray) -> BestFrame:
    """A frame that tells how many columns it was asked about."""
    return BestFrame(FRAME, (True, N.shape[1] > 1, False), (False, False, True))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "scene.html"
    return write_scene(make_recording(), ARMS, BODIES, path, 10, find, "best <frame>")


@pytest.fixture(scope="module")
def shown(page: Path) -> Shown:
    return Shown(page)


def config(page: Path) -> dict:
    return json.loads(re.search(r"^const CONFIG = (.*);$", page.read_text(), re.MULTILINE)[1])


class Fetches(HTMLParser):
    """Collects every address that an HTML page would load."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.addresses += [v or "" for k, v in attrs if k in ("src", "href", "srcset", "data")]


def test_page_fetches_nothing_and_escapes_its_words(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    reader = Fetches()
    reader.feed(text)
    assert reader.addresses == []
    assert "default-src 'none'" in text and "connect-src data: blob:;" not in text
    assert re.search(r'connect-src data: blob:"', text)
    assert "new WebSocket" not in text.rsplit("<script>", 2)[1]
    assert "<title>test &lt;scene&gt;</title>" in text
    assert "best \\u003cframe>" in text and config(page)["legend"][-2]["text"] == "best <frame>"
    assert "http" not in repr(read_commands(page))


def test_page_holds_every_body_and_plays_for_ever(page: Path) -> None:
    commands = read_commands(page)
    objects = {c["path"] for c in commands if c["type"] == "set_object"}
    for prefix in (
        "arms/left/base/", "arms/left/joint3/", "bodies/rod/", "bodies/face/",
        "contacts/left_end/true/shaft/rod", "contacts/right_end/commanded/head/cone",
        "contacts/left_end/measured/shaft/rod", "contacts/left_end/closed/line/rod",
        "contacts/left_end/closed/point", "contacts/left_end/lost/point", "twists/0/turn/axis/rod",
        "frame/axis2/couple/ring", "trails/object", "trails/right_end", "floor/plane",
    ):  # fmt: skip
        assert any(path.startswith(f"/meshcat/{prefix}") for path in objects), prefix
    (face,) = [
        c for c in commands if c["path"] == "/meshcat/bodies/face" and c["type"] == "set_transform"
    ]
    assert np.allclose(np.reshape(face["matrix"], (4, 4)).T, FACE.homogeneous, atol=1e-6)
    (animation,) = [c for c in commands if c["type"] == "set_animation"]
    assert animation["options"] == {"play": True, "repetitions": math.inf}
    last = {max(k["time"] for k in t["keys"])
            for a in animation["animations"] for t in a["clip"]["tracks"]}  # fmt: skip
    assert last == {10}, "tracks of unequal length would drift apart when repeated"


def test_arm_and_object_stand_where_the_recording_says(shown: Shown) -> None:
    recording = make_recording()
    model = pin.buildModelFromUrdf(str(URDF / "scara_left.urdf"))
    data = model.createData()
    for frame in (0, 4, 10):
        tick = 10 * frame
        pin.forwardKinematics(model, data, recording["q"][tick])
        for joint in ("joint1", "joint3", "hinge"):
            placed = shown.pose(f"/meshcat/arms/left/{joint}", frame)
            assert placed.isApprox(BASE * data.oMi[model.getJointId(joint)], 1e-5)
        rod = shown.at("/meshcat/bodies/rod", "position", frame)
        assert np.allclose(rod, recording["pose"][tick, :3], atol=1e-6)


def test_a_face_follows_its_recorded_pose(tmp_path: Path) -> None:
    recording = make_recording()
    poses = np.tile(pin.SE3ToXYZQUAT(FACE), (len(recording), 2, 1))
    poses[:, 0, 2] += 0.1 * recording["t"]
    moving = Recording(recording.meta, {**recording.channels, "face_pose": poses})
    shown = Shown(write_scene(moving, ARMS, BODIES, tmp_path / "scene.html", 10))
    for frame in (0, 7):
        expected = FACE.copy()
        expected.translation += [0.0, 0.0, 0.01 * frame]
        assert shown.pose("/meshcat/bodies/face", frame).isApprox(expected, 1e-5)


def test_force_arrows_have_their_tips_at_the_contact_and_10_mm_per_newton(shown: Shown) -> None:
    recording = make_recording()
    for i, name in enumerate(("left_end", "right_end")):
        node = f"/meshcat/contacts/{name}"
        for frame in (3, 8):
            tick = 10 * frame
            placed = shown.pose(node, frame)
            direction = recording["contact_direction"][tick, i]
            assert np.allclose(placed.translation, recording["contact_point"][tick, i], atol=1e-6)
            assert np.allclose(placed.rotation[:, 1], direction, atol=1e-6)
            for arrow, extra in (("true", 0.0), ("commanded", 1.0), ("measured", 0.1)):
                y = shown.at(f"{node}/{arrow}/shaft", "position", frame)[1]
                tail = y - shown.at(f"{node}/{arrow}/shaft", "scale", frame)[1]
                alpha = recording["alpha_true"][tick, i] + extra
                assert tail == pytest.approx(-0.01 * alpha, abs=1e-5)
    beside = shown.at("/meshcat/contacts/left_end/measured", "position", 0)
    assert beside == pytest.approx([0.017, 0.0, 0.0]), "seen where it equals the true force"


def test_a_lost_contact_turns_grey_and_its_true_force_vanishes(shown: Shown) -> None:
    left, right = (f"/meshcat/contacts/{name}_end" for name in ("left", "right"))
    lost = [4, 5]  # frames at which the recording says so
    for frame in range(1, 11):
        assert shown.seen(f"{left}/closed/line/rod", frame) == (frame not in lost)
        assert shown.seen(f"{left}/lost/line/rod", frame) == (frame in lost)
        assert shown.seen(f"{left}/true/shaft/rod", frame) == (frame not in lost)
        assert shown.seen(f"{left}/commanded/shaft/rod", frame)
        assert shown.seen(f"{right}/closed/line/rod", frame)
    assert not shown.seen(f"{right}/true/shaft/rod", 0), "no arrow for 0 N"
    paint = {c["path"]: c["object"]["materials"][0]["color"]
             for c in shown.commands if c["type"] == "set_object"}  # fmt: skip
    wanted = int(contact_colour(0)[1:], 16)
    for part in ("true/shaft/rod", "commanded/head/cone", "closed/line/rod", "closed/point"):
        assert paint[f"{left}/{part}"] == wanted
    red, green, blue = (paint[f"{left}/lost/line/rod"] >> shift & 255 for shift in (16, 8, 0))
    assert max(red, green, blue) - min(red, green, blue) < 16, "grey"


def test_twist_axes_are_motions_that_the_closed_contacts_permit(shown: Shown) -> None:
    """The velocity of each contact point, moved as the picture says, has no part along the force.

    The picture says: turn by 1 rad about the y-axis of the node and advance as steeply as the
    path drawn beside it.
    """
    recording = make_recording()
    for frame, count in ((2, 4), (5, 5), (9, 4)):  # the left contact is lost in between
        tick = 10 * frame
        drawn = [i for i in range(6) if shown.seen(f"/meshcat/twists/{i}/label", frame)]
        assert len(drawn) == count
        twists = []
        for i in drawn:
            node = f"/meshcat/twists/{i}"
            placed = shown.pose(node, frame)
            axis, on_axis = placed.rotation[:, 1], placed.translation
            if shown.at(f"{node}/slide", "visible", frame):
                omega, v = np.zeros(3), axis
            else:
                assert shown.at(f"{node}/turn", "visible", frame)
                path = vertices(shown, f"{node}/turn/path/tube").reshape(-1, 6, 3).mean(axis=1)
                path = path * shown.at(f"{node}/turn/path", "scale", frame)
                turned = np.unwrap(np.arctan2(path[:, 0], path[:, 2]))
                pitch = (
                    np.ptp(path[:, 1])
                    / np.ptp(turned)
                    * np.sign((path[-1, 1] - path[0, 1]) * (turned[-1] - turned[0]))
                )
                if abs(pitch) < 1e-5:
                    pitch = 0.0
                omega, v = axis, pitch * axis
            twists.append(np.concatenate([v - np.cross(omega, on_axis), omega]))  # at the origin
            for c in (0, 1):
                if recording["closed"][tick, c]:
                    point = recording["contact_point"][tick, c]
                    speed = v + np.cross(omega, point - on_axis)
                    along_force = speed @ recording["contact_direction"][tick, c]
                    assert abs(along_force) < 2e-3 * max(1.0, np.linalg.norm(speed))
        assert np.linalg.matrix_rank(np.array(twists), tol=1e-3) == count


def vertices(shown: Shown, path: str) -> np.ndarray:
    (drawn,) = [c for c in shown.commands if c["path"] == path and c["type"] == "set_object"]
    data = drawn["object"]["geometries"][0]["data"]["attributes"]["position"]["array"].data
    return np.frombuffer(data, np.float32).reshape(-1, 3)


def test_best_frame_stands_at_the_object_and_shows_what_it_selects(shown: Shown) -> None:
    recording = make_recording()
    for frame in (1, 5):
        placed = shown.pose("/meshcat/frame", frame)
        offset = recording["pose"][10 * frame, :3]
        assert np.allclose(placed.translation, FRAME.translation + offset, atol=1e-6)
        assert np.allclose(placed.rotation, FRAME.rotation, atol=1e-6)
        forces = [shown.at(f"/meshcat/frame/axis{a}/force", "visible", frame) for a in range(3)]
        couples = [shown.at(f"/meshcat/frame/axis{a}/couple", "visible", frame) for a in range(3)]
        assert forces == [True, frame != 5, False], "asked with the closed contacts only"
        assert couples == [False, False, True]
    for axis in range(3):
        placed = shown.pose(f"/meshcat/frame/axis{axis}", 0)
        assert np.allclose(placed.rotation[:, 1], np.eye(3)[axis], atol=1e-6)


def test_a_column_with_a_couple_is_a_screw(tmp_path: Path) -> None:
    """N = [d; (p − O) × d + h d]: the line keeps its place, and a helix of pitch h is beside it."""
    recording, pitch = make_recording(), 0.03
    d, p = recording["contact_direction"], recording["contact_point"]
    arms = p - recording["pose"][:, None, :3]
    N = np.concatenate([d, np.cross(arms, d) + pitch * d], axis=2).transpose(0, 2, 1)
    N[:, :3, 1], N[:, 3:, 1] = 0.0, d[:, 1]  # the second contact transmits a pure couple
    channels = {**recording.channels, "N": N}
    shown = Shown(write_scene(Recording(recording.meta, channels), ARMS, BODIES,
                              tmp_path / "s.html", 10))  # fmt: skip
    placed = shown.pose("/meshcat/contacts/left_end", 3)
    offset = placed.translation - p[30, 0]
    assert np.allclose(np.cross(offset, d[30, 0]), 0.0, atol=1e-6)
    path = vertices(shown, "/meshcat/contacts/left_end/closed/pitch").reshape(-1, 6, 3).mean(axis=1)
    turned = np.unwrap(np.arctan2(path[:, 0], path[:, 2]))
    assert np.polyfit(turned, path[:, 1], 1)[0] == pytest.approx(pitch, rel=1e-3)
    couple = "/meshcat/contacts/right_end/true"
    length = -shown.at(f"{couple}/shaft", "position", 8)[1] + shown.at(
        f"{couple}/shaft", "scale", 8)[1]  # fmt: skip
    assert length == pytest.approx(0.1 * recording["alpha_true"][80, 1], abs=1e-5)
    drawn = {c["path"] for c in shown.commands if c["type"] == "set_object"}
    assert f"{couple}/head/second" in drawn, "a couple has two heads"


def test_legend_switches_every_contact_and_starts_without_the_frame(page: Path) -> None:
    told = config(page)
    drawn = {c["path"] for c in read_commands(page)}
    switches = {entry["text"]: entry for entry in told["legend"] if entry["paths"]}
    for entry in switches.values():
        for path in entry["paths"]:
            assert any(p.startswith(f"/meshcat/{path}") for p in drawn) or "label" in path, path
    assert [text for text, entry in switches.items() if not entry["shown"]] == ["best <frame>"]
    true = switches["force, true"]["paths"]
    assert {path.split("/")[1] for path in true} == {"left_end", "right_end"}
    moved = tracks(page)
    for entry in switches.values():
        for path in entry["paths"]:
            assert "visible" not in moved.get(f"/meshcat/{path}", {}), "switched and animated"


def test_plots_hold_the_recorded_numbers(page: Path) -> None:
    told, recording = config(page), make_recording()
    assert [panel["title"] for panel in told["panels"]] == ["contact force", "power"]
    lines = [line for panel in told["panels"] for line in panel["lines"]]
    assert np.allclose(told["curves"]["t"], recording["t"])
    for line, values in zip(lines, told["curves"]["y"], strict=True):
        channel = recording[line["key"]]
        expected = channel if line["index"] < 0 else channel[:, line["index"]]
        assert np.allclose(values, expected, rtol=1e-3, atol=1e-6)
    labels = [label for label in told["labels"] if label["line"] is not None]
    for i, label in enumerate(labels):
        line = lines[label["line"]]
        assert (line["key"], line["index"]) == ("alpha_true", i)
    assert (told["begin"], told["length"]) == (0.0, 1.0)


def test_thinning_keeps_short_peaks_in_their_place() -> None:
    t = np.arange(50_000) / 1000.0
    y = np.sin(t)
    y[31_415], y[20_000] = 7.0, -5.0
    channels = {"t": t, "power_total": y}
    (panel,) = panels_of({"power_total": 0.0})
    thin = thinned(panel["lines"], channels)
    times, values = np.array(thin["t"]), np.array(thin["y"][0])
    assert len(times) <= 900 and np.all(np.diff(times) >= 0.0)
    assert values.max() == 7.0 and abs(times[values.argmax()] - 31.415) < 0.12
    assert values.min() == -5.0 and abs(times[values.argmin()] - 20.0) < 0.12
    usual = np.abs(values) < 2.0
    assert np.abs(values[usual] - np.sin(times[usual])).max() < 0.12


def test_a_long_recording_gets_fewer_frames_per_second(tmp_path: Path) -> None:
    recording = make_recording()
    channels = {**recording.channels, "t": 40.0 * recording["t"]}
    path = write_scene(Recording(recording.meta, channels), ARMS, BODIES, tmp_path / "s.html")
    frames = {k for nodes in tracks(path).values() for keys in nodes.values() for k in keys}
    assert max(frames) <= MOST_FRAMES and path.stat().st_size < 3_000_000
    (animation,) = [c for c in read_commands(path) if c["type"] == "set_animation"]
    (fps,) = {a["clip"]["fps"] for a in animation["animations"]}
    assert max(frames) / fps == pytest.approx(40.0)


def test_the_camera_sees_everything_and_stands_no_further_than_needed() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        points = rng.standard_normal((30, 3)) * rng.uniform(0.1, 2.0, 3)
        view = rng.standard_normal(3) + [0.0, 0.0, 0.5]
        view /= np.linalg.norm(view)
        target, distance = fitted(points, view)
        right = np.cross([0.0, 0.0, 1.0], view) / np.linalg.norm(np.cross([0.0, 0.0, 1.0], view))
        eye = target + distance * view
        depth = (eye - points) @ view
        half = np.tan(np.deg2rad(FIELD_OF_VIEW_DEG / 2))
        x = (points - eye) @ right / depth / half / ASPECT
        y = (points - eye) @ np.cross(view, right) / depth / half
        assert depth.min() > 0.0 and max(np.abs(x).max(), np.abs(y).max()) < 1.0
        assert max(np.abs(x).max(), np.abs(y).max()) > 0.75


def test_changes_sends_only_what_differs() -> None:
    sink = CommandSink()
    scene = sink.visualizer()
    pose = pin.SE3(np.eye(3), np.array([1.0, 2.0, 3.0]))
    before = {"a": State(pose, (1.0, 2.0, 1.0)), "b": State(visible=True)}
    changes(scene, {}, before)
    assert [c["type"] for c in sink.commands] == ["set_transform", "set_property"]
    matrix = np.reshape(sink.commands[0]["matrix"], (4, 4)).T
    assert np.allclose(matrix @ [0.0, 1.0, 0.0, 1.0], [1.0, 4.0, 3.0, 1.0]), "scaled, then moved"
    sink.commands.clear()
    changes(scene, before, {"a": State(pose, (1.0, 2.0, 1.0)), "b": State(visible=False)})
    assert [(c["path"], c["value"]) for c in sink.commands] == [("/meshcat/b", False)]


def test_track_leaves_out_only_what_changes_nothing() -> None:
    from meshcat.animation import Animation

    animation, scene = Animation(default_framerate=30), CommandSink().visualizer()
    values = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 2.0, 2.0])
    track(scene["node"], animation, "opacity", "number", values)
    track(scene["other"], animation, "opacity", "number", np.ones(5))
    (clip,) = animation.lower()
    keys = {key["time"]: key["value"] for key in clip["clip"]["tracks"][0]["keys"]}
    assert keys == {0: 0.0, 3: 0.0, 4: 1.0, 5: 2.0, 7: 2.0}
    assert np.allclose(np.interp(np.arange(8), list(keys), list(keys.values())), values)


def test_short_arrow_is_a_smaller_head() -> None:
    for length, head in ((0.01, 0.01 / 0.035), (0.035, 1.0), (0.135, 1.0)):
        shaft, y, scale = arrow_lengths(length)
        assert scale == pytest.approx((head,) * 3)
        assert shaft[1] - y == pytest.approx(length, abs=2e-6)
    assert np.isfinite([*arrow_lengths(float("nan"))[0], *arrow_lengths(-3.0)[2]]).all()


def test_a_tube_keeps_its_radius_around_every_bend() -> None:
    rng = np.random.default_rng(5)
    path = np.cumsum(rng.standard_normal((40, 3)) + [2.0, 0.0, 0.0], axis=0)
    path = np.insert(path, 7, path[7], axis=0)
    mesh = tube(path, 0.1, sides=8)
    rings = np.asarray(mesh.vertices, dtype=float).reshape(-1, 8, 3)
    assert np.allclose(rings.mean(axis=1), np.delete(path, 7, axis=0), atol=1e-4)
    radii = np.linalg.norm(rings - rings.mean(axis=1, keepdims=True), axis=2)
    assert np.allclose(radii, 0.1, atol=1e-4)
    assert mesh.faces.max() < len(mesh.vertices)
    tube([[0.0, 0.0, 0.0]] * 3, 0.1)


@pytest.mark.parametrize(
    "recording",
    [
        make_recording(contacts=0),
        make_recording(without=("contact_point", "contact_direction", "closed", "alpha_true")),
    ],
    ids=["no contacts", "no contact channels"],
)
def test_scene_without_contacts(recording: Recording, tmp_path: Path) -> None:
    path = write_scene(recording, ARMS, BODIES, tmp_path / "scene.html", find=find)
    paths = {c["path"] for c in read_commands(path)}
    assert "/meshcat/bodies/rod" in paths
    assert not any("contacts" in p or "twists" in p for p in paths)


def test_scene_refuses_what_does_not_fit(tmp_path: Path) -> None:
    path = tmp_path / "scene.html"
    with pytest.raises(InvalidInputError, match=r"takes 4 numbers of q.*nq = 5"):
        write_scene(make_recording(), [ARMS[0]._replace(q_slice=slice(0, 4))], [], path)
    with pytest.raises(InvalidInputError, match="'pose'"):
        write_scene(make_recording(without=("pose",)), [], BODIES, path)
    with pytest.raises(InvalidInputError, match="0 frames/s"):
        write_scene(make_recording(), [], [], path, fps=0)
    with pytest.raises(InvalidInputError, match="#RRGGBB"):
        entry = {"colour": "red;}", "text": "x"}
        write_page(CommandSink(), path, "t", EMPTY | {"legend": [entry]})
    assert list(tmp_path.iterdir()) == []


def test_page_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    (tmp_path / "taken").mkdir()
    with pytest.raises(OSError):
        write_page(CommandSink(), tmp_path / "taken", "title")
    assert [p.name for p in tmp_path.iterdir()] == ["taken"]
    (tmp_path / "empty.html").write_text("<html></html>")
    with pytest.raises(InvalidInputError, match="no drawing commands"):
        write_png(tmp_path / "empty.html", tmp_path / "empty.png")


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
