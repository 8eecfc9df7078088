"""What is judged of the sensors during a tick: whether motors, wrists, encoders, speeds agree.

Speeds of an approach may read too little; motor torques may contradict a wrist; encoders of several
arms may place the object that these hold at different places. The last two stop the arms.
"""

from __future__ import annotations

from math import sqrt

from osc_contact.law.arm_motion import place_point
from osc_contact.law.commands import pose_error
from osc_contact.law.jit import inner, leaf
from osc_contact.law.joint_friction import SPEED, V, observe_arm
from osc_contact.law.phases import APPROACHING, collect
from osc_contact.law.reasons import NO_REASON, declare_reason
from osc_contact.law.records import OTHER, contact_of
from osc_contact.law.vectors import clamped, dot3, dot6, minus3, origin, scaled, transformed

UNBALANCED = declare_reason(
    "UNBALANCED",
    59,
    "the motor torques of arm '{arm}' contradict its wrist by more than wrist_error = "
    "{safety.wrist_error:g} of their limits: the sensor's sign, scale, offset, frame or arm is "
    "wrong, or the masses of the links, or a joint rubs",
)
APART = declare_reason(
    "APART",
    60,
    "arm '{arm}' is more than closure_error = {closure_mm:g} mm away from where the others "
    "hold the object: an encoder is wrong, those of two arms are swapped, or a grasp has "
    "slipped",
)

_LAG = 0.02  #: s, of the low-pass of speeds of an approach
_AGREE = 0.2  #: of the speed of an approach, by which speeds may read less than positions show
_BALANCE = 0.04  #: s, of the low-pass of torques that nothing explains
_USUAL = 1.0  #: s in which an unexplained torque becomes the usual one
UNBALANCED_TIME = 0.1  #: s for which torques may be unexplained
_DOUBTFUL = 0.5  #: of their bound; nothing is learned of more, within the next
_DOUBTED = 0.2  #: s
_OUTLIER = 10.0  #: times their bound; no more of unexplained torques counts in one tick
_RUBBING = 2e-3  #: rad/s, m/s; joints that are faster than this rub
_RUBS = 0.5  #: of the friction that the model has, which may be wrong
_APART = 0.01  #: s for which arms may hold the object at different places


@inner
def compare_speeds(t):
    """Approaches use speeds from positions, low-passed, where NᵀV_rel is less than they show.

    Speeds that read too little would drive an object into its face ever faster. The twist that
    positions show is that from the last tick's X_WO to this one's.
    """
    memory = t.memory
    work = t.work
    dt = t.model.period * (1 + memory.gap)
    k = dt / (_LAG + dt)
    V = scaled(1.0 / dt, pose_error(work.X_WO, memory.X_WO))
    for a in range(work.rank):
        j = work.kept[a]
        row = memory.columns[j]
        speed = work.speed[a]
        if row.known == 0 or memory.compared == 0:
            row.velocity_from_positions = row.velocity_from_encoders = speed
            continue
        shown = dot6(work.columns[j].N, V) - work.V_N[a]
        row.velocity_from_positions += k * (shown - row.velocity_from_positions)
        row.velocity_from_encoders += k * (speed - row.velocity_from_encoders)
        short = row.velocity_from_positions - row.velocity_from_encoders
        approached = contact_of(t, j).phase == APPROACHING
        if approached and short > _AGREE * t.model.approach_speed:
            work.speed[a] = max(speed, row.velocity_from_positions)


@inner
def check_arms(t):
    """Whether motors, wrists and encoders of the arms fit together; a reason to stop.

    The residual of the motors less friction, of either sign, must stay within `wrist_error`
    of the torque limit, as far as it is not the usual one, and within twice that, see
    `joint_friction`.
    """
    model = t.model
    memory = t.memory
    dt = model.period * (1 + max(memory.gap, memory.wrench_age))
    apart = _find_apart(t)
    memory.apart = collect(memory.apart, dt, apart >= 0)
    if apart >= 0 and memory.apart > _APART:
        memory.culprit = apart
        return APART
    if memory.wrench_missing or memory.ticked == 0:
        return NO_REASON
    memory.balanced += 1
    memory.instant += int(dt / model.period + 0.5)
    for k in range(model.n_arms):
        if model.arms[k].sensor_joint >= 0 and _balance_arm(t, k, dt):
            memory.culprit = k
            return UNBALANCED
    return NO_REASON


@inner
def _balance_arm(t, k, dt):
    """Whether unexplained torques of arm k have been too large for too long, see `check_arms`.

    From half of their bound on they are doubtful: nothing is learned of them, until they have
    lasted for longer than a fault that is found.
    """
    arm = t.model.arms[k]
    own = t.memory.arms[k]
    found = False
    doubtful = False
    observe_arm(t, arm, t.work.arms[k], own.doubtful == 0.0 or own.doubtful > _DOUBTED, dt)
    first = 1.0 / t.memory.balanced  # low-passes begin as plain means
    fast = max(dt / (_BALANCE + dt), first)
    slow = max(dt / (_USUAL + dt), first)
    for j in range(arm.first, arm.sensor_joint + 1):
        known = t.memory.joints[j]
        joint = t.model.joints[j]
        if joint.motor < 0:
            continue
        most = t.model.wrist_error * joint.tau_max
        theta = joint.theta
        speed = abs(known.means[SPEED])
        most += _RUBS * (theta[0] + theta[1] * speed)  # this may be wrong
        if t.memory.friction_known[j]:
            theta = t.memory.friction[j].theta
        for i in range(3):  # slowly: a wrist that is wrong at once is not taken for friction
            known.trusted[i] += slow * (abs(theta[i]) - known.trusted[i])
        friction = known.trusted[0] + known.trusted[1] * speed + known.trusted[2] * abs(known.rate)
        least = _DOUBTFUL * most
        if known.means[V] * known.unexplained > _RUBBING * abs(known.unexplained):
            most *= 2.0  # it brakes the joint, as friction does that is not learned yet
        rest = known.residual - clamped(known.residual, friction)
        known.unexplained += fast * (clamped(rest, _OUTLIER * most) - known.unexplained)
        rest = known.unexplained
        known.usual += slow * (rest - known.usual)
        unusual = abs(rest - known.usual)
        doubtful = doubtful or unusual > least
        too_much = unusual > most or abs(rest) > 2.0 * most
        known.unbalanced = collect(known.unbalanced, dt, too_much)
        found = found or known.unbalanced > UNBALANCED_TIME
    own.doubtful = collect(own.doubtful, dt, doubtful)
    return found


@leaf
def _find_apart(t):
    """An arm whose tip is further from where the object has it than `closure_error`, or −1."""
    model = t.model
    X = t.work.X_WO
    apart = -1
    for k in range(model.n_arms if model.n_arms > 1 else 0):
        arm = model.arms[k]
        tip = place_point(t.work.joints[arm.tip_joint], arm.tip[9:])
        gap = transformed(minus3(origin(X), tip), X, arm.point)
        if arm.kind != OTHER and sqrt(dot3(gap, gap)) > model.closure_error:
            apart = k
    return apart
