"""The conventions page against Pinocchio's own spatial algebra."""

import numpy as np
import pinocchio as pin
from numpy.testing import assert_allclose, assert_array_equal
from pytest import mark, raises

from osc_contact.errors import InvalidInputError, OscContactError
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


def shift(start, end):
    """Pose of `start` seen from `end`, axes parallel: its action carries from start to end."""
    return pin.SE3(np.eye(3), start - end)


@mark.parametrize("seed", SEEDS)
def test_skew_is_the_cross_product(seed):
    x, y = np.random.default_rng(seed).normal(size=(2, 3))
    assert_allclose(skew(x) @ y, np.cross(x, y), atol=1e-15)
    assert_array_equal(skew(x), pin.skew(x))


def test_cross_works_column_by_column():
    x, y = np.random.default_rng(0).normal(size=(2, 3, 5))
    for k in range(5):
        assert_allclose(cross(x, y)[:, k], pin.skew(x[:, k]) @ y[:, k], atol=1e-15)
        assert_allclose(cross(x[:, k], y[:, k]), cross(x, y)[:, k], atol=1e-15)
    assert cross(np.zeros((3, 0)), np.zeros((3, 0))).shape == (3, 0)


@mark.parametrize("seed", SEEDS)
def test_carrying_agrees_with_pinocchio(seed):
    rng = np.random.default_rng(seed)
    V, F = rng.normal(size=(2, 6))
    start, end = rng.normal(size=(2, 3))
    X = shift(start, end)
    assert_allclose(carry_twist(V, start, end), X.act(pin.Motion(V)).vector, atol=1e-14, rtol=0)
    assert_allclose(carry_wrench(F, start, end), X.act(pin.Force(F)).vector, atol=1e-14, rtol=0)


def test_carrying_columns_is_carrying_each_and_leaves_the_input_alone():
    rng = np.random.default_rng(0)
    V, F = rng.normal(size=(2, 6, 4))
    kept = V.copy(), F.copy()
    start, end = rng.normal(size=(2, 3))
    for k in range(4):
        assert_allclose(
            carry_twist(V, start, end)[:, k], carry_twist(V[:, k], start, end), atol=1e-15
        )
        assert_allclose(
            carry_wrench(F, start, end)[:, k], carry_wrench(F[:, k], start, end), atol=1e-15
        )
    power = F.T @ V
    assert_allclose(carry_wrench(F, start, end).T @ carry_twist(V, start, end), power, atol=1e-13)
    assert_array_equal(V, kept[0])
    assert_array_equal(F, kept[1])
    assert carry_twist(np.zeros((6, 0)), start, end).shape == (6, 0)


@mark.parametrize("seed", SEEDS)
def test_cross_products_agree_with_pinocchio(seed):
    V, U, F = np.random.default_rng(seed).normal(size=(3, 6))
    assert_allclose(cross_twist(V, U), pin.Motion(V).cross(pin.Motion(U)).vector, atol=1e-14)
    assert_allclose(cross_wrench(V, F), pin.Motion(V).cross(pin.Force(F)).vector, atol=1e-14)


@mark.parametrize("seed", SEEDS)
def test_classical_to_spatial_agrees_with_pinocchio(seed):
    pin.seed(seed)
    rng = np.random.default_rng(seed)
    model = pin.buildSampleModelManipulator()
    data = model.createData()
    q = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))
    v, a = rng.normal(size=(2, model.nv))
    pin.forwardKinematics(model, data, q, v, a)
    pin.updateFramePlacements(model, data)
    at = (model, data, model.nframes - 1, pin.LOCAL_WORLD_ALIGNED)
    V = pin.getFrameVelocity(*at).vector
    classical = pin.getFrameClassicalAcceleration(*at).vector
    kept = classical.copy()
    spatial = classical_to_spatial(classical, V)
    assert_allclose(spatial, pin.getFrameAcceleration(*at).vector, atol=1e-12)
    assert_array_equal(classical, kept)


@mark.parametrize("seed", SEEDS)
def test_pose_error_carries_the_object_to_its_goal(seed):
    pin.seed(seed)
    X_WD = pin.SE3.Random()
    X_WO = pin.SE3.Random()
    e = pose_error(X_WD, X_WO)
    assert_allclose(X_WO.translation + e[:3], X_WD.translation, atol=1e-14)
    turned = pin.AngleAxis(float(np.linalg.norm(e[3:])), e[3:] / np.linalg.norm(e[3:]))
    assert_allclose(turned.matrix() @ X_WO.rotation, X_WD.rotation, atol=1e-12)
    assert np.linalg.norm(e[3:]) <= np.pi + 1e-12


def test_as_array_returns_a_fresh_float_copy():
    given = np.arange(6).reshape(2, 3)
    taken = as_array("x", given, (2, None))
    assert taken.dtype == np.float64 and taken.shape == (2, 3)
    taken[0, 0] = 7.0
    assert given[0, 0] == 0
    same = np.ones(3)
    as_array("x", same, (3,))[0] = 2.0
    assert same[0] == 1.0
    assert as_array("x", np.zeros((6, 0)), (6, None)).shape == (6, 0)
    assert as_array("x", 2, ()) == 2.0


@mark.parametrize(
    ("value", "shape", "message"),
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
    with raises(InvalidInputError, match=message) as caught:
        as_array("tool", value, shape)
    assert isinstance(caught.value, OscContactError) and isinstance(caught.value, ValueError)
