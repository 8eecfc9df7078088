"""The decoupled force/motion controller: fig. 4, assembled on one page.

Each method marked `@block` is one box of the figure: it reads and writes the named signals of
`Signals` and nothing else, so that the diagrams of figs. 4 and 5 can be drawn from a real tick.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs import ContactPair
from osc_contact.control.allocation import Allocation
from osc_contact.control.border import Status, independent, limited, require_sound, take_in
from osc_contact.control.command_filter import (
    filtered_motion,
    generalised_force,
    object_coordinates,
)
from osc_contact.control.effort_limits import EffortLimits, GivenUp, relieve
from osc_contact.control.fade import LostDirection, faded_motion, lost_directions
from osc_contact.control.force import (
    ForceGains,
    ForceLaw,
    contact_force,
    magnitudes,
    sum_of_wrenches,
)
from osc_contact.control.found import Found
from osc_contact.control.friction import Friction
from osc_contact.control.motion import MotionGains, MotionLaw
from osc_contact.control.wires import Block, Signals, Stage, TracedSignals, block
from osc_contact.dynamics.closed_chain import ChainState, ClosedChain
from osc_contact.dynamics.environment import Environment
from osc_contact.dynamics.rail import Body
from osc_contact.errors import InvalidInputError, OscContactError
from osc_contact.interface import Measurement, Reference
from osc_contact.spatial import Array, as_array

if TYPE_CHECKING:
    from osc_contact.control.compiled import CompiledTick

__all__ = ["Block", "Controller", "Gains", "Signals", "Status"]


@dataclass(frozen=True)
class Gains:
    """Gains of the two loops."""

    motion: MotionGains = field(default_factory=MotionGains)
    force: ForceGains = field(default_factory=ForceGains)


class Controller:
    """Dynamically decoupled force/motion control of one held object (fig. 4).

    Attributes:
        signals: every wire of the last tick. status, reason: how it ended.
        given_up: what motor limits cost in the last tick; None: nothing.
        lost_directions: in which motion commands were faded near a singular posture.
        engaged: whether the contacts are part of the model; False treats the object as free.
        f_tare: (6,) constant error of the wrist readings at O, removed from each.
        f_bias: (6,) constant wrench added to the command, learnt before contact.

    Gains, chain, pairs, bodies and B are taken at construction; to change them make another one.
    """

    def __init__(
        self,
        chain: ClosedChain,
        contacts: Sequence[ContactPair],
        gains: Gains | None = None,
        *,
        dt: float = 1e-3,
        B: Array | str = "object",
        bodies: Sequence[Body | None] | None = None,
        posture: Array | None = None,
        engaged: bool = True,
        compiled: bool = True,
        friction: Friction | None = None,
    ) -> None:
        """Assemble the loops.

        Args:
            chain: model of arms and object.
            contacts: pairs in the order of alpha_d.
            gains: of both loops.
            dt: control period (s).
            B: metric of the motion filter Ω_m(B), eq. 24: "object" (Λ_o⁻¹), "chain"
                ((ΣΛ_i + Λ_o)⁻¹ within the chain's motions) or a positive definite (6, 6).
            bodies: how the body at each contact answers forces; None: it does not, though it may
                be seen to move. The same object twice: both contacts are on one body.
            posture: (n,) where redundant arms return to (default: neutral).
            engaged: start in contact.
            compiled: run on the kernels, some hundred times faster; False: on the readable path
                below, which gives the same torques. The first controller ever made on a machine
                compiles them. Friction and grasps that move need the readable path.
            friction: what is believed of the contacts' friction; None: nothing.

        Raises:
            InvalidInputError: dt not positive, unknown metric, or an arm without a wrist sensor
                although there are contacts: their forces could not be measured.
        """
        require_sound(chain, contacts, dt, B, bodies, friction)
        gains = Gains() if gains is None else gains
        self.chain = chain
        self.friction = friction
        self.contacts = tuple(contacts)
        self.bodies = (None,) * len(self.contacts) if bodies is None else tuple(bodies)
        self.B = B
        self.engaged = engaged
        self.motion_law = MotionLaw(gains.motion, dt)
        self.force_law = ForceLaw(gains.force, dt)
        rest = np.zeros(chain.nq) if posture is None else np.asarray(posture, dtype=float)
        self.allocation = Allocation(chain, rest)
        self.limits = EffortLimits(chain, self.contacts)
        self.given_up: GivenUp | None = None
        self.lost_directions: tuple[LostDirection, ...] = ()
        self._tare, self._bias = np.zeros(6), np.zeros(6)
        self.signals = Signals()
        self._looked = True  # whether `signals` must be emptied by the next compiled tick
        self._by_twin = True  # whether the readable path computed the last tick
        self.status = Status.OK
        self._reason = ""
        self._last_tau: Array = np.zeros(chain.n_a)
        self._fast: CompiledTick | None = None
        if compiled and friction is None and all(g.is_rigid for g in chain.grasps):
            from osc_contact.control.compiled import CompiledTick

            self._fast = fast = CompiledTick(self)
            self._tare, self._bias, self._last_tau = fast.tare, fast.bias, fast.tau

    @property
    def reason(self) -> str:
        """Why `status` is not OK; empty if it is."""
        return self._reason or str(self.given_up or "; ".join(map(str, self.lost_directions)))

    @property
    def f_tare(self) -> Array:
        """(6,) constant error of the wrist readings at O (N, N m), removed from each."""
        return self._tare

    @f_tare.setter
    def f_tare(self, wrench: Array) -> None:
        self._tare[:] = as_array("f_tare", wrench, (6,))

    @property
    def f_bias(self) -> Array:
        """(6,) constant wrench added to the command at O (N, N m)."""
        return self._bias

    @f_bias.setter
    def f_bias(self, wrench: Array) -> None:
        self._bias[:] = as_array("f_bias", wrench, (6,))

    def tick(self, measurement: Measurement, reference: Reference) -> Array:
        """Motor torques (n_a,) for one control period.

        Never raises on bad data and never returns a torque that is not finite or exceeds a motor
        limit: a tick that cannot be computed repeats the last good torques, see `status`.
        """
        fast = self._fast
        if fast is not None and self.STAGES is _STAGES:
            code = fast(measurement, reference, self.engaged)
            if code != _ASK:
                if self._looked:
                    self._looked = self._by_twin = False
                    self.signals.__dict__.clear()
                    self.signals.__dict__["_fill"] = self._fill_signals
                self.status, self._reason, self.given_up = Status.OK, "", None
                self.lost_directions = ()
                if code == _SATURATED:
                    self._saturated()
                return self._last_tau.copy()
        return self._readable_tick(measurement, reference)

    def _readable_tick(self, measurement: Measurement, reference: Reference) -> Array:
        """The tick box by box; it also has the last word where the kernels have none."""
        s = Signals()
        before = (self.motion_law.integral, self.force_law.integral)
        try:
            self._take_in(measurement, reference, s)
            for stage in self.STAGES:
                stage(self, s)
            self._last_tau[:] = self._limited(s, *before)
            self._note_lost(s.state, before[0])
            self.signals.__dict__.clear()
            self.signals.__dict__.update(s.__dict__)
            self._looked = self._by_twin = True
        except (OscContactError, np.linalg.LinAlgError) as error:
            self._hold(error)
            self.motion_law.integral, self.force_law.integral = before
        return self._last_tau.copy()

    def _note_lost(self, state: ChainState, motion: Array) -> None:
        """Say which directions are fading; what is not commanded is not integrated."""
        self.lost_directions = () if self.restaged else lost_directions(state, self.chain)
        if self.lost_directions:
            self.motion_law.integral = motion
            if self.status is Status.OK:
                self.status = Status.DEGRADED

    def _saturated(self) -> None:
        """What the kernels want of the motors is too much."""
        assert self._fast is not None
        try:
            self.given_up = self._fast.relieve()
            self.status = Status.SATURATED
        except OscContactError as error:
            self._hold(error)

    def _hold(self, error: Exception) -> None:
        self.status, self._reason, self.given_up = Status.HELD, str(error), None

    def _fill_signals(self) -> None:
        """The wires of the last compiled tick, by the readable path."""
        assert self._fast is not None
        measurement, reference, then = self._fast.inputs()
        motion, force = self.motion_law, self.force_law
        now = (motion.integral, force.integral, self._tare, self._bias)
        how = (self.engaged, self.status, self._reason, self.given_up)
        s = Signals()
        try:
            motion.integral, force.integral = then.error_sum, then.force_sum
            self._tare, self._bias, self.engaged = then.tare, then.bias, then.engaged
            self._take_in(measurement, reference, s)
            for stage in self.STAGES:
                stage(self, s)
        finally:
            motion.integral, force.integral, self._tare, self._bias = now
            self.engaged, self.status, self._reason, self.given_up = how
        self.signals.__dict__.update(s.__dict__)
        self._looked = True

    def last_signals(self) -> Signals:
        """The wires of the last tick that could be computed.

        Raises:
            InvalidInputError: there was none yet.
        """
        if not hasattr(self.signals, "tau"):
            raise InvalidInputError(
                "no tick has been computed yet; call tick first"
                + (f" (the last one was held: {self.reason})" if self.reason else "")
            )
        return self.signals

    def last_torques(self) -> Array:
        """(n_a,) what the last tick gave out."""
        return self._last_tau.copy()

    def kernel_call(self, measurement: Measurement, reference: Reference) -> Callable[[], int]:
        """The kernel call of a tick by itself, to be timed; the state of the loops moves on."""
        if self._fast is None:
            raise InvalidInputError("this controller runs on the readable path: no kernel to call")
        return self._fast.bare_call(measurement, reference, self.engaged)

    def found(self) -> Found:
        """The numbers of the last computed tick that recordings keep.

        After a compiled tick they cost nothing, and are overwritten by the next one.

        Raises:
            InvalidInputError: there was no tick yet.
        """
        if self._fast is not None and not self._by_twin:
            return self._fast.found
        return Found.of(self.last_signals(), self)

    def joint_acceleration(self) -> Array:
        """(n,) q̈ = W η̇_c + w of all joints, as commanded by the last tick."""
        s = self.last_signals()
        return np.asarray(s.state.W @ s.eta_c + s.state.w)

    def residual_wrench(self) -> Array:
        """(6,) wrist reading of the last tick minus what the model predicts at rest, untared.

        Its mean over a moment at rest without contact is the tare: weight errors of object and
        grippers cannot be told from contact forces once contact is made. Store it in `f_tare`.
        """
        found = self.found()
        return found.f_meas + self.f_tare - found.bias_out

    def engage(self) -> None:
        """Take the contacts into the model, without a jump.

        What the motion integral has learnt in free space (weight errors, as a force) goes on as a
        constant wrench, in the contact directions too; the integrators start again from zero.
        """
        if self.engaged:
            return
        s = self.last_signals()
        learnt = self.motion_law.gains.integral * self.motion_law.integral
        force = s.state.Lambda @ object_coordinates(s.state, s.contact, learnt + s.state.sigma)
        H = s.state.S.T @ s.state.metric @ s.state.S
        self.f_bias = s.state.metric @ s.state.S @ np.linalg.solve(H, force)  # Sᵀf_bias = force
        self.motion_law.integral = np.zeros(6)
        self.force_law.integral = np.zeros(0)
        self.engaged = True

    # --- the boxes of fig. 4, in the order in which the signals meet them -----------------------

    @block("closed chain", "model", r"$\Lambda_S,\ \mu,\ p,\ S,\ \sigma,\ G$  (13)")
    def _model(self, s: Signals) -> None:
        s.state = self.chain.state(s.q, s.v)

    @block("contact geometry", "model", r"$N,\ T,\ n_\gamma$")
    def _contact(self, s: Signals) -> None:
        X_WO, V_O = s.state.X_WO, s.state.V_O
        pairs = self.contacts if self.engaged else ()
        touched = s.touched
        if touched is None:
            parts = [pair.contact(X_WO, V_O) for pair in pairs]
        else:
            moving = zip(pairs, touched.X_WE, touched.V_E, strict=False)
            parts = [pair.contact(X_WO, V_O, pin.SE3(X), V) for pair, X, V in moving]
        contact = Contact.stack(parts, np.linalg.inv(s.state.metric))
        s.parts, s.contact, s.drag = parts, contact, np.zeros_like(contact.N)
        if self.friction is not None:
            s.drag = self.friction.drags(pairs, X_WO, V_O, touched) @ contact.R.T

    @block("environment", "model", r"$\Phi_e,\ b_e,\ V_e$  (14)")
    def _environment(self, s: Signals) -> None:
        touched, parts = s.touched, s.parts
        if touched is None or not parts:
            s.environment = _AT_REST
            return
        O = s.state.X_WO.translation  # noqa: E741
        of_body: dict[Body, Environment] = {}  # contacts on one body share its environment
        answers = []
        for body, matrix, V, A in zip(
            self.bodies, touched.X_WE, touched.V_E, touched.A_E, strict=True
        ):
            if body is None:
                answers.append(Environment.moving(X_WE=pin.SE3(matrix), V_E=V, A_E=_STILL, O=O))
            else:
                if body not in of_body:
                    of_body[body] = body.environment(pin.SE3(matrix), V, A, O)
                answers.append(of_body[body])
        s.environment = Environment.combine(parts, answers, s.state.metric)

    @block("sum of wrist sensors", "force", r"$\Sigma$ at $O$")
    def _sense(self, s: Signals) -> None:
        s.f_meas = sum_of_wrenches(s.wrenches, s.state) - self.f_tare

    @block("force filter", "force", r"$\Omega_f(\Lambda_{out})$")
    def _force_filter(self, s: Signals) -> None:
        s.f_c_meas = contact_force(s.f_meas, s.state, s.contact, s.environment, s.drag)

    @block("generalised inverse", "force", r"$N^{\#}$")
    def _magnitudes(self, s: Signals) -> None:
        s.alpha_meas = magnitudes(s.f_c_meas, s.contact)

    @block("force law", "force", r"$\alpha_d + K_i\!\int(\alpha_d-\alpha_{meas})$")
    def _force_law(self, s: Signals) -> None:
        desired = independent(s.alpha_d, s.contact) if self.engaged else np.zeros(0)
        speed = s.contact.N.T @ (s.state.V_O - s.environment.V_e)
        s.alpha_u = self.force_law.command(desired, s.alpha_meas, speed)

    @block("to operational space", "force", r"$N\alpha_u$  (16)")
    def _operational_force(self, s: Signals) -> None:
        s.f_ccomm = (s.contact.N + s.drag) @ s.alpha_u

    @block("motion law", "motion", r"$\ddot x_d + K_d\dot e + K_p e + K_i\!\int\! e$")
    def _motion_law(self, s: Signals) -> None:
        Omega_m = s.contact.motion_projection(self._metric(s.state))
        s.a_u = self.motion_law.command(s.reference, s.state, Omega_m)

    @block("motion filter", "filter", r"$\Omega_m(B)$  (24)")
    def _motion_filter(self, s: Signals) -> None:
        eta_u = object_coordinates(s.state, s.contact, s.a_u)
        eta = filtered_motion(
            s.state, s.contact, eta_u, s.alpha_u, self._metric(s.state), s.environment
        )
        posture = self.allocation.retreat(s.q, s.v)
        s.eta_c = faded_motion(s.state, s.contact, self.chain, eta, posture)

    @block("dynamic control structure", "filter", r"$\Lambda_S\dot\eta_c+b_S+S^Tf_{ccomm}$  (21)")
    def _control_structure(self, s: Signals) -> None:
        s.f_S = generalised_force(s.state, s.eta_c, s.f_ccomm + self.f_bias)

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

    @property
    def restaged(self) -> bool:
        """Whether STAGES of this controller or its class were replaced.

        Only reading them one by one computes such a controller: a tick compiled from the stages
        above would not.
        """
        return self.STAGES is not Controller.STAGES

    # --- border --------------------------------------------------------------------------------

    def wiring(self, measurement: Measurement, reference: Reference) -> list[Block]:
        """The boxes with the signals each one really read and wrote, observed during one tick."""
        blocks = []
        wires = TracedSignals()
        before = (self.motion_law.integral, self.force_law.integral)
        self._take_in(measurement, reference, wires)
        for stage in self.STAGES:
            wires.begin()
            stage(self, wires)
            own: Block = stage.block  # type: ignore[attr-defined]
            blocks.append(Block(own.name, own.group, own.equation, *wires.seen()))
        self.motion_law.integral, self.force_law.integral = before
        return blocks

    def _take_in(self, measurement: Measurement, reference: Reference, s: Signals) -> None:
        self.status, self._reason, self.given_up = Status.OK, "", None
        take_in(measurement, reference, s, len(self.chain.arms), len(self.contacts))

    def _metric(self, state: ChainState) -> Array:
        if isinstance(self.B, str):
            if self.B == "object":
                return np.linalg.inv(state.metric)
            inertia = state.metric + sum(arm.Lambda for arm in state.arms)
            return np.asarray(np.linalg.inv(inertia))
        return self.B

    def _limited(self, s: Signals, motion: Array, force: Array) -> Array:
        """The torques, or those within the limits that lose least, which nobody integrates.

        Args:
            s: with `tau`. motion, force: the integrals before this tick.
        """
        if self.limits.kept(s.tau):
            return s.tau
        self.status, self.motion_law.integral = Status.SATURATED, motion
        if self.restaged:
            self.force_law.integral = force
            tau, self._reason = limited(s.tau, self.chain)
            return tau
        wanted = self.limits.response(s)
        relief = relieve(wanted)
        self.force_law.forgo(relief.force)
        lost = s.state.S @ relief.motion
        self.given_up = self.limits.given_up(wanted, relief, s.contact.R, lost)
        return relief.tau


_STAGES = Controller.STAGES  #: what the kernels compute; others are read box by box
_SATURATED, _ASK = 1, 2  #: the kernels' answer where the readable path must decide
_AT_REST = Environment.fixed()
_STILL = np.zeros(6)
