"""Near singular postures: commands fade, torques stay continuous, the lost direction is named."""

import numpy as np
import pinocchio as pin
from numpy.linalg import cholesky, lstsq, norm, solve
from pytest import approx
from rigs import (
    SCARA_Q,
    assert_near,
    largest,
    object_poses,
    one_panda,
    placed,
    scara_pair,
    unloaded,
    vector,
)
from samples import aligned, first, parametrize
from scipy.optimize import brentq

import osc_contact as osc
from osc_contact.settings.control import PostureTask
from osc_contact.settings.gains import MotionGains

STRAIGHT = -np.arctan(0.0825 / 0.316) - np.arctan(0.0825 / 0.384)  # the Panda's elbow has offsets


def straight_panda(offset):
    return vector(0.1, 0.6, -0.2, STRAIGHT + offset, 0.2, 1.9, 0.4)


def tick(chain, q, v, posture=None, controller=None):
    """A controller after one tick that asks for the same motion, whatever the posture."""
    X = chain.state(q, v).X_WO
    goal = placed(0.01, -0.005, 0.004) * X
    reference = osc.Reference(goal, squeeze_d=4.0)
    controller = controller or osc.Controller(
        chain, [], osc.Gains(MotionGains(400, 40)), posture=posture
    )
    controller.reset()
    return (controller, controller.tick(unloaded(q, v, len(chain.arms)), reference))


def share_left(chi):
    """3s² − 2s³ of what is commanded, s from χ = 0.05 to 0.3."""
    s = np.clip((chi - 0.05) / 0.25, 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s)


def assert_faded(chain, q, v, posture, controller):
    """The least change of the command in Λ_o, beside (1 − φ)/φ times what it asks of lost motions.

    A share φ weighs 1/φ, at most 1e8: so many digits are lost.
    """
    s = controller.signals
    task = PostureTask()
    state = s.state
    reported = controller.lost_directions
    assert len(reported) == len(state.singular_directions)
    assert (controller.status is osc.Status.DEGRADED) == bool(reported)
    S = state.S
    retreat = task.stiffness * (posture - q) - task.retreat_damping * v
    weight = S.T @ state.metric
    a = S @ solve(weight @ S, weight @ (s.a_u - state.sigma)) + state.sigma
    L = cholesky(weight @ S)
    rows = [*L.T]
    right = [0.0] * state.d
    for lost, one in aligned(state.singular_directions, reported):
        arm = state.arms[lost.arm]
        part = chain.slices[lost.arm]
        assert one.arm == chain.arms[lost.arm].name
        assert one.left == approx(share_left(lost.chi), abs=1e-9) == lost.share
        assert one.inertia_ratio == approx(1.0 / max(lost.chi, 1e-12) ** 2, rel=1e-6)
        assert_near(one.twist, lost.twist / norm(lost.twist[:3]), atol=1e-9)
        assert one.arm in controller.reason and "singular" in controller.reason
        row = S.T @ lost.wrench
        size = norm(solve(L, row))
        if not lost.locked and size > 1e-3:
            target = lost.chi * (lost.mode @ arm.M @ retreat[part]) - lost.wrench @ (a - arm.gamma)
            weight = np.sqrt((1.0 - lost.share) / max(lost.share, 1e-8)) / size
            rows.append(weight * row)
            right.append(weight * target)
    change = S @ lstsq(rows, right, rcond=None)[0]
    size = max(largest(a), largest(change))
    assert_near(S @ s.eta_c + state.sigma, a + change, atol=1e-6 * size, rtol=0)


def stretched_scaras():
    """(n,) postures of the pair, elbows from 0.35 rad to straight within rounding."""
    postures = []
    for bend in np.concatenate((np.linspace(0.35, 0.002, 350), np.geomspace(0.002, 1e-7, 60))):
        q = SCARA_Q.copy()
        q[1] = -bend
        q[6] = bend
        postures.append(_closed(q))
    return postures


def _closed(q):
    """Both arms symmetric about x = 0 with the rod along x: solved for the shoulder angle."""
    chain = scara_pair()

    def posture(shoulder):
        trial = q.copy()
        trial[[0, 5]] = (shoulder, np.pi - shoulder)
        trial[3] = -(trial[0] + trial[1])
        trial[8] = -trial[3]
        return trial

    def miss(shoulder):
        pin.framesForwardKinematics(chain.model, chain.data, posture(shoulder))
        left, right = object_poses(chain)
        return left.translation[0] - right.translation[0]

    return posture(brentq(miss, 0.9, 2.0, xtol=1e-15))


def ranks_on_the_way(chain, postures, v, posture):
    """Ranks of the first arm; torques must be continuous, and shares match their definition."""
    before = controller = None
    ranks = set()
    for k, q in enumerate(postures):
        controller, tau = tick(chain, q, v, posture, controller)
        assert controller.status is not osc.Status.HELD, controller.reason
        ranks.add(controller.signals.state.arms[0].rank)
        if before is not None:
            assert largest((tau - before) / chain.tau_max) < 0.02, q
        before = tau
        if k % 5 == 0:
            assert_faded(chain, q, v, posture, controller)
    return ranks


@parametrize("rest", first([0.4, 0.0], 1))
def test_torques_are_continuous_through_the_straight_elbow(rest):
    """Through fading, rank loss and out again on the other side, with the arm still or moving."""
    panda = one_panda()
    chain = osc.ClosedChain(panda.arms, panda.grasps, panda.payload, rank_tolerance=3e-3)
    v = rest * vector(0.3, -0.5, 0.2, 0.8, 0.1, -0.4, 0.6)
    ends = ((-0.4, -2e-3, 400), (-2e-3, 2e-3, 200), (2e-3, 0.4, 400))
    offsets = np.concatenate([np.linspace(*end) for end in ends])
    postures = map(straight_panda, offsets)
    assert ranks_on_the_way(chain, postures, v, straight_panda(-0.8)) == {5, 6}


def test_torques_of_the_pair_are_continuous_until_both_elbows_are_straight():
    postures = stretched_scaras()
    assert ranks_on_the_way(scara_pair(), postures, np.zeros(10), postures[0]) == {4, 5}


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
    # joints pass their speed limits here, and tips are fast
    data["control"]["safety"] = {"overspeed_time": 10.0, "speed_ceiling": 2.0}
    return osc.run(osc.Scenario.model_validate(data))


SCARAS = ("two_contact_rod", [0, 1, 0], 0.2205)  # 0.2185 m is all they reach
PANDA = ("panda_edge", [1, 0, 0.2], 0.4386)  # 0.4366 m


@parametrize(
    "run",
    first(
        [
            (SCARAS, 1.0, "mujoco"),
            (PANDA, 1.1, "mujoco"),
            (SCARAS, 1.6, "mujoco"),
            (PANDA, 1.6, "mujoco"),
            (SCARAS, 0.6, "mujoco"),
            (PANDA, 0.8, "mujoco"),
            (SCARAS, 1.0, "rigid"),
            (PANDA, 0.8, "rigid"),
        ]
    ),
    ids=str,
)
def test_slowly_normally_and_fast_to_the_edge_of_the_workspace_and_back(run):
    arms, duration, plant = run
    recording = outward(*arms, duration, plant)
    share = recording["tau"] / np.array(list(recording.meta["effort_limits"].values()))
    assert largest(share) <= 1.0
    assert largest(np.diff(share, axis=0)) < 0.15
    assert (recording["status"] == 3).sum() > 50 and not (recording["status"] == 2).any()
    assert largest(recording["motion_error"][-1, :3]) < 1e-3
