"""Environments that move and yield: eqs. 14–25 as written, d = 6, and the class itself.

What the law makes of them on random states is judged in `test_law_kkt`, whose ticks are used here.
"""

from dataclasses import replace
from itertools import islice

import numpy as np
import pinocchio as pin
from command_filter import command
from complaints import contact_error, invalid_input, model_error, refusals
from kkt_oracle import linkage, random_inertia
from numpy.linalg import inv, lstsq, solve
from numpy.random import default_rng
from rigs import largest, pose_of, product, random_state, refused, scara_pair, ticked
from samples import module_fixture, parametrize
from test_law_kkt import metric_of, miss, ticks

import osc_contact as osc
from osc_contact import projections
from osc_contact.dynamics.environment import Environment, Hinge
from osc_contact.response import Lambda_rel, contact_response

RTOL = 1e-9


class Relative:
    """What the equations speak of at a tick, with any Ṫβ that the contacts permit: NᵀṪβ = n_γ."""

    def __init__(self, t, rng):
        self.t = t
        self.s = s = t.controller.signals
        self.N = N = s.contact.N
        Tdot_beta = rng.standard_normal(6)
        miss = s.contact.n_gamma - N.T @ Tdot_beta
        self.Tdot_beta = Tdot_beta + lstsq(N.T, miss, rcond=None)[0]
        self.Lambda_0 = inv(s.state.Phi)
        self.Lambda_rel = Lambda_rel(s.state, s.environment)
        up = inv(s.state.S).T
        bias = s.state.b_S - s.state.Lambda_S @ solve(s.state.S, s.state.sigma)
        self.from_f = up @ bias + self.Lambda_0 @ (self.Tdot_beta + s.environment.b_e)

    def answer(self, tau):
        """f_c and ϑ̇′ that these torques bring, and the size of what ϑ̇′ is the difference of."""
        env = self.s.environment
        truth = self.t.state.answer(tau)
        f_c = self.N @ truth.alpha
        a_e = env.Phi_e @ f_c + env.b_e  # 14
        bodies = {id(c.on) for c in self.t.contacts}
        if len(bodies) == 1:
            assert miss(a_e, truth.a_e[0]) < RTOL
        sizes = [largest(x) for x in (truth.a_object, a_e, self.Tdot_beta)]
        return f_c, truth.a_object - a_e - self.Tdot_beta, max(sizes)

    def tick(self, **laws):
        controller = self.t.before.with_laws(**laws)
        tau = ticked(controller, self.t.measured, self.t.reference)
        return controller, tau


@module_fixture
def some():
    """With one to five columns, on several bodies or one."""
    rng = default_rng(31)
    made = [t for t in islice(ticks("ur5", "bodies"), 40) if 0 < len(t.state.N) < 6]
    return [(Relative(t, rng), rng) for t in made if t.state.apart() > 0.1]


def test_equations_17_to_20_as_written_with_the_relative_inertia(some):
    """β̇, α, ϑ̇′ and f_c with Λ_rel, T, Ṫβ and f′, against the whole system."""
    for r, _ in some:
        s = r.s
        N = r.N
        T = s.contact.T
        f_c, theta, size = r.answer(r.t.tau)  # 16
        got = contact_response(s.state, s.contact, s.environment, tau=r.t.tau)
        assert miss(got.a_e, s.environment.Phi_e @ f_c + s.environment.b_e) < RTOL
        f_prime = inv(s.state.S).T @ s.state.G @ r.t.tau - r.from_f
        drive = r.Lambda_rel @ inv(r.Lambda_0) @ f_prime
        beta_dot = solve(T.T @ r.Lambda_rel @ T, T.T @ drive)  # 17
        inverse = inv(r.Lambda_rel)
        alpha = solve(N.T @ inverse @ N, N.T @ inverse @ drive)  # 18
        assert miss(N @ alpha, f_c) < RTOL
        split = projections.Omega_f(N, inverse)
        assert miss(split @ drive, f_c) < RTOL  # 20
        assert largest(inverse @ (drive - split @ drive) - theta) < RTOL * size  # 19
        assert largest(T @ beta_dot - theta) < RTOL * size  # 15
    assert len(some) > 20 and {len({id(c.on) for c in r.t.contacts}) for r, _ in some} >= {1, 2}


def test_equations_21_24_and_25_with_relative_commands(some):
    """ϑ̇′ = Ω_m(B)ϑ̇′_u and f_c = Ω_f(A)f_cu for any Ṫ, A, B; f′ is that of eq. 21."""
    for r, rng in some:
        s = r.s
        N = r.N
        env = s.environment
        A = rng.standard_normal((6, 6))
        theta_u = 3 * rng.standard_normal(6)
        f_comm = projections.Omega_f(N, A @ A.T + 0.1 * np.eye(6)) @ (20 * rng.standard_normal(6))
        alpha_u = lstsq(N, f_comm, rcond=None)[0]
        a_u = theta_u + r.Tdot_beta + env.Phi_e @ f_comm + env.b_e + product(s.state.V_O)
        controller, tau = r.tick(force=lambda *_, x=alpha_u: x, motion=lambda *_, x=a_u: x)
        f_c, theta, size = r.answer(tau)
        theta_comm = theta_u - projections.Omega_m_bar(N, inv(metric_of(r.t))) @ theta_u
        assert largest(theta - theta_comm) < RTOL * max(size, largest(a_u))  # 24
        assert miss(f_c, f_comm) < RTOL  # 25
        f_S = s.state.Lambda_S @ controller.signals.eta_c + s.state.b_S + s.state.S.T @ f_comm
        want = r.Lambda_0 @ (theta_comm + env.Phi_e @ f_comm) + f_comm
        assert miss(inv(s.state.S).T @ f_S - r.from_f, want) < 1e-8  # 21, Λ_rel⁻¹ = Λ₀⁻¹ + Φ_e


def test_unfiltered_commands_couple_through_the_relative_inertia(some):
    """Eqs. 22 and 23 as written, after eq. 21 with any commands."""
    for r, rng in some:
        N = r.N
        inverse = inv(r.Lambda_rel)
        theta, force = rng.standard_normal((2, 6)) * [[2], [10]]
        f = r.Lambda_0 @ (theta + inverse @ force) + r.from_f  # 21
        tau = r.tick(structure=lambda s, f=f: (np.zeros(6), s.state.S.T @ f))[1]
        f_c, got, size = r.answer(tau)
        split = projections.Omega_f(N, inverse)
        bar = projections.Omega_m_bar(N, inverse)
        want = theta - bar @ theta + inverse @ (force - split @ force)  # 22
        assert largest(got - want) < RTOL * max(size, largest(inverse @ force))
        assert miss(f_c, split @ force + r.Lambda_rel @ bar @ theta) < RTOL  # 23
        assert largest(f_c - split @ force) > 1e-3


def test_no_relative_inertia_where_nobody_yields():
    state = scara_pair().state(*random_state(scara_pair(), default_rng(33)))
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
    """By the inverse of Nᵀ that it makes, so in any frame and any units (here mm)."""
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


BODY = pin.Inertia(2.0, np.array([0.1, 0, 0]), np.diag([0.02, 0.03, 0.04]))
AT = {"X_WE": pin.SE3.Identity(), "O": np.zeros(3)}


def rail(axes=(1,) * 6, rates=(0,), body=BODY, **how):
    return Environment.rail(body, **AT, axes=axes, rates=rates, **how)


def free_body(body=BODY, **how):
    return rail(np.eye(6), np.zeros(6), body, **how)


def of_contacts(Phi_N, columns=(0, 1), metric=(1,) * 6):
    zero = np.zeros(len(columns))
    return Environment.of_contacts(np.eye(6)[:, columns], Phi_N, zero, zero, np.diag(metric))


HINGE = {"axis": [0, 0, 1], "through": [0, 0, 0], "inertia": 1.0}
ONE = osc.Contact(np.eye(6)[:, :1])


test_bad_arguments_are_refused = refusals(
    invalid_input,
    [
        (lambda: Environment.moving(**AT, V_E=np.zeros(3), A_E=np.zeros(6)), "V_E: expected shape"),
        (lambda: free_body(gravity=[9.81]), "gravity"),
        (lambda: rail(np.zeros(3)), "axes: expected"),
        (lambda: rail(rates=[0.0, 1.0]), "rates"),
        (lambda: rail(force=[1, 2]), "force"),
        (lambda: Environment.combine([ONE], [], np.eye(6)), "1 contacts"),
        (lambda: of_contacts(np.eye(3)), r"Phi_N: expected shape \(2, 2\)"),
        (lambda: of_contacts([[1.0, 0.1], [0.0, 1.0]]), "Phi_N is not symmetric"),
        (lambda: of_contacts([[1.0, 2.0], [2.0, 1.0]]), "Phi_N is not positive semidefinite"),
        (lambda: Hinge(**HINGE | {"axis": [0, 0, 0]}), "hinge.axis is zero"),
        (lambda: Hinge(**HINGE | {"inertia": 0.0}), "hinge.inertia = 0"),
        (lambda: Hinge(**HINGE, damping=-1.0), "hinge.damping"),
        (lambda: Hinge(**HINGE | {"through": [0, np.nan, 0]}), "hinge.through"),
    ],
)


test_impossible_bodies_are_refused = refusals(
    model_error,
    [
        (lambda: rail(np.ones((6, 2)), [0, 0]), "its axes"),
        (lambda: rail([0, 0, 0, 0, 0, 1], body=pin.Inertia.FromSphere(1.0, 0.0)), "along its axes"),
        (lambda: free_body(pin.Inertia(0.0, np.zeros(3), np.eye(3))), "along its axes"),
        (lambda: of_contacts([[1.0]], [0], (1, 1, 1, 1, 1, -1.0)), "metric"),
    ],
)


def test_impossible_mechanisms_and_dependent_contacts_are_refused():
    body = linkage(default_rng(46), np.zeros(3))
    args = body.q, body.v, body.tau
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
    state = scara_pair().state(*random_state(scara_pair(), default_rng(47)))
    locked = osc.Contact(state.C)
    rolled = Environment(state.C @ state.C.T * 0.1)
    got = contact_response(state, locked, rolled, tau=np.zeros(8))
    want = (state.C.T @ state.sigma) / (0.1 * (state.C.T @ state.C)[0, 0] ** 2)
    assert miss(got.alpha, want) < RTOL
    across = Environment(np.outer(state.S[:, 0], state.S[:, 0]))
    with contact_error("the arms and the environment cannot push"):
        contact_response(state, locked, across, tau=np.zeros(8))
    both = osc.Contact(np.column_stack((np.eye(6)[:, 2], state.C[:, 0])))
    with contact_error("the arms cannot push on contact column 1"):
        contact_response(state, both, tau=np.zeros(8))
    with contact_error("the arms cannot push"):
        command(state, locked, np.zeros(6), np.zeros(1))


def test_contact_response_needs_exactly_one_command():
    state = scara_pair().state(*random_state(scara_pair(), default_rng(15)))
    nothing = osc.Contact(np.zeros((6, 0)))
    for commands in ({}, {"tau": np.zeros(8), "f_S": np.zeros(5)}):
        with refused("exactly one"):
            contact_response(state, nothing, **commands)
