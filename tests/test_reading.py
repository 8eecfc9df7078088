"""Contact forces read by least squares: what friction and tilted faces do not fool."""

from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin
from numpy.linalg import cholesky, inv, lstsq, solve, svd
from numpy.random import default_rng
from pair_kinds import touching
from rigs import (
    UNLIMITED,
    assert_near,
    largest,
    one_panda,
    panda_pair,
    posed,
    product,
    random_faces,
    refused,
    shift,
    sliding,
)
from samples import aligned, chosen, first, parametrize
from scenario_runs import judged
from test_law import inputs, motion_of, off_their_faces

import osc_contact as osc
from benchmarks.cases import POINT
from osc_contact.dynamics.environment import Conveyor, Guided, Rail
from osc_contact.lab.runs.run import start


def point(changes=None, **control):
    """A Panda that slides a ball-nosed peg in a circle on a tilted face."""
    data = POINT | {"control": POINT["control"] | control}
    data["plant"] = POINT["plant"] | (changes or {})
    return osc.Scenario.model_validate(data)


# --- against MuJoCo -------------------------------------------------------------------------------


def test_unknown_friction_fools_the_filter_and_not_least_squares():
    friction = {"friction": 0.2}
    assert judged(point(friction, force={"reading": "filter"})) > 0.1
    error, sensing = judged(point(friction), "rms_error_rel", "sensing_rms_rel")
    assert error < 0.005 and sensing < 0.001
    unlearnt = point(friction, friction={"mu": 0.0, "learning": 0.0})
    error, sensing = judged(unlearnt, "rms_error_rel", "sensing_rms_rel")
    assert error < 0.03 and sensing < 0.002


@parametrize("mu", first([0.14, 0.26], 1))
def test_friction_known_within_thirty_per_cent(mu):
    assert judged(point({"friction": 0.2}, friction={"mu": mu})) < 0.005


def tilted(axis, reading):
    """The controller assumes a face turned by 5° about an axis."""

    def install(c):
        face = c.contacts[0]
        wrong = replace(face, normal=pin.exp3(np.deg2rad(5) * axis) @ face.normal)
        return osc.Controller(
            c.chain, [wrong], c.gains, dt=c.dt, posture=c.posture, reading=reading
        )

    return install


@parametrize("axis", first([[0.0, 1.0, 0.0], [0.93969, 0.0, 0.34202]], 1))
def test_a_normal_wrong_by_five_degrees(axis):
    wrong = {r: tilted(np.array(axis), r) for r in ("filter", "least_squares")}
    assert judged(point(), install=wrong["least_squares"]) < 0.01
    assert judged(point(), install=wrong["filter"]) > 0.02


LIMITS = {"three_arm_plate": 0.03, "ur5_wipe": 0.05, "scara_peg": 0.03}


@parametrize("mu", first([0.14, 0.26], 1))
@parametrize("name", chosen(LIMITS, "three_arm_plate"))
def test_faces_posts_and_corners_with_friction(name, mu):
    scenario = osc.load_scenario(name, ["plant.friction=0.2", f"control.friction={{mu: {mu}}}"])
    error, peak = judged(scenario, "rms_error_rel", "peak_error_rel")
    assert error < LIMITS[name] and peak < 2.0


def test_the_coefficient_is_learnt_while_the_contact_slides():
    for learning, low, high in ((5.0, 0.08, 0.12), (0.0, 0.0, 0.0)):
        rig = osc.build_rig(point({"friction": 0.2}, friction={"mu": 0.1, "learning": learning}))
        plant, controller = start(rig)
        osc.run_loop(plant, controller, rig.references.each(2000, 1e-3))
        assert low <= controller.records.memory.more_friction <= high


# --- what the answer does not depend on -----------------------------------------------------------


ALONG = 0.3
ACROSS = 0.1
DEPARTURE = 0.1
LEAST_FORCE = 1.0
NOISE = 0.01


def explained(f_meas, state, contact, environment, friction_wrenches, A_D, commanded, where):
    """Magnitudes α (r,) by one weighted system in α, tangential forces and departures.

    The law works with the covariance of what α does not explain. A_D (6,) is classical; commanded:
    forces of all columns; where: point from O, normal and s = v_t / √(v_t² + v_0²) of each.
    """
    N = contact.N
    metric = state.metric
    out = state.Lambda_out
    mass = metric[0, 0]
    r = contact.N.shape[1]
    pull = solve(metric, N)
    pull = pull @ inv(N.T @ pull)  # least motion for given normal accelerations
    a = A_D - product(state.V_O)
    a = a + pull @ (contact.n_gamma + N.T @ environment.b_e - N.T @ a)
    pushed = N + friction_wrenches
    H = pushed + out @ pull @ N.T @ environment.Phi_e @ pushed
    tangents = []
    for (p, n, s), force in aligned(where, commanded):
        basis = svd(n[None])[2][1:].T
        C = ACROSS**2 * np.eye(2) + (ALONG**2 - ACROSS**2) * np.outer(basis.T @ s, basis.T @ s)
        wrench = np.vstack((np.eye(3), pin.skew(p))) @ basis @ cholesky(C)
        wrench = wrench * max(abs(force), LEAST_FORCE)
        tangents.append(wrench + out @ pull @ (N.T @ environment.Phi_e @ wrench))
    L = cholesky(metric)
    free = svd(solve(L, N).T)[2][r:].T  # orthonormal, energy coordinates
    free = DEPARTURE * np.sqrt(mass) * solve(L.T, free)
    unlikely = np.hstack((*tangents, out @ free))
    sharp = np.sqrt(mass) / NOISE * inv(L)
    k = unlikely.shape[1]
    rows = np.vstack((sharp @ np.hstack((H, unlikely)), np.eye(k, r + k, r)))
    known = np.append(sharp @ (f_meas - state.bias_out - out @ a), np.zeros(k))
    return lstsq(rows, known, rcond=None)[0][:r]


def permitted_twist(signals, pairs, V_D, touched):
    """Twist nearest to V_D (6,), in kinetic energy, with which no contact opens or is entered."""
    N = signals.contact.N
    pull = solve(signals.state.metric, N)
    X_WO = signals.state.X_WO
    V_E = np.zeros((6, len(pairs)))
    for i in range(len(pairs) if touched else 0):
        lever = X_WO.translation - np.array(touched.X_WE[i])[:3, 3]
        V_E[:, i] = touched.V_E[i]
        V_E[:3, i] += np.cross(V_E[3:, i], lever)
    return V_D + pull @ solve(N.T @ pull, np.sum(N * V_E, axis=0) - N.T @ V_D)


@parametrize("body", [None, "conveyor", "cart"])
@parametrize("mu", [0.0, 0.4])
def test_the_law_finds_what_explains_the_reading_best(body, mu):
    """Vertices near their faces, on bodies at rest or moving; any reading.

    Friction is that of the slip two periods ahead, mostly of the commanded one.
    """
    cart = Guided(Rail([1, 2, 3], inertia=5.0, stiffness=100, damping=3, preload=2))
    on = {"conveyor": Conveyor(), "cart": cart}.get(body)
    chain = one_panda()
    rng = default_rng(6)
    slip = 0.01
    for k in range(8):
        q, v, X = posed(chain, rng)
        pairs = off_their_faces(X, 1 + k % 3, rng)
        n = len(pairs)
        how = {"bodies": [on] * n, "friction": osc.Friction(mu, slip) if mu else None}
        controller = osc.Controller(chain, pairs, reading="least_squares", safety=UNLIMITED, **how)
        touched = motion_of(rng, n) if body else None
        measurement, reference = inputs(chain, q, v, rng, n, touched)
        controller.tick(measurement, reference)
        assert controller.status is not osc.Status.HELD, controller.reason
        s = controller.signals
        known = slip if mu else osc.Friction(0.0).slip
        change = 2.0 * controller.dt * reference.A_D
        permitted = permitted_twist(s, pairs, reference.V_D + change, touched)
        to_come = s.state.V_O + change
        where = sliding(pairs, s.state.X_WO, to_come, permitted, touched, known)
        friction = np.reshape([mu * np.append(x, np.cross(p, x)) for p, _, x in where], (n, 6)).T
        assert_near(s.friction_wrenches, friction, atol=1e-10)
        expected = explained(
            s.f_meas, s.state, s.contact, s.environment, friction, reference.A_D, s.alpha_d, where
        )
        assert_near(s.alpha_meas, expected, atol=1e-7, rtol=1e-7)


# --- which contacts ------------------------------------------------------------------------------


#: Packaged pairs that push.
PUSHING = [
    "vertex_on_face",
    "sphere_on_plane",
    "face_on_vertex",
    "edge_on_edge",
    "edge_on_face",
    "cylinder_on_plane",
    "face_on_face",
]


def test_least_squares_is_chosen_where_a_contact_pushes_at_a_known_point():
    chain = one_panda()
    rng = default_rng(4)
    *_, X = posed(chain, rng)
    one, other = random_faces(X, 2, rng)
    shifted = replace(one, vertex=one.vertex + one.normal @ X.rotation * 0.0 + 0.01)

    def chosen(pairs, **how):
        return osc.Controller(chain, pairs, **how).reading

    assert all(chosen([touching(name, X, 4, 0.1)]) == "least_squares" for name in PUSHING)
    assert chosen([one, shifted]) == "least_squares"
    cylinder = (np.zeros(3), [1.0, 0, 0], 0.02)
    groove = osc.CylinderInVGroove(*cylinder, np.zeros(3), [1.0, 0, 0], [0, 0, 1.0])
    hinge = osc.Revolute([0, 0, 0], one.normal, X)
    assert chosen([]) == chosen([hinge]) == "filter"
    for pairs in ([groove], [one, other], [one, hinge]):
        assert chosen(pairs) == "least_squares"
    assert chosen([one], reading="filter") == "filter"
    assert chosen([hinge], reading="least_squares") == "least_squares"
    assert chosen([one], life=osc.PhaseSettings()) == "least_squares"


def read_at_rest(reading, pairs, alpha, rubbing, **how):
    """Contact forces that a controller reads of two Pandas at rest.

    Args:
        pairs: a function of the object's pose.
        alpha: (r,) true (N).
        rubbing: a function of the pose, the wrench of friction on the bodies touched, at O in world
            axes.
    """
    chain = panda_pair()
    q, _, X = posed(chain, default_rng(1))
    made = pairs(X)
    controller = osc.Controller(
        chain, made, reading=reading, posture=q, safety=UNLIMITED, joint_friction=False, **how
    )
    goal = osc.Reference(X, alpha_d=alpha)
    still = osc.Measurement(q, 0.0 * q, np.zeros((2, 6)))
    controller.tick(still, goal)
    N = np.hstack([pair.contact(X, np.zeros(6)).N for pair in made])
    wrench = N @ alpha + rubbing(X) + controller.result().bias_out
    to_sensor = chain.state(q).sensors[0].inverse() * shift(X.translation)
    wrenches = np.array([to_sensor.act(pin.Force(wrench)).vector, np.zeros(6)])
    controller.tick(replace(still, wrenches=wrenches), goal)
    return controller.result().alpha


def test_friction_along_a_hole_is_no_contact_force():
    """A peg that sticks in its hole, which the filter takes for couples and a push sideways."""
    seat = np.array([0.05, 0.08, 0.02])
    hole = partial(osc.Prismatic, seat, [0.0, 0.0, 1.0])
    alpha = np.array([3.0, -2.0, 0.1, 0.2, -0.1])

    def rubbing(X):
        along = 2.0 * X.rotation[:, 2]
        return np.append(along, np.cross(X.rotation @ seat, along))

    given = (lambda X: [hole(assembled=X)], alpha, rubbing)
    off = {r: largest(read_at_rest(r, *given) - alpha) for r in ("filter", "least_squares")}
    assert off["least_squares"] < 0.02 < 0.1 < off["filter"]


def test_a_hole_beside_a_vertex():
    """The vertex and the hole, with and without phases, as if each were there alone."""
    spot = np.array([-0.1, 0.05, -0.05])

    def pairs(X):
        hole = osc.Prismatic([0.05, 0.08, 0.02], [1.0, 0.0, 0.0], assembled=X)
        return [osc.VertexOnFace(spot, X.act(spot), X.rotation @ [1.0, 0.0, 0.0]), hole]

    alpha = np.array([6.0, 3.0, -2.0, 0.1, 0.2, -0.1])
    for life in (None, osc.PhaseSettings()):
        read = read_at_rest(None, pairs, alpha, lambda X: np.zeros(6), life=life)
        assert_near(read, alpha, atol=0.02)


def test_impossible_readings_are_refused():
    chain = one_panda()
    rng = default_rng(5)
    *_, X = posed(chain, rng)
    faces = random_faces(X, 1, rng)
    with refused("gyro"):
        osc.Controller(chain, faces, reading="gyro")


@parametrize("name", [n for n in osc.list_scenarios() if n.startswith("two_contact")])
def test_the_papers_scenarios_keep_the_papers_filter(name):
    assert osc.load_scenario(name).control.force.reading == "filter"
