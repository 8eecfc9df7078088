"""Environments that move and yield, eqs. 14–25: judged by the whole system solved at once."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import pytest
from environment_oracle import Body, Touch, kkt, wrist_readings
from rigs import one_panda, panda_pair, random_state, scara_pair

import osc_contact as osc
from osc_contact import projections, robots
from osc_contact.contacts.pairs import VertexOnFace
from osc_contact.control.allocation import Allocation
from osc_contact.control.command_filter import (
    filtered_motion,
    generalised_force,
    object_acceleration,
    object_coordinates,
)
from osc_contact.control.force import contact_force, magnitudes, sum_of_wrenches
from osc_contact.dynamics.assembly import constraint_rows, inverse_rows
from osc_contact.dynamics.environment import Environment
from osc_contact.response import Lambda_rel, contact_response, require_reachable

G = np.array([0.0, 0.0, -9.81])
RIGS = (scara_pair, panda_pair, one_panda)
RTOL = 1e-9


def close_to(got, want):
    """Largest difference relative to the size of the vector."""
    return np.abs(got - want).max(initial=0.0) / max(np.abs(want).max(initial=0.0), 1e-3)


# Bodies of the environment, each as a Pinocchio model and as an Environment -----------------------


def random_inertia(rng):
    a, b, c = rng.uniform(0.01, 0.04, 3)  # any positive a, b, c make b + c, a + c, a + b possible
    turn = pin.rpy.rpyToMatrix(*rng.uniform(-3, 3, 3))
    spread = turn @ np.diag([b + c, a + c, a + b]) @ turn.T
    return pin.Inertia(rng.uniform(0.5, 4.0), rng.uniform(-0.1, 0.1, 3), spread)


def random_placement(rng, at):
    return pin.SE3(pin.rpy.rpyToMatrix(*rng.uniform(-3, 3, 3)), at + rng.uniform(-0.3, 0.3, 3))


def one_joint(joint, rng, X, prescribed=False):
    model = pin.Model()
    model.addJointFrame(model.addJoint(0, joint, X, "body"))
    model.appendBodyToJoint(1, random_inertia(rng), pin.SE3.Identity())
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-0.5, 0.5, model.nv))
    v, tau = rng.uniform(-1, 1, model.nv), rng.normal(size=model.nv) * 5
    acceleration = rng.normal(size=model.nv) * 3 if prescribed else None
    return Body(model, q, v, tau, "body", acceleration)


def axis(rng):
    x = rng.normal(size=3)
    return x / np.linalg.norm(x)


def rigid(rng, at):
    body = one_joint(pin.JointModelFreeFlyer(), rng, random_placement(rng, at))
    R = body.X.rotation
    wrench = np.concatenate((R @ body.tau[:3], R @ body.tau[3:]))
    return body, lambda O: Environment.rigid_body(  # noqa: E741
        body.model.inertias[1], X_WE=body.X, V_E=body.V, O=O, gravity=G, wrench=wrench
    )


def guided(joint):
    """A body on one joint: rail, door, ball, plate on a plane."""

    def make(rng, at):
        body = one_joint(joint(rng), rng, random_placement(rng, at))
        axes = np.column_stack([replace(body, v=e).V for e in np.eye(body.model.nv)])
        if body.model.nv == 1:
            axes = axes[:, 0]
        return body, lambda O: Environment.rail(  # noqa: E741
            body.model.inertias[1],
            X_WE=body.X,
            axes=axes,
            rates=body.v,
            O=O,
            gravity=G,
            force=body.tau,
        )

    return make


def linkage(rng, at):
    """Two hinges about skew axes; the second link is touched."""
    model = pin.Model()
    for k in range(2):
        X = random_placement(rng, at if k == 0 else np.zeros(3))
        model.addJoint(k, pin.JointModelRevoluteUnaligned(axis(rng)), X, f"hinge{k}")
        model.appendBodyToJoint(k + 1, random_inertia(rng), pin.SE3.Identity())
    for k, name in ((1, "upper"), (2, "touched")):
        X = random_placement(rng, np.zeros(3))
        model.addFrame(pin.Frame(name, k, 0, X, pin.FrameType.OP_FRAME))
    body = Body(model, rng.normal(size=2), rng.normal(size=2), rng.normal(size=2) * 2, "touched")
    return body, lambda O: Environment.articulated(  # noqa: E741
        body.model, body.q, body.v, body.tau, "touched", O
    )


def moving(rng, at):
    body = one_joint(pin.JointModelFreeFlyer(), rng, random_placement(rng, at), prescribed=True)
    R, v, a = body.X.rotation, body.v, body.prescribed
    classical = np.concatenate((R @ (a[:3] + np.cross(v[3:], v[:3])), R @ a[3:]))
    return body, lambda O: Environment.moving(  # noqa: E741
        X_WE=body.X, V_E=body.V, A_E=classical, O=O
    )


rail = guided(lambda rng: pin.JointModelPrismaticUnaligned(axis(rng)))
KINDS = {  # bodies, and the body of each contact
    "free body": ([rigid], [0, 0]),
    "rail": ([rail], [0, 0]),
    "hinge": ([guided(lambda rng: pin.JointModelRevoluteUnaligned(axis(rng)))], [0, 0]),
    "ball": ([guided(lambda rng: pin.JointModelSpherical())], [0, 0]),
    "plane": ([guided(lambda rng: pin.JointModelPlanar())], [0, 0]),
    "linkage": ([linkage], [0, 0]),
    "prescribed": ([moving], [0, 0]),
    "rail and free body": ([rail, rigid], [0, 1]),
    "prescribed and linkage": ([moving, linkage], [0, 1]),
    "three on two bodies": ([rigid, linkage], [0, 1, 0]),
}


@dataclass
class Scene:
    chain: osc.ClosedChain
    state: osc.ChainState
    contact: osc.Contact
    parts: list[osc.Contact]
    environment: Environment
    bodies: list[Body]
    touches: list[Touch]
    q: np.ndarray
    v: np.ndarray
    N_dot: np.ndarray

    def solve(self, tau):
        return kkt(self.chain, self.q, self.v, tau, self.bodies, self.touches)

    def normal_acceleration(self, truth):
        """nᵀa_e of each touched body along its own contact."""
        return np.concatenate(
            [p.N.T @ truth.a_e[t.body] for p, t in zip(self.parts, self.touches, strict=True)]
        )


def contacts_at(state, bodies, touches):
    """The contact of each touch at this instant, from vertex and face through the public pair."""
    parts = []
    for touch in touches:
        body = bodies[touch.body]
        point = body.X.actInv(state.X_WO.act(touch.vertex))
        pair = VertexOnFace(touch.vertex, point, touch.normal)
        parts.append(pair.contact(state.X_WO, state.V_O, body.X, body.V))
    return parts


def following(chain, q, v, N, normal_speed):
    """The nearest velocity with closed loops and NᵀV_O = normal_speed."""
    pin.computeAllTerms(chain.model, chain.data, q, v)
    A = constraint_rows(chain, chain.object_poses()[0].translation, N)
    b = np.concatenate((np.zeros(A.shape[0] - N.shape[1]), -normal_speed))
    for _ in range(3):
        v = v - inverse_rows(A, np.array(chain.data.M), len(chain.arms) - 1)[0] @ (A @ v - b)
    return v


def scene(rig, kind, rng):
    """A random state of a chain pressing on random bodies, all moving, contacts kept."""
    chain = rig()
    makers, owners = KINDS[kind]
    while True:
        q, v = random_state(chain, rng)
        state = chain.state(q, v)
        O = state.X_WO.translation  # noqa: E741
        made = [make(rng, O) for make in makers]
        bodies, each = [m[0] for m in made], [m[1](O) for m in made]
        touches = [Touch(rng.uniform(-0.3, 0.3, 3), rng.normal(size=3), i) for i in owners]
        N = np.hstack([p.N for p in contacts_at(state, bodies, touches)])
        try:
            require_reachable(state, osc.Contact(N))
        except osc.ContactError:
            continue
        speed = np.concatenate([N[:, [j]].T @ each[i].V_e for j, i in enumerate(owners)])
        v = following(chain, q, v, N, speed)
        state = chain.state(q, v)
        parts = contacts_at(state, bodies, touches)
        environment = Environment.combine(parts, [each[i] for i in owners], state.metric)
        contact = osc.Contact.stack(parts)
        rates = [_rate(state, p.N[:3, 0], each[i].V_e, t.vertex)
                 for p, t, i in zip(parts, touches, owners, strict=True)]  # fmt: skip
        return Scene(chain, state, contact, parts, environment, bodies, touches, q, v,
                     np.column_stack(rates))  # fmt: skip


def _rate(state, n, V_e, vertex):
    """Ṅ of one contact, reference point frozen."""
    s = state.X_WO.rotation @ vertex
    n_dot = np.cross(V_e[3:], n)
    s_dot = state.V_O[:3] + np.cross(state.V_O[3:], s)
    return np.concatenate((n_dot, np.cross(s_dot, n) + np.cross(s, n_dot)))


def cases(*rigs):
    return pytest.mark.parametrize(
        "rig, kind", [(rig, kind) for rig in rigs for kind in KINDS], ids=lambda x: str(
            getattr(x, "__name__", x)
        )
    )  # fmt: skip


# Equations 14 to 20 -------------------------------------------------------------------------------


@cases(*RIGS)
def test_contact_force_and_accelerations_agree_with_the_whole_system(rig, kind):
    """50 random states for each rig and kind, 500 for each rig: 1e-9 relative."""
    rng = np.random.default_rng(30)
    worst = {"alpha": 0.0, "object": 0.0, "environment": 0.0}
    for _ in range(50):
        s = scene(rig, kind, rng)
        tau = rng.normal(size=s.chain.n_a) * 20
        truth = s.solve(tau)
        got = contact_response(s.state, s.contact, s.environment, tau=tau)
        worst["alpha"] = max(worst["alpha"], close_to(got.alpha, truth.alpha))
        worst["object"] = max(worst["object"], close_to(got.acceleration, truth.a_object))
        if len(s.bodies) == 1:
            apart = close_to(got.a_e, truth.a_e[0])
        else:
            apart = close_to(s.contact.N.T @ got.a_e, s.normal_acceleration(truth))
        worst["environment"] = max(worst["environment"], apart)
        speeds = [s.parts[i].N.T @ _twist_at(s.bodies[t.body], s.state)
                  for i, t in enumerate(s.touches)]  # fmt: skip
        np.testing.assert_allclose(
            s.contact.N.T @ s.environment.V_e, np.concatenate(speeds), atol=1e-11
        )
        np.testing.assert_allclose(s.contact.N.T @ (s.state.V_O - s.environment.V_e), 0, atol=1e-10)
    assert max(worst.values()) < RTOL, worst


def _twist_at(body, state):
    shift = state.X_WO.translation - body.X.translation
    return np.concatenate((body.V[:3] + np.cross(body.V[3:], shift), body.V[3:]))


def velocity_product(s, rng):
    """T and Ṫβ of a smooth basis T(t): NᵀT = 0 at all times, and otherwise any spin."""
    T, N, N_dot = s.contact.T, s.contact.N, s.N_dot
    T_dot = -N @ np.linalg.solve(N.T @ N, N_dot.T @ T) + T @ rng.normal(size=(T.shape[1],) * 2)
    beta = np.linalg.lstsq(T, s.state.V_O - s.environment.V_e, rcond=None)[0]
    Tdot_beta = T_dot @ beta
    if len(s.bodies) > 1:  # there is no one V_rel = Tβ: only NᵀṪβ = n_γ remains of Ṫ
        miss = s.contact.n_gamma - N.T @ Tdot_beta
        Tdot_beta = Tdot_beta + N @ np.linalg.solve(N.T @ N, miss)
    return T, Tdot_beta


def test_several_bodies_have_one_relative_acceleration_but_no_common_velocity_product():
    """n_γ is −ṅᵀ(V − V_i) with each contact's own body; −ṄᵀV_rel with the combined V_e is not."""
    s = scene(panda_pair, "rail and free body", np.random.default_rng(38))
    V_rel = s.state.V_O - s.environment.V_e
    np.testing.assert_allclose(s.contact.N.T @ V_rel, 0, atol=1e-10)
    assert np.abs(-s.N_dot.T @ V_rel - s.contact.n_gamma).max() > 1e-2
    own = [-s.N_dot[:, i] @ (s.state.V_O - _twist_at(s.bodies[t.body], s.state))
           for i, t in enumerate(s.touches)]  # fmt: skip
    np.testing.assert_allclose(own, s.contact.n_gamma, rtol=1e-9)


def six_dimensional(state, f_S):
    """f, μ₀ + p₀ and Λ₀ of eq. 13 for d = 6."""
    up = np.linalg.inv(state.S).T
    return up @ f_S, up @ (state.bias - state.Lambda @ np.linalg.solve(state.S, state.sigma))


@cases(panda_pair, one_panda)
def test_equations_17_to_20_as_written_with_the_relative_inertia(rig, kind):
    """β̇, α, ϑ̇′ and f_c with Λ_rel, T, Ṫβ and f′, against the whole system (d = 6)."""
    rng = np.random.default_rng(31)
    for _ in range(10):
        s = scene(rig, kind, rng)
        state, env, N = s.state, s.environment, s.contact.N
        tau = rng.normal(size=s.chain.n_a) * 20
        truth = s.solve(tau)
        T, Tdot_beta = velocity_product(s, rng)
        np.testing.assert_allclose(N.T @ Tdot_beta, s.contact.n_gamma, atol=1e-9)
        Lambda_0, Phi_0 = np.linalg.inv(state.Phi), state.Phi
        relative = Lambda_rel(state, env)
        f, bias = six_dimensional(state, state.G @ tau)
        f_prime = f - bias - Lambda_0 @ (Tdot_beta + env.b_e)
        beta_dot = np.linalg.solve(T.T @ relative @ T, T.T @ relative @ Phi_0 @ f_prime)  # 17
        D = N.T @ np.linalg.inv(relative) @ N
        alpha = np.linalg.solve(D, N.T @ Phi_0 @ f_prime)  # 18
        drive = relative @ Phi_0 @ f_prime
        split = projections.Omega_f(N, np.linalg.inv(relative))
        theta = np.linalg.solve(relative, drive - split @ drive)  # 19
        f_c = split @ drive  # 20
        a_e = truth.a_e[0] if len(s.bodies) == 1 else env.Phi_e @ f_c + env.b_e  # 14
        want = truth.a_object - a_e - Tdot_beta
        assert close_to(alpha, truth.alpha) < RTOL
        assert close_to(N @ truth.alpha, f_c) < RTOL  # 16
        scale = max(np.abs(truth.a_object).max(), np.abs(a_e).max(), np.abs(Tdot_beta).max())
        assert np.abs(T @ beta_dot - want).max() < RTOL * scale  # 15
        assert np.abs(theta - want).max() < RTOL * scale


def test_five_motions_and_a_free_body_have_a_relative_inertia_too():
    """d = 5: Φ₀ is singular, Φ₀ + Φ_e is not; eqs. 17 and 18 hold with it."""
    rng = np.random.default_rng(32)
    for _ in range(20):
        s = scene(scara_pair, "free body", rng)
        state, env, N = s.state, s.environment, s.contact.N
        tau = rng.normal(size=8) * 20
        truth = s.solve(tau)
        T, Tdot_beta = velocity_product(s, rng)
        relative = Lambda_rel(state, env)
        np.testing.assert_allclose(relative @ (state.Phi + env.Phi_e), np.eye(6), atol=1e-8)
        free = state.S @ np.linalg.solve(state.Lambda, state.G @ tau - state.bias)
        drive = free + state.sigma - Tdot_beta - env.b_e  # Λ₀⁻¹f′
        beta_dot = np.linalg.solve(T.T @ relative @ T, T.T @ relative @ drive)
        alpha = np.linalg.solve(N.T @ np.linalg.inv(relative) @ N, N.T @ drive)
        assert close_to(alpha, truth.alpha) < RTOL
        want = truth.a_object - truth.a_e[0] - Tdot_beta
        scale = max(np.abs(x).max() for x in (truth.a_object, truth.a_e[0], Tdot_beta))
        assert np.abs(T @ beta_dot - want).max() < RTOL * scale


def test_no_relative_inertia_where_nobody_yields():
    state = scara_pair().state(*random_state(scara_pair(), np.random.default_rng(33)))
    with pytest.raises(osc.ModelError, match="neither chain nor environment yields"):
        Lambda_rel(state, Environment.fixed())


# Equations 21 to 25 -------------------------------------------------------------------------------


def metrics_B(state, rng):
    A = rng.normal(size=(6, 6))
    total = state.metric + sum(arm.Lambda for arm in state.arms)
    return np.linalg.inv(state.metric), np.linalg.inv(total), A @ A.T + 0.1 * np.eye(6)


def commanded(s, relative, alpha, B, Tdot_beta=None):
    """Whole-system answer to a relative motion command and a force command."""
    state, contact, env = s.state, s.contact, s.environment
    a_u = object_acceleration(state, contact, env, relative, alpha, Tdot_beta)
    eta_u = object_coordinates(state, contact, a_u)
    eta_c = filtered_motion(state, contact, eta_u, alpha, B, env)
    return s.solve(torques(s, generalised_force(state, eta_c, contact.N @ alpha), eta_c)), eta_c


def torques(s, f_S, eta):
    allocation = Allocation(s.chain, np.zeros(s.chain.nq))
    squeeze = 5.0 if len(s.chain.arms) == 2 else 0.0
    return allocation.torques(s.state, s.q, s.v, f_S, eta, squeeze)


def tangential(s, x):
    """P_T x: argmin_e (x − Se)ᵀΛ_o(x − Se) subject to NᵀSe = Nᵀx, by its own KKT system."""
    S, N_S, L = s.state.S, s.state.S.T @ s.contact.N, s.state.metric
    r = s.contact.r
    K = np.block([[S.T @ L @ S, N_S], [N_S.T, np.zeros((r, r))]])
    return np.linalg.solve(K, np.concatenate((S.T @ L @ x, s.contact.N.T @ x)))[: s.state.d]


def environment_acceleration(s, truth):
    """a_e (6,) of the touched body, or of the one that stands for several."""
    if len(s.bodies) == 1:
        return truth.a_e[0]
    return s.environment.Phi_e @ s.contact.N @ truth.alpha + s.environment.b_e


@cases(*RIGS)
def test_force_and_motion_commands_do_not_disturb_each_other_on_a_yielding_environment(rig, kind):
    """α = α_u, untouched by a motion step; P_T(a − a_e − σ) untouched by a force step."""
    rng = np.random.default_rng(34)
    for _ in range(3):
        s = scene(rig, kind, rng)
        alpha, relative = rng.uniform(5, 20, s.contact.r), rng.normal(size=6) * 3
        step = rng.uniform(2, 6, s.contact.r)
        for B in metrics_B(s.state, rng):
            base, eta_c = commanded(s, relative, alpha, B)
            forced, _ = commanded(s, relative, alpha + step, B)
            pushed, _ = commanded(s, relative + rng.normal(size=6), alpha, B)
            size = max(np.abs(x.a_object).max() for x in (base, forced))
            assert np.abs(base.a_object - s.state.S @ eta_c - s.state.sigma).max() < RTOL * size
            assert close_to(base.alpha, alpha) < RTOL
            assert close_to(pushed.alpha, alpha) < RTOL
            assert close_to(forced.alpha, alpha + step) < RTOL
            seen = [
                tangential(s, x.a_object - environment_acceleration(s, x) - s.state.sigma)
                for x in (base, forced, pushed)
            ]
            size = size * np.linalg.norm(np.linalg.pinv(s.state.S), 2)
            assert np.abs(seen[1] - seen[0]).max() < RTOL * size
            assert np.abs(seen[2] - seen[0]).max() > 1e-3
            if s.environment.Phi_e.any():  # the object itself does follow the environment
                assert np.abs(forced.a_object - base.a_object).max() > 1e-6


@cases(panda_pair, one_panda)
def test_equations_21_24_and_25_with_relative_commands(rig, kind):
    """ϑ̇′ = Ω_m(B)ϑ̇′_u and f_c = Ω_f(A)f_cu for any T, Ṫ, A, B; f′ is that of eq. 21 (d = 6)."""
    rng = np.random.default_rng(35)
    for _ in range(4):
        s = scene(rig, kind, rng)
        state, env, N = s.state, s.environment, s.contact.N
        Tdot_beta = velocity_product(s, rng)[1]
        A = rng.normal(size=(6, 6))
        A_inv = A @ A.T + 0.1 * np.eye(6)
        theta_u, f_cu = rng.normal(size=6) * 3, rng.normal(size=6) * 20
        f_comm = projections.Omega_f(N, A_inv) @ f_cu
        alpha_u = np.linalg.lstsq(N, f_comm, rcond=None)[0]
        for B in metrics_B(state, rng):
            truth, eta_c = commanded(s, theta_u, alpha_u, B, Tdot_beta)
            theta_comm = theta_u - projections.Omega_m_bar(N, B) @ theta_u
            a_e = environment_acceleration(s, truth)
            relative = truth.a_object - a_e - Tdot_beta
            size = max(np.abs(x).max() for x in (truth.a_object, a_e, Tdot_beta))
            assert np.abs(relative - theta_comm).max() < RTOL * size  # 24
            assert close_to(N @ truth.alpha, f_comm) < RTOL  # 25
            f, bias = six_dimensional(state, generalised_force(state, eta_c, f_comm))
            Lambda_0 = np.linalg.inv(state.Phi)
            f_prime = f - bias - Lambda_0 @ (Tdot_beta + env.b_e)
            want = Lambda_0 @ theta_comm + f_comm + Lambda_0 @ env.Phi_e @ f_comm
            assert close_to(f_prime, want) < 1e-8  # 21, with Λ_rel⁻¹ = Λ₀⁻¹ + Φ_e


@cases(panda_pair)
def test_unfiltered_commands_couple_through_the_relative_inertia(rig, kind):
    """Eqs. 22 and 23 as written, after eq. 21 with any commands (d = 6)."""
    rng = np.random.default_rng(36)
    for _ in range(4):
        s = scene(rig, kind, rng)
        state, env, N = s.state, s.environment, s.contact.N
        Tdot_beta = velocity_product(s, rng)[1]
        theta, force = rng.normal(size=6) * 2, rng.normal(size=6) * 10
        relative = Lambda_rel(state, env)
        Lambda_0, inverse = np.linalg.inv(state.Phi), np.linalg.inv(relative)
        f_prime = Lambda_0 @ theta + Lambda_0 @ inverse @ force  # 21
        _, bias = six_dimensional(state, np.zeros(6))
        f = f_prime + bias + Lambda_0 @ (Tdot_beta + env.b_e)
        truth = s.solve(torques(s, state.S.T @ f, np.zeros(6)))
        Omega_f, Omega_m_bar = projections.Omega_f(N, inverse), projections.Omega_m_bar(N, inverse)
        got = truth.a_object - environment_acceleration(s, truth) - Tdot_beta
        want = theta - Omega_m_bar @ theta + inverse @ (force - Omega_f @ force)  # 22
        f_c = Omega_f @ force + relative @ Omega_m_bar @ theta  # 23
        size = max(np.abs(x).max() for x in (truth.a_object, Tdot_beta, inverse @ force, theta))
        assert np.abs(got - want).max() < RTOL * size
        assert close_to(N @ truth.alpha, f_c) < RTOL
        assert np.abs(f_c - Omega_f @ force).max() > 1e-3


# Measurement (fig. 5) -----------------------------------------------------------------------------


def hardware(rig):
    """URDF of each arm, and the fixed joint that carries its sensor."""
    if rig is scara_pair:
        files = [robots.urdf_path("scara_left"), robots.urdf_path("scara_right")]
        return files, ["wrist_sensor_joint"] * 2
    k = len(rig().arms)
    return [robots.find_robot("panda")[0]] * k, ["panda_hand_joint"] * k


@cases(*RIGS)
def test_contact_force_from_wrist_sensors_is_exact_on_moving_and_yielding_bodies(rig, kind):
    """Sensors by RNEA through a hinge put in their place, links between sensor and object."""
    rng = np.random.default_rng(37)
    files, cuts = hardware(rig)
    for _ in range(8):
        s = scene(rig, kind, rng)
        tau = rng.normal(size=s.chain.n_a) * 20
        truth = s.solve(tau)
        O = s.state.X_WO.translation  # noqa: E741
        wrenches = wrist_readings(s.chain, files, cuts, s.q, s.v, truth, O)
        f_meas = sum_of_wrenches(wrenches, s.state)
        f_c = contact_force(f_meas, s.state, s.contact, s.environment)
        assert close_to(magnitudes(f_c, s.contact), truth.alpha) < RTOL
        ignored = contact_force(f_meas, s.state, s.contact, Environment.fixed())
        assert close_to(magnitudes(ignored, s.contact), truth.alpha) > 1e-4


# The constructors by themselves -------------------------------------------------------------------


def derivative(f, h=1e-3):
    """Central difference of fifth order."""
    return (8 * (f(h) - f(-h)) - (f(2 * h) - f(-2 * h))) / (12 * h)


@pytest.mark.parametrize("seed", range(20))
def test_prescribed_motion_against_finite_differences_of_the_pose(seed):
    """V_e, b_e and the classical acceleration from the pose alone, at a frozen point O."""
    rng = np.random.default_rng([seed, 40])
    c, d, e = rng.normal(size=(3, 3)), rng.normal(size=(3, 3)), random_placement(rng, np.zeros(3))
    O = rng.normal(size=3)  # noqa: E741

    def pose(t):
        s = np.array([np.sin(t), np.cos(2 * t), t * t])
        return pin.SE3(e.rotation @ pin.exp3(c @ s), d @ s)

    def twist(t):
        X = pose(t)
        R_dot = derivative(lambda h: pose(t + h).rotation, 2e-3)
        spin = R_dot @ X.rotation.T
        omega = np.array(
            [spin[2, 1] - spin[1, 2], spin[0, 2] - spin[2, 0], spin[1, 0] - spin[0, 1]]
        )
        return np.concatenate((derivative(lambda h: pose(t + h).translation, 2e-3), omega / 2))

    def at_O(t):
        V, X = twist(t), pose(t)
        return np.concatenate((V[:3] + np.cross(V[3:], O - X.translation), V[3:]))

    env = Environment.moving(X_WE=pose(0.3), V_E=twist(0.3),
                             A_E=derivative(lambda h: twist(0.3 + h), 5e-3), O=O)  # fmt: skip
    np.testing.assert_allclose(env.V_e, at_O(0.3), atol=1e-9)
    np.testing.assert_allclose(env.b_e, derivative(lambda h: at_O(0.3 + h), 5e-3), atol=2e-6)
    assert not env.Phi_e.any()


@pytest.mark.parametrize("kind", ["free body", "rail", "hinge", "ball", "plane", "linkage"])
def test_bias_acceleration_and_inverse_inertia_against_the_motion_that_follows(kind):
    """dV_e/dt at a frozen O along the motion ABA predicts, free and under a wrench at O."""
    rng = np.random.default_rng([41])
    make = KINDS[kind][0][0]
    for _ in range(20):
        body, at = make(rng, np.zeros(3))
        O, f = rng.normal(size=3), rng.normal(size=6)  # noqa: E741
        env = at(O)
        joint = body.model.frames[body.id].parentJoint
        for wrench in (np.zeros(6), f):
            external = [pin.Force.Zero() for _ in range(body.model.njoints)]
            at_world = pin.Force(wrench[:3], wrench[3:] + np.cross(O, wrench[:3]))
            pin.forwardKinematics(body.model, body.data, body.q)
            external[joint] = body.data.oMi[joint].actInv(at_world)
            qdd = pin.aba(body.model, body.data, body.q, body.v, body.tau, external)

            def twist(h, body=body, qdd=qdd, O=O):  # noqa: E741
                q = pin.integrate(body.model, body.q, body.v * h + qdd * h * h / 2)
                later = replace(body, q=q, v=body.v + qdd * h)
                V, p = later.V, later.X.translation
                return np.concatenate((V[:3] + np.cross(V[3:], O - p), V[3:]))

            got = env.Phi_e @ wrench + env.b_e
            h = 1e-5  # the path above is exact to second order
            want = (twist(h) - twist(-h)) / (2 * h)
            np.testing.assert_allclose(got, want, atol=1e-6 * max(1.0, np.abs(want).max()))
        np.testing.assert_allclose(env.V_e, twist(0.0), atol=1e-12)


def test_rank_of_the_inverse_inertia_is_the_freedom_of_the_body():
    rng = np.random.default_rng(42)
    ranks = {"free body": 6, "rail": 1, "hinge": 1, "ball": 3, "plane": 3, "linkage": 2}
    for kind, rank in ranks.items():
        values = np.linalg.eigvalsh(KINDS[kind][0][0](rng, np.zeros(3))[1](np.ones(3)).Phi_e)
        assert np.count_nonzero(values > 1e-9 * values[-1]) == rank


def test_a_cart_on_a_rail_needs_nothing_but_mass_and_direction():
    x = np.array([0.6, 0.0, -0.8])
    cart = Environment.rail(
        pin.Inertia(4.0, np.zeros(3), np.zeros((3, 3))),
        X_WE=pin.SE3.Identity(), axes=[*x, 0, 0, 0], rates=[0.5], O=[1, 2, 3], gravity=G,
        force=[-12.0],
    )  # fmt: skip
    np.testing.assert_allclose(cart.Phi_e[:3, :3], np.outer(x, x) / 4, atol=1e-15)
    assert not cart.Phi_e[3:].any()
    np.testing.assert_allclose(cart.b_e, [*(x * (0.8 * 9.81 - 3.0)), 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(cart.V_e, [*(0.5 * x), 0, 0, 0], atol=1e-15)


def test_two_links_of_one_mechanism_push_through_each_other():
    """Contacts on both links of a linkage: the full Φ_N, against the whole system."""
    rng, chain = np.random.default_rng(43), panda_pair()
    for _ in range(20):
        q, v = random_state(chain, rng)
        state = chain.state(q, v)
        O = state.X_WO.translation  # noqa: E741
        body, _ = linkage(rng, O)
        links = ["upper", "touched"]
        touches = [Touch(rng.uniform(-0.3, 0.3, 3), rng.normal(size=3), 0, f) for f in links]
        seen = [Body(body.model, body.q, body.v, body.tau, f) for f in links]
        parts = [contacts_at(state, [b], [replace(t, body=0)])[0]
                 for b, t in zip(seen, touches, strict=True)]  # fmt: skip
        each = [Environment.articulated(body.model, body.q, body.v, body.tau, f, O) for f in links]
        M = pin.crba(body.model, body.data, body.q)
        M = np.triu(M) + np.triu(M, 1).T
        rows = np.vstack([
            p.N.T @ np.column_stack([_twist_at(replace(b, v=e), state) for e in np.eye(2)])
            for p, b in zip(parts, seen, strict=True)
        ])  # fmt: skip
        env = Environment.of_contacts(
            np.hstack([p.N for p in parts]),
            rows @ np.linalg.solve(M, rows.T),
            np.concatenate([p.N.T @ e.b_e for p, e in zip(parts, each, strict=True)]),
            np.concatenate([p.N.T @ e.V_e for p, e in zip(parts, each, strict=True)]),
            state.metric,
        )
        tau = rng.normal(size=chain.n_a) * 20
        truth = kkt(chain, q, v, tau, [body], touches)
        got = contact_response(state, osc.Contact.stack(parts), env, tau=tau)
        assert close_to(got.alpha, truth.alpha) < RTOL
        assert close_to(got.acceleration, truth.a_object) < RTOL


def test_one_body_behind_every_contact_stays_what_it_is():
    """Shared bodies couple their contacts; as one environment or by their normals is the same."""
    rng = np.random.default_rng(44)
    s = scene(panda_pair, "free body", rng)
    env = s.environment
    assert Environment.combine(s.parts, [env, env], s.state.metric) is env
    N = s.contact.N
    alike = Environment.of_contacts(
        N, N.T @ env.Phi_e @ N, N.T @ env.b_e, N.T @ env.V_e, s.state.metric
    )
    tau = rng.normal(size=s.chain.n_a) * 20
    a, b = (contact_response(s.state, s.contact, e, tau=tau) for e in (env, alike))
    assert close_to(b.alpha, a.alpha) < RTOL
    assert close_to(b.acceleration, a.acceleration) < RTOL
    assert np.abs(b.a_e - a.a_e).max() > 1e-3  # only Nᵀa_e has a meaning
    assert close_to(N.T @ b.a_e, N.T @ a.a_e) < RTOL
    apart = Environment.combine(s.parts, [env, replace(env)], s.state.metric)
    assert close_to(contact_response(s.state, s.contact, apart, tau=tau).alpha, a.alpha) > 1e-3


def test_no_contacts_have_a_fixed_environment():
    env = Environment.combine([], [], np.eye(6))
    assert not (env.Phi_e.any() or env.b_e.any() or env.V_e.any())
    empty = Environment.of_contacts(np.zeros((6, 0)), np.zeros((0, 0)), [], [], np.eye(6))
    assert not empty.Phi_e.any()


@pytest.mark.parametrize("seed", range(50))
def test_the_environment_of_several_contacts_does_not_depend_on_frame_or_units(seed):
    rng = np.random.default_rng([seed, 45])
    N, half = rng.normal(size=(6, 3)), rng.normal(size=(3, 2))
    b_N, V_N = rng.normal(size=3), rng.normal(size=3)
    inertia = random_inertia(rng).matrix()
    env = Environment.of_contacts(N, half @ half.T, b_N, V_N, inertia)
    np.testing.assert_allclose(N.T @ env.Phi_e @ N, half @ half.T, atol=1e-10)
    np.testing.assert_allclose(N.T @ env.b_e, b_N, atol=1e-10)
    X = pin.SE3(pin.rpy.rpyToMatrix(*rng.uniform(-3, 3, 3)), rng.normal(size=3)).action
    X = np.diag([1e3, 1e3, 1e3, 1, 1, 1]) @ X  # mm
    F, Q = np.linalg.inv(X).T, rng.normal(size=(3, 3))  # forces; and another basis of N
    moved = Environment.of_contacts(
        F @ N @ Q, Q.T @ half @ half.T @ Q, Q.T @ b_N, Q.T @ V_N, F @ inertia @ F.T
    )
    assert close_to(moved.Phi_e, X @ env.Phi_e @ X.T) < 1e-9
    assert close_to(moved.b_e, X @ env.b_e) < 1e-9
    assert close_to(moved.V_e, X @ env.V_e) < 1e-9


# Refusals -----------------------------------------------------------------------------------------

BODY = pin.Inertia(2.0, np.array([0.1, 0, 0]), np.diag([0.02, 0.03, 0.04]))
AT = {"X_WE": pin.SE3.Identity(), "O": np.zeros(3)}


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: Environment.moving(**AT, V_E=np.zeros(3), A_E=np.zeros(6)), "V_E: expected shape"),
        (lambda: Environment.moving(**AT, V_E=np.zeros(6), A_E=np.full(6, np.nan)), "A_E: element"),
        (lambda: Environment.rigid_body(BODY, **AT, V_E=np.zeros(6), gravity=[9.81]), "gravity"),
        (lambda: Environment.rigid_body(BODY, **AT, V_E=np.full(6, np.inf)), "V_E: element"),
        (lambda: Environment.rigid_body(BODY, **AT, V_E=np.zeros(6), wrench=[1.0]), "wrench"),
        (lambda: Environment.rail(BODY, **AT, axes=np.zeros(3), rates=[0.0]), "axes: expected"),
        (lambda: Environment.rail(BODY, **AT, axes=np.ones(6), rates=[0.0, 1.0]), "rates"),
        (lambda: Environment.rail(BODY, **AT, axes=[[1.0], [1.0, 2.0]], rates=[0.0]), "axes"),
        (lambda: Environment.rail(BODY, **AT, axes=[np.nan] * 6, rates=[0.0]), "axes: element"),
        (lambda: Environment(-np.eye(6)), "Phi_e is not positive semidefinite"),
        (lambda: Environment(np.eye(6) + 1e-3 * np.eye(6, k=1)), "Phi_e is not symmetric"),
        (lambda: Environment.rail(BODY, **AT, axes=np.ones(6), rates=[0], force=[1, 2]), "force"),
        (lambda: Environment.combine([osc.Contact(np.eye(6)[:, :1])], [], np.eye(6)), "1 contacts"),
        (lambda: of_two(np.eye(3)), r"Phi_N: expected shape \(2, 2\)"),
        (lambda: of_two([[1.0, 0.1], [0.0, 1.0]]), "Phi_N is not symmetric"),
        (lambda: of_two([[1.0, 2.0], [2.0, 1.0]]), "Phi_N is not positive semidefinite"),
        (lambda: of_two([[1.0, 0.0], [0.0, np.nan]]), "Phi_N: element"),
    ],
)
def test_bad_arguments_are_refused(make, message):
    with pytest.raises(osc.InvalidInputError, match=message):
        make()


def of_two(Phi_N):
    return Environment.of_contacts(np.eye(6)[:, :2], Phi_N, np.zeros(2), np.zeros(2), np.eye(6))


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: Environment.rail(BODY, **AT, axes=np.ones((6, 2)), rates=[0, 0]), "its axes"),
        (
            lambda: Environment.rail(
                pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))),
                **AT, axes=[0, 0, 0, 0, 0, 1], rates=[0],
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
)  # fmt: skip
def test_impossible_bodies_are_refused(make, message):
    with pytest.raises(osc.ModelError, match=message):
        make()


def test_impossible_mechanisms_and_dependent_contacts_are_refused():
    body, _ = linkage(np.random.default_rng(46), np.zeros(3))
    args = (body.q, body.v, body.tau)
    with pytest.raises(osc.ModelError, match="touchd"):
        Environment.articulated(body.model, *args, "touchd", np.zeros(3))
    with pytest.raises(osc.InvalidInputError, match="tau: expected shape"):
        Environment.articulated(body.model, body.q, body.v, np.zeros(3), "touched", np.zeros(3))
    body.model.inertias[1] = body.model.inertias[2] = pin.Inertia.Zero()
    with pytest.raises(osc.ModelError, match="joint-space inertia"):
        Environment.articulated(body.model, *args, "touched", np.zeros(3))
    n = np.eye(6)[:, [0, 0]]
    with pytest.raises(osc.ContactError, match="dependent"):
        Environment.of_contacts(n, np.eye(2), np.zeros(2), np.zeros(2), np.eye(6))


def test_a_contact_where_nobody_yields_is_refused_and_one_where_the_environment_does_is_not():
    """The SCARA pair cannot turn about its locked couple; a free body behind it can."""
    chain, rng = scara_pair(), np.random.default_rng(47)
    state = chain.state(*random_state(chain, rng))
    locked = osc.Contact(state.C)
    rolled = Environment(state.C @ state.C.T * 0.1)
    got = contact_response(state, locked, rolled, tau=np.zeros(8))
    want = (state.C.T @ state.sigma) / (0.1 * (state.C.T @ state.C)[0, 0] ** 2)
    np.testing.assert_allclose(got.alpha, want, rtol=1e-9)
    across = Environment(np.outer(state.S[:, 0], state.S[:, 0]))
    with pytest.raises(osc.ContactError, match="the arms and the environment cannot push"):
        contact_response(state, locked, across, tau=np.zeros(8))
    with pytest.raises(osc.ContactError, match="the arms cannot push"):
        object_coordinates(state, locked, np.zeros(6))
