"""Force law: the force command of each contact from its desired and its measured force (fig. 5)."""

from __future__ import annotations

from math import inf

from osc_contact.law.commands import holds_at_zero
from osc_contact.law.jit import inner, leaf
from osc_contact.law.phases import CLOSED
from osc_contact.law.records import contact_of

_WINDUP = 1.5  #: bound of the force integral, as a multiple of the desired force
_LEVELLING = 0.9  #: share of its bound to which the integral of one corner of a face may rise
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
    larger. The second bound of the floor permits a force to rise from zero. The columns of a face
    or an edge are commanded together (`_command_face`). Reads `alpha_d`, `felt`, `speed`, `gain`,
    `damping`, `least`. Fills `alpha_u` (N) and `force_next`, the integral after this tick (N).

    Args:
        t: Tick.
    """
    a = 0
    while a < t.work.rank:
        end = _end_of_face(t, a)
        if end == a + 1:
            _command_column(t, a)
        else:
            _command_face(t, a, end)
        a = end


@leaf
def _end_of_face(t, a):
    """Find the end of a run of kept columns that one pressing face or edge has, else a + 1.

    It presses if it is CLOSED, and a force is desired of each of its columns.

    Args:
        t: Tick.
        a: index of the first column of the run among the kept ones.

    Returns:
        The index behind its last column.
    """
    work = t.work
    c = t.model.columns[work.kept[a]].contact
    end = a + 1
    are_independent = work.rank == work.count  # else no column is that of one contact alone
    is_closed = t.memory.contacts[c].phase == CLOSED
    if t.model.bodies[c].face == 0 or not are_independent or not is_closed:
        return end
    presses = work.alpha_d[a] > 0.0
    while end < work.rank and t.model.columns[work.kept[end]].contact == c:
        presses = presses and work.alpha_d[end] > 0.0
        end += 1
    return end if presses else a + 1


@inner
def _command_column(t, a):
    """Evaluate the force law of one column by itself.

    Args:
        t: Tick.
        a: index of the column among the kept ones.
    """
    work = t.work
    desired = work.alpha_d[a]
    last_integral_a = last_integral(t, a)
    bound = integral_room(t.model.integral_force, desired)
    integral = last_integral_a + work.gain[a] * work.dt * (desired - work.felt[a])
    integral = min(max(integral, -bound), bound)
    force = desired + integral - work.damping[a] * work.speed[a]
    # at the floor the integral must not fall any further
    floor = _floor(t, a)
    if force < floor:
        force = floor
        integral = max(integral, last_integral_a)
    work.alpha_u[a] = force
    work.force_next[a] = integral


@leaf
def _floor(t, a):
    """Compute the least force command of a kept column (N): min(α_min, `_LEAST` α_d).

    Args:
        t: Tick, with `least` and `alpha_d`.
        a: index of the column among the kept ones.
    """
    return min(t.work.least[a], _LEAST * t.work.alpha_d[a])


@inner
def _command_face(t, first, end):
    """Evaluate the force law of a face or an edge, so that the sum of its forces is exact.

    The integrals are the sum of a common part, the integral of the mean error, and of deviations
    from it, whose sum is zero and which press the face flat. Where the face rests on one side
    forces of the others cannot be reached, and their deviations grow until a command is at its
    floor or an integral at `_LEVELLING` of its bound; there all deviations are reduced by the same
    factor. The centre of pressure that is commanded stays between the corners, and the sum of the
    commands does not change, as it would if each column had its own floor.

    Args:
        t: Tick.
        first: index of the first column among the kept ones.
        end: index behind the last one.
    """
    work = t.work
    n = end - first
    last = 0.0  # N, means of the last integrals, of the errors, of the desired forces and floors
    error = 0.0
    desired = 0.0
    least = 0.0
    for a in range(first, end):
        last += last_integral(t, a) / n
        error += (work.alpha_d[a] - work.felt[a]) / n
        desired += work.alpha_d[a] / n
        least += _floor(t, a) / n
    bound = integral_room(t.model.integral_force, desired)
    common = last + work.gain[first] * work.dt * error
    common = min(max(common, -bound), bound)
    if desired + common < least:  # at the floor the integral must not fall any further
        common = max(common, last)
    # deviations, and the largest share of them that floors and bounds permit
    share = 1.0
    for a in range(first, end):
        own = last_integral(t, a) - last
        own += work.gain[a] * work.dt * (work.alpha_d[a] - work.felt[a] - error)
        work.force_next[a] = own
        if own < 0.0:
            room = work.alpha_d[a] + common - _floor(t, a)
        else:
            room = _LEVELLING * integral_room(t.model.integral_force, work.alpha_d[a]) - common
        room = max(room, 0.0)
        if abs(own) > room:
            share = min(share, room / abs(own))
    for a in range(first, end):
        integral = common + share * work.force_next[a]
        force = work.alpha_d[a] + integral - work.damping[a] * work.speed[a]
        work.alpha_u[a] = max(force, _floor(t, a))
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
