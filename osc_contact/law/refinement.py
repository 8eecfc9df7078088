"""Refinement of the torque program's solution: its active limits hold as equations."""

from __future__ import annotations

from osc_contact.law.algebra import add_scaled, back_substitute, dot, qr_rows, reflect
from osc_contact.law.jit import inner, matrix

_LEAST_REMAINDER = 1e-9  # part of a unit row outside the span of former rows that counts as zero
_ROOM = 1e-7  # relative tolerance of the bounds for a refined solution


@inner
def refine(p, slack):
    """Compute the solution `point` again, with the active limits as equations.

    The program is min |rowsᵀz|² with lower ≤ (z, A z) ≤ upper. z are v variables: changes of the
    motors' torques, then the slack variables; `rows` (v, w) are their coefficients in the w
    residuals, A (k, v) those in the k contact forces that have limits. This least-squares problem
    has the square root of the condition number of the Hessian rows rowsᵀ, so `point` is more
    accurate than the solver's z. Limits are active where the solver's multipliers are not 0:

    1. Variables at a limit are fixed, which leaves f free ones, with the coefficients `reduced`;
       the constant part of residuals and forces is `offset` (`_fix_variables`).
    2. Each active limit of A z determines one more variable after a reflection of the free ones
       (`_eliminate_limits`).
    3. The rest is solved by QR, and the reflections are reversed.

    Reads `rows`, A, `lower`, `upper` and `lam`. Fills `point` (v,); the other tables that this
    module fills are scratch.

    Args:
        p: PROGRAM with the solver's multipliers `lam` (v + k,) of z and A z: > 0 at an upper bound,
            < 0 at a lower bound, 0 between them.
        slack: number of slack variables: 0, or k, if the k forces may leave their ranges at a cost.

    Returns:
        False if `point` violates another limit, or if H is singular on the active limits; then
        `point` is not to be used.
    """
    k = p.k
    v = len(p.tau) + slack
    # elements of a row of `rows`: energies of motion (d), force (6), squeeze (s), idle joints
    w = 6 + p.d + p.s + len(p.idle) + v  # and a diagonal of all variables
    A = matrix(p.A, 0, k, v)
    y = p.y
    target = p.offset
    f = _fix_variables(p, A, v, w)  # number of free variables; `offset` is that of the residuals
    eliminated = _eliminate_limits(p, v, w, f)
    remaining = p.reduced[eliminated:]
    if not qr_rows(remaining, f - eliminated, w, p.diagonal, p.beta):
        return False
    # The remaining variables x minimise |remainingᵀx + target|²: x = −R⁻¹Qᵀtarget.
    for c in range(f - eliminated):
        reflect(remaining[c, c:], p.beta[c], w - c, target[c:])
    back_substitute(remaining, f - eliminated, 1, p.diagonal, matrix(target, 0, len(target), 1))
    for c in range(f - eliminated):
        y[eliminated + c] = -target[c]
    # Reflections are their own inverses; they are applied in the opposite order.
    for b in range(eliminated - 1, -1, -1):
        reflect(p.normals[b], p.bend[b], f - b, y[b:])
    for j in range(f):
        p.point[p.free[j]] = y[j]
    return _is_within_bounds(p, A, v)


@inner
def _fix_variables(p, A, v, w):
    """Fix the variables whose limits are active, and list the others.

    Reads `rows` (v, w), the bounds `lower` and `upper` (v + k,), and the solver's multipliers `lam`
    (v + k,): a variable is fixed at its upper bound if its multiplier is > 0, at its lower bound if
    < 0, and free if 0. Fills `point` (v,) with the values of the fixed variables, 0 for free ones;
    `offset` (w + k,), the products of these values with `rows` and with A; `free` (f,), the indices
    of the free variables; and `reduced` (f, w + k), their rows of `rows`, followed by their columns
    of A.

    Args:
        p: PROGRAM.
        A: (k, v) coefficients of the sums of variables that have limits, too.
        v: number of variables.
        w: length of a row of `rows`.

    Returns:
        Number f of free variables.
    """
    f = 0
    p.offset[:] = 0.0
    for j in range(v):
        # Row f is the next row for a free variable; for a fixed one it is scratch only, since f
        # does not advance and the next variable overwrites it.
        for i in range(w + p.k):
            p.reduced[f, i] = p.rows[j, i] if i < w else A[i - w, j]
        if p.lam[j] == 0.0:
            p.point[j] = 0.0
            p.free[f] = j
            f += 1
        else:
            p.point[j] = p.upper[j] if p.lam[j] > 0.0 else p.lower[j]
            add_scaled(p.point[j], p.reduced[f], w + p.k, p.offset)
    return f


@inner
def _eliminate_limits(p, v, w, f):
    """Eliminate one free variable by each active limit of A.

    A limit c is active if its multiplier `lam[v + c]` is not 0: at its upper bound if > 0, at its
    lower one if < 0. A reflector 1 − β n nᵀ of the free variables maps the coefficients of the
    limit to the first of the remaining variables, whose value then follows from the bound alone.
    Dependent limits are skipped. Fills `normals` (rows n, each followed by scratch) and `bend` (β)
    of the reflectors, and `y` (values of the eliminated variables); applies the reflectors to
    `reduced` (f, w + k), and adds the products of the eliminated values to `offset` (w + k,). `mix`
    and `diagonal` are scratch.

    Args:
        p: PROGRAM after `_fix_variables`.
        v: number of variables.
        w: length of a row of `rows`.
        f: number of free variables.

    Returns:
        Number of eliminated variables.
    """
    k = p.k
    eliminated = 0
    for c in range(k):
        normal = p.normals[eliminated]  # overwritten by the next limit unless this one is active
        remaining = p.reduced[eliminated:]
        for j in range(f - eliminated):  # behind w elements of `rows` follow those of A
            normal[j] = remaining[j, w + c]
        if p.lam[v + c] == 0.0 or eliminated == f:
            continue
        bend = p.bend[eliminated:]
        mirrored = qr_rows(p.normals[eliminated:], 1, f - eliminated, p.diagonal, bend)
        if not mirrored or abs(p.diagonal[0]) <= _LEAST_REMAINDER:
            continue
        p.mix[:] = 0.0  # becomes β nᵀremaining
        for j in range(f - eliminated):
            add_scaled(bend[0] * normal[j], remaining[j], w + k, p.mix)
        for j in range(f - eliminated):
            add_scaled(-normal[j], p.mix, w + k, remaining[j])
        bound = p.upper[v + c] if p.lam[v + c] > 0.0 else p.lower[v + c]
        p.y[eliminated] = (bound - p.offset[w + c]) / p.diagonal[0]
        add_scaled(p.y[eliminated], remaining[0], w + k, p.offset)
        eliminated += 1
    return eliminated


@inner
def _is_within_bounds(p, A, v):
    """Determine whether `point` and A `point` are within all bounds, up to `_ROOM`.

    Args:
        p: PROGRAM, of which `point`, `lower` and `upper` are read.
        A: (k, v) coefficients of the sums of variables that have limits.
        v: number of variables.
    """
    for j in range(v + p.k):
        x = p.point[j] if j < v else dot(A[j - v], p.point, v)
        room = _ROOM * (1.0 + abs(x))
        if not p.lower[j] - room <= x <= p.upper[j] + room:  # also if NaN
            return False
    return True
