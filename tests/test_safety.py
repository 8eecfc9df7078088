"""Ticks that cannot be computed: repeated, held, stopped; limits of the robot."""

from dataclasses import replace
from itertools import repeat

import numpy as np
import pinocchio as pin
from complaints import invalid_input
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, fixture
from rigs import largest, refused, shift, ticked, without_contacts
from samples import parametrize

import osc_contact as osc
from benchmarks.cases import CASES, SPECIAL_CASES, repeatable

RUN, DEGRADED, HOLD, SAFE_STOP = osc.SafetyState
NAN = float("nan")


@fixture(params=["one_panda", "two_contact_rod"])
def case(request):
    return CASES[request.param]()


def panda():
    return CASES["one_panda"]()


def blind(case):
    return replace(case.measurement, wrenches=np.full_like(case.measurement.wrenches, NAN))


@parametrize("lost", [1, 2, 3, 19, 20, 25])
def test_it_runs_on_after_19_lost_ticks_and_stops_at_20(case, lost):
    controller = case.controller()
    good = controller.tick(*case.given)
    sums = controller.motion_integral.copy(), controller.force_integral.copy()
    states = []
    for _ in range(lost):
        tau = controller.tick(blind(case), case.reference)
        states.append(controller.state)
        assert controller.status is osc.Status.HELD
        assert np.isfinite(tau).all() and (np.abs(tau) <= case.chain.tau_max).all()
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
        for _ in range(5):  # as fast as motors may change
            tau = controller.tick(*case.given)
            controller.motion_integral = controller.force_integral = np.zeros(6)
        assert_allclose(tau, good, rtol=0, atol=1e-9)
        assert controller.status is osc.Status.OK


def test_a_first_tick_that_fails_holds_the_arm_against_gravity():
    case = panda()
    still = replace(blind(case), v=np.zeros(7))
    tau = case.controller().tick(still, case.reference)
    model = case.chain.model
    data = case.chain.model.createData()
    gravity = pin.computeGeneralizedGravity(model, data, still.q).copy()
    inertia = case.chain.payload
    state = case.chain.state(still.q, still.v)
    weight = -inertia.inertia.mass * model.gravity.linear  # at the centre of mass of the object
    lever = state.X_WO.rotation @ inertia.inertia.lever
    wrench = np.concatenate((weight, np.cross(lever, weight)))  # at O
    J = pin.computeFrameJacobian(model, data, still.q, case.chain.tips[0], pin.LOCAL_WORLD_ALIGNED)
    shift = state.X_WO.translation - data.oMf[case.chain.tips[0]].translation
    at_tip = wrench + np.concatenate((np.zeros(3), np.cross(shift, weight)))
    assert_allclose(tau, gravity + J.T @ at_tip, rtol=0, atol=1e-9)


def test_unreadable_joints_leave_the_last_posture():
    case = panda()
    controller = case.controller()
    plain = case.controller()
    for each in (controller, plain):
        each.tick(*case.given)
    still = replace(blind(case), v=np.zeros(7))
    gone = replace(still, q=np.full(7, NAN), v=np.full(7, NAN))
    for _ in range(12):
        a = controller.tick(gone, case.reference)
        b = plain.tick(still, case.reference)
    assert controller.state is HOLD
    # speeds are predicted from what was commanded: braked, they are gone in some 1/(2 ω) = 25 ms
    for _ in range(300):
        a = controller.tick(gone, case.reference)
        b = plain.tick(still, case.reference)
    assert_allclose(a, b, rtol=0, atol=0.02 * case.chain.tau_max.max())
    assert controller.unbraked is not None and plain.unbraked is None


@parametrize(("name", "pace"), [("one_panda", 0.15), ("two_contact_rod", 1.0)])
def test_a_stop_brings_the_joints_to_rest_and_keeps_them_there(name, pace):
    case = CASES[name]()
    plant, controller = without_contacts(case, engaged=False)
    reference = replace(
        case.reference, alpha_d=np.zeros(0), V_D=pace * np.array([0.3, 0.2, 0.0, 0.0, 0.0, 0.5])
    )
    osc.run_loop(plant, controller, repeat(reference, 40))
    assert controller.status is osc.Status.OK and largest(plant.measure().v) > 0.09
    speeds = []
    before = controller.last_torques()
    for _ in range(1500):
        seen = plant.measure()
        speeds.append(largest(seen.v))
        seen = replace(seen, wrenches=np.full_like(seen.wrenches, NAN))
        tau = controller.tick(seen, reference)
        assert (np.abs(tau - before) <= 40.0 * 1e-3 * case.chain.tau_max * (1 + 1e-9)).all()
        before = tau
        plant.command(tau, 1e-3)
    assert controller.state is SAFE_STOP
    rest = plant.measure().q
    assert max(speeds[300:]) < 0.05
    osc.run_loop(plant, controller, repeat(reference, 300))
    assert controller.state is SAFE_STOP  # though the wrenches are back
    assert_allclose(plant.measure().q, rest, rtol=0, atol=2e-3)


def test_joints_that_stay_too_fast_end_in_a_stop(case):
    controller = repeatable(case.controller())
    limit = case.chain.model.velocityLimit[case.chain.actuated]
    joint = case.chain.actuated[int(np.argmin(limit))]
    v = case.measurement.v.copy()
    v[joint] = 1.05 * limit.min()
    fast = replace(case.measurement, v=v)
    for _ in range(20):
        controller.tick(fast, case.reference)
        assert controller.state < HOLD
    for _ in range(5):  # what speaks against it is taken off
        controller.tick(*case.given)
    for _ in range(5):
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


def test_settings_are_checked():
    with refused("repeats = 20, stop_after = 20"):
        osc.SafetySettings(repeats=20)
    with refused("hold_rate: expected a plain number; got nan"):
        osc.SafetySettings(hold_rate=NAN)


# Limits of the robot: torque rate, joint speed and position, power and force in the contacts


DT = 1e-3


def guarded(case, **safety):
    return repeatable(case.controller().with_safety(osc.SafetySettings(**safety)))


@parametrize("force", [60.0, 3000.0])  # within the motor limits, and beyond
def test_torques_go_straight_to_what_is_wanted_at_their_rate(case, force):
    controller = guarded(case, torque_rate=30.0)
    free = case.controller().with_safety(osc.SafetySettings.motors_only())
    before = controller.tick(*case.given)
    free.tick(*case.given)
    step = 30.0 * DT * case.chain.tau_max
    wish = replace(case.reference, alpha_d=np.full(len(case.pairs), force))
    wanted = free.tick(case.measurement, wish)
    assert (free.status is osc.Status.SATURATED) == (force > 1000.0)
    tau = controller.tick(case.measurement, wish)
    share = (np.abs(wanted - before) / step).max()
    assert share > 1.5
    assert_allclose(tau, before + (wanted - before) / share, rtol=0, atol=1e-6)


def test_a_joint_is_stopped_before_its_end():
    case = panda()
    plant, controller = without_contacts(case)
    X = pin.SE3(plant.poses()[0])
    model = case.chain.model
    ends = []
    for k in range(4000):
        angle = 1.5 * k * DT  # a turn that the wrist has no room for
        goal = X * pin.SE3(pin.exp3(np.array([0.0, 0.0, angle])), np.zeros(3))
        seen = plant.measure()
        ends.append(np.fmin(seen.q - model.lowerPositionLimit, model.upperPositionLimit - seen.q))
        spin = np.append(np.zeros(3), 1.5 * X.rotation[:, 2])
        plant.command(controller.tick(seen, osc.Reference(goal, spin)), DT)
        if controller.state is SAFE_STOP and np.abs(seen.v).max() < 1e-3:
            break
    assert controller.state is SAFE_STOP and "end of its range" in controller.reason
    nearest = np.min(ends, axis=0)
    joint = case.chain.joint_names[int(np.argmin(nearest))]
    assert f"joint {joint} " in controller.reason
    assert 0.0 < nearest.min() < 0.25


def pressed(case, times):
    """Readings in which the contact forces are so many times 10 N."""
    read = case.measurement
    state = case.chain.state(read.q, read.v)
    N = np.hstack([pair.contact(state.X_WO, state.V_O).N for pair in case.pairs])
    at_O = shift(state.X_WO.translation)
    more = at_O.act(pin.Force(N.sum(axis=1) * 10.0 * (times - 1.0)))
    return replace(read, wrenches=read.wrenches + state.sensors[0].actInv(more).vector)


def test_a_force_that_is_far_too_large_stops_it_and_so_does_one_that_is_not_felt():
    case = panda()
    for times, word, ticks in ((8.0, "three times its command", 51), (-1.0, "fifth of its", 101)):
        controller = guarded(case, overforce_time=0.0505, contact_loss_time=0.1005)
        passed = 0
        while controller.state is not SAFE_STOP and passed < 120:
            controller.tick(pressed(case, times), case.reference)
            controller.motion_integral = np.zeros(6)
            passed += 1
        assert passed in (ticks, ticks + 1), passed
        assert word in controller.reason and case.pairs[0].name in controller.reason


def test_the_force_integral_is_bounded():
    case = panda()
    dead = replace(case.measurement, wrenches=np.zeros_like(case.measurement.wrenches))
    for alpha_d, room in ((2.0, 15.0), (40.0, 60.0)):
        controller = guarded(case, contact_loss_time=np.inf)
        wish = replace(case.reference, alpha_d=np.array([alpha_d]))
        most = 0.0
        for _ in range(4000):
            controller.tick(dead, wish)
            controller.motion_integral = np.zeros(6)
            most = max(most, abs(controller.force_integral[0]))
        assert 0.5 * room < most <= room * (1 + 1e-12)


def test_the_motion_integral_is_bounded():
    case = panda()
    gains = osc.Gains(case.gains.motion.replaced(integral=2000.0), case.gains.force)
    controller = guarded(case, contact_loss_time=np.inf, integral_motion=0.5).with_gains(gains)
    off = replace(case.reference, X_WD=shift([0.01, -0.01, 0.0]) * case.reference.X_WD)
    for _ in range(60):
        controller.tick(case.measurement, off)
    assert 2000.0 * np.abs(controller.motion_integral).max() == approx(0.5)


def test_brakes_take_energy_though_motors_are_too_weak_for_all_of_them():
    case = panda()
    chain = case.chain
    model = chain.model
    rng = np.random.default_rng(5)
    weak = 0
    for _ in range(50):
        q = case.measurement.q + 0.2 * rng.standard_normal(7)
        v = 0.7 * model.velocityLimit * rng.uniform(-1.0, 1.0, 7)
        tau = case.controller().tick(osc.Measurement(q, v, np.full((1, 6), np.nan)), case.reference)
        assert (np.abs(tau) <= chain.tau_max * (1 + 1e-12)).all()
        at_rest = chain.state(q, np.zeros(7))
        J = at_rest.arms[0].J
        weight = J.T @ at_rest.payload.p  # of the object
        carried = pin.nonLinearEffects(model, model.createData(), q, v) + weight
        if (np.abs(carried) > chain.tau_max).any():
            continue  # not even the weight
        wanted = pin.crba(model, model.createData(), q) @ (-40.0 * v)
        weak += (np.abs(carried + wanted) > chain.tau_max).any()
        assert v @ (tau - carried) < 0.0
    assert weak > 20


def test_limits_are_checked_and_can_be_changed(case):
    for wrong, words in (
        ({"torque_rate": 0.0}, "torque_rate: must be > 0"),
        ({"brake_time": -1.0}, "brake_time: must be >= 0; got -1"),
    ):
        with invalid_input(words):
            osc.SafetySettings(**wrong)
    controller = case.controller()
    controller.tick(*case.given)
    other = controller.with_safety(osc.SafetySettings(torque_rate=5.0))
    assert other.settings.safety.torque_rate == 5.0
    assert_array_equal(other.last_torques(), controller.last_torques())
    wish = replace(case.reference, alpha_d=np.full(len(case.pairs), 300.0))
    step = np.abs(other.tick(case.measurement, wish) - controller.last_torques())
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
        got, want = (c.tick(*case.given) for c in (other, made))
        assert_allclose(got, want, rtol=1e-12)
