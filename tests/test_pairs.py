"""Contact pairs: N, T, n_γ and the gaps against finite differences with both bodies moving.

The object moves on each pair's own free coordinates (`pair_kinds`), which know nothing of N or T,
while the environment moves at will. Such a motion keeps the contact, so its differentiated poses
must satisfy NᵀV_rel = 0 and Nᵀa_rel = n_γ. Motions that break the contact show Ṅ and the gaps.
"""

from dataclasses import fields, replace
from functools import cache

import numpy as np
from complaints import contact_error, invalid_input, refusals
from numpy.linalg import det, norm
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from pair_kinds import KINDS, PLAIN, Motion, pose_of, rate
from pytest import approx, raises
from rigs import STILL, assert_near, largest, placed, refused, shift, unit, vector, within
from samples import parametrize

import osc_contact as osc
from osc_contact.contacts.pairs import PAIRS
from osc_contact.contacts.pairs.pair import count_forces, presses_flat, triad
from osc_contact.contacts.pairs.tangent_pair import TangentPair

ALL = sorted(KINDS)


def drawn(name, seed):
    """A pair of a kind, its free coordinates ↦ pose, number of forces."""
    return KINDS[name](default_rng(seed), PLAIN)


@cache
def class_of(name):
    """Class of the pairs of a kind, made only in a test, because one of them is compiled."""
    return type(drawn(name, 0)[0])


TURNS = range(3)


def test_no_pair_is_left_out():
    assert set(map(class_of, ALL)) == set(PAIRS.values())


def near(value, expected, scale, tolerance, per_metre=1.0):
    """Against the size of the summands, both bodies moving at about 1 m/s and 1 rad/s."""
    assert value.shape == expected.shape
    scale = scale + 0.1 * per_metre
    assert within(value - expected, tolerance * scale), (value, expected, scale)


@parametrize("per_metre", [1.0, 1e3])
@parametrize("turn", TURNS)
@parametrize("name", ALL)
def test_motions_that_keep_the_contact(name, turn, per_metre):
    motion = Motion.keeping(name, turn, per_metre)
    contact = motion.contact()
    (V_rel, a_rel) = motion.relative
    for t in (0.0, -0.3, 0.2):
        assert_near(motion.gaps(t), 0.0, atol=1e-12 * per_metre)
    size = np.abs(contact.N).T
    near(contact.N.T @ V_rel, np.zeros(contact.r), size @ np.abs(V_rel), 1e-10, per_metre)
    near(contact.n_gamma, contact.N.T @ a_rel, size @ np.abs(a_rel), 1e-8, per_metre)
    if contact.r not in (0, 6):
        assert largest(contact.n_gamma) > 1e-4  # n_γ = 0 would not do


@parametrize("turn", TURNS)
@parametrize("open_by", [0.0, 0.2])
@parametrize("name", ALL)
def test_gaps_shrink_along_the_columns_of_N(name, open_by, turn):
    """In contact for every pair, and for all but the screw with the gaps open too."""
    if name == "screw":
        open_by = 0.0
    motion = Motion.breaking(name, turn, open_by)
    contact = motion.contact()
    assert (contact.r, contact.name) == (drawn(name, turn)[2], motion.pair.name)
    (V_rel, a_rel) = motion.relative
    size = np.abs(contact.N).T
    near(rate(motion.gaps), -contact.N.T @ V_rel, size @ np.abs(V_rel), 1e-8)
    if not issubclass(class_of(name), TangentPair):  # whose n_γ presumes that V_rel is permitted
        expected = contact.n_gamma - contact.N.T @ a_rel
        scale = size @ np.abs(a_rel) + np.abs(contact.n_gamma)
        near(rate(motion.gaps, 2), expected, scale, 1e-7)


@parametrize("name", ALL)
def test_the_environment_defaults_to_the_world_at_rest(name):
    pair, pose, r = drawn(name, 5)
    X_WO = pose(np.full(6 - r, 0.3))
    V = np.arange(6.0)
    here = placed()
    for V_E in (STILL, V[::-1].copy()):
        one = pair.contact(X_WO, V, V_E=V_E) if V_E.any() else pair.contact(X_WO, V)
        other = pair.contact(X_WO, V, here, V_E)
        assert_near(one.N, other.N, atol=1e-14)
        assert_near(one.n_gamma, other.n_gamma, atol=1e-11)
    assert_near(pair.gaps(X_WO), pair.gaps(X_WO, here), atol=1e-14)
    assert isinstance(pair, osc.ContactPair)


@parametrize("turn", range(2))
@parametrize(
    "name", ["vertex_on_face", "sphere_on_plane", "edge_on_face", "face_on_face", "face_on_vertex"]
)
def test_lifted_objects_have_open_gaps(name, turn):
    """Outward normals: an object moved along the face's normal is that far away from it.

    Or against its own.
    """
    pair, pose, r = drawn(name, turn)
    X = pose(np.full(6 - r, 0.2))
    own = {"face_on_vertex": -X.rotation} | {"vertex_on_face": np.eye(3)}
    normal = own[name] @ pair.normal if name in own else pair.face_normal
    lifted = shift(0.05 * normal) * X
    assert_near(pair.gaps(lifted), np.full(r, 0.05), atol=1e-13)
    assert_near(pair.contact(X, STILL).N[:3], np.tile(-normal[:, None], r))


@parametrize("side, down", [(1.0, 1), (-1.0, -1), ([0.1, 0.3, 2.0], 1)])
def test_edges_cross_with_the_environment_on_the_stated_side(side, down):
    """e_A × e_E = y × x = −z; the crossing point follows the object."""
    pair = osc.EdgeOnEdge([0.0, 5, 0.02], [0.0, 1, 0], [7.0, 0, 0], [1.0, 0, 0], side)
    for X in (placed(), placed(0.4)):
        assert_near(pair.gaps(X), [down * 0.02], atol=1e-15)
        assert_near(pair.contact(X, STILL).N[:, 0], [0, 0, -down, 0, 0, 0])


def test_a_screw_is_closed_again_after_every_turn_and_open_in_between():
    pair = osc.Screw(np.zeros(3), [0.0, 0, 1], 0.002)
    for turns in (1, -2, 7):
        assert_near(pair.gaps(placed(0, 0, 0.002 * 2 * np.pi * turns)), 0.0, atol=1e-15)
    assert_near(pair.gaps(placed(rpy=(0.0, 0.0, 0.5))), [0, 0, 0, 0, 0.001], atol=1e-15)


@parametrize("name", ALL)
def test_pairs_are_frozen_and_comparable(name):
    pair, _, _ = drawn(name, 1)
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
        pair, pose, r = drawn(name, turn)
        X = pose(np.full(6 - r, 0.3))
        N = pair.contact(X, STILL).N
        moments = N[3:] - np.cross(X.rotation @ pair.point, N[:3], axis=0)
        assert_near(norm(moments, axis=0), length, atol=1e-12)
        assert_near(moments.sum(axis=1), 0.0, atol=1e-12)


def test_joints_are_held_by_forces_and_couples_along_the_axes_of_their_seats():
    for r, pair in ((5, osc.Revolute(O3, Z)), (6, osc.Fixed())):
        assert_near(pair.contact(placed(), STILL).N, np.eye(6)[:, :r])


Z = [0.0, 0.0, 1.0]
O3 = [0.0, 0.0, 0.0]


#: Numbers below or at zero that a field may have.
POSSIBLE = {"radius": {0.0}, "pitch": {-1.0}, "edge_outward": {-1.0}}


@parametrize("name", ALL)
def test_impossible_geometry_is_refused(name):
    """NaN, zero directions and negative lengths are refused with the name of the field."""
    pair, _, _ = drawn(name, 1)
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


test_sides_and_steps_out_of_bounds_are_refused = refusals(
    invalid_input,
    {
        r"edge_outward = 0.5; give \+1 or −1": lambda: osc.EdgeOnEdge(O3, Z, O3, Z, 0.5),
        "edge_outward is zero": lambda: osc.EdgeOnEdge(O3, Z, O3, Z, O3),
        "gap_functions.step = 1.0": lambda: osc.GapFunctions(lambda X: X.translation, step=1.0),
    },
)


@parametrize("name", ALL)
def test_forces_are_counted_in_any_pose(name):
    pair, _, r = drawn(name, 4)
    assert count_forces(pair) == r
    assert (
        count_forces(osc.EdgeOnEdge(O3, Z, [0.1, 0, 0], Z, 1)) == 1
    )  # parallel where frames coincide


def test_contacts_that_do_not_exist_are_refused():
    here = placed()
    parallel = osc.EdgeOnEdge(O3, Z, [0.1, 0, 0], Z, 1, name="rails")
    for ask in (lambda: parallel.contact(here, STILL), lambda: parallel.gaps(here)):
        with contact_error("rails: the edges are parallel"):
            ask()
    flat = osc.GapFunctions(lambda X: 1.0)  # a gap that no motion changes, as a plain number
    with contact_error("column 0 is zero"):
        flat.contact(here, STILL)
    with refused(r"broken.gap\(X_EA\): element \(0,\) is nan"):
        osc.GapFunctions(lambda X: [np.nan], name="broken").gaps(here)


# Vertex on a face ---------------------------------------------------------------------------------


def test_a_vertex_touches_where_the_line_of_force_meets_the_face():
    rng = default_rng(0)
    here = placed()
    for _ in range(40):
        pair = osc.VertexOnFace(*rng.standard_normal((3, 3)), 0.07)
        X_WO = pose_of(rng)
        for X_WE in ([pose_of(rng)], []):
            on_face = pair.points_of_contact(X_WO, *X_WE)[:, 0]
            body = (*X_WE, here)[0]
            height = body.actInv(on_face) @ pair.normal
            assert height == approx(pair.point @ pair.normal, abs=1e-12)
            reach = (pair.gaps(X_WO, *X_WE) + 0.07) * (body.rotation @ pair.normal)
            assert_near(on_face, X_WO.act(pair.vertex) - reach, atol=1e-12)


@parametrize("normal", [*np.vstack((np.eye(3), -np.eye(3))), (1e-3, 2e-3, 0), (300, -1, 2)])
def test_the_normal_of_a_face_becomes_a_unit_vector_and_input_is_copied(normal):
    point = vector(0.1, 0.2, 0.3)
    pair = osc.VertexOnFace(np.zeros(3), point, normal)
    point[:] = 9.0
    axes = triad(pair.normal)
    assert_near(axes.T @ axes, np.eye(3), atol=1e-12)
    assert det(axes) == approx(1.0)
    assert_near([axes[:, 2], pair.normal], [unit(normal)] * 2, atol=1e-12)
    assert_array_equal(pair.point, [0.1, 0.2, 0.3])
    assert pair.radius == 0.0 and pair.name == "vertex_on_face"


@parametrize("name", ALL)
def test_edges_and_faces_press_flat(name):
    flat = (osc.EdgeOnFace, osc.CylinderOnPlane, osc.FaceOnFace)
    assert presses_flat(drawn(name, 1)[0]) == (class_of(name) in flat)
