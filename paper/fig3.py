"""Fig. 3: the workcell and the two-contact task, rendered from a run of the packaged scenario."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pinocchio as pin
from matplotlib.figure import Figure
from matplotlib.image import imread

import osc_contact as osc
from osc_contact.lab.reports.viewing import content_of
from osc_contact.lab.visual import contact_colour
from osc_contact.lab.visual.browser import write_png
from osc_contact.lab.visual.marks import TwistAxes
from osc_contact.lab.visual.page import EMPTY, CommandSink, write_page
from osc_contact.lab.visual.parts import States, changes
from osc_contact.lab.visual.plots import style
from osc_contact.lab.visual.scene import Scene, eye, label, picture_axes, samples_at, set_stage
from osc_contact.lab.visual.shapes import along, at, material, plain
from osc_contact.spatial import Array
from paper.statements import Answer
from paper.study import Ask, Data, Study, table_of

if TYPE_CHECKING:
    from meshcat import Visualizer

# --- Marks: an overhead camera, sensors, labels --------------------------------------------------

INK = "#2A3038"
VISION = "#2B7CAE"
JOINT_TORQUE = "#B04E82"
WRIST = "#008763"
_DARK = "#2E3338"


class Callout(NamedTuple):
    """A label beside what it names, joined to it by a thin line.

    Attributes:
        text: text of the label.
        feature: (3,) what it names.
        beside: to the right and up in the picture, where the label is (m).
    """

    text: str
    feature: Array
    beside: tuple[float, float]
    colour: str = INK

    def draw(self, scene: Visualizer, path: str, axes: Array) -> dict[str, Any]:
        """Make the nodes; axes: (2, 3) right and up. Returns the label for the page's scripts.

        Args:
            scene: scene of the page.
            path: under which the nodes stand.
            axes: (2, 3) directions of the picture: right and up.
        """
        spot = self.feature + np.asarray(self.beside) @ axes
        scene[f"{path}/label"].set_transform(at(spot).homogeneous)
        thick = 0.0016 * float(np.hypot(*self.beside)) ** 0.5
        _bar(scene[f"{path}/line"], self.feature, spot, thick, plain(self.colour))
        return label(f"{path}/label", self.text, self.colour)


#: Lens of an overhead camera above the middle of the rod; scenarios do not say where it hangs.
EYE = np.array([0.0, -0.08, 1.12])
#: The rectangle at the rod's height that it sees, from below the lens.
SEEN = np.array([[0.5, 0.4, 0.0], [-0.5, 0.4, 0.0], [-0.5, -0.4, 0.0], [0.5, -0.4, 0.0]])


def draw_camera(scene: Visualizer, corners: Array) -> None:
    """Make the nodes of the camera and of the pyramid that it sees.

    Args:
        scene: scene of the page.
        corners: (4, 3) of the rectangle that is seen, in order.
    """
    from meshcat.geometry import Box

    node = scene["vision"]
    body = EYE + [0.0, 0.0, 0.065]
    _bar(node["lens"], body, EYE, 0.027, material(_DARK))
    for k, (end, after) in enumerate(zip(corners, np.roll(corners, -1, axis=0), strict=True)):
        _bar(node[f"view/edge{k}"], EYE, end, 0.0014, plain(VISION, 0.8))
        _bar(node[f"view/rim{k}"], end, after, 0.0022, plain(VISION))
    _put(node["body"], Box([0.11, 0.075, 0.075]), material(_DARK), at(body))


def _bar(node: Visualizer, start: Array, end: Array, r: float, paint: Any) -> None:
    from meshcat.geometry import Cylinder

    X = along(0.5 * (start + end), end - start)
    _put(node, Cylinder(float(np.linalg.norm(end - start)), r), paint, X)


def _put(node: Visualizer, shape: Any, paint: Any, X: pin.SE3) -> None:
    node.set_object(shape, paint)
    node.set_transform(X.homogeneous)


# --- The workcell --------------------------------------------------------------------------------

SCENARIO = "workcell"
#: Sensors of an arm: frame, place in it (m), radius of the collar that marks them, colour.
SENSORS = {
    "joint_torque/{}1": ("joint1", (0.0, 0.0, -0.012), 0.094, JOINT_TORQUE),
    "joint_torque/{}2": ("joint2", (0.0, 0.0, -0.006), 0.064, JOINT_TORQUE),
    # of the quill, which slides through the forearm
    "joint_torque/{}3": ("joint2", (0.3, 0.0, -0.036), 0.037, JOINT_TORQUE),
    "joint_torque/{}4": ("joint4", (0.0, 0.0, 0.014), 0.026, JOINT_TORQUE),
    "wrist/{}": ("wrist_sensor", (0.0, 0.0, -0.004), 0.037, WRIST),
}
FACE_SIDE = 0.26


class Shot(NamedTuple):
    """One view of it.

    Attributes:
        title: title of the picture.
        points: (k, 3) that fill it.
        heading, elevation: angles of the eye (deg).
        size: width and height of the picture (CSS pixels).
        callouts: labels of the picture.
        whole: with the camera and its view.
    """

    title: str
    points: Array
    heading: float
    elevation: float
    size: tuple[int, int]
    callouts: Sequence[Callout]
    whole: bool = False


class Workcell:
    """The rig and what it stood like at one tick of a run (channels of the recording).

    Attributes:
        rig, sample: those.
        frames: X of every frame of the arms, by "arm/frame".
        seen: (4, 3) corners of what the camera sees.
        faces: poses of the faces.
        rings: by path, where a sensor's collar is, its radius and colour.
    """

    def __init__(self, rig: osc.Rig, sample: Data) -> None:
        """Place everything.

        Args:
            rig: rig of the scenario.
            sample: channels at the tick.
        """
        self.rig = rig
        self.sample = sample
        model = rig.chain.model
        data = model.createData()
        pin.framesForwardKinematics(model, data, sample["q"])
        self.frames = {f.name: X.copy() for f, X in zip(model.frames, data.oMf, strict=True)}
        self.seen = SEEN + [*EYE[:2], sample["pose"][2]]
        self.faces = [pin.XYZQUATToSE3(x) for x in sample["face_pose"]]
        self.rings = {
            path.format(arm.name): (self.frames[f"{arm.name}/{frame}"] * at(place), radius, colour)
            for arm in rig.chain.arms
            for path, (frame, place, radius, colour) in SENSORS.items()
        }

    def page(self, shot: Shot, path: Path) -> Path:
        """Write a still page of one view."""
        now = samples_at(self.sample, None)
        picture = Scene(content_of(self.rig), now)
        picture.parts = [part for part in picture.parts if not isinstance(part, TwistAxes)]
        sink = CommandSink()
        scene = sink.visualizer()
        picture.draw(scene)
        frame = picture.states(now)
        for node in frame:
            if node.endswith(("/commanded", "/measured")):
                frame[node] = States(visible=np.array([False]))
        changes(scene, {}, frame)
        if shot.whole:
            draw_camera(scene, self.seen)
        for node, (X, radius, colour) in self.rings.items():
            half = 0.004 * X.rotation[:, 2]
            collar = material(colour, glow=0.35)
            _bar(
                scene[f"sensors/{node}"], X.translation - half, X.translation + half, radius, collar
            )
        heading, elevation = np.deg2rad([shot.heading, shot.elevation])
        aspect = shot.size[0] / shot.size[1]
        view = eye(heading, elevation)
        set_stage(scene, shot.points, view, aspect)
        axes = picture_axes(view)
        labels = [c.draw(scene, f"callouts/{k}", axes) for k, c in enumerate(shot.callouts)]
        config = EMPTY | {"labels": labels, "aspect": aspect}
        return write_page(sink, path, shot.title, config)

    def answers(self) -> dict[str, Answer]:
        """To what the paper states about fig. 3."""
        scenario = self.rig.scenario
        chain = self.rig.chain
        d = self.rig.state.d
        motors = [arm.model.nv - len(arm.passive_joints) for arm in chain.arms]
        hinges = [len(arm.passive_joints) for arm in chain.arms]
        length = float(np.linalg.norm(np.diff(self.sample["contact_point"], axis=0)))
        closed = int(np.count_nonzero(self.sample["closed"]))
        return {
            "arms": Answer(
                f"{len(motors)} arms with {motors} driven joints hold a rod whose ends touch "
                f"{1e2 * length:.1f} cm apart.",
                motors == [4, 4] and 0.55 < length < 0.65,
            ),
            "hinges": Answer(
                f"{hinges} hinges; the closed chain of arms and rod has {d} freedoms.",
                hinges == [1, 1] and d == 5,
            ),
            "vision": Answer(
                f"Simulated: {_vision_words(self)}.", scenario.sensors.vision is not None
            ),
            "contacts": Answer(
                f"{closed} of {len(scenario.contacts)} contacts are closed in the picture.",
                closed == len(scenario.contacts) == 2,
            ),
        }

    def shots(self) -> list[Shot]:
        """The whole cell, the task."""
        return [_whole(self), _task(self)]


def run(duration: float = 1.4, seed: int = 0, changes: Sequence[str] = ()) -> Workcell:
    """Run the workcell until both contacts are made; the last tick is what is drawn.

    Args:
        duration: simulated time (s).
        seed: of everything random.
        changes: "path.to.key=value" of the scenario.
    """
    scenario = osc.load_scenario(SCENARIO, changes)
    recording = osc.run(scenario, duration=duration, seed=seed)
    sample = samples_at(recording.channels, len(recording) - 1)
    return Workcell(osc.build_rig(scenario), sample)


def draw(cell: Workcell) -> Figure:
    """Both views, rendered, side by side.

    Raises:
        ViewerError: no browser to render with.
    """
    pictures = []
    with tempfile.TemporaryDirectory(prefix="osc_contact_") as folder:
        for k, shot in enumerate(cell.shots()):
            page = cell.page(shot, Path(folder) / f"{k}.html")
            png = page.with_suffix(".png")
            pictures.append(imread(write_png(page, png, size=shot.size, bare=True, density=2.0)))
    with style():
        figure = Figure(figsize=(12.0, 5.6))
        axes = figure.subplots(1, 2, width_ratios=[1.0, 1.1])
        for ax, shot, picture in zip(axes, cell.shots(), pictures, strict=True):
            ax.imshow(picture)
            ax.set_title(shot.title)
            ax.set_axis_off()
    return figure


def _whole(cell: Workcell) -> Shot:
    rings = cell.rings
    left, right = (cell.frames[f"{name}/joint1"].translation for name in ("left", "right"))
    feet = [p * [1, 1, 0] + [0.13 * np.sign(p[0]), 0, 0] for p in (left, right)]
    points = np.vstack((feet, EYE + [0, 0, 0.17], cell.seen))
    corner = min(_corners(cell.faces[0]), key=lambda p: float(p[2]))
    vision = "overhead vision: " + _vision_words(cell)
    sensor = _edge(rings["joint_torque/left2"])
    hinge = cell.frames["left/hinge"].translation
    callouts = [
        Callout(vision, EYE + [0, 0, 0.09], (0.3, 0.05), VISION),
        Callout("left arm", left + [0, 0, 0.13], (0.16, 0.1)),
        Callout("right arm", right + [0, 0, 0.13], (-0.16, 0.14)),
        Callout("rod", cell.sample["pose"][:3], (-0.03, -0.11)),
        Callout("joint torque sensors", sensor, (0.06, -0.09), JOINT_TORQUE),
        Callout("wrist force/torque sensor", _edge(rings["wrist/right"]), (0.09, 0.11), WRIST),
        Callout("free hinge", hinge, (-0.12, 0.03)),
        Callout("moving face", corner, (0.05, -0.09)),
    ]
    return Shot("dual-arm workcell", points, 76.0, 27.0, (760, 800), callouts, whole=True)


def _task(cell: Workcell) -> Shot:
    corners = [corner for X_WF in cell.faces for corner in _corners(X_WF)]
    callouts = []
    for k, contact in enumerate(cell.rig.scenario.contacts):
        point, push = (cell.sample[f"contact_{what}"][k] for what in ("point", "direction"))
        name = f"{contact.name.replace('_', ' ')}: {cell.sample['alpha_true'][k]:.1f} N"
        beside = (0.1 - 0.2 * k, 0.03)
        callouts.append(Callout(name, point - 0.12 * push, beside, contact_colour(k)))
    points = np.vstack((corners, cell.sample["pose"][:3] + [0, 0, 0.12]))
    title = "two-contact task: the lines of force are skew"
    return Shot(title, points, 84.0, 30.0, (840, 560), callouts)


def _corners(X_WF: pin.SE3) -> list[Array]:
    """Four corners (3,) of the front of a face at X_WF, in the world (m)."""
    half = 0.5 * FACE_SIDE
    return [X_WF.act(np.array([a, b, 0.0])) for a in (-half, half) for b in (-half, half)]


def _edge(mark: tuple[pin.SE3, float, str]) -> Array:
    X, radius, _ = mark
    return X.translation - [radius, 0.0, 0.0]


def _vision_words(cell: Workcell) -> str:
    vision = cell.rig.scenario.sensors.vision
    if vision is None:
        return "ideal"
    return (
        f"{vision.rate:g} Hz, {1e3 * vision.delay:g} ms old, "
        f"±{1e3 * vision.position.noise:g} mm, ±{1e3 * vision.orientation.noise:g} mrad"
    )


def study(ask: Ask) -> Study:
    """Fig. 3: the workcell in two views, and its parts in words."""
    ask.tell("making contact")
    cell = run(ask.lasting(1.4), ask.seed, ask.changes)
    answers = cell.answers()
    data = {key: answer.found for key, answer in answers.items()}
    table = table_of("fig. 3: the workcell", "part; what it is", data.items())
    figures = {}
    ask.tell("rendering")
    try:
        figures["fig3"] = draw(cell)
    except osc.ViewerError as error:  # the page is there all the same
        table.add_row("picture", f"not rendered: {error}")
    pages = {"fig3": partial(cell.page, cell.shots()[0])}
    return Study(figures, table, data, answers, pages)
