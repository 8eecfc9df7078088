"""Consistency of motors, wrists, encoders and speeds, checked during a tick.

Speeds of an approach are compared with positions, motor torques with wrist readings, and the poses
of the object by the encoders of several arms with each other. Speeds of an approach that are too
small are replaced; contradictions of the other kinds stop the arms.
"""

from __future__ import annotations

from math import sqrt

from osc_contact.law.arm_motion import place_point, place_pose
from osc_contact.law.commands import pose_error
from osc_contact.law.friction_estimate import SPEED, V
from osc_contact.law.jit import inner, leaf, local
from osc_contact.law.joint_friction import observe_arm
from osc_contact.law.phases import APPROACHING, collect
from osc_contact.law.reasons import NO_REASON, declare_reason
from osc_contact.law.records import OTHER, RIGID, contact_of
from osc_contact.law.vectors import (
    clamped,
    dot3,
    dot6,
    minus3,
    origin,
    plus3,
    rotated9,
    scaled,
    transformed,
)

UNBALANCED = declare_reason(
    "UNBALANCED",
    59,
    "the motor torques of arm '{arm}' contradict its wrist by more than wrist_error = "
    "{safety.wrist_error:g} of their limits: the sensor's sign, scale, offset, frame or arm is "
    "wrong, or the masses of the links, or a joint rubs",
)
GAP_HORIZON = 0.1  #: s ahead for which the gap between arms is extrapolated by its rate
APART = declare_reason(
    "APART",
    60,
    "arm '{arm}' is more than closure_error = {closure_mm:g} mm away from where the others "
    f"hold the object, or moves so far away within {GAP_HORIZON:g} s: an encoder is wrong, those "
    "of two arms are swapped, or a grasp has slipped",
)

_LAG = 0.02  #: s, time constant of the low-pass of speeds of an approach
_AGREE = 0.2  #: largest deficit of an approach's speed, as a share of `approach_speed`
_BALANCE = 0.04  #: s, time constant of the low-pass of unexplained torques
_USUAL = 1.0  #: s, time constant of the mean of unexplained torques
UNBALANCED_TIME = 0.1  #: s for which unexplained torques may exceed their bound
_DOUBTFUL = 0.5  #: share of the bound above which unexplained torques suspend identification
_DOUBTED = 0.2  #: s, longest suspension
_OUTLIER = 10.0  #: largest unexplained torque of one tick, as a multiple of the bound
_RUBBING = 2e-3  #: rad/s, m/s, speed above which a joint has dry friction along its motion
_RUBS = 0.5  #: possible error of the modelled friction, as a share
APART_TIME = 0.01  #: s for which arms may place the object differently
_PARTING = 0.01  #: s, time constant of the low-pass of the rate of a gap
#: share of its part of the object's weight above which a stopped arm holds the object if no other
#: arm does, or if encoders place the arms apart
HEAVY = 0.5


@inner
def compare_speeds(t):
    """Replace the speeds of approaching contacts by those from positions where they are too small.

    The speed of a contact is NᵀV_rel (m/s): the twist V_rel of the object relative to the face,
    along the column N. An approach with speed sensors that read too little would accelerate towards
    its face. Too little is a deficit of more than `_AGREE` times `approach_speed`. The twist from
    positions is computed from the poses `X_WO` of the last tick and of this one; both speeds are
    low-passed. A column that was not in N in the last tick (`known` = 0) begins without a past.
    Changes `speed` (m/s) of the kept columns; fills `velocity_from_positions` and
    `velocity_from_encoders` (m/s) of the columns in MEMORY.

    Args:
        t: Tick.
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
        # both speeds, low-passed; a deficit of that from encoders is replaced
        speed_from_positions = dot6(work.columns[j].N, V) - work.V_N[a]
        row.velocity_from_positions += k * (speed_from_positions - row.velocity_from_positions)
        row.velocity_from_encoders += k * (speed - row.velocity_from_encoders)
        deficit = row.velocity_from_positions - row.velocity_from_encoders
        approached = contact_of(t, j).phase == APPROACHING
        if approached and deficit > _AGREE * t.model.approach_speed:
            work.speed[a] = max(speed, row.velocity_from_positions)


@inner
def check_arms(t):
    """Compare motors, wrists and encoders of the arms with each other.

    The residual of a motor, the torque that neither model nor wrist explains, less friction must
    stay near its long-term mean and near zero (`_balance_arm`). The arms must place the object
    alike (`is_apart`); a difference that lasts for more than `APART_TIME` stops them. Wrists are
    not compared in ticks without wrenches. Updates in MEMORY `apart` (s), `balanced` (number of
    ticks with this comparison), `instant` (the same, lost ticks included), and the fields of
    `measure_gap` and `_balance_arm`.

    Args:
        t: Tick after `solve_chain`.

    Returns:
        `NO_REASON`; `APART` or `UNBALANCED`, with the arm in `culprit` of MEMORY.
    """
    model = t.model
    memory = t.memory
    dt = model.period * (1 + max(memory.gap, memory.wrench_age))
    arm = _find_apart(t, model.period * (1 + memory.gap))  # −1: none
    memory.apart = collect(memory.apart, dt, arm >= 0)
    if arm >= 0 and memory.apart > APART_TIME:
        memory.culprit = arm
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
    """Update unexplained motor torques of an arm; return whether one is too large for too long.

    For each motor from the base to the wrist sensor, the unexplained torque is low-passed
    (`unexplained`) and compared with its long-term mean (`usual`): their difference must not exceed
    the bound of `_torque_bound`, the torque itself not twice that bound. The bound is doubled while
    the torque opposes the motion. Differences above half of the bound suspend the identification of
    friction for up to `_DOUBTED`, longer than the detection of a fault takes.

    Of the joints in MEMORY `residual` (torque that neither model nor wrist explains; N m, N) and
    `means` (low-passed speed, …) are updated first, with the other fields of `observe_arm`, among
    them the estimate of friction. Updates further `unexplained`, `usual` (N m, N), `rubbed` (mean
    magnitude of the residual in motion; N m, N), `slid` (s of motion), `trusted` (F, D, |A|) and
    `unbalanced` (s above the bound), and `doubtful` of the arm (s above half of the bound).

    Args:
        t: Tick.
        k: index of the arm.
        dt: time since the last computed tick with wrenches (s).

    Returns:
        True if the torque of a motor has exceeded its bound for `UNBALANCED_TIME`.
    """
    arm = t.model.arms[k]
    arm_memory = t.memory.arms[k]
    contradicts = False
    is_doubtful = False
    is_sound = arm_memory.doubtful == 0.0 or arm_memory.doubtful > _DOUBTED
    observe_arm(t, arm, t.work.arms[k], is_sound, dt)
    # shares of one tick in the low-passes, which begin as plain means
    first_share = 1.0 / t.memory.balanced
    fast_share = max(dt / (_BALANCE + dt), first_share)
    slow_share = max(dt / (_USUAL + dt), first_share)
    for j in range(arm.first, arm.sensor_joint + 1):
        if t.model.joints[j].motor < 0:
            continue
        row = t.memory.joints[j]
        bound = _torque_bound(t, j)
        friction = _trusted_friction(t, j, slow_share)
        doubtful_bound = _DOUBTFUL * bound
        if row.means[V] * row.unexplained > _RUBBING * abs(row.unexplained):
            bound *= 2.0  # the torque opposes the motion, like friction not identified yet
        _note_rubbing(row, fast_share, dt)
        deviation = _follow_unexplained(row, friction, bound, fast_share, slow_share)
        is_doubtful = is_doubtful or deviation > doubtful_bound
        exceeds = deviation > bound or abs(row.unexplained) > 2.0 * bound
        row.unbalanced = collect(row.unbalanced, dt, exceeds)
        contradicts = contradicts or row.unbalanced > UNBALANCED_TIME
    arm_memory.doubtful = collect(arm_memory.doubtful, dt, is_doubtful)
    return contradicts


@leaf
def _torque_bound(t, j):
    """Compute the bound of a joint's unexplained torque (N m, N).

    It covers errors of the wrist and of the modelled friction: `wrist_error` times the torque
    limit, plus the share `_RUBS` of the modelled friction F + D |s|, with Coulomb friction F,
    viscous friction D and the low-passed permitted speed s.

    Args:
        t: Tick.
        j: index of the joint, which has a motor.
    """
    joint = t.model.joints[j]
    coulomb = joint.theta[0]
    viscous = joint.theta[1]
    speed = abs(t.memory.joints[j].means[SPEED])
    bound = t.model.wrist_error * joint.tau_max
    bound += _RUBS * (coulomb + viscous * speed)
    return bound


@leaf
def _trusted_friction(t, j, share):
    """Update and compute the friction F + D |s| + |A q̈| of a joint (N m, N) that is trusted.

    F, D and |A| (Coulomb and viscous friction, inertia of the rotor beyond the model's) are
    `trusted` (3,) of the joint in MEMORY, which follows the identified θ, or the model's, so slowly
    that a sudden fault of the wrist is not attributed to friction. s is the low-passed permitted
    speed, q̈ the low-passed acceleration `rate`.

    Args:
        t: Tick; `trusted` is changed.
        j: index of the joint.
        share: share of this tick in the low-pass of `trusted`.
    """
    row = t.memory.joints[j]
    theta = t.model.joints[j].theta
    if t.memory.friction_known[j]:
        theta = t.memory.friction[j].theta
    for i in range(3):
        row.trusted[i] += share * (abs(theta[i]) - row.trusted[i])
    return row.trusted[0] + row.trusted[1] * abs(row.means[SPEED]) + row.trusted[2] * abs(row.rate)


@leaf
def _note_rubbing(row, share, dt):
    """Update the mean magnitude of a joint's residual in motion, and the time of motion.

    Args:
        row: JOINT_MEMORY, of which `rubbed` (N m, N) and `slid` (s) are changed while the joint is
            faster than `_RUBBING`.
        share: share of this tick in the mean.
        dt: time since the last computed tick with wrenches (s).
    """
    if abs(row.past_v) > _RUBBING:
        row.rubbed += share * (abs(row.residual) - row.rubbed)
        row.slid += dt


@leaf
def _follow_unexplained(row, friction, bound, fast_share, slow_share):
    """Update the unexplained torque u of a joint and its long-term mean m; return |u − m|.

    u is the low-passed part of the residual that exceeds ±`friction`, which counts with at most
    `_OUTLIER` bounds in each tick, so that a single wrong reading changes u by little.

    Args:
        row: JOINT_MEMORY, of which `residual` is read, and `unexplained` u and `usual` m are
            changed (N m, N).
        friction: friction that explains a residual (N m, N), ≥ 0.
        bound: bound of |u − m| (N m, N).
        fast_share: share of this tick in the low-pass of u.
        slow_share: share of this tick in the low-pass of m.
    """
    excess = row.residual - clamped(row.residual, friction)
    excess = clamped(excess, _OUTLIER * bound)
    row.unexplained += fast_share * (excess - row.unexplained)
    row.usual += slow_share * (row.unexplained - row.usual)
    return abs(row.unexplained - row.usual)


@inner
def _find_apart(t, dt):
    """Find an arm that places the object apart from the leader, by `is_apart`.

    The leader is an arm that holds the object rigidly. If there is none, an arm is found whose
    grasp point is apart from its place in the object. Reads `X_WO`, and R and p of the joints;
    updates `gap` and `parting` of the arms in MEMORY.

    Args:
        t: Tick.
        dt: time since the last computed tick (s).

    Returns:
        Index of the last such arm, or −1; −1 also for a single arm.
    """
    model = t.model
    deviating_arm = -1
    if model.n_arms == 1:
        return deviating_arm
    for k in range(model.n_arms):
        if k == model.leader:
            continue
        measure_gap(t, k, t.work.X_WO, dt)
        if is_apart(t, k):
            deviating_arm = k
    return deviating_arm


@inner
def measure_gap(t, k, X, dt):
    """Measure how far from its place in the object arm k is, and the rate of that.

    The larger one of two distances is measured: of the arm's grasp point from its place in the
    object at X; and, if both arms hold the object rigidly, of the leader's grasp point from the
    place where arm k has it, which shows a different rotation of the object, too. Updates `gap` (m)
    and `parting` (its rate, low-passed; m/s) of the arm in MEMORY.

    Args:
        t: Tick after `place_arm` of all arms.
        k: index of the arm, which is not the leader.
        X: (4, 4) pose of the object by the leader (the arm that holds it rigidly); if there is no
            leader, `X_WO` of WORK.
        dt: time since the last call (s).
    """
    row = t.memory.arms[k]
    gap = grasp_gap(t, k, X)
    if t.model.leader >= 0 and t.model.arms[k].kind == RIGID:
        gap = max(gap, leader_gap(t, k))
    if row.gap > 0.0:  # it has been measured before
        parting = row.parting + (gap - row.gap - row.parting * dt) / (_PARTING + dt)
        row.parting = parting if parting == parting else 0.0  # NaN does not last
    row.gap = gap


@leaf
def is_apart(t, k):
    """Determine whether the gap of arm k exceeds `closure_error` (m), or will after `GAP_HORIZON`.

    The gap is extrapolated by its rate, if it grows. An arm that has let go is accelerated by the
    torques that carried its part of the object, and the others by its missing ones: before it is
    `closure_error` away, contact forces have changed, and its light joints are fast.

    Args:
        t: Tick after `measure_gap`.
        k: index of the arm, which is not the leader.
    """
    row = t.memory.arms[k]
    return row.gap + GAP_HORIZON * max(row.parting, 0.0) > t.model.closure_error


@leaf
def grasp_gap(t, k, X):
    """Compute the distance (m) of arm k's grasp point from its place in the object at a pose X.

    The grasp point is the origin of the tip; the object has it at `point` of the arm. The distance
    is zero for grasps of the kind OTHER, whose point may move.

    Args:
        t: Tick, of which R and p of the joints are read.
        k: index of the arm.
        X: (4, 4) pose of the object.
    """
    arm = t.model.arms[k]
    tip = place_point(t.work.joints[arm.tip_joint], arm.tip[9:])
    gap = transformed(minus3(origin(X), tip), X, arm.point)
    return sqrt(dot3(gap, gap)) if arm.kind != OTHER else 0.0


@inner
def leader_gap(t, k):
    """Compute the distance (m) of the leader's grasp point from its place by the tip of arm k.

    Both arms hold the object rigidly, so that the leader's grasp point has a fixed position in the
    tip of arm k.

    Args:
        t: Tick, of which R and p of the joints are read.
        k: index of the arm, which holds the object rigidly.
    """
    model = t.model
    arm = model.arms[k]
    leader = model.arms[model.leader]
    X = local(4, 4)
    place_pose(t.work.joints[arm.tip_joint], arm.tip, X)
    expected = plus3(rotated9(arm.X_TO, leader.point), arm.X_TO[9:])
    tip = place_point(t.work.joints[leader.tip_joint], leader.tip[9:])
    gap = transformed(minus3(origin(X), tip), X, expected)
    return sqrt(dot3(gap, gap))


@leaf
def weight_share(t):
    """Compute the weight of the object divided by the number of arms (N).

    Args:
        t: Tick.
    """
    return t.model.principal[0] * sqrt(dot3(t.model.gravity, t.model.gravity)) / t.model.n_arms
