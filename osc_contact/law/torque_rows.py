"""Rows of the torque allocation: Z = A R⁻¹Aᵀ of A = [G; E], its factor, row by row of E.

A row of E that the rows before it decide (a squeeze that the grasps do not pass on) has a pivot of
zero. Elimination leaves rounding errors there, as large as eps times the condition number of Z,
and near a singular posture no threshold tells them from a pivot. So what is left of a doubtful row
is projected a second time, in the joints, as in Gram-Schmidt with reorthogonalisation (Björck,
Numerical Methods for Least Squares Problems, 1996, section 2.4.5).
"""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import cholesky
from osc_contact.law.jit import inner
from osc_contact.law.refinement import dot
from osc_contact.law.six import add, dot6, fill, reflect, reflect_back, scaled, times6

_DRIVEN = 1e-12  #: least share of a pivot of Z
_DOUBTFUL = 1e-6  #: pivots of less share than this are computed twice


@inner
def factor_effort(t):
    """Factor of the block G R⁻¹Gᵀ, into Z; False: motors do not drive all motions."""
    work = t.work
    Z = t.work.factor
    d = 6 - work.locked
    for i in range(d):
        for j in range(i + 1):
            Z[i, j] = work.effort[work.locked + i, work.locked + j]
    return cholesky(Z, 0, d, Z) > _DRIVEN


@inner
def add_row(t, e):
    """Factor of Z with one row more; False: the rows before it decide what E[e]τ is.

    Args:
        e: the row of E.
    """
    E = t.work.extra
    weighed = t.work.weighed
    Z = t.work.factor
    size = 6 - t.work.locked + e
    row = Z[size]
    for k in range(t.model.n_arms):
        _weigh(t, t.model.arms[k], t.work.arms[k], E[e], weighed[e])
    _multiply(t, weighed[e], e, row)
    whole = row[size] = dot(weighed[e], E[e], t.model.n_joints)
    left = whole - _eliminate(Z, size, row)
    if left < _DOUBTFUL * whole:
        left = _project_again(t, e)
    if not left > _DRIVEN * whole:
        return False
    row[size] = 1.0 / sqrt(left)
    return True


@inner
def _multiply(t, weighed, e, out):
    """out = A R⁻¹a, the products of a weighed row with G and with E[:e]."""
    work = t.work
    joints = t.work.joints
    m = work.locked
    x = scaled(weighed[0], joints[0].J_bar)
    for j in range(1, t.model.n_joints):
        x = add(x, weighed[j], joints[j].J_bar)
    fill(work.u, x)
    reflect(work.reflectors, work.beta, m, work.u)
    for i in range(6 - m):
        out[i] = work.u[m + i]
    for c in range(e):
        out[6 - m + c] = dot(weighed, t.work.extra[c], t.model.n_joints)


@inner
def _eliminate(Z, size, x):
    """x[:size] = L⁻¹x, L the factor in Z; returns its square."""
    square = 0.0
    for i in range(size):
        s = x[i]
        for k in range(i):
            s -= Z[i, k] * x[k]
        x[i] = s * Z[i, i]
        square += x[i] * x[i]
    return square


@inner
def _project_again(t, e):
    """The pivot of row e, from what is left of it in the joints; mends its row of the factor."""
    work = t.work
    E = t.work.extra
    Z = t.work.factor
    n = t.model.n_joints
    m = work.locked
    size = 6 - m + e
    left = work.left
    weighed = work.left_weighed
    x = work.products
    for i in range(size - 1, -1, -1):  # multipliers of the rows before: L⁻ᵀ
        s = Z[size, i]
        for k in range(i + 1, size):
            s -= Z[k, i] * x[k]
        x[i] = s * Z[i, i]
    for i in range(6):
        work.u[i] = x[i - m] if i >= m else 0.0
    reflect_back(work.reflectors, work.beta, m, work.u)
    for j in range(n):
        s = E[e, j] - dot6(t.work.joints[j].J_bar, work.u)
        for c in range(e):
            s -= x[6 - m + c] * E[c, j]
        left[j] = s
    for k in range(t.model.n_arms):
        _weigh(t, t.model.arms[k], t.work.arms[k], left, weighed)
    _multiply(t, weighed, e, x)
    pivot = dot(weighed, left, n) - _eliminate(Z, size, x)
    for i in range(size):
        Z[size, i] += x[i]
    return pivot


@inner
def _weigh(t, arm, own, row, out):
    """out = R⁻¹ row, over one arm's joints."""
    joints = t.work.joints
    lo = arm.first
    hi = arm.end
    if own.wide == 0:
        for j in range(lo, hi):
            out[j] = t.model.joints[j].effort * row[j]
        return
    x = scaled(row[lo], joints[lo].J)
    for j in range(lo + 1, hi):
        x = add(x, row[j], joints[j].J)
    x = times6(own.effort, x)
    for j in range(lo, hi):
        out[j] = dot6(joints[j].J, x)
