"""The arrays a tick works on, by their row in the table of bound arrays, and what is where in them.

r_all columns of N, n joints, k arms, c contacts. Integers first, then what the controller knows,
then its state, then what the tick leaves behind, then scratch.
"""

from __future__ import annotations

__all__: list[str] = []

(
    SIZES,  # (1, 16) integers, see below
    ARMS_I,  # (k, 4) first joint, one past the last, pose rows of tip and sensor (−1: none)
    JOINTS_I,  # (n, 2) what of the link is outboard (0, 1: all, 2: a part); motor number or −1
    PAIRS_I,  # (pairs, 6) see `contact`
    COLUMNS_I,  # (r_all, 1) contact of each column
    BODIES_I,  # (c, 2) kind of the touched body, see `environment`; its number
    HEAD,  # constants, see below
    ARMS,  # (k, 17) tip point in its joint (0:3), sensor in its: rotation (3:12), point (12:15),
    # mass of the heaviest arm (15), motions it can make (16)
    JOINTS,  # (n, 27) link (0:10), outboard part (10:20), τ_max² (20), 1/τ_max² (21), posture (22),
    # near its limits: where margins begin (23, 24), their width (25), greatest push (26)
    SHAPES,  # (…, 16) see `contact`
    BODIES,  # (c, 48) see `environment`
    METRIC,  # (6, 6) B⁻¹ given by the user, world axes at O
    M,  # (n, n) Pinocchio's
    J,  # (n, 6) Pinocchio's, transposed
    POSE,  # (n + 1, 12) Pinocchio's oMi: rotation column by column, then position
    STATE,  # what a tick hands on to the next, see below
    SIGNALS,  # what a tick leaves behind, see below
    COLUMNS,  # (9, r_all) rows: see below, ALPHA_D …
    N_O,  # (r_all, 6) columns of N at O, world axes
    TAU,  # (n_a,)
    TAU_MAX,  # (n_a,)
    TOUCHED,  # (c, 28) X_WE, V_E, A_E
    JOINT_ROWS,  # (5, n, 6) see `model.add_arm`
    SQUARES,  # (14, 6, 6) see below, LAMBDA …
    ARM_SQUARES,  # (k, 6, 6)
    ROWS,  # (36, 8) see below, C …
    LOCKED,  # (6 k + 1, 7)
    LINKS,  # (n + 1, 10)
    TRIANGLE,  # (10, 10)
    HOUSEHOLDER,  # (10, 20)
    Q_FACTOR,  # (10, 10)
    CONTACT_ROWS,  # (8, r_all + 6, 6) see below, ALL …
    SHARE,  # (6, r_all + 6) R
    AXES,  # (4, 3, 3)
    JOINT_VECTORS,  # (4, n) of all joints: h, τ, w with q̈ = J̄a + w, and q̈ as commanded
    ANSWERS,  # (c, 48)
    INPUTS,  # of the last computed tick, see `inputs.keep`; at its end STATE as it found it
    KEEP,  # (r_all + 6, 2) integers: the columns of N that were kept; those in force
    STACK_Q,  # (10, 10) scratch
    WIDE,  # (16,) scratch
    TOUCHED_BEFORE,  # TOUCHED as the last computed tick saw it
    GRASPS_I,  # (k, 4) integers, see `grasp`
    GRASPS,  # (k, 64) see `grasp`
    TIPS,  # (k, 4, 3) scratch
    PASSED,  # (k, 6, 6) N and T of each grasp, white, orthonormal rows
    FILTERS,  # (k, 6, 6) of the wrist readings, white
    TERMS,  # (c, 4) in N or out of it, integral gain, damping, least command
    TERMS_BEFORE,  # TERMS as the last computed tick saw them
) = range(48)
COUNT = 48

# SIZES
N_JOINTS, N_ARMS, N_MOTORS, N_COLUMNS, N_PAIRS, N_CONTACTS, HELD, METRIC_KIND, N_LOCKED = range(9)
SLIPPING, LEADER = 14, 15  # whether some grasp permits motions; arm that holds rigidly or −1
BY_OBJECT, BY_CHAIN, BY_MATRIX = range(3)

# kinds of grasps
RIGID, HINGE, BALL = range(3)

# HEAD
GRAVITY, ROOTS, PRINCIPAL = 0, 3, 7  # g (3), √ of mass and principal moments (4), those squared (4)
X_JO, X_JP = 11, 23  # O and the principal axes in the leader's joint: rotation by rows, point
# (with no leader X_JP holds the principal axes in the object's frame)
TOLERANCE, STIFFNESS, DAMPING, INTEGRAL, PERIOD = range(35, 40)
POSTURE_STIFFNESS, POSTURE_DAMPING = 40, 41
GYRATION, FADING = 42, 43  # m², of the reference ball; 1/χ⁴ at which commands begin to fade
FRICTION, SLIP = 44, 45  # μ (0: none is reckoned with) and v_0, see `control.friction`
HEAD_SIZE = 46

# STATE: ∫e dt (6), f_tare (6), f_bias (6), ∫(α_d − α) dt (6) and how many of them count
ERROR_SUM, TARE, BIAS, FORCE_SUM, FORCE_RANK, STATE_SIZE = 0, 6, 12, 18, 24, 25

# SIGNALS
F_MEAS, BIAS_OUT, V_O, X_WO, F_C, ERROR, FREE_ERROR, A_U = 0, 6, 12, 18, 34, 40, 46, 52
SQUEEZE, LOCKED_AXES, RANK = 58, 59, 60
ERROR_SUM_NEXT, FORCE_SUM_NEXT, SIGNALS_SIZE = 61, 67, 80

# COLUMNS
ALPHA_MEAS, ALPHA_U, ALPHA_D, N_GAMMA, SPEED, SIZE, GAIN, DAMP, LEAST_U = range(9)

# what the tick returns
# (and 4 r behind them, r the independent columns of N)
OK, SATURATED, ASK = range(3)  # ASK: no plain verdict; the readable path decides

# SQUARES
LAMBDA, EFFORT, OUT_T, ARM, B_INV, PHI_N, GRAM, GRAM_L, WORK, FACTOR, MORE, LEAST = range(12)
MOBILITY, PHI_MU = 12, 13  # D of the force filter, see `force.contact_magnitudes`; NᵀΦ_eN_μ

# ROWS: vectors of up to 8 elements
(
    CENTRE, O, R_0, R_1, R_2, POINT, LINE, V, DRIFT, GAMMA, OWN_0, OWN_1, ALONG_0, ALONG_1,
    EFFORT_0, EFFORT_1, BIAS_LINKS, BIAS_WHITE, CHAIN, WEIGHT, SIGMA, BETA, DIAGONAL, WORLD,
    X, RHO, F_S, Z, Y, SCRATCH, B_N, V_N, ALPHA, TOTAL,
) = range(34)  # fmt: skip
N_ROWS = 36

# CONTACT_ROWS
# (N white, N_μ white and later turned, drags of all columns and of the kept ones at O)
ALL, REST, KEPT, TURNED, SOLVED, PUSHED, DRAGS, DRAG = range(8)

# kinds of contact pairs and of touched bodies
POINTS, FACE_ON_VERTEX, EDGES, TANGENTS, GIVEN = range(5)
UNYIELDING, CONVEYOR, CART, ELSEWHERE = range(4)
