"""Friction compensation: N_μ in the wrist filter, feed-forward, and what it brings in a run."""

import numpy as np
from environment_scenes import RTOL, close_to, scene
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import approx, fixture, mark
from rigs import friction_wrenches, largest, panda_pair, refused, scara_pair
from test_decoupling import commanded, in_contact
from test_effort_limits import weakened
from test_moving_environment import object_acceleration, seen, squeeze_of

import osc_contact as osc
from benchmarks.cases import POINT
from benchmarks.reversals import register_plants, reversing
from osc_contact.dynamics.environment import Environment
from osc_contact.runs.rig import PLANT_TYPES, PLANTS, register_plant
from osc_contact.scenarios.control_schema import Friction


def by_hand(pair, X_WO, V_O, mu):
    """Coulomb's law at the contact point, fully developed: wrench at O for one newton."""
    p = pair.point_on_face(X_WO)
    arm = p - X_WO.translation
    v = V_O[:3] + np.cross(V_O[3:], arm)
    v = v - (v @ pair.normal) * pair.normal
    force = mu * v / np.linalg.norm(v)
    return np.concatenate((force, np.cross(arm, force)))


def test_the_drag_is_coulombs_law():
    rng = default_rng(0)
    friction = Friction(0.3, slip=1e-9)
    for _ in range(50):
        state, _, pairs, *_ = in_contact(scara_pair(), rng)
        got = friction_wrenches(friction, pairs, state.X_WO, state.V_O, None)
        for column, pair in zip(got.T, pairs, strict=True):
            assert_allclose(column, by_hand(pair, state.X_WO, state.V_O, 0.3), atol=1e-9)
            assert column[:3] @ pair.normal == approx(0.0, abs=1e-12)


def test_friction_takes_power_from_the_object_and_fades_at_rest():
    rng = default_rng(1)
    state, _, pairs, *_ = in_contact(scara_pair(), rng)
    V = state.V_O
    friction = Friction(0.2, slip=1e-3)
    assert (
        V @ friction_wrenches(friction, pairs, state.X_WO, V, None)
    ).min() > 0.0  # given to the environment
    slow = friction_wrenches(friction, pairs, state.X_WO, 1e-6 * V / largest(V), None)
    assert largest(slow) < 1e-3


def test_only_motion_relative_to_a_moving_face_counts():
    rng = default_rng(2)
    state, _, pairs, *_ = in_contact(scara_pair(), rng)
    V_E = np.zeros((len(pairs), 6))
    X_WE = np.tile(np.eye(4), (len(pairs), 1, 1))
    V_E[:] = state.V_O  # carried along: at the world's origin, so shift to it
    V_E[:, :3] += np.cross(state.V_O[3:], -state.X_WO.translation)
    touched = osc.interface.Touched(X_WE, V_E, np.zeros_like(V_E))
    assert_allclose(
        friction_wrenches(Friction(0.3), pairs, state.X_WO, state.V_O, touched), 0.0, atol=1e-9
    )


def sliding(s, mu):
    """What a controller of the scene is given, friction, and (6, r) wrenches: all slide."""
    (pairs, how) = seen(s)
    friction = Friction(mu, slip=1e-9)
    return (
        pairs,
        how,
        friction,
        friction_wrenches(friction, pairs, s.state.X_WO, s.state.V_O, how["touched"]),
    )


YIELDING = (
    "prescribed",
    "rail",
    "hinge",
    "free body",
    "rail and free body",
    "hinged face",
    "prescribed and linkage",
    "three on two bodies",
)


@mark.parametrize("kind", YIELDING)
@mark.parametrize("rig", [scara_pair, panda_pair])
def test_the_law_is_exact_on_bodies_that_friction_drags_along(rig, kind):
    """Against everything solved at once, each force leaning against its slip; 1e-9 relative."""
    rng = default_rng(4)
    mu = 0.3
    without = []
    for _ in range(3):
        s = scene(rig, kind, rng)
        state = s.state
        contact = s.contact
        N = s.contact.N
        pairs, how, friction, friction_wrenches = sliding(s, mu)
        environment = Environment.combine(s.parts, s.each, state.metric, friction_wrenches)
        alpha_u = rng.uniform(5, 20, contact.r)
        relative = rng.standard_normal(6) * 3
        a_u = object_acceleration(state, contact, environment, relative, alpha_u)
        B = np.linalg.inv(state.metric)
        asked = s.q, s.v, a_u, alpha_u, B, squeeze_of(s)
        how |= {"friction": friction}
        controller, tau = commanded(s.chain, pairs, *asked, **how)
        reached = controller.signals
        truth = s.solve(tau, mu)
        assert close_to(truth.alpha, alpha_u) < RTOL
        assert close_to(truth.a_object, state.S @ reached.eta_c + state.sigma) < RTOL
        blind = commanded(s.chain, pairs, *asked, **how | {"friction": None})[1]
        blind = s.solve(blind, mu)
        without.append(close_to(blind.alpha, alpha_u))
        # what weaker motors cost is foreseen
        tired = weakened(s.chain, 0.7 * np.abs(tau) + 1e-3)
        controller, tau = commanded(tired, pairs, *asked, weak=True, **how)
        assert controller.status is osc.Status.SATURATED
        came = s.solve(tau, mu)
        assert_allclose(alpha_u - came.alpha, controller.given_up.force, rtol=0, atol=1e-6)
        lost = truth.a_object - came.a_object
        size = max(1.0, largest(truth.a_object))
        assert_allclose(lost, controller.given_up.acceleration, rtol=0, atol=1e-6 * size)
    assert max(without) > 1e-3
    assert N.shape[1] == len(s.touches)


def worst(mu, believed, *more, duration=2.0):
    friction = [] if believed is None else [f"control.friction={{mu: {believed}}}"]
    scenario = osc.load_scenario(
        "two_contact_rod_friction", [f"plant.friction={mu}", *friction, *more]
    )
    verdict = osc.metrics(osc.run(scenario, duration=duration))
    assert set(verdict["contact_fraction"].values()) == {1.0}
    return max(force["rms_error_rel"] for force in verdict["force"].values())


@mark.parametrize(
    ("mu", "believed", "limit"),
    [(0.1, 0.13, 0.02), (0.1, 0.07, 0.02), (0.3, 0.39, 0.05), (0.3, 0.21, 0.05)],
)
def test_forces_survive_friction_known_within_thirty_per_cent(mu, believed, limit):
    assert worst(mu, believed) <= limit


def test_without_compensation_friction_costs_twice_as_much():
    assert worst(0.3, None, "control.friction=null") > 2 * worst(0.3, 0.3)


@fixture(autouse=True)
def registered():
    """Plants of the tests, taken out again."""
    before = dict(PLANTS), dict(PLANT_TYPES)
    register_plants()
    yield
    for register, content in zip((PLANTS, PLANT_TYPES), before, strict=True):
        register.clear()
        register.update(content)


def reversal_error(*which):
    verdict = osc.metrics(osc.run(reversing(*which), duration=3.0))
    assert verdict["contact_fraction"] == {"nose": 1.0}
    return verdict["force"]["nose"]["rms_error_rel"]


@mark.parametrize("known", [True, False])
@mark.parametrize("stroke", [(20, 2), (5, 4)])
def test_straight_reversals(stroke, known):
    assert reversal_error("mujoco", stroke, "across", 0.3, known) < 0.01
    assert reversal_error("mujoco", stroke, "steepest", 0.2, known) < 0.01


def test_reversals_on_rigid_faces_and_in_a_cone_that_strikes():
    """The exact plant knows no part of MuJoCo; one impedance for both directions lifts the peg."""
    assert reversal_error("exact", (20, 2), "across", 0.2, True) < 0.002
    assert reversal_error("elliptic", (20, 2), "across", 0.2, True) > 0.03


@mark.parametrize("solref", [[0.01, 1], [0.004, 0.7]])
def test_friction_leaves_a_face_as_stiff_as_it_is(solref):
    """How deep 10 N press the peg, against contacts without friction."""
    plants = []

    @register_plant("kept")
    def keep(rig, seed):
        plants.append(PLANTS["mujoco"](rig, seed))
        return plants[-1]

    for mu in (0.0, 0.2):
        plant = {**POINT["plant"], "type": "kept", "friction": mu, "solref": solref}
        osc.run(osc.Scenario.from_dict({**POINT, "plant": plant, "motion": []}), duration=0.5)
    depth = [float(plant.data.contact.dist[0]) for plant in plants]
    assert depth[1] == approx(depth[0], rel=0.1)


@mark.parametrize("mu", [0.1, 0.3])
def test_a_face_slides_on_a_face_with_friction(mu):
    scenario = osc.load_scenario("ur5_wipe", [f"plant.friction={mu}", "duration=3 s"])
    verdict = osc.metrics(osc.run(scenario))
    assert verdict["contact_fraction"] == {"cloth": 1.0}
    assert max(force["rms_error_rel"] for force in verdict["force"].values()) < 0.01


def test_friction_on_contacts_without_known_points_is_refused():
    chain = scara_pair()
    pair = osc.Revolute(np.zeros(3), np.array([0.0, 0.0, 1.0]), name="hinge")
    with refused(r"hinge.*points of contact"):
        osc.Controller(chain, [pair], friction=Friction(0.1))


@mark.parametrize("bad", [(-0.1, 1e-3), (0.1, 0.0), (float("nan"), 1e-3)])
def test_impossible_friction_is_refused(bad):
    with refused("mu"):
        Friction(*bad)
