"""What a selection matrix can say of a contact: axes, a point, and flags."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from osc_contact.contacts.raibert_craig import Triple, selection_columns
from osc_contact.spatial import Array, skew

__all__ = ["Selection"]


@dataclass(frozen=True)
class Selection:
    """Force-controlled axes through one point p.

    With F the selected force directions and C the selected couple axes, in 6-vectors at p

        Ω̄ = diag(FFᵀ, CCᵀ),   Ω = 1 − Ω̄

    are Khatib's generalised task specification matrices. As projectors at p they are meant, for
    this is what the laws say; `force` and `motion` are the same carried to O.

    Attributes:
        linear: axes (columns of the rotation) along which forces are selected, and the point where
            they act, as a translation from O; world axes (m).
        angular: (3, 3) axes about which couples are selected.
        forces, couples: which of these axes are force controlled.
    """

    linear: pin.SE3
    angular: Array
    forces: Triple
    couples: Triple

    @classmethod
    def of_frame(cls, frame: pin.SE3, forces: Triple, couples: Triple) -> Selection:
        """One constraint frame for forces and couples: the Raibert–Craig model.

        Args:
            frame: pose of the constraint frame.
            forces, couples: which of its axes are force controlled.
        """
        return cls(frame, np.array(frame.rotation), forces, couples)

    @cached_property
    def wrenches(self) -> Array:
        """W (6, r): unit forces and couples that are force controlled, at O."""
        turned = pin.SE3(self.angular, self.linear.translation)
        none = (False, False, False)
        return np.hstack(
            (
                selection_columns(self.linear, self.forces, none),
                selection_columns(turned, none, self.couples),
            )
        )

    @cached_property
    def force(self) -> Array:
        """Ω̄ (6, 6) at O: the selected part of a wrench."""
        F = np.array(self.linear.rotation)[:, np.array(self.forces)]
        C = self.angular[:, np.array(self.couples)]
        lever = skew(np.array(self.linear.translation))
        upper, lower = F @ F.T, C @ C.T
        return np.block([[upper, np.zeros((3, 3))], [lever @ upper - lower @ lever, lower]])

    @cached_property
    def motion(self) -> Array:
        """Ω (6, 6) at O: the part of an acceleration left to motion control, WᵀΩ = 0."""
        return np.eye(6) - self.force.T
