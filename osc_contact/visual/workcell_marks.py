"""What a picture of a workcell points at: an overhead camera, sensor rings, labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from osc_contact.spatial import Array
from osc_contact.visual.primitives import along, material, plain, tube

if TYPE_CHECKING:
    from meshcat import Visualizer

__all__ = ["INK", "JOINT_TORQUE", "VISION", "WRIST", "Callout", "OverheadCamera", "ring", "stand"]

INK = "#2A3038"
VISION, JOINT_TORQUE, WRIST = "#2B7CAE", "#B04E82", "#008763"
_DARK, _METAL = "#2E3338", "#AEB6BF"


@dataclass(frozen=True)
class Callout:
    """A label beside what it names, joined to it by a thin line.

    Attributes:
        text: of the label. feature: (3,) what it names.
        beside: to the right and up in the picture, where the label is (m).
    """

    text: str
    feature: Array
    beside: tuple[float, float] = (0.0, 0.0)
    colour: str = INK

    def draw(self, scene: Visualizer, path: str, axes: Array) -> dict[str, Any]:
        """Make the nodes; axes: (2, 3) right and up. Returns the label for the page's scripts.

        Args:
            scene: of the page.
            path: under which the nodes stand.
            axes: (2, 3) directions of the picture: right and up.
        """
        from meshcat.geometry import Sphere

        spot = self.feature + np.asarray(self.beside) @ axes
        scene[f"{path}/label"].set_transform(pin.SE3(np.eye(3), spot).homogeneous)
        if any(self.beside):
            size = 0.004 * float(np.hypot(*self.beside)) ** 0.5
            _bar(scene[f"{path}/line"], self.feature, spot, 0.4 * size, plain(self.colour))
            scene[f"{path}/dot"].set_object(Sphere(1.4 * size), plain(self.colour))
            scene[f"{path}/dot"].set_transform(pin.SE3(np.eye(3), self.feature).homogeneous)
        return {
            "path": f"{path}/label", "text": self.text, "colour": self.colour,
            "line": None, "unit": "", "lost": None,
        }  # fmt: skip


@dataclass(frozen=True)
class OverheadCamera:
    """A camera on a boom, and the pyramid that it sees.

    Attributes:
        eye: (3,) of the lens. post: (2,) where the boom's post stands on the floor.
        middle: (3,) of the rectangle that is seen, in a horizontal plane.
        half: (2,) half its sides (m).
    """

    eye: Array
    post: Array
    middle: Array
    half: Array

    @property
    def corners(self) -> Array:
        """(4, 3) of the rectangle that is seen, in order."""
        signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
        return self.middle + np.column_stack((signs * self.half, np.zeros(4)))

    def draw(self, scene: Visualizer, path: str) -> None:
        """Make the nodes."""
        from meshcat.geometry import Box, Cylinder, TriangularMeshGeometry

        dark, metal = material(_DARK), material(_METAL)
        eye, foot = np.asarray(self.eye, dtype=float), np.append(self.post, 0.0)
        body, top = eye + [0.0, 0.0, 0.065], np.append(self.post, eye[2] + 0.14)
        _bar(scene[f"{path}/post"], foot, top, 0.022, metal)
        _bar(scene[f"{path}/boom"], top, body + [0.0, 0.0, 0.075], 0.018, metal)
        _bar(scene[f"{path}/hanger"], body + [0.0, 0.0, 0.075], body, 0.012, metal)
        scene[f"{path}/foot"].set_object(Cylinder(0.02, 0.1), metal)
        scene[f"{path}/foot"].set_transform(along(foot + [0, 0, 0.01], [0, 0, 1]).homogeneous)
        scene[f"{path}/body"].set_object(Box([0.11, 0.075, 0.075]), dark)
        scene[f"{path}/body"].set_transform(pin.SE3(np.eye(3), body).homogeneous)
        _bar(scene[f"{path}/lens"], body - [0, 0, 0.03], eye, 0.027, material("#15181C"))
        _bar(scene[f"{path}/glass"], eye, eye - [0, 0, 0.004], 0.021, material(VISION))
        ends = self.corners
        sides = np.array([[0, k + 1, (k + 1) % 4 + 1] for k in range(4)], dtype=np.uint32)
        seen = TriangularMeshGeometry(np.vstack((eye, ends)).astype(np.float32), sides)
        scene[f"{path}/view/sides"].set_object(seen, plain(VISION, 0.075))
        for k, end in enumerate(ends):
            _bar(scene[f"{path}/view/edge{k}"], eye, end, 0.0014, plain(VISION, 0.8))
            _bar(scene[f"{path}/view/rim{k}"], end, ends[(k + 1) % 4], 0.0022, plain(VISION))


def stand(node: Visualizer, X: pin.SE3, thickness: float) -> None:
    """What carries a plate whose front is the xy-plane of X: a post from the floor to its back.

    Args:
        node: that gets the post.
        X: pose of the plate's front, the xy-plane.
        thickness: of the plate (m).
    """
    back = X.act(np.array([0.0, 0.0, -thickness]))
    paint = material(_METAL)
    foot = np.array([back[0], back[1], 0.0])
    _bar(node["post"], foot, back - [0.0, 0.0, 0.02], 0.014, paint)
    _bar(node["foot"], foot, foot + [0.0, 0.0, 0.012], 0.06, paint)
    _bar(node["clamp"], back, back - 0.035 * X.rotation[:, 2], 0.022, material(_DARK))


def ring(node: Visualizer, X: pin.SE3, radius: float, colour: str, thickness: float) -> None:
    """A ring about the z-axis of X.

    Args:
        node: that gets the ring.
        X: its pose; the ring turns about z.
        radius: of the ring (m).
        colour: ``#RRGGBB``.
        thickness: of its tube (m).
    """
    turn = np.linspace(0.0, 2.0 * np.pi, 65)
    circle = radius * np.column_stack((np.cos(turn), np.sin(turn), np.zeros_like(turn)))
    node.set_object(tube(circle, thickness, sides=10), material(colour, glow=0.35))
    node.set_transform(X.homogeneous)


def _bar(node: Visualizer, start: Sequence[float] | Array, end: Array, r: float, how: Any) -> None:
    from meshcat.geometry import Cylinder

    start, end = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    node.set_object(Cylinder(float(np.linalg.norm(end - start)), r), how)
    node.set_transform(along(0.5 * (start + end), end - start).homogeneous)
