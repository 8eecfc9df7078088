"""Force law: the force command of each contact from its desired and its measured force (fig. 5)."""

from __future__ import annotations

from math import inf

from osc_contact.law.commands import holds_at_zero
from osc_contact.law.jit import inner, leaf
from osc_contact.law.records import contact_of

_WINDUP = 1.5  #: bound of the force integral, as a multiple of the desired force
_LEAST = 0.1  #: largest floor of a force command, as a share of the desired force


@leaf
def integral_room(setting, desired):
    """Bound of a force integral: `_WINDUP` times the desired force, at least `setting`.

    Args:
        setting: setting `integral_force` (N).
        desired: desired force (N).

    Returns:
        Bound (N).
    """
    return max(_WINDUP * abs(desired), setting)


@leaf
def last_integral(t, a):
    """Return the force integral of a kept column (N) after the last tick.

    If nothing has changed it is `force_sum`. After a change of the active contacts (`by_column` is
    1) it is the sum of `integral` of all active columns, weighted by their `share` of the kept one.
    If only the number of kept columns has changed, since one became dependent, it is 0. Reads the
    fields named here and `force_rank`, of MEMORY and WORK.

    Args:
        t: Tick.
        a: index of the column among the kept ones.
    """
    memory = t.memory
    work = t.work
    if memory.by_column:
        s = 0.0
        for i in range(work.count):
            j = work.chosen[i]
            s += work.columns[j].share[a] * memory.columns[j].integral
        return s
    return memory.force_sum[a] if memory.force_rank == work.rank else 0.0


@inner
def command_force(t):
    """Evaluate the force law: fill the commanded forces α_u (N) of the kept columns.

        α_u = α_d + K_i ∫(α_d − α_meas) dt − K_v NᵀV_rel ≥ min(α_min, `_LEAST` α_d)

    α_d is the desired and α_meas (`felt`) the measured force (N), K_i (1/s) and K_v (N s/m) are
    gain and damping, NᵀV_rel (m/s) is the speed into the contact, α_min the least command. The
    magnitude of the integral is limited to `integral_force` (N) or `_WINDUP` |α_d|, whichever is
    larger. The second bound of the floor permits a force to rise from zero. Reads `alpha_d`,
    `felt`, `speed`, `gain`, `damping`, `least`. Fills `alpha_u` (N) and `force_next`, the integral
    after this tick (N).

    Args:
        t: Tick.
    """
    work = t.work
    for a in range(work.rank):
        desired = work.alpha_d[a]
        last_integral_a = last_integral(t, a)
        bound = integral_room(t.model.integral_force, desired)
        integral = last_integral_a + work.gain[a] * work.dt * (desired - work.felt[a])
        integral = min(max(integral, -bound), bound)
        force = desired + integral - work.damping[a] * work.speed[a]
        # at the floor the integral must not fall any further
        floor = min(work.least[a], _LEAST * desired)
        if force < floor:
            force = floor
            integral = max(integral, last_integral_a)
        work.alpha_u[a] = force
        work.force_next[a] = integral


@inner
def contact_laws(t):
    """Copy the settings of the force law from the contacts to the kept columns.

    Dependent columns all get the smallest gain, the largest damping and the largest brake of the
    active contacts, and no floor. Fills `gain` (1/s), `damping` (N s/m), `brake` κ (1/s) and
    `least`, the least command (N).

    Args:
        t: Tick.
    """
    work = t.work
    dependent = work.rank < work.count
    for a in range(work.rank):
        gain, damping, brake = column_law(t, work.kept[a])
        if dependent:
            for j in range(work.count):
                other_gain, other_damping, other_brake = column_law(t, work.chosen[j])
                gain = min(gain, other_gain)
                damping = max(damping, other_damping)
                brake = max(brake, other_brake)
        work.gain[a] = gain
        work.damping[a] = damping
        work.brake[a] = brake
        work.least[a] = -inf if dependent else contact_of(t, work.kept[a]).least


@leaf
def column_law(t, j):
    """Gain K_i (1/s), damping K_v (N s/m) and brake κ (1/s) of the force law of a column.

    Of a contact that holds without a desired force they are `hold_gain`, the contact's damping and
    `hold_brake`; its brake acts on the whole speed, not on the part that does not last. The loop of
    such a contact with play is stable for every stiffness between 0 and that of its walls.

    Args:
        t: Tick.
        j: index among all columns.

    Returns:
        K_i (1/s), K_v (N s/m) and κ (1/s).
    """
    law = contact_of(t, j)
    if holds_at_zero(t, j):
        return t.model.hold_gain, law.damping, t.model.hold_brake
    return law.gain, law.damping, law.brake
