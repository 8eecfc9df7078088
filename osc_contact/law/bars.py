"""Internal forces of several grasps: forces in the bars of a virtual linkage."""

from __future__ import annotations

from math import inf, sqrt

from osc_contact.law.algebra import (
    add_scaled,
    dot,
    one_sided_jacobi,
)
from osc_contact.law.arm_motion import place_point
from osc_contact.law.jit import inner
from osc_contact.law.vectors import (
    divided3,
    dot3,
    fill3,
    minus3,
    rotated_back,
    scaled3,
    turned,
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
    """Fill X with [Eᵀ  1]: in each row a row of Eᵀ (3k numbers), then one of the identity.

    Eᵀ has the unit vector from grasp i to grasp j in the columns of arm i, and its opposite in
    those of arm j; a bar between coinciding points has zeros.

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
    """Convert rows [σyᵀ  uᵀ] of the SVD UΣYᵀ = Eᵀ to rows [yᵀ/σ  uᵀ], with E⁺ = UΣ⁻¹Yᵀ.

    Args:
        X: matrix whose rows are orthogonal in y, overwritten. count: number of rows. length: number
            of elements of y. carried: number of elements of u.
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
    """Compute the bar forces that torques cause: X[c] = Σ (y[:n]·Z[c]) y[n:] over the rows y of Y.

    Args:
        s: number of rows of Z. count: number of rows of Y. bars: number of bars. n: number of
            joints.
        Z: (s, n) torques (N m, N). Y: (count, n + bars) rows of forces per torque of a joint,
            behind each the bar forces that belong to it. X: (s, bars), filled with bar forces (N).
    """
    for c in range(s):
        for bar in range(bars):
            X[c, bar] = 0.0
        for row in range(count):
            add_scaled(dot(Y[row], Z[c], n), Y[row, n:], bars, X[c])


@inner
def _keep(X, count, length, width, above, most):
    """Move the rows of X to the front whose leading part y has above < |y|² ≤ most.

    Args:
        X: matrix, whose rows are overwritten. count: number of rows. length: number of elements of
            y.
        width: number of elements of a row. above, most: bounds of |y|².

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
    """Subtract from a row its components along orthonormal rows.

    Args:
        Q: matrix with orthonormal rows. count: number of its rows in use. length: number of
            elements.
        x: (length,), changed.
    """
    for c in range(count):
        add_scaled(-dot(Q[c], x, length), Q[c], length, x)


@inner
def _orthonormalise(X, count, length, tolerance):
    """Orthonormalise the rows of X by Gram–Schmidt, the longest remainder first.

    Each remainder is orthogonalised a second time before it is normalised. Rows whose remainder is
    at most `tolerance` times the longest row count as dependent.

    Args:
        X: matrix, overwritten. count: number of rows. length: number of elements of a row.
        tolerance: least remainder relative to the longest row.

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
        if not most > tolerance * tolerance * largest:  # also if NaN
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

    Args:
        t: Tick.
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
