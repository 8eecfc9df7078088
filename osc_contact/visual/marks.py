"""What a scene marks at contacts: forces and their lines, motions permitted, trails.

Arrows are 10 mm per newton (100 mm per N m for a couple), their tip at the contact, pointing the
way the object pushes into the environment. The true force lies on its line; the commanded one is a
wide, pale arrow around it; the measured one, thin and black, stands beside it so that it is seen
where the two agree. A contact that is lost turns grey.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin

from osc_contact.spatial import Array, norm
from osc_contact.visual import contact_colour
from osc_contact.visual.parts import Frame, LegendEntry, Part, Sample, State
from osc_contact.visual.screws import helix, tangents, twist_screw, wrench_screw
from osc_contact.visual.shapes import along, at, cylinder, material, on_y, plain, tube

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
HEAD_LENGTH = 0.035
"""Length of an arrow's head in m; shorter arrows are all head, shrunk."""
SHORTEST = 1e-6
SHOWN_FROM = 1e-3  # N
WRENCH_HELIX = (0.03, 0.24)
"""Radius and length (m) of the path that shows the pitch of a line of force."""
LEAST_PITCH = 0.005


class _Arrow(NamedTuple):
    """How one of the three forces of a contact is drawn."""

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


def arrow_states(path: str, length: float) -> Frame:
    """States that make an arrow `length` m long, with its tip at its origin, along the y-axis.

    The head keeps its size; an arrow shorter than its head is a smaller head without shaft.
    """
    length = max(length, SHORTEST) if np.isfinite(length) else SHORTEST
    head = min(1.0, length / HEAD_LENGTH)
    shaft = max(length - HEAD_LENGTH, SHORTEST)
    return {
        f"{path}/shaft": State(on_y(-HEAD_LENGTH * head), (head, shaft, head)),
        f"{path}/head": State(scale=(head, head, head)),
    }


class ContactForce(Part):
    """One column of N: the force (or couple) that one contact transmits.

    Args:
        name: of the node, unique.
        column: which column of N it is.
        contact: which contact it belongs to; gives the colour.
        first: the sample at which the pitch of the line is drawn.
    """

    def __init__(self, name: str, column: int, contact: int, first: Sample) -> None:
        self.path = f"contacts/{name}"
        self.words = name.replace("_", " ")
        self.column = column
        self.contact = contact
        self.colour = contact_colour(contact)
        self.arrows = [arrow for arrow in ARROWS if arrow.channel in first]
        self.last = pin.SE3.Identity()
        pitch = self._place(first)
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
                node[f"{state}/line/pitch"].set_object(tube(path, 0.002), paint)
        for arrow in self.arrows:
            measured = arrow.name == "measured"
            part = node[arrow.name]
            part.set_transform(at([BESIDE * measured, 0.0, 0.0]).homogeneous)
            paint = material(BLACK if measured else self.colour, arrow.opacity, glow=0.12)
            cylinder(part["shaft/rod"], paint, (-1.0, 0.0), arrow.radius)
            for name, tip in (("cone", 0.0), ("second", -0.025))[: 1 + self.couple]:
                ends = tip - HEAD_LENGTH, tip
                cylinder(part[f"head/{name}"], paint, ends, 2.4 * arrow.radius, top=0.0)

    def states(self, sample: Sample) -> Frame:
        """Pose, lengths and visibility at one tick."""
        self._place(sample)
        known, pressed = (bool(flags[self.column]) for flags in sample["normals"][1:])
        frame = {
            self.path: State(self.last),
            f"{self.path}/closed": State(visible=pressed),
            f"{self.path}/lost": State(visible=known and not pressed),
        }
        unit = METRES_PER_NEWTON_METRE if self.couple else METRES_PER_NEWTON
        lengths = [0.0]
        for arrow in self.arrows:
            alpha = float(sample[arrow.channel][self.column])
            drawn = pressed if arrow.name == "true" else known
            path = f"{self.path}/{arrow.name}"
            frame[path] = State(visible=drawn and alpha > SHOWN_FROM)
            frame |= arrow_states(path, unit * alpha)
            lengths.append(np.nan_to_num(unit * alpha, posinf=0.0))
        frame[f"{self.path}/label"] = State(on_y(-max(lengths) - 0.045))
        return frame

    def corners(self, sample: Sample) -> Array:
        """(k, 3) tip and label at one tick; none where the contact is not known."""
        label = self.states(sample)[f"{self.path}/label"].pose
        known = sample["normals"].known[self.column]
        ends = [X.translation for X in (self.last, self.last * label) if known]
        return np.reshape(ends, (-1, 3))

    def _place(self, sample: Sample) -> float:
        """Put the y-axis on the line of force, near the contact point, if known; the pitch (m)."""
        N, known, _ = sample["normals"]
        if not known[self.column]:
            return 0.0
        point = sample["contact_point"][self.contact]
        foot, direction, pitch = wrench_screw(N[:, self.column], sample["pose"][:3])
        if not np.isinf(pitch):
            point = foot + ((point - foot) @ direction) * direction
        self.last = along(point, direction)
        return pitch


def legend(forces: Sequence[ContactForce]) -> list[LegendEntry]:
    """Colours of the contacts, and the check boxes that all contacts share."""
    if not forces:
        return []
    rows = [
        (one.words, one.look, f"{one.name}/shaft", f"{one.name}/head") for one in forces[0].arrows
    ]
    rows.append(("N: lines of force (grey: contact lost)", "line", "closed/line", "lost/line"))
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

    def __init__(self, first: Sample) -> None:
        self.pitches = [LEAST_TWIST_PITCH] * 6
        for i, (_, pitch) in enumerate(_screws(first)):
            if LEAST_TWIST_PITCH < abs(pitch) < np.inf:
                self.pitches[i] = pitch

    def draw(self, scene: Visualizer) -> None:
        """Make the nodes of all six axes that T can have."""
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

    def states(self, sample: Sample) -> Frame:
        """Where the axes are at one tick; those that T does not have are hidden."""
        screws = _screws(sample)
        frame: Frame = {}
        for i, reference in enumerate(self.pitches):
            path = f"twists/{i}"
            pose, pitch = screws[i] if i < len(screws) else (pin.SE3.Identity(), 0.0)
            turns = bool(np.isfinite(pitch))
            curve = helix(reference, *TWIST_HELIX)
            most = TALLEST / np.ptp(curve[:, 1])
            stretch = float(np.clip(pitch / reference, -most, most)) if turns else 0.0
            if abs(stretch) < 1e-6:
                stretch = 1e-6
            curve *= [1.0, stretch, 1.0]
            end = 0.53 * (AXIS_LENGTH if turns else SLIDE_LENGTH + 0.06)
            frame |= {
                path: State(pose, visible=i < len(screws)),
                f"{path}/turn": State(visible=turns),
                f"{path}/slide": State(visible=not turns),
                f"{path}/turn/path": State(scale=(1.0, stretch, 1.0)),
                f"{path}/label": State(on_y(end)),
                f"{path}/turn/end": State(along(curve[-1], curve[-1] - curve[-2])),
            }
        return frame

    def legend(self) -> LegendEntry:
        """Its line of the legend."""
        paths = tuple(f"twists/{i}/{node}" for i in range(6) for node in TWIST_NODES)
        return LegendEntry(T_COLOUR, "T: a basis of the motions permitted", "turn", paths)


def _screws(sample: Sample) -> list[tuple[pin.SE3, float]]:
    """Pose, whose y-axis is the axis, and pitch of each motion that the closed contacts permit."""
    N, _, pressed = sample["normals"]
    screws = [twist_screw(t, sample["pose"][:3]) for t in tangents(N[:, pressed]).T]
    return [(along(screw.point, screw.direction), screw.pitch) for screw in screws]


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
        contacts = np.reshape(sample.get("contact_point", ()), (-1, 3))
        points = np.vstack((sample.get("pose", [np.nan] * 3)[:3], contacts))
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

    def legend(self) -> LegendEntry:
        """Its line of the legend."""
        paths = tuple(f"trails/{name}" for name in self.colours)
        return LegendEntry(TRAIL_COLOUR, "trails of object and contacts", "trail", paths)
