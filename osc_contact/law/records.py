"""The records of the law, declared once, and the bytes of controllers that hold them.

Each is one run of bytes: a head, then the rows of arms, joints and so on, see `nested`. A
controller has one row of MODEL and one of MEMORY; a batch has many. WORK and INPUT belong to the
thread that computes. Field names of rows that are methods of `numpy.recarray` are not allowed.

The parts of a tick take all four, and what is theirs:

| argument | record |
|---|---|
| `t` | `Tick`: t.model.stiffness, t.work.arms[k].V |
| `arm`, `own` | ARM row, and its ARM_WORK |
"""

from __future__ import annotations

from collections import namedtuple
from typing import Any

import numpy as np

from osc_contact.law.jit import leaf
from osc_contact.law.nested import Bytes, Nested

# --- What is given, what is remembered, what a tick works out -------------------------------------

MAX_JOINTS = 16  #: of one arm
JOINTS_AND_SIX = MAX_JOINTS + 6  #: length of rows that carry six numbers behind those of the joints
HISTORY = 16  #: ticks; by fewer than so many wrenches may be late
MOST_LOST = 3  #: lost ticks over which integrals and phases advance at once; more are a hold

_INT = np.int64
_FLOAT = np.float64


def _record(
    whole: tuple[str, ...] = (),
    number: tuple[str, ...] = (),
    vector: tuple[str, ...] = (),
    matrix: tuple[str, ...] = (),
    **shapes: int | tuple[int, ...],
) -> np.dtype[Any]:
    """Fields: integers, numbers, other arrays of numbers, 6-vectors, 6 × 6 matrices."""
    fields: list[Any] = [(name, _INT) for name in whole] + [(name, _FLOAT) for name in number]
    fields += [(name, _FLOAT, shape) for name, shape in shapes.items()]
    fields += [(name, _FLOAT, 6) for name in vector]
    fields += [(name, _FLOAT, (6, 6)) for name in matrix]
    return np.dtype(fields, align=True)


#: The parts of a tick, see `tick`.
LOOK, MEASURE, COMMAND, ALLOCATE, END, HAND_OVER = range(6)

# What is given ----------------------------------------------------------------------------------

#: metrics of the motion filter, kinds of grasps, of pairs, of touched bodies
BY_OBJECT, BY_CHAIN, BY_MATRIX = range(3)
RIGID, HINGE, BALL, OTHER = range(4)
POINTS, FACE_ON_VERTEX, EDGES, TANGENTS, GIVEN, SURFACE, FUNCTION = range(7)
FILTER, LEAST_SQUARES = range(2)  #: how contact forces are read off the wrists
#: columns and freedoms of pairs given by T
FORCE, COUPLE, THREAD = range(3)
TURN, SLIDE, SCREW = range(3)
UNYIELDING, CONVEYOR, CART, YIELDING, ELSEWHERE = range(5)

_MODEL = _record(
    whole=(
        "n_arms",
        "n_joints",
        "n_motors",
        "n_shapes",
        "n_columns",
        "n_contacts",
        "n_bars",  # internal forces that can be commanded: pairs of grasps
        "n_extra",  # rows that the torque allocation may need beside f_S
        "held",
        "metric",
        "slipping",  # whether some grasp permits motions
        "reading",  # how contact forces are read off the wrists
        "leader",  # arm that holds rigidly, or −1
        "rubs",  # whether friction of joints is compensated
        "friction_learning",  # and learned
        "friction_errors",  # and other errors of the arms
        "phased",  # whether contacts are opened and closed one by one
        "guarded",  # whether readings are judged: those of a controller, not of a lone chain
        "repeats",
        "fault_ticks",
        "fast_ticks",  # see `safety`
        "row_bytes",
        "memory_bytes",  # of one controller
    ),
    number=(
        "rank_tolerance",  # see `dynamics.closed_chain`
        "angle_tolerance",
        "stiffness",
        "damping",
        "integral",
        "period",
        "posture_stiffness",
        "posture_damping",
        "retreat_damping",
        "mu",
        "slip",
        "learning",
        "hold_rate",
        "torque_rate",  # 1/s, of `safety`
        # see `safety`: s to begin braking, W, N of the least limit, s of low and of high forces
        "reaction",
        "contact_power",
        "contact_force",
        "contact_loss_time",
        "regain_time",
        "overforce_time",
        "integral_force",
        "integral_motion",  # the most that integrals add: N, m/s² or rad/s²
        "force_brake",
        "drift_share",
        "step_time",
        "tilt",  # see `contact`
        "friction_share",
        "friction_smoothing",  # 1/s, see `joint_friction`
        # see `sensors`: N, N m, times a speed limit, s without a wrench
        "force_range",
        "torque_range",
        "plausible_speed",
        "wrench_timeout",
        "stuck_speed",
        "frozen_time",  # likewise: share of a speed limit, s
        "missed_share",  # of the ticks of the last second, see `safety`
        "speed_error",
        "position_drift",  # times a speed limit; rad or m
        "wrist_error",
        "closure_error",  # times a torque limit; m
        # contact phases, see `phases`
        "force_gain",
        "force_damping",
        "approach_speed",
        "approach_damping",
        "travel",
        "rise",
        "least_force",
        "phase_rate",
        "lost_share",
        "lag",
        "force_on",
        "force_off",
        "power",
        "patience",
        "window",
        "dwell",
        "leaving",
        "friction_bound",
        # see `ceilings`: N, N, m/s; s; times the largest command so far
        "contact_ceiling",
        "wrist_ceiling",
        "speed_ceiling",
        "ceiling_time",
        "contact_headroom",
        "wrist_headroom",
    ),
    gravity=3,
    roots=4,  # √ of mass and principal moments of the object
    principal=4,  # those squared
    reference=6,  # diagonal of Λ_ref, by which singular postures are judged
    lightness=6,  # its inverse
    X_LO=12,  # object in the leader's last joint: rotation by rows, then point
    X_LP=12,  # its principal axes there; with no leader: in the object's frame
    B_inv=(6, 6),  # of the motion filter, where it is given: world axes at O
)
ARM = _record(
    whole=(
        "first",
        "end",
        "tip_joint",
        "sensor_joint",
        "outer_joint",  # −1: none
        "m",
        "kind",
        "filtered",
        "full_rank",
    ),
    tip=12,
    sensor=12,  # frames in their joints: rotation by rows, then point
    outer=13,  # what of the first outboard link is beyond the sensor
    grasp=(6, 6),  # rows: m of N, 6 − m of T, in the tip
    point=3,
    axis=3,
    tip_axis=3,  # of the grasp: in the object, and its axis in the tip
    X_TO=12,  # object in the tip where the grasp stands at zero
)
#: Joints turn about or slide along the z axis of their frame.
JOINT = _record(
    whole=("slides", "motor"),  # motor: number or −1
    number=(
        "tau_max",
        "speed_max",
        "lower",
        "upper",
        "rated",  # speed limit of joints without a motor, too: none is watched above it
        "brake",  # s²/rad: 1/(2a), a the deceleration of a stop
        "effort",
        "ease",  # τ_max², 1/τ_max²; 0 without motor
        "armature",
        "posture",
        "low",
        "high",
        "width",
        "most",  # see `control.records.joint_limit_margins`
        "slip",  # speed from which on dry friction is whole
    ),
    theta=5,  # of `joint_friction`, at the start
    placement=12,  # in the joint before it, or in the world: rotation by rows, then point
    link=13,  # mass, centre, inertia about it by rows
)
#: Of θ: residuals that are no friction, and rounding (N m, N); standard deviations by which it must
#: differ from the model; standard deviation at the start and at most; bounds.
PRIOR = _record(number=("noise", "rounding", "sure"), doubt=5, spread=5, low=5, high=5)
PAIR = _record(
    whole=(
        "kind",
        "first",
        "count",
        "shape_at",
        "freedoms",
        "has_friction",
        "address",  # of the function that a FUNCTION pair is
    )
)
SHAPE = _record(row=16)
COLUMN = _record(whole=("contact",))
BODY = _record(whole=("kind", "same", "pushes"), parameters=8)

# What is remembered -----------------------------------------------------------------------------

GIVEN_POSE = 1
GIVEN_TWIST = 2
#: readings of a tick that are those of the last one; or even older, in a packet out of order
JOINTS = 1
WRISTS = 2
OUTDATED = 4
#: of a joint's position in this packet: credible; or not, as it jumps, or is another joint's
NOT_BARRED, JUMP, EXCHANGED = range(3)
#: of the joints in a hold: braked, or where they are held
BRAKED = 1
SETTLED = 2
#: of a joint
FAULTY_POSITION = 1
FAULTY_SPEED = 2

_MEMORY = _record(
    whole=(
        "force_rank",
        "located",
        "ticked",
        "fresh",
        "gap",
        "engaged",
        "hand_over",
        "reason",
        # see `safety`: ticks in this state, ticks in a row that were not computed, how many more of
        # those than of computed ones, ticks too fast, ticks that may repeat
        "state",
        "age",
        "faults",
        "lost",  # wrenches _e of lost directions
        "overspeed",
        "repeats",
        "cause",
        "settled",  # of a hold: BRAKED, SETTLED, or 0 where it begins
        "culprit",  # joint, arm or column of N that the cause is about
        "unbraked",  # joint that is stopped without any sound reading of it, or −1
        "above",  # whether holds that test the encoders stand above where the joints came to rest
        # see `sensors`: whether this tick has no wrench, ticks since the last one, whether one
        # was ever read, whether joints were
        "wrench_missing",
        "wrench_age",
        "has_wrench",
        "compared",
        "repeated",  # which readings of this tick are not new: JOINTS, WRISTS, OUTDATED
        "old_joints",
        "old_wrists",  # ticks since either was new
        "balanced",  # ticks in which wrists were compared with motor torques
        "instant",  # the same with lost ticks
        "stamped",  # `instant` from which on wrenches have stamps; 0: they have none
        "late",  # ticks by which wrenches are older than the readings of the joints
        "derived",  # whether speeds are estimated from positions: no second reading of a joint
        "given",  # GIVEN_POSE, GIVEN_TWIST: the object's pose, its twist too, need not be found
        # see `active_set`: whether the reference of the last tick named the active contacts;
        # whether force integrals stand in the columns, since others were in N
        "chosen_set",
        "by_column",
        "status",  # how the last tick ended
    ),
    number=(
        "more_friction",  # learned, beyond what is assumed
        "slid",  # s for which it was learned from contacts that slid with their desired forces
        "powered",
        "ending",  # see `safety`: s of too much power, s near the end of a joint
        "still",
        "frozen",  # s for which joints, and all sensors, have read the very same
        "apart",  # s for which arms have held the object at different places
        "mixed",  # s for which several joints have jumped in one packet
        "tested",  # s since the holds of a stop were last moved
        "missed",  # share of ticks that were not computed, low-passed
        "step_left",
        "step_time",  # share of a step's time that is left, and that time, see `commands`
        "squeeze_left",
        "squeeze_time",  # the same of a step of internal forces
        # see `ceilings`: N, the largest command so far of one contact, and of all beside squeezes;
        # s above each ceiling; the ceiling of a stop, and what was above it
        "largest_force",
        "largest_sum",
        "over_contact",
        "over_wrist",
        "over_tip",
        "ceiling",
        "reached",
    ),
    centre_speed=3,  # of the object's centre in the last tick (m/s), and its rate, low-passed
    centre_rate=3,
    X_WO=(4, 4),  # where no arm holds the object rigidly: the start of the next search
    vector=(
        "motion_sum",
        "f_tare",
        "f_bias",
        "force_sum",  # of the columns kept in the last tick
        "V_O",  # where it is given
    ),
)
CONTACT_MEMORY = _record(
    whole=("active", "phase", "held"),  # whether it was measured closed since it was open last
    number=("gain", "damping", "brake", "least", "since"),
)
COLUMN_MEMORY = _record(
    whole=(
        "closed",
        "collision",
        "known",
        "has_desired",  # whether a force was desired of it in the last tick
    ),
    number=(
        "low_for",
        "high_for",
        "burst",
        "armed_for",  # see `phases.monitor`
        "force",
        "filtered_speed",  # low-passed magnitude and speed
        "alpha",
        "speed",
        "net",  # of the last tick; net: without the inertia of what flies
        "underforce",
        "overforce",  # see `safety`: s of too little force, and of too much
        "desired",
        "scale",
        "drift",  # desired force, its size, lasting speed, see `commands`
        "driven",
        "deflection",
        "eased",
        "eased_rate",  # m/s, m, α_s (N, N/s): of a yielding face, see `commands`
        "yielded",
        "alpha_mean",
        "eased_mean",
        "correlation",
        "excitation",  # m, N, N, m N s, N² s: of what its compliance is learned
        "predicted",
        "gap",
        "time_since_loss",  # see `phases`: N to be read, m and s since it was lost
        "noise",  # N
        "integral",  # N, of the force law
        "touch",
        "explained",  # N, low-passed, of an approached column: see `witness`
        "unexplained",  # m/s, low-passed speed that the estimate of the normal does not explain
        "residual",  # (m/s)², its mean square
        "normal_std",  # rad, of that estimate where it is least certain; 0: none
        "velocity_from_positions",
        "velocity_from_encoders",  # low-passed NᵀV_rel, of positions and of speeds
    ),
    to_come=3,  # of a step, see `commands`
    turn=3,  # of the assumed normal, in the axes of its body, see `contact`
    tangential=3,  # force that friction does not explain (N), low-passed, see `reading`
    covariance=9,  # of that turn (rad²); 0: not estimated
)
#: of an internal force: what was desired last (N), its size, what is to come of a step
BAR_MEMORY = _record(number=("desired", "scale"), to_come=3)
#: what is known of a joint from its sensors, see `sensors`; `acceleration`: as commanded last
JOINT_MEMORY = _record(
    whole=(
        "faulty",  # FAULTY_POSITION, FAULTY_SPEED
        "unread_q",
        "unread_v",  # ticks since either was read
        "stuck",  # whether it should have moved by what was commanded
        "driven",  # whether friction cannot hold it against what was commanded
        # whether its last reading was a jump; how often its position has changed while the hold
        # stood where it does, and holds in a row that it has followed, see `sensors`
        "barred",
        "changes",
        "followed",
    ),
    number=(
        "q",
        "v",  # last read
        "hold",
        "way",  # that braking takes, from its speed when a hold began
        "acceleration",
        "pending",  # speed commanded since the position was last read, over lost ticks too
        "gained",  # speed commanded while the position stood still
        "error",
        "drift",  # of speeds from positions, low-passed; and summed
        # s for which the speed has been the very same, and how far the joint was seen to move
        # meanwhile; how far it should have moved by its speeds since the position last changed
        "same_speed",
        "moved",
        "due",
        # s for which the position has been the very same; where it was when the hold was last
        # moved, and how far it had gone since the time before
        "rested",
        "begun",
        "went",
        "step",  # its last change, and the share of changes that turned back, low-passed
        "turning",
        "model_v",
        "model_q",  # speeds predicted from those read, and from those of positions
        "surprise_v",
        "surprise_q",  # what of either was not predicted, low-passed
        # see `joint_friction`: torques that h inboard and the wrench take, last speed, its rate
        "past_weight",
        "load",
        "past_v",
        "rate",
        "residual",
        # permitted speed, the mean of its sign in this tick, its rate; friction compensated
        "speed",
        "sign",
        "turn",
        "friction",
        "unlearned",  # e
        # what of the residual is not compensated, low-passed, and its mean; s for which it has been
        # too large
        "unexplained",
        "usual",
        "unbalanced",
    ),
    trusted=3,  # F, D and |A| as learned for long, see `sensors`
    means=6,  # of `joint_friction`: what it observes of a tick, low-passed
)
PAST = _record(history=(HISTORY, 8))  #: of a joint, where wrenches have stamps
#: θ of a joint, the same without bounds, its covariance, variance of residuals; share of what is
#: learned that is applied; means low-passed once more; see `joint_friction`
FRICTION = _record(
    number=("noise", "evidence", "rested", "applied", "contradicted"),
    theta=5,
    estimate=5,
    P=(5, 5),
    smooth=6,
)
#: ticks since a wrist was read, s for which it has read the very same, and for which motors have
#: been doubtful; of a stopped arm, see `holding`: whether its load was read, whether it has let go
#: of the object, and the force that its wrist bears (N), low-passed
ARM_MEMORY = _record(whole=("unread", "weighed", "let_go"), number=("same", "doubtful"), load=3)

# What a tick works out --------------------------------------------------------------------------

#: Vectors are at O in world axes where nothing else stands beside them; `_e`: energy coordinates;
#: `_t`: these turned so that the first m axes are the locked ones.
_WORK = _record(
    whole=(
        # see `plausibility`: whether jumps were looked for, how many positions and speeds jump, and
        # one joint of each
        "looked",
        "jumps",
        "jumped",
        "speed_jumps",
        "speed_jumped",
        "rank",
        "locked",
        "count",
        "status",
        "reason",
        "where",
        "n_lost",
        "n_internal",
        "commanded",
        "moving",
        "weightless",
    ),
    number=(
        "reason_amount",  # the number that the sentence of a reason gives
        "dt",
        "mu",
        "more_friction",
        "slid",
        "step_left",
        "step_time",
        "squeeze_left",
        "squeeze_time",
        "integral_scale",
    ),
    # what recordings keep, side by side
    f_meas=6,
    bias_out=6,
    V_O=6,
    X_WO=(4, 4),
    f_c=6,
    error=6,
    free_error=6,
    p_C=3,  # centre of mass of the object
    p_O=3,  # operational point
    axes=(4, 3, 3),
    X_WD=(4, 4),
    beta=8,
    vector=(
        "V_D",  # with X_WD and A_D the reference of the last computed tick
        "A_D",
        "V_C",  # twist of the object at C
        "bias_links",
        "bias_e",
        "chain_bias",
        "sigma",  # _e, then _t
        "b_N",
        "V_N",
        "n_gamma",
        "alpha_d",
        "alpha_meas",
        "alpha_u",
        "reaction",  # what tangential forces take off it
        "speed",
        "gain",
        "damping",
        "brake",
        "least",
        "felt",  # what the force integral compares with alpha_d
        "reading_e",  # f_meas − bias_out
        "reading_rest",  # R⁻¹(f − N_μα) of least squares, see `reading.weigh_magnitudes`
        "motion_next",
        "force_next",
        "a_u",
        "acceleration_t",  # commanded to the object: S η̇_c + σ
        "f_S",
    ),
    matrix=(
        "Lambda",
        "effort",  # Λ_S and least effort, _e, then _t
        "out_T",  # Λ_out transposed, _e
        "reflectors",
        "N_e",
        "N_t",
        "pushed",
        "pushed_t",
        "friction_wrenches",
        # N = N_factor N_basis (rows), the basis orthonormal, see `algebra.orthonormalise`
        "N_basis",
        "N_factor",
        "N_basis_t",
        "N_factor_t",
        "Phi_mu",
        "mobility",
        "B_inv_t",
        "yields",  # NᵀΦ_e, at O
    ),
)
ARM_WORK = _record(
    whole=("n_locked", "n_kept", "wide", "n_lost"),
    tip=(4, 3),
    mode=(6, MAX_JOINTS),  # joints' motions of lost directions
    vector=(
        "reading",  # of its wrist
        "V",
        "drift",  # of the tip at C
        "bias",  # wrench of the outboard bodies at q̈ = 0, at C
        "gamma",  # drift, _e, as far as the grasp passes it on
        "chi",
        "share",
        "gone",  # of lost directions; gone: the chain counts them as locked
        "net",  # reading of its wrist at C less what moves and carries the bodies outboard of it
    ),
    matrix=(
        "passed",  # m of N, then 6 − m of T, orthonormal _e
        "filter",
        "Lambda",
        "effort",
        "resisted",  # orthonormal wrenches _e that its structure carries, n_locked of them
        "kept",  # orthonormal wrenches _e that the joints resist with their motors or inertia
        "lost",  # wrenches _e of lost directions
    ),
)
JOINT_WORK = _record(
    number=("q", "v", "h", "tau", "rest", "offset", "acceleration", "inertial", "friction"),
    R=(3, 3),
    p=3,
    body=13,
    M=MAX_JOINTS,
    vector=(
        "column",
        "J",
        "J_bar",
        "force",
        "outboard",
    ),
)
COLUMN_WORK = _record(
    whole=("shaped",),
    number=(
        "n_gamma",
        "extent",
        "alpha_d",
        "goal",
        "scale",
        "slides",
        "drift",
        "unexplained",
        "lever",
        "touch",
        "explained",  # N, see `witness`
    ),
    to_come=3,
    point=3,
    slip=3,  # of contact, from O; v_t / √(v_t² + v_0²) there
    turn=3,
    turned=3,  # of the assumed normal, and after this tick
    shown=3,  # direction in which sliding shows its error, in the same axes
    prior=9,  # covariance before anything has slid
    believed=3,  # that normal, into the body and in its axes, where no shape has it
    tangential=3,  # for the next tick
    vector=(
        "N",
        "friction_wrench",
        "energy",
        "rest",
        "share",
    ),
)
BAR_WORK = _record(number=("goal", "scale"), to_come=3)  #: goal: what is commanded (N)
BODY_WORK = _record(answer=48, motion=28)  #: Φ_e, b_e, V_e; X_WE, V_E, A_E

#: How a tick ends.
OK, SATURATED, HELD, DEGRADED = range(4)
#: What the controller does, see `safety`.
RUN, DEGRADED_STATE, HOLD, SAFE_STOP = range(4)

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
    priors=(PRIOR, "n"),  # last: read where friction is learned only
)
MEMORY = Nested(
    _MEMORY,
    contacts=(CONTACT_MEMORY, "c"),
    torques="a",  # given out last
    joints=(JOINT_MEMORY, "n"),
    arms=(ARM_MEMORY, "k"),
    q="n",
    v="n",  # as estimated, see `isolation.estimate_joints`
    friction_known=(_INT, "n"),  # see `joint_friction`
    wrenches=("k", 6),  # last read
    squeeze="squeezes",  # internal forces that are desired (N)
    internal=(BAR_MEMORY, "squeezes"),  # see `commands`
    friction=(FRICTION, "n"),  # used where friction is learned only
    past=(PAST, "n"),  # used where wrenches have stamps only
    columns=(COLUMN_MEMORY, "r"),  # last: pairs in Python may change r
)
WORK = Nested(
    _WORK,
    arms=(ARM_WORK, "k"),
    joints=(JOINT_WORK, "n"),
    columns=(COLUMN_WORK, "r"),
    bodies=(BODY_WORK, "c"),
    locked_rows=("6k", 7),  # of all arms: unit wrenches _e and their rates
    tau="a",
    step="a",  # of the motors, and the most that they may change by
    # of all columns of N: goals (N), whether they are in force; magnitudes, NᵀV_rel; numbers of
    # those in force, and of those kept
    goal="r",
    here="r",
    alpha="r",
    speeds="r",
    chosen=(_INT, "r"),
    kept=(_INT, "r"),
    # of the torque allocation, see there: E, R⁻¹Eᵀ, the factor of Z, b; and of a row of E that may
    # depend on those before it the multipliers of these, its rest and this weighed by R⁻¹. Their
    # sizes are those of the model, so that they do not stand on the stack.
    extra=("e", "n"),
    weighed=("e", "n"),
    factor=("6e", "6e"),
    sides="6e",
    multipliers="6e",
    rest="n",
    rest_weighed="n",
    # of internal forces, see `commands` and `allocation.settable_bars`
    internal=(BAR_WORK, "squeezes"),
    bars="squeezes",
    points=("k", 3),
    owners=(_INT, "6k"),
    carried=("6k", 3),
    levers=("bars", "n"),
    basis=("bars", "bars"),
    bar_inverse=("bars", "bar_row"),
    bar_effects=("bars", "effect_row"),
    bar_torques=("bars", "n"),
    moving_torques=(_FLOAT, 6, "n"),
)
#: What came in at a tick.
INPUT = Nested(
    _record(
        # whether motions of the touched bodies were measured, and active contacts are named
        whole=("moving", "chosen_set"),
        X_WD=(4, 4),
        V_D=6,
        A_D=6,  # the reference
    ),
    q="n",
    v="n",
    wrenches=("k", 6),
    alpha_d="r",
    touched=("c", 28),  # X_WE by rows, V_E, A_E of the bodies
    active="c",  # 1: in the active set, 0: not
)
#: What a call of `tick.rows` is to do: parts of the tick, rows; where their bytes are.
JOB = Nested(
    _record(
        whole=(
            "switches",
            "begin",
            "stop",
            "first",
            "last",
            "count",
            "model",
            "model_step",
            "memory",
            "work",
            "input",
        )
    )
)

#: What the parts of a tick take: four records.
Tick = namedtuple("Tick", "model memory work input")


# --- The bytes of one controller, and its records as views ----------------------------------------

_job, _model, _memory, _work, _input = (kind.at for kind in (JOB, MODEL, MEMORY, WORK, INPUT))


@leaf
def row_of(raw, at, i):
    """The records of a row.

    Args:
        raw: bytes of `Rows`. at: where the JOB of a thread is. i: which row.
    """
    job = _job(raw, at)
    model = _model(raw, job.model + i * job.model_step)
    memory = _memory(raw, job.memory + i * model.memory_bytes)
    return Tick(model, memory, _work(raw, job.work), _input(raw, job.input))


@leaf
def contact_of(t, column):
    """CONTACT_MEMORY of the contact that a column of N belongs to."""
    return t.memory.contacts[t.model.columns[column].contact]


@leaf
def body_of(t, column):
    """BODY that a column of N presses on."""
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
    """Sizes of all tables: arms, joints, motors, contacts, shapes, columns; and what follows."""
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
    """A row of MODEL in which nothing stands but how many there are of everything.

    Args:
        arms, joints, motors, contacts, shapes, columns: how many there are of each.
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
    """Controllers of one structure in one run of bytes, which `tick.rows` works on.

    Attributes:
        numbers, raw: all of it, as numbers and as bytes.
        model, memory: (rows, size) MODEL and MEMORY of each row; where all MODELs are the same, one
            that all rows share and nobody writes to.
        jobs, work, input: (threads, size) JOB, WORK and INPUT of each thread.
        starts: where the JOB of each thread is.
        job: JOB of the first thread.
    """

    def __init__(self, model: Bytes, memory: Bytes | None = None, threads: int = 1) -> None:
        """Copy models and memories.

        Args:
            model, memory: (rows, size) bytes; memory None: as new. threads: that share them.
        """
        model = np.atleast_2d(model)
        head = MODEL.view(model[0])
        counts = _counts(**{size: int(head[COUNTED[size]]) for size in "knacsr"})
        if memory is None:
            memory = np.tile(MEMORY.new(counts), (len(model), 1))
        shared = len(model) > 1 and (model == model[0]).all()
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
    """The records of a row, as the law's parts take them.

    Args:
        rows: controllers. i: which. thread: whose WORK and INPUT.
    """
    return Tick(
        MODEL.view(rows.model[i]),
        MEMORY.view(rows.memory[i]),
        WORK.view(rows.work[thread]),
        INPUT.view(rows.input[thread]),
    )
