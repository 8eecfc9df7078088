"""Equations 21 to 25 in NumPy: commands filtered so that force and motion stay apart."""

from __future__ import annotations

import numpy as np

from osc_contact.contacts.contact import Contact
from osc_contact.dynamics.closed_chain import ChainState
from osc_contact.dynamics.environment import Environment
from osc_contact.errors import InvalidInputError
from osc_contact.response import require_reachable
from osc_contact.spans import left_inverse
from osc_contact.spatial import Array

__all__ = [
    "object_acceleration",
    "object_coordinates",
    "filtered_motion",
    "generalised_force",
    "metric_in_coordinates",
    "metric_of",
]


def object_acceleration(
    state: ChainState,
    contact: Contact,
    environment: Environment,
    relative: Array,
    alpha_u: Array,
    Tdot_beta: Array | None = None,
) -> Array:
    """ϑ̇ = ϑ̇′ + Ṫβ + a_e (6,): the object's acceleration behind the paper's relative ϑ̇′.

    a_e = Φ_eNα_u + b_e is how the environment will answer the force command. Commands given in
    this relative form are what eqs. 24 and 25 decouple: a force step then moves the object with a
    yielding environment and not against it. On a fixed environment it only adds Ṫβ.

    Args:
        state, contact, environment: at this instant.
        relative: (6,) unfiltered relative acceleration ϑ̇′_u, velocity products removed.
        alpha_u: (r,) force command.
        Tdot_beta: (6,) velocity product of T; default: the least one in the object's energy
            metric with NᵀṪβ = n_γ, which is all that T itself must fulfil.
    """
    N = contact.N
    if Tdot_beta is None:
        Tdot_beta = contact.n_gamma @ left_inverse(N, np.linalg.inv(state.metric), "Ṫβ")
    return relative + Tdot_beta + environment.Phi_e @ (N @ alpha_u) + environment.b_e


def object_coordinates(state: ChainState, contact: Contact, a: Array) -> Array:
    """η̇ = P_T(a − σ), the coordinates (d,) of an object acceleration a (6,).

    P_T x = argmin_e (x − S e)ᵀΛ_o(x − S e) subject to NᵀS e = Nᵀx: exact where a − σ lies in
    range(S) (always, for d = 6), and what the contact sees is never rounded away.

    Raises:
        ContactError: the arms cannot push on some contact (rank SᵀN < r).
    """
    require_reachable(state, contact)
    x = a - state.sigma
    H = state.S.T @ state.metric @ state.S
    eta = np.linalg.solve(H, state.S.T @ state.metric @ x)
    N_S = state.S.T @ contact.N
    miss = contact.N.T @ x - N_S.T @ eta
    return np.asarray(eta + miss @ left_inverse(N_S, np.linalg.inv(H), "P_T"))


def metric_in_coordinates(state: ChainState, B: Array) -> Array:
    """B_S = (SᵀB⁻¹S)⁻¹ (d, d), so that the filter does not depend on the basis S.

    Raises:
        InvalidInputError: B is not symmetric positive definite.
    """
    scale = np.sqrt(np.diag(B)) if np.diag(B).min() > 0.0 else np.ones(6)
    scaled = B / np.outer(scale, scale)
    if np.abs(scaled - scaled.T).max() > 1e-9 or np.linalg.eigvalsh(scaled)[0] <= 0.0:
        raise InvalidInputError("the metric B of eq. 24 must be symmetric positive definite")
    return np.linalg.inv(state.S.T @ np.linalg.solve(B, state.S))


def metric_of(B: Array | str, state: ChainState) -> Array:
    """The metric (6, 6) of eq. 24: "object" Λ_o⁻¹, "chain" (ΣΛ_i + Λ_o)⁻¹, or the one given."""
    if not isinstance(B, str):
        return B
    inertia = state.metric
    if B == "chain":
        inertia = inertia + sum(arm.Lambda for arm in state.arms)
    return np.linalg.inv(inertia)


def filtered_motion(
    state: ChainState,
    contact: Contact,
    eta_u: Array,
    alpha_u: Array,
    B: Array,
    environment: Environment,
    friction_wrenches: Array | float = 0.0,
) -> Array:
    """η̇_c (d,): the motion command after Ω_m(B), eq. 24, with the velocity-product terms.

        ρ = n_γ + Nᵀ(b_e − σ + Φ_eN_μα_u)
        η̇_c = η̇_u − B_S N_S (N_SᵀB_S N_S)⁻¹ (N_Sᵀη̇_u − ρ),   N_S = SᵀN

    Friction acts on the environment too: N_μ = N + friction_wrenches is what pushes it; N is what
    is tested.

    Args:
        state, contact, environment: at this instant.
        eta_u: (d,) unfiltered motion command.
        alpha_u: (r,) force command.
        B: (6, 6) positive definite, any: it decides how a forbidden command is bent into T.
        friction_wrenches: (6, r) from `Friction.wrenches`, or none.
    """
    N = contact.N
    N_S = state.S.T @ N
    bent = left_inverse(N_S, metric_in_coordinates(state, B), "eq. 24").T
    pushed = environment.yielding(N, friction_wrenches) @ alpha_u
    rho = contact.n_gamma + N.T @ (environment.b_e - state.sigma) + pushed
    return np.asarray(eta_u - bent @ (N_S.T @ eta_u - rho))


def generalised_force(state: ChainState, eta_c: Array, f_c: Array) -> Array:
    """f_S = Λ_S η̇_c + b_S + Sᵀf_c (d,): the dynamic control structure, eq. 21.

    With a filtered η̇_c and f_c = N α_u the chain answers with exactly these (eqs. 24, 25); with
    unfiltered commands they couple as eqs. 22 and 23 say.
    """
    return np.asarray(state.Lambda_S @ eta_c + state.b_S + state.S.T @ f_c)
