"""Declarations of the law's records, and the byte arrays of controllers that contain them.

A record is a contiguous range of bytes: a head, then tables with the rows of arms, joints and so
on, see `nested`. A controller has one row of MODEL and one of MEMORY; a batch has many. WORK and
INPUT belong to the thread that computes. Fields of rows must not have names of methods of
`numpy.recarray`.

The functions of a tick take all four records together, and often rows of one arm:

| argument | record |
|---|---|
| `t` | `Tick`: t.model.stiffness, t.work.arms[k].V |
| `arm`, `arm_work` | ARM row, and its ARM_WORK |
"""

from __future__ import annotations

from collections import namedtuple
from typing import Any

import numpy as np

from osc_contact.law.jit import leaf
from osc_contact.law.nested import Bytes, Nested

# --- Parameters, states, and intermediate results of a tick ---------------------------------------

MAX_JOINTS = 16  #: largest number of joints of one arm
JOINTS_AND_SIX = MAX_JOINTS + 6  #: length of rows with one number for each joint, then six more
HISTORY = 16  #: ticks; delays of wrenches must be shorter
MOST_LOST = 3  #: lost ticks over which integrals and phases advance at once; after more they hold

_INT = np.int64
_FLOAT = np.float64


def _record(
    whole: tuple[str, ...] = (),
    number: tuple[str, ...] = (),
    vector: tuple[str, ...] = (),
    matrix: tuple[str, ...] = (),
    **shapes: int | tuple[int, ...],
) -> np.dtype[Any]:
    """Record type with named fields.

    Args:
        whole: names of integers.
        number: names of numbers.
        vector: names of vectors of six numbers.
        matrix: names of 6 × 6 matrices.
        shapes: shapes of other arrays of numbers by their names.
    """
    fields: list[Any] = [(name, _INT) for name in whole] + [(name, _FLOAT) for name in number]
    fields += [(name, _FLOAT, shape) for name, shape in shapes.items()]
    fields += [(name, _FLOAT, 6) for name in vector]
    fields += [(name, _FLOAT, (6, 6)) for name in matrix]
    return np.dtype(fields, align=True)


#: The parts of a tick, see `tick`.
LOOK, MEASURE, COMMAND, ALLOCATE, END, HAND_OVER = range(6)

# Parameters -------------------------------------------------------------------------------------

BY_OBJECT, BY_CHAIN, BY_MATRIX = range(3)  #: metrics of the motion filter
RIGID, HINGE, BALL, OTHER = range(4)  #: kinds of grasps
POINTS, FACE_ON_VERTEX, EDGES, TANGENTS, GIVEN, SURFACE, FUNCTION = range(7)  #: kinds of pairs
FILTER, LEAST_SQUARES = range(2)  #: methods of computing contact forces from wrist readings
FORCE, COUPLE, THREAD = range(3)  #: columns of N of TANGENTS pairs
TURN, SLIDE, SCREW = range(3)  #: permitted motions of TANGENTS pairs
UNYIELDING, CONVEYOR, CART, YIELDING, ELSEWHERE = range(5)  #: kinds of touched bodies

_MODEL = _record(
    whole=(
        "n_arms",  # k, number of arms
        "n_joints",  # n, number of joints of all arms, passive ones included
        "n_motors",  # n_a, number of joints with a motor
        "n_shapes",  # number of rows with the geometry of pairs
        "n_columns",  # number of columns of N of all contacts
        "n_contacts",  # number of contacts that may occur
        "n_bars",  # internal forces that can be commanded: pairs of grasps
        "n_extra",  # largest number of rows E of the torque allocation
        "held",  # 1 if an object is held
        "metric",  # of the motion filter: BY_OBJECT, BY_CHAIN or BY_MATRIX
        "slipping",  # 1 if a grasp permits motions
        "reading",  # method of computing contact forces: FILTER or LEAST_SQUARES
        "leader",  # arm that holds the object rigidly, or −1
        "rubs",  # 1 if joint friction is compensated
        "friction_learning",  # 1 if joint friction is identified
        "friction_errors",  # 1 if errors of the links' masses are compensated, too
        "phased",  # 1 with contact phases
        "hop_stops",  # 1 if a hopping contact stops the arms
        "guarded",  # 1 if readings are checked: in a controller, not in a chain alone
        # see `safety`
        "repeats",  # largest number of ticks with repeated torques
        "fault_ticks",  # number of ticks that are not computed from which on the arms are stopped
        "fast_ticks",  # largest number of ticks with a joint above its speed limit
        "row_bytes",  # size of this record (bytes)
        "memory_bytes",  # size of MEMORY of one controller (bytes)
    ),
    number=(
        # see `dynamics.closed_chain`
        "rank_tolerance",  # threshold of σ for locked directions, see `operational.arm_terms`
        "angle_tolerance",  # rad, angle between directions that counts as zero
        # motion law, see `commands.command_motion`
        "stiffness",  # K_p (1/s²)
        "damping",  # K_d (1/s)
        "integral",  # K_i (1/s³)
        "fastest",  # largest speed by feedback of the motion, as a share of the joints' limits
        "period",  # s, of the controller
        # posture law, see `operational.retreat`
        "posture_stiffness",  # k_p (1/s²)
        "posture_damping",  # k_d (1/s)
        "retreat_damping",  # k_d (1/s) along motions that the task loses in a singular posture
        # friction of contacts, see `contact` and `contact_friction.learn_friction`
        "mu",  # assumed coefficient
        "slip",  # v_0 (m/s), sliding speed below which friction is regularised
        "learning",  # 1/s, rate at which the coefficient is identified; 0: never
        "hold_rate",  # ω (1/s) of a hold, see `holding`
        "torque_rate",  # 1/s, see `phases.torque_rate`
        # see `safety`
        "reaction",  # s until brakes act
        "contact_power",  # W, largest power into the contacts
        "contact_force",  # N, measured force up to which no contact is overloaded
        "contact_loss_time",  # s of too little force until a contact is lost
        "regain_time",  # s in which a lost contact must be regained
        "overforce_time",  # s of too much force until the arms are stopped
        # see `force_law.command_force` and `commands`
        "integral_force",  # N, largest contribution of a force integral to small commands
        "integral_motion",  # m/s², rad/s², largest contribution of the motion integral
        "force_brake",  # κ (1/s)
        "hold_gain",  # 1/s, of contacts that hold without a desired force
        "hold_brake",  # κ (1/s) of such contacts, see `force_law.column_law`
        "drift_share",  # share of one tick in the low-pass of v̄ and in the estimate of normals
        "step_time",  # s, rise time of a step of a desired force
        "tilt",  # rad, largest error of a declared normal, see `normals`
        # see `joint_friction`
        "friction_share",  # g, share of e that is compensated
        "friction_smoothing",  # K_d (1/s)
        "brake_ratio",  # largest ratio κ/K_i to which K_i may be reduced, see `friction_slope`
        # limits of sensor checks, see `plausibility`, `sensors`, `agreement` and `safety`
        "force_range",  # N
        "torque_range",  # N m
        "plausible_speed",  # share of a speed limit
        "wrench_timeout",  # s
        "stuck_speed",  # share of a speed limit
        "frozen_time",  # s
        "missed_share",  # share of the ticks of the last second
        "hop_share",  # share of the last second, see `hopping`
        "hop_rate",  # 1/s
        "speed_error",  # share of a speed limit
        "position_drift",  # rad or m
        "wrist_error",  # share of a torque limit
        "closure_error",  # m
        # contact phases, see `phases`
        "force_gain",  # K_i of the force law (1/s)
        "force_damping",  # K_v of the force law (N s/m)
        "approach_speed",  # v_a (m/s)
        "approach_damping",  # K_a (N s/m)
        "travel",  # m, longest approach
        "rise",  # s, time in which the force of a closed contact rises to its goal
        "least_force",  # α_min (N), least command of a closed contact that must not pull
        "phase_rate",  # 1/s, rate of torques after a change of phase
        "lost_share",  # share of the expected force that is added to `force_off`
        "lag",  # s, time constant of the low-pass of forces and speeds
        "force_on",  # N, force above which contact is made
        "force_off",  # N, force below which contact is lost
        "power",  # W, above which an impact is a collision
        "patience",  # s of low force until contact is lost
        "window",  # s after contact is made in which collisions are detected
        "dwell",  # s of high force until contact is made
        "leaving",  # m/s, speed of separation at which a contact is lost at any force
        "return_speed",  # m/s, largest speed of the return of a lost contact
        "friction_bound",  # μ_b, bound of the coefficient of friction, see `witness`
        # see `ceilings`
        "contact_ceiling",  # N
        "wrist_ceiling",  # N
        "speed_ceiling",  # m/s
        "ceiling_time",  # s
        "contact_headroom",  # multiples of the largest command so far
        "wrist_headroom",
    ),
    gravity=3,  # m/s², world axes
    roots=4,  # square roots of mass and principal moments of the object
    principal=4,  # mass and principal moments of the object
    reference=6,  # diagonal of Λ_ref, see `singular`
    lightness=6,  # its inverse
    X_LO=12,  # frame of the object in the leader's last joint: rotation by rows, then point
    X_LP=12,  # frame of its principal axes there; without a leader in the object's frame
    B_inv=(6, 6),  # BY_MATRIX: B⁻¹ of the motion filter, in world axes at O
)
ARM = _record(
    whole=(
        "first",  # index of its first joint
        "end",  # index of the joint behind its last one
        "tip_joint",  # joint that carries the tip
        "sensor_joint",  # joint that carries the wrist sensor; −1 without a sensor
        "outer_joint",  # joint that carries the first link beyond the sensor; −1: none
        "m",  # number of independent wrenches that the grasp transmits
        "kind",  # of the grasp: RIGID, HINGE, BALL or OTHER
        "filtered",  # 1 if bodies beyond the sensor can move by themselves, see `grasps`
        "full_rank",  # number of motions of the tip, on the range of N, in regular postures
    ),
    tip=12,  # frame of the tip in `tip_joint`: rotation by rows, then point
    sensor=12,  # frame of the wrist sensor in `sensor_joint`
    outer=13,  # inertia of the part of the first outboard link that is beyond the sensor
    grasp=(6, 6),  # rows: m of N, 6 − m of T, in the frame of the tip
    point=3,  # grasp point in the object
    axis=3,  # axis of a hinge in the object
    tip_axis=3,  # axis of a hinge in the tip
    X_TO=12,  # frame of the object in the tip at zero displacement of the grasp
)
#: Joint, which rotates about or slides along the z axis of its frame.
JOINT = _record(
    whole=("slides", "motor"),  # 1 if prismatic; number of its motor or −1
    number=(
        "tau_max",  # N m, N; inf without a limit
        "speed_max",  # rad/s, m/s; inf without a limit, and without a motor
        "lower",  # rad, m, end of its range
        "upper",  # rad, m
        "rated",  # speed limit, also of passive joints, whose speeds are not monitored
        "brake",  # s²/rad: 1/(2a), a the deceleration of a stop
        "effort",  # τ_max²; 0 without a motor
        "ease",  # 1/τ_max²; 0 without a motor
        "armature",  # inertia of its rotor at the joint (kg m², kg)
        "posture",  # q₀ of the posture law (rad, m)
        # repulsion from the limits, see `allocation.push_from_limits`
        "low",  # rad, m, position below which it is pushed up
        "high",  # rad, m, position above which it is pushed down
        "width",  # rad, m, depth at which the push is largest
        "most",  # rad/s², m/s², largest push
        "slip",  # s_0, speed below which dry friction is regularised
    ),
    theta=5,  # initial θ of `friction_estimate`
    placement=12,  # frame in the joint before it, or in the world: rotation by rows, then point
    link=13,  # mass, centre of mass, inertia about it by rows
)
#: Prior of θ of a joint, see `friction_estimate`.
PRIOR = _record(
    number=(
        "noise",  # noise of residuals (N m, N)
        "rounding",  # rounding errors of residuals (N m, N)
        "sure",  # number of standard deviations by which θ must differ from the model
    ),
    doubt=5,  # standard deviations at the start
    spread=5,  # largest standard deviations
    low=5,  # lower bounds
    high=5,  # upper bounds
)
PAIR = _record(
    whole=(
        "kind",  # POINTS … FUNCTION
        "first",  # index of its first column of N
        "count",  # number of its columns
        "shape_at",  # index of its first SHAPE
        "freedoms",  # number of permitted motions that are declared (TANGENTS)
        "has_friction",  # 1 if it touches at known points, so that friction acts there
        "address",  # of the compiled function of a FUNCTION pair
    )
)
SHAPE = _record(row=16)  #: numbers of a pair's geometry, see the functions of `pair_geometry`
COLUMN = _record(whole=("contact",))  #: column of N: index of its contact
#: Body touched by a contact: kind (UNYIELDING …); index of the first contact with the same body; 1
#: if the pair can only push; 1 if it does so with several columns in one direction, as a face or an
#: edge does; numbers of a cart or a yielding face, see `columns` and `commands`.
BODY = _record(whole=("kind", "same", "pushes", "face"), parameters=8)

# States -----------------------------------------------------------------------------------------

GIVEN_POSE = 1  #: the object's pose is an input
GIVEN_TWIST = 2  #: the object's pose and twist are inputs
JOINTS = 1  #: flag: readings of the joints repeat those of the last tick
WRISTS = 2  #: flag: readings of the wrists repeat those of the last tick
OUTDATED = 4  #: flag: the packet is older than the last one
#: State of a joint's position in a packet: credible, jumping, exchanged with another joint's.
NOT_BARRED, JUMP, EXCHANGED = range(3)
BRAKED = 1  #: state of a hold: joints are being braked
SETTLED = 2  #: state of a hold: joints are held at fixed positions
ESTIMATED = 1  #: speeds are estimated from positions, so a joint has one reading only
NOISY = 2  #: so they are, of encoders far noisier than expected
FAULTY_POSITION = 1  #: flag of a joint
FAULTY_SPEED = 2  #: flag of a joint

_MEMORY = _record(
    whole=(
        "force_rank",  # number of columns kept in the last tick
        "located",  # 1 once the pose of the object is known
        "ticked",  # number of computed ticks
        "fresh",  # 1 if measured forces have not been evaluated by `active_set` yet
        "gap",  # ticks since the last computed one
        "engaged",  # 1 if contacts are included in the law
        "hand_over",  # 1 if this tick converts the motion integral to a wrench
        "reason",  # of the last tick
        # see `safety`
        "state",
        "age",  # ticks in this state
        "faults",  # consecutive ticks that were not computed
        "lost",  # ticks that were not computed, less computed ones (≥ 0)
        "overspeed",  # weighted ticks above a speed limit
        "repeats",  # ticks for which torques may be repeated
        "cause",  # reason of the present state
        "settled",  # state of a hold: 0 where it begins, BRAKED, SETTLED
        "hopping",  # 1 plus the column of N that hops; 0: none
        "culprit",  # joint, arm or column of N concerned by the cause
        "unbraked",  # joint that is stopped without a sound reading, or −1
        "above",  # 1 if holds that test encoders are above the joints' rest positions
        # see `sensors`
        "wrench_missing",  # 1 if this tick has no wrenches
        "wrench_age",  # ticks since the last wrenches
        "has_wrench",  # 1 once wrenches have been read
        "compared",  # 1 once joints have been read
        "repeated",  # flags of repeated readings: JOINTS, WRISTS, OUTDATED
        "old_joints",  # ticks since joints had new readings
        "old_wrists",  # ticks since wrists had new readings
        "balanced",  # ticks in which wrists were compared with motor torques
        "instant",  # number of those ticks, including lost ones
        "stamped",  # `instant` since which wrenches have time stamps; 0 without stamps
        "late",  # delay of the wrenches relative to the joints' readings (ticks)
        "derived",  # 0, ESTIMATED or NOISY: whether speeds are estimated from positions
        "given",  # GIVEN_POSE, GIVEN_TWIST, or 0 if pose and twist follow from the grasps
        # see `active_set`
        "chosen_set",  # 1 if the last reference named the active contacts
        "by_column",  # 1 if force integrals are stored in the columns
        "status",  # status of the last tick
    ),
    number=(
        "more_friction",  # identified coefficient of friction less the assumed one
        "slid",  # s of sliding from which it was identified
        "powered",  # s of too much power, see `safety`
        "ending",  # s of a joint near an end stop
        "still",  # s of identical readings of all joints
        "frozen",  # s of identical readings of joints and wrists
        "lively",  # share of readings that changed a position, low-passed; kept while none does
        "apart",  # s of arms that place the object differently
        "mixed",  # s of several joints that jump in one packet
        "tested",  # s since the holds of a stop were last moved
        "missed",  # share of ticks that were not computed, low-passed
        # steps, see `commands`: remaining share of the rise time, and rise time (s)
        "step_left",
        "step_time",
        "squeeze_left",
        "squeeze_time",
        # see `ceilings`
        "largest_force",  # N, largest command so far of one contact or squeeze
        "largest_sum",  # N, largest sum of commands so far
        "over_contact",  # s above the ceiling of contacts
        "over_wrist",
        "over_free",  # while no contact is active
        "over_tip",
        "ceiling",  # ceiling that stopped the arms, and the value above it
        "reached",
        # see `friction_slope`
        "slope",  # 1/s, κ_f of the joints of this round so far
        "integral_cut",  # share of the gains of force integrals that is taken off
    ),
    centre_speed=3,  # velocity of the object's centre in the last tick (m/s)
    centre_rate=3,  # its rate, low-passed (m/s²)
    X_WO=(4, 4),  # pose of the object; without a leader, the start of the next search
    vector=(
        "motion_sum",  # integral of the permitted pose error, at O (m s, rad s)
        "f_tare",  # wrench that is subtracted from the readings of the wrists, at O
        "f_bias",  # constant wrench added to commands, see `tick.transfer_integral`, at O
        "force_sum",  # force integrals of the columns kept in the last tick (N)
        "V_O",  # GIVEN_TWIST: twist of the object at O
        "filtered_twist",  # of the object at O, low-passed, see `phases.low_pass`
    ),
)
CONTACT_MEMORY = _record(
    whole=("active", "phase", "held"),  # held: 1 once a steady force was measured since OPEN
    # of the force law: K_i (1/s), K_v (N s/m), κ (1/s), α_min (N); s in the present phase;
    # s since a closed contact was named not active; s for which the sum of its forces is low
    number=("gain", "damping", "brake", "least", "since", "unloading", "low_for"),
)
COLUMN_MEMORY = _record(
    whole=(
        "closed",  # 1 if contact is made
        "collision",  # 1 if a collision begins in this tick
        "known",  # 1 if the column was in N in the last computed tick
        "has_desired",  # 1 if a force was desired in the last tick
        "pressing",  # see `hopping`
    ),
    number=(
        # see `phases.monitor`
        "low_for",  # s of low force
        "high_for",  # s of high force
        "burst",  # W, largest power of this contact
        "armed_for",  # s in which collisions are still detected
        "force",  # N, low-passed measured force
        "filtered_speed",  # m/s, low-passed NᵀV_rel
        "alpha",  # N, measured force of the last tick
        "speed",  # m/s, NᵀV_rel of the last tick
        "net",  # N, `force` less the inertial force of free flight
        "underforce",  # s of too little force, see `safety`
        "overforce",  # s of too much force
        "hop_share",  # share of the last second with too little force, see `hopping`
        "hop_rate",  # 1/s, falls of the force
        # see `commands`
        "desired",  # N, last desired force
        "scale",  # N, its size
        "drift",  # m/s, lasting speed v̄
        "approach",  # m/s, speed of its approach, see `joint_friction`
        # brake on a yielding face, see `commands`
        "driven",  # m/s, state of v̂
        "deflection",  # m, p
        "eased",  # N, α_s
        "eased_rate",  # N/s, α̇_s low-passed
        # estimate of its compliance
        "yielded",  # m, x̃
        "alpha_mean",  # N, low-passed α
        "eased_mean",  # N, low-passed α_s
        "correlation",  # m N s
        "excitation",  # N² s
        # see `phases`
        "predicted",  # N, force to be expected
        "gap",  # m, distance since the contact was lost
        "time_since_loss",  # s
        "noise",  # N
        "integral",  # N, of the force law
        # low-passed, of an approached column, see `witness`
        "touch_read",  # N, before the object's inertial force is subtracted
        "touch",  # N
        "explained",  # N
        # estimate of the normal, see `contact`
        "unexplained",  # m/s, low-passed speed that the estimate does not explain
        "residual",  # (m/s)², its mean square
        "normal_std",  # rad, largest standard deviation; 0 without an estimate
        # low-passed NᵀV_rel, see `agreement.compare_speeds`
        "velocity_from_positions",
        "velocity_from_encoders",
    ),
    to_come=3,  # a, b, c of the remainder of a step, see `commands`
    turn=3,  # turn of the assumed normal, in the axes of the body that carries it, see `contact`
    tangential=3,  # N, tangential force that friction does not explain, low-passed, see `reading`
    covariance=9,  # rad², of `turn`; 0 without an estimate
)
#: Internal force: last desired value (N), its size (N), a, b, c of the remainder of a step.
BAR_MEMORY = _record(number=("desired", "scale"), to_come=3)
#: State of a joint from its sensors, see `sensors`, and of its friction, see `joint_friction`.
JOINT_MEMORY = _record(
    whole=(
        "faulty",  # flags FAULTY_POSITION, FAULTY_SPEED
        "unread_q",  # ticks since the position was read
        "unread_v",  # ticks since the speed was read
        "stuck",  # 1 if it does not move although it is commanded to
        "driven",  # 1 if dry friction cannot hold it against the command
        "barred",  # NOT_BARRED, JUMP, EXCHANGED
        "changes",  # changes of the position since the hold was last moved
        "followed",  # consecutive moves of the hold that it has followed
    ),
    number=(
        "q",  # last position read
        "v",  # last speed read
        "hold",  # q_hold
        "way",  # braking distance, from its speed when the hold began
        "acceleration",  # last commanded acceleration
        "pending",  # speed commanded since the position was last read, over lost ticks, too
        "gained",  # speed commanded while the position did not change
        "halted",  # deceleration to a speed of 0 that has lasted since
        "error",  # speed less speed from positions, low-passed
        "drift",  # its integral, with forgetting
        "same_speed",  # s of identical speeds
        "moved",  # displacement during these
        "due",  # integral of the speed since the position last changed
        "rested",  # s of identical positions
        "begun",  # position when the hold was last moved
        "went",  # displacement before that, since the move before
        "step",  # last change of the position
        "turning",  # share of changes that reversed the one before, low-passed
        "model_v",  # speed predicted from speeds read
        "model_q",  # speed predicted from positions
        "surprise_v",  # speed read less `model_v` (rad/s, m/s), low-passed
        "surprise_q",  # speed from positions less `model_q` (rad/s, m/s), low-passed
        "blame",  # integral of |surprise_v| − |surprise_q|, with forgetting
        # see `joint_friction`
        "past_weight",  # torque of the arm's h less outboard bias in the last tick
        "load",  # torque of the wrench in the last tick
        "past_v",  # last speed
        "rate",  # low-passed acceleration
        "residual",  # r
        "speed",  # permitted speed s
        "sign",  # mean of its regularised sign in this tick
        "turn",  # ṡ
        "friction",  # compensated friction f
        "unlearned",  # e
        "rotor",  # inertia that M has beside the model's
        # see `agreement`
        "unexplained",  # residual less identified friction, low-passed
        "usual",  # its mean over a longer time
        "unbalanced",  # s for which it has been too large
        "rubbed",  # magnitude of the residual during the last motion, low-passed
        "slid",  # s of motion
        # see `probing`
        "probed",  # s of the torque that tests its encoder; 0 before, −1 after it
        "push",  # sum of this torque times its oscillation, over the last period
        "echo",  # sum of the torque of the wrist's wrench times this oscillation
    ),
    trusted=3,  # F, D and |A| low-passed over a long time, see `agreement`
    means=6,  # low-passed signals, see `friction_estimate`
)
PAST = _record(history=(HISTORY, 8))  #: signals of a joint in former ticks, for delayed wrenches
#: Estimate of a joint's friction, see `friction_estimate`: variance of residuals, s of evidence,
#: s of rest, s of rest although the joint is commanded to move fast, share that is applied, s of
#: contradiction, variance of residuals by the noise of the wrist; θ, θ without bounds and its
#: covariance; regressors after the second low-pass.
FRICTION = _record(
    number=("noise", "evidence", "rested", "stuck", "applied", "contradicted", "jitter"),
    theta=5,
    estimate=5,
    P=(5, 5),
    smooth=6,
)
ARM_MEMORY = _record(
    whole=(
        "unread",  # ticks since its wrist was read
        # of a stopped arm, see `holding`
        "weighed",  # 1 once the load of its wrist was read
        "let_go",  # 1 if it has let go of the object
        "holds",  # 1 if it alone holds the object
        "released",  # 1 if its last hold has released a motor, see `holding`
    ),
    number=(
        "same",  # s of identical readings of its wrist
        "doubtful",  # s of unexplained motor torques above half of their bound, see `agreement`
        "light",  # s for which the load of a stopped arm contradicts `let_go`
        "lively",  # share of the wrist's numbers that change with a reading, low-passed
        "watched",  # s for which this share has been observed
        "gap",  # m, distance between the places where it and the leader have the object
        "parting",  # m/s, rate of `gap`, low-passed
        "first_gap",  # m, `gap` when loads are first judged after a stop, see `isolation`
    ),
    load=3,  # N, force by which its gripper carries the object, low-passed
    weighing=3,  # N, state of this low-pass
    constant=6,  # s for which each of the six numbers of its wrist has been identical
)

# Intermediate results of a tick -----------------------------------------------------------------

#: Vectors are at O in world axes unless a comment says otherwise. `_e`: energy coordinates. `_t`:
#: energy coordinates turned so that the first m axes are the locked ones.
_WORK = _record(
    whole=(
        # see `plausibility.find_jumps`: 1 once it was called in this tick, numbers of positions and
        # of speeds that jump, and one joint of each
        "looked",
        "jumps",
        "jumped",
        "speed_jumps",
        "speed_jumped",
        "rank",  # r, number of independent columns of N
        "locked",  # m, number of motions of the object that the arms cannot make
        "count",  # number of active columns of N
        "status",  # OK, SATURATED, HELD, DEGRADED or HOPPING
        "reason",
        "where",  # column that the reason concerns: index among all, of UNREACHABLE among the kept
        "n_lost",  # number of lost directions of all arms near singular postures
        "n_internal",  # number of rows of E for internal forces
        "commanded",  # 1 if internal forces are commanded
        "moving",  # 1 if motions of the touched bodies are measured
        "weightless",  # 1 if no inertia is between wrist sensors and contacts
    ),
    number=(
        "reason_amount",  # number in the sentence of a reason
        "dt",  # s, time since the last computed tick
        "mu",  # coefficient of friction, assumed and identified
        "more_friction",  # identified coefficient less the assumed one
        "slid",  # s of sliding from which it was identified
        "step_left",  # remaining share of the rise time of a step, see `commands`
        "step_time",  # s, its rise time
        "squeeze_left",  # the same of internal forces
        "squeeze_time",
        "integral_scale",  # 0 … 1, factor of K_i during a step, see `commands.shape_steps`
    ),
    # contiguous, as recordings copy them together
    f_meas=6,  # sum of the wrist readings less tare
    # wrench that moves the bodies beyond the wrist sensors at a = 0, a the spatial acceleration of
    # the object: their weight and velocity products. Joints accelerate by `offset` then, q̈ is not
    # 0. Without contact the readings are Λ_out a + bias_out.
    bias_out=6,
    V_O=6,  # twist of the object at O
    X_WO=(4, 4),  # pose of the object
    f_c=6,  # N α_meas
    error=6,  # pose error (m, rad)
    free_error=6,  # its part that contacts and arms permit
    p_C=3,  # centre of mass of the object
    p_O=3,  # operational point
    axes=(4, 3, 3),  # maps from world axes at C to energy coordinates, see `vectors.set_axes`
    X_WD=(4, 4),  # reference of the last computed tick
    beta=8,  # β of `reflectors`
    vector=(
        "V_D",  # reference of the last computed tick, with X_WD and A_D
        "A_D",
        "V_C",  # twist of the object at C
        "bias_links",  # sum of `bias` of the arms that are not `filtered`, at C
        "bias_e",  # bias_out _e
        "chain_bias",  # μ + p of object and arms, _e, then _t
        "sigma",  # σ, acceleration of the object at η̇ = 0; _e, then _t
        # of the kept columns (r,)
        "b_N",  # Nᵀb_e, acceleration of the touched bodies (m/s²)
        "V_N",  # NᵀV_e, their speeds (m/s)
        "n_gamma",  # n_γ (m/s²)
        "alpha_d",  # desired forces (N)
        "alpha_meas",  # measured forces (N)
        "alpha_u",  # commanded forces (N)
        "reaction",  # N, contact force lost by tangential forces, see `oppose_friction`
        "speed",  # NᵀV_rel (m/s)
        "gain",  # K_i (1/s)
        "damping",  # K_v (N s/m)
        "brake",  # κ (1/s), then the deceleration by the brake (m/s²)
        "least",  # α_min (N)
        "felt",  # N, measured force that the force integral compares with alpha_d
        "reading_e",  # f_meas − bias_out
        "reading_rest",  # R⁻¹(f − N_μα) of least squares, see `reading.weigh_magnitudes`
        "motion_next",  # Ω_m e, then ∫Ω_m e dt after this tick (m s, rad s)
        "force_next",  # force integrals after this tick (N)
        "a_u",  # commanded acceleration of the object, spatial
        "acceleration_t",  # filtered acceleration of the object, S η̇_c + σ
        "f_S",  # commanded force on the object, along S from element m on; _t
    ),
    matrix=(
        "Lambda",  # Λ of object and arms, _e, then _t
        "effort",  # inverse metric of least effort of all arms, _e, then _t
        "out_T",  # Λ_out transposed, _e
        "reflectors",  # vectors of the reflections from _e to _t, by rows
        "N_e",  # kept columns of N, by rows
        "N_t",
        "pushed",  # N_μ, by rows, _e
        "pushed_t",
        "friction_wrenches",  # N_μ − N, by rows, at O
        # N = N_factor N_basis (rows), the basis orthonormal, see `algebra.orthonormalise`
        "N_basis",
        "N_factor",
        "N_basis_t",
        "N_factor_t",
        "Phi_mu",  # NᵀΦ_eN_μ
        "mobility",  # D, normal acceleration per measured contact force
        "B_inv_t",  # B⁻¹ of the motion filter
        "yields",  # NᵀΦ_e, at O
    ),
)
ARM_WORK = _record(
    # numbers of the rows of `resisted`, `kept` and `lost`; wide: 1 with redundant joints
    whole=("n_locked", "n_kept", "wide", "n_lost"),
    tip=(4, 3),  # axes of the tip by rows, then its point
    mode=(6, MAX_JOINTS),  # joints' motions of lost directions
    vector=(
        "reading",  # of its wrist
        "V",  # twist of the tip at C
        "drift",  # of the tip at C
        "bias",  # wrench of the outboard bodies at q̈ = 0, at C; overwritten if `filtered`
        "gamma",  # drift, _e
        # of lost directions, see `singular.find_lost`
        "chi",  # χ, distance from the singular posture
        "share",  # φ, share of the command that is executed
        "gone",  # 1 if the chain counts them as locked
        "net",  # reading of its wrist at C less weight and inertia of the bodies outboard of it
    ),
    matrix=(
        "passed",  # m of N, then 6 − m of T, orthonormal _e
        "filter",  # F of a gripper that can move by itself, _e, see `grasps.filter_outboard`
        "Lambda",  # Λ of the arm, _e
        "effort",  # its inverse metric of least effort, _e
        "resisted",  # orthonormal wrenches _e that its structure carries, n_locked of them
        "kept",  # orthonormal wrenches _e that the joints resist with their motors or inertia
        "lost",  # wrenches _e of lost directions
    ),
)
JOINT_WORK = _record(
    number=(
        "q",  # rad, m
        "v",  # rad/s, m/s
        "h",  # C v + g (N m, N)
        "tau",  # commanded torque (N m, N); of a hold the one that carries arm and object
        "rest",  # τ_0, torque without command; of a hold the braking torque
        "offset",  # −J̄ᵀγ, acceleration of the joint at a = 0
        "acceleration",  # q̈ under the command
        "inertial",  # h + M q̈
        "friction",  # compensated friction
    ),
    R=(3, 3),  # axes of its frame in the world
    p=3,  # origin of its frame in the world (m)
    body=13,  # mass, mass × centre, inertia at C of all bodies that it carries
    M=MAX_JOINTS,  # its row of the arm's joint-space inertia
    vector=(
        "column",  # its column of J at C, world axes
        "J",  # the same _e
        "J_bar",  # its row of J̄, _e
        "force",  # wrench that moves the bodies that it carries at q̈ = 0, at C
        "outboard",  # wrench of the bodies beyond the wrist sensor per q̈, at C, later _e
    ),
)
COLUMN_WORK = _record(
    whole=("shaped",),  # 1 if steps of its desired force are shaped
    number=(
        "n_gamma",  # n_γ (m/s²)
        "extent",  # norm in energy coordinates
        "alpha_d",  # N, desired force, as in the reference
        "goal",  # N, α_s, the desired force after shaping
        "scale",  # N, size of the force
        "slides",  # σλ, share of the speed that turns the normal
        "drift",  # m/s, lasting speed v̄
        "unexplained",  # m/s, speed that v̄ does not explain
        "lever",  # (m/s)², square of the sliding speed
        "rests",  # v_0²/(v_t² + v_0²) of the measured sliding speed: 1 at rest, 0 in fast slides
        # N, see `witness`
        "touch",
        "touch_inertia",
        "explained",
    ),
    to_come=3,
    point=3,  # point of contact from O
    slip=3,  # direction of slip s there, see `contact`
    turn=3,  # turn of the assumed normal, see `contact`
    turned=3,  # turn after this tick
    shown=3,  # direction in which sliding shows an error of the normal, in the same axes
    prior=9,  # covariance before any sliding
    believed=3,  # declared normal, in the axes of the body that carries the face
    tangential=3,  # N, for the next tick
    vector=(
        "N",  # at O, world axes
        "friction_wrench",  # μ [s; p × s], at O
        "energy",  # N _e
        "rest",  # part outside the span of the columns that are kept so far, _e
        "share",  # the wrench of its unit force as a combination of the kept columns
    ),
)
BAR_WORK = _record(number=("goal", "scale"), to_come=3)  #: commanded force (N), size, step
BODY_WORK = _record(answer=48, motion=28)  #: Φ_e, b_e, V_e; X_WE, V_E, A_E

OK, SATURATED, HELD, DEGRADED, HOPPING = range(5)  #: status of a tick
RUN, DEGRADED_STATE, HOLD, SAFE_STOP = range(4)  #: state of a controller, see `safety`

# The records as one run of bytes each -----------------------------------------------------------

#: Sizes: k arms, n joints, a motors, c contacts, s shapes, r columns of N, see `_counts`.
MODEL = Nested(
    _MODEL,
    arms=(ARM, "k"),
    joints=(JOINT, "n"),
    pairs=(PAIR, "c"),
    shapes=(SHAPE, "s"),
    columns=(COLUMN, "r"),
    bodies=(BODY, "c"),
    priors=(PRIOR, "n"),  # last, since it is read only if friction is identified
)
MEMORY = Nested(
    _MEMORY,
    contacts=(CONTACT_MEMORY, "c"),
    torques="a",  # motor torques of the last tick
    joints=(JOINT_MEMORY, "n"),
    arms=(ARM_MEMORY, "k"),
    q="n",
    v="n",  # as estimated, see `isolation.estimate_joints`
    friction_known=(_INT, "n"),  # see `joint_friction`
    wrenches=("k", 6),  # last ones read
    squeeze="squeezes",  # desired internal forces (N)
    internal=(BAR_MEMORY, "squeezes"),  # see `commands`
    friction=(FRICTION, "n"),  # used only if friction is identified
    past=(PAST, "n"),  # used only if wrenches have time stamps
    columns=(COLUMN_MEMORY, "r"),  # last, since pairs in Python may change r
)
WORK = Nested(
    _WORK,
    arms=(ARM_WORK, "k"),
    joints=(JOINT_WORK, "n"),
    columns=(COLUMN_WORK, "r"),
    bodies=(BODY_WORK, "c"),
    locked_rows=("6k", 7),  # of all arms: unit wrenches _e and their rates
    tau="a",  # motor torques (N m, N)
    step="a",  # their largest changes in this tick
    # columns of N
    goal="r",  # N
    here="r",  # 1 if active
    alpha="r",  # N, measured force
    speeds="r",  # m/s, NᵀV_rel
    chosen=(_INT, "r"),  # indices of active columns
    kept=(_INT, "r"),  # indices of independent columns
    # torque allocation, see `allocation`; these sizes depend on the model, so they are not local
    extra=("e", "n"),  # E
    weighed=("e", "n"),  # R⁻¹Eᵀ
    factor=("6e", "6e"),  # of Z
    sides="6e",  # b
    # of a row of E that may depend on those before it: multipliers of these, remainder, its R⁻¹
    multipliers="6e",
    rest="n",
    rest_weighed="n",
    # internal forces, see `commands` and `bars.settable_bars`
    internal=(BAR_WORK, "squeezes"),
    bars="squeezes",  # N, internal forces by the commanded torques
    points=("k", 3),  # grasp points in the world (m)
    owners=(_INT, "6k"),  # arm of each row of `carried`
    carried=("6k", 3),  # forces that the structures of the arms carry without motors
    levers=("bars", "n"),  # E⁺J̄ᵀ, force in the bars per torque
    basis=("bars", "bars"),  # settable combinations of bar forces, as columns
    # E⁺ = UΣ⁻¹Yᵀ, E (3k, bars): in each row one of Σ⁻¹Yᵀ, then one of Uᵀ
    bar_inverse=("bars", "bar_row"),
    # rows of Σ⁻¹Yᵀ times locked wrenches and forces by joints, then rows of Uᵀ
    bar_effects=("bars", "effect_row"),
    bar_torques=("bars", "n"),  # torques that change bar forces
    moving_torques=(_FLOAT, 6, "n"),  # torques that move the object
)
#: Input of a tick.
INPUT = Nested(
    _record(
        # 1 if motions of the touched bodies are measured; 1 if active contacts are named
        whole=("moving", "chosen_set"),
        # reference
        X_WD=(4, 4),  # desired pose of the object
        V_D=6,  # desired twist at O
        A_D=6,  # desired classical acceleration at O
    ),
    q="n",  # rad, m
    v="n",  # rad/s, m/s
    wrenches=("k", 6),  # readings of the wrists, in the axes of the sensors (N, N m)
    alpha_d="r",  # desired contact forces (N)
    touched=("c", 28),  # X_WE by rows, V_E, A_E of the bodies
    active="c",  # 1: in the active set, 0: not
)
#: Job of a call of `rows.rows`: parts of the tick, rows, and offsets of their bytes.
JOB = Nested(
    _record(
        whole=(
            "switches",  # flags of the tick, such as `tick.MOVING`
            "begin",  # first part
            "stop",  # part before which to stop
            "first",  # first row
            "last",  # row before which to stop
            "count",  # number of all rows, of which the input arrays have the values
            # offsets of records in the bytes
            "model",  # of the first row
            "model_step",  # distance of two rows; 0 if all share one
            "memory",  # of the first row
            "work",  # of the thread
            "input",  # of the thread
        )
    )
)

#: The four records that the functions of a tick take: MODEL, settings and structure; MEMORY, states
#: between ticks; WORK, results and intermediate results of this tick; INPUT, measurement and
#: reference.
Tick = namedtuple("Tick", "model memory work input")


# --- The bytes of one controller, and its records as views ----------------------------------------

_job, _model, _memory, _work, _input = (kind.at for kind in (JOB, MODEL, MEMORY, WORK, INPUT))


@leaf
def row_of(raw, at, i):
    """Return the records of one row of a job as a `Tick`: MODEL, MEMORY, WORK and INPUT.

    The JOB of a thread has the offsets (bytes) of all records: MODEL and MEMORY of row i lie behind
    those of the first row by i times the size of a row, WORK and INPUT belong to the thread.

    Args:
        raw: bytes of `Rows`.
        at: offset of the JOB of a thread.
        i: index of the row.
    """
    job = _job(raw, at)
    model = _model(raw, job.model + i * job.model_step)
    memory = _memory(raw, job.memory + i * model.memory_bytes)
    return Tick(model, memory, _work(raw, job.work), _input(raw, job.input))


@leaf
def contact_of(t, column):
    """Return the state of the contact that a column of N belongs to.

    Args:
        t: Tick.
        column: index of the column among all columns of the model.

    Returns:
        Row of CONTACT_MEMORY.
    """
    return t.memory.contacts[t.model.columns[column].contact]


@leaf
def body_of(t, column):
    """Return the body that the contact of a column of N touches.

    Args:
        t: Tick.
        column: index of the column among all columns of the model.

    Returns:
        Row of BODY.
    """
    return t.model.bodies[t.model.columns[column].contact]


#: Counts of tables, and the field of MODEL of the same value.
COUNTED = {
    "k": "n_arms",
    "n": "n_joints",
    "a": "n_motors",
    "c": "n_contacts",
    "s": "n_shapes",
    "r": "n_columns",
    "bars": "n_bars",
    "e": "n_extra",
}


def _counts(k: int, n: int, a: int, c: int, s: int, r: int) -> dict[str, int]:
    """Sizes of all tables by their names in the declarations.

    Args:
        k, n, a, c, s, r: numbers of arms, joints, motors, contacts, shapes and columns of N.
    """
    bars = k * (k - 1) // 2
    extra = max(1, bars) + 6 * k
    return {
        "k": k,
        "n": n,
        "a": a,
        "c": c,
        "s": s,
        "r": r,
        "6k": 6 * k,
        "e": extra,
        "6e": 6 + extra,
        "bars": bars,
        "squeezes": max(1, bars),
        "bar_row": 3 * k + bars,  # forces of the grasps, then of the bars
        "effect_row": 6 * k + n + bars,  # locked wrenches, then joints, then bars
    }


def new_model(
    arms: int, joints: int, motors: int, contacts: int = 0, shapes: int = 0, columns: int = 0
) -> Bytes:
    """Make a row of MODEL that is zero except for its layout and its numbers of parts.

    Args:
        arms, joints, motors, contacts, shapes, columns: number of each.

    Returns:
        The bytes of the row.
    """
    counts = _counts(arms, joints, motors, contacts, shapes, columns)
    raw = MODEL.new(counts)
    head = MODEL.view(raw)
    for size, name in COUNTED.items():
        setattr(head, name, counts[size])
    head.row_bytes = len(raw)
    head.memory_bytes = len(MEMORY.new(counts))
    return raw


class Rows:
    """Records of controllers of the same structure in one array of bytes, for `rows.rows`.

    Attributes:
        numbers, raw: the whole array, as numbers and as bytes.
        model, memory: (rows, size) bytes of MODEL and MEMORY of each row. If all MODELs are equal,
            all rows share one of them, which must not be written to.
        jobs, work, input: (threads, size) bytes of JOB, WORK and INPUT of each thread.
        starts: offset of the JOB of each thread.
        job: JOB of the first thread.
    """

    def __init__(self, model: Bytes, memory: Bytes | None = None, threads: int = 1) -> None:
        """Copy models and memories into one array.

        Args:
            model: (rows, size) bytes of MODEL.
            memory: (rows, size) bytes of MEMORY; None: initial state.
            threads: number of threads that share the rows.
        """
        model = np.atleast_2d(model)
        head = MODEL.view(model[0])
        counts = _counts(**{size: int(head[COUNTED[size]]) for size in "knacsr"})
        if memory is None:
            memory = np.tile(MEMORY.new(counts), (len(model), 1))
        shared = len(model) > 1 and (model == model[0]).all()
        # one array of bytes with all parts in sequence, of which the attributes are views
        parts = {
            "jobs": np.tile(JOB.new(counts), (threads, 1)),
            "model": model[:1] if shared else model,
            "memory": np.atleast_2d(memory),
            "work": np.tile(WORK.new(counts), (threads, 1)),
            "input": np.tile(INPUT.new(counts), (threads, 1)),
        }
        self.numbers = np.zeros(sum(part.size for part in parts.values()) // 8)
        self.raw: Bytes = self.numbers.view(np.uint8)
        starts = {}
        end = 0
        for name, part in parts.items():
            starts[name] = end
            here = self.raw[end : end + part.size].reshape(part.shape)
            here[:] = part
            setattr(self, name, here)
            end += part.size
        if shared:
            self.model = np.broadcast_to(self.model[0], model.shape)
        # a JOB for each thread, with the offsets of the records
        self.starts = [i * self.jobs.shape[1] for i in range(threads)]
        for i in range(threads):
            job = JOB.view(self.jobs[i])
            job.stop = END
            job.last = job.count = len(model)
            job.model = starts["model"]
            job.model_step = self.model.strides[0]
            job.memory = starts["memory"]
            job.work = starts["work"] + i * self.work.shape[1]
            job.input = starts["input"] + i * self.input.shape[1]
        self.job = JOB.view(self.jobs[0])

    jobs: Bytes
    model: Bytes
    memory: Bytes
    work: Bytes
    input: Bytes


def views(rows: Rows, i: int = 0, thread: int = 0) -> Any:
    """Records of one row, for use in Python.

    Args:
        rows: records of controllers.
        i: index of the row.
        thread: thread whose WORK and INPUT are taken.
    """
    return Tick(
        MODEL.view(rows.model[i]),
        MEMORY.view(rows.memory[i]),
        WORK.view(rows.work[thread]),
        INPUT.view(rows.input[thread]),
    )
