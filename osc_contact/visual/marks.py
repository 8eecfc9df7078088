"""What a scene marks at contacts: forces and their lines, motions permitted, a frame, trails.

Arrows are 10 mm per newton (100 mm per N m for a couple), their tip at the contact, pointing the
way the object pushes into the environment. The true force lies on its line; the commanded one is a
wide, pale arrow around it; the measured one, thin and black, stands beside it so that it is seen
where the two agree. A contact that is lost turns grey.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin

from osc_contact.spatial import norm
from osc_contact.visual import contact_colour
from osc_contact.visual.parts import Array, Frame, LegendEntry, Part, Sample, State
from osc_contact.visual.screws import (
    Normals,
    contact_normals,
    helix,
    tangents,
    twist_screw,
    wrench_screw,
)
from osc_contact.visual.shapes import along, arrow, arrow_lengths, at, cylinder, plain, tube

if TYPE_CHECKING:
    from meshcat import Visualizer


LOST = "#8E939A"
BLACK = "#15181C"
LINE_LENGTH = 0.7
LINE = (-0.5 * LINE_LENGTH, 0.5 * LINE_LENGTH)

# --- Forces and their lines ---------------------------------------------------------------------

METRES_PER_NEWTON = 0.01
METRES_PER_NEWTON_METRE = 0.1
BESIDE = 0.017
SHOWN_FROM = 1e-3  # N
WRENCH_HELIX = (0.03, 0.24)
"""Radius and length (m) of the path that shows the pitch of a line of force."""
LEAST_PITCH = 0.005


class _Arrow(NamedTuple):
    """How one of the three forces of a contact is drawn."""

    channel: str
    words: str
    look: str
    radius: float
    opacity: float = 1.0


ARROWS = {
    "true": _Arrow("alpha_true", "force, true", "solid", 0.006),
    "commanded": _Arrow("alpha_cmd", "commanded", "pale", 0.012, 0.32),
    "measured": _Arrow("alpha_meas", "measured", "thin", 0.0028),
}


class ContactForce(Part):
    """One column of N: the force (or couple) that one contact transmits.

    Args:
        name: of the node, unique.
        column: which column of N it is.
        contact: which contact it belongs to; gives the colour.
        owners: the contact of every column.
        first: the sample at which the pitch of the line is drawn.
    """

    def __init__(
        self, name: str, column: int, contact: int, owners: Sequence[int], first: Sample
    ) -> None:
        self.path = f"contacts/{name}"
        self.words = name.replace("_", " ")
        self.column = column
        self.contact = contact
        self.owners = owners
        self.colour = contact_colour(contact)
        self.arrows = [kind for kind, how in ARROWS.items() if how.channel in first]
        self.last, pitch = self._place(first, contact_normals(first, owners))
        self.couple = np.isinf(pitch)
        self.pitch = pitch if abs(pitch) > LEAST_PITCH else 0.0

    def draw(self, scene: Visualizer) -> None:
        """Make the nodes."""
        from meshcat.geometry import Cylinder, Sphere

        node = scene[self.path]
        for state, colour, opacity in (("closed", self.colour, 1.0), ("lost", LOST, 0.7)):
            paint = plain(colour, opacity)
            node[f"{state}/point"].set_object(Sphere(0.0065), paint)
            node[f"{state}/patch"].set_object(Cylinder(0.005, 0.024), plain(colour, 0.5))
            cylinder(node[f"{state}/line/rod"], paint, LINE, 0.002)
            if self.pitch:
                path = helix(0.0 if self.couple else self.pitch, *WRENCH_HELIX)
                node[f"{state}/pitch"].set_object(tube(path, 0.002), paint)
        for kind in self.arrows:
            how = ARROWS[kind]
            colour = BLACK if kind == "measured" else self.colour
            arrow(node[kind], colour, how.radius, how.opacity, heads=1 + self.couple)
        if "measured" in self.arrows:
            node["measured"].set_transform(at([BESIDE, 0.0, 0.0]).homogeneous)

    def states(self, sample: Sample) -> Frame:
        """Pose, lengths and visibility at one tick."""
        normals = contact_normals(sample, self.owners)
        known = bool(normals.known[self.column])
        pressed = bool(normals.pressed[self.column])
        if known:
            self.last = self._place(sample, normals)[0]
        frame = {
            self.path: State(self.last),
            f"{self.path}/closed": State(visible=pressed),
            f"{self.path}/lost": State(visible=known and not pressed),
        }
        unit = METRES_PER_NEWTON_METRE if self.couple else METRES_PER_NEWTON
        longest = 0.0
        for kind in self.arrows:
            alpha = float(sample[ARROWS[kind].channel][self.column])
            shaft, shaft_y, head = arrow_lengths(unit * alpha)
            drawn = pressed if kind == "true" else known
            frame[f"{self.path}/{kind}"] = State(visible=drawn and alpha > SHOWN_FROM)
            frame[f"{self.path}/{kind}/shaft"] = State(at([0.0, shaft_y, 0.0]), shaft)
            frame[f"{self.path}/{kind}/head"] = State(scale=head)
            longest = max(longest, np.nan_to_num(unit * alpha, posinf=0.0))
        frame[f"{self.path}/label"] = State(at([0.0, -longest - 0.045, 0.0]))
        return frame

    def ends(self, sample: Sample) -> Array:
        """(k, 3) ends of the longest arrow at one tick; none where the contact is not known."""
        label = self.states(sample)[f"{self.path}/label"].matrix
        known = contact_normals(sample, self.owners).known[self.column]
        if label is None or not known:
            return np.zeros((0, 3))
        return np.array([self.last.translation, self.last * label[:3, 3]])

    def legend(self) -> Iterable[LegendEntry]:
        """The contact's colour; the check boxes are shared by all contacts."""
        return [LegendEntry(self.colour, self.words)]

    def _place(self, sample: Sample, normals: Normals) -> tuple[pin.SE3, float]:
        """Pose whose y-axis is the line of force, near the contact point; the pitch (m)."""
        if not normals.known[self.column]:
            return pin.SE3.Identity(), 0.0
        point: Array = sample["contact_point"][self.contact]
        screw = wrench_screw(normals.N[:, self.column], sample["pose"][:3])
        if not np.isinf(screw.pitch):
            point = screw.point + ((point - screw.point) @ screw.direction) * screw.direction
        return along(point, screw.direction), screw.pitch


def toggles(forces: Sequence[ContactForce]) -> list[LegendEntry]:
    """The check boxes that all contacts share."""
    if not forces:
        return []

    def entry(words: str, look: str, *names: str) -> LegendEntry:
        paths = tuple(f"{force.path}/{name}" for force in forces for name in names)
        return LegendEntry(BLACK, words, look, paths)

    lines = ["closed/line", "lost/line"]
    if any(force.pitch for force in forces):
        lines += ["closed/pitch", "lost/pitch"]
    return [
        *(
            entry(ARROWS[kind].words, ARROWS[kind].look, f"{kind}/shaft", f"{kind}/head")
            for kind in forces[0].arrows
        ),
        entry("N: lines of force (grey: contact lost)", "line", *lines),
    ]


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

    def __init__(self, first: Sample, owners: Sequence[int] = ()) -> None:
        self.owners = owners
        pitches = [pitch for _, pitch in self._screws(first)]
        pitches += [0.0] * (6 - len(pitches))
        self.pitches = [
            pitch if LEAST_TWIST_PITCH < abs(pitch) < np.inf else LEAST_TWIST_PITCH
            for pitch in pitches
        ]

    def draw(self, scene: Visualizer) -> None:
        """Make the nodes of all six axes that T can have."""
        paint = plain(T_COLOUR)
        half = 0.5 * SLIDE_LENGTH
        for i, pitch in enumerate(self.pitches):
            node = scene[f"twists/{i}"]
            path = helix(pitch, *TWIST_HELIX)
            node["turn/path/tube"].set_object(tube(path, 0.0019), paint)
            cylinder(node["turn/axis/rod"], paint, (-0.5 * AXIS_LENGTH, 0.5 * AXIS_LENGTH), 0.0013)
            cylinder(node["turn/end/head"], paint, (-0.002, 0.018), 0.006, top=0.0)
            cylinder(node["slide/axis/rod"], paint, (-half, half), 0.0019)
            cylinder(node["slide/up"], paint, (half - 0.008, half + 0.02), 0.007, top=0.0)
            cylinder(node["slide/down"], paint, (0.008 - half, -half - 0.02), 0.007, top=0.0)

    def states(self, sample: Sample) -> Frame:
        """Where the axes are at one tick; those that T does not have are hidden."""
        screws = self._screws(sample)
        frame: Frame = {}
        for i, reference in enumerate(self.pitches):
            path = f"twists/{i}"
            pose, pitch = screws[i] if i < len(screws) else (pin.SE3.Identity(), 0.0)
            turns = bool(np.isfinite(pitch))
            stretch = _stretch(pitch if turns else 0.0, reference)
            curve = helix(reference, *TWIST_HELIX) * [1.0, stretch, 1.0]
            end = 0.53 * (AXIS_LENGTH if turns else SLIDE_LENGTH + 0.06)
            frame |= {
                path: State(pose, visible=i < len(screws)),
                f"{path}/turn": State(visible=turns),
                f"{path}/slide": State(visible=not turns),
                f"{path}/turn/path": State(scale=(1.0, stretch, 1.0)),
                f"{path}/label": State(at([0.0, end, 0.0])),
                f"{path}/turn/end": State(along(curve[-1], curve[-1] - curve[-2])),
            }
        return frame

    def legend(self) -> Iterable[LegendEntry]:
        """One entry."""
        paths = tuple(f"twists/{i}/{node}" for i in range(6) for node in TWIST_NODES)
        yield LegendEntry(T_COLOUR, "T: a basis of the motions permitted", "turn", paths)

    def _screws(self, sample: Sample) -> list[tuple[pin.SE3, float]]:
        normals = contact_normals(sample, self.owners)
        origin = sample["pose"][:3]
        screws = [twist_screw(t, origin) for t in tangents(normals.N[:, normals.pressed]).T]
        return [(along(screw.point, screw.direction), screw.pitch) for screw in screws]


def _stretch(pitch: float, reference: float) -> float:
    """How much the path drawn at the reference pitch is stretched along the axis."""
    most = TALLEST / np.ptp(helix(reference, *TWIST_HELIX)[:, 1])
    stretch = float(np.clip(pitch / reference, -most, most))
    return stretch if abs(stretch) > 1e-6 else 1e-6


# --- The best single frame ----------------------------------------------------------------------

DASHES = 12


class BestFrame(NamedTuple):
    """A single constraint frame and what it selects.

    Attributes:
        frame: its pose, from O, world axes.
        forces: along which of its axes forces are selected. couples: the same for couples.
    """

    frame: pin.SE3
    forces: Sequence[bool]
    couples: Sequence[bool]


FindFrame = Callable[[Array], BestFrame]
"""From N (6, r) at O to the single frame that comes closest to it."""


class ConstraintFrame(Part):
    """Raibert and Craig's frame that comes closest to N: the lines of force it would select."""

    def __init__(self, find: FindFrame, owners: Sequence[int] = (), words: str = "") -> None:
        self.find = find
        self.owners = owners
        self.words = words
        self.found: tuple[Array, BestFrame] | None = None

    def draw(self, scene: Visualizer) -> None:
        """Make the nodes; axis 0, 1, 2 of the frame lie along the y-axes of three nodes."""
        from meshcat.geometry import Sphere

        paint = plain(BLACK)
        ring = tube(helix(0.0, 0.05, 1.0, 60), 0.002)
        scene["frame/origin"].set_object(Sphere(0.009), paint)
        for axis, direction in enumerate(np.eye(3)):
            node = scene[f"frame/axis{axis}"]
            node.set_transform(along(np.zeros(3), direction).homogeneous)
            cylinder(node["stub/rod"], plain(BLACK, 0.45), (-0.05, 0.05), 0.0035)
            for k in range(DASHES):  # dashes: not a line of force the contact really has
                begin, end = LINE_LENGTH * ((np.array([k + 0.2, k + 0.8])) / DASHES - 0.5)
                cylinder(node[f"force/line/{k}"], paint, (begin, end), 0.002)
            node["couple/ring"].set_object(ring, paint)

    def states(self, sample: Sample) -> Frame:
        """Where the frame is at one tick, and what it selects."""
        normals = contact_normals(sample, self.owners)
        N = normals.N[:, normals.pressed]
        if self.found is None or not np.array_equal(self.found[0], N):
            self.found = N, self.find(N)
        best = self.found[1]
        origin = sample["pose"][:3]
        frame = {"frame": State(at(origin) * best.frame, visible=N.shape[1] > 0)}
        for axis in range(3):
            frame[f"frame/axis{axis}/force"] = State(visible=bool(best.forces[axis]))
            frame[f"frame/axis{axis}/couple"] = State(visible=bool(best.couples[axis]))
        return frame

    def legend(self) -> Iterable[LegendEntry]:
        """One entry."""
        kinds = ("stub", "force/line", "couple/ring")
        paths = tuple(f"frame/axis{axis}/{kind}" for axis in range(3) for kind in kinds)
        yield LegendEntry(BLACK, self.words, "frame", ("frame/origin", *paths), shown=False)


# --- Trails -------------------------------------------------------------------------------------

TRAIL_COLOUR = "#5A6270"
LONGEST = 240
STEP = 5e-4


class Trails:
    """Paths of the object's origin and of the contact points.

    They grow sample by sample; a path longer than 240 points is thinned to every other one.
    """

    def __init__(self, contacts: Sequence[str]) -> None:
        self.colours = {"object": TRAIL_COLOUR}
        self.colours |= {name: contact_colour(i) for i, name in enumerate(contacts)}
        self.points: dict[str, list[Array]] = {name: [] for name in self.colours}
        self.drawn: dict[str, int] = {}

    def extend(self, sample: Sample) -> None:
        """Take one tick in; a step of less than 0.5 mm is left out."""
        points = np.vstack(
            [
                sample.get("pose", [np.nan] * 3)[:3],
                np.reshape(sample.get("contact_point", ()), (-1, 3)),
            ]
        )
        for path, point in zip(self.points.values(), points, strict=False):
            if np.isfinite(point).all() and (not path or norm(point - path[-1]) >= STEP):
                path.append(point)
                if len(path) > LONGEST:
                    path[:-1] = path[:-1:2]

    def draw(self, scene: Visualizer) -> None:
        """(Re)draw what has grown since the last call."""
        for name, path in self.points.items():
            if len(path) > 1 and self.drawn.get(name) != len(path):
                paint = plain(self.colours[name], 0.9)
                scene[f"trails/{name}"].set_object(tube(path, 0.004, sides=5), paint)
                self.drawn[name] = len(path)

    def legend(self) -> list[LegendEntry]:
        """One entry."""
        paths = tuple(f"trails/{name}" for name in self.colours)
        return [LegendEntry(TRAIL_COLOUR, "trails of object and contacts", "trail", paths)]
