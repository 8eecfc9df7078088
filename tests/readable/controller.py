"""The law of fig. 4 box by box in plain NumPy: what `osc_contact.law` is held to."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from osc_contact.contacts.pairs import ContactPair
from osc_contact.control.friction import Friction
from osc_contact.control.gains import Gains
from osc_contact.control.reports import LimitLoss, LostDirection, Status
from osc_contact.control.signals import Block
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.rail import Body
from osc_contact.errors import InvalidInputError, OscContactError
from osc_contact.interface import Measurement, Reference
from osc_contact.spatial import Array, as_array
from readable.allocation import Allocation
from readable.boxes import Boxes
from readable.contact_phases import hand_over, live
from readable.effort_limits import EffortLimits
from readable.force import (
    ContactTerms,
    ForceLaw,
)
from readable.motion import MotionLaw
from readable.phases import ContactPhases, slewed
from readable.signals import Signals, TracedSignals, observed
from readable.singular import note_lost
from readable.tick_result import Found
from readable.validation import require_sound, take_in
from readable.within_limits import within_limits

__all__ = ["ReadableController"]


class ReadableController(Boxes):
    """Dynamically decoupled force/motion control of one held object (fig. 4).

    Attributes:
        signals: every signal of the last tick. status, reason: how it ended.
        given_up: what motor limits cost in the last tick; None: nothing.
        lost_directions: in which motion commands were faded near a singular posture.
        engaged: whether the contacts are part of the model; False treats the object as free.
        terms: on what terms each contact takes part. life: what sets them; None: all contacts are
            closed as long as they are engaged. ticked: whether life has a tick to judge.
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
        friction: Friction | None = None,
        reading: str = "filter",
        life: ContactPhases | None = None,
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
            friction: what is believed of the contacts' friction; None: nothing.
            reading: 'filter' or 'least_squares'.
            life: opens, approaches and closes the contacts one by one.

        Raises:
            InvalidInputError: dt not positive, unknown metric, or an arm without a wrist sensor
                although there are contacts: their forces could not be measured.
        """
        require_sound(chain, contacts, dt, B, bodies, friction)
        gains = Gains() if gains is None else gains
        self.chain = chain
        self.contacts = tuple(contacts)
        self.bodies = (None,) * len(self.contacts) if bodies is None else tuple(bodies)
        self.B = B
        self.motion_law = MotionLaw(gains.motion, dt)
        self.force_law = ForceLaw(gains.force, dt)
        rest = np.zeros(chain.nq) if posture is None else np.asarray(posture, dtype=float)
        self.allocation = Allocation(chain, rest)
        self.limits = EffortLimits(chain, self.contacts)
        self.given_up: LimitLoss | None = None
        self.lost_directions: tuple[LostDirection, ...] = ()
        self._tare, self._bias = np.zeros(6), np.zeros(6)
        self.friction, self.life, self.reading = friction, life, reading
        self.more_friction = self._more_friction = 0.0
        self.terms = ContactTerms(np.zeros((len(self.contacts), 5)), gains.force)
        self.signals = Signals()
        self.status, self._reason = Status.OK, ""
        self._last_tau: Array = np.zeros(chain.n_a)
        self.engaged, self.ticked = engaged, False
        self._fresh, self._speed = False, np.zeros(0)
        self._late = np.zeros((2, 0 if life is None else len(life.columns.owners)))

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

    @property
    def engaged(self) -> bool:
        """Whether the contacts are part of the model; False: the object counts as free."""
        return self._engaged

    @engaged.setter
    def engaged(self, engaged: bool) -> None:
        self._engaged = engaged
        if self.life is None or not engaged:
            self.terms.rows[:, 0] = engaged

    def tick(self, measurement: Measurement, reference: Reference) -> Array:
        """Motor torques (n_a,) for one control period.

        Never raises on bad data, never returns a torque that is not finite or exceeds a limit: a
        tick that cannot be computed repeats the last good torques, see `status`.
        """
        if self.life is None:
            return self._computed(measurement, reference)
        last = self._last_tau.copy()
        tau = self._computed(measurement, live(self, self.life, reference))
        if self.ticked and self.status is not Status.HELD:
            gentle = (self.life.state.since < 0.1).any()
            rate = self.life.settings.torque_rate if gentle else np.inf
            share = np.abs(measurement.v) / self.chain.model.velocityLimit
            share = share[self.chain.actuated].max()
            rate = rate / min((1.0 - share) / 0.75, 1.0) ** 2 if share < 1.0 else np.inf
            step = rate * self.force_law.dt * self.chain.tau_max
            self._last_tau[:] = tau = slewed(tau, last, step)
        self.ticked |= self.status is not Status.HELD
        return tau

    def _computed(self, measurement: Measurement, reference: Reference) -> Array:
        return self._readable_tick(measurement, reference)

    def _readable_tick(self, measurement: Measurement, reference: Reference) -> Array:
        """The tick box by box; it also has the last word where the kernels have none."""
        s, before = Signals(), (self.motion_law.integral, self.force_law.integral)
        try:
            self._take_in(measurement, reference, s)
            for stage in self.STAGES:
                stage(self, s)
            self._last_tau[:] = within_limits(self, s, *before)
            note_lost(self, s.state, before[0])
            self.more_friction = self._more_friction
            self.signals.__dict__.clear()
            self.signals.__dict__.update(s.__dict__)
        except (OscContactError, np.linalg.LinAlgError) as error:
            self._hold(error)
            self.motion_law.integral, self.force_law.integral = before
        return self._last_tau.copy()

    def _hold(self, error: Exception) -> None:
        self.status, self._reason, self.given_up = Status.HELD, str(error), None

    def last_signals(self) -> Signals:
        """The signals of the last tick that could be computed.

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

    def result(self) -> Found:
        """The numbers of the last computed tick that recordings keep.

        Raises:
            InvalidInputError: there was no tick yet.
        """
        return Found.of(self.last_signals(), self)

    def joint_acceleration(self) -> Array:
        """(n,) q̈ = W η̇_c + w of all joints, as commanded by the last tick."""
        s = self.last_signals()
        return np.asarray(s.state.W @ s.eta_c + s.state.w)

    def residual_wrench(self) -> Array:
        """(6,) wrist reading of the last tick minus what the model predicts at rest, untared.

        Its mean at rest without contact is the tare, to be stored in `f_tare`: weight errors
        cannot be told from contact forces once contact is made.
        """
        found = self.result()
        return found.f_meas + self.f_tare - found.bias_out

    def engage(self) -> None:
        """Take the contacts into the model, without a jump.

        What the motion integral has learnt in free space (weight errors, as a force) goes on as a
        constant wrench, in the contact directions too; the integrators start again from zero.
        """
        if not self.engaged:
            hand_over(self)
            self.force_law.integral = np.zeros(0)
            self.engaged = True

    @property
    def restaged(self) -> bool:
        """Whether STAGES were replaced: then only reading them one by one computes the tick."""
        return self.STAGES is not ReadableController.STAGES

    # --- border --------------------------------------------------------------------------------

    def wiring(self, measurement: Measurement, reference: Reference) -> list[Block]:
        """The boxes with the signals each one really read and wrote, observed during one tick."""
        before = (self.motion_law.integral, self.force_law.integral)
        signals = TracedSignals()
        self._take_in(measurement, reference, signals)
        blocks = observed(self, self.STAGES, signals)
        self.motion_law.integral, self.force_law.integral = before
        return blocks

    def _take_in(self, measurement: Measurement, reference: Reference, s: Signals) -> None:
        self._fresh = self.status is not Status.HELD and hasattr(self.signals, "state")
        self.status, self._reason, self.given_up = Status.OK, "", None
        take_in(measurement, reference, s, len(self.chain.arms), len(self.contacts))
