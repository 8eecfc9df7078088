"""Near singular postures: commands fade, torques stay continuous, the lost direction is named."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from grasp_oracle import kkt
from readable.chain import FULL, NONE_LEFT, share_left
from readable.controller import ReadableController
from rigs import SCARA_Q, one_panda, scara_pair

import osc_contact as osc
from osc_contact.control.controller import Controller
from osc_contact.control.motion import MotionGains
from osc_contact.control.settings import PostureTask
from osc_contact.interface import Measurement, Reference
from osc_contact.scenarios import Scenario

GAINS = osc.Gains(MotionGains(400, 40))
STRAIGHT = -np.arctan(0.0825 / 0.316) - np.arctan(0.0825 / 0.384)  # the Panda's elbow has offsets


def straight_panda(offset):
    return np.array([0.1, 0.6, -0.2, STRAIGHT + offset, 0.2, 1.9, 0.4])


def tick(chain, q, v, posture=None, law=Controller):
    """A controller after one tick that asks for the same motion, whatever the posture."""
    X = chain.state(q, v).X_WO
    goal = pin.SE3(X.rotation, X.translation + [0.01, -0.005, 0.004])
    reference = Reference(goal, np.zeros(6), np.zeros(6), np.zeros(0), 4.0)
    controller = law(chain, [], GAINS, posture=posture)
    measurement = Measurement(q, v, np.zeros((len(chain.arms), 6)))
    return controller, controller.tick(measurement, reference)


def assert_as_in_numpy(chain, q, v, posture, controller, tau):
    """The same torques and lost directions.

    A share φ weighs 1/φ, at most 1e8, in the least change of the command: so many digits are lost.
    """
    slow, want = tick(chain, q, v, posture, ReadableController)
    assert controller.status is slow.status
    got, lost = controller.lost_directions, slow.lost_directions
    assert [one.arm for one in got] == [one.arm for one in lost]
    for name in ("left", "inertia_ratio"):
        pairs = [[getattr(one, name) for one in told] for told in (got, lost)]
        np.testing.assert_allclose(*pairs, rtol=1e-6, atol=1e-12)
    shares = [one.share for one in slow.last_signals().state.singular_directions if not one.locked]
    digits = 1e-12 / max(min(shares, default=1.0), 1e-4)
    np.testing.assert_allclose(tau, want, rtol=0, atol=digits * np.abs(want).max())


def stretched_scaras():
    """(n,) postures of the pair, elbows from 0.35 rad to straight within rounding."""
    postures = []
    for bend in np.concatenate((np.linspace(0.35, 0.002, 350), np.geomspace(0.002, 1e-7, 60))):
        q = SCARA_Q.copy()
        q[1], q[6] = -bend, bend
        postures.append(_closed(q))
    return postures


def _closed(q):
    """Both arms symmetric about x = 0 with the rod along x: solved for the shoulder angle."""
    chain = scara_pair()

    def miss(shoulder):
        trial = q.copy()
        trial[0], trial[5] = shoulder, np.pi - shoulder
        trial[3] = -(trial[0] + trial[1])
        trial[8] = -trial[3]
        left, right = chain_poses(chain, trial)
        return left[0] - right[0], trial

    low, high = 0.9, 2.0
    for _ in range(60):
        mid = 0.5 * (low + high)
        if miss(low)[0] * miss(mid)[0] <= 0:
            high = mid
        else:
            low = mid
    return miss(0.5 * (low + high))[1]


def chain_poses(chain, q):
    pin.forwardKinematics(chain.model, chain.data, q)
    pin.updateFramePlacements(chain.model, chain.data)
    return [X.translation for X in chain.object_poses()]


def test_shares_rise_smoothly():
    assert share_left(NONE_LEFT) == 0.0 and share_left(FULL) == 1.0 and share_left(0.0) == 0.0
    x = np.linspace(0.0, 0.4, 2001)
    shares = np.array([share_left(one) for one in x])
    assert (np.diff(shares) >= 0).all() and np.diff(shares).max() < 0.002


def test_chi_is_the_inertia_that_the_arm_shows():
    """Against a push on the arm alone: 1/χ² times the reference's energy is the arm's."""
    chain = one_panda()
    q = straight_panda(0.05)
    state = chain.state(q, np.zeros(7))
    (lost,) = state.singular_directions
    arm = state.arms[0]
    np.testing.assert_allclose(arm.J @ lost.mode, lost.chi * lost.twist, atol=1e-9)
    assert lost.mode @ arm.M @ lost.mode == pytest.approx(1.0)
    assert lost.twist @ state.reference @ lost.twist == pytest.approx(1.0)
    u = lost.twist
    assert u @ arm.Lambda @ u == pytest.approx(1.0 / lost.chi**2, rel=1e-6)


@pytest.mark.parametrize("rest", [0.0, 0.4])
def test_torques_are_continuous_through_the_straight_elbow(rest):
    """Through fading, rank loss and out again on the other side, with the arm still or moving."""
    panda = one_panda()
    chain = osc.ClosedChain(panda.arms, panda.grasps, panda.payload, rank_tolerance=3e-3)
    v = rest * np.array([0.3, -0.5, 0.2, 0.8, 0.1, -0.4, 0.6])
    posture = straight_panda(-0.8)
    before, ranks = None, set()
    offsets = np.concatenate((np.linspace(-0.4, -2e-3, 400), np.linspace(-2e-3, 2e-3, 200),
                              np.linspace(2e-3, 0.4, 400)))  # fmt: skip
    for k, offset in enumerate(offsets):
        q = straight_panda(offset)
        controller, tau = tick(chain, q, v, posture)
        assert controller.status is not osc.Status.HELD, controller.reason
        ranks.add(controller.last_signals().state.arms[0].rank)
        if before is not None:
            assert np.abs((tau - before) / chain.tau_max).max() < 0.02, offset
        before = tau
        if k % 5 == 0:
            assert_as_in_numpy(chain, q, v, posture, controller, tau)
    assert ranks == {5, 6}


def test_torques_of_the_pair_are_continuous_until_both_elbows_are_straight():
    chain = scara_pair()
    before, ranks = None, set()
    postures = stretched_scaras()
    for k, q in enumerate(postures):
        controller, tau = tick(chain, q, np.zeros(10), postures[0])
        assert controller.status is not osc.Status.HELD, controller.reason
        state = controller.last_signals().state
        ranks.add(state.arms[0].rank)
        if before is not None:
            assert np.abs((tau - before) / chain.tau_max).max() < 0.02, q[1]
        before = tau
        if k % 5 == 0:
            assert_as_in_numpy(chain, q, np.zeros(10), postures[0], controller, tau)
    assert ranks == {4, 5}


@pytest.mark.parametrize("law", [Controller, ReadableController])
def test_what_fades_is_left_to_the_posture_and_the_rest_is_obeyed(law):
    """Accelerations by the KKT system of all bodies."""
    chain = one_panda()
    q, v = straight_panda(0.006), 0.1 * np.arange(-3.0, 4.0)
    posture = straight_panda(-0.5)
    controller, tau = tick(chain, q, v, posture, law)
    assert controller.status is osc.Status.DEGRADED
    s = controller.last_signals()
    (lost,) = s.state.singular_directions
    assert lost.share == 0.0 and lost.chi > 1e-3
    got = kkt(chain, q, v, tau)
    task = PostureTask()
    want = task.stiffness * (posture - q) - task.retreat_damping * v
    M = s.state.arms[0].M
    assert lost.mode @ M @ got.qdd == pytest.approx(lost.mode @ M @ want, rel=1e-3)
    # the command changes by what the object resists least
    push = np.linalg.solve(s.state.metric, lost.wrench)
    change = got.a_object - s.a_u
    along = (change @ s.state.metric @ push) / (push @ s.state.metric @ push)
    np.testing.assert_allclose(change, along * push, atol=1e-6 * np.abs(change).max())


@pytest.mark.parametrize("law", [Controller, ReadableController])
def test_the_lost_direction_is_named_and_ordinary_postures_lose_none(law):
    chain = one_panda()
    controller, _ = tick(chain, straight_panda(0.02), np.zeros(7), law=law)
    assert controller.status is osc.Status.DEGRADED
    (lost,) = controller.lost_directions
    assert lost.arm == "arm" and 0.0 <= lost.left < 1.0 and lost.inertia_ratio > 10.0
    assert "arm" in controller.reason and "singular" in controller.reason
    away = chain.state(straight_panda(0.02), np.zeros(7)).X_WO.translation
    assert abs(lost.twist[:3] @ (away - [0, 0, 0.333])) > 0.5 * np.linalg.norm(away)
    bent, _ = tick(chain, straight_panda(-1.5), np.zeros(7), law=law)
    assert bent.status is osc.Status.OK and bent.lost_directions == ()


def outward(name, direction, distance, duration, plant):
    """A run of the arms to `distance`, slightly beyond their reach, and back, without contacts."""
    data = osc.load_scenario(name).as_dict()
    data |= {"contacts": [], "force": {}, "environment": [], "duration": 0.4 + 2 * duration}
    data["plant"]["type"] = plant
    moves = [
        {"type": "minimum_jerk", "value": value, "start": start, "duration": duration}
        for value, start in ((distance, 0.1), (-distance, 0.1 + duration))
    ]
    data["motion"] = [{"kind": "linear", "direction": direction, "signals": moves}]
    data["control"]["safety"] = {"overspeed_time": 10.0}  # joints pass their speed limits here
    return osc.run(Scenario.model_validate(data))


SCARAS = ("two_contact_rod", [0, 1, 0], 0.2205)  # 0.2185 m is all they reach
PANDA = ("panda_edge", [1, 0, 0.2], 0.4386)  # 0.4366 m


@pytest.mark.parametrize(
    ("arms", "duration", "plant"),
    [
        (SCARAS, 1.6, "mujoco"), (SCARAS, 1.0, "mujoco"), (SCARAS, 0.6, "mujoco"),
        (PANDA, 1.6, "mujoco"), (PANDA, 1.1, "mujoco"), (PANDA, 0.8, "mujoco"),
        (SCARAS, 1.0, "rigid"), (PANDA, 0.8, "rigid"),
    ],
)  # fmt: skip
def test_slowly_normally_and_fast_to_the_edge_of_the_workspace_and_back(arms, duration, plant):
    recording = outward(*arms, duration, plant)
    share = recording["tau"] / np.array(list(recording.meta["effort_limits"].values()))
    assert np.isfinite(share).all() and np.abs(share).max() <= 1.0
    assert np.abs(np.diff(share, axis=0)).max() < 0.15
    assert (recording["status"] == 3).sum() > 50 and not (recording["status"] == 2).any()
    assert np.abs(recording["motion_error"][-1, :3]).max() < 1e-3
