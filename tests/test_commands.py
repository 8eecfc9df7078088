"""Eqs. 21 and 24 for any chain state, which the law computes, against the same in NumPy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from readable.command_filter import (
    filtered_motion,
    generalised_force,
    metric_of,
    object_coordinates,
)
from rigs import one_panda, panda_pair, scara_pair
from test_decoupling import in_contact

import osc_contact as osc
from osc_contact.control.command_filter import command


def numpy_command(state, contact, a_u, alpha_u, B, environment, friction_wrenches):
    eta_u, metric = object_coordinates(state, contact, a_u), metric_of(B, state)
    eta = filtered_motion(state, contact, eta_u, alpha_u, metric, environment, friction_wrenches)
    return eta, generalised_force(state, eta, (contact.N + friction_wrenches) @ alpha_u)


def assert_close(got, want):
    for one, other in zip(got, want, strict=True):
        size = max(1.0, np.abs(other).max())
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-9 * size)


@pytest.mark.parametrize("kind", ["object", "chain", "matrix"])
@pytest.mark.parametrize("rig", [scara_pair, panda_pair, one_panda])
def test_commands_are_those_of_the_numpy_law(rig, kind):
    """Fixed faces and bodies that move, yield and are dragged along; d = 5, 6."""
    chain, rng = rig(), np.random.default_rng(80)
    for _ in range(20):
        state, contact, *_ = in_contact(chain, rng)
        A, half = rng.normal(size=(6, 6)), rng.normal(size=(6, 3))
        B = A @ A.T + np.eye(6) if kind == "matrix" else kind
        a_u, alpha_u = rng.normal(size=6), rng.uniform(1, 20, contact.r)
        moving = osc.Environment(half @ half.T, rng.normal(size=6), rng.normal(size=6))
        friction_wrenches = 0.1 * rng.normal(size=contact.N.shape)
        for how in (
            (osc.Environment.fixed(), np.zeros_like(friction_wrenches)),
            (moving, friction_wrenches),
        ):
            given = state, contact, a_u, alpha_u, B, *how
            assert_close(command(*given), numpy_command(*given))


def test_commands_follow_the_basis_of_the_state():
    """Another basis S of the same motions: the same acceleration and joint torques' duty."""
    chain, rng = scara_pair(), np.random.default_rng(81)
    state, contact, *_ = in_contact(chain, rng)
    Q = rng.normal(size=(5, 5)) + 3 * np.eye(5)
    other = replace(
        state,
        S=state.S @ Q,
        Lambda_S=Q.T @ state.Lambda_S @ Q,
        mu_S=Q.T @ state.mu_S,
        p_S=Q.T @ state.p_S,
    )
    asked = contact, rng.normal(size=6), rng.uniform(1, 20, contact.r)
    eta, f_S = command(state, *asked)
    eta_Q, f_Q = command(other, *asked)
    assert_close((Q @ eta_Q, f_Q), (eta, Q.T @ f_S))
    with pytest.raises(osc.ContactError, match="metric B"):
        command(state, *asked, -np.eye(6))
