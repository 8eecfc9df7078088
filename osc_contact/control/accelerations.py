"""Accelerations of the joints that are expected under the last torques and measured forces."""

from __future__ import annotations

import numpy as np

from osc_contact.control.controller import Controller
from osc_contact.law.records import HELD
from osc_contact.spatial import Array

_SLOW = 0.03  #: rad/s, m/s; joints that swing with a contact are not faster
_SWINGS = 0.01  #: s, 1/ω of contacts


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
    work = controller.records.work
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
