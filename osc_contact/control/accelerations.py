"""Accelerations of the joints that are expected under the last torques and measured forces."""

from __future__ import annotations

from typing import Any

import numpy as np

from osc_contact.control.controller import Controller
from osc_contact.law.records import HELD
from osc_contact.spatial import Array

_SLOW = 0.03  #: rad/s, m/s; joints that swing with a contact are not faster
_SWINGS = 0.01  #: s, 1/ω of contacts
_LEAST = 1.0  #: N, N m; a contact of no desired force swings by less
_SETTLES = 0.1  #: s after an impact in which wrists do not show how contacts swing


class ExpectedAcceleration:
    """Accelerations of the joints from tick to tick, see `expected_acceleration`.

    A contact that swings about its desired force misses it by no more than this force, or it would
    open. Where a force is missed by more, the object is struck or pushed, and a wrist shows a force
    that no contact exerts: until `_SETTLES` after it accelerations are those commanded.
    """

    def __init__(self, dt: float) -> None:
        """Begin with contacts that swing.

        Args:
            dt: period of the ticks (s).
        """
        self._dt = dt
        self._calm_for = _SETTLES

    def update(self, controller: Controller) -> Array:
        """(n,) q̈ of all joints (rad/s², m/s²).

        Args:
            controller: after a tick.
        """
        work: Any = controller._records.work
        r = int(work.rank)
        missed = np.abs(work.alpha_u[:r] - work.alpha_meas[:r])
        struck = bool((missed > np.maximum(np.abs(work.alpha_d[:r]), _LEAST)).any())
        self._calm_for = 0.0 if struck else self._calm_for + self._dt
        if self._calm_for < _SETTLES:
            return controller.joint_acceleration()
        return expected_acceleration(controller)


def expected_acceleration(controller: Controller) -> Array:
    """(n,) q̈ of all joints, which an estimate of their velocities takes as known (rad/s², m/s²).

    The law commands η̇_c and expects the contact forces α_u. Where they are α_meas instead the chain
    answers with η̇_c + Λ_S⁻¹SᵀN_μ(α_u − α_meas): of a contact that swings the wrist sensors show its
    acceleration. Without that part where nothing was commanded of contacts, or near singular
    postures. What friction and a wrong model push beside it is left to the estimate.

    See docs/tuning.md#estimated-velocities.

    Args:
        controller: after a tick.

    Example:
        >>> rig = osc.build_rig(osc.load_scenario("ur5_wipe"))
        >>> controller, plant = rig.controller(), rig.plant()
        >>> tau = controller.tick(plant.measure(), rig.references.at(0.0))
        >>> print(expected_acceleration(controller).shape)
        (6,)
    """
    commanded = controller.joint_acceleration()
    work: Any = controller._records.work
    r = int(work.rank)
    if r == 0 or work.status == HELD or work.n_lost > 0:
        return commanded
    locked = int(work.locked)
    back = np.eye(6)  # from axes of which the arms lock the first
    for k in reversed(range(locked)):
        v = work.reflectors[k]
        back -= work.beta[k] * np.outer(v, v @ back)
    free = back[:, locked:]
    moves = work.joints.J_bar @ free
    inertia = work.Lambda[locked:, locked:] + moves.T @ (_dragged(controller) * moves.T).T
    push = (work.alpha_u[:r] - work.alpha_meas[:r]) @ work.pushed_t[:r]
    return commanded + np.asarray(moves @ np.linalg.solve(inertia, push[locked:]))


def _dragged(controller: Controller) -> Array:
    """(n,) what friction of the joints, as known so far, adds to their inertia while they swing."""
    dry, viscous = controller.joint_friction.T
    return np.asarray((viscous + dry / _SLOW) * _SWINGS)
