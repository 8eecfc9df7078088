"""Acceleration and contact force of a closed chain under a command, equations 17 to 20."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from osc_contact.contacts.contact import Contact
from osc_contact.dynamics.chain_state import ChainState
from osc_contact.dynamics.environment import Environment
from osc_contact.errors import ContactError, InvalidInputError, ModelError
from osc_contact.projections import orthonormal
from osc_contact.spatial import Array, as_array


@dataclass(frozen=True)
class ContactResponse:
    """Acceleration and contact force under a command, at O in world axes.

    Attributes:
        acceleration: (6,) spatial acceleration of the object, S η̇ + σ (m/s², rad/s²).
        eta_dot: (d,) coordinates η̇ of the acceleration in S.
        alpha: (r,) contact force magnitudes α (N).
        f_c: (6,) contact force on the environment, N α (eq. 16) (N, N m).
        a_e: (6,) spatial acceleration of the environment (eq. 14) (m/s², rad/s²).

    Example:
        >>> state = osc.build_rig(osc.load_scenario("two_contact_rod")).state
        >>> answer = osc.contact_response(state, osc.Contact(np.eye(6)[:, [2]]), tau=np.zeros(8))
        >>> print(answer.alpha.shape, answer.acceleration.shape)
        (1,) (6,)
    """

    acceleration: Array
    eta_dot: Array
    alpha: Array
    f_c: Array
    a_e: Array


def contact_response(
    state: ChainState,
    contact: Contact,
    environment: Environment | None = None,
    f_S: npt.ArrayLike | None = None,
    tau: npt.ArrayLike | None = None,
) -> ContactResponse:
    """Compute acceleration and contact force under a command (eqs. 17, 18 with Φ₀ for Λ₀⁻¹).

        α = D⁻¹[NᵀSΛ_S⁻¹(f_S − b_S) + Nᵀ(σ − b_e) − n_γ],   D = Nᵀ(Φ₀ + Φ_e)N
        η̇ = Λ_S⁻¹(f_S − b_S − SᵀNα)

    Args:
        state: state of the chain, with S, σ, Λ_S, b_S and Φ₀.
        contact: N and n_γ.
        environment: Φ_e and b_e; None: a fixed environment.
        f_S: (d,) generalised force on the object (N, N m); give either f_S or tau.
        tau: (n_a,) motor torques (N m, N), with f_S = G τ.

    Raises:
        InvalidInputError: not exactly one of f_S and tau, or wrong sizes.
        ContactError: neither the chain nor the environment yields along one of the contacts, or
            columns of N are linearly dependent.
    """
    if (f_S is None) == (tau is None):
        raise InvalidInputError("give exactly one of f_S= (d,) and tau= (n_a,)")
    if tau is not None:
        force = state.G @ as_array("tau", tau, (state.G.shape[1],))
    else:
        force = as_array("f_S", f_S, (state.d,))
    env = Environment.fixed() if environment is None else environment
    N = contact.N
    free = np.linalg.solve(state.Lambda_S, force - state.b_S)
    require_reachable(state, contact, env.Phi_e if env.Phi_e.any() else None)
    _, _, G = orthonormal(N, state.Phi + env.Phi_e, "contact force")  # D⁻¹ = GGᵀ
    drive = N.T @ (state.S @ free + state.sigma - env.b_e) - contact.n_gamma
    alpha = G @ (G.T @ drive)
    f_c = N @ alpha
    eta_dot = free - np.linalg.solve(state.Lambda_S, state.S.T @ f_c)
    return ContactResponse(
        acceleration=state.S @ eta_dot + state.sigma,
        eta_dot=eta_dot,
        alpha=alpha,
        f_c=f_c,
        a_e=env.Phi_e @ f_c + env.b_e,
    )


def Lambda_rel(state: ChainState, environment: Environment) -> Array:
    """Compute the relative inertia Λ_rel = (Λ₀⁻¹ + Φ_e)⁻¹ (6, 6) of eqs. 17 to 25, Φ₀ for Λ₀⁻¹.

    Λ_rel exists if chain and environment together can accelerate in all six directions. Its
    inverse Φ₀ + Φ_e, by which forces are computed, always exists.

    Args:
        state: state of the chain, with Φ₀.
        environment: Φ_e.

    Raises:
        ModelError: chain and environment are both locked in some direction.
    """
    L = np.linalg.cholesky(state.metric)  # dimensionless in the object's energy metric
    relative = L.T @ (state.Phi + environment.Phi_e) @ L
    values, vectors = np.linalg.eigh(0.5 * (relative + relative.T))
    if values[0] < 1e-10:
        locked = np.array2string(L @ vectors[:, 0], precision=3)
        raise ModelError(
            f"Λ_rel does not exist: neither chain nor environment yields to the wrench {locked} "
            f"(mobility {values[0]:.2g} of the free object's). Use Φ₀ + Φ_e, its inverse."
        )
    scaled = L @ vectors
    return (scaled / values) @ scaled.T


def require_reachable(state: ChainState, contact: Contact, Phi_e: Array | None = None) -> None:
    """Refuse contacts whose forces the arms cannot control: rank SᵀN < r.

    Args:
        state: state of the chain.
        contact: N (6, r) at this state.
        Phi_e: (6, 6) inverse inertia of the environment; with it, contacts at which only the
            environment yields are accepted as well: their force is defined, though no command
            changes it.

    Raises:
        ContactError: the message names the column of N.
    """
    bodies = "the arms" if Phi_e is None else "the arms and the environment"
    N = contact.N
    D = N.T @ (state.Phi if Phi_e is None else state.Phi + Phi_e) @ N
    if D.size == 0:
        return
    free_mobility = N.T @ np.linalg.solve(state.metric, N)  # of the object without arms
    mobility = np.diag(D) / np.diag(free_mobility)
    if mobility.min() < 1e-9:
        column = mobility.argmin()
        raise ContactError(
            f"{bodies} cannot push on contact column {column}: its mobility is "
            f"{mobility[column]:.2g} of the free object's. The structure carries this force; leave "
            "the contact out of N."
        )
    scaled = D / np.sqrt(np.outer(np.diag(D), np.diag(D)))
    values, vectors = np.linalg.eigh(scaled)
    if values[0] < 1e-10:
        columns = np.flatnonzero(np.abs(vectors[:, 0]) > 1e-3).tolist()
        raise ContactError(
            f"in the metric of {bodies}, contact columns {columns} are dependent (scaled "
            f"eigenvalue {values[0]:.2g}): their forces cannot be distinguished. Keep an "
            "independent subset."
        )
