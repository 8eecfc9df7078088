"""Torques within the motors' limits that disturb force and motion least: a quadratic program.

Torques τ + δτ instead of τ make the chain in contact answer with α + δα and η̇ + δη̇ (eqs. 17, 18):

    δα = D⁻¹NᵀΛ⁻¹G δτ,   δη̇ = Λ⁻¹(G δτ − N_μ δα),   D = NᵀΛ⁻¹N_μ + Φ_e

so every δτ keeps the contacts' constraints, and force and motion lost are known before they are.
What is given up is measured as acceleration energy (Gauss), N²/kg: |δη̇|² of motion, |N δα|² of
contact force (in energy coordinates the object's inertia is the identity), δs²/m_o of squeeze,
(νᵀδτ)² of joint motions ν, νᵀMν = 1, that redundant arms make without the object.
Metres and radians never meet, and an arm near a singular posture cannot make its lost motion dear.

Columns of N may be nearly dependent. A rotation U makes the rows of UNᵀ orthogonal in the free
motions, and ψ = Uδα obeys UDUᵀψ = UNᵀΛ⁻¹G δτ, whose rows differ in size instead of hardly at all.
"""

from __future__ import annotations

from math import isinf, sqrt
from typing import Any

import numpy as np

from osc_contact.errors import SolverError
from osc_contact.law.algebra import (
    cholesky,
    cholesky_solve,
    lu_solve,
    one_sided_jacobi,
)
from osc_contact.law.jit import direct, entry, inner
from osc_contact.law.refinement import add, dot, refine
from osc_contact.law.six import ZERO, fill

#: Weights beside the 1 of motion: what has memory goes last. Torques that do nothing to the object
#: count relative to the mean energy of the others.
_FORCE, _SQUEEZE, _TORQUE = 1e-3, 1e-5, 1e-7
_POSTURE = 0.1  # joint motions that leave the object alone: they cost too, or a joint whirls
_BEYOND = 1e2  # of a force outside its range, where no torques within the limits keep it
_INFINITE = 1e30  # the solver's
_SLACK = 1e-9  # of the limits, for rounding errors


@inner
def _mobility(d, r, Lambda, N, pushed, Phi_e, work):
    """Rows of X: UNᵀ (6, free motions first), U(N_μ − N)ᵀ (d), U (r). P = UN_μᵀΛ⁻¹. D: UDUᵀ, each
    row divided by its `size`. K: Cholesky factor of Λ. Returns False where Λ is not positive.
    """
    K, D, P, X, size, _ = work
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
def _respond(d, r, given, maps, work, rows):
    """What each motor does: `motion`, `force`, and their energies in its row of `rows`."""
    _, _, G, Lambda, N, pushed, Phi_e, _, _, _, _, _, _ = given
    scale, motion, force, _ = maps
    K, D, P, X, size, psi = work
    if not _mobility(d, r, Lambda, N, pushed, Phi_e, work):
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
            add(-psi[a], P[a], d, motion[j])
            add(psi[a], X[a, 6 + d :], r, force[j])
            add(sqrt(_FORCE) * psi[a], X[a], 6, rows[j, d:])
        add(1.0, motion[j], d, rows[j])
    return True


@entry
def prepare(sizes, slack, mass, given, maps, work, program):
    """Fill the program min |rowsᵀz|² with lower ≤ (z, Az) ≤ upper, z = (δτ/scale, slack).

    Args:
        sizes: d, r, k, s. slack: 0, or k: forces may leave their ranges at a price.
        mass, given: as in `TorqueLimits`, in its order.
        maps: (n_a,) scale; (n_a, 6) motion, force, (s, n_a) squeeze per unit of z.
        work: scratch.
        program: H (v, v), A (k, v), v = n_a + slack, bounds (2, ≥ v + k), and a motor's energies in
            each of rows (≥ v, ≥ 6 + d + s + v).

    Returns:
        Whether the response of the chain could be worked out.
    """
    wanted, tau_max, _, _, _, _, _, alpha, share, floor, E, carried, idle = given
    scale, motion, force, squeeze = maps
    d, r, k, s = sizes
    H, A, bounds, rows = program
    n = len(scale)
    v = len(H)
    p = len(idle)
    largest = 0.0
    energy = 0.0
    w = 6 + d + s + p
    for j in range(n):
        if not isinf(tau_max[j]):
            largest = max(largest, tau_max[j])
    for j in range(n):
        scale[j] = tau_max[j] if not isinf(tau_max[j]) else largest if largest > 0.0 else 1.0
        bounds[0, j] = max((-tau_max[j] - wanted[j]) / scale[j], -_INFINITE)
        bounds[1, j] = min((tau_max[j] - wanted[j]) / scale[j], _INFINITE)
    if not _respond(d, r, given, maps, work, rows):
        return False
    for j in range(n):
        for c in range(s):
            squeeze[c, j] = E[c, j] * scale[j] - dot(carried[c, 6 - d :], motion[j], d)
            rows[j, 6 + d + c] = sqrt(_SQUEEZE / mass) * squeeze[c, j]
        for c in range(p):
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
            bounds[0, n + c] = -_INFINITE
            bounds[1, n + c] = _INFINITE
        bounds[0, v + c] = min((floor[c] - dot(share[c], alpha, r)) / norm, 0.0)
        bounds[1, v + c] = 0.0  # nobody presses harder than commanded
    return True


@entry
def finish(solution, sizes, given, maps, program, scratch, answer):
    """Torques from the solver's z (v,) and multipliers (v + k,); whether they are finite.

    Args:
        solution: z, lam of the solver. sizes, given, maps, program: of `prepare`.
        scratch: see `refine`.
        answer: tau, at_limit and what is lost, filled, see `TorqueLimits`.
    """
    wanted, tau_max, _, _, _, _, _, _, _, _, _, _, idle = given
    scale, motion, force, squeeze = maps
    tau, at_limit, lost_force, lost_motion, lost_squeeze = answer
    z, lam = solution
    d, r, _, s = sizes
    _, A, bounds, rows = program
    if refine(lam, 6 + d + s + len(idle) + len(z), A, bounds, rows, scratch):
        for j in range(len(z)):
            z[j] = scratch[0][j]
    fill(lost_force, ZERO)
    fill(lost_motion, ZERO)
    for j in range(len(scale)):
        if not abs(z[j]) < _INFINITE:
            return False
        tau[j] = max(-tau_max[j], min(tau_max[j], wanted[j] + scale[j] * z[j]))
        at_limit[j] = abs(tau[j]) >= tau_max[j] * (1.0 - _SLACK)
        add(-z[j], force[j], r, lost_force)
        add(-z[j], motion[j], d, lost_motion[6 - d :])
    for c in range(s):
        lost_squeeze[c] = -dot(squeeze[c], z, len(scale))
    return True


class TorqueLimits:
    """Keeps torques within the motors' limits: fill the arrays below in place, then `solve`.

    All are in energy coordinates turned so that the last d axes are free; d, r, k, s say how much
    of them counts. Torques in N m (N), forces in N.

    Attributes:
        wanted, tau_max: (n_a,) torques; limits (inf: none).
        G: (n_a, 6) what each motor exerts, Lambda: (6, 6) of the chain.
        N, pushed: (6, 6) columns of N and, with friction, N_μ as rows. Phi_e: (6, 6) NᵀΦ_eN_μ.
        alpha: (6,) force command. share: (k_max, 6) forces that must not pull, out of α.
        floor: (k_max,) their least values, at most what is commanded.
        E: (s_max, n_a) rows of the squeeze. carried: (s_max, 6) what of it motions use up.
        idle: (p, n_a) joint motions ν of redundant arms, 1 kg m² or 1 kg in M, of their motors.
        mass: of the held object (kg).
        tau: (n_a,) found. at_limit: (n_a,) which motors stand at their limit.
        lost_force: (6,), lost_motion: (6,), lost_squeeze: (s_max,) wanted less what will come; zero
            beyond r, and in locked axes.
    """

    def __init__(self, n_a: int, k_max: int, s_max: int, p: int = 0) -> None:
        zeros = np.zeros
        v = n_a + k_max
        w = 12 + s_max + p + v + k_max
        self._sizes = (n_a, k_max, s_max, p)
        self.mass = 1.0
        self._given: tuple[Any, ...] = (
            zeros(n_a),
            np.full(n_a, np.inf),
            zeros((n_a, 6)),
            *zeros((4, 6, 6)),
            zeros(6),
            zeros((k_max, 6)),
            zeros(k_max),
            zeros((s_max, n_a)),
            zeros((s_max, 6)),
            zeros((p, n_a)),
        )
        self.wanted, self.tau_max, self.G, self.Lambda, self.N = self._given[:5]
        self.pushed, self.Phi_e, self.alpha, self.share, self.floor = self._given[5:10]
        self.E, self.carried, self.idle = self._given[10:]
        self._answer = zeros(n_a), zeros(n_a, dtype=bool), zeros(6), zeros(6), zeros(s_max)
        self.tau, self.at_limit, self.lost_force, self.lost_motion, self.lost_squeeze = self._answer
        self._maps = zeros(n_a), zeros((n_a, 6)), zeros((n_a, 6)), zeros((s_max, n_a))
        self._work = (*zeros((3, 6, 6)), zeros((6, 18)), zeros(6), zeros(6))
        self._H = zeros(v * v)
        self._A = zeros(k_max * v)
        self._f = zeros(v)
        self._bounds = zeros((2, v + k_max))
        self._rows = zeros((v, w))
        self._sense = zeros(v + k_max, np.int32)
        free = zeros(v, np.int64)
        T = zeros((w, 1))
        normals = zeros((k_max + 1, v))
        reduced = zeros((v, w))
        self._scratch = (*zeros((6, w)), T[:, 0].reshape(w), T, normals, reduced, free)
        self._solution = zeros(v), zeros(v + k_max)
        self._prepare = prepare
        self._finish = finish
        self.solve(0, 0, 0, 0)  # no tick has to wait until this is compiled
        self._prepare, self._finish = direct(prepare), direct(finish)

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

        given = self._given
        maps = self._maps
        bounds = self._bounds
        rows = self._rows
        for slack in (0, k):
            v = len(self.tau) + slack
            H, A, end = self._H[: v * v].reshape(v, v), self._A[: k * v].reshape(k, v), v + k
            mass = float(self.mass)
            work = self._work
            sizes, program = (d, r, k, s), (H, A, bounds, rows)
            if not self._prepare(sizes, slack, mass, given, maps, work, program):
                break
            z, _, verdict, info = daqp.solve(
                H,
                self._f[:v],
                A,
                bounds[1, :end],
                bounds[0, :end],
                self._sense[:end],
                primal_tol=1e-10,
            )
            if verdict <= 0:
                continue
            own_z = self._solution[0][:v]
            own_lam = self._solution[1][:end]
            own_z[:], own_lam[:] = z, info["lam"]
            if self._finish(
                (own_z, own_lam), sizes, given, maps, program, self._scratch, self._answer
            ):
                return slack > 0
        raise SolverError(
            f"no torques within the motor limits were found for {np.round(self.wanted, 3)} wanted"
        )

    def __getstate__(self) -> Any:
        return self._sizes, self.mass, (*self._given, *self._answer)

    def __setstate__(self, state: Any) -> None:
        self.__init__(*state[0])  # type: ignore[misc]
        self.mass = state[1]
        for own, other in zip((*self._given, *self._answer), state[2], strict=True):
            own[...] = other
