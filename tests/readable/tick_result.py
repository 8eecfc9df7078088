"""What one tick found, as plain arrays: what recordings keep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from osc_contact.spatial import Array, pose_error
from readable.allocation import squeeze_rows
from readable.force import outboard_mobility
from readable.linkage import Linkage, bar_forces, bars

if TYPE_CHECKING:
    from readable.controller import ReadableController as Controller
    from readable.signals import Signals

__all__ = ["Found"]


@dataclass(frozen=True)
class Found:
    """Everything at O in world axes.

    Attributes:
        J: (n, 6) the joints' columns at the world's origin, one in each row.
        f_meas, bias_out: (6,) wrist readings less tare; what they would be without contact.
        f_c: (6,) contact force in them. V_O: (6,) twist of the object. X_WO: (4, 4) its pose.
        error: (6,) pose error. free_error: (6,) Ω_m(Λ_o⁻¹) of it.
        squeeze: (1,) internal force along the grasp line (N), > 0 compresses; with k ≥ 3 arms
            (k(k − 1)/2,) that between each two grasps, as in `Reference.squeeze_d`, or zeros
            where none is commanded.
        magnitudes: (≥ r,) contact magnitudes measured; speeds: (≥ r,) NᵀV_rel; the first r of them
            count. rank: (1,) r.
        mobilities: (≥ r, ≥ r) D of the force filter, see `contact_force`; kept for contact phases.
    """

    J: Array
    f_meas: Array
    bias_out: Array
    f_c: Array
    V_O: Array
    X_WO: Array
    error: Array
    free_error: Array
    squeeze: Array
    magnitudes: Array
    speeds: Array
    mobilities: Array
    rank: Array

    @property
    def alpha_meas(self) -> Array:
        """(r,) contact magnitudes measured."""
        return self.magnitudes[: int(self.rank[0])]

    @property
    def normal_speed(self) -> Array:
        """(r,) NᵀV_rel (m/s): 0 while the contacts last."""
        return self.speeds[: int(self.rank[0])]

    @property
    def mobility(self) -> Array:
        """(r, r) D: normal acceleration for each newton on what is outboard of the sensors."""
        r = int(self.rank[0])
        return self.mobilities[:r, :r]

    @classmethod
    def of(cls, s: Signals, controller: Controller) -> Found:
        """From the signals of the readable path."""
        state = s.state
        error = pose_error(s.reference.X_WD, state.X_WO)
        Omega_m = s.contact.motion_projection(np.linalg.inv(state.metric))
        D = np.zeros((0, 0))
        if controller.life is not None and (state.d == 6 or state.payload.Lambda.any()):
            D = outboard_mobility(state, s.contact, s.environment, s.friction_wrenches)[0]
        return cls(
            J=controller.chain.data.J.T,
            f_meas=s.f_meas,
            bias_out=state.bias_out,
            f_c=s.f_c_meas,
            V_O=state.V_O,
            X_WO=state.X_WO.homogeneous,
            error=error,
            free_error=Omega_m @ error,
            squeeze=_squeeze(s, controller),
            magnitudes=s.alpha_meas,
            speeds=controller._speed,
            mobilities=D,
            rank=np.array([len(s.alpha_meas)]),
        )


def _squeeze(s: Signals, controller: Controller) -> Array:
    chain, given_up = controller.chain, controller.given_up
    wanted = bar_forces(len(chain.arms), s.squeeze_d)
    if wanted is not None:
        linkage = Linkage.of(s.state, chain)
        if given_up is not None:
            return np.asarray(linkage.basis @ (linkage.basis.T @ wanted) - given_up.squeeze)
        E, e0 = linkage.rows(s.state, chain, s.eta_c)
    else:
        E, e0 = squeeze_rows(s.state, chain, s.eta_c)
        if not len(e0):
            return np.zeros(max(1, bars(len(chain.arms))))
        if given_up is not None:
            return np.asarray(s.squeeze_d - given_up.squeeze)
    return np.asarray(E @ controller.last_torques() - e0)
