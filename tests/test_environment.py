"""The constructors of `Environment`, each by itself, and what they refuse."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
from environment_scenes import RTOL, close_to, linkage, random_inertia, scene
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import mark, raises
from rigs import largest, panda_pair, random_state, refused, scara_pair

import osc_contact as osc
from osc_contact.dynamics.environment import Environment
from osc_contact.response import contact_response
from paper.command_filter import command


def test_one_body_behind_every_contact_stays_what_it_is():
    """Shared bodies couple their contacts; as one environment or by their normals is the same."""
    rng = default_rng(44)
    s = scene(panda_pair, "free body", rng)
    env = s.environment
    assert Environment.combine(s.parts, [env, env], s.state.metric) is env
    N = s.contact.N
    alike = Environment.of_contacts(
        N, N.T @ env.Phi_e @ N, N.T @ env.b_e, N.T @ env.V_e, s.state.metric
    )
    tau = rng.standard_normal(s.chain.n_a) * 20
    a, b = (contact_response(s.state, s.contact, e, tau=tau) for e in (env, alike))
    assert close_to(b.alpha, a.alpha) < RTOL
    assert close_to(b.acceleration, a.acceleration) < RTOL
    assert largest(b.a_e - a.a_e) > 1e-3  # only Nᵀa_e has a meaning
    assert close_to(N.T @ b.a_e, N.T @ a.a_e) < RTOL
    apart = Environment.combine(s.parts, [env, replace(env)], s.state.metric)
    assert close_to(contact_response(s.state, s.contact, apart, tau=tau).alpha, a.alpha) > 1e-3


@mark.parametrize("seed", range(8))
def test_the_environment_of_several_contacts_does_not_depend_on_frame_or_units(seed):
    rng = default_rng([seed, 45])
    N = rng.standard_normal((6, 3))
    half = rng.standard_normal((3, 2))
    b_N = rng.standard_normal(3)
    V_N = rng.standard_normal(3)
    inertia = random_inertia(rng).matrix()
    env = Environment.of_contacts(N, half @ half.T, b_N, V_N, inertia)
    assert_allclose(N.T @ env.Phi_e @ N, half @ half.T, atol=1e-10)
    assert_allclose(N.T @ env.b_e, b_N, atol=1e-10)
    X = pin.SE3(pin.rpy.rpyToMatrix(*rng.uniform(-3, 3, 3)), rng.standard_normal(3)).action
    X = np.diag([1e3, 1e3, 1e3, 1, 1, 1]) @ X  # mm
    F = np.linalg.inv(X).T
    Q = rng.standard_normal((3, 3))  # forces; and another basis of N
    moved = Environment.of_contacts(
        F @ N @ Q, Q.T @ half @ half.T @ Q, Q.T @ b_N, Q.T @ V_N, F @ inertia @ F.T
    )
    assert close_to(moved.Phi_e, X @ env.Phi_e @ X.T) < 1e-9
    assert close_to(moved.b_e, X @ env.b_e) < 1e-9
    assert close_to(moved.V_e, X @ env.V_e) < 1e-9


# Refusals -----------------------------------------------------------------------------------------

BODY = pin.Inertia(2.0, np.array([0.1, 0, 0]), np.diag([0.02, 0.03, 0.04]))
AT = {"X_WE": pin.SE3.Identity(), "O": np.zeros(3)}


@mark.parametrize(
    "make, message",
    [
        (lambda: Environment.moving(**AT, V_E=np.zeros(3), A_E=np.zeros(6)), "V_E: expected shape"),
        (lambda: Environment.rigid_body(BODY, **AT, V_E=np.zeros(6), gravity=[9.81]), "gravity"),
        (lambda: Environment.rigid_body(BODY, **AT, V_E=np.zeros(6), wrench=[1.0]), "wrench"),
        (lambda: Environment.rail(BODY, **AT, axes=np.zeros(3), rates=[0.0]), "axes: expected"),
        (lambda: Environment.rail(BODY, **AT, axes=np.ones(6), rates=[0.0, 1.0]), "rates"),
        (lambda: Environment.rail(BODY, **AT, axes=np.ones(6), rates=[0], force=[1, 2]), "force"),
        (lambda: Environment.combine([osc.Contact(np.eye(6)[:, :1])], [], np.eye(6)), "1 contacts"),
        (lambda: of_two(np.eye(3)), r"Phi_N: expected shape \(2, 2\)"),
        (lambda: of_two([[1.0, 0.1], [0.0, 1.0]]), "Phi_N is not symmetric"),
        (lambda: of_two([[1.0, 2.0], [2.0, 1.0]]), "Phi_N is not positive semidefinite"),
    ],
)
def test_bad_arguments_are_refused(make, message):
    with refused(message):
        make()


def of_two(Phi_N):
    return Environment.of_contacts(np.eye(6)[:, :2], Phi_N, np.zeros(2), np.zeros(2), np.eye(6))


@mark.parametrize(
    "make, message",
    [
        (lambda: Environment.rail(BODY, **AT, axes=np.ones((6, 2)), rates=[0, 0]), "its axes"),
        (
            lambda: Environment.rail(
                pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))),
                **AT,
                axes=[0, 0, 0, 0, 0, 1],
                rates=[0],
            ),
            "along its axes",
        ),
        (
            lambda: Environment.rigid_body(
                pin.Inertia(0.0, np.zeros(3), np.eye(3)), **AT, V_E=np.zeros(6)
            ),
            "all must be positive",
        ),
        (
            lambda: Environment.of_contacts(
                np.eye(6)[:, :1], [[1.0]], [0.0], [0.0], np.diag([1, 1, 1, 1, 1, -1.0])
            ),
            "metric",
        ),
    ],
)
def test_impossible_bodies_are_refused(make, message):
    with raises(osc.ModelError, match=message):
        make()


def test_impossible_mechanisms_and_dependent_contacts_are_refused():
    body, _ = linkage(default_rng(46), np.zeros(3))
    args = (body.q, body.v, body.tau)
    with raises(osc.ModelError, match="touchd"):
        Environment.articulated(body.model, *args, "touchd", np.zeros(3))
    with refused("tau: expected shape"):
        Environment.articulated(body.model, body.q, body.v, np.zeros(3), "touched", np.zeros(3))
    body.model.inertias[1] = body.model.inertias[2] = pin.Inertia.Zero()
    with raises(osc.ModelError, match="joint-space inertia"):
        Environment.articulated(body.model, *args, "touched", np.zeros(3))
    n = np.eye(6)[:, [0, 0]]
    with raises(osc.ContactError, match="dependent"):
        Environment.of_contacts(n, np.eye(2), np.zeros(2), np.zeros(2), np.eye(6))


def test_a_contact_where_nobody_yields_is_refused_and_one_where_the_environment_does_is_not():
    """The SCARA pair cannot turn about its locked couple; a free body behind it can."""
    chain = scara_pair()
    rng = default_rng(47)
    state = chain.state(*random_state(chain, rng))
    locked = osc.Contact(state.C)
    rolled = Environment(state.C @ state.C.T * 0.1)
    got = contact_response(state, locked, rolled, tau=np.zeros(8))
    want = (state.C.T @ state.sigma) / (0.1 * (state.C.T @ state.C)[0, 0] ** 2)
    assert_allclose(got.alpha, want, rtol=1e-9)
    across = Environment(np.outer(state.S[:, 0], state.S[:, 0]))
    with raises(osc.ContactError, match="the arms and the environment cannot push"):
        contact_response(state, locked, across, tau=np.zeros(8))
    with raises(osc.ContactError, match="the arms cannot push"):
        command(state, locked, np.zeros(6), np.zeros(1))
