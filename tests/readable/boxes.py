"""The boxes of fig. 4, in the order in which the signals meet them.

Each method marked `@block` is one box: it reads and writes the named signals of `Signals` and
nothing else, so that the diagrams of figs. 4 and 5 can be drawn from a real tick.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs import ContactPair
from osc_contact.control.friction import Friction
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.rail import Body
from osc_contact.spatial import Array
from readable.allocation import Allocation
from readable.chain import state as chain_state
from readable.command_filter import (
    filtered_motion,
    generalised_force,
    metric_of,
    object_coordinates,
)
from readable.contact_state import chosen, parts_in_force, surroundings
from readable.force import (
    ContactTerms,
    ForceLaw,
    contact_force,
    magnitudes,
    sum_of_wrenches,
)
from readable.least_squares import explained, slides
from readable.motion import MotionLaw
from readable.phases import ContactPhases, Phase
from readable.rubbing import with_friction
from readable.signals import Signals, Stage, block
from readable.singular import faded_motion
from readable.validation import independent

__all__ = ["Boxes"]

AHEAD = 2.0  #: control periods from a measurement to when its torques act at the latest


class Boxes:
    """What the boxes know besides their signals; `Controller` says what each of these is."""

    chain: ClosedChain
    contacts: Sequence[ContactPair]
    bodies: Sequence[Body | None]
    friction: Friction | None
    reading: str
    more_friction: float
    B: Array | str
    motion_law: MotionLaw
    force_law: ForceLaw
    allocation: Allocation
    terms: ContactTerms
    life: ContactPhases | None
    _tare: Array
    _bias: Array
    _owners: Array
    _fresh: bool
    _late: Array
    signals: Signals

    @block("closed chain", "model", r"$\Lambda_S,\ \mu,\ p,\ S,\ \sigma,\ G$  (13)")
    def _model(self, s: Signals) -> None:
        state = chain_state(self.chain, s.q, s.v)
        later = s.reference.V_D + AHEAD * self.force_law.dt * s.reference.A_D
        s.state = with_friction(self.chain, state, s.v, later)

    @block("contact geometry", "model", r"$N,\ T,\ n_\gamma$")
    def _contact(self, s: Signals) -> None:
        active = self.terms.active
        pairs = [pair for pair, on in zip(self.contacts, active, strict=True) if on]
        touched = chosen(s.touched, active)
        s.parts = parts = parts_in_force(pairs, s.state, touched)
        s.contact = contact = Contact.stack(parts, np.linalg.inv(s.state.metric))
        s.friction_wrenches, X = np.zeros_like(contact.N), s.state.X_WO
        V = s.state.V_O + AHEAD * self.force_law.dt * s.reference.A_D  # when the torques act
        believed = self.friction or Friction(0.0)
        mu = max(believed.mu + self.more_friction, 0.0)
        if mu > 0.0:
            s.friction_wrenches = (
                replace(believed, mu=mu).wrenches(pairs, X, V, touched) @ contact.R.T
            )
        if self.reading == "least_squares":
            self._where = slides(pairs, X, V, touched, believed.slip)
        self._owners = np.repeat(np.flatnonzero(active), [part.R.shape[1] for part in parts])

    @block("environment", "model", r"$\Phi_e,\ b_e,\ V_e$  (14)")
    def _environment(self, s: Signals) -> None:
        active = self.terms.active
        bodies = [body for body, on in zip(self.bodies, active, strict=True) if on]
        s.environment = surroundings(
            bodies, s.parts, chosen(s.touched, active), s.state, s.friction_wrenches
        )

    @block("sum of wrist sensors", "force", r"$\Sigma$ at $O$")
    def _sense(self, s: Signals) -> None:
        s.f_meas = sum_of_wrenches(s.wrenches, s.state) - self._tare

    @block("force filter", "force", r"$\Omega_f(\Lambda_{out})$")
    def _force_filter(self, s: Signals) -> None:
        if self.reading == "filter" or s.contact.r == 0:
            s.f_c_meas = contact_force(
                s.f_meas, s.state, s.contact, s.environment, s.friction_wrenches
            )
            return
        wanted, active = s.alpha_d, self.terms.active
        if self.life is not None:
            wanted = wanted[active[self.life.columns.owners]]
        alpha, rate, self.inertia = explained(
            s.f_meas, s.state, s.contact, s.environment, s.friction_wrenches, s.reference.A_D,
            wanted, self._where,
        )  # fmt: skip
        s.f_c_meas = s.contact.N @ alpha
        believed = self.friction or Friction(0.0)
        more = self.more_friction + believed.learning * self.force_law.dt * rate
        self._more_friction = min(max(more, -believed.mu), 2.0 - believed.mu)

    @block("generalised inverse", "force", r"$N^{\#}$")
    def _magnitudes(self, s: Signals) -> None:
        s.alpha_meas = magnitudes(s.f_c_meas, s.contact)

    @block("force law", "force", r"$\alpha_d + K_i\!\int(\alpha_d-\alpha_{meas})$")
    def _force_law(self, s: Signals) -> None:
        wanted, active = s.alpha_d, self.terms.active
        if self.life is not None and not active.all():
            wanted = wanted[active[self.life.columns.owners]]
        desired = independent(wanted, s.contact) if active.any() else np.zeros(0)
        speed = s.contact.N.T @ (s.state.V_O - s.environment.V_e)
        if self.life is not None:
            speed = self._believed(s, speed)
        self._speed = speed
        terms = self.terms.of_columns(self._owners, s.contact.r)
        s.alpha_u = self.force_law.command(desired, s.alpha_meas, speed, terms)

    def _believed(self, s: Signals, speed: Array) -> Array:
        """(r,) NᵀV_rel; of approaches that of the positions, where these show more of it."""
        life, dt = self.life, self.force_law.dt
        assert life is not None
        here = np.flatnonzero(self.terms.active[life.columns.owners])
        if len(here) != len(speed):
            return speed
        turned = np.eye(3)
        step = np.zeros(3)
        if self._fresh:
            before = self.signals.state.X_WO
            turned = s.state.X_WO.rotation @ before.rotation.T
            step = s.state.X_WO.translation - before.translation
        twist = np.concatenate((step, pin.unSkew(0.5 * (turned - turned.T)))) / dt
        shows = s.contact.N.T @ (twist - s.environment.V_e)
        known = life.state.heard.known[here] & self._fresh
        late = self._late[:, here]
        late = np.where(known, late + dt / (0.02 + dt) * (np.stack((shows, speed)) - late), speed)
        self._late[:, here] = late
        short = late[0] - late[1] > 0.2 * life.settings.speed
        short &= known & (life.state.phase[life.columns.owners[here]] == Phase.APPROACHING)
        return np.where(short, late[0], speed)

    @block("to operational space", "force", r"$N\alpha_u$  (16)")
    def _operational_force(self, s: Signals) -> None:
        s.f_ccomm = (s.contact.N + s.friction_wrenches) @ s.alpha_u

    @block("motion law", "motion", r"$\ddot x_d + K_d\dot e + K_p e + K_i\!\int\! e$")
    def _motion_law(self, s: Signals) -> None:
        Omega_m = s.contact.motion_projection(metric_of(self.B, s.state))
        s.a_u = self.motion_law.command(s.reference, s.state, Omega_m)

    @block("motion filter", "filter", r"$\Omega_m(B)$  (24)")
    def _motion_filter(self, s: Signals) -> None:
        eta_u = object_coordinates(s.state, s.contact, s.a_u)
        B = metric_of(self.B, s.state)
        eta = filtered_motion(
            s.state, s.contact, eta_u, s.alpha_u, B, s.environment, s.friction_wrenches
        )
        posture = self.allocation.retreat(s.q, s.v)
        s.eta_c = faded_motion(s.state, s.contact, self.chain, eta, posture)

    @block("dynamic control structure", "filter", r"$\Lambda_S\dot\eta_c+b_S+S^Tf_{ccomm}$  (21)")
    def _control_structure(self, s: Signals) -> None:
        s.f_S = generalised_force(s.state, s.eta_c, s.f_ccomm + self._bias)

    @block("torque allocation", "filter", r"$G\tau = f_S$, squeeze in null$(G)$")
    def _allocate(self, s: Signals) -> None:
        s.tau = self.allocation.torques(s.state, s.q, s.v, s.f_S, s.eta_c, s.squeeze_d)

    STAGES: tuple[Stage, ...] = (
        _model,
        _contact,
        _environment,
        _sense,
        _force_filter,
        _magnitudes,
        _force_law,
        _operational_force,
        _motion_law,
        _motion_filter,
        _control_structure,
        _allocate,
    )
