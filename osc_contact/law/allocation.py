"""Motor torques for a commanded object force and internal forces: least torques, forces in bars."""

from __future__ import annotations

from math import inf, isfinite, sqrt

from osc_contact.law.algebra import (
    add_scaled,
    backward,
    cholesky,
    cholesky_solve,
    dot,
    forward,
    one_sided_jacobi,
)
from osc_contact.law.arm_motion import place_point
from osc_contact.law.chain import UNACTUATED
from osc_contact.law.jit import inner, leaf, local
from osc_contact.law.operational import null_motions, retreat
from osc_contact.law.reasons import NO_REASON
from osc_contact.law.records import MAX_JOINTS
from osc_contact.law.vectors import (
    ZERO,
    add,
    divided3,
    dot3,
    dot6,
    fill,
    fill3,
    minus3,
    plus,
    rotated_back,
    scaled3,
    times6,
    turned,
    turned_back,
    wrench_to_energy,
)

# --- Two grasps and more: forces in the bars of a virtual linkage ---------------------------------
#
# A bar joins each pair of grasp points, in the order (1, 2), (1, 3), …, (k − 1, k), and carries t,
# positive where the arms compress it (Williams and Khatib, "The virtual linkage: a model for
# internal forces in multi-grasp manipulation", IEEE ICRA 1993). With e the unit vector from grasp
# i to grasp j, arm i adds t e to the force it exerts on the object and arm j −t e: f = E t, a
# field without resultant. Back from forces, t = E⁺f; all of it is newtons, so that the least
# squares in E⁺ weigh no metre. Bars that depend on one another (four grasps in a plane, three in
# a line) share what E⁺ gives them. Two grasps have one bar, and its force is their squeeze.
#
# Everything is done on rows: rotations that make the rows of a matrix orthogonal (one-sided Jacobi)
# are the left factor of its SVD, and whatever stands behind the rows is rotated along.

_NO_BAR = 1e-9  # m: grasps nearer than this are the same point
_DEPENDENT = 1e-9  # of the longest: rows of which less is left are rounding errors


@inner
def settable_bars(t, n_locked):
    """Combinations of bar forces that the motors can set at will, and the levers of the bars.

    Left out are dependent bars, forces that the arms' structure carries whatever the motors do, and
    forces that no torques in null(G) make: what hinges and balls do not pass on, or passive joints
    do not resist. Reads `points`, `carried` and `owners`, J̄ of the joints. Fills `levers`: E⁺J̄ᵀ,
    force in the bars by 1 N m (or N) of joint torques that accelerate nothing; and `basis`:
    orthonormal columns, never more than 3k − 6, the identity if these are all bars.

    The tables below have the sizes of the model and stand in WORK, where no other function reads
    them: `bar_inverse` (E⁺ by rows), `bar_effects` (forces in the bars by locked wrenches and by
    joints), `bar_torques` (torques that the bars feel), `moving_torques` (that move the object).

    `angle_tolerance` is what counts as zero: singular values of E relative to the largest, those of
    the locked forces in the bars, and cosines between torques and null(G).

    Args:
        n_locked: rows of `carried`, ≤ 6k.

    Returns:
        s, how many columns of `basis` are filled.
    """
    work = t.work
    k = t.model.n_arms
    n = t.model.n_joints
    tolerance = t.model.angle_tolerance
    levers = work.levers
    basis = work.basis
    bars = k * (k - 1) // 2
    behind = n_locked + n
    X = work.bar_inverse
    Y = work.bar_effects
    Z = work.bar_torques
    Q = work.moving_torques
    _place_bars(k, bars, work.points, X)
    one_sided_jacobi(X, bars, 3 * k, bars)
    rank = _invert(X, bars, 3 * k, bars, tolerance)
    _dot_forces(t, rank, X, n_locked, Y)
    for bar in range(bars):
        for j in range(n):
            levers[bar, j] = 0.0
        for row in range(rank):
            Y[row, behind + bar] = X[row, 3 * k + bar]
            for j in range(n):
                levers[bar, j] += X[row, 3 * k + bar] * Y[row, n_locked + j]
    if k == 2:  # its row shows whether the grasps pass it on, see `add_row`
        basis[0, 0] = 1.0
        return rank
    count = rank
    if n_locked > 0:
        one_sided_jacobi(Y, rank, n_locked, n + bars)
        count = _keep(Y, rank, n_locked, behind + bars, -1.0, tolerance * tolerance)
    # torques by their effort: Q spans those that move the object, Z those that the bars feel
    for j in range(n):
        effort = sqrt(t.model.joints[j].effort)
        driven = turned(work, work.joints[j].J_bar)
        for row in range(6):
            Q[row, j] = driven[row] * effort if row >= work.locked else 0.0
        for row in range(count):
            Y[row, n_locked + j] *= effort
            Z[row, j] = Y[row, n_locked + j]
    moving = _orthonormalise(Q, 6, n, _DEPENDENT)
    felt = _orthonormalise(Z, count, n, _DEPENDENT)
    for row in range(felt):
        _take_out(Q, moving, n, Z[row])
    # by the angle to null(G): an arm near a singular posture makes some forces all too easily
    one_sided_jacobi(Z, felt, n, 0)
    s = _keep(Z, felt, n, n, tolerance * tolerance, inf)
    if s < count:
        _make_forces(s, count, bars, n, Z, Y[:, n_locked:], X)
        _orthonormalise(X, s, bars, 0.0)
    for bar in range(bars):
        for c in range(s):
            if s == bars:
                basis[bar, c] = 1.0 if c == bar else 0.0
            elif s < count:
                basis[bar, c] = X[c, bar]
            else:
                basis[bar, c] = Y[c, behind + bar]
    return s


@inner
def _place_bars(k, bars, points, X):
    """X (bars, 3k + bars) ← Eᵀ, behind it the identity.

    Args:
        k: number of arms. bars: of bars. points: (k, 3) grasp points (m). X: filled.
    """
    X[:] = 0.0
    bar = 0
    for i in range(k):
        for j in range(i + 1, k):
            X[bar, 3 * k + bar] = 1.0
            e = minus3(points[j], points[i])
            length = sqrt(dot3(e, e))
            if length >= _NO_BAR:
                e = divided3(e, length)
                fill3(X[bar, 3 * i :], e)
                fill3(X[bar, 3 * j :], scaled3(-1.0, e))
            bar += 1


@inner
def _invert(X, count, length, carried, tolerance):
    """Turn rows (σy, u), UΣYᵀ = Eᵀ, into those of E⁺ = UΣ⁻¹Yᵀ, (y/σ, u); returns how many are kept.

    Args:
        X: rows, overwritten. count: number of rows. length: of y. carried: length of u.
        tolerance: least σ, of the largest.
    """
    largest = 0.0
    for row in range(count):
        largest = max(largest, dot(X[row], X[row], length))
    kept = _keep(X, count, length, length + carried, tolerance * tolerance * largest, inf)
    for row in range(kept):
        inverse = 1.0 / dot(X[row], X[row], length)
        for i in range(length):
            X[row, i] *= inverse
    return kept


@inner
def _dot_forces(t, rank, X, n_locked, Y):
    """Y[:rank] ← products of the rows X[:rank, :3k] with each locked force, then with each joint's.

    Args:
        rank: number of rows. X: `bar_inverse`. n_locked: rows of `carried`. Y: `bar_effects`.
    """
    work = t.work
    for row in range(rank):
        for c in range(n_locked):
            Y[row, c] = dot3(X[row, 3 * work.owners[c] :], work.carried[c])
        for i in range(t.model.n_arms):
            for j in range(t.model.arms[i].first, t.model.arms[i].end):
                force = rotated_back(work.axes[0], work.joints[j].J_bar)  # in world axes: L f̃
                Y[row, n_locked + j] = dot3(X[row, 3 * i :], force)


@inner
def _make_forces(s, count, bars, n, Z, Y, X):
    """X[c, :bars] = Σ (y[:n]·Z[c]) y[n:] over rows y of Y[:count]: forces of torques Z[:s]."""
    for c in range(s):
        for bar in range(bars):
            X[c, bar] = 0.0
        for row in range(count):
            add_scaled(dot(Y[row], Z[c], n), Y[row, n:], bars, X[c])


@inner
def _keep(X, count, length, width, above, most):
    """Move rows X[:count, :width] with above < |X[row, :length]|² ≤ most to the front: how many."""
    kept = 0
    for row in range(count):
        if above < dot(X[row], X[row], length) <= most:
            for i in range(width):
                X[kept, i] = X[row, i]
            kept += 1
    return kept


@inner
def _take_out(Q, count, length, x):
    """Remove the directions of the orthonormal rows Q[:count] from a row x (length,)."""
    for c in range(count):
        add_scaled(-dot(Q[c], x, length), Q[c], length, x)


@inner
def _orthonormalise(X, count, length, tolerance):
    """Make orthonormal rows that span the rows X[:count, :length], the longest first: how many.

    By Gram and Schmidt; what is left of a row is cleared once more when its turn comes. Where no
    more than tolerance · the longest is left, the remaining rows depend on those before.
    """
    largest = 0.0
    for done in range(count):
        most = 0.0
        at = done
        for row in range(done, count):
            square = dot(X[row], X[row], length)
            if square > most:
                most = square
                at = row
        largest = max(largest, most)
        if not most > tolerance * tolerance * largest:
            return done
        for i in range(length):
            X[done, i], X[at, i] = X[at, i], X[done, i]
        _take_out(X, done, length, X[done])
        norm = sqrt(dot(X[done], X[done], length))
        for i in range(length):
            X[done, i] /= norm
        for row in range(done + 1, count):
            _take_out(X[done:], 1, length, X[row])
    return count


# --- Rows of the allocation: forces in the bars ---------------------------------------------------


@inner
def internal_rows(t, d):
    """Rows E of the settable bar forces and their goals; returns the number of rows.

    Reads `commanded`, R and p of the joints, `resisted` of the arms, `inertial` and `rest` of the
    joints, `goal` of the internal forces. Fills `points`, `carried`, `owners`, and rows of `extra`
    (E) and `sides` (E τ less what τ_0 makes).

    Args:
        d: rows of `sides` before these.
    """
    model = t.model
    work = t.work
    joints = work.joints
    n = model.n_joints
    bars = model.n_bars
    if work.commanded == 0:
        return 0
    locked = 0
    for i in range(model.n_arms):
        arm = model.arms[i]
        fill3(work.points[i], place_point(joints[arm.tip_joint], arm.tip[9:]))
        for c in range(work.arms[i].n_locked):  # of orthonormal wrenches that its structure carries
            force = rotated_back(work.axes[0], work.arms[i].resisted[c])
            fill3(work.carried[locked], divided3(force, model.roots[0]))
            work.owners[locked] = i
            locked += 1
    count = settable_bars(t, locked)
    for e in range(count):
        side = 0.0
        for j in range(n):
            s = 0.0
            for c in range(bars):
                s += work.basis[c, e] * work.levers[c, j]
            work.extra[e, j] = s
            side += s * (joints[j].inertial - joints[j].rest)
        for c in range(bars):
            side += work.basis[c, e] * work.internal[c].goal
        work.sides[d + e] = side
    return count


@inner
def internal_forces(t):
    """Forces `bars` between each two grasps (N) by the joints' torques.

    Reads `levers`, and `tau`, `friction` and `inertial` of the joints; 0 if none is commanded.
    """
    joints = t.work.joints
    out = t.work.bars
    n = t.model.n_joints
    bars = t.model.n_bars
    for c in range(bars):
        out[c] = 0.0
        if t.work.commanded:
            for j in range(n):
                beyond = joints[j].tau - joints[j].friction - joints[j].inertial
                out[c] += t.work.levers[c, j] * beyond


# --- Rows of the allocation: Z = A R⁻¹Aᵀ of A = [G; E], its factor, row by row of E ---------------
#
# A row of E that the rows before it decide (a squeeze that the grasps do not pass on) has a pivot
# of zero. Elimination leaves rounding errors there, as large as eps times the condition number of
# Z, and near a singular posture no threshold separates them from a pivot. So what is left of a
# doubtful row is projected a second time, in the joints, as in Gram-Schmidt with
# reorthogonalisation (Björck, Numerical Methods for Least Squares Problems, 1996, section 2.4.5).

_DRIVEN = 1e-12  #: least share of a pivot of Z
_DOUBTFUL = 1e-6  #: pivots of less share than this are computed twice


@inner
def factor_effort(t):
    """Factor of the block G R⁻¹Gᵀ of Z, `effort` to `factor`; False: motors miss some motion."""
    work = t.work
    Z = t.work.factor
    d = 6 - work.locked
    for i in range(d):
        for j in range(i + 1):
            Z[i, j] = work.effort[work.locked + i, work.locked + j]
    return cholesky(Z, 0, d, Z) > _DRIVEN


@inner
def add_row(t, e):
    """Factor of Z with one row more; False: the rows before it determine E[e]τ.

    Reads `extra` (E). Fills row e of `weighed` and the row of `factor` that belongs to it.

    Args:
        e: row of E.
    """
    work = t.work
    a = work.extra[e]
    size = 6 - work.locked + e
    row = work.factor[size]
    _weigh(t, a, work.weighed[e])
    _multiply(t, work.weighed[e], e, row)
    whole = row[size] = dot(work.weighed[e], a, t.model.n_joints)
    forward(work.factor, size, row)
    left = whole - dot(row, row, size)
    if left < _DOUBTFUL * whole:
        left = _project_again(t, e)
    if not left > _DRIVEN * whole:
        return False
    row[size] = 1.0 / sqrt(left)
    return True


@inner
def _multiply(t, weighed, e, out):
    """out ← A R⁻¹a, the products of a weighed row with G and with E[:e].

    Args:
        weighed: (n,) R⁻¹a. e: number of rows of E. out: (d + e,), filled.
    """
    work = t.work
    m = work.locked
    x = ZERO
    for j in range(t.model.n_joints):
        x = add(x, weighed[j], work.joints[j].J_bar)
    driven = local(6)
    fill(driven, turned(work, x))
    for i in range(6 - m):
        out[i] = driven[m + i]
    for c in range(e):
        out[6 - m + c] = dot(weighed, work.extra[c], t.model.n_joints)


@inner
def _project_again(t, e):
    """Pivot of row e of E, from its rest in the joints; the row of `factor` is corrected.

    Args:
        e: row of E, of which `factor` has a row already.
    """
    work = t.work
    Z = work.factor
    n = t.model.n_joints
    m = work.locked
    size = 6 - m + e
    rest = work.rest
    x = work.multipliers
    for i in range(size):
        x[i] = Z[size, i]
    backward(Z, size, x)
    y = _from_free(work, x)
    for j in range(n):
        rest[j] = work.extra[e, j] - dot6(work.joints[j].J_bar, y)
    for c in range(e):
        add_scaled(-x[6 - m + c], work.extra[c], n, rest)
    _weigh(t, rest, work.rest_weighed)
    _multiply(t, work.rest_weighed, e, x)
    forward(Z, size, x)
    add_scaled(1.0, x, size, Z[size])
    return dot(work.rest_weighed, rest, n) - dot(x, x, size)


@leaf
def _from_free(work, x):
    """A vector in energy coordinates, six numbers, from its part x (d,) along the free axes."""
    whole = local(6)
    for i in range(6):
        whole[i] = x[i - work.locked] if i >= work.locked else 0.0
    return turned_back(work, whole)


@inner
def _weigh(t, row, out):
    """out ← R⁻¹ row, both (n,) over all joints.

    Reads `wide` and `effort` of the arms, J of the joints.
    """
    joints = t.work.joints
    for k in range(t.model.n_arms):
        own = t.work.arms[k]
        lo = t.model.arms[k].first
        hi = t.model.arms[k].end
        if own.wide == 0:
            for j in range(lo, hi):
                out[j] = t.model.joints[j].effort * row[j]
            continue
        x = ZERO
        for j in range(lo, hi):
            x = add(x, row[j], joints[j].J)
        x = times6(own.effort, x)
        for j in range(lo, hi):
            out[j] = dot6(joints[j].J, x)


# --- Motor torques for a commanded object force and internal forces -------------------------------
#
# The least torque in the weight 1/τ_max² (R below) with G τ = f_S and E τ = e:
#
#     τ = τ_0 + R⁻¹AᵀZ⁻¹(b − A τ_0),   A = [G; E],   Z = A R⁻¹Aᵀ
#
# E holds the settable bar forces and the
# motions that only single arms have, because their grasp or their posture leaves them
# idle, as far as the motors drive them. Arms with more joints than they need hold their posture
# in the dynamically consistent null space, τ_0 = (1 − JᵀJ̄ᵀ)(h + M(−k_d q̇ + k_p(q₀ − q)) +
# diag(M) a_l(q)); passive joints have no torque.


@inner
def command_object(t):
    """Control structure f_S = Λ_S η̇_c + b_S + Sᵀ(N_μ(α_u + α_f) + f_bias) (21), turned.

    α_f is `reaction`, which tangential forces take off the contact forces. Reads `Lambda`,
    `acceleration_t`, `chain_bias`, `pushed_t`, `alpha_u`; fills `f_S` (6,).
    """
    work = t.work
    bias = turned(work, wrench_to_energy(work, t.memory.f_bias))
    f_S = plus(plus(work.chain_bias, bias), times6(work.Lambda, work.acceleration_t))
    for a in range(work.rank):
        f_S = add(f_S, work.alpha_u[a] + work.reaction[a], work.pushed_t[a])
    fill(work.f_S, f_S)


@leaf
def predict_joints(t):
    """Joint accelerations q̈ = J̄a + offset and their torques h + Mq̈, a the object's acceleration.

    Reads `acceleration_t`, and J̄, `offset`, `h`, M of the joints; fills `acceleration` and
    `inertial` of the joints.
    """
    joints = t.work.joints
    a = turned_back(t.work, t.work.acceleration_t)
    for k in range(t.model.n_arms):
        lo = t.model.arms[k].first
        hi = t.model.arms[k].end
        for j in range(lo, hi):
            joints[j].acceleration = dot6(joints[j].J_bar, a) + joints[j].offset
        for j in range(lo, hi):
            s = joints[j].h
            for i in range(lo, hi):
                s += joints[j].M[i - lo] * joints[i].acceleration
            joints[j].inertial = s


@inner
def allocate_torques(t):
    """Least torques τ = τ_0 + R⁻¹AᵀZ⁻¹(b − A τ_0) of all joints, not yet limited; returns a reason.

    Reads `f_S`, `effort`, `locked`, and the arms' and joints' terms. Fills `rest` (τ_0) and `tau`
    of the joints, `n_internal`, `extra`, `weighed`, `factor`, `sides`, and calls `internal_rows`.
    """
    model = t.model
    arms = model.arms
    work = t.work
    joints = work.joints
    n = model.n_joints
    d = 6 - work.locked
    b = work.sides
    for k in range(model.n_arms):
        if work.arms[k].wide:
            _hold_posture(t, arms[k], work.arms[k])
        else:
            for j in range(arms[k].first, arms[k].end):
                joints[j].rest = 0.0
    if model.n_arms == 1 and work.arms[0].wide and work.n_lost == 0:
        f = _from_free(work, work.f_S[work.locked :])  # τ = τ_0 + Jᵀf: no other arm has a share
        for j in range(n):
            joints[j].tau = joints[j].rest + dot6(joints[j].J, f)
        work.n_internal = 0
        return NO_REASON
    for i in range(d):
        b[i] = work.f_S[work.locked + i]
    count = internal_rows(t, d)
    work.n_internal = count
    if not factor_effort(t):
        return UNACTUATED
    for e in range(count):
        if not add_row(t, e):
            if model.n_arms != 2:
                return UNACTUATED
            count = 0  # the grasps pass on no separate squeeze: f_S decides it
            work.n_internal = 0
            work.commanded = 0
    size = d + count
    own = _own_motions(t, d, count)
    for e in range(count, count + own):
        if e > size - d:  # one before it was left out
            b[size] = b[d + e]
            for j in range(n):
                work.extra[size - d, j] = work.extra[e, j]
        if add_row(t, size - d):
            size += 1
    cholesky_solve(work.factor, size, b)
    y = _from_free(work, b)
    for k in range(model.n_arms):
        _add_torques(t, arms[k], work.arms[k], y)
    for e in range(size - d):
        for j in range(n):
            joints[j].tau += b[d + e] * work.weighed[e, j]
    return NO_REASON


@leaf
def push_from_limits(joint, q):
    """Acceleration away from joint limits, see `control.records.joint_limit_margins`."""
    if q < joint.low:
        depth = joint.low - q
        sign = 1.0
    else:
        depth = q - joint.high
        sign = -1.0
    if not depth > 0.0:
        return 0.0
    s = min(depth / joint.width, 1.0)
    return sign * joint.most * s * s * (3.0 - 2.0 * s)


@leaf
def _hold_posture(t, arm, own):
    """Posture torques (1 − JᵀJ̄ᵀ)τ₀ of a wide arm, τ₀ = h + M(k_p(q₀ − q) − k_d q̇) + diag(M) a_l.

    a_l drives joints away from their limits, see `push_from_limits`. Reads h, M, J, J̄ of the
    joints; fills their `rest` (N m, N), and `tau` with τ₀ itself.
    """
    model = t.model
    joints = t.work.joints
    lo = arm.first
    moved = ZERO
    for j in range(lo, arm.end):
        push = push_from_limits(model.joints[j], t.input.q[j])
        s = joints[j].h + joints[j].M[j - lo] * push + retreat(t, arm, j, model.posture_damping)
        joints[j].rest = s
        joints[j].tau = s
        moved = add(moved, s, joints[j].J_bar)
    for j in range(lo, arm.end):
        joints[j].rest -= dot6(joints[j].J, moved)
    if own.n_lost > 0:
        _retreat_from_lost(t, arm, own)


@inner
def _retreat_from_lost(t, arm, own):
    """Add the posture law of joint motions that a singular posture takes from the task to `rest`.

    Reads `mode`, `gone` and `share` of the arm; h, M and `tau` (τ₀, see `_hold_posture`) of its
    joints.
    """
    joints = t.work.joints
    lo = arm.first
    hi = arm.end
    for e in range(own.n_lost):
        mode = own.mode[e]
        along = 0.0
        for j in range(lo, hi):
            back = joints[j].h + retreat(t, arm, j, t.model.retreat_damping)
            if own.gone[e] != 0.0:
                along += mode[j - lo] * (back - joints[j].tau)
            else:
                along += mode[j - lo] * (1.0 - own.share[e]) * back
        for j in range(lo, hi):
            for k in range(lo, hi):
                joints[j].rest += along * joints[j].M[k - lo] * mode[k - lo]


@inner
def _own_motions(t, d, first):
    """Rows E[first:] that keep the posture in motions of narrow arms alone; returns how many.

    Such an arm can move without the object where its grasp leaves it idle motions (a SCARA on a
    slide, four joints in a plane) or in a singular posture: νᵀτ = νᵀ(h + M q̈_posture) for every
    joint motion ν with U J ν = 0. Fills rows of `extra` and `sides`, and subtracts from the first d
    of `sides` the force on the object by τ_0 of the other arms.

    Args:
        d: rows of `sides` before those of E. first: row of E.
    """
    model = t.model
    work = t.work
    joints = work.joints
    count = first
    for k in range(model.n_arms):
        own = work.arms[k]
        arm = model.arms[k]
        lo = arm.first
        n = arm.end - lo
        if own.wide or own.n_kept >= n:
            continue
        J = local(MAX_JOINTS, 6)
        motions = local(MAX_JOINTS, MAX_JOINTS)
        for j in range(n):
            fill(J[j], joints[lo + j].J)
        null_motions(own, J, n, motions)
        for a in range(own.n_kept, n):
            side = 0.0
            for j in range(model.n_joints):
                work.extra[count, j] = 0.0
            for i in range(n):
                back = retreat(t, arm, lo + i, model.retreat_damping)
                side += motions[a, i] * (joints[lo + i].h + back)
                work.extra[count, lo + i] = motions[a, i]
            work.sides[d + count] = side
            count += 1
    if count > first or work.n_lost > 0:
        x = ZERO
        for j in range(model.n_joints):
            x = add(x, joints[j].rest, joints[j].J_bar)
        driven = local(6)
        fill(driven, turned(work, x))
        for i in range(d):
            work.sides[i] -= driven[work.locked + i]
    return count - first


@leaf
def _add_torques(t, arm, own, y):
    """Torques of an arm for the object force, `tau` = τ_0 + R⁻¹J̄ y.

    Args:
        arm: ARM row. own: its ARM_WORK. y: six multipliers of f_S in energy coordinates.
    """
    joints = t.work.joints
    if own.wide == 0:
        for j in range(arm.first, arm.end):
            joints[j].tau = joints[j].rest + t.model.joints[j].effort * dot6(joints[j].J_bar, y)
        return
    x = times6(own.effort, y)
    for j in range(arm.first, arm.end):
        joints[j].tau = joints[j].rest + dot6(joints[j].J, x)


@leaf
def limit_torques(t):
    """Motor torques `tau`; returns whether one exceeds its limit, and whether all are finite.

    Where one exceeds its limit or is not finite `tau` stays as it is.
    """
    table = t.model.joints
    joints = t.work.joints
    excess = False
    total = 0.0
    for j in range(t.model.n_joints):
        if table[j].motor >= 0:
            total += joints[j].tau * 0.0
            excess = excess or abs(joints[j].tau) > table[j].tau_max
    if not isfinite(total):
        return False, False
    if not excess:
        for j in range(t.model.n_joints):
            if table[j].motor >= 0:
                t.work.tau[table[j].motor] = joints[j].tau
    return excess, True
