"""Eqs. 21 and 24 for any chain state: what the law commands, against its optimality conditions."""

import numpy as np
from command_filter import command
from complaints import contact_error
from numpy.testing import assert_allclose
from rigs import in_contact, largest, one_panda, panda_pair, scara_pair
from samples import parametrize

import osc_contact as osc


def nearest(W, S, x, N_S, value):
    """argmin_η (x − Sη)ᵀW(x − Sη) subject to N_Sᵀη = value."""
    r = len(value)
    K = np.block([[S.T @ W @ S, N_S], [N_S.T, np.zeros((r, r))]])
    return np.linalg.solve(K, np.concatenate((S.T @ W @ x, value)))[: S.shape[1]]


def by_definition(state, contact, a_u, alpha_u, B, environment, friction_wrenches):
    """η̇_c (d,) and f_S (d,)."""
    pushed = contact.N + friction_wrenches
    N_S = state.S.T @ contact.N
    inertia = {"object": 0.0, "chain": sum(arm.Lambda for arm in state.arms)}
    W = np.linalg.inv(B) if isinstance(B, np.ndarray) else state.metric + inertia[B]
    x = a_u - state.sigma
    eta_u = nearest(state.metric, state.S, x, N_S, contact.N.T @ x)
    behind = environment.b_e - state.sigma
    rho = contact.n_gamma + contact.N.T @ behind
    rho = rho + environment.yielding(contact.N, friction_wrenches) @ alpha_u
    eta = nearest(W, state.S, state.S @ eta_u, N_S, rho)
    return eta, state.Lambda_S @ eta + state.b_S + state.S.T @ pushed @ alpha_u


@parametrize("kind", ["object", "chain", "matrix"])
@parametrize("rig", [scara_pair, panda_pair, one_panda])
def test_commands_are_the_nearest_that_contacts_permit(rig, kind):
    """Fixed faces and bodies that move, yield and are dragged along; d = 5, 6."""
    chain = rig()
    rng = np.random.default_rng(80)
    for _ in range(20):
        state, contact, *_ = in_contact(chain, rng)
        A = rng.standard_normal((6, 6))
        half = rng.standard_normal((6, 3))
        B = A @ A.T + np.eye(6) if kind == "matrix" else kind
        a_u = rng.standard_normal(6)
        alpha_u = rng.uniform(1, 20, contact.r)
        moving = osc.Environment(half @ half.T, rng.standard_normal(6), rng.standard_normal(6))
        friction_wrenches = 0.1 * rng.standard_normal(contact.N.shape)
        fixed = osc.Environment.fixed(), np.zeros_like(friction_wrenches)
        for how in (fixed, (moving, friction_wrenches)):
            given = state, contact, a_u, alpha_u, B, *how
            for one, other in zip(command(*given), by_definition(*given), strict=True):
                assert_allclose(one, other, rtol=0, atol=1e-9 * max(1.0, largest(other)))


def test_a_metric_that_is_not_definite_is_refused():
    state, contact, *_ = in_contact(scara_pair(), np.random.default_rng(81))
    with contact_error("metric B"):
        command(state, contact, np.zeros(6), np.zeros(2), -np.eye(6))
