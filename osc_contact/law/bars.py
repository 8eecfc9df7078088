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

_COINCIDENT_M = 1e-9  # m, distance below which two grasps are the same point
_LEAST_REMAINDER = 1e-9  # remainder of a row, relative to the longest one, that counts as zero


@inner
def settable_bars(t, n_locked):
    """Compute the combinations of bar forces that the motors can set, and the levers of the bars.

    A bar carries an internal force between two of the k grasps; E (3k, bars) maps bar forces to
    forces at the grasps, E⁺ is its pseudo-inverse, J̄ᵀ (6, n) maps torques to the forces of the
    arms, and G (6, n) torques to the wrench on the object. Excluded are dependent bars, forces that
    the structure of the arms carries independently of the motors, and forces that no torques in
    null(G) produce (because hinges and balls do not transmit them, or passive joints do not resist
    them). Reads `points`, `carried` and `owners`, J̄ of the joints. Fills `levers` (bars, n),
    E⁺J̄ᵀ: force in the bars per torque of a joint, without acceleration; and `basis` (bars, s):
    orthonormal columns, at most 3k − 6, the identity if all bars can be set.

    Tables of the model's sizes are intermediate results in WORK that no other function reads:
    `bar_inverse` (factors of E⁺ = UΣ⁻¹Yᵀ: in each row one of Σ⁻¹Yᵀ, then one of Uᵀ), `bar_effects`
    (rows of Σ⁻¹Yᵀ times locked wrenches and times forces by joints, then Uᵀ), `bar_torques`
    (torques that change bar forces), `moving_torques` (torques that move the object).

    Below `angle_tolerance` count as zero: singular values of E relative to the largest one, those
    of the locked forces in the bars, and cosines between torques and null(G).

    Args:
        t: Tick.
        n_locked: number of rows of `carried`, forces that the arms carry without motors, ≤ 6k.

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
        # Combinations that the arms' structure does not change; −1 keeps exact zeros.
        count = _keep(effects, rank, n_locked, width, -1.0, tolerance * tolerance)
    settable = _find_internal_torques(t, count, n_locked)
    _fill_basis(t, settable, count, bars, n_locked)
    return settable


@inner
def _compute_levers(t, bars, n_locked):
    """Fill `levers` E⁺J̄ᵀ, and rows of `bar_effects`: locked forces, joints, bars.

    `levers` (bars, n) are the forces in the bars (N) per torque (N m, N) of each joint. E (3k,
    bars) maps forces in the bars to forces at the grasps of the k arms, E⁺ = UΣ⁻¹Yᵀ is its
    pseudo-inverse, and J̄ᵀ (6, n) maps torques to the forces of the arms. A row of `bar_effects`
    belongs to a singular value of E: it has products of the row of Σ⁻¹Yᵀ with locked forces and
    with the forces by joints, then the row of Uᵀ; singular values of zero are left out. Reads
    `points`, `carried`, `owners`, J̄ of the joints; fills `bar_inverse` with rows of Σ⁻¹Yᵀ, then of
    Uᵀ, too.

    Args:
        t: Tick.
        bars: number of bars.
        n_locked: number of rows of `carried`.

    Returns:
        Rank of E, the number of filled rows of `bar_effects`.
    """
    work = t.work
    arms = t.model.n_arms
    n = t.model.n_joints
    levers = work.levers
    inverse = work.bar_inverse
    effects = work.bar_effects
    _place_bars(arms, bars, work.points, inverse)  # [Eᵀ 1]
    one_sided_jacobi(inverse, bars, 3 * arms, bars)  # [ΣYᵀ Uᵀ]
    rank = _invert(inverse, bars, 3 * arms, bars, t.model.angle_tolerance)  # [Σ⁻¹Yᵀ Uᵀ]
    _apply_inverse(t, rank, inverse, n_locked, effects)
    # `levers` = U(Σ⁻¹Yᵀ J̄ᵀ), and Uᵀ as the last elements of `effects`
    for bar in range(bars):
        for j in range(n):
            levers[bar, j] = 0.0
        for row in range(rank):
            u = inverse[row, 3 * arms + bar]  # element of U in E⁺ = UΣ⁻¹Yᵀ
            effects[row, n_locked + n + bar] = u
            for j in range(n):
                levers[bar, j] += u * effects[row, n_locked + j]
    return rank


@inner
def _find_internal_torques(t, count, n_locked):
    """Find torques that change bar forces and, being in null(G), do not move the object.

    G (6, n) maps torques to the wrench on the object. Torques are counted in units of τ_max. In a
    singular posture some rows of `bar_effects` are huge; therefore torques are selected by their
    angle to the torques that move the object, not by size. Reads J̄ of the joints (n, 6), whose
    rows along the free axes are the columns of G, and `effort` (τ_max²) of the joints. Changes
    `bar_effects` (count, n_locked + n), whose rows have the effects of locked wrenches, then of
    each joint's torque, on one bar force: the elements of the joints are multiplied by τ_max. Fills
    `bar_torques` (s, n) with the torques, and `moving_torques` (6, n) with an orthonormal basis of
    the torques that move the object.

    Args:
        t: Tick.
        count: number of rows of `bar_effects`.
        n_locked: number of their leading elements, which belong to locked wrenches.

    Returns:
        Number s of these torques.
    """
    work = t.work
    n = t.model.n_joints
    effects = work.bar_effects
    loading = work.bar_torques
    moving_torques = work.moving_torques
    for j in range(n):
        tau_max = sqrt(t.model.joints[j].effort)
        wrench = turned(work, work.joints[j].J_bar)
        for row in range(6):  # the first rows are locked axes, along which no torque moves it
            moving_torques[row, j] = wrench[row] * tau_max if row >= work.locked else 0.0
        for row in range(count):
            effects[row, n_locked + j] *= tau_max
            loading[row, j] = effects[row, n_locked + j]
    n_moving = _orthonormalise(moving_torques, 6, n, _LEAST_REMAINDER)
    n_loading = _orthonormalise(loading, count, n, _LEAST_REMAINDER)
    # The remainder of a unit row is as long as the sine of its angle to the torques that move.
    for row in range(n_loading):
        _take_out(moving_torques, n_moving, n, loading[row])
    one_sided_jacobi(loading, n_loading, n, 0)  # principal directions, with the sines as lengths
    tolerance = t.model.angle_tolerance
    return _keep(loading, n_loading, n, n, tolerance * tolerance, inf)


@inner
def _fill_basis(t, settable, count, bars, n_locked):
    """Fill `basis` (bars, s) with orthonormal combinations of bar forces that motors can set.

    If all bars can be set, they are the bars themselves. If all torques that load bars are in
    null(G), so that they do not move the object, they are the bar forces in the rows of
    `bar_effects`; else the forces by the torques in `bar_torques` (s, n). A row of `bar_effects`
    has the effects of the locked wrenches (n_locked elements), of unit torques of the n joints, and
    the bar forces that belong to them. `bar_inverse` is overwritten.

    Args:
        t: Tick.
        settable: number s of columns.
        count: number of rows of `bar_effects`.
        bars: number of bars.
        n_locked: number of leading elements of each row of `bar_effects`.
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
        k: number of arms.
        bars: number of bars.
        points: (k, 3) grasp points (m).
        X: (bars, 3k + bars), filled.
    """
    X[:] = 0.0
    bar = 0
    for i in range(k):
        for j in range(i + 1, k):
            X[bar, 3 * k + bar] = 1.0
            e = minus3(points[j], points[i])
            length = sqrt(dot3(e, e))
            if length >= _COINCIDENT_M:
                e = divided3(e, length)
                fill3(X[bar, 3 * i :], e)
                fill3(X[bar, 3 * j :], scaled3(-1.0, e))
            bar += 1


@inner
def _invert(X, count, length, carried, tolerance):
    """Convert rows [σyᵀ, uᵀ] of the SVD Eᵀ = UΣYᵀ to rows [yᵀ/σ, uᵀ] of its inverse E⁺ = UΣ⁻¹Yᵀ.

    Each row belongs to a singular value σ with the singular vectors y (3k,) and u (bars,): y is a
    column of Y, u one of U. Rows with σ near zero are dropped.

    Args:
        X: (count, length + carried), orthogonal in the elements y, overwritten.
        count: number of rows.
        length: number of elements of y.
        carried: number of elements of u.
        tolerance: least σ relative to the largest one.

    Returns:
        Number of rows that remain, at the front of X.
    """
    largest = 0.0
    for row in range(count):
        largest = max(largest, dot(X[row], X[row], length))
    n_kept = _keep(X, count, length, length + carried, tolerance * tolerance * largest, inf)
    for row in range(n_kept):
        inverse = 1.0 / dot(X[row], X[row], length)  # 1/σ², since the row has σy
        for i in range(length):
            X[row, i] *= inverse
    return n_kept


@inner
def _apply_inverse(t, rank, inverse, n_locked, effects):
    """Multiply a factor of E⁺ with the locked forces and the forces by unit joint torques.

    E (3k, bars) maps forces in the bars (N) to forces at the grasps of the k arms, and E⁺ = UΣ⁻¹Yᵀ
    is its pseudo-inverse. The rows of Σ⁻¹Yᵀ are multiplied, the left factor U follows in
    `_compute_levers`. A locked force acts at the grasp of one arm, the force of a joint at that of
    its arm, so only three elements of a row count for each.

    Reads `owners`, `carried`, `axes`, and J̄ of the joints.

    Args:
        t: Tick.
        rank: number of rows, the rank of E.
        inverse: `bar_inverse`, of which the rows of Σ⁻¹Yᵀ, [:rank, :3k], are read.
        n_locked: number of rows of `carried`, forces that the arms carry without their motors.
        effects: `bar_effects`, of which [:rank] is filled: n_locked products with the rows of
            `carried`, then n with the force (N) at the grasp per torque (N m, N) of each joint.
    """
    work = t.work
    for row in range(rank):
        for c in range(n_locked):
            elements = inverse[row, 3 * work.owners[c] :]  # those of the arm on which it acts
            effects[row, c] = dot3(elements, work.carried[c])
        for i in range(t.model.n_arms):
            for j in range(t.model.arms[i].first, t.model.arms[i].end):
                # From energy coordinates to world axes, f = L f̃; the moment does not count.
                force = rotated_back(work.axes[0], work.joints[j].J_bar)
                effects[row, n_locked + j] = dot3(inverse[row, 3 * i :], force)


@inner
def _make_forces(s, count, bars, n, Z, Y, X):
    """Compute the bar forces that torques cause, Σ (y·z) b over the pairs (y, b) in the rows of Y.

    y (n,) is a row of forces per unit torque of each joint, b (bars,) the forces in the bars that
    belong to it, and z (n,) the torques in a row of Z.

    Args:
        s: number of rows of Z.
        count: number of rows of Y.
        bars: number of bars.
        n: number of joints.
        Z: (s, n) torques (N m, N).
        Y: (count, n + bars) rows [y, b]: force (N) per torque of each joint, then the bar forces
            that belong to a unit of it.
        X: (s, bars), filled with the bar forces (N) by each row of Z.
    """
    for c in range(s):
        for bar in range(bars):
            X[c, bar] = 0.0
        for row in range(count):
            add_scaled(dot(Y[row], Z[c], n), Y[row, n:], bars, X[c])


@inner
def _keep(X, count, length, width, low, high):
    """Move those rows of X to the front whose first `length` elements y have low < |y|² ≤ high.

    Args:
        X: matrix, whose rows are overwritten.
        count: number of rows.
        length: number of elements of y.
        width: number of elements of a row that are moved.
        low: lower bound of |y|²; a negative one keeps rows of zeros.
        high: upper bound of |y|².

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
    """Subtract from a vector x its components along orthonormal rows q of Q: x ← x − Σ (qᵀx) q.

    Args:
        Q: (count, length) or larger, with orthonormal rows.
        count: number of its rows in use.
        length: number of elements of x.
        x: (length,) or longer, changed.
    """
    for c in range(count):
        add_scaled(-dot(Q[c], x, length), Q[c], length, x)


@inner
def _orthonormalise(X, count, length, tolerance):
    """Orthonormalise the rows of X by Gram–Schmidt, the longest remainder first.

    Each remainder is orthogonalised a second time before it is normalised. Rows whose remainder is
    at most `tolerance` times the longest row count as dependent.

    Args:
        X: (count, length) or larger, overwritten.
        count: number of rows.
        length: number of elements of a row.
        tolerance: least remainder relative to the longest row.

    Returns:
        Number of orthonormal rows, at the front of X.
    """
    largest = 0.0
    for done in range(count):
        # the longest remaining row is moved to the front of the remaining ones
        longest = 0.0  # square of its norm
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
        # it is orthogonalised again and normalised, and its direction removed from the others
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
    """Fill the conditions on the torques for the bar forces that the motors can set.

    A bar is the line between two grasps that carries an internal force. Row e is E_e τ = side (N):
    E_e (n,) is the force of the e-th combination of bars, a column of `basis` (bars, s), per torque
    of each joint; the side is the commanded force plus E_e(h + M q̈), with the torques `inertial`
    that move the arms, less E_e τ_0, where τ_0 = `rest` are the torques without command. Reads
    `commanded`, `axes`, R and p of the joints, `resisted` of the arms, `inertial` and `rest` of the
    joints, `goal` of the internal forces (N). Fills `points` (k, 3; m), the forces `carried` by
    structures of the arms (rows of three) and their arms `owners`, the fields of `settable_bars`,
    rows of `extra` (E) and of `sides`.

    Args:
        t: Tick.
        d: number of rows of `sides` before these.

    Returns:
        Number s of these rows; 0 if no internal force is commanded.
    """
    model = t.model
    work = t.work
    joints = work.joints
    n = model.n_joints
    bars = model.n_bars
    if work.commanded == 0:
        return 0
    # grasp points, and forces that structures of arms carry instead of motors
    locked = 0
    for i in range(model.n_arms):
        arm = model.arms[i]
        fill3(work.points[i], place_point(joints[arm.tip_joint], arm.tip[9:]))
        for c in range(work.arms[i].n_locked):  # wrenches that the arm's structure carries
            # its force, from energy coordinates (√m R f̃) to world axes with the length of f̃
            force = rotated_back(work.axes[0], work.arms[i].resisted[c])
            fill3(work.carried[locked], divided3(force, model.roots[0]))
            work.owners[locked] = i
            locked += 1
    # a row of E and its side for each combination of bars that motors can set
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
    """Compute the internal force (N) in the bar between each two grasps, from the joints' torques.

    It is `levers` (bars, n; force per torque of each joint) times the torques less those of
    friction, of motion and of weight. Reads `levers`, and `tau`, `friction` and `inertial` of the
    joints; fills `bars`, with zeros if no internal force is commanded.

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
