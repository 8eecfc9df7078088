"""Contact pairs: N, T, n_γ and the gaps against finite differences with both bodies moving.

The object moves on each pair's own free coordinates (`pair_kinds`), which know nothing of N or T,
while the environment moves at will. Such a motion keeps the contact, so its differentiated poses
must satisfy NᵀV_rel = 0 and Nᵀa_rel = n_γ. Motions that break the contact show Ṅ and the gaps.
"""

from dataclasses import fields, replace

import numpy as np
import pinocchio as pin
from complaints import contact_error
from numpy.linalg import det, inv, norm, solve
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pair_kinds import (
    KINDS,
    PLAIN,
    STILL,
    Coordinates,
    Motion,
    Path,
    about,
    free_motions,
    kinematics,
    pose_of,
    rate,
)
from pytest import approx, raises
from rigs import largest, refused, shift, unit
from samples import parametrize

import osc_contact as osc
from osc_contact.contacts.pairs import PAIRS
from osc_contact.contacts.pairs.pair import count_forces
from osc_contact.contacts.pairs.tangent_pair import TangentPair

ALL = sorted(KINDS)
MADE = {name: type(KINDS[name](default_rng(0), PLAIN)[0]) for name in ALL}
#: n_γ from T and β: it presumes that V_rel is a permitted motion.
BY_T = {name for name, pair in MADE.items() if issubclass(pair, TangentPair)}
TURNS = range(3)


def test_twist_and_acceleration_from_poses_are_those_of_a_known_path():
    path = Path.random(default_rng(0))
    twist, acceleration = kinematics(path)
    assert_allclose(twist, path.twist, atol=1e-11)
    assert_allclose(acceleration, path.acceleration, atol=1e-9)


def test_no_pair_is_left_out():
    assert set(MADE.values()) == set(PAIRS.values())


def near(value, expected, scale, tolerance):
    """Against the size of the summands, both bodies moving at about 1 m/s and 1 rad/s."""
    assert value.shape == expected.shape
    scale = scale + 0.1
    assert (np.abs(value - expected) <= tolerance * scale).all(), (value, expected, scale)


@parametrize("turn", TURNS)
@parametrize("name", ALL)
def test_motions_that_keep_the_contact(name, turn):
    motion = Motion.keeping(name, turn)
    contact = motion.contact()
    (V_rel, a_rel) = motion.relative
    for t in (0.0, -0.3, 0.2):
        assert_allclose(motion.gaps(t), 0.0, atol=1e-12)
    size = np.abs(contact.N).T
    near(contact.N.T @ V_rel, np.zeros(contact.r), size @ np.abs(V_rel), 1e-10)
    near(contact.n_gamma, contact.N.T @ a_rel, size @ np.abs(a_rel), 1e-8)
    if contact.r not in (0, 6):
        assert largest(contact.n_gamma) > 1e-4  # n_γ = 0 would not do


@parametrize("turn", TURNS)
@parametrize("name", ALL)
def test_T_is_what_the_free_coordinates_can_do(name, turn):
    contact, twists = free_motions(name, turn)
    T = contact.T
    rates = np.linalg.lstsq(T, twists, rcond=None)[0]
    assert_allclose(T @ rates, twists, atol=1e-9 * (1 + largest(twists)))
    assert contact.r == 6 or np.linalg.matrix_rank(rates) == 6 - contact.r


@parametrize("turn", TURNS)
@parametrize("open_by", [0.0, 0.2])
@parametrize("name", ALL)
def test_gaps_shrink_along_the_columns_of_N(name, open_by, turn):
    """In contact for every pair, and for all but the screw with the gaps open too."""
    if name == "screw":
        open_by = 0.0
    motion = Motion.breaking(name, turn, open_by)
    contact = motion.contact()
    (V_rel, a_rel) = motion.relative
    size = np.abs(contact.N).T
    near(rate(motion.gaps), -contact.N.T @ V_rel, size @ np.abs(V_rel), 1e-8)
    if name not in BY_T:
        expected = contact.n_gamma - contact.N.T @ a_rel
        scale = size @ np.abs(a_rel) + np.abs(contact.n_gamma)
        near(rate(motion.gaps, 2), expected, scale, 1e-7)


@parametrize("turn", TURNS)
@parametrize("open_by", [0.0, 0.2])
@parametrize("name", ALL)
def test_N_and_T_do_no_work_on_one_another(name, open_by, turn):
    motion = Motion.breaking(name, turn, open_by)
    contact = motion.contact()
    r = KINDS[name](default_rng(turn), PLAIN)[2]
    assert contact.r == r and contact.T.shape == (6, 6 - r) and contact.name == motion.pair.name
    power = np.abs(contact.N.T @ contact.T)
    assert (power <= 1e-12 * (np.abs(contact.N).T @ np.abs(contact.T))).all()
    assert motion.gaps(0.0).shape == (r,)
    if r:
        assert np.linalg.svd(contact.N / norm(contact.N, axis=0))[1][-1] > 1e-3


@parametrize("name", ALL)
def test_the_environment_defaults_to_the_world_at_rest(name):
    pair, pose, r = KINDS[name](default_rng(5), PLAIN)
    X_WO = pose(np.full(6 - r, 0.3))
    V = np.arange(6.0)
    here = pin.SE3.Identity()
    for given, meant in (({}, (here, STILL)), ({"V_E": V[::-1].copy()}, (here, V[::-1].copy()))):
        one = pair.contact(X_WO, V, **given)
        other = pair.contact(X_WO, V, *meant)
        assert_allclose(one.N, other.N, atol=1e-14)
        assert_allclose(one.n_gamma, other.n_gamma, atol=1e-11)
    assert_allclose(pair.gaps(X_WO), pair.gaps(X_WO, here), atol=1e-14)
    assert isinstance(pair, osc.ContactPair)


def answer(contact, Phi, f, a_E):
    """f_c of a free body of inverse inertia Φ under the wrench f: Nᵀ(Φ(f − Nα) − a_E) = n_γ."""
    N = contact.N
    D = N.T @ Phi @ N
    d = 1 / np.sqrt(np.diag(D))
    alpha = d * solve(D * np.outer(d, d), d * (N.T @ (Phi @ f - a_E) - contact.n_gamma))
    return N @ alpha


@parametrize("turn", range(2))
@parametrize("name", ALL)
def test_the_contact_force_knows_no_frame_origin_basis_or_unit(name, turn):
    """Other frames W, A, E, another basis; mm and g."""
    rng = default_rng([turn, 9])
    Y = pose_of(rng)
    X_A = pose_of(rng)
    X_E = pose_of(rng)
    X_A.translation *= 0.2  # about the size of the object
    q = 0.5 * rng.standard_normal(6)
    env = Path.random(rng)
    pair, pose, r = KINDS[name](default_rng(turn), PLAIN)
    moved, _, _ = KINDS[name](default_rng(turn), Coordinates(X_A, X_E, 1e3))
    X_WE = env(0.0)
    X_WO = X_WE * pose(q[: 6 - r])
    (f, a_E, V_O, V_E) = rng.standard_normal((4, 6))
    inertia = pin.Inertia(
        2.0, 0.2 * rng.standard_normal(3), np.diag(rng.uniform(0.06, 0.1, size=3))
    )
    Phi = inv(inertia.matrix())
    plain = pair.contact(X_WO, V_O, X_WE, V_E)
    f_c = answer(plain, Phi, f, a_E)

    def mm(X):
        return pin.SE3(X.rotation, 1e3 * X.translation)

    def carried(X_old, X_new):
        """(6, 6) twists at one body-fixed origin, W axes (m) → another origin, W′ axes (mm)."""
        away = shift(X_new.translation - X_old.translation)
        turned = pin.SE3(Y.rotation, np.zeros(3))
        return np.diag([1e3] * 3 + [1.0] * 3) @ (turned * away.inverse()).toActionMatrix()

    to_O = carried(X_WO, X_WO * X_A)
    to_E = carried(X_WE, X_WE * X_E)
    forces = 1e9 * inv(to_O).T  # power: g mm²/s³ = 1e-9 W
    changed = moved.contact(mm(Y * X_WO * X_A), to_O @ V_O, mm(Y * X_WE * X_E), to_E @ V_E)
    f_changed = answer(changed, to_O @ Phi @ to_O.T / 1e9, forces @ f, to_O @ a_E)
    M = np.linalg.qr(rng.standard_normal((r, r)))[0] * rng.uniform(0.3, 3.0, size=r)
    f_basis = answer(osc.Contact(plain.N @ M, plain.n_gamma @ M), Phi, f, a_E)
    scale = largest(f_c) + largest(f)
    for other in (solve(forces, f_changed), f_basis):
        assert_allclose(other, f_c, rtol=0, atol=1e-9 * scale)


@parametrize("turn", range(2))
@parametrize("name", ["vertex_on_face", "sphere_on_plane", "edge_on_face", "face_on_face"])
def test_lifted_objects_have_open_gaps(name, turn):
    """Outward normals: an object moved along the face's normal is that far away from it."""
    pair, pose, r = KINDS[name](default_rng(turn), PLAIN)
    normal = pair.normal if r == 1 else pair.face_normal
    X = pose(np.full(6 - r, 0.2))
    lifted = pin.SE3(X.rotation, X.translation + 0.05 * normal)
    assert_allclose(pair.gaps(lifted), np.full(r, 0.05), atol=1e-13)
    assert_allclose(pair.contact(X, STILL).N[:3], np.tile(-normal[:, None], r))


def test_a_face_of_the_object_pushes_along_its_own_outward_normal():
    pair = osc.FaceOnVertex([0.0, 0, -0.1], [0.0, 0, -2.0], [0.3, 0.2, 0.0])
    X = shift([0.0, 0.0, 0.15])
    assert_allclose(pair.gaps(X), [0.05])
    assert_allclose(pair.contact(X, STILL).N[:, 0], [0, 0, -1, -0.2, 0.3, 0])


@parametrize(("side", "down"), [(1.0, 1), (-1.0, -1), ([0.1, 0.3, 2.0], 1)])
def test_edges_cross_with_the_environment_on_the_stated_side(side, down):
    """e_A × e_E = y × x = −z."""
    pair = osc.EdgeOnEdge([0.0, 5, 0.02], [0.0, 1, 0], [7.0, 0, 0], [1.0, 0, 0], side)
    here = pin.SE3.Identity()
    assert_allclose(pair.gaps(here), [down * 0.02], atol=1e-15)
    assert_allclose(pair.contact(here, STILL).N[:, 0], [0, 0, -down, 0, 0, 0])
    along_x = shift([0.4, 0, 0])  # the crossing point follows the object
    assert_allclose(pair.contact(along_x, STILL).N[:, 0], [0, 0, -down, 0, 0, 0])


def test_a_screw_is_closed_again_after_every_turn_and_open_in_between():
    pair = osc.Screw(np.zeros(3), [0.0, 0, 1], 0.002)
    for turns in (1, -2, 7):
        assert_allclose(pair.gaps(shift([0, 0, 0.002 * 2 * np.pi * turns])), 0.0, atol=1e-15)
    low = pin.SE3(about(np.array([0.0, 0, 1]), 0.5), np.zeros(3))
    assert_allclose(pair.gaps(low), [0, 0, 0, 0, 0.001], atol=1e-15)


def test_a_joint_angle_error_is_a_gap_in_radians():
    """Couples push against rotations about the axes of the environment: −θ for a turn by θ."""
    for axis in range(3):
        gaps = osc.Fixed().gaps(pin.SE3(about(np.eye(3)[axis], 1e-4), np.zeros(3)))
        assert_allclose(gaps, -1e-4 * np.eye(6)[3 + axis], atol=2e-8)
    assert_allclose(osc.Fixed().contact(pin.SE3.Identity(), STILL).N, np.eye(6))


@parametrize("name", ALL)
def test_pairs_are_frozen_and_comparable(name):
    pair, _, _ = KINDS[name](default_rng(1), PLAIN)
    with raises(AttributeError):
        pair.name = "other"
    assert pair == pair and pair in {pair}
    assert "name" in {f.name for f in fields(pair)} and pair.name in repr(pair)


@parametrize("turn", range(2))
def test_magnitudes_belong_to_feet_around_the_stated_point(turn):
    lever = {
        "edge_on_face": 0.15,
        "cylinder_on_plane": 0.2,
        "face_on_face": 0.2,
        "cylinder_in_hole": 0.1,
    }
    for name, length in lever.items():
        pair, pose, r = KINDS[name](default_rng(turn), PLAIN)
        X = pose(np.full(6 - r, 0.3))
        N = pair.contact(X, STILL).N
        moments = N[3:] - np.cross(X.rotation @ pair.point, N[:3], axis=0)
        assert_allclose(norm(moments, axis=0), length, atol=1e-12)
        assert_allclose(moments.sum(axis=1), 0.0, atol=1e-12)


def test_a_hinge_is_held_by_forces_and_couples_along_the_axes_of_its_seat():
    assert_allclose(osc.Revolute(O3, Z).contact(pin.SE3.Identity(), STILL).N, np.eye(6)[:, :5])


Z = [0.0, 0.0, 1.0]
O3 = [0.0, 0.0, 0.0]


#: Numbers below or at zero that a field may have.
POSSIBLE = {"radius": {0.0}, "pitch": {-1.0}, "side": {-1.0}}


@parametrize("name", ALL)
def test_impossible_geometry_is_refused(name):
    """No numbers, no directions, lengths that are none; the field is named."""
    pair, _, _ = KINDS[name](default_rng(1), PLAIN)
    for field in fields(pair):
        value = getattr(pair, field.name) if field.init else None
        if isinstance(value, float):
            bad = {np.nan, np.inf, 0.0, -1.0} - POSSIBLE.get(field.name, set())
        elif np.shape(value) == (3,):
            bad = [value[:2], np.nan * value, "corner"]
            bad += [0.0 * value] if norm(value) == approx(1.0) else []
        else:
            continue
        for one in bad:
            with refused({"groove_angle": "walls"}.get(field.name, f"{pair.name}.{field.name}")):
                replace(pair, **{field.name: one})


@parametrize(
    ("make", "message"),
    [
        (lambda: osc.EdgeOnEdge(O3, Z, O3, Z, side=0.5), r"side = 0.5; give \+1 or −1"),
        (lambda: osc.EdgeOnEdge(O3, Z, O3, Z, side=O3), "side is zero"),
        (lambda: osc.GapFunctions(lambda X: X.translation, step=1.0), "gap_functions.step = 1.0"),
    ],
)
def test_sides_and_steps_out_of_bounds_are_refused(make, message):
    with refused(message):
        make()


@parametrize("name", ALL)
def test_forces_are_counted_in_any_pose(name):
    pair, _, r = KINDS[name](default_rng(4), PLAIN)
    assert count_forces(pair) == r
    assert (
        count_forces(osc.EdgeOnEdge(O3, Z, [0.1, 0, 0], Z)) == 1
    )  # parallel where frames coincide


def test_contacts_that_do_not_exist_are_refused():
    here = pin.SE3.Identity()
    parallel = osc.EdgeOnEdge(O3, Z, [0.1, 0, 0], Z, name="rails")
    for ask in (lambda: parallel.contact(here, STILL), lambda: parallel.gaps(here)):
        with contact_error("rails: the edges are parallel"):
            ask()
    flat = osc.GapFunctions(lambda X: [1.0])  # a gap that no motion changes
    with contact_error("column 0 is zero"):
        flat.contact(here, STILL)
    with refused(r"broken.gap\(X_EA\): element \(0,\) is nan"):
        osc.GapFunctions(lambda X: [np.nan], name="broken").gaps(here)


# Vertex on a face ---------------------------------------------------------------------------------


def test_point_on_face_is_where_the_line_of_force_meets_it():
    for seed in range(40):
        rng = default_rng(seed)
        pair = osc.VertexOnFace(*rng.standard_normal((3, 3)), 0.07)
        X_WO, X_WE = pose_of(rng), pose_of(rng)
        on_face = pair.point_on_face(X_WO, X_WE)
        height = X_WE.actInv(on_face) @ pair.normal
        assert height == approx(pair.point @ pair.normal, abs=1e-12)
        reach = (pair.gap(X_WO, X_WE) + 0.07) * pair.direction(X_WE)
        assert_allclose(on_face, X_WO.act(pair.vertex) + reach, atol=1e-12)
        here = pin.SE3.Identity()
        assert_array_equal(pair.point_on_face(X_WO), pair.point_on_face(X_WO, here))
        assert_array_equal(pair.direction(), pair.direction(here))


@parametrize("normal", [*np.vstack((np.eye(3), -np.eye(3))), (1e-3, 2e-3, 0), (300, -1, 2)])
def test_face_placement_is_a_right_handed_frame_on_the_face(normal):
    X = osc.VertexOnFace(np.zeros(3), [0.1, 0.2, 0.3], normal).face_placement()
    assert_allclose(X.rotation.T @ X.rotation, np.eye(3), atol=1e-12)
    assert det(X.rotation) == approx(1.0)
    assert_allclose(X.rotation[:, 2], unit(normal), atol=1e-12)
    assert_array_equal(X.translation, [0.1, 0.2, 0.3])


def test_normal_is_normalised_and_input_is_copied():
    vertex = np.ones(3)
    pair = osc.VertexOnFace(vertex, np.zeros(3), np.array([0.0, 3.0, 4.0]))
    assert_allclose(pair.normal, [0.0, 0.6, 0.8], atol=1e-16)
    vertex[:] = 9.0
    assert_array_equal(pair.vertex, np.ones(3))
    assert pair.radius == 0.0 and pair.name == "vertex_on_face"
