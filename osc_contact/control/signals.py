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
    """Results of the last tick as views of a controller's records; the next tick overwrites them.

    Each field of WORK is an attribute. Wrenches (N, N m) and motions (m, rad, s) are at O in world
    axes.

    Attributes:
        records: records of the controller.
        f_meas, bias_out: (6,) sum of the wrist readings less tare; what it would be without contact
            at zero acceleration of the object (a = 0).
        f_c: (6,) measured contact wrench.
        V_O: (6,) twist of the object.
        X_WO: (4, 4) its pose.
        error: (6,) pose error.
        free_error: (6,) the part of it that arms and contacts permit.
    """

    def __init__(self, records: TickRecords) -> None:
        """Store the records whose fields are the results."""
        self.records = records

    def __getattr__(self, name: str) -> Any:
        """Return a field or table of WORK as an attribute."""
        if name == "records":  # `copy` asks before it is set; without this the lookup is endless
            raise AttributeError(name)
        return getattr(self.records.work, name)

    @property
    def squeeze(self) -> Array:
        """Internal force (1,) along the grasp line (N), > 0 compresses.

        With k ≥ 3 arms (k(k − 1)/2,): the force between each two grasps, in the order of
        `Reference.squeeze_d`; zeros if none is commanded.
        """
        return self.records.work.bars

    @property
    def friction(self) -> Array:
        """Motor torques (n,) that compensate friction of the joints (N m, N)."""
        return self.records.work.joints.friction

    @property
    def rank(self) -> int:
        """Number r of independent active columns of N."""
        return int(self.records.work.rank)

    @property
    def alpha_meas(self) -> Array:
        """Measured contact forces (r,) (N)."""
        return self.records.work.alpha_meas[: self.rank]

    @property
    def normal_speed(self) -> Array:
        """Speeds NᵀV_rel (r,) (m/s), 0 while the contacts last."""
        return self.records.work.speed[: self.rank]

    @property
    def mobility(self) -> Array:
        """Normal accelerations by contact forces, the mobility D (r, r) of the contacts in 1/kg.

        D = Nᵀ(Λ_out⁻¹ + Φ_e)N, with Λ_out the inertia beyond the wrist sensors.
        """
        r = self.rank
        return self.records.work.mobility[:r, :r]


class Signals(TickResult):
    """Signals of one tick (fig. 4), a copy that later ticks do not change.

    Wrenches (N, N m) and motions (m, rad, s) are at O in world axes.

    Attributes:
        q, v: (n,) measured joint positions and velocities.
        wrenches: (arms, 6) wrist readings.
        touched: motion of the touched bodies, or None.
        reference: reference of the tick.
        alpha_d: (r_all,) desired contact forces (N).
        squeeze_d: desired internal forces (N).
        state: Λ_S, μ, p, S, σ, G of the closed chain.
        parts: N, n_γ of each active contact.
        contact: N, n_γ of all active contacts together.
        friction_wrenches: (6, r) N_μ − N.
        environment: Φ_e, b_e, V_e.
        f_meas: (6,) sum of the wrist readings, less tare.
        f_c_meas: (6,) measured contact wrench.
        alpha_meas: (r,) measured contact forces (N).
        alpha_u, f_ccomm: (r,), (6,) force command. a_u: (6,) motion command.
        eta_c: (d,) motion command after its filter.
        f_S: (d,) generalised force on the object.
        tau: (n_a,) motor torques (N m, N).
    """

    def __init__(self, settings: Settings, records: TickRecords) -> None:
        """Copy the records of a tick, and set the signals that are no single field of WORK.

        Others are looked up in the records by their names (`self.joints`, `self.X_WD`, …).

        Args:
            settings: settings of the controller.
            records: records after the tick, or, for custom laws, between its parts.
        """
        super().__init__(records.copy())
        self._settings = settings
        self.q = self.joints.q
        self.v = self.joints.v
        self.wrenches = self.arms.reading
        self.alpha_d = self.columns.alpha_d
        memory = self.records.memory
        self.tau = memory.torques
        squeeze_d = memory.squeeze
        self.squeeze_d = float(squeeze_d[0]) if len(squeeze_d) == 1 else squeeze_d
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
        """State of arms and object at q, v, computed by the classes of `osc_contact.dynamics`."""
        chain = self._settings.chain
        motion = () if chain.leader is not None else (SE3(self.X_WO), self.V_O)
        return chain.state(self.q, self.v, *motion, data=chain.model.createData())

    @cached_property
    def _active_contacts(self) -> list[int]:
        """Indices of the contacts that have active columns of N, in the order of the columns."""
        columns = self.records.work.chosen[: int(self.count)]
        return list(dict.fromkeys(self.records.model.columns.contact[columns].tolist()))

    @cached_property
    def parts(self) -> list[Contact]:
        """Active contacts with N (6, r) at O in world axes, n_γ (r,), and the name of the pair.

        `_active_contacts` has the indices of these contacts, `_settings` their pairs; the columns
        of N are those of WORK.
        """
        contacts = []
        for number in self._active_contacts:
            columns = self.columns[self.records.model.columns.contact == number]
            name = self._settings.contacts[number].name
            contacts.append(Contact(columns.N.T, columns.n_gamma, name=name))
        return contacts

    @cached_property
    def contact(self) -> Contact:
        """Union of all active contacts: N (6, r), independent columns; n_γ (r,); shares R."""
        N = self.columns.N[self.records.kept()].T.copy()
        n_gamma = self.n_gamma[: self.rank]
        R = None if self.rank == self.count else self.records.shares()
        return Contact.judged(N, n_gamma, R)  # the law has selected independent columns

    @cached_property
    def environment(self) -> Environment:
        """Inverse inertia Φ_e, bias b_e and twist V_e of the bodies that all active contacts touch.

        They are at O in world axes. Contacts on one body share its environment; different bodies
        are combined along the contact normals. Without measured motions the environment is at rest.
        """
        if not self.moving:
            return Environment.fixed()
        touched = self.records.model.bodies.same[self._active_contacts].tolist()
        answers = {}
        for body in set(touched):
            Phi_e, b_e, V_e = np.split(self.bodies.answer[body], (36, 42))
            answers[body] = Environment(Phi_e.reshape(6, 6), b_e, V_e)
        answers_by_contact = [answers[body] for body in touched]
        return Environment.combine(self.parts, answers_by_contact, self.state.metric)

    @cached_property
    def f_ccomm(self) -> Array:
        """Commanded contact wrench (6,) N_μ α_u on the environment (N, N m)."""
        return (self.contact.N + self.friction_wrenches) @ self.alpha_u

    @cached_property
    def eta_c(self) -> Array:
        """Filtered motion command η̇_c (d,) of eq. 24: a − σ = S η̇_c in the chain's metric."""
        S = self.state.S
        weighted = S.T @ self.state.metric
        a = self.records.acceleration() - self.state.sigma
        return np.linalg.solve(weighted @ S, weighted @ a)

    @cached_property
    def f_S(self) -> Array:
        """Generalised force (d,) on the object, eq. 21, converted from locked axes to axes of S."""
        f = self.records.work.f_S.copy()
        f[: int(self.locked)] = 0.0
        wrench = np.linalg.solve(self.records.motions().T, self.records.reflection().T @ f)
        return self.state.S.T @ wrench
