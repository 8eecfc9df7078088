"""Isolation of faulty joint readings, and estimates of joint states from the sound ones.

If position and speed of a joint contradict each other, the reading whose changes the commanded
accelerations predict less is faulty. A packet that repeats itself or belongs to other joints has no
sound readings. Missing and faulty positions and speeds are estimated from sound readings.
"""

from __future__ import annotations

from osc_contact.law.agreement import UNBALANCED_TIME
from osc_contact.law.jit import inner
from osc_contact.law.records import FAULTY_POSITION, FAULTY_SPEED
from osc_contact.law.vectors import clamped

_GONE = 0.25  #: share of `position_drift` by which a lasting speed must change the position
_SLOPE = 0.005  #: s, time constant of the speed estimate from positions
_DRAWN = 0.2  #: share of the positions' error at which an estimated speed is faulty
DEAD = 0.01  #: s of identical readings of all joints after which the whole packet is dead
BLIND = 0.01  #: s without a sound reading after which a joint cannot be braked


@inner
def isolate_joint(t, j):
    """Mark the faulty reading of joint j, whose position and speed contradict each other.

    A reading that is constant while the other one changes is faulty; otherwise the one whose
    changes the commanded accelerations have predicted less, on average over the last half second.
    Speeds that are estimated from positions are drawn towards the predictions, and are faulty at
    `_DRAWN` times the error of the position. Speeds of all joints come from the same estimator, so
    all are marked if that of one joint is faulty.
    """
    joint_memory = t.memory.joints
    known = joint_memory[j]
    most = _GONE * t.model.position_drift
    stuck = abs(known.due) > most or known.stuck != 0
    dead = known.same_speed > DEAD and (stuck or abs(known.moved) > most)
    if stuck:
        known.faulty |= FAULTY_POSITION
        if dead or t.memory.derived:
            known.faulty |= FAULTY_SPEED
    elif known.faulty == 0:
        of_speed = known.blame > 0.0
        if t.memory.derived:
            of_speed = abs(known.surprise_v) > _DRAWN * abs(known.surprise_q)
        if dead or of_speed:
            for i in range(t.model.n_joints):
                if joint_memory[i].faulty == 0:
                    joint_memory[i].faulty = FAULTY_SPEED
        else:
            known.faulty = FAULTY_POSITION


@inner
def isolate_packet(t):
    """Mark all readings of joints as faulty if they are constant while motors contradict a wrist.

    The unexplained torque exceeds friction, so the joints must move although their readings have
    been identical for `UNBALANCED_TIME`.
    """
    memory = t.memory
    for j in range(t.model.n_joints if memory.still > UNBALANCED_TIME else 0):
        memory.joints[j].faulty = FAULTY_POSITION | FAULTY_SPEED


@inner
def estimate_joints(t):
    """Estimate positions and speeds of the joints (`q`, `v` of MEMORY) from sound readings.

    A missing or faulty position is integrated from the speed; a missing or faulty speed is
    estimated from positions and commanded accelerations. Without either reading both are predicted,
    and the joint cannot be braked reliably; `unbraked` of MEMORY is set to such a joint, or −1.
    """
    model = t.model
    table = model.joints
    memory = t.memory
    dt = model.period
    memory.unbraked = -1
    for j in range(model.n_joints):
        known = memory.joints[j]
        use_q = known.faulty & FAULTY_POSITION == 0
        use_v = known.faulty & FAULTY_SPEED == 0
        seen_q = use_q and known.unread_q == 0
        seen_v = use_v and known.unread_v == 0
        v = memory.v[j] + known.acceleration * dt
        if memory.ticked == 0:
            memory.q[j] = known.q
            v = 0.0
        if seen_v:
            v = known.v
        elif seen_q:
            slope = (known.q - memory.q[j]) / dt
            v += (slope - v) * dt / (_SLOPE + dt)
        v = clamped(v, model.plausible_speed * table[j].rated)
        memory.q[j] = known.q if seen_q else memory.q[j] + v * dt
        memory.v[j] = v
        blind_q = not use_q or known.unread_q * dt > BLIND
        blind_v = not use_v or known.unread_v * dt > BLIND
        if blind_q and blind_v and table[j].motor >= 0:
            memory.unbraked = j
