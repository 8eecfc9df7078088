"""The signals of fig. 4 as one tick left them: values, worked out from its records alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.control.settings import Settings
from osc_contact.control.tick_records import TickRecords
from osc_contact.dynamics.closed_chain import ChainState
from osc_contact.dynamics.environment import Environment
from osc_contact.interface import Reference, Touched
from osc_contact.spatial import Array

__all__ = ["BLOCKS", "Block", "SIGNALS", "Signals"]


@dataclass(frozen=True)
class Block:
    """One box of fig. 4 or 5: what it is called, what it computes, what goes in and out."""

    name: str
    group: str
    equation: str
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()


#: The boxes of fig. 4 in the order in which the signals meet them.
BLOCKS = (
    Block("closed chain", "model", "$\\Lambda_S,\\ \\mu,\\ p,\\ S,\\ \\sigma,\\ G$\n(13)",
          ("q", "v"), ("state",)),
    Block("contact geometry", "model", r"$N,\ T,\ n_\gamma$",
          ("touched", "state"), ("parts", "contact", "friction_wrenches")),
    Block("environment", "model", r"$\Phi_e,\ b_e,\ V_e$  (14)",
          ("touched", "parts", "state", "friction_wrenches"), ("environment",)),
    Block("sum of wrist sensors", "force", r"$\Sigma$ at $O$", ("wrenches", "state"), ("f_meas",)),
    Block("force filter", "force", r"$\Omega_f(\Lambda_{out})$",
          ("f_meas", "state", "contact", "environment", "friction_wrenches"), ("f_c_meas",)),
    Block("generalised inverse", "force", r"$N^{\#}$", ("f_c_meas", "contact"), ("alpha_meas",)),
    Block("force law", "force", r"$\alpha_d + K_i\int(\alpha_d-\alpha_{meas})$",
          ("alpha_d", "contact", "state", "environment", "alpha_meas"), ("alpha_u",)),
    Block("to operational space", "force", r"$N\alpha_u$  (16)",
          ("contact", "friction_wrenches", "alpha_u"), ("f_ccomm",)),
    Block("motion law", "motion", r"$\ddot x_d + K_d\dot e + K_p e + K_i\int e$",
          ("contact", "state", "reference"), ("a_u",)),
    Block("motion filter", "filter", r"$\Omega_m(B)$  (24)",
          ("state", "contact", "a_u", "alpha_u", "environment", "friction_wrenches", "q", "v"),
          ("eta_c",)),
    Block("dynamic control structure", "filter", "$\\Lambda_S\\dot\\eta_c+b_S+S^Tf_{ccomm}$\n(21)",
          ("state", "eta_c", "f_ccomm"), ("f_S",)),
    Block("torque allocation", "filter", "$G\\tau = f_S$,\nsqueeze in null$(G)$",
          ("state", "q", "v", "f_S", "eta_c", "squeeze_d"), ("tau",)),
)  # fmt: skip

SIGNALS = (
    "q", "v", "wrenches", "touched", "reference", "alpha_d", "squeeze_d", "state", "parts",
    "contact", "friction_wrenches", "environment", "f_meas", "f_c_meas", "alpha_meas", "alpha_u",
    "f_ccomm", "a_u", "eta_c", "f_S", "tau",
)  # fmt: skip


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
        rows = records.copy()
        self._rows, w = rows, rows.work
        self.q, self.v = rows.joints.q.copy(), rows.joints.v.copy()
        self.wrenches = rows.arms.reading.copy()
        self.alpha_d, self.squeeze_d, self.tau = rows.columns.alpha_d.copy(), squeeze_d, tau.copy()
        self.reference = Reference(
            pin.SE3(w.X_WD.copy()), w.V_D.copy(), w.A_D.copy(), self.alpha_d, squeeze_d
        )
        self.touched = None
        if w.moving:
            m = rows.bodies.motion.copy()
            self.touched = Touched(m[:, :16].reshape(-1, 4, 4), m[:, 16:22], m[:, 22:])
        r = int(w.rank)
        self.f_meas, self.f_c_meas, self.a_u = w.f_meas.copy(), w.f_c.copy(), w.a_u.copy()
        self.alpha_meas, self.alpha_u = w.alpha_meas[:r].copy(), w.alpha_u[:r].copy()
        self.friction_wrenches = w.friction_wrenches[:r].T.copy()

    @cached_property
    def state(self) -> ChainState:
        chain = self._settings.chain
        X = None if chain.leader is not None else pin.SE3(self._rows.work.X_WO.copy())
        V = None if X is None else self._rows.work.V_O.copy()
        return chain.state(self.q, self.v, X, V, data=chain.model.createData())

    @cached_property
    def parts(self) -> list[Contact]:
        rows, out = self._rows, []
        owners = rows.row.pairs.owners
        active = dict.fromkeys(owners[j] for j in rows.columns.chosen[: int(rows.work.count)])
        for c in active:
            mine = [j for j, owner in enumerate(owners) if owner == c]
            N, n_gamma = rows.columns.N[mine].T, rows.columns.n_gamma_all[mine]
            out.append(Contact(N, n_gamma, name=self._settings.contacts[c].name))
        return out

    @cached_property
    def contact(self) -> Contact:
        rows = self._rows
        kept, r = rows.kept(), int(rows.work.rank)
        if r == int(rows.work.count):
            return Contact(rows.columns.N[kept].T, rows.work.n_gamma[:r].copy())
        contact = Contact.__new__(Contact)  # the verdict is the tick's
        contact.N, contact.n_gamma = rows.columns.N[kept].T.copy(), rows.work.n_gamma[:r].copy()
        contact.name = ""
        contact.__dict__["R"] = rows.shares()
        return contact

    @cached_property
    def environment(self) -> Environment:
        rows = self._rows
        if not rows.work.moving:
            return Environment.fixed()
        owners = rows.row.pairs.owners
        active = dict.fromkeys(owners[j] for j in rows.columns.chosen[: int(rows.work.count)])
        bodies = rows.row.head.bodies.same
        answers: dict[int, Environment] = {}
        for body in (int(bodies[c]) for c in active):
            Phi_e, b_e, V_e = np.split(rows.bodies.answer[body], (36, 42))
            answers.setdefault(body, Environment(Phi_e.reshape(6, 6).copy(), b_e, V_e))
        each = [answers[int(bodies[c])] for c in active]
        return Environment.combine(self.parts, each, self.state.metric, self.friction_wrenches)

    @cached_property
    def f_ccomm(self) -> Array:
        return np.asarray((self.contact.N + self.friction_wrenches) @ self.alpha_u)

    @cached_property
    def eta_c(self) -> Array:
        S, a = self.state.S, self._rows.acceleration() - self.state.sigma
        H = S.T @ self.state.metric @ S
        return np.asarray(np.linalg.solve(H, S.T @ (self.state.metric @ a)))

    @cached_property
    def f_S(self) -> Array:
        rows = self._rows
        f = rows.work.f_S.copy()
        f[: int(rows.work.locked)] = 0.0
        wrench = np.linalg.solve(rows.motions().T, rows.reflection().T @ f)
        return np.asarray(self.state.S.T @ wrench)
