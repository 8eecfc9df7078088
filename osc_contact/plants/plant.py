"""What every plant offers: sensors for the controller, the truth for the judge, a step in time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import pinocchio as pin

from osc_contact.interface import Measurement
from osc_contact.spatial import Array

__all__ = ["Plant", "Truth"]


@dataclass(frozen=True)
class Truth:
    """What only the plant knows; for judging, never for the controller.

    Attributes:
        alpha: (r,) contact force magnitudes, contact after contact (N).
        closed: (contacts,) whether each contact touches; of several points, all of them.
        X_WO: pose of the object. V_O: (6,) its twist at its origin, world axes.
        X_WE: pose of the frame in which each contact's face is described; None: faces at rest.
    """

    alpha: Array
    closed: Array
    X_WO: pin.SE3
    V_O: Array
    X_WE: tuple[pin.SE3, ...] | None = None


class Plant(Protocol):
    """A rig under torque control."""

    time: float  #: s since the last reset

    def reset(self, q: Array) -> None:
        """Start again at rest at joint positions q (n,)."""

    def hold(self, tau: Array) -> None:
        """Apply torques (n_a,) from now on without letting time pass: sensors read under them."""

    def measure(self) -> Measurement:
        """What the rig's sensors read now."""

    def truth(self) -> Truth:
        """What they cannot read."""

    def poses(self) -> Array:
        """(1 + arms, 4, 4) of the object and of the arms' tips, as they really are."""

    def step(self, tau: Array, duration: float) -> None:
        """Hold motor torques (n_a,) for `duration` seconds.

        Raises:
            PlantError: the simulation diverged.
        """
