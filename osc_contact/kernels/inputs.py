"""What comes into a tick: checked, and kept for whoever looks at the signals afterwards."""

from __future__ import annotations

from math import isfinite

from osc_contact.kernels import layout as at
from osc_contact.kernels.compile import compiled, integers, matrix, vector

__all__ = ["choose", "commit", "fit", "keep"]


@compiled
def choose(bound, sizes):
    """List the columns of N whose contacts are in force; returns their number."""
    terms, owners = matrix(bound, at.TERMS), integers(bound, at.COLUMNS_I)
    chosen = integers(bound, at.KEEP)[:, 1]
    count = 0
    for j in range(sizes[at.N_COLUMNS]):
        if terms[owners[j, 0], 0] != 0.0:
            chosen[count] = j
            count += 1
    return count


@compiled
def fit(bound, sizes, q, v, wrenches, X_WD, V_D, A_D, alpha_d, squeeze, engaged, moving):
    """Whether what came in has the right sizes and is finite."""
    n, arms, r_all = sizes[at.N_JOINTS], sizes[at.N_ARMS], sizes[at.N_COLUMNS]
    if q.size != n or v.size != n or wrenches.shape[0] != arms or wrenches.shape[1] != 6:
        return False
    if V_D.size != 6 or A_D.size != 6 or (engaged and alpha_d.size != r_all):
        return False
    inputs = vector(bound, at.INPUTS)
    if inputs.size < 2 * n + 6 * arms + 31 + alpha_d.size + at.STATE_SIZE:
        return False
    s = squeeze * 0.0  # NaN if anything is NaN or inf
    for i in range(n):
        s += q[i] * 0.0 + v[i] * 0.0
    for k in range(arms):
        for i in range(6):
            s += wrenches[k, i] * 0.0
    for i in range(4):
        for j in range(4):
            s += X_WD[i, j] * 0.0
    for i in range(6):
        s += V_D[i] * 0.0 + A_D[i] * 0.0
    for i in range(alpha_d.size):
        s += alpha_d[i] * 0.0
    if moving:
        touched = matrix(bound, at.TOUCHED)
        for c in range(sizes[at.N_CONTACTS]):
            for i in range(28):
                s += touched[c, i] * 0.0
    return isfinite(s)


@compiled
def keep(bound, sizes, q, v, wrenches, X_WD, V_D, A_D, alpha_d, squeeze, moving):
    """Copy what came in (q, v, wrenches, X_WD, V_D, A_D, squeeze, moving, α_d), then the state."""
    n = sizes[at.N_JOINTS]
    inputs, state = vector(bound, at.INPUTS), vector(bound, at.STATE)
    for i in range(n):
        inputs[i] = q[i]
        inputs[n + i] = v[i]
    k = 2 * n
    for i in range(sizes[at.N_ARMS]):
        for j in range(6):
            inputs[k + j] = wrenches[i, j]
        k += 6
    for i in range(4):
        for j in range(4):
            inputs[k + j] = X_WD[i, j]
        k += 4
    for i in range(6):
        inputs[k + i] = V_D[i]
        inputs[k + 6 + i] = A_D[i]
    inputs[k + 12] = squeeze
    inputs[k + 13] = 1.0 if moving else 0.0
    inputs[k + 14] = alpha_d.size
    for i in range(alpha_d.size):
        inputs[k + 15 + i] = alpha_d[i]
    for i in range(at.STATE_SIZE):
        inputs[inputs.size - at.STATE_SIZE + i] = state[i]
    terms, terms_before = matrix(bound, at.TERMS), matrix(bound, at.TERMS_BEFORE)
    touched, before = matrix(bound, at.TOUCHED), matrix(bound, at.TOUCHED_BEFORE)
    for c in range(sizes[at.N_CONTACTS]):
        for i in range(4):
            terms_before[c, i] = terms[c, i]
        for i in range(28 if moving else 0):
            before[c, i] = touched[c, i]


@compiled
def commit(bound, r):
    """The integrators move on."""
    signals, state = vector(bound, at.SIGNALS), vector(bound, at.STATE)
    for i in range(6):
        state[at.ERROR_SUM + i] = signals[at.ERROR_SUM_NEXT + i]
    for a in range(r):
        state[at.FORCE_SUM + a] = signals[at.FORCE_SUM_NEXT + a]
    state[at.FORCE_RANK] = r
