"""Marks of a scene at contacts: forces and their lines, permitted motions, trails.

The length of an arrow is 10 mm per newton (100 mm per N m of a couple); its tip is at the contact,
and its direction is that in which the object pushes into the environment. The true force is on its
line; the commanded one is a wide, pale arrow around it; the measured one is thin and black and
displaced, so that it is visible even if it equals the true force. A lost contact is grey; a known
one that is not active is faint and has no label.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from osc_contact.lab.visual import contact_colour
from osc_contact.lab.visual.parts import Frames, LegendEntry, Part, Samples, States, held
from osc_contact.lab.visual.screws import helix, tangents, twist_screw, wrench_screw
from osc_contact.lab.visual.shapes import along, at, cylinder, material, plain, tube
from osc_contact.spatial import Array, norm

if TYPE_CHECKING:
    from meshcat import Visualizer


LOST = "#8E939A"
FAINT = 0.22  #: opacity of contacts that are not active
BLACK = "#15181C"
LINE_LENGTH = 0.7
LINE = (-0.5 * LINE_LENGTH, 0.5 * LINE_LENGTH)

# --- Forces and their lines ---------------------------------------------------------------------

METRES_PER_NEWTON = 0.01
METRES_PER_NEWTON_METRE = 0.1
BESIDE = 0.017
HEAD_LENGTH = 0.035
"""Length of an arrow's head in m; shorter arrows are all head, shrunk."""
SHORTEST = 1e-6
SHOWN_FROM = 1e-3  # N
WRENCH_HELIX = (0.03, 0.24)
"""Radius and length (m) of the path that shows the pitch of a line of force."""
LEAST_PITCH = 0.005


class _Arrow(NamedTuple):
    """Look of the arrow of one of the three forces of a contact.

    Attributes:
        name: name of its node.
        channel: channel of the force.
        words: text in the legend.
        look: sample in the legend.
        radius: radius of the shaft (m).
        opacity: 0 … 1.
    """

    name: str
    channel: str
    words: str
    look: str
    radius: float
    opacity: float = 1.0


ARROWS = (
    _Arrow("true", "alpha_true", "force, true", "solid", 0.006),
    _Arrow("commanded", "alpha_cmd", "commanded", "pale", 0.012, 0.32),
    _Arrow("measured", "alpha_meas", "measured", "thin", 0.0028),
)


def arrow_states(path: str, lengths: Array) -> Frames:
    """States of an arrow with its tip at its origin, along the y-axis.

    The head keeps its size; an arrow shorter than its head is a smaller head without shaft.

    Args:
        path: path of its node.
        lengths: (F,) m.
    """
    lengths = np.maximum(np.where(np.isfinite(lengths), lengths, 0.0), SHORTEST)
    head = np.minimum(1.0, lengths / HEAD_LENGTH)
    shaft = np.maximum(lengths - HEAD_LENGTH, SHORTEST)
    return {
        f"{path}/shaft": States(on_y_axis(-HEAD_LENGTH * head), np.array([head, shaft, head]).T),
        f"{path}/head": States(scale=np.array([head, head, head]).T),
    }


def on_y_axis(y: Array) -> Array:
    """Poses (F, 7) without rotation at points y (F,) of the y-axis (m)."""
    poses = np.zeros((len(y), 7))
    poses[:, 1] = y
    poses[:, 6] = 1.0
    return poses


def poses_along(points: Array, directions: Array) -> Array:
    """Poses (F, 7) with origins at points (F, 3) (m) and y-axes along directions (F, 3)."""
    poses = map(along, points, directions)
    return np.reshape([pin.SE3ToXYZQUAT(pose) for pose in poses], (-1, 7))


class ContactForce(Part):
    """Marks of a column of N, a force or couple that a contact transmits."""

    def __init__(self, name: str, column: int, contact: int, first: Samples) -> None:
        """Prepare the marks.

        Args:
            name: name of the node, unique.
            column: index of the column of N.
            contact: index of its contact, which determines the colour.
            first: a tick, which determines the pitch of the line.
        """
        self.path = f"contacts/{name}"
        self.words = name.replace("_", " ")
        self.column = column
        self.contact = contact
        self.colour = contact_colour(contact)
        self.arrows = [arrow for arrow in ARROWS if arrow.channel in first]
        self.last = pin.SE3ToXYZQUAT(pin.SE3.Identity())
        _, pitches = self._place(first)
        pitch = float(pitches[0]) if len(pitches) else 0.0
        self.couple = np.isinf(pitch)
        self.pitch = pitch if abs(pitch) > LEAST_PITCH else 0.0

    def draw(self, scene: Visualizer) -> None:
        """Make the nodes of the mark below its path: line of force, point, patch, arrows.

        Args:
            scene: root of the drawn scene.
        """
        from meshcat.geometry import Cylinder, Sphere

        node = scene[self.path]
        # one copy for each state of the contact, of which a tick shows one
        looks = (("closed", self.colour, 1.0), ("lost", LOST, 0.7), ("known", self.colour, FAINT))
        for state, colour, opacity in looks:
            paint = plain(colour, opacity)
            node[f"{state}/point"].set_object(Sphere(0.0065), paint)
            patch = plain(colour, min(opacity, 0.5))
            node[f"{state}/patch"].set_object(Cylinder(0.005, 0.024), patch)
            cylinder(node[f"{state}/line/rod"], paint, LINE, 0.002)
            if self.pitch:
                path = helix(0.0 if self.couple else self.pitch, *WRENCH_HELIX)
                node[f"{state}/line/pitch"].set_object(tube(path, 0.002), paint)
        for arrow in self.arrows:
            # the measured force is black and beside the true one; a couple has a second head
            is_measured = arrow.name == "measured"
            part = node[arrow.name]
            part.set_transform(at([BESIDE if is_measured else 0.0, 0.0, 0.0]).homogeneous)
            paint = material(BLACK if is_measured else self.colour, arrow.opacity, glow=0.12)
            cylinder(part["shaft/rod"], paint, (-1.0, 0.0), arrow.radius)
            cones = [("cone", 0.0)]
            if self.couple:
                cones.append(("second", -0.025))
            for name, tip in cones:
                ends = (tip - HEAD_LENGTH, tip)
                cylinder(part[f"head/{name}"], paint, ends, 2.4 * arrow.radius, top=0.0)

    def states(self, samples: Samples) -> Frames:
        """Poses, lengths (m) and visibility of the marks at F ticks.

        Args:
            samples: recorded channels at these ticks: contact points, N, forces, object poses.

        Returns:
            States of each node by its path in the scene.
        """
        poses, _ = self._place(samples)
        known, is_pressed, active = (flags[:, self.column] for flags in samples["normals"][1:])
        frames = {
            self.path: States(poses),
            f"{self.path}/closed": States(visible=is_pressed & active),
            f"{self.path}/lost": States(visible=known & active & ~is_pressed),
            f"{self.path}/known": States(visible=known & ~active),
        }
        unit = METRES_PER_NEWTON_METRE if self.couple else METRES_PER_NEWTON
        longest = np.zeros(len(poses))
        for arrow in self.arrows:
            alpha = samples[arrow.channel][:, self.column]
            is_drawn = is_pressed if arrow.name == "true" else known & active
            path = f"{self.path}/{arrow.name}"
            frames[path] = States(visible=is_drawn & (alpha > SHOWN_FROM))
            frames |= arrow_states(path, unit * alpha)
            longest = np.maximum(longest, np.nan_to_num(unit * alpha, posinf=0.0))
        frames[f"{self.path}/label"] = States(on_y_axis(-longest - 0.045), visible=active)
        return frames

    def corners(self, samples: Samples) -> Array:
        """Positions (k, 3) (m, world) of arrow tips and labels, which a camera has to show.

        Args:
            samples: recorded channels at F ticks; those without a known contact are skipped.
        """
        frames = self.states(samples)
        tips = frames[self.path].poses
        labels = frames[f"{self.path}/label"].poses
        assert tips is not None and labels is not None
        is_known = samples["normals"].known[:, self.column]
        ends = []
        for tip, label in zip(tips[is_known], labels[is_known], strict=True):
            X = pin.XYZQUATToSE3(tip)
            ends += [X.translation, X * label[:3]]
        return np.reshape(ends, (-1, 3))

    def _place(self, samples: Samples) -> tuple[Array, Array]:
        """Place the mark with its y-axis on the line of force, near the contact point.

        Args:
            samples: recorded channels at F ticks.

        Returns:
            Poses (F, 7), the last known one at ticks without a known contact; and pitches (m) of
            the ticks with a known contact, inf for a couple.
        """
        N, known, *_ = samples["normals"]
        is_known = known[:, self.column]
        points = samples["contact_point"][is_known, self.contact]
        foot, directions, pitches = wrench_screw(
            N[is_known, :, self.column], samples["pose"][is_known, :3]
        )
        on_line = foot + np.vecdot(points - foot, directions)[:, None] * directions
        points = np.where(np.isinf(pitches)[:, None], points, on_line)
        poses = held(is_known, poses_along(points, directions), self.last)
        self.last = poses[-1]
        return (poses, pitches)


def legend(forces: Sequence[ContactForce]) -> list[LegendEntry]:
    """Make the legend: the colour of each contact, and the check boxes that all contacts share.

    Args:
        forces: marks of all contact forces.
    """
    if not forces:
        return []
    rows: list[tuple[str, ...]] = [
        (arrow.words, arrow.look, f"{arrow.name}/shaft", f"{arrow.name}/head")
        for arrow in forces[0].arrows
    ]
    words = "N: lines of force (grey: contact lost, faint: not active)"
    rows.append((words, "line", *(f"{state}/line" for state in ("closed", "lost", "known"))))
    entries = [LegendEntry(force.colour, force.words) for force in forces]
    for words, look, *names in rows:
        paths = tuple(f"{force.path}/{name}" for force in forces for name in names)
        entries.append(LegendEntry(BLACK, words, look, paths))
    return entries


# --- Motions permitted --------------------------------------------------------------------------

T_COLOUR = "#7A3E9D"
AXIS_LENGTH = 0.44
SLIDE_LENGTH = 0.26
TWIST_HELIX = (0.035, 0.19)
"""Radius and length (m) of the path of a point beside a twist axis."""
LEAST_TWIST_PITCH = 0.02
TALLEST = 0.5
TWIST_NODES = (
    "label",
    "turn/axis",
    "turn/path/tube",
    "turn/end/head",
    "slide/axis",
    "slide/up",
    "slide/down",
)


class TwistAxes(Part):
    """A basis of T: turns about axes, drawn with the path of a point beside them, and slides.

    The path around an axis is a circle's arc for a pure turn and the steeper the further one turn
    advances; the height of a path is drawn up to 0.5 m.
    """

    def __init__(self, first: Samples) -> None:
        """Prepare the axes; the pitches of the drawn paths are those of the first tick."""
        _, (pitches,), _ = _screws(first)
        steep = (np.abs(pitches) > LEAST_TWIST_PITCH) & np.isfinite(pitches)
        self.pitches = np.where(steep, pitches, LEAST_TWIST_PITCH).tolist()

    def draw(self, scene: Visualizer) -> None:
        """Make the nodes of all six axes that T can have.

        Args:
            scene: root of the drawn scene.
        """
        paint = plain(T_COLOUR)
        half = 0.5 * SLIDE_LENGTH
        for i, pitch in enumerate(self.pitches):
            node = scene[f"twists/{i}"]
            node["turn/path/tube"].set_object(tube(helix(pitch, *TWIST_HELIX), 0.0019), paint)
            cylinder(node["turn/axis/rod"], paint, (-0.5 * AXIS_LENGTH, 0.5 * AXIS_LENGTH), 0.0013)
            cylinder(node["turn/end/head"], paint, (-0.002, 0.018), 0.006, top=0.0)
            cylinder(node["slide/axis/rod"], paint, (-half, half), 0.0019)
            cylinder(node["slide/up"], paint, (half - 0.008, half + 0.02), 0.007, top=0.0)
            cylinder(node["slide/down"], paint, (-half - 0.02, 0.008 - half), 0.0, top=0.007)

    def states(self, samples: Samples) -> Frames:
        """Poses and pitches of the six axes at F ticks; those beyond the dimension of T are hidden.

        Args:
            samples: recorded channels at these ticks.

        Returns:
            States of each node by its path in the scene.
        """
        poses, pitches, exists = _screws(samples)
        frames: Frames = {}
        for i, reference in enumerate(self.pitches):
            path = f"twists/{i}"
            turns = np.isfinite(pitches[:, i])
            curve = helix(reference, *TWIST_HELIX)
            largest = TALLEST / np.ptp(curve[:, 1])
            stretch = np.clip(np.where(turns, pitches[:, i], 0.0) / reference, -largest, largest)
            stretch[np.abs(stretch) < 1e-6] = 1e-6
            scale = np.insert(np.ones((len(stretch), 2)), 1, stretch, axis=1)
            end = 0.53 * np.where(turns, AXIS_LENGTH, SLIDE_LENGTH + 0.06)
            frames |= {
                path: States(poses[:, i], visible=exists[:, i]),
                f"{path}/turn": States(visible=turns),
                f"{path}/slide": States(visible=~turns),
                f"{path}/turn/path": States(scale=scale),
                f"{path}/label": States(on_y_axis(end)),
                f"{path}/turn/end": States(
                    poses_along(scale * curve[-1], scale * (curve[-1] - curve[-2]))
                ),
            }
        return frames

    def legend(self) -> LegendEntry:
        """Its line of the legend."""
        paths = tuple(f"twists/{i}/{node}" for i in range(6) for node in TWIST_NODES)
        return LegendEntry(T_COLOUR, "T: a basis of the motions permitted", "turn", paths)


def _screws(samples: Samples) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Axes and pitches of a basis of the motions that closed contacts permit.

    Args:
        samples: recorded channels at F ticks.

    Returns:
        Poses (F, 6, 7) whose y-axes are the axes; pitches (F, 6) (m/rad); flags (F, 6) of the
        axes that exist. The pitch of the others is zero.
    """
    N, _, is_closed, active = samples["normals"]
    pressed = is_closed & active
    bases = [tangents(columns[:, held_by]).T for columns, held_by in zip(N, pressed, strict=True)]
    counts = np.array([len(basis) for basis in bases])
    exists = np.arange(6) < counts[:, None]
    origins = np.repeat(samples["pose"][:, :3], counts, axis=0)
    point, direction, pitch = twist_screw(np.vstack(bases), origins)
    poses = np.zeros((*exists.shape, 7))
    poses[..., 6] = 1.0
    poses[exists] = poses_along(point, direction)
    pitches = np.zeros(exists.shape)
    pitches[exists] = pitch
    return (poses, pitches, exists)


# --- Trails -------------------------------------------------------------------------------------

TRAIL_COLOUR = "#5A6270"
LONGEST = 240
STEP = 5e-4


class Trails:
    """Paths of the object's origin and of the contact points.

    They grow tick by tick; a path longer than 240 points is thinned to every other one.
    """

    def __init__(self, contacts: Sequence[str]) -> None:
        """Begin with empty paths, one for the object and one for each contact (by name)."""
        self.colours = {"object": TRAIL_COLOUR}
        self.colours |= {name: contact_colour(i) for i, name in enumerate(contacts)}
        self.points: dict[str, list[Array]] = {name: [] for name in self.colours}
        self.drawn: dict[str, int] = {}

    def extend(self, samples: Samples) -> None:
        """Append the positions of some ticks; a step of less than 0.5 mm is omitted.

        Args:
            samples: recorded channels at these ticks.
        """
        contacts = np.moveaxis(samples.get("contact_point", np.zeros((0, 0, 3))), 1, 0)
        objects = [samples["pose"][:, :3]] if "pose" in samples else [np.zeros((0, 3))]
        for path, points in zip(self.points.values(), [*objects, *contacts], strict=False):
            for point in points[np.isfinite(points).all(axis=1)]:
                if not path or norm(point - path[-1]) >= STEP:
                    path.append(point)
                    if len(path) > LONGEST:
                        path[:-1] = path[:-1:2]

    def draw(self, scene: Visualizer) -> None:
        """Draw the paths that have grown since the last call."""
        for name, path in self.points.items():
            if len(path) > 1 and self.drawn.get(name) != len(path):
                paint = plain(self.colours[name], 0.9)
                scene[f"trails/{name}"].set_object(tube(path, 0.004, sides=5), paint)
                self.drawn[name] = len(path)

    def legend(self) -> LegendEntry:
        """Its line of the legend."""
        paths = tuple(f"trails/{name}" for name in self.colours)
        return LegendEntry(TRAIL_COLOUR, "trails of object and contacts", "trail", paths)
