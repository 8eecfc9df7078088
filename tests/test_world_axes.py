"""Λ, μ and p of a chain in world axes: power, equation of motion, another frame, the basis S."""

import numpy as np
import pinocchio as pin
from grasp_rigs import KINDS, random_case
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import approx, mark
from rigs import largest, one_panda, panda_pair, random_state, scara_pair

ARMS = ["scara", "ur5", "panda", "2R", "3R"]
CHAINS = {"one_panda": one_panda, "panda_pair": panda_pair, "scara_pair": scara_pair}


def close(got, want, digits=1e-9):
    size = max(1.0, largest(want))
    assert_allclose(got, want, rtol=0, atol=digits * size)


def some_states(count=40):
    """Chains of 1–3 arms with any grasps, at random states that their loops permit."""
    rng = default_rng(16)
    for _ in range(count):
        n = rng.integers(1, 4)
        case = random_case(list(rng.choice(ARMS, n)), list(rng.choice(KINDS, n)), rng)
        v, V = case.moving(rng)
        yield case.chain.state(case.q, v, case.X_WO, V), rng


def test_along_S_they_are_the_reduced_ones():
    """SᵀΛS = Λ_S, Sᵀ(μ + Λσ) = μ_S, Sᵀp = p_S, whatever the rank d."""
    ranks = set()
    for state, _ in some_states():
        S = state.S
        close(S.T @ state.Lambda @ S, state.Lambda_S)
        close(S.T @ (state.mu + state.Lambda @ state.sigma), state.mu_S, 1e-8)
        close(S.T @ state.p, state.p_S)
        close(state.b_S, state.mu_S + state.p_S)
        ranks.add(state.d)
    assert {4, 5, 6} <= ranks


@mark.parametrize("name", CHAINS)
def test_the_wrench_has_the_power_of_all_that_moves(name):
    """Vᵀ(Λa + μ + p): what Newton and Euler (Pinocchio) give joints and object together."""
    chain = CHAINS[name]()
    rng = default_rng(17)
    for _ in range(10):
        q, v = random_state(chain, rng)
        state = chain.state(q, v)
        eta = np.linalg.lstsq(state.S, state.V_O, rcond=None)[0]
        v = state.W @ eta  # without what redundant arms do by themselves
        state = chain.state(q, v)
        eta_dot = rng.standard_normal(state.d)
        a = state.S @ eta_dot + state.sigma
        a_q = state.W @ eta_dot + state.w
        model = chain.model
        power = v @ pin.rnea(model, model.createData(), q, v, a_q)
        weight = chain.payload.terms(state.X_WO, state.V_O, model.gravity.linear)
        power += state.V_O @ (weight.Lambda @ a + weight.mu + weight.p)
        wrench = state.Lambda @ a + state.mu + state.p
        assert wrench @ state.V_O == approx(power, rel=1e-8, abs=1e-8)


@mark.parametrize("name", ["one_panda", "panda_pair"])
def test_with_six_motions_the_inertia_is_the_inverse_of_the_mobility(name):
    """Λ₀ = Φ⁻¹ where d = 6; the SCARA pair's Φ has rank five and no inverse."""
    chain = CHAINS[name]()
    state = chain.state(*random_state(chain, default_rng(21)))
    close(state.Lambda @ state.Phi, np.eye(6), 1e-7)
    pair = scara_pair()
    state = pair.state(*random_state(pair, default_rng(22)))
    assert state.d == 5 and largest(state.Lambda @ state.Phi - np.eye(6)) > 0.1
    close(state.Phi @ state.Lambda @ state.Phi, state.Phi, 1e-8)
