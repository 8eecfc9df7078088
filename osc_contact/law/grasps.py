"""Grasps that permit motions: transmitted wrenches, and pose and twist of the object they hold."""

from __future__ import annotations

from math import atan2, cos, sin, sqrt

from osc_contact.law.algebra import (
    cholesky,
    cholesky_solve,
    dot,
    forward,
    one_sided_jacobi,
    orthonormalise,
)
from osc_contact.law.arm_motion import place_frame, turn_axes
from osc_contact.law.commands import rotation_vector
from osc_contact.law.jit import inner, leaf, local
from osc_contact.law.records import BALL, HINGE, JOINTS_AND_SIX, MAX_JOINTS
from osc_contact.law.vectors import (
    ZERO,
    accumulate,
    add,
    add3,
    add_square,
    angular,
    carry_motion,
    carry_wrench,
    combined,
    cross,
    divided3,
    dot3,
    dot6,
    energy_motion,
    energy_wrench,
    fill,
    fill3,
    join,
    minus,
    minus3,
    origin,
    plus,
    plus3,
    rotated,
    rotated_back,
    scaled,
    set_axes,
    set_identity,
    times6,
    transformed,
    world_motion,
    world_wrench,
)

# --- Transmitted wrenches, slip of the object in its grasps, wrist filters ------------------------

KNOWN = 1e-6  #: least relative pivot at which the grasps determine the object's motion
_MOVES = 1e-7  #: relative wrench of the outboard links' own motion that counts as zero


@inner
def grasp_rows(arm, work, C, axes, out):
    """Fill N and T of a grasp in energy coordinates, at the object's centre of mass.

    N (m, 6) are the wrenches that the grasp transmits, T (6 − m, 6) the motions that it permits.

    Args:
        arm: ARM row, whose `grasp` (6, 6) has the rows of N, then of T, at the tip and in its axes.
        work: its ARM_WORK, of which `tip` is read (axes and point of the tip).
        C: (3,) centre of mass of the object (m).
        axes: energy coordinates, from `set_axes`.
        out: (6, 6), filled with m rows of N, then 6 − m rows of T.
    """
    tip = work.tip
    for a in range(6):
        row = arm.grasp[a]
        x = join(rotated(tip, row), rotated(tip, row[3:]))
        if a < arm.m:
            fill(out[a], energy_wrench(axes, carry_wrench(x, tip[3], C)))
        else:
            fill(out[a], energy_motion(axes, carry_motion(x, tip[3], C)))


@inner
def find_twist(t, is_given):
    """Compute orthonormal N and T of grasps that are not rigid, and the twist of the object at C.

    N (m, 6) are the wrenches that a grasp transmits, T (6 − m, 6) the motions that it permits. With
    a leader (an arm that holds rigidly) the object moves with its tip. Without one, the twist V
    fulfils the velocity conditions NᵀV = NᵀV_tip of all grasps by least squares, in energy
    coordinates. Reads `axes`, `p_C`, R and p of the joints, V of the arms. Fills `tip` and `passed`
    (N, then T) of each arm whose grasp permits motions, and `V_C` unless it is given.

    Args:
        t: Tick.
        is_given: whether the twist is an input, from which the caller fills `V_C`.

    Returns:
        False if the grasps do not determine the twist.
    """
    model = t.model
    work = t.work
    factor = local(6, 6)
    A = local(6, 6)  # normal equations A y = x; x becomes their solution
    x = local(6)
    fill(x, ZERO)
    A[:] = 0.0
    for k in range(model.n_arms):
        arm = model.arms[k]
        row = work.arms[k]
        if arm.m == 6:
            continue
        # N and T of the grasp at the present tip, made orthonormal
        place_frame(work.joints[arm.tip_joint], arm.tip, row.tip, row.tip[3])
        grasp_rows(arm, row, work.p_C, work.axes, row.passed)
        motions = row.passed[arm.m :]
        if not orthonormalise(row.passed, arm.m, 0, row.passed, factor) > 0.0:  # also if NaN
            return False
        if not orthonormalise(motions, 6 - arm.m, 0, motions, factor) > 0.0:  # also if NaN
            return False
        if model.leader < 0 and not is_given:  # conditions NᵀV = NᵀV_tip
            twist = energy_motion(work.axes, row.V)
            for a in range(arm.m):
                _add_condition(row.passed[a], dot6(row.passed[a], twist), A, x)
    if is_given:
        return True
    if model.leader >= 0:
        fill(work.V_C, work.arms[model.leader].V)
        return True
    if not cholesky(A, 0, 6, factor) > KNOWN:  # also if NaN
        return False
    cholesky_solve(factor, 6, x)
    fill(work.V_C, world_motion(work.axes, x))
    return True


@leaf
def _add_condition(row, s, A, x):
    """Add the condition rᵀy = s on the unknown y to the normal equations A y = x.

    A ← A + r rᵀ and x ← x + s r.

    Args:
        row: (6,) r, dimensionless in energy coordinates.
        s: right side of the condition.
        A: (6, 6) matrix of the normal equations, changed.
        x: (6,) their right side, changed.
    """
    add_square(1.0, row, A)
    accumulate(x, s, row)


@inner
def add_slip(V, V_C, gamma):
    """Add V × V_C to the drift γ of an arm, for an object that slips in its grasp.

    The wrenches of the grasp move with the tip, of twist V, not with the object, of twist V_C. Of
    the spatial cross product each term is added separately.

    Args:
        V: (6,) twist of the tip at C.
        V_C: (6,) twist of the object at C.
        gamma: (6,) drift of the tip at C (m/s², rad/s²), changed.
    """
    linear = plus3(plus3(gamma, cross(V[3:], V_C)), cross(V, V_C[3:]))
    fill(gamma, join(linear, plus3(gamma[3:], cross(V[3:], V_C[3:]))))


@inner
def filter_outboard(t, arm, arm_work, bias):
    """Add the inertia Λ_out (transposed) and the bias of a gripper that can move by itself.

    P (6, n) has the wrenches of the outboard bodies per joint acceleration. A motion of the joints
    that does not move the object adds E = P(1 − J̄J) (6, n) to the wrist reading, with the Jacobian
    J (6, n) and its inertia-weighted inverse J̄ (n, 6). The filter F = 1 − E(T E)⁺T (6, 6) removes
    it, where singular values of T E exceed `_MOVES` times the largest element of P: T (6 − m, 6)
    are the motions that the grasp permits beside m forces, along which no force of the object acts.
    The bias becomes that at a = 0 of the object, where q̈ = −J̄ γ with the drift γ = `gamma`. Reads
    `passed` (T behind m rows), `gamma`, J, J̄ and `outboard` (P, at C in world axes, changed to
    energy coordinates as all other operands). Fills `filter` (F); adds to `out_T`, `bias_e`.

    Args:
        t: Tick.
        arm: ARM row.
        arm_work: its ARM_WORK.
        bias: (6,) wrench of the outboard bodies at q̈ = 0, at C, overwritten.
    """
    work = t.work
    F = arm_work.filter
    T = arm_work.passed[arm.m :]
    n = arm.end - arm.first
    count = 6 - arm.m
    H = local(6, 6)  # P J̄
    G = local(MAX_JOINTS, 6)  # rows: the columns of E
    X = local(6, JOINTS_AND_SIX)  # T E, behind it the identity
    _multiply_outboard(t, arm, arm_work, bias, H)
    # E = P − H J by columns, and the singular value decomposition of T E
    largest = 0.0
    for j in range(n):
        P = work.joints[arm.first + j].outboard
        fill(G[j], minus(P, times6(H, work.joints[arm.first + j].J)))
        for a in range(6):
            largest = max(largest, abs(P[a]))
    for a in range(count):
        for j in range(n):
            X[a, j] = dot6(T[a], G[j])
        for b in range(count):
            X[a, n + b] = 1.0 if a == b else 0.0
    one_sided_jacobi(X, count, n, count)  # row k of X becomes σ vᵀ (n), and behind it uᵀ
    set_identity(F)  # F = 1 − Σ (E v/σ)(uᵀT) over the singular values σ of T E
    for k in range(count):
        square = dot(X[k], X[k], n)
        if not sqrt(square) > _MOVES * largest:  # also if NaN
            continue
        own_reading = combined(X[k], G, n)
        detector = combined(X[k, n:], T, count)
        for a in range(6):
            accumulate(F[a], -own_reading[a] / square, detector)
    fill(work.bias_e, plus(work.bias_e, times6(F, bias)))
    for a in range(6):
        x = combined(F[a], H, 6)  # row of Λ_out = F H
        for b in range(6):
            work.out_T[b, a] += x[b]


@leaf
def _multiply_outboard(t, arm, arm_work, bias, H):
    """Compute H = P J̄, the wrench of an arm's outboard bodies per acceleration of the object.

    P (6, n) = `outboard` of the joints has these wrenches per joint acceleration, J̄ (n, 6) is the
    inertia-weighted inverse of the Jacobian. P and bias are converted from world axes at C to
    energy coordinates, and −P J̄ γ is added to the bias, with γ (6,) = `gamma` the drift of the tip.

    Args:
        t: Tick.
        arm: ARM row.
        arm_work: its ARM_WORK.
        bias: (6,) wrench of these bodies at q̈ = 0, changed to that at q̈ = −J̄γ.
        H: (6, 6), filled.
    """
    work = t.work
    H[:] = 0.0
    fill(bias, energy_wrench(work.axes, bias))
    for j in range(arm.first, arm.end):
        P = work.joints[j].outboard
        bar = work.joints[j].J_bar
        fill(P, energy_wrench(work.axes, P))
        accumulate(bias, -dot6(bar, arm_work.gamma), P)
        for a in range(6):
            accumulate(H[a], P[a], bar)


@inner
def filter_reading(axes, F, reading):
    """Wrist reading without the gripper's own motion: F times the reading, six numbers at C.

    Args:
        axes: energy coordinates, from `set_axes`.
        F: (6, 6) filter of the grasp from `filter_outboard`, in energy coordinates.
        reading: (6,) wrench at C, world axes.
    """
    return world_wrench(axes, times6(F, energy_wrench(axes, reading)))


# --- Pose of an object that no arm holds rigidly, from the conditions of all grasps ---------------


@inner
def rotate(X, w):
    """Rotate the rotation matrix R in X by a rotation vector w: R ← exp([w×]) R (Rodrigues).

    Args:
        X: at least (3, 3), changed in its first three rows and columns.
        w: (3,) rad, world axes.
    """
    angle = sqrt(dot3(w, w))
    a = 1.0  # sin φ/φ and (1 − cos φ)/φ², or their limits at φ = 0
    b = 0.5
    if angle > 1e-6:
        a = sin(angle) / angle
        b = (1.0 - cos(angle)) / (angle * angle)
    for j in range(3):
        x = cross(w, (X[0, j], X[1, j], X[2, j]))
        y = cross(w, x)
        for i in range(3):
            X[i, j] += a * x[i] + b * y[i]


@inner
def _square_up(X):
    """Orthonormalise the columns of the rotation matrix in X, against accumulated rounding errors.

    The first column keeps its direction, the second one its plane with the first.

    Args:
        X: at least (3, 3), changed in its first three rows and columns.
    """
    x = (X[0, 0], X[1, 0], X[2, 0])
    y = (X[0, 1], X[1, 1], X[2, 1])
    x = divided3(x, sqrt(dot3(x, x)))
    y = add3(y, -dot3(x, y), x)
    y = divided3(y, sqrt(dot3(y, y)))
    z = cross(x, y)
    for i in range(3):
        X[i, 0] = x[i]
        X[i, 1] = y[i]
        X[i, 2] = z[i]


@inner
def _grasp_miss(arm, tip, X, out):
    """Fill the position error of the object in a hinge or a ball joint, along the rows of N.

    N (m, 6) are the wrenches that the grasp transmits, in the axes of the tip.

    Args:
        arm: ARM row.
        tip: (4, 3) axes and point of the tip.
        X: (4, 4) pose of the object.
        out: (6,), filled with three distances (m), and for a hinge with two angles (rad), too.
    """
    fill3(out, rotated_back(tip, transformed(minus3(origin(X), tip[3]), X, arm.point)))
    if arm.kind == BALL:
        return
    u = rotated_back(tip, rotated(X, arm.axis))  # the object's axis, in the tip's axes
    x = cross(arm.tip_axis, u)
    sine = sqrt(dot3(x, x))
    ratio = 1.0  # angle between both axes over its sine
    if sine > 1e-12:
        ratio = atan2(sine, dot3(arm.tip_axis, u)) / sine
    for b in range(3, 5):  # the rows of N that are couples
        out[b] = ratio * dot3(arm.grasp[b][3:], x)


@inner
def _miss_of_group(arm, tip, X, out):
    """Fill the position error of the object in a grasp with the permitted motions T.

    The permitted part of the displacement is removed iteratively, along the rows of T in
    `arm.grasp[m:]`. They are orthonormal in metres and radians; these units affect the iteration,
    but not a result of zero. It ends at rounding errors, 1e-14, or after 30 steps.

    Args:
        arm: ARM row.
        tip: (4, 3) axes and point of the tip.
        X: (4, 4) pose of the object.
        out: (6,), filled along the rows of N (m, rad).
    """
    R = local(3, 3)
    p = local(3)
    for j in range(3):  # the object's grasp frame in the tip: R rotation, p point
        row = rotated_back(tip, rotated(X, arm.X_TO[3 * j :]))  # R X_TOᵀ
        for i in range(3):
            R[i, j] = row[i]
    p_O = rotated_back(tip, minus3(origin(X), tip[3]))
    fill3(p, minus3(p_O, rotated(R, arm.X_TO[9:])))
    for _ in range(30):
        displacement = _log_displacement(p, R)
        largest = 0.0
        step = ZERO
        for a in range(arm.m, 6):
            s = dot6(arm.grasp[a], displacement)
            step = add(step, s, arm.grasp[a])
            largest = max(largest, abs(s))
        if largest < 1e-14:
            break
        _displace(R, p, scaled(-1.0, step))
    fill(out, times6(arm.grasp, _log_displacement(p, R)))


@inner
def _log_displacement(p, R):
    """Compute the logarithm of a displacement (R, p): the twist that causes it in unit time.

    With the rotation vector w of R and θ = |w|, the twist is (p − ½ w × p + c w × (w × p), w) with
    c = (1 − ½ θ sin θ/(1 − cos θ))/θ². Its reference point is the tip's origin.

    Args:
        p: (3,) translation (m).
        R: (3, 3) rotation matrix.

    Returns:
        Six numbers (m, rad).
    """
    w = rotation_vector(R)
    square = dot3(w, w)
    c = 1.0 / 12.0 + square / 720.0  # series of c near θ = 0
    if square > 1e-4:
        angle = sqrt(square)
        c = (1.0 - 0.5 * angle * sin(angle) / (1.0 - cos(angle))) / square
    x = cross(w, p)
    return join(add3(add3(p, -0.5, x), c, cross(w, x)), w)


@inner
def _displace(R, p, twist):
    """Multiply a displacement by an exponential: (R, p) ← (R, p) exp(twist).

    The exponential is the displacement by a twist in unit time, about the tip's origin.

    Args:
        R: (3, 3) rotation matrix, changed.
        p: (3,) translation (m), changed.
        twist: (6,) m, rad.
    """
    w = angular(twist)
    square = dot3(w, w)
    b = 0.5 - square / 24.0  # their series near 0
    c = 1.0 / 6.0 - square / 120.0
    if square > 1e-4:
        angle = sqrt(square)
        b = (1.0 - cos(angle)) / square
        c = (angle - sin(angle)) / (angle * square)
    x = cross(w, twist)
    step = add3(add3(twist, b, x), c, cross(w, x))
    fill3(p, plus3(p, rotated(R, step)))
    rotate(R, rotated(R, w))  # R exp[w] = exp[R w] R


@inner
def centre_object(t, X):
    """Fill operational point `p_O`, centre of mass `p_C` and `axes` of energy coordinates.

    `X_LP` (12,) of MODEL is the frame of its principal axes in the object's frame: rotation by
    rows, then the centre of mass (m); `roots` are the square roots of mass and principal moments.

    Args:
        t: Tick.
        X: (4, 4) pose of the object.
    """
    model = t.model
    work = t.work
    fill3(work.p_O, origin(X))
    fill3(work.p_C, transformed(work.p_O, X, model.X_LP[9:]))
    R = local(3, 3)
    turn_axes(X, model.X_LP, R)
    set_axes(R, model.roots, work.axes)


@inner
def find_object(t, X):
    """Find the pose of the object that fits all grasps, by Gauss–Newton in the energy metric.

    Each step is the motion that removes the position errors along the wrenches of all grasps, by
    least squares in energy coordinates. Reads R and p of the joints. Fills `p_O`, `p_C`, `axes`,
    and `tip` of the arms; `passed` of the arms is that of the last iteration.

    Args:
        t: Tick.
        X: (4, 4) pose from which the search starts, overwritten with the result.

    Returns:
        False if the grasps do not determine the pose, or if the iteration does not converge.
    """
    arms = t.model.arms
    work = t.work
    factor = local(6, 6)
    A = local(6, 6)  # normal equations A y = x; x becomes their solution
    x = local(6)
    r = local(6)  # position errors of one grasp along the wrenches that it transmits
    for k in range(t.model.n_arms):
        arm_work = work.arms[k]
        place_frame(work.joints[arms[k].tip_joint], arms[k].tip, arm_work.tip, arm_work.tip[3])
    _square_up(X)
    size = 1.0
    for _ in range(50):
        # normal equations of the position errors of all grasps
        centre_object(t, X)
        fill(x, ZERO)
        A[:] = 0.0
        for k in range(t.model.n_arms):
            arm = arms[k]
            arm_work = work.arms[k]
            if arm.kind == BALL or arm.kind == HINGE:
                _grasp_miss(arm, arm_work.tip, X, r)
            else:
                _miss_of_group(arm, arm_work.tip, X, r)
            grasp_rows(arm, arm_work, work.p_C, work.axes, arm_work.passed)
            if (
                not orthonormalise(arm_work.passed, arm.m, 0, arm_work.passed, factor) > 0.0
            ):  # also if NaN
                return False
            forward(factor, arm.m, r)  # along the orthonormal rows
            for a in range(arm.m):
                _add_condition(arm_work.passed[a], -r[a], A, x)
        if not cholesky(A, 0, 6, factor) > KNOWN:  # also if NaN
            return False
        # the step turns and moves the object about O
        cholesky_solve(factor, 6, x)
        step = carry_motion(world_motion(work.axes, x), work.p_C, work.p_O)
        rotate(X, step[3:])
        size = 0.0  # largest element of the step (m, rad)
        for i in range(6):
            size = max(size, abs(step[i]))
            if i < 3:
                X[i, 3] += step[i]
        if not size > 1e-15:  # also if NaN
            break
    centre_object(t, X)
    return size < 1e-12
