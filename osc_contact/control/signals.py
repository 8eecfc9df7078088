"""Results of one tick: the signals of fig. 4, and the arrays that recordings store."""

from functools import cached_property
from typing import Any

import numpy as np
from pinocchio import SE3

from osc_contact.contacts.contact import Contact
from osc_contact.control.controller_settings import Settings
from osc_contact.control.records import TickRecords
from osc_contact.dynamics.chain_state import ChainState
from osc_contact.dynamics.environment import Environment
from osc_contact.interface import Reference, Touched
from osc_contact.spatial import Array


def internal_forces(arms: int) -> int:
    """Number of internal forces in recordings: one for each pair of grasps, at least one."""
    return max(1, arms * (arms - 1) // 2)


class TickResult:
    """Views of a controller's records: the next tick overwrites them. At O in world axes.

    Attributes:
        records: where all of it stands.
        f_meas, bias_out: (6,) wrist readings less tare; what they would be without contact.
        f_c: (6,) contact force in them. V_O: (6,) twist of the object. X_WO: (4, 4) its pose.
        error: (6,) pose error. free_error: (6,) the part of it that arms and contacts permit.
    """

    def __init__(self, records: TickRecords) -> None:
        """Store the records whose fields are the results."""
        self.records = records

    def __getattr__(self, name: str) -> Any:
        if name == "records":  # of a copy that is being made
            raise AttributeError(name)
        return getattr(self.records.work, name)

    @property
    def squeeze(self) -> Array:
        """(1,) internal force along the grasp line (N), > 0 compresses; with k ≥ 3 arms
        (k(k − 1)/2,) that between each two grasps, as in `Reference.squeeze_d`, or zeros where none
        is commanded."""
        return self.records.work.bars

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


class Signals(TickResult):
    """The signals of one tick; everything at O in world axes.

    q, v (n,) encoders · wrenches (arms, 6) · touched: motion of the touched bodies · reference ·
    alpha_d (r_all,) desired contact forces · squeeze_d · state: Λ_S, μ, p, S, σ, G of the closed
    chain · parts: N, n_γ of each contact in force · contact: of all contacts ·
    friction_wrenches (6, r): N_μ − N · environment: Φ_e, b_e, V_e · f_meas (6,): sum of
    the wrist readings, tare removed · f_c_meas (6,): contact force in it · alpha_meas (r,):
    its magnitudes · alpha_u (r,), f_ccomm (6,): force command · a_u (6,): motion
    command · eta_c (d,): after its filter · f_S (d,) · tau (n_a,).
    """

    def __init__(self, settings: Settings, records: TickRecords) -> None:
        """Copy what a tick has left."""
        super().__init__(records.copy())
        self._settings = settings
        self.q = self.joints.q
        self.v = self.joints.v
        self.wrenches = self.arms.reading
        self.alpha_d = self.columns.alpha_d
        memory = self.records.memory
        self.tau = memory.torques
        given = memory.squeeze
        self.squeeze_d = float(given[0]) if len(given) == 1 else given
        self.reference = Reference(SE3(self.X_WD), self.V_D, self.A_D, self.alpha_d, self.squeeze_d)
        self.touched = None
        if self.moving:
            X_WE, V_E, A_E = np.split(self.bodies.motion, (16, 22), axis=1)
            self.touched = Touched(X_WE.reshape(-1, 4, 4), V_E, A_E)
        self.f_c_meas = self.f_c
        r = self.rank
        self.alpha_u = self.records.work.alpha_u[:r]
        self.friction_wrenches = self.records.work.friction_wrenches[:r].T

    @cached_property
    def state(self) -> ChainState:
        chain = self._settings.chain
        motion = () if chain.leader is not None else (SE3(self.X_WO), self.V_O)
        return chain.state(self.q, self.v, *motion, data=chain.model.createData())

    @cached_property
    def _active(self) -> list[int]:
        """Contacts with columns in force, in their order."""
        chosen = self.records.work.chosen[: int(self.count)]
        return list(dict.fromkeys(self.records.model.columns.contact[chosen].tolist()))

    @cached_property
    def parts(self) -> list[Contact]:
        """Active contacts: N (6, r) at O in world axes, n_γ (r,), and the name of the pair."""
        out = []
        for c in self._active:
            mine = self.columns[self.records.model.columns.contact == c]
            name = self._settings.contacts[c].name
            out.append(Contact(mine.N.T, mine.n_gamma, name=name))
        return out

    @cached_property
    def contact(self) -> Contact:
        N = self.columns.N[self.records.kept()].T.copy()
        n_gamma = self.n_gamma[: self.rank]
        R = None if self.rank == self.count else self.records.shares()
        return Contact.judged(N, n_gamma, R)  # by the tick

    @cached_property
    def environment(self) -> Environment:
        """Inverse inertia Φ_e, bias b_e and twist V_e of the touched bodies together."""
        if not self.moving:
            return Environment.fixed()
        touched = self.records.model.bodies.same[self._active].tolist()
        answers = {}
        for body in set(touched):
            Phi_e, b_e, V_e = np.split(self.bodies.answer[body], (36, 42))
            answers[body] = Environment(Phi_e.reshape(6, 6), b_e, V_e)
        each = [answers[body] for body in touched]
        return Environment.combine(self.parts, each, self.state.metric)

    @cached_property
    def f_ccomm(self) -> Array:
        return (self.contact.N + self.friction_wrenches) @ self.alpha_u

    @cached_property
    def eta_c(self) -> Array:
        S = self.state.S
        weighted = S.T @ self.state.metric
        a = self.records.acceleration() - self.state.sigma
        return np.linalg.solve(weighted @ S, weighted @ a)

    @cached_property
    def f_S(self) -> Array:
        f = self.records.work.f_S.copy()
        f[: int(self.locked)] = 0.0
        wrench = np.linalg.solve(self.records.motions().T, self.records.reflection().T @ f)
        return self.state.S.T @ wrench
