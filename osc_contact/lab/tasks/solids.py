"""Bodies of boxes and cylinders: their URDF for MuJoCo, and their picture for scenes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from osc_contact.files import Json
from osc_contact.spatial import Array

_CYLINDER, _BOX = 5, 6  #: numbers of shapes in pictures, see `robots.pictures`


@dataclass(frozen=True)
class Solid:
    """Box or cylinder of a body.

    Attributes:
        centre: (3,) its centre in the frame of the body (m).
        edges: (3,) lengths of the edges of a box; diameter, diameter and length of a cylinder (m).
        turn: rotation of its frame about the z axis of the body (rad).
        is_cylinder: whether it is a cylinder, whose axis is z.
    """

    centre: Array
    edges: Array
    turn: float = 0.0
    is_cylinder: bool = False

    def beside(self, x: float) -> Solid:
        """Solid of the same shape, farther along x of the body.

        Args:
            x: distance (m).
        """
        centre = self.centre + np.array([x, 0.0, 0.0])
        return Solid(centre, self.edges, self.turn, self.is_cylinder)


def body_urdf(name: str, solids: Iterable[Solid], inertial: str = "") -> str:
    """URDF of one link of solids, in which each is shape and collision shape.

    Args:
        name: name of robot and link.
        solids: shapes of the link.
        inertial: element `inertial` of the link; empty: a body that does not move.
    """
    parts = []
    for solid in solids:
        if solid.is_cylinder:
            shape = f'<cylinder radius="{0.5 * solid.edges[0]}" length="{solid.edges[2]}"/>'
        else:
            shape = f'<box size="{" ".join(map(str, solid.edges))}"/>'
        xyz = " ".join(map(str, solid.centre))
        body = f'<origin xyz="{xyz}" rpy="0 0 {solid.turn}"/><geometry>{shape}</geometry>'
        parts.append(f"<visual>{body}</visual><collision>{body}</collision>")
    return f'<robot name="{name}"><link name="{name}">{inertial}{"".join(parts)}</link></robot>'


def picture(solids: Iterable[Solid], colour: Sequence[float]) -> Json:
    """Picture of solids of one body, see `robots.pictures`.

    Args:
        solids: shapes of the body.
        colour: red, green, blue and opacity of all.
    """
    shapes = [{"joint": 0, "rgba": list(colour), **_shape(solid)} for solid in solids]
    return {"joints": [], "shapes": shapes}


def _shape(solid: Solid) -> Json:
    """Kind, size and place of a solid in a picture."""
    place = pin.SE3(pin.exp3(np.array([0.0, 0.0, solid.turn])), solid.centre)
    half = (0.5 * solid.edges).tolist()
    return {
        "kind": _CYLINDER if solid.is_cylinder else _BOX,
        "size": [half[0], half[2], 0.0] if solid.is_cylinder else half,
        "place": pin.SE3ToXYZQUAT(place).tolist(),
    }
