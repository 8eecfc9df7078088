"""A pair given as a function that numba compiles: the kind for the tests of all pairs, its ways."""

import pickle

import numpy as np
import pinocchio as pin
from complaints import contact_error
from numba import njit
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pair_kinds import kind, placed
from pytest import mark
from rigs import STILL, direction, one_panda, posed, refused, unloaded, vector

import osc_contact as osc


def ball_on_ball(X_WO, V_O, X_WE, V_E, given, *out):
    """A ball of the object, centre and radius, on one of the environment; all from O."""
    N, n_gamma, gaps, points = out
    p = X_WO[:3, :3].copy() @ given[:3]
    c = X_WE[:3, 3] - X_WO[:3, 3] + X_WE[:3, :3].copy() @ given[4:7]
    p_dot = V_O[:3] + np.cross(V_O[3:], p)
    slip = V_E[:3] + np.cross(V_E[3:], c) - p_dot
    apart = np.sqrt(((c - p) ** 2).sum())
    n = (c - p) / apart
    n_dot = (slip - n * (n * slip).sum()) / apart
    V = V_O - V_E
    n_gamma[0] = -(n_dot * V[:3]).sum()
    n_gamma[0] -= ((np.cross(p_dot, n) + np.cross(p, n_dot)) * V[3:]).sum()
    N[:3, 0] = n
    N[3:, 0] = np.cross(p, n)
    points[:, 0] = X_WO[:3, 3] + p + given[3] * n
    gaps[0] = apart - given[3] - given[7]


one_ball = njit(ball_on_ball)


@kind
def compiled_pair(rng, c):
    ball = rng.standard_normal(3)
    rest = rng.standard_normal(3)
    radii = rng.uniform(10.0, 20.0, 2)  # the oracle differentiates numerically, steps of 5 mm
    given = np.concatenate((c.A(ball), radii[:1] * c.per_metre, c.E(rest), radii[1:] * c.per_metre))

    def pose(q):
        x, y, z = pin.exp3(np.append(q[3:], 0.0))[:, 2]
        return placed(pin.exp3(q[:3]), ball, rest + radii.sum() * vector(x, y, z))

    return (osc.CompiledPair(ball_on_ball, given, pushes=True), pose, 1)


def nothing(*arrays):
    """N stays as it is given."""


def of_no_type(*arrays):
    arrays[7][0] = {}.nothing_of_the_kind


def balls_on_balls(X_WO, V_O, X_WE, V_E, given, *out):
    N, n_gamma, gaps, points = out
    for k in range(len(gaps)):
        rest = (N[:, k:], n_gamma[k:], gaps[k:], points[:, k:])
        one_ball(X_WO, V_O, X_WE, V_E, given[8 * k :], *rest)


def same_geometry(X, count):
    """A compiled pair, and packaged ones of the same geometry."""
    rng = default_rng(3)
    given = []
    surfaces = []
    for _ in range(count):
        ball = 0.1 * rng.standard_normal(3)
        at = X.act(ball) + 0.112 * direction(rng)
        surfaces.append(osc.SphereOnSurface(ball, 0.012, osc.Surface.sphere(0.1), at))
        given += [*ball, 0.012, *at, 0.1]
    return ([osc.CompiledPair(balls_on_balls, given, forces=count, pushes=True)], surfaces)


@mark.parametrize("count", [1, 3])
@mark.parametrize("friction", [None, osc.Friction(mu=0.2)])
def test_a_controller_ticks_as_with_the_packaged_pair(friction, count):
    chain = one_panda()
    q, v, X = posed(chain, default_rng(4))
    measurement = osc.Measurement(q, 0.1 * v, np.ones((1, 6)))
    reference = osc.Reference(X, np.full(6, 0.02), alpha_d=np.arange(10.0, 10.0 + count))
    if count > 1 and friction is not None:
        # normals are estimated of pairs with one column, and μ learned with them: three packaged
        # pairs have such normals, one compiled pair of three columns has none
        friction = friction.model_copy(update={"learning": 0.0})
    controllers = [
        osc.Controller(chain, pairs, friction=friction) for pairs in same_geometry(X, count)
    ]
    assert {controller.reading for controller in controllers} == {"least_squares"}
    for _ in range(3):
        ours, theirs = (one.tick(measurement, reference) for one in controllers)
        assert_allclose(ours, theirs, rtol=1e-9)
    assert controllers[0].status is controllers[1].status is osc.Status.OK
    again = pickle.loads(pickle.dumps(controllers[0]))
    assert_array_equal(
        again.tick(measurement, reference), controllers[0].tick(measurement, reference)
    )


def test_what_is_wrong_is_reported(tmp_path):
    with refused("numba cannot compile it"):
        osc.CompiledPair(of_no_type)
    with refused("forces = 7; give r, 1 … 6"):
        osc.CompiledPair(nothing, forces=7)
    empty = osc.CompiledPair(nothing)
    with contact_error("N or n_γ is not finite"):
        empty.contact(pin.SE3.Identity(), STILL)
    chain = one_panda()
    q, v, X = posed(chain, default_rng(4))
    controller = osc.Controller(chain, [empty])
    tau = controller.tick(unloaded(q, v), osc.Reference(X, alpha_d=vector(1.0)))
    assert controller.status is osc.Status.HELD and np.isfinite(tau).all()
    assert "returned what is not finite" in controller.reason
    with refused("CompiledPair"):
        controller.save(tmp_path / "controller")
