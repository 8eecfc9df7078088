"""Force control in the N space: the blocks of fig. 5."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from osc_contact.contacts.contact import Contact
from osc_contact.control.force import ForceGains
from osc_contact.dynamics.closed_chain import ChainState
from osc_contact.dynamics.environment import Environment
from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array, carry_wrench

__all__ = [
    "ContactTerms",
    "ForceLaw",
    "contact_force",
    "magnitudes",
    "outboard_mobility",
    "sum_of_wrenches",
]


def sum_of_wrenches(wrenches: Array, state: ChainState) -> Array:
    """f_meas (6,): all wrist readings (arms, 6) turned to world axes and carried to O.

    Of a gripper that can move without the object, `state.filters` first takes out its own motion.
    """
    total = np.zeros(6)
    for reading, X_WS, F in zip(wrenches, state.sensors, state.filters, strict=True):
        if X_WS is not None:
            R = X_WS.rotation
            world = np.concatenate((R @ reading[:3], R @ reading[3:]))
            at_O = carry_wrench(world, X_WS.translation, state.X_WO.translation)
            total += at_O if F is None else F @ at_O
    return total


def contact_force(
    f_meas: Array,
    state: ChainState,
    contact: Contact,
    environment: Environment,
    friction_wrenches: Array | float = 0.0,
) -> Array:
    """The contact force f_c (6,) inside a wrist reading: the filter Ω_f(Λ_out) of fig. 5.

    The sensors read Λ_out a + bias_out + f_c. The contact knows Nᵀa_rel = n_γ, which takes the
    place of accelerometers:

        f_c = N (Nᵀ(Λ_out⁻¹ + Φ_e)N)⁻¹ [NᵀΛ_out⁻¹(f_meas − bias_out) − n_γ − Nᵀb_e]

    With Φ_e = 0 this is Ω_f(Λ_out) and an offset. Λ_out is the object's inertia Λ_o of the paper
    plus the gripper parts outboard of the sensors. Contacts that slide push N_μα,
    N_μ = N + friction_wrenches: the right N of the solve becomes N_μ, and what is returned is the
    normal part Nα.

    Args:
        f_meas: (6,) sum of the wrist readings at O.
        friction_wrenches: (6, r) from `Friction.wrenches`, or none.
        state, contact, environment: at this instant.
    """
    N = contact.N
    if state.d < 6 and not state.payload.Lambda.any():
        return _of_the_tip(f_meas, state, contact, environment, friction_wrenches)
    D, Phi_N = outboard_mobility(state, contact, environment, friction_wrenches)
    seen = Phi_N.T @ (f_meas - state.bias_out) - contact.n_gamma - N.T @ environment.b_e
    return N @ np.linalg.solve(D, seen)


def outboard_mobility(
    state: ChainState,
    contact: Contact,
    environment: Environment,
    friction_wrenches: Array | float = 0.0,
) -> tuple[Array, Array]:
    """D = Nᵀ(Λ_out⁻¹ + Φ_e)N_μ (r, r) and Λ_out⁻ᵀN (6, r); arguments as in `contact_force`."""
    N = contact.N
    Phi_N = np.linalg.solve(state.Lambda_out.T, N)
    return Phi_N.T @ (N + friction_wrenches) + environment.yielding(N, friction_wrenches), Phi_N


def _of_the_tip(
    f_meas: Array,
    state: ChainState,
    contact: Contact,
    environment: Environment,
    friction_wrenches: Array | float,
) -> Array:
    """The same where nothing is held and the tip cannot make every motion: Λ_out is singular.

    Sensors see the tip in its motions S only: S(SᵀΛ_outS)⁻¹Sᵀ and σ take the place of Λ_out⁻¹.
    """
    N, S = contact.N, state.S
    f = f_meas - state.bias_out - state.Lambda_out @ state.sigma
    if not state.Lambda_out.any():  # nothing beyond the sensors: they read f_c itself
        Phi_N = np.linalg.solve(state.metric, N)
        return N @ np.linalg.solve(Phi_N.T @ (N + friction_wrenches), Phi_N.T @ f)
    Phi_out = S @ np.linalg.solve(S.T @ state.Lambda_out @ S, S.T)
    D = N.T @ Phi_out @ (N + friction_wrenches) + environment.yielding(N, friction_wrenches)
    seen = N.T @ (Phi_out @ f + state.sigma - environment.b_e) - contact.n_gamma
    return N @ np.linalg.solve(D, seen)


def magnitudes(f_c: Array, contact: Contact) -> Array:
    """α (r,) with N α = f_c, by a generalised inverse of N.

    f_c lies in range(N), so every generalised inverse gives the same α (paper, fig. 5).
    """
    scale = np.abs(contact.N).max(axis=0, initial=0.0)
    N = contact.N / scale
    return np.asarray(np.linalg.lstsq(N, f_c, rcond=None)[0] / scale)


class ContactTerms:
    """On what terms each contact takes part in a tick; the compiled tick reads the same rows.

    Attributes:
        rows: (contacts, 5) in N (1) or out of it (0), integral gain (1/s), damping (N s/m), least
            force command (N; −inf: none), approached (1) or not (0).
    """

    def __init__(self, rows: Array, gains: ForceGains) -> None:
        self.rows = rows
        rows[:] = 1.0, gains.integral, gains.damping, -np.inf, 0.0

    @property
    def active(self) -> NDArray[np.bool_]:
        """(contacts,) whether its columns are in N."""
        return self.rows[:, 0] != 0.0

    def of_columns(self, owners: Array, r: int) -> tuple[Array, Array, Array, Array]:
        """Integral gain, damping, least command and approached (r,) of the r independent columns.

        Args:
            owners: the contact of each column that is in force. Where some of these depend on
                others the most careful terms of all hold: least gain, most damping, no least.
        """
        rows = self.rows[owners, 1:]
        if len(owners) != r:
            rows = np.tile((rows[:, 0].min(), rows[:, 1].max(), -np.inf, 0.0), (r, 1))
        gain, damping, least, approached = rows.T
        return np.where(approached, 10.0, gain), damping, least, approached


@dataclass
class ForceLaw:
    """α_u = α_d + K_i ∫(α_d − α_meas) dt − K_v NᵀV_rel: feed-forward, integral and damping.

    Where a least command is set, α_u ≥ min(α_min, α_d/10), and the integral stops there.
    """

    gains: ForceGains
    dt: float
    memory: Array = field(default_factory=lambda: np.zeros(7))  #: the integral (≤ 6) and its r

    @property
    def integral(self) -> Array:
        """(r,) K_i ∫(α_d − α_meas) dt (N)."""
        return self.memory[: int(self.memory[6])].copy()

    @integral.setter
    def integral(self, value: Array) -> None:
        r = len(value)
        self.memory[:r], self.memory[6] = value, r

    def __post_init__(self) -> None:
        if self.gains.integral * self.dt >= 1.0:
            raise InvalidInputError(
                f"force gain integral = {self.gains.integral:g} 1/s at a period of {self.dt:g} s "
                "leaves no stability margin; keep integral × period below 1"
            )

    def command(
        self,
        alpha_d: Array,
        alpha_meas: Array,
        normal_speed: Array,
        terms: tuple[Array, Array, Array, Array] | None = None,
    ) -> Array:
        """Commanded magnitudes α_u (r,).

        Args:
            alpha_d, alpha_meas: (r,) desired and measured (N). normal_speed: NᵀV_rel (r,) in m/s.
            terms: see `ContactTerms.of_columns`; default: the gains, no least, none approached.
        """
        r = len(alpha_d)
        k = self.gains
        alike = np.full(r, k.integral), np.full(r, k.damping), np.full(r, -np.inf), np.zeros(r)
        gain, damping, least, approached = alike if terms is None else terms
        before = self.integral if len(self.integral) == r else np.zeros(r)
        felt = np.where(approached, damping * normal_speed, alpha_meas)
        after = before + gain * self.dt * (alpha_d - felt)
        wanted = alpha_d + after - damping * normal_speed
        floor = np.minimum(least, 0.1 * alpha_d)
        self.integral = np.where(wanted < floor, np.maximum(before, after), after)
        return np.maximum(wanted, floor)

    def forgo(self, lost: Array, gain: Array) -> None:
        """Take back what the last `command`, with `gain` (r,), integrated of forces (r,) that will
        not come."""
        self.integral = self.integral - gain * self.dt * lost
