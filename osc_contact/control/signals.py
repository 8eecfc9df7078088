"""What one tick found: the signals of fig. 4 as values, and the arrays that recordings keep."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.control.records import Settings, TickRecords
from osc_contact.dynamics.chain_state import ChainState
from osc_contact.dynamics.environment import Environment
from osc_contact.interface import Reference, Touched
from osc_contact.spatial import Array


class Signals:
    """The signals of one tick; everything at O in world axes.

    q, v (n,) encoders · wrenches (arms, 6) · touched: motion of the touched bodies · reference ·
    alpha_d (r_all,) desired contact forces · squeeze_d · state: Λ_S, μ, p, S, σ, G of the closed
    chain · parts: N, n_γ of each contact in force · contact: of all contacts ·
    friction_wrenches (6, r): N_μ − N · environment: Φ_e, b_e, V_e · f_meas (6,): sum of
    the wrist readings, tare removed · f_c_meas (6,): contact force in it · alpha_meas (r,):
    its magnitudes · alpha_u (r,), f_ccomm (6,): force command · a_u (6,): motion
    command · eta_c (d,): after its filter · f_S (d,) · tau (n_a,).
    """

    def __init__(
        self, settings: Settings, records: TickRecords, squeeze_d: float | Array, tau: Array
    ) -> None:
        """Copy what a tick has left."""
        self._settings = settings
        self._records = records.copy()
        w = self._records.work
        r = int(w.rank)
        self.q = w.joints.q.copy()
        self.v = w.joints.v.copy()
        self.wrenches = w.arms.reading.copy()
        self.alpha_d = w.columns.alpha_d.copy()
        self.squeeze_d = squeeze_d
        self.tau = tau.copy()
        self.reference = Reference(
            pin.SE3(w.X_WD.copy()), w.V_D.copy(), w.A_D.copy(), self.alpha_d, squeeze_d
        )
        self.touched = None
        if w.moving:
            m = w.bodies.motion.copy()
            self.touched = Touched(m[:, :16].reshape(-1, 4, 4), m[:, 16:22], m[:, 22:])
        self.f_meas = w.f_meas.copy()
        self.f_c_meas = w.f_c.copy()
        self.a_u = w.a_u.copy()
        self.alpha_meas = w.alpha_meas[:r].copy()
        self.alpha_u = w.alpha_u[:r].copy()
        self.friction_wrenches = w.friction_wrenches[:r].T.copy()

    @cached_property
    def state(self) -> ChainState:
        chain = self._settings.chain
        work = self._records.work
        led = chain.leader is not None
        motion = () if led else (pin.SE3(work.X_WO.copy()), work.V_O.copy())
        return chain.state(self.q, self.v, *motion, data=chain.model.createData())

    @cached_property
    def _active(self) -> list[int]:
        """Contacts with columns in force, in their order."""
        work = self._records.work
        owners = self._records.model.columns.contact[work.columns.chosen[: int(work.count)]]
        return list(dict.fromkeys(owners.tolist()))

    @cached_property
    def parts(self) -> list[Contact]:
        columns = self._records.work.columns
        out = []
        for c in self._active:
            mine = self._records.model.columns.contact == c
            name = self._settings.contacts[c].name
            out.append(Contact(columns.N[mine].T, columns.n_gamma_all[mine], name=name))
        return out

    @cached_property
    def contact(self) -> Contact:
        records = self._records
        work = self._records.work
        N = work.columns.N[records.kept()].T
        n_gamma = work.n_gamma[: int(work.rank)].copy()
        if work.rank == work.count:
            return Contact(N, n_gamma)
        contact = Contact.__new__(Contact)  # the verdict is the tick's
        contact.N = N.copy()
        contact.n_gamma = n_gamma
        contact.name = ""
        contact.__dict__["R"] = records.shares()
        return contact

    @cached_property
    def environment(self) -> Environment:
        if not self._records.work.moving:
            return Environment.fixed()
        bodies = self._records.model.bodies.same[self._active].tolist()
        answers: dict[int, Environment] = {}
        for body in bodies:
            Phi_e, b_e, V_e = np.split(self._records.work.bodies.answer[body], (36, 42))
            answers.setdefault(body, Environment(Phi_e.reshape(6, 6).copy(), b_e, V_e))
        each = [answers[body] for body in bodies]
        return Environment.combine(self.parts, each, self.state.metric, self.friction_wrenches)

    @cached_property
    def f_ccomm(self) -> Array:
        return (self.contact.N + self.friction_wrenches) @ self.alpha_u

    @cached_property
    def eta_c(self) -> Array:
        S = self.state.S
        a = self._records.acceleration() - self.state.sigma
        H = S.T @ self.state.metric @ S
        return np.linalg.solve(H, S.T @ (self.state.metric @ a))

    @cached_property
    def f_S(self) -> Array:
        records = self._records
        f = records.work.f_S.copy()
        f[: int(records.work.locked)] = 0.0
        wrench = np.linalg.solve(records.motions().T, records.reflection().T @ f)
        return self.state.S.T @ wrench


def internal_forces(arms: int) -> int:
    """How many internal forces recordings keep: one for each two grasps, at least one."""
    return max(1, arms * (arms - 1) // 2)


class TickResult:
    """Views of a controller's records: the next tick overwrites them. At O in world axes.

    Attributes:
        records: where all of it stands.
        J_world: (n, 6) the joints' columns at the world's origin, one in each row.
        f_meas, bias_out: (6,) wrist readings less tare; what they would be without contact.
        f_c: (6,) contact force in them. V_O: (6,) twist of the object. X_WO: (4, 4) its pose.
        error: (6,) pose error. free_error: (6,) Ω_m(Λ_o⁻¹) of it.
    """

    def __init__(self, records: TickRecords) -> None:
        """What these records hold."""
        self.records = records

    def __getattr__(self, name: str) -> Any:
        return getattr(self.records.work, name)

    @property
    def squeeze(self) -> Array:
        """(1,) internal force along the grasp line (N), > 0 compresses; with k ≥ 3 arms
        (k(k − 1)/2,) that between each two grasps, as in `Reference.squeeze_d`, or zeros where none
        is commanded."""
        work = self.records.work
        return work.bars if len(work.bars) > 1 else work.internal

    @property
    def friction(self) -> Array:
        """(n,) motor torques that compensate friction of the joints."""
        return self.records.work.joints.friction

    @property
    def rank(self) -> int:
        """r, independent columns of N in force."""
        return int(self.records.work.rank)

    @property
    def alpha_meas(self) -> Array:
        """(r,) contact magnitudes measured."""
        return self.records.work.alpha_meas[: self.rank]

    @property
    def normal_speed(self) -> Array:
        """(r,) NᵀV_rel (m/s): 0 while the contacts last."""
        return self.records.work.speed[: self.rank]

    @property
    def mobility(self) -> Array:
        """(r, r) D: normal acceleration for each newton on what is outboard of the sensors."""
        r = self.rank
        return self.records.work.mobility[:r, :r]
