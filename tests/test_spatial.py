"""The conventions page against Pinocchio's own spatial algebra."""

import numpy as np
import pinocchio as pin
from numpy.linalg import norm
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from rigs import assert_near, data_at, refused, shift, unit
from samples import aligned, parametrize

from osc_contact.errors import OscContactError
from osc_contact.spatial import (
    as_array,
    carry_twist,
    carry_wrench,
    classical_to_spatial,
    cross,
    cross_twist,
    cross_wrench,
    pose_error,
    skew,
)

SEEDS = range(4)


@parametrize("columns", [0, 5])
def test_products_and_carrying_agree_with_pinocchio_column_by_column(columns):
    """The input is left alone."""
    V, U, F = given = default_rng(columns).standard_normal((3, 6, columns))
    kept = given.copy()
    start, end = default_rng(9).standard_normal((2, 3))
    X = shift(start - end)
    products = cross(V[:3], U[:3])
    motions = carry_twist(V, start, end)
    forces = carry_wrench(F, start, end)
    assert [found.shape[1] for found in (products, motions, forces)] == 3 * [columns]
    for k, (v, u, f) in enumerate(aligned(V.T, U.T, F.T)):
        twist = pin.Motion(v)
        W = skew(v[3:])
        for got, expected in (
            (products[:, k], pin.skew(v[:3]) @ u[:3]),
            (motions[:, k], X.act(twist).vector),
            (forces[:, k], X.act(pin.Force(f)).vector),
            (skew(v[:3]) @ u[:3], np.cross(v[:3], u[:3])),
            (cross_twist(v, u), np.block([[W, skew(v[:3])], [np.zeros((3, 3)), W]]) @ u),
            (cross_wrench(v, f) @ u, -f @ cross_twist(v, u)),
        ):
            assert_near(got, expected, atol=1e-14)
    assert_array_equal(given, kept)


@parametrize("seed", SEEDS)
def test_classical_to_spatial_agrees_with_pinocchio(seed):
    pin.seed(seed)
    model = pin.buildSampleModelManipulator()
    q = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))
    v, a = default_rng(seed).standard_normal((2, model.nv))
    at = (model, data_at(model, q, v, a), model.nframes - 1, pin.LOCAL_WORLD_ALIGNED)
    V = pin.getFrameVelocity(*at).vector
    spatial = classical_to_spatial(pin.getFrameClassicalAcceleration(*at).vector, V)
    assert_near(spatial, pin.getFrameAcceleration(*at).vector, atol=1e-12)


@parametrize("seed", SEEDS)
def test_pose_error_carries_the_object_to_its_goal(seed):
    pin.seed(seed)
    X_WD = pin.SE3.Random()
    X_WO = pin.SE3.Random()
    e = pose_error(X_WD, X_WO)
    assert_near(X_WO.translation + e[:3], X_WD.translation, atol=1e-14)
    turned = pin.AngleAxis(norm(e[3:]), unit(e[3:]))
    assert_near(turned.matrix() @ X_WO.rotation, X_WD.rotation, atol=1e-12)
    assert norm(e[3:]) <= np.pi + 1e-12


def test_as_array_returns_a_fresh_float_copy():
    for given, shape in ((np.arange(6).reshape(2, 3), (2, None)), (np.ones(3), (3,))):
        kept = given.copy()
        taken = as_array("x", given, shape)
        assert taken.dtype == np.float64
        taken += 7.0
        assert_array_equal(given, kept)
    assert as_array("x", np.zeros((6, 0)), (6, None)).shape == (6, 0)
    assert as_array("x", 2, ()) == as_array("x", 2, (None,))[0] == 2.0


@parametrize(
    "value, shape, message",
    [
        (np.zeros((2, 3)), (3, 3), r"tool: expected shape \(3, 3\), got \(2, 3\)"),
        (np.zeros(3), (3, None), r"tool: expected shape \(3, any\), got \(3,\)"),
        (np.zeros((3, 1)), (3,), r"tool: expected shape \(3\), got \(3, 1\)"),
        (1.0, (1,), r"tool: expected shape \(1\), got \(\)"),
        ([[1.0, 2.0], [np.nan, 0.0]], (2, 2), r"tool: element \(1, 0\) is nan"),
        ([1.0, -np.inf], (2,), r"tool: element \(1,\) is -inf"),
        ([[1.0], [1.0, 2.0]], (2, None), "tool: expected numbers"),
        ("here", (3,), "tool: expected numbers"),
        ([1j, 0.0], (2,), "tool: expected numbers"),
        (None, (3,), "tool: expected shape"),
    ],
)
def test_as_array_refuses_what_does_not_fit(value, shape, message):
    with refused(message) as caught:
        as_array("tool", value, shape)
    assert isinstance(caught.value, OscContactError) and isinstance(caught.value, ValueError)
