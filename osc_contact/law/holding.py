"""Braking and holding of arms by joint torques, without the control law.

The torques of each arm carry the arm and its share of the object, and brake it in proportion to the
joint-space inertia of both. An arm whose wrist has almost no load for `LET_GO_TIME` is assumed to
have let go of the object; then the other arms carry it, and this arm is braked up to twice as fast.
"""

from __future__ import annotations

from math import isfinite, sqrt

from osc_contact.law.agreement import (
    APART_TIME,
    HEAVY,
    UNBALANCED,
    is_apart,
    measure_gap,
    weight_share,
)
from osc_contact.law.arm_motion import (
    move_arm,
    place_arm,
    place_frame,
    place_point,
    place_pose,
    turn_axes,
)
from osc_contact.law.jit import inner, leaf, local
from osc_contact.law.phases import collect, slew
from osc_contact.law.plausibility import OUT_OF_RANGE
from osc_contact.law.probing import probe_joints
from osc_contact.law.reading import read_wrist
from osc_contact.law.records import BALL, BRAKED, HINGE, NOISY, SAFE_STOP, SETTLED
from osc_contact.law.vectors import (
    ZERO,
    ZERO_3,
    add,
    add3,
    angular,
    clamped,
    cross,
    dot3,
    dot6,
    fill,
    fill3,
    join,
    linear,
    minus3,
    origin,
    plus3,
    rotated,
    rotated9,
    rotated_back,
    scaled3,
    transformed,
    velocity_at,
)
from osc_contact.law.wrist_readings import WRIST_FROZEN, WRIST_SATURATED

_AT_REST = 0.02  #: rad/s, m/s, speed below which a braked joint counts as at rest
_BRAKING = 0.3  #: s, longest time of braking until the joints are held
_LEAST = 0.1  #: least share of the braking torques where motors can hardly carry the arm
BRAKE_RATE = 40.0  #: 1/s, rate of the torques of a hold, as a multiple of their limits
_HASTE = 4.0  #: factor of that rate if a joint is above its speed limit
_LIGHT = 0.25  #: share of its part of the object's weight below which an arm has let go
LET_GO_TIME = 0.02  #: s for which the load has to be below that share until an arm has let go
#: s that are enough where encoders place the arm and the object apart: joints that carried much
#: more than their own inertia swing meanwhile, on `workcell` with a period of 16 ms
_AWAY_TIME = 0.005
_FASTER = 2.0  #: factor of `hold_rate` of an arm that has let go
_SOFTER = 0.5  #: factor of `hold_rate` where speeds are estimated from noisy encoders
#: share of the ceiling of its wrist above which what presses on a stopped arm moves its hold, and
#: time constant of this motion (s): 0.2 rad/s move the hold by 10 mrad behind the joint
_PRESSED = 0.5
_YIELDING = 0.05
_LOAD_LAG = 0.02  #: s, time constant of the low-pass of the load of a wrist


@inner
def hold_posture(t):
    """Compute torques that brake the arms and hold them, without the control law.

        τ = h + M(−2ω q̇ − ω²(q − q_hold)) + Jᵀw

    h (n,) is the torque of velocities and gravity, M (n, n) the joint-space inertia of an arm, ω =
    `hold_rate` (1/s), q and q̇ positions and speeds of the joints, q_hold the positions where they
    are held, J the Jacobian, and w the wrench for each arm's share of the object's weight and
    inertia. Where q̇ is estimated from noisy encoders, with the bandwidth `hold_rate`, ω is half of
    that: a hold as fast as the estimate oscillates, and a faster estimate returns the noise. An arm
    that has let go of the object is braked and held with up to 2 `hold_rate` (see `_hold_rate`).

    While joints are braked, q_hold moves with them, at most by the braking distance; a joint beyond
    it is pushed by an error of the modelled weight or by an object that another arm has let go of.
    No acceleration is commanded to joints without a motor, which would drive others through the
    object. If motors cannot exert the braking torques, these are reduced (`_split_torques`), and
    q_hold follows the joints, so that the torques dissipate energy. Torques move in a straight line
    from the last ones, at `BRAKE_RATE`, or faster if a joint is above its speed limit or motors
    cannot exert the braking torques; those of an arm that has let go on a line of their own, at
    `torque_rate`. What presses on the wrist of a single arm, beyond a bound, moves q_hold
    (`_yield_holds`).

    Reads q and v of MEMORY. Fills `tau` (N m, N) and `step` (their largest changes) of the motors,
    `torques` of MEMORY with the same, and of the joints in MEMORY `hold`, `acceleration`, `driven`;
    of the arms the evidence of `_weigh` and `_compare_places`, and `released` in the first tick of
    a hold; and the fields of `_move_holds`, `_observe_arms` and `_count_holding`.

    Args:
        t: Tick that was not computed, after `estimate_joints`.
    """
    model = t.model
    work = t.work
    memory = t.memory
    is_first = memory.settled == 0
    if memory.settled != SETTLED:
        _move_holds(t)  # q_hold of the joints follows their motion
    _observe_arms(t)
    # the object's weight, and the number of arms among which it is divided
    R = local(3, 3)
    centre = local(3)
    weight = local(6)
    world = local(3)
    fill3(world, ZERO_3)
    object_is_known = _carry_weight(t, R, centre, weight)
    _yield_holds(t, weight)
    n_holding = _count_holding(t)
    rate_limit = _rate_limit(t)
    # torques of each arm, with its share of the object if it holds it
    for k in range(model.n_arms):
        arm = model.arms[k]
        has_let_go = n_holding < model.n_arms and memory.arms[k].let_go != 0
        object_share = 1.0 / n_holding if object_is_known and not has_let_go else 0.0
        _command_braking(t, arm, _hold_rate(t, has_let_go))
        share = _split_torques(t, arm, object_share, R, centre, weight)
        probe_joints(t, arm, k, world)
        rate = rate_limit if share == 1.0 else min(_HASTE * BRAKE_RATE, model.torque_rate)
        _set_torques(t, arm, share, rate)
        if is_first:
            _note_release(t, k)
        if has_let_go and memory.ticked != 0:
            _move_alone(t, arm)
    slew(work.tau, memory.torques, work.step, memory.ticked != 0)


@inner
def _observe_arms(t):
    """Compute kinematics and bias torques of all arms, and detect whether they have let go.

    Both are those at the estimated q and q̇ of MEMORY; wrenches are at the world's origin. Fills
    the fields of `place_arm` and `move_arm` of the joints in WORK, among them `h` (torques of
    velocities and gravity) and M, and the evidence of `_compare_places` and `_weigh`.

    Args:
        t: Tick.
    """
    model = t.model
    memory = t.memory
    origin_of_world = local(3)
    twist = local(6)
    drift = local(6)
    outboard = local(6)  # a result of `move_arm` that is not needed
    X = local(4, 4)  # of the object
    fill3(origin_of_world, ZERO_3)
    for k in range(model.n_arms):
        place_arm(t, model.arms[k], memory.q)
    _compare_places(t, X)
    for k in range(model.n_arms):
        fill(outboard, ZERO)
        move_arm(t, model.arms[k], memory.v, origin_of_world, twist, drift, outboard)
        _weigh(t, k, origin_of_world)


@leaf
def _rate_limit(t):
    """Compute the largest rate of the torques of a hold (1/s, as a multiple of their limits).

    It is `BRAKE_RATE`, or `_HASTE` times that if a joint is above its speed limit, and at most
    `torque_rate`.

    Args:
        t: Tick.
    """
    rate = BRAKE_RATE
    for j in range(t.model.n_joints):
        if abs(t.memory.v[j]) > t.model.joints[j].speed_max:
            rate = _HASTE * BRAKE_RATE
    return min(rate, t.model.torque_rate)


@leaf
def _hold_rate(t, has_let_go):
    """Compute the rate ω (1/s) with which the joints of an arm are braked and held.

    It is `hold_rate`; with noisy encoders `_SOFTER` times that. An arm that has let go of the
    object is braked `_FASTER` times as fast, or less so that the damping 2ω reduces a speed by at
    most a fifth in each tick, but not slower than `hold_rate`: its inertia is only its own, and its
    light joints may be fast, because until then they were driven by torques for both.

    Args:
        t: Tick.
        has_let_go: whether the arm has let go of the object.
    """
    model = t.model
    if t.memory.derived == NOISY:
        return _SOFTER * model.hold_rate
    if has_let_go:
        return min(_FASTER * model.hold_rate, max(model.hold_rate, 0.1 / model.period))
    return model.hold_rate


@leaf
def _command_braking(t, arm, omega):
    """Fill `acceleration` of an arm's joints, −2ω q̇ − ω²(q − q_hold), which brakes and holds them.

    q and q̇ are the estimated positions and speeds of MEMORY, q_hold = `hold` the positions where
    the joints are held (rad, m). ω|q − q_hold| counts at most as the speed limit v_max of the joint
    (rad/s, m/s), so that a joint returns from afar at half of v_max. Joints without a motor get 0.

    Args:
        t: Tick.
        arm: ARM row.
        omega: rate ω (1/s).
    """
    memory = t.memory
    for j in range(arm.first, arm.end):
        restoring = omega * (memory.q[j] - memory.joints[j].hold)
        restoring = clamped(restoring, t.model.joints[j].rated)
        has_motor = t.model.joints[j].motor >= 0
        acceleration = -omega * (2.0 * memory.v[j] + restoring) if has_motor else 0.0
        t.work.joints[j].acceleration = acceleration


@inner
def _set_torques(t, arm, share, rate):
    """Set torques, their largest steps and the commanded accelerations of an arm that is braked.

    Fills `tau` and `step` of the motors (N m, N), and of the joints in MEMORY `acceleration`
    (rad/s², m/s²), `driven` and, if braking torques are reduced, `hold` (rad, m). `driven` is 0:
    nothing shows that a joint must move, so a constant position counts as one at rest, not as a
    fault. A motor whose torque is not finite keeps the last one, without a reason of its own: the
    tick was not computed anyway.

    Args:
        t: Tick, with the torques of `_split_torques` in `tau` (carrying) and `rest` (braking) of
            the joints, and `acceleration`, which `rest` gives them.
        arm: ARM row.
        share: part of the braking torques that the motors can exert; below 1 the positions to be
            held follow the joints.
        rate: largest rate of the torques (1/s, in torque limits).
    """
    model = t.model
    memory = t.memory
    work = t.work
    joints = work.joints
    for j in range(arm.first, arm.end):
        memory.joints[j].acceleration = share * joints[j].acceleration
        memory.joints[j].driven = 0  # friction or an error of its weight may keep it at rest
        if share < 1.0:
            memory.joints[j].hold = memory.q[j]
        motor = model.joints[j].motor
        limit = model.joints[j].tau_max
        if motor >= 0:
            torque = min(max(joints[j].tau + share * joints[j].rest, -limit), limit)
            work.tau[motor] = torque if isfinite(torque) else memory.torques[motor]
            work.step[motor] = rate * model.period * limit


@leaf
def _note_release(t, k):
    """Determine whether a hold releases a motor of arm k; fill `released` of the arm in MEMORY.

    It does if it changes the motor's torque by more than a wrong wrist may hide (`wrist_error`
    times the limit) and dry friction holds. Then the arm moves: before, the motor accelerated it,
    or pressed it on a contact, which yields.

    Args:
        t: Tick in which a hold begins, of which `tau` of WORK is the torque of the hold, and
            `torques` of MEMORY the last one before it (N m, N).
        k: index of the arm.
    """
    arm = t.model.arms[k]
    released = 0
    for j in range(arm.first, arm.end):
        joint = t.model.joints[j]
        if joint.motor >= 0:
            friction = max(joint.theta[0], t.memory.joints[j].trusted[0])
            change = abs(t.work.tau[joint.motor] - t.memory.torques[joint.motor])
            if change > t.model.wrist_error * joint.tau_max + friction:
                released = 1
    t.memory.arms[k].released = released


@leaf
def _move_alone(t, arm):
    """Move the torques of an arm that has let go straight to their new values, at `torque_rate`.

    They carried and braked a part of the object, which would accelerate the arm's own inertia while
    they fall. The arm is not coupled to the others any more: neither limits the changes of the
    other. Changes `tau` of WORK and `torques` of MEMORY (N m, N) of its motors, which become equal.

    Args:
        t: Tick after a computed one.
        arm: ARM row.
    """
    joints = t.model.joints
    tau = t.work.tau
    last = t.memory.torques
    share = 1.0
    for j in range(arm.first, arm.end):
        motor = joints[j].motor
        if motor >= 0:
            step = t.model.torque_rate * t.model.period * joints[j].tau_max
            share = max(share, abs(tau[motor] - last[motor]) / step)
    for j in range(arm.first, arm.end):
        motor = joints[j].motor
        if motor >= 0:
            last[motor] += (tau[motor] - last[motor]) / share
            tau[motor] = last[motor]


@inner
def _move_holds(t):
    """Move the held positions of braked joints to where they are, at most by the braking distance.

    The braking distance |q̇| `reaction` (`way`; rad, m) is counted from the position where the hold
    began (`begun`). Sets `hold` (rad, m) of the joints in MEMORY, and `settled`: SETTLED when all
    joints are at rest, or have been braked for `_BRAKING`, else BRAKED.

    Args:
        t: Tick; `settled` of MEMORY is 0 in the first tick of a hold.
    """
    model = t.model
    memory = t.memory
    is_moving = False
    for j in range(model.n_joints):
        row = memory.joints[j]
        speed = abs(memory.v[j])
        if memory.settled == 0:
            row.begun = memory.q[j]
            row.probed = 0.0  # see `probing`
            row.way = speed * model.reaction
        is_moving = is_moving or speed > _AT_REST
        row.hold = row.begun + clamped(memory.q[j] - row.begun, row.way)
    is_braking = is_moving and memory.age * model.period < _BRAKING
    memory.settled = BRAKED if is_braking else SETTLED


@inner
def _yield_holds(t, weight):
    """Move the held positions of a single arm towards its joints while something presses on it.

    The hold is a spring: what moves its joints away presses as hard as they are away. In contact,
    an encoder that drifts, from which speeds are estimated, reads the same: the arm follows the
    drift, and presses harder the longer it lasts. So the hold follows the joints while the wrist's
    load, beside the object's weight, exceeds `_PRESSED` times its ceiling. A wrist that has stopped
    the arms by its reading is no evidence, nor one that is not read.

    Args:
        t: Tick after `_observe_arms`, of which `load` (3,; N) of the arm in MEMORY is read and
            `hold` of the joints is changed (rad, m).
        weight: (6,) wrench that carries the object (N, N m).
    """
    model = t.model
    memory = t.memory
    row = memory.arms[0]
    is_held = memory.state == SAFE_STOP and memory.settled == SETTLED and row.weighed != 0
    if model.n_arms != 1 or not is_held or memory.wrench_age + memory.old_wrists > 0:
        return
    cause = memory.cause
    if cause in (UNBALANCED, WRIST_FROZEN, WRIST_SATURATED, OUT_OF_RANGE):
        return
    ceiling = max(model.wrist_ceiling, model.wrist_headroom * memory.largest_sum)
    force = minus3(row.load, linear(weight))
    bound = _PRESSED * ceiling
    if dot3(force, force) <= bound * bound:
        return
    share = model.period / (_YIELDING + model.period)
    for j in range(model.n_joints):
        joint_memory = memory.joints[j]
        joint_memory.hold += share * (memory.q[j] - joint_memory.hold)


@inner
def _count_holding(t):
    """Count the arms that hold the object, without stopped arms that have let go of it.

    If all arms have let go (`let_go` of MEMORY), all count as holding, because contacts may carry
    the object; unless the wrist of the arm with the largest load bears more than `HEAVY` times its
    share of the weight. Then this arm holds the object: its `let_go` is revoked and its `holds`
    set. Before a stop, and of a single arm, all arms count. Reads `state` of MEMORY, and `load` of
    the arms (3,; N).

    Args:
        t: Tick.
    """
    model = t.model
    n = model.n_arms
    n_holding = n
    if t.memory.state == SAFE_STOP and model.held and n > 1:
        heaviest = 0
        largest_square = 0.0
        for k in range(n):
            row = t.memory.arms[k]
            n_holding -= row.let_go
            square = dot3(row.load, row.load)
            if square > largest_square:
                heaviest = k
                largest_square = square
        if n_holding == 0 and sqrt(largest_square) > HEAVY * weight_share(t):
            t.memory.arms[heaviest].let_go = 0
            t.memory.arms[heaviest].holds = 1
            n_holding = 1
    return n_holding if n_holding > 0 else n


@inner
def _compare_places(t, X):
    """Accumulate the time for which a stopped arm places the object apart from the leader.

    The leader is an arm that holds the object rigidly; `is_apart` determines whether an arm is
    apart from it. Updates in MEMORY `apart` (s: time in which any arm is, less time in which none
    is), and `gap` and `parting` of the arms. Nothing is done before a stop, for a single arm, or
    without a leader.

    Args:
        t: Tick after `place_arm` of all arms.
        X: (4, 4), filled with the pose of the object by the arm that holds it rigidly.
    """
    model = t.model
    memory = t.memory
    if memory.state != SAFE_STOP or model.n_arms == 1 or model.leader < 0:
        return
    place_pose(t.work.joints[model.arms[model.leader].tip_joint], model.X_LO, X)
    any_apart = False
    for k in range(model.n_arms):
        if k != model.leader:
            measure_gap(t, k, X, model.period)
            any_apart = any_apart or is_apart(t, k)
    memory.apart = collect(memory.apart, model.period, any_apart)


@inner
def _weigh(t, k, world):
    """Low-pass the load on the wrist of a stopped arm k, and judge by it whether it has let go.

    The load f is the force by which the gripper carries the object: the reading F less weight and
    inertial force of the gripper, F + m g − ṗ with its mass m, gravity g (3,; m/s²) and momentum p.
    The low-pass of F + m g and of p with the time constant T = `_LOAD_LAG`

        s ← s + dt/(T + dt) (F + m g + p/T − s),   f = s − p/T

    gives the low-pass f of the load without a difference of speeds.

    Fills `load` (3,; f) and `weighing` (3,; s), both in N, `weighed`, and what `_judge_load` fills,
    of the arm in MEMORY. At the first call after a stop `let_go`, `holds` and `light` are reset.

    Args:
        t: Tick after `move_arm` and `_compare_places`.
        k: index of the arm.
        world: (3,) origin of the world, reference point of the wrenches.
    """
    model = t.model
    memory = t.memory
    arm = model.arms[k]
    row = memory.arms[k]
    if arm.sensor_joint < 0 or memory.state != SAFE_STOP:
        return
    joint = t.work.joints[arm.sensor_joint]
    wrench = read_wrist(memory.wrenches[k], joint, arm.sensor, world)
    share = model.period / (_LOAD_LAG + model.period) if row.weighed else 1.0
    if row.weighed == 0:
        row.let_go = row.holds = 0
        row.light = 0.0
    row.weighed = 1
    # the low-passed load f
    inertial = scaled3(1.0 / _LOAD_LAG, _gripper_momentum(t, arm))
    force = plus3(add3(wrench, _gripper_mass(t, arm), model.gravity), inertial)
    fill3(row.weighing, add3(row.weighing, share, minus3(force, row.weighing)))
    fill3(row.load, minus3(row.weighing, inertial))
    _judge_load(t, k)


@inner
def _judge_load(t, k):
    """Determine by the load of its wrist whether a stopped arm has let go of the object.

    An arm whose load is below `_LIGHT` times its share of the object's weight for `LET_GO_TIME` has
    let go: in an oscillation that braking excites, the load of an arm that holds the object passes
    zero for a few milliseconds only. Where encoders place the arm and the object apart
    (`is_apart`), the bound is `HEAVY` times the share, because a bias of the sensor may exceed the
    lower one, and arms that hold a rigid object apart bear more; and a load below it for
    `_AWAY_TIME` is enough. A load above `HEAVY` times the share for `LET_GO_TIME` revokes that an
    arm has let go, if its distance from the object is measured: braking unloads an arm for a
    moment, and an encoder that jumps seems to move it away. Without this measurement it is not
    revoked until the next stop as long as other arms hold the object, because vibrations or errors
    of the sensor may look like a load later.

    A wrist is no evidence if motor torques contradict one of the wrists, as an error of scale,
    range or wiring may affect all, or if its reading repeats. Fills `light` (s of evidence against
    `let_go`) and `let_go` of the arm in MEMORY.

    Args:
        t: Tick after `_compare_places`.
        k: index of the arm, of which `load` (3,; N) of MEMORY is read.
    """
    model = t.model
    memory = t.memory
    row = memory.arms[k]
    is_frozen = memory.cause == WRIST_FROZEN and memory.culprit == k
    if is_frozen or memory.cause == UNBALANCED:
        return
    is_measured = model.leader >= 0 and k != model.leader
    is_away = is_measured and memory.apart > APART_TIME and is_apart(t, k)
    bound = (HEAVY if is_away or row.let_go else _LIGHT) * weight_share(t)
    is_light = dot3(row.load, row.load) < bound * bound
    contradicts = is_measured and not is_light if row.let_go else row.holds == 0 and is_light
    row.light = row.light + model.period if contradicts else 0.0
    away_time = max(_AWAY_TIME, 1.5 * model.period)  # two readings at least
    if row.light > (away_time if is_away and not row.let_go else LET_GO_TIME):
        row.let_go = 1 - row.let_go
        row.light = 0.0


@leaf
def _gripper_mass(t, arm):
    """Add up the mass of the bodies of an arm beyond its wrist sensor (kg).

    They are a part of the link of the joint `outer_joint`, with the mass `outer[0]`, and all links
    beyond it, whose mass is the first element of `body` of the next joint.

    Args:
        t: Tick after `move_arm`, of which `body` of the joints is read.
        arm: ARM row.
    """
    if arm.outer_joint < 0:
        return 0.0
    beyond = arm.outer_joint + 1
    return arm.outer[0] + (t.work.joints[beyond].body[0] if beyond < arm.end else 0.0)


@leaf
def _gripper_momentum(t, arm):
    """Compute the linear momentum of the bodies of an arm beyond its wrist sensor (N s).

    It is the sum of v_j times the momentum per unit speed of each joint, the first three numbers of
    `outboard` (wrench of these bodies per acceleration of the joint).

    Args:
        t: Tick after `move_arm`, of which `outboard` of the joints is read, and v of MEMORY.
        arm: ARM row.
    """
    momentum = ZERO_3
    for j in range(arm.first, arm.end if arm.outer_joint >= 0 else arm.first):
        momentum = add3(momentum, t.memory.v[j], t.work.joints[j].outboard)
    return momentum


@inner
def _split_torques(t, arm, object_share, R, centre, weight):
    """Compute the torques of one arm and its share of the object, split in carrying and braking.

    Fills of its joints `tau` (N m, N), which carries arm and object at rest, and `rest`, which
    accelerates both by `acceleration` q̈ of the joints. If the motors cannot exert the sum, the
    caller commands `tau` plus the returned share of `rest`, the largest one with which no motor
    exceeds its limit, at least `_LEAST`. If it extracts more power −restᵀq̇ from the joints, `rest`
    is replaced so that this share of it is the braking torque limited joint by joint: then one
    motor near its limit does not weaken the brakes of the others. The power is compared by Σ Δrest
    q̈, because q̈ is along −q̇ once the held positions follow the joints.

    Args:
        t: Tick.
        arm: ARM row.
        object_share: share of the object that this arm carries (0 … 1).
        R: (3, 3) principal axes of the object in the world.
        centre: (3,) its centre of mass in the world (m).
        weight: (6,) wrench that carries the object, at the world's origin (N, N m).

    Returns:
        Share of `rest` to be exerted (`_LEAST` … 1).
    """
    table = t.model.joints
    joints = t.work.joints
    lo = arm.first
    share = 1.0
    object_wrench = _inertial_wrench(t, arm, object_share, R, centre)
    for j in range(lo, arm.end):
        carrying = joints[j].h + object_share * dot6(joints[j].column, weight)
        brake = dot6(joints[j].column, object_wrench)
        for i in range(lo, arm.end):
            brake += joints[j].M[i - lo] * joints[i].acceleration
        joints[j].tau = carrying
        joints[j].rest = brake
        if table[j].motor >= 0 and abs(brake) > 0.0:  # the share that leaves the sum in ±limit
            limit = table[j].tau_max
            room = limit - carrying if brake > 0.0 else limit + carrying
            share = min(share, max(room, 0.0) / abs(brake))
    share = max(share, _LEAST)
    # limited joint by joint instead, if this extracts more power: then Σ change q̈ > 0
    power_gain = 0.0
    if share < 1.0:
        for j in range(lo, arm.end):
            if table[j].motor >= 0:
                change = _clip_brake(joints[j], table[j].tau_max) - share * joints[j].rest
                power_gain += change * joints[j].acceleration
    if power_gain > 0.0:
        for j in range(lo, arm.end):
            joints[j].rest = _clip_brake(joints[j], table[j].tau_max) / share
    return share


@leaf
def _clip_brake(joint, limit):
    """Limit the braking torque of a joint so that its sum with the carrying torque is in ±`limit`.

    Args:
        joint: JOINT_WORK, of which `rest` (braking) and `tau` (carrying) are read (N m, N).
        limit: torque limit of the motor (N m, N).

    Returns:
        The limited braking torque (N m, N).
    """
    low = min(-limit - joint.tau, 0.0)
    high = max(limit - joint.tau, 0.0)
    return min(max(joint.rest, low), high)


@inner
def _inertial_wrench(t, arm, object_share, R, centre):
    """Compute the wrench that gives a share of the object the acceleration by q̈ of an arm's joints.

    The object is accelerated along this wrench: force = mass × acceleration, not its opposite. The
    acceleration is J q̈, where q̈ is `acceleration` and J consists of `column` (Jacobian at the
    world's origin) of the joints; products of speeds are neglected. Turns about a ball, or the axis
    of a hinge, do not move the object: its inertia would be many times that of a light joint
    which makes such a turn, and so the gain of this joint.

    Args:
        t: Tick.
        arm: ARM row.
        object_share: share of the object that this arm accelerates (0 … 1).
        R: (3, 3) principal axes of the object in the world.
        centre: (3,) its centre of mass in the world (m).

    Returns:
        Wrench (six numbers: N, N m) at the world's origin, in world axes.
    """
    if object_share == 0.0:
        return ZERO
    work = t.work
    a = ZERO
    for j in range(arm.first, arm.end):
        a = add(a, work.joints[j].acceleration, work.joints[j].column)
    if arm.kind == BALL or arm.kind == HINGE:
        a = _transmitted_acceleration(t, arm, a)
    (x, y, z) = rotated_back(R, angular(a))  # angular acceleration along the principal axes
    I = t.model.principal  # mass, then the principal moments
    couple = scaled3(object_share, rotated(R, (I[1] * x, I[2] * y, I[3] * z)))
    # mass times the acceleration of the centre of mass; then from the centre to the world's origin
    force = scaled3(object_share * I[0], velocity_at(a, centre))
    couple = plus3(couple, cross(centre, force))
    if arm.kind == BALL or arm.kind == HINGE:
        tip = _grasp_point(t, arm)
        transmitted = _transmitted_turn(t, arm, minus3(couple, cross(tip, force)))
        couple = plus3(transmitted, cross(tip, force))
    return join(force, couple)


@leaf
def _grasp_point(t, arm):
    """Point of a ball, or on the axis of a hinge, by which an arm holds the object (m, world).

    Args:
        t: Tick after `place_arm`.
        arm: ARM row.
    """
    return place_point(t.work.joints[arm.tip_joint], arm.tip[9:])


@leaf
def _transmitted_acceleration(t, arm, a):
    """Compute the part of a hand's acceleration that a ball or hinge transmits to the object.

    Args:
        t: Tick after `place_arm`.
        arm: ARM row.
        a: acceleration of the hand, as a motion at the world's origin (m/s², rad/s²).

    Returns:
        Six numbers like `a`: the acceleration of the grasp point, without the free turn.
    """
    tip = _grasp_point(t, arm)
    turn = _transmitted_turn(t, arm, angular(a))
    return join(plus3(velocity_at(a, tip), cross(tip, turn)), turn)


@leaf
def _transmitted_turn(t, arm, x):
    """Compute the part of a turn or couple that a hinge transmits, across its axis; a ball: none.

    Args:
        t: Tick after `place_arm`.
        arm: ARM row of an arm with a hinge or ball.
        x: (3,) turn or couple in the world.
    """
    if arm.kind == BALL:
        return ZERO_3
    axis = rotated(t.work.joints[arm.tip_joint].R, rotated9(arm.tip, arm.tip_axis))
    return add3(x, -dot3(axis, x), axis)


@inner
def _carry_weight(t, R, centre, weight):
    """Compute the wrench at the world's origin that carries the object, and the object's axes.

    Reads R and p of the joints, or `X_WO` of MEMORY if no arm holds the object rigidly.

    Args:
        t: Tick.
        R: (3, 3), filled with the principal axes.
        centre: (3,), filled with the centre of mass (m).
        weight: (6,), filled with the wrench; zero without an object.

    Returns:
        False if no object is held, or if its pose is unknown.
    """
    model = t.model
    memory = t.memory
    axes_frame = model.X_LP
    fill(weight, ZERO)
    if model.held == 0 or (model.leader < 0 and memory.located == 0):
        return False
    if model.leader >= 0:
        tip = t.work.joints[model.arms[model.leader].tip_joint]
        place_frame(tip, axes_frame, R, centre)
    else:
        fill3(centre, transformed(origin(memory.X_WO), memory.X_WO, axes_frame[9:]))
        turn_axes(memory.X_WO, axes_frame, R)
    force = scaled3(-model.principal[0], model.gravity)  # −m g, at the centre of mass
    fill(weight, join(force, cross(centre, force)))
    return True
