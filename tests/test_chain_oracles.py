"""The closed chain against full systems of equations: 1,000 random states for each rig."""

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose
from rigs import ROD, SCARA_Q, panda_pair, random_state, scara_pair

import osc_contact as osc
from osc_contact import robots


def test_lambda0_is_the_sum_of_arms_and_object_for_full_rank_arms():
    """Section 6: Λ₀ = Λ₀l + Λ₀r + Λ₀o, and μ, p likewise."""
    chain = panda_pair()
    q, v = random_state(chain, np.random.default_rng(4))
    state = chain.state(q, v)
    total = state.payload.Lambda + sum(arm.Lambda for arm in state.arms)
    assert_allclose(np.linalg.inv(state.Phi), total, rtol=1e-9, atol=1e-9)
    S_inv = np.linalg.inv(state.S)
    mu = state.payload.mu + sum(arm.mu for arm in state.arms)
    mu = mu + total @ state.sigma  # σ = 0 would be a valid choice for d = 6
    assert_allclose(S_inv.T @ state.mu_S, mu, rtol=1e-8, atol=1e-8)
    p = state.payload.p + sum(arm.p for arm in state.arms)
    assert_allclose(S_inv.T @ state.p_S, p, rtol=1e-9, atol=1e-9)


def test_the_locked_direction_of_the_scara_pair_is_the_couple_about_the_rods_heading():
    chain = scara_pair()
    rng = np.random.default_rng(5)
    for _ in range(50):
        q, v = random_state(chain, rng)
        state = chain.state(q, v)
        heading = state.X_WO.rotation[:, 0] * [1, 1, 0]
        assert state.C.shape == (6, 1)
        c = state.C[:, 0] / np.linalg.norm(state.C[3:, 0])
        assert_allclose(c[:3], 0, atol=1e-9)
        assert_allclose(np.cross(c[3:], heading), 0, atol=1e-9)
        # both grippers turn: σ carries the product of yaw and pitch rates
        w = state.V_O[3:]
        hinge = np.cross([0, 0, 1], heading / np.linalg.norm(heading))
        expected = w[2] * (w @ hinge)
        along = state.sigma[3:] @ (heading / np.linalg.norm(heading))
        assert_allclose(along, -expected, rtol=1e-9, atol=1e-12)


def test_phi0_has_rank_five_and_is_not_a_damped_inverse():
    chain = scara_pair()
    state = chain.state(*random_state(chain, np.random.default_rng(6)))
    L = np.linalg.cholesky(state.metric)
    values = np.linalg.eigvalsh(L.T @ state.Phi @ L)
    assert values[0] < 1e-12 * values[-1]
    assert values[1] > 1e-3 * values[-1]
    assert_allclose(state.C.T @ state.S, 0, atol=1e-12)
    assert_allclose(state.Phi @ state.C, 0, atol=1e-10)


def test_a_motion_that_nobody_drives_is_named():
    arm = osc.Arm.from_urdf(
        robots.urdf_path("scara_left"), name="a", tip="tool", passive_joints=["hinge"]
    )
    chain = osc.ClosedChain([arm], None, osc.RigidObject(ROD))
    with pytest.raises(osc.ModelError, match="no motor drives"):
        chain.state(SCARA_Q[:5], np.zeros(5))


def test_calibration_errors_do_not_cost_a_motion():
    """A base turned by 1e-4 rad: the arms' locked directions differ, d stays 5."""
    arms = [
        osc.Arm.from_urdf(
            robots.urdf_path(f"scara_{side}"),
            name=side,
            tip="tool",
            base=pin.SE3(
                pin.rpy.rpyToMatrix(1e-4, -1e-4, 0.0) if side == "right" else np.eye(3),
                np.array([x, -0.40, 0.0]),
            ),
            passive_joints=["hinge"],
        )
        for side, x in (("left", -0.35), ("right", 0.35))
    ]
    chain = osc.ClosedChain(arms, scara_pair().grasps, osc.RigidObject(ROD))
    q, _ = random_state(scara_pair(), np.random.default_rng(8))
    assert chain.state(q, np.zeros(10)).d == 5
    strict = osc.ClosedChain(arms, scara_pair().grasps, chain.payload, rank_tolerance=1e-6)
    assert strict.state(q, np.zeros(10)).d == 4
