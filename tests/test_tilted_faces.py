"""Faces whose model is tilted: what sliding shows of their normals, and what that brings."""

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
from numpy.linalg import eigvalsh, lstsq, norm, solve
from pair_kinds import touching
from pytest import approx
from rigs import STILL, assert_near, one_panda, placed, pose_of, random_state, unit, velocity_at
from samples import parametrize
from scenario_runs import closed_force, judged, rig_of, verdict_of, worst_force
from test_moving_face import FACES
from test_reading import point

import osc_contact as osc

DT = 1e-3
SLIDES = 0.01


def circle(hertz, about=0.0, gains=None, **plant):
    """40 mm on a face that is assumed to be turned by 5°; 10 N."""
    data = point(plant).as_dict()
    for move in data["motion"]:
        move["signals"][0]["frequency"] = f"{hertz} Hz"
    data["gains"] = gains or {}
    data["model_error"] = {"face_tilt": "5 deg", "face_tilt_about": f"{about} deg"}
    return osc.Scenario.from_dict(data)


def slid(scenario, duration):
    """rad between the law's normal and the true one at last, and the given one; run, controller."""
    kept = []
    run = osc.run(scenario, duration=duration, install=lambda c: kept.append(c) or c)
    rig = rig_of(scenario)
    controller = max(kept, key=lambda c: c.records.memory.ticked)
    pairs = (*rig.pairs, *rig.controlled_pairs())
    n = pairs[1].normal - controller.records.memory.columns[0].turn
    return (*(np.arcsin(norm(np.cross(n, pair.normal))) for pair in pairs), run, controller)


@cache
def uncorrected(hertz, about):
    """Error of a force whose normal is not learned; two tests judge it."""
    return judged(circle(hertz, about, {"force": {"tilt": 0}}))


DEGREE = np.deg2rad(1.0)


# --- against MuJoCo -------------------------------------------------------------------------------


@parametrize("about", [0.0, 90.0])
def test_fast_circles_on_a_face_that_is_assumed_to_be_tilted(about):
    assert judged(circle(1.5, about)) < 0.01
    assert judged(circle(1.0, about, friction=0.2)) < 0.01
    assert uncorrected(1.0, about) > 0.03


@parametrize("hertz", [0.5, 0.75, 1.0])
def test_what_a_wrong_normal_costs_agrees_with_the_formula(hertz):
    """docs/tuning.md: of acceleration and brake that leak into the force."""
    cost = [uncorrected(hertz, about) for about in (0.0, 90.0)]
    rig = rig_of(circle(hertz))
    state = rig.state
    N = rig.pairs[0].contact(state.X_WO, STILL).N
    M = 1.0 / (N.T @ state.S @ solve(state.Lambda_S, state.S.T) @ N).item()
    w = 2 * np.pi * hertz
    K = 10 * np.pi
    leak = M * np.deg2rad(5) * 0.04 * w**2 / np.sqrt(2) / 10
    expected = leak * abs(1 + 1.4 * K / (K / 6 + 1j * w)) * w / np.hypot(w, K)
    assert np.mean(cost) == approx(expected, rel=0.25)


def test_the_normal_that_is_learnt_is_that_of_the_face():
    off, turned, *_ = slid(circle(0.5), 3.0)
    assert off < 0.1 * DEGREE and turned == approx(5.0 * DEGREE, abs=0.1 * DEGREE)
    off, turned, *_ = slid(circle(0.5, gains={"force": {"tilt": "3 deg"}}), 2.0)
    assert 2.5 * DEGREE < turned < 3.001 * DEGREE and off > 1.9 * DEGREE


def test_a_soft_face_is_not_taken_for_a_tilted_one():
    """It yields while it is slid on, and the force changes with the motion's frequency."""
    data = circle(0.5, solref=[0.03, 1.0], solimp=[0.1, 0.5, 0.003]).as_dict()
    sine = {"type": "sine", "amplitude": "5 N", "frequency": "0.5 Hz", "ramp": "1 s"}
    data["force"]["nose"].append(sine)
    data["model_error"]["face_tilt"] = 0
    off, _, run, _ = slid(osc.Scenario.from_dict(data), 3.0)
    assert off < DEGREE
    assert worst_force(osc.metrics(run)) < 0.01


def edge(about, **gains):
    """The packaged Panda on the edge of a table that is assumed to be turned by 5°."""
    tilt = ["model_error.face_tilt=5 deg", f"model_error.face_tilt_about={about} deg"]
    scenario = osc.load_scenario("panda_edge", tilt).replaced(gains=gains)
    return worst_force(verdict_of(scenario, duration=3.0))


@parametrize("about", [45.0, 90.0])
def test_an_edge_that_is_assumed_to_run_elsewhere(about):
    assert edge(about) < 0.002
    assert edge(about, force={"tilt": 0}) > 0.01


SOFT = ["plant.friction=0.2", "plant.solref=[0.03, 1]", "plant.solimp=[0.1, 0.5, 0.003]"]
SOFT += ["control.force.reading=least_squares", "duration=3 s"]


@parametrize("face", ["hinge with spring", "conveyor", "cart with spring"])
def test_the_estimate_is_not_worse_than_none_on_soft_faces_that_move(face):
    error = []
    for tilt in ("10 deg", "0"):
        changes = [*FACES[face], *SOFT, f"gains={{force: {{tilt: {tilt}}}}}"]
        error.append(closed_force(verdict_of("moving_face", *changes)))
    assert error[0] < error[1] + 0.001, error


def noisy(scenario, angle):
    """Rig with noisy encoders."""
    return scenario.replaced(sensors={"encoder": {"rate": "1 kHz", "angle": {"noise": angle}}})


@parametrize("about", [0.0, 45.0, 90.0, 135.0])
def test_the_covariance_is_that_of_the_error_and_settles(about):
    """Encoders are noisy; half of an error of 5° is corrected 0.4 s after the start."""
    off, _, run, controller = slid(noisy(circle(0.5, about), "0.02 mrad"), 3.0)
    std = run["normal_std"][:, 0]
    assert std[np.flatnonzero(np.isfinite(std))[0]] == approx(5.0 * DEGREE, rel=0.01)
    assert std[-1] < 1.5 * DEGREE
    assert np.sin(off) < 3.0 * std[-1]
    P = controller.normal_covariance[0]
    variances = eigvalsh(P)
    half = variances.sum() / 2.0
    pairs = (variances.sum() ** 2 - variances @ variances) / 2.0
    largest_of_two = np.sqrt(half + np.sqrt(half**2 - pairs))  # exact for rank two; n has turned
    assert controller.normal_std[0] == approx(largest_of_two, rel=1e-6)
    assert controller.normal_std[0] == approx(np.sqrt(variances[-1]), rel=0.01)
    assert_near(P, P.T, atol=1e-15)


@parametrize("about", [0.0, 90.0])
def test_it_settles_within_a_second_and_a_half(about):
    """docs/tuning.md: of 5°, in circles that begin within 1 s, forces within 0.25 s."""
    assert slid(circle(0.5, about), 0.9)[0] < DEGREE
    assert slid(circle(0.5, about), 1.6)[0] < 0.5 * DEGREE


def test_what_stands_keeps_its_face_and_its_uncertainty():
    _, turned, run, _ = slid(noisy(circle(0.5), "0.1 mrad").replaced(motion=[]), 3.0)
    assert turned == 0.0
    for std in (run["normal_std"][-1, 0], osc.metrics(run)["normals"]["nose"]):
        assert std == approx(5.0 * DEGREE, rel=0.01)


# --- what the law makes of it ---------------------------------------------------------------------


def point_of(pair, X, X_WE):
    """Sliding point in the world: a vertex, a centre, or the nearest point of the object's edge."""
    if isinstance(pair, osc.FaceOnVertex):
        return X_WE.act(pair.body_vertex)
    if not isinstance(pair, osc.EdgeOnEdge):
        return X.act(pair.centre if isinstance(pair, osc.SphereOnPlane) else pair.vertex)
    e = X.rotation @ pair.direction
    lines = np.column_stack((e, -pair.edge_direction))
    start = X.act(pair.point)
    return start + lstsq(lines, pair.edge_point - start, rcond=None)[0][0] * e


def turned_in_the_law(pair, turn, q, v, reference, touched):
    """N, n_γ and the next turn of a law whose pair is turned so far and slides off at 20 mm/s."""
    controller = osc.Controller(one_panda(), [pair], dt=DT)
    measurement = osc.Measurement(q, v, np.zeros((1, 6)), touched)
    controller.tick(measurement, reference)
    memory = controller.records.memory.columns[0]
    memory.turn[:] = turn
    memory.drift = 0.02
    controller.tick(measurement, reference)
    return (controller.signals.contact, controller.records.work.columns[0].turned)


def correction(shown, across):
    """Correction of a normal (3,) by the law for an error that sliding reveals."""
    square = shown @ shown
    share = square**2 / (square**2 + SLIDES**4)
    rate = 1 - np.exp(-osc.Gains().force.drift * DT)
    return rate * share * (across - 0.02) * shown / square


TURNED = ["vertex_on_face", "sphere_on_plane", "face_on_vertex"]


@parametrize(
    "kind, moving", [*product(TURNED, (False, True)), ("edge_on_edge", False)], ids=lambda x: f"{x}"
)
def test_a_turned_face_is_the_pair_with_that_normal_and_turns_by_the_law(kind, moving):
    """N and n_γ against the pair made anew; what shows of it, from a difference of its N."""
    rng = np.random.default_rng(11)
    for _ in range(5):
        q, v = random_state(one_panda(), rng)
        state = one_panda().state(q, v)
        X = state.X_WO
        X_WE = pose_of(rng) if moving else placed()
        V_E = 0.1 * rng.standard_normal(6) * moving
        at = (X, state.V_O, X_WE, V_E)
        pair = touching(kind, X_WE.actInv(X) * placed(0.01, 0.02, -0.01), rng.integers(99), 0.1)
        touched = osc.interface.Touched(X_WE.homogeneous[None], V_E[None], np.zeros((1, 6)))
        V_D = 0.3 * rng.standard_normal(6)
        reference = osc.Reference(X, V_D, alpha_d=[10.0])
        keys = {"edge_on_edge": "edge_direction", "sphere_on_plane": "face_normal"}
        key = keys.get(kind, "normal")
        sign = -1.0 if kind in ("vertex_on_face", "sphere_on_plane") else 1.0
        given = getattr(pair, key)
        new = unit(given + 0.03 * rng.standard_normal(3))
        turn = sign * (new - given)
        found, turned = turned_in_the_law(pair, turn, q, v, reference, touched if moving else None)
        other = replace(pair, **{key: new})
        expected = other.contact(*at)
        assert_near(found.N, expected.N, atol=1e-12)
        assert_near(found.n_gamma, expected.n_gamma, atol=1e-11)
        n = expected.N[:3, 0]
        point = point_of(other, X, X_WE)
        on_body = velocity_at(V_E, point - X_WE.translation)
        across = n @ (velocity_at(state.V_O, point - X.translation) - on_body)
        along = velocity_at(V_D, point - X.translation) - on_body
        steps = [replace(pair, **{key: new + 1e-6 * e}) for e in (*np.eye(3), *-np.eye(3))]
        normals = np.array([one.contact(*at).N[:3, 0] for one in steps])
        shown = (normals[:3] - normals[3:]) @ (along - (n @ along) * n) / 2e-6
        new = unit(new - correction(shown, across))
        assert_near(given + sign * turned, new, atol=1e-10)


def test_gains_for_one_mass_leave_faces_as_they_are_given():
    assert osc.ForceGains().tilt == approx(np.deg2rad(10))
    assert osc.ForceGains(30, 100).tilt == osc.ForceGains(bandwidth=5, tilt=0).tilt == 0.0
    assert osc.ForceGains(30, 100, tilt=0.1).tilt == 0.1
    plain = {"integral": 30}
    assert slid(circle(0.5, gains={"force": plain}), 1.2)[1] == 0.0
    assert slid(circle(0.5, gains={"force": plain | {"tilt": "10 deg"}}), 3.0)[0] < 0.3 * DEGREE
