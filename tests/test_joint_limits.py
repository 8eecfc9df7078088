"""Redundant arms keep off their joint limits, in motions that leave the object alone only."""

import numpy as np
from law_calls import allocation, records, write
from pytest import approx
from rigs import (
    PANDA_Q,
    UNLIMITED,
    holding_panda,
    largest,
    panda_arm,
    refused,
    rigid_plant,
    ticked,
    unloaded,
)
from samples import aligned, parametrize

import osc_contact as osc
from osc_contact.control.packing import joint_limit_margins
from osc_contact.settings.control import PostureTask


def push_of(q, margins):
    """(n,) accelerations away from joint limits."""
    rows = records(joints=7).model.joints
    write(rows, **dict(aligned(("low", "high", "width", "most"), margins)))
    return np.array([allocation.push_from_limits(row, x) for row, x in aligned(rows, q)])


def panda(limits):
    """One Panda whose model has other limits: index of a joint → (lower, upper)."""
    arm = panda_arm()
    for joint, (lower, upper) in limits.items():
        arm.model.lowerPositionLimit[joint] = lower
        arm.model.upperPositionLimit[joint] = upper
    return holding_panda(arm)


@parametrize(
    "joint, range_, whole",
    [(0, (-1.0, 2.0), 3.0), (1, (-np.inf, np.inf), None), (2, (-np.inf, 1.0), np.pi)]
    + [(0, (-9.0, 9.0), np.pi)],
)
def test_the_push_rises_smoothly_over_a_margin_and_stays_bounded(joint, range_, whole):
    """k w (3s² − 2s³) at depth s of the margin w, 5 % of a range that counts as π at most."""
    limits = joint_limit_margins(panda({joint: range_}).model, 400.0, 0.05)
    for end, sign in aligned(range_, (1.0, -1.0)):
        w = 0.05 * whole if np.isfinite(end) else 0.0
        for s, share in {-0.1: 0.0, 0.0: 0.0, 0.25: 5 / 32, 0.5: 0.5, 1.0: 1.0, 9: 1.0}.items():
            q = PANDA_Q.copy()
            q[joint] = end + sign * w * (1.0 - s) if w else sign * -1e3
            found = push_of(q, limits)
            assert found[joint] == approx(sign * 400.0 * w * share, abs=1e-9)
            assert not np.delete(found, joint).any()


@parametrize("stiffness", [400.0, 0.0])
def test_a_panda_drawn_along_its_null_path_stops_before_the_limit(stiffness):
    """Its rest posture lies 0.25 rad beyond a limit of joint 1; without the push it gets there."""
    chain = panda({0: (-2.8, 0.2)})
    posture = PANDA_Q + [3.2, 0, 0, 0, 0, 0, 0]
    plant = rigid_plant(PANDA_Q, chain, dt=2e-3)
    X = chain.state(PANDA_Q).X_WO
    task = PostureTask(limit_stiffness=stiffness)
    unwatched = osc.SafetySettings(brake_time=0.0)
    controller = osc.Controller(
        chain, [], dt=2e-3, posture=posture, posture_task=task, safety=unwatched
    )
    desired = osc.Reference(X)
    farthest = -np.inf
    before = None
    jump = 0.0
    for _ in range(400):
        tau = ticked(controller, plant.measure(), desired)
        jump = max(jump, 0.0 if before is None else largest(tau - before))
        before = tau
        plant.command(tau, 2e-3)
        farthest = max(farthest, plant.q[0])
    assert (farthest < 0.2) == (stiffness > 0.0)
    assert jump < 2.0  # N m, in 2 ms
    assert largest(plant.truth().X_WO.translation - X.translation) < 1e-5


@parametrize("past", [-0.3, -0.1, -0.02, 0.0, 0.05])
def test_idle_motions_are_pushed_away_from_their_limits(past):
    """Some joints inside their margins, some beyond their limits, some with a limit on one side."""
    rng = np.random.default_rng(62)
    for _ in range(3):
        q = PANDA_Q + rng.uniform(-0.5, 0.5, 7)
        v = rng.standard_normal(7)
        ends = {j: (-np.inf, q[j] - past) for j in (0, 3)}
        ends |= {j: (q[j] + past, q[j] + 3.0) for j in (2, 5)}
        chain = panda(ends)
        posture = q + 0.1 * rng.standard_normal(7)
        task = PostureTask()
        push = push_of(q, joint_limit_margins(chain.model, task.limit_stiffness, task.limit_margin))
        assert push.any() == (past > -0.15)
        state = chain.state(q, v)
        how = {"posture": posture, "safety": UNLIMITED, "joint_friction": False}
        controller = osc.Controller(chain, [], **how)
        tau = ticked(controller, unloaded(q, v), osc.Reference(state.X_WO, V_D=state.V_O))
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
