"""Ticks that cannot be computed: repeated, held, stopped; limits of the robot."""

from dataclasses import replace
from itertools import repeat
from math import inf

import numpy as np
import pinocchio as pin
import rigs
from complaints import invalid_input, refusals
from grasp_rigs import Case, motions_of, random_case
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from pytest import approx, fixture
from rigs import (
    UNLIMITED,
    assert_near,
    largest,
    placed,
    random_state,
    shift,
    strong,
    terms_at,
    ticked,
    vector,
    with_motors,
    within,
    without_contacts,
)
from samples import parametrize

import osc_contact as osc
from benchmarks.cases import CASES, SPECIAL_CASES, repeatable

RUN, DEGRADED, HOLD, SAFE_STOP = osc.SafetyState
NAN = np.nan


@fixture(params=["one_panda", "two_contact_rod"])
def case(request):
    return CASES[request.param]()


def panda():
    return CASES["one_panda"]()


def blind(case):
    return replace(case.measurement, wrenches=NAN * case.measurement.wrenches)


@parametrize("lost", [1, 2, 3, 19, 20, 25])
def test_it_runs_on_after_19_lost_ticks_and_stops_at_20(case, lost):
    controller = case.controller()
    good = controller.tick(*case.given)
    sums = (controller.motion_integral.copy(), controller.force_integral.copy())
    states = []
    for _ in range(lost):
        tau = controller.tick(blind(case), case.reference)
        states.append(controller.state)
        assert controller.status is osc.Status.HELD
        assert within(tau, case.chain.tau_max)
        if len(states) <= 2:
            assert_array_equal(tau, good)
    assert states == ([DEGRADED] * 2 + [HOLD] * 17 + [SAFE_STOP] * 6)[:lost]
    assert controller.faults == min(lost, 20)
    assert_array_equal(controller.motion_integral, sums[0])
    assert_array_equal(controller.force_integral, sums[1])
    controller.tick(*case.given)
    if lost < 20:
        assert controller.state is RUN and controller.status is osc.Status.OK
        assert controller.faults == 0
    else:
        assert controller.state is SAFE_STOP and "reset()" in controller.reason
        controller.reset()
        assert controller.state is RUN
        ticked(controller, *case.given)


@parametrize("lost, running", [(1, 40), (2, 18)])
def test_lost_ticks_between_others_add_up_where_they_are_more(case, lost, running):
    """Two out of three: the 20th more than were computed stops the arms."""
    controller = repeatable(case.controller())
    states = []
    for _ in range(40):
        for _ in range(lost):
            controller.tick(blind(case), case.reference)
        controller.tick(*case.given)
        states.append(controller.state)
    assert states == [RUN] * running + [SAFE_STOP] * (40 - running)


def test_unreadable_joints_leave_the_last_posture():
    """Speeds are predicted from what was commanded: braked, they are gone in 1/(2 ω) = 25 ms."""
    case = panda()
    controller = case.controller()
    controller.tick(*case.given)
    m = case.measurement
    for _ in range(300):
        tau = controller.tick(osc.Measurement(NAN * m.q, NAN * m.q, BLIND[:1]), case.reference)
    at = Case(case.chain, m.q, case.chain.state(m.q, m.v).X_WO, [])
    assert_near(tau, stop_of(at, 0.0 * m.v)[0], atol=0.02 * case.chain.tau_max.max())
    assert controller.unbraked is not None


@parametrize("name, speed", {"one_panda": 0.15, "two_contact_rod": 1.0})
def test_a_stop_brings_the_joints_to_rest_and_keeps_them_there(name, speed):
    case = CASES[name]()
    plant, controller = without_contacts(case, engaged=False)
    reference = replace(
        case.reference, alpha_d=np.zeros(0), V_D=speed * vector(0.3, 0.2, 0.0, 0.0, 0.0, 0.5)
    )
    osc.run_loop(plant, controller, repeat(reference, 40))
    assert controller.status is osc.Status.OK and largest(plant.measure().v) > 0.09
    speeds = []
    before = controller.last_torques()
    for _ in range(1500):
        seen = plant.measure()
        speeds.append(largest(seen.v))
        seen = replace(seen, wrenches=NAN * seen.wrenches)
        tau = controller.tick(seen, reference)
        assert within(tau - before, 40.0 * 1e-3 * case.chain.tau_max * (1 + 1e-9))
        before = tau
        plant.command(tau, 1e-3)
    assert controller.state is SAFE_STOP
    rest = plant.measure().q
    assert max(speeds[300:]) < 0.05
    osc.run_loop(plant, controller, repeat(reference, 300), check=False)  # which refuses a stop
    assert controller.state is SAFE_STOP  # though the wrenches are back
    assert_near(plant.measure().q, rest, atol=2e-3, rtol=0)


def test_joints_that_stay_too_fast_end_in_a_stop(case):
    controller = repeatable(case.controller())
    limits = controller.settings.safety.replaced(speed_ceiling=inf)
    controller = controller.with_safety(limits)
    limit = case.chain.model.velocityLimit[case.chain.actuated]
    joint = case.chain.actuated[np.argmin(limit)]
    v = case.measurement.v.copy()
    v[joint] = 1.05 * limit.min()
    fast = replace(case.measurement, v=v)
    for _ in range(20):
        controller.tick(fast, case.reference)
        assert controller.state < HOLD
    controller.tick(fast, case.reference)
    assert controller.state is SAFE_STOP
    name = case.chain.joint_names[joint]
    assert f"joint {name} stayed above its speed limit of {limit.min():.4g}" in controller.reason


def test_what_raises_in_python_counts_too():
    case = panda()

    class Broken(osc.VertexOnFace):
        broken = False

        def contact(self, *args, **keys):
            if self.broken:
                raise ValueError("no normal here")
            return super().contact(*args, **keys)

    (pair,) = case.pairs
    mine = Broken(pair.vertex, pair.point, pair.normal, pair.radius, name=pair.name)
    controller = osc.Controller(case.chain, [mine], case.gains, posture=case.posture)
    ticked(controller, *case.given)
    object.__setattr__(mine, "broken", True)
    for _ in range(20):
        controller.tick(*case.given)
        assert controller.status is osc.Status.HELD
    assert controller.state is SAFE_STOP
    other = case.controller()
    for _ in range(20):
        other.tick(replace(case.measurement, q="nowhere"), case.reference)
    assert other.state is SAFE_STOP


test_settings_are_checked = refusals(
    invalid_input,
    {
        "repeats = 20, stop_after = 20": lambda: osc.SafetySettings(repeats=20),
        "hold_rate: expected a plain number; got nan": lambda: osc.SafetySettings(hold_rate=NAN),
        "torque_rate: must be > 0": lambda: osc.SafetySettings(torque_rate=0.0),
        "brake_time: must be >= 0; got -1": lambda: osc.SafetySettings(brake_time=-1.0),
        "load_error: must be > 0": lambda: osc.SafetySettings(load_error=0.0),
    },
)


# Limits of the robot: torque rate, joint speed and position, power and force in the contacts


DT = 1e-3


def test_a_joint_is_stopped_before_its_end():
    case = panda()
    plant, controller = without_contacts(case)
    X = pin.SE3(plant.poses()[0])
    model = case.chain.model
    ends = []
    for k in range(4000):
        angle = 1.5 * k * DT  # a turn that the wrist has no room for
        goal = X * placed(rpy=(0.0, 0.0, angle))
        seen = plant.measure()
        ends.append(np.fmin(seen.q - model.lowerPositionLimit, model.upperPositionLimit - seen.q))
        spin = np.append(np.zeros(3), 1.5 * X.rotation[:, 2])
        plant.command(controller.tick(seen, osc.Reference(goal, spin)), DT)
        if controller.state is SAFE_STOP and largest(seen.v) < 1e-3:
            break
    assert controller.state is SAFE_STOP and "end of its range" in controller.reason
    nearest = np.min(ends, axis=0)
    joint = case.chain.joint_names[np.argmin(nearest)]
    assert f"joint {joint} " in controller.reason
    assert 0.0 < nearest.min() < 0.25


@parametrize(
    "times, word, ticks", [(8.0, "three times its command", 51), (-1.0, "fifth of its", 101)]
)
def test_a_force_that_is_far_too_large_stops_it_and_so_does_one_that_is_not_felt(
    times, word, ticks
):
    """Readings in which the contact force is so many times 10 N."""
    case = panda()
    m = case.measurement
    state = case.chain.state(m.q, m.v)
    n = case.pairs[0].contact(state.X_WO, state.V_O).N[:, 0]
    more = shift(state.X_WO.translation).act(pin.Force(n * 10.0 * (times - 1.0)))
    pressed = replace(m, wrenches=m.wrenches + state.sensors[0].actInv(more).vector)
    limits = osc.SafetySettings(
        overforce_time=0.0505, contact_loss_time=0.1005, contact_ceiling=inf, wrist_ceiling=inf
    )
    controller = repeatable(case.controller().with_safety(limits))
    passed = 0
    while controller.state is not SAFE_STOP and passed < 120:
        controller.tick(pressed, case.reference)
        controller.motion_integral = np.zeros(6)
        passed += 1
    assert passed in (ticks, ticks + 1)
    assert word in controller.reason and case.pairs[0].name in controller.reason


def stop_of(case, v, known=True):
    """Torques (n,) that carry arms and object and that brake both by q̈ = −40 v, and this q̈.

    Each arm carries its share of the object, where it is `known`. Joints without a motor drive
    nothing: q̈ = 0. A grasp transmits no turn about its ball or hinge.
    """
    chain = case.chain
    data = terms_at(chain.model, case.q, v)
    carry = np.array(data.nle)
    q_dd = np.zeros(chain.nq)
    q_dd[chain.actuated] = -40.0 * v[chain.actuated]
    brake = data.M @ q_dd
    rest = case.at_rest()
    for arm, s in zip(rest.arms if known else (), chain.slices, strict=known):
        share = arm.J.T / len(rest.arms)
        carry[s] += share @ rest.payload.p
    at_object = pin.SE3(np.eye(3), -case.X_WO.translation).toActionMatrix()
    for i, (kind, _, axis) in enumerate(case.grasps if known else ()):
        tip = f"{chain.arms[i].name}/{chain.arms[i].tip}"
        X_WT = data.oMf[chain.model.getFrameId(tip)]
        to_object = at_object @ X_WT.toActionMatrix()  # motions at the tip, in its axes
        T = motions_of(kind, axis)
        P = to_object @ (np.eye(6) - T @ T.T) @ np.linalg.inv(to_object)
        s = chain.slices[i]
        transmitted = P @ rest.arms[i].J
        inertia = transmitted.T @ rest.payload.Lambda @ transmitted
        brake[s] += inertia @ q_dd[s] / len(rest.arms)
    return (carry, brake, q_dd)


BLIND = np.full((2, 6), NAN)


@parametrize("arms", ["one_panda", "panda_pair", "scara_pair", "scara_pair, nothing held"])
def test_motors_carry_first_and_brake_with_what_is_left(arms):
    """Scaled as a whole, by a tenth or more, or joint by joint where this takes more power."""
    name, _, empty = arms.partition(",")
    chain = getattr(rigs, name)(*[False] * bool(empty))
    rng = default_rng(5)
    scaled = 0
    for _ in range(12):
        q, v = random_state(chain, rng)
        rigid = [("rigid", pin.SE3.Identity(), np.ones(3))] * len(chain.arms)
        carry, brake, q_dd = stop_of(Case(chain, q, chain.state(q, v).X_WO, rigid), v)
        most = abs(carry) * rng.choice([1.0, 0.9], len(q), p=[0.7, 0.3])
        most += abs(brake) * rng.choice([0.05, 0.3, 0.9, 5.0], len(q), p=[0.1, 0.1, 0.1, 0.7])
        most[[j for j in range(len(q)) if j not in chain.actuated]] = np.inf
        controller = osc.Controller(with_motors(chain, most[chain.actuated]), [])
        blind = osc.Measurement(q, v, BLIND[: len(chain.arms)])
        tau = controller.tick(blind, osc.Reference(placed()))
        room = np.maximum(most - carry * np.sign(brake), 0.0) / abs(brake)
        for s in chain.slices:
            share = np.clip(room[s].min(), 0.1, 1.0)
            least = np.minimum(room, 1.0) * brake
            driven = np.isfinite(most[s])
            better = (least - share * brake)[s][driven] @ q_dd[s][driven] > 0.0
            brake[s] = least[s] if better else share * brake[s]
            assert_near(
                controller.records.memory.joints.acceleration[s], share * q_dd[s], atol=1e-9
            )
            scaled += share < 1.0
        expected = np.clip(carry + brake, -most, most)[chain.actuated]
        assert_near(tau, expected, atol=1e-9, rtol=1e-9)
    assert scaled > 6


@parametrize("located", [False, True])
def test_an_object_that_no_arm_holds_rigidly_is_carried_where_it_was(located):
    case = random_case(["ur5", "panda"], ["hinge", "ball"], default_rng(1))
    case = replace(case, chain=strong(case.chain))
    controller = osc.Controller(case.chain, [], safety=UNLIMITED)
    still = np.zeros(case.chain.nq)
    for v, read in ((still, np.zeros((2, 6))), *[(still + 0.1, BLIND)] * 3)[not located :]:
        tau = controller.tick(osc.Measurement(case.q, v, read), osc.Reference(case.X_WO))
    carry, brake, _ = stop_of(case, v, located)
    assert_near(tau, carry + brake, atol=1e-9)


def test_limits_can_be_changed(case):
    controller = case.controller()
    controller.tick(*case.given)
    other = controller.with_safety(osc.SafetySettings(torque_rate=5.0))
    assert other.settings.safety.torque_rate == 5.0
    assert_array_equal(other.last_torques(), controller.last_torques())
    desired = replace(case.reference, alpha_d=np.full(len(case.pairs), 300.0))
    step = np.abs(other.tick(case.measurement, desired) - controller.last_torques())
    assert (step / case.chain.tau_max).max() == approx(5.0 * DT)


def test_other_limits_and_gains_hold_beside_pairs_written_in_python():
    """Such a pair has the records packed anew at the first tick: by the new settings."""
    case = SPECIAL_CASES["own_pair"]()
    tick, unwind = case.tick()
    for _ in range(400):  # the same readings for longer than `frozen_time`
        tick()
        unwind()
    soft = osc.Gains(osc.MotionGains(100.0, 20.0, 0.0), case.gains.force)
    other = case.controller().with_gains(soft)
    made = replace(case, gains=soft).controller()
    for _ in range(2):
        got, expected = (c.tick(*case.given) for c in (other, made))
        assert_near(got, expected, rtol=1e-12)
