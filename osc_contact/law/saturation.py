"""Exchange between the records of a saturated tick and the program of the motor limits."""

from __future__ import annotations

from osc_contact.law.active_set import keep_integrals
from osc_contact.law.algebra import backward, cholesky, cholesky_solve, dot
from osc_contact.law.columns import square_shares
from osc_contact.law.jit import entry, inner, local
from osc_contact.law.limits import PROGRAM
from osc_contact.law.operational import null_motions, weigh_joints
from osc_contact.law.phases import limit_changes
from osc_contact.law.records import MAX_JOINTS, body_of, row_of
from osc_contact.law.safety import count_computed
from osc_contact.law.vectors import ZERO, add, copy_rows, fill, turned

_program = PROGRAM.at
_FLOOR = 1.0  #: N, least force of contacts that must not pull, unless less is commanded


@inner
def _shares(t, alpha, share, floor):
    """Express the forces that must not pull as combinations of the kept columns' forces.

    These are the forces of the active columns of pairs that can only push (`pushes` of the body).
    With R (r, count) the shares of the active columns, each a combination of the r kept columns,
    the force of a column with the share x (r,) is xᵀ(RRᵀ)⁻¹α, the least forces that together give
    the forces α (r,; N) of the kept columns. Reads `share` of the columns.

    Args:
        t: Tick.
        alpha: (r,) force commands of the kept columns (N).
        share: (k, 6), filled with the coefficients (RRᵀ)⁻¹x in each row.
        floor: (k,), filled with least values (N): `_FLOOR`, or the commanded force if that is less.

    Returns:
        Number of these forces.
    """
    work = t.work
    r = work.rank
    k = 0
    RR = local(6, 6)
    factor = local(6, 6)
    square_shares(work, RR)
    cholesky(RR, 0, r, factor)
    for j in range(work.count):
        if body_of(t, work.chosen[j]).pushes == 0 or k == len(floor):
            continue
        x = share[k]
        fill(x, work.columns[work.chosen[j]].share)
        cholesky_solve(factor, r, x)
        floor[k] = min(_FLOOR, dot(x, alpha, r))
        k += 1
    return k


@inner
def _idle_motions(t, arm, arm_work, idle, count):
    """Append the joint motions ν of a redundant arm that do not move the object.

    ν (n,) = K⁻ᵀv satisfies N J ν = 0 and νᵀMν = 1, with the wrenches N (m, 6) that the grasp
    transmits, the Jacobian J (6, n), the joint-space inertia M = KKᵀ and orthonormal v (n,).

    Args:
        t: Tick.
        arm: ARM row.
        arm_work: its ARM_WORK.
        idle: (p, a) motions of the motors, of which rows from `count` on are filled.
        count: number of rows that are filled already.

    Returns:
        Number of filled rows.
    """
    work = t.work
    lo = arm.first
    n = arm.end - lo
    K = local(MAX_JOINTS, MAX_JOINTS)
    weighed = local(MAX_JOINTS, 6)
    motions = local(MAX_JOINTS, MAX_JOINTS)
    if n <= arm.m or not weigh_joints(work.joints, lo, n, K, weighed):
        return count
    null_motions(arm_work, weighed, n, motions)
    for c in range(arm_work.n_kept, min(n, arm_work.n_kept + len(idle) - count)):
        backward(K, n, motions[c])
        for i in range(n):  # joints are numbered along the arm, elements of `idle` by motors
            motor = t.model.joints[lo + i].motor
            if motor >= 0:
                idle[count, motor] = motions[c, i]
        count += 1
    return count


@entry
def fill_program(raw, at, i, program):
    """Fill the operands of the torque program from the records of a saturated tick.

    Copies torques and limits of the motors, J̄ (as G, the wrench on the object per torque), and in
    turned energy coordinates the inertia Λ of the chain, the columns N, those with friction N_μ,
    the mobility Φ_μ of the touched bodies, and the commanded forces α_u. Adds the rows E of the
    squeeze, with the squeeze E M J̄ᵀ that inertial forces of a motion cause, the joint motions of
    redundant arms, and the forces that must not pull.

    Fills of PROGRAM `desired`, `tau_max` (a; N m, N), `G` (a, 6), `E` (s, a), `idle` (joint motions
    (p, a)), `Lambda`, `alpha` (α_u, N), `N`, `pushed` (N_μ), `Phi_e` (Φ_μ), `carried` (E M J̄ᵀ
    (s, 6)), and the numbers `d` of free axes, `r` of columns, `s` of squeeze rows, `k` of forces
    that must not pull.

    Args:
        raw: bytes of `records.Rows`.
        at: offset of the JOB.
        i: row whose tick has just ended SATURATED.
        program: bytes of PROGRAM.
    """
    t = row_of(raw, at, i)
    p = _program(program, 0)
    model = t.model
    work = t.work
    joints = work.joints
    rows = work.extra
    for j in range(model.n_joints):
        motor = model.joints[j].motor
        if motor < 0:
            continue
        p.desired[motor] = joints[j].tau
        p.tau_max[motor] = model.joints[j].tau_max
        fill(p.G[motor], turned(work, joints[j].J_bar))
        for e in range(work.n_internal):
            p.E[e, motor] = rows[e, j]
        for c in range(len(p.idle)):
            p.idle[c, motor] = 0.0
    copy_rows(work.Lambda, p.Lambda)
    for a in range(work.rank):
        p.alpha[a] = work.alpha_u[a]
        fill(p.N[a], work.N_t[a])
        fill(p.pushed[a], work.pushed_t[a])
        fill(p.Phi_e[a], work.Phi_mu[a])
    # squeeze E M J̄ᵀ by inertial forces, for each row e of E
    for e in range(work.n_internal):
        inertial_squeeze = ZERO
        for k in range(model.n_arms):
            first = model.arms[k].first
            end = model.arms[k].end
            for j in range(first, end):
                inertia = dot(rows[e, first:], joints[j].M, end - first)
                inertial_squeeze = add(inertial_squeeze, inertia, joints[j].J_bar)
        fill(p.carried[e], turned(work, inertial_squeeze))
    count = 0
    if len(p.idle) > 0:
        for k in range(model.n_arms):
            count = _idle_motions(t, model.arms[k], work.arms[k], p.idle, count)
    p.d = 6 - work.locked
    p.r = work.rank
    p.s = work.n_internal
    p.k = _shares(t, p.alpha, p.share, p.floor)


@entry
def settle(raw, at, i, program):
    """Apply the solution of the program to the records: torques, force integrals, internal forces.

    The program finds the torques within the motors' limits that lose least force and motion. They
    are limited in their rate; the lost force is excluded from the integral of the force law. Reads
    `tau` (n_a; N m, N), `lost_force` (r; N) and `lost_squeeze` (s; N) of PROGRAM, the gains `gain`
    (1/s), the integrals `force_next` (N) and `basis` (columns: settable combinations of bar
    forces). Changes `tau` and `bars` (internal forces, N) of WORK, `step` of the motors, and in
    MEMORY `torques`, `force_sum` and the fields of `count_computed` and `keep_integrals`.

    Args:
        raw: bytes of `records.Rows`.
        at: offset of the JOB.
        i: row of the saturated tick.
        program: bytes of the solved PROGRAM.
    """
    t = row_of(raw, at, i)
    p = _program(program, 0)
    model = t.model
    memory = t.memory
    work = t.work
    count_computed(t)
    for j in range(model.n_motors):
        work.tau[j] = p.tau[j]
    limit_changes(t, memory.ticked > 1)
    for a in range(work.rank):
        memory.force_sum[a] = work.force_next[a] - work.gain[a] * work.dt * p.lost_force[a]
    keep_integrals(t)
    for bar in range(model.n_bars):
        work.bars[bar] -= dot(work.basis[bar], p.lost_squeeze, work.n_internal)
