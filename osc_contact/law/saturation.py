"""What a saturated tick left in its records, as the quadratic program of `limits`."""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import cholesky, cholesky_solve
from osc_contact.law.arm_terms import factor_inertia
from osc_contact.law.jit import entry, inner
from osc_contact.law.layout import row_of
from osc_contact.law.phases import limit_changes
from osc_contact.law.safety import count_computed
from osc_contact.law.six import ZERO, add, dot6, fill, reflect

_FLOOR = 1.0  #: N, least force of contacts that cannot pull; a command below it is its own floor


@inner
def _shares(t, alpha, share, floor, k_max):
    """Forces that must not pull, out of α: the split of least squares, and their least values."""
    work = t.work
    columns = t.work.columns
    r = work.rank
    count = work.count
    G = work.A
    x = work.u
    k = 0
    if r < count:
        for a in range(r):
            for b in range(r):
                G[a, b] = 0.0
                for j in range(count):
                    G[a, b] += columns[j].share[a] * columns[j].share[b]
        cholesky(G, 0, r, work.B)
    for j in range(count):
        if t.model.bodies[t.model.columns[columns[j].chosen].contact].pushes == 0 or k == k_max:
            continue
        for a in range(r):
            x[a] = columns[j].share[a] if r < count else (1.0 if a == j else 0.0)
        if r < count:
            cholesky_solve(work.B, r, x, 0)
        s = 0.0
        for a in range(r):
            share[k, a] = x[a]
            s += x[a] * alpha[a]
        floor[k] = min(_FLOOR, s)
        k += 1
    return k


@inner
def _idle_motions(t, arm, own, idle, count):
    """Rows ν of a redundant arm, νᵀMν = 1, out of M⁻¹(1 − JᵀJ̄ᵀ); the number of rows so far."""
    table = t.model.joints
    joints = t.work.joints
    work = t.work
    lo = arm.first
    n = arm.end - arm.first
    K = work.K
    X = work.X
    Z = work.Z
    if n <= arm.m or not factor_inertia(lo, n, joints, K):
        return count
    for c in range(n):  # rows of X: torques that do nothing to the object; of Z: what they move
        for i in range(n):
            X[c, i] = (1.0 if i == c else 0.0) - dot6(joints[lo + i].J, joints[lo + c].J_bar)
            Z[c, i] = X[c, i]
        cholesky_solve(K, n, Z[c], 0)
    for _ in range(n - own.n_kept):
        best = 0
        most = 0.0
        for c in range(n):
            size = 0.0
            for i in range(n):
                size += X[c, i] * Z[c, i]
            if size > most:
                best = c
                most = size
        if count == len(idle) or most <= 0.0:
            return count
        for i in range(n):
            work.s[i] = X[best, i] / sqrt(most)
            work.t[i] = Z[best, i] / sqrt(most)
            if table[lo + i].motor >= 0:
                idle[count, table[lo + i].motor] = work.t[i]
        count += 1
        for c in range(n):
            along = 0.0
            for i in range(n):
                along += X[c, i] * work.t[i]
            for i in range(n):
                X[c, i] -= along * work.s[i]
                Z[c, i] -= along * work.t[i]
    return count


@entry
def fill_program(raw, at, i, given, sizes):
    """Fill the arrays of `limits.TorqueLimits`.

    Args:
        raw, at: as of `tick.rows`. i: a row whose tick has ended SATURATED just now.
        given: wanted, tau_max, G, Λ, N, N_μ, Φ_e, α, share, floor, E, carried, idle.
        sizes: (4,) d, r, k, s, filled, too.
    """
    t = row_of(raw, at, i)
    model = t.model
    work = t.work
    arms = model.arms
    joints = t.work.joints
    table = model.joints
    rows = t.work.extra
    n = model.n_joints
    m = work.locked
    r = work.rank
    wanted, tau_max, G, Lambda, N, pushed, Phi_e, alpha, share, floor, E, carried, idle = given
    for j in range(n):
        motor = table[j].motor
        if motor < 0:
            continue
        wanted[motor], tau_max[motor] = joints[j].tau, table[j].tau_max
        fill(G[motor], joints[j].J_bar)
        reflect(work.reflectors, work.beta, m, G[motor])
    held = 1.0 if model.held != 0 else 0.0
    for a in range(6):
        for b in range(6):
            Lambda[a, b] = work.Lambda[a, b] + (held if a == b else 0.0)
    for a in range(r):
        alpha[a] = work.alpha_u[a]
        for i in range(6):
            N[a, i], pushed[a, i] = work.N_t[a, i], work.pushed_t[a, i]
        for b in range(r):
            Phi_e[a, b] = work.Phi_mu[a, b]
    for e in range(work.n_internal):
        fill(carried[e], ZERO)
        for k in range(model.n_arms):
            lo = arms[k].first
            hi = arms[k].end
            for j in range(lo, hi):
                s = 0.0
                for i in range(lo, hi):
                    s += rows[e, i] * joints[i].M[j - lo]
                fill(carried[e], add(carried[e], s, joints[j].J_bar))
        reflect(work.reflectors, work.beta, m, carried[e])
        for j in range(n):
            if table[j].motor >= 0:
                E[e, table[j].motor] = rows[e, j]
    count = 0
    for c in range(len(idle)):
        for i in range(model.n_motors):
            idle[c, i] = 0.0
    for k in range(model.n_arms):
        if len(idle) > 0:
            count = _idle_motions(t, arms[k], work.arms[k], idle, count)
    sizes[0] = 6 - m
    sizes[1] = r
    sizes[3] = work.n_internal
    sizes[2] = _shares(t, alpha, share, floor, len(floor))


@entry
def settle(raw, at, i, found, lost_force, lost_squeeze):
    """Torques found, no faster than motors may change; the next tick starts from them.

    Args:
        raw, at, i: as of `fill_program`. found: (motors,) torques within the limits.
        lost_force, lost_squeeze: desired less what will come: the force integral does not
            integrate it.
    """
    t = row_of(raw, at, i)
    model = t.model
    memory = t.memory
    work = t.work
    count_computed(t)
    for j in range(model.n_motors):
        work.tau[j] = found[j]
    if memory.ticked > 1:
        limit_changes(t)
    for j in range(model.n_motors):
        memory.torques[j] = work.tau[j]
    for a in range(work.rank):
        memory.force_sum[a] = work.force_next[a] - work.gain[a] * work.dt * lost_force[a]
    memory.force_rank = work.rank
    if work.n_internal > 0 and model.n_arms == 2:
        work.internal[0] -= lost_squeeze[0]
