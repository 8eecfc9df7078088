"""Ticks that cannot be computed: repeated, held, stopped; and joints that run away."""

from dataclasses import replace
from itertools import repeat

import numpy as np
import pinocchio as pin
from numpy.testing import assert_allclose, assert_array_equal
from pytest import fixture
from rigs import largest, refused, ticked, without_contacts
from samples import parametrize

import osc_contact as osc
from benchmarks.cases import CASES, repeatable

RUN, DEGRADED, HOLD, SAFE_STOP = osc.SafetyState
NAN = float("nan")


@fixture(params=["one_panda", "two_contact_rod"])
def case(request):
    return CASES[request.param]()


def blind(case):
    return replace(case.measurement, wrenches=np.full_like(case.measurement.wrenches, NAN))


@parametrize("lost", [1, 2, 3, 19, 20, 25])
def test_it_runs_on_after_19_lost_ticks_and_stops_at_20(case, lost):
    controller = case.controller()
    good = controller.tick(case.measurement, case.reference)
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
    controller.tick(case.measurement, case.reference)
    if lost < 20:
        assert controller.state is RUN and controller.status is osc.Status.OK
        assert controller.faults == 0
    else:
        assert controller.state is SAFE_STOP and "reset()" in controller.reason
        controller.reset()
        assert controller.state is RUN
        for _ in range(5):  # as fast as motors may change
            tau = controller.tick(case.measurement, case.reference)
            controller.motion_integral = controller.force_integral = np.zeros(6)
        assert_allclose(tau, good, rtol=0, atol=1e-9)
        assert controller.status is osc.Status.OK


def test_a_first_tick_that_fails_holds_the_arm_against_gravity():
    case = CASES["one_panda"]()
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
    case = CASES["one_panda"]()
    controller = case.controller()
    plain = case.controller()
    for each in (controller, plain):
        each.tick(case.measurement, case.reference)
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
        controller.tick(case.measurement, case.reference)
    for _ in range(5):
        controller.tick(fast, case.reference)
    assert controller.state < HOLD
    controller.tick(fast, case.reference)
    assert controller.state is SAFE_STOP
    name = case.chain.joint_names[joint]
    assert f"joint {name} stayed above its speed limit of {limit.min():.4g}" in controller.reason


def test_what_raises_in_python_counts_too():
    case = CASES["one_panda"]()

    class Broken(osc.VertexOnFace):
        broken = False

        def contact(self, *args, **keys):
            if self.broken:
                raise ValueError("no normal here")
            return super().contact(*args, **keys)

    (pair,) = case.pairs
    mine = Broken(pair.vertex, pair.point, pair.normal, pair.radius, name=pair.name)
    controller = osc.Controller(case.chain, [mine], case.gains, posture=case.posture)
    ticked(controller, case.measurement, case.reference)
    object.__setattr__(mine, "broken", True)
    for _ in range(20):
        controller.tick(case.measurement, case.reference)
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
