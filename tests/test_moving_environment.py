"""Environments that move and yield: eqs. 14–23 as written, d = 6, and the class itself.

What the law makes of them on random states is judged in `test_law_kkt`, whose ticks are used here.
"""

from dataclasses import FrozenInstanceError, replace
from itertools import islice

import numpy as np
import pinocchio as pin
from complaints import contact_error, invalid_input, model_error, refusals
from kkt_oracle import linkage, random_inertia
from numpy.linalg import inv, lstsq, solve
from numpy.random import default_rng
from pytest import raises
from rigs import largest, miss, placed, pose_of, random_state, refused, scara_pair, ticked, vector
from samples import parametrize
from test_law_kkt import ticks

import osc_contact as osc
from osc_contact import projections
from osc_contact.dynamics.environment import Environment, Guided, Rail
from osc_contact.response import Lambda_rel, contact_response

RTOL = 1e-9


def test_equations_17_to_23_as_written_with_the_relative_inertia():
    """β̇, α, ϑ̇′ and f_c with Λ_rel, T, Ṫβ and f′, against the whole system.

    With one to five columns, on several bodies or one, and any Ṫβ that the contacts permit.
    """
    rng = default_rng(31)
    bodies = []
    for t in islice(ticks("ur5", "bodies"), 24):
        if not 0 < len(t.state.N) < 6 or t.state.apart() <= 0.1:
            continue
        s = t.controller.signals
        env = s.environment
        N = s.contact.N
        T = s.contact.T
        Tdot_beta = rng.standard_normal(6)
        Tdot_beta += lstsq(N.T, s.contact.n_gamma - N.T @ Tdot_beta, rcond=None)[0]
        Lambda_0 = inv(s.state.Phi)
        relative = Lambda_rel(s.state, env)
        inverse = inv(relative)
        up = inv(s.state.S).T
        bias = s.state.b_S - s.state.Lambda_S @ solve(s.state.S, s.state.sigma)
        from_f = up @ bias + Lambda_0 @ (Tdot_beta + env.b_e)
        split = projections.Omega_f(N, inverse)
        bodies.append(len({id(c.on) for c in t.contacts}))
        truth = t.state.answer(t.tau)
        f_c = N @ truth.alpha  # 16
        a_e = env.Phi_e @ f_c + env.b_e  # 14
        assert bodies[-1] > 1 or miss(a_e, truth.a_e[0]) < RTOL
        assert miss(contact_response(s.state, s.contact, env, tau=t.tau).a_e, a_e) < RTOL
        theta = truth.a_object - a_e - Tdot_beta
        rtol = RTOL * max(largest(x) for x in (truth.a_object, a_e, Tdot_beta))
        drive = relative @ inv(Lambda_0) @ (up @ s.state.G @ t.tau - from_f)
        beta_dot = solve(T.T @ relative @ T, T.T @ drive)  # 17
        alpha = solve(N.T @ inverse @ N, N.T @ inverse @ drive)  # 18
        assert miss(N @ alpha, f_c) < RTOL
        assert miss(split @ drive, f_c) < RTOL  # 20
        assert largest(inverse @ (drive - split @ drive) - theta) < rtol  # 19
        assert largest(T @ beta_dot - theta) < rtol  # 15
        # any commands, unfiltered
        desired, force = rng.standard_normal((2, 6)) * [[2], [10]]
        f = Lambda_0 @ (desired + inverse @ force) + from_f  # 21
        own = {"structure": lambda s, f=f: (np.zeros(6), s.state.S.T @ f)}
        controller = t.controller_of(t.state.case.chain).with_laws(**own)
        truth = t.state.answer(ticked(controller, t.measured, t.reference))
        f_c = N @ truth.alpha
        theta = truth.a_object - env.Phi_e @ f_c - env.b_e - Tdot_beta
        bar = projections.Omega_m_bar(N, inverse)
        expected = desired - bar @ desired + inverse @ (force - split @ force)  # 22
        assert largest(theta - expected) < RTOL * max(
            largest(truth.a_object), largest(inverse @ force)
        )
        assert miss(f_c, split @ force + relative @ bar @ desired) < RTOL  # 23
        assert largest(f_c - split @ force) > 1e-3
    assert len(bodies) > 10 and set(bodies) >= {1, 2}


def scaras(seed):
    """The pair in a random state."""
    return scara_pair().state(*random_state(scara_pair(), default_rng(seed)))


def test_no_relative_inertia_where_nobody_yields():
    state = scaras(33)
    with model_error("neither chain nor environment yields") as refusal:
        Lambda_rel(state, Environment.fixed())
    wrench = np.fromstring(str(refusal.value).split("[")[1].split("]")[0], sep=" ")
    assert largest(state.Phi @ wrench) < 1e-3 * largest(wrench)


# The class ----------------------------------------------------------------------------------------


def test_one_body_behind_every_contact_stays_what_it_is():
    """Shared bodies couple their contacts; those on separate bodies have other forces."""
    for t in ticks("ur5", "bodies"):
        body = t.state.bodies[0]
        if len(t.state.bodies) == 1 < len(t.contacts) and body.prescribed is None is not body.given:
            break
    s = t.controller.signals
    parts = [c.pair.contact(t.state.case.X_WO, t.state.V, body.X, body.V) for c in t.contacts]
    env = body.given.environment(body.X, body.V, np.zeros(6), t.state.case.X_WO.translation)
    metric = s.state.metric
    assert Environment.combine(parts, [env] * len(parts), metric) is env
    apart = Environment.combine(parts, [replace(env) for _ in parts], metric)
    one, other = (contact_response(s.state, s.contact, e, tau=t.tau).alpha for e in (env, apart))
    assert miss(other, one) > 1e-3
    assert miss(s.contact.N.T @ apart.V_e, s.contact.N.T @ env.V_e) < RTOL
    twice = [parts[0], parts[0]]
    with contact_error("dependent"):
        Environment.combine(twice, [env, replace(env)], metric)
    driven = Environment.moving(X_WE=body.X, V_E=body.V, A_E=body.V, O=np.zeros(3))
    copies = [replace(driven), driven]  # one motion, nobody yields: one environment
    assert Environment.combine(twice, copies, metric) is copies[0]


@parametrize("seed", range(8))
def test_the_environment_of_several_contacts_follows_from_the_inertia_of_the_object(seed):
    """The inverse of Nᵀ is valid in any frame and units (here mm)."""
    rng = default_rng([seed, 45])
    N = rng.standard_normal((6, 3))
    half, b_N, V_N = rng.standard_normal((3, 3))
    Phi_N = np.outer(half, half) + np.outer(V_N, V_N)
    inertia = random_inertia(rng).matrix()
    if seed % 2:
        F = np.diag([1.0, 1, 1, 1e3, 1e3, 1e3]) @ pose_of(rng).dualAction
        N = F @ N
        inertia = F @ inertia @ F.T
    env = Environment.of_contacts(N, Phi_N, b_N, V_N, inertia)
    K = solve(inertia, N) @ inv(N.T @ solve(inertia, N))
    assert miss(env.Phi_e, K @ Phi_N @ K.T) < 1e-9
    assert miss(env.b_e, K @ b_N) < 1e-9 and miss(env.V_e, K @ V_N) < 1e-9


BODY = pin.Inertia(2.0, vector(0.1, 0, 0), np.diag([0.02, 0.03, 0.04]))
AT = {"X_WE": placed(), "O": np.zeros(3)}


def rail(axes=(1,) * 6, rates=(0,), body=BODY, **how):
    return Environment.rail(body, **AT, axes=axes, rates=rates, **how)


def free_body(body=BODY, **how):
    return rail(np.eye(6), np.zeros(6), body, **how)


def of_contacts(Phi_N, columns=(0, 1), metric=(1,) * 6):
    zero = np.zeros(len(columns))
    return Environment.of_contacts(np.eye(6)[:, columns], Phi_N, zero, zero, np.diag(metric))


HINGE = {"axis": [0, 0, 1], "through": [0, 0, 0], "inertia": 1.0}


test_bad_arguments_are_refused = refusals(
    invalid_input,
    {
        "V_E: expected shape": lambda: Environment.moving(**AT, V_E=np.zeros(3), A_E=np.zeros(6)),
        "gravity": lambda: free_body(gravity=[9.81]),
        "axes: expected": lambda: rail(np.zeros(3)),
        "rates": lambda: rail(rates=[0.0, 1.0]),
        "force": lambda: rail(force=[1, 2]),
        "1 contacts": lambda: Environment.combine([osc.Contact(np.eye(6)[:, :1])], [], np.eye(6)),
        r"Phi_N: expected shape \(2, 2\)": lambda: of_contacts(np.eye(3)),
        "Phi_N is not symmetric": lambda: of_contacts([[1.0, 0.1], [0.0, 1.0]]),
        "Phi_N is not positive semidefinite": lambda: of_contacts([[1.0, 2.0], [2.0, 1.0]]),
        "a guided body has a slide or a hinge": lambda: Guided(Rail(**HINGE | {"axis": [0, 0, 0]})),
        "has a slide or a hinge, and no motion": lambda: Guided(Rail([1, 0, 0], **HINGE)),
        "no motion": lambda: Guided(Rail([1, 0, 0], motion=lambda t: np.zeros((3, 2)))),
        "rail.inertia = 0": lambda: Rail(**HINGE | {"inertia": 0.0}),
        "rail.damping": lambda: Rail(**HINGE, damping=-1.0),
        "rail.through": lambda: Rail(**HINGE | {"through": [0, np.nan, 0]}),
    },
)


test_impossible_bodies_are_refused = refusals(
    model_error,
    {
        r"along its axes .*\[6.13 6.13\]": lambda: rail(np.ones((6, 2)), [0, 0]),
        r"along its axes .*\[0.\]": lambda: rail(
            [0, 0, 0, 0, 0, 1], body=pin.Inertia.FromSphere(1.0, 0.0)
        ),
        r"along its axes .*\[0. 0. 0. 1. 1. 1.\]": lambda: free_body(
            pin.Inertia(0.0, np.zeros(3), np.eye(3))
        ),
        "metric": lambda: of_contacts([[1.0]], [0], (1, 1, 1, 1, 1, -1.0)),
    },
)


def test_impossible_mechanisms_and_dependent_contacts_are_refused():
    body = linkage(default_rng(46), np.zeros(3))
    args = (body.q, body.v, body.tau)
    with model_error("touchd"):
        Environment.articulated(body.model, *args, "touchd", np.zeros(3))
    with refused("tau: expected shape"):
        Environment.articulated(body.model, *args[:2], np.zeros(3), "touched", np.zeros(3))
    body.model.inertias[1] = body.model.inertias[2] = pin.Inertia.Zero()
    with model_error("joint-space inertia"):
        Environment.articulated(body.model, *args, "touched", np.zeros(3))
    with contact_error("dependent"):
        of_contacts(np.eye(2), [0, 0])


def test_a_contact_where_nobody_yields_is_refused_and_one_where_the_environment_does_is_not():
    """The SCARA pair cannot turn about its locked couple; a free body behind it can."""
    state = scaras(47)
    locked = osc.Contact(state.C)
    got = contact_response(state, locked, Environment(state.C @ state.C.T * 0.1), tau=np.zeros(8))
    with raises(FrozenInstanceError):
        got.alpha = got.alpha
    expected = (state.C.T @ state.sigma) / (0.1 * (state.C.T @ state.C)[0, 0] ** 2)
    assert miss(got.alpha, expected) < RTOL
    across = Environment(np.outer(state.S[:, 0], state.S[:, 0]))
    with contact_error("the arms and the environment cannot push"):
        contact_response(state, locked, across, tau=np.zeros(8))
    both = osc.Contact(np.column_stack((np.eye(6)[:, 2], state.C[:, 0])))
    with contact_error("the arms cannot push on contact column 1"):
        contact_response(state, both, tau=np.zeros(8))


def test_contact_response_needs_exactly_one_command():
    state = scaras(15)
    nothing = osc.Contact(np.zeros((6, 0)))
    for commands in ({}, {"tau": np.zeros(8), "f_S": np.zeros(5)}):
        with refused("exactly one"):
            contact_response(state, nothing, **commands)
