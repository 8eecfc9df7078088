"""Detection: collision geometry and poses in, contacts out; judged by poses built by hand.

Poses are exact: a tipped box stands on the corner or edge that was put there, at a random place and
yaw; what N must span then follows from where its touching points are, without any detection.
"""

from __future__ import annotations

import textwrap
from itertools import product

import coal
import numpy as np
import pinocchio as pin
import pytest

import osc_contact as osc
from osc_contact import robots
from osc_contact.contacts import detection
from osc_contact.contacts.detection import CollisionShape, collision_shapes, detect
from osc_contact.errors import ContactError, InvalidInputError, ModelError

SIZE = np.array([0.10, 0.08, 0.06])
BOX = [CollisionShape("box", coal.Box(*SIZE))]
TABLE = [
    CollisionShape("table", coal.Box(1.0, 0.8, 0.1), pin.SE3(np.eye(3), np.array([0, 0, -0.05])))
]
"""Its top is z = 0."""
CORNERS = np.array(list(product((-0.5, 0.5), repeat=3))) * SIZE
SEEDS = range(100)
DEPTHS = (0.0, 5e-4, -5e-4)
"""Just touching, overlapping, a little apart (m); taken in turn."""
UP = np.array([0.0, 0.0, 1.0])


def moved(X, points):
    return np.asarray(points) @ X.rotation.T + X.translation


def standing(rotation, points, rng, lift=0.0):
    """A pose with this tilt (and random yaw) whose lowest of `points` is at z = lift."""
    R = pin.rpy.rpyToMatrix(0, 0, rng.uniform(-np.pi, np.pi)) @ rotation
    x, y = rng.uniform(-0.2, 0.2, 2)
    return pin.SE3(R, np.array([x, y, lift - (points @ R.T)[:, 2].min()]))


def random_pose(rng):
    return pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))


def pushes(points, directions, X_WO):
    """(6, k) wrenches at O of unit forces along `directions` at world `points`."""
    arms = np.asarray(points) - X_WO.translation
    directions = np.broadcast_to(directions, arms.shape)
    return np.hstack((directions, np.cross(arms, directions))).T


def assert_same_range(N, expected, tolerance=1e-9):
    """Equal spans, whatever the bases (moments in units of 0.1 m)."""
    scale = np.array([1, 1, 1, 10, 10, 10.0])[:, None]
    bases = [np.linalg.svd(scale * M, full_matrices=False) for M in (N, expected)]
    first, second = (svd.U[:, svd.S / svd.S[0] > 1e-6] for svd in bases)
    assert first.shape[1] == N.shape[1] == second.shape[1]
    np.testing.assert_allclose(first @ first.T, second @ second.T, atol=tolerance)


def assert_kept_by_its_pair(found, X_WO, X_WE, expected, gap=0.0):
    """`.pair()`: N spans what it should, the gaps vanish and n_γ follows from its N alone."""
    pair = found.pair()
    contact = pair.contact(X_WO, np.zeros(6), X_WE, np.zeros(6))
    assert contact.r == found.r
    assert_same_range(contact.N, expected)
    np.testing.assert_allclose(contact.n_gamma, 0.0, atol=1e-12)
    gaps = pair.gaps(X_WO, X_WE)
    assert gaps.shape == (found.r,)
    np.testing.assert_allclose(gaps, gap, atol=1e-9)
    assert (contact.N[:3].T @ found.normal < 0.0).all()  # into the environment


def only(found):
    assert len(found) == 1, [(d.name, d.kind, d.distance) for d in found]
    return found[0]


def seen_from(X, environment_pose, shapes, **options):
    """detect() with the object at X above the table, everything carried along to another pose."""
    return detect(shapes, environment_pose * X, TABLE, environment_pose, **options)


# A box on a table -----------------------------------------------------------------------------


@pytest.mark.parametrize("seed", SEEDS)
def test_a_box_flat_on_a_table_is_one_face_contact(seed):
    rng, depth = np.random.default_rng(seed), DEPTHS[seed % 3]
    X = standing(_quarter_turns(rng), CORNERS, rng, lift=-depth)
    X_WE = random_pose(rng)
    found = only(seen_from(X, X_WE, BOX))
    assert (found.kind, found.r, found.name) == ("face on face", 3, "box on table")
    lowest = moved(X, CORNERS)
    lowest = lowest[lowest[:, 2] < -depth + 1e-9]
    on_table = lowest * [1, 1, 0]
    assert len(found.points) == 4
    for corner in moved(X_WE, on_table):
        assert np.linalg.norm(found.points - corner, axis=1).min() < 1e-9
    up = X_WE.rotation @ UP
    np.testing.assert_allclose(found.normal, up, atol=1e-12)
    assert found.distance == pytest.approx(-depth, abs=1e-9)
    assert_kept_by_its_pair(
        found, X_WE * X, X_WE, pushes(moved(X_WE, lowest), -up, X_WE * X), -depth
    )


def _quarter_turns(rng):
    """One of the 24 orientations of a cube, exactly."""
    while True:
        R = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
        if np.linalg.det(R) > 0:
            return R


@pytest.mark.parametrize("seed", SEEDS)
def test_a_box_tipped_on_an_edge_is_one_line_contact(seed):
    rng, depth = np.random.default_rng(seed), DEPTHS[seed % 3]
    tilt = pin.rpy.rpyToMatrix(rng.uniform(0.05, np.pi / 2 - 0.05), 0, 0) @ _quarter_turns(rng)
    X = standing(tilt, CORNERS, rng, lift=-depth)
    X_WE = random_pose(rng)
    found = only(seen_from(X, X_WE, BOX))
    assert (found.kind, found.r) == ("edge on face", 2)
    lowest = moved(X, CORNERS)
    lowest = lowest[lowest[:, 2] < -depth + 1e-9]
    assert len(found.points) == len(lowest) == 2
    for corner in moved(X_WE, lowest * [1, 1, 0]):
        assert np.linalg.norm(found.points - corner, axis=1).min() < 1e-9
    assert found.distance == pytest.approx(-depth, abs=1e-9)
    up = X_WE.rotation @ UP
    assert_kept_by_its_pair(
        found, X_WE * X, X_WE, pushes(moved(X_WE, lowest), -up, X_WE * X), -depth
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_a_box_tipped_on_a_corner_is_one_point_contact(seed):
    rng, depth = np.random.default_rng(seed), DEPTHS[seed % 3]
    roll, pitch = rng.uniform(0.1, np.pi / 2 - 0.1, 2)
    X = standing(pin.rpy.rpyToMatrix(roll, pitch, 0), CORNERS, rng, lift=-depth)
    X_WE = random_pose(rng)
    found = only(seen_from(X, X_WE, BOX))
    assert (found.kind, found.r) == ("vertex on face", 1)
    corner = CORNERS[moved(X, CORNERS)[:, 2].argmin()]
    np.testing.assert_allclose(found.object_point, corner, atol=1e-12)
    np.testing.assert_allclose(found.points[0], X_WE.act(X.act(corner) + depth * UP), atol=1e-12)
    assert found.distance == pytest.approx(-depth, abs=1e-12)
    X_WO = X_WE * X
    declared = osc.VertexOnFace(corner, np.zeros(3), UP)
    V_O, V_E = rng.normal(size=(2, 6))
    mine, theirs = (p.contact(X_WO, V_O, X_WE, V_E) for p in (found.pair(), declared))
    np.testing.assert_allclose(mine.N, theirs.N, atol=1e-12)
    np.testing.assert_allclose(mine.n_gamma, theirs.n_gamma, atol=1e-9)
    np.testing.assert_allclose(found.pair().gaps(X_WO, X_WE), [-depth], atol=1e-12)


@pytest.mark.parametrize(("tilt", "kind"), [(0.5e-3, "face on face"), (2e-3, "edge on face")])
def test_the_angle_decides_between_a_face_and_its_edge(tilt, kind):
    X = standing(pin.rpy.rpyToMatrix(tilt, 0, 0), CORNERS, np.random.default_rng(0))
    assert only(detect(BOX, X, TABLE)).kind == kind
    assert only(detect(BOX, X, TABLE, angle=5e-3)).kind == "face on face"
    assert only(detect(BOX, X, TABLE, angle=1e-4)).kind == "edge on face"


def test_an_overhanging_box_touches_only_above_the_table():
    X = pin.SE3(np.eye(3), np.array([0.5, 0.1, 0.03]))
    found = only(detect(BOX, X, TABLE))
    assert (found.kind, found.r) == ("face on face", 3)
    np.testing.assert_allclose(found.points.min(axis=0), [0.45, 0.06, 0.0], atol=1e-12)
    np.testing.assert_allclose(found.points.max(axis=0), [0.50, 0.14, 0.0], atol=1e-12)


def test_an_overlap_narrower_than_the_margin_is_a_line():
    X = pin.SE3(np.eye(3), np.array([0.5496, 0.1, 0.03]))
    found = only(detect(BOX, X, TABLE))
    assert (found.kind, found.r) == ("edge on face", 2)
    ends = np.array([[0.4998, 0.06, 0.0], [0.4998, 0.14, 0.0]])
    np.testing.assert_allclose(found.points[np.argsort(found.points[:, 1])], ends, atol=1e-9)
    assert_kept_by_its_pair(found, X, pin.SE3.Identity(), pushes(ends, -UP, X))


@pytest.mark.parametrize("gap", [1.1e-3, 0.02, 1.0])
@pytest.mark.parametrize("seed", range(10))
def test_what_is_apart_does_not_touch(seed, gap):
    rng = np.random.default_rng(seed)
    for tilt in (np.eye(3), pin.rpy.rpyToMatrix(0.4, 0, 0), pin.rpy.rpyToMatrix(0.4, 0.6, 0)):
        X = standing(tilt, CORNERS, rng, lift=gap)
        assert detect(BOX, X, TABLE) == []
        assert len(detect(BOX, X, TABLE, margin=1.05 * gap)) == 1
    beside = pin.SE3(np.eye(3), np.array([0.55 + gap, 0.0, -0.02]))
    assert detect(BOX, beside, TABLE) == []


# Edges and vertices of the environment --------------------------------------------------------


@pytest.mark.parametrize("seed", SEEDS)
def test_crossed_edges_touch_in_their_crossing_point(seed):
    """Both boxes stand on an edge, roof against roof, ridges crossed at a random angle."""
    rng, depth = np.random.default_rng(seed), DEPTHS[seed % 3]
    lower = CollisionShape("ridge", coal.Box(0.4, 0.1, 0.1))
    roof = pin.rpy.rpyToMatrix(np.pi / 4 + rng.uniform(-0.2, 0.2), 0, 0)
    ridge = np.array([[x, y, z] for x in (-0.2, 0.2) for y, z in [(0.05, 0.05)]])
    upper = CORNERS[(CORNERS[:, 1] < 0) & (CORNERS[:, 2] < 0)]
    turn = rng.uniform(0.2, np.pi - 0.2)
    hang = pin.rpy.rpyToMatrix(0, 0, turn) @ pin.rpy.rpyToMatrix(
        np.pi / 4 + rng.uniform(-0.2, 0.2), 0, 0
    )
    X_WE, X_WO = pin.SE3(roof, np.zeros(3)), pin.SE3(hang, np.zeros(3))
    s, t = rng.uniform(-0.03, 0.03, 2)  # crossing point along either ridge
    meet = X_WE.act(ridge.mean(axis=0) + [s, 0, 0])
    X_WO.translation = meet - X_WO.act(upper.mean(axis=0) + [t, 0, 0]) - depth * UP
    turned = random_pose(rng)
    found = only(detect(BOX, turned * X_WO, [lower], turned * X_WE))
    assert (found.kind, found.r) == ("edge on edge", 1)
    np.testing.assert_allclose(found.points, [turned.act(meet)], atol=1e-9)
    np.testing.assert_allclose(found.normal, turned.rotation @ UP, atol=1e-9)
    assert found.distance == pytest.approx(-depth, abs=1e-9)
    np.testing.assert_allclose(
        turned.act(X_WO.act(found.object_point)), turned.act(meet - depth * UP), atol=1e-9
    )
    push = pushes([turned.act(meet)], -turned.rotation @ UP, turned * X_WO)
    assert_kept_by_its_pair(found, turned * X_WO, turned * X_WE, push, -depth)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_corner_of_the_environment_under_a_face_of_the_object(seed):
    """The box on its corner again, but now the table is held and the box is the environment."""
    rng, depth = np.random.default_rng(seed), DEPTHS[seed % 3]
    roll, pitch = rng.uniform(0.1, np.pi / 2 - 0.1, 2)
    X = standing(pin.rpy.rpyToMatrix(roll, pitch, 0), CORNERS, rng, lift=-depth)
    X_WO = random_pose(rng)
    found = only(detect(TABLE, X_WO, BOX, X_WO * X))
    assert (found.kind, found.r) == ("face on vertex", 1)
    corner = CORNERS[moved(X, CORNERS)[:, 2].argmin()]
    np.testing.assert_allclose(found.environment_point, corner, atol=1e-12)
    np.testing.assert_allclose(found.normal, -X_WO.rotation @ UP, atol=1e-12)
    touch = (X_WO * X).act(corner)
    np.testing.assert_allclose(found.points, [touch], atol=1e-12)
    push = pushes([touch], X_WO.rotation @ UP, X_WO)
    assert_kept_by_its_pair(found, X_WO, X_WO * X, push, -depth)


@pytest.mark.parametrize("seed", range(30))
def test_an_edge_of_the_environment_under_a_face_of_the_object(seed):
    rng = np.random.default_rng(seed)
    tilt = pin.rpy.rpyToMatrix(rng.uniform(0.1, 1.4), 0, 0)
    X = standing(tilt, CORNERS, rng)
    X_WO = random_pose(rng)
    found = only(detect(TABLE, X_WO, BOX, X_WO * X))
    assert (found.kind, found.r) == ("face on edge", 2)
    lowest = moved(X, CORNERS)
    touch = moved(X_WO, lowest[lowest[:, 2] < 1e-9])
    push = pushes(touch, X_WO.rotation @ UP, X_WO)
    assert_kept_by_its_pair(found, X_WO, X_WO * X, push)


# Round shapes ---------------------------------------------------------------------------------

BALL = [CollisionShape("ball", coal.Sphere(0.03), pin.SE3(np.eye(3), np.array([0.01, 0.02, 0.0])))]
CAN = [CollisionShape("can", coal.Cylinder(0.03, 0.12))]
PILL = [CollisionShape("pill", coal.Capsule(0.03, 0.12))]
AXIS = np.array([[0, 0, -0.06], [0, 0, 0.06]])
AROUND = np.array([0, 0, 0, 0, 0, 0.7])
"""A turn of the can about its own axis."""


@pytest.mark.parametrize("seed", range(50))
def test_a_ball_on_a_table(seed):
    rng, depth = np.random.default_rng(seed), DEPTHS[seed % 3]
    centre = np.array([[0.01, 0.02, 0.0]])
    X = standing(pin.exp3(rng.normal(size=3)), centre, rng, lift=0.03 - depth)
    X_WE = random_pose(rng)
    found = only(seen_from(X, X_WE, BALL))
    assert (found.kind, found.r) == ("sphere on plane", 1)
    np.testing.assert_allclose(found.object_point, centre[0], atol=1e-12)
    assert found.object_feature.radius == 0.03
    touch = X.act(centre[0]) * [1, 1, 0]
    np.testing.assert_allclose(found.points, [X_WE.act(touch)], atol=1e-9)
    assert found.distance == pytest.approx(-depth, abs=1e-12)
    push = pushes([X_WE.act(touch)], -X_WE.rotation @ UP, X_WE * X)
    assert_kept_by_its_pair(found, X_WE * X, X_WE, push, -depth)


@pytest.mark.parametrize("shapes", [CAN, PILL], ids=["can", "pill"])
@pytest.mark.parametrize("seed", range(50))
def test_a_lying_cylinder_is_one_line_contact(seed, shapes):
    rng, depth = np.random.default_rng(seed), DEPTHS[seed % 3]
    lie = pin.rpy.rpyToMatrix(np.pi / 2, 0, 0) @ pin.rpy.rpyToMatrix(0, 0, rng.uniform(-3, 3))
    X = standing(lie, AXIS, rng, lift=0.03 - depth)
    X_WE = random_pose(rng)
    found = only(seen_from(X, X_WE, shapes))
    assert (found.kind, found.r) == ("cylinder on plane", 2)
    touch = moved(X, AXIS) * [1, 1, 0]
    order = np.argsort(found.points @ (X_WE.rotation @ X.rotation[:, 2]))
    np.testing.assert_allclose(found.points[order], moved(X_WE, touch), atol=1e-9)
    assert found.distance == pytest.approx(-depth, abs=1e-9)
    push = pushes(moved(X_WE, touch), -X_WE.rotation @ UP, X_WE * X)
    assert_kept_by_its_pair(found, X_WE * X, X_WE, push, -depth)


@pytest.mark.parametrize("seed", range(50))
def test_a_standing_cylinder_is_one_face_contact(seed):
    rng, depth = np.random.default_rng(seed), DEPTHS[seed % 3]
    X = standing(np.diag([1, -1, -1.0]) if seed % 2 else np.eye(3), AXIS, rng, lift=-depth)
    X_WE = random_pose(rng)
    found = only(seen_from(X, X_WE, CAN))
    assert (found.kind, found.r) == ("face on face", 3)
    middle = X.translation * [1, 1, 0]
    radii = np.linalg.norm(found.points - X_WE.act(middle), axis=1)
    np.testing.assert_allclose(radii, 0.03, atol=1e-9)
    three = middle + 0.03 * np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0]])
    push = pushes(moved(X_WE, three), -X_WE.rotation @ UP, X_WE * X)
    assert_kept_by_its_pair(found, X_WE * X, X_WE, push, -depth)


@pytest.mark.parametrize("seed", range(30))
def test_a_standing_capsule_touches_with_its_cap(seed):
    rng = np.random.default_rng(seed)
    X = standing(pin.rpy.rpyToMatrix(rng.uniform(0.1, 1.4), 0, 0), AXIS, rng, lift=0.03)
    found = only(detect(PILL, X, TABLE))
    assert (found.kind, found.r) == ("sphere on plane", 1)
    np.testing.assert_allclose(found.object_point, AXIS[0], atol=1e-12)


@pytest.mark.parametrize("seed", range(30))
def test_a_cylinder_tipped_on_the_rim_of_its_end(seed):
    rng = np.random.default_rng(seed)
    tilt = rng.uniform(0.1, 1.4)
    R = pin.rpy.rpyToMatrix(tilt, 0, 0)
    rim = np.array([[0, -0.03, -0.06]])  # lowest point: turning about x lifts +y
    X = standing(R, rim, rng)
    found = only(detect(CAN, X, TABLE))
    assert (found.kind, found.r) == ("rim on face", 1)
    np.testing.assert_allclose(found.object_point, rim[0], atol=1e-9)
    push = pushes([X.act(rim[0])], -UP, X)
    assert_kept_by_its_pair(found, X, pin.SE3.Identity(), push)
    roll = np.append(np.zeros(3), X.rotation[:, 2])  # about its own axis: it stays on the table
    rolling = found.pair().contact(X, roll)
    np.testing.assert_allclose(rolling.N.T @ roll, 0.0, atol=1e-9)
    np.testing.assert_allclose(rolling.n_gamma, 0.0, atol=1e-8)
    np.testing.assert_allclose(found.pair().gaps(X * pin.exp6(pin.Motion(AROUND))), 0, atol=1e-9)


@pytest.mark.parametrize("seed", range(30))
def test_a_rim_of_the_environment_under_a_face_of_the_object(seed):
    rng = np.random.default_rng(seed)
    rim = np.array([[0, -0.03, -0.06]])
    X = standing(pin.rpy.rpyToMatrix(rng.uniform(0.1, 1.4), 0, 0), rim, rng)
    X_WO = random_pose(rng)
    found = only(detect(TABLE, X_WO, CAN, X_WO * X))
    assert (found.kind, found.r) == ("face on rim", 1)
    touch = (X_WO * X).act(rim[0])
    np.testing.assert_allclose(found.points, [touch], atol=1e-9)
    push = pushes([touch], X_WO.rotation @ UP, X_WO)
    assert_kept_by_its_pair(found, X_WO, X_WO * X, push)
    turned = X_WO * X * pin.exp6(pin.Motion(AROUND))
    np.testing.assert_allclose(found.pair().gaps(X_WO, turned), 0.0, atol=1e-9)


@pytest.mark.parametrize("seed", range(30))
def test_a_ball_of_the_environment_under_a_face_of_the_object(seed):
    rng = np.random.default_rng(seed)
    centre = BALL[0].placement.translation[None, :]
    X = standing(pin.exp3(rng.normal(size=3)), centre, rng, lift=0.03)
    X_WO = random_pose(rng)
    found = only(detect(TABLE, X_WO, BALL, X_WO * X))
    assert (found.kind, found.r) == ("plane on sphere", 1)
    touch = X_WO.act(X.act(centre[0]) * [1, 1, 0])
    np.testing.assert_allclose(found.points, [touch], atol=1e-9)
    push = pushes([touch], X_WO.rotation @ UP, X_WO)
    assert_kept_by_its_pair(found, X_WO, X_WO * X, push)


@pytest.mark.parametrize("seed", range(30))
def test_a_ball_at_an_edge_and_at_a_corner_is_pushed_through_its_centre(seed):
    rng = np.random.default_rng(seed)
    outward = np.append(rng.uniform(0.2, 1.0, 2), 0.0)
    for kind, corner, away in (
        ("sphere on edge", np.array([0.5, 0.4, -0.05]), outward),
        ("sphere on vertex", np.array([0.5, 0.4, 0.0]), outward + rng.uniform(0.2, 1.0) * UP),
    ):
        n = away / np.linalg.norm(away)
        X = pin.SE3(np.eye(3), corner + 0.03 * n - BALL[0].placement.translation)
        found = only(detect(BALL, X, TABLE))
        assert (found.kind, found.r) == (kind, 1)
        np.testing.assert_allclose(found.normal, n, atol=1e-9)
        np.testing.assert_allclose(found.points, [corner], atol=1e-9)
        push = pushes([corner], -n, X)
        assert_kept_by_its_pair(found, X, pin.SE3.Identity(), push)
        spin = np.concatenate((np.zeros(3), rng.normal(size=3)))  # in place: nothing moves
        spin[:3] = -np.cross(spin[3:], BALL[0].placement.translation)
        spun = found.pair().contact(X, spin)
        np.testing.assert_allclose(spun.N.T @ spin, 0.0, atol=1e-9)
        np.testing.assert_allclose(spun.n_gamma, [-n @ _centripetal(X, spin)], atol=1e-8)


def _centripetal(X, V):
    """What the ball's resting centre adds to N^T a_rel: a_O = -w x (w x centre), less w x v_O."""
    centre, w = X.rotation @ BALL[0].placement.translation, V[3:]
    return -np.cross(w, np.cross(w, centre)) - np.cross(w, V[:3])


@pytest.mark.parametrize("seed", range(30))
def test_crossed_pills_touch_between_their_axes(seed):
    rng = np.random.default_rng(seed)
    lie = pin.rpy.rpyToMatrix(np.pi / 2, 0, 0)
    turn = pin.rpy.rpyToMatrix(0, 0, rng.uniform(0.2, np.pi - 0.2))
    s, t = rng.uniform(-0.05, 0.05, 2)
    below = pin.SE3(lie, np.zeros(3))
    above = pin.SE3(turn @ lie, np.zeros(3))
    above.translation = 0.06 * UP + below.act(np.array([0, 0, s])) - above.act(np.array([0, 0, t]))
    turned = random_pose(rng)
    found = only(detect(PILL, turned * above, PILL, turned * below))
    assert (found.kind, found.r) == ("cylinder on cylinder", 1)
    meet = turned.act(below.act(np.array([0, 0, s])) + 0.03 * UP)
    np.testing.assert_allclose(found.points, [meet], atol=1e-9)
    push = pushes([meet], -turned.rotation @ UP, turned * above)
    assert_kept_by_its_pair(found, turned * above, turned * below, push)


def test_pills_side_by_side_have_no_pair():
    X = pin.SE3(np.eye(3), np.array([0.06, 0.0, 0.01]))
    found = only(detect(PILL, X, PILL))
    assert (found.kind, found.r) == ("cylinder on cylinder", 2)
    with pytest.raises(ContactError, match=r"cylinder on cylinder along a line.*GapFunctions"):
        found.pair()


def test_a_rim_on_an_edge_has_no_pair():
    low = np.array([0.0, -0.03, -0.06])
    ledge = pin.SE3(pin.rpy.rpyToMatrix(np.pi / 4, 0, 0), np.zeros(3))  # an edge along x on top
    X = pin.SE3(pin.rpy.rpyToMatrix(0.6, 0, np.pi / 2), np.zeros(3))  # its rim runs along y there
    X.translation = ledge.act(np.array([0.0, 0.4, 0.0])) + 2e-4 * UP - X.act(low)
    found = only(detect(CAN, X, TABLE, ledge))
    assert (found.kind, found.r) == ("rim on edge", 1)
    np.testing.assert_allclose(found.normal, UP, atol=5e-3)  # the solver's
    with pytest.raises(ContactError, match=r"rim of a cylinder.*GapFunctions"):
        found.pair()


# The rod of the scenario ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def rod():
    """(rod's shapes, declared pairs, (plate's shapes, pose) of each, start pose)."""
    rig = osc.build_rig(osc.load_scenario("two_contact_rod"))
    plate = collision_shapes(robots.urdf_path("face.urdf"))
    plates = [(plate, pair.face_placement()) for pair in rig.pairs]
    return collision_shapes(robots.urdf_path("rod.urdf")), rig.pairs, plates, rig.state().X_WO


def on_the_faces(pairs, X, motion):
    """X moved by `motion` (6,) at O, then pushed back onto the faces along N."""
    X = pin.SE3(pin.exp3(motion[3:]) @ X.rotation, X.translation + motion[:3])
    for _ in range(20):
        N = osc.Contact.stack([pair.contact(X, np.zeros(6)) for pair in pairs]).N
        gaps = np.array([pair.gap(X) for pair in pairs])
        step = N @ np.linalg.solve(N.T @ N, gaps)
        X = pin.SE3(pin.exp3(step[3:]) @ X.rotation, X.translation + step[:3])
    assert np.abs([pair.gap(X) for pair in pairs]).max() < 1e-14
    return X


@pytest.mark.parametrize("seed", range(201))
def test_the_rod_finds_the_contacts_the_scenario_declares(rod, seed):
    shapes, declared, plates, X_start = rod
    rng = np.random.default_rng(seed)
    motion = np.concatenate((rng.uniform(-0.04, 0.04, 3), rng.uniform(-0.2, 0.2, 3)))
    X_WO = X_start if seed == 0 else on_the_faces(declared, X_start, motion)
    V_O, V_E = rng.normal(size=(2, 6))
    found = [detect(shapes, X_WO, plate, X_WE) for plate, X_WE in plates]
    assert [[d.name for d in some] for some in found] == [
        ["left_end on plate"],
        ["right_end on plate"],
    ]
    for (contact,), pair, (_, X_WE) in zip(found, declared, plates, strict=True):
        assert (contact.kind, contact.r) == ("sphere on plane", 1)
        in_plate = osc.VertexOnFace(pair.vertex, np.zeros(3), UP, pair.radius)
        mine = contact.pair().contact(X_WO, V_O, X_WE, V_E)
        theirs = in_plate.contact(X_WO, V_O, X_WE, V_E)
        at_rest = pair.contact(X_WO, V_O)
        np.testing.assert_allclose(mine.N, at_rest.N, atol=1e-9)
        np.testing.assert_allclose(mine.n_gamma, theirs.n_gamma, atol=1e-9)
        still = contact.pair().contact(X_WO, V_O, X_WE, np.zeros(6))
        np.testing.assert_allclose(still.n_gamma, at_rest.n_gamma, atol=1e-9)
        np.testing.assert_allclose(contact.points, [pair.point_on_face(X_WO)], atol=1e-9)
        np.testing.assert_allclose(contact.normal, -pair.direction(), atol=1e-12)


def test_both_plates_as_one_environment_body(rod):
    shapes, declared, plates, X_WO = rod
    both = [
        CollisionShape(name, plate[0].shape, X_WE * plate[0].placement)
        for name, (plate, X_WE) in zip("ab", plates, strict=True)
    ]
    found = detect(shapes, X_WO, both)
    assert [d.name for d in found] == ["left_end on a", "right_end on b"]
    N = osc.Contact.stack([d.pair().contact(X_WO, np.zeros(6)) for d in found]).N
    expected = osc.Contact.stack([pair.contact(X_WO, np.zeros(6)) for pair in declared]).N
    np.testing.assert_allclose(N, expected, atol=1e-9)


# Found twice ----------------------------------------------------------------------------------


def test_a_rim_inside_a_ball_gives_way_to_the_ball(rod):
    """The rod nearly flat: its shaft's rim is closer to the table than the margin too."""
    shapes = rod[0]
    for tilt in (0.01, 0.1, 0.3):
        R = pin.rpy.rpyToMatrix(0, tilt, 0)
        X = pin.SE3(R, np.array([0, 0, 0.01 + 0.29 * np.sin(tilt)]))
        shaft = [shape for shape in shapes if shape.name == "shaft"]
        assert only(detect(shaft, X, TABLE)).kind == "rim on face"
        found = only(detect(shapes, X, TABLE))
        assert (found.name, found.kind) == ("right_end on table", "sphere on plane")


def test_the_lying_rod_is_one_line(rod):
    found = only(detect(rod[0], pin.SE3(np.eye(3), np.array([0, 0, 0.01])), TABLE))
    assert (found.name, found.kind, found.r) == ("shaft on table", "cylinder on plane", 2)


def test_two_feet_make_one_face_and_two_balls_two_points():
    def pair_of(shape):
        return [
            CollisionShape(f"foot{x:+.1f}", shape, pin.SE3(np.eye(3), np.array([x, 0, 0])))
            for x in (-0.1, 0.1)
        ]

    X = pin.SE3(np.eye(3), np.array([0, 0, 0.02]))
    found = only(detect(pair_of(coal.Box(0.04, 0.04, 0.04)), X, TABLE))
    assert (found.kind, found.r) == ("face on face", 3)
    assert [d.r for d in detect(pair_of(coal.Sphere(0.02)), X, TABLE)] == [1, 1]


# Shapes from files ----------------------------------------------------------------------------


def test_shapes_of_a_urdf_have_the_names_and_places_of_the_file(rod):
    shapes = {shape.name: shape for shape in rod[0]}
    assert list(shapes) == ["shaft", "left_end", "right_end"]
    np.testing.assert_allclose(shapes["left_end"].placement.translation, [-0.29, 0, 0])
    assert shapes["right_end"].shape.radius == 0.01
    assert shapes["shaft"].shape.halfLength == 0.29
    np.testing.assert_allclose(shapes["shaft"].solid.axis, [1, 0, 0], atol=1e-9)


def urdf(tmp_path, collision, joint=""):
    link = f'<link name="a">{collision}</link>'
    tail = '<link name="b"/>' + joint if joint else ""
    path = tmp_path / "body.urdf"
    path.write_text(f'<robot name="body">{link}{tail}</robot>')
    return path


BLOCK = '<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>'
MESH = '<collision><geometry><mesh filename="{}" scale="2 2 2"/></geometry></collision>'


def stl(path, corners, faces):
    lines = ["solid s"]
    for face in faces:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"vertex {x} {y} {z}" for x, y, z in corners[list(face)]]
        lines += ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid s"]))


CUBE_FACES = [
    (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
    (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
]  # fmt: skip


def test_a_convex_mesh_touches_like_the_box_it_is(tmp_path):
    stl(tmp_path / "box.stl", CORNERS / 2, CUBE_FACES)  # the URDF doubles it
    mesh = collision_shapes(urdf(tmp_path, MESH.format("box.stl")))
    assert mesh[0].name == "a_0"
    assert mesh[0].solid.corners.shape == (8, 3)
    for tilt, r in (
        (np.eye(3), 3),
        (pin.rpy.rpyToMatrix(0.4, 0, 0), 2),
        (pin.rpy.rpyToMatrix(0.4, 0.6, 0), 1),
    ):
        X = standing(tilt, CORNERS, np.random.default_rng(r))
        as_mesh, as_box = only(detect(mesh, X, TABLE)), only(detect(BOX, X, TABLE))
        assert as_mesh.r == as_box.r == r
        assert as_mesh.kind == as_box.kind
        for point in as_box.points:
            assert np.linalg.norm(as_mesh.points - point, axis=1).min() < 1e-7  # STL: float32


def test_a_dented_mesh_is_refused(tmp_path):
    corners = np.vstack((CORNERS, [[0.01, 0.0, 0.0]]))
    dented = [f for f in CUBE_FACES if f not in ((4, 6, 7), (4, 7, 5))]
    dented += [(4, 6, 8), (6, 7, 8), (7, 5, 8), (5, 4, 8)]
    stl(tmp_path / "dent.stl", corners, dented)
    with pytest.raises(ModelError, match="not convex"):
        collision_shapes(urdf(tmp_path, MESH.format("dent.stl")))


@pytest.mark.parametrize(
    ("collision", "joint", "message"),
    [
        ("", "", "no link has a <collision>"),
        (
            BLOCK,
            '<joint name="swing" type="continuous"><parent link="a"/><child link="b"/></joint>',
            "swing",
        ),
        (MESH.format("absent.stl"), "", "absent.stl"),
    ],
)
def test_files_that_are_no_body_are_refused(tmp_path, collision, joint, message):
    with pytest.raises(ModelError, match=message):
        collision_shapes(urdf(tmp_path, collision, textwrap.dedent(joint)))


def test_a_missing_file_is_named():
    with pytest.raises(ModelError, match=r"nowhere\.urdf"):
        collision_shapes("nowhere.urdf")


def test_bad_input_is_refused_at_the_door():
    X = pin.SE3.Identity()
    for options in ({"margin": 0.0}, {"margin": np.nan}, {"angle": 0.0}, {"angle": 0.5}):
        with pytest.raises(InvalidInputError, match=next(iter(options))):
            detect(BOX, X, TABLE, **options)
    with pytest.raises(InvalidInputError, match="Ellipsoid"):
        CollisionShape("egg", coal.Ellipsoid(1, 2, 3))
    puffed = coal.Box(1, 1, 1)
    puffed.setSweptSphereRadius(0.01)
    with pytest.raises(InvalidInputError, match="swept"):
        CollisionShape("puffed", puffed)
    assert set(detection.__all__) >= {"detect", "Detected", "CollisionShape", "collision_shapes"}
