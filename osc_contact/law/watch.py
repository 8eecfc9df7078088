"""What a robot must not go on with: joints too fast or near their ends, forces out of hand.

Each rule looks at a tick that could be computed, before its torques are worked out. A reason that
it finds stops the arms, see `safety`. Rules about forces and speeds collect seconds of evidence:
what speaks against them takes it away at the same pace, so that neither a knock nor one wrong
sample stops a robot, and bouncing does.
"""

from __future__ import annotations

from osc_contact.law.force import integral_room
from osc_contact.law.jit import inner, leaf
from osc_contact.law.tables import (
    CONTACT_LOST,
    NEAR_END,
    NO_REASON,
    OVERFORCE,
    OVERSPEED,
    POWERED,
    RUN,
)

__all__ = ["SURE", "watch_contacts", "watch_joints"]

_FULL = 0.99  #: share of its bound at which a force integral has reached it
_SHARE = 0.2  #: share of a command; a contact that reads less is lost
_LIGHT = 1.0  #: N; what is commanded less cannot be told from nothing
SURE = 0.0025  #: s of evidence, at the least, that one wrong sample does not bring about
#: a joint's time above its limit counts once more for each eighth of it that it is beyond it
_HASTE, _MOST = 8.0, 10.0
_OVERFORCE = 3.0  #: times the command; a contact that reads more is overloaded


@leaf
def watch_joints(chain, table, memory, q, v):
    """Joints above their speed limits for too long, or about to run into an end stop; a reason.

    A joint can stop within |q̇|(t_r + |q̇|/(2a)), t_r the time until the brakes are on. One that is
    beyond its end already is left alone: no braking helps there.

    Args:
        q, v: (n,) positions and speeds.
    """
    fast, near, times = -1, -1, 1.0
    for j in range(chain.n_joints):
        x, speed, row = q[j], v[j], table[j]
        if abs(speed) > times * row.speed_max:
            fast, times = j, abs(speed) / row.speed_max
        rest = x + speed * (chain.reaction + row.brake * abs(speed))
        if (rest > row.upper and x <= row.upper) or (rest < row.lower and x >= row.lower):
            near = j
    weight = 1 + int(_HASTE * min(times - 1.0, _MOST))
    ticks = 1 + memory.gap
    memory.overspeed = max(memory.overspeed + ticks * (weight if fast >= 0 else -1), 0)
    memory.ending = collect(memory.ending, ticks * chain.period, near >= 0)
    if memory.ending > max(SURE, 1.5 * chain.period):
        memory.culprit = near
        return NEAR_END
    if memory.overspeed > chain.fast_ticks:
        memory.culprit = fast
        return OVERSPEED
    return NO_REASON


@inner
def watch_contacts(chain, work, memory, columns, column_memory):
    """Contacts that take too much power, that are lost, or overloaded; a reason.

    P = Σ α_k (NᵀV_rel)_k over what moves into its face. A contact is lost, or its sensor lies,
    where less than a fifth of its command is read (contact phases see to that where they are on,
    but it must be held again in time), or its force integral stands at its bound. It is overloaded
    above three times its command, or above `contact_force`, whichever is more.
    """
    power, reason, dt = 0.0, NO_REASON, chain.period * (1 + memory.gap)
    for a in range(work.rank):
        alpha, wanted, speed = work.alpha_meas[a], work.alpha_d[a], work.speed[a]
        if alpha > 0.0 and speed > 0.0:
            power += alpha * speed
        row = column_memory[columns[int(work.keep[a])].chosen]
        size = abs(wanted)
        missing = size > _LIGHT and (alpha if wanted > 0.0 else -alpha) < _SHARE * size
        missing = missing and chain.phased == 0
        if memory.force_rank == work.rank:
            room = _FULL * integral_room(chain.integral_force, wanted)
            missing = missing or abs(memory.force_sum[a]) > room
        fair = memory.state == RUN or memory.faults > 0
        row.underforce = collect(row.underforce, dt, missing and fair)
        most = max(_OVERFORCE * size, chain.contact_force)
        row.overforce = collect(row.overforce, dt, abs(alpha) > most)
        if row.underforce > chain.contact_loss_time or row.astray > chain.regain_time:
            reason = CONTACT_LOST
        elif row.overforce > chain.overforce_time:
            reason = OVERFORCE
        if reason != NO_REASON:
            memory.culprit = columns[int(work.keep[a])].chosen
            return reason
    memory.powered = collect(memory.powered, dt, power > chain.contact_power)
    if memory.powered > max(SURE, 1.5 * chain.period):
        return POWERED
    return NO_REASON


@leaf
def collect(seconds, dt, amiss):
    """Seconds of evidence after one tick more.

    Args:
        seconds: so far. dt: period (s). amiss: whether this tick speaks against it.
    """
    return seconds + dt if amiss else max(seconds - dt, 0.0)
