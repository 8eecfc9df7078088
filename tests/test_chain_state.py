"""Every term of `ClosedChain.state` by what defines it: constraints, energy, wrist readings.

Pinocchio gives M, h, J and drifts, `kkt_oracle` what grasps permit.
"""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pinocchio as pin
from grasp_rigs import BODY, KINDS, random_case
from kkt_oracle import State
from numpy.linalg import cholesky, inv, lstsq, matrix_rank, norm, pinv, qr, solve, svd
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from pytest import approx
from rigs import (
    LWA,
    SCARA_Q,
    assert_close,
    assert_near,
    largest,
    one_panda,
    panda_pair,
    placed,
    posed,
    product,
    random_state,
    scara_pair,
    shift,
    terms_at,
)
from samples import aligned, parametrize
from test_singular import straight_panda, stretched_scaras

import osc_contact as osc

ARMS = ["scara", "ur5", "panda", "2R", "3R"]


def onto(columns):
    """Projection on what the columns span: the same for every basis."""
    return columns @ pinv(columns) if columns.size else np.zeros((6, 6))


def assert_arms(chain, s, q, v):
    """Φ, Λ, J̄, γ, μ, p, ranks, C and N of each arm; N = 1 where the grasp is rigid."""
    model = chain.model
    data = terms_at(model, q, v)
    assert_close(s.M, data.M, name="M")
    assert_close(s.h, data.nle, name="h")
    O = s.X_WO.translation
    X = chain.tip_poses(data)
    assert_near(s.grasp_points, [one.translation for one in X], atol=1e-12)
    root = cholesky(s.metric)
    for i, (arm, part, grasp) in enumerate(aligned(s.arms, chain.slices, chain.grasps)):
        to_O = shift(X[i].translation - O).action
        J = to_O @ pin.getFrameJacobian(model, data, chain.tips[i], LWA)[:, part]
        gamma = to_O @ pin.getFrameAcceleration(model, data, chain.tips[i], LWA).vector
        N = np.eye(6)
        if not grasp.is_rigid:  # the object slips while the tip carries N along
            gamma = gamma + pin.Motion(J @ v[part]).cross(pin.Motion(s.V_O)).vector
            N = grasp.wrenches_at(X[i], O)
        M = data.M[part, part]
        h = data.nle[part]
        g = data.g[part]
        passed = qr(solve(root, N))[0]
        U, sizes, Vh = svd(passed.T @ root.T @ J @ inv(cholesky(M)).T)
        ratio = (1.0 + 1.0 / np.maximum(sizes, 1e-30) ** 2) / (1.0 + 1.0 / sizes.max() ** 2)
        rank = np.count_nonzero(ratio < chain.rank_tolerance**-2)
        inverse = (Vh[:rank].T / sizes[:rank]) @ U[:, :rank].T
        J_bar = inv(cholesky(M)).T @ inverse @ passed.T @ root.T
        assert arm.rank == rank
        Lambda = J_bar.T @ M @ J_bar
        for name, expected in {
            "J": J,
            "gamma": gamma,
            "M": M,
            "Phi": J @ solve(M, J.T),
            "J_bar": J_bar,
            "Lambda": Lambda,
            "mu": J_bar.T @ (h - g) - Lambda @ gamma,
            "p": J_bar.T @ g,
        }.items():
            assert_close(getattr(arm, name), expected, name=name)
        assert_close(onto(arm.C), onto(root @ passed @ U[:, rank:]), name="C of an arm")
        if not grasp.is_rigid:
            assert_close(onto(arm.N), onto(root @ passed @ U[:, :rank]), name="N of an arm")


def assert_chain(case, v, V, s, rng):
    """S, σ, W, w, Λ_S, b_S, G by the rows of the grasps; Λ_out and its bias by wrist readings."""
    oracle = State(case, []).at(v, V)
    system = oracle.system
    rows = oracle.grasps
    S = s.S
    carried = S.T @ s.payload.Lambda
    weight = s.payload.mu + s.payload.p
    bias = s.W.T @ (s.h + s.M @ s.w) + S.T @ weight + carried @ s.sigma
    for name, got, expected, tolerance in (
        ("S", onto(S), onto(oracle.S), 1e-7),
        ("C", s.C.T @ S, 0.0, 1e-8),
        ("least σ", S.T @ s.metric @ s.sigma, 0.0, 1e-8),
        ("W", rows @ np.vstack((s.W, S)), 0.0, 1e-8),
        ("w", rows @ np.append(s.w, s.sigma + product(V)), system.right, 1e-7),
        ("Λ_S", s.Lambda_S, s.W.T @ s.M @ s.W + carried @ S, 1e-8),
        ("payload", s.payload.Lambda, system.I, 1e-8),
        ("b_S", s.b_S, bias, 1e-8),
        ("bias of the object", weight, system.I @ product(V) - system.pull, 1e-8),
        ("G", s.G, s.W.T[:, case.chain.actuated], 1e-8),
        ("Φ", s.Phi, S @ solve(s.Lambda_S, S.T), 1e-8),
        ("SᵀΛS", S.T @ s.Lambda @ S, s.Lambda_S, 1e-9),
        ("μ_S", S.T @ (s.mu + s.Lambda @ s.sigma), s.mu_S, 1e-8),
        ("p_S", S.T @ s.p, s.p_S, 1e-9),
        ("μ_S + p_S", s.mu_S + s.p_S, s.b_S, 1e-9),
    ):
        assert_close(got, expected, tolerance=tolerance, name=name)
    assert s.C.shape[1] == 6 - s.d == 6 - oracle.S.shape[1]
    undriven = matrix_rank(S, 1e-9) - matrix_rank(s.G, 1e-6)
    assert s.unactuated.shape[1] == undriven
    answer = oracle.answer(20.0 * rng.standard_normal(case.chain.n_a))
    at_O = shift(s.X_WO.translation).inverse()
    total = np.zeros(6)
    for reading, X, F in aligned(oracle.readings(answer), s.sensors, s.filters):
        wrench = (at_O * X).act(pin.Force(reading)).vector
        total += wrench if F is None else F @ wrench
    assert_close(total, s.Lambda_out @ answer.a_object + s.bias_out, tolerance=1e-7, name="Λ_out")


def test_random_chains_with_every_grasp():
    """1–4 arms, or one that holds nothing: metric and ranks are those of a small ball then.

    Pose and twist given, and found from the joints; gravity that changes.
    """
    rng = default_rng(70)
    found = 0
    for _ in range(30):
        n = rng.integers(1, 5)
        body = BODY if n > 1 or found % 2 else None
        kinds = list(rng.choice(KINDS, n)) if body else ["rigid"]
        case = random_case(list(rng.choice(ARMS, n)), kinds, rng, body=body)
        gravity = 5.0 * rng.standard_normal(3)
        case.chain.model.gravity.linear = gravity
        oracle = State(case, [])
        oracle.move(rng)
        v = oracle.v
        V = oracle.V
        s = case.chain.state(case.q, v, case.X_WO, V)
        assert_arms(case.chain, s, case.q, v)
        assert_chain(case, v, V, s, rng)
        case.chain.model.gravity.linear = -gravity
        try:
            s = case.chain.state(case.q, v)
        except osc.ModelError as error:
            assert "do not determine where the object is" in str(error)
            continue
        found += 1
        assert_near(s.X_WO.homogeneous, case.X_WO.homogeneous, atol=1e-10)
        assert_close(s.V_O, V)
        assert_arms(case.chain, s, case.q, v)
    assert found > 15


@parametrize("rig", [scara_pair, panda_pair])
def test_arms_that_contradict_one_another_move_the_object_as_all_joints_say(rig):
    """V_O of the least errors δ of joint speeds and ε of J_i (q̇_i + δ_i) = V_O + ε_i."""
    chain = rig()
    q, v = random_state(chain, default_rng(72))
    exact = chain.state(q, v)
    v = v + 0.01 * default_rng(73).standard_normal(chain.nq)
    s = chain.state(q, v)
    sliding = ["Prismatic" in joint.shortname() for joint in chain.model.joints[1:]]
    roots = np.where(sliding, 0.2, 1.0)  # of the variances of joint speeds
    energy = cholesky(s.metric).T
    A = np.eye(chain.nq + 12, chain.nq + 6)
    b = np.zeros(len(A))
    for i, (arm, part) in enumerate(aligned(s.arms, chain.slices)):
        J = energy @ arm.J * roots[part]
        rows = slice(chain.nq + 6 * i, chain.nq + 6 * i + 6)
        scale = 10.0 / norm(J)
        A[rows] = 0.0
        A[rows, part] = -scale * J
        A[rows, chain.nq :] = scale * energy
        b[rows] = scale * energy @ arm.J @ v[part]
    found = lstsq(A, b)[0]
    assert largest(found[: chain.nq]) > 1e-3
    assert largest(s.V_O - exact.V_O) > 1e-3
    assert_close(s.V_O, found[chain.nq :])


@parametrize("rig", [scara_pair, one_panda])
def test_a_pose_that_is_given_counts_more_than_what_the_joints_say(rig):
    """O somewhere else: everything is expressed there, and the twist is the tip's."""
    chain = rig()
    rng = default_rng(71)
    q, v, X = posed(chain, rng)
    X = X * pin.exp6(0.05 * rng.standard_normal(6))
    s = chain.state(q, v, X)
    assert_array_equal(s.X_WO.homogeneous, X.homogeneous)
    assert_arms(chain, s, q, v)
    assert_close(s.V_O, s.arms[0].J @ v[chain.slices[0]])


def test_what_singular_postures_lose():
    """χ, shares, wrenches, motions and modes of the SCARA pair and the Panda, elbows bent less."""
    rigs = [(scara_pair(), q) for q in stretched_scaras()[:350:25]]
    rigs += [(one_panda(), straight_panda(bend)) for bend in (0.3, 0.1, 0.02, 0.004)]
    seen = 0
    for chain, q in rigs:
        s = chain.state(q, 0.1 * np.ones(chain.nq))
        c = pin.skew(s.X_WO.rotation @ chain.reference.inertia.lever)
        ball = np.block([[np.eye(3), -c], [c, 0.1**2 * np.eye(3) - c @ c]])
        assert_close(s.reference, s.metric + chain.arm_mass * ball, name="Λ_ref")
        L = cholesky(s.reference)
        for i, arm in enumerate(s.arms):
            sizes = svd(L.T @ solve(cholesky(arm.M), arm.J.T).T, compute_uv=False)
            chis = sizes[: chain.full_ranks[i]]
            mine = [one for one in s.singular_directions if one.arm == i]
            assert_near(
                sorted(one.chi for one in mine), sorted(chis[chis < 0.3]), atol=1e-9, rtol=1e-6
            )
            for one in mine:
                assert one.mode @ arm.M @ one.mode == approx(1.0)
                assert one.twist @ s.reference @ one.twist == approx(1.0)
                assert_close(
                    arm.J @ one.mode, one.chi * one.twist, tolerance=1e-7, name="J ν = χ u"
                )
                assert_close(one.wrench, s.reference @ one.twist, tolerance=1e-7, name="wrench")
                seen += 1
    assert seen > 10


def test_a_state_is_a_value():
    """A later one changes nothing in it, and two at the same place are the same to the last bit."""
    chain = scara_pair()
    one = chain.state(SCARA_Q)
    kept = deepcopy(one)
    chain.state(*random_state(chain, default_rng(73)))
    again = chain.state(SCARA_Q)
    for name in ("M", "Phi"):
        assert_array_equal(getattr(one, name), getattr(kept, name))
        assert_array_equal(getattr(one, name), getattr(again, name))


def test_calibration_errors_do_not_cost_a_motion():
    """A base turned by 1e-4 rad: the arms' locked directions differ, d and V_O stay."""
    pair = scara_pair()
    left, right = pair.arms
    turned = replace(right, base=right.base * placed(rpy=(1e-4, -1e-4, 0.0)))
    q, v = random_state(pair, default_rng(8))
    V_O = pair.state(q, v).V_O
    for tolerance, d in ((pair.angle_tolerance, 5), (1e-6, 4)):
        parts = ([left, turned], pair.grasps, pair.payload)
        s = osc.ClosedChain(*parts, angle_tolerance=tolerance).state(q, v)
        assert s.d == d
        assert_near(s.V_O, V_O, atol=1e-3 * largest(V_O), rtol=0)
