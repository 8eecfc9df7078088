"""Environments that move and yield, eqs. 14–25: judged by the whole system solved at once."""

from dataclasses import replace

import numpy as np
from environment_scenes import RTOL, cases, close_to, contacts_at, pairs_at, scene, twist_at
from numpy.linalg import inv, lstsq, solve
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import raises
from rigs import largest, one_panda, panda_pair, random_state, scara_pair, unit
from test_decoupling import commanded as law_commanded
from test_decoupling import structured

import osc_contact as osc
from osc_contact import projections
from osc_contact.dynamics.environment import Environment
from osc_contact.response import Lambda_rel, contact_response

# Equations 14 to 20 -------------------------------------------------------------------------------


def velocity_product(s, rng):
    """T and Ṫβ of a smooth basis T(t): NᵀT = 0 at all times, and otherwise any spin."""
    T = s.contact.T
    N = s.contact.N
    N_dot = s.N_dot
    T_dot = -N @ solve(N.T @ N, N_dot.T @ T) + T @ rng.standard_normal((T.shape[1],) * 2)
    beta = lstsq(T, s.state.V_O - s.environment.V_e, rcond=None)[0]
    Tdot_beta = T_dot @ beta
    if len(s.bodies) > 1:  # there is no one V_rel = Tβ: only NᵀṪβ = n_γ remains of Ṫ
        miss = s.contact.n_gamma - N.T @ Tdot_beta
        Tdot_beta = Tdot_beta + N @ solve(N.T @ N, miss)
    return T, Tdot_beta


def test_several_bodies_have_one_relative_acceleration_but_no_common_velocity_product():
    """n_γ is −ṅᵀ(V − V_i) with each contact's own body; −ṄᵀV_rel with the combined V_e is not."""
    s = scene(panda_pair, "rail and free body", default_rng(38))
    V_rel = s.state.V_O - s.environment.V_e
    assert_allclose(s.contact.N.T @ V_rel, 0, atol=1e-10)
    assert largest(-s.N_dot.T @ V_rel - s.contact.n_gamma) > 1e-2
    own = [
        -s.N_dot[:, i] @ (s.state.V_O - twist_at(s.bodies[t.body], s.state))
        for i, t in enumerate(s.touches)
    ]
    assert_allclose(own, s.contact.n_gamma, rtol=1e-9)


def six_dimensional(state, f_S):
    """f, μ₀ + p₀ and Λ₀ of eq. 13 for d = 6."""
    up = inv(state.S).T
    return up @ f_S, up @ (state.b_S - state.Lambda_S @ solve(state.S, state.sigma))


@cases(panda_pair, one_panda)
def test_equations_17_to_20_as_written_with_the_relative_inertia(rig, kind):
    """β̇, α, ϑ̇′ and f_c with Λ_rel, T, Ṫβ and f′, against the whole system (d = 6)."""
    rng = default_rng(31)
    for _ in range(4):
        s = scene(rig, kind, rng)
        state = s.state
        env = s.environment
        N = s.contact.N
        tau = rng.standard_normal(s.chain.n_a) * 20
        truth = s.solve(tau)
        a_e = environment_acceleration(s, truth)  # 14
        T, Tdot_beta = velocity_product(s, rng)
        assert_allclose(N.T @ Tdot_beta, s.contact.n_gamma, atol=1e-9)
        Lambda_0 = inv(state.Phi)
        Phi_0 = state.Phi
        relative = Lambda_rel(state, env)
        f, bias = six_dimensional(state, state.G @ tau)
        f_prime = f - bias - Lambda_0 @ (Tdot_beta + env.b_e)
        assert close_to(contact_response(state, s.contact, env, tau=tau).a_e, a_e) < RTOL
        beta_dot = solve(T.T @ relative @ T, T.T @ relative @ Phi_0 @ f_prime)  # 17
        D = N.T @ inv(relative) @ N
        alpha = solve(D, N.T @ Phi_0 @ f_prime)  # 18
        drive = relative @ Phi_0 @ f_prime
        split = projections.Omega_f(N, inv(relative))
        theta = solve(relative, drive - split @ drive)  # 19
        f_c = split @ drive  # 20
        want = truth.a_object - a_e - Tdot_beta
        assert close_to(alpha, truth.alpha) < RTOL
        assert close_to(N @ truth.alpha, f_c) < RTOL  # 16
        scale = max(largest(truth.a_object), largest(a_e), largest(Tdot_beta))
        assert largest(T @ beta_dot - want) < RTOL * scale  # 15
        assert largest(theta - want) < RTOL * scale


def test_no_relative_inertia_where_nobody_yields():
    state = scara_pair().state(*random_state(scara_pair(), default_rng(33)))
    with raises(osc.ModelError, match="neither chain nor environment yields"):
        Lambda_rel(state, Environment.fixed())


def test_a_redundant_leg_changes_nothing_where_one_body_carries_all():
    """Two vertices and, between them, a third: n_γ of a moving body stays consistent."""
    rng = default_rng(48)
    for kind in ("free body", "prescribed"):
        for _ in range(4):
            s = scene(panda_pair, kind, rng)
            a, b = s.touches
            body = s.bodies[0]
            normal = unit(a.normal)
            legs = [
                replace(a, vertex=p, normal=normal)
                for p in (a.vertex, b.vertex, 0.3 * a.vertex + 0.7 * b.vertex)
            ]
            parts = contacts_at(s.state, [body], legs)
            three = osc.Contact.stack(parts)
            two = osc.Contact.stack(parts[:2])
            assert three.r == two.r == 2 and three.R.shape == (2, 3)
            assert Environment.combine(parts, [s.each[0]] * 3, s.state.metric) is s.each[0]
            tau = rng.standard_normal(s.chain.n_a) * 20
            one, other = (contact_response(s.state, c, s.each[0], tau=tau) for c in (three, two))
            assert close_to(one.f_c, other.f_c) < RTOL
            assert close_to(three.N @ three.R @ three.magnitudes(one.alpha), one.f_c) < 1e-12
            copies = [replace(s.each[0]) for _ in parts]
            if kind == "prescribed":  # one motion, nobody yields: one environment
                assert Environment.combine(parts, copies, s.state.metric) is copies[0]
            else:
                with raises(osc.ContactError, match="dependent"):
                    Environment.combine(parts, copies, s.state.metric)


# Equations 21 to 25 -------------------------------------------------------------------------------


def metrics_B(state, rng):
    A = rng.standard_normal((6, 6))
    total = state.metric + sum(arm.Lambda for arm in state.arms)
    return inv(state.metric), inv(total), A @ A.T + 0.1 * np.eye(6)


class Answering:
    """A body that answers as the scene says."""

    def __init__(self, answer):
        self.answer = answer

    def environment(self, X_WE, V_E, A_E, O):
        return self.answer


def seen(s):
    """The scene for a controller: pairs, one body for each contact, and how these move."""
    bodies = [s.bodies[touch.body] for touch in s.touches]
    pairs = pairs_at(s.state, s.bodies, s.touches)
    X = [body.X.homogeneous for body in bodies]
    V = [body.V for body in bodies]
    answering = {id(answer): Answering(answer) for answer in s.each}
    touched = osc.interface.Touched(np.array(X), np.array(V), np.zeros((len(X), 6)))
    return pairs, {"bodies": [answering[id(a)] for a in s.each], "touched": touched}


def squeeze_of(s):
    return 5.0 if len(s.chain.arms) == 2 else 0.0


def object_acceleration(state, contact, environment, relative, alpha_u, Tdot_beta=None):
    """ϑ̇ = ϑ̇′ + Ṫβ + Φ_eNα_u + b_e (6,): the object's behind the paper's relative ϑ̇′."""
    N = contact.N
    if Tdot_beta is None:  # the least with NᵀṪβ = n_γ in the object's energy metric
        mobile = solve(state.metric, N)
        Tdot_beta = mobile @ solve(N.T @ mobile, contact.n_gamma)
    return relative + Tdot_beta + environment.Phi_e @ (N @ alpha_u) + environment.b_e


def commanded(s, relative, alpha, B, Tdot_beta=None):
    """Whole-system answer to a relative motion command and a force command; η̇_c."""
    a_u = object_acceleration(s.state, s.contact, s.environment, relative, alpha, Tdot_beta)
    pairs, how = seen(s)
    controller, tau = law_commanded(s.chain, pairs, s.q, s.v, a_u, alpha, B, squeeze_of(s), **how)
    return s.solve(tau), controller.signals.eta_c


def environment_acceleration(s, truth):
    """a_e (6,) of the touched body, or of the one that stands for several."""
    if len(s.bodies) == 1:
        return truth.a_e[0]
    return s.environment.Phi_e @ s.contact.N @ truth.alpha + s.environment.b_e


@cases(panda_pair, one_panda)
def test_equations_21_24_and_25_with_relative_commands(rig, kind):
    """ϑ̇′ = Ω_m(B)ϑ̇′_u and f_c = Ω_f(A)f_cu for any T, Ṫ, A, B; f′ is that of eq. 21 (d = 6)."""
    rng = default_rng(35)
    for _ in range(4):
        s = scene(rig, kind, rng)
        state = s.state
        env = s.environment
        N = s.contact.N
        Tdot_beta = velocity_product(s, rng)[1]
        A = rng.standard_normal((6, 6))
        A_inv = A @ A.T + 0.1 * np.eye(6)
        theta_u = rng.standard_normal(6) * 3
        f_cu = rng.standard_normal(6) * 20
        f_comm = projections.Omega_f(N, A_inv) @ f_cu
        alpha_u = lstsq(N, f_comm, rcond=None)[0]
        for B in metrics_B(state, rng):
            truth, eta_c = commanded(s, theta_u, alpha_u, B, Tdot_beta)
            theta_comm = theta_u - projections.Omega_m_bar(N, B) @ theta_u
            a_e = environment_acceleration(s, truth)
            relative = truth.a_object - a_e - Tdot_beta
            size = max(largest(x) for x in (truth.a_object, a_e, Tdot_beta))
            assert largest(relative - theta_comm) < RTOL * size  # 24
            assert close_to(N @ truth.alpha, f_comm) < RTOL  # 25
            f, bias = six_dimensional(
                state, state.Lambda_S @ eta_c + state.b_S + state.S.T @ f_comm
            )
            Lambda_0 = inv(state.Phi)
            f_prime = f - bias - Lambda_0 @ (Tdot_beta + env.b_e)
            want = Lambda_0 @ theta_comm + f_comm + Lambda_0 @ env.Phi_e @ f_comm
            assert close_to(f_prime, want) < 1e-8  # 21, with Λ_rel⁻¹ = Λ₀⁻¹ + Φ_e


@cases(panda_pair)
def test_unfiltered_commands_couple_through_the_relative_inertia(rig, kind):
    """Eqs. 22 and 23 as written, after eq. 21 with any commands (d = 6)."""
    rng = default_rng(36)
    for _ in range(4):
        s = scene(rig, kind, rng)
        state = s.state
        env = s.environment
        N = s.contact.N
        Tdot_beta = velocity_product(s, rng)[1]
        theta = rng.standard_normal(6) * 2
        force = rng.standard_normal(6) * 10
        relative = Lambda_rel(state, env)
        Lambda_0 = inv(state.Phi)
        inverse = inv(relative)
        f_prime = Lambda_0 @ theta + Lambda_0 @ inverse @ force  # 21
        _, bias = six_dimensional(state, np.zeros(6))
        f = f_prime + bias + Lambda_0 @ (Tdot_beta + env.b_e)
        tau = structured(s.chain, s.q, s.v, state.S.T @ f, np.zeros(6), squeeze_of(s))
        truth = s.solve(tau)
        Omega_f = projections.Omega_f(N, inverse)
        Omega_m_bar = projections.Omega_m_bar(N, inverse)
        got = truth.a_object - environment_acceleration(s, truth) - Tdot_beta
        want = theta - Omega_m_bar @ theta + inverse @ (force - Omega_f @ force)  # 22
        f_c = Omega_f @ force + relative @ Omega_m_bar @ theta  # 23
        size = max(largest(x) for x in (truth.a_object, Tdot_beta, inverse @ force, theta))
        assert largest(got - want) < RTOL * size
        assert close_to(N @ truth.alpha, f_c) < RTOL
        assert largest(f_c - Omega_f @ force) > 1e-3
