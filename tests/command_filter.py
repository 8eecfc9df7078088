"""Equations 21 and 24 at one instant: the law's motion filter and control structure by themselves.

`osc_contact.law` computes them in coordinates in which the object's inertia is the identity and the
locked directions come first. Here any `ChainState` is brought into such coordinates, the same two
functions run as Python, and what they say is brought back.
"""

from types import SimpleNamespace

import numpy as np

from osc_contact.contacts.contact import Contact
from osc_contact.dynamics.chain_state import ChainState
from osc_contact.dynamics.environment import Environment
from osc_contact.errors import ContactError
from osc_contact.law import allocation, command_filter
from osc_contact.law.jit import as_python
from osc_contact.law.reasons import NO_REASON
from osc_contact.law.records import BY_MATRIX, BY_OBJECT, WORK, Tick
from osc_contact.response import require_reachable
from osc_contact.spatial import Array

_prepare = as_python(command_filter.require_reachable)
_filter = as_python(command_filter.filter_motion)
_structure = as_python(allocation.command_object)

_FIELDS = {name: field[0].shape for name, field in (WORK.dtype.fields or {}).items()}
_AXES = np.tile(np.eye(3), (4, 1, 1))


def command(
    state: ChainState,
    contact: Contact,
    a_u: Array,
    alpha_u: Array,
    B: Array | str = "object",
    environment: Environment | None = None,
    friction_wrenches: Array | float = 0.0,
) -> tuple[Array, Array]:
    """η̇_c and f_S (d,) for a motion and a force command, eqs. 24 and 21.

        ρ = n_γ + Nᵀ(b_e − σ + Φ_eN_μα_u)
        η̇_c = η̇_u − B_S N_S (N_SᵀB_S N_S)⁻¹ (N_Sᵀη̇_u − ρ),   η̇_u = P_T(a_u − σ),  N_S = SᵀN
        f_S = Λ_S η̇_c + b_S + SᵀN_μα_u

    The chain answers a force f_S with exactly η̇_c and α_u (eq. 25). Friction acts on the
    environment too: N_μ = N + friction_wrenches is what pushes it; N is what is tested.

    Args:
        state, contact: at this instant.
        a_u: (6,) unfiltered acceleration of the object at O. alpha_u: (r,) force command.
        B: metric of the filter, "object" (Λ_o⁻¹), "chain" ((ΣΛ_i + Λ_o)⁻¹) or positive definite
            (6, 6): it decides how a forbidden command is bent into T.
        environment: Φ_e and b_e; default: fixed.
        friction_wrenches: (6, r) what friction adds to each column of force.

    Raises:
        ContactError: the arms cannot push on some contact (rank SᵀN < r), or B is not definite.
    """
    require_reachable(state, contact)
    env = Environment.fixed() if environment is None else environment
    N = contact.N
    r = contact.r
    d = state.d
    L = np.linalg.cholesky(state.metric)
    Q, R = np.linalg.qr(L.T @ state.S, mode="complete")  # motions y = UᵀLᵀx, y[m:] = R η̇
    R = R[:d]
    U = np.roll(Q, 6 - d, axis=1)
    wrench = U.T @ np.linalg.inv(L)  # of a wrench at O
    motion = U.T @ L.T
    w = SimpleNamespace(**{name: np.zeros(shape) for name, shape in _FIELDS.items()})
    m = 6 - d
    w.rank = r
    w.locked = m
    w.axes = _AXES
    w.sigma = motion @ state.sigma
    w.a_u = motion @ a_u
    w.alpha_u = np.asarray(alpha_u)
    w.N_t[:r] = (wrench @ N).T
    w.pushed_t[:r] = (wrench @ (N + friction_wrenches)).T
    w.n_gamma[:r] = contact.n_gamma - w.N_t[:r, m:] @ w.sigma[m:]
    w.b_N[:r] = N.T @ env.b_e
    w.Phi_mu[:r, :r] = env.yielding(N, friction_wrenches)
    inverse = np.linalg.inv(R)
    w.Lambda[m:, m:] = inverse.T @ state.Lambda_S @ inverse
    w.chain_bias[m:] = inverse.T @ state.b_S
    chain = SimpleNamespace(metric=BY_OBJECT, held=0)
    if not (isinstance(B, str) and B == "object"):
        weight = (
            np.linalg.inv(B)
            if not isinstance(B, str)
            else state.metric + sum(arm.Lambda for arm in state.arms)
        )
        chain.metric = BY_MATRIX
        w.B_inv_t = wrench @ weight @ wrench.T
    t = Tick(chain, SimpleNamespace(f_bias=np.zeros(6)), w, None)
    _prepare(t)
    if _filter(t) != NO_REASON:
        raise ContactError("the metric B of eq. 24 is singular in the motions that the arms permit")
    _structure(t)
    return inverse @ w.x[m:], R.T @ w.f_S[m:]
