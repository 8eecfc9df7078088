"""Three-dimensional scene of a recording, and the page that plays it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from osc_contact.errors import InvalidInputError
from osc_contact.files import Json
from osc_contact.lab.visual import OKABE_ITO, contact_colour, marks
from osc_contact.lab.visual.key_frames import Animation
from osc_contact.lab.visual.page import EMPTY, CommandSink, write_page
from osc_contact.lab.visual.parts import Content, Frames, Moving, Part, Samples, animate
from osc_contact.lab.visual.screws import contact_normals
from osc_contact.lab.visual.shapes import at, plain, rgb
from osc_contact.recorder import Recording, column_names
from osc_contact.spatial import Array, norm

if TYPE_CHECKING:
    from meshcat import Visualizer


MOST_FRAMES = 360
"""Key frames of a page; a longer recording gets fewer per second, and motion in between."""


class Scene:
    """Parts of a scene, which are drawn once and then moved at each tick.

    Args:
        content: content of the scene.
        first: channels of the first tick; parts whose channels are missing are not drawn.
    """

    def __init__(self, content: Content, first: Samples) -> None:
        """Make the parts of the scene: arms, bodies, forces, axes of twists, trails and plots.

        Args:
            content: description of the arms, bodies and contacts.
            first: channels of the first tick by name, which determine the parts of the picture.
        """
        # forces are drawn only if the recording has the points at which they act
        has_points = {"contact_point", "contact_direction", "pose"} <= first.keys()
        contacts = content.contacts if has_points else ()
        self.owners = list(content.columns or range(len(contacts))) if contacts else []
        first = self._with_normals(first)
        names = column_names(contacts, self.owners)
        columns = enumerate(zip(names, self.owners, strict=True))
        self.arms = [Moving(arm, "arms") for arm in content.arms]
        self.bodies = [Moving(body, "bodies") for body in content.bodies]
        self.forces = [marks.ContactForce(name, i, owner, first) for i, (name, owner) in columns]
        self.parts: list[Part] = [*self.arms, *self.bodies, *self.forces]
        self.trails = marks.Trails(contacts)
        self.legend = marks.legend(self.forces)
        if contacts:
            axes = marks.TwistAxes(first)
            self.parts.append(axes)
            self.legend.append(axes.legend())
        self.legend.append(self.trails.legend())
        self.panels = panels_of(first, names, self.owners)
        self.lines = [line for panel in self.panels for line in panel["lines"]]

    def _with_normals(self, samples: Samples) -> Samples:
        """Channels with the further entry "normals" (`Normals`), if there are contacts."""
        if not self.owners:
            return samples
        return {**samples, "normals": contact_normals(samples, self.owners)}

    def draw(self, scene: Visualizer) -> None:
        """Draw all parts once.

        Args:
            scene: root of the scene.
        """
        for part in self.parts:
            part.draw(scene)

    def states(self, samples: Samples) -> Frames:
        """States of all moving nodes at several ticks, by the path of the node.

        Args:
            samples: channels of the ticks.
        """
        samples = self._with_normals(samples)
        return {path: frame for part in self.parts for path, frame in part.states(samples).items()}

    def look(self, scene: Visualizer, samples: Samples) -> list[Json]:
        """Draw floor and background, and place cameras that show all samples.

        Args:
            scene: root of the scene.
            samples: some ticks of the recording, beginning with the first one.

        Returns:
            Cameras of the page, the first of which is set, with name, target, and offset of the
            camera from the target (m, world).
        """
        nothing = np.zeros((0, 3))
        first = samples_at(samples, slice(1))
        samples = self._with_normals(samples)
        small: Sequence[Moving | marks.ContactForce] = (*self.bodies, *self.forces)
        contact_points = np.vstack([nothing, *(part.corners(samples) for part in small)])
        links = np.vstack([nothing, *(arm.corners(first) for arm in self.arms)])
        points = np.vstack((contact_points, links))
        bases = np.vstack([nothing, *(arm.base[:3] for arm in self.arms)])
        directions = first.get("contact_direction", nothing)
        # the floor is at the lowest base, or lower if parts would be in it
        floor = np.min(bases[:, 2], initial=0.0)
        lowest = points[:, 2].min()
        if lowest <= floor - 0.05:
            floor = lowest - 0.1
        pushes = np.nan_to_num(directions.reshape(-1, 3))
        arrows = np.vstack([nothing, *(force.corners(samples) for force in self.forces)])
        # directions from which arms, forces and faces hide one another least
        front, side = headings(points, bases, pushes, arrows, links)
        if not len(contact_points):
            contact_points = points
        views = {
            "whole": (points, eye(side)),
            "contacts": (contact_points, eye(side)),
            "from above": (contact_points, eye(front, np.deg2rad(85.0))),
            "other side": (points, eye(side + np.pi)),
        }
        set_stage(scene, points, views["whole"][1], floor=floor)
        cameras = []
        for name, (in_view, view) in views.items():
            target, offset = fitted(in_view, view)
            cameras.append({"name": name, "target": target.tolist(), "offset": offset.tolist()})
        return cameras

    def config(self, **more: Any) -> Json:
        """Configuration of the page's scripts: legend, labels and plots, as data for JSON.

        A label of a contact force shows the number of its line of true forces, and is hidden with
        it.

        Args:
            more: further entries, for example curves and cameras.
        """
        numbers = {(line["key"], line["index"]): k for k, line in enumerate(self.lines)}
        labels = [
            label(
                f"{force.path}/label",
                force.words,
                force.colour,
                line=numbers.get(("alpha_true", force.column)),
                unit="N m" if force.couple else "N",
                lost=f"{force.path}/lost",
            )
            for force in self.forces
        ]
        if self.forces:
            for i, name in enumerate(("t₁", "t₂", "t₃", "t₄", "t₅", "t₆")):
                labels.append(label(f"twists/{i}/label", name, marks.T_COLOUR))
        legend = [entry._asdict() for entry in self.legend]
        return EMPTY | {"legend": legend, "labels": labels, "panels": self.panels} | more


def label(path: str, text: str, colour: str, **more: Any) -> Json:
    """Make the description of a label for the page's scripts.

    Args:
        path: path of the node at which the label is drawn.
        text: text of the label.
        colour: ``#RRGGBB``.
        more: `line` and `unit`: index of the plotted line and unit of the value beside the label;
            `lost`: node that is visible while the contact is lost.
    """
    empty = {"line": None, "unit": "", "lost": None}
    return {"path": path, "text": text, "colour": colour} | empty | more


def write_scene(
    recording: Recording,
    content: Content,
    path: str | Path,
    fps: float = 30.0,
    still: float | None = None,
) -> Path:
    """Write the recording as an HTML page that plays by itself, with a time slider and plots.

    Args:
        recording: recording with the channel ``t``; ``q``, ``pose``, ``face_pose`` and the contact
            channels are drawn if it has them.
        content: bodies and marks of the scene.
        path: file of the page.
        fps: key frames per second, fewer if there would be more than 360.
        still: time at which the page stands still when it is opened (s); None: it plays.

    Returns:
        Path of the page.

    Raises:
        InvalidInputError: no ticks, fps < 1, a channel that a body needs is missing, or an arm's
            slice of q does not fit its URDF.
    """
    t = np.asarray(recording.channels["t"], dtype=float)
    if t.size == 0 or fps < 1:
        raise InvalidInputError(f"{t.size} ticks at {fps} frames/s make no picture: both need >= 1")
    length = float(t[-1] - t[0])
    # key frames at equal intervals, each from the first tick that is not earlier
    fps = float(min(fps, MOST_FRAMES / length)) if length else float(fps)
    times = np.arange(int(length * fps + 1e-9) + 1) / fps
    ticks = np.minimum(np.searchsorted(t - t[0], times - 1e-9), t.size - 1)
    samples = samples_at(recording.channels, ticks)
    picture = Scene(content, samples_at(samples, slice(1)))
    # the scene's commands are collected in the page instead of being sent to a viewer
    sink = CommandSink()
    scene = sink.visualizer()
    animation = Animation(fps)
    picture.draw(scene)
    picture.trails.extend(samples)
    frames = picture.states(samples)
    picture.trails.draw(scene)
    animate(scene, animation, frames)
    cameras = picture.look(scene, samples_at(samples, slice(None, None, max(len(ticks) // 20, 1))))
    sink.animation = animation.message()
    config = picture.config(
        curves=thinned(picture.lines, recording.channels),
        begin=float(t[0]),
        length=float(times[-1]),
        still=still,
        cameras=cameras,
    )
    return write_page(sink, path, content.title, config)


def samples_at(channels: Mapping[str, Any], ticks: int | slice | NDArray[np.intp] | None) -> Json:
    """Take channels at some ticks, as arrays of numbers.

    Args:
        channels: channels of a recording, or of one tick.
        ticks: index or indices of ticks; None: the channels are those of one tick, without an axis
            of ticks, and get such an axis.
    """
    return {key: np.asarray(value[ticks], dtype=float) for key, value in channels.items()}


# --- The stage: floor, background, and a camera that sees the forces from the side --------------

BACKGROUND = [0.93, 0.945, 0.96]
FLOOR_COLOUR = "#E3E7EC"
GRID_COLOUR = "#C9D0D9"
FLOOR_SIDE = 16.0
GRID_STEP = 0.25
GRID_LINES = 16
FIELD_OF_VIEW_DEG = 30.0
ELEVATION = np.deg2rad(28.0)
ASPECT = float(EMPTY["aspect"])
"""Width / height that the scene is fitted to; a wider window shows more floor."""
FILLED = 0.9
TURNS = (25, -25, 10, -10, 40, -40, 55, -55)
"""Headings from the object's side (deg) that are compared; the first of equal ones is taken."""
COVERED, NEARER = 0.04, 0.02
"""A point of an arm hides objects within this distance in the picture, and this far behind (m)."""


def set_stage(
    scene: Visualizer, points: Array, view: Array, aspect: float = ASPECT, floor: float = 0.0
) -> None:
    """Draw a floor with lines every 0.25 m and a background, and place a camera.

    meshcat 0.3.2 has no camera methods, and its orbit controls rotate about the viewer's origin.
    Therefore the whole scene is moved so that the target is at the origin, and the camera is placed
    at the offset in three.js axes (y up).

    Args:
        scene: root of the scene.
        points: (k, 3) points that fill the picture (m).
        view: (3,) unit vector from the target to the eye.
        aspect: width / height of the picture.
        floor: height of the floor (m).
    """
    from meshcat.geometry import Box, LineBasicMaterial, LineSegments, PointsGeometry

    # the floor lies slightly below its height, so that it does not flicker with faces on it
    ground = scene["floor"]
    ground.set_transform(at([*centre(points)[:2], floor - 0.0025]).homogeneous)
    ground["plane"].set_object(Box([FLOOR_SIDE, FLOOR_SIDE, 0.01]), plain(FLOOR_COLOUR))
    ground["plane"].set_transform(at([0.0, 0.0, -0.007]).homogeneous)
    steps = np.arange(-GRID_LINES, GRID_LINES + 1) * GRID_STEP
    end = steps[-1]
    lines = [[(s, -end, 0.0), (s, end, 0.0), (-end, s, 0.0), (end, s, 0.0)] for s in steps]
    ends = np.array(lines, dtype=np.float32).reshape(-1, 3).T
    ground["grid"].set_object(
        LineSegments(PointsGeometry(ends), LineBasicMaterial(color=rgb(GRID_COLOUR)))
    )
    # the scene is moved so that the target is the origin; three.js has its y-axis upwards
    target, offset = fitted(points, view, aspect)
    scene.set_transform(at(-target).homogeneous)
    x, y, z = offset.tolist()
    camera = scene["/Cameras/default/rotated/<object>"]
    camera.set_property("position", [x, z, -y])
    camera.set_property("fov", FIELD_OF_VIEW_DEG)
    for place in ("top_color", "bottom_color"):
        scene["/Background"].set_property(place, BACKGROUND)
    for helper in ("/Grid", "/Axes"):
        scene[helper].set_property("visible", False)


def headings(
    points: Array, bases: Array, pushes: Array, arrows: Array, links: Array
) -> tuple[float, float]:
    """Headings of two cameras (rad): at the object's side, and near it for a view of the forces.

    Best is the heading at which the arms hide the fewest arrows; among equal ones that at which the
    forces are seen most from the side.

    Args:
        points: (k, 3) points that are shown (m).
        bases: (arms, 3) positions of the arms' bases (m).
        pushes: (contacts, 3) directions of the forces.
        arrows: (k, 3) points of the arrows (m).
        links: (k, 3) points of the arms (m).

    Returns:
        Angle about the vertical axis of the direction from the target to each camera.
    """
    middle = centre(points)[:2]
    direction = middle - bases[:, :2].mean(axis=0) if len(bases) else middle
    front = np.arctan2(direction[1], direction[0]) if norm(direction) > 0.02 else -np.pi / 3
    views = {turn: eye(front + np.deg2rad(turn)) for turn in TURNS}
    cost = {
        turn: (
            round(float(hidden(arrows, links, view)), 1),
            round(float(np.abs(pushes @ view).max(initial=0.0)), 1),
        )
        for turn, view in views.items()
    }
    return (front, front + np.deg2rad(min(TURNS, key=lambda turn: cost[turn])))


def hidden(points: Array, links: Array, view: Array) -> float:
    """Share of points that points of the arms hide.

    Args:
        points: (k, 3) points to be seen (m).
        links: (n, 3) points of the arms (m).
        view: (3,) unit vector towards the eye.
    """
    if not len(points) or not len(links):
        return 0.0
    axes = picture_axes(view)
    distances = np.linalg.norm((links @ axes.T)[None] - (points @ axes.T)[:, None], axis=2)
    nearer = (links @ view)[None] > (points @ view)[:, None] + NEARER
    return float(np.mean(((distances < COVERED) & nearer).any(axis=1)))


def fitted(points: Array, view: Array, aspect: float = ASPECT) -> tuple[Array, Array]:
    """Target (3,) of a camera, and offset (3,) of the eye from it, so that points fill the picture.

    Args:
        points: (k, 3) points (m).
        view: (3,) unit vector from the target to the eye.
        aspect: width / height of the picture.
    """
    axes = np.vstack((picture_axes(view), view))
    half = np.tan(np.deg2rad(0.5 * FIELD_OF_VIEW_DEG)) * np.array([aspect, 1.0]) * FILLED
    target = axes.T @ centre(points @ axes.T)
    for _ in range(20):  # perspective: centre the picture at the distance that just fits
        in_view = (points - target) @ axes.T
        distance = (np.abs(in_view[:, :2]) / half + in_view[:, 2:]).max() + 0.05
        image = in_view[:, :2] / (distance - in_view[:, 2:])
        target = target + axes[:2].T @ (centre(image) * distance)
    return (target, max(distance, 0.3) * view)


def centre(points: Array) -> Array:
    """Centre (n,) of the bounding box of points (k, n)."""
    return 0.5 * (points.min(axis=0) + points.max(axis=0))


def picture_axes(view: Array) -> Array:
    """Unit vectors (2, 3) to the right and upwards in a picture, for a view (3,) as in `fitted`."""
    right = np.cross([0.0, 0.0, 1.0], view)
    right /= norm(right)
    return np.array([right, np.cross(view, right)])


def eye(heading: float, elevation: float = ELEVATION) -> Array:
    """Unit vector (3,) from a target to the eye; heading (from x about z) and elevation in rad."""
    flat = np.array([np.cos(heading), np.sin(heading), 0.0])
    return np.cos(elevation) * flat + [0.0, 0.0, np.sin(elevation)]


# --- Plots below the scene: contact forces and power over time ----------------------------------

_FORCES = (("alpha_cmd", "pale"), ("alpha_true", "solid"), ("alpha_meas", "dashed"))
_POWERS = (
    ("power_total", "#8A919C", "total"),
    ("power_projected", OKABE_ITO["purple"], "projected by Ω_f"),
)


def panels_of(
    samples: Samples, names: Sequence[str] = (), owners: Sequence[int] = ()
) -> list[Json]:
    """Make the panels of contact forces and of power, with a line for each recorded channel.

    Args:
        samples: recorded channels; a missing one has no line, a panel without lines is omitted.
        names: names of the contact forces.
        owners: index of the contact of each force.

    Returns:
        Panels with title, unit, lines and a note, for JSON.
    """
    forces = [
        {
            "key": key,
            "index": i,
            "look": look,
            "colour": contact_colour(owners[i]) if look != "dashed" else marks.BLACK,
            "name": name.replace("_", " ") if look == "solid" else "",
        }
        for key, look in _FORCES
        if key in samples
        for i, name in enumerate(names[: samples[key].shape[1]])
    ]
    powers = [
        {"key": key, "index": -1, "look": "solid", "colour": colour, "name": name}
        for key, colour, name in _POWERS
        if key in samples
    ]
    # panels in the order of the page; those without recorded channels are left out
    looks = "wide: commanded, solid: true, dashed: measured"
    note = "of the measured wrench, in the motion relative to the faces"
    panels = [
        {"title": "contact force", "unit": "N", "lines": forces, "note": looks},
        {"title": "power", "unit": "W", "lines": powers, "note": note},
    ]
    return [panel for panel in panels if panel["lines"]]


def values(lines: Sequence[Json], channels: Mapping[str, Any]) -> Array:
    """Values of all lines of the panels over time (lines, T), in the units of their channels.

    Args:
        lines: lines, each with the name `key` of its channel and the `index` of its column there;
            −1: the channel has one number at each time.
        channels: channels of a recording by name, (T,) or (T, columns).
    """
    rows = []
    for line in lines:
        channel = channels[line["key"]]
        rows.append(channel if line["index"] < 0 else channel[..., line["index"]])
    return np.array(rows, dtype=float)


def rounded(numbers: Array) -> list[float | None]:
    """Numbers (k,) with four significant digits; None for NaN and infinities, which JSON lacks."""
    return [float(f"{x:.4g}") if np.isfinite(x) else None for x in numbers.tolist()]


BINS = 450  #: stretches of equally many ticks


def thinned(lines: Sequence[Json], channels: Mapping[str, Any]) -> Json:
    """Times and values of all lines: the smallest and largest value of each of `BINS` stretches.

    Short peaks stay visible this way, however long the recording is.

    Args:
        lines: lines of the panels.
        channels: (T, …) of each channel, and the times `t` (T,).
    """
    t = np.asarray(channels["t"], dtype=float)
    rows = list(values(lines, channels))
    if len(t) > 2 * BINS:
        stretches = np.array_split(np.arange(len(t)), BINS)
        t = t[[part[k] for part in stretches for k in (0, -1)]]
        for number, row in enumerate(np.nan_to_num(rows)):
            kept_values = [
                sorted((part[row[part].argmin()], part[row[part].argmax()])) for part in stretches
            ]
            rows[number] = row[np.concatenate(kept_values)]
    return {"t": np.round(t, 4).tolist(), "y": [rounded(row) for row in rows]}
