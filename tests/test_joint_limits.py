"""Redundant arms keep off their joint limits, in motions that leave the object alone only."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from kkt_oracle import held
from law_calls import allocation
from numpy.linalg import inv
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx
from rigs import (
    PANDA_Q,
    UNLIMITED,
    commanded,
    holding_panda,
    in_contact,
    largest,
    one_panda,
    panda_pair,
    refused,
    rigid_plant,
    scara_pair,
    ticked,
    unloaded,
)
from samples import parametrize

import osc_contact as osc
from osc_contact import robots
from osc_contact.control.records import joint_limit_margins
from osc_contact.scenarios.control_schema import PostureTask


def push_of(q, margins):
    """(n,) accelerations away from joint limits."""
    names = ("low", "high", "width", "most")
    rows = [
        SimpleNamespace(**dict(zip(names, row, strict=True))) for row in zip(*margins, strict=True)
    ]
    return np.array([allocation.push_from_limits(row, x) for row, x in zip(rows, q, strict=True)])


CALM = PostureTask(limit_stiffness=0.0)
PUSHING = PostureTask(limit_margin=0.2)


def panda(**limits):
    """One Panda whose model has other limits: joint number → (lower, upper)."""
    model = robots.load_model(robots.find_robot("panda")[0])
    lower = model.lowerPositionLimit.copy()
    upper = model.upperPositionLimit.copy()
    for joint, (low, high) in limits.items():
        i = model.joints[model.getJointId(f"panda_{joint}")].idx_q
        lower[i] = low
        upper[i] = high
    model.lowerPositionLimit = lower
    model.upperPositionLimit = upper
    arm = osc.Arm.from_urdf(model, name="arm", tip="panda_hand_tcp", wrist_sensor="panda_hand")
    return holding_panda(arm)


def test_the_push_is_a_bounded_slope_of_a_potential():
    """Against the potential k w² (s³ − s⁴/2) + k w (depth beyond the limit), differentiated."""
    model = panda(joint1=(-1.0, 2.0), joint2=(-np.inf, np.inf), joint3=(-np.inf, 1.0)).model
    k = 400.0
    limits = joint_limit_margins(model, k, 0.05)
    w = np.array(
        [
            0.05 * 3.0,
            0.0,
            0.05 * np.pi,
            *(0.05 * np.minimum(model.upperPositionLimit - model.lowerPositionLimit, np.pi))[3:],
        ]
    )

    def potential(q):
        total = np.zeros(7)
        for i in (0, 2, 3, 4, 5, 6):
            for depth in (
                model.lowerPositionLimit[i] + w[i] - q[i],
                q[i] - model.upperPositionLimit[i] + w[i],
            ):
                s = np.clip(depth / w[i], 0.0, 1.0)
                total[i] += k * w[i] ** 2 * (s**3 - s**4 / 2)
                total[i] += k * w[i] * max(depth - w[i], 0.0)
        return total

    x = np.linspace(-4.0, 4.5, 3001)
    h = 1e-6
    pushes = np.array([push_of(np.full(7, value), limits) for value in x])
    slopes = np.array(
        [(potential(v + h) - potential(v - h)) / (2 * h) for v in x[:, None] * np.ones(7)]
    )
    assert_allclose(pushes, -slopes, atol=1e-6 * k)
    assert (np.abs(pushes) <= k * w + 1e-9).all()
    assert (pushes[:, 1] == 0.0).all() and (pushes[:, 2] <= 0.0).all()
    assert largest(np.diff(pushes, axis=0)) < 1.6 * k * (x[1] - x[0])  # slope 3/2 k at most
    assert not push_of(PANDA_Q, limits).any()


@parametrize("rig", [panda_pair, one_panda, scara_pair])
def test_object_and_contact_forces_do_not_feel_it(rig):
    """On the KKT system, with two contacts; arms without joints to spare get no push at all."""
    chain = rig()
    rng = default_rng(60)
    for _ in range(10):
        state, _, pairs, q, v = in_contact(chain, rng)
        a_u = rng.standard_normal(6)
        alpha = rng.uniform(5, 20, 2)
        close = limits_near(chain, q, rng)
        push = push_of(
            q, joint_limit_margins(close.model, PUSHING.limit_stiffness, PUSHING.limit_margin)
        )
        B = inv(state.metric)
        one, two = (
            commanded(close, pairs, q, v, a_u, alpha, B=B, posture=q, posture_task=task)[1]
            for task in (CALM, PUSHING)
        )
        if chain.nq == 10:
            assert_array_equal(one, two)
            continue
        base, other = (held(chain, q, v, pairs).answer(tau) for tau in (one, two))
        assert_allclose(other.a_object, base.a_object, atol=1e-9 * largest(base.a_object))
        assert_allclose(other.alpha, base.alpha, atol=1e-9 * largest(base.alpha))
        gain = other.qdd - base.qdd
        assert largest(gain) > 1.0
        for s in chain.slices:  # its own work on the joints it moves is never negative
            assert gain[s] @ (np.diag(state.M)[s] * push[s]) > 0.0


def limits_near(chain, q, rng):
    """The chain with limits so close to q that some joints are in their margins, some beyond."""
    width = rng.uniform(0.3, 1.8, len(q))
    lower = q - width * rng.uniform(-0.045, 0.3, len(q))  # controllers start up to 0.05 beyond
    upper = lower + width
    arms = []
    for arm, s in zip(chain.arms, chain.slices, strict=True):
        model = arm.model.copy()
        model.lowerPositionLimit = lower[s]
        model.upperPositionLimit = upper[s]
        arms.append(replace(arm, model=model))
    return osc.ClosedChain(arms, chain.grasps, chain.payload)


@parametrize("stiffness", [400.0, 0.0])
def test_a_panda_drawn_along_its_null_path_stops_before_the_limit(stiffness):
    """Its rest posture lies 0.25 rad beyond a limit of joint 1; without the push it gets there."""
    chain = panda(joint1=(-2.8, 0.2))
    posture = PANDA_Q + [3.2, 0, 0, 0, 0, 0, 0]
    plant = rigid_plant(PANDA_Q, chain, dt=2e-3)
    X = chain.state(PANDA_Q, np.zeros(7)).X_WO
    task = PostureTask(limit_stiffness=stiffness)
    unwatched = osc.SafetySettings(brake_time=0.0)
    controller = osc.Controller(
        chain, [], dt=2e-3, posture=posture, posture_task=task, safety=unwatched
    )
    wanted = osc.Reference(X, alpha_d=np.zeros(0))
    farthest = -np.inf
    before = None
    jump = 0.0
    for _ in range(400):
        tau = ticked(controller, plant.measure(), wanted)
        jump = max(jump, 0.0 if before is None else largest(tau - before))
        before = tau
        plant.command(tau, 2e-3)
        farthest = max(farthest, plant.q[0])
    assert (farthest < 0.2) == (stiffness > 0.0)
    assert jump < 2.0  # N m, in 2 ms
    moved = plant.truth().X_WO
    assert largest(moved.translation - X.translation) < 1e-5


@parametrize("past", [-0.3, -0.1, -0.02, 0.0, 0.05])
def test_idle_motions_are_pushed_away_from_their_limits(past):
    """Some joints inside their margins, some beyond their limits, some with a limit on one side."""
    rng = default_rng(62)
    for _ in range(3):
        q = PANDA_Q + rng.uniform(-0.5, 0.5, 7)
        v = rng.standard_normal(7)
        ends = {f"joint{j}": (-np.inf, q[j - 1] - past) for j in (1, 4)}
        ends |= {f"joint{j}": (q[j - 1] + past, q[j - 1] + 3.0) for j in (3, 6)}
        chain = panda(**ends)
        posture = q + 0.1 * rng.standard_normal(7)
        task = PostureTask()
        push = push_of(q, joint_limit_margins(chain.model, task.limit_stiffness, task.limit_margin))
        assert push.any() == (past > -0.15)
        state = chain.state(q, v)
        safety = UNLIMITED
        controller = osc.Controller(chain, [], posture=posture, safety=safety, joint_friction=False)
        wanted = osc.Reference(state.X_WO, V_D=state.V_O)
        tau = ticked(controller, unloaded(q, v), wanted)
        own = state.h + state.M @ (task.stiffness * (posture - q) - task.damping * v)
        own += np.diag(state.M) * push
        idle = np.linalg.svd(state.arms[0].J)[2][6]
        assert idle @ tau == approx(idle @ own, abs=1e-9 * largest(own))


def test_gains_out_of_range_are_refused():
    for bad in (
        {"limit_margin": 0.5},
        {"limit_margin": 0.0},
        {"limit_stiffness": -1.0},
        {"limit_stiffness": np.nan},
    ):
        with refused(next(iter(bad))):
            PostureTask(**bad)
