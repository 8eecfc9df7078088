"""Selection laws as their authors wrote them, beside ours: all that differs is how commands
become the object force f_S.

Ω̄ selects wrenches and Ω accelerations (`Selection`). For six motions the laws are, at O,

    selected before Λ        F = Λ Ω a + Ω̄ f + μ + p       Khatib 1987, Newton, SAI
    selected before and after   F = Ωᵀ Λ Ω a + Ω̄ f + μ + p      Isaac Lab

What is not selection is the same for all of them and exact: the closed chain's Λ_S and b_S with
gravity and velocity terms, force sensing, gains, references, torque allocation. f = Nα_u, so that
Ω̄N∫(α_d − α_meas) is integral feedback on the selected components of the measured wrench.

The chain need not move in all six directions. A selected acceleration x is then taken into its
motions S the way ours is, with the law's own selected wrenches W in the place of N,

    P_W x = argmin_e (x − S e)ᵀΛ_o(x − S e)   subject to   WᵀS e = Wᵀx,

so that rounding x to what the chain can do spoils nothing the law has put into it, and a force of
the chain is selected as the wrench P_∅ᵀΛ_S η̇ that gives it. For d = 6 both are S⁻¹.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from osc_contact.contacts.contact import Contact
from osc_contact.control.command_filter import command
from osc_contact.control.controller import Controller
from osc_contact.control.signals import Signals
from osc_contact.control.tick_records import TickRecords
from osc_contact.dynamics.closed_chain import ChainState
from osc_contact.law.frames import wrenches
from osc_contact.paper.baselines.selection import Selection
from osc_contact.spatial import Array

__all__ = ["BASELINES", "Baseline", "Law", "Ours", "SelectionLaw"]


def coordinates(state: ChainState | _Motions, W: Array) -> Array:
    """P_W (d, 6), see above; W (6, 0) gives P_∅, the nearest motion in the object's metric."""
    SM = state.S.T @ state.metric
    H = SM @ state.S
    P = np.linalg.solve(H, SM)
    if W.shape[1] == 0:
        return P
    W_S = state.S.T @ W
    lift = np.linalg.solve(H, W_S)
    return np.asarray(P + lift @ np.linalg.solve(W_S.T @ lift, W.T - W_S.T @ P))


def selected_before(state: ChainState | _Motions, selection: Selection) -> tuple[Array, Array]:
    """η̇ = X a − Y σ with X = P_W Ω, Y = P_W: F = ΛΩa + Ω̄f + μ + p."""
    Y = coordinates(state, selection.wrenches)
    return Y @ selection.motion, Y


def selected_before_and_after(
    state: ChainState | _Motions, selection: Selection
) -> tuple[Array, Array]:
    """The same with X = Λ_S⁻¹SᵀΩᵀP_∅ᵀΛ_S P_W Ω: F = ΩᵀΛΩa + Ω̄f + μ + p."""
    X, Y = selected_before(state, selection)
    again = state.S.T @ selection.motion.T @ coordinates(state, np.zeros((6, 0))).T
    return np.linalg.solve(state.Lambda_S, again @ state.Lambda_S @ X), Y


def structure(state: ChainState | _Motions, eta_dot: Array, f: Array) -> Array:
    """(d,) Λ_S η̇ + b_S + Sᵀf, the equation of motion that all of them cancel.

    Args:
        state: of the closed chain.
        eta_dot: (d,) commanded acceleration, in the coordinates of S.
        f: (6,) commanded contact wrench at O (N, N m).
    """
    return np.asarray(state.Lambda_S @ eta_dot + state.b_S + state.S.T @ f)


@dataclass(frozen=True)
class Baseline:
    """A family of selection laws.

    Attributes:
        label: what figures and tables call it.
        rule: (state, selection) → X, Y with η̇ = X a − Y σ.
        triads: 1: forces and couples are selected on the axes of one frame; 2: each on its own.
        equation: the law in words of `laws`.
        source: where it was published or is in use, and what differs there.
    """

    label: str
    rule: Callable[[ChainState | _Motions, Selection], tuple[Array, Array]]
    triads: int
    equation: str
    source: str


BASELINES: dict[str, Baseline] = {
    "khatib": Baseline(
        "Khatib, Newton, SAI",
        selected_before,
        2,
        "F = ΛΩa + Ω̄f + μ + p",
        "Khatib 1987, IEEE J. Robotics and Automation 3(1): Ω from a force triad S_F and a couple "
        "triad S_M. NVIDIA Newton, ControllerOperationalSpaceModelFree: the same Ω before Λ, "
        "proportional force feedback, no velocity terms. Stanford sai-primitives, "
        "MotionForceTask: the same from two projectors σ_force and σ_moment of any axis",
    ),
    "isaac_lab": Baseline(
        "Isaac Lab",
        selected_before_and_after,
        1,
        "F = ΩᵀΛΩa + Ω̄f + μ + p",
        "Isaac Lab 2, isaaclab/controllers/operational_space.py: the gains are selected "
        "and so is the force Λa they give, all on the axes of one task frame; there at the tool "
        "point and without velocity terms",
    ),
}


@dataclass(frozen=True)
class SelectionLaw:
    """A baseline with its selection, which moves with the object but keeps its axes."""

    baseline: Baseline
    selection: Selection

    def eta(self, state: ChainState | _Motions, a: Array) -> Array:
        """Commanded η̇ (d,) of an unfiltered object acceleration a (6,)."""
        X, Y = self.baseline.rule(state, self.selection)
        return np.asarray(X @ a - Y @ state.sigma)

    def f_S(self, state: ChainState | _Motions, contact: Contact, a: Array, alpha: Array) -> Array:
        """Object force (d,) for a motion command a (6,) and a force command α (r,).

        Args:
            state: of the closed chain.
            contact: the contacts in force.
            a: (6,) commanded spatial acceleration at O.
            alpha: (r,) commanded contact forces (N).
        """
        f = self.selection.force @ (contact.N @ alpha)
        return structure(state, self.eta(state, a), f)

    def install(self, controller: Controller) -> Controller:
        """Put this law in the place of our filter and control structure; the rest stays."""
        return controller.with_laws(structure=_Select(self, controller.f_bias))


@dataclass(frozen=True)
class _Motions:
    """What the laws take of a `ChainState`, from a tick's records."""

    S: Array
    metric: Array
    Lambda_S: Array
    b_S: Array
    sigma: Array

    @classmethod
    def of(cls, rows: TickRecords) -> _Motions:
        work, turn, motion = rows.work, rows.reflection(), rows.motions()
        m, held = int(work["locked"]), float(rows.row.head["held"] != 0)
        Lambda, sigma = work["Lambda"], work["sigma"][:m]
        wrench = wrenches(work)
        return cls(
            S=motion @ turn[m:].T,
            metric=wrench @ wrench.T,
            Lambda_S=Lambda[m:, m:] + held * np.eye(6 - m),
            b_S=work["chain_bias"][m:] + Lambda[m:, :m] @ sigma,
            sigma=motion @ (turn[:m].T @ sigma),
        )


@dataclass(frozen=True)
class _Select:
    """A selection law in a controller; f_bias: of its wrists."""

    law: SelectionLaw
    f_bias: Array

    def __call__(self, s: Signals) -> tuple[Array, Array]:
        """(η̇_c, f_S) of a tick's signals."""
        return self._command(s.state, s.a_u, s.f_ccomm)

    def fill(self, rows: TickRecords) -> None:
        """The same into a tick's records."""
        work, r = rows.work, int(rows.work["rank"])
        m, kept = int(work["locked"]), rows.kept()
        f = (rows.columns["N"][kept] + work["friction_wrenches"][:r]).T @ work["alpha_u"][:r]
        work["x"][m:], work["f_S"][m:] = self._command(_Motions.of(rows), work["a_u"], f)
        work["x"][:m], work["f_S"][:m] = work["sigma"][:m], 0.0

    def _command(self, state: ChainState | _Motions, a: Array, f: Array) -> tuple[Array, Array]:
        eta = self.law.eta(state, a)
        return eta, structure(state, eta, self.law.selection.force @ f + self.f_bias)


@dataclass(frozen=True)
class Ours:
    """Motion filter and dynamic control structure, eqs. 21 to 25, from the contact's N alone."""

    def f_S(self, state: ChainState, contact: Contact, a: Array, alpha: Array) -> Array:
        """Object force (d,) for a motion command a (6,) and a force command α (r,).

        Args:
            state, contact, a, alpha: as of `SelectionLaw.f_S`.
        """
        return command(state, contact, a, alpha)[1]

    def install(self, controller: Controller) -> Controller:
        """Nothing to do: a controller is born with this law."""
        return controller


Law = Ours | SelectionLaw
