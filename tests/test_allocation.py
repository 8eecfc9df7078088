"""Torque allocation: G τ = f_S, the squeeze asked for, least weighted torque, quiet null space."""

import numpy as np
import pytest
from grasp_oracle import kkt
from numpy.testing import assert_allclose
from rigs import panda_pair, scara_pair
from test_decoupling import commanded, in_contact

import osc_contact as osc


@pytest.mark.parametrize("rig", [scara_pair, panda_pair])
def test_squeeze_arises_between_the_grasps_and_disturbs_nothing(rig):
    """Judged by the wrenches of the KKT oracle: ½ eᵀ(λ₁ − λ₂) along the grasp line."""
    chain = rig()
    rng = np.random.default_rng(30)
    for _ in range(30):
        state, contact, pairs, q, v = in_contact(chain, rng)
        line = state.grasp_points[1] - state.grasp_points[0]
        e = line / np.linalg.norm(line)
        a_u = rng.normal(size=6)
        alpha = rng.uniform(5, 20, 2)
        B = np.linalg.inv(state.metric)
        seen = []
        for squeeze in (-15.0, 25.0):
            _, tau = commanded(chain, pairs, q, v, a_u, alpha, B, squeeze)
            got = kkt(chain, q, v, tau, contact.N, contact.n_gamma)
            force = got.loops[:, :3]
            assert 0.5 * e @ (force[0] - force[1]) == pytest.approx(squeeze, abs=1e-6)
            seen.append(got)
        scale = np.abs(seen[0].a_object).max()
        assert_allclose(seen[0].a_object, seen[1].a_object, atol=1e-9 * scale)
        assert_allclose(seen[0].alpha, seen[1].alpha, atol=1e-7)


def test_a_redundant_arm_with_passive_joints_is_refused():
    arm = panda_pair().arms[0]
    limp = osc.Arm(arm.name, arm.model, arm.tip, arm.base, passive_joints=("panda_joint7",))
    chain = osc.ClosedChain([limp], None, panda_pair().payload)
    with pytest.raises(osc.ModelError, match="posture"):
        osc.Controller(chain, [])
