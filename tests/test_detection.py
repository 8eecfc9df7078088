"""Detection: collision geometry and poses in, contacts out; judged by poses built by hand.

Poses are exact: a tipped box stands on the corner or edge that was put there, at a random place and
yaw; what N must span then follows from where its touching points are, without any detection.
"""

from itertools import product

import coal
import numpy as np
import pinocchio as pin
from complaints import contact_error, invalid_input, model_error
from numpy.linalg import det, norm, pinv
from numpy.random import default_rng
from pinocchio.rpy import rpyToMatrix
from pytest import approx
from rigs import (
    STILL,
    any_rotation,
    assert_near,
    placed,
    pose_of,
    rig_of,
    rotated,
    shift,
    unit,
    vector,
    within,
)
from samples import aligned, module_fixture, parametrize

import osc_contact as osc
from osc_contact import robots
from osc_contact.contacts.detection import CollisionShape, collision_shapes, detect
from osc_contact.contacts.detection.features import nearest
from osc_contact.contacts.pairs.pair import triad

SIZE = vector(0.10, 0.08, 0.06)
BOX = [CollisionShape("box", coal.Box(*SIZE))]
TABLE = [CollisionShape("table", coal.Box(1.0, 0.8, 0.1), placed(0, 0, -0.05))]
"""Its top is z = 0."""
CORNERS = np.array(list(product((-0.5, 0.5), repeat=3))) * SIZE
DEPTHS = (0.0, 5e-4, -5e-4)
"""Just touching, overlapping, a little apart (m); taken in turn."""
UP = vector(0.0, 0.0, 1.0)
FLOOR = [CollisionShape("floor", coal.Box(9, 9, 1), shift(-0.5 * UP))]


def moved(X, points):
    return np.asarray(points) @ X.rotation.T + X.translation


def standing(rotation, points, rng, lift=0.0):
    """A pose with this tilt (and random yaw) whose lowest of `points` is at z = lift."""
    R = rpyToMatrix(0, 0, rng.uniform(-np.pi, np.pi)) @ rotation
    x, y = rng.uniform(-0.2, 0.2, 2)
    return pin.SE3(R, vector(x, y, lift - (points @ R.T)[:, 2].min()))


def pushes(points, directions, X_WO):
    """(6, k) wrenches at O of unit forces along `directions` at world `points`."""
    arms = np.asarray(points) - X_WO.translation
    directions = np.broadcast_to(directions, arms.shape)
    return np.hstack((directions, np.cross(arms, directions))).T


def assert_same_range(N, expected):
    """Equal spans, whatever the bases (moments in units of 0.1 m)."""
    scale = vector(1, 1, 1, 10, 10, 10.0)[:, None]
    first, second = (M @ pinv(M, rcond=1e-6) for M in (scale * N, scale * expected))
    assert_near(first, second, atol=1e-9)
    assert np.trace(first) == approx(N.shape[1])


def only(found):
    assert len(found) == 1, [(d.name, d.kind, d.distance) for d in found]
    return found[0]


def assert_only(found, kind, points, normal, X_WO, X_WE=None, gap=0.0):
    """One contact of this kind, whose normal is given, held by pushes in these points.

    Of `.pair()` N spans these, the gaps are as given and n_γ follows from its N alone.
    """
    found = only(found)
    assert found.kind == kind
    assert_near(found.normal, normal, atol=1e-9)
    pair = found.pair()
    contact = pair.contact(X_WO, STILL, X_WE)
    assert contact.r == found.r
    assert_same_range(contact.N, pushes(points, -np.asarray(normal), X_WO))
    assert_near(contact.n_gamma, 0.0, atol=1e-12)
    assert_near(pair.gaps(X_WO, X_WE), np.full(found.r, gap), atol=1e-9)
    assert (contact.N[:3].T @ found.normal < 0.0).all()  # into the environment
    return found


BALL = [CollisionShape("ball", coal.Sphere(0.03), placed(0.01, 0.02))]
CAN = [CollisionShape("can", coal.Cylinder(0.03, 0.12))]
PILL = [CollisionShape("pill", coal.Capsule(0.03, 0.12))]
AXIS = np.array([[0, 0, -0.06], [0, 0, 0.06]])
RIM = np.array([[0, -0.03, -0.06]])  #: lowest point of a can: turning about x lifts +y
AROUND = vector(0, 0, 0, 0, 0, 0.7)
"""A turn of the can about its own axis."""

SEEDS = parametrize("seed", range(4))


# A body on a table, and a table on a body ---------------------------------------------------------


def quarter_turns(rng):
    """One of the 24 orientations of a cube, exactly."""
    while True:
        R = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
        if det(R) > 0:
            return R


def rolled(rng, *pitch):
    return rpyToMatrix(rng.uniform(0.1, np.pi / 2 - 0.1), *pitch, 0.0)


def lying(rng):
    return rpyToMatrix(np.pi / 2, 0, 0) @ rpyToMatrix(0, 0, rng.uniform(-3, 3))


#: Contact, its name where the table is the object, r, shapes, the points that may be lowest, how
#: far these are below the surface, tilt.
RESTING = [
    ("face on face", "face on face", 3, BOX, CORNERS, 0.0, quarter_turns),
    (
        "edge on face",
        "face on edge",
        2,
        BOX,
        CORNERS,
        0.0,
        lambda rng: rolled(rng, 0.0) @ quarter_turns(rng),
    ),
    (
        "vertex on face",
        "face on vertex",
        1,
        BOX,
        CORNERS,
        0.0,
        lambda rng: rolled(rng, rng.uniform(0.1, 1.4)),
    ),
    (
        "sphere on plane",
        "plane on sphere",
        1,
        BALL,
        BALL[0].placement.translation[None],
        0.03,
        any_rotation,
    ),
    (
        "rim on face",
        "face on rim",
        1,
        CAN,
        RIM,
        0.0,
        lambda rng: rpyToMatrix(rng.uniform(0.1, 1.4), 0, 0),
    ),
    ("cylinder on plane", "plane on cylinder", 2, CAN, AXIS, 0.03, lying),
    ("cylinder on plane", "plane on cylinder", 2, PILL, AXIS, 0.03, lying),
    ("sphere on plane", "plane on sphere", 1, PILL, AXIS, 0.03, lambda rng: rolled(rng, 0.0)),
]


@parametrize("below", [False, True])
@parametrize("row", RESTING, ids=lambda row: f"{row[3][0].name}: {row[0]}")
@parametrize("seed", range(3))
def test_a_body_that_rests_on_a_plane_touches_in_its_lowest_points(seed, row, below):
    """Each of the two may be the object."""
    above, under, r, shapes, points, radius, tilt = row
    rng = default_rng(seed)
    depth = DEPTHS[seed % 3]
    X_WT = pose_of(rng)
    X = standing(tilt(rng), points, rng, lift=radius - depth)
    body = X_WT * X
    up = X_WT.rotation @ UP
    lowest = moved(X, points)
    lowest = moved(X_WT, lowest[lowest[:, 2] < radius - depth + 1e-9] * [1, 1, 0])
    X_WO, X_WE = (X_WT, body) if below else (body, X_WT)
    of_O, of_E = (TABLE, shapes) if below else (shapes, TABLE)
    found = detect(of_O, X_WO, of_E, X_WE)
    kind, normal = (under, -up) if below else (above, up)
    found = assert_only(found, kind, lowest, normal, X_WO, X_WE, -depth)
    assert len(found.points) == len(lowest) and found.r == r
    away = norm(found.points[:, None] - lowest, axis=2).min(axis=0)
    assert away.max() < 1e-9 + below * abs(depth)
    assert found.distance == approx(-depth, abs=1e-9)


def box_on_table(size, *tilt):
    """A box of another size standing on its lowest corner, tilted by roll and pitch."""
    corners = CORNERS / (CORNERS.max(axis=0) * 2) * size
    X = standing(rpyToMatrix(*tilt, 0), corners, default_rng(1))
    return only(detect([CollisionShape("other", coal.Box(*size))], X, FLOOR))


def test_both_the_angle_and_the_margin_must_allow_a_face_or_an_edge():
    """1 mrad and 1 mm: small bodies differ by their angle, large ones by the height."""
    small = (0.01, 0.01, 0.01)
    plate = (1.6, 0.4, 0.02)
    assert box_on_table(small, 5e-3, 5e-3).kind == "vertex on face"  # no corner above 0.1 mm
    assert box_on_table(small, 5e-3, 0.0).kind == "edge on face"
    assert box_on_table(plate, 0.0, 0.8e-3).kind == "edge on face"  # one side is 1.3 mm up
    assert box_on_table(plate, 0.8e-3, 0.0).kind == "face on face"
    assert box_on_table(plate, 2e-3, 0.8e-3).kind == "vertex on face"


@parametrize("tilt, along", {(0.9e-3, 0.6e-3): 0, (0.6e-3, 0.9e-3): 1})
def test_a_face_too_steep_across_leaves_its_flattest_edge(tilt, along):
    """Both sides rise by less than 1 mrad, the face by more: roll lifts along y, pitch along x."""
    found = box_on_table((0.1, 0.1, 0.1), *tilt)
    assert found.kind == "edge on face"
    assert abs(found.object_feature.direction[along]) > 0.999


def test_an_overlap_narrower_than_the_margin_is_a_line():
    X = placed(0.5496, 0.1, 0.03)
    ends = np.array([[0.4998, 0.06, 0.0], [0.4998, 0.14, 0.0]])
    found = assert_only(detect(BOX, X, TABLE), "edge on face", ends, UP, X)
    assert_near(found.points[np.argsort(found.points[:, 1])], ends, atol=1e-9)


@SEEDS
def test_corners_that_point_at_one_another_touch_on_their_bodies(seed):
    """Where edges near both corners cross beyond their ends, the contact stays on them."""
    rng = default_rng(seed)
    R = any_rotation(rng)
    down = unit(-np.abs(rng.standard_normal(3)))
    corner = CORNERS[((CORNERS @ R.T) @ down).argmax()]
    found = only(detect(BOX, pin.SE3(R, -5e-4 * down - R @ corner), BOX, shift(-SIZE / 2)))
    assert 0.0 < found.distance <= 5e-4
    slack = 1e-9 if found.kind == "edge on edge" else 5e-4
    assert within(found.object_point, SIZE / 2 + slack)
    assert norm(found.object_point - corner) < 0.01


def test_a_corner_in_a_corner_touches_floor_and_walls():
    """Three contacts in one point: they repeat one another in place, not in direction."""
    room = [
        CollisionShape("floor", coal.Box(1, 1, 0.1), placed(0, 0, -0.05)),
        CollisionShape("wall", coal.Box(0.1, 1, 1), placed(-0.05)),
        CollisionShape("side", coal.Box(1, 0.1, 1), placed(0, -0.05)),
    ]
    ball = [CollisionShape("ball", coal.Sphere(0.0))]
    X = placed()
    found = detect(ball, X, room)
    assert sorted(d.environment_shape for d in found) == ["floor", "side", "wall"]
    N = osc.Contact.stack([d.pair().contact(X, STILL) for d in found]).N
    assert_same_range(N, np.eye(6)[:, :3])


def test_where_the_distance_solver_fails_the_shapes_decide(monkeypatch):
    """A distance that is no number counts as touching; see `separation`."""
    monkeypatch.setattr(coal, "distance", lambda *_: np.finfo(float).max)
    X = standing(rpyToMatrix(0.4, 0.5, 0), CORNERS, default_rng(0), lift=-5e-4)
    assert nearest(BOX[0].shape, X, TABLE[0].shape, X).distance == 0.0
    found = only(detect(BOX, X, TABLE))
    assert found.kind == "vertex on face" and found.distance == approx(-5e-4)
    X.translation += 2e-3 * UP
    assert detect(BOX, X, TABLE) == []


@parametrize("gap", [1.1e-3, 0.02, 1.0])
@parametrize("seed", range(2))
def test_what_is_apart_does_not_touch(seed, gap):
    rng = default_rng(seed)
    for tilt in (np.eye(3), rpyToMatrix(0.4, 0, 0), rpyToMatrix(0.4, 0.6, 0)):
        X = standing(tilt, CORNERS, rng, lift=gap)
        assert detect(BOX, X, TABLE) == []
        assert len(detect(BOX, X, TABLE, margin=1.05 * gap)) == 1
    assert detect(BOX, placed(0.55 + gap, 0.0, -0.02), TABLE) == []


# Edges and vertices of the environment --------------------------------------------------------


def ridge(rng):
    """A roof: a box rolled by about 45°."""
    return rpyToMatrix(np.pi / 4 + rng.uniform(-0.2, 0.2), 0, 0)


LIE = rpyToMatrix(np.pi / 2, 0, 0)
LOWER = [CollisionShape("ridge", coal.Box(0.4, 0.1, 0.1))]
#: Contact, object, environment, their tilts; point of the line of either and direction of both
#: lines, in body axes; how far the lines are above the bodies.
CROSSED = [
    ("edge on edge", BOX, LOWER, ridge, -SIZE / 2, [0, 0.05, 0.05], 0, 0.0),
    ("cylinder on cylinder", PILL, PILL, lambda rng: LIE, np.zeros(3), np.zeros(3), 2, 0.03),
]


@SEEDS
@parametrize("row", CROSSED, ids=lambda row: row[0])
def test_crossed_lines_touch_in_their_crossing_point(row, seed):
    """Roof against roof and pill on pill, crossed at a random angle."""
    kind, of_O, of_E, tilt, on_O, on_E, along, radius = row
    rng = default_rng(seed)
    depth = DEPTHS[seed % 3]
    X_WE = rotated(tilt(rng))
    X_WO = rotated(rpyToMatrix(0, 0, rng.uniform(0.2, np.pi - 0.2)) @ tilt(rng))
    own, other = np.array([on_O, on_E], dtype=float)
    own[along], other[along] = rng.uniform(-0.03, 0.03, 2)  # crossing point along either line
    meet = X_WE.act(other) + radius * UP
    X_WO.translation = meet - X_WO.act(own) + (radius - depth) * UP
    X = pose_of(rng)
    X_WO = X * X_WO
    at = [X.act(meet)]
    found = detect(of_O, X_WO, of_E, X * X_WE)
    found = assert_only(found, kind, at, X.rotation @ UP, X_WO, X * X_WE, -depth)
    assert_near(found.points, at, atol=1e-9 + abs(depth) * (radius > 0))
    assert found.distance == approx(-depth, abs=1e-9)
    assert radius or norm(found.object_point - own) < 1e-9


# The rod of the scenario ----------------------------------------------------------------------


@module_fixture
def rod():
    """(rod's shapes, declared pairs, (plate's shapes, pose) of each, start pose)."""
    rig = rig_of("two_contact_rod")
    plate = collision_shapes(robots.urdf_path("face.urdf"))
    plates = [(plate, pin.SE3(triad(pair.normal), pair.point)) for pair in rig.pairs]
    return (collision_shapes(robots.urdf_path("rod.urdf")), rig.pairs, plates, rig.state.X_WO)


def test_the_rod_finds_the_contacts_the_scenario_declares(rod):
    shapes, declared, plates, X_WO = rod
    for pair, (plate, X_WE), side in aligned(declared, plates, ("left", "right")):
        contact = only(detect(shapes, X_WO, plate, X_WE))
        assert (contact.name, contact.kind) == (f"{side}_end on plate", "sphere on plane")
        V_O = default_rng(0).standard_normal(6)
        mine = contact.pair().contact(X_WO, V_O, X_WE)
        theirs = pair.contact(X_WO, V_O)
        assert_near(mine.N, theirs.N, atol=1e-9)
        assert_near(mine.n_gamma, theirs.n_gamma, atol=1e-9)
        assert_near(contact.points, pair.points_of_contact(X_WO).T, atol=1e-9)
        assert_near(contact.normal, pair.normal, atol=1e-12)


# Found twice ----------------------------------------------------------------------------------


def test_a_rim_inside_a_ball_gives_way_to_the_ball(rod):
    """The rod nearly flat: its shaft's rim is closer to the table than the margin too."""
    shapes = rod[0]
    for tilt in (0.01, 0.1, 0.3):
        X = pin.SE3(rpyToMatrix(0, tilt, 0), vector(0, 0, 0.01 + 0.29 * np.sin(tilt)))
        shaft = [shape for shape in shapes if shape.name == "shaft"]
        assert only(detect(shaft, X, TABLE)).kind == "rim on face"
        found = only(detect(shapes, X, TABLE))
        assert (found.name, found.kind) == ("right_end on table", "sphere on plane")


def test_two_feet_make_one_face_and_two_balls_two_points():
    def pair_of(shape):
        return [CollisionShape(f"foot{x:+.1f}", shape, placed(x)) for x in (-0.1, 0.1)]

    X = placed(0, 0, 0.02)
    found = only(detect(pair_of(coal.Box(0.04, 0.04, 0.04)), X, TABLE))
    assert (found.kind, found.r) == ("face on face", 3)
    assert [d.r for d in detect(pair_of(coal.Sphere(0.02)), X, TABLE)] == [1, 1]


# Round shapes: balls, cylinders on their side, end or rim, capsules ----------------------------


@SEEDS
def test_a_standing_cylinder_is_one_face_contact(seed):
    rng = default_rng(seed)
    depth = DEPTHS[seed % 3]
    X = standing(np.diag([1, -1, -1.0]) if seed % 2 else np.eye(3), AXIS, rng, lift=-depth)
    X_WE = pose_of(rng)
    X_WO = X_WE * X
    middle = X.translation * [1, 1, 0]
    three = moved(X_WE, middle + 0.03 * np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0]]))
    found = detect(CAN, X_WO, TABLE, X_WE)
    found = assert_only(found, "face on face", three, X_WE.rotation @ UP, X_WO, X_WE, -depth)
    assert_near(norm(found.points - X_WE.act(middle), axis=1), 0.03, atol=1e-9)


def test_a_can_on_the_rim_of_its_end_rolls_in_contact():
    """Also as what lies under a face of the object."""
    rng = default_rng(0)
    table = pose_of(rng)
    can = table * standing(rpyToMatrix(rng.uniform(0.1, 1.4), 0, 0), RIM, rng)
    rolled = can * pin.exp6(AROUND)
    assert_near(only(detect(TABLE, table, CAN, can)).pair().gaps(table, rolled), 0, atol=1e-9)
    found = only(detect(CAN, can, TABLE, table))
    assert_near(found.object_point, RIM[0], atol=1e-9)
    assert_near(found.pair().gaps(rolled, table), 0, atol=1e-9)


def test_a_can_hardly_tipped_rolls_on_its_rim_and_a_large_one_sooner():
    """5 mrad: N from a gap that bends within 0.15 mm. A disc 2 m wide rises 1 mm in 0.8 mrad."""
    rng = default_rng(0)
    X = standing(rpyToMatrix(5e-3, 0, 0), RIM, rng)
    assert_only(detect(CAN, X, TABLE), "rim on face", [X.act(RIM[0])], UP, X)
    for radius, length, lies, kind in (
        (1.0, 0.1, False, "rim on face"),
        (0.1, 2.0, True, "rim on face"),
        (0.3, 0.1, False, "face on face"),
        (0.1, 0.6, True, "cylinder on plane"),
    ):
        tilt = np.pi / 2 - 0.8e-3 if lies else 0.8e-3
        X = standing(rpyToMatrix(tilt, 0, 0), np.array([[0, -radius, -length / 2]]), rng)
        X.translation = X.translation * [0, 0, 1]
        big = [CollisionShape("big", coal.Cylinder(radius, length))]
        assert only(detect(big, X, FLOOR)).kind == kind


@SEEDS
def test_the_side_of_a_can_on_a_corner_is_pushed_across_its_axis(seed):
    """Nearest point of the axis, overlapping by up to 3 mm: no solver finds this normal well."""
    rng = default_rng(seed)
    depth = (*DEPTHS, 3e-3)[seed % 4]
    n = unit(rng.uniform(0.2, 1.0, 3))
    z = unit(np.cross(n, rng.standard_normal(3)))
    corner = vector(0.5, 0.4, 0.0)
    X = pin.SE3(np.column_stack((n, np.cross(z, n), z)), corner)
    X.translation = corner + (0.03 - depth) * n + 0.03 * rng.uniform(-1, 1) * z
    assert_only(detect(CAN, X, TABLE), "cylinder on vertex", [corner], n, X, gap=-depth)


@SEEDS
def test_a_ball_at_an_edge_and_at_a_corner_is_pushed_through_its_centre(seed):
    """It may turn in place."""
    rng = default_rng(seed)
    outward = np.append(rng.uniform(0.2, 1.0, 2), 0.0)
    for kind, corner, away in (
        ("sphere on edge", vector(0.5, 0.4, -0.05), outward),
        ("sphere on vertex", vector(0.5, 0.4, 0.0), outward + rng.uniform(0.2, 1.0) * UP),
    ):
        n = unit(away)
        centre = BALL[0].placement
        X = shift(corner + 0.03 * n - centre.translation)
        found = assert_only(detect(BALL, X, TABLE), kind, [corner], n, X)
        assert_near(found.points, [corner], atol=1e-9)
        spun = rotated(any_rotation(rng))
        turned = X * centre * spun * centre.inverse()
        assert_near(found.pair().gaps(turned), 0.0, atol=1e-9)


def test_pills_side_by_side_have_no_pair():
    found = only(detect(PILL, placed(0.06, 0.0, 0.01), PILL))
    assert (found.kind, found.r) == ("cylinder on cylinder", 2)
    assert_near(np.sort(found.points[:, 2]), [-0.05, 0.06], atol=1e-9)
    with contact_error(r"cylinder on cylinder along a line.*GapFunctions"):
        found.pair()


def test_a_rim_on_an_edge_has_no_pair():
    ledge = placed(rpy=(np.pi / 4, 0, 0))  # an edge along x on top
    X = placed(rpy=(0.6, 0, np.pi / 2))  # its rim runs along y there
    X.translation = ledge.act(vector(0.0, 0.4, 0.0)) + 2e-4 * UP - X.act(RIM[0])
    found = only(detect(CAN, X, TABLE, ledge))
    assert (found.kind, found.r) == ("rim on edge", 1)
    assert_near(found.normal, UP, atol=5e-3)  # the solver's
    with contact_error(r"rim of a cylinder.*GapFunctions"):
        found.pair()


# Collision shapes from URDF files, and what detection refuses -------------------------------------


def test_shapes_of_a_urdf_have_the_names_and_places_of_the_file():
    shapes = {s.name: s for s in collision_shapes(robots.urdf_path("rod.urdf"))}
    assert list(shapes) == ["shaft", "left_end", "right_end"]
    assert_near(shapes["left_end"].placement.translation, [-0.29, 0, 0])
    assert shapes["right_end"].shape.radius == 0.01
    assert shapes["shaft"].shape.halfLength == 0.29
    assert_near(shapes["shaft"].solid.axis, [1, 0, 0], atol=1e-9)


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
        lines += [f"vertex {x} {y} {z}" for x, y, z in corners[list(map(int, face))]]
        lines += ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid s"]))


CUBE_FACES = ["013", "032", "467", "475", "045", "051", "237", "276", "026", "064", "157", "173"]


def test_a_convex_mesh_touches_like_the_box_it_is(tmp_path):
    stl(tmp_path / "box.stl", CORNERS / 2, CUBE_FACES)  # the URDF doubles it
    mesh = collision_shapes(urdf(tmp_path, MESH.format("box.stl")))
    assert mesh[0].name == "a_0"
    assert mesh[0].solid.corners.shape == (8, 3)
    for roll, pitch, r in ((0, 0, 3), (0.4, 0, 2), (0.4, 0.6, 1)):
        X = standing(rpyToMatrix(roll, pitch, 0), CORNERS, default_rng(r))
        as_mesh = only(detect(mesh, X, TABLE))
        as_box = only(detect(BOX, X, TABLE))
        assert as_mesh.r == as_box.r == r
        assert as_mesh.kind == as_box.kind
        for point in as_box.points:
            assert norm(as_mesh.points - point, axis=1).min() < 1e-7  # STL: float32


@parametrize("faces", [["021", "013", "032", "123"], ["012", "013", "023", "132"]])
def test_a_convex_mesh_that_is_no_mirror_image_of_itself(tmp_path, faces):
    """A tetrahedron on its face: outward normals are outward whatever the order of corners."""
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    stl(tmp_path / "wedge.stl", corners / 2, faces)
    mesh = collision_shapes(urdf(tmp_path, MESH.format("wedge.stl")))
    found = only(detect(mesh, placed(), TABLE))
    assert (found.kind, found.r) == ("face on face", 3)
    assert found.distance == approx(0.0, abs=1e-9)
    assert_near(found.normal, [0, 0, 1], atol=1e-9)
    assert detect(mesh, placed(0, 0, 0.01), TABLE) == []


SWING = '<joint name="swing" type="continuous"><parent link="a"/><child link="b"/></joint>'
DENTED = [*(f for f in CUBE_FACES if f not in ("467", "475")), "468", "678", "758", "548"]


@parametrize(
    "collision, joint, message",
    [
        ("", "", "no link has a <collision>"),
        (BLOCK, SWING, "swing"),
        (MESH.format("absent.stl"), "", "absent.stl"),
        (MESH.format("dent.stl"), "", "not convex"),
    ],
)
def test_files_that_are_no_body_are_refused(tmp_path, collision, joint, message):
    stl(tmp_path / "dent.stl", np.vstack((CORNERS, [[0.01, 0.0, 0.0]])), DENTED)
    with model_error(message):
        collision_shapes(urdf(tmp_path, collision, joint))
    with model_error(r"nowhere\.urdf"):
        collision_shapes("nowhere.urdf")


def test_bad_input_is_refused_at_the_door():
    X = placed()
    for options in ({"margin": 0.0}, {"margin": np.nan}, {"angle": 0.0}, {"angle": 0.5}):
        with invalid_input(next(iter(options))):
            detect(BOX, X, TABLE, **options)
    with invalid_input("Ellipsoid"):
        CollisionShape("egg", coal.Ellipsoid(1, 2, 3))
    puffed = coal.Box(1, 1, 1)
    puffed.setSweptSphereRadius(0.01)
    with invalid_input("swept"):
        CollisionShape("puffed", puffed)
