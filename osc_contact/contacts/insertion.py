"""Pegs, holes, and the contact pairs that they can make, by name.

The frames of peg and hole coincide when the peg's tip is in the mouth of the hole: the origin of
the peg is the middle of its tip, that of the hole the middle of its mouth, and both z axes point
into the hole. Sides are named by their directions in these frames, "+x", "-x", "+y" and "-y", and
corners by two of them, "+x+y".
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import product
from math import sqrt
from typing import Literal

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs.pair import ContactPair
from osc_contact.contacts.pairs.points_on_planes import CylinderInHole, VertexOnFace
from osc_contact.contacts.pairs.tangent_pair import Prismatic
from osc_contact.contacts.pairs.vertex_and_edge import EdgeOnEdge, FaceOnVertex
from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array

Shape = Literal["square", "round"]
SIDES: dict[str, Array] = {
    "+x": np.array([1.0, 0.0, 0.0]),
    "-x": np.array([-1.0, 0.0, 0.0]),
    "+y": np.array([0.0, 1.0, 0.0]),
    "-y": np.array([0.0, -1.0, 0.0]),
}
CORNERS: dict[str, Array] = {
    x + y: SIDES[x] + SIDES[y] for x, y in product(("+x", "-x"), ("+y", "-y"))
}
_OUT = np.array([0.0, 0.0, -1.0])  #: direction out of the hole
_INTO = -_OUT  #: direction into the hole
#: Distance of the two points of a round peg's axis at which it is held (m). A couple that
#: overcomes stiction of the joints, some 0.5 N m, takes a few newtons at both, not some tens.
_HELD_LENGTH = 0.1
_SHARE_OF_RIM = (
    0.7  #: distance of the two points of a side along a rim, as a share of the rim's length
)


@dataclass(frozen=True)
class Peg:
    """Straight peg. Its frame: origin in the middle of its tip, z out of the tip.

    Attributes:
        shape: shape of the cross section. The sides of a square peg are along x and y.
        width: width of the sides, or diameter (m).
        width_y: width along y (m) of a rectangular peg, whose `width` is along x; None: it is
            square. Rectangular pegs have the shape "square", too.
        pose: pose of the peg's frame in that of the held object; it differs from the identity if
            the object has several pegs.

    Raises:
        InvalidInputError: a width that is not positive.

    Example:
        >>> peg = osc.Peg("square", 0.02)
        >>> print(peg.shape, peg.width, peg.pose.translation)
        square 0.02 [0. 0. 0.]
    """

    shape: Shape
    width: float
    pose: pin.SE3 = field(default_factory=pin.SE3.Identity)
    width_y: float | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        """Refuse another shape, or a width that is not positive."""
        _require_sizes(self, "width")

    @property
    def half(self) -> Array:
        """Half the widths along x and y, and 0 (3,) (m)."""
        return _half_widths(self)


@dataclass(frozen=True)
class Hole:
    """Straight hole in a flat face. Its frame: origin in the middle of its mouth, z into it.

    Attributes:
        shape: shape of the cross section. The walls of a square hole are along x and y.
        width: distance of opposite walls, or diameter (m).
        width_y: distance (m) of the walls across y of a rectangular hole, whose `width` is along x;
            None: it is square.
        depth: distance of the bottom from the mouth (m).
        pose: pose of the hole's frame in the frame of the body that has the hole.

    Raises:
        InvalidInputError: a size that is not positive.

    Example:
        >>> hole = osc.Hole("square", width=0.0202, depth=0.03)
        >>> found = hole.found_at(pin.SE3(np.eye(3), np.array([1e-3, 0.0, 0.0])))
        >>> print(found.translation)
        [0.001 0.    0.   ]
    """

    shape: Shape
    width: float
    depth: float
    pose: pin.SE3 = field(default_factory=pin.SE3.Identity)
    width_y: float | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        """Refuse another shape, or a size that is not positive."""
        _require_sizes(self, "width", "depth")

    @property
    def half(self) -> Array:
        """Half the widths along x and y, and 0 (3,) (m)."""
        return _half_widths(self)

    def found_at(self, pose: pin.SE3) -> pin.SE3:
        """Pose of the body that has the hole, from the true pose of the hole.

        Args:
            pose: pose of the hole's frame in the world.
        """
        return pose * self.pose.inverse()


def _require_sizes(shape: Peg | Hole, *names: str) -> None:
    """Refuse another shape of the cross section, and sizes that are not positive.

    Args:
        shape: peg or hole.
        *names: names of its sizes (m).

    Raises:
        InvalidInputError: with the value.
    """
    if shape.shape not in ("square", "round"):
        raise InvalidInputError(f"shape = {shape.shape!r}; give 'square' or 'round'")
    if shape.width_y is not None and shape.shape == "round":
        raise InvalidInputError("width_y of a round cross section; leave it out")
    for name in names if shape.width_y is None else (*names, "width_y"):
        if not getattr(shape, name) > 0.0:
            raise InvalidInputError(f"{name} = {getattr(shape, name)!r}; give metres, > 0")


def _half_widths(shape: Peg | Hole) -> Array:
    """Half the widths along x and y, and 0 (3,) (m), of a peg or a hole."""
    across = shape.width if shape.width_y is None else shape.width_y
    return np.array([0.5 * shape.width, 0.5 * across, 0.0])


def pairs_between(peg: Peg, hole: Hole, *, prefix: str = "") -> dict[str, ContactPair]:
    """Make the contact pairs that a peg and a hole can have, by their names.

    A plan names the pairs of each stage; the controller is made for the pairs of all stages.

    | pair | geometry | r |
    |---|---|---|
    | `corner +x+y on face` | corner of the square tip, face around the mouth | 1 |
    | `edge +x on rim -y` | edge of the square tip, rim of the mouth that it crosses | 1 |
    | `corner +x+y on rim +x` | long edge of the square peg, rim that it crosses | 1 |
    | `corner +x+y on wall +x` | corner of the square tip, wall of the hole | 1 |
    | `point +x on face` | point of the round tip's edge, face | 1 |
    | `point +x on wall +x` | point of the round tip's edge, wall of the round hole | 1 |
    | `side +x on rim +x` | side of the peg at any depth, middle of the rim | 1 |
    | `side +x on rim +x, a` and `b` | side of the peg, point of the rim beside its middle | 1 |
    | `tip on face`, `tip on bottom` | middle of the tip, plane of the mouth, of the bottom | 1 |
    | `hole` | peg in the hole, free along its axis; a round peg is free to turn about it | 5, 4 |

    Args:
        peg: peg at its place in the held object.
        hole: hole at its modelled pose.
        prefix: beginning of all names, which distinguishes the pegs of an object, such as "left ".

    Raises:
        InvalidInputError: shapes of two kinds, or a peg that is not narrower than the hole.

    Example:
        >>> peg = osc.Peg("square", 0.02)
        >>> touch = osc.pairs_between(peg, osc.Hole("square", width=0.0202, depth=0.03))
        >>> print(len(touch), touch["edge +x on rim -y"].gaps(pin.SE3.Identity()).round(6))
        43 [0.]
    """
    if peg.shape != hole.shape:
        raise InvalidInputError(f"a {peg.shape} peg and a {hole.shape} hole; give the same shape")
    for width, opening in zip(2.0 * peg.half[:2], 2.0 * hole.half[:2], strict=True):
        if not width < opening:
            raise InvalidInputError(
                f"the peg is {1e3 * width:g} mm wide and the hole {1e3 * opening:g} mm; give a "
                "hole that is wider"
            )
    maker = _Pairs(peg, hole, prefix)
    pairs = maker.square() if peg.shape == "square" else maker.round()
    return {pair.name: pair for pair in pairs}


class _Pairs:
    """Maker of the pairs of a peg and a hole.

    Methods take points (3,) (m) and directions (3,) in the common frame of peg and hole; those of
    the peg are transformed to the frame of the object, those of the hole to that of its body.

    Args:
        peg: peg.
        hole: hole.
        prefix: beginning of all names.
    """

    def __init__(self, peg: Peg, hole: Hole, prefix: str) -> None:
        """Store half widths and depth (m), and the maps of points and directions.

        Args:
            peg: dimensions of the peg, and its pose in the object.
            hole: dimensions and pose of the hole.
            prefix: beginning of all names.
        """
        self._prefix = prefix  #: beginning of all names
        self._peg_half = peg.half  #: (3,) half the widths of the peg, and 0 (m)
        self._hole_half = hole.half  #: (3,) half the widths of the hole, and 0 (m)
        self._depth = hole.depth  #: depth of the hole (m)
        self._hole_pose = hole.pose  #: pose of the hole in its body
        self._peg_pose = peg.pose  #: pose of the peg in the object
        #: map of points (3,) to the frame of the hole's body
        self._to_body: Callable[[Array], Array] = hole.pose.act
        #: map of directions (3,) to that frame
        self._turn_to_body: Callable[[Array], Array] = lambda d: hole.pose.rotation @ d
        #: map of points (3,) to the frame of the object
        self._to_object: Callable[[Array], Array] = peg.pose.act
        #: map of directions (3,) to that frame
        self._turn_to_object: Callable[[Array], Array] = lambda d: peg.pose.rotation @ d

    def square(self) -> Iterator[ContactPair]:
        """Yield the pairs that a square peg and the hole can make, one after the other.

        They are corners of the tip on the face, on walls and on rims; edges of the tip on the rims
        that they cross; sides of the peg on the rim beside them, in the middle and near both ends;
        the pairs of the tip with the bottom; and the peg inserted, which only slides along the
        hole.
        """
        for name, corner in CORNERS.items():
            tip = self._peg_half * corner
            yield self._on_plane(f"corner {name} on face", tip, np.zeros(3), _OUT)
            for side in (name[:2], name[2:]):
                yield self._on_wall(f"corner {name} on wall {side}", tip, side)
                yield self._long_edge(f"corner {name} on rim {side}", tip, side)
        for edge, rim in product(SIDES, SIDES):
            if edge[1] != rim[1]:  # an edge of the tip crosses the rims of the other axis
                yield self._tip_edge(edge, rim)
        for name, direction in SIDES.items():
            along = np.cross(_INTO, direction)
            yield self._side_on_rim(f"side {name} on rim {name}", direction, np.zeros(3))
            for end, half in (("a", 0.5), ("b", -0.5)):
                offset = half * _SHARE_OF_RIM * 2.0 * self._hole_half * along
                yield self._side_on_rim(f"side {name} on rim {name}, {end}", direction, offset)
        yield from self._pairs_of_tip()
        tip = self._to_object(np.zeros(3))
        seated = self._hole_pose * self._peg_pose.inverse()  # pose of the object
        yield Prismatic(tip, self._turn_to_object(_INTO), seated, name=f"{self._prefix}hole")

    def round(self) -> Iterator[ContactPair]:
        """Yield the pairs of a round peg, at its four sides, and 45° beside each of them.

        A tilted cylinder that is pressed into the rim touches it on both sides of its lowest line;
        equal forces there keep it in the middle.
        """
        for name, side in SIDES.items():
            tip = self._peg_half * side
            yield self._on_plane(f"point {name} on face", tip, np.zeros(3), _OUT)
            yield self._on_wall(f"point {name} on wall {name}", tip, name)
            yield self._side_on_rim(f"side {name} on rim {name}", side, np.zeros(3))
            along = np.cross(_INTO, side)
            for end, sign in (("a", 1.0), ("b", -1.0)):
                beside = (side + sign * along) / sqrt(2.0)
                yield self._side_on_rim(f"side {name} on rim {name}, {end}", beside, np.zeros(3))
        yield from self._pairs_of_tip()
        yield CylinderInHole(
            self._to_object(-0.5 * self._depth * _INTO),
            self._turn_to_object(_INTO),
            self._to_body(np.zeros(3)),
            self._turn_to_body(_INTO),
            length=_HELD_LENGTH,
            name=f"{self._prefix}hole",
        )

    def _pairs_of_tip(self) -> Iterator[ContactPair]:
        """Yield the pairs of the middle of the tip, with the face and with the bottom."""
        yield self._on_plane("tip on face", np.zeros(3), np.zeros(3), _OUT)
        yield self._on_plane("tip on bottom", np.zeros(3), self._depth * _INTO, _OUT)

    def _on_plane(self, name: str, point: Array, on: Array, normal: Array) -> ContactPair:
        """Pair of a point of the peg and a plane of the hole.

        Args:
            name: name of the pair.
            point: point of the peg.
            on: point of the plane.
            normal: normal out of the plane's material.
        """
        return VertexOnFace(
            self._to_object(point),
            self._to_body(on),
            self._turn_to_body(normal),
            name=self._prefix + name,
        )

    def _on_wall(self, name: str, point: Array, side: str) -> ContactPair:
        """Pair of a point of the peg and the wall on a side of the hole, such as "+x"."""
        return self._on_plane(name, point, self._hole_half * SIDES[side], -SIDES[side])

    def _long_edge(self, name: str, tip: Array, rim: str) -> ContactPair:
        """Pair of the long edge through a corner `tip` of the square tip and the rim on a side."""
        return self._crossed_edges(name, tip, _INTO, rim, -SIDES[rim])

    def _tip_edge(self, edge: str, rim: str) -> ContactPair:
        """Pair of the edge of the square tip on the side `edge` and the rim on the side `rim`."""
        side = SIDES[edge]
        name = f"edge {edge} on rim {rim}"
        return self._crossed_edges(name, self._peg_half * side, np.cross(_INTO, side), rim, _OUT)

    def _crossed_edges(
        self, name: str, point: Array, direction: Array, rim: str, outward: Array
    ) -> ContactPair:
        """Pair of an edge of the peg and the rim of the square hole on a side.

        Args:
            name: name of the pair.
            point, direction: point and direction of the edge.
            rim: side of the rim, such as "+x".
            outward: direction out of the material at the rim.
        """
        side = SIDES[rim]
        edge = self._turn_to_body(np.cross(_INTO, side))
        on_rim = self._to_body(self._hole_half * side)
        return EdgeOnEdge(
            self._to_object(point),
            self._turn_to_object(direction),
            on_rim,
            edge,
            self._turn_to_body(outward),
            name=self._prefix + name,
        )

    def _side_on_rim(self, name: str, side: Array, offset: Array) -> ContactPair:
        """Pair of a side of the peg and a point of the rim.

        Args:
            name: name of the pair.
            side: direction of the side.
            offset: offset of the point from the middle of the rim (m).
        """
        point = self._to_body(self._hole_half * side + offset)
        on_side = self._to_object(self._peg_half * side)
        return FaceOnVertex(on_side, self._turn_to_object(side), point, name=self._prefix + name)
