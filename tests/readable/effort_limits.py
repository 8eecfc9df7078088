"""Torques within the motors' limits that disturb force and motion least: a quadratic program.

Torques τ + δτ instead of τ make the chain in contact answer with α + δα and η̇ + δη̇ (eqs. 17, 18):

    δα = D⁻¹N_SᵀΛ_S⁻¹G δτ,   δη̇ = Λ_S⁻¹(G δτ − N_S δα),   D = N_SᵀΛ_S⁻¹N_S + NᵀΦ_eN

(with friction the second N of each product is N_μ), so every δτ keeps the contacts' constraints,
and force and motion lost are known before they are.
What is given up is measured as acceleration energy (Gauss), N²/kg, in the object's inertia Λ_o:
δη̇ᵀSᵀΛ_oS δη̇ of motion, δαᵀNᵀΛ_o⁻¹N δα of contact force, δs²/m_o of squeeze, |νᵀδτ|² of joint
motions ν of redundant arms that leave the object alone, νᵀMν = 1. Metres and radians never meet,
and an arm near a singular posture cannot make its lost motion dear.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from osc_contact.contacts.pairs.pair import ContactPair, pushes_only
from osc_contact.control.reports import LimitLoss
from osc_contact.dynamics.closed_chain import ChainState, ClosedChain
from osc_contact.dynamics.motors import effort_scale
from osc_contact.errors import InvalidInputError, SolverError
from osc_contact.spatial import Array
from readable.allocation import squeeze_response
from readable.signals import Signals

__all__ = ["EffortLimits", "Relief", "Response", "idle_motions", "relieve"]

#: Weights beside the 1 of motion: what has memory goes last. Torques that do nothing to the object
#: count relative to the mean energy of the others.
_FORCE, _SQUEEZE, _TORQUE, _POSTURE = 1e-3, 1e-5, 1e-7, 0.1
_BEYOND = 1e2  # of a force outside its range, where no torques within the limits keep it
_INFINITE = 1e30  # the solver's
_SLACK = 1e-9  # of the limits, for rounding errors


@dataclass(frozen=True)
class Response:
    """Computed torques, and what the chain makes of others; in any basis of its d motions.

    Attributes:
        tau, tau_max: (n_a,) wanted; limits (inf: none).
        G: (d, n_a), Lambda: (d, d) of the chain. metric: (d, d) SᵀΛ_oS.
        N: (d, r) SᵀN. pushed: (d, r) the same with friction, SᵀN_μ. Phi_e: (r, r) NᵀΦ_eN_μ.
        normal: (r, r) NᵀΛ_o⁻¹N.
        alpha: (r,) force command. share: (k, r) forces that must not pull, out of α.
        floor: (k,) their least values (N), at most what is commanded.
        E: (s, n_a) rows of the squeeze. carried: (s, d) what of it accelerations η̇ use up.
        mass: of the held object (kg).
        idle: (p, n_a) rows νᵀ.
    """

    tau: Array
    tau_max: Array
    G: Array
    Lambda: Array
    metric: Array
    N: Array
    pushed: Array
    Phi_e: Array
    normal: Array
    alpha: Array
    share: Array
    floor: Array
    E: Array
    carried: Array
    mass: float
    idle: Array | None = None


@dataclass(frozen=True)
class Relief:
    """Torques within the limits, and what they lack.

    Attributes:
        tau: (n_a,). at_limit: (n_a,) which motors stand at their limit.
        force: (r,) N, motion: (d,), squeeze: (s,) N: what was wanted less what will come.
        short: some force leaves its range: no torques within the limits keep it there.
    """

    tau: Array
    at_limit: Array
    force: Array
    motion: Array
    squeeze: Array
    short: bool


def relieve(wanted: Response) -> Relief:
    """The torques within the limits that lose the least acceleration energy.

    Raises:
        SolverError: the program was not solved.
    """
    x, n = wanted, len(wanted.tau)
    scale = effort_scale(x.tau_max)
    answer = np.linalg.solve(x.Lambda, np.hstack((x.G * scale, x.pushed)))
    free, yielding = answer[:, :n], answer[:, n:]
    force = np.linalg.solve(x.N.T @ yielding + x.Phi_e, x.N.T @ free)
    motion = free - yielding @ force
    squeeze = x.E * scale - x.carried @ motion
    floors = x.share @ force
    energy = np.vstack(
        (
            np.linalg.cholesky(x.metric).T @ motion,
            np.sqrt(_FORCE) * np.linalg.cholesky(x.normal).T @ force,
            np.sqrt(_SQUEEZE / x.mass) * squeeze,
            np.sqrt(_POSTURE) * (np.zeros((0, n)) if x.idle is None else x.idle * scale),
        )
    )
    size = np.sqrt((energy**2).sum() / n) or 1.0
    rows = np.vstack((energy / size, np.sqrt(_TORQUE) * np.eye(n)))
    low, high = (-x.tau_max - x.tau) / scale, (x.tau_max - x.tau) / scale
    least = x.floor - x.share @ x.alpha  # ≤ 0: nobody presses harder than commanded
    unit = np.linalg.norm(floors, axis=1)
    floors /= unit[:, None]
    low, high = np.append(low, least / unit), np.append(high, np.zeros(len(least)))
    z, short = _solve(rows, floors, low, high), False
    if z is None:
        z, short = _with_slack(rows, floors, low, high), True
    if z is None or not np.isfinite(z).all():
        raise SolverError(
            f"no torques within the motor limits were found for {np.round(x.tau, 3)} wanted"
        )
    tau = np.clip(x.tau + scale * z, -x.tau_max, x.tau_max)
    at_limit = np.abs(tau) >= x.tau_max * (1.0 - _SLACK)
    return Relief(tau, at_limit, -force @ z, -motion @ z, -squeeze @ z, short)


def _with_slack(rows: Array, A: Array, low: Array, high: Array) -> Array | None:
    """The same with forces that may leave their ranges, at a price."""
    n, k = rows.shape[1], len(A)
    price = np.sqrt(_BEYOND) * np.eye(k)
    wider = np.block([[rows, np.zeros((len(rows), k))], [np.zeros((k, n)), price]])
    low, high = np.insert(low, n, np.full(k, -np.inf)), np.insert(high, n, np.full(k, np.inf))
    z = _solve(wider, np.hstack((A, np.eye(k))), low, high)
    return None if z is None else z[:n]


def _solve(rows: Array, A: Array, low: Array, high: Array) -> Array | None:
    """argmin |rows z|² with low ≤ [z; A z] ≤ high; None: there is no such z.

    The solver finds which limits are active; with these as equations the answer is worked out once
    more from `rows` themselves, whose condition is the root of their square's.
    """
    import daqp

    n = rows.shape[1]
    upper, lower = np.minimum(high, _INFINITE), np.maximum(low, -_INFINITE)
    z, _, verdict, info = daqp.solve(
        rows.T @ rows, np.zeros(n), np.ascontiguousarray(A), upper, lower,
        np.zeros(len(upper), dtype=np.int32), primal_tol=1e-10,
    )  # fmt: skip
    if verdict < 1:
        return None
    active = np.flatnonzero(info["lam"])
    C = np.vstack((np.eye(n), A))[active]
    bound = np.where(np.asarray(info["lam"])[active] > 0.0, upper[active], lower[active])
    U, s, Vh = np.linalg.svd(C) if len(active) else (np.eye(0), np.zeros(0), np.eye(n))
    rank = int(np.count_nonzero(s > 1e-9))
    start = Vh[:rank].T @ ((U[:, :rank].T @ bound) / s[:rank])
    if rank < n:
        rest = Vh[rank:].T
        start = start - rest @ np.linalg.lstsq(rows @ rest, rows @ start, rcond=None)[0]
    kept = np.concatenate((start, A @ start))
    room = 1e-7 * (1.0 + np.abs(kept))
    exact = (kept >= lower - room).all() and (kept <= upper + room).all()
    return np.asarray(start if exact else z)


class EffortLimits:
    """Keeps a controller's torques within the motor limits, and says what that costs.

    Attributes:
        chain: with the limits. contacts: in the order of alpha_d. floor: least force of contacts
            that cannot pull (N); a command below it is its own floor.
    """

    def __init__(
        self, chain: ClosedChain, contacts: Sequence[ContactPair], floor: float = 1.0
    ) -> None:
        self.chain, self.contacts, self.floor = chain, tuple(contacts), floor
        self._pushes = np.array([pushes_only(pair) for pair in contacts], dtype=bool)

    def kept(self, tau: Array) -> bool:
        """Whether no torque exceeds its limit.

        Raises:
            InvalidInputError: they are not finite.
        """
        if not np.isfinite(tau).all():
            raise InvalidInputError(f"computed torques are not finite: {tau}")
        return not (np.abs(tau) > self.chain.tau_max).any()

    def response(self, s: Signals, owners: Array) -> Response:
        """What the chain makes of other torques than `s.tau`; `owners`: contact of each column."""
        state, contact = s.state, s.contact
        E, carried = squeeze_response(state, self.chain, s.squeeze_d)
        return Response(
            tau=s.tau,
            tau_max=self.chain.tau_max,
            G=state.G,
            Lambda=state.Lambda_S,
            metric=state.S.T @ state.metric @ state.S,
            N=state.S.T @ contact.N,
            pushed=state.S.T @ (contact.N + s.friction_wrenches),
            Phi_e=s.environment.yielding(contact.N, s.friction_wrenches),
            normal=contact.N.T @ np.linalg.solve(state.metric, contact.N),
            alpha=s.alpha_u,
            E=E,
            carried=carried,
            mass=self.chain.reference.inertia.mass,
            idle=idle_motions(state, self.chain),
            **self.floors(owners, contact.R, s.alpha_u),
        )

    def floors(self, owners: Array, R: Array, alpha: Array) -> dict[str, Array]:
        """`share` and `floor` of a Response.

        Args:
            owners: (r_all,) contact of each column. R: (r, r_all) as in `Contact.R`.
            alpha: (r,) force command.
        """
        pushes = self._pushes[owners]
        share = R.T @ np.linalg.inv(R @ R.T) if len(R) else np.zeros((0, 0))
        return {"share": share[pushes], "floor": np.minimum(self.floor, share[pushes] @ alpha)}

    def given_up(
        self, wanted: Response, relief: Relief, R: Array, acceleration: Array
    ) -> LimitLoss:
        """For the user: by joint, by contact force, and as an acceleration (6,) at O."""
        motors = np.flatnonzero(relief.at_limit)
        names = self.chain.joint_names
        force = R.T @ np.linalg.solve(R @ R.T, relief.force) if len(R) else np.zeros(0)
        return LimitLoss(
            tuple(names[self.chain.actuated[i]] for i in motors),
            wanted.tau[motors],
            self.chain.tau_max[motors],
            force,
            acceleration,
            relief.squeeze,
            relief.short,
        )


def idle_motions(state: ChainState, chain: ClosedChain) -> Array:
    """(p, n_a) null spaces of NᵀJ of the redundant arms, orthonormal by M."""
    rows = [np.zeros((0, chain.nq))]
    for arm, part, grasp in zip(state.arms, chain.slices, chain.grasps, strict=True):
        n, m = part.stop - part.start, grasp.N.shape[1]
        if n <= m:
            continue
        null = np.linalg.svd(arm.N.T @ arm.J)[2][arm.rank :].T
        factor = np.linalg.cholesky(null.T @ arm.M @ null)
        row = np.zeros((n - arm.rank, chain.nq))
        row[:, part] = np.linalg.solve(factor, null.T)
        rows.append(row)
    return np.vstack(rows)[:, chain.actuated]
