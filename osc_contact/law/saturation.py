"""What a saturated tick left in its records, as the quadratic program of `limits`."""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import cholesky, cholesky_solve
from osc_contact.law.arm_terms import factor_inertia
from osc_contact.law.jit import entry, inner, matrix, numbers
from osc_contact.law.phases import haste, slew, torque_rate
from osc_contact.law.safety import count_computed
from osc_contact.law.six import dot6, reflect
from osc_contact.law.tables import (
    read_arm_work,
    read_arms,
    read_bodies,
    read_chain,
    read_column_work,
    read_columns,
    read_contact_memory,
    read_joint_work,
    read_joints,
    read_memory,
    read_work,
)

__all__ = ["fill", "settle"]

_FLOOR = 1.0  #: N, least force of contacts that cannot pull; a command below it is its own floor


@inner
def _shares(work, owners, bodies, columns, alpha, share, floor, k_max):
    """Forces that must not pull, out of α: the split of least squares, and their least values."""
    r, count, G, x, k = work.rank, work.count, work.A, work.u, 0
    if r < count:
        for a in range(r):
            for b in range(r):
                G[a, b] = 0.0
                for j in range(count):
                    G[a, b] += columns[j].share[a] * columns[j].share[b]
        cholesky(G, 0, r, work.B)
    for j in range(count):
        if bodies[owners[columns[j].chosen].contact].pushes == 0 or k == k_max:
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
def _idle_motions(arm, own, table, joints, work, idle, count):
    """Rows ν of a redundant arm, νᵀMν = 1, out of M⁻¹(1 − JᵀJ̄ᵀ); the number of rows so far."""
    lo, n, K, X, Z = arm.first, arm.end - arm.first, work.K, work.X, work.Z
    if n <= arm.m or not factor_inertia(lo, n, joints, K):
        return count
    for c in range(n):  # rows of X: torques that do nothing to the object; of Z: what they move
        for i in range(n):
            X[c, i] = (1.0 if i == c else 0.0) - dot6(joints[lo + i].J, joints[lo + c].J_bar)
            Z[c, i] = X[c, i]
        cholesky_solve(K, n, Z[c], 0)
    for _ in range(n - own.n_kept):
        best, most = 0, 0.0
        for c in range(n):
            size = 0.0
            for i in range(n):
                size += X[c, i] * Z[c, i]
            if size > most:
                best, most = c, size
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
def fill(model, raw, given, sizes):
    """Fill the arrays of `limits.TorqueLimits`.

    Args:
        model, raw: bytes of one row of MODEL, and of WORK after a tick that ended SATURATED.
        given: wanted, tau_max, G, Λ, N, N_μ, Φ_e, α, share, floor, E, carried, idle.
        sizes: (4,) d, r, k, s, filled, too.
    """
    chain, work = read_chain(model, 0, 1)[0], read_work(raw, 0, 1)[0]
    n, m, r = chain.n_joints, work.locked, work.rank
    table, joints = read_joints(model, chain.joints_at, n), read_joint_work(
        raw, chain.joint_work_at, n
    )  # fmt: skip
    arms = read_arms(model, chain.arms_at, chain.n_arms)
    arm_work = read_arm_work(raw, chain.arm_work_at, chain.n_arms)
    bodies = read_bodies(model, chain.bodies_at, chain.n_contacts)
    owners = read_columns(model, chain.columns_at, chain.n_columns)
    columns = read_column_work(raw, chain.column_work_at, chain.n_columns)
    rows = matrix(
        numbers(raw, chain.extra_at, chain.n_extra * n), 0, chain.n_extra, n
    )  # fmt: skip
    wanted, tau_max, G, Lambda, N, pushed, Phi_e, alpha, share, floor, E, carried, idle = given
    for j in range(n):
        i = table[j].motor
        if i < 0:
            continue
        wanted[i], tau_max[i] = joints[j].tau, table[j].tau_max
        for a in range(6):
            G[i, a] = joints[j].J_bar[a]
        reflect(work.reflectors, work.beta, m, G[i])
    held = 1.0 if chain.held != 0 else 0.0
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
        for a in range(6):
            carried[e, a] = 0.0
        for k in range(chain.n_arms):
            lo, hi = arms[k].first, arms[k].end
            for j in range(lo, hi):
                s = 0.0
                for i in range(lo, hi):
                    s += rows[e, i] * joints[i].M[j - lo]
                for a in range(6):
                    carried[e, a] += s * joints[j].J_bar[a]
        reflect(work.reflectors, work.beta, m, carried[e])
        for j in range(n):
            if table[j].motor >= 0:
                E[e, table[j].motor] = rows[e, j]
    count = 0
    for c in range(len(idle)):
        for i in range(chain.n_motors):
            idle[c, i] = 0.0
    for k in range(chain.n_arms):
        if len(idle) > 0:
            count = _idle_motions(arms[k], arm_work[k], table, joints, work, idle, count)
    sizes[0], sizes[1], sizes[3] = 6 - m, r, work.n_internal
    sizes[2] = _shares(work, owners, bodies, columns, alpha, share, floor, len(floor))


@entry
def settle(model, raw, memory_bytes, found, lost_force, lost_squeeze, tau):
    """Torques found to tau, no faster than motors may change; the memory goes on with them.

    Args:
        model, raw, memory_bytes: of one row. found: (motors,) torques within the limits.
        lost_force, lost_squeeze: wanted less what will come: the force integral does not
            integrate it. tau: (motors,) filled.
    """
    chain, work = read_chain(model, 0, 1)[0], read_work(raw, 0, 1)[0]
    memory = read_memory(memory_bytes, 0, 1)[0]
    last = numbers(memory_bytes, chain.torque_memory_at, chain.n_motors)
    count_computed(memory)
    for i in range(chain.n_motors):
        tau[i] = found[i]
    if memory.ticked > 1:
        step = numbers(raw, chain.flat_at + 40 * chain.n_columns, chain.n_motors)
        table = read_joints(model, chain.joints_at, chain.n_joints)
        contacts = read_contact_memory(memory_bytes, chain.contact_memory_at, chain.n_contacts)
        joints = read_joint_work(raw, chain.joint_work_at, chain.n_joints)
        rate = torque_rate(chain, contacts, haste(chain, table, joints))
        for j in range(chain.n_joints):
            if table[j].motor >= 0:
                step[table[j].motor] = rate * chain.period * table[j].tau_max
        slew(tau, last, step, chain.n_motors)
    for i in range(chain.n_motors):
        last[i] = tau[i]
    for a in range(work.rank):
        memory.force_sum[a] = work.force_next[a] - work.gain[a] * work.dt * lost_force[a]
    memory.force_rank = work.rank
    if work.n_internal > 0 and chain.n_arms == 2:
        work.internal[0] -= lost_squeeze[0]
