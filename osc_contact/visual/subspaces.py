"""The contact state's subspaces in a scene: T as twist axes, and the best single frame for N."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from osc_contact.visual.parts import Frame, LegendEntry, Sample, State
from osc_contact.visual.primitives import along, cone, plain, rod, tube
from osc_contact.visual.screws import contact_normals, helix, tangents, twist_screw

if TYPE_CHECKING:
    from meshcat import Visualizer

__all__ = ["BestFrame", "ConstraintFrame", "FindFrame", "T_COLOUR", "TwistAxes"]

Array = NDArray[np.float64]
T_COLOUR = "#7A3E9D"
FRAME_COLOUR = "#15181C"
AXIS_LENGTH, SLIDE_LENGTH, STUB_LENGTH, LINE_LENGTH = 0.44, 0.26, 0.1, 0.7
HELIX_RADIUS, HELIX_LENGTH, LEAST_PITCH, TALLEST = 0.035, 0.19, 0.02, 0.5


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


class TwistAxes:
    """A basis of T: turns about axes, drawn with the path of a point beside them, and slides.

    The path around an axis is a circle's arc for a pure turn and the steeper the further one turn
    advances; the height of a path is drawn up to 0.5 m.
    """

    def __init__(self, first: Sample, owners: Sequence[int] = ()) -> None:
        self.owners = owners
        self.pitches = [LEAST_PITCH] * 6
        for i, (_, pitch) in enumerate(self._screws(first)):
            if np.isfinite(pitch) and abs(pitch) > LEAST_PITCH:
                self.pitches[i] = pitch

    def draw(self, scene: Visualizer) -> None:
        """Make the nodes of all six axes that T can have."""
        paint = plain(T_COLOUR)
        for i, pitch in enumerate(self.pitches):
            node = scene[f"twists/{i}"]
            rod(node["turn/axis"], paint, AXIS_LENGTH, 0.0013)
            path = helix(pitch, HELIX_RADIUS, HELIX_LENGTH)
            node["turn/path/tube"].set_object(tube(path, 0.0019), paint)
            cone(node["turn/end/head"], paint, 0.018, 0.02, 0.006)
            rod(node["slide/axis"], paint, SLIDE_LENGTH, 0.0019)
            cone(node["slide/up"], paint, 0.5 * SLIDE_LENGTH + 0.02, 0.028, 0.007)
            cone(node["slide/down"], paint, -0.5 * SLIDE_LENGTH - 0.02, 0.028, 0.007)

    def states(self, sample: Sample) -> Frame:
        """Where the axes are at one tick; those that T does not have are hidden."""
        screws, frame = self._screws(sample), {}
        for i, reference in enumerate(self.pitches):
            path = f"twists/{i}"
            pose, pitch = screws[i] if i < len(screws) else (pin.SE3.Identity(), 0.0)
            turns = bool(np.isfinite(pitch))
            stretch = _stretch(pitch if turns else 0.0, reference)
            curve = helix(reference, HELIX_RADIUS, HELIX_LENGTH) * [1.0, stretch, 1.0]
            frame[path] = State(pose, visible=i < len(screws))
            frame[f"{path}/turn"] = State(visible=turns)
            frame[f"{path}/slide"] = State(visible=not turns)
            frame[f"{path}/turn/path"] = State(scale=(1.0, stretch, 1.0))
            end = 0.53 * (AXIS_LENGTH if turns else SLIDE_LENGTH + 0.06)
            frame[f"{path}/label"] = State(pin.SE3(np.eye(3), np.array([0.0, end, 0.0])))
            frame[f"{path}/turn/end"] = State(along(curve[-1], curve[-1] - curve[-2]))
        return frame

    def legend(self) -> Iterable[LegendEntry]:
        """One entry."""
        paths = tuple(f"twists/{i}/{kind}" for i in range(6) for kind in _KINDS)
        yield LegendEntry(T_COLOUR, "T: a basis of the motions permitted", "turn", paths)

    def _screws(self, sample: Sample) -> list[tuple[pin.SE3, float]]:
        normals = contact_normals(sample, self.owners)
        origin = np.asarray(sample["pose"], dtype=float)[:3]
        screws = [twist_screw(t, origin) for t in tangents(normals.N[:, normals.pressed]).T]
        return [(along(screw.point, screw.direction), screw.pitch) for screw in screws]


_KINDS = (
    "label",
    "turn/axis",
    "turn/path/tube",
    "turn/end/head",
    "slide/axis",
    "slide/up",
    "slide/down",
)


class ConstraintFrame:
    """Raibert and Craig's frame that comes closest to N: the lines of force it would select."""

    def __init__(self, find: FindFrame, owners: Sequence[int] = (), words: str = "") -> None:
        self.find, self.owners, self.words = find, owners, words
        self.seen: tuple[Array, BestFrame] | None = None

    def draw(self, scene: Visualizer) -> None:
        """Make the nodes; axis 0, 1, 2 of the frame lie along the y-axes of three nodes."""
        from meshcat.geometry import Sphere

        paint = plain(FRAME_COLOUR)
        circle = helix(0.0, 0.05, 1.0, 60)
        scene["frame/origin"].set_object(Sphere(0.009), paint)
        for axis in range(3):
            node = scene[f"frame/axis{axis}"]
            node.set_transform(along(np.zeros(3), np.eye(3)[axis]).homogeneous)
            rod(node["stub"], plain(FRAME_COLOUR, 0.45), STUB_LENGTH, 0.0035)
            for k in range(12):  # dashes: not a line of force the contact really has
                dash = node[f"force/line/{k}"]
                rod(dash, paint, 0.6 * LINE_LENGTH / 12, 0.002)
                y = LINE_LENGTH * ((k + 0.5) / 12 - 0.5)
                dash.set_transform(along([0.0, y, 0.0], [0.0, 1.0, 0.0]).homogeneous)
            node["couple/ring"].set_object(tube(circle, 0.002), paint)

    def states(self, sample: Sample) -> Frame:
        """Where the frame is at one tick, and what it selects."""
        normals = contact_normals(sample, self.owners)
        N = normals.N[:, normals.pressed]
        if self.seen is None or not np.array_equal(self.seen[0], N):
            self.seen = N, self.find(N)
        best = self.seen[1]
        origin = np.asarray(sample["pose"], dtype=float)[:3]
        pose = pin.SE3(best.frame.rotation, best.frame.translation + origin)
        frame = {"frame": State(pose, visible=N.shape[1] > 0)}
        for axis in range(3):
            frame[f"frame/axis{axis}/force"] = State(visible=bool(best.forces[axis]))
            frame[f"frame/axis{axis}/couple"] = State(visible=bool(best.couples[axis]))
        return frame

    def legend(self) -> Iterable[LegendEntry]:
        """One entry."""
        kinds = ("stub", "force/line", "couple/ring")
        paths = tuple(f"frame/axis{axis}/{kind}" for axis in range(3) for kind in kinds)
        yield LegendEntry(FRAME_COLOUR, self.words, "frame", ("frame/origin", *paths), shown=False)


def _stretch(pitch: float, reference: float) -> float:
    """How much the path drawn at the reference pitch is stretched along the axis."""
    height = np.ptp(helix(reference, HELIX_RADIUS, HELIX_LENGTH)[:, 1])
    stretch = float(np.clip(pitch / reference, -TALLEST / height, TALLEST / height))
    return stretch if abs(stretch) > 1e-6 else 1e-6
