"""A screw between object and environment."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs.pair import Bodies, store, triad
from osc_contact.contacts.pairs.registry import register_pair
from osc_contact.contacts.pairs.tangent_pair import (
    TangentPair,
    held_axis,
    read_joint,
    screw,
    thread,
)
from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array

__all__ = ["Screw"]


@register_pair()
@dataclass(frozen=True, eq=False)
class Screw(TangentPair):
    """A screw: the object turns about an axis of the environment and advances with it (r = 5).

    Gaps: two distances of the point from the axis, two angles of the axis, and the advance that
    the angle does not account for, to the nearest turn of the thread (m). Their gradient is −N in
    the assembled screw; N annihilates T in any pose.

    Attributes:
        point: (3,) a point of the axis in the object frame (m).
        axis: (3,) in the object frame; normalised on entry.
        pitch: advance along the axis (m/rad, not per turn); negative: left-handed.
        assembled: a pose of the object in the environment frame at which the screw is closed.
        name: used in messages and recordings.
    """

    point: Array
    axis: Array
    pitch: float
    assembled: pin.SE3 = field(default_factory=pin.SE3.Identity)
    name: str = "screw"
    _seat: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        read_joint(self)
        if not np.isfinite(self.pitch) or self.pitch == 0.0:
            raise InvalidInputError(
                f"{self.name}.pitch = {self.pitch}; give m/rad other than 0 (else: Revolute)"
            )
        store(self, _seat=triad(self.assembled.rotation @ self.axis))
        axes = self.point, self.axis, self._seat[:, 2], self.pitch
        on_axis = self.assembled.act(self.point)
        tilts = held_axis(self.axis, self._seat[:, 2])
        self._hold_tangents(
            self.point, self._seat[:, :2], on_axis, tilts, (screw(*axes),), (thread(*axes),)
        )

    def gaps(self, X_WO: pin.SE3, X_WE: pin.SE3 | None = None) -> Array:
        """(5,) signed errors, the last one wrapped to ±π |pitch|."""
        b = Bodies.at_O(X_WO, X_WE=X_WE)
        x, y, d = b.rotate_E(self._seat).T
        spoke = b.R_A @ (self.assembled.rotation.T @ self._seat[:, 0])  # along x when assembled
        angle = np.arctan2(y @ spoke, x @ spoke)
        on_axis = b.point_E(self.assembled.act(self.point))
        ahead = d @ (b.point_A(self.point) - on_axis) / self.pitch - angle
        wrapped = -self.pitch * np.remainder(ahead + np.pi, 2 * np.pi) + self.pitch * np.pi
        return np.append(super().gaps(X_WO, X_WE), wrapped)
