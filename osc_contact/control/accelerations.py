"""Accelerations of the joints that are expected under the last torques and measured forces."""

from __future__ import annotations

import numpy as np

from osc_contact.control.controller import Controller
from osc_contact.law.records import HELD
from osc_contact.spatial import Array

_SLOW = 0.03  #: rad/s, m/s; joints that swing with a contact are not faster
_SWINGS = 0.01  #: s, 1/ω of contacts


def expected_acceleration(controller: Controller) -> Array:
    """Predict the joint accelerations (n,) after a tick (rad/s², m/s²), for a velocity estimate.

    The law commands η̇_c and assumes the contact forces α_u. If the measured forces α_meas differ
    from them, the object accelerates by η̇_c + (Λ_S + SᵀJ̄ᵀD J̄S)⁻¹SᵀN_μ(α_u − α_meas) instead; the
    second term follows oscillations of a contact. D (n, n) is the diagonal matrix of
    `_friction_inertia`: friction of the joints slows an oscillation as additional inertias of the
    joints would. The term is omitted if no contact is in N, if the tick was held, and near singular
    postures. Other accelerations by friction and model errors are not included; the velocity
    estimate has to track them.

    See docs/tuning.md#estimated-velocities.

    Args:
        controller: controller after a tick.

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
    # transposed product of the reflectors 1 − β v vᵀ: from locked axes to energy coordinates
    from_locked_axes = np.eye(6)
    for k in reversed(range(locked)):
        v = work.reflectors[k]
        from_locked_axes -= work.beta[k] * np.outer(v, v @ from_locked_axes)
    free_axes = from_locked_axes[:, locked:]
    J_bar_free = work.joints.J_bar @ free_axes  # J̄S
    friction = _friction_inertia(controller)
    # Λ_S + SᵀJ̄ᵀD J̄S
    inertia = work.Lambda[locked:, locked:] + J_bar_free.T @ (friction * J_bar_free.T).T
    push = (work.alpha_u[:r] - work.alpha_meas[:r]) @ work.pushed_t[:r]
    return commanded + np.asarray(J_bar_free @ np.linalg.solve(inertia, push[locked:]))


def _friction_inertia(controller: Controller) -> Array:
    """Express friction of the joints as an additional inertia (n,) (kg m², kg).

    A joint that oscillates with a contact at the time constant `_SWINGS` and the speed `_SLOW` is
    slowed by friction as by this inertia. The friction is the identified one, or the model's.
    """
    dry, viscous = controller.joint_friction.T
    return np.asarray((viscous + dry / _SLOW) * _SWINGS)
