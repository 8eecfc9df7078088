"""Screws of wrenches and twists, the basis of T, against motions and moments computed anew."""

import numpy as np
import pinocchio as pin
from complaints import invalid_input
from pytest import mark

from osc_contact.visual.screws import twist_screw, wrench_screw

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
        with invalid_input("no screw"):
            twist_screw(bad, np.zeros(3))
