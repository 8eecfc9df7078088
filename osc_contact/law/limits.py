"""Torques within the motors' limits that disturb force and motion least: a quadratic program."""

from __future__ import annotations

from math import isinf, sqrt
from typing import Any

import numpy as np

from osc_contact.errors import SolverError
from osc_contact.law.active_set import keep_integrals
from osc_contact.law.algebra import (
    add_scaled,
    back_substitute,
    backward,
    cholesky,
    cholesky_solve,
    dot,
    lu_solve,
    one_sided_jacobi,
    qr_rows,
    reflect,
)
from osc_contact.law.columns import square_shares
from osc_contact.law.jit import entry, inner, local, matrix
from osc_contact.law.nested import Bytes, Nested
from osc_contact.law.operational import null_motions, weigh_joints
from osc_contact.law.phases import limit_changes
from osc_contact.law.records import MAX_JOINTS, body_of, row_of
from osc_contact.law.safety import count_computed
from osc_contact.law.vectors import ZERO, add, copy_rows, fill, six, turned

_FLOAT = np.float64
#: The quadratic program: its operands, its solution, and tables whose sizes are those of the
#: model. Sizes: a motors, k contacts that must not pull, s squeeze rows, p joint motions of
#: redundant arms, v variables and w rows of the program's root.
PROGRAM = Nested(
    np.dtype(
        [(name, np.int64) for name in ("d", "r", "k", "s", "short")]
        + [("mass", _FLOAT)]
        + [(name, _FLOAT, (6, 6)) for name in ("Lambda", "N", "pushed", "Phi_e")]
        + [(name, _FLOAT, (6,)) for name in ("alpha", "lost_force", "lost_motion")],
        align=True,
    ),
    desired="a",
    tau_max="a",
    G=("a", 6),
    share=("k", 6),
    floor="k",
    E=("s", "a"),
    carried=("s", 6),
    idle=("p", "a"),
    tau="a",
    at_limit=(np.int64, "a"),
    lost_squeeze="s",
    scale="a",  # of z; then motion, force and squeeze per unit of it
    motion=("a", 6),
    force=("a", 6),
    squeeze=("s", "a"),
    H="vv",  # (v, v), f (v,), A (k, v) and the bounds as the solver takes them
    f="v",
    A="kv",
    lower="vk",
    upper="vk",
    sense=(np.int32, "vk"),
    z="v",  # the solver's answer
    lam="vk",
    rows=("v", "w"),  # of a root of H
    point="w",
    y="w",
    diagonal="w",
    beta="w",
    bend="w",
    mix="w",
    t="w",
    normals=("k1", "v"),
    reduced=("v", "w"),
    free=(np.int64, "v"),
)
_program = PROGRAM.at


# --- A point of the program, refined from its active limits ---------------------------------------

_DEPENDENT = 1e-9  # of a unit row, beside the rows before it
_ROOM = 1e-7  # around the bounds, for a point worked out from its active limits


@inner
def refine(p, slack):
    """Work out z once more from `rows`, the limits that have multipliers as equations: `point`.

    That has the root of H's condition. Returns False where another limit is broken.

    Args:
        p: PROGRAM with the solver's multipliers. slack: of `prepare`.
    """
    k = p.k
    v = len(p.tau) + slack
    w = 6 + p.d + p.s + len(p.idle) + v
    A = matrix(p.A, 0, k, v)
    lam = p.lam
    lower = p.lower
    upper = p.upper
    y = p.y
    t = p.t
    f = 0
    kept = 0
    t[:] = 0.0
    for j in range(v):
        for i in range(w + k):
            p.reduced[f, i] = p.rows[j, i] if i < w else A[i - w, j]
        if lam[j] == 0.0:
            p.point[j] = 0.0
            p.free[f] = j
            f += 1
        else:
            p.point[j] = upper[j] if lam[j] > 0.0 else lower[j]
            add_scaled(p.point[j], p.reduced[f], w + k, t)
    for c in range(k):
        u = p.normals[kept]
        rest = p.reduced[kept:]
        for j in range(f - kept):
            u[j] = rest[j, w + c]
        if lam[v + c] == 0.0 or kept == f:
            continue
        mirrored = qr_rows(p.normals[kept:], 1, f - kept, p.diagonal, p.bend[kept:])
        if not mirrored or abs(p.diagonal[0]) <= _DEPENDENT:
            continue
        p.mix[:] = 0.0
        for j in range(f - kept):
            add_scaled(p.bend[kept] * u[j], rest[j], w + k, p.mix)
        for j in range(f - kept):
            add_scaled(-u[j], p.mix, w + k, rest[j])
        bound = upper[v + c] if lam[v + c] > 0.0 else lower[v + c]
        y[kept] = (bound - t[w + c]) / p.diagonal[0]
        add_scaled(y[kept], rest[0], w + k, t)
        kept += 1
    rest = p.reduced[kept:]
    if not qr_rows(rest, f - kept, w, p.diagonal, p.beta):
        return False
    for c in range(f - kept):
        reflect(rest[c, c:], p.beta[c], w - c, t[c:])
    back_substitute(rest, f - kept, 1, p.diagonal, matrix(t, 0, len(t), 1))
    for c in range(f - kept):
        y[kept + c] = -t[c]
    for b in range(kept - 1, -1, -1):
        reflect(p.normals[b], p.bend[b], f - b, y[b:])
    for j in range(f):
        p.point[p.free[j]] = y[j]
    for j in range(v + k):
        x = p.point[j] if j < v else dot(A[j - v], p.point, v)
        room = _ROOM * (1.0 + abs(x))
        if not lower[j] - room <= x <= upper[j] + room:
            return False
    return True


# --- The quadratic program ------------------------------------------------------------------------
#
# Torques τ + δτ instead of τ make the chain in contact answer with α + δα and η̇ + δη̇ (eqs. 17,
# 18):
#
#     δα = D⁻¹NᵀΛ⁻¹G δτ,   δη̇ = Λ⁻¹(G δτ − N_μ δα),   D = NᵀΛ⁻¹N_μ + Φ_e
#
# so every δτ keeps the contacts' constraints, and force and motion lost are known before they are.
# What is given up is measured as acceleration energy (Gauss), N²/kg: |δη̇|² of motion, |N δα|² of
# contact force (in energy coordinates the object's inertia is the identity), δs²/m_o of squeeze,
# (νᵀδτ)² of joint motions ν, νᵀMν = 1, that redundant arms make without the object.
# Metres and radians never meet, and an arm near a singular posture cannot make its lost motion
# dear.
#
# Columns of N may be nearly dependent. A rotation U makes the rows of UNᵀ orthogonal in the free
# motions, and ψ = Uδα obeys UDUᵀψ = UNᵀΛ⁻¹G δτ, whose rows differ in size instead of hardly at all.

#: Weights beside the 1 of motion: what has memory goes last. Torques that do nothing to the object
#: count relative to the mean energy of the others.
_FORCE = 1e-3
_SQUEEZE = 1e-5
_TORQUE = 1e-7
_POSTURE = 0.1  # joint motions that leave the object alone: they cost too, or a joint whirls
_BEYOND = 1e2  # of a force outside its range, where no torques within the limits keep it
_INFINITE = 1e30  # the solver's
_SLACK = 1e-9  # of the limits, for rounding errors


@inner
def _mobility(p, X, P, D, extent, K):
    """Mobility of the contacts in directions in which its rows are orthogonal.

    Args:
        p: PROGRAM, of which `Lambda`, `N`, `pushed`, `Phi_e` are read.
        X: (r, 18), filled: rows UNᵀ (6, free motions first), U(N_μ − N)ᵀ (d), U (r).
        P: (r, d), filled: UN_μᵀΛ⁻¹. D: (r, r), filled: UDUᵀ, each row divided by its `extent`.
        extent: (r,), filled: the largest element of each row. K: (d, d), filled: factor of Λ.

    Returns:
        False where Λ is not positive definite.
    """
    d = p.d
    r = p.r
    u = 6 + d
    for a in range(r):
        for i in range(6):
            X[a, (i + d) % 6] = p.N[a, i]
        for i in range(d):
            X[a, 6 + i] = p.pushed[a, 6 - d + i] - p.N[a, 6 - d + i]
        for b in range(r):
            X[a, u + b] = 1.0 if a == b else 0.0
    one_sided_jacobi(X, r, d, 6 + r)
    if not cholesky(p.Lambda, 6 - d, d, K) > 0.0:
        return False
    for b in range(r):
        for i in range(d):
            P[b, i] = X[b, i] + X[b, 6 + i]
        cholesky_solve(K, d, P[b])
    for a in range(r):
        extent[a] = 0.0
        for b in range(r):
            D[a, b] = dot(X[a], P[b], d)
            for c in range(r):
                D[a, b] += X[a, u + c] * dot(p.Phi_e[c], X[b, u:], r)
            extent[a] = max(extent[a], abs(D[a, b]))
        for b in range(r):
            D[a, b] /= extent[a]
    return True


@inner
def _respond(p):
    """Motion and force that each motor causes, per unit of its `scale`.

    Fills `motion`, `force`, and the energies of both in the motor's row of `rows`. Returns False
    where the response cannot be determined.
    """
    d = p.d
    r = p.r
    n = len(p.scale)
    X = local(6, 18)
    P = local(6, 6)
    D = local(6, 6)
    extent = local(6)
    K = local(6, 6)
    if not _mobility(p, X, P, D, extent, K):
        return False
    for j in range(n):
        for i in range(d):
            p.motion[j, i] = p.G[j, 6 - d + i] * p.scale[j]
        cholesky_solve(K, d, p.motion[j])
        for a in range(r):
            p.force[j, a] = dot(X[a], p.motion[j], d) / extent[a]
    if not lu_solve(D, r, p.force, n):
        return False
    for j in range(n):
        motion = p.motion[j]
        force = p.force[j]
        row = p.rows[j]
        row[:] = 0.0
        psi = six(force)
        fill(force, ZERO)
        for a in range(r):
            add_scaled(-psi[a], P[a], d, motion)
            add_scaled(psi[a], X[a, 6 + d :], r, force)
            add_scaled(sqrt(_FORCE) * psi[a], X[a], 6, row[d:])
        add_scaled(1.0, motion, d, row)
    return True


@entry
def prepare(raw, slack):
    """Fill the program min |rowsᵀz|² with lower ≤ (z, Az) ≤ upper, z = (δτ/scale, slack).

    H (v, v), A (k, v), v = n_a + slack; a motor's energies in each of `rows`.

    Args:
        raw: bytes of PROGRAM. slack: 0, or k: forces may leave their ranges at a price.

    Returns:
        Whether the response of the chain could be worked out.
    """
    p = _program(raw, 0)
    tau_max = p.tau_max
    scale = p.scale
    lower = p.lower
    upper = p.upper
    rows = p.rows
    n = len(scale)
    v = n + slack
    H = matrix(p.H, 0, v, v)
    A = matrix(p.A, 0, p.k, v)
    largest = 0.0
    energy = 0.0
    e = 6 + p.d
    w = e + p.s + len(p.idle)
    for j in range(n):
        if not isinf(tau_max[j]):
            largest = max(largest, tau_max[j])
    largest = largest if largest > 0.0 else 1.0
    for j in range(n):
        scale[j] = min(tau_max[j], largest)
        lower[j] = max((-tau_max[j] - p.desired[j]) / scale[j], -_INFINITE)
        upper[j] = min((tau_max[j] - p.desired[j]) / scale[j], _INFINITE)
    if not _respond(p):
        return False
    for j in range(n):
        for c in range(p.s):
            carried = dot(p.carried[c, 6 - p.d :], p.motion[j], p.d)
            p.squeeze[c, j] = p.E[c, j] * scale[j] - carried
            rows[j, e + c] = sqrt(_SQUEEZE / p.mass) * p.squeeze[c, j]
        for c in range(len(p.idle)):
            rows[j, e + p.s + c] = sqrt(_POSTURE) * p.idle[c, j] * scale[j]
        energy += dot(rows[j], rows[j], w)
    size = sqrt(energy / n) if energy > 0.0 else 1.0
    for j in range(v):
        weight = _TORQUE if j < n else _BEYOND
        for i in range(w):
            rows[j, i] = rows[j, i] / size if j < n else 0.0
        for i in range(v):
            rows[j, w + i] = sqrt(weight) if i == j else 0.0
        for i in range(j + 1):
            H[i, j] = H[j, i] = dot(rows[i], rows[j], w + v)
    for c in range(p.k):
        for j in range(v):
            A[c, j] = dot(p.share[c], p.force[j], p.r) if j < n else 0.0
        norm = sqrt(dot(A[c], A[c], n))
        norm = norm if norm > 0.0 else 1.0
        for j in range(n):
            A[c, j] /= norm
        if slack > 0:
            A[c, n + c] = 1.0
            lower[n + c] = -_INFINITE
            upper[n + c] = _INFINITE
        lower[v + c] = min((p.floor[c] - dot(p.share[c], p.alpha, p.r)) / norm, 0.0)
        upper[v + c] = 0.0  # nobody presses harder than commanded
    return True


@entry
def finish(raw, slack):
    """Torques from the solver's z (v,) and multipliers (v + k,); whether they are finite.

    Args:
        raw: bytes of PROGRAM. slack: of `prepare`.
    """
    p = _program(raw, 0)
    z = p.z
    n = len(p.scale)
    p.short = slack > 0
    if refine(p, slack):
        for j in range(n + slack):
            z[j] = p.point[j]
    fill(p.lost_force, ZERO)
    fill(p.lost_motion, ZERO)
    for j in range(n):
        if not abs(z[j]) < _INFINITE:
            return False
        most = p.tau_max[j]
        p.tau[j] = max(-most, min(most, p.desired[j] + p.scale[j] * z[j]))
        p.at_limit[j] = abs(p.tau[j]) >= most * (1.0 - _SLACK)
        add_scaled(-z[j], p.force[j], p.r, p.lost_force)
        add_scaled(-z[j], p.motion[j], p.d, p.lost_motion[6 - p.d :])
    for c in range(p.s):
        p.lost_squeeze[c] = -dot(p.squeeze[c], z, n)
    return True


class TorqueLimits:
    """Keeps torques within the motors' limits: fill the arrays of PROGRAM in place, then `solve`.

    All are in energy coordinates turned so that the last d axes are free. d free motions, r contact
    forces, k of them that must not pull and s squeeze rows count. Torques in N m (N), forces in N.

    Attributes:
        raw: bytes of PROGRAM, whose fields are attributes, too.
        desired, tau_max: (n_a,) torques; limits (inf: none).
        G: (n_a, 6) what each motor exerts, Lambda: (6, 6) of the chain. mass: of the object (kg).
        N, pushed: (6, 6) columns of N and, with friction, N_μ as rows. Phi_e: (6, 6) NᵀΦ_eN_μ.
        alpha: (6,) force command. share: (k_max, 6) forces that must not pull, out of α.
        floor: (k_max,) their least values, at most what is commanded.
        E: (s_max, n_a) rows of the squeeze. carried: (s_max, 6) what of it motions use up.
        idle: (p, n_a) joint motions ν of redundant arms, 1 kg m² or 1 kg in M, of their motors.
        tau: (n_a,) found. at_limit: (n_a,) which motors stand at their limit.
        lost_force: (6,), lost_motion: (6,), lost_squeeze: (s_max,) desired less what will come;
            zero beyond r, and in locked axes.
    """

    def __init__(self, n_a: int, k_max: int, s_max: int, p: int = 0) -> None:
        """Make room.

        Args:
            n_a, k_max, s_max, p: how many motors, contacts that must not pull, squeeze rows and
                joint motions of redundant arms there are, at most.
        """
        v = n_a + k_max
        w = 12 + s_max + p + v + k_max
        counts = {"a": n_a, "k": k_max, "s": s_max, "p": p, "v": v, "w": w, "k1": k_max + 1}
        self.__setstate__(PROGRAM.new({**counts, "vv": v * v, "kv": k_max * v, "vk": v + k_max}))
        self.program.mass = 1.0
        self.program.tau_max[:] = np.inf
        self.solve()  # no tick has to wait until this is compiled

    def __getattr__(self, name: str) -> Any:
        if name in ("raw", "program"):  # not made yet
            raise AttributeError(name)
        return getattr(self.program, name)

    def solve(self) -> bool:
        """Find the torques within the limits that lose the least acceleration energy.

        Returns:
            Whether some force leaves its range: no torques within the limits keep it there.

        Raises:
            SolverError: the program was not solved.
        """
        import daqp

        p = self.program
        k = int(p.k)
        for slack in (0, k):
            v = len(p.tau) + slack
            end = v + k
            if not prepare(self.raw, slack):
                break
            z, _, verdict, info = daqp.solve(
                p.H[: v * v].reshape(v, v),
                p.f[:v],
                p.A[: k * v].reshape(k, v),
                p.upper[:end],
                p.lower[:end],
                p.sense[:end],
                primal_tol=1e-10,
            )
            if verdict <= 0:
                continue
            p.z[:v] = z
            p.lam[:end] = info["lam"]
            if finish(self.raw, slack):
                return slack > 0
        raise SolverError(
            f"no torques within the motor limits were found for {np.round(self.desired, 3)} desired"
        )

    def __getstate__(self) -> Bytes:
        return self.raw

    def __setstate__(self, raw: Bytes) -> None:
        self.raw = raw.copy()
        self.program = PROGRAM.view(self.raw)


# --- A saturated tick's records as the program ----------------------------------------------------

_FLOOR = 1.0  #: N, least force of contacts that cannot pull; a command below it is its own floor


@inner
def _shares(t, alpha, share, floor):
    """Forces that must not pull, as combinations of α by least squares; returns their number.

    Args:
        alpha: (r,) magnitudes of the kept columns (N). share: (k, 6), filled: combinations.
        floor: (k,), filled: least values (N).
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
def _idle_motions(t, arm, own, idle, count):
    """Joint motions ν of a redundant arm, N J ν = 0 and νᵀMν = 1: ν = K⁻ᵀv.

    Args:
        arm: ARM row. own: its ARM_WORK. idle: (p, a), rows from `count` on are filled.
        count: number of rows before; returned with those that were added.
    """
    work = t.work
    lo = arm.first
    n = arm.end - lo
    K = local(MAX_JOINTS, MAX_JOINTS)
    weighed = local(MAX_JOINTS, 6)
    motions = local(MAX_JOINTS, MAX_JOINTS)
    if n <= arm.m or not weigh_joints(work.joints, lo, n, K, weighed):
        return count
    null_motions(own, weighed, n, motions)
    for c in range(own.n_kept, min(n, own.n_kept + len(idle) - count)):
        backward(K, n, motions[c])
        for i in range(n):
            motor = t.model.joints[lo + i].motor
            if motor >= 0:
                idle[count, motor] = motions[c, i]
        count += 1
    return count


@entry
def fill_program(raw, at, i, program):
    """Fill what `limits.TorqueLimits` is given.

    Args:
        raw, at: as of `tick.rows`. i: a row whose tick has ended SATURATED just now.
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
    for e in range(work.n_internal):
        carried = ZERO
        for k in range(model.n_arms):
            lo = model.arms[k].first
            hi = model.arms[k].end
            for j in range(lo, hi):
                s = dot(rows[e, lo:], joints[j].M, hi - lo)
                carried = add(carried, s, joints[j].J_bar)
        fill(p.carried[e], turned(work, carried))
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
    """Torques found, no faster than motors may change; the next tick starts from them.

    Force that is lost is not integrated by the force law.

    Args:
        raw, at, i, program: as of `fill_program`, solved.
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
