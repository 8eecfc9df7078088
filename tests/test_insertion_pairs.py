"""Pairs of pegs and holes: their gaps, N and n_γ against distances written down apart."""

import numpy as np
import pinocchio as pin
from complaints import invalid_input, refusals
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pair_kinds import Path
from pytest import fixture
from samples import parametrize

import osc_contact as osc
from benchmarks.held_holes import insert, misses
from osc_contact.contacts.insertion import CORNERS, SIDES

PEG, HOLE, DEPTH = 0.01, 0.0101, 0.03  #: halves of the widths, and depth (m)
STEP = 2e-3  #: s, of the differences
INTO = np.array([0.0, 0.0, 1.0])
POSE = pin.SE3(pin.exp3(np.array([3.0, 0.2, -0.1])), np.array([0.5, 0.1, 0.3]))  #: of the hole


def pairs_of(shape):
    peg = osc.Peg(shape, 2 * PEG)
    return osc.pairs_between(peg, osc.Hole(shape, 2 * HOLE, DEPTH, POSE))


PAIRS = {shape: pairs_of(shape) for shape in ("square", "round")}
POINTS = {**CORNERS, **SIDES}


def distance(shape, name):
    """Gap of a pair as a function of the pose of the peg in the frame of the hole."""
    if name.startswith("tip"):
        depth = DEPTH if name.endswith("bottom") else 0.0
        return lambda X: depth - X.translation[2]
    what, side, _, where, *rest = name.split()
    if what in ("corner", "point") and where == "face":
        return lambda X: -X.act(PEG * POINTS[side])[2]
    if where == "wall":
        return lambda X: HOLE - SIDES[rest[0]] @ X.act(PEG * POINTS[side])
    if what == "side":
        along = np.cross(INTO, SIDES[side])
        end = {"a": 1.0, "b": -1.0}.get(rest[-1], 0.0)
        if shape == "round" and end:  # 45° beside the side, on the round rim
            out = (SIDES[side] + end * along) / np.sqrt(2)
            return lambda X: out @ X.actInv(HOLE * out) - PEG
        away = 0.7 * end * HOLE * along
        return lambda X: SIDES[side] @ X.actInv(HOLE * SIDES[side] + away) - PEG
    if what == "edge":
        point, direction, out = PEG * SIDES[side], np.cross(INTO, SIDES[side]), -INTO
    else:  # a long edge on a rim
        point, direction, out = PEG * CORNERS[side], INTO, -SIDES[rest[0]]
    rim = SIDES[rest[0]]

    def between_lines(X):
        n = np.cross(X.rotation @ direction, np.cross(INTO, rim))
        n /= np.linalg.norm(n) * np.sign(n @ out)
        return n @ (X.act(point) - HOLE * rim)

    return between_lines


EVERY = [(shape, name) for shape in PAIRS for name in PAIRS[shape] if name != "hole"]


@fixture
def path():
    """Motion of the peg near the hole, tilted, in the frame of the hole."""
    rng = default_rng(61)
    p = np.array([[2e-3, -1e-3, 3e-3], *(0.02 * rng.standard_normal((2, 3)))])
    return Path(pin.exp3(np.array([0.15, -0.2, 0.1])), p, rng.standard_normal((2, 3)))


@parametrize("shape, name", EVERY)
def test_gaps_and_their_derivatives(shape, name, path):
    pair = PAIRS[shape][name]
    gap = distance(shape, name)
    X = POSE * path(0.0)
    assert_allclose(pair.gaps(X), gap(path(0.0)), atol=1e-12)
    times = STEP * np.arange(-2, 3)
    g = np.array([gap(path(t)) for t in times])
    rate = g @ [1, -8, 0, 8, -1] / (12 * STEP)
    V = np.concatenate((POSE.rotation @ path.p[1], POSE.rotation @ path.w[0]))
    contact = pair.contact(X, V)
    assert_allclose(contact.N.T @ V, -rate, atol=1e-7)
    second = g @ [-1, 16, -30, 16, -1] / (12 * STEP**2)
    A = 2.0 * np.concatenate((POSE.rotation @ path.p[2], POSE.rotation @ path.w[1]))
    A[:3] -= np.cross(V[3:], V[:3])  # spatial
    assert_allclose(contact.n_gamma - contact.N.T @ A, second, atol=1e-4)
    assert_allclose(contact.N.T @ contact.T, 0.0, atol=1e-12)


@parametrize("shape", PAIRS)
def test_a_peg_at_a_place_in_the_object_has_the_same_contacts(shape, path):
    """Gaps, N and n_γ of one of several pegs are those of the peg alone, at another origin."""
    place = pin.SE3(pin.exp3(np.array([0.3, -0.4, 0.2])), np.array([0.12, 0.03, -0.05]))
    peg = osc.Peg(shape, 2 * PEG, place)
    hole = osc.Hole(shape, 2 * HOLE, DEPTH, POSE)
    pairs = osc.pairs_between(peg, hole, prefix="left ")
    assert list(pairs) == [f"left {name}" for name in PAIRS[shape]]
    X_peg = POSE * path(0.0)
    X = X_peg * place.inverse()
    w = POSE.rotation @ path.w[0]
    to_peg = X_peg.translation - X.translation
    V_peg = np.concatenate((POSE.rotation @ path.p[1], w))
    V = np.concatenate((V_peg[:3] - np.cross(w, to_peg), w))
    for name, alone in PAIRS[shape].items():
        pair = pairs[f"left {name}"]
        assert pair.name == f"left {name}"
        assert_allclose(pair.gaps(X), alone.gaps(X_peg), atol=1e-12)
        contact, reference = pair.contact(X, V), alone.contact(X_peg, V_peg)
        shifted = reference.N + 0.0
        shifted[3:] += np.cross(to_peg, reference.N[:3], axisb=0).T
        # bases of a hole's directions follow the axes of the object: the spaces are the same
        change = np.linalg.lstsq(shifted, contact.N, rcond=None)[0]
        assert_allclose(shifted @ change, contact.N, atol=1e-10)
        assert_allclose(contact.N.T @ V, change.T @ (reference.N.T @ V_peg), atol=1e-10)
        if name != "hole":
            assert_allclose(change, 1.0, atol=1e-10)


@parametrize("shape, r, free", [("square", 5, [0, 0, 1, 0, 0, 0]), ("round", 4, None)])
def test_a_peg_in_its_hole_moves_along_its_axis(shape, r, free):
    pair = PAIRS[shape]["hole"]
    X = POSE * pin.SE3(np.eye(3), 0.01 * INTO)
    assert_allclose(pair.gaps(X), 0.0, atol=1e-12)
    contact = pair.contact(X, np.zeros(6))
    assert contact.r == r
    axis = np.concatenate((POSE.rotation @ INTO, np.zeros(3)))
    assert_allclose(contact.N.T @ axis, 0.0, atol=1e-12)
    turn = np.concatenate((np.zeros(3), POSE.rotation @ INTO))
    assert (np.abs(contact.N.T @ turn).max() < 1e-12) == (shape == "round")


def test_pairs_of_a_square_peg_touch_where_the_peg_leans():
    """A tilted peg whose corner is in the mouth rests on two rims with two edges: skew normals."""
    tilt = pin.exp3(0.25 * np.array([1.0, -1.0, 0.0]) / np.sqrt(2))
    pairs = pairs_of("square")
    chosen = [pairs["edge +y on rim -x"], pairs["edge +x on rim -y"]]
    low, high = -0.02, 0.02
    for _ in range(60):  # down, until both touch
        z = 0.5 * (low + high)
        X = POSE * pin.SE3(tilt, np.array([0.0, 0.0, z]))
        low, high = (z, high) if chosen[0].gaps(X)[0] > 0.0 else (low, z)
    N = np.hstack([pair.contact(X, np.zeros(6)).N for pair in chosen])
    assert_allclose([pair.gaps(X)[0] for pair in chosen], 0.0, atol=1e-9)
    assert np.linalg.norm(np.cross(N[:3, 0], N[:3, 1])) > 0.05


def test_a_hole_that_was_found():
    hole = osc.Hole("square", 2 * HOLE, DEPTH, POSE)
    found = POSE * pin.SE3(pin.exp3(np.array([0.02, 0.0, 0.01])), np.array([1e-3, 0.0, 2e-3]))
    X_WE = hole.found_at(found)
    X = found * pin.SE3(np.eye(3), 0.01 * INTO)
    assert_allclose(PAIRS["square"]["hole"].gaps(X, X_WE), 0.0, atol=1e-12)


test_refusals = refusals(
    invalid_input,
    {
        "shape = 'oval'": lambda: osc.Peg("oval", 0.02),
        "width = 0": lambda: osc.Peg("round", 0.0),
        "depth = -1": lambda: osc.Hole("round", 0.02, -1.0),
        "give the same shape": lambda: osc.pairs_between(
            osc.Peg("round", 0.02), osc.Hole("square", 0.021, 0.03)
        ),
        "the hole 20 mm": lambda: osc.pairs_between(
            osc.Peg("round", 0.02), osc.Hole("round", 0.02, 0.03)
        ),
    },
)


@parametrize("seed", [0, 11])
def test_a_held_peg_follows_a_hole_whose_axis_is_believed_wrong(seed):
    """By 2° and 1 mm, at zero force."""
    row = insert(seed)
    assert not misses(row) and row["largest force (N)"] < 10.0, row


def test_walls_of_a_rectangular_hole_are_as_far_apart_as_stated():
    peg = osc.Peg("square", 0.012, width_y=0.008)
    hole = osc.Hole("square", 0.0122, 0.03, width_y=0.0081)
    touch = osc.pairs_between(peg, hole)
    deep = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.01]))
    assert_allclose(touch["side +x on rim +x"].gaps(deep), 1e-4)
    assert_allclose(touch["side +y on rim +y"].gaps(deep), 5e-5)
    aside = pin.SE3(np.eye(3), np.array([1e-4, -5e-5, 0.01]))
    for name in ("corner +x-y on wall +x", "corner +x-y on wall -y"):
        assert_allclose(touch[name].gaps(aside), 0.0, atol=1e-12)


def test_rectangles_that_do_not_fit_are_refused():
    peg = osc.Peg("square", 0.012, width_y=0.008)
    with invalid_input("the peg is 8 mm wide and the hole 7 mm"):
        osc.pairs_between(peg, osc.Hole("square", 0.0122, 0.03, width_y=0.007))
    with invalid_input("width_y"):
        osc.Peg("round", 0.012, width_y=0.008)
    with invalid_input("width_y = 0.0"):
        osc.Hole("square", 0.012, 0.03, width_y=0.0)
