"""What the cone is asked to do: turn and slide at once while its pushes on the walls step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from osc_contact.interface import Reference
from osc_contact.paper.cone_in_groove.rig import ConeRig
from osc_contact.scenarios.quantities import Angle, Force, Length
from osc_contact.scenarios.signals import MinimumJerk, Sine, Step
from osc_contact.spatial import Array, cross

__all__ = ["ConeTask"]

_REST = (9.0, 7.0, 8.0, 10.0)  # N
_STEPS = (4.0, -3.0, 5.0, -4.0)  # N, one wall force after the other
_TURN = Sine[Angle](amplitude=0.6, frequency=0.4, ramp=1.0)
_SLIDE = Sine[Length](amplitude=0.04, frequency=0.55, ramp=1.0)


@dataclass(frozen=True)
class ConeTask:
    """References of a run.

    Attributes:
        rig: where it starts.
        step_times: (s) at which the four wall forces step, one after the other; at most four.
        moving: whether the cone turns and slides.
    """

    rig: ConeRig
    step_times: tuple[float, ...] = (2.0, 2.7, 3.4, 4.1)
    moving: bool = True

    def wall_forces(self, t: float) -> Array:
        """λ_d (4,): desired pushes at the ends of the lines of contact (N)."""
        forces = np.array([MinimumJerk[Force](value=v, duration=0.3).at(t)[0] for v in _REST])
        for i, start in enumerate(self.step_times):
            forces[i] += Step[Force](value=_STEPS[i], start=start).at(t)[0]
        return forces

    def motions(self, t: float) -> Array:
        """(2, 3): turn (rad) and slide (m), each with its first and second derivative."""
        if not self.moving:
            return np.zeros((2, 3))
        return np.array([_TURN.at(t), _SLIDE.at(t)])

    def at(self, t: float) -> Reference:
        """Desired pose, twist and classical acceleration of the object, α_d = R λ_d."""
        (psi, psi_dot, psi_ddot), (s, s_dot, s_ddot) = self.motions(t)
        cone, groove, start = self.rig.cone, self.rig.groove, self.rig.state.X_WO
        e, a = groove.direction, cone.seat(groove)
        R = pin.exp3(psi * a) @ start.rotation
        apex = start.act(cone.apex) + s * e
        r = -R @ cone.apex  # from the apex to O
        w, w_dot = psi_dot * a, psi_ddot * a
        V = np.concatenate((s_dot * e + cross(w, r), w))
        A = np.concatenate((s_ddot * e + cross(w_dot, r) + cross(w, cross(w, r)), w_dot))
        return Reference(
            pin.SE3(R, apex + r), V, A, self.rig.from_wall_forces @ self.wall_forces(t)
        )
