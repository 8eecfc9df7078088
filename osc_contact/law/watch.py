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

_FULL = 0.99  #: share of its bound at which a force integral has reached it
_SHARE = 0.2  #: share of a command; a contact that reads less is lost
_LIGHT = 1.0  #: N; what is commanded less cannot be told from nothing
SURE = 0.0025  #: s of evidence, at the least, that one wrong sample does not bring about
#: a joint's time above its limit counts once more for each eighth of it that it is beyond it
_HASTE, _MOST = 8.0, 10.0
_OVERFORCE = 3.0  #: times the command; a contact that reads more is overloaded


@leaf
def watch_joints(t):
    """Joints above their speed limits for too long, or about to run into an end stop; a reason.

    A joint can stop within |q̇|(t_r + |q̇|/(2a)), t_r the time until the brakes are on. One that is
    beyond its end already is left alone: no braking helps there.
    """
    model = t.model
    memory = t.memory
    fast = -1
    near = -1
    times = 1.0
    for j in range(model.n_joints):
        x = t.input.q[j]
        speed = t.input.v[j]
        row = model.joints[j]
        if abs(speed) > times * row.speed_max:
            fast = j
            times = abs(speed) / row.speed_max
        rest = x + speed * (model.reaction + row.brake * abs(speed))
        if (rest > row.upper and x <= row.upper) or (rest < row.lower and x >= row.lower):
            near = j
    weight = 1 + int(_HASTE * min(times - 1.0, _MOST))
    ticks = 1 + memory.gap
    memory.overspeed = max(memory.overspeed + ticks * (weight if fast >= 0 else -1), 0)
    memory.ending = collect(memory.ending, ticks * model.period, near >= 0)
    if memory.ending > max(SURE, 1.5 * model.period):
        memory.culprit = near
        return NEAR_END
    if memory.overspeed > model.fast_ticks:
        memory.culprit = fast
        return OVERSPEED
    return NO_REASON


@inner
def watch_contacts(t):
    """Contacts that take too much power, that are lost, or overloaded; a reason.

    P = Σ α_k (NᵀV_rel)_k over what moves into its face. A contact is lost, or its sensor lies,
    where less than a fifth of its command is read (contact phases see to that where they are on,
    but it must be held again in time), or its force integral stands at its bound. It is overloaded
    above three times its command, or above `contact_force`, whichever is more.
    """
    model = t.model
    work = t.work
    memory = t.memory
    columns = t.work.columns
    power = 0.0
    reason = NO_REASON
    dt = model.period * (1 + memory.gap)
    for a in range(work.rank):
        alpha = work.alpha_meas[a]
        wanted = work.alpha_d[a]
        speed = work.speed[a]
        if alpha > 0.0 and speed > 0.0:
            power += alpha * speed
        row = t.memory.columns[columns[int(work.keep[a])].chosen]
        size = abs(wanted)
        missing = size > _LIGHT and (alpha if wanted > 0.0 else -alpha) < _SHARE * size
        missing = missing and model.phased == 0
        if memory.force_rank == work.rank:
            room = _FULL * integral_room(model.integral_force, wanted)
            missing = missing or abs(memory.force_sum[a]) > room
        fair = memory.state == RUN or memory.faults > 0
        row.underforce = collect(row.underforce, dt, missing and fair)
        most = max(_OVERFORCE * size, model.contact_force)
        row.overforce = collect(row.overforce, dt, abs(alpha) > most)
        if row.underforce > model.contact_loss_time or row.time_since_loss > model.regain_time:
            reason = CONTACT_LOST
        elif row.overforce > model.overforce_time:
            reason = OVERFORCE
        if reason != NO_REASON:
            memory.culprit = columns[int(work.keep[a])].chosen
            return reason
    memory.powered = collect(memory.powered, dt, power > model.contact_power)
    if memory.powered > max(SURE, 1.5 * model.period):
        return POWERED
    return NO_REASON


@leaf
def collect(seconds, dt, violated):
    """Seconds of evidence after one tick more.

    Args:
        seconds: so far. dt: period (s). violated: whether this tick speaks against it.
    """
    return seconds + dt if violated else max(seconds - dt, 0.0)
