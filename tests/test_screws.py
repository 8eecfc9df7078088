"""Screws of wrenches and twists, the basis of T, against motions and moments computed anew."""

import numpy as np
import pinocchio as pin
from pytest import approx, mark, raises

from osc_contact.errors import InvalidInputError
from osc_contact.visual.screws import (
    contact_normals,
    echelon,
    helix,
    tangents,
    twist_screw,
    wrench_screw,
)

SEEDS = range(4)


@mark.parametrize("seed", SEEDS)
def test_twist_axis_is_where_a_finite_motion_only_advances(seed):
    """exp(V) moves the points of the axis along the axis, by the pitch per radian."""
    rng = np.random.default_rng(seed)
    twist = rng.standard_normal(6)
    origin = rng.standard_normal(3)
    point, direction, pitch = twist_screw(twist, origin)
    motion = pin.exp6(pin.Motion(twist))  # about `origin`
    angle = np.linalg.norm(twist[3:])
    for s in (-1.0, 0.0, 2.0):
        p = point + s * direction - origin
        assert np.allclose(motion * p - p, pitch * angle * direction, atol=1e-9)
    assert abs((point - origin) @ direction) < 1e-9, "the nearest point"


@mark.parametrize("seed", SEEDS)
def test_wrench_has_only_a_couple_along_its_axis_wherever_it_is_given(seed):
    rng = np.random.default_rng(seed)
    (force, moment) = rng.standard_normal((2, 3))
    origins = rng.standard_normal((2, 3))
    for origin in origins:
        there = moment + np.cross(origins[0] - origin, force)
        point, direction, pitch = wrench_screw([*force, *there], origin)
        on_axis = there + np.cross(origin - point, force)
        assert np.allclose(on_axis, pitch * force, atol=1e-9)
        assert np.allclose(direction * np.linalg.norm(force), force)


def test_couples_and_translations_have_no_pitch_and_nonsense_is_refused():
    couple = wrench_screw([0, 0, 0, 0, 0, 2.0], [1, 2, 3])
    assert np.isinf(couple.pitch) and np.allclose(couple.direction, [0, 0, 1])
    slide = twist_screw([0, 3.0, 0, 0, 0, 0], [1, 2, 3])
    assert np.isinf(slide.pitch) and np.allclose(slide.direction, [0, 1, 0])
    for bad in (np.zeros(6), np.ones(5), [np.nan, 0, 0, 0, 0, 1]):
        with raises(InvalidInputError, match="no screw"):
            twist_screw(bad, np.zeros(3))


@mark.parametrize("r", range(7))
def test_tangents_span_all_that_the_normals_permit(r):
    rng = np.random.default_rng(r)
    for _ in range(10):
        N = rng.standard_normal((6, r)) * 10.0 ** rng.uniform(-2, 2, r)
        T = tangents(N)
        assert T.shape == (6, 6 - r)
        assert np.abs(N.T @ T).max(initial=0.0) < 1e-8 * max(1.0, np.abs(N).max(initial=0.0))
        assert np.linalg.matrix_rank(T) == 6 - r
    repeated = np.hstack([N, N[:, :1]])
    assert tangents(repeated).shape == (6, 6 - r), "dependent contacts take nothing more away"


def test_echelon_keeps_the_space_and_puts_translations_first():
    rng = np.random.default_rng(2)
    plain = np.zeros((6, 3))
    plain[1, 0] = plain[5, 1] = plain[3, 2] = 1.0
    plain[0, 1] = 0.3
    basis = echelon(plain @ rng.standard_normal((3, 3)))
    assert np.allclose(basis[:, 0], plain[:, 0], atol=1e-9), "the only translation"
    assert np.linalg.matrix_rank(np.hstack([basis, plain]), tol=1e-9) == 3
    assert np.allclose(basis[3:, 1:].sum(axis=0), 1.0), "one world axis each"


@mark.parametrize("pitch", [0.0, 0.02, -0.3, 5.0])
def test_helix_has_the_pitch_the_radius_and_the_length(pitch):
    path = helix(pitch, 0.03, 0.1, 400)
    assert np.allclose(np.hypot(path[:, 0], path[:, 2]), 0.03)
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).sum() == approx(0.1, rel=1e-3)
    turned = np.arctan2(path[:, 0], path[:, 2])
    assert np.polyfit(turned, path[:, 1], 1)[0] == approx(pitch, abs=1e-6)
    moved = pin.exp6(pin.Motion(np.array([0.0, pitch, 0.0, 0.0, 1.0, 0.0]) * 1e-3)) * path[200]
    assert np.allclose(np.cross(moved - path[200], path[201] - path[200]), 0.0, atol=1e-7)


def test_normals_leave_out_what_is_open_or_unknown():
    sample = {
        "pose": [0.1, 0.2, 0.3, 0, 0, 0, 1],
        "contact_point": [[1.0, 0, 0], [np.nan] * 3, [0, 1.0, 0]],
        "contact_direction": [[0, 0, 1.0], [0, 0, 1.0], [0, 0, -1.0]],
        "closed": [True, True, False],
    }
    found = contact_normals(sample)
    assert found.known.tolist() == [True, False, True]
    assert found.pressed.tolist() == [True, False, False]
    moment = np.cross(np.array([1.0, 0, 0]) - [0.1, 0.2, 0.3], [0, 0, 1.0])
    assert np.allclose(found.N[:, 0], [0, 0, 1, *moment]) and not found.N[:, 1].any()
    wide = contact_normals({**sample, "N": np.eye(6)[:, :4]}, [0, 0, 2, 1])
    assert wide.owner.tolist() == [0, 0, 2, 1]
    assert wide.pressed.tolist() == [True, True, False, False]
