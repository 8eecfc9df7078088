"""Internal forces: squeeze of two arms, bars of a virtual linkage for more."""

from __future__ import annotations

from math import inf, sqrt

from osc_contact.law.algebra import add_scaled, dot, one_sided_jacobi
from osc_contact.law.arm_motion import place_point
from osc_contact.law.jit import inner, matrix
from osc_contact.law.vectors import (
    divided3,
    dot3,
    dot6,
    energy_motion,
    fill,
    fill3,
    minus3,
    rotated_back,
    scaled3,
    turned,
)

# --- Three grasps and more: forces in the bars of a virtual linkage -------------------------------
#
# A bar joins each pair of grasp points, in the order (1, 2), (1, 3), …, (k − 1, k), and carries t,
# positive where the arms compress it (Williams and Khatib, "The virtual linkage: a model for
# internal forces in multi-grasp manipulation", IEEE ICRA 1993). With e the unit vector from grasp
# i to grasp j, arm i adds t e to the force it exerts on the object and arm j −t e: f = E t, a
# field without resultant. Back from forces, t = E⁺f; all of it is newtons, so that the least
# squares in E⁺ weigh no metre. Bars that depend on one another (four grasps in a plane, three in
# a line) share what E⁺ gives them.
#
# Everything is done on rows: rotations that make the rows of a matrix orthogonal (one-sided Jacobi)
# are the left factor of its SVD, and whatever stands behind the rows is rotated along.

_NO_BAR = 1e-9  # m: grasps nearer than this are the same point
_DEPENDENT = 1e-9  # of the longest: rows of which less is left are rounding errors


def scratch_size(k: int, n: int) -> int:
    """Numbers that `settable_bars` needs for k arms with n joints together."""
    bars = k * (k - 1) // 2
    return bars * (9 * k + 2 * n + 2 * bars) + 6 * n


@inner
def settable_bars(t, n_locked):
    """Combinations of bar forces that the motors can set at will, and the levers of the bars.

    Left out are dependent bars, forces that the arms' structure carries whatever the motors do, and
    forces that no torques in null(G) make: what hinges and balls do not pass on, or passive joints
    do not resist. Fills `levers`: E⁺J̄ᵀ, force in the bars by 1 N m (or N) of joint torques that
    accelerate nothing; and `basis`: orthonormal columns, never more than 3k − 6, the identity if
    these are all bars.

    `tolerance` is what counts as zero: singular values of E relative to the largest, those of the
    locked forces in the bars, and cosines between torques and null(G).

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
    scratch = work.scratch
    X, at = _table(scratch, 0, bars, 3 * k + bars)
    Y, at = _table(scratch, at, bars, behind + bars)
    Z, at = _table(scratch, at, bars, n)
    Q, at = _table(scratch, at, 6, n)
    _place_bars(k, bars, work.points, X)
    one_sided_jacobi(X, bars, 3 * k, bars)
    rank = _invert(X, bars, 3 * k, bars, tolerance)
    _see_forces(t, rank, X, n_locked, Y)
    for bar in range(bars):
        for j in range(n):
            levers[bar, j] = 0.0
        for row in range(rank):
            Y[row, behind + bar] = X[row, 3 * k + bar]
            for j in range(n):
                levers[bar, j] += X[row, 3 * k + bar] * Y[row, n_locked + j]
    count = rank
    if n_locked > 0:
        one_sided_jacobi(Y, rank, n_locked, n + bars)
        count = _keep(Y, rank, n_locked, behind + bars, -1.0, tolerance * tolerance)
    # torques by their effort: Q spans those that move the object, Z those that the bars feel
    for j in range(n):
        for row in range(6):
            Q[row, j] = work.driven[j, row] * work.efforts[j]
        for row in range(count):
            Y[row, n_locked + j] *= work.efforts[j]
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
def _table(scratch, at, rows, columns):
    """(rows, columns) of the scratch from `at`, and what comes after."""
    after = at + rows * columns
    return matrix(scratch, at, rows, columns), after


@inner
def _place_bars(k, bars, points, X):
    """X (bars, 3k + bars): rows of Eᵀ, then the identity."""
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
    """From rows (σy, u) with UΣYᵀ = Eᵀ, those of E⁺ = UΣ⁻¹Yᵀ: (y/σ, u); how many."""
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
def _see_forces(t, rank, X, n_locked, Y):
    """Rows of Y: what each row of X[:rank, :3k] sees of locked forces, then of joint torques."""
    work = t.work
    for row in range(rank):
        for c in range(n_locked):
            Y[row, c] = dot3(X[row, 3 * work.owners[c] :], work.carried[c])
        for i in range(t.model.n_arms):
            for j in range(t.model.arms[i].first, t.model.arms[i].end):
                Y[row, n_locked + j] = dot3(X[row, 3 * i :], work.force_levers[j])


@inner
def _make_forces(s, count, bars, n, Z, Y, X):
    """Rows X[:s, :bars]: what the torques Z[:s] make in the combinations Y[:count]."""
    for c in range(s):
        for bar in range(bars):
            X[c, bar] = 0.0
        for row in range(count):
            add_scaled(dot(Y[row], Z[c], n), Y[row, n:], bars, X[c])


@inner
def _keep(X, count, length, width, above, most):
    """Move rows X[:count, :width] with above < |X[row, :length]|² ≤ most to the front; how many."""
    kept = 0
    for row in range(count):
        if above < dot(X[row], X[row], length) <= most:
            for i in range(width):
                X[kept, i] = X[row, i]
            kept += 1
    return kept


@inner
def _take_out(Q, count, length, x):
    """Take the directions of the orthonormal rows Q[:count] out of a row x."""
    for c in range(count):
        add_scaled(-dot(Q[c], x, length), Q[c], length, x)


@inner
def _orthonormalise(X, count, length, tolerance):
    """Make orthonormal rows that span the rows X[:count, :length], the longest first; how many.

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


# --- Rows of the allocation: squeeze of two arms, bars of more ------------------------------------

_COINCIDE = 1e-9  #: m; grasps nearer than this have no line between them


@inner
def internal_rows(t, d):
    """Rows of the commanded internal forces, and what they are to be; returns their number.

    Args:
        d: rows before these.
    """
    arms = t.model.arms
    work = t.work
    joints = work.joints
    squeeze = t.memory.squeeze[0]
    if t.model.n_arms > 2:
        return 0 if work.commanded == 0 else _bar_rows(t, d)
    start = place_point(joints[arms[0].tip_joint], arms[0].tip[9:])
    line = minus3(place_point(joints[arms[1].tip_joint], arms[1].tip[9:]), start)
    square = dot3(line, line)
    work.internal[0] = 0.0
    if square < _COINCIDE * _COINCIDE:
        return 0
    line = scaled3(0.5 / sqrt(square), line) + (0.0, 0.0, 0.0)
    fill(work.line, energy_motion(work.axes, line))
    offset = 0.0
    for k in range(2):
        for j in range(arms[k].first, arms[k].end):
            lever = (1.0 - 2.0 * k) * dot6(joints[j].J_bar, work.line)
            work.extra[0, j] = lever
            offset += lever * (joints[j].inertial - joints[j].rest)
    work.sides[d] = squeeze + offset
    work.internal[0] = squeeze
    return 1


@inner
def _bar_rows(t, d):
    """Rows of the settable bar forces of three arms and more."""
    model = t.model
    work = t.work
    joints = work.joints
    n = model.n_joints
    bars = model.n_bars
    locked = 0
    for i in range(model.n_arms):
        arm = model.arms[i]
        fill3(work.points[i], place_point(joints[arm.tip_joint], arm.tip[9:]))
        for c in range(work.arms[i].n_locked):  # of orthonormal wrenches that its structure carries
            force = rotated_back(work.axes[0], work.arms[i].resisted[c])
            fill3(work.carried[locked], divided3(force, model.roots[0]))
            work.owners[locked] = i
            locked += 1
    for j in range(n):
        work.efforts[j] = sqrt(model.joints[j].effort)
        # forces in world axes: L f̃
        fill3(work.force_levers[j], rotated_back(work.axes[0], joints[j].J_bar))
        fill(work.driven[j], turned(work, joints[j].J_bar))
        for i in range(work.locked):
            work.driven[j, i] = 0.0
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
            side += work.basis[c, e] * t.memory.squeeze[c]
        work.sides[d + e] = side
    return count


@inner
def internal_forces(t):
    """Forces (bars,) between each two of three grasps and more that the joints' torques make."""
    joints = t.work.joints
    out = t.work.bars
    n = t.model.n_joints
    bars = t.model.n_bars
    for c in range(bars):
        out[c] = 0.0
        for j in range(n if t.work.commanded != 0 else 0):
            out[c] += t.work.levers[c, j] * (
                joints[j].tau - joints[j].friction - joints[j].inertial
            )
