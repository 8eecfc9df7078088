"""Which readings of joints are faulty, and with what the joints are braked then.

Where a joint's position and speed contradict one another, the one whose changes nothing else
predicts is faulty. A packet that is dead, or that of other joints, has no sound reading at all.
Positions and speeds that are not read, or faulty, are estimated from those that are sound.
"""

from __future__ import annotations

from osc_contact.law.agreement import UNBALANCED_TIME
from osc_contact.law.jit import inner
from osc_contact.law.records import FAULTY_POSITION, FAULTY_SPEED
from osc_contact.law.vectors import clamped

_GONE = 0.25  #: of `position_drift`; a joint must show so much of a speed that lasts
_SLOPE = 0.005  #: s, of the filter of a speed that only positions show
DEAD = 0.01  #: s of the very same readings after which a stuck joint is one of a dead packet
BLIND = 0.01  #: s without a sound reading from which on a joint cannot be braked


@inner
def isolate_joint(t, j):
    """Note which reading of joint j is faulty, where they were found to contradict one another.

    It is one that stands still while the other moves, or the one whose changes the commanded
    accelerations predict less. Speeds come from one estimator for all joints: where those of one
    are faulty, none is used any more.
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
        if dead or abs(known.surprise_v) > abs(known.surprise_q):
            for i in range(t.model.n_joints):
                if joint_memory[i].faulty == 0:
                    joint_memory[i].faulty = FAULTY_SPEED
        else:
            known.faulty = FAULTY_POSITION


@inner
def isolate_packet(t):
    """Note that no joint is read, where motors contradict a wrist while all joints stand still.

    The torque is more than friction takes: joints that read the very same for as long must move.
    """
    memory = t.memory
    for j in range(t.model.n_joints if memory.still > UNBALANCED_TIME else 0):
        memory.joints[j].faulty = FAULTY_POSITION | FAULTY_SPEED


@inner
def estimate_joints(t):
    """Positions and speeds of the joints from their sound readings, else by prediction.

    A position that is not read, or is faulty, is integrated from the speed; a speed that is not
    read, or is faulty, follows from positions and commanded accelerations. Without either both are
    predicted, and the joint cannot be braked reliably: `memory.unbraked`.
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
