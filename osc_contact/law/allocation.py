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
# A bar joins each pair of grasp points, in the order (1, 2), (1, 3), …, (k − 1, k), and carries the
# force t, positive where the arms compress it (Williams and Khatib, "The virtual linkage: a model
# for internal forces in multi-grasp manipulation", IEEE ICRA 1993). With e the unit vector from
# grasp i to grasp j, arm i adds t e to the force it exerts on the object and arm j adds −t e:
# f = E t, forces without a resultant. Conversely t = E⁺f; all elements are in newtons, so the least
# squares in E⁺ add no metres. Dependent bars (four grasps in a plane, three in a line) share the
# force by E⁺. Two grasps have one bar, whose force is their squeeze.
#
# All matrices are handled by rows. Rotations that make the rows of a matrix orthogonal (one-sided
# Jacobi) are the left factor of its SVD; numbers appended to the rows are rotated with them.

_NO_BAR = 1e-9  # m, distance below which two grasps are the same point
_DEPENDENT = 1e-9  # remainder of a row, relative to the longest one, that counts as zero


@inner
def settable_bars(t, n_locked):
    """Compute the combinations of bar forces that the motors can set, and the levers of the bars.

    Dependent bars are excluded, and forces that the structure of the arms carries independently of
    the motors, and forces that no torques in null(G) produce (because hinges and balls do not
    transmit them, or passive joints do not resist them). Reads `points`, `carried` and `owners`, J̄
    of the joints. Fills `levers` (bars, n), E⁺J̄ᵀ: force in the bars per torque of a joint, without
    acceleration; and `basis` (bars, s): orthonormal columns, at most 3k − 6, the identity if all
    bars can be set.

    Tables of the model's sizes are intermediate results in WORK that no other function reads:
    `bar_inverse` (E⁺ by rows), `bar_effects` (forces in the bars by locked wrenches and by joints),
    `bar_torques` (torques that change bar forces), `moving_torques` (torques that move the object).

    `angle_tolerance` is the threshold below which are counted as zero: singular values of E
    relative to the largest one, those of the locked forces in the bars, and cosines between torques
    and null(G).

    Args:
        t: Tick. n_locked: number of rows of `carried`, ≤ 6k.

    Returns:
        Number s of columns of `basis`.
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
    if k == 2:  # `add_row` detects whether the grasps transmit the squeeze
        basis[0, 0] = 1.0
        return rank
    count = rank
    if n_locked > 0:
        one_sided_jacobi(Y, rank, n_locked, n + bars)
        count = _keep(Y, rank, n_locked, behind + bars, -1.0, tolerance * tolerance)
    # torques weighted by effort: Q spans those that move the object, Z those that load the bars
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
    # selected by their angle to null(G), not by size: singular postures exaggerate some forces
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
    """Fill X with the rows of Eᵀ, followed by those of the identity.

    Args:
        k: number of arms. bars: number of bars. points: (k, 3) grasp points (m).
        X: (bars, 3k + bars), filled.
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
    """Convert rows (σy, u) of the SVD UΣYᵀ = Eᵀ to rows (y/σ, u) of E⁺ = UΣ⁻¹Yᵀ.

    Args:
        X: matrix, overwritten. count: number of rows. length: length of y. carried: length of u.
        tolerance: least σ relative to the largest one; rows below it are dropped.

    Returns:
        Number of rows that remain, at the front of X.
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
    """Multiply rows of E⁺ with the locked forces, then with the force per torque of each joint.

    Args:
        t: Tick. rank: number of rows. X: `bar_inverse`, of which X[:rank, :3k] is read.
        n_locked: number of rows of `carried`. Y: `bar_effects`, of which Y[:rank] is filled with
            n_locked products, then n products.
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
    """Compute the bar forces X[c, :bars] caused by torques Z[c], c < s.

    X[c, :bars] = Σ (y[:n]·Z[c]) y[n:] over the rows y of Y[:count].
    """
    for c in range(s):
        for bar in range(bars):
            X[c, bar] = 0.0
        for row in range(count):
            add_scaled(dot(Y[row], Z[c], n), Y[row, n:], bars, X[c])


@inner
def _keep(X, count, length, width, above, most):
    """Move the rows X[:count, :width] with above < |X[row, :length]|² ≤ most to the front.

    Returns:
        Number of these rows.
    """
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
    """Orthonormalise the rows X[:count, :length] by Gram–Schmidt, the longest remainder first.

    Each remainder is orthogonalised a second time before it is normalised. Rows whose remainder is
    at most `tolerance` times the longest row count as dependent.

    Returns:
        Number of orthonormal rows, at the front of X.
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
    """Fill the rows E of the settable bar forces and their right-hand sides; return their number.

    Reads `commanded`, R and p of the joints, `resisted` of the arms, `inertial` and `rest` of the
    joints, `goal` of the internal forces. Fills `points`, `carried`, `owners`, and rows of `extra`
    (E) and `sides` (E τ less E τ_0).

    Args:
        t: Tick. d: number of rows of `sides` before these.
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
        for c in range(work.arms[i].n_locked):  # wrenches that the arm's structure carries
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
    """Compute the forces `bars` (N) between each two grasps from the torques of the joints.

    Reads `levers`, and `tau`, `friction` and `inertial` of the joints. The forces are zero if no
    internal force is commanded.
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
# A row of E that depends on the rows before it (a squeeze that the grasps do not transmit) has a
# pivot of zero. Elimination leaves a rounding error there, as large as eps times the condition
# number of Z, and near a singular posture no threshold separates it from a true pivot. Therefore
# the remainder of a doubtful row is projected a second time, in joint space, as in Gram-Schmidt
# with reorthogonalisation (Björck, Numerical Methods for Least Squares Problems, 1996, section
# 2.4.5).

_DRIVEN = 1e-12  #: least relative pivot of Z
_DOUBTFUL = 1e-6  #: relative pivot below which a pivot is computed a second time


@inner
def factor_effort(t):
    """Factorise the block G R⁻¹Gᵀ of Z, from `effort` to `factor`.

    Returns:
        False if the motors cannot drive all free motions of the object.
    """
    work = t.work
    Z = t.work.factor
    d = 6 - work.locked
    for i in range(d):
        for j in range(i + 1):
            Z[i, j] = work.effort[work.locked + i, work.locked + j]
    return cholesky(Z, 0, d, Z) > _DRIVEN


@inner
def add_row(t, e):
    """Append the row of E[e] to the factor of Z.

    Reads `extra` (E). Fills row e of `weighed` and the corresponding row of `factor`.

    Args:
        t: Tick. e: row of E.

    Returns:
        False if E[e]τ is determined by the rows before it.
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
    """Compute A R⁻¹a, the products of a weighted row R⁻¹a with G and with E[:e].

    Args:
        t: Tick. weighed: (n,) R⁻¹a. e: number of rows of E. out: (d + e,), filled.
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
    """Compute the pivot of row e of E from its remainder in joint space; correct its `factor` row.

    Args:
        t: Tick. e: row of E, whose row of `factor` has been computed once.
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
    """Vector in energy coordinates (six numbers) with the components x (d,) along the free axes."""
    whole = local(6)
    for i in range(6):
        whole[i] = x[i - work.locked] if i >= work.locked else 0.0
    return turned_back(work, whole)


@inner
def _weigh(t, row, out):
    """Compute R⁻¹ row, where R is the weight of the torques; `row` and `out` are (n,).

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
# The torques have the least weighted sum of squares (weight R = 1/τ_max²) with G τ = f_S, E τ = e:
#
#     τ = τ_0 + R⁻¹AᵀZ⁻¹(b − A τ_0),   A = [G; E],   Z = A R⁻¹Aᵀ
#
# E contains the settable bar forces, and motions of single arms that do not move the object
# because of the grasp or the posture, as far as motors drive them. Arms with more joints than their
# grasp transmits wrenches hold their posture in the dynamically consistent null space,
# τ_0 = (1 − JᵀJ̄ᵀ)(h + M(−k_d q̇ + k_p(q₀ − q)) + diag(M) a_l(q)). Passive joints have no torque.


@inner
def command_object(t):
    """Compute the commanded force of the control structure (21), in turned energy coordinates.

    f_S = Λ_S η̇_c + b_S + Sᵀ(N_μ(α_u + α_f) + f_bias), where α_f is `reaction`, the loss of contact
    force by tangential forces. Reads `Lambda`, `acceleration_t`, `chain_bias`, `pushed_t`,
    `alpha_u`; fills `f_S` (6,).
    """
    work = t.work
    bias = turned(work, wrench_to_energy(work, t.memory.f_bias))
    f_S = plus(plus(work.chain_bias, bias), times6(work.Lambda, work.acceleration_t))
    for a in range(work.rank):
        f_S = add(f_S, work.alpha_u[a] + work.reaction[a], work.pushed_t[a])
    fill(work.f_S, f_S)


@leaf
def predict_joints(t):
    """Compute joint accelerations q̈ = J̄a + offset and torques h + Mq̈ for the acceleration a.

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
    """Compute the least torques τ = τ_0 + R⁻¹AᵀZ⁻¹(b − A τ_0), not limited; return a reason.

    Reads `f_S`, `effort`, `locked`, and the terms of arms and joints. Fills `rest` (τ_0) and `tau`
    of the joints, `n_internal`, `extra`, `weighed`, `factor`, `sides`, and the fields that
    `internal_rows` fills.
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
        f = _from_free(work, work.f_S[work.locked :])  # a single arm: τ = τ_0 + Jᵀf
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
            count = 0  # the grasps do not transmit an independent squeeze: f_S determines it
            work.n_internal = 0
            work.commanded = 0
    size = d + count
    own = _own_motions(t, d, count)
    for e in range(count, count + own):
        if e > size - d:  # a row before it was dropped
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
    """Acceleration a_l (rad/s², m/s²) of the posture law that repels a joint from its limits.

    It is zero between `low` and `high`, and rises smoothly to `most` over `width` beyond them.

    Args:
        joint: JOINT row. q: its position (rad, m).
    """
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
    """Compute the posture torques (1 − JᵀJ̄ᵀ)τ₀ of an arm with redundant joints.

    τ₀ = h + M(k_p(q₀ − q) − k_d q̇) + diag(M) a_l, where a_l repels joints from their limits
    (`push_from_limits`). Reads h, M, J, J̄ of the joints; fills their `rest` with the posture
    torques and `tau` with τ₀ (N m, N).

    Args:
        t: Tick. arm: ARM row. own: its ARM_WORK.
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
    """Add to `rest` the posture law along joint motions that the task loses in a singular posture.

    Reads `mode`, `gone` and `share` of the arm; h, M and `tau` (τ₀ of `_hold_posture`) of its
    joints.

    Args:
        t: Tick. arm: ARM row. own: its ARM_WORK.
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
    """Append rows of E for motions of single arms that do not move the object; return their number.

    An arm without redundant joints has such motions if its grasp permits them (a SCARA on a slide,
    four joints in a plane) or in a singular posture. The posture law acts along them:
    νᵀτ = νᵀ(h + M q̈_posture) for every joint motion ν with U J ν = 0. Fills rows of `extra` and
    `sides`, and subtracts from the first d of `sides` the force on the object by τ_0 of all arms.

    Args:
        t: Tick. d: number of rows of `sides` before those of E. first: index of the first new row
            of E.
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
    """Fill `tau` of an arm's joints with τ_0 + R⁻¹J̄ y, the torques for the force on the object.

    Args:
        t: Tick. arm: ARM row. own: its ARM_WORK. y: six multipliers of f_S in energy coordinates.
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
    """Copy the torques of the joints to the motors, unless one exceeds its limit or is not finite.

    Returns:
        Whether a torque exceeds its limit, and whether all torques are finite.
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
