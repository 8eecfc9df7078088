"""Operational-space terms of one arm: J̄ and Λ, locked wrenches, effort, posture law."""

from __future__ import annotations

from math import isfinite

from osc_contact.law.algebra import (
    cholesky,
    dot,
    form_q,
    forward_rows,
    one_sided_jacobi,
    qr_rows,
)
from osc_contact.law.arm_motion import move_arm, place_arm, place_point, weight_on_joint
from osc_contact.law.jit import entry, inner, leaf, local
from osc_contact.law.records import JOINTS_AND_SIX, MAX_JOINTS, row_of
from osc_contact.law.vectors import (
    ZERO,
    accumulate,
    add,
    add_square,
    combined,
    cross,
    dot6,
    fill,
    fill3,
    finiteness,
    plus3,
    reflector,
    scaled,
    set_identity,
    six,
)

# --- J̄ and Λ of one arm in energy coordinates, its locked wrenches, its effort -------------------

_LEAST_PIVOT = 1e-12  #: least relative pivot of an effort metric


@inner
def arm_terms(t, first, n, m, arm, row):
    """Compute J̄, Λ and the locked wrenches of one arm in energy coordinates.

    Reads J (6, n) and M (n, n) of its joints, and `passed`, the rows N (m, 6) of wrenches that the
    grasp transmits, unless m = 6. Fills the inertia-weighted inverse J̄ (n, 6) of the joints and,
    of the arm, its inertia `Lambda` (6, 6), `passed`, `kept` (orthonormal wrenches that the joints
    resist), `n_kept` and `n_locked`; rows of `locked_rows`.

    With M = KKᵀ and N J K⁻ᵀ = U Σ Vᵀ arm and object together have the inertia 1 + 1/σ² along a
    column of U, with its singular value σ. Directions with σ²(1 + σ_max²) ≤ `rank_tolerance`²
    σ_max² count as locked, for an object of any mass. The faster QR of `_decompose_by_qr` is used
    if the bound 1/trace(Λ) of the least σ² is above this threshold.

    Args:
        t: Tick.
        first: first joint of the arm.
        n: number of its joints.
        m: number of independent wrenches that its grasp transmits.
        arm: ARM_WORK row.
        row: first row of `locked_rows` for the locked wrenches of this arm.

    Returns:
        Number of locked wrenches, or −1 if M is not positive definite.
    """
    if m == 6:  # all wrenches: the axes themselves are orthonormal
        set_identity(arm.passed)
        if _decompose_by_qr(t, first, n, arm, row):
            trace = 0.0
            for i in range(6):
                trace += arm.Lambda[i, i]
            if trace * t.model.rank_tolerance * t.model.rank_tolerance < 1.0:
                return arm.n_locked
    return arm.n_locked if _decompose_by_svd(t, first, n, m, arm, row) else -1


@leaf
def _weigh_inverse(joints, lo, n, K, Lambda):
    """Compute the inertia Λ of an arm and the inverse J̄ of its Jacobian from A⁺ (n, 6).

    A⁺ is the pseudo-inverse of A = J K⁻ᵀ (6, n), with the Jacobian J (6, n) and the factor K (n, n)
    of the joint-space inertia M = KKᵀ; then Λ = A⁺ᵀA⁺ (6, 6) and J̄ = K⁻ᵀA⁺ (n, 6), by back
    substitution.

    Args:
        joints: JOINT_WORK rows, whose `J_bar` contains the rows of A⁺ and is overwritten with those
            of J̄.
        lo: index of the first joint of the arm.
        n: number of its joints.
        K: (n, n) factor of M from `cholesky`, reciprocals on its diagonal.
        Lambda: (6, 6), filled.
    """
    Lambda[:] = 0.0
    for j in range(n - 1, -1, -1):  # row j of KᵀJ̄ = A⁺, from the last one
        bar = joints[lo + j].J_bar
        x = six(bar)
        add_square(1.0, x, Lambda)
        for k in range(j + 1, n):
            x = add(x, -K[k, j], joints[lo + k].J_bar)
        fill(bar, scaled(K[j, j], x))


@leaf
def weigh_joints(joints, lo, n, K, weighed):
    """Compute the factor K of the joint-space inertia M = KKᵀ of an arm, and K⁻¹Jᵀ.

    M (n, n) is read from the joints, as are the columns (6,) of the Jacobian J (6, n) in energy
    coordinates.

    Args:
        joints: JOINT_WORK rows, of which J and M are read.
        lo: first joint of the arm.
        n: number of its joints.
        K: (n, n), filled with the factor in the form of `cholesky`.
        weighed: (n, 6), filled with K⁻¹Jᵀ.

    Returns:
        False if M is not positive definite.
    """
    for i in range(n):
        joint = joints[lo + i]
        fill(weighed[i], joint.J)
        for j in range(i + 1):
            K[i, j] = joint.M[j]
    if not cholesky(K, 0, n, K) > 0.0:  # also if NaN
        return False
    forward_rows(K, n, weighed)
    return True


@inner
def _decompose_by_qr(t, lo, n, arm, row):
    """Compute J̄ and Λ of an arm of full rank by QR, in energy coordinates.

    J (6, n) is the Jacobian, J̄ (n, 6) its inverse weighted with the joint-space inertia M (n, n),
    Λ (6, 6) the inertia at the tip. With up to six joints J = QR, J̄ᵀ = QR⁻ᵀ and Λ = J̄ᵀMJ̄, whose
    accuracy does not depend on the condition of M. With more joints A = J K⁻ᵀ with M = KKᵀ, Aᵀ =
    QR, and A⁺ = QR⁻ᵀ is converted by `_weigh_inverse`.

    Reads J and M of the joints. Fills J̄ of the joints and, of the arm, `Lambda`, `kept`, `n_kept`
    and `n_locked`; rows of `locked_rows`.

    Args:
        t: Tick.
        lo: first joint of the arm.
        n: number of its joints.
        arm: ARM_WORK row.
        row: first row of `locked_rows` for the locked wrenches of this arm.

    Returns:
        False if columns of J are numerically dependent or M is not positive definite.
    """
    work = t.work
    joints = work.joints
    K = local(MAX_JOINTS, MAX_JOINTS)
    A = local(MAX_JOINTS, 6)  # (J K⁻ᵀ)ᵀ with more than six joints, else J
    Q = local(MAX_JOINTS, 6)
    R_T = local(6, 6)
    R_inv_T = local(6, 6)
    wide = n > 6
    columns = min(n, 6)
    if wide:
        if not weigh_joints(joints, lo, n, K, A):
            return False
    else:
        for i in range(6):  # J, whose columns are stored in the joints
            fill(A[i], ZERO)
            for j in range(n):
                A[i, j] = joints[lo + j].J[i]
    if not _qr_tall(A, max(n, 6), columns, Q, R_T):
        return False
    _store_wrenches(work.locked_rows, arm, row, n, Q)
    # rows of Q R⁻ᵀ: with more than six joints row i is that of A⁺, else column i of J̄
    set_identity(R_inv_T)
    forward_rows(R_T, columns, R_inv_T)
    for i in range(max(n, 6)):
        x = combined(Q[i], R_inv_T, columns)
        if wide:
            fill(joints[lo + i].J_bar, x)
        else:
            row_of_inverse = local(6)
            fill(row_of_inverse, x)
            for j in range(n):
                joints[lo + j].J_bar[i] = row_of_inverse[j]
    if wide:
        _weigh_inverse(joints, lo, n, K, arm.Lambda)
    else:
        _congruence_of_inertia(joints, lo, n, arm.Lambda)
    return True


@leaf
def _store_wrenches(locked_rows, arm, row, n, Q):
    """Store the wrenches that the joints of an arm of full rank resist, and its locked wrenches.

    With up to six joints these are the first n columns and the other columns of Q (6, 6). With more
    joints the arm resists all wrenches that its grasp transmits, and none is locked.

    Args:
        locked_rows: `locked_rows` of WORK, filled from `row` on.
        arm: ARM_WORK row, of which `kept`, `n_kept` and `n_locked` are filled.
        row: first row for the locked wrenches of this arm.
        n: number of its joints.
        Q: (6, 6) or larger, orthogonal factor of the Jacobian; not read with more than six joints.
    """
    arm.n_kept = min(n, 6)
    arm.n_locked = 6 - arm.n_kept
    for k in range(6):
        for i in range(6):
            if k >= n:
                locked_rows[row + k - n, i] = Q[i, k]
            else:
                arm.kept[k, i] = arm.passed[k, i] if n > 6 else Q[i, k]


@inner
def _congruence_of_inertia(joints, lo, n, Lambda):
    """Compute the operational-space inertia Λ = J̄ᵀMJ̄ (6, 6) of an arm, exactly symmetric.

    J̄ (n, 6) is the inertia-weighted inverse of its Jacobian in energy coordinates, M (n, n) its
    joint-space inertia; Λ is in energy coordinates, too.

    Args:
        joints: JOINT_WORK rows, of which J̄ and M are read.
        lo: index of the first joint of the arm.
        n: number of its joints.
        Lambda: (6, 6), filled.
    """
    Lambda[:] = 0.0
    for j in range(n):
        bar = joints[lo + j].J_bar
        x = ZERO  # row j of M J̄
        for k in range(n):
            x = add(x, joints[lo + j].M[k], joints[lo + k].J_bar)
        for i in range(6):
            accumulate(Lambda[i], bar[i], x)
    for i in range(1, 6):  # rounding errors of both triangles differ; the lower one is kept
        for j in range(i):
            Lambda[j, i] = Lambda[i, j]


@inner
def _qr_tall(A, rows, columns, Q, L):
    """Factorise A = Q Lᵀ by reflections 1 − β v vᵀ, one for each column of A (Householder).

    Reflection k maps the elements of column k from k on to α e_k, where α is the diagonal element
    of Lᵀ, and v is column k less α e_k. All six elements of a row are processed at once, which a
    compiler keeps in registers. The vectors v take the places of the columns of A.

    Args:
        A: (rows, 6), destroyed.
        rows: number of rows, at least six.
        columns: number of columns of A that are factorised.
        Q: (rows, 6), filled.
        L: (columns, columns), filled: lower triangular, with the reciprocals of its diagonal in
            place of the diagonal, the form of `cholesky`.

    Returns:
        False if a column depends on those before it.
    """
    products = local(6)
    beta = local(6)
    for k in range(columns):
        sums = scaled(A[k, k], A[k])
        for i in range(k + 1, rows):
            sums = add(sums, A[i, k], A[i])
        fill(products, sums)  # inner products of column k with all columns
        if not products[k] > 0.0:  # also if NaN
            return False
        (alpha, b) = reflector(products[k], A[k, k])
        fill(products, scaled(b, add(sums, -alpha, A[k])))  # β vᵀA
        for c in range(k + 1):  # columns up to k are finished: they must not change
            products[c] = 0.0
        A[k, k] -= alpha  # column k becomes v
        beta[k] = b
        changes = six(products)
        for i in range(k, rows):  # A ← A − v (β vᵀA)
            accumulate(A[i], -A[i, k], changes)
        for c in range(k + 1, columns):
            L[c, k] = A[k, c]
        L[k, k] = 1.0 / alpha
    for i in range(rows):
        fill(Q[i], ZERO)
        if i < 6:
            Q[i, i] = 1.0
    # Q is the product of the reflections, applied to the identity
    for k in range(columns - 1, -1, -1):
        sums = ZERO  # vᵀQ
        for i in range(k, rows):
            sums = add(sums, A[i, k], Q[i])
        changes = scaled(beta[k], sums)
        for i in range(k, rows):
            accumulate(Q[i], -A[i, k], changes)
    return True


@inner
def _decompose_by_svd(t, lo, n, m, arm, row):
    """Compute J̄ and Λ of any rank and for any grasp, by a singular value decomposition.

        A = N J K⁻ᵀ = UΣVᵀ,   J̄ = K⁻ᵀA⁺N,   Λ = NᵀA⁺ᵀA⁺N

    N (m, 6) are the wrenches that the grasp transmits, J (6, n) is the Jacobian, K (n, n) the
    factor of the joint-space inertia M = KKᵀ, J̄ (n, 6) the inverse of J and Λ (6, 6) the inertia
    at the tip. A⁺ omits the directions that count as locked: those with a singular value σ up to
    `rank_tolerance` σ_max/√(1 + σ_max²). Reads J and M of the joints, and `passed` (N). Fills J̄ of
    the joints and, of the arm, `Lambda`, `kept` (wrenches along the other directions), `n_kept` and
    `n_locked`; rows of `locked_rows` (wrenches along locked ones). All are in energy coordinates.

    Args:
        t: Tick.
        lo: first joint of the arm.
        n: number of its joints.
        m: number of independent wrenches that its grasp transmits.
        arm: ARM_WORK row.
        row: first row of `locked_rows` for the locked wrenches of this arm.

    Returns:
        False if M is not positive definite.
    """
    work = t.work
    joints = work.joints
    K = local(MAX_JOINTS, MAX_JOINTS)
    weighed = local(MAX_JOINTS, 6)
    X = local(6, JOINTS_AND_SIX)  # rows of UᵀA, behind them those of UᵀN
    if not weigh_joints(joints, lo, n, K, weighed):
        return False
    multiply_rows(arm.passed, m, weighed, n, X)
    one_sided_jacobi(X, m, n, 6)
    for j in range(n):
        fill(joints[lo + j].J_bar, ZERO)
    # rows of X are orthogonal now: n elements σvᵀ with the singular value σ, then the direction uᵀN
    arm.n_locked = 0
    arm.n_kept = 0
    largest = 0.0
    for k in range(m):
        largest = max(largest, dot(X[k], X[k], n))
    threshold = t.model.rank_tolerance * t.model.rank_tolerance * largest / (1.0 + largest)
    for k in range(m):
        square = dot(X[k], X[k], n)  # σ²
        u = X[k, n:]
        if square > threshold:  # adds the summand v/σ uᵀN of A⁺N
            for j in range(n):
                accumulate(joints[lo + j].J_bar, X[k, j] / square, u)
            fill(arm.kept[arm.n_kept], u)
            arm.n_kept += 1
        else:
            fill(work.locked_rows[row + arm.n_locked], u)
            arm.n_locked += 1
    _weigh_inverse(joints, lo, n, K, arm.Lambda)
    return True


@inner
def multiply_rows(rows, count, Y, n, out):
    """Fill `out` with [B Yᵀ, B] for a matrix B (count, 6): the product, and behind it B itself.

    Args:
        rows: (count, 6), B by rows.
        count: number of rows.
        Y: (n, 6).
        n: number of rows of Y.
        out: (count, n + 6), filled.
    """
    for a in range(count):
        for j in range(n):
            out[a, j] = dot6(rows[a], Y[j])
        fill(out[a, n:], rows[a])


@inner
def null_motions(arm_work, Y, n, motions):
    """Compute an orthonormal basis of joint motions v; those from row `n_kept` on have U Yᵀv = 0.

    U (n_kept, 6), `kept` of the arm, are the wrenches that the joints resist, and Yᵀ (6, n) maps
    joint motions to those of the tip, so the last n − n_kept motions do not move the object. The
    basis is the orthogonal factor of the QR decomposition of (U Yᵀ)ᵀ.

    Args:
        arm_work: ARM_WORK, of which `kept` is read, U, the wrenches that the joints resist.
        Y: (n, 6), for example Jᵀ or K⁻¹Jᵀ.
        n: number of joints of the arm.
        motions: (n, n), filled with one motion in each row.
    """
    X = local(6, JOINTS_AND_SIX)
    diagonal = local(MAX_JOINTS)
    beta = local(MAX_JOINTS)
    multiply_rows(arm_work.kept, arm_work.n_kept, Y, n, X)
    qr_rows(X, arm_work.n_kept, n, diagonal, beta)
    form_q(X, arm_work.n_kept, n, beta, n, motions)


@leaf
def effort_metric(t, lo, n, m, arm, out):
    """Compute the inverse metric of the least effort Σ τ²/τ_max² with which an arm exerts a wrench.

    It is J̄ᵀ τ_max² J̄ for an arm with at most m joints, whose torques are unique: J̄ (n, 6) is the
    inverse of the Jacobian J (6, n), τ_max² the diagonal matrix of the squared torque limits. For
    an arm with more joints it is Uᵀ(U J τ_max⁻² JᵀUᵀ)⁻¹U, where the rows of U (`kept` of the arm)
    are the wrenches that it can exert.

    Args:
        t: Tick.
        lo: first joint of the arm.
        n: number of its joints.
        m: number of independent wrenches that its grasp transmits.
        arm: ARM_WORK row.
        out: (6, 6), filled.

    Returns:
        False if the motors of the arm cannot exert all of these wrenches.
    """
    joints = t.work.joints
    table = t.model.joints
    count = arm.n_kept
    A = local(6, 6)
    factor = local(6, 6)
    x = local(6)
    out[:] = 0.0
    if n <= m:  # J̄ᵀ τ_max² J̄, with `effort` = τ_max²
        for j in range(lo, lo + n):
            add_square(table[j].effort, joints[j].J_bar, out)
        return True
    # A = U J τ_max⁻² JᵀUᵀ, with `ease` = 1/τ_max², and UᵀA⁻¹U by its Cholesky factor
    A[:] = 0.0
    fill(x, ZERO)
    for j in range(lo, lo + n):
        for a in range(count):
            x[a] = dot6(arm.kept[a], joints[j].J)
        add_square(table[j].ease, x, A)
    if count > 0 and not cholesky(A, 0, count, factor) > _LEAST_PIVOT:  # also if NaN
        return False
    for a in range(count):
        fill(A[a], arm.kept[a])
    forward_rows(factor, count, A)
    for a in range(count):
        add_square(1.0, A[a], out)
    return True


@inner
def retreat(t, arm, i, damping):
    """Compute the torque of joint i of an arm by the posture law, row i of M q̈.

        q̈ = k_p (q₀ − q) − k_d q̇

    M (n, n) is the joint-space inertia of the arm, q and q̇ are positions and speeds of its joints,
    q₀ the posture. Reads `posture_stiffness` k_p (1/s²) and `posture` q₀ of MODEL, q and q̇ of
    INPUT, and M.

    Args:
        t: Tick.
        arm: ARM row.
        i: index of the joint among the joints of all arms.
        damping: k_d (1/s).

    Returns:
        Torque or force (N m, N).
    """
    model = t.model
    torque = 0.0
    for j in range(arm.first, arm.end):
        acceleration = model.posture_stiffness * (model.joints[j].posture - t.input.q[j])
        acceleration = acceleration - damping * t.input.v[j]
        torque += t.work.joints[i].M[j - arm.first] * acceleration
    return torque


# --- Λ, μ, p, J, J̄, Φ and h of one arm at its tip in world axes, outside of a tick ----------------


@entry
def operational_space(raw, q, v, out):
    """Compute the operational-space terms of one arm for many states.

    A row of `out` contains the inertia Λ (6, 6) at the tip and its inverse Φ (6, 6), the Jacobian J
    (6, n) and its inertia-weighted inverse J̄ (n, 6), the wrenches μ (6,) and p (6,) of velocity
    and weight, J̇v (6,), the torques h (n,) of velocity and gravity, and the rank, in this order,
    matrices by rows.

    Args:
        raw: bytes of `records.Rows` with one arm alone.
        q, v: (rows · n,) joint positions and velocities.
        out: (rows, size), filled.

    Returns:
        Number of rows that were filled before the first state that is not finite or whose M is not
        positive definite.
    """
    t = row_of(raw, 0, 0)
    n = t.model.n_joints
    if len(q) != n * len(out) or len(v) != len(q):
        return 0
    for row in range(len(out)):
        first = row * n
        zero = finiteness(q[first:], n) + finiteness(v[first:], n)  # else NaN
        if not isfinite(zero) or not _arm_at_tip(t, n, q[first:], v[first:], out[row]):
            return row
    return len(out)


@inner
def _arm_at_tip(t, n, q, v, out):
    """Compute the operational-space terms of an arm at its tip, in world axes.

    They are the inertia Λ (6, 6) and its inverse Φ, the Jacobian J (6, n) and its inertia-weighted
    inverse J̄ (n, 6), the wrenches μ and p (6,) of velocity and weight, J̇v (6,), the torques h
    (n,) of velocity and gravity, and the rank. The rank is determined in energy coordinates of the
    reference object of the model, whose principal axes are taken along the world's. `Lambda` of the
    arm and J̄ of the joints are converted to world axes in place, and `drift` to the classical
    acceleration J̇v; J of the joints remains in energy coordinates.

    Args:
        t: Tick.
        n: number of joints.
        q, v: (n,) joint positions and velocities.
        out: row of `operational_space`, filled.

    Returns:
        False if M is not positive definite.
    """
    model = t.model
    work = t.work
    joints = work.joints
    arm = model.arms[0]
    arm_work = work.arms[0]
    drift = arm_work.drift
    root = local(6)
    K = local(MAX_JOINTS, MAX_JOINTS)
    weighed = local(MAX_JOINTS, 6)
    Phi = local(6, 6)
    mu = ZERO
    p = ZERO
    place_arm(t, arm, q)
    fill3(work.p_C, place_point(joints[arm.tip_joint], arm.tip[9:]))
    move_arm(t, arm, v, work.p_C, arm_work.V, drift, arm_work.bias)
    # from the spatial acceleration of the tip at q̈ = 0 to the classical one, J̇q̇
    fill3(drift, plus3(drift, cross(arm_work.V[3:], arm_work.V)))
    # energy coordinates along the world's axes: √m of linear axes, √I of the three angular ones
    for i in range(6):
        root[i] = model.roots[max(i - 2, 0)]
    for j in range(n):
        for i in range(6):
            joints[j].J[i] = root[i] * joints[j].column[i]
    if arm_terms(t, 0, n, 6, arm_work, 0) < 0:
        return False
    # Φ = J M⁻¹Jᵀ = weighedᵀ weighed, p = J̄ᵀg, and J̄ᵀ(h − g), which μ is before −Λ J̇q̇ is added
    weigh_joints(joints, 0, n, K, weighed)
    Phi[:] = 0.0
    for j in range(n):
        bar = joints[j].J_bar
        add_square(1.0, weighed[j], Phi)
        for a in range(6):  # to world axes
            bar[a] *= root[a]
        g = weight_on_joint(joints[j], model.gravity)
        p = add(p, g, bar)
        mu = add(mu, joints[j].h - g, bar)
    for a in range(6):  # to world axes
        for b in range(6):
            arm_work.Lambda[a, b] *= root[a] * root[b]
            Phi[a, b] /= root[a] * root[b]
    _write_terms(t, n, Phi, mu, p, out)
    return True


@inner
def _write_terms(t, n, Phi, mu, p, out):
    """Write the terms of an arm at its tip (world axes) to a row of numbers, in a fixed order.

    The order is: inertia Λ (6, 6), its inverse Φ (6, 6), Jacobian J (6, n), its inertia-weighted
    inverse J̄ (n, 6), all by rows; wrenches μ (6,) of velocity and p (6,) of weight (N, N m), drift
    J̇v (6,; m/s², rad/s²), torques h (n,; N m, N) of velocities and gravity, and the rank.

    Args:
        t: Tick, with Λ, J̇v and the rank of its arm 0, and J, J̄ and h of the joints.
        n: number of joints.
        Phi: (6, 6) Φ.
        mu: (6,) μ + Λ J̇v, from which Λ J̇v is subtracted here.
        p: (6,).
        out: row, filled.
    """
    arm_work = t.work.arms[0]
    joints = t.work.joints
    # places of Φ, J, J̄, μ, p, J̇v, h and the rank in the row
    at_Phi = 36
    at_J = 72
    at_J_bar = at_J + 6 * n
    at_mu = at_J_bar + 6 * n
    at_p = at_mu + 6
    at_drift = at_p + 6
    at_h = at_drift + 6
    for a in range(6):
        for b in range(6):
            out[6 * a + b] = arm_work.Lambda[a, b]
            out[at_Phi + 6 * a + b] = Phi[a, b]
        for j in range(n):
            out[at_J + a * n + j] = joints[j].column[a]
            out[at_J_bar + 6 * j + a] = joints[j].J_bar[a]
        out[at_mu + a] = mu[a] - dot6(arm_work.Lambda[a], arm_work.drift)
        out[at_p + a] = p[a]
        out[at_drift + a] = arm_work.drift[a]
    for j in range(n):
        out[at_h + j] = joints[j].h
    out[at_h + n] = arm_work.n_kept
