"""The closed chain against full systems of equations: 1,000 random states for each rig."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from grasp_oracle import ClosedLoop, kkt
from rigs import (
    ROD,
    SCARA_Q,
    consistent,
    contact_of,
    one_panda,
    panda_pair,
    random_faces,
    random_state,
    scara_pair,
)

import osc_contact as osc
from osc_contact import robots

STATES = 1000
RTOL = 1e-9


def close_to(got, want, scale=None):
    """Largest difference relative to the size of the vector."""
    size = max(np.abs(want).max(initial=0.0), 1e-3) if scale is None else scale
    return np.abs(got - want).max(initial=0.0) / size


@pytest.mark.parametrize("rig, d, contacts", [(scara_pair, 5, 2), (panda_pair, 6, 2)])
def test_two_arms_agree_with_the_full_kkt_system(rig, d, contacts):
    """Eqs. 13–20: contact force and acceleration, with and without contact."""
    chain, rng = rig(), np.random.default_rng(1)
    worst = 0.0
    for k in range(STATES):
        q, v = random_state(chain, rng)
        state = chain.state(q, v)
        assert state.d == d
        pairs = random_faces(state.X_WO, contacts if k % 4 else 0, rng)
        contact = contact_of(pairs, state)
        v = consistent(chain, q, v, contact.N)
        state = chain.state(q, v)
        contact = contact_of(pairs, state)
        tau = rng.normal(size=chain.n_a) * 20.0
        oracle = kkt(chain, q, v, tau, contact.N, contact.n_gamma)
        got = osc.contact_response(state, contact, tau=tau)
        worst = max(
            worst,
            close_to(got.alpha, oracle.alpha),
            close_to(got.acceleration, oracle.a_object),
        )
        assert worst < RTOL, (k, worst)
        if d == 5:  # no redundancy: the joints' accelerations are determined too
            assert close_to(state.W @ got.eta_dot + state.w, oracle.qdd) < RTOL


def test_one_panda_with_zero_to_five_contacts_agrees_with_the_full_kkt_system():
    """Eqs. 13–20 for one redundant arm, r = 0 … 5."""
    chain, rng = one_panda(), np.random.default_rng(2)
    for k in range(STATES):
        q, v = random_state(chain, rng)
        state = chain.state(q, v)
        pairs = random_faces(state.X_WO, k % 6, rng)
        contact = contact_of(pairs, state)
        v = consistent(chain, q, v, contact.N)
        state = chain.state(q, v)
        contact = contact_of(pairs, state)
        tau = rng.normal(size=7) * 20.0
        oracle = kkt(chain, q, v, tau, contact.N, contact.n_gamma)
        got = osc.contact_response(state, contact, tau=tau)
        assert close_to(got.alpha, oracle.alpha) < RTOL, k
        assert close_to(got.acceleration, oracle.a_object) < RTOL, k


@pytest.mark.parametrize("rig", [scara_pair, panda_pair, one_panda])
def test_accelerations_inertia_and_G_agree_with_pinocchio_constraint_dynamics(rig):
    """Λ_S⁻¹ and G from unit forces and unit torques on Pinocchio's own closed loop."""
    chain, rng = rig(), np.random.default_rng(3)
    oracle = ClosedLoop(chain)
    for k in range(STATES):
        q, v = random_state(chain, rng)
        state = chain.state(q, v)
        tau = rng.normal(size=chain.n_a) * 20.0
        got = osc.contact_response(state, osc.Contact(np.zeros((6, 0))), tau=tau)
        a = oracle.acceleration(q, v, state.X_WO, state.V_O, tau)
        assert close_to(got.acceleration, a) < RTOL, k
        if k % 20 == 0:
            rest, none = np.zeros(chain.nq), np.zeros(chain.n_a)
            still = chain.state(q, rest)
            where = q, rest, still.X_WO, still.V_O
            base = oracle.acceleration(*where, none)
            pushed = [oracle.acceleration(*where, none, wrench) - base for wrench in np.eye(6)]
            assert close_to(still.Phi, np.column_stack(pushed)) < RTOL
            driven = [oracle.acceleration(*where, motor) - base for motor in np.eye(chain.n_a)]
            SG = np.column_stack(driven)
            mine = still.S @ np.linalg.solve(still.Lambda_S, still.G)
            assert close_to(mine, SG) < RTOL


def test_lambda0_is_the_sum_of_arms_and_object_for_full_rank_arms():
    """Section 6: Λ₀ = Λ₀l + Λ₀r + Λ₀o, and μ, p likewise."""
    chain = panda_pair()
    q, v = random_state(chain, np.random.default_rng(4))
    state = chain.state(q, v)
    total = state.payload.Lambda + sum(arm.Lambda for arm in state.arms)
    np.testing.assert_allclose(np.linalg.inv(state.Phi), total, rtol=1e-9, atol=1e-9)
    S_inv = np.linalg.inv(state.S)
    mu = state.payload.mu + sum(arm.mu for arm in state.arms)
    mu = mu + total @ state.sigma  # σ = 0 would be a valid choice for d = 6
    np.testing.assert_allclose(S_inv.T @ state.mu_S, mu, rtol=1e-8, atol=1e-8)
    p = state.payload.p + sum(arm.p for arm in state.arms)
    np.testing.assert_allclose(S_inv.T @ state.p_S, p, rtol=1e-9, atol=1e-9)


def test_the_locked_direction_of_the_scara_pair_is_the_couple_about_the_rods_heading():
    chain, rng = scara_pair(), np.random.default_rng(5)
    for _ in range(50):
        q, v = random_state(chain, rng)
        state = chain.state(q, v)
        heading = state.X_WO.rotation[:, 0] * [1, 1, 0]
        assert state.C.shape == (6, 1)
        c = state.C[:, 0] / np.linalg.norm(state.C[3:, 0])
        np.testing.assert_allclose(c[:3], 0, atol=1e-9)
        np.testing.assert_allclose(np.cross(c[3:], heading), 0, atol=1e-9)
        # both grippers turn: σ carries the product of yaw and pitch rates
        w = state.V_O[3:]
        hinge = np.cross([0, 0, 1], heading / np.linalg.norm(heading))
        expected = w[2] * (w @ hinge)
        along = state.sigma[3:] @ (heading / np.linalg.norm(heading))
        np.testing.assert_allclose(along, -expected, rtol=1e-9, atol=1e-12)


def test_phi0_has_rank_five_and_is_not_a_damped_inverse():
    chain = scara_pair()
    state = chain.state(*random_state(chain, np.random.default_rng(6)))
    L = np.linalg.cholesky(state.metric)
    values = np.linalg.eigvalsh(L.T @ state.Phi @ L)
    assert values[0] < 1e-12 * values[-1]
    assert values[1] > 1e-3 * values[-1]
    np.testing.assert_allclose(state.C.T @ state.S, 0, atol=1e-12)
    np.testing.assert_allclose(state.Phi @ state.C, 0, atol=1e-10)


def test_energy_balance_along_the_motion():
    """Power of the motors = rate of kinetic plus potential energy (no contact work)."""
    chain, rng = scara_pair(), np.random.default_rng(7)
    for _ in range(20):
        q, v = random_state(chain, rng)
        state = chain.state(q, v)
        tau = rng.normal(size=8) * 10
        got = osc.contact_response(state, osc.Contact(np.zeros((6, 0))), tau=tau)
        qdd = state.W @ got.eta_dot + state.w
        h = 1e-6

        def energy(t, q=q, v=v, qdd=qdd):
            qt, vt = q + v * t + 0.5 * qdd * t * t, v + qdd * t
            pin.computeAllTerms(chain.model, chain.data, qt, vt)
            X = chain.object_poses()[0]
            s = chain.slices[0]
            J = pin.getFrameJacobian(
                chain.model, chain.data, chain.model.getFrameId("left/tool"), pin.WORLD
            )[:, s]
            V = J @ vt[s]
            V_O = np.concatenate((V[:3] + np.cross(V[3:], X.translation), V[3:]))
            body = chain.payload.inertia
            c = X.rotation @ body.lever
            v_c = V_O[:3] + np.cross(V_O[3:], c)
            I_c = X.rotation @ body.inertia @ X.rotation.T
            kinetic = 0.5 * body.mass * v_c @ v_c + 0.5 * V_O[3:] @ I_c @ V_O[3:]
            height = (X.translation + c)[2]
            return (
                chain.data.kinetic_energy + chain.data.potential_energy
                + kinetic + body.mass * 9.81 * height
            )  # fmt: skip

        rate = (energy(h) - energy(-h)) / (2 * h)
        power = tau @ v[chain.actuated]
        assert abs(rate - power) < 1e-5 * max(1.0, abs(power))


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
            robots.urdf_path(f"scara_{side}"), name=side, tip="tool",
            base=pin.SE3(pin.rpy.rpyToMatrix(1e-4, -1e-4, 0.0) if side == "right" else np.eye(3),
                         np.array([x, -0.40, 0.0])),
            passive_joints=["hinge"],
        )
        for side, x in (("left", -0.35), ("right", 0.35))
    ]  # fmt: skip
    chain = osc.ClosedChain(arms, scara_pair().grasps, osc.RigidObject(ROD))
    q, _ = random_state(scara_pair(), np.random.default_rng(8))
    assert chain.state(q, np.zeros(10)).d == 5
    strict = osc.ClosedChain(arms, scara_pair().grasps, chain.payload, rank_tolerance=1e-6)
    assert strict.state(q, np.zeros(10)).d == 4
