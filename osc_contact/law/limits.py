"""Torques within the motors' limits that disturb force and motion least: a quadratic program."""

from __future__ import annotations

from math import isinf, sqrt
from typing import Any

import numpy as np

from osc_contact.errors import SolverError
from osc_contact.law.algebra import (
    back_substitute,
    cholesky,
    cholesky_solve,
    lu_solve,
    one_sided_jacobi,
    qr_rows,
)
from osc_contact.law.jit import entry, inner, matrix
from osc_contact.law.nested import Bytes, Nested
from osc_contact.law.operational import factor_inertia
from osc_contact.law.phases import limit_changes
from osc_contact.law.records import row_of
from osc_contact.law.safety import count_computed
from osc_contact.law.vectors import ZERO, add, dot6, fill, reflect

_FLOAT = np.float64
#: The quadratic program: what it is given, what it answers, its scratch. Sizes: a motors,
#: k contacts that must not pull, s squeeze rows, p joint motions of redundant arms, v and w of the
#: program's root.
PROGRAM = Nested(
    np.dtype(
        [(name, np.int64) for name in ("d", "r", "k", "s", "short")]
        + [("mass", _FLOAT)]
        + [(name, _FLOAT, (6, 6)) for name in ("Lambda", "N", "pushed", "Phi_e", "K", "D", "P")]
        + [("X", _FLOAT, (6, 18))]
        + [(n, _FLOAT, (6,)) for n in ("alpha", "lost_force", "lost_motion", "extent", "psi")],
        align=True,
    ),
    desired=(_FLOAT, "a"),
    tau_max=(_FLOAT, "a"),
    G=(_FLOAT, "a", 6),
    share=(_FLOAT, "k", 6),
    floor=(_FLOAT, "k"),
    E=(_FLOAT, "s", "a"),
    carried=(_FLOAT, "s", 6),
    idle=(_FLOAT, "p", "a"),
    tau=(_FLOAT, "a"),
    at_limit=(np.int64, "a"),
    lost_squeeze=(_FLOAT, "s"),
    scale=(_FLOAT, "a"),  # of z; then motion, force and squeeze per unit of it
    motion=(_FLOAT, "a", 6),
    force=(_FLOAT, "a", 6),
    squeeze=(_FLOAT, "s", "a"),
    H=(_FLOAT, "vv"),  # (v, v), f (v,), A (k, v) and the bounds as the solver takes them
    f=(_FLOAT, "v"),
    A=(_FLOAT, "kv"),
    lower=(_FLOAT, "vk"),
    upper=(_FLOAT, "vk"),
    sense=(np.int32, "vk"),
    z=(_FLOAT, "v"),  # the solver's answer
    lam=(_FLOAT, "vk"),
    rows=(_FLOAT, "v", "w"),  # of a root of H
    point=(_FLOAT, "w"),
    y=(_FLOAT, "w"),
    diagonal=(_FLOAT, "w"),
    beta=(_FLOAT, "w"),
    bend=(_FLOAT, "w"),
    mix=(_FLOAT, "w"),
    t=(_FLOAT, "w"),
    normals=(_FLOAT, "k1", "v"),
    reduced=(_FLOAT, "v", "w"),
    free=(np.int64, "v"),
)
_program = PROGRAM.at


def new_program(n_a: int, k_max: int, s_max: int, p: int = 0) -> Bytes:
    """Bytes of PROGRAM.

    Args:
        n_a, k_max, s_max, p: how many motors, contacts that must not pull, squeeze rows and joint
            motions of redundant arms there are, at most.
    """
    v = n_a + k_max
    w = 12 + s_max + p + v + k_max
    counts = {"a": n_a, "k": k_max, "s": s_max, "p": p, "v": v, "w": w, "k1": k_max + 1}
    raw = PROGRAM.new({**counts, "vv": v * v, "kv": k_max * v, "vk": v + k_max})
    program = PROGRAM.view(raw)
    program.mass = 1.0
    program.tau_max[:] = np.inf
    return raw


# --- A point of the program, refined from its active limits ---------------------------------------

_DEPENDENT = 1e-9  # of a unit row, beside the rows before it
_ROOM = 1e-7  # around the bounds, for a point worked out from its active limits


@inner
def dot(a, b, n):
    """Σ aᵢbᵢ.

    Args:
        a, b: rows. n: how many elements of them count.
    """
    s = 0.0
    for i in range(n):
        s += a[i] * b[i]
    return s


@inner
def add_scaled(s, a, n, out):
    """out ← out + s a.

    Args:
        s: factor. a: row. n: how many elements of it count. out: row, overwritten.
    """
    for i in range(n):
        out[i] += s * a[i]


@inner
def _reflect(u, beta, n, x):
    add_scaled(-beta * dot(u, x, n), u, n, x)


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
    T = matrix(p.t, 0, len(p.t), 1)
    lam, lower, upper, rows = p.lam, p.lower, p.upper, p.rows
    point, y, diagonal, beta, bend, mix, t = p.point, p.y, p.diagonal, p.beta, p.bend, p.mix, p.t
    normals, reduced, free = p.normals, p.reduced, p.free
    f = 0
    kept = 0
    for i in range(w + k):
        t[i] = 0.0
    for j in range(v):
        for i in range(w + k):
            reduced[f, i] = rows[j, i] if i < w else A[i - w, j]
        if lam[j] == 0.0:
            point[j] = 0.0
            free[f] = j
            f += 1
        else:
            point[j] = upper[j] if lam[j] > 0.0 else lower[j]
            add_scaled(point[j], reduced[f], w + k, t)
    for c in range(k):
        u = normals[kept]
        rest = reduced[kept:]
        for j in range(f - kept):
            u[j] = rest[j, w + c]
        if lam[v + c] == 0.0 or kept == f:
            continue
        mirrored = qr_rows(normals[kept:], 1, f - kept, diagonal, bend[kept:])
        if not mirrored or abs(diagonal[0]) <= _DEPENDENT:
            continue
        for i in range(w + k):
            mix[i] = 0.0
        for j in range(f - kept):
            add_scaled(bend[kept] * u[j], rest[j], w + k, mix)
        for j in range(f - kept):
            add_scaled(-u[j], mix, w + k, rest[j])
        bound = upper[v + c] if lam[v + c] > 0.0 else lower[v + c]
        y[kept] = (bound - t[w + c]) / diagonal[0]
        add_scaled(y[kept], rest[0], w + k, t)
        kept += 1
    rest = reduced[kept:]
    if not qr_rows(rest, f - kept, w, diagonal, beta):
        return False
    for c in range(f - kept):
        _reflect(rest[c, c:], beta[c], w - c, t[c:])
    back_substitute(rest, f - kept, 1, diagonal, T)
    for c in range(f - kept):
        y[kept + c] = -t[c]
    for b in range(kept - 1, -1, -1):
        _reflect(normals[b], bend[b], f - b, y[b:])
    for j in range(f):
        point[free[j]] = y[j]
    for j in range(v + k):
        x = point[j] if j < v else dot(A[j - v], point, v)
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
def _mobility(p):
    """Rows of X: UNᵀ (6, free motions first), U(N_μ − N)ᵀ (d), U (r). P = UN_μᵀΛ⁻¹. D: UDUᵀ, each
    row divided by its `size`. K: Cholesky factor of Λ. Returns False where Λ is not positive.
    """
    d, r, Lambda, N, pushed, Phi_e = p.d, p.r, p.Lambda, p.N, p.pushed, p.Phi_e
    K, D, P, X, size = p.K, p.D, p.P, p.X, p.extent
    m = 6 - d
    u = 6 + d
    for a in range(r):
        for i in range(6):
            X[a, (i + d) % 6] = N[a, i]
        for i in range(d):
            X[a, 6 + i] = pushed[a, m + i] - N[a, m + i]
        for b in range(r):
            X[a, u + b] = 1.0 if a == b else 0.0
    one_sided_jacobi(X, r, d, 6 + r)
    if not cholesky(Lambda, m, d, K) > 0.0:
        return False
    for b in range(r):
        for i in range(d):
            P[b, i] = X[b, i] + X[b, 6 + i]
        cholesky_solve(K, d, P[b], 0)
    for a in range(r):
        size[a] = 0.0
        for b in range(r):
            D[a, b] = dot(X[a], P[b], d)
            for c in range(r):
                D[a, b] += X[a, u + c] * dot(Phi_e[c], X[b, u:], r)
            size[a] = max(size[a], abs(D[a, b]))
        for b in range(r):
            D[a, b] /= size[a]
    return True


@inner
def _respond(p):
    """What each motor does: `motion`, `force`, and their energies in its row of `rows`."""
    d, r, G, rows = p.d, p.r, p.G, p.rows
    scale, motion, force = p.scale, p.motion, p.force
    K, D, P, X, size, psi = p.K, p.D, p.P, p.X, p.extent, p.psi
    if not _mobility(p):
        return False
    for j in range(len(scale)):
        for i in range(d):
            motion[j, i] = G[j, 6 - d + i] * scale[j]
        cholesky_solve(K, d, motion[j], 0)
        for a in range(r):
            force[j, a] = dot(X[a], motion[j], d) / size[a]
    if not lu_solve(D, r, force, len(scale)):
        return False
    for j in range(len(scale)):
        for i in range(d + 6):
            rows[j, i] = 0.0
        for a in range(r):
            psi[a] = force[j, a]
            force[j, a] = 0.0
        for a in range(r):
            add_scaled(-psi[a], P[a], d, motion[j])
            add_scaled(psi[a], X[a, 6 + d :], r, force[j])
            add_scaled(sqrt(_FORCE) * psi[a], X[a], 6, rows[j, d:])
        add_scaled(1.0, motion[j], d, rows[j])
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
    desired, tau_max, alpha, share, floor = p.desired, p.tau_max, p.alpha, p.share, p.floor
    E, carried, idle, mass = p.E, p.carried, p.idle, p.mass
    scale, motion, force, squeeze = p.scale, p.motion, p.force, p.squeeze
    d, r, k, s = p.d, p.r, p.k, p.s
    lower, upper, rows = p.lower, p.upper, p.rows
    n = len(scale)
    v = n + slack
    H = matrix(p.H, 0, v, v)
    A = matrix(p.A, 0, k, v)
    largest = 0.0
    energy = 0.0
    w = 6 + d + s + len(idle)
    for j in range(n):
        if not isinf(tau_max[j]):
            largest = max(largest, tau_max[j])
    for j in range(n):
        scale[j] = tau_max[j] if not isinf(tau_max[j]) else largest if largest > 0.0 else 1.0
        lower[j] = max((-tau_max[j] - desired[j]) / scale[j], -_INFINITE)
        upper[j] = min((tau_max[j] - desired[j]) / scale[j], _INFINITE)
    if not _respond(p):
        return False
    for j in range(n):
        for c in range(s):
            squeeze[c, j] = E[c, j] * scale[j] - dot(carried[c, 6 - d :], motion[j], d)
            rows[j, 6 + d + c] = sqrt(_SQUEEZE / mass) * squeeze[c, j]
        for c in range(len(idle)):
            rows[j, 6 + d + s + c] = sqrt(_POSTURE) * idle[c, j] * scale[j]
        energy += dot(rows[j], rows[j], w)
    size = sqrt(energy / n) if energy > 0.0 else 1.0
    for j in range(v):
        weight = _TORQUE if j < n else _BEYOND
        for i in range(w):
            rows[j, i] = rows[j, i] / size if j < n else 0.0
        for i in range(v):
            rows[j, w + i] = sqrt(weight) if i == j else 0.0
        for i in range(j + 1):
            H[i, j] = H[j, i] = dot(rows[i], rows[j], w) + (weight if i == j else 0.0)
    for c in range(k):
        for j in range(v):
            A[c, j] = dot(share[c], force[j], r) if j < n else 0.0
        norm = sqrt(dot(A[c], A[c], n))
        norm = norm if norm > 0.0 else 1.0
        for j in range(n):
            A[c, j] /= norm
        if slack > 0:
            A[c, n + c] = 1.0
            lower[n + c] = -_INFINITE
            upper[n + c] = _INFINITE
        lower[v + c] = min((floor[c] - dot(share[c], alpha, r)) / norm, 0.0)
        upper[v + c] = 0.0  # nobody presses harder than commanded
    return True


@entry
def finish(raw, slack):
    """Torques from the solver's z (v,) and multipliers (v + k,); whether they are finite.

    Args:
        raw: bytes of PROGRAM. slack: of `prepare`.
    """
    p = _program(raw, 0)
    desired, tau_max, z = p.desired, p.tau_max, p.z
    scale, motion, force, squeeze = p.scale, p.motion, p.force, p.squeeze
    tau, at_limit, lost_squeeze = p.tau, p.at_limit, p.lost_squeeze
    lost_force, lost_motion = p.lost_force, p.lost_motion
    d, r, s = p.d, p.r, p.s
    p.short = 1 if slack > 0 else 0
    if refine(p, slack):
        for j in range(len(scale) + slack):
            z[j] = p.point[j]
    fill(lost_force, ZERO)
    fill(lost_motion, ZERO)
    for j in range(len(scale)):
        if not abs(z[j]) < _INFINITE:
            return False
        tau[j] = max(-tau_max[j], min(tau_max[j], desired[j] + scale[j] * z[j]))
        at_limit[j] = 1 if abs(tau[j]) >= tau_max[j] * (1.0 - _SLACK) else 0
        add_scaled(-z[j], force[j], r, lost_force)
        add_scaled(-z[j], motion[j], d, lost_motion[6 - d :])
    for c in range(s):
        lost_squeeze[c] = -dot(squeeze[c], z, len(scale))
    return True


class TorqueLimits:
    """Keeps torques within the motors' limits: fill the arrays of PROGRAM in place, then `solve`.

    All are in energy coordinates turned so that the last d axes are free; d, r, k, s say how much
    of them counts. Torques in N m (N), forces in N.

    Attributes:
        raw: bytes of PROGRAM, whose fields are attributes, too. counts: d, r, k, s in them.
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
        self._use(new_program(n_a, k_max, s_max, p))
        self.solve(0, 0, 0, 0)  # no tick has to wait until this is compiled

    def _use(self, raw: Bytes) -> None:
        self.raw = raw
        self.program = PROGRAM.view(raw)
        at = PROGRAM.dtype.fields["d"][1]
        self.counts = raw[at : at + 32].view(np.int64)

    def __getattr__(self, name: str) -> Any:
        if name in ("raw", "program", "counts"):  # not made yet
            raise AttributeError(name)
        return getattr(self.program, name)

    def solve(self, d: int, r: int, k: int, s: int) -> bool:
        """Find the torques within the limits that lose the least acceleration energy.

        Args:
            d: free motions. r: contact forces. k: those that must not pull. s: squeeze rows.

        Returns:
            Whether some force leaves its range: no torques within the limits keep it there.

        Raises:
            SolverError: the program was not solved.
        """
        import daqp

        p = self.program
        self.counts[:] = d, r, k, s
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
        self._use(raw.copy())


# --- A saturated tick's records as the program ----------------------------------------------------

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
    arms = model.arms
    joints = t.work.joints
    table = model.joints
    rows = t.work.extra
    n = model.n_joints
    m = work.locked
    r = work.rank
    desired, tau_max, G, Lambda, N, pushed = p.desired, p.tau_max, p.G, p.Lambda, p.N, p.pushed
    Phi_e, alpha, share, floor, E, carried = p.Phi_e, p.alpha, p.share, p.floor, p.E, p.carried
    idle = p.idle
    for j in range(n):
        motor = table[j].motor
        if motor < 0:
            continue
        desired[motor] = joints[j].tau
        tau_max[motor] = table[j].tau_max
        fill(G[motor], joints[j].J_bar)
        reflect(work.reflectors, work.beta, m, G[motor])
    held = 1.0 if model.held != 0 else 0.0
    for a in range(6):
        for b in range(6):
            Lambda[a, b] = work.Lambda[a, b] + (held if a == b else 0.0)
    for a in range(r):
        alpha[a] = work.alpha_u[a]
        for i in range(6):
            N[a, i] = work.N_t[a, i]
            pushed[a, i] = work.pushed_t[a, i]
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
    p.d = 6 - m
    p.r = r
    p.s = work.n_internal
    p.k = _shares(t, alpha, share, floor, len(floor))


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
    if memory.ticked > 1:
        limit_changes(t)
    for j in range(model.n_motors):
        memory.torques[j] = work.tau[j]
    for a in range(work.rank):
        memory.force_sum[a] = work.force_next[a] - work.gain[a] * work.dt * p.lost_force[a]
    memory.force_rank = work.rank
    if work.n_internal > 0 and model.n_arms == 2:
        work.internal[0] -= p.lost_squeeze[0]
    for bar in range(len(work.bars) if model.n_arms > 2 else 0):
        for c in range(p.s):
            work.bars[bar] -= work.basis[bar, c] * p.lost_squeeze[c]
