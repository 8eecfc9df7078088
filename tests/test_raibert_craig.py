"""The constraint frame of Raibert and Craig: found where there is one, refused with the reason."""

import re

import numpy as np
import pinocchio as pin
from numpy.linalg import det, norm, pinv
from numpy.random import default_rng
from pytest import approx, raises
from rigs import assert_near, placed, pose_of, refused, rotated, shift, vector
from samples import parametrize

from osc_contact.contacts import raibert_craig
from osc_contact.contacts.contact import Contact
from osc_contact.contacts.raibert_craig import as_raibert_craig, selection_columns
from osc_contact.errors import ContactError, InvalidInputError

SIZE = 0.3
ALL = (True,) * 3


def frame_at(rng):
    X = pose_of(rng)
    return pin.SE3(X.rotation, SIZE * X.translation)


def selection(rng, ranks=range(7)):
    while True:
        flags = rng.random(6) < rng.random()
        if flags.sum() in ranks:
            return (flags[:3], flags[3:])


def line(direction, point):
    """(6,) a unit magnitude of force along a line."""
    return np.concatenate((direction, np.cross(point, direction)))


def couple(axis):
    return np.concatenate((np.zeros(3), axis))


def largest_sine(A, B):
    """Between range(A) and range(B), by their orthogonal projectors."""
    assert A.shape == B.shape
    projectors = []
    for columns in (A, B):
        scaled = columns / np.array([1.0] * 3 + [SIZE] * 3)[:, None]
        projectors.append(scaled @ pinv(scaled))
    return norm(projectors[0] - projectors[1], 2)


def space_of(found):
    return selection_columns(found.frame, found.forces, found.couples)


def kind(forces, couples):
    """Numbers of forces, of couples, and of axes with both."""
    f = np.asarray(forces)
    c = np.asarray(couples)
    return (f.sum(), c.sum(), (f & c).sum())


def assert_describes(found, N):
    assert found, found.reason
    assert found.reason == "" and 0.0 <= found.residual <= 1e-9
    E = found.frame.rotation
    assert_near(E.T @ E, np.eye(3), atol=1e-12)
    assert det(E) > 0.0
    assert largest_sine(space_of(found), N) < 1e-9


# Found --------------------------------------------------------------------------------------------


def test_every_frame_and_selection_is_recognised_in_any_basis(monkeypatch):
    monkeypatch.setattr(raibert_craig, "_REFINEMENTS", 0)  # by construction, not by search
    rng = default_rng(1)
    kinds = set()
    for _ in range(300):
        forces, couples = selection(rng)
        frame = frame_at(rng)
        axes = frame.rotation.T
        lines = [line(axis, frame.translation) for axis in axes[forces]]
        N = selection_columns(frame, forces, couples)
        assert_near(N.T, [*lines, *map(couple, axes[couples])] or N.T, atol=1e-15)
        N = N @ rng.standard_normal((N.shape[1],) * 2)
        found = as_raibert_craig(N, SIZE)
        assert_describes(found, N)
        assert kind(found.forces, found.couples) == kind(forces, couples)
        kinds.add(kind(forces, couples))
    assert len(kinds) == 20  # all there are


LEAN = vector(0.6, 0.0, 0.8)
Z = vector(0.0, 0.0, 1.0)
Q = vector(0.1, -0.2, 0.05)


def test_the_frame_lies_where_one_would_put_it():
    """Axes named like the world's where they can be, the origin where the lines meet."""
    columns = [line(Z, p) for p in ([0, 0, 0], [0.2, 0, 0], [0, 0.3, 0])]
    face = as_raibert_craig(np.column_stack(columns), SIZE)
    assert face.forces == (False, False, True) and face.couples == (True, True, False)
    assert_near(face.frame.rotation, np.eye(3), atol=1e-12)
    for directions in ((LEAN, Z), (LEAN, Z, (0, 1, 1))):
        found = as_raibert_craig(np.column_stack([line(d, Q) for d in directions]), SIZE)
        assert_near(found.frame.translation, Q, atol=1e-12)
        assert kind(found.forces, found.couples) == (len(directions), 0, 0)
    # on a single line: the point nearest to the centre
    found = as_raibert_craig(line(LEAN, Q)[:, None], SIZE, centre=[1.0, 0, 0])
    assert_near(found.frame.translation, Q + LEAN * (LEAN @ ([1.0, 0, 0] - Q)), atol=1e-12)


# Refused ------------------------------------------------------------------------------------------


def test_skew_lines_are_refused_with_their_distance():
    """Fig. 1 and hundreds more, in any basis: (ii) fails, (i) does not."""
    rng = default_rng(2)
    for _ in range(300):
        u, v = rng.standard_normal((2, 3))
        p, q = SIZE * rng.standard_normal((2, 3))
        distance = abs(np.cross(u, v) @ (p - q)) / norm(np.cross(u, v))
        N = np.column_stack((line(u, p), line(v, q))) @ rng.standard_normal((2, 2))
        found = as_raibert_craig(N, SIZE)
        assert not found and 1e-9 < found.residual <= 1.0
        match = re.match(
            r"\(ii\) the lines of force pass (\S+) mm apart; no one point lies on both",
            found.reason,
        )
        assert match and "(i)" not in found.reason, found.reason
        assert float(match[1]) == approx(1e3 * distance, rel=1e-3)
        assert largest_sine(space_of(found), N) == approx(found.residual, abs=1e-9)


def cone_in_groove(angle):
    """Fig. 2: spin about the cone's axis, slide along a groove at `angle` from it. N (6, 4)."""
    axis = vector(np.cos(angle), 0.0, np.sin(angle))
    spin = np.concatenate((np.cross(Q, axis), axis))
    return Contact.from_tangents(np.column_stack((spin, [1.0, 0, 0, 0, 0, 0]))).N


def test_cone_in_groove_is_refused_for_its_axes():
    found = as_raibert_craig(cone_in_groove(np.deg2rad(60.0)), SIZE)
    assert not found
    assert found.reason.startswith(
        "(i) the couples and the forces have no common triad of axes: the normal of the plane of "
        "the forces and the normal of the plane of the couples are 60° apart, neither parallel "
        "nor perpendicular"
    )
    assert "(ii)" not in found.reason
    for angle in (0.0, np.pi / 2):
        assert_describes(as_raibert_craig(cone_in_groove(angle), SIZE), cone_in_groove(angle))
    # a little off the right angle: off by about as little
    assert 1e-4 < as_raibert_craig(cone_in_groove(np.pi / 2 - 1e-3), SIZE).residual < 1e-2


def test_contacts_of_a_selection_are_described_from_any_centre():
    """Figs. 1 and 2 by their own geometry: test_every_scenario.py, test_cone_in_groove.py."""
    frame = pin.SE3(pin.exp3(0.3 * LEAN), 0.1 * Z)
    for centre in (None, [0.1, 0.2, 0.3]):
        same = Contact.from_selection(frame, (True, False, False), (False, True, True))
        assert_describes(same.as_raibert_craig(centre=centre), same.N)


@parametrize("r", [1, 5])
def test_screws_are_refused_with_their_pitch(r):
    pitch = 0.007
    screw = line(LEAN, Q) + pitch * couple(LEAN)
    joint = screw.copy()
    joint[:3] = line(LEAN, Q)[3:] + pitch * LEAN
    joint[3:] = LEAN
    N = screw[:, None] if r == 1 else Contact.from_tangents(joint[:, None]).N
    found = as_raibert_craig(N, SIZE)
    assert not found
    assert found.reason == (
        "(ii) the forces do not act through one point: taken through the best one, a unit force "
        "still carries a couple of 7 mm"
    )


def test_both_conditions_can_fail():
    """A couple at 45° to the plane of two forces through Q, one of them screwed by 10 mm."""
    N = np.column_stack((line([1.0, 0, 0], Q), line(Z, Q), couple([0, 1.0, 1.0])))
    tilted = as_raibert_craig(N, SIZE)
    assert tilted.reason.startswith(
        "(i) the couples and the forces have no common triad of axes: the normal of the plane of "
        "the forces and the line of the couples are 45° apart"
    )
    assert not tilted and "(ii)" not in tilted.reason
    N[3:, 0] += [0.01, 0, 0]
    both = as_raibert_craig(N, SIZE)
    assert not both and both.reason.startswith(tilted.reason)
    assert "; (ii) the forces do not act through one point" in both.reason
    assert "a unit force still carries a couple of 10 mm" in both.reason
    N[3:, 0] += [4.0, 0, 0]  # a pitch of many sizes hides nothing
    assert as_raibert_craig(N, SIZE).reason.startswith(tilted.reason.split(";")[0])


def test_a_nearly_parallel_pair_is_reported_as_such():
    N = np.column_stack((line([0, 0, 1.0], [0.2, 0, 0]), line([0, 1e-6, 1.0], [-0.2, 0, 0])))
    found = as_raibert_craig(N, SIZE)
    assert not found and 1e-8 < found.residual < 2e-6
    assert found.reason == (
        "(ii) the lines of force pass 400 mm apart; no one point lies on both; "
        "the nearest frame has forces on 1, couples on 1 axes"
    )
    assert as_raibert_craig(N, SIZE, tolerance=1e-5)


# The residual -------------------------------------------------------------------------------------


def columns(rng, r):
    return np.concatenate((rng.standard_normal((3, r)), SIZE * rng.standard_normal((3, r))))


@parametrize("r", range(1, 6))
def test_neighbouring_frames_come_hardly_closer(r):
    """Gauss–Newton takes the sum of squares: with a single sine (r = 1, 5) that is the sine."""
    rng = default_rng([5, r])
    for _ in range(4):
        N = columns(rng, r)
        found = as_raibert_craig(N, SIZE)
        nearest = 1.0
        for _ in range(300):
            small = 10 ** rng.uniform(-3, -0.5) * rng.standard_normal(6)
            turn = pin.exp3(small[3:])
            origin = found.frame.translation + SIZE * small[:3]
            moved = pin.SE3(turn @ found.frame.rotation, origin)
            S = selection_columns(moved, found.forces, found.couples)
            nearest = min(nearest, largest_sine(S, N))
        assert found.residual <= (1.01 if r in (1, 5) else 1.25) * nearest


def test_nothing_depends_on_operational_point_axes_units_or_basis():
    rng = default_rng(6)
    millimetres = np.repeat([[1.0], [1e3]], 3, axis=0)
    for i in range(60):
        r = 1 + i % 5
        N = columns(rng, r)
        if i % 2:
            N = selection_columns(frame_at(rng), *selection(rng, range(r, r + 1)))
        centre, away = SIZE * rng.standard_normal((2, 3))
        found = as_raibert_craig(N, SIZE, centre=centre)
        R = pose_of(rng).rotation
        turned = np.kron(np.eye(2), R) @ N
        about_another = np.concatenate((N[:3], N[3:] - np.cross(away, N[:3], axis=0)))
        same = placed()
        for other, at, X, unit in (
            (about_another, centre - away, shift(away), 1.0),
            (turned, R @ centre, rotated(R.T), 1.0),
            (N @ rng.standard_normal((r, r)), centre, same, 1.0),
            (N * millimetres, 1e3 * centre, same, 1e3),
        ):
            other = as_raibert_craig(other, unit * SIZE, centre=at)
            assert other.residual == approx(found.residual, rel=1e-6, abs=1e-9)
            assert other.reason == found.reason or unit > 1.0  # which names lengths
            assert kind(other.forces, other.couples) == kind(found.forces, found.couples)
            other.frame.translation /= unit
            S = selection_columns(X * other.frame, other.forces, other.couples)
            assert largest_sine(S, space_of(found)) < 1e-4


# Refusals -----------------------------------------------------------------------------------------


@parametrize("flags", [(True, False), (True, False, 2), (True, None, False), True])
def test_malformed_selections_are_refused(flags):
    with refused(r"forces = .* three times True or False"):
        selection_columns(placed(), flags, ALL)
    with refused("couples = "):
        selection_columns(placed(), ALL, flags)


@parametrize(
    "given, words",
    [
        *((dict(size=size), "size = ") for size in (0.0, -1.0, np.nan, np.inf)),
        *((dict(tolerance=tolerance), "tolerance = ") for tolerance in (0.0, 1.0, np.nan)),
        (dict(N=np.eye(5)), r"N: expected shape \(6, any\)"),
        (dict(centre=np.zeros(2)), r"centre: expected shape \(3\)"),
        (dict(N=np.ones((6, 2))), r"columns \[0, 1\] are dependent"),
        (dict(N=np.zeros((6, 1))), "column 0 is zero; remove it"),
        (dict(N=np.ones((6, 7))), "7 columns in a 6-dimensional space"),
    ],
)
def test_impossible_input_is_refused(given, words):
    with raises((ContactError, InvalidInputError), match=words):
        as_raibert_craig(**{"N": np.eye(6), "size": SIZE} | given)
