"""Contact states: their likelihoods against least squares of scipy, invariance, groups, filter."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
from complaints import invalid_input, refusals
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import approx, fixture
from samples import parametrize
from scipy.optimize import nnls

import osc_contact as osc
from benchmarks.recognition import ERRORS as BELIEVED
from benchmarks.recognition import (
    Tally,
    Truth,
    Watch,
    square_peg_states,
    true_forces,
    true_instants,
)
from osc_contact.lab.checks.inspection import inspect_rig
from osc_contact.lab.checks.states import undistinguished, wrench_errors
from osc_contact.recognition.states import Columns

POSE = pin.SE3(pin.exp3(np.array([3.0, 0.2, -0.1])), np.array([0.5, 0.1, 0.3]))  #: of the hole
PEG, HOLE = osc.Peg("square", 0.02), osc.Hole("square", 0.0202, 0.03, POSE)
TOUCH = osc.pairs_between(PEG, HOLE)
X = POSE * pin.SE3(pin.exp3(np.array([0.15, -0.13, 0.02])), np.array([1e-4, 0.0, 1e-3]))
NAMES = {
    "free": [],
    "corner": ["corner +x+y on face"],
    "edge": ["edge +y on rim -x"],
    "edges": ["edge +y on rim -x", "edge +x on rim -y"],
    "side": ["side +x on rim +x, a", "side +x on rim +x, b"],
    "side and edges": [
        "side +x on rim +x, a",
        "side +x on rim +x, b",
        "edge +x on rim -y",
        "edge +y on rim -x",
    ],
}
LEAST = 0.4  #: N
ERRORS = osc.WrenchErrors(0.2, 0.02, (0.01, 0.0, -0.16), 1.2e-3, 0.02, 0.3, 6.0, LEAST)


@fixture(scope="module")
def states():
    return osc.ContactStates(NAMES, TOUCH, ERRORS)


def shifted(d):
    """Body displaced by d (6,), stated at the origin of the object, for a body at the world."""
    turn = pin.exp3(d[3:])
    O = X.translation
    return pin.SE3(turn, O + d[:3] - turn @ O)


def oracle(names, f):
    """Log-likelihood of one state, by scipy and a covariance written down apart."""
    N = [TOUCH[one].contact(X, np.zeros(6)).N[:, 0] for one in names]
    N = np.array(N).T.reshape(6, -1)
    h = 1e-5
    J = np.array(
        [
            [
                (
                    TOUCH[one].contact(X, np.zeros(6), shifted(h * e)).N[:, 0]
                    - TOUCH[one].contact(X, np.zeros(6), shifted(-h * e)).N[:, 0]
                )
                / (2 * h)
                for e in np.eye(6)
            ]
            for one in names
        ]
    ).reshape(-1, 6, 6)  # column, displacement, component
    lever = X.rotation @ ERRORS.sensor
    S_f = np.zeros((6, 6))
    for e in np.eye(3):
        force = 0.2 * np.concatenate((e, np.cross(lever, e)))
        couple = 0.02 * np.concatenate((np.zeros(3), e))
        S_f += np.outer(force, force) + np.outer(couple, couple)

    def fitted(S):
        root = np.linalg.cholesky(np.linalg.inv(S)).T
        if not names:
            return np.zeros(0), f @ np.linalg.solve(S, f)
        alpha, misfit = nnls(root @ N, root @ (f - LEAST * N.sum(axis=1)))
        return alpha + LEAST, misfit**2

    alpha, _ = fitted(S_f)
    S = S_f.copy()
    change = np.einsum("j,jda->da", alpha, J)
    for d, sigma in enumerate([1.2e-3] * 3 + [0.02] * 3):
        S += sigma**2 * np.outer(change[d], change[d])
    for one, n, a in zip(names, N.T, alpha, strict=True):
        point = TOUCH[one].points_of_contact(X)[:, 0] - X.translation
        axes = np.linalg.svd(n[None, :3])[2][1:]
        for t in axes:
            slide = 0.3 * a * np.concatenate((t, np.cross(point, t)))
            S += 0.5 * np.outer(slide, slide)
    _, squares = fitted(S)
    spread = S
    if names:
        spread = S + (6.0 / 0.2) ** 2 * N @ np.linalg.pinv(N.T @ np.linalg.solve(S_f, N)) @ N.T
    return -0.5 * squares - 0.5 * np.linalg.slogdet(spread)[1] + len(names) * np.log(2.0)


@parametrize("seed", range(6))
def test_likelihoods_are_those_of_constrained_least_squares(states, seed):
    rng = default_rng(seed)
    f = states.columns(X).N @ rng.uniform(0.0, 3.0, 5)
    f = f + rng.normal(size=6) * [0.5, 0.5, 0.5, 0.03, 0.03, 0.03]
    f *= -1.0 if seed == 5 else 1.0  # pulls: no state explains it
    found = states.log_likelihoods(X, f)
    assert_allclose(found, [oracle(own, f) for own in NAMES.values()], atol=2e-3)


@parametrize("seed", range(3))
def test_frame_origin_and_units_do_not_matter(states, seed):
    """Any other six coordinates of wrenches change all log-likelihoods by the same constant."""
    rng = default_rng(seed)
    A = rng.normal(size=(6, 6)) * [1, 1, 1, 1e3, 1e3, 1e3]
    there = states.columns(X)
    S_f = ERRORS.covariance(X)
    f = there.N @ rng.uniform(0.0, 3.0, 5)
    moved = Columns(A @ there.N, A @ there.J, A @ there.F @ A.T, there.exists)
    before, squares, alpha = states.judge(there, S_f, f)
    after, squares_after, alpha_after = states.judge(moved, A @ S_f @ A.T, A @ f)
    assert_allclose(after - before, -np.linalg.slogdet(A)[1], atol=1e-4)
    assert_allclose(squares_after, squares, atol=1e-4)
    assert_allclose(alpha_after, alpha, atol=1e-4)


def test_sizes_of_columns_do_not_matter(states):
    there = states.columns(X)
    f = there.N @ [1.0, 2.0, 0.5, 0.2, 1.0]
    sizes = np.array([2.0, 0.1, 30.0, 1.0, 5.0])
    each = sizes[:, None, None]
    other = Columns(there.N * sizes, there.J * each, there.F * each**2, there.exists)
    S_f = ERRORS.covariance(X)
    # ½ (μ α)² B Bᵀ with α smaller and B larger by the size; a least force has this size, too
    without = osc.ContactStates(NAMES, TOUCH, replace(ERRORS, least=0.0))
    before, _, _ = without.judge(there, S_f, f)
    after, _, _ = without.judge(other, S_f, f)
    assert_allclose(after, before, atol=1e-5)


def test_the_basis_of_a_pair_that_holds_does_not_matter():
    states = osc.ContactStates({"free": [], "in": ["hole"]}, TOUCH, ERRORS)
    there = states.columns(X)
    M = default_rng(1).normal(size=(5, 5))
    other = replace(there, N=there.N @ M, J=np.einsum("jk,jab->kab", M, there.J))
    f = there.N @ [1.0, -2.0, 0.5, 0.2, -1.0]
    S_f = ERRORS.covariance(X)
    assert_allclose(states.judge(other, S_f, f)[0], states.judge(there, S_f, f)[0], atol=1e-5)


def test_friction_of_a_contact_is_not_another_contact(states):
    """Half of μ along a rim leaves an edge an edge; three times as much presses the side."""
    there = states.columns(X)
    order = list(states.pairs)
    edge = there.N[:, order.index("edge +y on rim -x")]
    side = there.N[:, [order.index(f"side +x on rim +x, {k}") for k in "ab"]].mean(axis=1)

    def best(share):
        values = states.log_likelihoods(X, 6.0 * edge + share * 0.3 * 6.0 * side)
        return states.names[int(values.argmax())]

    assert best(0.0) == best(0.5) == "edge"
    assert best(3.0).startswith("side")


def test_edges_that_are_parallel_do_not_touch(states):
    turned = POSE * pin.SE3(pin.exp3(np.array([0.0, 0.0, np.pi / 2])), np.zeros(3))
    values = states.log_likelihoods(turned, np.array([0.0, 0.0, -5.0, 0.0, 0.0, 0.0]))
    named = dict(zip(states.names, values, strict=True))
    assert [name for name, value in named.items() if np.isneginf(value)] == [
        "edge",
        "edges",
        "side and edges",
    ]


# --- groups -------------------------------------------------------------------------------------


def wall_and_bottom(friction):
    """A peg on the bottom of a hole, that touches a wall at the same height, too."""
    wall = osc.VertexOnFace([0, 0, 0], POSE.act(np.array([0.01, 0, 0])), -POSE.rotation[:, 0])
    pairs = {"bottom": TOUCH["tip on bottom"], "wall": wall}
    names = {"free": [], "bottom": ["bottom"], "wall": ["wall"], "both": ["bottom", "wall"]}
    return osc.ContactStates(names, pairs, replace(ERRORS, friction=friction))


def test_a_wall_below_the_friction_of_the_bottom_is_not_distinguished():
    deep = POSE * pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.03]))
    separate = wall_and_bottom(0.1).groups(deep, force=6.0)
    assert separate == (("free",), ("bottom",), ("wall",), ("both",))
    joined = wall_and_bottom(0.9).groups(deep, force=6.0)
    assert joined == (("free",), ("bottom", "wall", "both"))


def test_states_that_a_sensor_does_not_see_are_one_group(states):
    coarse = osc.ContactStates(NAMES, TOUCH, replace(ERRORS, force=50.0, torque=5.0))
    assert len(coarse.groups(X)) == 1
    assert len(states.groups(X)) == len(NAMES)


# --- over time ----------------------------------------------------------------------------------


def test_a_change_is_recognised_within_some_instants(states):
    rng = default_rng(3)
    N = states.columns(X).N
    order = list(states.pairs)
    pairs = {"corner": "corner +x+y on face", "edge": "edge +y on rim -x"}
    noise = np.linalg.cholesky(ERRORS.covariance(X))

    def wrench(**forces):
        f = sum(a * N[:, order.index(pairs[one])] for one, a in forces.items())
        return f + noise @ rng.normal(size=6)

    recogniser = osc.Recogniser(states)
    assert_allclose(recogniser.probabilities, 1 / 6)
    for _ in range(20):
        recogniser.update(X, wrench(corner=6.0))
    assert recogniser.state == "corner" and recogniser.probability("corner") > 0.95
    assert recogniser.forces == {pairs["corner"]: approx(6.0, abs=0.7)}
    seen = []
    for _ in range(20):
        recogniser.update(X, wrench(edge=6.0))
        seen.append(recogniser.state)
    assert seen.index("edge") < 10 and set(seen[10:]) == {"edge"}
    assert recogniser.probability("edge", "edges") == approx(
        recogniser.probability("edge") + recogniser.probability("edges")
    )
    recogniser.reset()
    assert_allclose(recogniser.probabilities, 1 / 6)


def test_the_filter_is_that_of_bayes(states):
    """Against the sum over all sequences of states."""
    wrenches = states.columns(X).N @ default_rng(5).uniform(0.0, 1.0, (5, 4))
    L = np.array([states.log_likelihoods(X, f) for f in wrenches.T])
    L = np.exp(0.5 * (L - L.max(axis=1, keepdims=True)))
    recogniser = osc.Recogniser(states, 0.02, lasting=0.04, changes=5.0)
    for f in wrenches.T:
        recogniser.update(X, f)
    move = np.full((6, 6), (1 - np.exp(-0.1)) / 5)
    np.fill_diagonal(move, np.exp(-0.1))
    paths = np.einsum("ab,bc,cd,de,b,c,d,e->abcde", *[move] * 4, *L)
    expected = paths.sum(axis=(0, 1, 2, 3))
    assert_allclose(recogniser.probabilities, expected / expected.sum(), rtol=1e-9)


def test_a_plan_may_restrict_what_follows(states):
    following = {name: ["corner"] for name in states.names}
    recogniser = osc.Recogniser(states, following=following)
    recogniser.probabilities = np.eye(6)[0]
    edge = 6.0 * states.columns(X).N[:, list(states.pairs).index("edge +y on rim -x")]
    for _ in range(20):
        recogniser.update(X, edge)
    assert recogniser.state == "corner" and recogniser.probability("edge") == 0.0


def test_readings_that_are_no_numbers_change_nothing(states):
    recogniser = osc.Recogniser(states)
    recogniser.update(X, np.array([0, 0, -5.0, 0, 0, 0]))
    before = recogniser.probabilities
    recogniser.update(X, np.full(6, np.nan))
    assert recogniser.probabilities is before


def test_truth_of_the_benchmark():
    assert len(square_peg_states()) == 17
    R = POSE.rotation
    rows = np.full((4, 9), np.nan)
    half = 0.5 * HOLE.width
    places = {"edge -x": [-half, 4e-3, 0], "side +y": [2e-3, half, 0], "corner": [0.012, 0.013, 0]}
    normals = {"edge -x": [-0.2, 0, 0.98], "side +y": [0, 0.98, 0.2], "corner": [0, 0, 1]}
    for k, (name, place) in enumerate(places.items()):
        normal = R @ normals[name]
        rows[k] = [*POSE.act(np.array(place)), *normal, *((k + 1.0) * normal)]
    forces = true_forces(rows, HOLE)
    assert forces == approx({"edge -x": 1.0, "side +y": 2.0, "corner": 3.0}, rel=1e-3)
    assert BELIEVED.friction == 0.3
    assert Truth(forces).beyond(0.0) == {"side +y", "corner"}  # 1 N < 0.3 × 5 N
    assert Truth(forces).beyond(1.0) == {"corner"}
    assert Truth(forces).contacts == set(places)


class Alarmed:
    """Recogniser that has an alarm."""

    def unexpected(self, assumed):
        return "edge -x + side +y"


@parametrize("force, alarms", {1.4: 0, 0.0: 1})
def test_a_contact_that_chatters_is_no_false_alarm(force, alarms):
    """A side that touches in every third millisecond has a median of zero; without force it is."""
    hole = osc.Hole("square", 0.0202, 0.03)
    rows = np.full((19, 1, 9), np.nan)
    on_rim = [0.0101, 0.0, 0.0, 1.0, 0.0, 0.0, force, 0.0, 0.0]  # point, normal, force on it
    rows[::3, 0] = on_rim
    tally = Tally()
    watch = Watch(tally, assumed=frozenset({"corner"}))
    for truth in true_instants(rows, hole):
        assert truth.forces == {}
        watch.step(truth, frozenset({"corner"}), Alarmed())
    assert (tally.alarms, tally.alarms_by_median) == (alarms, 1)


def test_an_alarm_before_the_touch_is_false():
    """Contacts that follow an alarm do not excuse it."""
    hole = osc.Hole("square", 0.0202, 0.03)
    rows = np.full((19, 1, 9), np.nan)
    rows[1:, 0] = [0.0101, 0.0, 0.0, 1.0, 0.0, 0.0, 1.4, 0.0, 0.0]  # point, normal, force on it
    first = true_instants(rows, hole)[0]
    assert first.contacts and first.touched == frozenset()


test_refusals = refusals(
    invalid_input,
    {
        "no contact states": lambda: osc.ContactStates({}, TOUCH),
        "there is no contact 'rim'": lambda: osc.ContactStates({"a": ["rim"]}, TOUCH),
        "give a list of names": lambda: osc.ContactStates({"a": "hole"}, TOUCH),
        "have the same pairs": lambda: osc.ContactStates({"a": [], "b": []}, TOUCH),
        "has 7 columns of N": lambda: osc.ContactStates(
            {"a": ["hole", "tip on face", "tip on bottom"]}, TOUCH
        ),
        "force = 0": lambda: osc.WrenchErrors(force=0.0),
        "least = -1": lambda: osc.WrenchErrors(least=-1.0),
        "friction = -0.1": lambda: osc.WrenchErrors(friction=-0.1),
        "sensor": lambda: osc.WrenchErrors(sensor=(0.0, 1.0)),
        "period = 0": lambda: osc.Recogniser(osc.ContactStates({"a": []}, {}), 0.0),
        "following: there is no state 'b'": lambda: osc.Recogniser(
            osc.ContactStates({"a": []}, {}), following={"a": ["b"]}
        ),
        "there is no state 'c'": lambda: osc.Recogniser(
            osc.ContactStates({"a": []}, {})
        ).probability("c"),
    },
)


# --- what inspect says before a run ---------------------------------------------------------------

WALLS = ("'wall_x'", "'wall_y'", "'wall_x' and 'wall_y'")


@parametrize("noise, group", [(0.2, ()), (6.0, WALLS), (20.0, ("none", *WALLS))])
def test_inspect_names_sets_of_contacts_that_a_wrist_does_not_distinguish(noise, group):
    """A ball in a corner of two walls, whose wrenches are 90 degrees apart."""
    wrist = f"{{rate: 1 kHz, force: {{noise: {noise} N}}, torque: {{noise: {noise / 10} Nm}}}}"
    rig = osc.build_rig(osc.load_scenario("scara_peg", [f"sensors.wrist={wrist}"]))
    lines = [line for line in inspect_rig(rig).lines if line.startswith("not distinguished")]
    assert [line.rpartition(": ")[2] for line in lines] == ["; ".join(group) + "."] * bool(group)
    errors = wrench_errors(rig)
    assert (errors.force, errors.torque, errors.friction) == (noise, noise / 10, 0.3)
    at_sensor = rig.state.X_WO.act(np.asarray(errors.sensor))
    assert_allclose(at_sensor, rig.state.sensors[0].translation, atol=1e-12)


def test_sets_of_contacts_of_several_arms_are_not_judged():
    assert list(undistinguished(osc.build_rig("two_contact_rod"))) == []
