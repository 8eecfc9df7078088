"""Detection of round shapes: balls, cylinders on their side, end or rim, capsules."""

import coal
import numpy as np
import pinocchio as pin
from detection_bodies import (
    AROUND,
    AXIS,
    BALL,
    CAN,
    DEPTHS,
    PILL,
    TABLE,
    UP,
    assert_only,
    moved,
    only,
    random_pose,
    standing,
)
from numpy.testing import assert_allclose
from pytest import mark, raises

from osc_contact.contacts.detection import CollisionShape, detect
from osc_contact.errors import ContactError

SEEDS = mark.parametrize("seed", range(4))


@SEEDS
def test_a_standing_cylinder_is_one_face_contact(seed):
    rng = np.random.default_rng(seed)
    depth = DEPTHS[seed % 3]
    X = standing(np.diag([1, -1, -1.0]) if seed % 2 else np.eye(3), AXIS, rng, lift=-depth)
    X_WE = random_pose(rng)
    X_WO = X_WE * X
    middle = X.translation * [1, 1, 0]
    three = moved(X_WE, middle + 0.03 * np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0]]))
    found = detect(CAN, X_WO, TABLE, X_WE)
    found = assert_only(found, "face on face", three, X_WE.rotation @ UP, X_WO, X_WE, -depth)
    radii = np.linalg.norm(found.points - X_WE.act(middle), axis=1)
    assert_allclose(radii, 0.03, atol=1e-9)


@SEEDS
def test_a_standing_capsule_touches_with_its_cap(seed):
    rng = np.random.default_rng(seed)
    X = standing(pin.rpy.rpyToMatrix(rng.uniform(0.1, 1.4), 0, 0), AXIS, rng, lift=0.03)
    low = X.translation + X.rotation @ AXIS[0] - 0.03 * UP
    found = assert_only(detect(PILL, X, TABLE), "sphere on plane", [low], UP, X)
    assert_allclose(found.object_point, AXIS[0], atol=1e-12)


RIM = np.array([[0, -0.03, -0.06]])  #: lowest point of a can: turning about x lifts +y


@SEEDS
@mark.parametrize("below", [False, True])
def test_a_cylinder_tipped_on_the_rim_of_its_end(below, seed):
    """Also as what lies under a face of the object; it rolls about its own axis, in contact."""
    rng = np.random.default_rng(seed)
    X = standing(pin.rpy.rpyToMatrix(rng.uniform(0.1, 1.4), 0, 0), RIM, rng)
    table = random_pose(rng)
    can = table * X
    roll = pin.exp6(pin.Motion(AROUND))
    up = table.rotation @ UP
    touch = [can.act(RIM[0])]
    if below:
        found = assert_only(detect(TABLE, table, CAN, can), "face on rim", touch, -up, table, can)
        assert_allclose(found.points, touch, atol=1e-9)
        assert_allclose(found.pair().gaps(table, can * roll), 0.0, atol=1e-9)
        return
    found = assert_only(detect(CAN, can, TABLE, table), "rim on face", touch, up, can, table)
    assert_allclose(found.object_point, RIM[0], atol=1e-9)
    assert_allclose(found.pair().gaps(can * roll, table), 0, atol=1e-9)
    spin = np.append(np.zeros(3), can.rotation[:, 2])
    rolling = found.pair().contact(can, spin, table)
    assert_allclose(rolling.N.T @ spin, 0.0, atol=1e-9)
    assert_allclose(rolling.n_gamma, 0.0, atol=1e-8)


def test_a_can_hardly_tipped_rolls_on_its_rim_and_a_large_one_sooner():
    """5 mrad: N from a gap that bends within 0.15 mm. A disc 2 m wide rises 1 mm in 0.8 mrad."""
    rng = np.random.default_rng(0)
    X = standing(pin.rpy.rpyToMatrix(5e-3, 0, 0), RIM, rng)
    assert_only(detect(CAN, X, TABLE), "rim on face", [X.act(RIM[0])], UP, X)
    for shape, turn, low, kind in (
        (coal.Cylinder(1.0, 0.1), 0.0, [0, -1.0, -0.05], "rim on face"),
        (coal.Cylinder(0.1, 2.0), np.pi / 2, [0, -0.1, -1.0], "rim on face"),
        (coal.Cylinder(0.3, 0.1), 0.0, [0, -0.3, -0.05], "face on face"),
        (coal.Cylinder(0.1, 0.6), np.pi / 2, [0, -0.1, -0.3], "cylinder on plane"),
    ):
        tilt = 0.8e-3 if turn == 0.0 else np.pi / 2 - 0.8e-3
        X = standing(pin.rpy.rpyToMatrix(tilt, 0, 0), np.array([low]), rng)
        X.translation = X.translation * [0, 0, 1]
        big = [CollisionShape("big", shape)]
        floor = [CollisionShape("floor", coal.Box(9, 9, 1), pin.SE3(np.eye(3), -0.5 * UP))]
        assert only(detect(big, X, floor)).kind == kind


@SEEDS
def test_the_side_of_a_can_on_a_corner_is_pushed_across_its_axis(seed):
    """Nearest point of the axis, overlapping by up to 3 mm: no solver knows this normal well."""
    rng = np.random.default_rng(seed)
    depth = (*DEPTHS, 3e-3)[seed % 4]
    n = np.append(rng.uniform(0.2, 1.0, 2), rng.uniform(0.2, 1.0))
    n /= np.linalg.norm(n)
    z = np.cross(n, rng.normal(size=3))
    z /= np.linalg.norm(z)
    corner = np.array([0.5, 0.4, 0.0])
    X = pin.SE3(np.column_stack((n, np.cross(z, n), z)), corner)
    X.translation = corner + (0.03 - depth) * n + 0.03 * rng.uniform(-1, 1) * z
    assert_only(detect(CAN, X, TABLE), "cylinder on vertex", [corner], n, X, gap=-depth)


@SEEDS
def test_a_ball_at_an_edge_and_at_a_corner_is_pushed_through_its_centre(seed):
    rng = np.random.default_rng(seed)
    outward = np.append(rng.uniform(0.2, 1.0, 2), 0.0)
    for kind, corner, away in (
        ("sphere on edge", np.array([0.5, 0.4, -0.05]), outward),
        ("sphere on vertex", np.array([0.5, 0.4, 0.0]), outward + rng.uniform(0.2, 1.0) * UP),
    ):
        n = away / np.linalg.norm(away)
        X = pin.SE3(np.eye(3), corner + 0.03 * n - BALL[0].placement.translation)
        found = assert_only(detect(BALL, X, TABLE), kind, [corner], n, X)
        assert_allclose(found.points, [corner], atol=1e-9)
        spin = np.concatenate((np.zeros(3), rng.normal(size=3)))  # in place: nothing moves
        spin[:3] = -np.cross(spin[3:], BALL[0].placement.translation)
        spun = found.pair().contact(X, spin)
        assert_allclose(spun.N.T @ spin, 0.0, atol=1e-9)
        assert_allclose(spun.n_gamma, [-n @ _centripetal(X, spin)], atol=1e-8)


def _centripetal(X, V):
    """What the ball's resting centre adds to N^T a_rel: a_O = -w x (w x centre), less w x v_O."""
    centre = X.rotation @ BALL[0].placement.translation
    w = V[3:]
    return -np.cross(w, np.cross(w, centre)) - np.cross(w, V[:3])


@SEEDS
def test_crossed_pills_touch_between_their_axes(seed):
    rng = np.random.default_rng(seed)
    lie = pin.rpy.rpyToMatrix(np.pi / 2, 0, 0)
    turn = pin.rpy.rpyToMatrix(0, 0, rng.uniform(0.2, np.pi - 0.2))
    s, t = rng.uniform(-0.05, 0.05, 2)
    below = pin.SE3(lie, np.zeros(3))
    above = pin.SE3(turn @ lie, np.zeros(3))
    above.translation = 0.06 * UP + below.act(np.array([0, 0, s])) - above.act(np.array([0, 0, t]))
    turned = random_pose(rng)
    meet = turned.act(below.act(np.array([0, 0, s])) + 0.03 * UP)
    X = turned * above, turned * below
    found = detect(PILL, X[0], PILL, X[1])
    found = assert_only(found, "cylinder on cylinder", [meet], turned.rotation @ UP, *X)
    assert_allclose(found.points, [meet], atol=1e-9)


def test_pills_side_by_side_have_no_pair():
    X = pin.SE3(np.eye(3), np.array([0.06, 0.0, 0.01]))
    found = only(detect(PILL, X, PILL))
    assert (found.kind, found.r) == ("cylinder on cylinder", 2)
    assert_allclose(np.sort(found.points[:, 2]), [-0.05, 0.06], atol=1e-9)
    with raises(ContactError, match=r"cylinder on cylinder along a line.*GapFunctions"):
        found.pair()


def test_a_rim_on_an_edge_has_no_pair():
    ledge = pin.SE3(pin.rpy.rpyToMatrix(np.pi / 4, 0, 0), np.zeros(3))  # an edge along x on top
    X = pin.SE3(pin.rpy.rpyToMatrix(0.6, 0, np.pi / 2), np.zeros(3))  # its rim runs along y there
    X.translation = ledge.act(np.array([0.0, 0.4, 0.0])) + 2e-4 * UP - X.act(RIM[0])
    found = only(detect(CAN, X, TABLE, ledge))
    assert (found.kind, found.r) == ("rim on edge", 1)
    assert_allclose(found.normal, UP, atol=5e-3)  # the solver's
    with raises(ContactError, match=r"rim of a cylinder.*GapFunctions"):
        found.pair()
