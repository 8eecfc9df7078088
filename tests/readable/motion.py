"""Motion control of the object: the acceleration that brings it back to its reference."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from osc_contact.control.motion import MotionGains
from osc_contact.dynamics.closed_chain import ChainState
from osc_contact.interface import Reference
from osc_contact.spatial import Array, classical_to_spatial, pose_error

__all__ = ["MotionLaw"]


@dataclass
class MotionLaw:
    """a_u = p̈_d + K_d ė + K_p e + K_i ∫e, returned as a spatial acceleration at O.

    Only the part of e that the contact permits is integrated: the rest belongs to the force loop
    and would wind up.
    """

    gains: MotionGains
    dt: float
    memory: Array = field(default_factory=lambda: np.zeros(6))  #: where ∫e dt is kept

    @property
    def integral(self) -> Array:
        """(6,) ∫e dt (m s, rad s)."""
        return self.memory.copy()

    @integral.setter
    def integral(self, value: Array) -> None:
        self.memory[:] = value

    def command(self, reference: Reference, state: ChainState, Omega_m: Array) -> Array:
        """Commanded spatial acceleration (6,) of the object.

        Args:
            reference: desired pose, twist and classical acceleration.
            state: measured state of the chain.
            Omega_m: (6, 6) projection onto the permitted motions (eq. 4).
        """
        k = self.gains
        error = pose_error(reference.X_WD, state.X_WO)
        self.integral = self.integral + Omega_m @ error * self.dt
        classical = (
            reference.A_D
            + k.damping * (reference.V_D - state.V_O)
            + k.stiffness * error
            + k.integral * self.integral
        )
        return classical_to_spatial(classical, state.V_O)
