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

    Excluded are dependent bars, forces that the structure of the arms carries independently of the
    motors, and forces that no torques in null(G) produce (because hinges and balls do not transmit
    them, or passive joints do not resist them). Reads `points`, `carried` and `owners`, J̄ of the
    joints. Fills `levers` (bars, n), E⁺J̄ᵀ: force in the bars per torque of a joint, without
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
    arms = t.model.n_arms
    n = t.model.n_joints
    tolerance = t.model.angle_tolerance
    bars = arms * (arms - 1) // 2
    effects = work.bar_effects
    rank = _compute_levers(t, bars, n_locked)
    if arms == 2:  # `add_row` detects whether the grasps transmit the squeeze
        work.basis[0, 0] = 1.0
        return rank
    count = rank
    if n_locked > 0:
        one_sided_jacobi(effects, rank, n_locked, n + bars)
        width = n_locked + n + bars
        count = _keep(effects, rank, n_locked, width, -1.0, tolerance * tolerance)
    settable = _find_internal_torques(t, count, n_locked)
    _fill_basis(t, settable, count, bars, n_locked)
    return settable


@inner
def _compute_levers(t, bars, n_locked):
    """Fill `levers` E⁺J̄ᵀ, and rows [locked forces, joints, bars] of `bar_effects`.

    The rows of E⁺ that belong to singular values of zero are left out. Reads `points`, `carried`,
    `owners`, J̄ of the joints; fills `bar_inverse` (E⁺ by rows), too.

    Args:
        t: Tick. bars: number of bars. n_locked: number of rows of `carried`.

    Returns:
        Rank of E, the number of filled rows of `bar_effects`.
    """
    work = t.work
    arms = t.model.n_arms
    n = t.model.n_joints
    levers = work.levers
    inverse = work.bar_inverse
    effects = work.bar_effects
    _place_bars(arms, bars, work.points, inverse)
    one_sided_jacobi(inverse, bars, 3 * arms, bars)
    rank = _invert(inverse, bars, 3 * arms, bars, t.model.angle_tolerance)
    _dot_forces(t, rank, inverse, n_locked, effects)
    for bar in range(bars):
        for j in range(n):
            levers[bar, j] = 0.0
        for row in range(rank):
            share = inverse[row, 3 * arms + bar]  # element of u in E⁺ = UΣ⁻¹Yᵀ
            effects[row, n_locked + n + bar] = share
            for j in range(n):
                levers[bar, j] += share * effects[row, n_locked + j]
    return rank


@inner
def _find_internal_torques(t, count, n_locked):
    """Find torques that change bar forces and, being in null(G), do not move the object.

    Torques are weighted by effort, τ/τ_max. They are selected by their angle to null(G), not by
    size, because singular postures exaggerate some forces. Reads J̄ of the joints; weights the
    joint elements of `bar_effects`. Fills `bar_torques` (s, n) with these torques, and
    `moving_torques` with an orthonormal basis of the torques that move the object.

    Args:
        t: Tick. count: number of rows of `bar_effects`. n_locked: number of their leading elements,
            which belong to locked wrenches.

    Returns:
        Number s of these torques.
    """
    work = t.work
    n = t.model.n_joints
    effects = work.bar_effects
    loading = work.bar_torques
    moving_torques = work.moving_torques
    for j in range(n):
        effort = sqrt(t.model.joints[j].effort)
        driven = turned(work, work.joints[j].J_bar)
        for row in range(6):
            moving_torques[row, j] = driven[row] * effort if row >= work.locked else 0.0
        for row in range(count):
            effects[row, n_locked + j] *= effort
            loading[row, j] = effects[row, n_locked + j]
    n_moving = _orthonormalise(moving_torques, 6, n, _DEPENDENT)
    n_loading = _orthonormalise(loading, count, n, _DEPENDENT)
    for row in range(n_loading):
        _take_out(moving_torques, n_moving, n, loading[row])
    one_sided_jacobi(loading, n_loading, n, 0)
    tolerance = t.model.angle_tolerance
    return _keep(loading, n_loading, n, n, tolerance * tolerance, inf)


@inner
def _fill_basis(t, settable, count, bars, n_locked):
    """Fill `basis` (bars, s) with orthonormal combinations of bar forces that motors can set.

    If all bars can be set, they are the bars themselves; if all torques that load bars are in
    null(G), the rows of `bar_effects`; else the forces by the torques in `bar_torques`.

    Args:
        t: Tick. settable: number s of columns. count: number of rows of `bar_effects`.
        bars: number of bars. n_locked: number of leading elements of each row of `bar_effects`.
    """
    work = t.work
    n = t.model.n_joints
    effects = work.bar_effects
    forces = work.bar_inverse  # E⁺ is not needed any more
    if settable < count:
        _make_forces(settable, count, bars, n, work.bar_torques, effects[:, n_locked:], forces)
        _orthonormalise(forces, settable, bars, 0.0)
    for bar in range(bars):
        for c in range(settable):
            if settable == bars:
                work.basis[bar, c] = 1.0 if c == bar else 0.0
            elif settable < count:
                work.basis[bar, c] = forces[c, bar]
            else:
                work.basis[bar, c] = effects[c, n_locked + n + bar]


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
    n_kept = _keep(X, count, length, length + carried, tolerance * tolerance * largest, inf)
    for row in range(n_kept):
        inverse = 1.0 / dot(X[row], X[row], length)
        for i in range(length):
            X[row, i] *= inverse
    return n_kept


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
def _keep(X, count, length, width, low, high):
    """Move the rows of X to the front whose leading part y has above < |y|² ≤ most.

    Args:
        X: matrix, whose rows are overwritten. count: number of rows. length: number of elements of
            y. width: number of elements of a row that are moved. low, high: bounds of |y|².

    Returns:
        Number of these rows.
    """
    n_kept = 0
    for row in range(count):
        if low < dot(X[row], X[row], length) <= high:
            for i in range(width):
                X[n_kept, i] = X[row, i]
            n_kept += 1
    return n_kept


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
        longest = 0.0  # square of the length of the longest remaining row
        selected = done
        for row in range(done, count):
            square = dot(X[row], X[row], length)
            if square > longest:
                longest = square
                selected = row
        largest = max(largest, longest)
        if not longest > tolerance * tolerance * largest:  # also if NaN
            return done
        for i in range(length):
            X[done, i], X[selected, i] = X[selected, i], X[done, i]
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
            element = 0.0  # of E
            for bar in range(bars):
                element += work.basis[bar, e] * work.levers[bar, j]
            work.extra[e, j] = element
            side += element * (joints[j].inertial - joints[j].rest)
        for bar in range(bars):
            side += work.basis[bar, e] * work.internal[bar].goal
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
    forces = t.work.bars
    n = t.model.n_joints
    bars = t.model.n_bars
    for bar in range(bars):
        forces[bar] = 0.0
        if t.work.commanded:
            for j in range(n):  # torques without those of friction, motion and weight
                squeezing = joints[j].tau - joints[j].friction - joints[j].inertial
                forces[bar] += t.work.levers[bar, j] * squeezing
