"""Fig. 5: contact forces out of wrist readings, exact and without accelerometers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from readable.force import ForceLaw, contact_force, magnitudes, sum_of_wrenches
from rigs import (
    PANDA_Q,
    ROD,
    consistent,
    contact_of,
    panda_arm,
    panda_pair,
    placed,
    random_faces,
    scara_pair,
)
from test_decoupling import in_contact

import osc_contact as osc
from osc_contact.plants.rigid import RigidPlant

FIXED = osc.Environment.fixed()


def readings(chain, pairs, q, v, tau):
    """(f_meas at O, true α) of the rigid plant: Newton–Euler through the sensors."""
    plant = RigidPlant(chain, pairs, 1e-3)
    plant.q, plant.v, plant._tau = q, v, tau
    return plant.measure().wrenches, plant.truth().alpha


@pytest.mark.parametrize("rig", [scara_pair, panda_pair])
def test_contact_force_is_exact_at_any_speed_with_links_between_sensor_and_hinge(rig):
    chain, rng = rig(), np.random.default_rng(20)
    for _ in range(100):
        state, contact, pairs, q, v = in_contact(chain, rng)
        tau = rng.normal(size=chain.n_a) * 20
        wrenches, alpha = readings(chain, pairs, q, v, tau)
        f_c = contact_force(sum_of_wrenches(wrenches, state), state, contact, FIXED)
        got = magnitudes(f_c, contact)
        np.testing.assert_allclose(got, alpha, atol=1e-9 * max(np.abs(alpha).max(), 1.0))


def test_forgetting_the_gripper_links_is_seen():
    """Λ_o alone in place of Λ_out: the filter is no longer exact (theory of fig. 5)."""
    chain, rng = scara_pair(), np.random.default_rng(21)
    errors = []
    for _ in range(20):
        state, contact, pairs, q, v = in_contact(chain, rng)
        wrenches, alpha = readings(chain, pairs, q, v, rng.normal(size=8) * 20)
        bare = replace(
            state,
            Lambda_out=state.payload.Lambda,
            bias_out=state.payload.mu + state.payload.p,
        )
        f_c = contact_force(sum_of_wrenches(wrenches, state), bare, contact, FIXED)
        errors.append(np.abs(magnitudes(f_c, contact) - alpha).max())
    assert min(errors) > 0.1


def test_on_a_fixed_environment_the_filter_is_the_projection_omega_f():
    """Eq. 5 with Λ_out: idempotent, range N, kernel Λ_out T; a left inverse of N follows."""
    state, contact, *_ = in_contact(scara_pair(), np.random.default_rng(22))
    still = osc.Contact(contact.N)  # n_γ = 0: the offset is gone
    rest = replace(state, bias_out=np.zeros(6))
    Omega = np.column_stack([contact_force(e, rest, still, FIXED) for e in np.eye(6)])
    np.testing.assert_allclose(Omega @ Omega, Omega, atol=1e-10)
    np.testing.assert_allclose(Omega @ contact.N, contact.N, atol=1e-10)
    np.testing.assert_allclose(Omega @ state.Lambda_out @ contact.T, 0, atol=1e-10)
    for alpha in np.eye(2):
        np.testing.assert_allclose(magnitudes(still.N @ alpha, still), alpha, atol=1e-12)


def test_projected_power_is_zero_whatever_the_inertia():
    """Fig. 6: ϑᵀΩ_f(A) = 0 for every A, as long as the contact holds."""
    rng = np.random.default_rng(23)
    for _ in range(20):
        state, contact, *_ = in_contact(scara_pair(), rng)
        A = rng.normal(size=(6, 6))
        Omega_f = contact.force_projection(A @ A.T + 0.1 * np.eye(6))
        force = rng.normal(size=6) * 10
        total = abs(state.V_O @ force)
        assert abs(state.V_O @ Omega_f @ force) < 1e-11 * max(total, 1.0)


def test_force_law_integrates_and_damps_and_has_no_proportional_part():
    law = ForceLaw(osc.ForceGains(integral=30.0, damping=50.0), 1e-3)
    desired, measured = np.array([10.0, 8.0]), np.array([9.0, 8.5])
    first = law.command(desired, measured, np.array([0.01, 0.0]))
    np.testing.assert_allclose(first, [10 + 0.03 - 0.5, 8 - 0.015], rtol=1e-12)
    for _ in range(999):
        last = law.command(desired, measured, np.zeros(2))
    np.testing.assert_allclose(last - desired, [30.0, -15.0], rtol=1e-9)


@pytest.mark.parametrize("bad", [{"integral": -1.0}, {"damping": float("nan")}])
def test_bad_force_gains_are_refused(bad):
    with pytest.raises(osc.InvalidInputError, match="gain"):
        osc.ForceGains(**bad)


def test_an_integral_gain_without_stability_margin_is_refused():
    with pytest.raises(osc.InvalidInputError, match="stability margin"):
        ForceLaw(osc.ForceGains(integral=1000.0), 1e-3)


@pytest.mark.parametrize("sensor", ["panda_link7", "panda_link8", "panda_hand"])
def test_the_filter_is_exact_wherever_the_sensor_is_cut_in(sensor):
    """At a joint, at a fixed flange, at the hand: what is outboard is weighed, no more, no less."""
    body = osc.RigidObject(ROD)
    chain = osc.ClosedChain([panda_arm("arm", placed(), sensor)], [placed(0, 0, 0.05)], body)
    rng = np.random.default_rng(24)
    for _ in range(20):
        q, v = PANDA_Q + rng.uniform(-0.5, 0.5, 7), rng.normal(size=7)
        free = chain.state(q, v)
        pairs = random_faces(free.X_WO, 2, rng)
        v = consistent(chain, q, v, contact_of(pairs, free).N)
        state = chain.state(q, v)
        contact = contact_of(pairs, state)
        wrenches, alpha = readings(chain, pairs, q, v, rng.normal(size=7) * 20)
        f_c = contact_force(sum_of_wrenches(wrenches, state), state, contact, FIXED)
        got = magnitudes(f_c, contact)
        np.testing.assert_allclose(got, alpha, atol=1e-9 * max(np.abs(alpha).max(), 1.0))
