"""The conventions page against Pinocchio's own spatial algebra."""

import numpy as np
import pinocchio as pin
from numpy.linalg import norm
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from rigs import refused, shift, unit
from samples import parametrize

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


@parametrize("columns", [0, 1, 5])
def test_products_and_carrying_agree_with_pinocchio_column_by_column(columns):
    """The input is left alone."""
    V, U, F = given = default_rng(columns).standard_normal((3, 6, columns))
    kept = given.copy()
    start, end = default_rng(9).standard_normal((2, 3))
    X = shift(start - end)
    for made, want, of in (
        (lambda v, u: cross(v[:3], u[:3]), lambda v, u: pin.skew(v[:3]) @ u[:3], (V, U)),
        (lambda v: carry_twist(v, start, end), lambda v: X.act(pin.Motion(v)).vector, (V,)),
        (lambda f: carry_wrench(f, start, end), lambda f: X.act(pin.Force(f)).vector, (F,)),
    ):
        got = made(*of)
        assert got.shape[1] == columns
        for k, each in enumerate(zip(*(one.T for one in of), strict=True)):
            assert_allclose(got[:, k], want(*each), atol=1e-14)
            assert_allclose(made(*each), want(*each), atol=1e-14)
    for v, u, f in zip(V.T, U.T, F.T, strict=True):
        assert_array_equal(skew(v[:3]), pin.skew(v[:3]))
        assert_allclose(cross_twist(v, u), pin.Motion(v).cross(pin.Motion(u)).vector, atol=1e-14)
        assert_allclose(cross_wrench(v, f), pin.Motion(v).cross(pin.Force(f)).vector, atol=1e-14)
    assert_array_equal(given, kept)


@parametrize("seed", SEEDS)
def test_classical_to_spatial_agrees_with_pinocchio(seed):
    pin.seed(seed)
    rng = default_rng(seed)
    model = pin.buildSampleModelManipulator()
    data = model.createData()
    q = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))
    v, a = rng.standard_normal((2, model.nv))
    pin.forwardKinematics(model, data, q, v, a)
    pin.updateFramePlacements(model, data)
    at = (model, data, model.nframes - 1, pin.LOCAL_WORLD_ALIGNED)
    V = pin.getFrameVelocity(*at).vector
    spatial = classical_to_spatial(pin.getFrameClassicalAcceleration(*at).vector, V)
    assert_allclose(spatial, pin.getFrameAcceleration(*at).vector, atol=1e-12)


@parametrize("seed", SEEDS)
def test_pose_error_carries_the_object_to_its_goal(seed):
    pin.seed(seed)
    X_WD = pin.SE3.Random()
    X_WO = pin.SE3.Random()
    e = pose_error(X_WD, X_WO)
    assert_allclose(X_WO.translation + e[:3], X_WD.translation, atol=1e-14)
    turned = pin.AngleAxis(float(norm(e[3:])), unit(e[3:]))
    assert_allclose(turned.matrix() @ X_WO.rotation, X_WD.rotation, atol=1e-12)
    assert norm(e[3:]) <= np.pi + 1e-12


def test_as_array_returns_a_fresh_float_copy():
    for given, shape in ((np.arange(6).reshape(2, 3), (2, None)), (np.ones(3), (3,))):
        kept = given.copy()
        taken = as_array("x", given, shape)
        assert taken.dtype == np.float64
        taken += 7.0
        assert_array_equal(given, kept)
    assert as_array("x", np.zeros((6, 0)), (6, None)).shape == (6, 0)
    assert as_array("x", 2, ()) == 2.0


@parametrize(
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
    with refused(message) as caught:
        as_array("tool", value, shape)
    assert isinstance(caught.value, OscContactError) and isinstance(caught.value, ValueError)
