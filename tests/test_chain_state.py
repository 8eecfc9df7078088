"""`ClosedChain.state`, which the law computes, against the same terms in NumPy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from grasp_rigs import KINDS, random_case
from readable.chain import state as numpy_state
from rigs import SCARA_Q, one_panda, random_state, scara_pair
from test_singular import straight_panda, stretched_scaras

import osc_contact as osc

ARMS = ["scara", "ur5", "panda", "2R", "3R"]
TERMS = ("V_O", "Phi", "sigma", "w", "h", "M", "metric", "grasp_points", "Lambda_out", "bias_out",
         "reference")  # fmt: skip
ARM_TERMS = ("J", "gamma", "M", "Phi", "Lambda", "J_bar", "mu", "p")


def assert_close(name, got, want, tolerance):
    size = max(1.0, np.abs(want).max(initial=0.0))
    np.testing.assert_allclose(got, want, rtol=0, atol=tolerance * size, err_msg=name)


def onto(columns):
    """Projection on what the columns span: the same for every basis."""
    return columns @ np.linalg.pinv(columns) if columns.size else np.zeros((6, 6))


def assert_same(got, want, tolerance=1e-9):
    """All that does not name a basis; what does, in the basis of `want`."""
    np.testing.assert_allclose(got.X_WO.homogeneous, want.X_WO.homogeneous, atol=1e-12)
    for name in TERMS:
        assert_close(name, getattr(got, name), getattr(want, name), tolerance)
    assert got.d == want.d and got.unactuated.shape == want.unactuated.shape
    if got.d:
        B = np.linalg.lstsq(want.S, got.S, rcond=None)[0]
        for name, mine, theirs in (
            ("S", got.S, want.S @ B), ("Lambda_S", got.Lambda_S, B.T @ want.Lambda_S @ B),
            ("mu_S", got.mu_S, B.T @ want.mu_S), ("p_S", got.p_S, B.T @ want.p_S),
            ("W", got.W, want.W @ B),
            ("G", got.G, B.T @ want.G),
        ):  # fmt: skip
            assert_close(name, mine, theirs, tolerance)
    assert_close("C", onto(got.C), onto(want.C), tolerance)
    for mine, theirs in zip(got.arms, want.arms, strict=True):
        assert mine.rank == theirs.rank
        for name in ARM_TERMS:
            assert_close(name, getattr(mine, name), getattr(theirs, name), tolerance)
        assert_close("C of an arm", onto(mine.C), onto(theirs.C), tolerance)
        assert_close("N of an arm", onto(mine.N), onto(theirs.N), tolerance)
    for mine, theirs in zip(got.filters, want.filters, strict=True):
        if theirs is not None:
            assert_close("filter", np.eye(6) if mine is None else mine, theirs, tolerance)
    for mine, theirs in zip(got.sensors, want.sensors, strict=True):
        assert (mine is None) == (theirs is None)
        if mine is not None:
            assert mine.isApprox(theirs, 1e-12)


def test_random_chains_with_every_grasp():
    """1–4 arms; pose and twist given, and told by the joints."""
    rng, told = np.random.default_rng(70), 0
    for _ in range(60):
        n = rng.integers(1, 5)
        case = random_case(list(rng.choice(ARMS, n)), list(rng.choice(KINDS, n)), rng)
        v, V = case.moving(rng)
        here = case.X_WO, V
        assert_same(case.chain.state(case.q, v, *here), numpy_state(case.chain, case.q, v, *here))
        try:
            got = case.chain.state(case.q, v)
        except osc.ModelError as error:
            assert "do not tell where the object is" in str(error)
            continue
        told += 1
        assert_same(got, numpy_state(case.chain, case.q, v))
    assert told > 30


@pytest.mark.parametrize("rig", [scara_pair, one_panda])
def test_a_pose_that_is_given_counts_more_than_what_the_joints_say(rig):
    """O somewhere else: everything is said there, and the twist is the tip's."""
    chain, rng = rig(), np.random.default_rng(71)
    q, v = random_state(chain, rng)
    X = chain.state(q, v).X_WO * pin.exp6(pin.Motion(0.05 * rng.normal(size=6)))
    assert_same(chain.state(q, v, X), numpy_state(chain, q, v, X))


def test_nothing_held_and_gravity_that_changes():
    panda, rng = one_panda(), np.random.default_rng(72)
    chain = osc.ClosedChain(panda.arms, panda.grasps, None)
    for gravity in ([0.0, 0.0, -9.81], [1.0, -3.0, 2.0]):
        chain.model.gravity.linear = np.array(gravity)
        q, v = straight_panda(-1.5) + 0.3 * rng.normal(size=7), rng.normal(size=7)
        assert_same(chain.state(q, v), numpy_state(chain, q, v))


def test_what_singular_postures_lose():
    """χ, shares, wrenches, motions and modes of the SCARA pair and the Panda, elbows bent less."""
    rigs = [(scara_pair(), q) for q in stretched_scaras()[:350:25]]
    rigs += [(one_panda(), straight_panda(bend)) for bend in (0.3, 0.1, 0.02, 0.004)]
    seen = 0
    for chain, q in rigs:
        v = 0.1 * np.ones(chain.nq)
        got, want = chain.state(q, v), numpy_state(chain, q, v)
        assert_same(got, want, 1e-8)
        assert len(got.singular_directions) == len(want.singular_directions)
        for mine, theirs in zip(got.singular_directions, want.singular_directions, strict=True):
            assert (mine.arm, mine.locked) == (theirs.arm, theirs.locked)
            sign = np.sign(mine.mode @ got.arms[mine.arm].M @ theirs.mode)
            for name in ("chi", "share"):
                assert getattr(mine, name) == pytest.approx(getattr(theirs, name), rel=1e-7)
            for name in ("wrench", "twist", "mode"):
                assert_close(name, sign * getattr(mine, name), getattr(theirs, name), 1e-7)
            seen += 1
    assert seen > 10


def test_a_state_is_a_value():
    """A later one changes nothing in it, and two at the same place are the same to the last bit."""
    chain, rng = scara_pair(), np.random.default_rng(73)
    one = chain.state(SCARA_Q, np.zeros(10))
    kept = replace(one, M=one.M.copy(), Phi=one.Phi.copy())
    chain.state(*random_state(chain, rng))
    again = chain.state(SCARA_Q, np.zeros(10))
    for name in ("M", "Phi"):
        np.testing.assert_array_equal(getattr(one, name), getattr(kept, name))
        np.testing.assert_array_equal(getattr(one, name), getattr(again, name))
