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

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from scipy.optimize import least_squares

import osc_contact as osc
from osc_contact.contacts.raibert_craig import as_raibert_craig
from osc_contact.control.controller import Controller
from osc_contact.control.signals import Signals
from osc_contact.dynamics.chain_state import ChainState
from osc_contact.lab.rig.rig import Rig
from osc_contact.spatial import Array, skew


def coordinates(state: ChainState, W: Array) -> Array:
    """P_W (d, 6), see above; W (6, 0) gives P_∅, the nearest motion in the object's metric."""
    SM = state.S.T @ state.metric
    H = SM @ state.S
    P = np.linalg.solve(H, SM)
    W_S = state.S.T @ W
    lift = np.linalg.solve(H, W_S)
    return P + lift @ np.linalg.solve(W_S.T @ lift, W.T - W_S.T @ P)


def selected_before(state: ChainState, selection: Selection) -> tuple[Array, Array]:
    """η̇ = X a − Y σ with X = P_W Ω, Y = P_W: F = ΛΩa + Ω̄f + μ + p."""
    Y = coordinates(state, selection.wrenches)
    return Y @ selection.motion, Y


def selected_before_and_after(state: ChainState, selection: Selection) -> tuple[Array, Array]:
    """Matrices X (d, 6), Y (d, 6) of the law F = ΩᵀΛΩa + Ω̄f + μ + p, which selects twice.

    η̇ = X a − Y σ with X = Λ_S⁻¹SᵀΩᵀP_∅ᵀΛ_S P_W Ω, and Y as of `selected_before`.
    """
    X, Y = selected_before(state, selection)
    again = state.S.T @ selection.motion.T @ coordinates(state, np.zeros((6, 0))).T
    return np.linalg.solve(state.Lambda_S, again @ state.Lambda_S @ X), Y


def structure(state: ChainState, eta_dot: Array, f: Array) -> Array:
    """(d,) Λ_S η̇ + b_S + Sᵀf, the equation of motion that all of them cancel.

    Args:
        state: state of the closed chain.
        eta_dot: (d,) commanded acceleration, in the coordinates of S.
        f: (6,) commanded contact wrench at O (N, N m).
    """
    return state.Lambda_S @ eta_dot + state.b_S + state.S.T @ f


class Baseline(NamedTuple):
    """A family of selection laws; publications and software: docs/baselines.md.

    Attributes:
        label: name in figures and tables.
        rule: (state, selection) → X, Y with η̇ = X a − Y σ.
        triads: 1: forces and couples are selected on the axes of one frame; 2: each on its own.
    """

    label: str
    rule: Callable[[ChainState, Selection], tuple[Array, Array]]
    triads: int


BASELINES: dict[str, Baseline] = {
    "khatib": Baseline("Khatib, Newton, SAI", selected_before, 2),
    "isaac_lab": Baseline("Isaac Lab", selected_before_and_after, 1),
}


@dataclass(frozen=True)
class SelectionLaw:
    """A baseline with its selection, which moves with the object but keeps its axes."""

    baseline: Baseline
    selection: Selection

    @property
    def label(self) -> str:
        """Name in figures and tables."""
        return self.baseline.label

    def eta(self, state: ChainState, a: Array) -> Array:
        """Commanded η̇ (d,) of an unfiltered object acceleration a (6,)."""
        X, Y = self.baseline.rule(state, self.selection)
        return X @ a - Y @ state.sigma

    def install(self, controller: Controller) -> Controller:
        """Put this law in the place of our filter and control structure; the rest stays."""

        def command_structure(s: Signals) -> tuple[Array, Array]:
            eta = self.eta(s.state, s.a_u)
            f = self.selection.force @ s.f_ccomm
            return eta, structure(s.state, eta, f + controller.f_bias)

        return controller.with_laws(structure=command_structure)


@dataclass(frozen=True)
class Ours:
    """Motion filter and dynamic control structure, eqs. 21 to 25, from the contact's N alone."""

    label = "ours"

    def install(self, controller: Controller) -> Controller:
        """Nothing to do: a controller is born with this law."""
        return controller


Law = Ours | SelectionLaw


# --- What a selection matrix can say of a contact: axes, a point, and flags ---


@dataclass(frozen=True)
class Selection:
    """Force-controlled axes through one point p.

    With F the selected force directions and C the selected couple axes, in 6-vectors at p

        Ω̄ = diag(FFᵀ, CCᵀ),   Ω = 1 − Ω̄

    are Khatib's generalised task specification matrices. As projectors at p they are meant, for
    this is what the laws say; `force` and `motion` are the same carried to O.

    Attributes:
        point: (3,) where the forces act, from O in world axes (m).
        forces, couples: (3, ·) unit axes along which forces, about which couples are selected.
    """

    point: Array
    forces: Array
    couples: Array

    @classmethod
    def of_axes(cls, point: Array, triads: Sequence[Array], chosen: Sequence[int]) -> Selection:
        """Some of six axes: 0, 1, 2 of forces, 3, 4, 5 of couples.

        Args:
            point: as the attribute.
            triads: (3, 3) axes, of forces first and of couples last; one constraint frame for both
                is the Raibert–Craig model.
            chosen: the axes that are force controlled.
        """
        forces, couples = ([i % 3 for i in chosen if i // 3 == kind] for kind in (0, 1))
        return cls(point, triads[0][:, forces], triads[-1][:, couples])

    @cached_property
    def wrenches(self) -> Array:
        """W (6, r): unit forces and couples that are force controlled, at O."""
        arms = skew(self.point) @ self.forces
        return np.block([[self.forces, 0.0 * self.couples], [arms, self.couples]])

    def as_dict(self) -> dict[str, Any]:
        """JSON-able: point (m) and axes."""
        return {
            "point_m": self.point.tolist(),
            "force_axes": self.forces.T.tolist(),
            "couple_axes": self.couples.T.tolist(),
        }

    @cached_property
    def force(self) -> Array:
        """Ω̄ (6, 6) at O: the selected part of a wrench."""
        arms = skew(self.point) @ self.couples
        return self.wrenches @ np.block([[self.forces, arms], [0.0 * self.forces, self.couples]]).T

    @cached_property
    def motion(self) -> Array:
        """Ω (6, 6) at O: the part of an acceleration left to motion control, WᵀΩ = 0."""
        return np.eye(6) - self.force.T


# --- What a law does at one instant: cross-talk between force and motion, from eqs. 17 and 18 ---


_LEAST_GAIN = 0.1


class Coupling(NamedTuple):
    """The answer of a law to unit commands.

    Attributes:
        M: (r, r) N per N.
        K: (n, n) m/s² per m/s².
        G_f: (n, r) m/s² per N.
        G_m: (r, n) N per m/s².
        inertia: m, kg.
    """

    M: Array
    K: Array
    G_f: Array
    G_m: Array
    inertia: float

    @property
    def usable(self) -> bool:
        """True if feedback can compensate M and K: real parts of eigenvalues ≥ `_LEAST_GAIN`."""
        gains = [np.linalg.eigvals(X).real.min(initial=1.0) for X in (self.M, self.K)]
        return bool(min(gains) >= _LEAST_GAIN)

    @property
    def force_to_motion(self) -> Array:
        """(n, r) m G_f M⁻¹: acceleration along the free motions per achieved force."""
        return self.inertia * np.linalg.solve(self.M.T, self.G_f.T).T

    @property
    def motion_to_force(self) -> Array:
        """(r, n) G_m K⁻¹/m: contact force per achieved acceleration."""
        return np.linalg.solve(self.K.T, self.G_m.T).T / self.inertia

    @property
    def norms(self) -> tuple[float, float]:
        """Largest gain of `force_to_motion` and of `motion_to_force`."""
        parts = (self.force_to_motion, self.motion_to_force)
        f, m = (float(np.linalg.norm(x, 2)) if x.size else 0.0 for x in parts)
        return f, m

    @property
    def residuals(self) -> Array:
        """Both kinds of cross-talk in one vector, dimensionless."""
        return np.concatenate((self.force_to_motion.ravel(), self.motion_to_force.ravel()))

    @property
    def cost(self) -> float:
        """Root of the sum of squares of `residuals`; infinite where control would be lost."""
        return float(np.linalg.norm(self.residuals)) if self.usable else np.inf


class Instant:
    """Chain and contact at one instant, and what a force f_S does there.

    Attributes:
        state, contact: chain state and contact at this instant.
        size: largest radius of gyration of the object (m).
        free: (6, n) free motions, orthonormal with angles counted in `size`: the principal ones of
            the chain's inertia, lightest first.
        along: (n, 6) coordinates of a motion that is free.
        inertia: mean inertia of the free motions (kg).
    """

    def __init__(self, state: ChainState, contact: osc.Contact) -> None:
        self.state = state
        self.contact = contact
        self.size = _radius_of_gyration(state.metric)
        scale = np.repeat([1.0, self.size], 3)
        N_S = state.S.T @ contact.N
        null = np.linalg.svd(N_S.T, full_matrices=True)[2][contact.r :].T
        Q = np.linalg.qr(scale[:, None] * (state.S @ null))[0]
        e = np.linalg.lstsq(state.S, Q / scale[:, None], rcond=None)[0]
        inertias, principal = np.linalg.eigh(e.T @ state.Lambda_S @ e)
        Q = Q @ (principal * np.sign(principal.sum(axis=0)))
        self.free: Array = Q / scale[:, None]
        self.along: Array = Q.T * scale
        self.inertia = float(inertias.mean()) if len(inertias) else 1.0
        base = osc.contact_response(state, contact, f_S=state.b_S)
        unit = [osc.contact_response(state, contact, f_S=state.b_S + e) for e in np.eye(state.d)]
        self._alpha: Array = np.column_stack([x.alpha - base.alpha for x in unit])
        a = np.column_stack([x.acceleration - base.acceleration for x in unit])
        self._motion: Array = self.along @ a

    def coupling(self, law: SelectionLaw) -> Coupling:
        """Unit commands through the law and through `contact_response`."""
        state = self.state
        X, _ = law.baseline.rule(state, law.selection)
        of_a = state.Lambda_S @ X @ self.free
        of_alpha = state.S.T @ law.selection.force @ self.contact.N
        return Coupling(
            M=self._alpha @ of_alpha,
            K=self._motion @ of_a,
            G_f=self._motion @ of_alpha,
            G_m=self._alpha @ of_a,
            inertia=self.inertia,
        )


def _radius_of_gyration(inertia: Array) -> float:
    """Largest radius of gyration of a body about its centre of mass (m).

    Args:
        inertia: (6, 6) inertia of the body.
    """
    mass = inertia[0, 0]
    lever = inertia[3:, :3] / mass  # [c]×
    about_centre = inertia[3:, 3:] + mass * lever @ lever
    return float(np.sqrt(np.linalg.eigvalsh(about_centre)[-1] / mass))


# --- The best constraint frame each selection law can be given, by the cross-talk it predicts ---


def best_selection(
    instant: Instant, baseline: Baseline, *, restarts: int = 4, seed: int = 0
) -> SelectionLaw:
    """The law with the selection of least cost.

    Args:
        instant, baseline, restarts, seed: see `best_frames`.

    Raises:
        ContactError: with no selection does the law keep control of forces and motions.
    """
    found = best_frames(instant, baseline, restarts=restarts, seed=seed)
    return min(found, key=lambda law: instant.coupling(law).cost)


def selection_of(rig: Rig, restarts: int = 4) -> dict[str, Any]:
    """The best selection of Khatib's law at the start of a rig, as `Selection.as_dict`.

    Args:
        rig: see `build_rig`.
        restarts: see `best_frames`.

    Raises:
        ContactError: with no selection does the law keep control of forces and motions.
    """
    instant = Instant(rig.state, rig.contact)
    return best_selection(instant, BASELINES["khatib"], restarts=restarts).selection.as_dict()


def best_frames(
    instant: Instant, baseline: Baseline, *, restarts: int = 4, seed: int = 0
) -> list[SelectionLaw]:
    """Find the law of least cost for each selection of r out of six axes that keeps control.

    Args:
        instant: for which it is optimal.
        baseline: family of laws.
        restarts: random starts for each selection of axes, besides that of `as_raibert_craig`.
        seed: seed of the random starts.

    Raises:
        ContactError: there is none.
    """
    rng = np.random.default_rng(seed)
    start = as_raibert_craig(instant.contact.N, instant.size).frame
    best = []
    for chosen in combinations(range(6), instant.contact.r):
        first = Selection.of_axes(start.translation, [start.rotation], chosen)
        others = [random_selection(instant, baseline, rng, chosen) for _ in range(restarts)]
        found = [_descend(instant, SelectionLaw(baseline, one)) for one in (first, *others)]
        law, cost = min(found, key=lambda one: one[1])
        if np.isfinite(cost):
            best.append(law)
    if not best:
        raise osc.ContactError("no constraint frame keeps control of all forces and motions")
    return best


def random_selection(
    instant: Instant, baseline: Baseline, rng: np.random.Generator, chosen: Sequence[int]
) -> Selection:
    """A frame anywhere on the object: uniform axes, a point within twice its size of O.

    Args:
        instant: the state, for the object's size.
        baseline: how many triads the frame has.
        rng: source of the random numbers.
        chosen: the axes that are force controlled, see `Selection.of_axes`.
    """
    drawn = (rng.normal(size=4) for _ in range(baseline.triads))
    triads = [pin.Quaternion(*(x / np.linalg.norm(x))).matrix() for x in drawn]
    return Selection.of_axes(rng.uniform(-2.0, 2.0, 3) * instant.size, triads, chosen)


def _descend(instant: Instant, law: SelectionLaw) -> tuple[SelectionLaw, float]:
    """The law where |x|² (1 + w²|y|²) is least, and half that; infinite where control is lost.

    x is the cross-talk, y = (M − 1, K − 1, p/size). Many minima of |x| are whole lines and planes
    of points and axes, some infinitely far away. w = 1e-3 leaves isolated ones, which rounding
    does not move, and moves those that are isolated anyway by less than three digits show.
    """
    if not instant.coupling(law).usable:
        return law, np.inf

    def residuals(step: Array) -> Array:
        moved = _moved(law, step, instant.size)
        at = instant.coupling(moved)
        x = at.residuals
        gains = [(X - np.eye(len(X))).ravel() for X in (at.M, at.K)]
        y = np.concatenate((*gains, moved.selection.point / instant.size))
        return np.concatenate((x, 1e-3 * np.linalg.norm(x) * y))

    still = np.zeros(3 + 3 * law.baseline.triads)
    found = least_squares(
        residuals, still, "3-point", ftol=1e-15, xtol=1e-9, gtol=1e-12, max_nfev=100
    )
    best = _moved(law, found.x, instant.size)
    return best, float(found.cost) if instant.coupling(best).usable else np.inf


def _moved(law: SelectionLaw, step: Array, size: float) -> SelectionLaw:
    """The point moved by step[:3] sizes, the triads turned by step[3:6] and by its last three."""
    old = law.selection
    forces = pin.exp3(step[3:6]) @ old.forces
    couples = pin.exp3(step[-3:]) @ old.couples
    return replace(law, selection=Selection(old.point + size * step[:3], forces, couples))
