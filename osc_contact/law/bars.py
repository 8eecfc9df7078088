"""Internal forces: squeeze of two arms, bars of a virtual linkage for more."""

from __future__ import annotations

from math import inf, sqrt

from osc_contact.law.algebra import one_sided_jacobi
from osc_contact.law.arm_motion import place_point
from osc_contact.law.jit import inner, matrix
from osc_contact.law.vectors import dot6, energy_motion, fill, reflect

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
    for row in range(6):
        for j in range(n):
            Q[row, j] = work.driven[j, row] * work.efforts[j]
    moving = _orthonormalise(Q, 6, n, _DEPENDENT)
    for row in range(count):
        for j in range(n):
            Y[row, n_locked + j] *= work.efforts[j]
            Z[row, j] = Y[row, n_locked + j]
    felt = _orthonormalise(Z, count, n, _DEPENDENT)
    for row in range(felt):
        _take_out(Q, 0, moving, n, Z, row)
    # by the angle to null(G): an arm near a singular posture makes some forces all too easily
    one_sided_jacobi(Z, felt, n, 0)
    s = _keep(Z, felt, n, n, tolerance * tolerance, inf)
    if s < count:
        _make_forces(s, count, bars, n, Z, Y, n_locked, X)
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
    for bar in range(bars):
        for c in range(3 * k + bars):
            X[bar, c] = 0.0
        X[bar, 3 * k + bar] = 1.0
    bar = 0
    for i in range(k):
        for j in range(i + 1, k):
            x = points[j, 0] - points[i, 0]
            y = points[j, 1] - points[i, 1]
            z = points[j, 2] - points[i, 2]
            length = sqrt(x * x + y * y + z * z)
            if length >= _NO_BAR:
                X[bar, 3 * i] = x / length
                X[bar, 3 * j] = -x / length
                X[bar, 3 * i + 1] = y / length
                X[bar, 3 * j + 1] = -y / length
                X[bar, 3 * i + 2] = z / length
                X[bar, 3 * j + 2] = -z / length
            bar += 1


@inner
def _invert(X, count, length, carried, tolerance):
    """From rows (σy, u) with UΣYᵀ = Eᵀ, those of E⁺ = UΣ⁻¹Yᵀ: (y/σ, u); how many."""
    largest = 0.0
    for row in range(count):
        largest = max(largest, _square(X, row, length))
    kept = _keep(X, count, length, length + carried, tolerance * tolerance * largest, inf)
    for row in range(kept):
        inverse = 1.0 / _square(X, row, length)
        for i in range(length):
            X[row, i] *= inverse
    return kept


@inner
def _see_forces(t, rank, X, n_locked, Y):
    """Rows of Y: what each row of X[:rank, :3k] sees of locked forces, then of joint torques."""
    work = t.work
    locked = work.carried
    levers = work.force_levers
    for row in range(rank):
        for c in range(n_locked):
            i = 3 * work.owners[c]
            x = X[row, i]
            y = X[row, i + 1]
            z = X[row, i + 2]
            Y[row, c] = x * locked[c, 0] + y * locked[c, 1] + z * locked[c, 2]
        for i in range(t.model.n_arms):
            x = X[row, 3 * i]
            y = X[row, 3 * i + 1]
            z = X[row, 3 * i + 2]
            for j in range(t.model.arms[i].first, t.model.arms[i].end):
                f = x * levers[j, 0] + y * levers[j, 1] + z * levers[j, 2]
                Y[row, n_locked + j] = f


@inner
def _make_forces(s, count, bars, n, Z, Y, n_locked, X):
    """Rows X[:s, :bars]: what the torques Z[:s] make in the combinations Y[:count]."""
    for c in range(s):
        for bar in range(bars):
            X[c, bar] = 0.0
        for row in range(count):
            t = 0.0
            for j in range(n):
                t += Y[row, n_locked + j] * Z[c, j]
            for bar in range(bars):
                X[c, bar] += t * Y[row, n_locked + n + bar]


@inner
def _square(X, row, length):
    """|X[row, :length]|²."""
    s = 0.0
    for i in range(length):
        s += X[row, i] * X[row, i]
    return s


@inner
def _keep(X, count, length, width, above, most):
    """Move rows X[:count, :width] with above < |X[row, :length]|² ≤ most to the front; how many."""
    kept = 0
    for row in range(count):
        if above < _square(X, row, length) <= most:
            for i in range(width):
                X[kept, i] = X[row, i]
            kept += 1
    return kept


@inner
def _take_out(Q, begin, end, length, X, row):
    """Take the directions of the orthonormal rows Q[begin:end] out of one row of X."""
    for c in range(begin, end):
        t = 0.0
        for i in range(length):
            t += Q[c, i] * X[row, i]
        for i in range(length):
            X[row, i] -= t * Q[c, i]


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
            square = _square(X, row, length)
            if square > most:
                most = square
                at = row
        largest = max(largest, most)
        if not most > tolerance * tolerance * largest:
            return done
        for i in range(length):
            X[done, i], X[at, i] = X[at, i], X[done, i]
        _take_out(X, 0, done, length, X, done)
        norm = sqrt(_square(X, done, length))
        for i in range(length):
            X[done, i] /= norm
        for row in range(done + 1, count):
            _take_out(X, done, done + 1, length, X, row)
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
    joints = t.work.joints
    E = t.work.extra
    squeeze = t.memory.squeeze
    if t.model.n_arms == 2:
        line = work.line
        place_point(joints[arms[0].tip_joint], arms[0].tip, 9, work.u)
        place_point(joints[arms[1].tip_joint], arms[1].tip, 9, work.w)
        square = 0.0
        for i in range(3):
            line[i] = work.w[i] - work.u[i]
            square += line[i] * line[i]
            line[3 + i] = 0.0
        work.internal[0] = 0.0
        if square < _COINCIDE * _COINCIDE:
            return 0
        for i in range(3):
            line[i] *= 0.5 / sqrt(square)
        energy_motion(work.axes, line, line)
        offset = 0.0
        for k in range(2):
            for j in range(arms[k].first, arms[k].end):
                E[0, j] = (1.0 - 2.0 * k) * dot6(joints[j].J_bar, line)
                offset += E[0, j] * (joints[j].inertial - joints[j].rest)
        t.work.sides[d] = squeeze[0] + offset
        work.internal[0] = squeeze[0]
        return 1
    if work.commanded == 0:
        return 0
    return _bar_rows(t, d)


@inner
def _bar_rows(t, d):
    """Rows of the settable bar forces of three arms and more."""
    model = t.model
    arms = model.arms
    work = t.work
    arm_work = t.work.arms
    joints = t.work.joints
    n = model.n_joints
    k = model.n_arms
    bars = model.n_bars
    m = work.locked
    force_levers = work.force_levers
    carried = work.carried
    basis = work.basis
    root = work.axes
    locked = 0
    for i in range(k):
        place_point(joints[arms[i].tip_joint], arms[i].tip, 9, work.points[i])
        for c in range(arm_work[i].n_locked):  # of orthonormal wrenches that its structure carries
            u = arm_work[i].resisted[c]
            for a in range(3):
                carried[locked, a] = 0.0
                for j in range(3):
                    carried[locked, a] += root[0, j, a] * u[j] / model.roots[0]
            work.owners[locked] = i
            locked += 1
    for j in range(n):
        bar = joints[j].J_bar
        work.efforts[j] = sqrt(model.joints[j].effort)
        for a in range(3):  # forces in world axes: L f̃
            force_levers[j, a] = 0.0
            for i in range(3):
                force_levers[j, a] += root[0, i, a] * bar[i]
        fill(work.u, bar)
        reflect(work.reflectors, work.beta, m, work.u)
        for i in range(6):
            work.driven[j, i] = work.u[i] if i >= m else 0.0
    count = settable_bars(t, locked)
    for e in range(count):
        side = 0.0
        for j in range(n):
            s = 0.0
            for c in range(bars):
                s += basis[c, e] * work.levers[c, j]
            work.extra[e, j] = s
            side += s * (joints[j].inertial - joints[j].rest)
        for c in range(bars):
            side += basis[c, e] * t.memory.squeeze[c]
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
