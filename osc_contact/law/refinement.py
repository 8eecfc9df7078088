"""Refinement of the torque program's solution: its active limits hold as equations."""

from __future__ import annotations

from osc_contact.law.algebra import add_scaled, back_substitute, dot, qr_rows, reflect
from osc_contact.law.jit import inner, matrix

_DEPENDENT = 1e-9  # part of a unit row outside the span of former rows that counts as zero
_ROOM = 1e-7  # relative tolerance of the bounds for a refined solution


@inner
def refine(p, slack):
    """Compute the solution `point` again, with the active limits as equations.

    The least-squares problem in `rows` has the square root of H's condition number, so `point` is
    more accurate than the solver's z. Limits are active where the solver's multipliers are not 0.
    Variables at a limit are fixed, active limits of A are eliminated one by one by a reflection of
    the free variables, and the rest is solved by QR.

    Args:
        p: PROGRAM with the solver's multipliers `lam`. slack: number of slack variables, as in
            `prepare`.

    Returns:
        False if `point` violates another limit, or if the active limits are dependent.
    """
    k = p.k
    v = len(p.tau) + slack
    w = 6 + p.d + p.s + len(p.idle) + v
    A = matrix(p.A, 0, k, v)
    y = p.y
    target = p.t
    f = _fix_variables(p, A, v, w)
    eliminated = _eliminate_limits(p, v, w, f)
    remaining = p.reduced[eliminated:]
    if not qr_rows(remaining, f - eliminated, w, p.diagonal, p.beta):
        return False
    for c in range(f - eliminated):
        reflect(remaining[c, c:], p.beta[c], w - c, target[c:])
    back_substitute(remaining, f - eliminated, 1, p.diagonal, matrix(target, 0, len(target), 1))
    for c in range(f - eliminated):
        y[eliminated + c] = -target[c]
    for b in range(eliminated - 1, -1, -1):
        reflect(p.normals[b], p.bend[b], f - b, y[b:])
    for j in range(f):
        p.point[p.free[j]] = y[j]
    return _is_within_bounds(p, A, v)


@inner
def _fix_variables(p, A, v, w):
    """Fix the variables whose limits are active, and list the others.

    Reads `rows`, `lam`, `lower`, `upper`. Fills `point` of the fixed variables; `t` (w + k,), the
    products of their values with `rows` and with A; `free`, the indices of the other variables, and
    their rows of `rows` and columns of A in `reduced` (f, w + k).

    Args:
        p: PROGRAM. A: (k, v) limits of sums. v: number of variables. w: length of a row of `rows`.

    Returns:
        Number f of free variables.
    """
    f = 0
    p.t[:] = 0.0
    for j in range(v):
        for i in range(w + p.k):
            p.reduced[f, i] = p.rows[j, i] if i < w else A[i - w, j]
        if p.lam[j] == 0.0:
            p.point[j] = 0.0
            p.free[f] = j
            f += 1
        else:
            p.point[j] = p.upper[j] if p.lam[j] > 0.0 else p.lower[j]
            add_scaled(p.point[j], p.reduced[f], w + p.k, p.t)
    return f


@inner
def _eliminate_limits(p, v, w, f):
    """Eliminate one free variable by each active limit of A.

    A reflector maps the limit's coefficients to the first of the remaining variables, whose value
    follows from the bound. Dependent limits are skipped. Fills `normals` and `bend` (vectors and β
    of the reflectors), `y` (values of the eliminated variables); changes `reduced` and `t`.

    Args:
        p: PROGRAM after `_fix_variables`. v: number of variables. w: length of a row of `rows`.
        f: number of free variables.

    Returns:
        Number of eliminated variables.
    """
    k = p.k
    eliminated = 0
    for c in range(k):
        normal = p.normals[eliminated]
        remaining = p.reduced[eliminated:]
        for j in range(f - eliminated):
            normal[j] = remaining[j, w + c]
        if p.lam[v + c] == 0.0 or eliminated == f:
            continue
        bend = p.bend[eliminated:]
        mirrored = qr_rows(p.normals[eliminated:], 1, f - eliminated, p.diagonal, bend)
        if not mirrored or abs(p.diagonal[0]) <= _DEPENDENT:
            continue
        p.mix[:] = 0.0
        for j in range(f - eliminated):
            add_scaled(bend[0] * normal[j], remaining[j], w + k, p.mix)
        for j in range(f - eliminated):
            add_scaled(-normal[j], p.mix, w + k, remaining[j])
        bound = p.upper[v + c] if p.lam[v + c] > 0.0 else p.lower[v + c]
        p.y[eliminated] = (bound - p.t[w + c]) / p.diagonal[0]
        add_scaled(p.y[eliminated], remaining[0], w + k, p.t)
        eliminated += 1
    return eliminated


@inner
def _is_within_bounds(p, A, v):
    """Determine whether `point` and A `point` are within all bounds, up to `_ROOM`.

    Args:
        p: PROGRAM, of which `point`, `lower` and `upper` are read. A: (k, v). v: number of
            variables.
    """
    for j in range(v + p.k):
        x = p.point[j] if j < v else dot(A[j - v], p.point, v)
        room = _ROOM * (1.0 + abs(x))
        if not p.lower[j] - room <= x <= p.upper[j] + room:  # also if NaN
            return False
    return True
