"""Pages of scenes, decoded: poses, lengths, colours, screws, what is shown and fetched."""

import numpy as np
import pinocchio as pin
import umsgpack
from complaints import invalid_input
from html_pages import Page
from numpy.linalg import matrix_rank, norm
from pytest import approx, raises
from rigs import assert_near, largest
from samples import aligned, module_fixture, names_in, parametrize
from scene_samples import (
    ARMS,
    BODIES,
    ENDS,
    FACE,
    RECORDING,
    Shown,
    changed,
    links,
    make_recording,
    matrix,
    read_commands,
    write,
)

from osc_contact import robots
from osc_contact.lab.visual import contact_colour
from osc_contact.lab.visual.browser import write_png
from osc_contact.lab.visual.key_frames import Animation
from osc_contact.lab.visual.page import EMPTY, CommandSink, page_text, write_page
from osc_contact.lab.visual.parts import Content
from osc_contact.lab.visual.scene import (
    ASPECT,
    FIELD_OF_VIEW_DEG,
    MOST_FRAMES,
    TURNS,
    eye,
    fitted,
    headings,
    panels_of,
    picture_axes,
    thinned,
    write_scene,
)
from osc_contact.lab.visual.screws import twist_screw, wrench_screw
from osc_contact.lab.visual.shapes import along, triangle_colours, urdf_geometry, vertex_colours

LEFT, RIGHT = (f"/meshcat/contacts/{name}" for name in ENDS)


@module_fixture
def shown(tmp_path_factory):
    return Shown(write(tmp_path_factory.mktemp("scene")))


def test_page_fetches_nothing_and_escapes_its_words(shown):
    text = shown.page.read_text()
    page = Page(text)
    assert not page.loads and not page.links and "http" not in repr(shown.commands)
    assert "default-src 'none'" in text and 'connect-src data: blob:"' in text
    assert "connect-src data: blob:;" not in text
    assert "new WebSocket" not in text.rsplit("<script>", 2)[1]
    assert "<title>test &lt;scene&gt;</title>" in text
    entry = {"text": "a <word>", "colour": "#000000"}
    assert "a \\u003cword>" in page_text(CommandSink(), "", EMPTY | {"legend": [entry]})


def test_arm_and_object_stand_where_the_recording_has_them(shown):
    for frame in (0, 4, 10):
        placed = links(RECORDING["q"][10 * frame])
        for joint in ("joint1", "joint3", "hinge"):
            assert shown.pose(f"/meshcat/arms/left/{joint}", frame).isApprox(placed[joint], 1e-5)
        rod = shown.at("/meshcat/bodies/rod/base", "position", frame)
        assert_near(rod, RECORDING["pose"][10 * frame, :3], atol=1e-6)


def test_a_face_follows_its_recorded_pose(tmp_path):
    poses = np.tile(pin.SE3ToXYZQUAT(FACE), (101, 2, 1))
    poses[:, 0, 2] += 0.1 * RECORDING["t"]
    shown = Shown(write(tmp_path, changed(face_pose=poses)))
    for frame in (0, 7):
        expected = pin.XYZQUATToSE3(poses[10 * frame, 0])
        assert shown.pose("/meshcat/bodies/face/base", frame).isApprox(expected, 1e-5)


def test_what_is_not_known_stays_where_it_was(tmp_path):
    keys = ("q", "pose", "contact_point")
    channels = {key: RECORDING[key].copy() for key in keys}
    for values in channels.values():
        values[35:66] = np.nan
    shown = Shown(write(tmp_path, changed(**channels)))
    for node in ("/meshcat/arms/left/joint1", "/meshcat/bodies/rod/base", LEFT):
        stays, moves = (not shown.pose(node, 3).isApprox(shown.pose(node, k)) for k in (6, 7))
        assert (stays, moves) == (False, True), node
    for frame, known in {3: True, 5: False, 7: True}.items():
        for shape in ("closed", "commanded"):
            assert shown.seen(f"{RIGHT}/{shape}", frame) == known


@parametrize("frame", [3, 8])
@parametrize("i", [0, 1])
def test_force_arrows_have_their_tips_at_the_contact_and_10_mm_per_newton(shown, i, frame):
    tick = 10 * frame
    node = (LEFT, RIGHT)[i]
    placed = shown.pose(node, frame)
    for found, channel in ((placed.translation, "point"), (placed.rotation[:, 1], "direction")):
        assert_near(found, RECORDING[f"contact_{channel}"][tick, i], atol=1e-6)
    for arrow, channel in {"true": "true", "commanded": "cmd", "measured": "meas"}.items():
        alpha = RECORDING[f"alpha_{channel}"][tick, i]
        assert shown.length(f"{node}/{arrow}", frame) == approx(0.01 * alpha, abs=1e-5)
    beside = shown.at(f"{node}/measured", "position", 0)
    assert beside == approx([0.017, 0.0, 0.0]), "seen where it equals the true force"


def test_a_lost_contact_turns_grey_and_its_true_force_vanishes(shown):
    for frame in range(1, 11):
        lost = frame in (4, 5)
        for part, there in {
            f"{LEFT}/closed/line/rod": not lost,
            f"{LEFT}/true/shaft/rod": not lost,
            f"{LEFT}/lost/line/rod": lost,
            f"{LEFT}/commanded/shaft/rod": True,
            f"{RIGHT}/closed/line/rod": True,
        }.items():
            assert shown.seen(part, frame) == there, part
    assert not shown.seen(f"{RIGHT}/true/shaft/rod", 0), "no arrow for 0 N"
    paint = {path: one["materials"][0]["color"] for path, one in shown.objects.items()}
    for part in ("true/shaft/rod", "commanded/head/cone", "closed/line/rod", "closed/point"):
        assert paint[f"{LEFT}/{part}"] == int(contact_colour(0)[1:], 16)
    assert np.ptp([*paint[f"{LEFT}/lost/line/rod"].to_bytes(3)]) < 16, "grey"


def test_a_contact_that_is_not_active_is_faint_and_without_a_command(tmp_path):
    """The page of a controller that knows it; neither lost nor among what N holds."""
    phase = np.full((101, 2), 2)
    phase[40:, 0] = 0
    shown = Shown(write(tmp_path, changed(contact_phase=phase)))
    for frame in (3, 5, 7):
        known = frame > 3
        assert shown.seen(f"{LEFT}/known/line/rod", frame) == known
        for part in ("closed/line/rod", "lost/line/rod", "commanded/shaft/rod"):
            assert shown.seen(f"{LEFT}/{part}", frame) == (not known and part[0] != "l"), part
        assert shown.seen(f"{RIGHT}/closed/line/rod", frame)
        assert sum(shown.seen(f"/meshcat/twists/{i}", frame) for i in range(6)) == 4 + known
    opacity = {path: one["materials"][0]["opacity"] for path, one in shown.objects.items()}
    assert 3 * opacity[f"{LEFT}/known/line/rod"] < opacity[f"{LEFT}/lost/line/rod"]


@parametrize("frame, count", {2: 4, 5: 5, 9: 4})  # the left one is lost at 5
def test_twist_axes_are_motions_that_the_closed_contacts_permit(shown, frame, count):
    """The velocity of each contact point, moved as drawn, has no part along the force.

    Drawn is: turn by 1 rad about the y-axis of the node and advance as steeply as the path
    beside it.
    """
    drawn = [i for i in range(6) if shown.seen(f"/meshcat/twists/{i}/label", frame)]
    twists = []
    for i in drawn:
        node = f"/meshcat/twists/{i}"
        placed = shown.pose(node, frame)
        axis = placed.rotation[:, 1]
        on_axis = placed.translation
        omega = np.zeros(3)
        v = axis
        slides, turns = (shown.at(f"{node}/{way}", "visible", frame) for way in ("slide", "turn"))
        assert slides != turns
        if turns:
            path, turned = shown.path_of_tube(f"{node}/turn/path/tube")
            path = path * shown.at(f"{node}/turn/path", "scale", frame)
            pitch = (path[-1, 1] - path[0, 1]) / (turned[-1] - turned[0])
            omega = axis
            v = (pitch if abs(pitch) > 1e-5 else 0.0) * axis
        twists.append(np.concatenate([v - np.cross(omega, on_axis), omega]))  # at the origin
        for c in np.flatnonzero(RECORDING["closed"][10 * frame]):
            speed = v + np.cross(omega, RECORDING["contact_point"][10 * frame, c] - on_axis)
            along_force = speed @ RECORDING["contact_direction"][10 * frame, c]
            assert abs(along_force) < 2e-3 * max(1.0, norm(speed))
    assert len(drawn) == matrix_rank(twists, tol=1e-3) == count


def test_a_column_with_a_couple_is_a_screw(tmp_path):
    """N = [d; (p − O) × d + h d]: the line keeps its place, and a helix of pitch h is beside it."""
    pitch = 0.03
    d = RECORDING["contact_direction"]
    p = RECORDING["contact_point"]
    arms = p - RECORDING["pose"][:, None, :3]
    N = np.concatenate([d, np.cross(arms, d) + pitch * d], axis=2).transpose(0, 2, 1)
    N[:, :3, 1] = 0.0
    N[:, 3:, 1] = d[:, 1]  # the second contact transmits a pure couple
    shown = Shown(write(tmp_path, changed(N=N)))
    offset = shown.pose(LEFT, 3).translation - p[30, 0]
    assert_near(np.cross(offset, d[30, 0]), 0.0, atol=1e-6)
    path, turned = shown.path_of_tube(f"{LEFT}/closed/line/pitch")
    assert np.polyfit(turned, path[:, 1], 1)[0] == approx(pitch, rel=1e-3)
    couple = 0.1 * RECORDING["alpha_true"][80, 1]
    assert shown.length(f"{RIGHT}/true", 8) == approx(couple, abs=1e-5)
    assert f"{RIGHT}/true/head/second" in shown.objects, "a couple has two heads"
    assert_near(shown.pose(RIGHT, 8).rotation[:, 1], d[80, 1], atol=1e-6)


def test_key_frames_are_read_as_written():
    """The reader of MessagePack checks single precision and omitted keys in equal stretches."""
    rng = np.random.default_rng(5)
    positions = rng.standard_normal((70_000, 3))
    positions[3:9] = positions[3]
    visible = np.repeat([True, False, True], [1, 4, 69_995])
    animation = Animation(29.7)
    animation.track("/a", "position", "vector3", positions)
    animation.track("/a", "visible", "boolean", visible)
    animation.track("/b", "scale", "vector3", np.ones((70_000, 3)))
    message = umsgpack.unpackb(animation.message())
    assert message["type"] == "set_animation" and message["options"]["play"] is True
    ((clip, path),) = [(one["clip"], one["path"]) for one in message["animations"]]
    assert (path, clip["fps"]) == ("/a", approx(29.7))
    moves, shows = clip["tracks"]
    assert (moves["name"], moves["type"], shows["name"]) == (".position", "vector3", ".visible")
    kept = np.setdiff1d(np.arange(70_000), np.arange(4, 8))
    assert [key["time"] for key in moves["keys"]] == kept.tolist()
    found = [key["value"] for key in moves["keys"]]
    assert np.array_equal(found, positions[kept].astype(np.float32))
    assert [(key["time"], key["value"]) for key in shows["keys"]] == [
        (0, True),
        (1, False),
        (4, False),
        (5, True),
        (69_999, True),
    ]


def test_legend_switches_every_contact(shown):
    switches = {entry["text"]: entry for entry in shown.config["legend"] if entry["paths"]}
    paths = [f"/meshcat/{path}" for entry in switches.values() for path in entry["paths"]]
    for path in paths:
        assert any(c["path"].startswith(path) for c in shown.commands) or "label" in path, path
        assert (path, "visible") not in shown.tracks, "switched and animated"
    assert {path.split("/")[1] for path in switches["force, true"]["paths"]} == set(ENDS)


def test_plots_hold_the_recorded_numbers(shown):
    page = shown.config
    assert [panel["title"] for panel in page["panels"]] == ["contact force", "power"]
    lines = [line for panel in page["panels"] for line in panel["lines"]]
    assert np.allclose(page["curves"]["t"], RECORDING["t"])
    for line, values in aligned(lines, page["curves"]["y"]):
        channel = RECORDING[line["key"]]
        expected = channel if line["index"] < 0 else channel[:, line["index"]]
        assert_near(values, expected, atol=1e-6, rtol=1e-3)
    numbers = [lines[one["line"]] for one in page["labels"] if one["line"] is not None]
    assert [(x["key"], x["index"]) for x in numbers] == [("alpha_true", 0), ("alpha_true", 1)]
    assert (page["begin"], page["length"]) == (0.0, 1.0)


def test_thinning_keeps_short_peaks_in_their_place():
    t = np.arange(50_000) / 1000.0
    y = np.sin(t)
    y[31_415] = 7.0
    y[20_000] = -5.0
    (panel,) = panels_of({"power_total": 0.0})
    thin = thinned(panel["lines"], {"t": t, "power_total": y})
    times, values = np.array((thin["t"], thin["y"][0]))
    assert len(times) <= 900 and np.all(np.diff(times) >= 0.0)
    for peak, at in ((values.argmax(), 31_415), (values.argmin(), 20_000)):
        assert values[peak] == y[at] and abs(times[peak] - t[at]) < 0.12
    usual = np.abs(values) < 2.0
    assert largest(values[usual] - np.sin(times[usual])) < 0.12


def test_a_long_recording_gets_fewer_frames_per_second(tmp_path):
    shown = Shown(write(tmp_path, changed(t=40.0 * RECORDING["t"]), fps=30))
    last = max(map(max, shown.tracks.values()))
    assert last <= MOST_FRAMES and shown.page.stat().st_size < 3_000_000
    (fps,) = {a["clip"]["fps"] for a in shown.animation["animations"]}
    assert last / fps == approx(40.0)


def test_the_first_view_is_one_in_which_no_arm_hides_a_force():
    force = np.array([[0.6, 0.0, 0.3], [0.6, 0.0, 0.4]])
    bases, pushes = np.zeros((1, 3)), np.array([[0.0, 0.0, -1.0]])
    first, second = (np.deg2rad(turn) for turn in TURNS[:2])
    for turned, arm in (
        (first, np.zeros((0, 3))),
        (first, force - 0.2 * eye(first)),  # behind it
        (second, force + 0.2 * eye(first)),
        (first, force + 0.2 * eye(second)),
    ):
        front, side = headings(force, bases, pushes, force, arm)
        assert front == 0.0 and side == approx(turned)


@parametrize("seed", range(20))
def test_the_camera_sees_everything_and_stands_no_further_than_needed(seed):
    rng = np.random.default_rng(seed)
    points = rng.standard_normal((30, 3)) * rng.uniform(0.1, 2.0, 3)
    view = rng.standard_normal(3) + [0.0, 0.0, 0.5]
    view /= norm(view)
    target, offset = fitted(points, view)
    away = points - target - offset
    image = away @ picture_axes(view).T / -(away @ view)[:, None] / [ASPECT, 1.0]
    image /= np.tan(np.deg2rad(FIELD_OF_VIEW_DEG / 2))
    assert (away @ view).max() < 0.0 and 0.75 < largest(image) < 1.0


@parametrize(
    "how",
    [{"contacts": 0}, {"without": ("contact_point", "contact_direction", "closed", "alpha_true")}],
)
def test_scene_without_contacts(how, tmp_path):
    paths = {c["path"] for c in read_commands(write(tmp_path, make_recording(**how)))}
    assert "/meshcat/bodies/rod/base" in paths
    assert not any("contacts" in p or "twists" in p for p in paths)


@parametrize(
    "complaint, make",
    {
        r"takes 4 numbers of q.*nq = 5": lambda p: write_scene(
            RECORDING, Content("", [ARMS[0]._replace(q_slice=slice(0, 4))]), p
        ),
        "'pose'": lambda p: write_scene(
            make_recording(without=("pose",)), Content("", [], BODIES), p
        ),
        "0 frames/s": lambda p: write_scene(RECORDING, Content("", []), p, fps=0),
        "#RRGGBB": lambda p: write_page(
            CommandSink(), p, "t", EMPTY | {"legend": [{"colour": "red;}", "text": "x"}]}
        ),
        "no finite length": lambda p: along([0, 0, 0], [0, 0, 0]),
    },
)
def test_scene_refuses_what_does_not_fit(make, complaint, tmp_path):
    with invalid_input(complaint):
        make(tmp_path / "scene.html")
    assert not any(tmp_path.iterdir())


def test_page_is_written_whole_or_not_at_all(tmp_path):
    (tmp_path / "taken").mkdir()
    with raises(OSError):
        write_page(CommandSink(), tmp_path / "taken", "title")
    assert names_in(tmp_path) == {"taken"}
    empty = tmp_path / "empty.html"
    empty.write_text("<html></html>")
    with invalid_input("no drawing commands"):
        write_png(empty, tmp_path / "empty.png")


def test_urdf_shapes_lie_as_in_the_urdf(tmp_path):
    mesh = tmp_path / "tetra.obj"
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
    mesh.write_text(f"{corners}f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    shapes = (
        'box size="1 2 3"',
        'cylinder radius="0.1" length="0.7"',
        'sphere radius="0.2"',
        f'mesh filename="{mesh}" scale="2 2 2"',
    )
    visuals = "".join(
        f'<visual><origin xyz="{i} 0 0"/><geometry><{shape}/></geometry><material name="m{i}">'
        '<color rgba="1 0.5 0 0.4"/></material></visual>'
        for i, shape in enumerate(shapes)
    )
    urdf = tmp_path / "shapes.urdf"
    urdf.write_text(f'<robot name="r"><link name="l">{visuals}</link></robot>')
    _, geometry, _ = robots.load_geometry(urdf, pin.GeometryType.VISUAL)
    capsule = pin.GeometryObject.CreateCapsule(0.1, 0.4)
    sink = CommandSink()
    for i, shape in enumerate([*geometry.geometryObjects, capsule]):
        urdf_geometry(sink.visualizer()[str(i)], shape)
    drawn = {c["path"]: c["object"] for c in sink.commands if c["type"] == "set_object"}
    placed = {c["path"]: matrix(c) for c in sink.commands if c["type"] == "set_transform"}
    box, cylinder, sphere, tetra = (drawn[f"/meshcat/{i}/shape"]["geometries"][0] for i in range(4))
    for shape, expected in (
        (box, {"width": 1.0, "height": 2.0, "depth": 3.0}),
        (cylinder, {"radiusTop": 0.1, "height": 0.7}),
        (sphere, {"radius": 0.2}),
    ):
        assert expected.items() <= shape.items()
    assert np.allclose(placed["/meshcat/1/shape"][:3, :3] @ [0, 1, 0], [0, 0, 1])
    vertices = np.frombuffer(tetra["data"]["attributes"]["position"]["array"].data, np.float32)
    assert vertices.max() == 2.0 and len(vertices) % 3 == 0 and placed["/meshcat/2"][0, 3] == 2.0
    paint = drawn["/meshcat/0/shape"]["materials"][0]
    assert paint["color"] == 0xFF8000 and paint["opacity"] == approx(0.4)
    assert placed["/meshcat/4/shape/top"][2, 3] == approx(capsule.geometry.halfLength)


def test_screws_are_the_wrenches_they_are_of():
    """f = |f| d and m = (p − O) × f + h f, for each of many; a couple has no line."""
    rng = np.random.default_rng(3)
    wrenches = rng.standard_normal((40, 6)) * 10.0 ** rng.uniform(-3, 3, (40, 1))
    wrenches[:10, :3] = 0.0
    origins = rng.standard_normal((40, 3))
    point, direction, pitch = wrench_screw(wrenches, origins)
    assert_near(norm(direction, axis=1), 1.0, atol=1e-12)
    assert np.isinf(pitch[:10]).all() and np.isfinite(pitch[10:]).all()
    assert_near(point[:10], origins[:10], atol=0.0)
    couples = wrenches[:10, 3:]
    assert_near(direction[:10], couples / norm(couples, axis=1)[:, None], atol=1e-12)
    lines = (part[10:] for part in (wrenches, origins, point, direction, pitch))
    for wrench, O, p, d, h in aligned(*lines):
        f = norm(wrench[:3]) * d
        moment = np.cross(p - O, f) + h * f
        assert_near(np.append(f, moment), wrench, atol=1e-9 * norm(wrench))
        assert abs((p - O) @ d) < 1e-9 * max(1.0, norm(p - O)), "the point nearest to O"
        single = wrench_screw(wrench, O)
        assert_near(
            np.hstack([single.point, single.direction, single.pitch]), [*p, *d, h], atol=1e-12
        )


@parametrize(
    "bad", [np.zeros(6), np.ones(5), [np.nan, 0, 0, 0, 0, 1], np.eye(6)[:, :5] @ np.eye(5, 6)]
)
def test_what_is_no_screw_is_refused(bad):
    with invalid_input("no screw"):
        twist_screw(bad, np.zeros(3))


# Colours of COLLADA meshes: by material, in the order of the file's triangles.


DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<library_effects>
 <effect id="r-fx"><profile_COMMON><technique sid="t"><phong>
  <diffuse><color>1 0 0 1</color></diffuse></phong></technique></profile_COMMON></effect>
 <effect id="b-fx"><profile_COMMON><technique sid="t"><phong>
  <diffuse><color>0 0 1 1</color></diffuse></phong></technique></profile_COMMON></effect>
</library_effects>
<library_materials>
 <material id="red"><instance_effect url="#r-fx"/></material>
 <material id="blue"><instance_effect url="#b-fx"/></material>
</library_materials>
<library_geometries>
 <geometry id="g"><mesh>
  <triangles material="one" count="2"/><triangles material="two" count="1"/>
 </mesh></geometry>
</library_geometries>
<library_visual_scenes><visual_scene id="s"><node><instance_geometry url="#g">
 <bind_material><technique_common>
  <instance_material symbol="one" target="#red"/><instance_material symbol="two" target="#blue"/>
 </technique_common></bind_material>
</instance_geometry></node></visual_scene></library_visual_scenes>
</COLLADA>
"""
RED = (0.88, 0.14, 0.14)
BLUE = (0.14, 0.14, 0.88)


def test_triangles_have_the_colours_of_their_materials(tmp_path):
    file = tmp_path / "two.dae"
    file.write_text(DAE)
    assert_near(triangle_colours(file, 3), [RED, RED, BLUE], atol=1e-12)
    found = vertex_colours(file, np.array([[0, 1, 2], [2, 1, 3], [4, 5, 6]]), 7)
    assert_near(found, [RED] * 4 + [BLUE] * 3, atol=1e-6)


@parametrize(
    "name, text, count",
    [
        ("two.stl", DAE, 3),
        ("two.dae", DAE, 4),
        ("two.dae", "<COLLADA", 3),
        ("two.dae", DAE.replace('count="2"', 'count="many"'), 3),
        ("two.dae", '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema"/>', 0),
    ],
)
def test_what_is_not_given_is_not_guessed(name, text, count, tmp_path):
    (tmp_path / name).write_text(text)
    assert triangle_colours(tmp_path / name, count) is None


def test_the_pandas_hand_is_white_with_dark_parts():
    """Its DAE has 1 1 1 and 0.25 0.25 0.25 among others; read with Pinocchio's triangles."""
    path, folders = robots.resolve_urdf("panda")
    _, geometry, _ = robots.load_geometry(path, pin.GeometryType.VISUAL, folders)
    (hand,) = [shape for shape in geometry.geometryObjects if shape.name == "panda_hand_0"]
    colours = triangle_colours(hand.meshPath, hand.geometry.num_tris)
    assert colours is not None and len(colours) == hand.geometry.num_tris
    grey = np.ptp(colours, axis=1) < 0.03
    assert grey.mean() > 0.9, "no colour but grey"
    assert 0.3 < (colours[:, 0] < 0.4).mean() < 0.6, "the dark parts: 2798 of 7078 triangles"
