"""Contact forces in a scene: where they act, along which line, and how strong they are.

Arrows are 10 mm per newton (100 mm per N m for a couple), their tip at the contact, pointing the
way the object pushes into the environment. The true force lies on its line; the commanded one is a
wide, pale arrow around it; the measured one, thin and black, stands beside it so that it is seen
where the two agree. A contact that is lost turns grey.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from osc_contact.visual import contact_colour
from osc_contact.visual.parts import Frame, LegendEntry, Sample, State
from osc_contact.visual.primitives import (
    along,
    arrow,
    arrow_lengths,
    cone,
    material,
    plain,
    rod,
    tube,
)
from osc_contact.visual.screws import contact_normals, helix, wrench_screw

if TYPE_CHECKING:
    from meshcat import Visualizer

    from osc_contact.visual.screws import Array, Normals

__all__ = ["ContactForce", "METRES_PER_NEWTON"]

METRES_PER_NEWTON = 0.01
METRES_PER_NEWTON_METRE = 0.1
LINE_LENGTH = 0.7
LOST = "#8E939A"
BLACK = "#15181C"
BESIDE = 0.017
HELIX_RADIUS, HELIX_LENGTH, LEAST_PITCH = 0.03, 0.24, 0.005
SHOWN_FROM = 1e-3  # N
ARROWS = {
    "true": ("alpha_true", 0.006, 1.0),
    "commanded": ("alpha_cmd", 0.012, 0.32),
    "measured": ("alpha_meas", 0.0028, 1.0),
}


class ContactForce:
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
        self.name, self.column, self.contact, self.owners = name, column, contact, tuple(owners)
        self.colour = contact_colour(contact)
        self.arrows = [arrow for arrow, (key, *_) in ARROWS.items() if key in first]
        pitch = self._place(first, contact_normals(first, self.owners))[1]
        self.couple, self.pitch = np.isinf(pitch), pitch if abs(pitch) > LEAST_PITCH else 0.0
        self.last = pin.SE3.Identity()

    def draw(self, scene: Visualizer) -> None:
        """Make the nodes."""
        from meshcat.geometry import Cylinder, Sphere

        node = scene[self.path]
        for state, colour in (("closed", self.colour), ("lost", LOST)):
            paint = plain(colour, 1.0 if state == "closed" else 0.7)
            node[f"{state}/point"].set_object(Sphere(0.0065), paint)
            node[f"{state}/patch"].set_object(Cylinder(0.005, 0.024), plain(colour, 0.5))
            rod(node[f"{state}/line"], paint, LINE_LENGTH)
            if self.couple or self.pitch:
                path = helix(0.0 if self.couple else self.pitch, HELIX_RADIUS, HELIX_LENGTH)
                node[f"{state}/pitch"].set_object(tube(path, 0.002), paint)
        for name in self.arrows:
            _, radius, opacity = ARROWS[name]
            arrow(node[name], BLACK if name == "measured" else self.colour, radius, opacity)
            if self.couple:  # a second head makes it a couple
                paint = material(self.colour, opacity, glow=0.12)
                cone(node[name]["head/second"], paint, -0.025, 0.035, 2.4 * radius)
        if "measured" in self.arrows:
            node["measured"].set_transform(along([BESIDE, 0.0, 0.0], [0.0, 1.0, 0.0]).homogeneous)

    def states(self, sample: Sample) -> Frame:
        """Pose, lengths and visibility at one tick."""
        normals = contact_normals(sample, self.owners)
        known, pressed = (bool(flags[self.column]) for flags in (normals.known, normals.pressed))
        if known:
            self.last = self._place(sample, normals)[0]
        frame = {
            self.path: State(self.last),
            f"{self.path}/closed": State(visible=pressed),
            f"{self.path}/lost": State(visible=known and not pressed),
        }
        longest = 0.0
        unit = METRES_PER_NEWTON_METRE if self.couple else METRES_PER_NEWTON
        for name in self.arrows:
            alpha = float(np.asarray(sample[ARROWS[name][0]], dtype=float)[self.column])
            shaft, shaft_y, head = arrow_lengths(unit * alpha)
            below = pin.SE3(np.eye(3), np.array([0.0, shaft_y, 0.0]))
            wanted = pressed if name == "true" else known
            frame[f"{self.path}/{name}"] = State(visible=wanted and alpha > SHOWN_FROM)
            frame[f"{self.path}/{name}/shaft"] = State(below, shaft)
            frame[f"{self.path}/{name}/head"] = State(scale=head)
            longest = max(longest, unit * alpha if np.isfinite(alpha) else 0.0)
        tail = pin.SE3(np.eye(3), np.array([0.0, -longest - 0.045, 0.0]))
        frame[f"{self.path}/label"] = State(tail)
        return frame

    def ends(self, sample: Sample) -> Array:
        """(k, 3) ends of the longest arrow at one tick; none where the contact is not known."""
        frame = self.states(sample)
        pose: Any = frame[self.path].pose
        tail: Any = frame[f"{self.path}/label"].pose
        known = contact_normals(sample, self.owners).known[self.column]
        return np.array([pose.translation, pose * tail.translation])[: 2 * int(known)]

    def legend(self) -> Iterable[LegendEntry]:
        """The contact's colour; the check boxes are shared by all contacts."""
        return [LegendEntry(self.colour, self.name.replace("_", " "))]

    def _place(self, sample: Sample, normals: Normals) -> tuple[pin.SE3, float]:
        """Pose whose y-axis is the line of force, near the contact point; the pitch (m)."""
        column = normals.N[:, self.column]
        if not normals.known[self.column]:
            return pin.SE3.Identity(), 0.0
        point: Array = np.asarray(sample["contact_point"], dtype=float)[self.contact]
        screw = wrench_screw(column, np.asarray(sample["pose"], dtype=float)[:3])
        if np.isinf(screw.pitch):
            return along(point, screw.direction), screw.pitch
        foot = screw.point + ((point - screw.point) @ screw.direction) * screw.direction
        return along(foot, screw.direction), screw.pitch


def toggles(forces: Sequence[ContactForce]) -> list[LegendEntry]:
    """The check boxes that all contacts share."""
    if not forces:
        return []

    def paths(*names: str) -> tuple[str, ...]:
        return tuple(f"{force.path}/{name}" for force in forces for name in names)

    words = {"true": "force, true", "commanded": "commanded", "measured": "measured"}
    looks = {"true": "solid", "commanded": "pale", "measured": "thin"}
    entries = [
        LegendEntry(BLACK, words[name], looks[name], paths(f"{name}/shaft", f"{name}/head"))
        for name in ARROWS
        if name in forces[0].arrows
    ]
    lines = paths("closed/line", "lost/line")
    if any(force.couple or force.pitch for force in forces):
        lines += paths("closed/pitch", "lost/pitch")
    entries.append(LegendEntry(BLACK, "N: lines of force (grey: contact lost)", "line", lines))
    return entries
