"""Eqs. 21 and 24 for any chain state: what the law commands, against its optimality conditions."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
from numpy.testing import assert_allclose
from pytest import mark, raises
from rigs import one_panda, panda_pair, scara_pair
from test_decoupling import in_contact

import osc_contact as osc
from paper.command_filter import command


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


def assert_close(got, want):
    for one, other in zip(got, want, strict=True):
        size = max(1.0, np.abs(other).max())
        assert_allclose(one, other, rtol=0, atol=1e-9 * size)


@mark.parametrize("kind", ["object", "chain", "matrix"])
@mark.parametrize("rig", [scara_pair, panda_pair, one_panda])
def test_commands_are_the_nearest_that_contacts_permit(rig, kind):
    """Fixed faces and bodies that move, yield and are dragged along; d = 5, 6."""
    chain = rig()
    rng = np.random.default_rng(80)
    for _ in range(20):
        state, contact, *_ = in_contact(chain, rng)
        A = rng.normal(size=(6, 6))
        half = rng.normal(size=(6, 3))
        B = A @ A.T + np.eye(6) if kind == "matrix" else kind
        a_u = rng.normal(size=6)
        alpha_u = rng.uniform(1, 20, contact.r)
        moving = osc.Environment(half @ half.T, rng.normal(size=6), rng.normal(size=6))
        friction_wrenches = 0.1 * rng.normal(size=contact.N.shape)
        for how in (
            (osc.Environment.fixed(), np.zeros_like(friction_wrenches)),
            (moving, friction_wrenches),
        ):
            given = state, contact, a_u, alpha_u, B, *how
            assert_close(command(*given), by_definition(*given))


@mark.parametrize("rig", [scara_pair, panda_pair])
def test_frame_units_and_bases_do_not_matter(rig):
    """200 random frames, units (m → mm) and bases of S and N: the same η̇_c and f_S."""
    chain = rig()
    rng = np.random.default_rng(14)
    state, contact, *_ = in_contact(chain, rng)
    A = rng.normal(size=(6, 6))
    B = A @ A.T + 0.1 * np.eye(6)
    a_u = rng.normal(size=6)
    alpha = rng.uniform(5, 20, 2)
    eta, f_S = command(state, contact, a_u, alpha, B)
    for _ in range(200):
        X = pin.SE3.Random().action  # motions; forces go with X⁻ᵀ
        if rng.random() < 0.5:
            X = np.diag([1e3, 1e3, 1e3, 1, 1, 1]) @ X
        X_force = np.linalg.inv(X).T
        Q = np.linalg.qr(rng.normal(size=(state.d, state.d)))[0] * rng.uniform(0.2, 5, state.d)
        R = np.linalg.qr(rng.normal(size=(2, 2)))[0] * rng.uniform(0.2, 5, 2)
        moved = replace(
            state,
            S=X @ state.S @ Q,
            sigma=X @ state.sigma,
            metric=X_force @ state.metric @ X_force.T,
            Phi=X @ state.Phi @ X.T,
            Lambda_S=Q.T @ state.Lambda_S @ Q,
            mu_S=Q.T @ state.mu_S,
            p_S=Q.T @ state.p_S,
        )
        touched = osc.Contact(X_force @ contact.N @ R, R.T @ contact.n_gamma)
        eta_Q, f_Q = command(moved, touched, X @ a_u, np.linalg.solve(R, alpha), X @ B @ X.T)
        assert_close((Q @ eta_Q, np.linalg.solve(Q.T, f_Q)), (eta, f_S))


def test_a_metric_that_is_not_definite_is_refused():
    state, contact, *_ = in_contact(scara_pair(), np.random.default_rng(81))
    with raises(osc.ContactError, match="metric B"):
        command(state, contact, np.zeros(6), np.zeros(2), -np.eye(6))
