"""Friction compensation: N_μ in the wrist filter, feed-forward, and what it brings in a run."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from environment_oracle import kkt, wrist_readings
from environment_scenes import RTOL, close_to, scene
from readable.command_filter import (
    filtered_motion,
    generalised_force,
    object_acceleration,
    object_coordinates,
)
from readable.effort_limits import EffortLimits, relieve
from readable.force import contact_force, magnitudes, sum_of_wrenches
from rigs import panda_pair, scara_pair
from test_decoupling import commanded, in_contact
from test_effort_limits import weakened
from test_law import readable_of
from test_moving_environment import hardware, seen, squeeze_of, torques

import osc_contact as osc
from osc_contact.control.friction import Friction
from osc_contact.dynamics.environment import Environment
from osc_contact.runs.rig import build_rig


def by_hand(pair, X_WO, V_O, mu):
    """Coulomb's law at the contact point, fully developed: wrench at O for one newton."""
    p = pair.point_on_face(X_WO)
    arm = p - X_WO.translation
    v = V_O[:3] + np.cross(V_O[3:], arm)
    v = v - (v @ pair.normal) * pair.normal
    force = mu * v / np.linalg.norm(v)
    return np.concatenate((force, np.cross(arm, force)))


def test_the_drag_is_coulombs_law():
    rng = np.random.default_rng(0)
    friction = Friction(0.3, slip=1e-9)
    for _ in range(50):
        state, _, pairs, *_ = in_contact(scara_pair(), rng)
        got = friction.wrenches(pairs, state.X_WO, state.V_O, None)
        for column, pair in zip(got.T, pairs, strict=True):
            np.testing.assert_allclose(column, by_hand(pair, state.X_WO, state.V_O, 0.3), atol=1e-9)
            assert column[:3] @ pair.normal == pytest.approx(0.0, abs=1e-12)


def test_friction_takes_power_from_the_object_and_fades_at_rest():
    rng = np.random.default_rng(1)
    state, _, pairs, *_ = in_contact(scara_pair(), rng)
    V = state.V_O
    friction = Friction(0.2, slip=1e-3)
    assert (
        V @ friction.wrenches(pairs, state.X_WO, V, None)
    ).min() > 0.0  # given to the environment
    slow = friction.wrenches(pairs, state.X_WO, 1e-6 * V / np.abs(V).max(), None)
    assert np.abs(slow).max() < 1e-3


def test_only_motion_relative_to_a_moving_face_counts():
    rng = np.random.default_rng(2)
    state, _, pairs, *_ = in_contact(scara_pair(), rng)
    V_E = np.zeros((len(pairs), 6))
    X_WE = np.tile(np.eye(4), (len(pairs), 1, 1))
    V_E[:] = state.V_O  # carried along: at the world's origin, so shift to it
    V_E[:, :3] += np.cross(state.V_O[3:], -state.X_WO.translation)
    touched = osc.interface.Touched(X_WE, V_E, np.zeros_like(V_E))
    np.testing.assert_allclose(
        Friction(0.3).wrenches(pairs, state.X_WO, state.V_O, touched), 0.0, atol=1e-9
    )


def test_the_filter_is_exact_for_sliding_contacts_and_errs_without():
    """Wrists feel Λ_out a + bias + N_μα with Nᵀa = n_γ; α must come back."""
    rng = np.random.default_rng(3)
    fixed, friction = osc.Environment.fixed(), Friction(0.3, slip=1e-6)
    without = []
    for _ in range(50):
        state, contact, pairs, q, v = in_contact(scara_pair(), rng)
        alpha = rng.uniform(5, 15, contact.N.shape[1])
        friction_wrenches = friction.wrenches(pairs, state.X_WO, state.V_O, None)
        a = np.linalg.lstsq(contact.N.T, contact.n_gamma, rcond=None)[0]
        a = a + contact.T @ rng.normal(size=contact.T.shape[1])
        f_meas = state.Lambda_out @ a + state.bias_out + (contact.N + friction_wrenches) @ alpha
        got = magnitudes(contact_force(f_meas, state, contact, fixed, friction_wrenches), contact)
        np.testing.assert_allclose(got, alpha, rtol=1e-8)
        blind = magnitudes(contact_force(f_meas, state, contact, fixed), contact)
        without.append(np.abs(blind / alpha - 1).max())
        for believed, want in ((friction, alpha), (None, blind)):
            controller = osc.Controller(scara_pair(), pairs, friction=believed)
            controller.f_tare = -f_meas  # the wrists themselves say nothing
            silent = osc.Measurement(q, v, np.zeros((2, 6)))
            controller.tick(silent, osc.Reference(state.X_WO, alpha_d=alpha))
            np.testing.assert_allclose(controller.result().alpha_meas, want, rtol=1e-8)
    assert np.median(without) > 0.03


def sliding(s, mu):
    """What a controller of the scene is given, friction, and (6, r) wrenches: all slide."""
    (pairs, how), friction = seen(s), Friction(mu, slip=1e-9)
    return pairs, how, friction, friction.wrenches(pairs, s.state.X_WO, s.state.V_O, how["touched"])


YIELDING = ("prescribed", "rail", "hinge", "free body", "rail and free body", "hinged face",
            "prescribed and linkage", "three on two bodies")  # fmt: skip


@pytest.mark.parametrize("kind", YIELDING)
@pytest.mark.parametrize("rig", [scara_pair, panda_pair])
def test_law_and_filter_are_exact_on_bodies_that_friction_drags_along(rig, kind):
    """Against everything solved at once, each force leaning against its slip; 1e-9 relative."""
    rng, mu = np.random.default_rng(4), 0.3
    files, cuts = hardware(rig)
    without = []
    for _ in range(3):
        s = scene(rig, kind, rng)
        state, contact, N = s.state, s.contact, s.contact.N
        pairs, how, friction, friction_wrenches = sliding(s, mu)
        environment = Environment.combine(s.parts, s.each, state.metric, friction_wrenches)
        alpha_u, relative = rng.uniform(5, 20, contact.r), rng.normal(size=6) * 3
        a_u = object_acceleration(state, contact, environment, relative, alpha_u)
        eta_u, B = object_coordinates(state, contact, a_u), np.linalg.inv(state.metric)

        def answered(
            env,
            believed,
            s=s,
            friction_wrenches=friction_wrenches,
            alpha_u=alpha_u,
            eta_u=eta_u,
            B=B,
        ):
            eta_c = filtered_motion(s.state, s.contact, eta_u, alpha_u, B, env, believed)
            f_S = generalised_force(s.state, eta_c, (s.contact.N + friction_wrenches) @ alpha_u)
            tau = torques(s, f_S, eta_c)
            return kkt(s.chain, s.q, s.v, tau, s.bodies, s.touches, mu=mu), eta_c, tau

        truth, eta_c, tau = answered(environment, friction_wrenches)
        assert close_to(truth.alpha, alpha_u) < RTOL
        assert close_to(truth.a_object, state.S @ eta_c + state.sigma) < RTOL
        without.append(close_to(answered(s.environment, 0.0)[0].alpha, alpha_u))
        O = state.X_WO.translation  # noqa: E741
        sensed = wrist_readings(s.chain, files, cuts, s.q, s.v, truth, O)
        f_meas = sum_of_wrenches(sensed, state)
        got = magnitudes(
            contact_force(f_meas, state, contact, environment, friction_wrenches), contact
        )
        assert close_to(got, truth.alpha) < RTOL
        # what weaker motors will cost is foreseen: the forces that come are those foretold
        signals = SimpleNamespace(state=state, contact=contact,
                                friction_wrenches=friction_wrenches, environment=environment,
                                tau=tau, alpha_u=alpha_u, squeeze_d=0.0)  # fmt: skip
        wanted = EffortLimits(s.chain, pairs).response(signals, np.arange(len(pairs)))
        relief = relieve(replace(wanted, tau_max=0.9 * np.abs(tau) + 1e-3))
        came = kkt(s.chain, s.q, s.v, relief.tau, s.bodies, s.touches, mu=mu)
        np.testing.assert_allclose(alpha_u - came.alpha, relief.force, rtol=0, atol=1e-6)
        # and so is the law
        asked = s.q, s.v, a_u, alpha_u, B, squeeze_of(s)
        how |= {"friction": friction, "wrenches": sensed}
        controller, tau = commanded(s.chain, pairs, *asked, **how)
        found, reached = controller.result(), controller.signals
        assert close_to(found.alpha_meas, truth.alpha) < RTOL
        got = kkt(s.chain, s.q, s.v, tau, s.bodies, s.touches, mu=mu)
        assert close_to(got.alpha, alpha_u) < RTOL
        assert close_to(got.a_object, state.S @ reached.eta_c + state.sigma) < RTOL
        tired = weakened(s.chain, 0.7 * np.abs(tau) + 1e-3)
        controller, tau = commanded(tired, pairs, *asked, weak=True, **how)
        assert controller.status is osc.Status.SATURATED
        came = kkt(s.chain, s.q, s.v, tau, s.bodies, s.touches, mu=mu)
        np.testing.assert_allclose(
            alpha_u - came.alpha, controller.given_up.force, rtol=0, atol=1e-6
        )
        lost = got.a_object - came.a_object
        size = max(1.0, np.abs(got.a_object).max())
        np.testing.assert_allclose(lost, controller.given_up.acceleration, rtol=0, atol=1e-6 * size)
    assert (max(without) > 1e-3) == (kind != "prescribed")  # N in place of N_μ behind Φ_e
    assert N.shape[1] == len(s.touches)


def worst(mu, believed, *more, duration=2.0):
    friction = [] if believed is None else [f"control.friction={{mu: {believed}}}"]
    scenario = osc.load_scenario(
        "two_contact_rod_friction", [f"plant.friction={mu}", *friction, *more]
    )
    verdict = osc.metrics(osc.run(scenario, duration=duration))
    assert set(verdict["contact_fraction"].values()) == {1.0}
    return max(force["rms_error_rel"] for force in verdict["force"].values())


@pytest.mark.parametrize(
    ("mu", "believed", "limit"),
    [(0.1, 0.13, 0.02), (0.1, 0.07, 0.02), (0.3, 0.39, 0.05), (0.3, 0.21, 0.05)],
)
def test_forces_survive_friction_known_within_thirty_per_cent(mu, believed, limit):
    assert worst(mu, believed) <= limit


def test_without_compensation_friction_costs_twice_as_much():
    assert worst(0.3, None, "control.friction=null") > 2 * worst(0.3, 0.3)


def test_friction_on_contacts_without_known_points_is_refused():
    chain = scara_pair()
    pair = osc.Revolute(np.zeros(3), np.array([0.0, 0.0, 1.0]), name="hinge")
    with pytest.raises(osc.InvalidInputError, match=r"hinge.*where it touches"):
        osc.Controller(chain, [pair], friction=Friction(0.1))


@pytest.mark.parametrize("bad", [(-0.1, 1e-3), (0.1, 0.0), (float("nan"), 1e-3)])
def test_impossible_friction_is_refused(bad):
    with pytest.raises(osc.InvalidInputError, match="mu"):
        Friction(*bad)


def test_the_numpy_law_gives_up_the_same_on_a_cart_that_friction_drags_along():
    """Motors at their limits, a yielding face, friction, every tick."""
    weak = [f"arms.{name}.effort_factor=0.04" for name in ("left", "right")]
    at_once = "gains.force.rise=0 s"  # as in the NumPy law
    changes = ["control.friction={mu: 0.3}", "plant.friction=0.3", at_once, *weak]
    rig = build_rig(osc.load_scenario("moving_face", changes))
    fast = rig.controller().with_safety(osc.SafetySettings.motors_only())
    slow, plant = readable_of(fast), rig.plant(0)
    plant.hold(rig.controller().tick(rig.at_start(plant.measure()), rig.references.at(0.0)))
    wrenches = np.zeros(0)
    for k in range(60):
        measurement, reference = plant.measure(), rig.references.at(1e-3 * k)
        got, want = fast.tick(measurement, reference), slow.tick(measurement, reference)
        assert fast.status is slow.status is osc.Status.SATURATED
        wrenches = np.append(wrenches, np.abs(slow.last_signals().friction_wrenches).max())
        np.testing.assert_allclose(got, want, rtol=0, atol=1e-9 * np.abs(want).max())
        np.testing.assert_allclose(fast.given_up.force, slow.given_up.force, rtol=0, atol=1e-9)
        plant.command(got, 1e-3)
    assert wrenches[0] == 0.0 and wrenches[-1] > 0.1  # at rest, and sliding
